//! The measured tables, line by line, each number checked.

use crate::stability::Result;
use std::path::Path;

/// A reason instead of a value.
const SKIPPED: &str = "skipped";
const MEASURED: &[&str] = &["scene", "method", "settings", "pixel_cm", "metric", "value", "low", "high", "n"];
const PHANTOMS: &[&str] = &["scene", "method", "pixel_cm", "gap_cm", "share", "n"];
const SCALE: &[&str] = &["what", "size", "metric", "value", "low", "high"];

/// A figure with its least and greatest repeat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value {
    pub value: f64,
    pub low: f64,
    pub high: f64,
}

/// One line of `measured.csv`; no value where the cell was skipped.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    pub scene: String,
    pub method: String,
    /// Settings, or why it was skipped.
    pub settings: String,
    pub pixel_cm: f64,
    pub metric: String,
    pub value: Option<Value>,
}

/// One line of `phantoms.csv`.
#[derive(Debug, Clone, PartialEq)]
pub struct Phantom {
    pub scene: String,
    pub method: String,
    pub pixel_cm: f64,
    pub gap_cm: f64,
    pub share: f64,
}

/// One line of `scale.csv`.
#[derive(Debug, Clone, PartialEq)]
pub struct Scaled {
    pub what: String,
    pub size: f64,
    pub metric: String,
    pub value: Value,
}

/// A file that may be missing: no lines then.
pub fn optional<T>(path: &Path, read: fn(&Path) -> Result<Vec<T>>) -> Result<Vec<T>> {
    if path.exists() { read(path) } else { Ok(Vec::new()) }
}

pub fn measured(path: &Path) -> Result<Vec<Cell>> {
    lines(path, MEASURED, |line| {
        let skipped = line.text(4) == SKIPPED;
        let value = if skipped { None } else { Some(line.value(5)?) };
        Ok(Cell {
            scene: line.text(0),
            method: line.text(1),
            settings: line.text(2),
            pixel_cm: line.above_zero(3)?,
            metric: line.text(4),
            value,
        })
    })
}

pub fn phantoms(path: &Path) -> Result<Vec<Phantom>> {
    lines(path, PHANTOMS, |line| {
        Ok(Phantom {
            scene: line.text(0),
            method: line.text(1),
            pixel_cm: line.above_zero(2)?,
            gap_cm: line.number(3, "a finite number", |_| true)?,
            share: line.number(4, "a share from 0 to 1", |share| (0.0..=1.0).contains(&share))?,
        })
    })
}

pub fn scale(path: &Path) -> Result<Vec<Scaled>> {
    lines(path, SCALE, |line| {
        Ok(Scaled { what: line.text(0), size: line.above_zero(1)?, metric: line.text(2), value: line.value(3)? })
    })
}

/// A record and what an error says of its place.
struct Line<'a> {
    record: &'a csv::StringRecord,
    head: &'a [&'a str],
}

impl Line<'_> {
    fn text(&self, column: usize) -> String {
        self.record[column].to_owned()
    }

    fn number(&self, column: usize, expected: &str, fits: impl Fn(f64) -> bool) -> Result<f64> {
        let found = &self.record[column];
        let number = found.parse().ok().filter(|number: &f64| number.is_finite() && fits(*number));
        number.ok_or_else(|| format!("{}: expected {expected}, found {found:?}", self.head[column]).into())
    }

    fn above_zero(&self, column: usize) -> Result<f64> {
        self.number(column, "a number above 0", |number| number > 0.0)
    }

    /// Value, low and high, in columns from `first` on.
    fn value(&self, first: usize) -> Result<Value> {
        let at = |column| self.number(column, "a number from 0 on", |number| number >= 0.0);
        Ok(Value { value: at(first)?, low: at(first + 1)?, high: at(first + 2)? })
    }
}

fn lines<T>(path: &Path, head: &[&str], read: impl Fn(Line) -> Result<T>) -> Result<Vec<T>> {
    let name = path.display();
    let mut reader = csv::Reader::from_path(path).map_err(|e| format!("{name}: cannot be read: {e}"))?;
    let found = reader.headers().map_err(|e| format!("{name}: {e}"))?;
    if found.iter().ne(head.iter().copied()) {
        let found: Vec<_> = found.iter().collect();
        return Err(format!("{name}: line 1: expected {}, found {}", head.join(","), found.join(",")).into());
    }
    let mut all = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| format!("{name}: {e}; measure again, or take the line out"))?;
        let at = record.position().map_or(0, csv::Position::line);
        let line = read(Line { record: &record, head });
        all.push(line.map_err(|e| format!("{name}: line {at}: {e}; measure again, or take the line out"))?);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(lines: &str) -> Result<Vec<Cell>> {
        let file = tempfile::NamedTempFile::new()?;
        std::fs::write(file.path(), format!("{}\n{lines}", MEASURED.join(",")))?;
        measured(file.path())
    }

    #[test]
    fn quoted_settings_and_skipped_cells_are_read() -> Result<()> {
        let cells = read("house,octomap,\"a, b\",4,build_s,2,1.5,3,3\nhouse,capt,too slow,1,skipped,,,,\n")?;
        let value = Value { value: 2.0, low: 1.5, high: 3.0 };
        assert_eq!((cells[0].settings.as_str(), cells[0].value), ("a, b", Some(value)));
        assert_eq!((cells[1].settings.as_str(), cells[1].value), ("too slow", None));
        Ok(())
    }

    #[test]
    fn a_damaged_line_is_one_line_that_says_where_and_what() {
        let good = "house,octomap,,4,build_s,2,2,2,1\n";
        for (bad, says) in [
            ("house,octomap,,4,build_s,2x,2,2,1", r#"line 3: value: expected a number from 0 on, found "2x""#),
            ("house,octomap,,4,build_s,2,NaN,2,1", r#"line 3: low: expected a number from 0 on, found "NaN""#),
            ("house,octomap,,-4,build_s,2,2,2,1", r#"line 3: pixel_cm: expected a number above 0, found "-4""#),
            ("house,octomap,,4,build_s", "found record with 5 fields"),
        ] {
            let error = read(&format!("{good}{bad}\n")).expect_err(bad).to_string();
            assert!(error.contains(says) && !error.contains('\n'), "{error}");
        }
    }
}
