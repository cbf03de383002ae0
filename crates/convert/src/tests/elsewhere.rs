//! Accumulation outside of this crate makes the same archive as inside.

use super::*;
use std::collections::BTreeMap;

/// Accumulator that does what [`PointVoxel`] says, or refuses all work.
#[derive(Debug)]
struct Other {
    refuses: bool,
    records: AtomicU64,
}

impl Accumulate for Other {
    fn accumulate(&self, records: &[u64], ends: &[usize], band: u32) -> Option<Vec<Vec<PointVoxel>>> {
        const STEPS: u64 = 8160;
        let height = |record: u64| (record >> 14) & 0x1fff;
        if self.refuses || records.iter().any(|&record| height(record) >= STEPS) {
            return None;
        }
        self.records.fetch_add(records.len() as u64, Ordering::Relaxed);
        let (mut begin, band) = (0, u64::from(band));
        let column = |&end: &usize| {
            let mut voxels = BTreeMap::<u64, PointVoxel>::new();
            for &record in &records[std::mem::replace(&mut begin, end)..end] {
                let (key, steps) = (record >> 27, height(record));
                let empty = PointVoxel { key, heights: [u32::MAX, 0], ..PointVoxel::default() };
                let voxel = voxels.entry(key).or_insert(empty);
                let [least, greatest] = voxel.heights;
                voxel.heights = [least.min(steps as u32), greatest.max(steps as u32)];
                voxel.bins |= 1 << (steps / 510);
                let slice = key & 0xff_ffff;
                let [u, v] = [record >> 7, record].map(|bits| (bits & 0x7f) as i64);
                let w = (((slice % band) * STEPS + steps) / band) as i64;
                let point = [1, u, v, w, u * u, u * v, v * v, u * w, v * w, w * w];
                voxel.sums.iter_mut().zip(point).for_each(|(sum, value)| *sum += value);
            }
            voxels.into_values().collect::<Vec<_>>()
        };
        Some(ends.iter().map(column).collect())
    }
}

#[test]
fn an_accumulator_elsewhere_changes_no_byte_whether_it_does_the_work_or_not() {
    let mut job = Job::new();
    // Thin slices are classified in bands of several.
    for slice_m in [None, Some(0.02)] {
        job.options.grid.slice_m = slice_m;
        job.options.resources.accumulator = None;
        convert(&job.options, &NoMonitor).unwrap();
        let expected = fs::read(&job.options.output).unwrap();
        for refuses in [false, true] {
            let other = Arc::new(Other { refuses, records: AtomicU64::new(0) });
            job.options.resources.accumulator = Some(other.clone());
            convert(&job.options, &NoMonitor).unwrap();
            assert!(fs::read(&job.options.output).unwrap() == expected, "{slice_m:?}");
            assert_eq!(other.records.load(Ordering::Relaxed) >= 2 * POINTS as u64, !refuses);
        }
    }
}
