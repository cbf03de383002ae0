//! Texts and pipes: output for people, `-` in place of files, names that must not reach the terminal raw, completions
//! and manual pages.

use scangen::{WriteSpec, write_las};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, ShardOptions, convert};
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

/// A floor of 6 × 4 m at z = 0.35 m that begins at x = −22.99 m.
fn points() -> impl Iterator<Item = [f64; 3]> {
    (0..121 * 81).map(|n| [f64::from(n % 121) * 0.05 - 22.99, f64::from(n / 121) * 0.05 + 0.025, 0.35])
}

fn options(folder: &Path, name: &str) -> ConvertOptions {
    let mut options = ConvertOptions::new(vec![folder.join("scan.laz")], folder.join(name));
    options.grid.pixel = PixelSize::Metres(0.1);
    options
}

/// A folder with a scan, its archive, and waypoints on it.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.laz");
    write_las(&scan, points(), &WriteSpec::for_path(&scan)).unwrap();
    convert(&options(folder.path(), "a.slices"), &NoMonitor).unwrap();
    fs::write(folder.path().join("w.csv"), "x,y\n-18,2\n").unwrap();
    folder
}

fn slicetool(folder: &Path, arguments: &[&str]) -> Output {
    fed(folder, arguments, "")
}

/// Runs the program with `input` on standard input.
fn fed(folder: &Path, arguments: &[&str], input: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_slicetool"))
        .current_dir(folder)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A program that reads no table closes the pipe.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    child.wait_with_output().unwrap()
}

fn text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap()
}

fn done(out: Output, what: &str) -> (String, String) {
    let (result, said) = (text(out.stdout), text(out.stderr));
    assert!(out.status.success(), "{what}: {said}");
    (result, said)
}

fn refused(out: Output, code: i32) -> String {
    let said = text(out.stderr);
    assert_eq!(out.status.code(), Some(code), "{said}");
    assert!(said.lines().count() == 1 && said.starts_with("slicetool: "), "{said}");
    said
}

#[test]
fn info_is_written_for_people_and_takes_several_archives() {
    let folder = folder();
    let at = folder.path();
    let one = text(slicetool(at, &["info", "a.slices"]).stdout);
    for words in [
        "a.slices: ",
        "  points   9,801 read, all kept\n",
        "  extent   6 × 4 × 0 m, from (-22.99, 0.025, 0.35) to (-16.99, 4.025, 0.35)\n",
        "  grid     pixels of 0.1 m, slices of 0.3 m, ",
        "  unit     metres in the source; ",
        "  crs      unknown\n",
    ] {
        assert!(one.contains(words), "{words}: {one}");
    }
    assert!(!one.contains(['{', '[', '"', '_']), "no fragments of JSON: {one}");
    fs::copy(at.join("a.slices"), at.join("b.slices")).unwrap();
    let both = text(slicetool(at, &["info", "a.slices", "b.slices"]).stdout);
    assert_eq!(both, format!("{one}\n{}", one.replace("a.slices", "b.slices")));
    let list: Value =
        serde_json::from_slice(&slicetool(at, &["info", "a.slices", "b.slices", "--json"]).stdout).unwrap();
    let mut alone: Value = serde_json::from_slice(&slicetool(at, &["info", "b.slices", "--json"]).stdout).unwrap();
    assert!(alone["empty"] == false && alone.get("archive").is_none(), "{alone}");
    alone["archive"] = "b.slices".into();
    assert_eq!(list[1], alone);
    // The readable archives are reported.
    let out = slicetool(at, &["info", "none.slices", "a.slices"]);
    assert_eq!((out.status.code(), text(out.stdout)), (Some(1), one));
    assert!(text(out.stderr).contains("none.slices: cannot open"));
}

#[test]
fn a_file_that_is_no_archive_is_called_what_it_is_with_what_to_do() {
    let folder = folder();
    let at = folder.path();
    fs::write(at.join("house.obj"), "v 0 0 0\n").unwrap();
    fs::write(at.join("plan.json"), "{ \"slicewalk_plan\": 2 }").unwrap();
    for (name, what) in [
        (
            "scan.laz",
            "a laser scan (LAZ 1.2, 9,801 points) and not a slice archive; convert it first: sliceconv scan.laz -o scan.slices",
        ),
        ("house.obj", "a mesh and not a slice archive; convert it first: sliceconv house.obj -o house.slices"),
        ("plan.json", "a plan and not a slice archive; "),
    ] {
        for command in [&["info", name][..], &["stats", name], &["export", name, "-o", "x.ply"]] {
            let said = refused(slicetool(at, command), 1);
            assert!(said.contains(&format!("{name}: it is {what}")), "{said}");
        }
    }
}

