//! Standing places, tile by tile, and the steps between neighbours.

use super::intervals::{Floors, Interval, Lists, NONE};
use super::pawn::{Grid, Pawn, WAYS, gap};
use super::tiles::TileNumbers;
use super::{Needs, answer};
use crate::Result;
use crate::query::Answer;
use crate::seen::SeenSpace;
use crate::store::Snapshot;
use nalgebra::{Point2, Point3};
use std::ops::ControlFlow;
use std::sync::Arc;

/// Edge of a tile (pixels).
const TILE: usize = 64;
/// Value of [`Block::floor`] without floor.
const NO_FLOOR: i16 = i16::MIN;

/// Use of the top of an interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// No floor: too steep, or the top of an obstacle.
    Refused,
    /// Floor under the footprint without support under its middle; or the lower edge of a step.
    Bridge,
    /// A standing place.
    Standing,
}

/// An interval that blocks the pawn over one pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block {
    pub bottom: i32,
    pub top: i32,
    /// Height of the floor above the top, under the footprint or beside it (quanta), or [`NO_FLOOR`]; more than
    /// [`Grid::near`] for the lower edge of a step.
    floor: i16,
    pub kind: Kind,
    /// Highest solid under the middle of the feet, no higher than the top; [`NONE`] without any.
    pub foot: i32,
    /// Offset of the nearest pixel that stops the body on a step to a neighbour; `[0, 0]` if no step is stopped.
    pub stop: [i16; 2],
}

/// All blocks of one tile.
#[derive(Debug)]
pub(super) struct Tile {
    pub at: [i32; 2],
    pub starts: Box<[u32]>,
    pub blocks: Box<[Block]>,
}

impl Tile {
    #[inline]
    pub fn column(&self, [i, j]: [i32; 2]) -> &[Block] {
        let cell = (((j & 63) << 6) | (i & 63)) as usize;
        &self.blocks[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// Returns the number of a block in the tile, given its number in the column of its pixel.
    pub fn number(&self, [i, j]: [i32; 2], place: usize) -> usize {
        self.starts[(((j & 63) << 6) | (i & 63)) as usize] as usize + place
    }
}

/// Outcome of a step to a neighbouring pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// It ends on the block with this number in the pixel's column.
    To(usize),
    /// Something solid is in the way, or there is no headroom.
    Blocked,
    /// It ends on something that is not floor.
    Refused,
    /// The ground there is deeper than the pawn steps down, or missing.
    Open,
}

/// A standing place of a [`StandingPlaces`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlaceId {
    pub(super) pixel: [i32; 2],
    /// Number in the pixel's column.
    pub(super) place: usize,
    pub(super) top: i32,
}

/// A standing place found at or near a requested place.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Snapped {
    /// The place.
    pub spot: PlaceId,
    /// Place of the feet: the middle of a pixel (m).
    pub feet: Point3<f64>,
    /// Distance from the requested place (m); 0 if the pawn can stand there.
    pub moved: f64,
}

/// Greatest distance by which a place is moved (m).
const MOST_SNAP_M: f64 = 100.0;

/// Standing places of one pawn in a set of pages, computed tile by tile on request.
///
/// Many regions and routes can share it. Memory: see the [module documentation](super).
#[derive(Debug)]
pub struct StandingPlaces {
    pub(super) grid: Grid,
    pub(super) tiles: Vec<Tile>,
    numbers: TileNumbers,
    /// Space in which the pawn must stay.
    seen: Option<Arc<SeenSpace>>,
    /// First pixels of all tiles, and the numbers of those that are computed: what a flood from everywhere has begun.
    pub(super) begun: Option<(Vec<[i32; 2]>, Vec<usize>)>,
}

impl StandingPlaces {
    /// Creates the standing places of `pawn` in `set` without computing any tile. Fails for an invalid pawn, and for a
    /// set of pages larger than 2²⁴ tiles or 2¹⁶ layers.
    pub fn new(set: &Snapshot, pawn: Pawn) -> Result<Self> {
        let grid = Grid::new(set, pawn)?;
        Ok(Self { grid, tiles: Vec::new(), numbers: TileNumbers::default(), seen: None, begun: None })
    }

