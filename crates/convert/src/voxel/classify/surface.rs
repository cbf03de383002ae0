//! The surface around some voxels: the plane through its points or, without one, its vertical extent.

use crate::frame::{Frame, SLICE_QUANTA};
use crate::voxel::accumulate::{BINS, Moments, Patch, Sums, Voxel, neighbour, neighbourhood};
use crate::voxel::bands::Bands;
use crate::voxel::record::{SLICE_STEPS, SUBPIXELS};
use nalgebra::{Matrix2, Vector2};
use std::ops::{BitOr, Range};

/// Least standard deviation of the points' positions across their main direction that determines a plane (pixels).
const LEAST_SPREAD_PIXELS: f64 = 0.2;
/// Greatest root mean square distance from a plane at which points are taken to lie on it (pixels).
const GREATEST_RESIDUAL_PIXELS: f64 = 0.3;
/// Void that ends a chain of solids (pixels).
const CHAIN_VOID_PIXELS: f64 = 3.0;

/// Classifies voxels by the surface around them.
#[derive(Debug, Clone, Copy)]
pub struct Surfaces {
    bands: Bands,
    /// Slope in steps of height per 1/128 pixel, squared, above which a plane is an obstacle.
    steep_squared: f64,
    /// Greatest mean square residual of a plane (steps²).
    greatest_square: f64,
    /// Vertical gap across which voxels of neighbouring pixels are connected (quanta).
    reach: i64,
    /// Extent of a chain that a surface at the limit cannot have (quanta).
    steep_chain: f64,
    /// Height of a sixteenth of a band, rounded up (quanta).
    bin: i64,
    /// Void that ends a chain (sixteenths of a band).
    chain_void: u32,
    /// Greatest extent of connected solid that cannot be a steep plane (quanta).
    pub level: i64,
}

pub enum VoxelClass {
    Floor,
    Obstacle,
    /// The points lie on no plane: the extent of each voxel's run decides.
    ByRun,
}

enum Fit {
    Plane { slope_squared: f64 },
    NoPlane,
    Undetermined,
}

impl Surfaces {
    /// Surfaces steeper than the slope `tangent` are obstacles; neighbours that a plane of slope `reach` could connect
    /// belong to the same surface.
    pub fn new(frame: &Frame, bands: Bands, tangent: f64, reach: f64) -> Self {
        let quanta_per_pixel = frame.pixel_m() / frame.quantum_m();
        let bands_per_pixel = frame.pixel_m() / (frame.slice_m() * f64::from(bands.slices()));
        let steps_per_pixel = bands_per_pixel * SLICE_STEPS as f64;
        let greatest = GREATEST_RESIDUAL_PIXELS * steps_per_pixel;
        let steep = tangent * steps_per_pixel / SUBPIXELS as f64;
        Self {
            bands,
            steep_squared: steep * steep,
            greatest_square: greatest * greatest,
            // Gaps are whole quanta, so the fraction is irrelevant.
            reach: (reach * quanta_per_pixel) as i64,
            steep_chain: 3.0 * tangent * quanta_per_pixel,
            bin: (i64::from(bands.slices()) * SLICE_QUANTA + BINS - 1) / BINS,
            chain_void: (CHAIN_VOID_PIXELS * bands_per_pixel * BINS as f64).round().clamp(1.0, BINS as f64) as u32,
            level: level(tangent, quanta_per_pixel),
        }
    }

    /// Returns whether solids around a voxel with this total extent (quanta) are floor, whatever their points.
    #[inline]
    pub fn is_level(&self, extent: i64) -> bool {
        extent <= self.level && (extent + self.bin) as f64 <= self.steep_chain
    }

    /// Returns whether all solids in and around a pixel, of this total extent (quanta), form one surface within three
    /// bands and all take part in fits, since none up to `steep_run` is excluded. The plane is then that of all points
    /// around.
    #[inline]
    pub fn is_one_layer(&self, extent: i64, steep_run: f64) -> bool {
        let band = i64::from(self.bands.slices()) * SLICE_QUANTA;
        extent > self.level && extent <= self.reach && extent < band && extent as f64 <= steep_run
    }

    /// Returns whether the plane of points is steeper than the limit; `None` if they determine none or lie on none.
    pub fn plane_is_steep(&self, sums: &Moments) -> Option<bool> {
        match self.fit(sums) {
            Fit::Plane { slope_squared } => Some(slope_squared > self.steep_squared),
            Fit::NoPlane | Fit::Undetermined => None,
        }
    }