#[test]
fn tables_come_from_standard_input_and_results_go_to_standard_output() {
    let folder = folder();
    let at = folder.path();
    let (boxes, rays) = ("-20,1,0.3,-19,2,1\n", "-20,1,3,0,0,-1,10\n");
    for (option, table) in [("--boxes", boxes), ("--rays", rays)] {
        fs::write(at.join("t.csv"), table).unwrap();
        let by_name = done(slicetool(at, &["query", "a.slices", option, "t.csv"]), option);
        assert!(by_name.0.lines().count() == 2, "{}", by_name.0);
        assert_eq!(done(fed(at, &["query", "a.slices", option, "-"], table), option), by_name);
    }
    let said = refused(fed(at, &["query", "a.slices", "--boxes", "-"], "1,2,3\n"), 1);
    assert!(said.contains("standard input: line 1: 3 fields"), "{said}");
    let walk = ["walk", "a.slices", "--start", "-22,2,0.36"];
    let (path, _) = done(fed(at, &[&walk[..], &["--waypoints", "-", "-o", "-"]].concat(), "-18,2\n"), "walk");
    assert!(
        path.starts_with("t,x,y,z,state,frame_us,missing\n") && path.lines().last().unwrap().contains("arrived"),
        "{path}"
    );
    let ends = ["--from", "-22,2,0.36", "--to", "-18,2,0.36"];
    let (way, said) = done(slicetool(at, &[&["route", "a.slices", "-o", "-"], &ends[..]].concat()), "route");
    assert!(way.starts_with("x,y,z\n") && said.contains(" m over "), "{way}{said}");
    let (places, said) = done(slicetool(at, &["reach", "a.slices", "--from", "-22,2,0.36", "-o", "-"]), "reach");
    assert!(places.starts_with("x,y,z,clearance\n") && said.contains("slicetool: area "), "{said}");
    let out = slicetool(at, &["export", "a.slices", "-o", "-"]);
    done(slicetool(at, &["export", "a.slices", "-o", "a.ply"]), "export");
    assert!(out.status.success() && out.stdout == fs::read(at.join("a.ply")).unwrap());
    assert!(text(out.stderr).ends_with(" points\n"));
    let out = slicetool(at, &["show", "a.slices", "--slice", "0", "-o", "-"]);
    assert!(out.status.success() && out.stdout.starts_with(b"\x89PNG"));
    assert!(text(out.stderr).contains("slice 0 of 1, z from 0.3 to 0.6 m, 61 × 41 pixels of 0.1 m"));
    assert!(!at.join("-").exists());
}

#[test]
fn what_no_stream_can_be_is_refused_in_a_clear_line() {
    let folder = folder();
    let at = folder.path();
    let (recover, merge) = (["recover", "-", "-o", "r.slices"], ["merge", "a.slices", "-", "-o", "m.slices"]);
    for command in [&["info", "-"][..], &["verify", "-"], &["query", "-", "--boxes", "w.csv"], &recover, &merge] {
        assert!(refused(slicetool(at, command), 2).contains("not read from standard input; name a file"));
    }
    let said = refused(slicetool(at, &["extract", "a.slices", "-o", "-", "--bounds=-21,0,0,-20,1,1"]), 1);
    assert!(said.contains("-: a slice archive is not written to standard output; name a file"), "{said}");
    let walk = ["walk", "a.slices", "--start", "-22,2,0.36", "--waypoints", "w.csv", "-o", "-", "--json"];
    let route = ["route", "a.slices", "--from", "-22,2,0.36", "--to", "-18,2,0.36", "-o", "-", "--json"];
    for command in [&walk[..], &route, &["reach", "a.slices", "--from", "-22,2,0.36", "-o", "-", "--json"]] {
        assert!(refused(slicetool(at, command), 2).contains("both write to standard output"));
    }
}

#[test]
fn an_extract_of_nothing_is_a_warning_and_says_so_in_json() {
    let folder = folder();
    let at = folder.path();
    for json in [false, true] {
        let arguments = ["extract", "a.slices", "-o", "x.slices", "--force", "--bounds=0,0,0,1,1,1", "--json"];
        let (result, said) = done(slicetool(at, &arguments[..if json { 7 } else { 6 }]), "extract");
        assert!(said.starts_with("slicetool: warning: a.slices: nothing lies within --bounds"), "{said}");
        assert!(!json || serde_json::from_str::<Value>(&result).unwrap()["empty"] == true, "{result}");
    }
}

