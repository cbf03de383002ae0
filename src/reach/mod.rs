//! Where a pawn can walk: standing places, what can be reached on foot, the way, and every leak.
//!
//! In: a [`PageSet`](crate::store::PageSet) and a [`Pawn`]. Out: [`StandingPlaces`], the standing places of tile after tile;
//! [`Region`], those that can be reached from one of them, with area, clearance, [passages](Region::passages) and
//! [leaks](Leak); and routes ([`Search`]). Nothing is precomputed: each pawn gets its own places from the spans.
//!
//! ```text
//! spans → StandingPlaces (intervals that block the pawn, per pixel) → Region (flood, clearance) ┬→ storeys, passages, leaks
//!                                                                                        └→ Search → Route → Along
//! ```
//!
//! [`Planner`] is a route as a task: it goes on a bounded number of steps at a time, names the pages that it needs, and never reads. For
//! long distances, plan on a coarse [level](crate::archive::Level) of the archive with [`Coarse`], and let [`Along`] find the exact way along
//! that one, piece by piece.
//!
//! # What counts as standing
//!
//! A place is the centre of a pixel and the height of the matter that the feet rest on. The spans of all pixels that the
//! footprint touches are joined, and gaps lower than the body closed: the top of each joined interval is a place where the
//! whole body fits. Such a place
//!
//! - has **floor** if a floor span ends at most 5 cm below the feet inside the footprint, or else at most 5 cm below or above them
//!   within 25 cm of the footprint's bounds ([`BESIDE_M`](crate::walk::BESIDE_M)): the edge of a step is an obstacle, its tread lies
//!   beside;
//! - is **standing** if it has floor and matter lies under the middle of the feet (within a pixel, for a footprint of three pixels or
//!   more), no deeper than the climb height;
//! - is a **bridge** if it has floor but the middle of the feet hangs over a gap, or if floor lies beside it more than 5 cm and no more
//!   than the climb height above the feet, as at the lower edge of a step: a [walker](crate::walk) passes, so the region connects
//!   over it, but it counts for neither area nor the list of places.
//!
//! From a place the pawn steps to the neighbouring pixels: up to its climb height above the floor that it stands on, onto what has
//! floor no higher than that (from the lower edge of a step up to that floor), with room for its head on both sides, and down at most [`Pawn::max_drop`]. A [walker](crate::walk) has
//! the same floor and climbs as far, and it has followed every [`Route`] that is found. All arithmetic on places is on integers, so the
//! answer does not depend on the order in which pages arrive, nor on where the scan lies in its tiles.
//!
//! # Memory
//!
//! [`StandingPlaces`] holds 16 KiB for each tile (64 × 64 pixels) that the search touches and 20 bytes for each place in it;
//! [`Region`] holds 37 bytes for each place that it reaches; [`Search`] another 12. Pages are needed only while their tile is
//! computed.

mod along;
mod coarse;
mod distance;
mod intervals;
mod leaks;
mod passages;
mod pawn;
mod planner;
mod region;
mod route;
mod standing;
mod storeys;

pub use along::Along;
pub use coarse::Coarse;
pub use leaks::{Leak, LeakKind};
pub use passages::Passage;
pub use pawn::Pawn;
pub use planner::{Planned, Planner};
pub use region::{Flood, Place, Region};
pub use route::{Refusal, Route, Search};
pub use standing::{Snapped, Spot, StandingPlaces};
pub use storeys::{Storey, Storeys};

use crate::query::Answer;
use crate::store::Missing;
use crate::{Error, Result};
use std::ops::ControlFlow;

/// Most pages over one another, and most spans over a tile and the pixels around it, of which standing places are computed: some
/// hundred MiB. Scans have a hundredth of it.
const MOST_PAGES: usize = 4096;
const MOST_SPANS: usize = 1 << 21;

/// Why a value is not known.
enum Stop {
    /// Without these pages.
    Missing(Missing),
    /// So many pages lie over one another.
    Pages(usize),
    /// So many spans, or more.
    Spans(usize),
}

impl Stop {
    /// As a half answer, or an error.
    fn answer<T>(self) -> Result<Answer<T>> {
        let limit = |what: &str, found: usize, most: usize| {
            Err(Error::limit(
                format!("{what} over one tile, of which standing places are computed"),
                found as u64,
                most as u64,
            ))
        };
        match self {
            Self::Missing(missing) => Ok(Answer::NotLoaded(missing)),
            Self::Pages(found) => limit("pages", found, MOST_PAGES),
            Self::Spans(found) => limit("spans", found, MOST_SPANS),
        }
    }
}

/// A value, or why it is not known.
type Needs<T> = ControlFlow<Stop, T>;

fn answer<T>(needs: Needs<T>) -> Result<Answer<T>> {
    match needs {
        ControlFlow::Continue(value) => Ok(Answer::Known(value)),
        ControlFlow::Break(stop) => stop.answer(),
    }
}
