//! Leaks: where a region ends although nothing is in the way.
//!
//! A pixel is *open* at a height if the body fits there and no matter lies under the middle of the feet within
//! [`Pawn::max_drop`](super::Pawn::max_drop): it was not scanned, or it is deeper. The standing places next to open pixels
//! are the rim. Rim places within two pixels of each other are one leak; from them the open pixels are flooded at the height of the rim:
//!
//! - **edge**: nothing was scanned below, and the open pixels go on to the end of the scan (or over more than 2¹⁶ pixels);
//! - **hole**: they are closed in, and nothing was scanned below, or at least half of their border is floor;
//! - **ledge**: all others: what is below is deeper than the pawn drops.
//!
//! What is narrower than half of the pawn is no leak: a walker passes over it, and a scan has many such gaps.

use super::region::{Region, WAYS, middle};
use super::standing::{Block, Kind, StandingPlaces};
use super::{Needs, Stop, answer};
use crate::Result;
use crate::query::{Aabb, Answer, top_under};
use crate::store::PageSet;
use nalgebra::{Point3, Vector3};
use std::collections::{HashMap, HashSet, VecDeque};
use std::ops::ControlFlow;

/// Most open pixels that are looked at before a leak counts as an edge or a ledge.
const MOST_PIXELS: usize = 1 << 16;
/// Rim places this near each other belong together (pixels).
const TOGETHER: i32 = 2;

/// What kind of leak it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum LeakKind {
    /// A hole in a floor.
    Hole,
    /// The edge of the scan.
    Edge,
    /// A drop deeper than the pawn takes.
    Ledge,
}

impl LeakKind {
    /// As `slicetool reach` writes it.
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
    /// Its middle: of a hole the open pixel, else the rim place, nearest to the mean of all; at the height of the rim (m).
    pub at: Point3<f64>,
    /// Its greatest extent along x or y: of a hole itself, else of its rim (m).
    pub width: f64,
    /// How far down the next matter lies; `None` if nothing was scanned below (m).
    pub drop: Option<f64>,
    /// What kind it is.
    pub kind: LeakKind,
}

/// What lies at a pixel at the height of a rim.
#[derive(Clone, Copy, PartialEq)]
enum There {
    /// Nothing to stand on; how far down matter is (quanta).
    Open(Option<i32>),
    Floor,
    Matter,
    /// Beyond the scan.
    Outside,
}

impl Region {
    /// All leaks, by place (y, x, z). Needs pages around the rim, and in the tiles that the open pixels lie in.
    /// Fails where more matter lies over one tile than any scan has ([`Error::Limit`](crate::Error::Limit)).
    pub fn leaks<S: PageSet>(&self, standing: &mut StandingPlaces, set: &S) -> Result<Answer<Vec<Leak>>> {
        answer(Survey { region: self, standing, set, seen: HashMap::new() }.leaks())
    }
}

struct Survey<'a, S> {
    region: &'a Region,
    standing: &'a mut StandingPlaces,
    set: &'a S,
    /// What has been found out about pixels at heights.
    seen: HashMap<([i32; 2], i32), There>,
}

/// The open pixels behind a rim.
struct Opening {
    pixels: Vec<[i32; 2]>,
    drops: Vec<Option<i32>>,
    /// Border pixels with floor and with matter.
    floor: usize,
    matter: usize,
    is_closed: bool,
}

