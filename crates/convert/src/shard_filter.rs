//! Scope of one part of a conversion: which files it reads, and which points count in it.

use super::facts::{InputFacts, name_of};
use super::holes::Closer;
use super::options::{ConvertOptions, ShardOptions};
use super::plan_file::PlanFile;
use super::shard_inputs::Chosen;
use super::splats::SplatSet;
use super::split::{QuadCell, TileRect, tiles};
use crate::archive::{InputRead, Shard};
use crate::colour::ColourPlan;
use crate::frame::{Frame, TILE_PIXELS, morton};
use crate::input::{InputSet, PointBatch, ScanFile, StatedBounds};
use crate::plan::Plan;
use crate::voxel::record::{ColumnIndex, HALO_PIXELS, WHOLE};
use crate::voxel::visibility::Station;
use crate::{Error, Monitor, Result};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_128;

/// Part of a conversion, and how it treats each file.
pub(crate) struct ShardScope {
    pub shard: Shard,
    /// Roles by number in the set of inputs: scans, then meshes, then splats.
    roles: Vec<Role>,
    /// True if the part reads all inputs of the plan.
    reads_all: bool,
    frame: Frame,
    /// Distance around the part's columns within which it needs points (pixels).
    reach: i64,
}

/// Role of a file in a part.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Role {
    /// True if points of the file may lie in the part's columns or next to them.
    reads: bool,
    /// True if the file's points that make no voxel count in this part.
    owns: bool,
    /// True if other parts also read the file.
    shared: bool,
    /// Number in the plan file; for equal files, that of the first.
    number: u32,
    bounds: Option<StatedBounds>,
}

impl Role {
    /// Returns the role of `input` in the part `shard` of `file`.
    fn of(file: &PlanFile, shard: Shard, input: &InputFacts, reach: i64) -> Self {
        let meets = |first, last| meets(&file.plan.frame, reach, input, first, last);
        let reads = meets(shard.first, shard.last);
        let before = shard.first > 0 && meets(0, shard.first - 1);
        let behind = shard.last < u64::MAX && meets(shard.last + 1, u64::MAX);
        let number = file.number_of(input.fingerprint) as u32;
        Self { reads, owns: reads && !before, shared: before || behind, number, bounds: input.bounds }
    }
}

/// Returns how far from a pixel anything solid may affect it (pixels). A component that reaches farther than the number
/// of voxels up to which components are dropped is kept, whatever lies beyond; holes are closed by the floors around
/// them. With splats, up to four voxels may count for one.
pub(super) fn reach(plan: &Plan, has_splats: bool) -> i64 {
    let holes = match plan.options.fill_holes {
        0 => 0,
        widest => Closer::reach(widest),
    };
    let floaters = i64::from(plan.options.drop_floaters) * if has_splats { i64::from(WHOLE) } else { 1 };
    HALO_PIXELS + holes + floaters
}

/// Returns whether points of `input` may lie within `reach` pixels of the columns `first..=last`.
pub(super) fn meets(frame: &Frame, reach: i64, input: &InputFacts, first: u64, last: u64) -> bool {
    match &input.bounds {
        Some(bounds) => QuadCell::WHOLE.meets(&tiles(frame, bounds, reach), first, last),
        None => true,
    }
}

