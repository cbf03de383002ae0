//! Outputs of `sliceconv` never destroy what they should not: inputs, other files, archives of other runs.

use crate::scans;

use scans::{command, converts, names, points, refuses, verifies, write};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use tempfile::TempDir;

const OPTIONS: [&str; 5] = ["--pixel", "0.1", "--units", "m", "--quiet"];

/// `inputs` and `output` with the usual options.
fn with<'a>(inputs: &[&'a str], output: &[&'a str]) -> Vec<&'a str> {
    [inputs, output, &OPTIONS].concat()
}

/// A folder with a scan.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("scan.las"), &points(3000));
    folder
}

/// Names and bytes of all files in `folder`.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    names(folder).into_iter().map(|name| (name.clone(), fs::read(folder.join(name)).unwrap())).collect()
}

#[test]
fn no_input_is_replaced_whatever_the_options() {
    let folder = folder();
    let at = folder.path();
    write(&at.join("scan.laz"), &points(500));
    fs::write(at.join("roof.obj"), "v 0 0 3\nv 1 0 3\nv 0 1 3\nf 1 2 3\n").unwrap();
    let triangle: Vec<u8> =
        [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].into_iter().flat_map(f32::to_le_bytes).collect();
    fs::write(at.join("wall.bin"), triangle).unwrap();
    let gltf = r#"{"asset": {"version": "2.0"}, "buffers": [{"uri": "wall.bin", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "nodes": [{"mesh": 0}]}"#;
    fs::write(at.join("wall.gltf"), gltf).unwrap();
    fs::hard_link(at.join("scan.las"), at.join("hard.slices")).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink("scan.las", at.join("soft.slices")).unwrap();
    converts(at, &["scan.las", "--write-plan", "plan.json", "--pixel", "0.1", "--units", "m", "--quiet"]);
    converts(at, &["wall.gltf", "-o", "wall.slices", "--pixel", "0.1", "--quiet"]);
    let before = contents(at);
    for (inputs, output) in [
        (&["scan.las"][..], "scan.las"),
        (&["scan.las"], "./scan.las"),
        (&["scan.las"], "hard.slices"),
        (&["scan.las"], "soft.slices"),
        (&["."], "scan.las"),
        (&["*.la?"], "scan.laz"),
        (&["scan.laz", "roof.obj"], "roof.obj"),
        (&["wall.gltf"], "wall.gltf"),
        (&["wall.gltf"], "wall.bin"),
        (&["scan.las", "--plan", "plan.json"], "plan.json"),
        (&["scan.las", "--plan", "plan.json", "--shard", "1/2"], "plan.json"),
    ] {
        if !at.join(output).exists() {
            continue;
        }
        for more in [&["-o", output][..], &["-o", output, "--force"]] {
            let said = refuses(at, &with(inputs, more), 1);
            assert!(said.contains("choose another") && !said.contains("--force"), "{inputs:?} {more:?}: {said}");
        }
        if !inputs.contains(&"--plan") {
            for more in [&["--write-plan", output][..], &["--write-plan", output, "--force"]] {
                let said = refuses(at, &with(inputs, more), 1);
                assert!(said.contains("choose another") && !said.contains("--force"), "{inputs:?} {more:?}: {said}");
            }
        }
        assert!(contents(at) == before, "{inputs:?} {output}");
    }
}

#[test]
fn force_replaces_archives_by_archives_and_plans_by_plans_alone() {
    let folder = folder();
    let at = folder.path();
    converts(at, &with(&["scan.las"], &["-o", "a.slices"]));
    converts(at, &with(&["scan.las"], &["--write-plan", "plan.json"]));
    fs::write(at.join("picture.png"), "a picture").unwrap();
    fs::write(at.join("empty"), "").unwrap();
    let before = contents(at);
    for (option, kept, replaced) in [("-o", "plan.json", "a.slices"), ("--write-plan", "a.slices", "plan.json")] {
        for name in [kept, "picture.png"] {
            for force in [&[][..], &["--force"]] {
                let said = refuses(at, &with(&["scan.las"], &[&[option, name], force].concat()), 1);
                assert!(said.contains(name) && said.contains("choose another name"), "{said}");
            }
        }
        for name in [replaced, "empty"] {
            assert!(refuses(at, &with(&["scan.las"], &[option, name]), 1).contains("--force replaces it"));
        }
        assert!(contents(at) == before);
        converts(at, &[&with(&["scan.las"], &[option, replaced, "--force"])[..], &["--max-slope", "30"]].concat());
        assert!(contents(at)[replaced] != before[replaced]);
        converts(at, &with(&["scan.las"], &[option, replaced, "--force"]));
        assert!(contents(at) == before);
        converts(at, &with(&["scan.las"], &[option, "empty", "--force"]));
        assert!(contents(at)["empty"] == before[replaced]);
        fs::write(at.join("empty"), "").unwrap();
    }
}

