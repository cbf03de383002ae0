//! Equal LAZ files through `copc_converter`, which makes trees of points out of them, and through Slicewalk.

use super::Found;
use super::town::Town;
use crate::measured::Conversion;
use crate::stability::Result;
use crate::stability::table::{Table, number, spread};
use crate::watch::{Watched, watch};
use std::path::{Path, PathBuf};
use std::process::Command;

const RUNS: usize = 3;
/// Points on a square metre of the generated scan; ten blocks have ten million.
const DENSITY: u64 = 1600;

/// A file, and pixel sizes in its own unit: four times the spacing of its points, the default of a conversion, and
/// finer.
struct Case {
    name: &'static str,
    path: PathBuf,
    pixels: &'static [f64],
    unit: &'static str,
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
        let mut programs: Vec<(String, Vec<Watched>, &Path)> = case
            .pixels
            .iter()
            .map(|t| (format!("slicewalk, pixels of {t} {}", case.unit), Vec::new(), archive.as_path()))
            .collect();
        programs.push((version.trim().to_owned(), Vec::new(), &tree));
        let mut sizes = vec![0; programs.len()];
        for _ in 0..if quick { 1 } else { RUNS } {
            for (n, (_, runs, out)) in programs.iter_mut().enumerate() {
                runs.push(match case.pixels.get(n) {
                    Some(&pixel) => Conversion::new(&case.path, &archive, false, pixel).watched()?.1,
                    None => watch(Command::new(program).arg(&case.path).arg(&tree))?,
                });
                sizes[n] = std::fs::metadata(&out)?.len();
                std::fs::remove_file(out)?;
            }
        }
        for ((name, runs, _), size) in programs.iter().zip(sizes) {
            table.row(row(case.name, name, runs, size));
        }
    }
    found.section(&format!(
        "{title}Both with their defaults, on all threads, in turn; median of the runs. Their output differs: `copc_converter` keeps every point \
         and attribute in an octree, Slicewalk keeps occupied voxels with heights. Both decode all points. Memory as the \
         system reports it every 5 ms.\n\n{}\n",
        table.markdown()
    ));
    Ok(())
}

fn row(file: &str, program: &str, runs: &[Watched], out: u64) -> Vec<String> {
    let median = |of: fn(&Watched) -> f64| spread(&runs.iter().map(of).collect::<Vec<_>>())[0];
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
    Town::new(if quick { 1 } else { 10 }).write(&path, DENSITY)?;
    let mut cases = vec![Case { name: "generated town", path, pixels: &[0.1], unit: "m" }];
    let autzen = crate::data::file("autzen_stadium.laz");
    cases.extend(autzen.map(|path| Case { name: "autzen", path, pixels: &[3.6, 1.1], unit: "feet" }));
    Ok(cases)
}
