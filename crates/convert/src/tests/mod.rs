//! Conversions on disks that fail or lose data, conversions that resume from what another run left, and whole stories.

mod areas;
mod elsewhere;
mod faults;
mod floaters;
#[path = "../../../../tests/loader/link.rs"]
#[allow(dead_code, reason = "stories use a part")]
mod link;
mod pipeline;
mod power;
#[path = "../../../../tests/common/random.rs"]
mod random;
mod resume;
mod stories;
mod strikes;

use super::conversion::{Limits, convert_within};
use super::*;
use crate::colour::ColourSource;
use crate::disk::Disk;
use crate::disk::testing::model::{Content, ModelDisk};
use crate::input::Units;
use random::Random;
use scangen::{Chunks, WriteSpec, write_las};
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use tempfile::TempDir;

/// Conversion of two scans, a plain one and a compressed one in many chunks, that spills.
struct Job {
    folder: TempDir,
    options: ConvertOptions,
    /// Archive that the conversion replaces; `new` is the one that it makes.
    old: Vec<u8>,
    new: Vec<u8>,
}

/// Points of each of the two scans.
const POINTS: usize = 4_500;

impl Job {
    fn new() -> Self {
        Self::with(ColourMode::Off)
    }

    /// Like [`new`](Self::new), but with colours.
    fn with(colour: ColourMode) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut random = Random(7);
        for name in ["plain.las", "packed.laz"] {
            let mut millimetres = |most: u64| random.below(most) as f64 / 1000.0;
            let points: Vec<_> =
                (0..POINTS).map(|_| [millimetres(9000), millimetres(9000), millimetres(2000)]).collect();
            let path = folder.path().join(name);
            let mut spec = WriteSpec::for_path(&path);
            spec.compression = spec.compression.map(|_| Chunks::Fixed(700));
            write_las(&path, points.iter().copied(), &spec).unwrap();
        }
        let inputs = ["plain.las", "packed.laz"].map(|name| folder.path().join(name)).to_vec();
        let mut options = ConvertOptions::new(inputs, folder.path().join("a.slices"));
        options.resources.temp_dir = folder.path().join("temp");
        options.resources.threads = 1;
        options.resources.memory_bytes = MIN_MEMORY_BYTES;
        options.overwrite = true;
        options.reading.units = Units::Factor(1.0);
        options.sections.colour = colour;
        fs::create_dir(&options.resources.temp_dir).unwrap();
        let mut made = [1.0, 0.1].map(|pixel_m| {
            options.grid.pixel = PixelSize::Metres(pixel_m);
            convert(&options, &NoMonitor).unwrap();
            fs::read(&options.output).unwrap()
        });
        let [old, new] = std::mem::take(&mut made);
        fs::write(&options.output, &old).unwrap();
        Self { folder, options, old, new }
    }

    /// Limits that make runs of about 4,000 points, all of them on disk.
    fn limits() -> Limits {
        Limits { retain_bytes: 0, build_bytes: 0, views_bytes: 0 }
    }

    /// Returns a model of the folder before the conversion.
    fn content(&self) -> Content {
        let mut content = Content::default();
        content.put(&self.options.output, self.old.clone());
        content
    }

    fn convert(&self, resume: bool, monitor: &dyn Monitor) -> Result<Report> {
        convert_within(&ConvertOptions { resume, ..self.options.clone() }, Self::limits(), monitor)
    }

    fn convert_on(&self, disk: Arc<dyn Disk>, resume: bool) -> Result<Report> {
        crate::disk::with(disk, || self.convert(resume, &NoMonitor))
    }

    /// Returns what is wrong after another run on a disk that holds `content`. The run must make the archive and leave
    /// nothing else, except complete archives kept under other names.
    fn next_run_fails(&self, content: Content, resume: bool) -> Option<String> {
        let disk = ModelDisk::new(content);
        if let Err(error) = self.convert_on(disk.clone(), resume) {
            return Some(format!("the next run fails: {error}"));
        }
        let left = disk.content();
        if left.bytes(&self.options.output) != Some(&self.new[..]) {
            return Some("the next run makes another archive".into());
        }
        let is_kept = |path: &Path| left.bytes(path) == Some(&self.new[..]);
        let rest = left.names().find(|path| !is_kept(path));
        rest.map(|path| format!("{} is left behind", path.display()))
    }
}

/// Monitor that counts points and cancels after `after` of them.
struct Stops {
    after: u64,
    advanced: AtomicU64,
    stages: Mutex<Vec<String>>,
}

impl Stops {
    fn after(after: u64) -> Self {
        Self { after, advanced: AtomicU64::new(0), stages: Mutex::default() }
    }

    fn points(&self) -> u64 {
        self.advanced.load(Ordering::Relaxed)
    }
}

impl Monitor for Stops {
    fn stage(&self, name: &str, _: u64, _: &str) {
        self.stages.lock().unwrap().push(name.to_owned());
    }
    fn advance(&self, amount: u64) {
        if self.stages.lock().unwrap().last().is_some_and(|stage| stage == "reading points") {
            self.advanced.fetch_add(amount, Ordering::Relaxed);
        }
    }
    fn cancelled(&self) -> bool {
        self.points() >= self.after
    }
}
