//! Options of a conversion.

use super::plan_file::PlanFile;
use super::splats::SplatRules;
use super::upright::{Turn, UpFound};
use crate::colour::ColourSource;
use crate::input::{Columns, Units};
use crate::mesh::MeshMode;
use crate::placement::Similarity;
use crate::plan::PlanOptions;
use crate::text::number;
use crate::values::length;
use crate::voxel::accumulate::Accumulate;
use crate::{Error, MIN_MEMORY_BYTES, Parameter, Result};
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

/// Choice of the pixel size.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum PixelSize {
    /// Follows from the scans' own point spacing, or from the extent of the meshes if there is no scan (costs one more
    /// pass over the input).
    Auto,
    /// Given in metres.
    Metres(f64),
}

/// Parses the form of the command line: `auto`, or metres.
impl FromStr for PixelSize {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text.parse::<f64>() {
            _ if text == "auto" => Ok(Self::Auto),
            Ok(value) if value > 0.0 && value.is_finite() => Ok(Self::Metres(value)),
            _ => Err("expected auto, or a length in metres above 0".into()),
        }
    }
}

/// Choice of the tolerance to which heights are coarsened.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Tolerance {
    /// At most the scan's own noise (costs one more pass over the input).
    Auto,
    /// Given in metres.
    Metres(f64),
}

/// Parses the form of the command line: `auto`, or metres.
impl FromStr for Tolerance {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text.parse::<f64>() {
            _ if text == "auto" => Ok(Self::Auto),
            Ok(value) if value.is_finite() => Ok(Self::Metres(value)),
            _ => Err("expected auto, or a length in metres".into()),
        }
    }
}

/// Choice of the width of the holes to close.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum HoleWidth {
    /// Gaps between points: three times the scans' point spacing (costs one more pass over the input).
    Auto,
    /// Given in metres; rounded down to whole pixels, 1 to 45.
    Metres(f64),
}

/// Parses the form of the command line: `auto`, or metres.
impl FromStr for HoleWidth {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            _ => length(text).map(Self::Metres).map_err(|_| "expected auto, or a length in metres above 0".into()),
        }
    }
}

/// Choice of the point values that become colours of voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ColourMode {
    /// The archive has no colours.
    #[default]
    Off,
    /// RGB where the input has it, else intensity, else no colours. Values that are zero throughout count as missing.
    Auto,
    /// This source; an input without it is refused.
    Of(ColourSource),
}

impl ColourMode {
    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Auto => "auto",
            Self::Of(source) => source.name(),
        }
    }
}

/// Parses the form of the command line: `rgb`, `intensity`, `class`, `auto` or `off`.
impl FromStr for ColourMode {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let all = ColourSource::ALL.map(Self::Of).into_iter().chain([Self::Auto, Self::Off]);
        let found = all.into_iter().find(|mode| mode.name() == text);
        found.ok_or_else(|| "expected rgb, intensity, class, auto or off".into())
    }
}

/// How inputs are read and placed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ReadingOptions {
    /// Unit of the input.
    pub units: Units,
    /// Rotation of scans and splats upwards.
    pub turn: Turn,
    /// Placement of all inputs in metres, after their axes; `None` leaves them in place.
    pub placement: Option<Similarity>,
    /// EPSG code for scans that state no reference system; a scan that states another is refused.
    pub epsg: Option<u32>,
    /// Columns of text without a header of its own; x, y and z come first by default.
    pub columns: Option<Columns>,
    /// How meshes become voxels.
    pub mesh: MeshMode,
    /// How Gaussian splats become solid.
    pub splats: SplatRules,
}

/// Lengths that are given in metres or follow from the input.
#[derive(Debug, Clone)]
pub struct GridOptions {
    /// Pixel size `t`.
    pub pixel: PixelSize,
    /// Slice height `σ` (m); three pixel sizes by default (thesis, section 3.1.3).
    pub slice_m: Option<f64>,
    /// True if the tolerance follows from the scan's own noise, overriding that of the plan (costs one more pass over
    /// the input, shared with that for an automatic pixel size).
    pub tolerance_auto: bool,
    /// Width up to which holes in floors are closed by inferred floor. `None` uses the value of the plan, which by
    /// default closes no holes.
    pub fill_holes: Option<HoleWidth>,
}

impl Default for GridOptions {
    fn default() -> Self {
        Self { pixel: PixelSize::Auto, slice_m: None, tolerance_auto: false, fill_holes: None }
    }
}

