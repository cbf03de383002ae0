//! Pages in memory: chooses the next read, evicts pages for it, and updates the snapshot.
//!
//! A run of pages is claimed together with a reservation of the memory that it will take, and settled when it is
//! decoded. Memory is reserved before a read, so the budget holds at every moment. It covers the table of pages, pages
//! in memory, pages that snapshots still hold, bytes in flight, and the scratch memory of decoding.

use super::budget::{Budget, Reservation};
use super::counters::Counters;
use super::fetch::{PageError, Retry, Time, Turn};
use super::index::Index;
use super::motion_hint::{MotionHint, distance};
use super::publish::{Current, Retired};
use super::snapshot::{Edited, Held, Slots, Snapshot};
use crate::archive::{PageDecoder, PageEntry, Storage, joined};
use crate::frame::PageKey;
use crate::page::Page;
use crate::sort::{sort, sort_by, sort_by_key};
use crate::{Error, Result};
use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::sync::{Arc, Weak};

/// Most unwanted bytes that a run may read between two wanted pages.
const GAP: u64 = 16 << 10;
/// Pages considered in each direction for a run.
const NEIGHBOURS: u32 = 64;

#[derive(Debug)]
struct Resident {
    held: Arc<Held>,
    /// Pages whose slots hold it; several if they share its content.
    pages: Vec<u32>,
    /// True once a body touched it.
    touched: bool,
}

/// Requested pages, most urgent first, with the time until they are needed (s).
#[derive(Debug, Default)]
pub(super) struct Order {
    pub pages: Vec<(f32, u32)>,
    times: HashMap<u32, f32>,
    /// Number of `pages` that are finished, and when those of them that failed may be tried again.
    done: usize,
    pub again: Option<Time>,
    /// Requested by a waiting caller, not by a hint.
    explicit: bool,
    focus: Vec<PageKey>,
}

impl Order {
    /// Creates the order of all hints: by time, then by key.
    pub fn hinted(times: HashMap<u32, f32>, focus: Vec<PageKey>) -> Self {
        let mut pages: Vec<_> = times.iter().map(|(&page, &time)| (time, page)).collect();
        sort_by(&mut pages, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Self { pages, times, done: 0, again: None, explicit: false, focus }
    }

    /// Creates the order of a waiting caller: nearest to `around` first.
    pub fn explicit(index: &Index, keys: &[PageKey], around: PageKey) -> Self {
        let times: HashMap<u32, f32> = keys.iter().filter_map(|key| Some((index.find(*key)?, 0.0))).collect();
        let mut pages: Vec<_> = times.iter().map(|(&page, &time)| (time, page)).collect();
        sort_by_key(&mut pages, |&(_, page)| (distance(index.key(page), &[around]), page));
        Self { pages, times, done: 0, again: None, explicit: true, focus: vec![around] }
    }

    /// Considers all pages again.
    pub fn restart(&mut self) {
        (self.done, self.again) = (0, None);
    }

    pub fn wants(&self, page: u32) -> bool {
        self.times.contains_key(&page)
    }
}

/// A run of pages for one read.
#[derive(Debug)]
pub(super) struct PageRun {
    /// Contents to decode, each with the page that shows it.
    pub contents: Vec<(u32, u32)>,
    pub needed_in: f32,
    room: Reservation,
}

/// An order, and the test for pages that it must leave in memory for others.
type Wants<'a> = (&'a Order, &'a dyn Fn(u32) -> bool);

/// Access to the newest snapshot for any number of readers on any threads, which never wait.
#[derive(Clone)]
pub struct Snapshots {
    pub(super) index: Arc<Index>,
    pub(super) current: Arc<Current<Slots>>,
    pub(super) edited: Option<Arc<Edited>>,
}

impl Snapshots {
    /// Returns the pages in memory now. Lock-free; allocates nothing.
    #[inline]
    pub fn newest(&self) -> Snapshot {
        Snapshot::new(self.index.table().clone(), self.current.get()).with_edited(self.edited.clone())
    }

