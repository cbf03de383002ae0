//! `scangen`: writes a seeded scan of a scene and its truth.

use clap::{Parser, ValueEnum};
use scangen::geometry::Placement;
use scangen::sample::{Amount, Mode, Order, ScannerSpec, shuffle};
use scangen::write::{
    Chunks, CloudFormat, SplatLook, Texture, WriteSpec, Written, write_clouds, write_samples, write_splats,
    write_triangles_obj, write_truth_json,
};
use scangen::{Params, Result, SCENES, SampleSpec, Scene};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Farthest place, and largest angle: beyond, 64-bit numbers lose the surfaces.
const MOST: f64 = 1e9;

/// Writes a seeded scan of a scene with closed-form truth as LAS, LAZ, E57, PTX, PTS or XYZ, or as Gaussian splats
/// (3DGS PLY).
///
/// `scangen list` lists the scenes and their parameters; `scangen demo -o demo.laz` writes the demonstration house.
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// Scene, `demo`, or `list`
    scene: String,
    /// Output; the extension selects .las, .laz, .e57, .ptx, .pts, .xyz or, for splats, .ply
    #[arg(short, long, required_unless_present = "truth", required_unless_present = "obj")]
    output: Option<PathBuf>,
    /// Seed; the same seed gives the same bytes
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Total number of points (scanner: rays)
    #[arg(long, conflicts_with = "density")]
    points: Option<u64>,
    /// Points per square metre (scanner: at one metre) [default: 100]
    #[arg(long)]
    density: Option<f64>,
    /// Standard deviation of the noise, which never exceeds 6 times this value (m)
    #[arg(long, default_value_t = 0.0)]
    noise: f64,
    /// Adds X,Y,Z to the scene and makes it the file's offset
    #[arg(long, value_parser = triple, allow_hyphen_values = true)]
    origin: Option<Triple>,
    /// Rotates the scene about the vertical before shifting it [degrees]
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true, value_parser = moderate)]
    rotate: f64,
    /// Shifts the scene by X,Y,Z
    #[arg(long, value_parser = triple, allow_hyphen_values = true)]
    translate: Option<Triple>,
    /// Sampling method
    #[arg(long, value_enum, default_value_t = ModeArg::Direct)]
    mode: ModeArg,
    /// Order of directly drawn points
    #[arg(long, value_enum, default_value_t = OrderArg::Random)]
    order: OrderArg,
    /// Scanner: a station at X,Y,Z; may be repeated [default: the scene's]
    #[arg(long, value_parser = triple, allow_hyphen_values = true)]
    station: Vec<Triple>,
    /// Scanner: range (m)
    #[arg(long, default_value_t = 120.0)]
    range: f64,
    /// Scanner: fraction of edges that give a mixed pixel
    #[arg(long, default_value_t = 0.2)]
    mixed: f64,
    /// Scanner: number of people walking around each station
    #[arg(long, default_value_t = 0)]
    people: usize,
    /// Scanner: distance that people keep from walls; 0: they walk through walls (m)
    #[arg(long, default_value_t = 0.0)]
    clearance: f64,
    /// Class of points on people, as truth for their removal [default: that of all points]
    #[arg(long, value_name = "CLASS")]
    moving_class: Option<u8>,
    /// Outliers per point, 0 to 1
    #[arg(long, default_value_t = 0.0)]
    outliers: f64,
    /// Largest distance of an outlier from its point (m)
    #[arg(long, default_value_t = 20.0)]
    outlier_distance: f64,
    /// Exact repetitions per point, 0 to 1
    #[arg(long, default_value_t = 0.0)]
    duplicates: f64,
    /// Leaves out points within RADIUS of X,Y; may be repeated
    #[arg(long, value_name = "X,Y,RADIUS", value_parser = triple, allow_hyphen_values = true)]
    hole: Vec<Triple>,
    /// Shuffles the points (through temporary files next to the output)
    #[arg(long)]
    shuffle: bool,
    /// Parameter of the scene; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    param: Vec<String>,
    /// Writes the truth as JSON
    #[arg(long)]
    truth: Option<PathBuf>,
    /// Writes the scene as a mesh
    #[arg(long)]
    obj: Option<PathBuf>,
    /// Longest step on curved surfaces of the mesh (m)
    #[arg(long, default_value_t = 0.25)]
    obj_step: f64,
    /// LAS point data record format, 0 to 10
    #[arg(long, default_value_t = 0)]
    format: u8,
    /// Colours points by a formula that repeats after this distance (m); needs a format with RGB, such as 7
    #[arg(long, value_name = "PERIOD")]
    colour: Option<f64>,
    /// Writes 8-bit colour values in the 16 bits of a record
    #[arg(long, requires = "colour")]
    eight_bits: bool,
    /// Scanner: how much darker some stations record colours than others, 0 to 1
    #[arg(long, requires = "colour", default_value_t = 0.0)]
    exposure: f64,
    /// Coordinate step (m)
    #[arg(long, default_value_t = 0.001)]
    scale: f64,
    /// E57, PTX, PTS: number of points after which a new cloud begins
    #[arg(long, default_value_t = u64::MAX, hide_default_value = true, value_parser = clap::value_parser!(u64).range(1..))]
    cloud: u64,
    /// Points per LAZ chunk
    #[arg(long, default_value_t = 50_000)]
    chunk: u32,
    /// LAZ chunks of 1 to --chunk points instead of equal ones
    #[arg(long)]
    variable_chunks: bool,
    /// File with the coordinate system as WKT
    #[arg(long)]
    crs_wkt: Option<PathBuf>,
    /// Class and weight of surface points; may be repeated
    #[arg(long, value_name = "CLASS=WEIGHT", value_parser = class_weight)]
    class: Vec<(u8, f64)>,
    /// Splats: floaters per splat, 0 to 1
    #[arg(long, default_value_t = 0.0)]
    floaters: f64,
    /// Fraction of points flagged as withheld
    #[arg(long, default_value_t = 0.0)]
    withheld: f64,
}