    /// Counts as standing places only those where a scanner saw the middle of the pawn
    /// ([`SeenSpace::is_pawn_seen`]); call it before anything else. All other ground counts as no floor.
    #[must_use]
    pub fn within_seen(self, seen: Option<Arc<SeenSpace>>) -> Self {
        Self { seen, ..self }
    }

    /// Returns the memory of the computed tiles (bytes).
    pub fn memory_bytes(&self) -> usize {
        let tile = |tile: &Tile| size_of_val::<[u32]>(&tile.starts) + size_of_val::<[Block]>(&tile.blocks);
        self.tiles.iter().map(|own| tile(own) + 2 * size_of::<Tile>()).sum()
    }

    /// Returns the standing place at or under `at` (m): on the highest solid below it, however deep, or above it by at
    /// most the climb height. `None` if the pawn cannot stand there. Fails if a tile holds more spans than any scan has
    /// ([`Error::Limit`](crate::Error::Limit)).
    pub fn spot(&mut self, set: &Snapshot, at: Point3<f64>) -> Result<Answer<Option<PlaceId>>> {
        answer(self.find(set, at))
    }

    fn find(&mut self, set: &Snapshot, at: Point3<f64>) -> Needs<Option<PlaceId>> {
        let Some(pixel) = self.grid.pixel(at.x, at.y) else { return ControlFlow::Continue(None) };
        let level = self.grid.level(at.z);
        let tile = self.tile(set, pixel)?;
        let column = self.tiles[tile].column(pixel);
        let place = column.partition_point(|block| block.top <= level.saturating_add(self.grid.up)).checked_sub(1);
        let fits = |place: &usize| {
            column[*place].kind == Kind::Standing && column.get(place + 1).is_none_or(|next| next.bottom >= level)
        };
        ControlFlow::Continue(place.filter(fits).map(|place| PlaceId { pixel, place, top: column[place].top }))
    }

    /// Returns the standing place at or under `at` (m) like [`spot`](Self::spot), or else the nearest one within `snap`
    /// (m).
    ///
    /// Distances count across the ground and upwards. Downwards they count only to places that something covers,
    /// because in the air the floor below counts. Of equally near places the first along y, then x, then z wins.
    pub fn snapped(&mut self, set: &Snapshot, at: Point3<f64>, snap: f64) -> Result<Answer<Option<Snapped>>> {
        answer(self.snap(set, at, snap))
    }

    fn snap(&mut self, set: &Snapshot, at: Point3<f64>, snap: f64) -> Needs<Option<Snapped>> {
        if let Some(spot) = self.find(set, at)? {
            return ControlFlow::Continue(Some(self.snapped_to(spot, 0.0)));
        }
        // It may lie beside the grid, and places near it inside.
        let Some(middle) = self.grid.pixel_beside(at.x, at.y) else { return ControlFlow::Continue(None) };
        let far = (snap.clamp(0.0, MOST_SNAP_M) / self.grid.frame.pixel_m()).ceil() as i32;
        let mut best: Option<(f64, PlaceId)> = None;
        for pixel in self.grid.square(middle, far) {
            let across = (Point2::new(self.grid.middle(pixel[0], 0), self.grid.middle(pixel[1], 1)) - at.xy()).norm();
            if across > best.map_or(snap, |best| best.0) {
                continue;
            }
            let below =
                self.find(set, Point3::new(self.grid.middle(pixel[0], 0), self.grid.middle(pixel[1], 1), at.z))?;
            let tile = self.tile(set, pixel)?;
            for (place, block) in self.tiles[tile].column(pixel).iter().enumerate() {
                let up = self.grid.z(block.top) - at.z;
                let up = if below.is_some_and(|below| below.place == place) { up.max(0.0) } else { up };
                let distance = across.hypot(up);
                let is_better = distance <= snap && best.is_none_or(|best| distance < best.0);
                if block.kind == Kind::Standing && is_better {
                    best = Some((distance, PlaceId { pixel, place, top: block.top }));
                }
            }
        }
        ControlFlow::Continue(best.map(|(moved, spot)| self.snapped_to(spot, moved)))
    }

    /// Returns all standing places over `at` (m), lowest first. Without any, returns those over the nearest pixel
    /// within `snap` (m) that has some.
    ///
    /// Distances are horizontal. Among equally near pixels, the first along y, then x, wins.
    pub fn snapped_over(&mut self, set: &Snapshot, at: Point2<f64>, snap: f64) -> Result<Answer<Vec<Snapped>>> {
        answer(self.snap_over(set, at, snap))
    }

