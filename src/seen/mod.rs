//! Seen space: which places of a scan are known to be free, because a scanner saw through them.
//!
//! Space is divided into *cells* of 4 × 4 pixels and one slice. A conversion stores a cell as seen only if one of the
//! scanner's stations looked through all of it (`sliceconv --free-space`, chapter 15 of the specification); of every
//! other cell nothing is known, whether solid lies in it or not. So a clear answer of [`query`](crate::query) can mean
//! "free" or "never seen", and this module tells the two apart.
//!
//! Surfaces and the two cells or so in front of them are never seen: the rule keeps a margin. A box beside a wall is
//! therefore not all seen, and a ray may end in front of what it hits.
//!
//! In: pages of cells ([`SeenPage`]) by key. Out: whether boxes and rays are all seen ([`SeenSpace`]).

mod page;
mod ray;

pub use page::{CELL_PIXELS, SeenBlock, SeenPage};

use crate::frame::{Frame, PAGE_SLICES, PageKey, TILE_PIXELS, morton};
use nalgebra::Point3;
use page::{BLOCK_LAYERS, CELLS_PER_ROW};

/// Slices at a floor that are hardly ever seen: that of its surface, and those in front of it.
const FLOOR_SLICES: i64 = 3;

/// Cells that the last stretch of a ray before its hit may cross unseen, along each axis.
const HIT_CELLS: i64 = 2;

/// Index of a cell: pixels divided by [`CELL_PIXELS`] along x and y, slice along z.
type CellIndex = [i64; 3];

/// Seen space of an archive, in memory.
///
/// Memory: 2 KiB for each page that is seen in part, and about 40 bytes for each 64 pages one above the other.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenSpace {
    frame: Frame,
    /// In ascending order of column, then group.
    blocks: Vec<Held>,
    pages: Vec<SeenPage>,
    cells: u64,
}

/// A block whose pages lie in [`SeenSpace::pages`].
#[derive(Debug, Clone, Copy, PartialEq)]
struct Held {
    column: u64,
    group: i32,
    full: u64,
    mixed: u64,
    first: usize,
}

/// Seen space of a page.
#[derive(Clone, Copy)]
enum OfPage<'a> {
    Nothing,
    Part(&'a SeenPage),
    All,
}

impl SeenSpace {
    /// Creates a space in which nothing was seen, on the grid `frame`.
    pub fn new(frame: Frame) -> Self {
        Self { frame, blocks: Vec::new(), pages: Vec::new(), cells: 0 }
    }

    /// Adds a block. Returns `false`, and changes nothing, unless its key comes after those added before.
    pub fn push(&mut self, block: SeenBlock) -> bool {
        let column = block.key.column();
        if self.blocks.last().is_some_and(|last| (last.column, last.group) >= (column, block.key.layer)) {
            return false;
        }
        self.cells += block.cells();
        let first = self.pages.len();
        self.blocks.push(Held { column, group: block.key.layer, full: block.full, mixed: block.mixed, first });
        self.pages.extend(block.pages);
        true
    }

    /// Returns the grid.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Returns the number of seen cells.
    pub fn cells(&self) -> u64 {
        self.cells
    }

    /// Returns the memory that it takes (bytes).
    pub fn bytes(&self) -> usize {
        self.blocks.len() * size_of::<Held>() + self.pages.len() * size_of::<SeenPage>()
    }

