//! Extensions of glTF that shapes can be read without, and those that move shapes.

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
