//! `--fill-holes` closes holes in floors up to the given width and no wider ones, keeps everything scanned, and what is
//! inferred can be ignored.

use crate::scans;

use nalgebra::Point2;
use scangen::{Params, SampleSpec, Scene};
use scans::{Random, converts, refuses, sliceconv, verifies};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, PageDecoder, extract, merge, recover};
use slicewalk::frame::PageKey;
use slicewalk::page::Page;
use slicewalk::query::{Aabb, Answer, Overlap, overlaps};
use slicewalk::reach::{Flood, Pawn, StandingPlaces};
use slicewalk::store::{Prefetch, Snapshot, Stream, StreamOptions};
use slicewalk::walk::{Body, Config, State, Walker, Waypoints};
use slicewalk_convert::{ConvertOptions, HoleWidth, PixelSize, PointWriter};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

const PIXEL_M: f64 = 0.1;
const WIDEST_M: f64 = 0.4;
const OPTIONS: [&str; 8] = ["--pixel", "0.1", "--units", "m", "--quiet", "--force", "--threads", "2"];
const FILL: [&str; 2] = ["--fill-holes", "0.4"];

/// A hole in the floor of the hall.
#[derive(Clone, Copy, Debug)]
enum Hole {
    /// Centre and diameter.
    Disc([f64; 2], f64),
    /// Lowest corner and size.
    Rect([f64; 2], [f64; 2]),
}

impl Hole {
    /// How far a place is inside the hole (m); negative outside.
    fn depth(&self, [x, y]: [f64; 2]) -> f64 {
        match *self {
            Self::Disc([cx, cy], diameter) => diameter / 2.0 - (x - cx).hypot(y - cy),
            Self::Rect([x0, y0], [w, d]) => (x - x0).min(x0 + w - x).min(y - y0).min(y0 + d - y),
        }
    }
}

/// Up to the width, including a slot across the small room; then wider ones.
const CLOSED: [Hole; 5] = [
    Hole::Disc([2.0, 4.0], 0.4),
    Hole::Disc([3.03, 5.08], 0.25),
    Hole::Rect([5.0, 3.0], [0.4, 0.4]),
    Hole::Rect([1.5, 6.5], [2.0, 0.3]),
    Hole::Rect([11.0, -0.1], [0.4, 9.2]),
];
const OPEN: [Hole; 3] =
    [Hole::Disc([4.0, 1.5], 0.8), Hole::Rect([6.0, 4.0], [0.7, 0.7]), Hole::Rect([9.0, 5.5], [1.5, 0.65])];

/// The hall without the floor in the holes and in the leftmost half metre (the edge of the scan).
fn points(seed: u64) -> Vec<[f64; 3]> {
    let params = Params::new().with("leaves", 0.0).with("clutter", 0.0);
    let scene = Scene::named("hall", &params).unwrap();
    let spec = SampleSpec::direct_density(1500.0);
    let scanned = |p: &[f64; 3]| {
        let in_hole = CLOSED.iter().chain(&OPEN).any(|hole| hole.depth([p[0], p[1]]) > 0.0);
        p[2] > 0.01 || !in_hole && p[0] > 0.5
    };
    scene.points(seed, &spec).unwrap().map(|p| p.map(|v| (v * 1000.0).round() / 1000.0)).filter(scanned).collect()
}

fn convert(at: &Path, inputs: &[&str], options: &[&str], out: &str) -> Archive {
    converts(at, &[inputs, &OPTIONS, options, &["-o", out]].concat());
    verifies(&at.join(out));
    Archive::open(at.join(out)).unwrap()
}

/// All pages.
fn pages(archive: &Archive) -> BTreeMap<PageKey, Page> {
    let mut decoder = PageDecoder::new();
    let page = |entry: slicewalk::Result<_>| {
        let entry: slicewalk::archive::PageEntry = entry.unwrap();
        (entry.key, archive.page_with(&entry, &mut decoder).unwrap())
    };
    archive.entries().map(page).filter(|(_, page)| page.slices() != 0).collect()
}

