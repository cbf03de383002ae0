//! Division of the grid into ranges of columns of about equal weight, and the test which areas such a range meets.

use super::facts::InputFacts;
use crate::frame::{Frame, TILE_PIXELS};
use crate::input::StatedBounds;

/// Returns the first columns of `count` parts that hold about the same number of points each, if the headers are right.
pub(super) fn split(frame: &Frame, inputs: &[InputFacts], count: u32) -> Vec<u64> {
    let areas = inputs.iter().filter_map(|input| Some((tiles(frame, &input.bounds?, 0), input.points as f64)));
    let mut areas: Vec<(TileRect, f64)> = areas.collect();
    let mut total: f64 = areas.iter().map(|area| area.1).sum();
    if total <= 0.0 {
        areas = vec![(QuadCell::WHOLE.tiles(), 1.0)];
        total = 1.0;
    }
    let targets: Vec<f64> = (1..count).map(|index| total * f64::from(index) / f64::from(count)).collect();
    let mut wanted = Vec::with_capacity(targets.len());
    columns_at(QuadCell::WHOLE, &areas, 0.0, &targets, &mut wanted);
    let mut firsts = vec![0u64];
    for index in 1..count {
        let least = firsts[firsts.len() - 1] + 1;
        // Leave a column for each of the following parts.
        let most = u64::MAX - u64::from(count - index);
        firsts.push(wanted[index as usize - 1].clamp(least, most));
    }
    firsts
}

/// First and last tile along x and y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TileRect {
    pub x: (i64, i64),
    pub y: (i64, i64),
}

const GRID: (i64, i64) = (i32::MIN as i64, i32::MAX as i64);

/// Returns the tiles of the points within `bounds` and up to `halo` pixels around them.
pub(super) fn tiles(frame: &Frame, bounds: &StatedBounds, halo: i64) -> TileRect {
    let along = |axis: usize| {
        let tile = |pixel: i64| pixel.div_euclid(TILE_PIXELS).clamp(GRID.0, GRID.1);
        (tile(frame.pixel_of(bounds.min[axis]) - halo), tile(frame.pixel_of(bounds.max[axis]) + halo))
    };
    TileRect { x: along(0), y: along(1) }
}

impl TileRect {
    /// Returns the number of tiles in both (a float: there may be 2⁶⁴).
    pub fn common(&self, other: &Self) -> f64 {
        let along = |a: (i64, i64), b: (i64, i64)| (a.1.min(b.1) - a.0.max(b.0) + 1).max(0) as f64;
        along(self.x, other.x) * along(self.y, other.y)
    }
}

/// Square of tiles whose columns are consecutive: a node of the quadtree that the column order traverses.
#[derive(Clone, Copy)]
pub(super) struct QuadCell {
    x: i64,
    y: i64,
    /// The edge is `2^level` tiles long.
    level: u32,
    /// First column.
    first: u64,
}

impl QuadCell {
    pub const WHOLE: Self = Self { x: GRID.0, y: GRID.0, level: 32, first: 0 };

    fn tiles(&self) -> TileRect {
        let edge = (1i64 << self.level) - 1;
        TileRect { x: (self.x, self.x + edge), y: (self.y, self.y + edge) }
    }

    fn last(&self) -> u64 {
        self.first + ((1u128 << (2 * self.level)) - 1) as u64
    }

    /// Returns the four quarters in column order; the cell must be larger than a tile.
    fn quarters(&self) -> [Self; 4] {
        let level = self.level - 1;
        [0u64, 1, 2, 3].map(|number| Self {
            x: self.x + ((number as i64 & 1) << level),
            y: self.y + ((number as i64 >> 1) << level),
            level,
            first: self.first + (number << (2 * level)),
        })
    }

    /// Returns whether the cell has a tile of `area` whose column lies in `first..=last`.
    pub fn meets(&self, area: &TileRect, first: u64, last: u64) -> bool {
        if self.last() < first || self.first > last {
            return false;
        }
        let common = self.tiles().common(area);
        let all_columns = first <= self.first && self.last() <= last;
        let all_tiles = common >= self.tiles().common(&self.tiles());
        common > 0.0 && (all_columns || all_tiles || self.quarters().iter().any(|cell| cell.meets(area, first, last)))
    }
}

