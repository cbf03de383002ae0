//! Conversions of LAS and LAZ files beside reading alone, in turns, and conversions of scans with few points a voxel.

use crate::reading::read_las;
use crate::stability::Result;
use crate::stability::table::{Table, number, spread};
use laz::{LazVlr, ParLasZipDecompressor};
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::store::Snapshot;
use slicewalk_convert::{AUTO_PIXEL_SPACINGS, ConvertOptions, PixelSize, convert};
use slicewalk_input::spacing::estimate_spacing;
use slicewalk_input::{InputOptions, InputSet, PointDecoder, Units};
use std::fs::File;
use std::hint::black_box;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

const HOUSE_PIXEL_M: f64 = 0.05;
const RUNS: usize = 7;
/// Points that a call of `laz` decodes.
const SLAB: u64 = 1_000_000;
const SCANS: [&str; 3] = ["autzen_stadium.laz", "delft_city_block_ahn3.laz", "indoor_two_storey_zup.laz"];

/// Pixels (m) of scans with few points a voxel, and conversions of each.
const SPARSE_PIXEL_M: f64 = 0.1;
const SPARSE_RUNS: usize = 3;

/// A LAZ file: its name, its number of points, and the time of its conversion, of that of decoding alone.
pub struct Laz {
    pub name: String,
    pub points: u64,
    pub of_decoding: [f64; 3],
}

/// A scan with few points a voxel.
pub struct Sparse {
    pub name: &'static str,
    /// Voxels of the archive.
    pub voxels: u64,
    /// Time of a conversion by one thread (µs a voxel).
    pub us: [f64; 3],
    /// Memory of all pages (bytes a voxel).
    pub bytes: f64,
}

/// Converts a LAS file and LAZ files beside reading alone. Returns the table, and the figures of LAZ.
pub fn beside_reading(folder: &Path, quick: bool) -> Result<(Table, Vec<Laz>)> {
    let (las_points, laz_points) = if quick { (200_000, 100_000) } else { (20_000_000, 3_000_000) };
    let mut table = Table::new(["file", "points", "", "seconds", "fastest to slowest", "M points/s", "of the first"]);
    let las = house(&folder.join("house.las"), las_points)?;
    compare(&mut table, "house, LAS", &las, HOUSE_PIXEL_M, quick, |path, _| read_las(path))?;
    let laz = house(&folder.join("house.laz"), laz_points)?;
    let mut files = vec![("house".to_owned(), laz, HOUSE_PIXEL_M)];
    for name in if quick { &[][..] } else { &SCANS } {
        let Some(scan) = crate::data::file(name) else { continue };
        let pixel_m = chosen_pixel(&scan)?;
        files.push((name.trim_end_matches(".laz").to_owned(), scan, pixel_m));
    }
    let mut found = Vec::new();
    for (name, file, pixel_m) in files {
        let (points, of_decoding) = compare(&mut table, &name, &file, pixel_m, quick, |path, _| decode_laz(path))?;
        found.push(Laz { name, points, of_decoding });
    }
    Ok((table, found))
}

/// Converts scans of one point a voxel and fewer.
pub fn sparse(folder: &Path, quick: bool) -> Result<Vec<Sparse>> {
    let count = if quick { 100 } else { 1 };
    let shrunk = |metres: f64| metres / f64::from(count).sqrt();
    let level = Params::new().with("size", shrunk(671.0));
    let rough = Params::new().with("size", shrunk(474.0));
    let towers = Params::new().with("width", if quick { 60.0 } else { 200.0 }).with("depth", 150.0);
    let points = |millions: u64| SampleSpec::direct_count(millions * 1_000_000 / count as u64);
    let scans = [
        ("level ground", Scene::named("uniform", &level)?, points(20)),
        ("rough ground", Scene::named("uniform", &rough)?, points(10).with_noise(0.02)),
        ("towers", Scene::named("extent", &towers)?, SampleSpec::direct_density(40.0)),
    ];
    let (file, output) = (folder.join("sparse.las"), folder.join("sparse.slices"));
    let mut found = Vec::new();
    for (name, scene, spec) in scans {
        eprintln!("{name}");
        write_samples(&file, scene.samples(1, &spec)?, &WriteSpec::for_path(&file))?;
        let mut seconds = Vec::new();
        for _ in 0..if quick { 1 } else { SPARSE_RUNS } {
            let start = Instant::now();
            convert_file(&file, &output, SPARSE_PIXEL_M, 1)?;
            seconds.push(start.elapsed().as_secs_f64());
        }
        let archive = Archive::open(&output)?;
        let voxels = archive.header().voxels.occupied;
        let store = Snapshot::resident(&archive, &NoMonitor)?;
        let bytes = (store.weight_bytes() + store.table_bytes()) as f64 / voxels as f64;
        found.push(Sparse { name, voxels, us: spread(&seconds).map(|s| s * 1e6 / voxels as f64), bytes });
    }
    Ok(found)
}

/// The pixel size that is chosen for a scan (in its own unit).
fn chosen_pixel(path: &Path) -> Result<f64> {
    let options = InputOptions { units: Units::Factor(1.0), ..InputOptions::default() };
    let set = InputSet::open(&[path.to_owned()], options, &NoMonitor)?;
    Ok(AUTO_PIXEL_SPACINGS * estimate_spacing(&set, 1, &NoMonitor)?.spacing_m)
}

