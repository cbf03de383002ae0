//! The truth as JSON, so that programs in other languages can check the same answers.

use crate::shape::Shape;
use crate::{Error, Result, Scene};
use serde_json::{Value, json};
use std::path::Path;

/// The scene's surfaces, walk and stations as JSON. Lengths are in metres and angles in degrees, except for wave phases
/// and wave vectors (radians, radians per metre). A surface's index is its position in the list.
///
/// Kinds: `polygon` (planar, convex, `vertices` in order), `cylinder` (upright, lateral surface), `disc`
/// (horizontal), `terrain` (`z = center.z + Σ amplitude·sin(kx·u + ky·v + phase)`, where `(u, v)` are the plan
/// coordinates around the centre, rotated back by `heading_deg`, for `|u| ≤ half[0]`, `|v| ≤ half[1]`).
pub fn truth_json(scene: &Scene) -> Value {
    let surfaces: Vec<Value> = scene.surfaces().iter().map(|s| surface(&s.shape, s.label)).collect();
    let bounds = scene.bounds();
    let walk = scene.walk().map(|w| json!({ "start": w.start, "waypoints": w.waypoints, "end": w.end }));
    json!({
        "format": "scangen-truth",
        "version": 1,
        "scene": scene.name(),
        "bounds": { "min": bounds.min, "max": bounds.max },
        "stations": scene.stations(),
        "walk": walk,
        "surfaces": surfaces,
    })
}

fn surface(shape: &Shape, label: &str) -> Value {
    match shape {
        Shape::Polygon(p) => json!({ "kind": "polygon", "label": label, "vertices": p.vertices() }),
        Shape::Cylinder(c) => json!({
            "kind": "cylinder", "label": label, "center": c.center, "radius": c.radius,
            "z_min": c.z_min, "z_max": c.z_max,
        }),
        Shape::Disc(d) => json!({ "kind": "disc", "label": label, "center": d.center, "radius": d.radius }),
        Shape::Terrain(t) => {
            let waves: Vec<Value> =
                t.waves.iter().map(|w| json!({ "amplitude": w.amplitude, "k": w.k, "phase": w.phase })).collect();
            json!({
                "kind": "terrain", "label": label, "center": t.center, "half": t.half, "heading_deg": t.heading_deg,
                "waves": waves,
            })
        }
    }
}

/// Writes [`truth_json`] to `path`, replacing an existing file.
pub fn write_truth_json(path: &Path, scene: &Scene) -> Result<()> {
    let text = truth_json(scene).to_string() + "\n";
    std::fs::write(path, text).map_err(|e| Error::io(path, "write", e))
}
