//! Colours of voxels: their sources, exact sums, sRGB and CIELAB.
//!
//! A colour is the mean of the values of a voxel's points, computed from exact integer sums, so that no order, thread
//! or part changes it. Values of the input become 16-bit sRGB by one [`ColourScale`] for the whole input: RGB unchanged
//! (8 or 16 bits), intensity stretched between two of its quantiles, classes by a palette.
//!
//! Differences are CIE 1976 ΔE*ab under D65. Everything is computed in integers, or in `f32` and `f64` with only
//! `+ − × ÷` and square roots, which IEEE 754 rounds alike everywhere. Other roots come from Newton's iteration, so that the
//! same points give the same bytes on every platform. Sources: IEC 61966-2-1 (sRGB), CIE 15:2004 (CIELAB).

use std::sync::OnceLock;

/// Source of colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ColourSource {
    /// Red, green and blue of the points.
    Rgb,
    /// Intensity of the points, as grey.
    Intensity,
    /// Class of the points, by a palette.
    Class,
}

impl ColourSource {
    /// All sources, in the order of their codes in the archive, which begin with 1.
    pub const ALL: [Self; 3] = [Self::Rgb, Self::Intensity, Self::Class];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Intensity => "intensity",
            Self::Class => "class",
        }
    }
}

/// Mapping from values of points to colours, the same for a whole input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColourScale {
    /// Source of the values.
    pub source: ColourSource,
    /// Value that becomes black, as do all smaller ones.
    pub low: u16,
    /// Value that becomes white, as do all greater ones; more than `low`.
    pub high: u16,
}

impl ColourScale {
    /// Scale of classes, which use the palette.
    pub const CLASS: Self = Self { source: ColourSource::Class, low: 0, high: u8::MAX as u16 };

    /// Returns the scale of RGB whose greatest value is `greatest`: 8 bits if that fits, else 16.
    pub fn of_rgb(greatest: u16) -> Self {
        let high = if greatest <= u16::from(u8::MAX) { u16::from(u8::MAX) } else { u16::MAX };
        Self { source: ColourSource::Rgb, low: 0, high }
    }

    /// Returns the scale of intensities, given the number of points of each: the lowest and the highest hundredth of
    /// the points become black and white.
    pub fn of_intensity(counts: &[u64]) -> Self {
        let all: u64 = counts.iter().sum();
        let rank = all / 100;
        let mut passed = 0u64;
        let mut is_quantile = |count: u64| {
            passed = passed.saturating_add(count);
            passed > rank
        };
        let low = counts.iter().position(|&count| is_quantile(count)).unwrap_or(0) as u16;
        passed = 0;
        let mut is_quantile = |count: u64| {
            passed = passed.saturating_add(count);
            passed > rank
        };
        let high = counts.iter().rposition(|&count| is_quantile(count)).unwrap_or(0) as u16;
        // If all points have the same value above 0, they become white.
        let low = if high > low { low } else { high.saturating_sub(1) };
        Self { source: ColourSource::Intensity, low, high: high.max(1) }
    }

    /// Returns the value of a point as 16-bit grey.
    #[inline]
    pub fn stretch(&self, value: u16) -> u16 {
        let (low, width) = (u32::from(self.low), u32::from(self.high.max(self.low + 1) - self.low));
        let above = u32::from(value).saturating_sub(low).min(width);
        ((u64::from(above) * 0xFFFF + u64::from(width) / 2) / u64::from(width)) as u16
    }
}

/// Colour settings in the head of an archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColourPlan {
    /// Scale that made the colours.
    pub scale: ColourScale,
    /// Greatest mean difference from the exact colours in a page (thousandths of ΔE*ab); 0 is exact to 8 bits.
    pub error_milli: u16,
}

/// Palette of LAS classes (ASPRS LAS 1.4, table 17), in the colours that viewers commonly use.
const PALETTE: [[u8; 3]; 19] = [
    [170, 170, 170], // never classified
    [170, 170, 170], // unclassified
    [160, 110, 60],  // ground
    [170, 220, 120], // low vegetation
    [90, 180, 60],   // medium vegetation
    [30, 120, 30],   // high vegetation
    [220, 90, 70],   // building
    [255, 0, 255],   // low point
    [120, 120, 120], // model key point, reserved
    [60, 120, 220],  // water
    [90, 80, 80],    // rail
    [70, 70, 80],    // road surface
    [130, 130, 130], // overlap, reserved
    [255, 200, 60],  // wire, guard
    [255, 160, 0],   // wire, conductor
    [200, 140, 40],  // transmission tower
    [255, 230, 140], // wire connector
    [180, 160, 200], // bridge deck
    [255, 0, 120],   // high noise
];

