//! `bench`: measurements that write tables and plots into the repository.

use clap::{Parser, Subcommand};
use std::ffi::OsString;
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
    /// Every table and chart, in turn
    All(Common),
    /// One sweep per failure mode of such systems, with the thesis' rule and Slicewalk's
    Stability(Stability),
    /// Bytes of scans as archives, pictures and octrees, and what the scenes needed
    Size(Common),
    /// Bytes and time of coarser heights, relative to exact ones
    Lossy(Common),
    /// How near walks stay to the exact ones, and falls through storeys that are read meanwhile
    Walks(Common),
    /// Where pawns can walk: standing places, routes, leaks, and walking people removed
    Ways(bench::ways::Options),
    /// Speed beside accuracy: every method in every scene at six pixel sizes
    Chart(bench::chart::Options),
    /// The goals of speed and size, and what was found: `goals.md`, with the pages of `size` and `peers --only cubes`
    Goals(Common),
    /// Equal questions to Slicewalk and its peers: about a real scan, with the wrong answers, and about identical cubes
    Peers(Peers),
    /// Soak test: answers of a small cache, queried from four threads, beside those of all pages in memory
    Soak(Soak),
    /// The thesis' tables with Slicewalk's figures beside them; and objects against triangles
    Thesis(Common),
    /// The charts and pages of what `chart` and `scale` measured, again, without measuring
    Draw(Draw),
    /// Conversion against the size of its input, queries against the size of the scene, and a scene of great extent
    Scale(bench::scale::Scale),
    /// Reading and conversion of E57 and text: speed beside bare reading, and memory
    Inputs(bench::inputs::Inputs),
    /// One conversion, measured in a process of its own
    #[command(hide = true)]
    Measured(bench::measured::Conversion),
    /// One conversion without what moved, in a process of its own
    #[command(hide = true)]
    Moving(bench::ways::Moving),
}

#[derive(Debug, clap::Args)]
struct Peers {
    #[command(flatten)]
    common: Common,
    /// Only one of the pages
    #[arg(long)]
    only: Option<PeersPage>,
}

/// Pages of `bench peers`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PeersPage {
    /// `peers.md`: a real scan, with the wrong answers
    Scan,
    /// `cubes.md`: the same cubes in every library
    Cubes,
}

#[derive(Debug, clap::Args)]
struct Soak {
    /// How long
    #[arg(long, default_value_t = 10.0)]
    minutes: f64,
    /// Folder for `soak.md`
    #[arg(long, default_value = "tools/lab/results")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
struct Draw {
    /// Folder with `chart/measured.csv`, to write into
    #[arg(long, default_value = "tools/lab/results")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
struct Common {
    /// Small samples: a check that everything runs, in seconds
    #[arg(long)]
    quick: bool,
    /// Folder to write into [default: tools/lab/results, or target/bench-quick with --quick]
    #[arg(long)]
    out: Option<PathBuf>,
}

impl Common {
    fn out(&self) -> PathBuf {
        let default = if self.quick { "target/bench-quick" } else { "tools/lab/results" };
        self.out.clone().unwrap_or_else(|| default.into())
    }
}

#[derive(Debug, clap::Args)]
struct Stability {
    #[command(flatten)]
    common: Common,
    /// Only the sweeps whose name contains this; writes no `stability.md`
    #[arg(long)]
    only: Option<String>,
}

/// The parts of `bench all`; charts last because they draw the results of the others.
const ALL: [&[&str]; 9] = [
    &["stability"],
    &["goals"],
    &["lossy"],
    &["walks"],
    &["thesis"],
    &["peers", "--only", "scan"],
    &["scale"],
    &["inputs"],
    &["chart", "--fresh"],
];

fn run(command: Command) -> bench::stability::Result<()> {
    match command {
        Command::All(common) => ALL.into_iter().try_for_each(|part| {
            eprintln!("bench {}", part.join(" "));
            let quick = common.quick.then(|| OsString::from("--quick"));
            let out = [OsString::from("--out"), common.out().into()];
            let words = ["bench"].iter().chain(part).map(OsString::from).chain(out).chain(quick);
            run(Args::try_parse_from(words)?.command)
        }),
        Command::Stability(Stability { common, only }) => {
            bench::stability::run(&common.out(), common.quick, only.as_deref())
        }
        Command::Size(common) => bench::size::run(&common.out(), common.quick).map(|_| ()),
        Command::Goals(common) => bench::goals::run(&common.out(), common.quick),
        Command::Lossy(common) => bench::lossy::run(&common.out(), common.quick),
        Command::Chart(options) => bench::chart::run(&options),
        Command::Peers(Peers { common, only }) => {
            if only != Some(PeersPage::Cubes) {
                bench::peers::run(&common.out(), common.quick)?;
            }
            if only != Some(PeersPage::Scan) {
                bench::peers::cubes::run(&common.out(), common.quick).map(|_| ())?;
            }
            Ok(())
        }
        Command::Soak(soak) => bench::soak::run(&soak.out, soak.minutes),
        Command::Walks(common) => bench::walks::run(&common.out(), common.quick),
        Command::Ways(options) => bench::ways::run(&options),
        Command::Thesis(common) => bench::thesis::run(&common.out(), common.quick),
        Command::Draw(draw) => bench::chart::draw::run(&draw.out),
        Command::Scale(scale) => scale.run(),
        Command::Inputs(inputs) => inputs.run(),
        Command::Measured(conversion) => conversion.run(),
        Command::Moving(conversion) => conversion.run(),
    }
}

fn main() -> ExitCode {
    match run(Args::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("bench: {error}");
            ExitCode::FAILURE
        }
    }
}
