//! Textures: PNG and JPEG files and images inside glTF, decoded once per mesh file within a memory limit.
//!
//! A missing or unreadable texture is a warning: the rest of its material colours the triangles. One that exceeds the
//! memory limit is an error, because the contents of an archive must not depend on the memory.

use super::watch::{Digest, Watch};
use crate::bytes::Regular;
use crate::input::beside::Beside;
use crate::paint::{Image, Texture, Wrap};
use crate::{Error, Parameter, Result};
use std::collections::HashMap;
use std::hash::Hash;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// Longest edge of a texture (texels).
const MOST_EDGE: u32 = 1 << 15;
/// Most texels of a texture.
const MOST_TEXELS: u64 = 1 << 28;
/// Most warnings for the textures of one file.
const MOST_WARNINGS: u32 = 8;

/// Reason for a missing image.
#[derive(Debug)]
pub(super) enum Fault {
    /// It cannot be used, which is a warning.
    Unusable(String),
    /// It needs this many bytes, which exceeds the limit.
    Memory(u64),
    /// The mesh file itself could not be read.
    Failed(Error),
}

impl From<String> for Fault {
    fn from(reason: String) -> Self {
        Self::Unusable(reason)
    }
}

/// Textures of one mesh file by key.
pub(super) struct Textures<K> {
    path: PathBuf,
    images: HashMap<K, Option<Arc<Texture>>>,
    /// Most bytes that the textures may take, and the bytes they take.
    most_bytes: u64,
    held: u64,
    warnings: u32,
    digest: Digest,
    alive: Arc<()>,
}

impl<K: Eq + Hash> Textures<K> {
    /// Creates an empty set for the mesh file at `path`. Each texture holds a clone of `alive`.
    pub(super) fn new(path: &Path, most_bytes: u64, digest: &Digest, alive: &Arc<()>) -> Self {
        let (images, digest) = (HashMap::new(), digest.clone());
        Self { path: path.to_path_buf(), images, most_bytes, held: 0, warnings: 0, digest, alive: Arc::clone(alive) }
    }

    /// Warns about the colours of the file, at most [`MOST_WARNINGS`] times.
    pub(super) fn warn(&mut self, watch: &Watch, text: &str) {
        self.warnings += 1;
        if self.warnings <= MOST_WARNINGS {
            let last =
                if self.warnings == MOST_WARNINGS { " (further warnings for this file are left out)" } else { "" };
            watch.monitor.warn(&format!("{}: {text}{last}", self.path.display()).into());
        }
    }

    /// Adds to the hash of the bytes read for this file.
    pub(super) fn add_to_digest(&self, bytes: &[u8]) {
        self.digest.update(bytes);
    }

    /// Returns the texture of `key`, which `read` reads given the most bytes that it may have. Returns `None` if the
    /// texture cannot be used, and warns the first time.
    pub(super) fn get(
        &mut self,
        key: K,
        (name, wrap): (&str, [Wrap; 2]),
        watch: &Watch,
        read: impl FnOnce(u64) -> Result<Vec<u8>, Fault>,
    ) -> Result<Option<Arc<Texture>>> {
        if let Some(found) = self.images.get(&key) {
            return Ok(found.clone());
        }
        watch.check_cancelled()?;
        let left = self.most_bytes.saturating_sub(self.held);
        let image = read(left).and_then(|bytes| {
            self.digest.update(&bytes);
            decode(&bytes, left.saturating_sub(bytes.len() as u64))
        });
        let texture = match image {
            Ok((image, bytes)) => {
                self.held += bytes;
                Some(Arc::new(Texture::new(Arc::new(image), wrap, &self.alive)))
            }
            Err(Fault::Unusable(reason)) => {
                self.warn(watch, &format!("texture {name}: {reason}; its triangles get the colour of their material"));
                None
            }
            Err(Fault::Failed(error)) => return Err(error),
            Err(Fault::Memory(bytes)) => {
                let what = format!("{}: textures up to {name} (bytes)", self.path.display());
                let needed = self.held.saturating_add(bytes);
                return Err(Error::limit(what, needed, self.most_bytes).with_suggestion(Parameter::Memory));
            }
        };
        self.images.insert(key, texture.clone());
        Ok(texture)
    }
}

