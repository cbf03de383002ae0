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

mod gaps;
mod rims;

use self::gaps::{Gap, Gaps, There};
use self::rims::{Brink, Rim, Stretch};
use super::region::{Region, middle};
use super::standing::StandingPlaces;
use super::{Needs, answer};
use crate::Result;
use crate::query::Answer;
use crate::store::Snapshot;
use nalgebra::Point3;
use std::ops::ControlFlow;

/// Edge of a tile (pixels).
const TILE: usize = 64;
/// Stands for no brink or gap.
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
    gaps: Gaps,
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

struct Survey<'a> {
    region: &'a Region,
    found: &'a mut Found,
    standing: &'a mut StandingPlaces,
    set: &'a Snapshot,
    /// The last tile and its number.
    last: Option<([i32; 2], usize)>,
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
            let gap = self.found.gaps.all.len() as u32 - 1;
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
        stretches_of.resize_with(self.found.gaps.all.len(), Vec::new);
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
        ControlFlow::Continue(self.standing.there_in(tile, pixel, level))
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
