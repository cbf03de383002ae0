//! Clouds in E57, PLY, PCD and text: each gives the archive of the same points as LAS, alone and mixed, also in parts.
//! Damaged files are refused in one line; real files contain the points that other readers find in them.

use crate::reading::{gzip, read};
use crate::scans;
use crate::write;

use e57::{
    CartesianCoordinate, E57Reader, E57Writer, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform,
    Translation,
};
use scangen::{WriteSpec, write_las};
use scans::{Random, converts, data, refuses, verifies};
use slicewalk::archive::{Archive, merge};
use slicewalk::{Error, NoMonitor};
use slicewalk_input::{InputOptions, InputSet, PointCounts};
use std::fs;
use std::path::Path;
use write::{Cloud, E57, Pcd, Ply, Point, e57, pcd, ply, pts, ptx, rows};

/// A step that 32-bit floats, decimal text and LAS represent exactly.
const STEP: f64 = 1.0 / 1024.0;

/// A floor, a wall and a few scattered points within ±30 m.
fn points(count: usize, seed: u64) -> Vec<Point> {
    let mut random = Random(seed);
    let mut steps = |size: f64| (random.uniform() * size / STEP).round() * STEP;
    (0..count)
        .map(|number| match number % 8 {
            0 => [steps(60.0) - 30.0, steps(60.0) - 30.0, STEP + steps(5.0)],
            1 | 2 => [7.0 + steps(0.02), steps(20.0) - 10.0, STEP + steps(3.0)],
            _ => [steps(20.0) - 10.0, steps(20.0) - 10.0, STEP + steps(0.03)],
        })
        .collect()
}

fn las(path: &Path, points: &[Point]) {
    let mut spec = WriteSpec::for_path(path);
    (spec.scale, spec.offset) = ([STEP; 3], [0.0; 3]);
    write_las(path, points.iter().copied(), &spec).unwrap();
}

fn archive(folder: &Path, inputs: &[&str], options: &[&str]) -> Vec<u8> {
    let fixed = ["-o", "out.slices", "--force", "--quiet", "--temp-dir", ".", "--pixel", "0.25"];
    converts(folder, &[inputs, &fixed, options].concat());
    fs::read(folder.join("out.slices")).unwrap()
}

fn read_one(path: &Path) -> Result<(Vec<Point>, PointCounts), Error> {
    read(&[path.to_path_buf()], InputOptions::default()).map(|(points, counts, _)| (points, counts))
}

#[test]
fn coordinates_in_floats_that_are_coarse_for_the_pixels_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    const FAR: f64 = 5_000_000.0;
    let near: Vec<Point> = (0..400).map(|n| [f64::from(n % 20) * 0.5, f64::from(n / 20) * 0.5, 0.25]).collect();
    let far: Vec<Point> = near.iter().map(|[x, y, z]| [x + FAR, *y, *z]).collect();
    let put_e57 = |name: &str, points: &[Point], form: E57| {
        e57(&at(name), &[Cloud { points, form, posed: false, mixed: false }], None);
    };
    fs::write(at("near.ply"), ply(&near, Ply::Little)).unwrap();
    fs::write(at("text.ply"), ply(&far, Ply::Text)).unwrap();
    put_e57("near.e57", &near, E57::Single);
    put_e57("double.e57", &far, E57::Double);
    fs::write(at("little.ply"), ply(&far, Ply::Little)).unwrap();
    fs::write(at("binary.pcd"), pcd(&far, Pcd::Binary)).unwrap();
    fs::write(at("packed.pcd"), pcd(&far, Pcd::Packed)).unwrap();
    put_e57("single.e57", &far, E57::Single);
    // Around the scanner, whose place is far.
    let mut writer = E57Writer::from_file(at("posed.e57"), "{00000000-0000-0000-0000-000000000004}").unwrap();
    let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    let prototype = axes.map(|name| Record { name, data_type: RecordDataType::F32 }).to_vec();
    let mut cloud = writer.add_pointcloud("cloud", prototype).unwrap();
    let (rotation, translation) =
        (Quaternion { w: 1.0, x: 0.0, y: 0.0, z: 0.0 }, Translation { x: FAR, y: 0.0, z: 0.0 });
    cloud.set_transform(Some(Transform { rotation, translation }));
    for point in &near {
        cloud.add_point(point.map(|v| RecordValue::Single(v as f32)).to_vec()).unwrap();
    }
    cloud.finalize().unwrap();
    writer.finalize().unwrap();
    fs::write(at("m.txt"), format!("1 0 0 {FAR}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")).unwrap();

    let said = |inputs: &[&str], pixel: &str, more: &[&str]| {
        let options = ["-o", "a.slices", "--force", "--units", "m", "--pixel", pixel];
        let said = converts(folder.path(), &[inputs, &options, more].concat());
        let lines: Vec<&str> = said.lines().filter(|line| line.contains("floats of 32 bits")).collect();
        lines.join("\n")
    };
    for name in ["little.ply", "binary.pcd", "packed.pcd", "single.e57"] {
        let expected = format!(
            "sliceconv: warning: {name}: coordinates are floats of 32 bits, which are 0.5 m apart at 5,000,009, for pixels \
             of 0.5 m; export with an offset subtracted, or with coordinates of 64 bits (double)"
        );
        assert_eq!(said(&[name], "0.5", &[]), expected);
        assert_eq!(said(&[name], "2", &[]), "", "{name}: a quarter of a pixel");
    }
    let several = said(&["single.e57", "near.ply", "little.ply", "binary.pcd"], "0.5", &[]);
    assert!(several.contains("binary.pcd and 2 more: ") && several.lines().count() == 1, "{several}");
    for name in ["near.ply", "text.ply", "near.e57", "double.e57", "posed.e57"] {
        assert_eq!(said(&[name], "0.5", &[]), "", "{name}");
    }
    assert_eq!(said(&["near.ply"], "0.5", &["--transform", "m.txt"]), "", "the coordinates of the file count");
}

