//! Conversion of a scan in parts, on several machines or in turn.
//!
//! A plan file fixes a conversion in advance: grid, options, unit and inputs. It is cut into parts by tile columns:
//! part `k` of `n` has a range of columns in archive order, balanced by the bounds and point counts that headers state.
//! A voxel depends on points up to one pixel beyond its column, and the first pass gives each column copies of those
//! points. So a part that keeps the records of its own columns, and no others, makes the same pages as a single run.
//!
//! Each point counts in one part: a kept point in the part of its column, any other in the part that *owns* its file,
//! the first that needs it. A part reads the files whose stated bounds meet its columns. Bounds may lie, so the owner,
//! which reads its file whole, fails if a point lies outside of them: no point is lost unnoticed. Every part reads the
//! meshes and splats; their triangles and splats count in the first part, and their bounds in all.
//!
//! A file that changes between two parts would be in the whole in two versions. The plan knows files by samples of
//! their bytes. In addition, each part records a hash of all that it read of files that other parts read too, computed
//! while decoding, and the merge compares these hashes.

mod json;

pub(super) use json::{bounds, hex};

use super::facts::InputFacts;
use super::inputs::open_inputs;
use super::options::{ColourMode, ConvertOptions, GridOptions, HoleWidth, PixelSize, ReadingOptions};
use super::planning::{self, Surveyed};
use super::splats::SplatRules;
use super::split::split;
use super::upright::{Turn, UpFound};
use crate::archive::{MAX_SHARDS, Shard};
use crate::colour::{ColourPlan, ColourScale};
use crate::input::scenes::{Scene, far_apart};
use crate::input::{ScanFile, Units};
use crate::mesh::MeshMode;
use crate::plan::{Noise, Plan};
use crate::unit::LengthUnit;
use crate::{Error, Monitor, Parameter, Result};
use std::collections::HashMap;
use xxhash_rust::xxh3::xxh3_128;

/// Conversion fixed before any point is converted. The machines that convert its parts read it from a JSON file.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanFile {
    /// Grid and options.
    pub plan: Plan,
    /// How inputs are read and placed; the placement includes the rotation upwards.
    pub reading: ReadingOptions,
    /// True if the parts and the whole get overview levels.
    pub levels: bool,
    /// True if the parts and the whole hold which space was seen; else the options of each part decide.
    pub free_space: bool,
    /// Colour plan for all points of the inputs; `None` without colours.
    pub colour: Option<ColourPlan>,
    /// Measured point spacing, if the pixel size follows from it (m).
    pub spacing_m: Option<f64>,
    /// Direction that points up, if the inputs showed it.
    pub up: Option<UpFound>,
    /// Noise of the scan, if the tolerance follows from it.
    pub noise: Option<Noise>,
    /// Statements of the headers of all inputs together.
    pub stated: Stated,
    /// Inputs in order of their fingerprints, which is the same on every machine.
    pub inputs: Vec<InputFacts>,
}

/// Statements of the headers of all inputs together.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Stated {
    /// Reference system of the inputs, or that of the options.
    pub crs: Option<String>,
    /// Distinct units of the inputs.
    pub units: Vec<LengthUnit>,
}

