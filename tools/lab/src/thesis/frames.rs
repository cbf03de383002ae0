//! Frames (table 4.2) and memory at run time (figure 4.4): a pawn walks about in each model, 60 frames a second.

use super::models::Model;
use crate::Random;
use crate::measured::Conversion;
use crate::stability::Result;
use crate::stability::table::{Table, number};
use nalgebra::{Point3, Vector2};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::{Answer, Cylinder, Overlap, floor_under, overlaps};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, MoveInput, Walker};
use std::path::Path;
use std::time::Instant;

const PIXELS: f64 = 700.0;
const ROUNDS: usize = 3;
const BODY: Body = Body::Cylinder { radius: 0.25, height: 1.8 };

/// The table by name.
pub fn measure(models: &[Model], folder: &Path, quick: bool) -> Result<Vec<(&'static str, String)>> {
    let frames = if quick { 2_000 } else { 12_000 };
    let mut table = Table::new([
        "model",
        "thesis (frames per second, with and without)",
        "Slicewalk: a frame's collision, mean (µs)",
        "99.9 % below (µs)",
        "share of a frame at 60 Hz",
        "moved (m)",
        "all pages in memory (MB)",
    ]);
    for model in models {
        let path = folder.join("a.slices");
        Conversion::new(&model.path, &path, model.y_up, model.pixel(PIXELS)).measure(1)?;
        let store = Snapshot::resident(&Archive::open(&path)?, &NoMonitor)?;
        let theirs = model.thesis.map_or("-".into(), |thesis| format!("{0} and {0}", thesis.fps));
        let memory = number((store.weight_bytes() + store.table_bytes()) as f64 / 1e6, 1);
        let [mean, high, moved] = walk(&store, model, frames)?;
        table.row([
            model.name.to_owned(),
            theirs,
            number(mean, 1),
            number(high, 1),
            format!("{} %", number(mean * 60.0 / 1e4, 3)),
            number(moved, 0),
            memory,
        ]);
    }
    Ok(vec![("frames", table.markdown())])
}

/// Returns mean and 99.9th percentile of a frame (µs), and the distance walked (m). The pawn turns now and then, and
/// restarts elsewhere every ten seconds.
fn walk(store: &Snapshot, model: &Model, frames: usize) -> Result<[f64; 3]> {
    let mut times = vec![f64::INFINITY; frames];
    let mut moved = 0.0;
    // The path is equal each time, and the best of each frame counts: other work on the machine only adds.
    for _ in 0..ROUNDS {
        moved = walk_once(store, model, &mut times)?;
    }
    let mean = times.iter().sum::<f64>() / frames as f64;
    times.sort_by(f64::total_cmp);
    Ok([mean, times[(frames as f64 * 0.999) as usize - 1], moved])
}

/// One walk of as many frames as there are `times`, which are made no longer than these; returns the way walked.
fn walk_once(store: &Snapshot, model: &Model, times: &mut [f64]) -> Result<f64> {
    let mut random = Random(21);
    let config = Config { tick_s: 1.0 / 60.0, ..Config::new(BODY) };
    let mut walker = Walker::new(config, model.start.unwrap_or([0.0; 3]).into())?;
    let (mut heading, mut moved) = (0.0f64, 0.0);
    for (frame, time) in times.iter_mut().enumerate() {
        if frame % 600 == 0 {
            walker.place(stand(store, model, &mut random).ok_or("no place to stand was found")?);
        }
        if frame % 40 == 0 {
            heading = random.between(0.0, std::f64::consts::TAU);
        }
        let before = walker.feet();
        let start = Instant::now();
        walker.step(store, 1.0 / 60.0, MoveInput::Direction(Vector2::new(heading.cos(), heading.sin())));
        *time = time.min(start.elapsed().as_secs_f64() * 1e6);
        moved += (walker.feet().xy() - before.xy()).norm();
    }
    Ok(moved)
}

/// A place with a floor underfoot and room above.
fn stand(store: &Snapshot, model: &Model, random: &mut Random) -> Option<Point3<f64>> {
    (0..200_000).find_map(|_| {
        let [x, y, z] = [0, 1, 2].map(|k| random.between(model.min[k], model.max[k]));
        let sole = Cylinder::new(Point3::new(x, y, z), 0.25, 0.0).ok()?;
        let Answer::Known(Some(floor)) = floor_under(store, &sole, z, 3.0) else { return None };
        let feet = Point3::new(x, y, floor + 0.02);
        let body = Cylinder::new(feet, 0.25, 1.8).ok()?;
        (overlaps(store, &body) == Overlap::Clear).then_some(feet)
    })
}
