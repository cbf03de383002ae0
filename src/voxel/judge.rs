//! Floors and obstacles: the verdict per voxel.
//!
//! In: the voxels of a tile column with a halo of one pixel. Out: for each voxel whether it is an obstacle. Every rule
//! reads exact integers, so verdicts depend neither on the order of points nor on where tiles and slices end.
//!
//! *Pieces and runs.* The matter of a pixel is known in sixteenths of a slice; a piece is a stretch of them without a
//! void. Pieces are connected to a run when the void between them is at most a pixel's width, or when a neighbouring
//! pixel has matter well inside it and the pixel opposite has not the same void: so walls of few points are runs, while
//! the top and the underside of a floor slab, with nothing between, are not, even beside a wall. A plane of slope θ extends at most `√2·t·tan θ` within a pixel, whatever its heading; a
//! run that extends further is steeper.
//!
//! - [`Classifier::Span`]: a run higher than `√2·t·tan(limit)` is an obstacle.
//! - [`Classifier::Thesis`]: a voxel whose points differ by more than a third of the slice height (thesis, algorithm
//!   3.3, with all points of the voxel in place of the last one, which removes its dependence on their order).
//! - [`Classifier::Plane`]: runs clearly steeper than the limit are obstacles as above; any other voxel is judged by
//!   the least-squares plane through the points of the connected voxels in 3 × 3 pixels. Where the points do not
//!   determine a plane, or do not lie on one (stair edges, kerbs), the extents decide.
//!
//! Surfaces of meshes have a true slope, whatever the classifier: a voxel with a surface steeper than the limit is an
//! obstacle, one with other surfaces and no points is floor. Towards points, surfaces count as matter in the runs.

use super::fold::{Area, BINS, Moments, Patch, Sums, Voxel, neighbourhood};
use super::record::{PATCH_PIXELS, SLICE_STEPS, SUBPIXELS};
use crate::frame::{Frame, SLICE_QUANTA};
use crate::plan::{Classifier, Plan};
use nalgebra::{Matrix2, Vector2};

/// Runs are called steep without a fit from this far above the limit: below it, noise on a floor at the limit must
/// not make it an obstacle, and the fit is exact enough to tell.
const CLEARLY_STEEPER_DEG: f64 = 10.0;
/// A neighbour belongs to the same surface if a plane this much steeper than the limit could connect the two.
const CONNECTED_STEEPER_DEG: f64 = 15.0;
/// No angle beyond this is used as a bound: its tangent would connect everything.
const STEEPEST_BOUND_DEG: f64 = 80.0;
/// Least standard deviation of the points' places across their main direction that determines a plane (pixels).
const LEAST_SPREAD_PIXELS: f64 = 0.2;
/// Greatest root mean square distance of points from a plane that they are said to lie on (pixels).
const GREATEST_RESIDUAL_PIXELS: f64 = 0.3;

/// Judges voxels by one of the rules.
#[derive(Debug, Clone, Copy)]
pub struct Judge {
    classifier: Classifier,
    /// Slope in steps of height per 1/128 pixel, squared, above which a plane is an obstacle.
    steep_squared: f64,
    /// Extents of runs (quanta).
    steep_run: f64,
    clearly_steep_run: f64,
    /// Vertical gap across which voxels of neighbouring pixels are connected (quanta).
    reach: i64,
    /// Vertical extent of connected matter in a 3 × 3 × 3 neighbourhood that a surface at the limit cannot have (quanta).
    steep_neighbourhood: f64,
    /// Gap between voxels of one pixel across which they are connected without further evidence (quanta).
    pixel: f64,
    /// How far a surface at the limit can reach into a gap from its ends, one pixel further (quanta).
    intrusion: f64,
    /// Greatest mean square residual of a plane (steps²).
    greatest_square: f64,
    /// Connected matter that extends no further than this is no steep plane (quanta).
    level: i64,
}

