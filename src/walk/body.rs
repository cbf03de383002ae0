//! The shape of a pawn.

use crate::query::{
    Aabb, Answer, Cylinder, SweepHit, depenetrate, floor_under, mean_floor_under, probe, sweep, top_under,
};
use crate::store::Snapshot;
use crate::{Error, Parameter, Result};
use nalgebra::{Point3, Vector2, Vector3};
use std::str::FromStr;

/// Limit of the size of a body (m), and of the speeds (m/s) and the gravity (m/s²) of a [`Config`](super::Config). It
/// bounds the work of a tick.
pub(super) const MOST: f64 = 1000.0;

/// The shape of a pawn (m), standing on the middle of its bottom face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Body {
    /// A box along the axes.
    Box {
        /// Width along x (m, above 0, at most 1,000).
        x: f64,
        /// Width along y (m, above 0, at most 1,000).
        y: f64,
        /// Height (m, above 0, at most 1,000).
        height: f64,
    },
    /// An upright cylinder.
    Cylinder {
        /// Radius (m, above 0, at most 500).
        radius: f64,
        /// Height (m, above 0, at most 1,000).
        height: f64,
    },
}

/// Parses the form of the command line: `box:WIDTHxDEPTHxHEIGHT` or `cylinder:RADIUSxHEIGHT` (m, above 0).
impl FromStr for Body {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = || "expected box:0.5x0.5x1.8 or cylinder:0.25x1.8 (m, above 0)".to_owned();
        let (kind, sizes) = text.split_once(':').ok_or_else(wrong)?;
        let sizes: Option<Vec<f64>> = sizes.split('x').map(|v| v.trim().parse().ok()).collect();
        let body = match (kind, sizes.as_deref()) {
            ("box", Some(&[x, y, height])) => Self::Box { x, y, height },
            ("cylinder", Some(&[radius, height])) => Self::Cylinder { radius, height },
            _ => return Err(wrong()),
        };
        body.check().map(|()| body).map_err(|_| wrong())
    }
}

/// The part of a body between a height above its feet and its head.
#[derive(Debug, Clone, Copy)]
enum Part {
    Box(Aabb),
    Cylinder(Cylinder),
}

/// Runs a query with the shape of a part.
macro_rules! ask {
    ($part:expr, $shape:ident => $query:expr) => {
        match $part {
            Part::Box($shape) => $query,
            Part::Cylinder($shape) => $query,
        }
    };
}

impl Body {
    /// Height (m).
    pub fn height(&self) -> f64 {
        match *self {
            Self::Box { height, .. } | Self::Cylinder { height, .. } => height,
        }
    }

    /// Half of the width along x and y (m).
    pub fn half(&self) -> Vector2<f64> {
        match *self {
            Self::Box { x, y, .. } => Vector2::new(x, y) / 2.0,
            Self::Cylinder { radius, .. } => Vector2::repeat(radius),
        }
    }

    /// Area of its bottom face (m²).
    pub(super) fn area(&self) -> f64 {
        match *self {
            Self::Box { x, y, .. } => x * y,
            Self::Cylinder { radius, .. } => std::f64::consts::PI * radius * radius,
        }
    }

    /// Fails if a dimension is not above 0 or exceeds [`MOST`].
    pub(crate) fn check(&self) -> Result<()> {
        let size = 2.0 * self.half();
        for (what, length) in [("pawn's width", size.x), ("pawn's width", size.y), ("pawn's height", self.height())] {
            if !(length > 0.0 && length <= MOST) {
                let reason = format!("{length} m (expected more than 0, at most {MOST} m)");
                return Err(Error::parameter(Parameter::Pawn(what), reason));
            }
        }
        Ok(())
    }

    fn part(&self, feet: Point3<f64>, lift: f64) -> Part {
        let feet = feet + Vector3::new(0.0, 0.0, lift);
        // `Walker::new` has checked the sizes, and a pawn never leaves the range of valid places.
        match *self {
            Self::Box { x, y, height } => {
                Part::Box(Aabb::standing(feet, Vector3::new(x, y, height - lift)).expect("a finite box"))
            }
            Self::Cylinder { radius, height } => {
                Part::Cylinder(Cylinder::new(feet, radius, height - lift).expect("a finite cylinder"))
            }
        }
    }

    pub(super) fn sweep(&self, set: &Snapshot, feet: Point3<f64>, by: Vector3<f64>) -> Answer<Option<SweepHit>> {
        ask!(self.part(feet, 0.0), shape => sweep(set, &shape, by))
    }

    pub(super) fn top(&self, set: &Snapshot, feet: Point3<f64>, from: f64, depth: f64) -> Answer<Option<f64>> {
        ask!(self.part(feet, 0.0), shape => top_under(set, &shape, from, depth))
    }

    pub(super) fn floor(&self, set: &Snapshot, feet: Point3<f64>, from: f64, depth: f64) -> Answer<Option<f64>> {
        ask!(self.part(feet, 0.0), shape => floor_under(set, &shape, from, depth))
    }

    pub(super) fn mean_floor(&self, set: &Snapshot, feet: Point3<f64>, from: f64, depth: f64) -> Answer<Option<f64>> {
        ask!(self.part(feet, 0.0), shape => mean_floor_under(set, &shape, from, depth))
    }

    /// Returns the highest floor under the bounds of the footprint, grown by `margin` (m).
    pub(super) fn floor_around(
        &self,
        set: &Snapshot,
        feet: Point3<f64>,
        margin: f64,
        from: f64,
        depth: f64,
    ) -> Answer<Option<f64>> {
        let half = self.half().add_scalar(margin).push(0.0);
        let shape = Aabb::new(feet - half, feet + half).expect("a finite box");
        floor_under(set, &shape, from, depth)
    }

    /// Returns whether an obstacle touches the body above `lift`.
    pub(super) fn obstructed(&self, set: &Snapshot, feet: Point3<f64>, lift: f64) -> Answer<bool> {
        match ask!(self.part(feet, lift), shape => probe(set, &shape)) {
            Answer::Known(probe) => Answer::Known(probe.obstacle),
            Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
        }
    }

    pub(super) fn escape(&self, set: &Snapshot, feet: Point3<f64>, max: f64) -> Answer<Option<Vector3<f64>>> {
        ask!(self.part(feet, 0.0), shape => depenetrate(set, &shape, max))
    }
}
