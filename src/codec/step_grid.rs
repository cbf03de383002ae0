//! Step grid: the steps that heights lie on, since a scan stored in centimetres has no heights between them
//! (specification, chapter 6).
//!
//! Heights of a page are quanta, and a step spans several of them: coding the number of the step instead of the quantum
//! saves bits. Steps are found from the heights alone, independent of the layer and of any file header, so equal
//! content gives equal bytes.

use crate::frame::{Frame, PAGE_QUANTA, SLICE_QUANTA};
use crate::page::{Page, Span};

/// Fractional bits of [`StepGrid`]'s numbers.
pub const FRACTION_BITS: u32 = 32;
pub const ONE: i64 = 1 << FRACTION_BITS;
/// Tolerance of a height off its step (1/2³² quantum), because coordinates and the step were rounded.
const SLACK: i64 = 1 << 14;
/// Fewest heights from which a grid saves more than the 10 bytes that it takes.
pub const LEAST_HEIGHTS: usize = 32;
/// Steps to look for (m), coarse to fine: decimals of metres, feet and US survey feet, as LAS files are scaled.
const STEPS_M: [f64; 14] = [
    0.1,
    0.1 * 0.3048,
    0.1 * 1200.0 / 3937.0,
    0.01,
    0.005,
    0.01 * 0.3048,
    0.01 * 1200.0 / 3937.0,
    0.002,
    0.001,
    0.0005,
    0.001 * 0.3048,
    0.001 * 1200.0 / 3937.0,
    0.00025,
    0.0001,
];

/// Step of heights in overview levels (quanta): a third of a slice. Pages whose heights are all on slice boundaries use
/// whole slices.
pub const LEVEL_STEP: u32 = SLICE_QUANTA as u32 / 3;

/// Origin of a page's heights, which determines the possible steps.
#[derive(Debug, Clone, Copy)]
pub enum HeightsOf {
    /// A scan on this grid.
    Scan(Frame),
    /// An overview level.
    Level,
}

impl HeightsOf {
    /// Returns whether `page` has an encoding. Every page of a scan has one, at worst with every quantum as a step;
    /// heights of levels must lie on thirds of a slice.
    pub fn admits(&self, page: &Page) -> bool {
        let on_step = |span: &Span| span.bottom().is_multiple_of(LEVEL_STEP) && span.top().is_multiple_of(LEVEL_STEP);
        matches!(self, Self::Scan(_)) || page.spans_of_blocks().all(|spans| spans.iter().all(on_step))
    }
}

/// Equally spaced heights above a page's floor: step `index` lies at `phase + index · step`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepGrid {
    /// Distance of steps (1/2³² quantum).
    pub step: u64,
    /// Height of step 0 (1/2³² quantum), below `step`.
    pub phase: u64,
    /// Whether heights may lie one quantum off the [`usual`](Self::usual) ones, because coordinates were rounded.
    pub is_rounded: bool,
}

/// End of a span; ends are rounded outwards to quanta.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Rounded down.
    Bottom,
    /// Rounded up.
    Top,
}

/// Slice boundaries at which spans of a page begin or end. They may be cuts, so they reveal no steps.
#[derive(Debug, Clone)]
pub struct Boundaries {
    /// Numbers of ends there, by end and by the slice above.
    counts: [[u32; BOUNDARIES]; 2],
}

/// Boundaries of a page's slices.
const BOUNDARIES: usize = (PAGE_QUANTA / SLICE_QUANTA) as usize + 1;

impl Default for Boundaries {
    fn default() -> Self {
        Self { counts: [[0; BOUNDARIES]; 2] }
    }
}

impl Boundaries {
    /// Adds `height`, and returns `true`, if it is a boundary.
    #[inline]
    pub fn add(&mut self, height: u32, end: End) -> bool {
        let is_boundary = height.is_multiple_of(SLICE_QUANTA as u32);
        if is_boundary {
            self.counts[end as usize][(height / SLICE_QUANTA as u32) as usize] += 1;
        }
        is_boundary
    }

