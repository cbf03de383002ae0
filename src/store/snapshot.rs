//! Pages as queries see them: an immutable table of all pages, and the slots of those in memory at one moment.
//!
//! The slots are in groups of neighbouring tile columns; the next snapshot shares the groups in which nothing changed. A
//! reader that holds a snapshot holds all its pages: an evicted page lives until the last such reader drops its
//! snapshot. Everything here is plain shared data, without locks or `unsafe`, and answers do not change while a snapshot
//! is held.
//!
//! Memory: about 40 bytes a page, in memory or not (key 12, slot 24, tables). A new snapshot copies the pointers of all
//! groups and the slots of the groups that change.

use super::budget::Reservation;
use super::table::{KeyBounds, PageTable};
use crate::archive::{Archive, PageEntry, edited_pages};
use crate::frame::{Frame, PageKey};
use crate::monitor::Monitor;
use crate::page::Page;
use crate::sort::sort_by_key;
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A page in memory, with its reservation if a budget covers it.
#[derive(Debug)]
pub(super) struct Held {
    pub page: Page,
    pub room: Option<Reservation>,
}

impl Held {
    pub fn reserved_bytes(&self) -> usize {
        self.room.as_ref().map_or(0, Reservation::bytes)
    }
}

/// Slot of one page: properties known without loading it, and the page itself if it is in memory.
#[derive(Debug, Clone)]
pub struct PageSlot {
    layer: i32,
    slices: u64,
    page: Option<Arc<Held>>,
}

impl PageSlot {
    /// Creates the slot of a page in memory.
    pub(super) fn of(layer: i32, held: Held) -> Self {
        Self { layer, slices: held.page.slices(), page: Some(Arc::new(held)) }
    }

    /// Returns the layer of the page.
    #[inline]
    pub fn layer(&self) -> i32 {
        self.layer
    }

    /// Returns the occupied slices of the page as a mask, known even if the page is not in memory.
    #[inline]
    pub fn slices(&self) -> u64 {
        self.slices
    }

    /// Returns the page if it is in memory.
    #[inline]
    pub fn page(&self) -> Option<&Page> {
        self.page.as_deref().map(|held| &held.page)
    }
}

/// The slots of all pages at one moment.
#[derive(Debug)]
pub(super) struct Slots {
    groups: Box<[Arc<[PageSlot]>]>,
    /// Bytes of the pages in memory.
    weight: usize,
}

impl Slots {
    /// Creates the slots of pages with these masks of occupied slices; none is in memory.
    pub fn empty(table: &PageTable, slices: impl Fn(usize) -> u64) -> Self {
        let slot = |page: usize| PageSlot { layer: table.keys()[page].layer, slices: slices(page), page: None };
        Self { groups: table.groups().map(|pages| pages.map(slot).collect()).collect(), weight: 0 }
    }

    /// Returns these slots with some pages inserted or removed.
    pub fn with(&self, table: &PageTable, changes: &mut [(u32, Option<Arc<Held>>)]) -> Self {
        changes.sort_by_key(|(page, _)| *page);
        let (mut groups, mut weight) = (self.groups.clone(), self.weight);
        for change in changes.chunk_by_mut(|a, b| table.place(a.0).0 == table.place(b.0).0) {
            let (group, _) = table.place(change[0].0);
            let mut slots = groups[group].to_vec();
            for (page, held) in change {
                let slot = &mut slots[table.place(*page).1].page;
                let bytes = |held: &Option<Arc<Held>>| held.as_ref().map_or(0, |held| held.page.weight_bytes());
                weight = (weight + bytes(held)).saturating_sub(bytes(slot));
                *slot = held.take();
            }
            groups[group] = slots.into();
        }
        Self { groups, weight }
    }
}

/// Tile columns with edits, which stay in memory and stand for those of the archive.
#[derive(Debug)]
pub(super) struct Edited {
    pages: Snapshot,
    /// Tile columns of which the archive has no page.
    added: Vec<[i32; 2]>,
    bounds: Option<KeyBounds>,
}

impl Edited {
    #[cfg_attr(target_family = "wasm", allow(dead_code, reason = "of streams, which need threads"))]
    /// Creates the columns of an archive with pages in `table`. `slots` ascend.
    pub fn new(slots: Vec<(PageKey, PageSlot)>, table: &PageTable) -> Self {
        let pages = Snapshot::of_slots(*table.frame(), slots);
        let columns = (0..pages.column_count()).map(|number| pages.table.column_at(number));
        let added = columns.filter(|[tx, ty]| table.pages(*tx, *ty).is_empty()).collect();
        let bounds = match (table.bounds(), pages.bounds()) {
            (Some(a), Some(b)) => Some(KeyBounds {
                min: [0, 1, 2].map(|axis| a.min[axis].min(b.min[axis])),
                max: [0, 1, 2].map(|axis| a.max[axis].max(b.max[axis])),
            }),
            (a, b) => a.or(b),
        };
        Self { pages, added, bounds }
    }
}

