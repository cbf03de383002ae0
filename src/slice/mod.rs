//! Spans and pages: the form in which archives are queried in memory.
//!
//! In: spans per pixel (from the voxel pass or a decoded page). Out: [`Page`], one tile column of 64 slices, laid out
//! for queries. Memory: a page takes [`Page::weight_bytes`]: 4 bytes per span, about 48 per occupied block of 8 × 8
//! pixels, 8 per slice from the lowest occupied one to the highest, 180 per page.
//!
//! A span is a maximal vertical solid run in one pixel. It stores no heights between its ends, so a wall costs one span
//! regardless of the number of slices it crosses, and slices inside a wall are equal by construction.

mod colours;
mod inferred;
mod page;
mod span;

pub use colours::{Colours, Occupancy};
pub use inferred::Inferred;
#[doc(hidden)]
pub use page::RowBuilder;
pub use page::{BLOCK_PIXELS, BlockView, Page, PageBounds, PageBuilder, PageSize};
pub use span::Span;
