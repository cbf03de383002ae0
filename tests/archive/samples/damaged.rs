//! Damaged and forged samples. Forged ones have right checksums and break the one rule that says so.

use crate::common::forge::{Parts, put, word};
use crate::common::{archive, archive_in_colour, archive_of, archive_with_colours, key, page, plan, scene, two_pixels};
use slicewalk::archive::{Archive, ColourReader, Totals};
use slicewalk::codec::{Encoder, Packer, put_varint};
use slicewalk::colour::{ColourPlan, ColourScale};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::Span;
use slicewalk::plan::{Plan, PlanOptions};

/// Names, broken rules and bytes.
pub fn all() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let good = archive(&two_pixels());
    let parts = Parts::of(&good);
    let sections = [parts.head.len(), parts.pages.len(), parts.stored_leaf().len(), parts.metadata.len()];
    let start = |section: usize| sections[..section].iter().sum::<usize>();
    let flipped = |at: usize| {
        let mut bytes = good.clone();
        bytes[at] ^= 0x10;
        bytes
    };
    let many = Parts::of(&archive(&scene()));
    let total = |at: usize, value: u64| many.build(|head| put(head, at, value, 8));
    let bound = |at: usize, value: f64| parts.build(|head| put(head, at, value.to_bits(), 8));
    // Where voxels were dropped, bounds may reach far beyond the matter, but not beyond the grid.
    let options = PlanOptions { min_points: 2, ..plan().options };
    let dropping = Parts::of(&archive_of(&Plan { options, ..plan() }, &two_pixels(), None));
    let coloured = Parts::of(&archive_with_colours(&two_pixels(), ColourScale::of_rgb(65_535), 0, false));
    let in_colours = |from_end: usize| {
        let mut parts = coloured.clone();
        let at = parts.pages.len() - from_end;
        parts.pages[at] ^= 2;
        parts.build(|_| ())
    };
    let metadata = |metadata: &[u8]| Parts { metadata: metadata.to_vec(), ..parts.clone() }.build(|_| ());
    vec![
        ("cut-in-head", "H2", good[..300].to_vec()),
        ("cut-in-page", "H6", good[..start(1) + 30].to_vec()),
        ("cut-in-footer", "H6", good[..good.len() - 1].to_vec()),
        ("continued", "H6", [&good[..], b"\n"].concat()),
        ("flipped-in-magic", "H1", flipped(3)),
        ("flipped-in-head", "H3", flipped(100)),
        ("flipped-in-page", "P2", flipped(start(1) + 30)),
        ("flipped-in-leaf", "D1", flipped(start(2) + 9)),
        ("flipped-in-metadata", "M1", flipped(start(3) + 9)),
        ("flipped-in-footer", "F2", flipped(start(4) + 2)),
        ("foreign-footer", "F3", [&good[..start(4)], &archive(&scene())[archive(&scene()).len() - 24..]].concat()),
        ("bytes-behind-the-root", "H10", behind_the_root(&parts)),
        ("root-without-room", "R1", two_leaves(&parts)),
        ("next-major-version", "H4", parts.build(|head| put(head, 8, 2, 2))),
        ("unknown-feature", "H5", parts.build(|head| put(head, 16, 1 << 40, 8))),
        ("wrong-plan", "H7", parts.build(|head| put(head, 64, 0.5f64.to_bits(), 8))),
        ("wrong-point-counts", "H8", parts.build(|head| put(head, 152, 1, 8))),
        (
            "wrong-pages",
            "T1",
            many.build(|head| [272, 280].into_iter().zip([0, 2]).for_each(|(at, n)| put(head, at, n, 8))),
        ),
        ("wrong-tiles", "T2", total(240, 1)),
        ("wrong-voxels", "T3", total(256, 0)),
        ("wrong-slices", "T4", total(216, 0)),
        (
            "no-bounds",
            "T6",
            parts.build(|head| {
                head[160..208].fill(0);
                head[324] = 0;
            }),
        ),
        ("narrow-bounds", "T6", bound(184, 0.09)),
        ("low-bounds", "T6", bound(200, 0.0164)),
        ("wide-bounds", "T6", bound(184, 6.7)),
        ("high-bounds", "T6", bound(200, 19.3)),
        ("bounds-beyond-the-grid", "T6", dropping.build(|head| put(head, 192, 1e300f64.to_bits(), 8))),
        ("infinite-bounds", "H8", bound(200, f64::INFINITY)),
        ("bounds-of-minus-zero", "H8", bound(160, -0.0)),
        ("points-beyond-counting", "H8", parts.build(|head| put(head, 144, u64::MAX, 8))),
        ("leaf-of-another-length", "D2", parts.build(|head| put(head, 404, parts.leaf.len() as u64 + 1, 4))),
        ("shares-no-page", "D10", shares_no_page(&many)),
        ("no-slices", "D7", with_leaf(&parts, 4, 0)),
        ("wrong-slices-of-page", "P9", with_leaf(&parts, 4, 2)),
        ("wrong-words-of-page", "P11", with_leaf(&parts, 18, 2)),
        ("draft", "H1", draft(&good)),
        ("unknown-coding", "P5", with_body(&parts, |body| body[0] = 5)),
        ("bits-left", "P6", with_body(&parts, |body| body.push(0))),
        ("holes-of-no-width", "H7", parts.build(|head| put(head, 16, 1, 8))),
        ("runs-of-too-many-spans", "P12", with_body(&parts, |body| drop(body.splice(..1, [4, 2, 1, 2])))),
        ("runs-that-end-scanned", "P12", with_body(&parts, |body| drop(body.splice(..1, [4, 3, 0, 1, 1])))),
        ("inferred-without-holes", "P13", with_body(&parts, |body| drop(body.splice(..1, [4, 2, 1, 1])))),
        ("words-left", "P6", with_body(&parts, |body| body.extend([0, 0]))),
        ("not-the-one-encoding", "P10", other_encoding()),
        ("colours-of-no-source", "K1", coloured.build(|head| put(head, 378, 4, 1))),
        ("colours-without-a-table", "K1", coloured.build(|head| put(head, 352, 11, 8))),
        ("flipped-in-table-of-colours", "K2", in_colours(1)),
        ("flipped-in-colour-leaf", "K3", in_colours(13)),
        ("flipped-in-colours", "K4", in_colours(coloured.pages.len() - 41)),
        ("more-colours-than-voxels", "K1", coloured.build(|head| put(head, 360, 1 << 20, 8))),
        ("colour-leaf-longer-than-any", "K2", with_colours(&coloured, |colours| colours.more_raw = 100)),
        ("colour-leaf-outside-its-section", "K2", with_colours(&coloured, |colours| colours.more_stored = 1000)),
        ("colour-leaf-of-another-length", "K3", with_colours(&coloured, |colours| colours.more_raw = 1)),
        ("bytes-left-in-colour-leaf", "K3", with_colours(&coloured, |colours| colours.left = vec![0])),
        ("colours-begin-outside-their-section", "K4", with_colours(&coloured, |colours| colours.start = 1 << 20)),
        ("colours-end-outside-their-section", "K4", with_colours(&coloured, |colours| colours.more_len = 1000)),
        ("colours-of-an-unknown-model", "K5", with_colours(&coloured, |colours| colours.block[0] = 2)),
        ("words-left-in-colours", "K6", with_colours(&coloured, |colours| colours.block.extend([0, 0]))),
        ("colours-beyond-white", "K7", with_colours(&coloured, |colours| colours.block[1] = 255)),
        ("colours-miscounted", "K10", coloured.build(|head| put(head, 360, 1, 8))),
        ("flipped-in-colours-of-levels", "K11", colours_of_levels(|own, _| own[3] ^= 2)),
        ("colours-of-levels-of-others", "K12", colours_of_levels(|own, other| own.copy_from_slice(other))),
        ("level-without-its-colours", "K12", level_without_colours()),
        ("unordered-metadata", "M2", metadata(b"zzzz\0\0\0\0aaaa\0\0\0\0")),
        ("crs-not-utf-8", "M3", metadata(b"CRS \x01\0\0\0\xFF")),
        ("page-of-another-part", "T5", metadata(&[b"SHRD\x28\0\0\0\x01\0\0\0\x02\0\0\0", &[0; 32][..]].concat())),
        ("unit-of-no-length", "M5", metadata(&[b"UNIT\x10\0\0\0", &[0; 16][..]].concat())),
        ("input-cut-short", "M6", metadata(&[b"READ\x15\0\0\0", &[1; 21][..]].concat())),
        ("input-not-utf-8", "M6", metadata(&[b"READ\x16\0\0\0", &[0; 20][..], &[1, 0xFF]].concat())),
        ("wrong-part", "M4", metadata(&[b"SHRD\x28\0\0\0", &[0; 40][..]].concat())),
    ]
}

