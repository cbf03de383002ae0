//! Pages as queries see them: an immutable index of all pages, and snapshots of those in memory.
//!
//! A snapshot is a table of groups, each with the slots of some neighbouring tile columns; the next snapshot shares the
//! groups in which nothing changed. A reader that holds a snapshot holds all its pages: an evicted page lives until the
//! last such reader drops its snapshot. Everything here is plain shared data, without locks or `unsafe`, and answers do
//! not change while a view is held.
//!
//! Memory: about 90 bytes a page, in memory or not (entry 48, slot 24, tables). A new snapshot copies the pointers of
//! all groups and the slots of the groups that change; a table of n pages has about √n groups of √n slots.

use super::account::Room;
use super::outlook::Outlook;
use super::table::{KeyBounds, SlotTable, TileTable};
use super::{PageSet, PageSlot};
use crate::archive::{PageEntry, Storage};
use crate::frame::{Frame, PageKey};
use crate::slice::Page;
use std::collections::HashMap;
use std::sync::Arc;

/// A page in memory with its reservation.
#[derive(Debug)]
pub(super) struct Held {
    pub page: Page,
    pub room: Room,
}

/// Slot of one page in a [`View`].
#[derive(Debug, Clone)]
pub struct ViewSlot {
    layer: i32,
    slices: u64,
    page: Option<Arc<Held>>,
}

impl PageSlot for ViewSlot {
    #[inline]
    fn layer(&self) -> i32 {
        self.layer
    }

    #[inline]
    fn slices(&self) -> u64 {
        self.slices
    }

    #[inline]
    fn page(&self) -> Option<&Page> {
        self.page.as_deref().map(|held| &held.page)
    }
}

/// All pages of an archive, numbered from 0 in order of their keys.
#[derive(Debug)]
pub(super) struct Index {
    frame: Frame,
    entries: SlotTable<PageEntry>,
    keys: Box<[PageKey]>,
    /// For each page, the first page with the same content.
    contents: Box<[u32]>,
    /// Maps a tile column to `group << shift | offset`.
    tiles: TileTable,
    shift: u32,
    /// Number of each group's first page, then the number of all pages.
    groups: Box<[u32]>,
    /// True if pages are decoded without inferred spans.
    ignores_inferred: bool,
}

impl Index {
    /// Least that a page adds to [`weight_bytes`](Self::weight_bytes).
    pub const LEAST_PAGE_BYTES: usize =
        size_of::<PageEntry>() + size_of::<PageKey>() + size_of::<u32>() + size_of::<ViewSlot>();

    pub fn new(frame: Frame, entries: Vec<PageEntry>, ignores_inferred: bool) -> Self {
        let contents = contents(&entries);
        let keys: Box<[PageKey]> = entries.iter().map(|entry| entry.key).collect();
        let entries = SlotTable::new(entries.into_iter().map(|entry| (entry.key, entry)).collect());
        let columns = || (0..entries.column_count()).map(|number| entries.column_at(number));
        let longest = columns().map(|(_, _, slots)| slots.len()).max().unwrap_or(0);
        // No column is split between groups, so that its slots are contiguous.
        let size = longest.max(keys.len().isqrt()).max(64).next_power_of_two();
        let (mut groups, mut first, mut cells) = (vec![0], 0, Vec::new());
        for (tx, ty, slots) in columns() {
            let group = groups.len() - 1;
            let mut offset = first - groups[group] as usize;
            if offset + slots.len() > size {
                groups.push(first as u32);
                offset = 0;
            }
            let place = ((groups.len() - 1) * size + offset) as u32;
            cells.push((tx, ty, place..place + slots.len() as u32));
            first += slots.len();
        }
        groups.push(first as u32);
        let (tiles, shift) = (TileTable::new(cells), size.trailing_zeros());
        Self { frame, entries, keys, contents, tiles, shift, groups: groups.into(), ignores_inferred }
    }

    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    pub fn ignores_inferred(&self) -> bool {
        self.ignores_inferred
    }

    pub fn len(&self) -> usize {
        self.keys.len()
    }

    pub fn entry(&self, page: u32) -> &PageEntry {
        &self.entries.slots()[page as usize]
    }

