//! Plain LAS: counts the whole records of a file and reads them in slabs.
//!
//! Input: a checked header. Output: whole point records. Memory: one slab, supplied by the caller. The count in the
//! header is only an upper bound: files are truncated (`1.2-with-color-clipped.las`) and headers can be wrong.

use super::diagnostics::Findings;
use super::header::{LasHeader, u16_at};
use super::source::Source;
use crate::{Error, Monitor, Result};

/// Bytes examined at once after the points.
const LOOK_BYTES: usize = 1 << 16;

/// Returns the number of readable points: the stated count, or fewer if the file is too short.
pub(super) fn points(source: &Source, header: &LasHeader, file_bytes: u64, findings: &mut Findings) -> Result<u64> {
    let stated = header.points_stated;
    let end = end(source, header, file_bytes)?;
    let room = end.saturating_sub(header.points_at) / u64::from(header.record_bytes);
    if stated == 0 && room > 0 {
        let reason = format!(
            "the header states 0 points but room for {room} follows: the program that wrote this file was interrupted; \
             write or fetch the file again"
        );
        return Err(Error::input(source.path(), "header, byte 107", reason));
    }
    if stated > room {
        let text = match room {
            0 => format!("the header states {stated} points, but none can be read: the file is cut"),
            _ => format!("the header states {stated} points, the file holds {room} whole ones"),
        };
        findings.lose_points(stated - room, text)?;
    }
    Ok(stated.min(room))
}

/// Returns where the room for points ends: at the next part of the file, or where the file does.
pub(super) fn end(source: &Source, header: &LasHeader, file_bytes: u64) -> Result<u64> {
    let LasHeader { points_at, first_extended, waveforms_at, .. } = *header;
    let end = if header.extended > 0 && first_extended >= points_at { first_extended } else { file_bytes };
    let is_in_file = (points_at..file_bytes).contains(&waveforms_at);
    let end = if is_in_file && is_of_waveforms(source, waveforms_at)? { end.min(waveforms_at) } else { end };
    Ok(end.min(file_bytes))
}

/// Returns whether a record of waveforms begins at byte `at`. Some writers leave other bytes in the field of the header
/// that states its place; some write the owner of the record as `LAS_Spec` instead of `LASF_Spec`.
fn is_of_waveforms(source: &Source, at: u64) -> Result<bool> {
    let head = source.bytes_at(at, 20)?;
    Ok(head.is_some_and(|head| head[2..].starts_with(b"LAS") && u16_at(&head, 18) == u16::MAX))
}

/// Checks that no whole record fits between the stated `points` and the next part of the file. Zeros there are padding.
pub(super) fn check_end(
    source: &Source,
    header: &LasHeader,
    file_bytes: u64,
    points: u64,
    findings: &mut Findings,
    monitor: &dyn Monitor,
) -> Result<()> {
    let len = u64::from(header.record_bytes);
    let at = header.points_at.saturating_add(points.saturating_mul(len));
    let end = end(source, header, file_bytes)?;
    let room = end.saturating_sub(at) / len;
    if points == 0 || room == 0 {
        return Ok(());
    }
    let mut block = [0; LOOK_BYTES];
    let mut next = at;
    while next < end {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let want = (end - next).min(LOOK_BYTES as u64) as usize;
        let got = source.read_at(&mut block[..want], next)?;
        if got == 0 {
            break; // the file was truncated since it was opened
        }
        if block[..got].iter().any(|&byte| byte != 0) {
            let most = points.saturating_add(room);
            let text =
                format!("the header states {points} points, but its records have room for {most}, up to byte {end}");
            return findings.lose_points(room, text);
        }
        next += got as u64;
    }
    findings.note(format!("the header states {points} points; {} zeros after them are padding", end - at));
    Ok(())
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