    fn snap_over(&mut self, set: &Snapshot, at: Point2<f64>, snap: f64) -> Needs<Vec<Snapped>> {
        let Some(middle) = self.grid.pixel_beside(at.x, at.y) else { return ControlFlow::Continue(Vec::new()) };
        let mut best = self.over(set, middle, 0.0)?;
        if !best.is_empty() {
            return ControlFlow::Continue(best);
        }
        let far = (snap.clamp(0.0, MOST_SNAP_M) / self.grid.frame.pixel_m()).ceil() as i32;
        for pixel in self.grid.square(middle, far) {
            let across = (Point2::new(self.grid.middle(pixel[0], 0), self.grid.middle(pixel[1], 1)) - at).norm();
            let is_nearer = best.first().map_or(across <= snap, |best: &Snapped| across < best.moved);
            if is_nearer {
                let found = self.over(set, pixel, across)?;
                if !found.is_empty() {
                    best = found;
                }
            }
        }
        ControlFlow::Continue(best)
    }

    /// Returns the standing places over `pixel`, lowest first.
    fn over(&mut self, set: &Snapshot, pixel: [i32; 2], moved: f64) -> Needs<Vec<Snapped>> {
        if !self.grid.is_inside(pixel) {
            return ControlFlow::Continue(Vec::new());
        }
        let tile = self.tile(set, pixel)?;
        let column = self.tiles[tile].column(pixel).iter().enumerate();
        let standing = column.filter(|(_, block)| block.kind == Kind::Standing);
        let spots = standing.map(|(place, block)| PlaceId { pixel, place, top: block.top });
        ControlFlow::Continue(spots.map(|spot| self.snapped_to(spot, moved)).collect())
    }

    fn snapped_to(&self, spot: PlaceId, moved: f64) -> Snapped {
        let [i, j] = spot.pixel;
        let feet = Point3::new(self.grid.middle(i, 0), self.grid.middle(j, 1), self.grid.z(spot.top));
        Snapped { spot, feet, moved }
    }

    /// Returns the number of the tile with `pixel`, if it has been computed.
    pub(super) fn known(&self, pixel: [i32; 2]) -> Option<usize> {
        self.numbers.get([pixel[0] >> 6, pixel[1] >> 6])
    }

    /// Returns the number of the tile with `pixel`, which lies in the grid; computes it if necessary.
    pub(super) fn tile(&mut self, set: &Snapshot, pixel: [i32; 2]) -> Needs<usize> {
        let at = [pixel[0] >> 6, pixel[1] >> 6];
        if let Some(number) = self.numbers.get(at) {
            return ControlFlow::Continue(number);
        }
        let mut tile = compute(set, &self.grid, at)?;
        if let Some(seen) = &self.seen {
            refuse_unseen(&self.grid, seen, &mut tile);
        }
        self.numbers.add(at);
        self.tiles.push(tile);
        ControlFlow::Continue(self.tiles.len() - 1)
    }
}

impl Grid {
    /// Returns where a step from block `place` of `column` leads in the neighbouring pixel along `axis`, which has the
    /// blocks `next`.
    pub(super) fn step(&self, column: &[Block], place: usize, next: &[Block], axis: usize) -> Step {
        let (grid, from) = (self, column[place]);
        let limit = grid.limit(&from, next);
        let (below, above) = next.split_at(next.partition_point(|block| block.top <= limit));
        let to = below.last();
        let level = to.map_or(from.top, |block| block.top.max(from.top));
        // Without ground the body continues at its own height.
        let fits = |above: Option<&Block>, level: i32| above.is_none_or(|block| block.bottom - level >= grid.height);
        let drops = to.is_none_or(|block| from.top - block.top > grid.drop);
        let is_step = to.is_some_and(|block| from.top - block.top <= grid.up.min(grid.drop));
        let is_free = if grid.lets_go[axis] && is_step {
            true
        } else {
            fits(above.first(), level) && fits(column.get(place + 1), level)
        };
        match to {
            _ if !is_free => Step::Blocked,
            _ if drops => Step::Open,
            Some(block) if block.kind == Kind::Refused => Step::Refused,
            _ => Step::To(below.len() - 1),
        }
    }

