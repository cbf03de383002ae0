//! Search for pages by their leaders, without a sound leaf (appendix C).
//!
//! A page counts if its checksum is right and its content sound, wherever it lies; the search skips the bytes of a page
//! with a right checksum. Of all pages found, the longest run with ascending keys is kept, so a page with a wrong key
//! costs only itself.
//!
//! Leaders may be forged at every byte, each claiming 3.8 MiB. The checksum of any range is therefore derived from
//! checksums of prefixes: a search takes time linear in the bytes, and memory of 9 MiB and 40 bytes per page.

use super::page_coding::{self, MAX_STORED_PAGE, PageDecoder};
use crate::bytes::ByteSource;
use crate::bytes::crc;
use crate::frame::PageKey;
use crate::{Error, Monitor, Result};
use std::ops::Range;

/// Bytes of the file held at once.
const CHUNK: usize = 8 << 20;
const _: () = assert!(MAX_STORED_PAGE < CHUNK);
/// Most work per byte searched: two steps of checksum for each leader, and the share of reading and moving the window.
const WORK_A_BYTE: u64 = (2 * Sums::STEP / page_coding::MAGIC.len() + 2 * CHUNK / (CHUNK - MAX_STORED_PAGE) + 1) as u64;
/// Bytes read at once where larger reads fail.
const SECTOR: usize = 4096;
/// First bytes of a zstd frame, and so of a directory leaf.
const FRAME: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];

/// Location of a sound page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Found {
    pub key: PageKey,
    pub offset: u64,
    pub len: usize,
}

/// Finds sound pages with keys in `keys` in the bytes `range` of `source`, and returns their longest ascending run in
/// file order. With `to_the_leaf`, the search ends where a page is followed by a directory leaf or a page of a level.
pub(super) fn find_pages(
    source: &dyn ByteSource,
    range: Range<u64>,
    keys: impl Fn(PageKey) -> bool,
    to_the_leaf: bool,
    monitor: &dyn Monitor,
) -> Result<Vec<Found>> {
    let start = range.start;
    let mut window = Window::new(source, range);
    let mut decoder = PageDecoder::new();
    let mut found = Vec::new();
    while let Some(offset) = window.find_leader() {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let Some(len) = window.page_len() else {
            window.pass(1);
            continue;
        };
        let bytes = &window.bytes[window.at..window.at + len];
        if let Some((key, _)) = decoder.salvage(bytes)
            && keys(key)
        {
            found.push(Found { key, offset, len });
        }
        window.pass(len);
        if to_the_leaf && (window.starts_with(&FRAME) || window.starts_with(&page_coding::LEVEL_MAGIC)) {
            break;
        }
    }
    // The bound holds for forged leaders, too: each takes at least its magic, and the window advances by what a page
    // leaves of it.
    debug_assert!(window.work <= WORK_A_BYTE * (window.start + window.at as u64 - start) + 2 * CHUNK as u64);
    Ok(longest_ascending(&found))
}

/// Returns the longest subsequence of pages with ascending keys (Fredman 1975).
fn longest_ascending(found: &[Found]) -> Vec<Found> {
    // `ends[n]`: last page of the run of length `n + 1` whose last key is smallest. `before[n]`: page before page `n`
    // in its run.
    let (mut ends, mut before): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::with_capacity(found.len()));
    for (at, page) in found.iter().enumerate() {
        let len = ends.partition_point(|&end| found[end].key < page.key);
        before.push(if len > 0 { ends[len - 1] } else { at });
        match ends.get_mut(len) {
            Some(end) => *end = at,
            None => ends.push(at),
        }
    }
    let mut run = Vec::with_capacity(ends.len());
    let mut at = ends.last().copied();
    while let Some(page) = at {
        run.push(found[page]);
        at = Some(before[page]).filter(|&before| before != page);
    }
    run.reverse();
    run
}

/// Sliding window over the file.
struct Window<'a> {
    source: &'a dyn ByteSource,
    /// End of the search (byte offset in the file).
    end: u64,
    bytes: Vec<u8>,
    /// File offset of the bytes, and position of the search in them.
    start: u64,
    at: usize,
    sums: Sums,
    /// Bytes already summed, moved or read.
    work: u64,
}

impl<'a> Window<'a> {
    fn new(source: &'a dyn ByteSource, range: Range<u64>) -> Self {
        let end = range.end.min(source.len());
        let start = range.start.min(end);
        Self { source, end, bytes: Vec::new(), start, at: 0, sums: Sums::default(), work: 0 }
    }

    fn pass(&mut self, bytes: usize) {
        self.at += bytes;
    }

