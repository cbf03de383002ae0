//! Round trips of pages through the codec.

use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

/// Pages with a smooth floor, a wall, noise, or all 64 slices, in a part of the pixels.
pub fn pages() -> impl Strategy<Value = Page> {
    let column = proptest::collection::btree_map(0u32..64, (0u32..250, 0u32..4, any::<bool>()), 1..5);
    let noise = proptest::collection::btree_map((0u32..64, 0u32..64), column, 1..150);
    let floor = (0u32..16000, -8i32..9, -8i32..9, 1u32..40);
    (noise, floor, 0u32..65, 0u32..65, any::<bool>()).prop_map(|(noise, floor, width, depth, tower)| {
        let mut builder = PageBuilder::default();
        for pixel in 0..64 * 64 {
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

fn frame() -> Frame {
    Frame::new(0.05, 0.15).unwrap()
}

fn encoded(page: &Page) -> Vec<u8> {
    let mut body = Vec::new();
    Encoder::new(frame(), 0).encode(page, &mut body);
    body
}

/// Rounds the heights of `page` to centimetres, as long as its spans stay apart.
fn in_centimetres(page: &Page) -> Page {
    let mut builder = PageBuilder::default();
    for (px, py, spans) in page.columns() {
        let whole = |height: u32| height / 17 * 17;
        let spans: Vec<_> = spans
            .iter()
            .map(|s| Span::new(whole(s.bottom()), (whole(s.top()) + 1).min(16320), s.is_obstacle()).unwrap())
            .collect();
        assert!(builder.set_column(px, py, &spans) || spans.len() > 1);
    }
    builder.build()
}

#[test]
fn the_largest_page_has_less_than_the_stated_length() {
    let mut builder = PageBuilder::default();
    for pixel in 0..64 * 64u32 {
        let height = |k: u32| 255 * k + (pixel.wrapping_mul(2654435761).wrapping_mul(k + 1) >> 7) % 200;
        let span = |k: u32| Span::new(height(k), height(k) + (pixel ^ k) % 50, (pixel ^ k).is_multiple_of(3));
        let spans: Vec<_> = (0..64).map(|k| span(k).unwrap()).collect();
        assert!(builder.set_column(pixel % 64, pixel / 64, &spans));
    }
    let page = builder.build();
    let body = encoded(&page);
    assert!(body.len() <= MAX_BODY, "{} bytes", body.len());
    assert_eq!(Decoder::default().decode(&body).unwrap(), page);
}

#[test]
fn a_floor_in_centimetres_takes_fewer_bytes_than_one_in_quanta() {
    let floor = |unit: u32| {
        let mut builder = PageBuilder::default();
        for pixel in 0..64 * 64u32 {
            // Noise of 5 units around 1 m.
            let bottom = 17 * 100 + pixel.wrapping_mul(2654435761) % 5 * unit;
            assert!(builder.set_column(pixel % 64, pixel / 64, &[Span::new(bottom, bottom + 1, false).unwrap()]));
        }
        let body = encoded(&builder.build());
        assert_eq!(Decoder::default().decode(&body).unwrap(), builder.build());
        body.len()
    };
    assert!(floor(17) < floor(16) * 3 / 4, "{} and {}", floor(17), floor(16));
}

#[test]
fn marks_have_one_form_that_the_page_holds() {
    let mut builder = PageBuilder::default();
    for px in 0..5 {
        assert!(builder.set_column(px, 9, &[Span::new(100, 101, false).unwrap()]));
    }
    let body = encoded(&builder.build());
    // The runs, which are shorter than a byte, and the page without marks.
    let decode = |runs: &[u8]| {
        let marked = [&[MARKED, runs.len() as u8], runs, &body[1..]].concat();
        let mut decoder = Decoder::default();
        let page = decoder.decode(&marked);
        page.map(|page| decoder.inferred().without(&page, &mut PageBuilder::default()).span_count())
    };
    for (runs, scanned) in [(&[0, 5][..], 0), (&[4, 1], 4), (&[1, 2], 3), (&[0, 1, 3, 1], 3), (&[1, 1, 1, 2], 2)] {
        assert_eq!(decode(runs), Ok(scanned), "{runs:?}");
    }
    // Odd numbers of runs, runs of no span but the first, more spans than there are.
    for runs in
        [&[][..], &[5], &[1, 0], &[1, 0, 1, 1], &[1, 1, 0, 1], &[0, 0], &[1, 1, 1], &[4, 2], &[6, 1], &[1, 1, 3, 1]]
    {
        assert_eq!(decode(runs).unwrap_err().rule, "P12", "{runs:?}");
    }
    let long = [&[MARKED, 2, 0][..], &[0x81, 0x80, 0x10], &body[1..]].concat();
    let violation = Decoder::default().decode(&long).unwrap_err();
    assert_eq!((violation.expected.as_str(), violation.found.as_str()), ("a run of 1 to 262144 spans", "262145"));
    let most = [&[MARKED, 2, 0][..], &[0x80, 0x80, 0x10], &body[1..]].concat();
    let violation = Decoder::default().decode(&most).unwrap_err();
    assert_eq!(violation.expected, "runs of no more floor spans than the page has");
    // More runs than memory holds.
    let many = [&[MARKED, 0xFE, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F][..], &body[1..]].concat();
    assert_eq!(Decoder::default().decode(&many).unwrap_err().rule, "P12");
}

proptest! {
    #[test]
    fn pages_round_trip(pages in proptest::collection::vec(pages(), 1..4), centimetres: bool) {
        let (mut encoder, mut decoder) = (Encoder::new(frame(), 0), Decoder::default());
        for page in pages {
            let page = if centimetres { in_centimetres(&page) } else { page };
            prop_assume!(page.span_count() > 0);
            let mut body = Vec::new();
            encoder.encode(&page, &mut body);
            prop_assert!(body.len() <= MAX_BODY && body == encoded(&page));
            prop_assert_eq!(decoder.decode(&body).unwrap(), page);
        }
    }

    #[test]
    fn what_decodes_encodes_again(page in pages(), flips in proptest::collection::vec(any::<(prop::sample::Index, u8)>(), 1..4)) {
        let mut body = encoded(&page);
        for (at, value) in flips {
            let place = at.index(body.len());
            body[place] = value;
        }
        match Decoder::default().decode(&body) {
            Ok(page) => {
                let again = encoded(&page);
                prop_assert_eq!(Decoder::default().decode(&again).unwrap(), page);
            }
            Err(violation) => prop_assert!(["P5", "P6", "P7", "P8", "P12"].contains(&violation.rule)),
        }
    }

    #[test]
    fn random_bytes_never_panic(mut body in proptest::collection::vec(any::<u8>(), 0..2000), marked: bool) {
        if let Some(first) = body.first_mut() {
            *first = if marked { MARKED } else { PLAIN };
        }
        let _ = Decoder::default().decode(&body);
    }
}

#[test]
fn a_body_without_a_byte_is_refused() {
    assert_eq!(Decoder::default().decode(&[]).unwrap_err().rule, "P5");
}
