//! Conversion against reading alone, side by side in one run: `cargo bench --manifest-path tools/lab/Cargo.toml --bench convert`.
//!
//! Prints the time of reading every coordinate of a LAS and a LAZ file with the format's own crates on all cores, the
//! time of `slicewalk`'s reading alone, the time of a whole conversion, and the ratios. Runs of all contestants
//! alternate, so that other load slows all of them alike; the figure is the median, followed by the fastest and
//! slowest.
//! slowest.
//!
//! If real scans are available, they follow at the pixel size that `sliceconv` chooses. `SLICEWALK_BENCH_LAS` and
//! `SLICEWALK_BENCH_LAZ` name files to use instead of generated ones. `cargo test` runs each contestant once on little
//! data.

use bench::reading::read_las;
use laz::{LazVlr, ParLasZipDecompressor};
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk_convert::{AUTO_PIXEL_SPACINGS, ConvertOptions, PixelSize, convert};
use slicewalk_input::spacing::estimate_spacing;
use slicewalk_input::{InputOptions, InputSet, PointDecoder, Units};
use std::fs::File;
use std::hint::black_box;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::Instant;

const PIXEL_M: f64 = 0.05;
const RUNS: usize = 7;
const SCANS: [&str; 3] = ["autzen_stadium.laz", "delft_city_block_ahn3.laz", "indoor_two_storey_zup.laz"];

fn main() {
    // Only `cargo bench` says so.
    let smoke = std::env::args().all(|argument| argument != "--bench");
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (las_points, laz_points, runs) = if smoke { (200_000, 100_000, 1) } else { (20_000_000, 3_000_000, RUNS) };
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    println!(
        "conversion, at {PIXEL_M} m where nothing else is said, on {threads} threads, {runs} alternating runs each; median (fastest to slowest)"
    );

    let las = std::env::var_os("SLICEWALK_BENCH_LAS").map(PathBuf::from);
    let las = las.unwrap_or_else(|| generate(&dir.path().join("house.las"), las_points));
    compare("LAS", &las, PIXEL_M, runs, threads, |path, _| read_las(path).expect("a LAS file"));

    let laz = std::env::var_os("SLICEWALK_BENCH_LAZ").map(PathBuf::from);
    let laz = laz.unwrap_or_else(|| generate(&dir.path().join("house.laz"), laz_points));
    compare("LAZ", &laz, PIXEL_M, runs, threads, |path, _| decode_laz(path));
    for name in if smoke { &[][..] } else { &SCANS } {
        let Some(scan) = bench::data::file(name) else { continue };
        let pixel_m = chosen_pixel(&scan);
        compare(&format!("{name} at {pixel_m:.3} m"), &scan, pixel_m, runs, threads, |path, _| decode_laz(path));
    }
}

/// The pixel size that is chosen for a scan (in its own unit).
fn chosen_pixel(path: &Path) -> f64 {
    let options = InputOptions { units: Units::Factor(1.0), ..InputOptions::default() };
    let set = InputSet::open(&[path.to_owned()], options, &NoMonitor).expect("a scan");
    AUTO_PIXEL_SPACINGS * estimate_spacing(&set, 1, &NoMonitor).expect("points").spacing_m
}

fn generate(path: &Path, points: u64) -> PathBuf {
    let scene = Scene::named("house", &Params::new()).expect("the house has defaults");
    let samples = scene.samples(1, &SampleSpec::direct_count(points).with_noise(0.002)).expect("a valid sample");
    write_samples(path, samples, &WriteSpec::for_path(path)).expect("a writable temporary folder");
    path.to_owned()
}

