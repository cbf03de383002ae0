//! Clouds as text: XYZ, CSV, PTS, PTX.
//!
//! A [`Rows`] is a list of segments of rows. Plain text is cut into pieces of 4 MiB at line ends, which any number of
//! threads parse; compressed text (gzip, zstd) is read by one. Formats that state how many rows belong to a cloud are read
//! through once, to count lines, when they are opened.
//!
//! Sources: "Leica PTX / PTS format" as Cyclone writes it. PTX: columns, rows, four lines about the scanner, four rows of a
//! matrix `M`; a point is `(x y z 1) · M`, and `0 0 0` means no return.

mod decimal;
mod layout;
mod lines;

use super::values::{Channels, Kind, SAMPLE_PLACES, SAMPLE_POINTS, Sample, Scale};
use super::{Cloud, Depth, Format, Opened, Opening, Piece, Pose, Source, Standpoint, Taker};
use crate::colour::ColourSource;
use crate::{Error, Parameter, Result};
use layout::{Parsed, Places, RgbPlaces, RowLayout, ValueLayout, columns, is_numeric, names, recognise};
use lines::is_word;

pub(super) use decimal::short;
pub(super) use lines::Lines;
pub(super) use lines::Packing;
pub(in crate::input) use lines::unpacked_name;

/// Bytes of a piece of plain text.
const PIECE_BYTES: u64 = 4 << 20;
/// Most clouds of one file.
const MOST_CLOUDS: usize = 1 << 16;
/// Rows that are looked at to recognise a text.
const LOOKED_AT: usize = 256;

/// Rows that belong together.
#[derive(Debug, Clone)]
struct Segment {
    /// Place in the text of the first row, and behind the last.
    start: u64,
    end: u64,
    /// About how many.
    rows: u64,
    pose: Option<Pose>,
    station: Option<[f64; 3]>,
}

impl Segment {
    /// Rows between two places, without a pose.
    fn plain(start: u64, end: u64, rows: u64) -> Self {
        Self { start, end, rows, pose: None, station: None }
    }
}

/// Rows of text with a point each.
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
}

/// How rows are read with what is asked for.
struct Reading<'a> {
    layout: &'a RowLayout,
    values: Option<ValueLayout<'a>>,
    scale: Scale,
}

impl Reading<'_> {
    #[inline]
    fn parse(&self, row: &[u8]) -> Parsed<[u16; 3]> {
        match &self.values {
            None => self.layout.parse(row).map(|(at, class)| (at, class, None)),
            Some(values) => {
                let (at, class, numbers) = values.parse(row)?;
                Ok((at, class, numbers.map(|numbers| values.value(&numbers, &self.scale))))
            }
        }
    }
}

impl Rows {
    #[inline]
    fn take(
        &self,
        reading: &Reading<'_>,
        of: &Segment,
        row: &[u8],
        lines: &Lines<'_>,
        to: &mut Taker<'_>,
    ) -> Result<()> {
        let (at, class, value) = reading.parse(row).map_err(|reason| lines.error(reason))?;
        if self.zero_is_absent && at == [0.0; 3] {
            return to.absent();
        }
        to.push(of.pose.map_or(at, |pose| pose.apply(at)), class, value)
    }

