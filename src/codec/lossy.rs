//! Lossy pages: chooses heights within a tolerance that take few bytes.
//!
//! Heights move onto steps as far apart as the tolerance allows, bottoms down and tops up, so nothing between two steps
//! is coded. If a scan has steps of its own, several of them are combined: with a tolerance of 1.25 cm, heights in
//! whole centimetres become even ones. Steps half as wide leave most heights a choice, which the models of the length
//! estimate make. Of the few grids tried, each page takes the one with the least estimate.
//!
//! Ends that cannot move, mostly where the border of a page cuts a solid, lie on no wide step and take the symbol of
//! slice boundaries. The encoder finds a page's steps from its heights alone, so with few and similar heights it may
//! find wider steps than those chosen here. A page with many fixed ends may get narrow steps, which reach them; heights
//! then follow the prediction, except for the first few, which stay exact so that no wider steps fit all of them.

use super::estimate::{Candidates, Estimate};
use super::rows::{PIXELS, SLICE, telling_heights};
use super::step_grid::{End, HeightsOf, LEAST_HEIGHTS, ONE, StepGrid};
use crate::frame::{Frame, PAGE_QUANTA};
use crate::page::{Inferred, Page, PageBuilder, RowBuilder, Span};

/// Phases of a step that are compared.
const PHASES: u64 = 8;
/// Most pairs of spans used to compare phases.
const MOST_PAIRS: usize = 1024;
/// Try narrow steps if more than 1 in `CUT_SPANS` spans has an end that stays on a slice boundary.
const CUT_SPANS: usize = 16;
/// Number of spans that keep exact heights on narrow steps.
const TRUE_SPANS: usize = 8;
/// Rows of pixels between comparisons of a grid with the shortest one. They start where that one has spent an eighth of
/// its length.
const ROWS: usize = 8;
/// A grid is given up if it then needs over 1/`HOPELESS` more.
const HOPELESS: u64 = 48;
/// Cost (bits) of a height below the lowest step, when phases are compared.
const BELOW: u32 = 20;

/// Range in which each end of a span may lie (quanta): first and last height.
#[derive(Debug, Clone, Copy)]
struct Room {
    bottom: (u32, u32),
    top: (u32, u32),
}

/// Lossy encoding of a page; its memory is reused.
#[derive(Debug, Default)]
pub struct Lossy {
    /// Index of the first span of each pixel, and one more.
    first: Vec<u32>,
    spans: Vec<Span>,
    room: Vec<Room>,
    /// True if some spans are so close to each other that steps may not suit them.
    is_close: bool,
    /// True if many ends must stay on slice boundaries.
    is_cut: bool,
    heights: Vec<(u32, End)>,
    tried: Tried,
    best: Tried,
}

/// Cost of the rows before each multiple of [`ROWS`] (1/64 bit).
type RowCosts = [u64; PIXELS / 64 / ROWS];

/// Heights on a grid.
#[derive(Debug)]
struct Tried {
    grid: StepGrid,
    spans: Vec<Span>,
}

impl Default for Tried {
    fn default() -> Self {
        Self { grid: StepGrid::QUANTA, spans: Vec::new() }
    }
}

impl Lossy {
    /// Returns a page that takes few bytes and covers all solid of `page`: bottoms are up to `tolerance` (quanta)
    /// lower, tops up to `tolerance` higher. Spans of one kind without a gap between them merge. Also returns the step
    /// grid of the heights.
    pub fn simplify(
        &mut self,
        (of, steps): (&HeightsOf, &[u64]),
        (page, tolerance): (&Page, u32),
        estimate: &mut Estimate,
        builder: &mut RowBuilder,
    ) -> (Page, StepGrid) {
        self.set(page, tolerance);
        let mut shortest: Option<(u64, RowCosts)> = None;
        for grid in self.grids(of, tolerance) {
            let before = shortest.as_ref().filter(|_| !self.is_cut);
            let Some((mut length, costs)) = self.try_on(grid, before, estimate) else { continue };
            if self.is_cut {
                // The encoder may find other steps in the heights than those they were chosen on.
                let page = self.built(&self.tried, builder);
                let boundaries = telling_heights(&page, &mut self.heights);
                let grid = StepGrid::find_short(of, steps, &self.heights, &boundaries);
                let same = |_: &Estimate, number: usize, _: &Candidates| self.tried.spans[number];
                let all = estimate.walk(grid.unwrap_or(StepGrid::QUANTA), &self.first, same, |_, _| true);
                length = all.unwrap_or(length);
            }
            if shortest.is_none_or(|shortest| length < shortest.0) {
                shortest = Some((length, costs));
                std::mem::swap(&mut self.best, &mut self.tried);
            }
        }
        (self.built(&self.best, builder), self.best.grid)
    }

