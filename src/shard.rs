//! Converting a scan in parts, on several machines or one after the other.
//!
//! A *job* is a conversion fixed in advance: plan, unit and inputs. It is cut into parts by tile columns: part `k` of `n`
//! has a range of columns in archive order, balanced by the bounds and point counts that headers state. What decides a
//! voxel reaches one pixel beyond its column, and the voxel pass gives each column copies of the points there; so a part
//! that keeps the records of its own columns, and no others, makes the very pages of a single run.
//!
//! Each point counts in one part: by its column if it is kept, else in the part that *owns* its file, the first that
//! needs it. A part reads the files whose stated bounds meet its columns. Bounds may lie; so the owner, which reads its
//! file whole, fails if a point lies outside of them: no point is lost unnoticed.

use crate::archive::{MAX_SHARDS, Shard, plan_hash};
use crate::convert::{ConvertOptions, PixelSize};
use crate::frame::{Frame, TILE_PIXELS, morton};
use crate::input::{InputSet, PointBatch, ScanFile, StatedBounds, Units};
use crate::plan::Plan;
use crate::store::{ByteSource, FileSource};
use crate::voxel::record::HALO_PIXELS;
use crate::{Error, Monitor, Result};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_128;

/// Bytes at either end of a file by which it is known again, beside its length.
const FINGERPRINT_BYTES: u64 = 4096;

/// An input file as a plan remembers it.
#[derive(Debug, Clone, PartialEq)]
pub struct InputFacts {
    /// Its name without folders, for the reader of the plan only.
    pub name: String,
    /// Its length (bytes).
    pub bytes: u64,
    /// Points that its header states.
    pub points: u64,
    /// XXH3-128 of its length, its first and its last 4096 bytes: tells whether another machine has the same file.
    pub fingerprint: u128,
    /// Bounds that its header states (m); parts that these do not meet leave the file out. `None`: all parts read it.
    pub bounds: Option<StatedBounds>,
}

impl InputFacts {
    fn of(file: &ScanFile) -> Result<Self> {
        let name = file.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
        let bounds = file.bounds_with_slack();
        let (bytes, points) = (file.bytes(), file.points_stated());
        Ok(Self { name, bytes, points, fingerprint: fingerprint(file.path())?, bounds })
    }
}

fn fingerprint(path: &Path) -> Result<u128> {
    let source = FileSource::open(path)?;
    let (len, ends) = (source.len(), source.len().min(FINGERPRINT_BYTES));
    let mut bytes = len.to_le_bytes().to_vec();
    for at in [0, len - ends] {
        let start = bytes.len();
        bytes.resize(start + ends as usize, 0);
        source.read_at(at, &mut bytes[start..])?;
    }
    Ok(xxh3_128(&bytes))
}

/// A conversion fixed before any point is converted; `sliceconv --write-plan` writes one.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Grid and options.
    pub plan: Plan,
    /// Unit of the input.
    pub units: Units,
    /// Point spacing found, if the pixel size was chosen from it (m).
    pub spacing_m: Option<f64>,
    /// The inputs, in order of their fingerprints: the same on every machine.
    pub inputs: Vec<InputFacts>,
}

