//! Reading scans with the format's own crate, as a measure of what reading alone takes.

use crate::stability::Result;
use std::hint::black_box;
use std::path::Path;

/// Points decoded at once.
const BATCH: u64 = 500_000;

/// Reads all coordinates with `las`, on one thread: what the crate offers for uncompressed files. Their number.
pub fn read_las(path: &Path) -> Result<u64> {
    let mut reader = las::Reader::from_path(path)?;
    let mut points = reader.read_points(0)?;
    let (mut count, mut sum) = (0, 0.0);
    loop {
        let read = reader.fill_points(BATCH, &mut points)?;
        if read == 0 {
            break;
        }
        count += read;
        sum += points.x().sum::<f64>() + points.y().sum::<f64>() + points.z().sum::<f64>();
    }
    black_box(sum);
    Ok(count)
}
