//! Head and footer: fixed header fields, root directory, and the end that proves completeness (chapters 3 and 8).
//!
//! The head is read and checked as a whole: magic, length, checksum, then version and features, then every field.

use super::FORMAT_VERSION;
use super::colours::{ColourHead, LEAF_RECORD, LevelColours};
use super::levels::{Levels, MAX_LEVELS, MAX_STORED_TABLE};
use crate::bytes::crc;
use crate::codec::{ByteReader, LevelSteps, Violation};
use crate::colour::{ColourPlan, ColourScale, ColourSource};
use crate::frame::{Frame, MAX_INDEX, PageKey};
pub(super) use crate::output::ARCHIVE_MAGIC as MAGIC;
use crate::plan::{ClassSet, Classifier, Coding, Plan, PlanOptions, Up};
use crate::{Error, Result};
use xxhash_rust::xxh3::xxh3_128;

/// Last bytes of an archive.
pub(super) const END_MAGIC: [u8; 8] = *b"\x89CILS\r\n\x1a";
/// Minor version and required features of an archive of `plan`.
pub(super) fn needs(plan: &Plan, levels: bool, colours: bool) -> (u16, u64) {
    let (fills, braids) = (plan.options.fill_holes > 0, plan.options.coding == Coding::Braided);
    let needed = [
        (levels, LEVEL_THIRDS_MINOR),
        (fills, INFERRED_MINOR),
        (plan.tolerance_quanta() > 0, STEPS_MINOR),
        (colours, COLOURS_MINOR),
        (braids, BRAIDED_MINOR),
    ];
    let minor = needed.into_iter().filter(|(needs, _)| *needs).map(|(_, minor)| minor).max();
    let features = [(fills, INFERRED), (braids, BRAIDED)];
    (minor.unwrap_or(0), features.into_iter().filter(|(needs, _)| *needs).map(|(_, bit)| bit).sum())
}

/// Greatest length of a head, and the length of one whose size was not known in advance (bytes).
pub(super) const MAX_HEAD: usize = 16_384;
/// Length of the fixed fields (bytes).
pub(super) const FIXED: usize = 384;
/// Length of a root record (bytes).
pub(super) const ROOT_RECORD: usize = 28;
const CRC: usize = 4;
/// Length of the footer (bytes).
pub(super) const FOOTER: usize = 24;
/// Most leaves that a root directory holds.
pub(super) const MAX_LEAVES: usize = 512;
/// Entries of a leaf in an archive that needs no more than [`MAX_LEAVES`] such leaves.
pub(super) const MIN_LEAF_ENTRIES: u32 = 4096;
/// Most entries of a leaf.
pub(super) const MAX_LEAF_ENTRIES: u32 = 1 << 20;
/// Greatest length of the metadata block (bytes).
pub(super) const MAX_METADATA: u64 = 1 << 20;
/// Where the length of the archive lies in the head.
const FILE_LEN: std::ops::Range<usize> = 32..40;
/// Bit of `features_optional`: the archive was written with overview levels.
pub(super) const LEVELS: u64 = 1;
/// Minor version from which the head tells of levels.
const LEVELS_MINOR: u16 = 1;
/// Bit of `features_optional`: heights of levels lie on coarser steps.
pub(super) const LEVEL_THIRDS: u64 = 4;
/// Minor version from which they may.
const LEVEL_THIRDS_MINOR: u16 = 4;
/// Bit of `features_optional`: with levels and colours, levels have colours.
pub(super) const LEVEL_COLOURS: u64 = 8;
/// Minor version from which they may.
const LEVEL_COLOURS_MINOR: u16 = 4;
/// Bit of `features_required`: holes were filled, so pages may hold inferred matter.
pub(super) const INFERRED: u64 = 1;
/// Minor version from which there is inferred matter.
const INFERRED_MINOR: u16 = 2;
/// Bit of `features_required`: pages are braided.
pub(super) const BRAIDED: u64 = 2;
/// Minor version from which they may be.
const BRAIDED_MINOR: u16 = 5;
/// Minor version from which coarsened heights may lie on steps of the tolerance.
const STEPS_MINOR: u16 = 3;
/// Bit of `features_optional`: the archive has colours.
pub(super) const COLOURS: u64 = 2;
/// Minor version from which the head tells of colours.
const COLOURS_MINOR: u16 = 3;
/// Where the fields of levels end among those that were reserved first, and those of inferred matter.
const LEVELS_END: usize = 19;
const INFERRED_END: usize = LEVELS_END + 8;
/// Bytes of what the head says of colours.
const COLOURS_LEN: usize = 32;
const _: () = assert!(325 + INFERRED_END + COLOURS_LEN == FIXED);
/// Where the canonical bytes of the plan lie in the head.
const PLAN: std::ops::Range<usize> = 56..128;

