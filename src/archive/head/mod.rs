//! Head and footer: fixed header fields, root directory, and the footer that marks a complete archive (chapters 3 and
//! 8).
//!
//! A head is checked as a whole: magic, length, checksum, then version and features, then every field.

mod fields;
mod footer;
mod header;
mod root;

pub(super) use footer::{check_footer, encode_footer};
pub use header::{Bounds, Header, Pages, Sections, Tiles, Voxels};
pub(super) use root::{Leaf, decode_root, leaf_entries};

use super::colour_section::ColourHead;
use crate::Error;
use crate::Result;
use crate::bytes::crc;
use crate::codec::Violation;
use crate::colour::{ColourScale, ColourSource};
pub(super) use crate::output::ARCHIVE_MAGIC as MAGIC;
use crate::output::DRAFT_MAGIC;

/// Largest head, and the length of a head whose size was not known in advance (bytes).
pub(super) const MAX_HEAD: usize = 16_384;
/// Length of the fixed fields (bytes).
pub(super) const FIXED: usize = 384;
/// Length of a root record (bytes).
pub(super) const ROOT_RECORD: usize = 28;
const CRC: usize = 4;
/// Length of the footer (bytes).
pub(super) const FOOTER: usize = 24;
/// Most leaves in a root directory.
pub(super) const MAX_LEAVES: usize = 512;
/// Entries of a leaf in an archive that needs at most [`MAX_LEAVES`] leaves of this size.
pub(super) const MIN_LEAF_ENTRIES: u32 = 4096;
/// Most entries of a leaf.
pub(super) const MAX_LEAF_ENTRIES: u32 = 1 << 20;
/// Largest metadata block (bytes).
pub(super) const MAX_METADATA: u64 = 1 << 20;
/// Bytes of the head that state the length of the archive.
const FILE_LEN: std::ops::Range<usize> = 32..40;
/// Bit of `features_required`: holes were filled, so pages may hold inferred spans.
pub(super) const INFERRED: u64 = 1;
/// Bit of `features_optional`: the archive was written with overview levels.
pub(super) const LEVELS: u64 = 1;
/// Bit of `features_optional`: the archive has colours, and so have its levels.
pub(super) const COLOURS: u64 = 2;
/// Bit of `features_optional`: the pages section ends with seen space.
pub(super) const SEEN: u64 = 4;
/// Ends of the level fields and of the inferred-voxel count within the reserved bytes.
const LEVELS_END: usize = 19;
const INFERRED_END: usize = LEVELS_END + 8;
/// Bytes of the colour fields.
const COLOURS_LEN: usize = 32;
const _: () = assert!(325 + INFERRED_END + COLOURS_LEN == FIXED);
/// Bytes of the head that hold the plan in canonical form.
const PLAN: std::ops::Range<usize> = 56..128;

/// Returns the length of a head for `leaves` leaves without padding (bytes).
pub(super) fn exact_len(leaves: usize) -> usize {
    FIXED + leaves * ROOT_RECORD + CRC
}

/// Encodes the head of an archive, padded to the length that `header` states: [`exact_len`] to [`MAX_HEAD`] bytes.
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

/// Checks the magic at the start of a file (rule H1).
pub(super) fn check_magic(bytes: &[u8]) -> Result<()> {
    let magic = &bytes[..bytes.len().min(MAGIC.len())];
    if magic == DRAFT_MAGIC {
        return Err(Error::Unsupported {
            what: "slice archive written by an unreleased version (rule H1)".into(),
            version: env!("CARGO_PKG_VERSION"),
            suggestion: "convert the scan again".into(),
        });
    }
    if magic != MAGIC {
        return Err(Violation::new("H1", format!("a slice archive, {}", hex(&MAGIC)), hex(magic)).at("head", 0));
    }
    Ok(())
}

/// Returns the length of the archive (bytes) that a head states, unchecked; `None` if `bytes` are too few.
pub(super) fn stated_len(bytes: &[u8]) -> Option<u64> {
    bytes.get(FILE_LEN)?.try_into().ok().map(u64::from_le_bytes)
}

/// Decodes header and leaves from the first bytes of a file of `file_len` bytes. `bytes` must reach to the end of the
/// file or hold at least [`MAX_HEAD`] bytes.
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
    let (header, leaf_count) = fields::decode(covered, file_len)?;
    let leaves = decode_root(&covered[FIXED..], leaf_count, &header).map_err(at)?;
    Ok((header, leaves))
}

pub(super) fn hex(bytes: &[u8]) -> String {
    if bytes.is_empty() {
        return "no byte".into();
    }
    bytes.iter().take(32).map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::{ArchiveWriter, Totals};
    use crate::frame::Frame;
    use crate::plan::{Plan, PlanOptions};

    /// The header of an archive without pages.
    fn header() -> Header {
        let folder = tempfile::tempdir().unwrap();
        let plan = Plan { frame: Frame::new(0.05, 0.15).unwrap(), options: PlanOptions::default() };
        let writer = ArchiveWriter::create(&folder.path().join("empty.slices"), &plan, true).unwrap();
        writer.finish(Totals::default()).unwrap()
    }

    #[test]
    fn bounds_of_minus_zero_are_written_as_zero() {
        let zero = Header { bounds: Some(([0.0; 3], [0.0; 3])), ..header() };
        let minus = Header { bounds: Some(([-0.0; 3], [-0.0, 0.0, -0.0])), ..zero.clone() };
        assert_eq!(encode(&minus, &[]), encode(&zero, &[]));
    }

    #[test]
    fn a_file_holds_at_least_the_shortest_head_and_a_footer() {
        // Lengths of the specification, rule H2.
        let (head, file) = (388, 412);
        let bytes = Sections { head, ..Sections::default() };
        let header = Header { bytes, file_len: file, ..header() };
        let whole = [encode(&header, &[]), vec![0; FOOTER]].concat();
        assert_eq!(decode(&whole, file).unwrap(), (header, Vec::new()));
        let error = decode(&whole[..whole.len() - 1], file - 1).unwrap_err().to_string();
        assert!(error.contains("rule H2") && error.contains("at least 412 bytes"), "{error}");
    }
}
