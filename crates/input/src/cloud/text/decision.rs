//! Decides the layout of a table once, from its header and first rows.
//!
//! - The separator is the one that a first line `sep=;` states, else the first of semicolon, tab, comma and blanks with
//!   which more than half of the rows have three numbers. Tabs count as blanks if they merely align columns: if the
//!   number of tabs varies between rows but the number of words does not, or if a column is always empty and has no
//!   name.
//! - The number of cells is that of most rows. Every row must have it; empty cells at its end do not count.
//! - Names come from the line before the rows that is not a row, else from the last comment before the rows that names
//!   x, y and z. They fit if there are as many as cells. One fewer fits if the first column holds row names (quoted, or
//!   text or a number that counts up before the first coordinate), or if a blank separates dates from times. More fit,
//!   with blanks as separators, if they can be joined in only one way: `Point ID X Y Z`. A comment may have other words
//!   before and after the names. Anything else is refused, except a comment whose first names are x, y and z: it states
//!   the default.
//! - [`heading`](super::heading) ranks names. Without names, x, y and z come first. Tables without names are refused if
//!   the first column is quoted, or if it counts up before three columns with decimals and so may number the points.
//! - In most rows, coordinates must be numbers or words for a missing number. Coordinates decide whether there are
//!   decimal commas, or else values.
//!
//! Whatever is refused can be read with `--columns`, which decides everything but the separator.

use super::super::shown;
use super::heading::{NameUnit, NoAxes, axes, is_neutral, places, unit_of};
use super::layout::{Cell, Places, RgbPlaces, RowLayout, Separator, unquoted};
use crate::Columns;

/// Limits on the names examined in a header, on the words joined to names, and on the surplus of words.
const MOST_NAMES: usize = 4096;
const MOST_WORDS: usize = 256;
const MOST_JOINED: usize = 16;

/// Content of columns without a header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Custom {
    /// Coordinates.
    Xyz,
    /// Coordinates, red, green and blue.
    XyzRgb,
    /// Coordinates, then the intensity, colours, or both.
    Pts,
    /// Coordinates, intensity, and optionally colours.
    Ptx,
}

impl Custom {
    pub fn places(self, cells: usize) -> Places {
        let (intensity, rgb) = match (self, cells) {
            // Where one cloud of a PTS has intensities alone, another may have colours behind them.
            (Self::Ptx, _) | (Self::Pts, 4 | 7..) => (Some(3), Some([4, 5, 6])),
            (Self::Pts, 6) | (Self::XyzRgb, _) => (None, Some([3, 4, 5])),
            _ => (None, None),
        };
        Places { rgb: rgb.map(RgbPlaces::Each), intensity, ..Places::of([0, 1, 2]) }
    }
}

/// Beginning of a table.
pub(super) struct Beginning<'a> {
    /// Separator that the text states.
    pub separator: Option<Separator>,
    /// Comments before the rows.
    pub comments: &'a [Vec<u8>],
    /// Line before the rows that is not a row.
    pub header: Option<&'a [u8]>,
    /// The first rows, at least one.
    pub rows: &'a [Vec<u8>],
}

/// Layout of a table.
#[derive(Debug)]
pub(super) struct Decision {
    pub layout: RowLayout,
    pub places: Places,
    /// Number of cells per row, if it is fixed.
    pub cells: Option<usize>,
    /// Names of the columns, as far as known.
    pub names: Vec<String>,
    /// Units of the coordinates, as far as names state them.
    pub units: [Option<NameUnit>; 3],
    /// Warning about a guess that the user should check.
    pub odd: Option<String>,
}

/// Reason why the layout of a table is unclear.
#[derive(Debug)]
pub(super) struct Refusal {
    /// True if the header is at fault, false if the rows are.
    pub is_of_header: bool,
    pub reason: String,
}

impl Refusal {
    fn of_header(reason: impl Into<String>) -> Self {
        Self { is_of_header: true, reason: reason.into() }
    }

    fn of_rows(reason: impl Into<String>) -> Self {
        Self { is_of_header: false, reason: reason.into() }
    }
}

type Result<T> = std::result::Result<T, Refusal>;

/// Returns the separator that a line states for spreadsheets: `sep=;`.
pub(super) fn stated_separator(line: &[u8]) -> Option<Separator> {
    let line = line.strip_prefix(b"\"").unwrap_or(line);
    let (name, stated) = line.split_at_checked(4)?;
    match stated {
        [byte @ (b';' | b'\t' | b','), rest @ ..] if name.eq_ignore_ascii_case(b"sep=") => {
            let is_end = rest.iter().all(|byte| byte.is_ascii_whitespace() || *byte == b'"');
            is_end.then_some(Separator::Byte(*byte))
        }
        _ => None,
    }
}

