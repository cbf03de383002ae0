//! C99, C++17 and Python programs that use the library, as gcc and clang compile them with sanitizers.

use engine::NoMonitor;
use engine::archive::Archive;
use engine::nalgebra::{Point3, Vector3};
use engine::query::{Aabb, Cylinder, Overlap, Ray, Sphere, cast, floor_between, nearest_surface, overlaps, sweep};
use engine::reach::{Flood, Pawn, StandingPlaces};
use engine::seen::SeenSpace;
use engine::store::Snapshot;
use engine::walk::Body;
use scangen::sample::{Mode, ScannerSpec};
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, OnceLock};

/// A flight of stairs, and the library that the programs link with.
struct Set {
    folder: tempfile::TempDir,
    archive: PathBuf,
    /// Folder of the libraries.
    built: PathBuf,
    ends: [[f64; 3]; 2],
}

fn set() -> &'static Set {
    static SET: OnceLock<Set> = OnceLock::new();
    SET.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (scan, archive) = (folder.path().join("scan.las"), folder.path().join("stairs.slices"));
        let scene = Scene::named("stairs", &Params::new()).unwrap();
        let samples = scene.samples(1, &SampleSpec::direct_density(3600.0)).unwrap();
        write_samples(&scan, samples, &WriteSpec::for_path(&scan)).unwrap();
        let mut options = ConvertOptions::new(vec![scan], archive.clone());
        options.grid.pixel = PixelSize::Metres(0.05);
        options.reading.units = Units::Factor(1.0);
        options.resources.threads = 1;
        convert(&options, &NoMonitor).unwrap();
        let walk = scene.walk().expect("the stairs have a walk");
        Set { archive, built: build(), ends: [walk.start, walk.end], folder }
    })
}

/// Builds the libraries with the profile of this test, and returns their folder: or that of libraries just built,
/// SLICEWALK_C_LIBRARIES.
fn build() -> PathBuf {
    if let Some(built) = std::env::var_os("SLICEWALK_C_LIBRARIES") {
        return built.into();
    }
    let test = std::env::current_exe().unwrap();
    let folder = test.ancestors().nth(2).unwrap().to_path_buf();
    let profile = folder.file_name().unwrap().to_str().unwrap();
    let profile = if profile == "debug" { "dev" } else { profile };
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(["build", "--quiet", "-p", "slicewalk-c", "--profile", profile, "--target-dir"]);
    run(command.arg(folder.parent().unwrap()).current_dir(env!("CARGO_MANIFEST_DIR")));
    folder
}

/// Runs a program, which must succeed, and returns what it prints.
fn run(command: &mut Command) -> String {
    let done = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{command:?}: {}\n{text}", done.status);
    String::from_utf8(done.stdout).unwrap()
}

fn is_there(program: &str) -> bool {
    let there = Command::new(program).arg("--version").output().is_ok_and(|done| done.status.success());
    if !there {
        println!("skipped: no {program} here");
    }
    there
}

/// Compiles `source` with `compiler` and runs it on the stairs.
fn check(compiler: &str, standard: &str, source: &str, is_static: bool) {
    if !is_there(compiler) {
        return;
    }
    let set = set();
    let numbers = set.ends.as_flattened().iter().map(f64::to_string);
    assert_eq!(run(compiled(compiler, standard, source, is_static).arg(&set.archive).args(numbers)), "done\n");
}