    /// Returns the pages that a body touches before it moves; empty if the motion_hint is invalid.
    pub fn keys_around(&self, motion_hint: &MotionHint) -> Vec<PageKey> {
        let mut times = HashMap::new();
        if motion_hint.is_valid() {
            motion_hint.wants(&self.index, 0.0, &mut times);
        }
        let mut keys: Vec<_> = times.keys().map(|&page| self.index.key(page)).collect();
        sort(&mut keys);
        keys
    }
}

impl std::fmt::Debug for Snapshots {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Snapshots").field("pages", &self.index.len()).finish_non_exhaustive()
    }
}

#[derive(Debug)]
pub(super) struct Cache {
    pub snapshots: Snapshots,
    budget: Arc<Budget>,
    _table: Reservation,
    slots: Arc<Slots>,
    retired: Retired<Slots>,
    resident: HashMap<u32, Resident>,
    /// Bytes of the resident pages.
    weight: usize,
    /// Evicted pages that snapshots may still hold, and their bytes.
    evicted: Vec<(Weak<Held>, usize)>,
    in_flight: HashSet<u32>,
    /// Contents that could not be loaded. They are read one at a time, since a single one of a run may be the cause.
    failed: HashMap<u32, Retry>,
    /// Pages that the hints want, and the positions of the bodies, as of the last plan.
    times: HashMap<u32, f32>,
    focus: Vec<PageKey>,
    /// Contents that may be evicted, the next one last, each with the time until it is needed (s); from the last plan.
    victims: Option<Vec<(f32, u32)>>,
    longest_run: u64,
}

impl Cache {
    pub fn new(index: Arc<Index>, table: Reservation, budget: Arc<Budget>, run_bytes: usize) -> Self {
        let slots = Arc::new(index.empty_slots());
        let longest_run = run_bytes.min(budget.budget() / 8) as u64;
        let snapshots = Snapshots { index, current: Arc::new(Current::new(slots.clone())), edited: None };
        Self {
            snapshots,
            budget,
            _table: table,
            slots,
            retired: Retired::default(),
            resident: HashMap::new(),
            weight: 0,
            evicted: Vec::new(),
            in_flight: HashSet::new(),
            failed: HashMap::new(),
            times: HashMap::new(),
            focus: Vec::new(),
            victims: None,
            longest_run,
        }
    }

    pub fn index(&self) -> &Arc<Index> {
        &self.snapshots.index
    }

    /// Adopts the pages that the hints want now.
    pub fn replan(&mut self, order: &Order, counters: &mut Counters) {
        for (&page, &time) in &order.times {
            match self.resident.get_mut(&self.snapshots.index.content(page)) {
                Some(resident) => resident.touched |= time <= 0.0,
                None => counters.requested += u64::from(!self.times.contains_key(&page)),
            }
        }
        self.times.clone_from(&order.times);
        self.focus.clone_from(&order.focus);
        self.victims = None;
    }

    /// Claims the most urgent pages of `order` that are not in memory. Does not evict pages for which `stays` returns
    /// true, nor those that are needed now.
    pub fn claim(
        &mut self,
        order: &mut Order,
        stays: &dyn Fn(u32) -> bool,
        now: Time,
        counters: &mut Counters,
    ) -> Turn<(Range<u64>, PageRun)> {
        let (mut attached, mut busy, mut cursor) = (Vec::new(), false, order.done);
        let mut claim = Turn::Idle;
        while let Some(&(time, page)) = order.pages.get(cursor) {
            cursor += 1;
            let content = self.snapshots.index.content(page);
            if let Some(resident) = self.resident.get_mut(&content) {
                if !resident.pages.contains(&page) {
                    resident.pages.push(page);
                    attached.push((page, Some(resident.held.clone())));
                }
            } else if self.in_flight.contains(&content) {
                busy = true;
            } else if order.explicit || self.may_try(content, now) {
                match self.claim_run((order, stays), time, page, counters) {
                    // A uniform page needs no bytes and is in memory already.
                    Turn::Idle => continue,
                    other => claim = other,
                }
                break;
            } else if let Some(again) = self.failed.get(&content).and_then(Retry::at) {
                order.again = Some(order.again.map_or(again, |least| least.min(again)));
            }
            if !busy {
                order.done = cursor;
            }
        }
        if !attached.is_empty() {
            self.publish(attached);
        }
        match claim {
            Turn::Idle if busy => Turn::Busy,
            claim => claim,
        }
    }

