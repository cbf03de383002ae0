//! Sums over the points of a voxel.

use crate::voxel::bands::Bands;
use crate::voxel::record::{Content, Record, SLICE_STEPS, SUBPIXELS};

/// Exact sums over the points of one voxel: position `u`, `v` in its pixel (1/128 pixel) and height `w` in its band
/// [1/8160 band]. Ten numbers determine the least-squares plane and its residual.
///
/// No sum overflows below 10⁹ points in a 3 × 3 × 3 neighbourhood (24,480² · 10⁹ < 2⁶³).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Moments {
    pub n: i64,
    pub u: i64,
    pub v: i64,
    pub w: i64,
    pub uu: i64,
    pub uv: i64,
    pub vv: i64,
    pub uw: i64,
    pub vw: i64,
    pub ww: i64,
}

impl Moments {
    /// Returns the ten numbers, in the order of the fields.
    pub fn numbers(&self) -> [i64; 10] {
        [self.n, self.u, self.v, self.w, self.uu, self.uv, self.vv, self.uw, self.vw, self.ww]
    }

    /// Inverse of [`numbers`](Self::numbers).
    #[inline]
    pub fn from_numbers([n, u, v, w, uu, uv, vv, uw, vw, ww]: [i64; 10]) -> Self {
        Self { n, u, v, w, uu, uv, vv, uw, vw, ww }
    }

    /// Adds one point.
    #[inline]
    pub fn add(&mut self, u: i64, v: i64, w: i64) {
        self.n += 1;
        self.u += u;
        self.v += v;
        self.w += w;
        self.uu += u * u;
        self.uv += u * v;
        self.vv += v * v;
        self.uw += u * w;
        self.vw += v * w;
        self.ww += w * w;
    }

    /// Adds sums about the same origin.
    #[inline]
    pub fn add_all(&mut self, of: &Self) {
        let (own, of) = (self.numbers(), of.numbers());
        *self = Self::from_numbers(std::array::from_fn(|number| own[number] + of[number]));
    }

    /// Adds the point of a record; ignores surfaces.
    #[inline]
    pub(super) fn add_record(&mut self, record: Record, bands: Bands) {
        if record.content() == Content::Point {
            let (u, v) = record.place();
            self.add(i64::from(u), i64::from(v), bands.height(record));
        }
    }

    /// Adds the points of a voxel that lies `pixels_x`, `pixels_y` and `bands` away from the origin of these sums.
    #[inline]
    pub fn add_shifted(&mut self, of: &Self, pixels_x: i64, pixels_y: i64, bands: i64) {
        let (a, b, c) = (pixels_x * SUBPIXELS, pixels_y * SUBPIXELS, bands * SLICE_STEPS);
        self.n += of.n;
        self.u += of.u + of.n * a;
        self.v += of.v + of.n * b;
        self.w += of.w + of.n * c;
        self.uu += of.uu + 2 * a * of.u + of.n * a * a;
        self.uv += of.uv + a * of.v + b * of.u + of.n * a * b;
        self.vv += of.vv + 2 * b * of.v + of.n * b * b;
        self.uw += of.uw + a * of.w + c * of.u + of.n * a * c;
        self.vw += of.vw + b * of.w + c * of.v + of.n * b * c;
        self.ww += of.ww + 2 * c * of.w + of.n * c * c;
    }
}
