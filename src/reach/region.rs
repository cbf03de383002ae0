//! Regions: all places that can be reached on foot from one place.

use super::distance::{End, clearances, to_line};
use super::pawn::{Grid, Pawn, WAYS};
use super::route::LANDMARKS;
use super::standing::{Kind, PlaceId, StandingPlaces, Step};
use super::{Needs, answer};
use crate::query::Answer;
use crate::sort::sort_by_key;
use crate::store::Snapshot;
use crate::{Error, Monitor, Result};
use nalgebra::{Point2, Point3};
use std::ops::ControlFlow;

/// Number in a link that leads nowhere.
pub(super) const NO_PLACE: u32 = u32::MAX;
/// Places between two checks of the monitor.
const BETWEEN_LOOKS: usize = 1 << 14;

/// A flood over neighbouring places that can wait for pages.
///
/// ```
/// use nalgebra::Point3;
/// use slicewalk::NoMonitor;
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::query::Answer;
/// use slicewalk::reach::{Flood, StandingPlaces, Pawn};
/// use slicewalk::page::{PageBuilder, Span};
/// use slicewalk::store::Snapshot;
/// use slicewalk::walk::Body;
///
/// let mut builder = PageBuilder::default();
/// for (px, py) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
///     assert!(builder.set_column(px, py, &[Span::new(0, 10, false).unwrap()])); // a floor of 3.2 × 3.2 m
/// }
/// let key = PageKey { tx: 0, ty: 0, layer: 0 };
/// let store = Snapshot::from_pages(Frame::new(0.05, 0.15)?, [(key, builder.build())]);
///
/// let mut standing = StandingPlaces::new(&store, Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 }))?;
/// let Answer::Known(Some(start)) = standing.spot(&store, Point3::new(1.0, 1.0, 0.1))? else { panic!("it is all floor") };
/// let mut flood = Flood::from(start);
/// assert_eq!(flood.grow(&mut standing, &store, &NoMonitor)?, Answer::Known(()));
/// let region = flood.region(&standing);
/// // The middle of its feet may hang a pixel beyond each edge.
/// assert!((region.area_m2() - 3.3 * 3.3).abs() < 1e-9);
/// # Ok::<(), slicewalk::Error>(())
/// ```
#[derive(Debug)]
pub struct Flood {
    /// One bit for each block of each tile, by number of the tile.
    reached: Vec<Vec<u64>>,
    /// Places reached whose neighbours have not been visited.
    open: Vec<([i32; 2], usize)>,
    /// Places reached outside of the ellipse or the corridor.
    parked: Vec<([i32; 2], usize)>,
    /// Two places and the length of the paths between them within which the flood stays (m).
    ellipse: Option<([Point2<f64>; 2], f64)>,
    /// A line and the distance from it within which the flood stays (m).
    corridor: Option<(Vec<Point2<f64>>, f64)>,
}

impl Flood {
    /// Creates a flood from a standing place.
    pub fn from(start: PlaceId) -> Self {
        Self::of(vec![(start.pixel, start.place)])
    }

    /// Creates a flood from all standing places of the set at once, for routes between any two of them. Load the pages
    /// that are missing, and call again. Fails if a tile holds more spans than any scan has ([`Error::Limit`]).
    pub fn everywhere(standing: &mut StandingPlaces, set: &Snapshot) -> Result<Answer<Self>> {
        answer(Self::all(standing, set))
    }

    fn all(standing: &mut StandingPlaces, set: &Snapshot) -> Needs<Self> {
        let (corners, mut tiles) = standing.begun.take().unwrap_or_else(|| (corners(&standing.grid, set), Vec::new()));
        while let Some(&corner) = corners.get(tiles.len()) {
            match standing.tile(set, corner) {
                ControlFlow::Continue(tile) => tiles.push(tile),
                ControlFlow::Break(stop) => {
                    standing.begun = Some((corners, tiles));
                    return ControlFlow::Break(stop);
                }
            }
        }
        let mut open = Vec::new();
        for (corner, tile) in corners.into_iter().zip(tiles) {
            for cell in 0..64 * 64 {
                let pixel = [corner[0] + (cell & 63), corner[1] + (cell >> 6)];
                let blocks = standing.tiles[tile].column(pixel).iter().enumerate();
                open.extend(blocks.filter(|block| block.1.kind == Kind::Standing).map(|block| (pixel, block.0)));
            }
        }
        ControlFlow::Continue(Self::of(open))
    }

