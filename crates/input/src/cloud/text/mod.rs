//! Clouds as text: XYZ, CSV, PTS, PTX.
//!
//! A [`Rows`] is a list of segments of rows. Plain text is cut into pieces of 4 MiB at line ends, which any number of
//! threads parse; compressed text (gzip, zstd) is read by one thread. PTX states how many rows belong to a cloud, so
//! its lines are counted when it is opened. Tables (XYZ, CSV, PTS) are not read through: [`decision`] examines their
//! first rows, and the count in their first line is checked after all pieces are read ([`Tally`]).
//!
//! Source: "Leica PTX / PTS format" as Cyclone writes it.

mod decimal;
mod decision;
mod heading;
mod layout;
mod lines;
mod ptx;
mod tally;

use super::values::{Channels, Kind, SAMPLE_PLACES, SAMPLE_POINTS, Sample, Scale};
use super::{Cloud, Depth, Opened, Opening, Piece, Pose, Source, Standpoint, Taker};
use crate::colour::ColourSource;
use crate::columns::{TextColumn, TextLayout};
use crate::diagnostics::Findings;
use crate::{Error, Monitor, Parameter, Result};
use decision::{Beginning, Custom, Decision, decide, is_header};
use heading::NameUnit;
use layout::{Cell, Parsed, Places, RgbPlaces, RowLayout, Separator, ValueLayout};
use lines::is_word;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use tally::{Count, Tally};

pub(super) use decimal::short;
pub(super) use layout::Fault;
pub use lines::unpacked_name;
pub(super) use lines::{Lines, Packing, Step};
pub(super) use ptx::open_ptx;

/// Bytes per piece of plain text.
const PIECE_BYTES: u64 = 4 << 20;
/// Maximum number of clouds per file.
const MOST_CLOUDS: usize = 1 << 16;
/// Number of rows examined to recognise a text.
const LOOKED_AT: usize = 256;
/// Number of comments kept from before them.
const MOST_COMMENTS: usize = 64;
/// Format name of tables whose columns a user may name.
const TABLE: &str = "text";
/// Number of points shown to people.
const SHOWN_POINTS: usize = 3;

/// Rows that belong together.
#[derive(Debug, Clone)]
struct Segment {
    /// Offset of the first row in the text; `end`: offset after the last.
    start: u64,
    end: u64,
    /// Approximate number of rows.
    rows: u64,
    /// Number of cells per row, if it is fixed.
    cells: Option<usize>,
    pose: Option<Pose>,
    station: Option<[f64; 3]>,
}

impl Segment {
    /// Returns the rows between two offsets, without a pose.
    fn plain(start: u64, end: u64, rows: u64) -> Self {
        Self { start, end, rows, cells: None, pose: None, station: None }
    }
}

/// Rows of text with one point each.
#[derive(Debug)]
pub(super) struct Rows {
    format: &'static str,
    packing: Packing,
    layout: RowLayout,
    channels: Channels,
    segments: Vec<Segment>,
    /// `0 0 0` means no return.
    zero_is_absent: bool,
    stated: u64,
    /// Number of points stated by the first line, which can only be checked by reading.
    count: Option<Count>,
    /// Tallies of pieces by their first byte.
    found: Mutex<BTreeMap<u64, Tally>>,
}

/// Next item in a piece.
enum Next<'a> {
    Row(&'a [u8]),
    TooLong,
    /// No row for some time.
    Pause,
}

/// How to parse rows, with the requested values.
struct Reading<'a> {
    layout: &'a RowLayout,
    values: Option<ValueLayout<'a>>,
    scale: Scale,
}

impl Reading<'_> {
    #[inline]
    fn parse(&self, row: &[u8], cells: Option<usize>) -> Parsed<[u16; 3]> {
        match &self.values {
            None => self.layout.parse(row, cells).map(|(at, class)| (at, class, None)),
            Some(values) => {
                let (at, class, numbers) = values.parse(row, cells)?;
                Ok((at, class, numbers.map(|numbers| values.value(&numbers, &self.scale))))
            }
        }
    }
}

impl Rows {
    /// Returns the number of cells of a row that begins a cloud. In a file of several, clouds may differ: x, y, z;
    /// these with intensity; or with intensity, red, green and blue. Rows of six have the colours elsewhere, so they
    /// mix only with rows of three.
    fn other_width(&self, segment: &Segment, row: &[u8]) -> Option<usize> {
        let found = self.layout.separator().cells(row).ok()?.len();
        let fits =
            |a: usize, b: usize| a == 3 && [3, 4, 6, 7].contains(&b) || [4, 7].contains(&a) && [4, 7].contains(&b);
        segment.cells.filter(|cells| self.format == "PTS" && (fits(*cells, found) || fits(found, *cells)))?;
        Some(found)
    }

