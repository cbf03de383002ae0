//! Whole stories: points become files, files an archive, and a pawn walks in it; on the way disks fail, power is lost,
//! bytes rot and answers get lost. One number decides everything.
//!
//! | part | what must hold |
//! |---|---|
//! | conversion, killed or without power several times, resumed or not; or planned, in parts and merged | the bytes of an undisturbed run over the same points in another order and other files (G4, G6) |
//! | the archive | `verify` finds nothing; a box that contains a point is a hit (G1), one far from all points is not (G2) |
//! | a damaged copy | is refused, or known to `verify`; recovery yields sound pages of the original only |
//! | a region cut out | is a sound archive and answers in its bounds as the whole does |
//! | pages over a link that is slow, loses answers and mixes their order | every answer is that of the whole archive or "not loaded"; memory stays in the budget |
//! | the walk | ends at the very place where a pawn ends that has all pages in memory |
//!
//! `SLICEWALK_STORIES` sets how many, `SLICEWALK_SEED` the first; a failure names the one that replays it.

use super::link::{Link, Manners};
use super::*;
use crate::archive::{Archive, extract, merge, merge_run, recover};
use crate::disk::testing::model::Fate;
use crate::disk::testing::{Call, Hooked, Verdict};
use crate::frame::PageKey;
use crate::page::Page;
use nalgebra::{Point3, Vector2, Vector3};
use scangen::sample::{Kind, Sample};
use scangen::write_samples;
use slicewalk::query::{Aabb, Overlap, floor_under, overlaps};
use slicewalk::store::{Loader, LoaderOptions, Snapshot};
use slicewalk::walk::{Body, Config, MoveInput, Walker};
use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// Coordinates in millimetres from the offset of the files, and a kind, which decides the class.
type Point = ([i32; 3], Kind);

/// How often accidents and repairs happened.
#[derive(Debug, Default)]
struct Tally {
    accidents: AtomicU64,
    resumed: AtomicU64,
    merged: AtomicU64,
    /// Damaged copies of which some pages were recovered.
    repaired: AtomicU64,
    /// Frames in which a pawn waited for pages.
    waited: AtomicU64,
}

fn add_one(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

struct Story<'a> {
    tally: &'a Tally,
    random: Random,
    folder: TempDir,
    points: Vec<Point>,
    offset: [f64; 3],
    options: ConvertOptions,
    limits: Limits,
}

