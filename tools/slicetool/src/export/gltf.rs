//! The container of binary glTF 2.0.

use crate::Failure;
use serde_json::{Value, json};
use std::io::Write;

/// Magic numbers and version of the container.
const MAGIC: u32 = 0x4654_6C67;
const VERSION: u32 = 2;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BINARY_CHUNK: u32 = 0x004E_4942;
/// Constants of the standard: 32-bit floats and unsigned integers, buffers of vertices and of indices.
pub const FLOAT: u32 = 5126;
pub const UNSIGNED_INT: u32 = 5125;
pub const ARRAY_BUFFER: u32 = 34962;
pub const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// The key `asset` of a head.
pub fn asset() -> Value {
    json!({ "version": "2.0", "generator": concat!("slicetool ", env!("CARGO_PKG_VERSION")) })
}

/// Writes all that comes before `bytes` of binary data, a multiple of four; returns whether there are any.
pub fn write_head(head: &Value, bytes: u64, out: &mut impl Write) -> Result<bool, Failure> {
    let head = head.to_string();
    let head = format!("{head}{}", " ".repeat(head.len().next_multiple_of(4) - head.len()));
    let chunks = if bytes == 0 { 0 } else { 8 + bytes };
    let length = u32::try_from(12 + 8 + head.len() as u64 + chunks)
        .map_err(|_| Failure::Text("the surface exceeds the 4 GiB of a glTF file; extract a region first".into()))?;
    for word in [MAGIC, VERSION, length, head.len() as u32, JSON_CHUNK] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(head.as_bytes())?;
    if bytes > 0 {
        for word in [bytes as u32, BINARY_CHUNK] {
            out.write_all(&word.to_le_bytes())?;
        }
    }
    Ok(bytes > 0)
}
