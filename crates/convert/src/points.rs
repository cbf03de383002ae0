//! First pass over scans: writes points into runs.

use super::colours::Values;
use super::resume::{Progress, put_reads, result_bytes};
use super::stations::Measured;
use super::work::{FirstPass, StopFlag};
use crate::archive::Totals;
use crate::colour::ColourSource;
use crate::frame::Frame;
use crate::input::scenes::Scene;
use crate::input::{InputSet, PointBatch, PointChunk, PointCounts, PointDecoder, ScanFile};
use crate::unit::LengthUnit;
use crate::voxel::colours::values_of;
use crate::voxel::record::Recorder;
use crate::voxel::visibility::Views;
use crate::{Error, Monitor, Parameter, Result};
use std::ops::Range;
use std::sync::Mutex;

/// Result of the first pass, independent of the order of points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Read {
    /// All points read.
    pub counts: PointCounts,
    /// Bounds of all kept points.
    pub min: [f64; 3],
    pub max: [f64; 3],
    pub own: Own,
}

/// Bounds and counts of one file.
#[derive(Debug, Clone, Copy)]
pub(super) struct OfFile {
    min: [f64; 3],
    max: [f64; 3],
    kept: u64,
    left_out: u64,
}

impl OfFile {
    pub const NOTHING: Self = Self { min: Read::NOTHING.min, max: Read::NOTHING.max, kept: 0, left_out: 0 };

    pub fn add(&mut self, read: &Read) {
        join(&mut self.min, &mut self.max, (&read.min, &read.max));
        self.kept += read.counts.kept();
        self.left_out += read.counts.read - read.counts.kept() + read.counts.missing;
    }
}

/// Points that count in the archive: all of them, or in a part those that count in no other part.
#[derive(Debug, Clone, Copy)]
pub(super) struct Own {
    pub kept: u64,
    pub min: [f64; 3],
    pub max: [f64; 3],
    /// Points that make no voxel.
    pub left_out: PointCounts,
}

impl Own {
    /// Returns the totals that an archive of these points states.
    pub fn totals(&self, crs: &str, units: &[LengthUnit]) -> Totals {
        Totals {
            points_read: self.kept + self.left_out.read,
            points_kept: self.kept,
            points_withheld: self.left_out.withheld,
            points_excluded: self.left_out.excluded,
            bounds: (self.min[0] <= self.max[0]).then_some((self.min, self.max)),
            crs: crs.to_owned(),
            units: units.to_vec(),
            noise: None,
        }
    }
}

impl Read {
    pub const NOTHING: Self = {
        let none = PointCounts { read: 0, withheld: 0, excluded: 0, not_finite: 0, missing: 0 };
        let (min, max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        Self { counts: none, min, max, own: Own { kept: 0, min, max, left_out: none } }
    };

    pub fn merge(&mut self, other: &Self) {
        self.counts += other.counts;
        self.own.kept += other.own.kept;
        self.own.left_out += other.own.left_out;
        join(&mut self.min, &mut self.max, (&other.min, &other.max));
        join(&mut self.own.min, &mut self.own.max, (&other.own.min, &other.own.max));
    }
}

/// Extends bounds to contain others.
fn join(min: &mut [f64; 3], max: &mut [f64; 3], other: (&[f64; 3], &[f64; 3])) {
    for axis in 0..3 {
        min[axis] = min[axis].min(other.0[axis]);
        max[axis] = max[axis].max(other.1[axis]);
    }
}

/// Settings of the first pass over scans.
#[derive(Clone, Copy)]
pub(super) struct Reading<'a> {
    /// Points that existing runs cover.
    pub progress: &'a Progress,
    /// True if runs record which input they cover.
    pub notes: bool,
    /// Views of the stations, to be filled.
    pub seeing: Option<&'a Seeing>,
    /// Source of the values that become colours.
    pub source: Option<ColourSource>,
}

/// Views of the stations, and the station that measured the points of each cloud of each file.
pub(super) struct Seeing {
    pub views: Views,
    pub of_cloud: Vec<Vec<Measured>>,
    /// True if points that other stations saw through are removed.
    pub removes: bool,
}

impl Seeing {
    /// Adds the points of a batch of a file; fails for points whose station is not known.
    fn add(&self, batch: &PointBatch, file: &ScanFile, of_cloud: &[Measured]) -> Result<()> {
        let add = |station: usize, points: Range<usize>| {
            self.views.add(station, [&batch.x[points.clone()], &batch.y[points.clone()], &batch.z[points]]);
        };
        match &of_cloud[batch.cloud] {
            Measured::From(station) => add(*station, 0..batch.len()),
            by_tag => {
                // Points of one station usually follow each other.
                let (mut begin, mut of_run) = (0, None);
                for (number, &tag) in batch.tags.iter().enumerate().take(batch.len()) {
                    let station = by_tag.station(tag).map_err(|reason| Error::input(file.path(), "points", reason))?;
                    if let Some(other) = of_run.filter(|other| *other != station) {
                        add(other, begin..number);
                        begin = number;
                    }
                    of_run = Some(station);
                }
                if let Some(station) = of_run {
                    add(station, begin..batch.len());
                }
            }
        }
        Ok(())
    }
}