impl<'a> Story<'a> {
    fn new(seed: u64, tally: &'a Tally) -> Self {
        let mut random = Random(seed);
        let folder = tempfile::tempdir().unwrap();
        let offset = [[0.0; 3], [-3.0, -3.0, -1.0], [431_000.0, 5_281_000.0, 470.0]][random.below(3)];
        let points = points(&mut random);
        let mut options = ConvertOptions::new(Vec::new(), folder.path().join("a.slices"));
        let pixel = [0.1, 0.125, 0.2, 0.3][random.below(4)];
        options.grid.pixel = PixelSize::Metres(pixel);
        options.grid.slice_m = [None, None, Some(0.1), Some(0.5)][random.below(4)];
        options.plan.tolerance_m = [0.0, 0.0, pixel / 4.0][random.below(3)];
        options.plan.fill_holes = if random.chance(20) { 3 } else { 0 };
        options.plan.drop_floaters = [0, 0, 1, 4][random.below(4)];
        options.plan.min_points = if random.chance(15) { 2 } else { 1 };
        options.plan.max_slope_deg = random.between(20.0, 60.0);
        options.sections.levels = random.chance(40);
        options.sections.colour = if random.chance(30) { ColourMode::Of(ColourSource::Class) } else { ColourMode::Off };
        options.sections.colour_error = [0.0, 2.0][random.below(2)];
        options.reading.units = Units::Factor(1.0);
        options.resources.memory_bytes = MIN_MEMORY_BYTES;
        options.resources.temp_dir = folder.path().join("temp");
        fs::create_dir(&options.resources.temp_dir).unwrap();
        let limits = if random.chance(70) { Job::limits() } else { Limits::of(&options) };
        Self { tally, random, folder, points, offset, options, limits }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes all points in random order to this many files of random formats.
    fn files(&mut self, what: &str, count: usize) -> Vec<PathBuf> {
        self.random.shuffle(&mut self.points);
        let mut parts = vec![Vec::new(); count];
        for &point in &self.points {
            parts[self.random.below(count)].push(point);
        }
        let paths = parts.iter().enumerate().map(|(number, part)| {
            let packed = self.random.chance(60);
            let path = self.folder.path().join(format!("{what}{number}.{}", if packed { "laz" } else { "las" }));
            let chunks = [Chunks::Fixed(100), Chunks::Fixed(50_000), Chunks::Variable(700)][self.random.below(3)];
            // Formats 4, 5, 9 and 10 have wave packets, which the crate that writes LAZ does not compress.
            let format = [0, 1, 2, 3, 6, 7, 8][self.random.below(7)];
            let spec = WriteSpec {
                format,
                offset: self.offset,
                compression: packed.then_some(chunks),
                seed: self.random.bits(),
                ..WriteSpec::default()
            };
            write_points(&path, part, &spec);
            path
        });
        paths.collect()
    }

    /// Converts without accidents, from one file, on one thread, with everything in memory.
    fn undisturbed(&mut self) -> Vec<u8> {
        let inputs = self.files("all", 1);
        let mut options = ConvertOptions { inputs, output: self.path("whole.slices"), ..self.options.clone() };
        options.resources.threads = 1;
        convert(&options, &NoMonitor).unwrap();
        fs::read(&options.output).unwrap()
    }

    /// Converts in one run, after others that were killed or lost power.
    fn with_accidents(&mut self) -> Vec<u8> {
        let count = 1 + self.random.below(4);
        self.options.inputs = self.files("part", count);
        // With very many threads, columns are cut into areas.
        self.options.resources.threads = if self.random.chance(5) { 300 } else { 1 + self.random.below(2) };
        self.options.overwrite = true;
        let mut content = Content::default();
        for _ in 0..self.random.below(4) {
            content = self.accident(content);
        }
        let disk = ModelDisk::new(content);
        let options = ConvertOptions { resume: self.random.chance(60), ..self.options.clone() };
        let report = crate::disk::with(disk.clone(), || convert_within(&options, self.limits, &NoMonitor)).unwrap();
        report.resumed.iter().for_each(|_| add_one(&self.tally.resumed));
        let left = disk.content();
        let names: Vec<_> = left.names().collect();
        assert_eq!(names, [&*options.output], "nothing else is left");
        left.bytes(&options.output).unwrap().to_vec()
    }

    /// Converts until a call of the disk fails, and all later ones with it; returns what the disk holds then, without
    /// some of what was not synced if power fails too.
    fn accident(&mut self, content: Content) -> Content {
        let disk = ModelDisk::new(content);
        let most = 8u64 << self.random.below(9);
        let last = self.random.below(most);
        let mut calls = 0;
        let dying = Hooked::new(disk.clone(), move |_: Call| {
            calls += 1;
            if calls > last { Verdict::Torn(io::Error::other("killed")) } else { Verdict::Done }
        });
        let options = ConvertOptions { resume: self.random.chance(70), ..self.options.clone() };
        if crate::disk::with(dying, || convert_within(&options, self.limits, &NoMonitor)).is_err() {
            add_one(&self.tally.accidents);
        }
        if self.random.chance(50) {
            return disk.content();
        }
        let recording = disk.recording();
        let end = self.random.below(recording.steps.len() + 1);
        let durable = recording.durable(end, None);
        let share = self.random.below(101);
        recording.left(&durable, |_| match self.random.below(100) {
            chance if chance >= share => Fate::Kept,
            _ => [Fate::Lost, Fate::LengthOnly, Fate::Half, Fate::Blocks(self.random.bits())][self.random.below(4)],
        })
    }

    /// Plans the conversion, converts its parts in any order, and merges them, neighbours first or all at once.
    fn in_parts(&mut self) -> Vec<u8> {
        let count = 1 + self.random.below(4);
        let mut options = ConvertOptions { inputs: self.files("part", count), ..self.options.clone() };
        let plan_path = self.path("plan.json");
        PlanFile::new(&options, &NoMonitor).unwrap().write(&plan_path, false).unwrap();
        let plan = PlanFile::read(&plan_path).unwrap();
        let count = 1 + self.random.below(5u32);
        let mut order: Vec<u32> = (1..=count).collect();
        self.random.shuffle(&mut order);
        let mut parts = vec![PathBuf::new(); count as usize];
        for index in order {
            self.random.shuffle(&mut options.inputs);
            plan.apply_to(&mut options);
            options.plan_file = Some(plan.clone());
            options.shard = Some(ShardOptions { index, count });
            options.resources.threads = 1 + self.random.below(2);
            options.output = self.path(&format!("{index}-of-{count}.slices"));
            convert_within(&options, self.limits, &NoMonitor).unwrap();
            parts[index as usize - 1] = options.output.clone();
        }
        if count >= 2 && self.random.chance(50) {
            let cut = 1 + self.random.below(parts.len() - 1);
            let halves = [&parts[..cut], &parts[cut..]];
            parts = (1..)
                .zip(halves)
                .map(|(number, half)| {
                    let path = self.folder.path().join(format!("half{number}.slices"));
                    merge_run(half, (number, 2), &path, false, &NoMonitor).unwrap();
                    path
                })
                .collect();
        }
        self.random.shuffle(&mut parts);
        let merged = self.path("merged.slices");
        merge(&parts, &merged, false, &NoMonitor).unwrap();
        add_one(&self.tally.merged);
        fs::read(merged).unwrap()
    }

    /// Compares the answers to random boxes with the points.
    fn question(&mut self, all: &Snapshot) {
        let frame = all.frame();
        let plan = self.options.plan.clone();
        let grow = Vector3::new(frame.pixel_m(), frame.pixel_m(), frame.slice_m()).add_scalar(plan.tolerance_m);
        let places: Vec<_> = self.points.iter().map(|point| self.place(*point)).collect();
        for _ in 0..60 {
            let a = self.spot(&places);
            let size = frame.pixel_m() * [0.0, 0.3, 3.0, 30.0][self.random.below(4)];
            let b = a + Vector3::from_fn(|_, _| self.random.between(0.0, size));
            let shape = Aabb::new(a, b).unwrap();
            let holds = |by: Vector3<f64>| {
                places.iter().any(|p| (0..3).all(|axis| p[axis] >= a[axis] - by[axis] && p[axis] <= b[axis] + by[axis]))
            };
            let hit = overlaps(all, &shape) != Overlap::Clear;
            let keeps_all = plan.drop_floaters == 0 && plan.min_points == 1;
            assert!(hit || !keeps_all || !holds(Vector3::zeros()), "no point is missed (G1): {shape:?}");
            // Inferred floor is solid without points.
            assert!(!hit || plan.fill_holes > 0 || holds(grow), "phantoms are near points (G2): {shape:?}");
        }
    }

    /// Place of a point as readers get it.
    fn place(&self, (at, _): Point) -> Point3<f64> {
        Point3::from([0, 1, 2].map(|axis| f64::from(at[axis]) * 0.001 + self.offset[axis]))
    }

    /// A random place: that of a point, or anywhere around.
    fn spot(&mut self, places: &[Point3<f64>]) -> Point3<f64> {
        let place = places[self.random.below(places.len())];
        let far = [0.0, 0.2, 2.0][self.random.below(3)];
        place + Vector3::from_fn(|_, _| self.random.between(-far, far))
    }

    /// Damages a copy, and recovers what is left of it.
    fn rot(&mut self, bytes: &[u8], pages: &BTreeMap<PageKey, Page>) {
        let mut damaged = bytes.to_vec();
        let at = self.random.below(bytes.len());
        match self.random.below(4) {
            0 => damaged.truncate(at),
            1 => damaged[at] ^= 1 << self.random.below(8),
            2 => {
                let end = (at + 1 + self.random.below(4096)).min(bytes.len());
                damaged[at..end].fill(0);
            }
            _ => {
                for _ in 0..1 + self.random.below(20) {
                    let at = self.random.below(bytes.len());
                    damaged[at] = self.random.below(256) as u8;
                }
            }
        }
        let sound = Archive::from_bytes(damaged.clone()).is_ok_and(|archive| is_sound(&archive));
        assert!(!sound || damaged == bytes, "damage is noticed (G7)");
        let (path, out) = (self.path("damaged.slices"), self.path("recovered.slices"));
        fs::write(&path, &damaged).unwrap();
        let plan = Archive::from_bytes(bytes.to_vec()).unwrap().plan().clone();
        let Ok(recovered) = recover(&path, Some(&plan), &out, false, &NoMonitor) else { return };
        let archive = Archive::open(&out).unwrap();
        assert!(is_sound(&archive), "{recovered:?}");
        let left = pages_of(&archive);
        if !recovered.is_complete() && !left.is_empty() {
            add_one(&self.tally.repaired);
        }
        for (key, page) in &left {
            assert!(pages.get(key) == Some(page), "{key}: a page that was never there; {recovered:?}");
        }
        assert!(!recovered.is_complete() || left == *pages, "{recovered:?}");
        assert!(!recovered.identical || fs::read(&out).unwrap() == bytes, "{recovered:?}");
    }

    /// Cuts a region out, and asks for boxes in it.
    fn cut(&mut self, bytes: &[u8], all: &Snapshot) {
        let places: Vec<_> = self.points.iter().map(|point| self.place(*point)).collect();
        let (a, b) = (self.spot(&places), self.spot(&places));
        let (min, max) = (a.inf(&b), a.sup(&b));
        let out = self.path("region.slices");
        let archive = Archive::from_bytes(bytes.to_vec()).unwrap();
        extract(&archive, &(min.into(), max.into()), &out, false, &NoMonitor).unwrap();
        let region = Archive::open(&out).unwrap();
        assert!(is_sound(&region));
        let region = Snapshot::resident(&region, &NoMonitor).unwrap();
        for _ in 0..20 {
            let mut within = || {
                let inside = |axis: usize| self.random.between(min[axis], max[axis]).clamp(min[axis], max[axis]);
                Point3::from([0, 1, 2].map(inside))
            };
            let (a, b) = (within(), within());
            let shape = Aabb::new(a.inf(&b), a.sup(&b)).unwrap();
            assert_eq!(overlaps(&region, &shape), overlaps(all, &shape), "{shape:?}");
        }
    }

    /// Walks over a bad link, beside a pawn that has all pages in memory.
    fn walk(&mut self, bytes: &[u8], all: &Snapshot) {
        const FRAME: Duration = Duration::from_millis(33);
        let manners = Manners {
            latency: Duration::from_millis(self.random.below(120)),
            rate: [3e4, 1e6, 1e9][self.random.below(3)],
            lost: self.random.below(25),
            shuffled: self.random.chance(40),
        };
        let mut link = Link::new(bytes, manners, self.random.bits());
        let budget = [2 << 20, 8 << 20][self.random.below(2)];
        let length = self.random.chance(50).then_some(bytes.len() as u64);
        let mut loader =
            Loader::open(length, LoaderOptions { fetches: 1 + self.random.below(4), ..LoaderOptions::new(budget) });
        let pawn = loader.body();
        let body = match self.random.below(2) {
            0 => Body::Box { x: 0.4, y: 0.3, height: 1.2 },
            _ => Body::Cylinder { radius: 0.2, height: 1.2 },
        };
        let config = Config {
            speed: self.random.between(0.5, 4.0),
            max_drop: self.random.chance(50).then_some(0.5),
            ..Config::new(body)
        };
        let first = self.points[self.random.below(self.points.len())];
        let start = self.place(first) + Vector3::new(0.0, 0.0, self.random.between(0.0, 2.0));
        let (mut far, mut near) = (Walker::new(config, start).unwrap(), Walker::new(config, start).unwrap());
        let frame = *all.frame();
        let mut wish = MoveInput::Stay;
        for number in 0..self.random.below(150) {
            if number % 20 == 0 {
                let angle = self.random.between(0.0, std::f64::consts::TAU);
                wish = MoveInput::Direction(Vector2::new(angle.cos(), angle.sin()));
            }
            near.step(all, FRAME.as_secs_f64(), wish);
            let mut rest = FRAME.as_secs_f64();
            let begin = link.now;
            while rest > 0.0 {
                loader.hint(pawn, &far.motion_hint(&frame));
                // Until the archive is open, polling reports each answer that was lost.
                if let Err(error) = link.run(&mut loader, link.now + FRAME) {
                    assert!(loader.snapshot().is_none() && matches!(error, Error::Io { .. }), "{error}");
                    link.now += FRAME;
                }
                assert!(link.now - begin < Duration::from_secs(300), "the pawn waits for ever: {:#?}", link.transcript);
                let Some(view) = loader.snapshot() else { continue };
                let report = far.step(&view, rest, wish);
                rest = report.unspent;
                if let Some(missing) = report.missing {
                    loader.need(pawn, &missing);
                    add_one(&self.tally.waited);
                }
                let feet = far.feet();
                let shape = Aabb::new(feet - Vector3::new(0.2, 0.2, 0.3), feet + Vector3::new(0.2, 0.2, 0.9)).unwrap();
                let answer = overlaps(&view, &shape);
                assert!(matches!(answer, Overlap::NotLoaded(_)) || answer == overlaps(all, &shape), "{shape:?}");
                let floor = floor_under(&view, &shape, feet.z, 0.3).known();
                assert!(
                    floor.is_none_or(|floor| Some(floor) == floor_under(all, &shape, feet.z, 0.3).known()),
                    "{shape:?}"
                );
            }
            // Whether a pawn is blocked depends on the steps, and a wait divides one.
            assert_eq!(far.feet(), near.feet(), "frame {number}");
        }
        let counters = loader.counters();
        assert!(counters.peak_bytes <= counters.budget_bytes, "{counters:?}");
    }

    fn tell(mut self) {
        let expected = self.undisturbed();
        let made = if self.random.chance(60) { self.with_accidents() } else { self.in_parts() };
        assert!(made == expected, "the bytes of an undisturbed run (G4): {} and {} bytes", made.len(), expected.len());
        let archive = Archive::from_bytes(made.clone()).unwrap();
        assert!(is_sound(&archive));
        let pages = pages_of(&archive);
        let all = Snapshot::resident(&archive, &NoMonitor).unwrap();
        self.question(&all);
        self.rot(&made, &pages);
        self.cut(&made, &all);
        self.walk(&made, &all);
    }
}

fn is_sound(archive: &Archive) -> bool {
    let mut sound = true;
    archive.verify(&NoMonitor, &mut |_| sound = false).is_ok() && sound
}

fn pages_of(archive: &Archive) -> BTreeMap<PageKey, Page> {
    archive.entries().map(|entry| entry.and_then(|entry| Ok((entry.key, archive.page(&entry)?))).unwrap()).collect()
}

fn write_points(path: &Path, points: &[Point], spec: &WriteSpec) {
    let sample = |&(at, kind): &Point| {
        let position = [0, 1, 2].map(|axis| f64::from(at[axis]) * 0.001 + spec.offset[axis]);
        Sample { position, kind, surface: 0, station: 0 }
    };
    write_samples(path, points.iter().map(sample), spec).unwrap();
}

/// A floor with noise, a step, a wall and a ramp, and points anywhere, each perhaps.
fn points(random: &mut Random) -> Vec<Point> {
    let mut points = Vec::new();
    let width = 1500 + random.below(3000);
    let spacing = 40 + random.below(60);
    if random.chance(80) {
        let noise = 1 + random.below(30);
        let (step, ramp) = (width / 2 + random.below(width / 2), random.below(width / 2));
        let rise = random.below(400);
        let mut y = 0;
        while y < width {
            let mut x = 0;
            while x < width {
                let z = if x > step { rise } else { 0 } + if y < ramp { (ramp - y) / 3 } else { 0 };
                let jitter = [random.below(spacing), random.below(spacing), random.below(noise)];
                points.push(([x + jitter[0], y + jitter[1], z + jitter[2]], Kind::Surface));
                x += spacing;
            }
            y += spacing;
        }
    }
    if random.chance(50) {
        let (x, height) = (random.below(width), 300 + random.below(2500));
        for _ in 0..height / spacing * (width / spacing) {
            points.push(([x + random.below(20), random.below(width), random.below(height)], Kind::Surface));
        }
    }
    for _ in 0..if points.is_empty() { 20 + random.below(500) } else { random.below(300) } {
        let far = [500, 5_000, 60_000][random.below(3)];
        let mut anywhere = || random.below(2 * far) - far;
        points.push(([anywhere(), anywhere(), anywhere() / 4], Kind::Outlier));
    }
    points
}

#[test]
fn every_story_from_points_to_a_walk_holds_its_promises() {
    struct Told(u64);
    impl Drop for Told {
        fn drop(&mut self) {
            if std::thread::panicking() {
                eprintln!("story {0} failed: SLICEWALK_SEED={0} SLICEWALK_STORIES=1", self.0);
            }
        }
    }
    let number = |name: &str, default: u64| std::env::var(name).ok().map_or(default, |text| text.parse().unwrap());
    let (stories, first) = (number("SLICEWALK_STORIES", 40), number("SLICEWALK_SEED", 1));
    let (next, tally) = (AtomicU64::new(first), Tally::default());
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, |n| n.get()) {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + stories {
                        return;
                    }
                    let _told = Told(seed);
                    Story::new(seed, &tally).tell();
                }
            });
        }
    });
    println!("{stories} stories from {first} on: {tally:?}");
    let counters = [&tally.accidents, &tally.resumed, &tally.merged, &tally.repaired, &tally.waited];
    assert!(stories < 40 || counters.iter().all(|counter| counter.load(Ordering::Relaxed) > 0), "{tally:?}");
}
