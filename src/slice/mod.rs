//! Columns, spans and pages: what an archive holds and what queries read.
//!
//! In: spans per pixel (from the voxel pass or a decoded page). Out: [`Page`], one tile column of 64 slices, laid out
//! for queries. Memory: a page weighs [`Page::weight_bytes`]: 4 bytes per span, about 48 per block of 8 × 8 pixels that
//! has matter, 8 per slice from the lowest with matter to the highest, 180 per page.
//!
//! A span is a maximal vertical run of matter in one pixel. Inside it no height is stored, so a wall costs one span
//! however many slices it crosses, and slices inside a wall are equal by construction.

mod colours;
mod inferred;
mod page;
mod span;

pub use colours::{Colours, Occupancy};
pub use inferred::Inferred;
pub(crate) use page::RowBuilder;
pub use page::{BLOCK_PIXELS, BlockView, Page, PageBounds, PageBuilder, PageSize};
pub use span::Span;