    /// Creates a cloud without rows.
    fn empty(format: &'static str, packing: Packing, layout: RowLayout, channels: Channels) -> Self {
        Self {
            format,
            packing,
            layout,
            channels,
            segments: Vec::new(),
            zero_is_absent: false,
            stated: 0,
            count: None,
            found: Mutex::default(),
        }
    }

    /// Returns the point of a row in the coordinates of the file, its class and its value; `None` if it has no return.
    #[inline]
    fn point<V>(
        &self,
        of: &Segment,
        (at, class, value): ([f64; 3], Option<f64>, V),
    ) -> Option<([f64; 3], Option<f64>, V)> {
        if self.zero_is_absent && at == [0.0; 3] {
            return None;
        }
        Some((of.pose.map_or(at, |pose| pose.apply(at)), class, value))
    }

    /// Creates an error about the row that `lines` returned last.
    #[cold]
    fn row_error(&self, fault: Fault, lines: &Lines<'_>) -> Error {
        match fault.is_width && self.format == TABLE {
            true => lines.error(fault.reason).with_suggestion(Parameter::Columns),
            false => {
                lines.error(format!("{}; fetch or write it again", fault.reason)).with_suggestion(Parameter::Incomplete)
            }
        }
    }

    /// Returns the number of points in a row that states one, as a PTS may do before each cloud.
    fn count_in(&self, row: &[u8]) -> Option<u64> {
        if self.count.is_some_and(|count| count.may_repeat) { whole_word(row) } else { None }
    }

    /// Passes the items of a piece, each with its offset and segment number, to `take` until it returns false.
    fn each_row(
        &self,
        piece: &Piece,
        source: &Source,
        mut take: impl FnMut(u64, usize, Next<'_>, &Lines<'_>) -> Result<bool>,
    ) -> Result<()> {
        let is_packed = self.packing != Packing::Plain;
        let mut part = piece.part;
        let Some(first) = self.segments.get(part) else { return Ok(()) };
        // A row belongs to the piece in which it begins.
        let mut lines = match is_packed {
            true => Lines::open(source, source.stamp().len(), self.packing, None)?,
            false if piece.first == first.start => Lines::begin(source, piece.first),
            false => Lines::begin_behind(source, piece.first - 1, piece.end)?,
        };
        let end = if is_packed { u64::MAX } else { piece.end };
        while lines.position() < end {
            let Some(step) = lines.step()? else { break };
            let (at, next) = match step {
                Step::Row(at, line) => (at, Next::Row(lines.at(line))),
                Step::TooLong(at) => (at, Next::TooLong),
                Step::Pause => (0, Next::Pause),
            };
            if let Next::Pause = next {
                if take(at, part, next, &lines)? {
                    continue;
                }
                break;
            }
            if at >= end {
                break;
            }
            // Rows of the next cloud follow after its header.
            while is_packed && self.segments.get(part).is_some_and(|segment| at >= segment.end) {
                part += 1;
            }
            let Some(segment) = self.segments.get(part) else { break };
            if at >= segment.start && !take(at, part, next, &lines)? {
                break;
            }
        }
        Ok(())
    }

    /// Counts the rows of a piece without parsing them.
    fn count_rows(&self, piece: &Piece, source: &Source, monitor: &dyn Monitor) -> Result<Tally> {
        let (mut tally, mut rows) = (Tally::default(), 0u64);
        self.each_row(piece, source, |_, _, next, _| {
            rows += 1;
            if (rows.is_multiple_of(1 << 16) || matches!(next, Next::Pause)) && monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            match next {
                Next::Row(row) => match self.count_in(row) {
                    Some(stated) => tally.add_count(stated),
                    None => tally.add_row(),
                },
                Next::TooLong => tally.add_row(),
                Next::Pause => {}
            }
            Ok(true)
        })?;
        Ok(tally)
    }
}

