//! Parsing of text rows: their cells, the roles of the columns, and the numbers in them.
//!
//! A cell may be quoted; quotes may enclose the separator, and a quote inside is doubled. A coordinate that is empty or
//! a word for a missing number ([`decimal`]) is NaN: the row has no return.

use super::super::shown;
use super::super::values::{Sample, Scale};
use super::decimal::short;
use super::lines::MOST_LINE;
use crate::Columns;
use crate::colour::ColourSource;
use crate::number::decimal;
use crate::text::quoted_len;

/// Separator of columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::cloud) enum Separator {
    /// One or more blanks and tabs.
    Blanks,
    /// This byte, optionally with blanks around it.
    Byte(u8),
}

impl Separator {
    /// Returns its name for messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Blanks => "blanks",
            Self::Byte(b',') => "commas",
            Self::Byte(b'\t') => "tabs",
            Self::Byte(_) => "semicolons",
        }
    }

    /// Returns whether a byte beside a cell is insignificant.
    #[inline(always)]
    fn is_gap(self, byte: u8) -> bool {
        match self {
            Self::Blanks => byte.is_ascii_whitespace(),
            Self::Byte(own) => byte != own && byte.is_ascii_whitespace(),
        }
    }

    /// Returns `text` without gaps at its start.
    #[inline(always)]
    fn trim_start(self, text: &[u8]) -> &[u8] {
        let mut rest = text;
        while let [first, behind @ ..] = rest
            && self.is_gap(*first)
        {
            rest = behind;
        }
        rest
    }

    /// Returns the length of the cell at the start of `rest`.
    #[inline]
    fn cell_len(self, rest: &[u8]) -> Result<usize, Fault> {
        if rest.first() == Some(&b'"') {
            return self.quoted_cell_len(rest);
        }
        let end = match self {
            Self::Blanks => rest.iter().position(u8::is_ascii_whitespace),
            Self::Byte(byte) => memchr::memchr(byte, rest),
        };
        Ok(end.unwrap_or(rest.len()))
    }

    #[inline(never)]
    fn quoted_cell_len(self, rest: &[u8]) -> Result<usize, Fault> {
        let fault = |what| Fault::cell(format!("{what}: {}", shown(rest)));
        let len = quoted_len(rest).ok_or_else(|| fault("an opening quote without its end"))?;
        let behind = self.trim_start(&rest[len..]);
        let is_end = match self {
            Self::Blanks => behind.len() < rest.len() - len || behind.is_empty(),
            Self::Byte(byte) => behind.first().is_none_or(|first| *first == byte),
        };
        match (is_end, self) {
            (true, Self::Blanks) => Ok(len),
            (true, Self::Byte(_)) => Ok(rest.len() - behind.len()),
            (false, _) => Err(fault("text behind a closing quote")),
        }
    }

    /// Splits a row into cells, without the gaps around them.
    pub fn cells(self, row: &[u8]) -> Result<Vec<&[u8]>, Fault> {
        let (mut cells, mut rest) = (Vec::new(), self.trim_start(row));
        if self == Self::Blanks && rest.is_empty() {
            return Ok(cells);
        }
        loop {
            let (cell, behind) = rest.split_at(self.cell_len(rest)?);
            cells.push(cell.trim_ascii_end());
            rest = match (self, behind) {
                (Self::Byte(_), [_, behind @ ..]) => self.trim_start(behind),
                (Self::Blanks, _) if !self.trim_start(behind).is_empty() => self.trim_start(behind),
                _ => return Ok(cells),
            };
        }
    }
}

/// Returns a cell without its quotes.
pub(super) fn unquoted(cell: &[u8]) -> &[u8] {
    let cell = cell.trim_ascii();
    cell.strip_prefix(b"\"").and_then(|cell| cell.strip_suffix(b"\"")).map_or(cell, <[u8]>::trim_ascii)
}

/// Content of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Cell {
    Number(f64),
    /// Empty, or a word for a missing number.
    Missing,
    Text,
}

impl Cell {
    /// Parses a cell, quoted or not, with decimal points or commas.
    #[inline(never)]
    pub fn of(cell: &[u8], decimal_comma: bool) -> Self {
        let cell = unquoted(cell);
        match decimal(cell, decimal_comma) {
            Some(value) if !value.is_nan() => Self::Number(value),
            None if !cell.is_empty() => Self::Text,
            _ => Self::Missing,
        }
    }
}

