//! `slicetool extract`: writes a region as its own archive.

use crate::Outcome;
use crate::edits::EditOption;
use slicewalk::archive::{Bounds, Extracted, extract};
use slicewalk_base::text::{counted, file_size, one_line};
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `slicetool extract`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// Archive to write
    #[arg(short, long, value_name = "OUT.slices")]
    output: PathBuf,
    /// Lowest and highest corner of the region in metres; inf and -inf for no limit. With --edits: everything, unless
    /// given
    #[arg(long, allow_hyphen_values = true, value_name = "XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX", value_parser = bounds,
          required_unless_present = "edits")]
    bounds: Option<Bounds>,
    #[command(flatten)]
    edits: EditOption,
    /// Replace an existing slice archive
    #[arg(long)]
    force: bool,
    /// Print the new archive's metadata as JSON
    #[arg(long)]
    json: bool,
}

/// Bounds without a limit.
pub const EVERYTHING: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);

/// Parses the corners of a region.
pub fn bounds(text: &str) -> Result<Bounds, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x0, y0, z0, x1, y1, z1]) if x0 <= x1 && y0 <= y1 && z0 <= z1 => Ok(([x0, y0, z0], [x1, y1, z1])),
        _ => Err("expected six numbers, the least corner first".into()),
    }
}

/// Extracts the region.
pub fn run(arguments: &Arguments) -> Outcome {
    let archive = crate::open(&arguments.archive)?;
    let (archive, also_dropped) = match arguments.edits.read()? {
        Some(file) => (archive.with_edits(file.for_queries()), file.not_solid()),
        None => (archive, Vec::new()),
    };
    let bounds = arguments.bounds.unwrap_or(EVERYTHING);
    let Extracted { header, mut dropped, .. } =
        extract(&archive, &bounds, &arguments.output, arguments.force, &crate::terminal())
            .map_err(|error| crate::broken(&arguments.archive, &error))?;
    dropped.extend(also_dropped);
    if header.voxels.occupied == 0 {
        let (archive, output) = (arguments.archive.display(), arguments.output.display());
        let nothing = if arguments.bounds.is_some() { "nothing lies within --bounds" } else { "nothing is left" };
        crate::say(&format!("warning: {archive}: {nothing}; {output} is an empty archive"));
    }
    if arguments.json {
        let about = archive.crs().and_then(|crs| Ok((crs, archive.units()?)));
        let (crs, units) = about.map_err(|error| crate::broken(&arguments.archive, &error))?;
        let mut facts = slicewalk_convert::info::header_info(&header, &crs, &units);
        facts["dropped"] = dropped.into();
        return Ok(format!("{facts:#}\n"));
    }
    let (voxels, bytes) = (counted(header.voxels.occupied, "voxel"), file_size(header.file_len));
    let mut text = String::new();
    for what in dropped {
        writeln!(text, "dropped: {what}")?;
    }
    writeln!(text, "{}: {voxels}, {bytes}", one_line(&arguments.output.to_string_lossy()))?;
    Ok(text)
}
