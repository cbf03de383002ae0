//! Lower bound for every coder: the noise of heights on smooth surfaces.

use crate::stability::Result;
use slicewalk::archive::Archive;
use slicewalk::page::Page;
use std::collections::BTreeMap;

/// Steepest change from pixel to pixel on what counts as smooth (quanta).
const SMOOTH_QUANTA: i32 = 64;

/// Entropy of heights beside what their neighbours say.
pub struct Noise {
    /// Spans in smooth surroundings: alone in their pixel, as are those of the eight pixels around, all of them near.
    pub smooth: u64,
    /// All spans.
    pub spans: u64,
    /// Entropy of a bottom, less the median of the eight around, in smooth surroundings (bits).
    pub bottom_bits: f64,
    /// Entropy of a thickness given that of the bottom's length in bits (bits).
    pub thickness_bits: f64,
}

/// The noise in an archive. All eight neighbours are known here, where a decoder knows four: so this is less than what a
/// decoder can do with.
pub fn of(archive: &Archive) -> Result<Noise> {
    let mut bottoms = BTreeMap::<i32, u64>::new();
    let mut thicknesses = BTreeMap::<(u32, i32), u64>::new();
    let (mut smooth, mut spans) = (0, 0);
    for entry in archive.entries() {
        let page = archive.page(&entry?)?;
        spans += page.span_count() as u64;
        for (px, py) in (1..63).flat_map(|py| (1..63).map(move |px| (px, py))) {
            let Some((bottom, thickness)) = beside_neighbours(&page, px, py) else { continue };
            smooth += 1;
            *bottoms.entry(bottom).or_default() += 1;
            *thicknesses.entry((32 - bottom.unsigned_abs().leading_zeros(), thickness)).or_default() += 1;
        }
    }
    let mut of_length = BTreeMap::<u32, Vec<u64>>::new();
    thicknesses.iter().for_each(|((length, _), &count)| of_length.entry(*length).or_default().push(count));
    let bits = of_length.values().map(|counts| entropy(counts) * counts.iter().sum::<u64>() as f64).sum::<f64>();
    let counts: Vec<u64> = bottoms.values().copied().collect();
    Ok(Noise { smooth, spans, bottom_bits: entropy(&counts), thickness_bits: bits / (smooth as f64).max(1.0) })
}

/// Bottom and thickness of the only span of a pixel, less the medians of those around; `None` where it is not smooth.
fn beside_neighbours(page: &Page, px: u32, py: u32) -> Option<(i32, i32)> {
    let alone = |x: u32, y: u32| match page.column(x, y) {
        [span] => Some((span.bottom() as i32, (span.top() - span.bottom()) as i32)),
        _ => None,
    };
    let own = alone(px, py)?;
    let (mut bottoms, mut thicknesses) = ([0; 8], [0; 8]);
    let around = (0..9).filter(|&place| place != 4).map(|place| (px + place % 3 - 1, py + place / 3 - 1));
    for (number, (x, y)) in around.enumerate() {
        (bottoms[number], thicknesses[number]) = alone(x, y)?;
    }
    let near = |values: &[i32; 8], own: i32| values.iter().all(|value| (value - own).abs() <= SMOOTH_QUANTA);
    let median = |values: &mut [i32; 8]| {
        values.sort_unstable();
        (values[3] + values[4]) / 2
    };
    let smooth = near(&bottoms, own.0) && near(&thicknesses, own.1);
    smooth.then(|| (own.0 - median(&mut bottoms), own.1 - median(&mut thicknesses)))
}

/// Entropy of a distribution by its counts (bits), with the correction of Miller (1955) for few samples.
fn entropy(counts: &[u64]) -> f64 {
    let all = counts.iter().sum::<u64>() as f64;
    if all == 0.0 {
        return 0.0;
    }
    let plain: f64 = counts.iter().map(|&count| count as f64 / all).map(|share| -share * share.log2()).sum();
    plain + (counts.len() as f64 - 1.0) / (2.0 * all * std::f64::consts::LN_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entropies_of_known_distributions() {
        assert_eq!(entropy(&[]), 0.0);
        assert_eq!(entropy(&[7]), 0.0);
        assert!((entropy(&[1 << 40; 8]) - 3.0).abs() < 1e-9);
    }
}
