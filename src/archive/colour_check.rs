//! Verification of the colours of an archive or level: blocks are contiguous, in order and sound (rules K2 to K10).
//!
//! Memory: one colour leaf and one block.

use super::colour_section::{ColourEntry, ColourReader};
use super::reader::Archive;
use crate::Result;
use crate::codec::{ColourBlock, ColourEncoder, Violation};
use crate::frame::PageKey;
use crate::page::{Occupancy, Page};

/// Colours with the progress of their verification.
pub(super) struct ColourCheck {
    reader: ColourReader,
    encoder: ColourEncoder,
    /// Entries of the current directory leaf that are still to come, last first; empty if unknown.
    leaf: Vec<ColourEntry>,
    /// Where the next block must begin (byte offset); unknown after a damaged leaf.
    next: Option<u64>,
    /// Where the blocks begin (byte offset), if known.
    pub start: Option<u64>,
    pub voxels: u64,
    /// Bytes of sound blocks.
    pub bytes: u64,
}

impl ColourCheck {
    /// Starts the check of `archive`, whose blocks begin at byte `start`, if that is known. Returns `None` without
    /// colours and fails if their table is damaged.
    pub fn new(archive: &Archive, start: Option<u64>) -> Result<Option<Self>> {
        let new = |reader| Self {
            reader,
            encoder: ColourEncoder::default(),
            leaf: Vec::new(),
            next: start,
            start,
            voxels: 0,
            bytes: 0,
        };
        Ok(ColourReader::new(archive)?.map(new))
    }

    /// Starts the check of a level, whose blocks begin where its colours do.
    pub fn of_level(archive: &Archive) -> Result<Option<Self>> {
        let mut check = Self::new(archive, None)?;
        if let Some(check) = &mut check {
            check.start = Some(check.reader.start());
            check.next = check.start;
        }
        Ok(check)
    }

    /// Loads the colour leaf of directory leaf `index`.
    pub fn open_leaf(&mut self, index: usize) -> Result<()> {
        match self.reader.leaf_entries(index) {
            Ok(mut entries) => {
                entries.reverse();
                self.leaf = entries;
                Ok(())
            }
            Err(error) => {
                self.lose_leaf();
                Err(error)
            }
        }
    }

    /// Forgets where blocks lie, because the colour leaf or the directory leaf is damaged.
    pub fn lose_leaf(&mut self) {
        (self.leaf, self.next) = (Vec::new(), None);
    }

    /// Returns where the colours of the leaf's next page, `key`, lie (rule K8), or `None` if unknown.
    pub fn place(&mut self, key: PageKey) -> Result<Option<ColourEntry>> {
        let Some(place) = self.leaf.pop() else { return Ok(None) };
        let expected = self.next.replace(place.range().end);
        match expected.filter(|&expected| expected != place.offset) {
            Some(expected) => {
                let violation = Violation::new("K8", format!("the block at byte {expected}"), place.offset);
                Err(self.reader.broken(&place, key, violation))
            }
            None => Ok(Some(place)),
        }
    }

    /// Reads the block at `place` of page `key`, whose content is `page` (rules K4 to K7, K9); `None` if it has no
    /// colours.
    pub fn block(&mut self, place: &ColourEntry, key: PageKey, page: &Page) -> Result<Option<ColourBlock>> {
        let Some(mut block) = self.reader.block(place, key, page)? else { return Ok(None) };
        if !self.reader.is_canonical(&mut block, &mut self.encoder) {
            let violation = Violation::new("K9", "the one encoding of its content", "another");
            return Err(self.reader.broken(place, key, violation));
        }
        self.voxels += block.count();
        self.bytes += u64::from(place.len);
        Ok(Some(block))
    }

    /// Returns the voxels of the page whose block was read last.
    pub fn occupancy(&self) -> &Occupancy {
        self.reader.occupancy()
    }

    /// Returns the error for a violation in the colours of page `key` at `place`.
    pub fn broken(&self, place: &ColourEntry, key: PageKey, violation: Violation) -> crate::Error {
        self.reader.broken(place, key, violation)
    }

    /// Returns the number of coloured voxels that the archive states.
    pub fn stated_voxels(&self) -> u64 {
        self.reader.stated_voxels()
    }

    /// Returns where blocks end and colour leaves begin (byte offset).
    pub fn end(&self) -> u64 {
        self.reader.blocks_end()
    }

    /// Checks that the blocks end where the leaves begin (rule K8), as far as that is known.
    pub fn at_end(&self) -> Result<(), Violation> {
        let end = self.end();
        match self.next.filter(|&found| found != end) {
            Some(found) => Err(Violation::new("K8", format!("blocks up to byte {end}"), found)),
            None => Ok(()),
        }
    }
}