/// How many tiles (one slice of a page, where it holds matter) an archive has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tiles {
    /// All tiles with matter.
    pub occupied: u64,
    /// Those whose page has bytes of its own or shares those of another; the rest are uniform.
    pub stored: u64,
    /// Those whose page has bytes of its own.
    pub unique: u64,
}

/// How many voxels an archive has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Voxels {
    /// Voxels with matter.
    pub occupied: u64,
    /// Those with obstacle.
    pub obstacle: u64,
    /// Those whose matter is inferred alone: floor that closes holes of the scan.
    pub inferred: u64,
}

/// How many pages of each kind an archive has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pages {
    /// Pages with bytes of their own.
    pub stored: u64,
    /// Pages with the bytes of an earlier one.
    pub shared: u64,
    /// Pages told by one span.
    pub uniform: u64,
}

impl Pages {
    /// Pages of all kinds.
    pub fn total(&self) -> u64 {
        self.stored.saturating_add(self.shared).saturating_add(self.uniform)
    }
}

/// Lengths of the sections in the order in which they lie, without gap; the footer ends the file (bytes).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sections {
    /// Header and root directory.
    pub head: u64,
    /// Pages.
    pub pages: u64,
    /// Colours of voxels.
    pub colours: u64,
    /// Overview levels: their pages and directories.
    pub levels: u64,
    /// Leaf directories.
    pub directory: u64,
    /// Metadata block.
    pub metadata: u64,
}

/// Least and greatest coordinates (m).
pub type Bounds = ([f64; 3], [f64; 3]);

/// What the head of an archive says about the whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// Version of the format: major, minor.
    pub version: (u16, u16),
    /// Features that a reader must know.
    pub features_required: u64,
    /// Features that a reader may ignore.
    pub features_optional: u64,
    /// Length of the archive (bytes).
    pub file_len: u64,
    /// Grid and options of the conversion.
    pub plan: Plan,
    /// Identity of the plan: archives of equal hash can be compared and merged.
    pub plan_hash: u128,
    /// Points read from the input.
    pub points_read: u64,
    /// Points that made voxels.
    pub points_kept: u64,
    /// Points that the input marks as withheld.
    pub points_withheld: u64,
    /// Points of excluded classes.
    pub points_excluded: u64,
    /// Least and greatest coordinates of the kept points (m); `None` without points.
    pub bounds: Option<Bounds>,
    /// Lowest and highest slice with matter, inclusive; `None` without matter.
    pub slices: Option<(i64, i64)>,
    /// Tiles.
    pub tiles: Tiles,
    /// Voxels.
    pub voxels: Voxels,
    /// Pages.
    pub pages: Pages,
    /// Lengths of the sections.
    pub bytes: Sections,
    /// CRC32C of the metadata block.
    pub metadata_crc: u32,
    /// Entries in each directory leaf but the last.
    pub leaf_entries: u32,
    /// Where the overview levels are told of; `None` if the archive was written without.
    pub levels: Option<Levels>,
    /// What is said of colours; `None` if the archive was written without.
    pub colours: Option<ColourHead>,
    /// Which overview level this is the head of; 0 for the archive itself.
    pub level: u32,
}

/// Pages without bytes of their own that are gone through however small the archive is, and bytes for each one more.
const MOST_REPEATS: u64 = 1 << 22;
const BYTES_A_REPEAT: u64 = 16;
/// As [`MOST_REPEATS`] where each page adds its spans to overview levels.
const MOST_REPEATS_WITH_LEVELS: u64 = 1 << 16;

