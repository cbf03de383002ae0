//! Directions as cells of images on the six faces of a cube.
//!
//! Only sums, products, quotients and square roots determine the cell of a direction, so the result is the same on
//! every machine.

/// Cells along an edge of a face of the finest image; 0.18° in the middle of the face.
pub(super) const EDGE: usize = 1 << EDGE_BITS;
const EDGE_BITS: u32 = 9;
/// Images of a station; each is half as fine as the previous.
pub(super) const LEVELS: usize = 5;

/// 2⁵²: numbers from here on are whole, and their distance from it is in their low bits.
const WHOLE: f64 = (1u64 << 52) as f64;

/// Rounds `v` down; `v` must be at least 0 and less than 2⁵¹. Compiles to vector instructions everywhere.
#[inline(always)]
pub(super) fn floor(v: f64) -> f64 {
    let nearest = v + WHOLE - WHOLE;
    if nearest > v { nearest - 1.0 } else { nearest }
}

/// Returns the whole number `v`, at least 0 and less than 2³², in the low bits.
#[inline(always)]
pub(super) fn low_bits(v: f64) -> u64 {
    (v + WHOLE).to_bits()
}

/// A cell of the finest image: face of the cube, row and column. Edges are powers of two, so shifts give the cells of
/// coarser images.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(super) struct Cell(u32);

impl Cell {
    /// Returns the cell of a direction. Has no branches and conversions, so that loops over many directions compile to
    /// vector instructions.
    #[inline(always)]
    pub fn of(d: [f64; 3]) -> Self {
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
            // Also handles a zero vector, for which `at` is NaN.
            floor(if at < LAST { at } else { LAST })
        };
        let (column, row) = (place(pick(d[1], d[2], d[0])), place(pick(d[2], d[0], d[1])));
        Self(low_bits((face * EDGE as f64 + row) * EDGE as f64 + column) as u32)
    }

    /// Returns a cell of the finest image that lies in this cell of the image of `level`.
    #[inline]
    pub fn within(face: usize, [column, row]: [usize; 2], level: usize) -> Self {
        Self(((face * EDGE + (row << level)) * EDGE + (column << level)) as u32)
    }

    /// Face, column and row in the image of `level`.
    #[inline]
    pub fn parts(self, level: usize) -> (usize, [i64; 2]) {
        let part = |shift: u32| ((self.0 >> shift) as usize % EDGE) >> level;
        ((self.0 >> (2 * EDGE_BITS)) as usize, [part(0) as i64, part(EDGE_BITS) as i64])
    }

    /// Index in the image of `level`.
    #[inline]
    pub fn index(self, level: usize) -> usize {
        let (face, [column, row]) = self.parts(level);
        ((face << (EDGE_BITS as usize - level)) + row as usize) << (EDGE_BITS as usize - level) | column as usize
    }
}

/// Direction of the middle of a cell, which may lie beyond the edges of the face.
pub(super) fn direction(face: usize, cell: [i64; 2], edge: usize) -> [f64; 3] {
    let axis = face / 2;
    let mut d = [0.0; 3];
    d[axis] = if face % 2 == 1 { -1.0 } else { 1.0 };
    for (step, cell) in [1, 2].into_iter().zip(cell) {
        d[(axis + step) % 3] = (2 * cell + 1) as f64 / edge as f64 - 1.0;
    }
    d
}
