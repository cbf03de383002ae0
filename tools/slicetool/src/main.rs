//! Looks into slice archives. Results go to standard output, diagnostics to standard error; exit code 0 done, 1 failed
//! (one line: what, where, way out), 2 usage.

mod demo;
mod diff;
mod export;
mod extract;
mod ground;
mod info;
mod merge;
mod query;
mod reach;
mod recover;
mod route;
mod show;
mod stats;
mod verify;
mod walk;
mod web;

use clap::{Parser, Subcommand};
use slicewalk::archive::Archive;
use slicewalk::output::{Output, OutputKind, Protected};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What ends a command early.
pub enum Failure {
    /// One line for standard error.
    Text(String),
    /// A result to print that nevertheless means failure, such as a list of findings.
    Result(String),
    /// A signal asked it to stop: the exit code.
    #[cfg(feature = "serve")]
    Interrupted(u8),
}

impl<E: std::error::Error> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Text(error.to_string())
    }
}

/// Text for standard output, or a failure.
pub type Outcome = Result<String, Failure>;

/// Looks into slice archives.
#[derive(Parser)]
#[command(name = "slicetool", version, max_term_width = 110)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Print what an archive says of itself
    Info {
        archive: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Check every byte of an archive and list all findings
    Verify {
        archive: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Count what the scene needed: how pages and tiles are stored, and bytes by part
    Stats {
        archive: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Draw one slice in the thesis' colours: red height, green 255, blue 255 obstacle or 26 floor, black empty
    Show(show::Arguments),
    /// Compare what two archives of one grid hold, not their bytes; exit code 0 whether they differ or not
    Diff {
        a: PathBuf,
        b: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Write one point per occupied voxel as PLY or LAS/LAZ
    Export {
        archive: PathBuf,
        /// File to write; its ending (.ply, .las, .laz) decides the format
        #[arg(short, long)]
        output: PathBuf,
    },
    /// Join the parts that `sliceconv --shard` wrote, in any order, to the very bytes of a single run
    Merge(merge::Arguments),
    /// Make an archive again from the sound pages of a damaged one
    Recover(recover::Arguments),
    /// Cut a region out of an archive; queries inside it are answered as by the whole
    Extract(extract::Arguments),
    /// Answer boxes or rays from a CSV file
    Query(query::Arguments),
    /// Walk a pawn along waypoints and write its path
    Walk(walk::Arguments),
    /// Find out where a pawn can walk, how narrow it gets, and where it leaks
    Reach(reach::Arguments),
    /// Find the shortest way of a pawn between two places
    Route(route::Arguments),
    /// Show archives in the browser: walk in them, on this machine alone, until Ctrl-C (exit code 130)
    #[cfg(feature = "serve")]
    Serve(web::serve::Arguments),
    /// Write a folder with the page and archives for any web host that answers range requests
    Site(web::site::Arguments),
    /// Generate a scan, convert it, verify, query against brute force, draw slices
    Demo(demo::Arguments),
}

/// The archive at `path`; what it breaks is told with its name.
pub fn open(path: &Path) -> Result<Archive, Failure> {
    Archive::open(path).map_err(|error| broken(path, &error))
}

/// A failure to read the archive at `path`: errors about its content name the part, but not the file.
pub fn broken(path: &Path, error: &slicewalk::Error) -> Failure {
    match error {
        slicewalk::Error::Format { .. } => {
            Failure::Text(format!("{}: {error}; convert the scan again, or fetch the archive again", path.display()))
        }
        _ => Failure::Text(error.to_string()),
    }
}

/// Begins a picture, table or export at `path`, of `archive` and of the files `also` that the command reads.
pub fn output(path: &Path, archive: &Archive, also: &[&Path]) -> Result<Output, Failure> {
    let mut protected: Protected = also.iter().collect();
    protected.add_source(archive.source());
    Ok(Output::create(path, OutputKind::Result, protected)?)
}

/// A failure to hold all that `what` needs at once in a cache of `cache` bytes.
pub fn cache_too_small(what: &str, cache: u64, needed: usize) -> Failure {
    let needed = needed.div_ceil(1 << 10);
    Failure::Text(format!(
        "{what} needs {needed} KiB at once (the cache has {} KiB); give --cache {needed}KiB or more",
        cache >> 10
    ))
}

/// Prints a line on standard error. Unlike `eprintln!` it does not panic when nobody reads there any more.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "slicetool: {line}");
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Info { archive, json } => info::run(&archive, json),
        Command::Verify { archive, json } => verify::run(&archive, json),
        Command::Stats { archive, json } => stats::run(&archive, json),
        Command::Show(arguments) => show::run(&arguments),
        Command::Diff { a, b, json } => diff::run(&a, &b, json),
        Command::Export { archive, output } => export::run(&archive, &output),
        Command::Merge(arguments) => merge::run(&arguments),
        Command::Recover(arguments) => recover::run(&arguments),
        Command::Extract(arguments) => extract::run(&arguments),
        Command::Query(arguments) => query::run(&arguments),
        Command::Walk(arguments) => walk::run(&arguments),
        Command::Reach(arguments) => reach::run(&arguments),
        Command::Route(arguments) => route::run(&arguments),
        #[cfg(feature = "serve")]
        Command::Serve(arguments) => web::serve::run(&arguments),
        Command::Site(arguments) => web::site::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
    };
    let (text, code) = match outcome {
        Ok(text) => (text, ExitCode::SUCCESS),
        Err(Failure::Result(text)) => (text, ExitCode::FAILURE),
        #[cfg(feature = "serve")]
        Err(Failure::Interrupted(code)) => return ExitCode::from(code),
        Err(Failure::Text(text)) => {
            say(&text);
            return ExitCode::FAILURE;
        }
    };
    // A closed pipe (`slicetool query … | head`) is the reader's choice, not a failure.
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            say(&format!("cannot write to standard output: {error}"));
            ExitCode::FAILURE
        }
        _ => code,
    }
}
