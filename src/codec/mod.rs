//! Codecs: encode pages to bytes and decode them. No files, clocks or threads.
//!
//! A [`Page`] becomes at most [`MAX_BODY`] bytes, which decode to the same page. Memory: scratch of at most a few MiB
//! per codec object. `spec/slice-archive.md`, chapter 6, describes the bytes.
//!
//! The first byte of an encoded page says whether marks of inferred spans precede its spans. Decoders accept hostile
//! bytes: they check every number before it sizes, indexes or bounds a loop, and report a broken rule as a
//! [`Violation`], which the archive turns into an error with its place in the file.

mod bytes;
mod colour_blocks;
mod compress;
mod estimate;
mod interleaved;
mod lossy;
mod page;
mod rans;
mod rows;
mod step_grid;
#[cfg(not(target_arch = "wasm32"))]
mod zstd_c;
#[cfg(any(target_arch = "wasm32", test))]
mod zstd_rust;

#[doc(hidden)]
pub use bytes::ByteReader;
#[doc(hidden)]
pub use bytes::put_varint;
pub(crate) use bytes::{unzigzag, zigzag};
pub use colour_blocks::{ColourBlock, ColourEncoder, MAX_COLOUR_BLOCK};
#[doc(hidden)]
#[cfg(target_arch = "wasm32")]
pub use compress::set_compressor;
pub use compress::{LEVEL, Packer, Unpacker};
pub(crate) use step_grid::LEVEL_STEP;

use crate::Error;
use crate::frame::Frame;
use crate::page::{Inferred, Page, PageBuilder, RowBuilder, Span};
use rows::telling_heights;
use step_grid::{End, HeightsOf, StepGrid};

/// Most spans in a page: 64 in each of its 4,096 pixels.
pub const MAX_PAGE_SPANS: usize = 64 * 64 * 64;
/// Most bytes of the marks of inferred spans: their number, and one byte for each run of up to 127 spans.
const MAX_MARKS: usize = 3 + MAX_PAGE_SPANS + MAX_PAGE_SPANS / 127 + 1;
/// Largest encoded page (bytes).
pub const MAX_BODY: usize = 1 + MAX_MARKS + page::MAX_LEN;

/// Violation of a rule of the specification; [`Violation::at`] adds its place in the archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Rule of the specification.
    pub rule: &'static str,
    /// Content that the rule requires.
    pub expected: String,
    /// Content of the bytes.
    pub found: String,
}

impl Violation {
    /// Creates the violation of `rule`.
    pub fn new(rule: &'static str, expected: impl ToString, found: impl ToString) -> Self {
        Self { rule, expected: expected.to_string(), found: found.to_string() }
    }

    /// Returns the error about `part` of the archive, which begins at byte `offset`.
    pub fn at(self, part: impl Into<String>, offset: u64) -> Error {
        Error::format(self.rule, part, offset, self.expected, self.found)
    }
}

/// First byte of an encoded page without inferred spans.
const PLAIN: u8 = 3;
/// First byte of an encoded page with inferred spans: marks of these floor spans precede the spans.
const MARKED: u8 = 4;

/// Encodes pages; keeps its scratch memory, so that a page costs no allocation.
#[derive(Debug)]
pub struct Encoder {
    of: HeightsOf,
    /// How far heights may move (quanta), and the steps that they may have been put on.
    tolerance: u32,
    steps: Vec<u64>,
    /// Allocated with the first page.
    scratch: Option<Box<page::Scratch>>,
    heights: Vec<(u32, End)>,
    lossy: lossy::Lossy,
    /// Allocated with the first page whose heights are moved.
    estimate: Option<Box<estimate::Estimate>>,
    builder: RowBuilder,
}

impl Encoder {
    /// Creates an encoder for pages of an archive on this grid, with heights coarsened by up to `tolerance` (quanta).
    pub fn new(frame: Frame, tolerance: u32) -> Self {
        let steps = lossy::all_steps(&frame, tolerance);
        Self { tolerance, steps, ..Self::with(HeightsOf::Scan(frame)) }
    }

    /// Creates an encoder for pages of overview levels.
    pub fn of_levels() -> Self {
        Self::with(HeightsOf::Level)
    }

    fn with(of: HeightsOf) -> Self {
        Self {
            of,
            tolerance: 0,
            steps: Vec::new(),
            scratch: None,
            heights: Vec::new(),
            lossy: Default::default(),
            estimate: None,
            builder: RowBuilder::default(),
        }
    }

    /// Appends the encoding of `page`, at most [`MAX_BODY`] bytes. The page must contain a span; one of a level must
    /// lie on the level's steps. Equal pages have equal encodings, whatever was encoded before.
    pub fn encode(&mut self, page: &Page, out: &mut Vec<u8>) {
        self.encode_inferred(page, &Inferred::NONE, out);
    }

    /// Appends the encoding of a page with inferred spans; otherwise like [`encode`](Self::encode).
    pub fn encode_inferred(&mut self, page: &Page, inferred: &Inferred, out: &mut Vec<u8>) {
        put_marks(page, inferred, out);
        let boundaries = telling_heights(page, &mut self.heights);
        let grid = StepGrid::find_short(&self.of, &self.steps, &self.heights, &boundaries);
        page::encode(grid.unwrap_or(StepGrid::QUANTA), page, self.scratch.get_or_insert_default(), out);
    }

