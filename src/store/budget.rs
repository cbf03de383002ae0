//! Loading pages into a store under a byte budget, evicting the farthest first.

use super::columns::KeyBounds;
use super::held::Store;
use crate::frame::PageKey;
use crate::{Error, Result};

/// A box of pages, both ends inclusive.
pub type Region = KeyBounds;

/// What a call of [`Store::load`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LoadReport {
    /// Pages loaded now.
    pub loaded: usize,
    /// Pages asked for that were in memory already.
    pub already: usize,
    /// Pages dropped to make room.
    pub evicted: usize,
    /// Pages asked for that found no room, because all pages in memory are nearer.
    pub left_out: usize,
}

impl Store {
    /// Brings pages of `region` into memory, nearest to `around` first. Where the budget is short, pages farther from
    /// `around` make room: first those farthest in z, among these the farthest in x and y. A page is dropped only for
    /// one that is nearer.
    ///
    /// At every moment the pages in memory together with the one being decoded weigh at most the budget, if the
    /// source's [`weight_bytes`](super::PageInfo::weight_bytes) are true. Blocks while it reads; cost: one load per
    /// page, plus a pass over the pages in memory for each page that is dropped.
    ///
    /// Fails when a page cannot be loaded; pages loaded before stay. Does nothing in a store without a source.
    pub fn load(&mut self, region: &Region, around: PageKey) -> Result<LoadReport> {
        let mut wanted = self.keys_in(region);
        wanted.sort_unstable_by_key(|key| (distance(*key, around), *key));
        self.load_keys(wanted, around)
    }

    /// As [`load`](Self::load) for the pages that a query missed (see [`Missing`](crate::store::Missing)).
    pub fn load_missing(&mut self, missing: &[PageKey], around: PageKey) -> Result<LoadReport> {
        let mut wanted = missing.to_vec();
        wanted.sort_unstable_by_key(|key| (distance(*key, around), *key));
        self.load_keys(wanted, around)
    }

    fn load_keys(&mut self, wanted: Vec<PageKey>, around: PageKey) -> Result<LoadReport> {
        let mut report = LoadReport::default();
        let Some(source) = self.source.take() else { return Ok(report) };
        let result = wanted.into_iter().try_for_each(|key| {
            let Some(at) = self.place(key) else { return Ok(()) };
            if self.columns.slots()[at].page.is_some() {
                report.already += 1;
                return Ok(());
            }
            let bound = self.columns.slots()[at].weight as usize;
            if !self.make_room(bound, distance(key, around), around, &mut report) {
                report.left_out += 1;
                return Ok(());
            }
            let page = source.load(key)?;
            let weight = page.weight_bytes();
            // Only a source that broke its promise gets here with too heavy a page.
            if !self.make_room(weight, distance(key, around), around, &mut report) {
                report.left_out += 1;
                return Ok(());
            }
            let slot = self.columns.slot_mut(at);
            if page.slices() & !slot.slices != 0 {
                let reason = format!("page {key} has matter in slices that its source did not name");
                return Err(Error::parameter("page source", reason));
            }
            slot.weight = u32::try_from(weight).unwrap_or(u32::MAX);
            slot.page = Some(Box::new(page));
            self.weight += weight;
            self.loaded.push((key, at as u32));
            report.loaded += 1;
            Ok(())
        });
        self.source = Some(source);
        result.map(|()| report)
    }

    /// Drops pages farther than `than` until `bytes` fit; `false` if they cannot.
    fn make_room(&mut self, bytes: usize, than: (u32, u32), around: PageKey, report: &mut LoadReport) -> bool {
        let farther = self.loaded.iter().filter(|(key, _)| distance(*key, around) > than);
        let gain: usize = farther.map(|&(_, at)| self.columns.slots()[at as usize].weight as usize).sum();
        if (self.weight - gain).saturating_add(bytes) > self.budget {
            return false;
        }
        while self.weight + bytes > self.budget {
            let ranked = self.loaded.iter().enumerate();
            let farthest = ranked.max_by_key(|(_, (key, _))| (distance(*key, around), *key)).map(|(n, _)| n);
            let Some((_, at)) = farthest.map(|n| self.loaded.swap_remove(n)) else { return false };
            let slot = self.columns.slot_mut(at as usize);
            slot.page = None;
            self.weight -= slot.weight as usize;
            report.evicted += 1;
        }
        true
    }

    fn place(&self, key: PageKey) -> Option<usize> {
        let range = self.columns.range(key.tx, key.ty);
        let slots = &self.columns.slots()[range.clone()];
        slots.binary_search_by_key(&key.layer, |slot| slot.layer).ok().map(|n| range.start + n)
    }

    /// Keys of all known pages in `region`.
    fn keys_in(&self, region: &Region) -> Vec<PageKey> {
        let inside = |axis: usize, value: i32| (region.min[axis]..=region.max[axis]).contains(&value);
        let columns = (0..self.columns.column_count()).map(|number| self.columns.column_at(number));
        let columns = columns.filter(|&(tx, ty, _)| inside(0, tx) && inside(1, ty));
        columns
            .flat_map(|(tx, ty, slots)| slots.iter().map(move |slot| PageKey { tx, ty, layer: slot.layer }))
            .filter(|key| inside(2, key.layer))
            .collect()
    }
}

/// Layers apart, then tiles apart (the greater of x and y).
fn distance(key: PageKey, around: PageKey) -> (u32, u32) {
    let tiles = key.tx.abs_diff(around.tx).max(key.ty.abs_diff(around.ty));
    (key.layer.abs_diff(around.layer), tiles)
}