/// The pages of a scene at one moment, all or some of them in memory: what queries, walkers and routes work on. Space
/// outside its pages is free.
///
/// A resident scene has all of its pages in memory ([`from_pages`](Self::from_pages), [`resident`](Self::resident)).
/// For scans that exceed memory, a [`Stream`](super::Stream) or a [`Loader`](super::Loader) gives the newest snapshot
/// of the pages around moving bodies; take one per frame and drop it with the frame, because its pages stay in memory,
/// and count against the budget, until then. All answers from one snapshot refer to the same moment.
///
/// Answers come from memory at once: no lock, no I/O, no allocation. Threads share a snapshot by reference; a clone
/// costs two reference counts.
///
/// ```
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::query::{Aabb, Overlap, overlaps};
/// use slicewalk::page::{PageBuilder, Span};
/// use slicewalk::store::Snapshot;
///
/// let frame = Frame::new(0.05, 0.15)?; // pixels of 5 cm, slices of 15 cm
/// let mut builder = PageBuilder::default();
/// assert!(builder.set_column(10, 20, &[Span::new(0, 255, false).unwrap()]));
/// let scene = Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let touching = Aabb::new([0.52, 1.02, 0.15].into(), [0.6, 1.1, 1.0].into())?;
/// assert_eq!(overlaps(&scene, &touching), Overlap::Hit);
/// let above = Aabb::new([0.52, 1.02, 0.16].into(), [0.6, 1.1, 1.0].into())?;
/// assert_eq!(overlaps(&scene, &above), Overlap::Clear);
/// # Ok::<(), slicewalk::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Snapshot {
    table: Arc<PageTable>,
    slots: Arc<Slots>,
    edited: Option<Arc<Edited>>,
}

impl Snapshot {
    pub(super) fn new(table: Arc<PageTable>, slots: Arc<Slots>) -> Self {
        Self { table, slots, edited: None }
    }

    pub(super) fn with_edited(self, edited: Option<Arc<Edited>>) -> Self {
        Self { edited, ..self }
    }

    /// Creates a scene of slots that ascend.
    fn of_slots(frame: Frame, slots: Vec<(PageKey, PageSlot)>) -> Self {
        let table = PageTable::new(frame, slots.iter().map(|(key, _)| *key).collect());
        let weight = slots.iter().filter_map(|(_, slot)| slot.page()).map(Page::weight_bytes).sum();
        let mut slots = slots.into_iter().map(|(_, slot)| slot);
        let groups = table.groups().map(|range| slots.by_ref().take(range.len()).collect()).collect();
        Self::new(Arc::new(table), Arc::new(Slots { groups, weight }))
    }

    /// Creates a resident scene of pages that are in memory already.
    ///
    /// # Panics
    /// If a key occurs twice.
    pub fn from_pages(frame: Frame, pages: impl IntoIterator<Item = (PageKey, Page)>) -> Self {
        let slot = |(key, page): (PageKey, Page)| (key, PageSlot::of(key.layer, Held { page, room: None }));
        let mut slots: Vec<_> = pages.into_iter().map(slot).collect();
        sort_by_key(&mut slots, |(key, _)| *key);
        Self::of_slots(frame, slots)
    }

    /// Reads all pages of an archive: neighbours in reads of up to 1 MiB, four at a time. Fails with the error of the
    /// first page that cannot be loaded; before reading any page, if memory for all of them is not available; and with
    /// [`Error::Interrupted`] if `monitor` requests a stop.
    pub fn resident(archive: &Archive, monitor: &dyn Monitor) -> Result<Self> {
        let entries: Vec<PageEntry> = archive.entries().collect::<Result<_>>()?;
        let slot = size_of::<PageKey>() + size_of::<PageSlot>() + size_of::<Held>();
        let weights = entries.iter().map(|entry| entry.weight_bytes().saturating_add(slot));
        check_memory(weights.fold(0, usize::saturating_add), entries.len())?;
        monitor.stage("loading", entries.len() as u64, "pages");
        let pages = entries.iter().map(|entry| entry.key).zip(archive.pages(&entries, monitor)?);
        let Some(edited) = edited_pages(archive, monitor)? else {
            return Ok(Self::from_pages(*archive.frame(), pages));
        };
        let mut all: BTreeMap<PageKey, Page> = pages.collect();
        all.extend(edited);
        Ok(Self::from_pages(*archive.frame(), all))
    }

    /// Returns this snapshot without the pages for which `keep` returns false: they count as not loaded. For tests of
    /// programs that must handle missing pages.
    pub fn keep_loaded(&self, mut keep: impl FnMut(PageKey) -> bool) -> Self {
        let pages = self.table.keys().iter().zip(0u32..).filter(|(key, _)| !keep(**key));
        let mut dropped: Vec<_> = pages.map(|(_, page)| (page, None)).collect();
        let slots = Arc::new(self.slots.with(&self.table, &mut dropped));
        Self::new(self.table.clone(), slots).with_edited(self.edited.clone())
    }

