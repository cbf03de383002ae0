//! The tables that charts are drawn from: their columns, one reader, one writer.
//!
//! In and out: CSV with a head. Each number that is read is checked; an error is one line that says where and what.

use crate::stability::Result;
use std::io::Write as _;
use std::path::Path;

/// A reason in place of a value.
const SKIPPED: &str = "skipped";

/// A figure with its least and greatest repeat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value {
    pub value: f64,
    pub low: f64,
    pub high: f64,
}

/// A figure of `measured.csv`.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    pub scene: String,
    pub method: String,
    /// Settings, or why there is no figure.
    pub settings: String,
    pub pixel_cm: u32,
    /// Metric, its value and the number of questions; `None` if it was skipped.
    pub figure: Option<(String, Value, usize)>,
}

/// A share of `phantoms.csv`: how many boxes at one distance from the nearest point were answered "hit".
#[derive(Debug, Clone, PartialEq)]
pub struct PhantomShare {
    pub scene: String,
    pub method: String,
    pub pixel_cm: u32,
    pub gap_cm: f64,
    pub share: f64,
    pub n: usize,
}

/// A figure of `scale.csv`.
#[derive(Debug, Clone, PartialEq)]
pub struct Scaled {
    pub what: String,
    pub size: u64,
    pub metric: String,
    pub value: Value,
}

/// A line of one of the tables.
pub trait Line: Sized {
    /// Names of the columns.
    const HEAD: &'static [&'static str];

    /// Its cells, one per column.
    fn cells(&self) -> Vec<String>;

    /// The line of these cells.
    fn parse(cells: &Cells) -> Result<Self>;
}

impl Line for Measured {
    const HEAD: &'static [&'static str] =
        &["scene", "method", "settings", "pixel_cm", "metric", "value", "low", "high", "n"];

    fn cells(&self) -> Vec<String> {
        let Self { scene, method, settings, pixel_cm, figure } = self;
        let (metric, value, n) = match figure {
            Some((metric, value, n)) => (metric.clone(), value.cells(), n.to_string()),
            None => (SKIPPED.to_owned(), [const { String::new() }; 3], String::new()),
        };
        let cells = [scene.clone(), method.clone(), settings.clone(), pixel_cm.to_string(), metric];
        cells.into_iter().chain(value).chain([n]).collect()
    }

    fn parse(cells: &Cells) -> Result<Self> {
        let metric = cells.text(4);
        let figure = match metric == SKIPPED {
            true => None,
            false => Some((metric, cells.value(5)?, cells.whole(8)?)),
        };
        let [scene, method, settings] = [0, 1, 2].map(|column| cells.text(column));
        Ok(Self { scene, method, settings, pixel_cm: cells.pixel(3)?, figure })
    }
}

impl Line for PhantomShare {
    const HEAD: &'static [&'static str] = &["scene", "method", "pixel_cm", "gap_cm", "share", "n"];

    fn cells(&self) -> Vec<String> {
        let Self { scene, method, pixel_cm, gap_cm, share, n } = self;
        vec![scene.clone(), method.clone(), pixel_cm.to_string(), short(*gap_cm), short(*share), n.to_string()]
    }

    fn parse(cells: &Cells) -> Result<Self> {
        Ok(Self {
            scene: cells.text(0),
            method: cells.text(1),
            pixel_cm: cells.pixel(2)?,
            gap_cm: cells.number(3, "a finite number", |_| true)?,
            share: cells.number(4, "a share from 0 to 1", |share| (0.0..=1.0).contains(&share))?,
            n: cells.whole(5)?,
        })
    }
}

impl Line for Scaled {
    const HEAD: &'static [&'static str] = &["what", "size", "metric", "value", "low", "high"];

    fn cells(&self) -> Vec<String> {
        let Self { what, size, metric, value } = self;
        [what.clone(), size.to_string(), metric.clone()].into_iter().chain(value.cells()).collect()
    }

    fn parse(cells: &Cells) -> Result<Self> {
        Ok(Self { what: cells.text(0), size: cells.whole(1)?, metric: cells.text(2), value: cells.value(3)? })
    }
}

impl Value {
    fn cells(self) -> [String; 3] {
        [self.value, self.low, self.high].map(short)
    }
}

/// Six significant digits; measurements have no more.
fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return (value + 0.0).to_string();
    }
    let decimals = (5 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// The cells of a line, with the names of their columns for errors.
pub struct Cells<'a> {
    record: &'a csv::StringRecord,
    head: &'static [&'static str],
}

impl Cells<'_> {
    fn text(&self, column: usize) -> String {
        self.record[column].to_owned()
    }

    fn number(&self, column: usize, expected: &str, fits: impl Fn(f64) -> bool) -> Result<f64> {
        let found = &self.record[column];
        let number = found.parse().ok().filter(|number: &f64| number.is_finite() && fits(*number));
        number.ok_or_else(|| self.bad(column, expected))
    }

    /// Value, low and high, in columns from `first` on.
    fn value(&self, first: usize) -> Result<Value> {
        let at = |column| self.number(column, "a number from 0 on", |number| number >= 0.0);
        Ok(Value { value: at(first)?, low: at(first + 1)?, high: at(first + 2)? })
    }

    fn whole<T: std::str::FromStr>(&self, column: usize) -> Result<T> {
        self.record[column].parse().map_err(|_| self.bad(column, "a whole number"))
    }

    fn pixel(&self, column: usize) -> Result<u32> {
        self.whole(column).ok().filter(|&pixel| pixel > 0).ok_or_else(|| self.bad(column, "a whole number above 0"))
    }

    fn bad(&self, column: usize, expected: &str) -> crate::stability::Error {
        format!("{}: expected {expected}, found {:?}", self.head[column], &self.record[column]).into()
    }
}

