//! Where a pawn can walk: standing places, regions that can be reached on foot, routes, passages and leaks.
//!
//! Input: a [`Snapshot`](crate::store::Snapshot) and a [`Pawn`]. Output: [`StandingPlaces`], the standing places,
//! computed tile by tile; [`Region`], those that can be reached from one of them, with area, clearance,
//! [passages](Region::passages) and [leaks](LeakSearch); and routes ([`Search`]). Nothing is precomputed: the places of each
//! pawn come from the spans.
//!
//! ```text
//! spans → StandingPlaces (intervals that block the pawn, per pixel) → Region (flood, clearance) ┬→ storeys, passages, leaks
//!                                                                                        └→ Search → Route → Along
//! ```
//!
//! [`Planner`] plans a route as a task: it runs a bounded number of steps at a time, reports the pages that it needs,
//! and does no I/O. For long distances, plan on a coarse [level](crate::archive::Level) of the archive with [`Coarse`],
//! and let [`RouteRefiner`] find the exact route along the result, piece by piece.
//!
//! A search that reports missing pages continues where it was once they are loaded. Other pages may be evicted meanwhile:
//! as long as all pages around one place fit in memory at once, it ends, with the same answer.
//!
//! [`LongSearch`] finds what a pawn that is longer than wide reaches, such as a wheelchair, and its routes as places with
//! headings.
//!
//! If no route connects two places, [`ObstructionSearch`] finds what is in the way, and the pawn that would pass.
//!
//! # Definition of standing
//!
//! A place is the centre of a pixel and the height of the span that the feet rest on. The spans of all pixels that the
//! footprint enters are joined, and gaps lower than the body are closed: the top of each joined interval is a place
//! where the whole body fits. Such a place
//!
//! - has **floor** if a floor span ends at most 5 cm below the feet inside the footprint, or otherwise within 25 cm of
//!   the footprint's bounds ([`BESIDE_M`](crate::walk::BESIDE_M)), at most 5 cm below them or else above them: the edge
//!   of a step is an obstacle, and its tread lies beside it;
//! - is **standing** if it has floor and some span under the middle of the feet (within a pixel if the footprint has
//!   three pixels or more) ends at most the climb height below them;
//! - is a **bridge** if it has floor but the middle of the feet hangs over a gap, or if the floor lies beside it, more
//!   than 5 cm and at most the climb height above the feet, as at the lower edge of a step. A [walker](crate::walk)
//!   passes it, so the region connects over it, but it counts for neither the area nor the list of places.
//!
//! From a place the pawn steps to the neighbouring pixels: up by at most its climb height above the floor that it
//! stands on, onto places whose floor is no higher than that (from the lower edge of a step, up to that floor), with
//! headroom on both sides, and down by at most [`Pawn::max_drop`]. A [walker](crate::walk) uses the same floor and
//! climb height, and has followed every [`Route`] that is returned. All arithmetic on places uses integers, so the
//! result depends neither on the order in which pages arrive nor on where the scan lies in its tiles.
//!
//! # Memory
//!
//! [`StandingPlaces`] holds 16 KiB for each tile (64 × 64 pixels) that the search touches and 20 bytes for each place
//! in it; [`Region`] holds 37 bytes for each place that it reaches; [`Search`] another 12, [`LongSearch`] another 65.
//! Pages are needed only while their tile is computed.

mod blocked;
mod coarse_planner;
mod distance;
mod footprints;
mod grades;
mod intervals;
mod leaks;
mod long;
mod passages;
mod pawn;
mod planner;
mod refine;
mod region;
mod route;
mod standing;
mod storeys;
mod tiles;

pub use blocked::{Obstruction, ObstructionSearch, Reason, Sought};
pub use coarse_planner::Coarse;
pub use leaks::{Leak, LeakKind, LeakSearch};
pub use long::{LongReached, LongSearch};
pub use passages::Passage;
pub use pawn::Pawn;
pub use planner::{Planned, Planner};
pub use refine::RouteRefiner;
pub use region::{Flood, Place, Region};
pub use route::{Refusal, Route, Search};
pub use standing::{PlaceId, Snapped, StandingPlaces};
pub use storeys::{Storey, Storeys};

use crate::query::Answer;
use crate::store::Missing;
use crate::{Error, Result};
use std::ops::ControlFlow;

/// Most pages above one another, and most spans in a tile and the pixels around it, for which standing places are
/// computed: some hundred MiB. Scans have a hundredth of that.
const MOST_PAGES: usize = 4096;
const MOST_SPANS: usize = 1 << 21;
/// Spans allowed for each pixel under a large footprint, where more than [`MOST_SPANS`] do not mean a forged archive.
const SPANS_OF_A_PIXEL: usize = 4;

/// Reason why a value is unknown.
enum Stop {
    /// These pages are not loaded.
    Missing(Missing),
    /// Too many pages lie above one another: their number.
    Pages(usize),
    /// Too many spans: at least this number, and the most that are allowed.
    Spans(usize, usize),
}

impl Stop {
    /// Returns the missing pages as an answer, or a limit as an error.
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
            Self::Spans(found, most) => limit("spans", found, most),
        }
    }
}

/// A value, or why it is unknown.
type Needs<T> = ControlFlow<Stop, T>;

fn answer<T>(needs: Needs<T>) -> Result<Answer<T>> {
    match needs {
        ControlFlow::Continue(value) => Ok(Answer::Known(value)),
        ControlFlow::Break(stop) => stop.answer(),
    }
}