/// Returns, for each word of a line, whatever separates them, whether it is a number or stands for a missing one.
fn are_numbers(line: &[u8]) -> impl Iterator<Item = bool> {
    // Quotes may enclose a number with a comma.
    let words = line.split(|byte| matches!(byte, b';' | b'\t' | b',' | b' ' | b'"'));
    words.filter(|word| !word.is_empty()).map(|word| Cell::of(word, false) != Cell::Text)
}

/// Returns whether a line is a row: it holds three numbers, whatever separates them, or only separators.
pub(super) fn is_row(line: &[u8]) -> bool {
    let numbers = are_numbers(line).filter(|is_number| *is_number).take(3).count();
    numbers == 3 || !line.iter().any(|byte| byte.is_ascii_alphanumeric() || !byte.is_ascii())
}

/// Returns whether a line holds no words but numbers.
pub(super) fn is_without_text(line: &[u8]) -> bool {
    are_numbers(line).all(|is_number| is_number)
}

/// Returns whether a line names x, y and z, whatever separates the names.
pub(super) fn is_header(line: &[u8]) -> bool {
    let separators = [Separator::Byte(b';'), Separator::Byte(b'\t'), Separator::Byte(b','), Separator::Blanks];
    separators.into_iter().any(|separator| !matches!(axes(&names(line, separator)), Err(NoAxes::Missing)))
}

/// Returns the names in a header, without empty ones at its end.
fn names(header: &[u8], separator: Separator) -> Vec<String> {
    let mut begin = header;
    while let [b'#' | b'/' | b'%' | b'!', behind @ ..] = begin {
        // Only one blank between mark and names is skipped: a tab there is an empty name.
        begin = behind.strip_prefix(b" ").unwrap_or(behind);
    }
    // Older programs write Latin-1.
    let latin = |cell: &[u8]| cell.iter().map(|&byte| char::from(byte)).collect();
    let text = |cell: &[u8]| std::str::from_utf8(unquoted(cell)).map_or_else(|_| latin(unquoted(cell)), str::to_owned);
    let mut names: Vec<String> =
        separator.cells(begin).unwrap_or_default().iter().take(MOST_NAMES).map(|cell| text(cell)).collect();
    if separator == Separator::Blanks {
        // A unit in brackets belongs to the name before it.
        let mut joined: Vec<String> = Vec::new();
        let mut is_open = false;
        for name in names {
            is_open |= name.starts_with(['(', '[']);
            match joined.last_mut().filter(|_| is_open) {
                Some(before) => *before += &format!(" {name}"),
                None => joined.push(name.clone()),
            }
            is_open &= !name.ends_with([')', ']']);
        }
        names = joined;
    }
    names.truncate(names.iter().rposition(|name| !name.is_empty()).map_or(0, |last| last + 1));
    names
}

/// Rows at the beginning of a table, split at a separator.
struct Table<'a> {
    separator: Separator,
    /// Cells of the rows with the most frequent number of cells.
    rows: Vec<Vec<&'a [u8]>>,
    /// Minimum and maximum number of cells these rows may count as having, since cells at the end may be empty.
    least: usize,
    most: usize,
}

/// Returns how many cells of a row are numbers.
fn numbers(cells: &[&[u8]], separator: Separator) -> usize {
    // Where commas separate columns, a comma is part of a number only in quotes.
    let is_number = |cell: &&&[u8]| {
        let may_have_comma = separator != Separator::Byte(b',') || cell.starts_with(b"\"");
        let is_filled = !unquoted(cell).is_empty();
        let is = |comma| Cell::of(cell, comma) != Cell::Text;
        is_filled && (is(false) || may_have_comma && is(true))
    };
    cells.iter().filter(is_number).count()
}

/// Returns the most frequent value, the first of several.
pub(super) fn most_frequent(values: impl Iterator<Item = usize> + Clone) -> usize {
    let count = |value: usize| values.clone().filter(|other| *other == value).count();
    let counts: Vec<(usize, usize)> = values.clone().map(|value| (count(value), value)).collect();
    counts.iter().rev().max_by_key(|(count, _)| *count).map_or(0, |(_, value)| *value)
}