    /// Claims `page` and wanted pages near it in the file; returns [`Turn::Idle`] if it needed no bytes.
    fn claim_run(
        &mut self,
        wants: Wants,
        time: f32,
        page: u32,
        counters: &mut Counters,
    ) -> Turn<(Range<u64>, PageRun)> {
        let order = wants.0;
        let content = self.snapshots.index.content(page);
        let (mut bytes, mut contents) = self.run_around(order, content);
        contents[0].1 = page;
        let mut room = self.make_room(wants, time, self.need(&bytes, &contents), counters);
        if room.is_none() && contents.len() > 1 {
            contents.truncate(1);
            bytes = self.index().entry(content).bytes();
            room = self.make_room(wants, time, self.need(&bytes, &contents), counters);
        }
        let Some(room) = room else {
            counters.no_room += 1;
            return Turn::NoRoom(self.retired.len() > 0);
        };
        self.in_flight.extend(contents.iter().map(|(content, _)| *content));
        if !order.explicit {
            let late = contents.iter().filter(|(_, page)| order.times.get(page).is_some_and(|time| *time <= 0.0));
            counters.late += late.count() as u64;
        }
        let run = PageRun { contents, needed_in: time, room };
        if bytes.is_empty() {
            let page = PageDecoder::new().decode(self.snapshots.index.entry(content), &[]);
            // A uniform page is fully described by the directory, so decoding cannot fail.
            self.settle(run, vec![page], counters);
            return Turn::Idle;
        }
        Turn::Fetch((bytes, run))
    }

    /// Returns the memory for a run: its bytes, its pages, and the scratch memory of decoding them in turn.
    fn need(&self, bytes: &Range<u64>, contents: &[(u32, u32)]) -> usize {
        let entries = || contents.iter().map(|&(content, _)| self.snapshots.index.entry(content));
        // To drop its inferred spans, a page is built a second time.
        let ignores_inferred = self.snapshots.index.ignores_inferred();
        let whole = |entry: &PageEntry| if ignores_inferred { entry.weight_bytes() } else { 0 };
        let decoding = |entry: &PageEntry| PageDecoder::scratch_bytes(entry.size, ignores_inferred);
        let scratch = entries().map(|entry| decoding(entry) + whole(entry)).max().unwrap_or(0);
        (bytes.end - bytes.start) as usize + scratch + entries().map(|entry| entry.weight_bytes()).sum::<usize>()
    }

    /// Returns the budget in which all pages of `order` fit at once (bytes).
    pub fn needed_bytes(&self, order: &Order) -> usize {
        let contents: HashSet<u32> = order.pages.iter().map(|&(_, page)| self.snapshots.index.content(page)).collect();
        let weight = |content: &u32| self.snapshots.index.entry(*content).weight_bytes();
        let pages: usize = contents.iter().map(weight).sum();
        let read =
            |content: &u32| self.need(&self.index().entry(*content).bytes(), &[(*content, *content)]) - weight(content);
        self._table.bytes() + pages + contents.iter().map(read).max().unwrap_or(0)
    }

