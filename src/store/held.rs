//! The store: all pages of a scan in memory.

use super::edited::edited_pages;
use super::table::{KeyBounds, SlotTable};
use super::{PageSet, PageSlot};
use crate::archive::{Archive, PageEntry};
use crate::frame::{Frame, PageKey};
use crate::monitor::Monitor;
use crate::slice::Page;
use crate::{Error, Result};
use std::collections::BTreeMap;

/// Slot of one page in a [`Store`].
#[derive(Debug)]
pub struct StoreSlot {
    layer: i32,
    slices: u64,
    page: Box<Page>,
}

impl PageSlot for StoreSlot {
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
        Some(&self.page)
    }
}

/// All pages of a scan in memory. Threads share it by reference for queries. For scans that exceed memory, use a
/// [`Stream`](super::Stream).
///
/// ```
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::query::{Aabb, Overlap, overlaps};
/// use slicewalk::slice::{PageBuilder, Span};
/// use slicewalk::store::Store;
///
/// let frame = Frame::new(0.05, 0.15)?; // pixels of 5 cm, slices of 15 cm
/// let mut builder = PageBuilder::default();
/// assert!(builder.set_column(10, 20, &[Span::new(0, 255, false).unwrap()]));
/// let store = Store::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let touching = Aabb::new([0.52, 1.02, 0.15].into(), [0.6, 1.1, 1.0].into())?;
/// assert_eq!(overlaps(&store, &touching), Overlap::Hit);
/// let above = Aabb::new([0.52, 1.02, 0.16].into(), [0.6, 1.1, 1.0].into())?;
/// assert_eq!(overlaps(&store, &above), Overlap::Clear);
/// # Ok::<(), slicewalk::Error>(())
/// ```
pub struct Store {
    frame: Frame,
    columns: SlotTable<StoreSlot>,
    weight: usize,
}

impl Store {
    /// Creates a store of pages that are in memory already.
    ///
    /// # Panics
    /// If a key occurs twice.
    pub fn from_pages(frame: Frame, pages: impl IntoIterator<Item = (PageKey, Page)>) -> Self {
        let mut weight = 0;
        let slot = |(key, page): (PageKey, Page)| {
            weight += page.weight_bytes();
            (key, StoreSlot { layer: key.layer, slices: page.slices(), page: Box::new(page) })
        };
        let columns = SlotTable::new(pages.into_iter().map(slot).collect());
        Self { frame, columns, weight }
    }

    /// Reads all pages of an archive into a store: neighbours in reads of up to 1 MiB, four at a time. Fails with the
    /// error of the first page that cannot be loaded; before reading any page, if memory for all of them is not
    /// available; and with [`Error::Interrupted`] if `monitor` requests a stop.
    pub fn resident(archive: &Archive, monitor: &dyn Monitor) -> Result<Self> {
        let entries: Vec<PageEntry> = archive.entries().collect::<Result<_>>()?;
        let slot = size_of::<StoreSlot>() + size_of::<Page>();
        let weights = entries.iter().map(|entry| entry.weight_bytes().saturating_add(slot));
        check_memory(weights.fold(0, usize::saturating_add), entries.len())?;
        monitor.stage("loading", entries.len() as u64, "pages");
        let pages = entries.iter().map(|entry| entry.key).zip(archive.pages(&entries, monitor)?);
        let Some(edited) = edited_pages(archive)? else { return Ok(Self::from_pages(*archive.frame(), pages)) };
        let mut all: BTreeMap<PageKey, Page> = pages.collect();
        all.extend(edited);
        Ok(Self::from_pages(*archive.frame(), all))
    }

    /// Returns the memory of the pages (bytes).
    pub fn weight_bytes(&self) -> usize {
        self.weight
    }

    /// Returns the memory of the table of pages, which adds to [`weight_bytes`](Self::weight_bytes) (bytes).
    pub fn table_bytes(&self) -> usize {
        self.columns.weight_bytes()
    }

    /// Returns the number of pages.
    pub fn page_count(&self) -> usize {
        self.columns.slots().len()
    }
}

/// Fails if the system lacks memory for the pages, because running out of it while decoding would abort the process.
fn check_memory(bytes: usize, pages: usize) -> Result<()> {
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| {
        let action = format!("reserve {bytes} bytes for all {pages} pages");
        Error::io("memory", action, std::io::ErrorKind::OutOfMemory.into())
    })
}

impl std::fmt::Debug for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Store {{ pages: {}, bytes: {} }}", self.page_count(), self.weight)
    }
}

impl PageSet for Store {
    type Slot = StoreSlot;

    #[inline]
    fn frame(&self) -> &Frame {
        &self.frame
    }

    #[inline]
    fn bounds(&self) -> Option<KeyBounds> {
        self.columns.bounds()
    }

    #[inline]
    fn column(&self, tx: i32, ty: i32) -> &[StoreSlot] {
        self.columns.column(tx, ty)
    }

    #[inline]
    fn has_region(&self, rx: i32, ry: i32) -> bool {
        self.columns.has_region(rx, ry)
    }

    fn weight_hint(&self) -> usize {
        self.weight
    }

    fn column_count(&self) -> usize {
        self.columns.column_count()
    }

    fn column_at(&self, number: usize) -> (i32, i32, &[StoreSlot]) {
        self.columns.column_at(number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
