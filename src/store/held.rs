//! The store: slots of all pages of a scan, with the pages that are in memory.

use super::columns::{Columns, KeyBounds};
use super::{PageSet, PageSlot, PageSource};
use crate::frame::{Frame, PageKey};
use crate::monitor::Monitor;
use crate::slice::Page;
use crate::{Error, Result};

/// Place of one page in a [`Store`].
#[derive(Debug)]
pub struct StoreSlot {
    pub(super) layer: i32,
    /// Upper bound of the page's weight until it is loaded for the first time, then its weight (bytes).
    pub(super) weight: u32,
    pub(super) slices: u64,
    pub(super) page: Option<Box<Page>>,
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
        self.page.as_deref()
    }
}

/// All pages of a scan, or as many of them as a budget allows. Queries share it (`&Store`) between threads; loading
/// and evicting pages takes `&mut Store`.
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
    pub(super) frame: Frame,
    pub(super) columns: Columns<StoreSlot>,
    pub(super) source: Option<Box<dyn PageSource>>,
    /// Places in `columns` of the pages in memory, in no order.
    pub(super) loaded: Vec<(PageKey, u32)>,
    /// Weight of the pages in memory (bytes).
    pub(super) weight: usize,
    pub(super) budget: usize,
}

impl Store {
    /// A store of pages that are in memory already.
    ///
    /// # Panics
    /// If a key occurs twice.
    pub fn from_pages(frame: Frame, pages: impl IntoIterator<Item = (PageKey, Page)>) -> Self {
        let mut store = Self::empty(frame, None, usize::MAX);
        let slot = |(key, page): (PageKey, Page)| {
            let weight = page.weight_bytes();
            store.weight += weight;
            let slices = page.slices();
            let weight = u32::try_from(weight).unwrap_or(u32::MAX);
            (key, StoreSlot { layer: key.layer, weight, slices, page: Some(Box::new(page)) })
        };
        let slots: Vec<_> = pages.into_iter().map(slot).collect();
        store.columns = Columns::new(slots);
        store
    }

    /// A store that loads every page of `source` now. Fails with the first page that cannot be loaded, and with
    /// [`Error::Interrupted`] when `monitor` asks to stop.
    pub fn resident(source: &dyn PageSource, monitor: &dyn Monitor) -> Result<Self> {
        let infos = source.infos()?;
        monitor.stage("loading", infos.len() as u64, "pages");
        let mut pages = Vec::with_capacity(infos.len());
        for info in infos {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            pages.push((info.key, source.load(info.key)?));
            monitor.advance(1);
        }
        Ok(Self::from_pages(*source.frame(), pages))
    }

    /// A store that knows every page of `source` and holds none yet, and later at most `budget` bytes of them (see
    /// [`load`](Self::load)).
    pub fn with_budget(source: Box<dyn PageSource>, budget: usize) -> Result<Self> {
        let slots = source.infos()?.into_iter().map(|info| {
            let weight = u32::try_from(info.weight_bytes).unwrap_or(u32::MAX);
            (info.key, StoreSlot { layer: info.key.layer, weight, slices: info.slices, page: None })
        });
        let columns = Columns::new(slots.collect());
        Ok(Self { columns, ..Self::empty(*source.frame(), Some(source), budget) })
    }

    fn empty(frame: Frame, source: Option<Box<dyn PageSource>>, budget: usize) -> Self {
        Self { frame, columns: Columns::new(Vec::new()), source, loaded: Vec::new(), weight: 0, budget }
    }

    /// Weight of the pages in memory (bytes); never above the budget.
    pub fn weight_bytes(&self) -> usize {
        self.weight
    }

    /// Memory of the table of pages, which comes on top of [`weight_bytes`](Self::weight_bytes) (bytes).
    pub fn table_bytes(&self) -> usize {
        self.columns.weight_bytes()
    }

    /// Most bytes that pages in memory may weigh.
    pub fn budget_bytes(&self) -> usize {
        self.budget
    }

    /// Number of pages known, and how many of them are in memory.
    pub fn page_counts(&self) -> (usize, usize) {
        let slots = self.columns.slots();
        (slots.len(), slots.iter().filter(|slot| slot.page.is_some()).count())
    }
}

impl std::fmt::Debug for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (known, loaded) = self.page_counts();
        write!(f, "Store {{ pages: {known}, in memory: {loaded}, bytes: {} of {} }}", self.weight, self.budget)
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

    fn column_count(&self) -> usize {
        self.columns.column_count()
    }

    fn column_at(&self, number: usize) -> (i32, i32, &[StoreSlot]) {
        self.columns.column_at(number)
    }
}
