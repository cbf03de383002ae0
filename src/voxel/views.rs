//! What each station of a scan saw, as images of distances, and which points others saw through.
//!
//! In: stations and the points measured from them. An image covers all directions by the six faces of a cube; a cell keeps
//! the least distance measured in it, in whole centimetres. Least distances do not depend on the order of points, and only
//! sums, products, quotients and square roots decide in which cell a point falls: the same on every machine.
//!
//! A station *saw through* a place if it measured something clearly farther in the direction of the place and in all
//! directions around it. The directions around take care of what a ray only grazes: a floor far away, the edge of a door, a
//! leaf. It *hit* the place if it measured something about as far. A point is taken for moving where at least
//! one station saw through its place, and no more stations hit it: the one that measured the point is among these.
//!
//! Where a cell has no distance, or its neighbours have too few, coarser images are asked, which hold least distances too.
//!
//! A scanner that moves is a station for each short piece of its way. Its rays begin up to [`Station::within_m`] beside the place of
//! the station, so a ray through a place may end in another direction than that of the place, by at most that length divided by the
//! distance of the place. Only images whose cells are wider than this are asked: then the cell and those around it hold the ends of
//! all rays through the place.
//!
//! Compare: F. Pomerleau et al., "Long-term 3D map maintenance in dynamic environments" (2014), J. Schauer, A. Nüchter, "The
//! Peopleremover" (2018), G. Kim, A. Kim, "Remove, then Revert" (2020).

use super::record::{ColumnKey, Content, HALO_PIXELS, PATCH_PIXELS, Record, SLICE_STEPS, SUBPIXELS};
use crate::frame::{Frame, PageKey, TILE_PIXELS};
use crate::{Error, Parameter, Result};
use std::sync::atomic::{AtomicU16, Ordering};

/// Cells along an edge of a face of the finest image: 0.18° in its middle.
const EDGE: usize = 1 << EDGE_BITS;
const EDGE_BITS: u32 = 9;
/// Images of a station, each half as fine as the one before.
const LEVELS: usize = 5;
/// Farthest distance that an image can tell (cm); what is farther counts as this far.
const FARTHEST_CM: u16 = u16::MAX - 1;
/// Of a cell and the eight around it, so many must have a distance.
const LEAST_SEEN: usize = 5;
/// First image of a station that moves: rays from elsewhere make finer ones useless.
const FIRST_MOVING: usize = 2;
/// Least angle of a cell, in the corners of a face, times the number of cells along its edge.
const CELL_ANGLE: f64 = 0.9;
/// Nearer points are never judged (m): the scanner's own legs.
const NEAREST_M: f64 = 0.3;

/// Places that are looked at in one go.
pub const BATCH: usize = 128;

/// How much farther than a place something must be to be behind it (m): scans do not fit each other to the last centimetre.
fn margin_m(distance_m: f64) -> f64 {
    0.05 + 0.01 * distance_m
}

/// The distance that a cell's value tells (m); the value is not 0.
fn seen_m(value: u16) -> f64 {
    f64::from(FARTHEST_CM - (value - 1)) * 0.01
}

/// Greatest value of a cell that tells of a distance beyond `distance_m`, which is less than the farthest one.
#[inline]
fn beyond(distance_m: f64) -> u16 {
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

/// 2⁵²: numbers from here on are whole, and the distance from it lies in their low bits.
const WHOLE: f64 = (1u64 << 52) as f64;

/// The whole number at or below `v`, which is at least 0 and less than 2⁵¹. Compiles to vector instructions everywhere.
#[inline(always)]
fn floor(v: f64) -> f64 {
    let nearest = v + WHOLE - WHOLE;
    if nearest > v { nearest - 1.0 } else { nearest }
}

/// The whole number `v`, at least 0 and less than 2³², in the low bits.
#[inline(always)]
fn low_bits(v: f64) -> u64 {
    (v + WHOLE).to_bits()
}

/// What a station says of a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Says {
    /// Something is about there.
    Hit,
    /// It saw farther, in this direction and around it.
    Through,
    /// It cannot tell.
    Nothing,
}

/// A cell of the finest image: face of the cube, row and column. Edges are powers of two, so the cells of coarser images follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Cell(u32);