/// Reads a file that the mesh refers to, beside it or in a folder below.
pub(super) fn read_beside(files: &mut Beside, name: &str, most_bytes: u64) -> Result<Vec<u8>, Fault> {
    let path = files.path(name)?;
    let refused = |e: std::io::Error| format!("cannot read {}: {e}", path.display());
    let (file, about) = Regular::open(&path).map_err(refused)?;
    if about.len() > most_bytes {
        return Err(Fault::Memory(about.len()));
    }
    let mut bytes = Vec::new();
    file.take(most_bytes).read_to_end(&mut bytes).map_err(refused)?;
    Ok(bytes)
}

/// Decodes an image; returns it with the bytes that it takes. Takes at most `most_bytes`, both during decoding and
/// afterwards.
fn decode(bytes: &[u8], most_bytes: u64) -> Result<(Image, u64), Fault> {
    let (width, height, rgb) = match bytes {
        [0x89, b'P', b'N', b'G', ..] => decode_png(bytes, most_bytes)?,
        [0xFF, 0xD8, ..] => decode_jpeg(bytes, most_bytes)?,
        _ => return Err("it is neither PNG nor JPEG".to_owned().into()),
    };
    let texels = u64::from(width) * u64::from(height);
    Ok((Image::new(width, height, rgb), Image::bytes(texels)))
}

/// Checks the size of an image whose decoding takes `bytes_each` bytes per texel in addition to its mipmap levels.
fn check_size(width: u64, height: u64, bytes_each: u64, most_bytes: u64) -> Result<(u32, u32), Fault> {
    let (edge, texels) = (width.max(height), width.saturating_mul(height));
    if texels == 0 || edge > u64::from(MOST_EDGE) || texels > MOST_TEXELS {
        let reason =
            format!("{width} × {height} texels; expected 1 to {MOST_EDGE} along an edge and at most {MOST_TEXELS}");
        return Err(reason.into());
    }
    let needed = texels.saturating_mul(bytes_each).saturating_add(Image::bytes(texels)) + (1 << 20);
    if needed > most_bytes {
        return Err(Fault::Memory(needed));
    }
    Ok((width as u32, height as u32))
}

fn decode_png(bytes: &[u8], most_bytes: u64) -> Result<(u32, u32, Vec<u8>), Fault> {
    let damaged = |e: png::DecodingError| Fault::Unusable(format!("it is damaged: {e}"));
    let limits = png::Limits { bytes: usize::try_from(most_bytes).unwrap_or(usize::MAX) };
    let mut decoder = png::Decoder::new_with_limits(std::io::Cursor::new(bytes), limits);
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    decoder.set_ignore_text_chunk(true);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let (color, _) = reader.output_color_type();
    let samples = color.samples();
    let (width, height) = (u64::from(reader.info().width), u64::from(reader.info().height));
    // An interlaced image is buffered in full, with up to 16 bits per channel as in the file.
    let (width, height) = check_size(width, height, 1 + samples as u64, most_bytes)?;
    let size = reader.output_buffer_size().ok_or_else(|| Fault::Unusable("it is too large".into()))?;
    let mut values = vec![0; size];
    let info = reader.next_frame(&mut values).map_err(damaged)?;
    values.truncate(info.buffer_size());
    let texels = width as usize * height as usize;
    if values.len() < texels * samples || samples == 0 {
        return Err("it is damaged: rows are missing".to_owned().into());
    }
    // In place, so that an image of four channels is not in memory twice.
    match samples {
        1 | 2 => {
            let grey = values.chunks_exact(samples).take(texels);
            values = grey.flat_map(|texel| [texel[0]; 3]).collect();
        }
        _ => {
            for texel in 0..texels {
                values.copy_within(texel * samples..texel * samples + 3, texel * 3);
            }
            values.truncate(3 * texels);
        }
    }
    Ok((width, height, values))
}

