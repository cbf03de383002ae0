//! One part of a conversion: which files it reads, and which points count in it.

use super::chosen::Chosen;
use super::facts::{InputFacts, name_of};
use super::holes::Closer;
use super::options::{ConvertOptions, ShardOptions};
use super::plan_file::PlanFile;
use super::split::{QuadCell, TileRect, tiles};
use crate::archive::{InputRead, Shard};
use crate::colour::ColourPlan;
use crate::frame::{Frame, TILE_PIXELS, morton};
use crate::input::{InputSet, PointBatch, ScanFile, StatedBounds};
use crate::plan::Plan;
use crate::voxel::record::{ColumnIndex, HALO_PIXELS};
use crate::voxel::views::Station;
use crate::{Error, Monitor, Result};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_128;

/// A part of a conversion and how it treats each file.
pub(crate) struct ShardScope {
    pub shard: Shard,
    /// By number in the set of inputs: scans, then meshes.
    roles: Vec<Role>,
    /// Whether it reads all inputs of the plan.
    reads_all: bool,
    frame: Frame,
    /// Pixels around the part's columns whose points it needs.
    reach: i64,
}

/// How a part treats a file.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Role {
    /// Points of the file may lie in the part's columns or beside them.
    reads: bool,
    /// Points that make no voxel count here.
    owns: bool,
    /// Other parts read it too.
    shared: bool,
    /// Its number in the plan file; of equal files, that of the first.
    number: u32,
    bounds: Option<StatedBounds>,
}

impl Role {
    /// How the part `shard` of `file` treats one of its inputs.
    fn of(file: &PlanFile, shard: Shard, input: &InputFacts) -> Self {
        let reach = reach(&file.plan);
        let meets = |first, last| meets(&file.plan.frame, reach, input, first, last);
        let reads = meets(shard.first, shard.last);
        let before = shard.first > 0 && meets(0, shard.first - 1);
        let behind = shard.last < u64::MAX && meets(shard.last + 1, u64::MAX);
        let number = file.number_of(input.fingerprint) as u32;
        Self { reads, owns: reads && !before, shared: before || behind, number, bounds: input.bounds }
    }
}

/// How far from a pixel matter may lie that decides what becomes of it (pixels): connected matter that reaches farther than
/// it has voxels to be dropped stays, whatever is behind.
///
/// And holes are closed by floors around them.
pub(super) fn reach(plan: &Plan) -> i64 {
    let holes = match plan.options.fill_holes {
        0 => 0,
        widest => Closer::reach(widest),
    };
    match plan.options.drop_floaters {
        0 | 1 => HALO_PIXELS + holes,
        most => HALO_PIXELS + holes + i64::from(most),
    }
}

/// Whether points of `input` may lie within `reach` pixels of the columns `first..=last`.
pub(super) fn meets(frame: &Frame, reach: i64, input: &InputFacts, first: u64, last: u64) -> bool {
    match &input.bounds {
        Some(bounds) => QuadCell::WHOLE.meets(&tiles(frame, bounds, reach), first, last),
        None => true,
    }
}

impl ShardScope {
    /// The part that `options` ask for, of the inputs `set`, which must be those of its plan file; or, with `chosen` ones, some of
    /// them.
    pub fn new(
        shard: ShardOptions,
        set: &InputSet,
        plan: &Plan,
        options: &ConvertOptions,
        colour: Option<ColourPlan>,
        chosen: Option<&Chosen>,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let facts = match &options.plan_file {
            Some(_) => InputFacts::of(set, options.threads, monitor)?,
            None => InputFacts::measured(set, options.threads, monitor)?,
        };
        let fingerprints: Vec<u128> = facts.iter().map(|input| input.fingerprint).collect();
        if let (Some(file), Some(chosen)) = (&options.plan_file, chosen) {
            file.check_same_options(plan, options)?;
            return Self::of_chosen(file, chosen, &facts);
        }
        let here = PlanFile { colour, ..PlanFile::of(facts, plan.clone(), options) };
        let file = match &options.plan_file {
            Some(file) => {
                file.check_same_inputs(&here)?;
                file
            }
            None => &here,
        };
        let shard = file.shard(shard.index, shard.count)?;
        // Files of equal fingerprint may differ in the bounds that a person put into the plan.
        let mut inputs: HashMap<u128, Vec<&InputFacts>> = HashMap::new();
        file.inputs.iter().for_each(|input| inputs.entry(input.fingerprint).or_default().push(input));
        let role = |fingerprint: &u128| Some(Role::of(file, shard, inputs.get_mut(fingerprint).and_then(Vec::pop)?));
        // All are there: the inputs are those of the plan file.
        let roles: Vec<Role> = fingerprints.iter().filter_map(role).collect();
        Self::with(file, shard, roles, true)
    }