    /// Chooses heights on `grid` and returns their cost and that of the rows, or `None` if the grid was given up as
    /// longer than the `shortest` one.
    fn try_on(
        &mut self,
        grid: StepGrid,
        shortest: Option<&(u64, RowCosts)>,
        estimate: &mut Estimate,
    ) -> Option<(u64, RowCosts)> {
        let mut tried = std::mem::take(&mut self.tried);
        tried.grid = grid;
        tried.spans.clear();
        let mut costs = RowCosts::default();
        let goes_on = |row: usize, cost: u64| {
            if !row.is_multiple_of(ROWS) {
                return true;
            }
            let number = row / ROWS;
            costs[number] = cost;
            shortest.is_none_or(|&(all, shortest)| {
                8 * shortest[number] <= all || cost <= shortest[number] + shortest[number] / HOPELESS
            })
        };
        let choose = |estimate: &Estimate, number: usize, candidates: &Candidates| {
            let span = self.chosen(number, grid, candidates, estimate);
            tried.spans.push(span);
            span
        };
        let all = estimate.walk(grid, &self.first, choose, goes_on);
        self.tried = tried;
        all.map(|all| (all, costs))
    }

    /// Returns the span to take on `grid` in place of the one with this number.
    fn chosen(&self, number: usize, grid: StepGrid, candidates: &Candidates, estimate: &Estimate) -> Span {
        let (span, room) = (self.spans[number], self.room[number]);
        // The first spans keep exact heights if there is much to choose from.
        let is_free = number >= TRUE_SPANS;
        let thickness = candidates.thickness;
        let with = |bottom: u32, top: u32| Span::new(bottom, top, span.is_obstacle()).unwrap_or(span);
        if grid.is_quanta() {
            let bottom = follow(candidates.bottom, room.bottom);
            return with(bottom, follow(bottom as i32 + thickness, room.top));
        }
        let mut best = (u32::MAX, span);
        let bottoms = Choices::of(&grid, End::Bottom, room.bottom, is_free.then_some(candidates.bottom));
        for bottom in bottoms.all() {
            let expected = bottom.1 as i32 + thickness;
            let tops = Choices::of(&grid, End::Top, room.top, is_free.then_some(expected));
            if bottoms.len == 1 && tops.len == 1 {
                return with(bottom.0, tops.list[0].0);
            }
            let bottom_cost = estimate.cost(End::Bottom, candidates.bottom, bottom.2);
            for top in tops.all() {
                let cost = bottom_cost + estimate.cost(End::Top, expected, top.2);
                if cost < best.0 {
                    best = (cost, with(bottom.0, top.0));
                }
            }
        }
        best.1
    }

    /// Builds the page of the spans of `tried`.
    fn built(&self, tried: &Tried, builder: &mut RowBuilder) -> Page {
        let occupied = || self.first.windows(2).enumerate().filter(|(_, ends)| ends[0] < ends[1]);
        let mut rows = [0u64; 64];
        occupied().for_each(|(pixel, _)| rows[pixel / 64] |= 1 << (pixel % 64));
        builder.begin(rows);
        for (pixel, ends) in occupied() {
            let (px, py) = (pixel as u32 % 64, pixel as u32 / 64);
            let own = &tried.spans[ends[0] as usize..ends[1] as usize];
            debug_assert!(own.windows(2).all(|pair| pair[0].lies_below(pair[1])), "pixel {pixel}: {own:?}");
            own.iter().for_each(|&span| builder.push(px, span));
            builder.end_pixel(px, py);
        }
        builder.build()
    }

