//! Copying pages into another archive. Repeated content is read and decoded once.

use super::FORMAT_VERSION;
use super::colour_section::EncodedColours;
use super::dedup::WINDOW;
use super::head::{COLOURS, Header, LEVELS, SEEN};
use super::levels::CoarseSpan;
use super::page_coding::EncodedPage;
use super::writer::{ArchiveWriter, Placed};
use crate::frame::PageKey;
use crate::{Error, Result};
use std::collections::{HashMap, VecDeque};
use std::hash::Hash;
use std::path::Path;
use std::sync::Arc;

/// Limit on the coarse spans kept for all contents together: 4 MiB.
const COARSE_KEPT: usize = 1 << 19;

/// Writes pages whose content is identified by a `K`. Memory: about 150 bytes for each of the last 65,536 contents, and
/// 4 MiB.
pub(super) struct Copier<K> {
    /// Number of contents that are known.
    most: usize,
    known: HashMap<K, Known>,
    /// Oldest first.
    order: VecDeque<K>,
    coarse_kept: usize,
}

/// Content that was already handled.
struct Known {
    /// `None` for content that is left out.
    placed: Option<Placed>,
    /// Contribution to overview levels; `None` once dropped to save memory, empty without levels.
    coarse: Option<Arc<[CoarseSpan]>>,
}

impl<K: Copy + Eq + Hash> Copier<K> {
    pub fn new() -> Self {
        Self::knowing(WINDOW)
    }

    /// Creates a copier that knows only the last `most` contents, for a large `K`.
    pub fn knowing(most: usize) -> Self {
        Self { most, known: HashMap::new(), order: VecDeque::new(), coarse_kept: 0 }
    }

    /// Writes page `key` with this `content` and its own `colours`. Calls `make` to read and encode the page only if
    /// its content is new; `make` returns `None` for a page to leave out.
    pub fn put(
        &mut self,
        writer: &mut ArchiveWriter,
        key: PageKey,
        content: K,
        colours: EncodedColours,
        make: impl FnOnce() -> Result<Option<EncodedPage>>,
    ) -> Result<Option<Placed>> {
        match self.known.get(&content) {
            Some(Known { placed: None, .. }) => return Ok(None),
            Some(Known { placed: Some(placed), coarse: Some(coarse) })
                if writer.put_again(key, placed, coarse, &colours)? =>
            {
                return Ok(Some(*placed));
            }
            _ => {}
        }
        let page = make()?.map(|page| page.with_colours(colours));
        let coarse = page.as_ref().and_then(|page| page.coarse.clone()).unwrap_or_default();
        let placed = page.map(|page| writer.put_placed(key, &page)).transpose()?;
        self.coarse_kept += coarse.len();
        if self.coarse_kept > COARSE_KEPT {
            self.known.values_mut().for_each(|known| known.coarse = None);
            self.coarse_kept = coarse.len();
        }
        if self.known.insert(content, Known { placed, coarse: Some(coarse) }).is_none() {
            self.order.push_back(content);
            if self.order.len() > self.most
                && let Some(oldest) = self.order.pop_front()
            {
                self.known.remove(&oldest);
            }
        }
        Ok(placed)
    }
}

/// Describes what the header contains that this version cannot write, if anything.
pub(super) fn beyond_this_version(header: &Header) -> Option<String> {
    let (major, minor) = header.version;
    let newer = minor > FORMAT_VERSION.1;
    let features = header.features_optional & !(LEVELS | COLOURS | SEEN);
    (newer || features != 0).then(|| match newer {
        true => format!("what format {major}.{minor} adds to the head"),
        false => format!("optional features {features:#x}"),
    })
}

/// Returns whether the archive with this header has seen space.
pub(super) fn has_seen(header: &Header) -> bool {
    header.features_optional & SEEN != 0
}

