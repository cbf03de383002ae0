//! Speed and memory of the formats that scanners deliver: E57 beside its own crate, text in bytes a second.
//!
//! Out: `inputs.md`. Fails where a figure misses its limit, unless samples are small.

use crate::measured::Conversion;
use crate::scale::machine;
use crate::scale::town::{SURFACE_M2, Town};
use crate::stability::Result;
use crate::stability::table::{Table, number, spread};
use e57::E57Reader;
use scangen::write::CloudFormat;
use slicewalk::NoMonitor;
use slicewalk_input::{InputOptions, InputSet, PointDecoder};
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

/// The words at the top of the page.
const HEAD: &str = include_str!("head.md");
/// Points on a square metre, and the pixel that an automatic choice takes for them (m).
const DENSITY: u64 = 1600;
const PIXEL_M: f64 = 0.1;
/// Budget of a conversion, and what it may take beyond (bytes).
const MEMORY: u64 = 256 << 20;
const BEYOND: u64 = 64 << 20;
/// Conversion of E57 in times of the speed of the crate, at least.
const LEAST_RATIO: f64 = 0.8;
/// Text that a core reads in a second, at least (bytes).
const LEAST_TEXT: f64 = 100e6;
const ROUNDS: usize = 5;

/// Options of the measurement.
#[derive(Debug, Clone, clap::Args)]
pub struct Inputs {
    /// Small samples: a check that everything runs
    #[arg(long)]
    quick: bool,
    /// Folder to write into [default: tools/lab/results, or target/bench-quick with --quick]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Parts to measure [default: all]
    #[arg(long, value_delimiter = ',')]
    only: Vec<Part>,
    /// Folder for scans and archives, which are deleted; about 4 GB
    #[arg(long, default_value_os_t = std::env::temp_dir())]
    work: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Part {
    /// Time beside bare reading
    Speed,
    /// Peak memory of large files
    Memory,
}

impl Inputs {
    /// Measures, and writes.
    pub fn run(&self) -> Result<()> {
        let default = if self.quick { "target/bench-quick" } else { "tools/lab/results" };
        let out = self.out.clone().unwrap_or_else(|| default.into());
        std::fs::create_dir_all(&out)?;
        let work = tempfile::tempdir_in(&self.work)?;
        let mut page = format!("{HEAD}\n{}\n\n", machine());
        let mut missed = Vec::new();
        let has = |part: Part| self.only.is_empty() || self.only.contains(&part);
        if has(Part::Speed) {
            page += &self.e57_speed(work.path(), &mut missed)?;
            page += &self.text_speed(work.path(), &mut missed)?;
        }
        if has(Part::Memory) {
            page += &self.memory(work.path(), &mut missed)?;
        }
        let page = page.trim_end().to_owned() + "\n";
        println!("{page}");
        if self.only.is_empty() {
            std::fs::write(out.join("inputs.md"), page)?;
        }
        match missed.is_empty() || self.quick {
            true => Ok(()),
            false => Err(format!("limits missed: {}", missed.join("; ")).into()),
        }
    }

    fn rounds(&self) -> usize {
        if self.quick { 1 } else { ROUNDS }
    }

    /// Writes a town of about `points` points in this format; returns their number.
    fn town(&self, path: &Path, points: u64, clouds: u64) -> Result<u64> {
        let points = if self.quick { points / 100 } else { points };
        let town = Town::new(points / (DENSITY * SURFACE_M2));
        let format = CloudFormat::of(path).ok_or("no format of clouds")?;
        town.write_clouds(path, format, DENSITY, points / clouds + 1)
    }

