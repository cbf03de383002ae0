//! One part of a conversion: which files it reads, and which points count in it.

use super::facts::{InputFacts, fingerprint};
use super::job::Job;
use super::options::{ConvertOptions, ShardOptions};
use super::split::{Cell, tiles};
use crate::archive::Shard;
use crate::frame::{Frame, TILE_PIXELS, morton};
use crate::input::{InputSet, PointBatch, ScanFile, StatedBounds};
use crate::plan::Plan;
use crate::voxel::record::HALO_PIXELS;
use crate::{Error, Result};
use std::collections::HashMap;

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
    pub fn new(shard: &ShardOptions, set: &InputSet, plan: &Plan, options: &ConvertOptions) -> Result<Self> {
        let here = Job::of(set, plan.clone(), options)?;
        let job = match &shard.job {
            Some(job) => {
                job.check_same_inputs(&here)?;
                job
            }
            None => &here,
        };
        let shard = job.shard(shard.index, shard.count)?;
        let role = |input: &InputFacts| {
            let meets = |first, last| match &input.bounds {
                Some(bounds) => Cell::WHOLE.meets(&tiles(&plan.frame, bounds, HALO_PIXELS), first, last),
                None => true,
            };
            let reads = meets(shard.first, shard.last);
            let owns = reads && (shard.first == 0 || !meets(0, shard.first - 1));
            Role { reads, owns, bounds: input.bounds }
        };
        // Files of equal fingerprint may differ in the bounds that a person put into the plan.
        let mut inputs: HashMap<u128, Vec<&InputFacts>> = HashMap::new();
        job.inputs.iter().for_each(|input| inputs.entry(input.fingerprint).or_default().push(input));
        let mut roles = Vec::with_capacity(set.files().len());
        for file in set.files() {
            let Some(input) = inputs.get_mut(&fingerprint(file.path())?).and_then(Vec::pop) else {
                return Err(Error::input(file.path(), "content", "it changed while it was opened; start again"));
            };
            roles.push(role(input));
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

    /// Whether the triangles of meshes count in this part.
    pub fn owns_meshes(&self) -> bool {
        self.shard.index == 1
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
