//! `slicetool export`: contents of an archive in the formats of other programs.
//!
//! - `points.rs`: one point per occupied voxel (PLY, LAS, LAZ, E57)
//! - `surface.rs`: the boundary of all occupied space as triangles (glTF)
//! - `collider/`: a simplified surface that contains all occupied space (glTF, OBJ)
//! - `heights.rs`, `layers.rs`: figures of floors as a raster (GeoTIFF)
//! - `heightfield.rs`: heights of floors as tiles for the terrain of engines
//! - `drawing.rs`: the floor plan of a slice (SVG, DXF)
//! - `nav2.rs`: occupancy grids of storeys (Nav2)
//! - `esdf.rs`: signed distances to solid (numpy)
//! - `octomap.rs`, `voxel.rs`: occupied cubes as octrees (OctoMap; SuperSplat, PlayCanvas, Babylon)
//!
//! All coordinates are those of the archive: metres, in the scan's reference system.

mod collider;
mod crs;
mod cubes;
mod drawing;
mod esdf;
mod gltf;
mod heightfield;
mod heights;
mod layers;
mod nav2;
mod octomap;
mod points;
mod surface;
mod voxel;

pub use points::{Ply, check_count};

use crate::ground::Loader;
use crate::ground::Pawns;
use crate::{Failure, Outcome};
use clap::ArgMatches;
use clap::parser::ValueSource;
use collider::{Bound, Collider};
use crs::Crs;
use layers::{Figures, Layer};
use nav2::Which;
use slicewalk::archive::Bounds;
use slicewalk_base::output::is_standard;
use slicewalk_base::text::{counted, finite_number, grouped, number, one_line, whole_number};
use slicewalk_cube::binary_of;
use std::path::{Path, PathBuf};

/// Greatest distance of an ESDF by default (m).
const WITHIN_M: f64 = 2.0;

/// Options of `slicetool export`.
#[derive(clap::Args)]
// Only `reach` and `route` take it, which the refusal says.
#[command(mut_arg("seen", |seen| seen.hide(true)))]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// File to write; its extension selects points, one per voxel (.ply, .las, .laz, .e57), a surface (.glb, and .obj with
    /// --error or --triangles), floor heights and other layers (.tif), the plan of a slice (.svg, .dxf), maps of storeys
    /// for Nav2 (.yaml with .pgm), floors of storeys for the terrain of engines (.heightfield.json with .png), distances
    /// to solid (.npy), or cubes for OctoMap (.bt) or for SuperSplat and PlayCanvas (.voxel.json with .voxel.bin). `-`
    /// writes PLY to standard output
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
    /// With .tif, the layers to write, a band each
    #[arg(long, value_enum, value_name = "NAME", value_delimiter = ',', default_values_t = [Layer::Height])]
    layer: Vec<Layer>,
    /// With .npy: signed distances to the surface of solid as float32 in metres, positive in free space, with the axes z,
    /// y, x; sample k along an axis, counted from the origin, lies at (k + 1/2) times the step
    #[arg(long)]
    esdf: bool,
    /// With --esdf, lowest and highest corner of the region in metres [default: all of the archive, and what --edits adds]
    #[arg(long, allow_hyphen_values = true, value_name = "XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX", value_parser = crate::extract::bounds)]
    bounds: Option<Bounds>,
    /// With --esdf, metres between samples [default: a pixel]
    #[arg(long, value_name = "METRES", value_parser = length)]
    step: Option<f64>,
    /// With --esdf, greatest distance in metres; what is farther has this distance
    #[arg(long, value_name = "METRES", default_value_t = WITHIN_M, value_parser = length)]
    within: f64,
    #[command(flatten)]
    pawns: Pawns,
}

fn error_m(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| (1e-6..=1e6).contains(v));
    value.ok_or_else(|| "expected 0.000001 to 1000000 m".into())
}

fn length(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| *v > 0.0 && v.is_finite());
    value.ok_or_else(|| "expected a length above 0".into())
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
    Npy,
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
            "npy" => Self::Npy,
            "bt" => Self::Octomap,
            "json" if heightfield::is_name(output) => Self::Heightfield,
            "json" if binary_of(output).is_some() => Self::Voxel,
            _ if is_standard(output) => Self::Ply,
            _ => return None,
        })
    }
}

