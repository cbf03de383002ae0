//! `--remove-moving` removes people who walked through a scan and keeps what stands still, whatever the order, threads
//! and memory.

use crate::coloured;
use crate::scans;
use crate::write;

use nalgebra::Point3;
use scangen::sample::{Mode, ScannerSpec};
use scangen::shape::{Cylinder, Shape};
use scangen::{Kind, Params, Sample, SampleSpec, Scene, Surface, WriteSpec, write_samples};
use scans::{Random, converts, refuses, sliceconv, verifies};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, ColourReader};
use slicewalk::frame::{Frame, PAGE_SLICES, TILE_PIXELS};
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::path::Path;

const PIXEL_M: f64 = 0.05;
const OPTIONS: [&str; 8] = ["--pixel", "0.05", "--units", "m", "--quiet", "--force", "--threads", "2"];

/// Points of one station, rounded as in the file.
fn scan(scene: &Scene, at: [f64; 3], rays: u64, people: usize, seed: u64, path: &Path) -> Vec<Sample> {
    let scanner = ScannerSpec { stations: vec![at], people, clearance_m: 0.15, ..ScannerSpec::default() };
    let spec = SampleSpec { mode: Mode::Scanner(scanner), ..SampleSpec::scanner(rays) }.with_noise(0.003);
    let write = WriteSpec::for_path(path);
    let samples: Vec<Sample> = scene.samples(seed, &spec).unwrap().collect();
    write_samples(path, samples.iter().copied(), &write).unwrap();
    samples.into_iter().map(|s| Sample { position: write.rounded(s.position).unwrap(), ..s }).collect()
}

/// Writes the table of stations.
fn table(folder: &Path, stations: &[([f64; 3], &str)]) {
    let lines: Vec<String> = stations.iter().map(|([x, y, z], name)| format!("{name},{x},{y},{z}\n")).collect();
    fs::write(folder.join("stations.csv"), format!("file,x,y,z\n{}", lines.concat())).unwrap();
}

