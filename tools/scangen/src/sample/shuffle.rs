//! Shuffles any number of samples in bounded memory: into random buckets on disk, then bucket by bucket.

use super::{Kind, Sample, Stream};
use crate::{Error, Result};
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, Write};
use std::path::Path;

/// Buckets on disk. Peak memory is 1/128 of the samples at 32 bytes each: 27 MB for 107 million (2 GB of LAS).
pub const SHUFFLE_BUCKETS: usize = 128;

const RECORD: usize = 31;

/// The shuffled samples; errors while reading the temporary files are returned as items.
pub struct Shuffled {
    buckets: std::vec::IntoIter<File>,
    ready: Vec<Sample>,
    rng: Stream,
    folder: std::path::PathBuf,
}

/// Reads all of `samples` and returns them in a uniformly random order that depends only on `seed` and their original
/// order. Temporary files are unnamed, in `folder` (by default the operating system's), and vanish with the result.
pub fn shuffle(samples: impl Iterator<Item = Sample>, seed: u64, folder: Option<&Path>) -> Result<Shuffled> {
    let folder = folder.map_or_else(std::env::temp_dir, Path::to_path_buf);
    let failed = |what: &str| {
        let (folder, what) = (folder.clone(), what.to_owned());
        move |source| Error::io(folder, what, source)
    };
    let mut rng = Stream::new(seed, 4);
    let mut buckets = Vec::with_capacity(SHUFFLE_BUCKETS);
    for _ in 0..SHUFFLE_BUCKETS {
        let file = tempfile::tempfile_in(&folder).map_err(failed("create a temporary file"))?;
        buckets.push(BufWriter::with_capacity(1 << 16, file));
    }
    for sample in samples {
        let mut record = [0; RECORD];
        for (axis, value) in sample.position.into_iter().enumerate() {
            record[axis * 8..axis * 8 + 8].copy_from_slice(&value.to_le_bytes());
        }
        record[24] = sample.kind as u8;
        record[25..29].copy_from_slice(&sample.surface.to_le_bytes());
        record[29..].copy_from_slice(&sample.station.to_le_bytes());
        let bucket = &mut buckets[rng.below(SHUFFLE_BUCKETS as u64) as usize];
        bucket.write_all(&record).map_err(failed("write a temporary file"))?;
    }
    let mut files = Vec::with_capacity(SHUFFLE_BUCKETS);
    for bucket in buckets {
        let mut file = bucket.into_inner().map_err(|e| failed("write a temporary file")(e.into_error()))?;
        file.rewind().map_err(failed("rewind a temporary file"))?;
        files.push(file);
    }
    Ok(Shuffled { buckets: files.into_iter(), ready: Vec::new(), rng, folder })
}

impl Shuffled {
    fn load(&mut self, file: File) -> std::io::Result<()> {
        let mut reader = BufReader::with_capacity(1 << 16, file);
        let mut record = [0; RECORD];
        loop {
            match reader.read_exact(&mut record) {
                Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => break,
                other => other?,
            }
            let float = |at: usize| f64::from_le_bytes(std::array::from_fn(|i| record[at + i]));
            let kind = match record[24] {
                0 => Kind::Surface,
                1 => Kind::Outlier,
                2 => Kind::Mixed,
                _ => Kind::Moving,
            };
            let surface = u32::from_le_bytes(std::array::from_fn(|i| record[25 + i]));
            let station = u16::from_le_bytes([record[29], record[30]]);
            self.ready.push(Sample { position: [float(0), float(8), float(16)], kind, surface, station });
        }
        // Fisher–Yates shuffle.
        for i in (1..self.ready.len()).rev() {
            self.ready.swap(i, self.rng.below(i as u64 + 1) as usize);
        }
        Ok(())
    }
}

impl Iterator for Shuffled {
    type Item = Result<Sample>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(sample) = self.ready.pop() {
                return Some(Ok(sample));
            }
            let file = self.buckets.next()?;
            if let Err(source) = self.load(file) {
                self.ready.clear();
                self.buckets = Vec::new().into_iter();
                return Some(Err(Error::io(&self.folder, "read a temporary file", source)));
            }
        }
    }
}
