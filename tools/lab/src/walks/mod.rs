//! How near walks stay to the exact ones: for our response and for the thesis', beside each other; and falls through
//! storeys that are not in memory yet; and crowds.
//!
//! Out: `walks.md`. The table of paths is the same on every run.

pub mod cases;
mod crowds;
mod falls;
pub mod path;

use crate::stability::lab::{Scan, Setting};
use crate::stability::table::{Table, number};
use crate::stability::{Error, Result};
use cases::Case;
use path::Deviation;
use scangen::SampleSpec;
use slicewalk::plan::Classifier;
use slicewalk::walk::{Body, Response};
use std::path::Path;

const RESPONSES: [Response; 3] = [Response::Slide, Response::Thesis, Response::ThesisMean];
const BODIES: [(&str, Body); 2] =
    [("box", Body::Box { x: 0.5, y: 0.5, height: 1.8 }), ("cylinder", Body::Cylinder { radius: 0.25, height: 1.8 })];
/// Turns of the scenes (degrees) and, with each, noise of the scanner (m) and where the grid falls (m).
const VARIANTS: [(f64, f64, [f64; 3]); 5] = [
    (0.0, 0.0, [0.0; 3]),
    (0.0, 0.002, [0.013, 0.027, 0.041]),
    (17.0, 0.002, [0.0; 3]),
    (30.0, 0.0, [0.007, 0.0, 0.1]),
    (45.0, 0.002, [0.0, 0.031, 0.0]),
];
/// Points to a side of a pixel.
const PER_PIXEL: f64 = 3.0;

/// The worst walk of some, and how many there were.
#[derive(Debug, Clone, Copy)]
struct Worst {
    walks: usize,
    off: f64,
    /// Least and greatest share of the exact way.
    share: [f64; 2],
}

impl Worst {
    const NONE: Self = Self { walks: 0, off: 0.0, share: [f64::INFINITY, 0.0] };

    fn add(&mut self, seen: Deviation) {
        let share = [self.share[0].min(seen.share), self.share[1].max(seen.share)];
        *self = Self { walks: self.walks + 1, off: self.off.max(seen.off), share };
    }
}

impl Worst {
    fn gets_on(&self) -> String {
        let [least, most] = self.share.map(|share| number(share * 100.0, 0));
        if least == most { format!("{least} %") } else { format!("{least} to {most} %") }
    }
}

/// Measures, and writes `walks.md` into `out`.
pub fn run(out: &Path, quick: bool) -> Result<()> {
    let pixels = if quick { &[0.05][..] } else { &[0.02, 0.05, 0.1] };
    let mut page = String::from(include_str!("head.md"));
    for &pixel in pixels {
        let (table, within) = paths(pixel, if quick { 1 } else { VARIANTS.len() })?;
        page += &format!("\n## Pixels of {} cm\n\n{}\n\n{within}\n", number(pixel * 100.0, 0), table.markdown());
    }
    page += &falls::section(quick)?;
    page += &crowds::section(quick)?;
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("walks.md"), page)?;
    Ok(())
}

/// Returns the worst deviation per case, and a sentence on how many of Slicewalk's walks are within two pixels.
fn paths(pixel_m: f64, variants: usize) -> Result<(Table, String)> {
    let mut rows: Vec<(String, [Worst; 3])> = Vec::new();
    let (mut beyond, mut all) = (Vec::new(), 0);
    for (shape, body) in BODIES {
        for (turn, noise, shift) in &VARIANTS[..variants] {
            for case in cases::all(body, *turn, *shift) {
                let name = format!("{}, {shape}", case.name);
                let seen = compare(&case, pixel_m, *noise).map_err(|e| -> Error { format!("{name}: {e}").into() })?;
                all += 1;
                if seen[0].off > 2.0 * pixel_m {
                    beyond.push(format!("{name}, turned by {turn}°: {} cm", number(seen[0].off * 100.0, 1)));
                }
                if !rows.iter().any(|row| row.0 == name) {
                    rows.push((name.clone(), [Worst::NONE; 3]));
                }
                let row = rows.iter_mut().find(|row| row.0 == name).ok_or("a row just made")?;
                row.1.iter_mut().zip(seen).for_each(|(worst, seen)| worst.add(seen));
            }
        }
    }
    let mut table = Table::new([
        "in the way, pawn",
        "walks",
        "slide: off (cm)",
        "gets on",
        "thesis: off (cm)",
        "gets on",
        "thesis, mean: off (cm)",
        "gets on",
    ]);
    for (name, worst) in rows {
        let cells = worst.iter().flat_map(|worst| [number(worst.off * 100.0, 1), worst.gets_on()]);
        table.row([name, worst[0].walks.to_string()].into_iter().chain(cells));
    }
    let limit = number(200.0 * pixel_m, 0);
    let words = match beyond.len() {
        0 => format!("All {all} walks with `slide` stay within two pixels ({limit} cm) of the exact way all the time."),
        some => format!(
            "Of {all} walks with `slide`, {} stay within two pixels ({limit} cm) of the exact way all the time. The others: {}.",
            all - some,
            beyond.join("; ")
        ),
    };
    Ok((table, words))
}

/// One case with every response.
pub fn compare(case: &Case, pixel_m: f64, noise_m: f64) -> Result<[Deviation; 3]> {
    let spec = SampleSpec::direct_density((PER_PIXEL / pixel_m).powi(2)).with_noise(noise_m);
    let scan = Scan::new(case.scene.points(11, &spec)?.collect())?;
    let store = scan.convert(Setting::new(pixel_m), Classifier::Plane)?.store;
    Ok(RESPONSES.map(|response| path::walk(&store, case, response)))
}
