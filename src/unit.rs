//! Units of length in which inputs come, beside the metres of archives.

/// International foot (m).
pub const FOOT_M: f64 = 0.3048;
/// US survey foot (m).
pub const US_SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;
/// Least and greatest unit that is applied (m).
pub const UNIT_RANGE_M: std::ops::RangeInclusive<f64> = 1e-9..=1e9;

/// The unit that was applied to an input: what its coordinates were multiplied by to get metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LengthUnit {
    /// Metres per unit of the two axes on the ground.
    pub horizontal_m: f64,
    /// Metres per unit of heights.
    pub vertical_m: f64,
}

impl LengthUnit {
    /// Metres.
    pub const METRE: Self = Self::of(1.0);

    /// So many metres along all axes.
    pub const fn of(factor: f64) -> Self {
        Self { horizontal_m: factor, vertical_m: factor }
    }

    /// A set of units in one order, each once.
    pub fn distinct(units: impl IntoIterator<Item = Self>) -> Vec<Self> {
        let mut units: Vec<Self> = units.into_iter().collect();
        units.sort_by(Self::order);
        units.dedup();
        units
    }

    /// Order of units: by the ground, then by heights.
    pub fn order(&self, other: &Self) -> std::cmp::Ordering {
        let heights = self.vertical_m.total_cmp(&other.vertical_m);
        self.horizontal_m.total_cmp(&other.horizontal_m).then(heights)
    }
}

/// Name of a unit of `factor` metres, as the program `sliceconv` takes it; `other` for units that it takes by their length only.
pub fn unit_name(factor: f64) -> &'static str {
    match factor {
        1.0 => "m",
        FOOT_M => "ft",
        US_SURVEY_FOOT_M => "us-ft",
        _ => "other",
    }
}
