//! Exact parts of queries, for programs that traverse pages themselves, as `slicewalk-gpu` does.

use super::grid::Shape;
use super::grid::sealed::OnPixels;
use crate::frame::Frame;

/// Pixels under a shape and its heights, as the queries use them; all ends inclusive.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GridExtent {
    /// First and last pixel along x.
    pub i: [i64; 2],
    /// First and last pixel along y.
    pub j: [i64; 2],
    /// Lowest and highest height (quanta); the shape meets spans with a top at or above the first and a bottom at or
    /// below the second.
    pub heights: [i64; 2],
}

/// Returns the smallest rectangle of pixels around the footprint of `shape`, and the heights of the whole shape.
#[doc(hidden)]
#[inline]
pub fn grid_extent<H: Shape>(frame: &Frame, shape: &H) -> GridExtent {
    let shape = shape.on_grid(frame);
    let (rect, heights) = (shape.rect(), shape.heights());
    GridExtent { i: [rect.i0, rect.i1], j: [rect.j0, rect.j1], heights: [heights.low, heights.high] }
}
