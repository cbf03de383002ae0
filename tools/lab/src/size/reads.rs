//! Reads of a walk through a generated scene, and the reads if each tile were stored alone.

use crate::stability::Result;
use scangen::{Params, Scene, Truth};
use slicewalk::archive::{Archive, Storage};
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use std::collections::BTreeSet;

/// Half the width of the pawn, and its height (m).
const PAWN_M: (f64, f64) = (0.25, 1.8);
/// Length of a step (m).
const STEP_M: f64 = 0.05;

/// Distinct parts that a walk touches.
pub struct Reads {
    /// Stored pages: one read each.
    pub pages: usize,
    /// Occupied tiles: one read each if they were files, as in the thesis.
    pub tiles: usize,
}

/// The reads of the scene's own walk; `None` for scans, and scenes without one.
pub fn along_walk(case: &str, archive: &Archive) -> Result<Option<Reads>> {
    let name = case.split(',').next().unwrap_or_default();
    let Ok(scene) = Scene::named(name, &Params::new()) else { return Ok(None) };
    let Some(walk) = scene.walk() else { return Ok(None) };
    let (mut pages, mut tiles) = (BTreeSet::new(), BTreeSet::new());
    let frame = archive.frame();
    let entries: Vec<_> = archive.entries().collect::<slicewalk::Result<_>>()?;
    let (mut at, mut ground) = ([walk.start[0], walk.start[1]], walk.start[2]);
    for to in &walk.waypoints {
        let length = (to[0] - at[0]).hypot(to[1] - at[1]);
        let steps = (length / STEP_M).ceil().max(1.0);
        for step in 0..=steps as u32 {
            let part = f64::from(step) / steps;
            let centre = [0, 1].map(|axis| at[axis] + part * (to[axis] - at[axis]));
            let tile = |axis: usize, side: f64| {
                (frame.pixel_of(centre[axis] + side * PAWN_M.0).div_euclid(TILE_PIXELS)) as i32
            };
            ground = scene.floor_under(centre[0], centre[1], ground + 0.5).map_or(ground, |(floor, _)| floor);
            let (first, last) = (frame.slice_of(ground), frame.slice_of(ground + PAWN_M.1));
            for entry in &entries {
                let inside = (tile(0, -1.0)..=tile(0, 1.0)).contains(&entry.key.tx)
                    && (tile(1, -1.0)..=tile(1, 1.0)).contains(&entry.key.ty);
                let base = i64::from(entry.key.layer) * PAGE_SLICES;
                for slice in (first - base).max(0)..=(last - base).min(PAGE_SLICES - 1) {
                    if inside && entry.slices >> slice & 1 == 1 {
                        tiles.insert((entry.key, slice));
                        match entry.storage {
                            Storage::Stored(extent) | Storage::Shared(extent) => pages.insert(extent.offset),
                            Storage::Uniform(_) => false,
                        };
                    }
                }
            }
        }
        at = *to;
    }
    Ok(Some(Reads { pages: pages.len(), tiles: tiles.len() }))
}
