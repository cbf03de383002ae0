//! How many bytes scans take: as LAZ, as pictures of their slices, as an octree of cubes, and as slice archives of
//! several tolerances; what the scenes needed; and how fast archives open and decode.
//!
//! Out: `size.md`. All but its times are the same on every run.

mod cubes;
mod noise;
mod octree;
pub(crate) mod pictures;
mod planes;
mod reads;

use crate::stability::Result;
use crate::stability::table::{Table, number, percent, spread};
pub use cubes::Cubes;
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, PageDecoder, Storage};
use slicewalk::stats::{Need, Stats};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Real scans, their point spacing (m) as measured over all points, and metres to a unit.
const SCANS: [(&str, f64, f64); 8] = [
    ("indoor_two_storey_zup", 0.0165, 1.0),
    ("room_single_station", 0.037, 1.0),
    ("corridor_three_stations", 0.0164, 1.0),
    ("pump_room", 0.00557, 1.0),
    ("delft_city_block_ahn3", 0.265, 1.0),
    ("isprs_csite2_town", 0.142, 1.0),
    ("forest_plot_tls", 0.0425, 1.0),
    ("autzen_stadium", 0.28, 0.3048),
];
/// Generated scenes, pixel size (m; doubled while there would be too many points) and noise of the scanner (m).
const SCENES: [(&str, f64, f64); 7] = [
    ("house", 0.05, 0.003),
    ("house", 0.05, 0.0),
    ("church", 0.1, 0.003),
    ("church", 0.1, 0.0),
    ("columns", 0.1, 0.0),
    ("street", 0.1, 0.003),
    ("terrain", 0.2, 0.003),
];
/// Points to a side of a pixel in generated scans: `t` is four times their spacing.
const PER_PIXEL: f64 = 4.0;
const MAX_POINTS: f64 = 8e6;
const RUNS: usize = 7;

/// A scan to measure.
struct Case {
    name: String,
    file: PathBuf,
    pixel_m: f64,
    units: Units,
}

/// Figures of a run, besides its page.
pub struct Sizes {
    /// Identical cubes beside other coders.
    pub cubes: Vec<Cubes>,
    /// Decoding of the real scans.
    pub decoding: Vec<Decoding>,
}

/// Decoding of all pages of a scan.
pub struct Decoding {
    /// Name of the scan.
    pub name: String,
    /// Time of a span: median, least and greatest (ns).
    pub span_ns: [f64; 3],
}

/// An archive and what is in it.
struct Made {
    archive: Archive,
    stats: Stats,
    bytes: u64,
}