    fn of(open: Vec<([i32; 2], usize)>) -> Self {
        Self { reached: Vec::new(), open, parked: Vec::new(), ellipse: None, corridor: None }
    }

    /// Restricts the flood to where paths from one of `ends` to the other are no longer than `length` (m), to within a
    /// tile. A greater length later continues from there.
    pub fn within(&mut self, ends: [Point2<f64>; 2], length: f64) {
        if self.ellipse != Some((ends, length)) {
            self.ellipse = Some((ends, length));
            self.open.append(&mut self.parked);
        }
    }

    /// Restricts the flood to places within `distance` (m) of a line of these points. Another line or a greater
    /// distance later continues from there.
    pub fn along(&mut self, line: &[Point2<f64>], distance: f64) {
        if self.corridor.as_ref().is_none_or(|corridor| corridor.0 != line || corridor.1 != distance) {
            self.corridor = Some((line.to_vec(), distance));
            self.open.append(&mut self.parked);
        }
    }

    /// Adds a standing place from which the flood spreads, too, such as the other end of a lift.
    pub fn add(&mut self, start: PlaceId) {
        self.open.push((start.pixel, start.place));
    }

    /// Returns whether everything has been reached, and nothing is left outside of the ellipse or the corridor.
    pub fn is_whole(&self) -> bool {
        self.parked.is_empty() && self.open.is_empty()
    }

    /// Continues until everything is reached or pages are missing: load them and call again. Fails if `monitor` asks to
    /// stop, or if a tile holds more spans than any scan has ([`Error::Limit`]).
    pub fn grow(&mut self, standing: &mut StandingPlaces, set: &Snapshot, monitor: &dyn Monitor) -> Result<Answer<()>> {
        Ok(match self.grow_some(standing, set, usize::MAX, monitor)? {
            Answer::Known(_) => Answer::Known(()),
            Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
        })
    }

    /// Like [`grow`](Self::grow), but visits at most `steps` places. Returns whether everything is reached.
    pub fn grow_some(
        &mut self,
        standing: &mut StandingPlaces,
        set: &Snapshot,
        steps: usize,
        monitor: &dyn Monitor,
    ) -> Result<Answer<bool>> {
        let mut taken = 0;
        while taken < steps {
            let Some(place) = self.open.pop() else { break };
            taken += 1;
            if usize::is_multiple_of(taken, BETWEEN_LOOKS) {
                if monitor.cancelled() {
                    return Err(Error::Interrupted);
                }
                monitor.advance(BETWEEN_LOOKS as u64);
            }
            if let ControlFlow::Break(stop) = self.spread(standing, set, place) {
                self.open.push(place);
                return stop.answer();
            }
        }
        Ok(Answer::Known(self.open.is_empty()))
    }

    fn spread(
        &mut self,
        standing: &mut StandingPlaces,
        set: &Snapshot,
        (pixel, place): ([i32; 2], usize),
    ) -> Needs<()> {
        if !self.is_near(&standing.grid, pixel) {
            self.parked.push((pixel, place));
            return ControlFlow::Continue(());
        }
        let tile = standing.tile(set, pixel)?;
        self.mark(standing, tile, pixel, place);
        for (number, way) in WAYS.into_iter().enumerate() {
            let to = [pixel[0] + way[0], pixel[1] + way[1]];
            if !standing.grid.is_inside(to) {
                continue;
            }
            let is_same = (to[0] >> 6, to[1] >> 6) == (pixel[0] >> 6, pixel[1] >> 6);
            let other = if is_same { tile } else { standing.tile(set, to)? };
            let (column, next) = (standing.tiles[tile].column(pixel), standing.tiles[other].column(to));
            if let Step::To(reached) = standing.grid.step(column, place, next, number & 1)
                && self.mark(standing, other, to, reached)
            {
                self.open.push((to, reached));
            }
        }
        ControlFlow::Continue(())
    }

