//! Routes across a city that does not fit in memory: coarse ones from the overview levels, and exact ones, from a cold cache.
//!
//! Each route is a run of `slicetool` of its own, so the reported memory is all memory of the process.

use super::Effort;
use crate::Random;
use crate::stability::Result;
use crate::stability::table::{Table, number};
use crate::watch::watch;
use scangen::sample::{Mode, Order};
use scangen::{Params, SampleSpec, Scene, Truth, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::path::{Path, PathBuf};
use std::process::Command;

const PIXEL_M: f64 = 0.05;
/// Memory for pages.
const CACHE: &str = "16MiB";

/// The program beside this one.
fn slicetool() -> Result<PathBuf> {
    let path = std::env::current_exe()?.with_file_name("slicetool");
    if path.is_file() {
        Ok(path)
    } else {
        Err(format!("{}: build it first, in the same profile", path.display()).into())
    }
}

/// The city as an archive with overview levels.
fn city(folder: &Path, quick: bool) -> Result<(PathBuf, Scene)> {
    let params = Params::new();
    let params = if quick { params.with("width", 240.0).with("depth", 180.0).with("height", 60.0) } else { params };
    let scene = Scene::named("extent", &params)?;
    let (scan, path) = (folder.join("extent.las"), folder.join("extent.slices"));
    let even = SampleSpec::direct_density(PIXEL_M.powi(-2)).with_noise(0.002);
    let spec = SampleSpec { mode: Mode::Direct(Order::Grid), ..even };
    write_samples(&scan, scene.samples(1, &spec)?, &WriteSpec::default())?;
    let mut options = ConvertOptions::new(vec![scan.clone()], path.clone());
    options.grid.pixel = PixelSize::Metres(PIXEL_M);
    options.reading.units = Units::Factor(1.0);
    options.resources.temp_dir = folder.into();
    options.sections.levels = true;
    convert(&options, &NoMonitor)?;
    std::fs::remove_file(scan)?;
    Ok((path, scene))
}

/// One run: what it found, how long it took by its own clock (s), and its greatest memory (MiB).
fn run(archive: &Path, ends: [[f64; 3]; 2], coarse: bool) -> Result<(Option<f64>, f64, f64, f64)> {
    let place = |[x, y, z]: [f64; 3]| format!("{x},{y},{z}");
    let mut command = Command::new(slicetool()?);
    command.arg("route").arg(archive).args(["--json", "--cache", CACHE]);
    command.arg(format!("--from={}", place(ends[0]))).arg(format!("--to={}", place(ends[1])));
    command.args(coarse.then_some("--coarse"));
    let watched = watch(&mut command)?;
    let value = |key: &str| {
        let line = watched.said.lines().find(|line| line.contains(&format!("\"{key}\"")))?;
        line.split(':').nth(1)?.trim().trim_end_matches(',').parse::<f64>().ok()
    };
    let seconds = value("seconds").ok_or_else(|| format!("slicetool said {:?}", watched.said))?;
    Ok((value("length_m"), seconds, watched.peak_bytes as f64 / f64::from(1 << 20), watched.cpu_s))
}

/// The table, as a page.
pub fn page(effort: &Effort) -> Result<String> {
    let folder = tempfile::tempdir()?;
    let (archive, scene) = city(folder.path(), effort.quick)?;
    let size = scene.bounds().max;
    let mut random = Random(61);
    let mut pairs = vec![[[2.0, 1.0, 0.1], [size[0] - 2.0, size[1] - 1.0, 0.1]]];
    while pairs.len() < effort.of(20, 2) {
        let mut place = || {
            loop {
                let [x, y] = [0, 1].map(|axis| random.between(1.0, size[axis] - 1.0));
                // In a street, with room around.
                if scene.distance_to_box([x - 1.0, y - 1.0, 0.1], [x + 1.0, y + 1.0, 2.0]) > 0.0
                    && scene.ceiling_above(x, y, 0.1).is_none()
                {
                    return [x, y, 0.1];
                }
            }
        };
        pairs.push([place(), place()]);
    }
    let mut table = Table::new([
        "from, to (m)",
        "straight (m)",
        "coarse: length (m)",
        "time (ms)",
        "peak (MiB)",
        "exact: length (m)",
        "time (s)",
        "processor time (s)",
        "peak (MiB)",
    ]);
    for ends in pairs {
        let straight = (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1]);
        let coarse = run(&archive, ends, true)?;
        let exact = run(&archive, ends, false)?;
        let length = |length: Option<f64>| length.map_or("none".into(), |length| number(length, 1));
        let place = |[x, y, _]: [f64; 3]| format!("{x:.0}, {y:.0}");
        table.row([
            format!("{} → {}", place(ends[0]), place(ends[1])),
            number(straight, 0),
            length(coarse.0),
            number(coarse.1 * 1e3, 0),
            number(coarse.2, 0),
            length(exact.0),
            number(exact.1, 2),
            number(exact.3, 2),
            number(exact.2, 0),
        ]);
    }
    Ok(format!("{}\n{}\n", include_str!("city.head.md"), table.markdown()))
}
