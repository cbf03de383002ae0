//! View of one station: images of least distances, and its observation of a place.

use super::cell::{Cell, EDGE, LEVELS, direction, floor, low_bits};
use std::sync::atomic::{AtomicU16, Ordering};

/// Farthest distance that an image can hold (cm); farther ones count as this.
pub(super) const FARTHEST_CM: u16 = u16::MAX - 1;
/// Least number of cells with a distance among a cell and its eight neighbours.
pub(super) const LEAST_SEEN: usize = 5;
/// First image of a moving station. Finer ones, each four times as large, would be usable only beyond 14 m, and a path
/// has some twenty stations per metre.
const FIRST_MOVING: usize = 3;
/// Least angle of a cell (rad), in the corners of a face, times the number of cells along its edge.
pub(super) const CELL_ANGLE: f64 = 0.9;
/// Points nearer than this are never tested (m), because they may be the scanner's own legs.
pub(super) const NEAREST_M: f64 = 0.3;

/// Most positions per batch.
pub(super) const BATCH: usize = 128;

/// Least distance behind a place at which something is farther than the place (m): scans do not align to the
/// centimetre.
pub(super) fn margin_m(distance_m: f64) -> f64 {
    0.05 + 0.01 * distance_m
}

/// Distance that a cell's value encodes (m); the value must not be 0.
pub(super) fn seen_m(value: u16) -> f64 {
    f64::from(FARTHEST_CM - (value - 1)) * 0.01
}

/// Greatest cell value that encodes a distance beyond `distance_m`, which must be less than the farthest.
#[inline]
pub(super) fn beyond(distance_m: f64) -> u16 {
    // The estimate is off by at most one; the exact comparisons below correct it.
    let mut cm = (distance_m * 100.0) as u16;
    while cm > 0 && f64::from(cm) * 0.01 > distance_m {
        cm -= 1;
    }
    while f64::from(cm) * 0.01 <= distance_m {
        cm += 1;
    }
    FARTHEST_CM - cm + 1
}

/// Observation of a place by a station.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Visibility {
    /// Something is at about this distance.
    Hit,
    /// The station saw farther, in this direction and around it.
    Through,
    /// Undecided.
    Nothing,
}

/// Numbers of stations by their observation of a place.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    pub through: u32,
    pub hit: u32,
}

/// Position of a stationary scanner, or one section of a moving one's path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Station {
    /// Position (m).
    pub at: [f64; 3],
    /// Greatest distance from the position at which rays began (m); 0 for a stationary scanner.
    pub within_m: f64,
}

impl Station {
    /// Returns the distance (m) of a place, and its cell.
    #[inline(always)]
    pub(super) fn look(&self, point: [f64; 3]) -> (f64, Cell) {
        let d: [f64; 3] = std::array::from_fn(|axis| point[axis] - self.at[axis]);
        ((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt(), Cell::of(d))
    }

    /// Returns the first image that can be used for a place at this distance; [`LEVELS`] if no image can.
    #[inline]
    pub(super) fn first_level_at(&self, distance_m: f64) -> usize {
        let is_too_fine = |level: usize| self.within_m * (EDGE >> level) as f64 > CELL_ANGLE * distance_m;
        (self.first_level()..LEVELS).find(|&level| !is_too_fine(level)).unwrap_or(LEVELS)
    }

    pub(super) fn first_level(&self) -> usize {
        if self.within_m > 0.0 { FIRST_MOVING } else { 0 }
    }

    /// Bytes of its images.
    pub fn bytes(&self) -> u64 {
        (self.first_level()..LEVELS).map(|level| 12 * ((EDGE >> level) as u64).pow(2)).sum()
    }
}

/// One station with its images.
#[derive(Debug)]
pub(super) struct View {
    pub station: Station,
    /// For each level from the first one on, all faces, row by row: [`FARTHEST_CM`] + 1 minus the least distance (cm),
    /// or 0 without a return.
    levels: [Vec<AtomicU16>; LEVELS],
    /// Value of the farthest distance in the image that [`View::may_see_through`] reads first; 0 while the image is
    /// empty.
    farthest: AtomicU16,
}

impl View {
    pub fn new(station: Station) -> Self {
        let cells = |level: usize| if level < station.first_level() { 0 } else { 6 * (EDGE >> level).pow(2) };
        Self {
            station,
            levels: std::array::from_fn(|level| (0..cells(level)).map(|_| AtomicU16::new(0)).collect()),
            farthest: AtomicU16::new(0),
        }
    }

    pub fn cell(&self, level: usize, face: usize, cell: [i64; 2]) -> &AtomicU16 {
        let edge = EDGE >> level;
        &self.levels[level][(face * edge + cell[1] as usize) * edge + cell[0] as usize]
    }

