//! The record that makes an archive one part of several that were converted apart (chapter 7, tag `SHRD`).

use crate::codec::{Reader, Violation};
use std::ops::RangeInclusive;

/// Most parts of one conversion.
pub const MAX_SHARDS: u32 = 1 << 16;
/// Length of the record's content (bytes).
const LEN: usize = 40;

/// Which part of a conversion an archive holds. Parts of the same job and count make a whole: their columns follow one
/// another from the first tile column of the grid to the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Number of the part [1..=count].
    pub index: u32,
    /// Number of all parts [1..=65536].
    pub count: u32,
    /// First tile column of the part (see [`PageKey::column`](crate::frame::PageKey::column)).
    pub first: u64,
    /// Last tile column of the part; all matter of the input between the two is in it.
    pub last: u64,
    /// Identity of plan and inputs: parts of different jobs are never merged.
    pub job: u128,
}

impl Shard {
    /// The tile columns of the part.
    pub fn columns(&self) -> RangeInclusive<u64> {
        self.first..=self.last
    }

    fn is_sound(&self) -> bool {
        (1..=MAX_SHARDS).contains(&self.count)
            && (1..=self.count).contains(&self.index)
            && self.first <= self.last
            && (self.index == 1) == (self.first == 0)
            && (self.index == self.count) == (self.last == u64::MAX)
    }

    pub(super) fn encode(&self) -> [u8; LEN] {
        let mut out = [0; LEN];
        out[..4].copy_from_slice(&self.index.to_le_bytes());
        out[4..8].copy_from_slice(&self.count.to_le_bytes());
        out[8..16].copy_from_slice(&self.first.to_le_bytes());
        out[16..24].copy_from_slice(&self.last.to_le_bytes());
        out[24..].copy_from_slice(&self.job.to_le_bytes());
        out
    }

    pub(super) fn decode(content: &[u8]) -> Result<Self, Violation> {
        if content.len() != LEN {
            return Err(Violation::new("M4", format!("{LEN} bytes about the part"), content.len()));
        }
        let mut reader = Reader::new(content, "M4");
        let (index, count, first, last) = (reader.u32()?, reader.u32()?, reader.u64()?, reader.u64()?);
        let shard = Self { index, count, first, last, job: u128::from_le_bytes(reader.array()?) };
        if shard.is_sound() {
            return Ok(shard);
        }
        let found = format!("part {index} of {count}, columns {first:016x} to {last:016x}");
        Err(Violation::new("M4", "a part and its columns, from the first to the last of the grid", found))
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "part {} of {}", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_round_trip_and_impossible_ones_are_refused() {
        let good = Shard { index: 2, count: 3, first: 9, last: 70, job: 1 << 100 };
        assert_eq!(Shard::decode(&good.encode()), Ok(good));
        let whole = Shard { index: 1, count: 1, first: 0, last: u64::MAX, job: 0 };
        assert_eq!(Shard::decode(&whole.encode()), Ok(whole));
        for bad in [
            Shard { index: 0, ..good },
            Shard { index: 4, ..good },
            Shard { count: MAX_SHARDS + 1, ..good },
            Shard { count: 2, ..good },
            Shard { first: 71, ..good },
            Shard { first: 0, ..good },
            Shard { last: u64::MAX, ..good },
            Shard { index: 1, ..good },
        ] {
            assert_eq!(Shard::decode(&bad.encode()).map_err(|violation| violation.rule), Err("M4"), "{bad:?}");
        }
        assert_eq!(Shard::decode(&good.encode()[1..]).map_err(|violation| violation.rule), Err("M4"));
    }
}