fn with_leaf(parts: &Parts, at: usize, value: u8) -> Vec<u8> {
    let mut parts = parts.clone();
    parts.leaf[at] = value;
    parts.build(|_| ())
}

fn with_body(parts: &Parts, change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut body = parts.pages[24..].to_vec();
    change(&mut body);
    parts.with_page(&body).build(|_| ())
}

/// The head has a byte behind the root directory that is not zero.
fn behind_the_root(parts: &Parts) -> Vec<u8> {
    let mut parts = parts.clone();
    let end = parts.head.len() - 4;
    parts.head.insert(end, 1);
    parts.build(|head| {
        let len = head.len() as u64;
        put(head, 12, len, 4);
    })
}

/// The head states as many pages as need two leaves, and has room for the record of one.
fn two_leaves(parts: &Parts) -> Vec<u8> {
    parts.build(|head| {
        // Tiles, voxels, stored pages.
        [224, 248, 264].into_iter().for_each(|at| put(head, at, 4097, 8));
        put(head, 320, 2, 4);
    })
}

/// The colours of an only page, and in what their leaf and table differ from the truth.
#[derive(Default)]
struct Colours {
    block: Vec<u8>,
    /// Where the leaf says that the block begins, and how much longer it says that the block is.
    start: u64,
    more_len: u64,
    /// Bytes behind the leaf's checksums.
    left: Vec<u8>,
    /// How much longer the table says that the leaf is, before and after compression.
    more_raw: u32,
    more_stored: u32,
}

