//! What a row of text holds: separators, decimal commas, columns.

use super::super::shown;
use super::super::values::{Sample, Scale};
use super::decimal::short;
use crate::colour::ColourSource;
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
    /// Columns of a row.
    pub fn count(self, row: &[u8]) -> usize {
        match self {
            Self::Blanks => row.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).count(),
            Self::Byte(byte) => row.split(|&other| other == byte).count(),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Blanks => "blanks",
            Self::Byte(b',') => "commas",
            Self::Byte(_) => "semicolons",
        }
    }
}

/// What a column holds: coordinates from 0 on, then these; other columns are passed over.
const OTHER: u8 = u8::MAX;
const CLASS: usize = 3;
const INTENSITY: usize = 4;
const RED: usize = 5;
const ROLES: usize = 8;

/// Numbers of a row by their roles.
pub(in crate::input::cloud) type Row = [f64; ROLES];

/// Coordinates, class and value of a row; else what is wrong with it.
pub(in crate::input::cloud) type Parsed<V> = Result<([f64; 3], Option<f64>, Option<V>), String>;

/// Where red, green and blue stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::input::cloud) enum RgbPlaces {
    /// In a column each.
    Each([usize; 3]),
}

/// Columns of a row, from 0 on, no two of them the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::input::cloud) struct Places {
    pub axes: [usize; 3],
    pub class: Option<usize>,
    pub rgb: Option<RgbPlaces>,
    pub intensity: Option<usize>,
}

impl Places {
    /// Coordinates alone.
    pub fn of(axes: [usize; 3]) -> Self {
        Self { axes, class: None, rgb: None, intensity: None }
    }
}

/// How rows are read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::input::cloud) struct RowLayout {
    separator: Separator,
    decimal_comma: bool,
    places: Places,
    /// Of each column, up to the last that is needed for the place and the class.
    roles: Vec<u8>,
}

/// How rows are read with their values for colours.
#[derive(Debug)]
pub(in crate::input::cloud) struct ValueLayout<'a> {
    layout: &'a RowLayout,
    roles: Vec<u8>,
    source: ColourSource,
}

/// Puts a role at a place.
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

    pub fn has_class(&self) -> bool {
        self.places.class.is_some()
    }

    /// With the values of `source`, if rows have them.
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

    /// The coordinates of a row, and its class if there is one; else what is wrong with it.
    #[inline]
    pub fn parse(&self, row: &[u8]) -> Result<([f64; 3], Option<f64>), String> {
        let mut found = [0.0; ROLES];
        self.scan(row, &self.roles, &mut found)?;
        Ok(self.split(&found))
    }

    fn split(&self, found: &Row) -> ([f64; 3], Option<f64>) {
        ([found[0], found[1], found[2]], self.places.class.map(|_| found[CLASS]))
    }

    /// Puts numbers by their roles into `found`; whether all columns are there. Those of place and class must be.
    #[inline(always)]
    fn scan(&self, row: &[u8], roles: &[u8], found: &mut Row) -> Result<bool, String> {
        let point = if self.decimal_comma { b',' } else { b'.' };
        let mut rest = row;
        for (column, &role) in roles.iter().enumerate() {
            let is_needed = column < self.roles.len();
            if column > 0
                && let Separator::Byte(_) = self.separator
            {
                match rest.split_first() {
                    Some((_, behind)) => rest = behind,
                    None if is_needed => return Err(self.too_few(column, row)),
                    None => return Ok(false),
                }
            }
            rest = rest.trim_ascii_start();
            if rest.is_empty() && self.separator == Separator::Blanks {
                if is_needed {
                    return Err(self.too_few(column, row));
                }
                return Ok(false);
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
                    match self.number(word) {
                        Some(value) => value,
                        // A value that is left out.
                        None if !is_needed && word.trim_ascii().is_empty() => return Ok(false),
                        None => {
                            let word = shown(word.trim_ascii());
                            return Err(format!("expected a number in column {}, found {word}", column + 1));
                        }
                    }
                }
            };
            found[usize::from(role)] = value;
        }
        Ok(true)
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

