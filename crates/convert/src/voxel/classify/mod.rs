//! Classification of voxels as floor or obstacle.
//!
//! In: the voxels of a tile column with a halo of one pixel. Out: for each voxel whether it is an obstacle. Every rule
//! is computed from exact integers, so the result depends neither on the order of points nor on where tiles and slices
//! end.
//!
//! *Lengths in pixels.* A slope shows over about a pixel, and the spacing of points is that of the scan. Two of the
//! three rules therefore measure in pixels, never in slices. If slices are thinner than three pixels, they combine
//! several into a [band](super::bands::Bands). Thin slices refine heights and the positions of classified voxels, but
//! do not change the classification.
//!
//! *Pieces and runs.* The solid of a pixel is known in sixteenths of a slice; a piece is a stretch of them without a
//! void. Pieces are connected to a run if the void between them is at most a pixel's width, or if a neighbouring pixel
//! has solid well inside the void and the opposite pixel does not have the same void. So walls of few points are runs,
//! while the top and the underside of a floor slab, with nothing in between, are not, even beside a wall. A plane of
//! slope θ extends at most `√2·t·tan θ` within a pixel, whatever its heading; a run that extends further is steeper.
//!
//! The rules and their guarantees:
//!
//! - [`Classifier::Plane`]: runs clearly steeper than the limit are obstacles. Any other voxel is classified by the
//!   least-squares plane through the points of the connected voxels in 3 × 3 pixels. If the points do not determine a
//!   plane, or do not lie on one (stair edges, kerbs), the extents decide. On planes of two or more points per pixel
//!   edge the class switches at the limit ± 3°, at every heading, grid position and slice height, for limits up to 60°.
//!   Walls are obstacles from about one point per pixel on.
//! - [`Classifier::Span`]: a run higher than `√2·t·tan(limit)` is an obstacle. A plane up to the limit never is, except
//!   for its noise; a steeper one is detected from a slope on that depends on its heading and on the density of points.
//!   The rule depends on the slice height no more than the plane rule does.
//! - [`Classifier::Thesis`]: a voxel whose points differ by more than a third of the slice height is an obstacle
//!   (thesis, algorithm 3.3, with all points of the voxel in place of the last one, which removes the dependence on
//!   their order). Kept for comparison, like in the thesis: it guarantees no angle, and depends on the slice height.
//!
//! Surfaces of meshes and flat splats have a true slope, whatever the classifier: a voxel with a surface steeper than the
//! limit is an obstacle, one with other surfaces and no points is floor. Next to points, surfaces count as solid in the
//! runs.
//!
//! Other splats do not show their slope. A voxel of nothing else follows the surfaces of known slope in 3 × 3 pixels that
//! are connected to it (a void of at most a pixel's width): it is floor if one of their voxels is, else an obstacle.
//! Without any such surface, it is floor if it is part of a surface: at least five of the eight pixels around it have solid
//! connected to it. So a lone splat, or one on the leg of a table, is nothing to stand on.

mod extents;
mod pieces;
mod surface;
#[cfg(test)]
mod tests;
mod windows;

use super::accumulate::{Area, Patch, Sums, Voxel, neighbourhood};
use super::bands::Bands;
use crate::frame::SLICE_QUANTA;
use crate::plan::{Classifier, Plan, rise_of};
use extents::Extents;
use pieces::Runs;
use std::ops::Deref;
use surface::{Around, Surfaces, VoxelClass};
use windows::Windows;

/// Runs are steep without a fit from this far above the limit. Closer to it, noise must not make a floor at the limit
/// an obstacle, and the fit is exact enough to decide.
const CLEARLY_STEEPER_DEG: f64 = 10.0;
/// A neighbour belongs to the same surface if a plane this much steeper than the limit could connect the two.
const CONNECTED_STEEPER_DEG: f64 = 15.0;
/// Number of pixels to fit in a patch from which on the sums of all pixels are computed together.
const LEAST_WINDOWS: usize = 512;
/// Pixels around one with solid, from which on it is part of a surface. A straight edge has five.
const LEAST_BESIDE: usize = 5;
/// No angle beyond this is used as a bound, because its tangent would connect everything.
const STEEPEST_BOUND_DEG: f64 = 80.0;

