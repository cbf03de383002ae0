//! Cells that the simplification works on: columns of pixels, split or grouped to the size that the error asks for.

use slicewalk::frame::Frame;

/// Steps of the lattice of corners in a cell.
pub const STEPS: i64 = 8;
/// Cells in the error.
const CELLS: f64 = 3.0;
/// Pixels in the error for each pixel along the edge of a group.
const PIXELS_OF_GROUP: f64 = 6.0;
/// Most parts of a pixel along an axis, and of a quantum.
const MOST_PARTS: f64 = 24.0;
const MOST_FINE: f64 = 4096.0;
/// Units of height in the error, at least.
const UNITS: f64 = 32.0;

/// Returns the least error bound for a grid of an archive (m).
pub fn least_error_m(frame: &Frame) -> f64 {
    (frame.pixel_m() * CELLS / MOST_PARTS).max(frame.quantum_m() * UNITS / MOST_FINE)
}

/// Sizes for one error bound.
#[derive(Debug, Clone, Copy)]
pub struct Grid {
    /// Parts of a pixel along an axis; 1 if pixels are grouped.
    pub parts: i64,
    /// Pixels in a cell along an axis; 1 if pixels are split.
    pub group: i64,
    /// Units in a quantum of height.
    pub fine: i64,
    /// Edge of a cell (m).
    pub cell_m: f64,
    /// Unit of heights (m).
    pub unit_m: f64,
    /// Farthest from the cells that a surface may lie (m): the error, less the rounding of solid to cells.
    pub reach_m: f64,
}

impl Grid {
    /// Returns the sizes for an error bound (m), with cells smaller by `finer`; `None` if the error is too small for the
    /// grid of the archive.
    pub fn new(frame: &Frame, error_m: f64, finer: i64) -> Option<Self> {
        let pixel = frame.pixel_m();
        let ratio = error_m / pixel / finer as f64;
        let group =
            if ratio < 2.0 * PIXELS_OF_GROUP { 1 } else { 1i64 << ((ratio / PIXELS_OF_GROUP).min(1e9) as u64).ilog2() };
        // A cell is solid if any of its pixels is.
        let reach_m = error_m - std::f64::consts::SQRT_2 * (group - 1) as f64 * pixel;
        let parts = if group > 1 { 1.0 } else { (CELLS / ratio - 1e-9).ceil().max(1.0) };
        let fine = (frame.quantum_m() * UNITS / reach_m).ceil().max(1.0);
        if !(parts <= MOST_PARTS * finer as f64 && fine <= MOST_FINE) {
            return None;
        }
        let cell_m = pixel * group as f64 / parts;
        let unit_m = frame.quantum_m() / fine;
        Some(Self { parts: parts as i64, group, fine: fine as i64, cell_m, unit_m, reach_m })
    }

    /// Returns the first cell of a pixel, and the one after its last.
    pub fn cells(&self, pixel: i64) -> (i64, i64) {
        match self.group {
            1 => (pixel * self.parts, (pixel + 1) * self.parts),
            group => (pixel.div_euclid(group), pixel.div_euclid(group) + 1),
        }
    }

    /// Returns whole units in a share of the reach.
    pub fn units(&self, share: f64) -> i64 {
        (share * self.reach_m / self.unit_m) as i64
    }
}
