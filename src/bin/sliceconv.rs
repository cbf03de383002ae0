//! Converts scans and meshes into one slice archive: arguments, one call, printing, exit code.

use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use signal_hook::{consts, flag};
use slicewalk::convert::plan_file;
use slicewalk::convert::{ConvertOptions, PixelSize, Report, convert};
use slicewalk::convert::{Job, ShardOptions};
use slicewalk::input::Units;
use slicewalk::mesh::MeshMode;
use slicewalk::output::{Existing, Output, OutputKind};
use slicewalk::plan::{Classifier, Up};
use slicewalk::size::parse_size;
use slicewalk::{Error, Monitor, Parameter};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Converts scans (LAS, LAZ) and meshes (OBJ, PLY, STL, glTF) of any size into one slice archive, in bounded memory.
///
/// Numbers in input units are metres. The archive appears complete under its name, or not at all.
///
/// A scan can be converted in parts, on several machines: `sliceconv INPUT... --write-plan plan.json` fixes grid and
/// options, `sliceconv INPUT... --plan plan.json --shard 1/8 -o 1.slices` converts one part (all inputs are named, the
/// files that the part meets are read), and `slicetool merge *.slices -o OUT.slices` joins the parts to the very bytes of
/// a single run.
#[derive(Parser)]
#[command(name = "sliceconv", version, max_term_width = 110)]
struct Arguments {
    /// Scans and meshes: files, folders of scans, or glob patterns in quotes
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// Archive to write
    #[arg(short, long, required_unless_present = "write_plan", value_name = "OUT.slices")]
    output: Option<PathBuf>,
    /// Convert nothing; write grid, options and inputs to a plan. Reads headers only, unless the pixel size is `auto`
    #[arg(long, conflicts_with_all = ["output", "plan", "shard"], value_name = "PLAN.json")]
    write_plan: Option<PathBuf>,
    /// Take grid and options from a plan; options that contradict it are refused
    #[arg(long, value_name = "PLAN.json")]
    plan: Option<PathBuf>,
    /// Convert part I of N only, to be joined by `slicetool merge`
    #[arg(long, value_name = "I/N", value_parser = part)]
    shard: Option<(u32, u32)>,
    /// Edge of a pixel in metres, or `auto`: four times the scan's point spacing; of meshes alone, a 700th of their extent
    #[arg(long, default_value = "auto", allow_negative_numbers = true, value_name = "auto|METRES", value_parser = pixel_size)]
    pixel: PixelSize,
    /// Height of a slice in metres [default: three pixels]
    #[arg(long, allow_negative_numbers = true, value_name = "METRES", value_parser = length)]
    slice: Option<f64>,
    /// Steepest slope that can be stood on, in degrees
    #[arg(long, default_value_t = 45.0, allow_negative_numbers = true, value_name = "DEG")]
    max_slope: f64,
    /// How far heights may be coarsened, always outwards, in metres
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_name = "METRES")]
    tolerance: f64,
    /// How floors and obstacles are told apart
    #[arg(long, value_enum, default_value_t = Rule::Plane)]
    classifier: Rule,
    /// Memory to use, at least 64MiB
    #[arg(long, default_value = "512MiB", value_name = "SIZE", value_parser = parse_size)]
    memory: u64,
    /// Worker threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Folder for temporary data [default: the system's]
    #[arg(long, value_name = "DIR")]
    temp_dir: Option<PathBuf>,
    /// LAS classes to leave out, e.g. 7,18 for noise
    #[arg(long, value_name = "CLASSES", value_delimiter = ',')]
    exclude_class: Vec<u8>,
    /// Drop voxels of fewer points (their points may then be missed)
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    min_points: u32,
    /// Drop voxels without matter in any of the 26 around them (their points may then be missed)
    #[arg(long)]
    drop_isolated: bool,
    /// Axis of the input that points up (glTF says itself)
    #[arg(long, value_enum, default_value_t = Axis::Z)]
    up: Axis,
    /// Unit of the input: from its CRS, metres, feet, US survey feet, or metres per unit
    #[arg(long, default_value = "auto", allow_negative_numbers = true, value_name = "auto|m|ft|us-ft|FACTOR", value_parser = units)]
    units: Units,
    /// How meshes become voxels
    #[arg(long, value_enum, default_value_t = Surfaces::Exact)]
    mesh: Surfaces,
    /// Convert what can be read of incomplete input (cut or damaged files, files that cannot be read), with warnings, instead
    /// of refusing it
    #[arg(long)]
    allow_incomplete: bool,
    /// Go on from the temporary data of the same conversion that was killed, and leave them if this one ends early: on an
    /// error, when it is interrupted, on a full disk. Without such data the conversion begins anew
    #[arg(long, conflicts_with = "write_plan")]
    resume: bool,
    /// Replace an existing slice archive (or plan); nothing else is ever replaced
    #[arg(long)]
    force: bool,
    /// No progress and no warnings
    #[arg(long, short)]
    quiet: bool,
    /// Print what was done as JSON on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Rule {
    /// Vertical extent of connected matter in a pixel: no slope up to the limit is an obstacle, but some steeper ones are floor
    Span,
    /// Vertical extent within one voxel, as in the thesis: depends on the slice height and keeps no angle
    Thesis,
    /// Slope of a plane fitted to 3 × 3 pixels: keeps the limit within 3°
    Plane,
}

