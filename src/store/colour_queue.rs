//! Colours that a loader brings: the pages that want some, the bytes to fetch next, and colours to be taken.
//!
//! A page stays wanted until its colours have come; a fetch that fails or is given up changes nothing. So that none is
//! fetched twice, the loader has one fetch of colours out at a time, and begins the next one when all that came is
//! taken.
//!
//! Memory: one reservation of the loader's budget covers the leaves in use and either a fetch with what it decodes to,
//! or the colours to be taken. It begins with a share of the budget and grows if a single page needs more.

use super::budget::{Budget, Reservation};
use super::cache::Snapshots;
use super::fetch::{Retry, Time};
use super::id_map::IdMap;
use super::index::Index;
use super::snapshot::Snapshot;
use crate::archive::{Catalog, ColourEntry, ColourTable, joined};
use crate::frame::PageKey;
use crate::page::{Colours, Page};
use crate::sort::sort_by_key;
use crate::{Error, Result};
use std::collections::{HashSet, VecDeque};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// Most pages of a fetch, most bytes of their blocks (unless a single block is longer), and most unwanted bytes between
/// two blocks.
const RUN_PAGES: usize = 16;
const RUN_BYTES: u64 = 64 << 10;
const GAP_BYTES: u64 = 2 << 10;
/// Most pages considered for a fetch.
const NEAR: usize = 1 << 10;
/// Most bytes of an entry of a colour leaf before compression.
const RAW_ENTRY: usize = 16;
/// Memory of colours per page and per voxel, and what decoding takes besides (bytes).
const PAGE_BYTES: usize = 48 << 10;
const VOXEL_BYTES: usize = 4;
const PAGE_SCRATCH: usize = 16 << 10;
const VOXEL_SCRATCH: usize = 12;
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
    table: Option<ColourTable>,
    /// Entries of leaves in use; none if the leaf is damaged.
    leaves: IdMap<usize, Vec<ColourEntry>>,
    /// Wanted pages of the archive, the most urgent one last.
    pub(super) wanted: Vec<PageKey>,
    /// Colours to be taken.
    pub(super) ready: VecDeque<(PageKey, Result<Colours>)>,
    share: usize,
    room: Reservation,
    lacks_room: bool,
    retry: Retry,
}

/// Bytes of colours for one fetch.
#[derive(Debug)]
pub(super) struct ColourRun {
    /// The most urgent page.
    key: PageKey,
    /// Blocks of pages; `None` for the table or leaf that comes next on the way to that of `key`.
    pub blocks: Option<Blocks>,
}

type Blocks = Vec<(PageKey, ColourEntry)>;

impl ColourQueue {
    /// Creates the queue of an archive; `None` if it has no colours for the pages of its loader. Inferred voxels have no
    /// colours but are counted, so colours cannot be matched to pages without them.
    pub fn new(catalog: &Arc<Catalog>, budget: &Arc<Budget>) -> Option<Self> {
        if catalog.ignores_inferred() || catalog.colours_section().or(catalog.level_colours_range()).is_none() {
            return None;
        }
        let whole = budget.budget();
        Some(Self {
            catalog: catalog.clone(),
            table: None,
            leaves: IdMap::new(),
            wanted: Vec::new(),
            ready: VecDeque::new(),
            share: (whole / SHARE).max(LEAST_SHARE.min(whole / 4)).min(FULL_SHARE),
            room: budget.take(0)?,
            lacks_room: false,
            retry: Retry::default(),
        })
    }

    /// Replaces the wanted pages, most urgent first. Pages whose colours are to be taken are no longer wanted.
    pub fn want(&mut self, keys: &[PageKey], index: &Index) {
        let has_come = |key: &PageKey| self.ready.iter().any(|(other, made)| other == key && made.is_ok());
        let mut seen = HashSet::new();
        let is_new = |key: &PageKey| index.find(*key).is_some_and(|page| seen.insert(page));
        self.wanted = keys.iter().copied().filter(is_new).filter(|key| !has_come(key)).collect();
        self.wanted.reverse();
    }

