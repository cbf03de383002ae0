//! Choice of the holes of a tile column to close, and of the heights of the inferred floor.
//!
//! For holes up to `k` pixels wide, heights are cut into windows one climb high, four to a climb, so that floors within
//! three quarters of a climb always share a window and floors further apart than a climb never do. In each window,
//! everything that is not floor is *void*. The void that a disc `k + 1` pixels across covers, wherever it fits into the
//! void, is *open*. The remaining void is narrower than the disc everywhere. A pixel of it is closed if
//!
//! - it is more than a quarter of a disc away from open void, measured along void: corners of wide holes stay open, as
//!   do the mouths of bays at the edge of the scan;
//! - there is floor on both sides along at least two of the four axes (rows, columns, diagonals);
//! - the pixel has nothing solid up to a climb above, and nothing below but a ceiling close under the floor: anything
//!   scanned through a hole shows that the hole is real.
//!
//! The height is the mean of the heights interpolated along the axes. All widths from one pixel up to the widest are
//! closed in turn, and no width undoes what a narrower one has closed: a larger `k` never closes less. Everything
//! follows from the spans within [`reach`](Closer::reach) pixels, in integer arithmetic.

use crate::frame::{Frame, PAGE_QUANTA, TILE_PIXELS};
use crate::page::Page;
use crate::plan::PlanOptions;
use std::collections::BTreeSet;

/// Greatest height difference of floors around a hole (m), unless a pixel is larger.
const CLIMB_M: f64 = 0.35;
/// Windows of heights that begin within one climb.
const WINDOWS: i64 = 4;
/// Thickest ceiling that may lie under a hole (m).
const CEILING_M: f64 = 0.6;
/// Least height of the room below that ceiling (m).
const ROOM_M: f64 = 1.5;
/// Fractional bits of heights along an axis.
const FRACTION: u32 = 10;
/// Edge of the examined square of pixels: a tile and its neighbours.
const EDGE: usize = 3 * TILE_PIXELS as usize;
/// First pixel of the tile in the middle, and the pixel after its last.
const CORE: (usize, usize) = (TILE_PIXELS as usize, 2 * TILE_PIXELS as usize);

const _: () = assert!(reach_of(PlanOptions::MOST_FILL_PIXELS as usize) <= TILE_PIXELS as usize);

/// Returns how far the pixels that decide whether a pixel is closed lie from it (pixels), for holes up to `k` pixels
/// wide.
const fn reach_of(k: usize) -> usize {
    let (around, along) = (k + trim_of(k), ray_of(k));
    if around > along { around } else { along }
}

/// Returns the steps along void from an open place within which nothing is closed: the corner of a square hole lies
/// 0.21 discs from the disc.
const fn trim_of(k: usize) -> usize {
    (k + 1) / 4 + 1
}

/// Returns the steps along an axis in which to look for floor: two axes cross a slot of `k` pixels within 1.415 of its
/// width.
const fn ray_of(k: usize) -> usize {
    k + k * 5 / 12 + 1
}

/// Scanned solid span (quanta above the grid's origin).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Scanned {
    bottom: i64,
    /// Twice the thickness, plus 1 for floor.
    thickness: u32,
}

impl Scanned {
    fn top(self) -> i64 {
        self.bottom + i64::from(self.thickness >> 1)
    }

    fn is_floor(self) -> bool {
        self.thickness & 1 == 1
    }
}

/// Scanned spans of a tile column. Memory: 16 KiB, and 16 bytes per span.
#[derive(Debug)]
pub(super) struct ScannedColumn {
    /// Index of each pixel's first span, then the number of spans.
    starts: Vec<u32>,
    spans: Vec<Scanned>,
}

impl ScannedColumn {
    /// Collects the spans of a column's pages with their layers, lowest first.
    pub fn of(pages: &[(i32, Page)]) -> Self {
        let (mut starts, mut spans) = (vec![0], Vec::<Scanned>::new());
        for pixel in 0..(TILE_PIXELS * TILE_PIXELS) as u32 {
            let first = spans.len();
            for (layer, page) in pages {
                let floor = i64::from(*layer) * PAGE_QUANTA;
                for span in page.column(pixel & 63, pixel >> 6) {
                    let (bottom, kind) = (floor + i64::from(span.bottom()), u32::from(!span.is_obstacle()));
                    let thickness = span.top() - span.bottom();
                    match spans[first..].last_mut() {
                        // One span that was cut between two pages.
                        Some(below)
                            if bottom == floor
                                && below.top() == floor
                                && u32::from(below.is_floor()) == kind
                                && below.thickness < u32::MAX / 2 =>
                        {
                            below.thickness += 2 * thickness;
                        }
                        _ => spans.push(Scanned { bottom, thickness: (2 * thickness) | kind }),
                    }
                }
            }
            starts.push(spans.len() as u32);
        }
        Self { starts, spans }
    }

