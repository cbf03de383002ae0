//! Location of the chunks of a LAZ file, and their numbers of points.
//!
//! Input: a checked header, the chunk table, the heads of layered chunks. Output: a [`Chunking`] whose counts match the
//! header; otherwise, points are lost. If the table is missing, layered chunks are found by their heads, others by
//! decoding them in sequence.

use super::coder::MOST_STEP_BYTES;
use super::items::LaszipRecord;
use super::packed::PackedBytes;
use super::{EMPTY_CODE_BYTES, Numbers, Packing, too_much};
use crate::diagnostics::Findings;
use crate::header::{LasHeader, u32_at, u64_at};
use crate::las;
use crate::source::Source;
use crate::{Error, Result};

/// Size and number of points of one chunk.
#[derive(Debug, Clone, Copy)]
pub struct Chunk {
    pub bytes: u32,
    pub points: u32,
}

/// Division of the points of a LAZ file.
#[derive(Debug)]
pub enum Chunking {
    /// Consecutive chunks from byte `start` on.
    Chunks { start: u64, chunks: Vec<Chunk> },
    /// Chunks of unknown length in the `len` bytes from `start` on.
    Stream {
        start: u64,
        len: u64,
        points: u64,
        /// Offset of the chunk table stated by the file, right or wrong; `None` if the points are one chunk without a
        /// table.
        table_at: Option<u64>,
    },
}

impl Chunking {
    const NOTHING: Self = Self::Stream { start: 0, len: 0, points: 0, table_at: None };
}

/// Reason why a chunk table cannot be used, and its stated offset.
struct Lost {
    reason: String,
    table_at: u64,
}

/// Head of a layered chunk.
pub(super) struct Head {
    pub points: u32,
    /// Bytes of the whole chunk.
    pub bytes: u64,
    /// Bytes of each layer.
    pub sizes: Vec<u64>,
    /// The first point, and the rest of the head.
    pub first: Vec<u8>,
}

impl Packing {
    /// Finds the chunks. If the chunk table is missing or wrong, uses the heads of the chunks (formats 6 to 10) or one
    /// sequence. `most_chunks` limits the index.
    pub fn body(
        &self,
        source: &Source,
        header: &LasHeader,
        file_bytes: u64,
        most_chunks: u64,
        findings: &mut Findings,
    ) -> Result<Chunking> {
        let stated = header.points_stated;
        let data_at = header.points_at;
        let bad = |reason: String| Error::input(source.path(), "LAZ points", reason);
        if data_at >= file_bytes {
            if stated > 0 {
                let text = format!("the header states {stated} points, but the file ends before the first");
                findings.lose_points(stated, text)?;
            }
            return Ok(Chunking::NOTHING);
        }
        let unfinished = || {
            bad("the header states 0 points but data follow: the program that wrote this file was interrupted; write or \
                 fetch the file again"
                .into())
        };
        let sequence = |start: u64, end: u64, table_at| {
            let len = end.saturating_sub(start);
            match stated {
                0 if len >= self.record_bytes as u64 => Err(unfinished()),
                0 => Ok(Chunking::NOTHING),
                _ => Ok(Chunking::Stream { start, len, points: stated, table_at }),
            }
        };
        if self.whole {
            return sequence(data_at, las::end(source, header, file_bytes)?, None);
        }
        let start = data_at + 8;
        let Lost { reason, table_at } = match self.table(source, data_at, file_bytes, most_chunks)? {
            Ok(chunks) => {
                let chunks = self.with_counts(source, start, chunks, stated, findings)?.ok_or_else(unfinished)?;
                return Ok(Chunking::Chunks { start, chunks });
            }
            Err(lost) => lost,
        };
        if !self.layered {
            if self.record.chunk_points == LaszipRecord::VARIABLE {
                let what = "and its chunks vary in length, so none can be found; write or fetch the file again";
                return Err(bad(format!("{reason}, {what}")));
            }
            findings.note(format!("{reason}; its points are read without it"));
            return sequence(start, file_bytes, Some(table_at));
        }
        findings.note(format!("{reason}; its points are found without it"));
        let chunks = self.walk(source, start, file_bytes.max(start), stated, most_chunks)?;
        let found: u64 = chunks.iter().map(|c| u64::from(c.points)).sum();
        let end = start + chunks.iter().map(|c| u64::from(c.bytes)).sum::<u64>();
        let ends = self.may_end(source, end, file_bytes, Some(table_at), chunks.len() as u64)?;
        if found != stated || !ends && end < file_bytes {
            let rest = file_bytes.saturating_sub(end);
            let text =
                format!("the header states {stated} points, whole chunks hold {found}, and {rest} bytes follow them");
            findings.lose_points(stated.saturating_sub(found), text)?;
        }
        Ok(Chunking::Chunks { start, chunks })
    }

