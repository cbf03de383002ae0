//! Loading and evicting pages: what to read next, what has to go for it, and the change of the snapshot.
//!
//! The state is locked only between reads: to claim a run of pages with the room that they will take, and to settle what
//! became of it. Two threads never read the same page, and room is taken before a read, so that the budget
//! holds at every moment: pages in memory, pages that views still hold, pages being decoded and the bytes just read.

use super::account::{Account, Room};
use super::motion::distance;
use super::publish::{Current, Retired};
use super::snapshot::{Held, Index, Snapshot, View};
use super::tally::Tally;
use crate::archive::{Archive, PageDecoder, Place};
use crate::frame::PageKey;
use crate::slice::Page;
use crate::{Error, Result};
use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Bytes read in vain that a run of pages may hold between two that are wanted.
const GAP: u64 = 16 << 10;
/// Pages looked at in each direction for a run.
const NEIGHBOURS: u32 = 64;
/// Errors kept until somebody asks.
const ERRORS: usize = 16;
/// First pause before a page that could not be read is tried again; doubled each time, up to 2⁶ times.
const PAUSE: Duration = Duration::from_millis(100);

/// A page that could not be loaded. It stays "not loaded" in every view.
#[derive(Debug)]
pub struct PageError {
    /// The page.
    pub key: PageKey,
    /// Why: bytes that cannot be read, or a rule of the format that they break.
    pub error: Error,
}

#[derive(Debug)]
struct Resident {
    held: Arc<Held>,
    /// Pages whose slots hold it: more than one if they share its content.
    pages: Vec<u32>,
    /// Whether a body came to touch it.
    touched: bool,
}

#[derive(Debug)]
struct Failure {
    tries: u32,
    again: Instant,
    /// Damaged bytes stay damaged.
    lasting: bool,
}

/// Pages asked for, most urgent first, with the time until they are needed (s).
#[derive(Debug, Default)]
pub(super) struct Order {
    pub pages: Vec<(f32, u32)>,
    pub times: HashMap<u32, f32>,
    /// How many of `pages` are done with.
    done: usize,
    /// Asked for by a caller that waits, not by a hint.
    pub explicit: bool,
    pub focus: Vec<PageKey>,
}

impl Order {
    /// In order of time, then of keys.
    pub fn new(times: HashMap<u32, f32>, focus: Vec<PageKey>, explicit: bool) -> Self {
        let mut pages: Vec<_> = times.iter().map(|(&page, &time)| (time, page)).collect();
        pages.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Self { pages, times, done: 0, explicit, focus }
    }
}

/// A run of pages to read at once.
#[derive(Debug)]
pub(super) struct Run {
    start: u64,
    len: usize,
    /// Contents to decode, and the pages that show them.
    contents: Vec<(u32, u32)>,
    room: Room,
}

impl Run {
    pub fn pages(&self) -> usize {
        self.contents.len()
    }
}

/// What to do next about an order.
#[derive(Debug)]
pub(super) enum Claim {
    Run(Run),
    /// All that could be done is done; some pages may have failed.
    Done,
    /// Some pages are being read by another thread.
    Busy,
    /// The rest finds no room; `true`: until views are dropped.
    NoRoom(bool),
}

#[derive(Debug)]
pub(super) struct State {
    snapshot: Arc<Snapshot>,
    retired: Retired<Snapshot>,
    resident: HashMap<u32, Resident>,
    /// Weight of the resident pages, and of the room of runs being read.
    weight: usize,
    reserved: usize,
    in_flight: HashSet<u32>,
    failed: HashMap<u32, Failure>,
    /// What the hints want, and where the bodies are, as of the last plan.
    times: HashMap<u32, f32>,
    focus: Vec<PageKey>,
    /// What may go, first to go last, and by when it is needed; of the last plan.
    victims: Option<Vec<(f32, u32)>>,
    errors: VecDeque<PageError>,
    /// How long a read takes: the longest, slowly forgotten.
    pub latency: Duration,
}

/// What the threads of a stream share.
pub(super) struct Core {
    pub archive: Archive,
    pub index: Arc<Index>,
    pub account: Arc<Account>,
    pub tally: Tally,
    current: Current<Snapshot>,
    state: Mutex<State>,
    settled: Condvar,
    longest_run: u64,
}