impl Job {
    /// The job that `options` describe: headers are read, and the points once if the pixel size is to follow from them.
    pub fn new(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Self> {
        let set = crate::convert::open_inputs(options, monitor)?;
        let (plan, spacing) = crate::convert::plan(options, &set, monitor)?;
        Self::of(&set, plan, options.units, spacing.map(|spacing| spacing.spacing_m))
    }

    fn of(set: &InputSet, plan: Plan, units: Units, spacing_m: Option<f64>) -> Result<Self> {
        if let Some(mesh) = set.meshes().first() {
            let reason = "meshes are not converted in parts; leave them out, or convert everything in one run";
            return Err(Error::input(mesh, "mesh", reason));
        }
        let inputs = set.files().iter().map(InputFacts::of).collect::<Result<Vec<_>>>()?;
        let mut job = Self { plan, units, spacing_m, inputs };
        job.sort_inputs();
        Ok(job)
    }

    /// Puts the inputs into the order that does not depend on where they lie.
    pub fn sort_inputs(&mut self) {
        self.inputs.sort_by(|a, b| (a.fingerprint, &a.name).cmp(&(b.fingerprint, &b.name)));
    }

    /// Identity of the job: of everything that decides what its parts hold.
    pub fn hash(&self) -> u128 {
        let mut bytes = plan_hash(&self.plan).to_le_bytes().to_vec();
        let unit = match self.units {
            Units::Auto => 0.0,
            Units::Factor(factor) => factor,
        };
        bytes.extend(unit.to_le_bytes());
        for input in &self.inputs {
            bytes.extend(input.fingerprint.to_le_bytes());
            bytes.extend(input.points.to_le_bytes());
            let bounds = input.bounds.map(|bounds| [bounds.min, bounds.max].concat());
            bytes.push(u8::from(bounds.is_some()));
            bounds.into_iter().flatten().for_each(|value| bytes.extend((value + 0.0).to_le_bytes()));
        }
        xxh3_128(&bytes)
    }

    /// Sets the options that the job fixes.
    pub fn apply_to(&self, options: &mut ConvertOptions) {
        let Plan { frame, max_slope_deg, tolerance_m, classifier, min_points, drop_isolated, up, exclude_classes } =
            self.plan.clone();
        options.pixel = PixelSize::Metres(frame.pixel_m());
        options.slice_m = Some(frame.slice_m());
        options.max_slope_deg = max_slope_deg;
        options.tolerance_m = tolerance_m;
        options.classifier = classifier;
        options.min_points = min_points;
        options.drop_isolated = drop_isolated;
        options.up = up;
        options.exclude_classes = exclude_classes;
        options.units = self.units;
    }

    /// Part `index` of `count`.
    pub fn shard(&self, index: u32, count: u32) -> Result<Shard> {
        if !(1..=MAX_SHARDS).contains(&count) || !(1..=count).contains(&index) {
            return Err(Error::parameter(
                "--shard",
                format!("{index}/{count} is none of 1/1 to {MAX_SHARDS}/{MAX_SHARDS}"),
            ));
        }
        let firsts = self.split(count);
        let last = firsts.get(index as usize).map_or(u64::MAX, |next| next - 1);
        Ok(Shard { index, count, first: firsts[index as usize - 1], last, job: self.hash() })
    }

    /// First columns of `count` parts that hold about as many points each, if headers tell the truth.
    fn split(&self, count: u32) -> Vec<u64> {
        let frame = &self.plan.frame;
        let areas = self.inputs.iter().filter_map(|input| Some((tiles(frame, &input.bounds?, 0), input.points as f64)));
        let mut areas: Vec<(Tiles, f64)> = areas.collect();
        let mut total: f64 = areas.iter().map(|area| area.1).sum();
        if total <= 0.0 {
            areas = vec![(Cell::WHOLE.tiles(), 1.0)];
            total = 1.0;
        }
        let mut firsts = vec![0u64];
        for index in 1..count {
            let least = firsts[firsts.len() - 1] + 1;
            // Room for the parts that follow, each of which has a column.
            let most = u64::MAX - u64::from(count - index);
            let wanted = column_at(&areas, total * f64::from(index) / f64::from(count));
            firsts.push(wanted.clamp(least, most));
        }
        firsts
    }
}

/// First and last tile along x and y.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tiles {
    x: (i64, i64),
    y: (i64, i64),
}

const GRID: (i64, i64) = (i32::MIN as i64, i32::MAX as i64);

/// Tiles of the points within `bounds`, and of those up to `halo` pixels away.
fn tiles(frame: &Frame, bounds: &StatedBounds, halo: i64) -> Tiles {
    let along = |axis: usize| {
        let tile = |pixel: i64| pixel.div_euclid(TILE_PIXELS).clamp(GRID.0, GRID.1);
        (tile(frame.pixel_of(bounds.min[axis]) - halo), tile(frame.pixel_of(bounds.max[axis]) + halo))
    };
    Tiles { x: along(0), y: along(1) }
}

impl Tiles {
    /// Tiles in both (a float: there may be 2⁶⁴).
    fn common(&self, other: &Self) -> f64 {
        let along = |a: (i64, i64), b: (i64, i64)| (a.1.min(b.1) - a.0.max(b.0) + 1).max(0) as f64;
        along(self.x, other.x) * along(self.y, other.y)
    }
}

