//! Converts scans or meshes to an archive, with progress on standard error: `convert INPUT... OUT.slices`.

use slicewalk::{Monitor, Warning};
use slicewalk_convert::{ConvertOptions, convert};
use std::path::PathBuf;

/// Prints stages and warnings.
struct Progress;

impl Monitor for Progress {
    fn stage(&self, name: &str, total: u64, unit: &str) {
        eprintln!("{name} ({total} {unit})");
    }

    fn warn(&self, warning: &Warning) {
        eprintln!("warning: {warning}");
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let output = paths.pop().filter(|_| !paths.is_empty()).ok_or("usage: convert INPUT... OUT.slices")?;
    let mut options = ConvertOptions::new(paths, output);
    options.resources.memory_bytes = 256 << 20;
    let report = convert(&options, &Progress)?;
    let header = &report.header;
    println!(
        "{} points, {} voxels of {} m, {} bytes",
        header.points_kept,
        header.voxels.occupied,
        header.plan.frame.pixel_m(),
        header.file_len
    );
    Ok(())
}
