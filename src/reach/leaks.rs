//! Leaks: where a region ends although nothing is in the way.
//!
//! A pixel is *open* at a height if the body fits there and nothing supports the middle of the feet within
//! [`Pawn::max_drop`](super::Pawn::max_drop): the ground was not scanned, or is deeper. The steps from standing places
//! to open pixels are *brinks*; brinks within two pixels of each other make a *rim*. The rim decides what lies below a
//! leak: it is split where the ground below ends, and where its depth changes by more than the climb height from one
//! brink to the next. Stretches narrower than half of the pawn count as the longest one beside them.
//!
//! From each rim the open pixels are flooded at its height: they are its *gap*. A gap that reaches the end of the scan,
//! or has more than 2¹⁶ pixels, is not enclosed. Pixels that hold nothing are open at every height, so whether they lead
//! that far is decided once for all rims: most gaps end there after few pixels. Enclosed gaps that share a pixel are one
//! gap if their heights differ by no more than the pawn's; the depth below a pixel is then that from the lowest of them.
//! Each stretch of a rim is a leak:
//!
//! - **hole**: the gap is enclosed, and nothing was scanned below the stretch, or at least half of the gap's border is
//!   floor; stretches of one gap with the same depth are one hole, and a gap with several holes is divided by depth;
//! - **edge**: the gap is not enclosed, and nothing was scanned below the stretch;
//! - **ledge**: all others: the ground below is deeper than the pawn steps down.
//!
//! A gap narrower than half of the pawn is not a leak: a walker passes over it, and a scan has many such gaps.

use super::intervals::NONE;
use super::pawn::WAYS;
use super::region::{Region, middle};
use super::standing::{Block, Kind, StandingPlaces};
use super::tiles::TileNumbers;
use super::{Needs, answer};
use crate::Result;
use crate::query::Answer;
use crate::store::Snapshot;
use nalgebra::Point3;
use std::ops::ControlFlow;

/// Most open pixels of an enclosed gap.
const MOST_PIXELS: usize = 1 << 16;
/// Greatest distance between brinks of one rim (pixels).
const TOGETHER: i32 = 2;
/// Edge of a tile (pixels).
const TILE: usize = 64;
/// Stands for no number.
const NOTHING: u32 = u32::MAX;

/// Kind of a leak.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum LeakKind {
    /// A hole in a floor.
    Hole,
    /// The edge of the scan.
    Edge,
    /// A drop deeper than the pawn steps down.
    Ledge,
}

impl LeakKind {
    /// Returns the name that `slicetool reach` writes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hole => "hole",
            Self::Edge => "edge",
            Self::Ledge => "ledge",
        }
    }
}

/// A place where a region ends although nothing is in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Leak {
    /// Middle of the leak, at the height of the rim (m): the open pixel of a hole, or the place on another rim, that is
    /// nearest to the mean of all.
    pub at: Point3<f64>,
    /// Greatest extent along x or y, of the hole itself or else of the rim (m).
    pub width: f64,
    /// Depth of the ground below the rim (m): the median along the rim; `None` if nothing was scanned below.
    pub drop: Option<f64>,
    /// Kind of the leak.
    pub kind: LeakKind,
}

/// Content of a pixel at the height of a rim.
#[derive(Clone, Copy, PartialEq)]
enum There {
    /// Nothing to stand on; depth of the ground, if any (quanta).
    Open(Option<i32>),
    Floor,
    Matter,
    /// Outside of the scan.
    Outside,
}

/// A search for the leaks of a region that can wait for pages.
#[derive(Debug)]
pub struct LeakSearch<'a> {
    region: &'a Region,
    found: Found,
}

impl<'a> LeakSearch<'a> {
    /// Creates a search for all leaks of `region`.
    pub fn new(region: &'a Region) -> Self {
        Self { region, found: Found::default() }
    }

    /// Continues to the end, or until pages are missing: load them and call again with the standing places of the
    /// region. Returns all leaks, sorted by place (y, x, z). Needs the pages of the tiles that hold open pixels, and of
    /// those around them. Fails if a tile holds more spans than any scan has ([`Error::Limit`](crate::Error::Limit)).
    pub fn find(&mut self, standing: &mut StandingPlaces, set: &Snapshot) -> Result<Answer<Vec<Leak>>> {
        answer(Survey { region: self.region, found: &mut self.found, standing, set, last: None }.leaks())
    }
}

