//! Walking people removed: how many of their points go, how many of what stands, and what that takes.

use super::Effort;
use super::sight::{Eye, RayBound, best};
use crate::stability::Result;
use crate::stability::table::{Share, Table, number, percent};
use crate::thesis::models::read_scan;
use crate::watch::{Watched, watch};
use scangen::sample::{Mode, ScannerSpec};
use scangen::{Kind, Params, Sample, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::collections::{BTreeMap, HashSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

const PIXEL_M: f64 = 0.05;
const NOISE_M: f64 = 0.003;
const SEED: u64 = 1;
/// Edge of the cells that connect points on people (m).
const PART_CELL_M: f64 = 0.1;
/// Rays of each station in the tables of accuracy.
const RAYS: usize = 300_000;
/// All points of the large scan.
const MANY: usize = 100_000_000;

/// One conversion of a folder of scans, with or without what moved.
#[derive(Debug, Clone, clap::Args)]
pub struct Moving {
    /// Folder with scans; the table of stations is `stations.csv`
    folder: PathBuf,
    /// Whether to remove what moved
    #[arg(long)]
    remove: bool,
    /// Memory budget (bytes)
    #[arg(long)]
    memory: u64,
}

impl Moving {
    /// Converts, and prints what a parent process reads.
    pub fn run(&self) -> Result<()> {
        let report = convert(&self.options()?, &NoMonitor)?;
        println!("{}", report.points_moving);
        Ok(())
    }

    fn options(&self) -> Result<ConvertOptions> {
        let mut scans: Vec<PathBuf> = std::fs::read_dir(&self.folder)?
            .map(|entry| entry.map(|entry| entry.path()))
            .collect::<std::io::Result<_>>()?;
        scans.retain(|path| path.extension().is_some_and(|ending| ending == "las") && !path.ends_with("removed.las"));
        scans.sort();
        let mut options = ConvertOptions::new(scans, self.folder.join("out.slices"));
        options.grid.pixel = PixelSize::Metres(PIXEL_M);
        options.reading.units = Units::Factor(1.0);
        options.resources.memory_bytes = self.memory;
        options.resources.temp_dir = self.folder.clone();
        options.overwrite = true;
        if self.remove {
            options.plan.remove_moving = true;
            options.stations = Some(self.folder.join("stations.csv"));
            options.removed = Some(self.folder.join("removed.las"));
        }
        Ok(options)
    }

    /// In a process of its own.
    fn watched(&self) -> Result<Watched> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("moving").arg(&self.folder).arg(format!("--memory={}", self.memory));
        command.args(self.remove.then_some("--remove"));
        watch(&mut command)
    }
}

/// Sampling of one station, which writes a file of its own.
fn station_spec(station: [f64; 3], rays: usize, people: usize) -> SampleSpec {
    let scanner = ScannerSpec { stations: vec![station], people, clearance_m: 0.15, ..ScannerSpec::default() };
    SampleSpec { mode: Mode::Scanner(scanner), ..SampleSpec::scanner(rays as u64) }.with_noise(NOISE_M)
}

/// A scene with people, a file for each station, and the truth of each point as it lies in its file.
fn scans(scene: &Scene, rays: usize, people: usize, seed: u64, folder: &Path, keep: bool) -> Result<Vec<Sample>> {
    let (mut table, mut all) = (String::from("file,x,y,z\n"), Vec::new());
    for (number, station) in scene.stations().iter().enumerate() {
        let spec = station_spec(*station, rays, people);
        let path = folder.join(format!("{number}.las"));
        let write = WriteSpec::for_path(&path);
        let samples = scene.samples(seed + number as u64, &spec)?;
        if keep {
            let samples: Vec<Sample> = samples.collect();
            write_samples(&path, samples.iter().copied(), &write)?;
            for sample in samples {
                let position = write.rounded(sample.position).ok_or("a point does not fit a LAS file")?;
                all.push(Sample { position, station: number as u16, ..sample });
            }
        } else {
            write_samples(&path, samples, &write)?;
        }
        let [x, y, z] = station;
        writeln!(table, "{number}.las,{x},{y},{z}")?;
    }
    std::fs::write(folder.join("stations.csv"), table)?;
    Ok(all)
}

/// Rounds a place to cells of 1/128 pixel and whole millimetres, the precision of the places of removed points.
fn cell([x, y, z]: [f64; 3]) -> [i64; 3] {
    let sub = |v: f64| (v * (1.0 / PIXEL_M) * 128.0).floor() as i64;
    [sub(x), sub(y), (z * 1000.0).round() as i64]
}

/// Places of the points that were removed.
fn removed(path: &Path) -> Result<HashSet<[i64; 3]>> {
    Ok(read_scan(path, Units::Factor(1.0))?.into_iter().map(cell).collect())
}

/// Counts the doorways of a scene that are free.
fn is_open(archive: &Path, doors: &[[f64; 6]]) -> Result<usize> {
    let store = Snapshot::resident(&Archive::open(archive)?, &NoMonitor)?;
    let mut open = 0;
    for [x0, y0, z0, x1, y1, z1] in doors {
        let shape = Aabb::new([*x0, *y0, *z0].into(), [*x1, *y1, *z1].into())?;
        open += usize::from(overlaps(&store, &shape) == Overlap::Clear);
    }
    Ok(open)
}

/// The tables, as a page.
pub fn page(effort: &Effort) -> Result<String> {
    let mut table = Table::new([
        "scene",
        "stations",
        "people a station",
        "points on people",
        "removed",
        "points on surfaces",
        "lost",
        "dufomap: removed",
        "lost",
        "doors free before, after",
    ]);
    let mut sights = Table::new([
        "scene",
        "people a station",
        "clear: share",
        "removed",
        "grazed: share",
        "removed",
        "outvoted: share",
        "removed",
        "near background: share",
        "no background: share",
        "people: share",
        "hidden: share",
        "removed of all that could be seen through",
        "removed if by whole parts",
    ]);
    let hall_door = [7.9, 4.25, 0.2, 8.25, 4.75, 1.9];
    let house_door = [4.9, 4.75, 0.2, 5.3, 5.25, 1.9];
    for (name, params, door) in [
        ("hall", &[][..], hall_door),
        ("house", &[("storeys", 1.0)][..], house_door),
        ("corridor", &[("width", 4.0)][..], [3.9, -0.25, 0.2, 4.3, 0.25, 1.9]),
    ] {
        for people in [1, 2, 4] {
            if !effort.takes(name) {
                continue;
            }
            let params = params.iter().fold(Params::new(), |params, (name, value)| params.with(name, *value));
            let scene = Scene::named(name, &params)?;
            let folder = tempfile::tempdir()?;
            let rays = effort.of(RAYS, RAYS / 10);
            let samples = scans(&scene, rays, people, SEED, folder.path(), true)?;
            let eyes = eyes(&scene, rays, people, SEED)?;
            let moving = Moving { folder: folder.path().into(), remove: false, memory: 512 << 20 };
            let archive = folder.path().join("out.slices");
            convert(&moving.options()?, &NoMonitor)?;
            let before = is_open(&archive, &[door])?;
            convert(&Moving { remove: true, ..moving }.options()?, &NoMonitor)?;
            let after = is_open(&archive, &[door])?;
            let gone = removed(&folder.path().join("removed.las"))?;
            let is_gone = |sample: &Sample| {
                let [x, y, z] = cell(sample.position);
                (-1..=1).any(|dz| gone.contains(&[x, y, z + dz]))
            };
            let share = |kind: Kind, is_gone: &dyn Fn(usize, &Sample) -> bool| {
                let mut share = Share::default();
                samples
                    .iter()
                    .enumerate()
                    .filter(|(_, sample)| sample.kind == kind)
                    .for_each(|(n, sample)| share.add(is_gone(n, sample)));
                share
            };
            let [people_points, surfaces] =
                [Kind::Moving, Kind::Surface].map(|kind| share(kind, &|_, sample| is_gone(sample)));
            sights.row(
                [name.to_owned(), people.to_string()]
                    .into_iter()
                    .chain(by_sight(&scene, &eyes, &samples, &is_gone))
                    .chain([percent(by_parts(&samples, &is_gone).value())]),
            );
            let peer = dufomap(&scene, folder.path(), &samples)?;
            let peers = [Kind::Moving, Kind::Surface].map(|kind| {
                peer.as_ref().map_or("–".into(), |dynamic| percent(share(kind, &|n, _| dynamic[n]).value()))
            });
            let [peer_removed, peer_lost] = peers;
            table.row([
                name.to_owned(),
                scene.stations().len().to_string(),
                people.to_string(),
                people_points.all.to_string(),
                percent(people_points.value()),
                surfaces.all.to_string(),
                percent(surfaces.value()),
                peer_removed,
                peer_lost,
                format!("{before}, {after}"),
            ]);
        }
    }
    Ok(format!(
        "{}\n{}\n{}\n{}\n",
        include_str!("moving.head.md"),
        table.markdown(),
        include_str!("sight.head.md"),
        sights.markdown()
    ))
}

/// Share of the points on people if the removal of one took along all points of its connected part: those of the same
/// station in cells that touch, without the surfaces on which people stand.
fn by_parts(samples: &[Sample], is_gone: &dyn Fn(&Sample) -> bool) -> Share {
    let mut cells: BTreeMap<[i64; 4], Share> = BTreeMap::new();
    for sample in samples.iter().filter(|sample| sample.kind == Kind::Moving) {
        let [x, y, z] = sample.position.map(|v| (v / PART_CELL_M).floor() as i64);
        cells.entry([i64::from(sample.station), x, y, z]).or_default().add(is_gone(sample));
    }
    let mut sum = Share::default();
    while let Some((first, share)) = cells.pop_first() {
        let (mut part, mut open) = (share, vec![first]);
        while let Some([station, x, y, z]) = open.pop() {
            for [dx, dy, dz] in neighbours() {
                let next = [station, x + dx, y + dy, z + dz];
                if let Some(share) = cells.remove(&next) {
                    part.merge(share);
                    open.push(next);
                }
            }
        }
        let gone = if part.yes > 0 { part.all } else { 0 };
        sum.merge(Share { all: part.all, yes: gone });
    }
    sum
}

/// Steps to the cells that touch a cell, and to itself.
fn neighbours() -> impl Iterator<Item = [i64; 3]> {
    (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| [x, y, z])))
}

