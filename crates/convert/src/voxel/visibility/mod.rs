//! Views: images of the distances that each station of a scan measured, and detection of points that other stations saw
//! through.
//!
//! In: stations and the points measured from them. An image covers all directions on the six faces of a cube; a cell
//! keeps the least distance measured in it, in whole centimetres. Least distances do not depend on the order of points,
//! and only sums, products, quotients and square roots determine the cell of a point, so the result is the same on
//! every machine.
//!
//! A station *saw through* a place if it measured something clearly farther in the direction of the place and in all
//! directions around it. The directions around cover what a ray only grazes: a distant floor, the edge of a door, a
//! leaf. It *hit* the place if it measured something at about the same distance. A point counts as moving if at least
//! one station saw through its place and no more stations hit it, including the one that measured the point.
//!
//! If a cell has no distance, or too few of its neighbours have one, coarser images are used, which hold least
//! distances too.
//!
//! A moving scanner is modelled as a station for each short piece of its path. Its rays begin up to
//! [`Station::within_m`] away from the station's position, so a ray through a place may end in a direction that
//! deviates from that of the place by at most that length divided by the distance of the place. Only images whose cells
//! are wider than this are used: then the cell and its neighbours contain the ends of all rays through the place.
//!
//! Compare: F. Pomerleau et al., "Long-term 3D map maintenance in dynamic environments" (2014), J. Schauer, A. Nüchter,
//! "The Peopleremover" (2018), G. Kim, A. Kim, "Remove, then Revert" (2020).

mod boxes;
mod cell;
mod free;
mod places;
mod view;

use super::record::{ColumnKey, Content, Record};
use crate::frame::Frame;
use crate::{Error, Parameter, Result};
use boxes::Boxes;
use free::FreeView;
pub use free::{FreeColumn, FreeSpace};
pub use places::Places;
pub use view::Station;
use view::{BATCH, Counts, View, Visibility};

/// Most records per call of [`Views::are_moving`].
pub const CHUNK: usize = 1 << 13;

/// The views of all stations.
///
/// Memory: 4.2 MB per stationary station, 0.06 MB per moving one.
#[derive(Debug)]
pub struct Views {
    views: Vec<View>,
    frame: Frame,
}

impl Views {
    /// Creates empty views from these stations, for records on the grid `frame`. Fails if they exceed `max_bytes`.
    pub fn new(stations: &[Station], frame: Frame, max_bytes: u64) -> Result<Self> {
        Self::check_memory(stations, max_bytes)?;
        Ok(Self { views: stations.iter().map(|&station| View::new(station)).collect(), frame })
    }

    /// Fails if views from these stations exceed `max_bytes`.
    pub fn check_memory(stations: &[Station], max_bytes: u64) -> Result<()> {
        let bytes = stations.iter().map(Station::bytes).fold(0, u64::saturating_add);
        if bytes > max_bytes {
            let what = format!("memory for what {} stations saw (bytes)", stations.len());
            return Err(Error::limit(what, bytes, max_bytes).with_suggestion(Parameter::Memory));
        }
        Ok(())
    }

    /// Adds points (m) that a station measured, by coordinates.
    pub fn add(&self, station: usize, [x, y, z]: [&[f64]; 3]) {
        for begin in (0..x.len()).step_by(BATCH) {
            let batch = begin..(begin + BATCH).min(x.len());
            self.views[station].add([&x[batch.clone()], &y[batch.clone()], &z[batch]]);
        }
    }

    /// Completes the views; all points must have been added.
    pub fn finish(&self) {
        self.views.iter().for_each(View::make_coarser);
    }

    /// Makes the images from which seen space follows; the views must be complete.
    pub fn free_space(&self) -> FreeSpace {
        FreeSpace::new(self.views.iter().map(FreeView::new).collect(), self.frame)
    }

    /// Returns which of at most [`CHUNK`] records are points that count as moving.
    pub fn are_moving(&self, places: Places, records: &[Record]) -> Vec<bool> {
        let moves = self.views.iter().any(|view| view.station.within_m > 0.0);
        let boxes = if moves { Boxes::small(places, records) } else { Boxes::of_batches(places, records) };
        let mut counts = vec![Counts::default(); records.len()];
        for view in &self.views {
            for (points, range) in boxes.seen_by(view) {
                view.count(points, &mut counts[range]);
            }
        }
        let mut nearest: Option<Vec<&View>> = None;
        let mut is_moving = vec![false; records.len()];
        for (at, &counts) in counts.iter().enumerate().filter(|(_, counts)| counts.through > 0) {
            let number = boxes.number(at);
            if records[number].content() == Content::Point {
                let views = nearest.get_or_insert_with(|| self.nearest_to(boxes.middle()));
                is_moving[number] = !outweighed(views, boxes.point(at), counts);
            }
        }
        is_moving
    }

    /// Returns all views, the nearest to a place (m) first, because those are most likely to hit it.
    fn nearest_to(&self, place: [f64; 3]) -> Vec<&View> {
        let mut views: Vec<&View> = self.views.iter().collect();
        views.sort_by(|a, b| a.station.look(place).0.total_cmp(&b.station.look(place).0));
        views
    }

    /// Returns the positions of the points in a column's records.
    pub fn places(&self, column: ColumnKey) -> Places {
        Places::new(column, self.frame)
    }
}

/// Returns whether more stations hit a place (m) than saw through it. `counts` covers the stations that may have seen
/// through it; the others can only have hit it.
fn outweighed(views: &[&View], point: [f64; 3], Counts { through, mut hit }: Counts) -> bool {
    for view in views {
        if hit > through {
            break;
        }
        let (distance, cell) = view.station.look(point);
        let can_only_hit = !view.may_see_through(distance, cell);
        hit += u32::from(can_only_hit && view.says(distance, cell) == Visibility::Hit);
    }
    hit > through
}

#[cfg(test)]
mod tests;