    /// Returns the number of ends that lie on no step of `grid`, and whether some of them would if heights were rounded.
    fn off(&self, grid: &StepGrid) -> (usize, bool) {
        let rounded = StepGrid { is_rounded: true, ..*grid };
        let (mut count, mut is_beside) = (0, false);
        for end in [End::Bottom, End::Top] {
            for (slice, &ends) in (0..).zip(&self.counts[end as usize]).filter(|(_, ends)| **ends > 0) {
                let off = rounded.index(slice * SLICE_QUANTA as u32, end).map(|(_, off)| off != 0);
                is_beside |= !grid.is_rounded && off == Some(true);
                count += if off.is_none_or(|off| off && !grid.is_rounded) { ends as usize } else { 0 };
            }
        }
        (count, is_beside)
    }
}

impl StepGrid {
    /// Grid on which every quantum is a step.
    pub const QUANTA: Self = Self { step: ONE as u64, phase: 0, is_rounded: false };

    /// Returns the grid of `step` and `phase` with rounded heights; `None` unless the step is 2 to 255 quanta and larger
    /// than the phase.
    pub fn new(step: u64, phase: u64) -> Option<Self> {
        ((2 * ONE as u64..=SLICE_QUANTA as u64 * ONE as u64).contains(&step) && phase < step).then_some(Self {
            step,
            phase,
            is_rounded: true,
        })
    }

    /// Returns whether the steps are the quanta themselves.
    #[inline]
    pub fn is_quanta(&self) -> bool {
        self.step == ONE as u64
    }

    /// Returns the quantum that step `index` (0..2¹⁴) lies in.
    #[inline]
    pub fn floor(&self, index: u32) -> i32 {
        ((self.phase + index as u64 * self.step) >> FRACTION_BITS) as i32
    }

    /// Returns the first step at or above `height` (quanta).
    #[inline]
    pub fn at_or_above(&self, height: u32) -> u32 {
        if self.is_quanta() {
            return height;
        }
        ((height as u64) << FRACTION_BITS).saturating_sub(self.phase).div_ceil(self.step) as u32
    }

    /// Returns the usual height for a span's `end`: that of a point on step `index` without rounding errors.
    #[inline]
    pub fn usual(&self, index: u32, end: End) -> i32 {
        self.floor(index) + (end == End::Top && !self.is_quanta()) as i32
    }

    /// Returns the step of `height` (quanta) as a span's `end`, and its offset from the [`usual`](Self::usual) height:
    /// −1..=1 if heights are rounded, else 0. `None` if the height lies on no step.
    #[inline]
    pub fn index(&self, height: u32, end: End) -> Option<(u32, i32)> {
        if self.is_quanta() {
            return Some((height, 0));
        }
        let near = self.at_or_above(height.saturating_sub(2));
        let offs = if self.is_rounded { &[0, 1, -1][..] } else { &[0] };
        offs.iter().find_map(|&off| {
            let hit = |index: &u32| self.usual(*index, end) + off == height as i32;
            (near..near + 3).find(hit).map(|index| (index, off))
        })
    }

    /// Finds the grid of one step a slice, if all `heights` (quanta) of a page lie on it; else of the first of `steps`
    /// (1/2³² quantum) that they lie on, or of the coarsest of the usual steps of scans. For an overview level, returns
    /// the level's grid, on which all heights lie that it [admits](HeightsOf::admits).
    pub fn find(of: &HeightsOf, steps: &[u64], heights: &[(u32, End)]) -> Option<Self> {
        Self::find_with(of, steps, heights, &Boundaries::default(), |_, low, high| low + (high - low) / 2)
    }

    /// Like [`find`](Self::find), but takes the phase with the most trailing zeros among all that fit. Heights are rounded
    /// if one of `boundaries` needs it. A grid is passed over if more of `boundaries` lie on none of its steps than there
    /// are `heights`.
    pub fn find_short(of: &HeightsOf, steps: &[u64], heights: &[(u32, End)], boundaries: &Boundaries) -> Option<Self> {
        Self::find_with(of, steps, heights, boundaries, |step, low, high| {
            let whole = low.div_euclid(step) * step;
            let (low, high) = (low - whole, high - whole);
            // Highest bit in which the last phase differs from the one before the first.
            let bit = ((low - 1) ^ high).checked_ilog2().unwrap_or(0);
            if low <= 0 || high >= step { 0 } else { high >> bit << bit }
        })
    }

