//! `slicetool demo`: runs the main job from end to end on a generated scan and prints the true value beside every
//! answer.

use crate::{Failure, Outcome, Quiet, show};
use scangen::{Scene, Truth};
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Config, State, Walker, Waypoints};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::collections::HashMap;
use std::fmt::Write;
use std::hint::black_box;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;

const PIXEL_M: f64 = 0.05;
const BOXES: usize = 10_000;
/// Rounds of timing.
const ROUNDS: usize = 5;
/// The pawn of the thesis, a box of a person's size.
const PAWN: [f64; 3] = [0.5, 0.5, 1.8];
/// LAS class of the points that the generator marks as noise: readings that mix an edge with what is behind it. They
/// float in the air and would stop a pawn.
const NOISE_CLASS: u8 = 7;
/// Seed of the scan and of the boxes.
const SEED: u64 = 1;

/// Options of `slicetool demo`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder for the scan, the archive and the pictures
    #[arg(short, long, default_value = "demo-out")]
    output: PathBuf,
}

/// A small generator of uniform numbers in 0..1, the same on every platform.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + self.uniform() * (high - low)
    }
}

/// Runs the demonstration and returns its table.
pub fn run(arguments: &Arguments) -> Outcome {
    let dir = &arguments.output;
    std::fs::create_dir_all(dir).map_err(|e| Failure::Text(format!("{}: cannot create: {e}", dir.display())))?;
    let (scan, output) = (dir.join("house.laz"), dir.join("house.slices"));
    // Without its scan, the archive is that of another one.
    let other = match scan.exists() {
        true => (!is_generated(&scan)?).then_some(&scan),
        false => output.symlink_metadata().is_ok().then_some(&output),
    };
    if let Some(other) = other {
        let reason = "exists and was not written by the demonstration, so it is not replaced; choose another folder";
        return Err(Failure::Text(format!("{}: {reason}", other.display())));
    }
    let mut table = Table::default();

    crate::say("generating a scan of a three-storey house");
    let started = Instant::now();
    let written = scangen::demo::write_demo(&scan, SEED)?;
    table.row("scan generated", format!("{} points in {:.2} s", written.points, started.elapsed().as_secs_f64()));

    crate::say("converting it");
    let mut options = ConvertOptions::new(vec![scan.clone()], output.clone());
    options.grid.pixel = PixelSize::Metres(PIXEL_M);
    options.reading.units = slicewalk_input::Units::Factor(1.0);
    options.overwrite = true;
    options.plan.exclude_classes.insert(NOISE_CLASS);
    let started = Instant::now();
    let report = convert(&options, &crate::terminal())?;
    let seconds = started.elapsed().as_secs_f64();
    let header = &report.header;
    let laz_bytes = std::fs::metadata(&scan)?.len();
    table.row("converted", format!("{seconds:.2} s, {:.1} M points/s", header.points_read as f64 / seconds / 1e6));
    table.row(
        "archive",
        format!(
            "{} bytes, 1/{:.0} of the LAZ; {} voxels of {PIXEL_M} m ({} obstacle), {} slices",
            header.file_len,
            laz_bytes as f64 / header.file_len as f64,
            header.voxels.occupied,
            header.voxels.obstacle,
            slicewalk_convert::info::slice_count(header)
        ),
    );

    crate::say("verifying every byte");
    let archive = Archive::open(&output)?;
    let mut findings = Vec::new();
    archive.verify(&Quiet, &mut |finding| findings.push(finding.to_string()))?;
    if let Some(finding) = findings.first() {
        return Err(Failure::Text(format!("{}: {finding}", output.display())));
    }
    table.row("verified", "every byte, no finding".into());

    let store = Snapshot::resident(&archive, &Quiet)?;
    table.row(
        "in memory",
        format!(
            "{} bytes, {:.2} per voxel, heights included",
            store.weight_bytes(),
            store.weight_bytes() as f64 / header.voxels.occupied as f64
        ),
    );

    crate::say(&format!("asking {BOXES} boxes, against brute force over the points"));
    let points = Points::read(&scan)?;
    boxes(&store, &archive, &points, &mut table)?;

    crate::say("walking up the stairs");
    walk(&store, &mut table)?;

    let frame = *archive.frame();
    for (name, height) in [("floor", 0.02), ("knees", 0.5), ("eyes", 1.6)] {
        let slice = frame.slice_of(height);
        if header.slices.is_some_and(|(lowest, highest)| (lowest..=highest).contains(&slice)) {
            let path = dir.join(format!("slice-{name}.png"));
            show::draw(&archive, &output, slice, show::Look::Legend, &path)?;
            table.row("picture", format!("{} (z = {height} m)", path.display()));
        }
    }
    table.row("walk in it", format!("slicetool serve {} --open", output.display()));
    Ok(table.text)
}