/// Converts the scans of `names` without moving objects; returns the archive, the removed points, and the report.
fn convert(at: &Path, names: &[&str], options: &[&str]) -> (Vec<u8>, Vec<u8>, serde_json::Value) {
    let moving =
        ["--remove-moving", "--stations", "stations.csv", "--removed", "gone.las", "--json", "-o", "out.slices"];
    let out = sliceconv(at, &[names, &OPTIONS, &moving, options].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let report = serde_json::from_slice(&out.stdout).unwrap();
    (fs::read(at.join("out.slices")).unwrap(), fs::read(at.join("gone.las")).unwrap(), report)
}

#[test]
fn scanners_of_e57_and_ptx_need_no_table() {
    /// A step that floats and LAS represent exactly.
    const STEP: f64 = 1.0 / 1024.0;
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = Scene::named("hall", &Params::new()).unwrap();
    let round = |p: [f64; 3]| p.map(|v| (v / STEP).round() * STEP);
    let clouds: Vec<([f64; 3], Vec<[f64; 3]>)> = (1..)
        .zip(scene.stations())
        .map(|(seed, station)| {
            let scanner = ScannerSpec { stations: vec![*station], people: 2, ..ScannerSpec::default() };
            let spec = SampleSpec { mode: Mode::Scanner(scanner), ..SampleSpec::scanner(60_000) };
            (round(*station), scene.samples(seed, &spec).unwrap().map(|sample| round(sample.position)).collect())
        })
        .collect();
    let names: Vec<String> = (0..clouds.len()).map(|number| format!("{number}.las")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for (name, (_, points)) in names.iter().zip(&clouds) {
        scans::write_as(&at.join(name), points, STEP, [0.0; 3]);
    }
    table(at, &clouds.iter().map(|cloud| cloud.0).zip(names.iter().copied()).collect::<Vec<_>>());
    let (archive, _, report) = convert(at, &names, &[]);
    assert!(report["points_moving"].as_u64().unwrap() > 1000, "{report}");
    write::e57_of_stations(&at.join("all.e57"), &clouds);
    write::e57_of_stations(&at.join("two.e57"), &clouds[..2]);
    fs::write(at.join("all.ptx"), write::ptx_of_stations(&clouds)).unwrap();
    fs::write(at.join("all.ptx.zst"), zstd::encode_all(&fs::read(at.join("all.ptx")).unwrap()[..], 1).unwrap())
        .unwrap();
    fs::write(at.join("others.ptx"), write::ptx_of_stations(&clouds[2..])).unwrap();
    for inputs in [&["all.e57"][..], &["all.ptx"], &["all.ptx.zst"], &["two.e57", "others.ptx"]] {
        converts(at, &[inputs, &OPTIONS, &["--remove-moving", "-o", "out.slices"]].concat());
        assert!(fs::read(at.join("out.slices")).unwrap() == archive, "{inputs:?}");
    }
    // A table takes precedence, and need not name files that state their own position.
    table(at, &clouds[2..].iter().map(|cloud| cloud.0).zip(names[2..].iter().copied()).collect::<Vec<_>>());
    convert(at, &[&["two.e57"], &names[2..]].concat(), &[]);
    assert!(fs::read(at.join("out.slices")).unwrap() == archive);
    let moved = [(clouds[0].0, "two.e57"), (clouds[2].0, "others.ptx")];
    table(at, &moved);
    assert!(convert(at, &["two.e57", "others.ptx"], &[]).0 != archive);

    let turned = |from: &str, to: &str| fs::read_to_string(at.join("others.ptx")).unwrap().replace(from, to);
    let [x, y, z] = clouds[2].0;
    let (stated, moved) = (format!("\n{x} {y} {z}\n"), format!("\n{x} {y} {z} 1\n"));
    fs::write(at.join("differ.ptx"), turned(&stated, "\n7 8 9\n")).unwrap();
    fs::write(at.join("zero.ptx"), turned(&stated, "\n0 0 0\n")).unwrap();
    fs::write(at.join("origin.ptx"), write::ptx_of_stations(&[([0.0; 3], vec![[1.0; 3]]), ([0.0; 3], vec![[2.0; 3]])]))
        .unwrap();
    fs::write(at.join("plain.xyz"), "1 2 3\n").unwrap();
    let plain = write::Cloud { points: &[[1.0; 3]], form: write::E57::Double, posed: false, mixed: false };
    write::e57(&at.join("plain.e57"), &[plain], None);
    assert!(fs::read_to_string(at.join("differ.ptx")).unwrap().contains(&moved));
    let options = [&OPTIONS[..], &["--remove-moving", "-o", "x.slices"]].concat();
    for (name, words) in [
        ("differ.ptx", "cloud 1: scanner position and matrix name different places"),
        ("origin.ptx", "2 clouds state the origin"),
        ("plain.xyz", "text does not say where the scanner stood"),
        ("plain.e57", "cloud 1 has no pose"),
        ("0.las", "LAS does not say where the scanner stood"),
    ] {
        let said = refuses(at, &[&["two.e57", name], &options[..]].concat(), 2);
        assert!(said.contains(words) && said.contains(name) && said.contains("--stations"), "{said}");
        refuses(at, &[&["two.e57", name, "--dry-run"], &options[..]].concat(), 2);
    }
    converts(at, &[&["two.e57", "zero.ptx"], &options[..]].concat());
    assert!(fs::read(at.join("x.slices")).unwrap() == archive, "a position of 0 0 0 says nothing");
}

/// The points of a plain LAS file.
fn read(path: &Path) -> Vec<[f64; 3]> {
    let bytes = fs::read(path).unwrap();
    let float = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let start = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    let len = usize::from(u16::from_le_bytes(bytes[105..107].try_into().unwrap()));
    let axis = |record: &[u8], axis: usize| {
        let raw = i32::from_le_bytes(record[4 * axis..4 * axis + 4].try_into().unwrap());
        f64::from(raw) * float(131 + 8 * axis) + float(155 + 8 * axis)
    };
    bytes[start..].chunks_exact(len).map(|record| [0, 1, 2].map(|at| axis(record, at))).collect()
}

/// Positions of the points in a LAS file, as cells of 1/128 pixel and whole millimetres.
fn places_of(path: &Path) -> HashSet<[i64; 3]> {
    read(path).into_iter().map(cell).collect()
}

fn cell([x, y, z]: [f64; 3]) -> [i64; 3] {
    let sub = |v: f64| (v * (1.0 / PIXEL_M) * 128.0).floor() as i64;
    [sub(x), sub(y), (z * 1000.0).round() as i64]
}

fn is_among(gone: &HashSet<[i64; 3]>, p: [f64; 3]) -> bool {
    let [x, y, z] = cell(p);
    (-1..=1).any(|dz| gone.contains(&[x, y, z + dz]))
}

#[test]
#[ignore = "slow: .ci/run"]
fn walkers_go_and_what_stands_stays_beside_glass_mirrors_plants_and_clutter() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = Scene::named("hall", &Params::new()).unwrap();
    let names: Vec<String> = (0..scene.stations().len()).map(|n| format!("{n}.las")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut samples = Vec::new();
    for (number, (station, name)) in scene.stations().iter().zip(&names).enumerate() {
        samples.extend(scan(&scene, *station, 300_000, 2, number as u64 + 1, &at.join(name)));
    }
    let stations: Vec<_> = scene.stations().iter().copied().zip(names.iter().copied()).collect();
    table(at, &stations);
    let (archive, removed, report) = convert(at, &names, &[]);
    verifies(&at.join("out.slices"));
    let gone = places_of(&at.join("gone.las"));
    let share = |wanted: &dyn Fn(&Sample) -> bool| {
        let all: Vec<_> = samples.iter().filter(|sample| wanted(sample)).collect();
        let lost = all.iter().filter(|sample| is_among(&gone, sample.position)).count();
        (lost as f64 / all.len().max(1) as f64, all.len())
    };
    let moving = share(&|sample| sample.kind == Kind::Moving);
    let standing = share(&|sample| sample.kind == Kind::Surface);
    for label in ["floor", "ceiling", "wall", "reveal", "glass", "leaf", "stem", "pot", "clutter"] {
        let of =
            |sample: &Sample| sample.kind == Kind::Surface && scene.surfaces()[sample.surface as usize].label == label;
        println!("{label}: {:?}", share(&of));
    }
    println!("moving {moving:?}, standing {standing:?}");
    println!("mixed {:?}", share(&|s| s.kind == Kind::Mixed));
    println!("mirrored {:?}", share(&|s| s.kind == Kind::Outlier));
    assert!(moving.1 > 10_000 && moving.0 >= 0.95, "{moving:?}");
    assert!(standing.0 <= 0.01, "{standing:?}");
    assert_eq!(
        report["points_moving"].as_u64().unwrap() + report["points_kept"].as_u64().unwrap(),
        samples.len() as u64
    );
    assert_eq!(report["points_read"], samples.len(), "those that were removed were read");
    assert_eq!(report["remove_moving"], true);

    // Another order, other threads, a small memory budget.
    for name in &names {
        let mut own = read(&at.join(name));
        Random(5).shuffle(&mut own);
        scans::write(&at.join(name), &own);
    }
    let mut turned = names.clone();
    turned.rotate_left(2);
    // By 32 threads in strips of rows.
    let few = ["--memory", "100MiB", "--threads"];
    for options in [&["--threads", "1"][..], &[&few[..], &["4"]].concat(), &[&few[..], &["32"]].concat()] {
        let options: Vec<&str> = OPTIONS[..6].iter().chain(options).copied().collect();
        let moving = ["--remove-moving", "--stations", "stations.csv", "--removed", "gone.las", "-o", "out.slices"];
        converts(at, &[&turned[..], &options, &moving].concat());
        assert!(fs::read(at.join("out.slices")).unwrap() == archive, "{options:?}");
        assert!(fs::read(at.join("gone.las")).unwrap() == removed, "{options:?}");
    }
}

#[test]
fn a_doorway_that_somebody_stood_in_opens() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let hall = Scene::named("hall", &Params::new()).unwrap();
    let mut with_person = hall.surfaces().to_vec();
    let shape = Shape::Cylinder(Cylinder { center: [8.07, 4.5], radius: 0.25, z_min: 0.0, z_max: 1.75 });
    with_person.push(Surface { shape, label: "person" });
    let occupied = Scene::new("hall", with_person);
    let stations = hall.stations();
    scan(&occupied, stations[0], 200_000, 0, 1, &at.join("a.las"));
    scan(&hall, stations[3], 200_000, 0, 2, &at.join("b.las"));
    scan(&hall, stations[2], 200_000, 0, 3, &at.join("c.las"));
    table(at, &[(stations[0], "a.las"), (stations[3], "b.las"), (stations[2], "c.las")]);
    let names = ["a.las", "b.las", "c.las"];
    let door = Aabb::new([7.8, 4.2, 0.15].into(), [8.3, 4.8, 1.9].into()).unwrap();
    let is_open = || {
        let archive = Archive::open(at.join("out.slices")).unwrap();
        overlaps(&Snapshot::resident(&archive, &NoMonitor).unwrap(), &door) == Overlap::Clear
    };
    converts(at, &[&names[..], &OPTIONS, &["-o", "out.slices"]].concat());
    assert!(!is_open(), "without stations the ghost stays");
    convert(at, &names, &[]);
    assert!(is_open());
}

/// Writes samples in a point format with GPS times, 0.01 ms apart, and with these point source ids if the file is not
/// compressed.
fn write_tagged(path: &Path, format: u8, samples: &[Sample], id: impl Fn(usize) -> u16) {
    let spec = WriteSpec { format, ..WriteSpec::for_path(path) };
    write_samples(path, samples.iter().copied(), &spec).unwrap();
    if spec.compression.is_none() {
        let mut bytes = fs::read(path).unwrap();
        let start = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
        let len = usize::from(u16::from_le_bytes(bytes[105..107].try_into().unwrap()));
        let at = if format < 6 { 18 } else { 20 };
        for (number, record) in bytes[start..].chunks_exact_mut(len).take(samples.len()).enumerate() {
            record[at..at + 2].copy_from_slice(&id(number).to_le_bytes());
        }
        fs::write(path, bytes).unwrap();
    }
}

/// Writes samples as LAZ in layers with these point source ids.
fn write_packed(path: &Path, format: u8, samples: &[Sample], id: impl Fn(usize) -> u16) {
    let mut builder = las::Builder::from((1, 4));
    builder.point_format = las::point::Format::new(format).unwrap();
    builder.point_format.is_compressed = true;
    let has_colour = builder.point_format.has_color;
    let mut writer = las::Writer::from_path(path, builder.into_header().unwrap()).unwrap();
    for (number, sample) in samples.iter().enumerate() {
        let [x, y, z] = sample.position;
        let color = has_colour.then(|| las::Color::new(1, 2, 3));
        let point_source_id = id(number);
        writer
            .write_point(las::Point { x, y, z, color, point_source_id, gps_time: Some(0.5), ..las::Point::default() })
            .unwrap();
    }
    writer.close().unwrap();
}

#[test]
#[ignore = "slow: .ci/run"]
fn stations_by_source_id_and_by_time_do_what_files_of_their_own_do() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = Scene::named("hall", &Params::new()).unwrap();
    let names = ["0.las", "1.las", "2.las"];
    let stations: Vec<[f64; 3]> = scene.stations()[..3].to_vec();
    let mut samples = Vec::new();
    let mut ends = Vec::new();
    for (seed, (name, station)) in (1..).zip(names.iter().zip(&stations)) {
        samples.extend(scan(&scene, *station, 60_000, 3, seed, &at.join(name)));
        ends.push(samples.len());
    }
    table(at, &stations.iter().copied().zip(names).collect::<Vec<_>>());
    let (archive, removed, report) = convert(at, &names, &[]);
    assert!(report["points_moving"].as_u64().unwrap() > 300, "{report}");

    let of = |number: usize| ends.iter().filter(|end| **end <= number).count();
    let ids = [700u16, 0, 65535];
    for format in [0, 1, 6, 7] {
        write_tagged(&at.join("all.las"), format, &samples, |number| ids[of(number)]);
        for other in ["0", ""] {
            let [a, b, c] = [0, 1, 2].map(|n| stations[n].map(|v| v.to_string()).join(","));
            let text = format!("source_id,x,y,z,file\n700,{a},all.las\n{other},{b},all.las\n65535,{c},all.las\n");
            fs::write(at.join("stations.csv"), text).unwrap();
            assert!(convert(at, &["all.las"], &[]).0 == archive, "format {format}, {other:?}");
        }
    }
    for format in [6, 7] {
        write_packed(&at.join("ids.laz"), format, &samples, |number| ids[of(number)]);
        let table = fs::read_to_string(at.join("stations.csv")).unwrap();
        fs::write(at.join("stations.csv"), table.replace("all.las", "ids.laz")).unwrap();
        assert!(convert(at, &["ids.laz"], &[]).0 == archive, "packed, format {format}");
    }
    // From setup to setup in no time.
    let mut text = String::from("file,t,x,y,z\n");
    let mut begin = 0;
    for ([x, y, z], end) in stations.iter().zip(&ends) {
        for index in [begin as f64 - 0.5, *end as f64 - 0.75] {
            text += &format!("NAME,{},{x},{y},{z}\n", index * 1e-5);
        }
        begin = *end;
    }
    for (name, format) in
        [("all.las", 1), ("all.las", 3), ("all.las", 6), ("packed.laz", 1), ("packed.laz", 6), ("packed.laz", 7)]
    {
        write_tagged(&at.join(name), format, &samples, |_| 0);
        fs::write(at.join("stations.csv"), text.replace("NAME", name)).unwrap();
        let (own, gone, _) = convert(at, &[name], &[]);
        assert!(own == archive && gone == removed, "{name}, format {format}");
    }
    // Points without a station.
    let said = |table: &str, name: &str| {
        fs::write(at.join("stations.csv"), table).unwrap();
        let moving = ["--remove-moving", "--stations", "stations.csv", "-o", "x.slices"];
        refuses(at, &[&[name], &OPTIONS[..], &moving].concat(), 1)
    };
    let late = said("file,t,x,y,z\npacked.laz,0.1,1,2,3\npacked.laz,9,1,2,3\n", "packed.laz");
    assert!(late.contains("packed.laz") && late.contains("gps time") && late.contains("0.1 to 9"), "{late}");
    write_tagged(&at.join("all.las"), 0, &samples, |number| ids[of(number)]);
    let id = said("file,source_id,x,y,z\nall.las,700,1,2,3\nall.las,65535,1,2,3\n", "all.las");
    assert!(id.contains("all.las") && id.contains("point source id 0 has no station"), "{id}");
    let times = said("file,t,x,y,z\nall.las,0,1,2,3\nall.las,9,1,2,3\n", "all.las");
    assert!(times.contains("stations.csv: line 2: the points of all.las have no gps times"), "{times}");
}

