//! Inspects and queries slice archives. Results go to standard output, diagnostics to standard error. Exit codes: 0
//! success, 1 failure (one line: what, where, what to do), 2 usage, 128 and the number of the signal if one interrupted it.

mod blocked;
mod changes;
mod coverage;
mod demo;
mod diff;
mod edits;
mod export;
mod extract;
mod figures;
mod ground;
mod info;
mod links;
mod manual;
mod merge;
mod nearest;
mod outline;
mod query;
mod reach;
mod recover;
mod replace;
mod route;
mod show;
mod standard;
mod stats;
mod verify;
mod walk;
mod web;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use slicewalk::archive::{Archive, PageEntry};
use slicewalk::bytes::interruptible;
use slicewalk::edit::Edits;
use slicewalk::{Monitor, Parameter};
use slicewalk_base::output::{Output, OutputKind, Protected};
use slicewalk_base::text::lines;
use slicewalk_terminal::Terminal;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

/// Reason why a command ends early.
#[derive(Clone)]
pub enum Failure {
    /// One line for standard error.
    Text(String),
    /// An option has an invalid value; one line.
    Usage(String),
    /// A result to print that nevertheless means failure, such as a list of findings.
    Result(String),
    /// A signal ended the command: its exit code.
    Interrupted(u8),
}

impl Failure {
    /// The line that says what failed.
    #[cfg(feature = "serve")]
    fn text(&self) -> &str {
        match self {
            Self::Text(text) | Self::Usage(text) | Self::Result(text) => text,
            Self::Interrupted(_) => "interrupted",
        }
    }
}

impl<E: std::error::Error + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        match (&error as &dyn std::error::Error).downcast_ref() {
            Some(error) => of_library(error),
            None => Self::Text(error.to_string()),
        }
    }
}

/// Converts an error of the library, with command-line options in place of its parameters.
fn of_library(error: &slicewalk::Error) -> Failure {
    use slicewalk::Error::{Input, Interrupted, Io};
    // A signal also ends the wait for a server.
    if matches!(error, Interrupted) || asked() && matches!(error, Io { .. } | Input { .. }) {
        return Failure::Interrupted(128 + signal().load(Ordering::Relaxed) as u8);
    }
    if let slicewalk::Error::Parameter { what, reason } = error
        && let Some(option) = option_of(what)
    {
        // `--pawn` holds several numbers, so name the wrong one.
        return Failure::Usage(match what {
            Parameter::Pawn(number) if option == "--pawn" => format!("{option}: {number}: {reason}"),
            _ => format!("{option}: {reason}"),
        });
    }
    Failure::Text(error.render(suggestion))
}

/// Advice that names an option.
fn suggestion(parameter: &Parameter) -> Option<&'static str> {
    Some(match parameter {
        Parameter::Overwrite => "--force replaces it",
        Parameter::Plan => "give them with --plan (sliceconv --write-plan makes one)",
        Parameter::Cache => "give more --cache",
        Parameter::Bounds => "extract a region first",
        Parameter::PixelSize => "give a larger --pixel, or the unit by --units",
        Parameter::Units => "set the unit with --units",
        _ => return None,
    })
}

/// Returns the option whose value is invalid for any archive.
fn option_of(parameter: &Parameter) -> Option<&'static str> {
    Some(match parameter {
        Parameter::Pawn("speed") => "--speed",
        Parameter::Pawn("climb height") => "--climb",
        Parameter::Pawn("deepest drop") => "--max-drop",
        Parameter::Pawn("start") => "--start",
        Parameter::Pawn("length") => "--length",
        Parameter::Pawn(_) => "--pawn",
        Parameter::Cache => "--cache",
        Parameter::PixelSize => "--pixel",
        Parameter::Units => "--units",
        _ => return None,
    })
}

/// Text for standard output, or a failure.
pub type Outcome = Result<String, Failure>;

