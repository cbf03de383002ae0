//! Colliders as binary glTF 2.0, a node for each tile, and as OBJ, an object for each tile.

use super::super::gltf::{self, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, FLOAT, UNSIGNED_INT};
use super::Collider;
use crate::Failure;
use serde_json::{Value, json};
use slicewalk_base::output::Output;
use slicewalk_base::text::number;
use std::io::{BufWriter, IntoInnerError, Write};

/// glTF is y-up.
fn turned<T: std::ops::Neg<Output = T>>([x, y, z]: [T; 3]) -> [T; 3] {
    [x, z, -y]
}

/// Writes a collider as binary glTF.
pub fn glb(collider: &Collider, to: Output) -> Result<(), Failure> {
    let pieces = &collider.pieces;
    let corners: u64 = pieces.iter().map(|piece| piece.corners.len() as u64).sum();
    let bytes = [12 * corners, 12 * collider.triangles()];
    let mut file = BufWriter::new(to);
    if gltf::write_head(&head(collider, bytes), bytes[0] + bytes[1], &mut file)? {
        for corner in pieces.iter().flat_map(|piece| &piece.corners) {
            for value in turned(*corner) {
                file.write_all(&value.to_le_bytes())?;
            }
        }
        for index in pieces.iter().flat_map(|piece| piece.triangles.as_flattened()) {
            file.write_all(&index.to_le_bytes())?;
        }
    }
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    Ok(())
}

fn head(collider: &Collider, bytes: [u64; 2]) -> Value {
    let extras = json!({ "error": collider.error_m });
    if collider.pieces.is_empty() {
        return json!({ "asset": gltf::asset(), "scene": 0, "scenes": [{ "extras": extras }] });
    }
    let (mut nodes, mut meshes, mut accessors) = (Vec::new(), Vec::new(), Vec::new());
    let mut at = [0, 0];
    for (number, piece) in collider.pieces.iter().enumerate() {
        let ends = |choose: fn(f32, f32) -> f32| {
            let corners = piece.corners.iter().map(|corner| turned(*corner));
            corners.reduce(|a, b| [0, 1, 2].map(|axis| choose(a[axis], b[axis]))).unwrap_or_default()
        };
        nodes.push(json!({ "mesh": number, "name": piece.name, "translation": turned(piece.origin) }));
        let attributes = json!({ "POSITION": 2 * number });
        meshes.push(json!({ "name": piece.name, "primitives": [{ "attributes": attributes, "indices": 2 * number + 1, "material": 0 }] }));
        let count = [piece.corners.len(), 3 * piece.triangles.len()];
        accessors.push(json!({
            "bufferView": 0, "byteOffset": at[0], "componentType": FLOAT, "count": count[0], "type": "VEC3",
            "min": ends(f32::min), "max": ends(f32::max)
        }));
        accessors.push(json!({
            "bufferView": 1, "byteOffset": at[1], "componentType": UNSIGNED_INT, "count": count[1], "type": "SCALAR"
        }));
        at = [at[0] + 12 * count[0] as u64, at[1] + 4 * count[1] as u64];
    }
    json!({
        "asset": gltf::asset(),
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>(), "extras": extras }],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [{
            "name": "collider",
            "pbrMetallicRoughness": { "baseColorFactor": [0.75, 0.75, 0.72, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0 }
        }],
        "accessors": accessors,
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": bytes[0], "byteStride": 12, "target": ARRAY_BUFFER },
            { "buffer": 0, "byteOffset": bytes[0], "byteLength": bytes[1], "target": ELEMENT_ARRAY_BUFFER }
        ],
        "buffers": [{ "byteLength": bytes[0] + bytes[1] }],
    })
}

/// Writes a collider as OBJ, in the coordinates of the archive.
pub fn obj(collider: &Collider, to: Output) -> Result<(), Failure> {
    let mut file = BufWriter::new(to);
    let version = env!("CARGO_PKG_VERSION");
    writeln!(file, "# slicetool {version}: metres, z up; at most {} m beyond the solid", number(collider.error_m))?;
    let mut first = 1;
    for piece in &collider.pieces {
        writeln!(file, "o {}", piece.name)?;
        for corner in &piece.corners {
            let [x, y, z] = [0, 1, 2].map(|axis| piece.origin[axis] + f64::from(corner[axis]));
            writeln!(file, "v {x} {y} {z}")?;
        }
        for triangle in &piece.triangles {
            let [a, b, c] = triangle.map(|at| u64::from(at) + first);
            writeln!(file, "f {a} {b} {c}")?;
        }
        first += piece.corners.len() as u64;
    }
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    Ok(())
}