/// Optional sections of the archive.
#[derive(Debug, Clone)]
pub struct SectionOptions {
    /// True if the archive gets overview levels (see [`Level`](crate::archive::Level)); off by default.
    pub levels: bool,
    /// Source of the colours of voxels; off by default.
    pub colour: ColourMode,
    /// Greatest mean difference of a page's colours from the means of the points (ΔE*ab of CIELAB, 0 to 65.535); 0 is
    /// exact to 8 bits. The default is visible side by side, if at all.
    pub colour_error: f64,
    /// True if the archive also stores which space the stations saw (see [`seen`](slicewalk::seen)); off by default.
    pub free_space: bool,
}

impl Default for SectionOptions {
    fn default() -> Self {
        Self { levels: false, colour: ColourMode::Off, colour_error: 2.0, free_space: false }
    }
}

/// Memory, threads and temporary folder of a conversion.
#[derive(Debug, Clone)]
pub struct Resources {
    /// Memory budget (bytes, at least 64 MiB).
    pub memory_bytes: u64,
    /// Worker threads (at least 1).
    pub threads: usize,
    /// Folder for temporary data.
    pub temp_dir: PathBuf,
    /// Accumulator of points to use in place of this crate's.
    #[doc(hidden)]
    pub accumulator: Option<Arc<dyn Accumulate>>,
}

impl Default for Resources {
    fn default() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        Self { memory_bytes: 512 << 20, threads, temp_dir: crate::disk::temp_dir(), accumulator: None }
    }
}

/// Options of a conversion. The README shows the command line that sets them.
#[derive(Debug, Clone)]
pub struct ConvertOptions {
    /// Files, folders and glob patterns.
    pub inputs: Vec<PathBuf>,
    /// How inputs are read and placed.
    pub reading: ReadingOptions,
    /// True if input that is only partly readable is converted with warnings instead of being refused.
    pub allow_incomplete: bool,
    /// Table of scanner positions with the columns `file,x,y,z` (also `source_id`, or `t` for paths by GPS time).
    /// Needed for [`free_space`](SectionOptions::free_space), or if the plan removes moving points, and a scan does not
    /// state its station, as E57 and PTX do.
    pub stations: Option<PathBuf>,
    /// Lengths that are given or follow from the input.
    pub grid: GridOptions,
    /// Other options that decide the content of the archive.
    pub plan: PlanOptions,
    /// Optional sections of the archive.
    pub sections: SectionOptions,
    /// The archive to write.
    pub output: PathBuf,
    /// True if an existing slice archive may be replaced; any other file never is.
    pub overwrite: bool,
    /// File for the points that were removed as moving, as LAS.
    pub removed: Option<PathBuf>,
    /// Memory, threads and temporary folder.
    pub resources: Resources,
    /// Plan file of this conversion, already applied to these options ([`PlanFile::apply_to`]); inputs other than its
    /// own are refused.
    pub plan_file: Option<PlanFile>,
    /// Part to convert; `None` for the whole.
    pub shard: Option<ShardOptions>,
    /// True to continue from the temporary data that an earlier run of the same conversion left in
    /// [`temp_dir`](Resources::temp_dir), and to keep such data if this run fails. Without such data the conversion
    /// starts from the beginning.
    pub resume: bool,
}

impl ConvertOptions {
    /// Sets the tolerance to which heights are coarsened.
    pub fn set_tolerance(&mut self, tolerance: Tolerance) {
        (self.grid.tolerance_auto, self.plan.tolerance_m) = match tolerance {
            Tolerance::Auto => (true, 0.0),
            Tolerance::Metres(tolerance_m) => (false, tolerance_m),
        };
    }

    /// Returns the placement of all inputs, the rotation upwards included, if `up` is the direction that the input shows.
    pub fn placement_with(&self, up: Option<&UpFound>) -> Option<Similarity> {
        let turn = match self.reading.turn {
            Turn::None => None,
            Turn::From(up) => Some(Similarity::raising(up)),
            Turn::Auto => up.map(UpFound::turn),
        };
        match (self.reading.placement, turn.filter(|turn| *turn != Similarity::IDENTITY)) {
            (Some(placement), Some(turn)) => Some(placement * turn),
            (placement, turn) => placement.or(turn),
        }
    }

    /// Returns whether the positions of scanners change the archive.
    pub fn needs_stations(&self) -> bool {
        self.plan.remove_moving || self.sections.free_space
    }

