//! Colours that a loader brings: the pages that want some, the bytes to fetch next, and colours to be taken.
//!
//! In: pages by urgency, fetched bytes. Out: runs of colours to fetch and decode. Memory: bytes in flight, the colour
//! leaves in use, the scratch memory of decoding and colours not taken yet, in a share of the loader's budget that is
//! set aside when colours are first wanted, or in what is left of the budget.

use super::budget::{Budget, Reservation};
use super::fetch::{Retry, Time};
use super::id_map::IdMap;
use super::index::Index;
use super::snapshot::Snapshot;
use crate::archive::{Catalog, ColourEntry, ColourTable};
use crate::frame::PageKey;
use crate::page::{Colours, Page};
use crate::{Error, Result};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// Most pages of a fetch, most bytes of their blocks (unless a single block is longer), and most unwanted bytes between
/// two blocks.
const RUN_PAGES: usize = 16;
const RUN_BYTES: u64 = 64 << 10;
const GAP_BYTES: u64 = 2 << 10;
/// Most bytes of an entry of a colour leaf before compression.
const RAW_ENTRY: usize = 16;
/// Memory of colours per page and per voxel, and of decoding them, with the result (bytes).
const PAGE_BYTES: usize = 48 << 10;
const VOXEL_BYTES: usize = 4;
const PAGE_SCRATCH: usize = 64 << 10;
const VOXEL_SCRATCH: usize = 16;
/// Share of the budget for colours; its least size (bytes), provided that is at most a quarter of the budget; and the
/// size that suffices for a page in which every voxel is occupied.
const SHARE: usize = 8;
const LEAST_SHARE: usize = 512 << 10;
const FULL_SHARE: usize = (4 << 20) + LEAST_SHARE;
/// Interval at which to check whether the budget has room, since releasing memory sends no notification.
const ROOM_AGAIN: Duration = Duration::from_millis(100);

#[derive(Debug)]
pub(super) struct ColourQueue {
    /// Catalog of the archive; for an overview level, with its colours located once their table is read.
    catalog: Arc<Catalog>,
    index: Arc<Index>,
    budget: Arc<Budget>,
    /// Memory set aside for colours, in use or not.
    share: Option<(Arc<Budget>, Reservation)>,
    table: Option<ColourTable>,
    leaves: IdMap<usize, Leaf>,
    /// Numbers of the wanted pages, the most urgent one last.
    wanted: Vec<u32>,
    /// Whether what is in flight is still wanted.
    wants_flight: bool,
    lacks_room: bool,
    retry: Retry,
    /// Colours to be taken, and their memory.
    ready: Vec<(PageKey, Result<Colours>)>,
    ready_room: Option<Reservation>,
}

#[derive(Debug)]
struct Leaf {
    /// Empty if the leaf is damaged.
    entries: Vec<ColourEntry>,
    _room: Reservation,
}

/// Bytes of colours for one fetch.
#[derive(Debug)]
pub(super) struct ColourRun {
    part: Part,
    /// The most urgent page.
    page: u32,
    room: Reservation,
}

#[derive(Debug)]
enum Part {
    /// Table that locates the colours of a level.
    Levels,
    Table,
    Leaf(usize),
    Blocks(Vec<(u32, ColourEntry)>),
}

/// Returns whether the archive has colours for the pages of a loader. Inferred voxels have no colours but are counted,
/// so colours cannot be matched to pages without them.
pub(super) fn has_colours(catalog: &Catalog) -> bool {
    !catalog.ignores_inferred() && (catalog.colours_section().is_some() || catalog.level_colours_range().is_some())
}

impl ColourQueue {
    /// Creates the queue of an archive that [has colours](has_colours).
    pub fn new(catalog: Arc<Catalog>, index: Arc<Index>, budget: Arc<Budget>) -> Self {
        Self {
            catalog,
            index,
            budget,
            share: None,
            table: None,
            leaves: IdMap::new(),
            wanted: Vec::new(),
            wants_flight: false,
            lacks_room: false,
            retry: Retry::default(),
            ready: Vec::new(),
            ready_room: None,
        }
    }