impl Cell {
    /// The cell of a direction. Without branches and conversions, so that loops over many compile to vector instructions.
    #[inline(always)]
    fn of(d: [f64; 3]) -> Self {
        const LAST: f64 = (EDGE - 1) as f64;
        let [x, y, z] = d.map(f64::abs);
        let (is_x, is_y) = ((x >= y) & (x >= z), y >= z);
        let pick = |of_x: f64, of_y: f64, of_z: f64| {
            let other = if is_y { of_y } else { of_z };
            if is_x { of_x } else { other }
        };
        let along = pick(d[0], d[1], d[2]);
        let face = pick(0.0, 2.0, 4.0) + if along < 0.0 { 1.0 } else { 0.0 };
        let place = |across: f64| {
            let at = (across / along.abs() + 1.0) / 2.0 * EDGE as f64;
            // Also without a direction, where this is no number.
            floor(if at < LAST { at } else { LAST })
        };
        let (column, row) = (place(pick(d[1], d[2], d[0])), place(pick(d[2], d[0], d[1])));
        Self(low_bits((face * EDGE as f64 + row) * EDGE as f64 + column) as u32)
    }

    /// Face, column and row in the image of this level.
    #[inline]
    fn parts(self, level: usize) -> (usize, [i64; 2]) {
        let part = |shift: u32| ((self.0 >> shift) as usize % EDGE) >> level;
        ((self.0 >> (2 * EDGE_BITS)) as usize, [part(0) as i64, part(EDGE_BITS) as i64])
    }

    /// Its place in the image of this level.
    #[inline]
    fn index(self, level: usize) -> usize {
        let (face, [column, row]) = self.parts(level);
        ((face << (EDGE_BITS as usize - level)) + row as usize) << (EDGE_BITS as usize - level) | column as usize
    }
}