/// The stations, and the people that their scans met.
fn eyes(scene: &Scene, rays: usize, people: usize, seed: u64) -> Result<Vec<Eye>> {
    let eye = |(number, station): (u64, &[f64; 3])| {
        let crowd = scene.crowd(seed + number, &station_spec(*station, rays, people))?;
        Ok(Eye { station: *station, crowd })
    };
    (0..).zip(scene.stations()).map(eye).collect()
}

/// Classifies the points on people by [`RayBound`]: shares of all, and how many of each were removed.
fn by_sight(scene: &Scene, eyes: &[Eye], samples: &[Sample], is_gone: &dyn Fn(&Sample) -> bool) -> [String; 11] {
    let mut gone: BTreeMap<RayBound, Share> = BTreeMap::new();
    let mut all = 0u64;
    for sample in samples.iter().filter(|sample| sample.kind == Kind::Moving) {
        let others = eyes.iter().zip(0u16..).filter(|(_, number)| *number != sample.station);
        let sight = best(scene, others.map(|(eye, _)| eye), sample.position);
        gone.entry(sight).or_default().add(is_gone(sample));
        all += 1;
    }
    let of = |sights: &[RayBound]| {
        let mut sum = Share::default();
        sights.iter().filter_map(|sight| gone.get(sight)).for_each(|share| sum.merge(*share));
        sum
    };
    let share = |sights: &[RayBound]| percent(of(sights).all as f64 / all.max(1) as f64);
    let removed = |sights: &[RayBound]| percent(of(sights).value());
    [
        share(&[RayBound::Clear]),
        removed(&[RayBound::Clear]),
        share(&[RayBound::Grazed]),
        removed(&[RayBound::Grazed]),
        share(&[RayBound::Outvoted]),
        removed(&[RayBound::Outvoted]),
        share(&[RayBound::Near]),
        share(&[RayBound::Open]),
        share(&[RayBound::Occupied, RayBound::Crowded]),
        share(&[RayBound::Hidden]),
        removed(&[RayBound::Clear, RayBound::Grazed]),
    ]
}