/// Fault of a row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::cloud) struct Fault {
    pub reason: String,
    /// True if the number of cells is wrong, false if the content of a cell is.
    pub is_width: bool,
}

impl Fault {
    #[cold]
    fn cell(reason: String) -> Self {
        Self { reason, is_width: false }
    }

    /// Returns the fault of a line that is too long for a row.
    pub fn too_long() -> Self {
        Self::cell(format!("a line of more than {MOST_LINE} bytes: the file is not text, or it is damaged"))
    }

    #[cold]
    fn width(reason: String) -> Self {
        Self { reason, is_width: true }
    }
}

/// Roles of columns: 0 to 2 for coordinates, then these; `OTHER` columns are skipped.
const OTHER: u8 = u8::MAX;
const CLASS: usize = 3;
const INTENSITY: usize = 4;
const RED: usize = 5;
const ROLES: usize = 8;

/// Numbers of a row by role.
pub(in crate::cloud) type Row = [f64; ROLES];

/// Coordinates, class and value of a row, or its fault.
pub(in crate::cloud) type Parsed<V> = Result<([f64; 3], Option<f64>, Option<V>), Fault>;

/// Location of red, green and blue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::cloud) enum RgbPlaces {
    /// In one column each.
    Each([usize; 3]),
}

/// Columns of a row, from 0, all different.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::cloud) struct Places {
    pub axes: [usize; 3],
    pub class: Option<usize>,
    pub rgb: Option<RgbPlaces>,
    pub intensity: Option<usize>,
}

impl Places {
    /// Returns places for coordinates alone.
    pub fn of(axes: [usize; 3]) -> Self {
        Self { axes, class: None, rgb: None, intensity: None }
    }
}

/// Layout for parsing rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::cloud) struct RowLayout {
    separator: Separator,
    decimal_comma: bool,
    places: Places,
    /// Role of each column, up to the last that position and class need.
    roles: Vec<u8>,
}

/// Layout for parsing rows with their colour values.
#[derive(Debug)]
pub(in crate::cloud) struct ValueLayout<'a> {
    layout: &'a RowLayout,
    roles: Vec<u8>,
    source: ColourSource,
}

/// Sets the role of a column.
fn put(roles: &mut Vec<u8>, place: usize, role: usize) {
    if roles.len() <= place {
        roles.resize(place + 1, OTHER);
    }
    roles[place] = role as u8;
}

impl RowLayout {
    pub fn new(places: Places, separator: Separator, decimal_comma: bool) -> Self {
        let mut roles = Vec::new();
        places.class.into_iter().for_each(|class| put(&mut roles, class, CLASS));
        places.axes.into_iter().enumerate().for_each(|(axis, place)| put(&mut roles, place, axis));
        Self { separator, decimal_comma, places, roles }
    }

    pub fn separator(&self) -> Separator {
        self.separator
    }

    pub fn decimal_comma(&self) -> bool {
        self.decimal_comma
    }

    pub fn has_class(&self) -> bool {
        self.places.class.is_some()
    }

