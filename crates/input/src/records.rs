//! Variable length records before the points and (LAS 1.4) after them; only a few kinds are relevant.
//!
//! Input: a checked header. Output: the LASzip record and the records that describe the reference system.
//! Memory: one record of each kind, each within its limit; other records are skipped. Stated counts (some files state
//! 1,069,128,089) never determine an allocation: reading stops where the points begin or the file ends.
//!
//! The crate `las` is not used: it holds every record whole, and allocates the stated length, up to 2⁶⁴ bytes, before
//! it reads the record.

use super::header::{LasHeader, u16_at, u64_at};
use super::source::Source;
use crate::Result;

/// Longest text of a reference system that is kept (bytes), as an archive can hold it; longer ones are skipped with a
/// note.
pub(super) const MOST_TEXT: u64 = 1 << 20;
/// Longest GeoTIFF record that is kept, and longest LASzip record (bytes).
const MOST_KEYS: u64 = 1 << 16;
/// Maximum number of records examined before the points, and again after them.
const MOST_RECORDS: u32 = 1 << 16;

/// Record id of well-known text.
pub(super) const WKT: u16 = 2112;
/// Record id of the GeoTIFF key directory.
pub(super) const GEO_KEYS: u16 = 34735;
/// Record id of GeoTIFF numbers.
pub(super) const GEO_DOUBLES: u16 = 34736;
/// Record id of GeoTIFF texts.
pub(super) const GEO_TEXT: u16 = 34737;
const LASZIP: u16 = 22204;

/// Records that are kept.
#[derive(Debug, Default)]
pub(super) struct Records {
    pub laszip: Option<Vec<u8>>,
    /// Id and content of the first non-empty record of each id with user `LASF_Projection`.
    projection: Vec<(u16, Vec<u8>)>,
    /// Warnings for the monitor.
    pub notes: Vec<String>,
}

impl Records {
    pub(super) fn read(source: &Source, header: &LasHeader, file_bytes: u64) -> Result<Self> {
        let mut records = Self::default();
        let end = header.points_at.min(file_bytes);
        let mut at = u64::from(header.header_bytes);
        let mut seen = 0;
        while seen < header.records.min(MOST_RECORDS) {
            let Some(next) = records.step(source, at, end, 54)? else { break };
            at = next;
            seen += 1;
        }
        if seen < header.records {
            records.notes.push(format!("the header states {} records before the points, {seen} fit", header.records));
        }
        if header.extended > 0 {
            let (mut at, mut seen) = (header.first_extended, 0);
            while at >= header.points_at && seen < header.extended.min(MOST_RECORDS) {
                let Some(next) = records.step(source, at, file_bytes, 60)? else { break };
                at = next;
                seen += 1;
            }
            if seen < header.extended {
                let text = format!("the header states {} records after the points, {seen} fit", header.extended);
                records.notes.push(text);
            }
        }
        Ok(records)
    }

    /// Examines the record at `at`; returns the offset of the byte after it, or `None` if it does not fit before `end`.
    fn step(&mut self, source: &Source, at: u64, end: u64, head_bytes: u64) -> Result<Option<u64>> {
        let Some(body_at) = at.checked_add(head_bytes).filter(|&b| b <= end) else { return Ok(None) };
        let Some(head) = source.bytes_at(at, head_bytes as usize)? else { return Ok(None) };
        let length = if head_bytes == 54 { u64::from(u16_at(&head, 20)) } else { u64_at(&head, 20) };
        let Some(next) = body_at.checked_add(length).filter(|&n| n <= end) else { return Ok(None) };
        // Some programs fill the user's name with blanks.
        let user = head[2..18].split(|&b| b == 0).next().unwrap_or_default().trim_ascii_end();
        let id = u16_at(&head, 18);
        let projection = user == b"LASF_Projection" && [WKT, GEO_KEYS, GEO_DOUBLES, GEO_TEXT].contains(&id);
        let laszip = user == b"laszip encoded" && id == LASZIP;
        let wanted = laszip || projection && length > 0 && self.projection(id).is_none();
        if wanted {
            if length > if id == WKT { MOST_TEXT } else { MOST_KEYS } {
                self.notes.push(format!("record {id} at byte {at} is {length} bytes long; it is passed over"));
            } else if let Some(body) = source.bytes_at(body_at, length as usize)? {
                if laszip {
                    self.laszip = Some(body);
                } else {
                    self.keep(id, body);
                }
            }
        }
        Ok(Some(next))
    }

    /// Keeps a projection record.
    pub(super) fn keep(&mut self, id: u16, body: Vec<u8>) {
        self.projection.push((id, body));
    }

    /// Returns the first non-empty projection record `id`.
    pub(super) fn projection(&self, id: u16) -> Option<&[u8]> {
        self.projection.iter().find(|(i, _)| *i == id).map(|(_, body)| body.as_slice())
    }
}
