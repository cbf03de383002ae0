//! `slicetool demo`: the main job from end to end on a generated scan, with truth beside every answer.

use crate::{Failure, Outcome, show};
use scangen::{Scene, Truth};
use slicewalk::archive::Archive;
use slicewalk::convert::{ConvertOptions, PixelSize, convert};
use slicewalk::query::{Aabb, Overlap, floor_under, overlaps};
use slicewalk::store::Store;
use slicewalk::{Monitor, NoMonitor};
use std::collections::HashMap;
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Instant;

const PIXEL_M: f64 = 0.05;
const BOXES: usize = 10_000;
/// The pawn of the thesis: as wide and deep as a person, as high as one.
const PAWN: [f64; 3] = [0.5, 0.5, 1.8];
const CLIMB_M: f64 = 0.35;
/// Seed of the scan and of the boxes.
const SEED: u64 = 1;

/// Where the demonstration's files go.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder for the scan, the archive and the pictures
    #[arg(short, long, default_value = "demo-out")]
    output: PathBuf,
}

struct Warnings;

impl Monitor for Warnings {
    fn warn(&self, text: &str) {
        eprintln!("slicetool: warning: {text}");
    }
}

/// A small generator of uniform numbers in 0..1, the same everywhere.
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
    let mut table = Table::default();

    eprintln!("generating a scan of a three-storey house");
    let started = Instant::now();
    let written = scangen::demo::write_demo(&scan, SEED)?;
    table.row("scan generated", format!("{} points in {:.2} s", written.points, started.elapsed().as_secs_f64()));

    eprintln!("converting it");
    let mut options = ConvertOptions::new(vec![scan.clone()], output.clone());
    options.pixel = PixelSize::Metres(PIXEL_M);
    options.units = slicewalk::input::Units::Factor(1.0);
    options.overwrite = true;
    let started = Instant::now();
    let report = convert(&options, &Warnings)?;
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
            slicewalk::info::slice_count(header)
        ),
    );

    eprintln!("verifying every byte");
    let archive = Archive::open(&output)?;
    let mut findings = Vec::new();
    archive.verify(&NoMonitor, &mut |finding| findings.push(finding.to_string()))?;
    if let Some(finding) = findings.first() {
        return Err(Failure::Text(format!("{}: {finding}", output.display())));
    }
    table.row("verified", "every byte, no finding".into());

    let store = Store::resident(&archive, &NoMonitor)?;
    table.row(
        "in memory",
        format!(
            "{} bytes, {:.2} per voxel, heights included",
            store.weight_bytes(),
            store.weight_bytes() as f64 / header.voxels.occupied as f64
        ),
    );

    eprintln!("asking {BOXES} boxes, against brute force over the points");
    let points = Points::read(&scan)?;
    boxes(&store, &archive, &points, &mut table)?;

    eprintln!("following the stairs");
    walk(&store, &mut table)?;

    let slices = header.slices.map_or(0..=-1, |(lowest, highest)| lowest..=highest);
    let frame = *archive.frame();
    for (name, height) in [("floor", 0.02), ("knees", 0.5), ("eyes", 1.6)] {
        let slice = frame.slice_of(height);
        if slices.contains(&slice) {
            let path = dir.join(format!("slice-{name}.png"));
            show::draw(&archive, slice, &path)?;
            table.row("picture", format!("{} (z = {height} m)", path.display()));
        }
    }
    Ok(table.text)
}

#[derive(Default)]
struct Table {
    text: String,
}

impl Table {
    fn row(&mut self, name: &str, value: String) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "{name:<16} {value}");
    }
}

