//! Colours of pages in memory, for viewers: a state machine that uses the idle time of a [`Loader`].
//!
//! In: pages by urgency, fetched bytes. Out: colours, one page at a time. Memory: bytes in flight, the colour leaves in
//! use and the scratch memory of decoding, in a share of the loader's budget. The share is set aside because pages fill
//! the rest of the budget. Colours that were handed out belong to the caller and no longer count.

use super::budget::{Budget, Reservation};
use super::directory_loader::{pause_after, short_answer};
use super::fetch::Time;
use super::id_map::IdMap;
use super::index::Index;
use super::loader::Loader;
use super::snapshot::Snapshot;
use crate::archive::{Catalog, ColourEntry, ColourTable};
use crate::frame::PageKey;
use crate::page::{Colours, Occupancy, Page};
use crate::{Error, Result};
use std::ops::Range;
use std::sync::Arc;

/// Most bytes of blocks in one fetch (unless a single block is longer), and most unwanted bytes between two blocks.
const RUN_BYTES: u64 = 64 << 10;
const GAP_BYTES: u64 = 2 << 10;
/// Most bytes of an entry of a colour leaf before compression.
const RAW_ENTRY: usize = 16;
/// Scratch memory of decoding per page and per voxel (bytes).
const PAGE_SCRATCH: usize = 64 << 10;
const VOXEL_SCRATCH: usize = 16;
/// Share of the budget for colours; its least size (bytes), provided that is at most a quarter of the budget; and the
/// size that suffices for a page in which every voxel is occupied.
const SHARE: usize = 8;
const LEAST_SHARE: usize = 512 << 10;
const FULL_SHARE: usize = (4 << 20) + LEAST_SHARE;

/// Loads the colours of pages in memory; see [`Loader::colours`].
///
/// Its owner names the pages that it draws ([`want`](Self::want)), fetches the bytes that [`poll`](Self::poll) returns,
/// passes them to [`given`](Self::given) and takes colours ([`decode`](Self::decode)) until there are no more. Only one
/// fetch is in flight at a time, so that colours never delay geometry for long; [`cancel`](Self::cancel) gives it up.
#[derive(Debug)]
pub struct ColourLoader {
    catalog: Arc<Catalog>,
    index: Arc<Index>,
    budget: Arc<Budget>,
    /// The share that is set aside, in use or not.
    own: Arc<Budget>,
    _share: Option<Reservation>,
    table: Option<ColourTable>,
    leaves: IdMap<usize, Leaf>,
    /// Numbers of the wanted pages, most urgent first.
    wanted: Vec<u32>,
    flight: Option<Flight>,
    here: Option<Here>,
    tries: u32,
    again: Time,
}

#[derive(Debug)]
struct Leaf {
    /// Empty if the leaf is damaged.
    entries: Vec<ColourEntry>,
    _room: Reservation,
}

#[derive(Debug)]
struct Flight {
    range: Range<u64>,
    what: What,
    room: Reservation,
}

#[derive(Debug)]
enum What {
    /// Table that locates the colours of a level.
    Levels,
    Table,
    Leaf(usize),
    Pages(Vec<(u32, ColourEntry)>),
}

/// Blocks to decode, the next one last.
#[derive(Debug)]
struct Here {
    start: u64,
    bytes: Vec<u8>,
    pages: Vec<(u32, ColourEntry)>,
    _room: Reservation,
}

