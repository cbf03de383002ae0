//! Seen space: the cells that some station looked through entirely.
//!
//! # Rule
//!
//! A cell of 4 × 4 pixels and one slice is seen if one station sees through every place in it. A station sees through a
//! place at the distance `r` if, in its image of `n × n` directions a face of a cube,
//!
//! - at least five of the direction of the place and the eight around it hold a return, and
//! - every return in these nine is farther than `r` by more than 5 cm and 1 % of `r` ([`margin_m`]),
//!
//! and `r` is at least [`NEAREST_M`]. So for every place in a seen cell there is a station all of whose returns within
//! `0.9/n` radians of the direction of the place are farther by more than the margin, and at least five of whose
//! returns lie within `12/n` radians. Whatever is doubtful is unseen: directions without returns, such as the sky,
//! glass and wet floors; what only grazes an edge; the last centimetres before a surface.
//!
//! `n` follows from the returns of the station: the finest image of 512, 256 ... 32 in which three of four neighbours of
//! directions with returns have returns, too. Where fewer than five of nine have, the next coarser image decides. A
//! moving scanner has rays that begin up to [`Station::within_m`] from the station, so at a distance `r` only images
//! with directions wider than that length over `r` are used ([`Station::first_level_at`]).
//!
//! Cells have four pixels across, since a pawn is about ten wide and a slice three high: cells are nearly cubes, smaller
//! than a body and larger than the margin. Cells of two pixels would be eight times as many for one in ten more of
//! space, those of eight would leave doorways unseen.
//!
//! # Method
//!
//! Least distances over the nine directions are computed once for each direction. An image pyramid of their least and
//! greatest values answers for all directions of a box at once. Boxes are pages, then their halves and eighths, down to
//! single cells: most boxes are all seen or not seen at all. Only products, sums, quotients and square roots are used,
//! and a cell depends on its place and the images alone, so neither order, threads, memory nor parts change a bit.

use super::cell::{Cell, EDGE, LEVELS, direction};
use super::view::{CELL_ANGLE, FARTHEST_CM, LEAST_SEEN, NEAREST_M, Station, View, beyond, margin_m, seen_m};
use crate::frame::{Frame, PAGE_SLICES, PageKey, TILE_PIXELS};
use slicewalk::seen::{CELL_PIXELS, SeenPage};
use std::ops::Range;
use std::sync::atomic::Ordering;

/// Images of a station that decide seen space; those beyond [`LEVELS`] serve moving scanners near by.
const IMAGES: usize = LEVELS + 2;
/// Value of a direction in which too little was measured: nearer than any distance.
const UNKNOWN: u16 = u16::MAX;
/// Boxes are larger than their cells by this (m), which is more than the rounding of their corners.
const SLACK_M: f64 = 1e-6;
/// Margin for the rounding of directions (cells of an image).
const ROUNDING: f64 = 1e-6;
/// Greatest index of a tile or layer, and of the negative ones.
const MOST_TILE: i32 = (1 << 30) - 1;
/// Cells of an image per node of its pyramid of greatest distances.
const COARSE: usize = 3;

/// Image with pyramids: nodes of level `k` cover `2^k × 2^k` directions.
#[derive(Debug)]
struct Image {
    /// Least distance around a direction, as values of a view; [`UNKNOWN`] where none is known. Greatest values of
    /// coarser nodes follow.
    nearest: Vec<Vec<u16>>,
    /// Least values (greatest distances) of nodes of level [`COARSE`] and coarser.
    farthest: Vec<Vec<u16>>,
    edge: usize,
}

/// Directions of a face: columns and rows, first and last.
type Directions = (usize, [[usize; 2]; 2]);

