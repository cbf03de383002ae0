//! The LASzip record: the items of a packed point, and their packing.
//!
//! Input: the bytes of the record. Output: its items, each of a known type and size.

use crate::header::{u16_at, u32_at};

/// Type of an item.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Byte,
    Point10,
    GpsTime11,
    RGB12,
    WavePacket13,
    Point14,
    RGB14,
    RGBNIR14,
    WavePacket14,
    Byte14,
}

impl Kind {
    /// Returns the type with this number, and the bytes of its items (`None`: any).
    fn of(number: u16) -> Option<(Self, Option<u16>)> {
        Some(match number {
            0 => (Self::Byte, None),
            6 => (Self::Point10, Some(20)),
            7 => (Self::GpsTime11, Some(8)),
            8 => (Self::RGB12, Some(6)),
            9 => (Self::WavePacket13, Some(29)),
            10 => (Self::Point14, Some(30)),
            11 => (Self::RGB14, Some(6)),
            12 => (Self::RGBNIR14, Some(8)),
            13 => (Self::WavePacket14, Some(29)),
            14 => (Self::Byte14, None),
            _ => return None,
        })
    }

    /// Returns whether it belongs to formats 6 to 10, in which each field has a layer of its own.
    pub fn is_layered(self) -> bool {
        matches!(self, Self::Point14 | Self::RGB14 | Self::RGBNIR14 | Self::WavePacket14 | Self::Byte14)
    }
}

/// One part of each point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Item {
    pub kind: Kind,
    pub bytes: usize,
    pub version: u16,
}

impl Item {
    /// Returns the number of its layers in formats 6 to 10.
    pub fn layers(&self) -> usize {
        match self.kind {
            Kind::Point14 => 9,
            Kind::RGBNIR14 => 2,
            Kind::Byte14 => self.bytes,
            _ => 1,
        }
    }
}

/// A LASzip record.
#[derive(Debug, Clone)]
pub(super) struct LaszipRecord {
    /// 1: the whole file is one sequence; 2: chunks; 3: chunks of layers.
    pub compressor: u16,
    /// Points per chunk; [`VARIABLE`](Self::VARIABLE) if the chunk table states them.
    pub chunk_points: u32,
    pub items: Vec<Item>,
}

impl LaszipRecord {
    /// Value of `chunk_points` if chunks differ.
    pub const VARIABLE: u32 = u32::MAX;
    const HEAD_BYTES: usize = 34;
    const ITEM_BYTES: usize = 6;

    /// Parses the record `body`; fails with the reason why it is invalid.
    pub fn read(body: &[u8]) -> Result<Self, String> {
        if body.len() < Self::HEAD_BYTES {
            return Err(format!("{} bytes long, expected {} or more", body.len(), Self::HEAD_BYTES));
        }
        let (compressor, coder, chunk_points) = (u16_at(body, 0), u16_at(body, 2), u32_at(body, 12));
        let count = usize::from(u16_at(body, 32));
        if !(1..=32).contains(&count) || body.len() < Self::HEAD_BYTES + Self::ITEM_BYTES * count {
            return Err(format!("it lists {count} items in {} bytes, expected 1 to 32 of 6 bytes", body.len()));
        }
        if coder != 0 {
            return Err(format!("its coder is {coder}, expected 0 (arithmetic)"));
        }
        let item = |item: &[u8]| {
            let (number, bytes, version) = (u16_at(item, 0), u16_at(item, 2), u16_at(item, 4));
            let (kind, expected) = Kind::of(number).ok_or_else(|| format!("items of type {number} are unknown"))?;
            match expected {
                Some(expected) if expected != bytes => {
                    Err(format!("its {kind:?} has {bytes} bytes, expected {expected}"))
                }
                _ => Ok(Item { kind, bytes: bytes.into(), version }),
            }
        };
        let listed = body[Self::HEAD_BYTES..].chunks_exact(Self::ITEM_BYTES).take(count);
        let items = listed.map(item).collect::<Result<Vec<_>, _>>()?;
        let layered = match items[0].kind {
            Kind::Point10 => false,
            Kind::Point14 => true,
            other => return Err(format!("its first item is {other:?}, expected a point")),
        };
        if let Some(other) = items.iter().find(|item| item.kind.is_layered() != layered) {
            let (first, other) = (items[0].kind, other.kind);
            return Err(format!("its items belong to different point formats: {first:?} and {other:?}"));
        }
        if !matches!((compressor, layered), (1 | 2, false) | (3, true)) {
            return Err(format!("compressor {compressor} does not fit its items; 1 and 2 pack old points, 3 new"));
        }
        if compressor != 1 && chunk_points == 0 {
            return Err("its chunks have 0 points".into());
        }
        Ok(Self { compressor, chunk_points, items })
    }
}
