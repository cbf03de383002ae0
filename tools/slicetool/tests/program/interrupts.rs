//! Signals end long work with their exit code and leave nothing behind.

use crate::scene::{converted, floor_wall_roof};
use slicewalk::archive::{ArchiveWriter, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::plan::Plan;
use slicewalk::seen::{SeenBlock, SeenPage};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

fn names(folder: &Path) -> Vec<String> {
    fs::read_dir(folder).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
#[cfg(feature = "remote")]
fn a_signal_ends_the_wait_for_a_server() {
    let folder = converted(floor_wall_roof(), 0.05, None);
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let scan = format!("http://{}/a.xyz", silent.local_addr().unwrap());
    // It listens for signals before it asks the server.
    let mut command = Command::new(env!("CARGO_BIN_EXE_slicetool"));
    command.current_dir(folder.path()).args(["site", &scan, "-o", "site", "--page", "page"]);
    fs::create_dir(folder.path().join("page")).unwrap();
    fs::write(folder.path().join("page/index.html"), "page").unwrap();
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    let _client = silent.accept().unwrap();
    let sent = Command::new("kill").args(["-s", "INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    for _ in 0..200 {
        if child.try_wait().unwrap().is_some() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(100));
    }
    let _ = child.kill();
    let out = child.wait_with_output().unwrap();
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.code() == Some(130) && said == "slicetool: interrupted\n", "{:?} {said}", out.status);
    assert_eq!(names(folder.path()).len(), 2);
}

#[test]
fn an_interrupted_site_leaves_no_part_of_a_file() {
    let folder = converted(floor_wall_roof(), 0.05, None);
    let at = folder.path();
    fs::create_dir(at.join("page")).unwrap();
    fs::write(at.join("page/index.html"), "page").unwrap();
    // COPC by its head, and far more than can be copied before the signal. It takes no space.
    let mut head = vec![0; 589];
    head[..4].copy_from_slice(b"LASF");
    head[377..381].copy_from_slice(b"copc");
    fs::write(at.join("c.copc.laz"), head).unwrap();
    fs::File::options().write(true).open(at.join("c.copc.laz")).unwrap().set_len(64 << 30).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_slicetool"));
    command.current_dir(at).args(["site", "a.slices", "--cloud", "c.copc.laz", "--page", "page", "-o", "site"]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let is_copied = |name: &String| name.contains("c.copc") && name.ends_with(".part");
    while !at.join("site").is_dir() || !names(&at.join("site")).iter().any(is_copied) {
        std::thread::yield_now();
    }
    let sent = Command::new("kill").args(["-s", "INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let out = child.wait_with_output().unwrap();
    assert_eq!((out.status.code(), names(&at.join("site"))), (Some(130), vec!["a.slices".to_owned()]));
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

#[test]
fn a_signal_ends_a_tree_of_free_cubes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
    let mut writer = ArchiveWriter::create(&at.join("a.slices"), &plan, false).unwrap();
    writer.set_seen();
    let mut keys: Vec<_> = (0..100).map(|tx| PageKey { tx, ty: 0, layer: 0 }).collect();
    keys.sort_unstable();
    for key in keys {
        let mut block = SeenBlock::new(key);
        (0..64).for_each(|layer| block.push(layer, &SeenPage::ALL));
        writer.put_seen(&block).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_slicetool"));
    command.current_dir(at).args(["export", "a.slices", "-o", "a.bt"]).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    while !names(at).iter().any(|name| name.ends_with(".part")) {
        std::thread::yield_now();
    }
    let sent = Command::new("kill").args(["-s", "INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let out = child.wait_with_output().unwrap();
    assert_eq!((out.status.code(), names(at)), (Some(130), vec!["a.slices".to_owned()]));
}
