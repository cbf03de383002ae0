//! Archives that are read back before they have a name: a conversion that looks at its own pages once more.

use super::{ArchiveWriter, Totals};
use crate::Result;
use crate::archive::reader::Archive;
use crate::bytes::ByteSource;
use crate::output::Output;
use std::path::Path;

/// An archive that is complete and has no name.
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
    /// A file for temporary data of the same work, in `folder`.
    pub(crate) fn scratch(&self, folder: &Path) -> Result<Output> {
        let name = self.output.beside().file_name().unwrap_or_default();
        Output::scratch(self.output.files(), &folder.join(name))
    }

    /// The archive that was written, to be read once before it is gone: it never gets a name.
    pub(crate) fn read_back(mut self, totals: Totals) -> Result<Archive> {
        let len = self.complete(totals)?.file_len;
        Archive::from_source(Box::new(Written { output: self.output, len }))
    }
}
