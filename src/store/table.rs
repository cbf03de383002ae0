//! An immutable table of the pages of a scene, by tile column.

use crate::frame::{Frame, PageKey};
use std::ops::Range;

/// Smallest and greatest key of a set along each axis, both inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeyBounds {
    /// Least `tx`, `ty`, layer.
    pub min: [i32; 3],
    /// Greatest `tx`, `ty`, layer.
    pub max: [i32; 3],
}

/// All pages of a scene, numbered from 0 in order of their keys, and the place of each in a snapshot.
///
/// A snapshot keeps slots in groups of neighbouring tile columns, about √n groups of √n slots for n pages. No column is
/// divided between groups, so that its slots are contiguous.
#[derive(Debug)]
pub(super) struct PageTable {
    frame: Frame,
    keys: Box<[PageKey]>,
    /// First page of each tile column, then the number of all pages.
    columns: Box<[u32]>,
    /// Maps a tile column to `group << shift | offset`.
    tiles: TileTable,
    shift: u32,
    /// First page of each group, then the number of all pages.
    groups: Box<[u32]>,
    /// Regions of 64 × 64 tiles that have a page.
    regions: TileTable,
    bounds: Option<KeyBounds>,
}

impl PageTable {
    /// Builds the table from distinct keys in ascending order.
    ///
    /// # Panics
    /// If a key occurs twice or there are 2³² pages or more, which sources rule out.
    pub fn new(frame: Frame, keys: Vec<PageKey>) -> Self {
        assert!(u32::try_from(keys.len()).is_ok(), "{} pages are too many", keys.len());
        let mut columns: Vec<u32> = Vec::new();
        let mut bounds: Option<KeyBounds> = None;
        for (at, key) in keys.iter().enumerate() {
            assert!(at == 0 || keys[at - 1] < *key, "page {key} is given twice or out of order");
            let along = [key.tx, key.ty, key.layer];
            let bounds = bounds.get_or_insert(KeyBounds { min: along, max: along });
            for (axis, &value) in along.iter().enumerate() {
                bounds.min[axis] = bounds.min[axis].min(value);
                bounds.max[axis] = bounds.max[axis].max(value);
            }
            if at == 0 || (keys[at - 1].tx, keys[at - 1].ty) != (key.tx, key.ty) {
                columns.push(at as u32);
            }
        }
        columns.push(keys.len() as u32);
        // Along the Morton curve the tiles of a region are contiguous.
        let first = |column: &u32| &keys[*column as usize];
        let mut regions: Vec<_> =
            columns[..columns.len() - 1].iter().map(first).map(|key| (key.tx >> 6, key.ty >> 6)).collect();
        regions.dedup();
        let regions = TileTable::new(regions.into_iter().map(|(rx, ry)| (rx, ry, 0..1)).collect());

        let longest = columns.windows(2).map(|ends| ends[1] - ends[0]).max().unwrap_or(0);
        let size = keys.len().isqrt().max(longest as usize).max(64).next_power_of_two() as u32;
        let (mut groups, mut cells) = (vec![0], Vec::with_capacity(columns.len() - 1));
        for ends in columns.windows(2) {
            let key = first(&ends[0]);
            if ends[1] - groups[groups.len() - 1] > size {
                groups.push(ends[0]);
            }
            let place = (groups.len() as u32 - 1) * size + ends[0] - groups[groups.len() - 1];
            cells.push((key.tx, key.ty, place..place + ends[1] - ends[0]));
        }
        groups.push(keys.len() as u32);
        let (tiles, shift) = (TileTable::new(cells), size.trailing_zeros());
        Self { frame, columns: columns.into(), tiles, shift, groups: groups.into(), regions, bounds, keys: keys.into() }
    }

    #[inline]
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    #[inline]
    pub fn bounds(&self) -> Option<KeyBounds> {
        self.bounds
    }

    pub fn keys(&self) -> &[PageKey] {
        &self.keys
    }

    /// Returns the group of tile column (`tx`, `ty`) and the range of its slots in there; an empty range if the column
    /// has no page.
    #[inline]
    pub fn column(&self, tx: i32, ty: i32) -> (usize, Range<usize>) {
        let range = self.tiles.get(tx, ty);
        let offset = range.start & ((1 << self.shift) - 1);
        (range.start >> self.shift, offset..offset + range.len())
    }

    /// Returns the numbers of the pages of tile column (`tx`, `ty`).
    pub fn pages(&self, tx: i32, ty: i32) -> Range<u32> {
        let (group, offsets) = self.column(tx, ty);
        if offsets.is_empty() {
            return 0..0;
        }
        let first = self.groups[group];
        first + offsets.start as u32..first + offsets.end as u32
    }