    /// Returns whether a run brings something that is wanted.
    pub fn wants(&self, run: &ColourRun) -> bool {
        run.blocks
            .as_ref()
            .map_or(!self.wanted.is_empty(), |blocks| blocks.iter().any(|(key, _)| self.wanted.contains(key)))
    }

    /// Returns when to ask again if only time must pass.
    pub fn again(&self, now: Time) -> Option<Time> {
        let room = self.lacks_room.then(|| now + ROOM_AGAIN);
        let times = [self.retry.at(), room].into_iter().flatten();
        times.filter(|again| *again > now && !self.wanted.is_empty()).min()
    }

    pub fn take(&mut self) -> Option<(PageKey, Result<Colours>)> {
        self.ready.pop_front()
    }

    /// Returns the bytes to fetch now; `None` while there are colours to be taken or no room, and if no page needs bytes.
    /// Pages that are not in memory get no colours. The caller ensures that no run is out.
    pub fn claim(
        &mut self,
        snapshots: &Snapshots,
        now: Time,
        make_room: &mut dyn FnMut(usize) -> Option<Reservation>,
    ) -> Option<(Range<u64>, ColourRun)> {
        self.lacks_room = false;
        while self.ready.is_empty() && self.retry.is_due(now) {
            let key = *self.wanted.last()?;
            let leaf = self.catalog.leaf_of(key)?;
            let of_level = self.catalog.level_colours_range();
            let (blocks, range, bytes) = if of_level.is_some() || self.table.is_none() {
                let range = of_level.or_else(|| self.catalog.colour_table_range())?;
                let bytes = 2 * (range.end - range.start) as usize;
                (None, range, bytes)
            } else if let Some(entries) = self.leaves.get(&leaf) {
                let Some((blocks, range, bytes)) = self.blocks(entries, leaf, snapshots) else {
                    self.wanted.pop();
                    continue;
                };
                (Some(blocks), range, bytes)
            } else {
                let range = self.table.as_ref()?.leaf_range(leaf);
                let entries = self.catalog.leaf_entries(leaf) as usize;
                let bytes = (range.end - range.start) as usize + entries * (RAW_ENTRY + size_of::<ColourEntry>());
                (None, range, bytes)
            };
            if !self.reserve(bytes, make_room) {
                self.lacks_room = true;
                return None;
            }
            let run = ColourRun { key, blocks };
            if !range.is_empty() {
                return Some((range, run));
            }
            // Pages without a colour need no bytes.
            let blocks = run.blocks.as_deref().unwrap_or_default();
            self.loaded(&run, decode_blocks(&snapshots.newest(), blocks, range.start, &[]));
        }
        None
    }

    /// Makes the reservation cover `bytes` for a run. Drops the leaves if necessary: they are few and can be fetched
    /// again.
    fn reserve(&mut self, bytes: usize, make_room: &mut dyn FnMut(usize) -> Option<Reservation>) -> bool {
        if self.leaf_bytes() + bytes > self.room.bytes() {
            self.leaves = IdMap::new();
        }
        let lacks = |bytes: usize| bytes.saturating_sub(self.room.bytes());
        if lacks(bytes) > 0 {
            let Some(more) = make_room(lacks(bytes.max(self.share))).or_else(|| make_room(lacks(bytes))) else {
                return false;
            };
            self.room.join(more);
        }
        true
    }

    fn leaf_bytes(&self) -> usize {
        self.leaves.values().map(|entries| entries.capacity() * size_of::<ColourEntry>()).sum()
    }

