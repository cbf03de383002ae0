//! Statements of PLY, PCD, E57, STL and glTF about themselves are checked, sound files of every dialect are read, and
//! of damaged files the smallest unit is left out where allowed, with its points counted.

use crate::files;
use crate::reading::{self, Listener};
use crate::scans;
use crate::write;

use files::{Triangle, buffer, structure, write_glb};
use scans::{converts, refuses, sliceconv};
use slicewalk::Error;
use slicewalk_input::{InputOptions, PointCounts, Units};
use slicewalk_mesh::{MeshOptions, MeshSet};
use std::fs;
use std::path::Path;
use write::{Cloud, E57, Pcd, Ply, Point, e57, pcd, ply};

/// Returns the kept points of a file, their counts, and the warnings.
fn read_with(path: &Path, allow_incomplete: bool) -> Result<(Vec<Point>, PointCounts, String), Error> {
    let options = InputOptions { allow_incomplete, ..InputOptions::default() };
    let (found, counts, said) = reading::read(&[path.to_path_buf()], options)?;
    Ok((found, counts, said.join("\n")))
}

fn read(path: &Path) -> Result<Vec<Point>, String> {
    read_with(path, false).map(|(points, _, _)| points).map_err(|error| error.to_string())
}

/// The triangles of a file, in its own coordinates, and the warnings.
fn mesh_with(path: &Path, allow_incomplete: bool) -> Result<(Vec<Triangle>, String), String> {
    let listener = Listener::default();
    let options = MeshOptions { units: Units::Factor(1.0), allow_incomplete, ..MeshOptions::default() };
    let set = MeshSet::open(&[path.to_path_buf()], options, &listener).map_err(|error| error.to_string())?;
    let (mut feed, mut batch, mut found) = (set.feed(), Vec::new(), Vec::new());
    while feed.next(&mut batch, &listener).map_err(|error| error.to_string())? {
        found.extend_from_slice(&batch);
    }
    Ok((found, listener.said().join("\n")))
}

fn mesh(path: &Path) -> Result<Vec<Triangle>, String> {
    mesh_with(path, false).map(|(triangles, _)| triangles)
}

fn points(count: usize) -> Vec<Point> {
    (0..count).map(|n| [n as f64 * 0.5, (n % 7) as f64, (n % 3) as f64 + 0.25]).collect()
}

/// Replaces `from` by `to`.
fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let place = bytes.windows(from.len()).position(|of| of == from).unwrap();
    [&bytes[..place], to, &bytes[place + from.len()..]].concat()
}

/// Name and content of a file.
type Named = (String, Vec<u8>);

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

/// A text PLY of points with a normal, written by `row`.
fn with_normals(points: &[Point], row: impl Fn(usize, &Point) -> String) -> String {
    let rows: String = points.iter().enumerate().map(|(number, point)| row(number, point)).collect();
    let count = points.len();
    format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\n{XYZ}property float nx\nproperty float ny\nproperty float nz\n\
         end_header\n{rows}"
    )
}

#[test]
fn points_on_several_lines_are_the_points_that_a_person_sees() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let all = points(40);
    let two = with_normals(&all, |_, [x, y, z]| format!("{x} {y} {z} \n0 0 1 \n"));
    let cases = [
        ("rows", with_normals(&all, |_, [x, y, z]| format!("{x} {y} {z} 0 0 1\n"))),
        ("two lines", two.clone()),
        ("blank lines and tabs", two.replace('\n', "\r\n\r\n").replace(' ', "\t").replacen("\r\n\r\n", "\r\n", 9)),
        ("a line each", with_normals(&all, |_, [x, y, z]| format!("{x}\n{y}\n{z}\n0\n0\n1\n"))),
        (
            "now so, now so",
            with_normals(&all, |n, [x, y, z]| match n % 3 {
                0 => format!("{x} {y} {z} 0 0 1\n"),
                1 => format!("{x} {y}\n{z} 0 0\n1\n"),
                _ => format!("{x} {y} {z} 0 0\n1\n"),
            }),
        ),
        ("a mark", format!("\u{feff}{two}")),
        (
            "elements around",
            two.replacen("element vertex", "element grid 2\nproperty list uchar int n\nelement vertex", 1).replacen(
                "end_header\n",
                "element tail 1\nproperty int a\nproperty int b\nend_header\n3 1\n2 3\n0\n",
                1,
            ) + "7\n8\n",
        ),
    ];
    for (name, text) in cases {
        fs::write(&path, text.replace("\t\r\n", "\r\n")).unwrap();
        let header_lines = text.replace('\t', " ");
        if name.contains("tabs") {
            // Any kind of blank separates words of a header.
            assert!(header_lines.contains("element vertex 40"));
        }
        assert_eq!(read(&path).as_ref(), Ok(&all), "{name}");
    }
}

