//! Axes: logarithmic with a place for zero, or linear; and the numbers on them.

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use std::ops::Range;

/// An axis and how values lie on it.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Label with the unit.
    pub label: String,
    scale: Scale,
    /// Values of the ends.
    low: f64,
    high: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Scale {
    Linear,
    Log,
    /// Logarithmic, with zero at a place of its own below the least value.
    LogAndZero,
}

/// Share of a logarithmic axis between zero and the least value.
const ZERO_GAP: f64 = 0.07;

impl Axis {
    /// A logarithmic axis around `values`; what is not above zero is zero.
    pub fn log(label: &str, values: impl Iterator<Item = f64>) -> Self {
        let (mut low, mut high, mut scale) = (f64::INFINITY, 0f64, Scale::Log);
        for value in values {
            if value > 0.0 {
                (low, high) = (low.min(value), high.max(value));
            } else {
                scale = Scale::LogAndZero;
            }
        }
        if high <= 0.0 {
            (low, high) = (1.0, 1.0);
        }
        Self { label: label.into(), scale, low: below(low / 1.3), high: above(high * 1.3) }
    }

    /// Returns the axis cut at `most`, a value that nothing exceeds.
    pub fn up_to(self, most: f64) -> Self {
        Self { high: self.high.min(most), ..self }
    }

    /// A linear axis from `low` to `high`.
    pub fn linear(label: &str, low: f64, high: f64) -> Self {
        Self { label: label.into(), scale: Scale::Linear, low, high: if high > low { high } else { low + 1.0 } }
    }

    /// Where a value lies, between the ends of [`Self::ends`].
    fn place(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => value,
            Scale::LogAndZero if value <= 0.0 => self.low.log10() - self.gap(),
            _ => value.max(self.low).log10(),
        }
    }

    fn ends(&self) -> Range<f64> {
        match self.scale {
            Scale::Linear => self.low..self.high,
            Scale::Log => self.low.log10()..self.high.log10(),
            Scale::LogAndZero => self.low.log10() - 1.6 * self.gap()..self.high.log10(),
        }
    }

    fn gap(&self) -> f64 {
        (self.high / self.low).log10() * ZERO_GAP
    }

    /// Values to mark: 1, 2 and 5 of each power of ten where the axis is short, else powers of ten.
    fn ticks(&self) -> Vec<f64> {
        if self.scale == Scale::Linear {
            let step = above((self.high - self.low) / 10.0);
            let (first, last) = ((self.low / step).ceil() as i64, (self.high / step + 1e-9).floor() as i64);
            return (first..=last).map(|n| n as f64 * step).collect();
        }
        let decades = (self.high / self.low).log10();
        let every = if decades > 8.0 { 2 } else { 1 };
        let digits: &[f64] = if decades > 3.5 { &[1.0] } else { &[1.0, 2.0, 5.0] };
        let powers = (self.low.log10().floor() as i32..=self.high.log10().ceil() as i32).filter(|n| n % every == 0);
        let values = powers.flat_map(|power| digits.iter().map(move |digit| digit * 10f64.powi(power)));
        let inside = values.filter(|value| (self.low * 0.999..=self.high * 1.001).contains(value));
        let zero = (self.scale == Scale::LogAndZero).then_some(0.0);
        zero.into_iter().chain(inside).collect()
    }

    /// The number of a tick.
    pub fn number(&self, tick: f64) -> String {
        match self.scale {
            Scale::Linear => short(tick),
            // Zero has no place among logarithms: words, where the axis is broken.
            Scale::LogAndZero if tick <= 0.0 => "none".into(),
            _ => with_prefix(tick),
        }
    }

    /// The two values between which the axis is broken: zero, which has a place of its own, and the least one above.
    pub fn broken(&self) -> Option<(f64, f64)> {
        (self.scale == Scale::LogAndZero).then_some((0.0, self.low))
    }
}

impl Ranged for Axis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        let Range { start, end } = self.ends();
        from + ((self.place(*value) - start) / (end - start) * f64::from(to - from)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        // Light points have no numbers.
        if hint.weight().allow_light_points() { vec![] } else { self.ticks() }
    }

    fn range(&self) -> Range<f64> {
        if self.scale == Scale::LogAndZero { 0.0..self.high } else { self.low..self.high }
    }
}

/// The greatest 1, 2 or 5 of a power of ten that is not above a positive value.
fn below(value: f64) -> f64 {
    let power = 10f64.powf(value.log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|digit| digit * power).find(|tick| *tick <= value).unwrap_or(power)
}

/// The least 1, 2 or 5 of a power of ten that is not below a positive value.
fn above(value: f64) -> f64 {
    let power = 10f64.powf(value.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|digit| digit * power).find(|tick| *tick >= value * 0.999).unwrap_or(10.0 * power)
}

/// A number of an axis, thousands as k, M and G.
fn with_prefix(value: f64) -> String {
    for (size, letter) in [(1e9, "G"), (1e6, "M"), (1e3, "k")] {
        if value >= size * 0.999 {
            return format!("{} {letter}", short(value / size));
        }
    }
    short(value)
}

/// A number without needless digits.
pub fn short(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-4 {
        return format!("{value:.0e}");
    }
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.to_owned() }
}

/// A measured number with three figures, thousands apart.
pub fn figures(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let decimals = (2 - value.abs().log10().floor() as i32).max(0) as usize;
    let text = format!("{value:.decimals$}");
    let (whole, rest) = text.split_once('.').unwrap_or((&text, ""));
    let mut grouped = String::new();
    for (n, digit) in whole.chars().enumerate() {
        if n > 0 && digit != '-' && (whole.len() - n).is_multiple_of(3) && !grouped.ends_with('-') {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    if rest.is_empty() { grouped } else { format!("{grouped}.{rest}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_axis_counts_1_2_5_and_a_long_one_tens() {
        let short = Axis::log("ns", [30.0, 400.0].into_iter());
        assert_eq!(short.ticks(), [20.0, 50.0, 100.0, 200.0, 500.0, 1000.0]);
        let long = Axis::log("ns", [0.0, 20.0, 3e6].into_iter());
        assert_eq!(long.ticks(), [0.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6]);
        assert_eq!([0.0, 1.0, 1e4, 1e6].map(|tick| long.number(tick)), ["none", "1", "10 k", "1 M"]);
        let places = [0.0, 20.0, 3e6].map(|value| long.map(&value, (0, 1000)));
        assert!(0 < places[0] && places[0] + 50 < places[1] && places[2] < 1000, "{places:?}");
        assert_eq!(Axis::log("share", [0.0, 0.4, 0.9].into_iter()).up_to(1.0).ticks(), [0.0, 0.2, 0.5, 1.0]);
        assert_eq!(Axis::linear("gap", -8.0, 64.0).ticks(), [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
    }

    #[test]
    fn numbers_keep_three_figures() {
        let shown = [0.0, 0.01234, 9.876, 65.43, 1234.5, 1_234_567.0].map(figures);
        assert_eq!(shown, ["0", "0.0123", "9.88", "65.4", "1,234", "1,234,567"]);
    }
}
