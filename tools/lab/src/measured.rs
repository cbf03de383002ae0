//! A conversion in a process of its own, with its time and its greatest memory.

use crate::stability::Result;
use crate::watch::{Watched, watch};
use slicewalk::NoMonitor;
use slicewalk::plan::{Classifier, Up};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_mesh::MeshMode;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Options of a conversion.
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
    /// Memory budget (bytes); that of the command line if left out
    #[arg(long)]
    pub memory: Option<u64>,
}

/// Figures of a conversion.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Time of the conversion itself (s).
    pub seconds: f64,
    /// Greatest resident memory (MiB).
    pub peak_mib: f64,
    /// Points made of triangles.
    pub points_made: u64,
    /// Length of the archive (bytes).
    pub bytes: u64,
    /// Temporary data written to disk (bytes).
    pub temp_bytes: u64,
    /// Points read from the input.
    pub points_read: u64,
}

impl Conversion {
    /// A conversion to pixels of `pixel` metres, exact.
    pub fn new(input: &Path, output: &Path, y_up: bool, pixel: f64) -> Self {
        let (input, output) = (input.to_path_buf(), output.to_path_buf());
        Self { input, output, pixel, step: None, y_up, thesis_rule: false, memory: None }
    }

    /// Converts, and prints what a parent process reads.
    pub fn run(&self) -> Result<()> {
        let mut options = ConvertOptions::new(vec![self.input.clone()], self.output.clone());
        options.grid.pixel = PixelSize::Metres(self.pixel);
        options.plan.up = if self.y_up { Up::Y } else { Up::Z };
        options.overwrite = true;
        options.resources.memory_bytes = self.memory.unwrap_or(options.resources.memory_bytes);
        if let Some(step) = self.step {
            options.reading.mesh = MeshMode::Sampled { step_m: Some(step) };
        }
        if self.thesis_rule {
            options.plan.classifier = Classifier::Thesis;
        }
        let start = Instant::now();
        let report = convert(&options, &NoMonitor)?;
        let seconds = start.elapsed().as_secs_f64();
        let header = &report.header;
        println!(
            "{seconds} {} {} {} {} {}",
            peak_mib()?,
            report.points_made,
            header.file_len,
            report.temp_bytes,
            header.points_read
        );
        Ok(())
    }

    /// Converts in a process of its own: the fastest of `rounds`.
    pub fn measure(&self, rounds: usize) -> Result<Measured> {
        let mut best = self.watched()?.0;
        for _ in 1..rounds {
            let found = self.watched()?.0;
            if found.seconds < best.seconds {
                best = found;
            }
        }
        Ok(best)
    }

    /// Converts once in a process of its own, and watches it.
    pub fn watched(&self) -> Result<(Measured, Watched)> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("measured").arg(&self.input).arg(&self.output).arg(format!("--pixel={}", self.pixel));
        command.args(self.step.map(|step| format!("--step={step}")));
        command.args(self.y_up.then_some("--y-up")).args(self.thesis_rule.then_some("--thesis-rule"));
        command.args(self.memory.map(|bytes| format!("--memory={bytes}")));
        let watched = watch(&mut command).map_err(|error| format!("{}: {error}", self.input.display()))?;
        Ok((Measured::parse(&watched.said)?, watched))
    }
}

impl Measured {
    /// Parses the output of [`Conversion::run`].
    fn parse(said: &str) -> Result<Self> {
        let numbers: Option<Vec<f64>> = said.split_whitespace().map(|word| word.parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[seconds, peak_mib, points_made, bytes, temp_bytes, points_read]) => Ok(Self {
                seconds,
                peak_mib,
                points_made: points_made as u64,
                bytes: bytes as u64,
                temp_bytes: temp_bytes as u64,
                points_read: points_read as u64,
            }),
            _ => Err(format!("a conversion said {said:?}").into()),
        }
    }
}

/// Greatest resident memory of this process (MiB), as the system counts it.
fn peak_mib() -> Result<f64> {
    let text = std::fs::read_to_string("/proc/self/status")?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:")).ok_or("the system reports no peak memory")?;
    let kib: f64 = line.split_whitespace().next().ok_or("no number")?.parse()?;
    Ok(kib / 1024.0)
}
