//! Spheres.

use super::disc::{Disc, lower, upper};
use super::grid::sealed::{OnGrid, OnPixels};
use super::grid::{Heights, Rect, all_within_reach};
use crate::frame::Frame;
use crate::text::{number, place};
use crate::{Error, Result};
use nalgebra::Point3;

/// A closed ball in world coordinates (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    center: Point3<f64>,
    radius: f64,
}

impl Sphere {
    /// Creates the ball of `radius` (m, >= 0) around `center`. Fails on NaN and on values beyond ±10¹⁰⁰ m.
    pub fn new(center: Point3<f64>, radius: f64) -> Result<Self> {
        if all_within_reach(center.iter().chain([&radius])) && radius >= 0.0 {
            Ok(Self { center, radius })
        } else {
            Err(Error::parameter(
                "sphere",
                format!("no sphere at {} has radius {} (all within ±1e100 m)", place(center.into()), number(radius)),
            ))
        }
    }

    /// Returns the middle (m).
    pub fn center(&self) -> Point3<f64> {
        self.center
    }

    /// Returns the radius (m).
    pub fn radius(&self) -> f64 {
        self.radius
    }
}

impl OnGrid for Sphere {
    type Grid = GridSphere;

    #[inline]
    fn on_grid(&self, frame: &Frame) -> GridSphere {
        let disc = Disc::new(frame, self.center.x, self.center.y, self.radius);
        GridSphere { disc, frame: *frame, z: self.center.z }
    }
}

/// A sphere on the grid.
#[derive(Debug, Clone, Copy)]
pub struct GridSphere {
    disc: Disc,
    frame: Frame,
    z: f64,
}

impl GridSphere {
    #[inline]
    fn heights_within(&self, half: f64) -> Heights {
        Heights::of(&self.frame, lower(self.z - half), upper(self.z + half))
    }
}

impl OnPixels for GridSphere {
    const UPRIGHT: bool = false;

    #[inline]
    fn rect(&self) -> Rect {
        self.disc.rect()
    }

    #[inline]
    fn heights(&self) -> Heights {
        self.heights_within(self.disc.radius())
    }

    #[inline]
    fn holds(&self, i: i64, j: i64) -> bool {
        self.disc.holds(i, j)
    }

    #[inline]
    fn mask(&self, i: i64, j: i64) -> u64 {
        self.disc.mask(i, j)
    }

    #[inline]
    fn heights_over(&self, i: i64, j: i64, edge: i64) -> Heights {
        // A square that the disc just touches may seem to lie outside by an ulp; it counts as touched.
        self.heights_within(self.disc.half_chord(self.disc.distance_to(i, j, edge)).unwrap_or(0.0))
    }
}
