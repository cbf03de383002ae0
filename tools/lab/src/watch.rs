//! Runs another program and measures time, processor time and memory, as `/proc` reports them for any program.

use crate::stability::Result;
use std::io::{Read, Seek};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Between looks at the greatest memory and the processor time.
const LOOK: Duration = Duration::from_millis(5);
/// Between samples of memory that are kept (s).
const SAMPLE_S: f64 = 0.5;
/// Ticks of processor time in a second, as Linux reports them to programs on every machine.
const TICKS_PER_S: f64 = 100.0;

/// Resident memory over time (s, bytes).
pub type Memory = Vec<(f64, u64)>;

/// Measurements of a program.
#[derive(Debug, Clone)]
pub struct Watched {
    /// From start to end (s).
    pub seconds: f64,
    /// Processor time of all its threads (s).
    pub cpu_s: f64,
    /// Greatest resident memory (bytes), as of the last look before it ended.
    pub peak_bytes: u64,
    /// Resident memory over time (s, bytes).
    pub resident: Memory,
    /// Standard output of the program.
    pub said: String,
}

/// Runs a program to its end. A program that fails is an error, with what it said.
pub fn watch(command: &mut Command) -> Result<Watched> {
    // Files instead of pipes, because pipes are not emptied meanwhile.
    let (mut said, mut complained) = (tempfile::tempfile()?, tempfile::tempfile()?);
    command.stdin(Stdio::null()).stdout(said.try_clone()?).stderr(complained.try_clone()?);
    let start = Instant::now();
    let mut child =
        command.spawn().map_err(|error| format!("{:?} cannot be started: {error}", command.get_program()))?;
    let mut watched = Watched { seconds: 0.0, cpu_s: 0.0, peak_bytes: 0, resident: Vec::new(), said: String::new() };
    let folder = format!("/proc/{}", child.id());
    loop {
        // Linux reports the time of a program that has ended until it is waited for.
        let ended = match std::fs::read_to_string(format!("{folder}/stat")).ok().as_deref().and_then(stat) {
            Some((state, cpu_s)) => {
                watched.cpu_s = cpu_s;
                state == 'Z'
            }
            None => true,
        };
        if ended {
            break;
        }
        let now = start.elapsed().as_secs_f64();
        if let Ok(text) = std::fs::read_to_string(format!("{folder}/status")) {
            watched.peak_bytes = watched.peak_bytes.max(memory(&text, "VmHWM:").unwrap_or(0));
            if watched.resident.len() as f64 * SAMPLE_S <= now {
                watched.resident.extend(memory(&text, "VmRSS:").map(|bytes| (now, bytes)));
            }
        }
        std::thread::sleep(LOOK);
    }
    let status = child.wait()?;
    watched.seconds = start.elapsed().as_secs_f64();
    said.rewind()?;
    said.read_to_string(&mut watched.said)?;
    if status.success() {
        return Ok(watched);
    }
    let mut text = String::new();
    complained.rewind()?;
    complained.read_to_string(&mut text)?;
    Err(format!("{:?} ended with {status}: {}", command.get_program(), text.trim()).into())
}

/// State and processor time (s) from the text of `/proc/PID/stat`.
fn stat(text: &str) -> Option<(char, f64)> {
    // The name, in brackets, may hold anything.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace();
    let state = fields.next()?.chars().next()?;
    let ticks = |field: Option<&str>| field?.parse::<f64>().ok();
    let cpu = ticks(fields.nth(10))? + ticks(fields.next())?;
    Some((state, cpu / TICKS_PER_S))
}

/// Parses a line of `/proc/PID/status` in KiB (bytes).
fn memory(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_behind_any_name() {
        let text = "7 (a) b (c) R 1 7 7 0 -1 4194304 100 0 0 0 250 50 0 0 20 0";
        assert_eq!(stat(text), Some(('R', 3.0)));
        assert_eq!(stat("7 (a"), None);
        assert_eq!(memory("Name: x\nVmHWM:\t   12 kB\n", "VmHWM:"), Some(12 * 1024));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_failing_program_says_why() {
        let seen =
            watch(Command::new("sh").args(["-c", "echo done; i=0; while [ $i -lt 30000 ]; do i=$((i+1)); done"]));
        let seen = seen.expect("it runs");
        assert_eq!((seen.said.as_str(), seen.peak_bytes > 0), ("done\n", true));
        let error = watch(Command::new("sh").args(["-c", "echo oh >&2; exit 3"])).expect_err("it fails");
        assert!(error.to_string().ends_with(": oh"), "{error}");
    }
}
