//! Where a body touches: round columns from all sides, and doors that just fit.

use super::lab::{Converted, Scan, Setting, Vec3};
use super::planes::PIXEL_M;
use super::plot::{Line, Plot};
use super::table::{Errors, Table, number};
use super::{Effort, Outcome, Result};
use crate::Random;
use nalgebra::{Point3, Vector3};
use slicewalk::plan::Classifier;
use slicewalk::query::{Aabb, Cylinder, Overlap, overlaps};
use std::f64::consts::TAU;

/// Half width of the bodies (m).
const HALF_M: f64 = 0.25;
/// Heights between which bodies stand; walls and columns reach beyond both.
const FEET_M: f64 = 0.1;
const TALL_M: f64 = 0.2;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Body {
    Cylinder,
    Box,
}

impl Body {
    const ALL: [Self; 2] = [Self::Cylinder, Self::Box];

    fn name(self) -> &'static str {
        match self {
            Self::Cylinder => "cylinder of 25 cm radius",
            Self::Box => "box of 50 cm",
        }
    }

    fn hits(self, scan: &Converted, x: f64, y: f64) -> bool {
        let feet = Point3::new(x, y, FEET_M);
        let answer = match self {
            Self::Cylinder => overlaps(&scan.store, &Cylinder::new(feet, HALF_M, TALL_M).expect("finite")),
            Self::Box => {
                let size = Vector3::new(2.0 * HALF_M, 2.0 * HALF_M, TALL_M);
                overlaps(&scan.store, &Aabb::standing(feet, size).expect("finite"))
            }
        };
        answer == Overlap::Hit
    }

    /// Gap between the body at (x, y) and a round column of radius `r` about the origin (m).
    fn gap(self, x: f64, y: f64, r: f64) -> f64 {
        match self {
            Self::Cylinder => x.hypot(y) - HALF_M - r,
            Self::Box => {
                let beyond = |v: f64| (v.abs() - HALF_M).max(0.0);
                beyond(x).hypot(beyond(y)) - r
            }
        }
    }
}

/// First distance on the way in along a direction at which `touches` holds (m).
fn contact(far: f64, touches: impl Fn(f64) -> bool) -> f64 {
    let step = PIXEL_M / 16.0;
    let mut out = far;
    while out > 0.0 && !touches(out - step) {
        out -= step;
    }
    let mut inside = out - step;
    for _ in 0..20 {
        let middle = (out + inside) / 2.0;
        *(if touches(middle) { &mut inside } else { &mut out }) = middle;
    }
    out
}