/// Returns the formats that an option is for, and their endings. `has_layers` if the raster has other layers than heights.
fn formats_of(option: &str, has_layers: bool) -> (&'static [Format], &'static str) {
    match option {
        "slice" => (&[Format::Svg, Format::Dxf], ".svg and .dxf"),
        "z" => (
            &[Format::Tif, Format::Svg, Format::Dxf, Format::Nav2, Format::Heightfield],
            ".tif, .svg, .dxf, .yaml and .heightfield.json",
        ),
        "error" | "triangles" => (&[Format::Glb, Format::Obj], ".glb and .obj"),
        "layer" => (&[Format::Tif], ".tif"),
        "esdf" | "bounds" | "step" | "within" => (&[Format::Npy], ".npy"),
        "edits" => {
            (&[Format::Nav2, Format::Npy], ".yaml and .npy; for others, `slicetool extract --edits` makes a copy")
        }
        "seen" => (&[], "`reach` and `route`"),
        "max-grade" | "max-ramp" | "max-drop" => (&[Format::Nav2, Format::Heightfield], ".yaml and .heightfield.json"),
        "ignore-inferred" => {
            (&[Format::Nav2, Format::Heightfield, Format::Npy, Format::Tif], ".yaml, .heightfield.json, .npy and .tif")
        }
        "cache" if has_layers => {
            (&[Format::Nav2, Format::Heightfield, Format::Npy, Format::Tif], "maps, heightfields, layers and distances")
        }
        "cache" => {
            (&[Format::Nav2, Format::Heightfield, Format::Npy], ".yaml, .heightfield.json, .npy and layers of .tif")
        }
        "storey" => (&[Format::Nav2, Format::Heightfield], ".yaml and .heightfield.json"),
        // All options of the pawn.
        _ if has_layers => (&[Format::Nav2, Format::Heightfield, Format::Tif], "maps, heightfields and layers"),
        _ => (&[Format::Nav2, Format::Heightfield], ".yaml, .heightfield.json and layers of .tif"),
    }
}

/// Refuses options that are not for `format`.
fn refuse_others(format: Format, has_layers: bool, given: &ArgMatches) -> Result<(), Failure> {
    let command = <Arguments as clap::Args>::augment_args(clap::Command::new("export"));
    for option in command.get_arguments().filter(|option| option.get_id() != "output") {
        let Some(name) = option.get_long() else { continue };
        let (formats, endings) = formats_of(name, has_layers);
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
        let endings = ".ply, .las, .laz, .e57, .glb, .obj, .tif, .svg, .dxf, .yaml, .heightfield.json, .npy, .bt or \
                       .voxel.json";
        return Err(Failure::Text(format!("{}: unknown format; name the file {endings}", output.display())));
    };
    refuse_others(format, arguments.layer != [Layer::Height], given)?;
    let bound = arguments.error.map(Bound::Error).or(arguments.triangles.map(Bound::Triangles));
    if format == Format::Obj && bound.is_none() {
        return Err(Failure::Usage("--error or --triangles: .obj needs one of them".into()));
    }
    if let Some(twice) = (1..arguments.layer.len()).find(|&n| arguments.layer[..n].contains(&arguments.layer[n])) {
        return Err(Failure::Usage(format!("--layer: {} is named twice", arguments.layer[twice].name())));
    }
    if arguments.esdf != (format == Format::Npy) {
        return Err(Failure::Usage("--esdf: name a file .npy for it, and no other; .npy holds nothing else".into()));
    }
    if arguments.esdf {
        let loader = Loader::new(arguments.pawns.open(path)?, path, arguments.pawns.cache())?;
        let samples = esdf::Samples { bounds: arguments.bounds, step_m: arguments.step, within_m: arguments.within };
        let edits = arguments.pawns.edits().path();
        let about = esdf::npy(&loader, &samples, crate::output(output, loader.archive(), edits.as_slice())?)?;
        return crate::standard::written(output, &format!("{}: {about}\n", one_line(&output.to_string_lossy())));
    }
    if matches!(format, Format::Nav2 | Format::Heightfield) {
        let number = arguments.storey.map(|storey| Which::Number(usize::try_from(storey).unwrap_or(usize::MAX)));
        let which = number.or(arguments.z.map(Which::Near)).unwrap_or(Which::All);
        return match format {
            Format::Nav2 => nav2::write(output, path, &arguments.pawns, which),
            _ => heightfield::write(output, path, &arguments.pawns, which),
        };
    }
    // Other formats refuse the options that change what an archive holds.
    let archive = if format == Format::Tif { arguments.pawns.open(path)? } else { crate::open(path)? };
    points::check_count(&archive, path)?;
    let crs = match format {
        Format::Ply
        | Format::Glb
        | Format::Obj
        | Format::Nav2
        | Format::Heightfield
        | Format::Npy
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
            let figures = Figures::new(&arguments.layer, &arguments.pawns, path, *archive.frame())?;
            let layers = heights::Layers { layers: &arguments.layer, figures, highest: arguments.z };
            let [width, height] = heights::tif(&archive, path, &layers, to, crs)?;
            let pixel = number(archive.frame().pixel_m());
            format!("{} × {} pixels of {pixel} m", grouped(width.into()), grouped(height.into()))
        }
        Format::Voxel => {
            let binary = binary_of(output).unwrap_or_default();
            voxel::write(&archive, path, [to, crate::output(&binary, &archive, &[output])?])?
        }
        Format::Octomap => octomap::bt(&archive, path, to)?,
        Format::Nav2 | Format::Heightfield | Format::Npy | Format::Obj => unreachable!("written above"),
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