    /// Iterates over the pages of which something was seen, in archive order.
    pub fn pages(&self) -> impl Iterator<Item = (PageKey, SeenPage)> + '_ {
        self.blocks.iter().flat_map(|held| {
            (0..64).filter(|layer| (held.full | held.mixed) >> layer & 1 == 1).map(|layer| {
                let key = PageKey::from_column(held.column, held.group * BLOCK_LAYERS + layer);
                let page = match self.in_block(held, layer) {
                    OfPage::Part(page) => *page,
                    _ => SeenPage::ALL,
                };
                (key, page)
            })
        })
    }

    /// Iterates over seen cells above one another, in archive order: the first pixel of the cells ([`CELL_PIXELS`] long)
    /// along x and y, the first slice and the one after the last. Runs end with their page.
    pub fn runs(&self) -> impl Iterator<Item = ([i64; 2], [i64; 2])> + '_ {
        self.pages().flat_map(|(key, page)| {
            let cells = (0..CELLS_PER_ROW).flat_map(|y| (0..CELLS_PER_ROW).map(move |x| [x, y]));
            cells.flat_map(move |cell| {
                let pixel =
                    [0, 1].map(|axis| i64::from([key.tx, key.ty][axis]) * TILE_PIXELS + cell[axis] * CELL_PIXELS);
                let base = i64::from(key.layer) * PAGE_SLICES;
                page.runs(cell.map(|at| at as usize)).map(move |run| (pixel, run.map(|slice| base + slice)))
            })
        })
    }

    /// Returns whether all of the closed box between these corners (m) was seen.
    pub fn is_box_seen(&self, min: Point3<f64>, max: Point3<f64>) -> bool {
        let [first, last] = [min, max].map(|corner| self.cell_of(corner));
        self.are_cells_seen(first, last)
    }

    fn are_cells_seen(&self, first: CellIndex, last: CellIndex) -> bool {
        // Ends at the first cell that was not seen, so its cost does not depend on the size of the box.
        let pages = |axis: usize, cells: i64| first[axis].div_euclid(cells)..=last[axis].div_euclid(cells);
        for ty in pages(1, CELLS_PER_ROW) {
            for tx in pages(0, CELLS_PER_ROW) {
                for layer in pages(2, PAGE_SLICES) {
                    let within = |axis: usize, page: i64, cells: i64| {
                        let ends = [first[axis], last[axis]].map(|at| (at - page * cells).clamp(0, cells - 1));
                        ends.map(|at| at as usize)
                    };
                    let ranges = [(0, tx, CELLS_PER_ROW), (1, ty, CELLS_PER_ROW), (2, layer, PAGE_SLICES)];
                    let seen = match self.page([tx, ty, layer]) {
                        OfPage::Nothing => false,
                        OfPage::All => true,
                        OfPage::Part(page) => page.is_seen(ranges.map(|(axis, at, cells)| within(axis, at, cells))),
                    };
                    if !seen {
                        return false;
                    }
                }
            }
        }
        true
    }

    /// Returns whether the middle of a pawn with its feet at `feet` (m) was seen: the line above them from `climb` to
    /// `height` (m).
    ///
    /// Only the middle, because nothing is stored as seen beside surfaces: whatever is wider than that would make a way
    /// along a wall unseen. For the same reason three slices above the feet do not count, up to the head.
    pub fn is_pawn_seen(&self, feet: Point3<f64>, climb: f64, height: f64) -> bool {
        let [floor, mut low, head] =
            [0.0, climb, height].map(|above| self.cell_of(Point3::new(feet.x, feet.y, feet.z + above)));
        // Counted in slices: a multiple of their height may be rounded to the one below.
        low[2] = low[2].max(floor[2] + FLOOR_SLICES).min(head[2]);
        self.are_cells_seen(low, head)
    }

    /// Returns whether a place (m) was seen.
    pub fn is_seen(&self, place: Point3<f64>) -> bool {
        self.is_cell_seen(self.cell_of(place))
    }

    fn is_cell_seen(&self, [x, y, z]: CellIndex) -> bool {
        let at = [x.div_euclid(CELLS_PER_ROW), y.div_euclid(CELLS_PER_ROW), z.div_euclid(PAGE_SLICES)];
        match self.page(at) {
            OfPage::Nothing => false,
            OfPage::All => true,
            OfPage::Part(page) => {
                let cell = [x.rem_euclid(CELLS_PER_ROW), y.rem_euclid(CELLS_PER_ROW), z.rem_euclid(PAGE_SLICES)];
                page.is_seen(cell.map(|at| [at as usize; 2]))
            }
        }
    }

    fn cell_of(&self, place: Point3<f64>) -> CellIndex {
        let along = |v: f64| self.frame.pixel_of(v).div_euclid(CELL_PIXELS);
        [along(place.x), along(place.y), self.frame.slice_of(place.z)]
    }

    /// Returns the cell size (m): along x and y, along z.
    fn cell_m(&self) -> [f64; 3] {
        let across = CELL_PIXELS as f64 * self.frame.pixel_m();
        [across, across, self.frame.slice_m()]
    }

    fn page(&self, at: [i64; 3]) -> OfPage<'_> {
        let [Ok(tx), Ok(ty), Ok(layer)] = at.map(i32::try_from) else { return OfPage::Nothing };
        let (column, group) = (morton(tx, ty), layer.div_euclid(BLOCK_LAYERS));
        match self.blocks.binary_search_by_key(&(column, group), |held| (held.column, held.group)) {
            Ok(found) => self.in_block(&self.blocks[found], layer.rem_euclid(BLOCK_LAYERS)),
            Err(_) => OfPage::Nothing,
        }
    }

    fn in_block(&self, held: &Held, layer: i32) -> OfPage<'_> {
        let bit = 1u64 << layer;
        if held.full & bit != 0 {
            return OfPage::All;
        }
        match held.mixed & bit {
            0 => OfPage::Nothing,
            _ => OfPage::Part(&self.pages[held.first + (held.mixed & (bit - 1)).count_ones() as usize]),
        }
    }
}

const _: () = assert!(CELLS_PER_ROW * CELL_PIXELS == TILE_PIXELS);

#[cfg(test)]
mod tests;