/// Inspects and queries slice archives.
#[derive(Parser)]
#[command(name = "slicetool", version, max_term_width = 110)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Print the metadata of archives
    Info {
        /// Slice archives
        #[arg(required = true, value_name = "ARCHIVE")]
        archives: Vec<PathBuf>,
        /// Print JSON: an object, or a list of objects for several archives
        #[arg(long)]
        json: bool,
    },
    /// Check every byte of an archive and list all findings; exit code 1 if there are any
    Verify {
        /// Slice archive
        archive: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Count how pages and tiles are stored, and bytes by part; or report what was seen
    Stats {
        /// Slice archive
        archive: PathBuf,
        /// Report how much space was seen (`sliceconv --free-space`), where it ends in the open, and where the next
        /// stations should stand
        #[arg(long)]
        coverage: bool,
        /// Plan of the coverage to draw (PNG): seen space blue, where it ends red, stations white
        #[arg(short, long, requires = "coverage", value_name = "PLAN.png")]
        output: Option<PathBuf>,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Draw one slice in the thesis' colours: red height, green 255, blue 255 obstacle, 26 floor or 128 inferred floor,
    /// black empty
    Show(show::Arguments),
    /// Compare the contents of two archives on one grid, not their bytes; exits with code 0 whether they differ or not
    Diff(diff::Arguments),
    /// Export voxels as points, floors as a raster, a slice as a plan, or all occupied space as a surface
    Export(export::Arguments),
    /// Merge the parts that `sliceconv --shard` wrote, in any order, into the exact bytes of a single run
    Merge(merge::Arguments),
    /// Rebuild an archive from the sound pages of a damaged one
    Recover(recover::Arguments),
    /// Extract a region of an archive; queries inside it give the same answers as the whole
    Extract(extract::Arguments),
    /// Replace a region of an archive by that of another one, such as a rescan of a room, in a new archive
    Replace(replace::Arguments),
    /// Answer boxes or rays from a CSV file
    Query(query::Arguments),
    /// Walk a pawn along waypoints and write its path
    Walk(walk::Arguments),
    /// Find where a pawn can walk, how narrow it gets, and where it leaks
    Reach(reach::Arguments),
    /// Find the shortest route of a pawn between two places
    Route(route::Arguments),
    /// Show archives and scans in the browser to walk in them, served to this machine only, until Ctrl-C (exit code
    /// 130). Scans are converted first; the page shows the progress
    #[cfg(feature = "serve")]
    Serve(web::serve::Arguments),
    /// Write a folder with the viewer page and archives, or scans converted to them, for any web host that answers range
    /// requests
    Site(web::site::Arguments),
    /// Generate a scan, convert it, verify it, query it against brute force, draw slices
    Demo(demo::Arguments),
    /// Print completions for a shell
    Completions {
        /// Shell to print completions for
        #[arg(value_enum)]
        shell: clap_complete::Shell,
    },
    /// Write manual pages, one per command
    Man {
        /// Folder to write them to; created if it does not exist
        folder: PathBuf,
    },
}

/// Opens the archive at `path`; errors name it and, for another kind of file, say what it is.
pub fn open(path: &Path) -> Result<Archive, Failure> {
    standard::refuse_archive(path)?;
    Archive::open(path).map_err(|error| info::other_file(path).unwrap_or_else(|| broken(path, &error)))
}

/// Options that change what an archive holds: `--ignore-inferred` and `--edits`.
#[derive(clap::Args)]
pub struct Variant {
    /// Ignore floor inferred by `--fill-holes`
    #[arg(long)]
    ignore_inferred: bool,
    #[command(flatten)]
    edits: edits::EditOption,
}

impl Variant {
    /// Opens the archive at `path` as boxes and rays meet it.
    pub fn open(&self, path: &Path) -> Result<Archive, Failure> {
        self.opened(path, edits::EditFile::for_queries)
    }

    /// Opens the archive at `path` as pawns meet it: no-go areas are in their way.
    pub fn open_for_pawns(&self, path: &Path) -> Result<Archive, Failure> {
        self.opened(path, edits::EditFile::for_pawns)
    }

    fn opened(&self, path: &Path, edits: fn(&edits::EditFile) -> Edits) -> Result<Archive, Failure> {
        let archive = open(path)?;
        let archive = if self.ignore_inferred { archive.ignoring_inferred() } else { archive };
        Ok(match self.edits.read()? {
            Some(file) => archive.with_edits(edits(&file)),
            None => archive,
        })
    }

    /// The edits.
    pub fn edits(&self) -> &edits::EditOption {
        &self.edits
    }
}

/// Iterates over the pages of an archive at `path`, until a signal asks to stop.
pub fn entries<'a>(archive: &'a Archive, path: &'a Path) -> impl Iterator<Item = Result<PageEntry, Failure>> + 'a {
    archive.entries().map(move |entry| {
        go_on()?;
        entry.map_err(|error| broken(path, &error))
    })
}

/// A failure to read the archive at `path`: the library's errors name the damaged part but not the file.
pub fn broken(path: &Path, error: &slicewalk::Error) -> Failure {
    match error {
        slicewalk::Error::Format { .. } => {
            Failure::Text(format!("{}: {error}; convert the scan again, or fetch the archive again", path.display()))
        }
        slicewalk::Error::Limit { .. } => match of_library(error) {
            Failure::Text(text) => Failure::Text(format!("{}: {text}", path.display())),
            other => other,
        },
        _ => of_library(error),
    }
}

/// Begins a picture, table or export at `path`. It must not replace `archive` or the files `also`, which the command
/// reads. From now on signals only ask to stop, so that it is removed.
pub fn output(path: &Path, archive: &Archive, also: &[&Path]) -> Result<Output, Failure> {
    go_on()?;
    let mut protected: Protected = also.iter().collect();
    protected.add_source(archive.source());
    Ok(Output::create(path, OutputKind::Result, protected)?)
}

/// A failure because a cache of `cache` bytes cannot hold everything that `what` needs at once.
pub fn cache_too_small(what: &str, cache: u64, needed: usize) -> Failure {
    let needed = needed.div_ceil(1 << 10);
    Failure::Text(format!(
        "{what} needs {needed} KiB at once (the cache has {} KiB); give --cache {needed}KiB or more",
        cache >> 10
    ))
}

/// Prints a line on standard error.
pub fn say(line: &str) {
    slicewalk_terminal::say(&format!("slicetool: {line}"));
}

/// Number of the signal that asks to stop, or 0. From the first call on, a signal no longer ends the program: the work has
/// to ask.
pub fn signal() -> &'static Arc<AtomicUsize> {
    SIGNAL.get_or_init(|| {
        let signal = Arc::default();
        if let Err(error) = slicewalk_terminal::listen(&signal) {
            say(&format!("warning: cannot listen for Ctrl-C: {error}"));
        }
        signal
    })
}