impl ValueLayout<'_> {
    /// As [`RowLayout::parse`], and the numbers of the row's value; `None` where the row ends before them.
    pub fn parse(&self, row: &[u8]) -> Parsed<Row> {
        let mut found = [0.0; ROLES];
        let whole = self.layout.scan(row, &self.roles, &mut found)?;
        let (at, class) = self.layout.split(&found);
        Ok((at, class, whole.then_some(found)))
    }

    /// The value of such numbers.
    #[inline]
    pub fn value(&self, row: &Row, scale: &Scale) -> [u16; 3] {
        match self.source {
            ColourSource::Rgb => [0, 1, 2].map(|channel| scale.of(row[RED + channel])),
            _ => [scale.of(row[INTENSITY]), 0, 0],
        }
    }

    /// Adds them to a sample.
    pub fn look(&self, row: &Row, sample: &mut Sample) {
        let numbers = if self.source == ColourSource::Rgb { RED..ROLES } else { INTENSITY..RED };
        row[numbers].iter().for_each(|&value| sample.add(value));
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

/// What columns hold, by the names of a header.
pub(super) fn columns(names: &[String]) -> Option<Places> {
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
    let rgb = [&["r", "red", "rf"][..], &["g", "green", "gf"], &["b", "blue", "bf"]].map(find);
    let rgb = match rgb {
        [Some(r), Some(g), Some(b)] => Some(RgbPlaces::Each([r, g, b])),
        _ => None,
    };
    let intensity = find(&["intensity", "i", "scalar_intensity", "reflectance", "scalar_reflectance"]);
    Some(Places { axes, class: find(&["classification", "class", "scalar_classification"]), rgb, intensity })
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
            let layout = RowLayout::new(Places::of([0, 1, 2]), found.0, found.1);
            assert_eq!(layout.parse(&rows[0]).unwrap(), (at, None), "{text}");
        }
        assert!(recognise(&rows("1,5, 2,5, 3,5")).unwrap_err().contains("commas stand both"));
    }

    #[test]
    fn columns_are_found_by_name_and_anything_else_is_said() {
        let found = columns(&names(b"// R G B \"Z\" X Y Classification\r")).unwrap();
        assert_eq!((found.axes, found.class, found.rgb), ([4, 5, 3], Some(6), Some(RgbPlaces::Each([0, 1, 2]))));
        let found = columns(&names(b"Easting [m];Northing [m];Height [m];Intensity;red;green")).unwrap();
        assert_eq!(found, Places { intensity: Some(3), ..Places::of([0, 1, 2]) });
        assert_eq!(columns(&names(b"X,Y,X")), None);
        let places = Places { class: Some(3), ..Places::of([2, 0, 1]) };
        let layout = RowLayout::new(places, Separator::Blanks, false);
        assert_eq!(layout.parse(b"2 3 1 7 9 9").unwrap(), ([1.0, 2.0, 3.0], Some(7.0)));
        assert!(layout.parse(b"1 2 3").unwrap_err().starts_with("expected 4 columns or more, found 3"));
        assert!(layout.parse(b"1 a 3 4").unwrap_err().contains("a number in column 2, found \"a\""));
        assert!(layout.parse(b"nan 1 inf 4").unwrap().0[1].is_nan());
        let commas = RowLayout::new(Places::of([0, 1, 2]), Separator::Byte(b','), false);
        assert!(commas.parse(b"1,2").is_err() && commas.parse(b"1,2,").is_err() && commas.parse(b"").is_err());
    }

    #[test]
    fn values_stand_behind_and_between_and_rows_may_end_before_them() {
        for (separator, byte) in [(Separator::Blanks, ' '), (Separator::Byte(b';'), ';')] {
            let of = |text: &str| text.replace(' ', &byte.to_string()).into_bytes();
            let rgb = Some(RgbPlaces::Each([4, 1, 6]));
            let places = Places { rgb, intensity: Some(5), ..Places::of([0, 2, 3]) };
            let layout = RowLayout::new(places, separator, false);
            let values = layout.with_values(ColourSource::Rgb).unwrap();
            let (at, class, row) = values.parse(&of("1 20 2 3 10 0.5 30 rest")).unwrap();
            assert_eq!((at, class), ([1.0, 2.0, 3.0], None));
            assert_eq!(values.value(&row.unwrap(), &Scale::BYTES), [10, 20, 30]);
            let intensity = layout.with_values(ColourSource::Intensity).unwrap();
            let (_, _, row) = intensity.parse(&of("1 x 2 3 x 7 x")).unwrap();
            assert_eq!(intensity.value(&row.unwrap(), &Scale::WHOLE), [7, 0, 0]);
            for short in ["1 20 2 3 10 0.5", "1 20 2 3"] {
                assert_eq!(values.parse(&of(short)).unwrap(), ([1.0, 2.0, 3.0], None, None), "{short}");
            }
            assert!(values.parse(&of("1 20 2")).unwrap_err().contains("expected 4 columns"));
            assert!(values.parse(&of("1 20 2 3 10 0.5 red")).unwrap_err().contains("a number in column 7"));
            assert!(layout.with_values(ColourSource::Class).is_none());
        }
    }
}