#[test]
fn a_scanner_that_is_carried_sees_through_who_has_gone() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let hall = Scene::named("hall", &Params::new().with("leaves", 0.0)).unwrap();
    let person = |sample: &Sample| {
        let [x, y, z] = sample.position;
        (x - 4.0).hypot(y - 6.6) < 0.22 && (0.05..1.8).contains(&z)
    };
    let mut with_person = hall.surfaces().to_vec();
    let shape = Shape::Cylinder(Cylinder { center: [4.0, 6.6], radius: 0.2, z_min: 0.0, z_max: 1.75 });
    with_person.push(Surface { shape, label: "person" });
    let occupied = Scene::new("hall", with_person);
    let (mut samples, mut text) = (Vec::new(), String::from("file,t,x,y,z\n"));
    let places = 48;
    for number in 0..=places {
        let station = [2.0 + 0.05 * f64::from(number), 2.5, 1.7];
        text +=
            &format!("way.laz,{},{},{},{}\n", samples.len() as f64 * 1e-5 - 5e-6, station[0], station[1], station[2]);
        if number < places {
            let scene = if number < 12 { &occupied } else { &hall };
            samples.extend(scan(scene, station, 20_000, 0, number as u64 + 1, &at.join("one.las")));
        }
    }
    write_tagged(&at.join("way.laz"), 6, &samples, |_| 0);
    fs::write(at.join("stations.csv"), text).unwrap();
    let (archive, removed, _) = convert(at, &["way.laz"], &[]);
    let gone = places_of(&at.join("gone.las"));
    let share = |wanted: &dyn Fn(&Sample) -> bool| {
        let all: Vec<_> = samples.iter().filter(|sample| wanted(sample)).collect();
        let lost = all.iter().filter(|sample| is_among(&gone, sample.position)).count();
        (lost as f64 / all.len().max(1) as f64, all.len())
    };
    let (moving, standing) = (share(&person), share(&|sample| !person(sample)));
    println!("person {moving:?}, others {standing:?}");
    assert!(moving.1 > 300 && moving.0 > 0.5, "{moving:?}");
    assert!(standing.0 < 0.001, "{standing:?}");
    let (again, gone, _) = convert(at, &["way.laz"], &["--memory", "200MiB"]);
    assert!(again == archive && gone == removed);
    // It saw the air between its way and the person, and nothing below the floor.
    let seen = ["way.laz", "--free-space", "--stations", "stations.csv", "-o", "seen.slices"];
    converts(at, &[&seen[..], &OPTIONS].concat());
    verifies(&at.join("seen.slices"));
    let space = Archive::open(at.join("seen.slices")).unwrap().seen_space(1 << 30).unwrap().unwrap();
    assert_eq!([1.4, -1.0].map(|z| space.is_seen(Point3::new(3.4, 4.1, z))), [true, false]);
}

