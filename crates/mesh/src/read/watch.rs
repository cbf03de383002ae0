//! State shared by mesh readers: cancellation, broken-face count, content hash.

use crate::bytes::Regular;
use crate::{Error, Monitor, Parameter, Result};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use xxhash_rust::xxh3::Xxh3;

/// Steps between two checks for cancellation.
const STEPS: u32 = 1 << 10;

/// Cancellation and faults while one file is read.
pub(super) struct Watch<'a> {
    pub monitor: &'a dyn Monitor,
    /// True if broken faces are left out instead of being errors.
    pub allow_incomplete: bool,
    /// Number of faces left out, and the error of the first.
    pub broken: u64,
    pub reason: Option<Error>,
    steps: u32,
}

impl<'a> Watch<'a> {
    pub fn new(monitor: &'a dyn Monitor, allow_incomplete: bool) -> Self {
        Self { monitor, allow_incomplete, broken: 0, reason: None, steps: 0 }
    }

    /// Counts one step of work; checks for cancellation every [`STEPS`] steps.
    pub fn step(&mut self) -> Result<()> {
        self.steps += 1;
        if self.steps < STEPS {
            return Ok(());
        }
        self.steps = 0;
        self.check_cancelled()
    }

    /// Fails if the work is cancelled.
    pub fn check_cancelled(&self) -> Result<()> {
        if self.monitor.cancelled() { Err(Error::Interrupted) } else { Ok(()) }
    }

    /// Records `faces` unreadable faces; fails unless incomplete input is allowed.
    pub fn lose(&mut self, faces: u64, error: Error) -> Result<()> {
        match error {
            error @ Error::Input { .. } if !self.allow_incomplete => Err(error.with_suggestion(Parameter::Incomplete)),
            Error::Input { .. } => {
                self.broken = self.broken.saturating_add(faces);
                self.reason.get_or_insert(error);
                Ok(())
            }
            error => Err(error),
        }
    }
}

/// Hash of all bytes read of a file, in reading order; shared by its readers.
#[derive(Clone, Default)]
pub(super) struct Digest(Arc<Mutex<Option<Box<Xxh3>>>>);

impl Digest {
    /// Creates the hash of no bytes; ignores all input unless `wanted`.
    pub fn new(wanted: bool) -> Self {
        Self(Arc::new(Mutex::new(wanted.then(Box::default))))
    }

    pub fn update(&self, bytes: &[u8]) {
        if let Some(state) = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            state.update(bytes);
        }
    }

    /// Starts over, because the file is read again.
    fn reset(&self) {
        if let Some(state) = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            state.reset();
        }
    }

    pub fn value(&self) -> u128 {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map_or(0, |state| state.digest128())
    }
}

/// A mesh file that is read from front to back and hashed.
pub(super) struct MeshSource {
    file: Regular,
    bytes: u64,
    digest: Digest,
}

impl MeshSource {
    pub fn open(path: &Path, digest: &Digest) -> Result<Self> {
        let (file, stamp) = Regular::open(path).map_err(|e| Error::io(path, "open", e))?;
        digest.reset();
        Ok(Self { file, bytes: stamp.len(), digest: digest.clone() })
    }

    /// Length of the file (bytes).
    pub fn len(&self) -> u64 {
        self.bytes
    }
}

impl Read for MeshSource {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let read = self.file.read(buf)?;
        self.digest.update(&buf[..read]);
        Ok(read)
    }
}

impl Seek for MeshSource {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.digest.reset();
        self.file.seek(to)
    }
}
