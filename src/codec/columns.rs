//! Model 1, `columns`: all spans of all pixels, each predicted from those of its neighbours (specification, chapter 6).
//!
//! Laid out as separate byte strings, so that equal things lie together for zstd: occupancy rows, span counts, bottoms
//! (low bytes, then high bytes), thicknesses likewise, obstacle bits. A span is predicted from the spans at its own
//! height in the four neighbours that are coded already; what is stored is the difference.
//!
//! A page of two pixels, (0, 0) with the floor span 10..=14 and (1, 0) with 12..=15: occupancy row 0 is 3, the counts
//! are 1, 1. The first span is predicted as 0..=0, so its bottom is stored as zigzag(10) = 20 and its thickness as
//! zigzag(4) = 8. The second is predicted as 10..=14: bottom zigzag(2) = 4, thickness zigzag(3 - 4) = 1.

use super::{MAX_PAGE_SPANS, Violation};
use crate::slice::{Page, PageBuilder, Span};

const ROWS: usize = 64;
const PIXELS: usize = ROWS * 64;
/// Most spans in one pixel.
const MAX_COLUMN: usize = 64;
/// Differences are taken modulo 2¹⁴, which holds every height of a page.
const MODULUS: u32 = 1 << 14;

/// Greatest length of an encoding (bytes).
pub const MAX_LEN: usize = ROWS * 8 + PIXELS + 4 * MAX_PAGE_SPANS + MAX_PAGE_SPANS / 8;

/// Spans coded so far, and where each pixel's begin; reused from page to page.
#[derive(Debug)]
pub struct Scratch {
    /// Per pixel in row order, and one more: index of its first span. Valid up to the pixel in work.
    first: Box<[u32]>,
    spans: Vec<Span>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self { first: vec![0; PIXELS + 1].into(), spans: Vec::new() }
    }
}

/// The spans of the four neighbours coded already (west, north, north-west, north-east) that are still to be passed by
/// the spans of the pixel in work.
type Neighbours = [std::ops::Range<u32>; 4];

impl Scratch {
    /// Neighbours of `pixel`, all of whose predecessors are in.
    #[inline]
    fn neighbours(&self, pixel: usize) -> Neighbours {
        let of = |exists: bool, back: usize| {
            if exists { self.first[pixel - back]..self.first[pixel - back + 1] } else { 0..0 }
        };
        let (px, below_first_row) = (pixel & 63, pixel >= 64);
        [of(px > 0, 1), of(below_first_row, 64), of(below_first_row && px > 0, 65), of(below_first_row && px < 63, 63)]
    }

    /// Bottom and thickness expected of the next span of the pixel in work; `below` is the span beneath it in the
    /// same pixel. Moves past the neighbours' spans that `below` rules out.
    ///
    /// A median follows edges where a mean would blur them: on six scans, bottoms and thicknesses by the second least
    /// of four neighbours took 5 % (indoors 15 %) fewer bytes than by the mean of two.
    #[inline]
    fn predict(&self, neighbours: &mut Neighbours, below: Option<Span>) -> (u32, u32) {
        let mut found = 0;
        let (mut bottoms, mut thicknesses) = ([u32::MAX; 4], [u32::MAX; 4]);
        for range in neighbours {
            while let Some(&span) = self.spans.get(range.start as usize).filter(|_| range.start < range.end) {
                if below.is_none_or(|below| span.bottom() > below.top()) {
                    bottoms[found] = span.bottom();
                    thicknesses[found] = span.top() - span.bottom();
                    found += 1;
                    break;
                }
                range.start += 1;
            }
        }
        match (found, below, self.spans.last()) {
            (3.., _, _) => (second_least(bottoms), second_least(thicknesses)),
            (1.., _, _) => (bottoms[0], thicknesses[0]),
            (0, Some(below), _) => (below.top(), below.top() - below.bottom()),
            (0, None, Some(last)) => (last.bottom(), last.top() - last.bottom()),
            (0, None, None) => (0, 0),
        }
    }
}