#[derive(Clone, Copy, ValueEnum)]
enum Surfaces {
    /// Every pixel that a triangle touches, its exact heights there, and its true slope
    Exact,
    /// As points a pixel apart, as in the thesis; misses pixels
    Sampled,
}

#[derive(Clone, Copy, ValueEnum)]
enum Axis {
    Z,
    Y,
}

fn length(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("expected a length in metres above 0".into()),
    }
}

fn pixel_size(text: &str) -> Result<PixelSize, String> {
    if text == "auto" { Ok(PixelSize::Auto) } else { length(text).map(PixelSize::Metres) }
}

fn units(text: &str) -> Result<Units, String> {
    Ok(match text {
        "auto" => Units::Auto,
        "m" => Units::Factor(1.0),
        "ft" => Units::Factor(0.3048),
        "us-ft" => Units::Factor(1200.0 / 3937.0),
        factor => match factor.parse::<f64>() {
            Ok(value) if value > 0.0 && value.is_finite() => Units::Factor(value),
            _ => return Err("expected auto, m, ft, us-ft, or metres per unit above 0".into()),
        },
    })
}

fn part(text: &str) -> Result<(u32, u32), String> {
    let numbers = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
    numbers
        .filter(|&(index, count)| (1..=count).contains(&index) && count <= slicewalk::archive::MAX_SHARDS)
        .ok_or_else(|| format!("expected a part and their number, from 1/1 to {0}/{0}", slicewalk::archive::MAX_SHARDS))
}

/// Shows progress on a terminal and prints warnings on standard error.
struct Terminal {
    quiet: bool,
    /// The signal that asked to stop, 0 if none did.
    signal: Arc<AtomicUsize>,
    bar: Mutex<ProgressBar>,
}

impl Terminal {
    fn bar(&self) -> std::sync::MutexGuard<'_, ProgressBar> {
        self.bar.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Monitor for Terminal {
    fn stage(&self, name: &str, total: u64, unit: &str) {
        if self.quiet {
            return;
        }
        let bar = if total > 0 { ProgressBar::new(total) } else { ProgressBar::new_spinner() };
        let template = format!("{{msg:16}} {{wide_bar}} {{human_pos}}/{{human_len}} {unit} {{per_sec}} {{eta}}");
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style);
        }
        bar.set_message(name.to_owned());
        std::mem::replace(&mut *self.bar(), bar).finish_and_clear();
    }

    fn advance(&self, amount: u64) {
        self.bar().inc(amount);
    }

    fn warn(&self, text: &str) {
        if !self.quiet {
            self.bar().suspend(|| say(&format!("sliceconv: warning: {text}")));
        }
    }

    fn cancelled(&self) -> bool {
        self.signal.load(Ordering::Relaxed) != 0
    }
}

/// What was done.
enum Done {
    Archive(Box<Report>),
    Plan(Box<Job>),
}

fn main() -> ExitCode {
    let given = Arguments::command().get_matches();
    let arguments = match Arguments::from_arg_matches(&given) {
        Ok(arguments) => arguments,
        Err(error) => error.exit(),
    };
    slicewalk::input::quiet_decoder_panics();
    let signal = Arc::new(AtomicUsize::new(0));
    let terminal = Terminal { quiet: arguments.quiet, signal: signal.clone(), bar: Mutex::new(ProgressBar::hidden()) };
    if let Err(error) = listen(&signal) {
        terminal.warn(&format!("cannot listen for Ctrl-C: {error}"));
    }
    let started = Instant::now();
    let result = run(&arguments, &given, &terminal);
    terminal.bar().finish_and_clear();
    match result {
        Ok(Done::Archive(report)) => {
            print_report(&arguments, &report, started.elapsed().as_secs_f64());
            ExitCode::SUCCESS
        }
        Ok(Done::Plan(job)) => {
            print_plan(&arguments, &job);
            ExitCode::SUCCESS
        }
        Err(failed) => {
            let (line, code) = failure(&failed, signal.load(Ordering::Relaxed));
            say(&format!("sliceconv: {line}"));
            code
        }
    }
}

