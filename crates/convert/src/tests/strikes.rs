//! Conversions of every kind of input of which one step fails: a call of the disk, or the user stops. A conversion says so, and what it leaves under the output's name is whole or not there.

use super::*;
use crate::bytes::testing::Strike;
use crate::disk::testing::{Call, Hooked};
use crate::mesh::MeshMode;
use crate::plan::Classifier;
use std::fmt::Write;
use std::io;
use std::path::PathBuf;

/// Rows of a scan of a room with a hole in its floor, seen from its middle.
fn ptx() -> String {
    let mut rows = String::new();
    let mut count = 0;
    for i in -30i32..=30 {
        for j in -30i32..=30 {
            let (x, y) = (f64::from(i) * 0.1, f64::from(j) * 0.1);
            let z = if i.abs() == 30 || j.abs() == 30 { f64::from((i + j).rem_euclid(17)) * 0.1 } else { 0.0 };
            if !(5..8).contains(&i) || !(5..8).contains(&j) {
                writeln!(rows, "{x:.3} {y:.3} {z:.3} 0.5 {} 90 {}", 100 + i, 100 + j).unwrap();
                count += 1;
            }
        }
    }
    format!("1\n{count}\n0 0 1.5\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n{rows}")
}

/// A floor and a wall, with colours at their corners.
const OBJ: &str = "v -3 -3 0 1 0 0\nv 3 -3 0 0 1 0\nv 3 3 0 0 0 1\nv -3 3 0 1 1 0\nv -3 3 2 0 1 1\nv 3 3 2 1 0 1\n\
                   f 1 2 3 4\nf 4 3 6 5\n";

fn splats() -> String {
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let names = names.iter().chain(&["rot_0", "rot_1", "rot_2", "rot_3"]);
    let properties: String = names.map(|name| format!("property float {name}\n")).collect();
    let row = |n: i32| format!("{} {} 0 0.1 0.2 0.3 2 -1.5 -1.2 -2 1 0.1 0 0\n", n % 5 - 2, n / 5 - 2);
    let rows: String = (0..25).map(row).collect();
    format!("ply\nformat ascii 1.0\nelement vertex 25\n{properties}end_header\n{rows}")
}

