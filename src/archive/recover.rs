//! Making an archive again from what is left of a damaged one (chapter 9).
//!
//! Pages name themselves in their leaders, so a walk over the file finds every sound one, whatever became of directory
//! and footer. Uniform and shared pages are only told of by the directory: they come back as far as its leaves are
//! sound. The head gives the plan and where the leaves lie; without it, the plan must come from elsewhere.
//! Memory: 3 MiB of the file, one leaf, and one writer.

use super::catalog::Catalog;
use super::directory::{PageEntry, Place};
use super::head::{self, Bounds, Header, MAX_HEAD, Pages};
use super::metadata::Metadata;
use super::page::{self, EncodedPage, PageDecoder};
use super::reader::Archive;
use super::writer::{ArchiveWriter, Totals};
use crate::bytes::{ByteSource, FileSource};
use crate::frame::{PAGE_QUANTA, PageKey, TILE_PIXELS};
use crate::output::Existing;
use crate::plan::Plan;
use crate::slice::Page;
use crate::{Error, Monitor, Result};
use std::path::Path;

/// Bytes of the file read at once; at least a page fits.
const CHUNK: usize = 8 << 20;
const _: () = assert!(page::MAX_STORED_PAGE < CHUNK);

/// What a recovery found.
#[derive(Debug, Clone)]
pub struct Recovered {
    /// Head of the new archive.
    pub header: Header,
    /// Whether the damaged archive's head was sound.
    pub head: bool,
    /// Directory leaves: how many were sound, and how many there were; `None` if only a sound head could tell.
    pub leaves: Option<(usize, usize)>,
    /// Pages found: with bytes of their own, shared, uniform.
    pub found: Pages,
    /// Pages that the head counts and that were not found; `None` if only a sound head could tell.
    pub lost: Option<Pages>,
    /// Whether reference system and other metadata are lost or unknown.
    pub metadata_lost: bool,
}

impl Recovered {
    /// Whether the new archive is known to hold all that the damaged one held when it was whole.
    pub fn is_complete(&self) -> bool {
        self.lost.is_some_and(|lost| lost.total() == 0) && !self.metadata_lost
    }
}

