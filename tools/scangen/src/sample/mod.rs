//! Points drawn from a scene, in bounded memory.
//!
//! [`Mode::Direct`] draws evenly by area. [`Mode::Scanner`] casts rays from stations and reproduces what makes real
//! scans hard: 1/r² density, shadows, mixed pixels at edges, people walking through. Noise, outliers, duplicates and
//! holes apply to both modes. Each has its own random stream, so changing one leaves the other points in place.

mod direct;
mod rng;
mod scanner;
mod shuffle;

pub use scanner::Crowd;
pub use shuffle::{SHUFFLE_BUCKETS, Shuffled, shuffle};

pub(crate) use rng::Stream;

use crate::geometry::{Vec3, add, scale};
use crate::{Error, Result, Scene};

/// Kind of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Kind {
    /// On a surface of the scene, up to noise.
    Surface = 0,
    /// Anywhere: a reflection, a bird.
    Outlier = 1,
    /// Between two surfaces at an edge, where the beam met both of them.
    Mixed = 2,
    /// On a person who walked through.
    Moving = 3,
}

/// A point and its origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Position.
    pub position: Vec3,
    /// Kind.
    pub kind: Kind,
    /// Surface it was drawn from, or that of the point it was derived from.
    pub surface: u32,
    /// Number of the station that saw the point; 0 without a scanner.
    pub station: u16,
}

/// How many points to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Amount {
    /// In total. A scanner casts this many rays (some hit nothing); a grid comes close to it.
    Count(u64),
    /// Per square metre of surface; for a scanner, at one metre from it.
    Density(f64),
}

/// Order of directly drawn points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Independent of each other, so already shuffled.
    Random,
    /// Surface by surface, random within each.
    Surfaces,
    /// Surface by surface on a jittered grid, without gaps or clumps.
    Grid,
}

/// Sampling method.
#[derive(Debug, Clone, PartialEq)]
pub enum Mode {
    /// Evenly by area, hidden surfaces included.
    Direct(Order),
    /// By ray casting from stations.
    Scanner(ScannerSpec),
}

/// A scanner and its imperfections.
#[derive(Debug, Clone, PartialEq)]
pub struct ScannerSpec {
    /// Stations; if empty, the scene's own.
    pub stations: Vec<Vec3>,
    /// Range `[m, > 0]`.
    pub range_m: f64,
    /// Fraction of edges (neighbouring rays whose ranges differ by 0.3 m or more) that give a mixed pixel `[0..=1]`.
    pub mixed_rate: f64,
    /// Number of people who walk to and fro around each station.
    pub people: usize,
    /// Distance that people keep from anything that rises more than 0.3 m above their feet; 0: they walk through walls
    /// (m).
    pub clearance_m: f64,
}

impl Default for ScannerSpec {
    fn default() -> Self {
        Self { stations: Vec::new(), range_m: 120.0, mixed_rate: 0.2, people: 0, clearance_m: 0.0 }
    }
}

/// Sampling of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleSpec {
    /// Method.
    pub mode: Mode,
    /// Number of points.
    pub amount: Amount,
    /// Standard deviation of the noise, along the normal (direct) or the ray (scanner); the noise never exceeds 6 times
    /// this (m).
    pub noise_m: f64,
    /// Outliers added per point `[0..=1]`.
    pub outlier_rate: f64,
    /// Largest distance of an outlier from its original point (m); the smallest is half of it.
    pub outlier_distance_m: f64,
    /// Points repeated exactly, per point `[0..=1]`.
    pub duplicate_rate: f64,
    /// Circles without data: x, y, radius.
    pub holes: Vec<[f64; 3]>,
}

impl SampleSpec {
    /// Independent points, `count` in total, without noise.
    pub fn direct_count(count: u64) -> Self {
        Self {
            mode: Mode::Direct(Order::Random),
            amount: Amount::Count(count),
            noise_m: 0.0,
            outlier_rate: 0.0,
            outlier_distance_m: 20.0,
            duplicate_rate: 0.0,
            holes: Vec::new(),
        }
    }

    /// Independent points, `density` per square metre, without noise.
    pub fn direct_density(density: f64) -> Self {
        Self { amount: Amount::Density(density), ..Self::direct_count(0) }
    }

