//! Encodings of pages are those of the format, byte for byte: the same points make the same archive in every version.

use crate::random;

use random::Random;
use slicewalk::codec::Encoder;
use slicewalk::frame::{Frame, PAGE_QUANTA, SLICE_QUANTA};
use slicewalk::page::{Inferred, Page, PageBuilder, Span};
use xxhash_rust::xxh3::Xxh3;

/// Content of a page.
struct Terrain {
    /// Of the instrument's heights (quanta), 0 for none; and deviation of its noise (steps, or quanta).
    step: f64,
    noise: f64,
    /// Per hundred pixels: the occupied ones, and the obstacles among these.
    dense: usize,
    obstacles: usize,
    /// Most floors above each other.
    storeys: usize,
}

/// Thicknesses around every length of a number, so around every class of them (quanta).
fn thickness(random: &mut Random) -> u32 {
    let power = 1u32 << random.below(13u32);
    (power + random.below(4u32)).saturating_sub(2)
}

fn page(terrain: &Terrain, random: &mut Random) -> Page {
    let quanta = |height: f64, up: bool| {
        let steps = if terrain.step > 0.0 { (height / terrain.step).round() * terrain.step } else { height };
        let quanta = if up { steps.ceil() } else { steps.floor() };
        quanta.clamp(0.0, (PAGE_QUANTA - 1) as f64) as u32
    };
    let slope = [random.between(-40.0, 40.0), random.between(-40.0, 40.0)];
    let start = random.between(0.0, 9000.0);
    let mut builder = PageBuilder::default();
    for pixel in 0..64 * 64 {
        if !random.chance(terrain.dense) {
            continue;
        }
        let (px, py) = (pixel % 64, pixel / 64);
        let mut spans: Vec<Span> = Vec::new();
        for storey in 0..=random.below(terrain.storeys) {
            let height = start + slope[0] * f64::from(px) + slope[1] * f64::from(py) + 2700.0 * storey as f64;
            let bottom = height + terrain.noise * terrain.step.max(1.0) * random.normal();
            let top = bottom + f64::from(thickness(random));
            let (bottom, top) = (quanta(bottom, false), quanta(top, true).max(quanta(bottom, false)));
            let slices = SLICE_QUANTA as u32;
            let is_apart = spans.last().is_none_or(|last| last.top().div_ceil(slices) < bottom / slices);
            spans.extend(Span::new(bottom, top, random.chance(terrain.obstacles)).filter(|_| is_apart));
        }
        assert!(spans.is_empty() || builder.set_column(px, py, &spans), "{spans:?}");
    }
    builder.build()
}

/// Pages of all kinds: flat and steep, with and without steps of an instrument, full and nearly empty.
fn pages() -> impl Iterator<Item = Page> {
    let mut random = Random(7);
    let mut terrains = Vec::new();
    for step in [0.0, 17.0, 8.5, 255.0, 91.0] {
        for noise in [0.0, 0.6, 30.0] {
            for (dense, obstacles, storeys) in [(100, 3, 1), (80, 50, 3), (4, 100, 6)] {
                terrains.push(Terrain { step, noise, dense, obstacles, storeys });
            }
        }
    }
    terrains.into_iter().map(move |terrain| page(&terrain, &mut random))
}

/// Spans close above each other, within the tolerance of most neighbours.
fn crowded(random: &mut Random) -> Page {
    let mut builder = PageBuilder::default();
    for pixel in 0..64 * 64 {
        let (mut spans, mut low) = (Vec::new(), 900 + random.below(40u32));
        for _ in 0..=random.below(7u32) {
            let top = low + random.below(40u32);
            spans.extend(Span::new(low, top, random.chance(20)));
            low = top + 2 + random.below(60u32);
        }
        assert!(builder.set_column(pixel % 64, pixel / 64, &spans));
    }
    builder.build()
}

/// Every third span of a page, if it is a floor.
fn third(page: &Page) -> Inferred {
    let (mut inferred, mut number) = (Inferred::new(), 0);
    for (px, py, spans) in page.columns() {
        let mut mask = 0;
        for (at, span) in spans.iter().enumerate() {
            number += 1;
            mask |= u64::from(number % 3 == 0 && !span.is_obstacle()) << at;
        }
        assert!(inferred.push(px, py, mask));
    }
    inferred
}

/// The page with its lowest spans down to its floor, as where the border of a page cuts a solid.
fn cut(page: &Page) -> Page {
    let mut builder = PageBuilder::default();
    for (px, py, spans) in page.columns() {
        let mut spans = spans.to_vec();
        spans[0] = Span::new(0, spans[0].top(), spans[0].is_obstacle()).unwrap();
        assert!(builder.set_column(px, py, &spans));
    }
    builder.build()
}

