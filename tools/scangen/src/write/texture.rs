//! Colours by a formula: closed-form truth for tests of colours.

use crate::geometry::Vec3;

/// Colours that depend only on the position: each channel rises and falls along its own direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Texture {
    /// Distance after which the channels repeat (m, > 0).
    pub period_m: f64,
    /// Whether values have 8 bits in the 16 bits of a record, as some programs write them.
    pub eight_bits: bool,
    /// How much darker some stations record colours than others `[0..=1]`; 0: all stations agree.
    pub exposure: f64,
}

impl Texture {
    /// Red, green and blue at a position in the range of a record: from 40 to 215 of 255.
    pub fn at(&self, [x, y, z]: Vec3) -> [u16; 3] {
        // From 0 to 1 and back, by exact arithmetic, so the same on every machine.
        let wave = |turns: f64| (2.0 * (turns - turns.floor()) - 1.0).abs();
        let turns = [x, y + self.period_m / 3.0, 0.5 * (x + y) + z].map(|along| along / self.period_m);
        let range = if self.eight_bits { 255.0 } else { 65_535.0 };
        turns.map(|turns| ((40.0 + 175.0 * wave(turns)) / 255.0 * range).round() as u16)
    }

    /// Fraction of each value that a station records, 1 − `exposure` to 1: all of it at station 0, fractions that never
    /// repeat at others.
    pub fn share(&self, station: u16) -> f64 {
        let turns = 0.618_033_988_749_895 * f64::from(station);
        1.0 - self.exposure * (turns - turns.floor())
    }

    /// Colours that a station records at a position.
    pub fn seen_from(&self, station: u16, place: Vec3) -> [u16; 3] {
        let share = self.share(station);
        self.at(place).map(|value| (f64::from(value) * share).round() as u16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stations_see_shares_of_values_that_differ() {
        let texture = Texture { period_m: 2.0, eight_bits: false, exposure: 0.4 };
        let at = [0.3, 1.2, 0.7];
        assert_eq!(texture.seen_from(0, at), texture.at(at));
        for station in 1..50 {
            let share = texture.share(station);
            assert!((0.6..1.0).contains(&share) && (share - texture.share(station - 1)).abs() > 0.1);
            for (seen, whole) in texture.seen_from(station, at).into_iter().zip(texture.at(at)) {
                assert!((f64::from(seen) / f64::from(whole) - share).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn channels_repeat_and_have_8_or_16_bits() {
        let texture = Texture { period_m: 2.0, eight_bits: true, exposure: 0.0 };
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