/// Returns whether the scan's header names `scangen` as generating software (bytes 58 to 89 of the LAS header).
fn is_generated(scan: &Path) -> Result<bool, Failure> {
    let mut header = Vec::new();
    std::fs::File::open(scan)?.take(90).read_to_end(&mut header)?;
    Ok(header.get(58..).is_some_and(|software| software.starts_with(b"scangen")))
}

#[derive(Default)]
struct Table {
    text: String,
}

impl Table {
    fn row(&mut self, name: &str, value: String) {
        // Writing to a string never fails.
        let _ = writeln!(self.text, "{name:<16} {value}");
    }
}

/// The scan's points in cells of one metre, read without code of the library.
struct Points {
    cells: HashMap<(i64, i64), Vec<[f64; 3]>>,
    min: [f64; 3],
    max: [f64; 3],
}

impl Points {
    fn read(path: &std::path::Path) -> Result<Self, Failure> {
        let mut points = Self { cells: HashMap::new(), min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };
        let mut reader = las::Reader::from_path(path)?;
        let all = reader.read_all()?;
        for (((x, y), z), class) in all.x().zip(all.y()).zip(all.z()).zip(all.classification()) {
            if class == NOISE_CLASS {
                continue;
            }
            let point = [x, y, z];
            points.min = std::array::from_fn(|axis| points.min[axis].min(point[axis]));
            points.max = std::array::from_fn(|axis| points.max[axis].max(point[axis]));
            points.cells.entry(Self::cell(point[0], point[1])).or_default().push(point);
        }
        Ok(points)
    }

    fn cell(x: f64, y: f64) -> (i64, i64) {
        (x.floor() as i64, y.floor() as i64)
    }

    /// Returns whether a point is in the closed box.
    fn any_in(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        let ((x0, y0), (x1, y1)) = (Self::cell(min[0], min[1]), Self::cell(max[0], max[1]));
        (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (x, y))).filter_map(|cell| self.cells.get(&cell)).any(|points| {
            points.iter().any(|point| (0..3).all(|axis| min[axis] <= point[axis] && point[axis] <= max[axis]))
        })
    }
}

fn boxes(store: &Snapshot, archive: &Archive, points: &Points, table: &mut Table) -> Result<(), Failure> {
    let frame = archive.frame();
    let grow = [frame.pixel_m(), frame.pixel_m(), frame.slice_m()];
    let mut random = Random(SEED);
    let shapes = (0..BOXES)
        .map(|_| {
            let at: [f64; 3] = std::array::from_fn(|axis| random.between(points.min[axis], points.max[axis]));
            Aabb::standing(at.into(), PAWN.into())
        })
        .collect::<Result<Vec<_>, _>>()?;
    let answers: Vec<Overlap> = shapes.iter().map(|shape| overlaps(store, shape)).collect();
    // Warm, as in a game that queries constantly; best of several rounds, because other programs use the machine too.
    let round = |_| {
        let started = Instant::now();
        for shape in &shapes {
            black_box(overlaps(store, shape));
        }
        started.elapsed().as_nanos() as f64 / BOXES as f64
    };
    let nanoseconds = (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min);
    let (mut hits, mut misses, mut phantoms, mut near) = (0, 0, 0, 0);
    for (shape, answer) in shapes.iter().zip(&answers) {
        let (min, max): ([f64; 3], [f64; 3]) = (shape.min().into(), shape.max().into());
        let hit = *answer == Overlap::Hit;
        hits += u32::from(hit);
        let truth = points.any_in(min, max);
        misses += u32::from(truth && !hit);
        if hit && !truth {
            let grown: [[f64; 3]; 2] = [
                std::array::from_fn(|axis| min[axis] - grow[axis]),
                std::array::from_fn(|axis| max[axis] + grow[axis]),
            ];
            if points.any_in(grown[0], grown[1]) {
                near += 1;
            } else {
                phantoms += 1;
            }
        }
    }
    table.row("pawn boxes", format!("{BOXES} at random, {nanoseconds:.0} ns each, {hits} hits"));
    table.row(
        "against points",
        format!("{misses} misses, {phantoms} phantoms; {near} hits within one voxel of a point but without one"),
    );
    if misses + phantoms > 0 {
        return Err(Failure::Text(format!("{misses} misses and {phantoms} phantoms: guarantees G1 and G2 are broken")));
    }
    Ok(())
}

