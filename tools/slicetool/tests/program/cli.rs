//! The program `slicetool` from a user's view: exit codes, streams, one-line errors, tables, pictures, exports.

use scangen::{WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk::archive::{ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::plan::Plan;
use slicewalk_base::text::grouped;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

/// A floor of 4 × 4 m at z = 0.35 with a wall 2 m high along x = 3, sampled every 5 cm.
fn points() -> Vec<[f64; 3]> {
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let floor = (0..80).flat_map(|i| (0..80).map(move |j| [step(i), step(j), 0.35]));
    let wall = (0..80).flat_map(|j| (0..40).map(move |k| [3.025, step(j), 0.35 + step(k)]));
    floor.chain(wall).collect()
}

/// Writes an archive `name` of `points` to `folder`.
fn archive(folder: &Path, name: &str, points: &[[f64; 3]], pixel_m: f64) {
    let scan = folder.join("scan.las");
    write_las(&scan, points.iter().copied(), &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan.clone()], folder.join(name));
    options.grid.pixel = PixelSize::Metres(pixel_m);
    convert(&options, &NoMonitor).unwrap();
    fs::remove_file(scan).unwrap();
}

fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    archive(folder.path(), "a.slices", &points(), 0.1);
    folder
}

fn slicetool(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_slicetool")).current_dir(folder).args(arguments).output().unwrap()
}

/// Checks that the command succeeds without standard error; returns its result.
fn done(folder: &Path, arguments: &[&str]) -> String {
    let out = slicetool(folder, arguments);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success() && said.is_empty(), "{arguments:?}: {said}");
    String::from_utf8(out.stdout).unwrap()
}

/// Checks that the command fails without a result and with one line, which is returned.
fn refuses(folder: &Path, arguments: &[&str]) -> String {
    let out = slicetool(folder, arguments);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(1), "{arguments:?}: {said}");
    // The answers before the refused row have been written already.
    assert!(out.stdout.is_empty() || arguments[0] == "query", "{arguments:?}");
    assert!(said.lines().count() == 1 && said.starts_with("slicetool: "), "{arguments:?}: {said}");
    said
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

#[test]
fn info_verify_and_stats_say_the_same_as_json_and_as_text() {
    let folder = folder();
    let at = folder.path();
    let info = json(&done(at, &["info", "a.slices", "--json"]));
    let points = points().len();
    assert_eq!((&info["points_read"], &info["points_kept"]), (&points.into(), &points.into()));
    assert!((info["bounds"]["min"][2].as_f64().unwrap() - 0.35).abs() < 1e-12);
    assert_eq!(info["input_quantum"], 0.0);
    assert_eq!(info["slices"], 7, "from 0.35 to 2.325 m in slices of 0.3 m");
    let text = done(at, &["info", "a.slices"]);
    assert!(text.contains(&format!("  points   {} read, all kept\n", grouped(points as u64))), "{text}");
    let verified = json(&done(at, &["verify", "a.slices", "--json"]));
    assert_eq!(verified["ok"], true);
    assert_eq!(verified["bytes"], info["bytes"]["file"]);
    assert!(done(at, &["verify", "a.slices"]).starts_with("a.slices: ok, "));
    let stats = json(&done(at, &["stats", "a.slices", "--json"]));
    assert_eq!(stats["voxels"]["occupied"], info["voxels"]["occupied"]);
    assert_eq!(stats["bytes"]["file"], info["bytes"]["file"]);
    assert_eq!(stats["bytes"]["levels"], info["bytes"]["levels"]);
    let (levels, pages) = (stats["levels"].as_array().unwrap(), |level: &serde_json::Value| level["pages"].as_u64());
    assert!(levels.windows(2).all(|pair| pages(&pair[0]) >= pages(&pair[1])), "{levels:?}");
    assert!(levels.first().is_none_or(|first| first["pixel_size"] == 0.4), "{levels:?}");
    assert!(done(at, &["stats", "a.slices"]).contains("voxels"));
}