impl Cloud for Rows {
    fn format(&self) -> &'static str {
        self.format
    }

    fn points_stated(&self) -> u64 {
        self.stated
    }

    fn points_expected(&self) -> u64 {
        self.segments.iter().map(|segment| segment.rows).fold(0, u64::saturating_add)
    }

    fn pieces(&self) -> Box<dyn Iterator<Item = Piece> + Send + '_> {
        if self.packing != Packing::Plain {
            let all = Piece { points: self.points_expected(), part: 0, first: 0, end: u64::MAX };
            return Box::new(Some(all).into_iter().filter(|_| !self.segments.is_empty()));
        }
        Box::new(self.segments.iter().enumerate().flat_map(|(part, segment)| {
            let bytes = segment.end - segment.start;
            (0..bytes.div_ceil(PIECE_BYTES)).map(move |number| {
                let first = segment.start + number * PIECE_BYTES;
                let end = segment.end.min(first + PIECE_BYTES);
                let share = u128::from(segment.rows) * u128::from(end - first) / u128::from(bytes);
                Piece { points: share as u64, part, first, end }
            })
        }))
    }

    fn has_values(&self, source: ColourSource) -> bool {
        if source == ColourSource::Class { self.layout.has_class() } else { self.channels.has(source) }
    }

    fn prepare(&mut self, source: ColourSource, file: &Source) -> Result<()> {
        let mut sample = Sample::NOTHING;
        if let Some(values) = self.layout.with_values(source).filter(|_| self.channels.is_open(source)) {
            let pieces = self.pieces().count() as u64;
            // Of compressed text, only the beginning is accessible.
            let places = SAMPLE_PLACES.min(pieces);
            let rows = SAMPLE_POINTS as u64 * (SAMPLE_PLACES / places.max(1));
            let at = |place: u64| (place * (pieces - 1) / (places - 1).max(1)) as usize;
            let mut wanted = (0..places).map(at).peekable();
            for (_, piece) in self.pieces().enumerate().filter(|(number, _)| wanted.next_if_eq(number).is_some()) {
                let mut left = rows;
                self.each_row(&piece, file, |_, part, next, _| {
                    // Invalid rows are refused when they are read in full.
                    let Next::Row(row) = next else { return Ok(false) };
                    let segment = &self.segments[part];
                    let cells = self.other_width(segment, row).or(segment.cells);
                    if let Ok((_, _, Some(numbers))) = values.parse(row, cells) {
                        values.look(&numbers, &mut sample);
                    }
                    left -= 1;
                    Ok(left > 0)
                })?;
            }
        }
        self.channels.settle(source, &sample);
        Ok(())
    }

    fn depth(&self) -> Depth {
        self.channels.depth()
    }

    fn decode(&self, piece: &Piece, source: &Source, _: &mut Vec<u8>, taker: &mut Taker<'_>) -> Result<u64> {
        let (layout, scale) = (&self.layout, self.channels.scale());
        let reading = Reading { layout, values: taker.wanted().and_then(|source| layout.with_values(source)), scale };
        let mut tally = Tally::default();
        // Cells per row of the current cloud, if not those of the first; whether none of its rows has been read; and
        // whether its width was taken from the last one.
        let (mut width, mut is_first, mut is_new) = (None, self.count.is_some(), false);
        let done = self.each_row(piece, source, |at, part, next, lines| {
            taker.begin_cloud(part)?;
            let segment = &self.segments[part];
            let fault = match next {
                Next::Row(row) => match reading.parse(row, width.or(segment.cells)) {
                    Ok(row) => {
                        (is_first, is_new) = (false, is_first);
                        tally.add_row();
                        match self.point(segment, row) {
                            Some((at, class, value)) => taker.push(at, class, value)?,
                            None => taker.absent()?,
                        }
                        return Ok(true);
                    }
                    // Rows without a return may end before the colours.
                    Err(_)
                        if self.zero_is_absent && self.layout.parse(row, None).is_ok_and(|row| row.0 == [0.0; 3]) =>
                    {
                        tally.add_row();
                        return taker.absent().map(|()| true);
                    }
                    Err(fault) => match self.count_in(row) {
                        Some(stated) => {
                            (width, is_first, is_new) = (None, true, false);
                            tally.add_count(stated);
                            return Ok(true);
                        }
                        None => {
                            let other = is_first.then(|| self.other_width(segment, row)).flatten();
                            match other.map(|other| reading.parse(row, Some(other))) {
                                Some(Ok((at, class, value))) => {
                                    (width, is_first, is_new) = (other, false, true);
                                    tally.add_row();
                                    return taker.push(at, class, value).map(|()| true);
                                }
                                _ => {
                                    // The first row was cut, and the others are wider or have the usual width.
                                    let (usual, cells) = (segment.cells, self.other_width(segment, row));
                                    let likelier = [usual, cells.filter(|_| cells > width.or(usual))];
                                    let fits = |cells: &Option<usize>| is_new && reading.parse(row, *cells).is_ok();
                                    let found = likelier.into_iter().find(fits);
                                    (width, is_new) = (found.unwrap_or(width), found.is_some());
                                    fault
                                }
                            }
                        }
                    },
                },
                Next::TooLong => Fault::too_long(),
                // Lets the sink cancel the work.
                Next::Pause => return taker.flush().map(|()| true),
            };
            tally.add_row();
            if !taker.lose()? {
                return Err(self.row_error(fault, lines));
            }
            tally.add_fault(at, fault.reason);
            Ok(true)
        });
        // Recorded even if damage ended the piece, but not if the sink did: then there may be more rows.
        if !taker.refused {
            self.found.lock().unwrap_or_else(PoisonError::into_inner).insert(piece.first, tally);
        }
        done.map(|()| 0)
    }

    fn check(&self, findings: &mut Findings<'_>, monitor: &dyn Monitor) -> Result<()> {
        let mut found = std::mem::take(&mut *self.found.lock().unwrap_or_else(PoisonError::into_inner));
        let source = || Source::open(findings.path, None);
        // Pieces decoded by an earlier run have no tally; their rows are counted now.
        let missing = self.pieces().filter(|piece| self.count.is_some() && !found.contains_key(&piece.first));
        for piece in missing.collect::<Vec<_>>() {
            found.insert(piece.first, self.count_rows(&piece, &source()?, monitor)?);
        }
        if let Some(count) = self.count {
            tally::check_count(count, found.values(), findings)?;
        }
        let (lost, first) = tally::faults(found.values());
        if let Some((at, reason)) = first {
            let line = lines::number_at(&source()?, self.packing, at)?;
            let (rows, more) =
                if lost == 1 { ("row", String::new()) } else { ("rows", ", the first of them".to_owned()) };
            findings.lose(format!("{lost} {rows} left out{more}: {line}: {reason}"))?;
        }
        Ok(())
    }

    fn forget(&self) {
        self.found.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    fn state(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = self.layout.bytes().collect();
        bytes.extend([self.zero_is_absent.into(), self.packing as u8]);
        for Segment { start, end, cells, pose, .. } in &self.segments {
            let cells = cells.map_or(0, |cells| cells as u64);
            bytes.extend([*start, *end, cells].into_iter().flat_map(u64::to_le_bytes));
            bytes.extend(pose.iter().flat_map(Pose::bytes));
        }
        bytes
    }

    fn standpoints(&self) -> Vec<Standpoint> {
        let of_segment = |(number, segment): (usize, &Segment)| match segment.station {
            _ if segment.rows == 0 => Standpoint::Needless,
            Some(at) => Standpoint::At(at),
            None if self.format == "PTX" => {
                let reason = "scanner position and matrix name different places";
                Standpoint::Unknown(format!("cloud {}: {reason}", number + 1))
            }
            None => Standpoint::Unknown(format!("{} does not say where the scanner stood", self.format)),
        };
        self.segments.iter().enumerate().map(of_segment).collect()
    }
}