/// Round columns of 1 to 20 pixels radius, approached from all sides.
pub fn round(effort: Effort) -> Result<Outcome> {
    let radii: Vec<i64> = (1..=20).step_by(effort.of(1, 7)).collect();
    let (copies, ways) = (effort.of(4, 1), effort.of(96, 24));
    let pitch = 80.0 * PIXEL_M;
    let mut random = Random(12);
    let (mut points, mut middles) = (Vec::new(), Vec::new());
    for (n, &radius) in radii.iter().enumerate() {
        for copy in 0..copies {
            let at = |number: usize, random: &mut Random| (number as f64 + 0.5) * pitch + random.between(0.0, PIXEL_M);
            let middle = [at(n, &mut random), at(copy, &mut random)];
            let r = radius as f64 * PIXEL_M;
            let count = (TAU * radius as f64 * 8.0 * 25.0) as usize;
            for _ in 0..count {
                let turn = random.between(0.0, TAU);
                let z = random.between(0.0, 8.0 * PIXEL_M);
                points.push([middle[0] + r * turn.cos(), middle[1] + r * turn.sin(), z]);
            }
            middles.push(middle);
        }
    }
    let scan = Scan::new(points)?.convert(Setting::new(PIXEL_M), Classifier::Plane)?;
    let mut csv =
        Table::new(["radius_pixels", "body", "mean_pixels", "least_pixels", "greatest_pixels", "anisotropy_pixels"]);
    let mut profile_csv = Table::new(["direction_deg", "cylinder_pixels", "box_pixels"]);
    let mut lines = [Vec::new(), Vec::new()];
    let mut profiles = [Vec::new(), Vec::new()];
    let mut all = [Errors::default(), Errors::default()];
    for (n, &radius) in radii.iter().enumerate() {
        let r = radius as f64 * PIXEL_M;
        for (b, body) in Body::ALL.into_iter().enumerate() {
            let (mut errors, mut anisotropy) = (Errors::default(), 0.0f64);
            for copy in 0..copies {
                let middle = middles[n * copies + copy];
                let mut own = Errors::default();
                for way in 0..ways {
                    let (s, c) = (way as f64 / ways as f64 * TAU).sin_cos();
                    let far = r + 2.0 * HALF_M + 6.0 * PIXEL_M;
                    let found = contact(far, |d| body.hits(&scan, middle[0] + d * c, middle[1] + d * s));
                    let truth = contact(far, |d| body.gap(d * c, d * s, r) <= 0.0);
                    own.0.push((found - truth) / PIXEL_M);
                    if radius == 8 && copy == 0 {
                        profiles[b].push((way as f64 * 360.0 / ways as f64, (found - truth) / PIXEL_M));
                    }
                }
                let ends = own.0.iter().fold([f64::MAX, f64::MIN], |[a, b], &v| [a.min(v), b.max(v)]);
                anisotropy = anisotropy.max(ends[1] - ends[0]);
                errors.0.extend(own.0);
            }
            let ends = errors.0.iter().fold([f64::MAX, f64::MIN], |[a, b], &v| [a.min(v), b.max(v)]);
            let cells = [errors.mean(), ends[0], ends[1], anisotropy].map(|v| number(v, 3));
            csv.row([radius.to_string(), body.name().into()].into_iter().chain(cells));
            lines[b].push((radius as f64, anisotropy));
            all[b].0.extend(errors.0);
        }
    }
    for (a, b) in profiles[0].iter().zip(&profiles[1]) {
        profile_csv.row([number(a.0, 2), number(a.1, 3), number(b.1, 3)]);
    }
    let mut outcome = Outcome { tables: vec![("round", csv), ("round-profile", profile_csv)], ..Outcome::default() };
    for (body, errors) in ["cylinder", "box"].into_iter().zip(&all) {
        let ends = errors.0.iter().fold([f64::MAX, f64::MIN], |[a, b], &v| [a.min(v), b.max(v)]);
        outcome.fact(format!("round-{body}-mean"), number(errors.mean(), 2));
        outcome.fact(format!("round-{body}-least"), number(ends[0], 2));
        outcome.fact(format!("round-{body}-most"), number(ends[1], 2));
    }
    outcome.plots.push(Plot {
        name: "round",
        title: "Where a body touches a round column of 8 pixels radius too early, by direction".into(),
        x: "direction from which it comes (degrees)",
        y: "contact before the true one (pixels)",
        log_x: false,
        y_range: (0.0, 1.5),
        marks: vec![],
        lines: Body::ALL
            .into_iter()
            .zip(profiles)
            .enumerate()
            .map(|(n, (b, l))| Line::new(b.name(), 4 + n, l))
            .collect(),
    });
    outcome.plots.push(Plot {
        name: "round-anisotropy",
        title: "Latest minus earliest contact around a round column (the worst of four places)".into(),
        x: "radius of the column (pixels)",
        y: "anisotropy (pixels)",
        log_x: false,
        y_range: (0.0, 1.5),
        marks: vec![],
        lines: Body::ALL.into_iter().zip(lines).enumerate().map(|(n, (b, l))| Line::new(b.name(), 4 + n, l)).collect(),
    });
    Ok(outcome)
}

