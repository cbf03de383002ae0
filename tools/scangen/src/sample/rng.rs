//! Random numbers that do not depend on the platform or on the versions of dependencies.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A seeded stream. Streams of one seed are independent: more noise or outliers do not move the other points.
#[derive(Debug, Clone)]
pub(crate) struct Stream(ChaCha8Rng);

impl Stream {
    /// Stream number `stream` of `seed`. The key is the seed, little-endian, then zeros.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        let mut rng = ChaCha8Rng::from_seed(key);
        rng.set_stream(stream);
        Self(rng)
    }

    /// Uniform in `[0, 1)`, a multiple of 2⁻⁵³.
    #[inline]
    pub fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in `0..n`, `n > 0`; the bias is below n·2⁻⁶⁴.
    #[inline]
    pub fn below(&mut self, n: u64) -> u64 {
        ((u128::from(self.0.next_u64()) * u128::from(n)) >> 64) as u64
    }

    /// Nearly normal, mean 0 and variance 1: the sum of twelve uniform 16-bit numbers. Never beyond ±6 and computed
    /// exactly, so that a bound of 6σ holds for every point.
    #[inline]
    pub fn normal(&mut self) -> f64 {
        let mut sum = 0u64;
        for _ in 0..3 {
            let bits = self.0.next_u64();
            sum += (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        }
        (sum as f64 - 6.0 * 65535.0) * (1.0 / 65536.0)
    }

    /// A uniform direction: a unit vector (rejection from the cube).
    pub fn direction(&mut self) -> [f64; 3] {
        loop {
            let v: [f64; 3] = std::array::from_fn(|_| 2.0 * self.unit() - 1.0);
            let len = crate::geometry::length(v);
            if len > 1e-3 && len <= 1.0 {
                return crate::geometry::unit(v);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_mean_0_variance_1_and_stays_within_6_sigma() {
        let mut rng = Stream::new(1, 0);
        let draws: Vec<f64> = (0..100_000).map(|_| rng.normal()).collect();
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        let variance = draws.iter().map(|d| d * d).sum::<f64>() / draws.len() as f64;
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02, "mean {mean}, variance {variance}");
        assert!(draws.iter().all(|d| d.abs() <= 6.0));
    }

    #[test]
    fn the_first_numbers_of_a_seed_never_change() {
        let mut rng = Stream::new(42, 0);
        let first: Vec<u64> = (0..3).map(|_| rng.below(1_000_000)).collect();
        assert_eq!(first, FIRST_OF_42);
        assert_ne!(Stream::new(42, 1).below(u64::MAX), Stream::new(42, 0).below(u64::MAX));
    }

    /// Values of an independent ChaCha8 implementation.
    const FIRST_OF_42: [u64; 3] = [348_254, 285_698, 493_472];
}
