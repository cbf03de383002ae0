//! Spans in byte planes under zstd 1: the simplest coding that keeps all that a page holds, to set the size and the
//! decoding time of the adaptive model against.

use crate::stability::Result;
use slicewalk::page::{Page, PageBuilder, Span};

const LEVEL: i32 = 1;
/// Bytes of planes that a page can have: a count for each pixel, and five bytes for each of at most 64 spans in it.
const MAX_BYTES: usize = 4096 * (1 + 5 * 64);

/// Packs pages and unpacks them, with scratch that is kept from page to page.
pub struct Planes {
    packer: zstd::bulk::Compressor<'static>,
    unpacker: zstd::bulk::Decompressor<'static>,
    bytes: Vec<u8>,
    spans: Vec<Span>,
    builder: PageBuilder,
}

impl Planes {
    pub fn new() -> Result<Self> {
        Ok(Self {
            packer: zstd::bulk::Compressor::new(LEVEL)?,
            unpacker: zstd::bulk::Decompressor::new()?,
            bytes: Vec::with_capacity(MAX_BYTES),
            spans: Vec::new(),
            builder: PageBuilder::default(),
        })
    }

    /// The spans of all 4,096 pixels: their numbers, then low and high bytes of bottoms and thicknesses, then the flags.
    pub fn pack(&mut self, page: &Page) -> Result<Vec<u8>> {
        let pixels = (0..64 * 64).map(|pixel| page.column(pixel % 64, pixel / 64));
        let spans: Vec<Span> = pixels.clone().flatten().copied().collect();
        let low = |value: u32| value as u8;
        let high = |value: u32| (value >> 8) as u8;
        self.bytes.clear();
        self.bytes.extend(pixels.map(|column| column.len() as u8));
        self.bytes.extend(spans.iter().map(|span| low(span.bottom())));
        self.bytes.extend(spans.iter().map(|span| high(span.bottom())));
        self.bytes.extend(spans.iter().map(|span| low(span.top() - span.bottom())));
        self.bytes.extend(spans.iter().map(|span| high(span.top() - span.bottom())));
        self.bytes.extend(spans.iter().map(|span| u8::from(span.is_obstacle())));
        Ok(self.packer.compress(&self.bytes)?)
    }

    /// The page that [`pack`](Self::pack) packed.
    pub fn unpack(&mut self, packed: &[u8]) -> Result<Page> {
        self.bytes.clear();
        self.unpacker.decompress_to_buffer(packed, &mut self.bytes)?;
        let (counts, planes) = self.bytes.split_at(4096);
        let number = planes.len() / 5;
        let planes: [&[u8]; 5] = std::array::from_fn(|plane| &planes[plane * number..(plane + 1) * number]);
        let word = |plane: usize, at: usize| u32::from(planes[plane][at]) | u32::from(planes[plane + 1][at]) << 8;
        let span = |at| {
            let bottom = word(0, at);
            Span::new(bottom, bottom + word(2, at), planes[4][at] == 1).ok_or("a span that is none")
        };
        self.builder.clear();
        let mut next = 0;
        for (pixel, &count) in (0u32..).zip(counts) {
            self.spans.clear();
            for at in next..next + usize::from(count) {
                self.spans.push(span(at)?);
            }
            next += usize::from(count);
            if count > 0 && !self.builder.set_column(pixel % 64, pixel / 64, &self.spans) {
                return Err("spans that are no column".into());
            }
        }
        Ok(self.builder.build())
    }
}
