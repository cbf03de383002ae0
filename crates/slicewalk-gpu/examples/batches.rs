//! Times batches of boxes, cylinders, spheres, floors and rays on the device and on the processor.
//!
//! ```text
//! cargo run --release --example batches -- [SCAN.slices] [--software] [--most N]
//! ```
//!
//! Without an archive, a scan of a house is generated. Most questions lie within a few metres of solid.

use scangen::{Params, SampleSpec, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::PAGE_QUANTA;
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::query::{Aabb, Cylinder, Ray, Sphere};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_gpu::{Below, Device, Options, Question, Scene};
use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let (mut archive, mut software, mut most) = (None, false, 10_000_000);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match &argument[..] {
            "--software" => software = true,
            "--most" => most = arguments.next().ok_or("--most: a number is missing")?.parse()?,
            path => archive = Some(PathBuf::from(path)),
        }
    }
    let pages = match archive {
        Some(path) => Snapshot::resident(&Archive::open(&path)?, &NoMonitor)?,
        None => house()?,
    };
    let device = Device::open(&Options { software, buffer_bytes: None })?;
    let info = device.info();
    println!("{} ({:?}, {:?}, {} {})", info.name, info.device_type, info.backend, info.driver, info.driver_info);
    let begin = Instant::now();
    let scene = Scene::new(&device, &pages)?;
    println!(
        "{} pages: {:.1} MB in memory, {:.1} MB on the device, uploaded in {:.1} ms",
        pages.page_count(),
        pages.weight_bytes() as f64 / 1e6,
        scene.device_bytes() as f64 / 1e6,
        begin.elapsed().as_secs_f64() * 1e3
    );
    let processor = Scene::on_processor(&pages);
    println!(
        "{:<10} {:>9} {:>10} {:>10} {:>11} {:>11} {:>7} {:>10}",
        "", "batch", "send", "collect", "device", "processor", "ratio", "undecided"
    );
    println!(
        "{:<10} {:>9} {:>10} {:>10} {:>11} {:>11} {:>7} {:>10}",
        "", "", "ms", "ms", "ns each", "ns each", "", "%"
    );
    let mut count = 1000;
    while count <= most {
        let mut places = Places::new(&pages);
        compare(
            "boxes",
            &scene,
            &processor,
            &places.each(count, |at, _| Aabb::standing(at, Vector3::new(0.5, 0.5, 1.6))),
        )?;
        compare("cylinders", &scene, &processor, &places.each(count, |at, _| Cylinder::new(at, 0.25, 1.6)))?;
        compare("spheres", &scene, &processor, &places.each(count, |at, _| Sphere::new(at, 0.25)))?;
        let below =
            |at, _| Ok(Below { shape: Aabb::standing(at, Vector3::new(0.5, 0.5, 1.6))?, from: at.z, depth: 5.0 });
        compare("floors", &scene, &processor, &places.each(count, below))?;
        compare("rays", &scene, &processor, &places.each(count, |at, way| Ray::new(at, way, 20.0)))?;
        count *= 10;
    }
    Ok(())
}

/// Answers a batch on both, prints the times and checks that the answers are equal.
fn compare<Q: Question>(name: &str, scene: &Scene, processor: &Scene, questions: &[Q]) -> Result<(), Box<dyn Error>>
where
    Q::Answer: PartialEq,
{
    // The first of a kind warms up both; small batches take the best of several.
    let rounds = (200_000 / questions.len()).clamp(1, 20);
    let (mut times, mut share) = ([f64::INFINITY; 3], 0.0);
    for _ in 0..rounds {
        let begin = Instant::now();
        let pending = scene.ask(questions)?;
        let sent = begin.elapsed().as_secs_f64();
        let replies = pending.wait()?;
        let done = begin.elapsed().as_secs_f64();
        if done < times[1] {
            (times[0], times[1]) = (sent, done);
        }
        let begin = Instant::now();
        let expected = processor.ask(questions)?.wait()?;
        times[2] = times[2].min(begin.elapsed().as_secs_f64());
        if replies.answers != expected.answers {
            return Err(format!("{name}: the answers differ").into());
        }
        share = 100.0 * replies.by_processor as f64 / questions.len() as f64;
    }
    let each = |seconds: f64| seconds * 1e9 / questions.len() as f64;
    println!(
        "{name:<10} {:>9} {:>10.2} {:>10.2} {:>11.1} {:>11.1} {:>7.2} {share:>10.3}",
        questions.len(),
        times[0] * 1e3,
        (times[1] - times[0]) * 1e3,
        each(times[1]),
        each(times[2]),
        times[2] / times[1]
    );
    Ok(())
}

/// A scan of a house of two million points at pixels of 5 cm.
fn house() -> Result<Snapshot, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let (scan, output) = (folder.path().join("house.las"), folder.path().join("house.slices"));
    let scene = scangen::Scene::named("house", &Params::new())?;
    let samples = scene.samples(1, &SampleSpec::direct_count(2_000_000).with_noise(0.003))?;
    write_samples(&scan, samples, &WriteSpec::for_path(&scan))?;
    let mut options = ConvertOptions::new(vec![scan], output.clone());
    options.grid.pixel = PixelSize::Metres(0.05);
    convert(&options, &NoMonitor)?;
    Ok(Snapshot::resident(&Archive::open(&output)?, &NoMonitor)?)
}

/// Random places above floors, and directions.
struct Places {
    floors: Vec<Point3<f64>>,
    state: u64,
}

impl Places {
    fn new(pages: &Snapshot) -> Self {
        let (frame, mut floors) = (pages.frame(), Vec::new());
        for (tx, ty, slots) in (0..pages.column_count()).map(|number| pages.column_at(number)) {
            for (slot, page) in slots.iter().filter_map(|slot| Some((slot, slot.page()?))) {
                for (x, y, spans) in page.columns() {
                    let at =
                        |tile: i32, pixel: u32| (f64::from(tile) * 64.0 + f64::from(pixel) + 0.5) * frame.pixel_m();
                    let height =
                        |top: u32| (i64::from(slot.layer()) * PAGE_QUANTA + i64::from(top)) as f64 * frame.quantum_m();
                    let tops = spans.iter().filter(|span| !span.is_obstacle()).map(|span| height(span.top()));
                    floors.extend(tops.map(|z| Point3::new(at(tx, x), at(ty, y), z)));
                }
            }
        }
        Self { floors, state: 1 }
    }

    fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.state ^ (self.state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform between two numbers.
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Makes questions of places 0.3 to 1.5 m above a floor, moved across by up to half a metre.
    fn each<Q>(&mut self, count: usize, make: impl Fn(Point3<f64>, Vector3<f64>) -> slicewalk::Result<Q>) -> Vec<Q> {
        let mut question = || {
            let number = self.bits() % self.floors.len() as u64;
            let floor = self.floors[number as usize];
            let away = Vector3::new(self.between(-0.5, 0.5), self.between(-0.5, 0.5), self.between(0.3, 1.5));
            let way = Vector3::new(self.between(-1.0, 1.0), self.between(-1.0, 1.0), self.between(-0.5, 0.5));
            make(floor + away, way).expect("the numbers are finite")
        };
        (0..count).map(|_| question()).collect()
    }
}
