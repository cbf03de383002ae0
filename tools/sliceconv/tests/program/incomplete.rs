//! Input that can be read only in part is refused, and existing files stay; with `--allow-incomplete` the rest is
//! converted, and a warning names what is missing. Input that changes while it is read, and parts that read two
//! versions of an input, are detected.

use crate::scans;

use scangen::{Chunks, WriteSpec, write_las};
use scans::{command, converts, points, refuses, sliceconv, text, verifies, write};
use slicewalk::archive::{Archive, merge, merge_run};
use slicewalk::{Monitor, NoMonitor, Warning};
use slicewalk_convert::{ConvertOptions, PixelSize, PlanFile, ShardOptions, convert};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use tempfile::TempDir;

const OPTIONS: [&str; 6] = ["--pixel", "0.1", "--units", "m", "-o", "a.slices"];

/// A folder with a scan of 3,000 points and an archive of it.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("scan.las"), &points(3000));
    write(&folder.path().join("scan.laz"), &points(12_000));
    converts(folder.path(), &[&["scan.las"], &OPTIONS[..]].concat());
    folder
}

fn points_kept(folder: &Path) -> u64 {
    Archive::open(folder.join("a.slices")).unwrap().header().points_kept
}

/// Checks that `inputs` are refused with `words` and advice, and that the archive stays; with permission, `left` points
/// are converted, the same words are a warning, and `missing` points are counted as such.
fn is_incomplete(folder: &Path, inputs: &[&str], words: &str, left: u64, missing: u64) {
    let before = fs::read(folder.join("a.slices")).unwrap();
    for pixel in ["0.1", "auto"] {
        let options = ["--pixel", pixel, "--units", "m", "-o", "a.slices", "--force"];
        let said = refuses(folder, &[inputs, &options].concat(), 1);
        assert!(said.contains(words) && said.contains("--allow-incomplete"), "{inputs:?}: {said}");
        assert!(fs::read(folder.join("a.slices")).unwrap() == before, "{inputs:?}: the old archive is gone");
    }
    let allowed = [inputs, &OPTIONS, &["--force", "--allow-incomplete"]].concat();
    let said = converts(folder, &allowed);
    assert!(said.contains("warning: ") && said.contains("incomplete") && said.contains(words), "{inputs:?}: {said}");
    assert_eq!(points_kept(folder), left, "{inputs:?}: {said}");
    verifies(&folder.join("a.slices"));
    let out = sliceconv(folder, &[&allowed[..], &["--json"]].concat());
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((&facts["points_missing"], &facts["complete"]), (&missing.into(), &false.into()), "{inputs:?}");
    fs::write(folder.join("a.slices"), before).unwrap();
}