#[test]
fn rows_and_counts_other_than_stated_are_refused_and_the_others_kept_where_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let all = points(300);
    let row = |[x, y, z]: &Point| format!("{x} {y} {z} 0 0 1\n");
    let with = |number: usize, other: &str| with_normals(&all, |n, p| if n == number { other.into() } else { row(p) });
    let pcd_text = String::from_utf8(pcd(&all, Pcd::Text)).unwrap();
    let little = ply(&all, Ply::Little);
    let more = |name: &str, bytes: Vec<u8>, extra: &[u8]| (name.to_owned(), [&bytes[..], extra].concat());
    let binary = pcd(&all, Pcd::Binary);
    // File, message, points left, points missing.
    let cases: [(Named, &str, usize, u64); 15] = [
        (("a.ply".into(), with(9, "1 2 3 0 0\n").into()), "line 20: expected 6 values, found 5", 299, 1),
        (("a.ply".into(), with(9, "1 2 3 0 0 1 7\n").into()), "line 20: expected 6 values, found 7", 299, 1),
        (("a.ply".into(), with(9, "1 2 three 0 0 1\n").into()), "line 20: value 3: expected a number", 299, 1),
        (("a.ply".into(), with(9, "").into()), "states 300 points, 299 lines follow", 299, 1),
        (("a.ply".into(), with(9, "1 2 3 0 0 1\n1 2 3 0 0 1\n").into()), "states 300 points, 301 lines follow", 300, 1),
        (
            (
                "a.ply".into(),
                with_normals(&all, |n, [x, y, z]| match n {
                    290.. => String::new(),
                    _ => format!("{x} {y} {z}\n0 0 1\n"),
                })
                .into(),
            ),
            "states 300 points of 6 values, 290 follow",
            290,
            10,
        ),
        (
            ("a.pcd".into(), pcd_text.replacen("\n0 1 2 3 0 ", "\n0 1 2 0 ", 1).into()),
            "expected 7 values, found 6",
            299,
            1,
        ),
        (
            more("a.pcd", pcd_text.clone().into(), b"1 1 2 3 4 5 6\n2 1 2 3 4 5 6\n"),
            "states 300 points, 302 lines follow",
            300,
            2,
        ),
        (
            ("a.pcd".into(), pcd_text.replacen("WIDTH 300", "WIDTH 200", 1).into()),
            "states 300 points, but a width of 200 and a height of 1",
            300,
            0,
        ),
        (
            ("d.pcd".into(), replaced(&pcd(&all, Pcd::Packed), b"WIDTH 300", b"WIDTH 400")),
            "states 300 points, but a width of 400",
            300,
            0,
        ),
        (more("b.pcd", binary.clone(), &[1; 23 * 3]), "69 bytes more follow its data", 300, 3),
        (more("c.ply", little.clone(), &[1; 25 * 2]), "50 bytes more follow its data", 300, 2),
        (("c.ply".into(), little[..little.len() - 30].to_vec()), "the file holds 298 whole ones", 298, 2),
        (
            ("a.ply".into(), with(0, "1 2 3 0 0 1\n").replacen("vertex 300", "vertex 290", 1).into()),
            "states 290 points, 300 lines follow",
            290,
            10,
        ),
        (more("d.pcd", pcd(&all, Pcd::Packed), &[1; 44]), "144 bytes more follow its data", 300, 6),
    ];
    for ((name, bytes), words, left, missing) in cases {
        fs::write(at(&name), bytes).unwrap();
        let said = refuses(folder.path(), &[&name, "-o", "y.slices", "--pixel", "0.5", "--units", "m"], 1);
        assert!(said.contains(words) && said.contains("--allow-incomplete"), "{words}: {said}");
        let (found, _, said) = read_with(&at(&name), true).unwrap();
        assert!(said.contains(words) && said.contains("incomplete"), "{words}: {said}");
        assert_eq!(found.len(), left, "{words}");
        let options = ["-o", "x.slices", "--pixel", "0.5", "--units", "m", "--force", "--allow-incomplete"];
        let out = sliceconv(folder.path(), &[&[&name[..]], &options[..], &["--json"]].concat());
        let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        assert_eq!((&facts["points_missing"], &facts["complete"]), (&missing.into(), &false.into()), "{words}");
        let said = converts(folder.path(), &[&[&name[..]], &options[..]].concat());
        assert_eq!(said.contains(" could not be read\n"), missing > 0, "{words}: {said}");
    }
    // Padding is not a point.
    for (name, bytes) in [("b.pcd", &binary), ("c.ply", &little)] {
        fs::write(at(name), [&bytes[..], &[0; 500], b"\r\n"].concat()).unwrap();
        assert_eq!(read(&at(name)).as_ref().map(Vec::len), Ok(300), "{name}");
    }
    // Ambiguous files are refused, not guessed.
    for (from, to, words) in [
        ("end_header", "element vertex 1\nproperty float x\nend_header", "\"vertex\" more than once"),
        ("property float nx", "property float X", "property x more than once"),
        ("element vertex", "element nothing 3\nelement vertex", "element 1 has no properties"),
    ] {
        fs::write(at("a.ply"), with(0, "1 2 3 0 0 1\n").replacen(from, to, 1)).unwrap();
        let said = read(&at("a.ply")).unwrap_err();
        assert!(said.contains(words), "{said}");
    }
    fs::write(at("a.pcd"), pcd_text.replacen("FIELDS x _ y rgb z", "FIELDS x _ y x z", 1)).unwrap();
    assert!(read(&at("a.pcd")).unwrap_err().contains("the field x is there more than once"));
    for name in ["a.pcd", "b.pcd"] {
        let bytes = if name == "a.pcd" { pcd_text.clone().into_bytes() } else { binary.clone() };
        fs::write(at(name), [b"\xEF\xBB\xBF", &bytes[..]].concat()).unwrap();
        assert_eq!(read(&at(name)).as_ref(), Ok(&all), "{name}");
    }
    fs::write(at("c.ply"), [b"\xEF\xBB\xBF", &little[..]].concat()).unwrap();
    assert_eq!(read(&at("c.ply")).as_ref(), Ok(&all));
}

#[test]
fn every_spelling_of_no_number_is_a_point_without_a_return() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for word in
        ["nan", "-nan", "NaN", "nan(ind)", "-nan(ind)", "-nan(snan)", "1.#QNAN", "1.#QNAN0", "-1.#IND", "-1.#IND00"]
    {
        let rows = format!("1 2 3\n{word} {word} {word}\n4 5 6\n");
        fs::write(at("a.ply"), format!("ply\nformat ascii 1.0\nelement vertex 3\n{XYZ}end_header\n{rows}")).unwrap();
        let header =
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA ascii\n";
        fs::write(at("a.pcd"), format!("{header}{rows}")).unwrap();
        for name in ["a.ply", "a.pcd"] {
            let (found, counts, _) = read_with(&at(name), false).unwrap();
            assert_eq!((found.len(), counts.withheld), (2, 1), "{name}: {word}");
        }
    }
}