/// Changes the colours of the only page, which has 41 bytes, and puts them together again.
fn with_colours(parts: &Parts, change: impl FnOnce(&mut Colours)) -> Vec<u8> {
    let (mut parts, page) = (parts.clone(), parts.pages[..41].to_vec());
    let table = parts.pages.len() - 12;
    let leaf = word(&parts.pages, table);
    let mut colours = Colours { block: parts.pages[41..table - leaf].to_vec(), ..Colours::default() };
    change(&mut colours);
    let mut raw = Vec::new();
    put_varint(&mut raw, colours.start);
    put_varint(&mut raw, colours.block.len() as u64 + colours.more_len);
    raw.extend(crc32c::crc32c(&[&[0; 12][..], &colours.block].concat()).to_le_bytes());
    raw.extend(&colours.left);
    let mut stored = Vec::new();
    Packer::new().pack(&raw, &mut stored);
    let lens = [stored.len() as u32 + colours.more_stored, raw.len() as u32 + colours.more_raw];
    let record = [lens[0], lens[1], crc32c::crc32c(&stored)].map(u32::to_le_bytes).concat();
    parts.pages = [&page[..], &colours.block, &stored, &record].concat();
    let (len, crc) = (parts.pages.len() - 41, crc32c::crc32c(&record));
    parts.build(|head| {
        put(head, 352, len as u64, 8);
        put(head, 368, crc.into(), 4);
    })
}

/// Two pages of one voxel in colour, with their level.
fn two_in_colour(red: u16) -> Vec<u8> {
    let one = page([((3, 4), vec![Span::new(40, 50, true).unwrap()])]);
    let made = ([key(0, 0, 0), key(1, 0, 0)].map(|key| (key, one.clone())).into(), Totals::default());
    let colours = ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 0 };
    archive_in_colour(&plan(), &made, colours, true, None, |_, _, _| vec![Some([red, 20_000, 40_000])])
}

/// Two pages in colour, whose level has none.
fn level_without_colours() -> Vec<u8> {
    let bytes = two_in_colour(9000);
    let archive = Archive::from_bytes(bytes.clone()).unwrap();
    let [own, mut of_level] = [&archive, &archive.level(1).unwrap()].map(|archive| {
        let mut reader = ColourReader::new(archive).unwrap().unwrap();
        let mut block = |key: PageKey| {
            let range = reader.find(key).unwrap().range();
            (key, bytes[range.start as usize..range.end as usize].to_vec())
        };
        archive.entries().map(|entry| block(entry.unwrap().key)).collect::<Vec<_>>()
    });
    let parts = Parts::of(&bytes);
    let start = archive.header().colours_offset() as usize - parts.head.len();
    let end = start + word(&parts.head, 352);
    let build = |of_level: &[(PageKey, Vec<u8>)], voxels: u64| {
        let (part, crc) = colour_section(0, of_level);
        let mut table = [part.len() as u64, voxels].map(u64::to_le_bytes).concat();
        table.extend(crc.to_le_bytes());
        table.extend(crc32c::crc32c(&table).to_le_bytes());
        let (section, crc) = colour_section(table.len() + part.len(), &own);
        let colours = [table, part, section].concat();
        let pages = [&parts.pages[..start], &colours, &parts.pages[end..]].concat();
        Parts { pages, ..parts.clone() }.build(|head| {
            put(head, 352, colours.len() as u64, 8);
            put(head, 368, crc.into(), 4);
        })
    };
    assert!(build(&of_level, 2) == bytes);
    of_level.iter_mut().for_each(|(_, block)| block.clear());
    build(&of_level, 0)
}