/// Middles of pixels with inferred floor, and its heights (m).
fn inferred(archive: &Archive) -> Vec<[f64; 3]> {
    let (mut found, mut decoder, frame) = (Vec::new(), PageDecoder::new(), archive.frame());
    for entry in archive.entries() {
        let entry = entry.unwrap();
        let page = archive.page_with(&entry, &mut decoder).unwrap();
        for (px, py, mask) in decoder.inferred().pixels() {
            for (at, span) in page.column(px, py).iter().enumerate().filter(|(at, _)| mask >> at & 1 == 1) {
                assert!(!span.is_obstacle(), "span {at}");
                let middle = |tile: i32, pixel: u32| (f64::from(tile) * 64.0 + f64::from(pixel) + 0.5) * PIXEL_M;
                let height = f64::from(entry.key.layer) * 16320.0 + f64::from(span.top());
                found.push([middle(entry.key.tx, px), middle(entry.key.ty, py), height * frame.quantum_m()]);
            }
        }
    }
    found
}

fn known<T>(answer: Answer<T>) -> T {
    match answer {
        Answer::Known(value) => value,
        Answer::NotLoaded(missing) => panic!("{missing:?}"),
    }
}

/// Area that a slim pawn can reach on foot from the middle of the hall (m²).
fn area(archive: &Archive) -> f64 {
    let store = Snapshot::resident(archive, &NoMonitor).unwrap();
    let pawn = Pawn::new(Body::Cylinder { radius: 0.15, height: 1.7 });
    let mut standing = StandingPlaces::new(&store, pawn).unwrap();
    let start = known(standing.spot(&store, [10.0, 3.0, 0.1].into()).unwrap()).unwrap();
    let mut flood = Flood::from(start);
    known(flood.grow(&mut standing, &store, &NoMonitor).unwrap());
    flood.region(&standing).area_m2()
}

/// Returns whether a slim walker crosses the slot.
fn crosses(archive: &Archive) -> bool {
    let store = Snapshot::resident(archive, &NoMonitor).unwrap();
    let config = Config { max_drop: Some(0.35), ..Config::new(Body::Cylinder { radius: 0.15, height: 1.7 }) };
    let mut walker = Walker::new(config, [10.0, 3.0, 0.1].into()).unwrap();
    let mut way = Waypoints::new(vec![Point2::new(12.5, 3.1)]).unwrap();
    (0..600).any(|_| {
        walker.follow(&store, 1.0 / 60.0, &mut way);
        assert!(walker.feet().z > -0.1, "fell");
        walker.state() == State::Arrived
    })
}

