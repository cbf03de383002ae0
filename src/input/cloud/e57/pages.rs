//! Pages of an E57: 1,024 bytes, of which the last four are a checksum (CRC-32C, the most significant byte first).
//!
//! A place in the file is *physical*, a place among the bytes without checksums *logical*. Every page that is read is
//! checked.

use crate::input::source::Source;
use crate::{Error, Result};

/// Bytes of a page, and of its content.
pub(super) const PAGE: u64 = 1024;
const CONTENT: u64 = PAGE - 4;
/// Pages read at once.
const AT_ONCE: u64 = 64;

/// Logical place of a physical one; `None` within a checksum.
pub(super) fn logical(physical: u64) -> Option<u64> {
    (physical % PAGE < CONTENT).then(|| physical / PAGE * CONTENT + physical % PAGE)
}

/// Physical place of a logical one.
pub(super) fn physical(logical: u64) -> u64 {
    (logical / CONTENT).saturating_mul(PAGE).saturating_add(logical % CONTENT)
}

/// The content of the pages of a file.
pub(super) struct Pages<'a> {
    source: &'a Source,
    /// Whole pages of the file.
    count: u64,
    /// Pages at hand: the number of the first, and their content.
    first: u64,
    held: Vec<u8>,
    raw: Vec<u8>,
}

impl<'a> Pages<'a> {
    pub fn new(source: &'a Source, file_bytes: u64) -> Self {
        Self { source, count: file_bytes / PAGE, first: 0, held: Vec::new(), raw: Vec::new() }
    }

    /// Logical length of the file.
    pub fn len(&self) -> u64 {
        self.count * CONTENT
    }

    /// Fills `out` with the content from a logical place on; `ahead`: more of it is needed soon.
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
                    // Pages before it may be all that is needed.
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
