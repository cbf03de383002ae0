//! Plain LAS: how many whole records a file holds, and reading them in slabs.
//!
//! In: a checked header. Out: whole point records. Memory: one slab, given by the caller. The count in the header is
//! only an upper bound: files are cut (`1.2-with-color-clipped.las`) and headers lie.

use super::header::Header;
use super::source::Source;
use crate::{Error, Result};

/// Points that can be read: as many as stated, if they fit.
pub(super) fn points(source: &Source, header: &Header, file_bytes: u64, notes: &mut Vec<String>) -> Result<u64> {
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
        notes.push(format!("the header states {stated} points, the file holds {room} whole ones; these are read"));
    }
    Ok(stated.min(room))
}

/// Reads `count` records of `record_bytes` from byte `start` on, slab by slab; returns how many were there.
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
            break; // the file became shorter since it was opened
        }
    }
    Ok(done)
}
