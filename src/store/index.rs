//! The pages of an archive as a loader knows them: their table and their directory entries.

use super::snapshot::{PageSlot, Slots};
use super::table::PageTable;
use crate::archive::{PageEntry, Storage};
use crate::frame::{Frame, PageKey};
use crate::sort::sort_by_key;
use std::collections::HashMap;
use std::sync::Arc;

/// All pages of an archive, numbered from 0 in order of their keys.
#[derive(Debug)]
pub(super) struct Index {
    table: Arc<PageTable>,
    entries: Box<[PageEntry]>,
    /// For each page, the first page with the same content.
    contents: Box<[u32]>,
    /// True if pages are decoded without inferred spans.
    ignores_inferred: bool,
}

impl Index {
    /// Least that a page adds to [`weight_bytes`](Self::weight_bytes).
    pub const LEAST_PAGE_BYTES: usize =
        size_of::<PageEntry>() + size_of::<PageKey>() + size_of::<u32>() + size_of::<PageSlot>();

    pub fn new(frame: Frame, mut entries: Vec<PageEntry>, ignores_inferred: bool) -> Self {
        sort_by_key(&mut entries, |entry| entry.key);
        let contents = contents(&entries);
        let table = Arc::new(PageTable::new(frame, entries.iter().map(|entry| entry.key).collect()));
        Self { table, entries: entries.into(), contents, ignores_inferred }
    }

    pub fn table(&self) -> &Arc<PageTable> {
        &self.table
    }

    /// Returns the slots of the pages; none is in memory.
    pub fn empty_slots(&self) -> Slots {
        Slots::empty(&self.table, |page| self.entries[page].slices)
    }

    pub fn frame(&self) -> &Frame {
        self.table.frame()
    }

    pub fn ignores_inferred(&self) -> bool {
        self.ignores_inferred
    }

    pub fn len(&self) -> usize {
        self.entries.len()
    }

    pub fn entry(&self, page: u32) -> &PageEntry {
        &self.entries[page as usize]
    }

    pub fn key(&self, page: u32) -> PageKey {
        self.entries[page as usize].key
    }

    /// Returns the page that represents all pages of the same content.
    pub fn content(&self, page: u32) -> u32 {
        self.contents[page as usize]
    }

    /// Returns the number of the page with this key.
    pub fn find(&self, key: PageKey) -> Option<u32> {
        self.table.find(key)
    }

    /// Calls `f` with the numbers of the pages of each tile column with `tx` and `ty` in these inclusive ranges.
    pub fn for_each_column(&self, [tx0, tx1]: [i32; 2], [ty0, ty1]: [i32; 2], mut f: impl FnMut(std::ops::Range<u32>)) {
        let Some(bounds) = self.table.bounds() else { return };
        let (tx0, tx1) = (tx0.max(bounds.min[0]), tx1.min(bounds.max[0]));
        let (ty0, ty1) = (ty0.max(bounds.min[1]), ty1.min(bounds.max[1]));
        if tx0 > tx1 || ty0 > ty1 {
            return;
        }
        let tiles = u64::from(tx1.abs_diff(tx0)).saturating_add(1) * (u64::from(ty1.abs_diff(ty0)) + 1);
        let mut column = |tx, ty| {
            let pages = self.table.pages(tx, ty);
            if !pages.is_empty() {
                f(pages);
            }
        };
        if tiles > self.table.column_count() as u64 {
            for number in 0..self.table.column_count() {
                let [tx, ty] = self.table.column_at(number);
                if (tx0..=tx1).contains(&tx) && (ty0..=ty1).contains(&ty) {
                    column(tx, ty);
                }
            }
            return;
        }
        for ty in ty0..=ty1 {
            for tx in tx0..=tx1 {
                column(tx, ty);
            }
        }
    }

    /// Returns the bytes of the index and of the slots of one snapshot.
    pub fn weight_bytes(&self) -> usize {
        self.table.weight_bytes() + self.len() * (size_of::<PageEntry>() + size_of::<u32>() + size_of::<PageSlot>())
    }
}