#[test]
fn packed_columns_in_any_order_are_those_of_a_binary_file() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let all = points(20_000);
    fs::write(at("a.pcd"), pcd(&all, Pcd::Binary)).unwrap();
    let packed = pcd(&all, Pcd::Packed);
    fs::write(at("b.pcd"), &packed).unwrap();
    assert_eq!(read(&at("b.pcd")), read(&at("a.pcd")));
    // Fields named in another order: x and z change places, while their bytes stay in order.
    let place = packed.windows(18).position(|bytes| bytes == b"FIELDS x _ y rgb z").unwrap();
    let mut turned = packed.clone();
    turned[place..place + 18].copy_from_slice(b"FIELDS z _ y rgb x");
    fs::write(at("b.pcd"), &turned).unwrap();
    let expected: Vec<Point> = all.iter().map(|&[x, y, z]| [z, y, x]).collect();
    assert_eq!(read(&at("b.pcd")), Ok(expected));
    // The compressed data hold less, or more, than they should.
    let start = packed.windows(17).position(|bytes| bytes == b"binary_compressed").unwrap() + 18;
    let size = |at: usize| u32::from_le_bytes(packed[at..at + 4].try_into().unwrap());
    for by in [-40i64, 3] {
        let mut other = packed.clone();
        other[start..start + 4].copy_from_slice(&((i64::from(size(start)) + by) as u32).to_le_bytes());
        fs::write(at("b.pcd"), &other).unwrap();
        assert!(
            read(&at("b.pcd")).unwrap_err().contains(if by > 0 { "LZF" } else { "bytes more follow its data" }),
            "{by}"
        );
    }
}

#[test]
fn a_cloud_that_cannot_be_read_does_not_take_the_others_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let all = points(900);
    let cloud = |points, posed| Cloud { points, form: E57::Double, posed, mixed: false };
    e57(&at("a.e57"), &[cloud(&all[..500], false), cloud(&all[500..600], true), cloud(&all[600..], false)], None);
    let good = fs::read(at("a.e57")).unwrap();
    let content: Vec<u8> = good.chunks(1024).flat_map(|page| &page[..1020]).copied().collect();
    // In the last `times` places of the XML.
    let with = |content: &[u8], from: &str, to: &str, times: usize| {
        let mut other = content.to_vec();
        for _ in 0..times {
            let place = other.windows(from.len()).rposition(|bytes| bytes == from.as_bytes()).unwrap();
            other[place..place + from.len()].copy_from_slice(to.as_bytes());
        }
        let page = |page: &[u8]| [page, &crc32c::crc32c(page).to_be_bytes()].concat();
        fs::write(at("b.e57"), other.chunks(1020).flat_map(page).collect::<Vec<_>>()).unwrap();
    };
    // The only pose is that of the second cloud; otherwise, the last occurrence of a word is in the last cloud.
    let cases = [
        ("<z type=\"Float\">1</z>", "<z type=\"Float\">x</z>", "expected a finite number in z", 1, 800, 100),
        ("cartesianX", "cartesianU", "neither cartesian nor spherical", 2, 600, 300),
        ("recordCount=\"300\"", "recordCount=\"900\"", "its packets hold 300 whole ones", 1, 900, 600),
        ("recordCount=\"300\"", "recordCount=\"299\"", "it states 299 points, its packets hold 300 whole", 1, 899, 1),
        ("recordCount=\"300\"", "recordCount=\"000\"", "it states 0 points, its packets hold 300 whole", 1, 600, 300),
    ];
    for (from, to, words, times, left, missing) in cases {
        with(&content, from, to, times);
        let said = refuses(folder.path(), &["b.e57", "-o", "y.slices", "--pixel", "0.5"], 1);
        assert!(said.contains(words) && said.contains("--allow-incomplete"), "{said}");
        let (found, _, said) = read_with(&at("b.e57"), true).unwrap();
        assert!(found.len() == left && said.contains(words), "{} {said}", found.len());
        let options = ["b.e57", "-o", "x.slices", "--pixel", "0.5", "--force", "--allow-incomplete", "--json"];
        let facts: serde_json::Value = serde_json::from_slice(&sliceconv(folder.path(), &options).stdout).unwrap();
        assert_eq!((&facts["points_missing"], &facts["complete"]), (&missing.into(), &false.into()));
    }
    // Zeros mean no rotation: the points of the second cloud are only moved.
    with(&content, "<z type=\"Float\">1</z>", "<z type=\"Float\">0</z>", 1);
    let found = read(&at("b.e57")).unwrap();
    let expected: Vec<Point> = all[500..600].iter().map(|[x, y, z]| [4.0 - x, -8.0 - y, *z]).collect();
    assert_eq!((&found[..500], &found[500..600], &found[600..]), (&all[..500], &expected[..], &all[600..]));
    // If no points are left, nothing is converted.
    e57(&at("a.e57"), &[cloud(&all, false)], None);
    let whole = fs::read(at("a.e57")).unwrap();
    let content: Vec<u8> = whole.chunks(1024).flat_map(|page| &page[..1020]).copied().collect();
    // Lengths that a file states must be those that it has.
    let long = |at: usize| u64::from_le_bytes(content[at..at + 8].try_into().unwrap());
    for (place, value, words) in [
        (16, long(16) - 1024, "bytes, the file has"),
        (56, 32, "its section states 32 bytes, expected more than"),
        (56, long(56) - 4, "its section should end at byte"),
        (56, long(56) + 64, "its section should end at byte"),
    ] {
        let mut other = content.clone();
        other[place..place + 8].copy_from_slice(&u64::to_le_bytes(value));
        with(&other, "cartesianX", "cartesianX", 1);
        let said = refuses(folder.path(), &["b.e57", "-o", "y.slices", "--pixel", "0.5"], 1);
        assert!(said.contains(words) && said.contains("--allow-incomplete"), "{said}");
        let (found, _, said) = read_with(&at("b.e57"), true).unwrap();
        assert!(found == all && said.contains(words), "{} {said}", found.len());
    }
    with(&content, "cartesianX", "cartesianU", 2);
    assert!(read_with(&at("b.e57"), true).unwrap_err().to_string().contains("neither cartesian"));
}