/// The program `source`, linked with the static or the shared library.
fn compiled(compiler: &str, standard: &str, source: &str, is_static: bool) -> Command {
    let (set, folder) = (set(), Path::new(env!("CARGO_MANIFEST_DIR")));
    let program = set.folder.path().join(format!("{source}-{compiler}-{is_static}"));
    let mut command = Command::new(compiler);
    command.args([standard, "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-g", "-O1"]);
    command.args(["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]);
    command.arg("-I").arg(folder.join("include")).arg(folder.join("tests/c").join(source)).arg("-o").arg(&program);
    if is_static {
        command.arg(set.built.join("libslicewalk.a"));
    } else {
        command.arg(set.built.join("libslicewalk.so")).arg(format!("-Wl,-rpath,{}", set.built.display()));
    }
    run(command.args(["-lpthread", "-ldl", "-lm"]));
    Command::new(program)
}

#[test]
fn a_c99_program_runs_compiled_by_gcc() {
    check("gcc", "-std=c99", "program.c", false);
    check("gcc", "-std=c99", "program.c", true);
}

#[test]
fn a_c99_program_runs_compiled_by_clang() {
    check("clang", "-std=c99", "program.c", false);
}

#[test]
fn a_cpp17_program_runs_compiled_by_gcc() {
    check("g++", "-std=c++17", "program.cpp", false);
}

#[test]
fn a_cpp17_program_runs_compiled_by_clang() {
    check("clang++", "-std=c++17", "program.cpp", true);
}

/// Numbers between 0 and 1, the same in every run.
fn unit(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

/// Installs headers, libraries and the file for pkg-config, as in `/usr/local`.
fn install(set: &Set, name: &str, libraries: &[&str]) -> PathBuf {
    let (prefix, source) = (set.folder.path().join(name), Path::new(env!("CARGO_MANIFEST_DIR")));
    for folder in ["include", "lib/pkgconfig"] {
        std::fs::create_dir_all(prefix.join(folder)).unwrap();
    }
    let copy = |from: PathBuf, to: String| std::fs::copy(from, prefix.join(to)).unwrap();
    for header in ["slicewalk.h", "slicewalk.hpp"] {
        copy(source.join("include").join(header), format!("include/{header}"));
    }
    for library in libraries {
        copy(set.built.join(library), format!("lib/{library}"));
    }
    copy(source.join("slicewalk.pc"), "lib/pkgconfig/slicewalk.pc".into());
    prefix
}

#[test]
fn programs_are_built_with_pkg_config() {
    if !is_there("pkg-config") || !is_there("cc") {
        return;
    }
    let (set, folder) = (set(), Path::new(env!("CARGO_MANIFEST_DIR")));
    for (name, library, kind) in [("shared", "libslicewalk.so", None), ("static", "libslicewalk.a", Some("--static"))] {
        let prefix = install(set, name, &[library]);
        let asked = |words: &[&str]| {
            let mut command = Command::new("pkg-config");
            run(command.env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig")).args(words).arg("slicewalk"))
        };
        assert_eq!(asked(&["--modversion"]).trim(), env!("CARGO_PKG_VERSION"));
        let program = prefix.join("program");
        let mut command = Command::new("cc");
        command.arg("-std=c99").arg(folder.join("tests/c/program.c")).arg("-o").arg(&program);
        let flags = asked(&["--cflags", "--libs"].into_iter().chain(kind).collect::<Vec<_>>());
        command.args(flags.split_whitespace()).args((name == "shared").then_some("-lm"));
        run(command.arg(format!("-Wl,-rpath,{}", prefix.join("lib").display())));
        let numbers = set.ends.as_flattened().iter().map(f64::to_string);
        assert_eq!(run(Command::new(program).arg(&set.archive).args(numbers)), "done\n", "{name}");
    }
}

#[test]
fn the_sample_for_unity_walks_compiled_by_mcs() {
    if !is_there("mcs") || !is_there("mono") {
        return;
    }
    let (set, folder) = (set(), Path::new(env!("CARGO_MANIFEST_DIR")));
    let program = set.folder.path().join("unity.exe");
    let mut command = Command::new("mcs");
    command.arg("-warnaserror").arg(format!("-out:{}", program.display()));
    run(command.arg(folder.join("samples/unity/SlicewalkPawn.cs")).arg(folder.join("tests/c/unity.cs")));
    let [x, y, z] = set.ends[0];
    let mut command = Command::new("mono");
    command.env("LD_LIBRARY_PATH", &set.built).arg(program).arg(&set.archive).arg(format!("{x} {y} {z}"));
    let said = run(&mut command);
    let end: Vec<f64> = said.split_whitespace().map(|number| number.parse().unwrap()).collect();
    // In Unity's axes, y is up: the pawn stands on the sixth or seventh step, of 0.17 m.
    let [x, up, across] = end[..] else { panic!("{said}") };
    assert!((2.5..2.7).contains(&x) && (0.9..1.3).contains(&up) && across.abs() < 0.01, "{said}");
}

#[test]
fn ctypes_gets_the_answers_of_the_library() {
    if !is_there("python3") {
        return;
    }
    let set = set();
    let store = Snapshot::resident(&Archive::open(&set.archive).unwrap(), &NoMonitor).unwrap();
    let (mut random, mut rows) = (7, String::new());
    let (mut hits, mut clear) = (0, 0);
    for _ in 0..500 {
        let at: [f64; 3] = std::array::from_fn(|axis| {
            let (low, high) = (set.ends[0][axis] - 1.5, set.ends[1][axis] + 1.5);
            low + (high - low) * unit(&mut random)
        });
        let size = 0.05 + unit(&mut random);
        let way: [f64; 3] = std::array::from_fn(|_| unit(&mut random) - 0.5);
        let shape = Aabb::new(at.into(), Point3::from(at) + Vector3::repeat(size)).unwrap();
        let code = |overlap| if overlap == Overlap::Hit { 1.0 } else { 0.0 };
        let ray = Ray::new(at.into(), way.into(), 20.0).unwrap();
        let expected = [
            code(overlaps(&store, &shape)),
            code(overlaps(&store, &Sphere::new(at.into(), size).unwrap())),
            code(overlaps(&store, &Cylinder::new(at.into(), size, 1.0).unwrap())),
            cast(&store, &ray).known().unwrap().map_or(f64::INFINITY, |hit| hit.distance),
            sweep(&store, &shape, way.into()).known().unwrap().map_or(1.0, |hit| hit.fraction),
            floor_between(&store, &shape, at[2], at[2] + size).known().unwrap().unwrap_or(f64::NEG_INFINITY),
            nearest_surface(&store, at.into(), 1.0).known().unwrap().map_or(f64::INFINITY, |found| found.distance),
        ];
        hits += usize::from(expected[0] == 1.0);
        clear += usize::from(expected[0] == 0.0);
        let numbers = at.iter().chain(&way).chain([&size]).chain(&expected);
        numbers.for_each(|number| write!(rows, "{number:?} ").unwrap());
        rows.push('\n');
    }
    assert!(hits > 50 && clear > 50, "{hits} hits and {clear} free boxes say little");
    let table = set.folder.path().join("rows.txt");
    std::fs::write(&table, rows).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/c/same.py");
    let library = set.built.join("libslicewalk.so");
    let printed = run(Command::new("python3").arg(script).arg(library).arg(&set.archive).arg(table));
    assert_eq!(printed, "500 rows are the same\n");
}

/// A storey of a house in which all surfaces were scanned, but one station looked around, in one room; with its seen
/// space, and without.
fn house(folder: &Path) -> [PathBuf; 2] {
    let scene = Scene::named("house", &Params::new().with("storeys", 1.0)).unwrap();
    let at = scene.stations()[0];
    let scanner = ScannerSpec { stations: vec![at], mixed_rate: 0.0, ..ScannerSpec::default() };
    let spec = SampleSpec { mode: Mode::Scanner(scanner), ..SampleSpec::scanner(200_000) };
    let seen = scene.samples(1, &spec).unwrap();
    let samples: Vec<_> = seen.chain(scene.samples(2, &SampleSpec::direct_density(300.0)).unwrap()).collect();
    let (scan, stations) = (folder.join("house.las"), folder.join("stations.csv"));
    write_samples(&scan, samples, &WriteSpec::for_path(&scan)).unwrap();
    std::fs::write(&stations, format!("file,x,y,z\nhouse.las,{},{},{}\n", at[0], at[1], at[2])).unwrap();
    [true, false].map(|is_seen| {
        let archive = folder.join(format!("house-{is_seen}.slices"));
        let mut options = ConvertOptions::new(vec![scan.clone()], archive.clone());
        options.grid.pixel = PixelSize::Metres(0.1);
        options.reading.units = Units::Factor(1.0);
        options.resources.threads = 1;
        options.sections.free_space = is_seen;
        options.stations = is_seen.then(|| stations.clone());
        convert(&options, &NoMonitor).unwrap();
        archive
    })
}

/// A table of places, boxes and rays with the answers of the library in Rust.
fn seen_rows(archive: &Path) -> String {
    let archive = Archive::open(archive).unwrap();
    let space = archive.seen_space(1 << 30).unwrap().unwrap();
    let store = Snapshot::resident(&archive, &NoMonitor).unwrap();
    let (low, high) = archive.header().bounds.unwrap();
    let (mut random, mut rows, mut counts) = (11, String::new(), [[0; 2]; 3]);
    for _ in 0..600 {
        let at: [f64; 3] = std::array::from_fn(|axis| low[axis] + (high[axis] - low[axis]) * unit(&mut random));
        let size = 0.02 + 0.5 * unit(&mut random);
        let way: [f64; 3] = std::array::from_fn(|_| unit(&mut random) - 0.5);
        let longest = 0.2 + 8.0 * unit(&mut random);
        let ray = Ray::new(at.into(), way.into(), longest).unwrap();
        let hit = cast(&store, &ray).known().unwrap().map(|hit| hit.distance);
        let answers = [
            space.is_seen(at.into()),
            space.is_box_seen(at.into(), Point3::from(at) + Vector3::repeat(size)),
            space.is_ray_seen(ray.origin(), ray.direction(), hit.unwrap_or(longest), hit.is_some()),
        ];
        counts.iter_mut().zip(answers).for_each(|(count, answer)| count[usize::from(answer)] += 1);
        let numbers = at.iter().chain(&way).chain([&longest, &size]).copied();
        let numbers =
            numbers.chain([hit.unwrap_or(f64::INFINITY)]).chain(answers.map(|answer| f64::from(u8::from(answer))));
        numbers.for_each(|number| write!(rows, "{number:?} ").unwrap());
        rows.push('\n');
    }
    assert!(counts.as_flattened().iter().all(|count| *count > 25), "{counts:?}");
    rows
}

/// Returns a place that was seen, and that a pawn reaches from `start` only over places where it was not.
fn beyond_unseen(archive: &Path, start: [f64; 3]) -> [f64; 3] {
    let archive = Archive::open(archive).unwrap();
    let store = Snapshot::resident(&archive, &NoMonitor).unwrap();
    let space = Arc::new(archive.seen_space(1 << 30).unwrap().unwrap());
    let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 });
    let places = |seen: Option<&Arc<SeenSpace>>, start: Option<[f64; 3]>| -> Vec<Point3<f64>> {
        let mut standing = StandingPlaces::new(&store, pawn).unwrap().within_seen(seen.cloned());
        let mut flood = match start {
            Some(start) => Flood::from(standing.spot(&store, start.into()).unwrap().known().unwrap().unwrap()),
            None => Flood::everywhere(&mut standing, &store).unwrap().known().unwrap(),
        };
        flood.grow(&mut standing, &store, &NoMonitor).unwrap().known().unwrap();
        flood.region(&standing).places().map(|place| place.feet).collect()
    };
    let (all, reached) = (places(Some(&space), None), places(Some(&space), Some(start)));
    let anyhow = places(None, Some(start));
    let found = all.into_iter().find(|place| anyhow.contains(place) && !reached.contains(place));
    found.expect("a place seen through a door that is too narrow to be gone through in seen space").into()
}

#[test]
fn programs_get_the_seen_space_of_the_library() {
    let set = set();
    let [archive, plain] = house(set.folder.path());
    let beyond = beyond_unseen(&archive, [1.5, 3.5, 0.5]).map(|number| number.to_string());
    let table = set.folder.path().join("seen.txt");
    std::fs::write(&table, seen_rows(&archive)).unwrap();
    for (compiler, standard, source) in
        [("gcc", "-std=c99", "seen.c"), ("clang", "-std=c99", "seen.c"), ("g++", "-std=c++17", "seen.cpp")]
    {
        if is_there(compiler) {
            let mut program = compiled(compiler, standard, source, false);
            assert_eq!(
                run(program.arg(&archive).arg(&plain).arg(&table).args(&beyond)),
                "600 rows are the same\n",
                "{source}"
            );
        }
    }
}
