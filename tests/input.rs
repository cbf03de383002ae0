//! Scan files as they are found in the world: what each of them gives, and what damage gives.
#![cfg(feature = "convert")]

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use slicewalk::input::spacing::estimate_spacing;
use slicewalk::input::{BATCH_POINTS, Decoder, InputOptions, InputSet, UnitCounts, Units};
use slicewalk::plan::Up;
use slicewalk::{Error, Monitor, NoMonitor, Result};

/// Keeps warnings.
#[derive(Default)]
struct Heard(Mutex<Vec<String>>);

impl Monitor for Heard {
    fn warn(&self, text: &str) {
        self.0.lock().unwrap().push(text.to_string());
    }
}

impl Heard {
    fn all(&self) -> String {
        self.0.lock().unwrap().join("\n")
    }
}

/// What a set of files gives.
#[derive(Debug, Default, Clone, PartialEq)]
struct Read {
    counts: UnitCounts,
    points: Vec<[f64; 3]>,
    warnings: String,
}

fn read(paths: &[PathBuf], options: InputOptions) -> Result<Read> {
    let heard = Heard::default();
    let set = InputSet::open(paths, options, &heard)?;
    let mut all = Read::default();
    let mut decoder = Decoder::new();
    for unit in set.units() {
        all.counts += decoder.decode(&set, &unit, &mut |batch| {
            assert!((1..=BATCH_POINTS).contains(&batch.len()));
            assert!(batch.y.len() == batch.len() && batch.z.len() == batch.len());
            all.points.extend((0..batch.len()).map(|i| [batch.x[i], batch.y[i], batch.z[i]]));
            Ok(())
        })?;
    }
    assert_eq!(all.counts.kept(), all.points.len() as u64);
    set.warn_of_losses(&heard);
    all.warnings = heard.all();
    Ok(all)
}

fn read_one(path: &Path) -> Result<Read> {
    read(&[path.to_path_buf()], InputOptions::default())
}

/// The folder of real data, or `None` (said on standard output) where it is missing.
fn data() -> Option<PathBuf> {
    let shared = match std::env::var_os("SLICEWALK_SHARED") {
        Some(shared) => PathBuf::from(shared),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"),
    };
    let data = shared.join("data");
    if !data.is_dir() {
        println!("skipped: {} does not exist; SLICEWALK_SHARED names another place", data.display());
        return None;
    }
    Some(data)
}

#[test]
fn survey() {
    let Some(data) = data() else { return };
    let mut files: Vec<_> = std::fs::read_dir(data.join("odd")).unwrap().map(|e| e.unwrap().path()).collect();
    files.extend(std::fs::read_dir(&data).unwrap().map(|e| e.unwrap().path()).filter(|p| p.extension().is_some_and(|e| e == "laz")));
    files.sort();
    for f in files {
        let n = f.file_name().unwrap().to_str().unwrap();
        match read_one(&f) {
            Ok(r) => println!("{n} | {:?} | {}", r.counts, r.warnings.replace(f.to_str().unwrap(), "F").replace('\n', " // ")),
            Err(e) => println!("{n} | ERR {e}"),
        }
    }
}