/// First pass: writes all points, or those that a part needs, into runs. Also returns what each file holds, and the
/// statistics of the values.
pub(super) fn read_points(
    pass: FirstPass<'_>,
    set: &InputSet,
    reading: Reading<'_>,
) -> Result<(Read, Vec<OfFile>, Option<Values>)> {
    let FirstPass { plan, scope, store, monitor, .. } = pass;
    let Reading { progress, notes, seeing, source } = reading;
    monitor.stage("reading points", set.points_stated(), "points");
    monitor.advance(progress.read.counts.read);
    let recorder = Recorder::new(plan.frame);
    let is_needed = |chunk: &PointChunk, number: u64| {
        scope.is_none_or(|scope| scope.reads(chunk.file())) && !progress.is_done(number)
    };
    // Stations see with all points, including those of other parts or of earlier runs.
    let needed = set.chunks().zip(0u64..).filter(|(chunk, number)| seeing.is_some() || is_needed(chunk, *number));
    let chunks = Mutex::new(needed);
    let next_chunk = || chunks.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next();
    let flag = StopFlag::new(monitor);
    let of_files = Mutex::new(progress.of_files.clone());
    let work = || -> Result<(Read, Option<Values>)> {
        let mut decoder = PointDecoder::new();
        let mut builder = pass.runs();
        // If points are removed, each value follows its point's record, so that it is removed with the point.
        let removes = seeing.is_some_and(|seeing| seeing.removes);
        let mut values = source.map(|source| (source, Values::new(source), pass.values(removes)));
        if notes {
            let log = decoder.log();
            builder = builder.covering(move |out| put_reads(&log, out));
            let log = decoder.log();
            values = values
                .map(|(source, found, builder)| (source, found, builder.covering(move |out| put_reads(&log, out))));
        }
        let mut read = Read::NOTHING;
        let mut looking = PointDecoder::new();
        while let Some((chunk, number)) = next_chunk() {
            if let Some(seeing) = seeing.filter(|_| !is_needed(&chunk, number)) {
                looking.decode(set, &chunk, &mut |batch| match flag.is_raised() {
                    true => Err(Error::Interrupted),
                    false => seeing.add(batch, &set.files()[chunk.file()], &seeing.of_cloud[chunk.file()]),
                })?;
                continue;
            }
            let mut of_chunk = Read::NOTHING;
            let (covered, mut at) = (progress.of_chunk(number), 0);
            builder.begin_chunk(number);
            values.iter_mut().for_each(|(_, _, builder)| builder.begin_chunk(number));
            of_chunk.counts = decoder.decode(set, &chunk, &mut |batch| {
                // A chunk may be a whole file, so checking once per chunk would be too rare.
                if flag.is_raised() {
                    return Err(Error::Interrupted);
                }
                if batch.is_empty() {
                    return Ok(());
                }
                monitor.advance(batch.len() as u64);
                let (min, max) = bounds(batch);
                if !recorder.reaches(min, max) {
                    return Err(out_of_reach(&plan.frame, min, max));
                }
                if let Some(seeing) = seeing {
                    seeing.add(batch, &set.files()[chunk.file()], &seeing.of_cloud[chunk.file()])?;
                }
                let (kept, own_min, own_max) = match scope {
                    Some(scope) => {
                        scope.check_bounds(&set.files()[chunk.file()], chunk.file(), min, max)?;
                        scope.own(batch)
                    }
                    None => (batch.len() as u64, min, max),
                };
                let own = Own { kept, min: own_min, max: own_max, ..Read::NOTHING.own };
                of_chunk.merge(&Read { min, max, own, ..Read::NOTHING });
                let begin = at;
                at += batch.len() as u64;
                let number_of_points = begin..at;
                missing(number_of_points.clone(), covered.matter, |what| match what {
                    Missing::Not(points) => {
                        builder.pass(points);
                        Ok(())
                    }
                    Missing::Points(range) => {
                        builder.push(&batch.x[range.clone()], &batch.y[range.clone()], &batch.z[range], store)
                    }
                })?;
                let Some((source, found, builder)) = &mut values else { return Ok(()) };
                missing(number_of_points, covered.values, |what| match what {
                    Missing::Not(points) => {
                        builder.pass(points);
                        Ok(())
                    }
                    Missing::Points(range) if batch.values.is_empty() => {
                        builder.without_records(range.len() as u64);
                        Ok(())
                    }
                    Missing::Points(range) => {
                        let own = &batch.values[range.clone()];
                        found.add(own);
                        let points = [&batch.x[range.clone()], &batch.y[range.clone()], &batch.z[range]];
                        builder.push_values(points, |number| values_of(*source, own[number]), store)
                    }
                })
            })?;
            if scope.is_none_or(|scope| scope.owns(chunk.file())) {
                of_chunk.own.left_out = of_chunk.counts;
                of_chunk.own.left_out.read -= of_chunk.counts.kept();
            }
            monitor.advance(of_chunk.counts.read - of_chunk.counts.kept());
            // A chunk with diagnostics gets no result, so that the run that reads it again reports them.
            let result = (notes && !decoder.has_lost()).then(|| result_bytes(&of_chunk, decoder.log().hash()));
            builder.end_chunk(result.as_deref());
            values.iter_mut().for_each(|(_, _, builder)| builder.end_chunk(None));
            read.merge(&of_chunk);
            of_files.lock().unwrap_or_else(std::sync::PoisonError::into_inner)[chunk.file()].add(&of_chunk);
        }
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        builder.flush(store)?;
        let values = values.map(|(_, found, mut builder)| builder.flush(store).map(|()| found)).transpose()?;
        Ok((read, values))
    };
    let (mut all, mut values) = (progress.read, progress.values.clone());
    for (read, of_worker) in pass.on_threads(&flag, work)? {
        all.merge(&read);
        match (&mut values, of_worker) {
            (Some(values), Some(more)) => values.merge(&more),
            (none, more) => *none = more,
        }
    }
    let of_files = of_files.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    warn_of_bounds(set, &of_files, monitor);
    set.warn_of_coarse_floats(plan.frame.pixel_m(), monitor);
    Ok((all, of_files, values))
}