/// Returns the colour of a LAS class (sRGB).
pub fn class_colour(class: u8) -> [u8; 3] {
    PALETTE.get(usize::from(class)).copied().unwrap_or_else(|| {
        // Classes without a standard meaning get different colours, the same everywhere.
        let hash = u32::from(class).wrapping_mul(0x9E37_79B1);
        [24, 16, 8].map(|shift| 64 + ((hash >> shift) as u8 & 0x7F))
    })
}

/// Exact sums of the colours of a voxel's points.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ColourSum {
    /// Number of points.
    pub n: u64,
    /// Sums of red, green and blue.
    pub sum: [u64; 3],
}

impl ColourSum {
    /// Returns the mean of values up to `high` as 16-bit sRGB, rounded to nearest; `None` without points.
    #[inline]
    pub fn mean(&self, high: u16) -> Option<[u16; 3]> {
        let [r, g, b] = self.sum;
        let greatest = r.max(g).max(b);
        match (self.n, high) {
            (0, _) | (_, 0) => None,
            // One point with 8 or 16 bits, as in most voxels of sparse scans, needs no rounding.
            (1, 0xFF | 0xFFFF) if greatest <= u64::from(high) => Some(self.sum.map(|sum| sum as u16 * (0xFFFF / high))),
            (n, _) if n < 1 << 30 && greatest < 1 << 46 => {
                let whole = n * u64::from(high);
                Some(self.sum.map(|sum| ((sum * 0xFFFF + whole / 2) / whole).min(0xFFFF) as u16))
            }
            (n, _) => {
                let whole = u128::from(n) * u128::from(high);
                let mean = |sum: u64| ((u128::from(sum) * 0xFFFF + whole / 2) / whole).min(0xFFFF) as u16;
                Some(self.sum.map(mean))
            }
        }
    }
}

/// Returns the nearest 8-bit value of a 16-bit one.
#[inline]
pub fn to_8_bits(value: u16) -> u8 {
    ((u32::from(value) + 128) / 257) as u8
}

/// Colour in CIELAB.
pub type Lab = [f32; 3];

/// Returns ΔE*ab.
#[inline]
pub fn difference(a: Lab, b: Lab) -> f32 {
    let [l, m, n] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (l * l + m * m + n * n).sqrt()
}

/// Table for the conversion of sRGB colours to CIELAB.
#[derive(Debug)]
pub struct LabTable {
    /// Linear light of each 8-bit value.
    linear: [f32; 257],
    /// The function `f` of CIELAB over 0..=1, in steps of 1/4096.
    f: Box<[f32; LabTable::LEN]>,
}

/// Returns the root of degree `n` of a positive number, by Newton's iteration from above.
fn root(value: f64, n: i32) -> f64 {
    let power = |y: f64, n: i32| (0..n).fold(1.0, |product, _| product * y);
    let mut y = value.max(1.0);
    loop {
        let next = y - (power(y, n) - value) / (f64::from(n) * power(y, n - 1));
        // From above, each step decreases until rounding stops it.
        if next >= y {
            return y;
        }
        y = next;
    }
}

impl LabTable {
    const STEPS: usize = 4096;
    /// A power of two greater than the number of steps, so that indices into the table need no check.
    const LEN: usize = 2 * Self::STEPS;