impl Header {
    /// Refuses to go through all pages of an archive that makes so many of so few bytes that it would take minutes and more.
    pub(super) fn check_repeats(&self) -> Result<()> {
        let repeats = self.pages.shared.saturating_add(self.pages.uniform);
        let least = if self.levels.is_some() { MOST_REPEATS_WITH_LEVELS } else { MOST_REPEATS };
        let most = least.max(self.file_len / BYTES_A_REPEAT);
        if repeats > most {
            let what = format!(
                "pages without bytes of their own, in an archive of {} bytes (convert the scan again with larger pixels)",
                self.file_len
            );
            return Err(Error::limit(what, repeats, most));
        }
        Ok(())
    }

    /// Steps that heights of the overview levels lie on.
    pub(super) fn level_steps(&self) -> LevelSteps {
        let has_thirds = self.version.1 >= LEVEL_THIRDS_MINOR && self.features_optional & LEVEL_THIRDS != 0;
        if has_thirds { LevelSteps::Thirds } else { LevelSteps::Fifths }
    }

    /// Where the colours of the overview levels are told of; `None` if levels have none.
    pub(super) fn level_colours(&self) -> Option<LevelColours> {
        let has_colours = self.version.1 >= LEVEL_COLOURS_MINOR && self.features_optional & LEVEL_COLOURS != 0;
        let (levels, colours) = (self.levels?, self.colours.filter(|_| has_colours)?);
        let leaves = self.pages.total().div_ceil(u64::from(self.leaf_entries.max(1)));
        let end = self.levels_offset().saturating_sub(LEAF_RECORD as u64 * leaves);
        (levels.count > 0).then(|| LevelColours::new(levels.count, self.colours_offset(), end, colours.plan))
    }

    /// Offset of the pages (bytes).
    pub fn pages_offset(&self) -> u64 {
        self.bytes.head
    }

    /// Offset of the colours, where the pages end (bytes).
    pub fn colours_offset(&self) -> u64 {
        self.bytes.head + self.bytes.pages
    }

    /// Offset of the overview levels (bytes).
    pub fn levels_offset(&self) -> u64 {
        self.colours_offset() + self.bytes.colours
    }

    /// Offset of the leaf directories (bytes).
    pub fn directory_offset(&self) -> u64 {
        self.levels_offset() + self.bytes.levels
    }

    /// Offset of the metadata block (bytes).
    pub fn metadata_offset(&self) -> u64 {
        self.directory_offset() + self.bytes.directory
    }
}

/// A leaf as the root directory tells of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Leaf {
    /// Key of its first entry.
    pub first: PageKey,
    pub entries: u32,
    /// Offset from the start of the directory section; implied by the lengths of the leaves before it.
    pub offset: u64,
    pub stored_len: u32,
    pub raw_len: u32,
    pub crc: u32,
}

impl Leaf {
    /// Appends the root record of the leaf.
    pub fn encode(&self, out: &mut Vec<u8>) {
        out.extend(self.first.column().to_le_bytes());
        out.extend(self.first.layer.to_le_bytes());
        for value in [self.entries, self.stored_len, self.raw_len, self.crc] {
            out.extend(value.to_le_bytes());
        }
    }
}

/// Entries of a leaf in a directory of so many entries: as few as fit the root directory.
pub(super) fn leaf_entries(total: u64) -> u32 {
    let mut entries = MIN_LEAF_ENTRIES;
    while total.div_ceil(entries as u64) > MAX_LEAVES as u64 {
        entries *= 2;
    }
    entries
}

/// Length of a head for `leaves` leaves without padding (bytes).
pub(super) fn exact_len(leaves: usize) -> usize {
    FIXED + leaves * ROOT_RECORD + CRC
}