/// Writes to `output` an archive of every page of the archive at `path` that is still sound. `plan` is that of the
/// archive; it is needed only where the head is damaged, and refused if a sound head says otherwise.
///
/// If nothing is lost the new archive has the bytes of the old one as it once was. Otherwise the point counts of its
/// head are those of the conversion, or 0 if that head is lost. Cost: one pass over the file, all pages decoded.
pub fn recover(
    path: &Path,
    plan: Option<&Plan>,
    output: &Path,
    overwrite: bool,
    monitor: &dyn Monitor,
) -> Result<Recovered> {
    let source = FileSource::open(path)?;
    let old = sound_head(&source).map(|catalog| {
        let archive = Archive::from_parts(Box::new(FileSource::open(path)?), catalog);
        Ok::<_, Error>(archive)
    });
    let old = old.transpose()?;
    let plan = match (old.as_ref().map(Archive::plan), plan) {
        (Some(told), Some(given)) if told != given => {
            let reason = format!("is not the plan of {}, whose head is sound; leave it out", path.display());
            return Err(Error::parameter("--plan", reason));
        }
        (Some(plan), _) | (None, Some(plan)) => plan.clone(),
        (None, None) => {
            let reason = "it is damaged, so grid and options are unknown; give them with --plan (sliceconv --write-plan \
                          makes one)";
            return Err(Error::input(path, "head", reason));
        }
    };
    monitor.stage("recover", source.len(), "bytes");
    let existing = Existing::replaced_if(overwrite);
    let mut writer = ArchiveWriter::begin(output, &plan, existing, [path].into_iter().collect())?;
    let start = old.as_ref().map_or(0, |archive| archive.header().pages_offset());
    let mut walk = Walk::new(&source, start);
    let mut told = Told::new(old.as_ref());
    let (mut found, mut matter) = (Pages::default(), Matter::default());
    let (mut from_walk, mut from_leaf) = (walk.next()?, told.next());
    while from_walk.is_some() || from_leaf.is_some() {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let next_key = |page: &Option<Found>| page.as_ref().map(|page| page.key);
        let (walked, leaf) = (next_key(&from_walk), next_key(&from_leaf));
        let takes_walked = walked.is_some_and(|walked| leaf.is_none_or(|leaf| walked <= leaf));
        let page = if takes_walked { from_walk.take() } else { from_leaf.take() };
        if takes_walked {
            // A directory that tells of the same page as shared or uniform is wrong about it.
            if walked == leaf {
                from_leaf = told.next();
            }
            from_walk = walk.next()?;
            monitor.advance(walk.passed());
        } else {
            from_leaf = told.next();
        }
        let Some(page) = page else { continue };
        matter.add(page.key, &page.page);
        match page.kind {
            Kind::Stored => found.stored += 1,
            Kind::Shared => found.shared += 1,
            Kind::Uniform => found.uniform += 1,
        }
        writer.put(page.key, EncodedPage::copied(page.key, &page.bytes, &page.page))?;
    }
    if found.total() == 0 && old.as_ref().is_none_or(|archive| archive.header().pages.total() > 0) {
        return Err(Error::input(path, "pages", "no sound page is left in it; convert the scan again"));
    }
    let lost = old.as_ref().map(|archive| {
        let stated = archive.header().pages;
        Pages {
            stored: stated.stored.saturating_sub(found.stored),
            shared: stated.shared.saturating_sub(found.shared),
            uniform: stated.uniform.saturating_sub(found.uniform),
        }
    });
    let metadata = old.as_ref().and_then(|archive| archive.metadata().ok());
    let metadata_lost = metadata.is_none();
    let Metadata { crs, shard, read, units } = metadata.unwrap_or_default();
    // With a page less it is no part that merges to the whole.
    if let Some(shard) = shard.filter(|_| lost.is_some_and(|lost| lost.total() == 0)) {
        writer.set_shard(shard);
        writer.set_read(read);
    }
    let totals = match old.as_ref().map(Archive::header) {
        Some(header) => Totals {
            points_read: header.points_read,
            points_kept: header.points_kept,
            points_withheld: header.points_withheld,
            points_excluded: header.points_excluded,
            bounds: header.bounds,
            crs,
            units,
        },
        None => Totals { bounds: matter.bounds(&plan), crs, units, ..Totals::default() },
    };
    let leaves = old.as_ref().map(|archive| (told.sound, archive.leaf_count()));
    let header = writer.finish(totals)?;
    Ok(Recovered { header, head: old.is_some(), leaves, found, lost, metadata_lost })
}

/// Head and leaves, if all of the head is there and right; the rest of the file may be cut.
fn sound_head(source: &FileSource) -> Option<Catalog> {
    let mut start = vec![0; MAX_HEAD];
    let there = source.len().min(MAX_HEAD as u64) as usize;
    source.read_at(0, &mut start[..there]).ok()?;
    let stated = u64::from_le_bytes(start[32..40].try_into().ok()?);
    let (header, leaves) = head::decode(&start, stated).ok()?;
    (header.bytes.head <= there as u64).then(|| Catalog::new(header, leaves))
}

enum Kind {
    Stored,
    Shared,
    Uniform,
}

/// A sound page: its bytes (none of a uniform one) and what they hold.
struct Found {
    key: PageKey,
    kind: Kind,
    bytes: Vec<u8>,
    page: Page,
}

/// Finds the pages that a file holds, by their leaders.
struct Walk<'a> {
    source: &'a FileSource,
    /// Bytes at hand, and where in the file they begin.
    window: Vec<u8>,
    start: u64,
    /// Where in the window the search goes on.
    at: usize,
    /// Where in the file the last report of progress was.
    reported: u64,
    last: Option<PageKey>,
    decoder: PageDecoder,
}

impl<'a> Walk<'a> {
    fn new(source: &'a FileSource, start: u64) -> Self {
        let start = start.min(source.len());
        Self { source, window: Vec::new(), start, at: 0, reported: 0, last: None, decoder: PageDecoder::new() }
    }

    /// Bytes passed since the last call.
    fn passed(&mut self) -> u64 {
        let at = self.start + self.at as u64;
        at - std::mem::replace(&mut self.reported, at)
    }

