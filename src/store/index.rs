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
