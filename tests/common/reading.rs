//! Points of files as the library reads them, and its warnings.
#![allow(dead_code, reason = "each test file uses a part")]

use slicewalk::{Error, Monitor, Warning};
use slicewalk_input::{BATCH_POINTS, InputOptions, InputSet, PointCounts, PointDecoder};
use std::io::Write;
use std::path::PathBuf;
use std::sync::Mutex;

/// Collects warnings.
#[derive(Default)]
pub struct Listener(Mutex<Vec<String>>);

impl Listener {
    /// Returns the recorded warnings.
    pub fn said(&self) -> Vec<String> {
        self.0.lock().unwrap().clone()
    }
}

impl Monitor for Listener {
    fn warn(&self, warning: &Warning) {
        self.0.lock().unwrap().push(warning.to_string());
    }
}

/// Kept points, their counts, and the warnings.
pub type Found = (Vec<[f64; 3]>, PointCounts, Vec<String>);

/// Reads files.
pub fn read(paths: &[PathBuf], options: InputOptions) -> Result<Found, Error> {
    let listener = Listener::default();
    let set = InputSet::open(paths, options, &listener)?;
    let (mut found, mut counts, mut decoder) = (Vec::new(), PointCounts::default(), PointDecoder::new());
    for chunk in set.chunks() {
        counts += decoder.decode(&set, &chunk, &mut |batch| {
            assert!(batch.len() <= BATCH_POINTS && batch.y.len() == batch.len() && batch.z.len() == batch.len());
            found.extend((0..batch.len()).map(|n| [batch.x[n], batch.y[n], batch.z[n]]));
            Ok(())
        })?;
    }
    assert_eq!(counts.kept(), found.len() as u64);
    set.check_complete(&listener)?;
    Ok((found, counts, listener.said()))
}

/// Compresses bytes with gzip.
pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}