#[test]
fn cut_and_damaged_scans() {
    let folder = folder();
    let at = folder.path();
    let las = fs::read(at.join("scan.las")).unwrap();
    fs::write(at.join("cut.las"), &las[..las.len() / 2]).unwrap();
    is_incomplete(at, &["cut.las"], "cut.las: ", 1494, 1506);
    let words = "the header states 3000 points, the file holds 1494 whole ones";
    is_incomplete(at, &["cut.las", "scan.las"], words, 4494, 1506);
    // The spacing of a single point is not what is wrong.
    fs::write(at.join("one.pts"), "5\n1 2 3\n").unwrap();
    is_incomplete(at, &["one.pts"], "its first line states 5 points, 1 line follows", 1, 4);
    // The header counts too few points: others follow, whether or not they lie in its bounds.
    let mut few = las.clone();
    few[107..111].copy_from_slice(&1000u32.to_le_bytes());
    fs::write(at.join("few.las"), &few).unwrap();
    is_incomplete(at, &["few.las"], "the header states 1000 points, but its records have room for 3000", 1000, 2000);
    few[107..111].copy_from_slice(&2999u32.to_le_bytes());
    few[179..227].fill(0);
    fs::write(at.join("few.las"), few).unwrap();
    is_incomplete(at, &["few.las"], "the header states 2999 points, but its records have room for 3000", 2999, 1);
    let appended: Vec<u8> = las.iter().copied().chain([7; 34]).collect();
    fs::write(at.join("appended.las"), appended).unwrap();
    let words = "the header states 3000 points, but its records have room for 3001";
    is_incomplete(at, &["appended.las"], words, 3000, 1);
    // Zeros may follow as padding.
    let padded: Vec<u8> = las.iter().copied().chain([0; 4096]).collect();
    fs::write(at.join("padded.las"), padded).unwrap();
    let said = converts(at, &[&["padded.las"], &OPTIONS[..], &["--force"]].concat());
    assert!(said.contains("warning: padded.las: the header states 3000 points; 4096 zeros after them"), "{said}");
    assert_eq!(points_kept(at), 3000);
    let mut laz = fs::read(at.join("scan.laz")).unwrap();
    let middle = laz.len() * 2 / 3;
    laz[middle..middle + 300].fill(0xA5);
    fs::write(at.join("damaged.laz"), laz).unwrap();
    let said = refuses(at, &[&["damaged.laz"], &OPTIONS[..], &["--force"]].concat(), 1);
    assert!(said.contains("damaged.laz: LAZ chunk 1: damaged"), "{said}");
    // A pass before, for the spacing, reports nothing and counts nothing.
    for more in [&[][..], &["--fill-holes", "auto"]] {
        let said = converts(at, &[&["damaged.laz"], &OPTIONS[..], &["--force", "--allow-incomplete"], more].concat());
        assert!(said.contains("warning: damaged.laz: incomplete: LAZ chunk 1: damaged"), "{said}");
        assert!(said.contains("5,000 points could not be read") && !said.contains("10,000"), "{said}");
        assert_eq!(points_kept(at), 7_000);
    }
}

/// No point of a damaged chunk is kept, so every way to convert its file keeps the same points.
#[test]
fn damaged_laz_in_parts_gives_what_one_run_gives() {
    for format in [1, 6] {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let scan = at.join("scan.laz");
        let spec = WriteSpec { format, compression: Some(Chunks::Fixed(1000)), ..WriteSpec::for_path(&scan) };
        let mut all = points(12_000);
        all.retain(|point| point.iter().all(|v| v.abs() < 100.0));
        write_las(&scan, all, &spec).unwrap();
        let input = [scan.clone()];
        let mut options = ConvertOptions::new(input.to_vec(), at.join("whole.slices"));
        options.grid.pixel = PixelSize::Metres(0.1);
        options.overwrite = true;
        let good = fs::read(&scan).unwrap();
        // Among the coordinates of a chunk, because other layers of formats 6 to 10 are not read.
        let places =
            if format == 6 { [2, 8].map(|n| chunks(&good)[n] + 150) } else { [3, 4].map(|n| good.len() * n / 5) };
        for place in places {
            let mut bad = good.clone();
            bad[place..place + 40].iter_mut().for_each(|byte| *byte ^= 0x5A);
            fs::write(&scan, bad).unwrap();
            options.allow_incomplete = false;
            let file = PlanFile::new(&options, &NoMonitor).unwrap();
            let said = convert(&options, &NoMonitor).unwrap_err().to_string();
            assert!(said.contains(": damaged: "), "{said}");
            // Each part that meets the damage reports the same, and nothing about bounds.
            let refusals: Vec<_> = (1..=3).filter_map(|index| part(at, &input, index, &file).err()).collect();
            assert!(!refusals.is_empty() && refusals.iter().all(|error| error.to_string() == said), "{refusals:?}");
            options.allow_incomplete = true;
            convert(&options, &NoMonitor).unwrap();
            let parts = [1, 2, 3].map(|index| part_of(at, &input, index, &file, true).unwrap());
            merge(&parts, &at.join("merged.slices"), true, &NoMonitor).unwrap();
            assert!(fs::read(at.join("merged.slices")).unwrap() == fs::read(&options.output).unwrap());
        }
    }
}

#[test]
fn coordinates_that_cannot_be_kept() {
    let folder = folder();
    let at = folder.path();
    let mut las = fs::read(at.join("scan.las")).unwrap();
    // With steps of 10⁷ m, the outermost coordinates are beyond 10¹² m.
    las[131..139].copy_from_slice(&1e8f64.to_le_bytes());
    fs::write(at.join("far.las"), las).unwrap();
    let said = refuses(at, &["far.las", "-o", "b.slices", "--pixel", "1e5", "--units", "m"], 1);
    assert!(said.contains("points have a coordinate that is not finite or beyond 1e12 m"), "{said}");
    let allowed = ["far.las", "-o", "b.slices", "--pixel", "1e5", "--units", "m", "--allow-incomplete"];
    assert!(converts(at, &allowed).contains("points have a coordinate that is not finite"));
}

