//! Records that mark an archive as one of several parts converted separately (chapter 7, tags `SHRD` and `READ`).

use crate::codec::{ByteReader, Violation};
use std::ops::RangeInclusive;

/// Most parts of one conversion.
pub const MAX_SHARDS: u32 = 1 << 16;
/// Length of the record's content (bytes).
const LEN: usize = 40;

/// Part of a conversion that an archive holds. Parts with the same plan file and count make a whole: their columns are
/// adjacent, from the first tile column of the grid to the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Number of the part (1..=count).
    pub index: u32,
    /// Number of all parts (1..=65536).
    pub count: u32,
    /// First tile column of the part (see [`PageKey::column`](crate::frame::PageKey::column)).
    pub first: u64,
    /// Last tile column of the part. The part holds all solid of the input from `first` to `last`.
    pub last: u64,
    /// Identity of the plan file (plan, unit, inputs). Parts of different plan files are never merged.
    pub plan_file: u128,
}

impl Shard {
    /// Returns the tile columns of the part.
    pub fn columns(&self) -> RangeInclusive<u64> {
        self.first..=self.last
    }

    pub(super) fn is_sound(&self) -> bool {
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
        out[24..].copy_from_slice(&self.plan_file.to_le_bytes());
        out
    }

    pub(super) fn decode(content: &[u8]) -> Result<Self, Violation> {
        if content.len() != LEN {
            return Err(Violation::new("M4", format!("{LEN} bytes about the part"), content.len()));
        }
        let mut reader = ByteReader::new(content, "M4");
        let (index, count, first, last) = (reader.u32()?, reader.u32()?, reader.u64()?, reader.u64()?);
        let shard = Self { index, count, first, last, plan_file: u128::from_le_bytes(reader.array()?) };
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

/// Record of an input that several parts read; with it, `merge` detects parts that read different versions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputRead {
    /// Number of the input in the plan file.
    pub input: u32,
    /// Hash of everything that was read of it, independent of the order.
    pub hash: u128,
    /// File name without folders, for messages; its first 255 bytes are kept.
    pub name: String,
}

impl InputRead {
    /// Most inputs in one record; with shortened names they fit the metadata.
    pub const MOST: usize = 1 << 15;
    /// Bytes of an input without its name.
    const LEN: usize = 21;
    /// Most bytes of all names; if they take more, none is stored.
    const MOST_NAMES: usize = 1 << 17;

    /// Returns the part of the name that is kept.
    fn short_name(&self) -> &str {
        let mut end = self.name.len().min(usize::from(u8::MAX));
        while !self.name.is_char_boundary(end) {
            end -= 1;
        }
        &self.name[..end]
    }

    pub(super) fn encode(all: &[Self]) -> Vec<u8> {
        let named = all.iter().map(|one| one.short_name().len()).sum::<usize>() <= Self::MOST_NAMES;
        let mut out = Vec::new();
        for one in all {
            let name = if named { one.short_name() } else { "" };
            out.extend(one.input.to_le_bytes());
            out.extend(one.hash.to_le_bytes());
            out.push(name.len() as u8);
            out.extend(name.as_bytes());
        }
        out
    }

    /// Decodes the record (rule M6).
    pub(super) fn decode(content: &[u8]) -> Result<Vec<Self>, Violation> {
        let mut all: Vec<Self> = Vec::new();
        let mut rest = content;
        while !rest.is_empty() || all.is_empty() {
            let mut reader = ByteReader::new(rest, "M6");
            let (input, hash) = (reader.u32()?, u128::from_le_bytes(reader.array()?));
            let [len] = reader.array()?;
            let name = std::str::from_utf8(reader.take(len.into())?);
            let name = name.map_err(|error| Violation::new("M6", "names in UTF-8", error))?.to_owned();
            if let Some(last) = all.last().filter(|last| last.input >= input) {
                return Err(Violation::new("M6", format!("an input above {}", last.input), input));
            }
            rest = &rest[Self::LEN + usize::from(len)..];
            all.push(Self { input, hash, name });
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_round_trip_without_names_where_these_are_too_long_and_disorder_is_refused() {
        let read = |input: u32| InputRead { input, hash: u128::from(input) << 77, name: "größe".repeat(60) };
        let two = [read(3), read(9)];
        let found = InputRead::decode(&InputRead::encode(&two)).unwrap();
        assert_eq!((found[1].input, found[1].hash, found[1].name.len()), (9, 9 << 77, 254));
        let many: Vec<_> = (0..InputRead::MOST as u32).map(read).collect();
        let bytes = InputRead::encode(&many);
        assert!(bytes.len() <= 700_000);
        assert!(
            InputRead::decode(&bytes).unwrap().iter().zip(&many).all(|(a, b)| a.hash == b.hash && a.name.is_empty())
        );
        let bytes = InputRead::encode(&two);
        let disorder = [&bytes[21 + 254..], &bytes[..21 + 254]].concat();
        for wrong in [&[][..], &bytes[..20], &bytes[..bytes.len() - 1], &disorder, &[0xFF; 60]] {
            assert_eq!(InputRead::decode(wrong).map_err(|violation| violation.rule), Err("M6"));
        }
    }

    #[test]
    fn parts_round_trip_and_impossible_ones_are_refused() {
        let good = Shard { index: 2, count: 3, first: 9, last: 70, plan_file: 1 << 100 };
        assert_eq!(Shard::decode(&good.encode()), Ok(good));
        let whole = Shard { index: 1, count: 1, first: 0, last: u64::MAX, plan_file: 0 };
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