impl<'a> Table<'a> {
    fn of(beginning: &Beginning<'a>) -> Result<Self> {
        refuse_both_commas(beginning.rows)?;
        let candidates = [Separator::Byte(b';'), Separator::Byte(b'\t'), Separator::Byte(b','), Separator::Blanks];
        let split = |separator: Separator| -> Vec<Vec<&'a [u8]>> {
            beginning.rows.iter().filter_map(|row| separator.cells(row).ok()).collect()
        };
        let fitting = |separator: Separator| {
            let rows = split(separator);
            let count = |rows: &Vec<Vec<&[u8]>>| rows.iter().filter(|row| numbers(row, separator) >= 3).count();
            (count(&rows), rows)
        };
        let may_be = |separator: Separator| beginning.separator.is_none_or(|stated| stated == separator);
        // Rows without any return do not show the separator.
        let filled = beginning.rows.iter().filter(|row| row.iter().any(u8::is_ascii_alphanumeric)).count().max(1);
        let tried = candidates.map(|separator| (separator, fitting(separator)));
        let most = |least: usize| tried.iter().position(|(by, (count, _))| may_be(*by) && *count >= least);
        let best = most(filled / 2 + 1).or_else(|| most(1)).ok_or_else(|| {
            let row = shown(beginning.rows.first().map_or(&[][..], |row| row.trim_ascii()));
            Refusal::of_rows(format!("expected three numbers, found {row}"))
        })?;
        let [_, _, _, (_, (_, by_blanks))] = &tried;
        let is_alignment = beginning.separator.is_none()
            && tried[best].0 == Separator::Byte(b'\t')
            && Self::lines_up(&tried[best].1.1, by_blanks, beginning.rows.len(), beginning.header);
        let (separator, (_, rows)) = if is_alignment { &tried[3] } else { &tried[best] };
        let all = most_frequent(rows.iter().map(Vec::len));
        let rows: Vec<Vec<&[u8]>> = rows.iter().filter(|row| row.len() == all).cloned().collect();
        let filled = |row: &Vec<&[u8]>| row.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1);
        let least = rows.iter().map(filled).max().unwrap_or(0).max(3.min(all));
        Ok(Self { separator: *separator, rows, least, most: all })
    }

    /// Returns whether tabs merely align words.
    fn lines_up(tabs: &[Vec<&[u8]>], blanks: &[Vec<&[u8]>], rows: usize, header: Option<&[u8]>) -> bool {
        let is_constant = |rows: &[Vec<&[u8]>]| rows.windows(2).all(|pair| pair[0].len() == pair[1].len());
        let enough = blanks.len() == rows && blanks.iter().all(|row| row.len() >= 3);
        if !enough || !is_constant(blanks) {
            return false;
        }
        let named = header.map(|header| names(header, Separator::Byte(b'\t'))).unwrap_or_default();
        let has_name = |column: usize| named.get(column).is_some_and(|name| !name.is_empty());
        let is_empty = |column: usize| tabs.iter().all(|row| row.get(column).is_some_and(|cell| cell.is_empty()));
        // An empty column at the end does not count.
        let width = tabs.iter().map(|row| row.iter().rposition(|cell| !cell.is_empty()).unwrap_or(0)).max();
        !is_constant(tabs) || (0..width.unwrap_or(0)).any(|column| is_empty(column) && !has_name(column))
    }

    /// Returns whether `holds` is true for this column's cell in more than half of the rows.
    fn mostly(&self, column: usize, holds: impl Fn(&[u8]) -> bool) -> bool {
        2 * self.rows.iter().filter(|row| row.get(column).is_some_and(|cell| holds(cell))).count() > self.rows.len()
    }

    fn is_text(&self, column: usize) -> bool {
        let is_number = |cell: &[u8]| Cell::of(cell, false) != Cell::Text || Cell::of(cell, true) != Cell::Text;
        self.mostly(column, |cell| !is_number(cell))
    }

    /// Returns whether commas between whole numbers separate decimals from them, too: some have leading zeros.
    fn has_split_decimals(&self) -> bool {
        let is_whole = |cell: &&[u8]| cell.iter().all(|byte| byte.is_ascii_digit() || matches!(byte, b'-' | b'+'));
        let is_decimals = |cell: Option<&&[u8]>| cell.is_some_and(|cell| cell.len() > 1 && cell[0] == b'0');
        self.separator == Separator::Byte(b',')
            && self.least >= 6
            && self.rows.iter().all(|row| row.iter().take(6).all(is_whole))
            && self.rows.iter().any(|row| [1, 3, 5].iter().any(|&column| is_decimals(row.get(column))))
    }

    /// Returns whether no row has anything in the column.
    fn is_empty(&self, column: usize) -> bool {
        self.rows.iter().all(|row| row.get(column).is_none_or(|cell| cell.is_empty()))
    }

    /// Returns whether the column holds dates and the next one times, separated by a blank.
    fn is_time(&self, column: usize) -> bool {
        let has =
            |cell: &[u8], byte| cell.iter().filter(|other| **other == byte).count() >= 1 && cell[0].is_ascii_digit();
        let is_date = |cell: &[u8]| has(cell, b'-') || has(cell, b'/') || has(cell, b'.');
        let is_date = self.is_text(column) && self.mostly(column, is_date);
        self.separator == Separator::Blanks && is_date && self.mostly(column + 1, |cell| has(cell, b':'))
    }

    /// Returns whether this column is quoted and the next one is not.
    fn is_quoted(&self, column: usize) -> bool {
        let is_quoted = |column| self.mostly(column, |cell| cell.starts_with(b"\""));
        is_quoted(column) && !is_quoted(column + 1)
    }

    /// Returns whether the first column counts up from 0 or 1, row by row.
    fn counts_up(&self) -> bool {
        let numbers = self.rows.iter().map(|row| {
            let cell = row.first().map(|cell| unquoted(cell)).filter(|cell| cell.iter().all(u8::is_ascii_digit))?;
            std::str::from_utf8(cell).ok()?.parse::<u64>().ok()
        });
        let Some(numbers) = numbers.collect::<Option<Vec<u64>>>() else { return false };
        numbers.len() >= 3 && numbers[0] <= 1 && numbers.windows(2).all(|pair| pair[1] == pair[0].saturating_add(1))
    }

    /// Returns whether the first column counts up and three columns with decimals follow.
    fn numbers_points(&self) -> bool {
        let has_decimals = |cell: &[u8]| cell.contains(&b'.') || cell.contains(&b',');
        self.least >= 4 && self.counts_up() && (1..4).all(|column| self.mostly(column, has_decimals))
    }

    /// Returns names for all cells, if `names` fit them.
    fn fit(&self, names: &[String], separator: Separator, is_comment: bool) -> Option<Vec<String>> {
        let has_axes = |names: &[String]| axes(names).is_ok();
        if (self.least..=self.most).contains(&names.len()) && has_axes(names) {
            return Some(names.to_vec());
        }
        if (self.least..=self.most).contains(&(names.len() + 1)) && has_axes(names) {
            let begins_with_axis = axes(names).is_ok_and(|axes| axes.contains(&0));
            if self.is_quoted(0) || begins_with_axis && (self.is_text(0) || self.counts_up()) {
                return Some([&[String::new()], names].concat());
            }
            if let Some(date) = (0..names.len()).find(|&column| self.is_time(column)) {
                return Some([&names[..=date], &[String::new()], &names[date + 1..]].concat());
            }
        }
        if separator != Separator::Blanks || names.len() <= self.most {
            return None;
        }
        let width = self.least;
        if let Some(joined) = joined(names, width) {
            return Some(joined);
        }
        if !is_comment {
            return None;
        }
        let windows: Vec<&[String]> = names.windows(width).filter(|names| has_axes(names)).collect();
        match windows[..] {
            [only] => Some(only.to_vec()),
            _ => None,
        }
    }

    /// Returns the column names in a line and how many names the line has, `None` if it has none, or a refusal.
    fn named_by(&self, line: &[u8], is_comment: bool) -> Result<Option<(Vec<String>, usize)>> {
        let mut separators = vec![
            self.separator,
            Separator::Byte(b';'),
            Separator::Byte(b'\t'),
            Separator::Byte(b','),
            Separator::Blanks,
        ];
        separators.dedup();
        let mut refusal = None;
        // In comments, names may follow a colon: `columns: x y z`.
        let behind = line.iter().rposition(|&byte| byte == b':').filter(|_| is_comment).map(|at| &line[at + 1..]);
        for (line, separator) in Some(line)
            .into_iter()
            .chain(behind)
            .flat_map(|line| separators.iter().map(move |&separator| (line, separator)))
        {
            let names = names(line, separator);
            if let Some(fitting) = self.fit(&names, separator, is_comment) {
                return Ok(Some((fitting, names.len())));
            }
            match axes(&names) {
                Err(NoAxes::Missing) => {}
                Err(NoAxes::Unclear(reason)) => {
                    refusal.get_or_insert(Refusal::of_header(reason));
                }
                Ok(axes) => {
                    if is_comment && axes == [0, 1, 2] {
                        return Ok(None);
                    }
                    let (found, most) = (names.len(), self.least);
                    let shown = shown(names.join(",").as_bytes());
                    let reason = format!("it names {found} columns, the rows have {most}: {shown}");
                    refusal.get_or_insert(Refusal::of_header(reason));
                }
            }
        }
        match (refusal, is_comment) {
            (Some(refusal), _) => Err(refusal),
            (None, true) => Ok(None),
            (None, false) => {
                let found = shown(names(line, self.separator).join(",").as_bytes());
                Err(Refusal::of_header(format!("expected columns named x, y and z, found {found}")))
            }
        }
    }

    /// Drops the places of class, colours and intensity that hold text: names of classes are not numbers.
    fn without_text(&self, places: Places) -> Places {
        let is_number = |column: &usize| !self.is_text(*column);
        let each = |rgb: &RgbPlaces| matches!(rgb, RgbPlaces::Each(each) if each.iter().all(is_number));
        let (class, intensity) = (places.class.filter(is_number), places.intensity.filter(is_number));
        Places { class, intensity, rgb: places.rgb.filter(each), ..places }
    }

    /// Returns whether numbers in these columns have decimal commas; the coordinates must agree.
    fn decimal_comma(&self, places: &Places) -> Result<bool> {
        let has = |column: usize, byte: u8| {
            let is = |cell: &&[u8]| cell.contains(&byte) && Cell::of(cell, byte == b',') != Cell::Text;
            let is_number = |cell: &&[u8]| is(cell) && unquoted(cell).iter().any(u8::is_ascii_digit);
            let in_quotes = |cell: &&[u8]| self.separator != Separator::Byte(b',') || cell.starts_with(b"\"");
            self.rows.iter().filter_map(|row| row.get(column)).any(|cell| is_number(cell) && in_quotes(cell))
        };
        let any = |byte| places.axes.iter().any(|&column| has(column, byte));
        match (any(b','), any(b'.')) {
            (true, true) => Err(Refusal::of_rows("numbers have both decimal points and decimal commas")),
            (false, true) => Ok(false),
            (true, false) => Ok(true),
            (false, false) => {
                let rgb = match places.rgb {
                    Some(RgbPlaces::Each(each)) => each.to_vec(),
                    _ => Vec::new(),
                };
                Ok(rgb.into_iter().chain(places.intensity).any(|column| has(column, b',')))
            }
        }
    }
}

