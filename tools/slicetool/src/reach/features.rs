//! Steps and ramps of a region, found from its places alone.

use super::Reach;
use crate::outline::Area;
use nalgebra::Point3;
use slicewalk::frame::Frame;
use std::collections::HashMap;

/// Lower ones are no steps (m), as for storeys. With coarse pixels it is the pixel size, because ramps rise as much.
const LEAST_STEP_M: f64 = 0.06;
/// Narrower steps are left out: single things on the ground (m).
const LEAST_WIDTH_M: f64 = 0.3;
/// Edges of one step differ by no more than this in the height of the lower place (m).
const SAME_M: f64 = 0.03;
/// Ground steeper than 1:20 is a ramp (ADA Standards for Accessible Design 2010, 403.3).
const RAMP: f64 = 0.05;
/// Least area (m²) and rise (m) of a ramp.
const LEAST_RAMP_M2: f64 = 1.0;
const LEAST_RISE_M: f64 = 0.1;

/// The edge of a step, across which the ground rises at once.
pub struct StepEdge {
    /// Middle of the edge, at the height of the lower side (m).
    pub at: Point3<f64>,
    /// Median height, and greatest extent along x or y (m).
    pub height: f64,
    pub width: f64,
}

/// Ground that rises steadily.
pub struct Ramp {
    pub area: Area,
    pub area_m2: f64,
    /// Median height (m), median grade (rise over run) and rise (m).
    pub z: f64,
    pub grade: f64,
    pub rise: f64,
}

/// The places by pixel.
pub struct Ground<'a> {
    frame: &'a Frame,
    feet: Vec<Point3<f64>>,
    grades: Vec<f64>,
    pixels: Vec<[i64; 2]>,
    by_pixel: HashMap<[i64; 2], Vec<u32>>,
    /// Highest step of the pawn, and greatest rise to a neighbouring place of the same level (m).
    climb: f64,
    level: f64,
}

impl<'a> Ground<'a> {
    pub fn new(reach: &Reach, frame: &'a Frame) -> Self {
        let feet: Vec<Point3<f64>> = reach.region.places().map(|place| place.feet).collect();
        let pixels: Vec<[i64; 2]> = feet.iter().map(|at| [frame.pixel_of(at.x), frame.pixel_of(at.y)]).collect();
        let mut by_pixel: HashMap<[i64; 2], Vec<u32>> = HashMap::with_capacity(feet.len());
        for (pixel, number) in pixels.iter().zip(0..) {
            by_pixel.entry(*pixel).or_default().push(number);
        }
        // Floors are rounded to quanta, so a step of exactly the climb height may be higher.
        let climb = reach.region.pawn().climb + 2.0 * frame.quantum_m();
        Self {
            frame,
            feet,
            grades: reach.region.grades(),
            pixels,
            by_pixel,
            climb,
            level: LEAST_STEP_M.max(1.01 * frame.pixel_m()),
        }
    }

    fn z(&self, place: u32) -> f64 {
        self.feet[place as usize].z
    }

    /// Returns the place beside `place`, at most `most` higher or lower; of several the one nearest in height.
    fn beside(&self, place: u32, [x, y]: [i64; 2], most: f64) -> Option<u32> {
        let [i, j] = self.pixels[place as usize];
        let far = |other: &u32| (self.z(*other) - self.z(place)).abs();
        let others = self.by_pixel.get(&[i + x, j + y])?.iter().copied();
        others.filter(|other| far(other) <= most).min_by(|a, b| far(a).total_cmp(&far(b)))
    }

