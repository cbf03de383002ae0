//! Resuming from the data that an earlier run of the same conversion left on disk.
//!
//! A run that spills records in its journal which chunks of the input its runs cover, what was found in them, and which
//! bytes were read for them, with their hash. A later run reuses these runs if it has the same plan and the same
//! inputs. Inputs are compared by path, length and modification time of each file, by what its header states of its
//! chunks, and by hashing again the bytes that were read. The later run then reads the chunks that are missing. Of a
//! chunk covered in part it skips the points that are covered, because the decoder gives the same points in the same
//! order.
//!
//! Values for colours have their own runs, which cover points separately; a chunk is done when both kinds of runs cover
//! it. The statistics of all values follow from their records.
//!
//! Meshes are read again. The second pass, from runs to pages, starts from the beginning.

use super::colours::Values;
use super::planning::Surveyed;
use super::points::{OfFile, Read};
use super::{ConvertOptions, PixelSize};
use crate::archive::Shard;
use crate::codec::ByteReader;
use crate::colour::ColourSource;
use crate::input::spacing::Spacing;
use crate::input::{InputSet, PointCounts, ReadLog, Reads, ScanFile, Units};
use crate::mesh::MeshMode;
use crate::output::Output;
use crate::plan::{Noise, Plan};
use crate::voxel::record::Record;
use crate::voxel::spill::{Leftover, Spill, SpillPlace, SpilledRun};
use crate::{Error, Monitor, Parameter, Result};
use std::cell::RefCell;
use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

/// Data reused from an earlier run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Resumed {
    /// Points that the reused runs cover.
    pub points: u64,
    /// Length of these runs on disk (bytes).
    pub bytes: u64,
}

/// Everything that decides which records a run makes from a chunk.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Identity {
    version: String,
    plan: Vec<u8>,
    /// Measurements from which automatic options follow.
    surveyed: Surveyed,
    /// Unit of the input, mode of meshes and source of colours, as numbers.
    numbers: [f64; 3],
    shard: Option<Shard>,
    inputs: Vec<InputState>,
}

/// State of an input, as hashes, because there may be very many inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct InputState {
    /// Hash of its absolute path.
    path: u64,
    /// Hash of its length, its modification time, and what decides which chunks it has.
    state: u64,
}

impl InputState {
    fn of(file: &ScanFile) -> Self {
        let path = std::path::absolute(file.path()).unwrap_or_else(|_| file.path().to_path_buf());
        let mut state = file.bytes().to_le_bytes().to_vec();
        state.extend(file.stamp.modified_ns().unwrap_or(i128::MIN).to_le_bytes());
        state.extend(file.layout_hash().to_le_bytes());
        Self { path: xxh3_64(path.as_os_str().as_encoded_bytes()), state: xxh3_64(&state) }
    }
}

