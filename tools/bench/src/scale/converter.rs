//! The same LAZ files through `copc_converter`, which makes trees of points out of them, and through ours.

use super::town::Town;
use super::{Found, spread};
use crate::measured::Conversion;
use crate::stability::Result;
use crate::stability::table::{Table, number};
use crate::watch::{Watched, watch};
use std::path::{Path, PathBuf};
use std::process::Command;

const RUNS: usize = 3;

/// A file, and the pixel size for it (m).
struct Case {
    name: &'static str,
    path: PathBuf,
    pixel_m: f64,
}

/// Converts a real scan, where there is one, and a generated one by both programs, in turn.
pub fn measure(found: &mut Found, work: &Path, program: Option<&Path>, quick: bool) -> Result<()> {
    let title = "## Beside `copc_converter`\n\n";
    let Some(program) = program else {
        found.section(&format!(
            "{title}Skipped: name the program by `--copc-converter` (`cargo install copc_converter`).\n"
        ));
        return Ok(());
    };
    let version = watch(Command::new(program).arg("--version"))?.said;
    let mut table = Table::new(["file", "program", "runs", "wall (s)", "processor (s)", "peak (MiB)", "out (MB)"]);
    for case in cases(work, quick)? {
        let archive = work.join("ours.slices");
        let tree = work.join("theirs.copc.laz");
        let conversion = Conversion::new(&case.path, &archive, false, case.pixel_m);
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for _ in 0..if quick { 1 } else { RUNS } {
            ours.push(conversion.watched()?.1);
            theirs.push(watch(Command::new(program).arg(&case.path).arg(&tree))?);
        }
        let ours_name = format!("ours, pixels of {} m", case.pixel_m);
        for (name, runs, out) in [(ours_name.as_str(), ours, archive), (version.trim(), theirs, tree)] {
            table.row(row(case.name, name, &runs, std::fs::metadata(&out)?.len()));
            std::fs::remove_file(out)?;
        }
    }
    found.section(&format!(
        "{title}Both with their defaults, on all threads, in turn; median of the runs. What they make differs: it keeps every point \
         and attribute in an octree, ours keeps occupied voxels with heights. Both decode all points. Memory as the \
         system tells every 5 ms.\n\n{}\n",
        table.markdown()
    ));
    Ok(())
}

fn row(file: &str, program: &str, runs: &[Watched], out: u64) -> Vec<String> {
    let median = |of: fn(&Watched) -> f64| spread(&runs.iter().map(of).collect::<Vec<_>>()).0;
    vec![
        file.to_owned(),
        program.to_owned(),
        runs.len().to_string(),
        number(median(|run| run.seconds), 2),
        number(median(|run| run.cpu_s), 2),
        number(median(|run| run.peak_bytes as f64) / f64::from(1 << 20), 0),
        number(out as f64 / 1e6, 1),
    ]
}

fn cases(work: &Path, quick: bool) -> Result<Vec<Case>> {
    let path = work.join("town.laz");
    let points = if quick { 300_000 } else { 10_000_000 };
    Town::of_points(points).write(&path, points)?;
    let mut cases = vec![Case { name: "generated town", path, pixel_m: 0.1 }];
    let shared = std::env::var_os("SLICEWALK_SHARED").map_or_else(|| "../shared".into(), PathBuf::from);
    let path = shared.join("data/autzen_stadium.laz");
    if path.exists() {
        cases.push(Case { name: "autzen", path, pixel_m: 0.25 });
    } else {
        eprintln!("autzen is left out: {} is missing", path.display());
    }
    Ok(cases)
}
