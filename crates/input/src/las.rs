//! Plain LAS: counts the whole records of a file and reads them in slabs.
//!
//! Input: a checked header. Output: whole point records. Memory: one slab, supplied by the caller. The count in the
//! header is only an upper bound: files are truncated (`1.2-with-color-clipped.las`) and headers can be wrong.

use super::diagnostics::Findings;
use super::header::LasHeader;
use super::source::Source;
use crate::{Error, Result};

/// Returns the number of readable points: the stated count, or fewer if the file is too short.
pub(super) fn points(source: &Source, header: &LasHeader, file_bytes: u64, findings: &mut Findings) -> Result<u64> {
    let stated = header.points_stated;
    let extended_at = header.first_extended;
    let end = if header.extended > 0 && extended_at >= header.points_at { extended_at } else { file_bytes };
    let room = end.min(file_bytes).saturating_sub(header.points_at) / u64::from(header.record_bytes);
    if stated == 0 && room > 0 {
        let reason = format!(
            "the header states 0 points but room for {room} follows: the program that wrote this file was interrupted; \
             write or fetch the file again"
        );
        return Err(Error::input(source.path(), "header, byte 107", reason));
    }
    if stated > room {
        findings.lose(match room {
            0 => format!("the header states {stated} points, but none can be read: the file is cut"),
            _ => format!("the header states {stated} points, the file holds {room} whole ones"),
        })?;
    }
    Ok(stated.min(room))
}

/// Returns the record that follows the stated `points`, if one fits before the next part of the file.
pub(super) fn record_after(
    source: &Source,
    header: &LasHeader,
    file_bytes: u64,
    points: u64,
) -> Result<Option<Vec<u8>>> {
    let len = u64::from(header.record_bytes);
    let at = header.points_at.saturating_add(points.saturating_mul(len));
    let others = [header.first_extended, header.waveforms_at].into_iter().filter(|&other| other >= header.points_at);
    let end = others.fold(file_bytes, u64::min);
    if points == 0 || end.saturating_sub(at) < len {
        return Ok(None);
    }
    source.bytes_at(at, header.record_bytes.into())
}

/// Reads `count` records of `record_bytes` from byte `start` on in slabs; returns the number read.
pub(super) fn read(
    source: &Source,
    start: u64,
    count: u64,
    record_bytes: usize,
    slab: &mut [u8],
    sink: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<u64> {
    let slab_points = (slab.len() / record_bytes) as u64;
    let mut done = 0;
    while done < count {
        let want = (count - done).min(slab_points) as usize * record_bytes;
        let got = source.read_at(&mut slab[..want], start + done * record_bytes as u64)? / record_bytes;
        if got > 0 {
            sink(&slab[..got * record_bytes])?;
        }
        done += got as u64;
        if got * record_bytes < want {
            break; // the file was truncated since it was opened
        }
    }
    Ok(done)
}
