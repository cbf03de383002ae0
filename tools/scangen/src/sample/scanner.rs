//! A terrestrial scanner: rays from stations at equal angles hit the nearest surface.

use super::{Amount, Kind, Sample, SampleSpec, ScannerSpec, Stream};
use crate::geometry::{Vec3, add, scale, sin_cos_deg};
use crate::shape::{Cylinder, Shape};
use crate::{Error, Result, Scene, Truth};

/// Time of one full turn, during which people walk `[s]`.
const TURN_S: f64 = 60.0;
/// Difference of the ranges of neighbouring rays above which they mark an edge (m).
const EDGE_M: f64 = 0.3;
/// Places checked along a line on which a person needs room.
const CHECKS: u32 = 16;
/// Attempts to place people, beyond their number.
const MOST_DRAWS: usize = 400;
/// Fraction of rays that pass through a pane of glass.
const GLASS_PASSES: f64 = 0.9;
/// Most panes and mirrors that a ray meets.
const MOST_TURNS: usize = 8;
/// Distance behind a pane or in front of a mirror at which a ray continues (m).
const CLEAR_M: f64 = 1e-6;

/// A person who walks to and fro on a line.
struct Person {
    from: [f64; 2],
    step: [f64; 2],
    foot: f64,
    phase_s: f64,
}

impl Person {
    const RADIUS_M: f64 = 0.25;
    const HEIGHT_M: f64 = 1.75;
    /// Time from one end of the line to the other `[s]`.
    const LEG_S: f64 = 5.0;

    fn at(&self, time_s: f64) -> Shape {
        let t = (time_s + self.phase_s) / Self::LEG_S;
        let along = (t - 2.0 * (t / 2.0).floor() - 1.0).abs();
        let center = [self.from[0] + along * self.step[0], self.from[1] + along * self.step[1]];
        let (z_min, z_max) = (self.foot, self.foot + Self::HEIGHT_M);
        Shape::Cylinder(Cylinder { center, radius: Self::RADIUS_M, z_min, z_max })
    }
}

/// The people around a scanner, as met by its rays.
pub struct Crowd {
    station: Vec3,
    people: Vec<Person>,
    columns: u64,
}

impl Crowd {
    /// Distance from the station at which a ray in this direction meets a person (m).
    pub fn nearest(&self, direction: Vec3) -> Option<f64> {
        let turn = (direction[1].atan2(direction[0]) / std::f64::consts::TAU).rem_euclid(1.0);
        let column = (turn * self.columns as f64).round() as u64 % self.columns.max(1);
        let time_s = TURN_S * column as f64 / self.columns.max(1) as f64;
        let met = self
            .people
            .iter()
            .filter_map(|person| person.at(time_s).raycast(self.station, direction, 0.0, f64::INFINITY));
        met.min_by(f64::total_cmp)
    }
}

/// The scan, one ray at a time: by station, column (azimuth), then elevation from the nadir up.
pub(super) struct Scan<'a> {
    scene: &'a Scene,
    stations: Vec<Vec3>,
    spec: ScannerSpec,
    noise_m: f64,
    noise: Stream,
    extras: Stream,
    elevations: Vec<(f64, f64)>,
    columns: u64,
    station: usize,
    column: u64,
    row: usize,
    heading: (f64, f64),
    people: Vec<Person>,
    bodies: Vec<Shape>,
    last: Option<(f64, u32)>,
    waiting: Option<Sample>,
}

impl<'a> Scan<'a> {
    pub fn new(scene: &'a Scene, seed: u64, spec: &ScannerSpec, common: &SampleSpec) -> Result<Self> {
        let stations = if spec.stations.is_empty() { scene.stations().to_vec() } else { spec.stations.clone() };
        let step = match common.amount {
            // n columns of n/2 rays per station.
            Amount::Count(rays) => 360.0 / (2.0 * rays as f64 / stations.len().max(1) as f64).sqrt().max(4.0),
            Amount::Density(density) => (1.0 / density.sqrt()).to_degrees(),
        };
        if !(1e-4..=90.0).contains(&step) {
            return Err(Error::parameter("scanner", format!("an angular step of {step}° lies outside 0.0001 to 90")));
        }
        let empty = matches!(common.amount, Amount::Count(0));
        let rows = (180.0 / step).round() as usize;
        let columns = if empty { 0 } else { (360.0 / step).round() as u64 };
        let elevations =
            (0..rows).map(|i| sin_cos_deg((i as f64 + 0.5) * 180.0 / rows as f64 - 90.0)).collect::<Vec<_>>();
        let mut scan = Self {
            scene,
            stations,
            spec: spec.clone(),
            noise_m: common.noise_m,
            noise: Stream::new(seed, 1),
            extras: Stream::new(seed, 3),
            elevations,
            columns,
            station: 0,
            column: 0,
            row: 0,
            heading: (0.0, 1.0),
            people: Vec::new(),
            bodies: Vec::new(),
            last: None,
            waiting: None,
        };
        scan.set_up();
        Ok(scan)
    }

    /// The people around the first station.
    pub fn into_crowd(self) -> Option<Crowd> {
        let station = *self.stations.first()?;
        Some(Crowd { station, people: self.people, columns: self.columns })
    }

