//! Conversion of the scans that `serve` and `site` are given: into a temporary folder, with progress for the page.

use super::KioskArguments;
use crate::extract::EVERYTHING;
use crate::{Failure, of_library, say, suggestion};
use slicewalk::archive::{Archive, extract};
use slicewalk::bytes::interruptible;
use slicewalk::{Error, Monitor, Warning};
use slicewalk_base::output::{ARCHIVE_MAGIC, DRAFT_MAGIC};
use slicewalk_convert::{ColourMode, ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use slicewalk_terminal::Terminal;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tempfile::TempDir;

/// Options of the conversion of scans; archives are served as they are.
#[derive(clap::Args)]
pub struct ConversionArguments {
    /// Scans: edge of a pixel in metres, or `auto`
    #[arg(long, default_value = "auto", allow_negative_numbers = true, value_name = "auto|METRES")]
    pixel: PixelSize,
    /// Scans: unit of the input
    #[arg(long, default_value = "auto", allow_negative_numbers = true, value_name = "auto|m|ft|us-ft|FACTOR")]
    units: Units,
    /// Scans: axis of the input that points up
    #[arg(long, value_enum, default_value_t = Axis::Z)]
    up: Axis,
}

impl ConversionArguments {
    /// An option that has another value than its default.
    pub fn given(&self) -> Option<&'static str> {
        let given = [
            (self.pixel != PixelSize::Auto, "pixel"),
            (self.units != Units::Auto, "units"),
            (self.up != Axis::Z, "up"),
        ];
        given.into_iter().find(|(is_given, _)| *is_given).map(|(_, option)| option)
    }
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Axis {
    Z,
    Y,
}

/// Returns whether `path` is to be opened as an archive: by its name, or by its first bytes.
pub fn is_archive(path: &Path) -> bool {
    let named = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("slices"));
    let mut start = [0; 8];
    let opened = || path.is_file().then(|| std::fs::File::open(path).ok()).flatten();
    named
        || slicewalk_base::output::is_standard(path)
        || opened().is_some_and(|mut file| file.read_exact(&mut start).is_ok())
            && (start == ARCHIVE_MAGIC || start == DRAFT_MAGIC)
}

/// How an archive is made.
enum Work {
    Convert(Box<ConvertOptions>),
    /// Copy an archive with the edits that it carries.
    Edit(Box<Archive>),
}

/// Scans to convert into one archive, or an archive to edit. Dropping it removes the new archive.
pub struct Conversion {
    work: Work,
    /// Name of the archive for the page.
    pub name: String,
    /// Where the archive will be.
    pub path: PathBuf,
    folder: TempDir,
}

impl Conversion {
    /// Prepares the conversion of `scans`, as `sliceconv --colour auto --levels on` does it.
    pub fn new(scans: Vec<PathBuf>, arguments: &ConversionArguments) -> Result<Self, Failure> {
        let stem = |path: &PathBuf| path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        // A pattern is no name.
        let stem = scans.first().and_then(stem).filter(|stem| !stem.contains(['*', '?', '[']) && !stem.is_empty());
        let name = format!("{}.slices", stem.as_deref().unwrap_or("scans"));
        let (folder, path) = temporary()?;
        let mut options = ConvertOptions::new(scans, path.clone());
        options.resources.temp_dir = folder.path().to_path_buf();
        options.grid.pixel = arguments.pixel;
        options.reading.units = arguments.units;
        options.plan.up = match arguments.up {
            Axis::Z => slicewalk::plan::Up::Z,
            Axis::Y => slicewalk::plan::Up::Y,
        };
        options.sections.colour = ColourMode::Auto;
        options.sections.levels = true;
        Ok(Self { work: Work::Convert(Box::new(options)), name, path, folder })
    }

    /// Prepares a copy of `archive`, shown under `name`, with the edits that it carries.
    pub fn of_edits(archive: Archive, name: String) -> Result<Self, Failure> {
        let (folder, path) = temporary()?;
        Ok(Self { work: Work::Edit(Box::new(archive)), name, path, folder })
    }

    /// Makes the archive on this thread.
    pub fn run(&self, progress: &Progress) -> Result<(), Failure> {
        // Also on a thread that the program's main one has started.
        let done = interruptible(Some(Arc::new(crate::asked)), || match &self.work {
            Work::Convert(options) => convert(options, progress).map(drop),
            Work::Edit(archive) => extract(archive, &EVERYTHING, &self.path, false, progress).map(drop),
        });
        progress.terminal().take();
        done.map_err(|error| match error {
            Error::Interrupted => Failure::Interrupted(128 + progress.signal.load(Ordering::Relaxed) as u8),
            error => of_library(&error),
        })
    }

