//! Spans and pages: the form in which archives are queried in memory.
//!
//! In: spans per pixel (from the voxel pass or a decoded page). Out: [`Page`], one tile column of 64 slices, laid out
//! for queries. Memory: a page takes [`Page::weight_bytes`]: 4 bytes per span, about 48 per occupied block of 8 × 8
//! pixels, 8 per slice from the lowest occupied one to the highest, 180 per page.
//!
//! A span is a maximal vertical solid run in one pixel. It stores no heights between its ends, so a wall costs one span
//! regardless of the number of slices it crosses, and slices inside a wall are equal by construction.

mod inferred;
mod page_colours;
mod span;
mod spans;

pub use inferred::Inferred;
pub use page_colours::{Colours, Occupancy};
pub use span::Span;
#[doc(hidden)]
pub use span::joins;
#[doc(hidden)]
pub use spans::RowBuilder;
pub use spans::{BLOCK_PIXELS, BlockView, Page, PageBounds, PageBuilder, PageSize};