impl Core {
    pub fn new(archive: Archive, budget: usize, run_bytes: usize) -> Result<Self> {
        let index = Arc::new(Index::new(*archive.frame(), archive.all_entries()?));
        let snapshot = Arc::new(Snapshot::empty(&index));
        let state = State {
            snapshot: snapshot.clone(),
            retired: Retired::default(),
            resident: HashMap::new(),
            weight: 0,
            reserved: 0,
            in_flight: HashSet::new(),
            failed: HashMap::new(),
            times: HashMap::new(),
            focus: Vec::new(),
            victims: None,
            errors: VecDeque::new(),
            latency: Duration::ZERO,
        };
        Ok(Self {
            archive,
            index,
            account: Account::new(budget),
            tally: Tally::default(),
            current: Current::new(snapshot),
            state: Mutex::new(state),
            settled: Condvar::new(),
            longest_run: run_bytes.min(budget / 8) as u64,
        })
    }

    pub fn view(&self) -> View {
        View { index: self.index.clone(), snapshot: self.current.get() }
    }

    pub fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for another thread to settle a run, or a moment.
    pub fn wait(&self, state: MutexGuard<'_, State>, at_most: Duration) {
        drop(self.settled.wait_timeout(state, at_most));
    }

    /// Takes over what the hints want now.
    pub fn replan(&self, order: &Order) {
        let mut state = self.state();
        let mut requested = 0;
        for (&page, &time) in &order.times {
            match state.resident.get_mut(&self.index.content(page)) {
                Some(resident) => resident.touched |= time <= 0.0,
                None => requested += u64::from(!state.times.contains_key(&page)),
            }
        }
        self.tally.requested.fetch_add(requested, Relaxed);
        state.times.clone_from(&order.times);
        state.focus.clone_from(&order.focus);
        state.victims = None;
    }

    /// Claims the most urgent pages of `order` that are not in memory.
    pub fn claim(&self, state: &mut State, order: &mut Order) -> Claim {
        let (mut attached, mut busy, mut cursor) = (Vec::new(), false, order.done);
        let now = Instant::now();
        let mut claim = None;
        while let Some(&(time, page)) = order.pages.get(cursor) {
            cursor += 1;
            let content = self.index.content(page);
            if let Some(resident) = state.resident.get_mut(&content) {
                if !resident.pages.contains(&page) {
                    resident.pages.push(page);
                    attached.push((page, Some(resident.held.clone())));
                }
            } else if state.in_flight.contains(&content) {
                busy = true;
            } else if order.explicit || state.may_try(content, now) {
                claim = Some((time, page));
                break;
            }
            if !busy {
                order.done = cursor;
            }
        }
        if !attached.is_empty() {
            self.publish(state, attached);
        }
        match claim {
            Some((time, page)) => self.claim_run(state, order, time, page),
            None if busy => Claim::Busy,
            None => Claim::Done,
        }
    }

    fn claim_run(&self, state: &mut State, order: &Order, time: f32, page: u32) -> Claim {
        let content = self.index.content(page);
        let (mut bytes, mut contents) = self.run_around(state, order, content);
        contents[0].1 = page;
        let weight = |contents: &[(u32, u32)]| -> usize {
            contents.iter().map(|&(content, _)| self.index.entry(content).weight_bytes()).sum()
        };
        let length = |bytes: &std::ops::Range<u64>| (bytes.end - bytes.start) as usize;
        let mut room = self.make_room(state, order, time, weight(&contents) + length(&bytes));
        if room.is_none() && contents.len() > 1 {
            contents.truncate(1);
            let extent = self.index.entry(content).extent();
            bytes = extent.map_or(0..0, |extent| extent.offset..extent.offset + u64::from(extent.len));
            room = self.make_room(state, order, time, weight(&contents) + length(&bytes));
        }
        let Some(room) = room else {
            self.tally.no_room.fetch_add(1, Relaxed);
            return Claim::NoRoom(state.retired.len() > 0);
        };
        state.reserved += room.bytes();
        state.in_flight.extend(contents.iter().map(|(content, _)| *content));
        if !order.explicit {
            let late = contents.iter().filter(|(_, page)| order.times.get(page).is_some_and(|time| *time <= 0.0));
            self.tally.late.fetch_add(late.count() as u64, Relaxed);
        }
        Claim::Run(Run { start: bytes.start, len: length(&bytes), contents, room })
    }