/// The head of an archive, as long as `header` says: at least [`exact_len`] and at most [`MAX_HEAD`].
pub(super) fn encode(header: &Header, leaves: &[Leaf]) -> Vec<u8> {
    let mut out = Vec::with_capacity(header.bytes.head as usize);
    out.extend(MAGIC);
    out.extend(header.version.0.to_le_bytes());
    out.extend(header.version.1.to_le_bytes());
    out.extend((header.bytes.head as u32).to_le_bytes());
    let word = |out: &mut Vec<u8>, value: u64| out.extend(value.to_le_bytes());
    word(&mut out, header.features_required);
    word(&mut out, header.features_optional);
    debug_assert_eq!(out.len(), FILE_LEN.start);
    word(&mut out, header.file_len);
    out.extend(header.plan_hash.to_le_bytes());
    debug_assert_eq!(out.len(), PLAN.start);
    out.extend(header.plan.to_bytes());
    for points in [header.points_read, header.points_kept, header.points_withheld, header.points_excluded] {
        word(&mut out, points);
    }
    let (min, max) = header.bounds.unwrap_or_default();
    for value in min.into_iter().chain(max) {
        word(&mut out, (value + 0.0).to_bits());
    }
    let (first, last) = header.slices.unwrap_or((0, -1));
    word(&mut out, first as u64);
    word(&mut out, last as u64);
    for count in [
        header.tiles.occupied,
        header.tiles.stored,
        header.tiles.unique,
        header.voxels.occupied,
        header.voxels.obstacle,
        header.pages.stored,
        header.pages.shared,
        header.pages.uniform,
        header.bytes.pages + header.bytes.colours + header.bytes.levels,
        header.bytes.directory,
        header.bytes.metadata,
    ] {
        word(&mut out, count);
    }
    out.extend(header.metadata_crc.to_le_bytes());
    out.extend(header.leaf_entries.to_le_bytes());
    out.extend((leaves.len() as u32).to_le_bytes());
    out.push(header.bounds.is_some() as u8);
    let levels = header.levels.unwrap_or_default();
    out.extend([levels.count as u8, 0, 0]);
    word(&mut out, header.bytes.levels);
    out.extend(levels.table_len.to_le_bytes());
    out.extend(levels.table_crc.to_le_bytes());
    word(&mut out, header.voxels.inferred);
    if let Some(ColourHead { plan, voxels, table_crc }) = header.colours {
        word(&mut out, header.bytes.colours);
        word(&mut out, voxels);
        out.extend(table_crc.to_le_bytes());
        let ColourScale { source, low, high } = plan.scale;
        [low, high, plan.error_milli].iter().for_each(|value| out.extend(value.to_le_bytes()));
        out.extend(ColourSource::ALL.iter().zip(1u8..).filter(|(one, _)| **one == source).map(|(_, code)| code));
    }
    out.resize(FIXED, 0);
    leaves.iter().for_each(|leaf| leaf.encode(&mut out));
    out.resize(header.bytes.head as usize - CRC, 0);
    let crc = crc::crc32c(&out);
    out.extend(crc.to_le_bytes());
    out
}

/// The footer of an archive of `file_len` bytes whose head is `head`.
pub(super) fn encode_footer(file_len: u64, head: &[u8]) -> [u8; FOOTER] {
    let mut out = [0; FOOTER];
    out[..8].copy_from_slice(&file_len.to_le_bytes());
    out[8..12].copy_from_slice(&head[head.len() - CRC..]);
    let crc = crc::crc32c(&out[..12]);
    out[12..16].copy_from_slice(&crc.to_le_bytes());
    out[16..].copy_from_slice(&END_MAGIC);
    out
}

/// Checks the footer `bytes` of an archive of `file_len` bytes whose head is `head`.
pub(super) fn check_footer(bytes: &[u8; FOOTER], file_len: u64, head: &[u8]) -> Result<()> {
    let at = |violation: Violation| violation.at("footer", file_len - FOOTER as u64);
    let expected = encode_footer(file_len, head);
    if bytes[16..] != END_MAGIC {
        return Err(at(Violation::new("F1", hex(&END_MAGIC), hex(&bytes[16..]))));
    }
    if crc::crc32c(&bytes[..12]).to_le_bytes() != bytes[12..16] {
        return Err(at(Violation::new("F2", "the footer's checksum", hex(&bytes[12..16]))));
    }
    if *bytes != expected {
        return Err(at(Violation::new("F3", format!("the footer of this head, {}", hex(&expected)), hex(bytes))));
    }
    Ok(())
}

/// Rule H1, of the first bytes of a file.
pub(super) fn check_magic(bytes: &[u8]) -> Result<()> {
    let magic = &bytes[..bytes.len().min(MAGIC.len())];
    if magic != MAGIC {
        return Err(Violation::new("H1", format!("a slice archive, {}", hex(&MAGIC)), hex(magic)).at("head", 0));
    }
    Ok(())
}

/// Length of the archive (bytes) that the first bytes of a head state, unchecked; `None` if they are too few.
pub(super) fn stated_len(bytes: &[u8]) -> Option<u64> {
    bytes.get(FILE_LEN)?.try_into().ok().map(u64::from_le_bytes)
}

