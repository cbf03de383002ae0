//! Seeded random numbers: SplitMix64 (Steele, Lea and Flood 2014).

/// A generator; its seed is its state.
#[derive(Debug, Clone)]
pub struct Random(pub u64);

impl Random {
    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Evenly from `low` to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// About normal, mean 0: a sum of twelve (Irwin-Hall).
    pub fn normal(&mut self, deviation: f64) -> f64 {
        deviation * ((0..12).map(|_| self.between(0.0, 1.0)).sum::<f64>() - 6.0)
    }
}
