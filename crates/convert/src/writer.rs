//! Writer for points that a program holds in memory: makes an archive batch by batch.

use super::conversion::Limits;
use super::pages::{Writing, write_archive};
use super::points::{Own, Read, bounds, out_of_reach};
use super::report::Report;
use super::upright::Turn;
use super::{ConvertOptions, HoleWidth, PixelSize, Resources};
use crate::archive::ArchiveWriter;
use crate::input::{FARTHEST_M, PointBatch, PointCounts};
use crate::mesh::MeshCounts;
use crate::output::{Existing, Output, OutputKind, Protected};
use crate::plan::Plan;
use crate::unit::LengthUnit;
use crate::voxel::record::Recorder;
use crate::voxel::runs::{RunBuilder, RunStore};
use crate::voxel::spill::SpillPlace;
use crate::{Error, Monitor, Parameter, Result};

/// Points of a batch examined together.
const PIECE: usize = 1 << 12;

/// Converts points in metres from memory, in batches of any size and order; the archive appears on
/// [`finish`](Self::finish). The result is byte for byte that of [`convert`](super::convert) for a file of the same
/// points in metres.
///
/// Memory: the budget of the options plus a constant, as for a conversion of files. Dropping the writer writes nothing.
///
/// ```
/// use slicewalk_convert::{ConvertOptions, PixelSize, PointWriter};
///
/// let folder = tempfile::tempdir()?;
/// let mut options = ConvertOptions::new(Vec::new(), folder.path().join("floor.slices"));
/// options.grid.pixel = PixelSize::Metres(0.1);
/// let mut writer = PointWriter::create(&options, "")?;
/// writer.push(&[0.05, 0.15, 0.25], &[0.05, 0.05, 0.05], &[0.0, 0.0, 0.0])?;
/// let report = writer.finish(&slicewalk::NoMonitor)?;
/// assert_eq!(report.header.voxels.occupied, 3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct PointWriter {
    options: ConvertOptions,
    plan: Plan,
    crs: String,
    recorder: Recorder,
    runs: RunBuilder,
    store: RunStore,
    output: ArchiveWriter,
    read: Read,
    piece: PointBatch,
}

impl PointWriter {
    /// Creates a writer of the archive `options.output` in the coordinate reference system `crs` (text as a scan would
    /// state it, or empty). The options must hold no inputs, no part and no unit, and the pixel size in metres.
    ///
    /// Fails for invalid options, and if the output must not be written.
    pub fn create(options: &ConvertOptions, crs: &str) -> Result<Self> {
        options.check()?;
        if options.plan.remove_moving {
            let reason = "points from memory have no stations; convert files to remove what moved";
            return Err(Error::parameter(Parameter::Stations, reason));
        }
        if options.sections.free_space {
            let reason = "points from memory have no stations; convert files to store which space they saw";
            return Err(Error::parameter(Parameter::Stations, reason));
        }
        if options.sections.colour != super::ColourMode::Off {
            let reason = "points from memory come without values for colours; convert files";
            return Err(Error::parameter(Parameter::Colour, reason));
        }
        let PixelSize::Metres(pixel_m) = options.grid.pixel else {
            let reason = "the pixel size cannot follow from points that are still to come; give it in metres";
            return Err(Error::parameter(Parameter::PixelSize, reason));
        };
        if options.reading.turn != Turn::None {
            let reason = "points that are not there yet have no floor; turn them by the placement";
            return Err(Error::parameter(Parameter::Other("up".into()), reason));
        }
        if options.grid.tolerance_auto {
            let reason = "the noise of points that are still to come is unknown; give the tolerance in metres";
            return Err(Error::parameter(Parameter::Tolerance, reason));
        }
        if options.grid.fill_holes == Some(HoleWidth::Auto) {
            let reason = "the spacing of points that are still to come is unknown; give the width in metres";
            return Err(Error::parameter(Parameter::FillHoles, reason));
        }
        let plan = options.plan_of(pixel_m)?;
        let kind = OutputKind::Archive(Existing::replaced_if(options.overwrite));
        let output = Output::create_by(&options.output, kind, Protected::default(), &options.resources.temp_dir)?;
        // Pushed points cannot be resumed: without a head, the next run removes what a kill leaves.
        let name = output.beside().file_name().unwrap_or_default().to_owned();
        let place = SpillPlace {
            files: output.files().clone(),
            folder: options.resources.temp_dir.clone(),
            name,
            head: Vec::new(),
        };
        let mut output = ArchiveWriter::on(output, &plan)?;
        if options.sections.levels {
            output.set_levels();
        }
        let recorder = Recorder::new(plan.frame);
        // Only one run is under construction at a time.
        let limits = Limits::for_threads(1, options);
        Ok(Self {
            runs: RunBuilder::new(recorder, limits.build_bytes),
            store: RunStore::new(limits.retain_bytes, place),
            options: options.clone(),
            crs: crs.to_owned(),
            read: Read::NOTHING,
            piece: PointBatch::default(),
            plan,
            recorder,
            output,
        })
    }