    /// Of inputs of which others than the `chosen` ones stay closed.
    fn of_chosen(file: &PlanFile, chosen: &Chosen, facts: &[InputFacts]) -> Result<Self> {
        let mut inputs: HashMap<u128, Vec<&InputFacts>> = HashMap::new();
        for (input, _) in file.inputs.iter().zip(&chosen.is_closed).filter(|(_, is_closed)| !**is_closed) {
            inputs.entry(input.fingerprint).or_default().push(input);
        }
        let mut roles = Vec::with_capacity(facts.len());
        for here in facts {
            let known = inputs.get_mut(&here.fingerprint).and_then(Vec::pop);
            roles.push(Role::of(file, chosen.shard, known.ok_or_else(|| PlanFile::stranger(&here.name))?));
        }
        if let Some(missing) = inputs.values().flatten().map(|input| &input.name).min() {
            return Err(PlanFile::left_out(missing));
        }
        Self::with(file, chosen.shard, roles, chosen.closed.is_empty())
    }

    fn with(file: &PlanFile, shard: Shard, roles: Vec<Role>, all: bool) -> Result<Self> {
        let shared = roles.iter().filter(|role| role.reads && role.shared).count();
        if shared > InputRead::MOST {
            let what = "inputs that several parts read (join files, or convert fewer at once)";
            return Err(Error::limit(what, shared, InputRead::MOST));
        }
        let reads_all = all && roles.iter().all(|role| role.reads);
        Ok(Self { shard, roles, reads_all, frame: file.plan.frame, reach: reach(&file.plan) })
    }

    /// Makes the part one of a conversion with these stations: it fits no part with others.
    pub fn sees_from(&mut self, stations: &[Station]) {
        let bits = |station: &Station| [&station.at[..], &[station.within_m]].concat().into_iter().map(f64::to_bits);
        let hash = |station: &Station| xxh3_128(&bits(station).flat_map(u64::to_le_bytes).collect::<Vec<u8>>());
        // In any order: it follows from where the files lie.
        let all = stations.iter().map(hash).fold(0, u128::wrapping_add);
        self.shard.plan_file = self.shard.plan_file.wrapping_add(all);
    }

    /// Whether the part needs the records of a tile column: one of its own, or one within reach.
    pub fn keeps(&self) -> impl Fn(ColumnIndex) -> bool + Send + 'static {
        let Shard { first, last, .. } = self.shard;
        // A column has a halo of its own.
        let around = (self.reach - HALO_PIXELS + TILE_PIXELS - 1).div_euclid(TILE_PIXELS);
        move |ColumnIndex { tx, ty, .. }| {
            if around == 0 {
                return (first..=last).contains(&morton(tx, ty));
            }
            let along = |tile: i32| (i64::from(tile) - around, i64::from(tile) + around);
            QuadCell::WHOLE.meets(&TileRect { x: along(tx), y: along(ty) }, first, last)
        }
    }

    /// What the part read of inputs that other parts read too, from the hashes of all its inputs.
    pub fn inputs_read<'a>(&self, hashes: impl Iterator<Item = (&'a Path, u128)>) -> Vec<InputRead> {
        let mut read: BTreeMap<u32, InputRead> = BTreeMap::new();
        for (role, (path, hash)) in self.roles.iter().zip(hashes) {
            if role.reads && role.shared {
                let nothing = || InputRead { input: role.number, hash: 0, name: name_of(path) };
                let sum = &mut read.entry(role.number).or_insert_with(nothing).hash;
                *sum = sum.wrapping_add(hash);
            }
        }
        read.into_values().collect()
    }

    /// Whether the part needs a file.
    pub fn reads(&self, file: usize) -> bool {
        self.roles[file].reads
    }

    /// Whether points of a file that make no voxel count in this part.
    pub fn owns(&self, file: usize) -> bool {
        self.roles[file].owns
    }

    /// Whether the triangles of meshes count in this part.
    pub fn owns_meshes(&self) -> bool {
        self.shard.index == 1
    }

    /// Whether the part needs every file.
    pub fn reads_all(&self) -> bool {
        self.reads_all
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