/// Measures, and writes `size.md` into `out`.
pub fn run(out: &Path, quick: bool) -> Result<Sizes> {
    let folder = tempfile::tempdir()?;
    let cases = cases(folder.path(), quick)?;
    let mut sizes = Table::new([
        "scan",
        "t (m)",
        "LAZ",
        "PNG",
        "PNG, both heights",
        "octree",
        "archive",
        "1 cm",
        "t/4",
        "t",
        "of LAZ",
        "of PNG",
        "of PNG, both",
        "t/4 of PNG, both",
        "of octree",
        "bytes a voxel",
    ]);
    let mut needs =
        Table::new(["scan", "tolerance", "slices", "distinct"].into_iter().chain(Need::ALL.map(Need::name)).chain([
            "free",
            "free with walls",
            "dense tiles",
        ]));
    let mut noises = Table::new([
        "scan",
        "spans",
        "smooth",
        "noise of a bottom (bits)",
        "of a thickness",
        "both",
        "archive, a span (bits)",
        "1/4 of PNG, both, a span",
    ]);
    let mut times = Table::new([
        "scan",
        "open (us)",
        "pages",
        "decode (ms)",
        "us a page",
        "ns a span",
        "raster (GB/s)",
        "byte planes, of the pages",
        "ns a span",
    ]);
    let mut decoding = Vec::new();
    let mut walks = Table::new(["scan", "pages read", "tiles walked through", "pages to tiles"]);
    for case in &cases {
        eprintln!("{}", case.name);
        let exact = make(case, 0.0, folder.path())?;
        let coarser = [0.01, case.pixel_m / 4.0, case.pixel_m].map(|tolerance| make(case, tolerance, folder.path()));
        let [centimetre, quarter, pixel] = coarser;
        let (centimetre, quarter, pixel) = (centimetre?, quarter?, pixel?);
        let laz = std::fs::metadata(&case.file)?.len();
        let [png, png_both] = pictures::bytes(&exact.archive)?;
        let octree = octree::bytes(&case.file, case.units, case.pixel_m)?;
        let share = |bytes: u64, of: u64| number(bytes as f64 / of as f64, 3);
        let voxels = exact.stats.voxels;
        sizes.row([
            case.name.clone(),
            number(case.pixel_m, 3),
            laz.to_string(),
            png.to_string(),
            png_both.to_string(),
            octree.to_string(),
            exact.bytes.to_string(),
            centimetre.bytes.to_string(),
            quarter.bytes.to_string(),
            pixel.bytes.to_string(),
            share(exact.bytes, laz),
            share(exact.bytes, png),
            share(exact.bytes, png_both),
            share(quarter.bytes, png_both),
            share(exact.bytes, octree),
            share(exact.bytes, voxels),
        ]);
        for (name, made) in [("0", &exact), ("t/4", &quarter)] {
            needs.row(need_row(case, name, made));
        }
        noises.row(noise_row(case, &exact, png_both)?);
        let (row, span_ns) = time_row(case, &exact)?;
        times.row(row);
        decoding.push(Decoding { name: case.name.clone(), span_ns });
        if let Some(walk) = reads::along_walk(&case.name, &exact.archive)? {
            walks.row([
                case.name.clone(),
                walk.pages.to_string(),
                walk.tiles.to_string(),
                percent(walk.pages as f64 / walk.tiles as f64),
            ]);
        }
    }
    // Generated scenes come after the real scans.
    decoding.truncate(if quick { 2 } else { SCANS.len() });
    let (beside_others, cubes) = cubes::measure(folder.path(), quick)?;
    let page = format!(
        "{}\n{}\n\n## Cubes\n\n{}\n\n{}\n\n## What no coder can save\n\n{}\n\n{}\n\n## What the scenes needed\n\n{}\n\n{}\n\n## Opening and decoding\n\n{}\n\n{}\n\n## Reads along a walk\n\n{}\n\n{}\n",
        include_str!("head.md"),
        sizes.markdown(),
        include_str!("cubes.md").trim_end(),
        beside_others.markdown(),
        include_str!("noise.md").trim_end(),
        noises.markdown(),
        include_str!("needs.md").trim_end(),
        needs.markdown(),
        include_str!("times.md").trim_end(),
        times.markdown(),
        include_str!("reads.md").trim_end(),
        walks.markdown(),
    );
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("size.md"), page)?;
    Ok(Sizes { cubes, decoding })
}

fn cases(folder: &Path, quick: bool) -> Result<Vec<Case>> {
    let mut cases = Vec::new();
    for (name, spacing_m, unit) in &SCANS[..if quick { 2 } else { SCANS.len() }] {
        let Some(file) = crate::data::file(&format!("{name}.laz")) else { continue };
        // Two digits, as `--pixel auto` rounds.
        let pixel_m = format!("{:.1e}", 4.0 * spacing_m).parse()?;
        let units = if *unit == 1.0 { Units::Auto } else { Units::Factor(*unit) };
        cases.push(Case { name: (*name).to_owned(), file, pixel_m, units });
    }
    for &(name, mut pixel_m, noise_m) in &SCENES[..if quick { 1 } else { SCENES.len() }] {
        let scene = Scene::named(name, &Params::new())?;
        while scene.area() * (PER_PIXEL / pixel_m).powi(2) > MAX_POINTS {
            pixel_m *= 2.0;
        }
        let spec = SampleSpec::direct_density((PER_PIXEL / pixel_m).powi(2)).with_noise(noise_m);
        let noise = if noise_m > 0.0 { format!("noise {} mm", number(noise_m * 1e3, 0)) } else { "no noise".into() };
        let file = folder.join(format!("{name}-{noise_m}.laz"));
        write_samples(&file, scene.samples(5, &spec)?, &WriteSpec::for_path(&file))?;
        cases.push(Case { name: format!("{name}, {noise}"), file, pixel_m, units: Units::Auto });
    }
    Ok(cases)
}

fn make(case: &Case, tolerance_m: f64, folder: &Path) -> Result<Made> {
    make_slices(case, tolerance_m, None, folder)
}

/// Converts with slices of this height, by default three pixels.
fn make_slices(case: &Case, tolerance_m: f64, slice_m: Option<f64>, folder: &Path) -> Result<Made> {
    let output = folder.join("made.slices");
    let mut options = ConvertOptions::new(vec![case.file.clone()], output.clone());
    options.grid.pixel = PixelSize::Metres(case.pixel_m);
    options.grid.slice_m = slice_m;
    options.reading.units = case.units;
    options.plan.tolerance_m = tolerance_m;
    options.overwrite = true;
    options.resources.temp_dir = folder.to_owned();
    let header = convert(&options, &NoMonitor)?.header;
    let archive = Archive::from_bytes(std::fs::read(output)?)?;
    Ok(Made { stats: Stats::of(&archive)?, archive, bytes: header.file_len })
}