impl Image {
    fn new(edge: usize, values: Vec<u16>) -> Self {
        let levels = edge.trailing_zeros() as usize;
        let (mut nearest, mut least) = (vec![values], Vec::new());
        let mut below: Option<Vec<u16>> = None;
        for level in 1..=levels {
            nearest.push(joined(&nearest[level - 1], edge >> (level - 1), u16::max));
            let values = joined(below.as_deref().unwrap_or(&nearest[0]), edge >> (level - 1), u16::min);
            if level >= COARSE.min(levels) {
                least.push(values.clone());
            }
            below = Some(values);
        }
        Self { nearest, farthest: least, edge }
    }

    fn levels(&self) -> usize {
        self.edge.trailing_zeros() as usize
    }

    /// Least value of all: the greatest distance.
    fn farthest_of_all(&self) -> u16 {
        self.farthest.last().map_or(UNKNOWN, |faces| faces.iter().copied().min().unwrap_or(UNKNOWN))
    }

    /// Returns whether all of these directions hold values of at most `behind`, that is farther distances.
    fn are_all_behind(&self, at: &Directions, behind: u16) -> bool {
        let is_behind = |level: usize, node: usize| self.nearest[level][node] <= behind;
        self.all(at, self.first_level(at, 0), 0, &is_behind)
    }

    /// Returns whether some of these directions may hold a value of at most `behind`; exact to nodes of the pyramid.
    fn is_any_behind(&self, at: &Directions, behind: u16) -> bool {
        let first = COARSE.min(self.levels());
        let is_before = |level: usize, node: usize| self.farthest[level - first][node] > behind;
        !self.all(at, self.first_level(at, first), first, &is_before)
    }

    /// Returns the level of which a few nodes cover these directions.
    fn first_level(&self, (_, ranges): &Directions, least: usize) -> usize {
        let wide = ranges.iter().map(|[first, last]| last - first).max().unwrap_or(0) + 1;
        (wide.next_power_of_two().trailing_zeros() as usize).clamp(least, self.levels())
    }

    /// Returns whether `holds` is true for all directions; a node for which it is true answers for those in it. Goes no
    /// deeper than `last`.
    fn all(
        &self,
        &(face, [columns, rows]): &Directions,
        level: usize,
        last: usize,
        holds: &dyn Fn(usize, usize) -> bool,
    ) -> bool {
        let edge = self.edge >> level;
        (rows[0] >> level..=rows[1] >> level).all(|row| {
            (columns[0] >> level..=columns[1] >> level).all(|column| {
                if holds(level, (face * edge + row) * edge + column) {
                    return true;
                }
                if level == last {
                    return false;
                }
                let part =
                    |[first, end]: [usize; 2], at: usize| [first.max(at << level), end.min(((at + 1) << level) - 1)];
                self.all(&(face, [part(columns, column), part(rows, row)]), level - 1, last, holds)
            })
        })
    }
}

/// What one station says of a box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Seen {
    All,
    /// Perhaps some of its cells.
    Some,
    Nothing,
}

/// Box between two corners (m).
type Corners = ([f64; 3], [f64; 3]);

/// Images of a station from which seen space follows.
///
/// Memory: 4.3 MB of a stationary station whose finest image is used, at most 0.2 MB of a moving one.
#[derive(Debug)]
pub struct FreeView {
    station: Station,
    /// Images from the first one that is used; of a stationary station only that.
    images: Vec<Image>,
    /// Distance beyond which it sees nothing (m).
    reach_m: f64,
}