/// Name of a kind of conversion, its inputs, and its options.
type Kind = (&'static str, &'static [&'static str], fn(&mut ConvertOptions));

const KINDS: &[Kind] = &[
    ("all that follows from a scan", &["a.ptx"], |options| {
        options.grid =
            GridOptions { fill_holes: Some(HoleWidth::Auto), tolerance_auto: true, ..GridOptions::default() };
        options.reading.turn = Turn::Auto;
        options.sections =
            SectionOptions { levels: true, colour: ColourMode::Auto, free_space: true, ..SectionOptions::default() };
    }),
    ("a scan without what moves", &["a.ptx"], |options| {
        options.plan.remove_moving = true;
        options.removed = Some("/model/removed.las".into());
        options.plan.drop_floaters = 2;
        options.plan.classifier = Classifier::Thesis;
        options.resume = true;
    }),
    ("a mesh", &["a.obj"], |options| {
        options.sections.levels = true;
        options.sections.colour = ColourMode::Auto;
        options.grid.fill_holes = Some(HoleWidth::Metres(0.5));
    }),
    ("a mesh as points", &["a.obj"], |options| {
        options.grid.pixel = PixelSize::Auto;
        options.reading.mesh = MeshMode::Sampled { step_m: None };
        options.sections.colour = ColourMode::Auto;
    }),
    ("splats", &["a.splats.ply"], |options| {
        options.sections.colour = ColourMode::Auto;
        options.plan.min_points = 2;
    }),
    ("a part of all", &["a.ptx", "a.obj", "a.splats.ply"], |options| {
        options.shard = Some(ShardOptions { index: 1, count: 2 });
        options.sections.colour = ColourMode::Of(ColourSource::Rgb);
    }),
];

/// Writes the inputs to `folder`; everything else is on another disk.
fn options_of((_, inputs, change): &Kind, folder: &Path) -> ConvertOptions {
    let inputs = inputs.iter().map(|name| {
        let path = folder.join(name);
        fs::write(&path, content(name)).unwrap();
        path
    });
    let mut options = ConvertOptions::new(inputs.collect(), at("a.slices"));
    options.resources.temp_dir = at("");
    options.resources.threads = 1;
    options.resources.memory_bytes = MIN_MEMORY_BYTES;
    options.grid.pixel = PixelSize::Metres(0.25);
    options.reading.units = Units::Factor(1.0);
    change(&mut options);
    options
}

fn at(name: &str) -> PathBuf {
    Path::new("/model").join(name)
}

fn content(name: &str) -> String {
    match name {
        "a.ptx" => ptx(),
        "a.obj" => OBJ.into(),
        _ => splats(),
    }
}

/// Converts on `disk`.
fn convert_on(options: &ConvertOptions, disk: Arc<dyn Disk>, monitor: &dyn Monitor) -> Result<Report> {
    let limits = Limits { views_bytes: Limits::of(options).views_bytes, ..Job::limits() };
    crate::disk::with(disk, || convert_within(options, limits, monitor))
}

/// Refuses what a conversion left, unless it is the whole archive or nothing. Spilled data may be kept to resume from.
fn check(what: &str, done: &Result<Report>, left: &Content, output: &Path, whole: &[u8]) {
    let archive = left.bytes(output);
    assert!(archive.is_none_or(|archive| archive == whole), "{what}: another archive");
    let is_there = match done {
        Ok(_) | Err(Error::NotDurable { .. }) => true,
        // The points that were left out follow when the archive is complete.
        Err(Error::Io { path, .. }) if path.to_string_lossy().contains("removed.las") => archive.is_some(),
        Err(_) => false,
    };
    assert_eq!(is_there, archive.is_some(), "{what}: {done:?}");
    let Err(error) = done else { return };
    assert_eq!(error.to_string().lines().count(), 1, "{what}: {error}");
}

/// Returns the numbers of calls to let fail: all, or fewer of the later ones of many.
fn numbers() -> impl Iterator<Item = u64> {
    std::iter::successors(Some(0), |number| Some(number + 1 + number / 12))
}

#[test]
#[ignore = "slow: .ci/run"]
fn whichever_step_of_any_conversion_fails_it_says_so() {
    for kind in KINDS {
        let name = kind.0;
        let folder = tempfile::tempdir().unwrap();
        let options = options_of(kind, folder.path());
        let model = ModelDisk::new(Content::default());
        convert_on(&options, model.clone(), &NoMonitor).unwrap_or_else(|error| panic!("{name}: {error}"));
        let whole = model.content().bytes(&options.output).unwrap().to_vec();
        let mut counts = Vec::new();
        counts.push(numbers().find(|&number| {
            let strike = Strike::at(number);
            let model = ModelDisk::new(Content::default());
            let done = convert_on(&options, model.clone(), &*strike);
            let what = format!("{name}: stop {number}");
            check(&what, &done, &model.content(), &options.output, &whole);
            let stopped = |error: &Error| match error {
                Error::Resumable { source, .. } => matches!(**source, Error::Interrupted),
                error => matches!(error, Error::Interrupted),
            };
            assert!(done.as_ref().err().is_none_or(stopped) && done.is_err() == strike.fell(), "{what}: {done:?}");
            !strike.fell()
        }));
        counts.push(numbers().find(|&number| {
            let strike = Strike::at(number);
            let call = Arc::new(Mutex::new(None));
            let model = ModelDisk::new(Content::default());
            let (hook, noted) = (strike.clone(), call.clone());
            let disk = Hooked::new(model.clone(), move |call| {
                if !hook.hits() {
                    return Ok(()).into();
                }
                *noted.lock().unwrap() = Some(call);
                Err(io::Error::other(Strike::REASON)).into()
            });
            let done = convert_on(&options, disk, &NoMonitor);
            let call = *call.lock().unwrap();
            let what = format!("{name}: call {number} of the disk, {call:?}");
            check(&what, &done, &model.content(), &options.output, &whole);
            // A failure that could change the bytes must be reported.
            let bears = matches!(call, Some(Call::Write | Call::Sync | Call::Rename));
            assert!(!bears || done.is_err(), "{what}");
            !strike.fell()
        }));
        println!("{name}: stops, calls of the disk: {counts:?}");
    }
}