    /// Finds a grid; `phase` gets the step and the first and last phase that fit, and returns one of them.
    fn find_with(
        of: &HeightsOf,
        steps: &[u64],
        heights: &[(u32, End)],
        boundaries: &Boundaries,
        phase: impl Fn(i64, i64, i64) -> i64,
    ) -> Option<Self> {
        let HeightsOf::Scan(frame) = of else {
            let step = if heights.is_empty() { SLICE_QUANTA as u32 } else { LEVEL_STEP };
            return Self::new(u64::from(step) << FRACTION_BITS, 0);
        };
        if heights.len() < LEAST_HEIGHTS {
            return None;
        }
        let with_step = |step: u64| {
            let grid = Self::new(step, 0)?;
            let with_phase = |(low, high): (i64, i64), is_rounded: bool| {
                let step = grid.step as i64;
                Self { phase: phase(step, low, high).rem_euclid(step) as u64, is_rounded, ..grid }
            };
            // An end off the grid takes about what a wide step saves at an end on it.
            let serves = |found: &Self| {
                let (off, is_beside) = boundaries.off(found);
                off <= heights.len() && !is_beside
            };
            // Most grids have a phase at which no height is off; then offsets need not be coded.
            [false, true].into_iter().find_map(|is_rounded| {
                let around = if is_rounded { (SLACK, SLACK) } else { (0, -1) };
                Some(with_phase(grid.phases_of(heights, around)?, is_rounded)).filter(serves)
            })
        };
        // Centres of voxels have one height in each slice.
        let slice = SLICE_QUANTA as u64 * ONE as u64;
        std::iter::once(slice).chain(steps.iter().copied()).chain(Self::steps_of_scans(frame)).find_map(with_step)
    }

    /// Returns the steps that scans have on this grid (1/2³² quantum), coarse to fine; some exceed the limits of a
    /// grid.
    pub fn steps_of_scans(frame: &Frame) -> impl Iterator<Item = u64> {
        let slice_m = frame.slice_m();
        STEPS_M.iter().map(move |step_m| (step_m * SLICE_QUANTA as f64 / slice_m * ONE as f64 + 0.5).floor() as u64)
    }