static SIGNAL: OnceLock<Arc<AtomicUsize>> = OnceLock::new();

/// Returns whether a signal asks the work to stop.
fn asked() -> bool {
    SIGNAL.get().is_some_and(|signal| signal.load(Ordering::Relaxed) != 0)
}

/// Fails once a signal asks to stop.
pub fn go_on() -> slicewalk::Result<()> {
    if Quiet.cancelled() { Err(slicewalk::Error::Interrupted) } else { Ok(()) }
}

/// Monitor that shows progress on the terminal, and ends the work at a signal.
pub fn terminal() -> Terminal {
    Terminal::new("slicetool", false, suggestion, signal().clone())
}

/// Monitor that only ends the work at a signal.
pub struct Quiet;

impl Monitor for Quiet {
    fn cancelled(&self) -> bool {
        signal().load(Ordering::Relaxed) != 0
    }
}

fn main() -> ExitCode {
    let given = Arguments::command().get_matches();
    let arguments = Arguments::from_arg_matches(&given).unwrap_or_else(|error| error.exit());
    let given = given.subcommand().map(|(_, given)| given.clone()).unwrap_or_default();
    #[cfg(feature = "serve")]
    let is_server = matches!(arguments.command, Command::Serve(_));
    #[cfg(not(feature = "serve"))]
    let is_server = false;
    // Waits for servers end with a signal, too.
    let outcome = interruptible(Some(Arc::new(asked)), || match arguments.command {
        Command::Info { archives, json } => info::run(&archives, json),
        Command::Verify { archive, json } => verify::run(&archive, json),
        Command::Stats { archive, coverage: true, output, json } => coverage::run(&archive, output.as_deref(), json),
        Command::Stats { archive, json, .. } => stats::run(&archive, json),
        Command::Show(arguments) => show::run(&arguments),
        Command::Diff(arguments) => diff::run(&arguments),
        Command::Export(arguments) => export::run(&arguments, &given),
        Command::Merge(arguments) => merge::run(&arguments),
        Command::Recover(arguments) => recover::run(&arguments),
        Command::Extract(arguments) => extract::run(&arguments),
        Command::Replace(arguments) => replace::run(&arguments),
        Command::Query(arguments) => query::run(&arguments),
        Command::Walk(arguments) => walk::run(&arguments),
        Command::Reach(arguments) => reach::run(&arguments),
        Command::Route(arguments) => route::run(&arguments),
        #[cfg(feature = "serve")]
        Command::Serve(arguments) => web::serve::run(&arguments),
        Command::Site(arguments) => web::site::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Completions { shell } => manual::completions(shell),
        Command::Man { folder } => manual::write(&folder),
    });
    let (text, code) = match outcome {
        Ok(text) => (text, ExitCode::SUCCESS),
        Err(Failure::Result(text)) => (text, ExitCode::FAILURE),
        Err(Failure::Interrupted(code)) => {
            // A server ends in no other way.
            if !is_server {
                say("interrupted");
            }
            return ExitCode::from(code);
        }
        Err(Failure::Text(text)) => {
            say(&text);
            return ExitCode::FAILURE;
        }
        Err(Failure::Usage(text)) => {
            say(&text);
            return ExitCode::from(2);
        }
    };
    // A closed pipe (`slicetool query … | head`) is the reader's choice, not a failure.
    match std::io::stdout().write_all(lines(&text).as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            say(&format!("cannot write to standard output: {error}"));
            ExitCode::FAILURE
        }
        _ => code,
    }
}