impl Judge {
    /// A judge for archives of `plan`.
    pub fn new(plan: &Plan) -> Self {
        let frame: &Frame = &plan.frame;
        let quanta_per_pixel = frame.pixel_m() / frame.quantum_m();
        let tangent = |deg: f64| if deg >= 90.0 { f64::INFINITY } else { deg.to_radians().tan() };
        let limit = plan.options.max_slope_deg;
        let bound = |more: f64| (limit + more).min(STEEPEST_BOUND_DEG.max(limit));
        let steps_per_pixel = frame.pixel_m() / frame.slice_m() * SLICE_STEPS as f64;
        let steep = tangent(limit) * steps_per_pixel / SUBPIXELS as f64;
        let run = |deg: f64| std::f64::consts::SQRT_2 * tangent(deg) * quanta_per_pixel;
        Self {
            classifier: plan.options.classifier,
            steep_squared: steep * steep,
            steep_run: run(limit),
            clearly_steep_run: run(bound(CLEARLY_STEEPER_DEG)),
            // Gaps are whole quanta, so the part behind the point decides nothing.
            reach: (tangent(bound(CONNECTED_STEEPER_DEG).min(STEEPEST_BOUND_DEG)) * quanta_per_pixel) as i64,
            steep_neighbourhood: 3.0 * tangent(limit) * quanta_per_pixel,
            pixel: quanta_per_pixel,
            intrusion: run(limit),
            greatest_square: (GREATEST_RESIDUAL_PIXELS * steps_per_pixel).powi(2),
            level: level(tangent(limit), quanta_per_pixel),
        }
    }

    /// Sets `verdicts` to one verdict per voxel of `patch`: true for an obstacle. Only those of pixels in `area` are
    /// meant to be used; the halo's are computed from less.
    pub fn judge(&self, patch: &Patch, sums: &mut Sums, area: Area, verdicts: &mut Vec<bool>) {
        verdicts.clear();
        verdicts.resize(patch.voxels().len(), false);
        if patch.voxels().iter().any(Voxel::has_points) {
            self.judge_points(patch, sums, area, verdicts);
        }
        for (verdict, voxel) in verdicts.iter_mut().zip(patch.voxels()) {
            *verdict = voxel.is_steep() || voxel.has_points() && *verdict;
        }
    }

    /// Verdicts on voxels with points; those on others mean nothing.
    fn judge_points(&self, patch: &Patch, of_voxels: &mut Sums, area: Area, verdicts: &mut [bool]) {
        match self.classifier {
            Classifier::Thesis => {
                for (verdict, voxel) in verdicts.iter_mut().zip(patch.voxels()) {
                    *verdict = i64::from(voxel.top - voxel.bottom) > SLICE_QUANTA / 3;
                }
            }
            Classifier::Span => self.mark_runs(patch, area, self.steep_run, verdicts),
            Classifier::Plane => {
                self.mark_runs(patch, area, self.clearly_steep_run, verdicts);
                // What stays out of the fits is decided by each pixel alone, so that it does not depend on which
                // neighbours of the halo are at hand.
                let mut steep_alone = vec![false; verdicts.len()];
                for pixel in patch.occupied() {
                    let alone = |below: &Piece, above: &Piece| (above.low - below.high) as f64 <= self.pixel;
                    mark_steep(patch, pixel, alone, self.clearly_steep_run, &mut steep_alone);
                }
                for pixel in patch.occupied().filter(|&pixel| area.holds(pixel)) {
                    let mut around = Around::new(patch, pixel);
                    for number in patch.range(pixel) {
                        let centre = &patch.voxels()[number];
                        if verdicts[number] || !centre.has_points() {
                            continue;
                        }
                        around.climb(patch, centre.slice);
                        verdicts[number] = self.is_steep(patch, of_voxels, &steep_alone, &around, number);
                    }
                }
            }
        }
    }

    /// Marks the runs of all pixels in `area` that extend further than `greatest_extent` (quanta).
    fn mark_runs(&self, patch: &Patch, area: Area, greatest_extent: f64, verdicts: &mut [bool]) {
        for pixel in patch.occupied().filter(|&pixel| area.holds(pixel)) {
            let connected = |below: &Piece, above: &Piece| self.connected(patch, pixel, below, above);
            mark_steep(patch, pixel, connected, greatest_extent, verdicts);
        }
    }