impl Identity {
    /// Creates the identity of a conversion of `set`, which already reads the values that become colours, if any.
    pub fn of(options: &ConvertOptions, plan: &Plan, surveyed: Surveyed, shard: Option<Shard>, set: &InputSet) -> Self {
        let unit = match options.reading.units {
            Units::Auto => 0.0,
            Units::Factor(factor) => factor,
        };
        let mesh = match options.reading.mesh {
            MeshMode::Exact => -1.0,
            MeshMode::Sampled { step_m } => step_m.unwrap_or(0.0),
        };
        let source = set.options().colour.and_then(|source| ColourSource::ALL.iter().position(|all| *all == source));
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            plan: plan.to_bytes().to_vec(),
            surveyed,
            numbers: [unit, mesh, source.map_or(0.0, |source| 1.0 + source as f64)],
            shard,
            inputs: set.files().iter().map(InputState::of).collect(),
        }
    }

    /// Returns the head of a journal: the target, then this identity.
    pub fn head(&self, target: &Path) -> Vec<u8> {
        let mut out = Vec::new();
        let mut put = |bytes: &[u8]| {
            out.extend((bytes.len() as u64).to_le_bytes());
            out.extend(bytes);
        };
        put(target.as_os_str().as_encoded_bytes());
        put(self.version.as_bytes());
        put(&self.plan);
        let spacing = self.surveyed.spacing.map(|Spacing { spacing_m, sampled, block_m, points }| {
            [spacing_m.to_bits(), sampled, block_m.to_bits(), points].map(u64::to_le_bytes)
        });
        put(spacing.as_ref().map_or(&[][..], |spacing| spacing.as_flattened()));
        put(self.numbers.map(f64::to_le_bytes).as_flattened());
        let shard = self.shard.map(|Shard { index, count, first, last, plan_file }| {
            let numbers = [u64::from(index), u64::from(count), first, last, plan_file as u64, (plan_file >> 64) as u64];
            numbers.map(u64::to_le_bytes)
        });
        put(shard.as_ref().map_or(&[][..], |shard| shard.as_flattened()));
        let inputs: Vec<_> =
            self.inputs.iter().flat_map(|input| [input.path, input.state]).map(u64::to_le_bytes).collect();
        put(inputs.as_flattened());
        if let Some(Noise { noise_m, regions, region_m }) = self.surveyed.noise {
            put([noise_m.to_bits(), regions, region_m.to_bits()].map(u64::to_le_bytes).as_flattened());
        }
        out
    }

    /// Splits a head into the target and the other fields.
    fn split(head: &[u8]) -> Option<(&[u8], Vec<&[u8]>)> {
        let mut reader = ByteReader::new(head, "");
        let mut fields = Vec::new();
        while !reader.is_empty() {
            let len = reader.u64().ok()?;
            fields.push(reader.take(usize::try_from(len).ok()?).ok()?);
        }
        let (target, rest) = fields.split_first()?;
        Some((target, rest.to_vec()))
    }

    fn from_fields(fields: &[&[u8]]) -> Option<Self> {
        let (&[version, plan, spacing, numbers, shard, inputs], noise) = fields.split_first_chunk()?;
        let u64s =
            |bytes: &[u8]| bytes.as_chunks().0.iter().map(|&bytes| u64::from_le_bytes(bytes)).collect::<Vec<_>>();
        let spacing = match u64s(spacing)[..] {
            [] => None,
            [spacing, sampled, block, points] => {
                let (spacing_m, block_m) = (f64::from_bits(spacing), f64::from_bits(block));
                Some(Spacing { spacing_m, sampled, block_m, points })
            }
            _ => return None,
        };
        let noise = match noise {
            [] => None,
            [noise] => {
                let [noise, regions, region] = u64s(noise)[..] else { return None };
                Some(Noise { noise_m: f64::from_bits(noise), regions, region_m: f64::from_bits(region) })
            }
            _ => return None,
        };
        let shard = match u64s(shard)[..] {
            [] => None,
            [index, count, first, last, low, high] => Some(Shard {
                index: index as u32,
                count: count as u32,
                first,
                last,
                plan_file: u128::from(high) << 64 | u128::from(low),
            }),
            _ => return None,
        };
        let inputs = u64s(inputs).as_chunks().0.iter().map(|&[path, state]| InputState { path, state }).collect();
        let numbers: [u64; 3] = u64s(numbers).try_into().ok()?;
        Some(Self {
            version: String::from_utf8(version.to_vec()).ok()?,
            plan: plan.to_vec(),
            surveyed: Surveyed { spacing, noise },
            numbers: numbers.map(f64::from_bits),
            shard,
            inputs,
        })
    }

    /// Fails if a run of this identity, over `set`, cannot continue from the data of `earlier`.
    fn check(&self, earlier: &Self, set: &InputSet) -> Result<()> {
        let again = "give the same inputs and options again, or start over without resuming";
        let refuse = |reason: String| Err(Error::parameter(Parameter::Resume, reason));
        if earlier.version != self.version {
            let (was, is) = (&earlier.version, &self.version);
            return refuse(format!(
                "version {was} of this program began the conversion, this is {is}; start over without resuming"
            ));
        }
        let path = |number: usize| set.files()[number].path();
        let before: HashSet<u64> = earlier.inputs.iter().map(|input| input.path).collect();
        if let Some(new) = self.inputs.iter().position(|input| !before.contains(&input.path)) {
            return refuse(format!("the conversion was begun without {}; {again}", path(new).display()));
        }
        if before.len() > self.inputs.len() {
            return refuse(format!("the conversion was begun with inputs that are not named now; {again}"));
        }
        if let Some(changed) = self.inputs.iter().zip(&earlier.inputs).position(|(now, then)| now != then) {
            return Err(changed_since(path(changed)));
        }
        if earlier.shard != self.shard {
            return refuse(format!("another part was begun; {again}"));
        }
        if (&earlier.plan, earlier.numbers) != (&self.plan, self.numbers) {
            return refuse(format!("the conversion was begun with other options; {again}"));
        }
        Ok(())
    }
}