    fn e57_speed(&self, work: &Path, missed: &mut Vec<String>) -> Result<String> {
        let path = work.join("town.e57");
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        let points = self.town(&path, 10_000_000, 4 * threads as u64)?;
        let bytes = path.metadata()?.len();
        let archive = work.join("town.slices");
        let [mut crate_s, mut read_s, mut converted_s] = [const { Vec::new() }; 3];
        read_by_crate(&path, threads)?;
        for _ in 0..self.rounds() {
            crate_s.push(timed(points, || read_by_crate(&path, threads))?);
            read_s.push(timed(points, || read_by_slicewalk(&path, threads))?);
            let measured = Conversion::new(&path, &archive, false, PIXEL_M).watched()?.0;
            check(points, measured.points_read)?;
            converted_s.push(measured.seconds);
        }
        std::fs::remove_file(&path)?;
        let rate = |seconds: &[f64]| number(points as f64 / 1e6 / spread(seconds)[0], 1);
        let ratio = |seconds: &[f64]| {
            let ratios: Vec<f64> = crate_s.iter().zip(seconds).map(|(bare, own)| bare / own).collect();
            spread(&ratios)[0]
        };
        let mut table = Table::new(["what", "M points/s", "of the crate's speed"]);
        table.row(["crate `e57`, raw values", &rate(&crate_s), "1"]);
        table.row(["`InputSet`, coordinates", &rate(&read_s), &number(ratio(&read_s), 2)]);
        table.row(["`sliceconv`, whole conversion", &rate(&converted_s), &number(ratio(&converted_s), 2)]);
        if ratio(&converted_s) < LEAST_RATIO {
            missed.push(format!("conversion of E57 at {:.2} of the crate's speed", ratio(&converted_s)));
        }
        Ok(format!(
            "## E57\n\n{} M points in {} clouds, {} MB: scaled integers of 32 bits, intensity and colours. All on {threads} threads, in \
             turn, medians of {} rounds; the crate reads a cloud on one thread.\n\n{}\n\n",
            number(points as f64 / 1e6, 1),
            4 * threads,
            number(bytes as f64 / 1e6, 0),
            self.rounds(),
            table.markdown()
        ))
    }

    fn text_speed(&self, work: &Path, missed: &mut Vec<String>) -> Result<String> {
        let mut table =
            Table::new(["file", "bytes a point", "one thread, MB/s", "all threads, MB/s", "conversion, MB/s"]);
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        let archive = work.join("town.slices");
        for name in ["town.xyz", "town.pts", "town.ptx"] {
            let path = work.join(name);
            let points = self.town(&path, 5_000_000, 3)?;
            let bytes = path.metadata()?.len();
            let [mut one, mut all, mut converted] = [const { Vec::new() }; 3];
            read_by_slicewalk(&path, threads)?;
            for _ in 0..self.rounds() {
                one.push(timed(points, || read_by_slicewalk(&path, 1))?);
                all.push(timed(points, || read_by_slicewalk(&path, threads))?);
                let measured = Conversion::new(&path, &archive, false, PIXEL_M).watched()?.0;
                check(points, measured.points_read)?;
                converted.push(measured.seconds);
            }
            std::fs::remove_file(&path)?;
            let rate = |seconds: &[f64]| bytes as f64 / spread(seconds)[0];
            let mega = |seconds: &[f64]| number(rate(seconds) / 1e6, 0);
            let each = number(bytes as f64 / points as f64, 1);
            table.row([name.into(), each, mega(&one), mega(&all), mega(&converted)]);
            if rate(&one) < LEAST_TEXT {
                missed.push(format!("{name} at {} MB/s a core", mega(&one)));
            }
        }
        Ok(format!(
            "## Text\n\n5 M points each. Reading is opening (PTX and PTS are counted then) and all coordinates, from the cache; the \
             conversion runs on all threads. Medians of {} rounds.\n\n{}\n\n",
            self.rounds(),
            table.markdown()
        ))
    }

