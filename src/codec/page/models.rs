//! Symbol models of the page coding, and their initial state.

use super::BOUNDARY;
use crate::codec::interleaved::{Bit, Nibble};

/// Weights around the most common symbol of a height, which is at index 15.
const SHAPE: [u16; 31] =
    [8, 8, 8, 8, 8, 8, 8, 8, 12, 16, 20, 35, 60, 110, 210, 300, 110, 45, 20, 12, 8, 6, 4, 3, 2, 2, 2, 2, 2, 2, 2];
/// Most common symbol of a bottom, by context, and of a thickness, by its class unless that is 0.
const BOTTOM_PEAKS: [[usize; 16]; 2] =
    [[9, 6, 4, 6, 7, 9, 9, 9, 3, 3, 4, 5, 6, 6, 8, 10], [8, 6, 2, 7, 8, 11, 9, 9, 1, 2, 5, 6, 8, 9, 10, 12]];
const THICKNESS_PEAKS: [[usize; 8]; 2] = [[0, 3, 5, 6, 7, 8, 9, 11], [0, 6, 7, 8, 9, 10, 11, 12]];
/// Weights of thicknesses where thin spans are expected.
const THIN: [[u16; 16]; 2] = [
    [450, 30, 60, 60, 60, 70, 80, 80, 70, 50, 30, 15, 6, 3, 2, 2],
    [300, 95, 95, 45, 60, 30, 85, 80, 70, 50, 35, 30, 20, 5, 2, 5],
];
/// Weights of numbers of spans, by the larger of those in the west and north: up to 1, 2, 3 or more.
const COUNTS: [[u16; 16]; 3] = [
    [880, 80, 20, 6, 3, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1],
    [450, 390, 100, 30, 10, 5, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1],
    [200, 280, 240, 120, 60, 35, 20, 10, 5, 2, 1, 1, 1, 1, 1, 1],
];
/// By the number of occupied pixels among the six before.
const PIXELS_BEFORE: [u16; 7] = [3300, 8500, 17000, 19500, 21500, 24000, 28000];
const RARE: u16 = 1 << 10;

/// All adaptive models, reset for each page because pages are read independently.
#[derive(Debug, Clone)]
pub struct Models {
    pub count: [Nibble; 16],
    pub bottom: [Nibble; 16],
    pub thickness: [Nibble; 80],
    /// Offsets of bottom and top from the usual heights of their steps: three by three cases.
    pub off: Nibble,
    /// By the states of the blocks in the west and north: whether a block is occupied at all, and in all pixels.
    pub matter: [Bit; 9],
    pub full: [Bit; 9],
    /// By the six pixels before.
    pub pixel: [Bit; 64],
    /// Whether the offsets differ from those that the steps had last, by what is known of the steps.
    pub surprise: [Bit; 16],
    /// By obstacles among the candidates, number of candidates, and whether the span is thick; 50 are used.
    pub kind: [Bit; 64],
}

fn around(peak: usize) -> Nibble {
    let (mut weights, mut symbol) = ([2; 16], 0);
    while symbol < BOUNDARY as usize {
        weights[symbol] = SHAPE[15 + symbol - peak];
        symbol += 1;
    }
    Nibble::new(weights)
}

/// Returns the initial models, averaged over pages of nine scans; `steps` is the index of the alphabet.
pub fn fresh(steps: usize) -> Models {
    const UNSET: Nibble = Nibble::new([1; 16]);
    const RARELY: Bit = Bit::new(RARE);
    let mut models = Models {
        count: [UNSET; 16],
        bottom: [UNSET; 16],
        thickness: [Nibble::new(THIN[steps]); 80],
        off: UNSET,
        matter: [RARELY; 9],
        full: [RARELY; 9],
        pixel: [RARELY; 64],
        surprise: [RARELY; 16],
        kind: [RARELY; 64],
    };
    let mut at = 0;
    while at < 80 {
        if at < 9 {
            models.matter[at] = Bit::new(match at / 3 + at % 3 {
                0 => 2600,
                1 => 21500,
                _ => 31000,
            });
            models.full[at] = Bit::new(match at {
                8 => 29000,
                2 | 6 => 23000,
                5 | 7 => 12500,
                _ => 1500,
            });
        }
        if at < 16 {
            let most = if at / 4 > at % 4 { at / 4 } else { at % 4 };
            models.count[at] = Nibble::new(COUNTS[most.saturating_sub(1)]);
            models.bottom[at] = around(BOTTOM_PEAKS[steps][at]);
        }
        if at < 50 {
            let (obstacles, candidates) = (at / 10, at / 2 % 5);
            let thin = (2 * obstacles + 1) << 15;
            let thick = (2 * obstacles + 3) << 15;
            let ones = if at % 2 == 0 { thin / (4 * candidates + 8) } else { thick / (2 * candidates + 4) };
            models.kind[at] = Bit::new(if ones > 32000 { 32000 } else { ones as u16 });
        }
        if at < 64 {
            models.pixel[at] = Bit::new(PIXELS_BEFORE[at.count_ones() as usize]);
        }
        if at >= 10 {
            models.thickness[at] = around(THICKNESS_PEAKS[steps][at / 10]);
        }
        at += 1;
    }
    models
}