fn changed_since(path: &Path) -> Error {
    let reason = "the file has changed since the run to be resumed read it; start over without resuming";
    Error::input(path, "content", reason)
}

/// Data that an earlier run left for this target.
pub(super) struct Earlier {
    leftover: Leftover,
    identity: Identity,
}

impl Earlier {
    /// Finds the data that an earlier run left for the archive `target`. Removes the data if it is not to be resumed.
    pub fn find(options: &ConvertOptions, output: &Output, target: &Path) -> Result<Option<Self>> {
        let files = output.files();
        let name = target.file_name().unwrap_or_default();
        let found = match Leftover::find(files, &options.resources.temp_dir, name, output.owner()) {
            Ok(found) => found,
            Err(error) if options.resume => return Err(error),
            // A folder that cannot be read cannot be written to either, and writing reports that.
            Err(_) => return Ok(None),
        };
        let mut earlier: Option<Self> = None;
        for leftover in found {
            let Some((of, fields)) = leftover.head().and_then(Identity::split) else {
                leftover.remove();
                continue;
            };
            if of != target.as_os_str().as_encoded_bytes() {
                continue;
            }
            let is_there = files.about(leftover.path()).is_ok_and(|about| about.is_some());
            match Identity::from_fields(&fields).filter(|_| options.resume && is_there) {
                // Only concurrent runs leave several: keep the largest.
                Some(identity) => {
                    let this = Self { leftover, identity };
                    let (more, less) = match earlier.take() {
                        Some(other) if other.leftover.bytes() >= this.leftover.bytes() => (other, Some(this)),
                        other => (this, other),
                    };
                    less.into_iter().for_each(|less| less.leftover.remove());
                    earlier = Some(more);
                }
                None => leftover.remove(),
            }
        }
        Ok(earlier)
    }

    /// Returns the length of the data on disk (bytes).
    pub fn bytes(&self) -> u64 {
        self.leftover.bytes()
    }

    /// Returns the measurements from which the automatic options of `options` follow; `None` unless all are known.
    pub fn surveyed(&self, options: &ConvertOptions) -> Option<Surveyed> {
        let Surveyed { spacing, noise } = self.identity.surveyed;
        let (auto_pixel, auto_tolerance) = (options.grid.pixel == PixelSize::Auto, options.grid.tolerance_auto);
        if auto_pixel && spacing.is_none() || auto_tolerance && noise.is_none() {
            return None;
        }
        Some(Surveyed { spacing: spacing.filter(|_| auto_pixel), noise: noise.filter(|_| auto_tolerance) })
    }