impl<S: PageSet> Survey<'_, S> {
    fn leaks(&mut self) -> Needs<Vec<Leak>> {
        // Pixels of holes and of openings that are none, with their heights.
        let mut holes: HashMap<[i32; 2], i32> = HashMap::new();
        let mut wide: HashMap<[i32; 2], i32> = HashMap::new();
        let mut leaks: Vec<Leak> = Vec::new();
        for rim in self.rims()? {
            // At the height at which most of the rim lies: stairs have a rim at each tread.
            let mut tops: Vec<i32> = rim.iter().map(|place| self.region.tops[*place as usize]).collect();
            tops.sort_unstable();
            let level = tops[tops.len() / 2];
            let opening = self.opening(&rim, level, &wide)?;
            let is_known = |pixel: &[i32; 2]| {
                holes.get(pixel).is_some_and(|known| (known - level).abs() < self.standing.grid.height)
            };
            if opening.pixels.is_empty() || opening.pixels.iter().any(is_known) || self.is_narrow(&opening) {
                continue;
            }
            let leak = self.leak(&rim, level, &opening)?;
            let seen = if leak.kind == LeakKind::Hole { &mut holes } else { &mut wide };
            seen.extend(opening.pixels.iter().map(|pixel| (*pixel, level)));
            if leak.kind == LeakKind::Hole || leak.width >= self.standing.grid.pawn.body.half().min() {
                leaks.push(leak);
            }
        }
        leaks.sort_by(|a, b| a.at.y.total_cmp(&b.at.y).then(a.at.x.total_cmp(&b.at.x)).then(a.at.z.total_cmp(&b.at.z)));
        ControlFlow::Continue(leaks)
    }

    /// Standing places next to open pixels, those near each other together.
    fn rims(&mut self) -> Needs<Vec<Vec<u32>>> {
        let mut rim: HashMap<[i32; 2], Vec<u32>> = HashMap::new();
        let mut order = Vec::new();
        for place in 0..self.region.len() as u32 {
            let at = place as usize;
            // A neighbour that can be stood on is no opening.
            let is_inner = |link: &u32| self.region.standing.get(*link as usize).is_some_and(|standing| *standing);
            if !self.region.standing[at] || self.region.links[at].iter().all(is_inner) {
                continue;
            }
            let ([i, j], level) = (self.region.pixels[at], self.region.tops[at]);
            for way in WAYS {
                if matches!(self.there([i + way[0], j + way[1]], level)?, There::Open(_)) {
                    rim.entry([i, j]).or_default().push(place);
                    order.push(place);
                    break;
                }
            }
        }
        let mut taken: HashSet<u32> = HashSet::new();
        let mut rims = Vec::new();
        for first in order {
            if !taken.insert(first) {
                continue;
            }
            let (mut own, mut next) = (vec![first], 0);
            while next < own.len() {
                let at = own[next] as usize;
                next += 1;
                let ([i, j], level) = (self.region.pixels[at], self.region.tops[at]);
                for (x, y) in
                    (i - TOGETHER..=i + TOGETHER).flat_map(|x| (j - TOGETHER..=j + TOGETHER).map(move |y| (x, y)))
                {
                    for &other in rim.get(&[x, y]).map_or(&[][..], Vec::as_slice) {
                        let is_level = (self.region.tops[other as usize] - level).abs() <= self.standing.grid.up;
                        if is_level && taken.insert(other) {
                            own.push(other);
                        }
                    }
                }
            }
            rims.push(own);
        }
        ControlFlow::Continue(rims)
    }

    fn there(&mut self, pixel: [i32; 2], level: i32) -> Needs<There> {
        if let Some(there) = self.seen.get(&(pixel, level)) {
            return ControlFlow::Continue(*there);
        }
        let there = self.look(pixel, level)?;
        self.seen.insert((pixel, level), there);
        ControlFlow::Continue(there)
    }

    fn look(&mut self, pixel: [i32; 2], level: i32) -> Needs<There> {
        if !self.standing.grid.is_inside(pixel) {
            return ControlFlow::Continue(There::Outside);
        }
        let tile = self.standing.tile(self.set, pixel)?;
        let grid = &self.standing.grid;
        let column: &[Block] = self.standing.tiles[tile].column(pixel);
        let (below, above) = column.split_at(column.partition_point(|block| block.top <= level + grid.up));
        let feet = below.last().map_or(level, |block| block.top.max(level));
        if above.first().is_some_and(|block| block.bottom - feet < grid.height) {
            return ControlFlow::Continue(There::Matter);
        }
        if below.last().is_some_and(|block| level - block.top <= grid.drop && block.kind != Kind::Bridge) {
            return ControlFlow::Continue(There::Floor);
        }
        let under = self.under_foot(pixel, level)?;
        let is_deep = under.is_none_or(|drop| drop > self.standing.grid.drop);
        ControlFlow::Continue(if is_deep { There::Open(under) } else { There::Floor })
    }

    /// How far below `level` the highest matter under the middle of the feet lies (quanta).
    fn under_foot(&self, pixel: [i32; 2], level: i32) -> Needs<Option<i32>> {
        let grid = &self.standing.grid;
        let edge = (2.0 * f64::from(grid.foot) + 0.5) * grid.frame.pixel_m();
        let at = Point3::new(grid.middle(pixel[0], 0), grid.middle(pixel[1], 1), 0.0);
        // Sizes of a pixel, at places inside the set: it is a box.
        let Ok(foot) = Aabb::standing(at, Vector3::new(edge, edge, 0.0)) else { return ControlFlow::Continue(None) };
        // Down to the bottom of the set.
        let depth = f64::from((level + grid.up).max(0) + 1) * grid.frame.quantum_m();
        match top_under(self.set, &foot, grid.z(level + grid.up), depth) {
            Answer::Known(top) => ControlFlow::Continue(top.map(|top| level - grid.level(top))),
            Answer::NotLoaded(missing) => ControlFlow::Break(Stop::Missing(missing)),
        }
    }

    /// Floods the open pixels at `level` next to a rim.
    fn opening(&mut self, rim: &[u32], level: i32, wide: &HashMap<[i32; 2], i32>) -> Needs<Opening> {
        let mut opening = Opening { pixels: Vec::new(), drops: Vec::new(), floor: 0, matter: 0, is_closed: true };
        let mut seen: HashSet<[i32; 2]> = HashSet::new();
        let near = |place: &&u32| (self.region.tops[**place as usize] - level).abs() <= self.standing.grid.up;
        let mut queue: VecDeque<[i32; 2]> =
            rim.iter().filter(near).map(|place| self.region.pixels[*place as usize]).collect();
        let mut is_rim = queue.len();
        while let Some([i, j]) = queue.pop_front() {
            let from_rim = is_rim > 0;
            is_rim = is_rim.saturating_sub(1);
            for way in WAYS {
                let to = [i + way[0], j + way[1]];
                if seen.contains(&to) {
                    continue;
                }
                match self.there(to, level)? {
                    There::Open(drop) => {
                        seen.insert(to);
                        opening.pixels.push(to);
                        opening.drops.push(drop);
                        queue.push_back(to);
                        let is_wide = |known: &i32| (known - level).abs() < self.standing.grid.height;
                        opening.is_closed &= !wide.get(&to).is_some_and(is_wide);
                    }
                    There::Outside => opening.is_closed = false,
                    There::Floor if !from_rim => {
                        seen.insert(to);
                        opening.floor += 1;
                    }
                    There::Matter if !from_rim => {
                        seen.insert(to);
                        opening.matter += 1;
                    }
                    _ => {}
                }
            }
            opening.is_closed &= opening.pixels.len() <= MOST_PIXELS;
            if !opening.is_closed {
                // What lies farther off says nothing about the rim.
                break;
            }
        }
        ControlFlow::Continue(opening)
    }

    /// Extent along x and y of pixels that widen by `beyond` on each side (m).
    fn extent(&self, pixels: impl Iterator<Item = [i32; 2]>, beyond: i32) -> [f64; 2] {
        let (mut low, mut high) = ([i32::MAX; 2], [i32::MIN; 2]);
        for pixel in pixels {
            for axis in 0..2 {
                (low[axis], high[axis]) = (low[axis].min(pixel[axis]), high[axis].max(pixel[axis]));
            }
        }
        [0, 1].map(|axis| f64::from(high[axis] - low[axis] + 1 + 2 * beyond) * self.standing.grid.frame.pixel_m())
    }

    fn is_narrow(&self, opening: &Opening) -> bool {
        if !opening.is_closed {
            return false;
        }
        let pixel = self.standing.grid.frame.pixel_m();
        let longest = self.extent(opening.pixels.iter().copied(), 0).into_iter().fold(0.0, f64::max);
        let mean =
            opening.pixels.len() as f64 * pixel * pixel / longest + 2.0 * f64::from(self.standing.grid.foot) * pixel;
        mean < self.standing.grid.pawn.body.half().min()
    }

    /// Extent of a rim; where it ends at matter the way goes on beside the middle of the pawn (m).
    fn rim_width(&mut self, rim: &[u32]) -> Needs<f64> {
        let at = |place: &u32| self.region.pixels[*place as usize];
        let extent = self.extent(rim.iter().map(at), 0);
        let axis = usize::from(extent[1] > extent[0]);
        let mut beside = 0;
        for (end, way) in [
            (rim.iter().min_by_key(|place| at(place)[axis]), axis + 2),
            (rim.iter().max_by_key(|place| at(place)[axis]), axis),
        ] {
            let Some(&end) = end else { continue };
            let ([i, j], level) = (self.region.pixels[end as usize], self.region.tops[end as usize]);
            if self.there([i + WAYS[way][0], j + WAYS[way][1]], level)? == There::Matter {
                beside += self.standing.grid.half[axis];
            }
        }
        ControlFlow::Continue(extent[axis] + f64::from(beside) * self.standing.grid.frame.pixel_m())
    }

    fn leak(&mut self, rim: &[u32], level: i32, opening: &Opening) -> Needs<Leak> {
        let mut drops: Vec<i32> = opening.drops.iter().filter_map(|drop| *drop).collect();
        let is_void = 2 * drops.len() < opening.drops.len();
        let kind = match opening.is_closed {
            true if is_void || opening.floor >= opening.matter => LeakKind::Hole,
            false if is_void => LeakKind::Edge,
            _ => LeakKind::Ledge,
        };
        let (width, at) = if kind == LeakKind::Hole {
            let extent = self.extent(opening.pixels.iter().copied(), self.standing.grid.foot);
            (extent[0].max(extent[1]), middle(&opening.pixels, |pixel| *pixel))
        } else {
            let pixel = |place: &u32| self.region.pixels[*place as usize];
            (self.rim_width(rim)?, middle(rim, pixel).map(|place| pixel(&place)))
        };
        let [i, j] = at.unwrap_or_default();
        // Of a large opening only what lies next to the rim says how deep one falls here.
        if kind != LeakKind::Hole {
            drops.truncate(rim.len().max(1));
        }
        drops.sort_unstable();
        let drop = drops.get(drops.len() / 2).filter(|_| !is_void);
        let grid = &self.standing.grid;
        ControlFlow::Continue(Leak {
            at: Point3::new(grid.middle(i, 0), grid.middle(j, 1), grid.z(level)),
            width,
            drop: drop.map(|drop| f64::from(*drop) * grid.frame.quantum_m()),
            kind,
        })
    }
}
