//! Runs this program under callgrind, and reads what it counted.

use super::paths::{self, Group};
use crate::stability::Result;
use std::path::Path;
use std::process::Command;

/// The function whose instructions count; see [`paths`]. Callgrind dumps nothing for names that begin with a `*`.
const REGION: &str = "bench::counts::paths::region";

/// Whether Valgrind is there.
pub fn check() -> Result<()> {
    match Command::new("valgrind").arg("--version").output() {
        Ok(said) if said.status.success() => Ok(()),
        _ => Err("valgrind cannot be run: install it (on Debian: apt-get install valgrind)".into()),
    }
}

/// Returns the paths of a group with their instruction counts, in order.
pub fn count(folder: &Path, group: Group) -> Result<Vec<(paths::Path, u64)>> {
    let out = folder.join(format!("{group:?}.callgrind"));
    let mut command = Command::new("valgrind");
    command.args(["--quiet", "--tool=callgrind"]).arg(format!("--callgrind-out-file={}", out.display()));
    if !group.is_whole() {
        // One file per call of the region, numbered from 1 on; the file without a number is what comes after.
        command.arg(format!("--toggle-collect={REGION}")).arg(format!("--dump-after={REGION}"));
    }
    command.arg(std::env::current_exe()?).arg("counted").arg(group.name()).arg(folder);
    let done = command.output()?;
    let told = || String::from_utf8_lossy(&done.stderr).into_owned();
    if !done.status.success() {
        return Err(format!("valgrind, {}: {}", group.name(), told()).into());
    }
    let paths = paths::Path::parse_all(group, &String::from_utf8(done.stdout.clone())?)?;
    let mut counted = Vec::with_capacity(paths.len());
    for (n, path) in paths.into_iter().enumerate() {
        let file = if group.is_whole() { out.clone() } else { out.with_extension(format!("callgrind.{}", n + 1)) };
        let text = std::fs::read_to_string(&file).map_err(|error| {
            format!("{}: callgrind wrote no count of {}: {error} {}", file.display(), path.name, told())
        })?;
        counted.push((path, total(&text).ok_or_else(|| format!("{}: holds no count", file.display()))?));
    }
    Ok(counted)
}

/// The instructions that a file of callgrind sums up; none where it counted none.
fn total(text: &str) -> Option<u64> {
    let sum = text.lines().find_map(|line| line.strip_prefix("totals:").or(line.strip_prefix("summary:")))?;
    sum.split_whitespace().next()?.parse().ok().filter(|&count| count > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_instructions_is_no_count() {
        assert_eq!(total("events: Ir\nsummary: 1234\nfn=(1) x\ntotals: 1234\n"), Some(1234));
        assert_eq!(total("events: Ir\ntotals: 0\n"), None);
        assert_eq!(total("events: Ir\n"), None);
    }
}
