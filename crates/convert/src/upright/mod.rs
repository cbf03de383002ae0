//! `--up auto`: the direction that points up, from the floor of the scans and splats.

mod find;
mod sample;

pub use find::UpFound;

use super::splats::SplatSet;
use super::work::for_each_batch;
use crate::input::InputSet;
use crate::placement::Similarity;
use crate::{ConvertOptions, Error, Monitor, Parameter, Result};
use find::{Patch, find};
use sample::Sample;
use std::sync::{Mutex, PoisonError};

/// Rotation that turns scans and splats upwards, after the axes that a format or [`PlanOptions::up`] states.
///
/// [`PlanOptions::up`]: crate::plan::PlanOptions::up
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Turn {
    /// None.
    #[default]
    None,
    /// Turns this direction of the input (a unit vector) upwards.
    From([f64; 3]),
    /// As the floor shows. Refused if that is not sure.
    Auto,
}

impl UpFound {
    /// Returns the rotation that turns the direction to z.
    pub fn turn(&self) -> Similarity {
        Similarity::raising(self.up)
    }
}

/// Finds the direction that points up in unplaced scans and splats. Cost: reads all of them once. Memory: 40 MB.
pub(super) fn find_up(
    scans: &InputSet,
    splats: &SplatSet,
    options: &ConvertOptions,
    monitor: &dyn Monitor,
) -> Result<UpFound> {
    monitor.stage("floor", scans.points_stated().saturating_add(splats.count()), "points and splats");
    let sample = Mutex::new(Sample::default());
    for_each_batch(scans, options.resources.threads, monitor, &|_| true, &|_, batch| {
        let mut sample = sample.lock().unwrap_or_else(PoisonError::into_inner);
        for ((&x, &y), &z) in batch.x.iter().zip(&batch.y).zip(&batch.z) {
            sample.add(Patch { at: [x, y, z], normal: None });
        }
        drop(sample);
        monitor.advance(batch.len() as u64);
        true
    })?;
    let mut sample = sample.into_inner().unwrap_or_else(PoisonError::into_inner);
    splats.for_each_solid(options, monitor, &mut |ellipsoid| {
        let Some(normal) = ellipsoid.normal else {
            return sample.add(Patch { at: ellipsoid.centre, normal: None });
        };
        // A disc is sampled at nine places, because it may be larger than the cells in which areas are measured.
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| ellipsoid.radii[a].total_cmp(&ellipsoid.radii[b]));
        let [_, u, v] = order;
        for su in [-0.6, 0.0, 0.6] {
            for sv in [-0.6, 0.0, 0.6] {
                let along = |k: usize, share: f64, axis: usize| share * ellipsoid.radii[k] * ellipsoid.axes[k][axis];
                let at = [0, 1, 2].map(|axis| ellipsoid.centre[axis] + along(u, su, axis) + along(v, sv, axis));
                sample.add(Patch { at, normal: Some(normal.map(|v| v as f32)) });
            }
        }
    })?;
    let z_is_likely = splats.is_empty();
    find(sample.finish(), z_is_likely).map_err(|reason| {
        let reason = format!("{reason}; name the axis (--up x, y, z, -x, -y or -z), or turn the input by --transform");
        Error::parameter(Parameter::Other("automatic up".into()), reason)
    })
}