/// Notes the signals that ask to stop. A second one ends the process at once: temporary data vanish with it or are
/// removed by the next run.
fn listen(signal: &Arc<AtomicUsize>) -> std::io::Result<()> {
    let again = Arc::new(AtomicBool::new(false));
    let asking = [
        consts::SIGINT,
        consts::SIGTERM,
        #[cfg(unix)]
        consts::SIGHUP,
    ];
    for number in asking {
        flag::register_conditional_shutdown(number, 128 + number, again.clone())?;
        flag::register(number, again.clone())?;
        flag::register_usize(number, signal.clone(), number as usize)?;
    }
    Ok(())
}

/// Why nothing was done.
enum Failure {
    /// The options contradict each other; one line.
    Usage(String),
    Failed(Error),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

/// The line and the exit code that a failure ends with.
fn failure(failure: &Failure, signal: usize) -> (String, ExitCode) {
    let error = match failure {
        Failure::Usage(line) => return (line.clone(), ExitCode::from(2)),
        Failure::Failed(error) => error,
    };
    let cause = match error {
        Error::Resumable { source, .. } => source,
        error => error,
    };
    match cause {
        // As the shell reports a program that a signal ended.
        Error::Interrupted => (error.to_string(), ExitCode::from(128 + u8::try_from(signal).unwrap_or(2))),
        // The input is at fault, not the option.
        Error::Parameter { what: Parameter::AutomaticPixelSize, reason } => {
            (format!("--pixel auto: {reason}"), ExitCode::FAILURE)
        }
        Error::Parameter { what, reason } => match option_of(what) {
            Some(option) => (format!("{option}: {reason}"), ExitCode::from(2)),
            None => (error.to_string(), ExitCode::FAILURE),
        },
        _ => (error.to_string(), ExitCode::FAILURE),
    }
}

/// The option whose value is wrong whatever the input holds.
fn option_of(parameter: &Parameter) -> Option<&'static str> {
    Some(match parameter {
        Parameter::PixelSize => "--pixel",
        Parameter::SliceHeight => "--slice",
        Parameter::MaxSlope => "--max-slope",
        Parameter::Tolerance => "--tolerance",
        Parameter::MinPoints => "--min-points",
        Parameter::Memory => "--memory",
        Parameter::Units => "--units",
        Parameter::Shard => "--shard",
        _ => return None,
    })
}

/// Prints a line on standard error. Unlike `eprintln!` it does not panic when nobody reads there any more.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

fn run(arguments: &Arguments, given: &ArgMatches, monitor: &dyn Monitor) -> Result<Done, Failure> {
    let mut options = ConvertOptions::new(arguments.inputs.clone(), arguments.output.clone().unwrap_or_default());
    options.pixel = arguments.pixel;
    options.slice_m = arguments.slice;
    options.plan.max_slope_deg = arguments.max_slope;
    options.plan.tolerance_m = arguments.tolerance;
    options.plan.classifier = match arguments.classifier {
        Rule::Span => Classifier::Span,
        Rule::Thesis => Classifier::Thesis,
        Rule::Plane => Classifier::Plane,
    };
    options.memory_bytes = arguments.memory;
    options.threads = arguments.threads.map_or(options.threads, usize::from);
    options.temp_dir = arguments.temp_dir.clone().unwrap_or(options.temp_dir);
    options.plan.exclude_classes = arguments.exclude_class.iter().copied().collect();
    options.plan.min_points = arguments.min_points;
    options.plan.drop_isolated = arguments.drop_isolated;
    options.plan.up = match arguments.up {
        Axis::Z => Up::Z,
        Axis::Y => Up::Y,
    };
    options.units = arguments.units;
    options.mesh = match arguments.mesh {
        Surfaces::Exact => MeshMode::Exact,
        Surfaces::Sampled => MeshMode::Sampled { step_m: None },
    };
    options.allow_incomplete = arguments.allow_incomplete;
    options.overwrite = arguments.force;
    options.resume = arguments.resume;
    if let Some(path) = &arguments.write_plan {
        let kind = OutputKind::Plan(Existing::replaced_if(arguments.force));
        let output = Output::create(path, kind, arguments.inputs.iter().collect())?;
        let job = Job::new(&options, monitor)?;
        plan_file::write_to(&job, output)?;
        return Ok(Done::Plan(Box::new(job)));
    }
    let job = arguments.plan.as_deref().map(plan_file::read).transpose()?;
    if let Some(job) = &job {
        let wanted = options.clone();
        job.apply_to(&mut options);
        refuse_contradictions(given, &wanted, &options)?;
    }
    options.shard = arguments.shard.map(|(index, count)| ShardOptions { index, count, job });
    Ok(Done::Archive(Box::new(convert(&options, monitor)?)))
}