/// Joins neighbouring `words` to the names of `width` columns, if that is possible in only one way.
fn joined(words: &[String], width: usize) -> Option<Vec<String>> {
    if let Some(names) = joined_between(words, width) {
        return Some(names);
    }
    // Words may qualify a neighbour: `X coordinate Y coordinate Z coordinate`, `Local X Local Y Local Z`.
    let found = axes(words).ok()?;
    let merged = |is_before: bool| {
        let mut names: Vec<String> = Vec::new();
        let mut is_open = false;
        for (at, word) in words.iter().enumerate() {
            let is_axis = found.contains(&at);
            let next_is_axis =
                found.iter().any(|&axis| axis > at && words[at..axis].iter().all(|word| is_neutral(word)));
            let joins = is_open && (if is_axis { is_before } else { is_neutral(word) });
            match names.last_mut().filter(|_| joins) {
                Some(before) => *before += &format!(" {word}"),
                None => names.push(word.clone()),
            }
            is_open = if is_before { !is_axis && next_is_axis } else { is_axis || joins };
        }
        Some(names).filter(|names| names.len() == width && axes(names).is_ok())
    };
    merged(false).or_else(|| merged(true))
}

/// Like [`joined`], but joins only words that are not coordinates with one another.
fn joined_between(words: &[String], width: usize) -> Option<Vec<String>> {
    let found = axes(words).ok()?;
    let mut ends = found;
    ends.sort_unstable();
    let [a, b, c] = ends;
    let runs = [&words[..a], &words[a + 1..b], &words[b + 1..c], &words[c + 1..]];
    let room = runs.map(|run| run.len().saturating_sub(1));
    let more = words.len().checked_sub(width).filter(|&more| words.len() <= MOST_WORDS && more <= MOST_JOINED)?;
    let mut ways = Vec::new();
    for first in 0..=room[0].min(more) {
        for second in 0..=room[1].min(more - first) {
            for third in 0..=room[2].min(more - first - second) {
                let last = more - first - second - third;
                if last <= room[3] {
                    ways.push([first, second, third, last]);
                }
            }
        }
    }
    let [fewer] = ways[..] else { return None };
    let mut names = Vec::new();
    for (number, (run, fewer)) in runs.iter().zip(fewer).enumerate() {
        match run.len() - fewer {
            _ if fewer == 0 => names.extend_from_slice(run),
            // One name takes all words of the run, the others stay empty: how they are joined is irrelevant.
            left => {
                names.push(run.join(" "));
                names.resize(names.len() + left - 1, String::new());
            }
        }
        names.extend(ends.get(number).map(|&axis| words[axis].clone()));
    }
    Some(names)
}