    /// Returns whether the points of `chunks` chunks may end at byte `at`: the file ends or its chunk table begins
    /// there.
    pub(super) fn may_end(
        &self,
        source: &Source,
        at: u64,
        end: u64,
        table_at: Option<u64>,
        chunks: u64,
    ) -> Result<bool> {
        let Some(table_at) = table_at.filter(|_| at != end) else { return Ok(at == end) };
        let head = source.bytes_at(at, 8)?;
        // An empty chunk may come last.
        let is_table = |head: Vec<u8>| u32_at(&head, 0) == 0 && u64::from(u32_at(&head, 4)).abs_diff(chunks) <= 1;
        Ok(at == table_at || head.is_some_and(is_table))
    }

    /// Reads the chunk table. The inner error is the reason why it cannot be used.
    fn table(
        &self,
        source: &Source,
        data_at: u64,
        file_bytes: u64,
        most_chunks: u64,
    ) -> Result<std::result::Result<Vec<Chunk>, Lost>> {
        let start = data_at + 8;
        let place = |bytes: Option<Vec<u8>>| bytes.map_or(0, |b| u64_at(&b, 0));
        let mut table_at = place(source.bytes_at(data_at, 8)?);
        if table_at == u64::MAX || table_at <= data_at {
            // Written to a pipe: the offset of the table is at the very end.
            table_at = place(source.bytes_at(file_bytes.saturating_sub(8), 8)?);
            if table_at < start || table_at > file_bytes.saturating_sub(16) {
                return Ok(Err(Lost { reason: "it has no chunk table".into(), table_at: 0 }));
            }
        }
        let lost = |reason: String| Ok(Err(Lost { reason, table_at }));
        if table_at < start || table_at > file_bytes.saturating_sub(8) {
            return lost(format!("its chunk table should begin at byte {table_at} of {file_bytes}: the file is cut"));
        }
        let Some(head) = source.bytes_at(table_at, 8)? else { return lost("its chunk table is cut".into()) };
        let (version, count) = (u32_at(&head, 0), u64::from(u32_at(&head, 4)));
        let data_bytes = table_at - start;
        // Even a chunk without points takes a few bytes, except in a file without any points.
        if version != 0 || count > 1 + data_bytes / EMPTY_CODE_BYTES {
            return lost(format!("its chunk table (version {version}, {count} chunks) is damaged"));
        }
        check_count(source, count, most_chunks)?;
        let Some(chunks) = self.entries(source, table_at + 8, file_bytes - table_at - 8, count)? else {
            return lost("its chunk table is cut".into());
        };
        let sum: u64 = chunks.iter().map(|c| u64::from(c.bytes)).sum();
        if sum != data_bytes {
            return lost(format!("its chunk table gives {sum} bytes to {count} chunks, which have {data_bytes}"));
        }
        Ok(Ok(chunks))
    }

    /// Reads the `count` entries of a chunk table in the `len` bytes from `start` on, each stored as a difference from
    /// the last; `None` if the table is cut.
    fn entries(&self, source: &Source, start: u64, len: u64, count: u64) -> Result<Option<Vec<Chunk>>> {
        const POINTS: usize = 0;
        const BYTES: usize = 1;
        const MOST: usize = 2 * Numbers::MOST_STEPS * MOST_STEP_BYTES + EMPTY_CODE_BYTES as usize;
        let mut packed = PackedBytes::new(source, start, len);
        let mut numbers = Numbers::new(32, 2);
        let (mut points, mut bytes) = (0, 0);
        let mut chunks = Vec::new();
        for number in 0..count {
            packed.hold(MOST).map_err(|e| Error::io(source.path(), "read the chunk table", e))?;
            let mut coder = if number == 0 { packed.begin(0) } else { packed.coder() };
            if self.record.chunk_points == LaszipRecord::VARIABLE {
                points = numbers.next(&mut coder, POINTS, points);
            }
            bytes = numbers.next(&mut coder, BYTES, bytes);
            if coder.is_beyond() {
                return Ok(None);
            }
            let state = coder.state();
            packed.keep(state);
            // The numbers are unsigned 32-bit.
            chunks.push(Chunk { bytes: bytes as u32, points: points as u32 });
        }
        Ok(Some(chunks))
    }