/// Refuses options on the command line that say otherwise than the plan, whose options are `planned`.
fn refuse_contradictions(given: &ArgMatches, wanted: &ConvertOptions, planned: &ConvertOptions) -> Result<(), Failure> {
    let options = [
        ("pixel", "--pixel", wanted.pixel == planned.pixel),
        ("slice", "--slice", wanted.slice_m == planned.slice_m),
        ("max_slope", "--max-slope", wanted.plan.max_slope_deg == planned.plan.max_slope_deg),
        ("tolerance", "--tolerance", wanted.plan.tolerance_m == planned.plan.tolerance_m),
        ("classifier", "--classifier", wanted.plan.classifier == planned.plan.classifier),
        ("exclude_class", "--exclude-class", wanted.plan.exclude_classes == planned.plan.exclude_classes),
        ("min_points", "--min-points", wanted.plan.min_points == planned.plan.min_points),
        ("drop_isolated", "--drop-isolated", wanted.plan.drop_isolated == planned.plan.drop_isolated),
        ("up", "--up", wanted.plan.up == planned.plan.up),
        ("units", "--units", wanted.units == planned.units),
        ("mesh", "--mesh", wanted.mesh == planned.mesh),
    ];
    for (id, name, same) in options {
        if !same && given.value_source(id) == Some(ValueSource::CommandLine) {
            let line = format!("{name}: contradicts the plan; leave it out, or write another plan");
            return Err(Failure::Usage(line));
        }
    }
    Ok(())
}

fn print_plan(arguments: &Arguments, job: &Job) {
    if arguments.json {
        let _ = writeln!(std::io::stdout(), "{:#}", plan_file::to_json(job));
    } else if !arguments.quiet {
        let frame = &job.plan.frame;
        let inputs = job.inputs.len();
        say(&format!("plan: pixel {} m, slice {} m, {inputs} inputs", frame.pixel_m(), frame.slice_m()));
    }
}

fn print_report(arguments: &Arguments, report: &Report, seconds: f64) {
    let header = &report.header;
    if arguments.json {
        let mut facts = slicewalk::info::header_info(header, &report.crs, &report.units);
        facts["points_not_finite"] = report.points_not_finite.into();
        facts["complete"] = report.complete.into();
        facts["triangles_read"] = report.triangles.read.into();
        facts["triangles_left_out"] = report.triangles.left_out.into();
        facts["points_made"] = report.points_made.into();
        facts["voxels_dropped"] = report.voxels_dropped.into();
        facts["temp_bytes"] = report.temp_bytes.into();
        facts["points_resumed"] = report.resumed.map_or(0, |resumed| resumed.points).into();
        facts["temp_bytes_resumed"] = report.resumed.map_or(0, |resumed| resumed.bytes).into();
        facts["point_spacing"] = report.spacing.as_ref().map(|spacing| spacing.spacing_m).into();
        if let Some(shard) = &report.shard {
            facts["shard"] = slicewalk::info::shard_info(shard);
        }
        facts["seconds"] = seconds.into();
        // The archive is written; that nobody reads about it is no failure.
        let _ = writeln!(std::io::stdout(), "{facts:#}");
    }
    if arguments.quiet || arguments.json {
        return;
    }
    let frame = &header.plan.frame;
    if let Some(spacing) = &report.spacing {
        say(&format!(
            "pixel size {} m: 4 × the point spacing of {:.4} m (median over {} sampled points)",
            frame.pixel_m(),
            spacing.spacing_m,
            spacing.sampled
        ));
    }
    if let Some(resumed) = report.resumed {
        let (points, bytes) = (resumed.points, resumed.bytes);
        say(&format!("resumed: {points} points were not read again, from {bytes} bytes of temporary data"));
    }
    let left_out = header.points_read - header.points_kept;
    let what = match report.triangles.read {
        0 => "points",
        all if all == header.points_read => "triangles",
        _ => "points and triangles",
    };
    say(&format!(
        "{}: {} {what} ({left_out} left out), {} voxels ({} obstacle) in {} slices of {} m",
        arguments.output.clone().unwrap_or_default().display(),
        header.points_kept,
        header.voxels.occupied,
        header.voxels.obstacle,
        slicewalk::info::slice_count(header),
        frame.slice_m()
    ));
    say(&format!("unit of the source: {}; the archive is in metres", slicewalk::info::units_in_words(&report.units)));
    if report.voxels_dropped > 0 {
        let dropped = report.voxels_dropped;
        say(&format!("{dropped} voxels of too few points or without neighbours dropped, and their points"));
    }
    say(&format!(
        "{} bytes, {} bytes of temporary data, {seconds:.2} s, {:.2} M {what}/s",
        header.file_len,
        report.temp_bytes,
        header.points_read as f64 / seconds / 1e6
    ));
}