/// Returns, for each entry, the first entry of the same content: stored pages and those that share their bytes, and
/// uniform pages with equal spans.
fn contents(entries: &[PageEntry]) -> Box<[u32]> {
    let mut stored: Vec<(u64, u32)> = Vec::new();
    let mut uniform = HashMap::new();
    let number = |(at, entry): (usize, &PageEntry)| {
        let at = at as u32;
        match entry.storage {
            Storage::Stored(extent) => {
                stored.push((extent.offset, at));
                at
            }
            // An archive whose pages do not ascend is damaged; its pages are then not shared, and reading them reports
            // the reason.
            Storage::Shared(extent) => {
                let found = stored.binary_search_by_key(&extent.offset, |&(offset, _)| offset);
                let first = found.map_or(at, |found| stored[found].1);
                let other = &entries[first as usize];
                let same = other.extent() == Some(extent) && (other.slices, other.size) == (entry.slices, entry.size);
                if same { first } else { at }
            }
            Storage::Uniform(span) => *uniform.entry(span).or_insert(at),
        }
    };
    entries.iter().enumerate().map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::Extent;
    use crate::page::{PageSize, Span};
    use proptest::prelude::*;

    fn entry(tx: i32, ty: i32, layer: i32, storage: Storage) -> PageEntry {
        PageEntry { key: PageKey { tx, ty, layer }, slices: 1, size: PageSize::UNIFORM, storage }
    }

    fn flat(top: u32) -> Storage {
        Storage::Uniform(Span::new(0, top, false).unwrap())
    }

    proptest! {
        #[test]
        fn columns_of_a_range_are_found_in_sets_that_are_dense_sparse_or_empty(
            keys in proptest::collection::btree_set((-4i32..4, -4i32..4, 0i32..2), 0..60),
            far in any::<bool>(),
            [x, y] in [(-6i32..6, 0i32..9), (-6i32..6, 0i32..9)],
            wide in any::<bool>(),
        ) {
            let frame = Frame::new(0.05, 0.15).unwrap();
            let far = [(i32::MAX, i32::MIN, 0), (i32::MIN, 7, 0)].into_iter().filter(|_| far);
            let keys: Vec<_> = keys.into_iter().chain(far).collect();
            let entries = keys.iter().map(|&(tx, ty, layer)| entry(tx, ty, layer, flat(9)));
            let index = Index::new(frame, entries.collect(), false);
            let range = |(from, len): (i32, i32)| if wide { [i32::MIN, i32::MAX] } else { [from, from + len] };
            let ranges = [x, y].map(range);
            let is_in = |&(tx, ty, _): &(i32, i32, i32)| {
                (ranges[0][0]..=ranges[0][1]).contains(&tx) && (ranges[1][0]..=ranges[1][1]).contains(&ty)
            };
            let mut expected: Vec<_> = keys.iter().copied().filter(is_in).collect();
            let mut found = Vec::new();
            index.for_each_column(ranges[0], ranges[1], |pages| {
                found.extend(pages.map(|page| index.key(page)).map(|key| (key.tx, key.ty, key.layer)));
            });
            expected.sort_unstable();
            found.sort_unstable();
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn pages_share_a_content_only_if_all_that_the_directory_says_of_it_is_equal() {
        let extent = |offset, len| Extent { offset, len, crc: 5 };
        let storages = [
            (Storage::Stored(extent(100, 50)), 0u32),
            (flat(7), 1),
            (Storage::Stored(extent(150, 30)), 2),
            (Storage::Shared(extent(100, 50)), 0),
            (flat(7), 1),
            (flat(8), 5),
            // Bytes of a damaged directory: those of one and a half pages, and some that no page stores.
            (Storage::Shared(extent(100, 65)), 6),
            (Storage::Shared(extent(110, 40)), 7),
            (Storage::Shared(extent(150, 30)), 2),
        ];
        let entries: Vec<_> = (0..).zip(storages).map(|(layer, (storage, _))| entry(0, 0, layer, storage)).collect();
        assert_eq!(contents(&entries)[..], storages.map(|(_, first)| first));
    }
}