/// Header and leaves from the first bytes of a file of `file_len` bytes, and how many of the bytes are the head's.
/// `bytes` must reach to the end of the file or [`MAX_HEAD`] bytes far.
pub(super) fn decode(bytes: &[u8], file_len: u64) -> Result<(Header, Vec<Leaf>)> {
    let at = |violation: Violation| violation.at("head", 0);
    check_magic(bytes)?;
    let least = exact_len(0) + FOOTER;
    if bytes.len() < least {
        return Err(at(Violation::new("H2", format!("at least {least} bytes in the file"), file_len)));
    }
    let head_len = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
    if head_len < exact_len(0) || head_len > bytes.len().min(MAX_HEAD) {
        let expected = format!("a head of {} to {} bytes", exact_len(0), bytes.len().min(MAX_HEAD));
        return Err(at(Violation::new("H2", expected, head_len)));
    }
    let (covered, crc) = bytes[..head_len].split_at(head_len - CRC);
    if crc::crc32c(covered).to_le_bytes() != crc {
        return Err(at(Violation::new("H3", "the head's checksum", hex(crc))));
    }
    let (header, leaf_count) = decode_fixed(covered, file_len)?;
    let leaves = decode_root(&covered[FIXED..], leaf_count, &header).map_err(at)?;
    Ok((header, leaves))
}

fn decode_fixed(covered: &[u8], file_len: u64) -> Result<(Header, usize)> {
    let at = |violation: Violation| violation.at("head", 0);
    let mut reader = ByteReader::new(&covered[MAGIC.len()..FIXED], "H2");
    let mut fields = || -> Result<_, Violation> {
        let version = (u16::from_le_bytes(reader.array()?), u16::from_le_bytes(reader.array()?));
        let head_len = reader.u32()?;
        Ok((version, head_len, reader.u64()?, reader.u64()?, reader.u64()?))
    };
    let (version, head_len, features_required, features_optional, stated_len) = fields().map_err(at)?;
    let unsupported = |what: String| Error::Unsupported {
        what,
        version: env!("CARGO_PKG_VERSION"),
        way_out: "use a newer version, or convert the scan again with this one".into(),
    };
    if version.0 != FORMAT_VERSION.0 {
        return Err(unsupported(format!("slice archive format {}.{} (rule H4)", version.0, version.1)));
    }
    let unknown = features_required & !(INFERRED | BRAIDED);
    if unknown != 0 {
        let bits: Vec<_> = (0..64).filter(|bit| unknown >> bit & 1 == 1).map(|bit| bit.to_string()).collect();
        return Err(unsupported(format!("required archive feature {} (rule H5)", bits.join(", "))));
    }
    if stated_len != file_len {
        return Err(at(Violation::new("H6", format!("{stated_len} bytes in the file"), file_len)));
    }
    let coding = if features_required & BRAIDED != 0 { Coding::Braided } else { Coding::Adaptive };
    let mut rest = || -> Result<_, Violation> {
        if coding == Coding::Braided && version.1 < BRAIDED_MINOR {
            let expected = "braided pages in archives of version 1.5 or newer alone";
            return Err(Violation::new("H7", expected, format!("version 1.{}", version.1)));
        }
        let plan_hash = u128::from_le_bytes(reader.array()?);
        let plan = decode_plan(&reader.array()?, plan_hash, coding)?;
        let mut words = [0u64; 23];
        for word in &mut words {
            *word = reader.u64()?;
        }
        let [metadata_crc, leaf_entries, leaf_count] = [reader.u32()?, reader.u32()?, reader.u32()?];
        let [has_bounds] = reader.array()?;
        let reserved = reader.take(FIXED - 325)?;
        reader = ByteReader::new(&[], "H2");
        let (levels, levels_len) = decode_levels(version.1, features_optional, &reserved[..LEVELS_END])?;
        let inferred = decode_inferred(version.1, features_required, &plan, &reserved[LEVELS_END..INFERRED_END])?;
        let (colours, colours_len) = decode_colours(version.1, features_optional, &reserved[INFERRED_END..])?;
        let Some(pages_len) = words[20].checked_sub(levels_len).and_then(|len| len.checked_sub(colours_len)) else {
            return Err(Violation::new("L1", format!("levels of at most {} bytes", words[20]), levels_len));
        };
        let float = |at: usize| f64::from_bits(words[at]);
        let corner = |at: usize| [float(at), float(at + 1), float(at + 2)];
        let bounds = decode_bounds(corner(4), corner(7), has_bounds)?;
        let slices = decode_slices(words[10] as i64, words[11] as i64)?;
        let header = Header {
            version,
            features_required,
            features_optional,
            file_len,
            plan,
            plan_hash,
            points_read: words[0],
            points_kept: words[1],
            points_withheld: words[2],
            points_excluded: words[3],
            bounds,
            slices,
            tiles: Tiles { occupied: words[12], stored: words[13], unique: words[14] },
            voxels: Voxels { occupied: words[15], obstacle: words[16], inferred },
            pages: Pages { stored: words[17], shared: words[18], uniform: words[19] },
            bytes: Sections {
                head: head_len as u64,
                pages: pages_len,
                colours: colours_len,
                levels: levels_len,
                directory: words[21],
                metadata: words[22],
            },
            metadata_crc,
            leaf_entries,
            levels,
            colours,
            level: 0,
        };
        check_sums(&header)?;
        let of_levels = header.level_colours().map_or(0, |levels| levels.table().end - levels.table().start);
        let tables = LEAF_RECORD as u64 * u64::from(leaf_count) + of_levels;
        if header.colours.is_some() && colours_len < tables {
            let expected = format!("colours of {tables} bytes or more");
            return Err(Violation::new("K1", expected, colours_len));
        }
        Ok((header, leaf_count as usize))
    };
    rest().map_err(at)
}

