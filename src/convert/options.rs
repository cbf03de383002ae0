//! What to convert, and how.

use super::job::Job;
use crate::input::Units;
use crate::mesh::MeshMode;
use crate::plan::{Classifier, Up};
use std::path::PathBuf;

/// How the pixel size is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PixelSize {
    /// From the scans' own point spacing, or the extent of the meshes where there is no scan (costs one more pass over
    /// the input).
    Auto,
    /// This many metres.
    Metres(f64),
}

/// What to convert, and how. See the README for the command line that sets these.
#[derive(Debug, Clone)]
pub struct ConvertOptions {
    /// Files, folders and glob patterns.
    pub inputs: Vec<PathBuf>,
    /// The archive to write.
    pub output: PathBuf,
    /// Pixel size `t`.
    pub pixel: PixelSize,
    /// Slice height `σ` (m); three pixel sizes by default (thesis, section 3.1.3).
    pub slice_m: Option<f64>,
    /// Steepest slope that can be stood on (degrees).
    pub max_slope_deg: f64,
    /// How far heights may be coarsened, outwards (m).
    pub tolerance_m: f64,
    /// How floors and obstacles are told apart.
    pub classifier: Classifier,
    /// Memory budget [bytes, at least 64 MiB].
    pub memory_bytes: u64,
    /// Worker threads [>= 1].
    pub threads: usize,
    /// Folder for temporary data.
    pub temp_dir: PathBuf,
    /// LAS classes left out, as in [`Plan::exclude_classes`].
    pub exclude_classes: [u64; 4],
    /// Voxels with fewer points are dropped.
    pub min_points: u32,
    /// Whether voxels without matter in any of the 26 voxels around them are dropped.
    pub drop_isolated: bool,
    /// Up axis of the input.
    pub up: Up,
    /// Unit of the input.
    pub units: Units,
    /// How meshes become voxels.
    pub mesh: MeshMode,
    /// Whether an existing archive may be replaced.
    pub overwrite: bool,
    /// The part to convert; `None` for the whole.
    pub shard: Option<ShardOptions>,
}

impl ConvertOptions {
    /// Defaults of the command line for these inputs and this output.
    pub fn new(inputs: Vec<PathBuf>, output: PathBuf) -> Self {
        Self {
            inputs,
            output,
            pixel: PixelSize::Auto,
            slice_m: None,
            max_slope_deg: 45.0,
            tolerance_m: 0.0,
            classifier: Classifier::Plane,
            memory_bytes: 512 << 20,
            threads: std::thread::available_parallelism().map_or(1, |n| n.get()),
            temp_dir: std::env::temp_dir(),
            exclude_classes: [0; 4],
            min_points: 1,
            drop_isolated: false,
            up: Up::Z,
            units: Units::Auto,
            mesh: MeshMode::Exact,
            overwrite: false,
            shard: None,
        }
    }
}

/// What to convert of a scan, if not all.
#[derive(Debug, Clone)]
pub struct ShardOptions {
    /// Number of the part [1..=count].
    pub index: u32,
    /// Number of all parts [1..=65536].
    pub count: u32,
    /// The job as a plan fixed it; made anew from the inputs if `None`, the same in every part.
    pub job: Option<Job>,
}