    /// Removes the archive and its folder.
    pub fn remove(self) {
        if let Err(error) = self.folder.close() {
            say(&format!("cannot remove the temporary folder: {error}"));
        }
    }
}

/// Creates a temporary folder, and names the archive in it. From now on signals only ask to stop, so that it is removed.
fn temporary() -> Result<(TempDir, PathBuf), Failure> {
    crate::go_on()?;
    let parent = std::env::temp_dir();
    let failed = |error| Failure::Text(format!("{}: cannot create a temporary folder: {error}", parent.display()));
    let folder = tempfile::Builder::new().prefix("slicetool-").tempdir().map_err(failed)?;
    let path = folder.path().join("scan.slices");
    Ok((folder, path))
}

/// Progress of a conversion, for the terminal and for the page.
pub struct Progress {
    terminal: Mutex<Option<Terminal>>,
    /// Number of the signal that asks to stop, or 0.
    pub signal: Arc<AtomicUsize>,
    /// Name of the current stage and its total (0 if unknown); `None` before the first one.
    stage: Mutex<Option<(String, u64)>>,
    done: AtomicU64,
}

impl Progress {
    /// Begins; `signal` is to get the number of the signal that asks to stop.
    pub fn new(signal: Arc<AtomicUsize>) -> Self {
        let terminal = Terminal::new("slicetool", false, suggestion, signal.clone());
        Self { terminal: Mutex::new(Some(terminal)), signal, stage: Mutex::new(None), done: AtomicU64::new(0) }
    }

    /// Returns the stage and its share of work done (0 to 1, 0 if unknown), once the inputs are open.
    #[cfg_attr(not(feature = "serve"), allow(dead_code, reason = "a site is written after the conversion"))]
    pub fn stage_and_share(&self) -> Option<(String, f64)> {
        let (name, total) = self.stage.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        let done = self.done.load(Ordering::Relaxed);
        Some((name, if total == 0 { 0.0 } else { (done as f64 / total as f64).min(1.0) }))
    }

    fn terminal(&self) -> MutexGuard<'_, Option<Terminal>> {
        self.terminal.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Monitor for Progress {
    fn stage(&self, name: &str, total: u64, unit: &str) {
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner) = Some((name.to_owned(), total));
        self.done.store(0, Ordering::Relaxed);
        self.terminal().iter().for_each(|terminal| terminal.stage(name, total, unit));
    }

    fn advance(&self, amount: u64) {
        self.done.fetch_add(amount, Ordering::Relaxed);
        self.terminal().iter().for_each(|terminal| terminal.advance(amount));
    }

    fn warn(&self, warning: &Warning) {
        self.terminal().iter().for_each(|terminal| terminal.warn(warning));
    }

    fn cancelled(&self) -> bool {
        self.signal.load(Ordering::Relaxed) != 0
    }
}

/// Checks the table of a tour: columns x, y and z, and two rows or more.
pub fn check_tour(arguments: &KioskArguments) -> Result<(), Failure> {
    let Some(path) = &arguments.tour else { return Ok(()) };
    let failed = |reason: String| Failure::Text(format!("--tour {}: {reason}", path.display()));
    let file = std::fs::File::open(path).map_err(|error| failed(format!("cannot open: {error}")))?;
    let mut reader =
        csv::ReaderBuilder::new().comment(Some(b'#')).flexible(true).trim(csv::Trim::All).from_reader(file);
    let head = reader.headers().map_err(|error| failed(error.to_string()))?.clone();
    let column = |name: &str| head.iter().position(|own| own.eq_ignore_ascii_case(name));
    let (Some(x), Some(y), Some(z)) = (column("x"), column("y"), column("z")) else {
        return Err(failed(
            "expected the columns x, y and z in its first line; `slicetool route -o` writes them".into(),
        ));
    };
    let mut rows = 0u64;
    for record in reader.records() {
        let record = record.map_err(|error| failed(error.to_string()))?;
        let is_number =
            |at: usize| record.get(at).and_then(|text| text.parse::<f64>().ok()).is_some_and(f64::is_finite);
        if ![x, y, z].into_iter().all(is_number) {
            let line = record.position().map_or(0, csv::Position::line);
            return Err(failed(format!("line {line}: expected numbers for x, y and z")));
        }
        rows += 1;
    }
    match rows {
        0 | 1 => Err(failed(format!("expected at least two places, found {rows}"))),
        _ => Ok(()),
    }
}
