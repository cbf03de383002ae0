//! Decoding of pieces of files, on any number of threads, in any order.

use super::cloud;
use super::convert::{self, Extras, TagField};
use super::diagnostics::without_path;
use super::file::Content;
use super::laz::{Chunking, PackedPoints, Wanted};
use super::source::{ReadLog, Source};
use super::{BATCH_POINTS, InputSet, PointBatch, PointCounts, las};
use crate::colour::ColourSource;
use crate::{Error, Result};
use std::sync::PoisonError;

/// Points in one [`PointChunk`] of a plain LAS file.
const CHUNK_POINTS: u64 = 1 << 17;
/// Maximum length of a slab of undecoded records (bytes): fits into a second-level cache beside the batch.
const SLAB_BYTES: usize = 1 << 17;

/// One piece of work.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PointChunk {
    file: usize,
    points: u64,
    source: ChunkSource,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum ChunkSource {
    Records { first: u64 },
    Chunk { index: usize, start: u64, len: u64 },
    Stream { start: u64, len: u64, table_at: Option<u64> },
    Cloud(cloud::Piece),
}

impl PointChunk {
    /// Returns the index of its file in [`InputSet::files`].
    pub fn file(&self) -> usize {
        self.file
    }

    /// Returns the number of points it should hold: for progress only.
    pub fn points(&self) -> u64 {
        self.points
    }
}

impl InputSet {
    /// Returns independent pieces of work, created lazily: 131,072 points of a LAS file, one LAZ chunk, or a whole LAZ
    /// file that can only be read from its start.
    pub fn chunks(&self) -> impl Iterator<Item = PointChunk> + Send + '_ {
        self.files.iter().enumerate().flat_map(|(file, scan)| {
            let pieces: Box<dyn Iterator<Item = PointChunk> + Send + '_> = match &scan.content {
                Content::Plain { points } => {
                    let points = *points;
                    Box::new((0..points.div_ceil(CHUNK_POINTS)).map(move |i| {
                        let first = i * CHUNK_POINTS;
                        PointChunk {
                            file,
                            points: CHUNK_POINTS.min(points - first),
                            source: ChunkSource::Records { first },
                        }
                    }))
                }
                Content::Packed { body: Chunking::Stream { start, len, points, table_at }, .. } => {
                    let source = ChunkSource::Stream { start: *start, len: *len, table_at: *table_at };
                    Box::new((*points > 0).then_some(PointChunk { file, points: *points, source }).into_iter())
                }
                Content::Packed { body: Chunking::Chunks { start, chunks }, .. } => {
                    let mut at = *start;
                    Box::new(chunks.iter().enumerate().filter_map(move |(index, chunk)| {
                        let (start, len) = (at, u64::from(chunk.bytes));
                        at += len;
                        let points = u64::from(chunk.points);
                        let source = ChunkSource::Chunk { index, start, len };
                        (points > 0 || len > 0).then_some(PointChunk { file, points, source })
                    }))
                }
                Content::Cloud(cloud) => Box::new(cloud.pieces().map(move |piece| PointChunk {
                    file,
                    points: piece.points,
                    source: ChunkSource::Cloud(piece),
                })),
            };
            pieces
        })
    }
}

/// Decodes pieces of work; use one per thread to reuse its buffers.
#[derive(Debug, Default)]
pub struct PointDecoder {
    slab: Vec<u8>,
    batch: PointBatch,
    source: Option<(usize, Source)>,
    log: ReadLog,
    lost: bool,
}

impl PointDecoder {
    /// Creates a decoder with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the log of its reads, which is filled if the set's options request hashes.
    pub fn log(&self) -> ReadLog {
        self.log.clone()
    }

    /// Returns whether the last decoded piece was incomplete.
    pub fn has_lost(&self) -> bool {
        self.lost
    }

