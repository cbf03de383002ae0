//! What one station saw: images of least distances, and what they say of a place.

use super::cell::{Cell, EDGE, LEVELS, direction, floor, low_bits};
use std::sync::atomic::{AtomicU16, Ordering};

/// Farthest distance that an image can tell (cm); what is farther counts as this far.
pub(super) const FARTHEST_CM: u16 = u16::MAX - 1;
/// Of a cell and the eight around it, so many must have a distance.
pub(super) const LEAST_SEEN: usize = 5;
/// First image of a station that moves: finer ones, of four times the size each, could be asked beyond 14 m only. A way has some
/// twenty stations a metre.
const FIRST_MOVING: usize = 3;
/// Least angle of a cell, in the corners of a face, times the number of cells along its edge.
pub(super) const CELL_ANGLE: f64 = 0.9;
/// Nearer points are never judged (m): the scanner's own legs.
pub(super) const NEAREST_M: f64 = 0.3;

/// Places that are looked at in one go.
pub(super) const BATCH: usize = 128;

/// How much farther than a place something must be to be behind it (m): scans do not fit each other to the last centimetre.
pub(super) fn margin_m(distance_m: f64) -> f64 {
    0.05 + 0.01 * distance_m
}

/// The distance that a cell's value tells (m); the value is not 0.
pub(super) fn seen_m(value: u16) -> f64 {
    f64::from(FARTHEST_CM - (value - 1)) * 0.01
}

/// Greatest value of a cell that tells of a distance beyond `distance_m`, which is less than the farthest one.
#[inline]
pub(super) fn beyond(distance_m: f64) -> u16 {
    // Within one of the right number, which the comparison itself finds.
    let mut cm = (distance_m * 100.0) as u16;
    while cm > 0 && f64::from(cm) * 0.01 > distance_m {
        cm -= 1;
    }
    while f64::from(cm) * 0.01 <= distance_m {
        cm += 1;
    }
    FARTHEST_CM - cm + 1
}

/// What a station says of a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Says {
    /// Something is about there.
    Hit,
    /// It saw farther, in this direction and around it.
    Through,
    /// It cannot tell.
    Nothing,
}

/// How many stations said what of a place.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    pub through: u32,
    pub hit: u32,
}

/// Where a scanner stood, or a piece of the way of one that moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Station {
    /// Its place (m).
    pub at: [f64; 3],
    /// How far beside it rays began (m); 0 if it stood.
    pub within_m: f64,
}