const BOTH_COMMAS: &str =
    "commas stand both within numbers and between them; write decimal points, or semicolons between columns";

/// Refuses rows with commas both within numbers and between them.
fn refuse_both_commas(rows: &[Vec<u8>]) -> Result<()> {
    let has = |byte: u8| rows.iter().any(|row| row.contains(&byte));
    if has(b';') || has(b'.') || has(b'"') || !has(b',') {
        return Ok(());
    }
    let is_digit = |byte: Option<&u8>| byte.is_some_and(u8::is_ascii_digit);
    let is_both = |word: &[u8]| {
        let inner = word.iter().position(|&byte| byte == b',').filter(|&at| at + 1 < word.len());
        word.ends_with(b",")
            && inner.is_some_and(|at| is_digit(word.get(at + 1)) && at > 0 && is_digit(word.get(at - 1)))
    };
    // Empty cells at the end do not count.
    let filled = |row: &Vec<u8>| row.iter().rposition(|byte| *byte != b',' && !byte.is_ascii_whitespace());
    let both =
        |row: &&Vec<u8>| row[..filled(row).map_or(0, |last| last + 1)].split(u8::is_ascii_whitespace).any(is_both);
    if 2 * rows.iter().filter(both).count() > rows.len() {
        return Err(Refusal::of_rows(BOTH_COMMAS));
    }
    Ok(())
}

