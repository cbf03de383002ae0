//! Metadata: tagged records (chapter 7). Records with unknown tags are kept unchanged.

use super::head::{MAX_METADATA, hex};
use super::shard::{InputRead, Shard};
use crate::bytes::crc;
use crate::codec::{ByteReader, Violation};
use crate::plan::Noise;
use crate::unit::{LengthUnit, UNIT_RANGE_M};
use crate::{Error, Result};
use std::collections::BTreeMap;

/// Name of a record; records are sorted by it.
pub(super) type Tag = [u8; 4];

/// Tag of the coordinate reference system, as the input states it.
const CRS: Tag = *b"CRS ";

/// Tag of the scan noise from which the tolerance was chosen.
const NOISE: Tag = *b"NOIS";

/// Tag of the inputs that a part read and other parts read, too.
const READ: Tag = *b"READ";

/// Tag of the part of a conversion that the archive holds.
const SHARD: Tag = *b"SHRD";

/// Records with tags that this version does not know, ascending and without duplicates.
pub(super) type Unknown = Vec<(Tag, Vec<u8>)>;

/// Tag of the units that were applied to the inputs.
const UNIT: Tag = *b"UNIT";
/// Bytes of one unit.
const UNIT_LEN: usize = 16;
/// Most units of inputs that one archive can state.
pub const MAX_UNITS: usize = 256;

/// Decoded metadata.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Metadata {
    /// Coordinate reference system, empty if unknown.
    pub crs: String,
    /// Part of a conversion that the archive holds; `None` for a whole one.
    pub shard: Option<Shard>,
    /// Inputs that a part read and other parts read, too, ordered by number.
    pub read: Vec<InputRead>,
    /// Units of the inputs, ascending and without duplicates; empty if unknown.
    pub units: Vec<LengthUnit>,
    /// Noise of the scan, if the tolerance was chosen from it.
    pub noise: Option<Noise>,
    pub unknown: Unknown,
}

/// Returns a printable tag, with other characters escaped.
pub(super) fn tag_name(tag: &Tag) -> String {
    tag.escape_ascii().to_string()
}

impl Metadata {
    /// Encodes the metadata block; unknown values get no record. Fails if it would exceed 1 MiB.
    pub fn encode(&self) -> Result<Vec<u8>> {
        let read = (!self.read.is_empty()).then(|| InputRead::encode(&self.read));
        let shard = self.shard.as_ref().map(Shard::encode);
        let units = self.units.iter().flat_map(|unit| [unit.horizontal_m, unit.vertical_m]);
        let units: Vec<u8> = units.flat_map(f64::to_le_bytes).collect();
        let noise = self.noise.map(|Noise { noise_m, regions, region_m }| {
            [noise_m.to_bits(), regions, region_m.to_bits()].map(u64::to_le_bytes)
        });
        let mut records: BTreeMap<Tag, &[u8]> =
            self.unknown.iter().map(|(tag, content)| (*tag, &content[..])).collect();
        records.extend((!self.crs.is_empty()).then_some((CRS, self.crs.as_bytes())));
        records.extend(noise.as_ref().map(|noise| (NOISE, noise.as_flattened())));
        records.extend(read.as_ref().map(|read| (READ, &read[..])));
        records.extend(shard.as_ref().map(|shard| (SHARD, &shard[..])));
        records.extend((!units.is_empty()).then_some((UNIT, &units[..])));
        let mut out = Vec::new();
        for (tag, content) in records {
            out.extend(tag);
            out.extend((content.len() as u32).to_le_bytes());
            out.extend(content);
        }
        if out.len() as u64 > MAX_METADATA {
            let [value, max] = [out.len() as u64, MAX_METADATA].map(|len| format!("{len} bytes"));
            return Err(Error::limit("metadata with the coordinate reference system", value, max));
        }
        Ok(out)
    }