    fn set(&mut self, page: &Page, tolerance: u32) {
        let Self { first, spans, room, is_close, is_cut, heights, .. } = self;
        *is_close = false;
        first.clear();
        spans.clear();
        room.clear();
        heights.clear();
        for (px, py, column) in page.columns() {
            let start = spans.len();
            first.resize((py * 64 + px + 1) as usize, start as u32);
            for &span in column {
                let mut own = Room {
                    bottom: (span.bottom().saturating_sub(tolerance), span.bottom()),
                    top: (span.top(), (span.top() + tolerance).min(PAGE_QUANTA as u32)),
                };
                let below = spans[start..].last_mut().zip(room.last_mut());
                if let Some((below, below_room)) = below.filter(|(_, room)| room.top.1 >= own.bottom.0) {
                    let is_same = below.is_obstacle() == span.is_obstacle();
                    let both = Span::new(below.bottom(), span.top(), span.is_obstacle());
                    if let Some(both) = both.filter(|_| is_same) {
                        *below = both;
                        below_room.top = own.top;
                        continue;
                    }
                    // Spans of different kinds may meet on the slice boundary between them.
                    let border = below.top().next_multiple_of(SLICE);
                    if !is_same && border <= span.bottom() {
                        below_room.top.1 = border.min(below_room.top.1);
                        own.bottom.0 = border.max(own.bottom.0);
                    } else {
                        *is_close = true;
                        below_room.top.1 = below.top();
                        own.bottom.0 = span.bottom();
                    }
                }
                spans.push(span);
                room.push(own);
            }
        }
        first.resize(PIXELS + 1, spans.len() as u32);
        let fixed = |&&(low, high): &&(u32, u32)| low == high && low % SLICE == 0;
        let cut = room.iter().flat_map(|room| [&room.bottom, &room.top]).filter(fixed).count();
        *is_cut = cut * CUT_SPANS > spans.len();
        heights.extend(room.iter().flat_map(|room| [(room.bottom.1, End::Bottom), (room.top.0, End::Top)]));
        // Heights on slice boundaries may be cuts, so they reveal no steps.
        heights.retain(|(height, _)| height % SLICE != 0);
    }

    /// Returns the grids to try.
    fn grids(&self, of: &HeightsOf, tolerance: u32) -> Vec<StepGrid> {
        if self.heights.len() < LEAST_HEIGHTS || self.is_close || tolerance == 0 {
            return vec![StepGrid::QUANTA];
        }
        let own = StepGrid::find(of, &[], &self.heights);
        if let Some((own, most)) = own.and_then(|own| Some((own, together(own.step, tolerance)?))) {
            let on = |count: u64| {
                let phases =
                    (0..count.min(PHASES)).map(|phase| own.phase + phase * count / count.min(PHASES) * own.step);
                self.with_best_phase(count * own.step, phases)
            };
            let half = Some(most.div_ceil(2)).filter(|&half| half < most);
            return [Some(most), half].into_iter().flatten().filter_map(on).collect();
        }
        let on = |(number, step): (usize, u32)| {
            let step = u64::from(step);
            // A choice of heights makes up for a bad phase.
            let phases = if number == 0 { PHASES.min(step) } else { 1 };
            self.with_best_phase(
                step * ONE as u64,
                (0..phases).map(|phase| (phase * step / phases) * ONE as u64 + ONE as u64 / 2),
            )
        };
        let mut all: Vec<StepGrid> = steps(tolerance).enumerate().filter_map(on).collect();
        if let (true, HeightsOf::Scan(frame), Some(wide)) = (self.is_cut, of, all.last()) {
            // The wide steps end there; scans have narrower ones, and the encoder looks for those, too.
            let narrow = StepGrid::steps_of_scans(frame).filter_map(|step| StepGrid::new(step, 0)).last();
            all.extend(narrow.filter(|narrow| narrow.step < wide.step));
        }
        all
    }