#[test]
fn an_archive_that_is_none_or_damaged_is_named_by_every_command() {
    let folder = folder();
    let at = folder.path();
    let whole = fs::read(at.join("a.slices")).unwrap();
    fs::write(at.join("text.slices"), "no archive at all ".repeat(100)).unwrap();
    fs::write(at.join("empty.slices"), "").unwrap();
    fs::write(at.join("cut.slices"), &whole[..whole.len() / 2]).unwrap();
    // Damage a byte of a page: the archive opens, and reading the page fails.
    let mut page = whole.clone();
    let first_page = whole.windows(4).position(|bytes| bytes == b"\x89PAG").unwrap();
    page[first_page + 40] ^= 1;
    fs::write(at.join("page.slices"), page).unwrap();
    fs::write(at.join("q.csv"), "0,0,0,4,4,4\n").unwrap();
    for name in ["none.slices", "text.slices", "empty.slices", "cut.slices", "page.slices", "."] {
        for command in [
            &["stats", name][..],
            &["show", name, "--slice", "1", "-o", "out.png"],
            &["diff", name, "a.slices"],
            &["diff", "a.slices", name],
            &["replace", "a.slices", "--with", name, "-o", "out.slices", "--bounds", "0,0,0,9,9,9"],
            &["replace", name, "--with", "a.slices", "-o", "out.slices", "--bounds", "0,0,0,1,1,1"],
            &["export", name, "-o", "out.ply"],
            &["export", name, "-o", "out.las"],
            &["query", name, "--boxes", "q.csv"],
            &["info", name],
        ] {
            if name == "page.slices" && command[0] == "info" {
                continue;
            }
            let said = refuses(at, command);
            assert!(said.contains(name), "{command:?}: {said}");
            assert!(
                ["out.png", "out.ply", "out.las", "out.slices"].iter().all(|output| !at.join(output).exists()),
                "{command:?}"
            );
        }
    }
    for name in ["text.slices", "empty.slices", "cut.slices", "page.slices"] {
        let out = slicetool(at, &["verify", name]);
        let listed = String::from_utf8(out.stdout).unwrap();
        assert_eq!(out.status.code(), Some(1), "{name}: {listed}");
        assert!(listed.starts_with(&format!("{name}: rule ")), "{listed}");
        let out = slicetool(at, &["verify", name, "--json"]);
        let facts = json(&String::from_utf8(out.stdout).unwrap());
        assert!(out.status.code() == Some(1) && facts["ok"] == false, "{facts}");
        assert!(!facts["findings"].as_array().unwrap().is_empty());
    }
    assert!(refuses(at, &["verify", "none.slices"]).contains("none.slices"));
}

#[test]
fn boxes_come_back_as_they_were_with_the_answers_behind() {
    let folder = folder();
    let at = folder.path();
    let ask = |table: &str| {
        fs::write(at.join("q.csv"), table).unwrap();
        done(at, &["query", "a.slices", "--boxes", "q.csv"])
    };
    let floor = "1,1,0.3,1.5,1.5,1.0";
    let plain = ask(&format!("xmin,ymin,zmin,xmax,ymax,zmax\n{floor}\n1,1,1,1.5,1.5,2\n2.9,1,1,3.1,1.5,2\n"));
    let lines: Vec<&str> = plain.lines().collect();
    assert_eq!(lines[0], "xmin,ymin,zmin,xmax,ymax,zmax,hit,obstacle,floor_z");
    assert!(lines[1].starts_with(&format!("{floor},1,0,0.35")), "{plain}");
    assert!(lines[2].starts_with("1,1,1,1.5,1.5,2,0,0,0.35"), "{plain}");
    assert!(lines[3].starts_with("2.9,1,1,3.1,1.5,2,1,1,"), "{plain}");
    assert_eq!(lines.len(), 4);
    // Other columns, another order, blanks, quotes, a byte order mark and Windows line ends are all kept.
    let answer = lines[1].strip_prefix(floor).unwrap();
    let head = "name, zmax,\"xmin\",ymin,zmin,xmax,ymax";
    let row = "\"a, b\" , 1.0,1e0,+1,0.30,1.50,1.5";
    let expected = format!("{head},hit,obstacle,floor_z\n{row}{answer}\n");
    assert_eq!(ask(&format!("\u{feff}{head}\r\n{row}\r\n\r\n# remark\r\n")), expected);
    // Without a header, the columns have the documented order.
    assert_eq!(ask(floor), format!("xmin,ymin,zmin,xmax,ymax,zmax,hit,obstacle,floor_z\n{floor}{answer}\n"));
    assert_eq!(ask("xmin,ymin,zmin,xmax,ymax,zmax\n").lines().count(), 1);
}

