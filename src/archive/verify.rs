//! Verification of an archive: reads every byte, checks every rule, lists findings and continues (chapter 8).
//!
//! Opening has checked head and footer, and that the sections fill the file without gaps. Verification checks that the
//! leaves list every page once and in order, that every page is sound and canonical, and that the totals and bounds in
//! the head are right.
//!
//! Memory: the bytes of one leaf, 1 MiB of pages, and the results of the last 65,536 stored pages (about 8 MiB), which
//! also serve pages that share their bytes. Time: linear in the bytes of the pages and in their number.

use super::colour_check::ColourCheck;
use super::dedup::WINDOW;
use super::directory::{Content, Extent, PageEntry, Storage};
use super::head::{Pages, Tiles, Voxels};
use super::levels::{CoarseColour, CoarseSpan, LevelCheck, coarse, coarse_colours};
use super::page_coding::{PageDecoder, PageEncoder, check_entry, check_key, check_leader};
use super::reader::{Archive, read};
use super::seen::{SeenReader, SeenTable};
use super::shard::Shard;
use super::solid_bounds::Matter;
use crate::codec::Violation;
use crate::frame::TILE_PIXELS;
use crate::monitor::Monitor;
use crate::page::{Inferred, Page, PageBounds, PageSize, Span};
use crate::{Error, Result};
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

/// Limit on the coarse spans kept for all contents together: 4 MiB.
const COARSE_KEPT: usize = 1 << 19;
/// Bytes of pages read at once.
const CHUNK: u64 = 1 << 20;

/// Violation of one rule.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Finding {
    /// Rule of the specification; `S1` if bytes could not be read at all.
    pub rule: &'static str,
    /// Part of the archive.
    pub part: String,
    /// First byte of the part (offset from the start of the archive).
    pub offset: u64,
    /// Content that the rule requires.
    pub expected: String,
    /// Content of the archive.
    pub found: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { rule, part, offset, expected, found } = self;
        write!(f, "rule {rule}: {part} at byte {offset}: expected {expected}, found {found}")
    }
}

/// Result of a verification.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct VerifySummary {
    /// Number of findings; 0 means that the archive is sound.
    pub findings: u64,
    /// Bytes read and checked.
    pub bytes: u64,
    /// Pages with sound entries.
    pub pages: Pages,
    /// Tiles of sound pages.
    pub tiles: Tiles,
    /// Voxels of sound pages.
    pub voxels: Voxels,
    /// Lowest and highest occupied slice of the entries.
    pub slices: Option<(i64, i64)>,
}

impl Archive {
    /// Reads and checks every byte and continues after a finding. Passes the first [`LISTED`] findings of each rule to
    /// `findings`; the summary counts all.
    ///
    /// Fails if `monitor` cancels, if this is an overview level, and for archives whose pages
    /// [`entries`](Self::entries) refuses to list. Cost: one pass over the file; each stored page is decoded and
    /// encoded again.
    pub fn verify(&self, monitor: &dyn Monitor, findings: &mut dyn FnMut(Finding)) -> Result<VerifySummary> {
        if self.catalog().ignores_inferred() {
            return self.whole().verify(monitor, findings);
        }
        let header = self.header();
        header.check_repeats()?;
        if header.level > 0 {
            return Err(Error::parameter(
                format!("level {}", header.level),
                "verify the archive that it is a level of",
            ));
        }
        monitor.stage("verify", header.pages.total(), "pages");
        let mut pass = Pass {
            archive: self,
            findings,
            counts: HashMap::new(),
            summary: VerifySummary { bytes: header.bytes.head + super::head::FOOTER as u64, ..Default::default() },
            decoder: PageDecoder::new(),
            encoder: PageEncoder::of_plan(self.plan()),
            chunk: (0, Vec::new()),
            next: Some(header.pages_offset()),
            lost_leaf: false,
            stored: VecDeque::new(),
            shard: None,
            matter: Matter::default(),
            levels: None,
            coarse: HashMap::new(),
            coarse_kept: 0,
            colours: None,
            colour_decoder: PageDecoder::new(),
            pages_end: header.colours_offset(),
            lost_seen: false,
        };
        pass.metadata();
        pass.colour_table();
        pass.seen_space(monitor)?;
        if header.levels.is_some() {
            match LevelCheck::new(self) {
                Ok(levels) => pass.levels = Some(levels),
                Err(error) => pass.error(error, "table of levels", header.levels_offset()),
            }
        }
        for index in 0..self.leaf_count() {
            if let Err(error) = pass.leaf(index, monitor) {
                if monitor.cancelled() {
                    return Err(Error::Interrupted);
                }
                pass.error(error, &format!("directory leaf {index}"), header.directory_offset());
                // Where the pages and colours of the next leaf begin is now unknown.
                pass.next = None;
                pass.lost_leaf = true;
                if let Some(colours) = &mut pass.colours {
                    colours.lose_leaf();
                }
            }
        }
        pass.totals();
        Ok(pass.summary)
    }
}

