//! Coarsened heights: every point stays solid, heights move outwards by at most the tolerance, and `--tolerance auto`
//! finds the noise of the scan, independent of the order of points, threads, memory and parts.

use crate::scans;

use scans::{Random, converts, data, refuses, verifies, write_as};
use serde_json::Value;
use slicewalk::archive::{Archive, extract, merge, recover};
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use slicewalk::{Error, NoMonitor, Parameter};
use slicewalk_convert::{ConvertOptions, PixelSize, PointWriter, Tolerance};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// A floor, a table, a gentle ramp and two walls, with noise of this standard deviation along their normals.
fn room(noise_m: f64) -> Vec<[f64; 3]> {
    let mut random = Random(7);
    let mut normal = move || (0..12).map(|_| random.uniform()).sum::<f64>() - 6.0;
    let mut random = Random(8);
    let mut points = Vec::new();
    for number in 0..90_000 {
        let (x, y) = (random.uniform() * 6.0, random.uniform() * 6.0);
        let off = noise_m * normal();
        points.push(match number % 6 {
            0 => [x, 0.03 + off, y / 2.0],
            1 => [0.04 + off, x, y / 2.0],
            2 if x < 2.0 && y < 1.0 => [x + 1.0, y + 2.0, 0.77 + off],
            2 => [x, y, 2.9 + 0.1 * x + off],
            _ => [x, y, 0.21 + off],
        });
    }
    points
}

fn write(path: &Path, points: &[[f64; 3]]) {
    write_as(path, points, 0.0001, [0.0; 3]);
}

const OPTIONS: [&str; 5] = ["--pixel", "0.1", "--units", "m", "--force"];
const AUTO: [&str; 2] = ["--tolerance", "auto"];