    /// Moves to the next leader and returns its offset in the file.
    fn find_leader(&mut self) -> Option<u64> {
        loop {
            let rest = &self.bytes[self.at..];
            if let Some(begin) = rest.windows(page_coding::MAGIC.len()).position(|bytes| *bytes == page_coding::MAGIC) {
                self.at += begin;
                return Some(self.start + self.at as u64);
            }
            // The last bytes may begin a leader.
            self.at = self.bytes.len() - rest.len().min(page_coding::MAGIC.len() - 1);
            if !self.refill() {
                return None;
            }
        }
    }

    /// Returns the length of the page that begins here, if its checksum is right.
    fn page_len(&mut self) -> Option<usize> {
        if !self.reaches(page_coding::LEADER + 1) {
            return None;
        }
        let len = page_coding::stated_len(&self.bytes[self.at..]).filter(|&len| self.reaches(len))?;
        let (leader, body) =
            (&self.bytes[self.at..self.at + page_coding::LEADER], self.at + page_coding::LEADER..self.at + len);
        self.work += 2 * Sums::STEP as u64;
        let sum = self.sums.appended(page_coding::covered_crc(leader), &self.bytes, body);
        (sum == page_coding::leader_crc(leader)).then_some(len)
    }

    fn starts_with(&mut self, bytes: &[u8]) -> bool {
        self.reaches(bytes.len()) && self.bytes[self.at..].starts_with(bytes)
    }

    /// Returns whether `len` bytes follow from here; reads them if so.
    fn reaches(&mut self, len: usize) -> bool {
        if self.bytes.len() - self.at >= len {
            return true;
        }
        self.start + (self.at + len) as u64 <= self.end && self.refill()
    }

    /// Drops the bytes before the position and reads more; returns whether there were any.
    fn refill(&mut self) -> bool {
        self.bytes.drain(..self.at);
        self.start += self.at as u64;
        self.at = 0;
        let have = self.bytes.len();
        let left = self.end - (self.start + have as u64);
        let more = left.min((CHUNK - have) as u64) as usize;
        self.bytes.resize(have + more, 0);
        let (from, new) = (self.start + have as u64, &mut self.bytes[have..]);
        if self.source.read_at(from, new).is_err() {
            // On a failing disk, treat unreadable sectors as zeros: they hold no page.
            for (at, sector) in (from..).step_by(SECTOR).zip(new.chunks_mut(SECTOR)) {
                if self.source.read_at(at, sector).is_err() {
                    sector.fill(0);
                }
            }
        }
        self.sums = Sums::of(&self.bytes);
        self.work += 2 * self.bytes.len() as u64;
        more > 0
    }
}

/// Checksums of the prefixes that end at multiples of [`Sums::STEP`]; those of any range follow from them.
#[derive(Default)]
struct Sums {
    before: Vec<u32>,
}

impl Sums {
    const STEP: usize = 256;

    fn of(bytes: &[u8]) -> Self {
        let mut sum = 0;
        let sums = bytes.chunks(Self::STEP).map(|step| {
            let before = sum;
            sum = crc::crc32c_append(sum, step);
            before
        });
        Self { before: sums.collect() }
    }

    /// Returns the checksum `sum` continued over `range` of `bytes`, the bytes that these sums were computed from.
    fn appended(&self, sum: u32, bytes: &[u8], range: Range<usize>) -> u32 {
        let before = |end: usize| {
            let step = (end / Self::STEP).min(self.before.len().saturating_sub(1));
            let known = self.before.get(step).copied().unwrap_or(0);
            crc::crc32c_append(known, &bytes[step * Self::STEP..end])
        };
        shifted(sum ^ before(range.start), range.len()) ^ before(range.end)
    }
}

/// `x⁸` to the power of 2ⁿ, modulo the CRC32C polynomial.
const POWERS: [u32; 24] = {
    let mut powers = [1 << 23; 24];
    let mut n = 1;
    while n < powers.len() {
        powers[n] = multiplied(powers[n - 1], powers[n - 1]);
        n += 1;
    }
    powers
};
const _: () = assert!(CHUNK < 1 << POWERS.len());

/// Returns the product of two polynomials modulo that of CRC32C. As in checksums, the highest bit is the constant term.
const fn multiplied(a: u32, mut b: u32) -> u32 {
    let (mut product, mut bit) = (0, 32);
    while bit > 0 {
        bit -= 1;
        if a >> bit & 1 == 1 {
            product ^= b;
        }
        b = if b & 1 == 1 { b >> 1 ^ 0x82F6_3B78 } else { b >> 1 };
    }
    product
}

/// Returns `sum` advanced over `len` zero bytes, without the CRC's initial and final inversion.
fn shifted(sum: u32, len: usize) -> u32 {
    let powers = POWERS.iter().enumerate().filter(|(bit, _)| len >> bit & 1 == 1);
    powers.fold(sum, |sum, (_, power)| multiplied(*power, sum))
}

#[cfg(test)]
mod tests {
    use super::super::page_coding::PageEncoder;
    use super::*;
    use crate::NoMonitor;
    use crate::bytes::MemorySource;
    use crate::bytes::testing::{Fault, FaultySource, Strike};
    use crate::frame::Frame;
    use crate::page::{PageBuilder, Span};
    use proptest::prelude::*;

