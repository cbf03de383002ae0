//! Spans of triangles, and the interior of closed meshes.

use super::tree::MOST_ITEMS;
use crate::{Error, Result};

type Pixel = (i64, i64);

/// Surfaces and crossings that triangles leave in the pixels, in any order.
#[derive(Debug, Default)]
pub(super) struct Columns {
    /// Heights of surfaces (quanta).
    surfaces: Vec<(Pixel, (i64, i64))>,
    /// Heights at which the line through the middle of a pixel crosses a surface (quanta), and the change of the
    /// winding number there.
    crossings: Vec<(Pixel, f64, i32)>,
}

impl Columns {
    pub(super) fn add(&mut self, pixel: Pixel, heights: (i64, i64)) {
        self.surfaces.push((pixel, heights));
    }

    pub(super) fn cross(&mut self, pixel: Pixel, height: f64, change: i32) {
        self.crossings.push((pixel, height, change));
    }

    /// Fails if a triangle of about `pixels` more would exceed the limit. When the list is full it merges overlapping
    /// surfaces before it grows, so that millions of small triangles take no more memory than the pixels they touch.
    pub(super) fn make_room(&mut self, pixels: f64) -> Result<()> {
        if self.surfaces.len() == self.surfaces.capacity() && !self.surfaces.is_empty() {
            unite(&mut self.surfaces);
            self.surfaces.reserve(self.surfaces.len());
        }
        let most = MOST_ITEMS as f64;
        if self.surfaces.len() as f64 + pixels > most || self.crossings.len() as f64 + pixels > most {
            let what = "pixels of a model's triangles (give a larger pixel)";
            return Err(Error::limit(what, "more", MOST_ITEMS));
        }
        Ok(())
    }
}

/// Returns the spans, merged where they share a height. Between two crossings of a pixel it is solid if the winding
/// number is not zero: inside one body or several, whichever way their faces are oriented.
pub(super) fn fill(columns: Columns) -> Vec<(Pixel, (i64, i64))> {
    let Columns { mut surfaces, mut crossings } = columns;
    crossings.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    for column in crossings.chunk_by(|a, b| a.0 == b.0) {
        let mut winding = 0;
        for (&(pixel, low, change), &(_, high, _)) in column.iter().zip(&column[1..]) {
            winding += change;
            if winding != 0 {
                surfaces.push((pixel, (low.floor() as i64, high.ceil() as i64)));
            }
        }
    }
    unite(&mut surfaces);
    surfaces
}

/// Sorts the surfaces and merges neighbours that share a height.
fn unite(surfaces: &mut Vec<(Pixel, (i64, i64))>) {
    surfaces.sort_unstable();
    surfaces.dedup_by(|next, kept| {
        let same = next.0 == kept.0 && next.1.0 <= kept.1.1;
        if same {
            kept.1.1 = kept.1.1.max(next.1.1);
        }
        same
    });
}