impl Loader {
    /// Returns a loader of colours for the pages that this loader brings, within its budget; `None` until the directory
    /// is loaded, and for an archive or overview level without colours. Reserves an eighth of the budget for colours if
    /// available, so call it before pages fill the budget.
    pub fn colours(&self) -> Option<ColourLoader> {
        let (catalog, index) = (self.shared_catalog()?, self.cache.as_ref()?.index().clone());
        // Inferred voxels have no colours but are counted, so colours cannot be matched to pages without them.
        if catalog.ignores_inferred() {
            return None;
        }
        if catalog.colours_section().is_none() && catalog.level_colours_range().is_none() {
            return None;
        }
        let budget = self.budget().budget();
        let share = self.budget().take((budget / SHARE).max(LEAST_SHARE.min(budget / 4)).min(FULL_SHARE));
        Some(ColourLoader {
            catalog,
            index,
            budget: self.budget().clone(),
            own: Budget::new(share.as_ref().map_or(0, Reservation::bytes)),
            _share: share,
            table: None,
            leaves: IdMap::new(),
            wanted: Vec::new(),
            flight: None,
            here: None,
            tries: 0,
            again: Time::ZERO,
        })
    }
}

impl ColourLoader {
    /// Sets the pages that should get colours, most urgent first, and replaces the previous ones. Unknown pages are
    /// ignored.
    pub fn want(&mut self, keys: impl IntoIterator<Item = PageKey>) {
        let busy = |page: &u32| {
            let under_way = match &self.flight {
                Some(Flight { what: What::Pages(pages), .. }) => &pages[..],
                _ => &[],
            };
            let here = self.here.as_ref().map_or(&[][..], |here| &here.pages);
            under_way.iter().chain(here).any(|(other, _)| other == page)
        };
        self.wanted = keys.into_iter().filter_map(|key| self.index.find(key)).filter(|page| !busy(page)).collect();
    }

    /// Returns whether bytes are in flight.
    pub fn is_fetching(&self) -> bool {
        self.flight.is_some()
    }

    /// Returns when to poll again if only time must pass.
    pub fn retry_at(&self) -> Option<Time> {
        Some(self.again).filter(|again| *again > Time::ZERO && *again < Time::MAX && !self.wanted.is_empty())
    }

    /// Returns the page for which bytes are fetched.
    pub fn most_urgent(&self) -> Option<PageKey> {
        let page = match &self.flight {
            Some(Flight { what: What::Pages(pages), .. }) => pages.first().map(|(page, _)| *page),
            _ => self.wanted.first().copied(),
        };
        page.map(|page| self.index.key(page))
    }

    /// Returns whether [`decode`](Self::decode) has bytes to decode.
    pub fn has_decodable(&self) -> bool {
        self.here.is_some()
    }

    /// Returns the byte range to fetch now; `None` while bytes are in flight or to be decoded, and if no page needs
    /// any.
    pub fn poll(&mut self, now: Time) -> Option<Range<u64>> {
        if self.flight.is_some() || self.here.is_some() || now < self.again {
            return None;
        }
        loop {
            let page = *self.wanted.first()?;
            if let Some(range) = self.catalog.level_colours_range() {
                let bytes = 2 * (range.end - range.start) as usize;
                return self.launch(range, What::Levels, bytes);
            }
            if self.table.is_none() {
                let range = self.catalog.colour_table_range()?;
                let bytes = 2 * (range.end - range.start) as usize;
                return self.launch(range, What::Table, bytes);
            }
            let number = self.catalog.leaf_of(self.index.key(page))?;
            let Some(leaf) = self.leaves.get(&number) else {
                let range = self.table.as_ref()?.leaf_range(number);
                let entries = self.catalog.leaf_entries(number) as usize;
                let bytes = (range.end - range.start) as usize + entries * (RAW_ENTRY + size_of::<ColourEntry>());
                return self.launch(range, What::Leaf(number), bytes);
            };
            let first: u32 = (0..number).map(|before| self.catalog.leaf_entries(before)).sum();
            let run = run(&leaf.entries, first, page, &self.wanted);
            let Some((_, entry)) = run.first() else {
                self.wanted.remove(0);
                continue;
            };
            let range = entry.offset..run.last().map_or(entry.offset, |(_, last)| last.range().end);
            let (what, bytes) = (What::Pages(run), (range.end - range.start) as usize);
            let launched = self.launch(range, what, bytes)?;
            if let Some(Flight { what: What::Pages(pages), .. }) = &self.flight {
                self.wanted.retain(|page| !pages.iter().any(|(other, _)| other == page));
            }
            if !launched.is_empty() {
                return Some(launched);
            }
            // Pages without a colour need no bytes.
            let _ = self.arrived(Vec::new());
            return None;
        }
    }

