//! What a row of text holds: separators, decimal commas, columns.

use super::super::shown;
use super::decimal::short;
use crate::input::Columns;

/// What stands between two columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::input::cloud) enum Separator {
    /// Blanks and tabs, one or more.
    Blanks,
    /// This byte, with blanks around it that mean nothing.
    Byte(u8),
}

impl Separator {
    fn name(self) -> &'static str {
        match self {
            Self::Blanks => "blanks",
            Self::Byte(b',') => "commas",
            Self::Byte(_) => "semicolons",
        }
    }
}

/// Role of a column that is passed over, and of the class.
const OTHER: u8 = u8::MAX;
const CLASS: u8 = 3;

/// How rows are read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::input::cloud) struct RowLayout {
    separator: Separator,
    decimal_comma: bool,
    /// Of each column, up to the last that is needed.
    roles: Vec<u8>,
}

impl RowLayout {
    /// With x, y and z (three different ones) and maybe the class in these columns, from 0 on.
    pub fn new(axes: [usize; 3], class: Option<usize>, separator: Separator, decimal_comma: bool) -> Self {
        let last = axes.into_iter().chain(class).max().unwrap_or(0);
        let mut roles = vec![OTHER; last + 1];
        if let Some(class) = class {
            roles[class] = CLASS;
        }
        for (axis, column) in axes.into_iter().enumerate() {
            roles[column] = axis as u8;
        }
        Self { separator, decimal_comma, roles }
    }

    /// The coordinates of a row, and its class if there is one; else what is wrong with it.
    #[inline]
    pub fn parse(&self, row: &[u8]) -> Result<([f64; 3], Option<f64>), String> {
        let (mut at, mut class) = ([0.0; 3], None);
        let point = if self.decimal_comma { b',' } else { b'.' };
        let mut rest = row;
        for (column, &role) in self.roles.iter().enumerate() {
            if column > 0
                && let Separator::Byte(_) = self.separator
            {
                let Some((_, behind)) = rest.split_first() else { return Err(self.too_few(column, row)) };
                rest = behind;
            }
            rest = rest.trim_ascii_start();
            if rest.is_empty() && self.separator == Separator::Blanks {
                return Err(self.too_few(column, row));
            }
            if role == OTHER {
                rest = &rest[self.word_len(rest)..];
                continue;
            }
            let value = match short(rest, point) {
                Some((value, len)) if self.ends_word(&mut rest, len) => value,
                _ => {
                    let (word, behind) = rest.split_at(self.word_len(rest));
                    rest = behind;
                    self.number(word).ok_or_else(|| {
                        format!("expected a number in column {}, found {}", column + 1, shown(word.trim_ascii()))
                    })?
                }
            };
            match at.get_mut(usize::from(role)) {
                Some(axis) => *axis = value,
                None => class = Some(value),
            }
        }
        Ok((at, class))
    }

    /// Length of the word that `rest` begins with.
    #[inline]
    fn word_len(&self, rest: &[u8]) -> usize {
        match self.separator {
            Separator::Blanks => rest.iter().position(u8::is_ascii_whitespace),
            Separator::Byte(byte) => memchr::memchr(byte, rest),
        }
        .unwrap_or(rest.len())
    }

    /// Whether a word ends behind `len` bytes; if so, goes on to what separates it from the next.
    #[inline]
    fn ends_word(&self, rest: &mut &[u8], len: usize) -> bool {
        let behind = &rest[len..];
        let ended = match self.separator {
            Separator::Blanks => behind.first().is_none_or(u8::is_ascii_whitespace).then_some(behind),
            Separator::Byte(byte) if behind.first() == Some(&byte) => Some(behind),
            Separator::Byte(byte) => {
                Some(behind.trim_ascii_start()).filter(|behind| behind.first().is_none_or(|first| *first == byte))
            }
        };
        ended.inspect(|behind| *rest = behind).is_some()
    }

    #[cold]
    fn too_few(&self, found: usize, row: &[u8]) -> String {
        format!("expected {} columns or more, found {found}: {}", self.roles.len(), shown(row.trim_ascii()))
    }

    /// Any number, long or in quotes.
    #[inline(never)]
    fn number(&self, word: &[u8]) -> Option<f64> {
        let word = word.trim_ascii();
        let word = word.strip_prefix(b"\"").and_then(|word| word.strip_suffix(b"\"")).unwrap_or(word);
        let mut points = [0; 64];
        let word = match self.decimal_comma {
            false => word,
            true => {
                let points = points.get_mut(..word.len())?;
                points.copy_from_slice(word);
                points.iter_mut().filter(|byte| **byte == b',').for_each(|byte| *byte = b'.');
                points
            }
        };
        std::str::from_utf8(word).ok()?.parse().ok()
    }

    /// As the user is told of it.
    pub fn describe(&self, names: &[String]) -> String {
        let columns = match names {
            [] => "x y z".into(),
            names => names.iter().take(8).map(|name| shown(name.as_bytes())).collect::<Vec<_>>().join(" "),
        };
        let commas = if self.decimal_comma { ", decimal commas" } else { "" };
        format!("columns {columns}, separated by {}{commas}", self.separator.name())
    }

    pub fn bytes(&self) -> impl Iterator<Item = u8> + '_ {
        let separator = match self.separator {
            Separator::Blanks => b' ',
            Separator::Byte(byte) => byte,
        };
        [separator, self.decimal_comma.into()].into_iter().chain(self.roles.iter().copied())
    }
}

