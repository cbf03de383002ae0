//! The program `sliceconv` from a user's view: exit codes, streams, one-line errors, names.

use crate::scans;

use scans::{command, converts, names, points, refuses, sliceconv, verifies, write};
use slicewalk::archive::Archive;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use tempfile::TempDir;

fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("scan.las"), &points(3000));
    write(&folder.path().join("scan.laz"), &points(3000));
    folder
}

const OPTIONS: [&str; 8] = ["-o", "a.slices", "--pixel", "0.1", "--units", "m", "--threads", "2"];

fn with(inputs: &[&'static str], more: &[&'static str]) -> Vec<&'static str> {
    [inputs, &OPTIONS, more].concat()
}

#[test]
fn json_on_standard_output_is_one_document_with_the_keys_of_the_contract() {
    let folder = folder();
    let out = sliceconv(folder.path(), &with(&["scan.las"], &["--json"]));
    assert!(out.status.success() && out.stderr.is_empty(), "{}", String::from_utf8_lossy(&out.stderr));
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(facts["points_read"], 3000);
    assert_eq!(facts["points_kept"], 3000);
    assert_eq!(facts["pixel_size"], 0.1);
    assert_eq!(facts["slice_height"], 0.3);
    assert_eq!(facts["max_slope"], 45.0);
    assert_eq!(facts["tolerance"], 0.0);
    assert_eq!(facts["format_version"], "1.0");
    assert_eq!(facts["origin"].as_array().unwrap().len(), 3);
    for corner in ["min", "max"] {
        assert_eq!(facts["bounds"][corner].as_array().unwrap().len(), 3);
    }
    let numbers = [
        &["slices"][..],
        &["tiles", "occupied"],
        &["tiles", "stored"],
        &["tiles", "unique"],
        &["voxels", "occupied"],
        &["voxels", "obstacle"],
        &["bytes", "file"],
        &["bytes", "tiles"],
        &["bytes", "directory"],
    ];
    for path in numbers {
        let value = path.iter().fold(&facts, |value, key| &value[key]);
        assert!(value.as_u64().is_some_and(|value| value > 0), "{path:?}: {value}");
    }
    assert!(facts.as_object().unwrap().contains_key("crs"));
    assert_eq!(facts["bytes"]["file"], fs::metadata(folder.path().join("a.slices")).unwrap().len());
    verifies(&folder.path().join("a.slices"));
}

#[test]
fn levels_are_made_on_demand_and_a_plan_decides_for_its_parts() {
    let folder = folder();
    let at = folder.path();
    let made = |more: &[&'static str]| {
        let out = sliceconv(at, &with(&["scan.las"], more));
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let header = slicewalk::archive::Archive::open(at.join("a.slices")).unwrap().header().clone();
        (header.version, header.bytes.levels > 0)
    };
    assert_eq!(made(&[]), ((1, 0), false));
    assert_eq!(made(&["--levels", "on", "--force"]), ((1, 0), true));
    let plan = ["scan.las", "--write-plan", "p.json", "--pixel", "0.1", "--units", "m", "--levels", "on"];
    assert!(sliceconv(at, &plan).status.success());
    assert_eq!(made(&["--plan", "p.json", "--shard", "1/1", "--force"]), ((1, 0), true));
    let out = sliceconv(at, &with(&["scan.las"], &["--plan", "p.json", "--levels", "off", "--force"]));
    assert_eq!(out.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&out.stderr).contains("--levels: contradicts the plan"));
}

#[test]
fn what_was_done_goes_to_standard_error_without_any_progress_in_a_pipe_and_quiet_is_quiet() {
    let folder = folder();
    let out = sliceconv(folder.path(), &with(&["scan.laz"], &[]));
    assert!(out.status.success() && out.stdout.is_empty());
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(said.contains("a.slices: 3,000 points → "), "{said}");
    assert!(!said.contains(['\r', '\u{1b}', '█']), "{said:?}");
    let out = sliceconv(folder.path(), &with(&["scan.laz"], &["--force", "--quiet"]));
    assert!(out.status.success() && out.stdout.is_empty() && out.stderr.is_empty());
    // Without --units, a missing unit is a warning, unless quiet.
    let said = converts(folder.path(), &["scan.las", "-o", "b.slices", "--pixel", "0.1"]);
    assert!(said.contains("sliceconv: warning: scan.las: no unit of length"), "{said}");
    let said = converts(folder.path(), &["scan.las", "-o", "b.slices", "--pixel", "0.1", "--force", "--quiet"]);
    assert_eq!(said, "");
}