/// All lines of the table at `path`.
pub fn read<T: Line>(path: &Path) -> Result<Vec<T>> {
    let name = path.display();
    let mut reader = csv::Reader::from_path(path).map_err(|e| format!("{name}: cannot be read: {e}"))?;
    let found = reader.headers().map_err(|e| format!("{name}: {e}"))?;
    if found.iter().ne(T::HEAD.iter().copied()) {
        let found: Vec<_> = found.iter().collect();
        return Err(format!("{name}: line 1: expected {}, found {}", T::HEAD.join(","), found.join(",")).into());
    }
    let mut all = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| format!("{name}: {e}; measure again, or take the line out"))?;
        let at = record.position().map_or(0, csv::Position::line);
        let line = T::parse(&Cells { record: &record, head: T::HEAD });
        all.push(line.map_err(|e| format!("{name}: line {at}: {e}; measure again, or take the line out"))?);
    }
    Ok(all)
}

/// Makes the table at `path` of `lines`, in place of an older one.
pub fn write<T: Line>(path: &Path, lines: &[T]) -> Result<()> {
    let head = T::HEAD.iter().map(|name| (*name).to_owned()).collect();
    let text = text([head].into_iter().chain(lines.iter().map(T::cells)))?;
    std::fs::write(path, text).map_err(|e| format!("{}: cannot be written: {e}", path.display()).into())
}

/// Adds `lines` to the table at `path`, all at once.
pub fn append<T: Line>(path: &Path, lines: &[T]) -> Result<()> {
    let text = text(lines.iter().map(T::cells))?;
    let file = std::fs::OpenOptions::new().append(true).open(path);
    let written = file.and_then(|mut file| file.write_all(&text));
    written.map_err(|e| format!("{}: cannot be written: {e}", path.display()).into())
}

fn text(lines: impl Iterator<Item = Vec<String>>) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for cells in lines {
        writer.write_record(cells.iter().map(|cell| cell.replace('\n', " ")))?;
    }
    writer.into_inner().map_err(|error| error.to_string().into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(lines: &str) -> Result<Vec<Measured>> {
        let file = tempfile::NamedTempFile::new()?;
        std::fs::write(file.path(), format!("{}\n{lines}", Measured::HEAD.join(",")))?;
        read(file.path())
    }

    #[test]
    fn what_is_written_is_read_again() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let value = Value { value: 2.5, low: 1.0, high: 123_456.75 };
        let measured = |settings: &str, figure| Measured {
            scene: "house".into(),
            method: "capt".into(),
            settings: settings.into(),
            pixel_cm: 8,
            figure,
        };
        let lines =
            [measured("cubes, \"exact\"", Some(("build_s".into(), value, 3))), measured("would take 40 GB", None)];
        let path = folder.path().join("measured.csv");
        write(&path, &lines[..1])?;
        append(&path, &lines[1..])?;
        let text = std::fs::read_to_string(&path)?;
        let expected =
            "house,capt,\"cubes, \"\"exact\"\"\",8,build_s,2.5,1,123457,3\nhouse,capt,would take 40 GB,8,skipped,,,,\n";
        assert_eq!(text.split_once('\n').ok_or("no head")?.1, expected);
        let again = read::<Measured>(&path)?;
        assert_eq!((&again[0].settings, &again[1]), (&lines[0].settings, &lines[1]));
        let shared =
            PhantomShare { scene: "house".into(), method: "capt".into(), pixel_cm: 8, gap_cm: -2.5, share: 0.25, n: 4 };
        write(&path, std::slice::from_ref(&shared))?;
        assert_eq!(read::<PhantomShare>(&path)?, [shared]);
        let scaled = Scaled { what: "query".into(), size: 7, metric: "ns".into(), value: Value { high: 3.0, ..value } };
        write(&path, std::slice::from_ref(&scaled))?;
        assert_eq!(read::<Scaled>(&path)?, [scaled]);
        assert!(read::<PhantomShare>(&path).is_err(), "another head");
        Ok(())
    }

    #[test]
    fn a_damaged_line_is_one_line_that_says_where_and_what() {
        let good = "house,octomap,,4,build_s,2,2,2,1\n";
        for (bad, says) in [
            ("house,octomap,,4,build_s,2x,2,2,1", r#"line 3: value: expected a number from 0 on, found "2x""#),
            ("house,octomap,,4,build_s,2,NaN,2,1", r#"line 3: low: expected a number from 0 on, found "NaN""#),
            ("house,octomap,,-4,build_s,2,2,2,1", r#"line 3: pixel_cm: expected a whole number above 0, found "-4""#),
            ("house,octomap,,4,build_s,2,2,2,", r#"line 3: n: expected a whole number, found """#),
            ("house,octomap,,4,build_s", "found record with 5 fields"),
        ] {
            let error = read_text(&format!("{good}{bad}\n")).expect_err(bad).to_string();
            assert!(error.contains(says) && !error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn numbers_keep_six_digits() {
        let numbers = [0.0, -0.0, 123456789.0, 0.000123456789, 2.5, -28.0];
        assert_eq!(numbers.map(short), ["0", "0", "123456789", "0.000123457", "2.5", "-28"]);
    }
}