    /// Decodes `piece` of `set` and passes its kept points to `sink` in batches of at most [`BATCH_POINTS`] points. A
    /// batch may be empty, so that `sink` can cancel even if no points are kept.
    ///
    /// An error of `sink` ends the work and is returned. Missing points are counted and are not an error. Damaged
    /// compressed data are an error, after some points were passed on. With `allow_incomplete` they are a loss reported
    /// by [`InputSet::check_complete`], and no point of a damaged LAZ chunk is passed on.
    pub fn decode(
        &mut self,
        set: &InputSet,
        piece: &PointChunk,
        sink: &mut dyn FnMut(&PointBatch) -> Result<()>,
    ) -> Result<PointCounts> {
        let Some(file) = set.files.get(piece.file) else { return Err(of_another_set()) };
        if self.source.as_ref().is_none_or(|(number, _)| *number != piece.file) {
            let source = Source::open(file.path(), set.options.hash.then(|| self.log.clone()))?;
            if source.stamp() != file.stamp {
                set.diagnostics.add(piece.file, |loss| loss.changed = true);
            }
            self.source = Some((piece.file, source));
        }
        let Some((_, source)) = &self.source else { return Ok(PointCounts::default()) };
        self.batch.cloud = 0;
        self.log.begin(piece.file);
        self.lost = false;
        if let Content::Cloud(cloud) = &file.content {
            let ChunkSource::Cloud(part) = &piece.source else { return Err(of_another_set()) };
            let mut taker = cloud::Taker::new(file.unit_m(), &set.options, &mut self.batch, sink).widening(file.widen);
            let done = cloud.decode(part, source, &mut self.slab, &mut taker);
            let outcome = match done {
                Ok(missing) => taker.flush().map(|()| missing),
                // Points before the damage are passed on.
                Err(error) if !taker.refused => taker.flush().and(Err(error)),
                Err(error) => Err(error),
            };
            let (counts, refused, broken) = (taker.counts(), taker.refused, taker.broken());
            set.singles.lock().unwrap_or_else(PoisonError::into_inner).note(piece.file, taker.farthest_singles());
            if let Some((records, reason)) = broken {
                set.diagnostics.add(piece.file, |loss| {
                    loss.unread += records;
                    loss.reason.get_or_insert(reason);
                });
            }
            return self.settle(set, piece, outcome, counts, refused);
        }
        let colour = set.options.colour;
        let field = colour.and_then(|source| file.field(source));
        let rgb = matches!(field, Some(convert::Field::Rgb(_)));
        let tag = set.tag.and_then(|tag| file.tag_field(tag));
        let record_bytes = match &file.content {
            Content::Plain { .. } => usize::from(file.record_bytes),
            Content::Packed { packing, .. } => packing.decoded_bytes(rgb),
            Content::Cloud(_) => return Err(of_another_set()),
        };
        // A slab holds at least one record (at most 64 KiB), and no more than a batch or than the piece needs.
        let most_points = piece.points.clamp(1, BATCH_POINTS as u64) as usize;
        let slab_points = (SLAB_BYTES / record_bytes).clamp(1, most_points);
        self.slab.resize(slab_points * record_bytes, 0);
        let (batch, mut counts, mut refused) = (&mut self.batch, PointCounts::default(), false);
        let filter = set.filter(file.layout());
        let mut take = |records: &[u8]| {
            convert::convert(records, record_bytes, &file.transform, filter, Extras { field, tag }, batch, &mut counts);
            if file.widen {
                batch.values.as_flattened_mut().iter_mut().for_each(|value| *value = value.saturating_mul(257));
            }
            sink(batch).inspect_err(|_| refused = true)
        };
        let wanted = Wanted {
            classes: !set.options.exclude_classes.is_empty() || colour == Some(ColourSource::Class),
            intensity: colour == Some(ColourSource::Intensity),
            rgb,
            source_ids: matches!(tag, Some(TagField::SourceId(_))),
            times: matches!(tag, Some(TagField::GpsTime(_))),
        };
        let run = |packing, start, len, stream, name| {
            let (points, memory) = (piece.points, &set.chunk_memory);
            PackedPoints { source, packing, start, len, points, stream, wanted, memory, name }
        };
        let (slab, only_whole) = (&mut self.slab, set.options.allow_incomplete);
        // `Ok` holds the number of missing points.
        let outcome = match (&piece.source, &file.content) {
            (ChunkSource::Chunk { index, start, len }, Content::Packed { packing, .. }) => {
                let run = run(&**packing, *start, *len, None, format!("LAZ chunk {index}"));
                run.decode(only_whole, slab, &mut take).map(|()| 0)
            }
            (ChunkSource::Stream { start, len, table_at }, Content::Packed { packing, .. }) => {
                let run = run(&**packing, *start, *len, Some(*table_at), "LAZ points".into());
                run.decode(only_whole, slab, &mut take).map(|()| 0)
            }
            (ChunkSource::Records { first }, Content::Plain { .. }) => {
                let start = file.points_at + first * record_bytes as u64;
                las::read(source, start, piece.points, record_bytes, slab, &mut take)
                    .map(|done| piece.points.saturating_sub(done))
            }
            _ => return Err(of_another_set()),
        };
        self.settle(set, piece, outcome, counts, refused)
    }

