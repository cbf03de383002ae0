//! libFuzzer on the target in `SLICEWALK_FUZZ_TARGET`, or on the one that the program's file is named after, as OSS-Fuzz needs it.
//! Without either it prints all names and ends.
#![no_main]

// An explicit path makes its own modules lie beside it, as in `tests/seeds.rs`.
#[path = "targets.rs"]
mod targets;

use std::path::PathBuf;
use std::sync::LazyLock;

static TARGET: LazyLock<targets::Target> = LazyLock::new(|| {
    let find = |wanted: &str| targets::TARGETS.iter().find(|(name, _)| *name == wanted);
    let wanted = std::env::var("SLICEWALK_FUZZ_TARGET").ok();
    let file = std::env::args().next().map(PathBuf::from);
    let own = file.as_deref().and_then(|file| file.file_name()?.to_str());
    let Some(target) = wanted.as_deref().or(own).and_then(find) else {
        let names: Vec<_> = targets::TARGETS.iter().map(|(name, _)| *name).collect();
        println!("{}", names.join(" "));
        std::process::exit(if wanted.is_none() { 0 } else { 2 });
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
