//! Decodes any bytes as an encoded page; what decodes must encode to bytes that decode to the same page.
#![no_main]

use libfuzzer_sys::fuzz_target;
use slicewalk::codec::{Decoder, Encoder};
use slicewalk::frame::Frame;

fuzz_target!(|bytes: &[u8]| {
    let mut decoder = Decoder::default();
    if let (Ok(page), Ok(frame)) = (decoder.decode(bytes), Frame::new(0.05, 0.15)) {
        let mut again = Vec::new();
        Encoder::new(frame).encode(&page, &mut again);
        assert_eq!(decoder.decode(&again).as_ref(), Ok(&page));
    }
});