impl FreeView {
    /// Makes the images from a complete view.
    pub(super) fn new(view: &View) -> Self {
        let station = view.station;
        let lowest = station.first_level();
        let mut plain: Vec<Vec<u16>> = (lowest..LEVELS)
            .map(|level| view.values(level).iter().map(|value| value.load(Ordering::Relaxed)).collect())
            .collect();
        for level in LEVELS..IMAGES {
            let coarser = joined(&plain[level - 1 - lowest], EDGE >> (level - 1), u16::max);
            plain.push(coarser);
        }
        let is_dense = |level: usize| is_dense(&plain[level - lowest], EDGE >> level);
        let first = (lowest..LEVELS).find(|&level| is_dense(level)).unwrap_or(LEVELS - 1);
        // A stationary station needs one image.
        let last = if station.within_m > 0.0 { IMAGES } else { first + 1 };
        let around = |level: usize| nearest_around(&plain[level - lowest], EDGE >> level);
        let mut images = Vec::new();
        let mut own = around(first);
        for level in first..last {
            let mut coarser = if level + 1 < IMAGES { around(level + 1) } else { Vec::new() };
            let edge = EDGE >> level;
            if !coarser.is_empty() {
                for (at, value) in own.iter_mut().enumerate().filter(|(_, value)| **value == UNKNOWN) {
                    let (face, row, column) = (at / (edge * edge), at / edge % edge, at % edge);
                    *value = coarser[(face * (edge / 2) + row / 2) * (edge / 2) + column / 2];
                }
            }
            images.push(Image::new(edge, std::mem::replace(&mut own, std::mem::take(&mut coarser))));
        }
        let values = images.iter().map(Image::farthest_of_all).filter(|&value| value != UNKNOWN);
        let reach_m = values.min().map_or(0.0, seen_m);
        Self { station, images, reach_m }
    }

    /// Returns the position of the image to use for a place at this distance, if any can be used.
    fn image_at(&self, distance_m: f64) -> Option<usize> {
        let is_wide = |&at: &usize| self.station.within_m * self.images[at].edge as f64 <= CELL_ANGLE * distance_m;
        (0..self.images.len()).find(is_wide)
    }

