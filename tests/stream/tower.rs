//! A tower of dense storeys around a shaft, as an archive, and a body that falls through it.
#![allow(dead_code, reason = "each test file uses a part")]

pub use crate::random::Random;
use nalgebra::{Point3, Vector3};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, ArchiveWriter, PageEncoder, Totals};
use slicewalk::bytes::ByteSource;
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::plan::{Plan, PlanOptions};
use slicewalk::query::Aabb;
use slicewalk::store::{MotionHint, Snapshot};
use std::collections::BTreeMap;

/// Latency of a slow source (s), and duration of a frame.
pub const READ_S: f64 = 0.002;
pub const FRAME_S: f64 = 1.0 / 60.0;

/// A tower of `half` metres to each side and `height` metres high: a rough floor every 3 m with a shaft of 1.2 m in the
/// middle, pillars and clutter. Pixels of 2 cm, slices of 6 cm: pages are 1.28 m wide and 3.84 m high.
pub fn tower(half: f64, height: f64, seed: u64) -> Vec<u8> {
    let frame = Frame::new(0.02, 0.06).unwrap();
    let mut random = Random(seed);
    let pixels = (half / frame.pixel_m()) as i64;
    let shaft = (0.6 / frame.pixel_m()) as i64;
    let storeys = (height / 3.0) as i64;
    let quantum = |z: f64| frame.quantum_floor(z);
    let mut tiles: BTreeMap<(i64, i64), Vec<(i64, i64)>> = BTreeMap::new();
    for i in -pixels..pixels {
        for j in -pixels..pixels {
            tiles.entry((i.div_euclid(64), j.div_euclid(64))).or_default().push((i, j));
        }
    }
    let mut pages = BTreeMap::new();
    for ((tx, ty), tile) in tiles {
        let mut builders: BTreeMap<i64, PageBuilder> = BTreeMap::new();
        for (i, j) in tile {
            let in_shaft = i.abs() <= shaft && j.abs() <= shaft;
            let pillar = i.rem_euclid(100) < 12 && j.rem_euclid(100) < 12 && !in_shaft;
            let mut spans: Vec<(i64, i64, bool)> = Vec::new();
            match (pillar, in_shaft) {
                (true, _) => spans.push((0, quantum(3.0 * storeys as f64), true)),
                (_, true) => spans.push((0, 20, false)),
                _ => {
                    for storey in 0..=storeys {
                        let floor = 3.0 * storey as f64;
                        let rough = random.below(6) as i64;
                        spans.push((quantum(floor) + rough, quantum(floor) + 8 + rough, false));
                        if random.below(8) == 0 {
                            let z = quantum(floor + random.between(0.3, 2.6));
                            spans.push((z, z + 30, true));
                        }
                    }
                }
            }
            let mut parts: BTreeMap<i64, Vec<Span>> = BTreeMap::new();
            for (bottom, top, obstacle) in spans {
                for layer in bottom.div_euclid(PAGE_QUANTA)..=(top - 1).max(bottom).div_euclid(PAGE_QUANTA) {
                    let base = layer * PAGE_QUANTA;
                    let (low, high) = ((bottom - base).max(0), (top - base).min(PAGE_QUANTA));
                    parts.entry(layer).or_default().push(Span::new(low as u32, high as u32, obstacle).unwrap());
                }
            }
            for (layer, spans) in parts {
                let builder = builders.entry(layer).or_default();
                assert!(builder.set_column(i.rem_euclid(64) as u32, j.rem_euclid(64) as u32, &spans), "{spans:?}");
            }
        }
        for (layer, builder) in builders {
            pages.insert(PageKey { tx: tx as i32, ty: ty as i32, layer: layer as i32 }, builder.build());
        }
    }
    let plan = Plan { frame, options: PlanOptions::default() };
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("tower.slices");
    let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
    let mut encoder = PageEncoder::of_plan(&plan);
    for (key, page) in &pages {
        writer.put(*key, encoder.encode(*key, page)).unwrap();
    }
    writer.finish(Totals { points_read: 1, points_kept: 1, ..Totals::default() }).unwrap();
    std::fs::read(&target).unwrap()
}

/// An archive that reads from `source`.
pub fn open(source: impl ByteSource + 'static) -> Archive {
    Archive::from_source(Box::new(source)).unwrap()
}

/// All pages in memory.
pub fn resident(bytes: &[u8]) -> Snapshot {
    Snapshot::resident(&Archive::from_bytes(bytes.to_vec()).unwrap(), &NoMonitor).unwrap()
}

/// A body of 0.5 × 0.5 × 1.8 m with its feet at a point.
#[derive(Clone, Copy)]
pub struct Body {
    pub feet: Point3<f64>,
    pub velocity: Vector3<f64>,
}

impl Body {
    pub fn at(x: f64, y: f64, z: f64) -> Self {
        Self { feet: Point3::new(x, y, z), velocity: Vector3::zeros() }
    }

    pub fn shape(&self) -> Aabb {
        let half = Vector3::new(0.25, 0.25, 0.0);
        Aabb::new(self.feet - half, self.feet + half + Vector3::new(0.0, 0.0, 1.8)).unwrap()
    }

    /// Motion hint with 5 cm to each side, and 0.4 m up and down for steps.
    pub fn motion(&self) -> MotionHint {
        let half = Vector3::new(0.3, 0.3, 0.4);
        let top = self.feet + Vector3::new(0.0, 0.0, 1.8);
        MotionHint { terminal_speed: 50.0, ..MotionHint::walking(self.feet - half, top + half, self.velocity) }
    }

    /// Falls for one frame, at most at 50 m/s.
    pub fn fall(&mut self) {
        let before = self.velocity.z;
        self.velocity.z = (before - 9.81 * FRAME_S).max(-50.0);
        self.feet.z += (before + self.velocity.z) / 2.0 * FRAME_S;
    }
}