#[test]
fn every_hole_up_to_the_width_is_closed_and_none_wider_and_a_walker_crosses() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let points = points(1);
    scans::write(&at.join("hall.las"), &points);
    let plain = convert(at, &["hall.las"], &[], "plain.slices");
    let filled = convert(at, &["hall.las"], &FILL, "filled.slices");

    let found = inferred(&filled);
    let on_floor: Vec<_> = found.iter().filter(|p| p[2] < 1.0).collect();
    for hole in CLOSED {
        let inside = (0..140 * 90).map(|n| [f64::from(n % 140), f64::from(n / 140)].map(|v| (v + 0.5) * PIXEL_M));
        // Pixels of which all points are in the hole.
        for place in inside.filter(|&place| hole.depth(place) > 0.75 * PIXEL_M && place[1] > 0.5 && place[1] < 8.5) {
            let near = |p: &&&[f64; 3]| (p[0] - place[0]).abs() < 1e-6 && (p[1] - place[1]).abs() < 1e-6;
            let fills: Vec<_> = on_floor.iter().filter(near).collect();
            assert!(fills.len() == 1 && fills[0][2].abs() < 0.01, "{hole:?} at {place:?}: {fills:?}");
        }
    }
    for hole in OPEN {
        let inside = on_floor.iter().find(|p| hole.depth([p[0], p[1]]) > 0.75 * PIXEL_M);
        assert!(inside.is_none(), "{hole:?}: {inside:?}");
    }
    assert!(found.iter().all(|p| p[2] > 1.0 || p[0] > 0.45), "beyond the edge of what was scanned");

    // Everything scanned stays bit for bit; inferred floor is counted and can be ignored.
    let counts = filled.header().voxels;
    assert_eq!((counts.inferred, counts.obstacle), (found.len() as u64, plain.header().voxels.obstacle));
    assert_eq!(counts.occupied - counts.inferred, plain.header().voxels.occupied);
    assert_eq!((filled.header().version, plain.header().version), ((1, 0), (1, 0)));
    let scanned = Archive::open(at.join("filled.slices")).unwrap().ignoring_inferred();
    assert!(pages(&scanned) == pages(&plain));
    assert!(crosses(&filled) && !crosses(&plain) && !crosses(&scanned));
    let areas = [&plain, &scanned, &filled].map(area);
    assert!(areas[0] == areas[1] && areas[2] > areas[0] + 10.0, "{areas:?}");

    // G1 with inferred floor, G2 without it, in memory and streamed.
    let store = Snapshot::resident(&filled, &NoMonitor).unwrap();
    let stream =
        Stream::open(scanned, StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(64 << 20) }).unwrap();
    let keys: Vec<PageKey> = filled.entries().map(|entry| entry.unwrap().key).collect();
    assert_eq!(stream.load(&keys, keys[0]).unwrap().left_out, 0);
    let of_plain = Snapshot::resident(&plain, &NoMonitor).unwrap();
    let mut random = Random(9);
    for p in points.iter().step_by(97) {
        let r = 1e-6 + 0.02 * random.uniform();
        let around = Aabb::new(p.map(|v| v - r).into(), p.map(|v| v + r).into()).unwrap();
        assert_eq!(overlaps(&store, &around), Overlap::Hit, "{p:?}");
    }
    let (mut phantoms, mut fills) = (0, 0);
    for _ in 0..20_000 {
        let low = [14.0 * random.uniform(), 9.0 * random.uniform(), 3.0 * random.uniform() * random.uniform() - 0.2];
        let size = [0.2, 0.2, 0.3].map(|most| most * random.uniform());
        let asked = Aabb::new(low.into(), [low[0] + size[0], low[1] + size[1], low[2] + size[2]].into()).unwrap();
        let ignoring = overlaps(&stream.snapshot(), &asked);
        assert_eq!(ignoring, overlaps(&of_plain, &asked), "{asked:?}");
        phantoms += u32::from(ignoring == Overlap::Hit);
        fills += u32::from(ignoring == Overlap::Clear && overlaps(&store, &asked) == Overlap::Hit);
    }
    assert!(phantoms > 1000 && fills > 20, "{phantoms} hits, {fills} of inferred floor");
}

#[test]
#[ignore = "slow: .ci/run"]
fn what_was_scanned_is_what_it_is_without_closed_holes_at_any_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scans::write(&at.join("hall.las"), &points(4));
    for tolerance in ["0.002", "0.02", "0.1", "0.3"] {
        let loose = ["--tolerance", tolerance];
        let plain = convert(at, &["hall.las"], &loose, "plain.slices");
        let filled = convert(at, &["hall.las"], &[&FILL[..], &loose].concat(), "filled.slices");
        assert!(filled.header().voxels.inferred > 300, "{tolerance}");
        assert!(pages(&filled) != pages(&plain));
        assert!(pages(&filled.ignoring_inferred()) == pages(&plain), "{tolerance}");
    }
}

