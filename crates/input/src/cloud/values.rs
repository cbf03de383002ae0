//! Colour values of points: conversion of the numbers in a file to 16 bits.
//!
//! If the format states what white is (an 8-bit type, the limits of an E57), that holds. Otherwise a sample of the file
//! decides: the same rows of the same file on every machine, whatever else is converted.

use crate::colour::ColourSource;

/// Points sampled at each of `SAMPLE_PLACES` places in the file.
pub(super) const SAMPLE_POINTS: usize = 256;
pub(super) const SAMPLE_PLACES: u64 = 16;

/// Maximum of the red, green and blue of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// 255.
    Eight,
    /// 65,535.
    Sixteen,
    /// One of the two: whole numbers whose maximum decides.
    Unstated,
}

/// Maps a number in the file to a value: 0 at `low`, `by` for each unit above, up to `most`; NaN becomes 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    low: f64,
    by: f64,
    most: f64,
}

impl Scale {
    /// Whole numbers, unchanged.
    pub const WHOLE: Self = Self { low: 0.0, by: 1.0, most: 65_535.0 };
    /// Whole numbers of 8 bits, unchanged.
    pub const BYTES: Self = Self { low: 0.0, by: 1.0, most: 255.0 };
    /// 0 to 1.
    const UNIT: Self = Self { low: 0.0, by: 65_535.0, most: 65_535.0 };
    /// -2048 to 2047, the range of intensities written by Cyclone.
    const TWELVE_BITS: Self = Self { low: -2048.0, by: 16.0, most: 65_535.0 };
    /// Signed 16-bit numbers.
    const SIGNED: Self = Self { low: -32_768.0, by: 1.0, most: 65_535.0 };

    /// Maps `low` to `high` onto all 16 bits; `None` if the two leave no usable range.
    pub fn between(low: f64, high: f64) -> Option<Self> {
        let by = 65_535.0 / (high - low);
        (high > low && by.is_finite() && by > 0.0).then_some(Self { low, by, most: 65_535.0 })
    }

    #[inline]
    pub fn of(&self, value: f64) -> u16 {
        ((value - self.low) * self.by).clamp(0.0, self.most).round() as u16
    }
}

/// Storage of the numbers of a channel, as far as the format states it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// 8 bits.
    Bytes,
    /// 8 bits by convention; a sample may show otherwise.
    Custom,
    /// Whole numbers of more than 8 bits.
    Whole,
    /// Nothing stated: floating point, or text.
    Any,
}

/// Colour channels of a file of records or rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Channels {
    rgb: Option<Kind>,
    intensity: Option<Kind>,
    scale: Scale,
    depth: Depth,
}

/// Range of the numbers in a sample.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    least: f64,
    most: f64,
}

impl Sample {
    pub const NOTHING: Self = Self { least: f64::INFINITY, most: f64::NEG_INFINITY };

    /// Adds a number; NaN and infinities are ignored.
    pub fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.least = self.least.min(value);
            self.most = self.most.max(value);
        }
    }

    fn is_unit(&self) -> bool {
        self.least >= 0.0 && self.most > 0.0 && self.most <= 1.0
    }

    /// Returns white of colours in this range, of which black is 0.
    pub fn white(&self) -> f64 {
        match self.most {
            most if most > 255.0 => 65_535.0,
            most if most > 1.0 => 255.0,
            _ => 1.0,
        }
    }

    /// Returns the scale for intensities in this range.
    pub fn intensity(&self) -> Scale {
        match self {
            _ if self.is_unit() => Scale::UNIT,
            Self { least, most } if *least < 0.0 && *least >= -2048.0 && *most <= 2047.0 => Scale::TWELVE_BITS,
            Self { least, .. } if *least < 0.0 => Scale::SIGNED,
            _ => Scale::WHOLE,
        }
    }
}

impl Channels {
    /// Creates channels before any sample.
    pub fn new(rgb: Option<Kind>, intensity: Option<Kind>) -> Self {
        let (scale, depth) = match rgb {
            Some(Kind::Bytes | Kind::Custom) => (Scale::BYTES, Depth::Eight),
            _ => (Scale::WHOLE, Depth::Unstated),
        };
        Self { rgb, intensity, scale, depth }
    }

    pub fn has(&self, source: ColourSource) -> bool {
        match source {
            ColourSource::Rgb => self.rgb.is_some(),
            ColourSource::Intensity => self.intensity.is_some(),
            ColourSource::Class => false,
        }
    }

