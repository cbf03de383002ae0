//! `--free-space` stores as seen only what a station looked through: the rule, checked by brute force over the rays.

use crate::scans;

use nalgebra::Point3;
use scangen::sample::{Mode, ScannerSpec};
use scangen::{Params, SampleSpec, Scene, Truth, WriteSpec, write_samples};
use scans::{Random, converts, merges_to, refuses, sliceconv, verifies};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, extract, recover};
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use slicewalk::seen::{CELL_PIXELS, SeenSpace};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

const PIXEL_M: f64 = 0.05;
const OPTIONS: [&str; 7] = ["--pixel", "0.05", "--units", "m", "--quiet", "--free-space", "--force"];
const MOST: u64 = 1 << 30;

/// A scan by several stations, as files `0.las`, `1.las` ... with their table.
struct Scan {
    scene: Scene,
    stations: Vec<[f64; 3]>,
    /// Points of each station.
    points: Vec<Vec<[f64; 3]>>,
    folder: tempfile::TempDir,
}

impl Scan {
    fn new(scene: &str, params: &Params, rays: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scene = Scene::named(scene, params).unwrap();
        let stations: Vec<[f64; 3]> = scene.stations().iter().copied().take(3).collect();
        let mut table = String::from("file,x,y,z\n");
        let mut points = Vec::new();
        for (number, at) in stations.iter().enumerate() {
            let scanner = ScannerSpec { stations: vec![*at], mixed_rate: 0.0, ..ScannerSpec::default() };
            let spec = SampleSpec { mode: Mode::Scanner(scanner), ..SampleSpec::scanner(rays) }.with_noise(0.003);
            let name = format!("{number}.las");
            let write = WriteSpec::for_path(Path::new(&name));
            let samples: Vec<_> = scene.samples(number as u64 + 1, &spec).unwrap().collect();
            write_samples(&folder.path().join(&name), samples.iter().copied(), &write).unwrap();
            points.push(samples.iter().map(|sample| write.rounded(sample.position).unwrap()).collect());
            table += &format!("{name},{},{},{}\n", at[0], at[1], at[2]);
        }
        fs::write(folder.path().join("stations.csv"), table).unwrap();
        Self { scene, stations, points, folder }
    }

    fn at(&self) -> &Path {
        self.folder.path()
    }

    fn names(&self) -> Vec<String> {
        (0..self.stations.len()).map(|number| format!("{number}.las")).collect()
    }

    fn convert(&self, out: &str, more: &[&str]) -> Archive {
        let names = self.names();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        converts(self.at(), &[&names[..], &OPTIONS, &["--stations", "stations.csv", "-o", out], more].concat());
        Archive::open(self.at().join(out)).unwrap()
    }
}

fn house(rays: u64) -> Scan {
    Scan::new("house", &Params::new().with("storeys", 1.0), rays)
}

fn less([a, b]: [[f64; 3]; 2]) -> [f64; 3] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

