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
