//! Outputs of `slicetool` never destroy what they should not: files that a command reads, archives, an older output.

use crate::forge;
#[cfg(unix)]
use crate::full;

#[cfg(unix)]
use full::{SmallDisk, with_little_space};
use scangen::{WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::plan::Plan;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

const SLICETOOL: &str = env!("CARGO_BIN_EXE_slicetool");

/// A folder with an archive of a rough floor of 4 × 4 m, waypoints on it, and a table of boxes.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.las");
    let points = (0..160 * 160).map(|n| {
        let (i, j) = (n % 160, n / 160);
        [f64::from(i) * 0.025, f64::from(j) * 0.025, 0.35 + 0.001 * f64::from(i * j % 7)]
    });
    write_las(&scan, points, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan.clone()], folder.path().join("a.slices"));
    options.grid.pixel = PixelSize::Metres(0.05);
    convert(&options, &NoMonitor).unwrap();
    fs::remove_file(scan).unwrap();
    fs::write(folder.path().join("w.csv"), "x,y\n3,3\n").unwrap();
    folder
}

fn slicetool(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(SLICETOOL).current_dir(folder).args(arguments).output().unwrap()
}

/// Checks that the command failed without a result and with one line, which is returned.
fn failed(out: &Output, what: &[&str]) -> String {
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(1), "{what:?}: {said}");
    assert!(out.stdout.is_empty(), "{what:?}");
    assert!(
        said.lines().count() == 1 && said.starts_with("slicetool: ") && !said.contains("panicked"),
        "{what:?}: {said}"
    );
    said
}

fn refuses(folder: &Path, arguments: &[&str]) -> String {
    failed(&slicetool(folder, arguments), arguments)
}

fn done(folder: &Path, arguments: &[&str]) {
    let out = slicetool(folder, arguments);
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
}

/// Every command that writes a picture, table or export of `archive` to `output`, whose extension is `ending`.
fn writers<'a>(archive: &'a str, output: &'a str) -> Vec<Vec<&'a str>> {
    let walk = ["walk", archive, "--start", "1,1,0.36", "--waypoints", "w.csv", "-o", output];
    vec![vec!["show", archive, "--slice", "0", "-o", output], walk.to_vec(), vec!["export", archive, "-o", output]]
}

/// Names and bytes of all files in `folder`.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.map(|name| (name.clone(), fs::read(folder.join(name)).unwrap())).collect()
}

#[test]
fn what_a_command_reads_is_not_replaced_under_any_name() {
    let folder = folder();
    let at = folder.path();
    fs::hard_link(at.join("a.slices"), at.join("hard.ply")).unwrap();
    fs::hard_link(at.join("w.csv"), at.join("hard.csv")).unwrap();
    let outputs = ["a.slices", "./a.slices", "hard.ply", "soft.las"];
    #[cfg(unix)]
    std::os::unix::fs::symlink("a.slices", at.join("soft.las")).unwrap();
    #[cfg(not(unix))]
    fs::hard_link(at.join("a.slices"), at.join("soft.las")).unwrap();
    fs::copy(at.join("a.slices"), at.join("b.slices")).unwrap();
    let before = contents(at);
    for output in outputs {
        for command in writers("a.slices", output) {
            if command[0] == "export" && output.ends_with("slices") {
                continue;
            }
            assert!(refuses(at, &command).contains("this command reads"), "{command:?}");
        }
        let bounds = "--bounds=0,0,0,1,1,1";
        for force in [&[][..], &["--force"]] {
            for command in [
                &["extract", "a.slices", bounds, "-o", output][..],
                &["recover", "a.slices", "-o", output],
                &["replace", "a.slices", "--with", "b.slices", bounds, "-o", output],
                &["replace", "b.slices", "--with", "a.slices", bounds, "-o", output],
            ] {
                assert!(refuses(at, &[command, force].concat()).contains("this command reads"), "{command:?}");
            }
        }
    }
    for output in ["w.csv", "hard.csv"] {
        let walk = ["walk", "a.slices", "--start", "1,1,0.36", "--waypoints", "w.csv", "-o", output];
        assert!(refuses(at, &walk).contains("this command reads"));
    }
    assert!(contents(at) == before);
}

