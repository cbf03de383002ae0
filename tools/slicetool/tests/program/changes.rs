//! `diff --changes`: what is new, gone or not seen, by brute force over all pairs of voxels.

use serde_json::Value;
use slicewalk::archive::{ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{Inferred, PageBuilder, Span};
use slicewalk::plan::{Plan, PlanOptions};
use slicewalk::seen::{SeenBlock, SeenPage};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Pixels of 0.5 m, slices of 1 m.
fn plan() -> Plan {
    let options = PlanOptions { fill_holes: 3, ..PlanOptions::default() };
    Plan { frame: Frame::new(0.5, 1.0).unwrap(), options }
}

/// Pixel and slice of the grid.
type Place = [i64; 3];
/// Bottom and top in the voxel (quanta), and whether it is inferred.
type Voxels = BTreeMap<Place, (u32, u32, bool)>;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % end
    }
}

/// Voxels around the corner of eight pages and around one page far away.
fn voxels(random: &mut Random, count: usize) -> Voxels {
    let mut found = Voxels::new();
    for _ in 0..count {
        let far = if random.below(4) == 0 { 64 * 5 + 32 } else { 0 };
        let place = [0; 3].map(|_| random.below(13) as i64 - 6);
        // Below the top of its slice, so that no spans touch.
        let bottom = random.below(200) as u32;
        let inferred = random.below(8) == 0;
        found.insert([place[0] + far, place[1], place[2]], (bottom, bottom + random.below(40) as u32, inferred));
    }
    found
}

fn page_of(place: Place) -> (PageKey, [u32; 3]) {
    let [tx, ty, layer] = place.map(|at| at.div_euclid(64) as i32);
    (PageKey { tx, ty, layer }, place.map(|at| at.rem_euclid(64) as u32))
}

/// Writes an archive of these voxels, with the seen cells of `seen`: cells of 4 × 4 pixels and a slice.
fn write(path: &Path, voxels: &Voxels, seen: Option<&BTreeSet<Place>>) {
    let plan = plan();
    let mut writer = ArchiveWriter::create(path, &plan, true).unwrap();
    let mut encoder = PageEncoder::of_plan(&plan);
    let mut pages: BTreeMap<PageKey, BTreeMap<_, Vec<(Span, bool)>>> = BTreeMap::new();
    for (&place, &(bottom, top, inferred)) in voxels {
        let (key, [px, py, k]) = page_of(place);
        let span = Span::new(k * 255 + bottom, k * 255 + top, false).unwrap();
        pages.entry(key).or_default().entry((py, px)).or_default().push((span, inferred));
    }
    for (key, columns) in pages {
        let (mut builder, mut marks) = (PageBuilder::default(), Inferred::new());
        for ((py, px), spans) in columns {
            let mask = spans.iter().enumerate().map(|(at, (_, inferred))| u64::from(*inferred) << at).sum();
            let spans: Vec<Span> = spans.into_iter().map(|(span, _)| span).collect();
            assert!(builder.set_column(px, py, &spans) && marks.push(px, py, mask));
        }
        writer.put(key, encoder.encode_inferred(key, &builder.build(), &marks)).unwrap();
    }
    if let Some(cells) = seen {
        writer.set_seen();
        let mut found: BTreeMap<PageKey, SeenPage> = BTreeMap::new();
        for &[x, y, z] in cells {
            let (key, [px, py, k]) = page_of([4 * x, 4 * y, z]);
            let cell = [px / 4, py / 4, k].map(|at| [at as usize; 2]);
            found.entry(key).or_insert(SeenPage::NOTHING).mark(cell);
        }
        let mut blocks: BTreeMap<PageKey, SeenBlock> = BTreeMap::new();
        for (key, page) in found {
            let (block, at) = SeenBlock::place_of(key);
            blocks.entry(block).or_insert_with(|| SeenBlock::new(block)).push(at, &page);
        }
        blocks.values().for_each(|block| writer.put_seen(block).unwrap());
    }
    writer.finish(Totals::default()).unwrap();
}