/// Two steps of a stair, and their triangles.
const CORNERS: [[f64; 3]; 6] =
    [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [2.0, 2.0, 0.0], [0.0, 2.0, 1.0], [2.0, 2.0, 1.0]];

fn of(numbers: &[[usize; 3]]) -> Vec<Triangle> {
    numbers.iter().map(|corners| corners.map(|number| CORNERS[number])).collect()
}

/// A PLY of these corners and elements, in text or binary of either byte order; lists are `list COUNT NUMBER`.
fn ply_of(form: Ply, elements: &[(&str, &str, &str, &[&[i64]])]) -> Vec<u8> {
    let name = match form {
        Ply::Text => "ascii",
        Ply::Little => "binary_little_endian",
        Ply::Big => "binary_big_endian",
    };
    let headers: String = elements
        .iter()
        .map(|(name, count, number, lists)| {
            format!("element {name} {}\nproperty list {count} {number} vertex_indices\n", lists.len())
        })
        .collect();
    let mut bytes = format!("ply\nformat {name} 1.0\nelement vertex 6\n{XYZ}{headers}end_header\n").into_bytes();
    let number = |kind: &str, value: i64| {
        let (mut bytes, len) = (
            value.to_le_bytes().to_vec(),
            match kind {
                "uchar" => 1,
                "short" => 2,
                _ => 4,
            },
        );
        bytes.truncate(len);
        if form == Ply::Big {
            bytes.reverse();
        }
        bytes
    };
    for corner in CORNERS {
        match form {
            Ply::Text => bytes.extend(corner.map(|v| format!("{v} ")).concat().bytes().chain([b'\n'])),
            _ => corner.iter().for_each(|v| {
                let bits = (*v as f32).to_bits();
                bytes.extend(if form == Ply::Big { bits.to_be_bytes() } else { bits.to_le_bytes() });
            }),
        }
    }
    for (_, count, kind, lists) in elements {
        for list in *lists {
            match form {
                Ply::Text => {
                    let words: String = list.iter().map(|v| format!(" {v}")).collect();
                    bytes.extend(format!("{}{words}\n", list.len()).bytes());
                }
                _ => {
                    bytes.extend(number(count, list.len() as i64));
                    list.iter().for_each(|&v| bytes.extend(number(kind, v)));
                }
            }
        }
    }
    bytes
}

#[test]
fn all_faces_and_strips_of_a_ply_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let floor: &[&[i64]] = &[&[0, 1, 3], &[0, 3, 2]];
    let riser: &[&[i64]] = &[&[2, 3, 5], &[2, 5, 4]];
    let expected = of(&[[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]]);
    let strips = of(&[[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5]]);
    for form in [Ply::Text, Ply::Little, Ply::Big] {
        let check = |elements: &[(&str, &str, &str, &[&[i64]])], expected: &[Triangle]| {
            fs::write(&path, ply_of(form, elements)).unwrap();
            assert_eq!(mesh(&path).as_deref(), Ok(expected), "{form:?} {elements:?}");
        };
        check(&[("face", "uchar", "int", floor), ("face", "uchar", "short", riser)], &expected);
        check(
            &[
                ("face", "uchar", "int", floor),
                ("camera", "int", "int", &[&[9, 9], &[]]),
                ("face", "int", "uint", riser),
            ],
            &expected,
        );
        check(&[("tristrips", "int", "int", &[&[0, 1, 2, 3, 4, 5]])], &strips);
        check(&[("tristrips", "int", "short", &[&[0, 1, 2, 3, -1, 2, 3, 4, 5, -1]])], &strips);
        check(&[("tristrips", "uchar", "uint", &[&[0, 1, 2, 3, 4_294_967_295], &[2, 3, 4, 5]])], &strips);
        // Joined by corners that are named twice.
        check(&[("tristrips", "int", "int", &[&[0, 1, 2, 3, 3, 2, 2, 3, 4, 5]])], &strips);
        let both = [expected[..2].to_vec(), of(&[[2, 3, 4], [3, 4, 5]])].concat();
        check(&[("face", "uchar", "int", floor), ("tristrips", "int", "int", &[&[2, 3, 4, 5]])], &both);
        let both = [of(&[[2, 3, 4], [3, 4, 5]]), expected[..2].to_vec()].concat();
        check(&[("tristrips", "int", "int", &[&[2, 3, 4, 5]]), ("face", "uchar", "int", floor)], &both);
        // One missing corner breaks two triangles of a strip of four, and counts as one fault.
        fs::write(&path, ply_of(form, &[("tristrips", "int", "int", &[&[0, 1, 2, 3, 9, 2, 3, 4, 5]])])).unwrap();
        assert!(mesh(&path).unwrap_err().contains("there is no corner 9"));
        assert_eq!(mesh_with(&path, true).unwrap().0, strips);
    }
    // A strip of more triangles than are read at a time, and of more numbers than a face's list may have.
    let long: Vec<i64> = (0..100_000).map(|n| n % 6).collect();
    fs::write(&path, ply_of(Ply::Little, &[("tristrips", "int", "int", &[&long])])).unwrap();
    assert_eq!(mesh(&path).unwrap().len(), 99_998);
}

