//! Verifies the levels of an archive: rebuilds them from its pages and compares page by page.
//!
//! Memory: that of a [`LevelBuilder`], and one directory leaf and one page of each level, with their colours.

use super::super::catalog::Catalog;
use super::super::colour_check::ColourCheck;
use super::super::directory::{LeafEntries, PageEntry, Storage};
use super::super::head::Pages;
use super::super::page_coding::{LEVEL_MAGIC, PageDecoder, PageEncoder};
use super::super::reader::Archive;
use super::build::LevelBuilder;
use super::coarse::CoarseSpan;
use super::level_colours::{CoarseColour, VoxelSum, exact};
use crate::bytes::ByteSource;
use crate::codec::Violation;
use crate::disk::Files;
use crate::frame::PageKey;
use crate::page::{Inferred, Occupancy, Page};
use crate::{Error, Result};

/// Compares the levels of an archive with those rebuilt from its pages.
pub struct LevelCheck<'a> {
    builder: LevelBuilder,
    /// True while all pages were sound; otherwise the expected content of levels is unknown.
    comparing: bool,
    levels: Vec<Checked<'a>>,
    scratch: Scratch,
}

struct Scratch {
    decoder: PageDecoder,
    encoder: PageEncoder,
    bytes: Vec<u8>,
    /// Findings that were not taken yet.
    found: Vec<Error>,
}

/// A level and the progress of reading it.
struct Checked<'a> {
    number: u32,
    source: &'a dyn ByteSource,
    catalog: &'a Catalog,
    leaf: usize,
    entries: Option<LeafEntries>,
    /// Entries read up to now.
    pages: Pages,
    /// Where the next stored page begins (byte offset).
    next: u64,
    /// True after the first finding; a level reports only one.
    broken: bool,
    /// Check of its colours, until they show a violation.
    colours: Option<ColourCheck>,
}

impl<'a> LevelCheck<'a> {
    /// Starts the check of the levels of `archive`. Fails if their table is damaged.
    pub fn new(archive: &'a Archive) -> Result<Self> {
        let levels = archive.levels()?.iter().map(|level| Checked {
            number: level.number(),
            source: archive.source(),
            catalog: level.catalog(),
            leaf: 0,
            entries: None,
            pages: Pages::default(),
            next: level.bytes().start,
            broken: false,
            colours: None,
        });
        let mut levels: Vec<_> = levels.collect();
        let mut found = Vec::new();
        for level in &mut levels {
            match ColourCheck::of_level(&archive.level(level.number)?) {
                Ok(colours) => level.colours = colours,
                // Damage of the common table shows up in every level; report it once.
                Err(error) if found.iter().any(|other: &Error| other.to_string() == error.to_string()) => {}
                Err(error) => found.push(error),
            }
        }
        let (decoder, encoder) = (PageDecoder::new(), PageEncoder::of_levels());
        Ok(Self {
            builder: LevelBuilder::new(archive.frame(), &Files::current(), None),
            comparing: true,
            levels,
            scratch: Scratch { decoder, encoder, bytes: Vec::new(), found },
        })
    }

    /// Takes the findings collected since the last call.
    pub fn found(&mut self) -> Vec<Error> {
        std::mem::take(&mut self.scratch.found)
    }

    /// Stops comparing, because a page of the archive is not sound.
    pub fn give_up(&mut self) {
        self.comparing = false;
    }

    /// Adds page `key` of the archive by its coarse spans and colours. Keys must ascend.
    pub fn add(&mut self, key: PageKey, spans: &[CoarseSpan], colours: &[CoarseColour]) {
        let Self { builder, comparing, levels, scratch } = self;
        if *comparing {
            let added = builder.add(key, spans, colours, &mut |at, key, page, sums| {
                compare(levels, scratch, at, key, page, sums);
                Ok(())
            });
            if let Err(error) = added {
                scratch.found.push(error);
                *comparing = false;
            }
        }
    }