    /// Returns the grid of all pages.
    #[inline]
    pub fn frame(&self) -> &Frame {
        self.table.frame()
    }

    /// Returns the bounds of all keys; `None` if there are no pages.
    #[inline]
    pub fn bounds(&self) -> Option<KeyBounds> {
        self.edited.as_deref().map_or_else(|| self.table.bounds(), |edited| edited.bounds)
    }

    /// Returns the slots of tile column (`tx`, `ty`), lowest layer first; empty if the scan has no page there.
    #[inline]
    pub fn column(&self, tx: i32, ty: i32) -> &[PageSlot] {
        if let Some(edited) = &self.edited {
            let own = edited.pages.column(tx, ty);
            if !own.is_empty() {
                return own;
            }
        }
        let (group, offsets) = self.table.column(tx, ty);
        if offsets.is_empty() { &[] } else { &self.slots.groups[group][offsets] }
    }

    /// Returns whether any tile column of region (`rx`, `ry`), the 64 × 64 tiles that begin at (`64·rx`, `64·ry`), has
    /// a slot. Long rays skip regions without slots.
    #[inline]
    pub fn has_region(&self, rx: i32, ry: i32) -> bool {
        self.table.has_region(rx, ry) || self.edited.as_deref().is_some_and(|edited| edited.pages.has_region(rx, ry))
    }

    /// Returns the number of tile columns with at least one slot.
    pub fn column_count(&self) -> usize {
        self.table.column_count() + self.edited.as_deref().map_or(0, |edited| edited.added.len())
    }

    /// Returns tile column `number` (`0..column_count()`) as `(tx, ty, slots)`, in any fixed order.
    pub fn column_at(&self, number: usize) -> (i32, i32, &[PageSlot]) {
        let [tx, ty] = match (number.checked_sub(self.table.column_count()), &self.edited) {
            (Some(beyond), Some(edited)) => edited.added[beyond],
            _ => self.table.column_at(number),
        };
        (tx, ty, self.column(tx, ty))
    }

    /// Returns the number of pages, in memory or not.
    pub fn page_count(&self) -> usize {
        self.table.keys().len()
    }

    /// Returns whether the page is in memory; `None` if the scan has no such page.
    pub fn is_loaded(&self, key: PageKey) -> Option<bool> {
        if self.edited.as_deref().is_some_and(|edited| !edited.pages.column(key.tx, key.ty).is_empty()) {
            return Some(true);
        }
        let (group, offset) = self.table.place(self.table.find(key)?);
        Some(self.slots.groups[group][offset].page.is_some())
    }

    /// Returns the memory of the pages in memory (bytes). Batches of queries are ordered by place if this exceeds the
    /// processor's caches.
    pub fn weight_bytes(&self) -> usize {
        self.slots.weight
    }

    /// Returns the memory of the table of pages and of their slots, which adds to
    /// [`weight_bytes`](Self::weight_bytes) (bytes).
    pub fn table_bytes(&self) -> usize {
        self.table.weight_bytes() + self.page_count() * size_of::<PageSlot>()
    }
}

/// Fails if the system lacks memory for the pages, because running out of it while decoding would abort the process.
fn check_memory(bytes: usize, pages: usize) -> Result<()> {
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| {
        let action = format!("reserve {bytes} bytes for all {pages} pages");
        Error::io("memory", action, std::io::ErrorKind::OutOfMemory.into())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::{PageBuilder, Span};

    #[test]
    fn a_page_of_a_table_takes_about_40_bytes() {
        let mut page = PageBuilder::default();
        assert!(page.set_column(1, 2, &[Span::new(0, 255, false).unwrap()]));
        let page = page.build();
        let pages = (0..1000).map(|layer| (PageKey { tx: 0, ty: 0, layer }, page.clone()));
        let scene = Snapshot::from_pages(Frame::new(0.05, 0.15).unwrap(), pages);
        let each = scene.table_bytes() as f64 / 1000.0;
        assert!((25.0..45.0).contains(&each), "{each} bytes a page");
        assert_eq!(scene.weight_bytes(), 1000 * page.weight_bytes());
    }

    #[test]
    fn memory_that_cannot_be_had_is_an_error() {
        check_memory(1 << 20, 5).unwrap();
        for bytes in [1 << 46, usize::MAX] {
            let error = check_memory(bytes, 5).unwrap_err();
            assert!(matches!(&error, Error::Io { source, .. } if source.kind() == std::io::ErrorKind::OutOfMemory));
            assert!(error.to_string().contains("for all 5 pages"), "{error}");
        }
    }
}
