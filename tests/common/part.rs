//! A set of pages of which some are not in memory, as a program might implement it.

use slicewalk::frame::{Frame, PageKey};
use slicewalk::slice::Page;
use slicewalk::store::{KeyBounds, PageSet, PageSlot};
use std::collections::BTreeMap;

/// All pages of a scene, some of them in memory.
pub struct Part {
    frame: Frame,
    columns: BTreeMap<(i32, i32), Vec<PartSlot>>,
}

pub struct PartSlot {
    layer: i32,
    page: Page,
    loaded: bool,
}

impl Part {
    /// Starts with none of the pages in memory.
    pub fn new(frame: Frame, pages: impl IntoIterator<Item = (PageKey, Page)>) -> Self {
        let mut columns: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for (key, page) in pages {
            columns.entry((key.tx, key.ty)).or_default().push(PartSlot { layer: key.layer, page, loaded: false });
        }
        columns.values_mut().for_each(|slots| slots.sort_by_key(|slot| slot.layer));
        Self { frame, columns }
    }

    /// Loads pages; returns how many were missing.
    pub fn load(&mut self, keys: &[PageKey]) -> usize {
        let mut loaded = 0;
        for key in keys {
            let slots = self.columns.get_mut(&(key.tx, key.ty)).expect("a known page");
            let slot = slots.iter_mut().find(|slot| slot.layer == key.layer).expect("a known page");
            loaded += usize::from(!std::mem::replace(&mut slot.loaded, true));
        }
        loaded
    }
}

impl PageSlot for PartSlot {
    fn layer(&self) -> i32 {
        self.layer
    }

    fn slices(&self) -> u64 {
        self.page.slices()
    }

    fn page(&self) -> Option<&Page> {
        self.loaded.then_some(&self.page)
    }
}

impl PageSet for Part {
    type Slot = PartSlot;

    fn frame(&self) -> &Frame {
        &self.frame
    }

    fn bounds(&self) -> Option<KeyBounds> {
        let slots = || self.columns.iter().flat_map(|(&(tx, ty), slots)| slots.iter().map(move |s| [tx, ty, s.layer]));
        let least = slots().reduce(|a, b| std::array::from_fn(|axis| a[axis].min(b[axis])))?;
        let greatest = slots().reduce(|a, b| std::array::from_fn(|axis| a[axis].max(b[axis])))?;
        Some(KeyBounds { min: least, max: greatest })
    }

    fn column(&self, tx: i32, ty: i32) -> &[PartSlot] {
        self.columns.get(&(tx, ty)).map_or(&[], |slots| slots)
    }

    fn has_region(&self, _: i32, _: i32) -> bool {
        true
    }

    fn column_count(&self) -> usize {
        self.columns.len()
    }

    fn column_at(&self, number: usize) -> (i32, i32, &[PartSlot]) {
        let ((tx, ty), slots) = self.columns.iter().nth(number).expect("a number below the count");
        (*tx, *ty, slots)
    }
}