    /// Replaces the wanted pages, most urgent first.
    pub fn want(&mut self, keys: &[PageKey], flight: Option<&ColourRun>) {
        self.wanted = keys.iter().rev().filter_map(|key| self.index.find(*key)).collect();
        self.wants_flight = !self.wanted.is_empty();
        if let Some(Part::Blocks(blocks)) = flight.map(|run| &run.part) {
            let count = self.wanted.len();
            self.wanted.retain(|page| !blocks.iter().any(|(other, _)| other == page));
            self.wants_flight = self.wanted.len() < count;
        }
    }

    pub fn wants_flight(&self) -> bool {
        self.wants_flight
    }

    /// Returns the size of the share while pages are wanted and it is not set aside yet (bytes).
    pub fn share_to_set_aside(&self) -> Option<usize> {
        let budget = self.budget.budget();
        let share = (budget / SHARE).max(LEAST_SHARE.min(budget / 4)).min(FULL_SHARE);
        (self.share.is_none() && !self.wanted.is_empty()).then_some(share)
    }

    pub fn set_aside(&mut self, room: Reservation) {
        self.share = Some((Budget::new(room.bytes()), room));
    }

    #[cfg(test)]
    pub fn share_rest(&self) -> Option<Reservation> {
        self.share.as_ref().map(|(own, _)| own.take_rest())
    }

    /// Returns when to ask again if only time must pass.
    pub fn again(&self, now: Time) -> Option<Time> {
        let room = self.lacks_room.then(|| now + ROOM_AGAIN);
        self.retry.at().or(room).filter(|again| *again > now && !self.wanted.is_empty())
    }

    pub fn is_ready(&self) -> bool {
        !self.ready.is_empty()
    }

    pub fn take(&mut self) -> Vec<(PageKey, Result<Colours>)> {
        self.ready_room = None;
        std::mem::take(&mut self.ready)
    }

    /// Returns the bytes to fetch now for pages of `view`; `None` while there are colours to be taken or no room, and if
    /// no page needs bytes. Pages that are not in memory get no colours.
    pub fn claim(&mut self, view: &Snapshot, now: Time) -> Option<(Range<u64>, ColourRun)> {
        self.lacks_room = false;
        if !self.ready.is_empty() || !self.retry.is_due(now) {
            return None;
        }
        loop {
            let page = *self.wanted.last()?;
            if let Some(range) = self.catalog.level_colours_range() {
                let bytes = 2 * (range.end - range.start) as usize;
                return self.reserve(range, Part::Levels, page, bytes);
            }
            if self.table.is_none() {
                let range = self.catalog.colour_table_range()?;
                let bytes = 2 * (range.end - range.start) as usize;
                return self.reserve(range, Part::Table, page, bytes);
            }
            let number = self.catalog.leaf_of(self.index.key(page))?;
            let Some(leaf) = self.leaves.get(&number) else {
                let range = self.table.as_ref()?.leaf_range(number);
                let entries = self.catalog.leaf_entries(number) as usize;
                let bytes = (range.end - range.start) as usize + entries * (RAW_ENTRY + size_of::<ColourEntry>());
                return self.reserve(range, Part::Leaf(number), page, bytes);
            };
            let first: u32 = (0..number).map(|before| self.catalog.leaf_entries(before)).sum();
            let (blocks, bytes) = self.blocks(&leaf.entries, first, page, view);
            let Some((_, entry)) = blocks.first() else {
                self.wanted.pop();
                continue;
            };
            let range = entry.offset..blocks.last().map_or(entry.offset, |(_, last)| last.range().end);
            let (range, run) = self.reserve(range, Part::Blocks(blocks), page, bytes)?;
            let blocks = self.blocks_of(&run).unwrap_or_default();
            self.wanted.retain(|page| !blocks.iter().any(|(key, _)| *key == self.index.key(*page)));
            if !range.is_empty() {
                return Some((range, run));
            }
            // Pages without a colour need no bytes.
            self.loaded(run, decode_blocks(view, blocks, range.start, &[]));
            return None;
        }
    }