/// Report of `sliceconv --json`.
fn json_of(folder: &Path, arguments: &[&str]) -> Value {
    let out = scans::sliceconv(folder, &[arguments, &OPTIONS, &["--json"]].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

/// Checks that the spans of `loose` contain those of `exact`, and exceed them by at most `tolerance` (quanta).
fn is_within(exact: &Archive, loose: &Archive, tolerance: u32) {
    let pages = |archive: &Archive| -> BTreeMap<_, _> {
        archive.entries().map(|entry| entry.unwrap()).map(|entry| (entry.key, archive.page(&entry).unwrap())).collect()
    };
    let (exact, loose) = (pages(exact), pages(loose));
    assert!(exact.keys().eq(loose.keys()));
    let mut joined = 0;
    for (page, coarse) in exact.values().zip(loose.values()) {
        for (px, py) in (0..4096).map(|at| (at % 64, at / 64)) {
            let mut spans = page.column(px, py).iter().peekable();
            for wide in coarse.column(px, py) {
                let first = spans.next().expect("no span without matter");
                assert!(wide.bottom() <= first.bottom() && first.bottom() <= wide.bottom() + tolerance);
                let mut last = first;
                while let Some(next) = spans.next_if(|next| next.top() <= wide.top()) {
                    assert!(next.bottom() - last.top() <= 2 * tolerance);
                    (last, joined) = (next, joined + 1);
                }
                assert!(last.top() <= wide.top() && wide.top() <= last.top() + tolerance);
                assert_eq!((first.is_obstacle(), last.is_obstacle()), (wide.is_obstacle(), wide.is_obstacle()));
            }
            assert!(spans.next().is_none(), "matter is missing");
        }
    }
    eprintln!("{joined} spans joined to the one below");
}

#[test]
fn heights_move_outwards_within_the_tolerance_and_every_point_is_a_hit() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let points = room(0.004);
    write(&at.join("room.las"), &points);
    let exact = json_of(at, &["room.las", "-o", "exact.slices"]);
    let exact_archive = Archive::open(at.join("exact.slices")).unwrap();
    let mut least = exact["bytes"]["file"].as_u64().unwrap();
    for tolerance in ["0.004", "0.025", "0.1"] {
        let facts = json_of(at, &["room.las", "-o", "loose.slices", "--tolerance", tolerance]);
        let bytes = facts["bytes"]["file"].as_u64().unwrap();
        assert!(bytes < least, "{bytes} and {least} bytes at {tolerance}");
        least = bytes;
        assert_eq!(facts["format_version"], "1.0");
        assert!(facts.get("tolerance_auto").is_none());
        verifies(&at.join("loose.slices"));
        let loose = Archive::open(at.join("loose.slices")).unwrap();
        is_within(&exact_archive, &loose, loose.plan().tolerance_quanta());
        let store = Snapshot::resident(&loose, &NoMonitor).unwrap();
        for point in points.iter().step_by(7) {
            let point = point.map(|v| (v * 1e4).round() * 1e-4);
            let body = Aabb::new(point.into(), point.into()).unwrap();
            assert!(matches!(overlaps(&store, &body), Overlap::Hit), "{point:?}");
        }
    }
    assert!(least * 3 < exact["bytes"]["file"].as_u64().unwrap());
}

#[test]
fn the_noise_of_a_scan_is_found_said_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (noise_m, band) in [(0.0, 0.0..0.0001), (0.002, 0.0016..0.0021), (0.006, 0.0048..0.0063)] {
        write(&at.join("room.las"), &room(noise_m));
        let said = converts(at, &[&["room.las", "-o", "a.slices"], &OPTIONS[..], &AUTO].concat());
        assert!(said.contains("tolerance ") && said.contains("flat regions of"), "{said}");
        let facts = json_of(at, &["room.las", "-o", "a.slices", "--tolerance", "auto"]);
        let found = facts["tolerance_auto"]["noise"].as_f64().unwrap();
        assert!(band.contains(&found), "{noise_m}: {facts}");
        let seen = json_of(at, &["room.las", "--dry-run", "--tolerance", "auto"]);
        assert_eq!((&seen["tolerance"], &seen["tolerance_auto"]), (&facts["tolerance"], &facts["tolerance_auto"]));
        let tolerance = facts["tolerance"].as_f64().unwrap();
        assert!(tolerance <= found && tolerance >= 0.9 * found - 1e-9, "{tolerance} of {found}");
        let archive = Archive::open(at.join("a.slices")).unwrap();
        let info = slicewalk_convert::info::info(&archive).unwrap();
        assert_eq!((&info["tolerance"], &info["tolerance_auto"]), (&facts["tolerance"], &facts["tolerance_auto"]));
        verifies(&at.join("a.slices"));
        // Equals the archive of that explicit tolerance, except for the record of the noise.
        converts(at, &[&["room.las", "-o", "b.slices", "--tolerance", &tolerance.to_string()], &OPTIONS[..]].concat());
        let given = Archive::open(at.join("b.slices")).unwrap();
        let read = |archive: &Archive| {
            let pages: Vec<_> = archive.entries().map(|entry| archive.page(&entry.unwrap()).unwrap()).collect();
            (pages, archive.header().plan_hash)
        };
        assert!(read(&given) == read(&archive));
        assert_eq!(given.noise().unwrap(), None);
        // Operations that derive archives keep it.
        let all = ([-9.0; 3], [9.0; 3]);
        extract(&archive, &all, &at.join("cut.slices"), true, &NoMonitor).unwrap();
        let _ = fs::remove_file(at.join("saved.slices"));
        recover(&at.join("a.slices"), None, &at.join("saved.slices"), true, &NoMonitor).unwrap();
        for name in ["cut.slices", "saved.slices"] {
            assert_eq!(Archive::open(at.join(name)).unwrap().noise().unwrap(), archive.noise().unwrap(), "{name}");
        }
    }
}

