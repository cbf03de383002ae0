//! Gaps: the open pixels behind a rim.
//!
//! A gap is flooded by rows of a tile: 64 pixels, each a bit. Its pixels are listed only if it is enclosed.

use super::rims::Rim;
use super::{NOTHING, Sets, Survey, TILE, cell};
use crate::reach::Needs;
use crate::reach::intervals::NONE;
use crate::reach::pawn::{Grid, WAYS};
use crate::reach::standing::{Block, Kind, StandingPlaces, Tile};
use std::ops::ControlFlow;

/// Most open pixels of an enclosed gap.
const MOST_PIXELS: usize = 1 << 16;

/// Content of a pixel at the height of a rim.
#[derive(Clone, Copy, PartialEq)]
pub enum There {
    /// Nothing to stand on; depth of the ground, if any (quanta).
    Open(Option<i32>),
    Floor,
    Matter,
    /// Outside of the scan.
    Outside,
}

/// Open pixels behind a rim.
#[derive(Debug)]
pub struct Gap {
    pub level: i32,
    /// Empty if the gap is not enclosed.
    pub pixels: Vec<GapPixel>,
    pub is_closed: bool,
    /// Earlier gaps of the same height that hold a part of its pixels.
    shared: Vec<u32>,
    /// Whether another gap that is too far below holds a part of its pixels.
    is_above: bool,
}

/// Open pixel of a gap.
#[derive(Debug, Clone, Copy)]
pub struct GapPixel {
    pub pixel: [i32; 2],
    /// Number of its tile.
    tile: u32,
    /// Depth of the ground below the gap's height, if any (quanta).
    pub depth: Option<i32>,
}

/// Gaps of a search, and the pixels that their floods visited.
#[derive(Debug, Default)]
pub struct Gaps {
    /// By height.
    pub all: Vec<Gap>,
    /// The next gap, if pages were missing for it.
    begun: Option<BegunGap>,
    /// For each tile of the standing places its pixels at the height of the last gap.
    rows: Vec<Option<Box<Rows>>>,
    /// Likewise the number of the last gap at each pixel. Empty for tiles without gaps.
    marks: Vec<Box<[u32]>>,
    /// Likewise the pixels that hold nothing.
    voids: Vec<Option<Box<Voids>>>,
}

/// The pixels of a tile, a bit for each; one word is a row along x.
#[derive(Debug, Clone)]
struct Rows {
    level: i32,
    /// One bit for each row whose pixels are known at this level.
    known: u64,
    open: [u64; TILE],
    /// Number of the last gap in the tile, and its pixels.
    gap: u32,
    reached: [u64; TILE],
}

impl Rows {
    const UNKNOWN: Self = Self { level: 0, known: 0, open: [0; TILE], gap: NOTHING, reached: [0; TILE] };
}

/// A gap before its end.
#[derive(Debug)]
struct BegunGap {
    level: i32,
    is_closed: bool,
    shared: Vec<u32>,
    /// Numbers of its tiles.
    tiles: Vec<u32>,
    /// Number of its pixels.
    count: usize,
    /// Pixels still to be visited.
    seeds: Vec<Seed>,
}

/// Pixels in one row of the tile `at`.
#[derive(Debug, Clone, Copy)]
struct Seed {
    at: [i32; 2],
    row: usize,
    bits: u64,
}

impl Seed {
    fn corner(&self) -> [i32; 2] {
        self.at.map(|at| at << 6)
    }

    /// Returns the pixels beside these in the same row of the tiles beside, and in the rows before and after.
    fn around(&self) -> impl Iterator<Item = Self> {
        let Self { at: [x, y], row, bits } = *self;
        let last = TILE - 1;
        let around = [
            Self { at: [x - 1, y], row, bits: (bits & 1) << last },
            Self { at: [x + 1, y], row, bits: bits >> last },
            Self { at: [x, y - i32::from(row == 0)], row: row.checked_sub(1).unwrap_or(last), bits },
            Self { at: [x, y + i32::from(row == last)], row: if row == last { 0 } else { row + 1 }, bits },
        ];
        around.into_iter().filter(|seed| seed.bits != 0)
    }
}