    /// Reserves the memory of a fetch in the share or else in the whole budget. Drops the leaves if necessary: they are
    /// few and can be fetched again.
    fn reserve(&mut self, range: Range<u64>, part: Part, page: u32, bytes: usize) -> Option<(Range<u64>, ColourRun)> {
        let (own, whole) = (self.share.as_ref().map(|(own, _)| own.clone()), self.budget.clone());
        let take = || own.as_ref().and_then(|own| own.take(bytes)).or_else(|| whole.take(bytes));
        let room = take().or_else(|| {
            self.leaves = IdMap::new();
            take()
        });
        (self.lacks_room, self.wants_flight) = (room.is_none(), true);
        room.map(|room| (range, ColourRun { part, page, room }))
    }

    /// Returns `page` and wanted pages whose blocks lie close to its block, in order, and the memory to bring them.
    /// `entries` begin with page `first`. Empty if the leaf is damaged or the page is not in memory.
    fn blocks(
        &self,
        entries: &[ColourEntry],
        first: u32,
        page: u32,
        view: &Snapshot,
    ) -> (Vec<(u32, ColourEntry)>, usize) {
        let entry = |page: u32| Some((page, *entries.get(page.checked_sub(first)? as usize)?));
        let voxels = |page: u32| Some(loaded(view, self.index.key(page))?.voxel_counts().0 as usize);
        let (Some(middle), Some(count)) = (entry(page), voxels(page)) else { return (Vec::new(), 0) };
        let mut near: Vec<_> =
            self.wanted.iter().filter_map(|&other| entry(other)).filter(|one| one.0 != page).collect();
        near.sort_unstable_by_key(|other| other.0);
        let (below, above) = near.split_at(near.partition_point(|other| other.0 < page));
        let room = self.share.as_ref().map_or(0, |(own, _)| own.budget() - own.used());
        let (mut run, mut range) = (vec![middle], middle.1.range());
        // Colours of all pages, and the memory of decoding those of most voxels.
        let need = |count: usize| PAGE_BYTES + VOXEL_BYTES * count;
        let decoding = |count: usize| PAGE_SCRATCH + VOXEL_SCRATCH * count - need(count);
        let (mut colours, mut most) = (need(count), count);
        let mut extend = |other: &(u32, ColourEntry)| {
            let (own, Some(count)) = (other.1.range(), voxels(other.0)) else { return true };
            let gap = own.start.saturating_sub(range.end).max(range.start.saturating_sub(own.end));
            let whole = range.start.min(own.start)..range.end.max(own.end);
            let bytes = (whole.end - whole.start) as usize + colours + need(count) + decoding(most.max(count));
            let fits =
                gap <= GAP_BYTES && whole.end - whole.start <= RUN_BYTES && bytes <= room && run.len() < RUN_PAGES;
            if fits {
                (range, colours, most) = (whole, colours + need(count), most.max(count));
                run.push(*other);
            }
            fits
        };
        let _ = above.iter().all(&mut extend);
        let _ = below.iter().rev().all(&mut extend);
        run.sort_unstable_by_key(|other| other.0);
        (run, (range.end - range.start) as usize + colours + decoding(most))
    }

    /// Returns the blocks that a run brings; `None` if it brings a table or leaf.
    pub fn blocks_of(&self, run: &ColourRun) -> Option<Vec<(PageKey, ColourEntry)>> {
        let Part::Blocks(blocks) = &run.part else { return None };
        Some(blocks.iter().map(|(page, entry)| (self.index.key(*page), *entry)).collect())
    }

