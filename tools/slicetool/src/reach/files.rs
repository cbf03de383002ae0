//! File formats of `slicetool reach`, chosen by extension.

use super::{Reach, geojson, map};
use crate::Failure;
use crate::ground::Loader;
use slicewalk_base::output::{Output, is_standard};
use std::io::{BufWriter, Write};
use std::path::Path;

/// Destination of a file.
pub type Out = BufWriter<Output>;

type Writer = fn(&Reach, &Loader, &mut Out) -> Result<(), Failure>;

/// Returns the writer of the format that the extension of `output` selects.
pub fn writer(output: &Path) -> Result<Writer, Failure> {
    let ending = output.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    match ending.as_str() {
        "png" => Ok(map::write),
        "csv" => Ok(csv),
        "ply" => Ok(ply),
        "geojson" => Ok(geojson::write),
        _ if is_standard(output) => Ok(csv),
        _ => {
            let text = format!("{}: unknown format; name the file .png, .csv, .ply or .geojson", output.display());
            Err(Failure::Text(text))
        }
    }
}

fn csv(reach: &Reach, _: &Loader, out: &mut Out) -> Result<(), Failure> {
    writeln!(out, "x,y,z,clearance")?;
    for place in reach.region.places() {
        let feet = place.feet;
        writeln!(out, "{:.4},{:.4},{:.4},{:.3}", feet.x, feet.y, feet.z, place.clearance)?;
    }
    Ok(())
}

fn ply(reach: &Reach, _: &Loader, out: &mut Out) -> Result<(), Failure> {
    writeln!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}", reach.region.places().count())?;
    writeln!(out, "property double x\nproperty double y\nproperty double z\nproperty float clearance\nend_header")?;
    for place in reach.region.places() {
        for value in place.feet.iter() {
            out.write_all(&value.to_le_bytes())?;
        }
        out.write_all(&(place.clearance as f32).to_le_bytes())?;
    }
    Ok(())
}
