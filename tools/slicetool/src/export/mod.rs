//! `slicetool export`: contents of an archive in the formats of other programs.
//!
//! - `points.rs`: one point per occupied voxel (PLY, LAS, LAZ, E57)
//! - `surface.rs`: the boundary of all occupied space as triangles (glTF)
//! - `collider/`: a simplified surface that contains all occupied space (glTF, OBJ)
//! - `heights.rs`: heights of floors as a raster (GeoTIFF)
//! - `heightfield.rs`: heights of floors as tiles for the terrain of engines
//! - `drawing.rs`: the floor plan of a slice (SVG, DXF)
//! - `nav2.rs`: occupancy grids of storeys (Nav2)
//! - `octomap.rs`, `voxel.rs`: occupied cubes as octrees (OctoMap; SuperSplat, PlayCanvas, Babylon)
//!
//! All coordinates are those of the archive: metres, in the scan's reference system.

mod collider;
mod crs;
mod cubes;
mod drawing;
mod gltf;
mod heightfield;
mod heights;
mod nav2;
mod octomap;
mod points;
mod surface;
mod voxel;

use crate::ground::Pawns;
use crate::{Failure, Outcome};
use clap::ArgMatches;
use clap::parser::ValueSource;
use collider::{Bound, Collider};
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
    /// File to write; its extension selects points, one per voxel (.ply, .las, .laz, .e57), a surface (.glb, and .obj with
    /// --error or --triangles), floor heights (.tif), the plan of a slice (.svg, .dxf), maps of storeys for Nav2 (.yaml with
    /// .pgm), floors of storeys for the terrain of engines (.heightfield.json with .png), or cubes for OctoMap (.bt) or for SuperSplat and PlayCanvas (.voxel.json with .voxel.bin). `-` writes PLY to
    /// standard output
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Plan of this slice, counted from 0 at the lowest; by default, the slice 1.2 m above the floor of the lowest
    /// storey
    #[arg(long, value_name = "N", group = "which", value_parser = whole_number(0u64, u64::MAX))]
    slice: Option<u64>,
    /// Plan of the slice at this height in metres; with .tif, the highest floors up to this height; with .yaml or
    /// .heightfield.json, the storey nearest to it
    #[arg(long, value_name = "Z", group = "which", allow_hyphen_values = true, value_parser = finite_number)]
    z: Option<f64>,
    /// With .yaml or .heightfield.json, only this storey, counted from 0 at the lowest; by default, a map for each storey
    /// (NAME_storey0.yaml ...) and the links between them (NAME_links.geojson)
    #[arg(long, value_name = "N", group = "which", value_parser = whole_number(0u64, u64::MAX))]
    storey: Option<u64>,
    /// With .glb or .obj, a collider: a simplified surface that contains all solid and lies at most this far beyond it (m)
    #[arg(long, value_name = "METRES", group = "bound", allow_negative_numbers = true, value_parser = error_m)]
    error: Option<f64>,
    /// With .glb or .obj, the collider of the least error that has at most this many triangles
    #[arg(long, value_name = "N", group = "bound", value_parser = whole_number(1u64, u64::MAX))]
    triangles: Option<u64>,
    #[command(flatten)]
    pawns: Pawns,
}

fn error_m(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| (1e-6..=1e6).contains(v));
    value.ok_or_else(|| "expected 0.000001 to 1000000 m".into())
}

/// Format, selected by the file's extension.
#[derive(Clone, Copy, PartialEq)]
enum Format {
    Ply,
    Las,
    Laz,
    E57,
    Glb,
    Obj,
    Tif,
    Svg,
    Dxf,
    Nav2,
    Heightfield,
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
            "obj" => Self::Obj,
            "tif" | "tiff" => Self::Tif,
            "svg" => Self::Svg,
            "dxf" => Self::Dxf,
            "yaml" | "yml" => Self::Nav2,
            "bt" => Self::Octomap,
            "json" if heightfield::is_name(output) => Self::Heightfield,
            "json" if voxel::binary_of(output).is_some() => Self::Voxel,
            _ if is_standard(output) => Self::Ply,
            _ => return None,
        })
    }
}

/// Returns the formats that an option is for, and their endings.
fn formats_of(option: &str) -> (&'static [Format], &'static str) {
    match option {
        "slice" => (&[Format::Svg, Format::Dxf], ".svg and .dxf"),
        "z" => (
            &[Format::Tif, Format::Svg, Format::Dxf, Format::Nav2, Format::Heightfield],
            ".tif, .svg, .dxf, .yaml and .heightfield.json",
        ),
        "error" | "triangles" => (&[Format::Glb, Format::Obj], ".glb and .obj"),
        // The storey, and all options of the pawn.
        _ => (&[Format::Nav2, Format::Heightfield], ".yaml and .heightfield.json"),
    }
}

/// Refuses options that are not for `format`.
fn refuse_others(format: Format, given: &ArgMatches) -> Result<(), Failure> {
    let command = <Arguments as clap::Args>::augment_args(clap::Command::new("export"));
    for option in command.get_arguments().filter(|option| option.get_id() != "output") {
        let Some(name) = option.get_long() else { continue };
        let (formats, endings) = formats_of(name);
        let is_given = given.value_source(option.get_id().as_str()) == Some(ValueSource::CommandLine);
        if is_given && !formats.contains(&format) {
            return Err(Failure::Usage(format!("--{name}: this option is only for {endings}")));
        }
    }
    Ok(())
}

/// Runs the export. `given` separates options of the command line from defaults.
pub fn run(arguments: &Arguments, given: &ArgMatches) -> Outcome {
    let (path, output) = (arguments.archive.as_path(), arguments.output.as_path());
    let Some(format) = Format::of(output) else {
        let endings =
            ".ply, .las, .laz, .e57, .glb, .obj, .tif, .svg, .dxf, .yaml, .heightfield.json, .bt or .voxel.json";
        return Err(Failure::Text(format!("{}: unknown format; name the file {endings}", output.display())));
    };
    refuse_others(format, given)?;
    let bound = arguments.error.map(Bound::Error).or(arguments.triangles.map(Bound::Triangles));
    if format == Format::Obj && bound.is_none() {
        return Err(Failure::Usage("--error or --triangles: .obj needs one of them".into()));
    }
    if matches!(format, Format::Nav2 | Format::Heightfield) {
        let number = arguments.storey.map(|storey| Which::Number(usize::try_from(storey).unwrap_or(usize::MAX)));
        let which = number.or(arguments.z.map(Which::Near)).unwrap_or(Which::All);
        return match format {
            Format::Nav2 => nav2::write(output, path, &arguments.pawns, which),
            _ => heightfield::write(output, path, &arguments.pawns, which),
        };
    }
    let archive = crate::open(path)?;
    points::check_count(&archive, path)?;
    let crs = match format {
        Format::Ply
        | Format::Glb
        | Format::Obj
        | Format::Nav2
        | Format::Heightfield
        | Format::Octomap
        | Format::Voxel => None,
        _ => Crs::of(&archive, path)?,
    };
    let crs = crs.as_ref();
    let to = crate::output(output, &archive, &[])?;
    if let Some(bound) = bound {
        let collider = Collider::new(&archive, path, bound)?;
        match format {
            Format::Obj => collider::obj(&collider, to)?,
            _ => collider::glb(&collider, to)?,
        }
        let about = collider.about();
        return crate::standard::written(output, &format!("{}: {about}\n", one_line(&output.to_string_lossy())));
    }
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
        Format::Nav2 | Format::Heightfield | Format::Obj => unreachable!("written above"),
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