    /// Takes the bytes of a table or leaf. Colours that damaged bytes describe are never loaded.
    pub fn arrived(&mut self, mut run: ColourRun, bytes: &[u8], now: Time) {
        self.retry = Retry::default();
        let taken = match (&run.part, &self.table) {
            (Part::Levels, _) => self.catalog.with_level_colours(bytes).map(|catalog| self.catalog = Arc::new(catalog)),
            (Part::Leaf(number), Some(table)) => {
                let entries = self.catalog.decode_colour_leaf(table, *number, bytes).unwrap_or_else(|error| {
                    self.ready.push((self.index.key(run.page), Err(error)));
                    Vec::new()
                });
                let room = run.room.split(entries.capacity() * size_of::<ColourEntry>());
                self.leaves.insert(*number, Leaf { entries, _room: room });
                Ok(())
            }
            _ => self.catalog.decode_colour_table(bytes).map(|table| self.table = Some(table)),
        };
        if let Err(error) = taken {
            self.failed(run, error, now);
        }
    }

    /// Takes decoded colours.
    pub fn loaded(&mut self, mut run: ColourRun, made: Vec<(PageKey, Result<Colours>)>) {
        self.retry = Retry::default();
        let weight = |colours: &Colours| PAGE_BYTES + VOXEL_BYTES * colours.values().len();
        let bytes = made.iter().filter_map(|(_, colours)| colours.as_ref().ok()).map(weight).sum();
        self.ready_room = Some(run.room.split(bytes));
        self.ready.extend(made);
    }

    /// Notes that a run failed, and reports it with the most urgent page.
    pub fn failed(&mut self, run: ColourRun, error: Error, now: Time) {
        self.retry.failed(&error, now);
        self.ready.push((self.index.key(run.page), Err(error)));
        self.cancel(run);
    }

    /// Gives up a run; its pages stay wanted.
    pub fn cancel(&mut self, run: ColourRun) {
        if let Part::Blocks(blocks) = run.part {
            let others = blocks.into_iter().map(|(page, _)| page).filter(|page| *page != run.page);
            self.wanted.extend(others.chain([run.page]));
        }
    }
}

/// Decodes blocks of pages that are still in memory, from bytes that begin at offset `start` of the archive. Damage is an
/// error of its page alone.
pub(super) fn decode_blocks(
    view: &Snapshot,
    blocks: Vec<(PageKey, ColourEntry)>,
    start: u64,
    bytes: &[u8],
) -> Vec<(PageKey, Result<Colours>)> {
    let decode = |(key, entry): (PageKey, ColourEntry)| {
        let from = (entry.offset - start) as usize;
        let own = bytes.get(from..from + entry.len as usize).unwrap_or(&[]);
        Some((key, entry.decode(key, loaded(view, key)?, own)))
    };
    blocks.into_iter().filter_map(decode).collect()
}

fn loaded(view: &Snapshot, key: PageKey) -> Option<&Page> {
    view.column(key.tx, key.ty).iter().find(|slot| slot.layer() == key.layer)?.page()
}

#[cfg(test)]
mod tests {
    use super::super::{
        Fetch, Loader, LoaderOptions, MotionHint, Next, Payload, Prefetch, Step, Stream, StreamOptions,
    };
    use super::*;
    use crate::archive::{Archive, ArchiveWriter, ColourReader, EncodedColours, PageEncoder, Totals};
    use crate::codec::ColourEncoder;
    use crate::colour::{ColourPlan, ColourScale};
    use crate::frame::Frame;
    use crate::page::{Occupancy, PageBuilder, Span};
    use crate::plan::Plan;

