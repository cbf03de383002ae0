//! One traversal that answers all of a walker's questions.

use super::answer::Answer;
use super::batch;
use super::blocks::{MATTER, OBSTACLE};
use super::floor::FloorSearch;
use super::footprint::{Touch, for_each_column};
use super::grid::Shape;
use super::grid::sealed::OnPixels;
use crate::store::{Snapshot, join};
use std::ops::ControlFlow;

/// Result of [`probe`]: contacts of a shape, and the floor under it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Probe {
    /// The shape touches something solid.
    pub hit: bool,
    /// The shape touches an obstacle.
    pub obstacle: bool,
    /// World height (m) of the highest floor at or below the shape's top, at any depth, in the pixels of its footprint
    /// (see [`floor_under`](super::floor_under)).
    pub floor_z: Option<f64>,
}

/// Returns the contacts of `shape` and the floor under it from one traversal of the pages. Not loaded if a page that is
/// not in memory could change any of the three fields.
///
/// Cost: an [`overlaps`](super::overlaps) that does not end before the first obstacle, and a
/// [`floor_under`](super::floor_under).
pub fn probe<H: Shape>(set: &Snapshot, shape: &H) -> Answer<Probe> {
    let shape = shape.on_grid(set.frame());
    let mut touch = Touch::new(&shape, OBSTACLE);
    let mut untouched = None;
    let mut floor = FloorSearch::new(-1 << 50, shape.heights().high);
    for_each_column(set, shape.rect(), |tile, slots| {
        if !touch.done() {
            // A break only means that `touch` has found all it looks for.
            let _ = touch.column(&shape, tile, slots, &mut untouched);
        }
        floor.column(&shape, tile, slots);
        ControlFlow::Continue(())
    });
    let floor = floor.settle(set, &shape);
    let (hit, obstacle) = (touch.found & MATTER != 0, touch.found & OBSTACLE != 0);
    let mut missing = floor.missing;
    if let (Some(more), false) = (untouched, obstacle) {
        join(&mut missing, &more);
    }
    Answer::new(Probe { hit, obstacle, floor_z: floor.floor_z(set.frame()) }, missing)
}

/// Runs [`probe`] for each of `shapes`, in order, into `answers`.
///
/// # Panics
/// If `answers` is shorter than `shapes`.
pub fn probe_batch<H: Shape>(set: &Snapshot, shapes: &[H], answers: &mut [Answer<Probe>]) {
    batch::answer_each(set, shapes, answers, |shape| batch::pixel_of(set, shape), |shape| probe(set, shape));
}