/// What the reserved fields say of levels, and the length of their section (rules H10 and L1).
fn decode_levels(minor: u16, features: u64, reserved: &[u8]) -> Result<(Option<Levels>, u64), Violation> {
    let has_levels = minor >= LEVELS_MINOR && features & LEVELS != 0;
    if !has_levels && minor <= FORMAT_VERSION.1 && reserved.iter().any(|&byte| byte != 0) {
        return Err(Violation::new("H10", "zeros in reserved fields", hex(reserved)));
    }
    if !has_levels {
        return Ok((None, 0));
    }
    let mut reader = ByteReader::new(reserved, "L1");
    let [count, a, b] = reader.array()?;
    let len = reader.u64()?;
    let levels = Levels { count: count.into(), table_len: reader.u32()?, table_crc: reader.u32()? };
    let some = levels.count > 0 && levels.table_len > 0 && u64::from(levels.table_len) < len;
    let none = (levels, len) == (Levels::default(), 0);
    if levels.count as usize > MAX_LEVELS || levels.table_len > MAX_STORED_TABLE || [a, b] != [0, 0] || !(some || none)
    {
        let expected = "up to 16 levels and their table inside a section, or none";
        return Err(Violation::new("L1", expected, hex(reserved)));
    }
    Ok((Some(levels), len))
}

/// Number of inferred voxels by the reserved fields behind those of levels (rules H7 and H10).
fn decode_inferred(minor: u16, features: u64, plan: &Plan, reserved: &[u8]) -> Result<u64, Violation> {
    let fills = features & INFERRED != 0;
    if fills != (plan.options.fill_holes > 0) || fills && minor < INFERRED_MINOR {
        let expected = "holes filled in archives of version 1.2 with the required feature 0, and in no others";
        let found = format!("holes of {} pixels, version 1.{minor}, features {features:#x}", plan.options.fill_holes);
        return Err(Violation::new("H7", expected, found));
    }
    if !fills && minor <= FORMAT_VERSION.1 && reserved.iter().any(|&byte| byte != 0) {
        return Err(Violation::new("H10", "zeros in reserved fields", hex(reserved)));
    }
    if fills { ByteReader::new(reserved, "H2").u64() } else { Ok(0) }
}