    /// Whether two neighbouring pieces of `pixel` are parts of one run (see the module text).
    fn connected(&self, patch: &Patch, pixel: usize, below: &Piece, above: &Piece) -> bool {
        let void = (above.low - below.high) as f64;
        if void <= self.pixel {
            return true;
        }
        let margin = (void / 4.0).max(self.intrusion);
        if 2.0 * margin >= void {
            return false;
        }
        let (low, high) = (below.high as f64 + margin, above.low as f64 - margin);
        let reaches_in = |neighbour: usize| {
            let voxels = &patch.voxels()[patch.around(neighbour, (below.high / SLICE_QUANTA) as u32)];
            voxels
                .iter()
                .any(|v| quanta_above(v, 0, v.top) as f64 >= low && quanta_above(v, 0, v.bottom) as f64 <= high)
        };
        let around = |neighbour: usize, height: i64| {
            pieces(&patch.voxels()[patch.around(neighbour, (height / SLICE_QUANTA) as u32)])
        };
        let matter = |neighbour: usize| around(neighbour, below.high);
        let inside = |piece: Piece| low <= piece.low as f64 && piece.high as f64 <= high;
        let near = |a: i64, b: i64| (a - b).abs() as f64 <= self.intrusion;
        // The same void, between the same ends: what a slab has in common with its next pixel, and a wall has not.
        let same_void = |neighbour: usize| {
            matter(neighbour).any(|piece| near(piece.high, below.high))
                && around(neighbour, above.low).any(|piece| near(piece.low, above.low))
                && !matter(neighbour).any(|piece| piece.high as f64 > low && (piece.low as f64) < high)
        };
        neighbourhood(pixel).any(|(neighbour, ..)| {
            reaches_in(neighbour) && matter(neighbour).any(inside) && !same_void(2 * pixel - neighbour)
        })
    }

    /// Verdict on one voxel by the surface around it.
    fn is_steep(
        &self,
        patch: &Patch,
        of_voxels: &mut Sums,
        steep_alone: &[bool],
        around: &Around,
        number: usize,
    ) -> bool {
        let centre = &patch.voxels()[number];
        let first_slice = i64::from(centre.slice) - 1;
        let (low, high) =
            (quanta_above(centre, first_slice, centre.bottom), quanta_above(centre, first_slice, centre.top));
        let (mut lowest, mut highest) = (low, high);
        // At most three voxels in each of nine pixels.
        let mut connected = [(0, 0, 0); 27];
        let mut count = 0;
        for (place, range) in around.ranges().enumerate() {
            for other in range {
                let voxel = &patch.voxels()[other];
                let bottom = quanta_above(voxel, first_slice, voxel.bottom);
                let top = quanta_above(voxel, first_slice, voxel.top);
                let gap = (bottom - high).max(low - top);
                if !steep_alone[other] && gap <= self.reach {
                    (lowest, highest) = (lowest.min(bottom), highest.max(top));
                    connected[count] = (other, place as i64 % 3, place as i64 / 3);
                    count += 1;
                }
            }
        }
        let chain_is_steep = || chain_extent(patch, around, centre) as f64 > self.steep_neighbourhood;
        if highest - lowest <= self.level && !chain_is_steep() {
            return false;
        }
        let mut sums = Moments::default();
        for &(other, dx, dy) in &connected[..count] {
            let pixel = around.pixel + dy as usize * PATCH_PIXELS + dx as usize - PATCH_PIXELS - 1;
            let slices = i64::from(patch.voxels()[other].slice) - first_slice;
            sums.add_shifted(of_voxels.of(patch, pixel, other), dx, dy, slices);
        }
        match self.fit(&sums) {
            Fit::Plane { slope_squared } => slope_squared > self.steep_squared,
            Fit::NoPlane => self.run_extent(patch, around.pixel, number) as f64 > self.steep_run,
            Fit::Undetermined => chain_is_steep(),
        }
    }