    /// Returns the byte range around `content` that covers wanted neighbours, and the contents to decode from it.
    fn run_around(&self, order: &Order, content: u32) -> (Range<u64>, Vec<(u32, u32)>) {
        let index = &self.snapshots.index;
        let (mut contents, mut bytes) = (vec![(content, content)], index.entry(content).bytes());
        if bytes.is_empty() || self.failed.contains_key(&content) {
            return (bytes, contents);
        }
        let mut extend = |page: u32| {
            if !matches!(index.entry(page).storage, Storage::Stored(_)) {
                return true;
            }
            let Some(whole) = joined(&bytes, &index.entry(page).bytes(), GAP, self.longest_run) else { return false };
            let absent = !self.resident.contains_key(&page) && !self.in_flight.contains(&page);
            if absent && order.wants(page) && !self.failed.contains_key(&page) {
                bytes = whole;
                contents.push((page, page));
            }
            true
        };
        let end = (content + 1).saturating_add(NEIGHBOURS).min(index.len() as u32);
        let _ = (content + 1..end).all(&mut extend);
        let _ = (content.saturating_sub(NEIGHBOURS)..content).rev().all(&mut extend);
        (bytes, contents)
    }

    /// Reserves `bytes`, if necessary by evicting pages: first those that no body wants, farthest first, then those
    /// needed later than `time`, latest first.
    fn make_room(&mut self, wants: Wants, time: f32, bytes: usize, counters: &mut Counters) -> Option<Reservation> {
        self.retired.reclaim();
        if let Some(room) = self.budget.take(bytes) {
            return Some(room);
        }
        let (used, budget) = (self.budget.used(), self.budget.budget());
        // Pages held by snapshots alone are released without further eviction.
        self.evicted.retain(|(held, _)| held.strong_count() > 0);
        let held_by_snapshots: usize = self.evicted.iter().map(|(_, bytes)| bytes).sum();
        let need = used.saturating_sub(held_by_snapshots).saturating_add(bytes).saturating_sub(budget);
        if need == 0 {
            return None;
        }
        let mut victims = match self.victims.take() {
            Some(victims) if !wants.0.explicit => victims,
            _ => self.victims(wants),
        };
        let (mut gain, mut count) = (0, 0);
        for &(needed, content) in victims.iter().rev() {
            // Evict a little more than is needed now, so that the next run need not wait for snapshots to be dropped.
            let enough = if needed.is_infinite() { need + budget / 16 } else { need };
            if gain >= enough || needed <= time {
                break;
            }
            count += 1;
            gain += self.resident.get(&content).map_or(0, |resident| resident.held.reserved_bytes());
        }
        let room = (gain >= need).then(|| {
            let gone = victims.split_off(victims.len() - count);
            self.evict(gone.into_iter().map(|(_, content)| content), counters);
            self.budget.take(bytes)
        });
        if !wants.0.explicit {
            self.victims = Some(victims);
        }
        room.flatten()
    }

    /// Reserves `bytes` for other uses than pages, if necessary by evicting pages that no body needs now and for which
    /// `stays` returns false.
    pub fn set_aside(
        &mut self,
        bytes: usize,
        stays: &dyn Fn(u32) -> bool,
        counters: &mut Counters,
    ) -> Option<Reservation> {
        self.make_room((&Order::default(), stays), 0.0, bytes, counters)
    }