#[test]
fn unusable_inputs_are_named_in_one_line_that_says_the_way_out() {
    let folder = folder();
    let at = folder.path();
    fs::create_dir(at.join("empty")).unwrap();
    fs::write(at.join("notes.txt"), "these are notes, and long enough to be a header if they were one".repeat(9))
        .unwrap();
    fs::write(at.join("house.obj"), "v 0 0 0\n").unwrap();
    fs::write(at.join("far.xyz"), "1e13 0 0\n2e13 0 0\n3e13 1 1\n").unwrap();
    fs::write(at.join("beyond.xyz"), "9e11 0 0\n9e11 1 0\n9e11 1 1\n").unwrap();
    fs::write(at.join("nothing.las"), "").unwrap();
    let las = fs::read(at.join("scan.las")).unwrap();
    fs::write(at.join("head.las"), &las[..100]).unwrap();
    let laz = fs::read(at.join("scan.laz")).unwrap();
    fs::write(at.join("cut.las"), &las[..230]).unwrap();
    let mut scale = las.clone();
    scale[131..139].copy_from_slice(&f64::MAX.to_le_bytes());
    fs::write(at.join("scale.las"), scale).unwrap();
    let mut broken = laz.clone();
    let len = broken.len();
    broken[len / 3..len / 3 + 200].fill(0xA5);
    fs::write(at.join("broken.laz"), broken).unwrap();
    for (input, words) in [
        ("no.las", &["no.las", "cannot open", "check the name"][..]),
        ("scan.lsa", &["scan.lsa", "cannot open"]),
        ("empty", &["empty", "no scan lies in it"]),
        ("*.e57", &["*.e57", "matches no"]),
        ("notes.txt", &["notes.txt", "columns named x, y and z", "--columns"]),
        ("house.obj", &["house.obj", "triangles"]),
        ("far.xyz", &["far.xyz", "3 points have a coordinate that is not finite or beyond 1e12 m; fetch or write"]),
        ("beyond.xyz", &["coordinates that a grid of this pixel size reaches", "give a larger --pixel"]),
        ("nothing.las", &["nothing.las"]),
        ("head.las", &["head.las"]),
        ("cut.las", &["cut.las", "3000 points, but none can be read", "fetch or write"]),
        ("scale.las", &["scale.las", "scale or offset in the header"]),
        ("broken.laz", &["broken.laz", "damaged", "fetch or write the file again"]),
    ] {
        let said = refuses(at, &with(&[input], &[]), 1);
        assert!(words.iter().all(|word| said.contains(word)) && !said.contains("panicked"), "{input}: {said}");
    }
    assert!(names(at).iter().all(|name| !name.contains("slices")), "{:?}", names(at));
}

