//! Text tables, PTS and PTX: the points are those that a person sees in the file, whatever separates columns, ends
//! lines, names columns or marks missing numbers; ambiguous content is refused in one line, or skipped row by row where
//! allowed.

use crate::reading::{self, gzip};
use crate::scans;
use crate::write;

use scans::{converts, data, refuses, sliceconv};
use slicewalk::archive::Archive;
use slicewalk::{Error, Monitor, NoMonitor};
use slicewalk_input::{InputOptions, InputSet, PointCounts, PointDecoder};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use write::{Point, pts, rows};

fn read_with(path: &Path, options: InputOptions) -> Result<(Vec<Point>, PointCounts, Vec<String>), Error> {
    reading::read(&[path.to_path_buf()], options)
}

fn read(path: &Path) -> Result<(Vec<Point>, PointCounts, Vec<String>), Error> {
    read_with(path, InputOptions::default())
}

/// Reads what is readable, as if incomplete input were allowed.
fn read_rest(path: &Path) -> (Vec<Point>, PointCounts, String) {
    let options = InputOptions { allow_incomplete: true, ..InputOptions::default() };
    let (found, counts, said) = read_with(path, options).unwrap();
    (found, counts, said.join("\n"))
}

fn points(count: usize) -> Vec<Point> {
    let number = |n: usize| (n % 997) as f64 / 8.0;
    (0..count).map(|n| [number(n * 7) + 0.5, -number(n * 11), number(n * 13) + 100.25]).collect()
}

#[test]
fn ends_of_lines_marks_and_packing_do_not_matter() {
    let folder = tempfile::tempdir().unwrap();
    let all = points(300);
    let ptx = write::ptx_of_stations(&[([0.0; 3], all.clone())]);
    let texts = [
        ("a.xyz", rows(&all, " ")),
        ("a.csv", format!("x,y,z\n{}", rows(&all, ","))),
        (
            "a.txt",
            format!("name\tx\ty\tz\n{}", rows(&all, "\t").lines().map(|row| format!("\t{row}\n")).collect::<String>()),
        ),
        ("a.xyz", format!("300\n{}", rows(&all, ";").replace('.', ","))),
        ("a.pts", pts(&[&all])),
        ("a.pts", rows(&all, " ")),
        ("a.ptx", ptx),
    ];
    for (name, text) in texts {
        let text = text.replace('\r', "");
        let mixed: String =
            (0..).zip(text.lines()).map(|(n, line)| [line, ["\n", "\r", "\r\n"][n % 3]].concat()).collect();
        let ends =
            [text.clone(), text.replace('\n', "\r\n"), text.replace('\n', "\r"), mixed, text.trim_end().to_owned()];
        for (number, text) in ends.iter().enumerate() {
            for mark in ["", "\u{feff}"] {
                let bytes = [mark, text].concat().into_bytes();
                for (ending, bytes) in
                    [("", bytes.clone()), (".gz", gzip(&bytes)), (".zst", zstd::encode_all(&bytes[..], 1).unwrap())]
                {
                    let path = folder.path().join(format!("{name}{ending}"));
                    fs::write(&path, bytes).unwrap();
                    let (found, counts, _) = read(&path).unwrap_or_else(|error| panic!("{error}"));
                    assert!(found == all, "{name}{ending}, ends {number}, mark {mark:?}: {} points", found.len());
                    assert_eq!(counts.read, 300);
                }
            }
        }
        // UTF-16 in both byte orders, with and without a mark, is recognised.
        let units = |mark: &str| [mark, &text].concat().encode_utf16().collect::<Vec<u16>>();
        for mark in ["", "\u{feff}"] {
            let little: Vec<u8> = units(mark).into_iter().flat_map(u16::to_le_bytes).collect();
            let big: Vec<u8> = units(mark).into_iter().flat_map(u16::to_be_bytes).collect();
            for bytes in [little, big] {
                for (ending, bytes) in [("", bytes.clone()), (".gz", gzip(&bytes))] {
                    let path = folder.path().join(format!("{name}{ending}"));
                    fs::write(&path, bytes).unwrap();
                    let error = read(&path).unwrap_err().to_string();
                    assert!(error.contains("UTF-16; save it as UTF-8"), "{error}");
                }
            }
        }
    }
}

