//! Real scans and meshes, where a folder of them is at hand.
#![allow(dead_code, reason = "each user needs a part")]

use std::path::PathBuf;

/// Names the folder.
const NAME: &str = "SLICEWALK_DATA";

/// The folder that `SLICEWALK_DATA` names; `None`, and a line on standard error, if it is not set.
pub fn folder() -> Option<PathBuf> {
    let Some(folder) = std::env::var_os(NAME).map(PathBuf::from) else {
        eprintln!("skipped: no real data; {NAME} names a folder of it");
        return None;
    };
    assert!(folder.is_dir(), "{NAME}: {} is not a folder", folder.display());
    Some(folder)
}

/// The file `name` of the folder; `None`, and a line on standard error, if it is missing.
pub fn file(name: &str) -> Option<PathBuf> {
    let path = folder()?.join(name);
    if !path.is_file() {
        eprintln!("skipped: {} does not exist", path.display());
        return None;
    }
    Some(path)
}