/// Opens the lines of a text, after its byte order mark.
fn begin<'a>(opening: &Opening<'a, '_>) -> Result<(Lines<'a>, Packing)> {
    let packing = Packing::of(opening.source)?;
    Ok((Lines::open(opening.source, opening.bytes, packing, Some(opening.monitor))?, packing))
}

/// Opens XYZ, CSV and other text in rows.
pub(super) fn open_rows(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    let custom = if is_xyzrgb(opening.source.path()) { Custom::XyzRgb } else { Custom::Xyz };
    open_table(opening, custom)
}

/// Opens PTS: the number of points, then that many rows; possibly repeated.
pub(super) fn open_pts(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    open_table(opening, Custom::Pts)
}

/// Returns whether the name indicates that red, green and blue follow the coordinates.
fn is_xyzrgb(path: &Path) -> bool {
    unpacked_name(path).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("xyzrgb"))
}

fn parse_whole(text: &[u8]) -> Option<u64> {
    std::str::from_utf8(text.trim_ascii()).ok()?.parse().ok()
}

/// Returns the whole number that is the only word of a row.
fn whole_word(row: &[u8]) -> Option<u64> {
    if is_word(row) { parse_whole(row) } else { None }
}

/// Line before the rows of a table.
struct Header {
    line: Vec<u8>,
    /// Offset of the line; `number`: its number.
    at: u64,
    number: u64,
}

