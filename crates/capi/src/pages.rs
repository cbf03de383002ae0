//! Sets of pages, and batches of queries on them.

use crate::archive::sw_archive;
use crate::border::{Failure, Handle, Outcome, check_apart, close, give, guard, held, input, output, sw_status};
use engine::nalgebra::{Point3, Vector3};
use engine::query::{
    Aabb, Answer, Cylinder, Overlap, Ray, Sphere, cast, ceiling_between, floor_between, nearest_surface, overlaps,
    sweep,
};
use engine::store::Snapshot;
use engine::{NoMonitor, Result};

/// Pages in memory: all of an archive, or those of a stream at one moment. Any number of threads may use it at once.
pub struct sw_pages;

impl Handle for sw_pages {
    type Value = Snapshot;
    const NAME: &'static str = "sw_pages";
}

/// Loads all pages of an archive.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_pages_load(archive: *const sw_archive, pages: *mut *mut sw_pages) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles and `pages`.
        unsafe { give(pages, || Ok(Snapshot::resident(&held(archive)?.archive, &NoMonitor)?)) }
    })
}

/// Closes a set of pages. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_pages_close(pages: *mut sw_pages) -> sw_status {
    // SAFETY: as the header demands of handles.
    unsafe { close(pages) }
}

/// Answers rows of `N` numbers.
///
/// # Safety
/// The conditions of [`held`], [`input`] and [`output`] hold.
pub unsafe fn batch<H: Handle, const N: usize, A: Copy>(
    handle: *const H,
    (rows, len, what): (*const f64, usize, &str),
    (answers, count): (*mut A, usize),
    answer: impl Fn(&H::Value, &[f64; N]) -> Result<A>,
) -> Outcome {
    // SAFETY: guaranteed by the caller.
    let content = unsafe { held(handle) }?;
    if count.checked_mul(N) != Some(len) {
        let text = format!("{what}: expected {N} numbers for each of {count} answers, found {len} numbers");
        return Err(Failure::argument(text));
    }
    check_apart(rows, len, answers, count)?;
    // SAFETY: guaranteed by the caller.
    let (rows, answers) = unsafe { (input(rows, len, what)?, output(answers, count, "answers")?) };
    for (number, (row, place)) in rows.as_chunks::<N>().0.iter().zip(answers).enumerate() {
        place.write(answer(content, row).map_err(|error| Failure::from(error).of_row(what, number))?);
    }
    Ok(())
}

fn code(overlap: Overlap) -> u8 {
    match overlap {
        Overlap::Clear => 0,
        Overlap::Hit => 1,
        Overlap::NotLoaded(_) => 2,
    }
}

/// Reads a box.
pub fn aabb(&[x0, y0, z0, x1, y1, z1]: &[f64; 6]) -> Result<Aabb> {
    Aabb::new([x0, y0, z0].into(), [x1, y1, z1].into())
}

fn known<T>(answer: Answer<T>, value: impl FnOnce(T) -> f64) -> f64 {
    answer.known().map_or(f64::NAN, value)
}

/// Answers whether boxes touch anything solid.
///
/// `boxes` holds `boxes_len` = 6 · `count` numbers: xmin, ymin, zmin, xmax, ymax, zmax (m; minima may be -∞, maxima ∞).
/// `answers` gets `count` values: `SW_CLEAR`, `SW_HIT`, `SW_NOT_LOADED`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_overlaps_boxes(
    pages: *const sw_pages,
    boxes: *const f64,
    boxes_len: usize,
    answers: *mut u8,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        batch(pages, (boxes, boxes_len, "boxes"), (answers, count), |pages, row: &[f64; 6]| {
            let shape = aabb(row)?;
            Ok(code(overlaps(pages, &shape)))
        })
    })
}

/// Answers whether upright cylinders touch anything solid, like `sw_overlaps_boxes`: 5 numbers each, x, y, z of the
/// middle of the bottom, radius, height (m).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_overlaps_cylinders(
    pages: *const sw_pages,
    cylinders: *const f64,
    cylinders_len: usize,
    answers: *mut u8,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        let given = (cylinders, cylinders_len, "cylinders");
        batch(pages, given, (answers, count), |pages, &[x, y, z, radius, height]: &[f64; 5]| {
            let shape = Cylinder::new([x, y, z].into(), radius, height)?;
            Ok(code(overlaps(pages, &shape)))
        })
    })
}

/// Answers whether spheres touch anything solid, like `sw_overlaps_boxes`: 4 numbers each, x, y, z of the middle,
/// radius (m).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_overlaps_spheres(
    pages: *const sw_pages,
    spheres: *const f64,
    spheres_len: usize,
    answers: *mut u8,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        let given = (spheres, spheres_len, "spheres");
        batch(pages, given, (answers, count), |pages, &[x, y, z, radius]: &[f64; 4]| {
            let shape = Sphere::new([x, y, z].into(), radius)?;
            Ok(code(overlaps(pages, &shape)))
        })
    })
}