/// Decides the layout of a table; `columns` come from the user.
pub(super) fn decide(beginning: &Beginning<'_>, columns: Option<Columns>, custom: Custom) -> Result<Decision> {
    let table = Table::of(beginning)?;
    let (mut named, mut of_header) = (Vec::new(), 0);
    if let Some(header) = beginning.header {
        let found = table.named_by(header, false);
        (named, of_header) = if columns.is_some() { found.unwrap_or_default() } else { found? }.unwrap_or_default();
    } else {
        for comment in beginning.comments.iter().rev() {
            let found = table.named_by(comment, true);
            if let Some((names, _)) = if columns.is_some() { found.unwrap_or_default() } else { found? } {
                named = names;
                break;
            }
        }
    }
    let (places, cells) = match columns {
        Some(columns) => (columns.places(), None),
        None if custom == Custom::Ptx => (custom.places(table.least), None),
        None if named.is_empty() => {
            if table.is_quoted(0) || table.is_text(0) {
                let cell = table.rows.first().and_then(|row| row.first()).map_or(&[][..], |cell| cell);
                return Err(Refusal::of_rows(format!("the first column is text: {}", shown(cell))));
            }
            if table.has_split_decimals() {
                return Err(Refusal::of_rows(BOTH_COMMAS));
            }
            if table.numbers_points() {
                return Err(Refusal::of_rows("the first column counts up and may number the points"));
            }
            let places = custom.places(table.least);
            if let Some(column) = places.axes.into_iter().find(|&column| table.is_empty(column)) {
                return Err(Refusal::of_rows(format!("column {} is empty", column + 1)));
            }
            (places, Some(table.least))
        }
        None => {
            let found = axes(&named).map_err(|_| Refusal::of_header("expected columns named x, y and z"))?;
            (table.without_text(places(&named, found)), Some(named.len().max(table.least)))
        }
    };
    for (&column, axis) in places.axes.iter().zip(["x", "y", "z"]) {
        if table.is_text(column) {
            let text = table.rows.iter().filter_map(|row| row.get(column));
            let text = text.map(|cell| shown(cell)).next().unwrap_or_default();
            return Err(Refusal::of_rows(format!("expected numbers in column {} ({axis}), found {text}", column + 1)));
        }
    }
    let decimal_comma = table.decimal_comma(&places)?;
    let units = places.axes.map(|column| named.get(column).and_then(|name| unit_of(name)));
    if columns.is_none()
        && let Some(axis) = units.iter().position(|unit| *unit == Some(NameUnit::Unknown))
    {
        let name = shown(named[places.axes[axis]].as_bytes());
        return Err(Refusal::of_header(format!(
            "the unit in {name} is not known; expected m, mm, ft, us-ft or the like"
        )));
    }
    if units[0] != units[1] && columns.is_none() {
        return Err(Refusal::of_header("x and y state different units"));
    }
    let is_odd = beginning.header.is_some() && columns.is_none() && named.len() != of_header;
    let odd = is_odd.then(|| {
        let width = named.len();
        format!("the header has {of_header} names for {width} columns; check which of them were taken as x, y and z")
    });
    let layout = RowLayout::new(places, table.separator, decimal_comma);
    Ok(Decision { layout, places, cells, names: named, units, odd })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Decides the layout of a text with an optional header line, comments, and rows.
    fn decided(text: &str, columns: Option<&str>) -> Result<Decision> {
        let lines: Vec<Vec<u8>> = text.lines().map(|line| line.as_bytes().to_vec()).collect();
        let (comments, lines): (Vec<_>, Vec<_>) =
            lines.into_iter().partition(|line| line.starts_with(b"#") || line.starts_with(b"//"));
        let header = lines.first().filter(|line| is_header(line) || !is_row(line)).cloned();
        let rows = &lines[usize::from(header.is_some())..];
        let beginning = Beginning { separator: None, comments: &comments, header: header.as_deref(), rows };
        decide(&beginning, columns.map(|columns| columns.parse().unwrap()), Custom::Xyz)
    }

    /// Returns the point of the last row.
    fn point(text: &str, columns: Option<&str>) -> [f64; 3] {
        let found = decided(text, columns).unwrap_or_else(|refusal| panic!("{text}: {}", refusal.reason));
        let row = text.lines().last().unwrap();
        found.layout.parse(row.as_bytes(), found.cells).unwrap_or_else(|fault| panic!("{text}: {}", fault.reason)).0
    }

    #[test]
    fn layouts_are_decided_by_header_and_rows() {
        for text in [
            // Separators and decimal commas.
            "1 2.5 -3",
            " 1\t2,5\t-3 ",
            "1,0 2,5 -3,0 7",
            "1,2.5,-3",
            "1, 2.5, -3",
            "1; 2.5; -3",
            "1;2,5;-3",
            "\"1\",\"2.5\",\"-3\"",
            "\"1\",\"2,5\",\"-3\"",
            "1\t2.5\t-3\tsome text\t",
            "1\t\t2.5\t-3\n1.0000000\t2.5\t-3",
            "\t1\t2.5\t-3",
            "1\t2.5 -3",
            "1 2.5 -3 0.5",
            "1,2.5,-3,7,8,9",
            // Headers.
            "x y z\n1 2.5 -3",
            "X;Y;Z;\n1;2,5;-3;",
            "//X Y Z R G B\n1 2.5 -3 7 8 9",
            "# x, y, z\n1 2.5 -3",
            "# points of a scan\n# columns: z x y\n# made by a program\n-3 1 2.5",
            "# x y z in metres of the local system\n1 2.5 -3 7",
            "# x y z\n1 2.5 -3 7 8 9",
            "# 3 columns of x y z\n1 2.5 -3",
            "z,name,y,x\n-3,\"a, b\",2.5,1",
            "name,x,y,z\nP0,1,2.5,-3",
            "name;x;y;z\nP, 0;1,0;2,5;-3,0",
            "time,x,y,z\n2026-01-01T12:00:00.5Z,1,2.5,-3",
            "time,x,y,z\n2026-01-01 12:00:00,1,2.5,-3",
            "time x y z\n2026-01-01T12:00:00Z 1 2.5 -3",
            "id\tcode\tx\ty\tz\n7\t\t1\t2.5\t-3",
            "name\tx\ty\tz\tq\n\t1\t2\t3\t9\nb\t1\t2.5\t-3\t9",
            "\tx\ty\tz\n0\t1\t2.5\t-3",
            ",x,y,z\n0,1,2.5,-3",
            "x\t\ty\t\tz\n1\t\t2.5\t\t-3",
            "x y z note\n1 2.5 -3 \"two words\"",
            "x,y,z,note\n1,2.5,-3,",
            "x,y,z,1,2,3\n1,2.5,-3,1,2,3",
            "x,y,z\n,,\n1,2.5,-3",
            "X [m] Y [m] Z [m]\n1 2.5 -3",
            "ring,azimuth,elevation,distance,x,y,z\n0,0,0.1,5,1,2.5,-3",
            // More or fewer names than cells, with only one way to fit.
            "Point ID X Y Z Intensity\n0 1 2.5 -3 77",
            "\"Point ID\" X Y Z Scan Angle\n0 1 2.5 -3 77",
            "X coordinate Y coordinate Z coordinate\n1 2.5 -3",
            "Local X Local Y Local Z\n1 2.5 -3",
            "x y z\n\"1\" 1 2.5 -3",
            "x y z\nP0 1 2.5 -3",
            "time x y z\n2026-01-01 12:00:00 1 2.5 -3",
            "x y time z\n1 2.5 01.02.2026 12:00 -3",
            "x y z class\n1 2.5 -3 ground",
            "x y z\n1 7 8 9\n2 6 7 8\n3 1 2.5 -3",
            "x,y,z\nP0,1,2.5,-3",
        ] {
            assert_eq!(point(text, None), [1.0, 2.5, -3.0], "{text}");
        }
        // Whole numbers with empty cells at the end, whether the header names these or not.
        for text in ["1,2,3,", "1,2,3,,", "1,2,3, ,\t", "x,y,z\n1,2,3,", "x,y,z,\n1,2,3,", "x,y,z,i,\n1,2,3,100,"] {
            assert_eq!(point(text, None), [1.0, 2.0, 3.0], "{text}");
        }
        for (columns, text) in [
            ("x,y,z", "1 2.5 -3 4 5"),
            ("-,x,y,z", "P0,1,2.5,-3"),
            ("-,x,y,z", "BM 0\t1\t2.5\t-3"),
            ("-,x,y,z", "1 1.0 2.5 -3.0\n2 1.0 2.5 -3.0\n3 1.0 2.5 -3.0"),
            ("-,z,x,y", "a b c d\n7 -3 1 2.5"),
            ("x,y,z", "# y x z\n1 2.5 -3 4"),
            ("t,x,y,z", "x,y,z\n9,8,7\n2026-01-01 12:00:00,1,2.5,-3"),
        ] {
            assert_eq!(point(text, Some(columns)), [1.0, 2.5, -3.0], "{text}");
        }
    }

    #[test]
    fn only_a_header_of_more_or_fewer_names_than_columns_is_odd() {
        for (text, columns, odd) in [
            ("Point ID X Y Z\n0 1 2.5 -3", None, Some("5 names for 4 columns")),
            ("x,y,z\nP0,1,2.5,-3", None, Some("3 names for 4 columns")),
            ("x,y,z\nP0,1,2.5,-3", Some("-,x,y,z"), None),
            ("X;Y;Z;\n1;2,5;-3;", None, None),
            ("# points as x y z\n1 2.5 -3", None, None),
            ("1 2.5 -3", None, None),
        ] {
            let found = decided(text, columns).unwrap_or_else(|refusal| panic!("{text}: {}", refusal.reason)).odd;
            assert!(
                found.is_some() == odd.is_some() && found.iter().all(|found| found.contains(odd.unwrap())),
                "{found:?}"
            );
        }
    }

    #[test]
    fn what_is_not_clear_is_refused() {
        for (text, words) in [
            ("1,5, 2,5, 3,5", "commas stand both"),
            ("1,5, 2,5, 3,5,", "commas stand both"),
            ("1,25,2,50,3,75\n1,25,2,05,-3,75", "commas stand both"),
            ("1,5 2.5 3", "both decimal points and decimal commas"),
            ("P0,1,2.5,-3", "the first column is text: \"P0\""),
            ("\"7\" 1 2.5 -3", "the first column is text"),
            ("2026-01-01T00:00:00Z,1,2,3", "the first column is text"),
            ("1 1.5 2.5 3.5\n2 1.5 2.5 3.5\n3 1.5 2.5 3.5", "counts up and may number the points"),
            ("X,Y,X\n1,2,3", "expected columns named x, y and z, found \"X,Y,X\""),
            ("x,y,z,x\n1,2,3,4", "two columns may be x"),
            ("azimuth,elevation,range\n1,2,3", "expected columns named x, y and z"),
            ("x,y,elevation,azimuth\n1,2,3,4", "may be an angle"),
            ("x y z\n7 1 2.5 -3\n9 1 2.5 -3", "it names 3 columns, the rows have 4"),
            ("x,y,z,i\n1,2.5,-3", "it names 4 columns, the rows have 3"),
            ("x,y,z\n1,5,2,5,3,5", "it names 3 columns, the rows have 6"),
            ("Point ID X Y Z Scan Angle\n0 1 2.5 -3 77 9", "it names 7 columns, the rows have 6"),
            ("# y x z\n1 2 3 4", "it names 3 columns, the rows have 4"),
            ("id x y z note\nP1 1 2.5 -3 4 5", "it names 5 columns, the rows have 6"),
            ("X (mm),Y (m),Z (m)\n1,2,3", "different units"),
            ("x [m],y [m],z [10^-3 m]\n1,2,3", "the unit in \"z [10^-3 m]\" is not known"),
            ("name,x,y,z\n1,P0,2,3,\n", "found \"P0\""),
            (";1.5;2.5;3.5\n;4.5;5.5;6.5", "column 1 is empty"),
            ("1.5,,2.5,3.5\n4.5,,5.5,6.5", "column 2 is empty"),
        ] {
            let Err(refusal) = decided(text, None) else { panic!("{text} is decided") };
            assert!(refusal.reason.contains(words), "{text}: {}", refusal.reason);
        }
    }

    #[test]
    fn names_state_units_and_channels() {
        let found = decided("X (mm),Y (mm),Z (mm),Rf,Gf,Bf,Intensity,Class\n1,2,3,0,0,0,5,2", None).unwrap();
        assert_eq!(found.units, [Some(NameUnit::Metres(0.001)); 3]);
        let latin = [&b"Rechtswert;Hochwert;H\xF6he"[..], b"1;2;3"];
        let beginning =
            Beginning { separator: None, comments: &[], header: Some(latin[0]), rows: &[latin[1].to_vec()] };
        assert_eq!(decide(&beginning, None, Custom::Xyz).unwrap().names[2], "Höhe");
        let Places { rgb, intensity, class, .. } = found.places;
        assert_eq!((rgb, intensity, class), (Some(RgbPlaces::Each([3, 4, 5])), Some(6), Some(7)));
    }
}
