//! Codecs: pages to bytes and back, no files, no clocks, no threads.
//!
//! In: a [`Page`]. Out: at most [`MAX_BODY`] bytes, and from them the same page again. Memory:
//! one scratch of at most a few MiB per codec object. The bytes are described in `spec/slice-archive.md`, chapter 6.
//!
//! The first byte of an encoded page names its model: `adaptive`, or from version 1.5 on `braided`, each also behind
//! marks that say which spans are inferred. Decoders take hostile bytes: every number
//! is checked before it sizes, indexes or bounds a loop, and a broken rule comes back as a [`Violation`], which the archive
//! turns into an error with its place in the file.

mod adaptive;
mod braid;
mod braided;
mod bytes;
mod colours;
mod compress;
mod lattice;
mod loose;
mod rans;

#[doc(hidden)]
pub use bytes::put_varint;
pub(crate) use bytes::{ByteReader, unzigzag, zigzag};
pub use colours::{ColourBlock, ColourEncoder, MAX_COLOUR_BLOCK};
#[doc(hidden)]
pub use compress::{Packer, Unpacker};
pub use lattice::LevelSteps;

use crate::Error;
use crate::frame::Frame;
use crate::plan::Coding;
use crate::slice::{Inferred, Page, PageBuilder, RowBuilder, Span};
use lattice::{End, HeightsOf, Lattice};

/// Most spans that a page can hold: 64 in each of its 4,096 pixels.
pub const MAX_PAGE_SPANS: usize = 64 * 64 * 64;
/// Most bytes of the marks of inferred spans: their number, and one byte for each run of up to 127 spans.
const MAX_MARKS: usize = 3 + MAX_PAGE_SPANS + MAX_PAGE_SPANS / 127 + 1;
/// Greatest length of an encoded page (bytes). Marks fit in, too: no symbol takes more than 15 of the 16 bits that are
/// reckoned for it.
pub const MAX_BODY: usize = 1 + adaptive::MAX_LEN;
/// The same of a braided page.
pub(crate) const MAX_BRAIDED_BODY: usize = 1 + MAX_MARKS + braided::MAX_LEN;
const _: () = assert!(MAX_MARKS < adaptive::MAX_LEN / 16 - 8 && MAX_BRAIDED_BODY < MAX_BODY);

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

/// First byte of an encoded page: its model. Version 1.0 has one, and readers refuse those that they do not know.
const ADAPTIVE: u8 = 1;
/// Model of pages with inferred spans, of version 1.2: which floor spans are inferred, then as [`ADAPTIVE`].
const MARKED: u8 = 2;
/// Models of version 1.5: as the two above, with spans in the braided coding.
const BRAIDED: u8 = 3;
const MARKED_BRAIDED: u8 = 4;

/// Encodes pages; keeps its scratch, so that a page costs no allocation.
#[derive(Debug)]
pub struct Encoder {
    coding: Coding,
    of: HeightsOf,
    /// How far heights may be moved (quanta), and the steps that they may have been put on then.
    tolerance: u32,
    steps: Vec<u64>,
    /// Made with the first page that is not braided, or may be coarsened.
    adaptive: Option<Box<adaptive::Scratch>>,
    /// Made with the first page that is braided.
    braided: Option<Box<braided::Scratch>>,
    heights: Vec<(u32, End)>,
    loose: loose::Loose,
    builder: RowBuilder,
}

impl Encoder {
    /// An encoder for pages of an archive with this grid and heights coarsened by up to `tolerance` (quanta).
    pub fn new(frame: Frame, tolerance: u32) -> Self {
        let steps = loose::all_steps(&frame, tolerance);
        Self { tolerance, steps, ..Self::with(HeightsOf::Scan(frame)) }
    }

    /// An encoder for pages of overview levels.
    pub fn of_levels(steps: LevelSteps) -> Self {
        Self::with(HeightsOf::Level(steps))
    }

    /// As this one, of pages of an archive that is coded so; in the default coding without this.
    pub fn with_coding(self, coding: Coding) -> Self {
        Self { coding, ..self }
    }

    fn with(of: HeightsOf) -> Self {
        Self {
            coding: Coding::default(),
            of,
            tolerance: 0,
            steps: Vec::new(),
            adaptive: None,
            braided: None,
            heights: Vec::new(),
            loose: Default::default(),
            builder: RowBuilder::default(),
        }
    }

