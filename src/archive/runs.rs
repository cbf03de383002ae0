//! Reading of many pages: adjacent pages in one read, several reads in parallel.
//!
//! Pages come back in the order of their entries. Memory: 1 MiB for each of four threads, besides the pages.

use super::directory::PageEntry;
use super::page_coding::PageDecoder;
use super::reader::Archive;
use crate::bytes::spawn_in;
use crate::monitor::Monitor;
use crate::page::Page;
use crate::{Error, Result};
use std::ops::Range;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;

/// Most bytes of one read, unless a single page is longer.
const LONGEST: u64 = 1 << 20;
/// Most pages of one read, since pages may share bytes or have none.
const MOST: usize = 1 << 12;
/// Parallel reads.
const TOGETHER: usize = 4;

/// Bytes of one read, and its pages as a range of the read order.
#[derive(Debug, PartialEq)]
struct Run {
    bytes: Range<u64>,
    pages: Range<usize>,
}

impl Archive {
    /// Reads the pages of `entries`, and returns them in the order given. Fails with the error that comes first in byte
    /// order, and with [`Error::Interrupted`] if `monitor` cancels.
    pub(crate) fn pages(&self, entries: &[PageEntry], monitor: &dyn Monitor) -> Result<Vec<Page>> {
        let mut order: Vec<usize> = (0..entries.len()).collect();
        order.sort_by_key(|&number| entries[number].bytes().start);
        let runs = runs(entries, &order);
        let next = AtomicUsize::new(0);
        let read = |number: usize, decoder: &mut PageDecoder, bytes: &mut Vec<u8>| -> Result<Vec<(usize, Page)>> {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let run = &runs[number];
            bytes.clear();
            bytes.resize((run.bytes.end - run.bytes.start) as usize, 0);
            if !bytes.is_empty() {
                self.source().read_at(run.bytes.start, bytes)?;
            }
            let page = |&number: &usize| {
                let own = entries[number].bytes();
                let at = (own.start - run.bytes.start) as usize;
                let page = decoder.decode(&entries[number], &bytes[at..at + (own.end - own.start) as usize])?;
                monitor.advance(1);
                Ok((number, page))
            };
            order[run.pages.clone()].iter().map(page).collect()
        };
        let work = || {
            let (mut decoder, mut bytes, mut pages) = (PageDecoder::new(), Vec::new(), Vec::new());
            decoder.set_ignore_inferred(self.catalog().ignores_inferred());
            loop {
                let number = next.fetch_add(1, Relaxed);
                if number >= runs.len() {
                    return Ok(pages);
                }
                match read(number, &mut decoder, &mut bytes) {
                    Ok(more) => pages.extend(more),
                    Err(error) => {
                        // Earlier runs still finish, so the first error in order wins.
                        next.store(runs.len(), Relaxed);
                        return Err((number, error));
                    }
                }
            }
        };
        let results: Vec<_> = std::thread::scope(|scope| {
            let helper = |_| spawn_in(scope, work).ok();
            let helpers: Vec<_> = (1..TOGETHER.min(runs.len())).filter_map(helper).collect();
            let own = work();
            let join = |helper: std::thread::ScopedJoinHandle<'_, _>| {
                helper.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            std::iter::once(own).chain(helpers.into_iter().map(join)).collect()
        });
        let (mut pages, mut failed) = (Vec::with_capacity(entries.len()), Vec::new());
        for result in results {
            match result {
                Ok(more) => pages.extend(more),
                Err(error) => failed.push(error),
            }
        }
        if let Some((_, error)) = failed.into_iter().min_by_key(|(number, _)| *number) {
            return Err(error);
        }
        pages.sort_unstable_by_key(|(number, _)| *number);
        Ok(pages.into_iter().map(|(_, page)| page).collect())
    }
}

/// Returns the range that covers both; `None` if more than `gap` bytes lie between them or it exceeds `longest`.
pub(crate) fn joined(a: &Range<u64>, b: &Range<u64>, gap: u64, longest: u64) -> Option<Range<u64>> {
    let between = b.start.saturating_sub(a.end).max(a.start.saturating_sub(b.end));
    let whole = a.start.min(b.start)..a.end.max(b.end);
    (between <= gap && whole.end - whole.start <= longest).then_some(whole)
}