fn need_row(case: &Case, tolerance: &str, made: &Made) -> Vec<String> {
    let stats = &made.stats;
    let tiles: u64 = stats.needs.iter().sum();
    let free = |counts: &[u64; 6]| {
        let free: u64 = Need::ALL.iter().zip(counts).filter(|(need, _)| need.is_free()).map(|(_, n)| n).sum();
        percent(free as f64 / counts.iter().sum::<u64>().max(1) as f64)
    };
    let slices = made.archive.header().slices.map_or(0, |(low, high)| high - low + 1);
    // A byte for each height, and a bit for each obstacle.
    let dense = tiles * (64 * 64 + 64 * 64 / 8);
    [case.name.clone(), tolerance.into(), slices.to_string(), stats.distinct_slices.to_string()]
        .into_iter()
        .chain(stats.needs.iter().map(u64::to_string))
        .chain([
            free(&stats.needs),
            free(&stats.wall_needs),
            format!("{} ×", number(dense as f64 / made.bytes as f64, 0)),
        ])
        .collect()
}

fn noise_row(case: &Case, made: &Made, png: u64) -> Result<Vec<String>> {
    let noise = noise::of(&made.archive)?;
    let bits_a_span = |bytes: f64| number(bytes * 8.0 / noise.spans.max(1) as f64, 1);
    Ok(vec![
        case.name.clone(),
        noise.spans.to_string(),
        percent(noise.smooth as f64 / noise.spans.max(1) as f64),
        number(noise.bottom_bits, 1),
        number(noise.thickness_bits, 1),
        number(noise.bottom_bits + noise.thickness_bits, 1),
        bits_a_span(made.bytes as f64),
        bits_a_span(png as f64 / 4.0),
    ])
}

/// Row of times, and those of decoding a span (ns).
fn time_row(case: &Case, made: &Made) -> Result<(Vec<String>, [f64; 3])> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("open.slices");
    let mut bytes = vec![0; made.archive.source().len() as usize];
    made.archive.source().read_at(0, &mut bytes)?;
    std::fs::write(&path, &bytes)?;
    let mut open = Vec::new();
    let mut decode = Vec::new();
    let (mut decoder, mut planes) = (PageDecoder::new(), planes::Planes::new()?);
    let (mut packed, mut in_planes) = (Vec::new(), 0);
    for entry in made.archive.entries() {
        let entry = entry?;
        let page = made.archive.page_with(&entry, &mut decoder)?;
        packed.push(planes.pack(&page)?);
        if matches!(entry.storage, Storage::Stored(_)) {
            in_planes += packed[packed.len() - 1].len();
        }
        let again = planes.unpack(&packed[packed.len() - 1])?;
        assert!(page.columns().eq(again.columns()), "byte planes lost something");
    }
    let mut unpack = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        let archive = Archive::open(&path)?;
        open.push(start.elapsed().as_secs_f64());
        let start = Instant::now();
        for entry in archive.entries() {
            std::hint::black_box(archive.page_with(&entry?, &mut decoder)?);
        }
        decode.push(start.elapsed().as_secs_f64());
        let start = Instant::now();
        for page in &packed {
            std::hint::black_box(planes.unpack(page)?);
        }
        unpack.push(start.elapsed().as_secs_f64());
    }
    let spans = made.stats.spans.max(1) as f64;
    let span_ns = spread(&decode).map(|seconds| seconds * 1e9 / spans);
    let [open, decode, unpack] = [&open, &decode, &unpack].map(|times| spread(times)[0]);
    let pages = made.stats.pages.iter().sum::<u64>();
    // Memory of a program that keeps rasters: bottom, top and a bit of kind in each pixel of each tile.
    let raster = made.stats.needs.iter().sum::<u64>() as f64 * 4096.0 * 2.125;
    let row = vec![
        case.name.clone(),
        number(open * 1e6, 0),
        pages.to_string(),
        number(decode * 1e3, 2),
        number(decode * 1e6 / pages.max(1) as f64, 0),
        format!("{:.0} ({:.0}–{:.0})", span_ns[0], span_ns[1], span_ns[2]),
        number(raster / decode / 1e9, 2),
        number(in_planes as f64 / made.archive.header().bytes.pages as f64, 2),
        number(unpack * 1e9 / spans, 0),
    ];
    Ok((row, span_ns))
}
