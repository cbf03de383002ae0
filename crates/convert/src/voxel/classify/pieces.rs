//! Pieces and runs: the solids of one pixel from bottom to top.

use crate::frame::{Frame, SLICE_QUANTA};
use crate::voxel::accumulate::{BINS, Patch, Voxel, neighbourhood};
use crate::voxel::bands::Bands;
use std::ops::RangeInclusive;

/// Longest void inside a run (pixels): the most that two adjacent bands can leave at the default slice height.
const LONGEST_VOID_PIXELS: f64 = 6.0;

/// Joins pieces to runs (see the [parent module](super)).
#[derive(Debug, Clone, Copy)]
pub struct Runs {
    bands: Bands,
    /// Void that joins two pieces without further evidence (quanta).
    pixel: f64,
    longest_void: f64,
    /// Greatest rise of a surface at the limit across one pixel, by which it can extend into a void (quanta).
    intrusion: f64,
}

impl Runs {
    pub fn new(frame: &Frame, bands: Bands, intrusion: f64) -> Self {
        let pixel = frame.pixel_m() / frame.quantum_m();
        Self { bands, pixel, longest_void: LONGEST_VOID_PIXELS * pixel, intrusion }
    }

    /// Marks the voxels of runs that extend further than `greatest_extent` (quanta).
    pub fn mark(&self, patch: &Patch, pixel: usize, greatest_extent: f64, marks: &mut [bool]) {
        let connected = |below: &Piece, above: &Piece| self.connected(patch, pixel, below, above);
        self.mark_connected(patch, pixel, connected, greatest_extent, marks);
    }

    /// Like [`mark`](Self::mark), but considers only the solids of the pixel itself.
    pub fn mark_alone(&self, patch: &Patch, pixel: usize, greatest_extent: f64, marks: &mut [bool]) {
        let connected = |below: &Piece, above: &Piece| (above.low - below.high) as f64 <= self.pixel;
        self.mark_connected(patch, pixel, connected, greatest_extent, marks);
    }

    /// Sets `extents` to the greatest extent (quanta) of a run for each voxel of a pixel.
    pub fn extents(&self, patch: &Patch, pixel: usize, extents: &mut Vec<i64>) {
        let voxels = &patch.voxels()[patch.range(pixel)];
        extents.clear();
        extents.resize(voxels.len(), 0);
        let connected = |below: &Piece, above: &Piece| self.connected(patch, pixel, below, above);
        self.for_each_run(voxels, connected, |voxels, extent| {
            extents[voxels].iter_mut().for_each(|greatest| *greatest = extent.max(*greatest));
        });
    }

    fn mark_connected(
        &self,
        patch: &Patch,
        pixel: usize,
        connected: impl Fn(&Piece, &Piece) -> bool,
        greatest_extent: f64,
        marks: &mut [bool],
    ) {
        let range = patch.range(pixel);
        let mut start = range.start;
        // No run crosses an empty band, so most pixels are settled without their pieces.
        for stack in patch.voxels()[range].chunk_by(|below, above| self.adjacent(below, above)) {
            if let [first, .., last] | [first @ last] = stack
                && (last.quanta_above(first.slice.into()).1 - i64::from(first.bottom)) as f64 > greatest_extent
            {
                self.for_each_run(stack, &connected, |voxels, extent| {
                    if extent as f64 > greatest_extent {
                        marks[start + voxels.start()..=start + voxels.end()].fill(true);
                    }
                });
            }
            start += stack.len();
        }
    }

