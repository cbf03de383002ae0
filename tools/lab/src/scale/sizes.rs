//! Speed and memory of conversions against the number of points.

use super::town::{SURFACE_M2, Town};
use super::{Found, MEMORY};
use crate::measured::Conversion;
use crate::reading::read_las;
use crate::stability::Result;
use crate::stability::table::{Table, number, spread};
use crate::watch::Memory;
use std::io::{Read, Seek, Write};
use std::path::Path;
use std::time::Instant;

const PIXEL_M: f64 = 0.1;
/// Points on a square metre: a pixel is four times their spacing, the default of a conversion.
const DENSITY: u64 = 1600;
/// Disk per point: its record, what the conversion writes for a while (limit: 12), and the archive.
const DISK_PER_POINT: u64 = 20 + 12 + 4;
/// Disk space that must stay free (bytes).
const DISK_LEFT: u64 = 2 << 30;
/// Sizes up to this many points are measured three times.
const REPEATED: u64 = 100_000_000;

/// Converts towns of `millions` of points. Returns resident memory over time of the largest.
pub fn measure(found: &mut Found, work: &Path, millions: &[u64], quick: bool) -> Result<Table> {
    let mut table = Table::new([
        "points (M)",
        "LAS (GB)",
        "ground (ha)",
        "seconds",
        "M points/s",
        "`las` alone, M points/s",
        "ratio",
        "peak (MiB)",
        "temporary (B a point)",
        "the file alone (s)",
        "temporary data alone (s)",
        "archive (MB)",
        "(B a point)",
    ]);
    let mut notes = String::new();
    let mut memory = Vec::new();
    for &size in millions {
        let points = size * 1_000_000;
        let needed = points * DISK_PER_POINT + DISK_LEFT;
        let free = fs4::available_space(work)?;
        if free < needed {
            notes += &format!(
                "{size} M points are left out: they need {} GB of disk, {} are free.\n",
                number(needed as f64 / 1e9, 0),
                number(free as f64 / 1e9, 0)
            );
            continue;
        }
        let (row, resident) = one(found, work, points, if points <= REPEATED && !quick { 3 } else { 1 })?;
        println!("{}", row.join(" | "));
        table.row(row);
        memory = resident;
    }
    found.section(&format!(
        "## Conversion against the number of points\n\n{DENSITY} points on a square metre, `--memory 512MiB --pixel 0.1` (four times the spacing of points, as `--pixel auto` chooses); blocks in random order, points in random \
         order within each block; the file is read once before, so it is cached as far as the memory goes. Median of \
         three runs up to 100 M points, one run beyond; `las` reads the same file on one thread, in turn with the \
         conversions. *The file alone*: its bytes are read and nothing else is done; *temporary data alone*: as many bytes as the conversion \
         puts aside are written and read back.\n\n{}\n{notes}",
        table.markdown()
    ));
    let mut samples = Table::new(["t_s", "rss_bytes"]);
    for (seconds, bytes) in memory {
        samples.row([number(seconds, 2), bytes.to_string()]);
    }
    Ok(samples)
}

fn one(found: &mut Found, work: &Path, points: u64, runs: usize) -> Result<(Vec<String>, Memory)> {
    let (scan, archive) = (work.join("town.las"), work.join("town.slices"));
    let town = Town::new(points / (DENSITY * SURFACE_M2));
    let points = town.write(&scan, DENSITY)?;
    let bytes = std::fs::metadata(&scan)?.len();
    let conversion = Conversion { memory: Some(MEMORY), ..Conversion::new(&scan, &archive, false, PIXEL_M) };
    let [mut reading, mut seconds, mut peaks] = [const { Vec::new() }; 3];
    let (mut last, mut resident) = (None, Vec::new());
    read_las(&scan)?;
    for _ in 0..runs {
        let start = Instant::now();
        let read = read_las(&scan)?;
        reading.push(points as f64 / start.elapsed().as_secs_f64());
        let (measured, watched) = conversion.watched()?;
        if read != points || measured.points_read != points {
            return Err(format!("of {points} points {read} and {} were read", measured.points_read).into());
        }
        seconds.push(measured.seconds);
        peaks.push(measured.peak_mib * f64::from(1 << 20));
        resident = watched.resident;
        last = Some(measured);
    }
    let measured = last.ok_or("no run")?;
    let (of_file, of_temporary) = (time(|| read_bytes(&scan))?, time(|| spill(work, measured.temp_bytes))?);
    let rates: Vec<f64> = seconds.iter().map(|seconds| points as f64 / seconds).collect();
    for (metric, values) in [
        ("points_per_s", &rates),
        ("seconds", &seconds),
        ("peak_bytes", &peaks),
        ("read_points_per_s", &reading),
        ("temp_bytes", &vec![measured.temp_bytes as f64]),
        ("archive_bytes", &vec![measured.bytes as f64]),
        ("file_alone_s", &vec![of_file]),
        ("temp_alone_s", &vec![of_temporary]),
    ] {
        found.add("conversion", points, metric, values);
    }
    for path in [scan, archive] {
        std::fs::remove_file(path)?;
    }
    let ([rate, ..], [read, ..], [peak, ..]) = (spread(&rates), spread(&reading), spread(&peaks));
    let each = |bytes: u64| number(bytes as f64 / points as f64, 2);
    let row = vec![
        number(points as f64 / 1e6, 0),
        number(bytes as f64 / 1e9, 2),
        number(town.area_m2() / 1e4, 1),
        number(spread(&seconds)[0], 2),
        number(rate / 1e6, 1),
        number(read / 1e6, 0),
        number(rate / read, 3),
        number(peak / f64::from(1 << 20), 0),
        each(measured.temp_bytes),
        number(of_file, 2),
        number(of_temporary, 2),
        number(measured.bytes as f64 / 1e6, 1),
        each(measured.bytes),
    ];
    Ok((row, resident))
}

/// Bytes that are read or written at once.
const PIECE: usize = 1 << 20;

fn time(work: impl FnOnce() -> Result<()>) -> Result<f64> {
    let start = Instant::now();
    work()?;
    Ok(start.elapsed().as_secs_f64())
}

fn read_bytes(path: &Path) -> Result<()> {
    let (mut file, mut piece) = (std::fs::File::open(path)?, vec![0; PIECE]);
    while file.read(&mut piece)? > 0 {}
    Ok(())
}

/// Writes `bytes` to a new file in `folder` and reads them back.
fn spill(folder: &Path, bytes: u64) -> Result<()> {
    let mut file = tempfile::tempfile_in(folder)?;
    let mut piece = vec![1; PIECE];
    let mut left = bytes;
    while left > 0 {
        let now = left.min(PIECE as u64);
        file.write_all(&piece[..now as usize])?;
        left -= now;
    }
    file.rewind()?;
    while file.read(&mut piece)? > 0 {}
    Ok(())
}
