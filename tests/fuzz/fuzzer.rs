//! libFuzzer on the target in `SLICEWALK_FUZZ_TARGET`. Without a name it prints all names and ends.
#![no_main]

// An explicit path makes its own modules lie beside it, as in `tests/seeds.rs`.
#[path = "targets.rs"]
mod targets;

use std::sync::LazyLock;

static TARGET: LazyLock<targets::Target> = LazyLock::new(|| {
    let wanted = std::env::var("SLICEWALK_FUZZ_TARGET").unwrap_or_default();
    let names = || targets::TARGETS.iter().map(|(name, _)| *name);
    let Some(target) = targets::TARGETS.iter().find(|(name, _)| *name == wanted) else {
        println!("{}", names().collect::<Vec<_>>().join(" "));
        std::process::exit(if wanted.is_empty() { 0 } else { 2 });
    };
    *target
});

libfuzzer_sys::fuzz_target!(
    init: {
        LazyLock::force(&TARGET);
    },
    |bytes: &[u8]| {
        let _ = TARGET.1(bytes);
    }
);
