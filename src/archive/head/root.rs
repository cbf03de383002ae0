//! Root directory: one record per leaf (chapter 3).

use super::{Header, MAX_LEAF_ENTRIES, MAX_LEAVES, MIN_LEAF_ENTRIES, ROOT_RECORD};
use crate::codec::{ByteReader, Violation};
use crate::frame::PageKey;

/// Record of a leaf in the root directory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::archive) struct Leaf {
    /// Key of the leaf's first entry.
    pub first: PageKey,
    pub entries: u32,
    /// Offset from the start of the directory section (bytes), the sum of the lengths of the leaves before.
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

/// Returns the entries per leaf for a directory of `total` entries: the fewest for which the leaves fit the root
/// directory.
pub(in crate::archive) fn leaf_entries(total: u64) -> u32 {
    let mut entries = MIN_LEAF_ENTRIES;
    while total.div_ceil(entries as u64) > MAX_LEAVES as u64 {
        entries *= 2;
    }
    entries
}

/// Decodes the root directory from the bytes between the fixed fields and the head's checksum (rules R1 to R4).
pub(in crate::archive) fn decode_root(
    bytes: &[u8],
    leaf_count: usize,
    header: &Header,
) -> Result<Vec<Leaf>, Violation> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_are_as_short_as_the_root_allows() {
        let (least, most) = (u64::from(MIN_LEAF_ENTRIES), MAX_LEAVES as u64);
        for doublings in 0..4 {
            let fit = (least << doublings) * most;
            assert_eq!(u64::from(leaf_entries(fit)), least << doublings);
            assert_eq!(u64::from(leaf_entries(fit + 1)), least << (doublings + 1));
        }
        assert_eq!(u64::from(leaf_entries(0)), least);
    }
}
