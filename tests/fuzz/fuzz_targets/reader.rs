//! Any of the targets, the one that `SLICEWALK_FUZZ_TARGET` names: `e57`, `ptx`, `ply` and so on.
#![no_main]

#[path = "../targets.rs"]
#[allow(dead_code, reason = "archives, pages and scans have fuzzers of their own")]
mod targets;

use std::sync::LazyLock;

static TARGET: LazyLock<targets::Target> = LazyLock::new(|| {
    let wanted = std::env::var("SLICEWALK_FUZZ_TARGET").expect("SLICEWALK_FUZZ_TARGET names a target");
    *targets::TARGETS.iter().find(|(name, _)| *name == wanted).expect("a target of targets.rs")
});

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = TARGET.1(bytes);
});
