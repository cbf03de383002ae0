//! Batch queries on arrays of numbers, in the shapes that the package documents.

use crate::fault::invalid;
use slicewalk::frame::PageKey;
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::query::{self, Aabb, Answer, Cylinder, Overlap, Ray, RayBound, Shape, Sphere};
use slicewalk::store::{Missing, Snapshot};

/// Most keys of missing pages that a batch gathers.
const MISSING: usize = 1024;

/// Pages missing for the answers of a batch.
#[derive(Debug, Default)]
pub(crate) struct Lacks(pub Vec<PageKey>);

impl Lacks {
    fn note(&mut self, missing: &Missing) {
        for key in missing.keys() {
            // Neighbouring queries mostly need the same pages.
            if self.0.len() < MISSING && !self.0.iter().rev().any(|other| other == key) {
                self.0.push(*key);
            }
        }
    }

    /// Returns what is known, or notes what is missing for it.
    pub(crate) fn known<T>(&mut self, answer: Answer<T>) -> Option<T> {
        match answer {
            Answer::Known(value) => Some(value),
            Answer::NotLoaded(missing) => {
                self.note(&missing);
                None
            }
        }
    }
}

fn rows<const N: usize>(numbers: &[f64]) -> Result<&[[f64; N]], String> {
    match numbers.as_chunks::<N>() {
        (rows, []) => Ok(rows),
        _ => Err(invalid(format_args!("{} numbers are not rows of {N}", numbers.len()))),
    }
}

fn each<const N: usize, T>(
    numbers: &[f64],
    mut answer: impl FnMut(&[f64; N]) -> slicewalk::Result<T>,
) -> Result<Vec<T>, String> {
    let rows = rows::<N>(numbers)?.iter().enumerate();
    rows.map(|(n, row)| answer(row).map_err(|error| invalid(format_args!("row {n}: {error}")))).collect()
}

fn aabb(row: &[f64]) -> slicewalk::Result<Aabb> {
    Aabb::new(Point3::from_slice(&row[..3]), Point3::from_slice(&row[3..6]))
}

fn sphere(row: &[f64]) -> slicewalk::Result<Sphere> {
    Sphere::new(Point3::from_slice(&row[..3]), row[3])
}

fn cylinder(row: &[f64]) -> slicewalk::Result<Cylinder> {
    Cylinder::new(Point3::from_slice(&row[..3]), row[3], row[4])
}

fn overlap<H: Shape>(set: &Snapshot, shape: &H, lacks: &mut Lacks) -> u8 {
    match query::overlaps(set, shape) {
        Overlap::Clear => 0,
        Overlap::Hit => 1,
        Overlap::NotLoaded(missing) => {
            lacks.note(&missing);
            2
        }
    }
}

/// N×6 (min, max) → 0 clear, 1 hit, 2 not loaded.
pub(crate) fn overlaps(set: &Snapshot, boxes: &[f64], lacks: &mut Lacks) -> Result<Vec<u8>, String> {
    each::<6, _>(boxes, |row| Ok(overlap(set, &aabb(row)?, lacks)))
}

/// N×4 (centre, radius) → as [`overlaps`].
pub(crate) fn spheres(set: &Snapshot, spheres: &[f64], lacks: &mut Lacks) -> Result<Vec<u8>, String> {
    each::<4, _>(spheres, |row| Ok(overlap(set, &sphere(row)?, lacks)))
}

/// N×5 (feet, radius, height) → as [`overlaps`].
pub(crate) fn cylinders(set: &Snapshot, cylinders: &[f64], lacks: &mut Lacks) -> Result<Vec<u8>, String> {
    each::<5, _>(cylinders, |row| Ok(overlap(set, &cylinder(row)?, lacks)))
}

/// N×9 (min, max, motion) → free fraction of the motion; NaN: not loaded.
pub(crate) fn sweep(set: &Snapshot, sweeps: &[f64], lacks: &mut Lacks) -> Result<Vec<f64>, String> {
    each::<9, _>(sweeps, |row| {
        let answer = query::sweep(set, &aabb(row)?, Vector3::from_column_slice(&row[6..]));
        Ok(lacks.known(answer).map_or(f64::NAN, |hit| hit.map_or(1.0, |hit| hit.fraction)))
    })
}

/// N×7 (origin, direction, max) → five numbers per ray: distance (∞: no hit, NaN: not loaded), normal, obstacle.
pub(crate) fn cast(set: &Snapshot, rays: &[f64], lacks: &mut Lacks) -> Result<Vec<f64>, String> {
    let answers = each::<7, _>(rays, |row| {
        let ray = Ray::new(Point3::from_slice(&row[..3]), Vector3::from_column_slice(&row[3..6]), row[6])?;
        Ok(match lacks.known(query::cast(set, &ray)) {
            None => [f64::NAN, 0.0, 0.0, 0.0, 0.0],
            Some(None) => [f64::INFINITY, 0.0, 0.0, 0.0, 0.0],
            Some(Some(hit)) => {
                [hit.distance, hit.normal.x, hit.normal.y, hit.normal.z, f64::from(u8::from(hit.obstacle))]
            }
        })
    })?;
    Ok(answers.into_flattened())
}

/// N×7 (origin, direction, max) → two numbers per ray: distance (∞: no hit, NaN: not loaded), and 1 if it is only a
/// lower bound, from the level.
pub(crate) fn far(
    set: &Snapshot,
    level: Option<&Snapshot>,
    rays: &[f64],
    lacks: &mut Lacks,
) -> Result<Vec<f64>, String> {
    let answers = each::<7, _>(rays, |row| {
        let ray = Ray::new(Point3::from_slice(&row[..3]), Vector3::from_column_slice(&row[3..6]), row[6])?;
        let answer = match level {
            Some(level) => query::cast_far(set, level, &ray),
            None => match query::cast(set, &ray) {
                Answer::Known(hit) => Answer::Known(RayBound::Exact(hit)),
                Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
            },
        };
        Ok(match lacks.known(answer) {
            None => [f64::NAN, 0.0],
            Some(RayBound::Exact(hit)) => [hit.map_or(f64::INFINITY, |hit| hit.distance), 0.0],
            Some(RayBound::AtLeast(distance)) => [distance, 1.0],
        })
    })?;
    Ok(answers.into_flattened())
}

/// N×6 (min, max) → the highest floor at or below the top; −∞: none, NaN: not loaded.
pub(crate) fn floor(set: &Snapshot, boxes: &[f64], lacks: &mut Lacks) -> Result<Vec<f64>, String> {
    each::<6, _>(boxes, |row| {
        let floor = query::floor_under(set, &aabb(row)?, row[5], f64::INFINITY);
        Ok(lacks.known(floor).map_or(f64::NAN, |floor| floor.unwrap_or(f64::NEG_INFINITY)))
    })
}
