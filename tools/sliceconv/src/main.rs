//! Command-line program that converts scans and meshes into one slice archive: arguments, one library call, output,
//! exit code.

mod report;

use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, ValueEnum};
use slicewalk::bytes::interruptible;
use slicewalk::plan::Classifier;
use slicewalk::{Error, Monitor, Parameter};
use slicewalk_base::output::{Existing, Output, OutputKind, check, is_standard};
use slicewalk_base::text::{counted, finite_number, whole_number};
use slicewalk_convert::size::parse_size;
use slicewalk_convert::values::{UpChoice, class_range, epsg, length, part, scale_from, transform};
use slicewalk_convert::{ColourMode, ConvertOptions, HoleWidth, PixelSize, Preview, Report, convert, preview};
use slicewalk_convert::{PlanFile, SectionOptions, ShardOptions, Tolerance};
use slicewalk_input::{Columns, Units};
use slicewalk_mesh::MeshMode;
use slicewalk_terminal::{Terminal, listen, say};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Converts scans (LAS, LAZ, E57, PTX, PTS, XYZ, CSV, PCD, PLY), meshes (OBJ, PLY, STL, glTF) and Gaussian splats (PLY,
/// SPZ, SOG, .splat, .ksplat, glTF) of any size into one slice archive, in bounded memory.
///
/// Lengths are in metres. The archive appears under its name when it is complete, or not at all.
///
/// A scan can be converted in parts, on several machines. `sliceconv INPUT... --write-plan plan.json` fixes grid and
/// options. `sliceconv INPUT... --plan plan.json --shard 1/8 -o 1.slices` converts one part (name all inputs; it reads
/// the files that the part needs). `slicetool merge *.slices -o OUT.slices` joins the parts; the result is byte for
/// byte that of a single run.
#[derive(Parser)]
#[command(
    name = "sliceconv",
    version,
    max_term_width = 110,
    override_usage = "sliceconv <INPUT>... -o <OUT.slices> [OPTIONS]",
    // Options that use the positions of scanners, and a plan, which may.
    group = clap::ArgGroup::new("visibility").args(["remove_moving", "free_space", "plan"]).multiple(true)
)]
struct Arguments {
    /// Scans, meshes, splats, and octrees of solid cubes (OctoMap .bt and .ot, .voxel.json): files, folders of scans, or
    /// glob patterns in quotes. Folders and patterns skip .txt, .csv and .asc
    /// files, and folders also skip .ply; text may be compressed (.gz, .zst). Scans may also be at https:// addresses
    /// or in object stores: s3://bucket/key (gs://, az://), s3://bucket/folder/, "s3://bucket/tiles/*.laz", with
    /// credentials from AWS_* (GOOGLE_*, AZURE_*) in the environment
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// Archive to write: a file, or an address in an object store
    #[arg(short, long, required_unless_present_any = ["write_plan", "dry_run"], value_name = "OUT.slices")]
    output: Option<PathBuf>,
    /// Convert nothing; write grid, options and inputs to a plan. Reads only headers, unless the pixel size is `auto`
    #[arg(long, conflicts_with_all = ["output", "plan", "shard"], value_name = "PLAN.json")]
    write_plan: Option<PathBuf>,
    /// Take grid and options from a plan; contradicting options, and inputs other than the plan's, are refused
    #[arg(long, value_name = "PLAN.json")]
    plan: Option<PathBuf>,
    /// Convert only part I of N; `slicetool merge` joins the parts
    #[arg(long, value_name = "I/N", value_parser = part)]
    shard: Option<(u32, u32)>,
    /// Edge of a pixel in metres, or `auto`: four times the scan's point spacing, or for meshes alone a 700th of their
    /// extent
    #[arg(long, default_value = "auto", allow_negative_numbers = true, value_name = "auto|METRES")]
    pixel: PixelSize,
    /// Height of a slice in metres [default: three pixels]
    #[arg(long, allow_negative_numbers = true, value_name = "METRES", value_parser = length)]
    slice: Option<f64>,
    /// Steepest slope that a pawn can stand on, in degrees
    #[arg(long, default_value_t = 45.0, allow_negative_numbers = true, value_name = "DEG", value_parser = finite_number)]
    max_slope: f64,
    /// Coarsen heights by up to this much, always outwards, in metres; `auto`: by at most the scan's own noise, which
    /// takes one more pass over the input
    #[arg(long, default_value = "0", allow_negative_numbers = true, value_name = "auto|METRES")]
    tolerance: Tolerance,
    /// Rule that distinguishes floors from obstacles
    #[arg(long, value_enum, default_value_t = Rule::Plane)]
    classifier: Rule,
    /// Memory budget, at least 64MiB
    #[arg(long, default_value = "512MiB", value_name = "SIZE", value_parser = parse_size)]
    memory: u64,
    /// Worker threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = whole_number(1u16, 1024))]
    threads: Option<u16>,
    /// Folder for temporary data [default: the system's]
    #[arg(long, value_name = "DIR")]
    temp_dir: Option<PathBuf>,
    /// LAS classes to leave out: numbers and ranges, for example 7,18,64-255 (7 and 18 are noise)
    #[arg(long, value_name = "CLASSES", value_delimiter = ',', value_parser = class_range)]
    exclude_class: Vec<RangeInclusive<u8>>,
    /// Drop voxels with fewer points; queries may then miss these points
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = whole_number(1u32, u32::MAX))]
    min_points: u32,
    /// Drop connected components of up to this many voxels (sharing a face, an edge or a corner); queries may then miss
    /// their points
    #[arg(long, value_name = "VOXELS", value_parser = whole_number(1u16, u16::MAX))]
    drop_floaters: Option<u16>,
    /// Short for `--drop-floaters 1`: drop voxels whose 26 neighbours are all empty
    #[arg(long, conflicts_with = "drop_floaters")]
    drop_isolated: bool,
    /// Remove points that moved: other stations saw through their positions
    #[arg(long)]
    remove_moving: bool,
    /// Also store which space the stations saw: queries can then distinguish free from never seen
    #[arg(long)]
    free_space: bool,
    /// Table of scanner positions, for --remove-moving and --free-space, with the columns file,x,y,z, in the scan's coordinates. With a column source_id, a
    /// row applies to the points of that point source id; with a column t, the rows are the scanner's path by GPS time
    /// (s). E57 with poses and PTX state the positions themselves; the table has precedence
    #[arg(long, requires = "visibility", value_name = "STATIONS.csv")]
    stations: Option<PathBuf>,
    /// Write the points that were removed as moving to a LAS file
    #[arg(long, requires = "remove_moving", value_name = "REMOVED.las")]
    removed: Option<PathBuf>,
    /// Close holes in floors of up to this width in metres (1 to 45 whole pixels) with floor inferred from around them;
    /// the archive marks inferred floor. `auto`: gaps between points, up to three times the scan's point spacing. Takes
    /// one more pass (`auto` two), and temporary data of about the archive's size
    #[arg(long, allow_negative_numbers = true, value_name = "auto|METRES")]
    fill_holes: Option<HoleWidth>,
    /// Axis of the input that points up (glTF files state it), or `auto` for scans and splats: the floor shows it, or it
    /// is refused as not sure, which takes one more pass over the input
    #[arg(long, default_value = "z", allow_hyphen_values = true, value_name = "auto|z|y|x|-z|-y|-x")]
    up: UpChoice,
    /// Unit of the input: `auto` takes it from the CRS; else metres, feet, US survey feet, or metres per unit
    #[arg(long, default_value = "auto", allow_negative_numbers = true, value_name = "auto|m|ft|us-ft|FACTOR")]
    units: Units,
    /// Coordinate reference system of scans that state none; a scan that states another is refused
    #[arg(long, value_name = "EPSG:N", value_parser = epsg)]
    crs: Option<u32>,
    /// Columns of XYZ, CSV and TXT files, from left to right: x, y, z, `i` for intensity, r, g, b for colours, `class`
    /// for LAS classes, and any other name for columns to skip [default: from the file's header, else x,y,z]
    #[arg(long, value_name = "x,y,z,...")]
    columns: Option<Columns>,
    /// Gaussian splats: a place is solid if some splat's own opacity there is at least this (above 0, at most 1)
    #[arg(long, default_value_t = 0.1, allow_negative_numbers = true, value_name = "X", value_parser = finite_number)]
    opacity: f64,
    /// Gaussian splats: leave out those with less opacity at their centre
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_name = "X", value_parser = finite_number)]
    min_opacity: f64,
    /// Gaussian splats: leave out those whose solid part is longer than this, such as needles and blobs of sky
    #[arg(long, allow_negative_numbers = true, value_name = "METRES", value_parser = length)]
    max_size: Option<f64>,
    /// Gaussian splats: unit from a known distance, two places in the file's coordinates and the metres between them
    #[arg(long, num_args = 3, conflicts_with = "units", allow_hyphen_values = true, value_names = ["X,Y,Z", "X,Y,Z", "METRES"])]
    scale_from: Vec<String>,
    /// Place the input, after --units and --up, by the 4 × 4 matrix in a text file (16 numbers, row by row; a rotation,
    /// one scale and a shift)
    #[arg(long, value_name = "MATRIX.txt")]
    transform: Option<PathBuf>,
    /// How meshes become voxels
    #[arg(long, value_enum, default_value_t = Surfaces::Exact)]
    mesh: Surfaces,
    /// Add overview levels for first looks and distant views: pixels and slices 4, 16, 64 ... times as large. They cost
    /// bytes and time, most on sparse scans
    #[arg(long, value_enum, default_value_t = Switch::Off)]
    levels: Switch,
    /// Source of a colour for each voxel: red, green and blue of the points, their intensity as grey, their LAS class
    /// by a palette, `auto` (RGB where the input has it, else intensity, else no colours), or `off`. Meshes have RGB:
    /// colours of corners, materials and textures
    #[arg(long, default_value = "off", value_name = "rgb|intensity|class|auto|off")]
    colour: ColourMode,
    /// Greatest mean difference of a page's colours from the means of the points, in CIELAB; 0 keeps the means exactly,
    /// to 8 bits
    #[arg(long, default_value_t = SectionOptions::default().colour_error, allow_negative_numbers = true, value_name = "E", value_parser = finite_number)]
    colour_error: f64,
    /// Convert the readable part of incomplete input (cut, damaged or unreadable files) with warnings, instead of
    /// refusing it
    #[arg(long)]
    allow_incomplete: bool,
    /// Convert nothing; print the inputs, the grid, the memory and the temporary space. Reads only headers and meshes,
    /// unless the pixel size is `auto`
    #[arg(long, conflicts_with = "write_plan")]
    dry_run: bool,
    /// Continue from the temporary data that an earlier, killed run of the same conversion left, and keep such data if
    /// this run ends early: on an error, on an interruption, on a full disk. Without such data the conversion starts
    /// from the beginning
    #[arg(long, conflicts_with = "write_plan")]
    resume: bool,
    /// Replace an existing slice archive (or plan); no other file is ever replaced
    #[arg(long)]
    force: bool,
    /// Print no progress, no summary and no warnings
    #[arg(long, short)]
    quiet: bool,
    /// Print the result as JSON on standard output
    #[arg(long)]
    json: bool,
    /// Print completions for a shell and exit
    #[arg(long, exclusive = true, value_enum, value_name = "SHELL")]
    completions: Option<clap_complete::Shell>,
    /// Print the manual page and exit
    #[arg(long, exclusive = true)]
    man: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Rule {
    /// Vertical extent of the connected solid run in a pixel: no slope up to the limit is an obstacle, but some steeper
    /// slopes are floor
    Span,
    /// Vertical extent within one voxel, as in the thesis: depends on the slice height and keeps no angle
    Thesis,
    /// Slope of a plane fitted to 3 × 3 pixels: keeps the limit within 3°
    Plane,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(Clone, Copy, ValueEnum)]