#[test]
fn ends_of_meshes_are_where_their_counts_say() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let floor: &[&[i64]] = &[&[0, 1, 3], &[0, 3, 2]];
    let faces: &[(&str, &str, &str, &[&[i64]])] = &[("face", "uchar", "int", floor)];
    let text = String::from_utf8(ply_of(Ply::Text, faces)).unwrap();
    let little = ply_of(Ply::Little, faces);
    let mut stl = vec![b' '; 80];
    stl.extend(1u32.to_le_bytes());
    stl.extend([0; 12]);
    [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().for_each(|v| stl.extend(v.to_le_bytes()));
    stl.extend([0; 2]);
    for (name, bytes, words, left) in [
        ("a.ply", format!("{text}3 1 2 3\n").into_bytes(), "line 18: more lines follow", 2),
        ("a.ply", [&little[..], &[3, 1, 0, 0, 0, 2, 0]].concat(), "more bytes follow", 2),
        (
            "a.ply",
            text.replacen("3 0 1 3\n", "3 0 1\n", 1).into_bytes(),
            "line 17: expected the end of the line behind the element that begins in line 16, found \"0\"",
            0,
        ),
        (
            "a.ply",
            text.replacen("3 0 1 3\n", "3 0 1 3 2\n", 1).into_bytes(),
            "line 16: expected the end of the line",
            1,
        ),
        (
            "a.ply",
            text.replacen("3 0 1 3\n", "3 0 one 3\n", 1).into_bytes(),
            "line 16: expected a number, found \"one\"",
            1,
        ),
        ("a.ply", text.replacen("3 0 1 3\n", "2.5 0 1 3\n", 1).into_bytes(), "a list of 2.5 numbers", 1),
        ("a.stl", [&stl[..], &stl[84..]].concat(), "it states 1 triangle of 50 bytes, and more bytes follow", 1),
    ] {
        fs::write(at(name), bytes).unwrap();
        let said = mesh(&at(name)).unwrap_err();
        assert!(said.contains(words), "{said}");
        match mesh_with(&at(name), true) {
            Ok((found, said)) => {
                assert!(found.len() == left && said.contains(words), "{words}: {} {said}", found.len())
            }
            Err(said) => assert!(left == 0 && said.contains(words), "{said}"),
        }
    }
    for (name, bytes) in [("a.ply", &little), ("a.stl", &stl)] {
        fs::write(at(name), [&bytes[..], &[0; 99], b"\n"].concat()).unwrap();
        assert!(mesh(&at(name)).is_ok(), "{name}");
    }
    // Elements on several lines, with empty lines in between.
    let (head, body) = text.split_once("end_header\n").unwrap();
    fs::write(at("a.ply"), format!("{head}end_header\n{}", body.replace(' ', "\n"))).unwrap();
    assert_eq!(mesh(&at("a.ply")), Ok(of(&[[0, 1, 3], [0, 3, 2]])));
}

#[test]
fn text_stl_is_text_in_any_case_and_with_any_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.stl");
    let good = "solid a\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1e0 0 0\n   vertex 0 1 0\n  endloop\n \
                endfacet\nendsolid a\n";
    let expected = vec![[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]];
    let latin: Vec<u8> =
        good.replacen("solid a", "solid K?rper", 1).bytes().map(|b| if b == b'?' { 0xF6 } else { b }).collect();
    for bytes in [
        good.into(),
        good.to_uppercase().into_bytes(),
        good.replace("vertex", "Vertex").replace("solid", "Solid").into_bytes(),
        good.replace("solid a", "solid Körper_1 Gehäuse").into_bytes(),
        good.replace("solid a", "solid 部品").into_bytes(),
        latin,
        good.replace('\n', "\r\n").into_bytes(),
        format!("\n\t  {good}").into_bytes(),
        format!("\u{feff}{}", good.to_uppercase()).into_bytes(),
    ] {
        fs::write(&path, &bytes).unwrap();
        assert_eq!(mesh(&path).as_ref(), Ok(&expected), "{}", String::from_utf8_lossy(&bytes));
    }
    // A cut binary file whose title looks like text: its count is not text.
    let mut binary = b"SOLID no text".to_vec();
    binary.resize(80, b' ');
    binary.extend(2u32.to_le_bytes());
    binary.extend([0; 70]);
    fs::write(&path, binary).unwrap();
    assert!(mesh(&path).unwrap_err().contains("states 2 triangles of 50 bytes"));
}