    /// Returns whether `page` has an encoding: heights of a level's page must lie on the steps of the level.
    pub(crate) fn admits(&self, page: &Page) -> bool {
        self.of.admits(page)
    }

    /// Encodes and returns a page that takes fewer bytes and covers all that `page` covers: bottoms are up to the
    /// tolerance lower, tops up to the tolerance higher. Spans of one kind without a gap between them merge.
    ///
    /// Also returns the inferred spans. Without them, the page equals the encoding of a page that never had any.
    pub fn encode_lossy(&mut self, page: &Page, inferred: &Inferred, out: &mut Vec<u8>) -> (Page, Inferred) {
        let Self { of, tolerance, steps, estimate, lossy, builder, .. } = self;
        let estimate = estimate.get_or_insert_default();
        let mut simplify = |page: &Page| lossy.simplify((of, steps), (page, *tolerance), estimate, builder);
        let (page, inferred) = if inferred.is_empty() {
            (simplify(page).0, Inferred::NONE)
        } else {
            let mut plain = PageBuilder::default();
            let mut scanned = (inferred.without(page, &mut plain), StepGrid::QUANTA);
            if scanned.0.span_count() > 0 {
                scanned = simplify(&scanned.0);
            }
            lossy::with_inferred((&scanned.0, scanned.1), (page, inferred), *tolerance, &mut plain)
        };
        self.encode_inferred(&page, &inferred, out);
        (page, inferred)
    }
}

/// Appends the first byte and, if there are any, the marks of inferred spans.
fn put_marks(page: &Page, inferred: &Inferred, out: &mut Vec<u8>) {
    if inferred.is_empty() {
        return out.push(PLAIN);
    }
    out.push(MARKED);
    let runs = inferred.runs(page);
    put_varint(out, runs.len() as u64);
    runs.iter().for_each(|&run| put_varint(out, run.into()));
}

/// Decodes pages; keeps its scratch memory, so that a page costs no more than its own allocations.
#[derive(Debug, Default)]
pub struct Decoder {
    /// Allocated with the first page that is not uniform.
    scratch: Option<Box<page::Scratch>>,
    rows: RowBuilder,
    inferred: Inferred,
}

impl Decoder {
    /// Creates a decoder for pages of up to `spans` spans, which needs at most [`scratch_bytes`](Self::scratch_bytes)
    /// of memory.
    pub fn for_spans(spans: usize) -> Self {
        let mut decoder = Self::default();
        decoder.rows.reserve(spans);
        decoder
    }

    /// Returns the scratch memory of a decoder created by [`for_spans`](Self::for_spans) (bytes).
    pub fn scratch_bytes(spans: usize) -> usize {
        page::Scratch::decoding_bytes() + RowBuilder::scratch_bytes(spans) + Inferred::most_bytes(spans)
    }

    /// Decodes the page of `body` (rules P5 to P8 and P12). Time: linear in the length of `body` and the number of
    /// spans.
    pub fn decode(&mut self, body: &[u8]) -> Result<Page, Violation> {
        self.inferred.clear();
        match body.split_first() {
            Some((&PLAIN, coded)) => self.decode_spans(coded),
            Some((&MARKED, coded)) => self.decode_marked(coded),
            Some((first, _)) => Err(Violation::new("P5", format!("{PLAIN} or {MARKED}"), first)),
            None => Err(Violation::new("P5", "a byte", "none")),
        }
    }

    fn decode_spans(&mut self, coded: &[u8]) -> Result<Page, Violation> {
        page::decode(coded, self.scratch.get_or_insert_default(), &mut self.rows)?;
        Ok(self.rows.build())
    }

    fn decode_marked(&mut self, marked: &[u8]) -> Result<Page, Violation> {
        let mut reader = ByteReader::new(marked, "P12");
        let count = reader.varint()?;
        // Each run takes at least one byte, and the states follow.
        if count < 2 || count % 2 == 1 || count > reader.len() as u64 {
            return Err(Violation::new("P12", "an even number of runs, 2 or more, inside the page", count));
        }
        let mut runs = reader.clone();
        for number in 0..count {
            let run = reader.varint()?;
            if run > MAX_PAGE_SPANS as u64 || run == 0 && number > 0 {
                return Err(Violation::new("P12", format!("a run of 1 to {MAX_PAGE_SPANS} spans"), run));
            }
        }
        let page = self.decode_spans(reader.take(reader.len())?)?;
        // Read again, because there may be more of them than the page has spans.
        let runs = (0..count).map_while(|_| Some(runs.varint().ok()? as u32));
        if !self.inferred.set_runs(&page, runs) {
            self.inferred.clear();
            return Err(Violation::new("P12", "runs of no more floor spans than the page has", "more"));
        }
        Ok(page)
    }

    /// Returns which spans of the last decoded page are inferred.
    pub fn inferred(&self) -> &Inferred {
        &self.inferred
    }
}

/// Returns a span in the form stored in directories: bottom in bits 0..14, top in bits 14..28, obstacle in bit 28.
pub fn span_bits(span: Span) -> u32 {
    span.bottom() | span.top() << 14 | (span.is_obstacle() as u32) << 28
}

/// Inverse of [`span_bits`]; `None` if the bits are not a span.
pub fn span_from_bits(bits: u32) -> Option<Span> {
    let field = |shift: u32| bits >> shift & 0x3FFF;
    (bits >> 29 == 0).then(|| Span::new(field(0), field(14), bits >> 28 & 1 == 1)).flatten()
}

#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use tests::pages;