#[test]
fn every_format_gives_the_archive_of_the_same_points_as_las() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // More than two blocks of E57, and more than one of text.
    let all = points(200_000, 3);
    las(&at("a.las"), &all);
    let expected = archive(folder.path(), &["a.las"], &[]);
    verifies(&at("out.slices"));
    let put = |name: &str, bytes: &[u8]| fs::write(at(name), bytes).unwrap();
    put("text.ply", &ply(&all, Ply::Text));
    put("little.ply", &ply(&all, Ply::Little));
    put("big.PLY", &ply(&all, Ply::Big));
    put("text.pcd", &pcd(&all, Pcd::Text));
    put("binary.pcd", &pcd(&all, Pcd::Binary));
    put("packed.pcd", &pcd(&all, Pcd::Packed));
    let blanks = rows(&all, "  ");
    assert!(blanks.len() > 4 << 20, "one piece of text only");
    put("a.xyz", blanks.as_bytes());
    put("a.xyz.gz", &gzip(blanks.as_bytes()));
    put("a.xyz.zst", &zstd::encode_all(blanks.as_bytes(), 3).unwrap());
    put("a.csv", format!("\u{feff}\"X\", \"Y\",\"Z\"\n\n{}", rows(&all, ",")).as_bytes());
    put("german.csv", rows(&all, ";").replace('.', ",").as_bytes());
    put("tabs.txt", format!("// x y z\n{}", rows(&all, "\t").replace('.', ",")).as_bytes());
    let turned: Vec<Point> = all.iter().map(|&[x, y, z]| [z, x, y]).collect();
    put("turned.txt", rows(&turned, " ").as_bytes());
    put("a.pts", pts(&[&all]).as_bytes());
    put("two.pts", pts(&[&all[..70_001], &all[70_001..]]).as_bytes());
    for (name, form, posed) in
        [("single.e57", E57::Single, false), ("double.e57", E57::Double, true), ("scaled.e57", E57::Scaled, false)]
    {
        let cloud = |points| Cloud { points, form, posed, mixed: false };
        e57(&at(name), &[cloud(&all[..150_000]), cloud(&all[150_000..])], None);
    }
    for (name, options) in [
        ("text.ply", &[][..]),
        ("little.ply", &["--threads", "1"]),
        ("big.PLY", &["--memory", "64MiB"]),
        ("text.pcd", &[]),
        ("binary.pcd", &[]),
        ("packed.pcd", &[]),
        ("a.xyz", &["--threads", "4"]),
        ("a.xyz.gz", &["--memory", "64MiB"]),
        ("a.xyz.zst", &["--memory", "64MiB"]),
        ("a.csv", &[]),
        ("german.csv", &[]),
        ("tabs.txt", &[]),
        ("turned.txt", &["--columns", "z,x,y"]),
        ("a.pts", &["--threads", "3"]),
        ("two.pts", &[]),
        ("single.e57", &["--threads", "4"]),
        ("double.e57", &["--memory", "64MiB", "--threads", "1"]),
        ("scaled.e57", &["--threads", "3"]),
    ] {
        assert!(archive(folder.path(), &[name], options) == expected, "{name}");
    }
    // `--up`, `--units` and `--fill-holes` apply to all formats.
    let options = ["--up", "y", "--units", "ft", "--pixel", "0.1", "--fill-holes", "0.3"];
    let (small, folder) = (&all[..5000], folder.path());
    las(&at("small.las"), small);
    put("small.ply", &ply(small, Ply::Little));
    put("small.xyz", rows(small, " ").as_bytes());
    e57(&at("small.e57"), &[Cloud { points: small, form: E57::Double, posed: false, mixed: false }], None);
    let small = |name: &str| {
        converts(folder, &[&[name, "-o", "s.slices", "--force", "--quiet"][..], &options].concat());
        fs::read(folder.join("s.slices")).unwrap()
    };
    let expected = small("small.las");
    for name in ["small.ply", "small.xyz", "small.e57"] {
        assert!(small(name) == expected, "{name}");
    }
}

