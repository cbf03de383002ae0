//! Small archives, sources that count and fail, and a readable form of an archive's content.
#![allow(dead_code, reason = "each test file uses a part")]

pub mod content;

pub mod forge;

pub mod part;

pub mod random;

use slicewalk::archive::{Archive, ArchiveWriter, ColourReader, EncodedColours, PageEncoder, Shard, Storage, Totals};
use slicewalk::bytes::{ByteSource, MemorySource};
use slicewalk::codec::ColourEncoder;
use slicewalk::colour::{ColourPlan, ColourScale};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{Occupancy, Page, PageBuilder, Span};
use slicewalk::plan::{Classifier, Plan, PlanOptions};
use slicewalk::{Error, Result};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Pages of an archive by key.
pub type Pages = BTreeMap<PageKey, Page>;

/// Pixels of 0.1 m, slices of 0.3 m.
pub fn plan() -> Plan {
    let options = PlanOptions { classifier: Classifier::Span, ..PlanOptions::default() };
    Plan { frame: Frame::new(0.1, 0.3).unwrap(), options }
}

/// A page from spans by pixel.
pub fn page(columns: impl IntoIterator<Item = ((u32, u32), Vec<Span>)>) -> Page {
    let mut builder = PageBuilder::default();
    for ((px, py), spans) in columns {
        assert!(builder.set_column(px, py, &spans), "({px}, {py}): {spans:?}");
    }
    builder.build()
}

/// The specification's worked example.
pub fn two_pixels() -> (Pages, Totals) {
    let span = |bottom, top| vec![Span::new(bottom, top, false).unwrap()];
    let page = page([((0, 0), span(10, 14)), ((1, 0), span(12, 15))]);
    let bounds = Some(([0.04, 0.02, 0.0125], [0.13, 0.05, 0.017]));
    let totals = Totals { points_read: 3, points_kept: 3, bounds, crs: "EPSG:28992".into(), ..Totals::default() };
    (BTreeMap::from([(key(0, 0, 0), page)]), totals)
}

/// Numbers of the golden archives and samples (a linear congruential generator, constants of D. Knuth's MMIX).
pub struct Congruential(pub u64);

impl Congruential {
    /// A number below `limit`.
    pub fn below(&mut self, limit: u32) -> u32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) as u32) % limit
    }
}

/// A rough floor, a wall over two layers, and equal, uniform and sparse pages on both sides of the origin.
pub fn scene() -> (Pages, Totals) {
    let mut random = Congruential(7);
    let span = |bottom, top, obstacle| Span::new(bottom, top, obstacle).unwrap();
    let mut pages = Pages::new();
    let floor = |random: &mut Congruential| {
        page((0..20 * 30).map(|at| {
            let bottom = 700 + at % 20 * 3 + random.below(5);
            ((at % 20, 10 + at / 20), vec![span(bottom, bottom + 2 + random.below(6), false)])
        }))
    };
    pages.insert(key(-1, 0, 0), floor(&mut random));
    pages.insert(key(0, 0, 0), floor(&mut random));
    let wall = |bottom, top| page((0..64).map(|py| ((40, py), vec![span(bottom, top, true)])));
    pages.insert(key(-1, -1, -1), wall(16000, 16320));
    pages.insert(key(-1, -1, 0), wall(0, 900));
    pages.insert(key(1, 0, 0), wall(0, 900));
    let slab = page((0..4096).map(|at| ((at % 64, at / 64), vec![span(255, 600, false)])));
    pages.insert(key(0, 0, 1), slab);
    let sparse = (0..40).map(|at| {
        let px = random.below(60) / 8 * 8 + at % 8;
        let column = (0..1 + random.below(4)).map(|k| span(k * 900 + random.below(200), k * 900 + 300, at % 2 == 0));
        ((px, at), column.collect::<Vec<_>>())
    });
    pages.insert(key(2, -3, 5), page(sparse.collect::<BTreeMap<_, _>>()));
    let totals = Totals {
        points_read: 5000,
        points_kept: 4321,
        points_withheld: 9,
        points_excluded: 100,
        bounds: Some(([-6.4, -19.2, -19.2], [19.2, 6.4, 115.5])),
        crs: "a made-up place".into(),
        units: Vec::new(),
        noise: None,
    };
    (pages, totals)
}

