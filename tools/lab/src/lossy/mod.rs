//! Bytes and conversion times of coarser heights, relative to those of exact ones.
//!
//! Out: `lossy.md`. Bytes are the same on every run; times are ratios within one round, in which each tolerance has its turn.

use crate::stability::Result;
use crate::stability::table::{Table, number};
use slicewalk::NoMonitor;
use slicewalk::plan::Noise;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::path::Path;
use std::time::Instant;

/// Scans and pixel sizes (m).
const CASES: [(&str, f64); 6] = [
    ("pump_room", 0.02),
    ("delft_city_block_ahn3", 1.0),
    ("corridor_three_stations", 0.02),
    ("corridor_three_stations", 0.05),
    ("indoor_two_storey_zup", 0.05),
    ("isprs_csite2_town", 0.5),
];
const ROUNDS: usize = 15;

/// How far heights may be coarsened.
#[derive(Clone, Copy)]
enum Tolerance {
    Pixels(f64),
    Auto,
}

const TOLERANCES: [Tolerance; 4] =
    [Tolerance::Pixels(0.0), Tolerance::Pixels(0.25), Tolerance::Pixels(1.0), Tolerance::Auto];

/// Bytes, seconds, tolerance (m) and noise of one conversion.
fn run_once(scan: &Path, pixel_m: f64, tolerance: Tolerance, folder: &Path) -> Result<(u64, f64, f64, Option<Noise>)> {
    let mut options = ConvertOptions::new(vec![scan.to_owned()], folder.join("made.slices"));
    options.grid.pixel = PixelSize::Metres(pixel_m);
    options.overwrite = true;
    options.resources.temp_dir = folder.to_owned();
    match tolerance {
        Tolerance::Pixels(pixels) => options.plan.tolerance_m = pixels * pixel_m,
        Tolerance::Auto => options.grid.tolerance_auto = true,
    }
    let start = Instant::now();
    let report = convert(&options, &NoMonitor)?;
    let seconds = start.elapsed().as_secs_f64();
    Ok((report.header.file_len, seconds, report.header.plan.options.tolerance_m, report.noise))
}

/// Median, and the quartiles around it.
fn spread(values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    let at = |quarter: usize| number(values[(values.len() - 1) * quarter / 4], 2);
    format!("{} ({} to {})", at(2), at(1), at(3))
}

/// Measures, and writes `lossy.md` into `out`.
pub fn run(out: &Path, quick: bool) -> Result<()> {
    let folder = tempfile::tempdir()?;
    let mut table = Table::new([
        "scan",
        "t (m)",
        "bytes",
        "ms",
        "t/4: bytes",
        "time",
        "t: bytes",
        "time",
        "noise (mm)",
        "auto (mm)",
        "auto: bytes",
        "time",
    ]);
    let (cases, rounds) = if quick { (2, 3) } else { (CASES.len(), ROUNDS) };
    for (name, pixel_m) in &CASES[..cases] {
        let Some(scan) = crate::data::file(&format!("{name}.laz")) else { continue };
        eprintln!("{name} at {pixel_m} m");
        let mut bytes = [0u64; TOLERANCES.len()];
        let mut ratios = vec![Vec::new(); TOLERANCES.len()];
        let mut exact = Vec::new();
        let mut auto = (0.0, Noise::default());
        for round in 0..=rounds {
            let mut seconds = [0.0; TOLERANCES.len()];
            for (number, tolerance) in TOLERANCES.into_iter().enumerate() {
                let (made, took, tolerance_m, noise) = run_once(&scan, *pixel_m, tolerance, folder.path())?;
                (bytes[number], seconds[number]) = (made, took);
                noise.inspect(|noise| auto = (tolerance_m, *noise));
            }
            // The first round warms up.
            if round > 0 {
                exact.push(seconds[0] * 1e3);
                ratios.iter_mut().zip(seconds).for_each(|(ratios, took)| ratios.push(took / seconds[0]));
            }
        }
        let share = |at: usize| number(bytes[at] as f64 / bytes[0] as f64, 3);
        table.row([
            (*name).to_owned(),
            number(*pixel_m, 2),
            bytes[0].to_string(),
            spread(&mut exact),
            share(1),
            spread(&mut ratios[1]),
            share(2),
            spread(&mut ratios[2]),
            number(auto.1.noise_m * 1e3, 2),
            number(auto.0 * 1e3, 2),
            share(3),
            spread(&mut ratios[3]),
        ]);
    }
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("lossy.md"), format!("{}\n\n{}\n", include_str!("head.md").trim_end(), table.markdown()))?;
    Ok(())
}