    /// Returns the grid of this step (1/2³² quantum) with the one of `phases` that suits the heights best.
    fn with_best_phase(&self, step: u64, phases: impl Iterator<Item = u64>) -> Option<StepGrid> {
        let grids = phases.filter_map(|phase| StepGrid::new(step, phase % step));
        let all: Vec<StepGrid> = grids.collect();
        if all.len() < 2 {
            return all.first().copied();
        }
        let pairs = self.pairs();
        all.into_iter().min_by_key(|grid| pairs.iter().map(|pair| changes(grid, pair)).sum::<u32>())
    }

    /// Returns up to [`MOST_PAIRS`] pairs, spread over the page, of a span and the span with the same index to the
    /// west.
    fn pairs(&self) -> Vec<[Span; 2]> {
        let every = self.spans.len() / MOST_PAIRS + 1;
        let mut pairs = Vec::with_capacity(MOST_PAIRS);
        let mut left = 0;
        for pixel in (0..PIXELS).filter(|pixel| pixel % 64 > 0) {
            let of = |pixel: usize| &self.spans[self.first[pixel] as usize..self.first[pixel + 1] as usize];
            for (west, span) in of(pixel - 1).iter().zip(of(pixel)) {
                if left == 0 {
                    pairs.push([*west, *span]);
                    left = every;
                }
                left -= 1;
            }
        }
        pairs
    }
}

/// Adds the inferred spans of the `exact` page to the `scanned` page, whose heights were chosen on `grid`. They move
/// onto the grid, too, but not into scanned solid; inferred spans that it covers are dropped.
pub fn with_inferred(
    (scanned, grid): (&Page, StepGrid),
    (exact, inferred): (&Page, &Inferred),
    tolerance: u32,
    builder: &mut PageBuilder,
) -> (Page, Inferred) {
    builder.clear();
    let mut marks = Inferred::new();
    for (px, py, spans) in scanned.columns().filter(|&(px, py, _)| inferred.of(px, py) == 0) {
        let taken = builder.set_column(px, py, spans);
        debug_assert!(taken, "spans of a page");
    }
    let mut column: Vec<(Span, bool)> = Vec::new();
    for (px, py, mask) in inferred.pixels() {
        column.clear();
        column.extend(scanned.column(px, py).iter().map(|&span| (span, false)));
        let own = exact.column(px, py).iter().enumerate().filter(|(at, _)| mask >> (at & 63) & 1 == 1);
        for span in own.map(|(_, span)| *span) {
            let at = column.partition_point(|(other, _)| other.bottom() <= span.bottom());
            let least = at.checked_sub(1).map_or(0, |below| column[below].0.top() + 1);
            let most = column.get(at).map_or(PAGE_QUANTA as u32, |above| above.0.bottom().saturating_sub(1));
            if least > span.top() || most < span.bottom() {
                continue;
            }
            let lower = grid.at_or_above(span.bottom() + 1).checked_sub(1).map(|step| grid.usual(step, End::Bottom));
            let upper = grid.usual(grid.at_or_above(span.top().saturating_sub(1)), End::Top);
            let within =
                |height: i32, exact: u32| height as u32 + tolerance >= exact && height as u32 <= exact + tolerance;
            let bottom =
                lower.filter(|&height| within(height, span.bottom())).map_or(span.bottom(), |height| height as u32);
            let top = if within(upper, span.top()) { (upper as u32).max(span.top()) } else { span.top() };
            let span = Span::new(bottom.min(span.bottom()).max(least), top.min(most), false);
            column.extend(span.map(|span| (span, true)));
            column.sort_unstable_by_key(|(span, _)| (span.bottom(), span.top()));
        }
        let mask = column.iter().enumerate().fold(0, |mask, (at, (_, new))| mask | u64::from(*new) << (at & 63));
        let spans: Vec<Span> = column.iter().map(|(span, _)| *span).collect();
        let taken = spans.is_empty() || builder.set_column(px, py, &spans) && marks.push(px, py, mask);
        debug_assert!(taken, "spans that are apart");
    }
    (builder.build(), marks)
}