#[test]
fn bounds_in_the_header_that_are_not_those_of_the_points_give_one_warning() {
    let folder = folder();
    let at = folder.path();
    for name in ["wide.las", "narrow.las"] {
        let mut las = fs::read(at.join("scan.las")).unwrap();
        // Largest x, at byte 179 of the header.
        las[179..187].copy_from_slice(&(if name == "wide.las" { 1e9f64 } else { 1.0 }).to_le_bytes());
        fs::write(at.join(name), las).unwrap();
    }
    let about = |said: &str| {
        said.lines().filter(|line| line.contains("the bounds in the header")).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(about(&converts(at, &with(&["scan.las", "scan.laz"], &[]))), [""; 0]);
    for inputs in [&["wide.las"][..], &["narrow.las"], &["narrow.las", "wide.las", "scan.las"]] {
        let lines = about(&converts(at, &with(inputs, &["--force"])));
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert!(lines[0].contains(inputs[0]), "{lines:?}");
        assert_eq!(lines[0].contains("and 1 more"), inputs.len() > 1, "{lines:?}");
    }
}

#[test]
fn an_archive_is_only_replaced_when_asked_and_nothing_else_ever() {
    let folder = folder();
    let at = folder.path();
    converts(at, &with(&["scan.las"], &[]));
    let before = fs::read(at.join("a.slices")).unwrap();
    let said = refuses(at, &with(&["scan.las"], &["--max-slope", "30"]), 1);
    assert!(said.contains("a.slices") && said.contains("--force"), "{said}");
    assert_eq!(fs::read(at.join("a.slices")).unwrap(), before);
    converts(at, &with(&["scan.las"], &["--max-slope", "30", "--force"]));
    assert_ne!(fs::read(at.join("a.slices")).unwrap(), before);
    fs::create_dir(at.join("d.slices")).unwrap();
    let said = refuses(at, &["scan.las", "-o", "d.slices", "--pixel", "1", "--force"], 1);
    assert!(said.contains("d.slices") && said.contains("choose another name"), "{said}");
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let folder = folder();
    let at = folder.path();
    fs::write(at.join("file"), "").unwrap();
    for output in ["no/such/a.slices", "file/a.slices"] {
        let said = refuses(at, &["scan.las", "-o", output, "--pixel", "0.1"], 1);
        assert!(said.contains(output.strip_suffix("/a.slices").unwrap()), "{said}");
    }
    let said = refuses(at, &with(&["scan.las"], &["--temp-dir", "no/such"]), 1);
    assert!(said.contains("no/such"), "{said}");
    assert_eq!(names(at), ["file", "scan.las", "scan.laz"]);
}

#[test]
fn wrong_usage_ends_with_2_and_says_what_was_expected() {
    let folder = folder();
    let at = folder.path();
    for (arguments, word) in [
        (&["-o", "a.slices"][..], "INPUT"),
        (&["scan.las"], "--output"),
        (&["scan.las", "-o", "a.slices", "--pixel", "0"], "above 0"),
        (&["scan.las", "-o", "a.slices", "--pixel", "-1"], "--pixel"),
        (&["scan.las", "-o", "a.slices", "--pixel", "nan"], "above 0"),
        (&["scan.las", "-o", "a.slices", "--pixel", "wide"], "above 0"),
        (&["scan.las", "-o", "a.slices", "--pixel", "1e-12"], "--pixel: "),
        (&["scan.las", "-o", "a.slices", "--pixel", "1e7"], "--pixel: "),
        (&["scan.las", "-o", "a.slices", "--slice", "0"], "above 0"),
        (&["scan.las", "-o", "a.slices", "--pixel", "1", "--slice", "1e7"], "--slice: "),
        (&["scan.las", "-o", "a.slices", "--memory", "lots"], "expected B, KiB"),
        (&["scan.las", "-o", "a.slices", "--memory", "5parsecs"], "unknown unit"),
        (&["scan.las", "-o", "a.slices", "--memory", "63MiB"], "64MiB"),
        (&["scan.las", "-o", "a.slices", "--memory", "0"], "64MiB"),
        (&["scan.las", "-o", "a.slices", "--units", "furlong"], "us-ft"),
        (&["scan.las", "-o", "a.slices", "--units", "-1"], "--units"),
        (&["scan.las", "-o", "a.slices", "--threads", "0"], "--threads"),
        (&["scan.las", "-o", "a.slices", "--threads", "two"], "--threads"),
        (&["scan.las", "-o", "a.slices", "--max-slope", "91"], "--max-slope"),
        (&["scan.las", "-o", "a.slices", "--tolerance", "-0.1"], "--tolerance"),
        (&["scan.las", "-o", "a.slices", "--classifier", "guess"], "thesis"),
        (&["scan.las", "-o", "a.slices", "--exclude-class", "256"], "--exclude-class"),
        (&["scan.las", "-o", "a.slices", "--exclude-class", "64-7"], "such as 7,18,64-255"),
        (&["scan.las", "-o", "a.slices", "--min-points", "x"], "a whole number from 1 to "),
        (&["scan.las", "-o", "a.slices", "--max-slope", "steep"], "expected a number"),
        (&["scan.las", "-o", "a.slices", "--pixel", "1", "--slice", "1e300"], "--slice: 1e300 m"),
        (&["-", "-o", "a.slices"], "standard input"),
        (&["scan.las", "-o", "a.slices", "--min-points", "0"], "--min-points"),
        (&["scan.las", "-o", "a.slices", "--up", "w"], "--up"),
        (&["scan.las", "-o", "a.slices", "--no-such"], "--no-such"),
    ] {
        let said = refuses(at, arguments, 2);
        assert!(said.contains(word), "{arguments:?}: {said}");
    }
    assert_eq!(names(at), ["scan.las", "scan.laz"]);
    for arguments in [["--help"], ["--version"]] {
        let out = sliceconv(at, &arguments);
        assert!(out.status.success() && !out.stdout.is_empty() && out.stderr.is_empty());
    }
}

#[test]
fn several_files_folders_and_patterns_with_spaces_and_foreign_letters_are_one_scan() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let tiles = at.join("Größe und Höhe 測量");
    fs::create_dir(&tiles).unwrap();
    let all = points(3000);
    for (number, part) in all.chunks(1000).enumerate() {
        write(&tiles.join(format!("tile {number}.{}", ["las", "LAZ", "laz"][number])), part);
    }
    write(&at.join("all.las"), &all);
    let output = "Archiv für 測量.slices";
    let run = |inputs: &[&str]| {
        converts(at, &[inputs, &["-o", output, "--pixel", "0.1", "--units", "m", "--force"]].concat());
        verifies(&at.join(output));
        fs::read(at.join(output)).unwrap()
    };
    let one = run(&["all.las"]);
    assert!(run(&["Größe und Höhe 測量"]) == one);
    assert!(run(&["Größe*/tile ?.[lL][aA]*"]) == one);
    assert!(run(&["Größe und Höhe 測量/tile 2.laz", "Größe*/tile [01].*"]) == one);
}