#[test]
fn tables_that_are_wrong_and_options_that_do_not_go_together_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scans::write(&at.join("a.las"), &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]);
    scans::write(&at.join("b.las"), &[[0.0, 1.0, 0.0]]);
    let names = ["a.las", "b.las", "-o", "x.slices"];
    let good = "file,x,y,z\na.las,0,0,1\n\"b.las\",1,1,1\n";
    fs::write(at.join("s.csv"), good).unwrap();
    let moving = ["--remove-moving", "--stations", "s.csv"];
    for (options, code) in [
        (&["--remove-moving"][..], 2),
        (&["--stations", "s.csv"], 2),
        (&["--removed", "r.las"], 2),
        (&["--remove-moving", "--stations", "none.csv"], 1),
    ] {
        refuses(at, &[&names[..], &OPTIONS, options].concat(), code);
    }
    // Points of meshes could be taken for points that moved; triangles cannot.
    fs::write(at.join("m.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let with_mesh = [&["m.obj"][..], &names, &OPTIONS, &moving].concat();
    converts(at, &with_mesh);
    for more in [&[][..], &["--dry-run"], &["--shard", "1/2"]] {
        let said = refuses(at, &[&with_mesh[..], &["--mesh", "sampled"], more].concat(), 2);
        assert!(said.contains("m.obj: points sampled from meshes"), "{said}");
    }
    for (text, word) in [
        ("", "file,x,y,z"),
        ("file,x,y\na.las,0,0\n", "file,x,y,z"),
        ("file,x,y,z\na.las,0,0,1\n", "b.las has no station"),
        ("file,x,y,z\na.las,0,0,1\nb.las,0,nan,1\n", "line 3: expected a number"),
        ("file,x,y,z\na.las,0,0,1\nb.las,0,1\n", "line 3: expected 4 fields"),
        ("file,x,y,z\na.las,0,0,1\nc.las,0,0,1\n", "line 3: no input is called"),
        ("file,x,y,z\n,0,0,1\n", "line 2: no input is called"),
        ("file,x,y,z\na.las,0,0,1\na.las,0,0,1\n", "line 3"),
        ("file,x,y,z\na.las,1e300,0,1\n\"b.las\",0,0,1\n", "line 2: (1e300, 0, 1) is beyond the coordinates of a.las"),
        ("file,x,y,z\na.las,0,0,-2e12\n", "is beyond the coordinates"),
        ("file,x,y,z\na.las,0,0,1\n\"b.las,0,0,1\n", "line 3: an opening quote without its end"),
        ("file,x,y,z\na.las,0,0,1\nb.las,0,0,\"1\n", "line 3: an opening quote without its end"),
        ("file,x,y,z\n\"a\".las,0,0,1\n", "line 2: text behind a closing quote"),
        ("file,x,y,z,x\na.las,0,0,1,2\n", "two columns are named \"x\""),
        ("file,t,x,y,z\na.las,0,0,0,1\n", "have no gps times"),
        ("file,t,source_id,x,y,z\na.las,0,0,0,0,1\n", "expected source_id or t"),
        ("file,source_id,x,y,z\na.las,70000,0,0,1\n", "line 2: expected a source id (0 to 65535)"),
        ("file,source_id,x,y,z\na.las,-1,0,0,1\n", "line 2: expected a source id"),
        ("file,source_id,x,y,z\na.las,7,0,0,1\na.las,7,0,1,1\n", "line 3: a.las has a station for source id 7 already"),
        ("file,source_id,x,y,z\na.las,,0,0,1\na.las,,0,1,1\n", "line 3: a.las has a station for all other source ids"),
        ("file,source_id,x,y,z\na.las,,0,0,1\n", "b.las has no station"),
        ("file,t,x,y,z\nt.las,0,0,0,1\na.las,0,0,0,1\n", "no input is called"),
    ] {
        fs::write(at.join("s.csv"), text).unwrap();
        let said = refuses(at, &[&names[..], &OPTIONS, &moving].concat(), 1);
        assert!(said.contains("s.csv") && said.contains(word), "{word}: {said}");
    }
    let samples = Scene::named("plane", &Params::new()).unwrap();
    let spec = SampleSpec::direct_density(2.0);
    write_samples(
        &at.join("b.las"),
        samples.samples(1, &spec).unwrap(),
        &WriteSpec { format: 1, ..WriteSpec::default() },
    )
    .unwrap();
    for (text, word) in [
        ("file,t,x,y,z\nb.las,0,0,0,1\n", "b.las has one place only"),
        ("file,t,x,y,z\nb.las,0,0,0,1\nb.las,9,0,0,2\nb.las,0,3,0,1\n", "b.las has two places at gps time 0"),
        ("file,t,x,y,z\nb.las,0,0,0,1\nb.las,inf,0,0,2\n", "line 3: expected a number"),
        ("file,t,x,y,z\nb.las,,0,0,1\nb.las,1,0,0,2\n", "line 2: expected a number"),
        ("file,t,x,y,z\nb.las,0,0,0,1\nb.las,1e9,1e9,0,2\n", "pieces"),
        ("file,t,x,y,z\nb.las,0,0,0,1\nb.las,100,1000,0,2\n", "memory for what"),
    ] {
        fs::write(at.join("s.csv"), text).unwrap();
        for end in [&["-o", "x.slices"][..], &["--dry-run"]] {
            let said = refuses(at, &[&["b.las"][..], end, &OPTIONS, &moving].concat(), 1);
            assert!(said.contains(word), "{word}: {said}");
        }
    }
    // Tables that are too long or no text, points without ids, and a scanner farther out than any point may be.
    let refused = |input: &str, more: &[&str], code: i32, word: &str| {
        let said = refuses(at, &[&[input, "-o", "x.slices"], &OPTIONS[..], more].concat(), code);
        assert!(said.contains(word), "{word}: {said}");
    };
    fs::File::create(at.join("s.csv")).unwrap().set_len((64 << 20) + 1).unwrap();
    refused("b.las", &moving, 1, "bytes of the stations s.csv");
    fs::write(at.join("s.csv"), b"file,x,y,z\nb\xFF.las,0,0,1\n").unwrap();
    refused("b.las", &moving, 1, "s.csv: cannot read");
    fs::write(at.join("s.csv"), "file,source_id,x,y,z\nc.xyz,7,0,0,1\n").unwrap();
    fs::write(at.join("c.xyz"), "0 0 0\n1 0 0\n0 1 0\n").unwrap();
    refused("c.xyz", &moving, 1, "line 2: the points of c.xyz have no point source ids");
    let unmoved = "1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1";
    fs::write(at.join("far.ptx"), format!("1\n1\n1e13 0 1\n{unmoved}\n1 2 3 0.5\n")).unwrap();
    refused("far.ptx", &["--remove-moving"], 2, "its scanner stood beyond all coordinates");
    // Clouds without points need no station, though two at the origin would be refused.
    let clouds = [([1.0, 2.0, 1.0], vec![[0.0; 3], [1.0, 0.0, 0.0]]), ([0.0; 3], vec![]), ([0.0; 3], vec![])];
    fs::write(at.join("empty.ptx"), write::ptx_of_stations(&clouds)).unwrap();
    converts(at, &[&["empty.ptx", "-o", "x.slices", "--remove-moving"], &OPTIONS[..]].concat());
    // A point at the place of the scanner, and one beyond its sight.
    scans::write(&at.join("a.las"), &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [900.0, 0.0, 0.0]]);
    scans::write(&at.join("b.las"), &[[0.0, 1.0, 0.0]]);
    fs::write(at.join("s.csv"), good).unwrap();
    // An input, the archive itself, and a folder that is missing, with and without the work.
    for removed in ["s.csv", "a.las", "new.slices", "./new.slices", "none/r.las"] {
        let outputs = ["-o", "new.slices", "--removed", removed];
        let whole = [&["a.las", "b.las"][..], &outputs, &OPTIONS, &moving].concat();
        for more in [&[][..], &["--dry-run"]] {
            let said = refuses(at, &[&whole[..], more].concat(), 1);
            assert!(said.contains(removed) && !at.join("new.slices").exists(), "{removed}: {said}");
        }
    }
    let out = sliceconv(at, &[&names[..], &OPTIONS, &moving, &["--json"]].concat());
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((&report["points_kept"], &report["points_moving"]), (&5.into(), &0.into()));
    // Without any kept point there are no bounds, and the file of removed points begins at the origin.
    converts(at, &[&names[..], &OPTIONS, &moving, &["--exclude-class", "0-255", "--removed", "none.las"]].concat());
    let bytes = fs::read(at.join("none.las")).unwrap();
    assert_eq!((&bytes[155..179], bytes.len()), (&[0; 24][..], 375));
}

