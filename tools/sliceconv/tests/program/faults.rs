//! All or nothing (guarantee G6): after a kill, an interrupt, a full disk, or the loss of an input, the old archive is
//! whole and nothing is left behind.
//!
//! `SLICEWALK_KILLS` sets the number of conversions killed, `SLICEWALK_KILLS_SEED` the seed of the moments, so that
//! runs by hand add up.
#![cfg(unix)]

use crate::full;

use crate::scans;

use full::{SmallDisk, with_little_space};
use scans::{Random, command, converts, names, points, verifies, write};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A folder with a scan to convert, an old archive to be replaced, and a folder for temporary data.
struct Place {
    folder: TempDir,
    old: Vec<u8>,
}

impl Place {
    fn new(count: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("small.las"), &points(2000));
        write(&folder.path().join("scan.las"), &points(count));
        fs::create_dir(folder.path().join("temp")).unwrap();
        converts(folder.path(), &["small.las", "-o", "a.slices", "--pixel", "0.1", "--quiet"]);
        let old = fs::read(folder.path().join("a.slices")).unwrap();
        Self { folder, old }
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn archive(&self) -> PathBuf {
        self.path().join("a.slices")
    }

    /// Checks that the archive is the old one, byte for byte.
    fn is_old(&self) {
        assert!(fs::read(self.archive()).unwrap() == self.old, "the old archive is not what it was");
    }

    /// Checks that the folders contain nothing unexpected.
    fn is_clean(&self) {
        assert_eq!(names(self.path()), ["a.slices", "scan.las", "small.las", "temp"]);
        assert_eq!(names(&self.path().join("temp")), [""; 0]);
    }

    fn overwrite(&self) -> Command {
        let mut command = command(self.path());
        command.args(["scan.las", "-o", "a.slices", "--pixel", "0.02", "--force", "--quiet", "--units", "m"]);
        command.args(["--memory", "64MiB", "--temp-dir", "temp"]).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }
}

/// Checks that the program failed without a panic and with one line, which is returned.
fn failed(status: ExitStatus, stderr: &[u8]) -> String {
    ended(status, stderr, 1)
}