fn length(d: [f64; 3]) -> f64 {
    d.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Returns of a station by direction, in cubes of the space of unit vectors.
struct Returns {
    at: [f64; 3],
    cubes: HashMap<[i32; 3], Vec<([f64; 3], f64)>>,
}

const CUBE: f64 = 0.02;

impl Returns {
    fn new(at: [f64; 3], points: &[[f64; 3]]) -> Self {
        let mut cubes: HashMap<_, Vec<_>> = HashMap::new();
        for &point in points {
            let d = less([point, at]);
            let far = length(d);
            let unit = d.map(|v| v / far);
            cubes.entry(unit.map(|v| (v / CUBE).floor() as i32)).or_default().push((unit, far));
        }
        Self { at, cubes }
    }

    /// Distances of the returns within an angle of a direction (chords, which are shorter).
    fn within(&self, unit: [f64; 3], angle: f64, mut each: impl FnMut(f64)) {
        let [low, high] = [-angle, angle].map(|by| unit.map(|v| ((v + by) / CUBE).floor() as i32));
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    for (other, far) in self.cubes.get(&[x, y, z]).into_iter().flatten() {
                        if length(less([*other, unit])) <= angle {
                            each(*far);
                        }
                    }
                }
            }
        }
    }

    /// The rule of a place: for some `n`, all returns within `0.9/n` rad are farther by the margin, and at least five
    /// lie within `12/n` rad.
    fn see_through(&self, place: [f64; 3]) -> bool {
        let d = less([place, self.at]);
        let far = length(d);
        let unit = d.map(|v| v / far);
        far >= 0.3
            && [512.0, 256.0, 128.0, 64.0, 32.0].into_iter().any(|n| {
                let (mut count, mut nearest) = (0, f64::INFINITY);
                self.within(unit, 12.0 / n, |_| count += 1);
                // Angles are longer than chords by less than one in a thousand.
                self.within(unit, 0.9 / n * 0.999, |far| nearest = nearest.min(far));
                count >= 5 && nearest > far + 0.05 + 0.01 * far
            })
    }
}

/// Corners of all seen cells (m).
fn cells(space: &SeenSpace) -> Vec<[f64; 3]> {
    let frame = space.frame();
    let mut cells = Vec::new();
    for (key, page) in space.pages() {
        for at in 0..16 * 16 * 64 {
            let [x, y, z] = [at % 16, at / 16 % 16, at / 256];
            if page.is_seen([[x; 2], [y; 2], [z; 2]]) {
                cells.push([
                    frame.edge_of_pixel(i64::from(key.tx) * TILE_PIXELS + x as i64 * CELL_PIXELS),
                    frame.edge_of_pixel(i64::from(key.ty) * TILE_PIXELS + y as i64 * CELL_PIXELS),
                    frame.bottom_of_slice(i64::from(key.layer) * PAGE_SLICES + z as i64),
                ]);
            }
        }
    }
    cells
}

/// Size of a cell (m).
const CELL: [f64; 3] = [4.0 * PIXEL_M, 4.0 * PIXEL_M, 3.0 * PIXEL_M];

#[test]
#[ignore = "slow: .ci/run"]
fn no_cell_is_stored_as_seen_that_breaks_the_rule_and_most_seen_space_is_stored() {
    let samples = std::env::var("SLICEWALK_SEEN_SAMPLES").map_or(5_000, |text| text.parse().unwrap());
    for scan in [house(400_000), Scan::new("hall", &Params::new().with("leaves", 0.0), 400_000)] {
        let archive = scan.convert("out.slices", &[]);
        let space = archive.seen_space(MOST).unwrap().unwrap();
        let cells = cells(&space);
        assert_eq!(cells.len() as u64, space.cells());
        let returns: Vec<Returns> =
            scan.stations.iter().zip(&scan.points).map(|(at, points)| Returns::new(*at, points)).collect();
        let mut random = Random(11);
        let mut hidden = 0;
        for _ in 0..samples {
            let corner = cells[(random.uniform() * cells.len() as f64) as usize];
            let place = std::array::from_fn(|axis| corner[axis] + CELL[axis] * random.uniform());
            assert!(returns.iter().any(|returns| returns.see_through(place)), "{place:?} breaks the rule");
            let is_visible = |at: &[f64; 3]| {
                let d = less([place, *at]);
                scan.scene.raycast(*at, d.map(|v| v / length(d)), length(d)).is_none()
            };
            hidden += usize::from(!scan.stations.iter().any(is_visible));
        }
        // Space that the stations see in truth, two cells and more away from all surfaces.
        let bounds = scan.scene.bounds();
        let (mut seen, mut all) = (0, 0);
        for _ in 0..samples {
            let place: [f64; 3] =
                std::array::from_fn(|axis| bounds.min[axis] + (bounds.max[axis] - bounds.min[axis]) * random.uniform());
            let around = |sign: f64| std::array::from_fn(|axis| place[axis] + sign * 2.0 * CELL[axis]);
            let is_visible = |at: &[f64; 3]| {
                let d = less([place, *at]);
                let unit = d.map(|v| v / length(d));
                // The sky has no returns, so nothing is known in front of it.
                scan.scene.raycast(*at, unit, length(d)).is_none() && scan.scene.raycast(*at, unit, 100.0).is_some()
            };
            if scan.scene.distance_to_box(around(-1.0), around(1.0)) > 0.0 && scan.stations.iter().any(is_visible) {
                all += 1;
                seen += usize::from(space.is_seen(Point3::from(place)));
            }
        }
        let share = seen as f64 / all as f64;
        println!(
            "{}: {} cells, hidden {hidden} of {samples}, {share:.3} of {all} seen",
            scan.scene.name(),
            cells.len()
        );
        assert_eq!(hidden, 0);
        assert!(share >= 0.8, "{}: {share} of {all}", scan.scene.name());
    }
}