    /// Returns the layout with values of `source`, if rows have them.
    pub fn with_values(&self, source: ColourSource) -> Option<ValueLayout<'_>> {
        let mut roles = self.roles.clone();
        match (source, self.places.rgb, self.places.intensity) {
            (ColourSource::Rgb, Some(RgbPlaces::Each(places)), _) => {
                places.into_iter().enumerate().for_each(|(channel, place)| put(&mut roles, place, RED + channel));
            }
            (ColourSource::Intensity, _, Some(place)) => put(&mut roles, place, INTENSITY),
            _ => return None,
        }
        Some(ValueLayout { layout: self, roles, source })
    }

    /// Parses the coordinates of a row, and its class if there is one. Checks the number of `cells`, if given.
    #[inline]
    pub fn parse(&self, row: &[u8], cells: Option<usize>) -> Result<([f64; 3], Option<f64>), Fault> {
        let mut found = [0.0; ROLES];
        self.scan(row, cells, &self.roles, &mut found)?;
        Ok(self.split(&found))
    }

    fn split(&self, found: &Row) -> ([f64; 3], Option<f64>) {
        ([found[0], found[1], found[2]], self.places.class.map(|_| found[CLASS]))
    }

    /// Stores numbers by role in `found`; returns whether all values are present. Columns of position and class must
    /// be.
    #[inline(always)]
    fn scan(&self, row: &[u8], cells: Option<usize>, roles: &[u8], found: &mut Row) -> Result<bool, Fault> {
        // Where commas separate columns, they are part of numbers only in quotes.
        let point = if self.decimal_comma && self.separator != Separator::Byte(b',') { b',' } else { b'.' };
        let (mut rest, mut is_whole) = (row, true);
        for (column, &role) in roles.iter().enumerate() {
            let is_needed = column < self.roles.len();
            let is_end = match self.separator {
                Separator::Byte(_) if column > 0 => match rest.split_first() {
                    Some((_, behind)) => {
                        rest = self.separator.trim_start(behind);
                        false
                    }
                    None => true,
                },
                separator => {
                    rest = separator.trim_start(rest);
                    rest.is_empty() && separator == Separator::Blanks
                }
            };
            if is_end {
                let may_end = !is_needed && cells.is_none_or(|cells| cells == column);
                return if may_end { Ok(false) } else { Err(self.too_few(column, cells, row)) };
            }
            if role == OTHER {
                rest = &rest[self.separator.cell_len(rest)?..];
                continue;
            }
            let value = match short(rest, point) {
                Some((value, len)) if self.ends_cell(&mut rest, len) => value,
                _ => {
                    let (cell, behind) = rest.split_at(self.separator.cell_len(rest)?);
                    rest = behind;
                    match Cell::of(cell, self.decimal_comma) {
                        Cell::Number(value) => value,
                        Cell::Missing => {
                            is_whole &= is_needed;
                            f64::NAN
                        }
                        Cell::Text => {
                            let found = shown(cell.trim_ascii());
                            return Err(Fault::cell(format!(
                                "expected a number in column {}, found {found}",
                                column + 1
                            )));
                        }
                    }
                }
            };
            found[usize::from(role)] = value;
        }
        if let Some(cells) = cells {
            self.check_width(rest, roles.len(), cells, row)?;
        }
        Ok(is_whole)
    }

    /// Returns whether a cell ends after `len` bytes; if so, advances `rest` to the separator.
    #[inline]
    fn ends_cell(&self, rest: &mut &[u8], len: usize) -> bool {
        let behind = &rest[len..];
        let ended = match self.separator {
            Separator::Blanks => behind.first().is_none_or(u8::is_ascii_whitespace).then_some(behind),
            Separator::Byte(byte) if behind.first() == Some(&byte) => Some(behind),
            separator @ Separator::Byte(byte) => {
                Some(separator.trim_start(behind)).filter(|behind| behind.first().is_none_or(|first| *first == byte))
            }
        };
        ended.inspect(|behind| *rest = behind).is_some()
    }

    /// Checks that the row has `cells` cells, given `rest` after the first `columns`; empty cells at the end do not
    /// count.
    #[inline]
    fn check_width(&self, rest: &[u8], columns: usize, cells: usize, row: &[u8]) -> Result<(), Fault> {
        let (mut all, mut filled) = (columns, columns);
        match self.separator {
            Separator::Blanks => {
                let (mut is_blank, mut is_quoted) = (true, false);
                for byte in rest {
                    let next = byte.is_ascii_whitespace();
                    all += usize::from(is_blank & !next);
                    is_blank = next;
                    is_quoted |= *byte == b'"';
                }
                if is_quoted {
                    all = columns + self.separator.cells(rest)?.len();
                }
                filled = all;
            }
            separator @ Separator::Byte(_) => {
                let mut rest = rest;
                while let [_, behind @ ..] = rest {
                    let cell = separator.trim_start(behind);
                    rest = &cell[separator.cell_len(cell)?..];
                    all += 1;
                    if rest.len() < cell.len() {
                        filled = all;
                    }
                }
            }
        }
        match filled <= cells && cells <= all {
            true => Ok(()),
            false if filled > cells => Err(self.too_many(filled, cells, row)),
            false => Err(self.too_few(all, Some(cells), row)),
        }
    }

    #[cold]
    fn too_few(&self, found: usize, cells: Option<usize>, row: &[u8]) -> Fault {
        let row = shown(row.trim_ascii());
        Fault::width(match cells {
            Some(cells) => format!("expected {cells} columns, found {found}: {row}"),
            None => format!("expected {} columns or more, found {found}: {row}", self.roles.len()),
        })
    }

    #[cold]
    fn too_many(&self, found: usize, cells: usize, row: &[u8]) -> Fault {
        Fault::width(format!("expected {cells} columns, found {found}: {}", shown(row.trim_ascii())))
    }

    pub fn bytes(&self) -> impl Iterator<Item = u8> + '_ {
        let separator = match self.separator {
            Separator::Blanks => b' ',
            Separator::Byte(byte) => byte,
        };
        [separator, self.decimal_comma.into()].into_iter().chain(self.roles.iter().copied())
    }
}