/// Plans the reads for the pages of `entries`, which `order` sorts by their bytes.
fn runs(entries: &[PageEntry], order: &[usize]) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (at, &number) in order.iter().enumerate() {
        let own = entries[number].bytes();
        let last = runs.last_mut().filter(|run| run.pages.len() < MOST);
        match last.and_then(|run| Some((joined(&run.bytes, &own, 0, LONGEST)?, run))) {
            Some((whole, run)) => (run.bytes, run.pages.end) = (whole, at + 1),
            None => runs.push(Run { bytes: own, pages: at..at + 1 }),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::super::directory::{Extent, Storage};
    use super::super::{ArchiveWriter, PageEncoder, Totals};
    use super::*;
    use crate::NoMonitor;
    use crate::bytes::testing::Strike;
    use crate::frame::{Frame, PageKey};
    use crate::page::{PageBuilder, PageSize, Span};
    use crate::plan::Plan;

    fn entry(bytes: Range<u64>) -> PageEntry {
        let extent = Extent { offset: bytes.start, len: (bytes.end - bytes.start) as u32, crc: 0 };
        let span = Span::new(0, 255, false).unwrap();
        let storage = if bytes.is_empty() { Storage::Uniform(span) } else { Storage::Stored(extent) };
        PageEntry { key: PageKey { tx: 0, ty: 0, layer: 0 }, slices: 1, size: PageSize::UNIFORM, storage }
    }

    #[test]
    fn the_failure_that_comes_first_in_the_file_is_reported_and_a_stop_ends_the_reading() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
        let page = |layer: i32| {
            let mut builder = PageBuilder::default();
            assert!(builder.set_column(layer as u32, 0, &[Span::new(5, 9, false).unwrap()]));
            builder.build()
        };
        let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        let mut encoder = PageEncoder::of_plan(&plan);
        for layer in 0..16 {
            let key = PageKey { tx: 0, ty: 0, layer };
            writer.put(key, encoder.encode(key, &page(layer))).unwrap();
        }
        writer.finish(Totals::default()).unwrap();
        let mut bytes = std::fs::read(&target).unwrap();
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        // Every second page, which takes a read of its own; the last one first.
        let entries: Vec<PageEntry> = archive.leaf(0).unwrap().into_iter().step_by(2).rev().collect();
        let pages = archive.pages(&entries, &NoMonitor).unwrap();
        assert!(pages.into_iter().eq((0..16).step_by(2).rev().map(page)));
        assert!(matches!(archive.pages(&entries, &*Strike::at(3)), Err(Error::Interrupted)));
        for entry in entries.iter().filter(|entry| entry.key.layer >= 6) {
            bytes[entry.bytes().end as usize - 1] ^= 1;
        }
        let damaged = Archive::from_bytes(bytes).unwrap();
        let said = damaged.pages(&entries, &NoMonitor).unwrap_err().to_string();
        assert!(said.contains("rule P2: page (0, 0, 6)"), "{said}");
    }

    #[test]
    fn neighbours_are_read_at_once_up_to_a_bound() {
        let of = |all: &[Range<u64>]| {
            runs(&all.iter().cloned().map(entry).collect::<Vec<_>>(), &Vec::from_iter(0..all.len()))
        };
        let run = |bytes: Range<u64>, pages: Range<usize>| Run { bytes, pages };
        assert_eq!(of(&[]), []);
        assert_eq!(of(&[100..150, 150..200, 150..200, 200..230]), [run(100..230, 0..4)]);
        assert_eq!(of(&[0..0, 0..0, 100..150, 151..200]), [run(0..0, 0..2), run(100..150, 2..3), run(151..200, 3..4)]);
        let long = 5 + LONGEST;
        assert_eq!(of(&[5..long - 1, long - 1..long, long..long + 1]), [run(5..long, 0..2), run(long..long + 1, 2..3)]);
        assert_eq!(of(&[5..long + 9, long + 9..long + 10]).len(), 2);
        assert_eq!(of(&vec![0..0; MOST + 1]), [run(0..0, 0..MOST), run(0..0, MOST..MOST + 1)]);
    }
}
