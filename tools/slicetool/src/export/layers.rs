//! Layers of a GeoTIFF: figures of the floor in each pixel, as elevation maps of robots have them.
//!
//! The floor of a pixel is its highest one, or the highest up to `--z`. Slope and roughness follow from the
//! least-squares plane through the floors of the 3 × 3 pixels around, as far as they lie within the climb height of the
//! middle one; without three of them that are not in a line there are none.

use crate::Failure;
use crate::ground::{Loader, Pawns};
use nalgebra::Point3;
use slicewalk::frame::Frame;
use slicewalk::query::{Answer, Cylinder, Overlap, overlaps};
use slicewalk::reach::Pawn;
use slicewalk::walk::Body;
use std::path::Path;

/// A figure of the floor in a pixel.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Layer {
    /// Height of the floor (m)
    Height,
    /// Slope of the floor (degrees)
    Slope,
    /// Standard deviation of the floor's heights from a plane over 3 × 3 pixels (m)
    Roughness,
    /// Free height above the floor (m), infinite under the open sky
    Headroom,
    /// Distance from the middle of the pixel to what the pawn can neither climb nor pass under (m), at most 2
    Clearance,
}

impl Layer {
    /// Name of the band.
    pub fn name(self) -> &'static str {
        match self {
            Self::Height => "height",
            Self::Slope => "slope",
            Self::Roughness => "roughness",
            Self::Headroom => "headroom",
            Self::Clearance => "clearance",
        }
    }
}

/// Greatest clearance (m), and how exactly it is found.
const WIDEST_M: f64 = 2.0;
const WIDTH_STEP_M: f64 = 1e-3;
/// Least height of a body above the climb height (m).
const LEAST_BODY_M: f64 = 0.05;

/// Floor of a pixel (quanta).
#[derive(Clone, Copy)]
pub struct Floor {
    pub top: i64,
    /// Bottom of the next span above.
    pub ceiling: Option<i64>,
}

/// Computes layers from floors and pages.
pub struct Figures {
    frame: Frame,
    pawn: Pawn,
    /// Pages, if a layer needs more than the floors around.
    loader: Option<Loader>,
}

impl Figures {
    /// Prepares these layers of the archive at `path`.
    pub fn new(layers: &[Layer], pawns: &Pawns, path: &Path, frame: Frame) -> Result<Self, Failure> {
        let needs_pages = layers.contains(&Layer::Clearance);
        let loader = needs_pages.then(|| Loader::new(pawns.open(path)?, path, pawns.cache())).transpose()?;
        Ok(Self { frame, pawn: pawns.pawn(), loader })
    }

    /// Computes a layer for the floor in the middle of `around`, which has its place at `middle`: 3 × 3 floors, rows from
    /// the north, columns from the west.
    pub fn of(
        &self,
        layer: Layer,
        floor: Floor,
        around: &[[Option<Floor>; 3]; 3],
        middle: [f64; 2],
    ) -> Result<f64, Failure> {
        Ok(match layer {
            Layer::Height => self.frame.top_height(floor.top),
            Layer::Slope => self.plane(floor, around).map_or(f64::NAN, |(slope, _)| slope),
            Layer::Roughness => self.plane(floor, around).map_or(f64::NAN, |(_, roughness)| roughness),
            Layer::Headroom => floor
                .ceiling
                .map_or(f64::INFINITY, |ceiling| self.frame.bottom_height(ceiling) - self.frame.top_height(floor.top)),
            Layer::Clearance => self.clearance(floor, middle)?,
        })
    }

    /// Slope (degrees) and roughness (m) of the floor.
    fn plane(&self, floor: Floor, around: &[[Option<Floor>; 3]; 3]) -> Option<(f64, f64)> {
        let quantum = self.frame.quantum_m();
        let near = |other: &Floor| (other.top - floor.top).abs() as f64 * quantum <= self.pawn.climb;
        let offsets = [-1.0, 0.0, 1.0];
        let mut points = Vec::with_capacity(9);
        for (y, row) in offsets.into_iter().rev().zip(around) {
            for (x, other) in offsets.into_iter().zip(row) {
                points.extend(other.filter(near).map(|other| [x, y, (other.top - floor.top) as f64]));
            }
        }
        // Sums of small whole numbers are exact, so a line of points has a determinant of exactly zero.
        let count = points.len() as f64;
        let sum = |of: &dyn Fn(&[f64; 3]) -> f64| points.iter().map(of).sum::<f64>();
        let [x, y, z] = [0, 1, 2].map(|axis| sum(&|point| point[axis]));
        let moment = |a: usize, b: usize| count * sum(&|point| point[a] * point[b]) - [x, y, z][a] * [x, y, z][b];
        let (xx, xy, yy, xz, yz) = (moment(0, 0), moment(0, 1), moment(1, 1), moment(0, 2), moment(1, 2));
        let determinant = xx * yy - xy * xy;
        if determinant <= 0.0 {
            return None;
        }
        let (gx, gy) = ((xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant);
        let level = (z - gx * x - gy * y) / count;
        let squares = sum(&|point| (point[2] - gx * point[0] - gy * point[1] - level).powi(2));
        let rise = (gx * gx + gy * gy).sqrt() * quantum / self.frame.pixel_m();
        Some((libm::atan(rise).to_degrees(), (squares / count).sqrt() * quantum))
    }

    /// Distance to solid between the climb height and the top of the pawn (m).
    fn clearance(&self, floor: Floor, [x, y]: [f64; 2]) -> Result<f64, Failure> {
        let Some(loader) = &self.loader else { return Ok(f64::NAN) };
        let height = match self.pawn.body {
            Body::Box { height, .. } | Body::Cylinder { height, .. } => height,
        };
        let feet = Point3::new(x, y, self.frame.top_height(floor.top) + self.pawn.climb);
        let body = (height - self.pawn.climb).max(LEAST_BODY_M);
        let is_free = |radius: f64| {
            loader.known(|view| {
                Ok(match overlaps(view, &Cylinder::new(feet, radius, body)?) {
                    Overlap::NotLoaded(missing) => Answer::NotLoaded(missing),
                    overlap => Answer::Known(overlap == Overlap::Clear),
                })
            })
        };
        if is_free(WIDEST_M)? {
            return Ok(WIDEST_M);
        }
        let (mut free, mut hit) = (0.0, WIDEST_M);
        while hit - free > WIDTH_STEP_M {
            let middle = 0.5 * (free + hit);
            *if is_free(middle)? { &mut free } else { &mut hit } = middle;
        }
        Ok(free)
    }
}