/// What the last reserved fields say of colours, and the length of their section (rules H10 and K1).
fn decode_colours(minor: u16, features: u64, reserved: &[u8]) -> Result<(Option<ColourHead>, u64), Violation> {
    let has_colours = minor >= COLOURS_MINOR && features & COLOURS != 0;
    if !has_colours {
        if minor <= FORMAT_VERSION.1 && reserved.iter().any(|&byte| byte != 0) {
            return Err(Violation::new("H10", "zeros in reserved fields", hex(reserved)));
        }
        return Ok((None, 0));
    }
    let mut reader = ByteReader::new(reserved, "K1");
    let (len, voxels, table_crc) = (reader.u64()?, reader.u64()?, reader.u32()?);
    let mut number = || reader.array().map(u16::from_le_bytes);
    let (low, high, error_milli) = (number()?, number()?, number()?);
    let [source, rest @ ..]: [u8; 6] = reader.array()?;
    let source = usize::from(source).checked_sub(1).and_then(|code| ColourSource::ALL.get(code).copied());
    match source {
        Some(source) if low < high && (minor > FORMAT_VERSION.1 || rest == [0; 5]) => {
            let plan = ColourPlan { scale: ColourScale { source, low, high }, error_milli };
            Ok((Some(ColourHead { plan, voxels, table_crc }), len))
        }
        _ => Err(Violation::new("K1", "a source 1 to 3, a range of values, and zeros", hex(reserved))),
    }
}

fn decode_plan(bytes: &[u8; 72], stated_hash: u128, coding: Coding) -> Result<Plan, Violation> {
    let mut reader = ByteReader::new(bytes, "H7");
    let sizes = [reader.f64()?, reader.f64()?, reader.f64()?, reader.f64()?];
    let [classifier, flags] = reader.array()?;
    let drop_floaters = u16::from_le_bytes(reader.array()?);
    let min_points = reader.u32()?;
    let exclude_classes = ClassSet::from_words([reader.u64()?, reader.u64()?, reader.u64()?, reader.u64()?]);
    let wrong = |error: Error| Violation::new("H7", "a plan within its limits", error);
    let Some(&classifier) = Classifier::ALL.get(classifier as usize) else {
        return Err(Violation::new("H7", "classifier 0, 1 or 2", classifier));
    };
    let (up, remove_moving) = (if flags & 1 == 1 { Up::Y } else { Up::Z }, flags & 2 == 2);
    let frame = Frame::new(sizes[0], sizes[1]).map_err(wrong)?;
    let [_, _, max_slope_deg, tolerance_m] = sizes;
    let options = PlanOptions {
        max_slope_deg,
        tolerance_m,
        classifier,
        min_points,
        drop_floaters,
        remove_moving,
        fill_holes: flags >> 2,
        up,
        exclude_classes,
        coding,
    };
    let plan = Plan { frame, options };
    plan.options.check().map_err(wrong)?;
    if plan.to_bytes() != *bytes {
        return Err(Violation::new("H7", "the canonical bytes of the plan", hex(bytes)));
    }
    let hash = xxh3_128(bytes);
    if hash != stated_hash {
        return Err(Violation::new("H7", format!("plan hash {hash:032x}"), format!("{stated_hash:032x}")));
    }
    Ok(plan)
}

fn decode_bounds(min: [f64; 3], max: [f64; 3], flag: u8) -> Result<Option<Bounds>, Violation> {
    let canonical = |value: f64| value.is_finite() && value.to_bits() != (-0.0f64).to_bits();
    let ordered = min.iter().zip(&max).all(|(min, max)| min <= max && canonical(*min) && canonical(*max));
    let none = min.iter().chain(&max).all(|value| value.to_bits() == 0);
    match flag {
        1 if ordered => Ok(Some((min, max))),
        0 if none => Ok(None),
        _ => {
            Err(Violation::new("H8", "finite bounds, least first, or none", format!("{min:?} to {max:?}, flag {flag}")))
        }
    }
}

fn decode_slices(first: i64, last: i64) -> Result<Option<(i64, i64)>, Violation> {
    let inside = -MAX_INDEX - 1..=MAX_INDEX;
    match (first, last) {
        (0, -1) => Ok(None),
        _ if first <= last && inside.contains(&first) && inside.contains(&last) => Ok(Some((first, last))),
        _ => Err(Violation::new("H8", "lowest and highest slice in order", format!("{first} and {last}"))),
    }
}