    /// Records diagnostics: missing points, or those left unread after an error.
    fn settle(
        &mut self,
        set: &InputSet,
        piece: &PointChunk,
        outcome: Result<u64>,
        mut counts: PointCounts,
        refused: bool,
    ) -> Result<PointCounts> {
        // Single unreadable records are already counted as missing.
        let broken = counts.missing;
        self.lost = broken > 0;
        match outcome {
            Ok(missing) => {
                counts.missing += missing;
                if missing + counts.not_finite > 0 {
                    self.lost = true;
                    set.diagnostics.add(piece.file, |loss| {
                        loss.missing += missing;
                        loss.not_finite += counts.not_finite;
                    });
                }
            }
            Err(error @ (Error::Input { .. } | Error::Io { .. })) if !refused && set.options.allow_incomplete => {
                let unread = piece.points.saturating_sub(counts.read + broken);
                counts.missing += unread;
                self.lost = true;
                set.diagnostics.add(piece.file, |loss| {
                    loss.not_finite += counts.not_finite;
                    loss.unread += unread;
                    loss.damaged += 1;
                    loss.reason.get_or_insert(without_path(error));
                });
            }
            Err(error) => return Err(error),
        }
        if set.options.hash {
            set.add_hash(piece.file, self.log.hash());
        }
        Ok(counts)
    }
}

fn of_another_set() -> Error {
    Error::parameter("chunk", "it belongs to another set of files")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::InputOptions;
    use slicewalk_base::bytes::testing::{Strike, StruckSource};
    use slicewalk_base::bytes::{MemorySource, hold_source};
    use slicewalk_base::{Monitor, Warning};
    use std::sync::Mutex;

    /// LAS 1.2 of format 0.
    fn las(points: u8) -> Vec<u8> {
        let mut file = vec![0; 227];
        let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"LASF");
        put(24, &[1, 2]);
        put(94, &[227, 0, 227]);
        put(105, &[20, 0, points]);
        (0..3).for_each(|axis| put(131 + 8 * axis, &0.01f64.to_le_bytes()));
        file.extend((0..points).flat_map(|n| [[n; 4]; 5].concat()));
        file
    }

    /// Notes all warnings.
    #[derive(Default)]
    struct Notes(Mutex<Vec<String>>);

    impl Monitor for Notes {
        fn warn(&self, warning: &Warning) {
            self.0.lock().unwrap().push(warning.to_string());
        }
    }

    #[test]
    fn a_user_who_stops_gets_no_part_of_a_set() {
        const NAME: &str = "stopped.las";
        let mut file = las(3);
        // Padding is read in several steps.
        file.resize(file.len() + (1 << 18), 0);
        hold_source(NAME, MemorySource::new(file));
        for number in 0.. {
            let stop = Strike::at(number);
            let set = InputSet::of_paths(vec![NAME.into()], InputOptions::default(), &*stop);
            if !stop.fell() {
                assert!(set.unwrap().points_stated() == 3 && number > 4, "{number} questions");
                break;
            }
            assert!(matches!(set, Err(Error::Interrupted)), "{number}");
        }
    }

    #[test]
    fn a_failed_read_loses_no_point_unnoticed() {
        const NAME: &str = "struck.las";
        let file = las(3);
        for allow_incomplete in [false, true] {
            let mut incomplete = 0;
            for number in 0.. {
                let strike = Strike::at(number);
                hold_source(NAME, StruckSource::new(MemorySource::new(&file[..]), &strike));
                let notes = Notes::default();
                let pass = || {
                    let options = InputOptions { allow_incomplete, ..InputOptions::default() };
                    let set = InputSet::of_paths(vec![NAME.into()], options, &notes)?;
                    let (mut decoder, mut counts) = (PointDecoder::new(), PointCounts::default());
                    for piece in set.chunks() {
                        counts += decoder.decode(&set, &piece, &mut |_| Ok(()))?;
                    }
                    set.check_complete(&notes)?;
                    Ok::<_, Error>((counts.read, counts.missing))
                };
                let done = pass();
                if !strike.fell() {
                    assert_eq!(done.unwrap(), (3, 0));
                    break;
                }
                match done {
                    Ok(counts) => {
                        assert!(allow_incomplete && counts == (0, 3), "{number}: {counts:?}");
                        let said = notes.0.into_inner().unwrap();
                        let lines: Vec<_> = said.iter().filter(|line| line.contains("incomplete")).collect();
                        let [line] = lines[..] else { panic!("{said:?}") };
                        assert!(line.contains(Strike::REASON) && line.contains("3 points could not be read"), "{line}");
                        assert_eq!(line.matches(NAME).count(), 1, "{line}");
                        incomplete += 1;
                    }
                    Err(error) => assert!(error.to_string().contains(Strike::REASON), "{number}: {error}"),
                }
            }
            assert_eq!(incomplete > 0, allow_incomplete);
        }
    }
}
