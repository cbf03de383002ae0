//! Pages of an E57: 1,024 bytes, the last four of which are a checksum (CRC-32C, most significant byte first).
//!
//! *Physical* offsets count all bytes of the file, *logical* offsets leave out the checksums. The checksum of every
//! page that is read is verified.

use crate::source::Source;
use crate::{Error, Result};

/// Page size (bytes); `CONTENT`: without the checksum.
pub(super) const PAGE: u64 = 1024;
const CONTENT: u64 = PAGE - 4;
/// Pages read at once.
const AT_ONCE: u64 = 64;

/// Converts a physical offset to a logical one; `None` within a checksum.
pub(super) fn logical(physical: u64) -> Option<u64> {
    (physical % PAGE < CONTENT).then(|| physical / PAGE * CONTENT + physical % PAGE)
}

/// Converts a logical offset to a physical one.
pub(super) fn physical(logical: u64) -> u64 {
    (logical / CONTENT).saturating_mul(PAGE).saturating_add(logical % CONTENT)
}

/// Content of the pages of a file.
pub(super) struct Pages<'a> {
    source: &'a Source,
    /// Number of whole pages in the file.
    count: u64,
    /// Number of the first loaded page; `held`: content of the loaded pages.
    first: u64,
    held: Vec<u8>,
    raw: Vec<u8>,
}

impl<'a> Pages<'a> {
    pub fn new(source: &'a Source, file_bytes: u64) -> Self {
        Self { source, count: file_bytes / PAGE, first: 0, held: Vec::new(), raw: Vec::new() }
    }

    /// Returns the logical length of the file.
    pub fn len(&self) -> u64 {
        self.count * CONTENT
    }

    /// Fills `out` with the content from a logical offset on; `ahead`: the bytes after it are needed soon.
    pub fn read(&mut self, out: &mut [u8], at: u64, ahead: bool) -> Result<()> {
        let mut filled = 0;
        while filled < out.len() {
            let from = at.saturating_add(filled as u64);
            let page = from / CONTENT;
            let held = self.held.len() as u64 / CONTENT;
            if page < self.first || page >= self.first + held {
                let needed = (out.len() - filled) as u64 / CONTENT + 2;
                self.load(page, if ahead { AT_ONCE } else { needed.min(AT_ONCE) })?;
            }
            let begin = ((page - self.first) * CONTENT + from % CONTENT) as usize;
            let now = (self.held.len() - begin).min(out.len() - filled);
            out[filled..filled + now].copy_from_slice(&self.held[begin..begin + now]);
            filled += now;
        }
        Ok(())
    }

    fn load(&mut self, page: u64, most: u64) -> Result<()> {
        self.held.clear();
        if page >= self.count {
            let reason = format!("the file ends there: it has {} pages; fetch or write it again", self.count);
            return Err(Error::input(self.source.path(), format!("byte {}", page.saturating_mul(PAGE)), reason));
        }
        self.first = page;
        let pages = (self.count - page).min(most);
        self.raw.resize((pages * PAGE) as usize, 0);
        let got = self.source.read_at(&mut self.raw, page * PAGE)? as u64 / PAGE;
        for (number, raw) in self.raw.chunks_exact(PAGE as usize).take(got as usize).enumerate() {
            let (content, stated) = raw.split_at(CONTENT as usize);
            let found = crc32c::crc32c(content);
            if stated != found.to_be_bytes() {
                if number > 0 {
                    // The pages before it may suffice.
                    break;
                }
                let stated = stated.iter().fold(0u32, |sum, &byte| sum << 8 | u32::from(byte));
                let reason = format!(
                    "page {page} is damaged: expected the checksum {stated:08x}, found {found:08x}; fetch the file again"
                );
                return Err(Error::input(self.source.path(), format!("byte {}", page * PAGE), reason));
            }
            self.held.extend(content);
        }
        if self.held.is_empty() {
            let reason = "the file became shorter while it was read";
            return Err(Error::input(self.source.path(), format!("byte {}", page * PAGE), reason));
        }
        Ok(())
    }
}