#[test]
fn order_threads_memory_and_parts_change_no_byte_and_marks_outlive_what_makes_archives_of_archives() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut points = points(2);
    let (first, second) = points.split_at(points.len() / 3);
    scans::write(&at.join("a.las"), first);
    scans::write(&at.join("b.las"), second);
    let options: Vec<&str> = FILL.into_iter().chain(["--levels", "on", "--tolerance", "0.004"]).collect();
    let whole = convert(at, &["a.las", "b.las"], &options, "whole.slices");
    assert!(whole.header().voxels.inferred > 300 && whole.levels().unwrap().len() == 1);
    let expected = fs::read(at.join("whole.slices")).unwrap();

    Random(3).shuffle(&mut points);
    scans::write(&at.join("all.las"), &points);
    for how in [["--threads", "1", "--memory", "64MiB"], ["--threads", "5", "--memory", "256MiB"]] {
        converts(at, &[&["all.las"], &OPTIONS[..6], &options, &how, &["-o", "again.slices"]].concat());
        assert!(fs::read(at.join("again.slices")).unwrap() == expected, "{how:?}");
    }
    let mut of_memory = ConvertOptions::new(Vec::new(), at.join("pushed.slices"));
    (of_memory.grid.pixel, of_memory.grid.fill_holes, of_memory.sections.levels) =
        (PixelSize::Metres(PIXEL_M), Some(HoleWidth::Metres(WIDEST_M)), true);
    of_memory.plan.tolerance_m = 0.004;
    let mut writer = PointWriter::create(&of_memory, "").unwrap();
    let column = |axis: usize| points.iter().map(|p| p[axis]).collect::<Vec<_>>();
    writer.push(&column(0), &column(1), &column(2)).unwrap();
    writer.finish(&NoMonitor).unwrap();
    let pushed = Archive::open(at.join("pushed.slices")).unwrap();
    assert!(pages(&pushed) == pages(&whole) && inferred(&pushed) == inferred(&whole));

    // Parts of a plan, whose borders run through the holes.
    converts(
        at,
        &[&["a.las", "b.las", "--quiet", "--pixel", "0.1", "--units", "m", "--write-plan", "plan.json"], &options[..]]
            .concat(),
    );
    let parts: Vec<_> = (1..=4).map(|part| at.join(format!("{part}.slices"))).collect();
    for (number, part) in (1..).zip(&parts) {
        let shard = format!("{number}/4");
        converts(
            at,
            &["a.las", "b.las", "--quiet", "--plan", "plan.json", "--shard", &shard, "-o", part.to_str().unwrap()],
        );
        verifies(part);
    }
    merge(&parts, &at.join("merged.slices"), false, &NoMonitor).unwrap();
    let merged = fs::read(at.join("merged.slices")).unwrap();
    assert!(merged == expected, "{} and {} bytes", merged.len(), expected.len());

    // An extracted region, and an archive rebuilt from its pages.
    let bounds = ([1.0, 1.0, -0.5], [6.03, 6.2, 2.0]);
    extract(&whole, &bounds, &at.join("cut.slices"), false, &NoMonitor).unwrap();
    verifies(&at.join("cut.slices"));
    let cut = inferred(&Archive::open(at.join("cut.slices")).unwrap());
    let inside = |p: &&[f64; 3]| (0..2).all(|axis| bounds.0[axis] < p[axis] && p[axis] < bounds.1[axis]) && p[2] < 2.0;
    let of_region: Vec<_> = inferred(&whole).iter().filter(inside).copied().collect();
    assert!(of_region.len() > 15 && of_region.iter().all(|p| cut.contains(p)), "{of_region:?} and {cut:?}");
    let mut damaged = expected.clone();
    let leaf = whole.header().directory_offset() as usize;
    damaged[leaf + 20] ^= 1;
    fs::write(at.join("damaged.slices"), damaged).unwrap();
    let recovered = recover(&at.join("damaged.slices"), None, &at.join("found.slices"), false, &NoMonitor).unwrap();
    assert!(recovered.found.stored > 0);
    verifies(&at.join("found.slices"));
    assert_eq!(inferred(&Archive::open(at.join("found.slices")).unwrap()), inferred(&whole));
}

