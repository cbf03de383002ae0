//! Conversion of scans and meshes into one archive.
//!
//! ```no_run
//! use slicewalk_convert::{ConvertOptions, PixelSize, convert};
//!
//! let mut options = ConvertOptions::new(vec!["scan.laz".into()], "scan.slices".into());
//! options.grid.pixel = PixelSize::Metres(0.05); // or PixelSize::Auto: four times the point spacing
//! options.plan.max_slope_deg = 40.0;
//! let report = convert(&options, &slicewalk::NoMonitor)?;
//! println!("{} voxels", report.header.voxels.occupied);
//! # Ok::<(), slicewalk::Error>(())
//! ```
//!
//! Two passes in bounded memory. First, all workers read pieces of the input and sort their points, and the voxels that
//! triangles fill, into runs by tile column. Then the merged runs yield tile columns in archive order: workers
//! accumulate them to voxels, classify floors and obstacles, form spans and encode pages, and one thread writes the
//! pages in order.
//!
//! Memory for a budget of `M`: `M/2` for runs kept in memory; `M/4` for runs under construction and afterwards for
//! columns being processed; `M/8` each for pieces of the input and for encoded pages. Nothing is sized by what a header
//! states.

mod colours;
mod columns;
mod conversion;
mod cubes;
mod facts;
mod free;
mod holes;
#[doc(hidden)]
pub mod info;
mod inputs;
mod meshes;
mod options;
mod pages;
mod pipeline;
mod plan_file;
mod planning;
mod points;
mod preview;
mod removed;
mod report;
mod resume;
mod shard_filter;
mod shard_inputs;
#[doc(hidden)]
pub mod size;
mod splats;
mod split;
mod stations;
mod sync;
#[cfg(test)]
mod tests;
mod upright;
#[doc(hidden)]
pub mod values;
mod voxel;
mod work;
mod writer;

pub use conversion::convert;
pub use facts::InputFacts;
pub use free::SeenCounts;
pub use options::{
    ColourMode, ConvertOptions, GridOptions, HoleWidth, PixelSize, ReadingOptions, Resources, SectionOptions,
    ShardOptions, Tolerance,
};
pub use plan_file::{PlanFile, Stated};
pub use planning::{AUTO_PIXEL_SPACINGS, AUTO_PIXELS};
pub use preview::{Preview, PreviewInput, preview};
pub use report::Report;
pub use resume::Resumed;
pub use slicewalk_base::placement::Similarity;
pub use splats::{SplatCounts, SplatRules};
pub use upright::{Turn, UpFound};
#[doc(hidden)]
pub use voxel::accumulate::{Accumulate, PointVoxel};
pub use writer::PointWriter;

use slicewalk::{archive, codec, page};
use slicewalk_base::{
    Error, Monitor, NoMonitor, Parameter, Result, Warning, bytes, colour, disk, frame, output, placement, plan, text,
    unit,
};
use slicewalk_input as input;
use slicewalk_mesh as mesh;

/// Smallest memory budget (bytes).
pub const MIN_MEMORY_BYTES: u64 = 64 << 20;
