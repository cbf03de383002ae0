//! `--resume`: killed at any moment, interrupted or out of space, a conversion resumes and makes the same bytes, and
//! repeats at most 5 % of the points or 256 MiB of temporary data.
//!
//! `SLICEWALK_RESUME_POINTS` and `SLICEWALK_RESUME_KILLS` set the numbers of points and of kills;
//! `SLICEWALK_RESUME_MEMORY` sets the budget.
#![cfg(target_os = "linux")]

use crate::full;

use crate::scans;

use full::with_little_space;
use scangen::{WriteSpec, write_las};
use scans::{Random, command, names, refuses, verifies};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use tempfile::TempDir;

/// Bytes of a point's temporary record.
const RECORD_BYTES: u64 = 8;

fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().map_or(default, |text| text.parse().unwrap())
}

/// A folder with a scan that exceeds the budget, an old archive, and the new one made by a single run.
struct Place {
    folder: TempDir,
    points: u64,
    memory: String,
    /// Bytes per point in the scan.
    point_bytes: u64,
    options: &'static [&'static str],
    new: Vec<u8>,
}

impl Place {
    /// Points anywhere in a room.
    fn new(points: u64) -> Self {
        Self::with(points, 2_500.0, |_| true, &[])
    }

    /// Points in a room up to `height` (mm), filtered by `wanted` (m).
    fn with(points: u64, height: f64, wanted: fn(&[f64; 3]) -> bool, options: &'static [&'static str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.las");
        let mut random = Random(9);
        let mut millimetres = |most: f64| (random.uniform() * most).round() / 1000.0;
        let cloud = (0..points).map(|_| [millimetres(20_000.0), millimetres(20_000.0), millimetres(height)]);
        let points = write_las(&path, cloud.filter(wanted), &WriteSpec::for_path(&path)).unwrap().points;
        let header = fs::File::open(&path).unwrap();
        let mut bytes = [0; 2];
        std::os::unix::fs::FileExt::read_exact_at(&header, &mut bytes, 105).unwrap();
        fs::create_dir(folder.path().join("temp")).unwrap();
        let memory = std::env::var("SLICEWALK_RESUME_MEMORY").unwrap_or_else(|_| "64MiB".into());
        let point_bytes = u64::from(u16::from_le_bytes(bytes));
        let mut place = Self { folder, points, memory, point_bytes, options, new: Vec::new() };
        let whole = place.finishes(&[]);
        assert!(whole["temp_bytes"].as_u64().unwrap() > 0, "the scan fits in memory");
        place.new = fs::read(place.path().join("a.slices")).unwrap();
        place
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn arguments(&self) -> Vec<&str> {
        let fixed = ["scan.las", "-o", "a.slices", "--pixel", "0.05", "--force", "--quiet", "--units", "m", "--json"];
        [&fixed[..], &["--threads", "2", "--temp-dir", "temp", "--memory", &self.memory], self.options].concat()
    }

    fn starts(&self, more: &[&str]) -> Child {
        command(self.path())
            .args(self.arguments())
            .args(more)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// Runs to success; checks that only the archive is left, and returns the report.
    fn finishes(&self, more: &[&str]) -> Value {
        let out = self.starts(more).wait_with_output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        assert_eq!(names(&self.path().join("temp")), [""; 0]);
        assert_eq!(names(self.path()), ["a.slices", "scan.las", "temp"]);
        serde_json::from_slice(&out.stdout).unwrap()
    }

    /// The file with this extension in the folder for temporary data, and its length.
    fn temporary(&self, ending: &str) -> Option<(PathBuf, u64)> {
        let temp = self.path().join("temp");
        let name = names(&temp).into_iter().find(|name| name.ends_with(ending))?;
        let len = fs::metadata(temp.join(&name)).ok()?.len();
        Some((temp.join(name), len))
    }

    /// Ends `child` by SIGKILL once its journal is `bytes` long, or it writes pages; returns the bytes it had read and
    /// the length of its temporary data.
    fn kill(&self, mut child: Child, bytes: u64) -> Option<(u64, u64)> {
        loop {
            if child.try_wait().unwrap().is_some() {
                return None;
            }
            if self.temporary(".journal").is_some_and(|(_, len)| len >= bytes) {
                break;
            }
            std::thread::yield_now();
        }
        // Stop it first, so that nothing is read between the count and the kill.
        let signal = |name: &str| {
            assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
        };
        signal("-STOP");
        let io = fs::read_to_string(format!("/proc/{}/io", child.id())).unwrap_or_default();
        let read = io.lines().find_map(|line| line.strip_prefix("rchar: ")).map_or(0, |text| text.parse().unwrap());
        let spilled = self.temporary(".spill").map_or(0, |(_, len)| len);
        child.kill().unwrap();
        child.wait().unwrap();
        Some((read, spilled))
    }

    fn is_new(&self) {
        assert!(fs::read(self.path().join("a.slices")).unwrap() == self.new, "the archive is not that of one run");
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn killed_at_any_moment_a_conversion_goes_on_and_repeats_little() {
    kills(&Place::new(setting("SLICEWALK_RESUME_POINTS", 6_000_000)), setting("SLICEWALK_RESUME_KILLS", 4));
}

/// A floor with holes of 20 and of 50 cm.
#[test]
#[ignore = "slow: .ci/run"]
fn killed_at_any_moment_a_conversion_that_fills_holes_goes_on() {
    let wanted = |p: &[f64; 3]| {
        let gap = [p[0], p[1]].map(|v| (v.rem_euclid(2.0) - 1.0).abs());
        let half = if p[0].rem_euclid(4.0) < 2.0 { 0.1 } else { 0.25 };
        gap[0] > half || gap[1] > half
    };
    let place = Place::with(6_000_000, 4.0, wanted, &["--fill-holes", "0.3"]);
    kills(&place, 2);
    let archive = slicewalk::archive::Archive::open(place.path().join("a.slices")).unwrap();
    assert!(archive.header().voxels.inferred > 100, "nothing was filled");
}

#[test]
#[ignore = "slow: .ci/run"]
fn killed_at_any_moment_a_conversion_with_colours_goes_on() {
    kills(&Place::with(4_000_000, 2_500.0, |_| true, &["--colour", "intensity"]), 2);
}

/// Kills conversions at random moments and resumes them.
fn kills(place: &Place, kills: u64) {
    // The journal of a whole run, to place the moments.
    let mut child = place.starts(&[]);
    let mut longest = 0;
    while child.try_wait().unwrap().is_none() {
        longest = place.temporary(".journal").map_or(longest, |(_, len)| len.max(longest));
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let mut random = Random(setting("SLICEWALK_RESUME_SEED", 3));
    let (mut killed, mut most_points, mut most_bytes) = (0, 0, 0);
    for number in 0..kills {
        // Every second time, the run that resumes is killed, too.
        // Bytes that each killed run read, and bytes that the previous one had left on disk.
        let (mut killed_runs, mut left) = (Vec::new(), 0);
        for run in 0..=number % 2 {
            let more = if run == 0 { &[][..] } else { &["--resume"] };
            let moment = (random.uniform() * longest as f64) as u64;
            if let Some((bytes, spilled)) = place.kill(place.starts(more), moment) {
                killed_runs.push((bytes, std::mem::replace(&mut left, spilled)));
                most_bytes = most_bytes.max(spilled);
            }
        }
        let spilled = place.temporary(".spill").map_or(0, |(_, len)| len);
        let done = place.finishes(&["--resume"]);
        place.is_new();
        let number = |key: &str| done[key].as_u64().unwrap();
        let (points, bytes) = (number("points_resumed"), number("temp_bytes_resumed"));
        // To check what another run left, a run reads it, and the points that it represents.
        let points_in = |left: u64| left * points / bytes.max(1);
        let of_points = |(read, left)| u64::saturating_sub(read, left + points_in(left) * place.point_bytes);
        let read = killed_runs.iter().copied().map(of_points).sum::<u64>() / place.point_bytes;
        // Data read in the second pass are temporary data, not points.
        let repeated = read.min(place.points).saturating_sub(points);
        killed += killed_runs.len();
        most_points = most_points.max(repeated);
        let bound = (place.points / 20).max((256 << 20) / RECORD_BYTES);
        assert!(repeated <= bound && spilled - bytes <= 256 << 20, "{repeated} points, {spilled} - {bytes} bytes");
        println!("{points} points and {bytes} bytes resumed, {repeated} points repeated");
    }
    println!("{killed} kills, at most {most_points} points repeated, {most_bytes} bytes spilled");
    assert!(killed > 0, "no run was killed");
    verifies(&place.path().join("a.slices"));
}

#[test]
#[ignore = "slow: .ci/run"]
fn after_a_kill_a_run_that_does_not_resume_cleans_up() {
    let place = Place::new(6_000_000);
    assert!(place.kill(place.starts(&["--resume"]), 1).is_some());
    assert_eq!(names(&place.path().join("temp")).len(), 2);
    let done = place.finishes(&[]);
    assert_eq!(done["points_resumed"], 0);
    place.is_new();
}

#[test]
#[ignore = "slow: .ci/run"]
fn interrupted_or_without_space_a_run_to_be_resumed_says_what_it_keeps_and_where() {
    let place = Place::new(6_000_000);
    // Interrupted.
    let child = place.starts(&["--resume"]);
    while place.temporary(".journal").is_none_or(|(_, len)| len < 500) {
        std::thread::yield_now();
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let out = child.wait_with_output().unwrap();
    let said = String::from_utf8(out.stderr).unwrap();
    if !out.status.success() {
        assert_eq!(out.status.code(), Some(130), "{said}");
        let (spill, len) = place.temporary(".spill").unwrap();
        let spill = spill.file_name().unwrap().to_str().unwrap();
        assert!(said.contains("interrupted") && said.contains("--resume"), "{said}");
        assert!(said.contains(spill) && said.contains(&len.to_string()) && said.lines().count() == 1, "{said}");
        // Another scan of the same name is refused, and the kept data stay.
        let scan = fs::read(place.path().join("scan.las")).unwrap();
        let mut other = scan.clone();
        other[1000] ^= 1;
        fs::write(place.path().join("scan.las"), other).unwrap();
        let said = refuses(place.path(), &[&place.arguments()[..], &["--resume"]].concat(), 1);
        assert!(said.contains("scan.las") && said.contains("changed"), "{said}");
        assert!(place.temporary(".spill").is_some());
        fs::write(place.path().join("scan.las"), scan).unwrap();
        // The file's time has changed, so the conversion starts over.
        assert_eq!(place.finishes(&[])["points_resumed"], 0);
    }
    // No space for the temporary data.
    let arguments = [&place.arguments()[..], &["--resume"]].concat();
    let out = with_little_space(env!("CARGO_BIN_EXE_sliceconv"), place.path(), 24_000, &arguments);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert!(said.contains("--temp-dir") && said.contains("--resume"), "{said}");
    let done = place.finishes(&["--resume"]);
    assert!(done["points_resumed"].as_u64().unwrap() > 0);
    place.is_new();
}