/// A square of tiles whose columns are consecutive: a node of the quadtree that the order of columns walks through.
#[derive(Clone, Copy)]
struct Cell {
    x: i64,
    y: i64,
    /// Its edge is `2^level` tiles.
    level: u32,
    /// Its first column.
    first: u64,
}

impl Cell {
    const WHOLE: Self = Self { x: GRID.0, y: GRID.0, level: 32, first: 0 };

    fn tiles(&self) -> Tiles {
        let edge = (1i64 << self.level) - 1;
        Tiles { x: (self.x, self.x + edge), y: (self.y, self.y + edge) }
    }

    fn last(&self) -> u64 {
        self.first + ((1u128 << (2 * self.level)) - 1) as u64
    }

    /// The four cells of which it consists, in the order of their columns; itself must be larger than a tile.
    fn quarters(&self) -> [Self; 4] {
        let level = self.level - 1;
        [0u64, 1, 2, 3].map(|number| Self {
            x: self.x + ((number as i64 & 1) << level),
            y: self.y + ((number as i64 >> 1) << level),
            level,
            first: self.first + (number << (2 * level)),
        })
    }

    /// Whether the cell has a tile of `area` whose column lies in `first..=last`.
    fn meets(&self, area: &Tiles, first: u64, last: u64) -> bool {
        if self.last() < first || self.first > last {
            return false;
        }
        let common = self.tiles().common(area);
        let all_columns = first <= self.first && self.last() <= last;
        let all_tiles = common >= self.tiles().common(&self.tiles());
        common > 0.0 && (all_columns || all_tiles || self.quarters().iter().any(|cell| cell.meets(area, first, last)))
    }
}

/// The column before which the `areas`, evenly filled with their weights, hold `target`.
fn column_at(areas: &[(Tiles, f64)], target: f64) -> u64 {
    let mut cell = Cell::WHOLE;
    let mut before = 0.0;
    while cell.level > 0 {
        let quarters = cell.quarters();
        cell = quarters[3];
        for quarter in &quarters[..3] {
            let tiles = quarter.tiles();
            let weight: f64 = areas.iter().map(|(area, weight)| weight * tiles.common(area) / area.common(area)).sum();
            if before + weight > target {
                cell = *quarter;
                break;
            }
            before += weight;
        }
    }
    cell.first
}

/// What to convert of a scan, if not all.
#[derive(Debug, Clone)]
pub struct ShardOptions {
    /// Number of the part [1..=count].
    pub index: u32,
    /// Number of all parts [1..=65536].
    pub count: u32,
    /// The job as a plan fixed it; made anew from the inputs if `None`, the same in every part.
    pub job: Option<Job>,
}

/// A part of a conversion and how it treats each file.
pub(crate) struct Part {
    pub shard: Shard,
    /// By number in the set of inputs.
    roles: Vec<Role>,
    frame: Frame,
}

/// How a part treats a file.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Role {
    /// Points of the file may lie in the part's columns or beside them.
    reads: bool,
    /// Points that make no voxel count here.
    owns: bool,
    bounds: Option<StatedBounds>,
}

impl Part {
    /// The part that `options` ask for, of the inputs `set`, which must be those of its job.
    pub fn new(options: &ShardOptions, set: &InputSet, plan: &Plan, units: Units) -> Result<Self> {
        let here = Job::of(set, plan.clone(), units, None)?;
        let job = match &options.job {
            Some(job) => {
                job.check_same_inputs(&here)?;
                job
            }
            None => &here,
        };
        let shard = job.shard(options.index, options.count)?;
        let firsts = job.split(options.count);
        let role = |input: &InputFacts| {
            let meets = |first, last| match &input.bounds {
                Some(bounds) => Cell::WHOLE.meets(&tiles(&plan.frame, bounds, HALO_PIXELS), first, last),
                None => true,
            };
            let reads = meets(shard.first, shard.last);
            let owns = reads && (shard.first == 0 || !meets(0, firsts[shard.index as usize - 1] - 1));
            Role { reads, owns, bounds: input.bounds }
        };
        let mut roles = Vec::with_capacity(set.files().len());
        let mut taken = vec![false; job.inputs.len()];
        for file in set.files() {
            let print = fingerprint(file.path())?;
            // Files of equal fingerprint may differ in the bounds that a person put into the plan.
            let found = (0..taken.len()).find(|&number| !taken[number] && job.inputs[number].fingerprint == print);
            let Some(number) = found else {
                return Err(Error::input(file.path(), "content", "it changed while it was opened; start again"));
            };
            taken[number] = true;
            roles.push(role(&job.inputs[number]));
        }
        Ok(Self { shard, roles, frame: plan.frame })
    }