/// Classifies voxels by one of the rules.
#[derive(Debug, Clone, Copy)]
pub struct VoxelClassifier {
    classifier: Classifier,
    bands: Bands,
    runs: Runs,
    surfaces: Surfaces,
    /// Extents of runs (quanta).
    steep_run: f64,
    clearly_steep_run: f64,
    /// Widest void between connected voxels without points (quanta).
    connected: i64,
    least_windows: usize,
}

/// Classes of a patch's voxels, true for an obstacle, and the buffers for computing them; reused.
#[derive(Debug, Default)]
pub struct VoxelClasses {
    of_voxels: Vec<bool>,
    /// Voxels that are excluded from fits.
    steep_alone: Vec<bool>,
    extents: Extents,
    /// Pixels that are not settled as floor by their low height.
    open: Vec<usize>,
    windows: Windows,
    around: Around,
    /// Extents of the runs of a pixel.
    of_runs: Vec<i64>,
}

impl Deref for VoxelClasses {
    type Target = [bool];

    fn deref(&self) -> &[bool] {
        &self.of_voxels
    }
}

impl VoxelClassifier {
    /// Creates the classifier for archives of `plan`.
    pub fn new(plan: &Plan) -> Self {
        let (frame, limit) = (&plan.frame, plan.options.max_slope_deg);
        let bands = Bands::new(plan);
        let bound = |more: f64| (limit + more).min(STEEPEST_BOUND_DEG.max(limit));
        let quanta_per_pixel = frame.pixel_m() / frame.quantum_m();
        let run = |deg: f64| std::f64::consts::SQRT_2 * rise_of(deg) * quanta_per_pixel;
        let reach = rise_of(bound(CONNECTED_STEEPER_DEG).min(STEEPEST_BOUND_DEG));
        Self {
            classifier: plan.options.classifier,
            bands,
            runs: Runs::new(frame, bands, run(limit)),
            surfaces: Surfaces::new(frame, bands, rise_of(limit), reach),
            steep_run: run(limit),
            clearly_steep_run: run(bound(CLEARLY_STEEPER_DEG)),
            connected: quanta_per_pixel as i64,
            least_windows: LEAST_WINDOWS,
        }
    }

    /// Sets `voxel_classes` to the classes of the voxels of `patch`. Only those of pixels in `area` are valid; those of the
    /// halo are computed from fewer neighbours.
    pub fn classify(&self, patch: &Patch, sums: &mut Sums, area: Area, voxel_classes: &mut VoxelClasses) {
        voxel_classes.of_voxels.clear();
        voxel_classes.of_voxels.resize(patch.voxels().len(), false);
        if patch.voxels().iter().any(Voxel::has_points) {
            self.judge_points(patch, sums, area, voxel_classes);
        }
        for (voxel_class, voxel) in voxel_classes.of_voxels.iter_mut().zip(patch.voxels()) {
            *voxel_class = voxel.is_steep() || voxel.has_points() && *voxel_class;
        }
        if patch.voxels().iter().any(Voxel::is_undecided) {
            for pixel in patch.occupied().filter(|&pixel| area.holds(pixel)) {
                for number in patch.range(pixel).filter(|&number| patch.voxels()[number].is_undecided()) {
                    voxel_classes.of_voxels[number] = !self.is_floor_by_neighbours(patch, pixel, number);
                }
            }
        }
    }

    /// Returns whether a voxel of unknown slope is floor.
    fn is_floor_by_neighbours(&self, patch: &Patch, pixel: usize, number: usize) -> bool {
        let (low, high) = patch.voxels()[number].quanta_above(0);
        let (low, high) = (low - self.connected, high + self.connected);
        let slice_of = |quantum: i64| quantum.div_euclid(SLICE_QUANTA).max(0) as u32;
        let (mut has_steep, mut beside) = (false, 0);
        for (other, ..) in neighbourhood(pixel) {
            let near = patch.between(other, slice_of(low)..slice_of(high) + 1).map(|number| &patch.voxels()[number]);
            let connected = near.filter(|voxel| {
                let (bottom, top) = voxel.quanta_above(0);
                bottom <= high && top >= low
            });
            let mut is_beside = false;
            for voxel in connected {
                if voxel.is_flat() {
                    return true;
                }
                has_steep |= voxel.is_steep();
                is_beside = true;
            }
            beside += usize::from(is_beside && other != pixel);
        }
        !has_steep && beside >= LEAST_BESIDE
    }

