//! Every available scan, and odd and damaged ones, through the program: a sound archive or one clear line, in bounded
//! time and memory, and never a panic.
//!
//! Needs a folder of scans in `SLICEWALK_DATA`; without it the tests say so, and only damage generated here is tried.

use crate::scans;

use scans::{Random, command, data, peak_memory_kib, points, text, verifies, write};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Far more than any of these files needs, on any machine.
const MOST_TIME: Duration = Duration::from_secs(120);

/// Converts `input` and returns whether that succeeded. In either case, the files are sound and the message is clear.
fn tried(folder: &Path, input: &Path, arguments: &[&str]) -> bool {
    let output = folder.join("odd.slices");
    let _ = fs::remove_file(&output);
    let log = fs::File::create(folder.join("stderr")).unwrap();
    let mut child = command(folder)
        .args([text(input), "-o", text(&output), "--memory", "64MiB", "--temp-dir", text(folder)])
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(log)
        .spawn()
        .unwrap();
    let began = Instant::now();
    let mut peak_kib = 0;
    let status = loop {
        peak_kib = peak_kib.max(peak_memory_kib(child.id()));
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if began.elapsed() > MOST_TIME {
            child.kill().unwrap();
            panic!("{}: not done after {MOST_TIME:?}", input.display());
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    let said = fs::read_to_string(folder.join("stderr")).unwrap();
    assert!(!said.contains("panicked"), "{}: {said}", input.display());
    assert!(peak_kib <= (64 + 64) << 10, "{}: {peak_kib} KiB", input.display());
    if status.success() {
        verifies(&output);
        return true;
    }
    assert_eq!(status.code(), Some(1), "{}: {said}", input.display());
    let lines: Vec<&str> = said.lines().filter(|line| !line.starts_with("sliceconv: warning: ")).collect();
    assert!(lines.len() == 1 && lines[0].starts_with("sliceconv: "), "{}: {said}", input.display());
    assert!(!output.exists());
    false
}

fn scans_in(folder: &Path) -> Vec<PathBuf> {
    let mut scans: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "las" || ending == "laz"))
        .collect();
    scans.sort();
    scans
}

#[test]
fn every_odd_file_gives_an_archive_or_one_clear_line() {
    let Some(data) = data::folder() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut done = [0, 0];
    for scan in scans_in(&data.join("odd")) {
        for pixel in ["auto", "0.5"] {
            done[usize::from(tried(folder.path(), &scan, &["--pixel", pixel]))] += 1;
        }
    }
    println!("{} conversions, {} refusals", done[1], done[0]);
    assert!(done[1] > 60, "{done:?}");
}

#[test]
fn every_scan_gives_a_sound_archive() {
    let Some(data) = data::folder() else { return };
    let folder = tempfile::tempdir().unwrap();
    for scan in scans_in(&data) {
        assert!(tried(folder.path(), &scan, &["--pixel", "auto"]), "{}", scan.display());
    }
}

#[test]
fn damaged_scans_give_an_archive_or_one_clear_line() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(11);
    let mut done = [0, 0];
    for ending in ["las", "laz"] {
        let path = folder.path().join(format!("damaged.{ending}"));
        write(&path, &points(20_000));
        let whole = fs::read(&path).unwrap();
        for round in 0..60 {
            let mut bytes = whole.clone();
            match round % 4 {
                0 => bytes.truncate(random.below(whole.len())),
                // Damage to the head has the greatest effect.
                1 => bytes[random.below(400)] = random.below(256) as u8,
                2 => {
                    let first = random.below(whole.len() - 100);
                    bytes[first..first + 100].iter_mut().for_each(|byte| *byte = random.below(256) as u8);
                }
                _ => {
                    let at = 94 + random.below(130);
                    bytes[at..at + 4].fill([0x00, 0xFF, 0x7F][random.below(3)]);
                }
            }
            fs::write(&path, &bytes).unwrap();
            done[usize::from(tried(folder.path(), &path, &["--pixel", "0.5"]))] += 1;
        }
    }
    println!("{} conversions, {} refusals", done[1], done[0]);
    assert!(done[0] > 10 && done[1] > 10, "{done:?}: the test shows little");
}