    /// Whether the part needs a file.
    pub fn reads(&self, file: usize) -> bool {
        self.roles[file].reads
    }

    /// Whether points of a file that make no voxel count in this part.
    pub fn owns(&self, file: usize) -> bool {
        self.roles[file].owns
    }

    /// Whether the part needs every file.
    pub fn reads_all(&self) -> bool {
        self.roles.iter().all(|role| role.reads)
    }

    /// Fails if points of a file that reach from `min` to `max` lie where other parts would not look for them.
    pub fn check_bounds(&self, scan: &ScanFile, file: usize, min: [f64; 3], max: [f64; 3]) -> Result<()> {
        let Some(stated) = self.roles[file].bounds else { return Ok(()) };
        // Heights do not decide which part needs a file.
        if (0..2).all(|axis| stated.min[axis] <= min[axis] && max[axis] <= stated.max[axis]) {
            return Ok(());
        }
        let reason = format!(
            "points from {min:?} to {max:?} lie outside the bounds that its header states, by which parts choose their \
             files; write a plan, set the file's bounds in it to null, and convert every part again with it"
        );
        Err(Error::input(scan.path(), "bounds", reason))
    }

    /// How many points of `batch` lie in the part's columns, and their bounds.
    pub fn own(&self, batch: &PointBatch) -> (u64, [f64; 3], [f64; 3]) {
        let (mut count, mut min, mut max) = (0, [f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        let columns = self.shard.columns();
        let mut last = None;
        for ((&x, &y), &z) in batch.x.iter().zip(&batch.y).zip(&batch.z) {
            let tile = [x, y].map(|v| self.frame.pixel_of(v).div_euclid(TILE_PIXELS) as i32);
            // Points that follow each other mostly lie in the same tile.
            let own = match last {
                Some((same, own)) if same == tile => own,
                _ => columns.contains(&morton(tile[0], tile[1])),
            };
            last = Some((tile, own));
            if own {
                count += 1;
                for (axis, value) in [x, y, z].into_iter().enumerate() {
                    min[axis] = min[axis].min(value);
                    max[axis] = max[axis].max(value);
                }
            }
        }
        (count, min, max)
    }
}

impl Job {
    /// Refuses inputs that are not those of the job.
    fn check_same_inputs(&self, here: &Self) -> Result<()> {
        let missing = |from: &Self, of: &Self| {
            let mut rest: Vec<u128> = from.inputs.iter().map(|input| input.fingerprint).collect();
            let missing = of.inputs.iter().find(|input| {
                let found = rest.iter().position(|&print| print == input.fingerprint);
                found.map(|at| rest.swap_remove(at)).is_none()
            });
            missing.map(|input| input.name.clone())
        };
        if let Some(name) = missing(self, here) {
            let reason = "it is not among the files of the plan, or has changed since; write the plan again, and convert \
                          every part with it";
            return Err(Error::input(name, "content", reason));
        }
        if let Some(name) = missing(here, self) {
            return Err(Error::input(name, "plan", "it is a file of the plan, but not among the inputs; name it too"));
        }
        if here.plan != self.plan || here.units != self.units {
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
    use super::*;
    use crate::plan::{Classifier, Up};
    use proptest::prelude::*;

    fn job(areas: &[([f64; 2], [f64; 2], u64)]) -> Job {
        let plan = Plan {
            frame: Frame::new(0.1, 0.3).unwrap(),
            max_slope_deg: 45.0,
            tolerance_m: 0.0,
            classifier: Classifier::Plane,
            min_points: 1,
            drop_isolated: false,
            up: Up::Z,
            exclude_classes: [0; 4],
        };
        let facts = |(number, &(min, size, points)): (usize, &([f64; 2], [f64; 2], u64))| InputFacts {
            name: format!("{number}.las"),
            bytes: 1,
            points,
            fingerprint: number as u128,
            bounds: Some(StatedBounds { min: [min[0], min[1], 0.0], max: [min[0] + size[0], min[1] + size[1], 1.0] }),
        };
        Job { plan, units: Units::Auto, spacing_m: None, inputs: areas.iter().enumerate().map(facts).collect() }
    }

    proptest! {
        #[test]
        fn parts_follow_one_another_over_the_whole_grid_and_every_file_is_owned_once(
            areas in proptest::collection::vec(
                (prop::array::uniform2(-1e4f64..1e4), prop::array::uniform2(0.0f64..3e3), 0u64..1_000_000), 0..6),
            count in 1u32..9
        ) {
            let job = job(&areas);
            let parts: Vec<Shard> = (1..=count).map(|index| job.shard(index, count).unwrap()).collect();
            prop_assert_eq!((parts[0].first, parts[count as usize - 1].last), (0, u64::MAX));
            for pair in parts.windows(2) {
                prop_assert!(pair[0].first <= pair[0].last && pair[0].last + 1 == pair[1].first);
            }
            for input in &job.inputs {
                let area = tiles(&job.plan.frame, &input.bounds.unwrap(), HALO_PIXELS);
                let met = |first, last| Cell::WHOLE.meets(&area, first, last);
                let owners = parts.iter().filter(|p| met(p.first, p.last) && (p.first == 0 || !met(0, p.first - 1)));
                prop_assert_eq!(owners.count(), 1);
                // By brute force along the lower edge: each of its tiles lies in a part that needs the file.
                for x in area.x.0..=area.x.1.min(area.x.0 + 300) {
                    let column = morton(x as i32, area.y.0 as i32);
                    let part = parts.iter().find(|part| part.columns().contains(&column)).unwrap();
                    prop_assert!(met(part.first, part.last), "tile {} of {:?}", x, area);
                }
            }
        }

        #[test]
        fn a_range_meets_an_area_exactly_when_it_has_a_column_of_it(
            x in (-20i64..20, 0i64..9), y in (-20i64..20, 0i64..9), at in (-24i32..32, -24i32..32), length in 0u64..200
        ) {
            let area = Tiles { x: (x.0, x.0 + x.1), y: (y.0, y.0 + y.1) };
            let first = morton(at.0, at.1);
            let last = first + length;
            let inside = |tx: i64, ty: i64| (first..=last).contains(&morton(tx as i32, ty as i32));
            let expected = (area.x.0..=area.x.1).any(|tx| (area.y.0..=area.y.1).any(|ty| inside(tx, ty)));
            prop_assert_eq!(Cell::WHOLE.meets(&area, first, last), expected);
        }
    }

    #[test]
    fn parts_of_an_even_scan_are_about_equal() {
        let job = job(&[([-100.0, -50.0], [200.0, 100.0], 1_000_000)]);
        let area = tiles(&job.plan.frame, &job.inputs[0].bounds.unwrap(), 0);
        let all = area.common(&area);
        for part in (1..=4).map(|index| job.shard(index, 4).unwrap()) {
            let own = |tx: i64| {
                (area.y.0..=area.y.1).filter(move |&ty| part.columns().contains(&morton(tx as i32, ty as i32)))
            };
            let share = (area.x.0..=area.x.1).flat_map(own).count() as f64 / all;
            assert!((0.2..0.3).contains(&share), "{share}");
        }
    }

    #[test]
    fn jobs_differ_by_what_decides_their_parts_and_not_by_names() {
        let one = job(&[([0.0; 2], [9.0; 2], 10), ([5.0; 2], [9.0; 2], 20)]);
        let mut renamed = one.clone();
        renamed.inputs[0].name = "other.las".into();
        assert_eq!(renamed.hash(), one.hash());
        let mut changes = vec![one.clone(); 5];
        changes[0].plan.max_slope_deg = 44.0;
        changes[1].units = Units::Factor(1.0);
        changes[2].inputs[0].fingerprint = 9;
        changes[3].inputs[1].bounds = None;
        changes[4].inputs.pop();
        for (number, changed) in changes.iter().enumerate() {
            assert_ne!(changed.hash(), one.hash(), "{number}");
        }
    }
}