fn compare(name: &str, path: &Path, pixel_m: f64, runs: usize, threads: usize, bare: impl Fn(&Path, usize) -> u64) {
    let bytes = std::fs::metadata(path).expect("the file").len();
    let points = bare(path, threads);
    println!("\n{name}: {} points, {bytes} bytes", points);
    let contestants: [(&str, &dyn Fn() -> u64); 4] = [
        ("bare crates", &|| bare(path, threads)),
        ("our reading", &|| read_ours(path, threads)),
        ("conversion", &|| convert_file(path, pixel_m, threads)),
        ("conversion, 1 thread", &|| convert_file(path, pixel_m, 1)),
    ];
    let mut seconds = [const { Vec::new() }; 4];
    for _ in 0..runs {
        for (contestant, seconds) in contestants.iter().zip(&mut seconds) {
            let started = Instant::now();
            assert_eq!(black_box(contestant.1()), points, "{} read another number of points", contestant.0);
            seconds.push(started.elapsed().as_secs_f64());
        }
    }
    let mut bare_median = 0.0;
    for ((contestant, _), seconds) in contestants.iter().zip(&mut seconds) {
        seconds.sort_by(f64::total_cmp);
        let (fastest, median, slowest) = (seconds[0], seconds[seconds.len() / 2], seconds[seconds.len() - 1]);
        if bare_median == 0.0 {
            bare_median = median;
        }
        println!(
            "{contestant:<21} {median:8.3} s ({fastest:.3} to {slowest:.3})  {:7.2} M points/s  {:6.3} × the time of bare",
            points as f64 / median / 1e6,
            median / bare_median
        );
    }
}

/// Decodes all points with `laz`'s parallel decoder, and looks at nothing.
fn decode_laz(path: &Path) -> u64 {
    let reader = las::Reader::from_path(path).expect("a LAZ file");
    let header = reader.header();
    let (points, format) = (header.number_of_points(), *header.point_format());
    let vlr = header.vlrs().iter().chain(header.evlrs()).find(|vlr| vlr.user_id == "laszip encoded");
    let vlr = LazVlr::from_buffer(&vlr.expect("the LASzip record").data).expect("a sound LASzip record");
    let mut file = BufReader::new(File::open(path).expect("the file"));
    let mut start = [0; 4];
    file.seek(SeekFrom::Start(96)).and_then(|_| file.read_exact(&mut start)).expect("a header");
    file.seek(SeekFrom::Start(u64::from(u32::from_le_bytes(start)))).expect("points");
    let mut decoder = ParLasZipDecompressor::new(file, vlr).expect("a decoder");
    let mut slab = vec![0u8; usize::from(format.len()) * 1_000_000];
    let mut left = points;
    while left > 0 {
        let count = left.min(1_000_000) as usize;
        decoder.decompress_many(&mut slab[..count * usize::from(format.len())]).expect("points");
        left -= count as u64;
    }
    black_box(&slab);
    points
}

/// Reads all points by this crate's input, on `threads` threads.
fn read_ours(path: &Path, threads: usize) -> u64 {
    let options = InputOptions { units: Units::Factor(1.0), ..InputOptions::default() };
    let set = InputSet::open(&[path.to_owned()], options, &NoMonitor).expect("a scan");
    let chunks = std::sync::Mutex::new(set.chunks());
    let work = || {
        let (mut decoder, mut count) = (PointDecoder::new(), 0);
        loop {
            let Some(chunk) = chunks.lock().expect("no panic").next() else { return count };
            count += decoder
                .decode(&set, &chunk, &mut |batch| {
                    black_box(batch);
                    Ok(())
                })
                .expect("points")
                .read;
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        workers.into_iter().map(|worker| worker.join().expect("no panic")).sum()
    })
}

fn convert_file(path: &Path, pixel_m: f64, threads: usize) -> u64 {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let mut options = ConvertOptions::new(vec![path.to_owned()], dir.path().join("scan.slices"));
    options.grid.pixel = PixelSize::Metres(pixel_m);
    options.reading.units = Units::Factor(1.0);
    options.resources.threads = threads;
    options.resources.temp_dir = dir.path().to_owned();
    convert(&options, &NoMonitor).expect("a conversion").header.points_read
}