/// Casts rays: 7 numbers each, x, y, z, direction dx, dy, dz of any length but 0, longest distance (m, may be ∞).
/// `distances` gets the distance to the first solid (m), ∞ without a hit, NaN if that depends on missing pages.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_cast_rays(
    pages: *const sw_pages,
    rays: *const f64,
    rays_len: usize,
    distances: *mut f64,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        let given = (rays, rays_len, "rays");
        batch(pages, given, (distances, count), |pages, &[x, y, z, dx, dy, dz, max]: &[f64; 7]| {
            let ray = Ray::new(Point3::new(x, y, z), Vector3::new(dx, dy, dz), max)?;
            let answer = cast(pages, &ray);
            Ok(known(answer, |hit| hit.map_or(f64::INFINITY, |hit| hit.distance)))
        })
    })
}

/// Sweeps boxes: 9 numbers each, the box, then its motion dx, dy, dz (m). `fractions` gets the share of the motion up
/// to the first contact, 1 without a contact, NaN if that depends on missing pages.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_sweep_boxes(
    pages: *const sw_pages,
    sweeps: *const f64,
    sweeps_len: usize,
    fractions: *mut f64,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        let given = (sweeps, sweeps_len, "sweeps");
        batch(pages, given, (fractions, count), |pages, &[x0, y0, z0, x1, y1, z1, dx, dy, dz]: &[f64; 9]| {
            let (shape, motion) = (aabb(&[x0, y0, z0, x1, y1, z1])?, Vector3::new(dx, dy, dz));
            if !motion.iter().all(|v| v.is_finite()) {
                return Err(engine::Error::parameter("motion", "its numbers must be finite"));
            }
            let answer = sweep(pages, &shape, motion);
            Ok(known(answer, |hit| hit.map_or(1.0, |hit| hit.fraction)))
        })
    })
}

/// Finds the highest floor under each box between its zmin and zmax: 6 numbers each. `heights` gets the height (m), -∞
/// without a floor, NaN if that depends on missing pages.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_floors(
    pages: *const sw_pages,
    boxes: *const f64,
    boxes_len: usize,
    heights: *mut f64,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        batch(pages, (boxes, boxes_len, "boxes"), (heights, count), |pages, row: &[f64; 6]| {
            let answer = floor_between(pages, &aabb(row)?, row[2], row[5]);
            Ok(known(answer, |z| z.unwrap_or(f64::NEG_INFINITY)))
        })
    })
}

/// Finds the lowest ceiling over each box between its zmin and zmax: 6 numbers each. `heights` gets the height (m), ∞
/// without a ceiling, NaN if that depends on missing pages.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_ceilings(
    pages: *const sw_pages,
    boxes: *const f64,
    boxes_len: usize,
    heights: *mut f64,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        batch(pages, (boxes, boxes_len, "boxes"), (heights, count), |pages, row: &[f64; 6]| {
            let answer = ceiling_between(pages, &aabb(row)?, row[2], row[5]);
            Ok(known(answer, |z| z.unwrap_or(f64::INFINITY)))
        })
    })
}

/// Finds the nearest place on the surface of solid space: 4 numbers each, x, y, z of a place, greatest distance (m).
/// `answers` gets 7 · `count` numbers: the signed distance (m; above 0 in free space, below 0 inside solid), x, y, z of the
/// place on the surface (m), and the unit vector along which the distance grows (zero on the surface). If there is nothing
/// that near, the distance is ∞ and the rest NaN; all are NaN if that depends on missing pages.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_nearest_surfaces(
    pages: *const sw_pages,
    places: *const f64,
    places_len: usize,
    answers: *mut f64,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        let given = (places, places_len, "places");
        batch(pages, given, (answers.cast(), count), |pages, &[x, y, z, max]: &[f64; 4]| {
            if ![x, y, z].iter().all(|v| v.is_finite()) || max.is_nan() || max < 0.0 {
                let reason = "expected a finite place and a distance of at least 0";
                return Err(engine::Error::parameter("place", reason));
            }
            let nothing = |distance: f64| [distance, f64::NAN, f64::NAN, f64::NAN, f64::NAN, f64::NAN, f64::NAN];
            Ok(match nearest_surface(pages, Point3::new(x, y, z), max) {
                Answer::NotLoaded(_) => nothing(f64::NAN),
                Answer::Known(None) => nothing(f64::INFINITY),
                Answer::Known(Some(found)) => {
                    let ([px, py, pz], [gx, gy, gz]): ([f64; 3], [f64; 3]) =
                        (found.point.into(), found.gradient.into());
                    [found.distance, px, py, pz, gx, gy, gz]
                }
            })
        })
    })
}