#[test]
fn words_for_no_number_are_no_return_in_all_text() {
    let folder = tempfile::tempdir().unwrap();
    let words = [
        "nan",
        "NaN",
        "-nan",
        "+nan",
        "nan(ind)",
        "-nan(ind)",
        "nan(snan)",
        "1.#QNAN",
        "1.#QNAN0",
        "-1.#IND",
        "NA",
        "null",
        "NULL",
    ];
    let all = points(20);
    let with = |separator: &str, word: &str, behind: &str| {
        let mut text = String::new();
        for (number, [x, y, z]) in all.iter().enumerate() {
            if number % 10 == 3 {
                writeln!(text, "{word}{separator}{word}{separator}{word}{behind}").unwrap();
                writeln!(text, "{x}{separator}{y}{separator}{word}{behind}").unwrap();
            }
            writeln!(text, "{x}{separator}{y}{separator}{z}{behind}").unwrap();
        }
        text
    };
    let ply =
        "ply\nformat ascii 1.0\nelement vertex 24\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let pcd = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 24\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
               POINTS 24\nDATA ascii\n";
    let ptx = "24\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    let files = |word: &str| {
        [
            ("a.xyz", with(" ", word, "")),
            ("a.csv", format!("x,y,z\n{}", with(",", word, ""))),
            ("a.txt", with("\t", word, "\tmore")),
            ("b.csv", format!("x;y;z\n{}", with(";", word, "").replace('.', ","))),
            ("a.pts", format!("24\n{}", with(" ", word, " 5 1 2 3"))),
            ("a.ptx", format!("{ptx}{}", with(" ", word, " 0.5"))),
            ("a.ply", format!("{ply}{}", with(" ", word, ""))),
            ("a.pcd", format!("{pcd}{}", with(" ", word, ""))),
        ]
    };
    for word in words {
        for (name, text) in files(word) {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            let (found, counts, _) = read(&path).unwrap_or_else(|error| panic!("{word}: {error}"));
            assert!(found == all, "{name}, {word}");
            assert_eq!((counts.read, counts.withheld, counts.missing), (24, 4, 0), "{name}, {word}");
        }
    }
    // Empty cells, where separators reveal them.
    for separator in [",", ";", "\t"] {
        let path = folder.path().join("empty.csv");
        fs::write(&path, format!("{}\n{}", ["x", "y", "z"].join(separator), with(separator, "", ""))).unwrap();
        let (found, counts, _) = read(&path).unwrap_or_else(|error| panic!("{error}"));
        let blank_rows = if separator == "\t" { 2 } else { 0 };
        assert_eq!((found == all, counts.withheld), (true, 4 - blank_rows), "{separator:?}");
    }
    // Infinity is a loss, whether written as a word or as too large a number.
    for word in ["inf", "-Infinity", "1.#INF", "-1.#INF00", "1e400"] {
        let turned = ptx.replace("1 0 0 0\n0 1 0 0", "0 1 0 0\n-1 0 0 0");
        let more = [("b.ptx", format!("{turned}{}", with(" ", word, " 0.5")))];
        for (name, text) in files(word).into_iter().chain(more) {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            let error = read(&path).map(|(_, counts, _)| counts).expect_err(&format!("{name}, {word}")).to_string();
            assert!(error.contains("not finite"), "{name}, {word}: {error}");
            let (found, counts, _) = read_rest(&path);
            assert!(found == all || name == "b.ptx", "{name}, {word}");
            assert_eq!((counts.read, counts.withheld, counts.not_finite), (24, 0, 4), "{name}, {word}");
        }
    }
}

