//! Bands: groups of slices that are classified together.

use super::record::{BLOCK_SLICES, Record, SLICE_STEPS};
use crate::plan::{Plan, rise_of};
use std::ops::Range;

/// Least height of a band (pixels): the default height of a slice.
const LEAST_PIXELS: f64 = 3.0;
/// Least height of a band (pixels per unit of the limit's tangent): a wall in three bands must rise further than a
/// surface at the limit does in three pixels. Exceeds [`LEAST_PIXELS`] only for limits above 60°.
const LEAST_PIXELS_PER_RISE: f64 = 1.732;
/// Limits beyond this need no higher bands than this one (degrees).
const STEEPEST_LIMIT_DEG: f64 = 80.0;

/// Groups of adjacent slices, counted from the lowest slice of a column's block.
///
/// Slopes and walls show over lengths of about a pixel. A slice much thinner than that contains too little of them,
/// even with its neighbours, so a band has the fewest slices that together are three pixels high.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bands {
    slices: u32,
}

impl Default for Bands {
    /// Bands of one slice.
    fn default() -> Self {
        Self { slices: 1 }
    }
}

impl Bands {
    /// Returns the bands for archives of `plan`.
    pub fn new(plan: &Plan) -> Self {
        let rise = rise_of(plan.options.max_slope_deg.min(STEEPEST_LIMIT_DEG));
        // Slightly less, so that a slice of three pixels is a band, however the quotient is rounded.
        let pixels = LEAST_PIXELS.max(LEAST_PIXELS_PER_RISE * rise) * (1.0 - 1e-9);
        let slices = (pixels * plan.frame.pixel_m() / plan.frame.slice_m()).ceil();
        Self { slices: slices.clamp(1.0, BLOCK_SLICES as f64) as u32 }
    }

    /// Slices in a band.
    #[inline]
    pub fn slices(self) -> u32 {
        self.slices
    }

    /// Returns the band of a slice.
    #[inline]
    pub fn of(self, slice: u32) -> u32 {
        // Most archives have bands of one slice, and a division costs as much as the rest of a step.
        if self.slices == 1 { slice } else { slice / self.slices }
    }

    /// Returns the slices of a band, of the one below and of the one above.
    #[inline]
    pub fn around(self, band: u32) -> Range<u32> {
        band.saturating_sub(1) * self.slices..(band + 2) * self.slices
    }

    /// Returns the height of a point above the floor of its band [1/8160 band].
    #[inline]
    pub fn height(self, record: Record) -> i64 {
        let height = i64::from(record.height());
        if self.slices == 1 {
            return height;
        }
        let below = i64::from(record.slice() % self.slices);
        (below * SLICE_STEPS + height) / i64::from(self.slices)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::plan::PlanOptions;
    use crate::voxel::record::Recorder;

    fn slices(pixel_m: f64, slice_m: f64, max_slope_deg: f64) -> u32 {
        let options = PlanOptions { max_slope_deg, ..PlanOptions::default() };
        Bands::new(&Plan { frame: Frame::new(pixel_m, slice_m).unwrap(), options }).slices()
    }

    #[test]
    fn a_slice_of_three_pixels_or_more_is_a_band() {
        for thousandths in 1..2000 {
            let t = f64::from(thousandths) * 0.001;
            let rounded: f64 = format!("{:.3}", 3.0 * t).parse().unwrap();
            for limit in [0.0, 45.0, 60.0] {
                assert_eq!(slices(t, 3.0 * t, limit), 1, "{t} m, {limit} degrees");
                assert_eq!(slices(t, rounded, limit), 1, "{t} m, {limit} degrees");
                assert_eq!(slices(t, 5.0 * t, limit), 1, "{t} m, {limit} degrees");
            }
        }
    }

    #[test]
    fn thinner_slices_make_bands_of_three_pixels_and_steep_limits_higher_ones() {
        assert_eq!(slices(0.05, 0.14, 45.0), 2);
        assert_eq!(slices(0.05, 0.05, 45.0), 3);
        assert_eq!(slices(0.05, 0.01, 45.0), 15);
        assert_eq!(slices(0.05, 0.15, 75.0), 3);
        assert_eq!(slices(0.05, 0.15, 90.0), slices(0.05, 0.15, 80.0));
        assert_eq!(slices(1e6, 1e-6, 90.0), BLOCK_SLICES as u32);
        let widest = Bands { slices: BLOCK_SLICES as u32 };
        assert_eq!(widest.around(widest.of(BLOCK_SLICES as u32 - 1)), 0..2 * BLOCK_SLICES as u32);
    }

    #[test]
    fn heights_in_a_band_rise_from_its_floor_to_its_top() {
        let frame = Frame::new(0.05, 0.01).unwrap();
        let bands = Bands::new(&Plan::new(frame));
        let mut last = None;
        for step in 0..3000 {
            let z = 0.0001 * f64::from(step);
            Recorder::new(frame).record(&[0.5], &[0.5], &[z], |_, record| {
                let place = (bands.of(record.slice()), bands.height(record));
                assert!((0..SLICE_STEPS).contains(&place.1));
                assert!(last < Some(place), "{z} m");
                last = Some(place);
            });
        }
    }
}