    fn find(bytes: Vec<u8>) -> Vec<Found> {
        let range = 0..bytes.len() as u64;
        find_pages(&MemorySource::new(bytes), range, |_| true, false, &NoMonitor).unwrap()
    }

    #[test]
    fn sectors_that_cannot_be_read_cost_their_own_pages_and_a_stop_ends_the_search() {
        let mut encoder = PageEncoder::new(Frame::new(0.1, 0.3).unwrap());
        let (mut bytes, mut pages) = (Vec::new(), Vec::new());
        for layer in 0..6 {
            let (key, mut builder) = (PageKey { tx: 0, ty: 0, layer }, PageBuilder::default());
            assert!(builder.set_column(9, 9, &[Span::new(layer as u32, 300, true).unwrap()]));
            let page = encoder.encode(key, &builder.build()).bytes;
            bytes.resize(layer as usize * SECTOR, 0);
            pages.push(Found { key, offset: bytes.len() as u64, len: page.len() });
            bytes.extend(page);
        }
        let source = FaultySource::new(MemorySource::new(&bytes[..]));
        let find = |monitor: &dyn Monitor| find_pages(&source, 0..bytes.len() as u64, |_| true, false, monitor);
        assert_eq!(find(&NoMonitor).unwrap(), pages);
        // From the end of one sector to the beginning of the next.
        source.set(Fault::Fail, 3 * SECTOR as u64 - 1..3 * SECTOR as u64 + 1);
        assert_eq!(find(&NoMonitor).unwrap(), [&pages[..2], &pages[4..]].concat());
        assert!(matches!(find(&*Strike::at(2)), Err(Error::Interrupted)));
    }

    #[test]
    fn a_page_across_the_end_of_the_bytes_held_at_once_is_found() {
        let (key, mut builder) = (PageKey { tx: 0, ty: 0, layer: 7 }, PageBuilder::default());
        assert!(builder.set_column(9, 9, &[Span::new(5, 300, true).unwrap()]));
        let page = PageEncoder::new(Frame::new(0.1, 0.3).unwrap()).encode(key, &builder.build()).bytes;
        // The search begins within the file, and the bytes that it first holds end with the page's leader.
        let start = 1000;
        let offset = start + CHUNK - page_coding::LEADER;
        let mut bytes = vec![0; offset];
        bytes.extend(&page);
        let range = start as u64..bytes.len() as u64;
        let found = find_pages(&MemorySource::new(bytes), range, |_| true, false, &NoMonitor).unwrap();
        assert_eq!(found, [Found { key, offset: offset as u64, len: page.len() }]);
    }

    /// `find_pages` asserts the bound on its work where it ends.
    #[test]
    fn forged_leaders_take_work_linear_in_their_bytes() {
        for (period, claim) in [(24, MAX_STORED_PAGE - page_coding::LEADER), (24, 3 << 20), (20, 1 << 20), (4, 0)] {
            let mut leader = vec![0; period];
            leader[..4].copy_from_slice(&page_coding::MAGIC);
            if period > 4 {
                leader[16..20].copy_from_slice(&(claim as u32).to_le_bytes());
            }
            assert_eq!(find(leader.repeat((12 << 20) / period)), []);
        }
    }

    proptest! {
        #[test]
        fn checksums_of_stretches_follow_from_those_of_beginnings(
            bytes in proptest::collection::vec(any::<u8>(), 0..9000), ends in any::<[prop::sample::Index; 2]>(), sum: u32
        ) {
            let [a, b] = ends.map(|end| end.index(bytes.len() + 1));
            let range = a.min(b)..a.max(b);
            let expected = crc::crc32c_append(sum, &bytes[range.clone()]);
            prop_assert_eq!(Sums::of(&bytes).appended(sum, &bytes, range), expected);
        }

        #[test]
        fn no_ascending_run_is_longer(keys in proptest::collection::vec(0i32..9, 0..10)) {
            let page = |(at, &layer): (usize, &i32)| Found { key: PageKey { tx: 0, ty: 0, layer }, offset: at as u64, len: 0 };
            let found: Vec<_> = keys.iter().enumerate().map(page).collect();
            let run = longest_ascending(&found);
            prop_assert!(run.is_sorted_by(|a, b| a.key < b.key && a.offset < b.offset));
            prop_assert!(run.iter().all(|page| found.contains(page)));
            let longest = (0u32..1 << found.len()).filter(|chosen| {
                let chosen: Vec<_> = found.iter().enumerate().filter(|(at, _)| chosen >> at & 1 == 1).map(|(_, page)| page.key).collect();
                chosen.is_sorted_by(|a, b| a < b)
            });
            prop_assert_eq!(Some(run.len() as u32), longest.map(u32::count_ones).max());
        }
    }
}