    /// Adds at most [`BATCH`] points (m).
    pub fn add(&self, points: [&[f64]; 3]) {
        const FARTHEST: f64 = FARTHEST_CM as f64;
        const MOST: f64 = FARTHEST + 1.0;
        let (mut cells, mut values) = ([Cell::default(); BATCH], [0u16; BATCH]);
        for ((point, cell), value) in places(points).zip(&mut cells).zip(&mut values) {
            let (distance, at) = self.station.look(point);
            // A point at the station's position has no direction.
            let cm = distance * 100.0;
            let cm = floor(if cm < FARTHEST { cm } else { FARTHEST });
            (*cell, *value) = (at, low_bits(if distance > 0.0 { MOST - cm } else { 0.0 }) as u16);
        }
        let first = self.station.first_level();
        for (cell, &value) in cells.iter().zip(&values).take(points[0].len()) {
            let cell = &self.levels[first][cell.index(first)];
            // Most points change nothing.
            if cell.load(Ordering::Relaxed) < value {
                cell.fetch_max(value, Ordering::Relaxed);
            }
        }
    }

    /// Returns the values of an image that the station has.
    pub fn values(&self, level: usize) -> &[AtomicU16] {
        &self.levels[level]
    }

    pub fn make_coarser(&self) {
        for level in self.station.first_level() + 1..LEVELS {
            let edge = (EDGE >> level) as i64;
            for face in 0..6 {
                for cell in (0..edge).flat_map(|y| (0..edge).map(move |x| [x, y])) {
                    let finer = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[x, y]| {
                        self.cell(level - 1, face, [2 * cell[0] + x, 2 * cell[1] + y]).load(Ordering::Relaxed)
                    });
                    let nearest = finer.into_iter().max().unwrap_or(0);
                    self.cell(level, face, cell).store(nearest, Ordering::Relaxed);
                }
            }
        }
        let values = self.levels[self.station.first_level() + 1].iter().map(|cell| cell.load(Ordering::Relaxed));
        self.farthest.store(values.filter(|&value| value != 0).min().unwrap_or(0), Ordering::Relaxed);
    }

    /// Returns whether the station may have seen through a place in a box (m) between these corners: false if the whole
    /// box is beyond everything it saw.
    pub fn reaches(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        let farthest = self.farthest.load(Ordering::Relaxed);
        // The operations and their order are those for a place, and rounding is monotone.
        let at = self.station.at;
        let d: [f64; 3] = std::array::from_fn(|axis| (min[axis] - at[axis]).max(at[axis] - max[axis]).max(0.0));
        let nearest = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        farthest != 0 && seen_m(farthest) > nearest + margin_m(nearest)
    }

    /// Returns the least distance (m) known in a cell, from the image of `level` or the first coarser one that has it;
    /// 0 if none has.
    #[inline]
    fn nearest_m(&self, level: usize, cell: Cell) -> f64 {
        let values = (level..LEVELS).map(|level| self.levels[level][cell.index(level)].load(Ordering::Relaxed));
        values.into_iter().find(|&value| value != 0).map_or(0.0, seen_m)
    }

    /// Tests at most [`BATCH`] places (m) that the station may have seen through: increments in `counts` for each place
    /// whether the station saw through it or hit it.
    pub fn count(&self, points: [&[f64]; 3], counts: &mut [Counts]) {
        let (mut cells, mut distances) = ([Cell::default(); BATCH], [0f64; BATCH]);
        for ((point, cell), distance) in places(points).zip(&mut cells).zip(&mut distances) {
            (*distance, *cell) = self.station.look(point);
        }
        let mut may = [false; BATCH];
        let looks = || cells.iter().zip(&distances).take(points[0].len());
        if self.station.within_m > 0.0 {
            looks().zip(&mut may).for_each(|((&cell, &distance), may)| *may = self.may_see_through(distance, cell));
        } else {
            // This is the same test with a fixed level, because stationary stations are tested with far more places.
            for ((&cell, &distance), may) in looks().zip(&mut may) {
                *may = (self.nearest_m(1, cell) > distance + margin_m(distance)) & (distance >= NEAREST_M);
            }
        }
        for (((&cell, &distance), counts), _) in looks().zip(counts).zip(&may).filter(|(_, may)| **may) {
            match self.says(distance, cell) {
                Visibility::Through => counts.through += 1,
                Visibility::Hit => counts.hit += 1,
                Visibility::Nothing => {}
            }
        }
    }

    /// Returns whether the station may have seen through a place. Reads at most one cell per image, and is true for few
    /// more places than [`says`](Self::says) finds seen through.
    ///
    /// Starts one image coarser than `says` does: of the cells that must all be farther, that image holds the nearest
    /// of four.
    #[inline]
    pub fn may_see_through(&self, distance: f64, cell: Cell) -> bool {
        let first = self.station.first_level_at(distance);
        let level = (first + 1).min(LEVELS - 1);
        first < LEVELS && distance >= NEAREST_M && self.nearest_m(level, cell) > distance + margin_m(distance)
    }

