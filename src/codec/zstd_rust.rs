//! Zstandard without C, for WebAssembly: a page must be buildable where no C compiler knows WebAssembly. Readers only
//! decompress; a program that writes archives sets its compressor, which must give the bytes of `zstd_c`.

use super::Violation;
use super::compress::frame_error;
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};
use std::sync::OnceLock;

/// Appends the frame of its first argument, at [`LEVEL`](super::compress::LEVEL), to the second one.
pub type Compress = fn(&[u8], &mut Vec<u8>);

static COMPRESS: OnceLock<Compress> = OnceLock::new();

/// Sets the function that compresses; the first one stays.
#[cfg_attr(not(target_arch = "wasm32"), allow(dead_code, reason = "tests decompress only"))]
pub fn set_compressor(compress: Compress) {
    let _ = COMPRESS.set(compress);
}

/// State of a compressor.
#[cfg_attr(not(target_arch = "wasm32"), allow(dead_code, reason = "tests decompress only"))]
pub struct Compressor(Compress);

#[cfg_attr(not(target_arch = "wasm32"), allow(dead_code, reason = "tests decompress only"))]
impl Compressor {
    pub fn new() -> Self {
        Self(*COMPRESS.get().expect("a compressor that was set before an archive is written"))
    }

    /// Appends the frame of `raw` to `out`.
    pub fn compress(&mut self, raw: &[u8], out: &mut Vec<u8>) {
        (self.0)(raw, out);
    }
}

/// State of a decompressor.
pub struct Decompressor(FrameDecoder);

impl Decompressor {
    pub fn new() -> Self {
        Self(FrameDecoder::new())
    }

    /// Replaces `raw` by the content of `frame`, which states that it has `raw.len()` bytes.
    pub fn decompress(&mut self, frame: &[u8], raw: &mut [u8], rule: &'static str) -> Result<(), Violation> {
        let decoder = &mut self.0;
        let mut rest = frame;
        let broken = |error: ruzstd::decoding::errors::FrameDecoderError| frame_error(rule, error.to_string());
        // A window is never larger than what a frame of this content needs, rounded as writers round it.
        decoder.set_max_window_size((raw.len() as u64 * 2).max(1 << 20));
        decoder.reset(&mut rest).map_err(broken)?;
        // One byte more, so that a frame that holds more than it states is noticed before it grows.
        decoder.decode_blocks(&mut rest, BlockDecodingStrategy::UptoBytes(raw.len() + 1)).map_err(broken)?;
        let written = decoder.can_collect();
        if !decoder.is_finished() || written != raw.len() {
            return Err(frame_error(rule, format!("{written} bytes where the frame states {}", raw.len())));
        }
        if !rest.is_empty() {
            return Err(frame_error(rule, format!("{} bytes behind the frame", rest.len())));
        }
        let mut room = &mut raw[..];
        decoder.collect_to_writer(&mut room).map_err(|error| frame_error(rule, error.to_string()))?;
        Ok(())
    }
}
