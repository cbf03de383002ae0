//! Queries against the size of the scene.

use super::Found;
use super::town::Town;
use crate::peers::measure::measure as timed;
use crate::stability::Result;
use crate::stability::table::{Table, number, spread};
use nalgebra::Vector3;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Answer, Overlap, Ray, cast, cast_batch, overlaps, overlaps_batch};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

const PIXEL_M: f64 = 0.1;
/// Points on a square metre: two a pixel, to keep files small.
const DENSITY: u64 = 200;
/// Approximate voxels per block, used only to choose sizes; the table has the true numbers.
const VOXELS_PER_BLOCK: f64 = 57_000.0;
const ASKED: usize = 20_000;
const REPEATS: usize = 5;
/// Questions of a batch, and metres of its rays.
const BATCH: usize = 100_000;
const RAY_M: f64 = 20.0;
/// Rounds of a repeat, of which the fastest counts: other work on the machine only adds.
const ROUNDS: usize = 5;

/// Asks the same of towns of 0.1 to 30 M voxels.
pub fn measure(found: &mut Found, work: &Path, quick: bool) -> Result<()> {
    let sizes = if quick { &[0.1, 1.0][..] } else { &[0.1, 0.3, 1.0, 3.0, 10.0, 30.0] };
    let mut table = Table::new([
        "voxels (M)",
        "pages",
        "in memory (MB)",
        "random: mean (ns)",
        "p50",
        "hits (%)",
        "walk: mean (ns)",
        "p50",
        "hits (%)",
    ]);
    let mut batches = Table::new([
        "in memory (MB)",
        "boxes singly (ns)",
        "as a batch",
        "times as fast (least to most)",
        "two threads",
        "rays singly (ns)",
        "as a batch",
        "times as fast (least to most)",
        "two threads",
    ]);
    for millions in sizes {
        let town = Town::new((millions * 1e6 / VOXELS_PER_BLOCK) as u64);
        table.row(one(found, work, town, &mut batches)?);
    }
    found.section(&format!(
        "## Queries against the size of the scene\n\nA box of 0.5 × 0.5 × 1.8 m, all pages in memory, pixels of 10 cm: {ASKED} \
         boxes anywhere in the town, and as many steps of a walk through it. The mean is that of all boxes asked one after the other, the best of {ROUNDS} rounds; p50 that of single boxes, the best of three, less the time of the clock. Median of {REPEATS} repeats; {DENSITY} points on a square metre.\n\n{}\n",
        table.markdown()
    ));
    found.section(&format!(
        "## Batches\n\nThe same towns: {BATCH} boxes anywhere, in random order, singly and by `overlaps_batch`; then rays of {RAY_M} m from \
         the middle of each, level, in all directions, singly and by `cast_batch`. Medians of {REPEATS} rounds, in turns; two \
         threads have half of the batch each, in times of the batch of one thread.\n\n{}\n",
        batches.markdown()
    ));
    Ok(())
}