    /// Calls `give` with the voxels and the extent (quanta) of each run: pieces in the same or adjacent bands, each
    /// `connected` to the next.
    fn for_each_run(
        &self,
        voxels: &[Voxel],
        connected: impl Fn(&Piece, &Piece) -> bool,
        mut give: impl FnMut(RangeInclusive<usize>, i64),
    ) {
        let mut run: Option<(Piece, Piece)> = None;
        for piece in pieces(voxels) {
            run = Some(match run {
                Some((first, last))
                    if self.adjacent(&voxels[last.voxel], &voxels[piece.voxel]) && connected(&last, &piece) =>
                {
                    (first, piece)
                }
                ended => {
                    if let Some((first, last)) = ended {
                        give(first.voxel..=last.voxel, last.high - first.low);
                    }
                    (piece, piece)
                }
            });
        }
        if let Some((first, last)) = run {
            give(first.voxel..=last.voxel, last.high - first.low);
        }
    }

    /// Returns whether two voxels, one above the other, lie in one band or in adjacent ones.
    #[inline]
    fn adjacent(&self, below: &Voxel, above: &Voxel) -> bool {
        self.bands.of(above.slice) - self.bands.of(below.slice) <= 1
    }

    /// Returns whether two consecutive pieces of `pixel` are parts of one run.
    fn connected(&self, patch: &Patch, pixel: usize, below: &Piece, above: &Piece) -> bool {
        let void = (above.low - below.high) as f64;
        if void <= self.pixel {
            return true;
        }
        let margin = (void / 4.0).max(self.intrusion);
        if 2.0 * margin >= void || void > self.longest_void {
            return false;
        }
        let (low, high) = (below.high as f64 + margin, above.low as f64 - margin);
        let near_height = |neighbour: usize, height: i64| {
            let band = self.bands.of((height / SLICE_QUANTA) as u32);
            &patch.voxels()[patch.between(neighbour, self.bands.around(band))]
        };
        let reaches_in = |neighbour: usize| {
            near_height(neighbour, below.high).iter().any(|voxel| {
                let (bottom, top) = voxel.quanta_above(0);
                top as f64 >= low && bottom as f64 <= high
            })
        };
        let matter = |neighbour: usize| pieces(near_height(neighbour, below.high));
        let inside = |piece: Piece| low <= piece.low as f64 && piece.high as f64 <= high;
        let near = |a: i64, b: i64| (a - b).abs() as f64 <= self.intrusion;
        // A slab's next pixel has the same void between the same ends, a wall's does not.
        let same_void = |neighbour: usize| {
            matter(neighbour).any(|piece| near(piece.high, below.high))
                && pieces(near_height(neighbour, above.low)).any(|piece| near(piece.low, above.low))
                && !matter(neighbour).any(|piece| piece.high as f64 > low && (piece.low as f64) < high)
        };
        neighbourhood(pixel).any(|(neighbour, ..)| {
            reaches_in(neighbour) && matter(neighbour).any(inside) && !same_void(2 * pixel - neighbour)
        })
    }
}

/// An uninterrupted solid interval in one voxel, in quanta above the column block's floor.
#[derive(Debug, Clone, Copy)]
struct Piece {
    /// Number of the voxel in its pixel.
    voxel: usize,
    low: i64,
    high: i64,
}

/// Returns the pieces of a pixel's voxels, lowest first.
fn pieces(voxels: &[Voxel]) -> impl Iterator<Item = Piece> {
    voxels.iter().enumerate().flat_map(|(number, voxel)| {
        let floor = i64::from(voxel.slice) * SLICE_QUANTA;
        let mut left = u32::from(voxel.bins);
        std::iter::from_fn(move || {
            if left == 0 {
                return None;
            }
            let first = left.trailing_zeros();
            let end = first + (!(left >> first)).trailing_zeros();
            left &= !0 << end;
            // Bins are coarse; the voxel's own ends are exact.
            let low = if first == voxel.bins.trailing_zeros() {
                i64::from(voxel.bottom)
            } else {
                i64::from(first) * SLICE_QUANTA / BINS
            };
            let high = if left == 0 { i64::from(voxel.top) } else { i64::from(end) * SLICE_QUANTA / BINS };
            Some(Piece { voxel: number, low: floor + low, high: floor + high })
        })
    })
}