    /// Ends the pages and checks what is left of each level.
    pub fn finish(&mut self) {
        let Self { builder, comparing, levels, scratch } = self;
        if *comparing {
            let count = builder.finish(&mut |at, key, page, sums| {
                compare(levels, scratch, at, key, page, sums);
                Ok(())
            });
            match count {
                Ok(count) if count < levels.len() => {
                    let wrong = Violation::new("L5", format!("{count} levels"), levels.len());
                    scratch.found.push(levels[count].error(wrong));
                    levels[count..].iter_mut().for_each(|level| level.broken = true);
                }
                Ok(_) => {}
                Err(error) => {
                    scratch.found.push(error);
                    *comparing = false;
                }
            }
        }
        for level in levels.iter_mut().filter(|level| !level.broken) {
            let ended = level.rest(*comparing, scratch);
            scratch.found.extend(ended.err());
        }
    }
}

fn compare(levels: &mut [Checked<'_>], scratch: &mut Scratch, at: usize, key: PageKey, page: &Page, sums: &[VoxelSum]) {
    match levels.get_mut(at) {
        Some(level) if level.broken => {}
        Some(level) => {
            if let Err(error) = level.compare(key, page, sums, scratch) {
                level.broken = true;
                scratch.found.push(error);
            }
        }
        None if scratch.found.is_empty() => {
            let at = levels.last().map_or(0, |level| level.catalog.header().metadata_offset());
            let wrong = Violation::new("L5", format!("more than {} levels", levels.len()), levels.len());
            scratch.found.push(wrong.at("levels", at));
        }
        None => {}
    }
}

impl Checked<'_> {
    fn error(&self, violation: Violation) -> Error {
        violation.at(format!("level {}", self.number), self.catalog.header().pages_offset())
    }

    fn next_entry(&mut self, scratch: &mut Scratch) -> Result<Option<PageEntry>> {
        loop {
            if let Some(entries) = &mut self.entries {
                if let Some(entry) = entries.next() {
                    let entry = entry?;
                    match entry.storage {
                        Storage::Stored(_) => self.pages.stored += 1,
                        Storage::Shared(_) => self.pages.shared += 1,
                        Storage::Uniform(_) => self.pages.uniform += 1,
                    }
                    return Ok(Some(entry));
                }
                self.entries = None;
            }
            if self.leaf == self.catalog.leaf_count() {
                return Ok(None);
            }
            let range = self.catalog.leaf_range(self.leaf);
            let mut stored = vec![0; (range.end - range.start) as usize];
            self.source.read_at(range.start, &mut stored)?;
            self.entries = Some(self.catalog.open_leaf(self.leaf, &stored)?);
            if let Some(colours) = &mut self.colours
                && let Err(error) = colours.open_leaf(self.leaf)
            {
                self.colours = None;
                scratch.found.push(error);
            }
            self.leaf += 1;
        }
    }

    /// Checks that the next page of the level is `key` and equals `page`.
    fn compare(&mut self, key: PageKey, page: &Page, sums: &[VoxelSum], scratch: &mut Scratch) -> Result<()> {
        let entry = self.next_entry(scratch)?;
        let Some(entry) = entry.filter(|entry| entry.key == key) else {
            let found = entry.map_or("none".into(), |entry| format!("page {}", entry.key));
            return Err(self.error(Violation::new(
                "L5",
                format!("page {key}, because the level below is occupied there"),
                found,
            )));
        };
        if self.page(&entry, scratch)? != *page {
            let wrong = Violation::new("L5", "what the pages below make", "something else");
            let at = entry.bytes().start;
            return Err(wrong.at(format!("page {key} of level {}", self.number), at));
        }
        self.page_colours(key, page, Some(sums), scratch);
        Ok(())
    }

    /// Checks the colours of page `key`, whose content is `page`, against `sums` if these are known.
    fn page_colours(&mut self, key: PageKey, page: &Page, sums: Option<&[VoxelSum]>, scratch: &mut Scratch) {
        if let Some(Err(error)) = self.colours.as_mut().map(|check| check_colours(check, key, page, sums)) {
            self.colours = None;
            scratch.found.push(error);
        }
    }

    /// Reads a page; checks that it lies where it must and has the canonical encoding.
    fn page(&mut self, entry: &PageEntry, Scratch { decoder, encoder, bytes, .. }: &mut Scratch) -> Result<Page> {
        bytes.clear();
        let (name, at) = (format!("page {} of level {}", entry.key, self.number), entry.bytes().start);
        if let Storage::Stored(extent) = entry.storage {
            let expected = std::mem::replace(&mut self.next, at + u64::from(extent.len));
            if at != expected {
                return Err(Violation::new("D9", format!("the page at byte {expected}"), at).at(name, at));
            }
            bytes.resize(extent.len as usize, 0);
            self.source.read_at(at, bytes)?;
        } else if let Storage::Shared(_) = entry.storage {
            return Err(Violation::new("D10", "no shared page in a level", "one").at(name, at));
        }
        let page = decoder.decode(entry, bytes)?;
        let one = bytes.is_empty() || encoder.gives(&page, &Inferred::NONE, bytes);
        match bytes.get(..4) {
            Some(magic) if magic != LEVEL_MAGIC => {
                Err(Violation::new("P1", "the magic of a page of a level", "another").at(name, at))
            }
            _ if !one => Err(Violation::new("P10", "the one encoding of its content", "another").at(name, at)),
            _ => Ok(page),
        }
    }

    /// Checks the remaining entries, of which there must be none if all were `compared`, then that the table counts the
    /// pages, and that these end where they must.
    fn rest(&mut self, compared: bool, scratch: &mut Scratch) -> Result<()> {
        while let Some(entry) = self.next_entry(scratch)? {
            if compared {
                let found = format!("page {}", entry.key);
                return Err(self.error(Violation::new("L5", "no more pages: the level below is empty there", found)));
            }
            let page = self.page(&entry, scratch)?;
            self.page_colours(entry.key, &page, None, scratch);
        }
        self.colours_end(compared, scratch);
        let (header, counted) = (self.catalog.header(), self.pages);
        if compared && header.pages != counted {
            return Err(self.error(Violation::new("L5", format!("{counted:?}"), format!("{:?}", header.pages))));
        }
        let end = header.colours_offset();
        match self.next == end {
            true => Ok(()),
            false => Err(self.error(Violation::new("D9", format!("pages up to byte {end}"), self.next))),
        }
    }

    /// Checks that blocks end where they must (rule K8) and, if all pages were `compared`, that the number of coloured
    /// voxels matches the table (rule K10).
    fn colours_end(&mut self, compared: bool, scratch: &mut Scratch) {
        let Some(check) = self.colours.take() else { return };
        let counted = match check.stated_voxels() {
            stated if compared && stated != check.voxels => Err(Violation::new("K10", check.voxels, stated)),
            _ => Ok(()),
        };
        let part = || format!("colours of level {}", self.number);
        let at = check.start.unwrap_or(0);
        scratch.found.extend(check.at_end().and(counted).err().map(|violation| violation.at(part(), at)));
    }
}

/// Checks rules K4 to K9, and that the colours are the means of those below (rule K12).
fn check_colours(check: &mut ColourCheck, key: PageKey, page: &Page, sums: Option<&[VoxelSum]>) -> Result<()> {
    let Some(place) = check.place(key)? else { return Ok(()) };
    let block = check.block(&place, key, page)?;
    let Some(sums) = sums else { return Ok(()) };
    let right = match &block {
        Some(block) => block.is_of(&exact(check.occupancy(), sums)),
        None => sums.is_empty() || exact(&Occupancy::of(page), sums).iter().all(Option::is_none),
    };
    match right {
        true => Ok(()),
        false => {
            let violation = Violation::new("K12", "the means of the colours of the archive's voxels", "others");
            Err(check.broken(&place, key, violation))
        }
    }
}