    /// Appends the encoding of `page`, at most [`MAX_BODY`] bytes. The page must hold matter, and one of a level lie on its steps. Equal
    /// pages have equal encodings, whatever was encoded before.
    pub fn encode(&mut self, page: &Page, out: &mut Vec<u8>) {
        self.encode_inferred(page, &Inferred::NONE, out);
    }

    /// As [`encode`](Self::encode), of a page some of whose spans are inferred.
    pub fn encode_inferred(&mut self, page: &Page, inferred: &Inferred, out: &mut Vec<u8>) {
        self.encode_as(self.coding, page, inferred, out);
    }

    /// Whether `page` has an encoding: heights of a level's page must lie on the steps of the level.
    pub(crate) fn admits(&self, page: &Page) -> bool {
        self.of.admits(page)
    }

    /// How this encodes pages.
    pub(crate) fn coding(&self) -> Coding {
        self.coding
    }

    /// As [`encode_inferred`](Self::encode_inferred), in this coding.
    pub(crate) fn encode_as(&mut self, coding: Coding, page: &Page, inferred: &Inferred, out: &mut Vec<u8>) {
        put_model(coding, page, inferred, out);
        self.encode_spans(coding, page, out);
    }

    fn encode_spans(&mut self, coding: Coding, page: &Page, out: &mut Vec<u8>) {
        match coding {
            Coding::Adaptive => {
                adaptive::encode(&self.of, &self.steps, page, self.adaptive.get_or_insert_default(), out);
            }
            Coding::Braided => {
                adaptive::telling_heights(page, &mut self.heights);
                let lattice = Lattice::find_short(&self.of, &self.steps, &self.heights).unwrap_or(Lattice::QUANTA);
                braided::encode(lattice, page, self.braided.get_or_insert_default(), out);
            }
        }
    }

    /// As [`encode_inferred`](Self::encode_inferred), as archives before version 1.3 have it: heights on none but the steps of scans.
    pub fn encode_as_before(&mut self, page: &Page, inferred: &Inferred, out: &mut Vec<u8>) {
        put_model(Coding::Adaptive, page, inferred, out);
        adaptive::encode(&self.of, &[], page, self.adaptive.get_or_insert_default(), out);
    }

    /// Whether [`encode_as_before`](Self::encode_as_before) may differ.
    pub fn has_changed(&self, coding: Coding) -> bool {
        coding == Coding::Adaptive && !self.steps.is_empty()
    }

    /// As [`encode_inferred`](Self::encode_inferred), of a page that takes fewer bytes and holds all matter of `page`, which is
    /// returned: bottoms are up to the tolerance lower, tops as much higher. Spans of one kind between which that leaves no gap
    /// become one. Without its inferred spans, which come with it, the page is what it would be if there had been none.
    pub fn encode_loose(&mut self, page: &Page, inferred: &Inferred, out: &mut Vec<u8>) -> (Page, Inferred) {
        let Self { coding, of, tolerance, steps, adaptive, loose, builder, .. } = self;
        let adaptive = adaptive.get_or_insert_default();
        if inferred.is_empty() {
            let (page, tried) = loose.simplify((of, steps), (page, *tolerance), adaptive, builder);
            put_model(*coding, &page, inferred, out);
            match coding {
                Coding::Adaptive => adaptive::encode_chosen(of, steps, &page, tried, adaptive, out),
                Coding::Braided => self.encode_spans(Coding::Braided, &page, out),
            }
            return (page, Inferred::NONE);
        }
        let mut plain = PageBuilder::default();
        let mut scanned = (inferred.without(page, &mut plain), Lattice::QUANTA);
        if scanned.0.span_count() > 0 {
            let (page, tried) = loose.simplify((of, steps), (&scanned.0, *tolerance), adaptive, builder);
            scanned = (page, tried.lattice);
        }
        let (page, inferred) = loose::with_inferred((&scanned.0, scanned.1), (page, inferred), *tolerance, &mut plain);
        put_model(self.coding, &page, &inferred, out);
        self.encode_spans(self.coding, &page, out);
        (page, inferred)
    }
}