    /// Moves people to the current station and begins its first column.
    fn set_up(&mut self) {
        let Some(at) = self.stations.get(self.station).copied() else { return };
        let mut crowd = Vec::new();
        let mut draws = MOST_DRAWS + self.spec.people;
        while crowd.len() < self.spec.people && draws > 0 {
            draws -= 1;
            let (s, c) = sin_cos_deg(360.0 * self.extras.unit());
            let away = 1.0 + 3.0 * self.extras.unit();
            // Across the line of sight, so that no person walks through the scanner.
            let from = [at[0] + away * c + 2.0 * s, at[1] + away * s - 2.0 * c];
            let foot = self.scene.floor_under(from[0], from[1], at[2]).map_or(at[2] - 1.7, |(z, _)| z);
            let phase_s = Person::LEG_S * 2.0 * self.extras.unit();
            let person = Person { from, step: [-4.0 * s, 4.0 * c], foot, phase_s };
            if self.has_room(&person) {
                crowd.push(person);
            }
        }
        self.people = crowd;
        self.begin_column();
    }

    /// Returns whether a person keeps clear of everything on the whole line.
    fn has_room(&self, person: &Person) -> bool {
        let clearance = self.spec.clearance_m;
        let body = clearance + Person::RADIUS_M;
        let places = (0..=CHECKS).map(|step| f64::from(step) / f64::from(CHECKS));
        let at = |along: f64| [0, 1].map(|axis| person.from[axis] + along * person.step[axis]);
        clearance <= 0.0
            || places.map(at).all(|[x, y]| {
                let min = [x - body, y - body, person.foot + 0.3];
                let max = [x + body, y + body, person.foot + Person::HEIGHT_M];
                self.scene.distance_to_box(min, max) > 0.0
            })
    }

    fn begin_column(&mut self) {
        let turn = self.column as f64 / self.columns.max(1) as f64;
        self.heading = sin_cos_deg(360.0 * turn);
        self.bodies = self.people.iter().map(|p| p.at(TURN_S * turn)).collect();
        self.row = 0;
        self.last = None;
    }

    /// Returns what a ray meets: length of its path, surface, and kind. Mirrors reflect the ray and glass passes most
    /// of it; a surface seen in a mirror appears behind the mirror, where nothing is.
    fn trace(&mut self, origin: Vec3, dir: Vec3) -> Option<(f64, u32, Kind)> {
        let (mut from, mut along, mut way, mut mirrored) = (origin, dir, 0.0, false);
        for _ in 0..MOST_TURNS {
            let limit = self.spec.range_m - way;
            let mut hit = self.scene.raycast(from, along, limit).map(|(t, i)| (t, i, Kind::Surface));
            for body in &self.bodies {
                let limit = hit.map_or(limit, |h| h.0);
                if let Some(t) = body.raycast(from, along, 0.0, limit) {
                    hit = Some((t, hit.map_or(0, |h| h.1), Kind::Moving));
                }
            }
            let (t, surface, kind) = hit?;
            let met = &self.scene.surfaces()[surface];
            let passes = match (kind, met.label) {
                (Kind::Surface, "glass") => self.extras.unit() < GLASS_PASSES,
                (Kind::Surface, "mirror") => true,
                _ => false,
            };
            if !passes {
                return Some((way + t, surface as u32, if mirrored { Kind::Outlier } else { kind }));
            }
            let at = add(from, scale(along, t));
            if met.label == "mirror" {
                let normal = met.shape.normal_at(at);
                let facing = (0..3).map(|axis| along[axis] * normal[axis]).sum::<f64>();
                along = add(along, scale(normal, -2.0 * facing));
                mirrored = true;
            }
            way += t + CLEAR_M;
            from = add(at, scale(along, CLEAR_M));
        }
        None
    }

    /// Casts one ray.
    fn shoot(&mut self, origin: Vec3, dir: Vec3) -> Option<Sample> {
        let hit = self.trace(origin, dir);
        let before = self.last;
        self.last = hit.map(|(t, i, _)| (t, i));
        let (range, surface, kind) = hit?;
        if let Some((other, _)) = before.filter(|b| (b.0 - range).abs() > EDGE_M)
            && self.spec.mixed_rate > 0.0
            && self.extras.unit() < self.spec.mixed_rate
        {
            let between = range + (other - range) * self.extras.unit();
            let position = add(origin, scale(dir, between));
            self.waiting = Some(Sample { position, kind: Kind::Mixed, surface, station: self.station as u16 });
        }
        let noise = if self.noise_m > 0.0 { self.noise_m * self.noise.normal() } else { 0.0 };
        let position = add(origin, scale(dir, range + noise));
        Some(Sample { position, kind, surface, station: self.station as u16 })
    }
}

impl Iterator for Scan<'_> {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        if let Some(mixed) = self.waiting.take() {
            return Some(mixed);
        }
        loop {
            let origin = *self.stations.get(self.station)?;
            if self.column >= self.columns {
                (self.station, self.column) = (self.station + 1, 0);
                self.set_up();
                continue;
            }
            let Some((sin, cos)) = self.elevations.get(self.row).copied() else {
                self.column += 1;
                self.begin_column();
                continue;
            };
            self.row += 1;
            let (s, c) = self.heading;
            if let Some(sample) = self.shoot(origin, [cos * c, cos * s, sin]) {
                return Some(sample);
            }
        }
    }
}
