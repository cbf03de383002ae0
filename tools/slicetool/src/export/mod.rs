//! `slicetool export`: contents of an archive in the formats of other programs.
//!
//! - `points.rs`: one point per occupied voxel (PLY, LAS, LAZ, E57)
//! - `surface.rs`: the boundary of all occupied space as triangles (glTF)
//! - `heights.rs`: heights of floors as a raster (GeoTIFF)
//! - `drawing.rs`: the floor plan of a slice (SVG, DXF)
//! - `nav2.rs`: occupancy grids of storeys (Nav2)
//! - `octomap.rs`, `voxel.rs`: occupied cubes as octrees (OctoMap; SuperSplat, PlayCanvas, Babylon)
//!
//! All coordinates are those of the archive: metres, in the scan's reference system.

mod crs;
mod cubes;
mod drawing;
mod heights;
mod nav2;
mod octomap;
mod points;
mod surface;
mod voxel;

use crate::ground::Pawns;
use crate::{Failure, Outcome};
use crs::Crs;
use nav2::Which;
use slicewalk_base::output::is_standard;
use slicewalk_base::text::{counted, finite_number, grouped, number, one_line, whole_number};
use std::path::{Path, PathBuf};

/// Options of `slicetool export`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// File to write; its extension selects points, one per voxel (.ply, .las, .laz, .e57), a surface (.glb), floor
    /// heights (.tif), the plan of a slice (.svg, .dxf), maps of storeys for Nav2 (.yaml with .pgm), or cubes for OctoMap
    /// (.bt) or for SuperSplat and PlayCanvas (.voxel.json with .voxel.bin). `-` writes PLY to standard output
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Plan of this slice, counted from 0 at the lowest; by default, the slice 1.2 m above the floor of the lowest
    /// storey
    #[arg(long, value_name = "N", group = "which", value_parser = whole_number(0u64, u64::MAX))]
    slice: Option<u64>,
    /// Plan of the slice at this height in metres; with .tif, the highest floors up to this height; with .yaml, the
    /// storey nearest to it
    #[arg(long, value_name = "Z", group = "which", allow_hyphen_values = true, value_parser = finite_number)]
    z: Option<f64>,
    /// With .yaml, only this storey, counted from 0 at the lowest; by default, a map for each storey
    /// (NAME_storey0.yaml ...) and the links between them (NAME_links.geojson)
    #[arg(long, value_name = "N", group = "which", value_parser = whole_number(0u64, u64::MAX))]
    storey: Option<u64>,
    #[command(flatten)]
    pawns: Pawns,
}

/// Format, selected by the file's extension.
#[derive(Clone, Copy, PartialEq)]
enum Format {
    Ply,
    Las,
    Laz,
    E57,
    Glb,
    Tif,
    Svg,
    Dxf,
    Nav2,
    Octomap,
    Voxel,
}

impl Format {
    fn of(output: &Path) -> Option<Self> {
        let ending = output.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
        Some(match ending.as_str() {
            "ply" => Self::Ply,
            "las" => Self::Las,
            "laz" => Self::Laz,
            "e57" => Self::E57,
            "glb" => Self::Glb,
            "tif" | "tiff" => Self::Tif,
            "svg" => Self::Svg,
            "dxf" => Self::Dxf,
            "yaml" | "yml" => Self::Nav2,
            "bt" => Self::Octomap,
            "json" if voxel::binary_of(output).is_some() => Self::Voxel,
            _ if is_standard(output) => Self::Ply,
            _ => return None,
        })
    }
}

/// Runs the export.
pub fn run(arguments: &Arguments) -> Outcome {
    let (path, output) = (arguments.archive.as_path(), arguments.output.as_path());
    let Some(format) = Format::of(output) else {
        let endings = ".ply, .las, .laz, .e57, .glb, .tif, .svg, .dxf, .yaml, .bt or .voxel.json";
        return Err(Failure::Text(format!("{}: unknown format; name the file {endings}", output.display())));
    };
    let is_plan = matches!(format, Format::Svg | Format::Dxf);
    if arguments.slice.is_some() && !is_plan {
        return Err(Failure::Usage("--slice: only .svg and .dxf show one slice".into()));
    }
    if arguments.z.is_some() && !is_plan && !matches!(format, Format::Tif | Format::Nav2) {
        return Err(Failure::Usage("--z: only .tif, .svg, .dxf and .yaml depend on a height".into()));
    }
    if arguments.storey.is_some() && format != Format::Nav2 {
        return Err(Failure::Usage("--storey: only .yaml shows one storey".into()));
    }
    if arguments.pawns.edits().path().is_some() && format != Format::Nav2 {
        return Err(Failure::Usage("--edits: only .yaml is made with edits; leave it out".into()));
    }
    if format == Format::Nav2 {
        let number = arguments.storey.map(|storey| Which::Number(usize::try_from(storey).unwrap_or(usize::MAX)));
        let which = number.or(arguments.z.map(Which::Near)).unwrap_or(Which::All);
        return nav2::write(output, path, &arguments.pawns, which);
    }
    let archive = crate::open(path)?;
    points::check_count(&archive, path)?;
    let crs = match format {
        Format::Ply | Format::Glb | Format::Nav2 | Format::Octomap | Format::Voxel => None,
        _ => Crs::of(&archive, path)?,
    };
    let crs = crs.as_ref();
    let to = crate::output(output, &archive, &[])?;
    let about = match format {
        Format::Ply => counted(points::ply(&archive, path, to)?, "point"),
        Format::Las => counted(points::las(&archive, path, to, crs, false)?, "point"),
        Format::Laz => counted(points::las(&archive, path, to, crs, true)?, "point"),
        Format::E57 => counted(points::e57(&archive, path, to, crs)?, "point"),
        Format::Glb => counted(surface::glb(&archive, path, to)?, "triangle"),
        Format::Tif => {
            let [width, height] = heights::tif(&archive, path, arguments.z, to, crs)?;
            let pixel = number(archive.frame().pixel_m());
            format!("{} × {} pixels of {pixel} m", grouped(width.into()), grouped(height.into()))
        }
        Format::Voxel => {
            let binary = voxel::binary_of(output).unwrap_or_default();
            voxel::write(&archive, path, [to, crate::output(&binary, &archive, &[output])?])?
        }
        Format::Octomap => octomap::bt(&archive, path, to)?,
        Format::Nav2 => unreachable!("written above"),
        Format::Svg | Format::Dxf => {
            let slice = drawing::slice(&archive, path, arguments.slice, arguments.z)?;
            let plan = drawing::Plan::of(&archive, path, slice)?;
            match format {
                Format::Svg => plan.svg(crs, to)?,
                _ => plan.dxf(to)?,
            }
        }
    };
    crate::standard::written(output, &format!("{}: {about}\n", one_line(&output.to_string_lossy())))
}
