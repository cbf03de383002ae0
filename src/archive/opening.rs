//! Opening of an archive without files, threads or a clock (chapter 11): which bytes to fetch, and what they say.
//!
//! [`Opening`] takes pieces of the archive in any order and from anywhere. It reports the ranges still missing, then
//! returns the [`Catalog`]. Memory: at most 16 KiB for the longest head, and a footer.
//!
//! The caller fetches the bytes:
//!
//! ```
//! use slicewalk::archive::{Catalog, Opened, Opening};
//!
//! fn open(file_len: u64, read: impl Fn(std::ops::Range<u64>) -> Vec<u8>) -> slicewalk::Result<Catalog> {
//!     let mut opening = Opening::new(Some(file_len));
//!     loop {
//!         match opening.next()? {
//!             Opened::Wants(ranges) => ranges.into_iter().for_each(|range| opening.give(range.start, &read(range.clone()))),
//!             Opened::Ready(catalog) => return Ok(*catalog),
//!         }
//!     }
//! }
//! ```

use super::catalog::Catalog;
use super::head::{self, FOOTER, MAGIC, MAX_HEAD};
use crate::Result;
use std::ops::Range;

/// State of an [`Opening`].
#[derive(Debug, Clone, PartialEq)]
pub enum Opened {
    /// Ranges still missing, ascending and disjoint; at most 16 KiB and a footer in all.
    Wants(Vec<Range<u64>>),
    /// The catalog: head and footer are sound and belong together.
    Ready(Box<Catalog>),
}

/// Collects the head and the footer of an archive.
///
/// Asks for both at once if the length of the archive is known; otherwise first for the head, which states the length.
/// That is two requests, or one for an archive of at most 16 KiB. Finds all damage of head and footer, and missing
/// bytes; finds bytes after the footer only if the length is known. Results are stable: the first bytes received for a
/// place count, and an error stays.
#[derive(Debug, Clone)]
pub struct Opening {
    file_len: Option<u64>,
    start: Piece,
    footer: Option<Piece>,
}

impl Opening {
    /// Begins to open an archive of `file_len` bytes, if that is known.
    pub fn new(file_len: Option<u64>) -> Self {
        let start = Piece::new(0..file_len.unwrap_or(u64::MAX).min(MAX_HEAD as u64));
        let mut opening = Self { file_len: None, start, footer: None };
        if let Some(len) = file_len {
            opening.ends_at(len);
        }
        opening
    }

    /// Sets the length of the archive (bytes) when the source learns it with its first answer. The first length counts.
    pub fn ends_at(&mut self, len: u64) {
        if self.file_len.is_none() {
            self.file_len = Some(len);
            self.expect_end(len);
        }
    }

    /// Adds bytes of the archive that begin at `offset`. They may be more or fewer than requested; of bytes that arrive
    /// twice, the first count.
    pub fn give(&mut self, offset: u64, bytes: &[u8]) {
        self.start.give(offset, bytes);
        if self.footer.is_none()
            && let Some(len) = self.stated_len()
        {
            self.expect_end(len);
        }
        if let Some(footer) = &mut self.footer {
            footer.give(offset, bytes);
        }
    }

    /// Returns the missing ranges or the catalog. Repeated calls without new bytes return the same.
    pub fn next(&self) -> Result<Opened> {
        let known = self.start.known();
        if known.len() >= MAGIC.len() || self.start.is_complete() {
            head::check_magic(known)?;
        }
        let wants = self.wants();
        if !wants.is_empty() {
            return Ok(Opened::Wants(wants));
        }
        let start = &self.start.bytes;
        let file_len = self.file_len.or(self.stated_len()).unwrap_or(start.len() as u64);
        let (header, leaves) = head::decode(start, file_len)?;
        // A head that decodes leaves room for a footer after it.
        let footer =
            self.footer.as_ref().and_then(|piece| piece.bytes.first_chunk::<FOOTER>()).copied().unwrap_or_default();
        head::check_footer(&footer, file_len, &start[..header.bytes.head as usize])?;
        Ok(Opened::Ready(Box::new(Catalog::new(header, leaves))))
    }