    /// Records a fetch if the budget has room for its bytes and for what they decode to.
    fn launch(&mut self, range: Range<u64>, what: What, bytes: usize) -> Option<Range<u64>> {
        let room = self.room(bytes)?;
        self.flight = Some(Flight { range: range.clone(), what, room });
        Some(range)
    }

    /// Reserves in the share or else in the whole budget. Drops the leaves if necessary: they are few and can be
    /// fetched again.
    fn room(&mut self, bytes: usize) -> Option<Reservation> {
        let take = |own: &Arc<Budget>, shared: &Arc<Budget>| own.take(bytes).or_else(|| shared.take(bytes));
        take(&self.own, &self.budget).or_else(|| {
            self.leaves = IdMap::new();
            take(&self.own, &self.budget)
        })
    }

    /// Takes the bytes of the fetch. Fails if they break a rule of the format; the colours they describe are then never
    /// loaded.
    pub fn given(&mut self, bytes: Vec<u8>, now: Time) -> Result<()> {
        let Some(flight) = &self.flight else { return Ok(()) };
        if bytes.len() as u64 != flight.range.end - flight.range.start {
            let error = short_answer(&flight.range, bytes.len());
            self.failed(now);
            return Err(error);
        }
        (self.tries, self.again) = (0, Time::ZERO);
        self.arrived(bytes)
    }

    fn arrived(&mut self, bytes: Vec<u8>) -> Result<()> {
        let Some(Flight { range, what, room }) = self.flight.take() else { return Ok(()) };
        match what {
            What::Levels => {
                let catalog = self.catalog.with_level_colours(&bytes);
                self.catalog = Arc::new(catalog.inspect_err(|_| self.again = Time::MAX)?);
            }
            What::Table => {
                let table = self.catalog.decode_colour_table(&bytes);
                self.table = Some(table.inspect_err(|_| self.again = Time::MAX)?);
            }
            What::Leaf(number) => {
                let table = self.table.as_ref().ok_or_else(|| Error::parameter("colours", "they have no table"))?;
                let entries = self.catalog.decode_colour_leaf(table, number, &bytes);
                let (entries, error) =
                    entries.map_or_else(|error| (Vec::new(), Some(error)), |entries| (entries, None));
                let mut room = room;
                let room = room.split(entries.capacity() * size_of::<ColourEntry>());
                self.leaves.insert(number, Leaf { entries, _room: room });
                return error.map_or(Ok(()), Err);
            }
            What::Pages(mut pages) => {
                pages.reverse();
                self.here = Some(Here { start: range.start, bytes, pages, _room: room });
            }
        }
        Ok(())
    }

    /// Records that the fetch failed. The same bytes are requested again after 0.1 s, then 0.2 s and so on up to 6.4 s.
    pub fn failed(&mut self, now: Time) {
        self.cancel();
        self.again = now + pause_after(self.tries);
        self.tries += 1;
    }

    /// Gives up the fetch; its pages stay wanted.
    pub fn cancel(&mut self) {
        if let Some(Flight { what: What::Pages(pages), .. }) = self.flight.take() {
            self.wanted.splice(0..0, pages.into_iter().map(|(page, _)| page));
        }
    }

    /// Decodes the colours of the next page whose bytes have arrived; takes about 0.3 ms. Skips pages that are no longer
    /// in memory. Damage is an error of that page alone. Returns `None` if there is nothing to decode or, while
    /// [`has_decodable`](Self::has_decodable) is true, until the budget has room.
    pub fn decode(&mut self, view: &Snapshot) -> Option<(PageKey, Result<Colours>)> {
        loop {
            let Some(&(number, entry)) = self.here.as_ref()?.pages.last() else {
                self.here = None;
                return None;
            };
            let key = self.index.key(number);
            let page = loaded(view, key);
            let scratch = page.map_or(0, |page| PAGE_SCRATCH + VOXEL_SCRATCH * Occupancy::of(page).len());
            let _room = self.room(scratch)?;
            let here = self.here.as_mut()?;
            here.pages.pop();
            if let Some(page) = page {
                let from = (entry.offset - here.start) as usize;
                let bytes = here.bytes.get(from..from + entry.len as usize).unwrap_or(&[]);
                return Some((key, entry.decode(key, page, bytes)));
            }
        }
    }
}