    /// Returns the first and last phase at which all heights lie on steps, which are up to `below` and `above`
    /// (1/2³² quantum) outside the quantum that was rounded away.
    fn phases_of(&self, heights: &[(u32, End)], (below, above): (i64, i64)) -> Option<(i64, i64)> {
        // Range of the point of a height, not below the floor of the page. There are no steps there, so a top of one
        // quantum would have none.
        let point = |(height, end): (u32, End)| {
            let low = (height as i64 - (end == End::Top) as i64) * ONE;
            ((low - below).max(0), low + ONE + above)
        };
        let step = self.step as i64;
        let (first, (mut low, mut high)) = heights.first().map(|&height| (point(height).0, point(height)))?;
        for &height in heights {
            let (from, to) = point(height);
            let shift = (from - first + step / 2).div_euclid(step) * step;
            (low, high) = (low.max(from - shift), high.min(to - shift));
            if low > high {
                return None;
            }
        }
        Some((low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn heights(frame: &Frame, points: &[f64], floor: i64) -> Vec<(u32, End)> {
        let ends = points
            .iter()
            .flat_map(|&z| [(frame.quantum_floor(z) - floor, End::Bottom), (frame.quantum_ceil(z) - floor, End::Top)]);
        ends.map(|(height, end)| (height as u32, end)).collect()
    }

    proptest! {
        #[test]
        fn finds_the_steps_of_points_at_any_offset(
            slice_m in prop_oneof![Just(0.15), Just(0.171), Just(0.0301), 0.03f64..0.6],
            step in prop_oneof![Just(0.01), Just(0.001), Just(0.003048)],
            offset in prop_oneof![Just(0.0), Just(49.0254), -900f64..900.0],
            steps in proptest::collection::vec(0u32..5000, 40..200),
        ) {
            let frame = Frame::new(slice_m / 3.0, slice_m).unwrap();
            prop_assume!(step / frame.quantum_m() >= 2.0 && step < slice_m);
            let count = (60.0 * slice_m / step) as u32;
            let points: Vec<f64> = steps.iter().map(|&n| offset + f64::from(n % count) * step).collect();
            let floor = frame.quantum_floor(offset) - 3;
            let heights = heights(&frame, &points, floor);
            let grid = StepGrid::find(&HeightsOf::Scan(frame), &[], &heights).expect("a grid");
            for &(height, end) in &heights {
                let (index, off) = grid.index(height, end).expect("a step");
                prop_assert_eq!(grid.usual(index, end) + off, height as i32);
            }
        }

        #[test]
        fn indices_are_inverse_to_heights(step in 2.0f64..255.0, phase in 0.0f64..1.0, height in 0u32..16320) {
            let step = (step * ONE as f64) as u64;
            let grid = StepGrid::new(step, (phase * step as f64) as u64).unwrap();
            let index = grid.at_or_above(height);
            let exact = |index: u32| grid.phase + u64::from(index) * grid.step;
            prop_assert!(exact(index) >= u64::from(height) << 32);
            prop_assert!(index == 0 || exact(index - 1) < u64::from(height) << 32);
            for end in [End::Bottom, End::Top] {
                if let Some((index, off)) = grid.index(height, end) {
                    prop_assert_eq!(grid.usual(index, end) + off, height as i32);
                    prop_assert!(off.abs() <= 1);
                }
            }
        }
    }

    #[test]
    fn every_height_has_a_step_where_points_lie_on_the_floor_of_a_page() {
        let mut found = 0;
        for (pixel_cm, layer) in (1..100).flat_map(|pixel_cm| [-3, -1, 0, 1, 2, 5].map(|layer| (pixel_cm, layer))) {
            let pixel_m = f64::from(pixel_cm) / 100.0;
            let frame = Frame::new(pixel_m, 3.0 * pixel_m).unwrap();
            let floor = layer * 64 * SLICE_QUANTA;
            let first = (floor as f64 * frame.quantum_m() * 100.0).round();
            let points: Vec<_> = (0..400).map(|n| (first + f64::from(n)) / 100.0).collect();
            let on_page =
                |z: &f64| frame.quantum_floor(*z) >= floor && frame.quantum_ceil(*z) < floor + 64 * SLICE_QUANTA;
            let points: Vec<_> = points.into_iter().filter(on_page).collect();
            let mut heights = heights(&frame, &points, floor);
            heights.retain(|(height, _)| height % SLICE_QUANTA as u32 != 0);
            let Some(grid) = StepGrid::find(&HeightsOf::Scan(frame), &[], &heights) else { continue };
            found += 1;
            for &(height, end) in &heights {
                assert!(grid.index(height, end).is_some(), "{height} {end:?} of {pixel_m} m in layer {layer}");
            }
        }
        assert!(found > 100, "{found} grids have steps");
    }

    #[test]
    fn centres_of_voxels_have_one_step_a_slice() {
        for slice_m in [0.05, 0.022, 0.066] {
            let frame = Frame::new(slice_m, slice_m).unwrap();
            let points: Vec<f64> = (0..60).map(|k| (f64::from(k * 7 % 64) + 0.5) * slice_m).collect();
            let grid = StepGrid::find(&HeightsOf::Scan(frame), &[], &heights(&frame, &points, 0)).unwrap();
            assert_eq!(grid.step, 255 << FRACTION_BITS, "slices of {slice_m} m");
            assert!(!grid.is_rounded, "slices of {slice_m} m");
        }
    }

    #[test]
    fn a_boundary_beside_a_step_is_rounded() {
        let of = HeightsOf::Scan(Frame::new(0.05, 0.15).unwrap());
        let heights: Vec<_> = (0..60).map(|k| (1 + 17 * k, End::Bottom)).collect();
        // Step 15 lies at 256.
        for (boundary, is_rounded) in [(None, false), (Some(255), true), (Some(2 * 255), true), (Some(64 * 255), true)]
        {
            let mut boundaries = Boundaries::default();
            assert!(boundary.is_none_or(|height| boundaries.add(height, End::Bottom)));
            let grid = StepGrid::find_short(&of, &[17 << FRACTION_BITS], &heights, &boundaries).unwrap();
            assert_eq!((grid.step, grid.is_rounded), (17 << FRACTION_BITS, is_rounded), "{boundary:?}");
        }
        // A boundary on no step, or on one of its own, changes nothing.
        let (mut far, mut own) = (Boundaries::default(), Boundaries::default());
        assert!(far.add(255, End::Bottom) && own.add(255, End::Top) && !own.add(256, End::Bottom));
        let farther: Vec<_> = heights.iter().map(|&(height, end)| (height + 7, end)).collect();
        for (heights, boundaries) in [(&farther, &far), (&heights, &own)] {
            let grid = StepGrid::find_short(&of, &[17 << FRACTION_BITS], heights, boundaries).unwrap();
            assert!(!grid.is_rounded, "{boundaries:?}");
        }
    }

    #[test]
    fn floors_on_slice_boundaries_have_the_steps_that_they_lie_on() {
        // Pillars of 4 m on a floor at the bottom of the page.
        let of = HeightsOf::Scan(Frame::new(0.4, 1.2).unwrap());
        let heights = [(850, End::Top); 40];
        for (floors, step) in [(40, 255 * ONE), (41, 85 * ONE / 4)] {
            let mut boundaries = Boundaries::default();
            assert!((0..floors).all(|_| boundaries.add(0, End::Top)));
            let grid = StepGrid::find_short(&of, &[], &heights, &boundaries).unwrap();
            assert_eq!(grid.step, step as u64, "{floors} floors");
        }
    }

    #[test]
    fn as_many_heights_as_needed_and_a_single_phase_suffice() {
        let of = HeightsOf::Scan(Frame::new(0.05, 0.15).unwrap());
        let heights: Vec<_> = (0..32).map(|k| (1 + 17 * k, End::Bottom)).collect();
        assert!(StepGrid::find(&of, &[], &heights).is_some());
        assert!(StepGrid::find(&of, &[], &heights[1..]).is_none());
        // The second height is a step less a quantum above the first, but for the least fraction.
        let grid = StepGrid::new(17 * ONE as u64 + 1, 0).unwrap();
        let phases = |second: u32| grid.phases_of(&[(0, End::Bottom), (second, End::Bottom)], (0, -1));
        assert_eq!(phases(18), Some((ONE - 1, ONE - 1)));
        assert_eq!(phases(19), None);
    }

    #[test]
    fn levels_take_pages_with_both_ends_on_their_steps() {
        let admits = |bottom: u32, top: u32| {
            let mut builder = crate::page::PageBuilder::default();
            assert!(builder.set_column(0, 0, &[crate::page::Span::new(bottom, top, false).unwrap()]));
            HeightsOf::Level.admits(&builder.build())
        };
        assert!(admits(85, 170) && !admits(85, 171) && !admits(84, 170));
    }

    #[test]
    fn noise_has_no_steps() {
        let mut random = 1u64;
        let mut next = || {
            random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (random >> 33) as u32 % 16000
        };
        let heights: Vec<_> = (0..200).map(|_| (next(), End::Bottom)).collect();
        let frame = Frame::new(0.05, 0.15).unwrap();
        assert_eq!(StepGrid::find(&HeightsOf::Scan(frame), &[], &heights), None);
        assert_eq!(StepGrid::find(&HeightsOf::Scan(frame), &[], &heights[..5]), None);
    }
}
