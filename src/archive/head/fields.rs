//! Decodes and checks the fixed fields of a head (rules H4 to H10).

use super::super::FORMAT_VERSION;
use super::super::colour_section::{ColourHead, LEAF_RECORD};
use super::super::levels::{Levels, MAX_LEVELS, MAX_STORED_TABLE};
use super::header::{Bounds, Header, Pages, Sections, Tiles, Voxels};
use super::{
    COLOURS, FIXED, FOOTER, INFERRED, INFERRED_END, LEVELS, LEVELS_END, MAGIC, MAX_LEAF_ENTRIES, MAX_LEAVES,
    MAX_METADATA, hex,
};
use crate::codec::{ByteReader, Violation};
use crate::colour::{ColourPlan, ColourScale, ColourSource};
use crate::frame::{Frame, MAX_INDEX};
use crate::plan::{ClassSet, Classifier, Plan, PlanOptions, Up};
use crate::{Error, Result};
use xxhash_rust::xxh3::xxh3_128;

/// Decodes the header from the bytes that the head's checksum covers. Also returns the number of leaves in the root
/// directory.
pub(super) fn decode(covered: &[u8], file_len: u64) -> Result<(Header, usize)> {
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
        suggestion: "use a newer version, or convert the scan again with this one".into(),
    };
    if version.0 != FORMAT_VERSION.0 {
        return Err(unsupported(format!("slice archive format {}.{} (rule H4)", version.0, version.1)));
    }
    let unknown = features_required & !INFERRED;
    if unknown != 0 {
        let bits: Vec<_> = (0..64).filter(|bit| unknown >> bit & 1 == 1).map(|bit| bit.to_string()).collect();
        return Err(unsupported(format!("required archive feature {} (rule H5)", bits.join(", "))));
    }
    if stated_len != file_len {
        return Err(at(Violation::new("H6", format!("{stated_len} bytes in the file"), file_len)));
    }
    let mut rest = || -> Result<_, Violation> {
        let plan_hash = u128::from_le_bytes(reader.array()?);
        let plan = decode_plan(&reader.array()?, plan_hash)?;
        let mut words = [0u64; 23];
        for word in &mut words {
            *word = reader.u64()?;
        }
        let [metadata_crc, leaf_entries, leaf_count] = [reader.u32()?, reader.u32()?, reader.u32()?];
        let [has_bounds] = reader.array()?;
        let reserved = reader.take(FIXED - 325)?;
        reader = ByteReader::new(&[], "H2");
        let is_known = version.1 <= FORMAT_VERSION.1;
        let (levels, levels_len) = decode_levels(is_known, features_optional, &reserved[..LEVELS_END])?;
        let inferred = decode_inferred(is_known, features_required, &plan, &reserved[LEVELS_END..INFERRED_END])?;
        let (colours, colours_len) = decode_colours(is_known, features_optional, &reserved[INFERRED_END..])?;
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

/// Decodes the level fields and the length of the levels section (rules H10 and L1).
fn decode_levels(is_known: bool, features: u64, reserved: &[u8]) -> Result<(Option<Levels>, u64), Violation> {
    let has_levels = features & LEVELS != 0;
    if !has_levels && is_known && reserved.iter().any(|&byte| byte != 0) {
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

/// Decodes the number of inferred voxels, which follows the level fields (rules H7 and H10).
fn decode_inferred(is_known: bool, features: u64, plan: &Plan, reserved: &[u8]) -> Result<u64, Violation> {
    let fills = features & INFERRED != 0;
    if fills != (plan.options.fill_holes > 0) {
        let expected = "holes filled in archives with the required feature 0, and in no others";
        let found = format!("holes of {} pixels, features {features:#x}", plan.options.fill_holes);
        return Err(Violation::new("H7", expected, found));
    }
    if !fills && is_known && reserved.iter().any(|&byte| byte != 0) {
        return Err(Violation::new("H10", "zeros in reserved fields", hex(reserved)));
    }
    if fills { ByteReader::new(reserved, "H2").u64() } else { Ok(0) }
}

/// Decodes the colour fields, the last of the reserved ones, and the length of the colours section (rules H10 and K1).
fn decode_colours(is_known: bool, features: u64, reserved: &[u8]) -> Result<(Option<ColourHead>, u64), Violation> {
    if features & COLOURS == 0 {
        if is_known && reserved.iter().any(|&byte| byte != 0) {
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
        Some(source) if low < high && (!is_known || rest == [0; 5]) => {
            let plan = ColourPlan { scale: ColourScale { source, low, high }, error_milli };
            Ok((Some(ColourHead { plan, voxels, table_crc }), len))
        }
        _ => Err(Violation::new("K1", "a source 1 to 3, a range of values, and zeros", hex(reserved))),
    }
}

fn decode_plan(bytes: &[u8; 72], stated_hash: u128) -> Result<Plan, Violation> {
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

/// Checks that counts and section lengths are consistent, independent of the rest of the file (rules H8, H9, and K1 for
/// the number of coloured voxels).
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