#[test]
fn many_missing_parts_are_named_in_one_short_line() {
    let folder = folder();
    let mut options = options(folder.path(), "1.slices");
    options.shard = Some(ShardOptions { index: 3, count: 60_000 });
    convert(&options, &NoMonitor).unwrap();
    let said = refused(slicetool(folder.path(), &["merge", "1.slices", "-o", "m.slices"]), 1);
    assert!(said.contains("missing of 60000: 1-2, 4-60000; ") && said.len() < 200, "{said}");
}

#[cfg(unix)]
#[test]
fn no_name_or_text_of_a_file_reaches_the_terminal_with_control_characters() {
    let folder = folder();
    let at = folder.path();
    let crs = "PROJCS[\"bad\u{1b}[31m\u{9b}crs\",UNIT[\"metre\",1]]";
    let spec = WriteSpec { crs_wkt: Some(crs.into()), ..WriteSpec::for_path(Path::new("x.las")) };
    write_las(&at.join("scan.laz"), points(), &spec).unwrap();
    let name = "bad\u{1b}[31m\n\u{202e}.slices";
    convert(&options(at, name), &NoMonitor).unwrap();
    fs::write(at.join("broken\u{1b}.slices"), "no archive").unwrap();
    for command in [
        &["info", name][..],
        &["info", name, "--json"],
        &["info", name, "none\u{1b}[1m", "--json"],
        &["verify", name],
        &["verify", "broken\u{1b}.slices"],
        &["verify", "broken\u{1b}.slices", "--json"],
        &["export", name, "-o", "out\u{1b}.ply"],
        &["show", name, "--slice", "0", "-o", "out\u{1b}.png"],
        &["extract", name, "-o", "cut\u{1b}.slices", "--bounds=0,0,0,1,1,1"],
        &["recover", name, "-o", "again\u{1b}.slices"],
        &["replace", name, "--with", name, "-o", "new\u{1b}.slices", "--bounds=0,0,0,1,1,1"],
    ] {
        let out = slicetool(at, command);
        for text in [text(out.stdout), text(out.stderr)] {
            assert!(!text.contains(|c: char| c.is_control() && c != '\n' || c == '\u{202e}'), "{command:?}: {text:?}");
            assert!(!text.contains("bad\\u001b[31m\n"), "{command:?}: {text:?}");
        }
    }
    let facts: Value = serde_json::from_slice(&slicetool(at, &["info", name, "--json"]).stdout).unwrap();
    assert_eq!(facts["crs"], crs, "JSON keeps the text");
}

#[test]
fn a_legend_adds_a_strip_and_leaves_the_slice_as_it_is() {
    let folder = folder();
    let at = folder.path();
    let (plain, _) = done(slicetool(at, &["show", "a.slices", "--slice", "0", "-o", "s.png"]), "show");
    let (legend, _) = done(slicetool(at, &["show", "a.slices", "--slice", "0", "-o", "l.png", "--legend"]), "show");
    assert!(plain.contains("61 × 41 pixels") && legend.contains("400 × 95 pixels"), "{plain}{legend}");
    let picture = |name: &str| {
        let file = std::io::BufReader::new(fs::File::open(at.join(name)).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        bytes.as_chunks::<3>().0.chunks(info.width as usize).map(<[_]>::to_vec).collect::<Vec<_>>()
    };
    let (plain, legend) = (picture("s.png"), picture("l.png"));
    assert!(plain.iter().zip(&legend).all(|(plain, legend)| legend[..plain.len()] == plain[..]));
    // A bar of 10 m is 100 pixels of white; the ramps end at the top of the slice.
    let longest = |colour: [u8; 3]| {
        let rows = legend[plain.len()..].iter();
        rows.map(|row| row.iter().filter(|&&pixel| pixel == colour).count()).max().unwrap()
    };
    assert!(longest([255; 3]) >= 100, "{}", longest([255; 3]));
    assert_eq!([longest([255, 255, 26]), longest([0, 255, 255])], [1, 1]);
}

#[test]
fn completions_and_manual_pages_come_from_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let (completions, _) = done(slicetool(at, &["completions", shell]), shell);
        assert!(completions.contains("waypoints") && completions.contains("slicetool"), "{shell}");
    }
    let (said, _) = done(slicetool(at, &["man", "pages"]), "man");
    let mut names: Vec<_> =
        fs::read_dir(at.join("pages")).unwrap().map(|page| page.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert!(names.contains(&"slicetool.1".into()) && names.contains(&"slicetool-query.1".into()), "{names:?}");
    assert_eq!(said, format!("pages: {} manual pages\n", names.len()));
    let page = fs::read_to_string(at.join("pages/slicetool-query.1")).unwrap();
    assert!(page.contains(".TH slicetool-query 1") && page.contains("slicetool query"), "{page}");
    assert_eq!(slicetool(at, &["completions", "cmd"]).status.code(), Some(2));
}