#[test]
fn one_bad_row_is_one_point_less() {
    let folder = tempfile::tempdir().unwrap();
    // More than two blocks, with bad rows in each.
    let all = points(400_000);
    let places = [2usize, 1000, 200_001, 399_000];
    let kept: Vec<Point> =
        all.iter().enumerate().filter(|(n, _)| !places.contains(n)).map(|(_, point)| *point).collect();
    let long = "7".repeat(70_000);
    let bad = |row: &str| ["1 2 x".to_owned(), "1 2".into(), format!("{row} 5 5 5 5 5"), long.clone()];
    let with_faults = |text: String, header: usize| {
        let mut at = 0;
        let rows = text.lines().enumerate().map(|(n, row)| match places.iter().position(|place| place + header == n) {
            Some(which) => {
                at += 1;
                bad(row)[which].clone() + "\n"
            }
            None => format!("{row}\n"),
        });
        let text: String = rows.collect();
        assert!(at == 4 && text.len() > 8 << 20, "{} bytes", text.len());
        text
    };
    let wide = |text: String| text.lines().map(|row| format!("{row} 123456 \n")).collect::<String>();
    let ptx = write::ptx_of_stations(&[([0.0; 3], all.clone())]);
    for (name, text, line) in [
        ("a.xyz", with_faults(wide(rows(&all, " ")), 0), 3),
        ("a.csv", with_faults(format!("x y z i\n{}", wide(rows(&all, " "))), 1), 4),
        ("a.pts", with_faults(pts(&[&all]), 1), 4),
        ("a.ptx", with_faults(ptx, 10), 13),
    ] {
        for (ending, bytes) in [("", text.clone().into_bytes()), (".gz", gzip(text.as_bytes()))] {
            let path = folder.path().join(format!("{name}{ending}"));
            fs::write(&path, bytes).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains(&format!("line {line}: expected ")) && error.contains("found \""), "{error}");
            let (found, counts, said) = read_rest(&path);
            assert!(found == kept, "{name}{ending}: {} points", found.len());
            assert_eq!((counts.missing, counts.read), (4, kept.len() as u64));
            assert!(said.contains("incomplete: 4 rows left out, the first of them: "), "{said}");
            assert!(ending == ".gz" || said.contains(&format!("line {line}: expected ")), "{said}");
        }
    }
    // The program reports it, too, and converts the rest; its summary names the columns.
    fs::write(folder.path().join("b.xyz"), "1 2 3\n4 5 six\n7 8 9\n").unwrap();
    let options = ["b.xyz", "-o", "b.slices", "--pixel", "0.5", "--units", "m"];
    let said = refuses(folder.path(), &options, 1);
    assert!(
        said.contains("b.xyz: line 2: expected a number in column 3, found \"six\"")
            && said.contains("--allow-incomplete"),
        "{said}"
    );
    let said = converts(folder.path(), &[&options[..], &["--allow-incomplete"]].concat());
    assert!(said.contains("1 row left out: line 2: expected a number in column 3, found \"six\""), "{said}");
    assert!(
        said.contains("columns of b.xyz: x is column 1, y is column 2, z is column 3, separated by blanks"),
        "{said}"
    );
    assert_eq!(said.matches("x is column").count(), 1, "{said}");
    assert_eq!(Archive::open(folder.path().join("b.slices")).unwrap().header().points_kept, 2);
    fs::write(folder.path().join("c.xyz"), "1 2 3\n4 5 6\n0 7 8 9\n").unwrap();
    let said = refuses(folder.path(), &["c.xyz", "-o", "c.slices", "--pixel", "0.5"], 1);
    assert!(
        said.contains("line 3: expected 3 columns, found 4: \"0 7 8 9\"; name the columns with --columns"),
        "{said}"
    );
}