/// The bytes of an archive with colours by a formula; every seventh voxel and every fifth page have none.
pub fn archive_with_colours(made: &(Pages, Totals), scale: ColourScale, error_milli: u16, levels: bool) -> Vec<u8> {
    archive_in_colour(&plan(), made, ColourPlan { scale, error_milli }, levels, None, |number, _, occupancy| {
        let mut random = Congruential(number as u64);
        let value = |(pixel, k): (usize, u32)| {
            let base = (pixel as u32 % 64 * 700 + k * 900) % 60_000;
            let colour =
                [base, base / 2 + 9000, 50_000 - base / 2].map(|channel| (channel + random.below(3000)) as u16);
            (random.below(7) > 0 && number % 5 < 4).then_some(colour)
        };
        occupancy.voxels().map(value).collect()
    })
}

/// Like [`archive_with_colours`], but colours depend only on the position of voxels, so that parts have the colours of
/// the whole.
pub fn archive_coloured_by_place(
    made: &(Pages, Totals),
    error_milli: u16,
    levels: bool,
    shard: Option<Shard>,
) -> Vec<u8> {
    let colours = ColourPlan { scale: ColourScale::of_rgb(255), error_milli };
    archive_in_colour(&plan(), made, colours, levels, shard, |_, key, occupancy| {
        let mut random = Congruential(key.column() ^ key.layer as u64);
        let value = |(pixel, k): (usize, u32)| {
            let [x, y] = [(key.tx, pixel & 63), (key.ty, pixel >> 6)].map(|(t, p)| (64 * t + p as i32).rem_euclid(400));
            let base = (x * 90 + y * 40) as u32 + k * 100;
            let colour = [base, 60_000 - base, base / 2 + 7000].map(|channel| (channel + random.below(4000)) as u16);
            (random.below(7) > 0 && key.tx % 5 != 3).then_some(colour)
        };
        occupancy.voxels().map(value).collect()
    })
}

/// The bytes of an archive in which `colours_of` gives the exact colours of each page's voxels, by its number and key.
pub fn archive_in_colour(
    plan: &Plan,
    (pages, totals): &(Pages, Totals),
    colours: ColourPlan,
    levels: bool,
    shard: Option<Shard>,
    mut colours_of: impl FnMut(usize, PageKey, &Occupancy) -> Vec<Option<[u16; 3]>>,
) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let mut writer = ArchiveWriter::create(&target, plan, false).unwrap();
    if levels {
        writer.set_levels();
    }
    writer.set_colours(colours);
    shard.into_iter().for_each(|shard| writer.set_shard(shard));
    let (mut encoder, mut colour_encoder) = (PageEncoder::of_plan(plan), ColourEncoder::default());
    for (number, (&key, page)) in pages.iter().enumerate() {
        let occupancy = Occupancy::of(page);
        let values = colours_of(number, key, &occupancy);
        let made = EncodedColours::new(&colours, &occupancy, &values, &mut colour_encoder);
        writer.put(key, encoder.encode(key, page).with_colours(made)).unwrap();
    }
    writer.finish(totals.clone()).unwrap();
    std::fs::read(&target).unwrap()
}

/// The bytes of an archive with one page that has bytes, and many that share them.
pub fn sharing() -> Vec<u8> {
    let span = |at| Span::new(at, at + 40, at % 2 == 0).unwrap();
    let content = page((0..300).map(|at| ((at % 64, at / 64), vec![span(at)])));
    let pages = (0..5000).map(|layer| (key(0, 0, layer), content.clone())).collect();
    archive_of(&plan(), &(pages, Totals::default()), None)
}

/// Makes a key.
pub fn key(tx: i32, ty: i32, layer: i32) -> PageKey {
    PageKey { tx, ty, layer }
}

/// The bytes of an archive.
pub fn archive(made: &(Pages, Totals)) -> Vec<u8> {
    archive_of(&plan(), made, None)
}

/// The bytes of an archive with overview levels.
pub fn archive_with_levels(plan: &Plan, (pages, totals): &(Pages, Totals), shard: Option<Shard>) -> Vec<u8> {
    written(plan, pages, totals, |writer| {
        writer.set_levels();
        shard.into_iter().for_each(|shard| writer.set_shard(shard));
    })
}

/// The bytes of an archive of a plan, or of a part of one.
pub fn archive_of(plan: &Plan, (pages, totals): &(Pages, Totals), shard: Option<Shard>) -> Vec<u8> {
    written(plan, pages, totals, |writer| shard.into_iter().for_each(|shard| writer.set_shard(shard)))
}

