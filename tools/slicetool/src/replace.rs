//! `slicetool replace`: puts a region of another archive, such as a rescan, in place of the old one.

use crate::Outcome;
use slicewalk::archive::{Bounds, Replaced, replace};
use slicewalk_base::text::{counted, file_size, one_line};
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `slicetool replace`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// Slice archive of the rescan, on the same grid and with the same options
    #[arg(long, value_name = "RESCAN.slices")]
    with: PathBuf,
    /// Lowest and highest corner of the region in metres; inf and -inf for no limit. The region is all pixels and slices
    /// that hold a place between them
    #[arg(long, allow_hyphen_values = true, value_name = "XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX", value_parser = crate::extract::bounds)]
    bounds: Bounds,
    /// Archive to write
    #[arg(short, long, value_name = "OUT.slices")]
    output: PathBuf,
    /// Replace an existing slice archive
    #[arg(long)]
    force: bool,
    /// Print the new archive's metadata as JSON
    #[arg(long)]
    json: bool,
}

/// Writes the archive with the new region.
pub fn run(arguments: &Arguments) -> Outcome {
    let Arguments { archive, with, bounds, output, force, json } = arguments;
    // Names what another kind of file is.
    for path in [archive, with] {
        crate::open(path)?;
    }
    let made = replace(archive, with, bounds, output, *force, &crate::terminal())?;
    let Replaced { header, crs, units, is_cleared, dropped, .. } = made;
    if is_cleared {
        crate::say(&format!("warning: {}: nothing lies within --bounds; the region is empty now", with.display()));
    }
    if *json {
        let mut facts = slicewalk_convert::info::header_info(&header, &crs, &units);
        facts["region_empty"] = is_cleared.into();
        facts["dropped"] = dropped.into();
        return Ok(format!("{facts:#}\n"));
    }
    let mut text = String::new();
    for what in dropped {
        writeln!(text, "dropped: {}", one_line(&what))?;
    }
    let (voxels, bytes) = (counted(header.voxels.occupied, "voxel"), file_size(header.file_len));
    writeln!(text, "{}: {voxels}, {bytes}", one_line(&output.to_string_lossy()))?;
    Ok(text)
}