#[cfg(test)]
impl ColourLoader {
    /// Reserves all that is left of the share.
    pub(super) fn take_rest(&self) -> Reservation {
        self.own.take_rest()
    }
}

fn loaded(view: &Snapshot, key: PageKey) -> Option<&Page> {
    view.column(key.tx, key.ty).iter().find(|slot| slot.layer() == key.layer)?.page()
}

/// Returns the wanted pages around `page` whose blocks lie close together, in order. `entries` begin with page `first`.
/// Empty if the leaf is damaged.
fn run(entries: &[ColourEntry], first: u32, page: u32, wanted: &[u32]) -> Vec<(u32, ColourEntry)> {
    let entry = |page: u32| Some((page, *entries.get(page.checked_sub(first)? as usize)?));
    let Some(middle) = entry(page) else { return Vec::new() };
    let mut near: Vec<_> = wanted.iter().filter_map(|&other| entry(other)).filter(|other| other.0 != page).collect();
    near.sort_unstable_by_key(|other| other.0);
    let above = near.partition_point(|other| other.0 < page);
    let mut run = vec![middle];
    let (mut start, mut end) = (middle.1.offset, middle.1.range().end);
    for other in &near[above..] {
        let range = other.1.range();
        if range.start - end > GAP_BYTES || range.end - start > RUN_BYTES {
            break;
        }
        end = range.end;
        run.push(*other);
    }
    for other in near[..above].iter().rev() {
        let range = other.1.range();
        if start - range.end > GAP_BYTES || end - range.start > RUN_BYTES {
            break;
        }
        start = range.start;
        run.insert(0, *other);
    }
    run
}

#[cfg(test)]
mod tests {
    use super::super::{LoaderOptions, Next, Prefetch, Step, Stream, StreamOptions};
    use super::*;
    use crate::archive::{Archive, ArchiveWriter, ColourReader, EncodedColours, PageEncoder, Totals};
    use crate::codec::ColourEncoder;
    use crate::colour::{ColourPlan, ColourScale};
    use crate::frame::Frame;
    use crate::page::{PageBuilder, Span};
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