impl Header {
    /// Returns whether the line is a damaged row rather than a header: it names no axes, and has numbers in two of
    /// their columns.
    fn is_row(&self, Decision { layout, places, .. }: &Decision) -> bool {
        let cells = layout.separator().cells(&self.line).unwrap_or_default();
        let cell = |column: usize| cells.get(column).map(|cell| Cell::of(cell, layout.decimal_comma()));
        let is_number = |column: usize| matches!(cell(column), Some(Cell::Number(_)));
        places.axes.into_iter().filter(|&column| is_number(column)).count() >= 2 && !is_header(&self.line)
    }
}

/// Lines before the rows of a table, and the first rows.
#[derive(Default)]
struct Start {
    separator: Option<Separator>,
    comments: Vec<Vec<u8>>,
    /// Line that names the columns.
    header: Option<Header>,
    count: Option<u64>,
    /// Offset of the first row, and its line number.
    first: Option<(u64, u64)>,
    rows: Vec<Vec<u8>>,
    /// True if these are all rows.
    is_whole: bool,
}

impl Start {
    /// Reads them; `is_named` if the user names the columns.
    fn read(lines: &mut Lines<'_>, custom: Custom, is_named: bool) -> Result<Self> {
        let mut start = Self::default();
        while start.rows.len() < LOOKED_AT {
            let is_first = lines.number() == 0;
            let Some((at, line)) = lines.next()? else {
                start.is_whole = true;
                break;
            };
            let Some(line) = line else {
                // After the first row, it is a bad row like any other.
                if start.first.is_none() {
                    return Err(lines.error(Fault::too_long().reason));
                }
                continue;
            };
            if is_first && let Some(separator) = decision::stated_separator(line) {
                start.separator = Some(separator);
                continue;
            }
            let text = line.trim_ascii();
            let is_comment = text.starts_with(b"#") || text.starts_with(b"//");
            if text.is_empty() || is_comment && start.first.is_some() {
                continue;
            }
            if is_comment {
                if start.comments.len() < MOST_COMMENTS && is_header(text) {
                    start.comments.push(line.to_vec());
                }
                continue;
            }
            match whole_word(text) {
                Some(count) if start.first.is_none() && start.count.is_none() => {
                    start.count = Some(count);
                    continue;
                }
                Some(_) if custom == Custom::Pts => continue,
                _ => {}
            }
            let names = start.first.is_none() && is_header(text);
            // Behind the names of the axes, rows may have empty cells or faults.
            let is_behind_names = || match &start.header {
                Some(header) => is_named || is_header(&header.line),
                None => !start.comments.is_empty() && decision::is_without_text(text),
            };
            if start.first.is_some() || is_behind_names() || decision::is_row(text) && !names {
                let line = line.to_vec();
                start.first.get_or_insert((at, lines.number()));
                start.rows.push(line);
            } else if start.header.is_none() && (names || custom != Custom::Pts) {
                let line = line.to_vec();
                start.header = Some(Header { line, at, number: lines.number() });
            } else {
                let what = if custom == Custom::Pts { "a number of points" } else { "numbers" };
                let line = text.to_vec();
                return Err(lines.expected(what, &line));
            }
        }
        Ok(start)
    }
}

