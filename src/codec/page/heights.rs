//! Heights as symbols: a residual's class and the remaining bits.

use super::BOUNDARY;
use crate::codec::interleaved::Strands;
use crate::codec::rows::{SLICE, fold};
use crate::codec::step_grid::{End, StepGrid};

/// Smallest residual of each symbol, and number of bits that select one of its residuals.
pub struct Alphabet {
    pub least: [u16; 16],
    pub bits: [u8; 16],
}

/// Alphabets for grids where every quantum is a step, and for others, where steps are few and residuals small.
pub static ALPHABETS: [Alphabet; 2] = [
    Alphabet {
        least: [0, 1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 0],
        bits: [0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 7],
    },
    Alphabet {
        least: [0, 1, 2, 3, 4, 6, 8, 16, 32, 64, 128, 256, 512, 1024, 4096, 0],
        bits: [0, 0, 0, 0, 1, 1, 3, 4, 5, 6, 7, 8, 9, 12, 14, 7],
    },
];

impl Alphabet {
    /// Returns the symbol of a folded residual.
    #[inline]
    pub fn symbol(&self, residual: u32) -> u32 {
        let bits = u32::BITS - residual.leading_zeros();
        // Symbol `n` begins at 2ⁿ⁻¹ or below, and below 1024 it covers at least half of a length.
        let mut symbol = bits.min(14);
        while symbol < 14 && u32::from(self.least[symbol as usize + 1]) <= residual {
            symbol += 1;
        }
        symbol
    }
}

/// A height to code.
#[derive(Clone, Copy, Default)]
pub struct Given {
    height: u32,
    /// Step and offset from its usual height; `None` for a slice boundary that lies on no step.
    pub step: Option<(u32, i32)>,
}

impl Given {
    #[inline(always)]
    pub fn of(grid: &StepGrid, height: u32, end: End) -> Self {
        Self { height, step: grid.index(height, end) }
    }

    /// Returns the symbol and its bits if step `expected` is predicted.
    #[inline(always)]
    pub fn symbol(&self, alphabet: &Alphabet, expected: i32) -> (u32, u32) {
        let Some((step, _)) = self.step else {
            // All other heights have steps, or the grid is not one of this page.
            debug_assert!(self.height.is_multiple_of(SLICE), "no step for {}", self.height);
            return (BOUNDARY, self.height / SLICE);
        };
        let residual = fold(step as i32 - expected);
        let symbol = alphabet.symbol(residual);
        (symbol, residual - u32::from(alphabet.least[symbol as usize & 15]))
    }

    #[inline(always)]
    pub fn off(&self) -> i32 {
        self.step.map_or(0, |(_, off)| off)
    }
}

/// Codes a bit that is 1 if there is a grid, then its step and phase, of each the number of trailing zeros and the rest of
/// its 40 bits, and a bit that is 1 if heights are rounded. Returns `None` if what is decoded is not a grid.
pub fn code_grid(coder: &mut impl Strands, given: StepGrid) -> Option<StepGrid> {
    if coder.raw(1, u32::from(!given.is_quanta())) == 0 {
        return Some(StepGrid::QUANTA);
    }
    let mut number = |given: u64| {
        let zeros = coder.raw(6, given.trailing_zeros().min(40));
        let bits = 40u32.checked_sub(zeros)?;
        let given = given.checked_shr(zeros).unwrap_or(0);
        let (low, high) = (bits.min(20), bits - bits.min(20));
        let low_part = coder.raw(low, (given & ((1 << low) - 1)) as u32);
        let high_part = coder.raw(high, (given >> low) as u32);
        Some((u64::from(high_part) << low | u64::from(low_part)).checked_shl(zeros).unwrap_or(0))
    };
    let grid = StepGrid::new(number(given.step)?, number(given.phase)?)?;
    Some(StepGrid { is_rounded: coder.raw(1, given.is_rounded.into()) == 1, ..grid })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_residual_has_one_symbol() {
        for alphabet in &ALPHABETS {
            for residual in 0..1 << 14 {
                let symbol = alphabet.symbol(residual);
                let rest = residual - u32::from(alphabet.least[symbol as usize]);
                assert!(symbol < BOUNDARY && rest >> alphabet.bits[symbol as usize] == 0, "{residual}");
            }
        }
    }
}