    /// Takes over the data for a run of `identity` that spills at `place`.
    pub fn take_over(
        self,
        identity: &Identity,
        place: SpillPlace,
        set: &InputSet,
        monitor: &dyn Monitor,
    ) -> Result<TakenOver> {
        identity.check(&self.identity, set)?;
        monitor.stage("checking", self.bytes(), "bytes");
        let mut look = |bytes| {
            monitor.advance(bytes);
            if monitor.cancelled() { Err(Error::Interrupted) } else { Ok(()) }
        };
        let (mut runs, mut begun) = (Vec::new(), BTreeMap::new());
        let mut progress = Progress::nothing(set.files().len());
        progress.wants_values = set.options().colour.is_some();
        // `of_run` holds the values of the current run, `progress.values` those of all runs that proved whole.
        let of_run = set.options().colour.map(Values::new);
        progress.values = of_run.clone();
        let of_run = RefCell::new(of_run);
        let mut see = |run: &SpilledRun, bytes: &[u8]| {
            let mut of_run = of_run.borrow_mut();
            let Some(values) = of_run.as_mut().filter(|_| run.values) else { return };
            if bytes.is_empty() {
                values.clear();
            }
            values.add_records(bytes.as_chunks().0.iter().map(|&bytes| Record(u64::from_ne_bytes(bytes))));
        };
        let path = self.leftover.path().to_path_buf();
        let mut take = |run: SpilledRun, cover: &[u8]| {
            let broken = || Error::input(&path, "journal", "it contradicts itself; start over without resuming");
            progress.add(run.values, cover, set, &mut begun)?.ok_or_else(broken)?;
            if let (Some(all), Some(of_run)) = (&mut progress.values, &*of_run.borrow())
                && run.values
            {
                all.merge(of_run);
            }
            runs.push(run);
            Ok(())
        };
        let spill = self.leftover.take_over(place, &mut look, &mut see, &mut take)?;
        progress.partial = begun.into_iter().map(|(chunk, begun)| (chunk, begun.pieces)).collect();
        let resumed = Resumed { points: progress.points, bytes: runs.iter().map(SpilledRun::bytes).sum() };
        Ok(TakenOver { spill, runs, progress, resumed })
    }
}

/// Runs of an earlier run, and the input they cover.
pub(super) struct TakenOver {
    pub spill: Spill,
    pub runs: Vec<SpilledRun>,
    pub progress: Progress,
    pub resumed: Resumed,
}

/// Input that need not be read again.
#[derive(Debug)]
pub(super) struct Progress {
    /// Chunks that are done, as ranges: first chunk and end.
    done: BTreeMap<u64, u64>,
    /// Covered points of other chunks, by point runs and by value runs: first and end, ascending.
    partial: BTreeMap<u64, [Vec<(u64, u64)>; 2]>,
    points: u64,
    /// True if values are needed; `values` holds the statistics of those in runs.
    wants_values: bool,
    pub values: Option<Values>,
    /// Results of the chunks that are done.
    pub read: Read,
    pub of_files: Vec<OfFile>,
}

/// Points of a chunk that runs cover: first and end, ascending.
#[derive(Clone, Copy)]
pub(super) struct Covered<'a> {
    pub matter: &'a [(u64, u64)],
    pub values: &'a [(u64, u64)],
}

/// State of a chunk while the journal is read.
#[derive(Default)]
struct Begun {
    /// Covered by point runs, and by value runs.
    pieces: [Vec<(u64, u64)>; 2],
    /// Number of its points, what was found in it, and the hash of what was read.
    result: Option<(u64, Read, u128)>,
    file: usize,
}

impl Progress {
    /// Creates the progress of a conversion that has read nothing.
    pub fn nothing(files: usize) -> Self {
        let (read, of_files) = (Read::NOTHING, vec![OfFile::NOTHING; files]);
        let (done, partial) = (BTreeMap::new(), BTreeMap::new());
        Self { done, partial, points: 0, wants_values: false, values: None, read, of_files }
    }

    pub fn is_done(&self, chunk: u64) -> bool {
        self.done.range(..=chunk).next_back().is_some_and(|(_, &end)| chunk < end)
    }