/// The pixels of a tile that hold nothing, by rows.
#[derive(Debug, Clone)]
struct Voids {
    all: [u64; TILE],
    /// Those that lead to at most [`MOST_PIXELS`] of their kind.
    enclosed: [u64; TILE],
    /// Those that lead to the end of the scan, or to more.
    endless: [u64; TILE],
}

impl Voids {
    fn of(tile: &Tile) -> Self {
        if tile.blocks.is_empty() {
            return Self { all: [!0; TILE], enclosed: [0; TILE], endless: [0; TILE] };
        }
        let is_void = |row: usize, bit: i32| u64::from(tile.column([bit, row as i32]).is_empty()) << bit;
        let row = |row: usize| (0..TILE as i32).fold(0, |bits, bit| bits | is_void(row, bit));
        Self { all: std::array::from_fn(row), enclosed: [0; TILE], endless: [0; TILE] }
    }
}

/// Returns the positions of the bits that are set.
fn ones(mut bits: u64) -> impl Iterator<Item = i32> {
    std::iter::from_fn(move || {
        let first = (bits != 0).then(|| bits.trailing_zeros() as i32)?;
        bits &= bits - 1;
        Some(first)
    })
}

/// Returns the bits of `free` that are connected with one of `seeds`, which are free, along the row.
fn spread(seeds: u64, free: u64) -> u64 {
    let (mut up, mut down) = (seeds, seeds);
    let (mut free_up, mut free_down) = (free, free);
    for by in [1, 2, 4, 8, 16, 32] {
        up |= free_up & up << by;
        free_up &= free_up << by;
        down |= free_down & down >> by;
        free_down &= free_down >> by;
    }
    up | down
}

/// Returns the numbers of the last gaps at the pixels of a tile, in a list that grows to the number of `tiles`.
fn marks_of(marks: &mut Vec<Box<[u32]>>, tiles: usize, tile: usize) -> &mut [u32] {
    if marks.len() <= tile {
        marks.resize_with(tiles, Box::default);
    }
    if marks[tile].is_empty() {
        marks[tile] = vec![NOTHING; TILE * TILE].into();
    }
    &mut marks[tile]
}

impl Grid {
    /// Returns the content of a pixel with these blocks at `level`.
    #[inline]
    fn content(&self, column: &[Block], level: i32) -> There {
        if column.is_empty() {
            return There::Open(None);
        }
        // Few blocks lie above one another.
        let (below, above) = column.split_at(column.iter().take_while(|block| block.top <= level + self.up).count());
        let feet = below.last().map_or(level, |block| block.top.max(level));
        if above.first().is_some_and(|block| block.bottom - feet < self.height) {
            return There::Matter;
        }
        let Some(block) = below.last() else { return There::Open(None) };
        if level - block.top <= self.drop && block.kind != Kind::Bridge {
            return There::Floor;
        }
        let depth = (block.foot != NONE).then(|| level - block.foot);
        let is_deep = depth.is_none_or(|depth| depth > self.drop);
        if is_deep { There::Open(depth) } else { There::Floor }
    }
}

impl StandingPlaces {
    /// Returns the content of a pixel of a known tile at `level`.
    #[inline]
    pub fn there_in(&self, tile: usize, pixel: [i32; 2], level: i32) -> There {
        self.grid.content(self.tiles[tile].column(pixel), level)
    }