/// Appends the model of a page, and which of its spans are inferred.
fn put_model(coding: Coding, page: &Page, inferred: &Inferred, out: &mut Vec<u8>) {
    let (plain, marked) = match coding {
        Coding::Adaptive => (ADAPTIVE, MARKED),
        Coding::Braided => (BRAIDED, MARKED_BRAIDED),
    };
    if inferred.is_empty() {
        return out.push(plain);
    }
    out.push(marked);
    let runs = inferred.runs(page);
    put_varint(out, runs.len() as u64);
    runs.iter().for_each(|&run| put_varint(out, run.into()));
}

/// The coding of the page that `body` encodes, by its own word; of a model that nobody knows none.
pub(crate) fn coding_of(body: &[u8]) -> Option<Coding> {
    match *body.first()? {
        ADAPTIVE | MARKED => Some(Coding::Adaptive),
        BRAIDED | MARKED_BRAIDED => Some(Coding::Braided),
        _ => None,
    }
}

/// Decodes pages; keeps its scratch, so that a page costs no more than its own allocations.
#[derive(Debug, Default)]
pub struct Decoder {
    /// Made with the first page of each coding: one archive has pages of one.
    adaptive: Option<Box<adaptive::Scratch>>,
    braided: Option<Box<(braided::Scratch, RowBuilder)>>,
    builder: PageBuilder,
    inferred: Inferred,
}

impl Decoder {
    /// A decoder of pages in `coding` of up to `spans` spans, of which it has [`scratch_bytes`](Self::scratch_bytes) at most.
    pub fn for_spans(coding: Coding, spans: usize) -> Self {
        let mut decoder = Self::default();
        match coding {
            Coding::Adaptive => decoder.adaptive.get_or_insert_default().reserve(spans),
            Coding::Braided => decoder.braided.get_or_insert_default().1.reserve(spans),
        }
        decoder.builder.reserve(spans);
        decoder
    }

    /// Bytes of scratch memory of a decoder made [`for_spans`](Self::for_spans), as long as it decodes no page of another coding.
    pub fn scratch_bytes(coding: Coding, spans: usize) -> usize {
        let coded = match coding {
            Coding::Adaptive => adaptive::Scratch::decoding_bytes(spans),
            Coding::Braided => braided::Scratch::decoding_bytes() + RowBuilder::own_bytes(spans),
        };
        coded + PageBuilder::scratch_bytes(spans)
    }

    /// The page that `body` encodes, in whatever coding. Linear in `body` and the page's spans; breaks of rules P5 to P8 and P12 are
    /// errors.
    pub fn decode(&mut self, body: &[u8]) -> Result<Page, Violation> {
        self.decode_as(None, body)
    }

    /// As [`decode`](Self::decode), of a page of an archive whose pages have this coding (rule P5).
    pub fn decode_as(&mut self, coding: Option<Coding>, body: &[u8]) -> Result<Page, Violation> {
        self.inferred.clear();
        let found = coding_of(body);
        match (found, body.split_first()) {
            (Some(found), Some((&model, coded))) if coding.is_none_or(|coding| coding == found) => match model {
                MARKED | MARKED_BRAIDED => self.decode_marked(found, coded),
                _ => self.decode_spans(found, coded),
            },
            (_, Some((&model, _))) => {
                let expected = match coding {
                    None => format!("model {ADAPTIVE} to {MARKED_BRAIDED}"),
                    Some(Coding::Adaptive) => format!("model {ADAPTIVE} or {MARKED}"),
                    Some(Coding::Braided) => format!("model {BRAIDED} or {MARKED_BRAIDED}"),
                };
                Err(Violation::new("P5", expected, model))
            }
            (_, None) => Err(Violation::new("P5", "a model", "no byte")),
        }
    }

    fn decode_spans(&mut self, coding: Coding, coded: &[u8]) -> Result<Page, Violation> {
        match coding {
            Coding::Adaptive => {
                self.builder.clear();
                adaptive::decode(coded, self.adaptive.get_or_insert_default(), &mut self.builder)?;
                Ok(self.builder.build())
            }
            Coding::Braided => {
                let (scratch, rows) = &mut **self.braided.get_or_insert_default();
                braided::decode(coded, scratch, rows)?;
                Ok(rows.build())
            }
        }
    }

    fn decode_marked(&mut self, coding: Coding, marked: &[u8]) -> Result<Page, Violation> {
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
        let page = self.decode_spans(coding, reader.take(reader.len())?)?;
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
pub(crate) use adaptive::tests::pages;