#[test]
fn numbers_of_points_are_checked_while_rows_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let all = points(250_000);
    let long = |points: &[Point]| {
        rows(points, " ").lines().map(|row| format!("{row} 100000 120000 140000\n")).collect::<String>()
    };
    let text = long(&all);
    assert!(text.len() > 8 << 20, "one piece only");
    for (name, first, words) in [
        ("a.xyz", "250000\n", ""),
        ("a.xyz", "250001\n", "its first line states 250001 points, 250000 lines follow"),
        ("a.xyz", "# a comment\n99999999\n", "its first line states 99999999 points, 250000 lines follow"),
        ("a.pts", "250000\n", ""),
        ("a.pts", "250001\n", "cloud 1: its first line states 250001 points, 250000 lines follow"),
    ] {
        for (ending, bytes) in
            [("", format!("{first}{text}").into_bytes()), (".gz", gzip(format!("{first}{text}").as_bytes()))]
        {
            let path = at(&format!("{name}{ending}"));
            fs::write(&path, bytes).unwrap();
            match (read(&path), words) {
                (Ok((found, ..)), "") => assert!(found == all),
                (Err(error), words) => {
                    assert!(!words.is_empty() && error.to_string().contains(words), "{error}");
                    let (found, _, said) = read_rest(&path);
                    assert!(found == all && said.contains(words), "{said}");
                }
                _ => panic!("{name}, {first}"),
            }
        }
    }
    // Additional points are read, with a warning.
    for (name, text) in [("b.xyz", "2\n1 2 3\n4 5 6\n7 8 9\n"), ("b.pts", "2\n1 2 3\n4 5 6\n7 8 9\n")] {
        fs::write(at(name), text).unwrap();
        let (found, _, said) = read(&at(name)).unwrap();
        assert!(
            found.len() == 3 && said.iter().any(|said| said.contains("states 2 points, 3 lines follow; all are read"))
        );
    }
    // Clouds of a PTS across blocks.
    let (a, b) = all.split_at(130_000);
    for (first, second, words) in
        [(130_000, 120_000, ""), (130_000, 120_001, "cloud 2: "), (130_001, 120_000, "cloud 1: ")]
    {
        fs::write(at("c.pts"), format!("{first}\n{}{second}\n{}", long(a), long(b))).unwrap();
        match read(&at("c.pts")) {
            Ok((found, ..)) => assert!(words.is_empty() && found == all),
            Err(error) => assert!(!words.is_empty() && error.to_string().contains(words), "{error}"),
        }
    }
    // The rest of a cut compressed text is read; a count of 0 is ignored.
    let cut = gzip(format!("250000\n{text}").as_bytes());
    fs::write(at("cut.xyz.gz"), &cut[..cut.len() / 2]).unwrap();
    let (found, _, said) = read_rest(&at("cut.xyz.gz"));
    assert!(
        found.len() > 50_000 && said.contains("cannot be unpacked") && said.contains("states 250000 points"),
        "{said}"
    );
    fs::write(at("zero.pts"), "0\n1 2 3\n").unwrap();
    let (found, _, said) = read(&at("zero.pts")).unwrap();
    assert!(found.len() == 1 && said.iter().any(|said| said.contains("states 0 points, 1 line follows")), "{said:?}");
    fs::write(at("none.xyz"), "5\n").unwrap();
    assert!(read(&at("none.xyz")).unwrap_err().to_string().contains("states 5 points, no lines follow"));
    // A resumed run checks everything, too.
    fs::write(at("cut.pts"), format!("250001\n{text}")).unwrap();
    let options = ["cut.pts", "-o", "cut.slices", "--pixel", "0.5", "--memory", "64MiB", "--resume", "--temp-dir", "."];
    for _ in 0..2 {
        let said = refuses(folder.path(), &options, 1);
        assert!(said.contains("states 250001 points, 250000 lines follow"), "{said}");
    }
}

#[test]
fn looking_for_colours_counts_no_table_as_cut() {
    let folder = tempfile::tempdir().unwrap();
    // Three batches, of which the first shows that there are intensities.
    let rows: String = (0..140_000).map(|n| format!("{}.5 {} 1 {}\n", n % 97, n % 89, n % 200 + 1)).collect();
    let text = format!("140000\n{rows}");
    for (name, bytes) in [("a.pts", text.clone().into_bytes()), ("b.pts.gz", gzip(text.as_bytes()))] {
        fs::write(folder.path().join(name), bytes).unwrap();
        let options = ["-o", "a.slices", "--force", "--pixel", "0.5", "--units", "m", "--colour", "intensity"];
        converts(folder.path(), &[&[name], &options[..]].concat());
        assert_eq!(Archive::open(folder.path().join("a.slices")).unwrap().header().points_kept, 140_000, "{name}");
    }
}