#[test]
fn older_pictures_tables_and_exports_are_replaced_archives_and_plans_never() {
    let folder = folder();
    let at = folder.path();
    fs::copy(at.join("a.slices"), at.join("other.ply")).unwrap();
    fs::write(at.join("plan.ply"), "{ \"slicewalk_plan\": 1 }").unwrap();
    let before = contents(at);
    for output in ["other.ply", "plan.ply"] {
        for command in writers("a.slices", output) {
            assert!(refuses(at, &command).contains("never replaces"), "{command:?}");
        }
    }
    assert!(contents(at) == before);
    for ending in ["ply", "las", "laz"] {
        let output = format!("o.{ending}");
        for command in writers("a.slices", &output) {
            fs::write(at.join(&output), "an older output").unwrap();
            done(at, &command);
            assert!(fs::read(at.join(&output)).unwrap() != b"an older output", "{command:?}");
        }
        fs::remove_file(at.join(output)).unwrap();
    }
    assert!(contents(at) == before);
}

#[test]
fn a_failure_leaves_the_older_output_as_it_was_and_nothing_else() {
    let folder = folder();
    let at = folder.path();
    // Damage a byte of the last page, and one of the directory.
    let whole = fs::read(at.join("a.slices")).unwrap();
    let last_page = whole.windows(4).rposition(|bytes| bytes == b"\x89PAG").unwrap();
    let archive = Archive::open(at.join("a.slices")).unwrap();
    let directory = archive.header().metadata_offset() as usize - 10;
    for (name, place) in [("page.slices", last_page + 40), ("leaf.slices", directory)] {
        let mut bytes = whole.clone();
        bytes[place] ^= 1;
        fs::write(at.join(name), bytes).unwrap();
    }
    fs::write(at.join("none.csv"), "x,y\n1,oops\n").unwrap();
    for output in ["o.ply", "o.las", "o.laz", "o.png"] {
        for older in [None, Some("an older output")] {
            if let Some(older) = older {
                fs::write(at.join(output), older).unwrap();
            }
            let before = contents(at);
            let mut commands = [writers("page.slices", output), writers("leaf.slices", output)].concat();
            commands.extend(writers("none.slices", output));
            commands.push(vec!["show", "a.slices", "--slice", "99", "-o", output]);
            commands.push(vec!["walk", "a.slices", "--start", "1,1,1", "--waypoints", "none.csv", "-o", output]);
            for command in commands {
                refuses(at, &command);
                assert!(contents(at) == before, "{command:?}: {:?}", contents(at).keys());
            }
        }
    }
}

