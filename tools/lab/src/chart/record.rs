//! Record of measurements: tables that grow cell by cell, so that an interrupted run resumes where it stopped.

use super::lines::{self, Measured, PhantomShare, Value};
use crate::stability::Result;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

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
    /// A line per figure; one without a figure if it was skipped.
    fn measured(&self) -> Vec<Measured> {
        let line = |figure| Measured {
            scene: self.scene.clone(),
            method: self.method.clone(),
            settings: self.settings.clone(),
            pixel_cm: self.pixel_cm,
            figure,
        };
        if self.figures.is_empty() {
            return vec![line(None)];
        }
        let figure = |figure: &Figure| {
            let &Figure { metric, value, low, high, n } = figure;
            line(Some((metric.to_owned(), Value { value, low, high }, n)))
        };
        self.figures.iter().map(figure).collect()
    }

    fn phantoms(&self) -> Vec<PhantomShare> {
        let line = |&Phantom { gap_cm, share, n }: &Phantom| PhantomShare {
            scene: self.scene.clone(),
            method: self.method.clone(),
            pixel_cm: self.pixel_cm,
            gap_cm,
            share,
            n,
        };
        self.phantoms.iter().map(line).collect()
    }
}

/// The files.
pub struct Record {
    measured: PathBuf,
    phantoms: PathBuf,
    done: HashSet<(String, String, u32)>,
}

impl Record {
    /// Opens the files in a folder and reads the cells that they hold; `fresh` starts over.
    pub fn open(folder: &Path, fresh: bool) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        let (measured, phantoms) = (folder.join("measured.csv"), folder.join("phantoms.csv"));
        if fresh || !measured.exists() {
            lines::write::<Measured>(&measured, &[])?;
        }
        if fresh || !phantoms.exists() {
            lines::write::<PhantomShare>(&phantoms, &[])?;
        }
        let known = lines::read::<Measured>(&measured).map_err(|e| format!("{e}; --fresh begins anew"))?;
        let done = known.into_iter().map(|line| (line.scene, line.method, line.pixel_cm)).collect();
        Ok(Self { measured, phantoms, done })
    }

    /// Whether a cell is there already.
    pub fn has(&self, scene: &str, method: &str, pixel_cm: u32) -> bool {
        self.done.contains(&(scene.to_owned(), method.to_owned(), pixel_cm))
    }

    /// Adds a cell.
    pub fn add(&mut self, cell: &Cell) -> Result<()> {
        lines::append(&self.phantoms, &cell.phantoms())?;
        lines::append(&self.measured, &cell.measured())?;
        self.done.insert((cell.scene.clone(), cell.method.clone(), cell.pixel_cm));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_knows_its_cells_when_it_is_opened_again() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let cell = |method: &str, figures: Vec<Figure>| Cell {
            scene: "house".into(),
            method: method.into(),
            settings: "cubes".into(),
            pixel_cm: 8,
            figures,
            phantoms: vec![Phantom { gap_cm: 1.0, share: 0.5, n: 2 }],
        };
        let mut record = Record::open(folder.path(), false)?;
        record.add(&cell("capt", Figure::median("build_s", vec![3.0, 1.0, 2.5], 3).into_iter().collect()))?;
        record.add(&cell("octomap", vec![]))?;
        let again = Record::open(folder.path(), false)?;
        assert!(again.has("house", "capt", 8) && again.has("house", "octomap", 8) && !again.has("house", "capt", 16));
        let lines = lines::read::<Measured>(&folder.path().join("measured.csv"))?;
        assert_eq!(lines[0].figure, Some(("build_s".into(), Value { value: 2.5, low: 1.0, high: 3.0 }, 3)));
        assert_eq!(lines[1].figure, None);
        assert_eq!(lines::read::<PhantomShare>(&folder.path().join("phantoms.csv"))?.len(), 2);
        assert!(!Record::open(folder.path(), true)?.has("house", "capt", 8));
        Ok(())
    }
}