    /// Returns the voxels at the head of `numbers` that are classified together: those in the band of the first with no
    /// gap between two surfaces, up to one that is already classified or has no points.
    pub fn centre(&self, patch: &Patch, numbers: Range<usize>, voxel_classes: &[bool]) -> Centre {
        let first = &patch.voxels()[numbers.start];
        let band = self.bands.of(first.slice);
        let floor = self.bands.around(band).start;
        let (low, mut high) = first.quanta_above(floor.into());
        let mut end = numbers.start + 1;
        while end < numbers.end && self.bands.of(patch.voxels()[end].slice) == band {
            let voxel = &patch.voxels()[end];
            let (bottom, top) = voxel.quanta_above(floor.into());
            if voxel_classes[end] || !voxel.has_points() || bottom - high > self.reach {
                break;
            }
            high = top;
            end += 1;
        }
        Centre { band, numbers: numbers.start..end, floor, low, high }
    }

    /// Classifies the voxels of `centre`, which lie in the pixel that `around` has entered. Voxels that are
    /// `steep_alone` are excluded from planes.
    pub fn voxel_class(
        &self,
        patch: &Patch,
        of_voxels: &mut Sums,
        steep_alone: &[bool],
        around: &mut Around,
        centre: &Centre,
    ) -> VoxelClass {
        around.climb(patch, self.bands.around(centre.band));
        let Around { places, connected, .. } = around;
        connected.clear();
        let (mut lowest, mut highest) = (centre.low, centre.high);
        let (mut bottom_of_all, mut top_of_all) = (centre.low, centre.high);
        for (place, &[first, above, _]) in places.iter().enumerate() {
            for (other, voxel) in (first..).zip(&patch.voxels()[first..above]) {
                let (bottom, top) = voxel.quanta_above(centre.floor.into());
                (bottom_of_all, top_of_all) = (bottom_of_all.min(bottom), top_of_all.max(top));
                if !steep_alone[other] && (bottom - centre.high).max(centre.low - top) <= self.reach {
                    (lowest, highest) = (lowest.min(bottom), highest.max(top));
                    connected.push((other, place as u8));
                }
            }
        }
        // A chain is no longer than everything around, except for the width of a bin.
        let longest_chain = top_of_all - bottom_of_all + self.bin;
        let chain_is_steep = || {
            longest_chain as f64 > self.steep_chain
                && self.chain_extent(patch, around, centre) as f64 > self.steep_chain
        };
        if highest - lowest <= self.level && !chain_is_steep() {
            return VoxelClass::Floor;
        }
        let mut sums = Moments::default();
        for &(other, place) in &around.connected {
            let (pixel, dx, dy) = neighbour(around.pixel, place.into());
            let band = i64::from(self.bands.of(patch.voxels()[other].slice)) + 1 - i64::from(centre.band);
            of_voxels.add_to(&mut sums, patch, (pixel, other), [dx, dy, band]);
        }
        let steep = match self.fit(&sums) {
            Fit::Plane { slope_squared } => slope_squared > self.steep_squared,
            Fit::NoPlane => return VoxelClass::ByRun,
            Fit::Undetermined => chain_is_steep(),
        };
        if steep { VoxelClass::Obstacle } else { VoxelClass::Floor }
    }

