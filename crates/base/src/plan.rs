//! Plan of an archive: grid and options that decide its content. Archives of one plan can be compared and merged.

use crate::frame::{Frame, SLICE_QUANTA};
use crate::text::number;
use crate::{Error, Parameter, Result};
use xxhash_rust::xxh3::xxh3_128;

/// Length of [`Plan::to_bytes`].
pub const PLAN_BYTES: usize = 72;

/// Rule that distinguishes floors from obstacles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Classifier {
    /// Vertical solid runs in a pixel that are longer than the slope limit allows are obstacles. No slope up to the
    /// limit is one, apart from noise; how much steeper an obstacle must be depends on its heading and on the density
    /// of points.
    Span,
    /// The thesis' rule (algorithm 3.3), made independent of the order of points: two points of a voxel that differ by
    /// more than a third of the slice height make it an obstacle. It promises no angle.
    Thesis,
    /// Slope of a plane fitted to the points of 3 × 3 pixels. Where a pixel edge holds two points or more, the class
    /// switches at the slope limit ± 3°, for limits up to 60°, at any heading and slice height. Walls are obstacles.
    Plane,
}

impl Classifier {
    /// All classifiers, in the order of their codes in the archive.
    pub const ALL: [Self; 3] = [Self::Span, Self::Thesis, Self::Plane];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Span => "span",
            Self::Thesis => "thesis",
            Self::Plane => "plane",
        }
    }
}

/// Axis of the input that points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Up {
    /// z is up: coordinates stay unchanged.
    #[default]
    Z,
    /// y is up: (x, y, z) becomes (x, −z, y).
    Y,
}

impl Up {
    /// Turns a point of the input so that z is up.
    pub fn turn(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Z => [x, y, z],
            Self::Y => [x, -z, y],
        }
    }

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Z => "z",
            Self::Y => "y",
        }
    }
}

/// Set of LAS classes (0 to 255): class `c` is bit `c % 64` of word `c / 64`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ClassSet([u64; 4]);

impl ClassSet {
    /// Creates the set from its words, its form in an archive's head.
    pub const fn from_words(words: [u64; 4]) -> Self {
        Self(words)
    }

    /// Returns the words of [`from_words`](Self::from_words).
    pub fn words(&self) -> [u64; 4] {
        self.0
    }

    /// Adds a class.
    pub fn insert(&mut self, class: u8) {
        self.0[usize::from(class / 64)] |= 1 << (class % 64);
    }

    /// Returns whether the set contains this class.
    #[inline]
    pub fn contains(&self, class: u8) -> bool {
        self.0[usize::from(class / 64)] >> (class % 64) & 1 == 1
    }

    /// Returns whether the set is empty.
    pub fn is_empty(&self) -> bool {
        self.0 == [0; 4]
    }

    /// Returns the classes in ascending order.
    pub fn iter(&self) -> impl Iterator<Item = u8> + '_ {
        (0..=u8::MAX).filter(|&class| self.contains(class))
    }
}

impl FromIterator<u8> for ClassSet {
    fn from_iter<I: IntoIterator<Item = u8>>(classes: I) -> Self {
        let mut set = Self::default();
        classes.into_iter().for_each(|class| set.insert(class));
        set
    }
}

/// Returns rise over run of a slope of `deg` degrees, 0..=90. The result is the same on every platform, unlike the
/// platforms' own tangents, because classes, and so the bytes of archives, depend on it.
pub fn rise_of(deg: f64) -> f64 {
    if deg >= 90.0 { f64::INFINITY } else { libm::tan(deg.to_radians()) }
}

/// Noise of a scan's heights, from which an automatic tolerance is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Noise {
    /// Standard deviation of heights from planes fitted to flat regions (m): the lower quartile of all regions. 0 if
    /// there are too few regions.
    pub noise_m: f64,
    /// Number of flat regions found; 0 if there are too few.
    pub regions: u64,
    /// Edge of a region (m).
    pub region_m: f64,
}

