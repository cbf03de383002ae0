//! Partition of records by tile column, within a memory budget: an external counting sort.
//!
//! Workers collect records into runs. A full run is sorted by tile column and kept in memory while the budget allows,
//! else written to a temporary file ([`spill`](super::spill)). Then the runs are merged: tile columns come out in
//! archive order, each with the ranges of its records. Every run is read from front to back, whatever the order of the
//! input, so neither shuffled points nor a huge extent cause many small random reads.
//!
//! Value runs, for colours, share the store with the runs of points and surfaces and are merged into the same columns.
//!
//! A run states which part of the input it covers, so that another process can resume from the runs on disk after a
//! kill.
//!
//! Memory: `retain_bytes` for runs kept, 20 bytes per record and 120 per tile column of each run under construction,
//! and while merging up to 4 KiB per run, or less for very many runs. Disk: 8 bytes per record plus 3 to 12 bytes per
//! tile column and run.

mod builder;
mod cover;
mod merge;
mod store;

pub use builder::RunBuilder;
pub use merge::{ColumnJob, LoadedRecords, Merge};
pub use store::RunStore;
#[cfg(test)]
pub use {builder::BUILD_BYTES, store::MOST_IN_MEMORY_WHILE_SPILLING};

use super::record::{ColumnKey, Record};
use crate::Result;

const RECORD_BYTES: u64 = size_of::<Record>() as u64;
/// Segments of a run with at least this many records are also sorted by pixel. A column of very many records is
/// processed in areas, and their rows can then be found without reading the whole column for each.
const SORTED_RECORDS: u64 = 1 << 14;

/// Records of one tile column in a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Segment {
    key: ColumnKey,
    records: u32,
}

/// Encodes segments as bytes: column minus the previous column (varint), then the count (varint), then the block if it
/// is not 0.
#[derive(Default)]
struct SegmentCoder {
    column: u64,
}

fn put_varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

impl SegmentCoder {
    fn encode(&mut self, segment: Segment, out: &mut Vec<u8>) {
        put_varint(segment.key.column.wrapping_sub(self.column), out);
        self.column = segment.key.column;
        let block = segment.key.block;
        // One bit of the count marks a following block: nearly all columns have a single block.
        put_varint(u64::from(segment.records) << 1 | u64::from(block != 0), out);
        if block != 0 {
            out.extend_from_slice(&block.to_le_bytes());
        }
    }

    fn decode(&mut self, mut next: impl FnMut() -> Result<u8>) -> Result<Segment> {
        let mut varint = || -> Result<u64> {
            let mut value = 0;
            for shift in (0..64).step_by(7) {
                let byte = next()?;
                value |= u64::from(byte & 0x7F) << shift;
                if byte < 0x80 {
                    break;
                }
            }
            Ok(value)
        };
        self.column = self.column.wrapping_add(varint()?);
        let count = varint()?;
        let block = if count & 1 == 1 { i16::from_le_bytes([next()?, next()?]) } else { 0 };
        Ok(Segment { key: ColumnKey { column: self.column, block }, records: (count >> 1) as u32 })
    }
}

impl std::fmt::Debug for SegmentCoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SegmentCoder({})", self.column)
    }
}