/// Like [`failed`], with this exit code.
fn ended(status: ExitStatus, stderr: &[u8], code: i32) -> String {
    let said = String::from_utf8_lossy(stderr).into_owned();
    assert_eq!(status.code(), Some(code), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
    assert!(said.starts_with("sliceconv: ") && !said.contains("panicked"), "{said}");
    said
}

#[test]
fn killed_at_any_instant_the_old_archive_stays_and_the_next_run_cleans_up() {
    let place = Place::new(250_000);
    let began = Instant::now();
    assert!(place.overwrite().output().unwrap().status.success());
    let mut whole = began.elapsed().as_secs_f64();
    let new = fs::read(place.archive()).unwrap();
    let setting = |name: &str| std::env::var(name).map_or(20, |text| text.parse().unwrap());
    let mut random = Random(setting("SLICEWALK_KILLS_SEED"));
    let (mut killed, mut left) = (0, 0);
    let runs = setting("SLICEWALK_KILLS");
    for _ in 0..runs {
        fs::write(place.archive(), &place.old).unwrap();
        let mut child = place.overwrite().spawn().unwrap();
        std::thread::sleep(Duration::from_secs_f64(random.uniform() * whole));
        child.kill().unwrap();
        let is_killed = child.wait().unwrap().code().is_none();
        killed += u32::from(is_killed);
        // The machine's speed varies. To keep the moments spread over a whole run, about one in twenty is meant to come
        // too late.
        whole *= if is_killed { 1.0025 } else { 0.95 };
        let found = fs::read(place.archive()).unwrap();
        assert!(found == place.old || found == new, "neither the old archive nor the new one");
        verifies(&place.archive());
        let parts = names(place.path()).iter().filter(|name| name.ends_with(".part")).count();
        assert!(parts <= 1, "a run leaves at most one file, and the next removes it");
        left += parts;
        // A scan as small as this needs no temporary data (see `tests/resume.rs` for larger ones).
        assert_eq!(names(&place.path().join("temp")), [""; 0]);
    }
    println!("{killed} of {runs} runs were killed, {left} files were left and removed by the next run");
    assert!(place.overwrite().output().unwrap().status.success());
    assert!(fs::read(place.archive()).unwrap() == new);
    place.is_clean();
}

#[test]
fn without_threads_of_its_own_it_fails_in_one_line_and_leaves_nothing() {
    let place = Place::new(20_000);
    // No system can provide a stack this large.
    let out = place.overwrite().env("RUST_MIN_STACK", (1u64 << 62).to_string()).output().unwrap();
    let said = failed(out.status, &out.stderr);
    assert!(said.contains("cannot start a thread"), "{said}");
    place.is_old();
    place.is_clean();
}

#[test]
fn interrupted_it_says_so_and_leaves_nothing() {
    let place = Place::new(1_000_000);
    let mut interrupted = 0;
    for (number, (signal, code)) in [("INT", 130), ("TERM", 143), ("INT", 130), ("HUP", 129)].into_iter().enumerate() {
        fs::write(place.archive(), &place.old).unwrap();
        let child = place.overwrite().spawn().unwrap();
        // Wait until it listens: the temporary file beside the target shows that it is running.
        while !names(place.path()).iter().any(|name| name.ends_with(".part")) {
            std::thread::yield_now();
        }
        std::thread::sleep(Duration::from_millis(40 * number as u64));
        let sent = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let out = child.wait_with_output().unwrap();
        place.is_clean();
        // A program that finished before the signal has succeeded.
        if !out.status.success() {
            assert!(ended(out.status, &out.stderr, code).contains("interrupted"));
            assert!(out.stdout.is_empty());
            place.is_old();
            interrupted += 1;
        }
    }
    assert!(interrupted > 0, "no run was interrupted");
}

#[test]
fn without_space_for_the_archive_or_the_temporary_data_the_old_archive_stays() {
    let place = Place::new(5_500_000);
    let arguments = ["scan.las", "-o", "a.slices", "--pixel", "0.02", "--force", "--quiet", "--temp-dir", "temp"];
    let sliceconv = |blocks, more: &[&str]| {
        let arguments = [&arguments[..], more].concat();
        with_little_space(env!("CARGO_BIN_EXE_sliceconv"), place.path(), blocks, &arguments)
    };
    let out = sliceconv(200, &["--memory", "1GiB"]);
    let said = failed(out.status, &out.stderr);
    assert!(said.contains(".a.slices.slicewalk-") && said.contains("cannot write"), "{said}");
    place.is_old();
    place.is_clean();
    // 64 MiB hold 32 MiB of runs; the temporary file reaches the limit first.
    let out = sliceconv(20_000, &["--memory", "64MiB"]);
    let said = failed(out.status, &out.stderr);
    assert!(said.contains("temp") && said.contains("--temp-dir"), "{said}");
    place.is_old();
    place.is_clean();
}

#[test]
fn on_a_full_disk_it_says_which_and_the_old_archive_stays() {
    let place = Place::new(5_500_000);
    let at = place.path().join("disk");
    let Some(disk) = SmallDisk::mount(&at, "1m") else { return };
    fs::write(at.join("a.slices"), &place.old).unwrap();
    let fixed = ["scan.las", "--pixel", "0.02", "--force", "--quiet", "--memory", "64MiB"];
    let out = command(place.path()).args(fixed).args(["-o", "disk/a.slices", "--temp-dir", "temp"]).output().unwrap();
    let said = failed(out.status, &out.stderr);
    assert!(said.contains("disk") && said.contains("No space left"), "{said}");
    assert!(fs::read(at.join("a.slices")).unwrap() == place.old);
    assert_eq!(names(&at), ["a.slices"]);
    // Temporary data would not fit there, which is detected before the work begins.
    let out = command(place.path()).args(fixed).args(["-o", "a.slices", "--temp-dir", "disk"]).output().unwrap();
    let said = failed(out.status, &out.stderr);
    assert!(said.contains("disk") && said.contains("--temp-dir"), "{said}");
    place.is_old();
    assert_eq!(names(&at), ["a.slices"]);
    drop(disk);
}

#[test]
fn a_scan_that_is_cut_or_vanishes_while_it_is_read_gives_a_whole_archive_or_none() {
    let place = Place::new(1_000_000);
    let scan = fs::read(place.path().join("scan.las")).unwrap();
    for delay_ms in [0, 3, 10, 30] {
        fs::write(place.archive(), &place.old).unwrap();
        fs::write(place.path().join("scan.las"), &scan).unwrap();
        let child = place.overwrite().spawn().unwrap();
        while !names(place.path()).iter().any(|name| name.ends_with(".part")) {
            std::thread::yield_now();
        }
        std::thread::sleep(Duration::from_millis(delay_ms));
        fs::File::options().write(true).open(place.path().join("scan.las")).unwrap().set_len(100_000).unwrap();
        let out = child.wait_with_output().unwrap();
        if out.status.success() {
            verifies(&place.archive());
        } else {
            failed(out.status, &out.stderr);
            place.is_old();
        }
        place.is_clean();
    }
}