impl Noise {
    /// Returns the tolerance that the noise hides (m): its first two digits, rounded down.
    pub fn tolerance_m(&self) -> f64 {
        let text = format!("{:.15e}", self.noise_m);
        let digits = text.split_once('e').map(|(digits, exponent)| format!("{}e{exponent}", &digits[..3]));
        digits.and_then(|text| text.parse().ok()).filter(|tolerance_m: &f64| tolerance_m.is_finite()).unwrap_or(0.0)
    }
}

/// Grid and options that decide an archive's content.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Grid.
    pub frame: Frame,
    /// All other options.
    pub options: PlanOptions,
}

/// Options other than the grid that decide an archive's content.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanOptions {
    /// Steepest slope that can be stood on (degrees, 0 to 90).
    pub max_slope_deg: f64,
    /// Tolerance to which heights may be coarsened, always outwards (m, at least 0).
    pub tolerance_m: f64,
    /// Rule that finds obstacles.
    pub classifier: Classifier,
    /// Voxels with fewer points are dropped, unless they hold a triangle of a mesh (points, at least 1).
    pub min_points: u32,
    /// Connected components of at most this many voxels are dropped; voxels are connected if they share a face, an edge
    /// or a corner. 0 drops nothing, 1 drops isolated voxels.
    pub drop_floaters: u16,
    /// True if points that other stations of the scan saw through are removed.
    pub remove_moving: bool,
    /// Greatest width of the holes in floors that are closed by inferred floor (pixels, at most
    /// [`MOST_FILL_PIXELS`](Self::MOST_FILL_PIXELS)); 0 closes none.
    pub fill_holes: u8,
    /// Up axis of the input, unless its format fixes it.
    pub up: Up,
    /// Points of these LAS classes are left out.
    pub exclude_classes: ClassSet,
}

impl Default for PlanOptions {
    /// Returns the defaults of `sliceconv`.
    fn default() -> Self {
        Self {
            max_slope_deg: 45.0,
            tolerance_m: 0.0,
            classifier: Classifier::Plane,
            min_points: 1,
            drop_floaters: 0,
            remove_moving: false,
            fill_holes: 0,
            up: Up::Z,
            exclude_classes: ClassSet::default(),
        }
    }
}

impl Plan {
    /// Creates the plan of an archive on this grid with the default options.
    pub fn new(frame: Frame) -> Self {
        Self { frame, options: PlanOptions::default() }
    }

    /// Returns how far heights may move outwards (quanta): the tolerance rounded down to whole quanta, at most a slice.
    pub fn tolerance_quanta(&self) -> u32 {
        (self.options.tolerance_m / self.frame.quantum_m()).floor().clamp(0.0, SLICE_QUANTA as f64) as u32
    }

    /// Returns the canonical bytes that identify the plan, which are also its bytes in an archive's head (spec, chapter
    /// 3).
    pub fn to_bytes(&self) -> [u8; PLAN_BYTES] {
        let mut bytes = [0; PLAN_BYTES];
        // Adding zero turns -0 into 0, so that equal plans have equal bytes.
        let sizes = [
            self.frame.pixel_m(),
            self.frame.slice_m(),
            self.options.max_slope_deg + 0.0,
            self.options.tolerance_m + 0.0,
        ];
        for (slot, value) in bytes[..32].chunks_exact_mut(8).zip(sizes) {
            slot.copy_from_slice(&value.to_le_bytes());
        }
        bytes[32] =
            Classifier::ALL.iter().position(|&c| c == self.options.classifier).map_or(u8::MAX, |code| code as u8);
        let flags = u8::from(self.options.up == Up::Y) | u8::from(self.options.remove_moving) << 1;
        bytes[33] = flags | self.options.fill_holes << 2;
        bytes[34..36].copy_from_slice(&self.options.drop_floaters.to_le_bytes());
        bytes[36..40].copy_from_slice(&self.options.min_points.to_le_bytes());
        for (slot, value) in bytes[40..].chunks_exact_mut(8).zip(self.options.exclude_classes.words()) {
            slot.copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }

    /// Returns the identity of the plan: XXH3-128 of its canonical bytes. Archives of one plan can be compared and
    /// merged.
    pub fn hash(&self) -> u128 {
        xxh3_128(&self.to_bytes())
    }
}

impl PlanOptions {
    /// Widest holes that can be closed (pixels); up to this width, the adjacent tile columns decide whether a hole is
    /// closed.
    pub const MOST_FILL_PIXELS: u8 = 45;

