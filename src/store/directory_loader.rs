//! Start of a [`Loader`](super::Loader): reads the head and footer of an archive, then all leaves of its directory.
//!
//! In: fetched bytes. Out: the table of all pages. Memory: reserved in the budget before a leaf is requested.

use super::budget::{Budget, Reservation};
use super::fetch::{Cargo, FetchId, Flight, Retry, Time, wrong_length};
use super::id_map::IdMap;
use super::index::Index;
use crate::archive::{Catalog, Opened, Opening, PageEntry};
use crate::{Error, Parameter, Result};
use std::ops::Range;
use std::sync::Arc;

/// Most bytes of leaves in one fetch, unless a single leaf is longer.
const LONGEST: u64 = 1 << 20;
#[derive(Debug)]
pub(super) struct Start {
    opening: Opening,
    len_known: bool,
    catalog: Option<Arc<Catalog>>,
    /// Reservation for the table of pages; its size becomes exact when the table is built.
    table: Option<Reservation>,
    /// Leaves not requested yet, by run; those that failed return here.
    left: Vec<Range<usize>>,
    entries: IdMap<usize, Vec<PageEntry>>,
    retry: Retry,
    /// Error that the next poll returns. Unless it is a failed read, every later poll returns it, too.
    error: Option<Error>,
}

/// Next action.
pub(super) enum StartTurn {
    Fetch(Range<u64>, Cargo),
    Wait(Option<Time>),
    /// The table of pages with its reservation.
    Ready(Arc<Index>, Reservation),
}

impl Start {
    pub fn new(file_len: Option<u64>) -> Self {
        Self {
            opening: Opening::new(file_len),
            len_known: file_len.is_some(),
            catalog: None,
            table: None,
            left: Vec::new(),
            entries: IdMap::new(),
            retry: Retry::default(),
            error: None,
        }
    }

    /// Begins with an archive that is open already.
    pub fn with(catalog: Catalog, budget: &Arc<Budget>) -> Result<Self> {
        let mut start = Self::new(None);
        start.plan(catalog, budget)?;
        Ok(start)
    }

    pub fn catalog(&self) -> Option<&Arc<Catalog>> {
        self.catalog.as_ref()
    }

    /// Reserves the table of pages, before any read whose size depends on their number.
    fn plan(&mut self, catalog: Catalog, budget: &Arc<Budget>) -> Result<()> {
        let pages = catalog.header().pages.total();
        let least = usize::try_from(pages).unwrap_or(usize::MAX).saturating_mul(Index::LEAST_PAGE_BYTES);
        self.table = Some(budget.take(least).ok_or_else(|| too_small(budget, pages, least))?);
        let (mut first, count) = (0, catalog.leaf_count());
        let longest = LONGEST.min(budget.budget() as u64 / 16);
        while first < count {
            let start = catalog.leaf_range(first).start;
            let more = (first + 1..count).take_while(|&leaf| catalog.leaf_range(leaf).end - start <= longest).count();
            self.left.push(first..first + 1 + more);
            first += 1 + more;
        }
        self.left.reverse();
        self.catalog = Some(Arc::new(catalog));
        Ok(())
    }

    /// Returns the next action; `flights` are those of the loader.
    pub fn poll(&mut self, now: Time, budget: &Arc<Budget>, flights: &IdMap<FetchId, Flight>) -> Result<StartTurn> {
        if let Some(error) = self.error.take() {
            if !matches!(error, Error::Io { .. }) {
                self.error = Some(same_again(&error));
            }
            return Err(error);
        }
        if !self.retry.is_due(now) {
            return Ok(StartTurn::Wait(self.retry.at()));
        }
        let turn = self.advance(budget, flights);
        if let Err(error) = &turn {
            self.error = Some(same_again(error));
        }
        turn
    }