#[test]
fn headers_of_pts_and_commas_of_ptx_are_understood() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Named colours precede the intensity, and the sample shows that they are 0 to 1.
    let header = "//X;Y;Z;Rf;Gf;Bf;Intensity;Nx;Ny;Nz\n";
    let row = |z: f64| format!("1.5;2.5;{z};0.25;0.5;1;0.75;0;0;1\n");
    fs::write(at("a.pts"), format!("{header}3\n{}{}{}", row(1.0), row(2.0), row(3.0))).unwrap();
    let colour = Some(slicewalk::colour::ColourSource::Rgb);
    let set = InputSet::open(&[at("a.pts")], InputOptions { colour, ..InputOptions::default() }, &NoMonitor).unwrap();
    let mut values = Vec::new();
    for chunk in set.chunks() {
        PointDecoder::new()
            .decode(&set, &chunk, &mut |batch| {
                values.extend_from_slice(&batch.values);
                Ok(())
            })
            .unwrap();
    }
    assert_eq!(values, [[16_384, 32_768, 65_535]; 3]);
    let layout = set.files()[0].text_layout().unwrap();
    let words = "x is column 1 \"X\", y is column 2 \"Y\", z is column 3 \"Z\", intensity is column 7 \"Intensity\", red is column 4 \"Rf\"";
    assert!(layout.to_string().starts_with(words), "{layout}");
    // Decimal commas in header and rows, or in one of them.
    let head = "3\n1\n1,5 2,5 3,5\n1,0 0,0 0,0\n0,0 1,0 0,0\n0,0 0,0 1,0\n1,0 0,0 0,0 0,0\n0,0 1,0 0,0 0,0\n0,0 0,0 1,0 0,0\n1,5 2,5 3,5 1,0\n";
    let rows = "0 0 0 0\n0,25 0,5 1,0 0,5\n2,0 4 -1,5 0,5\n";
    let found = [[1.75, 3.0, 4.5], [3.5, 6.5, 2.0]];
    for (name, text) in [
        ("a.ptx", format!("{head}{rows}")),
        ("b.ptx", format!("{head}{}", rows.replace(',', "."))),
        ("c.ptx", format!("{}{rows}", head.replace(',', "."))),
        ("d.ptx", format!("{}{rows}", head.replace(',', ".").replace(' ', ", "))),
    ] {
        fs::write(at(name), text).unwrap();
        let (points, counts, _) = read(&at(name)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((&points[..], counts.withheld), (&found[..], 1), "{name}");
    }
}

#[test]
fn a_bad_cloud_of_a_ptx_leaves_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ptx");
    let clouds: Vec<(Point, Vec<Point>)> = (0..3).map(|n| ([f64::from(n), 0.0, 0.0], points(50))).collect();
    let good = write::ptx_of_stations(&clouds);
    let all = {
        fs::write(&path, &good).unwrap();
        read(&path).unwrap().0
    };
    assert_eq!(all.len(), 150);
    let second = good.match_indices("50\n1\n").nth(1).unwrap().0;
    let (before, behind) = good.split_at(second);
    for (from, to, words) in [
        ("0 0 1 0\n", "0 0 1 5\n", "last column 0 0 0 1"),
        ("1 0 0 0\n", "1 0 nan 0\n", "not finite"),
        ("1 0 0 0\n", "0 0 0 0\n", "the matrix is singular"),
        ("0 1 0 0\n", "0 1\n", "numbers of the header"),
        ("50\n1\n", "fifty\n1\n", "the number of columns of a cloud"),
        ("50\n1\n", "50\none\n", "the number of rows of a cloud"),
        ("0 1 0\n", "", ""),
    ] {
        fs::write(&path, format!("{before}{}", behind.replacen(from, to, 1))).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("line "), "{error}");
        let (found, _, said) = read_rest(&path);
        assert!(found == [&all[..50], &all[100..]].concat(), "{to}: {} points: {said}", found.len());
        assert!(said.contains("left out") && said.contains(words), "{said}");
    }
}