#[test]
fn rays_come_back_with_distance_and_normal() {
    let folder = folder();
    let at = folder.path();
    fs::write(at.join("r.csv"), "x,y,z,dx,dy,dz,max\n1,1,3,0,0,-1,10\n1,1,3,0,0,1,10\n1,2,1,2,0,0,5\n").unwrap();
    let text = done(at, &["query", "a.slices", "--rays", "r.csv"]);
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "x,y,z,dx,dy,dz,max,hit,distance,nx,ny,nz");
    let number = |line: &str, field: usize| line.split(',').nth(field).unwrap().parse::<f64>().unwrap();
    assert_eq!([7, 9, 10, 11].map(|field| number(lines[1], field)), [1.0, 0.0, 0.0, 1.0], "{text}");
    assert!((number(lines[1], 8) - 2.65).abs() < 0.01, "{text}");
    assert_eq!(lines[2], "1,1,3,0,0,1,10,0,,,,");
    assert_eq!([7, 9, 10, 11].map(|field| number(lines[3], field)), [1.0, -1.0, 0.0, 0.0], "{text}");
    assert!((number(lines[3], 8) - 2.0).abs() < 1e-9, "the wall's pixels begin at x = 3: {text}");
}

#[cfg(unix)]
#[test]
fn answers_leave_while_the_table_is_still_being_written() {
    use std::io::{BufRead, BufReader, Write};
    let folder = folder();
    let mut child = Command::new(env!("CARGO_BIN_EXE_slicetool"))
        .current_dir(folder.path())
        .args(["query", "a.slices", "--boxes", "/dev/stdin"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let (mut table, mut answers) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
    // A program that answers only at the end of the table would hang here.
    let mut next = || {
        let mut line = String::new();
        answers.read_line(&mut line).unwrap();
        line
    };
    table.write_all(b"1,1,0.3,1.5,1.5,1.0\n").unwrap();
    assert_eq!(next(), "xmin,ymin,zmin,xmax,ymax,zmax,hit,obstacle,floor_z\n");
    assert!(next().starts_with("1,1,0.3,1.5,1.5,1.0,1,0,0.35"));
    table.write_all(b"1,1,1,1.5,1.5,2\n").unwrap();
    assert!(next().starts_with("1,1,1,1.5,1.5,2,0,0,0.35"));
    table.write_all(b"1,1,1,1.5,1.5,none\n").unwrap();
    drop(table);
    assert_eq!(child.wait().unwrap().code(), Some(1));
}

#[test]
fn a_cache_too_small_for_one_question_says_how_much_is_enough() {
    let folder = folder();
    let at = folder.path();
    fs::write(at.join("q.csv"), "-9,-9,-9,9,9,9\n").unwrap();
    let ask = |cache: &str| slicetool(at, &["query", "a.slices", "--boxes", "q.csv", "--cache", cache]);
    let said = refuses(at, &["query", "a.slices", "--boxes", "q.csv", "--cache", "60KiB"]);
    assert!(said.contains("line 1: this question needs"), "{said}");
    let enough = said.split("give --cache ").nth(1).and_then(|rest| rest.split(' ').next()).expect(&said);
    assert_eq!(ask(enough).stdout, ask("1GiB").stdout);
    assert!(ask(enough).status.success());
    let said = refuses(at, &["query", "a.slices", "--boxes", "q.csv", "--cache", "100"]);
    assert!(said.contains("100 bytes are too few: the table of"), "{said}");
}

#[test]
fn tables_that_cannot_be_answered_are_named_with_the_line() {
    let folder = folder();
    let at = folder.path();
    let head = "xmin,ymin,zmin,xmax,ymax,zmax\n";
    for (table, words) in [
        (String::new(), &["q.csv", "empty", "xmin,ymin,zmin,xmax,ymax,zmax"][..]),
        ("\n# only a remark\n".into(), &["empty"]),
        ("xmin,ymin,zmin,xmax,ymax\n1,1,1,2,2\n".into(), &["line 1", "no column zmax"]),
        ("1,2,3\n".into(), &["line 1", "3 fields and no header"]),
        ("1,1,1,2,2,two\n".into(), &["line 1", "zmax is \"two\""]),
        (format!("{head}1,1,1,2,2,2\n1,1,x,2,2,2\n"), &["line 3", "zmin is \"x\""]),
        (format!("{head}1,1,1,2,2\n"), &["line 2", "5 fields"]),
        (format!("{head}1,1,1,2,2,\n"), &["line 2", "zmax is \"\""]),
        (format!("{head}1,1,1,2,2,NaN\n"), &["line 2", "NaN"]),
        (format!("{head}1,1,1,0,2,2\n"), &["line 2", "q.csv"]),
        (format!("{head}\"1,1,1,2,2,2\n"), &["line 2", "quoted"]),
    ] {
        fs::write(at.join("q.csv"), &table).unwrap();
        let said = refuses(at, &["query", "a.slices", "--boxes", "q.csv"]);
        assert!(words.iter().all(|word| said.contains(word)), "{table:?}: {said}");
    }
    fs::write(at.join("q.csv"), [head.as_bytes(), b"1,1,1,2,2,\xFF\n"].concat()).unwrap();
    assert!(refuses(at, &["query", "a.slices", "--boxes", "q.csv"]).contains("line 2"));
    assert!(refuses(at, &["query", "a.slices", "--boxes", "none.csv"]).contains("none.csv: cannot read"));
    fs::write(at.join("r.csv"), "1,1,1,0,0,0,5\n").unwrap();
    assert!(refuses(at, &["query", "a.slices", "--rays", "r.csv"]).contains("line 1"));
}

/// Width and pixels of a picture.
fn picture(path: &Path) -> (usize, Vec<[u8; 3]>) {
    let mut reader = png::Decoder::new(std::io::BufReader::new(fs::File::open(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    (info.width as usize, bytes[..info.buffer_size()].as_chunks::<3>().0.to_vec())
}

#[test]
fn show_draws_the_thesis_colours_and_counts_slices_from_the_lowest() {
    let folder = folder();
    let at = folder.path();
    let said = done(at, &["show", "a.slices", "--slice", "0", "-o", "0.png"]);
    assert_eq!(said, "0.png: slice 0 of 7, z from 0.3 to 0.6 m, 40 × 40 pixels of 0.1 m\n");
    let (width, pixels) = picture(&at.join("0.png"));
    assert_eq!((width, pixels.len()), (40, 40 * 40));
    // The floor lies at 0.05 of a slice of 0.3 m: red ⌈255 / 6⌉ = 43, green 255, blue 26; the wall is blue 255.
    assert_eq!(pixels[20 * 40 + 10], [43, 255, 26]);
    assert_eq!(pixels[20 * 40 + 30][1..], [255, 255]);
    done(at, &["show", "a.slices", "--slice", "6", "-o", "6.png"]);
    let (_, pixels) = picture(&at.join("6.png"));
    assert_eq!(pixels.iter().filter(|&&pixel| pixel != [0, 0, 0]).count(), 40, "only the wall is as high as slice 6");
    done(at, &["show", "a.slices", "--z", "2.2", "-o", "z.png"]);
    assert_eq!(fs::read(at.join("6.png")).unwrap(), fs::read(at.join("z.png")).unwrap());
    assert_eq!(slicetool(at, &["show", "a.slices", "--z", "nan", "-o", "no.png"]).status.code(), Some(2));
    for which in [["--slice", "7"], ["--z", "-1"], ["--z", "1e300"], ["--slice", "18446744073709551615"]] {
        let said = refuses(at, &["show", "a.slices", which[0], which[1], "-o", "no.png"]);
        assert!(said.contains("--slice 0 to 6, --z 0.3 to 2.4\n"), "{said}");
    }
    assert!(refuses(at, &["show", "a.slices", "--slice", "0", "-o", "no/such.png"]).contains("no/such.png"));
    let said = refuses(at, &["show", "a.slices", "--slice", "0", "-o", "./a.slices"]);
    assert!(said.contains("this command reads"), "{said}");
    done(at, &["verify", "a.slices"]);
}

#[test]
fn show_draws_an_overview_level() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scan = at.join("scan.las");
    write_las(&scan, points(), &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], at.join("a.slices"));
    (options.grid.pixel, options.sections.levels) = (PixelSize::Metres(0.02), true);
    convert(&options, &NoMonitor).unwrap();
    let level = |number| ["show", "a.slices", "--z", "0.35", "--level", number, "-o", "level.png"];
    let said = done(at, &level("1"));
    assert_eq!(said, "level.png: slice 0 of 9, z from 0.24 to 0.48 m, 50 × 50 pixels of 0.08 m\n");
    let (_, pixels) = picture(&at.join("level.png"));
    assert_eq!(pixels[25 * 50 + 10][1..], [255, 26], "the floor");
    assert!(pixels.iter().any(|pixel| pixel[2] == 255), "the wall");
    assert!(refuses(at, &level("9")).contains("the archive has levels 1 to "));
}

#[test]
fn diff_tells_same_from_different_and_refuses_other_grids() {
    let folder = folder();
    let at = folder.path();
    let mut others = points();
    others.reverse();
    archive(at, "same.slices", &others, 0.1);
    let same = json(&done(at, &["diff", "a.slices", "same.slices", "--json"]));
    assert!(same["identical"] == true && same["same_plan"] == true, "{same}");
    others.push([1.0, 1.0, 1.75]);
    archive(at, "more.slices", &others, 0.1);
    let more = json(&done(at, &["diff", "a.slices", "more.slices", "--json"]));
    assert!(more["identical"] == false && more["voxels"]["only_b"] == 1 && more["voxels"]["only_a"] == 0, "{more}");
    assert!(done(at, &["diff", "a.slices", "same.slices"]).contains("identical"));
    assert!(done(at, &["diff", "a.slices", "more.slices"]).contains("1 only in B"));
    let voxels = |name: &str| json(&done(at, &["info", name, "--json"]))["voxels"]["occupied"].as_u64().unwrap();
    assert_eq!(more["voxels"]["in_both"].as_u64(), Some(voxels("a.slices")));
    // The slice's floor away from the walls, 2 cm higher, has other heights. A wall shifted by a pixel changes kinds,
    // too.
    let raised = points().into_iter().map(|[x, y, z]| [x, y, if x < 2.0 { z + 0.02 } else { z }]).collect::<Vec<_>>();
    archive(at, "raised.slices", &raised, 0.1);
    let facts = json(&done(at, &["diff", "a.slices", "raised.slices", "--json"]));
    assert_eq!(facts["voxels"]["other_height"], 20 * 40, "{facts}");
    for end in ["height", "bottom", "top"] {
        let difference = facts[format!("greatest_{end}_difference")].as_f64().unwrap();
        assert!((0.019..0.0215).contains(&difference), "{facts}");
    }
    assert!(facts["voxels"]["only_a"] == 0 && facts["voxels"]["other_kind"] == 0 && facts["same_bounds"] == true);
    archive(at, "floor.slices", &points()[..80 * 80], 0.1);
    let facts = json(&done(at, &["diff", "a.slices", "floor.slices", "--json"]));
    let voxels = &facts["voxels"];
    assert!(voxels["obstacle_only_a"].as_u64() >= Some(40) && voxels["obstacle_only_b"] == 0, "{facts}");
    assert!(voxels["only_a"].as_u64() >= Some(6 * 40) && voxels["only_b"] == 0, "{facts}");
    let back = json(&done(at, &["diff", "floor.slices", "a.slices", "--json"]));
    assert_eq!(back["voxels"]["obstacle_only_b"], voxels["obstacle_only_a"]);
    archive(at, "coarse.slices", &others, 0.2);
    let said = refuses(at, &["diff", "a.slices", "coarse.slices"]);
    assert!(said.contains("a.slices and coarse.slices lie on different grids"), "{said}");
}

#[test]
fn exports_hold_one_point_per_voxel() {
    let folder = folder();
    let at = folder.path();
    let info = json(&done(at, &["info", "a.slices", "--json"]));
    let voxels = info["voxels"]["occupied"].as_u64().unwrap();
    let obstacles = info["voxels"]["obstacle"].as_u64().unwrap();
    for name in ["out.las", "out.laz", "Ö ut.ply"] {
        assert_eq!(done(at, &["export", "a.slices", "-o", name]), format!("{name}: {} points\n", grouped(voxels)));
    }
    for name in ["out.las", "out.laz"] {
        let all = las::Reader::from_path(at.join(name)).unwrap().read_all().unwrap();
        assert_eq!(all.x().count() as u64, voxels);
        let class = |class: u8| all.classification().filter(|&found| found == class).count() as u64;
        assert_eq!((class(1), class(2)), (obstacles, voxels - obstacles));
        assert!(all.x().all(|x| (0.0..4.0).contains(&x)) && all.z().all(|z| (0.349..2.34).contains(&z)));
    }
    let ply = fs::read(at.join("Ö ut.ply")).unwrap();
    let end = ply.windows(11).position(|bytes| bytes == b"end_header\n").unwrap() + 11;
    assert_eq!((ply.len() - end) as u64, voxels * 27);
    assert!(String::from_utf8_lossy(&ply[..end]).contains(&format!("element vertex {voxels} ")));
    for (output, word) in [("out.xyz", ".ply, .las, .laz"), ("no/out.ply", "no/out.ply"), ("no/out.las", "no/out.las")]
    {
        let said = refuses(at, &["export", "a.slices", "-o", output]);
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn an_archive_without_points_is_no_trouble() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    archive(at, "e.slices", &[], 0.1);
    let info = json(&done(at, &["info", "e.slices", "--json"]));
    assert!(info["points_read"] == 0 && info["bounds"].is_null() && info["slices"] == 0, "{info}");
    done(at, &["verify", "e.slices"]);
    done(at, &["stats", "e.slices"]);
    assert!(done(at, &["diff", "e.slices", "e.slices"]).contains("identical"));
    assert!(done(at, &["export", "e.slices", "-o", "e.las"]).contains("0 points"));
    assert!(refuses(at, &["show", "e.slices", "--slice", "0", "-o", "e.png"]).contains("holds no points"));
    fs::write(at.join("q.csv"), "0,0,0,4,4,4\n").unwrap();
    assert!(done(at, &["query", "e.slices", "--boxes", "q.csv"]).ends_with("0,0,0,4,4,4,0,0,\n"));
}

/// Three parts of the floor and wall, seen from the middle of the grid.
fn parts(folder: &Path) -> Vec<String> {
    let scan = folder.join("scan.las");
    let centred = points().into_iter().map(|[x, y, z]| [x - 2.0, y - 2.0, z]);
    write_las(&scan, centred, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], folder.join("whole.slices"));
    options.grid.pixel = PixelSize::Metres(0.02);
    convert(&options, &NoMonitor).unwrap();
    let part = |index: u32| {
        let name = format!("{index}.slices");
        options.output = folder.join(&name);
        options.shard = Some(slicewalk_convert::ShardOptions { index, count: 3 });
        convert(&options, &NoMonitor).unwrap();
        name
    };
    (1..=3).map(part).collect()
}

#[test]
fn merge_joins_parts_and_names_what_does_not_belong() {
    let folder = folder();
    let at = folder.path();
    let parts = parts(at);
    let info = json(&done(at, &["info", "2.slices", "--json"]));
    assert!(info["shard"]["index"] == 2 && info["shard"]["count"] == 3, "{info}");
    assert!(json(&done(at, &["info", "whole.slices", "--json"])).get("shard").is_none());
    done(at, &["verify", "2.slices"]);
    let merge = |more: &[&'static str]| [&["merge", &parts[2], &parts[0], &parts[1], "-o", "m.slices"], more].concat();
    assert!(done(at, &merge(&[])).contains("m.slices: written, 3 parts"));
    assert!(fs::read(at.join("m.slices")).unwrap() == fs::read(at.join("whole.slices")).unwrap());
    let again = json(&done(at, &merge(&["--json"])));
    assert!(again["written"] == false && again["shards"] == 3 && again["points_read"] == points().len(), "{again}");
    assert!(done(at, &merge(&["2.slices"])).contains("2.slices: a copy of another part, left out"));
    fs::write(at.join("m.slices"), "mine").unwrap();
    for more in [&[][..], &["--force"]] {
        assert!(refuses(at, &merge(more)).contains("not a slice archive"));
        assert_eq!(fs::read(at.join("m.slices")).unwrap(), b"mine");
    }
    fs::copy(at.join("1.slices"), at.join("m.slices")).unwrap();
    assert!(refuses(at, &merge(&[])).contains("--force"));
    assert_eq!(fs::read(at.join("m.slices")).unwrap(), fs::read(at.join("1.slices")).unwrap());
    done(at, &merge(&["--force"]));
    assert!(refuses(at, &["merge", "1.slices", "3.slices", "-o", "n.slices"]).contains("missing of 3: 2"));
    assert!(refuses(at, &["merge", "1.slices", "a.slices", "-o", "n.slices"]).contains("a.slices"));
    let onto_itself = ["merge", &parts[2], &parts[0], &parts[1], "-o", "1.slices", "--force"];
    assert!(refuses(at, &onto_itself).contains("this command reads"));
    assert!(refuses(at, &["merge", "none.slices", "-o", "n.slices"]).contains("none.slices"));
    assert!(!at.join("n.slices").exists());
}

#[test]
fn an_export_of_gigabytes_from_a_thousand_bytes_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
    let mut writer = ArchiveWriter::create(&at.join("a.slices"), &plan, false).unwrap();
    let mut builder = PageBuilder::default();
    for pixel in 0..4096 {
        assert!(builder.set_column(pixel % 64, pixel / 64, &[Span::new(0, 16320, true).unwrap()]));
    }
    let (page, mut encoder) = (builder.build(), PageEncoder::new(plan.frame));
    for layer in 0..300 {
        let key = PageKey { tx: 0, ty: 0, layer };
        writer.put(key, encoder.encode(key, &page)).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
    let said = refuses(at, &["export", "a.slices", "-o", "a.ply"]);
    assert!(said.contains("a.slices: 78643200 voxels") && said.contains("extract"), "{said}");
    assert!(!at.join("a.ply").exists());
    done(at, &["extract", "a.slices", "-o", "b.slices", "--bounds", "0,0,0,1,1,1"]);
    assert!(done(at, &["export", "b.slices", "-o", "b.ply"]).contains("points"));
}

#[test]
fn recover_writes_what_is_left_and_says_what_is_not() {
    let folder = folder();
    let at = folder.path();
    parts(at);
    let whole = fs::read(at.join("whole.slices")).unwrap();
    let cut = |len: usize| fs::write(at.join("cut.slices"), &whole[..len]).unwrap();
    cut(whole.len() - 1);
    let text = done(at, &["recover", "cut.slices", "-o", "r.slices"]);
    assert!(text.contains("pages lost: none") && text.contains("complete"), "{text}");
    assert!(fs::read(at.join("r.slices")).unwrap() == whole);
    assert!(refuses(at, &["recover", "cut.slices", "-o", "r.slices"]).contains("--force"));
    let header = slicewalk::archive::Archive::open(at.join("whole.slices")).unwrap().header().clone();
    cut(header.levels_offset() as usize - 1);
    let facts = json(&done(at, &["recover", "cut.slices", "-o", "r.slices", "--force", "--json"]));
    assert!(facts["complete"] == false && facts["head"] == true, "{facts}");
    assert_eq!(facts["pages"]["lost"]["stored"], 1, "{facts}");
    assert!(done(at, &["verify", "r.slices"]).contains("ok"));
    // Without a head, recovered by a plan.
    fs::write(at.join("tail.slices"), &whole[40..]).unwrap();
    assert!(refuses(at, &["recover", "tail.slices", "-o", "t.slices"]).contains("--plan"));
    let mut options = ConvertOptions::new(vec![at.join("scan.las")], at.join("unused"));
    options.grid.pixel = PixelSize::Metres(0.02);
    let file = slicewalk_convert::PlanFile::new(&options, &NoMonitor).unwrap();
    file.write(&at.join("plan.json"), false).unwrap();
    let recover = ["recover", "tail.slices", "-o", "t.slices", "--plan", "plan.json"];
    assert!(done(at, &recover).contains("pages lost: unknown"));
    assert!(json(&done(at, &["diff", "whole.slices", "t.slices", "--json"]))["identical"] == true);
    done(at, &["show", "t.slices", "--slice", "0", "-o", "t.png"]);
    fs::write(at.join("text.slices"), "no archive at all ".repeat(100)).unwrap();
    let said = refuses(at, &["recover", "text.slices", "-o", "x.slices", "--plan", "plan.json"]);
    assert!(said.contains("text.slices") && !at.join("x.slices").exists(), "{said}");
}

#[test]
fn extract_cuts_a_region_that_answers_as_the_whole_does() {
    let folder = folder();
    let at = folder.path();
    let region = "--bounds=2.5,1,-1,9,3,1.2";
    done(at, &["extract", "a.slices", "-o", "x.slices", region]);
    done(at, &["verify", "x.slices"]);
    fs::write(at.join("q.csv"), "2.6,1.1,0.3,2.8,1.3,1\n2.9,1,0.8,3.1,1.5,1\n2.6,1.1,0.6,2.8,1.3,1\n").unwrap();
    let ask = |name: &str| done(at, &["query", name, "--boxes", "q.csv"]);
    assert_eq!(ask("x.slices"), ask("a.slices"));
    let facts = json(&done(at, &["info", "x.slices", "--json"]));
    assert!(
        facts["bounds"]["min"][0].as_f64() >= Some(2.3) && facts["bounds"]["max"][2].as_f64() < Some(1.9),
        "{facts}"
    );
    let difference = json(&done(at, &["diff", "a.slices", "x.slices", "--json"]));
    assert!(difference["voxels"]["only_a"].as_u64() > Some(0) && difference["voxels"]["only_b"] == 0, "{difference}");
    done(at, &["show", "x.slices", "--slice", "0", "-o", "x.png"]);
    done(at, &["extract", "a.slices", "-o", "all.slices", "--bounds=-inf,-inf,-inf,inf,inf,inf"]);
    assert!(fs::read(at.join("all.slices")).unwrap() == fs::read(at.join("a.slices")).unwrap());
    assert!(refuses(at, &["extract", "a.slices", "-o", "all.slices", region]).contains("--force"));
    assert!(refuses(at, &["extract", "a.slices", "-o", "a.slices", region, "--force"]).contains("this command reads"));
    for wrong in ["1,2,3", "1,2,3,4,5,x", "5,0,0,1,1,1", "nan,0,0,1,1,1"] {
        let wrong = format!("--bounds={wrong}");
        assert_eq!(slicetool(at, &["extract", "a.slices", "-o", "y.slices", &wrong]).status.code(), Some(2));
    }
}

#[test]
fn wrong_usage_ends_with_2() {
    let folder = folder();
    for arguments in [
        &[][..],
        &["look", "a.slices"],
        &["info"],
        &["show", "a.slices", "-o", "s.png"],
        &["show", "a.slices", "--slice", "0", "--z", "1", "-o", "s.png"],
        &["show", "a.slices", "--slice", "-1", "-o", "s.png"],
        &["query", "a.slices"],
        &["query", "a.slices", "--boxes", "q.csv", "--rays", "r.csv"],
        &["export", "a.slices"],
        &["diff", "a.slices"],
        &["merge", "a.slices"],
        &["merge", "-o", "m.slices"],
        &["recover", "a.slices"],
        &["extract", "a.slices", "-o", "x.slices"],
        &["replace", "a.slices", "-o", "x.slices", "--bounds", "0,0,0,1,1,1"],
        &["replace", "a.slices", "--with", "a.slices", "-o", "x.slices"],
        &["replace", "a.slices", "--with", "a.slices", "-o", "x.slices", "--bounds", "1,0,0,0,1,1"],
    ] {
        let out = slicetool(folder.path(), arguments);
        assert_eq!(out.status.code(), Some(2), "{arguments:?}");
        assert!(out.stdout.is_empty() && !out.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn a_pipe_closed_early_is_no_failure_and_no_panic() {
    let folder = folder();
    let at = folder.path();
    fs::write(at.join("q.csv"), "1,1,0.3,1.5,1.5,1.0\n".repeat(20_000)).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_slicetool"))
        .current_dir(at)
        .args(["query", "a.slices", "--boxes", "q.csv"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let out = child.wait_with_output().unwrap();
    assert!(out.status.success() && out.stderr.is_empty(), "{}", String::from_utf8_lossy(&out.stderr));
}