#[test]
fn files_that_cannot_be_read() {
    let folder = folder();
    let at = folder.path();
    fs::create_dir(at.join("tiles")).unwrap();
    fs::copy(at.join("scan.las"), at.join("tiles/a.las")).unwrap();
    fs::write(at.join("tiles/b.las"), "no scan at all, and long enough to hold a header if it were one".repeat(9))
        .unwrap();
    for inputs in [&["tiles"][..], &["tiles/*.las"], &["scan.las", "tiles/b.las"], &["scan.las", "none.las"]] {
        let said = refuses(at, &[inputs, &OPTIONS, &["--force"]].concat(), 1);
        assert!(said.contains("b.las") || said.contains("none.las"), "{said}");
        let said = converts(at, &[inputs, &OPTIONS, &["--force", "--allow-incomplete"]].concat());
        assert!(said.contains("warning: incomplete: left out: "), "{said}");
        assert_eq!(points_kept(at), 3000);
    }
    // If nothing is left, nothing is written.
    for inputs in [&["tiles/b.las"][..], &["none.las"], &["none/*.las"]] {
        refuses(at, &[inputs, &OPTIONS, &["--force", "--allow-incomplete"]].concat(), 1);
        assert_eq!(points_kept(at), 3000);
    }
    // Nor if the files open and hold no whole point.
    let las = fs::read(at.join("scan.las")).unwrap();
    fs::write(at.join("cut.las"), &las[..230]).unwrap();
    write(&at.join("broken.laz"), &points(3000));
    let mut laz = fs::read(at.join("broken.laz")).unwrap();
    let third = laz.len() / 3;
    laz[third..third + 200].fill(0xA5);
    fs::write(at.join("broken.laz"), laz).unwrap();
    for (input, words) in
        [("cut.las", "can be read"), ("broken.laz", "the header states 3000 points, but none can be read")]
    {
        let said = refuses(at, &[&[input], &OPTIONS[..], &["--force", "--allow-incomplete"]].concat(), 1);
        assert!(said.contains(words), "{input}: {said}");
        assert_eq!(points_kept(at), 3000);
    }
}

