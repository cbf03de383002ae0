//! `counts`: instructions of the hot paths beside the committed ones; needs Valgrind. A program of its own, so that it can be
//! built without the peers: `.ci/counts`.

use bench::counts::{Counts, paths::Calls};
use clap::Parser;
use std::process::ExitCode;

/// Counts the instructions of the hot paths, and compares them with the committed ones
#[derive(Debug, Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
struct Args {
    #[command(flatten)]
    counts: Counts,
    #[command(subcommand)]
    called: Option<Called>,
}

#[derive(Debug, clap::Subcommand)]
enum Called {
    /// The hot paths, called for callgrind
    #[command(hide = true)]
    Counted(Calls),
}

fn main() -> ExitCode {
    let Args { counts, called } = Args::parse();
    let done = match called {
        None => counts.run(),
        Some(Called::Counted(calls)) => calls.run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("counts: {error}");
            ExitCode::FAILURE
        }
    }
}
