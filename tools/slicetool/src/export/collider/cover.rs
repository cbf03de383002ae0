//! The first surface: the boundary of solid grown by about half of the reach, in whole cells and levels.
//!
//! Cells are then added until no two parts touch along an edge or at a corner only: so each edge has exactly two
//! triangles, and each corner one fan.

use super::super::surface::{self, Corner};
use super::grid::Grid;
use super::shell::{Columns, Interval, join};
use std::collections::VecDeque;

/// Growth along z, and height of a level, in shares of the reach.
const GROWTH: f64 = 0.2;
const LEVEL: f64 = 0.1;
/// Growth along x and y: it is at least a cell.
const ACROSS: f64 = 0.3;
/// Most cells that are added for each solid one: the addition ends in any case.
const MOST_ADDED: usize = 8;

/// Solid per cell, grown.
pub struct Cover {
    size: [usize; 2],
    columns: Vec<Vec<Interval>>,
    /// Units in a level.
    level: i64,
}

/// Cells by which solid grows along x and y.
pub fn growth(grid: &Grid) -> usize {
    ((ACROSS * grid.reach_m / grid.cell_m) as usize).max(1)
}

impl Cover {
    /// Grows solid; `None` if parts keep touching.
    pub fn of(solid: &Columns, grid: &Grid) -> Option<Self> {
        let (grow, level) = (grid.units(GROWTH), grid.units(LEVEL).max(1));
        let [width, height] = solid.size;
        let by = growth(grid);
        let near = |at: usize, end: usize| at.saturating_sub(by)..(at + by + 1).min(end);
        let rows = Columns::new(solid.size, |x, y, own| {
            for x in near(x, width) {
                let grown = solid
                    .at(x, y)
                    .iter()
                    .map(|[bottom, top]| [(bottom - grow).div_euclid(level), -(-(top + grow)).div_euclid(level)]);
                own.extend(grown);
            }
        });
        let mut columns = vec![Vec::new(); width * height];
        for y in 0..height {
            for x in 0..width {
                let own: &mut Vec<Interval> = &mut columns[y * width + x];
                near(y, height).for_each(|y| own.extend_from_slice(rows.at(x, y)));
                join(own);
            }
        }
        let mut cover = Self { size: solid.size, columns, level };
        cover.part_contacts().then_some(cover)
    }

    /// Adds cells where parts touch along an edge or at a corner only.
    fn part_contacts(&mut self) -> bool {
        let [width, height] = self.size;
        let mut open: VecDeque<(usize, usize)> =
            (0..height - 1).flat_map(|y| (0..width - 1).map(move |x| (x, y))).collect();
        let mut left = MOST_ADDED * (open.len() + 64);
        while let Some((x, y)) = open.pop_front() {
            let cells = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
            while let Some((cell, interval)) = self.contact(cells) {
                if left == 0 {
                    return false;
                }
                left -= 1;
                let (x, y) = cells[cell];
                let column = &mut self.columns[y * width + x];
                column.push(interval);
                join(column);
                let around = |at: usize, end: usize| at.saturating_sub(1)..(at + 1).min(end - 1);
                open.extend(around(y, height).flat_map(|y| around(x, width).map(move |x| (x, y))));
            }
        }
        true
    }

    /// Returns what to add to which of four columns, numbered by x, then y.
    fn contact(&self, cells: [(usize, usize); 4]) -> Option<(usize, Interval)> {
        let columns = cells.map(|(x, y)| &self.columns[y * self.size[0] + x][..]);
        if columns.iter().all(|column| column.is_empty()) {
            return None;
        }
        let mut heights: Vec<i64> = columns.iter().flat_map(|column| column.as_flattened()).copied().collect();
        heights.sort_unstable();
        heights.dedup();
        // Solid columns just below and just above a height.
        let solid = |at: i64| {
            (0..4).map(|n| u8::from(columns[n].iter().any(|[low, high]| *low <= at && at < *high)) << n).sum::<u8>()
        };
        for (number, &z) in heights.iter().enumerate() {
            let (below, above) = (solid(z - 1), solid(z));
            if above == 0b1001 || above == 0b0110 {
                let next = heights.get(number + 1).copied().unwrap_or(z + 1);
                return Some(((!above).trailing_zeros() as usize, [z, next]));
            }
            for (one, other) in [(0, 1), (2, 3), (0, 2), (1, 3)].into_iter().flat_map(|(a, b)| [(a, b), (b, a)]) {
                let has = |mask: u8, column: usize| mask >> column & 1 == 1;
                if has(below, one) && !has(below, other) && has(above, other) && !has(above, one) {
                    return Some((one, [z, z + 1]));
                }
            }
            for one in 0..4 {
                let opposite = 3 - one;
                if (below, above) == (1 << one, 1 << opposite) {
                    return Some((one, [z, z + 1]));
                }
                if (below ^ 15, above ^ 15) == (1 << one, 1 << opposite) {
                    return Some((one, [z - 1, z]));
                }
            }
        }
        None
    }

    /// Returns corners, in cells and units, and triangles of the boundary.
    pub fn surface(&self) -> (Vec<Corner>, Vec<[u32; 3]>) {
        let mut columns = surface::Columns::new();
        for (at, column) in self.columns.iter().enumerate().filter(|(_, column)| !column.is_empty()) {
            columns.insert(((at % self.size[0]) as i64, (at / self.size[0]) as i64), column.clone());
        }
        let (mut corners, triangles) = surface::closed(&columns);
        corners.iter_mut().for_each(|corner| corner[2] *= self.level);
        (corners, triangles)
    }
}
