//! Opens any bytes as a LAS or LAZ file, as they are and behind a sound signature, and decodes what they seem to hold.
//!
//! Worth seeding with the odd files and small scans of other people's test suites.
#![no_main]

use libfuzzer_sys::fuzz_target;
use slicewalk::NoMonitor;
use slicewalk::input::{InputOptions, InputSet, PointDecoder, quiet_decoder_panics};
use std::path::PathBuf;

/// Points after which decoding ends: a few bytes of LAZ may stand for billions.
const ENOUGH: usize = 1 << 20;

fn read(path: PathBuf, bytes: &[u8]) {
    std::fs::write(&path, bytes).expect("a folder to write to");
    let Ok(set) = InputSet::open(&[path], InputOptions::default(), &NoMonitor) else { return };
    let mut decoder = PointDecoder::new();
    let mut points = 0;
    for chunk in set.chunks().take(64) {
        let decoded = decoder.decode(&set, &chunk, &mut |batch| {
            points += batch.len();
            assert!(batch.x.iter().chain(&batch.y).chain(&batch.z).all(|v| v.abs() <= 1e12));
            if points < ENOUGH { Ok(()) } else { Err(slicewalk::Error::Interrupted) }
        });
        if decoded.is_err() {
            return;
        }
    }
}

fuzz_target!(|bytes: &[u8]| {
    quiet_decoder_panics();
    let path = std::env::temp_dir().join(format!("slicewalk-fuzz-{}.laz", std::process::id()));
    read(path.clone(), bytes);
    let mut signed = bytes.to_vec();
    if signed.len() > 24 {
        signed[..4].copy_from_slice(b"LASF");
        signed[24] = 1;
        read(path.clone(), &signed);
    }
    let _ = std::fs::remove_file(path);
});