/// Opens a table, whose rows may follow their count and the names of the columns.
fn open_table(opening: &mut Opening<'_, '_>, custom: Custom) -> Result<Opened> {
    let (mut lines, packing) = begin(opening)?;
    // A user names columns of tables; a PTS has a layout of its own.
    let columns = opening.columns.filter(|_| custom != Custom::Pts);
    let Start { separator, comments, header, count, first, rows, is_whole } =
        Start::read(&mut lines, custom, columns.is_some())?;
    let format = if custom == Custom::Pts { "PTS" } else { TABLE };
    let Some((start, first_line)) = first else {
        if let Some(count) = count.filter(|&count| count > 0) {
            let text = format!("its first line states {count} points, no lines follow");
            opening.findings.lose_points(count, text)?;
        }
        if let Some(Header { line, number, .. }) = header.filter(|header| !is_header(&header.line)) {
            let reason = format!("expected columns named x, y and z, found {}", super::shown(line.trim_ascii()));
            return Err(opening.error(format!("line {number}"), reason).with_suggestion(Parameter::Columns));
        }
        let layout = RowLayout::new(Places::of([0, 1, 2]), Separator::Blanks, false);
        return Ok(Opened::new(Rows::empty(format, packing, layout, Channels::new(None, None))));
    };
    let named = header.as_ref().map(|header| &header.line[..]);
    let beginning = Beginning { separator, comments: &comments, header: named, rows: &rows };
    let decided = decide(&beginning, columns, custom).map_err(|refusal| {
        let line = header.as_ref().filter(|_| refusal.is_of_header).map_or(first_line, |header| header.number);
        let at = format!("line {line}");
        match custom {
            Custom::Pts => {
                let suggestion = "give it the ending .txt and name its columns";
                opening.error(at, format!("{}; {suggestion}", refusal.reason))
            }
            _ => opening.error(at, refusal.reason).with_suggestion(Parameter::Columns),
        }
    })?;
    let start = header.filter(|header| columns.is_some() && header.is_row(&decided)).map_or(start, |header| header.at);
    let Decision { layout, places, cells, names, units, odd } = decided;
    let kind = if custom == Custom::Pts && names.is_empty() { Kind::Custom } else { Kind::Any };
    let channels = Channels::new(places.rgb.map(|_| kind), places.intensity.map(|_| Kind::Any));
    let end = if packing == Packing::Plain { opening.bytes } else { u64::MAX };
    let mean = rows.iter().map(|row| row.len() as u64 + 1).sum::<u64>() / rows.len().max(1) as u64;
    let guess = if is_whole { rows.len() as u64 } else { opening.bytes / mean.max(1) };
    // In compressed text and with several clouds, the first line or the guess may be far off.
    let near = count.filter(|count| (guess / 2..=guess.saturating_mul(2)).contains(count));
    let segment = Segment { cells, ..Segment::plain(start, end, near.unwrap_or(guess).max(1)) };
    let is_seen = custom != Custom::Pts || cells != Some(4);
    let shown = Places { rgb: places.rgb.filter(|_| is_seen), ..places };
    let text = text_layout(&layout, &shown, &names, &rows, |row| layout.parse(row, cells).ok().map(|row| row.0));
    let may_repeat = custom == Custom::Pts;
    let count = count.map(|stated| Count { stated: Some(stated), may_repeat });
    let rows = Rows {
        segments: vec![segment],
        stated: count.and_then(|count| count.stated).unwrap_or(0),
        count: count.or(may_repeat.then_some(Count { stated: None, may_repeat })),
        ..Rows::empty(format, packing, layout, channels)
    };
    let mut opened = Opened { odd, text: Some(text), ..Opened::new(rows) };
    let length = |unit| match unit {
        Some(NameUnit::Metres(metres)) => Some(metres),
        _ => None,
    };
    opened.georeference.horizontal = length(units[0]).filter(|_| units[0] == units[1]);
    opened.georeference.vertical = length(units[2]);
    opened.georeference.degrees = units[0] == Some(NameUnit::Angle);
    Ok(opened)
}

/// Returns the description of a layout for people: its columns and the first points.
fn text_layout(
    layout: &RowLayout,
    places: &Places,
    names: &[String],
    rows: &[Vec<u8>],
    point: impl Fn(&[u8]) -> Option<[f64; 3]>,
) -> TextLayout {
    let column = |holds, place: usize| TextColumn {
        holds,
        number: place + 1,
        name: names.get(place).filter(|name| !name.is_empty()).cloned(),
    };
    let rgb = match places.rgb {
        Some(RgbPlaces::Each([r, g, b])) => vec![("red", r), ("green", g), ("blue", b)],
        None => Vec::new(),
    };
    let axes = ["x", "y", "z"].into_iter().zip(places.axes);
    let class = places.class.map(|place| ("class", place));
    let intensity = places.intensity.map(|place| ("intensity", place));
    let all = axes.chain(class).chain(intensity).chain(rgb);
    let points = rows.iter().filter_map(|row| point(row)).filter(|at| !at.iter().any(|v| v.is_nan()));
    TextLayout {
        separator: layout.separator().name(),
        decimal_comma: layout.decimal_comma(),
        columns: all.map(|(holds, place)| column(holds, place)).collect(),
        first_points: points.take(SHOWN_POINTS).collect(),
    }
}

fn check_clouds(clouds: usize, opening: &Opening<'_, '_>) -> Result<()> {
    if clouds == MOST_CLOUDS {
        let what = format!("clouds in {} (write it as several files)", opening.source.path().display());
        return Err(Error::limit(what, format!("more than {MOST_CLOUDS}"), MOST_CLOUDS));
    }
    Ok(())
}