    /// Decodes the metadata block and checks it against `crc` (rules M1 to M7).
    pub fn decode(bytes: &[u8], crc: u32) -> Result<Self, Violation> {
        let found = crc::crc32c(bytes);
        if found != crc {
            return Err(Violation::new("M1", format!("checksum {crc:08x}"), format!("{found:08x}")));
        }
        let mut rest = bytes;
        let mut last: Option<Tag> = None;
        let mut metadata = Self::default();
        while !rest.is_empty() {
            let mut reader = ByteReader::new(rest, "M2");
            let tag: Tag = reader.array()?;
            let len = reader.u32()? as usize;
            let content = reader.take(len)?;
            if last.is_some_and(|last| last >= tag) {
                return Err(Violation::new("M2", "records in ascending order of their tags", hex(&tag)));
            }
            match tag {
                CRS => {
                    let text = std::str::from_utf8(content);
                    metadata.crs = text.map_err(|error| Violation::new("M3", "text in UTF-8", error))?.to_owned();
                    if metadata.crs.is_empty() {
                        return Err(Violation::new("M3", "a text", "none"));
                    }
                }
                NOISE => metadata.noise = Some(decode_noise(content)?),
                READ => metadata.read = InputRead::decode(content)?,
                SHARD => metadata.shard = Some(Shard::decode(content)?),
                UNIT => metadata.units = decode_units(content)?,
                _ => metadata.unknown.push((tag, content.to_vec())),
            }
            last = Some(tag);
            rest = &rest[8 + len..];
        }
        Ok(metadata)
    }
}

/// Decodes the noise record (rule M7).
fn decode_noise(content: &[u8]) -> Result<Noise, Violation> {
    let mut reader = ByteReader::new(content, "M7");
    let noise = Noise { noise_m: reader.f64()?, regions: reader.u64()?, region_m: reader.f64()? };
    let sound = |length: f64| (0.0..=1e6).contains(&length) && length.is_sign_positive();
    if !reader.is_empty() || !sound(noise.noise_m) || !sound(noise.region_m) {
        return Err(Violation::new(
            "M7",
            "24 bytes, lengths of 0 to 1000000 m",
            format!("{noise:?}, {} bytes", content.len()),
        ));
    }
    Ok(noise)
}