#[test]
fn formats_mix_in_one_run_in_folders_and_in_parts() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let all = points(60_000, 4);
    las(&at("whole.las"), &all);
    let expected = archive(folder.path(), &["whole.las"], &[]);
    fs::create_dir(at("scans")).unwrap();
    let parts: Vec<&[Point]> = all.chunks(7_500).collect();
    las(&at("scans/a.las"), parts[0]);
    las(&at("scans/b.laz"), parts[1]);
    e57(&at("scans/c.e57"), &[Cloud { points: parts[2], form: E57::Scaled, posed: false, mixed: false }], None);
    fs::write(at("scans/d.PCD"), pcd(parts[3], Pcd::Packed)).unwrap();
    fs::write(at("scans/e.pts"), pts(&[parts[4]])).unwrap();
    fs::write(at("scans/f.xyz.gz"), gzip(rows(parts[5], " ").as_bytes())).unwrap();
    fs::write(at("scans/g.ply"), ply(parts[6], Ply::Big)).unwrap();
    fs::write(at("scans/h.csv"), rows(parts[7], ",")).unwrap();
    fs::write(at("scans/notes.txt"), "these are no points").unwrap();
    let inputs = ["scans", "scans/g.ply", "scans/h.csv"];
    assert!(archive(folder.path(), &inputs, &[]) == expected);
    assert!(archive(folder.path(), &["scans/h.csv", "scans/*.ply", "scans/*"], &["--threads", "3"]) == expected);
    let said = refuses(folder.path(), &["scans/*.csv", "-o", "x.slices"], 1);
    assert!(said.contains(".csv and .asc explicitly"), "{said}");
    // The plan knows where every file lies, although most files have no header that states it.
    converts(folder.path(), &[&inputs[..], &["--write-plan", "plan.json", "--pixel", "0.25"]].concat());
    let plan: serde_json::Value = serde_json::from_str(&fs::read_to_string(at("plan.json")).unwrap()).unwrap();
    let listed = plan["inputs"].as_array().unwrap();
    assert!(listed.iter().all(|input| input["points"] == 7_500 && input["bounds"].is_object()), "{plan:#}");
    for (with_plan, name) in [(true, "planned"), (false, "free")] {
        let mut files = Vec::new();
        for shard in ["1/3", "2/3", "3/3"] {
            let output = format!("{name}-{}.slices", &shard[..1]);
            let options = if with_plan { ["--plan", "plan.json"] } else { ["--pixel", "0.25"] };
            let fixed = ["-o", &output, "--quiet", "--shard", shard];
            converts(folder.path(), &[&inputs[..], &fixed, &options].concat());
            files.push(at(&output));
        }
        let with_points = files.iter().filter(|file| Archive::open(file).unwrap().header().points_kept > 1000).count();
        assert!(with_points >= 2, "{with_points} of 3 parts hold something");
        merge(&files, &at(name), false, &NoMonitor).unwrap();
        assert!(fs::read(at(name)).unwrap() == expected, "{name}");
    }
    fs::write(at("scans/h.csv"), rows(parts[7], ", ")).unwrap();
    let said = refuses(folder.path(), &[&inputs[..], &["--plan", "plan.json", "-o", "y.slices"]].concat(), 1);
    assert!(said.contains("h.csv"), "{said}");
}