/// Adds the path, and what to do, to an error about the content of one of several archives.
pub(super) fn named(path: &Path, error: Error, advice: &str) -> Error {
    match error {
        Error::Format { .. } | Error::Unsupported { .. } => Error::input(path, "damaged", format!("{error}; {advice}")),
        limit @ Error::Limit { .. } => Error::input(path, "directory", limit.to_string()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::{Archive, PageEncoder, Totals};
    use crate::frame::Frame;
    use crate::page::{Page, PageBuilder, Span};
    use crate::plan::Plan;

    #[test]
    fn content_is_made_once_and_nothing_is_made_for_what_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
        let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        let page = |height: u32| -> Page {
            let mut builder = PageBuilder::default();
            let pixels = if height == 0 { 4096 } else { height };
            for pixel in 0..pixels {
                assert!(builder.set_column(pixel % 64, pixel / 64, &[Span::new(height, 300, true).unwrap()]));
            }
            builder.build()
        };
        let (mut copier, mut encoder) = (Copier::new(), PageEncoder::of_plan(&plan));
        let mut made = [0; 4];
        for layer in 0..40 {
            let (key, content) = (PageKey { tx: 0, ty: 0, layer }, layer as usize % 4);
            let placed = copier.put(&mut writer, key, content, EncodedColours::default(), || {
                made[content] += 1;
                Ok((content < 3).then(|| encoder.encode(key, &page(content as u32))))
            });
            assert_eq!(placed.unwrap().is_some(), content < 3);
        }
        assert_eq!(made, [1; 4]);
        let header = writer.finish(Totals::default()).unwrap();
        assert_eq!((header.pages.stored, header.pages.shared, header.pages.uniform), (2, 18, 10));
        let archive = Archive::open(&target).unwrap();
        for entry in archive.entries() {
            let entry = entry.unwrap();
            assert_eq!(archive.page(&entry).unwrap(), page(entry.key.layer as u32 % 4));
        }
        archive.verify(&crate::NoMonitor, &mut |finding| panic!("{finding}")).unwrap();
    }

    /// Puts `contents` in order in an archive with levels; `content` makes each. Verifies the archive and returns how
    /// often each was made.
    fn made(
        copier: &mut Copier<usize>,
        contents: impl Iterator<Item = usize>,
        content: impl Fn(usize) -> Page,
    ) -> HashMap<usize, u32> {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
        let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        writer.set_levels();
        let (mut encoder, mut made) = (PageEncoder::of_plan(&plan), HashMap::new());
        for (layer, number) in (0..).zip(contents) {
            let key = PageKey { tx: 0, ty: 0, layer };
            let placed = copier.put(&mut writer, key, number, EncodedColours::default(), || {
                *made.entry(number).or_default() += 1;
                Ok(Some(encoder.encode(key, &content(number))))
            });
            assert!(placed.unwrap().is_some());
        }
        writer.finish(Totals::default()).unwrap();
        let archive = Archive::open(&target).unwrap();
        archive.verify(&crate::NoMonitor, &mut |finding| panic!("{finding}")).unwrap();
        made
    }

    #[test]
    fn the_oldest_content_is_forgotten_first() {
        let content = |number: usize| {
            let mut builder = PageBuilder::default();
            assert!(builder.set_column(number as u32, 0, &[Span::new(5, 9, false).unwrap()]));
            builder.build()
        };
        let made = made(&mut Copier::knowing(2), [0, 1, 0, 2, 1, 0].into_iter(), content);
        assert_eq!(made, HashMap::from([(0, 2), (1, 1), (2, 1)]));
    }

    #[test]
    fn content_is_made_again_once_its_coarse_spans_are_dropped() {
        // Sixteen spans in each pixel of level 1.
        const SPANS: usize = 16 * 16 * 16;
        let content = |number: usize| {
            let mut builder = PageBuilder::default();
            for pixel in 0..16 * 16 {
                let bottoms = (0..16).map(|slice| 1020 * slice + 340 + number as u32);
                let spans: Vec<_> = bottoms.map(|bottom| Span::new(bottom, bottom + 9, false).unwrap()).collect();
                assert!(builder.set_column(pixel % 16 * 4, pixel / 16 * 4, &spans));
            }
            builder.build()
        };
        // All are kept up to the last one, which takes more than there is room for.
        let last = COARSE_KEPT / SPANS;
        let contents = (0..last).chain([0, 1, last, 0, last, 0]);
        let made = made(&mut Copier::new(), contents, content);
        assert_eq!((made[&0], made[&1], made[&last]), (2, 1, 1));
    }
}
