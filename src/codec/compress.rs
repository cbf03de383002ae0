//! A zstd frame around a directory leaf (specification, chapters 2 and 4).
//!
//! Frames are compressed at a fixed level by one thread, without dictionary or zstd's own checksum. They always state
//! their content size, so a reader allocates exactly what is needed. Equal input gives equal frames for the same
//! version of the zstd library; a reader accepts any conforming frame.

use super::Violation;
#[cfg(not(target_arch = "wasm32"))]
use super::zstd_c::{Compressor, Decompressor};
#[cfg(target_arch = "wasm32")]
pub use super::zstd_rust::set_compressor;
#[cfg(target_arch = "wasm32")]
use super::zstd_rust::{Compressor, Decompressor};

/// Compression level. It is fixed so that equal pages give equal files.
pub const LEVEL: i32 = 1;

/// Compresses byte strings.
pub struct Packer(Compressor);

impl Packer {
    /// Creates a packer with its own zstd state (about 1 MiB once used).
    pub fn new() -> Self {
        Self(Compressor::new())
    }

    /// Appends the frame of `raw` to `out`.
    pub fn pack(&mut self, raw: &[u8], out: &mut Vec<u8>) {
        self.0.compress(raw, out);
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
    state: Decompressor,
    raw: Vec<u8>,
}

impl Unpacker {
    /// Creates an unpacker with its own zstd state (about 150 KiB).
    pub fn new() -> Self {
        Self { state: Decompressor::new(), raw: Vec::new() }
    }

