//! Text bodies of PLY and PCD, with one point per row, and checks of the data after the points.
//!
//! A row with more or fewer values than the header states is refused: its coordinates could be other values. If every
//! point starts on a line of its own but takes several lines, the lines are joined; one thread reads such a file.

use super::text::{Fault, Lines, Step, short};
use super::values::{Channels, SAMPLE_PLACES, SAMPLE_POINTS, Sample, bytes_of};
use super::{Cloud, Depth, Opening, Piece, Source, Taker, shown};
use crate::colour::ColourSource;
use crate::diagnostics::without_path;
use crate::number::decimal;
use crate::ply_header::{Element, Property};
use crate::text::counted;
use crate::{Error, Monitor, Result};

/// Bytes per piece.
const PIECE_BYTES: u64 = 4 << 20;
/// Bytes examined at once after the points.
const LOOK_BYTES: usize = 1 << 16;

/// Format of the rows.
#[derive(Debug)]
pub(super) struct Form {
    pub format: &'static str,
    /// True if values are separated by commas, not only by blanks.
    pub commas: bool,
    /// Number of values per point.
    pub words: usize,
    /// Indices of x, y and z among them; below, those of the other known values.
    pub axes: [usize; 3],
    pub class: Option<usize>,
    pub rgb: Option<RgbPlaces>,
    pub intensity: Option<usize>,
    pub channels: Channels,
}

/// Location of red, green and blue.
#[derive(Debug, Clone, Copy)]
pub(super) enum RgbPlaces {
    Each([usize; 3]),
    /// In the bytes of a whole number.
    Whole(usize),
    /// In the bytes of a 32-bit number written as floating point.
    Float(usize),
}

/// Roles of values in a row: 0 to 2 for coordinates, then these.
const CLASS: usize = 3;
const COLOUR: usize = 4;
const NOTHING: usize = 7;

/// Values of a row by role.
type Row = [f64; NOTHING + 1];

/// Points as text.
#[derive(Debug)]
pub(super) struct Body {
    form: Form,
    start: u64,
    end: u64,
    points: u64,
    stated: u64,
    /// True if points take more than one line.
    folded: bool,
}

/// Lines joined to one point.
#[derive(Default)]
struct Fold {
    row: Vec<u8>,
    words: usize,
}

impl Fold {
    /// Adds a line; returns whether the point is complete.
    fn add(&mut self, line: &[u8], form: &Form) -> Result<bool, String> {
        if self.words == form.words {
            *self = Self::default();
        }
        let found = form.count(line);
        let missing = form.words - self.words;
        if found > missing {
            let of = if self.words > 0 { " to complete the point" } else { "" };
            let expected = counted(missing as u64, "value");
            return Err(format!("expected {expected}{of}, found {found}: {}", shown(line.trim_ascii())));
        }
        self.row.extend(line);
        self.row.push(b' ');
        self.words += found;
        Ok(self.words == form.words)
    }
}

/// Result of a pass over joined lines.
struct Walk {
    /// Number of complete points; `end`: offset after the last.
    held: u64,
    end: u64,
    folded: bool,
    /// Why the pass ended before the file did.
    wrong: Option<Error>,
}

impl Form {
    fn count(&self, line: &[u8]) -> usize {
        let is_blank = |byte: &u8| byte.is_ascii_whitespace() || self.commas && *byte == b',';
        line.split(is_blank).filter(|word| !word.is_empty()).count()
    }

    /// Returns the role of each value in a row, with those of `source` if given.
    fn roles(&self, source: Option<ColourSource>) -> Vec<usize> {
        let mut roles = vec![NOTHING; self.words];
        let mut put = |place: usize, role: usize| roles.iter_mut().skip(place).take(1).for_each(|of| *of = role);
        match (source, self.rgb, self.intensity) {
            (Some(ColourSource::Rgb), Some(RgbPlaces::Each(places)), _) => {
                places.into_iter().zip(COLOUR..).for_each(|(place, role)| put(place, role));
            }
            (Some(ColourSource::Rgb), Some(RgbPlaces::Whole(place) | RgbPlaces::Float(place)), _)
            | (Some(ColourSource::Intensity), _, Some(place)) => put(place, COLOUR),
            _ => {}
        }
        self.class.into_iter().for_each(|place| put(place, CLASS));
        self.axes.into_iter().enumerate().for_each(|(axis, place)| put(place, axis));
        roles
    }

