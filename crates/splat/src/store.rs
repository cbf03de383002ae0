//! Decompressed bytes: in memory as far as they fit, else in an unnamed temporary file.

use super::Work;
use slicewalk_base::bytes::ByteSource;
use slicewalk_base::disk::{Files, OpenFile};
use slicewalk_base::{Error, Parameter, Result};
use std::io;
use std::path::PathBuf;

/// Bytes written once, from front to back, then read anywhere.
pub struct Store {
    memory: Vec<u8>,
    most: usize,
    folder: PathBuf,
    file: Option<OpenFile>,
    len: u64,
}

impl Store {
    /// Creates an empty store that holds `most` bytes in memory.
    pub fn new(work: &Work<'_>, most: u64) -> Self {
        // A growing vector takes up to three times its contents while it reallocates.
        let most = usize::try_from(most / 3).unwrap_or(usize::MAX);
        Self { memory: Vec::new(), most, folder: work.options.temp_dir.clone(), file: None, len: 0 }
    }

    /// Appends `bytes`.
    pub fn append(&mut self, bytes: &[u8]) -> Result<()> {
        if self.file.is_none() && bytes.len() > self.most.saturating_sub(self.memory.len()) {
            let file = Files::current().create_unnamed(&self.folder).map_err(|e| self.refused("create a file", e))?;
            file.write_at(0, &self.memory).map_err(|e| self.refused("write temporary data", e))?;
            self.memory = Vec::new();
            self.file = Some(file);
        }
        match &self.file {
            Some(file) => file.write_at(self.len, bytes).map_err(|e| self.refused("write temporary data", e))?,
            None => self.memory.extend_from_slice(bytes),
        }
        self.len += bytes.len() as u64;
        Ok(())
    }

    fn refused(&self, action: &str, error: io::Error) -> Error {
        Error::io(&self.folder, action, error).with_suggestion(Parameter::TempDir)
    }
}

impl ByteSource for Store {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        if let Some(file) = &self.file {
            return file.read_exact_at(offset, buf).map_err(|e| self.refused("read temporary data", e));
        }
        let from = usize::try_from(offset).ok().and_then(|from| self.memory.get(from..)?.get(..buf.len()));
        let from = from.ok_or_else(|| self.refused("read temporary data", io::ErrorKind::UnexpectedEof.into()))?;
        buf.copy_from_slice(from);
        Ok(())
    }
}
