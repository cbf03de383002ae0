//! The class of machine that figures were measured on.

use crate::stability::Result;
use std::path::Path;

/// Where a measuring run leaves the words of [`machine`], beside its tables.
pub const MACHINE_FILE: &str = "machine.txt";

/// Cores and processor of this machine, in words.
pub fn machine() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let cpus = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpus.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let model = model.map_or_else(|| std::env::consts::ARCH.into(), |(_, model)| model.trim().to_owned());
    format!("{cores} core{} of {model}", if cores == 1 { "" } else { "s" })
}

/// Returns the machine that the measuring run noted in `folder`; without a note, this machine, marked as such.
pub fn measured_on(folder: &Path) -> Result<String> {
    let path = folder.join(MACHINE_FILE);
    if !path.exists() {
        return Ok(format!("not noted; drawn on {}", machine()));
    }
    let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: cannot be read: {e}", path.display()))?;
    Ok(text.trim().to_owned())
}
