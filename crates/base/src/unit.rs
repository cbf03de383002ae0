//! Units of length of inputs; archives are in metres.

/// International foot (m).
pub const FOOT_M: f64 = 0.3048;
/// US survey foot (m).
pub const US_SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;
/// Range of units accepted (m).
pub const UNIT_RANGE_M: std::ops::RangeInclusive<f64> = 1e-9..=1e9;

/// Unit applied to an input: the factors that convert its coordinates to metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LengthUnit {
    /// Metres per unit along the two ground axes.
    pub horizontal_m: f64,
    /// Metres per unit of height.
    pub vertical_m: f64,
}

impl LengthUnit {
    /// Metres.
    pub const METRE: Self = Self::of(1.0);

    /// Returns a unit of `factor` metres along all axes.
    pub const fn of(factor: f64) -> Self {
        Self { horizontal_m: factor, vertical_m: factor }
    }

    /// Returns a set of units, sorted, each once.
    pub fn distinct(units: impl IntoIterator<Item = Self>) -> Vec<Self> {
        let mut units: Vec<Self> = units.into_iter().collect();
        units.sort_by(Self::order);
        units.dedup();
        units
    }

    /// Orders units by the ground axes, then by height.
    pub fn order(&self, other: &Self) -> std::cmp::Ordering {
        let heights = self.vertical_m.total_cmp(&other.vertical_m);
        self.horizontal_m.total_cmp(&other.horizontal_m).then(heights)
    }
}

/// Returns the name by which `sliceconv` takes a unit of `factor` metres; `other` for units that it takes only by their
/// length.
pub fn unit_name(factor: f64) -> &'static str {
    match factor {
        1.0 => "m",
        FOOT_M => "ft",
        US_SURVEY_FOOT_M => "us-ft",
        _ => "other",
    }
}
