//! Streams of Zstandard frames: by the C library, or without C for WebAssembly.

use std::io::{BufRead, Read, Result};

/// Returns the content of the frames that `packed` consists of. Frames whose window has more than
/// 2^`most_window_log` bytes are refused.
#[cfg(not(target_arch = "wasm32"))]
pub fn unzstd<'a>(packed: impl BufRead + 'a, most_window_log: u32) -> Result<Box<dyn Read + 'a>> {
    let mut decoder = zstd::stream::read::Decoder::with_buffer(packed)?;
    decoder.window_log_max(most_window_log)?;
    Ok(Box::new(decoder))
}

/// Returns the content of the frames that `packed` consists of. Frames whose window has more than
/// 2^`most_window_log` bytes are refused.
#[cfg(target_arch = "wasm32")]
pub fn unzstd<'a>(packed: impl BufRead + 'a, most_window_log: u32) -> Result<Box<dyn Read + 'a>> {
    Ok(Box::new(rust::Frames::new(packed, most_window_log)))
}

#[cfg(any(target_arch = "wasm32", test))]
mod rust {
    use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
    use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};
    use std::io::{BufRead, Error, ErrorKind, Read, Result, copy, sink};

    /// Bytes decoded at once.
    const STEP: usize = 128 << 10;

    /// Reader of consecutive frames.
    pub struct Frames<R> {
        packed: R,
        decoder: FrameDecoder,
        is_within: bool,
        has_begun: bool,
    }

    impl<R: BufRead> Frames<R> {
        pub fn new(packed: R, most_window_log: u32) -> Self {
            let mut decoder = FrameDecoder::new();
            decoder.set_max_window_size(1 << most_window_log);
            Self { packed, decoder, is_within: false, has_begun: false }
        }
    }

    fn broken(error: FrameDecoderError) -> Error {
        Error::new(ErrorKind::InvalidData, error.to_string())
    }

    impl<R: BufRead> Read for Frames<R> {
        fn read(&mut self, buf: &mut [u8]) -> Result<usize> {
            while !buf.is_empty() {
                let read = if self.is_within { self.decoder.read(buf)? } else { 0 };
                if read > 0 {
                    return Ok(read);
                }
                if self.is_within && !self.decoder.is_finished() {
                    let how = BlockDecodingStrategy::UptoBytes(STEP);
                    self.decoder.decode_blocks(&mut self.packed, how).map_err(broken)?;
                    continue;
                }
                self.is_within = false;
                if self.packed.fill_buf()?.is_empty() {
                    // No frame at all is an error, as in the C library.
                    return if self.has_begun { Ok(0) } else { Err(ErrorKind::UnexpectedEof.into()) };
                }
                self.has_begun = true;
                match self.decoder.reset(&mut self.packed) {
                    Ok(()) => self.is_within = true,
                    Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame {
                        length, ..
                    })) => {
                        let skipped = copy(&mut (&mut self.packed).take(length.into()), &mut sink())?;
                        if skipped < length.into() {
                            return Err(ErrorKind::UnexpectedEof.into());
                        }
                    }
                    Err(error) => return Err(broken(error)),
                }
            }
            Ok(0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(packed: &[u8], window: u32) -> [Result<Vec<u8>>; 2] {
        let all = |mut reader: Box<dyn Read + '_>| {
            let mut bytes = Vec::new();
            reader.read_to_end(&mut bytes).map(|_| bytes)
        };
        [unzstd(packed, window).and_then(&all), all(Box::new(rust::Frames::new(packed, window)))]
    }

    proptest! {
        #[test]
        fn both_readers_give_the_same_content(
            parts in proptest::collection::vec(proptest::collection::vec(0u8..9, 0..9000), 0..4),
            skipped in proptest::option::of(0u8..50), cut in proptest::option::of(any::<prop::sample::Index>())
        ) {
            let mut packed: Vec<u8> = parts.iter().flat_map(|part| zstd::encode_all(&part[..], 3).unwrap()).collect();
            if let Some(len) = skipped {
                packed.extend([0x50, 0x2A, 0x4D, 0x18, len, 0, 0, 0]);
                packed.extend(vec![7; len.into()]);
            }
            if let (Some(cut), false) = (cut, packed.is_empty()) {
                packed.truncate(cut.index(packed.len()));
            }
            let [c, rust] = read(&packed, 27);
            match c {
                Ok(content) => prop_assert_eq!(content, rust.unwrap()),
                Err(_) => prop_assert!(rust.is_err()),
            }
        }
    }

    #[test]
    fn large_windows_are_refused() {
        let content: Vec<u8> = (0..1u32 << 21).flat_map(|n| n.wrapping_mul(0x9E37_79B9).to_le_bytes()).collect();
        let packed = zstd::encode_all(&content[..], 19).unwrap();
        assert!(read(&packed, 27).iter().all(|content| content.as_ref().is_ok_and(|content| content.len() == 1 << 23)));
        assert!(read(&packed, 12).iter().all(Result::is_err));
    }
}
