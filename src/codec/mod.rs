//! Codecs: pages to bytes and back, no files, no clocks, no threads.
//!
//! In: a [`Page`]. Out: at most [`MAX_BODY`] bytes, and from them the same page again. Memory:
//! one scratch of at most a few MiB per codec object. The bytes are described in `spec/slice-archive.md`, chapter 6.
//!
//! The first byte of an encoded page says whether marks of inferred spans come before its spans. Decoders take hostile bytes: every
//! number is checked before it sizes, indexes or bounds a loop, and a broken rule comes back as a [`Violation`], which the archive
//! turns into an error with its place in the file.

mod bytes;
mod colours;
mod compress;
mod estimate;
mod interleaved;
mod lossy;
mod page;
mod rans;
mod rows;
mod step_grid;

#[doc(hidden)]
pub use bytes::put_varint;
pub(crate) use bytes::{ByteReader, unzigzag, zigzag};
pub use colours::{ColourBlock, ColourEncoder, MAX_COLOUR_BLOCK};
#[doc(hidden)]
pub use compress::{Packer, Unpacker};
pub(crate) use step_grid::LEVEL_STEP;

use crate::Error;
use crate::frame::Frame;
use crate::slice::{Inferred, Page, PageBuilder, RowBuilder, Span};
use rows::telling_heights;
use step_grid::{End, HeightsOf, StepGrid};

/// Most spans that a page can hold: 64 in each of its 4,096 pixels.
pub const MAX_PAGE_SPANS: usize = 64 * 64 * 64;
/// Most bytes of the marks of inferred spans: their number, and one byte for each run of up to 127 spans.
const MAX_MARKS: usize = 3 + MAX_PAGE_SPANS + MAX_PAGE_SPANS / 127 + 1;
/// Greatest length of an encoded page (bytes).
pub const MAX_BODY: usize = 1 + MAX_MARKS + page::MAX_LEN;

/// A rule of the specification that bytes break; [`Violation::at`] adds where they lie.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Rule id of the specification.
    pub rule: &'static str,
    /// What the rule asks for.
    pub expected: String,
    /// What the bytes say.
    pub found: String,
}

impl Violation {
    /// The violation of `rule`.
    pub fn new(rule: &'static str, expected: impl ToString, found: impl ToString) -> Self {
        Self { rule, expected: expected.to_string(), found: found.to_string() }
    }

    /// As an error about `part` of the archive, which begins at byte `offset`.
    pub fn at(self, part: impl Into<String>, offset: u64) -> Error {
        Error::format(self.rule, part, offset, self.expected, self.found)
    }
}

/// First byte of an encoded page without inferred spans.
const PLAIN: u8 = 3;
/// First byte of an encoded page with inferred spans: which floor spans these are comes before the spans.
const MARKED: u8 = 4;

/// Encodes pages; keeps its scratch, so that a page costs no allocation.
#[derive(Debug)]
pub struct Encoder {
    of: HeightsOf,
    /// How far heights may be moved (quanta), and the steps that they may have been put on then.
    tolerance: u32,
    steps: Vec<u64>,
    /// Made with the first page.
    scratch: Option<Box<page::Scratch>>,
    heights: Vec<(u32, End)>,
    lossy: lossy::Lossy,
    /// Made with the first page whose heights are moved.
    estimate: Option<Box<estimate::Scratch>>,
    builder: RowBuilder,
}

impl Encoder {
    /// An encoder for pages of an archive with this grid and heights coarsened by up to `tolerance` (quanta).
    pub fn new(frame: Frame, tolerance: u32) -> Self {
        let steps = lossy::all_steps(&frame, tolerance);
        Self { tolerance, steps, ..Self::with(HeightsOf::Scan(frame)) }
    }

    /// An encoder for pages of overview levels.
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

    /// Appends the encoding of `page`, at most [`MAX_BODY`] bytes. The page must hold a span, and one of a level lie on its steps. Equal
    /// pages have equal encodings, whatever was encoded before.
    pub fn encode(&mut self, page: &Page, out: &mut Vec<u8>) {
        self.encode_inferred(page, &Inferred::NONE, out);
    }