/// Sums of red and of points, by pixel and slice.
type Reds = BTreeMap<[i64; 3], (u64, u64)>;

fn reds(frame: &Frame, points: impl Iterator<Item = coloured::Coloured>) -> Reds {
    let mut sums = Reds::new();
    for point in points {
        let [x, y, z] = point.at;
        let sum = sums.entry([frame.pixel_of(x), frame.pixel_of(y), frame.slice_of(z)]).or_default();
        *sum = (sum.0 + u64::from(point.rgb[0]), sum.1 + 1);
    }
    sums
}

#[test]
fn what_is_removed_takes_its_colours_along() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = Scene::named("hall", &Params::new()).unwrap();
    let names: Vec<String> = (0..scene.stations().len()).map(|n| format!("{n}.las")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut all = Vec::new();
    for (number, (station, name)) in scene.stations().iter().zip(&names).enumerate() {
        let samples = scan(&scene, *station, 120_000, 2, number as u64 + 1, &at.join(name));
        // Moving people are red.
        let of = |sample: &Sample| coloured::Coloured {
            at: sample.position,
            rgb: [if sample.kind == Kind::Moving { 65_535 } else { 200 }, 10_000, 300],
            intensity: 1,
        };
        let points: Vec<_> = samples.iter().map(of).collect();
        coloured::las(&at.join(name), &points, 0.001);
        all.extend(points);
    }
    let stations: Vec<_> = scene.stations().iter().copied().zip(names.iter().copied()).collect();
    table(at, &stations);
    let (plain, removed, _) = convert(at, &names, &[]);
    let pages = Archive::from_bytes(plain).unwrap();
    let colour = ["--colour", "rgb", "--colour-error", "0"];
    let (coloured, same_removed, _) = convert(at, &names, &colour);
    verifies(&at.join("out.slices"));
    assert!(removed == same_removed);
    let archive = Archive::from_bytes(coloured.clone()).unwrap();
    assert_eq!(archive.header().voxels, pages.header().voxels);
    assert_eq!(archive.header().points_kept, pages.header().points_kept);
    let gone = places_of(&at.join("gone.las"));
    let expected = reds(archive.frame(), all.iter().filter(|point| !is_among(&gone, point.at)).copied());
    let with_all = reds(archive.frame(), all.iter().copied());
    let mut reader = ColourReader::new(&archive).unwrap().unwrap();
    let (mut compared, mut wrong, mut cleaner) = (0, 0, 0);
    for entry in archive.entries().map(Result::unwrap) {
        for (px, py, k, found) in reader.colours(&entry).unwrap().voxels() {
            let pixel = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
            let key = entry.key;
            let place = [pixel(key.tx, px), pixel(key.ty, py), i64::from(key.layer) * PAGE_SLICES + i64::from(k)];
            let (Some(found), Some(&(sum, n))) = (found, expected.get(&place)) else { continue };
            let red = |(sum, n): (u64, u64)| sum as f64 / n as f64 / 257.0;
            compared += 1;
            wrong += u32::from((f64::from(found[0]) - red((sum, n))).abs() > 0.51);
            cleaner += u32::from(red(with_all[&place]) > red((sum, n)) + 5.0);
        }
    }
    println!("{compared} voxels, {wrong} wrong, {cleaner} without those who moved");
    // Positions of removed points are rounded.
    assert!(compared > 10_000 && wrong * 500 < compared && cleaner > 20, "{compared} {wrong} {cleaner}");
    for options in [["--threads", "1", "--memory", "100MiB"], ["--threads", "4", "--memory", "256MiB"]] {
        let options: Vec<&str> = OPTIONS[..6].iter().chain(&options).chain(&colour).copied().collect();
        let moving = ["--remove-moving", "--stations", "stations.csv", "-o", "again.slices"];
        converts(at, &[&names[..], &options, &moving].concat());
        assert!(fs::read(at.join("again.slices")).unwrap() == coloured, "{options:?}");
    }
}