#[test]
fn records_without_a_return_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let all = points(1000, 5);
    let mut holes = all.clone();
    for number in 0..100 {
        holes.insert(number * 10, [f64::NAN, 1.0, 2.0]);
    }
    for (name, bytes) in [
        ("a.pcd", pcd(&holes, Pcd::Text)),
        ("b.pcd", pcd(&holes, Pcd::Binary)),
        ("c.pcd", pcd(&holes, Pcd::Packed)),
        ("d.ply", ply(&holes, Ply::Big)),
        ("e.ply", ply(&holes, Ply::Text)),
        ("f.xyz", rows(&holes, " ").into_bytes()),
        ("g.ptx", ptx(&[&all[..500], &all[500..]]).0.into_bytes()),
        ("h.ptx.gz", gzip(ptx(&[&all[..500], &all[500..]]).0.as_bytes())),
    ] {
        fs::write(at(name), bytes).unwrap();
        let (found, counts) = read_one(&at(name)).unwrap();
        assert!(found == all, "{name}");
        assert_eq!((counts.read, counts.withheld, counts.not_finite), (1100, 100, 0), "{name}");
    }
    for (form, posed) in [(E57::Single, true), (E57::Double, false), (E57::Scaled, true)] {
        let cloud = Cloud { points: &all, form, posed, mixed: true };
        e57(&at("i.e57"), &[cloud, Cloud { points: &[], ..cloud }], None);
        let (found, counts) = read_one(&at("i.e57")).unwrap();
        assert!(found == all, "{form:?}");
        assert_eq!((counts.read, counts.withheld), (1200, 200), "{form:?}");
    }
    // Infinite points, and those farther than any scan, count as losses.
    let mut far = all.clone();
    far[7][1] = f64::INFINITY;
    fs::write(at("far.ply"), ply(&far, Ply::Little)).unwrap();
    assert!(read_one(&at("far.ply")).unwrap_err().to_string().contains("not finite"));
}