    fn advance(&mut self, budget: &Arc<Budget>, flights: &IdMap<FetchId, Flight>) -> Result<StartTurn> {
        let Some(catalog) = self.catalog.clone() else {
            let wants = match self.opening.next()? {
                Opened::Ready(catalog) => {
                    self.plan(*catalog, budget)?;
                    return self.advance(budget, flights);
                }
                Opened::Wants(wants) => wants,
            };
            let on_its_way = |range: &Range<u64>| {
                flights.values().any(|flight| flight.range.start < range.end && range.start < flight.range.end)
            };
            let range = wants.into_iter().find(|range| !on_its_way(range));
            return Ok(range.map_or(StartTurn::Wait(None), |range| StartTurn::Fetch(range, Cargo::Head)));
        };
        if let Some(leaves) = self.left.pop() {
            let range = catalog.leaf_range(leaves.start).start..catalog.leaf_range(leaves.end - 1).end;
            let scratch: usize = leaves.clone().map(|leaf| catalog.leaf_entries(leaf) as usize * LEAF_SCRATCH).sum();
            let bytes = ((range.end - range.start) as usize).saturating_add(scratch);
            if let Some(room) = budget.take(bytes) {
                return Ok(StartTurn::Fetch(range, Cargo::Leaves { leaves, _room: room }));
            }
            if flights.is_empty() {
                return Err(too_small(budget, catalog.header().pages.total(), budget.used().saturating_add(bytes)));
            }
            self.left.push(leaves);
            return Ok(StartTurn::Wait(None));
        }
        if !flights.is_empty() {
            return Ok(StartTurn::Wait(None));
        }
        let entries: Vec<PageEntry> =
            std::mem::replace(&mut self.entries, IdMap::new()).into_values().flatten().collect();
        let index = Index::new(catalog.header().plan.frame, entries, catalog.ignores_inferred());
        let (pages, bytes) = (index.len() as u64, index.weight_bytes());
        self.table = None;
        let table = budget.take(bytes).ok_or_else(|| too_small(budget, pages, bytes))?;
        Ok(StartTurn::Ready(Arc::new(index), table))
    }

    /// Takes bytes of head or footer.
    pub fn given(&mut self, range: &Range<u64>, bytes: &[u8], now: Time) {
        if (bytes.len() as u64) < range.end - range.start {
            // Only the first answer may be short: it reveals the archive's length.
            if self.len_known || range.start > 0 {
                return self.failed(0..0, wrong_length(range, bytes.len()), now);
            }
            self.opening.ends_at(bytes.len() as u64);
            self.len_known = true;
        }
        self.opening.give(range.start, bytes);
    }

    /// Notes that a fetch failed; `leaves` is empty for head and footer.
    pub fn failed(&mut self, leaves: Range<usize>, error: Error, now: Time) {
        self.left.extend(Some(leaves).filter(|leaves| !leaves.is_empty()));
        self.retry.failed(&error, now);
        self.error = Some(error);
    }

    /// Takes decoded leaves.
    pub fn loaded(&mut self, leaves: Range<usize>, entries: Result<Vec<PageEntry>>) {
        match entries {
            Ok(entries) => {
                self.entries.insert(leaves.start, entries);
                self.retry = Retry::default();
            }
            Err(error) => self.error = Some(error),
        }
    }
}

/// Most bytes for decoding each entry of a leaf: before compression, and as columns of numbers.
const LEAF_SCRATCH: usize = 47 + 8 + size_of::<crate::frame::PageKey>() + 4;

/// Copies a lasting error for later polls: errors cannot be cloned, because `io::Error` cannot.
fn same_again(error: &Error) -> Error {
    match error {
        Error::Format { rule, part, offset, expected, found } => {
            Error::format(rule, part.clone(), *offset, expected, found)
        }
        Error::Unsupported { what, version, suggestion } => {
            Error::Unsupported { what: what.clone(), version, suggestion: suggestion.clone() }
        }
        Error::Parameter { what, reason } => Error::parameter(what.clone(), reason.clone()),
        other => Error::parameter("archive", other.to_string()),
    }
}

