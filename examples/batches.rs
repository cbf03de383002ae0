//! Queries many boxes at once: the fraction of a storey in which a pawn of 0.5 × 0.5 × 1.8 m touches nothing.
//! `batches ARCHIVE.slices FEET_Z`

use nalgebra::{Point3, Vector3};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Overlap, overlaps_batch};
use slicewalk::store::Snapshot;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, feet] = &arguments[..] else { return Err("usage: batches ARCHIVE.slices FEET_Z".into()) };
    let feet: f64 = feet.parse()?;
    let archive = Archive::open(path)?;
    let (min, max) = archive.header().bounds.ok_or("the archive is empty")?;
    let store = Snapshot::resident(&archive, &NoMonitor)?;

    let size = Vector3::new(0.5, 0.5, 1.8);
    let step = 0.25;
    let places = |axis: usize| ((max[axis] - min[axis]) / step).ceil() as usize;
    let mut boxes = Vec::new();
    for (x, y) in (0..places(0)).flat_map(|x| (0..places(1)).map(move |y| (x, y))) {
        let at = Point3::new(min[0] + x as f64 * step, min[1] + y as f64 * step, feet);
        boxes.push(Aabb::standing(at, size)?);
    }
    let mut answers = vec![Overlap::Clear; boxes.len()];
    overlaps_batch(&store, &boxes, &mut answers);
    let clear = answers.iter().filter(|answer| **answer == Overlap::Clear).count();
    println!("{clear} of {} places are clear", boxes.len());
    Ok(())
}