/// Finds the columns before which the `areas`, evenly filled with their weights, hold each of the ascending `targets`.
/// Only areas that meet `cell` are needed, since others add nothing; `before` is the weight in columns before the cell.
///
/// Cost: per level of the quadtree, the areas that meet the cells with targets; not areas times targets.
fn columns_at(cell: QuadCell, areas: &[(TileRect, f64)], mut before: f64, mut targets: &[f64], found: &mut Vec<u64>) {
    if cell.level == 0 {
        found.extend(targets.iter().map(|_| cell.first));
        return;
    }
    for (number, quarter) in cell.quarters().iter().enumerate() {
        if targets.is_empty() {
            return;
        }
        let tiles = quarter.tiles();
        let weight: f64 = areas.iter().map(|(area, weight)| weight * tiles.common(area) / area.common(area)).sum();
        let here = match number {
            3 => targets.len(),
            _ => targets.partition_point(|&target| before + weight > target),
        };
        let (within, rest) = targets.split_at(here);
        if !within.is_empty() {
            let meets = |(area, _): &&(TileRect, f64)| tiles.common(area) > 0.0;
            match areas.iter().filter(meets).count() {
                all if all == areas.len() => columns_at(*quarter, areas, before, within, found),
                _ => {
                    let met: Vec<_> = areas.iter().filter(meets).copied().collect();
                    columns_at(*quarter, &met, before, within, found);
                }
            }
        }
        before += weight;
        targets = rest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::morton;
    use proptest::prelude::*;

    /// Reference: one target at a time, with all areas.
    fn column_at(areas: &[(TileRect, f64)], target: f64) -> u64 {
        let mut cell = QuadCell::WHOLE;
        let mut before = 0.0;
        while cell.level > 0 {
            let quarters = cell.quarters();
            cell = quarters[3];
            for quarter in &quarters[..3] {
                let tiles = quarter.tiles();
                let weight: f64 =
                    areas.iter().map(|(area, weight)| weight * tiles.common(area) / area.common(area)).sum();
                if before + weight > target {
                    cell = *quarter;
                    break;
                }
                before += weight;
            }
        }
        cell.first
    }

    proptest! {
        #[test]
        fn columns_of_many_targets_are_those_of_each(
            areas in proptest::collection::vec(((-5000i64..5000, 0i64..700), (-5000i64..5000, 0i64..700), 0.0f64..1e6), 1..12),
            count in 2u32..40
        ) {
            let area = |&(x, y, weight): &((i64, i64), (i64, i64), f64)| {
                (TileRect { x: (x.0, x.0 + x.1), y: (y.0, y.0 + y.1) }, weight)
            };
            let areas: Vec<_> = areas.iter().map(area).collect();
            let total: f64 = areas.iter().map(|area| area.1).sum();
            let targets: Vec<f64> = (1..count).map(|index| total * f64::from(index) / f64::from(count)).collect();
            let mut found = Vec::new();
            columns_at(QuadCell::WHOLE, &areas, 0.0, &targets, &mut found);
            let expected: Vec<u64> = targets.iter().map(|&target| column_at(&areas, target)).collect();
            prop_assert_eq!(found, expected);
        }

        #[test]
        fn a_range_meets_an_area_exactly_when_it_has_a_column_of_it(
            x in (-20i64..20, 0i64..9), y in (-20i64..20, 0i64..9), at in (-24i32..32, -24i32..32), length in 0u64..200
        ) {
            let area = TileRect { x: (x.0, x.0 + x.1), y: (y.0, y.0 + y.1) };
            let first = morton(at.0, at.1);
            let last = first + length;
            let inside = |tx: i64, ty: i64| (first..=last).contains(&morton(tx as i32, ty as i32));
            let expected = (area.x.0..=area.x.1).any(|tx| (area.y.0..=area.y.1).any(|ty| inside(tx, ty)));
            prop_assert_eq!(QuadCell::WHOLE.meets(&area, first, last), expected);
        }
    }
}
