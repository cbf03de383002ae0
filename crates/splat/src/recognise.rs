//! The format of a file, by its content and name.

use super::SplatFormat;
use memchr::memmem::find;
use slicewalk_base::text::behind_mark;
use std::path::Path;

/// Returns the format of a file by its first bytes ([`HEAD_BYTES`](crate::HEAD_BYTES) are enough) and its name; `None`
/// if it holds no Gaussian splats. The content decides if it has a signature: a PLY or glTF of points or triangles is
/// not a file of splats, whatever its name.
pub fn recognise(head: &[u8], name: &Path) -> Option<SplatFormat> {
    let ending = name.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let has = |text: &str| find(head, text.as_bytes()).is_some();
    let bare = behind_mark(head);
    if bare.starts_with(b"ply") {
        let end = find(bare, b"end_header").unwrap_or(bare.len());
        let word = |text: &str| bare[..end].split(u8::is_ascii_whitespace).any(|word| word == text.as_bytes());
        return if word("packed_position") && word("chunk") {
            Some(SplatFormat::CompressedPly)
        } else {
            (word("rot_0") && word("scale_0") || word("f_dc_0")).then_some(SplatFormat::Ply)
        };
    }
    if head.starts_with(b"NGSP") || (head.starts_with(&[0x1F, 0x8B]) && ending == "spz") {
        return Some(SplatFormat::Spz);
    }
    if head.starts_with(b"PK\x03\x04") {
        return (ending == "sog" || (ending == "zip" && has(".webp"))).then_some(SplatFormat::Sog);
    }
    let is_json = bare.iter().find(|b| !b.is_ascii_whitespace()) == Some(&b'{');
    if head.starts_with(b"glTF") || (is_json && ending == "gltf") {
        return (has("KHR_gaussian_splatting") || has("KHR_spz")).then_some(SplatFormat::Gltf);
    }
    if is_json {
        let whole = has("\"means\"") && has("\"quats\"");
        let levels = has("\"lodLevels\"") || (has("\"tree\"") && has("\"filenames\""));
        // The codebooks of a meta.json may push the next names out of the first bytes.
        return match name.file_name()?.to_str()? {
            _ if levels => Some(SplatFormat::SogLevels),
            _ if whole => Some(SplatFormat::SogFolder),
            "lod-meta.json" => Some(SplatFormat::SogLevels),
            "meta.json" if has("\"means\"") => Some(SplatFormat::SogFolder),
            _ => None,
        };
    }
    match ending.as_str() {
        "splat" => Some(SplatFormat::Splat),
        "ksplat" => Some(SplatFormat::Ksplat),
        "spz" => Some(SplatFormat::Spz),
        "sog" => Some(SplatFormat::Sog),
        _ => None,
    }
}