    /// Returns all pages in memory that are not needed now, the next one to evict last.
    fn victims(&self, (order, stays): Wants) -> Vec<(f32, u32)> {
        let mut focus = self.focus.clone();
        focus.extend(order.focus.iter().filter(|_| order.explicit));
        let rank = |(&content, resident): (&u32, &Resident)| {
            let time = |page: &u32| {
                if stays(*page) {
                    return 0.0;
                }
                let hinted = self.times.get(page).copied().unwrap_or(f32::INFINITY);
                hinted.min(order.times.get(page).copied().unwrap_or(f32::INFINITY))
            };
            let time = resident.pages.iter().map(time).fold(f32::INFINITY, f32::min);
            let apart = resident.pages.iter().map(|page| distance(self.snapshots.index.key(*page), &focus)).min();
            (time, apart, content)
        };
        let mut ranked: Vec<_> = self.resident.iter().map(rank).filter(|(time, ..)| *time > 0.0).collect();
        sort_by(&mut ranked, |a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        ranked.into_iter().map(|(time, _, content)| (time, content)).collect()
    }

    fn evict(&mut self, contents: impl Iterator<Item = u32>, counters: &mut Counters) {
        let mut changes = Vec::new();
        for content in contents {
            let Some(resident) = self.resident.remove(&content) else { continue };
            let bytes = resident.held.reserved_bytes();
            self.weight -= bytes;
            self.evicted.push((Arc::downgrade(&resident.held), bytes));
            counters.evicted += 1;
            counters.wasted += u64::from(!resident.touched);
            changes.extend(resident.pages.into_iter().map(|page| (page, None)));
        }
        self.publish(changes);
    }

    fn publish(&mut self, mut changes: Vec<(u32, Option<Arc<Held>>)>) {
        let next = Arc::new(self.slots.with(self.snapshots.index.table(), &mut changes));
        self.snapshots.current.publish(&next);
        self.retired.push(std::mem::replace(&mut self.slots, next));
        self.retired.reclaim();
    }

    /// Puts the pages of a run into the next snapshot; returns their number and the errors of the others.
    pub fn settle(
        &mut self,
        run: PageRun,
        pages: Vec<Result<Page>>,
        counters: &mut Counters,
    ) -> (usize, Vec<(u32, PageError)>) {
        let PageRun { contents, mut room, .. } = run;
        let (mut changes, mut failures) = (Vec::new(), Vec::new());
        for ((content, page), decoded) in contents.into_iter().zip(pages) {
            self.in_flight.remove(&content);
            let decoded = match decoded {
                Ok(decoded) => decoded,
                Err(error) => {
                    failures.push((content, PageError { key: self.snapshots.index.key(page), error }));
                    continue;
                }
            };
            self.failed.remove(&content);
            // Equals the directory's size of the page, which the decoder checked (rule P11).
            let room = room.split(decoded.weight_bytes());
            self.weight += room.bytes();
            let held = Arc::new(Held { page: decoded, room: Some(room) });
            let touched = self.times.get(&page).is_some_and(|time| *time <= 0.0);
            changes.push((page, Some(held.clone())));
            self.resident.insert(content, Resident { held, pages: vec![page], touched });
        }
        drop(room);
        counters.loaded += changes.len() as u64;
        let loaded = changes.len();
        if loaded > 0 {
            self.publish(changes);
        }
        (loaded, failures)
    }

    /// Gives up a run that was not read, and its reservation.
    pub fn release(&mut self, run: PageRun) {
        for (content, _) in &run.contents {
            self.in_flight.remove(content);
        }
    }

    /// Gives up a run of several pages that could not be read; they will be read one at a time.
    pub fn divide(&mut self, run: PageRun) {
        for (content, _) in &run.contents {
            self.failed.entry(*content).or_default();
        }
        self.release(run);
    }

    /// Records that a page could not be loaded.
    pub fn note_failure(&mut self, content: u32, error: &Error, now: Time) {
        self.failed.entry(content).or_default().failed(error, now);
    }

    fn may_try(&self, content: u32, now: Time) -> bool {
        self.failed.get(&content).is_none_or(|failure| failure.is_due(now))
    }

    /// Returns whether `order` wants a page that is neither in memory nor in flight and may be tried now.
    pub fn is_absent(&self, order: &Order, now: Time) -> bool {
        let absent = |&(_, page): &(f32, u32)| {
            let content = self.snapshots.index.content(page);
            let known = self.resident.contains_key(&content) || self.in_flight.contains(&content);
            !known && (order.explicit || self.may_try(content, now))
        };
        order.pages[order.done..].iter().any(absent)
    }

    /// Returns the number of pages of `order` that are not in memory under their own slots.
    pub fn absent(&self, order: &Order) -> usize {
        let holds = |page: u32| {
            self.resident
                .get(&self.snapshots.index.content(page))
                .is_some_and(|resident| resident.pages.contains(&page))
        };
        order.pages.iter().filter(|(_, page)| !holds(*page)).count()
    }

    /// Returns the number of pages in memory and their bytes, without those that only snapshots hold.
    pub fn resident(&self) -> (usize, usize) {
        (self.resident.len(), self.weight)
    }
}
