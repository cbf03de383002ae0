//! Holes in floors: each cut hole must be listed, and no other.

use super::{Effort, known, reached, spot};
use crate::Random;
use crate::stability::Result;
use crate::stability::lab::{Scan, Setting};
use crate::stability::table::Table;
use scangen::sample::{Mode, Order};
use scangen::scene::build::{Builder, Wall};
use scangen::{Sample, SampleSpec, Scene};
use slicewalk::plan::Classifier;
use slicewalk::reach::{LeakKind, LeakSearch, Pawn, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;

/// Pixel size (m), noise (m), and size of the room (m).
const PIXEL_M: f64 = 0.05;
const NOISE_M: f64 = 0.002;
const ROOM: [f64; 2] = [14.0, 10.0];
/// Between holes, and to the walls (m).
const APART_M: f64 = 1.2;

type Rect = [f64; 4];

/// Rectangles of random sizes that keep apart.
fn rects(random: &mut Random, most: usize, taken: &[Rect]) -> Vec<Rect> {
    let mut rects: Vec<Rect> = Vec::new();
    for _ in 0..40 * most {
        let size = [0, 1].map(|_| random.between(0.6, 1.6));
        let at = [0, 1].map(|axis| random.between(APART_M, ROOM[axis] - APART_M - size[axis]));
        let rect = [at[0], at[1], at[0] + size[0], at[1] + size[1]];
        let apart = |other: &Rect| {
            (0..2).any(|axis| rect[axis] > other[axis + 2] + APART_M || other[axis] > rect[axis + 2] + APART_M)
        };
        let is_start = rect[0] < 2.4 && rect[1] < 2.4;
        if !is_start && rects.iter().chain(taken).all(apart) {
            rects.push(rect);
        }
        if rects.len() == most {
            break;
        }
    }
    rects
}

/// Floor under the holes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Below {
    Nothing,
    Floor,
}

/// A room with boxes in it and rectangular holes in its floor.
fn room(holes: &[Rect], boxes: &[Rect], below: Below) -> Scene {
    let [l, w] = ROOM;
    let mut build = Builder::new();
    build.level("floor", [0.0, 0.0, l, w], 0.0, holes);
    if below == Below::Floor {
        build.level("floor", [0.0, 0.0, l, w], -1.5, &[]);
    }
    let z = [if below == Below::Floor { -1.5 } else { 0.0 }, 2.8];
    for (from, to) in [([0.0, 0.0], [l, 0.0]), ([l, 0.0], [l, w]), ([l, w], [0.0, w]), ([0.0, w], [0.0, 0.0])] {
        build.wall(Wall { from, to, thickness: 0.0, z }, &[]);
    }
    for [x0, y0, x1, y1] in boxes {
        build.open_cuboid("box", [*x0, *y0, 0.0], [*x1, *y1, 0.9]);
    }
    build.finish("room")
}

fn store(samples: Vec<Sample>) -> Result<Snapshot> {
    let scan = Scan::new(samples.iter().map(|sample| sample.position).collect())?;
    Ok(scan.convert(Setting::new(PIXEL_M), Classifier::Plane)?.store)
}

fn spec() -> SampleSpec {
    let even = SampleSpec::direct_density((3.0 / PIXEL_M).powi(2)).with_noise(NOISE_M);
    SampleSpec { mode: Mode::Direct(Order::Grid), ..even }
}

/// Middles of all leaks of a pawn that starts at a place, with their kinds.
fn leaks(store: &Snapshot, pawn: Pawn, from: [f64; 3]) -> Result<Vec<([f64; 3], LeakKind)>> {
    let mut standing = StandingPlaces::new(store, pawn)?;
    let start = spot(store, &mut standing, from)?.ok_or("no place to start")?;
    let region = reached(store, &mut standing, start)?;
    let leaks = known(LeakSearch::new(&region).find(&mut standing, store)?)?;
    Ok(leaks.iter().map(|leak| (leak.at.into(), leak.kind)).collect())
}

/// Random rooms with and without holes, and closed scenes of `scangen`.
pub fn page(effort: &Effort) -> Result<String> {
    let mut table = Table::new(["rooms", "pawn", "holes cut", "listed as holes at their place", "listed beside them"]);
    let mut strange = Vec::new();
    for (what, below, cut) in [
        ("nothing scanned below", Below::Nothing, 8),
        ("a floor 1.5 m below", Below::Floor, 8),
        ("no holes", Below::Nothing, 0),
        ("no holes, a floor 1.5 m below", Below::Floor, 0),
    ] {
        for body in [Body::Box { x: 0.5, y: 0.5, height: 1.8 }, Body::Cylinder { radius: 0.25, height: 1.8 }] {
            let mut random = Random(31);
            let (mut all, mut listed, mut beside) = (0, 0, 0);
            for seed in 0..effort.of(50, 3) as u64 {
                let holes = rects(&mut random, cut, &[]);
                let boxes = rects(&mut random, 6, &holes);
                let scene = room(&holes, &boxes, below);
                let store = store(scene.samples(seed, &spec())?.collect())?;
                let found = leaks(&store, Pawn::new(body), [0.8, 0.8, 0.1])?;
                all += holes.len();
                let is_in = |[x, y, _]: [f64; 3], rect: &Rect| rect[0] < x && x < rect[2] && rect[1] < y && y < rect[3];
                for hole in &holes {
                    let mut own = found.iter().filter(|leak| is_in(leak.0, hole));
                    listed += usize::from(own.next().is_some_and(|leak| leak.1 == LeakKind::Hole));
                }
                // The tops of the boxes are ledges only to who stands on them.
                let others: Vec<_> =
                    found.iter().filter(|leak| !holes.iter().any(|hole| is_in(leak.0, hole))).collect();
                beside += others.len();
                strange.extend(others.iter().map(|leak| format!("{what}, room {seed}: {leak:?}")));
            }
            let pawn = if matches!(body, Body::Box { .. }) { "box" } else { "cylinder" };
            table.row([what.to_owned(), pawn.into(), all.to_string(), listed.to_string(), beside.to_string()]);
        }
    }
    for line in strange.iter().take(12) {
        eprintln!("{line}");
    }
    Ok(format!("{}\n{}\n", include_str!("holes.head.md"), table.markdown()))
}