    pub(super) fn check(&self) -> Result<()> {
        if self.resources.memory_bytes < MIN_MEMORY_BYTES {
            let reason =
                format!("{} bytes are too few; give at least {MIN_MEMORY_BYTES} (64MiB)", self.resources.memory_bytes);
            return Err(Error::parameter(Parameter::Memory, reason));
        }
        if self.resources.threads == 0 {
            return Err(Error::parameter(Parameter::Threads, "0 do no work; give at least 1"));
        }
        if let Some(HoleWidth::Metres(widest_m)) = self.grid.fill_holes
            && !(widest_m > 0.0 && widest_m.is_finite())
        {
            let reason = format!("{} is not a width of holes in metres; give a length above 0", number(widest_m));
            return Err(Error::parameter(Parameter::FillHoles, reason));
        }
        if self.stations.is_some() && !self.needs_stations() {
            let reason = "a table of stations changes nothing unless moving points are removed or seen space is stored";
            return Err(Error::parameter(Parameter::Stations, reason));
        }
        if self.resume && crate::bytes::address(&self.output).is_some() {
            let reason = "an archive at an address cannot be resumed; leave it out, or write a file";
            return Err(Error::parameter(Parameter::Resume, reason));
        }
        self.check_colour()?;
        self.reading.splats.check()?;
        self.plan.check()
    }

    /// Creates the defaults of the command line for these inputs and this output.
    pub fn new(inputs: Vec<PathBuf>, output: PathBuf) -> Self {
        Self {
            inputs,
            reading: ReadingOptions::default(),
            allow_incomplete: false,
            stations: None,
            grid: GridOptions::default(),
            plan: PlanOptions::default(),
            sections: SectionOptions::default(),
            output,
            overwrite: false,
            removed: None,
            resources: Resources::default(),
            plan_file: None,
            shard: None,
            resume: false,
        }
    }
}

/// Part of a conversion. Without a [`plan_file`](ConvertOptions::plan_file), every part computes the same plan from the
/// inputs.
#[derive(Debug, Clone, Copy)]
pub struct ShardOptions {
    /// Number of this part (1..=count).
    pub index: u32,
    /// Number of parts (1..=65536).
    pub count: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Error, NoMonitor, Parameter, convert};

    #[test]
    fn options_that_do_no_work_are_refused_by_name() {
        let refused = |change: fn(&mut ConvertOptions)| {
            let mut options = ConvertOptions::new(vec!["none.las".into()], "none.slices".into());
            change(&mut options);
            match convert(&options, &NoMonitor) {
                Err(Error::Parameter { what, .. }) => what,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(refused(|options| options.resources.threads = 0), Parameter::Threads);
        assert_eq!(refused(|options| options.resources.memory_bytes = 0), Parameter::Memory);
        assert_eq!(refused(|options| options.plan.min_points = 0), Parameter::MinPoints);
        assert_eq!(refused(|options| options.grid.fill_holes = Some(HoleWidth::Metres(0.0))), Parameter::FillHoles);
        assert_eq!(
            refused(|options| options.grid.fill_holes = Some(HoleWidth::Metres(f64::NAN))),
            Parameter::FillHoles
        );
        assert_eq!(refused(|options| options.stations = Some("s.csv".into())), Parameter::Stations);
        assert_eq!(refused(|options| options.reading.splats.opacity = 0.0), Parameter::Splats("opacity"));
        assert_eq!(refused(|options| options.reading.splats.min_opacity = 1.5), Parameter::Splats("least opacity"));
        assert_eq!(
            refused(|options| options.reading.splats.max_size_m = Some(0.0)),
            Parameter::Splats("greatest size")
        );
        let at_an_address = |options: &mut ConvertOptions| {
            options.resume = true;
            options.output = "https://example.org/a.slices".into();
        };
        assert_eq!(refused(at_an_address), Parameter::Resume);
    }

    #[test]
    fn a_placement_moves_what_is_turned_upwards_before() {
        let mut options = ConvertOptions::new(vec!["none.las".into()], "none.slices".into());
        options.reading.turn = Turn::From([1.0, 0.0, 0.0]);
        options.reading.placement = Some(Similarity::parse("1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1").unwrap());
        let placed = options.placement_with(None).unwrap().apply([2.0, 0.0, 0.0]);
        assert!(
            placed.iter().zip([5.0, 6.0, 9.0]).all(|(found, expected)| (found - expected).abs() < 1e-12),
            "{placed:?}"
        );
    }
}
