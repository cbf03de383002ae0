//! Units of reference systems that a file or an option names only by EPSG code.
//!
//! Input: a code. Output: the meaning of its axes. GeoTIFF keys may leave the unit to the code (`ProjLinearUnits` is
//! optional); then nothing in the file says "feet". A code that is not in the table has no unit; none is guessed.

use super::epsg_table::{KINDS, RUNS, UNITS};
pub(super) use crate::unit::{FOOT_M as FOOT, US_SURVEY_FOOT_M as US_SURVEY_FOOT};

/// Axes of a reference system.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct System {
    /// x and y.
    pub ground: Ground,
    /// Metres per unit of z, if the system has a vertical axis; negative if that points down.
    pub up: Option<f64>,
    /// True if it combines two systems that have codes of their own.
    pub is_compound: bool,
}

/// Horizontal axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Ground {
    /// Metres per unit.
    Length(f64),
    /// Longitude and latitude.
    Angles,
    /// Three axes from the centre of the Earth, in metres.
    Geocentric,
    /// No horizontal axes: a vertical system.
    None,
}

/// Returns the system `code`, or `None` if it is not in the table.
pub(super) fn system(code: u32) -> Option<System> {
    let code = u16::try_from(code).ok()?;
    let after = RUNS.partition_point(|&(first, _)| first <= code);
    let kind = RUNS[after.checked_sub(1)?].1;
    KINDS.get(usize::from(kind).checked_sub(1)?).copied()
}

/// Returns metres per unit of EPSG unit of measure `code`, as used by `ProjLinearUnits` and `VerticalUnits`.
pub(super) fn unit(code: u16) -> Option<f64> {
    UNITS.binary_search_by_key(&code, |unit| unit.0).ok().map(|at| UNITS[at].1)
}

/// Replaces a rounded conversion factor by the metre or the exact foot that it stands for.
pub(super) fn exact(factor: f64) -> f64 {
    let near = |exact: &f64| (factor - exact).abs() <= 1e-7 * exact;
    [1.0, FOOT, US_SURVEY_FOOT].into_iter().find(near).unwrap_or(factor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_of_system_has_the_axes_that_its_code_means() {
        let axes = |code| system(code).map(|system| (system.ground, system.up));
        assert_eq!(axes(2229), Some((Ground::Length(US_SURVEY_FOOT), None))); // NAD83 / California zone 5 (ftUS)
        assert_eq!(axes(2992), Some((Ground::Length(FOOT), None))); // NAD83 / Oregon GIC Lambert (ft)
        assert_eq!(axes(2991), Some((Ground::Length(1.0), None))); // NAD83 / Oregon LCC (m)
        assert_eq!(axes(32633), Some((Ground::Length(1.0), None))); // WGS 84 / UTM zone 33N
        for degrees in [4167, 4326, 4674, 4759, 4807] {
            assert_eq!(axes(degrees), Some((Ground::Angles, None)), "{degrees}");
        }
        assert_eq!(axes(4979), Some((Ground::Angles, Some(1.0)))); // WGS 84, three axes
        assert_eq!(axes(4978), Some((Ground::Geocentric, None)));
        assert_eq!(axes(6360), Some((Ground::None, Some(US_SURVEY_FOOT)))); // NAVD88 height (ftUS)
        assert_eq!(axes(5715), Some((Ground::None, Some(-1.0)))); // MSL depth
        assert_eq!(axes(5555), Some((Ground::Length(1.0), Some(1.0)))); // ETRS89 / UTM zone 32N + DHHN92 height
        for none in [0, 1, 1999, 32767, 65535, 65536, 900_913, u32::MAX] {
            assert_eq!(axes(none), None, "{none}");
        }
    }

    #[test]
    fn the_table_is_in_order_and_names_kinds_that_exist() {
        assert!(RUNS.windows(2).all(|pair| pair[0].0 < pair[1].0 && pair[0].1 != pair[1].1));
        assert!(RUNS.iter().all(|run| usize::from(run.1) <= KINDS.len()));
        assert!(UNITS.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert_eq!((unit(9001), unit(9002), unit(9003)), (Some(1.0), Some(FOOT), Some(US_SURVEY_FOOT)));
        assert_eq!((unit(0), unit(9102), unit(32767)), (None, None, None));
    }
}