    /// Returns which pixels of a row of a known tile are open at `level`.
    fn open_row(&self, tile: usize, row: usize, level: i32) -> u64 {
        if self.tiles[tile].blocks.is_empty() {
            return !0;
        }
        let tile = &self.tiles[tile];
        let ends = tile.starts[row * TILE..=(row + 1) * TILE].windows(2);
        ends.zip(0..).fold(0, |bits, (ends, bit)| {
            let column = &tile.blocks[ends[0] as usize..ends[1] as usize];
            bits | u64::from(matches!(self.grid.content(column, level), There::Open(_))) << bit
        })
    }
}

impl Survey<'_> {
    /// Finds the gap of a rim, whose level is no lower than those before.
    pub fn flood(&mut self, rim: &Rim) -> Needs<()> {
        let mut begun = self.found.gaps.begun.take().unwrap_or_else(|| {
            let up = self.standing.grid.up;
            let brinks = rim.brinks.iter();
            let near = brinks.filter(|brink| (self.region.tops[brink.place as usize] - rim.level).abs() <= up);
            let seed = |[i, j]: [i32; 2]| Seed { at: [i >> 6, j >> 6], row: (j & 63) as usize, bits: 1 << (i & 63) };
            BegunGap {
                level: rim.level,
                is_closed: true,
                shared: Vec::new(),
                tiles: Vec::new(),
                count: 0,
                seeds: near.map(|brink| seed(self.beyond(brink))).collect(),
            }
        });
        // A gap that is not enclosed need not be explored further.
        while begun.is_closed
            && let Some(seed) = begun.seeds.pop()
        {
            if let ControlFlow::Break(stop) = self.visit(&mut begun, seed) {
                begun.seeds.push(seed);
                self.found.gaps.begun = Some(begun);
                return ControlFlow::Break(stop);
            }
            begun.is_closed &= begun.count <= MOST_PIXELS;
        }
        let pixels = if begun.is_closed { self.pixels_of(&begun) } else { Vec::new() };
        let BegunGap { level, is_closed, shared, .. } = begun;
        self.found.gaps.all.push(Gap { level, pixels, is_closed, shared, is_above: false });
        ControlFlow::Continue(())
    }

    /// Adds the open pixels of a row that are connected with a seed to the next gap. Those of an earlier gap of the same
    /// height are not flooded again.
    fn visit(&mut self, begun: &mut BegunGap, seed: Seed) -> Needs<()> {
        let (corner, row) = (seed.corner(), seed.row);
        if !self.standing.grid.is_inside(corner) {
            begun.is_closed = false;
            return ControlFlow::Continue(());
        }
        let tile = self.tile(corner)?;
        let number = self.found.gaps.all.len() as u32;
        let rows = self.rows(tile, row, begun.level);
        if rows.gap != number {
            (rows.gap, rows.reached) = (number, [0; TILE]);
            begun.tiles.push(tile as u32);
        }
        let free = rows.open[row] & !rows.reached[row];
        let mut found = spread(seed.bits & free, free);
        if self.is_endless(tile, Seed { bits: found, ..seed })? {
            begun.is_closed = false;
            return ControlFlow::Continue(());
        }
        let tiles = self.standing.tiles.len();
        let gaps = &mut self.found.gaps;
        let has_equal = gaps.all.last().is_some_and(|before| before.level == begun.level);
        let marks = marks_of(&mut gaps.marks, tiles, tile);
        for bit in ones(found) {
            let mark = &mut marks[cell([bit, row as i32])];
            let before = gaps.all.get(*mark as usize).filter(|before| has_equal && before.level == begun.level);
            if let Some(before) = before {
                begun.is_closed &= before.is_closed;
                if begun.shared.last() != Some(mark) {
                    begun.shared.push(*mark);
                }
                found &= !(1 << bit);
            } else {
                *mark = number;
            }
        }
        if let Some(rows) = &mut gaps.rows[tile] {
            rows.reached[row] |= found;
        }
        begun.count += found.count_ones() as usize;
        begun.seeds.extend(Seed { bits: found, ..seed }.around());
        ControlFlow::Continue(())
    }

    /// Returns what is known of a tile, with one of its rows.
    fn rows(&mut self, tile: usize, row: usize, level: i32) -> &mut Rows {
        let all = &mut self.found.gaps.rows;
        if all.len() <= tile {
            all.resize(self.standing.tiles.len(), None);
        }
        let rows = all[tile].get_or_insert_with(|| Box::new(Rows::UNKNOWN));
        if rows.level != level {
            (rows.level, rows.known) = (level, 0);
        }
        if rows.known >> row & 1 == 0 {
            rows.known |= 1 << row;
            rows.open[row] = self.standing.open_row(tile, row, level);
        }
        rows
    }

    /// Returns the pixels of the last gap.
    fn pixels_of(&self, begun: &BegunGap) -> Vec<GapPixel> {
        let mut pixels = Vec::with_capacity(begun.count);
        for &tile in &begun.tiles {
            let Some(rows) = &self.found.gaps.rows[tile as usize] else { continue };
            let corner = self.standing.tiles[tile as usize].at.map(|at| at << 6);
            for (row, bits) in (0..).zip(rows.reached) {
                pixels.extend(ones(bits).map(|bit| {
                    let pixel = [corner[0] + bit, corner[1] + row];
                    let depth = match self.standing.there_in(tile as usize, pixel, begun.level) {
                        There::Open(depth) => depth,
                        _ => None,
                    };
                    GapPixel { pixel, tile, depth }
                }));
            }
        }
        pixels
    }

    /// Returns whether one of the pixels holds nothing and leads over such pixels to the end of the scan, or to more than
    /// [`MOST_PIXELS`]. `tile` is the number of their tile.
    fn is_endless(&mut self, tile: usize, seed: Seed) -> Needs<bool> {
        loop {
            let voids = self.voids(tile);
            let bits = seed.bits & voids.all[seed.row];
            if bits & voids.endless[seed.row] != 0 {
                return ControlFlow::Continue(true);
            }
            let Some(bit) = ones(bits & !voids.enclosed[seed.row]).next() else {
                return ControlFlow::Continue(false);
            };
            let mut found = Vec::new();
            let is_endless = self.leads_out(Seed { bits: 1 << bit, ..seed }, &mut found);
            if !matches!(is_endless, ControlFlow::Continue(false)) {
                for (tile, row, bits) in found {
                    let voids = self.voids(tile);
                    voids.enclosed[row] &= !bits;
                    voids.endless[row] |= if is_endless.is_continue() { bits } else { 0 };
                }
            }
            is_endless?;
        }
    }

    /// Marks the pixels that hold nothing around a seed as enclosed, until it is known whether they are endless; lists
    /// them by tile and row.
    fn leads_out(&mut self, seed: Seed, found: &mut Vec<(usize, usize, u64)>) -> Needs<bool> {
        let (mut seeds, mut count) = (vec![seed], 0);
        while let Some(seed) = seeds.pop() {
            if !self.standing.grid.is_inside(seed.corner()) {
                return ControlFlow::Continue(true);
            }
            let tile = self.tile(seed.corner())?;
            let voids = self.voids(tile);
            let free = voids.all[seed.row] & !voids.enclosed[seed.row];
            let own = spread(seed.bits & free, free);
            voids.enclosed[seed.row] |= own;
            found.push((tile, seed.row, own));
            count += own.count_ones() as usize;
            if own & voids.endless[seed.row] != 0 || count > MOST_PIXELS {
                return ControlFlow::Continue(true);
            }
            // Straight ahead, the end of the scan is reached after fewer pixels than by circles.
            seeds.extend(Seed { bits: own, ..seed }.around());
        }
        ControlFlow::Continue(false)
    }

    /// Returns the pixels of a tile that hold nothing.
    fn voids(&mut self, tile: usize) -> &mut Voids {
        let all = &mut self.found.gaps.voids;
        if all.len() <= tile {
            all.resize(self.standing.tiles.len(), None);
        }
        all[tile].get_or_insert_with(|| Box::new(Voids::of(&self.standing.tiles[tile])))
    }

    /// Returns the sets of enclosed gaps that are one. A pixel of several gaps of a set is kept in the lowest alone.
    pub fn joined_gaps(&mut self) -> Sets {
        let Gaps { all, marks, .. } = &mut self.found.gaps;
        let mut sets = Sets::new(all.len());
        marks.iter_mut().for_each(|marks| marks.fill(NOTHING));
        let levels: Vec<i32> = all.iter().map(|gap| gap.level).collect();
        for (number, gap) in (0..).zip(all).filter(|(_, gap)| gap.is_closed) {
            gap.shared.iter().for_each(|other| sets.join(number, *other));
            let (level, is_above) = (gap.level, &mut gap.is_above);
            gap.pixels.retain(|own| {
                let before = std::mem::replace(&mut marks[own.tile as usize][cell(own.pixel)], number);
                if before == NOTHING {
                    return true;
                }
                let is_one = level - levels[before as usize] < self.standing.grid.height;
                if is_one {
                    sets.join(number, before);
                }
                *is_above |= !is_one;
                !is_one
            });
        }
        sets
    }

    /// Returns gaps, in order of their heights, as one gap.
    pub fn joined(&self, members: &[u32]) -> Gap {
        let all = || members.iter().map(|gap| &self.found.gaps.all[*gap as usize]);
        let mut pixels: Vec<GapPixel> = all().flat_map(|gap| gap.pixels.iter().copied()).collect();
        let is_above = all().any(|gap| gap.is_above);
        // Gaps far above one another may be joined by others.
        if members.len() > 1 && is_above {
            // The sort is stable: of a pixel of several gaps that of the lowest stays.
            pixels.sort_by_key(|own| own.pixel);
            pixels.dedup_by_key(|own| own.pixel);
        }
        let level = self.found.gaps.all[members[0] as usize].level;
        Gap { level, pixels, is_closed: all().all(|gap| gap.is_closed), shared: Vec::new(), is_above }
    }

    /// Returns true if at least half of the pixels around an enclosed gap hold nothing solid at its height. `number`
    /// marks its pixels.
    pub fn is_in_floor(&mut self, gap: &Gap, number: u32) -> Needs<bool> {
        let inside = 2 * self.found.gaps.all.len() as u32 + 2 * number;
        for own in &gap.pixels {
            self.found.gaps.marks[own.tile as usize][cell(own.pixel)] = inside;
        }
        let (mut border, mut matter) = (0usize, 0usize);
        for own in &gap.pixels {
            for way in WAYS {
                let to = [own.pixel[0] + way[0], own.pixel[1] + way[1]];
                // An enclosed gap was flooded, with all pixels around it.
                let tile = self.tile(to)?;
                let marks = marks_of(&mut self.found.gaps.marks, self.standing.tiles.len(), tile);
                let mark = &mut marks[cell(to)];
                if *mark & !1 != inside {
                    *mark = inside + 1;
                    border += 1;
                    matter += usize::from(self.standing.there_in(tile, to, gap.level) == There::Matter);
                }
            }
        }
        ControlFlow::Continue(border - matter >= matter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_seed_spreads_over_its_run(seeds: u64, free in any::<[u64; 2]>()) {
            // Long runs, too.
            let free = free[0] | free[1];
            let seeds = seeds & seeds.rotate_left(7) & free;
            let runs = ones(seeds).fold(0, |all, bit| {
                let ahead = (bit..64).take_while(|bit| free >> bit & 1 == 1);
                let back = (0..bit).rev().take_while(|bit| free >> bit & 1 == 1);
                ahead.chain(back).fold(all, |all, bit| all | 1 << bit)
            });
            prop_assert_eq!(spread(seeds, free), runs);
        }
    }
}
