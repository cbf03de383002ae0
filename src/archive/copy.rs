//! Putting pages of one archive into another: content that occurs again is neither read nor decoded again.

use super::FORMAT_VERSION;
use super::dedup::WINDOW;
use super::head::Header;
use super::page::EncodedPage;
use super::writer::{ArchiveWriter, Placed};
use crate::frame::PageKey;
use crate::{Error, Result};
use std::collections::{HashMap, VecDeque};
use std::hash::Hash;

/// Pages that may be copied although the archive has no bytes of their own for them.
const MOST_REPEATS: u64 = 1 << 22;

/// Puts pages whose content is told by a `K`. Memory: about 150 bytes for each of the last 65,536 contents.
pub(super) struct Copier<K> {
    /// `None` for content that is left out.
    known: HashMap<K, Option<Placed>>,
    /// Oldest first.
    order: VecDeque<K>,
}

impl<K: Copy + Eq + Hash> Copier<K> {
    pub fn new() -> Self {
        Self { known: HashMap::new(), order: VecDeque::new() }
    }

    /// Puts the page `key` of this content into `writer`. `make` reads and encodes it, where that is needed; a page that
    /// it leaves out is `None`.
    pub fn put(
        &mut self,
        writer: &mut ArchiveWriter,
        key: PageKey,
        content: K,
        make: impl FnOnce() -> Result<Option<EncodedPage>>,
    ) -> Result<Option<Placed>> {
        match self.known.get(&content) {
            Some(None) => return Ok(None),
            Some(Some(placed)) if writer.put_again(key, placed)? => return Ok(Some(*placed)),
            _ => {}
        }
        let page = make()?;
        let placed = page.map(|page| writer.put_placed(key, &page)).transpose()?;
        if self.known.insert(content, placed).is_none() {
            self.order.push_back(content);
            if self.order.len() > WINDOW
                && let Some(oldest) = self.order.pop_front()
            {
                self.known.remove(&oldest);
            }
        }
        Ok(placed)
    }
}

/// Refuses an archive whose directory makes so many pages of so few bytes that a copy would take hours and fill a disk.
pub(super) fn refuse_repeats(header: &Header) -> Result<()> {
    let repeats = header.pages.shared.saturating_add(header.pages.uniform);
    let most = MOST_REPEATS.max(header.file_len / 16);
    if repeats > most {
        let what = format!(
            "pages without bytes of their own, in an archive of {} bytes (cut out a region with slicetool extract, or \
             convert the scan again with larger pixels)",
            header.file_len
        );
        return Err(Error::limit(what, repeats, most));
    }
    Ok(())
}

/// What a head says that this version cannot write, in words.
pub(super) fn beyond_this_version(header: &Header) -> Option<String> {
    let (major, minor) = header.version;
    let newer = minor > FORMAT_VERSION.1;
    (newer || header.features_optional != 0).then(|| match newer {
        true => format!("what format {major}.{minor} adds to the head"),
        false => format!("optional features {:#x}", header.features_optional),
    })
}
