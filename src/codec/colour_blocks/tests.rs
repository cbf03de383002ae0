//! Round trips, errors and bytes of colour blocks.

use super::*;
use crate::page::{PageBuilder, Span};
use proptest::prelude::*;

fn occupancy(columns: impl IntoIterator<Item = ((u32, u32), (u32, u32))>) -> Occupancy {
    let mut builder = PageBuilder::default();
    for ((px, py), (bottom, height)) in columns {
        let span = Span::new(bottom, (bottom + height).min(16320), false).unwrap();
        assert!(builder.set_column(px, py, &[span]));
    }
    Occupancy::of(&builder.build())
}

fn mean_error(colours: &[Option<[u16; 3]>], found: &Colours) -> f64 {
    let table = LabTable::get();
    let (mut sum, mut count) = (0.0, 0.0);
    for (exact, (.., found)) in colours.iter().zip(found.voxels()) {
        assert_eq!(exact.is_some(), found.is_some());
        if let (Some(exact), Some(found)) = (exact, found) {
            sum += f64::from(difference(table.of_16_bits(*exact), table.of_8_bits(found)));
            count += 1.0;
        }
    }
    sum / count
}

#[test]
fn multiplications_divide_exactly() {
    for step in 1..=MOST_STEP {
        for step in steps_for(step) {
            let (divisor, step) = (257 * i32::from(step), u32::from(step));
            let by = Divisor::new(257 * step);
            // Around all multiples of halves, where quotients change.
            for half in (0..=65_535 / divisor * 2 + 1).map(|n| n * divisor / 2) {
                for value in [half - 1, half, half + 1].into_iter().flat_map(|v| [v, -v]).filter(|v| v.abs() <= 65_535)
                {
                    let expected = (value.abs() + divisor / 2) / divisor * value.signum();
                    assert_eq!(i32::from(by.nearest(value)), expected, "{value} / {divisor}");
                }
            }
        }
    }
    for weight in 1..=MOST_WEIGHT as i32 {
        for sum in -255 * weight..=255 * weight {
            assert_eq!(mean(sum, weight), (2 * sum + weight).div_euclid(2 * weight), "{sum} / {weight}");
        }
    }
}

fn code(block: &mut ColourBlock, occupancy: &Occupancy) -> Vec<u8> {
    let mut bytes = Vec::new();
    block.encode(occupancy, &mut ColourEncoder::default(), &mut bytes);
    assert!(bytes.len() <= MAX_COLOUR_BLOCK);
    bytes
}

/// Walls, floors, gaps and noise, with and without colours: the same bytes in every version.
#[test]
fn blocks_of_all_kinds_have_the_bytes_that_they_always_had() {
    let mut state = 1u64;
    let mut random = |below: u64| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) % below
    };
    let mut hash = xxhash_rust::xxh3::Xxh3::new();
    let mut lens = Vec::new();
    for (tall, dense, noise) in [(300, 90, 900), (6000, 60, 0), (60, 100, 20_000), (2500, 10, 4000)] {
        let mut columns = Vec::new();
        for (px, py) in (0..64).flat_map(|py| (0..64).map(move |px| (px, py))) {
            if random(100) < dense {
                columns.push(((px, py), (u64::from(px * 40 + py * 25) as u32, random(tall) as u32)));
            }
        }
        let occupancy = occupancy(columns);
        let colours: Vec<Option<[u16; 3]>> = occupancy
            .voxels()
            .map(|(pixel, k)| {
                let smooth = (pixel as u64 * 11 + u64::from(k) * 700) % 40_000;
                let colour = [0, 3000, 9000].map(|channel| (smooth + channel + random(noise + 1)) as u16);
                (random(12) > 0).then_some(colour)
            })
            .collect();
        for error_milli in [0, 500, 3000] {
            let mut block = ColourBlock::quantise(&colours, error_milli, &mut ColourEncoder::default()).unwrap();
            let bytes = code(&mut block, &occupancy);
            hash.update(&bytes);
            lens.push(bytes.len());
        }
    }
    let expected = [5862, 4674, 1394, 12700, 6168, 4188, 11342, 10292, 5456, 4278, 3690, 1444];
    assert_eq!((lens.as_slice(), hash.digest()), (&expected[..], 0x965c0188a8d5a5f1));
}

fn any_columns() -> impl Strategy<Value = std::collections::BTreeMap<(u32, u32), (u32, u32)>> {
    proptest::collection::btree_map((0u32..64, 0u32..64), (0u32..16000, 0u32..2000), 1..80)
}

