//! The table of measurements: a file that grows cell by cell, so that a run that was stopped goes on where it was.

use crate::stability::Result;
use std::collections::HashSet;
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::{Path, PathBuf};

const HEAD: &str = "scene,method,settings,pixel_cm,metric,value,low,high,n\n";
const PHANTOMS_HEAD: &str = "scene,method,pixel_cm,gap_cm,share,n\n";

/// A figure, with the least and greatest of its repeats.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    pub metric: &'static str,
    pub value: f64,
    pub low: f64,
    pub high: f64,
    pub n: usize,
}

impl Figure {
    /// One figure of `n` questions.
    pub fn one(metric: &'static str, value: f64, n: usize) -> Self {
        Self { metric, value, low: value, high: value, n }
    }

    /// The median of repeats; of an even number the lower.
    pub fn median(metric: &'static str, mut repeats: Vec<f64>, n: usize) -> Option<Self> {
        repeats.sort_by(f64::total_cmp);
        let (low, high) = (*repeats.first()?, *repeats.last()?);
        Some(Self { metric, value: repeats[(repeats.len() - 1) / 2], low, high, n })
    }
}

/// Boxes of one distance that were answered hit.
#[derive(Debug, Clone, PartialEq)]
pub struct Phantom {
    pub gap_cm: f64,
    pub share: f64,
    pub n: usize,
}

/// All that is known of one method in one scene at one pixel size.
#[derive(Debug, Clone)]
pub struct Cell {
    pub scene: String,
    pub method: String,
    pub settings: String,
    pub pixel_cm: u32,
    pub figures: Vec<Figure>,
    pub phantoms: Vec<Phantom>,
}

impl Cell {
    fn text(&self) -> String {
        let Self { scene, method, settings, pixel_cm, .. } = self;
        let head = format!("{scene},{method},{},{pixel_cm}", quoted(settings));
        if self.figures.is_empty() {
            return format!("{head},skipped,,,,0\n");
        }
        self.figures.iter().fold(String::new(), |mut text, figure| {
            let Figure { metric, value, low, high, n } = figure;
            let _ = writeln!(text, "{head},{metric},{},{},{},{n}", short(*value), short(*low), short(*high));
            text
        })
    }

    fn phantoms(&self) -> String {
        self.phantoms.iter().fold(String::new(), |mut text, phantom| {
            let Phantom { gap_cm, share, n } = phantom;
            let (gap_cm, share) = (short(*gap_cm), short(*share));
            let _ = writeln!(text, "{},{},{},{gap_cm},{share},{n}", self.scene, self.method, self.pixel_cm);
            text
        })
    }
}

/// Six significant digits; measurements have no more.
fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.abs().to_string();
    }
    let decimals = (5 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn quoted(text: &str) -> String {
    let text = text.replace('\n', " ");
    if text.contains([',', '"']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text }
}

/// The fields of a line.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut inside = false;
    for c in line.chars() {
        match c {
            '"' => inside = !inside,
            ',' if !inside => fields.push(String::new()),
            c => fields.last_mut().expect("begins with one").push(c),
        }
    }
    fields
}

/// The files.
pub struct Record {
    measured: PathBuf,
    phantoms: PathBuf,
    done: HashSet<(String, String, String)>,
}

impl Record {
    /// Opens the files in a folder, and finds out what is there already; `fresh` begins anew.
    pub fn open(folder: &Path, fresh: bool) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        let (measured, phantoms) = (folder.join("measured.csv"), folder.join("phantoms.csv"));
        for (path, head) in [(&measured, HEAD), (&phantoms, PHANTOMS_HEAD)] {
            if fresh || !path.exists() {
                std::fs::write(path, head).map_err(|e| format!("{}: {e}", path.display()))?;
            }
        }
        let text = std::fs::read_to_string(&measured).map_err(|e| format!("{}: {e}", measured.display()))?;
        if !text.starts_with(HEAD) {
            return Err(
                format!("{}: expected the columns {}; --fresh begins anew", measured.display(), HEAD.trim()).into()
            );
        }
        let key = |line: &str| match &fields(line)[..] {
            [scene, method, _, pixel, ..] => Some((scene.clone(), method.clone(), pixel.clone())),
            _ => None,
        };
        let done = text.lines().skip(1).filter_map(key).collect();
        Ok(Self { measured, phantoms, done })
    }

    /// Whether a cell is there already.
    pub fn has(&self, scene: &str, method: &str, pixel_cm: u32) -> bool {
        self.done.contains(&(scene.to_owned(), method.to_owned(), pixel_cm.to_string()))
    }

    /// Adds a cell.
    pub fn add(&mut self, cell: &Cell) -> Result<()> {
        for (path, text) in [(&self.phantoms, cell.phantoms()), (&self.measured, cell.text())] {
            let file = OpenOptions::new().append(true).open(path);
            let written = file.and_then(|mut file| file.write_all(text.as_bytes()));
            written.map_err(|e| format!("{}: {e}", path.display()))?;
        }
        self.done.insert((cell.scene.clone(), cell.method.clone(), cell.pixel_cm.to_string()));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_knows_its_cells_when_it_is_opened_again() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let settings = "cubes, \"exact\"".to_owned();
        let figures = Figure::median("build_s", vec![3.0, 1.0, 2.5], 3).into_iter().collect();
        let cell = |method: &str| Cell {
            scene: "house".into(),
            method: method.into(),
            settings: settings.clone(),
            pixel_cm: 8,
            figures,
            phantoms: vec![],
        };
        let cell = cell("capt");
        Record::open(folder.path(), false)?.add(&cell)?;
        let again = Record::open(folder.path(), false)?;
        assert!(again.has("house", "capt", 8) && !again.has("house", "capt", 16));
        let text = std::fs::read_to_string(folder.path().join("measured.csv"))?;
        let line = text.lines().nth(1).ok_or("no line")?;
        assert_eq!(line, "house,capt,\"cubes, \"\"exact\"\"\",8,build_s,2.5,1,3,3");
        assert_eq!(fields(line)[4], "build_s");
        assert!(!Record::open(folder.path(), true)?.has("house", "capt", 8));
        Ok(())
    }

    #[test]
    fn numbers_keep_six_digits() {
        assert_eq!([0.0, 123456789.0, 0.000123456789, 2.5].map(short), ["0", "123456789", "0.000123457", "2.5"]);
    }
}