impl PlanFile {
    /// Makes the plan file for `options`. Cost: reads headers; reads all points once if pixel size or tolerance follows
    /// from them, files whose headers state no bounds once more for these, and all files once more for the range of
    /// colours.
    pub fn new(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Self> {
        let mut inputs = open_inputs(options, monitor)?;
        if let Some(path) = inputs.cubes.inputs().next() {
            let reason = format!("{}: cubes are converted in one run, without a plan", path.display());
            return Err(Error::parameter(crate::Parameter::Plan, reason));
        }
        let (plan, Surveyed { spacing, noise }) = planning::plan(options, &inputs, None, monitor)?;
        let found = super::colours::source_of(options, &mut inputs, monitor)?;
        let set = &mut inputs.scans;
        let scale =
            found.map(|found| super::colours::measure(set, found, options.resources.threads, monitor)).transpose()?;
        let colour = scale.map(|scale| options.colour_plan(scale));
        let scenes: Vec<Scene> = inputs.scans.files().iter().filter_map(ScanFile::scene_stated).collect();
        far_apart(&scenes).inspect(|warning| monitor.warn(warning));
        let stated = Stated { crs: inputs.scans.crs().map(str::to_owned), units: inputs.length_units() };
        let facts = InputFacts::measured((&inputs.scans, &inputs.splats), options.resources.threads, monitor)?;
        let file = Self::of(facts, plan, options);
        let reading = ReadingOptions { placement: inputs.placement, ..file.reading };
        let spacing_m = spacing.map(|spacing| spacing.spacing_m);
        Ok(Self { reading, colour, spacing_m, up: inputs.up, noise, stated, ..file })
    }

    pub(super) fn of(inputs: Vec<InputFacts>, plan: Plan, options: &ConvertOptions) -> Self {
        let mut file = Self {
            plan,
            reading: ReadingOptions { turn: Turn::None, ..options.reading.clone() },
            levels: options.sections.levels,
            free_space: options.sections.free_space,
            colour: None,
            spacing_m: None,
            up: None,
            noise: None,
            stated: Stated::default(),
            inputs,
        };
        file.sort_inputs();
        file
    }

    /// Returns the number of the first input with this fingerprint.
    pub(super) fn number_of(&self, fingerprint: u128) -> usize {
        self.inputs.partition_point(|input| input.fingerprint < fingerprint)
    }

    /// Sorts the inputs into the order that does not depend on their paths.
    pub fn sort_inputs(&mut self) {
        self.inputs.sort_by(|a, b| (a.fingerprint, &a.name).cmp(&(b.fingerprint, &b.name)));
    }

    /// Returns the identity of the plan file: a hash of everything that decides the content of its parts.
    pub fn hash(&self) -> u128 {
        let mut bytes = self.plan.hash().to_le_bytes().to_vec();
        let unit = match self.reading.units {
            Units::Auto => 0.0,
            Units::Factor(factor) => factor,
        };
        let mesh = match self.reading.mesh {
            MeshMode::Exact => -1.0,
            MeshMode::Sampled { step_m } => step_m.unwrap_or(0.0),
        };
        bytes.extend([unit, mesh].map(f64::to_le_bytes).concat());
        bytes.extend(self.reading.epsg.into_iter().flat_map(u32::to_le_bytes));
        bytes.extend(self.reading.columns.into_iter().flat_map(|columns| columns.to_string().into_bytes()));
        if let Some(ColourPlan { scale: ColourScale { source, low, high }, error_milli }) = self.colour {
            bytes.extend(source.name().as_bytes());
            bytes.extend([low, high, error_milli].map(u16::to_le_bytes).concat());
        }
        bytes.extend(self.reading.placement.iter().flat_map(|placement| placement.matrix()).flat_map(f64::to_le_bytes));
        if self.reading.splats != SplatRules::default() {
            let SplatRules { opacity, min_opacity, max_size_m } = self.reading.splats;
            bytes.extend([opacity, min_opacity, max_size_m.unwrap_or(f64::INFINITY)].map(f64::to_le_bytes).concat());
        }
        for input in &self.inputs {
            bytes.extend(input.fingerprint.to_le_bytes());
            bytes.extend(input.points.to_le_bytes());
            let bounds = input.bounds.map(|bounds| [bounds.min, bounds.max].concat());
            bytes.push(u8::from(bounds.is_some()));
            bounds.into_iter().flatten().for_each(|value| bytes.extend((value + 0.0).to_le_bytes()));
        }
        xxh3_128(&bytes)
    }

    /// Sets the options that the plan file fixes.
    pub fn apply_to(&self, options: &mut ConvertOptions) {
        options.grid = GridOptions {
            pixel: PixelSize::Metres(self.plan.frame.pixel_m()),
            slice_m: Some(self.plan.frame.slice_m()),
            ..GridOptions::default()
        };
        options.plan = self.plan.options.clone();
        options.reading = self.reading.clone();
        options.sections.levels = self.levels;
        options.sections.free_space |= self.free_space;
        options.sections.colour = self.colour_mode();
        if let Some(plan) = self.colour {
            options.sections.colour_error = f64::from(plan.error_milli) / 1000.0;
        }
    }

    fn colour_mode(&self) -> ColourMode {
        self.colour.map_or(ColourMode::Off, |plan| ColourMode::Of(plan.scale.source))
    }

    /// Returns whether an option contradicts the plan: `name` is that of the command line, with underscores, `wanted`
    /// the options that were given.
    pub fn contradicts(&self, name: &str, wanted: &ConvertOptions) -> bool {
        let Self { plan: Plan { frame, options }, reading, .. } = self;
        let (given, of_plan) = (&wanted.reading, &wanted.plan);
        // The plan holds one placement, which follows from `--up` and `--transform`.
        let same_placement = wanted.placement_with(self.up.as_ref()) == reading.placement;
        let turns = given.turn == Turn::Auto;
        match name {
            "pixel" => wanted.grid.pixel != PixelSize::Metres(frame.pixel_m()),
            "slice" => wanted.grid.slice_m != Some(frame.slice_m()),
            "max_slope" => of_plan.max_slope_deg != options.max_slope_deg,
            "tolerance" if wanted.grid.tolerance_auto => self.noise.is_none(),
            "tolerance" => of_plan.tolerance_m != options.tolerance_m,
            "classifier" => of_plan.classifier != options.classifier,
            "exclude_class" => of_plan.exclude_classes != options.exclude_classes,
            "min_points" => of_plan.min_points != options.min_points,
            "drop_isolated" | "drop_floaters" => of_plan.drop_floaters != options.drop_floaters,
            "remove_moving" => of_plan.remove_moving != options.remove_moving,
            "fill_holes" => {
                let pixels = wanted.fill_holes_pixels(frame.pixel_m());
                wanted.grid.fill_holes == Some(HoleWidth::Auto) || pixels.ok() != Some(options.fill_holes)
            }
            "up" => {
                let same_placement = same_placement || given.placement.is_none() && turns;
                of_plan.up != options.up || turns != self.up.is_some() || !same_placement
            }
            "transform" => !same_placement,
            "opacity" => given.splats.opacity != reading.splats.opacity,
            "min_opacity" => given.splats.min_opacity != reading.splats.min_opacity,
            "max_size" => given.splats.max_size_m != reading.splats.max_size_m,
            "units" | "scale_from" => given.units != reading.units,
            "crs" => given.epsg != reading.epsg,
            "columns" => given.columns != reading.columns,
            "mesh" => given.mesh != reading.mesh,
            "levels" => wanted.sections.levels != self.levels,
            "free_space" => self.free_space && !wanted.sections.free_space,
            // The plan holds the source that `auto` found.
            "colour" if wanted.sections.colour == ColourMode::Auto => false,
            "colour" => wanted.sections.colour != self.colour_mode(),
            "colour_error" => {
                self.colour.is_some_and(|plan| wanted.sections.colour_error != f64::from(plan.error_milli) / 1000.0)
            }
            _ => false,
        }
    }

    /// Returns part `index` of `count`.
    pub fn shard(&self, index: u32, count: u32) -> Result<Shard> {
        if !(1..=MAX_SHARDS).contains(&count) || !(1..=count).contains(&index) {
            return Err(Error::parameter(
                Parameter::Shard,
                format!("{index}/{count} is not a part; expected 1/1 to {MAX_SHARDS}/{MAX_SHARDS}"),
            ));
        }
        let firsts = split(&self.plan.frame, &self.inputs, count);
        let last = firsts.get(index as usize).map_or(u64::MAX, |next| next - 1);
        Ok(Shard { index, count, first: firsts[index as usize - 1], last, plan_file: self.hash() })
    }

    /// Refuses inputs that are not those of the plan file.
    pub(super) fn check_same_inputs(&self, here: &Self) -> Result<()> {
        let missing = |from: &Self, of: &Self| {
            let mut rest: HashMap<u128, usize> = HashMap::new();
            from.inputs.iter().for_each(|input| *rest.entry(input.fingerprint).or_default() += 1);
            let missing = of.inputs.iter().find(|input| match rest.get_mut(&input.fingerprint) {
                Some(left) if *left > 0 => {
                    *left -= 1;
                    false
                }
                _ => true,
            });
            missing.map(|input| input.name.clone())
        };
        if let Some(name) = missing(self, here) {
            return Err(Self::stranger(&name));
        }
        if let Some(name) = missing(here, self) {
            return Err(Self::left_out(&name));
        }
        Self::refuse_other_options(here.plan != self.plan || here.reading != self.reading)
    }

    /// Refuses options that are not those of the plan file.
    pub(super) fn check_same_options(&self, plan: &Plan, options: &ConvertOptions) -> Result<()> {
        Self::refuse_other_options(*plan != self.plan || options.reading != self.reading)
    }

    /// Makes the error for an input that is not in the plan.
    pub(super) fn stranger(name: &str) -> Error {
        let reason = "it is not among the files of the plan, or has changed since; write the plan again, and convert every \
                      part with it";
        Error::input(name, "content", reason)
    }

    /// Makes the error for a file of the plan that is not among the inputs.
    pub(super) fn left_out(name: &str) -> Error {
        Error::input(name, "plan", "it is a file of the plan, but not among the inputs; name it too")
    }

    fn refuse_other_options(differ: bool) -> Result<()> {
        if differ {
            return Err(Error::parameter(
                "plan",
                "its options are not those of the conversion; apply it to them first",
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::split::{QuadCell, tiles};
    use super::*;
    use crate::frame::{Frame, morton};
    use crate::input::StatedBounds;
    use crate::placement::Similarity;
    use crate::plan::{Classifier, Up};
    use crate::voxel::record::HALO_PIXELS;
    use proptest::prelude::*;

    fn plan_file(areas: &[([f64; 2], [f64; 2], u64)]) -> PlanFile {
        let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
        let facts = |(number, &(min, size, points)): (usize, &([f64; 2], [f64; 2], u64))| InputFacts {
            name: format!("{number}.las"),
            bytes: 1,
            points,
            fingerprint: number as u128,
            bounds: Some(StatedBounds { min: [min[0], min[1], 0.0], max: [min[0] + size[0], min[1] + size[1], 1.0] }),
        };
        let options = ConvertOptions::new(Vec::new(), "a.slices".into());
        PlanFile::of(areas.iter().enumerate().map(facts).collect(), plan, &options)
    }

    proptest! {
        #[test]
        fn parts_follow_one_another_over_the_whole_grid_and_every_file_is_owned_once(
            areas in proptest::collection::vec(
                (prop::array::uniform2(-1e4f64..1e4), prop::array::uniform2(0.0f64..3e3), 0u64..1_000_000), 0..6),
            count in 1u32..9
        ) {
            let file = plan_file(&areas);
            let parts: Vec<Shard> = (1..=count).map(|index| file.shard(index, count).unwrap()).collect();
            prop_assert_eq!((parts[0].first, parts[count as usize - 1].last), (0, u64::MAX));
            for pair in parts.windows(2) {
                prop_assert!(pair[0].first <= pair[0].last && pair[0].last + 1 == pair[1].first);
            }
            for input in &file.inputs {
                let area = tiles(&file.plan.frame, &input.bounds.unwrap(), HALO_PIXELS);
                let met = |first, last| QuadCell::WHOLE.meets(&area, first, last);
                let owners = parts.iter().filter(|p| met(p.first, p.last) && (p.first == 0 || !met(0, p.first - 1)));
                prop_assert_eq!(owners.count(), 1);
                // Brute force along the lower edge: each of its tiles lies in a part that needs the file.
                for x in area.x.0..=area.x.1.min(area.x.0 + 300) {
                    let column = morton(x as i32, area.y.0 as i32);
                    let part = parts.iter().find(|part| part.columns().contains(&column)).unwrap();
                    prop_assert!(met(part.first, part.last), "tile {} of {:?}", x, area);
                }
            }
        }
    }

    #[test]
    fn parts_of_an_even_scan_are_about_equal() {
        let file = plan_file(&[([-100.0, -50.0], [200.0, 100.0], 1_000_000)]);
        let area = tiles(&file.plan.frame, &file.inputs[0].bounds.unwrap(), 0);
        let all = area.common(&area);
        for part in (1..=4).map(|index| file.shard(index, 4).unwrap()) {
            let own = |tx: i64| {
                (area.y.0..=area.y.1).filter(move |&ty| part.columns().contains(&morton(tx as i32, ty as i32)))
            };
            let share = (area.x.0..=area.x.1).flat_map(own).count() as f64 / all;
            assert!((0.2..0.3).contains(&share), "{share}");
        }
    }

    #[test]
    fn jobs_differ_by_what_decides_their_parts_and_not_by_names() {
        let one = plan_file(&[([0.0; 2], [9.0; 2], 10), ([5.0; 2], [9.0; 2], 20)]);
        let mut renamed = one.clone();
        renamed.inputs[0].name = "other.las".into();
        assert_eq!(renamed.hash(), one.hash());
        let mut changes = vec![one.clone(); 9];
        changes[0].plan.options.max_slope_deg = 44.0;
        changes[1].reading.units = Units::Factor(1.0);
        changes[2].inputs[0].fingerprint = 9;
        changes[3].inputs[1].bounds = None;
        changes[4].inputs.pop();
        changes[5].reading.mesh = MeshMode::Sampled { step_m: None };
        changes[6].reading.epsg = Some(25832);
        changes[7].reading.columns = Some("y,x,z".parse().unwrap());
        changes[8].colour = Some(ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 2000 });
        for (number, changed) in changes.iter().enumerate() {
            assert_ne!(changed.hash(), one.hash(), "{number}");
        }
    }

    #[test]
    fn an_option_contradicts_a_plan_that_holds_another_value() {
        type Changed = (&'static str, fn(&mut ConvertOptions));
        let mut file = plan_file(&[([0.0; 2], [9.0; 2], 10)]);
        file.free_space = true;
        file.colour = Some(ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 2000 });
        let mut same = ConvertOptions::new(Vec::new(), "a.slices".into());
        file.apply_to(&mut same);
        let changes: [Changed; 28] = [
            ("pixel", |options| options.grid.pixel = PixelSize::Metres(0.2)),
            ("pixel", |options| options.grid.pixel = PixelSize::Auto),
            ("slice", |options| options.grid.slice_m = Some(0.2)),
            ("max_slope", |options| options.plan.max_slope_deg = 30.0),
            ("tolerance", |options| options.plan.tolerance_m = 0.01),
            ("tolerance", |options| options.grid.tolerance_auto = true),
            ("classifier", |options| options.plan.classifier = Classifier::Thesis),
            ("exclude_class", |options| options.plan.exclude_classes = [7u8].into_iter().collect()),
            ("min_points", |options| options.plan.min_points = 2),
            ("drop_isolated", |options| options.plan.drop_floaters = 1),
            ("drop_floaters", |options| options.plan.drop_floaters = 9),
            ("remove_moving", |options| options.plan.remove_moving = true),
            ("fill_holes", |options| options.grid.fill_holes = Some(HoleWidth::Metres(0.3))),
            ("fill_holes", |options| options.grid.fill_holes = Some(HoleWidth::Auto)),
            ("up", |options| options.plan.up = Up::Y),
            ("up", |options| options.reading.turn = Turn::Auto),
            ("up", |options| options.reading.turn = Turn::From([1.0, 0.0, 0.0])),
            ("transform", |options| options.reading.placement = Some(Similarity::scaling(2.0))),
            ("opacity", |options| options.reading.splats.opacity = 0.5),
            ("min_opacity", |options| options.reading.splats.min_opacity = 0.5),
            ("max_size", |options| options.reading.splats.max_size_m = Some(1.0)),
            ("units", |options| options.reading.units = Units::Factor(2.0)),
            ("scale_from", |options| options.reading.units = Units::Factor(2.0)),
            ("crs", |options| options.reading.epsg = Some(25832)),
            ("columns", |options| options.reading.columns = Some("y,x,z".parse().unwrap())),
            ("mesh", |options| options.reading.mesh = MeshMode::Sampled { step_m: None }),
            ("levels", |options| options.sections.levels = true),
            ("free_space", |options| options.sections.free_space = false),
        ];
        let colours: [Changed; 2] = [
            ("colour", |options| options.sections.colour = ColourMode::Off),
            ("colour_error", |options| options.sections.colour_error = 1.0),
        ];
        for (name, change) in changes.into_iter().chain(colours) {
            assert!(!file.contradicts(name, &same), "{name}");
            let mut other = same.clone();
            change(&mut other);
            assert!(file.contradicts(name, &other), "{name}");
            assert!(!file.contradicts("threads", &other));
        }
        // The plan holds the source that was found.
        same.sections.colour = ColourMode::Auto;
        assert!(!file.contradicts("colour", &same));
        // A plan without seen space leaves the choice to its parts.
        file.free_space = false;
        assert!(!file.contradicts("free_space", &same));
    }

    #[test]
    fn the_direction_that_a_plan_found_may_be_given_without_its_matrix() {
        let mut file = plan_file(&[([0.0; 2], [9.0; 2], 10)]);
        let found = UpFound { up: [1.0, 0.0, 0.0], sure: 0.9, floor_m2: 9.0, next_m2: 0.1 };
        file.up = Some(found);
        file.reading.placement = Some(Similarity::scaling(2.0) * found.turn());
        let mut options = ConvertOptions::new(Vec::new(), "a.slices".into());
        assert!(file.contradicts("up", &options), "the input is not upright");
        options.reading.turn = Turn::Auto;
        assert!(!file.contradicts("up", &options));
        for (factor, contradicts) in [(2.0, false), (3.0, true)] {
            options.reading.placement = Some(Similarity::scaling(factor));
            assert_eq!(["up", "transform"].map(|name| file.contradicts(name, &options)), [contradicts; 2]);
        }
    }

    #[test]
    fn parts_that_are_none_and_options_of_another_plan_are_refused() {
        let file = plan_file(&[([0.0; 2], [9.0; 2], 10)]);
        for (index, count) in [(0, 3), (4, 3), (1, 0), (1, MAX_SHARDS + 1)] {
            let refused = file.shard(index, count);
            assert!(matches!(refused, Err(Error::Parameter { what: Parameter::Shard, .. })), "{index}/{count}");
        }
        let mut options = ConvertOptions::new(Vec::new(), "a.slices".into());
        file.check_same_options(&file.plan, &options).unwrap();
        file.check_same_inputs(&file).unwrap();
        let mut other = file.plan.clone();
        other.options.min_points = 2;
        options.reading.epsg = Some(25832);
        for refused in [
            file.check_same_options(&other, &ConvertOptions::new(Vec::new(), "a.slices".into())),
            file.check_same_options(&file.plan, &options),
            file.check_same_inputs(&PlanFile { plan: other.clone(), ..file.clone() }),
        ] {
            assert!(refused.unwrap_err().to_string().contains("its options are not those of the conversion"));
        }
    }
}