    /// Returns the points of a chunk that runs cover.
    pub fn of_chunk(&self, chunk: u64) -> Covered<'_> {
        let [matter, values] = match self.partial.get(&chunk) {
            Some(pieces) => pieces.each_ref().map(Vec::as_slice),
            None => [&[][..]; 2],
        };
        Covered { matter, values }
    }

    /// Adds what a point run or value run covers, after comparing it with the files; returns `None` if the journal
    /// contradicts itself.
    fn add(
        &mut self,
        values: bool,
        cover: &[u8],
        set: &InputSet,
        begun: &mut BTreeMap<u64, Begun>,
    ) -> Result<Option<()>> {
        let mut reader = ByteReader::new(cover, "");
        while !reader.is_empty() {
            let Some((chunk, piece, file, reads, result)) = parse_piece(&mut reader) else { return Ok(None) };
            let Some(scan) = set.files().get(file) else { return Ok(None) };
            if !reads.are_of(scan.path())? {
                return Err(changed_since(scan.path()));
            }
            let is_empty = piece.0 == piece.1;
            if self.is_done(chunk) {
                // A run that reads missing points or values of a chunk repeats the chunk's result.
                if is_empty {
                    continue;
                }
                return Ok(None);
            }
            let of_chunk = begun.entry(chunk).or_default();
            let pieces = &mut of_chunk.pieces[usize::from(values)];
            let at = pieces.partition_point(|other| other.0 < piece.0);
            let overlaps = |other: Option<&(u64, u64)>| other.is_some_and(|o| o.0 < piece.1 && piece.0 < o.1);
            let before = at.checked_sub(1).and_then(|before| pieces.get(before));
            if overlaps(before) || overlaps(pieces.get(at)) {
                return Ok(None);
            }
            if !is_empty {
                pieces.insert(at, piece);
            }
            self.points += if values { 0 } else { piece.1 - piece.0 };
            of_chunk.file = file;
            if let Some((read, hash)) = result {
                of_chunk.result = Some((piece.1, read, hash));
            }
            self.finish(chunk, begun, set);
        }
        Ok(Some(()))
    }

    /// Moves a chunk to those that are done, if it is covered completely.
    fn finish(&mut self, chunk: u64, begun: &mut BTreeMap<u64, Begun>, set: &InputSet) {
        let Some(Begun { pieces, result: Some((points, read, hash)), file }) = begun.get(&chunk) else { return };
        let is_whole = |pieces: &Vec<(u64, u64)>| pieces.iter().map(|piece| piece.1 - piece.0).sum::<u64>() == *points;
        if !is_whole(&pieces[0]) || self.wants_values && !is_whole(&pieces[1]) {
            return;
        }
        self.read.merge(read);
        self.of_files[*file].add(read);
        set.add_hash(*file, *hash);
        begun.remove(&chunk);
        let (mut first, mut end) = (chunk, chunk + 1);
        if let Some((&before, &its_end)) = self.done.range(..chunk).next_back()
            && its_end == chunk
        {
            first = before;
        }
        if let Some(its_end) = self.done.remove(&end) {
            end = its_end;
        }
        self.done.insert(first, end);
    }
}

/// Appends a decoder's log of its reads, in the form stored in a piece.
pub(super) fn put_reads(log: &ReadLog, out: &mut Vec<u8>) {
    let (file, Reads { sum, pieces }) = log.reads();
    out.extend((file as u64).to_le_bytes());
    out.extend(sum.to_le_bytes());
    pieces.iter().for_each(|(at, len)| out.extend([at.to_le_bytes(), len.to_le_bytes()].concat()));
}

type Piece = (u64, (u64, u64), usize, Reads, Option<(Read, u128)>);

