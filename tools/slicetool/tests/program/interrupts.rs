//! Signals end long work with their exit code and leave nothing behind.

use crate::scene::{converted, floor_wall_roof};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

fn names(folder: &Path) -> Vec<String> {
    fs::read_dir(folder).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn interrupted_exports_say_so_and_leave_nothing() {
    let folder = converted(floor_wall_roof(), 0.05, None);
    let at = folder.path();
    // Far more work than fits between the temporary file and the signal: billions of distances, a mesh of millions of edges.
    let fields = ["export", "a.slices", "-o", "a.npy", "--esdf", "--step", "0.003"];
    let collider = ["export", "a.slices", "-o", "a.glb", "--error", "0.007"];
    for (arguments, signal, code) in [(&fields[..], "INT", 130), (&collider, "INT", 130), (&collider, "TERM", 143)] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_slicetool"));
        command.current_dir(at).args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = command.spawn().unwrap();
        // It listens before it makes a temporary file.
        while !names(at).iter().any(|name| name.ends_with(".part")) {
            std::thread::yield_now();
        }
        let sent = Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let out = child.wait_with_output().unwrap();
        assert_eq!(out.status.code(), Some(code), "{arguments:?}");
        let said = String::from_utf8(out.stderr).unwrap();
        assert!(said == "slicetool: interrupted\n" && out.stdout.is_empty(), "{arguments:?}: {said}");
        assert_eq!(names(at), ["a.slices"], "{arguments:?}");
    }
}