    /// Returns the blocks of the most urgent page and of wanted pages close to it, their bytes, and the memory to bring
    /// them. `entries` are those of its leaf. `None` if the page is not in memory or the leaf is damaged.
    fn blocks(
        &self,
        entries: &[ColourEntry],
        leaf: usize,
        snapshots: &Snapshots,
    ) -> Option<(Blocks, Range<u64>, usize)> {
        let first: u32 = (0..leaf).map(|before| self.catalog.leaf_entries(before)).sum();
        let view = snapshots.newest();
        let block = |key: &PageKey| {
            let entry = entries.get(snapshots.index.find(*key)?.checked_sub(first)? as usize)?;
            Some((*key, *entry, loaded(&view, *key)?.voxel_counts().0 as usize))
        };
        let middle = block(self.wanted.last()?)?;
        let mut near: Vec<_> = self.wanted.iter().rev().skip(1).take(NEAR).filter_map(block).collect();
        sort_by_key(&mut near, |other| (other.1.offset.abs_diff(middle.1.offset), other.0));
        let free = self.room.bytes().saturating_sub(self.leaf_bytes());
        let (mut run, mut range, mut colours, mut most, mut bytes) = (Vec::new(), middle.1.range(), 0, 0, 0);
        for (key, entry, voxels) in std::iter::once(middle).chain(near) {
            let Some(whole) =
                joined(&range, &entry.range(), GAP_BYTES, RUN_BYTES).or(run.is_empty().then(|| range.clone()))
            else {
                continue;
            };
            // Colours of all pages, and the memory of decoding those of most voxels.
            let (all, largest) = (colours + PAGE_BYTES + VOXEL_BYTES * voxels, most.max(voxels));
            let need = (whole.end - whole.start) as usize + all + PAGE_SCRATCH + VOXEL_SCRATCH * largest;
            if run.is_empty() || need <= free && run.len() < RUN_PAGES {
                (range, colours, most, bytes) = (whole, all, largest, need);
                run.push((key, entry));
            }
        }
        Some((run, range, bytes))
    }

    /// Takes the bytes of a table or leaf. Colours that damaged bytes describe are never loaded.
    pub fn arrived(&mut self, run: &ColourRun, bytes: &[u8], now: Time) {
        self.retry = Retry::default();
        let taken = match (&self.table, self.catalog.leaf_of(run.key)) {
            _ if self.catalog.level_colours_range().is_some() => {
                self.catalog.with_level_colours(bytes).map(|catalog| self.catalog = Arc::new(catalog))
            }
            (Some(table), Some(leaf)) => {
                let entries = self.catalog.decode_colour_leaf(table, leaf, bytes).unwrap_or_else(|error| {
                    self.ready.push_back((run.key, Err(error)));
                    Vec::new()
                });
                self.leaves.insert(leaf, entries);
                Ok(())
            }
            _ => self.catalog.decode_colour_table(bytes).map(|table| self.table = Some(table)),
        };
        if let Err(error) = taken {
            self.failed(run, error, now);
        }
    }

    /// Takes the decoded colours of a run. Its pages that left memory meanwhile get none.
    pub fn loaded(&mut self, run: &ColourRun, made: Vec<(PageKey, Result<Colours>)>) {
        self.retry = Retry::default();
        self.wanted.retain(|key| !run.blocks.iter().flatten().any(|(other, _)| other == key));
        self.ready.extend(made);
    }

    /// Notes that a run failed, and reports it with the most urgent page.
    pub fn failed(&mut self, run: &ColourRun, error: Error, now: Time) {
        self.retry.failed(&error, now);
        self.ready.push_back((run.key, Err(error)));
    }
}

/// Decodes blocks of pages that are still in memory, from bytes that begin at offset `start` of the archive. Damage is an
/// error of its page alone.
pub(super) fn decode_blocks(
    view: &Snapshot,
    blocks: &[(PageKey, ColourEntry)],
    start: u64,
    bytes: &[u8],
) -> Vec<(PageKey, Result<Colours>)> {
    let decode = |(key, entry): &(PageKey, ColourEntry)| {
        let from = (entry.offset - start) as usize;
        let own = bytes.get(from..from + entry.len as usize).unwrap_or(&[]);
        Some((*key, entry.decode(*key, loaded(view, *key)?, own)))
    };
    blocks.iter().filter_map(decode).collect()
}