fn too_small(budget: &Budget, pages: u64, least: usize) -> Error {
    match budget.budget() {
        0 => Error::parameter(Parameter::Cache, "0 bytes hold no page; give some MiB"),
        // The least size depends on the archive, so the parameter alone is not at fault.
        budget => Error::parameter(
            "cache",
            format!("{budget} bytes are too few: the table of {pages} pages alone needs {least}; give more memory"),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{archive, written};
    use super::super::{Loader, LoaderOptions, Next};
    use super::*;
    use crate::archive::Archive;
    use crate::frame::PageKey;
    use crate::page::{PageBuilder, Span};
    use crate::random::Random;

    /// Opens an archive; notes how many fetches are out at once.
    fn open(bytes: &[u8], budget: usize, out: &mut Vec<usize>) -> Result<()> {
        let catalog = Archive::from_bytes(bytes.to_vec()).unwrap().catalog().clone();
        let mut loader = Loader::new(catalog, LoaderOptions::new(budget))?;
        while loader.snapshot().is_none() {
            let mut fetches = Vec::new();
            while let Next::Fetch(fetch) = loader.poll(Time::ZERO)? {
                fetches.push(fetch);
            }
            out.extend(Some(fetches.len()).filter(|count| *count > 0));
            for fetch in fetches {
                let own = bytes[fetch.range.start as usize..fetch.range.end as usize].to_vec();
                let job = loader.given(fetch.id, own, Time::ZERO).unwrap();
                loader.loaded(job.run(), Time::ZERO);
            }
        }
        assert!(loader.counters().peak_bytes <= budget);
        Ok(())
    }

    /// More pages than a leaf holds, far apart: the table takes more memory than the least.
    #[test]
    fn a_budget_that_is_too_small_names_one_that_takes_it_further() {
        let mut random = Random(3);
        let mut far = || random.below(1u64 << 28) as i32 - (1 << 27);
        let keys: std::collections::BTreeSet<_> =
            (0..4100).map(|_| PageKey { tx: far(), ty: far(), layer: far() }).collect();
        // In any slices, so that a leaf is too long for a fetch with another one.
        let mut page = PageBuilder::default();
        let page = |key| {
            let slices = random.bits() | 1;
            let bottoms = (0..64).filter(|slice| slices >> slice & 1 == 1).map(|slice| 255 * slice + 10);
            let spans: Vec<_> = bottoms.map(|bottom| Span::new(bottom, bottom + 9, false).unwrap()).collect();
            page.clear();
            assert!(page.set_column(1, 2, &spans));
            (key, page.build())
        };
        let pages: Vec<_> = keys.into_iter().map(page).collect();
        let bytes = written(&pages, false, None);
        let (mut budget, mut out) = (1, Vec::new());
        loop {
            out.push(Vec::new());
            let Err(error) = open(&bytes, budget, out.last_mut().unwrap()) else { break };
            let told = error.to_string();
            assert!(told.contains(&format!("{budget} bytes are too few: the table of 4100 pages")), "{told}");
            let needed = told.split("alone needs ").nth(1).and_then(|rest| rest.split(';').next()).unwrap();
            let more = needed.parse().unwrap();
            assert!(more > budget && out.len() < 5, "{told}");
            budget = more;
        }
        // Room for the least table, for the first leaf, then for one leaf after the other, and for the table itself.
        assert_eq!(out, [vec![], vec![], vec![1, 1], vec![2]]);
    }

    #[test]
    fn a_lasting_error_comes_at_every_poll() {
        let mut newer = archive(false);
        newer[8] += 1;
        let end = u32::from_le_bytes(newer[12..16].try_into().unwrap()) as usize - 4;
        let crc = crc32c::crc32c(&newer[..end]);
        newer[end..end + 4].copy_from_slice(&crc.to_le_bytes());
        let limit = Error::limit("bytes of the link", 5, 4);
        for (mut fails, says) in [(None, "rule H4"), (Some(limit), "bytes of the link: 5 is beyond the limit of 4")] {
            let mut loader = Loader::open(Some(newer.len() as u64), LoaderOptions::new(1 << 20));
            let mut told = Vec::new();
            while told.len() < 3 {
                match loader.poll(Time::ZERO) {
                    Ok(Next::Fetch(fetch)) => match fails.take() {
                        Some(error) => loader.failed(fetch.id, error, Time::ZERO),
                        None => {
                            let own = newer[fetch.range.start as usize..fetch.range.end as usize].to_vec();
                            assert!(loader.given(fetch.id, own, Time::ZERO).is_none());
                        }
                    },
                    Ok(next) => panic!("{next:?}"),
                    Err(error) => told.push(error.to_string()),
                }
            }
            assert!(told.iter().all(|told| told.contains(says)), "{told:?}");
        }
    }
}