/// Most findings of one rule that a verification lists; the rest are only counted.
pub const LISTED: u64 = 1000;
/// Pages between checks for cancellation.
const STRIDE: u64 = 1 << 6;
/// Pixels of a page.
const PIXELS: u64 = (TILE_PIXELS * TILE_PIXELS) as u64;

/// Contribution of a sound page to the totals.
#[derive(Debug, Clone, Copy)]
struct Facts {
    voxels: (u64, u64),
    inferred: u64,
    bounds: PageBounds,
}

impl Facts {
    fn of(page: &Page, inferred: &Inferred) -> Option<Self> {
        Some(Self { voxels: page.voxel_counts(), inferred: inferred.voxel_count(page), bounds: page.bounds()? })
    }

    /// Returns the facts of a page whose pixels all hold the one `span`.
    fn of_uniform(span: Span) -> Self {
        let voxels = PIXELS * u64::from(span.slice_mask().count_ones());
        let obstacle = if span.is_obstacle() { voxels } else { 0 };
        Self { voxels: (voxels, obstacle), inferred: 0, bounds: PageBounds::of_uniform(span) }
    }
}

/// A stored page already checked: its entry, and its facts or the rule that it breaks.
struct Seen {
    extent: Extent,
    slices: u64,
    size: PageSize,
    verdict: Result<Facts, Box<Violation>>,
}

struct Pass<'a> {
    archive: &'a Archive,
    findings: &'a mut dyn FnMut(Finding),
    /// Number of findings by rule.
    counts: HashMap<&'static str, u64>,
    summary: VerifySummary,
    decoder: PageDecoder,
    encoder: PageEncoder,
    /// Offset of the bytes read ahead, and the bytes.
    chunk: (u64, Vec<u8>),
    /// Where the next stored page must begin; unknown after a damaged leaf.
    next: Option<u64>,
    /// True if stored pages are unknown because their leaf is damaged.
    lost_leaf: bool,
    /// The most recent stored pages, which later ones may share; ascending.
    stored: VecDeque<Seen>,
    /// Part of a conversion that the archive claims to hold.
    shard: Option<Shard>,
    /// Extent of the solid of sound pages.
    matter: Matter,
    levels: Option<LevelCheck<'a>>,
    /// Contributions to levels by content, up to the limit, and their number of spans.
    coarse: HashMap<Content, Arc<[CoarseSpan]>>,
    coarse_kept: usize,
    /// `None` without colours, or if their table is damaged.
    colours: Option<ColourCheck>,
    colour_decoder: PageDecoder,
    /// Where the pages end; seen space may follow.
    pages_end: u64,
    /// True if that is unknown, because seen space is damaged.
    lost_seen: bool,
}

