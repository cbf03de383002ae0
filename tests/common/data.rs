//! Real scans and meshes, if a folder of them is available.
#![allow(dead_code, reason = "each user needs a part")]

use std::path::PathBuf;

/// Environment variable with the folder.
const NAME: &str = "SLICEWALK_DATA";

/// The folder in `SLICEWALK_DATA`; `None`, with a line on standard error, if it is not set.
pub fn folder() -> Option<PathBuf> {
    let Some(folder) = std::env::var_os(NAME).map(PathBuf::from) else {
        eprintln!("skipped: no real data; {NAME} names a folder of it");
        return None;
    };
    assert!(folder.is_dir(), "{NAME}: {} is not a folder", folder.display());
    Some(folder)
}

/// The file `name` of the folder; `None`, with a line on standard error, if it is missing.
pub fn file(name: &str) -> Option<PathBuf> {
    let path = folder()?.join(name);
    if !path.is_file() {
        eprintln!("skipped: {} does not exist", path.display());
        return None;
    }
    Some(path)
}