fn written(plan: &Plan, pages: &Pages, totals: &Totals, begin: impl FnOnce(&mut ArchiveWriter)) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("test.slices");
    let mut writer = ArchiveWriter::create(&target, plan, false).unwrap();
    begin(&mut writer);
    let mut encoder = PageEncoder::of_plan(plan);
    for (&key, page) in pages {
        writer.put(key, encoder.encode(key, page)).unwrap();
    }
    writer.finish(totals.clone()).unwrap();
    std::fs::read(&target).unwrap()
}

/// All pages of an archive, or the first error.
pub fn read_all(archive: &Archive) -> Result<Pages> {
    archive.entries().map(|entry| entry.and_then(|entry| Ok((entry.key, archive.page(&entry)?)))).collect()
}

/// Everything that an archive contains, as text.
pub fn render(archive: &Archive) -> String {
    let header = archive.header();
    let mut out = String::new();
    let mut line = |text: std::fmt::Arguments<'_>| writeln!(out, "{text}").unwrap();
    line(format_args!("version {}.{}", header.version.0, header.version.1));
    line(format_args!("pixel {} slice {}", archive.frame().pixel_m(), archive.frame().slice_m()));
    line(format_args!("slope {} tolerance {}", header.plan.options.max_slope_deg, header.plan.options.tolerance_m));
    line(format_args!("classifier {} up {:?}", header.plan.options.classifier.name(), header.plan.options.up));
    line(format_args!(
        "min_points {} exclude {:?}",
        header.plan.options.min_points,
        header.plan.options.exclude_classes.words()
    ));
    line(format_args!("plan {:032x}", header.plan_hash));
    line(format_args!(
        "points read {} kept {} withheld {} excluded {}",
        header.points_read, header.points_kept, header.points_withheld, header.points_excluded
    ));
    line(format_args!("bounds {:?}", header.bounds));
    line(format_args!("slices {:?}", header.slices));
    line(format_args!("{:?}", header.tiles));
    let voxels = &header.voxels;
    line(format_args!("Voxels {{ occupied: {}, obstacle: {} }}", voxels.occupied, voxels.obstacle));
    line(format_args!("{:?}", header.pages));
    line(format_args!("crs {}", archive.crs().unwrap()));
    let mut reader = ColourReader::new(archive).unwrap();
    if let Some(colours) = header.colours {
        line(format_args!("colours {:?} voxels {}", colours.plan, colours.voxels));
    }
    for entry in archive.entries().map(Result::unwrap) {
        let kind = match entry.storage {
            Storage::Stored(_) => "stored",
            Storage::Shared(_) => "shared",
            Storage::Uniform(_) => "uniform",
        };
        line(format_args!("page {} {kind} slices {:016x}", entry.key, entry.slices));
        if let Some(reader) = &mut reader {
            let colours = reader.colours(&entry).unwrap();
            let hash = crc32c::crc32c(colours.values().as_flattened());
            line(format_args!("  {} coloured voxels, crc {hash:08x}", colours.count()));
        }
        if let Storage::Uniform(span) = entry.storage {
            line(format_args!("  all: {span:?}"));
            continue;
        }
        for (px, py, spans) in archive.page(&entry).unwrap().columns() {
            line(format_args!("  {px},{py}: {spans:?}"));
        }
    }
    for level in archive.levels().unwrap() {
        let (number, level) = (level.number(), archive.level(level.number()).unwrap());
        let Some(mut reader) = ColourReader::new(&level).unwrap() else { continue };
        for entry in level.entries().map(Result::unwrap) {
            let colours = reader.colours(&entry).unwrap();
            let hash = crc32c::crc32c(colours.values().as_flattened());
            line(format_args!(
                "level {number} page {}: {} coloured voxels, crc {hash:08x}",
                entry.key,
                colours.count()
            ));
        }
    }
    out
}

/// Counts reads, and fails one of them.
pub struct Watched {
    source: MemorySource,
    /// Number of reads.
    pub reads: AtomicU64,
    /// Index of the read that fails.
    pub fails: u64,
}

impl Watched {
    /// A source of `bytes` that fails read number `fails`.
    pub fn new(bytes: &[u8], fails: u64) -> Arc<Self> {
        Arc::new(Self { source: MemorySource::new(bytes), reads: AtomicU64::new(0), fails })
    }
}

impl ByteSource for Watched {
    fn len(&self) -> u64 {
        self.source.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        if self.reads.fetch_add(1, Ordering::Relaxed) == self.fails {
            return Err(Error::io("test", "read", std::io::ErrorKind::Other.into()));
        }
        self.source.read_at(offset, buf)
    }
}