/// Whatever the kinds of the others are.
#[test]
fn a_file_of_which_nothing_can_be_read_is_left_out_beside_others() {
    let folder = folder();
    let at = folder.path();
    let laz = fs::read(at.join("scan.laz")).unwrap();
    let mut broken = laz.clone();
    broken[laz.len() / 3..].fill(0xA5);
    for (name, bytes) in [
        ("header.las", &b"LASF, and no header"[..]),
        ("chunk.laz", &broken),
        ("bad.spz", b"NGSP, and no header of splats"),
        ("cut.stl", b"solid\nfacet"),
        ("empty.obj", b"v 0 0 0\n"),
        (
            "flat.stl",
            b"solid\nfacet\nouter loop\nvertex 0 0 0\nvertex 0 0 0\nvertex 0 0 0\nendloop\nendfacet\nendsolid",
        ),
        ("floor.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    ] {
        fs::write(at.join(name), bytes).unwrap();
    }
    let before = fs::read(at.join("a.slices")).unwrap();
    let bad = ["header.las", "chunk.laz", "bad.spz", "cut.stl", "empty.obj", "flat.stl"];
    for name in bad {
        for sound in ["scan.las", "floor.obj"] {
            refuses(at, &[&[sound, name], &OPTIONS[..], &["--force"]].concat(), 1);
            let said = converts(at, &[&[sound, name], &OPTIONS[..], &["--force", "--allow-incomplete"]].concat());
            assert!(said.contains("incomplete") && said.contains(name), "{sound}, {name}: {said}");
        }
        let options = ["--pixel", "auto", "--units", "m", "-o", "a.slices", "--force", "--allow-incomplete"];
        converts(at, &[&["scan.las", name], &options[..]].concat());
    }
    fs::write(at.join("a.slices"), &before).unwrap();
    for inputs in [&bad[..], &bad[..2], &bad[1..4], &bad[2..], &bad[3..], &bad[4..5]] {
        refuses(at, &[inputs, &OPTIONS, &["--force", "--allow-incomplete"]].concat(), 1);
        assert!(fs::read(at.join("a.slices")).unwrap() == before, "{inputs:?}");
    }
}

#[test]
fn broken_meshes() {
    let folder = folder();
    let at = folder.path();
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 nan\n";
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
               element face 3\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 9\n";
    let stl = "solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    let mut binary = vec![b' '; 80];
    binary.extend(2u32.to_le_bytes());
    binary.extend([0; 12]);
    [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().for_each(|v| binary.extend(v.to_le_bytes()));
    binary.extend([0; 20]);
    for (name, bytes, words) in [
        (
            "face.obj",
            format!("{corners}f 1 2 3\nf 1 2 9\nf 1 2 3 zero\n").into_bytes(),
            "line 6: there is no corner \"9\"",
        ),
        ("far.obj", format!("{corners}f 1 2 3\nf 1 2 4\n").into_bytes(), "1 of 2 triangles have a corner"),
        ("face.ply", ply.as_bytes().to_vec(), "there is no corner 9"),
        ("cut.ply", ply.replace("3 0 1 9\n", "").into_bytes(), "the file ends before the elements"),
        ("cut.stl", stl.as_bytes().to_vec(), "ends before \"endsolid\""),
        ("loop.stl", format!("{stl}facet\nvertex 1 2 3\nendloop\nendsolid\n").into_bytes(), "a loop has 1 corners"),
        ("binary.stl", binary, "states 2 triangles of 50 bytes"),
    ] {
        fs::write(at.join(name), bytes).unwrap();
        is_incomplete(at, &[name], words, 1, 0);
    }
    // A degenerate triangle is not a loss.
    fs::write(at.join("flat.obj"), format!("{corners}f 1 2 3\nf 1 2 2\n")).unwrap();
    let said = converts(at, &[&["flat.obj"], &OPTIONS[..], &["--force"]].concat());
    assert!(said.contains("1 of 2 triangles left out: they have no area"), "{said}");
}

#[cfg(unix)]
#[test]
fn names_of_any_bytes_count_in_patterns_too() {
    use std::os::unix::ffi::OsStrExt;
    let folder = folder();
    let at = folder.path();
    fs::create_dir(at.join("tiles")).unwrap();
    fs::copy(at.join("scan.las"), at.join("tiles/a.las")).unwrap();
    let odd = std::ffi::OsStr::from_bytes(b"tiles/Gr\xF6\xDFe.las");
    fs::copy(at.join("scan.las"), at.join(odd)).unwrap();
    for input in ["tiles", "tiles/*.las", "**/tiles/*"] {
        converts(at, &[&[input], &OPTIONS[..], &["--force"]].concat());
        assert_eq!(points_kept(at), 6000, "{input}");
    }
}

/// Checks that it ends within a minute, rather than waiting forever.
#[cfg(unix)]
fn ends(folder: &Path, arguments: &[&str]) -> String {
    use std::process::Stdio;
    use std::time::{Duration, Instant};
    let mut child = command(folder).args(arguments).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if began.elapsed() > Duration::from_secs(60) {
            child.kill().unwrap();
            panic!("{arguments:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let out = child.wait_with_output().unwrap();
    assert_eq!(out.status.code(), Some(1));
    String::from_utf8(out.stderr).unwrap()
}

#[cfg(unix)]
#[test]
fn pipes_devices_and_links_in_circles_are_no_input() {
    let folder = folder();
    let at = folder.path();
    let pipe =
        |name: &str| assert!(std::process::Command::new("mkfifo").arg(at.join(name)).status().unwrap().success());
    let buffer = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4,"uri":"buffer.bin"}]}"#;
    fs::write(at.join("scene.gltf"), buffer).unwrap();
    for name in ["a.las", "a.laz", "a.obj", "a.ply", "a.stl", "a.glb", "plan.json", "buffer.bin"] {
        pipe(name);
    }
    for input in ["a.las", "a.laz", "a.obj", "a.ply", "a.stl", "a.glb", "scene.gltf", "?.la?", "/dev/zero"] {
        let said = ends(at, &[&[input], &OPTIONS[..], &["--force", "--quiet"]].concat());
        assert!(said.contains("a pipe or a device"), "{input}: {said}");
    }
    let said = ends(at, &["scan.las", "--plan", "plan.json", "-o", "b.slices"]);
    assert!(said.contains("plan.json") && said.contains("a pipe or a device"), "{said}");
    for n in 0..12 {
        std::os::unix::fs::symlink(".", at.join(format!("loop{n}"))).unwrap();
    }
    let said = ends(at, &["**/*.none", "-o", "b.slices"]);
    assert!(said.contains("matches no"), "{said}");
}

#[test]
fn buffers_outside_the_folder_of_a_gltf_file_are_not_followed() {
    let folder = folder();
    let at = folder.path();
    fs::create_dir(at.join("scene")).unwrap();
    fs::write(at.join("secret.bin"), [0; 36]).unwrap();
    let outside = text(&at.join("secret.bin")).replace('\\', r"\\");
    for uri in ["../secret.bin", "%2e%2e/secret.bin", "x/../../secret.bin", &outside] {
        let json = format!(r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":36,"uri":"{uri}"}}]}}"#);
        fs::write(at.join("scene/a.gltf"), json).unwrap();
        let said = refuses(at, &[&["scene/a.gltf"], &OPTIONS[..], &["--force", "--quiet"]].concat(), 1);
        // A drive looks like the scheme of an address.
        let why = if uri.contains(':') { "it lies elsewhere" } else { "leads out of the folder" };
        assert!(said.contains(why), "{uri}: {said}");
    }
}

/// Modifies files when a stage begins.
struct Meddler<F: Fn()> {
    stage: &'static str,
    act: F,
    heard: Mutex<Vec<String>>,
}

impl<F: Fn() + Sync> Monitor for Meddler<F> {
    fn stage(&self, name: &str, _: u64, _: &str) {
        if name == self.stage {
            (self.act)();
        }
    }

    fn warn(&self, warning: &Warning) {
        self.heard.lock().unwrap().push(warning.to_string());
    }
}

#[test]
fn files_that_change_while_they_are_read() {
    let folder = folder();
    let at = folder.path();
    let before = fs::read(at.join("a.slices")).unwrap();
    let scan = fs::read(at.join("scan.las")).unwrap();
    fs::write(at.join("floor.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let mut other = scan.clone();
    let middle = scan.len() / 2;
    other[middle..middle + 400].reverse();
    fs::write(at.join("other.las"), &other).unwrap();
    type Act<'a> = Box<dyn Fn() + Sync + 'a>;
    let of = |name: &str| fs::File::options().write(true).open(at.join(name)).unwrap();
    let acts: Vec<(&str, Act)> = vec![
        ("scan.las", Box::new(|| of("scan.las").set_len(50_000).unwrap())),
        ("scan.las", Box::new(|| fs::write(at.join("scan.las"), [&scan[..], &[7; 500]].concat()).unwrap())),
        ("scan.las", Box::new(|| fs::write(at.join("scan.las"), &other).unwrap())),
        ("scan.las", Box::new(|| fs::rename(at.join("other.las"), at.join("scan.las")).unwrap())),
        ("scan.las", Box::new(|| fs::remove_file(at.join("scan.las")).unwrap())),
        ("floor.obj", Box::new(|| fs::write(at.join("floor.obj"), "v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n").unwrap())),
    ];
    for (number, (name, act)) in acts.iter().enumerate() {
        // Before the only pass, and between the two passes that determine the pixel size from the points.
        for (pixel, stage) in [
            (PixelSize::Metres(0.1), if *name == "floor.obj" { "reading meshes" } else { "reading points" }),
            (PixelSize::Auto, "reading points"),
        ] {
            fs::write(at.join("scan.las"), &scan).unwrap();
            fs::write(at.join("other.las"), &other).unwrap();
            for allow_incomplete in [false, true] {
                let monitor = Meddler { stage, act, heard: Mutex::default() };
                let mut options = ConvertOptions::new(vec![at.join(name)], at.join("a.slices"));
                options.grid.pixel = pixel;
                options.overwrite = true;
                options.allow_incomplete = allow_incomplete;
                // A file that disappears before its points are read is refused even so.
                let done = convert(&options, &monitor);
                if allow_incomplete && at.join(name).exists() {
                    assert!(done.as_ref().is_ok_and(|report| !report.complete), "{number}: {done:?}");
                    let heard = monitor.heard.into_inner().unwrap();
                    assert!(
                        heard.iter().any(|text| text.contains("incomplete: it was written to")),
                        "{number}: {heard:?}"
                    );
                    fs::write(at.join("a.slices"), &before).unwrap();
                } else {
                    let error = done.unwrap_err().to_string();
                    assert!(error.contains(name), "{number}: {error}");
                    assert!(fs::read(at.join("a.slices")).unwrap() == before, "{number}");
                }
                fs::write(at.join("scan.las"), &scan).unwrap();
                fs::write(at.join("other.las"), &other).unwrap();
                fs::write(at.join("floor.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
            }
        }
    }
}

/// Two adjacent scans, of which the first extends over both halves.
fn two_scans(at: &Path, extension: &str) -> [PathBuf; 2] {
    let mut all = points(40_000);
    all.retain(|point| point.iter().all(|v| v.abs() < 100.0));
    let names = ["wide", "east"].map(|name| at.join(format!("{name}.{extension}")));
    let wide: Vec<_> = all.iter().map(|[x, y, z]| [x * 4.0, *y, *z]).collect();
    let east: Vec<_> = all.iter().map(|[x, y, z]| [x + 30.0, *y, *z]).collect();
    for (name, points) in names.iter().zip([wide, east]) {
        let mut spec = WriteSpec { format: 6, ..WriteSpec::for_path(name) };
        spec.compression = spec.compression.map(|_| Chunks::Fixed(1000));
        write_las(name, points, &spec).unwrap();
    }
    names
}

/// Returns whether this byte belongs to the samples by which a plan identifies a file: eight blocks of 4096 bytes,
/// evenly from first to last.
fn is_sampled(at: usize, len: usize) -> bool {
    (0..8).map(|n| (len - 4096) * n / 7).any(|begin| (begin..begin + 4096).contains(&at))
}

/// Offsets of the chunks of a LAZ file of format 6: each has a point, the number of points, and nine sizes of layers.
fn chunks(file: &[u8]) -> Vec<usize> {
    let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
    let (mut at, mut starts) = (word(96) + 8, Vec::new());
    let table = word(word(96));
    while at < table {
        starts.push(at);
        at += 70 + (0..9).map(|layer| word(at + 34 + 4 * layer)).sum::<usize>();
    }
    starts
}

/// Converts part `index` of three.
fn part(at: &Path, inputs: &[PathBuf], index: u32, file: &PlanFile) -> slicewalk::Result<PathBuf> {
    part_of(at, inputs, index, file, false)
}

fn part_of(
    at: &Path,
    inputs: &[PathBuf],
    index: u32,
    file: &PlanFile,
    allow_incomplete: bool,
) -> slicewalk::Result<PathBuf> {
    let output = at.join(format!("{index}.slices"));
    let mut options = ConvertOptions::new(inputs.to_vec(), output.clone());
    file.apply_to(&mut options);
    options.overwrite = true;
    options.allow_incomplete = allow_incomplete;
    options.plan_file = Some(file.clone());
    options.shard = Some(ShardOptions { index, count: 3 });
    convert(&options, &NoMonitor)?;
    Ok(output)
}

#[test]
fn parts_of_two_versions_of_an_input_are_refused_by_its_name() {
    for extension in ["las", "laz"] {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let mut inputs = two_scans(at, extension).to_vec();
        fs::write(at.join("floor.obj"), "v 0 0 0\nv 0.3 0 0\nv 0 0.3 0\n".to_owned() + &"f 1 2 3\n".repeat(9000))
            .unwrap();
        inputs.push(at.join("floor.obj"));
        let mut options = ConvertOptions::new(inputs.clone(), at.join("unused"));
        options.grid.pixel = PixelSize::Metres(0.1);
        let file = PlanFile::new(&options, &NoMonitor).unwrap();
        file.write(&at.join("plan.json"), false).unwrap();
        let good = [1, 2, 3].map(|index| part(at, &inputs, index, &file).unwrap());
        let merged = at.join("merged.slices");
        merge(&good, &merged, false, &NoMonitor).unwrap();
        let whole = at.join("whole.slices");
        options.output.clone_from(&whole);
        convert(&options, &NoMonitor).unwrap();
        assert!(fs::read(&whole).unwrap() == fs::read(&merged).unwrap());
        // One byte between the samples by which the plan identifies a file: the intensity of a point, or a corner of
        // the mesh.
        for (name, changed) in [(&inputs[0], "a scan"), (&inputs[2], "a mesh")] {
            let before = fs::read(name).unwrap();
            let place = match (changed, extension) {
                ("a mesh", _) => (before.len() / 5..).find(|&at| before[at] == b'3' && !is_sampled(at, before.len())),
                (_, "las") => (375 + 12..).step_by(30).find(|&at| !is_sampled(at, before.len())),
                // The first point of a chunk is stored uncompressed.
                _ => chunks(&before).into_iter().map(|at| at + 12).find(|&at| !is_sampled(at, before.len())),
            };
            let mut after = before.clone();
            after[place.unwrap()] ^= 1;
            fs::write(name, &after).unwrap();
            let second = part(at, &inputs, 2, &file).unwrap();
            fs::write(name, before).unwrap();
            let parts = [good[0].clone(), second, good[2].clone()];
            let error = merge(&parts, &at.join("bad.slices"), false, &NoMonitor);
            let error = error.unwrap_err().to_string();
            let input = name.file_name().unwrap().to_str().unwrap();
            assert!(
                error.starts_with(&format!("{input}: content: it changed between two parts")),
                "{changed}: {error}"
            );
            assert!(!at.join("bad.slices").exists());
            // Also detected if the parts meet only in the last node of a tree, because joined parts keep what they
            // read.
            let node = |index: u32, from: &[PathBuf]| {
                let name = at.join(format!("node{index}.slices"));
                merge_run(from, (index, 2), &name, true, &NoMonitor).map(|_| name)
            };
            let found = node(2, &parts[1..])
                .and_then(|last| merge(&[node(1, &parts[..1])?, last], &at.join("bad.slices"), false, &NoMonitor));
            let error = found.unwrap_err().to_string();
            assert!(error.contains("it changed between two parts"), "{changed}: {error}");
            assert!(!at.join("bad.slices").exists());
            part(at, &inputs, 2, &file).unwrap();
        }
        // A change of most of the file shows in the samples, before the work begins.
        let mut after = fs::read(&inputs[0]).unwrap();
        let len = after.len();
        after[len / 10..len * 9 / 10].iter_mut().for_each(|byte| *byte ^= 1);
        fs::write(&inputs[0], after).unwrap();
        let error = part(at, &inputs, 2, &file).unwrap_err().to_string();
        assert!(error.contains("has changed since"), "{error}");
    }
}

/// No empty archive takes the place of a scan of which nothing can be used.
#[test]
fn a_scan_without_one_usable_point_is_refused_even_where_gaps_are_allowed() {
    let folder = folder();
    let axes = "property double x\nproperty double y\nproperty double z\n";
    let far = format!("ply\nformat ascii 1.0\nelement vertex 2\n{axes}end_header\n1e13 1 2\n1e13 2 3\n");
    let before = fs::read(folder.path().join("a.slices")).unwrap();
    for (name, text, words) in [
        (
            "far.ply",
            &*far,
            "far.ply: points: no point has a finite position within 1e12 m; fetch or write the file again",
        ),
        ("none.pts", "5\n", "INPUT: nothing of it can be used; fetch or write it again"),
    ] {
        fs::write(folder.path().join(name), text).unwrap();
        let said = refuses(folder.path(), &[&[name, "--force", "--allow-incomplete"], &OPTIONS[..]].concat(), 1);
        assert!(said.contains(words), "{said}");
        assert!(fs::read(folder.path().join("a.slices")).unwrap() == before, "{name}");
    }
}