#[inline]
fn second_least([a, b, c, d]: [u32; 4]) -> u32 {
    let (least, rest) = (a.min(b).max(c.min(d)), a.max(b).min(c.max(d)));
    least.min(rest)
}

/// `value - expected` modulo 2¹⁴ with the sign folded into the lowest bit, 0..2¹⁴.
#[inline]
fn fold(value: u32, expected: u32) -> u32 {
    let difference = (value.wrapping_sub(expected) << 18) as i32 >> 18;
    (difference << 1 ^ difference >> 31) as u32
}

/// Inverse of [`fold`] for `folded` below 2¹⁴.
#[inline]
fn unfold(folded: u32, expected: u32) -> u32 {
    expected.wrapping_add(folded >> 1 ^ (folded & 1).wrapping_neg()) & (MODULUS - 1)
}

/// Appends the encoding of `page`, at most [`MAX_LEN`] bytes.
pub fn encode(page: &Page, scratch: &mut Scratch, out: &mut Vec<u8>) {
    scratch.spans.clear();
    let rows_at = out.len();
    out.resize(rows_at + ROWS * 8, 0);
    for (py, row) in out[rows_at..].chunks_exact_mut(8).enumerate() {
        let bits = (0..64u32).fold(0u64, |bits, px| bits | (!page.column(px, py as u32).is_empty() as u64) << px);
        row.copy_from_slice(&bits.to_le_bytes());
    }
    out.extend(page.columns().map(|(_, _, spans)| spans.len() as u8));

    let count = page.span_count();
    let planes_at = out.len();
    out.resize(planes_at + 4 * count + count.div_ceil(8), 0);
    let (planes, flags) = out[planes_at..].split_at_mut(4 * count);
    let mut put = |plane: usize, at: usize, folded: u32| {
        planes[plane * count + at] = folded as u8;
        planes[(plane + 1) * count + at] = (folded >> 8) as u8;
    };
    let mut at = 0;
    for pixel in 0..PIXELS {
        scratch.first[pixel] = at as u32;
        let spans = page.column(pixel as u32 % 64, pixel as u32 / 64);
        let mut neighbours = scratch.neighbours(pixel);
        let mut below = None;
        for &span in spans {
            let (bottom, thickness) = scratch.predict(&mut neighbours, below);
            put(0, at, fold(span.bottom(), bottom));
            put(2, at, fold(span.top() - span.bottom(), thickness));
            flags[at / 8] |= (span.is_obstacle() as u8) << (at % 8);
            scratch.spans.push(span);
            below = Some(span);
            at += 1;
        }
        scratch.first[pixel + 1] = at as u32;
    }
}

