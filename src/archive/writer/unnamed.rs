//! Archives that are read back before they are named: a conversion uses one to read its own pages again.

use super::{ArchiveWriter, Totals};
use crate::Result;
use crate::archive::reader::Archive;
use crate::bytes::ByteSource;
use crate::output::Output;
use std::path::Path;

/// Complete archive without a name.
struct Written {
    output: Output,
    len: u64,
}

impl ByteSource for Written {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        self.output.read_at(offset, buf)
    }
}

impl ArchiveWriter {
    /// Creates a file in `folder` for temporary data of the same conversion.
    #[doc(hidden)]
    pub fn scratch(&self, folder: &Path) -> Result<Output> {
        let name = self.output.beside().file_name().unwrap_or_default();
        Output::scratch(self.output.files(), &folder.join(name))
    }

    /// Completes the archive and opens it for reading once. It never gets a name and is removed afterwards.
    #[doc(hidden)]
    pub fn read_back(mut self, totals: Totals) -> Result<Archive> {
        let len = self.complete(totals)?.file_len;
        Archive::from_source(Box::new(Written { output: self.output, len }))
    }
}
