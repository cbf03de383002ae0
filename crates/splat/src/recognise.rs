//! The format of a file, by its content and name.

use super::{HEAD_BYTES, SplatFormat};
use memchr::memmem::{find, find_iter};
use slicewalk_base::Result;
use slicewalk_base::bytes::ByteSource;
use slicewalk_base::text::behind_mark;
use std::path::Path;

/// Names of the extensions of glTF for splats begin with these.
const EXTENSIONS: [&[u8]; 2] = [b"KHR_gaussian_splatting", b"KHR_spz"];
/// Bytes of a structure of glTF searched at once, and bytes in which two such pieces overlap: longer than such a name and
/// what follows it up to its colon.
const PIECE_BYTES: u64 = 1 << 20;
const OVERLAP_BYTES: usize = 256;

/// Returns the format of the file that `path` names; `None` if it holds no Gaussian splats. The structure of a glTF is
/// searched whole, because programs that sort its keys write buffers of any length in front of its extensions.
pub fn format_of(source: &dyn ByteSource, path: &Path) -> Result<Option<SplatFormat>> {
    let mut bytes = vec![0; source.len().min(HEAD_BYTES as u64) as usize];
    source.read_at(0, &mut bytes)?;
    let format = recognise(&bytes, path);
    let Some(end) = structure_end(&bytes, path).filter(|_| format.is_none()) else { return Ok(format) };
    let (end, mut at) = (end.min(source.len()), bytes.len() as u64);
    while at < end {
        let kept = bytes.len().min(OVERLAP_BYTES);
        bytes.drain(..bytes.len() - kept);
        let len = (end - at).min(PIECE_BYTES);
        bytes.resize(kept + len as usize, 0);
        source.read_at(at, &mut bytes[kept..])?;
        at += len;
        if names_splats(&bytes) {
            return Ok(Some(SplatFormat::Gltf));
        }
    }
    Ok(None)
}

/// Returns whether bytes of a glTF have the name of an extension for splats as a key: files may list extensions that they
/// do not use.
fn names_splats(bytes: &[u8]) -> bool {
    let is_key = |at: usize| {
        let mut rest = bytes[at..].iter().take(OVERLAP_BYTES).skip_while(|byte| **byte != b'"').skip(1);
        rest.find(|byte| !byte.is_ascii_whitespace()) == Some(&b':')
    };
    EXTENSIONS.iter().any(|name| find_iter(bytes, *name).any(is_key))
}

/// Returns the ending of a name, in lower case.
fn ending_of(name: &Path) -> String {
    name.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase()
}

/// Returns whether a file begins like JSON.
fn is_json(head: &[u8]) -> bool {
    behind_mark(head).iter().find(|b| !b.is_ascii_whitespace()) == Some(&b'{')
}

/// Returns where the structure of a glTF ends, by the first bytes and the name of its file; `None` for other files.
fn structure_end(head: &[u8], name: &Path) -> Option<u64> {
    match *head {
        [b'g', b'l', b'T', b'F', _, _, _, _, _, _, _, _, a, b, c, d, ..] => {
            Some(20 + u64::from(u32::from_le_bytes([a, b, c, d])))
        }
        _ => (is_json(head) && ending_of(name) == "gltf").then_some(u64::MAX),
    }
}

/// Returns the format of a file by its first bytes and its name; `None` if it holds no Gaussian splats. [`HEAD_BYTES`]
/// are enough for all formats but glTF, see [`format_of`]. The content decides if it has a signature: a PLY or glTF of
/// points or triangles is not a file of splats, whatever its name.
pub fn recognise(head: &[u8], name: &Path) -> Option<SplatFormat> {
    let ending = ending_of(name);
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
    if head.starts_with(b"glTF") || (is_json(head) && ending == "gltf") {
        return names_splats(head).then_some(SplatFormat::Gltf);
    }
    if is_json(head) {
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