    /// The stretch of bytes around `content` with the neighbours that are wanted too, and these.
    fn run_around(&self, state: &State, order: &Order, content: u32) -> (std::ops::Range<u64>, Vec<(u32, u32)>) {
        let mut contents = vec![(content, content)];
        let Some(extent) = self.index.entry(content).extent() else { return (0..0, contents) };
        let mut bytes = extent.offset..extent.offset + u64::from(extent.len);
        let now = Instant::now();
        let mut extend = |page: u32| {
            let Place::Stored(extent) = self.index.entry(page).place else { return true };
            let (start, end) = (extent.offset, extent.offset + u64::from(extent.len));
            let gap = start.saturating_sub(bytes.end).max(bytes.start.saturating_sub(end));
            let whole = bytes.start.min(start)..bytes.end.max(end);
            if gap > GAP || whole.end - whole.start > self.longest_run {
                return false;
            }
            let absent = !state.resident.contains_key(&page) && !state.in_flight.contains(&page);
            if absent && order.times.contains_key(&page) && state.may_try(page, now) {
                bytes = whole;
                contents.push((page, page));
            }
            true
        };
        let end = (content + 1).saturating_add(NEIGHBOURS).min(self.index.len() as u32);
        let _ = (content + 1..end).all(&mut extend);
        let _ = (content.saturating_sub(NEIGHBOURS)..content).rev().all(&mut extend);
        (bytes, contents)
    }

    /// Takes room for `bytes`, evicting pages that no body wants, farthest first, and then pages that are needed later
    /// than `time`, latest first.
    fn make_room(&self, state: &mut State, order: &Order, time: f32, bytes: usize) -> Option<Room> {
        state.retired.reclaim();
        if let Some(room) = self.account.take(bytes) {
            return Some(room);
        }
        let (used, budget) = (self.account.used(), self.account.budget());
        // What views alone still hold becomes free without any further eviction.
        let held_by_views = used.saturating_sub(state.weight + state.reserved);
        let need = (used - held_by_views).saturating_add(bytes).saturating_sub(budget);
        let mut victims = match state.victims.take() {
            Some(victims) if !order.explicit => victims,
            _ => self.victims(state, order),
        };
        let (mut gain, mut count) = (0, 0);
        for &(needed, content) in victims.iter().rev() {
            // A little more than is needed now, so that the next run need not wait for views to be dropped.
            let enough = if needed.is_infinite() { need + budget / 16 } else { need };
            if gain >= enough || needed <= time {
                break;
            }
            count += 1;
            gain += state.resident.get(&content).map_or(0, |resident| resident.held.room.bytes());
        }
        let room = (gain >= need).then(|| {
            let gone = victims.split_off(victims.len() - count);
            self.evict(state, gone.into_iter().map(|(_, content)| content));
            self.account.take(bytes)
        });
        if !order.explicit {
            state.victims = Some(victims);
        }
        room.flatten()
    }

    /// All pages in memory that are not needed now, first to go last.
    fn victims(&self, state: &State, order: &Order) -> Vec<(f32, u32)> {
        let mut focus = state.focus.clone();
        focus.extend(order.focus.iter().filter(|_| order.explicit));
        let rank = |(&content, resident): (&u32, &Resident)| {
            let time = |page: &u32| {
                let hinted = state.times.get(page).copied().unwrap_or(f32::INFINITY);
                hinted.min(order.times.get(page).copied().unwrap_or(f32::INFINITY))
            };
            let time = resident.pages.iter().map(time).fold(f32::INFINITY, f32::min);
            let apart = resident.pages.iter().map(|page| distance(self.index.key(*page), &focus)).min();
            (time, apart, content)
        };
        let mut ranked: Vec<_> = state.resident.iter().map(rank).filter(|(time, ..)| *time > 0.0).collect();
        ranked.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        ranked.into_iter().map(|(time, _, content)| (time, content)).collect()
    }

    fn evict(&self, state: &mut State, contents: impl Iterator<Item = u32>) {
        let mut changes = Vec::new();
        for resident in contents.filter_map(|content| state.resident.remove(&content)) {
            state.weight -= resident.held.room.bytes();
            self.tally.evicted.fetch_add(1, Relaxed);
            self.tally.wasted.fetch_add(u64::from(!resident.touched), Relaxed);
            changes.extend(resident.pages.into_iter().map(|page| (page, None)));
        }
        if !changes.is_empty() {
            self.publish(state, changes);
        }
    }

    fn publish(&self, state: &mut State, mut changes: Vec<(u32, Option<Arc<Held>>)>) {
        let next = Arc::new(state.snapshot.with(&self.index, &mut changes));
        self.current.publish(&next);
        state.retired.push(std::mem::replace(&mut state.snapshot, next));
        state.retired.reclaim();
    }

