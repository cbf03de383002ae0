//! `slicetool extract`: a region as an archive of its own.

use crate::Outcome;
use slicewalk::NoMonitor;
use slicewalk::archive::{Bounds, extract};
use std::path::PathBuf;

/// What to cut out.
#[derive(clap::Args)]
pub struct Arguments {
    archive: PathBuf,
    /// Archive to write
    #[arg(short, long, value_name = "OUT.slices")]
    output: PathBuf,
    /// Least and greatest corner of the region in metres; inf and -inf for no limit
    #[arg(long, allow_hyphen_values = true, value_name = "XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX", value_parser = bounds)]
    bounds: Bounds,
    /// Replace an existing slice archive
    #[arg(long)]
    force: bool,
    /// Print what the new archive says of itself as JSON
    #[arg(long)]
    json: bool,
}

fn bounds(text: &str) -> Result<Bounds, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x0, y0, z0, x1, y1, z1]) if x0 <= x1 && y0 <= y1 && z0 <= z1 => Ok(([x0, y0, z0], [x1, y1, z1])),
        _ => Err("expected six numbers, the least corner first".into()),
    }
}

/// Cuts the region out.
pub fn run(arguments: &Arguments) -> Outcome {
    let archive = crate::open(&arguments.archive)?;
    let header = extract(&archive, &arguments.bounds, &arguments.output, arguments.force, &NoMonitor)
        .map_err(|error| crate::broken(&arguments.archive, &error))?;
    if arguments.json {
        let about = archive.crs().and_then(|crs| Ok((crs, archive.units()?)));
        let (crs, units) = about.map_err(|error| crate::broken(&arguments.archive, &error))?;
        return Ok(format!("{:#}\n", slicewalk::info::header_info(&header, &crs, &units)));
    }
    let (voxels, bytes) = (header.voxels.occupied, header.file_len);
    Ok(format!("{}: {voxels} voxels, {bytes} bytes\n", arguments.output.display()))
}