/// Results of a search before its end.
#[derive(Debug, Default)]
struct Found {
    brinks: Vec<Brink>,
    /// Number of places whose brinks are known.
    seen: u32,
    /// By height, the next one last.
    rims: Option<Vec<Rim>>,
    stretches: Vec<Stretch>,
    gaps: Vec<Gap>,
    /// The next gap, if pages were missing for it.
    begun: Option<BegunGap>,
    /// For each tile of the standing places, twice the number of the last gap that was flooded at each pixel, plus one
    /// on the border of the gap. Empty for tiles without gaps.
    marks: Vec<Box<[u32]>>,
    /// Likewise for the pixels that hold nothing.
    voids: Vec<Box<[Void]>>,
}

/// Brinks near each other.
#[derive(Debug)]
struct Rim {
    /// Median height: a rim beside stairs has a height for each tread.
    level: i32,
    brinks: Vec<Brink>,
    /// The brinks of each of its stretches.
    stretches: Vec<Vec<Brink>>,
}

/// Number of the last brink at each pixel, by tile.
struct Firsts {
    numbers: TileNumbers,
    tiles: Vec<Box<[u32; TILE * TILE]>>,
}

impl Firsts {
    /// Returns the numbers from one pixel of row `j` to another one in the same tile; `None` if the tile has no brink.
    fn row(&self, [from, to]: [i32; 2], j: i32) -> Option<&[u32]> {
        let first = ((j & 63) << 6 | from & 63) as usize;
        let tile = &self.tiles[self.numbers.get([from >> 6, j >> 6])?];
        Some(&tile[first..first + (to - from) as usize + 1])
    }

    fn put(&mut self, pixel: [i32; 2], number: u32) -> u32 {
        let at = [pixel[0] >> 6, pixel[1] >> 6];
        let tile = match self.numbers.get(at) {
            Some(tile) => tile,
            None => {
                self.numbers.add(at);
                self.tiles.push(Box::new([NOTHING; TILE * TILE]));
                self.tiles.len() - 1
            }
        };
        std::mem::replace(&mut self.tiles[tile][cell(pixel)], number)
    }
}

/// Where the pixels that hold nothing lead.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Void {
    Unknown,
    /// To at most [`MOST_PIXELS`] of their kind.
    Enclosed,
    /// To the end of the scan, or to more.
    Endless,
}

/// Returns the number of a pixel in its tile.
fn cell([i, j]: [i32; 2]) -> usize {
    ((j & 63) << 6 | i & 63) as usize
}

/// Disjoint sets of numbers.
struct Sets(Vec<u32>);

impl Sets {
    fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    fn root(&mut self, mut item: u32) -> u32 {
        while self.0[item as usize] != item {
            let above = self.0[self.0[item as usize] as usize];
            self.0[item as usize] = above;
            item = above;
        }
        item
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// Returns the members of each set, ordered by their first.
    fn members(&mut self) -> Vec<Vec<u32>> {
        let mut members: Vec<Vec<u32>> = Vec::new();
        let mut number_of = vec![NOTHING; self.0.len()];
        for item in 0..self.0.len() as u32 {
            let number = &mut number_of[self.root(item) as usize];
            if *number == NOTHING {
                *number = members.len() as u32;
                members.push(Vec::new());
            }
            members[*number as usize].push(item);
        }
        members
    }
}

/// A step from a standing place to an open pixel.
#[derive(Debug, Clone, Copy)]
struct Brink {
    place: u32,
    way: usize,
    /// Depth of the ground, if any (quanta).
    depth: Option<i32>,
}

/// A gap whose first pixels have their neighbours.
#[derive(Debug)]
struct BegunGap {
    gap: Gap,
    done: usize,
}

/// Open pixels behind a rim.
#[derive(Debug)]
struct Gap {
    level: i32,
    /// Empty if the gap is not enclosed.
    pixels: Vec<GapPixel>,
    is_closed: bool,
    /// Earlier gaps of the same height that hold a part of its pixels.
    shared: Vec<u32>,
}

/// Open pixel of a gap.
#[derive(Debug, Clone, Copy)]
struct GapPixel {
    pixel: [i32; 2],
    /// Number of its tile.
    tile: u32,
    /// Depth of the ground below the gap's height, if any (quanta).
    depth: Option<i32>,
}

/// Neighbouring brinks of a rim with similar depth.
#[derive(Debug)]
struct Stretch {
    brinks: Vec<Brink>,
    /// Number of its gap.
    gap: u32,
}

/// Returns the median depth; `None` if there is no ground below most of the brinks.
fn depth_of(brinks: &[Brink]) -> Option<i32> {
    let mut depths: Vec<i32> = brinks.iter().filter_map(|brink| brink.depth).collect();
    depths.sort_unstable();
    depths.get(depths.len() / 2).copied().filter(|_| 2 * depths.len() >= brinks.len())
}

impl Stretch {
    fn depth(&self) -> Option<i32> {
        depth_of(&self.brinks)
    }