    /// Reads and decodes a run. Holds no lock.
    pub fn read(&self, run: &Run, decoder: &mut PageDecoder) -> (Duration, Vec<Result<Page>>) {
        let start = Instant::now();
        let mut bytes = vec![0; run.len];
        let mut whole = self.read_at(run.start, &mut bytes).err();
        let latency = start.elapsed();
        let decode = |&(content, _): &(u32, u32)| {
            let entry = self.index.entry(content);
            let Some(extent) = entry.extent() else { return decoder.decode(entry, &[]) };
            let from = (extent.offset - run.start) as usize;
            let part = &mut bytes[from..from + extent.len as usize];
            match whole.take() {
                Some(error) if run.contents.len() == 1 => return Err(error),
                // Something in the run cannot be read; maybe not this page.
                Some(error) => {
                    whole = Some(error);
                    self.read_at(extent.offset, part)?;
                }
                None => {}
            }
            decoder.decode(entry, part)
        };
        (latency, run.contents.iter().map(decode).collect())
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        if buf.is_empty() {
            return Ok(());
        }
        self.tally.reads.fetch_add(1, Relaxed);
        self.tally.read_bytes.fetch_add(buf.len() as u64, Relaxed);
        self.archive.source().read_at(offset, buf)
    }

    /// Puts the pages of a run into the next snapshot; what failed is noted. Returns how many pages were loaded.
    pub fn settle(&self, state: &mut State, run: Run, latency: Duration, pages: Vec<Result<Page>>) -> usize {
        let Run { len, contents, mut room, .. } = run;
        if len > 0 {
            state.latency = latency.max(state.latency.mul_f64(0.95));
        }
        state.reserved -= room.bytes();
        let mut changes = Vec::new();
        for ((content, page), decoded) in contents.into_iter().zip(pages) {
            state.in_flight.remove(&content);
            let decoded = match decoded {
                Ok(decoded) => decoded,
                Err(error) => {
                    self.tally.failed.fetch_add(1, Relaxed);
                    state.fail(content, PageError { key: self.index.key(page), error });
                    continue;
                }
            };
            state.failed.remove(&content);
            // The weight is the directory's: checked by the decoder (rule P11).
            let room = room.split(decoded.weight_bytes());
            state.weight += room.bytes();
            let held = Arc::new(Held { page: decoded, room });
            let touched = state.times.get(&page).is_some_and(|time| *time <= 0.0);
            changes.push((page, Some(held.clone())));
            state.resident.insert(content, Resident { held, pages: vec![page], touched });
        }
        drop(room);
        let loaded = changes.len();
        self.tally.loaded.fetch_add(loaded as u64, Relaxed);
        if loaded > 0 {
            self.publish(state, changes);
        }
        self.settled.notify_all();
        loaded
    }

    /// Errors since the last call.
    pub fn take_errors(&self) -> Vec<PageError> {
        self.state().errors.drain(..).collect()
    }

    #[cfg(test)]
    pub fn hold_a_publication(&self) -> impl Sized + '_ {
        self.current.hold_a_publication()
    }

    /// Bytes of pages in memory, without those that views alone hold.
    pub fn resident(&self) -> (usize, usize) {
        let state = self.state();
        (state.resident.len(), state.weight)
    }
}

impl State {
    fn may_try(&self, content: u32, now: Instant) -> bool {
        self.failed.get(&content).is_none_or(|failure| !failure.lasting && failure.again <= now)
    }

    fn fail(&mut self, content: u32, error: PageError) {
        let tries = self.failed.get(&content).map_or(0, |failure| failure.tries);
        let again = Instant::now() + PAUSE * (1 << tries.min(6));
        let lasting = !matches!(error.error, Error::Io { .. });
        self.failed.insert(content, Failure { tries: tries + 1, again, lasting });
        if self.errors.len() == ERRORS {
            self.errors.pop_front();
        }
        self.errors.push_back(error);
    }

    /// When a page that failed may be tried again.
    pub fn next_try(&self) -> Option<Instant> {
        let tries = self.failed.values().filter(|failure| !failure.lasting);
        tries.map(|failure| failure.again).min()
    }

    /// Whether all pages of `order` are in memory under their own slots.
    pub fn holds(&self, index: &Index, page: u32) -> bool {
        self.resident.get(&index.content(page)).is_some_and(|resident| resident.pages.contains(&page))
    }

    /// The newest error about one of these pages; taken out.
    pub fn take_error(&mut self, keys: &HashSet<PageKey>) -> Option<Error> {
        let at = self.errors.iter().rposition(|error| keys.contains(&error.key))?;
        self.errors.remove(at).map(|error| error.error)
    }
}
