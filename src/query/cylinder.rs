//! Upright cylinders.

use super::disc::Disc;
use super::grid::sealed::{OnGrid, OnPixels};
use super::grid::{Heights, Rect, all_within_reach};
use crate::frame::Frame;
use crate::text::{number, place};
use crate::{Error, Result};
use nalgebra::Point3;

/// A closed upright cylinder in world coordinates (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cylinder {
    feet: Point3<f64>,
    radius: f64,
    height: f64,
}

impl Cylinder {
    /// Creates the cylinder of `radius` (m, >= 0) that stands on `feet` (the middle of its bottom face) and is `height`
    /// (m, >= 0) tall. Fails on NaN and on values beyond ±10¹⁰⁰ m.
    pub fn new(feet: Point3<f64>, radius: f64, height: f64) -> Result<Self> {
        if all_within_reach(feet.iter().chain([&radius, &height])) && radius >= 0.0 && height >= 0.0 {
            Ok(Self { feet, radius, height })
        } else {
            let reason = format!(
                "no cylinder at {} has radius {} and height {} (all within ±1e100 m)",
                place(feet.into()),
                number(radius),
                number(height)
            );
            Err(Error::parameter("cylinder", reason))
        }
    }

    /// Returns the middle of the bottom face (m).
    pub fn feet(&self) -> Point3<f64> {
        self.feet
    }

    /// Returns the radius (m).
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Returns the height (m).
    pub fn height(&self) -> f64 {
        self.height
    }
}

impl OnGrid for Cylinder {
    type Grid = GridCylinder;

    #[inline]
    fn on_grid(&self, frame: &Frame) -> GridCylinder {
        GridCylinder {
            disc: Disc::new(frame, self.feet.x, self.feet.y, self.radius),
            heights: Heights::of(frame, self.feet.z, self.feet.z + self.height),
        }
    }
}

/// A cylinder on the grid.
#[derive(Debug, Clone, Copy)]
pub struct GridCylinder {
    disc: Disc,
    heights: Heights,
}

impl OnPixels for GridCylinder {
    const UPRIGHT: bool = true;

    #[inline]
    fn rect(&self) -> Rect {
        self.disc.rect()
    }

    #[inline]
    fn heights(&self) -> Heights {
        self.heights
    }

    #[inline]
    fn holds(&self, i: i64, j: i64) -> bool {
        self.disc.holds(i, j)
    }

    #[inline]
    fn mask(&self, i: i64, j: i64) -> u64 {
        self.disc.mask(i, j)
    }
}
