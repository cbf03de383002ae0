//! What a plan remembers of each input: enough to know it again on another machine, and to give it to parts.

use crate::Result;
use crate::bytes::{ByteSource, FileSource};
use crate::input::{ScanFile, StatedBounds};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_128;

/// Bytes at either end of a file by which it is known again, beside its length.
const FINGERPRINT_BYTES: u64 = 4096;

/// An input file as a plan remembers it.
#[derive(Debug, Clone, PartialEq)]
pub struct InputFacts {
    /// Its name without folders, for the reader of the plan only.
    pub name: String,
    /// Its length (bytes).
    pub bytes: u64,
    /// Points that its header states.
    pub points: u64,
    /// XXH3-128 of its length, its first and its last 4096 bytes: tells whether another machine has the same file.
    pub fingerprint: u128,
    /// Bounds that its header states (m); parts that these do not meet leave the file out. `None`: all parts read it.
    pub bounds: Option<StatedBounds>,
}

impl InputFacts {
    pub(super) fn of(file: &ScanFile) -> Result<Self> {
        let name = file.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
        let bounds = file.bounds_with_slack();
        let (bytes, points) = (file.bytes(), file.points_stated());
        Ok(Self { name, bytes, points, fingerprint: fingerprint(file.path())?, bounds })
    }

    /// Meshes have no headers that tell bounds: every part reads them.
    pub(super) fn of_mesh(path: &Path) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let bytes = FileSource::open(path)?.len();
        Ok(Self { name, bytes, points: 0, fingerprint: fingerprint(path)?, bounds: None })
    }
}

/// XXH3-128 of length, first and last bytes of the file at `path`.
pub(super) fn fingerprint(path: &Path) -> Result<u128> {
    let source = FileSource::open(path)?;
    let (len, ends) = (source.len(), source.len().min(FINGERPRINT_BYTES));
    let mut bytes = len.to_le_bytes().to_vec();
    for at in [0, len - ends] {
        let start = bytes.len();
        bytes.resize(start + ends as usize, 0);
        source.read_at(at, &mut bytes[start..])?;
    }
    Ok(xxh3_128(&bytes))
}