#[cfg(unix)]
#[test]
fn on_a_full_disk_the_older_output_stays() {
    let folder = folder();
    let at = folder.path();
    fs::create_dir(at.join("small")).unwrap();
    let disk = SmallDisk::mount(&at.join("small"), "4k");
    for name in ["o.ply", "o.las", "o.laz", "o.png"] {
        for command in writers("a.slices", name) {
            if command[0] != "export" && name != "o.png" || command[0] == "export" && name == "o.png" {
                continue;
            }
            for older in [None, Some("an older output")] {
                if let Some(older) = older {
                    fs::write(at.join(name), older).unwrap();
                }
                let before = fs::read(at.join(name)).ok();
                // All of these need more than two blocks; a LAS header alone needs more than one.
                let blocks = if command[0] == "show" { 0 } else { 2 };
                let said = failed(&with_little_space(SLICETOOL, at, blocks, &command), &command);
                assert!(said.contains(name) && said.contains("cannot write"), "{said}");
                assert_eq!(fs::read(at.join(name)).ok(), before);
                let names: Vec<_> = fs::read_dir(at).unwrap().map(|name| name.unwrap().file_name()).collect();
                assert!(names.iter().all(|name| !name.to_string_lossy().starts_with('.')), "{names:?}");
            }
            fs::remove_file(at.join(name)).unwrap();
            if disk.is_none() || command[0] == "show" {
                continue;
            }
            let output = format!("small/{name}");
            let mut command = command.clone();
            *command.last_mut().unwrap() = &output;
            fs::write(at.join(&output), "an older output").unwrap();
            let said = refuses(at, &command);
            assert!(said.contains("No space left"), "{said}");
            assert_eq!(contents(&at.join("small")), BTreeMap::from([(name.to_owned(), b"an older output".to_vec())]));
            fs::remove_file(at.join(output)).unwrap();
        }
    }
    drop(disk);
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_take_the_whole_output_and_stay() {
    use std::os::unix::fs::{FileTypeExt, symlink};
    let folder = folder();
    let at = folder.path();
    let made = Command::new("mkfifo").args(["pipe.ply", "pipe.las"]).current_dir(at).status();
    assert!(made.unwrap().success());
    for name in ["pipe.ply", "pipe.las"] {
        for command in writers("a.slices", name) {
            let whole = format!("whole.{}", &name[5..]);
            let mut to_file = command.clone();
            *to_file.last_mut().unwrap() = &whole;
            done(at, &to_file);
            let pipe = at.join(name);
            let reader = std::thread::spawn(move || fs::read(pipe).unwrap());
            done(at, &command);
            let (read, whole) = (reader.join().unwrap(), fs::read(at.join(whole)).unwrap());
            let lines = |bytes: &[u8]| bytes.iter().filter(|&&byte| byte == b'\n').count();
            // The table of a walk includes the time of each frame.
            assert!(lines(&read) == lines(&whole) && (command[0] == "walk" || read == whole), "{command:?}");
            assert!(fs::metadata(at.join(name)).unwrap().file_type().is_fifo());
        }
        assert!(refuses(at, &["recover", "a.slices", "-o", name, "--force"]).contains("not a regular file"));
    }
    for (device, works) in [("/dev/null", true), ("/dev/full", false)] {
        symlink(device, at.join("device.ply")).unwrap();
        for command in writers("a.slices", "device.ply") {
            if works {
                done(at, &command);
            } else {
                assert!(refuses(at, &command).contains("device.ply: cannot write"));
            }
        }
        assert!(fs::metadata(device).unwrap().file_type().is_char_device());
        fs::remove_file(at.join("device.ply")).unwrap();
    }
    // A file that the shell opened is written from its current position and not truncated.
    fs::write(at.join("log"), "before\n").unwrap();
    let walk = "walk a.slices --start 1,1,0.36 --waypoints w.csv -o /dev/stdout";
    let script = format!("\"$0\" {walk} >> log 2>/dev/null && echo after >> log");
    assert!(Command::new("sh").args(["-c", &script, SLICETOOL]).current_dir(at).status().unwrap().success());
    let log = fs::read_to_string(at.join("log")).unwrap();
    assert!(log.starts_with("before\nt,x,y,z,") && log.ends_with("\nafter\n"), "{log}");
    let onto_itself = format!("\"$0\" {walk} >> w.csv");
    assert!(
        !Command::new("sh").args(["-c", &onto_itself, SLICETOOL]).current_dir(at).output().unwrap().status.success()
    );
    assert_eq!(fs::read_to_string(at.join("w.csv")).unwrap(), "x,y\n3,3\n");
}

/// Writes an archive `name` of pages at `keys`, all with the same spans in pixel (3, 4).
fn archive_of(folder: &Path, name: &str, frame: Frame, keys: &[PageKey], spans: &[Span]) {
    let mut writer = ArchiveWriter::create(&folder.join(name), &Plan::new(frame), false).unwrap();
    let mut builder = PageBuilder::default();
    assert!(builder.set_column(3, 4, spans));
    let (page, mut encoder) = (builder.build(), PageEncoder::new(frame));
    for &key in keys {
        writer.put(key, encoder.encode(key, &page)).unwrap();
    }
    let corner = |key: &PageKey, off: f64, quantum: u32| {
        let place = [(key.tx, 3.0 + off), (key.ty, 4.0 + off)].map(|(tile, pixel)| f64::from(tile) * 64.0 + pixel);
        let z = f64::from(key.layer) * 64.0 * frame.slice_m() + f64::from(quantum) * frame.quantum_m();
        [place[0] * frame.pixel_m(), place[1] * frame.pixel_m(), z]
    };
    let (first, last) = (&spans[0], &spans[spans.len() - 1]);
    let bounds = Some((corner(&keys[0], 0.1, first.bottom()), corner(&keys[keys.len() - 1], 0.9, last.top())));
    let count = keys.len() as u64;
    writer.finish(Totals { points_read: count, points_kept: count, bounds, ..Totals::default() }).unwrap();
}

/// Replaces the bounds in the head of the archive `name`, with valid checksums.
fn lie_about_bounds(folder: &Path, name: &str, bounds: [f64; 2]) {
    let path = folder.join(name);
    let forged = forge::Parts::of(&fs::read(&path).unwrap()).build(|head| {
        for (corner, value) in bounds.into_iter().enumerate() {
            for axis in 0..3 {
                forge::put(head, 160 + 24 * corner + 8 * axis, value.to_bits(), 8);
            }
        }
    });
    fs::write(path, forged).unwrap();
}

#[test]
fn las_coordinates_follow_from_the_pages_and_not_from_the_head() {
    let folder = folder();
    let at = folder.path();
    let key = |tx, ty, layer| PageKey { tx, ty, layer };
    let far = (1 << 30) - 1;
    let fine = Frame::new(0.001, 0.003).unwrap();
    let usual = Frame::new(0.1, 0.3).unwrap();
    let near = [key(0, 0, 0), key(1, 0, 0)];
    let span = [Span::new(7, 9, false).unwrap()];
    let wide = [-1e300, 1e300];
    for (name, frame, bounds) in [("wide", usual, wide), ("narrow", usual, [0.0; 2]), ("fine", fine, wide)] {
        let archive = format!("{name}.slices");
        archive_of(at, &archive, frame, &near, &span);
        lie_about_bounds(at, &archive, bounds);
        for ending in ["las", "laz"] {
            let output = format!("{name}.{ending}");
            done(at, &["export", &archive, "-o", &output]);
            let mut reader = las::Reader::from_path(at.join(output)).unwrap();
            let points = reader.read_all().unwrap();
            for (((x, y), z), tile) in points.x().zip(points.y()).zip(points.z()).zip([0.0, 64.0]) {
                let expected = [tile + 3.5, 4.5].map(|pixel| pixel * frame.pixel_m());
                let off = [x - expected[0], y - expected[1], z - 8.5 * frame.quantum_m()];
                assert!(off.iter().all(|off| off.abs() < frame.quantum_m() / 2.0), "{name}: {off:?}");
            }
            assert_eq!(points.len(), 2);
        }
    }
    archive_of(at, "far.slices", usual, &[key(-far, -far, -far), key(far, far, far)], &span);
    lie_about_bounds(at, "far.slices", [0.0, 1.0]);
    for output in ["far.las", "far.laz"] {
        fs::write(at.join(output), "an older output").unwrap();
        let said = refuses(at, &["export", "far.slices", "-o", output]);
        assert!(said.contains("far.slices") && said.contains("export .ply"), "{said}");
        assert_eq!(fs::read(at.join(output)).unwrap(), b"an older output");
    }
    done(at, &["export", "far.slices", "-o", "far.ply"]);
}

#[test]
fn a_voxel_is_one_point_even_with_two_spans_in_it() {
    let folder = folder();
    let at = folder.path();
    let frame = Frame::new(0.1, 0.3).unwrap();
    let span = |bottom, top, obstacle| Span::new(bottom, top, obstacle).unwrap();
    // Three spans in slices 0 and 1, the middle one in both.
    let spans = [span(7, 9, false), span(30, 300, true), span(400, 410, false)];
    archive_of(at, "two.slices", frame, &[PageKey { tx: 0, ty: 0, layer: 0 }], &spans);
    done(at, &["export", "two.slices", "-o", "two.las"]);
    let points = las::Reader::from_path(at.join("two.las")).unwrap().read_all().unwrap();
    let voxels: Vec<_> =
        points.z().zip(points.classification()).map(|(z, class)| ((z / frame.quantum_m()).ceil(), class)).collect();
    assert_eq!(voxels, [(255.0, 1), (410.0, 1)]);
}

#[test]
fn the_demonstration_replaces_no_archive_of_another_scan() {
    let folder = folder();
    let at = folder.path();
    fs::copy(at.join("a.slices"), at.join("house.slices")).unwrap();
    let before = contents(at);
    assert!(refuses(at, &["demo", "-o", "."]).contains("house.slices"));
    assert!(contents(at) == before);
}

#[test]
fn the_demonstration_replaces_its_own_scan_alone() {
    let folder = folder();
    let at = folder.path();
    let scan = at.join("house.laz");
    write_las(&scan, [[1.0, 2.0, 3.0]], &WriteSpec::for_path(&scan)).unwrap();
    let mut bytes = fs::read(&scan).unwrap();
    bytes[58..90].fill(0);
    fs::write(&scan, bytes).unwrap();
    let before = contents(at);
    assert!(refuses(at, &["demo", "-o", "."]).contains("house.laz"));
    assert!(contents(at) == before);
}
