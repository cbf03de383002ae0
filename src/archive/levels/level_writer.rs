//! Levels of an archive that is being written, buffered until the archive's own pages are complete.
//!
//! Memory per level: 256 KiB of pages, 1.5 MiB of entries and 512 KiB of colours; the rest waits in temporary files
//! beside the archive.

use super::super::colour_section::{ColourWriter, EncodedColours, LevelPart, encode_level_colours};
use super::super::directory::{Extent, PageEntry, Storage};
use super::super::head::{Pages, leaf_entries};
use super::super::page_coding::PageEncoder;
use super::super::spill::{Entries, Spool, write_leaves};
use super::build::LevelBuilder;
use super::coarse::CoarseSpan;
use super::level_colours::{CoarseColour, VoxelSum, exact};
use super::{LevelRecord, Levels, encode_table};
use crate::Result;
use crate::bytes::crc;
use crate::codec::ColourEncoder;
use crate::colour::ColourPlan;
use crate::disk::Files;
use crate::frame::PageKey;
use crate::page::{Occupancy, Page};
use crate::plan::Plan;
use std::path::{Path, PathBuf};

/// Builds and buffers the levels of an archive.
#[derive(Debug)]
pub struct LevelWriter {
    builder: LevelBuilder,
    made: Made,
}

/// Levels encoded up to now.
#[derive(Debug)]
struct Made {
    encoder: PageEncoder,
    /// How colours are encoded, if there are any.
    colours: Option<ColourPlan>,
    colour_encoder: ColourEncoder,
    occupancy: Occupancy,
    levels: Vec<LevelPages>,
    files: Files,
    beside: PathBuf,
}

/// Pages of one level.
#[derive(Debug)]
struct LevelPages {
    bytes: Spool,
    entries: Entries,
    pages: Pages,
    colours: Option<ColourWriter>,
}

impl LevelWriter {
    /// Creates the writer for an archive of `plan`; temporary files lie beside `target`.
    pub fn new(plan: &Plan, files: &Files, target: &Path) -> Self {
        let made = Made {
            encoder: PageEncoder::of_levels(),
            colours: None,
            colour_encoder: ColourEncoder::default().for_levels(false),
            occupancy: Occupancy::default(),
            levels: Vec::new(),
            files: files.clone(),
            beside: target.to_path_buf(),
        };
        Self { builder: LevelBuilder::new(&plan.frame, files, Some(target)), made }
    }

    /// Adds colours of `plan` to the levels. Must precede the first page.
    pub fn set_colours(&mut self, plan: ColourPlan) {
        self.made.colours = Some(plan);
    }

    /// Adds page `key` of the archive by its coarse spans and colours. Keys must ascend.
    pub fn add(&mut self, key: PageKey, spans: &[CoarseSpan], colours: &[CoarseColour]) -> Result<()> {
        let Self { builder, made } = self;
        builder.add(key, spans, colours, &mut |level, key, page, sums| made.put(level, key, page, sums))
    }

    /// Ends the pages.
    pub fn end(&mut self) -> Result<()> {
        let Self { builder, made } = self;
        let count = builder.finish(&mut |level, key, page, sums| made.put(level, key, page, sums))?;
        debug_assert_eq!(count, made.levels.len());
        Ok(())
    }

    /// Passes all bytes of the levels' colours to `give`, in order, and returns their number.
    pub fn finish_colours(&mut self, give: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<u64> {
        let Made { levels, files, beside, .. } = &mut self.made;
        let (mut parts, mut told) = (Spool::new(files, beside), Vec::new());
        for level in levels.iter_mut().rev() {
            if let Some(colours) = level.colours.take() {
                let leaf_entries = leaf_entries(level.entries.len());
                let (head, len) = colours.finish(leaf_entries, 0, &mut |bytes| parts.push(bytes))?;
                told.push(LevelPart { head, len });
            }
        }
        if told.is_empty() {
            return Ok(0);
        }
        told.reverse();
        let table = encode_level_colours(&told);
        give(&table)?;
        parts.read(give)?;
        Ok(table.len() as u64 + parts.len())
    }

    /// Passes all bytes of the levels section to `give`, in order. Returns the level fields of the head and the length
    /// of the section (bytes).
    pub fn finish(self, give: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<(Levels, u64)> {
        let (mut records, mut len) = (Vec::new(), 0);
        let made = self.made;
        for level in &made.levels {
            let pages_len = level.bytes.len();
            level.bytes.read(give)?;
            let leaf_entries = leaf_entries(level.entries.len());
            let leaves = write_leaves(&level.entries, leaf_entries, give)?;
            let record = LevelRecord { pages_len, pages: level.pages, leaf_entries, leaves };
            len += pages_len + record.directory_len();
            records.push(record);
        }
        if records.is_empty() {
            return Ok((Levels::default(), 0));
        }
        let table = encode_table(&records);
        give(&table)?;
        let table_len = table.len() as u32;
        let count = records.len() as u32;
        Ok((Levels { count, table_len, table_crc: crc::crc32c(&table) }, len + u64::from(table_len)))
    }
}

impl Made {
    fn put(&mut self, level: usize, key: PageKey, page: &Page, sums: &[VoxelSum]) -> Result<()> {
        let Self { encoder, colours: plan, colour_encoder, occupancy, levels, files, beside } = self;
        while levels.len() <= level {
            levels.push(LevelPages {
                bytes: Spool::new(files, beside),
                entries: Entries::new(files, beside),
                pages: Pages::default(),
                colours: plan.map(|plan| ColourWriter::new(plan, files, beside)),
            });
        }
        let LevelPages { bytes, entries, pages, colours } = &mut levels[level];
        let encoded = encoder.encode(key, page);
        let storage = match encoded.uniform {
            Some(span) => {
                pages.uniform += 1;
                Storage::Uniform(span)
            }
            None => {
                pages.stored += 1;
                let (offset, len) = (bytes.len(), encoded.bytes.len() as u32);
                bytes.push(&encoded.bytes)?;
                Storage::Stored(Extent { offset, len, crc: encoded.crc() })
            }
        };
        entries.push(PageEntry { key, slices: encoded.slices, size: encoded.size, storage })?;
        let Some(colours) = colours else { return Ok(()) };
        if sums.is_empty() {
            return colours.add(key, &EncodedColours::default());
        }
        occupancy.set(page);
        colours.add(key, &EncodedColours::new(&colours.plan, occupancy, &exact(occupancy, sums), colour_encoder))
    }
}