    /// Adds points (m). Points with a coordinate that is not finite or beyond 10¹² m are left out and counted.
    ///
    /// Fails if the lists differ in length, if a point lies beyond the reach of a grid of this pixel size, or if the
    /// temporary data cannot be written. Points added earlier stay, and more may be added.
    pub fn push(&mut self, x: &[f64], y: &[f64], z: &[f64]) -> Result<()> {
        if x.len() != y.len() || x.len() != z.len() {
            let reason = format!("{} x, {} y and {} z are no points", x.len(), y.len(), z.len());
            return Err(Error::parameter("points", reason));
        }
        let (up, placement) = (self.plan.options.up, self.options.reading.placement);
        for start in (0..x.len()).step_by(PIECE) {
            let range = start..(start + PIECE).min(x.len());
            self.piece.clear();
            for at in range.clone() {
                let point = up.turn([x[at], y[at], z[at]]);
                let point = placement.map_or(point, |placement| placement.apply(point));
                if point.iter().all(|v| v.abs() <= FARTHEST_M) {
                    self.piece.push(point);
                }
            }
            let (kept, all) = (self.piece.len() as u64, range.len() as u64);
            let (min, max) = bounds(&self.piece);
            if kept > 0 {
                if !self.recorder.reaches(min, max) {
                    return Err(out_of_reach(&self.plan.frame, min, max));
                }
                self.runs.push(&self.piece.x, &self.piece.y, &self.piece.z, &self.store)?;
            }
            let left_out = PointCounts { read: all - kept, not_finite: all - kept, ..Read::NOTHING.counts };
            let own = Own { kept, min, max, left_out };
            self.read.merge(&Read { min, max, own, ..Read::NOTHING });
        }
        Ok(())
    }

    /// Returns the number of points added, including those left out.
    pub fn points(&self) -> u64 {
        self.read.own.kept + self.read.own.left_out.read
    }

    /// Writes and publishes the archive. Fails if points were added, but none of them can be used: as for files, an empty
    /// archive must not take the place of a good one.
    pub fn finish(mut self, monitor: &dyn Monitor) -> Result<Report> {
        let left_out = self.read.own.left_out.not_finite;
        if left_out > 0 && self.read.own.kept == 0 {
            let reason = format!("none of {left_out} has a finite position within 1e12 m; check their coordinates");
            return Err(Error::parameter("points", reason));
        }
        self.runs.flush(&self.store)?;
        drop(self.runs);
        let (options, own) = (&self.options, &self.read.own);
        let Resources { memory_bytes, threads, ref temp_dir, ref accumulator } = options.resources;
        let accumulator = accumulator.as_deref();
        let writing = Writing { memory_bytes, threads, columns: None, views: None, temp_dir, accumulator };
        let left_out = write_archive(&self.plan, &self.store, writing, &mut self.output, None, monitor)?;
        if monitor.cancelled_at_last() {
            return Err(Error::Interrupted);
        }
        let units = vec![LengthUnit::METRE];
        Ok(Report {
            header: self.output.finish(own.totals(&self.crs, &units))?,
            shard: None,
            spacing: None,
            noise: None,
            up: None,
            placement: options.reading.placement,
            crs: self.crs,
            units,
            texts: Vec::new(),
            input_bytes: 0,
            resumed: None,
            temp_bytes: self.store.temp_bytes(),
            points_not_finite: own.left_out.not_finite,
            points_missing: 0,
            complete: true,
            splats: Default::default(),
            cubes: 0,
            triangles: MeshCounts::default(),
            points_made: 0,
            points_moving: 0,
            seen: None,
            voxels_dropped: left_out.voxels,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{NoMonitor, convert};
    use las::{Builder, Point, Writer};

    fn options(folder: &std::path::Path, name: &str) -> ConvertOptions {
        let mut options = ConvertOptions::new(Vec::new(), folder.join(name));
        options.grid.pixel = PixelSize::Metres(0.1);
        options.resources.memory_bytes = super::super::MIN_MEMORY_BYTES;
        options
    }

    fn points(count: usize) -> Vec<[f64; 3]> {
        let mut state = 7u64;
        let mut below = |most: u64| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) % most
        };
        // Whole millimetres, which a file with such a step holds exactly.
        (0..count).map(|_| [below(9000), below(7000), below(3000)].map(|mm| f64::from(mm as u32) * 0.001)).collect()
    }

    fn columns(points: &[[f64; 3]]) -> [Vec<f64>; 3] {
        [0, 1, 2].map(|axis| points.iter().map(|point| point[axis]).collect())
    }

    #[test]
    fn points_from_memory_make_the_bytes_that_a_file_of_them_makes() {
        let folder = tempfile::tempdir().unwrap();
        let points = points(30_000);
        let path = folder.path().join("scan.las");
        let mut writer = Writer::from_path(&path, Builder::from((1, 2)).into_header().unwrap()).unwrap();
        for &[x, y, z] in &points {
            writer.write_point(Point { x, y, z, ..Point::default() }).unwrap();
        }
        writer.close().unwrap();
        let mut of_file = options(folder.path(), "file.slices");
        of_file.inputs = vec![path];
        convert(&of_file, &NoMonitor).unwrap();
        let expected = std::fs::read(&of_file.output).unwrap();
        for batch in [1000, 4096, 30_000] {
            let of_memory = options(folder.path(), &format!("{batch}.slices"));
            let mut writer = PointWriter::create(&of_memory, "").unwrap();
            for points in points.rchunks(batch) {
                let [x, y, z] = columns(points);
                writer.push(&x, &y, &z).unwrap();
            }
            let report = writer.finish(&NoMonitor).unwrap();
            assert_eq!(report.header.points_kept, 30_000);
            assert!(std::fs::read(&of_memory.output).unwrap() == expected, "batches of {batch}");
        }
    }

    #[test]
    fn points_that_are_no_places_are_counted_and_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = PointWriter::create(&options(folder.path(), "a.slices"), "").unwrap();
        writer.push(&[0.0, f64::NAN, 1e13, 0.5], &[0.0; 4], &[0.0, 0.0, 0.0, f64::INFINITY]).unwrap();
        assert_eq!(writer.points(), 4);
        let report = writer.finish(&NoMonitor).unwrap();
        assert_eq!((report.header.points_kept, report.points_not_finite, report.header.points_read), (1, 3, 4));
    }

