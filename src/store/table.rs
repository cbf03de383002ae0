//! An immutable table from tile columns to runs of slots.

use crate::frame::PageKey;
use std::ops::Range;

/// Smallest and greatest key of a set along each axis, both inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeyBounds {
    /// Least `tx`, `ty`, layer.
    pub min: [i32; 3],
    /// Greatest `tx`, `ty`, layer.
    pub max: [i32; 3],
}

/// Slots sorted by key, with an index from tile column to run.
#[derive(Debug)]
pub(super) struct SlotTable<T> {
    slots: Box<[T]>,
    /// Runs in order of their keys, and a sentinel that ends the last one.
    runs: Box<[TileRun]>,
    tiles: TileTable,
    /// Regions of 64 × 64 tiles that hold a run.
    regions: TileTable,
    bounds: Option<KeyBounds>,
}

#[derive(Debug, Clone, Copy)]
struct TileRun {
    tx: i32,
    ty: i32,
    first: u32,
}

impl<T> SlotTable<T> {
    /// Builds the table from slots with distinct keys in any order.
    ///
    /// # Panics
    /// If a key occurs twice or there are 2³² slots or more, which sources rule out.
    pub fn new(mut slots: Vec<(PageKey, T)>) -> Self {
        slots.sort_unstable_by_key(|(key, _)| *key);
        assert!(u32::try_from(slots.len()).is_ok(), "{} pages are too many", slots.len());
        let mut runs: Vec<TileRun> = Vec::new();
        let mut bounds: Option<KeyBounds> = None;
        for (at, (key, _)) in slots.iter().enumerate() {
            assert!(at == 0 || slots[at - 1].0 != *key, "page {key} is given twice");
            let along = [key.tx, key.ty, key.layer];
            let bounds = bounds.get_or_insert(KeyBounds { min: along, max: along });
            for (axis, &value) in along.iter().enumerate() {
                bounds.min[axis] = bounds.min[axis].min(value);
                bounds.max[axis] = bounds.max[axis].max(value);
            }
            if runs.last().is_none_or(|run| (run.tx, run.ty) != (key.tx, key.ty)) {
                runs.push(TileRun { tx: key.tx, ty: key.ty, first: at as u32 });
            }
        }
        // Along the Morton curve the tiles of a region are contiguous.
        let mut regions: Vec<(i32, i32)> = runs.iter().map(|run| (run.tx >> 6, run.ty >> 6)).collect();
        regions.dedup();
        let end = slots.len() as u32;
        let ends: Vec<u32> = runs.iter().skip(1).map(|run| run.first).chain([end]).collect();
        let tiles = runs.iter().zip(ends).map(|(run, end)| (run.tx, run.ty, run.first..end));
        let tiles = TileTable::new(tiles.collect());
        let regions = TileTable::new(regions.into_iter().map(|(rx, ry)| (rx, ry, 0..1)).collect());
        runs.push(TileRun { tx: 0, ty: 0, first: end });
        let slots = slots.into_iter().map(|(_, slot)| slot).collect();
        Self { slots, runs: runs.into(), tiles, regions, bounds }
    }

    /// Returns the range of the slots of tile column (`tx`, `ty`).
    #[inline]
    pub fn range(&self, tx: i32, ty: i32) -> Range<usize> {
        self.tiles.get(tx, ty)
    }

    /// Returns the slots of tile column (`tx`, `ty`).
    #[inline]
    pub fn column(&self, tx: i32, ty: i32) -> &[T] {
        &self.slots[self.range(tx, ty)]
    }

    /// Returns whether any tile of region (`rx`, `ry`) has slots.
    #[inline]
    pub fn has_region(&self, rx: i32, ry: i32) -> bool {
        !self.regions.get(rx, ry).is_empty()
    }

    /// Returns the number of tile columns.
    pub fn column_count(&self) -> usize {
        self.runs.len() - 1
    }

    /// Returns the tile column with this number.
    pub fn column_at(&self, number: usize) -> (i32, i32, &[T]) {
        let (run, next) = (self.runs[number], self.runs[number + 1]);
        (run.tx, run.ty, &self.slots[run.first as usize..next.first as usize])
    }

    pub fn bounds(&self) -> Option<KeyBounds> {
        self.bounds
    }

    pub fn slots(&self) -> &[T] {
        &self.slots
    }

    /// Returns the bytes of the tables and of the slots, without memory that slots own.
    pub fn weight_bytes(&self) -> usize {
        size_of_val::<[T]>(&self.slots)
            + size_of_val::<[TileRun]>(&self.runs)
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

    proptest! {
        #[test]
        fn finds_every_column_and_no_other(
            mut keys in proptest::collection::btree_set((-5i32..5, -5i32..5, -3i32..3), 0..80), far in any::<bool>()
        ) {
            // One so far away that a grid of all would be too large.
            keys.extend(far.then_some((i32::MAX, i32::MIN, 0)));
            let slots: Vec<_> = keys.iter().map(|&(tx, ty, layer)| (PageKey { tx, ty, layer }, layer)).collect();
            let mut expected: BTreeMap<(i32, i32), Vec<i32>> = BTreeMap::new();
            for &(tx, ty, layer) in &keys {
                expected.entry((tx, ty)).or_default().push(layer);
            }
            let columns = SlotTable::new(slots);
            prop_assert!(!far || keys.len() == 1 || matches!(columns.tiles, TileTable::Hashed(_)));
            let around = (-6..6).flat_map(|tx| (-6..6).map(move |ty| (tx, ty)));
            for (tx, ty) in around.chain([(i32::MAX, i32::MIN), (i32::MIN, i32::MAX), (i32::MAX, i32::MAX)]) {
                let found = columns.column(tx, ty);
                prop_assert_eq!(found, expected.get(&(tx, ty)).map_or(&[][..], |layers| layers));
            }
            prop_assert_eq!(columns.column_count(), expected.len());
            for number in 0..columns.column_count() {
                let (tx, ty, layers) = columns.column_at(number);
                prop_assert_eq!(layers, &expected[&(tx, ty)][..]);
            }
        }
    }

    #[test]
    fn tile_zero_zero_is_told_apart_from_a_free_cell() {
        let columns = SlotTable::new(vec![(PageKey { tx: 1, ty: 0, layer: 0 }, ())]);
        assert!(columns.column(0, 0).is_empty());
        assert_eq!(columns.column(1, 0).len(), 1);
        assert!(matches!(columns.tiles, TileTable::Grid(_)));
        assert!(SlotTable::<()>::new(Vec::new()).column(0, 0).is_empty());
    }
}