/// The direction of the middle of a cell, which may lie beyond the edges of the face.
fn direction(face: usize, cell: [i64; 2], edge: usize) -> [f64; 3] {
    let axis = face / 2;
    let mut d = [0.0; 3];
    d[axis] = if face % 2 == 1 { -1.0 } else { 1.0 };
    for (step, cell) in [1, 2].into_iter().zip(cell) {
        d[(axis + step) % 3] = (2 * cell + 1) as f64 / edge as f64 - 1.0;
    }
    d
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
    fn look(&self, point: [f64; 3]) -> (f64, Cell) {
        let d: [f64; 3] = std::array::from_fn(|axis| point[axis] - self.at[axis]);
        ((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt(), Cell::of(d))
    }

    /// First image that can be asked about a place so far away; none may be.
    #[inline]
    fn first_level_at(&self, distance_m: f64) -> usize {
        let is_too_fine = |level: usize| self.within_m * (EDGE >> level) as f64 > CELL_ANGLE * distance_m;
        (self.first_level()..LEVELS).find(|&level| !is_too_fine(level)).unwrap_or(LEVELS)
    }

    fn first_level(&self) -> usize {
        if self.within_m > 0.0 { FIRST_MOVING } else { 0 }
    }

    /// Bytes of its images.
    fn bytes(&self) -> u64 {
        (self.first_level()..LEVELS).map(|level| 12 * ((EDGE >> level) as u64).pow(2)).sum()
    }
}

/// One station with its images.
#[derive(Debug)]
struct View {
    station: Station,
    /// For each level from the first one on all faces, row after row: [`FARTHEST_CM`] + 1 minus the least distance (cm), 0 where there
    /// is none.
    levels: [Vec<AtomicU16>; LEVELS],
    /// Of the values by which places are seen through, the farthest; 0 while there are none.
    farthest: AtomicU16,
}

impl View {
    fn new(station: Station) -> Self {
        let cells = |level: usize| if level < station.first_level() { 0 } else { 6 * (EDGE >> level).pow(2) };
        Self {
            station,
            levels: std::array::from_fn(|level| (0..cells(level)).map(|_| AtomicU16::new(0)).collect()),
            farthest: AtomicU16::new(0),
        }
    }

    fn cell(&self, level: usize, face: usize, cell: [i64; 2]) -> &AtomicU16 {
        let edge = EDGE >> level;
        &self.levels[level][(face * edge + cell[1] as usize) * edge + cell[0] as usize]
    }

    /// Adds points (m), as many as [`BATCH`].
    fn add(&self, points: [&[f64]; 3]) {
        const FARTHEST: f64 = FARTHEST_CM as f64;
        const MOST: f64 = FARTHEST + 1.0;
        let (mut cells, mut values) = ([Cell(0); BATCH], [0u16; BATCH]);
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

    fn make_coarser(&self) {
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
    fn reaches(&self, min: [f64; 3], max: [f64; 3]) -> bool {
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

    /// Notes which places (m), as many as [`BATCH`], the station may have seen through: few more than it has, at the cost of one
    /// cell each.
    ///
    /// The image asked is one coarser than the first that [`says`](Self::says) asks: of the cells that must all be farther, it holds
    /// the nearest of four.
    fn note_seen_through(&self, points: [&[f64]; 3], may: &mut [bool; BATCH]) {
        let (mut cells, mut distances) = ([Cell(0); BATCH], [0f64; BATCH]);
        for ((point, cell), distance) in places(points).zip(&mut cells).zip(&mut distances) {
            (*distance, *cell) = self.station.look(point);
        }
        let looks = cells.iter().zip(&distances).zip(may).take(points[0].len());
        if self.station.within_m > 0.0 {
            looks.for_each(|((&cell, &distance), may)| *may |= self.may_see_through(distance, cell));
            return;
        }
        for ((&cell, &distance), may) in looks {
            let far = distance + margin_m(distance);
            *may |= (self.nearest_m(1, cell) > far) & (distance >= NEAREST_M);
        }
    }

    /// As [`note_seen_through`](Self::note_seen_through), for one place.
    #[inline]
    fn may_see_through(&self, distance: f64, cell: Cell) -> bool {
        let first = self.station.first_level_at(distance);
        let level = (first + 1).min(LEVELS - 1);
        first < LEVELS && distance >= NEAREST_M && self.nearest_m(level, cell) > distance + margin_m(distance)
    }

    fn says(&self, distance: f64, cell: Cell) -> Says {
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

/// The views of all stations.
///
/// Memory: 4.2 MB a station, 0.26 MB one that moves.
#[derive(Debug)]
pub struct Views {
    views: Vec<View>,
    frame: Frame,
}

impl Views {
    /// Views from these stations, for records on the grid `frame`, without any point yet. Fails beyond `max_bytes`.
    pub fn new(stations: &[Station], frame: Frame, max_bytes: u64) -> Result<Self> {
        let bytes = stations.iter().map(Station::bytes).fold(0, u64::saturating_add);
        if bytes > max_bytes {
            let what = format!("memory for what {} stations saw (bytes)", stations.len());
            return Err(Error::limit(what, bytes, max_bytes).with_way_out(Parameter::Memory));
        }
        Ok(Self { views: stations.iter().map(|&station| View::new(station)).collect(), frame })
    }

    /// Adds points (m) that a station measured, by coordinates.
    pub fn add(&self, station: usize, [x, y, z]: [&[f64]; 3]) {
        for begin in (0..x.len()).step_by(BATCH) {
            let batch = begin..(begin + BATCH).min(x.len());
            self.views[station].add([&x[batch.clone()], &y[batch.clone()], &z[batch]]);
        }
    }

    /// All points are there.
    pub fn finish(&self) {
        self.views.iter().for_each(View::make_coarser);
    }

    /// Whether a point (m) is taken for moving.
    pub fn is_moving(&self, point: [f64; 3]) -> bool {
        let looks = || self.views.iter().map(|view| (view, view.station.look(point)));
        let (mut through, mut hit) = (0, 0);
        for (view, (distance, cell)) in looks() {
            if view.may_see_through(distance, cell) {
                match view.says(distance, cell) {
                    Says::Through => through += 1,
                    Says::Hit => hit += 1,
                    Says::Nothing => {}
                }
            }
        }
        if through == 0 {
            return false;
        }
        // The others can only have hit it.
        for (view, (distance, cell)) in looks() {
            if hit > through {
                break;
            }
            hit += usize::from(!view.may_see_through(distance, cell) && view.says(distance, cell) == Says::Hit);
        }
        through >= hit
    }

    /// Which of some records, as many as [`BATCH`], are points that are taken for moving.
    pub fn are_moving(&self, places: Places, records: &[Record]) -> [bool; BATCH] {
        let [mut x, mut y, mut z] = [[0f64; BATCH]; 3];
        for (((record, x), y), z) in records.iter().zip(&mut x).zip(&mut y).zip(&mut z) {
            [*x, *y, *z] = places.of(*record);
        }
        let points = [&x, &y, &z].map(|column| &column[..records.len()]);
        let (min, max) = places.bounds();
        let mut is_moving = [false; BATCH];
        let reaching = self.views.iter().filter(|view| view.reaches(min, max));
        reaching.for_each(|view| view.note_seen_through(points, &mut is_moving));
        for (number, record) in records.iter().enumerate() {
            if is_moving[number] {
                let point = [x[number], y[number], z[number]];
                is_moving[number] = record.content() == Content::Point && self.is_moving(point);
            }
        }
        is_moving
    }

    /// Where the points of records of a column lie.
    pub fn places(&self, column: ColumnKey) -> Places {
        let PageKey { tx, ty, .. } = PageKey::from_column(column.column, 0);
        // All of these are exact.
        let corner = [tx, ty].map(|tile| (i64::from(tile) * TILE_PIXELS - HALO_PIXELS) as f64);
        Places { corner, first_slice: column.first_slice() as f64, frame: self.frame }
    }
}

/// Where the points of records of one column lie.
#[derive(Debug, Clone, Copy)]
pub struct Places {
    /// First pixel of the column with its halo.
    corner: [f64; 2],
    first_slice: f64,
    frame: Frame,
}

impl Places {
    /// A box around the places of all points (m).
    fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let [x, y] = self.corner;
        let edge = |pixels: f64| pixels * self.frame.pixel_m();
        let [end_x, end_y] = [x, y].map(|pixels| edge(pixels + PATCH_PIXELS as f64));
        ([edge(x), edge(y), f64::NEG_INFINITY], [end_x, end_y, f64::INFINITY])
    }

    /// Where the point of a record lies, to the precision of records (m).
    #[inline(always)]
    pub fn of(&self, record: Record) -> [f64; 3] {
        // Of 32 bits and with signs: what vector instructions convert.
        let float = |whole: u32| f64::from(whole as i32);
        let along = |corner: f64, patch: u32, sub: u32| {
            (corner + float(patch) + (float(sub) + 0.5) / SUBPIXELS as f64) * self.frame.pixel_m()
        };
        let (u, v) = record.place();
        let slice = self.first_slice + float(record.slice());
        let height = float(record.height()) / SLICE_STEPS as f64;
        let (row, pixel) = (record.pixel() as u32 / PATCH_PIXELS as u32, record.pixel() as u32 % PATCH_PIXELS as u32);
        [along(self.corner[0], pixel, u), along(self.corner[1], row, v), (slice + height) * self.frame.slice_m()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::voxel::record::Recorder;
    use proptest::prelude::*;

    fn frame() -> Frame {
        Frame::new(0.05, 0.15).unwrap()
    }

    fn stood(at: [f64; 3]) -> Station {
        Station { at, within_m: 0.0 }
    }

    proptest! {
        #[test]
        fn cells_are_those_of_the_face_that_the_direction_points_to(
            d in [-3i32..=3, -3..=3, -3..=3], more in [-1f64..1.0, -1f64..1.0, -1f64..1.0], scale in prop_oneof![Just(0.0), Just(1e-3), Just(1.0)]
        ) {
            // Ties of the coordinates, edges and corners among them.
            let d: [f64; 3] = std::array::from_fn(|axis| f64::from(d[axis]) + scale * more[axis]);
            prop_assume!(d != [0.0; 3]);
            let size = d.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
            // Of equally long axes y before z, and x before both.
            let axis = d.iter().position(|v| v.abs() == size).unwrap();
            let at = |axis: usize| (((d[axis % 3] / size + 1.0) / 2.0 * EDGE as f64) as i64).min(EDGE as i64 - 1);
            let face = 2 * axis + usize::from(d[axis] < 0.0);
            for level in 0..LEVELS {
                let expected = (face, [at(axis + 1) >> level, at(axis + 2) >> level]);
                prop_assert_eq!(Cell::of(d).parts(level), expected);
                let edge = EDGE >> level;
                let index = (face * edge + expected.1[1] as usize) * edge + expected.1[0] as usize;
                prop_assert_eq!(Cell::of(d).index(level), index);
            }
        }

        #[test]
        fn records_tell_where_their_points_lie(x in -500f64..500.0, y in -500f64..500.0, z in -90f64..90.0) {
            let views = Views::new(&[], frame(), 0).unwrap();
            Recorder::new(frame()).record(&[x], &[y], &[z], |index, record| {
                let place = views.places(index.key()).of(record);
                let (min, max) = views.places(index.key()).bounds();
                assert!((0..3).all(|axis| min[axis] <= place[axis] && place[axis] <= max[axis]));
                let near = (place[0] - x).abs() < 0.0005 && (place[1] - y).abs() < 0.0005 && (place[2] - z).abs() < 0.0001;
                assert!(near, "{place:?}");
            });
        }

        #[test]
        fn a_cell_beyond_an_edge_is_the_neighbour_on_the_next_face(face in 0usize..6, along in 0i64..512, side in 0usize..4) {
            let cell = [[-1, along], [512, along], [along, -1], [along, 512]][side];
            let inside = [[0, along], [511, along], [along, 0], [along, 511]][side];
            let vector = |(face, cell): (usize, [i64; 2])| {
                let d = direction(face, cell, 512);
                let len = d.iter().map(|v| v * v).sum::<f64>().sqrt();
                d.map(|v| v / len)
            };
            let out = Cell::of(direction(face, cell, 512));
            prop_assert_ne!(out.parts(0).0, face);
            let (a, b) = (vector(out.parts(0)), vector((face, inside)));
            let apart = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
            prop_assert!(apart < 3.0 * 2.0 / 512.0, "{}", apart);
        }
    }

    impl View {
        fn add_point(&self, [x, y, z]: [f64; 3]) {
            self.add([&[x], &[y], &[z]]);
        }
    }

    /// Least distance in a cell, which may lie beyond the edges of the face (m).
    fn distance(view: &View, level: usize, face: usize, cell: [i64; 2]) -> Option<f64> {
        let edge = EDGE >> level;
        let value = if cell.iter().all(|&at| (0..edge as i64).contains(&at)) {
            view.cell(level, face, cell)
        } else {
            let (face, cell) = Cell::of(direction(face, cell, edge)).parts(level);
            view.cell(level, face, cell)
        };
        Some(value.load(Ordering::Relaxed)).filter(|&value| value != 0).map(seen_m)
    }

    /// What a station says by the definition, distance by distance.
    fn says_by_definition(view: &View, point: [f64; 3]) -> Says {
        let (distance_m, cell) = view.station.look(point);
        let margin = margin_m(distance_m);
        if distance_m < NEAREST_M || distance_m + margin >= f64::from(FARTHEST_CM) * 0.01 {
            return Says::Nothing;
        }
        let of = |seen: f64| {
            if seen > distance_m + margin {
                Says::Through
            } else if seen + margin + 0.01 >= distance_m {
                Says::Hit
            } else {
                Says::Nothing
            }
        };
        for level in view.station.first_level()..LEVELS {
            let least_m = view.station.within_m * (EDGE >> level) as f64 / CELL_ANGLE;
            if distance_m < least_m {
                continue;
            }
            let (face, [x, y]) = cell.parts(level);
            let Some(seen) = distance(view, level, face, [x, y]) else { continue };
            if of(seen) != Says::Through {
                return of(seen);
            }
            let near = (0..9).filter(|&step| step != 4).map(|step| [x + step % 3 - 1, y + step / 3 - 1]);
            let seen: Vec<f64> = near.filter_map(|cell| distance(view, level, face, cell)).collect();
            if let Some(&seen) = seen.iter().find(|&&seen| of(seen) != Says::Through) {
                return of(seen);
            }
            if seen.len() + 1 >= LEAST_SEEN {
                return Says::Through;
            }
        }
        Says::Nothing
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(6))]
        #[test]
        fn stations_say_what_the_definition_says(seed: u64, spread in 0.01f64..0.5, within_m in prop_oneof![Just(0.0), 0.01f64..0.1]) {
            let mut state = seed;
            let mut uniform = || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            };
            let mut place = |r: f64| -> [f64; 3] {
                // Near the corners and edges of the faces, too.
                let d = [1.0, 1.0, -1.0].map(|at| at + spread * (2.0 * uniform() - 1.0));
                d.map(|v| v * r * (0.2 + uniform()))
            };
            let view = View::new(Station { at: [0.0; 3], within_m });
            (0..30_000).for_each(|_| view.add_point(place(6.0)));
            view.make_coarser();
            let mut counts = [0; 3];
            for _ in 0..3_000 {
                let point = place(5.0);
                let (distance, cell) = view.station.look(point);
                let says = view.says(distance, cell);
                prop_assert_eq!(says, says_by_definition(&view, point));
                let may = view.may_see_through(distance, cell);
                prop_assert!(says != Says::Through || may);
                prop_assert!(!may || view.reaches(point, point));
                let mut noted = [false; BATCH];
                view.note_seen_through([&[point[0]], &[point[1]], &[point[2]]], &mut noted);
                prop_assert_eq!(noted[0], may);
                counts[says as usize] += 1;
            }
            prop_assert!(counts[0] > 20 && counts[2] > 20 || within_m > 0.0, "{counts:?}");
        }

        #[test]
        fn values_beyond_a_distance_are_those_that_tell_of_more(distance_m in 0.0f64..655.3) {
            let most = beyond(distance_m);
            prop_assert!(most > 0 && seen_m(most) > distance_m);
            prop_assert!(most > FARTHEST_CM || seen_m(most + 1) <= distance_m);
        }
    }

    /// A floor at z = 0 and a wall at x = 8, seen from (0, 0, 1.6) at steps of a quarter of a degree, and whatever stands in
    /// front of them.
    fn see(views: &Views, station: usize, from: [f64; 3], in_front: impl Fn([f64; 3]) -> Option<f64>) -> Vec<[f64; 3]> {
        let mut points = Vec::new();
        for turn in 0..1440 {
            for rise in -340..340 {
                let (a, b) = ((f64::from(turn) / 4.0).to_radians(), (f64::from(rise) / 4.0).to_radians());
                let d = [b.cos() * a.cos(), b.cos() * a.sin(), b.sin()];
                let floor = if d[2] < 0.0 { -from[2] / d[2] } else { f64::INFINITY };
                let wall = if d[0] > 0.0 { (8.0 - from[0]) / d[0] } else { f64::INFINITY };
                let t = floor.min(wall).min(in_front(d).unwrap_or(f64::INFINITY));
                if t < 60.0 {
                    let point = [0, 1, 2].map(|axis| from[axis] + t * d[axis]);
                    views.views[station].add_point(point);
                    points.push(point);
                }
            }
        }
        points
    }

    #[test]
    fn what_stood_there_for_one_station_only_is_moving_and_floors_and_walls_are_not() {
        let (one, two) = ([0.0, 0.0, 1.6], [3.0, 5.0, 1.6]);
        let views = Views::new(&[one, two].map(stood), frame(), u64::MAX).unwrap();
        // Somebody like a screen, 1.7 m high, 4 m in front of the first station.
        let person = |d: [f64; 3]| {
            let t = 4.0 / d[0];
            let within = d[0] > 0.0 && (t * d[1]).abs() < 0.25 && (-1.6..0.1).contains(&(t * d[2]));
            within.then_some(t)
        };
        let of_one = see(&views, 0, one, person);
        let of_two = see(&views, 1, two, |_| None);
        views.finish();
        let on_person = |p: &&[f64; 3]| (p[0] - 4.0).abs() < 1e-9 && p[1].abs() < 0.25 && p[2] > 0.001 && p[2] < 1.7;
        let person: Vec<_> = of_one.iter().filter(on_person).collect();
        let gone = person.iter().filter(|p| views.is_moving(***p)).count();
        assert!(person.len() > 500 && gone as f64 > 0.95 * person.len() as f64, "{gone} of {}", person.len());
        let others: Vec<_> = of_one.iter().filter(|p| !on_person(p)).chain(&of_two).collect();
        let lost = others.iter().filter(|p| views.is_moving(***p)).count();
        assert!(lost * 100_000 <= others.len(), "{lost} of {}", others.len());
    }

    #[test]
    fn many_stations_are_asked_only_about_what_lies_within_what_they_saw() {
        let near = View::new(stood([0.0; 3]));
        assert!(!near.reaches([-1.0; 3], [1.0; 3]), "it saw nothing");
        near.add_point([3.0, 0.0, 0.0]);
        near.add_point([0.0, 8.0, 0.0]);
        near.make_coarser();
        assert!(near.reaches([-1.0; 3], [1.0; 3]) && near.reaches([7.0, -1.0, -1.0], [9.0, 1.0, 1.0]));
        assert!(near.reaches([-50.0, -50.0, -7.5], [50.0, 50.0, -7.0]), "in another direction it may have, too");
        assert!(!near.reaches([8.0, -50.0, -50.0], [9.0, 50.0, 50.0]));
        assert!(!near.reaches([5.0, 5.0, 5.0], [6.0, 6.0, 6.0]));
    }

    #[test]
    fn one_station_alone_takes_nothing_for_moving_and_memory_is_limited() {
        let views = Views::new(&[stood([0.0, 0.0, 1.6])], frame(), stood([0.0; 3]).bytes()).unwrap();
        let points = see(&views, 0, [0.0, 0.0, 1.6], |d| (d[0] > 0.9).then_some(2.0));
        views.finish();
        assert_eq!(points.iter().filter(|p| views.is_moving(**p)).count(), 0);
        let refused = Views::new(&[stood([0.0; 3]); 2], frame(), stood([0.0; 3]).bytes()).unwrap_err();
        assert_eq!(refused.way_out(), Some(&Parameter::Memory));
    }
}