/// Changes by place, as the rule states them.
fn expected(a: &Voxels, b: &Voxels, seen: Option<&BTreeSet<Place>>, reach: Place) -> BTreeMap<Place, &'static str> {
    let is_alone = |place: &Place, others: &Voxels| {
        !others.keys().any(|other| (0..3).all(|axis| (other[axis] - place[axis]).abs() <= reach[axis]))
    };
    let changed = |own: &Voxels, others: &Voxels| -> Vec<Place> {
        own.iter().filter(|(place, voxel)| !voxel.2 && is_alone(place, others)).map(|(place, _)| *place).collect()
    };
    let cell = |[i, j, k]: &Place| [i.div_euclid(4), j.div_euclid(4), *k];
    let gone = changed(a, b).into_iter().map(|place| {
        let unseen = seen.is_some_and(|cells| !cells.contains(&cell(&place)));
        (place, if unseen { "not_seen" } else { "gone" })
    });
    changed(b, a).into_iter().map(|place| (place, "new")).chain(gone).collect()
}

fn slicetool(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_slicetool")).current_dir(folder).args(arguments).output().unwrap()
}

fn text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap()
}

fn done(folder: &Path, arguments: &[&str]) -> (String, String) {
    let out = slicetool(folder, arguments);
    let said = text(out.stderr);
    assert!(out.status.success(), "{arguments:?}: {said}");
    (text(out.stdout), said)
}

/// Rows of a table by voxel, with the middle of its solid.
fn rows(table: &str) -> Vec<([f64; 3], String)> {
    let mut lines = table.lines();
    assert_eq!(lines.next(), Some("x,y,z,change"));
    lines
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            ([0, 1, 2].map(|at| fields[at].parse().unwrap()), fields[3].to_owned())
        })
        .collect()
}

/// Points of a binary PLY file with colours and changes.
fn points(bytes: &[u8]) -> Vec<([f64; 3], [u8; 3], u8)> {
    let end = bytes.windows(11).position(|bytes| bytes == b"end_header\n").unwrap() + 11;
    let head = std::str::from_utf8(&bytes[..end]).unwrap();
    let count: usize =
        head.lines().find_map(|line| line.strip_prefix("element vertex ")).unwrap().trim().parse().unwrap();
    assert!(head.contains("comment change: 0 new, 1 gone, 2 not seen\n") && head.contains("property uchar change\n"));
    let (records, rest) = bytes[end..].as_chunks::<28>();
    assert!(records.len() == count && rest.is_empty());
    let value = |record: &[u8; 28], axis: usize| f64::from_le_bytes(record[8 * axis..][..8].try_into().unwrap());
    let point = |record: &[u8; 28]| {
        ([0, 1, 2].map(|axis| value(record, axis)), [record[24], record[25], record[26]], record[27])
    };
    records.iter().map(point).collect()
}

#[test]
fn changes_are_those_of_a_brute_force_over_all_voxels() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut random = Random(5);
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for number in 0..36 {
        let density = [20, 150, 600][number % 3];
        let (a, b) = (voxels(&mut random, density), voxels(&mut random, density));
        let cells: BTreeSet<Place> = (0..300)
            .map(|_| {
                [
                    random.below(5) as i64 - 2 + 88 * random.below(2) as i64,
                    random.below(5) as i64 - 2,
                    random.below(13) as i64 - 6,
                ]
            })
            .collect();
        let seen = (number % 4 > 0).then_some(&cells);
        write(&at.join("a.slices"), &a, None);
        write(&at.join("b.slices"), &b, seen);
        // By default a pixel, which is a slice too; 0; between two and three pixels, which is two slices; all of a page.
        let (within, reach): (&[&str], Place) = match number / 3 % 4 {
            0 => (&[], [1; 3]),
            1 => (&["--within", "0"], [0; 3]),
            2 => (&["--within", "1.2"], [3, 3, 2]),
            _ => (&["--within", "3"], [6, 6, 3]),
        };
        let command = [&["diff", "a.slices", "b.slices", "--changes", "c.csv", "--json"][..], within].concat();
        let (result, said) = done(at, &command);
        assert_eq!(said.contains("b.slices: it does not say which space was seen"), seen.is_none(), "{said}");
        assert_eq!(said.lines().count(), usize::from(seen.is_none()), "{said}");
        let expected = expected(&a, &b, seen, reach);
        let found = rows(&fs::read_to_string(at.join("c.csv")).unwrap());
        let place = |x: f64, size: f64| (x / size).floor() as i64;
        let by_place: BTreeMap<Place, &str> = found
            .iter()
            .map(|([x, y, z], change)| {
                let at = [place(*x, 0.5), place(*y, 0.5), place(*z, 1.0)];
                let (bottom, top, _) = if change == "new" { b[&at] } else { a[&at] };
                let middle = [
                    at[0] as f64 / 2.0 + 0.25,
                    at[1] as f64 / 2.0 + 0.25,
                    at[2] as f64 + f64::from(bottom + top) / 510.0,
                ];
                let is_near = (0..3).all(|axis| ([*x, *y, *z][axis] - middle[axis]).abs() < 1e-3);
                assert!(is_near, "{x} {y} {z}: {middle:?}");
                (at, &**change)
            })
            .collect();
        assert!(by_place == expected && by_place.len() == found.len(), "{number}: {by_place:?} {expected:?}");
        let facts: Value = serde_json::from_str(&result).unwrap();
        for name in ["new", "gone", "not_seen"] {
            let count = expected.values().filter(|change| **change == name).count();
            assert_eq!(facts["changes"][name], count, "{facts}");
            *counts.entry(name).or_default() += count;
        }
        // The same as points.
        done(at, &[&["diff", "a.slices", "b.slices", "--changes", "c.ply"][..], within].concat());
        let points = points(&fs::read(at.join("c.ply")).unwrap());
        assert_eq!(points.len(), found.len());
        for ((position, colour, change), (row, name)) in points.iter().zip(&found) {
            assert!((0..3).all(|axis| (position[axis] - row[axis]).abs() < 1e-3));
            let (number, channel) = [("new", 1), ("gone", 0)]
                .into_iter()
                .enumerate()
                .find_map(|(number, (other, channel))| (name == other).then_some((number as u8, Some(channel))))
                .unwrap_or((2, None));
            assert_eq!(*change, number);
            assert!(channel.is_none_or(|channel| (0..3).all(|at| at == channel || colour[at] < colour[channel])));
        }
    }
    assert!(counts.values().all(|count| *count > 300), "{counts:?}");
}