    /// Determines the points of chunks of equal length, and notes if they differ from `stated`. Returns `None` if only
    /// the header could state the size of the last chunk, and it states 0.
    fn with_counts(
        &self,
        source: &Source,
        start: u64,
        mut chunks: Vec<Chunk>,
        stated: u64,
        findings: &mut Findings,
    ) -> Result<Option<Vec<Chunk>>> {
        let size = self.record.chunk_points;
        if size != LaszipRecord::VARIABLE {
            // Chunks after the last point are empty.
            let filled = chunks.iter().rposition(|c| u64::from(c.bytes) > EMPTY_CODE_BYTES).map_or(0, |last| last + 1);
            let before = filled.saturating_sub(1);
            chunks[..before].iter_mut().for_each(|chunk| chunk.points = size);
            let at = start + chunks[..before].iter().map(|c| u64::from(c.bytes)).sum::<u64>();
            let before = before as u64 * u64::from(size);
            if let Some(last) = chunks[..filled].last_mut() {
                let rest = stated.checked_sub(before).filter(|rest| (1..=u64::from(size)).contains(rest));
                last.points = match rest {
                    // The chunk is more reliable than the header.
                    _ if self.layered => {
                        self.head(source, at, u64::from(last.bytes))?.map_or(0, |head| head.points).min(size)
                    }
                    Some(rest) => rest as u32,
                    None if stated == 0 => return Ok(None),
                    None => {
                        let (least, most) = (before + 1, before + u64::from(size));
                        let text = format!(
                            "the header states {stated} points, but its {filled} chunks hold {least} to {most}"
                        );
                        findings.lose_points(stated.saturating_sub(most), text)?;
                        size
                    }
                };
                if !self.layered {
                    return Ok(Some(chunks));
                }
            }
        }
        let found: u64 = chunks.iter().map(|c| u64::from(c.points)).sum();
        if found != stated {
            let text = format!("the header states {stated} points, its chunks hold {found}");
            findings.lose_points(stated.saturating_sub(found), text)?;
        }
        Ok(Some(chunks))
    }

    /// Finds layered chunks by their heads alone, up to `stated` points (0: all) or the end.
    fn walk(&self, source: &Source, start: u64, end: u64, stated: u64, most_chunks: u64) -> Result<Vec<Chunk>> {
        let (mut at, mut points) = (start, 0);
        let mut chunks = Vec::new();
        while stated == 0 || points < stated {
            let Some(head) = self.head(source, at, end - at)? else { break };
            if head.points == 0 || head.bytes > end - at || head.bytes > u64::from(u32::MAX) {
                break;
            }
            chunks.push(Chunk { bytes: head.bytes as u32, points: head.points });
            check_count(source, chunks.len() as u64, most_chunks)?;
            at += head.bytes;
            points += u64::from(head.points);
        }
        Ok(chunks)
    }

    /// Reads the head of the layered chunk at `at`: one plain record, the number of points, the sizes of the layers.
    pub(super) fn head(&self, source: &Source, at: u64, room: u64) -> Result<Option<Head>> {
        let len = self.record_bytes + 4 + 4 * self.layers;
        if room < len as u64 {
            return Ok(None);
        }
        let Some(bytes) = source.bytes_at(at, len)? else { return Ok(None) };
        let size = |layer: usize| u64::from(u32_at(&bytes, self.record_bytes + 4 + 4 * layer));
        let sizes: Vec<u64> = (0..self.layers).map(size).collect();
        let points = u32_at(&bytes, self.record_bytes);
        Ok(Some(Head { points, bytes: len as u64 + sizes.iter().sum::<u64>(), sizes, first: bytes }))
    }
}

fn check_count(source: &Source, count: u64, most: u64) -> Result<()> {
    if count <= most {
        return Ok(());
    }
    Err(too_much(source, "chunks of a LAZ file", count, most))
}