fn one(found: &mut Found, work: &Path, town: Town, batches: &mut Table) -> Result<Vec<String>> {
    let (scan, path) = (work.join("town.las"), work.join("town.slices"));
    town.write(&scan, DENSITY)?;
    let mut options = ConvertOptions::new(vec![scan.clone()], path.clone());
    options.grid.pixel = PixelSize::Metres(PIXEL_M);
    options.overwrite = true;
    options.resources.temp_dir = work.to_owned();
    let header = convert(&options, &NoMonitor)?.header;
    let voxels = header.voxels.occupied;
    let store = Snapshot::resident(&Archive::open(&path)?, &NoMonitor)?;
    for path in [scan, path] {
        std::fs::remove_file(path)?;
    }
    let mut row = vec![
        number(voxels as f64 / 1e6, 2),
        store.page_count().to_string(),
        number((store.weight_bytes() + store.table_bytes()) as f64 / 1e6, 1),
    ];
    let walk = town.walking_pawns(&store, ASKED, 12);
    for (name, shapes) in [("random", town.random_pawns(ASKED, 11)), ("walk", walk)] {
        row.extend(ask(found, &store, voxels, name, &shapes));
    }
    let boxes = town.random_pawns(BATCH, 13);
    let mut ray = |(n, shape): (usize, &Aabb)| {
        let angle = n as f64 * 2.399_963;
        Ray::new(nalgebra::center(&shape.min(), &shape.max()), Vector3::new(angle.cos(), angle.sin(), 0.0), RAY_M)
    };
    let rays = boxes.iter().enumerate().map(&mut ray).collect::<slicewalk::Result<Vec<_>>>()?;
    let mut cells = vec![row[2].clone()];
    let answers = vec![Overlap::Clear; BATCH];
    cells.extend(batch(
        &boxes,
        answers,
        |shape| overlaps(&store, shape),
        |some, into| overlaps_batch(&store, some, into),
    ));
    let answers = vec![Answer::Known(None); BATCH];
    cells.extend(batch(&rays, answers, |ray| cast(&store, ray), |some, into| cast_batch(&store, some, into)));
    batches.row(cells);
    Ok(row)
}

/// Times of questions asked in turn, as a batch, and as a batch in two halves on two threads.
fn batch<Q: Sync, A: Send + PartialEq>(
    questions: &[Q],
    mut answers: Vec<A>,
    ask: impl Fn(&Q) -> A,
    ask_all: impl Fn(&[Q], &mut [A]) + Sync,
) -> [String; 4] {
    let [mut singles, mut together, mut ratios, mut gains] = [const { Vec::new() }; 4];
    let clock = |work: &mut dyn FnMut()| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64() * 1e9 / questions.len() as f64
    };
    for _ in 0..REPEATS {
        let one =
            clock(&mut || questions.iter().zip(&mut answers).for_each(|(question, answer)| *answer = ask(question)));
        let all = clock(&mut || ask_all(questions, &mut answers));
        let half = questions.len() / 2;
        let two = clock(&mut || {
            let (first, second) = answers.split_at_mut(half);
            std::thread::scope(|scope| {
                scope.spawn(|| ask_all(&questions[..half], first));
                ask_all(&questions[half..], second);
            });
        });
        singles.push(one);
        together.push(all);
        ratios.push(one / all);
        gains.push(all / two);
    }
    assert!(
        questions.iter().zip(&answers).all(|(question, answer)| *answer == ask(question)),
        "a batch answers the same"
    );
    let [ratio, least, most] = spread(&ratios);
    let median = |values: &[f64]| spread(values)[0];
    [
        number(median(&singles), 0),
        number(median(&together), 0),
        format!("{ratio:.2} ({least:.2} to {most:.2})"),
        number(median(&gains), 2),
    ]
}

/// Time of a box when all are asked in turn (ns).
fn all_at_once(store: &Snapshot, shapes: &[Aabb]) -> f64 {
    let start = Instant::now();
    for shape in shapes {
        black_box(overlaps(store, black_box(shape)));
    }
    start.elapsed().as_secs_f64() * 1e9 / shapes.len() as f64
}

fn ask(found: &mut Found, store: &Snapshot, voxels: u64, name: &str, shapes: &[Aabb]) -> Vec<String> {
    let [mut means, mut medians] = [const { Vec::new() }; 2];
    let mut hits = 0;
    for _ in 0..REPEATS {
        means.push((0..ROUNDS).map(|_| all_at_once(store, shapes)).fold(f64::INFINITY, f64::min));
        let measured = timed(shapes, |shape| overlaps(store, shape));
        medians.push(measured.times[1]);
        hits = measured.answers.iter().filter(|&answer| *answer == Overlap::Hit).count();
    }
    found.add("query", voxels, &format!("{name}_mean_ns"), &means);
    found.add("query", voxels, &format!("{name}_p50_ns"), &medians);
    let share = hits as f64 / shapes.len() as f64 * 100.0;
    vec![number(spread(&means)[0], 1), number(spread(&medians)[0], 0), number(share, 1)]
}