    /// Returns whether the station, which must be a moving one, may have seen through a place in a box (m) between
    /// these corners.
    ///
    /// If false, [`may_see_through`](Self::may_see_through) is false for all places in the box: no cell that the box
    /// extends into holds a distance beyond the nearest place in the box.
    pub fn may_see_through_some(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        // The operations and their order are those for a place, and rounding is monotone.
        let low: [f64; 3] = std::array::from_fn(|axis| min[axis] - self.station.at[axis]);
        let high: [f64; 3] = std::array::from_fn(|axis| max[axis] - self.station.at[axis]);
        let length = |d: [f64; 3]| (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let farthest = length(std::array::from_fn(|axis| high[axis].max(-low[axis])));
        // Finer images hold no nearer distances than coarser ones.
        let first = self.station.first_level_at(farthest);
        if first == LEVELS {
            return false;
        }
        let level = (first + 1).min(LEVELS - 1);
        let nearest = length(std::array::from_fn(|axis| low[axis].max(-high[axis]).max(0.0)));
        let far = nearest + margin_m(nearest);
        let Some((face, [columns, rows])) = cells_of(low, high) else { return true };
        let [columns, rows] = [columns, rows].map(|[first, last]| first >> level..=last >> level);
        let mut cells = rows.flat_map(|row| columns.clone().map(move |column| [column, row]));
        cells.any(|at| self.nearest_m(level, Cell::within(face, at, level)) > far)
    }

    pub fn says(&self, distance: f64, cell: Cell) -> Visibility {
        let margin = margin_m(distance);
        if distance < NEAREST_M || distance + margin >= f64::from(FARTHEST_CM) * 0.01 {
            return Visibility::Nothing;
        }
        // Values above this are nearer, so not behind the place. A cell's distance is rounded down by up to a
        // centimetre.
        let behind = beyond(distance + margin);
        let nearer =
            |value: u16| if seen_m(value) + margin + 0.01 >= distance { Visibility::Hit } else { Visibility::Nothing };
        for level in self.station.first_level_at(distance)..LEVELS {
            match self.levels[level][cell.index(level)].load(Ordering::Relaxed) {
                0 => continue,
                value if value > behind => return nearer(value),
                _ => {}
            }
            let (face, at) = cell.parts(level);
            let around = self.around(level, face, at, EDGE >> level);
            if let Some(&value) = around.iter().find(|&&value| value > behind) {
                return nearer(value);
            }
            if 1 + around.iter().filter(|&&value| value != 0).count() >= LEAST_SEEN {
                return Visibility::Through;
            }
        }
        Visibility::Nothing
    }

    /// Returns the values of the eight cells around one, row by row.
    #[inline]
    fn around(&self, level: usize, face: usize, [x, y]: [i64; 2], edge: usize) -> [u16; 8] {
        const STEPS: [[i64; 2]; 8] = [[-1, -1], [0, -1], [1, -1], [-1, 0], [1, 0], [-1, 1], [0, 1], [1, 1]];
        let inner = 1..edge as i64 - 1;
        if inner.contains(&x) && inner.contains(&y) {
            // Most cells have all neighbours on their own face.
            let first = (face * edge + y as usize - 1) * edge + x as usize - 1;
            let row = |row: usize| &self.levels[level][first + row * edge..first + row * edge + 3];
            let (above, own, below) = (row(0), row(1), row(2));
            let cells = [&above[0], &above[1], &above[2], &own[0], &own[2], &below[0], &below[1], &below[2]];
            return cells.map(|cell| cell.load(Ordering::Relaxed));
        }
        STEPS.map(|[dx, dy]| {
            let cell = [x + dx, y + dy];
            if cell.iter().all(|&at| (0..edge as i64).contains(&at)) {
                return self.cell(level, face, cell).load(Ordering::Relaxed);
            }
            self.levels[level][Cell::of(direction(face, cell, edge)).index(level)].load(Ordering::Relaxed)
        })
    }
}

/// Iterates over the points of three columns.
#[inline(always)]
fn places([x, y, z]: [&[f64]; 3]) -> impl Iterator<Item = [f64; 3]> {
    x.iter().zip(y).zip(z).map(|((&x, &y), &z)| [x, y, z])
}

/// Returns the cells of the finest image that a box of directions extends into: face, first and last column, first and
/// last row. `None` if they lie on several faces.
#[inline]
fn cells_of(low: [f64; 3], high: [f64; 3]) -> Option<(usize, [[usize; 2]; 2])> {
    // Margin for the rounding of these quotients (cells).
    const ROUNDING: f64 = 1e-6;
    let sizes: [f64; 3] = std::array::from_fn(|axis| high[axis].max(-low[axis]));
    let ahead: [f64; 3] = std::array::from_fn(|axis| low[axis].max(-high[axis]));
    let axis = (0..3).find(|&axis| ahead[axis] > sizes[(axis + 1) % 3].max(sizes[(axis + 2) % 3]))?;
    let (near, far) = (ahead[axis], sizes[axis]);
    let cells = [1, 2].map(|step| {
        let (low, high) = (low[(axis + step) % 3], high[(axis + step) % 3]);
        let ends = [low / if low < 0.0 { near } else { far }, high / if high > 0.0 { near } else { far }];
        let cell = |at: f64| at.clamp(0.0, (EDGE - 1) as f64) as usize;
        let [first, last] = ends.map(|end| (end + 1.0) / 2.0 * EDGE as f64);
        [cell(first - ROUNDING), cell(last + ROUNDING)]
    });
    Some((2 * axis + usize::from(low[axis] < 0.0), cells))
}
