//! Scope and effort of a run.

use super::cell::Effort;
use super::subject::NAMES;
use crate::stability::Result;
use std::path::PathBuf;
use std::time::Duration;

/// Pixel sizes (cm), from coarse to fine, so that the cost of a finer one can be predicted.
const PIXELS_CM: [u32; 6] = [32, 16, 8, 4, 2, 1];
/// Options of the measurement.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// Small samples of three scenes: a check that everything runs
    #[arg(long)]
    pub quick: bool,
    /// Folder to write `chart/` into [default: tools/lab/results, or target/bench-quick with --quick]
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Only this scene
    #[arg(long, value_name = "SCENE")]
    pub only: Option<String>,
    /// Seconds that a method may take to build one cell
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0)]
    pub budget: f64,
    /// Starts over instead of resuming
    #[arg(long)]
    pub fresh: bool,
}

/// How large a run is.
pub(super) struct Plan {
    pub scenes: Vec<&'static str>,
    pub pixels_cm: Vec<u32>,
    pub points: Option<usize>,
    pub effort: Effort,
    pub budget_s: f64,
}

impl Options {
    /// The folder of the results.
    pub(super) fn folder(&self) -> PathBuf {
        let default = if self.quick { "target/bench-quick" } else { "tools/lab/results" };
        self.out.clone().unwrap_or_else(|| default.into())
    }
}

impl Plan {
    pub fn new(options: &Options) -> Result<Self> {
        let of = |full, quick| if options.quick { quick } else { full };
        let effort = Effort {
            questions: of(4000, 400),
            repeats: of(3, 2),
            places: of(20_000, 2000),
            grazing: of(100, 10),
            round: Duration::from_millis(of(100, 10) as u64),
            builds: Duration::from_millis(of(1500, 100) as u64),
        };
        let scenes: Vec<_> = match &options.only {
            Some(only) => vec![known(only)?],
            None if options.quick => vec!["house", "delft", "sibenik"],
            None => NAMES.to_vec(),
        };
        let pixels_cm = if options.quick { vec![32, 8] } else { PIXELS_CM.to_vec() };
        Ok(Self { scenes, pixels_cm, points: options.quick.then_some(40_000), effort, budget_s: options.budget })
    }
}

/// A scene that there is.
fn known(name: &str) -> Result<&'static str> {
    let wrong = || format!("--only {name}: no such scene; there are {}", NAMES.join(", "));
    Ok(NAMES.into_iter().find(|known| *known == name).ok_or_else(wrong)?)
}
