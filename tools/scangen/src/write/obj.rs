//! A scene as a mesh: Wavefront OBJ, one group per surface.

use crate::{Error, Result, Scene};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Writes the scene's surfaces as triangles of three vertices each, in groups `g LABEL_INDEX`; returns their number.
///
/// Curved surfaces are cut into steps of at most `step_m` `[m, > 0]`: polygons are exact, the vertices of others lie on
/// the surface. No vertex is shared; coordinates are printed so that they read back to the same `f64`.
pub fn write_triangles_obj(path: &Path, scene: &Scene, step_m: f64) -> Result<u64> {
    if !step_m.is_finite() || step_m <= 0.0 {
        return Err(Error::parameter("step", format!("{step_m} m is not above 0")));
    }
    let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
    let mut out = BufWriter::with_capacity(1 << 20, file);
    let mut count = 0u64;
    let mut write = || -> std::io::Result<()> {
        writeln!(out, "# scangen {}: z up, metres", scene.name())?;
        for (i, surface) in scene.surfaces().iter().enumerate() {
            writeln!(out, "g {}_{i}", surface.label.replace(' ', "_"))?;
            let mut done = Ok(());
            surface.shape.triangles(step_m, &mut |corners| {
                if done.is_ok() {
                    done = corners.iter().try_for_each(|[x, y, z]| writeln!(out, "v {x} {y} {z}"));
                    done = std::mem::replace(&mut done, Ok(())).and_then(|()| writeln!(out, "f -3 -2 -1"));
                    count += 1;
                }
            });
            done?;
        }
        out.flush()
    };
    write().map_err(|e| Error::io(path, "write triangles", e))?;
    Ok(count)
}