enum Surfaces {
    /// Every pixel that a triangle touches, with its exact heights there and its true slope
    Exact,
    /// Points a pixel apart, as in the thesis; misses pixels
    Sampled,
}

/// Result of a run.
enum Done {
    Archive(Box<Report>),
    Plan(Box<PlanFile>),
    /// Nothing was done; describes what would be done.
    Preview(Box<Preview>),
}

fn main() -> ExitCode {
    let given = Arguments::command().get_matches();
    let arguments = match Arguments::from_arg_matches(&given) {
        Ok(arguments) => arguments,
        Err(error) => error.exit(),
    };
    if let Some(written) = describe_program(&arguments) {
        return written;
    }
    let signal = Arc::new(AtomicUsize::new(0));
    let terminal = Terminal::new("sliceconv", arguments.quiet, suggestion, signal.clone());
    if let Err(error) = listen(&signal) {
        terminal.warn(&format!("cannot listen for Ctrl-C: {error}").into());
    }
    let started = Instant::now();
    let asked = signal.clone();
    let stop = move || asked.load(Ordering::Relaxed) != 0;
    let result = interruptible(Some(Arc::new(stop)), || run(&arguments, &given, &terminal));
    drop(terminal);
    told(match result {
        Ok(Done::Archive(report)) => report::of_conversion(&arguments, &report, started.elapsed().as_secs_f64()),
        Ok(Done::Plan(file)) => report::of_plan(&arguments, &file),
        Ok(Done::Preview(preview)) => report::of_preview(&arguments, &preview),
        Err(failed) => {
            let (line, code) = failure(&failed, signal.load(Ordering::Relaxed));
            say(&format!("sliceconv: {line}"));
            return code;
        }
    })
}

