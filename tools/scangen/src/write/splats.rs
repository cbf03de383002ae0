//! Gaussian splats on the surfaces of a scene, as 3DGS PLY.

use super::Written;
use crate::geometry::{Aabb, add, scale};
use crate::sample::{Amount, Stream};
use crate::{Error, Result, Sample, Scene};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

/// Look of splats.
#[derive(Debug, Clone, PartialEq)]
pub struct SplatLook {
    /// Seed of sizes, opacities and floaters.
    pub seed: u64,
    /// Typical standard deviation along the surface (m).
    pub spread_m: f64,
    /// Typical standard deviation across the surface (m).
    pub thickness_m: f64,
    /// Floaters per splat `[0..=1]`: faint blobs anywhere in the scene's bounds.
    pub floater_rate: f64,
}

impl SplatLook {
    /// Splats that cover the scene if it has as many samples: the spread is the distance between neighbours.
    pub fn for_scene(scene: &Scene, amount: Amount) -> Self {
        let area_of_one_m2 = match amount {
            Amount::Count(count) => scene.area() / count.max(1) as f64,
            Amount::Density(density) => 1.0 / density,
        };
        let spread_m = area_of_one_m2.sqrt();
        Self { seed: 1, spread_m, thickness_m: 0.1 * spread_m, floater_rate: 0.0 }
    }
}

/// Properties of a splat, all of them floats.
const PROPERTIES: &str = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";

/// Standard deviations at which a splat still shows: training shrinks those that reach into free space.
const SEEN: f64 = 2.0;
/// Distance from a surface at which a splat's rim shows (m).
const SEEN_M: f64 = 0.01;

/// Writes one splat per sample: a disc along the surface, 0.5 to 2 times the typical size, of opacity 0.3 to 0.99. Discs
/// that reach beyond an edge into free space are smaller, as after training.
pub fn write_splats(
    path: &Path,
    scene: &Scene,
    samples: &mut dyn Iterator<Item = Sample>,
    look: &SplatLook,
) -> Result<Written> {
    if !(0.0..=1.0).contains(&look.floater_rate) {
        return Err(Error::parameter("--floaters", format!("{} lies outside 0 to 1", look.floater_rate)));
    }
    let io = |what: &'static str| move |error| Error::io(path, what, error);
    let mut file = BufWriter::new(File::create(path).map_err(io("create"))?);
    let rng = &mut Stream::new(look.seed, 7);
    let bounds = scene.bounds();
    let (mut count, mut found) = (0u64, Aabb::EMPTY);
    file.write_all(header(0).as_bytes()).map_err(io("write"))?;
    for sample in samples {
        let shape = &scene.surfaces()[sample.surface as usize].shape;
        let normal = shape.normal_at(sample.position);
        let mut size = |typical: f64| typical * libm::exp2(2.0 * rng.unit() - 1.0);
        let mut sizes = [size(look.spread_m), size(look.spread_m), size(look.thickness_m)];
        let opacity = 0.3 + 0.69 * rng.unit();
        let rotation = turned_to(normal, rng.unit());
        for (axis, own) in sizes[..2].iter_mut().enumerate() {
            let along = axis_of(rotation, axis);
            let in_air = |size: f64| {
                [-SEEN, SEEN]
                    .iter()
                    .any(|side| !scene.has_near(add(sample.position, scale(along, side * size)), SEEN_M))
            };
            while *own > look.thickness_m && in_air(*own) {
                *own *= 0.7;
            }
        }
        put(&mut file, sample.position, sizes, rotation, opacity).map_err(io("write"))?;
        count += 1;
        found.grow(sample.position);
        if rng.unit() < look.floater_rate {
            let edge = [0, 1, 2].map(|axis| (bounds.max[axis] - bounds.min[axis]) * rng.unit());
            let mut size = |typical: f64| typical * libm::exp2(4.0 * rng.unit() - 2.0);
            let sizes = [0; 3].map(|_| size(look.spread_m));
            // Most are faint, a few are not.
            let opacity = 0.02 + 0.6 * rng.unit().powi(3);
            let at = add(bounds.min, edge);
            found.grow(at);
            put(&mut file, at, sizes, [1.0, 0.0, 0.0, 0.0], opacity).map_err(io("write"))?;
            count += 1;
        }
    }
    file.seek(SeekFrom::Start(0)).map_err(io("write"))?;
    file.write_all(header(count).as_bytes()).map_err(io("write"))?;
    file.flush().map_err(io("write"))?;
    let len_bytes = file.get_ref().metadata().map_err(io("measure"))?.len();
    Ok(Written { points: count, bounds: found, len_bytes })
}

/// The header; as long for every count.
fn header(count: u64) -> String {
    let properties: String = PROPERTIES.split(' ').map(|name| format!("property float {name}\n")).collect();
    format!("ply\nformat binary_little_endian 1.0\nelement vertex {count:020}\n{properties}end_header\n")
}

/// Quaternion that turns z to `normal`, after a turn about z by `share` of a full circle.
fn turned_to([x, y, z]: [f64; 3], share: f64) -> [f64; 4] {
    let (s, c) = libm::sincos(share * std::f64::consts::PI);
    let tilt = if z > -0.999_999 { [1.0 + z, -y, x, 0.0] } else { [0.0, 1.0, 0.0, 0.0] };
    let length = tilt.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, a, b, _] = tilt.map(|v| v / length);
    [w * c, a * c + b * s, b * c - a * s, w * s]
}

/// Direction of the first or second axis of a splat with this rotation.
fn axis_of([w, x, y, z]: [f64; 4], axis: usize) -> [f64; 3] {
    match axis {
        0 => [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        _ => [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
    }
}

fn put(file: &mut impl Write, at: [f64; 3], sizes: [f64; 3], q: [f64; 4], opacity: f64) -> std::io::Result<()> {
    let sizes = sizes.map(libm::log);
    let odds = libm::log(opacity / (1.0 - opacity));
    // A colour that follows the place.
    let dc = scale([0, 1, 2].map(|axis| (at[axis] - at[axis].floor()) - 0.5), 1.0 / 0.282_094_791_773_878_14);
    let mut row = [at, [0.0; 3], dc].concat().into_iter().chain([odds]).chain(sizes).chain(q);
    row.try_for_each(|value| file.write_all(&(value as f32).to_le_bytes()))
}