#[test]
fn lines_of_obj_and_ply_may_end_with_returns() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let triangles = Ok(vec![[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]);
    let obj = "# a\nv 0 0 0\nv 1 0 0\n\nv 0 1 0 \\\n 1\nf 1 2 3\n";
    let head =
        |format: &str, faces: &str| format!("ply\nformat {format} 1.0\nelement vertex 3\n{XYZ}{faces}end_header\n");
    let faces = "element face 1\nproperty list uchar int vertex_indices\n";
    let corners = "0 0 0\n1 0 0\n0 1 0\n";
    for end in ["\r", "\r\n", "\n"] {
        let put = |name: &str, text: &str, binary: &[u8]| {
            fs::write(at(name), [text.replace('\n', end).as_bytes(), binary].concat()).unwrap();
        };
        put("a.obj", obj, &[]);
        assert_eq!(mesh(&at("a.obj")), triangles, "{end:?}");
        put("a.ply", &(head("ascii", faces) + corners + "3 0 1 2\n"), &[]);
        assert_eq!(mesh(&at("a.ply")), triangles, "{end:?}");
        put("b.ply", &(head("ascii", "") + corners), &[]);
        assert_eq!(read(&at("b.ply")).unwrap()[1], [1.0, 0.0, 0.0], "{end:?}");
        // The first byte of the body is that of a line feed.
        let x = f32::from_le_bytes([b'\n', 0, 0, 0x40]);
        let bytes: Vec<u8> = [x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        put("b.ply", &head("binary_little_endian", ""), &bytes);
        assert_eq!(read(&at("b.ply")).unwrap()[0], [x.into(), 0.0, 0.0], "{end:?}");
        put(
            "a.ply",
            &head("binary_little_endian", faces),
            &[&bytes[..], &[3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]].concat(),
        );
        assert_eq!(mesh(&at("a.ply")).unwrap()[0][0], [x.into(), 0.0, 0.0], "{end:?}");
    }
}

#[test]
fn no_corner_of_an_obj_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    let good = "o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let of = |line: &str| good.replacen("v 1 0 0", line, 1);
    let keywords =
        "vn 0 0 1\nvt 0 0\nvp 1\ng a b\ns off\nusemtl a\nbevel on\nd_interp off\nlod 3\nl 1 2\np 1\n#v 4 5\n \t\n";
    for text in [of("v 1 0 0 1"), of("v 1 0 0 0.5 0.5 1"), of("v 1 0 0 1 255 0 9 # v"), format!("{keywords}{good}")] {
        fs::write(&path, &text).unwrap();
        assert_eq!(mesh(&path), Ok(vec![[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]), "{text}");
    }
    for (line, words) in [
        ("v 1 0 0 v 4 5 6", "line 3: expected a number, found \"v\""),
        ("v 1 0 0 foo", "line 3: expected a number, found \"foo\""),
        ("v 1 0 0 4 5", "line 3: expected 3, 4, 6 or 7 numbers of a corner, found 5"),
        ("v 1 0", "line 3: expected a number, found the end of the line"),
        ("w 1 0 0", "line 3: expected a keyword of OBJ, such as v or f, found \"w\""),
        ("V 1 0 0", "line 3: expected a keyword of OBJ, such as v or f, found \"V\""),
        ("call other.obj", "line 3: it reads in another file, whose corners count here"),
    ] {
        fs::write(&path, of(line)).unwrap();
        for allow_incomplete in [false, true] {
            let said = mesh_with(&path, allow_incomplete).unwrap_err();
            assert!(said.contains(words), "{words}: {said}");
        }
    }
}

#[test]
fn text_stl_is_words_whatever_separates_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.stl");
    let facet = |x: usize| {
        format!(
            "facet normal 0 0 1\nouter loop\nvertex {x} 0 0\nvertex {} 0 0\nvertex {x} 1 0\nendloop\nendfacet\n",
            x + 1
        )
    };
    let triangle = |x: f64| [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0]];
    let flat = |text: String| text.replace('\n', " ");
    let good = format!("solid a\n{}{}endsolid a\n", facet(0), facet(1));
    for text in [
        good.replace('\n', "\r"),
        good.replace('\n', "\r\n"),
        good.replace('\n', "\n\n").replace(' ', " \t "),
        flat(good.clone()),
        good.trim_end().into(),
        format!("solid {}{}endsolid", flat(facet(0)), flat(facet(1))),
        format!("solid a facet {}\n{}endsolid a", flat(facet(0)), facet(1)),
        format!("solid a\n{}{}\nendsolid a", facet(0), flat(facet(1))),
        format!("solid a\n{}{}endsolid a", facet(0), flat(facet(1))),
        // The names of solids end with their lines, and may hold keywords.
        format!("solid solid facet\n{}endsolid my solid\nsolid vertex 1 2\n{}endsolid facet", facet(0), facet(1)),
        format!("solid a {}endsolid a solid b {}endsolid b", flat(facet(0)), flat(facet(1))),
        format!("solid a endsolid a\nsolid b\n{}{}endsolid b", facet(0), facet(1)),
        good.replace("normal 0 0 1", "normal nan -nan(ind) 0,5").replacen("normal nan -nan(ind) 0,5", "", 1),
    ] {
        fs::write(&path, &text).unwrap();
        assert_eq!(mesh(&path), Ok(vec![triangle(0.0), triangle(1.0)]), "{text}");
    }
    for (text, words) in [
        (good.replace("1 1 0\n", "1 1 0 7\n"), "line 13: expected a keyword of STL, found \"7\""),
        (good.replace("2 0 0\n", "2 0\n"), "line 13: expected a number, found \"vertex\""),
        (good.replace("0 0 1", "0 0 1 0"), "line 2: expected a keyword of STL, found \"0\""),
        (good.replacen("endloop\n", "", 1), "line 7: a loop ends without \"endloop\""),
        (good.replace("endsolid a\n", ""), "ends before \"endsolid\""),
        (good[..good.rfind(" 1 0\n").unwrap() + 2].into(), "line 13: the file ends before \"endsolid\""),
        (flat(good[..good.len() - 12].into()), "ends before \"endsolid\""),
        (format!("{good}{}", facet(2)), "ends before \"endsolid\""),
    ] {
        fs::write(&path, &text).unwrap();
        let said = mesh(&path).unwrap_err();
        assert!(said.contains(words), "{words}: {said}");
    }
}

/// A structure with this in place of its first accessor, and with these extensions.
fn gltf(accessor: &str, views: &str, bytes: usize, node: &str, extensions: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0{node}}}],{extensions}
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"accessors":[{accessor}],
        "bufferViews":[{views}],"buffers":[{{"byteLength":{bytes}}}]}}"#
    )
}