type Triple = [f64; 3];

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ModeArg {
    Direct,
    Scanner,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum OrderArg {
    Random,
    Surfaces,
    Grid,
}

/// Parses a number of moderate size.
fn moderate(text: &str) -> std::result::Result<f64, String> {
    let value = text.trim().parse().ok().filter(|value: &f64| value.abs() <= MOST);
    value.ok_or_else(|| format!("expected a number from -{MOST} to {MOST}"))
}

fn triple(text: &str) -> std::result::Result<Triple, String> {
    let numbers: std::result::Result<Vec<f64>, _> = text.split(',').map(moderate).collect();
    numbers?.try_into().map_err(|_| "expected three numbers with commas between them".to_owned())
}

fn class_weight(text: &str) -> std::result::Result<(u8, f64), String> {
    let (class, weight) = text.split_once('=').ok_or("expected CLASS=WEIGHT")?;
    Ok((class.parse().map_err(|_| "a class is 0 to 255")?, weight.parse().map_err(|_| "a weight is a number")?))
}

fn main() -> ExitCode {
    // Clap exits with 2 on wrong usage and with 0 after help.
    if std::env::args().nth(1).is_some_and(|a| a == "list") && std::env::args().len() == 2 {
        print!("{}", list());
        return ExitCode::SUCCESS;
    }
    let args = Args::parse();
    match run(&args) {
        Ok(summary) => {
            eprint!("{summary}");
            ExitCode::SUCCESS
        }
        Err(error @ scangen::Error::Parameter { .. }) => fail(&error, 2),
        Err(error) => fail(&error, 1),
    }
}

fn fail(error: &scangen::Error, code: u8) -> ExitCode {
    eprintln!("scangen: {error}");
    ExitCode::from(code)
}

fn list() -> String {
    let mut text = String::new();
    for scene in SCENES {
        text += &format!("{:<10}{}\n", scene.name, scene.about);
        for p in scene.params {
            text += &format!("{:<10}  --param {}={}  {} ({} to {})\n", "", p.name, p.default, p.about, p.min, p.max);
        }
    }
    text + "demo      the house, scanned from nine stations, for the project's demonstration\n"
}

fn run(args: &Args) -> Result<String> {
    let mut params = Params::new();
    args.param.iter().try_for_each(|p| params.parse(p))?;
    let demo = args.scene == "demo";
    let origin = args.origin.unwrap_or_default();
    let shift = args.translate.unwrap_or_default();
    let translate = [0, 1, 2].map(|a| shift[a] + origin[a]);
    let scene = Scene::named(if demo { "house" } else { &args.scene }, &params)?;
    let scene = scene.placed(&Placement { rotate_deg: args.rotate, translate });
    let mut summary = String::new();
    if let Some(path) = &args.output {
        let written = write_points(args, &scene, demo, origin, path)?;
        summary += &format!("{}: {} points, {} bytes\n", path.display(), written.points, written.len_bytes);
    }
    if let Some(path) = &args.truth {
        write_truth_json(path, &scene)?;
        summary += &format!("{}: {} surfaces\n", path.display(), scene.surfaces().len());
    }
    if let Some(path) = &args.obj {
        summary += &format!("{}: {} triangles\n", path.display(), write_triangles_obj(path, &scene, args.obj_step)?);
    }
    Ok(summary)
}

fn write_points(args: &Args, scene: &Scene, demo: bool, origin: Triple, path: &Path) -> Result<Written> {
    let amount = args.points.map_or(Amount::Density(args.density.unwrap_or(100.0)), Amount::Count);
    let mode = match args.mode {
        ModeArg::Scanner => Mode::Scanner(ScannerSpec {
            stations: args.station.clone(),
            range_m: args.range,
            mixed_rate: args.mixed,
            people: args.people,
            clearance_m: args.clearance,
        }),
        ModeArg::Direct => Mode::Direct(match args.order {
            OrderArg::Random => Order::Random,
            OrderArg::Surfaces => Order::Surfaces,
            OrderArg::Grid => Order::Grid,
        }),
    };
    let sampling = SampleSpec {
        mode,
        amount,
        noise_m: args.noise,
        outlier_rate: args.outliers,
        outlier_distance_m: args.outlier_distance,
        duplicate_rate: args.duplicates,
        holes: args.hole.clone(),
    };
    let mut writing = WriteSpec::for_path(path);
    let chunks = if args.variable_chunks { Chunks::Variable } else { Chunks::Fixed };
    writing.compression = writing.compression.map(|_| chunks(args.chunk));
    let crs = args
        .crs_wkt
        .as_ref()
        .map(|p| std::fs::read_to_string(p).map(|t| t.trim().to_owned()).map_err(|e| scangen::Error::io(p, "read", e)));
    let writing = WriteSpec {
        format: args.format,
        scale: [args.scale; 3],
        offset: origin,
        crs_wkt: crs.transpose()?,
        classes: args.class.clone(),
        moving_class: args.moving_class,
        withheld_share: args.withheld,
        texture: args.colour.map(|period_m| Texture { period_m, eight_bits: args.eight_bits, exposure: args.exposure }),
        seed: args.seed,
        ..writing
    };
    let samples: Box<dyn Iterator<Item = scangen::Sample>> = if demo {
        Box::new(scangen::demo::demo_samples(scene, args.seed)?)
    } else {
        Box::new(scene.samples(args.seed, &sampling)?)
    };
    let is_ply = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("ply"));
    let look = SplatLook { seed: args.seed, floater_rate: args.floaters, ..SplatLook::for_scene(scene, amount) };
    let write = |samples: &mut dyn Iterator<Item = scangen::Sample>| match CloudFormat::of(path) {
        None if is_ply => write_splats(path, scene, samples, &look),
        Some(format) => write_clouds(path, format, samples, &writing, args.cloud),
        None => write_samples(path, samples, &writing),
    };
    let mut samples = samples;
    if !args.shuffle {
        return write(&mut samples);
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    let mut failed = None;
    let shuffled = shuffle(samples, args.seed, folder)?;
    let mut good = shuffled.map_while(|s| s.map_err(|e| failed = Some(e)).ok());
    let written = write(&mut good)?;
    failed.map_or(Ok(written), Err)
}