    #[test]
    fn colours_come_as_a_reader_reads_them_the_most_urgent_first() {
        let bytes = archive(false);
        let mut reader = ColourReader::new(&Archive::from_bytes(bytes.clone()).unwrap()).unwrap().unwrap();
        let loader = whole(&bytes, 64 << 20);
        let view = loader.snapshot().unwrap();
        let mut colours = loader.colours().unwrap();
        assert_eq!(colours.poll(Time::ZERO), None, "nothing is wanted");
        let mut wanted = keys(&Archive::from_bytes(bytes.clone()).unwrap());
        wanted.rotate_left(17);
        colours.want(wanted.iter().copied().chain([PageKey { tx: 99, ty: 0, layer: 0 }]));
        let (mut found, mut fetches) = (Vec::new(), 0);
        loop {
            let range = colours.poll(Time::ZERO);
            if let Some(range) = range.clone() {
                assert_eq!(colours.poll(Time::ZERO), None, "one fetch at a time");
                fetches += 1;
                if fetches == 3 {
                    colours.cancel();
                    assert_eq!(colours.poll(Time::ZERO), Some(range.clone()));
                    colours.failed(Time::ZERO);
                    assert_eq!(colours.poll(Time::ZERO), None);
                    assert_eq!(colours.poll(colours.retry_at().unwrap()), Some(range.clone()));
                }
                colours.given(bytes[range.start as usize..range.end as usize].to_vec(), Time::ZERO).unwrap();
            }
            let mut count = 0;
            while let Some((key, colours)) = colours.decode(&view) {
                let page = loaded(&view, key).unwrap();
                assert_eq!(colours.unwrap(), reader.colours_of(key, page).unwrap());
                found.push(key);
                count += 1;
            }
            if range.is_none() && count == 0 {
                break;
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
        let loader = whole_of(&level, &bytes, 64 << 20);
        let view = loader.snapshot().unwrap();
        for damage in [None, Some(table.start), Some(table.end - 1)] {
            let mut damaged = bytes.clone();
            damage.into_iter().for_each(|at| damaged[at as usize] ^= 1);
            let mut colours = loader.colours().unwrap();
            colours.want(keys(&level));
            let (mut found, mut errors, mut fetched) = (0, Vec::new(), 0);
            while let Some(range) = colours.poll(Time::ZERO) {
                assert_eq!(fetched == 0, range == table, "the table comes first");
                fetched += 1;
                let bytes = damaged[range.start as usize..range.end as usize].to_vec();
                errors.extend(colours.given(bytes, Time::ZERO).err());
                while let Some((key, colours)) = colours.decode(&view) {
                    let expected = reader.colours_of(key, loaded(&view, key).unwrap()).unwrap();
                    assert!(expected.count() > 0);
                    assert_eq!(colours.unwrap(), expected);
                    found += 1;
                }
            }
            match damage {
                None => assert_eq!((found, errors.len(), fetched), (3, 0, 4)),
                Some(_) => {
                    assert_eq!((found, errors.len(), fetched), (0, 1, 1));
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
        let loader = whole(&bytes, 64 << 20);
        let rest = loader.counters().budget_bytes - loader.counters().used_bytes;
        let taken = loader.budget().take(rest);
        let mut colours = loader.colours().unwrap();
        colours.want(all.iter().copied());
        assert_eq!(colours.poll(Time::ZERO), None);
        drop(taken);
        assert!(colours.poll(Time::ZERO).is_some());
        // Every bit of the table, of the leaf and of a block.
        let (view, catalog) = (loader.snapshot().unwrap(), archive_of(&bytes));
        let section = catalog.catalog().colours_section().unwrap();
        for byte in section.clone().step_by(((section.end - section.start) / 60) as usize).chain([section.end - 1]) {
            let mut damaged = bytes.clone();
            damaged[byte as usize] ^= 0x10;
            let mut colours = loader.colours().unwrap();
            colours.want(all.iter().copied());
            let mut errors = Vec::new();
            for _ in 0..200 {
                if let Some(range) = colours.poll(Time::ZERO) {
                    let part = damaged[range.start as usize..range.end as usize].to_vec();
                    errors.extend(colours.given(part, Time::ZERO).err());
                }
                while let Some((_, colours)) = colours.decode(&view) {
                    errors.extend(colours.err());
                }
            }
            assert_eq!(errors.len(), 1, "byte {byte}");
            assert!(matches!(&errors[0], Error::Format { rule, .. } if rule.starts_with('K')), "{}", errors[0]);
            assert_eq!((colours.poll(Time::ZERO), colours.is_fetching()), (None, false));
        }
    }

    #[test]
    fn colours_come_while_pages_fill_the_budget_and_no_thread_spins() {
        let bytes = archive(false);
        let all = keys(&Archive::from_bytes(bytes.clone()).unwrap());
        for budget in [1100 << 10, 1400 << 10, 2 << 20] {
            for prefetch in [Prefetch::Manual, Prefetch::Thread] {
                let options = StreamOptions { prefetch, ..StreamOptions::new(budget) };
                let stream = Stream::open(Archive::from_bytes(bytes.clone()).unwrap(), options).unwrap();
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
            pawn.hint(&super::super::MotionHint::walking(low, high, nalgebra::Vector3::zeros()));
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