/// Rules H8 and H9: numbers that must fit together whatever the rest of the file says.
fn check_sums(header: &Header) -> Result<(), Violation> {
    let Header { tiles, voxels, pages, bytes, .. } = header;
    let parts = [header.points_kept, header.points_withheld, header.points_excluded];
    let points = parts.iter().try_fold(0u64, |sum, &part| sum.checked_add(part));
    let wrong = |what: &str, found: String| Err(Violation::new("H8", what, found));
    if points.is_none_or(|sum| sum > header.points_read) {
        return wrong("no more points than were read", format!("{parts:?} of {}", header.points_read));
    }
    if tiles.unique > tiles.stored || tiles.stored > tiles.occupied {
        return wrong("unique <= stored <= occupied tiles", format!("{tiles:?}"));
    }
    let known = voxels.obstacle.checked_add(voxels.inferred);
    if known.is_none_or(|known| known > voxels.occupied) || voxels.occupied < tiles.occupied {
        let expected = "obstacle and inferred among the occupied voxels, one or more a tile";
        return wrong(expected, format!("{voxels:?}, {tiles:?}"));
    }
    let most = MAX_LEAVES as u64 * MAX_LEAF_ENTRIES as u64;
    let counts = [pages.stored, pages.shared, pages.uniform];
    if counts.iter().any(|&count| count > most) || pages.total() > most {
        return wrong("at most 2^29 pages", format!("{pages:?}"));
    }
    if (pages.total() == 0) != header.slices.is_none() || tiles.occupied < pages.total() {
        return wrong(
            "one or more tiles a page, and slices exactly if there are pages",
            format!("{pages:?}, {tiles:?}"),
        );
    }
    let sections =
        [bytes.head, bytes.pages, bytes.colours, bytes.levels, bytes.directory, bytes.metadata, FOOTER as u64];
    let sum = sections.iter().try_fold(0u64, |sum, &len| sum.checked_add(len));
    if sum != Some(header.file_len) {
        let expected = format!("sections that fill {} bytes", header.file_len);
        return Err(Violation::new("H9", expected, format!("{sections:?}")));
    }
    if header.colours.is_some_and(|colours| colours.voxels > voxels.occupied) {
        return Err(Violation::new("K1", format!("at most {} voxels with colours", voxels.occupied), "more"));
    }
    if bytes.metadata > MAX_METADATA {
        return Err(Violation::new("H9", format!("metadata of at most {MAX_METADATA} bytes"), bytes.metadata));
    }
    Ok(())
}

/// The root directory from the bytes between the fixed fields and the head's checksum.
pub(super) fn decode_root(bytes: &[u8], leaf_count: usize, header: &Header) -> Result<Vec<Leaf>, Violation> {
    let total = header.pages.total();
    let capacity = header.leaf_entries as u64;
    if !header.leaf_entries.is_power_of_two() || !(MIN_LEAF_ENTRIES..=MAX_LEAF_ENTRIES).contains(&header.leaf_entries) {
        return Err(Violation::new("R1", "leaves of 4096 to 2^20 entries, a power of two", header.leaf_entries));
    }
    if leaf_count as u64 != total.div_ceil(capacity) || leaf_count > MAX_LEAVES {
        return Err(Violation::new("R1", format!("{} leaves", total.div_ceil(capacity)), leaf_count));
    }
    let Some((records, padding)) = bytes.split_at_checked(leaf_count * ROOT_RECORD) else {
        return Err(Violation::new("R1", format!("room for {leaf_count} leaves"), format!("{} bytes", bytes.len())));
    };
    if padding.iter().any(|&byte| byte != 0) {
        return Err(Violation::new("H10", "zeros after the root directory", "other bytes"));
    }
    let mut leaves: Vec<Leaf> = Vec::with_capacity(leaf_count);
    let (mut offset, mut left) = (0u64, total);
    for record in records.chunks_exact(ROOT_RECORD) {
        let mut reader = ByteReader::new(record, "R1");
        let column = reader.u64()?;
        let layer = i32::from_le_bytes(reader.array()?);
        let [entries, stored_len, raw_len, crc] = [reader.u32()?, reader.u32()?, reader.u32()?, reader.u32()?];
        let first = PageKey::from_column(column, layer);
        if leaves.last().is_some_and(|leaf| leaf.first >= first) {
            return Err(Violation::new("R2", "leaves in ascending order of their first keys", first));
        }
        if entries as u64 != left.min(capacity) {
            return Err(Violation::new("R3", format!("a leaf of {} entries", left.min(capacity)), entries));
        }
        leaves.push(Leaf { first, entries, offset, stored_len, raw_len, crc });
        offset += stored_len as u64;
        left -= entries as u64;
    }
    if offset != header.bytes.directory {
        return Err(Violation::new("R4", format!("leaves of {} bytes in all", header.bytes.directory), offset));
    }
    Ok(leaves)
}

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().take(32).map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}
