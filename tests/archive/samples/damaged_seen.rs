//! Samples that break the rules of seen space (chapter 15). All checksums are right but the one whose rule is broken.

use super::good::part;
use crate::common::forge::{Parts, pack, put};
use crate::common::{archive, key, two_pixels};
use slicewalk::archive::{Archive, ArchiveWriter};
use slicewalk::codec::put_varint;
use slicewalk::frame::PageKey;
use slicewalk::seen::{SeenBlock, SeenPage};

/// Names, broken rules and bytes.
pub fn all() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let sound = || Section::of(&[block(key(0, 0, 0))]);
    let made = |change: &dyn Fn(&mut Section)| {
        let mut section = sound();
        change(&mut section);
        section.archive()
    };
    let masks = |full: u64, part: u64, pages: &[SeenPage]| {
        let mut raw = [full, part].map(u64::to_le_bytes).concat();
        pages.iter().for_each(|page| page.encode(&mut raw));
        let count = pages.len() as u8;
        made(&|section| section.blocks[0] = Block { raw: raw.clone(), pages: count, ..section.blocks[0].clone() })
    };
    let (some, all) = (corner(), SeenPage::ALL);
    vec![
        ("seen-space-without-a-section", "V1", Parts::of(&archive(&two_pixels())).build(|head| with_seen(head))),
        ("flipped-in-trailer-of-seen-space", "V1", flipped(&sound(), 39 - 20)),
        ("seen-space-longer-than-the-pages", "V1", made(&|section| section.more_len = 1 << 20)),
        ("seen-space-without-a-table", "V1", made(&|section| section.table_len = Some(0))),
        ("seen-space-of-too-many-blocks", "V1", made(&|section| section.count = Some(1 << 10))),
        ("flipped-in-table-of-seen-space", "V2", flipped(&sound(), 42)),
        ("seen-space-out-of-order", "V2", Section::of(&[block(key(0, 0, 0)), block(key(0, 0, 0))]).archive()),
        ("seen-space-beyond-the-grid", "V2", Section::of(&[block(key(0, 0, 1 << 24))]).archive()),
        ("seen-space-beyond-all-columns", "V2", beyond_all_columns()),
        ("seen-block-of-no-bytes", "V2", made(&|section| section.blocks[0].len = Some(0))),
        ("seen-block-longer-than-any", "V2", made(&|section| section.blocks[0].len = Some(135_185))),
        ("seen-space-of-65-pages", "V2", made(&|section| section.blocks[0].pages = 65)),
        ("bytes-left-in-table-of-seen-space", "V2", made(&|section| section.left_in_table = 1)),
        ("bytes-left-in-seen-space", "V2", made(&|section| section.left = 1)),
        ("flipped-in-seen-space", "V3", made(&|section| section.blocks[0].flips = true)),
        ("seen-page-of-two-kinds", "V3", masks(1, 1, &[some])),
        ("seen-block-without-pages", "V3", masks(0, 0, &[])),
        ("seen-pages-miscounted", "V3", masks(2, 5, &[some])),
        ("seen-page-in-part-with-all-cells", "V3", masks(2, 1, &[all])),
        ("seen-page-in-part-without-cells", "V3", masks(2, 1, &[SeenPage::NOTHING])),
        ("seen-block-cut-short", "V3", made(&|section| section.blocks[0].raw.truncate(2000))),
        ("bytes-left-in-seen-block", "V3", made(&|section| section.blocks[0].raw.push(0))),
        ("seen-cells-miscounted", "V4", made(&|section| section.more_cells = 1)),
        ("seen-space-of-another-part", "V5", of_another_part()),
        ("gap-before-seen-space", "D9", made(&|section| section.before = 1)),
    ]
}

/// Some cells of three slices.
fn corner() -> SeenPage {
    let mut page = SeenPage::NOTHING;
    page.mark([[2, 5], [0, 3], [1, 3]]);
    page
}

/// A block of one page seen in part and one seen entirely.
fn block(key: PageKey) -> SeenBlock {
    let mut block = SeenBlock::new(key);
    block.push(0, &corner());
    block.push(1, &SeenPage::ALL);
    block
}

/// Sets the bit of seen space.
fn with_seen(head: &mut [u8]) {
    put(head, 24, 4, 8);
}

/// Two blocks, the second of which lies more columns from the first than there are.
fn beyond_all_columns() -> Vec<u8> {
    let mut section = Section::of(&[block(key(0, 0, 0)), block(key(1, 0, 0))]);
    section.blocks[1].columns = Some(u64::MAX);
    section.archive()
}

