//! The program: exit codes, streams, one-line errors.

use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

fn scangen(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_scangen")).current_dir(folder).args(args).output().unwrap()
}

fn fails(folder: &Path, args: &[&str], code: i32) -> String {
    let out = scangen(folder, args);
    let text = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(code), "{args:?}: {text}");
    assert!(out.stdout.is_empty());
    text
}

#[test]
fn list_names_every_scene_on_standard_output() {
    let out = scangen(&std::env::temp_dir(), &["list"]);
    let text = String::from_utf8(out.stdout).unwrap();
    assert!(out.status.success());
    for scene in scangen::SCENES {
        assert!(text.contains(&format!("\n{} ", scene.name)) || text.starts_with(scene.name), "{}", scene.name);
    }
}

#[test]
fn the_same_command_gives_the_same_files_and_another_seed_others() {
    let folder = TempDir::new().unwrap();
    let run = |name: &str, seed: &str| {
        let args = ["stairs", "-o", name, "--seed", seed, "--points", "5000", "--noise", "0.002", "--shuffle"];
        let more = ["--origin", "500000,-5000000,0", "--rotate", "-30", "--param", "riser=0.2", "--truth", "t.json"];
        let out = scangen(folder.path(), &[args.as_slice(), &more].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        std::fs::read(folder.path().join(name)).unwrap()
    };
    assert_eq!(run("a.laz", "1"), run("b.laz", "1"));
    assert_ne!(run("a.laz", "1"), run("a.laz", "2"));
    let truth = std::fs::read_to_string(folder.path().join("t.json")).unwrap();
    assert!(truth.contains("\"scene\":\"stairs\""));
    // Only the outputs stay behind.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
}

#[test]
fn splats_are_as_large_by_density_as_by_count() {
    let folder = TempDir::new().unwrap();
    // The plane has 400 m².
    let run = |name: &str, amount: [&str; 2]| {
        let out = scangen(folder.path(), &[&["plane", "-o", name], &amount[..]].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        std::fs::read(folder.path().join(name)).unwrap()
    };
    assert!(run("a.ply", ["--density", "50"]) == run("b.ply", ["--points", "20000"]));
}

#[test]
fn usage_errors_end_with_2_and_failures_with_1_and_say_why_in_one_line() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    fails(at, &[], 2);
    fails(at, &["plane"], 2);
    fails(at, &["plane", "-o", "a.las", "--origin", "1,2"], 2);
    fails(at, &["plane", "-o", "a.las", "--points", "5", "--density", "5"], 2);
    for [option, value] in [["--origin", "nan,0,0"], ["--translate", "1e300,0,0"], ["--rotate", "inf"]] {
        let text = fails(at, &["house", "-o", "a.las", "--points", "5", option, value], 2);
        assert!(text.contains(option) && text.contains("expected a number"), "{text}");
    }
    let line = |args: &[&str], code| {
        let text = fails(at, args, code);
        assert_eq!(text.lines().count(), 1, "{text}");
        text
    };
    assert!(line(&["hose", "-o", "a.las"], 2).starts_with("scangen: SCENE: \"hose\" is not one of plane"));
    assert!(line(&["plane", "-o", "a.las", "--param", "slope=91"], 2).contains("slope: 91 lies outside 0 to 90"));
    assert!(line(&["plane", "-o", "a.las", "--outliers", "2"], 2).contains("outlier rate: 2 lies outside 0 to 1"));
    assert!(line(&["plane", "-o", "no/such/a.las"], 1).starts_with("scangen: no/such/a.las: cannot create: "));
    assert!(line(&["plane", "-o", "a.las", "--format", "11"], 1).contains("point format 11 is not one of 0 to 10"));
    let far = line(&["plane", "-o", "a.las", "--translate", "9e6,0,0"], 1);
    assert!(far.contains("does not fit 32-bit coordinates"));
}