    fn pixel(&self, x: usize, y: usize) -> &[Scanned] {
        let pixel = ((y % 64) << 6) | (x % 64);
        &self.spans[self.starts[pixel] as usize..self.starts[pixel + 1] as usize]
    }
}

/// Tile column and its neighbours, row by row; `None` where nothing was scanned.
pub(super) type Around<'a> = [Option<&'a ScannedColumn>; 9];

fn spans_at<'a>(around: &Around<'a>, x: usize, y: usize) -> &'a [Scanned] {
    around[y / 64 * 3 + x / 64].map_or(&[], |column| column.pixel(x, y))
}

/// Inferred floor in a pixel of the middle column (quanta above the grid's origin).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Fill {
    /// `64·py + px`.
    pub pixel: u16,
    pub bottom: i64,
    /// Equal to the bottom, or one more.
    pub top: i64,
}

/// One bit for each pixel of a tile and its neighbours, row by row.
type Bits = Box<[Row; EDGE]>;
type Row = [u64; 3];

const ONES: Row = [u64::MAX; 3];
const NONE: Row = [0; 3];

fn bits(row: Row) -> Bits {
    Box::new([row; EDGE])
}

fn both(a: Row, b: Row) -> Row {
    [a[0] & b[0], a[1] & b[1], a[2] & b[2]]
}

fn either(a: Row, b: Row) -> Row {
    [a[0] | b[0], a[1] | b[1], a[2] | b[2]]
}

fn not(a: Row) -> Row {
    a.map(|word| !word)
}

/// Shifts `row` down: bit `x` of the result is bit `x + by`, followed at the end by bits of `beyond`. `by` is less than
/// 64.
fn earlier(row: Row, by: usize, beyond: u64) -> Row {
    let next = [row[1], row[2], beyond];
    std::array::from_fn(|at| ((u128::from(next[at]) << 64 | u128::from(row[at])) >> by) as u64)
}

/// Shifts `row` up: bit `x` of the result is bit `x − by`, or 0 before the first. `by` is less than 64.
fn later(row: Row, by: usize) -> Row {
    let before = [0, row[0], row[1]];
    std::array::from_fn(|at| (((u128::from(row[at]) << 64 | u128::from(before[at])) << by) >> 64) as u64)
}

fn has(bits: &[Row; EDGE], x: usize, y: usize) -> bool {
    bits[y][x / 64] >> (x % 64) & 1 == 1
}

/// Finder of holes, with its scratch memory.
pub(crate) struct Closer {
    /// Widest hole, and the width that is being closed now (pixels).
    most: usize,
    widest: usize,
    /// Quarter of a climb, thickest ceiling, lowest room (quanta).
    step: i64,
    ceiling: i64,
    room: i64,
    /// Rows of the disc of each width: first pixel and number of pixels.
    discs: Vec<Vec<(usize, usize)>>,
    floor: Bits,
    /// Floors in window order: number of the quarter climb that holds the top, pixel.
    floors: Vec<(i64, u16)>,
    scratch: [Bits; 3],
}

impl Closer {
    /// Creates a finder of holes up to `widest` pixels wide, 1 to [`PlanOptions::MOST_FILL_PIXELS`].
    pub(super) fn new(frame: &Frame, widest: u8) -> Self {
        let quanta = |metres: f64| (metres / frame.quantum_m()).round().clamp(1.0, 1e12) as i64;
        let most = usize::from(widest.clamp(1, PlanOptions::MOST_FILL_PIXELS));
        Self {
            most,
            widest: most,
            step: (quanta(CLIMB_M.max(frame.pixel_m())) / WINDOWS).max(1),
            ceiling: quanta(CEILING_M),
            room: quanta(ROOM_M),
            discs: (0..=most).map(|width| disc(width + 1)).collect(),
            floor: bits(NONE),
            floors: Vec::new(),
            scratch: [bits(NONE), bits(NONE), bits(NONE)],
        }
    }

    /// Returns how far the pixels that decide whether a pixel is closed lie from it (pixels), for holes up to `widest`
    /// pixels wide.
    pub(crate) fn reach(widest: u8) -> i64 {
        reach_of(usize::from(widest)) as i64
    }