#[test]
fn an_archive_that_appears_meanwhile_stays_and_the_new_one_is_kept_beside_it() {
    let folder = folder();
    let at = folder.path();
    write(&at.join("large.las"), &points(400_000));
    // Before the other begins, because that one may finish soon.
    converts(at, &with(&["scan.las"], &["-o", "b.slices"]));
    let mut conversion = command(at);
    conversion.args(["large.las", "-o", "a.slices", "--pixel", "0.02", "--units", "m", "--quiet"]);
    let child = conversion.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    while !names(at).iter().any(|name| name.ends_with(".part")) {
        std::thread::yield_now();
    }
    fs::rename(at.join("b.slices"), at.join("a.slices")).unwrap();
    let appeared = fs::read(at.join("a.slices")).unwrap();
    let out = child.wait_with_output().unwrap();
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!((out.status.code(), said.lines().count()), (Some(1), 1), "{said}");
    assert!(fs::read(at.join("a.slices")).unwrap() == appeared);
    let kept =
        names(at).into_iter().find(|name| name.starts_with("a.slicewalk-") && name.ends_with(".slices")).unwrap();
    assert!(said.contains("another file got this name") && said.contains(&kept), "{said}");
    converts(at, &["large.las", "-o", "c.slices", "--pixel", "0.02", "--units", "m", "--quiet"]);
    assert!(fs::read(at.join(&kept)).unwrap() == fs::read(at.join("c.slices")).unwrap());
    assert_eq!(names(at), ["a.slices", &*kept, "c.slices", "large.las", "scan.las"]);
}

#[test]
fn of_many_runs_without_force_one_writes_the_archive_and_every_other_says_so() {
    let folder = folder();
    let at = folder.path();
    write(&at.join("other.las"), &points(2500));
    let run = |number: usize| {
        let scan = ["scan.las", "other.las"][number % 2];
        command(at).args(with(&[scan], &["-o", "a.slices"])).stderr(Stdio::piped()).spawn().unwrap()
    };
    for _ in 0..4 {
        let runs: Vec<_> = (0..6).map(run).collect();
        let done: Vec<_> = runs.into_iter().map(|run| run.wait_with_output().unwrap()).collect();
        assert_eq!(done.iter().filter(|out| out.status.code() == Some(0)).count(), 1);
        verifies(&at.join("a.slices"));
        let mut kept = 0;
        for out in done.iter().filter(|out| out.status.code() != Some(0)) {
            let said = String::from_utf8_lossy(&out.stderr);
            assert!(out.status.code() == Some(1) && said.lines().count() == 1, "{said}");
            let was_late = said.contains("another file got this name");
            assert!(was_late || said.contains("exists already"), "{said}");
            kept += usize::from(was_late);
        }
        let archives: Vec<_> = names(at).into_iter().filter(|name| name.ends_with(".slices")).collect();
        assert_eq!((archives.len(), names(at).len()), (1 + kept, 3 + kept), "{:?}", names(at));
        archives.iter().for_each(|name| fs::remove_file(at.join(name)).unwrap());
    }
}

#[test]
fn a_plan_that_cannot_be_written_is_refused_before_the_work_and_a_killed_one_leaves_what_the_next_run_cleans() {
    let folder = folder();
    let at = folder.path();
    write(&at.join("large.las"), &points(1_000_000));
    let planning = || {
        let mut planning = command(at);
        planning.args(["large.las", "--write-plan", "plan.json", "--units", "m", "--quiet"]);
        planning.stderr(Stdio::piped()).spawn().unwrap()
    };
    let parts = || names(at).iter().filter(|name| name.ends_with(".part")).count();
    let mut child = planning();
    while parts() == 0 && child.try_wait().unwrap().is_none() {
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let named =
        |name: &String| name.starts_with(".plan.json.slicewalk-") || name.ends_with(".las") || name == "plan.json";
    assert!(names(at).iter().all(named), "{:?}", names(at));
    let _ = fs::remove_file(at.join("plan.json"));
    assert!(planning().wait().unwrap().success());
    assert_eq!(names(at), ["large.las", "plan.json", "scan.las"]);
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        fs::write(at.join("plain"), "").unwrap();
        let mode = |name: &str| fs::metadata(at.join(name)).unwrap().mode();
        assert_eq!(mode("plan.json"), mode("plain"));
    }
}