    /// Returns the missing ranges of both pieces, joined where they meet.
    fn wants(&self) -> Vec<Range<u64>> {
        let missing = [Some(&self.start), self.footer.as_ref()].into_iter().flatten().flat_map(|piece| &piece.missing);
        let mut wants: Vec<Range<u64>> = Vec::new();
        for gap in missing {
            match wants.last_mut().filter(|last| gap.start <= last.end) {
                Some(last) => last.end = last.end.max(gap.end),
                None => wants.push(gap.clone()),
            }
        }
        wants
    }

    /// Returns the length that the head states (bytes), once enough of it has arrived.
    fn stated_len(&self) -> Option<u64> {
        head::stated_len(self.start.known())
    }

    /// Expects a footer before byte `len`, and no head after it.
    fn expect_end(&mut self, len: u64) {
        self.start.cut(len);
        if let Some(at) = len.checked_sub(FOOTER as u64) {
            let mut footer = Piece::new(at..len);
            let known = self.start.known().to_vec();
            footer.give(0, &known);
            self.footer = Some(footer);
        }
    }
}

/// Range of the archive that arrives in pieces.
#[derive(Debug, Clone)]
struct Piece {
    at: u64,
    bytes: Vec<u8>,
    /// Missing ranges: ascending, not empty, disjoint.
    missing: Vec<Range<u64>>,
}

impl Piece {
    fn new(range: Range<u64>) -> Self {
        let bytes = vec![0; (range.end - range.start) as usize];
        Self { at: range.start, bytes, missing: Vec::from_iter((!range.is_empty()).then_some(range)) }
    }

    fn give(&mut self, offset: u64, bytes: &[u8]) {
        let end = offset.saturating_add(bytes.len() as u64);
        let mut left = Vec::with_capacity(self.missing.len() + 1);
        for gap in self.missing.drain(..) {
            let given = gap.start.max(offset)..gap.end.min(end);
            if given.is_empty() {
                left.push(gap);
                continue;
            }
            let from = &bytes[(given.start - offset) as usize..(given.end - offset) as usize];
            self.bytes[(given.start - self.at) as usize..(given.end - self.at) as usize].copy_from_slice(from);
            left.extend([gap.start..given.start, given.end..gap.end].into_iter().filter(|rest| !rest.is_empty()));
        }
        self.missing = left;
    }

    /// Drops everything from byte `len` on.
    fn cut(&mut self, len: u64) {
        let keep = len.saturating_sub(self.at).min(self.bytes.len() as u64);
        self.bytes.truncate(keep as usize);
        self.missing.iter_mut().for_each(|gap| gap.end = gap.end.min(len));
        self.missing.retain(|gap| gap.start < gap.end);
    }

    /// Returns the bytes before the first gap.
    fn known(&self) -> &[u8] {
        let end = self.missing.first().map_or(self.bytes.len(), |gap| (gap.start - self.at) as usize);
        &self.bytes[..end]
    }

    fn is_complete(&self) -> bool {
        self.missing.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ArchiveWriter, Header, Totals};
    use super::*;
    use crate::frame::Frame;
    use crate::plan::Plan;
    use proptest::prelude::*;
    use std::sync::LazyLock;

    /// Archives without pages, shorter and longer than 16 KiB; the longer one has a long reference system.
    static SMALL: LazyLock<(Header, Vec<u8>)> = LazyLock::new(|| archive(10));
    static LARGE: LazyLock<(Header, Vec<u8>)> = LazyLock::new(|| archive(100_000));

    fn archive(crs: usize) -> (Header, Vec<u8>) {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
        let writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        let header = writer.finish(Totals { crs: "x".repeat(crs), ..Totals::default() }).unwrap();
        (header, std::fs::read(&target).unwrap())
    }

    #[test]
    fn a_piece_knows_its_bytes_up_to_the_first_gap() {
        let mut piece = Piece::new(100..130);
        assert_eq!(piece.known(), [0u8; 0]);
        piece.give(95, &[7; 15]);
        assert_eq!(piece.known(), [7; 10]);
        piece.give(120, &[9; 20]);
        assert_eq!((piece.known().len(), piece.is_complete()), (10, false));
        piece.give(110, &[8; 10]);
        assert_eq!((piece.known(), piece.is_complete()), (&[[7; 10], [8; 10], [9; 10]].concat()[..], true));
    }