/// The scan's points in cells of one metre, read without any code of the library.
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
        for ((x, y), z) in all.x().zip(all.y()).zip(all.z()) {
            let point = [x, y, z];
            for axis in 0..3 {
                points.min[axis] = points.min[axis].min(point[axis]);
                points.max[axis] = points.max[axis].max(point[axis]);
            }
            points.cells.entry(Self::cell(point[0], point[1])).or_default().push(point);
        }
        Ok(points)
    }

    fn cell(x: f64, y: f64) -> (i64, i64) {
        (x.floor() as i64, y.floor() as i64)
    }

    /// Whether a point lies in the closed box.
    fn any_in(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        let ((x0, y0), (x1, y1)) = (Self::cell(min[0], min[1]), Self::cell(max[0], max[1]));
        (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (x, y))).filter_map(|cell| self.cells.get(&cell)).any(|points| {
            points.iter().any(|point| (0..3).all(|axis| min[axis] <= point[axis] && point[axis] <= max[axis]))
        })
    }
}

fn boxes(store: &Store, archive: &Archive, points: &Points, table: &mut Table) -> Result<(), Failure> {
    let frame = archive.frame();
    let grow = [frame.pixel_m(), frame.pixel_m(), frame.slice_m()];
    let mut random = Random(SEED);
    let shapes = (0..BOXES)
        .map(|_| {
            let at: [f64; 3] = std::array::from_fn(|axis| random.between(points.min[axis], points.max[axis]));
            Aabb::standing(at.into(), PAWN.into())
        })
        .collect::<Result<Vec<_>, _>>()?;
    let started = Instant::now();
    let answers: Vec<Overlap> = shapes.iter().map(|shape| overlaps(store, shape)).collect();
    let nanoseconds = started.elapsed().as_nanos() as f64 / BOXES as f64;
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

/// Follows the scene's way up the stairs: at every step the floor under the feet, and room for the body above it.
fn walk(store: &Store, table: &mut Table) -> Result<(), Failure> {
    const STEP_M: f64 = 0.05;
    let scene = Scene::demo();
    let Some(way) = scene.walk() else { return Ok(()) };
    let (mut x, mut y, mut z) = (way.start[0], way.start[1], way.start[2]);
    let (mut steps, mut blocked, mut squares, mut greatest, mut climbed) = (0u32, 0u32, 0.0, 0.0f64, 0.0);
    let started = Instant::now();
    for &[to_x, to_y] in &way.waypoints {
        let count = ((to_x - x).hypot(to_y - y) / STEP_M).ceil().max(1.0);
        let (dx, dy) = ((to_x - x) / count, (to_y - y) / count);
        for _ in 0..count as u32 {
            (x, y) = (x + dx, y + dy);
            let feet = Aabb::standing([x, y, z].into(), [0.4, 0.4, 0.0].into())?;
            let Some(floor) = floor_under(store, &feet, z + CLIMB_M, 2.0).known().flatten() else {
                return Err(Failure::Text(format!("no floor under ({x:.2}, {y:.2}, {z:.2})")));
            };
            climbed += (floor - z).max(0.0);
            z = floor;
            // The body begins where the feet can no longer step.
            let body = Aabb::standing([x, y, z + CLIMB_M].into(), [0.4, 0.4, PAWN[2] - CLIMB_M].into())?;
            blocked += u32::from(overlaps(store, &body) != Overlap::Clear);
            if let Some((truth, _)) = scene.floor_under(x, y, z + 0.05) {
                squares += (z - truth) * (z - truth);
                greatest = greatest.max((z - truth).abs());
            }
            steps += 1;
        }
    }
    let nanoseconds = started.elapsed().as_nanos() as f64 / f64::from(steps.max(1));
    table.row(
        "walk",
        format!(
            "{steps} steps up the stairs, {climbed:.2} m climbed, arrived at z = {z:.2} m (truth {:.2}), {blocked} blocked",
            way.end[2]
        ),
    );
    table.row(
        "floor heights",
        format!(
            "off by {:.1} mm (root mean square), {:.1} mm at most; {:.0} ns a step, truth included",
            1e3 * (squares / f64::from(steps.max(1))).sqrt(),
            1e3 * greatest,
            nanoseconds
        ),
    );
    Ok(())
}