#[test]
fn extensions_of_gltf_that_move_nothing_are_no_hindrance_and_others_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let triangle = [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]];
    let expected = vec![[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]];
    let plain = structure(3, "", r#"[{"mesh":0}]"#, "[0]");
    let with = |key: &str, name: &str| plain.replacen('{', &format!("{{\"{key}\":[\"{name}\"],"), 1);
    for name in [
        "KHR_materials_unlit",
        "KHR_materials_specular",
        "KHR_texture_basisu",
        "KHR_texture_transform",
        "EXT_texture_webp",
        "KHR_lights_punctual",
        "KHR_xmp_json_ld",
        "KHR_animation_pointer",
        "KHR_mesh_quantization",
    ] {
        write_glb(&path, &with("extensionsRequired", name), &buffer(&triangle));
        assert_eq!(mesh(&path).as_ref(), Ok(&expected), "{name}");
    }
    for (key, name) in [
        ("extensionsRequired", "KHR_draco_mesh_compression"),
        ("extensionsRequired", "EXT_meshopt_compression"),
        ("extensionsRequired", "KHR_materials"),
        ("extensionsRequired", "ACME_moves_corners"),
        ("extensionsUsed", "CESIUM_RTC"),
    ] {
        write_glb(&path, &with(key, name), &buffer(&triangle));
        let said = mesh(&path).unwrap_err();
        assert!(said.contains(name) && said.contains("export the file without it"), "{said}");
    }
    write_glb(&path, &with("extensionsUsed", "ACME_looks"), &buffer(&triangle));
    assert!(mesh(&path).is_ok());
    // Compressed parts of a file that does not require the extension, with and without plain values beside them.
    let draco = r#""attributes":{"POSITION":0},"extensions":{"KHR_draco_mesh_compression":{"bufferView":0}}"#;
    let draco = plain.replacen(r#""attributes":{"POSITION":0}"#, draco, 1);
    write_glb(&path, &draco, &buffer(&triangle));
    assert!(mesh(&path).is_ok());
    write_glb(&path, &draco.replacen(r#""bufferView":0,"componentType""#, r#""componentType""#, 1), &buffer(&triangle));
    assert!(mesh(&path).unwrap_err().contains("KHR_draco_mesh_compression"));
    let meshopt = plain.replacen(
        r#""buffers":["#,
        r#""buffers":[{"byteLength":36},{"byteLength":36,"extensions":{"EXT_meshopt_compression":{"fallback":true}}},"#,
        1,
    );
    write_glb(&path, &meshopt, &buffer(&triangle));
    assert!(mesh(&path).unwrap_err().contains("EXT_meshopt_compression"));
    // Only the first buffer may be the binary part of the file.
    write_glb(&path, &plain.replacen(r#""buffers":["#, r#""buffers":[{"byteLength":36},"#, 1), &buffer(&triangle));
    assert!(mesh(&path).unwrap_err().contains("buffer 1"));
}

#[test]
fn lengths_and_matrices_of_gltf_must_agree_with_themselves() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let values = buffer(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]]);
    let accessor = r#"{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}"#;
    let glb = |view: usize, buffer: usize, node: &str, padding: usize| {
        let view = format!(r#"{{"buffer":0,"byteLength":{view}}}"#);
        write_glb(&path, &gltf(accessor, &view, buffer, node, ""), &[&values[..], &vec![0; padding]].concat());
        fs::read(&path).unwrap()
    };
    let good = glb(36, 36, "", 0);
    let stating = |more: i32| {
        let whole = (good.len() as i32 + more).to_le_bytes();
        [&good[..8], &whole, &good[12..]].concat()
    };
    let matrix = |last: &str| glb(36, 36, &format!(r#","matrix":[1,0,0,0,0,1,0,0,0,0,1,0,{last}]"#), 0);
    for bytes in [good.clone(), glb(36, 36, "", 3), [&good[..], &[0; 9]].concat(), matrix("0,0,0,1")] {
        fs::write(&path, bytes).unwrap();
        assert_eq!(mesh(&path), Ok(vec![[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]]));
    }
    for (bytes, words) in [
        (glb(36, 20, "", 0), "buffer 0: it states 20 bytes, and the binary part of the file that holds it states 36"),
        (glb(40, 36, "", 3), "accessor 0: its view 0 reaches to byte 40 of buffer 0, which states 36 bytes"),
        (glb(36, 36, "", 4), "buffer 0: it states 36 bytes"),
        (stating(-4), "and its binary part reaches to byte"),
        (stating(4), "it is cut or damaged"),
        ([&good[..], b"more"].concat(), "bytes, and 4 bytes follow"),
        (matrix("10,20,30,2"), "node 0: expected a matrix with the last row 0 0 0 1, found 0 0 0 2"),
        (matrix("10,20,30,0"), "node 0: expected a matrix with the last row 0 0 0 1, found 0 0 0 0"),
        (
            glb(36, 36, r#","matrix":[1,0,0,10,0,1,0,20,0,0,1,30,0,0,0,1]"#, 0),
            "expected a matrix with the last row 0 0 0 1, found 10 20 30 1; write it column by column",
        ),
    ] {
        fs::write(&path, bytes).unwrap();
        let said = mesh(&path).unwrap_err();
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn nodes_of_gltf_far_from_the_origin_are_not_rounded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let corners = buffer(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]]);
    for node in [
        r#"[{"mesh":0,"translation":[389100.4,112.35,-5711234.7]}]"#,
        r#"[{"mesh":0,"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,389100.4,112.35,-5711234.7,1]}]"#,
    ] {
        write_glb(&path, &structure(3, "", node, "[0]"), &corners);
        assert_eq!(mesh(&path).unwrap()[0][0], [389_100.4, 5_711_234.7, 112.35], "{node}");
    }
}

#[test]
fn quantized_sparse_and_repeated_parts_of_gltf_lie_where_they_should() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let triangle = |scale: f64| vec![[[0.0, 0.0, 0.0], [-scale, 0.0, 0.0], [0.0, 0.0, 2.0 * scale]]];
    // Corners 0, (-1, 0, 0) and (0, 2, 0) in each type, four components apart.
    for (kind, size, normalized, unit) in
        [(5120, 1, false, 1.0), (5120, 1, true, 1.0 / 127.0), (5122, 2, false, 1.0), (5122, 2, true, 1.0 / 32_767.0)]
    {
        let corners = [[0i16, 0, 0, 0], [-1, 0, 0, 0], [0, 2, 0, 0]];
        let bytes: Vec<u8> = corners.iter().flatten().flat_map(|v| v.to_le_bytes()[..size].to_vec()).collect();
        let accessor =
            format!(r#"{{"bufferView":0,"componentType":{kind},"normalized":{normalized},"count":3,"type":"VEC3"}}"#);
        let view = format!(r#"{{"buffer":0,"byteLength":{},"byteStride":{}}}"#, bytes.len(), 4 * size);
        let extension = r#""extensionsRequired":["KHR_mesh_quantization"],"#;
        write_glb(&path, &gltf(&accessor, &view, bytes.len(), "", extension), &bytes);
        assert_eq!(mesh(&path), Ok(triangle(unit)), "{kind} {normalized}");
    }
    // The least value maps to no less than -1.
    let bytes =
        [[0i8, 0, 0, 0], [-128, 0, 0, 0], [0, 127, 0, 0]].as_flattened().iter().map(|v| *v as u8).collect::<Vec<_>>();
    let accessor = r#"{"bufferView":0,"componentType":5120,"normalized":true,"count":3,"type":"VEC3"}"#;
    write_glb(&path, &gltf(accessor, r#"{"buffer":0,"byteLength":12,"byteStride":4}"#, 12, "", ""), &bytes);
    assert_eq!(mesh(&path), Ok(vec![[[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]]));
    let floats = |all: &[f32]| all.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    // Sparse: the second corner by an exception, on top of values and on top of nothing.
    let corners = [0.0, 0.0, 0.0, 9.0, 9.0, 9.0, 0.0, 2.0, 0.0];
    let mut bytes = floats(&corners);
    bytes.extend(floats(&[1.0, 0.0, 0.0, 0.0, 2.0, 0.0]));
    bytes.extend([1, 2]);
    let views = r#"{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":24},{"buffer":0,"byteOffset":60,"byteLength":2}"#;
    let expected = vec![[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]];
    for base in [r#""bufferView":0,"#, ""] {
        let sparse =
            r#""sparse":{"count":2,"indices":{"bufferView":2,"componentType":5121},"values":{"bufferView":1}}"#;
        let accessor = format!(r#"{{{base}"componentType":5126,"count":3,"type":"VEC3",{sparse}}}"#);
        write_glb(&path, &gltf(&accessor, views, bytes.len(), "", ""), &bytes);
        assert_eq!(mesh(&path), Ok(expected.clone()), "{base}");
        write_glb(
            &path,
            &gltf(&accessor.replacen(r#""count":2"#, r#""count":4"#, 1), views, bytes.len(), "", ""),
            &bytes,
        );
        assert!(mesh(&path).unwrap_err().contains("accessor 0"));
    }
    // Instances give the same result as nodes with the same translations, rotations and scales.
    let places = [[10.0f32, 20.0, 30.0], [-1.0, 0.5, 0.0]];
    let (turns, sizes) = ([[0.0f32, 0.6, 0.0, 0.8], [0.0, 0.0, 0.0, 1.0]], [[1.0f32, 2.0, 3.0], [-1.0, 1.0, 1.0]]);
    let mut bytes = floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
    for values in [places.as_flattened(), turns.as_flattened(), sizes.as_flattened()] {
        bytes.extend(floats(values));
    }
    let views = r#"{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":24},
        {"buffer":0,"byteOffset":60,"byteLength":32},{"buffer":0,"byteOffset":92,"byteLength":24}"#;
    let accessors = r#"{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},{"bufferView":1,"componentType":5126,"count":2,"type":"VEC3"},
        {"bufferView":2,"componentType":5126,"count":2,"type":"VEC4"},{"bufferView":3,"componentType":5126,"count":2,"type":"VEC3"}"#;
    let node = |attributes: &str| {
        format!(
            r#","translation":[5,0,0],"scale":[1,1,-2],"extensions":{{"EXT_mesh_gpu_instancing":{{"attributes":{{{attributes}}}}}}}"#
        )
    };
    let all = node(r#""TRANSLATION":1,"ROTATION":2,"SCALE":3"#);
    let used = r#""extensionsUsed":["EXT_mesh_gpu_instancing"],"#;
    write_glb(&path, &gltf(accessors, views, bytes.len(), &all, used), &bytes);
    let found = mesh(&path).unwrap();
    let copy = |n: usize| {
        let list = |values: &[f32]| values.iter().map(|v| f64::from(*v).to_string()).collect::<Vec<_>>().join(",");
        let (place, turn, size) = (list(&places[n]), list(&turns[n]), list(&sizes[n]));
        format!(r#"{{"mesh":0,"translation":[{place}],"rotation":[{turn}],"scale":[{size}]}}"#)
    };
    let nodes = format!(r#"[{{"children":[1,2],"translation":[5,0,0],"scale":[1,1,-2]}},{},{}]"#, copy(0), copy(1));
    write_glb(&path, &structure(3, "", &nodes, "[0]"), &bytes[..36]);
    let expected = mesh(&path).unwrap();
    assert_eq!((found.len(), &found), (2, &expected));
    // More translations than rotations or fewer, and an index that refers to nothing.
    for (attributes, words) in
        [(r#""TRANSLATION":1,"SCALE":0"#, "differ in number"), (r#""TRANSLATION":9"#, "accessor 9")]
    {
        write_glb(&path, &gltf(accessors, views, bytes.len(), &node(attributes), ""), &bytes);
        assert!(mesh(&path).unwrap_err().contains(words));
    }
    // Negative scales, and strips, fans and gaps between corners, are read as they are.
    let plain = structure(3, "", r#"[{"mesh":0,"scale":[-1,1,1]}]"#, "[0]");
    for mode in [5, 6] {
        write_glb(
            &path,
            &plain.replacen(r#""attributes""#, &format!(r#""mode":{mode},"attributes""#), 1),
            &bytes[..36],
        );
        assert_eq!(mesh(&path), Ok(vec![[[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]]), "{mode}");
    }
    write_glb(&path, &plain.replacen(r#""attributes""#, r#""mode":7,"attributes""#, 1), &bytes[..36]);
    assert!(mesh(&path).unwrap_err().contains("the mode 7"));
}
