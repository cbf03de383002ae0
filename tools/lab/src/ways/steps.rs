//! Random steps with a guard rail: no pawn falls out of the world.

use super::routes::{converted, generated};
use super::{Effort, everywhere};
use crate::stability::Result;
use crate::stability::table::{Table, number};
use crate::{Random, data};
use nalgebra::{Point3, Vector2};
use slicewalk::plan::Up;
use slicewalk::reach::Pawn;
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, MoveInput, State, Walker};

/// Steps in one scene, and those between two starts elsewhere.
const STEPS: usize = 10_000_000;
const A_WALK: usize = 20_000;
const MAX_DROP_M: f64 = 0.35;
/// Heights are stored to a quantum (m).
const ROUNDING_M: f64 = 0.005;
const SCENES: [(&str, &[(&str, f64)]); 9] = [
    ("plane", &[("size", 8.0)]),
    ("stairs", &[]),
    ("corridor", &[]),
    ("house", &[]),
    ("hall", &[]),
    ("church", &[("bays", 4.0)]),
    ("columns", &[("size", 24.0), ("field", 12.0)]),
    ("terrain", &[("size", 30.0), ("wave", 20.0), ("height", 2.0)]),
    ("tower", &[("storeys", 5.0)]),
];

/// Results of many steps.
#[derive(Debug, Default)]
struct Walked {
    steps: usize,
    metres: f64,
    /// Deepest drop between two places on the ground (m).
    deepest: f64,
    /// Steps in the air that lead deeper than allowed below the last ground.
    fallen: usize,
    stopped: usize,
}

fn walk(store: &Snapshot, starts: &[Point3<f64>], body: Body, steps: usize) -> Result<Walked> {
    let config = Config { tick_s: 1.0 / 60.0, max_drop: Some(MAX_DROP_M), speed: 3.0, ..Config::new(body) };
    let (mut random, mut walked) = (Random(41), Walked::default());
    while walked.steps < steps {
        let start = starts[(random.bits() % starts.len() as u64) as usize];
        let mut walker = Walker::new(config, start)?;
        let (mut ground, mut heading) = (start.z, 0.0f64);
        for step in 0..A_WALK.min(steps - walked.steps) {
            if step % 40 == 0 {
                heading = random.between(0.0, std::f64::consts::TAU);
            }
            let before = walker.feet();
            let report =
                walker.step(store, 1.0 / 60.0, MoveInput::Direction(Vector2::new(heading.cos(), heading.sin())));
            walked.metres += (walker.feet() - before).norm();
            walked.stopped += usize::from(report.stop.is_some());
            let drop = ground - walker.feet().z;
            walked.fallen += usize::from(drop > MAX_DROP_M + ROUNDING_M);
            if walker.state() != State::Falling {
                walked.deepest = walked.deepest.max(drop);
                ground = walker.feet().z;
            }
        }
        walked.steps += A_WALK.min(steps - walked.steps);
    }
    Ok(walked)
}

/// Steps in each scene, as a table.
pub fn section(effort: &Effort) -> Result<String> {
    let mut table =
        Table::new(["scene", "steps (M)", "way (km)", "stopped at ledges and voids", "deepest drop (m)", "fallen"]);
    let cylinder = Body::Cylinder { radius: 0.25, height: 1.8 };
    let mut row = |name: &str, store: &Snapshot, body: Body| -> Result<()> {
        let (_, region) = everywhere(store, Pawn::new(body))?;
        let starts: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        if starts.is_empty() {
            return Err(format!("{name}: nowhere to stand").into());
        }
        let walked = walk(store, &starts, body, effort.of(STEPS, 20_000))?;
        table.row([
            name.to_owned(),
            number(walked.steps as f64 / 1e6, 2),
            number(walked.metres / 1e3, 0),
            walked.stopped.to_string(),
            number(walked.deepest, 3),
            walked.fallen.to_string(),
        ]);
        Ok(())
    };
    for (name, params) in SCENES.iter().filter(|scene| effort.takes(scene.0)) {
        row(name, &generated(name, params)?, cylinder)?;
    }
    for (name, file, up, height) in [
        ("real scan of two storeys", "indoor_two_storey_zup.laz", Up::Z, 1.6),
        ("sibenik", "meshes/sibenik.obj", Up::Y, 1.8),
        ("nav_test", "meshes/nav_test.obj", Up::Y, 1.8),
    ] {
        if effort.takes(name)
            && let Some(path) = data::file(file)
        {
            row(name, &converted(&path, up)?, Body::Box { x: 0.5, y: 0.5, height })?;
        }
    }
    Ok(format!(
        "\n## Random steps with `max_drop`\n\nTicks of 1/60 s at 3 m/s in random directions from random standing places, `max_drop` {MAX_DROP_M} m. \
         *Fallen* counts steps that end deeper than that below the last ground, and 5 mm for heights rounded outwards.\n\n{}\n",
        table.markdown()
    ))
}