    /// Refuses values outside the limits stated at the fields.
    pub fn check(&self) -> Result<()> {
        if !(0.0..=90.0).contains(&self.max_slope_deg) {
            let reason = format!("{} is not an angle between 0 and 90 degrees", number(self.max_slope_deg));
            return Err(Error::parameter(Parameter::MaxSlope, reason));
        }
        if !(0.0..=1e6).contains(&self.tolerance_m) {
            let reason = format!("{} is not a length between 0 and 1000000 m", number(self.tolerance_m));
            return Err(Error::parameter(Parameter::Tolerance, reason));
        }
        if self.fill_holes > Self::MOST_FILL_PIXELS {
            let most = Self::MOST_FILL_PIXELS;
            let reason = format!("{} pixels are too many; at most {most} can be closed", self.fill_holes);
            return Err(Error::parameter(Parameter::FillHoles, reason));
        }
        if self.min_points == 0 {
            return Err(Error::parameter(Parameter::MinPoints, "0 is too few; 1 keeps every point"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tolerance_by_noise_is_never_above_it() {
        let tolerance = |noise_m| Noise { noise_m, ..Noise::default() }.tolerance_m();
        for (noise_m, expected) in
            [(0.0, 0.0), (0.00299999, 0.0029), (0.003, 0.003), (1.0, 1.0), (12.99, 12.0), (1e-9, 1e-9)]
        {
            assert_eq!(tolerance(noise_m), expected);
        }
        assert_eq!(tolerance(f64::NAN), 0.0);
        assert!((1..2000).map(|n| f64::from(n) * 1.37e-5).all(|noise_m| tolerance(noise_m) <= noise_m));
    }

    #[test]
    fn rises_have_the_same_bits_everywhere() {
        let written_down = [
            (30.0, 0x3fe2_79a7_4590_331c),
            (45.0, 0x3fef_ffff_ffff_ffff),
            (60.0, 0x3ffb_b67a_e858_4ca8),
            (89.9, 0x4081_e7a8_5f79_a037),
        ];
        for (deg, bits) in written_down {
            assert_eq!(rise_of(deg).to_bits(), bits, "{deg}");
        }
        assert_eq!((rise_of(0.0), rise_of(90.0)), (0.0, f64::INFINITY));
    }

    #[test]
    fn options_beyond_their_limits_are_refused_by_name() {
        type Change = fn(&mut PlanOptions);
        let check = |change: Change| {
            let mut options = PlanOptions::default();
            change(&mut options);
            options.check().map_err(|error| error.to_string())
        };
        let cases: [(&str, Change, Change); 5] = [
            ("maximum slope: 90.5 is", |o| o.max_slope_deg = 90.5, |o| o.max_slope_deg = 90.0),
            ("maximum slope: ", |o| o.max_slope_deg = f64::NAN, |o| o.max_slope_deg = 0.0),
            ("tolerance: -1 is", |o| o.tolerance_m = -1.0, |o| o.tolerance_m = 1e6),
            ("widest holes to close: 46 pixels", |o| o.fill_holes = 46, |o| o.fill_holes = 45),
            ("least points of a voxel: 0 is", |o| o.min_points = 0, |o| o.min_points = u32::MAX),
        ];
        for (words, beyond, within) in cases {
            let said = check(beyond).unwrap_err();
            assert!(said.starts_with(words), "{said}");
            assert_eq!(check(within), Ok(()), "{words}");
        }
    }
}