    /// Returns the number of the page with this key.
    pub fn find(&self, key: PageKey) -> Option<u32> {
        let pages = self.pages(key.tx, key.ty);
        let keys = &self.keys[pages.start as usize..pages.end as usize];
        keys.binary_search_by_key(&key.layer, |key| key.layer).ok().map(|at| pages.start + at as u32)
    }

    /// Returns the group of a page and its offset in there.
    pub fn place(&self, page: u32) -> (usize, usize) {
        let group = self.groups.partition_point(|&first| first <= page) - 1;
        (group, (page - self.groups[group]) as usize)
    }

    /// Returns the ranges of pages that form the groups.
    pub fn groups(&self) -> impl Iterator<Item = Range<usize>> {
        self.groups.windows(2).map(|ends| ends[0] as usize..ends[1] as usize)
    }

    /// Returns whether any tile of region (`rx`, `ry`) has a page.
    #[inline]
    pub fn has_region(&self, rx: i32, ry: i32) -> bool {
        !self.regions.get(rx, ry).is_empty()
    }

    /// Returns the number of tile columns.
    pub fn column_count(&self) -> usize {
        self.columns.len() - 1
    }

    /// Returns the indices of the tile column with this number.
    pub fn column_at(&self, number: usize) -> [i32; 2] {
        let key = self.keys[self.columns[number] as usize];
        [key.tx, key.ty]
    }

    /// Returns the memory of the table (bytes).
    pub fn weight_bytes(&self) -> usize {
        size_of_val::<[PageKey]>(&self.keys)
            + size_of_val::<[u32]>(&self.columns)
            + size_of_val::<[u32]>(&self.groups)
            + self.tiles.weight_bytes()
            + self.regions.weight_bytes()
    }
}

/// Map from pairs of indices to ranges that are not empty.
#[derive(Debug)]
pub(super) enum TileTable {
    Grid(Grid),
    Hashed(Hashed),
}

/// A cell for every pair within a rectangle, row by row.
#[derive(Debug)]
pub(super) struct Grid {
    first: [i32; 2],
    size: [u32; 2],
    /// Begin and length.
    cells: Box<[[u32; 2]]>,
}

/// Fibonacci hashing (Knuth, vol. 3, section 6.4) and linear probing at a load of at most one half, so that a lookup
/// reads one or two neighbouring cache lines.
#[derive(Debug)]
pub(super) struct Hashed {
    /// Its length is a power of two.
    buckets: Box<[Bucket]>,
    /// Right shift of a 64-bit hash to an index of `buckets`.
    shift: u32,
}

/// Free if `count` is 0.
#[derive(Debug, Clone, Copy, Default)]
struct Bucket {
    name: u64,
    first: u32,
    count: u32,
}

impl TileTable {
    /// Most cells of a grid per entry; a grid with that many is as large as the smallest table of buckets.
    const MOST_CELLS: usize = 4;

    pub fn new(entries: Vec<(i32, i32, Range<u32>)>) -> Self {
        Grid::new(&entries).map_or_else(|| Self::Hashed(Hashed::new(entries)), Self::Grid)
    }

    pub fn weight_bytes(&self) -> usize {
        match self {
            Self::Grid(grid) => size_of_val::<[[u32; 2]]>(&grid.cells),
            Self::Hashed(hashed) => size_of_val::<[Bucket]>(&hashed.buckets),
        }
    }

    #[inline]
    pub fn get(&self, x: i32, y: i32) -> Range<usize> {
        match self {
            Self::Grid(grid) => grid.get(x, y),
            Self::Hashed(hashed) => hashed.get(x, y),
        }
    }
}

impl Grid {
    /// Returns `None` if too few of the cells would have an entry.
    fn new(entries: &[(i32, i32, Range<u32>)]) -> Option<Self> {
        let ends = |along: fn(&(i32, i32, Range<u32>)) -> i32| {
            let (least, most) = (entries.iter().map(along).min()?, entries.iter().map(along).max()?);
            Some((least, u32::try_from(i64::from(most) - i64::from(least) + 1).ok()?))
        };
        let ((x, columns), (y, rows)) = (ends(|entry| entry.0)?, ends(|entry| entry.1)?);
        let count = usize::try_from(u64::from(columns) * u64::from(rows)).ok()?;
        if count > TileTable::MOST_CELLS * entries.len() {
            return None;
        }
        let mut cells = vec![[0; 2]; count];
        let grid = Self { first: [x, y], size: [columns, rows], cells: Box::default() };
        for (x, y, range) in entries {
            cells[grid.place(*x, *y)?] = [range.start, range.end - range.start];
        }
        Some(Self { cells: cells.into(), ..grid })
    }

