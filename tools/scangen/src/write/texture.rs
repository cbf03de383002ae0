//! Colours by a formula: closed-form truth for whatever makes colours of points.

use crate::geometry::Vec3;

/// Colours that follow from the place alone: each channel goes up and down along another direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Texture {
    /// Distance after which channels repeat (m, > 0).
    pub period_m: f64,
    /// Whether values have 8 bits, in the 16 bits of a record, as some programs write them.
    pub eight_bits: bool,
}

impl Texture {
    /// Red, green and blue at a place, as a record holds them: from 40 to 215 of 255.
    pub fn at(&self, [x, y, z]: Vec3) -> [u16; 3] {
        // From 0 to 1 and back, by exact arithmetic: the same on every machine.
        let wave = |turns: f64| (2.0 * (turns - turns.floor()) - 1.0).abs();
        let turns = [x, y + self.period_m / 3.0, 0.5 * (x + y) + z].map(|along| along / self.period_m);
        let range = if self.eight_bits { 255.0 } else { 65_535.0 };
        turns.map(|turns| ((40.0 + 175.0 * wave(turns)) / 255.0 * range).round() as u16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_repeat_and_have_8_or_16_bits() {
        let texture = Texture { period_m: 2.0, eight_bits: true };
        let wide = Texture { eight_bits: false, ..texture };
        for at in [[0.0, 0.0, 0.0], [0.3, 1.2, 0.7], [-5.1, 2.2, 9.0]] {
            assert_eq!(texture.at(at), texture.at([at[0] + 4.0, at[1] - 8.0, at[2]]));
            assert!(texture.at(at).iter().all(|value| (40..=215).contains(value)));
            for (narrow, wide) in texture.at(at).into_iter().zip(wide.at(at)) {
                assert!((f64::from(wide) / 257.0 - f64::from(narrow)).abs() <= 0.51);
            }
        }
    }
}