#[test]
fn removed_points_replace_no_text_that_the_command_reads_and_share_no_stream() {
    let folder = folder();
    let at = folder.path();
    let matrix = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    fs::write(at.join("m.txt"), matrix).unwrap();
    let removing = ["-o", "a.slices", "--remove-moving", "--stations", "s.csv"];
    let arguments = [&removing[..], &["--transform", "m.txt", "--removed", "m.txt"]].concat();
    let said = refuses(at, &with(&["scan.las"], &arguments), 1);
    assert!(said.contains("m.txt: is a file that this command reads"), "{said}");
    assert_eq!(fs::read_to_string(at.join("m.txt")).unwrap(), matrix);
    let arguments = [&removing[..], &["--removed", "-", "--json"]].concat();
    let said = refuses(at, &with(&["scan.las"], &arguments), 2);
    assert!(said.contains("--removed - and --json both write to standard output"), "{said}");
}

/// Runs the program under a tracer that makes a system call fail: `fault` is `call:error=E:when=N`. `None`, with a line
/// on standard error, without a tracer.
#[cfg(target_os = "linux")]
fn with_failing_call(folder: &Path, fault: &str, arguments: &[&str]) -> Option<std::process::Output> {
    let strace = || std::process::Command::new("strace");
    let tried = strace().args(["-o", "/dev/null", "true"]).stderr(Stdio::null()).status();
    if !tried.is_ok_and(|status| status.success()) {
        eprintln!("skipped: no strace that can trace here");
        return None;
    }
    let log = tempfile::NamedTempFile::new().unwrap();
    let (call, _) = fault.split_once(':').unwrap();
    let mut traced = strace();
    traced.args(["-f", "-qq", "-e", &format!("trace={call}"), "-e", &format!("inject={fault}"), "-o"]).arg(log.path());
    let out = traced.arg(env!("CARGO_BIN_EXE_sliceconv")).args(arguments).current_dir(folder).output().unwrap();
    let log = fs::read_to_string(log.path()).unwrap();
    assert!(log.contains("(INJECTED)"), "{fault} was not met: {log}");
    Some(out)
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_synced_is_said_of_an_archive_that_stands() {
    let folder = folder();
    let at = folder.path();
    converts(at, &with(&["scan.las"], &["-o", "good.slices"]));
    let arguments = with(&["scan.las"], &["-o", "a.slices"]);
    // The first sync is that of the file.
    let Some(out) = with_failing_call(at, "fsync:error=EIO:when=1", &arguments) else { return };
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(1) && said.contains("cannot sync") && !at.join("a.slices").exists(), "{said}");
    let Some(out) = with_failing_call(at, "fsync:error=EIO:when=2", &arguments) else { return };
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(1) && said.lines().count() == 1, "{said}");
    assert!(said.starts_with("sliceconv: a.slices: complete") && said.contains("folder could not be synced"), "{said}");
    assert!(fs::read(at.join("a.slices")).unwrap() == fs::read(at.join("good.slices")).unwrap());
    assert_eq!(names(at), ["a.slices", "good.slices", "scan.las"]);
}

#[cfg(target_os = "linux")]
#[test]
fn signals_that_interrupt_calls_and_renames_that_the_file_system_does_not_know_change_nothing() {
    let folder = folder();
    let at = folder.path();
    converts(at, &with(&["scan.las"], &["-o", "old.slices"]));
    for (fault, existed) in [
        ("flock:error=EINTR", false),
        ("getdents64:error=EINTR", false),
        ("renameat2:error=EINTR", false),
        ("renameat2:error=EINVAL", false),
        ("rename:error=EINTR", true),
    ] {
        fs::remove_file(at.join("a.slices")).unwrap_or_default();
        if existed {
            fs::copy(at.join("old.slices"), at.join("a.slices")).unwrap();
        }
        let arguments =
            with(&["scan.las"], &["-o", "a.slices", "--max-slope", "30", "--force"][..4 + usize::from(existed)]);
        let Some(out) = with_failing_call(at, &format!("{fault}:when=1"), &arguments) else { return };
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.success(), "{fault}: {said}");
        verifies(&at.join("a.slices"));
        assert!(fs::read(at.join("a.slices")).unwrap() != fs::read(at.join("old.slices")).unwrap());
        assert_eq!(names(at), ["a.slices", "old.slices", "scan.las"], "{fault}");
    }
}