/// Parses a piece: chunk, points, file, what was read, and the result.
fn parse_piece(reader: &mut ByteReader<'_>) -> Option<Piece> {
    let mut number = || reader.varint().ok();
    let (chunk, from, points) = (number()?, number()?, number()?);
    let noted = number()?;
    let mut noted = ByteReader::new(reader.take(usize::try_from(noted).ok()?).ok()?, "");
    let file = usize::try_from(noted.u64().ok()?).ok()?;
    let sum = u128::from_le_bytes(noted.array().ok()?);
    let mut pieces = Vec::new();
    while !noted.is_empty() {
        pieces.push((noted.u64().ok()?, noted.u64().ok()?));
    }
    let result = match reader.varint().ok()? {
        0 => None,
        len => Some(result_of(reader.take(usize::try_from(len - 1).ok()?).ok()?)?),
    };
    Some((chunk, (from, from.checked_add(points)?), file, Reads { sum, pieces }, result))
}

/// Returns the result of a chunk, and the hash of what was read of it, in the form stored in a piece.
pub(super) fn result_bytes(read: &Read, hash: u128) -> Vec<u8> {
    let counts = |counts: &PointCounts| {
        [counts.read, counts.withheld, counts.excluded, counts.not_finite, counts.missing]
            .map(u64::to_le_bytes)
            .concat()
    };
    let bounds = |min: &[f64; 3], max: &[f64; 3]| [*min, *max].concat().into_iter().flat_map(f64::to_le_bytes);
    let own = &read.own;
    let mut out = hash.to_le_bytes().to_vec();
    out.extend(counts(&read.counts));
    out.extend(bounds(&read.min, &read.max));
    out.extend(own.kept.to_le_bytes());
    out.extend(bounds(&own.min, &own.max));
    out.extend(counts(&own.left_out));
    out
}

fn result_of(bytes: &[u8]) -> Option<(Read, u128)> {
    let mut reader = ByteReader::new(bytes, "");
    let hash = u128::from_le_bytes(reader.array().ok()?);
    let mut read = Read::NOTHING;
    read.counts = counts_of(&mut reader)?;
    (read.min, read.max) = bounds_of(&mut reader)?;
    read.own.kept = reader.u64().ok()?;
    (read.own.min, read.own.max) = bounds_of(&mut reader)?;
    read.own.left_out = counts_of(&mut reader)?;
    Some((read, hash))
}

fn counts_of(reader: &mut ByteReader<'_>) -> Option<PointCounts> {
    let mut number = || reader.u64().ok();
    Some(PointCounts {
        read: number()?,
        withheld: number()?,
        excluded: number()?,
        not_finite: number()?,
        missing: number()?,
    })
}