    /// Returns the table. Cost: 33 KiB, made once.
    pub fn get() -> &'static Self {
        static TABLE: OnceLock<LabTable> = OnceLock::new();
        TABLE.get_or_init(|| {
            let linear = |value: usize| {
                let u = value.min(255) as f64 / 255.0;
                if u <= 0.04045 {
                    return (u / 12.92) as f32;
                }
                let x = (u + 0.055) / 1.055;
                // To the power of 12/5.
                (x * x * root(x * x, 5)) as f32
            };
            let f = |step: usize| {
                // One more entry than steps, so that interpolation stays within the table.
                if step > Self::STEPS + 1 {
                    return 0.0;
                }
                let t = step as f64 / Self::STEPS as f64;
                let edge = 6.0 / 29.0;
                let f = if t > edge * edge * edge { root(t, 3) } else { t / (3.0 * edge * edge) + 4.0 / 29.0 };
                f as f32
            };
            Self { linear: std::array::from_fn(linear), f: Box::new(std::array::from_fn(f)) }
        })
    }

    #[inline]
    fn f(&self, t: f32) -> f32 {
        let at = t.clamp(0.0, 1.0) * Self::STEPS as f32;
        // Between 0 and the number of steps, so `i32` suffices; it converts faster.
        let step = at as i32;
        let (low, high) = (self.f[step as usize & (Self::LEN - 1)], self.f[(step as usize + 1) & (Self::LEN - 1)]);
        low + (high - low) * (at - step as f32)
    }

    #[inline]
    fn of_linear(&self, [r, g, b]: [f32; 3]) -> Lab {
        // Rows of the sRGB matrix, each divided by the white point of D65.
        let x = self.f(r * 0.433_953 + g * 0.376_219 + b * 0.189_828);
        let y = self.f(r * 0.212_671 + g * 0.715_160 + b * 0.072_169);
        let z = self.f(r * 0.017_758 + g * 0.109_477 + b * 0.872_766);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    /// Converts an 8-bit colour.
    #[inline]
    pub fn of_8_bits(&self, rgb: [u8; 3]) -> Lab {
        self.of_linear(rgb.map(|value| self.linear[usize::from(value)]))
    }

    /// Converts a 16-bit colour.
    #[inline]
    pub fn of_16_bits(&self, rgb: [u16; 3]) -> Lab {
        self.of_linear(rgb.map(|value| {
            let (step, rest) = (usize::from(value / 257), f32::from(value % 257) / 257.0);
            let (low, high) = (self.linear[step], self.linear[step + 1]);
            low + (high - low) * rest
        }))
    }
}

/// Returns the 8-bit sRGB value nearest to linear light (0..=1), measured in light.
pub fn from_linear(light: f32) -> u8 {
    let linear = &LabTable::get().linear[..256];
    let above = linear.partition_point(|&value| value < light).min(255);
    let below = above.saturating_sub(1);
    if light - linear[below] < linear[above] - light { below as u8 } else { above as u8 }
}