    /// Returns the steps, by height of their lower side.
    pub fn steps(&self) -> Vec<StepEdge> {
        // Edges as pairs of the lower and the upper place.
        let mut edges: Vec<[u32; 2]> = Vec::new();
        for place in 0..self.feet.len() as u32 {
            for way in [[1, 0], [0, 1]] {
                let Some(other) = self.beside(place, way, self.climb) else { continue };
                if (self.z(other) - self.z(place)).abs() > self.level {
                    edges.push(if self.z(place) < self.z(other) { [place, other] } else { [other, place] });
                }
            }
        }
        edges.sort_by(|a, b| self.z(a[0]).total_cmp(&self.z(b[0])).then(a.cmp(b)));
        let mut at_pixel: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
        for (number, [lower, _]) in edges.iter().enumerate() {
            at_pixel.entry(self.pixels[*lower as usize]).or_default().push(number);
        }
        let is_same = |a: usize, b: usize| {
            let far = |side: usize| (self.z(edges[a][side]) - self.z(edges[b][side])).abs();
            far(0) <= SAME_M && far(1) <= SAME_M
        };
        let mut taken = vec![false; edges.len()];
        let mut steps = Vec::new();
        for first in 0..edges.len() {
            if std::mem::replace(&mut taken[first], true) {
                continue;
            }
            let (mut members, mut next) = (vec![first], 0);
            while let Some(&edge) = members.get(next) {
                next += 1;
                let [i, j] = self.pixels[edges[edge][0] as usize];
                for (x, y) in (-1..=1).flat_map(|y| (-1..=1).map(move |x| (x, y))) {
                    for &other in at_pixel.get(&[i + x, j + y]).map_or(&[][..], |all| all) {
                        if is_same(edge, other) && !std::mem::replace(&mut taken[other], true) {
                            members.push(other);
                        }
                    }
                }
            }
            let step = self.step(members.iter().map(|edge| edges[*edge]).collect());
            steps.extend(step.filter(|step| step.width >= LEAST_WIDTH_M));
        }
        steps
    }

    fn step(&self, edges: Vec<[u32; 2]>) -> Option<StepEdge> {
        let mut heights: Vec<f64> = edges.iter().map(|[lower, upper]| self.z(*upper) - self.z(*lower)).collect();
        heights.sort_by(f64::total_cmp);
        let (mut low, mut high, mut sum) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2], [0.0; 2]);
        for [lower, _] in &edges {
            let at = self.feet[*lower as usize];
            for (axis, value) in [at.x, at.y].into_iter().enumerate() {
                (low[axis], high[axis]) = (low[axis].min(value), high[axis].max(value));
                sum[axis] += value / edges.len() as f64;
            }
        }
        let far = |at: &Point3<f64>| (at.x - sum[0]).hypot(at.y - sum[1]);
        let lower = edges.iter().map(|[lower, _]| self.feet[*lower as usize]);
        let at = lower.min_by(|a, b| far(a).total_cmp(&far(b)))?;
        let width = (high[0] - low[0]).max(high[1] - low[1]) + self.frame.pixel_m();
        Some(StepEdge { at, height: heights[heights.len() / 2], width })
    }

    /// Returns the ramps, by the number of their first place.
    pub fn ramps(&self) -> Vec<Ramp> {
        let grades = &self.grades;
        let mut taken: Vec<bool> = grades.iter().map(|grade| *grade <= RAMP).collect();
        let mut ramps = Vec::new();
        for first in 0..self.feet.len() as u32 {
            if std::mem::replace(&mut taken[first as usize], true) {
                continue;
            }
            let (mut members, mut next) = (vec![first], 0);
            while let Some(&place) = members.get(next) {
                next += 1;
                for way in [[1, 0], [0, 1], [-1, 0], [0, -1]] {
                    if let Some(other) = self.beside(place, way, self.level)
                        && !std::mem::replace(&mut taken[other as usize], true)
                    {
                        members.push(other);
                    }
                }
            }
            let median = |value: &dyn Fn(u32) -> f64| {
                let mut values: Vec<f64> = members.iter().map(|place| value(*place)).collect();
                values.sort_by(f64::total_cmp);
                (values[values.len() / 2], values[values.len() - 1] - values[0])
            };
            let ((z, rise), (grade, _)) = (median(&|place| self.z(place)), median(&|place| grades[place as usize]));
            let area_m2 = members.len() as f64 * self.frame.pixel_m().powi(2);
            if area_m2 >= LEAST_RAMP_M2 && rise >= LEAST_RISE_M {
                let mut area = Area::default();
                members.iter().for_each(|place| area.insert(self.pixels[*place as usize].into()));
                ramps.push(Ramp { area, area_m2, z, grade, rise });
            }
        }
        ramps
    }
}
