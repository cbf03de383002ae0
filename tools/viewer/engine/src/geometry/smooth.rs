//! Smooth surfaces for the eye: tops and undersides of neighbouring cells meet at the mean of their heights, and holes
//! that a surface surrounds are closed. Collision knows neither.

use super::COARSEST;
use super::cells::{Bar, Cells};
use slicewalk::frame::TILE_PIXELS;
use slicewalk::page::Page;

/// Surfaces meet if their heights differ by at most the climb height of a pawn (m), within these multiples of a cell:
/// less would show slopes as steps, more would show steps as slopes.
const CLIMB_M: f64 = 0.35;
const LEAST_CELLS: f64 = 1.0;
const MOST_CELLS: f64 = 1.5;
/// A hole is closed if the surface is in this many of the eight cells around it; in pages of points that lie apart, this
/// many are enough, and cells that were closed count, too.
const SURROUNDING: usize = 5;
const SURROUNDING_APART: usize = 4;
const ROUNDS_APART: usize = 3;
/// Most ends of bars that are looked at around a corner or a hole.
const MOST: usize = 24;

/// Pages in which fewer of the occupied pixels have a neighbour count as sparse, and are drawn with cells of which this
/// share is occupied.
const CONNECTED: f64 = 0.5;
const FILLED: f64 = 0.45;

/// Coarseness with which a page is drawn at least: points that lie apart, as scanned from the air, become a surface.
pub(super) fn sparseness(page: &Page) -> u32 {
    let mut rows = [0u64; TILE_PIXELS as usize + 1];
    let mut blocks = 0u64;
    for (x, y, _) in page.columns() {
        rows[y as usize] |= 1 << x;
        blocks |= 1 << (x / 8 + y / 8 * 8);
    }
    let (mut count, mut connected) = (0.0, 0.0);
    for pair in rows.windows(2) {
        let (row, next) = (pair[0], pair[1]);
        count += f64::from(row.count_ones());
        connected += f64::from((row & (row << 1 | next | next << 1 | next >> 1)).count_ones());
    }
    let (mut share, mut coarseness) = (count / (64.0 * f64::from(blocks.count_ones())), 0);
    while connected < CONNECTED * count && share < FILLED && coarseness < COARSEST {
        (share, coarseness) = (share * 4.0, coarseness + 1);
    }
    coarseness
}

/// Which end of a bar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    Top,
    Bottom,
}

impl End {
    fn of(self, bar: &Bar) -> u16 {
        match self {
            Self::Top => bar.top,
            Self::Bottom => bar.bottom,
        }
    }
}

/// How surfaces meet.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smooth {
    /// Height of a step in quanta, and in cells.
    pub step: u32,
    pub step_cells: f64,
    /// Largest difference of heights that meet (steps).
    pub reach: u16,
}

/// A corner of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Corner {
    /// Height (quanta).
    pub height: u16,
    pub normal: [i8; 3],
}

/// Receives the heights and cells of a surface; returns true to end the search.
type Each<'a> = dyn FnMut(&[(u16, u8)]) -> bool + 'a;

/// Heights around a place with the number of their cell, ascending.
struct Around([(u16, u8); MOST], usize);

impl Around {
    fn new() -> Self {
        Self([(0, 0); MOST], 0)
    }

    #[inline(never)]
    fn add(&mut self, height: u16, cell: u8) {
        if self.1 < MOST {
            let mut at = self.1;
            while at > 0 && self.0[at - 1] > (height, cell) {
                self.0[at] = self.0[at - 1];
                at -= 1;
            }
            self.0[at] = (height, cell);
            self.1 += 1;
        }
    }

    /// Splits the heights into surfaces: each at most once per cell, without gaps above `reach`. The split depends
    /// only on the heights, so that all cells around a corner agree.
    #[inline(never)] // one copy keeps the engine small
    fn surfaces(&self, reach: u16, each: &mut Each<'_>) {
        let all = &self.0[..self.1];
        let mut from = 0;
        for to in 1..=all.len() {
            let ends = to == all.len()
                || all[to].0 - all[to - 1].0 > reach
                || all[from..to].iter().any(|other| other.1 == all[to].1);
            if ends {
                if each(&all[from..to]) {
                    return;
                }
                from = to;
            }
        }
    }
}