fn house(path: &Path, points: u64) -> Result<PathBuf> {
    let scene = Scene::named("house", &Params::new())?;
    let samples = scene.samples(1, &SampleSpec::direct_count(points).with_noise(0.002))?;
    write_samples(path, samples, &WriteSpec::for_path(path))?;
    Ok(path.to_owned())
}

/// Reads and converts a file in turns. Returns its number of points, and the time of a conversion of that of `bare`, a round
/// at a time.
fn compare(
    table: &mut Table,
    name: &str,
    path: &Path,
    pixel_m: f64,
    quick: bool,
    bare: impl Fn(&Path, usize) -> Result<u64>,
) -> Result<(u64, [f64; 3])> {
    eprintln!("{name}");
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let folder = tempfile::tempdir()?;
    let output = folder.path().join("scan.slices");
    let points = bare(path, threads)?;
    let contestants: [(&str, &dyn Fn() -> Result<u64>); 4] = [
        ("the format's crate alone", &|| bare(path, threads)),
        ("our reading alone", &|| read_ours(path, threads)),
        ("conversion", &|| convert_file(path, &output, pixel_m, threads)),
        ("conversion, one thread", &|| convert_file(path, &output, pixel_m, 1)),
    ];
    let mut seconds = [const { Vec::new() }; 4];
    for _ in 0..if quick { 1 } else { RUNS } {
        for ((what, run), seconds) in contestants.iter().zip(&mut seconds) {
            let start = Instant::now();
            let read = run()?;
            seconds.push(start.elapsed().as_secs_f64());
            if read != points {
                return Err(format!("{name}: {what} read {read} of {points} points").into());
            }
        }
    }
    let ratios: Vec<[f64; 3]> = seconds
        .iter()
        .map(|own| spread(&own.iter().zip(&seconds[0]).map(|(own, bare)| own / bare).collect::<Vec<_>>()))
        .collect();
    for (((what, _), seconds), ratio) in contestants.iter().zip(&seconds).zip(&ratios) {
        let [median, fastest, slowest] = spread(seconds);
        table.row([
            format!("{name}, {pixel_m:.2}"),
            points.to_string(),
            (*what).to_owned(),
            number(median, 3),
            format!("{fastest:.3}–{slowest:.3}"),
            number(points as f64 / median / 1e6, 1),
            number(ratio[0], 2),
        ]);
    }
    Ok((points, ratios[2]))
}

/// Decodes all points with `laz`'s parallel decoder, and looks at nothing.
fn decode_laz(path: &Path) -> Result<u64> {
    let reader = las::Reader::from_path(path)?;
    let header = reader.header();
    let (points, format) = (header.number_of_points(), *header.point_format());
    let vlr = header.vlrs().iter().chain(header.evlrs()).find(|vlr| vlr.user_id == "laszip encoded");
    let vlr = LazVlr::from_buffer(&vlr.ok_or("no LASzip record")?.data)?;
    let mut file = BufReader::new(File::open(path)?);
    let mut start = [0; 4];
    file.seek(SeekFrom::Start(96))?;
    file.read_exact(&mut start)?;
    file.seek(SeekFrom::Start(u64::from(u32::from_le_bytes(start))))?;
    let mut decoder = ParLasZipDecompressor::new(file, vlr)?;
    let mut slab = vec![0u8; usize::from(format.len()) * SLAB as usize];
    let mut left = points;
    while left > 0 {
        let count = left.min(SLAB);
        decoder.decompress_many(&mut slab[..count as usize * usize::from(format.len())])?;
        left -= count;
    }
    black_box(&slab);
    Ok(points)
}

/// Reads all points by Slicewalk's readers, on `threads` threads.
fn read_ours(path: &Path, threads: usize) -> Result<u64> {
    let options = InputOptions { units: Units::Factor(1.0), ..InputOptions::default() };
    let set = InputSet::open(&[path.to_owned()], options, &NoMonitor)?;
    let chunks = Mutex::new(set.chunks());
    let work = || -> Result<u64> {
        let (mut decoder, mut count) = (PointDecoder::new(), 0);
        loop {
            let Some(chunk) = chunks.lock().expect("no panic").next() else { return Ok(count) };
            let looked_at = decoder.decode(&set, &chunk, &mut |batch| {
                black_box(batch);
                Ok(())
            })?;
            count += looked_at.read;
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        workers.into_iter().map(|worker| worker.join().expect("no panic")).sum()
    })
}

fn convert_file(path: &Path, output: &Path, pixel_m: f64, threads: usize) -> Result<u64> {
    let mut options = ConvertOptions::new(vec![path.to_owned()], output.to_owned());
    options.grid.pixel = PixelSize::Metres(pixel_m);
    options.reading.units = Units::Factor(1.0);
    options.resources.threads = threads;
    options.resources.temp_dir = output.parent().ok_or("no folder")?.to_owned();
    options.overwrite = true;
    Ok(convert(&options, &NoMonitor)?.header.points_read)
}