    /// Returns what the station saw of a box. The result is `Nothing` only if it saw through no place in it.
    fn of(&self, (min, max): &Corners) -> Seen {
        // These operations are monotone, so a box in a box is nowhere nearer or farther.
        let low: [f64; 3] = std::array::from_fn(|axis| min[axis] - self.station.at[axis]);
        let high: [f64; 3] = std::array::from_fn(|axis| max[axis] - self.station.at[axis]);
        let length = |d: [f64; 3]| (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let nearest = length(std::array::from_fn(|axis| low[axis].max(-high[axis]).max(0.0)));
        if nearest + margin_m(nearest) >= self.reach_m {
            return Seen::Nothing;
        }
        let farthest = length(std::array::from_fn(|axis| high[axis].max(-low[axis])));
        if farthest < NEAREST_M {
            return Seen::Nothing;
        }
        let image = self.image_at(nearest).filter(|_| nearest >= NEAREST_M);
        // Nearer parts of the box may need coarser images than farther ones.
        let Some(finest) = self.image_at(farthest) else { return Seen::Nothing };
        let used = &self.images[finest..=self.image_at(nearest).unwrap_or(self.images.len() - 1)];
        let behind_near = beyond(nearest + margin_m(nearest));
        let far = farthest + margin_m(farthest);
        let behind_far = if far < f64::from(FARTHEST_CM) * 0.01 { beyond(far) } else { 0 };
        let (mut all, mut any) = (image.is_some() && behind_far > 0, false);
        for directions in Faces::of(low, high) {
            if let Some(image) = image.map(|at| &self.images[at])
                && all
            {
                all = image.are_all_behind(&directions.on(image.edge), behind_far);
            }
            any = any || used.iter().any(|image| image.is_any_behind(&directions.on(image.edge), behind_near));
            if any && !all {
                return Seen::Some;
            }
        }
        match (all, any) {
            (true, _) => Seen::All,
            (false, true) => Seen::Some,
            (false, false) => Seen::Nothing,
        }
    }
}

/// Returns an image half as fine, of what `pick` takes of four values.
fn joined(values: &[u16], edge: usize, pick: fn(u16, u16) -> u16) -> Vec<u16> {
    let mut half = Vec::with_capacity(values.len() / 4);
    for rows in values.chunks_exact(2 * edge) {
        let (upper, lower) = rows.split_at(edge);
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        half.extend(pairs.map(|(a, b)| pick(pick(a[0], a[1]), pick(b[0], b[1]))));
    }
    half
}

/// Returns whether three of four neighbours of directions with returns have returns.
fn is_dense(values: &[u16], edge: usize) -> bool {
    let (mut either, mut both) = (0u64, 0u64);
    let mut compare = |a: &[u16], b: &[u16]| {
        for (a, b) in a.iter().zip(b) {
            either += u64::from(a | b != 0);
            both += u64::from(*a != 0 && *b != 0);
        }
    };
    for face in values.chunks_exact(edge * edge) {
        face.chunks_exact(edge).for_each(|row| compare(row, &row[1..]));
        compare(face, &face[edge..]);
    }
    either > 0 && 4 * both >= 3 * either
}

/// Returns for each direction the least distance of it and the eight around it, or [`UNKNOWN`] if fewer than
/// [`LEAST_SEEN`] of these have one.
fn nearest_around(values: &[u16], edge: usize) -> Vec<u16> {
    let mut around = Vec::with_capacity(values.len());
    let decided = |(nearest, known): (u16, usize)| if known >= LEAST_SEEN { nearest } else { UNKNOWN };
    for (face, row) in (0..6).flat_map(|face| (0..edge).map(move |row| (face, row))) {
        let at_the_edge = |column: usize| decided(around_at_the_edge(values, edge, face, [column as i64, row as i64]));
        if row == 0 || row == edge - 1 {
            around.extend((0..edge).map(at_the_edge));
            continue;
        }
        let first = (face * edge + row) * edge;
        let [above, own, below] = [first - edge, first, first + edge].map(|first| &values[first..first + edge]);
        around.push(at_the_edge(0));
        around.extend(above.windows(3).zip(own.windows(3)).zip(below.windows(3)).map(|((above, own), below)| {
            let (mut nearest, mut known) = (0, 0);
            for &value in above.iter().chain(own).chain(below) {
                nearest = nearest.max(value);
                known += usize::from(value != 0);
            }
            decided((nearest, known))
        }));
        around.push(at_the_edge(edge - 1));
    }
    around
}

/// Like the inner part of [`nearest_around`], for a direction at the edge of a face. Rows of two faces do not meet end to
/// end, so of those on other faces the ones next to them count as well.
fn around_at_the_edge(values: &[u16], edge: usize, face: usize, [column, row]: [i64; 2]) -> (u16, usize) {
    let level = (EDGE / edge).trailing_zeros() as usize;
    let (mut nearest, mut known) = (0, 0);
    let inside = 0..edge as i64;
    for (x, y) in (-1..=1).flat_map(|y| (-1..=1).map(move |x| (column + x, row + y))) {
        if inside.contains(&x) && inside.contains(&y) {
            let value = values[(face * edge + y as usize) * edge + x as usize];
            nearest = nearest.max(value);
            known += usize::from(value != 0);
            continue;
        }
        let (other, [x, y]) = Cell::of(direction(face, [x, y], edge)).parts(level);
        known += usize::from(values[(other * edge + y as usize) * edge + x as usize] != 0);
        for (x, y) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy))) {
            if inside.contains(&x) && inside.contains(&y) {
                nearest = nearest.max(values[(other * edge + y as usize) * edge + x as usize]);
            }
        }
    }
    (nearest, known)
}

/// Directions of a box on one face, in units of half its edge: from −1 to 1.
struct OnFace {
    face: usize,
    across: [[f64; 2]; 2],
}

impl OnFace {
    /// Returns the directions as columns and rows of an image.
    fn on(&self, edge: usize) -> Directions {
        let cell = |at: f64| at.clamp(0.0, (edge - 1) as f64) as usize;
        let ranges = self.across.map(|[first, last]| {
            let [first, last] = [first, last].map(|at| (at + 1.0) / 2.0 * edge as f64);
            [cell(first - ROUNDING), cell(last + ROUNDING)]
        });
        (self.face, ranges)
    }
}