    fn fit(&self, sums: &Moments) -> Fit {
        let central =
            |n: i64, ab: i64, a: i64, b: i64| (i128::from(n) * i128::from(ab) - i128::from(a) * i128::from(b)) as f64;
        let Moments { n, u, v, w, .. } = *sums;
        let [cuu, cuv, cvv] =
            [(sums.uu, u, u), (sums.uv, u, v), (sums.vv, v, v)].map(|(ab, a, b)| central(n, ab, a, b));
        let [cuw, cvw, cww] =
            [(sums.uw, u, w), (sums.vw, v, w), (sums.ww, w, w)].map(|(ab, a, b)| central(n, ab, a, b));
        let square = (n as f64) * (n as f64);
        let half_trace = (cuu + cvv) / 2.0;
        let half_difference = (cuu - cvv) / 2.0;
        // Only operations that IEEE 754 rounds exactly, so that every machine gives the same verdict.
        let smaller = half_trace - (half_difference * half_difference + cuv * cuv).sqrt();
        let least = (LEAST_SPREAD_PIXELS * SUBPIXELS as f64).powi(2) * square;
        let covariance = Matrix2::new(cuu, cuv, cuv, cvv);
        let Some(inverse) = covariance.try_inverse().filter(|_| n >= 3 && smaller >= least) else {
            return Fit::Undetermined;
        };
        let gradient = inverse * Vector2::new(cuw, cvw);
        let residual = (cww - gradient.dot(&Vector2::new(cuw, cvw))) / square;
        if residual > self.greatest_square {
            return Fit::NoPlane;
        }
        Fit::Plane { slope_squared: gradient.norm_squared() }
    }

    /// Greatest extent of a run that the voxel has a piece of (quanta).
    fn run_extent(&self, patch: &Patch, pixel: usize, number: usize) -> i64 {
        let range = patch.range(pixel);
        let own = number - range.start;
        let mut greatest = 0;
        let connected = |below: &Piece, above: &Piece| self.connected(patch, pixel, below, above);
        for_each_run(&patch.voxels()[range], connected, |voxels, extent| {
            if voxels.contains(&own) {
                greatest = greatest.max(extent);
            }
        });
        greatest
    }
}

/// Vertical extent (quanta) up to which connected matter is no steep plane, whatever its points.
///
/// The gradient `g` of a least-squares plane explains no more than all variance of the heights: `|g|²·λ ≤ var(w)`, where
/// `λ`, the least variance of the places, is at least [`LEAST_SPREAD_PIXELS`]² or the plane is undetermined. Heights
/// within `h` have at most the variance `h²/4`. So up to `h = 2·LEAST_SPREAD·tan(limit)` no plane is too steep, and up to
/// `2·GREATEST_RESIDUAL` every plane fits.
fn level(tangent: f64, quanta_per_pixel: f64) -> i64 {
    // A little less, for the rounding of the fit.
    (2.0 * 0.999 * (LEAST_SPREAD_PIXELS * tangent).min(GREATEST_RESIDUAL_PIXELS) * quanta_per_pixel) as i64
}

/// The voxels of 3 × 3 pixels in three slices, which move up with the voxels of the pixel in the middle.
struct Around {
    pixel: usize,
    /// Per pixel of the neighbourhood: numbers of the first voxel in these slices, of the first above them, and of the
    /// first of the next pixel.
    places: [[usize; 3]; 9],
}

impl Around {
    fn new(patch: &Patch, pixel: usize) -> Self {
        let mut places = [[0; 3]; 9];
        for (place, (neighbour, ..)) in places.iter_mut().zip(neighbourhood(pixel)) {
            let range = patch.range(neighbour);
            *place = [range.start, range.start, range.end];
        }
        Self { pixel, places }
    }

