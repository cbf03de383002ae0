//! Decodes any bytes as an encoded page; what decodes must encode to the same bytes.
#![no_main]

use libfuzzer_sys::fuzz_target;
use slicewalk::codec::{RawDecoder, RawEncoder};

fuzz_target!(|bytes: &[u8]| {
    if let Ok(page) = RawDecoder::default().decode(bytes) {
        let mut again = Vec::new();
        RawEncoder::default().encode(&page, &mut again);
        assert_eq!(again, bytes);
    }
});