fn count_segments(index: &[u8]) -> Result<u64> {
    let (mut coder, mut bytes, mut count) = (SegmentCoder::default(), index.iter(), 0);
    while bytes.len() > 0 {
        coder.decode(|| Ok(bytes.next().copied().unwrap_or(0)))?;
        count += 1;
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::super::record::{RecordPieces, Recorder};
    use super::super::spill::SpillPlace;
    use super::*;
    use crate::frame::Frame;
    use std::collections::BTreeMap;
    use std::path::Path;

    type Columns = BTreeMap<ColumnKey, Vec<Record>>;

    fn points(count: usize) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let mut state = 1u64;
        let mut random = move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut axes = (Vec::new(), Vec::new(), Vec::new());
        for number in 0..count {
            axes.0.push(random() * 100.0 - 50.0);
            axes.1.push(random() * 40.0);
            axes.2.push(if number == 7 { 1e7 } else { random() * 3.0 });
        }
        axes
    }

    fn expected(recorder: Recorder, (x, y, z): &(Vec<f64>, Vec<f64>, Vec<f64>)) -> Columns {
        let mut columns = Columns::new();
        for number in 0..x.len() {
            recorder.record(&x[number..=number], &y[number..=number], &z[number..=number], |index, record| {
                columns.entry(index.key()).or_default().push(record);
            });
        }
        columns.values_mut().for_each(|records| records.sort_unstable());
        columns
    }

    #[test]
    fn every_record_comes_out_in_its_column_from_memory_and_from_disk() {
        let recorder = Recorder::new(Frame::new(0.05, 0.15).unwrap());
        let points = points(100_000);
        let expected = expected(recorder, &points);
        let dir = tempfile::tempdir().unwrap();
        for (retain_bytes, max_records) in [(u64::MAX, 1000), (0, 5000), (500_000, 1)] {
            let store = RunStore::new(retain_bytes, SpillPlace::unnamed(dir.path()));
            let mut builder = RunBuilder::new(recorder, 20 << 14);
            builder.push(&points.0, &points.1, &points.2, &store).unwrap();
            builder.flush(&store).unwrap();
            assert_eq!(store.temp_bytes() > 0, retain_bytes < 1_000_000);
            let merge = Merge::new(&store);
            assert!(merge.runs.len() > 5);
            let mut found = Columns::new();
            let mut streamed = Columns::new();
            merge
                .jobs(max_records, 1000, |job| {
                    assert!(job.columns.len() <= 1000);
                    assert!(job.records <= max_records || job.columns.len() == 1);
                    let mut buffer = Vec::new();
                    let loaded = merge.load(&job, &mut buffer)?;
                    for (number, &(key, count)) in job.columns.iter().enumerate() {
                        let mut own = Vec::new();
                        loaded.column(number).each(|piece| own.extend_from_slice(piece));
                        assert_eq!(own.len() as u64, count);
                        assert!(found.last_key_value().is_none_or(|(last, _)| *last < key));
                        found.insert(key, own);
                    }
                    if job.columns.len() == 1 {
                        let of_column = streamed.entry(job.columns[0].0).or_default();
                        merge.stream(&job, (0, 66), 100, |chunk| {
                            of_column.extend_from_slice(chunk);
                            Ok(true)
                        })?;
                    }
                    Ok(())
                })
                .unwrap();
            found.values_mut().chain(streamed.values_mut()).for_each(|records| records.sort_unstable());
            assert_eq!(found, expected);
            if max_records == 1 {
                assert_eq!(streamed, expected);
            }
        }
    }

    #[test]
    fn rows_of_a_dense_column_come_without_most_of_the_others() {
        let recorder = Recorder::new(Frame::new(1.0, 3.0).unwrap());
        let dir = tempfile::tempdir().unwrap();
        let at = |number: usize, factor: usize| (number * factor % 64_000) as f64 / 1000.0;
        let count = 3 * SORTED_RECORDS as usize;
        let x: Vec<f64> = (0..count).map(|number| at(number, 7919)).collect();
        let y: Vec<f64> = (0..count).map(|number| at(number, 104_729)).collect();
        let z = vec![0.5; count];
        for retain_bytes in [0, u64::MAX] {
            let store = RunStore::new(retain_bytes, SpillPlace::unnamed(dir.path()));
            let mut builder = RunBuilder::new(recorder, 40 * SORTED_RECORDS);
            builder.push(&x, &y, &z, &store).unwrap();
            builder.flush(&store).unwrap();
            let merge = Merge::new(&store);
            let mut dense = 0;
            merge
                .jobs(1, 1, |job| {
                    let gather = |rows: (u32, u32)| {
                        let mut all = Vec::new();
                        let take = |records: &[Record]| {
                            all.extend_from_slice(records);
                            Ok(true)
                        };
                        merge.stream(&job, rows, 1000, take).unwrap();
                        all.sort_unstable();
                        all
                    };
                    let all = gather((0, 66));
                    assert_eq!(all.len() as u64, job.records);
                    for rows in [(0, 3), (10, 13), (64, 66)] {
                        let within =
                            |record: &Record| (rows.0 as usize..rows.1 as usize).contains(&(record.pixel() / 66));
                        let mut some = gather(rows);
                        if job.records > 2 * SORTED_RECORDS {
                            dense += 1;
                            assert!(some.len() < all.len() / 2, "{} of {}", some.len(), all.len());
                        }
                        some.retain(within);
                        let (mut loaded, mut buffer) = (Vec::new(), Vec::new());
                        merge
                            .load_rows(&job, rows, &mut buffer)?
                            .column(0)
                            .each(|piece| loaded.extend_from_slice(piece));
                        loaded.sort_unstable();
                        assert_eq!(loaded, some, "no other rows");
                        assert_eq!(some, all.iter().copied().filter(within).collect::<Vec<_>>());
                    }
                    Ok(())
                })
                .unwrap();
            assert_eq!(dense, 3, "the test needs one dense column");
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named_in_the_error() {
        let store = RunStore::new(0, SpillPlace::unnamed(Path::new("/nonexistent/folder")));
        let mut builder = RunBuilder::new(Recorder::new(Frame::new(0.05, 0.15).unwrap()), 0);
        builder.push(&[0.0], &[0.0], &[0.0], &store).unwrap();
        let text = builder.flush(&store).unwrap_err().to_string();
        assert!(text.contains("/nonexistent/folder") && text.contains("choose a folder"), "{text}");
    }
}