    /// 12 × 3 pages of rough ground; every fourth has no colours.
    fn archive(levels: bool) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
        let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        let plan_of_colours = ColourPlan { scale: ColourScale::of_rgb(65_535), error_milli: 0 };
        if levels {
            writer.set_levels();
        }
        writer.set_colours(plan_of_colours);
        let (mut encoder, mut of_colours) = (PageEncoder::new(plan.frame), ColourEncoder::default());
        let mut keys: Vec<_> = (0..36).map(|n| PageKey { tx: n % 12, ty: n / 12, layer: 0 }).collect();
        keys.sort_unstable();
        for (number, key) in keys.into_iter().enumerate() {
            let mut page = PageBuilder::default();
            for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
                let top = 100 + (x * 31 + y * 17) % 5 * 60 + number as u32;
                assert!(page.set_column(x, y, &[Span::new(0, top, false).unwrap()]));
            }
            let page = page.build();
            let occupancy = Occupancy::of(&page);
            let colour = |voxel: usize| {
                (!number.is_multiple_of(4)).then_some([(voxel * 257 % 65_536) as u16, (number * 1000) as u16, 30_000])
            };
            let colours: Vec<_> = (0..occupancy.len()).map(colour).collect();
            let colours = EncodedColours::new(&plan_of_colours, &occupancy, &colours, &mut of_colours);
            writer.put(key, encoder.encode(key, &page).with_colours(colours)).unwrap();
        }
        writer.finish(Totals { points_read: 1, points_kept: 1, ..Totals::default() }).unwrap();
        std::fs::read(&target).unwrap()
    }

    fn keys(archive: &Archive) -> Vec<PageKey> {
        archive.entries().map(|entry| entry.unwrap().key).collect()
    }

    /// A loader with all pages of the archive in memory.
    fn whole(bytes: &[u8], budget: usize) -> Loader {
        whole_of(&Archive::from_bytes(bytes.to_vec()).unwrap(), bytes, budget)
    }

    fn whole_of(archive: &Archive, bytes: &[u8], budget: usize) -> Loader {
        let mut loader = Loader::new(archive.catalog().clone(), LoaderOptions::new(budget)).unwrap();
        let mut request = None;
        loop {
            match loader.poll(Time::ZERO).unwrap() {
                Next::Fetch(fetch) => {
                    let bytes = bytes[fetch.range.start as usize..fetch.range.end as usize].to_vec();
                    if let Some(job) = loader.given(fetch.id, bytes, Time::ZERO) {
                        loader.loaded(job.run(), Time::ZERO);
                    }
                }
                Next::Wait(_) if request.is_some() => return loader,
                Next::Wait(_) => request = Some(loader.request(&keys(archive), keys(archive)[0])),
                other => panic!("{other:?}"),
            }
        }
    }

    /// Returns the fetch of colours that a loader asks for; fails if it asks for anything else.
    fn asked(loader: &mut Loader, now: Time) -> Option<Fetch> {
        match loader.poll(now).unwrap() {
            Next::Fetch(fetch) if fetch.what == Payload::Colours => Some(fetch),
            Next::Wait(_) => None,
            other => panic!("{other:?}"),
        }
    }

    fn give(loader: &mut Loader, bytes: &[u8], fetch: &Fetch) {
        let bytes = bytes[fetch.range.start as usize..fetch.range.end as usize].to_vec();
        if let Some(job) = loader.given(fetch.id, bytes, Time::ZERO) {
            loader.loaded(job.run(), Time::ZERO);
        }
    }

    #[test]
    fn colours_come_as_a_reader_reads_them_the_most_urgent_first() {
        let bytes = archive(false);
        let mut reader = ColourReader::new(&Archive::from_bytes(bytes.clone()).unwrap()).unwrap().unwrap();
        let mut loader = whole(&bytes, 64 << 20);
        let view = loader.snapshot().unwrap();
        assert!(loader.has_colours());
        assert_eq!(asked(&mut loader, Time::ZERO), None, "nothing is wanted");
        let mut wanted = keys(&Archive::from_bytes(bytes.clone()).unwrap());
        wanted.rotate_left(17);
        let unknown = PageKey { tx: 99, ty: 0, layer: 0 };
        loader.want_colours(&wanted.iter().copied().chain([unknown]).collect::<Vec<_>>());
        let (mut found, mut fetches, mut now) = (Vec::new(), 0, Time::ZERO);
        loop {
            let fetch = asked(&mut loader, now);
            if let Some(mut fetch) = fetch.clone() {
                assert_eq!(asked(&mut loader, now), None, "one fetch at a time");
                fetches += 1;
                if fetches == 3 {
                    loader.want_colours(&[]);
                    assert!(
                        matches!(loader.poll(now).unwrap(), Next::Cancel(id) if id == fetch.id),
                        "it is not wanted"
                    );
                    loader.want_colours(&wanted);
                    let again = asked(&mut loader, now).unwrap();
                    assert_eq!(again.range, fetch.range);
                    loader.failed(again.id, Error::io("link", "read", std::io::ErrorKind::TimedOut.into()), now);
                    let failed = loader.take_colours();
                    assert!(matches!(failed[..], [(key, Err(Error::Io { .. }))] if key == wanted[0]), "{failed:?}");
                    let Next::Wait(Some(at)) = loader.poll(now).unwrap() else { panic!("no retry") };
                    now = at;
                    fetch = asked(&mut loader, now).unwrap();
                    assert_eq!(again.range, fetch.range);
                    // An answer to a fetch that was given up is ignored.
                    give(&mut loader, &bytes, &again);
                }
                give(&mut loader, &bytes, &fetch);
            }
            let taken = loader.take_colours();
            assert!(taken.len() <= RUN_PAGES);
            if fetch.is_none() && taken.is_empty() {
                break;
            }
            for (key, colours) in taken {
                let page = loaded(&view, key).unwrap();
                assert_eq!(colours.unwrap(), reader.colours_of(key, page).unwrap());
                found.push(key);
            }
        }
        assert_eq!(found.len(), wanted.len());
        assert!(found[..8].contains(&wanted[0]) && fetches < 20, "{fetches} fetches, {found:?}");
        found.sort_unstable();
        wanted.sort_unstable();
        assert_eq!(found, wanted);
    }

    #[test]
    fn colours_of_a_level_come_like_those_of_an_archive_and_damage_keeps_them_away() {
        let bytes = archive(true);
        let level = Archive::from_bytes(bytes.clone()).unwrap().level(1).unwrap();
        let table = level.catalog().level_colours_range().unwrap();
        let mut reader = ColourReader::new(&level).unwrap().unwrap();
        for damage in [None, Some(table.start), Some(table.end - 1)] {
            let mut damaged = bytes.clone();
            damage.into_iter().for_each(|at| damaged[at as usize] ^= 1);
            let mut loader = whole_of(&level, &bytes, 64 << 20);
            let view = loader.snapshot().unwrap();
            loader.want_colours(&keys(&level));
            let (mut found, mut errors, mut fetched) = (0, Vec::new(), 0);
            while let Some(fetch) = asked(&mut loader, Time::ZERO) {
                assert_eq!(fetched == 0, fetch.range == table, "the table comes first");
                fetched += 1;
                give(&mut loader, &damaged, &fetch);
                for (key, colours) in loader.take_colours() {
                    let expected = reader.colours_of(key, loaded(&view, key).unwrap()).unwrap();
                    assert!(expected.count() > 0);
                    match colours {
                        Ok(colours) => assert_eq!(colours, expected),
                        Err(error) => errors.push(error),
                    }
                    found += 1;
                }
            }
            match damage {
                None => assert_eq!((found, errors.len(), fetched), (3, 0, 4)),
                Some(_) => {
                    assert_eq!((found, errors.len(), fetched), (1, 1, 1));
                    assert!(matches!(errors[0], Error::Format { rule: "K11", .. }), "{}", errors[0]);
                }
            }
        }
        // From the bytes of the level alone.
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        let told = &archive.levels().unwrap()[0];
        let range = told.bytes();
        let alone = Archive::of_level(told, bytes[range.start as usize..range.end as usize].to_vec()).unwrap();
        assert!(ColourReader::new(&alone).unwrap().is_none());
    }

    #[test]
    fn a_budget_without_room_and_damage_keep_colours_away_and_nothing_else() {
        let bytes = archive(false);
        let archive_of = |bytes: &[u8]| Archive::from_bytes(bytes.to_vec()).unwrap();
        let all = keys(&archive_of(&bytes));
        let mut loader = whole(&bytes, 64 << 20);
        // The pages are needed now, so none is evicted for colours.
        let body = loader.body();
        let (low, high) = ([0.1, 0.1, 0.1].into(), [38.0, 9.5, 1.0].into());
        loader.hint(body, &MotionHint::walking(low, high, nalgebra::Vector3::zeros()));
        let taken = loader.fill_the_budget();
        loader.want_colours(&all);
        assert_eq!(asked(&mut loader, Time::ZERO), None);
        assert!(matches!(loader.poll(Time::ZERO).unwrap(), Next::Wait(Some(_))), "it looks for room again");
        drop(taken);
        assert!(asked(&mut loader, Time::ZERO).is_some());
        let mut loader = whole(&bytes, 64 << 20);
        // Every bit of the table, of the leaf and of a block.
        let catalog = archive_of(&bytes);
        let section = catalog.catalog().colours_section().unwrap();
        for byte in section.clone().step_by(((section.end - section.start) / 60) as usize).chain([section.end - 1]) {
            let mut damaged = bytes.clone();
            damaged[byte as usize] ^= 0x10;
            loader.colours = None;
            loader.want_colours(&all);
            let mut errors = Vec::new();
            for _ in 0..200 {
                if let Some(fetch) = asked(&mut loader, Time::ZERO) {
                    give(&mut loader, &damaged, &fetch);
                }
                errors.extend(loader.take_colours().into_iter().filter_map(|(_, colours)| colours.err()));
            }
            assert_eq!(errors.len(), 1, "byte {byte}");
            assert!(matches!(&errors[0], Error::Format { rule, .. } if rule.starts_with('K')), "{}", errors[0]);
            assert_eq!(asked(&mut loader, Time::ZERO), None);
            assert_eq!(loader.snapshot().unwrap().page_count(), all.len(), "pages stay");
        }
    }

    #[test]
    fn a_page_that_a_body_waits_for_ends_a_fetch_of_colours_and_takes_its_turn() {
        let bytes = archive(false);
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        let all = keys(&archive);
        let options = LoaderOptions { fetches: 1, ..LoaderOptions::new(64 << 20) };
        let mut loader = Loader::new(archive.catalog().clone(), options).unwrap();
        while let Next::Fetch(fetch) = loader.poll(Time::ZERO).unwrap() {
            give(&mut loader, &bytes, &fetch);
        }
        let first = loader.request(&all[..1], all[0]);
        let Next::Fetch(fetch) = loader.poll(Time::ZERO).unwrap() else { panic!("no page") };
        give(&mut loader, &bytes, &fetch);
        while loader.outcome(first).is_none() {
            assert!(matches!(loader.poll(Time::ZERO).unwrap(), Next::Wait(None)));
        }
        loader.want_colours(&all);
        let colours = asked(&mut loader, Time::ZERO).expect("colours");
        loader.request(&all[20..21], all[20]);
        let Next::Fetch(page) = loader.poll(Time::ZERO).unwrap() else { panic!("it waits for colours") };
        assert_eq!((page.what, page.needed_in), (Payload::Pages, Time::ZERO));
        assert!(matches!(loader.poll(Time::ZERO).unwrap(), Next::Cancel(id) if id == colours.id));
        assert_eq!(asked(&mut loader, Time::ZERO), None, "no colours while a page is in flight");
        give(&mut loader, &bytes, &page);
        assert_eq!(asked(&mut loader, Time::ZERO).unwrap().range, colours.range);
    }

    #[test]
    fn without_a_wish_no_byte_of_colours_is_read() {
        let bytes = archive(true);
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        let section = archive.catalog().colours_section().unwrap();
        let mut damaged = bytes.clone();
        damaged[section.start as usize..section.end as usize].fill(0x55);
        let loader = whole_of(&archive, &damaged, 64 << 20);
        assert!(loader.colours.is_none());
        assert!(keys(&archive).iter().all(|key| loader.snapshot().unwrap().is_loaded(*key) == Some(true)));
    }

    #[test]
    fn colours_come_while_pages_fill_the_budget_and_no_thread_spins() {
        let bytes = archive(false);
        let all = keys(&Archive::from_bytes(bytes.clone()).unwrap());
        for budget in [1100 << 10, 1400 << 10, 2 << 20] {
            for prefetch in [Prefetch::Manual, Prefetch::Thread] {
                let options = StreamOptions { prefetch, ..StreamOptions::new(budget) };
                let stream = Stream::open(Archive::from_bytes(bytes.clone()).unwrap(), options).unwrap();
                // Sets the share aside.
                stream.want_colours(&all);
                stream.step();
                stream.load(&all, all[0]).unwrap();
                let resident: Vec<_> =
                    all.iter().copied().filter(|key| loaded(&stream.snapshot(), *key).is_some()).collect();
                assert!(resident.len() > 8, "{budget}: {} pages", resident.len());
                stream.want_colours(&resident);
                let start = std::time::Instant::now();
                let mut found = 0;
                while found < resident.len() {
                    assert!(start.elapsed().as_secs() < 60, "{budget}: {found} of {} pages", resident.len());
                    stream.step();
                    found += stream.take_colours().into_iter().filter(|(_, colours)| colours.is_ok()).count();
                }
                assert!(stream.counters().peak_bytes <= budget);
            }
        }
        // Without memory for a share there is nothing to do until the budget has room.
        let options = StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(64 << 20) };
        let stream = Stream::open(Archive::from_bytes(bytes.clone()).unwrap(), options).unwrap();
        stream.load(&all, all[0]).unwrap();
        stream.want_colours(&all);
        while stream.take_colours().is_empty() {
            assert_eq!(stream.step(), Step::Coloured);
        }
        let taken = stream.fill_the_budget();
        for _ in 0..100 {
            stream.take_colours();
            if stream.step() == Step::Idle {
                break;
            }
        }
        assert_eq!((stream.step(), stream.take_colours().len()), (Step::Idle, 0));
        drop(taken);
        assert_eq!(stream.step(), Step::Coloured);
    }

    #[test]
    fn a_stream_reads_colours_when_no_page_is_to_be_read() {
        let bytes = archive(false);
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        let wanted = keys(&archive);
        let mut reader = ColourReader::new(&archive).unwrap().unwrap();
        for prefetch in [Prefetch::Manual, Prefetch::Thread] {
            let options = StreamOptions { prefetch, ..StreamOptions::new(64 << 20) };
            let stream = Stream::open(Archive::from_bytes(bytes.clone()).unwrap(), options).unwrap();
            stream.want_colours(&wanted);
            let (low, high) = ([0.1, 0.1, 0.1].into(), [38.0, 9.5, 1.0].into());
            let mut pawn = stream.pawn();
            pawn.hint(&MotionHint::walking(low, high, nalgebra::Vector3::zeros()));
            let mut found = std::collections::BTreeSet::new();
            let mut colour_steps = 0;
            while found.len() < wanted.len() {
                match stream.step() {
                    Step::Loaded(_) => assert_eq!(colour_steps, 0, "pages come first"),
                    Step::Coloured => colour_steps += 1,
                    _ => std::thread::yield_now(),
                }
                let taken = stream.take_colours();
                assert!(taken.len() <= 16);
                for (key, colours) in taken {
                    let view = stream.snapshot();
                    assert_eq!(colours.unwrap(), reader.colours_of(key, loaded(&view, key).unwrap()).unwrap());
                    found.insert(key);
                }
                if prefetch == Prefetch::Thread {
                    // Pages that were not in memory when they were requested are requested again.
                    stream.want_colours(&wanted.iter().copied().filter(|key| !found.contains(key)).collect::<Vec<_>>());
                }
            }
            assert!(found.iter().eq(&wanted));
        }
    }
}