    /// Moves up to the slices `slice − 1 ..= slice + 1`.
    #[inline]
    fn climb(&mut self, patch: &Patch, slice: u32) {
        let voxels = patch.voxels();
        for [first, above, end] in &mut self.places {
            while *first < *end && voxels[*first].slice + 1 < slice {
                *first += 1;
            }
            *above = (*first).max(*above);
            while *above < *end && voxels[*above].slice <= slice + 1 {
                *above += 1;
            }
        }
    }

    /// Numbers of the voxels, pixel by pixel in the order of [`neighbourhood`].
    fn ranges(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        self.places.iter().map(|&[first, above, _]| first..above)
    }
}

/// Vertical extent of the matter in the 3 × 3 × 3 neighbourhood of a voxel that hangs together with it across voids
/// of less than a slice height (quanta): where few points stand in a line, what tells a wall from an edge.
fn chain_extent(patch: &Patch, around: &Around, centre: &Voxel) -> i64 {
    const SLICE: u32 = BINS as u32;
    let mut bins = 0u64;
    for voxel in around.ranges().flat_map(|range| &patch.voxels()[range]) {
        // Slices below, at and above the centre take the bits 0, 16 and 32.
        bins |= u64::from(voxel.bins) << ((voxel.slice + 1 - centre.slice) * SLICE);
    }
    let start = SLICE + centre.bins.trailing_zeros();
    let (mut low, mut high) = (start, start);
    loop {
        let above = (bins >> (high + 1)).trailing_zeros();
        if above >= SLICE {
            break;
        }
        high += 1 + above;
    }
    while low > 0 {
        let below = (bins << (64 - low)).leading_zeros();
        if below >= SLICE {
            break;
        }
        low -= 1 + below;
    }
    i64::from(high - low) * SLICE_QUANTA / BINS
}

enum Fit {
    Plane { slope_squared: f64 },
    NoPlane,
    Undetermined,
}

fn quanta_above(voxel: &Voxel, first_slice: i64, quantum: u8) -> i64 {
    (i64::from(voxel.slice) - first_slice) * SLICE_QUANTA + i64::from(quantum)
}

/// A stretch of matter in one voxel, in quanta above the column block's floor.
#[derive(Debug, Clone, Copy)]
struct Piece {
    /// Number of the voxel in its pixel.
    voxel: usize,
    low: i64,
    high: i64,
}

/// The pieces of a pixel's voxels, lowest first.
fn pieces(voxels: &[Voxel]) -> impl Iterator<Item = Piece> {
    voxels.iter().enumerate().flat_map(|(number, voxel)| {
        let floor = i64::from(voxel.slice) * SLICE_QUANTA;
        let mut left = u32::from(voxel.bins);
        std::iter::from_fn(move || {
            if left == 0 {
                return None;
            }
            let first = left.trailing_zeros();
            let end = first + (!(left >> first)).trailing_zeros();
            left &= !0 << end;
            // Bins are coarse; the voxel's own ends are exact.
            let low = if first == voxel.bins.trailing_zeros() {
                i64::from(voxel.bottom)
            } else {
                i64::from(first) * SLICE_QUANTA / BINS
            };
            let high = if left == 0 { i64::from(voxel.top) } else { i64::from(end) * SLICE_QUANTA / BINS };
            Some(Piece { voxel: number, low: floor + low, high: floor + high })
        })
    })
}

/// Calls `give` with the voxels and the extent (quanta) of each run: pieces in adjacent slices, each `connected` to the
/// next.
fn for_each_run(
    voxels: &[Voxel],
    connected: impl Fn(&Piece, &Piece) -> bool,
    mut give: impl FnMut(std::ops::RangeInclusive<usize>, i64),
) {
    let mut run: Option<(Piece, Piece)> = None;
    for piece in pieces(voxels) {
        run = Some(match run {
            Some((first, last))
                if voxels[piece.voxel].slice - voxels[last.voxel].slice <= 1 && connected(&last, &piece) =>
            {
                (first, piece)
            }
            ended => {
                if let Some((first, last)) = ended {
                    give(first.voxel..=last.voxel, last.high - first.low);
                }
                (piece, piece)
            }
        });
    }
    if let Some((first, last)) = run {
        give(first.voxel..=last.voxel, last.high - first.low);
    }
}

