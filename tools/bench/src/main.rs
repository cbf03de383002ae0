//! `bench`: measurements that write tables and plots into the repository.

use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// Measures slicewalk and writes what it finds as CSV, SVG and Markdown.
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// One sweep per way in which such systems fail, for the thesis' rule and for ours
    Stability(Stability),
}

#[derive(Debug, clap::Args)]
struct Stability {
    /// Small samples: a check that everything runs, in seconds
    #[arg(long)]
    quick: bool,
    /// Folder for `stability.md` and `stability/` [default: tools/bench/results, or target/bench-quick with --quick]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Only the sweeps whose name contains this; writes no `stability.md`
    #[arg(long)]
    only: Option<String>,
}

fn main() -> ExitCode {
    let Args { command: Command::Stability(args) } = Args::parse();
    let default = if args.quick { "target/bench-quick" } else { "tools/bench/results" };
    let out = args.out.unwrap_or_else(|| default.into());
    match bench::stability::run(&out, args.quick, args.only.as_deref()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("bench: {error}");
            ExitCode::FAILURE
        }
    }
}