/// Faces of the cube on which a box has directions.
struct Faces {
    low: [f64; 3],
    high: [f64; 3],
    faces: Range<usize>,
}

impl Faces {
    /// From the corners of a box relative to the station.
    fn of(low: [f64; 3], high: [f64; 3]) -> Self {
        Self { low, high, faces: 0..6 }
    }
}

impl Iterator for Faces {
    type Item = OnFace;

    fn next(&mut self) -> Option<OnFace> {
        loop {
            let face = self.faces.next()?;
            let axis = face / 2;
            let (near, far) = match face % 2 {
                0 => (self.low[axis], self.high[axis]),
                _ => (-self.high[axis], -self.low[axis]),
            };
            let others = [1, 2].map(|step| {
                let other = (axis + step) % 3;
                [self.low[other], self.high[other]]
            });
            // No place of the face is nearer along its axis than across it.
            let least = others.map(|[low, high]| low.max(-high).max(0.0));
            let near = near.max(least[0]).max(least[1]);
            if far <= 0.0 || far < near {
                continue;
            }
            let across = others.map(|[low, high]| {
                let quotient = |at: f64, outwards: bool| {
                    let depth = if outwards { near } else { far };
                    if depth > 0.0 {
                        (at / depth).clamp(-1.0, 1.0)
                    } else if at < 0.0 {
                        -1.0
                    } else {
                        1.0
                    }
                };
                [quotient(low, low < 0.0), quotient(high, high > 0.0)]
            });
            return Some(OnFace { face, across });
        }
    }
}

/// Box of cells of a page: first and last cell along each axis.
type Cells = [[usize; 2]; 3];

/// Seen space of a set of stations.
#[derive(Debug)]
pub struct FreeSpace {
    views: Vec<FreeView>,
    frame: Frame,
}

/// A tile column in which some stations may have seen something.
#[derive(Debug, Clone)]
pub struct FreeColumn {
    /// Key of the column; the layer has no meaning.
    pub key: PageKey,
    views: Vec<usize>,
}

impl FreeSpace {
    pub(super) fn new(views: Vec<FreeView>, frame: Frame) -> Self {
        Self { views, frame }
    }

    /// Passes the tile columns of `range` in which a station may have seen something to `take`, in archive order.
    pub fn each_column<E>(
        &self,
        range: (u64, u64),
        take: &mut dyn FnMut(FreeColumn) -> Result<(), E>,
    ) -> Result<(), E> {
        let views = (0..self.views.len()).filter(|&view| self.views[view].reach_m > 0.0).collect();
        self.descend(0, 32, views, range, take)
    }

    /// Visits the `2^size × 2^size` tiles whose first has the position `first` on the curve.
    fn descend<E>(
        &self,
        first: u64,
        size: u32,
        views: Vec<usize>,
        range: (u64, u64),
        take: &mut dyn FnMut(FreeColumn) -> Result<(), E>,
    ) -> Result<(), E> {
        let last = first + ((1u128 << (2 * size)) - 1) as u64;
        if views.is_empty() || last < range.0 || first > range.1 {
            return Ok(());
        }
        let key = PageKey::from_column(first, 0);
        let ends = [key.tx, key.ty].map(|tile| {
            [i64::from(tile), i64::from(tile) + (1i64 << size)].map(|tile| self.frame.edge_of_pixel(tile * TILE_PIXELS))
        });
        let mut views = views;
        views.retain(|&view| self.views[view].reaches(ends));
        if size == 0 {
            let in_grid = [key.tx, key.ty].iter().all(|tile| (-MOST_TILE..=MOST_TILE).contains(tile));
            return if views.is_empty() || !in_grid { Ok(()) } else { take(FreeColumn { key, views }) };
        }
        for quarter in 0..4 {
            self.descend(first + (quarter << (2 * size - 2)), size - 1, views.clone(), range, take)?;
        }
        Ok(())
    }