/// Returns how much two spans differ on a grid (roughly in bits).
fn changes(grid: &StepGrid, pair: &[Span; 2]) -> u32 {
    let ends = pair.map(|span| {
        let bottom = grid.at_or_above(span.bottom() + 1) as i32 - 1;
        (bottom, grid.at_or_above(span.top().saturating_sub(1)) as i32 - bottom)
    });
    let bits = |a: i32, b: i32| 2 * (u32::BITS - a.abs_diff(b).leading_zeros());
    let below = if ends[1].0 < 0 { BELOW } else { 0 };
    bits(ends[0].0, ends[1].0) + bits(ends[0].1, ends[1].1) + below
}

/// Returns steps (quanta) for a scan without steps of its own: one that gives each height a single choice, and one that
/// gives it two.
fn steps(tolerance: u32) -> impl Iterator<Item = u32> {
    [1, 2].into_iter().map(move |parts| ((tolerance + 1) / parts).min(SLICE)).filter(|&step| step >= 2)
}

/// Most steps of a scan that are combined. If more fit the tolerance, steps that ignore them do as well.
const MOST_TOGETHER: u64 = 6;

/// Returns how many steps of a scan, `step` apart (1/2³² quantum), fit into the tolerance (quanta) and a slice. Two
/// quanta of the tolerance go to rounding.
fn together(step: u64, tolerance: u32) -> Option<u64> {
    let slice = u64::from(SLICE) * ONE as u64;
    if !(2 * ONE as u64..=slice).contains(&step) {
        return None;
    }
    let most = u64::from(tolerance.saturating_sub(2)) * ONE as u64 / step + 1;
    Some(most.min(slice / step)).filter(|&most| most <= MOST_TOGETHER)
}

/// Returns all steps (1/2³² quantum) that lossy encoding may use on this grid with a tolerance of `tolerance` quanta.
pub fn all_steps(frame: &Frame, tolerance: u32) -> Vec<u64> {
    if tolerance == 0 {
        return Vec::new();
    }
    let of_scans = StepGrid::steps_of_scans(frame).filter_map(|step| Some((step, together(step, tolerance)?)));
    let of_scans = of_scans.flat_map(|(step, most)| [most, most.div_ceil(2)].map(|count| (step, count)));
    let of_scans = of_scans.filter(|&(_, count)| count > 1).map(|(step, count)| step * count);
    let mut all: Vec<u64> = of_scans.chain(steps(tolerance).map(|step| u64::from(step) * ONE as u64)).collect();
    all.dedup();
    all
}

/// Candidate height of an end: the quantum, its step or the next one above, and the step if it is on one.
type Choice = (u32, u32, Option<u32>);

/// Most candidate heights of an end.
const MOST_CHOICES: usize = 3;

/// Candidate heights of an end: all steps in its range if they are few; otherwise the one that follows the predicted
/// step, and the one nearest to the exact height. Without a prediction only the latter.
struct Choices {
    list: [Choice; MOST_CHOICES],
    len: usize,
}

impl Choices {
    fn of(grid: &StepGrid, end: End, (low, high): (u32, u32), expected: Option<i32>) -> Self {
        // First and last step of the range, by their usual heights.
        let up = if end == End::Top { 1 } else { 0 };
        let first = grid.at_or_above(low.saturating_sub(up));
        let Some(last) = grid.at_or_above(high + 1 - up).checked_sub(1).filter(|&last| first <= last) else {
            // Take a slice boundary, or keep the exact height, which the steps of a scan reach except for rounding.
            // With steps of the tolerance, a height beside a step would stop the encoder from finding those steps.
            let (exact, border) = match end {
                End::Bottom => (high, high / SLICE * SLICE),
                End::Top => (low, low.next_multiple_of(SLICE)),
            };
            let height = if (low..=high).contains(&border) { border } else { exact };
            let step = grid.index(height, end).map(|(step, _)| step);
            let index = step.unwrap_or_else(|| grid.at_or_above(height));
            return Self { list: [(height, index, step); MOST_CHOICES], len: 1 };
        };
        let near = if end == End::Top { first } else { last };
        let away = |steps: u32| if end == End::Top { near + steps } else { near.saturating_sub(steps) };
        let (indices, len) = match last - first {
            more @ 0..=2 => ([near, away(1), away(2)], more as usize + 1),
            _ => match expected.map(|expected| follow(expected, (first, last))) {
                Some(follow) if follow != near => ([follow, near, near], 2),
                _ => ([near; MOST_CHOICES], 1),
            },
        };
        Self { list: indices.map(|index| (grid.usual(index, end) as u32, index, Some(index))), len }
    }