#[test]
fn classes_systems_and_layouts_of_text_are_understood_and_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let classes = InputOptions { exclude_classes: [7].into_iter().collect(), ..InputOptions::default() };
    fs::write(at("a.csv"), "Classification;Y;X;Z\n2;1,5;2,5;3\n7;1;1;1\n").unwrap();
    let layout = |name: &str, options| {
        let set = InputSet::open(&[at(name)], options, &NoMonitor).unwrap();
        set.files()[0].text_layout().unwrap().to_string()
    };
    let (found, counts, said) = read(&[at("a.csv")], classes).unwrap();
    assert_eq!((found, counts.excluded), (vec![[2.5, 1.5, 3.0]], 1));
    assert!(said.iter().all(|line| !line.contains("column")), "{said:?}");
    assert!(layout("a.csv", classes).contains("separated by semicolons, decimal commas"));
    let columns = InputOptions { columns: Some("-,x,y,z,class".parse().unwrap()), ..classes };
    fs::write(at("b.txt"), "9 1 2 3 7 8\n9 4 5 6 1 8\n").unwrap();
    let (found, _, _) = read(&[at("b.txt")], columns).unwrap();
    assert_eq!(found, [[4.0, 5.0, 6.0]]);
    let words = "x is column 2, y is column 3, z is column 4, class is column 5, separated by blanks";
    assert_eq!(layout("b.txt", columns), words);
    // A number of points before rows of XYZ, and comments between the rows.
    fs::write(at("c.xyz"), "2\n# two points\n1 2 3\n\n4 5 6\n").unwrap();
    assert_eq!(read_one(&at("c.xyz")).unwrap().0, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    let wkt = "PROJCS[\"P\",GEOGCS[\"G\",UNIT[\"degree\",0.0174532925199433]],UNIT[\"metre\",1],AUTHORITY[\"EPSG\",\"25832\"]]";
    let all = points(100, 6);
    e57(&at("d.e57"), &[Cloud { points: &all, form: E57::Double, posed: false, mixed: false }], Some(wkt));
    let set = InputSet::open(&[at("d.e57")], InputOptions::default(), &NoMonitor).unwrap();
    assert_eq!(set.crs(), Some(wkt));
    assert!(read(&[at("d.e57")], InputOptions::default()).unwrap().2.is_empty());
    for wkt in [wkt.replace("\"metre\",1", "\"foot\",0.3048"), wkt.replace("PROJCS", "GEOGCS"), "EPSG:2229".into()] {
        e57(&at("f.e57"), &[Cloud { points: &all, form: E57::Double, posed: false, mixed: false }], Some(&wkt));
        let (found, _, said) = read(&[at("f.e57")], InputOptions::default()).unwrap();
        assert_eq!(found, read(&[at("d.e57")], InputOptions::default()).unwrap().0, "metres, by the standard");
        assert!(said.len() == 1 && said[0].contains("metres are taken"), "{wkt}: {said:?}");
    }
    let other = InputOptions { epsg: Some(25833), ..InputOptions::default() };
    assert!(InputSet::open(&[at("d.e57")], other, &NoMonitor).unwrap_err().to_string().contains("expected EPSG:25833"));
    let set = InputSet::open(&[at("c.xyz")], other, &NoMonitor).unwrap();
    assert_eq!(set.crs(), Some("EPSG:25833"));
    let said = read(&[at("c.xyz")], InputOptions::default()).unwrap().2;
    assert!(said.iter().any(|line| line.contains("no unit of length is stated")), "{said:?}");
}