#[test]
fn changes_go_to_standard_output_and_never_replace_an_archive() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let voxels = |places: &[Place]| places.iter().map(|place| (*place, (3, 9, false))).collect::<Voxels>();
    write(&at.join("a.slices"), &voxels(&[[0, 0, 0], [9, 9, 2]]), None);
    write(&at.join("b.slices"), &voxels(&[[1, 0, 0], [20, 9, 2]]), Some(&[[2, 2, 2]].into()));
    let (result, said) = done(at, &["diff", "a.slices", "b.slices", "--changes", "-"]);
    assert_eq!(rows(&result).iter().map(|row| &row.1[..]).collect::<Vec<_>>(), ["gone", "new"], "{result}");
    assert!(said.contains("slicetool: -: 1 voxel new, 1 gone, 0 not seen"), "{said}");
    let (result, said) = done(at, &["diff", "a.slices", "b.slices", "--changes", "c.csv"]);
    assert!(result.ends_with("c.csv: 1 voxel new, 1 gone, 0 not seen\n") && said.is_empty(), "{result}{said}");
    // Without the option, nothing changes.
    let (plain, _) = done(at, &["diff", "a.slices", "b.slices", "--json"]);
    assert!(!plain.contains("changes"), "{plain}");
    let before = fs::read(at.join("b.slices")).unwrap();
    for (more, code, words) in [
        (&["--changes", "-", "--json"][..], 2, "--changes - and --json both write to standard output"),
        (&["--within", "1"], 2, "--changes"),
        (&["--changes", "c.csv", "--within", "-1"], 2, "--within"),
        (&["--changes", "c.csv", "--within", "33"], 2, "--within: at most 32 m"),
        (&["--changes", "c.las"], 1, "c.las: unknown format; name the file .ply or .csv"),
        (&["--changes", "b.slices"], 1, "b.slices: unknown format"),
    ] {
        let out = slicetool(at, &[&["diff", "a.slices", "b.slices"], more].concat());
        let said = text(out.stderr);
        assert!(out.status.code() == Some(code) && said.contains(words), "{more:?}: {said}");
    }
    for name in ["hard.csv", "hard.ply"] {
        fs::hard_link(at.join("b.slices"), at.join(name)).unwrap();
        let out = slicetool(at, &["diff", "a.slices", "b.slices", "--changes", name]);
        assert!(out.status.code() == Some(1) && text(out.stderr).contains("this command reads"));
    }
    assert!(fs::read(at.join("b.slices")).unwrap() == before && !at.join("c.las").exists());
}