/// Cancels after a number of polls.
struct Impatient(AtomicU64, u64);

impl Monitor for Impatient {
    fn cancelled(&self) -> bool {
        self.0.fetch_add(1, Ordering::Relaxed) >= self.1
    }
}

#[test]
fn packed_text_without_rows_can_be_interrupted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.xyz.gz");
    let empty = vec![b'\n'; 64 << 20];
    let open = |monitor: &dyn Monitor| InputSet::open(std::slice::from_ref(&path), InputOptions::default(), monitor);
    fs::write(&path, gzip(&empty)).unwrap();
    assert!(matches!(open(&Impatient(AtomicU64::new(0), 20)), Err(Error::Interrupted)));
    // Rows, then none: the reader polls for cancellation at least once per MiB.
    let rows: String = (0..300).map(|n| format!("{n} 2.5 3.5\n")).collect();
    fs::write(&path, gzip(&[rows.as_bytes(), &empty].concat())).unwrap();
    let set = open(&NoMonitor).unwrap();
    let mut asked = 0;
    let chunk = set.chunks().next().unwrap();
    let counts = PointDecoder::new().decode(&set, &chunk, &mut |_| {
        asked += 1;
        Ok(())
    });
    assert!(counts.unwrap().read == 300 && asked > 30, "asked {asked} times");
}

#[test]
fn a_dry_run_shows_columns_and_first_points() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(
        at.join("a.csv"),
        "id;Height [m];Easting [m];Northing [m]\nP1;3,5;1,25;2\nP2;NA;1;1\nP3;4,5;2;3\nP4;5;6;7\nP5;1;1;1\n",
    )
    .unwrap();
    fs::write(at.join("b.pts"), "2\n1 2 3 5 10 20 30\n4 5 6 5 10 20 30\n").unwrap();
    // The first cloud has no returns.
    let cloud = |x: u32, rows: &str| {
        format!("1\n2\n{x} 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n{x} 0 0 1\n{rows}")
    };
    let clouds = [(1000, "0 0 0 0\n0 0 0 0\n"), (5000, "1 2 3 0.5 10 20 30\n4 5 6 0.5 10 20 30\n")];
    fs::write(at.join("c.ptx"), clouds.map(|(x, rows)| cloud(x, rows)).concat()).unwrap();
    let arguments = ["a.csv", "b.pts", "c.ptx", "--dry-run", "--pixel", "0.5"];
    let out = sliceconv(at, &arguments);
    let text = String::from_utf8(out.stdout).unwrap();
    for words in [
        "x is column 3 \"Easting [m]\", y is column 4 \"Northing [m]\", z is column 2 \"Height [m]\", separated by semicolons, decimal commas",
        "first points: (1.25, 2, 3.5), (2, 3, 4.5), (6, 7, 5)\n",
        "x is column 1, y is column 2, z is column 3, intensity is column 4, red is column 5, green is column 6, blue is column 7",
        "first points: (1, 2, 3), (4, 5, 6)\n",
        "first points: (5001, 2, 3), (5004, 5, 6)\n",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let out = sliceconv(at, &[&arguments[..], &["--json"]].concat());
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let of_text = &facts["inputs"][0]["text"];
    assert_eq!(of_text["columns"][0], serde_json::json!({ "holds": "x", "number": 3, "name": "Easting [m]" }));
    assert_eq!(of_text["first_points"], serde_json::json!([[1.25, 2.0, 3.5], [2.0, 3.0, 4.5], [6.0, 7.0, 5.0]]));
    assert_eq!((&of_text["separator"], &of_text["decimal_comma"]), (&"semicolons".into(), &true.into()));
    let out = sliceconv(at, &["a.csv", "-o", "a.slices", "--pixel", "0.5", "--json"]);
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((&facts["texts"][0]["path"], &facts["texts"][0]["columns"][2]["number"]), (&"a.csv".into(), &2.into()));
}