/// Walks a pawn along the scene's route from the ground floor up the stairs to the top.
fn walk(store: &Snapshot, table: &mut Table) -> Result<(), Failure> {
    const HZ: f64 = 60.0;
    /// Half the pawn, plus the pixels by which its footprint is rounded.
    const REACH: f64 = PAWN[0] / 2.0 + 1.5 * PIXEL_M;
    let scene = Scene::demo();
    let Some(way) = scene.walk() else { return Ok(()) };
    let mut pawn = Walker::new(Config::default(), way.start.into())?;
    let mut route = Waypoints::new(way.waypoints.iter().map(|&place| place.into()).collect())?;
    let mut frame_us = Vec::new();
    // The true height of the feet is unambiguous only where the whole footprint is on one level floor.
    let (mut level, mut squares, mut greatest) = (0u32, 0.0, 0.0f64);
    let mut blocked = 0;
    while pawn.state() != State::Arrived && blocked < 2 * HZ as usize && frame_us.len() < 300 * HZ as usize {
        let started = Instant::now();
        pawn.follow(store, 1.0 / HZ, &mut route);
        frame_us.push(started.elapsed().as_secs_f64() * 1e6);
        blocked = if pawn.state() == State::Blocked { blocked + 1 } else { 0 };
        let feet = pawn.feet();
        let floors = [(-REACH, -REACH), (-REACH, REACH), (REACH, -REACH), (REACH, REACH), (0.0, 0.0)]
            .map(|(dx, dy)| scene.floor_under(feet.x + dx, feet.y + dy, feet.z + 0.2).map(|(height, _)| height));
        if let Some(truth) = floors[0].filter(|_| floors.iter().all(|floor| *floor == floors[0])) {
            level += 1;
            squares += (feet.z - truth) * (feet.z - truth);
            greatest = greatest.max((feet.z - truth).abs());
        }
    }
    let (feet, state) = (pawn.feet(), pawn.state().name());
    if pawn.state() != State::Arrived {
        return Err(Failure::Text(format!("the pawn is {state} at {feet:.2}, though the way is free")));
    }
    frame_us.sort_by(f64::total_cmp);
    let at = |share: f64| frame_us[((frame_us.len() - 1) as f64 * share) as usize];
    table.row(
        "walk",
        format!(
            "up the stairs in {:.1} s of its time, {state} at z = {:.2} m (truth {:.2})",
            frame_us.len() as f64 / HZ,
            feet.z,
            way.end[2]
        ),
    );
    table.row(
        "frames",
        format!("{:.1} µs (median), {:.1} µs (99 %) at {HZ:.0} a second, four ticks each", at(0.5), at(0.99)),
    );
    table.row(
        "feet on floors",
        format!(
            "{:.1} mm above the true floor (root mean square over {level} frames), {:.1} mm at most; noise is 3 mm",
            1e3 * (squares / f64::from(level.max(1))).sqrt(),
            1e3 * greatest
        ),
    );
    Ok(())
}