impl ValueLayout<'_> {
    /// Like [`RowLayout::parse`], but also returns the numbers of the row's value; `None` if it has none.
    pub fn parse(&self, row: &[u8], cells: Option<usize>) -> Parsed<Row> {
        let mut found = [0.0; ROLES];
        let whole = self.layout.scan(row, cells, &self.roles, &mut found)?;
        let (at, class) = self.layout.split(&found);
        Ok((at, class, whole.then_some(found)))
    }

    /// Converts these numbers to a value.
    #[inline]
    pub fn value(&self, row: &Row, scale: &Scale) -> [u16; 3] {
        match self.source {
            ColourSource::Rgb => [0, 1, 2].map(|channel| scale.of(row[RED + channel])),
            _ => [scale.of(row[INTENSITY]), 0, 0],
        }
    }

    /// Adds these numbers to a sample.
    pub fn look(&self, row: &Row, sample: &mut Sample) {
        let numbers = if self.source == ColourSource::Rgb { RED..ROLES } else { INTENSITY..RED };
        row[numbers].iter().for_each(|&value| sample.add(value));
    }
}

impl Columns {
    pub(super) fn places(self) -> Places {
        Places {
            axes: self.axes.map(usize::from),
            class: self.class.map(usize::from),
            rgb: self.rgb.map(|rgb| RgbPlaces::Each(rgb.map(usize::from))),
            intensity: self.intensity.map(usize::from),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_numbers_no_numbers_or_text() {
        for word in ["", "nan", "-1.#IND", "NA", "\"\"", " \"nan\" "] {
            assert_eq!(Cell::of(word.as_bytes(), false), Cell::Missing, "{word}");
            assert_eq!(Cell::of(word.as_bytes(), true), Cell::Missing, "{word}");
        }
        for (word, comma, expected) in [
            ("1.5", false, Cell::Number(1.5)),
            ("\"1.5\"", false, Cell::Number(1.5)),
            ("1,5", true, Cell::Number(1.5)),
            ("1e400", false, Cell::Number(f64::INFINITY)),
            ("-inf", true, Cell::Number(f64::NEG_INFINITY)),
            ("1,5", false, Cell::Text),
            ("1.5", true, Cell::Text),
            ("nano", false, Cell::Text),
        ] {
            assert_eq!(Cell::of(word.as_bytes(), comma), expected, "{word}");
        }
    }

    #[test]
    fn rows_are_read_by_their_cells() {
        let places = Places { class: Some(3), ..Places::of([2, 0, 1]) };
        let layout = RowLayout::new(places, Separator::Blanks, false);
        assert_eq!(layout.parse(b" 2\t3 1 7 9 9 ", None), Ok(([1.0, 2.0, 3.0], Some(7.0))));
        let fault = |layout: &RowLayout, row: &str, cells| layout.parse(row.as_bytes(), cells).unwrap_err().reason;
        assert!(fault(&layout, "1 2 3", None).starts_with("expected 4 columns or more, found 3"));
        assert!(fault(&layout, "1 a 3 4", None).contains("a number in column 2, found \"a\""));
        assert!(layout.parse(b"nan 1 inf 4", None).is_ok_and(|(at, _)| at[0] == f64::INFINITY && at[1].is_nan()));
        assert_eq!(layout.parse(b"2 3 1 7 \"a b\"", Some(5)), Ok(([1.0, 2.0, 3.0], Some(7.0))));
        for (row, found) in [("2 3 1 7", 4), ("2 3 1", 3), ("2 3 1 7 8 9", 6), ("2 3 1 7 a b", 6)] {
            assert!(fault(&layout, row, Some(5)).starts_with(&format!("expected 5 columns, found {found}")), "{row}");
        }
        let commas = RowLayout::new(Places::of([1, 2, 3]), Separator::Byte(b','), false);
        for row in
            ["a,1,2,3", "\"a,b\",1,2,3", "\"a \"\"b\"\", c\" , 1 , 2 , \"3\" ", ",1,2,3,", ",1,2,3, ,", "5\",1,2,3"]
        {
            assert_eq!(commas.parse(row.as_bytes(), Some(4)), Ok(([1.0, 2.0, 3.0], None)), "{row}");
        }
        assert!(commas.parse(b"a,,,", Some(4)).unwrap().0.iter().all(|v| v.is_nan()));
        for (row, reason) in [
            ("a,1,2", "expected 4 columns, found 3"),
            ("a,b,1,2,3", "expected a number in column 2, found \"b\""),
            ("a,1,2,3,4", "expected 4 columns, found 5"),
            ("\"a,1,2,3", "an opening quote without its end"),
            ("a,1,2,\"3", "an opening quote without its end"),
            ("\"a\"b,1,2,3", "text behind a closing quote"),
            ("", "expected 4 columns, found 1"),
        ] {
            assert!(fault(&commas, row, Some(4)).starts_with(reason), "{row}: {}", fault(&commas, row, Some(4)));
        }
        let tabs = RowLayout::new(Places::of([1, 2, 3]), Separator::Byte(b'\t'), false);
        for row in ["\t1\t2\t3\t9", "a b\t1 \t 2\t3\t"] {
            assert_eq!(tabs.parse(row.as_bytes(), Some(5)), Ok(([1.0, 2.0, 3.0], None)), "{row}");
        }
        assert!(Separator::Blanks.cells(b" \t").is_ok_and(|cells| cells.is_empty()));
        let german = RowLayout::new(Places::of([0, 1, 2]), Separator::Byte(b','), true);
        assert_eq!(german.parse(b"1,\"2,5\",\"-3,5\"", Some(3)), Ok(([1.0, 2.5, -3.5], None)));
    }

    #[test]
    fn values_stand_behind_and_between_and_rows_may_end_before_them() {
        for (separator, byte) in [(Separator::Blanks, ' '), (Separator::Byte(b';'), ';')] {
            let of = |text: &str| text.replace(' ', &byte.to_string()).into_bytes();
            let rgb = Some(RgbPlaces::Each([4, 1, 6]));
            let places = Places { rgb, intensity: Some(5), ..Places::of([0, 2, 3]) };
            let layout = RowLayout::new(places, separator, false);
            let values = layout.with_values(ColourSource::Rgb).unwrap();
            let (at, class, row) = values.parse(&of("1 20 2 3 10 0.5 30 rest"), None).unwrap();
            assert_eq!((at, class), ([1.0, 2.0, 3.0], None));
            assert_eq!(values.value(&row.unwrap(), &Scale::BYTES), [10, 20, 30]);
            let intensity = layout.with_values(ColourSource::Intensity).unwrap();
            let (_, _, row) = intensity.parse(&of("1 x 2 3 x 7 x"), None).unwrap();
            assert_eq!(intensity.value(&row.unwrap(), &Scale::WHOLE), [7, 0, 0]);
            for short in ["1 20 2 3 10 0.5", "1 20 2 3"] {
                assert_eq!(values.parse(&of(short), None).unwrap(), ([1.0, 2.0, 3.0], None, None), "{short}");
            }
            let fault = |row: &str| values.parse(&of(row), None).unwrap_err().reason;
            assert!(fault("1 20 2").contains("expected 4 columns"));
            assert!(fault("1 20 2 3 10 0.5 red").contains("a number in column 7"));
            assert_eq!(values.parse(&of("1 20 2 3 NA 0.5 30"), None).unwrap(), ([1.0, 2.0, 3.0], None, None));
            assert!(layout.with_values(ColourSource::Class).is_none());
        }
    }
}
