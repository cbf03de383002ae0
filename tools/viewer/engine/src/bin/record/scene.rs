//! The archive of a hall to walk in: rough floor, stairs to a gallery, pillars, a beam to crouch under, blocks to climb
//! or jump onto.

use crate::random::Random;
use slicewalk::archive::{ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::plan::Plan;
use std::collections::BTreeMap;

/// Half of the hall's width (m).
const HALF: f64 = 9.0;
const STEPS: f64 = 17.0;
const GALLERY: f64 = 3.0;
/// Edge of the squares that may hold a block (m).
const SQUARE: f64 = 0.6;

/// Bottom, top (m), and whether it is an obstacle.
type Matter = (f64, f64, bool);

fn column(x: f64, y: f64, rough: f64) -> Vec<Matter> {
    if x.abs().max(y.abs()) > HALF - 0.2 {
        return vec![(-0.1, GALLERY + 2.0, true)];
    }
    if (-1.0..0.2).contains(&y) && (-3.5..-0.5).contains(&x) {
        let step = ((x + 3.5) / 3.0 * STEPS).floor() + 1.0;
        return vec![(-0.1, step * GALLERY / STEPS, false)];
    }
    let pillar = |v: f64| (v + 0.9).rem_euclid(2.0) < 0.2;
    if pillar(x) && pillar(y) {
        return vec![(-0.1, GALLERY, true)];
    }
    let cell = |v: f64| (v / SQUARE).floor() as i64 as u64;
    let mut matter = match Random(cell(x) << 32 ^ cell(y)).below(24) {
        0 | 1 => vec![(-0.1, 0.3, false)],
        2 => vec![(-0.1, 0.48, false)],
        _ => vec![(-0.1, rough, false)],
    };
    if (2.5..2.7).contains(&y) {
        matter.push((1.3, 1.6, true));
    }
    if x > -0.5 {
        matter.push((GALLERY - 0.1, GALLERY + rough, false));
    }
    matter
}

/// Returns the bytes of the archive.
pub fn hall(has_levels: bool) -> slicewalk::Result<Vec<u8>> {
    let frame = Frame::new(0.04, 0.12)?;
    let (mut random, pixels) = (Random(3), (HALF / frame.pixel_m()) as i64);
    let mut pages: BTreeMap<PageKey, PageBuilder> = BTreeMap::new();
    for (i, j) in (-pixels..pixels).flat_map(|i| (-pixels..pixels).map(move |j| (i, j))) {
        let middle = |pixel: i64| (pixel as f64 + 0.5) * frame.pixel_m();
        let mut parts: BTreeMap<i64, Vec<Span>> = BTreeMap::new();
        for (bottom, top, obstacle) in column(middle(i), middle(j), random.in_range(0.0, 0.006)) {
            let (bottom, top) = (frame.quantum_floor(bottom), frame.quantum_ceil(top));
            for layer in bottom.div_euclid(PAGE_QUANTA)..=(top - 1).div_euclid(PAGE_QUANTA) {
                let base = layer * PAGE_QUANTA;
                let (low, high) = ((bottom - base).max(0), (top - base).min(PAGE_QUANTA));
                parts.entry(layer).or_default().extend(Span::new(low as u32, high as u32, obstacle));
            }
        }
        for (layer, spans) in parts {
            let key = PageKey { tx: i.div_euclid(64) as i32, ty: j.div_euclid(64) as i32, layer: layer as i32 };
            let (px, py) = (i.rem_euclid(64) as u32, j.rem_euclid(64) as u32);
            assert!(pages.entry(key).or_default().set_column(px, py, &spans), "{spans:?}");
        }
    }
    let plan = Plan::new(frame);
    let folder = tempfile::tempdir().map_err(|error| slicewalk::Error::io("hall.slices", "create a folder", error))?;
    let target = folder.path().join("hall.slices");
    let mut writer = ArchiveWriter::create(&target, &plan, false)?;
    let mut encoder = PageEncoder::new(plan.frame).for_levels(has_levels);
    if has_levels {
        writer.set_levels();
    }
    for (key, builder) in pages {
        writer.put(key, encoder.encode(key, &builder.build()))?;
    }
    writer.finish(Totals { points_read: 1, points_kept: 1, ..Totals::default() })?;
    std::fs::read(&target).map_err(|error| slicewalk::Error::io(&target, "read", error))
}