/// Decodes the units (rule M5).
fn decode_units(content: &[u8]) -> Result<Vec<LengthUnit>, Violation> {
    let (records, rest) = content.as_chunks::<UNIT_LEN>();
    let wrong = |found: String| Violation::new("M5", "1 to 256 units, ascending, of 1e-9 to 1e9 m", found);
    if records.is_empty() || !rest.is_empty() || records.len() > MAX_UNITS {
        return Err(wrong(format!("{} bytes", content.len())));
    }
    let mut units: Vec<LengthUnit> = Vec::with_capacity(records.len());
    for record in records {
        let mut reader = ByteReader::new(record, "M5");
        let unit = LengthUnit { horizontal_m: reader.f64()?, vertical_m: reader.f64()? };
        let sound = [unit.horizontal_m, unit.vertical_m].iter().all(|length| UNIT_RANGE_M.contains(length));
        if !sound || units.last().is_some_and(|last| last.order(&unit).is_ge()) {
            return Err(wrong(format!("{unit:?} after {:?}", units.last())));
        }
        units.push(unit);
    }
    Ok(units)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn keeps_unknown_records_and_refuses_disorder() {
        let record = |tag: &[u8; 4], content: &[u8]| [tag, &(content.len() as u32).to_le_bytes()[..], content].concat();
        let read = |bytes: &[u8]| Metadata::decode(bytes, crc::crc32c(bytes)).map_err(|violation| violation.rule);
        let (crs, other) = (record(b"CRS ", b"EPSG:28992"), record(b"zzzz", &[0xFF; 3]));
        let unknown = Unknown::from([(*b"zzzz", vec![0xFF; 3])]);
        let both = Metadata { crs: "EPSG:28992".into(), unknown: unknown.clone(), ..Metadata::default() };
        assert_eq!(read(&[&crs[..], &other].concat()), Ok(both));
        assert_eq!(read(&other), Ok(Metadata { unknown, ..Metadata::default() }));
        assert_eq!(read(&[&other[..], &crs].concat()), Err("M2"));
        assert_eq!(read(&[&crs[..], &crs].concat()), Err("M2"));
        assert_eq!(read(&crs[..crs.len() - 1]), Err("M2"));
        assert_eq!(read(&record(b"CRS ", &[0xFF])), Err("M3"));
        assert_eq!(read(&record(b"CRS ", b"")), Err("M3"));
        assert_eq!(read(&record(b"SHRD", &[0; 40])), Err("M4"));
        assert_eq!(Metadata::decode(&crs, 0).map_err(|violation| violation.rule), Err("M1"));
        let units =
            |numbers: &[f64]| record(b"UNIT", &numbers.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<_>>());
        assert_eq!(read(&units(&[0.3048, 1.0, 1.0, 1.0])).map(|found| found.units.len()), Ok(2));
        for wrong in [
            &[][..],
            &[1.0],
            &[1.0, 0.0],
            &[f64::NAN, 1.0],
            &[1.0, -1.0],
            &[1.0, 1.0, 1.0, 1.0],
            &[2.0, 1.0, 1.0, 1.0],
            &[1.0, 1.0, 2.0],
        ] {
            assert_eq!(read(&units(wrong)), Err("M5"), "{wrong:?}");
        }
        let many = |count: u32| units(&(1..=count).flat_map(|n| [f64::from(n), 1.0]).collect::<Vec<_>>());
        assert_eq!(read(&many(256)).map(|found| found.units.len()), Ok(MAX_UNITS));
        assert_eq!(read(&many(257)), Err("M5"));
        assert_eq!(read(&record(b"READ", b"")), Err("M6"));
        let noise = |numbers: [f64; 3]| record(b"NOIS", numbers.map(f64::to_le_bytes).as_flattened());
        assert!(read(&noise([0.003, 0.0, 0.25])).is_ok());
        for wrong in [[-0.0, 0.0, 0.0], [f64::NAN, 0.0, 0.0], [0.0, 0.0, 1e7]] {
            assert_eq!(read(&noise(wrong)), Err("M7"), "{wrong:?}");
        }
        assert_eq!(read(&record(b"NOIS", &[0; 23])), Err("M7"));
        assert_eq!(read(&record(b"NOIS", &[0; 25])), Err("M7"));
        // With its tag and its length, 1 MiB.
        let long = |more: usize| Metadata { crs: "x".repeat((1 << 20) - 8 + more), ..Metadata::default() };
        assert_eq!(long(0).encode().unwrap().len(), 1 << 20);
        assert!(matches!(long(1).encode(), Err(Error::Limit { .. })));
    }

    proptest! {
        #[test]
        fn records_round_trip(
            crs in ".{0,40}", part in proptest::option::of((0u32..5, any::<u128>())),
            units in proptest::collection::vec((1e-9f64..1e9, 1e-9f64..1e9), 0..4),
            inputs in proptest::collection::btree_map(any::<u32>(), (any::<u128>(), ".{0,300}"), 0..4),
            noise in proptest::option::of((0.0f64..1e3, any::<u64>(), 0.0f64..1e3)),
            mut unknown in proptest::collection::btree_map(any::<Tag>(), proptest::collection::vec(any::<u8>(), 0..9), 0..4)
        ) {
            unknown.retain(|tag, _| ![CRS, NOISE, READ, SHARD, UNIT].contains(tag));
            let unknown = Unknown::from_iter(unknown);
            let shard = part.map(|(index, plan_file)| {
                let first = u64::from(index) << 60;
                let last = if index == 4 { u64::MAX } else { first + (1 << 60) - 1 };
                Shard { index: index + 1, count: 5, first, last, plan_file }
            });
            let units = units.into_iter().map(|(horizontal_m, vertical_m)| LengthUnit { horizontal_m, vertical_m });
            let read = inputs.into_iter().map(|(input, (hash, name))| InputRead { input, hash, name }).collect();
            let noise = noise.map(|(noise_m, regions, region_m)| Noise { noise_m, regions, region_m });
            let metadata = Metadata { crs, shard, read, noise, unknown, units: LengthUnit::distinct(units) };
            let bytes = metadata.encode().unwrap();
            let mut found = Metadata::decode(&bytes, crc::crc32c(&bytes)).unwrap();
            for (found, given) in found.read.iter_mut().zip(&metadata.read) {
                prop_assert!(given.name.starts_with(&found.name) && found.name.len() + 4 > given.name.len().min(255));
                found.name.clone_from(&given.name);
            }
            prop_assert_eq!(found, metadata);
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
            let _ = Metadata::decode(&bytes, crc::crc32c(&bytes));
        }
    }
}