/// Fills `builder`, which must be empty, from the encoding `body`.
pub fn decode(body: &[u8], scratch: &mut Scratch, builder: &mut PageBuilder) -> Result<(), Violation> {
    scratch.spans.clear();
    let short = |part: &str| Violation::new("P6", format!("{part} in full"), format!("{} bytes", body.len()));
    let (rows, rest) = body.split_at_checked(ROWS * 8).ok_or_else(|| short("64 occupancy rows"))?;
    let mut occupancy = [0u64; ROWS];
    for (bits, row) in occupancy.iter_mut().zip(rows.chunks_exact(8)) {
        *bits = row.iter().rev().fold(0, |bits, &byte| bits << 8 | byte as u64);
    }
    let pixels = occupancy.iter().map(|bits| bits.count_ones() as usize).sum();
    if pixels == 0 {
        return Err(Violation::new("P6", "matter in some pixel", "none"));
    }
    let (counts, rest) = rest.split_at_checked(pixels).ok_or_else(|| short("a count for each occupied pixel"))?;
    if let Some(bad) = counts.iter().find(|&&count| !(1..=MAX_COLUMN).contains(&(count as usize))) {
        return Err(Violation::new("P7", "1 to 64 spans in an occupied pixel", bad));
    }
    let count: usize = counts.iter().map(|&count| count as usize).sum();
    if rest.len() != 4 * count + count.div_ceil(8) {
        let expected = format!("{} bytes for {count} spans", 4 * count + count.div_ceil(8));
        return Err(Violation::new("P6", expected, rest.len()));
    }
    let (planes, flags) = rest.split_at(4 * count);
    let plane = |index: usize| &planes[index * count..][..count];
    let (bottom_low, bottom_high, thick_low, thick_high) = (plane(0), plane(1), plane(2), plane(3));
    if bottom_high.iter().chain(thick_high).any(|&high| high >= (MODULUS >> 8) as u8) {
        return Err(Violation::new("P7", "differences below 16384", "a greater one"));
    }
    if flags.get(count / 8).is_some_and(|last| last >> (count % 8) != 0) {
        return Err(Violation::new("P7", "zero bits after the last obstacle bit", "others"));
    }

    let (mut at, mut counts) = (0, counts.iter());
    for pixel in 0..PIXELS {
        let first = at;
        scratch.first[pixel] = at as u32;
        if occupancy[pixel / 64] >> (pixel % 64) & 1 == 1 {
            let mut neighbours = scratch.neighbours(pixel);
            let mut below = None;
            // One count per occupied pixel, and their sum is the length of every plane: both checked above.
            for _ in 0..counts.next().copied().unwrap_or(0) {
                let folded = |low: &[u8], high: &[u8]| low[at] as u32 | (high[at] as u32) << 8;
                let (bottom, thickness) = scratch.predict(&mut neighbours, below);
                let bottom = unfold(folded(bottom_low, bottom_high), bottom);
                let thickness = unfold(folded(thick_low, thick_high), thickness);
                let obstacle = flags[at / 8] >> (at % 8) & 1 == 1;
                let span = Span::new(bottom, bottom + thickness, obstacle).ok_or_else(|| {
                    let found = format!("{bottom}..={}", bottom + thickness);
                    Violation::new("P8", "a span inside the page", found)
                })?;
                scratch.spans.push(span);
                below = Some(span);
                at += 1;
            }
            if !builder.set_column(pixel as u32 % 64, pixel as u32 / 64, &scratch.spans[first..at]) {
                let found = format!("{:?} in pixel ({}, {})", &scratch.spans[first..at], pixel % 64, pixel / 64);
                return Err(Violation::new("P8", "spans apart, lowest first", found));
            }
        }
        scratch.first[pixel + 1] = at as u32;
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::codec::{MAX_RAW_PAGE, RawDecoder, RawEncoder};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// Spans of pixels, as a page holds them: a smooth floor, a wall, noise, or all 64 slices, in a part of the pixels.
    pub fn pages() -> impl Strategy<Value = Page> {
        let column = proptest::collection::btree_map(0u32..64, (0u32..250, 0u32..4, any::<bool>()), 1..5);
        let noise = proptest::collection::btree_map((0u32..64, 0u32..64), column, 1..150);
        let floor = (0u32..16000, -8i32..9, -8i32..9, 1u32..40);
        (noise, floor, 0u32..65, 0u32..65, any::<bool>()).prop_map(|(noise, floor, width, depth, tower)| {
            let mut builder = PageBuilder::default();
            for pixel in 0..PIXELS as u32 {
                let (px, py) = (pixel % 64, pixel / 64);
                let spans: Vec<Span> = match noise.get(&(px, py)) {
                    Some(parts) => noisy(parts),
                    None if px < width && py < depth && tower => {
                        (0..64).map(|k| Span::new(255 * k + px, 255 * k + px + py, k % 3 == 1).unwrap()).collect()
                    }
                    None if px < width && py < depth => {
                        let (base, dx, dy, thick) = floor;
                        let bottom = base as i32 + dx * px as i32 + dy * py as i32 + (px * py % 5) as i32;
                        let bottom = bottom.clamp(0, 16319) as u32;
                        vec![Span::new(bottom, (bottom + thick).min(16320), px == 7).unwrap()]
                    }
                    None => continue,
                };
                assert!(builder.set_column(px, py, &spans));
            }
            builder.build()
        })
    }

    fn noisy(parts: &BTreeMap<u32, (u32, u32, bool)>) -> Vec<Span> {
        parts.iter().map(|(k, &(b, h, kind))| Span::new(k * 255 + b, k * 255 + b + h, kind).unwrap()).collect()
    }

    fn encoded(page: &Page) -> Vec<u8> {
        let mut raw = Vec::new();
        RawEncoder::default().encode(page, &mut raw);
        raw
    }

    #[test]
    fn the_page_of_the_module_text_has_the_bytes_of_the_module_text() {
        let mut builder = PageBuilder::default();
        assert!(builder.set_column(0, 0, &[Span::new(10, 14, false).unwrap()]));
        assert!(builder.set_column(1, 0, &[Span::new(12, 15, false).unwrap()]));
        let raw = encoded(&builder.build());
        let rows = [&[3][..], &[0; 511]].concat();
        assert_eq!(raw, [&[1][..], &rows, &[1, 1], &[20, 4, 0, 0], &[8, 1, 0, 0], &[0]].concat());
    }

    #[test]
    fn the_largest_page_has_the_stated_length() {
        let mut builder = PageBuilder::default();
        for pixel in 0..PIXELS as u32 {
            let spans: Vec<_> = (0..64).map(|k| Span::new(255 * k, 255 * k + pixel % 200, true).unwrap()).collect();
            assert!(builder.set_column(pixel % 64, pixel / 64, &spans));
        }
        let page = builder.build();
        let raw = encoded(&page);
        assert_eq!(raw.len(), MAX_RAW_PAGE);
        assert_eq!(RawDecoder::default().decode(&raw).unwrap(), page);
    }

    #[test]
    fn the_second_least_is_the_middle_one_of_three() {
        for (values, second) in [([4, 1, 3, 2], 2), ([1, 1, 0, 9], 1), ([7, 5, 6, u32::MAX], 6), ([5, 5, 5, 5], 5)] {
            for turn in 0..4 {
                let mut turned = values;
                turned.rotate_left(turn);
                assert_eq!(second_least(turned), second);
                turned.swap(0, 1);
                assert_eq!(second_least(turned), second);
            }
        }
    }

    #[test]
    fn folding_is_a_bijection() {
        for expected in [0, 1, 8191, 8192, 16320, 32640] {
            let mut folded: Vec<u32> = (0..MODULUS).map(|value| fold(value, expected)).collect();
            assert!((0..MODULUS).all(|value| unfold(folded[value as usize], expected) == value));
            folded.sort_unstable();
            assert!(folded.into_iter().eq(0..MODULUS));
        }
    }

    proptest! {
        #[test]
        fn pages_round_trip(pages in proptest::collection::vec(pages(), 1..4)) {
            let (mut encoder, mut decoder) = (RawEncoder::default(), RawDecoder::default());
            let mut raw = Vec::new();
            for page in pages {
                encoder.encode(&page, &mut raw);
                prop_assert!(raw.len() <= MAX_RAW_PAGE && raw == encoded(&page));
                prop_assert_eq!(decoder.decode(&raw).unwrap(), page);
            }
        }

        #[test]
        fn what_decodes_is_canonical(page in pages(), flips in proptest::collection::vec(any::<(prop::sample::Index, u8)>(), 1..4)) {
            let mut raw = encoded(&page);
            for (at, value) in flips {
                let place = at.index(raw.len());
                raw[place] = value;
            }
            match RawDecoder::default().decode(&raw) {
                Ok(page) => prop_assert_eq!(encoded(&page), raw),
                Err(violation) => prop_assert!(["P5", "P6", "P7", "P8"].contains(&violation.rule)),
            }
        }

        #[test]
        fn random_bytes_never_panic(mut raw in proptest::collection::vec(any::<u8>(), 0..2000), sparse: bool) {
            if let Some(first) = raw.first_mut() {
                *first = 1;
            }
            if sparse {
                for byte in raw.iter_mut().take(513).skip(4) {
                    *byte = 0;
                }
            }
            let _ = RawDecoder::default().decode(&raw);
        }
    }
}