    /// Returns whether a sample is needed to interpret the numbers of `source`.
    pub fn is_open(&self, source: ColourSource) -> bool {
        let kind = match source {
            ColourSource::Rgb => self.rgb,
            ColourSource::Intensity => self.intensity,
            ColourSource::Class => None,
        };
        matches!(kind, Some(Kind::Custom | Kind::Any)) || source == ColourSource::Intensity && kind == Some(Kind::Whole)
    }

    /// Chooses how to interpret the numbers of `source`, given a sample of them.
    pub fn settle(&mut self, source: ColourSource, sample: &Sample) {
        match source {
            ColourSource::Intensity if self.intensity == Some(Kind::Bytes) => self.scale = Scale::BYTES,
            ColourSource::Intensity => self.scale = sample.intensity(),
            ColourSource::Class => {}
            ColourSource::Rgb => {
                *self = Self::new(self.rgb, self.intensity);
                match self.rgb {
                    Some(Kind::Custom | Kind::Any) if sample.is_unit() => {
                        (self.scale, self.depth) = (Scale::UNIT, Depth::Sixteen);
                    }
                    Some(Kind::Custom) if sample.most > 255.0 => {
                        (self.scale, self.depth) = (Scale::WHOLE, Depth::Unstated);
                    }
                    _ => {}
                }
            }
        }
    }

    /// Returns the scale of the channel that was settled last.
    pub fn scale(&self) -> Scale {
        self.scale
    }

    pub fn depth(&self) -> Depth {
        self.depth
    }
}

/// Splits a number into red, green and blue bytes, blue lowest, as in PCD.
#[inline]
pub(super) fn bytes_of(packed: u32) -> [u16; 3] {
    [16, 8, 0].map(|shift| (packed >> shift & 0xFF) as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(values: &[f64]) -> Sample {
        let mut sample = Sample::NOTHING;
        values.iter().for_each(|&value| sample.add(value));
        sample
    }

    #[test]
    fn limits_are_black_and_white_and_what_lies_outside_is_too() {
        let scale = Scale::between(-66.0, 66.0).unwrap();
        assert_eq!([-66.0, -67.0, 66.0, 1e300, f64::NAN].map(|v| scale.of(v)), [0, 0, 65_535, 65_535, 0]);
        assert_eq!(scale.of(0.0), 32_768);
        assert_eq!(Scale::between(0.0, 65_535.0), Some(Scale::WHOLE));
        assert!((0..=255).all(|v| Scale::between(0.0, 255.0).unwrap().of(f64::from(v)) == v * 257));
        for (low, high) in [(1.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (0.0, f64::INFINITY), (0.0, 5e-324)] {
            assert_eq!(Scale::between(low, high), None, "{low} to {high}");
        }
    }

    #[test]
    fn a_sample_tells_what_numbers_mean() {
        let rgb = |kind, values: &[f64]| {
            let mut channels = Channels::new(Some(kind), None);
            channels.settle(ColourSource::Rgb, &sample(values));
            (channels.depth(), channels.scale().of(0.5), channels.scale().of(200.0))
        };
        for kind in [Kind::Any, Kind::Custom] {
            assert_eq!(rgb(kind, &[0.0, 0.25, 1.0]), (Depth::Sixteen, 32_768, 65_535));
        }
        assert_eq!(rgb(Kind::Any, &[0.0, f64::NAN, 1.0, f64::INFINITY]), (Depth::Sixteen, 32_768, 65_535));
        assert_eq!(rgb(Kind::Any, &[0.0, 255.0]), (Depth::Unstated, 1, 200));
        assert_eq!(rgb(Kind::Any, &[]), (Depth::Unstated, 1, 200));
        assert_eq!(rgb(Kind::Custom, &[0.0, 255.0]), (Depth::Eight, 1, 200));
        assert_eq!(rgb(Kind::Custom, &[0.0, 256.0]).0, Depth::Unstated);
        assert_eq!(rgb(Kind::Bytes, &[0.0, 1.0]), (Depth::Eight, 1, 200));
        let intensity = |values: &[f64], value: f64| {
            let mut channels = Channels::new(None, Some(Kind::Any));
            channels.settle(ColourSource::Intensity, &sample(values));
            channels.scale().of(value)
        };
        assert_eq!(intensity(&[0.0, 0.5], 1.0), 65_535);
        assert_eq!(intensity(&[0.0, 2.0, 300.0], 299.6), 300);
        assert_eq!(intensity(&[-1999.0, 3.0], 0.0), 32_768);
        assert_eq!(intensity(&[-20_000.0, 3.0], -32_768.0), 0);
    }

    #[test]
    fn packed_colours_have_blue_lowest() {
        assert_eq!(bytes_of(0xFF01_0203), [1, 2, 3]);
    }
}
