//! Verifying an archive: every byte is read and every rule checked; findings are listed and work goes on (chapter 8).
//!
//! Opening has checked head and footer, and that the sections fill the file without gap. What is left: the leaves
//! cover every page once and in order, every page is sound and canonical, and the totals and bounds of the head are true.
//! Memory: one leaf, 1 MiB of pages, and the places of the last 65,536 stored pages (about 2 MiB).

use super::dedup::WINDOW;
use super::directory::{Extent, PageEntry, Storage};
use super::head::{Pages, Tiles, Voxels};
use super::matter::Matter;
use super::page::{PageDecoder, PageEncoder};
use super::reader::Archive;
use super::shard::Shard;
use crate::codec::Violation;
use crate::monitor::Monitor;
use crate::slice::{Page, PageSize};
use crate::{Error, Result};
use std::collections::VecDeque;

/// Bytes of pages read at once.
const CHUNK: u64 = 1 << 20;

/// One rule that an archive breaks.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Finding {
    /// Rule id of the specification; `S1` if bytes could not be read at all.
    pub rule: &'static str,
    /// Part of the archive.
    pub part: String,
    /// First byte of the part.
    pub offset: u64,
    /// What the rule asks for.
    pub expected: String,
    /// What the bytes say.
    pub found: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { rule, part, offset, expected, found } = self;
        write!(f, "rule {rule}: {part} at byte {offset}: expected {expected}, found {found}")
    }
}

/// What a verification went through.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct VerifySummary {
    /// Number of findings; 0 means that the archive is sound.
    pub findings: u64,
    /// Bytes read and checked.
    pub bytes: u64,
    /// Pages of sound entries.
    pub pages: Pages,
    /// Tiles of sound pages.
    pub tiles: Tiles,
    /// Voxels of sound pages.
    pub voxels: Voxels,
    /// Lowest and highest slice of the entries.
    pub slices: Option<(i64, i64)>,
}

impl Archive {
    /// Reads and checks every byte; gives each finding to `findings` and goes on. Fails only if `monitor` asks to stop.
    /// Cost: one pass over the file, each page decoded and encoded again.
    pub fn verify(&self, monitor: &dyn Monitor, findings: &mut dyn FnMut(Finding)) -> Result<VerifySummary> {
        let header = self.header();
        monitor.stage("verify", header.pages.total(), "pages");
        let mut pass = Pass {
            archive: self,
            findings,
            summary: VerifySummary { bytes: header.bytes.head + super::head::FOOTER as u64, ..Default::default() },
            decoder: PageDecoder::new(),
            encoder: PageEncoder::new(*self.frame()),
            chunk: (0, Vec::new()),
            shared: Vec::new(),
            next: Some(header.pages_offset()),
            lost_leaf: false,
            stored: VecDeque::new(),
            shard: None,
            matter: Matter::default(),
        };
        pass.metadata();
        for index in 0..self.leaf_count() {
            let entries = match self.leaf(index) {
                Ok(entries) => entries,
                Err(error) => {
                    pass.report(error, &format!("directory leaf {index}"), header.directory_offset());
                    // Where the pages of the next leaf begin can no longer be known.
                    pass.next = None;
                    pass.lost_leaf = true;
                    continue;
                }
            };
            for entry in &entries {
                if monitor.cancelled() {
                    return Err(Error::Interrupted);
                }
                pass.entry(entry);
                monitor.advance(1);
            }
        }
        pass.totals();
        Ok(pass.summary)
    }
}

struct Pass<'a> {
    archive: &'a Archive,
    findings: &'a mut dyn FnMut(Finding),
    summary: VerifySummary,
    decoder: PageDecoder,
    encoder: PageEncoder,
    /// Bytes read ahead, and where they begin.
    chunk: (u64, Vec<u8>),
    /// Bytes of a shared page, which lie far behind the chunk.
    shared: Vec<u8>,
    /// Where the next stored page must begin; unknown after a damaged leaf.
    next: Option<u64>,
    /// Some stored pages are not known because the leaf that tells of them is damaged.
    lost_leaf: bool,
    /// The most recent stored pages, which later ones may share; ascending.
    stored: VecDeque<(Extent, u64, PageSize)>,
    /// The part of a conversion that the archive says it holds.
    shard: Option<Shard>,
    /// Where the matter of sound pages lies.
    matter: Matter,
}