    /// Opens `file`, answering each request with exactly its bytes; returns the number of requests.
    fn requests(file: &[u8], mut opening: Opening) -> (usize, Result<Catalog>) {
        let mut rounds = 0;
        loop {
            match opening.next() {
                Ok(Opened::Wants(ranges)) => {
                    rounds += 1;
                    for range in ranges {
                        let end = range.end.min(file.len() as u64);
                        opening.give(range.start, &file[range.start as usize..end as usize]);
                        if end < range.end {
                            opening.ends_at(file.len() as u64);
                        }
                    }
                }
                Ok(Opened::Ready(catalog)) => return (rounds, Ok(*catalog)),
                Err(error) => return (rounds, Err(error)),
            }
        }
    }

    #[test]
    fn a_small_archive_opens_with_one_round_and_a_large_one_with_one_or_two() {
        let (header, small) = &*SMALL;
        for len in [Some(small.len() as u64), None] {
            let (rounds, catalog) = requests(small, Opening::new(len));
            assert_eq!((rounds, catalog.unwrap().header()), (1, header));
        }
        let (header, large) = &*LARGE;
        for (len, expected) in [(Some(large.len() as u64), 1), (None, 2)] {
            let (rounds, catalog) = requests(large, Opening::new(len));
            assert_eq!((rounds, catalog.unwrap().header()), (expected, header));
        }
        // The first length counts.
        let mut opening = Opening::new(Some(small.len() as u64));
        opening.ends_at(100);
        assert_eq!(requests(small, opening).1.unwrap().header(), &SMALL.0);
        // All bytes at once, requested or not.
        let mut opening = Opening::new(None);
        opening.give(0, large);
        assert!(matches!(opening.next(), Ok(Opened::Ready(_))));
    }

    #[test]
    fn what_is_no_archive_is_refused_with_its_first_bytes_and_stays_so() {
        let file = &LARGE.1;
        let mut opening = Opening::new(None);
        opening.give(0, b"LASF and more");
        for _ in 0..2 {
            assert!(opening.next().unwrap_err().to_string().contains("rule H1"));
            opening.give(0, file);
        }
        let mut lying = file.clone();
        lying.push(0);
        let (_, refused) = requests(&lying, Opening::new(Some(lying.len() as u64)));
        assert!(refused.unwrap_err().to_string().contains("rule H6"));
        for len in 0..100 {
            let (_, refused) = requests(&file[..len], Opening::new(Some(len as u64)));
            assert!(refused.is_err());
            let (_, refused) = requests(&file[..len], Opening::new(None));
            assert!(refused.is_err());
        }
    }

    proptest! {
        /// Pieces in any order, duplicated and overlapping, give the same catalog; at most 16 KiB and a footer are
        /// requested.
        #[test]
        fn pieces_may_come_in_any_order(
            pieces in proptest::collection::vec((any::<prop::sample::Index>(), 0usize..9000), 0..40), known: bool
        ) {
            let file = &LARGE.1;
            let mut opening = Opening::new(known.then_some(file.len() as u64));
            for (at, len) in pieces {
                let at = at.index(file.len());
                opening.give(at as u64, &file[at..(at + len).min(file.len())]);
                if let Opened::Wants(ranges) = opening.next().unwrap() {
                    let sum: u64 = ranges.iter().map(|range| range.end - range.start).sum();
                    prop_assert!(sum <= (MAX_HEAD + FOOTER) as u64);
                    prop_assert!(ranges.is_sorted_by(|a, b| a.end < b.start));
                }
            }
            let (rounds, catalog) = requests(file, opening);
            prop_assert!(rounds <= 2);
            prop_assert_eq!(catalog.unwrap(), requests(file, Opening::new(None)).1.unwrap());
        }

        /// Damaged bytes cause no panic and no large allocation.
        #[test]
        fn damaged_heads_never_panic(at: prop::sample::Index, value: u8, known: bool) {
            let mut file = SMALL.1.clone();
            let at = at.index(file.len());
            let sound = file[at] == value;
            file[at] = value;
            let (rounds, opened) = requests(&file, Opening::new(known.then_some(file.len() as u64)));
            prop_assert!(rounds <= 3);
            prop_assert!(opened.is_err() || sound || at >= SMALL.0.bytes.head as usize);
        }
    }
}