    #[inline]
    fn place(&self, x: i32, y: i32) -> Option<usize> {
        let (i, j) = (x.wrapping_sub(self.first[0]) as u32, y.wrapping_sub(self.first[1]) as u32);
        (i < self.size[0] && j < self.size[1]).then_some(j as usize * self.size[0] as usize + i as usize)
    }

    #[inline]
    fn get(&self, x: i32, y: i32) -> Range<usize> {
        let cell = self.place(x, y).and_then(|place| self.cells.get(place));
        cell.map_or(0..0, |&[first, count]| first as usize..(first + count) as usize)
    }
}

impl Hashed {
    fn new(entries: Vec<(i32, i32, Range<u32>)>) -> Self {
        let count = (2 * entries.len()).next_power_of_two().max(2);
        let mut table = Self { buckets: vec![Bucket::default(); count].into(), shift: 64 - count.trailing_zeros() };
        for (x, y, range) in entries {
            let name = name(x, y);
            let mut at = table.home(name);
            while table.buckets[at].count != 0 {
                at = (at + 1) & (count - 1);
            }
            table.buckets[at] = Bucket { name, first: range.start, count: range.end - range.start };
        }
        table
    }

    #[inline]
    fn home(&self, name: u64) -> usize {
        (name.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> self.shift) as usize
    }

    #[inline]
    fn get(&self, x: i32, y: i32) -> Range<usize> {
        let name = name(x, y);
        let mut at = self.home(name);
        loop {
            let cell = &self.buckets[at];
            if cell.name == name || cell.count == 0 {
                return cell.first as usize..cell.first as usize + cell.count as usize;
            }
            at = (at + 1) & (self.buckets.len() - 1);
        }
    }
}

#[inline]
fn name(x: i32, y: i32) -> u64 {
    u64::from(x as u32) << 32 | u64::from(y as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn table(mut keys: Vec<PageKey>) -> PageTable {
        keys.sort_unstable();
        PageTable::new(Frame::new(0.05, 0.15).unwrap(), keys)
    }

    proptest! {
        #[test]
        fn finds_every_column_and_no_other(
            mut keys in proptest::collection::btree_set((-5i32..5, -5i32..5, -3i32..3), 0..160), far in any::<bool>()
        ) {
            // One so far away that a grid of all would be too large.
            keys.extend(far.then_some((i32::MAX, i32::MIN, 0)));
            let mut expected: BTreeMap<(i32, i32), Vec<i32>> = BTreeMap::new();
            for &(tx, ty, layer) in &keys {
                expected.entry((tx, ty)).or_default().push(layer);
            }
            let table = table(keys.iter().map(|&(tx, ty, layer)| PageKey { tx, ty, layer }).collect());
            prop_assert!(!far || keys.len() == 1 || matches!(table.tiles, TileTable::Hashed(_)));
            let groups: Vec<Range<usize>> = table.groups().collect();
            prop_assert_eq!(groups.iter().map(Range::len).sum::<usize>(), keys.len());
            let around = (-6..6).flat_map(|tx| (-6..6).map(move |ty| (tx, ty)));
            for (tx, ty) in around.chain([(i32::MAX, i32::MIN), (i32::MIN, i32::MAX), (i32::MAX, i32::MAX)]) {
                let pages = table.pages(tx, ty);
                let found: Vec<i32> = pages.clone().map(|page| table.keys()[page as usize].layer).collect();
                prop_assert_eq!(&found[..], expected.get(&(tx, ty)).map_or(&[][..], |layers| layers));
                for page in pages {
                    let (group, offset) = table.place(page);
                    prop_assert_eq!(groups[group].start + offset, page as usize);
                    prop_assert_eq!(table.find(table.keys()[page as usize]), Some(page));
                }
            }
            prop_assert_eq!(table.column_count(), expected.len());
            let columns = (0..table.column_count()).map(|number| table.column_at(number));
            let mut columns: Vec<(i32, i32)> = columns.map(|[tx, ty]| (tx, ty)).collect();
            columns.sort_unstable();
            prop_assert!(columns.iter().eq(expected.keys()));
        }
    }

    #[test]
    fn tile_zero_zero_is_told_apart_from_a_free_cell() {
        let one = table(vec![PageKey { tx: 1, ty: 0, layer: 0 }]);
        assert!(one.pages(0, 0).is_empty());
        assert_eq!(one.pages(1, 0), 0..1);
        assert!(matches!(one.tiles, TileTable::Grid(_)));
        assert!(table(Vec::new()).pages(0, 0).is_empty());
    }
}