    /// Parses the values of a row; fails if their number is wrong.
    fn parse(&self, row: &[u8], roles: &[usize]) -> Result<Row, String> {
        let is_blank = |byte: &u8| byte.is_ascii_whitespace() || self.commas && *byte == b',';
        let (mut found, mut rest) = ([0.0; NOTHING + 1], row);
        for (number, &role) in roles.iter().enumerate() {
            while let [first, behind @ ..] = rest
                && is_blank(first)
            {
                rest = behind;
            }
            if rest.is_empty() {
                return Err(self.uneven(number, row));
            }
            if role != NOTHING
                && let Some((value, len)) = short(rest, b'.')
                && rest.get(len).is_none_or(is_blank)
            {
                (found[role], rest) = (value, &rest[len..]);
                continue;
            }
            let (word, behind) = rest.split_at(rest.iter().position(is_blank).unwrap_or(rest.len()));
            rest = behind;
            if role != NOTHING {
                let wrong = || format!("value {}: expected a number, found {}", number + 1, shown(word));
                found[role] = decimal(word, false).ok_or_else(wrong)?;
            }
        }
        if rest.iter().all(is_blank) { Ok(found) } else { Err(self.uneven(self.count(row), row)) }
    }

    #[cold]
    fn uneven(&self, found: usize, row: &[u8]) -> String {
        format!("expected {} values, found {found}: {}", self.words, shown(row.trim_ascii()))
    }

    /// Returns the colour value of a row.
    fn value(&self, row: &Row, source: ColourSource) -> Option<[u16; 3]> {
        let (scale, [.., red, green, blue, _]) = (self.channels.scale(), row);
        Some(match (source, self.rgb) {
            (ColourSource::Intensity, _) => [scale.of(self.intensity.map(|_| *red)?), 0, 0],
            (ColourSource::Rgb, Some(RgbPlaces::Each(_))) => [red, green, blue].map(|v| scale.of(*v)),
            (ColourSource::Rgb, Some(RgbPlaces::Whole(_))) => bytes_of(*red as i64 as u32),
            (ColourSource::Rgb, Some(RgbPlaces::Float(_))) => bytes_of((*red as f32).to_bits()),
            _ => return None,
        })
    }

    /// Joins lines to `stated` points, skips the elements `tail` and checks that the file ends there.
    fn walk(&self, opening: &Opening<'_, '_>, start: u64, stated: u64, tail: &[Element]) -> Result<Walk> {
        let (mut lines, mut fold) = (Lines::begin(opening.source, start), Fold::default());
        let mut walk = Walk { held: 0, end: start, folded: false, wrong: None };
        let mut number = 0u64;
        while walk.held < stated {
            if number.is_multiple_of(1 << 16) && opening.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            number += 1;
            let line = match lines.next_row() {
                Ok(Some((_, line))) => line,
                Ok(None) => {
                    walk.wrong = Some(lines.error("the file ends"));
                    return Ok(walk);
                }
                // A line that is too long.
                Err(error @ Error::Input { .. }) => {
                    walk.wrong = Some(error);
                    return Ok(walk);
                }
                Err(error) => return Err(error),
            };
            match fold.add(line, self) {
                Ok(true) => (walk.held, walk.end) = (walk.held + 1, lines.position()),
                Ok(false) => walk.folded = true,
                Err(reason) => {
                    walk.wrong = Some(lines.error(reason));
                    return Ok(walk);
                }
            }
        }
        let after = pass(&mut lines, tail, opening.monitor).and_then(|passed| match passed {
            Err(reason) => Ok(Some(lines.error(reason))),
            Ok(()) => Ok(lines.row()?.map(|_| lines.error("more lines follow"))),
        });
        walk.wrong = match after {
            Err(error @ Error::Input { .. }) => Some(error),
            after => after?,
        };
        Ok(walk)
    }
}

/// Skips elements, each of which begins and ends at line boundaries; the inner error describes the fault.
pub(super) fn pass(lines: &mut Lines<'_>, elements: &[Element], monitor: &dyn Monitor) -> Result<Result<(), String>> {
    for element in elements {
        for instance in 0..element.count {
            if instance.is_multiple_of(1 << 12) && monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let mut values = Values { properties: &element.properties, left: 0.0 };
            while !values.properties.is_empty() || values.left > 0.0 {
                let Some((_, line)) = lines.next_row()? else {
                    let name = shown(element.name.as_bytes());
                    return Ok(Err(format!("the file ends within the element {name}")));
                };
                let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
                if let Err(reason) = words.try_for_each(|word| values.take(word)) {
                    let name = shown(element.name.as_bytes());
                    return Ok(Err(format!("element {name}: {reason}")));
                }
            }
        }
    }
    Ok(Ok(()))
}