    fn is_near(&self, grid: &Grid, pixel: [i32; 2]) -> bool {
        if let Some((line, distance)) = &self.corridor {
            let at = Point2::new(grid.middle(pixel[0], 0), grid.middle(pixel[1], 1));
            let is_beside = |ends: &[Point2<f64>]| to_line(at, [ends[0], ends[1]]) <= *distance;
            if !line.windows(2).any(is_beside) {
                return false;
            }
        }
        let Some((ends, length)) = self.ellipse else { return true };
        let corner = pixel.map(|pixel| pixel & !63);
        let gap = |end: &Point2<f64>| {
            let along = |axis: usize| {
                let (low, high) = (grid.middle(corner[axis], axis), grid.middle(corner[axis] + 63, axis));
                (low - end[axis]).max(end[axis] - high).max(0.0)
            };
            along(0).hypot(along(1))
        };
        gap(&ends[0]) + gap(&ends[1]) <= length
    }

    /// Marks a place as reached. Returns whether it was not reached before.
    fn mark(&mut self, standing: &StandingPlaces, tile: usize, pixel: [i32; 2], place: usize) -> bool {
        if self.reached.len() <= tile {
            self.reached.resize_with(standing.tiles.len(), Vec::new);
        }
        let own = &standing.tiles[tile];
        let bits = &mut self.reached[tile];
        if bits.is_empty() {
            bits.resize(own.blocks.len().div_ceil(64), 0);
        }
        let at = own.number(pixel, place);
        let is_new = bits[at >> 6] >> (at & 63) & 1 == 0;
        bits[at >> 6] |= 1 << (at & 63);
        is_new
    }

    /// Returns whether the flood has reached a place of the same standing places, without building a [`Region`].
    pub fn holds(&self, standing: &StandingPlaces, spot: &PlaceId) -> bool {
        let Some(tile) = standing.known(spot.pixel) else { return false };
        let bits = self.reached.get(tile).map_or(&[][..], |bits| bits);
        let at = standing.tiles[tile].number(spot.pixel, spot.place);
        bits.get(at >> 6).is_some_and(|word| word >> (at & 63) & 1 == 1)
    }

    /// Returns the memory of the flood now (bytes).
    pub fn memory_bytes(&self) -> usize {
        let bits: usize = self.reached.iter().map(|bits| bits.capacity() * 8 + size_of::<Vec<u64>>()).sum();
        bits + (self.open.capacity() + self.parked.capacity()) * size_of::<([i32; 2], usize)>()
    }

