//! A zstd frame around a directory leaf (specification, chapters 2 and 4).
//!
//! Frames are compressed at a fixed level by one thread, without dictionary or zstd's own checksum. They always state
//! their content size, so a reader allocates exactly what is needed. Equal input gives equal frames for the same
//! version of the zstd library; a reader accepts any conforming frame.

use super::Violation;
use zstd_safe::{CCtx, DCtx};

/// Compression level. It is fixed so that equal pages give equal files.
pub const LEVEL: i32 = 1;

/// Compresses byte strings.
pub struct Packer(CCtx<'static>);

impl Packer {
    /// Creates a packer with its own zstd state (about 1 MiB once used).
    pub fn new() -> Self {
        Self(CCtx::try_create().expect("memory for the state of a compressor"))
    }

    /// Appends the frame of `raw` to `out` and returns the frame's length.
    pub fn pack(&mut self, raw: &[u8], out: &mut Vec<u8>) -> usize {
        let start = out.len();
        out.resize(start + zstd_safe::compress_bound(raw.len()), 0);
        let len = self.0.compress(&mut out[start..], raw, LEVEL).expect("room for the longest frame");
        out.truncate(start + len);
        len
    }
}

impl Default for Packer {
    fn default() -> Self {
        Self::new()
    }
}

impl std::fmt::Debug for Packer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Packer")
    }
}

/// Decompresses byte strings into a buffer that it keeps.
pub struct Unpacker {
    state: DCtx<'static>,
    raw: Vec<u8>,
}

impl Unpacker {
    /// Creates an unpacker with its own zstd state (about 150 KiB).
    pub fn new() -> Self {
        let state = DCtx::try_create().expect("memory for the state of a decompressor");
        Self { state, raw: Vec::new() }
    }

    /// Returns the content of `frame`, which must be exactly one zstd frame with a stated content size of at most
    /// `max_len` bytes; anything else breaks `rule`.
    pub fn unpack(&mut self, frame: &[u8], max_len: usize, rule: &'static str) -> Result<&[u8], Violation> {
        let wrong = |found: String| Violation::new(rule, "one zstd frame with its content size", found);
        let len = match zstd_safe::get_frame_content_size(frame) {
            Ok(Some(len)) if len <= max_len as u64 => len as usize,
            Ok(Some(len)) => return Err(Violation::new(rule, format!("at most {max_len} bytes in the frame"), len)),
            Ok(None) => return Err(wrong("no content size".into())),
            Err(_) => return Err(wrong("no frame header".into())),
        };
        match zstd_safe::find_frame_compressed_size(frame) {
            Ok(size) if size == frame.len() => {}
            Ok(size) => return Err(wrong(format!("a frame of {size} bytes in {} bytes", frame.len()))),
            Err(code) => return Err(wrong(zstd_safe::get_error_name(code).into())),
        }
        self.raw.clear();
        self.raw.resize(len, 0);
        match self.state.decompress(&mut self.raw[..], frame) {
            Ok(written) if written == len => Ok(&self.raw),
            Ok(written) => Err(wrong(format!("{written} bytes where the frame states {len}"))),
            Err(code) => Err(wrong(zstd_safe::get_error_name(code).into())),
        }
    }
}

impl Unpacker {
    /// Returns the last unpacked content without a copy.
    pub fn into_content(self) -> Vec<u8> {
        self.raw
    }
}

impl Default for Unpacker {
    fn default() -> Self {
        Self::new()
    }
}

impl std::fmt::Debug for Unpacker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Unpacker")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn refuses_two_frames_trailing_bytes_and_large_contents() {
        let mut frame = Vec::new();
        Packer::new().pack(&[7; 1000], &mut frame);
        let mut unpacker = Unpacker::new();
        assert_eq!(unpacker.unpack(&frame, 1000, "D2").unwrap(), &[7; 1000]);
        assert_eq!(unpacker.unpack(&frame, 999, "D2").unwrap_err().rule, "D2");
        let twice = [&frame[..], &frame].concat();
        assert!(unpacker.unpack(&twice, 9999, "D2").is_err());
        assert!(unpacker.unpack(&[&frame[..], &[0]].concat(), 9999, "D2").is_err());
        assert!(unpacker.unpack(&frame[..frame.len() - 1], 9999, "D2").is_err());
        assert!(unpacker.unpack(&[], 9999, "D2").is_err());
    }

    proptest! {
        #[test]
        fn a_used_packer_gives_the_bytes_of_a_fresh_one(
            inputs in proptest::collection::vec(proptest::collection::vec(0u8..4, 0..3000), 1..5)
        ) {
            let (mut used, mut unpacker) = (Packer::new(), Unpacker::new());
            for input in &inputs {
                let (mut first, mut second) = (Vec::new(), vec![1, 2]);
                used.pack(input, &mut first);
                Packer::new().pack(input, &mut second);
                prop_assert_eq!(&first[..], &second[2..]);
                prop_assert_eq!(unpacker.unpack(&first, 3000, "D2").unwrap(), &input[..]);
            }
        }

        #[test]
        fn random_bytes_are_refused_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let framed = [&[0x28, 0xB5, 0x2F, 0xFD][..], &bytes].concat();
            let mut unpacker = Unpacker::new();
            for input in [&bytes, &framed] {
                if let Ok(raw) = unpacker.unpack(input, 5000, "D2") {
                    prop_assert!(raw.len() <= 5000);
                }
            }
        }
    }
}