    /// Returns the least and the greatest depth.
    fn depths(&self) -> Option<[i32; 2]> {
        self.depth()?;
        let depths = || self.brinks.iter().filter_map(|brink| brink.depth);
        Some([depths().min()?, depths().max()?])
    }
}

struct Survey<'a> {
    region: &'a Region,
    found: &'a mut Found,
    standing: &'a mut StandingPlaces,
    set: &'a Snapshot,
    /// The last tile and its number.
    last: Option<([i32; 2], usize)>,
}

/// Returns what is known of a pixel, in a list that grows to the number of `tiles`.
fn known<T: Copy>(lists: &mut Vec<Box<[T]>>, tiles: usize, tile: usize, pixel: [i32; 2], nothing: T) -> &mut T {
    if lists.len() <= tile {
        lists.resize_with(tiles, Box::default);
    }
    if lists[tile].is_empty() {
        lists[tile] = vec![nothing; TILE * TILE].into();
    }
    &mut lists[tile][cell(pixel)]
}

impl Survey<'_> {
    fn leaks(mut self) -> Needs<Vec<Leak>> {
        self.brinks()?;
        let mut rims = match self.found.rims.take() {
            Some(rims) => rims,
            None => {
                let brinks = std::mem::take(&mut self.found.brinks);
                let mut rims = self.rims(&brinks);
                // By height, so that gaps of the same height follow each other and need one flood.
                rims.sort_by_key(|rim| rim.level);
                rims.reverse();
                rims
            }
        };
        while let Some(rim) = rims.pop() {
            if let ControlFlow::Break(stop) = self.flood(&rim) {
                rims.push(rim);
                self.found.rims = Some(rims);
                return ControlFlow::Break(stop);
            }
            let gap = self.found.gaps.len() as u32 - 1;
            self.found.stretches.extend(rim.stretches.into_iter().map(|brinks| Stretch { brinks, gap }));
        }
        let leaks = self.leaks_of_gaps();
        // The next call starts another search.
        *self.found = Found::default();
        leaks
    }

    fn leaks_of_gaps(&mut self) -> Needs<Vec<Leak>> {
        let mut sets = self.joined_gaps();
        let mut stretches_of: Vec<Vec<Stretch>> = Vec::new();
        stretches_of.resize_with(self.found.gaps.len(), Vec::new);
        for stretch in std::mem::take(&mut self.found.stretches) {
            stretches_of[sets.root(stretch.gap) as usize].push(stretch);
        }
        let mut leaks = Vec::new();
        for members in sets.members() {
            let stretches = std::mem::take(&mut stretches_of[members[0] as usize]);
            let gap = self.joined(&members);
            if gap.is_closed && (gap.pixels.is_empty() || self.is_narrow(&gap)) {
                continue;
            }
            let is_in_floor = gap.is_closed && self.is_in_floor(&gap, members[0])?;
            let (holes, others): (Vec<Stretch>, Vec<Stretch>) =
                stretches.into_iter().partition(|stretch| gap.is_closed && (is_in_floor || stretch.depth().is_none()));
            for stretch in others {
                let width = self.rim_width(&stretch)?;
                if width >= self.standing.grid.pawn.body.half().min() {
                    leaks.push(self.leak(&stretch, width, None));
                }
            }
            let holes = self.alike(holes);
            let is_one = holes.len() == 1;
            for hole in holes {
                let below = hole.depths();
                let up = self.standing.grid.up;
                let is_below = |depth: &Option<i32>| match (below, depth) {
                    (Some([low, high]), Some(depth)) => (low - up..=high + up).contains(depth),
                    (below, depth) => below.is_none() && depth.is_none(),
                };
                let all = gap.pixels.iter().filter(|own| is_one || is_below(&own.depth));
                let mut pixels: Vec<[i32; 2]> = all.map(|own| own.pixel).collect();
                // A rim over a high step may lead to no pixel of this depth.
                if pixels.is_empty() {
                    pixels = hole.brinks.iter().map(|brink| self.beyond(brink)).collect();
                }
                let extent = self.extent(pixels.iter().copied(), self.standing.grid.foot);
                leaks.push(self.leak(&hole, extent[0].max(extent[1]), middle(&pixels, |pixel| *pixel)));
            }
        }
        leaks.sort_by(|a, b| a.at.y.total_cmp(&b.at.y).then(a.at.x.total_cmp(&b.at.x)).then(a.at.z.total_cmp(&b.at.z)));
        ControlFlow::Continue(leaks)
    }

    /// Finds the brinks of all places.
    fn brinks(&mut self) -> Needs<()> {
        while (self.found.seen as usize) < self.region.len() {
            let place = self.found.seen;
            let at = place as usize;
            // A neighbour that can be stood on is not open.
            if self.region.standing[at] && self.region.is_beside_end(place) {
                let mut own = [None; WAYS.len()];
                for (way, own) in own.iter_mut().enumerate() {
                    let brink = Brink { place, way, depth: None };
                    if let There::Open(depth) = self.there(self.beyond(&brink), self.region.tops[at])? {
                        *own = Some(Brink { depth, ..brink });
                    }
                }
                self.found.brinks.extend(own.into_iter().flatten());
            }
            self.found.seen += 1;
        }
        ControlFlow::Continue(())
    }

    /// Returns the open pixel of a brink.
    fn beyond(&self, brink: &Brink) -> [i32; 2] {
        let pixel = self.region.pixels[brink.place as usize];
        let way = WAYS[brink.way];
        [pixel[0] + way[0], pixel[1] + way[1]]
    }

    /// Returns the rims, by their first brink.
    fn rims(&self, brinks: &[Brink]) -> Vec<Rim> {
        let (mut rims, mut stretches) = (Sets::new(brinks.len()), Sets::new(brinks.len()));
        let mut meets: Vec<[u32; 2]> = Vec::new();
        let up = self.standing.grid.up;
        let pixel_of = |brink: &Brink| self.region.pixels[brink.place as usize];
        let top_of = |brink: &Brink| self.region.tops[brink.place as usize];
        let mut firsts = Firsts { numbers: TileNumbers::default(), tiles: Vec::new() };
        let mut next = vec![NOTHING; brinks.len()];
        for (number, brink) in brinks.iter().enumerate() {
            let [i, j] = pixel_of(brink);
            let beyond = self.beyond(brink);
            let mut meet = |mut other: u32| {
                while other != NOTHING {
                    let before = &brinks[other as usize];
                    let far = self.beyond(before);
                    let is_near = (top_of(before) - top_of(brink)).abs() <= up
                        && (0..2).all(|axis| (far[axis] - beyond[axis]).abs() <= TOGETHER)
                        // Not on the other side of a beam.
                        && before.way != (brink.way + 2) & 3;
                    if is_near {
                        rims.join(number as u32, other);
                        let is_alike = match (before.depth, brink.depth) {
                            (Some(a), Some(b)) => (a - b).abs() <= up,
                            (a, b) => a == b,
                        };
                        if is_alike {
                            stretches.join(number as u32, other);
                        } else {
                            meets.push([number as u32, other]);
                        }
                    }
                    other = next[other as usize];
                }
            };
            for y in j - TOGETHER..=j + TOGETHER {
                // The part of the row in each tile.
                let (first, last) = (i - TOGETHER, i + TOGETHER);
                let border = last & !63;
                let parts = if first < border {
                    [Some([first, border - 1]), Some([border, last])]
                } else {
                    [Some([first, last]), None]
                };
                for row in parts.into_iter().flatten().filter_map(|part| firsts.row(part, y)) {
                    row.iter().for_each(|other| meet(*other));
                }
            }
            next[number] = firsts.put([i, j], number as u32);
        }
        self.join_narrow(brinks, &mut stretches, &meets);
        // By the first brink of the rim.
        let mut own: Vec<Vec<Vec<Brink>>> = vec![Vec::new(); brinks.len()];
        for members in stretches.members() {
            let of_stretch = members.iter().map(|brink| brinks[*brink as usize]).collect();
            own[rims.root(members[0]) as usize].push(of_stretch);
        }
        let rim = |members: Vec<u32>| {
            let mut tops: Vec<i32> = members.iter().map(|brink| top_of(&brinks[*brink as usize])).collect();
            tops.sort_unstable();
            Rim {
                level: tops[tops.len() / 2],
                brinks: members.iter().map(|brink| brinks[*brink as usize]).collect(),
                stretches: std::mem::take(&mut own[members[0] as usize]),
            }
        };
        rims.members().into_iter().map(rim).collect()
    }

    /// Joins stretches narrower than half of the pawn to each other, and to the longest one that they meet; of equally
    /// long ones to the deepest.
    fn join_narrow(&self, brinks: &[Brink], stretches: &mut Sets, meets: &[[u32; 2]]) {
        // By the first brink of a stretch: whether the stretch is narrow, its length and its depth.
        let sizes = |stretches: &mut Sets| -> Vec<Option<(bool, usize, i32)>> {
            let mut sizes = vec![None; brinks.len()];
            for members in stretches.members() {
                let own: Vec<Brink> = members.iter().map(|brink| brinks[*brink as usize]).collect();
                let extent = self.extent(own.iter().map(|brink| self.region.pixels[brink.place as usize]), 0);
                let is_narrow = extent[0].max(extent[1]) < self.standing.grid.pawn.body.half().min();
                sizes[members[0] as usize] = Some((is_narrow, own.len(), depth_of(&own).unwrap_or(i32::MAX)));
            }
            sizes
        };
        let before = sizes(stretches);
        for [a, b] in meets {
            let [a, b] = [stretches.root(*a), stretches.root(*b)];
            // A joined set keeps the name of its first member.
            if [a, b].iter().all(|root| before[*root as usize].is_some_and(|size| size.0)) {
                stretches.join(a, b);
            }
        }
        let after = sizes(stretches);
        // The longest wide stretch that each narrow one meets.
        let mut longest: Vec<Option<(usize, i32, u32)>> = vec![None; brinks.len()];
        for meet in meets {
            let roots = meet.map(|brink| stretches.root(brink));
            for [own, other] in [roots, [roots[1], roots[0]]] {
                if let (Some((true, ..)), Some((false, size, depth))) = (after[own as usize], after[other as usize]) {
                    let longest = &mut longest[own as usize];
                    *longest = (*longest).max(Some((size, depth, other)));
                }
            }
        }
        for (own, longest) in (0..).zip(longest) {
            if let Some((_, _, other)) = longest {
                stretches.join(own, other);
            }
        }
    }

    /// Returns the number of the tile with `pixel`, which lies in the grid.
    #[inline]
    fn tile(&mut self, pixel: [i32; 2]) -> Needs<usize> {
        let at = [pixel[0] >> 6, pixel[1] >> 6];
        if let Some((last, tile)) = self.last
            && last == at
        {
            return ControlFlow::Continue(tile);
        }
        let tile = self.standing.tile(self.set, pixel)?;
        self.last = Some((at, tile));
        ControlFlow::Continue(tile)
    }

    fn there(&mut self, pixel: [i32; 2], level: i32) -> Needs<There> {
        if !self.standing.grid.is_inside(pixel) {
            return ControlFlow::Continue(There::Outside);
        }
        let tile = self.tile(pixel)?;
        ControlFlow::Continue(self.there_in(tile, pixel, level))
    }

    /// Returns the blocks of a pixel of a known tile.
    #[inline]
    fn column(&self, tile: usize, pixel: [i32; 2]) -> &[Block] {
        let tile = &self.standing.tiles[tile];
        // Gaps lead far over tiles without anything, and most of their pixels hold nothing.
        if tile.blocks.is_empty() { &[] } else { tile.column(pixel) }
    }

    /// Returns whether pixels that hold nothing lead from one of them, in `tile`, to the end of the scan or to more than
    /// [`MOST_PIXELS`].
    fn is_endless(&mut self, pixel: [i32; 2], tile: usize) -> Needs<bool> {
        let void = *known(&mut self.found.voids, self.standing.tiles.len(), tile, pixel, Void::Unknown);
        if void != Void::Unknown {
            return ControlFlow::Continue(void == Void::Endless);
        }
        self.found.voids[tile][cell(pixel)] = Void::Enclosed;
        let mut pixels = vec![(pixel, tile)];
        let is_endless = self.leads_out(&mut pixels);
        let void = match is_endless {
            ControlFlow::Continue(false) => return is_endless,
            ControlFlow::Continue(true) => Void::Endless,
            ControlFlow::Break(_) => Void::Unknown,
        };
        pixels.iter().for_each(|&(pixel, tile)| self.found.voids[tile][cell(pixel)] = void);
        is_endless
    }

    /// Adds the pixels that hold nothing around `pixels`, until it is known whether they are endless.
    fn leads_out(&mut self, pixels: &mut Vec<([i32; 2], usize)>) -> Needs<bool> {
        let mut done = 0;
        while let Some(&(pixel, tile)) = pixels.get(done) {
            for way in WAYS {
                let to = [pixel[0] + way[0], pixel[1] + way[1]];
                if !self.standing.grid.is_inside(to) {
                    return ControlFlow::Continue(true);
                }
                let is_same = (to[0] >> 6, to[1] >> 6) == (pixel[0] >> 6, pixel[1] >> 6);
                let tile = if is_same { tile } else { self.standing.tile(self.set, to)? };
                if !self.column(tile, to).is_empty() {
                    continue;
                }
                let void = known(&mut self.found.voids, self.standing.tiles.len(), tile, to, Void::Unknown);
                match void {
                    Void::Endless => return ControlFlow::Continue(true),
                    Void::Enclosed => {}
                    Void::Unknown => {
                        *void = Void::Enclosed;
                        pixels.push((to, tile));
                    }
                }
            }
            if pixels.len() > MOST_PIXELS {
                return ControlFlow::Continue(true);
            }
            done += 1;
        }
        ControlFlow::Continue(false)
    }

    /// Returns the content of a pixel of a known tile at `level`.
    #[inline]
    fn there_in(&self, tile: usize, pixel: [i32; 2], level: i32) -> There {
        let grid = &self.standing.grid;
        let column = self.column(tile, pixel);
        if column.is_empty() {
            return There::Open(None);
        }
        // Few blocks lie above one another.
        let (below, above) = column.split_at(column.iter().take_while(|block| block.top <= level + grid.up).count());
        let feet = below.last().map_or(level, |block| block.top.max(level));
        if above.first().is_some_and(|block| block.bottom - feet < grid.height) {
            return There::Matter;
        }
        let Some(block) = below.last() else { return There::Open(None) };
        if level - block.top <= grid.drop && block.kind != Kind::Bridge {
            return There::Floor;
        }
        let depth = (block.foot != NONE).then(|| level - block.foot);
        let is_deep = depth.is_none_or(|depth| depth > grid.drop);
        if is_deep { There::Open(depth) } else { There::Floor }
    }

    /// Floods the open pixels next to a rim.
    fn flood(&mut self, rim: &Rim) -> Needs<()> {
        let mut begun = self.found.begun.take().unwrap_or_else(|| BegunGap {
            gap: Gap { level: rim.level, pixels: Vec::new(), is_closed: true, shared: Vec::new() },
            done: 0,
        });
        if let ControlFlow::Break(stop) = self.fill(&mut begun, &rim.brinks) {
            self.found.begun = Some(begun);
            return ControlFlow::Break(stop);
        }
        let mut gap = begun.gap;
        if !gap.is_closed {
            gap.pixels = Vec::new();
        }
        self.found.gaps.push(gap);
        ControlFlow::Continue(())
    }

    fn fill(&mut self, BegunGap { gap, done }: &mut BegunGap, rim: &[Brink]) -> Needs<()> {
        let up = self.standing.grid.up;
        for brink in rim {
            if (self.region.tops[brink.place as usize] - gap.level).abs() <= up {
                self.visit(gap, self.beyond(brink), None)?;
            }
        }
        loop {
            gap.is_closed &= gap.pixels.len() <= MOST_PIXELS;
            // A gap that is not enclosed need not be explored further.
            let Some(&GapPixel { pixel, tile, .. }) = gap.pixels.get(*done).filter(|_| gap.is_closed) else { break };
            for way in WAYS {
                let to = [pixel[0] + way[0], pixel[1] + way[1]];
                let is_same = (to[0] >> 6, to[1] >> 6) == (pixel[0] >> 6, pixel[1] >> 6);
                self.visit(gap, to, is_same.then_some(tile as usize))?;
            }
            *done += 1;
        }
        ControlFlow::Continue(())
    }

    /// Adds a pixel to the next gap, as a part of it or of its border. A pixel of an earlier gap of the same height is
    /// not flooded again. `tile` is the pixel's tile, if known.
    #[inline]
    fn visit(&mut self, gap: &mut Gap, pixel: [i32; 2], tile: Option<usize>) -> Needs<()> {
        let tile = match tile {
            Some(tile) => tile,
            None if self.standing.grid.is_inside(pixel) => self.standing.tile(self.set, pixel)?,
            None => {
                gap.is_closed = false;
                return ControlFlow::Continue(());
            }
        };
        let number = self.found.gaps.len() as u32;
        let mark = *known(&mut self.found.marks, self.standing.tiles.len(), tile, pixel, NOTHING);
        if mark >> 1 == number {
            return ControlFlow::Continue(());
        }
        let there = self.there_in(tile, pixel, gap.level);
        if let There::Open(depth) = there {
            if self.column(tile, pixel).is_empty() && self.is_endless(pixel, tile)? {
                gap.is_closed = false;
                return ControlFlow::Continue(());
            }
            let before = self.found.gaps.get((mark >> 1) as usize).filter(|_| mark & 1 == 0);
            if let Some(before) = before.filter(|before| before.level == gap.level) {
                gap.is_closed &= before.is_closed;
                if gap.shared.last() != Some(&(mark >> 1)) {
                    gap.shared.push(mark >> 1);
                }
                return ControlFlow::Continue(());
            }
            gap.pixels.push(GapPixel { pixel, tile: tile as u32, depth });
        }
        self.found.marks[tile][cell(pixel)] = 2 * number + u32::from(!matches!(there, There::Open(_)));
        ControlFlow::Continue(())
    }

    /// Returns the sets of enclosed gaps that are one. From now on marks are numbers of gaps.
    fn joined_gaps(&mut self) -> Sets {
        let mut sets = Sets::new(self.found.gaps.len());
        self.found.marks.iter_mut().for_each(|marks| marks.fill(NOTHING));
        for (number, gap) in (0..).zip(&self.found.gaps).filter(|(_, gap)| gap.is_closed) {
            gap.shared.iter().for_each(|other| sets.join(number, *other));
            for own in &gap.pixels {
                let before = std::mem::replace(&mut self.found.marks[own.tile as usize][cell(own.pixel)], number);
                let height = |before: u32| gap.level - self.found.gaps[before as usize].level;
                if before != NOTHING && height(before) < self.standing.grid.height {
                    sets.join(number, before);
                }
            }
        }
        sets
    }

    /// Returns gaps, in order of their heights, as one gap.
    fn joined(&self, members: &[u32]) -> Gap {
        let all = || members.iter().map(|gap| &self.found.gaps[*gap as usize]);
        let mut pixels: Vec<GapPixel> = all().flat_map(|gap| gap.pixels.iter().copied()).collect();
        if members.len() > 1 {
            // The sort is stable: of a pixel of several gaps that of the lowest stays.
            pixels.sort_by_key(|own| own.pixel);
            pixels.dedup_by_key(|own| own.pixel);
        }
        let level = self.found.gaps[members[0] as usize].level;
        Gap { level, pixels, is_closed: all().all(|gap| gap.is_closed), shared: Vec::new() }
    }

    /// Returns true if at least half of the pixels around an enclosed gap hold nothing solid at its height. `number`
    /// marks its pixels.
    fn is_in_floor(&mut self, gap: &Gap, number: u32) -> Needs<bool> {
        let inside = 2 * self.found.gaps.len() as u32 + 2 * number;
        for own in &gap.pixels {
            self.found.marks[own.tile as usize][cell(own.pixel)] = inside;
        }
        let (mut border, mut matter) = (0usize, 0usize);
        for own in &gap.pixels {
            for way in WAYS {
                let to = [own.pixel[0] + way[0], own.pixel[1] + way[1]];
                // An enclosed gap was flooded, with all pixels around it.
                let tile = self.tile(to)?;
                let mark = &mut self.found.marks[tile][cell(to)];
                if *mark & !1 != inside {
                    *mark = inside + 1;
                    border += 1;
                    matter += usize::from(self.there_in(tile, to, gap.level) == There::Matter);
                }
            }
        }
        ControlFlow::Continue(border - matter >= matter)
    }

    /// Joins the stretches of one gap that have similar depths.
    fn alike(&self, stretches: Vec<Stretch>) -> Vec<Stretch> {
        let mut sets = Sets::new(stretches.len());
        let up = self.standing.grid.up;
        let depths: Vec<Option<[i32; 2]>> = stretches.iter().map(Stretch::depths).collect();
        for (a, b) in (0..stretches.len()).flat_map(|a| (0..a).map(move |b| (a, b))) {
            let is_alike = match (depths[a], depths[b]) {
                (Some(a), Some(b)) => a[0] - b[1] <= up && b[0] - a[1] <= up,
                (a, b) => a == b,
            };
            if is_alike {
                sets.join(a as u32, b as u32);
            }
        }
        let together = |members: Vec<u32>| Stretch {
            brinks: members.iter().flat_map(|stretch| stretches[*stretch as usize].brinks.iter().copied()).collect(),
            gap: stretches[members[0] as usize].gap,
        };
        sets.members().into_iter().map(together).collect()
    }

    /// Returns the extent along x and y of pixels, widened by `beyond` pixels on each side (m).
    fn extent(&self, pixels: impl Iterator<Item = [i32; 2]>, beyond: i32) -> [f64; 2] {
        let (mut low, mut high) = ([i32::MAX; 2], [i32::MIN; 2]);
        for pixel in pixels {
            for axis in 0..2 {
                (low[axis], high[axis]) = (low[axis].min(pixel[axis]), high[axis].max(pixel[axis]));
            }
        }
        let pixels = |axis: usize| f64::from(high[axis].saturating_sub(low[axis]).saturating_add(1 + 2 * beyond));
        [0, 1].map(|axis| pixels(axis) * self.standing.grid.frame.pixel_m())
    }

    fn is_narrow(&self, gap: &Gap) -> bool {
        let pixel = self.standing.grid.frame.pixel_m();
        let longest = self.extent(gap.pixels.iter().map(|own| own.pixel), 0).into_iter().fold(0.0, f64::max);
        let mean = gap.pixels.len() as f64 * pixel * pixel / longest + 2.0 * f64::from(self.standing.grid.foot) * pixel;
        mean < self.standing.grid.pawn.body.half().min()
    }

    /// Returns the extent of a stretch (m). If it ends at something solid, the opening continues for the half of the
    /// pawn beside its middle.
    fn rim_width(&mut self, stretch: &Stretch) -> Needs<f64> {
        let pixels: Vec<[i32; 2]> =
            stretch.brinks.iter().map(|brink| self.region.pixels[brink.place as usize]).collect();
        let extent = self.extent(pixels.iter().copied(), 0);
        let mut width = 0.0f64;
        for axis in (0..2).filter(|axis| extent[*axis] >= extent[1 - *axis]) {
            let mut beside = 0;
            let along = |pixel: &[i32; 2]| pixel[axis];
            let ends = [pixels.iter().map(along).min(), pixels.iter().map(along).max()];
            for (end, way) in ends.into_iter().zip([axis + 2, axis]) {
                let mut is_matter = false;
                for brink in
                    stretch.brinks.iter().filter(|brink| Some(self.region.pixels[brink.place as usize][axis]) == end)
                {
                    let level = self.region.tops[brink.place as usize];
                    is_matter |= self.there(self.beyond(&Brink { way, ..*brink }), level)? == There::Matter;
                }
                beside += if is_matter { self.standing.grid.half[axis] } else { 0 };
            }
            width = width.max(extent[axis] + f64::from(beside) * self.standing.grid.frame.pixel_m());
        }
        ControlFlow::Continue(width)
    }

    /// Returns the leak at a stretch, or in the middle of its `hole`.
    fn leak(&self, stretch: &Stretch, width: f64, hole: Option<[i32; 2]>) -> Leak {
        let pixel = |brink: &Brink| self.region.pixels[brink.place as usize];
        let [i, j] = hole.or_else(|| middle(&stretch.brinks, pixel).map(|brink| pixel(&brink))).unwrap_or_default();
        let mut tops: Vec<i32> = stretch.brinks.iter().map(|brink| self.region.tops[brink.place as usize]).collect();
        tops.sort_unstable();
        let grid = &self.standing.grid;
        let depth = stretch.depth();
        let kind = match (hole, depth) {
            (Some(_), _) => LeakKind::Hole,
            (None, None) => LeakKind::Edge,
            (None, Some(_)) => LeakKind::Ledge,
        };
        Leak {
            at: Point3::new(
                grid.middle(i, 0),
                grid.middle(j, 1),
                grid.z(tops.get(tops.len() / 2).copied().unwrap_or(0)),
            ),
            width,
            drop: depth.map(|depth| f64::from(depth) * grid.frame.quantum_m()),
            kind,
        }
    }
}
