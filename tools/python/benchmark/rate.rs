//! Times one batch query of the library over boxes (raw little-endian `f64`, six per box) for each line on standard
//! input: `rate ARCHIVE.slices BOXES`. `rate.py` alternates it with the same batch in Python.

use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Overlap, overlaps_batch};
use slicewalk::store::Snapshot;
use std::io::BufRead;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [archive, boxes] = &arguments[..] else { return Err("usage: rate ARCHIVE.slices BOXES".into()) };
    let store = Snapshot::resident(&Archive::open(archive)?, &NoMonitor)?;
    let bytes = std::fs::read(boxes)?;
    let numbers: Vec<f64> = bytes.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    let aabb = |&[x0, y0, z0, x1, y1, z1]: &[f64; 6]| Aabb::new([x0, y0, z0].into(), [x1, y1, z1].into());
    let boxes = numbers.as_chunks::<6>().0.iter().map(aabb).collect::<Result<Vec<_>, _>>()?;
    let mut answers = vec![Overlap::Clear; boxes.len()];
    for line in std::io::stdin().lock().lines() {
        line?;
        let started = Instant::now();
        overlaps_batch(&store, &boxes, &mut answers);
        let seconds = started.elapsed().as_secs_f64();
        println!("{seconds} {}", answers.iter().filter(|answer| **answer == Overlap::Hit).count());
    }
    Ok(())
}
