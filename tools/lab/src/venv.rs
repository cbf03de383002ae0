//! Peers in Python, in a virtual environment that the environment variable [`VENV`] names.

use crate::stability::Result;
use std::path::PathBuf;

/// Folder of the virtual environment.
const VENV: &str = "SLICEWALK_VENV";

/// Returns the environment's folder.
pub fn folder() -> Result<PathBuf> {
    Ok(PathBuf::from(std::env::var_os(VENV).ok_or(format!("{VENV} names no virtual environment"))?))
}

/// Returns the environment's interpreter.
pub fn python() -> Result<PathBuf> {
    let python = folder()?.join("bin/python");
    if python.is_file() { Ok(python) } else { Err(format!("{} is not there", python.display()).into()) }
}

/// Returns what is sought in the environment's folder of packages; an error says that `package` is not there.
#[cfg(feature = "peers")]
pub fn find<T>(package: &str, seek: impl Fn(&std::path::Path) -> Option<T>) -> Result<T> {
    let venv = folder()?;
    let missing = || format!("the package {package} is not in {}", venv.display());
    let versions = std::fs::read_dir(venv.join("lib")).map_err(|_| missing())?;
    let found = |version: std::io::Result<std::fs::DirEntry>| seek(&version.ok()?.path().join("site-packages"));
    Ok(versions.into_iter().find_map(found).ok_or_else(missing)?)
}