impl Station {
    /// Distance (m) of a place, and its cell.
    #[inline(always)]
    pub(super) fn look(&self, point: [f64; 3]) -> (f64, Cell) {
        let d: [f64; 3] = std::array::from_fn(|axis| point[axis] - self.at[axis]);
        ((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt(), Cell::of(d))
    }

    /// First image that can be asked about a place so far away; none may be.
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
    /// For each level from the first one on all faces, row after row: [`FARTHEST_CM`] + 1 minus the least distance (cm), 0 where there
    /// is none.
    levels: [Vec<AtomicU16>; LEVELS],
    /// Of the values by which places are seen through, the farthest; 0 while there are none.
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

    /// Adds points (m), as many as [`BATCH`].
    pub fn add(&self, points: [&[f64]; 3]) {
        const FARTHEST: f64 = FARTHEST_CM as f64;
        const MOST: f64 = FARTHEST + 1.0;
        let (mut cells, mut values) = ([Cell::default(); BATCH], [0u16; BATCH]);
        for ((point, cell), value) in places(points).zip(&mut cells).zip(&mut values) {
            let (distance, at) = self.station.look(point);
            // A point where the scanner stood has no direction.
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

    /// Whether the station may have seen through a place in a box (m) between these corners: not if all are beyond what it saw.
    pub fn reaches(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        let farthest = self.farthest.load(Ordering::Relaxed);
        // The operations and their order are those for a place, and rounding keeps order.
        let at = self.station.at;
        let d: [f64; 3] = std::array::from_fn(|axis| (min[axis] - at[axis]).max(at[axis] - max[axis]).max(0.0));
        let nearest = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        farthest != 0 && seen_m(farthest) > nearest + margin_m(nearest)
    }

    /// The nearest distance (m) known in a cell, from the image of this `level` or the first coarser one that has it; 0 where none has.
    #[inline]
    fn nearest_m(&self, level: usize, cell: Cell) -> f64 {
        let values = (level..LEVELS).map(|level| self.levels[level][cell.index(level)].load(Ordering::Relaxed));
        values.into_iter().find(|&value| value != 0).map_or(0.0, seen_m)
    }

    /// Adds what the station says of places (m), as many as [`BATCH`], that it may have seen through: to `counts` how many saw through each
    /// place and how many hit it.
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
            // The same, with the level known: who stood is asked about far more places.
            for ((&cell, &distance), may) in looks().zip(&mut may) {
                *may = (self.nearest_m(1, cell) > distance + margin_m(distance)) & (distance >= NEAREST_M);
            }
        }
        for (((&cell, &distance), counts), _) in looks().zip(counts).zip(&may).filter(|(_, may)| **may) {
            match self.says(distance, cell) {
                Says::Through => counts.through += 1,
                Says::Hit => counts.hit += 1,
                Says::Nothing => {}
            }
        }
    }

    /// Whether the station may have seen through a place: it does so of few more places than it saw through, at the cost of one cell each.
    ///
    /// The image asked is one coarser than the first that [`says`](Self::says) asks: of the cells that must all be farther, it holds
    /// the nearest of four.
    #[inline]
    pub fn may_see_through(&self, distance: f64, cell: Cell) -> bool {
        let first = self.station.first_level_at(distance);
        let level = (first + 1).min(LEVELS - 1);
        first < LEVELS && distance >= NEAREST_M && self.nearest_m(level, cell) > distance + margin_m(distance)
    }

    /// Whether the station, one that moves, may have seen through a place in a box (m) between these corners.
    ///
    /// Where it is false, [`may_see_through`](Self::may_see_through) is so for all places in the box: no cell that the box reaches into tells of
    /// anything farther than the nearest place in it.
    pub fn may_see_through_some(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        // The operations and their order are those for a place, and rounding keeps order.
        let low: [f64; 3] = std::array::from_fn(|axis| min[axis] - self.station.at[axis]);
        let high: [f64; 3] = std::array::from_fn(|axis| max[axis] - self.station.at[axis]);
        let length = |d: [f64; 3]| (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let farthest = length(std::array::from_fn(|axis| high[axis].max(-low[axis])));
        // Finer images tell of nothing nearer than coarser ones.
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

    pub fn says(&self, distance: f64, cell: Cell) -> Says {
        let margin = margin_m(distance);
        if distance < NEAREST_M || distance + margin >= f64::from(FARTHEST_CM) * 0.01 {
            return Says::Nothing;
        }
        // Greater values are nearer: these are not behind the place. A cell's distance is rounded down by up to a centimetre.
        let behind = beyond(distance + margin);
        let nearer = |value: u16| if seen_m(value) + margin + 0.01 >= distance { Says::Hit } else { Says::Nothing };
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
                return Says::Through;
            }
        }
        Says::Nothing
    }

    /// The values of the eight cells around one, row by row.
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

/// The points of three columns.
#[inline(always)]
fn places([x, y, z]: [&[f64]; 3]) -> impl Iterator<Item = [f64; 3]> {
    x.iter().zip(y).zip(z).map(|((&x, &y), &z)| [x, y, z])
}

/// Cells of the finest image that a box of directions reaches into: their face, first and last column, first and last row. `None` where these are
/// of several faces.
#[inline]
fn cells_of(low: [f64; 3], high: [f64; 3]) -> Option<(usize, [[usize; 2]; 2])> {
    // For what the same quotients lose when they are rounded (cells).
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
