//! Metadata: tagged records of any kind; unknown ones are skipped (chapter 7).

use super::head::{MAX_METADATA, hex};
use crate::codec::{Reader, Violation};
use crate::{Error, Result};

/// Tag of the coordinate reference system, as the input states it.
const CRS: [u8; 4] = *b"CRS ";

/// The metadata block for a coordinate reference system, at most 1 MiB; no text, no record.
pub(super) fn encode(crs: &str) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    if crs.is_empty() {
        return Ok(out);
    }
    if crs.len() as u64 > MAX_METADATA - 8 {
        let [value, max] = [crs.len() as u64, MAX_METADATA - 8].map(|len| format!("{len} bytes"));
        return Err(Error::Limit { what: "text of the coordinate reference system".into(), value, max });
    }
    out.extend(CRS);
    out.extend((crs.len() as u32).to_le_bytes());
    out.extend(crs.as_bytes());
    Ok(out)
}

/// The coordinate reference system in the metadata block `bytes`, empty if there is none.
pub(super) fn decode(bytes: &[u8], crc: u32) -> Result<String, Violation> {
    let found = crc32c::crc32c(bytes);
    if found != crc {
        return Err(Violation::new("M1", format!("checksum {crc:08x}"), format!("{found:08x}")));
    }
    let mut rest = bytes;
    let mut last: Option<[u8; 4]> = None;
    let mut crs = String::new();
    while !rest.is_empty() {
        let mut reader = Reader::new(rest, "M2");
        let tag: [u8; 4] = reader.array()?;
        let len = reader.u32()? as usize;
        let content = reader.take(len)?;
        if last.is_some_and(|last| last >= tag) {
            return Err(Violation::new("M2", "records in ascending order of their tags", hex(&tag)));
        }
        if tag == CRS {
            let text = std::str::from_utf8(content);
            crs = text.map_err(|error| Violation::new("M3", "text in UTF-8", error))?.to_owned();
            if crs.is_empty() {
                return Err(Violation::new("M3", "a text", "none"));
            }
        }
        last = Some(tag);
        rest = &rest[8 + len..];
    }
    Ok(crs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn skips_unknown_records_and_refuses_disorder() {
        let record = |tag: &[u8; 4], content: &[u8]| [tag, &(content.len() as u32).to_le_bytes()[..], content].concat();
        let read = |bytes: &[u8]| decode(bytes, crc32c::crc32c(bytes)).map_err(|violation| violation.rule);
        let (crs, other) = (record(b"CRS ", b"EPSG:28992"), record(b"zzzz", &[0xFF; 3]));
        assert_eq!(read(&[&crs[..], &other].concat()), Ok("EPSG:28992".into()));
        assert_eq!(read(&other), Ok(String::new()));
        assert_eq!(read(&[&other[..], &crs].concat()), Err("M2"));
        assert_eq!(read(&[&crs[..], &crs].concat()), Err("M2"));
        assert_eq!(read(&crs[..crs.len() - 1]), Err("M2"));
        assert_eq!(read(&record(b"CRS ", &[0xFF])), Err("M3"));
        assert_eq!(read(&record(b"CRS ", b"")), Err("M3"));
        assert_eq!(decode(&crs, 0).map_err(|violation| violation.rule), Err("M1"));
        assert!(matches!(encode(&"x".repeat(1 << 20)), Err(Error::Limit { .. })));
    }

    proptest! {
        #[test]
        fn texts_round_trip(crs in ".{0,40}") {
            let bytes = encode(&crs).unwrap();
            prop_assert_eq!(decode(&bytes, crc32c::crc32c(&bytes)), Ok(crs));
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
            let _ = decode(&bytes, crc32c::crc32c(&bytes));
        }
    }
}