fn loaded(view: &Snapshot, key: PageKey) -> Option<&Page> {
    view.column(key.tx, key.ty).iter().find(|slot| slot.layer() == key.layer)?.page()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{archive, keys, written};
    use super::super::{
        Fetch, Loader, LoaderOptions, MotionHint, Next, Payload, Prefetch, Step, Stream, StreamOptions,
    };
    use super::*;
    use crate::archive::{Archive, ColourReader};
    use crate::page::{PageBuilder, Span};

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

    fn taken(loader: &mut Loader) -> Vec<(PageKey, Result<Colours>)> {
        std::iter::from_fn(|| loader.take_colours()).collect()
    }

    fn taken_of(stream: &Stream) -> Vec<(PageKey, Result<Colours>)> {
        std::iter::from_fn(|| stream.take_colours()).collect()
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
                    let failed = taken(&mut loader);
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
            let taken = taken(&mut loader);
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
                for (key, colours) in taken(&mut loader) {
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
    #[ignore = "slow: .ci/run"]
    fn a_budget_without_room_and_damage_keep_colours_away_and_nothing_else() {
        let bytes = archive(false);
        let archive_of = |bytes: &[u8]| Archive::from_bytes(bytes.to_vec()).unwrap();
        let all = keys(&archive_of(&bytes));
        let mut loader = whole(&bytes, 64 << 20);
        // The pages are needed now, so none is evicted for colours.
        let body = loader.body();
        let (low, high) = ([0.1, 0.1, 0.1].into(), [38.0, 9.5, 1.0].into());
        loader.hint(body, &MotionHint::walking(low, high, nalgebra::Vector3::zeros()));
        let rest = loader.budget().take_rest();
        loader.want_colours(&all);
        assert_eq!(asked(&mut loader, Time::ZERO), None);
        assert!(matches!(loader.poll(Time::ZERO).unwrap(), Next::Wait(Some(_))), "it looks for room again");
        drop(rest);
        assert!(asked(&mut loader, Time::ZERO).is_some());
        let mut loader = whole(&bytes, 64 << 20);
        // Every bit of the table, of the leaf and of a block.
        let catalog = archive_of(&bytes);
        let section = catalog.catalog().colours_section().unwrap();
        for byte in section.clone().step_by(((section.end - section.start) / 60) as usize).chain([section.end - 1]) {
            let mut damaged = bytes.clone();
            damaged[byte as usize] ^= 0x10;
            let (catalog, budget) = (catalog.catalog().clone().into(), loader.budget().clone());
            loader.colours = ColourQueue::new(&catalog, &budget).map(Box::new);
            loader.want_colours(&all);
            let mut errors = Vec::new();
            for _ in 0..200 {
                if let Some(fetch) = asked(&mut loader, Time::ZERO) {
                    give(&mut loader, &damaged, &fetch);
                }
                errors.extend(taken(&mut loader).into_iter().filter_map(|(_, colours)| colours.err()));
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
    fn a_retry_that_has_passed_does_not_hide_that_room_is_looked_for_again() {
        let bytes = archive(false);
        let mut loader = whole(&bytes, 64 << 20);
        loader.want_colours(&keys(&Archive::from_bytes(bytes).unwrap()));
        let colours = loader.colours.as_mut().unwrap();
        let ms = Duration::from_millis;
        assert_eq!(colours.again(ms(0)), None);
        colours.retry.failed(&Error::io("link", "read", std::io::ErrorKind::TimedOut.into()), ms(0));
        assert_eq!((colours.again(ms(50)), colours.again(ms(150))), (Some(ms(100)), None));
        colours.lacks_room = true;
        assert_eq!(colours.again(ms(150)), Some(ms(250)));
    }

    #[test]
    fn without_a_wish_no_byte_of_colours_is_read() {
        let bytes = archive(true);
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        let section = archive.catalog().colours_section().unwrap();
        let mut damaged = bytes.clone();
        damaged[section.start as usize..section.end as usize].fill(0x55);
        let loader = whole_of(&archive, &damaged, 64 << 20);
        assert_eq!(loader.colours.as_ref().unwrap().room.bytes(), 0);
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
                    found += taken_of(&stream).into_iter().filter(|(_, colours)| colours.is_ok()).count();
                }
                assert!(stream.counters().peak_bytes <= budget);
            }
        }
        // Without memory for a share there is nothing to do until the budget has room.
        let options = StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(64 << 20) };
        let stream = Stream::open(Archive::from_bytes(bytes.clone()).unwrap(), options).unwrap();
        let mut pawn = stream.pawn();
        let (low, high) = ([0.1, 0.1, 0.1].into(), [38.0, 9.5, 1.0].into());
        pawn.hint(&MotionHint::walking(low, high, nalgebra::Vector3::zeros()));
        while stream.step() != Step::Idle {}
        let taken = stream.fill_the_budget();
        stream.want_colours(&all);
        assert_eq!((stream.step(), stream.step(), taken_of(&stream).len()), (Step::Idle, Step::Idle, 0));
        drop(taken);
        assert_eq!(stream.step(), Step::Coloured);
        // All pages are there, so nothing is left to settle, whatever colours are left to read.
        let colours = (0..40).map(|_| (stream.settle(Duration::MAX), taken_of(&stream).len()));
        assert_eq!(colours.fold((true, 0), |sum, more| (sum.0 && more.0, sum.1 + more.1)), (true, all.len()));
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
                let taken = taken_of(&stream);
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
    #[test]
    fn colours_take_memory_from_pages_but_not_from_those_that_are_waited_for() {
        let bytes = archive(false);
        let all = keys(&Archive::from_bytes(bytes.clone()).unwrap());
        let budget = 512 << 10;
        let mut loader = whole(&bytes, budget);
        let full = loader.counters();
        assert!(full.resident_pages < all.len() && full.evicted == 0, "{full:?}");
        let view = loader.snapshot().unwrap();
        let resident: Vec<_> = all.iter().copied().filter(|key| loaded(&view, *key).is_some()).collect();
        drop(view);
        // One of them is waited for, with a page that cannot come while its fetch is unanswered.
        let absent = all.iter().copied().find(|key| !resident.contains(key)).unwrap();
        let nearest = resident[resident.len() - 1];
        let request = loader.request(&[nearest, absent], nearest);
        let Next::Fetch(page) = loader.poll(Time::ZERO).unwrap() else { panic!("no page") };
        let before = loader.counters();
        loader.want_colours(&resident);
        assert_eq!(loader.colour_turn(Time::ZERO).map(|fetch| fetch.what), Some(Payload::Colours));
        assert!(loader.counters().evicted > before.evicted);
        assert_eq!(loader.snapshot().unwrap().is_loaded(nearest), Some(true));
        give(&mut loader, &bytes, &page);
        assert!(matches!(loader.poll(Time::ZERO).unwrap(), Next::Wait(_)));
        assert_eq!(loader.outcome(request).unwrap().unwrap().left_out, 0);
        assert!(loader.counters().peak_bytes <= budget);
    }

    #[test]
    fn colours_of_every_leaf_are_those_of_their_pages() {
        // A row of more pages than a leaf holds, of one voxel each.
        let mut page = PageBuilder::default();
        assert!(page.set_column(7, 9, &[Span::new(0, 100, false).unwrap()]));
        let pages: Vec<_> = (0..4100).map(|tx| (PageKey { tx, ty: 0, layer: 0 }, page.build())).collect();
        let bytes = written(&pages, false, Some(&|number: usize, _: usize| Some([number as u16, 257, 514])));
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        assert_eq!(archive.catalog().leaf_count(), 2);
        let mut reader = ColourReader::new(&archive).unwrap().unwrap();
        let all = keys(&archive);
        let wanted = [all[4099], all[0], all[4095], all[4096]];
        let mut loader = whole(&bytes, 64 << 20);
        let view = loader.snapshot().unwrap();
        loader.want_colours(&wanted);
        let mut found = Vec::new();
        while let Some(fetch) = asked(&mut loader, Time::ZERO) {
            give(&mut loader, &bytes, &fetch);
            for (key, colours) in taken(&mut loader) {
                assert_eq!(colours.unwrap(), reader.colours_of(key, loaded(&view, key).unwrap()).unwrap());
                found.push(key);
            }
        }
        found.sort_unstable();
        let mut wanted = wanted.to_vec();
        wanted.sort_unstable();
        assert_eq!(found, wanted);
    }
}
