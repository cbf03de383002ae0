//! Sums over the points of 3 × 3 pixels, row by row. They classify rough ground of few points, where every pixel's
//! surface needs a fit.

use crate::voxel::accumulate::{Moments, place_in_patch};
use crate::voxel::bands::Bands;
use crate::voxel::record::{Content, PATCH_PIXELS, Record};

/// The ten numbers of [`Moments`] for each pixel of a row.
type Row = [[i64; PATCH_PIXELS]; 10];

/// Sums of each pixel's window, about one origin for the whole patch; fits do not depend on the origin. Memory: 21 kB,
/// reused.
#[derive(Debug)]
pub struct Windows {
    /// Sums of single pixels, for three rows; row `y` is at index `y % 3`.
    own: Box<[Row; 3]>,
    /// Rows in `own`; [`NO_ROW`] for those of an earlier patch.
    rows: [usize; 3],
    /// Sums of the windows of a row.
    sums: Box<Row>,
    row: usize,
    /// Lowest band of the patch.
    lowest: u32,
}

const NO_ROW: usize = usize::MAX;

impl Default for Windows {
    fn default() -> Self {
        let row = || [[0; PATCH_PIXELS]; 10];
        let own = Box::new([row(), row(), row()]);
        Self { own, rows: [NO_ROW; 3], sums: Box::new(row()), row: NO_ROW, lowest: 0 }
    }
}

impl Windows {
    /// Begins a patch whose sums are about the band `lowest`.
    pub fn begin(&mut self, lowest: u32) {
        (self.rows, self.row, self.lowest) = ([NO_ROW; 3], NO_ROW, lowest);
    }

    /// Returns the sums over all points in the 3 × 3 pixels around a pixel that is not in the halo; `records` returns
    /// those of each pixel. Cost when called row by row: each point once, and 40 additions per pixel.
    #[inline]
    pub fn around<'a>(&mut self, pixel: usize, records: impl Fn(usize) -> &'a [Record], bands: Bands) -> Moments {
        let (row, x) = (pixel / PATCH_PIXELS, pixel % PATCH_PIXELS);
        if self.row != row {
            self.enter(row, records, bands);
        }
        Moments::from_numbers(std::array::from_fn(|number| self.sums[number][x]))
    }

    fn enter<'a>(&mut self, row: usize, records: impl Fn(usize) -> &'a [Record], bands: Bands) {
        let Self { own, rows, sums, lowest, .. } = self;
        for y in row - 1..=row + 1 {
            if std::mem::replace(&mut rows[y % 3], y) == y {
                continue;
            }
            let to = &mut own[y % 3];
            for x in 0..PATCH_PIXELS {
                let mut sums = Moments::default();
                let points = records(y * PATCH_PIXELS + x).iter().filter(|record| record.content() == Content::Point);
                for &record in points {
                    let [u, v, w] = place_in_patch(record, y * PATCH_PIXELS + x, bands, *lowest);
                    sums.add(u, v, w);
                }
                to.iter_mut().zip(sums.numbers()).for_each(|(to, number)| to[x] = number);
            }
        }
        let [a, b, c] = &**own;
        for (number, sums) in sums.iter_mut().enumerate() {
            let column: [i64; PATCH_PIXELS] = std::array::from_fn(|x| a[number][x] + b[number][x] + c[number][x]);
            for x in 1..PATCH_PIXELS - 1 {
                sums[x] = column[x - 1] + column[x] + column[x + 1];
            }
        }
        self.row = row;
    }
}