    fn all(&self) -> &[Choice] {
        &self.list[..self.len]
    }
}

/// Returns the expected height or step if it is in the range. Otherwise goes a third of the way across, because the
/// surface has left the prediction and may continue to do so.
fn follow(expected: i32, (low, high): (u32, u32)) -> u32 {
    let (low, high) = (low as i32, high as i32);
    let height = match expected {
        _ if expected < low => low + (high - low) / 3,
        _ if expected > high => high - (high - low) / 3,
        _ => expected,
    };
    height as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{Decoder, Encoder, MAX_BODY, pages};
    use proptest::prelude::*;

    fn frame() -> Frame {
        Frame::new(0.05, 0.15).unwrap()
    }

    /// Encodes `page` within the tolerance, and checks that the result covers all of it and exceeds it by no more than
    /// the tolerance.
    fn check(page: &Page, tolerance: u32) -> (Page, usize) {
        let mut encoder = Encoder::new(frame(), tolerance);
        let (mut body, mut again) = (Vec::new(), Vec::new());
        let (loose, _) = encoder.encode_lossy(page, &Inferred::NONE, &mut body);
        encoder.encode(&loose, &mut again);
        assert!(body == again && body.len() <= MAX_BODY, "the one encoding");
        assert_eq!(Decoder::default().decode(&body).unwrap(), loose);
        for pixel in 0..PIXELS as u32 {
            let (px, py) = (pixel % 64, pixel / 64);
            let mut exact = page.column(px, py).iter().peekable();
            for span in loose.column(px, py) {
                let first = exact.next().expect("matter");
                assert!(
                    span.bottom() <= first.bottom() && first.bottom() <= span.bottom() + tolerance,
                    "{first:?} {span:?}"
                );
                let mut last = first;
                // A span of another kind without height may lie on the slice boundary where this one ends; it is not
                // part of it.
                let is_in = |next: &&Span| next.top() <= span.top() && next.is_obstacle() == first.is_obstacle();
                while let Some(next) = exact.next_if(is_in) {
                    assert!(next.bottom() - last.top() <= 2 * tolerance, "{last:?} {next:?}");
                    last = next;
                }
                assert!(last.top() <= span.top() && span.top() <= last.top() + tolerance, "{last:?} {span:?}");
                assert_eq!(first.is_obstacle(), span.is_obstacle());
            }
            assert!(exact.next().is_none());
        }
        (loose, body.len())
    }

    /// Rounds the heights of `page` to steps of `step` quanta, as long as its spans stay apart.
    fn in_steps(page: &Page, step: u32) -> Page {
        let mut builder = PageBuilder::default();
        for (px, py, spans) in page.columns() {
            let whole = |height: u32| height / step * step;
            let on_steps =
                |span: &Span| Span::new(whole(span.bottom()), (whole(span.top()) + 1).min(16320), span.is_obstacle());
            let spans: Vec<_> = spans.iter().filter_map(on_steps).collect();
            assert!(builder.set_column(px, py, &spans) || spans.len() > 1);
        }
        builder.build()
    }

    proptest! {
        #[test]
        #[ignore = "slow: .ci/run"]
        fn loose_pages_hold_all_matter_within_the_tolerance_in_the_one_encoding(
            page in pages(), tolerance in prop_oneof![1u32..4, 1u32..256, Just(21), Just(255)], step in prop_oneof![Just(1u32), Just(17)],
        ) {
            let page = if step > 1 { in_steps(&page, step) } else { page };
            prop_assume!(page.span_count() > 0);
            check(&page, tolerance);
        }

        #[test]
        #[ignore = "slow: .ci/run"]
        fn loose_pages_without_their_inferred_spans_are_those_that_never_had_any(
            page in pages(), tolerance in prop_oneof![1u32..4, 1u32..256, Just(21), Just(255)], step in prop_oneof![Just(1u32), Just(17)],
            every in 1usize..9,
        ) {
            let page = if step > 1 { in_steps(&page, step) } else { page };
            prop_assume!(page.span_count() > 0);
            let mut inferred = Inferred::new();
            for (number, (px, py, spans)) in page.columns().enumerate() {
                let floors = spans.iter().enumerate().filter(|(at, span)| !span.is_obstacle() && (number + at) % every == 0);
                prop_assert!(inferred.push(px, py, floors.fold(0, |mask, (at, _)| mask | 1 << (at & 63))));
            }
            let mut builder = PageBuilder::default();
            let scanned = inferred.without(&page, &mut builder);
            let mut encoder = Encoder::new(frame(), tolerance);
            let (mut body, mut again) = (Vec::new(), Vec::new());
            let (loose, marks) = encoder.encode_lossy(&page, &inferred, &mut body);
            encoder.encode_inferred(&loose, &marks, &mut again);
            prop_assert!(body == again && body.len() <= MAX_BODY, "the one encoding");
            let mut decoder = Decoder::default();
            prop_assert_eq!(&decoder.decode(&body).unwrap(), &loose);
            prop_assert_eq!(decoder.inferred(), &marks);
            let alone = match scanned.span_count() {
                0 => scanned.clone(),
                _ => encoder.encode_lossy(&scanned, &Inferred::NONE, &mut again).0,
            };
            prop_assert_eq!(marks.without(&loose, &mut builder), alone);
            // Inferred spans lie in the result, or within the tolerance of their place.
            for (px, py, mask) in inferred.pixels() {
                let own = page.column(px, py).iter().enumerate().filter(|(at, _)| mask >> (at & 63) & 1 == 1);
                for (_, span) in own {
                    let meets = |other: &&Span| other.meets(span.bottom(), span.top());
                    prop_assert!(loose.column(px, py).iter().any(|other| meets(&other)), "{span:?}");
                }
            }
            prop_assert!(loose.span_count() <= page.span_count());
        }
    }

    /// A sloping floor with noise of `noise` quanta.
    fn floor(unit: u32, noise: u32) -> Page {
        let mut builder = PageBuilder::default();
        for pixel in 0..PIXELS as u32 {
            let random = pixel.wrapping_mul(2654435761) >> 16;
            let bottom = (2000 + pixel % 64 * 3 + random % noise) / unit * unit;
            let span = Span::new(bottom, bottom + (random >> 8) % 20 / unit * unit + 1, false).unwrap();
            assert!(builder.set_column(pixel % 64, pixel / 64, &[span]));
        }
        builder.build()
    }

    fn exact_len(page: &Page) -> usize {
        let mut body = Vec::new();
        Encoder::new(frame(), 0).encode(page, &mut body);
        body.len()
    }

    #[test]
    fn a_quarter_of_a_pixel_saves_most_of_the_bits_below_it() {
        let page = floor(1, 40);
        let (exact, (_, loose)) = (exact_len(&page), check(&page, 21));
        assert!(loose * 5 < exact * 2, "{loose} of {exact} bytes");
        let (_, wider) = check(&page, 85);
        assert!(wider * 2 < loose, "{wider} and {loose} bytes");
    }

    #[test]
    fn a_floor_that_the_page_cuts_off_takes_hardly_more_than_one_that_lies_free() {
        let at = |height: u32| {
            let mut builder = PageBuilder::default();
            for pixel in 0..PIXELS as u32 {
                let random = pixel.wrapping_mul(2654435761) >> 16;
                let span = Span::new(height.saturating_sub(random % 5), height + 2 + (random >> 8) % 5, false).unwrap();
                assert!(builder.set_column(pixel % 64, pixel / 64, &[span]));
            }
            builder.build()
        };
        for tolerance in [21, 85, 170] {
            let [free, cut] = [at(2000), at(0)].map(|page| check(&page, tolerance).1);
            assert!(cut < free + 128, "{cut} and {free} bytes at {tolerance}");
        }
    }

    #[test]
    fn steps_of_a_scan_are_taken_together() {
        let page = floor(17, 200);
        let (loose, len) = check(&page, 21);
        let exact = exact_len(&page);
        assert!(len * 8 < exact * 7, "{len} of {exact} bytes");
        assert!(loose.columns().flat_map(|(_, _, spans)| spans).all(|span| span.bottom() % 17 == 0));
    }

    #[test]
    fn spans_of_two_kinds_may_meet_on_a_slice_boundary_and_stay_two() {
        let span = |bottom, top, obstacle| Span::new(bottom, top, obstacle).unwrap();
        let mut builder = PageBuilder::default();
        for pixel in 0..PIXELS as u32 {
            let floor = span(2 * SLICE, 2 * SLICE, false);
            let is_shared = pixel % 32 == 1;
            let column = if is_shared { vec![span(300, 400, true), floor] } else { vec![span(300, 800, true)] };
            assert!(builder.set_column(pixel % 64, pixel / 64, &column));
        }
        let (loose, _) = check(&builder.build(), 255);
        assert_eq!(loose.column(1, 0)[0].top(), 2 * SLICE);
    }

    #[test]
    fn a_page_of_inferred_spans_alone_stays_one() {
        let mut builder = PageBuilder::default();
        let mut inferred = Inferred::new();
        for pixel in 0..PIXELS as u32 {
            let (px, py) = (pixel % 64, pixel / 64);
            assert!(builder.set_column(px, py, &[Span::new(300 + px, 310 + px + py % 3, false).unwrap()]));
            assert!(inferred.push(px, py, 1));
        }
        let page = builder.build();
        let (loose, marks) = Encoder::new(frame(), 30).encode_lossy(&page, &inferred, &mut Vec::new());
        assert_eq!(marks, inferred);
        for (px, py, spans) in page.columns() {
            let [found] = loose.column(px, py) else { panic!("one span") };
            assert!(found.bottom() <= spans[0].bottom() && spans[0].top() <= found.top());
            assert!(found.bottom() + 30 >= spans[0].bottom() && found.top() <= spans[0].top() + 30);
        }
    }

    #[test]
    fn spans_of_two_kinds_in_one_slice_stay_apart() {
        let span = |bottom, top, obstacle| Span::new(bottom, top, obstacle).unwrap();
        let mut builder = PageBuilder::default();
        for pixel in 0..PIXELS as u32 {
            let up = pixel * 7 % 30;
            let column = [span(300 + up, 310 + up, false), span(320 + up, 330 + up, true)];
            assert!(builder.set_column(pixel % 64, pixel / 64, &column));
        }
        let (loose, _) = check(&builder.build(), 85);
        assert!(loose.columns().all(|(_, _, column)| column.len() == 2));
    }

    #[test]
    fn a_gap_that_is_closed_joins_spans_of_one_kind() {
        let column = |pixel: u32| {
            let span = |bottom, top, obstacle| Span::new(bottom, top, obstacle).unwrap();
            vec![span(300, 400, true), span(540, 600, pixel.is_multiple_of(2)), span(900, 1000, true)]
        };
        let mut builder = PageBuilder::default();
        assert!((0..PIXELS as u32).all(|pixel| builder.set_column(pixel % 64, pixel / 64, &column(pixel))));
        let (loose, _) = check(&builder.build(), 85);
        assert_eq!((loose.column(0, 0).len(), loose.column(1, 0).len()), (2, 3));
    }
}