    pub fn key(&self, page: u32) -> PageKey {
        self.keys[page as usize]
    }

    /// Returns the page that represents all pages of the same content.
    pub fn content(&self, page: u32) -> u32 {
        self.contents[page as usize]
    }

    /// Returns the number of the page with this key.
    pub fn find(&self, key: PageKey) -> Option<u32> {
        let range = self.entries.range(key.tx, key.ty);
        let layers = &self.keys[range.clone()];
        layers.binary_search_by_key(&key.layer, |key| key.layer).ok().map(|at| (range.start + at) as u32)
    }

    /// Calls `f` with the numbers of the pages of each tile column with `tx` and `ty` in these inclusive ranges.
    pub fn for_each_column(&self, [tx0, tx1]: [i32; 2], [ty0, ty1]: [i32; 2], mut f: impl FnMut(std::ops::Range<u32>)) {
        let Some(bounds) = self.entries.bounds() else { return };
        let (tx0, tx1) = (tx0.max(bounds.min[0]), tx1.min(bounds.max[0]));
        let (ty0, ty1) = (ty0.max(bounds.min[1]), ty1.min(bounds.max[1]));
        if tx0 > tx1 || ty0 > ty1 {
            return;
        }
        let tiles = u64::from(tx1.abs_diff(tx0)).saturating_add(1) * (u64::from(ty1.abs_diff(ty0)) + 1);
        let mut column = |tx, ty| {
            let range = self.entries.range(tx, ty);
            if !range.is_empty() {
                f(range.start as u32..range.end as u32);
            }
        };
        if tiles > self.entries.column_count() as u64 {
            for number in 0..self.entries.column_count() {
                let (tx, ty, _) = self.entries.column_at(number);
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
        self.entries.weight_bytes()
            + self.tiles.weight_bytes()
            + self.len() * (size_of::<PageKey>() + size_of::<u32>() + size_of::<ViewSlot>())
            + size_of_val::<[u32]>(&self.groups)
    }

    fn group(&self, page: u32) -> (usize, usize) {
        let group = self.groups.partition_point(|&first| first <= page) - 1;
        (group, (page - self.groups[group]) as usize)
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

/// The pages in memory at one moment.
#[derive(Debug)]
pub(super) struct Snapshot {
    groups: Box<[Arc<[ViewSlot]>]>,
    /// Bytes of its pages.
    weight: usize,
}

impl Snapshot {
    /// Creates the snapshot without pages in memory.
    pub fn empty(index: &Index) -> Self {
        let slot = |entry: &PageEntry| ViewSlot { layer: entry.key.layer, slices: entry.slices, page: None };
        let groups = index.groups.windows(2).map(|ends| {
            let entries = &index.entries.slots()[ends[0] as usize..ends[1] as usize];
            entries.iter().map(slot).collect()
        });
        Self { groups: groups.collect(), weight: 0 }
    }

    /// Returns this snapshot with some pages inserted or removed.
    pub fn with(&self, index: &Index, changes: &mut [(u32, Option<Arc<Held>>)]) -> Self {
        changes.sort_by_key(|(page, _)| *page);
        let (mut groups, mut weight) = (self.groups.clone(), self.weight);
        for change in changes.chunk_by_mut(|a, b| index.group(a.0).0 == index.group(b.0).0) {
            let (group, _) = index.group(change[0].0);
            let mut slots = groups[group].to_vec();
            for (page, held) in change {
                let slot = &mut slots[index.group(*page).1].page;
                let bytes = |held: &Option<Arc<Held>>| held.as_ref().map_or(0, |held| held.page.weight_bytes());
                weight = (weight + bytes(held)).saturating_sub(bytes(slot));
                *slot = held.take();
            }
            groups[group] = slots.into();
        }
        Self { groups, weight }
    }
}

/// Tile columns with edits, which stay in memory.
#[derive(Debug)]
pub(super) struct Edited {
    table: SlotTable<ViewSlot>,
    /// Tile columns of which the archive has no page.
    added: Vec<[i32; 2]>,
    bounds: Option<KeyBounds>,
}

impl Edited {
    pub fn new(slots: Vec<(PageKey, ViewSlot)>, index: &Index) -> Self {
        let table = SlotTable::new(slots);
        let columns = (0..table.column_count()).map(|number| table.column_at(number));
        let added =
            columns.map(|(tx, ty, _)| [tx, ty]).filter(|[tx, ty]| index.tiles.get(*tx, *ty).is_empty()).collect();
        let bounds = match (index.entries.bounds(), table.bounds()) {
            (Some(a), Some(b)) => Some(KeyBounds {
                min: [0, 1, 2].map(|axis| a.min[axis].min(b.min[axis])),
                max: [0, 1, 2].map(|axis| a.max[axis].max(b.max[axis])),
            }),
            (a, b) => a.or(b),
        };
        Self { table, added, bounds }
    }
}

/// Pages of a [`Stream`](super::Stream) that were in memory when the view was taken: a [`PageSet`] for queries.
///
/// All answers from one view refer to the same moment: pages loaded or evicted meanwhile change nothing. Pages in a
/// view stay in memory, and count against the budget, until it is dropped: take one per frame, and drop it with the
/// frame. Cost: two reference counts to take; a query follows one pointer more than in a resident
/// [`Store`](super::Store).
#[derive(Debug, Clone)]
pub struct View {
    pub(super) index: Arc<Index>,
    pub(super) snapshot: Arc<Snapshot>,
    pub(super) edited: Option<Arc<Edited>>,
}

impl View {
    /// Returns whether the page is in memory; `None` if the archive has no such page.
    pub fn is_loaded(&self, key: PageKey) -> Option<bool> {
        let (group, offset) = self.index.group(self.index.find(key)?);
        Some(self.snapshot.groups[group][offset].page.is_some())
    }

    /// Returns the number of pages in memory that a body touches before it moves; 0 if the outlook is invalid.
    pub fn count_loaded(&self, outlook: &Outlook) -> usize {
        let loaded = |page: &u32| {
            let (group, offset) = self.index.group(*page);
            self.snapshot.groups[group][offset].page.is_some()
        };
        let mut pages = HashMap::new();
        if outlook.is_valid() {
            outlook.wants(&self.index, 0.0, &mut pages);
        }
        pages.keys().filter(|page| loaded(page)).count()
    }
}

impl ViewSlot {
    /// Returns the slot of a page that stays in memory.
    pub(super) fn of_edited(layer: i32, held: Held) -> Self {
        Self { layer, slices: held.page.slices(), page: Some(Arc::new(held)) }
    }
}

impl PageSet for View {
    type Slot = ViewSlot;

    #[inline]
    fn frame(&self) -> &Frame {
        &self.index.frame
    }

    #[inline]
    fn bounds(&self) -> Option<KeyBounds> {
        self.edited.as_deref().map_or_else(|| self.index.entries.bounds(), |edited| edited.bounds)
    }

    #[inline]
    fn column(&self, tx: i32, ty: i32) -> &[ViewSlot] {
        if let Some(edited) =
            self.edited.as_deref().map(|edited| edited.table.column(tx, ty)).filter(|own| !own.is_empty())
        {
            return edited;
        }
        let range = self.index.tiles.get(tx, ty);
        if range.is_empty() {
            return &[];
        }
        let offset = range.start & ((1 << self.index.shift) - 1);
        &self.snapshot.groups[range.start >> self.index.shift][offset..offset + range.len()]
    }

    #[inline]
    fn has_region(&self, rx: i32, ry: i32) -> bool {
        self.index.entries.has_region(rx, ry)
            || self.edited.as_deref().is_some_and(|edited| edited.table.has_region(rx, ry))
    }

    fn weight_hint(&self) -> usize {
        self.snapshot.weight
    }

    fn column_count(&self) -> usize {
        self.index.entries.column_count() + self.edited.as_deref().map_or(0, |edited| edited.added.len())
    }

    fn column_at(&self, number: usize) -> (i32, i32, &[ViewSlot]) {
        let count = self.index.entries.column_count();
        let added = self.edited.as_deref().map_or(&[][..], |edited| &edited.added);
        let [tx, ty] = match number.checked_sub(count) {
            Some(beyond) => added[beyond],
            None => {
                let (tx, ty, _) = self.index.entries.column_at(number);
                [tx, ty]
            }
        };
        (tx, ty, self.column(tx, ty))
    }
}