impl ShardScope {
    /// Creates the part that `options` ask for. The `inputs` must be those of its plan file, or the `chosen` ones
    /// of them.
    pub fn new(
        shard: ShardOptions,
        inputs: (&InputSet, &SplatSet),
        plan: &Plan,
        options: &ConvertOptions,
        colour: Option<ColourPlan>,
        chosen: Option<&Chosen>,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let facts = match &options.plan_file {
            Some(_) => InputFacts::of(inputs, options.resources.threads, monitor)?,
            None => InputFacts::measured(inputs, options.resources.threads, monitor)?,
        };
        let reach = reach(plan, !inputs.1.is_empty());
        let fingerprints: Vec<u128> = facts.iter().map(|input| input.fingerprint).collect();
        if let (Some(file), Some(chosen)) = (&options.plan_file, chosen) {
            file.check_same_options(plan, options)?;
            return Self::of_chosen(file, chosen, &facts, reach);
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
        // Files of equal fingerprint may have different bounds if the plan was edited by hand.
        let mut inputs: HashMap<u128, Vec<&InputFacts>> = HashMap::new();
        file.inputs.iter().for_each(|input| inputs.entry(input.fingerprint).or_default().push(input));
        let role =
            |fingerprint: &u128| Some(Role::of(file, shard, inputs.get_mut(fingerprint).and_then(Vec::pop)?, reach));
        // Finds a role for every input, because the inputs are those of the plan file.
        let roles: Vec<Role> = fingerprints.iter().filter_map(role).collect();
        Self::with(file, shard, roles, reach, true)
    }

    /// Creates the part if all inputs but the `chosen` ones stay closed.
    fn of_chosen(file: &PlanFile, chosen: &Chosen, facts: &[InputFacts], reach: i64) -> Result<Self> {
        let mut inputs: HashMap<u128, Vec<&InputFacts>> = HashMap::new();
        for (input, _) in file.inputs.iter().zip(&chosen.is_closed).filter(|(_, is_closed)| !**is_closed) {
            inputs.entry(input.fingerprint).or_default().push(input);
        }
        let mut roles = Vec::with_capacity(facts.len());
        for here in facts {
            let known = inputs.get_mut(&here.fingerprint).and_then(Vec::pop);
            roles.push(Role::of(file, chosen.shard, known.ok_or_else(|| PlanFile::stranger(&here.name))?, reach));
        }
        if let Some(missing) = inputs.values().flatten().map(|input| &input.name).min() {
            return Err(PlanFile::left_out(missing));
        }
        Self::with(file, chosen.shard, roles, reach, chosen.closed.is_empty())
    }

    fn with(file: &PlanFile, shard: Shard, roles: Vec<Role>, reach: i64, all: bool) -> Result<Self> {
        let shared = roles.iter().filter(|role| role.reads && role.shared).count();
        if shared > InputRead::MOST {
            let what = "inputs that several parts read (join files, or convert fewer at once)";
            return Err(Error::limit(what, shared, InputRead::MOST));
        }
        let reads_all = all && roles.iter().all(|role| role.reads);
        Ok(Self { shard, roles, reads_all, frame: file.plan.frame, reach })
    }

    /// Ties the part to these stations, so that it cannot be merged with parts that used others.
    pub fn sees_from(&mut self, stations: &[Station]) {
        let bits = |station: &Station| [&station.at[..], &[station.within_m]].concat().into_iter().map(f64::to_bits);
        let hash = |station: &Station| xxh3_128(&bits(station).flat_map(u64::to_le_bytes).collect::<Vec<u8>>());
        // Independent of the order, which depends on the paths of the files.
        let all = stations.iter().map(hash).fold(0, u128::wrapping_add);
        self.shard.plan_file = self.shard.plan_file.wrapping_add(all);
    }

    /// Returns a predicate: whether the part needs the records of a tile column, because it is its own or within reach.
    pub fn keeps(&self) -> impl Fn(ColumnIndex) -> bool + Send + 'static {
        let Shard { first, last, .. } = self.shard;
        // A column already has a halo.
        let around = (self.reach - HALO_PIXELS + TILE_PIXELS - 1).div_euclid(TILE_PIXELS);
        move |ColumnIndex { tx, ty, .. }| {
            if around == 0 {
                return (first..=last).contains(&morton(tx, ty));
            }
            let along = |tile: i32| (i64::from(tile) - around, i64::from(tile) + around);
            QuadCell::WHOLE.meets(&TileRect { x: along(tx), y: along(ty) }, first, last)
        }
    }

    /// Returns the hashes of the inputs that other parts read too, given the hashes of all inputs.
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

    /// Returns whether the part needs a file.
    pub fn reads(&self, file: usize) -> bool {
        self.roles[file].reads
    }

    /// Returns whether a file's points that make no voxel count in this part.
    pub fn owns(&self, file: usize) -> bool {
        self.roles[file].owns
    }

    /// Returns whether the triangles of meshes, and splats, count in this part.
    pub fn owns_meshes(&self) -> bool {
        self.shard.index == 1
    }

    /// Returns whether the part needs every file.
    pub fn reads_all(&self) -> bool {
        self.reads_all
    }

    /// Fails if points of a file, from `min` to `max`, lie where other parts would not look for them.
    pub fn check_bounds(&self, scan: &ScanFile, file: usize, min: [f64; 3], max: [f64; 3]) -> Result<()> {
        let Some(stated) = self.roles[file].bounds else { return Ok(()) };
        // Heights do not decide which parts need a file.
        if (0..2).all(|axis| stated.min[axis] <= min[axis] && max[axis] <= stated.max[axis]) {
            return Ok(());
        }
        let reason = format!(
            "points from {min:?} to {max:?} lie outside the bounds that its header states, by which parts choose their \
             files; write a plan, set the file's bounds in it to null, and convert every part again with it"
        );
        Err(Error::input(scan.path(), "bounds", reason))
    }

    /// Returns how many points of `batch` lie in the part's columns, and their bounds.
    pub fn own(&self, batch: &PointBatch) -> (u64, [f64; 3], [f64; 3]) {
        let (mut count, mut min, mut max) = (0, [f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        let columns = self.shard.columns();
        let mut last = None;
        for ((&x, &y), &z) in batch.x.iter().zip(&batch.y).zip(&batch.z) {
            let tile = [x, y].map(|v| self.frame.pixel_of(v).div_euclid(TILE_PIXELS) as i32);
            // Consecutive points usually lie in the same tile.
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
