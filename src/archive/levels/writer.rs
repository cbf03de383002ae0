//! Levels of an archive that is being written: their pages wait until those of the archive are complete.
//!
//! Memory: 256 KiB of pages and 1.5 MiB of entries a level; the rest waits in temporary files beside the archive.

use super::super::directory::{Extent, PageEntry, Storage};
use super::super::head::{Pages, leaf_entries};
use super::super::page::PageEncoder;
use super::super::spill::{Entries, Spool, write_leaves};
use super::build::LevelBuilder;
use super::coarse::CoarseSpan;
use super::{LEVEL_STEPS, LevelRecord, Levels, encode_table};
use crate::Result;
use crate::bytes::crc;
use crate::disk::Files;
use crate::frame::{Frame, PageKey};
use crate::slice::Page;
use std::path::{Path, PathBuf};

/// Makes and holds the levels of an archive.
#[derive(Debug)]
pub struct LevelWriter {
    builder: LevelBuilder,
    made: Made,
}

/// What was made so far.
#[derive(Debug)]
struct Made {
    encoder: PageEncoder,
    levels: Vec<LevelPages>,
    files: Files,
    beside: PathBuf,
}

/// The pages of one level.
#[derive(Debug)]
struct LevelPages {
    bytes: Spool,
    entries: Entries,
    pages: Pages,
}

impl LevelWriter {
    /// Of an archive on the grid `frame`; temporary files lie beside `target`.
    pub fn new(frame: &Frame, files: &Files, target: &Path) -> Self {
        let made = Made {
            encoder: PageEncoder::of_levels(LEVEL_STEPS),
            levels: Vec::new(),
            files: files.clone(),
            beside: target.to_path_buf(),
        };
        Self { builder: LevelBuilder::new(frame, LEVEL_STEPS, files, Some(target)), made }
    }

    /// Adds the page `key` of the archive by its coarse spans. Keys ascend.
    pub fn add(&mut self, key: PageKey, spans: &[CoarseSpan]) -> Result<()> {
        let Self { builder, made } = self;
        builder.add(key, spans, &mut |level, key, page| made.put(level, key, page))
    }

    /// Gives all bytes of the levels section, in order; what the head says of it, and its length (bytes).
    pub fn finish(mut self, give: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<(Levels, u64)> {
        let Self { builder, made } = &mut self;
        let count = builder.finish(&mut |level, key, page| made.put(level, key, page))?;
        debug_assert_eq!(count, made.levels.len());
        let (mut records, mut len) = (Vec::new(), 0);
        for level in &made.levels {
            let pages_len = level.bytes.len();
            level.bytes.read(give)?;
            let leaf_entries = leaf_entries(level.entries.len());
            let leaves = write_leaves(&level.entries, leaf_entries, give)?;
            let record = LevelRecord { pages_len, pages: level.pages, leaf_entries, leaves };
            len += pages_len + record.directory_len();
            records.push(record);
        }
        if count == 0 {
            return Ok((Levels::default(), 0));
        }
        let table = encode_table(&records);
        give(&table)?;
        let table_len = table.len() as u32;
        Ok((Levels { count: count as u32, table_len, table_crc: crc::crc32c(&table) }, len + u64::from(table_len)))
    }
}

impl Made {
    fn put(&mut self, level: usize, key: PageKey, page: &Page) -> Result<()> {
        let Self { encoder, levels, files, beside } = self;
        while levels.len() <= level {
            levels.push(LevelPages {
                bytes: Spool::new(files, beside),
                entries: Entries::new(files, beside),
                pages: Pages::default(),
            });
        }
        let LevelPages { bytes, entries, pages } = &mut levels[level];
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
        entries.push(PageEntry { key, slices: encoded.slices, size: encoded.size, storage })
    }
}