    /// Appends the encoding of a page some of whose spans are inferred; otherwise like [`encode`](Self::encode).
    pub fn encode_inferred(&mut self, page: &Page, inferred: &Inferred, out: &mut Vec<u8>) {
        put_marks(page, inferred, out);
        telling_heights(page, &mut self.heights);
        let grid = StepGrid::find_short(&self.of, &self.steps, &self.heights).unwrap_or(StepGrid::QUANTA);
        page::encode(grid, page, self.scratch.get_or_insert_default(), out);
    }

    /// Returns whether `page` has an encoding: heights of a level's page must lie on the steps of the level.
    pub(crate) fn admits(&self, page: &Page) -> bool {
        self.of.admits(page)
    }

    /// Encodes a page that takes fewer bytes and holds all that `page` holds, and returns it: bottoms are up to the tolerance lower,
    /// tops up to the tolerance higher. Spans of one kind between which that leaves no gap become one. Without its inferred spans,
    /// which are returned too, the page is what it would be if there had been none.
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

/// Appends which spans of a page are inferred, and before that whether any are.
fn put_marks(page: &Page, inferred: &Inferred, out: &mut Vec<u8>) {
    if inferred.is_empty() {
        return out.push(PLAIN);
    }
    out.push(MARKED);
    let runs = inferred.runs(page);
    put_varint(out, runs.len() as u64);
    runs.iter().for_each(|&run| put_varint(out, run.into()));
}

/// Decodes pages; keeps its scratch, so that a page costs no more than its own allocations.
#[derive(Debug, Default)]
pub struct Decoder {
    scratch: page::Scratch,
    rows: RowBuilder,
    builder: PageBuilder,
    inferred: Inferred,
}

impl Decoder {
    /// A decoder of pages of up to `spans` spans, of which it has [`scratch_bytes`](Self::scratch_bytes) at most.
    pub fn for_spans(spans: usize) -> Self {
        let mut decoder = Self::default();
        decoder.rows.reserve(spans);
        decoder.builder.reserve(spans);
        decoder
    }

    /// Bytes of scratch memory of a decoder made [`for_spans`](Self::for_spans).
    pub fn scratch_bytes(spans: usize) -> usize {
        page::Scratch::decoding_bytes() + RowBuilder::own_bytes(spans) + PageBuilder::scratch_bytes(spans)
    }

    /// The page that `body` encodes. Linear in `body` and the page's spans; breaks of rules P5 to P8 and P12 are errors.
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
        page::decode(coded, &mut self.scratch, &mut self.rows)?;
        Ok(self.rows.build())
    }

    fn decode_marked(&mut self, marked: &[u8]) -> Result<Page, Violation> {
        let mut reader = ByteReader::new(marked, "P12");
        let count = reader.varint()?;
        // Each takes a byte or more, and the state follows.
        if count < 2 || count % 2 == 1 || count > reader.len() as u64 {
            return Err(Violation::new("P12", "an even number of runs, 2 or more, inside the page", count));
        }
        let mut runs = Vec::with_capacity(count as usize);
        for number in 0..count {
            let run = reader.varint()?;
            if run > MAX_PAGE_SPANS as u64 || run == 0 && number > 0 {
                return Err(Violation::new("P12", format!("a run of 1 to {MAX_PAGE_SPANS} spans"), run));
            }
            runs.push(run as u32);
        }
        let page = self.decode_spans(reader.take(reader.len())?)?;
        if !self.inferred.set_runs(&page, &runs) {
            self.inferred.clear();
            return Err(Violation::new("P12", "runs of no more floor spans than the page has", "more"));
        }
        Ok(page)
    }

    /// Which spans of the page decoded last are inferred.
    pub fn inferred(&self) -> &Inferred {
        &self.inferred
    }

    /// The page decoded last, which is `page`, without its inferred spans.
    pub fn scanned(&mut self, page: &Page) -> Page {
        self.inferred.without(page, &mut self.builder)
    }
}

/// A span as it is stored in directories: bottom in bits 0..14, top in bits 14..28, obstacle in bit 28.
pub fn span_bits(span: Span) -> u32 {
    span.bottom() | span.top() << 14 | (span.is_obstacle() as u32) << 28
}

/// The span of [`span_bits`]; `None` if the bits make none.
pub fn span_from_bits(bits: u32) -> Option<Span> {
    let field = |shift: u32| bits >> shift & 0x3FFF;
    (bits >> 29 == 0).then(|| Span::new(field(0), field(14), bits >> 28 & 1 == 1)).flatten()
}

#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use tests::pages;