fn bounds_of(reader: &mut ByteReader<'_>) -> Option<([f64; 3], [f64; 3])> {
    let mut corner = || Some([reader.f64().ok()?, reader.f64().ok()?, reader.f64().ok()?]);
    Some((corner()?, corner()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoMonitor;
    use crate::codec::put_varint;
    use crate::input::InputOptions;
    use scangen::{WriteSpec, write_las};

    /// Encodes one piece of a file's only chunk, with no bytes read.
    fn piece(from: u64, end: u64, result: Option<&[u8]>) -> Vec<u8> {
        let mut out = Vec::new();
        [0, from, end - from, 24].into_iter().for_each(|number| put_varint(&mut out, number));
        out.extend([0; 24]);
        put_varint(&mut out, result.map_or(0, |result| 1 + result.len() as u64));
        out.extend(result.unwrap_or_default());
        out
    }

    /// A run kept in memory is lost with its process, while the next run, which holds the end of the chunk and its
    /// result, was on disk. The run that reads the lost points repeats the result, after the chunk is complete.
    #[test]
    fn the_end_of_a_chunk_may_stand_before_its_beginning() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.las");
        write_las(&path, (0..100).map(|n| [f64::from(n), 0.0, 0.0]), &WriteSpec::for_path(&path)).unwrap();
        let set = InputSet::open(&[path], InputOptions { hash: true, ..InputOptions::default() }, &NoMonitor).unwrap();
        let found = PointCounts { read: 100, ..Read::NOTHING.counts };
        let result = result_bytes(&Read { counts: found, ..Read::NOTHING }, 7);
        let (end, again) =
            (piece(60, 100, Some(&result)), [piece(0, 60, None), piece(100, 100, Some(&result))].concat());
        for wants_values in [false, true] {
            let (mut progress, mut begun) = (Progress::nothing(1), BTreeMap::new());
            progress.wants_values = wants_values;
            let mut add = |values, cover: &[u8]| progress.add(values, cover, &set, &mut begun).unwrap();
            assert_eq!([add(false, &end), add(false, &again)], [Some(()); 2]);
            if wants_values {
                assert_eq!([add(true, &piece(60, 100, None)), add(true, &piece(0, 60, None))], [Some(()); 2]);
            }
            // Points that are already covered are a contradiction.
            assert_eq!(add(false, &piece(10, 20, None)), None);
            assert!(progress.is_done(0) && begun.is_empty());
            assert_eq!((progress.points, progress.read.counts), (100, found));
        }
    }

    #[test]
    fn pieces_that_contradict_the_scans_or_each_other_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.las");
        write_las(&path, (0..100).map(|n| [f64::from(n), 0.0, 0.0]), &WriteSpec::for_path(&path)).unwrap();
        let set = InputSet::open(&[path], InputOptions::default(), &NoMonitor).unwrap();
        let add = |cover: &[u8]| Progress::nothing(1).add(false, cover, &set, &mut BTreeMap::new()).unwrap();
        let good = piece(0, 60, None);
        assert_eq!(add(&good), Some(()));
        assert_eq!(add(&[&good[..], &piece(60, 80, None)].concat()), Some(()));
        assert_eq!(add(&[&good[..], &piece(59, 80, None)].concat()), None, "points covered twice");
        assert_eq!(add(&good[..good.len() - 1]), None, "cut");
        // The number of the file follows four numbers of one byte.
        let mut other = good.clone();
        other[4] = 1;
        assert_eq!(add(&other), None, "a file of another set");
    }

    #[test]
    fn other_versions_and_parts_are_refused_and_odd_heads_are_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.las");
        write_las(&path, [[0.0; 3]], &WriteSpec::for_path(&path)).unwrap();
        let set = InputSet::open(&[path], InputOptions::default(), &NoMonitor).unwrap();
        let plan = Plan::new(crate::frame::Frame::new(0.1, 0.3).unwrap());
        let options = ConvertOptions::new(Vec::new(), "a.slices".into());
        let shard = Shard { index: 1, count: 2, first: 0, last: 9, plan_file: 1 << 70 };
        let noise = Some(Noise { noise_m: 0.004, regions: 7, region_m: 0.25 });
        let identity = Identity::of(&options, &plan, Surveyed { spacing: None, noise }, Some(shard), &set);
        identity.check(&identity, &set).unwrap();
        for (earlier, words) in [
            (
                Identity { version: "0.0".into(), ..identity.clone() },
                "version 0.0 of this program began the conversion",
            ),
            (Identity { shard: None, ..identity.clone() }, "another part was begun"),
            (Identity { numbers: [2.0; 3], ..identity.clone() }, "other options"),
        ] {
            let error = identity.check(&earlier, &set).unwrap_err();
            assert!(matches!(error, Error::Parameter { what: Parameter::Resume, .. }), "{error}");
            assert!(error.to_string().contains(words), "{error}");
        }
        let head = identity.head(Path::new("a.slices"));
        let (target, fields) = Identity::split(&head).unwrap();
        assert_eq!((target, Identity::from_fields(&fields)), (&b"a.slices"[..], Some(identity)));
        // Spacing, shard and noise of another number of values, more fields, and fewer.
        let odd = [0u8; 16];
        for number in [2, 4, 6] {
            let mut fields = fields.clone();
            fields[number] = &odd;
            assert_eq!(Identity::from_fields(&fields), None, "{number}");
        }
        assert_eq!(Identity::from_fields(&[&fields[..], &[&odd[..]]].concat()), None);
        assert_eq!(Identity::from_fields(&fields[..5]), None);
    }
}