    /// The next sound page. Keys ascend in an archive, so a page that goes back is none.
    fn next(&mut self) -> Result<Option<Found>> {
        loop {
            let rest = &self.window[self.at..];
            let Some(begin) = rest.windows(page::MAGIC.len()).position(|bytes| *bytes == page::MAGIC) else {
                // The last bytes may be the first ones of a leader.
                let kept = rest.len().min(page::MAGIC.len() - 1);
                if !self.refill(self.window.len() - kept)? {
                    return Ok(None);
                }
                continue;
            };
            self.at += begin;
            let rest = &self.window[self.at..];
            let needed = page::stated_len(rest).unwrap_or(page::LEADER + 1);
            if rest.len() < needed && self.refill(self.at)? {
                continue;
            }
            let rest = &self.window[self.at..];
            if let Some((key, len, page)) = self.decoder.salvage(rest)
                && self.last.is_none_or(|last| last < key)
            {
                let bytes = rest[..len].to_vec();
                self.at += len;
                self.last = Some(key);
                return Ok(Some(Found { key, kind: Kind::Stored, bytes, page }));
            }
            self.at += 1;
        }
    }

    /// Forgets the window before `keep` and reads on behind it; whether there was more.
    fn refill(&mut self, keep: usize) -> Result<bool> {
        self.window.drain(..keep);
        self.start += keep as u64;
        self.at = 0;
        let have = self.window.len();
        let left = self.source.len() - (self.start + have as u64);
        let more = left.min((CHUNK - have) as u64) as usize;
        self.window.resize(have + more, 0);
        self.source.read_at(self.start + have as u64, &mut self.window[have..])?;
        Ok(more > 0)
    }
}

/// Shared and uniform pages, as the sound leaves of a directory tell of them.
struct Told<'a> {
    archive: Option<&'a Archive>,
    leaf: usize,
    entries: std::vec::IntoIter<PageEntry>,
    sound: usize,
    decoder: PageDecoder,
}

impl<'a> Told<'a> {
    fn new(archive: Option<&'a Archive>) -> Self {
        Self { archive, leaf: 0, entries: Vec::new().into_iter(), sound: 0, decoder: PageDecoder::new() }
    }

    fn next(&mut self) -> Option<Found> {
        let archive = self.archive?;
        loop {
            let Some(entry) = self.entries.next() else {
                if self.leaf == archive.leaf_count() {
                    return None;
                }
                if let Ok(entries) = archive.leaf(self.leaf) {
                    self.entries = entries.into_iter();
                    self.sound += 1;
                }
                self.leaf += 1;
                continue;
            };
            let kind = match entry.place {
                Place::Stored(_) => continue,
                Place::Shared(_) => Kind::Shared,
                Place::Uniform(_) => Kind::Uniform,
            };
            if let Ok(page) = archive.page_with(&entry, &mut self.decoder) {
                return Some(Found { key: entry.key, kind, bytes: self.decoder.bytes.clone(), page });
            }
        }
    }
}

/// Least and greatest pixel and height of pages, for the bounds of an archive whose head is lost.
#[derive(Default)]
struct Matter {
    range: Option<([i64; 3], [i64; 3])>,
}

impl Matter {
    fn add(&mut self, key: PageKey, page: &Page) {
        let (x, y, floor) =
            (i64::from(key.tx) * TILE_PIXELS, i64::from(key.ty) * TILE_PIXELS, i64::from(key.layer) * PAGE_QUANTA);
        for (px, py, spans) in page.columns() {
            let (Some(lowest), Some(highest)) = (spans.first(), spans.last()) else { continue };
            let (i, j) = (x + i64::from(px), y + i64::from(py));
            let low = [i, j, floor + i64::from(lowest.bottom())];
            let high = [i, j, floor + i64::from(highest.top())];
            let (min, max) = self.range.get_or_insert((low, high));
            for axis in 0..3 {
                min[axis] = min[axis].min(low[axis]);
                max[axis] = max[axis].max(high[axis]);
            }
        }
    }

    fn bounds(&self, plan: &Plan) -> Option<Bounds> {
        let frame = &plan.frame;
        let (min, max) = self.range?;
        let corner = |at: [i64; 3], z: f64| [frame.edge_of_pixel(at[0]), frame.edge_of_pixel(at[1]), z];
        let least = corner(min, frame.bottom_height(min[2]));
        Some((least, corner([max[0] + 1, max[1] + 1, 0], frame.top_height(max[2]))))
    }
}
