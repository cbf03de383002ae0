//! See `targets::colours`.
#![no_main]

#[path = "../targets.rs"]
#[allow(dead_code, reason = "each fuzzer runs one target")]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = targets::colours(bytes);
});