    /// Returns all reached places as a graph.
    pub fn region(&self, standing: &StandingPlaces) -> Region {
        let mut order: Vec<usize> = (0..self.reached.len()).filter(|tile| !self.reached[*tile].is_empty()).collect();
        sort_by_key(&mut order, |tile| [standing.tiles[*tile].at[1], standing.tiles[*tile].at[0]]);
        let places: usize = self.reached.iter().flatten().map(|bits| bits.count_ones() as usize).sum();
        let mut region = Region {
            grid: standing.grid.clone(),
            pixels: Vec::with_capacity(places),
            tops: Vec::with_capacity(places),
            standing: Vec::with_capacity(places),
            links: Vec::with_capacity(places),
            clearances: Vec::new(),
            levels: Vec::new(),
            landmarks: Vec::new(),
            lowest_headroom: None,
            highest_step: None,
        };
        // For each tile the place numbers of its blocks.
        let mut numbers: Vec<Vec<u32>> = vec![Vec::new(); self.reached.len()];
        for &tile in &order {
            let (own, bits) = (&standing.tiles[tile], &self.reached[tile]);
            numbers[tile] = vec![NO_PLACE; own.blocks.len()];
            for cell in 0..64 * 64 {
                let pixel = [own.at[0] * 64 + (cell & 63), own.at[1] * 64 + (cell >> 6)];
                let first = own.starts[cell as usize] as usize;
                for (place, block) in own.column(pixel).iter().enumerate() {
                    let at = first + place;
                    if bits[at >> 6] >> (at & 63) & 1 == 1 {
                        numbers[tile][at] = region.pixels.len() as u32;
                        region.pixels.push(pixel);
                        region.tops.push(block.top);
                        region.standing.push(block.kind == Kind::Standing);
                    }
                }
            }
        }
        let mut ends = Vec::new();
        for &tile in &order {
            let own = &standing.tiles[tile];
            for cell in 0..64 * 64 {
                let pixel = [own.at[0] * 64 + (cell & 63), own.at[1] * 64 + (cell >> 6)];
                let first = own.starts[cell as usize] as usize;
                let column = own.column(pixel);
                for place in (0..column.len()).filter(|place| numbers[tile][first + place] != NO_PLACE) {
                    let own = numbers[tile][first + place];
                    let links = [0, 1, 2, 3].map(|number| {
                        let way = WAYS[number];
                        let to = [pixel[0] + way[0], pixel[1] + way[1]];
                        let is_same = (to[0] >> 6, to[1] >> 6) == (pixel[0] >> 6, pixel[1] >> 6);
                        // The region does not end where the flood has not been.
                        let Some(other) = (if is_same { Some(tile) } else { standing.known(to) }) else {
                            return NO_PLACE;
                        };
                        let next = standing.tiles[other].column(to);
                        let is_open = match standing.grid.step(column, place, next, number & 1) {
                            Step::To(reached) => {
                                let reached = standing.tiles[other].number(to, reached);
                                let numbers = numbers.get(other).and_then(|numbers| numbers.get(reached));
                                return numbers.copied().unwrap_or(NO_PLACE);
                            }
                            step => step == Step::Open,
                        };
                        let offset = if is_open { way.map(|way| way as i16) } else { column[place].stop };
                        ends.push(End { place: own, offset, is_open });
                        NO_PLACE
                    });
                    region.links.push(links);
                }
            }
        }
        region.levels = region.levelled();
        if region.grid.pawn.max_grade.is_finite() {
            region.leave_out(&region.too_steep(), &mut ends);
        }
        if region.grid.pawn.max_ramp.is_finite() {
            region.leave_out(&region.far_from_landings(), &mut ends);
        }
        region.clearances = clearances(&standing.grid, &region.links, &ends);
        region.measure(standing);
        region
    }
}

/// Returns the first pixels of all tiles with standing places, by y, then x.
fn corners(grid: &Grid, set: &Snapshot) -> Vec<[i32; 2]> {
    // The feet are supported within a pixel of their middle, so a place may lie in the next tile.
    let mut corners: Vec<[i32; 2]> = (0..set.column_count())
        .flat_map(|number| {
            let (tx, ty, _) = set.column_at(number);
            let at = [tx - grid.origin[0], ty - grid.origin[1]];
            (-1..=1).flat_map(move |y| (-1..=1).map(move |x| [64 * (at[0] + x), 64 * (at[1] + y)]))
        })
        .filter(|corner| grid.is_inside(*corner))
        .collect();
    corners.sort_unstable_by_key(|corner| [corner[1], corner[0]]);
    corners.dedup();
    corners
}

/// A place of a [`Region`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Place {
    /// Place of the feet: the middle of a pixel, on the highest span under the footprint (m).
    pub feet: Point3<f64>,
    /// Distance from the middle of the feet to the nearest thing that the pawn cannot walk over, exact to a pixel (m):
    /// something solid that stops its body, or missing ground beyond a ledge, a hole or the end of the scan. Gaps that
    /// its footprint spans do not count. Infinite if nothing ends the region.
    pub clearance: f64,
}

/// All places that can be reached from one of them, and the steps between them.
///
/// Places are numbered by tile (y, then x), pixel and height, so equal scenes give equal regions.
#[derive(Debug, Clone)]
pub struct Region {
    pub(super) grid: Grid,
    pub(super) pixels: Vec<[i32; 2]>,
    pub(super) tops: Vec<i32>,
    /// True for standing places, false for bridges.
    pub(super) standing: Vec<bool>,
    pub(super) links: Vec<[u32; 4]>,
    pub(super) clearances: Vec<f32>,
    /// Heights averaged over the places around (quanta).
    pub(super) levels: Vec<i32>,
    /// Costs of the routes from some distant places; empty unless prepared.
    pub(super) landmarks: Vec<[u32; LANDMARKS]>,
    lowest_headroom: Option<(i32, u32)>,
    highest_step: Option<(i32, u32)>,
}