/// Blocks of the pages of one leaf, whose first begins at byte `base` of the section, with their leaf and its table;
/// and the checksum of the table.
fn colour_section(base: usize, blocks: &[(PageKey, Vec<u8>)]) -> (Vec<u8>, u32) {
    let mut raw = Vec::new();
    put_varint(&mut raw, base as u64);
    blocks.iter().for_each(|(_, block)| put_varint(&mut raw, block.len() as u64));
    for (key, block) in blocks.iter().filter(|(_, block)| !block.is_empty()) {
        let key = [key.tx, key.ty, key.layer].map(i32::to_le_bytes).concat();
        raw.extend(crc32c::crc32c(&[&key[..], block].concat()).to_le_bytes());
    }
    let mut stored = Vec::new();
    Packer::new().pack(&raw, &mut stored);
    let table = [stored.len() as u32, raw.len() as u32, crc32c::crc32c(&stored)].map(u32::to_le_bytes).concat();
    let blocks: Vec<u8> = blocks.iter().flat_map(|(_, block)| block).copied().collect();
    ([&blocks[..], &stored, &table].concat(), crc32c::crc32c(&table))
}

/// Two pages in colour, with the table and the colours of their level changed; those of other colours are as long.
fn colours_of_levels(change: impl FnOnce(&mut [u8], &[u8])) -> Vec<u8> {
    let [mut own, other] = [9000, 9257].map(two_in_colour);
    let archive = Archive::from_bytes(own.clone()).unwrap();
    let (header, first) = (archive.header(), archive.catalog().colour_table_range().unwrap().start);
    let (start, end) = (header.colours_offset() as usize, first as usize);
    assert_eq!(own.len(), other.len());
    // Behind the part of the level come the blocks of the archive, each as long as the other, then its leaf.
    let len = 24 + u64::from_le_bytes(own[start..start + 8].try_into().unwrap()) as usize;
    assert!(start + len < end && own[start..start + len] != other[start..start + len]);
    change(&mut own[start..start + len], &other[start..start + len]);
    own
}

/// The only shared page begins one byte beside the page that it shares.
fn shares_no_page(many: &Parts) -> Vec<u8> {
    let archive = Archive::from_bytes(many.build(|_| ())).unwrap();
    let entries = archive.leaf(0).unwrap();
    let paged: Vec<_> = entries.iter().filter(|entry| entry.extent().is_some()).collect();
    let more = |words: u32| 1 + usize::from(words >= 1 << 7) + usize::from(words >= 1 << 14);
    let sizes: usize = paged.iter().map(|entry| 1 + more(entry.size.words() - entry.size.blocks())).sum();
    // The distance is the last varint before checksums (4 bytes a page), sizes, and the one uniform span.
    let at = many.leaf.len() - 4 - sizes - 4 * paged.len() - 1;
    with_leaf(many, at, many.leaf[at] ^ 1)
}

/// Heights in centimetres, coded in quanta.
fn other_encoding() -> Vec<u8> {
    let columns = (0..64).map(|px| ((px, 0), vec![Span::new(51 * px, 51 * px + 1, false).unwrap()]));
    let page = page(columns);
    let parts = Parts::of(&archive(&([(key(0, 0, 0), page.clone())].into(), Totals::default())));
    let mut body = Vec::new();
    // An encoder of another grid finds no steps.
    let mut encoder = Encoder::new(Frame::new(1e5, 3e5).unwrap(), 0);
    encoder.encode(&page, &mut body);
    assert_ne!(body, parts.pages[24..], "steps in {:?}", plan().frame);
    parts.with_page(&body).build(|_| ())
}

/// An archive as unreleased versions began it.
fn draft(good: &[u8]) -> Vec<u8> {
    [b"\x89SLIC\r\n\x1a", &good[8..]].concat()
}
