//! A conversion in a process of its own, with its time and its greatest memory.

use crate::stability::Result;
use slicewalk::NoMonitor;
use slicewalk::convert::{ConvertOptions, PixelSize, convert};
use slicewalk::mesh::MeshMode;
use slicewalk::plan::{Classifier, Up};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// What to convert.
#[derive(Debug, Clone, clap::Args)]
pub struct Conversion {
    /// Scan or mesh
    pub input: PathBuf,
    /// Archive
    pub output: PathBuf,
    /// Pixel size (m)
    #[arg(long)]
    pub pixel: f64,
    /// Step of oversampling (m); exact if left out
    #[arg(long)]
    pub step: Option<f64>,
    /// Whether y points up
    #[arg(long)]
    pub y_up: bool,
    /// By the thesis' rule for obstacles
    #[arg(long)]
    pub thesis_rule: bool,
}

/// What came of it.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    pub seconds: f64,
    /// Greatest resident memory (MiB).
    pub peak_mib: f64,
    pub points_made: u64,
    pub bytes: u64,
}

impl Conversion {
    /// A conversion to pixels of `pixel` metres, exact.
    pub fn new(input: &Path, output: &Path, y_up: bool, pixel: f64) -> Self {
        let (input, output) = (input.to_path_buf(), output.to_path_buf());
        Self { input, output, pixel, step: None, y_up, thesis_rule: false }
    }

    /// Converts, and prints what a parent process reads.
    pub fn run(&self) -> Result<()> {
        let mut options = ConvertOptions::new(vec![self.input.clone()], self.output.clone());
        options.pixel = PixelSize::Metres(self.pixel);
        options.up = if self.y_up { Up::Y } else { Up::Z };
        options.overwrite = true;
        if let Some(step) = self.step {
            options.mesh = MeshMode::Sampled { step_m: Some(step) };
        }
        if self.thesis_rule {
            options.classifier = Classifier::Thesis;
        }
        let start = Instant::now();
        let report = convert(&options, &NoMonitor)?;
        let seconds = start.elapsed().as_secs_f64();
        println!("{seconds} {} {} {}", peak_mib()?, report.points_made, report.header.file_len);
        Ok(())
    }

    /// Converts in a process of its own: the fastest of `rounds`.
    pub fn measure(&self, rounds: usize) -> Result<Measured> {
        let mut best: Option<Measured> = None;
        for _ in 0..rounds.max(1) {
            let mut command = Command::new(std::env::current_exe()?);
            command.arg("measured").arg(&self.input).arg(&self.output).arg(format!("--pixel={}", self.pixel));
            command.args(self.step.map(|step| format!("--step={step}")));
            command.args(self.y_up.then_some("--y-up")).args(self.thesis_rule.then_some("--thesis-rule"));
            let done = command.output()?;
            if !done.status.success() {
                let said = String::from_utf8_lossy(&done.stderr);
                return Err(format!("{}: {said}", self.input.display()).into());
            }
            let text = String::from_utf8(done.stdout)?;
            let numbers: Vec<f64> = text.split_whitespace().map(str::parse).collect::<std::result::Result<_, _>>()?;
            let [seconds, peak_mib, points_made, bytes] = numbers[..] else {
                return Err(format!("said {text:?}").into());
            };
            let found = Measured { seconds, peak_mib, points_made: points_made as u64, bytes: bytes as u64 };
            best = best.filter(|best| best.seconds <= seconds).or(Some(found));
        }
        best.ok_or_else(|| "nothing was measured".into())
    }
}

/// Greatest resident memory of this process (MiB), as the system counts it.
fn peak_mib() -> Result<f64> {
    let text = std::fs::read_to_string("/proc/self/status")?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:")).ok_or("the system tells no peak memory")?;
    let kib: f64 = line.split_whitespace().next().ok_or("no number")?.parse()?;
    Ok(kib / 1024.0)
}