#[test]
fn nobody_reading_the_output_is_no_failure_and_no_panic() {
    let folder = folder();
    // The reader leaves before the program writes, which an error reports instead of a signal.
    for (number, arguments) in [with(&["scan.las"], &["--json"]), with(&["scan.las"], &["--force"])].iter().enumerate()
    {
        let mut child =
            command(folder.path()).args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop((child.stdout.take(), child.stderr.take()));
        assert_eq!(child.wait().unwrap().code(), Some(0), "run {number}");
        verifies(&folder.path().join("a.slices"));
    }
    assert_eq!(names(folder.path()), ["a.slices", "scan.las", "scan.laz"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_result_that_cannot_be_written_is_a_failure_of_one_line() {
    let folder = folder();
    let dry = ["scan.las", "--dry-run", "--json", "--units", "m", "--pixel", "0.1"];
    for arguments in
        [&dry[..], &["--man"], &["--completions", "bash"], &with(&["scan.las"], &["--json", "--quiet"])[..]]
    {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let out = command(folder.path()).args(arguments).stdout(full).stderr(Stdio::piped()).output().unwrap();
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!((out.status.code(), said.lines().count()), (Some(1), 1), "{arguments:?}: {said}");
        assert!(said.contains("cannot write to standard output"), "{said}");
    }
}

#[test]
fn a_scan_without_points_is_an_empty_archive_and_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let mut las = Vec::new();
    write(&folder.path().join("one.las"), &[[1.0, 2.0, 3.0]]);
    las.extend(fs::read(folder.path().join("one.las")).unwrap());
    let points_at = u32::from_le_bytes(las[96..100].try_into().unwrap()) as usize;
    las.truncate(points_at);
    las[107..111].fill(0);
    let file = folder.path().join("none.las");
    fs::write(&file, las).unwrap();
    let said = converts(folder.path(), &with(&["none.las"], &[]));
    assert!(said.contains("the archive is empty"), "{said}");
    verifies(&folder.path().join("a.slices"));
    let said = refuses(folder.path(), &["none.las", "-o", "b.slices"], 1);
    assert!(said.contains("--pixel"), "{said}");
    assert!(!Path::new(&folder.path().join("b.slices")).exists());
}

#[test]
fn a_dry_run_says_what_would_be_read_and_writes_nothing() {
    let folder = folder();
    let at = folder.path();
    let before = names(at);
    let out = sliceconv(at, &["scan.las", "scan.laz", "--dry-run", "--units", "m", "--pixel", "0.1", "-o", "a.slices"]);
    assert!(out.status.success() && out.stderr.is_empty(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = String::from_utf8(out.stdout).unwrap();
    for words in [
        "2 files",
        "scan.las: 3,000 points",
        "6,000 stated",
        "1500 × 2020 × 500 m",
        "not stated",
        "pixels of 0.1 m",
        "slices of 0.3 m",
        "576 MiB",
        "nothing expected on disk",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    // Without an output, and with the pixel size that a conversion would choose.
    let out = sliceconv(at, &["scan.las", "--dry-run", "--json", "--units", "m"]);
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!(out.status.success() && facts["dry_run"] == true, "{facts}");
    assert_eq!((&facts["points_stated"], &facts["inputs"][0]["points_stated"]), (&3000.into(), &3000.into()));
    assert_eq!(facts["unit"], serde_json::json!({ "name": "m", "factor": 1.0 }));
    assert!(facts["crs"].is_null() && facts["temp_bytes"] == 0 && facts["memory_bytes"] == 512 << 20, "{facts}");
    assert!(facts["extent"].as_array().unwrap().iter().all(|edge| edge.as_f64() > Some(100.0)), "{facts}");
    assert_eq!(names(at), before);
    converts(at, &["scan.las", "-o", "auto.slices", "--units", "m"]);
    let archive = Archive::open(at.join("auto.slices")).unwrap();
    assert_eq!(facts["pixel_size"].as_f64(), Some(archive.frame().pixel_m()));
    // Fails if the conversion would.
    let onto = ["scan.las", "--dry-run", "-o", "auto.slices", "--pixel", "0.1"];
    assert!(refuses(at, &onto, 1).contains("--force"));
    assert!(refuses(at, &["scan.las", "--dry-run", "-o", "scan.las", "--force"], 1).contains("scan.las"));
    assert!(refuses(at, &["none.las", "--dry-run"], 1).contains("none.las"));
    let said = refuses(at, &["scan.las", "--dry-run", "--temp-dir", "no/such"], 1);
    assert!(said.contains("no/such: no such folder"), "{said}");
    refuses(at, &["scan.las", "--dry-run", "--write-plan", "p.json"], 2);
}

#[test]
fn classes_are_left_out_by_number_and_by_range() {
    let folder = folder();
    let at = folder.path();
    let out = sliceconv(at, &with(&["scan.las"], &["--json", "--exclude-class", "7,18,64-255"]));
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let classes: Vec<u64> = facts["excluded_classes"].as_array().unwrap().iter().flat_map(|c| c.as_u64()).collect();
    assert_eq!(classes, [7, 18].into_iter().chain(64..=255).collect::<Vec<_>>());
    assert!(facts["points_kept"] == 3000 && facts["empty"] == false, "{facts}");
}

#[test]
fn an_archive_of_points_that_are_all_left_out_is_no_silent_success() {
    let folder = folder();
    let at = folder.path();
    for (option, words) in [
        (["--min-points", "1000000"], "voxels have too few points"),
        (["--exclude-class", "0-255"], "all 3,000 points are left out (3,000 by class"),
    ] {
        let out = sliceconv(at, &with(&["scan.las"], &["--json", "--force", option[0], option[1]]));
        let said = String::from_utf8(out.stderr).unwrap();
        let warnings: Vec<_> = said.lines().filter(|line| line.contains("warning: nothing is kept: ")).collect();
        assert!(out.status.success() && warnings.len() == 1 && warnings[0].contains(words), "{said}");
        let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        assert_eq!(facts["empty"], true);
    }
}

#[test]
fn a_plan_takes_its_own_inputs_alone_and_names_what_differs() {
    let folder = folder();
    let at = folder.path();
    write(&at.join("other.las"), &points(2000));
    converts(at, &["scan.las", "--units", "m", "--pixel", "0.1", "--write-plan", "plan.json"]);
    converts(at, &["scan.las", "--plan", "plan.json", "-o", "planned.slices"]);
    converts(at, &with(&["scan.las"], &[]));
    assert!(fs::read(at.join("planned.slices")).unwrap() == fs::read(at.join("a.slices")).unwrap());
    for more in [&[][..], &["--dry-run"], &["--shard", "1/2"]] {
        let with_plan = |inputs: &[&'static str]| [inputs, &["--plan", "plan.json", "-o", "b.slices"], more].concat();
        let said = refuses(at, &with_plan(&["other.las"]), 1);
        assert!(said.contains("other.las") && said.contains("not among the files of the plan"), "{said}");
        let said = refuses(at, &with_plan(&["scan.las", "other.las"]), 1);
        assert!(said.contains("other.las"), "{said}");
    }
    assert!(!at.join("b.slices").exists());
}

#[test]
fn the_summary_is_written_for_people() {
    let folder = folder();
    let said = converts(folder.path(), &with(&["scan.las"], &["--exclude-class", "7"]));
    let lines: Vec<&str> = said.lines().collect();
    assert!(lines[0].starts_with("a.slices: 3,000 points → ") && lines[0].contains(" obstacles), "), "{said}");
    assert!(lines[0].ends_with(" slices of 0.3 m, 1500 × 2020 × 500 m"), "{said}");
    let last = lines[lines.len() - 1];
    assert!(last.contains(" kB → ") && last.contains(" %), ") && last.ends_with(" M points/s"), "{said}");
}

#[test]
fn archives_and_plans_do_not_go_to_standard_output() {
    let folder = folder();
    let at = folder.path();
    let said = refuses(at, &["scan.las", "-o", "-", "--pixel", "0.1"], 1);
    assert!(said.contains("-: a slice archive is not written to standard output; name a file"), "{said}");
    assert!(refuses(at, &["scan.las", "--write-plan", "-", "--pixel", "0.1"], 1).contains("standard output"));
}

#[cfg(unix)]
#[test]
fn no_name_of_a_file_reaches_the_terminal_with_control_characters() {
    let folder = folder();
    let at = folder.path();
    let name = "bad\u{1b}]0;owned\u{7}\n.las";
    fs::copy(at.join("scan.las"), at.join(name)).unwrap();
    for arguments in [&[name, "-o", "b.slices", "--pixel", "0.1"][..], &[name, "--dry-run", "--pixel", "0.1"]] {
        for json in [&[][..], &["--json"]] {
            let out = sliceconv(at, &[arguments, json, &["--force"]].concat());
            assert!(out.status.success());
            for text in [out.stdout, out.stderr].map(|bytes| String::from_utf8(bytes).unwrap()) {
                assert!(!text.contains(|c: char| c.is_control() && c != '\n'), "{text:?}");
                assert!(!text.contains("owned") || text.contains("bad\\u001b]0;owned\\u0007"), "{text:?}");
            }
        }
    }
    let said = refuses(at, &["no\u{1b}[31m.las", "-o", "c.slices"], 1);
    assert!(said.contains("no\\u001b[31m.las"), "{said:?}");
}

#[test]
fn completions_and_the_manual_come_from_the_program() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let out = sliceconv(folder.path(), &["--completions", shell]);
        let text = String::from_utf8(out.stdout).unwrap();
        assert!(out.status.success() && text.contains("exclude-class") && text.contains("sliceconv"), "{shell}");
    }
    let out = sliceconv(folder.path(), &["--man"]);
    let text = String::from_utf8(out.stdout).unwrap();
    assert!(out.status.success() && text.contains(".TH sliceconv 1") && text.contains("exclude\\-class"), "{text}");
    assert_eq!(sliceconv(folder.path(), &["--completions", "cmd"]).status.code(), Some(2));
}