/// What separates the columns of these rows, and whether they have decimal commas; else why that is not clear.
pub(super) fn recognise(rows: &[Vec<u8>]) -> Result<(Separator, bool), String> {
    let has = |byte: u8| rows.iter().any(|row| row.contains(&byte));
    if has(b';') {
        return Ok((Separator::Byte(b';'), has(b',')));
    }
    if !has(b',') {
        return Ok((Separator::Blanks, false));
    }
    let words = || rows.iter().flat_map(|row| row.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()));
    let inner = |word: &[u8]| word[..word.len() - 1].contains(&b',');
    let enough = rows.iter().all(|row| row.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).count() >= 3);
    let ends = words().any(|word| word.ends_with(b","));
    let single = words().all(|word| word.iter().filter(|&&byte| byte == b',').count() <= 1);
    if enough && !ends && single && !has(b'.') {
        return Ok((Separator::Blanks, true));
    }
    if enough && ends && words().any(|word| word.ends_with(b",") && inner(word)) && !has(b'.') {
        return Err("commas stand both within numbers and between them; write decimal points, or semicolons between \
                    columns"
            .into());
    }
    Ok((Separator::Byte(b','), false))
}

/// Names in a header, as they stand there.
pub(super) fn names(header: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(header);
    let text = text.trim().trim_start_matches('\u{feff}').trim_start_matches(['#', '/']).trim();
    let clean = |name: &str| name.trim().trim_matches('"').trim().to_owned();
    match [';', ',', '\t'].into_iter().find(|&separator| text.contains(separator)) {
        Some(separator) => text.split(separator).map(clean).collect(),
        None => text.split_whitespace().map(clean).collect(),
    }
}

/// Columns of x, y and z and of the class among the names of a header.
pub(super) fn columns(names: &[String]) -> Option<([usize; 3], Option<usize>)> {
    let find = |wanted: &[&str]| {
        let plain = |name: &String| {
            let name = name.split(['(', '[']).next().unwrap_or_default().trim().to_ascii_lowercase();
            wanted.contains(&name.as_str())
        };
        names.iter().position(plain)
    };
    let axes = [
        find(&["x", "easting", "east"])?,
        find(&["y", "northing", "north"])?,
        find(&["z", "height", "elevation", "elev"])?,
    ];
    Some((axes, find(&["classification", "class", "scalar_classification"])))
}

impl Columns {
    pub(super) fn places(self) -> ([usize; 3], Option<usize>) {
        (self.axes.map(usize::from), self.class.map(usize::from))
    }
}

/// Whether a row begins with a number.
pub(super) fn is_numeric(row: &[u8]) -> bool {
    let word = row.trim_ascii().split(|byte| byte.is_ascii_whitespace() || matches!(byte, b',' | b';')).next();
    let word = word.unwrap_or_default();
    let word = word.strip_prefix(b"\"").and_then(|word| word.strip_suffix(b"\"")).unwrap_or(word);
    std::str::from_utf8(word).is_ok_and(|word| word.parse::<f64>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &str) -> Vec<Vec<u8>> {
        text.lines().map(|line| line.as_bytes().to_vec()).collect()
    }

    #[test]
    fn separators_and_decimal_commas_are_recognised() {
        for (text, expected, at) in [
            ("1 2.5 3\n4 5 6", (Separator::Blanks, false), [1.0, 2.5, 3.0]),
            (" 1\t2,5\t-3 \n", (Separator::Blanks, true), [1.0, 2.5, -3.0]),
            ("1,5 2,5 3,25 7", (Separator::Blanks, true), [1.5, 2.5, 3.25]),
            ("1,2.5,3", (Separator::Byte(b','), false), [1.0, 2.5, 3.0]),
            ("1,2,3", (Separator::Byte(b','), false), [1.0, 2.0, 3.0]),
            ("1, 2, 3", (Separator::Byte(b','), false), [1.0, 2.0, 3.0]),
            (".5, .5, 1e1\r", (Separator::Byte(b','), false), [0.5, 0.5, 10.0]),
            ("1.5; 2; 3", (Separator::Byte(b';'), false), [1.5, 2.0, 3.0]),
            ("1,5;2,25;+3", (Separator::Byte(b';'), true), [1.5, 2.25, 3.0]),
            ("\"1\",\"2\",\"3\"", (Separator::Byte(b','), false), [1.0, 2.0, 3.0]),
        ] {
            let rows = rows(text);
            let found = recognise(&rows).unwrap();
            assert_eq!(found, expected, "{text}");
            let layout = RowLayout::new([0, 1, 2], None, found.0, found.1);
            assert_eq!(layout.parse(&rows[0]).unwrap(), (at, None), "{text}");
        }
        assert!(recognise(&rows("1,5, 2,5, 3,5")).unwrap_err().contains("commas stand both"));
    }

    #[test]
    fn columns_are_found_by_name_and_anything_else_is_said() {
        let found = columns(&names(b"// R G B \"Z\" X Y Classification\r")).unwrap();
        assert_eq!(found, ([4, 5, 3], Some(6)));
        assert_eq!(columns(&names(b"Easting [m];Northing [m];Height [m]")).unwrap(), ([0, 1, 2], None));
        assert_eq!(columns(&names(b"X,Y,X")), None);
        let layout = RowLayout::new([2, 0, 1], Some(3), Separator::Blanks, false);
        assert_eq!(layout.parse(b"2 3 1 7 9 9").unwrap(), ([1.0, 2.0, 3.0], Some(7.0)));
        assert!(layout.parse(b"1 2 3").unwrap_err().starts_with("expected 4 columns or more, found 3"));
        assert!(layout.parse(b"1 a 3 4").unwrap_err().contains("a number in column 2, found \"a\""));
        assert!(layout.parse(b"nan 1 inf 4").unwrap().0[1].is_nan());
        let commas = RowLayout::new([0, 1, 2], None, Separator::Byte(b','), false);
        assert!(commas.parse(b"1,2").is_err() && commas.parse(b"1,2,").is_err() && commas.parse(b"").is_err());
    }
}