    /// Classifies voxels with points; the results for others are undefined.
    fn judge_points(&self, patch: &Patch, sums: &mut Sums, area: Area, voxel_classes: &mut VoxelClasses) {
        let VoxelClasses { of_voxels, steep_alone, extents, .. } = voxel_classes;
        let greatest_extent = match self.classifier {
            Classifier::Thesis => {
                for (voxel_class, voxel) in of_voxels.iter_mut().zip(patch.voxels()) {
                    *voxel_class = i64::from(voxel.top - voxel.bottom) > SLICE_QUANTA / 3;
                }
                return;
            }
            Classifier::Span => self.steep_run,
            Classifier::Plane => self.clearly_steep_run,
        };
        // No run extends further than the solids of its pixel.
        extents.set(patch);
        let reaches_far = |&pixel: &usize| extents.height(pixel) as f64 > greatest_extent;
        for pixel in patch.occupied().filter(reaches_far).filter(|&pixel| area.holds(pixel)) {
            self.runs.mark(patch, pixel, greatest_extent, of_voxels);
        }
        if self.classifier == Classifier::Plane {
            // Each pixel alone decides which voxels are excluded from fits, so that the result does not depend on which
            // neighbours of the halo are available.
            steep_alone.clear();
            steep_alone.resize(of_voxels.len(), false);
            for pixel in patch.occupied().filter(reaches_far) {
                self.runs.mark_alone(patch, pixel, greatest_extent, steep_alone);
            }
            self.classify_surfaces(patch, sums, area, voxel_classes);
        }
    }

    /// Classifies the voxels outside clearly steep runs.
    fn classify_surfaces(&self, patch: &Patch, sums: &mut Sums, area: Area, voxel_classes: &mut VoxelClasses) {
        let VoxelClasses { of_voxels: voxel_classes, steep_alone, extents, open, windows, around, of_runs } =
            voxel_classes;
        extents.set_around();
        // If all solid around a pixel is this low, all of it is floor, however it is connected.
        let is_low = |pixel: usize| self.surfaces.is_level(extents.height_around(pixel));
        open.clear();
        open.extend(patch.occupied().filter(|&pixel| area.holds(pixel) && !is_low(pixel)));
        let is_one_layer =
            |pixel: usize| self.surfaces.is_one_layer(extents.height_around(pixel), self.clearly_steep_run);
        let layers = open.iter().filter(|&&pixel| is_one_layer(pixel)).count();
        let lowest = sums.lowest_band().filter(|_| layers >= self.least_windows);
        lowest.into_iter().for_each(|lowest| windows.begin(lowest));
        for &pixel in &*open {
            let range = patch.range(pixel);
            if lowest.is_some()
                && is_one_layer(pixel)
                && let Some(records) = sums.few_by_pixel()
                && let Some(is_steep) = self.surfaces.plane_is_steep(&windows.around(pixel, records, self.bands))
            {
                voxel_classes[range].fill(is_steep);
                continue;
            }
            around.enter(patch, pixel);
            of_runs.clear();
            let mut rest = range.clone();
            while let Some(first) = rest.next() {
                if voxel_classes[first] || !patch.voxels()[first].has_points() {
                    continue;
                }
                let centre = self.surfaces.centre(patch, first..range.end, voxel_classes);
                rest.start = centre.numbers.end;
                match self.surfaces.voxel_class(patch, sums, steep_alone, around, &centre) {
                    VoxelClass::Floor => {}
                    VoxelClass::Obstacle => voxel_classes[centre.numbers].fill(true),
                    VoxelClass::ByRun => {
                        if of_runs.is_empty() {
                            self.runs.extents(patch, pixel, of_runs);
                        }
                        for number in centre.numbers {
                            voxel_classes[number] = of_runs[number - range.start] as f64 > self.steep_run;
                        }
                    }
                }
            }
        }
    }
}
