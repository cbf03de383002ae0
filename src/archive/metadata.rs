//! Metadata: tagged records of any kind; unknown ones are skipped (chapter 7).

use super::head::{MAX_METADATA, hex};
use super::shard::Shard;
use crate::codec::{Reader, Violation};
use crate::{Error, Result};

/// Tag of the coordinate reference system, as the input states it.
const CRS: [u8; 4] = *b"CRS ";

/// Tag of the part of a conversion that the archive holds.
const SHARD: [u8; 4] = *b"SHRD";

/// What the metadata say.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Metadata {
    /// Coordinate reference system, empty if unknown.
    pub crs: String,
    /// Which part of a conversion the archive holds; `None` for a whole.
    pub shard: Option<Shard>,
}

impl Metadata {
    /// The metadata block, at most 1 MiB; what is not known makes no record.
    pub fn encode(&self) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        let mut put = |tag: [u8; 4], content: &[u8]| {
            out.extend(tag);
            out.extend((content.len() as u32).to_le_bytes());
            out.extend(content);
        };
        if !self.crs.is_empty() {
            put(CRS, self.crs.as_bytes());
        }
        if let Some(shard) = &self.shard {
            put(SHARD, &shard.encode());
        }
        if out.len() as u64 > MAX_METADATA {
            let [value, max] = [out.len() as u64, MAX_METADATA].map(|len| format!("{len} bytes"));
            return Err(Error::Limit { what: "metadata with the coordinate reference system".into(), value, max });
        }
        Ok(out)
    }

    /// What the metadata block `bytes` says.
    pub fn decode(bytes: &[u8], crc: u32) -> Result<Self, Violation> {
        let found = crc32c::crc32c(bytes);
        if found != crc {
            return Err(Violation::new("M1", format!("checksum {crc:08x}"), format!("{found:08x}")));
        }
        let mut rest = bytes;
        let mut last: Option<[u8; 4]> = None;
        let mut metadata = Self::default();
        while !rest.is_empty() {
            let mut reader = Reader::new(rest, "M2");
            let tag: [u8; 4] = reader.array()?;
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
                SHARD => metadata.shard = Some(Shard::decode(content)?),
                _ => {}
            }
            last = Some(tag);
            rest = &rest[8 + len..];
        }
        Ok(metadata)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn skips_unknown_records_and_refuses_disorder() {
        let record = |tag: &[u8; 4], content: &[u8]| [tag, &(content.len() as u32).to_le_bytes()[..], content].concat();
        let read = |bytes: &[u8]| Metadata::decode(bytes, crc32c::crc32c(bytes)).map_err(|violation| violation.rule);
        let (crs, other) = (record(b"CRS ", b"EPSG:28992"), record(b"zzzz", &[0xFF; 3]));
        assert_eq!(read(&[&crs[..], &other].concat()), Ok(Metadata { crs: "EPSG:28992".into(), shard: None }));
        assert_eq!(read(&other), Ok(Metadata::default()));
        assert_eq!(read(&[&other[..], &crs].concat()), Err("M2"));
        assert_eq!(read(&[&crs[..], &crs].concat()), Err("M2"));
        assert_eq!(read(&crs[..crs.len() - 1]), Err("M2"));
        assert_eq!(read(&record(b"CRS ", &[0xFF])), Err("M3"));
        assert_eq!(read(&record(b"CRS ", b"")), Err("M3"));
        assert_eq!(read(&record(b"SHRD", &[0; 40])), Err("M4"));
        assert_eq!(Metadata::decode(&crs, 0).map_err(|violation| violation.rule), Err("M1"));
        let long = Metadata { crs: "x".repeat(1 << 20), shard: None };
        assert!(matches!(long.encode(), Err(Error::Limit { .. })));
    }

    proptest! {
        #[test]
        fn records_round_trip(crs in ".{0,40}", part in proptest::option::of((0u32..5, any::<u128>()))) {
            let shard = part.map(|(index, job)| {
                let first = u64::from(index) << 60;
                let last = if index == 4 { u64::MAX } else { first + (1 << 60) - 1 };
                Shard { index: index + 1, count: 5, first, last, job }
            });
            let metadata = Metadata { crs, shard };
            let bytes = metadata.encode().unwrap();
            prop_assert_eq!(Metadata::decode(&bytes, crc32c::crc32c(&bytes)), Ok(metadata));
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
            let _ = Metadata::decode(&bytes, crc32c::crc32c(&bytes));
        }
    }
}
