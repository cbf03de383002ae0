//! Rules of glTF for readers of meshes and of splats: extensions that shapes can be read without, those that move
//! shapes, and the matrices of nodes.

/// Extensions that a file may require: those that are read, and those that neither move nor add triangles (appearance,
/// lights, metadata, animations, which rest, and coarser copies). A name that ends in `_` is a prefix.
const HARMLESS: [&str; 20] = [
    "KHR_mesh_quantization",
    "EXT_mesh_gpu_instancing",
    "KHR_materials_",
    "EXT_materials_",
    "ADOBE_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_dds",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "KHR_animation_pointer",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "EXT_mesh_features",
    "EXT_instance_features",
    "EXT_structural_metadata",
    "CESIUM_primitive_outline",
    "MSFT_lod",
];
/// Extensions that move triangles and are not supported: files that use them are refused, whether they require them or
/// not.
const MOVING: [&str; 1] = ["CESIUM_RTC"];

/// Returns whether a file that requires this extension can be read without knowing it.
pub fn is_harmless(name: &str) -> bool {
    HARMLESS.iter().any(|of| if of.ends_with('_') { name.starts_with(of) } else { name == *of })
}

/// Returns whether a file that uses this extension is elsewhere than it seems.
pub fn moves(name: &str) -> bool {
    MOVING.contains(&name)
}

/// Checks that the matrix of a node, by columns, is affine (glTF 2.0, section 3.5.3); returns the reason if not.
pub fn check_matrix(matrix: &[f64; 16]) -> Result<(), String> {
    let [a, b, c, d] = [3, 7, 11, 15].map(|at| matrix[at]);
    if [a, b, c, d] == [0.0, 0.0, 0.0, 1.0] {
        return Ok(());
    }
    Err(format!(
        "expected a matrix with the last row 0 0 0 1, found {a} {b} {c} {d}; write it column by column and without \
         perspective"
    ))
}
