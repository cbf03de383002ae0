//! Seeded random scenes: points, their spans by brute force, and their pages.

pub use crate::random::Random;
use nalgebra::{Point3, Vector3};
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
use slicewalk::page::{Page, PageBuilder, Span};
use slicewalk::query::Aabb;
use slicewalk::store::Snapshot;
use std::collections::BTreeMap;

#[path = "../common/part.rs"]
mod part;
pub use part::Part;

/// Bottom and top in quanta above the origin, and whether it is an obstacle.
pub type Matter = (i64, i64, bool);
/// Spans of each pixel, joined across pages, lowest first.
pub type Columns = BTreeMap<(i64, i64), Vec<Matter>>;

pub struct Scene {
    pub frame: Frame,
    pub origin: Point3<f64>,
    pub points: Vec<Point3<f64>>,
    pub columns: Columns,
    pub pages: Vec<(PageKey, Page)>,
}

impl Scene {
    /// `count` points around a corner of eight pages at about `distance` from the origin.
    pub fn new(seed: u64, distance: f64, count: usize) -> Self {
        let mut random = Random(seed);
        let t = [0.02, 0.05, 0.3][random.below(3)];
        let frame = Frame::new(t, [3.0 * t, 0.7 * t][random.below(2)]).unwrap();
        let near = |distance: f64, unit: f64| (distance / unit).round() * unit;
        let (tile, layer) = (64.0 * t, 64.0 * frame.slice_m());
        let origin = Point3::new(near(distance, tile), near(-distance, tile), near(distance / 1e4, layer));
        let points: Vec<_> = (0..count).map(|_| random_point(&mut random, &frame, origin)).collect();

        let mut voxels: BTreeMap<(i64, i64, i64), (i64, i64)> = BTreeMap::new();
        for p in &points {
            let voxel = (frame.pixel_of(p.x), frame.pixel_of(p.y), frame.slice_of(p.z));
            let (low, high) = (frame.quantum_floor(p.z), frame.quantum_ceil(p.z));
            let range = voxels.entry(voxel).or_insert((low, high));
            *range = (range.0.min(low), range.1.max(high));
        }
        let mut columns = Columns::new();
        let obstacles = 10 + random.below(60);
        for ((i, j, _), (bottom, top)) in voxels {
            let obstacle = random.chance(obstacles);
            let column = columns.entry((i, j)).or_default();
            match column.last_mut() {
                Some(last) if last.1 == bottom && last.2 == obstacle => last.1 = top,
                _ => column.push((bottom, top, obstacle)),
            }
        }
        let pages = pages_of(&columns);
        Self { frame, origin, points, columns, pages }
    }

    /// Scenes of three densities at three distances, each with a random generator for its queries.
    pub fn all() -> impl Iterator<Item = (Self, Random)> {
        (0..60).map(|seed| {
            let distance = [0.0, 5e5, -1e7][seed as usize % 3];
            let count = [20, 300, 3000][seed as usize / 3 % 3];
            (Self::new(seed, distance, count), Random(seed ^ 0xABCD))
        })
    }

    pub fn store(&self) -> Snapshot {
        Snapshot::from_pages(self.frame, self.pages.clone())
    }

    /// Keys of all pages.
    pub fn keys(&self) -> Vec<PageKey> {
        self.pages.iter().map(|page| page.0).collect()
    }

    /// A set of all pages, with those of `keys` in memory.
    pub fn part(&self, keys: &[PageKey]) -> Part {
        let mut part = Part::new(self.store());
        part.load(keys);
        part
    }

    /// A point in the scene or near it.
    pub fn random_point(&self, random: &mut Random) -> Point3<f64> {
        match random.below(3) {
            0 => self.points[random.below(self.points.len())],
            _ => random_point(random, &self.frame, self.origin),
        }
    }

    /// A box of any size up to the whole scene.
    pub fn random_box(&self, random: &mut Random) -> Aabb {
        let a = self.random_point(random);
        let b = match random.below(4) {
            0 => self.random_point(random),
            1 => a,
            _ => {
                let size = self.frame.pixel_m() * [0.3, 3.0, 30.0][random.below(3)];
                Point3::from(a.coords.map(|v| v + random.between(0.0, size)))
            }
        };
        Aabb::new(a.inf(&b), a.sup(&b)).unwrap()
    }
}

/// Often on edges of pixels, slices and quanta.
fn random_point(random: &mut Random, frame: &Frame, origin: Point3<f64>) -> Point3<f64> {
    let spread = [2.0, 12.0, 70.0][random.below(3)];
    let mut steps = |whole: usize| {
        let steps = random.between(-spread, spread);
        if random.chance(whole) { steps.round() } else { steps }
    };
    let (x, y) = (steps(20) * frame.pixel_m(), steps(20) * frame.pixel_m());
    let z = steps(30);
    let unit = if random.chance(60) { frame.slice_m() } else { frame.quantum_m() };
    origin + Vector3::new(x, y, z * unit)
}

pub fn pages_of(columns: &Columns) -> Vec<(PageKey, Page)> {
    type Part = BTreeMap<(u32, u32), Vec<Span>>;
    let mut parts: BTreeMap<(i64, i64, i64), Part> = BTreeMap::new();
    for (&(i, j), spans) in columns {
        for &(bottom, top, obstacle) in spans {
            let (first, last) = (bottom.div_euclid(PAGE_QUANTA), (top - 1).max(bottom).div_euclid(PAGE_QUANTA));
            for layer in first..=last {
                let base = layer * PAGE_QUANTA;
                let (low, high) = (bottom.max(base) - base, top.min(base + PAGE_QUANTA) - base);
                let span = Span::new(low as u32, high as u32, obstacle).unwrap();
                let page = parts.entry((i.div_euclid(64), j.div_euclid(64), layer)).or_default();
                page.entry((i.rem_euclid(64) as u32, j.rem_euclid(64) as u32)).or_default().push(span);
            }
        }
    }
    let mut builder = PageBuilder::default();
    let mut pages = Vec::new();
    for ((tx, ty, layer), columns) in parts {
        builder.clear();
        for ((px, py), spans) in columns {
            assert!(builder.set_column(px, py, &spans), "{spans:?}");
        }
        pages.push((PageKey { tx: tx as i32, ty: ty as i32, layer: layer as i32 }, builder.build()));
    }
    pages
}