#[test]
fn what_is_broken_is_refused_in_one_line_that_names_the_place() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let all = points(3000, 7);
    let cloud = Cloud { points: &all, form: E57::Double, posed: false, mixed: false };
    e57(&at("good.e57"), &[cloud], None);
    let good = fs::read(at("good.e57")).unwrap();
    let damaged = |place: usize| {
        let mut bytes = good.clone();
        bytes[place] ^= 4;
        bytes
    };
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let ascii = text(ply(&all, Ply::Text));
    let in_pcd = |from: &str, to: &str| text(pcd(&all, Pcd::Text)).replacen(from, to, 1).into_bytes();
    let packed = pcd(&all, Pcd::Packed);
    let data = packed
        .windows(19)
        .position(|w| w == b"binary_compressed\n\0" || w.starts_with(b"binary_compressed\n"))
        .unwrap()
        + 18;
    let with_size = |at: usize, size: u32| {
        let mut bytes = packed.clone();
        bytes[data + at..data + at + 4].copy_from_slice(&size.to_le_bytes());
        bytes
    };
    let mut lzf = packed.clone();
    lzf[data + 8] = 0xFF;
    let splat = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float f_dc_0\nend_header\n";
    let ptx_text = ptx(&[&all[..20], &all[20..40]]).0;
    for (name, bytes, words) in [
        ("a.e57", good[..good.len() / 2].to_vec(), &["header, byte 16", "it is cut"][..]),
        ("a.e57", good[..40].to_vec(), &["ASTM-E57"]),
        ("a.e57", damaged(3000), &["cloud 1", "byte 2048", "checksum"]),
        ("a.e57", damaged(good.len() - 600), &["checksum"]),
        ("a.e57", damaged(700), &["byte 0", "checksum"]),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex x\nend_header\n".to_vec(), &["line 3", "number of elements"]),
        ("a.ply", splat.to_vec(), &["splats"]),
        ("a.ply", ascii.replace("float64 y", "float64 why").into_bytes(), &["no properties x, y and z"]),
        ("a.ply", ascii.as_bytes()[..ascii.len() / 2].to_vec(), &["states 3000 points", "lines follow"]),
        (
            "a.ply",
            ascii.replacen("element vertex 3000", "element vertex 99999999999", 1).into_bytes(),
            &["99999999999"],
        ),
        (
            "a.ply",
            {
                let b = ply(&all, Ply::Big);
                b[..b.len() - 50].to_vec()
            },
            &["the file holds 2998 whole ones"],
        ),
        ("a.pcd", b"1 2 3\n4 5 6\n".to_vec(), &["line 1", "PCD header"]),
        ("a.pcd", in_pcd("FIELDS x", "FIELDS w"), &["expected the fields x, y and z", "w _ y rgb z"]),
        ("a.pcd", in_pcd("SIZE 4", "SIZE 3"), &["TYPE", "type, size or count"]),
        ("a.pcd", in_pcd("COUNT 1", "COUNT 99999999999999999999"), &["field 1"]),
        ("a.pcd", in_pcd("POINTS 3000", "POINTS 3001"), &["states 3001 points"]),
        ("a.pcd", in_pcd("DATA ascii", "DATA zip"), &["not supported", "zip"]),
        ("a.pcd", with_size(0, u32::MAX), &["4294967295 bytes"]),
        ("a.pcd", with_size(4, u32::MAX), &["4294967295 unpacked bytes"]),
        ("a.pcd", lzf, &["LZF"]),
        ("a.xyz", b"1 2 3\n4 five 6\n".to_vec(), &["line 2", "column 2", "five"]),
        ("a.xyz", b"1 2 3\n4 5\n".to_vec(), &["line 2", "expected 3 columns, found 2", "--columns"]),
        ("a.xyz", b"\xFF\xFE1\x00".to_vec(), &["UTF-16"]),
        ("a.xyz", vec![], &["the file is empty"]),
        ("a.xyz", vec![b'1'; 1 << 20], &["line 1", "a line of more than"]),
        ("a.csv", b"X,Y,X\n1,2,3\n".to_vec(), &["expected columns named x, y and z", "X,Y,X", "columns"]),
        ("a.csv", b"1,5, 2,5, 3,5\n".to_vec(), &["commas stand both"]),
        ("a.pts", b"3\n1 2 3\n4 5 6\n".to_vec(), &["cloud 1", "states 3 points, 2 lines follow"]),
        ("a.pts", b"hello\n".to_vec(), &["line 1", "a number of points"]),
        ("a.ptx", b"2\n2\n0 0 0\n1 0 0\n".to_vec(), &["3 numbers of the header"]),
        ("a.ptx", ptx_text.replacen("22\n1\n", "22\n1000000000000\n", 1).into_bytes(), &["cloud 1", "22 lines follow"]),
        ("a.ptx", ptx_text.replacen("22\n1\n", "21\n1\n", 1).into_bytes(), &["the number of columns of a cloud"]),
        ("a.ptx", ptx_text.replacen("0 0 1 0", "0 0 1 5", 1).into_bytes(), &["last column 0 0 0 1"]),
        ("a.xyz.gz", gzip(rows(&all, " ").as_bytes())[..2000].to_vec(), &["cannot be unpacked"]),
        ("a.spz", b"NGSP....".to_vec(), &["SPZ header", "cut"]),
    ] {
        fs::write(at(name), &bytes).unwrap();
        let said = refuses(folder.path(), &[name, "-o", "x.slices", "--pixel", "0.25", "--quiet"], 1);
        assert!(words.iter().all(|word| said.contains(word)) && said.contains(name), "{name}: {words:?}: {said}");
        fs::remove_file(at(name)).unwrap();
    }
    // A cut text is read up to the cut where that is allowed.
    fs::write(at("cut.ply"), &ascii.as_bytes()[..ascii.len() / 2]).unwrap();
    converts(folder.path(), &["cut.ply", "-o", "x.slices", "--pixel", "0.25", "--quiet", "--allow-incomplete"]);
    let mut line = rows(&all, " ");
    line.push_str("1 2\n");
    fs::write(at("line.xyz"), line).unwrap();
    converts(
        folder.path(),
        &["line.xyz", "-o", "x.slices", "--force", "--pixel", "0.25", "--quiet", "--allow-incomplete"],
    );
    assert_eq!(Archive::open(at("x.slices")).unwrap().header().points_kept, 3000);
}

/// Points that the crate `e57` finds in a file.
pub fn by_the_crate(path: &Path) -> Vec<Point> {
    let mut reader = E57Reader::from_file(path).unwrap();
    let mut found = Vec::new();
    for cloud in reader.pointclouds() {
        for point in reader.pointcloud_simple(&cloud).unwrap() {
            if let CartesianCoordinate::Valid { x, y, z } = point.unwrap().cartesian {
                found.push([x, y, z]);
            }
        }
    }
    found
}