impl Pass<'_> {
    fn metadata(&mut self) {
        match self.archive.metadata() {
            Ok(metadata) => {
                self.summary.bytes += self.archive.header().bytes.metadata;
                self.shard = metadata.shard;
            }
            Err(error) => self.report(error, "metadata", self.archive.header().metadata_offset()),
        }
    }

    fn report(&mut self, error: Error, part: &str, at: u64) {
        self.summary.findings += 1;
        (self.findings)(match error {
            Error::Format { rule, part, offset, expected, found } => Finding { rule, part, offset, expected, found },
            other => {
                let expected = "bytes that can be read".into();
                Finding { rule: "S1", part: part.into(), offset: at, expected, found: other.to_string() }
            }
        });
    }

    fn violation(&mut self, violation: Violation, part: &str, at: u64) {
        self.report(violation.at(part, at), part, at);
    }

    fn entry(&mut self, entry: &PageEntry) {
        let part = format!("page {}", entry.key);
        let (low, high) = entry.slice_range();
        let (first, last) = self.summary.slices.unwrap_or((low, high));
        self.summary.slices = Some((first.min(low), last.max(high)));
        let at = entry.extent().map_or(0, |extent| extent.offset);
        if let Err(violation) = self.place(entry) {
            self.violation(violation, &part, at);
        }
        if let Some(shard) = self.shard.filter(|shard| !shard.columns().contains(&entry.key.column())) {
            let expected = format!("columns {:016x} to {:016x} of {shard}", shard.first, shard.last);
            self.violation(Violation::new("T5", expected, format!("{:016x}", entry.key.column())), &part, at);
        }
        match self.content(entry) {
            Ok(page) => {
                let (occupied, obstacle) = page.voxel_counts();
                self.summary.voxels.occupied += occupied;
                self.summary.voxels.obstacle += obstacle;
                if let Some(bounds) = page.bounds() {
                    self.matter.add(entry.key, &bounds);
                }
            }
            Err(error) => self.report(error, &part, at),
        }
    }

    /// Rules D9 and D10: stored pages lie one after the other, shared ones lie where a recent one does.
    fn place(&mut self, entry: &PageEntry) -> Result<(), Violation> {
        let tiles = entry.slices.count_ones() as u64;
        self.summary.tiles.occupied += tiles;
        match entry.storage {
            Storage::Uniform(_) => {
                self.summary.pages.uniform += 1;
                Ok(())
            }
            Storage::Stored(extent) => {
                self.summary.pages.stored += 1;
                self.summary.tiles.stored += tiles;
                self.summary.tiles.unique += tiles;
                if self.stored.len() == WINDOW {
                    self.stored.pop_front();
                }
                self.stored.push_back((extent, entry.slices, entry.size));
                let expected = self.next.replace(extent.offset + extent.len as u64);
                match expected {
                    Some(expected) if expected != extent.offset => {
                        Err(Violation::new("D9", format!("the page at byte {expected}"), extent.offset))
                    }
                    _ => Ok(()),
                }
            }
            Storage::Shared(extent) => {
                self.summary.pages.shared += 1;
                self.summary.tiles.stored += tiles;
                let first = self.stored.partition_point(|(stored, ..)| stored.offset < extent.offset);
                match self.stored.get(first) {
                    Some(&known) if known == (extent, entry.slices, entry.size) => Ok(()),
                    // What it shares may be of the lost leaf; the bytes are checked all the same.
                    _ if self.lost_leaf => Ok(()),
                    other => {
                        let expected = format!("one of the last {WINDOW} stored pages");
                        Err(Violation::new("D10", expected, format!("{extent:?} of {other:?}")))
                    }
                }
            }
        }
    }

    /// The page, decoded and encoded again.
    fn content(&mut self, entry: &PageEntry) -> Result<Page> {
        let Some(extent) = entry.extent() else {
            return self.decoder.decode(entry, &[]);
        };
        let bytes = match entry.storage {
            Storage::Shared(_) => {
                self.shared.resize(extent.len as usize, 0);
                self.archive.source().read_at(extent.offset, &mut self.shared)?;
                &self.shared[..]
            }
            _ => {
                let start = self.read_ahead(extent)?;
                &self.chunk.1[start..start + extent.len as usize]
            }
        };
        let page = self.decoder.decode(entry, bytes)?;
        if !self.encoder.gives(&page, bytes) {
            let part = format!("page {}", entry.key);
            return Err(Violation::new("P10", "the one encoding of its content", "another").at(part, extent.offset));
        }
        if matches!(entry.storage, Storage::Stored(_)) {
            self.summary.bytes += extent.len as u64;
        }
        Ok(page)
    }

    /// Makes the chunk hold `extent` and returns where in the chunk it begins.
    fn read_ahead(&mut self, extent: Extent) -> Result<usize> {
        let (start, bytes) = &mut self.chunk;
        let end = extent.offset + extent.len as u64;
        if extent.offset < *start || end > *start + bytes.len() as u64 {
            let section = self.archive.header().directory_offset();
            let ahead = (section - extent.offset).min(CHUNK.max(extent.len as u64)) as usize;
            *start = extent.offset;
            bytes.resize(ahead, 0);
            if self.archive.source().read_at(extent.offset, bytes).is_err() {
                // Something in the chunk cannot be read; maybe not what is wanted now.
                bytes.clear();
                bytes.resize(extent.len as usize, 0);
                if let Err(error) = self.archive.source().read_at(extent.offset, bytes) {
                    bytes.clear();
                    return Err(error);
                }
            }
        }
        Ok((extent.offset - self.chunk.0) as usize)
    }

    /// Rules D9, T1 to T4 and T6: the pages end where the directory begins, and the head counts and bounds what is
    /// there. Says nothing about totals where damage makes them wrong anyway.
    fn totals(&mut self) {
        let header = self.archive.header();
        let directory = header.directory_offset();
        if let Some(end) = self.next.filter(|&end| end != directory) {
            let violation = Violation::new("D9", format!("pages up to byte {directory}"), end);
            self.violation(violation, "pages", header.pages_offset());
        }
        if self.summary.findings > 0 {
            return;
        }
        self.summary.bytes += header.bytes.directory;
        let found = self.summary;
        let mut compare = |rule, stated: String, counted: String| {
            if stated != counted {
                self.violation(Violation::new(rule, counted, stated), "head", 0);
            }
        };
        compare("T1", format!("{:?}", header.pages), format!("{:?}", found.pages));
        compare("T2", format!("{:?}", header.tiles), format!("{:?}", found.tiles));
        compare("T3", format!("{:?}", header.voxels), format!("{:?}", found.voxels));
        compare("T4", format!("slices {:?}", header.slices), format!("slices {:?}", found.slices));
        let bounds = self.matter.check(&header.plan, self.shard.is_some(), header.bounds.as_ref());
        if let Err(violation) = bounds {
            self.violation(violation, "head", 0);
        }
    }
}