/// A block, and what the table says of it.
#[derive(Clone)]
struct Block {
    key: PageKey,
    raw: Vec<u8>,
    pages: u8,
    /// Columns from the block before, and length, in place of the truth.
    columns: Option<u64>,
    len: Option<u64>,
    /// True if a bit of its bytes is flipped.
    flips: bool,
}

/// A section of seen space, and in what it lies.
struct Section {
    blocks: Vec<Block>,
    /// What the trailer says in place of the truth.
    table_len: Option<u32>,
    count: Option<u32>,
    more_len: u64,
    more_cells: u64,
    cells: u64,
    /// Zero bytes before the section, before its table, and at the end of the content of the table.
    before: usize,
    left: usize,
    left_in_table: usize,
}

impl Section {
    fn of(blocks: &[SeenBlock]) -> Self {
        let made = |block: &SeenBlock| {
            let mut raw = [block.full, block.mixed].map(u64::to_le_bytes).concat();
            block.pages.iter().for_each(|page| page.encode(&mut raw));
            Block { key: block.key, raw, pages: block.pages.len() as u8, columns: None, len: None, flips: false }
        };
        Self {
            blocks: blocks.iter().map(made).collect(),
            table_len: None,
            count: None,
            more_len: 0,
            more_cells: 0,
            cells: blocks.iter().map(SeenBlock::cells).sum(),
            before: 0,
            left: 0,
            left_in_table: 0,
        }
    }

    fn bytes(&self) -> Vec<u8> {
        let (mut section, mut table) = (Vec::new(), Vec::new());
        let (mut lens, mut checksums) = (Vec::new(), Vec::new());
        for block in &self.blocks {
            let start = section.len();
            pack(&block.raw, &mut section);
            let key = [block.key.tx, block.key.ty, block.key.layer].map(i32::to_le_bytes);
            let crc = crc32c::crc32c_append(crc32c::crc32c(key.as_flattened()), &section[start..]);
            put_varint(&mut lens, block.len.unwrap_or((section.len() - start) as u64));
            checksums.extend(crc.to_le_bytes());
            section[start] ^= u8::from(block.flips);
        }
        section.resize(section.len() + self.left, 0);
        let (mut column, mut group) = (0, 0);
        for block in &self.blocks {
            put_varint(&mut table, block.columns.unwrap_or(block.key.column() - column));
            column = block.key.column();
        }
        for block in &self.blocks {
            // Zigzag of a difference that is not negative.
            put_varint(&mut table, 2 * (block.key.layer as u64 - group));
            group = block.key.layer as u64;
        }
        table.extend(self.blocks.iter().map(|block| block.pages));
        table.extend([&lens[..], &checksums, &vec![0; self.left_in_table]].concat());
        let start = section.len();
        pack(&table, &mut section);
        let table_crc = crc32c::crc32c(&section[start..]);
        let table_len = self.table_len.unwrap_or((section.len() - start) as u32);
        let mut trailer = b"\x89SEE\r\n\x1a\n".to_vec();
        trailer.extend((section.len() as u64 + 40 + self.more_len).to_le_bytes());
        trailer.extend((self.cells + self.more_cells).to_le_bytes());
        trailer.extend(self.count.unwrap_or(self.blocks.len() as u32).to_le_bytes());
        trailer.extend([table_len, table_crc].map(u32::to_le_bytes).concat());
        trailer.extend(crc32c::crc32c(&trailer).to_le_bytes());
        [&section[..], &trailer].concat()
    }

    /// The archive of two pixels with this section.
    fn archive(&self) -> Vec<u8> {
        let mut parts = Parts::of(&archive(&two_pixels()));
        parts.pages.resize(parts.pages.len() + self.before, 0);
        parts.pages.extend(self.bytes());
        parts.build(|head| with_seen(head))
    }
}

/// The archive with a bit flipped in the byte `from_end` before the end of the section.
fn flipped(section: &Section, from_end: usize) -> Vec<u8> {
    let mut parts = Parts::of(&section.archive());
    let at = parts.pages.len() - 1 - from_end;
    parts.pages[at] ^= 0x10;
    parts.build(|_| ())
}

/// A part whose seen space lies in a column before its own.
fn of_another_part() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("part.slices");
    let mut writer = ArchiveWriter::create(&target, &crate::common::plan(), false).unwrap();
    writer.set_shard(part());
    writer.set_seen();
    writer.put_seen(&block(key(-1, -1, 0))).unwrap();
    writer.finish(Default::default()).unwrap();
    let bytes = std::fs::read(target).unwrap();
    assert!(Archive::from_bytes(bytes.clone()).unwrap().seen_space(1 << 20).is_ok());
    bytes
}
