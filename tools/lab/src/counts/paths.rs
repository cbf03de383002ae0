//! The hot paths, each called through `region`, which callgrind knows by its name. Runs in a process of its own, under
//! Valgrind; what it needs to have ready is made before, outside.

use crate::stability::Result;
use crate::{Random, pawns};
use nalgebra::{Vector2, Vector3};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, PageDecoder, PageEncoder};
use slicewalk::query::{Aabb, Overlap, Ray, cast, floor_under, overlaps, sweep};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, MoveInput, Walker};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::hint::black_box;
use std::path::PathBuf;

/// Names of the files that must lie ready.
pub const SCAN: &str = "scan.las";
/// See [`SCAN`].
pub const ARCHIVE: &str = "scan.slices";

/// Every path, in the order in which they are counted.
pub const NAMES: [&str; 9] = [
    "convert_point",
    "decode_page",
    "encode_page",
    "box_random",
    "box_walk",
    "sweep_walk",
    "floor_walk",
    "ray_random",
    "walk_frame",
];
const ASKED: usize = 2000;
/// Steps of the walk before those that ask: it begins at a table, where it stands for a while.
const SKIPPED: usize = 4000;
const PAGES: usize = 100;
const FRAMES: usize = 600;
const PIXEL_M: f64 = 0.1;

/// Paths that are counted in one process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Group {
    /// A conversion: the whole process counts, for its threads are not in the region.
    Conversion,
    /// Pages and answers, each in the region.
    Answers,
}

/// All groups, in the order of [`NAMES`].
pub const GROUPS: [Group; 2] = [Group::Conversion, Group::Answers];

impl Group {
    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Conversion => "conversion",
            Self::Answers => "answers",
        }
    }

    /// Whether the whole process counts.
    pub fn is_whole(self) -> bool {
        self == Self::Conversion
    }
}

/// A path that was called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Path {
    /// Its name, one of [`NAMES`].
    pub name: &'static str,
    /// How many operations it did `[> 0]`.
    pub operations: u64,
}

impl Path {
    /// Parses the list of called paths that a process printed.
    pub fn parse_all(group: Group, said: &str) -> Result<Vec<Self>> {
        let line = |line: &str| {
            let (name, operations) = line.split_once(' ')?;
            let name = NAMES.into_iter().find(|known| *known == name)?;
            let operations = operations.parse().ok().filter(|&operations| operations > 0)?;
            Some(Self { name, operations })
        };
        let paths: Option<Vec<Self>> = said.lines().map(line).collect();
        paths.filter(|p| !p.is_empty()).ok_or_else(|| format!("{} said {said:?}", group.name()).into())
    }
}

/// Options of a process that calls the paths.
#[derive(Debug, Clone, clap::Args)]
pub struct Calls {
    group: Group,
    /// Folder with the files
    folder: PathBuf,
}

impl Calls {
    /// Calls the paths, and prints for each its name and how many operations it did.
    pub fn run(&self) -> Result<()> {
        match self.group {
            Group::Conversion => self.convert(),
            Group::Answers => self.answer(),
        }
    }

    fn convert(&self) -> Result<()> {
        let mut options = ConvertOptions::new(vec![self.folder.join(SCAN)], self.folder.join("counted.slices"));
        options.grid.pixel = PixelSize::Metres(PIXEL_M);
        options.resources.threads = 1;
        options.overwrite = true;
        options.resources.temp_dir.clone_from(&self.folder);
        called("convert_point", convert(&options, &NoMonitor)?.header.points_read);
        Ok(())
    }

    fn answer(&self) -> Result<()> {
        let archive = Archive::from_bytes(std::fs::read(self.folder.join(ARCHIVE))?)?;
        pages(&archive)?;
        let store = Snapshot::resident(&archive, &NoMonitor)?;
        answers(&store)
    }
}

fn pages(archive: &Archive) -> Result<()> {
    let entries: Vec<_> = archive.entries().take(PAGES).collect::<slicewalk::Result<_>>()?;
    // Scratch grows with the first pages: it is there before we count.
    let mut decoder = PageDecoder::new();
    let mut decode = || entries.iter().map(|entry| archive.page_with(entry, &mut decoder)).collect::<Vec<_>>();
    decode();
    let mut pages = Vec::new();
    region("decode_page", entries.len(), &mut || pages = decode());
    let pages = pages.into_iter().collect::<slicewalk::Result<Vec<_>>>()?;
    let mut encoder = PageEncoder::new(*archive.frame());
    let mut encode = || {
        for (entry, page) in entries.iter().zip(&pages) {
            black_box(encoder.encode(entry.key, page));
        }
    };
    encode();
    region("encode_page", entries.len(), &mut encode);
    Ok(())
}

fn answers(store: &Snapshot) -> Result<()> {
    let anywhere = pawns::random(ASKED, 11);
    let along = pawns::walk(store, SKIPPED + ASKED, 12).split_off(SKIPPED);
    let mut random = Random(13);
    let way = |random: &mut Random| {
        let mut part = |far: f64| random.between(-far, far);
        Vector3::new(part(1.0), part(1.0), part(0.3))
    };
    let steps: Vec<(Aabb, Vector3<f64>)> =
        along.iter().map(|shape| (*shape, way(&mut random).normalize() * 0.1)).collect();
    let rays: Vec<Ray> =
        anywhere.iter().map(|shape| Ray::new(shape.max(), way(&mut random), 8.0)).collect::<slicewalk::Result<_>>()?;
    each("box_random", &anywhere, |shape| overlaps(store, shape));
    each("box_walk", &along, |shape| overlaps(store, shape));
    each("sweep_walk", &steps, |(shape, motion)| sweep(store, shape, *motion));
    each("floor_walk", &along, |shape| floor_under(store, shape, shape.min().z + 0.4, 2.0));
    each("ray_random", &rays, |ray| cast(store, ray));
    let body = Body::Box { x: pawns::PAWN[0], y: pawns::PAWN[1], height: pawns::PAWN[2] };
    let free = anywhere.iter().find(|shape| overlaps(store, *shape) == Overlap::Clear).ok_or("no free place")?;
    let mut walker =
        Walker::new(Config::new(body), free.min() + Vector3::new(pawns::PAWN[0], pawns::PAWN[1], 0.0) / 2.0)?;
    let mut heading = 0.3f64;
    region("walk_frame", FRAMES, &mut || {
        for _ in 0..FRAMES {
            let wish = MoveInput::Direction(Vector2::new(heading.cos(), heading.sin()));
            let report = black_box(walker.step(store, 1.0 / 60.0, wish));
            heading += if report.stop.is_some() { 2.0 } else { 0.01 };
        }
    });
    Ok(())
}

/// Calls `call` with each of `items` in the region.
fn each<T, R>(name: &'static str, items: &[T], call: impl Fn(&T) -> R) {
    region(name, items.len(), &mut || {
        for item in items {
            black_box(call(black_box(item)));
        }
    });
}

/// Region that callgrind counts. Callgrind selects it by name: it must be a function of its own with a unique name.
#[inline(never)]
fn region(name: &'static str, operations: usize, work: &mut dyn FnMut()) {
    work();
    called(name, operations as u64);
}

fn called(name: &'static str, operations: u64) {
    println!("{name} {operations}");
}