#[test]
fn units_of_headers_count() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    fs::write(&path, "X (mm),Y (mm),Z (mm)\n2500,803,385\n").unwrap();
    let (found, _, said) = read(&path).unwrap();
    assert!(
        found == [[2500.0 * 0.001, 803.0 * 0.001, 385.0 * 0.001]] && !said.iter().any(|said| said.contains("no unit"))
    );
    let options = InputOptions { units: slicewalk_input::Units::Factor(1.0), ..InputOptions::default() };
    assert_eq!(read_with(&path, options).unwrap().0, [[2500.0, 803.0, 385.0]]);
    fs::write(&path, "X [m],Y [m],Z [ft]\n1,2,10\n").unwrap();
    assert_eq!(read(&path).unwrap().0, [[1.0, 2.0, 10.0 * 0.3048]]);
}

/// Handmade files whose correct points are obvious to a person.
#[test]
fn odd_tables_hold_the_points_that_a_person_sees() {
    let Some(folder) = data::folder().map(|folder| folder.join("cases")).filter(|folder| folder.is_dir()) else {
        return eprintln!("skipped: the real data have no folder \"cases\"");
    };
    let columns = |text: &str| InputOptions { columns: Some(text.parse().unwrap()), ..InputOptions::default() };
    let whole = InputOptions::default();
    for (name, options, kept, absent) in [
        ("cc-header-pts_cc.pts", whole, 40, 0),
        ("cr-pts-nocount.pts", whole, 40, 0),
        ("cr-txt-header.txt", whole, 40, 0),
        ("cr-xyz.xyz", whole, 40, 0),
        ("elevation-angle.csv", whole, 40, 0),
        ("header-fewer.txt", whole, 40, 0),
        ("header-multiword.txt", whole, 40, 0),
        ("tab-empty.txt", whole, 40, 0),
        ("tab-columns.txt", columns("-,x,y,z"), 40, 0),
        ("text-first-column.csv", whole, 40, 0),
        ("text-first-columns-option.csv", columns("name,x,y,z"), 40, 0),
        ("nan-allow.csv", whole, 40, 1),
        ("nan-csv_-1.IND.csv", whole, 40, 2),
        ("nan-csv_-nanind.csv", whole, 40, 2),
        ("nan-csv_1.QNAN0.csv", whole, 40, 2),
        ("nan-csv_NA.csv", whole, 40, 2),
        ("nan-csv_empty.csv", whole, 40, 2),
        ("nan-csv_nanind.csv", whole, 40, 2),
        ("nan-csv_null.csv", whole, 40, 2),
        ("nan-pcd.pcd", whole, 40, 1),
        ("nan-ply.ply", whole, 40, 1),
    ] {
        let (found, counts, _) = read_with(&folder.join(name), options).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(found[..2], [[2.5, 0.803, 0.385], [3.589, 2.641, 1.856]], "{name}");
        assert_eq!(found.last().unwrap()[1..], [0.436, 1.631], "{name}");
        assert_eq!((found.len(), counts.withheld), (kept, absent), "{name}");
    }
    // Its matrix moves the points by (5, 6.1, 7).
    let moved = read(&folder.join("ptx-comma.ptx")).unwrap().0;
    assert_eq!((moved.len(), moved[0]), (40, [2.5 + 5.0, 0.803 + 6.1, 0.385 + 7.0]));
    let millimetres = read(&folder.join("header-mm.csv")).unwrap().0;
    assert_eq!(millimetres[0], [2500.0 * 0.001, 803.0 * 0.001, 385.0 * 0.001]);
    let small = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]];
    for name in ["r3_cr.xyz", "r3_tab_empty_cells.csv", "r3_bom_b.xyz.gz"] {
        assert_eq!(read(&folder.join(name)).unwrap().0, small, "{name}");
    }
    for (name, words) in [
        ("count-cut.xyz", "its first line states 100 points, 40 lines follow"),
        ("ragged-rows.xyz", "line 41: expected 3 columns, found 4"),
        ("tab-columns.txt", "the first column is text"),
        ("text-first-columns-option.csv", "the first column is text: \"P0\""),
    ] {
        let error = read(&folder.join(name)).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}