/// Returns the product of two sRGB colours in linear light.
pub fn multiplied(a: [u8; 3], b: [u8; 3]) -> [u8; 3] {
    let linear = |value: u8| LabTable::get().linear[usize::from(value)];
    [0, 1, 2].map(|channel| from_linear(linear(a[channel]) * linear(b[channel])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn values_come_back_from_linear_light_and_white_multiplies_to_the_same() {
        for value in 0..=255u8 {
            assert_eq!(from_linear(LabTable::get().linear[usize::from(value)]), value);
            assert_eq!(multiplied([value, 7, 255], [255; 3]), [value, 7, 255]);
        }
        assert_eq!((from_linear(-1.0), from_linear(2.0), from_linear(f32::NAN)), (0, 255, 0));
        assert_eq!(multiplied([255, 128, 0], [188; 3]), [188, 93, 0]);
    }

    /// Reference: the formulas, with the functions of the system.
    fn by_definition(rgb: [f64; 3]) -> [f64; 3] {
        let linear = |u: f64| if u <= 0.04045 { u / 12.92 } else { ((u + 0.055) / 1.055).powf(2.4) };
        let [r, g, b] = rgb.map(linear);
        let xyz = [
            (0.4124564 * r + 0.3575761 * g + 0.1804375 * b) / 0.95047,
            0.2126729 * r + 0.7151522 * g + 0.0721750 * b,
            (0.0193339 * r + 0.1191920 * g + 0.9503041 * b) / 1.08883,
        ];
        let f = |t: f64| {
            if t > (6.0f64 / 29.0).powi(3) { t.cbrt() } else { t * (29.0f64 / 6.0).powi(2) / 3.0 + 4.0 / 29.0 }
        };
        let [x, y, z] = xyz.map(f);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    proptest! {
        #[test]
        fn tables_give_cielab_as_its_formulas_do(rgb: [u16; 3]) {
            let table = LabTable::get();
            let apart = |lab: Lab, exact: [f64; 3]| {
                (0..3).map(|at| (f64::from(lab[at]) - exact[at]).powi(2)).sum::<f64>().sqrt()
            };
            let exact = by_definition(rgb.map(|value| f64::from(value) / 65535.0));
            prop_assert!(apart(table.of_16_bits(rgb), exact) < 0.05, "{:?} {:?}", table.of_16_bits(rgb), exact);
            let eight = rgb.map(to_8_bits);
            let exact = by_definition(eight.map(|value| f64::from(value) / 255.0));
            prop_assert!(apart(table.of_8_bits(eight), exact) < 0.02, "{:?} {:?}", table.of_8_bits(eight), exact);
        }

        #[test]
        fn means_are_the_nearest_and_do_not_depend_on_the_order(values in proptest::collection::vec(any::<[u8; 3]>(), 1..60)) {
            let mut sum = ColourSum::default();
            for value in values.iter().rev() {
                sum.n += 1;
                (0..3).for_each(|channel| sum.sum[channel] += u64::from(value[channel]));
            }
            let mean = sum.mean(255).unwrap();
            // Wider sums give the same mean.
            let far = 1 << 40;
            let wide = ColourSum { n: sum.n * far, sum: sum.sum.map(|sum| sum * far) };
            prop_assert_eq!(wide.mean(255).unwrap(), mean);
            for channel in 0..3 {
                let exact = values.iter().map(|value| f64::from(value[channel])).sum::<f64>() / values.len() as f64;
                prop_assert!((f64::from(mean[channel]) - exact * 257.0).abs() <= 0.5 + 1e-9);
                prop_assert!((f64::from(to_8_bits(mean[channel])) - exact).abs() <= 0.5 + 1.0 / 257.0);
            }
        }

        #[test]
        fn intensities_between_the_quantiles_are_stretched_over_the_whole_range(values in proptest::collection::vec(any::<u16>(), 1..500)) {
            let mut counts = vec![0u64; 1 << 16];
            values.iter().for_each(|&value| counts[usize::from(value)] += 1);
            let scale = ColourScale::of_intensity(&counts);
            prop_assert!(scale.low < scale.high);
            prop_assert_eq!((scale.stretch(0), scale.stretch(u16::MAX)), (0, u16::MAX));
            prop_assert_eq!(scale.stretch(scale.high), u16::MAX);
            let below = values.iter().filter(|&&value| value < scale.low).count();
            prop_assert!(below <= values.len() / 100);
        }
    }

    #[test]
    fn known_colours_have_the_coordinates_of_tables_in_print() {
        let table = LabTable::get();
        // Lindbloom's calculator, D65, 2 degrees.
        for (rgb, lab) in [
            ([255, 255, 255], [100.0, 0.0, 0.0]),
            ([0, 0, 0], [0.0, 0.0, 0.0]),
            ([255, 0, 0], [53.241, 80.092, 67.203]),
            ([0, 255, 0], [87.735, -86.183, 83.179]),
            ([0, 0, 255], [32.297, 79.188, -107.860]),
            ([119, 119, 119], [50.034, 0.0, 0.0]),
        ] {
            let apart = difference(table.of_8_bits(rgb), lab);
            assert!(apart < 0.1, "{rgb:?}: {:?}, {apart}", table.of_8_bits(rgb));
        }
    }

    #[test]
    fn greatest_values_tell_8_bits_from_16() {
        assert_eq!(ColourScale::of_rgb(255).high, 255);
        assert_eq!(ColourScale::of_rgb(256).high, 65535);
        let of = |value: usize| {
            let mut counts = vec![0; 1 << 16];
            counts[value] = 9;
            ColourScale::of_intensity(&counts)
        };
        assert_eq!([1, 7, 65535].map(|value| of(usize::from(value)).stretch(value)), [65535; 3], "all the same");
        assert_eq!((of(0).stretch(0), of(7).stretch(6)), (0, 0));
        assert_eq!(ColourSum::default().mean(255), None);
        assert_eq!(ColourSum { n: 2, sum: [510, 1, 0] }.mean(255), Some([65535, 129, 0]));
        assert_ne!(class_colour(2), class_colour(6));
        assert_ne!(class_colour(100), class_colour(101));
    }
}
