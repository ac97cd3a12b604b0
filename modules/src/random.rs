//! Random numbers that are the same again for the same seed, so that a
//! simulated flight can be repeated.
//!
//! SplitMix64 (Steele, Lea, Flood 2014): eight bytes of state, passes BigCrush,
//! and any seed is a good one.

use std::f64::consts::TAU;

/// A sequence of random numbers.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// The sequence that belongs to this seed.
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// The sequence of one of several sources that share a seed. Each has its
    /// own, whichever others there are.
    pub fn of_source(seed: u64, source: u32) -> Self {
        let start = Self(seed).bits();
        Self(start ^ Self(source.into()).bits())
    }

    /// The next 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ (bits >> 31)
    }

    /// A number above 0, up to 1.
    pub fn uniform(&mut self) -> f64 {
        // The 53 bits that a double has room for.
        ((self.bits() >> 11) + 1) as f64 / (1_u64 << 53) as f64
    }

    /// A number of the normal distribution about 0 (Box and Muller).
    pub fn gauss(&mut self, standard_deviation: f64) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        standard_deviation * radius * (TAU * self.uniform()).cos()
    }

    /// A number from 0 to 2^31 - 1, as C's `random()` gives them.
    pub fn integer(&mut self) -> i32 {
        (self.bits() >> 33) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_published_generator() {
        // The first values of the authors' own program for seed 1234567.
        let mut random = Random::new(1_234_567);
        let first = [random.bits(), random.bits(), random.bits()];
        assert_eq!(
            first,
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]
        );
    }

    #[test]
    fn the_same_seed_gives_the_same_numbers_and_each_source_its_own() {
        let numbers = |seed, source| {
            let mut random = Random::of_source(seed, source);
            [random.bits(), random.bits()]
        };
        assert_eq!(numbers(1, 0), numbers(1, 0));
        assert_ne!(numbers(1, 0), numbers(1, 1));
        assert_ne!(numbers(1, 0), numbers(2, 0));
    }

    #[test]
    fn noise_is_normal() {
        let mut random = Random::new(7);
        let noise: Vec<f64> = (0..100_000).map(|_| random.gauss(2.0)).collect();
        let mean = noise.iter().sum::<f64>() / noise.len() as f64;
        let variance = noise.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / noise.len() as f64;
        let beyond = noise.iter().filter(|x| x.abs() > 4.0).count() as f64 / noise.len() as f64;
        // Standard errors: 2 / sqrt(100,000) = 0.006 of the mean, 0.3 % of the deviation.
        assert!(mean.abs() < 0.03, "{mean}");
        assert!((variance.sqrt() - 2.0).abs() < 0.03, "{variance}");
        assert!((beyond - 0.0455).abs() < 0.005, "two deviations: {beyond}");
    }
}
