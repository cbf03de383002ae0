//! Hostile archives under limits of the system: every command ends by itself, in a stated amount of memory, with an answer or one
//! line. `docs/budgets.md` has the amounts.
#![cfg(target_os = "linux")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Memory of a command that looks at an archive (MiB), caches not included.
const MEMORY_MIB: u64 = 64;
/// Memory of a surface, which is held whole (MiB).
const SURFACE_MIB: u64 = 1024;
/// The cache that queries and walks get (MiB).
const CACHE_MIB: u64 = 16;
/// Time of the processor after which the system ends a command (s): many times what the slowest takes, so that only endless work
/// is found.
const SECONDS: u64 = 60;

/// Runs the program under limits of private memory and of time.
fn limited(folder: &Path, mib: u64, arguments: &[&str]) -> Output {
    let limits = format!("ulimit -d {} && ulimit -t {SECONDS} && exec \"$0\" \"$@\"", mib << 10);
    Command::new("sh")
        // One arena: each further one reserves what it may never use.
        .env("MALLOC_ARENA_MAX", "1")
        .current_dir(folder)
        .args(["-c", &limits, env!("CARGO_BIN_EXE_slicetool")])
        .args(arguments)
        .output()
        .unwrap()
}

/// It did its work, or said in one line why not.
fn is_handled(arguments: &[&str], out: &Output) {
    let said = String::from_utf8_lossy(&out.stderr);
    let code = out.status.code();
    assert!(matches!(code, Some(0 | 1)), "{arguments:?}: {}, {said}", out.status);
    assert!(!said.contains("panicked") && !said.contains("memory allocation"), "{arguments:?}: {said}");
    assert!(code == Some(0) || said.lines().count() <= 1, "{arguments:?}: {said}");
}

#[test]
fn forged_archives_cost_little_whatever_is_asked() {
    let Some(data) = std::env::var_os("SLICEWALK_DATA").map(PathBuf::from).filter(|data| data.join("forged").is_dir())
    else {
        eprintln!("skipped: SLICEWALK_DATA names no folder with forged archives");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("boxes.csv"), "0,0,0,1,1,1\n-1e6,-1e6,-1e6,1e6,1e6,1e6\n").unwrap();
    fs::write(at.join("rays.csv"), "0,0,1,1,0,0,1e9\n0,0,1,0,0,-1,inf\n").unwrap();
    fs::write(at.join("way.csv"), "1,1\n2,2\n").unwrap();
    let cache = format!("{CACHE_MIB}MiB");
    let mut count = 0;
    for entry in fs::read_dir(data.join("forged")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|ending| ending != "slices") {
            continue;
        }
        count += 1;
        let name = path.to_str().unwrap();
        let commands: [&[&str]; 16] = [
            &["info", name, "--json"],
            &["verify", name],
            &["stats", name],
            &["show", name, "--slice", "0", "-o", "s.png"],
            &["diff", name, name],
            &["query", name, "--boxes", "boxes.csv", "--cache", &cache],
            &["query", name, "--rays", "rays.csv", "--cache", &cache],
            &["walk", name, "--start", "0,0,0", "--waypoints", "way.csv", "--cache", &cache, "-o", "p.csv"],
            &["reach", name, "--from", "0,0,0", "--cache", &cache],
            &["route", name, "--from", "0,0,0", "--to", "1,1,0", "--cache", &cache],
            &["export", name, "-o", "p.ply"],
            &["export", name, "-o", "p.tif"],
            &["export", name, "-o", "p.dxf"],
            &["export", name, "-o", "p.glb"],
            &["extract", name, "-o", "x.slices", "--bounds", "0,0,0,1,1,1", "--force"],
            &["recover", name, "-o", "r.slices", "--force"],
        ];
        for arguments in commands {
            let mib = if arguments.contains(&"p.glb") { SURFACE_MIB } else { MEMORY_MIB + CACHE_MIB };
            let out = limited(at, mib, arguments);
            is_handled(arguments, &out);
        }
    }
    assert!(count > 20, "{count} archives");
}