#[test]
fn order_files_threads_memory_and_parts_do_not_change_an_automatic_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut points = room(0.003);
    write(&at.join("a.las"), &points);
    let convert = |inputs: &[&str], output: &str, more: &[&str]| {
        let options = ["--units", "m", "--force", "--quiet", "-o", output];
        converts(at, &[inputs, &options, more].concat());
        fs::read(at.join(output)).unwrap()
    };
    for pixel in [&["--pixel", "0.08"][..], &[]] {
        let auto = [&AUTO[..], pixel].concat();
        let expected = convert(&["a.las"], "whole.slices", &auto);
        Random(3).shuffle(&mut points);
        write(&at.join("b.laz"), &points[..20_000]);
        write(&at.join("c.las"), &points[20_000..]);
        for how in [["--threads", "1", "--memory", "64MiB"], ["--threads", "4", "--memory", "256MiB"]] {
            assert!(convert(&["c.las", "b.laz"], "again.slices", &[&auto[..], &how].concat()) == expected, "{how:?}");
        }
        converts(
            at,
            &[&["b.laz", "c.las", "--units", "m", "--write-plan", "plan.json", "--force", "--quiet"], &auto[..]]
                .concat(),
        );
        for options in [&["--plan", "plan.json"][..], &["--plan", "plan.json", "--tolerance", "auto"], &auto] {
            let parts = ["1/3", "2/3", "3/3"].map(|shard| {
                let output = format!("{}.slices", &shard[..1]);
                convert(&["b.laz", "c.las"], &output, &[options, &["--shard", shard]].concat());
                at.join(output)
            });
            let _ = fs::remove_file(at.join("merged.slices"));
            merge(&parts, &at.join("merged.slices"), true, &NoMonitor).unwrap();
            assert!(fs::read(at.join("merged.slices")).unwrap() == expected, "{options:?}");
        }
    }
    let given = ["b.laz", "c.las", "-o", "x.slices", "--plan", "plan.json", "--tolerance", "0.01"];
    assert!(refuses(at, &given, 2).contains("--tolerance: contradicts the plan"));
}

#[test]
fn where_nothing_is_flat_heights_stay_and_what_makes_no_sense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut random = Random(4);
    let cloud: Vec<_> = (0..20_000).map(|_| [0; 3].map(|_| random.uniform() * 4.0)).collect();
    write(&at.join("cloud.las"), &cloud);
    let said = converts(at, &[&["cloud.las", "-o", "a.slices"], &OPTIONS[..], &AUTO].concat());
    assert!(said.contains("warning: --tolerance auto: too little of the input is flat"), "{said}");
    let archive = Archive::open(at.join("a.slices")).unwrap();
    assert_eq!((archive.plan().options.tolerance_m, archive.header().version), (0.0, (1, 0)));
    assert_eq!(archive.noise().unwrap().map(|noise| noise.regions), Some(0));
    let said = refuses(at, &[&["cloud.las", "-o", "b.slices", "--tolerance", "some"], &OPTIONS[..]].concat(), 2);
    assert!(said.contains("expected auto, or a length in metres"), "{said}");
    let mut options = ConvertOptions::new(Vec::new(), at.join("c.slices"));
    options.grid.pixel = PixelSize::Metres(0.1);
    options.set_tolerance(Tolerance::Auto);
    let refused = PointWriter::create(&options, "").map(drop);
    assert!(matches!(refused, Err(Error::Parameter { what: Parameter::Tolerance, .. })));
}

/// Bytes of real scans at a quarter of a pixel, relative to those without a tolerance, with a margin.
#[test]
fn real_scans_take_no_more_than_was_promised() {
    let folder = tempfile::tempdir().unwrap();
    for (name, pixel_m, goal) in [
        ("pump_room.laz", 0.02, 0.50),
        ("delft_city_block_ahn3.laz", 1.0, 0.60),
        ("corridor_three_stations.laz", 0.05, 0.65),
        ("indoor_two_storey_zup.laz", 0.05, 0.85),
    ] {
        let Some(scan) = data::file(name) else { continue };
        let bytes = |tolerance_m: f64| {
            let mut options = ConvertOptions::new(vec![scan.clone()], folder.path().join("a.slices"));
            options.grid.pixel = PixelSize::Metres(pixel_m);
            options.plan.tolerance_m = tolerance_m;
            options.overwrite = true;
            slicewalk_convert::convert(&options, &NoMonitor).unwrap().header.file_len
        };
        let (exact, loose) = (bytes(0.0), bytes(pixel_m / 4.0));
        assert!((loose as f64) < goal * exact as f64, "{name}: {loose} of {exact} bytes");
        verifies(&folder.path().join("a.slices"));
    }
}