/// Returns the points that `dufomap` takes for moving; `None`, and a line on standard error, if it is not installed.
fn dufomap(scene: &Scene, folder: &Path, samples: &[Sample]) -> Result<Option<Vec<bool>>> {
    let Some(python) = std::env::var_os("DUFOMAP_PYTHON") else {
        eprintln!("skipped: dufomap; DUFOMAP_PYTHON names a Python that has it");
        return Ok(None);
    };
    // x, y, z and number of the station, as 64-bit floats, station after station as the samples are.
    let mut bytes = Vec::with_capacity(32 * samples.len());
    let mut station = Vec::new();
    for number in 0..scene.stations().len() {
        let reader = las::Reader::from_path(folder.join(format!("{number}.las")))?;
        station.extend(std::iter::repeat_n(number as f64, reader.header().number_of_points() as usize));
    }
    for (sample, station) in samples.iter().zip(&station) {
        sample.position.iter().chain([station]).for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    let (points, labels) = (folder.join("points.f64"), folder.join("labels.u8"));
    std::fs::write(&points, bytes)?;
    let places: Vec<String> = scene.stations().iter().map(|[x, y, z]| format!("{x},{y},{z}")).collect();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("dufomap/label.py");
    let mut command = Command::new(python);
    command.arg(script).arg(&points).arg(&labels).args(places);
    watch(&mut command)?;
    Ok(Some(std::fs::read(&labels)?.iter().map(|label| *label != 0).collect()))
}

/// Time and memory of a large scan, with and without removing, in turn, as a page.
pub fn speed(effort: &Effort) -> Result<String> {
    let scene = Scene::named("hall", &Params::new())?;
    let folder = tempfile::tempdir()?;
    let rays = effort.of(MANY, MANY / 100) / scene.stations().len();
    scans(&scene, rays, 2, SEED, folder.path(), false)?;
    let mut table = Table::new([
        "memory",
        "round",
        "plain (s)",
        "processor time",
        "peak (MiB)",
        "removing (s)",
        "processor time",
        "peak (MiB)",
        "share of the speed",
    ]);
    for memory in [512u64 << 20, 128 << 20] {
        for round in 1..=effort.of(2, 1) {
            let moving = Moving { folder: folder.path().into(), remove: false, memory };
            let plain = moving.watched()?;
            let without = Moving { remove: true, ..moving }.watched()?;
            let mib = |bytes: u64| number(bytes as f64 / f64::from(1 << 20), 0);
            table.row([
                format!("{} MiB", memory >> 20),
                round.to_string(),
                number(plain.seconds, 1),
                number(plain.cpu_s, 1),
                mib(plain.peak_bytes),
                number(without.seconds, 1),
                number(without.cpu_s, 1),
                mib(without.peak_bytes),
                number(plain.seconds / without.seconds, 2),
            ]);
        }
    }
    Ok(format!(
        "# Time and memory of removing walking people\n\n`cargo run --release --manifest-path tools/lab/Cargo.toml -- ways speed`\n\nThe hall scanned with {} M rays in all from {} stations, two people around each.\n\n{}\n",
        number((rays * scene.stations().len()) as f64 / 1e6, 0),
        scene.stations().len(),
        table.markdown()
    ))
}