/// Values of an element that have not been read yet.
struct Values<'e> {
    properties: &'e [Property],
    /// Values left in the current list.
    left: f64,
}

impl Values<'_> {
    fn take(&mut self, word: &[u8]) -> Result<(), String> {
        if self.left > 0.0 {
            self.left -= 1.0;
            return Ok(());
        }
        let Some((property, rest)) = self.properties.split_first() else {
            return Err(format!("expected the end of the line, found {}", shown(word)));
        };
        self.properties = rest;
        if property.list.is_some() {
            let length = decimal(word, false).filter(|length| *length >= 0.0 && length.fract() == 0.0);
            self.left = length.ok_or_else(|| format!("expected the length of a list, found {}", shown(word)))?;
        }
        Ok(())
    }
}

impl Body {
    /// Opens the points from `lines` on, of which the header states `stated`, followed by the elements `tail`. Any
    /// other number of points or lines is a loss.
    pub fn open(
        opening: &mut Opening<'_, '_>,
        form: Form,
        mut lines: Lines<'_>,
        stated: u64,
        tail: &[Element],
    ) -> Result<Self> {
        let start = lines.position();
        let in_rows = lines.peek()?.is_none_or(|row| form.count(&row) == form.words);
        let held = lines.count_rows(stated, false, opening.monitor)?;
        let end = lines.position();
        let more = lines.count_rows(u64::MAX, false, opening.monitor)?;
        let behind = tail.iter().fold(0u64, |sum, element| sum.saturating_add(element.count));
        let as_many = held == stated && more == behind;
        if in_rows && as_many {
            return Ok(Self { form, start, end, points: held, stated, folded: false });
        }
        let walk = form.walk(opening, start, stated, tail)?;
        let folded = walk.folded;
        if walk.wrong.is_none() {
            return Ok(Self { form, start, end: walk.end, points: stated, stated, folded });
        }
        if !in_rows && !as_many {
            let (words, held) = (form.words, walk.held);
            let reason = walk.wrong.map(without_path).unwrap_or_default();
            let text = format!("the header states {stated} points of {words} values, {held} follow: {reason}");
            opening.findings.lose_points(stated - held, text)?;
            return Ok(Self { form, start, end: walk.end, points: held, stated, folded });
        }
        if held < stated {
            let text = format!("the header states {stated} points, {held} lines follow");
            opening.findings.lose_points(stated - held, text)?;
        } else if more > behind {
            let extra = more - behind;
            let text = format!("the header states {stated} points, {} lines follow", held + extra);
            opening.findings.lose_points(more - behind, text)?;
        } else if more < behind
            && let Some(error) = walk.wrong
        {
            opening.findings.note(format!("behind its points: {}", without_path(error)));
        }
        Ok(Self { form, start, end, points: held, stated, folded: false })
    }

    /// Passes the rows of a piece, or their faults, to `take` until it returns false.
    fn each_row(
        &self,
        piece: &Piece,
        source: &Source,
        wanted: Option<ColourSource>,
        mut take: impl FnMut(Result<Row, Error>) -> Result<bool>,
    ) -> Result<()> {
        let roles = self.form.roles(wanted);
        // A row belongs to the piece in which it begins.
        let mut lines = match piece.first == self.start {
            true => Lines::begin(source, piece.first),
            false => {
                let mut lines = Lines::begin(source, piece.first - 1);
                lines.next()?;
                lines
            }
        };
        let mut fold = Fold::default();
        while lines.position() < piece.end {
            let Some(step) = lines.step()? else { break };
            let (at, line) = match step {
                Step::Row(at, line) => (at, Some(lines.at(line))),
                Step::TooLong(at) => (at, None),
                Step::Pause => continue,
            };
            if at >= piece.end {
                break;
            }
            let row = match line.ok_or_else(|| Fault::too_long().reason) {
                Ok(line) if !self.folded => self.form.parse(line, &roles),
                Err(reason) if !self.folded => Err(reason),
                line => match line.and_then(|line| fold.add(line, &self.form)) {
                    Ok(true) => self.form.parse(&fold.row, &roles),
                    Ok(false) => continue,
                    Err(reason) => return Err(lines.error(reason)),
                },
            };
            if !take(row.map_err(|reason| lines.error(reason)))? {
                break;
            }
        }
        Ok(())
    }
}