/// Returns the exit code once the result is printed, or could not be.
fn told(printed: std::io::Result<()>) -> ExitCode {
    match printed {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("sliceconv: cannot write to standard output: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// Writes completions or the manual page, if requested.
fn describe_program(arguments: &Arguments) -> Option<ExitCode> {
    let mut text = Vec::new();
    match arguments.completions {
        Some(shell) => clap_complete::generate(shell, &mut Arguments::command(), "sliceconv", &mut text),
        None if arguments.man => clap_mangen::Man::new(Arguments::command()).render(&mut text).ok()?,
        None => return None,
    }
    Some(told(report::print_bytes(&text)))
}

/// Reason why nothing was done.
enum Failure {
    /// The options contradict each other; holds one line.
    Usage(String),
    Failed(Error),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

/// Returns the message and the exit code for a failure.
fn failure(failure: &Failure, signal: usize) -> (String, ExitCode) {
    let error = match failure {
        Failure::Usage(line) => return (line.clone(), ExitCode::from(2)),
        Failure::Failed(error) => error,
    };
    if let Error::Resumable { source, path, bytes, points } = error {
        let (line, code) = failure_of(source, signal);
        let (points, path) = (counted(*points, "point"), path.display());
        return (format!("{line}; --resume continues from {points}, {bytes} bytes of temporary data in {path}"), code);
    }
    failure_of(error, signal)
}

fn failure_of(error: &Error, signal: usize) -> (String, ExitCode) {
    match error {
        // Like the shell reports a program ended by a signal.
        Error::Interrupted => (error.to_string(), ExitCode::from(128 + u8::try_from(signal).unwrap_or(2))),
        // The signal ended a wait for a server.
        Error::Io { .. } | Error::Input { .. } if signal != 0 => failure_of(&Error::Interrupted, signal),
        // The input is at fault, not the option.
        Error::Parameter { what: Parameter::AutomaticPixelSize, reason } => {
            (format!("--pixel auto: {reason}"), ExitCode::FAILURE)
        }
        Error::Parameter { what: Parameter::Other(name), reason } if name == "automatic up" => {
            (format!("--up auto: {reason}"), ExitCode::FAILURE)
        }
        Error::Parameter { what, reason } => match option_of(what) {
            Some(option) => (format!("{option}: {reason}"), ExitCode::from(2)),
            None => (error.to_string(), ExitCode::FAILURE),
        },
        _ => (error.render(suggestion), ExitCode::FAILURE),
    }
}

/// Returns the advice that names the option for a parameter.
fn suggestion(parameter: &Parameter) -> Option<&'static str> {
    Some(match parameter {
        Parameter::PixelSize => "give a larger --pixel, or the unit by --units",
        Parameter::Units => "set the unit with --units",
        Parameter::Columns => "name the columns with --columns x,y,z",
        Parameter::Memory => "give more --memory",
        Parameter::TempDir => "choose a folder with space by --temp-dir",
        Parameter::Incomplete => "or take what can be read with --allow-incomplete",
        Parameter::Overwrite => "--force replaces it",
        _ => return None,
    })
}

/// Returns the option for a parameter whose value is wrong regardless of the input.
fn option_of(parameter: &Parameter) -> Option<&'static str> {
    Some(match parameter {
        Parameter::PixelSize => "--pixel",
        Parameter::SliceHeight => "--slice",
        Parameter::MaxSlope => "--max-slope",
        Parameter::Tolerance => "--tolerance",
        Parameter::MinPoints => "--min-points",
        Parameter::Memory => "--memory",
        Parameter::Threads => "--threads",
        Parameter::Units => "--units",
        Parameter::Shard => "--shard",
        Parameter::Resume => "--resume",
        Parameter::Stations => "--stations",
        Parameter::FillHoles => "--fill-holes",
        Parameter::Colour => "--colour",
        Parameter::ColourError => "--colour-error",
        Parameter::Other(name) if name == "mesh" => "--mesh",
        Parameter::Other(name) if name == "up" => "--up",
        Parameter::Other(name) if name == "plan file" => "--plan",
        Parameter::Splats("opacity") => "--opacity",
        Parameter::Splats("least opacity") => "--min-opacity",
        Parameter::Splats("greatest size") => "--max-size",
        _ => return None,
    })
}

fn run(arguments: &Arguments, given: &ArgMatches, monitor: &dyn Monitor) -> Result<Done, Failure> {
    if arguments.inputs.iter().any(|input| is_standard(input)) {
        return Err(Failure::Usage(
            "-: scans are read in pieces from everywhere, not from standard input; name a file".into(),
        ));
    }
    if arguments.json && arguments.removed.as_deref().is_some_and(is_standard) {
        let text = "--removed - and --json both write to standard output; name a file for --removed";
        return Err(Failure::Usage(text.into()));
    }
    let mut options = ConvertOptions::new(arguments.inputs.clone(), arguments.output.clone().unwrap_or_default());
    options.grid.pixel = arguments.pixel;
    options.grid.slice_m = arguments.slice;
    options.plan.max_slope_deg = arguments.max_slope;
    options.set_tolerance(arguments.tolerance);
    options.plan.classifier = match arguments.classifier {
        Rule::Span => Classifier::Span,
        Rule::Thesis => Classifier::Thesis,
        Rule::Plane => Classifier::Plane,
    };
    options.resources.memory_bytes = arguments.memory;
    options.resources.threads = arguments.threads.map_or(options.resources.threads, usize::from);
    options.resources.temp_dir = arguments.temp_dir.clone().unwrap_or(options.resources.temp_dir);
    options.plan.exclude_classes = arguments.exclude_class.iter().cloned().flatten().collect();
    options.plan.min_points = arguments.min_points;
    options.plan.drop_floaters = arguments.drop_floaters.unwrap_or(arguments.drop_isolated.into());
    options.plan.remove_moving = arguments.remove_moving;
    options.sections.free_space = arguments.free_space;
    options.grid.fill_holes = arguments.fill_holes;
    options.stations = arguments.stations.clone();
    options.removed = arguments.removed.clone();
    (options.plan.up, options.reading.turn) = (arguments.up.axis, arguments.up.turn);
    options.reading.units = arguments.units;
    if let [from, to, metres] = &arguments.scale_from[..] {
        options.reading.units =
            scale_from(from, to, metres).map_err(|why| Failure::Usage(format!("--scale-from: {why}")))?;
    }
    options.reading.splats.opacity = arguments.opacity;
    options.reading.splats.min_opacity = arguments.min_opacity;
    options.reading.splats.max_size_m = arguments.max_size;
    if let Some(path) = &arguments.transform {
        options.reading.placement = Some(transform(path)?);
    }
    // The library knows the content of these two, not their names.
    let texts = [&arguments.transform, &arguments.plan].into_iter().flatten();
    if let Some(removed) = arguments.removed.as_deref().filter(|removed| removed.is_file()) {
        check(removed, OutputKind::Result, texts.collect())?;
    }
    options.reading.epsg = arguments.crs;
    options.reading.columns = arguments.columns;
    options.reading.mesh = match arguments.mesh {
        Surfaces::Exact => MeshMode::Exact,
        Surfaces::Sampled => MeshMode::Sampled { step_m: None },
    };
    options.sections.levels = arguments.levels == Switch::On;
    options.sections.colour = arguments.colour;
    options.sections.colour_error = arguments.colour_error;
    options.allow_incomplete = arguments.allow_incomplete;
    options.overwrite = arguments.force;
    options.resume = arguments.resume;
    if let Some(path) = &arguments.write_plan {
        let kind = OutputKind::Plan(Existing::replaced_if(arguments.force));
        let output = Output::create(path, kind, arguments.inputs.iter().collect())?;
        let file = PlanFile::new(&options, monitor)?;
        file.write_to(output)?;
        return Ok(Done::Plan(Box::new(file)));
    }
    let plan_file = arguments.plan.as_deref().map(PlanFile::read).transpose()?;
    if let Some(file) = &plan_file {
        refuse_contradictions(given, &options, file)?;
        file.apply_to(&mut options);
        if options.stations.is_some() && !options.needs_stations() {
            let text = "--stations: the plan neither removes what moved nor stores seen space; leave it out";
            return Err(Failure::Usage(text.into()));
        }
    }
    options.plan_file = plan_file;
    options.shard = arguments.shard.map(|(index, count)| ShardOptions { index, count });
    if arguments.dry_run {
        return Ok(Done::Preview(Box::new(preview(&options, monitor)?)));
    }
    Ok(Done::Archive(Box::new(convert(&options, monitor)?)))
}

/// Refuses options on the command line that contradict the plan.
fn refuse_contradictions(given: &ArgMatches, wanted: &ConvertOptions, plan: &PlanFile) -> Result<(), Failure> {
    let mut named = given.ids().map(clap::Id::as_str);
    let typed = |id: &str| given.value_source(id) == Some(ValueSource::CommandLine);
    if let Some(id) = named.find(|id| typed(id) && plan.contradicts(id, wanted)) {
        let name = id.replace('_', "-");
        return Err(Failure::Usage(format!("--{name}: contradicts the plan; leave it out, or write another plan")));
    }
    Ok(())
}