fn decode_jpeg(bytes: &[u8], most_bytes: u64) -> Result<(u32, u32, Vec<u8>), Fault> {
    let damaged = |e: zune_jpeg::errors::DecodeErrors| Fault::Unusable(format!("it is damaged: {e}"));
    let edge = MOST_EDGE as usize;
    let options = DecoderOptions::new_safe()
        .set_strict_mode(true)
        .set_max_width(edge)
        .set_max_height(edge)
        .jpeg_set_max_scans(64)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(damaged)?;
    let info = decoder.info().ok_or_else(|| "it has no size".to_owned())?;
    // A progressive image is held as 16-bit coefficients of up to four channels until its end.
    let bytes_each = if is_progressive(bytes) { 3 + 8 } else { 3 };
    let (width, height) = check_size(info.width.into(), info.height.into(), bytes_each, most_bytes)?;
    let values = decoder.decode().map_err(damaged)?;
    if values.len() < 3 * width as usize * height as usize {
        return Err("it is damaged: rows are missing".to_owned().into());
    }
    Ok((width, height, values))
}

/// Returns whether a JPEG is progressive: its frame is neither baseline nor extended sequential (ITU-T T.81, table
/// B.1).
fn is_progressive(bytes: &[u8]) -> bool {
    let mut at = 2;
    loop {
        match bytes.get(at..at + 4) {
            Some(&[0xFF, 0xFF, ..]) => at += 1,
            Some(&[0xFF, 0xC0 | 0xC1, ..]) => return false,
            Some(&[0xFF, 0xC4 | 0xC8 | 0xCC | 0xD8..=0xFE, high, low]) => {
                at += 2 + usize::from(u16::from_be_bytes([high, low]));
            }
            _ => return true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// JPEG of 8 × 8 grey texels, all of the value 128 + `more`, which is 64 to 127.
    fn grey(more: u8) -> Vec<u8> {
        let mut bytes = vec![0xFF, 0xD8, 0xFF, 0xDB, 0, 67, 0];
        // With steps of 8 the first coefficient is what it adds to each texel.
        bytes.extend([8; 64]);
        bytes.extend([0xFF, 0xC0, 0, 11, 8, 0, 8, 0, 8, 1, 1, 0x11, 0]);
        for (table, symbol) in [(0x00, 7), (0x10, 0)] {
            bytes.extend([0xFF, 0xC4, 0, 20, table, 1]);
            bytes.extend([0; 15]);
            bytes.push(symbol);
        }
        bytes.extend([0xFF, 0xDA, 0, 8, 1, 1, 0, 0, 63, 0]);
        // One bit for "seven bits follow", these, one bit for "no more coefficients", and ones.
        bytes.extend([more & 0x7F, 0x7F, 0xFF, 0xD9]);
        bytes
    }

    #[test]
    fn a_grey_jpeg_is_grey() {
        let (width, height, rgb) = decode_jpeg(&grey(72), 1 << 30).unwrap();
        assert_eq!((width, height, rgb.len()), (8, 8, 3 * 64));
        assert!(rgb.iter().all(|value| value.abs_diff(200) <= 1), "{rgb:?}");
    }

    #[test]
    fn frames_are_found_behind_any_segments_and_fill_bytes() {
        let baseline = grey(64);
        let of = |from: &[u8], to: &[u8]| {
            let at = baseline.windows(from.len()).position(|bytes| bytes == from).unwrap();
            [&baseline[..at], to, &baseline[at + from.len()..]].concat()
        };
        for (bytes, expected) in [
            (baseline.clone(), false),
            (of(&[0xFF, 0xC0], &[0xFF, 0xC1]), false),
            (of(&[0xFF, 0xC0], &[0xFF, 0xC2]), true),
            // A marker may have any number of fill bytes before it (ITU-T T.81, B.1.1.2).
            (of(&[0xFF, 0xC0], &[0xFF, 0xFF, 0xFF, 0xC0]), false),
            (of(&[0xFF, 0xC0], &[0xFF, 0xFF, 0xFF, 0xC2]), true),
        ] {
            assert_eq!(is_progressive(&bytes), expected, "{bytes:?}");
        }
    }
}