/// Marks the runs of one pixel that extend further than `greatest_extent` (quanta).
fn mark_steep(
    patch: &Patch,
    pixel: usize,
    connected: impl Fn(&Piece, &Piece) -> bool,
    greatest_extent: f64,
    verdicts: &mut [bool],
) {
    let range = patch.range(pixel);
    let mut start = range.start;
    // No run goes past an empty slice, so most pixels need no look at their pieces.
    for stack in patch.voxels()[range].chunk_by(|below, above| above.slice - below.slice <= 1) {
        if let [first, .., last] | [first @ last] = stack
            && (quanta_above(last, first.slice.into(), last.top) - i64::from(first.bottom)) as f64 > greatest_extent
        {
            for_each_run(stack, &connected, |voxels, extent| {
                if extent as f64 > greatest_extent {
                    verdicts[start + voxels.start()..=start + voxels.end()].fill(true);
                }
            });
        }
        start += stack.len();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::PlanOptions;
    use crate::voxel::record::{Record, Recorder};

    const T: f64 = 0.05;

    fn plan(classifier: Classifier, max_slope_deg: f64) -> Plan {
        let options = PlanOptions { max_slope_deg, classifier, ..PlanOptions::default() };
        Plan { frame: Frame::new(T, 3.0 * T).unwrap(), options }
    }

    /// A small generator of uniform numbers in 0..1 and of nearly normal ones.
    struct Random(u64);

    impl Random {
        fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }
        fn normal(&mut self) -> f64 {
            (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
        }
    }

    /// The voxels of tile (0, 0), which holds `points`.
    fn folded(plan: &Plan, points: impl Iterator<Item = [f64; 3]>) -> (Patch, Sums) {
        let recorder = Recorder::new(plan.frame);
        let mut records: Vec<Record> = Vec::new();
        for [x, y, z] in points {
            recorder.record(&[x], &[y], &[z], |index, record| {
                if (index.tx, index.ty) == (0, 0) {
                    records.push(record);
                }
            });
        }
        let (mut patch, mut sums) = (Patch::default(), Sums::default());
        patch.fold(&records, 1, Area::TILE, &mut sums);
        (patch, sums)
    }

    /// Share of voxels judged obstacle among the inner pixels of tile (0, 0), which holds `points`.
    fn obstacle_share(plan: &Plan, points: impl Iterator<Item = [f64; 3]>) -> f64 {
        obstacle_share_between(plan, points, (4, 60))
    }

    /// The same among the pixels from `x.0` to before `x.1` alone.
    fn obstacle_share_between(plan: &Plan, points: impl Iterator<Item = [f64; 3]>, x: (u32, u32)) -> f64 {
        let (patch, mut sums) = folded(plan, points);
        let inner = Area { x, y: (4, 60) };
        let mut verdicts = Vec::new();
        Judge::new(plan).judge(&patch, &mut sums, inner, &mut verdicts);
        let (mut all, mut obstacles) = (0, 0);
        for pixel in patch.occupied().filter(|&pixel| inner.holds(pixel)) {
            for number in patch.range(pixel) {
                all += 1;
                obstacles += usize::from(verdicts[number]);
            }
        }
        f64::from(obstacles as u32) / f64::from(all)
    }

    fn plane(slope_deg: f64, heading_deg: f64, per_edge: f64, noise: f64, random: &mut Random) -> Vec<[f64; 3]> {
        let (slope, heading) = (slope_deg.to_radians(), heading_deg.to_radians());
        let edge = 64.0 * T;
        // Uniform on the plane itself, as a scanner at a fair distance sees it.
        let count = (64.0 * per_edge).powi(2) / slope.cos().max(0.05);
        let phase = random.uniform() * 3.0 * T;
        (0..count as usize)
            .map(|_| {
                let (x, y) = (random.uniform() * edge, random.uniform() * edge);
                let along = (x - edge / 2.0) * heading.cos() + (y - edge / 2.0) * heading.sin();
                let z = phase + along * slope.tan();
                let off = noise * random.normal();
                let (nx, nz) = (-slope.sin(), slope.cos());
                [x + off * nx * heading.cos(), y + off * nx * heading.sin(), z + off * nz]
            })
            .collect()
    }

    #[test]
    fn the_plane_rule_flips_at_the_limit_within_three_degrees_for_every_heading_and_phase() {
        let mut random = Random(7);
        for limit in [30.0, 45.0] {
            let plan = plan(Classifier::Plane, limit);
            for noise in [0.0, 0.002] {
                for heading in [0.0, 15.0, 30.0, 45.0, 77.0, 90.0, 200.0] {
                    for (slope, obstacle) in [
                        (0.0, false),
                        (limit - 10.0, false),
                        (limit - 3.0, false),
                        (limit + 3.0, true),
                        (limit + 8.0, true),
                        (limit + 15.0, true),
                        (75.0, true),
                        (85.0, true),
                    ] {
                        let share = obstacle_share(&plan, plane(slope, heading, 2.0, noise, &mut random).into_iter());
                        let right = if obstacle { share } else { 1.0 - share };
                        assert!(right >= 0.95, "limit {limit} slope {slope} heading {heading} noise {noise}: {right}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_is_floor_without_a_fit_is_floor_by_the_fit_too() {
        let mut random = Random(31);
        let edge = 64.0 * T;
        for (limit, noise) in [(30.0, 0.002), (45.0, 0.004), (45.0, 0.012), (60.0, 0.02), (80.0, 0.03)] {
            let plan = plan(Classifier::Plane, limit);
            // From a point in three pixels to ten in one: where points hardly determine a plane, and where they do.
            let points: Vec<_> = (0..12_000)
                .map(|_| {
                    let (x, y) = (random.uniform() * edge, random.uniform().powi(3) * edge);
                    let step = f64::from((x * 3.0) as u32) * 0.05 + x * 0.2;
                    [x, y, step + noise * random.normal()]
                })
                .collect();
            let with = Judge::new(&plan);
            let without = Judge { level: -1, ..with };
            let (patch, mut sums) = folded(&plan, points.into_iter());
            let [mut fast, mut full] = [Vec::new(), Vec::new()];
            with.judge(&patch, &mut sums, Area::TILE, &mut fast);
            without.judge(&patch, &mut sums, Area::TILE, &mut full);
            assert!(fast == full, "limit {limit}, noise {noise}");
            assert!(full.contains(&false), "the test would show nothing");
        }
    }

    #[test]
    fn a_flat_floor_on_a_slice_boundary_is_floor() {
        let mut random = Random(3);
        for classifier in [Classifier::Plane, Classifier::Span] {
            let edge = 64.0 * T;
            let points =
                (0..60_000).map(|_| [random.uniform() * edge, random.uniform() * edge, 0.002 * random.normal()]);
            assert_eq!(obstacle_share(&plan(classifier, 45.0), points.collect::<Vec<_>>().into_iter()), 0.0);
        }
    }

    #[test]
    fn a_slab_scanned_from_above_and_below_is_floor_wherever_its_slices_begin() {
        let mut random = Random(17);
        let edge = 64.0 * T;
        for phase in 0..16 {
            for thickness in [0.08, 0.12, 0.2, 0.25, 0.3] {
                let top = f64::from(phase) * 3.0 * T / 16.0;
                let points: Vec<_> = (0..40_000)
                    .map(|n| {
                        let z = if n % 2 == 0 { top } else { top - thickness };
                        [random.uniform() * edge, random.uniform() * edge, z + 0.003 * random.normal()]
                    })
                    .collect();
                for classifier in [Classifier::Plane, Classifier::Span] {
                    let share = obstacle_share(&plan(classifier, 45.0), points.iter().copied());
                    assert!(share < 0.01, "{classifier:?}, {thickness} m thick, top at {top}: {share}");
                }
            }
        }
    }

    #[test]
    fn a_slab_beside_a_wall_is_floor_up_to_the_wall() {
        let mut random = Random(23);
        let edge = 64.0 * T;
        for (slab, wall) in [(40_000, 4_000), (40_000, 12_000), (150_000, 40_000)] {
            for thickness in [0.2, 0.25] {
                let mut points: Vec<_> = (0..slab)
                    .map(|n| {
                        let z = if n % 2 == 0 { 0.3 } else { 0.3 - thickness };
                        [random.uniform() * 1.6, random.uniform() * edge, z + 0.002 * random.normal()]
                    })
                    .collect();
                // The wall fills pixel 32, from 1.60 to 1.65 m.
                points.extend((0..wall).map(|_| [1.61, random.uniform() * edge, random.uniform() * 2.4 - 1.2]));
                for classifier in [Classifier::Plane, Classifier::Span] {
                    let share = |x| obstacle_share_between(&plan(classifier, 45.0), points.iter().copied(), x);
                    let (beside, own) = (share((31, 32)), share((32, 33)));
                    assert!(beside < 0.02, "{classifier:?}, {thickness} m, {wall} points: {beside} beside the wall");
                    assert!(
                        own > 0.9 || classifier == Classifier::Span,
                        "{classifier:?}, {thickness} m, {wall} points: {own} of the wall"
                    );
                }
            }
        }
    }

    #[test]
    fn stairs_are_floor_and_their_risers_are_not() {
        let mut random = Random(5);
        let edge = 64.0 * T;
        let height = |x: f64| (x / 0.3).floor() * 0.18;
        let treads: Vec<_> = (0..80_000)
            .map(|_| (random.uniform() * edge, random.uniform() * edge))
            .map(|(x, y)| [x, y, height(x)])
            .collect();
        let share = obstacle_share(&plan(Classifier::Plane, 45.0), treads.into_iter());
        assert!(share < 0.01, "treads: {share}");
        // A riser at x = 1.21, in the middle of a pixel, with its two treads.
        let riser: Vec<_> = (0..20_000).map(|_| [1.21, random.uniform() * edge, random.uniform() * 0.18]).collect();
        let share = obstacle_share(&plan(Classifier::Plane, 45.0), riser.into_iter());
        assert!(share > 0.95, "riser: {share}");
    }

    #[test]
    fn walls_are_obstacles_down_to_one_point_per_voxel() {
        let mut random = Random(11);
        let edge = 64.0 * T;
        for (density, least) in [(10.0, 0.99), (1.0, 0.9)] {
            // Points per voxel of the wall's pixels.
            let count = (64.0 * (2.4 / (3.0 * T)) * density) as usize;
            let wall: Vec<_> = (0..count).map(|_| [1.21, random.uniform() * edge, random.uniform() * 2.4]).collect();
            let share = obstacle_share(&plan(Classifier::Plane, 45.0), wall.into_iter());
            assert!(share >= least, "{density} points per voxel: {share}");
        }
    }

    #[test]
    fn mirrored_points_get_mirrored_verdicts() {
        let mut random = Random(13);
        let points = plane(45.0, 33.0, 2.0, 0.003, &mut random);
        let edge = 64.0 * T;
        // Keep off pixel borders, which are half open and so do not mirror.
        let inside = |v: f64| ((v / T).fract() - 0.5).abs() < 0.49;
        let points: Vec<_> = points.into_iter().filter(|p| inside(p[0]) && inside(p[1])).collect();
        let mirrored = points.iter().map(|&[x, y, z]| [edge - x, y, z]).collect::<Vec<_>>();
        let plan = plan(Classifier::Plane, 45.0);
        let share = obstacle_share(&plan, points.into_iter());
        assert!((0.05..0.95).contains(&share), "{share}: the test would show nothing");
        assert!((share - obstacle_share(&plan, mirrored.into_iter())).abs() < 0.01);
    }
}