    /// Returns the fills of the middle column, sorted by pixel and height.
    pub(super) fn close(&mut self, around: &Around<'_>) -> Vec<Fill> {
        let mut floors = std::mem::take(&mut self.floors);
        floors.clear();
        for y in 0..EDGE {
            for x in 0..EDGE {
                let tops = spans_at(around, x, y).iter().filter(|span| span.is_floor());
                floors.extend(tops.map(|span| (span.top().div_euclid(self.step), (y * EDGE + x) as u16)));
            }
        }
        floors.sort_unstable();
        let mut fills: BTreeSet<Fill> = BTreeSet::new();
        for width in 1..=self.most {
            self.widest = width;
            self.close_width(around, &floors, &mut fills);
        }
        self.floors = floors;
        fills.into_iter().collect()
    }

    /// Adds the fills of holes of the current width.
    fn close_width(&mut self, around: &Around<'_>, floors: &[(i64, u16)], fills: &mut BTreeSet<Fill>) {
        let mut first = 0;
        let (mut last_window, mut last_range) = (None, 0..0);
        while first < floors.len() {
            // Windows that hold the lowest floor left and were not examined yet.
            let quarter = floors[first].0;
            for window in quarter - WINDOWS + 1..=quarter {
                if last_window.is_some_and(|last| window <= last) {
                    continue;
                }
                last_window = Some(window);
                let from = floors.partition_point(|floor| floor.0 < window);
                let to = floors.partition_point(|floor| floor.0 < window + WINDOWS);
                // The next window often holds the same floors, with the same result.
                if std::mem::replace(&mut last_range, from..to) != (from..to) {
                    self.window(around, window, &floors[from..to], fills);
                }
            }
            first = floors.partition_point(|floor| floor.0 <= quarter);
        }
    }

    /// Adds the fills found among the `floors` of a window.
    fn window(&mut self, around: &Around<'_>, window: i64, floors: &[(i64, u16)], fills: &mut BTreeSet<Fill>) {
        self.floor.fill(NONE);
        for &(_, pixel) in floors {
            let (x, y) = (usize::from(pixel) % EDGE, usize::from(pixel) / EDGE);
            self.floor[y][x / 64] |= 1 << (x % 64);
        }
        let near = CORE.0 - ray_of(self.widest)..CORE.1 + ray_of(self.widest);
        let has_floor = self.floor[near].iter().any(|row| *row != NONE);
        let has_void = self.floor[CORE.0..CORE.1].iter().any(|row| row[1] != u64::MAX);
        if !has_floor || !has_void {
            return;
        }
        self.narrow();
        let heights = window * self.step..(window + WINDOWS) * self.step;
        let climb = WINDOWS * self.step;
        for y in CORE.0..CORE.1 {
            let mut left = self.scratch[0][y][1];
            while left != 0 {
                let x = CORE.0 + left.trailing_zeros() as usize;
                left &= left - 1;
                let pixel = ((y - CORE.0) << 6 | (x - CORE.0)) as u16;
                let Some((bottom, top)) = self.height(around, (x, y), &heights) else { continue };
                // Windows and widths overlap, so most holes are closed in several of them: fill each once.
                let near = |height: i64| Fill { pixel, bottom: height, top: i64::MIN };
                let mut fills_near = fills.range(near(bottom - climb - 1)..near(top + climb + 1));
                let again = fills_near.any(|fill| bottom <= fill.top + climb);
                if !again && self.is_free(spans_at(around, x, y), bottom, top) {
                    fills.insert(Fill { pixel, bottom, top });
                }
            }
        }
    }

    /// Sets the first scratch to the void that is narrow and not next to open void.
    fn narrow(&mut self) {
        let Self { floor, discs, scratch: [narrow, open, fits], widest, .. } = self;
        let disc = &discs[*widest];
        // Positions of the disc (first pixel and row) that lie in void; all is void beyond the edge.
        fits.fill(ONES);
        let mut run = bits(NONE);
        for (number, &(_, len)) in disc.iter().enumerate() {
            // The rows of the disc are symmetric: the first row of each length stands for all.
            if disc[..number].iter().any(|row| row.1 == len) {
                continue;
            }
            for (run, floor) in run.iter_mut().zip(floor.iter()) {
                *run = void_run(not(*floor), len);
            }
            for (down, &(start, _)) in disc.iter().enumerate().filter(|(_, row)| row.1 == len) {
                for (fits, run) in fits.iter_mut().zip(&run[down..]) {
                    *fits = both(*fits, earlier(*run, start, u64::MAX));
                }
            }
        }
        // Pixels that the disc covers there.
        open.fill(NONE);
        for (number, &(_, len)) in disc.iter().enumerate() {
            if disc[..number].iter().any(|row| row.1 == len) {
                continue;
            }
            for (run, fits) in run.iter_mut().zip(fits.iter()) {
                *run = covered_run(*fits, len);
            }
            for (down, &(start, _)) in disc.iter().enumerate().filter(|(_, row)| row.1 == len) {
                for (open, run) in open[down..].iter_mut().zip(run.iter()) {
                    *open = either(*open, later(*run, start));
                }
            }
        }
        for (narrow, (open, floor)) in narrow.iter_mut().zip(open.iter().zip(floor.iter())) {
            *narrow = not(either(*open, *floor));
        }
        for _ in 0..trim_of(*widest) {
            for (y, fits) in fits.iter_mut().enumerate() {
                let rows = &open[y.saturating_sub(1)..(y + 2).min(EDGE)];
                let near = rows.iter().fold(NONE, |near, row| either(near, *row));
                let near = either(near, either(earlier(near, 1, 0), later(near, 1)));
                *fits = both(near, narrow[y]);
            }
            for ((narrow, open), more) in narrow.iter_mut().zip(open.iter_mut()).zip(fits.iter()) {
                *open = either(*open, *more);
                *narrow = both(*narrow, not(*more));
            }
        }
    }

