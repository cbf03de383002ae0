//! The format of a file, by its content and name.

use crate::binary_of;
use std::path::Path;

/// Format of a file of cubes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CubeFormat {
    /// OctoMap tree of two bits a node (`.bt`).
    OctomapBinary,
    /// OctoMap tree with probabilities (`.ot`).
    Octomap,
    /// Header of a voxel octree (`.voxel.json`).
    Voxel,
}

/// First line of a `.bt`, without its end.
pub const BINARY: &[u8] = b"# Octomap OcTree binary file";
/// First line of a `.ot`, without its end.
pub const FULL: &[u8] = b"# Octomap OcTree file";

/// Returns the format of a file by its first bytes ([`HEAD_BYTES`](crate::HEAD_BYTES) are enough) and its name; `None`
/// if it holds no cubes. Names decide for files whose content says nothing, so that damaged ones get their own message.
pub fn recognise(head: &[u8], name: &Path) -> Option<CubeFormat> {
    let ending = name.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match ending.as_str() {
        _ if head.starts_with(BINARY) => Some(CubeFormat::OctomapBinary),
        _ if head.starts_with(FULL) => Some(CubeFormat::Octomap),
        "bt" => Some(CubeFormat::OctomapBinary),
        "ot" => Some(CubeFormat::Octomap),
        "json" => binary_of(name).map(|_| CubeFormat::Voxel),
        _ => None,
    }
}