impl Cloud for Body {
    fn format(&self) -> &'static str {
        self.form.format
    }

    fn points_stated(&self) -> u64 {
        self.stated
    }

    fn points_expected(&self) -> u64 {
        self.points
    }

    fn has_values(&self, source: ColourSource) -> bool {
        if source == ColourSource::Class { self.form.class.is_some() } else { self.form.channels.has(source) }
    }

    fn prepare(&mut self, source: ColourSource, file: &Source) -> Result<()> {
        let mut sample = Sample::NOTHING;
        if self.form.channels.is_open(source) {
            let of_source = if source == ColourSource::Rgb { COLOUR..NOTHING } else { COLOUR..COLOUR + 1 };
            let pieces = self.pieces().count() as u64;
            let places = SAMPLE_PLACES.min(pieces);
            let rows = SAMPLE_POINTS as u64 * (SAMPLE_PLACES / places.max(1));
            let at = |place: u64| (place * (pieces - 1) / (places - 1).max(1)) as usize;
            let mut wanted = (0..places).map(at).peekable();
            for (_, piece) in self.pieces().enumerate().filter(|(number, _)| wanted.next_if_eq(number).is_some()) {
                let mut left = rows;
                self.each_row(&piece, file, Some(source), |row| {
                    // Invalid rows are refused when they are read in full.
                    row.iter().flat_map(|row| &row[of_source.clone()]).for_each(|&value| sample.add(value));
                    left -= 1;
                    Ok(left > 0)
                })?;
            }
        }
        self.form.channels.settle(source, &sample);
        Ok(())
    }

    fn depth(&self) -> Depth {
        self.form.channels.depth()
    }

    fn pieces(&self) -> Box<dyn Iterator<Item = Piece> + Send + '_> {
        let bytes = self.end - self.start;
        let of_piece = if self.folded { bytes.max(1) } else { PIECE_BYTES };
        Box::new((0..bytes.div_ceil(of_piece)).map(move |number| {
            let first = self.start + number * of_piece;
            let end = self.end.min(first + of_piece);
            let share = u128::from(self.points) * u128::from(end - first) / u128::from(bytes);
            Piece { points: share as u64, part: 0, first, end }
        }))
    }

    fn decode(&self, piece: &Piece, source: &Source, _: &mut Vec<u8>, taker: &mut Taker<'_>) -> Result<u64> {
        let wanted = taker.wanted();
        self.each_row(piece, source, wanted, |row| {
            match row {
                Ok(row) => {
                    let value = wanted.and_then(|source| self.form.value(&row, source));
                    taker.push([row[0], row[1], row[2]], self.form.class.map(|_| row[CLASS]), value)?;
                }
                Err(error) => taker.leave_out(1, error)?,
            }
            Ok(true)
        })?;
        Ok(0)
    }

    fn state(&self) -> Vec<u8> {
        let Form { axes, class, words, commas, .. } = &self.form;
        let marks = [u64::from(*commas), u64::from(self.folded), self.start, self.end];
        let places = axes.iter().chain(class).chain([words]).map(|place| *place as u64);
        places.chain(marks).flat_map(u64::to_le_bytes).collect()
    }
}

/// Checks the bytes after the `stated` records and everything else stated in a binary body: they may be padding; more
/// records are a loss.
pub(super) fn look_behind(opening: &mut Opening<'_, '_>, end: u64, stride: usize, stated: u64) -> Result<()> {
    let mut block = [0; LOOK_BYTES];
    let mut at = end;
    while at < opening.bytes {
        if opening.monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let got = opening.source.read_at(&mut block, at)?;
        let is_padding = |byte: &u8| *byte == 0 || byte.is_ascii_whitespace();
        if !block[..got].iter().all(is_padding) {
            let more = opening.bytes - end;
            let text = format!("the header states {stated} points, but {} more follow its data", counted(more, "byte"));
            return opening.findings.lose_points(more / stride as u64, text);
        }
        if got == 0 {
            break;
        }
        at += got as u64;
    }
    Ok(())
}
