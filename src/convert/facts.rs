//! What a plan remembers of each input: enough to know it again on another machine, and to give it to parts.

use crate::bytes::{ByteSource, FileSource};
use crate::input::{InputSet, ScanFile, StatedBounds};
use crate::{Error, Monitor, Result};
use std::path::Path;
use xxhash_rust::xxh3::Xxh3;

/// Blocks of a file by which it is known again, beside its length: the first, the last, and some evenly between.
const BLOCKS: u64 = 8;
/// Length of a block (bytes).
const BLOCK_BYTES: u64 = 4096;

/// An input file as a plan remembers it.
#[derive(Debug, Clone, PartialEq)]
pub struct InputFacts {
    /// Its name without folders, for the reader of the plan only.
    pub name: String,
    /// Its length (bytes).
    pub bytes: u64,
    /// Points that its header states.
    pub points: u64,
    /// XXH3-128 of its length and of eight blocks of 4096 bytes: tells whether another machine has the same file.
    pub fingerprint: u128,
    /// Bounds that its header states (m); parts that these do not meet leave the file out. `None`: all parts read it.
    pub bounds: Option<StatedBounds>,
}

impl InputFacts {
    /// Of all scans of `set`, then of its meshes. Cost: eight small reads a file.
    pub(super) fn of(set: &InputSet, monitor: &dyn Monitor) -> Result<Vec<Self>> {
        let scans = set.files().iter().map(|file| (file.path(), Some(file)));
        let all = scans.chain(set.meshes().iter().map(|path| (path.as_path(), None)));
        let one = |(path, scan): (&Path, Option<&ScanFile>)| {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let (bytes, fingerprint) = fingerprint(path)?;
            let name = name_of(path);
            // Meshes have no headers that tell bounds: every part reads them.
            let (points, bounds) = scan.map_or((0, None), |scan| (scan.points_stated(), scan.bounds_with_slack()));
            Ok(Self { name, bytes, points, fingerprint, bounds })
        };
        all.map(one).collect()
    }
}

/// Name of a file without folders.
pub(super) fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Length of the file at `path`, and XXH3-128 of the length and the blocks.
fn fingerprint(path: &Path) -> Result<(u64, u128)> {
    let source = FileSource::open(path)?;
    let len = source.len();
    let (mut hash, mut block) = (Xxh3::new(), [0; BLOCK_BYTES as usize]);
    hash.update(&len.to_le_bytes());
    let bytes = len.min(BLOCK_BYTES);
    for number in 0..BLOCKS {
        let at = (u128::from(len - bytes) * u128::from(number) / u128::from(BLOCKS - 1)) as u64;
        source.read_at(at, &mut block[..bytes as usize])?;
        hash.update(&block[..bytes as usize]);
    }
    Ok((len, hash.digest128()))
}