/// Doors in a sheet of wall, in quarter pixels wider than a body: which is the least that lets it through?
pub fn doors(effort: Effort) -> Result<Outcome> {
    let (turns, phases) = effort.of((7, 16), (3, 4));
    let extras: Vec<f64> = (-1..=16).map(|n| f64::from(n) * 0.25).collect();
    let pitch = 48.0 * PIXEL_M;
    let per_row = 64;
    let mut random = Random(71);
    let mut points: Vec<Vec3> = Vec::new();
    let mut sites = Vec::new();
    for body in Body::ALL {
        for turn in 0..turns {
            let angle = (turn as f64 * 90.0 / (turns - 1) as f64).to_radians();
            // A box does not turn with the door.
            let (s, c) = angle.sin_cos();
            let need = if body == Body::Box { 2.0 * HALF_M * (s.abs() + c.abs()) } else { 2.0 * HALF_M };
            for phase in 0..phases {
                for &extra in &extras {
                    let n = sites.len();
                    let shift = phase as f64 / phases as f64 * PIXEL_M;
                    let at = |index: usize| (index as f64 + 0.5) * pitch;
                    // The shift along the wall, so that the jambs move over the pixels.
                    let middle = [at(n % per_row) - s * shift, at(n / per_row) + c * shift];
                    let width = need + extra * PIXEL_M;
                    for _ in 0..(2 * 8 * 8 * 10) {
                        let side = if random.bits() & 1 == 1 { 1.0 } else { -1.0 };
                        let along = side * (width / 2.0 + random.between(0.0, 8.0 * PIXEL_M));
                        let z = random.between(0.0, 8.0 * PIXEL_M);
                        points.push([middle[0] - s * along, middle[1] + c * along, z]);
                    }
                    // The jambs' own edges are points too.
                    for (side, k) in [-1.0, 1.0].into_iter().flat_map(|side| (0..8).map(move |k| (side, k))) {
                        let along = side * width / 2.0;
                        points.push([middle[0] - s * along, middle[1] + c * along, f64::from(k) * PIXEL_M]);
                    }
                    sites.push(middle);
                }
            }
        }
    }
    let scan = Scan::new(points)?.convert(Setting::new(PIXEL_M), Classifier::Plane)?;
    let mut csv = Table::new(["body", "angle_deg", "phase_of_pixel", "excess_pixels"]);
    let mut outcome = Outcome::default();
    let mut lines = Vec::new();
    let mut number_of = 0;
    for body in Body::ALL {
        let mut all = Errors::default();
        let mut line = Vec::new();
        for turn in 0..turns {
            let degrees = turn as f64 * 90.0 / (turns - 1) as f64;
            let (s, c) = degrees.to_radians().sin_cos();
            let mut worst = 0.0f64;
            for phase in 0..phases {
                let mut least = None;
                for &extra in &extras {
                    let [x, y] = sites[number_of];
                    number_of += 1;
                    let steps = 64;
                    let clear = (-steps..=steps).all(|k| {
                        let along = f64::from(k) / f64::from(steps) * 0.5;
                        !body.hits(&scan, x + c * along, y + s * along)
                    });
                    least = match (least, clear) {
                        (None, true) => Some(extra),
                        (known, true) => known,
                        (_, false) => None,
                    };
                }
                let excess = least.unwrap_or(f64::INFINITY);
                worst = worst.max(excess);
                all.0.push(excess);
                csv.row([
                    body.name().into(),
                    number(degrees, 0),
                    number(phase as f64 / phases as f64, 4),
                    number(excess, 2),
                ]);
            }
            line.push((degrees, worst));
        }
        let key = if body == Body::Box { "box" } else { "cylinder" };
        outcome.fact(format!("door-{key}-mean"), number(all.mean(), 2));
        outcome.fact(format!("door-{key}-worst"), number(all.quantile(1.0), 2));
        lines.push(Line::new(body.name(), if body == Body::Box { 5 } else { 4 }, line));
    }
    outcome.tables.push(("doors", csv));
    outcome.plots.push(Plot {
        name: "doors",
        title: "How much wider than the body a door must be, at the worst of 16 grid phases".into(),
        x: "heading of the way through (degrees)",
        y: "excess width needed (pixels)",
        log_x: false,
        y_range: (0.0, 3.0),
        marks: vec![],
        lines,
    });
    Ok(outcome)
}