impl Region {
    /// Returns whether a place lies beside the end of the region, or beside a gap that the footprint spans.
    pub(super) fn is_beside_end(&self, place: u32) -> bool {
        let is_inner = |link: &u32| self.standing.get(*link as usize).is_some_and(|standing| *standing);
        !self.links[place as usize].iter().all(is_inner)
    }

    /// Returns the pawn.
    pub fn pawn(&self) -> &Pawn {
        &self.grid.pawn
    }

    /// Returns the number of places, bridges included.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Returns whether the region has no places.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// Returns all standing places, in order.
    pub fn places(&self) -> impl Iterator<Item = Place> + '_ {
        (0..self.len() as u32).filter(|place| self.standing[*place as usize]).map(|place| self.place(place))
    }

    pub(super) fn place(&self, number: u32) -> Place {
        Place { feet: self.feet(number), clearance: f64::from(self.clearances[number as usize]) }
    }

    pub(super) fn feet(&self, number: u32) -> Point3<f64> {
        let [i, j] = self.pixels[number as usize];
        Point3::new(self.grid.middle(i, 0), self.grid.middle(j, 1), self.grid.z(self.tops[number as usize]))
    }

    /// Returns the area of all standing places (m²): a pixel each. Places above one another all count.
    pub fn area_m2(&self) -> f64 {
        self.area_of(self.standing.iter().filter(|standing| **standing).count())
    }

    pub(super) fn area_of(&self, places: usize) -> f64 {
        places as f64 * self.grid.frame.pixel_m().powi(2)
    }

    /// Returns the standing place with the least headroom, and its headroom (m); `None` if nothing lies above any
    /// place.
    pub fn lowest_headroom(&self) -> Option<(Place, f64)> {
        self.lowest_headroom.map(|(room, place)| (self.place(place), f64::from(room) * self.grid.frame.quantum_m()))
    }

    /// Returns the place below the highest step up to a neighbouring place, and the height of that step (m); `None` if
    /// there is no step up.
    pub fn highest_step(&self) -> Option<(Place, f64)> {
        self.highest_step.map(|(rise, place)| (self.place(place), f64::from(rise) * self.grid.frame.quantum_m()))
    }

    /// Returns the number of a place; `None` if it is not reached.
    pub(super) fn number(&self, spot: &PlaceId) -> Option<u32> {
        // The order in which places are numbered.
        let key = |[i, j]: [i32; 2], top: i32| (j >> 6, i >> 6, j & 63, i & 63, top);
        let (mut low, mut high) = (0, self.len());
        while low < high {
            let middle = low.midpoint(high);
            if key(self.pixels[middle], self.tops[middle]) < key(spot.pixel, spot.top) {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        (low < self.len() && (self.pixels[low], self.tops[low]) == (spot.pixel, spot.top)).then_some(low as u32)
    }

    /// Leaves out these places: the region ends there.
    fn leave_out(&mut self, is_out: &[bool], ends: &mut Vec<End>) {
        for place in 0..self.len() {
            for (link, way) in self.links[place].iter_mut().zip(WAYS) {
                if *link != NO_PLACE && (is_out[place] || is_out[*link as usize]) {
                    *link = NO_PLACE;
                    if !is_out[place] {
                        let offset = way.map(|way| way as i16);
                        ends.push(End { place: place as u32, offset, is_open: false });
                    }
                }
            }
            self.standing[place] &= !is_out[place];
        }
    }

    /// Leaves out the places that no steps lead to from any of `starts`. Only a pawn with a steepest grade or a longest
    /// ramp leaves such places in the region of a [`Flood`] from them. `standing` are the standing places of the region.
    pub fn keep_linked(&mut self, standing: &StandingPlaces, starts: &[PlaceId]) {
        let mut seen = vec![false; self.len()];
        let mut open: Vec<u32> = starts.iter().filter_map(|start| self.number(start)).collect();
        open.iter().for_each(|place| seen[*place as usize] = true);
        while let Some(place) = open.pop() {
            for &next in self.links[place as usize].iter().filter(|next| **next != NO_PLACE) {
                if !std::mem::replace(&mut seen[next as usize], true) {
                    open.push(next);
                }
            }
        }
        self.standing.iter_mut().zip(seen).for_each(|(standing, seen)| *standing &= seen);
        self.measure(standing);
    }

    /// Finds the lowest headroom of the standing places, and the highest step that begins or ends at one of them.
    pub(super) fn measure(&mut self, standing: &StandingPlaces) {
        (self.lowest_headroom, self.highest_step) = (None, None);
        for place in 0..self.len() {
            let (pixel, top, stands) = (self.pixels[place], self.tops[place], self.standing[place]);
            if stands && let Some(tile) = standing.known(pixel) {
                let above = standing.tiles[tile].column(pixel).iter().find(|block| block.top > top);
                let room = above.map(|block| block.bottom - top);
                if let Some(room) = room.filter(|room| self.lowest_headroom.is_none_or(|lowest| *room < lowest.0)) {
                    self.lowest_headroom = Some((room, place as u32));
                }
            }
            for &link in self.links[place].iter().filter(|link| **link != NO_PLACE) {
                let rise = self.tops[link as usize] - top;
                let is_highest = rise > 0 && self.highest_step.is_none_or(|(highest, _)| rise > highest);
                if is_highest && (stands || self.standing[link as usize]) {
                    self.highest_step = Some((rise, place as u32));
                }
            }
        }
    }

    /// Returns whether the pawn can stand at a place of the region.
    pub fn stands_at(&self, spot: &PlaceId) -> bool {
        self.number(spot).is_some_and(|place| self.standing[place as usize])
    }

    /// Returns whether a place has been reached.
    pub fn holds(&self, spot: &PlaceId) -> bool {
        self.number(spot).is_some()
    }

    /// Returns the memory of the region (bytes).
    pub fn memory_bytes(&self) -> usize {
        let place =
            size_of::<[i32; 2]>() + 2 * size_of::<i32>() + size_of::<bool>() + size_of::<[u32; 4]>() + size_of::<f32>();
        self.len() * place + size_of_val(&self.landmarks[..])
    }
}

/// Returns the item whose pixel is nearest to the mean of all; of several the first along y, then x.
pub(super) fn middle<T: Copy>(items: &[T], pixel: impl Fn(&T) -> [i32; 2]) -> Option<T> {
    let count = items.len() as i64;
    let sum = |axis: usize| items.iter().map(|item| i64::from(pixel(item)[axis])).sum::<i64>();
    let sum = [sum(0), sum(1)];
    let far = |item: &&T| {
        let own = pixel(item);
        let gap = [0, 1].map(|axis| i128::from(i64::from(own[axis]) * count - sum[axis]));
        (gap[0] * gap[0] + gap[1] * gap[1], own[1], own[0])
    };
    items.iter().min_by_key(far).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, PageKey};
    use crate::page::{PageBuilder, Span};
    use crate::walk::Body;

    #[test]
    fn a_flood_from_everywhere_continues_where_pages_were_missing() {
        let mut builder = PageBuilder::default();
        for (px, py) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
            assert!(builder.set_column(px, py, &[Span::new(0, 10, false).unwrap()]));
        }
        let keys = [0, 1, 2].map(|tx| PageKey { tx, ty: 0, layer: 0 });
        let page = builder.build();
        let set = Snapshot::from_pages(Frame::new(0.05, 0.15).unwrap(), keys.map(|key| (key, page.clone())));
        let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 });
        let mut standing = StandingPlaces::new(&set, pawn).unwrap();
        let (mut computed, mut loaded) = (Vec::new(), Vec::new());
        let flood = loop {
            match Flood::everywhere(&mut standing, &set.keep_loaded(|key| loaded.contains(&key))).unwrap() {
                Answer::Known(flood) => break flood,
                Answer::NotLoaded(missing) => loaded.extend(missing.keys().iter().take(1)),
            }
            computed.push(standing.begun.as_ref().unwrap().1.len());
        };
        assert!(computed.is_sorted() && computed[1] > computed[0], "{computed:?}");
        let Answer::Known(whole) = Flood::everywhere(&mut standing, &set).unwrap() else { panic!("all is loaded") };
        assert!(flood.open == whole.open && flood.open.len() > 3 * 64 * 64);
    }
}
