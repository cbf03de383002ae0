//! Inputs that a program provides under a name, in place of a file: those that a browser hands over, and those of tests.
//! They hold for the thread that provided them.

use super::ByteSource;
use std::cell::RefCell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// True once a thread provides inputs.
static HOLDS: AtomicBool = AtomicBool::new(false);

thread_local! {
    static HELD: RefCell<HashMap<PathBuf, Arc<dyn ByteSource>>> = RefCell::default();
}

/// Makes this thread read `source` for an input called `path`, whatever files exist.
pub fn hold_source(path: impl Into<PathBuf>, source: impl ByteSource + 'static) {
    HOLDS.store(true, Relaxed);
    HELD.with_borrow_mut(|held| held.insert(path.into(), Arc::new(source)));
}

/// Ends all inputs that this thread provides.
pub fn release_sources() {
    HELD.with_borrow_mut(HashMap::clear);
}

/// Returns the input that this thread provides under this name.
pub fn held(path: &Path) -> Option<Arc<dyn ByteSource>> {
    if HOLDS.load(Relaxed) { HELD.with_borrow(|held| held.get(path).cloned()) } else { None }
}

/// Returns whether this thread provides an input under this name, or there is a regular file.
pub fn is_file_at(path: &Path) -> bool {
    held(path).is_some() || path.is_file()
}

/// Returns the length of the input that this thread provides, or of the file, at `path` (bytes).
pub fn len_at(path: &Path) -> std::io::Result<u64> {
    match held(path) {
        Some(source) => Ok(source.len()),
        None => std::fs::metadata(path).map(|about| about.len()),
    }
}
