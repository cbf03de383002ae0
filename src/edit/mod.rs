//! Edits of a scan that leave its archive untouched: solids taken away and added.
//!
//! In: prisms (an outline in plan, a bottom and a top). Out: the pages of an archive as they are with the edits. An
//! [`Archive`](crate::archive::Archive) that [carries edits](crate::archive::Archive::with_edits) gives stores and
//! streams whose queries, pawns, regions and routes see the changed space; the archive's own pages, its directory and
//! its bytes stay as they are.
//!
//! Edits apply in the order in which they were made, so a later one wins.
//!
//! - **Removed**: solid strictly between the bottom and the top of a prism, in pixels whose middle lies in its outline.
//!   Solid that remains below is cut level, so it is floor.
//! - **Added**: solid from the bottom to the top, both included, in every pixel that the outline touches. The top is
//!   floor or an obstacle, as requested; everything below the top slice is an obstacle.
//!
//! In an overview level, solid is taken away only in pixels that lie wholly in the outline, so that the level still covers
//! all solid of the archive.

mod column;
mod polygon;

pub(crate) use column::{EditedColumn, MOST_EDITED_PAGES};
use polygon::Outline;

use crate::frame::Frame;
use crate::{Error, Result};
use nalgebra::Point2;

/// Most edits of one archive.
pub const MOST_EDITS: usize = 10_000;
/// Most corners of an outline.
pub const MOST_CORNERS: usize = 1_000;
/// Farthest coordinate of a prism (m).
const FARTHEST_M: f64 = 1e9;

/// An upright prism: an outline in plan, a bottom and a top (m).
#[derive(Debug, Clone, PartialEq)]
pub struct Prism {
    outline: Outline,
    bottom: f64,
    top: f64,
}

impl Prism {
    /// Creates the prism over an outline of 3 to [`MOST_CORNERS`] corners, in either direction. Places that an outline
    /// which crosses itself surrounds twice count as outside. Fails if a number is not finite or beyond 10⁹ m, if there
    /// are too few or too many corners, if the outline has no area, or unless `bottom < top`.
    pub fn new(corners: &[Point2<f64>], bottom: f64, top: f64) -> Result<Self> {
        let bad = |reason: String| Err(Error::parameter("prism", reason));
        if !(3..=MOST_CORNERS).contains(&corners.len()) {
            return bad(format!("expected 3 to {MOST_CORNERS} corners, found {}", corners.len()));
        }
        let numbers = corners.iter().flat_map(|corner| [corner.x, corner.y]).chain([bottom, top]);
        if let Some(wrong) = numbers.into_iter().find(|number| !(-FARTHEST_M..=FARTHEST_M).contains(number)) {
            return bad(format!("expected numbers from -1e9 to 1e9 m, found {wrong}"));
        }
        if bottom >= top {
            return bad(format!("expected a bottom below the top, found {bottom} and {top} m"));
        }
        let Some(outline) = Outline::new(corners) else {
            return bad("expected corners around an area, found a line".to_owned());
        };
        Ok(Self { outline, bottom, top })
    }

    /// Creates the box between two corners (m).
    pub fn of_box(min: [f64; 3], max: [f64; 3]) -> Result<Self> {
        let corners = [[min[0], min[1]], [max[0], min[1]], [max[0], max[1]], [min[0], max[1]]].map(Point2::from);
        if min[0] >= max[0] || min[1] >= max[1] {
            let reason = format!("expected minima below maxima, found {min:?} and {max:?}");
            return Err(Error::parameter("box", reason));
        }
        Self::new(&corners, min[2], max[2])
    }

    /// Returns the pixels around the outline that a change may affect: first and last along x and y.
    fn pixels(&self, frame: &Frame, change: Change) -> [[i64; 2]; 2] {
        let [low, high] = self.outline.bounds();
        let first = |at: f64| {
            let pixel = frame.pixel_of(at);
            // An outline on the border of two pixels touches both.
            let touches_both = change != Change::Removed && frame.edge_of_pixel(pixel) >= at;
            pixel - i64::from(touches_both)
        };
        [[first(low.x), first(low.y)], [frame.pixel_of(high.x), frame.pixel_of(high.y)]]
    }
}

/// Kind of an edit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Change {
    Removed,
    Added { is_floor: bool },
}

/// Solids taken away from a scan and added to it, in order.
///
/// ```
/// use slicewalk::edit::{Edits, Prism};
///
/// let mut edits = Edits::default();
/// edits.remove(Prism::of_box([4.0, 0.0, 0.0], [4.2, 6.0, 2.5])?)?; // a wall that was torn down
/// edits.add(Prism::of_box([1.0, 1.0, 0.0], [2.0, 2.0, 0.75])?, true)?; // a table that one can stand on
/// # Ok::<(), slicewalk::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Edits {
    all: Vec<(Prism, Change)>,
}

impl Edits {
    /// Takes the solid in a prism away. Fails if there are [`MOST_EDITS`] edits already.
    pub fn remove(&mut self, prism: Prism) -> Result<()> {
        self.push(prism, Change::Removed)
    }

    /// Adds a solid prism, with floor on top or without. Fails if there are [`MOST_EDITS`] edits already.
    pub fn add(&mut self, prism: Prism, is_floor: bool) -> Result<()> {
        self.push(prism, Change::Added { is_floor })
    }

    fn push(&mut self, prism: Prism, change: Change) -> Result<()> {
        if self.all.len() >= MOST_EDITS {
            return Err(Error::limit("edits", self.all.len() + 1, MOST_EDITS));
        }
        self.all.push((prism, change));
        Ok(())
    }

    /// Returns whether nothing changes.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Returns the lower and the upper corner (m) around the pixels and quanta that added prisms fill; `None` if nothing is
    /// added.
    pub fn added_bounds(&self, frame: &Frame) -> Option<([f64; 3], [f64; 3])> {
        let added = self.all.iter().filter(|(_, change)| *change != Change::Removed);
        let boxes = added.map(|(prism, change)| {
            let [[x0, y0], [x1, y1]] = prism.pixels(frame, *change);
            let [bottom, top] = [frame.quantum_floor(prism.bottom), frame.quantum_ceil(prism.top)];
            let low = [frame.edge_of_pixel(x0), frame.edge_of_pixel(y0), frame.bottom_height(bottom)];
            (low, [frame.edge_of_pixel(x1 + 1), frame.edge_of_pixel(y1 + 1), frame.top_height(top)])
        });
        boxes.reduce(|(low, high), (min, max)| {
            ([0, 1, 2].map(|axis| low[axis].min(min[axis])), [0, 1, 2].map(|axis| high[axis].max(max[axis])))
        })
    }

    /// Returns the number of edits.
    pub fn len(&self) -> usize {
        self.all.len()
    }
}

#[cfg(test)]
mod tests;
