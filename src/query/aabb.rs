//! Axis-aligned boxes.

use super::grid::sealed::{OnGrid, OnPixels};
use super::grid::{Heights, Rect};
use crate::frame::Frame;
use crate::text::place;
use crate::{Error, Result};
use nalgebra::{Point3, Vector3};

/// A closed axis-aligned box in world coordinates (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    min: Point3<f64>,
    max: Point3<f64>,
}

impl Aabb {
    /// Creates the box from `min` to `max`, both inclusive (m). A minimum of -∞ and a maximum of ∞ are allowed, and
    /// every query answers them exactly. Fails on a NaN, a minimum above its maximum, and a box that lies at infinity.
    pub fn new(min: Point3<f64>, max: Point3<f64>) -> Result<Self> {
        // Written so that NaN fails.
        let spans = |axis: usize| min[axis] <= max[axis] && min[axis] < f64::INFINITY && max[axis] > f64::NEG_INFINITY;
        if (0..3).all(spans) {
            Ok(Self { min, max })
        } else {
            Err(Error::parameter("box", format!("no box lies between {} and {}", place(min.into()), place(max.into()))))
        }
    }

    /// Creates the box between corners that are known to be in order and free of NaN.
    pub(crate) fn between(min: Point3<f64>, max: Point3<f64>) -> Self {
        debug_assert!((0..3).all(|axis| min[axis] <= max[axis]));
        Self { min, max }
    }

    /// Creates a box of `size` (m, >= 0) with `feet` in the middle of its bottom face: the pawn of the thesis. Fails
    /// like [`new`](Self::new).
    pub fn standing(feet: Point3<f64>, size: Vector3<f64>) -> Result<Self> {
        let half = Vector3::new(size.x / 2.0, size.y / 2.0, 0.0);
        Self::new(feet - half, feet + half + Vector3::new(0.0, 0.0, size.z))
    }

    /// Returns the lower corner (m).
    pub fn min(&self) -> Point3<f64> {
        self.min
    }

    /// Returns the upper corner (m).
    pub fn max(&self) -> Point3<f64> {
        self.max
    }
}

impl OnGrid for Aabb {
    type Grid = GridBox;

    #[inline]
    fn on_grid(&self, frame: &Frame) -> GridBox {
        GridBox {
            rect: Rect {
                i0: frame.pixel_of(self.min.x),
                i1: frame.pixel_of(self.max.x),
                j0: frame.pixel_of(self.min.y),
                j1: frame.pixel_of(self.max.y),
            },
            heights: Heights::of(frame, self.min.z, self.max.z),
        }
    }
}

/// A box on the grid.
#[derive(Debug, Clone, Copy)]
pub struct GridBox {
    rect: Rect,
    heights: Heights,
}

impl OnPixels for GridBox {
    const UPRIGHT: bool = true;

    #[inline]
    fn rect(&self) -> Rect {
        self.rect
    }

    #[inline]
    fn heights(&self) -> Heights {
        self.heights
    }

    #[inline]
    fn holds(&self, i: i64, j: i64) -> bool {
        (self.rect.i0 <= i) & (i + 7 <= self.rect.i1) & (self.rect.j0 <= j) & (j + 7 <= self.rect.j1)
    }

    #[inline]
    fn mask(&self, i: i64, j: i64) -> u64 {
        self.rect.bits(i, j, 0)
    }
}
