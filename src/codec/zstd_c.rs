//! Zstandard by its C library: compression, which decides bytes of archives, and the fastest decompression.

use super::Violation;
use super::compress::{LEVEL, frame_error};
use zstd_safe::{CCtx, DCtx};

/// State of a compressor.
pub struct Compressor(CCtx<'static>);

impl Compressor {
    pub fn new() -> Self {
        Self(CCtx::try_create().expect("memory for the state of a compressor"))
    }

    /// Appends the frame of `raw` to `out`.
    pub fn compress(&mut self, raw: &[u8], out: &mut Vec<u8>) {
        let start = out.len();
        out.resize(start + zstd_safe::compress_bound(raw.len()), 0);
        let len = self.0.compress(&mut out[start..], raw, LEVEL).expect("room for the longest frame");
        out.truncate(start + len);
    }
}

/// State of a decompressor.
pub struct Decompressor(DCtx<'static>);

impl Decompressor {
    pub fn new() -> Self {
        Self(DCtx::try_create().expect("memory for the state of a decompressor"))
    }

    /// Replaces `raw` by the content of `frame`, which states that it has `raw.len()` bytes.
    pub fn decompress(&mut self, frame: &[u8], raw: &mut [u8], rule: &'static str) -> Result<(), Violation> {
        let wrong = |found: String| frame_error(rule, found);
        match zstd_safe::find_frame_compressed_size(frame) {
            Ok(size) if size == frame.len() => {}
            Ok(size) => return Err(wrong(format!("a frame of {size} bytes in {} bytes", frame.len()))),
            Err(code) => return Err(wrong(zstd_safe::get_error_name(code).into())),
        }
        match self.0.decompress(raw, frame) {
            Ok(written) if written == raw.len() => Ok(()),
            Ok(written) => Err(wrong(format!("{written} bytes where the frame states {}", raw.len()))),
            Err(code) => Err(wrong(zstd_safe::get_error_name(code).into())),
        }
    }
}