    #[test]
    fn points_of_which_none_is_a_place_replace_no_archive() {
        let folder = tempfile::tempdir().unwrap();
        let mut options = options(folder.path(), "a.slices");
        let empty = PointWriter::create(&options, "").unwrap().finish(&NoMonitor).unwrap();
        assert_eq!(empty.header.points_read, 0);
        let before = std::fs::read(&options.output).unwrap();
        options.overwrite = true;
        let mut writer = PointWriter::create(&options, "").unwrap();
        writer.push(&[f64::NAN, 1e13], &[0.0; 2], &[0.0; 2]).unwrap();
        let error = writer.finish(&NoMonitor).unwrap_err().to_string();
        assert!(error.contains("points: none of 2 has a finite position"), "{error}");
        assert!(std::fs::read(&options.output).unwrap() == before);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn more_points_than_the_budget_holds_go_to_disk() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = PointWriter::create(&options(folder.path(), "a.slices"), "").unwrap();
        let [x, y, z] = columns(&points(1 << 16));
        for _ in 0..(40 << 20) / (8 << 16) {
            writer.push(&x, &y, &z).unwrap();
        }
        assert!(writer.finish(&NoMonitor).unwrap().temp_bytes > 0);
    }

    #[test]
    fn a_writer_that_is_dropped_or_refused_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = PointWriter::create(&options(folder.path(), "a.slices"), "").unwrap();
        writer.push(&[0.0], &[0.0], &[0.0]).unwrap();
        assert!(writer.push(&[0.0], &[0.0], &[]).is_err());
        assert!(writer.push(&[0.0], &[1e11], &[0.0]).is_err(), "beyond the grid");
        drop(writer);
        let mut without_size = options(folder.path(), "b.slices");
        without_size.grid.pixel = PixelSize::Auto;
        assert!(PointWriter::create(&without_size, "").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn options_that_need_files_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |change: fn(&mut ConvertOptions)| {
            let mut options = options(folder.path(), "a.slices");
            change(&mut options);
            match PointWriter::create(&options, "") {
                Err(Error::Parameter { what, .. }) => what,
                other => panic!("{:?}", other.err()),
            }
        };
        assert_eq!(refused(|options| options.plan.remove_moving = true), Parameter::Stations);
        assert_eq!(refused(|options| options.sections.free_space = true), Parameter::Stations);
        assert_eq!(refused(|options| options.sections.colour = crate::ColourMode::Auto), Parameter::Colour);
        assert_eq!(refused(|options| options.grid.pixel = PixelSize::Auto), Parameter::PixelSize);
        assert_eq!(refused(|options| options.reading.turn = Turn::Auto), Parameter::Other("up".into()));
        assert_eq!(refused(|options| options.grid.tolerance_auto = true), Parameter::Tolerance);
        assert_eq!(refused(|options| options.grid.fill_holes = Some(HoleWidth::Auto)), Parameter::FillHoles);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    /// Monitor that cancels only when it is asked for the last time.
    struct AtLast;

    impl Monitor for AtLast {
        fn cancelled_at_last(&self) -> bool {
            true
        }
    }

    #[test]
    fn points_are_placed_and_a_stop_at_the_last_moment_writes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut options = options(folder.path(), "a.slices");
        options.reading.placement = Some(crate::Similarity::scaling(2.0));
        let written = |monitor: &dyn Monitor| {
            let mut writer = PointWriter::create(&options, "").unwrap();
            writer.push(&[0.5, 1.0], &[0.0, 2.0], &[1.5, -3.0]).unwrap();
            writer.finish(monitor)
        };
        assert!(matches!(written(&AtLast), Err(Error::Interrupted)));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let bounds = written(&NoMonitor).unwrap().header.bounds;
        assert_eq!(bounds, Some(([1.0, 0.0, -6.0], [2.0, 4.0, 3.0])));
    }
}
