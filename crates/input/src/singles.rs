//! Coordinates that files store as floats of 32 bits, which are coarse far from the origin.

use crate::text::{grouped, number, rounded};
use std::collections::BTreeMap;
use std::path::Path;

/// Share of a pixel that floats may lie apart without a warning.
const COARSE: f64 = 0.25;

/// Farthest coordinates of each file that are floats of 32 bits, by number of the file.
#[derive(Debug, Default)]
pub struct Singles(BTreeMap<usize, [f64; 3]>);

impl Singles {
    /// Notes how far from 0 such coordinates are, in the units of the file and before any pose; 0 without any.
    pub fn note(&mut self, file: usize, farthest: [f64; 3]) {
        if farthest != [0.0; 3] {
            let known = self.0.entry(file).or_default();
            *known = [0, 1, 2].map(|axis| known[axis].max(farthest[axis]));
        }
    }

    /// Returns a warning about the files whose floats are too coarse for pixels of `pixel_m`. `about` returns the name
    /// of a file and the lengths of its units (m).
    pub fn warning<'a>(&self, pixel_m: f64, about: impl Fn(usize) -> (&'a Path, [f64; 3])) -> Option<String> {
        let coarse = self.0.iter().filter_map(|(&file, farthest)| {
            let (path, unit) = about(file);
            let steps = [0, 1, 2].map(|axis| (step_at(farthest[axis]) * unit[axis], farthest[axis]));
            let (step, at) = steps.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
            (step > COARSE * pixel_m).then_some((path, step, at))
        });
        let coarse: Vec<_> = coarse.collect();
        let ((first, ..), (_, step, at)) = (coarse.first()?, coarse.iter().max_by(|a, b| a.1.total_cmp(&b.1))?);
        let others = match coarse.len() - 1 {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        Some(format!(
            "{}{others}: coordinates are floats of 32 bits, which are {} m apart at {}, for pixels of {} m; export with an \
             offset subtracted, or with coordinates of 64 bits (double)",
            first.display(),
            rounded(*step, 0.01 * step),
            grouped(*at as u64),
            number(pixel_m)
        ))
    }
}

/// Returns the distance between neighbouring floats of 32 bits at `value`.
fn step_at(value: f64) -> f64 {
    let single = value as f32;
    f64::from(single.next_up()) - f64::from(single)
}