/// Section of a batch.
enum Missing {
    /// Points to add to runs.
    Points(Range<usize>),
    /// Number of points that other runs cover already.
    Not(u64),
}

/// Passes the sections of a batch with these point numbers to `take` in order, split by what is `covered`.
fn missing(numbers: Range<u64>, covered: &[(u64, u64)], mut take: impl FnMut(Missing) -> Result<()>) -> Result<()> {
    let Range { start: begin, end } = numbers;
    let mut next = begin;
    let points = |from: u64, to: u64| Missing::Points((from - begin) as usize..(to - begin) as usize);
    for &(first, last) in covered.iter().filter(|piece| piece.0 < end && begin < piece.1) {
        let (first, last) = (first.max(begin), last.min(end));
        take(points(next, first))?;
        take(Missing::Not(last - first))?;
        next = last;
    }
    take(points(next, end))
}

/// Returns the files that have points, with their bounds.
pub(super) fn scenes<'a>(set: &'a InputSet, of_files: &'a [OfFile]) -> impl Iterator<Item = Scene<'a>> {
    let files = set.files().iter().zip(of_files).filter(|(_, found)| found.kept > 0);
    files.map(|(file, found)| Scene { path: file.path(), min: found.min, max: found.max })
}

/// Warns once if headers state bounds that do not match the points: the archive has the bounds of the points, and a
/// user who compares the two should know which ones are wrong.
fn warn_of_bounds(set: &InputSet, of_files: &[OfFile], monitor: &dyn Monitor) {
    // The points left out may have been at the corners, so the stated box may be larger.
    let disagrees = |(file, found): &(&ScanFile, &OfFile)| {
        found.kept > 0 && file.bounds_disagree(found.min, found.max, found.left_out == 0)
    };
    let mut found = set.files().iter().zip(of_files).filter(disagrees);
    if let Some((file, read)) = found.next() {
        let others = match found.count() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let text = format!(
            "{}{others}: the bounds in the header are not those of the points; using the latter: {:?} to {:?}",
            file.path().display(),
            read.min,
            read.max
        );
        monitor.warn(&text.into());
    }
}

/// Returns the least and greatest coordinates of points.
pub(super) fn bounds(points: &PointBatch) -> ([f64; 3], [f64; 3]) {
    let along = [&points.x, &points.y, &points.z].map(|values| range(values));
    (along.map(|ends| ends.0), along.map(|ends| ends.1))
}

/// Returns the least and greatest value, in lanes that compile to vector instructions.
fn range(values: &[f64]) -> (f64, f64) {
    let (mut min, mut max) = ([f64::INFINITY; 8], [f64::NEG_INFINITY; 8]);
    let (chunks, rest) = values.as_chunks::<8>();
    for chunk in chunks {
        for lane in 0..8 {
            min[lane] = if chunk[lane] < min[lane] { chunk[lane] } else { min[lane] };
            max[lane] = if chunk[lane] > max[lane] { chunk[lane] } else { max[lane] };
        }
    }
    let min = min.iter().chain(rest).fold(f64::INFINITY, |a, &b| a.min(b));
    let max = max.iter().chain(rest).fold(f64::NEG_INFINITY, |a, &b| a.max(b));
    (min, max)
}

pub(super) fn out_of_reach(frame: &Frame, min: [f64; 3], max: [f64; 3]) -> Error {
    let reach = frame.pixel_m().min(frame.slice_m()) * crate::frame::MAX_INDEX as f64;
    let what = "coordinates that a grid of this pixel size reaches (m)";
    Error::limit(what, format!("{min:?} to {max:?}"), format!("±{reach}")).with_suggestion(Parameter::PixelSize)
}
