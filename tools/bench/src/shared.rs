//! Real scans and meshes, where a folder of them is at hand.

use std::path::{Path, PathBuf};

/// The folder: `../shared/data` beside the project, or `data` in what `SLICEWALK_SHARED` names.
pub fn folder() -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    std::env::var_os("SLICEWALK_SHARED").map_or_else(beside, PathBuf::from).join("data")
}

/// A file of the folder; if it is missing, says on standard error that it is left out.
pub fn file(name: &str) -> Option<PathBuf> {
    let path = folder().join(name);
    let there = path.is_file();
    if !there {
        eprintln!("left out: {} does not exist; SLICEWALK_SHARED names another folder", path.display());
    }
    there.then_some(path)
}