#[test]
fn order_threads_memory_and_parts_change_no_byte_and_other_sections_stay() {
    let scan = house(60_000);
    let at = scan.at();
    scan.convert("out.slices", &["--threads", "1"]);
    let whole = fs::read(at.join("out.slices")).unwrap();
    verifies(&at.join("out.slices"));
    let turned = ["2.las", "0.las", "1.las", "--stations", "stations.csv", "-o", "turned.slices", "--threads", "3"];
    converts(at, &[&turned[..], &OPTIONS, &["--memory", "100MiB"]].concat());
    assert!(fs::read(at.join("turned.slices")).unwrap() == whole);
    let names = ["0.las", "1.las", "2.las"];
    let planned = |name: &str, options: &[&str]| {
        let plan = ["--pixel", "0.05", "--units", "m", "--quiet", "--write-plan", name];
        converts(at, &[&names[..], &plan, options].concat());
    };
    planned("plain.json", &[]);
    planned("plan.json", &["--free-space"]);
    let part = |number: u32, plan: &str, options: &[&str]| {
        let (shard, out) = (format!("{number}/3"), format!("{number}.slices"));
        let of_part = ["--plan", plan, "--shard", &shard, "-o", &out, "--quiet", "--force"];
        converts(at, &[&names[..], &of_part, options].concat());
        verifies(&at.join(&out));
        at.join(out)
    };
    let stations = ["--stations", "stations.csv"];
    let parts: Vec<PathBuf> = (1..=3).map(|number| part(number, "plan.json", &stations)).collect();
    merges_to(&parts, &at.join("out.slices"));
    part(2, "plain.json", &["--free-space", stations[0], stations[1]]);
    merges_to(&parts, &at.join("out.slices"));
    let useless = [&names[..], &["--plan", "plain.json", "-o", "x.slices"], &stations].concat();
    assert!(refuses(at, &useless, 2).contains("--stations: the plan neither"));
    part(2, "plain.json", &[]);
    let error = slicewalk::archive::merge(&parts, &at.join("x.slices"), false, &NoMonitor).unwrap_err().to_string();
    assert!(error.contains("part 2 of 3: only one of it and") && error.contains("has seen space; convert"), "{error}");
    // All other sections are those of an archive without seen space.
    let plain = [&names[..], &["--pixel", "0.05", "--units", "m", "--quiet", "-o", "plain.slices"]].concat();
    converts(at, &plain);
    let (plain, with) =
        (Archive::open(at.join("plain.slices")).unwrap(), Archive::open(at.join("out.slices")).unwrap());
    assert!(plain.entries().map(Result::unwrap).eq(with.entries().map(Result::unwrap)));
    assert_eq!((plain.seen_table().unwrap(), plain.seen_space(MOST).unwrap()), (None, None));
    let seen = with.seen_table().unwrap().unwrap();
    assert_eq!(plain.header().file_len + seen.bytes(), with.header().file_len);
}

