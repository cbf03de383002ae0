//! Spans as cubes with the edge of a pixel, anchored like pixels at the origin.

use slicewalk_base::frame::{Frame, SLICE_QUANTA};

/// Ratios of slice height to pixel size up to this are recognised as whole numbers.
const MOST_RATIO: f64 = 1e6;
/// Differences of heights that count as rounding (cubes).
const ROUNDING: f64 = 1e-6;

/// Conversion of heights to cubes along z.
#[derive(Debug, Clone, Copy)]
pub struct SpanCubes {
    frame: Frame,
    /// Pixels in a slice height, if that is a whole number: then cubes follow exactly.
    ratio: Option<i64>,
}

impl SpanCubes {
    /// Creates the conversion for a grid.
    pub fn of(frame: &Frame) -> Self {
        let ratio = frame.slice_m() / frame.pixel_m();
        let is_whole = ratio <= MOST_RATIO && ratio.round() >= 1.0 && (ratio - ratio.round()).abs() <= 1e-12 * ratio;
        Self { frame: *frame, ratio: is_whole.then_some(ratio.round() as i64) }
    }

    /// Returns the first cube that a span from `bottom` to `top` (quanta) reaches, and the one after the last. A flat span
    /// on the boundary of two cubes makes the upper one solid, which has its lower face there.
    pub fn of_span(&self, bottom: i64, top: i64) -> (i64, i64) {
        let (first, end) = match self.ratio {
            Some(ratio) => {
                let scaled = [bottom, top].map(|height| i128::from(height) * i128::from(ratio));
                let slice = i128::from(SLICE_QUANTA);
                (scaled[0].div_euclid(slice) as i64, -(-scaled[1]).div_euclid(slice) as i64)
            }
            None => {
                let size = self.frame.pixel_m();
                let first = (self.frame.bottom_height(bottom) / size).floor();
                (first as i64, (self.frame.top_height(top) / size).ceil() as i64)
            }
        };
        (first, end.max(first + 1))
    }

    /// Returns the first cube that lies in the slices from `first` up to `end`, and the one after the last.
    pub fn within_slices(&self, first: i64, end: i64) -> (i64, i64) {
        let size = self.frame.pixel_m();
        // A cube that ends with the slice may seem to end above it, by rounding.
        let [bottom, top] = [first, end].map(|slice| self.frame.bottom_of_slice(slice) / size);
        ((bottom - ROUNDING).ceil() as i64, (top + ROUNDING).floor() as i64)
    }
}