proptest! {
    #[test]
    fn blocks_come_back_and_stay_within_their_error(
        columns in any_columns(), seed: u64, smooth: bool, error_milli in prop_oneof![Just(0u16), Just(2000), 300u16..9000]
    ) {
        let occupancy = occupancy(columns);
        let mut state = seed | 1;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as u32
        };
        let colours: Vec<Option<[u16; 3]>> = occupancy.voxels().map(|(pixel, k)| {
            let base = (pixel as u32 * 7 + k * 300) % 40_000;
            let colour = std::array::from_fn(|at| match smooth {
                true => (base + at as u32 * 3000 + random() % 2500) as u16,
                false => random() as u16,
            });
            (random() % 9 > 0).then_some(colour)
        }).collect();
        let Some(mut block) = ColourBlock::quantise(&colours, error_milli, &mut ColourEncoder::default()) else {
            prop_assert!(colours.iter().all(Option::is_none));
            return Ok(());
        };
        let before = block.clone();
        let bytes = code(&mut block, &occupancy);
        prop_assert_eq!(&block, &before);
        prop_assert!(block.is_of(&colours));
        let rgb: Vec<_> = block.colours(occupancy.clone()).unwrap().voxels().map(|(.., colour)| colour).collect();
        prop_assert_eq!(block.rgb().collect::<Vec<_>>(), rgb);
        prop_assert_eq!(&ColourBlock::decode(&bytes, &occupancy).unwrap(), &block);
        let found = block.colours(occupancy.clone()).unwrap();
        prop_assert_eq!(found.count(), block.count());
        let error = mean_error(&colours, &found);
        // If no wider steps fit, 8-bit colours are taken.
        prop_assert!(block.steps == [1; 3] || error <= f64::from(error_milli) / 1000.0 + 1e-4, "{}", error);
        if error_milli == 0 {
            for (exact, (.., found)) in colours.iter().zip(found.voxels()) {
                prop_assert_eq!(exact.map(|exact| exact.map(to_8_bits)), found);
            }
        }
        // Damaged bytes give an error or some block.
        let mut damaged = bytes.clone();
        let at = random() as usize % damaged.len();
        damaged[at] ^= 1 << (random() % 8);
        let _ = ColourBlock::decode(&damaged, &occupancy);
        prop_assert!(ColourBlock::decode(&bytes[..bytes.len() - 1], &occupancy).is_err());
    }

    #[test]
    fn any_bytes_are_refused_or_decoded(columns in any_columns(), bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let occupancy = occupancy(columns);
        if let Ok(block) = ColourBlock::decode(&[&[1, 3, 4, 2][..], &bytes].concat(), &occupancy) {
            prop_assert!(block.count() > 0);
        }
    }

    #[test]
    fn luma_and_differences_are_reversible(rgb: [u8; 3]) {
        prop_assert_eq!(rgb_of(ycocg(rgb)), rgb);
    }
}

#[test]
fn parts_keep_the_colours_of_their_voxels() {
    let whole = occupancy((0..40).map(|at| ((at, 3), (at * 100, 900))));
    let part = occupancy((10..20).map(|at| ((at, 3), (at * 100, 300))));
    let colours: Vec<_> = whole.voxels().map(|(pixel, k)| Some([(pixel * 900) as u16, (k * 1000) as u16, 5])).collect();
    let block = ColourBlock::quantise(&colours, 2000, &mut ColourEncoder::default()).unwrap();
    let cut = block.part(&whole, &part).unwrap();
    let (all, some) = (block.colours(whole).unwrap(), cut.colours(part.clone()).unwrap());
    for (pixel, k) in part.voxels() {
        let (px, py) = (pixel as u32 & 63, pixel as u32 >> 6);
        assert_eq!(some.of(px, py, k), all.of(px, py, k));
        assert!(some.of(px, py, k).is_some());
    }
}

#[test]
fn voxels_of_which_none_has_a_colour_have_no_block() {
    let colours = [Some([900, 5, 5]), Some([9000, 5, 5])];
    let block = ColourBlock::quantise(&colours, 2000, &mut ColourEncoder::default()).unwrap();
    assert_eq!(ColourBlock::pieced([Some(&block), None], [(1, Some(0)), (0, None)].into_iter()), None);
    assert!(ColourBlock::pieced([Some(&block), None], [(1, Some(0)), (0, Some(1))].into_iter()).is_some());
}

#[test]
fn a_block_shorter_than_its_lead_is_refused() {
    let lead = [MODEL, 3, 4, 2];
    for len in 0..lead.len() {
        assert_eq!(ColourBlock::decode(&lead[..len], &occupancy([])).unwrap_err().rule, "K5");
    }
}

#[test]
fn models_steps_and_numbers_out_of_range_are_refused() {
    let one = occupancy([((0, 0), (0, 10))]);
    // The first luma is expected at 128, in steps: the same residual leads to other numbers with other steps.
    let decode = |model: u8, step: u8, luma: i16| {
        let coded = code(&mut ColourBlock { steps: [1; 3], values: vec![[luma, 0, 0]] }, &one);
        let bytes = [&[model, step, 1, 1], &coded[LEAD..]].concat();
        ColourBlock::decode(&bytes, &one).map(|block| block.values[0]).map_err(|violation| violation.rule)
    };
    for (step, most) in [(2, 128), (3, 85), (4, 64), (255, 1)] {
        let luma = 128 - 128 / i16::from(step) + most;
        assert_eq!(decode(MODEL, step, luma), Ok([most, 0, 0]), "{step}");
        assert_eq!(decode(MODEL, step, luma + 1), Err("K7"), "{step}");
    }
    assert_eq!(decode(MODEL, 1, 0), Ok([0; 3]));
    assert_eq!(decode(MODEL, 2, 63), Err("K7"));
    assert_eq!(decode(MODEL + 1, 1, 0), Err("K5"));
    assert_eq!(decode(MODEL, 0, 0), Err("K5"));
}

#[test]
fn pieces_of_one_pair_of_steps_keep_their_numbers() {
    let block = |steps, values: &[[i16; 3]]| ColourBlock { steps, values: values.to_vec() };
    let (a, b) = (block([3, 4, 2], &[[5, 1, -1], [6, 0, 0]]), block([3, 4, 2], &[[7, 2, 1]]));
    let pieced = |b| ColourBlock::pieced([Some(&a), Some(b)], [(0, Some(1)), (1, Some(0)), (0, None)].into_iter());
    assert_eq!(pieced(&b), Some(block([3, 4, 2], &[[6, 0, 0], [7, 2, 1], [ABSENT, 0, 0]])));
    assert_eq!(pieced(&block([1; 3], &[[7, 2, 1]])), Some(block([1; 3], &[[18, 0, 0], [7, 2, 1], [ABSENT, 0, 0]])));
}