impl Pass<'_> {
    fn metadata(&mut self) {
        match self.archive.metadata() {
            Ok(metadata) => {
                self.summary.bytes += self.archive.header().bytes.metadata;
                self.shard = metadata.shard;
            }
            Err(error) => self.error(error, "metadata", self.archive.header().metadata_offset()),
        }
    }

    fn colour_table(&mut self) {
        let header = self.archive.header();
        // Colours of levels come first; their table is checked with the levels.
        let start = match header.level_colours() {
            None => Some(header.colours_offset()),
            Some(place) => match read(self.archive.source(), place.table()) {
                // A table that breaks a rule is found with the levels.
                Ok(table) => place.decode(&table).ok().and_then(|places| Some(places.first()?.range.end)),
                Err(error) => {
                    self.error(error, "table of the colours of levels", place.table().start);
                    None
                }
            },
        };
        match ColourCheck::new(self.archive, start) {
            Ok(check) => self.colours = check,
            Err(error) => self.error(error, "table of colours", header.colours_offset()),
        }
    }

    /// Checks seen space (rules V1 to V5), which ends the section of pages.
    fn seen_space(&mut self, monitor: &dyn Monitor) -> Result<()> {
        match self.archive.seen_table() {
            Ok(None) => {}
            Ok(Some(table)) => {
                self.pages_end = table.start();
                self.summary.bytes += table.bytes();
                return self.seen_blocks(&table, monitor);
            }
            Err(error) => {
                let at = self.archive.header().colours_offset();
                self.error(error, "seen space", at);
                // Where the pages end is now unknown.
                self.lost_seen = true;
            }
        }
        Ok(())
    }

    fn seen_blocks(&mut self, table: &SeenTable, monitor: &dyn Monitor) -> Result<()> {
        let (mut reader, mut cells, mut complete) = (SeenReader::new(self.archive), 0, true);
        for entry in table.entries() {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            if let Some(shard) = self.shard.filter(|shard| !shard.columns().contains(&entry.key.column())) {
                let expected = format!("columns {:016x} to {:016x} of {shard}", shard.first, shard.last);
                let found = format!("{:016x}", entry.key.column());
                self.error(Violation::new("V5", expected, found).at("seen space", table.start()), "seen space", 0);
            }
            match reader.block(entry) {
                Ok(block) => cells += block.cells(),
                Err(error) => {
                    complete = false;
                    self.error(error, "seen space", table.start());
                }
            }
        }
        if complete && cells != table.cells() {
            self.error(Violation::new("V4", cells, table.cells()).at("seen space", table.start()), "seen space", 0);
        }
        Ok(())
    }

    /// Loads the colour leaf of directory leaf `index`.
    fn colour_leaf(&mut self, index: usize) {
        if let Some(check) = &mut self.colours
            && let Err(error) = check.open_leaf(index)
        {
            let at = self.archive.header().colours_offset();
            self.error(error, &format!("colour leaf {index}"), at);
        }
    }

    /// Checks the colours of the leaf's next page and returns their contribution to levels, if there are any. For a
    /// page that is not sound, checks only where its colours lie.
    fn page_colours(&mut self, entry: &PageEntry, sound: bool) -> Box<[CoarseColour]> {
        let Some(mut check) = self.colours.take() else { return Box::default() };
        let checked = self.check_colours(&mut check, entry, sound);
        self.colours = Some(check);
        checked.unwrap_or_else(|error| {
            let at = self.archive.header().colours_offset();
            self.error(error, &format!("colours of page {}", entry.key), at);
            Box::default()
        })
    }

    /// Checks rules K4 to K9.
    fn check_colours(
        &mut self,
        check: &mut ColourCheck,
        entry: &PageEntry,
        sound: bool,
    ) -> Result<Box<[CoarseColour]>> {
        let Some(place) = check.place(entry.key)?.filter(|place| place.len > 0 && sound) else {
            return Ok(Box::default());
        };
        let page = self.archive.page_with(entry, &mut self.colour_decoder)?;
        let block = check.block(&place, entry.key, &page)?.filter(|_| self.levels.is_some());
        Ok(block.map_or_else(Box::default, |block| coarse_colours(check.occupancy(), block.rgb())))
    }

    /// Counts a finding of `rule`, and lists it unless there are too many.
    fn report(&mut self, rule: &'static str, finding: impl FnOnce() -> Finding) {
        self.summary.findings += 1;
        let count = self.counts.entry(rule).or_default();
        *count += 1;
        if *count <= LISTED {
            (self.findings)(finding());
        }
    }

    fn error(&mut self, error: Error, part: &str, at: u64) {
        match error {
            Error::Format { rule, part, offset, expected, found } => {
                self.report(rule, || Finding { rule, part, offset, expected, found });
            }
            other => self.report("S1", || {
                let expected = "bytes that can be read".into();
                Finding { rule: "S1", part: part.into(), offset: at, expected, found: other.to_string() }
            }),
        }
    }

    /// Reports a finding about the page of `entry`.
    fn page(&mut self, entry: &PageEntry, rule: &'static str, found: impl FnOnce() -> (String, String)) {
        self.report(rule, || {
            let offset = entry.bytes().start;
            let (expected, found) = found();
            Finding { rule, part: format!("page {}", entry.key), offset, expected, found }
        });
    }

    fn leaf(&mut self, index: usize, monitor: &dyn Monitor) -> Result<()> {
        self.colour_leaf(index);
        for (number, entry) in (0u64..).zip(self.archive.open_leaf(index)?) {
            if number.is_multiple_of(STRIDE) && monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            self.entry(&entry?);
            monitor.advance(1);
        }
        Ok(())
    }

    fn entry(&mut self, entry: &PageEntry) {
        let (low, high) = entry.slice_range();
        let (first, last) = self.summary.slices.unwrap_or((low, high));
        self.summary.slices = Some((first.min(low), last.max(high)));
        if let Some(shard) = self.shard.filter(|shard| !shard.columns().contains(&entry.key.column())) {
            let expected = || format!("columns {:016x} to {:016x} of {shard}", shard.first, shard.last);
            self.page(entry, "T5", || (expected(), format!("{:016x}", entry.key.column())));
        }
        self.summary.tiles.occupied += u64::from(entry.slices.count_ones());
        let facts = match entry.storage {
            Storage::Uniform(span) => {
                self.summary.pages.uniform += 1;
                Some(Facts::of_uniform(span))
            }
            Storage::Stored(extent) => self.stored(entry, extent),
            Storage::Shared(extent) => self.shared(entry, extent),
        };
        let colours = self.page_colours(entry, facts.is_some());
        if let Some(facts) = facts {
            self.summary.voxels.occupied += facts.voxels.0;
            self.summary.voxels.obstacle += facts.voxels.1;
            self.summary.voxels.inferred += facts.inferred;
            self.matter.add(entry.key, &facts.bounds);
        }
        if let Some(mut levels) = self.levels.take() {
            match self.coarse_of(entry) {
                Some(spans) => levels.add(entry.key, &spans, &colours),
                None => levels.give_up(),
            }
            self.level_findings(&mut levels);
            self.levels = Some(levels);
        }
    }

    /// Returns the contribution of the page of `entry` to levels; `None` after any finding.
    fn coarse_of(&mut self, entry: &PageEntry) -> Option<Arc<[CoarseSpan]>> {
        if self.summary.findings > 0 {
            return None;
        }
        let content = entry.content();
        if let Some(spans) = self.coarse.get(&content) {
            return Some(spans.clone());
        }
        let page = self.archive.page_with(entry, &mut self.decoder).ok()?;
        Some(self.keep_coarse(content, coarse(&page)))
    }

    fn keep_coarse(&mut self, content: Content, spans: Vec<CoarseSpan>) -> Arc<[CoarseSpan]> {
        if self.coarse_kept + spans.len() > COARSE_KEPT {
            self.coarse.clear();
            self.coarse_kept = 0;
        }
        self.coarse_kept += spans.len();
        let spans: Arc<[_]> = spans.into();
        self.coarse.insert(content, spans.clone());
        spans
    }

    fn level_findings(&mut self, levels: &mut LevelCheck<'_>) {
        let at = self.archive.header().levels_offset();
        for error in levels.found() {
            self.error(error, "levels", at);
        }
    }

    /// Checks a stored page: it follows the previous one (rule D9) and keeps the rules of pages.
    fn stored(&mut self, entry: &PageEntry, extent: Extent) -> Option<Facts> {
        let tiles = u64::from(entry.slices.count_ones());
        self.summary.pages.stored += 1;
        self.summary.tiles.stored += tiles;
        self.summary.tiles.unique += tiles;
        let expected = self.next.replace(extent.offset + u64::from(extent.len));
        if let Some(expected) = expected.filter(|&expected| expected != extent.offset) {
            let found = || (format!("the page at byte {expected}"), extent.offset.to_string());
            self.page(entry, "D9", found);
        }
        let verdict = match self.content(entry, extent) {
            Ok(verdict) => verdict,
            Err(error) => {
                self.error(error, &format!("page {}", entry.key), extent.offset);
                let unread = Violation::new("S1", "bytes that can be read", "those of a page that could not be");
                self.remember(entry, extent, Err(Box::new(unread)));
                return None;
            }
        };
        if let Err(violation) = &verdict {
            let Violation { rule, expected, found } = &**violation;
            self.page(entry, rule, || (expected.clone(), found.clone()));
        }
        let facts = verdict.as_ref().ok().copied();
        self.remember(entry, extent, verdict);
        facts
    }

    fn remember(&mut self, entry: &PageEntry, extent: Extent, verdict: Result<Facts, Box<Violation>>) {
        if self.stored.len() == WINDOW {
            self.stored.pop_front();
        }
        self.stored.push_back(Seen { extent, slices: entry.slices, size: entry.size, verdict });
    }

    /// Checks a shared page: it lies where a recent stored one does (rule D10), and inherits the result of that page.
    /// Rule P3 follows, because a stored page has the key of an earlier entry.
    fn shared(&mut self, entry: &PageEntry, extent: Extent) -> Option<Facts> {
        self.summary.pages.shared += 1;
        self.summary.tiles.stored += u64::from(entry.slices.count_ones());
        let first = self.stored.partition_point(|seen| seen.extent.offset < extent.offset);
        let seen = self
            .stored
            .get(first)
            .filter(|seen| (seen.extent, seen.slices, seen.size) == (extent, entry.slices, entry.size));
        match seen.map(|seen| seen.verdict.clone()) {
            Some(Ok(facts)) => Some(facts),
            Some(Err(violation)) => {
                let Violation { rule, expected, found } = *violation;
                self.page(entry, rule, || (expected, found));
                None
            }
            // The page that it shares may belong to the lost leaf.
            None if self.lost_leaf => None,
            None => {
                self.page(entry, "D10", || (format!("one of the last {WINDOW} stored pages"), format!("{extent:?}")));
                None
            }
        }
    }

    /// Decodes the bytes of a stored page and encodes them again.
    fn content(&mut self, entry: &PageEntry, extent: Extent) -> Result<Result<Facts, Box<Violation>>> {
        let start = self.read_ahead(extent)?;
        let bytes = &self.chunk.1[start..start + extent.len as usize];
        let (decoder, encoder) = (&mut self.decoder, &mut self.encoder);
        let header = self.archive.header();
        let (wanted, fills) = (self.levels.is_some(), header.plan.options.fill_holes > 0);
        let mut spans = Vec::new();
        let mut check = || {
            check_key(entry, check_leader(extent, bytes)?)?;
            let page = decoder.decode_body(bytes)?;
            check_entry(entry, page.slices(), page.size())?;
            if !fills && !decoder.inferred().is_empty() {
                return Err(Violation::new("P13", "inferred solid only if the plan fills holes", "some"));
            }
            if !encoder.gives(&page, decoder.inferred(), bytes) {
                return Err(Violation::new("P10", "the one encoding of its content", "another"));
            }
            if wanted {
                spans = coarse(&page);
            }
            Facts::of(&page, decoder.inferred()).ok_or_else(|| Violation::new("P6", "matter in some pixel", "none"))
        };
        let verdict = check();
        if verdict.is_ok() {
            self.summary.bytes += u64::from(extent.len);
            if wanted {
                self.keep_coarse(entry.content(), spans);
            }
        }
        Ok(verdict.map_err(Box::new))
    }

    /// Loads `extent` into the chunk and returns where in the chunk it begins.
    fn read_ahead(&mut self, extent: Extent) -> Result<usize> {
        let (start, bytes) = &mut self.chunk;
        let end = extent.offset + extent.len as u64;
        if extent.offset < *start || end > *start + bytes.len() as u64 {
            let section = self.archive.header().colours_offset();
            let ahead = (section - extent.offset).min(CHUNK.max(extent.len as u64)) as usize;
            *start = extent.offset;
            bytes.resize(ahead, 0);
            if self.archive.source().read_at(extent.offset, bytes).is_err() {
                // Part of the chunk cannot be read, perhaps not the page itself.
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

    /// Checks rules D9, T1 to T4 and T6: the pages end where the colours begin, and counts and bounds in the head are
    /// right. After any finding it skips the totals, which the damage would falsify.
    fn totals(&mut self) {
        let header = self.archive.header();
        let pages_end = self.pages_end;
        if let Some(end) = self.next.filter(|&end| end != pages_end && !self.lost_seen) {
            let violation = Violation::new("D9", format!("pages up to byte {pages_end}"), end);
            self.error(violation.at("pages", header.pages_offset()), "pages", 0);
        }
        if let Some(check) = self.colours.take() {
            if let Err(violation) = check.at_end() {
                self.error(violation.at("colours", header.colours_offset()), "colours", 0);
            }
            self.summary.bytes += check.bytes;
            let stated = check.stated_voxels();
            if self.summary.findings == 0 && stated != check.voxels {
                self.error(Violation::new("K10", check.voxels, stated).at("head", 0), "head", 0);
            }
            if self.summary.findings == 0 {
                let start = check.start.unwrap_or(header.colours_offset());
                self.summary.bytes += start - header.colours_offset() + header.levels_offset() - check.end();
            }
        }
        if let Some(mut levels) = self.levels.take() {
            if self.summary.findings > 0 {
                levels.give_up();
            }
            levels.finish();
            self.level_findings(&mut levels);
        }
        if self.summary.findings > 0 {
            return;
        }
        self.summary.bytes += header.bytes.levels + header.bytes.directory;
        let found = self.summary;
        let mut compare = |rule, stated: String, counted: String| {
            if stated != counted {
                self.error(Violation::new(rule, counted, stated).at("head", 0), "head", 0);
            }
        };
        compare("T1", format!("{:?}", header.pages), format!("{:?}", found.pages));
        compare("T2", format!("{:?}", header.tiles), format!("{:?}", found.tiles));
        compare("T3", format!("{:?}", header.voxels), format!("{:?}", found.voxels));
        compare("T4", format!("slices {:?}", header.slices), format!("slices {:?}", found.slices));
        let bounds = self.matter.check(&header.plan, self.shard.is_some(), header.bounds.as_ref());
        if let Err(violation) = bounds {
            self.error(violation.at("head", 0), "head", 0);
        }
    }
}