#[test]
fn real_clouds_hold_what_other_readers_find() {
    let Some(folder) = data::folder().map(|folder| folder.join("formats")).filter(|folder| folder.is_dir()) else {
        return eprintln!("skipped: the real data have no folder \"formats\"");
    };
    let near = |a: &Point, b: &Point| (0..3).all(|axis| (a[axis] - b[axis]).abs() <= 1e-9 * (1.0 + b[axis].abs()));
    for name in [
        "A4",
        "A4_moved",
        "A_B",
        "A_moved_B",
        "bunnyDouble",
        "bunnyFloat",
        "bunnyInt19",
        "bunnyInt24",
        "cartesian_invalid_state_single",
        "ColouredCubeDouble",
        "float_intensity_without_min_max",
        "integer_intensity",
        "las2e57_no_images_tag",
        "pumpAVisualReferenceImage",
        "read_error",
        "tiny_pc_and_images",
        "tiny_pc_with_extension",
        "tiny_spherical",
        "tinyCartesianFloatRgb",
        "translationWithoutRotation",
        "../made/pump_three_stations_poses",
    ] {
        let path = folder.join("e57").join(format!("{name}.e57"));
        let (found, _) = read_one(&path).unwrap_or_else(|error| panic!("{error}"));
        let expected = by_the_crate(&path);
        assert_eq!(found.len(), expected.len(), "{name}");
        assert!(!found.is_empty() && found.iter().zip(&expected).all(|(a, b)| near(a, b)), "{name}");
    }
    // Kept points, and records without a return.
    for (name, kept, absent) in [
        ("e57/empty.e57", 0, 0),
        ("e57/ZeroPoints.e57", 0, 0),
        ("e57/ZeroPointsInvalid.e57", 0, 0),
        ("e57/InvalidCVHeader.e57", 0, 0),
        ("pcd/autzen-utm.pcd", 1065, 0),
        ("pcd/brisk_keypoints_gt.pcd", 1860, 0),
        ("pcd/bun0.pcd", 397, 0),
        ("pcd/bun4.pcd", 361, 0),
        ("pcd/capture0001.pcd", 249_647, 57_553),
        ("pcd/car6.pcd", 10_031, 0),
        ("pcd/colored_cloud.pcd", 1000, 0),
        ("pcd/fragment.pcd", 113_662, 0),
        ("pcd/gauss_smooth.pcd", 65_536, 0),
        ("pcd/ism_train.pcd", 3400, 0),
        ("pcd/lamppost.pcd", 1771, 0),
        ("pcd/milk_color.pcd", 13_704, 0),
        ("pcd/min_cut_segmentation_tutorial.pcd", 9311, 0),
        ("pcd/object_template_0.pcd", 1397, 0),
        ("pcd/octants.pcd", 8, 0),
        ("pcd/office1.pcd", 254_456, 52_744),
        ("pcd/office1_keypoints.pcd", 1318, 0),
        ("pcd/samp11-utm.pcd", 38_010, 0),
        ("pcd/table_scene_mug_stereo_textured.pcd", 209_280, 97_920),
        ("pcd/tiny.pcd", 4, 0),
        ("pcd/utm17_comma.pcd", 10, 0),
        ("pcd/utm17_space.pcd", 10, 0),
        ("pcd/Zaghetto.pcd", 59_750, 0),
        ("ply/fragment_002.ply", 112_698, 0),
        ("ply/issue_2421.ply", 1, 0),
        ("ply/ply_empty_bin.ply", 0, 0),
        ("ply/points_ascii.ply", 5, 0),
        ("ply/points_ascii_with_lists.ply", 5, 0),
        ("ply/points_bin.ply", 5, 0),
        ("ply/points_emptyface.ply", 1024, 0),
        ("ply/ripple_ascii.ply", 10_201, 0),
        ("ply/simple_binary.ply", 3, 0),
        ("ply/simple_text.ply", 3, 0),
        ("ply/slac_fragment_000.ply", 5028, 0),
        ("ply/text_extradim.ply", 1, 0),
        ("ply/tiny.ply", 10, 0),
        ("ptx/1.2-with-color.ptx", 1065, 0),
        ("ptx/complex-transform.ptx", 4, 8),
        ("ptx/multiple-and-transform.ptx", 8, 0),
        ("pts/autzen.pts", 10, 0),
        ("pts/bunny_8.pts", 9, 0),
        ("pts/bunnyData.pts", 30_571, 0),
        ("pts/point_cloud_sample1.pts", 10, 0),
        ("pts/test.pts", 19, 0),
        ("pts/tiny.pts", 3, 0),
        ("text/autzen-bmx-cc.txt", 103, 0),
        ("text/crlf_test.txt", 10, 0),
        ("text/diamond.xyz", 6, 0),
        ("text/gdal-data.xyz", 400, 0),
        ("text/missingheader.txt", 5, 0),
        ("text/numeric_dim.txt", 5, 0),
        ("text/pc-05-plane-gap.csv", 10_544, 0),
        ("text/pc-16-estonia-boreal.csv", 95_005, 0),
        ("text/points_agisoft.xyz", 100, 0),
        ("text/points_cloudcompare.xyz", 101, 0),
        ("text/quoted.txt", 9, 0),
        ("text/utm17_1.txt", 10, 0),
        ("text/utm17_2.txt", 10, 0),
    ] {
        let (found, counts) = read_one(&folder.join(name)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((found.len(), counts.withheld), (kept, absent), "{name}");
    }
    for (name, words) in [
        ("e57/corrupt_crc.e57", "checksum"),
        ("e57/InvalidFileLength.e57", "states 2048 bytes, the file has 120"),
        // The crate and libE57Format refuse it as well.
        ("e57/synthetic-normals.e57", "whose length divides by 4, found type 1 and 213 bytes"),
        ("pcd/missingheader.pcd", "PCD header"),
        ("pcd/stereo_left.pcd", "expected the fields x, y and z, found \"rgba\""),
        ("ply/no_vertex.ply", "no element \"vertex\""),
        ("ply/ply_empty_header.ply", "no element \"vertex\""),
        ("ptx/ripple.ptx", "states 44502216 points, 10201 lines follow"),
        ("text/badheader.txt", "expected columns named x, y and z"),
        ("splat/engine-test.ply", "splats"),
        ("splat/guitar.compressed.ply", "splats"),
        ("splat/minimal_ascii.ply", "splats"),
        ("splat/playbot-lod5", "no scan lies in it"),
        ("splat/train-1000.ply", "splats"),
        ("splat/unitCube-ascii.ply", "splats"),
        ("splat/fourth_st.spz", "splats"),
        ("splat/massa.sog", "splats"),
        ("splat/minimal.ksplat", "splats"),
        ("splat/minimal.splat", "splats"),
        ("made/room.ply", "splats"),
        ("made/room.compressed.ply", "splats"),
    ] {
        let error = read_one(&folder.join(name)).unwrap_err().to_string();
        assert!(error.contains(words) && error.lines().count() == 1, "{name}: {error}");
    }
    // One bunny as E57 and as PTS, equal to the six digits of the latter.
    let (mut a, mut b) = (
        read_one(&folder.join("e57/bunnyInt24.e57")).unwrap().0,
        read_one(&folder.join("pts/bunnyData.pts")).unwrap().0,
    );
    let key = |p: &Point| p.map(|v| (v * 1e6).round() as i64);
    a.sort_by_key(key);
    b.sort_by_key(key);
    assert!(a.iter().map(key).eq(b.iter().map(key)));
    // The pump room was converted from this file.
    let room = read_one(&folder.join("../pump_room.laz")).unwrap().0;
    let pump = read_one(&folder.join("e57/pumpAVisualReferenceImage.e57")).unwrap().0;
    let bounds = |points: &[Point]| {
        let ends = |axis: usize| {
            points.iter().map(move |p| p[axis]).fold([f64::MAX, f64::MIN], |[a, b], v| [a.min(v), b.max(v)])
        };
        [ends(0), ends(1), ends(2)]
    };
    let (a, b) = (bounds(&room), bounds(&pump));
    let same = a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() < 0.002);
    assert!(room.len() == pump.len() && same, "{a:?} {b:?}");
}