impl Smooth {
    pub fn new(cell_m: f64, step: u32, step_cells: f64) -> Self {
        let cells = (CLIMB_M / cell_m).clamp(LEAST_CELLS, MOST_CELLS);
        Self { step, step_cells, reach: (cells / step_cells).round().clamp(1.0, 8000.0) as u16 }
    }

    /// The corner with the least x and y of cell (`x`, `y`), of the surface that has `height` (steps) in one of the four
    /// cells that meet there.
    #[inline(never)]
    pub fn corner(&self, cells: &Cells, x: isize, y: isize, end: End, height: u16) -> Corner {
        let mut around = Around::new();
        for cell in 0..4u8 {
            let (dx, dy) = (isize::from(cell & 1), isize::from(cell >> 1));
            for bar in cells.at(x - 1 + dx, y - 1 + dy) {
                let at = end.of(bar);
                if at.abs_diff(height) <= 3 * self.reach {
                    around.add(at, cell);
                }
            }
        }
        let mut corner = Corner { height: (u32::from(height) * self.step) as u16, normal: [0, 0, 127] };
        around.surfaces(self.reach, &mut |surface| {
            let is_ours = surface.iter().any(|at| at.0 == height);
            if is_ours {
                corner = self.mean(surface);
            }
            is_ours
        });
        if end == End::Bottom {
            corner.normal = corner.normal.map(|part| -part);
        }
        corner
    }

    fn mean(&self, surface: &[(u16, u8)]) -> Corner {
        let (mut sum, mut sides) = (0u32, [(0.0, 0.0); 4]);
        for &(height, cell) in surface {
            sum += u32::from(height);
            // Left, right, below, above.
            for side in [usize::from(cell & 1), 2 + usize::from(cell >> 1)] {
                sides[side].0 += f64::from(height);
                sides[side].1 += 1.0;
            }
        }
        let count = surface.len() as u32;
        let slope = |low: (f64, f64), high: (f64, f64)| {
            if low.1 > 0.0 && high.1 > 0.0 { (high.0 / high.1 - low.0 / low.1) * self.step_cells } else { 0.0 }
        };
        let (along_x, along_y) = (slope(sides[0], sides[1]), slope(sides[2], sides[3]));
        let size = 127.0 / (along_x * along_x + along_y * along_y + 1.0).sqrt();
        let normal = [-along_x * size, -along_y * size, size].map(|part| part.round() as i8);
        Corner { height: ((sum * self.step + count / 2) / count) as u16, normal }
    }

    /// The two ends of a side between two cells at one of its corners (quanta), the lower first.
    pub fn side(&self, cells: &Cells, [x, y]: [isize; 2], ends: [(End, u16); 2]) -> [u16; 2] {
        let [bottom, top] = ends.map(|(end, height)| self.corner(cells, x, y, end, height).height);
        [bottom.min(top), top]
    }

    /// Closes holes that a surface surrounds; `apart`: of points that lie apart.
    pub fn close_holes(&self, cells: &mut Cells, apart: bool) {
        let (rounds, surrounding) = if apart { (ROUNDS_APART, SURROUNDING_APART) } else { (1, SURROUNDING) };
        (0..rounds).for_each(|_| self.close(cells, surrounding));
    }

    fn close(&self, cells: &mut Cells, surrounding: usize) {
        let edge = cells.edge as isize;
        let mut found = Vec::new();
        for (x, y) in (0..edge).flat_map(|y| (0..edge).map(move |x| (x, y))) {
            let mut around = Around::new();
            for cell in (0..9u8).filter(|cell| *cell != 4) {
                let (dx, dy) = (isize::from(cell % 3) - 1, isize::from(cell / 3) - 1);
                cells.at(x + dx, y + dy).iter().for_each(|bar| around.add(bar.top, cell));
            }
            around.surfaces(self.reach, &mut |surface| {
                let (low, high) = (surface[0].0, surface[surface.len() - 1].0);
                let has_own = |bar: &Bar| bar.bottom <= high + self.reach && bar.top + self.reach >= low;
                if surface.len() >= surrounding && !cells.at(x, y).iter().any(has_own) {
                    let sum: u32 = surface.iter().map(|at| u32::from(at.0)).sum();
                    let top = ((sum / surface.len() as u32) as u16).max(1);
                    found.push((x, y, Bar { bottom: top - 1, top, obstacle: false }));
                }
                false
            });
        }
        cells.add_bars(&found);
    }
}