    fn fit(&self, sums: &Moments) -> Fit {
        // Fewer than 2¹¹ points cannot overflow 64 bits, even about the origin of a patch: (2²⁰ · 2¹¹)² < 2⁶³.
        let central = |n: i64, ab: i64, a: i64, b: i64| match n < 1 << 11 {
            true => (n * ab - a * b) as f64,
            false => (i128::from(n) * i128::from(ab) - i128::from(a) * i128::from(b)) as f64,
        };
        let Moments { n, u, v, w, .. } = *sums;
        let [cuu, cuv, cvv] =
            [(sums.uu, u, u), (sums.uv, u, v), (sums.vv, v, v)].map(|(ab, a, b)| central(n, ab, a, b));
        let [cuw, cvw, cww] =
            [(sums.uw, u, w), (sums.vw, v, w), (sums.ww, w, w)].map(|(ab, a, b)| central(n, ab, a, b));
        let square = (n as f64) * (n as f64);
        let half_trace = (cuu + cvv) / 2.0;
        let half_difference = (cuu - cvv) / 2.0;
        // Uses only operations that IEEE 754 rounds exactly, so that every machine gives the same result.
        let smaller = half_trace - (half_difference * half_difference + cuv * cuv).sqrt();
        let least = LEAST_SPREAD_PIXELS * SUBPIXELS as f64;
        let least = least * least * square;
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

    /// Returns the greatest vertical extent (quanta) of a chain that includes voxels of the centre: solids in three
    /// bands of 3 × 3 pixels without a void of three pixels. It distinguishes a wall from an edge if few points stand
    /// in a line.
    fn chain_extent(&self, patch: &Patch, around: &Around, centre: &Centre) -> i64 {
        let bins = |numbers: Range<usize>| {
            patch.voxels()[numbers].iter().map(|voxel| self.bins(voxel, centre.floor)).fold(0, u64::bitor)
        };
        let own = bins(centre.numbers.clone());
        let mut rest = around.ranges().map(bins).fold(0, u64::bitor);
        let mut greatest = 0;
        while rest != 0 {
            let first = rest.trailing_zeros();
            let mut last = first;
            loop {
                let void = (rest >> (last + 1)).trailing_zeros();
                if void >= self.chain_void {
                    break;
                }
                last += 1 + void;
            }
            let chain = bits(first, last);
            if own & chain != 0 {
                greatest = greatest.max(last - first);
            }
            rest &= !chain;
        }
        i64::from(greatest) * i64::from(self.bands.slices()) * SLICE_QUANTA / BINS
    }

    /// Returns which sixteenths of bands, from slice `floor` up, contain solid of a voxel.
    #[inline]
    fn bins(&self, voxel: &Voxel, floor: u32) -> u64 {
        let (slices, above) = (u64::from(self.bands.slices()), u64::from(voxel.slice - floor) * BINS as u64);
        if slices == 1 {
            return u64::from(voxel.bins) << above;
        }
        // A voxel lower than a band is lower than the void that ends a chain, so voids inside it are irrelevant.
        let bin = |bin: u32| ((above + u64::from(bin)) / slices) as u32;
        bits(bin(voxel.bins.trailing_zeros()), bin(u16::BITS - 1 - voxel.bins.leading_zeros()))
    }
}

/// Greatest vertical extent (quanta) of connected solid that cannot be a steep plane, whatever its points.
///
/// The gradient `g` of a least-squares plane explains no more than the whole variance of the heights: `|g|²·λ ≤
/// var(w)`, where `λ`, the least variance of the positions, is at least [`LEAST_SPREAD_PIXELS`]² or the plane is
/// undetermined. The variance of heights within `h` is at most `h²/4`. So up to `h = 2·LEAST_SPREAD·tan(limit)` no
/// plane is too steep, and up to `2·GREATEST_RESIDUAL` every plane fits.
fn level(tangent: f64, quanta_per_pixel: f64) -> i64 {
    // Slightly less, to allow for rounding in the fit.
    (2.0 * 0.999 * (LEAST_SPREAD_PIXELS * tangent).min(GREATEST_RESIDUAL_PIXELS) * quanta_per_pixel) as i64
}

/// Bits `first..=last`.
fn bits(first: u32, last: u32) -> u64 {
    (2 << last) - (1 << first)
}

/// Voxels of one pixel and band that are classified together. Heights are in quanta above the floor of the band below.
pub struct Centre {
    band: u32,
    /// Numbers of the voxels.
    pub numbers: Range<usize>,
    /// Lowest slice of the band below.
    floor: u32,
    low: i64,
    high: i64,
}

/// The voxels of 3 × 3 pixels in three bands; moves up with the voxels of the centre pixel.
#[derive(Debug, Default)]
pub struct Around {
    pixel: usize,
    /// Per pixel of the neighbourhood: numbers of the first voxel in these bands, of the first above them, and of the
    /// first of the next pixel.
    places: [[usize; 3]; 9],
    /// Voxels connected to the current centre, each with the number of its pixel in the neighbourhood; a buffer.
    connected: Vec<(usize, u8)>,
}

impl Around {
    /// Moves to the lowest voxels around a pixel.
    pub fn enter(&mut self, patch: &Patch, pixel: usize) {
        self.pixel = pixel;
        for (place, (neighbour, ..)) in self.places.iter_mut().zip(neighbourhood(pixel)) {
            let range = patch.range(neighbour);
            *place = [range.start, range.start, range.end];
        }
    }

    /// Moves up to these slices.
    #[inline]
    fn climb(&mut self, patch: &Patch, slices: Range<u32>) {
        let voxels = patch.voxels();
        for [first, above, end] in &mut self.places {
            while *first < *end && voxels[*first].slice < slices.start {
                *first += 1;
            }
            *above = (*first).max(*above);
            while *above < *end && voxels[*above].slice < slices.end {
                *above += 1;
            }
        }
    }

    /// Returns the numbers of the voxels, pixel by pixel in the order of [`neighbourhood`].
    fn ranges(&self) -> impl Iterator<Item = Range<usize>> {
        self.places.iter().map(|&[first, above, _]| first..above)
    }
}