    /// Hands the rows of a piece to `take`, each with the number of its segment, as long as that asks for more.
    fn each_row(
        &self,
        piece: &Piece,
        source: &Source,
        mut take: impl FnMut(usize, &Segment, &[u8], &Lines<'_>) -> Result<bool>,
    ) -> Result<()> {
        if self.packing != Packing::Plain {
            let mut lines = Lines::open(source, source.stamp().len(), self.packing)?;
            let mut segments = self.segments.iter().enumerate().peekable();
            while let Some(&(part, segment)) = segments.peek() {
                let Some((at, line)) = lines.next_place()? else { break };
                if at >= segment.end {
                    // Rows of the next cloud follow behind its header.
                    segments.next();
                    continue;
                }
                if at >= segment.start && !take(part, segment, lines.at(line), &lines)? {
                    break;
                }
            }
            return Ok(());
        }
        let Some(segment) = self.segments.get(piece.part) else { return Ok(()) };
        // A row belongs to the piece in which it begins.
        let mut lines = match piece.first == segment.start {
            true => Lines::begin(source, piece.first),
            false => {
                let mut lines = Lines::begin(source, piece.first - 1);
                lines.next()?;
                lines
            }
        };
        while lines.position() < piece.end {
            let Some((at, line)) = lines.next_place()? else { break };
            if at >= piece.end || !take(piece.part, segment, lines.at(line), &lines)? {
                break;
            }
        }
        Ok(())
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
            // Of packed text, only the beginning is at hand.
            let places = SAMPLE_PLACES.min(pieces);
            let rows = SAMPLE_POINTS as u64 * (SAMPLE_PLACES / places.max(1));
            let at = |place: u64| (place * (pieces - 1) / (places - 1).max(1)) as usize;
            let mut wanted = (0..places).map(at).peekable();
            for (_, piece) in self.pieces().enumerate().filter(|(number, _)| wanted.next_if_eq(number).is_some()) {
                let mut left = rows;
                self.each_row(&piece, file, |_, _, row, _| {
                    // What is no row of numbers is refused where it is read in full.
                    if let Ok((_, _, Some(numbers))) = values.parse(row) {
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
        self.each_row(piece, source, |part, segment, row, lines| {
            taker.begin_cloud(part)?;
            self.take(&reading, segment, row, lines, taker).map(|()| true)
        })?;
        Ok(0)
    }

    fn state(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = self.layout.bytes().collect();
        bytes.extend([self.zero_is_absent.into(), self.packing as u8]);
        for Segment { start, end, pose, .. } in &self.segments {
            bytes.extend([start, end].into_iter().flat_map(|v| v.to_le_bytes()));
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

/// The lines of a text, which is not one in UTF-16, and its place behind a byte order mark.
fn begin<'a>(opening: &Opening<'a, '_>) -> Result<(Lines<'a>, Packing)> {
    let packing = Packing::of(opening.source)?;
    let start = opening.source.bytes_at(0, opening.bytes.min(2) as usize)?;
    if matches!(start.as_deref(), Some([0xFF, 0xFE] | [0xFE, 0xFF])) {
        return Err(opening.error("byte 0", "text in UTF-16; save it as UTF-8"));
    }
    Ok((Lines::open(opening.source, opening.bytes, packing)?, packing))
}

/// A row without the mark that some editors put before a text.
fn without_mark(row: &[u8]) -> &[u8] {
    row.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(row)
}

/// XYZ, CSV and other text in rows.
pub(super) fn open_rows(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    let (mut lines, packing) = begin(opening)?;
    let (mut header, mut first, mut rows): (Option<Vec<u8>>, _, Vec<Vec<u8>>) = (None, None, Vec::new());
    // Some write the number of points first.
    let mut count: Option<u64> = None;
    while rows.len() < LOOKED_AT {
        let Some((at, line)) = lines.next()? else { break };
        let marked = at == 0 && line.starts_with(b"\xEF\xBB\xBF");
        let line = if marked { without_mark(line) } else { line };
        let text = line.trim_ascii();
        let is_comment = text.starts_with(b"#") || text.starts_with(b"//");
        if text.is_empty() {
            continue;
        }
        if is_comment {
            if header.is_none() && first.is_none() && columns(&names(text)).is_some() {
                header = Some(text.to_vec());
            }
        } else if first.is_none() && count.is_none() && is_word(text) && parse_whole(text).is_some() {
            count = parse_whole(text);
        } else if first.is_some() || is_numeric(text) {
            first.get_or_insert(at + if marked { 3 } else { 0 });
            rows.push(text.to_vec());
        } else if header.is_none() {
            header = Some(text.to_vec());
        } else {
            let line = text.to_vec();
            return Err(lines.expected("numbers", &line));
        }
    }
    let header = header.map(|header| names(&header)).unwrap_or_default();
    let found = columns(&header);
    let is_rgb = format_rgb(opening.source.path());
    let places = match opening.columns {
        Some(columns) => columns.places(),
        None if header.is_empty() && is_rgb => {
            Places { rgb: Some(RgbPlaces::Each([3, 4, 5])), ..Places::of([0, 1, 2]) }
        }
        None if header.is_empty() => Places::of([0, 1, 2]),
        None => found.ok_or_else(|| {
            let found = super::shown(header.join(",").as_bytes());
            let reason = format!("expected columns named x, y and z, found {found}");
            opening.error("header", reason).with_way_out(Parameter::Columns)
        })?,
    };
    let (separator, decimal_comma) = recognise(&rows).map_err(|reason| opening.error("columns", reason))?;
    let layout = RowLayout::new(places, separator, decimal_comma);
    let channels = Channels::new(places.rgb.map(|_| Kind::Any), places.intensity.map(|_| Kind::Any));
    let empty =
        Rows { format: "text", packing, layout, channels, segments: Vec::new(), zero_is_absent: false, stated: 0 };
    let layout = &empty.layout;
    let Some(start) = first else {
        if let Some(count) = count.filter(|&count| count > 0) {
            opening.findings.lose(format!("its first line states {count} points, no lines follow"))?;
        }
        return Ok(Opened::new(empty));
    };
    if let Some(Err(reason)) = rows.first().map(|row| layout.parse(row)) {
        return Err(opening.error("first row", reason).with_way_out(Parameter::Columns));
    }
    let end = if packing == Packing::Plain { opening.bytes } else { u64::MAX };
    let mean = rows.iter().map(|row| row.len() as u64 + 1).sum::<u64>() / rows.len().max(1) as u64;
    let rows = if rows.len() < LOOKED_AT { rows.len() as u64 } else { opening.bytes / mean.max(1) };
    let named = opening.columns.map(|columns| columns.to_string().split(',').map(str::to_owned).collect());
    let said = format!("read as text: {}", layout.describe(&named.unwrap_or(header)));
    let segments = vec![Segment::plain(start, end, rows)];
    Ok(Opened { said: Some(said), ..Opened::new(Rows { segments, ..empty }) })
}

/// Whether the name says that red, green and blue follow the coordinates.
fn format_rgb(path: &std::path::Path) -> bool {
    unpacked_name(path).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("xyzrgb"))
}

fn parse_whole(text: &[u8]) -> Option<u64> {
    std::str::from_utf8(text.trim_ascii()).ok()?.parse().ok()
}

/// PTS: the number of points, then so many rows; maybe again.
pub(super) fn open_pts(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    let (mut lines, packing) = begin(opening)?;
    let (mut segments, mut stated, mut row) = (Vec::new(), 0u64, None);
    let first = lines.row()?;
    let marked = first.as_ref().is_some_and(|row| without_mark(row).len() < row.len());
    let mut next = first.map(|row| without_mark(&row).to_vec());
    let mut uncounted = 0;
    while let Some(line) = next {
        let count = if is_word(&line) { parse_whole(&line) } else { None };
        let start = match count {
            Some(_) => lines.position(),
            // Rows without a number of them before: from the beginning of this one.
            None if segments.is_empty() && is_numeric(&line) && !is_word(&line) => {
                uncounted = 1;
                if marked { 3 } else { 0 }
            }
            None => return Err(lines.expected("a number of points", &line)),
        };
        let most = count.unwrap_or(u64::MAX);
        let mut rows = lines.count_rows(most, true, opening.monitor)? + uncounted;
        if rows < count.unwrap_or(0) {
            let number = segments.len() + 1;
            let text = format!("cloud {number}: its first line states {most} points, {rows} lines follow");
            opening.findings.lose(text)?;
        }
        // One that states fewer than it has goes on until the next.
        let more = lines.count_rows(u64::MAX, true, opening.monitor)?;
        if more > 0 {
            let number = segments.len() + 1;
            opening.findings.note(format!(
                "cloud {number}: its first line states {most} points, {} lines follow; all are read",
                rows + more
            ));
            rows += more;
        }
        stated = stated.saturating_add(rows);
        check_clouds(segments.len(), opening)?;
        segments.push(Segment::plain(start, lines.position(), rows));
        if row.is_none() {
            row = first_row(opening, packing, start)?;
        }
        next = lines.row()?;
    }
    let (layout, channels) = layout_of(opening, Format::Pts, row)?;
    let zero_is_absent = false;
    Ok(Opened::new(Rows { format: "PTS", packing, layout, channels, segments, zero_is_absent, stated }))
}

/// The first row from `start` on.
fn first_row(opening: &Opening<'_, '_>, packing: Packing, start: u64) -> Result<Option<Vec<u8>>> {
    let mut lines = Lines::open(opening.source, opening.bytes, packing)?;
    while let Some((at, line)) = lines.next_row()? {
        if at >= start {
            return Ok(Some(without_mark(line).to_vec()));
        }
    }
    Ok(None)
}

/// Columns 1 to 3, as the first row separates them, and those behind: `i`, `r g b`, or `i r g b`. A PTX may have clouds without colours;
/// so all rows may end before theirs.
fn layout_of(opening: &Opening<'_, '_>, format: Format, first: Option<Vec<u8>>) -> Result<(RowLayout, Channels)> {
    let rows: Vec<Vec<u8>> = first.into_iter().collect();
    let (separator, decimal_comma) = recognise(&rows).map_err(|reason| opening.error("columns", reason))?;
    let count = rows.first().map_or(0, |row| separator.count(row));
    let (intensity, rgb) = match count {
        _ if format == Format::Ptx => (Some(3), Some([4, 5, 6])),
        4 => (Some(3), None),
        6 => (None, Some([3, 4, 5])),
        7.. => (Some(3), Some([4, 5, 6])),
        _ => (None, None),
    };
    let places = Places { rgb: rgb.map(RgbPlaces::Each), intensity, ..Places::of([0, 1, 2]) };
    let channels = Channels::new(rgb.map(|_| Kind::Custom), intensity.map(|_| Kind::Any));
    Ok((RowLayout::new(places, separator, decimal_comma), channels))
}

fn check_clouds(clouds: usize, opening: &Opening<'_, '_>) -> Result<()> {
    if clouds == MOST_CLOUDS {
        let what = format!("clouds in {} (write it as several files)", opening.source.path().display());
        return Err(Error::limit(what, format!("more than {MOST_CLOUDS}"), MOST_CLOUDS));
    }
    Ok(())
}

/// PTX: clouds with a header of ten lines each.
pub(super) fn open_ptx(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    let (mut lines, packing) = begin(opening)?;
    let (mut segments, mut stated, mut first) = (Vec::new(), 0u64, None);
    while let Some(line) = lines.row()? {
        let line = without_mark(&line);
        let Some(columns) = parse_whole(line).filter(|_| is_word(line)) else {
            return Err(lines.expected("the number of columns of a cloud", line));
        };
        let line = lines.row()?.unwrap_or_default();
        let Some(rows) = parse_whole(&line).filter(|_| is_word(&line)) else {
            return Err(lines.expected("the number of rows of a cloud", &line));
        };
        let position = numbers(&mut lines, 3)?;
        for _ in 0..3 {
            numbers(&mut lines, 3)?;
        }
        let mut matrix = [[0.0; 3]; 4];
        for (number, row) in matrix.iter_mut().enumerate() {
            let line = numbers(&mut lines, 4)?;
            row.copy_from_slice(&line[..3]);
            if line[3] != if number == 3 { 1.0 } else { 0.0 } {
                return Err(lines.error(format!("expected a matrix with the last column 0 0 0 1, found {}", line[3])));
            }
        }
        let pose = Pose(matrix);
        if !pose.is_finite() {
            return Err(lines.error("the matrix has numbers that are not finite"));
        }
        let count = columns.saturating_mul(rows);
        let start = lines.position();
        let found = lines.count_rows(count, true, opening.monitor)?;
        stated = stated.saturating_add(count);
        let number = segments.len() + 1;
        if found < count {
            opening.findings.lose(format!("cloud {number}: its header states {count} points, {found} lines follow"))?;
        }
        let station = station(&position, &pose);
        let pose = Some(pose).filter(|pose| *pose != Pose::IDENTITY);
        check_clouds(segments.len(), opening)?;
        segments.push(Segment { pose, station, ..Segment::plain(start, lines.position(), found) });
        if first.is_none() {
            first = first_row(opening, packing, start)?;
        }
    }
    let (layout, channels) = layout_of(opening, Format::Ptx, first)?;
    let rows = Rows { format: "PTX", packing, layout, channels, segments, zero_is_absent: true, stated };
    let mut opened = Opened::new(rows);
    // By convention: Cyclone writes metres.
    opened.georeference.horizontal = Some(1.0);
    Ok(opened)
}

/// Where the scanner of a PTX stood: its position, which is where the matrix moves the origin to. Programs that write only one of
/// the two leave the other 0; `None` where both are there and differ.
fn station(position: &[f64], pose: &Pose) -> Option<[f64; 3]> {
    let stated: [f64; 3] = std::array::from_fn(|axis| position[axis]);
    let moved = pose.apply([0.0; 3]);
    let near = |a: f64, b: f64| (a - b).abs() <= 0.001 + 1e-6 * b.abs();
    if !stated.iter().all(|v| v.is_finite()) {
        return None;
    }
    match (stated == [0.0; 3], moved == [0.0; 3]) {
        (true, _) => Some(moved),
        // Points in common coordinates already.
        (_, true) => Some(stated).filter(|_| *pose == Pose::IDENTITY),
        _ => (0..3).all(|axis| near(stated[axis], moved[axis])).then_some(moved),
    }
}

/// The numbers of the next row, at least `least` of them.
fn numbers(lines: &mut Lines<'_>, least: usize) -> Result<Vec<f64>> {
    let line = lines.row()?.unwrap_or_default();
    let text = String::from_utf8_lossy(&line);
    let words = text.split([' ', '\t', ',', '\r']).filter(|word| !word.is_empty());
    let numbers: Option<Vec<f64>> = words.map(|word| word.parse().ok()).collect();
    match numbers.filter(|numbers| numbers.len() >= least) {
        Some(numbers) => Ok(numbers),
        None => Err(lines.expected(&format!("{least} numbers of the header of a cloud"), &line)),
    }
}