/// The pixels of the page in a disc around one of them: full blocks, cut ones and empty ones side by side.
fn disc(page: &Page, (x, y): (u32, u32)) -> Page {
    let mut builder = PageBuilder::default();
    for (px, py, spans) in page.columns() {
        let is_in = px.abs_diff(x).pow(2) + py.abs_diff(y).pow(2) < 500;
        assert!(!is_in || builder.set_column(px, py, spans));
    }
    builder.build()
}

/// Bytes, and their hash, of all pages as `encode` has them.
fn of_all(mut encode: impl FnMut(&Page, &mut Vec<u8>)) -> (usize, u64) {
    let (mut hash, mut len, mut bytes) = (Xxh3::new(), 0, Vec::new());
    for page in pages() {
        bytes.clear();
        encode(&page, &mut bytes);
        hash.update(&bytes);
        len += bytes.len();
    }
    (len, hash.digest())
}

#[test]
fn pages_of_all_kinds_have_the_bytes_that_they_always_had() {
    let frame = Frame::new(0.05, 0.15).unwrap();
    let exact = |tolerance| {
        let mut encoder = Encoder::new(frame, tolerance);
        of_all(|page, out| encoder.encode(page, out))
    };
    let lossy = |tolerance| {
        let mut encoder = Encoder::new(frame, tolerance);
        of_all(|page, out| drop(encoder.encode_lossy(page, &Inferred::NONE, out)))
    };
    let of_discs = || {
        let (mut encoder, mut out) = (Encoder::new(frame, 0), Vec::new());
        for (number, page) in pages().enumerate().filter(|(number, _)| number % 3 == 0) {
            encoder.encode(&disc(&page, ([9, 30, 50][number / 3 % 3], 4 * number as u32)), &mut out);
        }
        (out.len(), xxhash_rust::xxh3::xxh3_64(&out))
    };
    let found = [
        ("discs", of_discs()),
        ("exact", exact(0)),
        ("on steps of 91 quanta", exact(90)),
        ("30 quanta off", lossy(30)),
    ];
    let expected = [
        ("discs", (10_708, 0xe4d99a078a6c50e8)),
        ("exact", (326_960, 0x910354704a00b96c)),
        ("on steps of 91 quanta", (314_227, 0x25dbabef08dd9035)),
        ("30 quanta off", (225_743, 0xe7bbbf7bec485326)),
    ];
    assert_eq!(found, expected);
}

/// Which heights within the tolerance a writer takes is its own choice, but always the same one.
#[test]
fn pages_of_all_kinds_lose_what_they_always_lost() {
    let frame = Frame::new(0.05, 0.15).unwrap();
    let marked = |tolerance| {
        let mut encoder = Encoder::new(frame, tolerance);
        of_all(|page, out| drop(encoder.encode_lossy(page, &third(page), out)))
    };
    let of_cut = |tolerance| {
        let mut encoder = Encoder::new(frame, tolerance);
        of_all(|page, out| drop(encoder.encode_lossy(&cut(page), &Inferred::NONE, out)))
    };
    let of_crowded = |tolerance| {
        let (mut encoder, mut out, mut random) = (Encoder::new(frame, tolerance), Vec::new(), Random(9));
        for _ in 0..3 {
            let page = crowded(&mut random);
            encoder.encode_lossy(&page, &third(&page), &mut out);
        }
        (out.len(), xxhash_rust::xxh3::xxh3_64(&out))
    };
    let found = [
        ("inferred, 30 quanta off", marked(30)),
        ("inferred, 3 quanta off", marked(3)),
        ("cut, 30 quanta off", of_cut(30)),
        ("cut, 255 quanta off", of_cut(255)),
        ("crowded, 20 quanta off", of_crowded(20)),
        ("crowded, 85 quanta off", of_crowded(85)),
    ];
    let expected = [
        ("inferred, 30 quanta off", (299_954, 0xb6ea2ecea6cc8720)),
        ("inferred, 3 quanta off", (396_381, 0xb188b1dd25e821f2)),
        ("cut, 30 quanta off", (218_521, 0xcaf88d7eb25c7f8c)),
        ("cut, 255 quanta off", (148_941, 0x1e3c6540c58262a9)),
        ("crowded, 20 quanta off", (101_115, 0x11f5f9355d04fb78)),
        ("crowded, 85 quanta off", (63_065, 0x23ba2c1ef9dfc56b)),
    ];
    assert_eq!(found, expected);
}