    /// The scene's own stations and about `rays` rays in total, without noise.
    pub fn scanner(rays: u64) -> Self {
        Self { mode: Mode::Scanner(ScannerSpec::default()), ..Self::direct_count(rays) }
    }

    /// Adds noise of this standard deviation (m).
    pub fn with_noise(self, noise_m: f64) -> Self {
        Self { noise_m, ..self }
    }

    fn check(&self) -> Result<()> {
        let within = |what: &str, value: f64, max: f64| {
            let fits = (0.0..=max).contains(&value);
            fits.then_some(()).ok_or_else(|| Error::parameter(what, format!("{value} lies outside 0 to {max}")))
        };
        within("noise", self.noise_m, 1e3)?;
        within("outlier rate", self.outlier_rate, 1.0)?;
        within("outlier distance", self.outlier_distance_m, 1e8)?;
        within("duplicate rate", self.duplicate_rate, 1.0)?;
        if let Amount::Density(density) = self.amount {
            within("density", density, 1e9)?;
        }
        if let Mode::Scanner(s) = &self.mode {
            within("mixed rate", s.mixed_rate, 1.0)?;
            within("range", s.range_m, 1e6)?;
        }
        Ok(())
    }
}

impl Scene {
    /// Points of this scene; see [`Scene::samples`].
    pub fn points<'a>(&'a self, seed: u64, spec: &SampleSpec) -> Result<impl Iterator<Item = Vec3> + use<'a>> {
        Ok(self.samples(seed, spec)?.map(|s| s.position))
    }

    /// Samples of this scene: the same for the same seed and spec, in memory that does not grow with their number.
    pub fn samples<'a>(&'a self, seed: u64, spec: &SampleSpec) -> Result<impl Iterator<Item = Sample> + use<'a>> {
        spec.check()?;
        let raw: Box<dyn Iterator<Item = Sample> + 'a> = match &spec.mode {
            Mode::Direct(order) => direct::draw(self, seed, *order, spec),
            Mode::Scanner(scanner) => Box::new(scanner::Scan::new(self, seed, scanner, spec)?),
        };
        Ok(Spoiled { raw, rng: Stream::new(seed, 2), spec: spec.clone(), waiting: Vec::new() })
    }
}

impl Scene {
    /// The people around the first station of a scan, where [`Scene::samples`] with the same seed and spec meets them;
    /// `None` without a scanner or without stations.
    pub fn crowd(&self, seed: u64, spec: &SampleSpec) -> Result<Option<Crowd>> {
        spec.check()?;
        match &spec.mode {
            Mode::Direct(_) => Ok(None),
            Mode::Scanner(scanner) => Ok(scanner::Scan::new(self, seed, scanner, spec)?.into_crowd()),
        }
    }
}

/// Drops points in holes and adds outliers and duplicates.
struct Spoiled<'a> {
    raw: Box<dyn Iterator<Item = Sample> + 'a>,
    rng: Stream,
    spec: SampleSpec,
    waiting: Vec<Sample>,
}

impl Iterator for Spoiled<'_> {
    type Item = Sample;

    #[inline]
    fn next(&mut self) -> Option<Sample> {
        if let Some(extra) = self.waiting.pop() {
            return Some(extra);
        }
        let sample = loop {
            let sample = self.raw.next()?;
            let [x, y, _] = sample.position;
            if !self.spec.holes.iter().any(|[hx, hy, r]| (x - hx) * (x - hx) + (y - hy) * (y - hy) <= r * r) {
                break sample;
            }
        };
        if self.spec.duplicate_rate > 0.0 && self.rng.unit() < self.spec.duplicate_rate {
            self.waiting.push(sample);
        }
        if self.spec.outlier_rate > 0.0 && self.rng.unit() < self.spec.outlier_rate {
            let away = self.spec.outlier_distance_m * (0.5 + 0.5 * self.rng.unit());
            let position = add(sample.position, scale(self.rng.direction(), away));
            self.waiting.push(Sample { position, kind: Kind::Outlier, ..sample });
        }
        Some(sample)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.waiting.len(), None)
    }
}