    fn memory(&self, work: &Path, missed: &mut Vec<String>) -> Result<String> {
        let mut table =
            Table::new(["file", "points (M)", "GB", "seconds", "peak (MiB)", "limit (MiB)", "temporary (B a point)"]);
        let archive = work.join("town.slices");
        for (name, points, clouds) in
            [("100.e57", 100_000_000, 8), ("one cloud.e57", 100_000_000, 1), ("30.ptx", 30_000_000, 6)]
        {
            let path = work.join(name);
            let points = self.town(&path, points, clouds)?;
            let bytes = path.metadata()?.len();
            let conversion = Conversion { memory: Some(MEMORY), ..Conversion::new(&path, &archive, false, PIXEL_M) };
            let measured = conversion.watched()?.0;
            check(points, measured.points_read)?;
            std::fs::remove_file(&path)?;
            let limit = (MEMORY + BEYOND) as f64 / f64::from(1 << 20);
            table.row([
                format!("`{name}`, {clouds} clouds"),
                number(points as f64 / 1e6, 0),
                number(bytes as f64 / 1e9, 2),
                number(measured.seconds, 1),
                number(measured.peak_mib, 0),
                number(limit, 0),
                number(measured.temp_bytes as f64 / points as f64, 2),
            ]);
            if measured.peak_mib > limit {
                missed.push(format!("{name} took {:.0} MiB", measured.peak_mib));
            }
        }
        Ok(format!(
            "## Memory\n\n`--memory 256MiB --pixel {PIXEL_M}`; peak resident memory as the system counts it.\n\n{}\n\n",
            table.markdown()
        ))
    }
}

/// Seconds that `read` takes, which must find all points.
fn timed(points: u64, read: impl FnOnce() -> Result<u64>) -> Result<f64> {
    let start = Instant::now();
    let found = read()?;
    let seconds = start.elapsed().as_secs_f64();
    check(points, found).map(|()| seconds)
}

fn check(points: u64, found: u64) -> Result<()> {
    if found == points { Ok(()) } else { Err(format!("of {points} points {found} were read").into()) }
}

/// Passes the numbers from 0 to `count` to `work` on threads, in ascending order, and adds up the results.
fn on_threads(
    threads: usize,
    count: usize,
    work: impl Fn(&mut dyn Iterator<Item = usize>) -> std::result::Result<u64, String> + Sync,
) -> Result<u64> {
    let left = Mutex::new(0..count);
    let next = || left.lock().ok()?.next();
    let sums = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(|| work(&mut std::iter::from_fn(next)))).collect();
        let done = workers.into_iter().map(|worker| worker.join().unwrap_or_else(|_| Err("a thread died".into())));
        done.collect::<std::result::Result<Vec<u64>, String>>()
    });
    Ok(sums?.into_iter().sum())
}

/// All raw values by the crate `e57`, a cloud at a time on each thread. The number of points.
fn read_by_crate(path: &Path, threads: usize) -> Result<u64> {
    let clouds = E57Reader::from_file(path)?.pointclouds();
    on_threads(threads, clouds.len(), |numbers| {
        let fault = |error: e57::Error| error.to_string();
        let mut reader = E57Reader::from_file(path).map_err(fault)?;
        let mut points = 0;
        for number in numbers {
            for values in reader.pointcloud_raw(&clouds[number]).map_err(fault)? {
                black_box(values.map_err(fault)?);
                points += 1;
            }
        }
        Ok(points)
    })
}

/// All coordinates by the library. The number of points.
fn read_by_slicewalk(path: &Path, threads: usize) -> Result<u64> {
    let set = InputSet::open(&[path.to_path_buf()], InputOptions::default(), &NoMonitor)?;
    let chunks: Vec<_> = set.chunks().collect();
    on_threads(threads, chunks.len(), |numbers| {
        let (mut decoder, mut points) = (PointDecoder::new(), 0);
        for number in numbers {
            let counts = decoder.decode(&set, &chunks[number], &mut |batch| {
                black_box(batch);
                Ok(())
            });
            points += counts.map_err(|error| error.to_string())?.read;
        }
        Ok(points)
    })
}