#[test]
fn an_extract_keeps_the_cells_of_its_region_and_a_recovery_the_sound_ones() {
    let scan = house(60_000);
    let at = scan.at();
    let archive = scan.convert("out.slices", &[]);
    let space = archive.seen_space(MOST).unwrap().unwrap();
    let (min, max) = ([1.03, 2.04, 0.31], [6.1, 5.02, 2.2]);
    extract(&archive, &(min, max), &at.join("part.slices"), false, &NoMonitor).unwrap();
    verifies(&at.join("part.slices"));
    let part = Archive::open(at.join("part.slices")).unwrap().seen_space(MOST).unwrap().unwrap();
    let mut random = Random(3);
    let mut inside = 0;
    for _ in 0..50_000 {
        let place = Point3::new(random.uniform() * 14.0, random.uniform() * 10.0, random.uniform() * 3.0);
        let is_in = (0..3).all(|axis| (min[axis]..=max[axis]).contains(&place[axis]));
        inside += usize::from(is_in && space.is_seen(place));
        assert!(!is_in || part.is_seen(place) == space.is_seen(place), "{place}");
        assert!(!part.is_seen(place) || space.is_seen(place), "{place}");
    }
    assert!(inside > 1000 && part.cells() < space.cells() / 4, "{inside}");
    // Damage to some byte is found, and costs a recovery a block at most, or all without the table.
    let bytes = fs::read(at.join("out.slices")).unwrap();
    let header = archive.header();
    let end = (header.bytes.head + header.bytes.pages) as usize;
    let section = archive.seen_table().unwrap().unwrap().bytes() as usize;
    let damaged = at.join("damaged.slices");
    for number in 0..60 {
        // The last bytes are those of table and trailer.
        let back = if number < 20 { number * 3 } else { (random.uniform() * section as f64) as usize };
        let mut copy = bytes.clone();
        copy[end - 1 - back.min(section - 1)] ^= 1 << (number % 8);
        fs::write(&damaged, &copy).unwrap();
        let opened = Archive::open(&damaged).unwrap();
        let mut found = Vec::new();
        opened.verify(&NoMonitor, &mut |finding| found.push(finding.rule)).unwrap();
        assert!(
            found.iter().any(|rule| rule.starts_with('V')) && found.iter().all(|rule| rule.starts_with('V')),
            "{found:?}"
        );
        assert!(opened.seen_space(MOST).is_err());
        let recovered = recover(&damaged, None, &at.join("again.slices"), true, &NoMonitor).unwrap();
        assert!(!recovered.is_complete() && recovered.dropped[0].contains("seen space"), "{:?}", recovered.dropped);
        verifies(&at.join("again.slices"));
        if let Some(kept) = Archive::open(at.join("again.slices")).unwrap().seen_space(MOST).unwrap() {
            assert!(
                kept.cells() < space.cells()
                    && kept
                        .pages()
                        .all(|(key, page)| { space.pages().any(|(other, whole)| other == key && page == whole) })
            );
        }
    }
    assert!(archive.seen_space(1000).unwrap_err().to_string().contains("seen space"));
}

#[test]
fn positions_are_needed_and_the_report_counts_cells() {
    let scan = house(20_000);
    let at = scan.at();
    let said = refuses(at, &[&["0.las", "-o", "x.slices"], &OPTIONS[..]].concat(), 2);
    assert!(said.contains("--stations") && said.contains("0.las"), "{said}");
    let said = refuses(at, &["0.las", "-o", "x.slices", "--stations", "stations.csv"], 2);
    assert!(said.contains("--free-space"), "{said}");
    let out = sliceconv(
        at,
        &[&["0.las", "1.las", "2.las", "-o", "out.slices", "--json", "--stations", "stations.csv"], &OPTIONS[..]]
            .concat(),
    );
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let table = Archive::open(at.join("out.slices")).unwrap().seen_table().unwrap().unwrap();
    assert_eq!(report["seen"]["cells"], table.cells());
    assert_eq!(report["seen"]["bytes"], table.bytes());
    assert!(table.cells() > 10_000);
}