    /// Returns the height up to which a step from block `from` to a pixel with blocks `next` may lead.
    pub(super) fn limit(&self, from: &Block, next: &[Block]) -> i32 {
        // Climbing is measured from the floor, so that no ledge is climbed in parts. An edge whose floor is out of
        // reach is in the way.
        let limit = match i32::from(from.floor) {
            above if above > self.near => from.top + above,
            floor => from.top.max(from.top + floor + self.up),
        };
        let highest = next.partition_point(|block| block.top <= limit).checked_sub(1).map(|at| &next[at]);
        let is_too_high = |edge: &&Block| edge.top > from.top && edge.top + i32::from(edge.floor) > limit;
        highest.filter(is_too_high).map_or(limit, |edge| edge.top - 1)
    }
}

/// Computes the blocks of the tile `at`, or returns the pages that are needed.
fn compute(set: &Snapshot, grid: &Grid, at: [i32; 2]) -> Needs<Tile> {
    // One more pixel, for steps across the border of the tile.
    let margin = grid.half.map(|half| half + grid.ahead + 1);
    let corner = [0, 1].map(|axis| at[axis] * TILE as i32 - margin[axis]);
    let size = margin.map(|margin| TILE + 2 * margin as usize);
    let (matter, floors) = Lists::read(set, grid, corner, size)?;
    if matter.is_empty() {
        return ControlFlow::Continue(Tile { at, starts: vec![0; TILE * TILE + 1].into(), blocks: Box::default() });
    }
    let under = matter.under(&grid.rects, grid.half, grid.height);
    let foot = matter.under(&[[grid.foot; 2]], margin.map(|margin| margin - 1), grid.height);
    let mut columns = Columns::default();
    for (y, x) in (0..TILE + 2).flat_map(|y| (0..TILE + 2).map(move |x| (y, x))) {
        let own = under.at(x + grid.ahead as usize, y + grid.ahead as usize);
        columns.blocks.extend(own.iter().map(|interval| judge(grid, interval, &floors, [x, y], foot.at(x, y))));
        columns.starts.push(columns.blocks.len() as u32);
    }
    let (mut starts, mut blocks) = (Vec::with_capacity(TILE * TILE + 1), Vec::with_capacity(columns.blocks.len()));
    starts.push(0);
    for (y, x) in (1..=TILE).flat_map(|y| (1..=TILE).map(move |x| (y, x))) {
        let column = columns.at(x, y);
        for place in 0..column.len() {
            let next = [columns.at(x + 1, y), columns.at(x, y + 1), columns.at(x - 1, y), columns.at(x, y - 1)];
            let at = [x + margin[0] as usize - 1, y + margin[1] as usize - 1];
            blocks.push(Block { stop: nearest_stop(grid, &matter, at, column, place, next), ..column[place] });
        }
        starts.push(blocks.len() as u32);
    }
    ControlFlow::Continue(Tile { at, starts: starts.into(), blocks: blocks.into() })
}

/// Makes the ground on which the middle of the pawn was not seen no floor.
fn refuse_unseen(grid: &Grid, seen: &SeenSpace, tile: &mut Tile) {
    for (cell, ends) in tile.starts.windows(2).enumerate() {
        let pixel = [0, 1].map(|axis| tile.at[axis] * TILE as i32 + ((cell >> (6 * axis)) & 63) as i32);
        let [x, y] = [0, 1].map(|axis| grid.middle(pixel[axis], axis));
        for block in &mut tile.blocks[ends[0] as usize..ends[1] as usize] {
            let feet = Point3::new(x, y, grid.z(block.top));
            if block.kind != Kind::Refused && !seen.is_pawn_seen(feet, grid.pawn.climb, grid.pawn.body.height()) {
                block.kind = Kind::Refused;
            }
        }
    }
}

/// Blocks of a tile and of the pixels around it.
struct Columns {
    starts: Vec<u32>,
    blocks: Vec<Block>,
}

impl Default for Columns {
    fn default() -> Self {
        Self { starts: vec![0], blocks: Vec::new() }
    }
}