#[test]
fn gaps_between_sparse_points_are_closed_by_the_measured_width() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // A floor of 20 × 20 m with a point in each square of 0.25 m, anywhere in it.
    let mut state = 1u64;
    let mut random = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    let points: Vec<[f64; 3]> = (0..80 * 80)
        .map(|n| [(f64::from(n % 80) + random()) * 0.25, (f64::from(n / 80) + random()) * 0.25, 0.002])
        .collect();
    scans::write(&at.join("a.las"), &points);
    let inferred = |options: &[&'static str]| {
        let archive = convert(at, &["a.las"], options, "a.slices");
        (archive.plan().options.fill_holes, archive.header().voxels.inferred)
    };
    assert_eq!(inferred(&[]), (0, 0));
    let (pixels, voxels) = inferred(&["--fill-holes", "auto"]);
    // The nearest point lies about 0.15 m off; 34,000 of the 40,000 pixels hold none.
    assert!((3..=6).contains(&pixels) && voxels > 12_000, "{pixels} pixels wide: {voxels} voxels");
    // Pixels wider than the gaps have none.
    converts(at, &["a.las", "--pixel", "1", "--fill-holes", "auto", "--quiet", "-o", "wide.slices"]);
    assert_eq!(Archive::open(at.join("wide.slices")).unwrap().plan().options.fill_holes, 0);
    converts(at, &["a.las", "--pixel", "0.1", "--fill-holes", "auto", "--quiet", "--write-plan", "p.json"]);
    let said = refuses(at, &["a.las", "--plan", "p.json", "--fill-holes", "auto", "-o", "b.slices"], 2);
    assert!(said.contains("--fill-holes: contradicts the plan"), "{said}");
    // Meshes have no spacing.
    fs::write(at.join("m.obj"), "v 0 0 0\nv 4 0 0\nv 4 4 0\nf 1 2 3\n").unwrap();
    let said = converts(at, &["m.obj", "--pixel", "0.1", "--units", "m", "--fill-holes", "auto", "-o", "m.slices"]);
    assert!(said.contains("--fill-holes auto: the input has no points"), "{said}");
    assert_eq!(Archive::open(at.join("m.slices")).unwrap().plan().options.fill_holes, 0);
}

#[test]
fn widths_that_make_no_sense_are_refused_by_the_option_and_a_plan_keeps_the_width() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scans::write(&at.join("a.las"), &scans::points(2000));
    let with = |width: &'static str| ["a.las", "--pixel", "0.1", "-o", "a.slices", "--fill-holes", width];
    for (width, says) in [("0", "above 0"), ("0.05", "narrower"), ("5", "4.5"), ("-1", "above 0"), ("nan", "")] {
        let said = refuses(at, &with(width), 2);
        assert!(said.contains("--fill-holes") && said.contains(says), "{said}");
    }
    assert!(!at.join("a.slices").exists());
    converts(at, &["a.las", "--pixel", "0.1", "--fill-holes", "0.35", "--quiet", "--write-plan", "p.json"]);
    let said = refuses(at, &["a.las", "--plan", "p.json", "--fill-holes", "0.2", "-o", "a.slices"], 2);
    assert!(said.contains("--fill-holes: contradicts"), "{said}");
    converts(at, &["a.las", "--plan", "p.json", "--fill-holes", "0.3", "--quiet", "-o", "a.slices"]);
    assert_eq!(Archive::open(at.join("a.slices")).unwrap().plan().options.fill_holes, 3);
    let out = sliceconv(at, &["a.las", "--plan", "p.json", "--json", "-o", "a.slices", "--force"]);
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(report["fill_holes"]["pixels"], 3);
    assert!(report["voxels"]["inferred"].as_u64().is_some());
}