    /// Computes the pages of a column in which something was seen, lowest first.
    pub fn pages(&self, column: &FreeColumn) -> Vec<(PageKey, SeenPage)> {
        let PageKey { tx, ty, .. } = column.key;
        let mut layers: Vec<[i64; 2]> = column.views.iter().map(|&view| self.layers(view)).collect();
        layers.sort_unstable();
        let (mut pages, mut next) = (Vec::new(), i64::MIN);
        for [first, last] in layers {
            for layer in first.max(next)..=last {
                let key = PageKey { tx, ty, layer: layer as i32 };
                let page = self.page(key, &column.views);
                if page.cells() > 0 {
                    pages.push((key, page));
                }
            }
            next = next.max(last + 1);
        }
        pages
    }

    /// Returns the first and last layer that a station reaches.
    fn layers(&self, view: usize) -> [i64; 2] {
        let view = &self.views[view];
        const MOST: i64 = MOST_TILE as i64;
        [-view.reach_m, view.reach_m]
            .map(|reach| self.frame.slice_of(view.station.at[2] + reach).div_euclid(PAGE_SLICES).clamp(-MOST, MOST))
    }

    fn page(&self, key: PageKey, views: &[usize]) -> SeenPage {
        let mut page = SeenPage::NOTHING;
        let views: Vec<&FreeView> = views.iter().map(|&view| &self.views[view]).collect();
        self.cells(key, [[0, 15], [0, 15], [0, 63]], &views, &mut page);
        page
    }

    /// Marks what these stations saw of a box of cells.
    fn cells(&self, key: PageKey, cells: Cells, views: &[&FreeView], page: &mut SeenPage) {
        let corners = self.corners(key, cells);
        let mut perhaps = Vec::new();
        for &view in views {
            match view.of(&corners) {
                Seen::All => return page.mark(cells),
                Seen::Some => perhaps.push(view),
                Seen::Nothing => {}
            }
        }
        let lengths = cells.map(|[first, last]| last - first + 1);
        let longest = lengths.into_iter().max().unwrap_or(1);
        if perhaps.is_empty() || longest == 1 {
            return;
        }
        // Only the longest edges are halved: a page becomes four cubes, these eight each.
        let halves = |axis: usize| {
            let [first, last] = cells[axis];
            let middle = first + lengths[axis] / 2;
            if lengths[axis] == longest { vec![[first, middle - 1], [middle, last]] } else { vec![[first, last]] }
        };
        for z in halves(2) {
            for y in halves(1) {
                for x in halves(0) {
                    self.cells(key, [x, y, z], &perhaps, page);
                }
            }
        }
    }

    /// Returns a box (m) around cells of a page.
    fn corners(&self, key: PageKey, cells: Cells) -> Corners {
        let pixel = |tile: i32, cell: usize| i64::from(tile) * TILE_PIXELS + cell as i64 * CELL_PIXELS;
        let slice = |cell: usize| i64::from(key.layer) * PAGE_SLICES + cell as i64;
        let ends = |end: usize| {
            let at = cells.map(|range| range[end] + end);
            [
                self.frame.edge_of_pixel(pixel(key.tx, at[0])),
                self.frame.edge_of_pixel(pixel(key.ty, at[1])),
                self.frame.bottom_of_slice(slice(at[2])),
            ]
        };
        (ends(0).map(|at| at - SLACK_M), ends(1).map(|at| at + SLACK_M))
    }
}

impl FreeView {
    /// Returns whether the station reaches places between these coordinates along x and y (m).
    fn reaches(&self, ends: [[f64; 2]; 2]) -> bool {
        let apart = [0, 1].map(|axis| {
            let at = self.station.at[axis];
            (ends[axis][0] - at).max(at - ends[axis][1]).max(0.0)
        });
        // Rounded, so a little more than it reaches.
        apart[0] * apart[0] + apart[1] * apart[1] <= (self.reach_m + 0.01) * (self.reach_m + 0.01)
    }
}