impl Columns {
    fn at(&self, x: usize, y: usize) -> &[Block] {
        let cell = y * (TILE + 2) + x;
        &self.blocks[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}

fn judge(grid: &Grid, interval: &Interval, floors: &Floors, at: [usize; 2], foot: &[Interval]) -> Block {
    let Interval { bottom, top, .. } = *interval;
    // The interval knows the highest floor under the footprint.
    let floor = match interval.floor != NONE && top - interval.floor <= grid.near {
        true => Some(interval.floor),
        false => {
            let size = grid.half.map(|half| 2 * (half + grid.ahead) as usize + 1);
            let highest = grid.up.max(grid.near).min(i32::from(i16::MAX));
            floors
                .highest(at, size, [top - grid.near, top])
                .or_else(|| floors.highest(at, size, [top, top + grid.near]))
                .or_else(|| floors.lowest(at, size, [top + grid.near, top + highest]))
        }
    };
    let is_edge = floor.is_some_and(|floor| floor > top + grid.near);
    let under_foot = foot.partition_point(|matter| matter.top <= top).checked_sub(1);
    let foot = under_foot.map_or(NONE, |matter| foot[matter].top);
    let kind = match foot {
        _ if floor.is_none() => Kind::Refused,
        foot if foot != NONE && !is_edge && top - foot <= grid.up => Kind::Standing,
        _ => Kind::Bridge,
    };
    let floor = floor.map_or(NO_FLOOR, |floor| (floor - top) as i16);
    Block { bottom, top, floor, kind, foot, stop: [0; 2] }
}

/// Returns the offset of the nearest pixel whose spans stop a body on block `place` of the pixel `at` on a step to one
/// of its neighbours; `[0, 0]` if no step is stopped.
fn nearest_stop(
    grid: &Grid,
    matter: &Lists,
    at: [usize; 2],
    column: &[Block],
    place: usize,
    next: [&[Block]; 4],
) -> [i16; 2] {
    let from = &column[place];
    if from.kind == Kind::Refused {
        return [0; 2];
    }
    let pixel = |by: [i32; 2]| {
        let [x, y] = [0, 1].map(|axis| at[axis].wrapping_add_signed(by[axis] as isize));
        matter.at(x, y)
    };
    let highest = from.top + grid.up;
    let (mut nearest, mut is_wall) = ([0; 2], false);
    // Takes a pixel if it is nearer and stops the body. Of equally near ones the lesser wins, so that the result does
    // not depend on the order.
    let mut offer = |by: [i32; 2], stops: &dyn Fn(&Interval) -> bool| {
        let is_nearer = nearest == [0; 2] || (gap(by), by) < (gap(nearest), nearest);
        if is_nearer && by != [0; 2] && pixel(by).iter().any(stops) {
            nearest = by;
        }
    };
    for (number, (way, next)) in WAYS.into_iter().zip(next).enumerate() {
        let step = grid.step(column, place, next, number & 1);
        if !matches!(step, Step::Blocked | Step::Refused) {
            continue;
        }
        let limit = grid.limit(from, next);
        let (below, above) = next.split_at(next.partition_point(|block| block.top <= limit));
        let to = below.last();
        let level = to.map_or(from.top, |block| block.top.max(from.top));
        let is_in_the_way = |matter: &Interval| matter.top > limit && matter.bottom - level < grid.height;
        if step == Step::Blocked
            && above.first().is_some_and(|block| block.bottom - from.top < grid.height && block.top > highest)
        {
            is_wall = true;
            continue;
        }
        // Steep ground, an edge too high above its floor, or a beam above a step.
        for &[x, y] in &grid.rects {
            for by in (-y..=y).flat_map(|y| (-x..=x).map(move |x| [x, y])) {
                offer([by[0] + way[0], by[1] + way[1]], &|matter| match step {
                    Step::Refused => to.is_some_and(|block| block.top == matter.top),
                    _ => is_in_the_way(matter),
                });
                if step == Step::Blocked && level > from.top {
                    offer(by, &|matter| matter.bottom > from.top && is_in_the_way(matter));
                }
            }
        }
    }
    if is_wall {
        let is_wall = |matter: &Interval| matter.top > highest && matter.bottom - from.top < grid.height;
        let mut around = grid.around.iter().map(|by| by.map(i32::from));
        if let Some(by) = around.find(|by| pixel(*by).iter().any(is_wall)) {
            offer(by, &|_| true);
        }
    }
    nearest.map(|by| by as i16)
}