    /// Returns the mean height at a pixel, rounded down and up, between floors on both sides of it with tops in
    /// `heights`. `None` if fewer than two axes have floor on both sides.
    fn height(
        &self,
        around: &Around<'_>,
        (x, y): (usize, usize),
        heights: &std::ops::Range<i64>,
    ) -> Option<(i64, i64)> {
        let top_of = |(x, y): (usize, usize)| {
            let floors = spans_at(around, x, y).iter().filter(|span| span.is_floor());
            floors.map(|span| span.top()).filter(|top| heights.contains(top)).max()
        };
        let hit = |dx: isize, dy: isize| {
            (1..=ray_of(self.widest) as isize).find_map(|step| {
                let at = (x.wrapping_add_signed(step * dx), y.wrapping_add_signed(step * dy));
                has(&self.floor, at.0, at.1).then(|| Some((step as i64, top_of(at)?))).flatten()
            })
        };
        let (mut axes, mut sum) = (0, 0);
        for (dx, dy) in [(1, 0), (0, 1), (1, 1), (1, -1)] {
            let (Some((a, top_a)), Some((b, top_b))) = (hit(dx, dy), hit(-dx, -dy)) else { continue };
            // Relative to the bottom of the window, so that nothing overflows.
            let weighted = (top_a - heights.start) * b + (top_b - heights.start) * a;
            axes += 1;
            sum += (weighted << FRACTION).div_euclid(a + b);
        }
        let mean = |sum: i64| heights.start + sum.div_euclid(axes << FRACTION);
        (axes >= 2).then(|| (mean(sum), mean(sum + (axes << FRACTION) - 1)))
    }

    /// Returns whether floor from `bottom` to `top` fits into a pixel with these spans, lowest first.
    fn is_free(&self, spans: &[Scanned], bottom: i64, top: i64) -> bool {
        let below = spans.partition_point(|span| span.top() < bottom);
        if spans.get(below).is_some_and(|above| above.bottom <= top + WINDOWS * self.step) {
            return false;
        }
        match &spans[..below] {
            [] => true,
            [.., room, ceiling] => bottom - ceiling.top() <= self.ceiling && ceiling.bottom - room.top() >= self.room,
            // A floor seen through the hole.
            [_] => false,
        }
    }
}

/// Returns the rows of a disc `across` pixels across: first pixel and number of pixels.
fn disc(across: usize) -> Vec<(usize, usize)> {
    let inside = |x: usize, y: usize| {
        let [x, y] = [x, y].map(|at| (2 * at + 1).abs_diff(across));
        4 * (x * x + y * y) <= (2 * across - 1).pow(2)
    };
    let row = |y: usize| {
        let start = (0..across).find(|&x| inside(x, y)).unwrap_or(across / 2);
        (start, across - 2 * start)
    };
    (0..across).map(row).collect()
}

/// Returns the pixels at which a run of `len` pixels of `void` begins.
fn void_run(void: Row, len: usize) -> Row {
    let (mut run, mut have) = (void, 1);
    while have < len {
        let by = have.min(len - have);
        run = both(run, earlier(run, by, u64::MAX));
        have += by;
    }
    run
}

/// Returns the pixels covered by runs of `len` pixels that begin at `starts`.
fn covered_run(starts: Row, len: usize) -> Row {
    let (mut run, mut have) = (starts, 1);
    while have < len {
        let by = have.min(len - have);
        run = either(run, later(run, by));
        have += by;
    }
    run
}