    /// Returns the content of `frame`, which must be exactly one zstd frame with a stated content size of at most
    /// `max_len` bytes; anything else breaks `rule`.
    pub fn unpack(&mut self, frame: &[u8], max_len: usize, rule: &'static str) -> Result<&[u8], Violation> {
        let len = match content_size(frame).map_err(|found| frame_error(rule, found.into()))? {
            len if len <= max_len as u64 => len as usize,
            len => return Err(Violation::new(rule, format!("at most {max_len} bytes in the frame"), len)),
        };
        self.raw.clear();
        self.raw.resize(len, 0);
        self.state.decompress(frame, &mut self.raw, rule)?;
        Ok(&self.raw)
    }
}

/// A frame that breaks `rule`.
pub(super) fn frame_error(rule: &'static str, found: String) -> Violation {
    Violation::new(rule, "one zstd frame with its content size", found)
}

/// Returns the content size (bytes) that the header of a zstd frame states (RFC 8878, section 3.1.1.1).
fn content_size(frame: &[u8]) -> Result<u64, &'static str> {
    const MAGIC: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];
    let descriptor = *frame.strip_prefix(&MAGIC).and_then(<[u8]>::first).ok_or("no frame header")?;
    if descriptor & 0x08 != 0 {
        return Err("a reserved bit");
    }
    let is_single = descriptor & 0x20 != 0;
    let bytes = match descriptor >> 6 {
        0 if !is_single => return Err("no content size"),
        0 => 1,
        flag => 1usize << flag,
    };
    // Between descriptor and content size: the window unless there is a single segment, and the dictionary's number.
    let dictionary = [0, 1, 2, 4][usize::from(descriptor & 3)];
    let start = MAGIC.len() + 1 + usize::from(!is_single) + dictionary;
    let stated = frame.get(start..start + bytes).ok_or("no frame header")?;
    let size = stated.iter().rev().fold(0u64, |size, &byte| size << 8 | u64::from(byte));
    Ok(if bytes == 2 { size + 256 } else { size })
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
        let mut reserved = frame;
        reserved[4] |= 0x08;
        assert!(unpacker.unpack(&reserved, 9999, "D2").unwrap_err().found.contains("reserved"));
    }

    #[test]
    fn a_frame_of_another_length_than_it_states_is_refused() {
        use crate::codec::{zstd_c, zstd_rust};
        let content: Vec<u8> = (0..1000u32).map(|at| (at * at % 7) as u8).collect();
        let mut frame = Vec::new();
        Packer::new().pack(&content, &mut frame);
        // Sizes from 256 take two bytes, less 256.
        let bytes = |size: u16| (size - 256).to_le_bytes();
        let at = frame.windows(2).position(|pair| pair == bytes(1000)).unwrap();
        for size in [999, 1001] {
            frame[at..at + 2].copy_from_slice(&bytes(size));
            assert_eq!(content_size(&frame), Ok(size.into()));
            let mut raw = vec![0; size.into()];
            assert_eq!(zstd_c::Decompressor::new().decompress(&frame, &mut raw, "D2").unwrap_err().rule, "D2");
            assert_eq!(zstd_rust::Decompressor::new().decompress(&frame, &mut raw, "D2").unwrap_err().rule, "D2");
        }
    }

    /// Every form of a header (RFC 8878, section 3.1.1.1), and its bytes from the fifth.
    #[test]
    fn content_sizes_are_read_from_every_header() {
        let header = |after: &[u8]| content_size(&[&[0x28, 0xB5, 0x2F, 0xFD], after].concat());
        let forms = [
            // A single segment with sizes of 1, 2, 4 and 8 bytes.
            (&[0x20, 9][..], 9),
            (&[0x60, 9, 1], 256 + 265),
            (&[0xA0, 9, 1, 2, 3], 0x0302_0109),
            (&[0xE0, 9, 1, 2, 3, 4, 5, 6, 7], 0x0706_0504_0302_0109),
            // The byte of a window precedes sizes.
            (&[0x40, 0x58, 9, 1], 256 + 265),
            (&[0x80, 0x58, 9, 1, 2, 3], 0x0302_0109),
            // So do dictionaries' numbers of 1, 2 and 4 bytes.
            (&[0x21, 7, 9], 9),
            (&[0x22, 7, 7, 9], 9),
            (&[0x23, 7, 7, 7, 7, 9], 9),
            (&[0x43, 0x58, 7, 7, 7, 7, 9, 1], 256 + 265),
        ];
        for (bytes, size) in forms {
            assert_eq!(header(bytes), Ok(size), "{bytes:x?}");
            assert_eq!(header(&bytes[..bytes.len() - 1]), Err("no frame header"), "{bytes:x?}");
        }
        assert_eq!(header(&[0x00, 0x58, 9]), Err("no content size"));
        assert_eq!(header(&[0x28, 9]), Err("a reserved bit"));
    }

    /// A skippable frame adds nothing to the content.
    #[test]
    fn a_frame_with_another_behind_it_is_refused() {
        use crate::codec::{zstd_c, zstd_rust};
        let (mut frame, mut raw) = (Vec::new(), [0; 40]);
        Packer::new().pack(&[7; 40], &mut frame);
        assert_eq!(zstd_c::Decompressor::new().decompress(&frame, &mut raw, "D2"), Ok(()));
        frame.extend([0x50, 0x2A, 0x4D, 0x18, 0, 0, 0, 0]);
        assert_eq!(zstd_c::Decompressor::new().decompress(&frame, &mut raw, "D2").unwrap_err().rule, "D2");
        assert_eq!(zstd_rust::Decompressor::new().decompress(&frame, &mut raw, "D2").unwrap_err().rule, "D2");
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

        /// Both decompressors accept the same frames, whole, cut, flipped and followed by bytes.
        #[test]
        fn a_page_reads_what_a_program_reads(
            input in proptest::collection::vec(0u8..6, 0..5000), at in any::<prop::sample::Index>(), bit in 0..8u32, how in 0..4
        ) {
            use crate::codec::{zstd_c, zstd_rust};
            let mut frame = Vec::new();
            Packer::new().pack(&input, &mut frame);
            match how {
                0 => {}
                1 => frame.truncate(at.index(frame.len())),
                2 => frame.push(0),
                _ => {
                 let at = at.index(frame.len());
                 frame[at] ^= 1u8 << bit;
             }
            }
            let Ok(len) = content_size(&frame) else { return Ok(()) };
            // A flipped bit may also ask for a window that only the C library refuses here already.
            let by_c = zstd_safe::get_frame_content_size(&frame).ok().flatten();
            prop_assert!(by_c == Some(len) || how == 3 && by_c.is_none(), "{:?} where the header states {}", by_c, len);
            let len = (len as usize).min(20_000);
            let (mut by_c, mut by_rust) = (vec![0; len], vec![0; len]);
            let c = zstd_c::Decompressor::new().decompress(&frame, &mut by_c, "D2");
            let rust = zstd_rust::Decompressor::new().decompress(&frame, &mut by_rust, "D2");
            // A flipped bit may leave a frame that only one of them refuses; archives have a checksum above it.
            prop_assert!(how == 3 || c.is_ok() == rust.is_ok(), "{:?} {:?}", c, rust);
            if c.is_ok() && rust.is_ok() && how < 3 {
                prop_assert_eq!(by_c, by_rust);
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
