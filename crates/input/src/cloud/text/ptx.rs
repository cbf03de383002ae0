//! PTX: clouds with a header of ten lines each.
//!
//! Columns, rows, four lines about the scanner, four rows of a matrix `M`; a point is `(x y z 1) · M`, and `0 0 0` means
//! no return. Source: "Leica PTX / PTS format" as Cyclone writes it.

use super::decision::{Beginning, Custom, decide, most_frequent};
use super::layout::{Places, RowLayout, Separator};
use super::lines::Lines;
use super::{LOOKED_AT, Rows, Segment, begin, check_clouds, text_layout, whole_word};
use crate::cloud::values::{Channels, Kind};
use crate::cloud::{Opened, Opening, Pose};
use crate::number::decimal;
use crate::{Error, Result};

/// Number of rows that show the width of a cloud.
const SHOWN_ROWS: usize = 9;

/// Header of a cloud in a PTX.
struct PtxHead {
    points: u64,
    pose: Pose,
    station: Option<[f64; 3]>,
    /// True if its numbers have decimal commas.
    decimal_comma: bool,
}

/// Reads the columns and rows of the next cloud in a PTX; if `may_seek`, skips lines until they come.
fn ptx_size(lines: &mut Lines<'_>, may_seek: bool) -> Result<Option<[u64; 2]>> {
    let mut columns = None;
    while let Some(line) = lines.row()? {
        match (columns, whole_word(&line)) {
            (Some(columns), Some(rows)) => return Ok(Some([columns, rows])),
            (None, Some(count)) => columns = Some(count),
            (_, None) if may_seek => columns = None,
            (None, None) => return Err(lines.expected("the number of columns of a cloud", &line)),
            (Some(_), None) => return Err(lines.expected("the number of rows of a cloud", &line)),
        }
    }
    match columns {
        Some(_) if !may_seek => Err(lines.expected("the number of rows of a cloud", b"")),
        _ => Ok(None),
    }
}

fn ptx_head(lines: &mut Lines<'_>, [columns, rows]: [u64; 2]) -> Result<PtxHead> {
    let (position, mut decimal_comma) = numbers(lines, 3)?;
    for _ in 0..3 {
        decimal_comma |= numbers(lines, 3)?.1;
    }
    let mut matrix = [[0.0; 3]; 4];
    for (number, row) in matrix.iter_mut().enumerate() {
        let (line, has_comma) = numbers(lines, 4)?;
        decimal_comma |= has_comma;
        row.copy_from_slice(&line[..3]);
        if line[3] != if number == 3 { 1.0 } else { 0.0 } {
            return Err(lines.error(format!("expected a matrix with the last column 0 0 0 1, found {}", line[3])));
        }
    }
    let pose = Pose(matrix);
    if !pose.is_finite() {
        return Err(lines.error("the matrix has numbers that are not finite"));
    }
    let points = columns.saturating_mul(rows);
    if points > 0 && pose.is_flat() {
        return Err(lines.error("the matrix is singular: it puts all points in one plane, on one line or at one place"));
    }
    let station = station(&position, &pose);
    Ok(PtxHead { points, pose, station, decimal_comma })
}

/// Opens PTX: clouds with a header of ten lines each.
pub(in crate::cloud) fn open_ptx(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    let (mut lines, packing) = begin(opening)?;
    let (mut segments, mut stated, mut sample, mut decimal_comma) = (Vec::new(), 0u64, Vec::new(), false);
    // `sampled`: the cloud of the sample.
    let (mut may_seek, mut number, mut sampled) = (false, 0, 0);
    loop {
        let size = match ptx_size(&mut lines, may_seek) {
            Err(Error::Input { at, reason, .. }) if opening.findings.allow_incomplete => {
                opening.findings.lose(format!("{at}: {reason}; rows up to the next cloud are left out"))?;
                may_seek = true;
                continue;
            }
            size => size?,
        };
        let Some(size) = size else { break };
        number += 1;
        let head = match ptx_head(&mut lines, size) {
            Err(Error::Input { at, reason, .. }) if opening.findings.allow_incomplete => {
                let points = size[0].saturating_mul(size[1]);
                stated = stated.saturating_add(points);
                let text = format!("cloud {number} of {points} points is left out: {at}: {reason}");
                opening.findings.lose_points(points, text)?;
                may_seek = true;
                continue;
            }
            head => head?,
        };
        may_seek = false;
        let PtxHead { points, pose, station, .. } = head;
        decimal_comma |= head.decimal_comma;
        let start = lines.position();
        let (found, first) = lines.keep_rows(points, true, (LOOKED_AT, |row| !is_absent(row)), opening.monitor)?;
        stated = stated.saturating_add(points);
        if found < points {
            let text = format!("cloud {number}: its header states {points} points, {found} lines follow");
            opening.findings.lose_points(points - found, text)?;
        }
        let pose = Some(pose).filter(|pose| *pose != Pose::IDENTITY);
        check_clouds(segments.len(), opening)?;
        segments.push((Segment { pose, station, ..Segment::plain(start, lines.position(), found) }, typical(&first)));
        // Rows without a return do not show decimal commas.
        if !first.is_empty() && sample.iter().all(|row: &Vec<u8>| is_absent(row)) {
            (sample, sampled) = (first, segments.len() - 1);
        }
    }
    let mut layout = RowLayout::new(Custom::Ptx.places(7), Separator::Blanks, decimal_comma);
    if !sample.is_empty() {
        let beginning = Beginning { separator: None, comments: &[], header: None, rows: &sample };
        let decided = decide(&beginning, None, Custom::Ptx).map_err(|refusal| opening.error("rows", refusal.reason))?;
        let has_points = sample.iter().any(|row| row.contains(&b'.'));
        let decimal_comma = decided.layout.decimal_comma() || decimal_comma && !has_points;
        layout = RowLayout::new(decided.places, decided.layout.separator(), decimal_comma);
    }
    // Intensity alone, with colours, or neither; clouds may differ in that.
    let cells = |row: Option<Vec<u8>>| {
        let cells = row.and_then(|row| layout.separator().cells(&row).ok().map(|cells| cells.len()));
        cells.filter(|&cells| cells >= 3)
    };
    let segments: Vec<Segment> =
        segments.into_iter().map(|(segment, first)| Segment { cells: cells(first), ..segment }).collect();
    let places = Custom::Ptx.places(7);
    let channels = Channels::new(Some(Kind::Custom), Some(Kind::Any));
    let rows = Rows { segments, zero_is_absent: true, stated, ..Rows::empty("PTX", packing, layout, channels) };
    let first = rows.segments.get(sampled);
    let point = |row: &[u8]| {
        let (at, class) = rows.layout.parse(row, None).ok()?;
        rows.point(first?, (at, class, ())).map(|(at, _, ())| at)
    };
    let has = |cells: usize| first.and_then(|first| first.cells).is_some_and(|found| found >= cells);
    let shown = Places { rgb: places.rgb.filter(|_| has(7)), intensity: places.intensity.filter(|_| has(4)), ..places };
    let text = text_layout(&rows.layout, &shown, &[], &sample, point);
    let mut opened = Opened { text: Some(text), ..Opened::new(rows) };
    // By convention: Cyclone writes metres.
    (opened.georeference.horizontal, opened.georeference.vertical) = (Some(1.0), Some(1.0));
    Ok(opened)
}

/// Returns the words of a row, whatever separates them.
fn words(row: &[u8]) -> impl Iterator<Item = &[u8]> {
    let is_gap = |byte: &u8| byte.is_ascii_whitespace() || matches!(byte, b',' | b';');
    row.split(is_gap).filter(|word| !word.is_empty())
}

/// Returns whether a row begins with `0 0 0`: it has no return.
fn is_absent(row: &[u8]) -> bool {
    words(row).take(3).all(|word| decimal(word, false) == Some(0.0))
}

/// Returns one of the rows that show the width of a cloud: the first rows with a return, most of which are whole. Rows
/// without a return may end before the colours.
fn typical(rows: &[Vec<u8>]) -> Option<Vec<u8>> {
    let mut shown = rows.iter().filter(|row| !is_absent(row)).take(SHOWN_ROWS);
    let width = most_frequent(shown.clone().map(|row| words(row).count()));
    shown.find(|row| words(row).count() == width).cloned()
}

/// Returns the scanner position of a PTX cloud: the stated position, which should be where the matrix moves the origin.
/// Programs that write only one of the two leave the other 0; `None` if both are present and differ.
fn station(position: &[f64], pose: &Pose) -> Option<[f64; 3]> {
    let stated: [f64; 3] = std::array::from_fn(|axis| position[axis]);
    let moved = pose.apply([0.0; 3]);
    let near = |a: f64, b: f64| (a - b).abs() <= 0.001 + 1e-6 * b.abs();
    if !stated.iter().all(|v| v.is_finite()) {
        return None;
    }
    match (stated == [0.0; 3], moved == [0.0; 3]) {
        (true, _) => Some(moved),
        // The points are in common coordinates already.
        (_, true) => Some(stated).filter(|_| *pose == Pose::IDENTITY),
        _ => (0..3).all(|axis| near(stated[axis], moved[axis])).then_some(moved),
    }
}

/// Parses the numbers of the next row, at least `least` of them; also returns whether they have decimal commas.
fn numbers(lines: &mut Lines<'_>, least: usize) -> Result<(Vec<f64>, bool)> {
    let line = lines.row()?.unwrap_or_default();
    let text = String::from_utf8_lossy(&line);
    let words: Vec<&str> = text.split_ascii_whitespace().collect();
    // As many words as numbers expected, some with a comma inside: these are decimal commas.
    let has_comma = |word: &&str| word.contains(',');
    let is_decimal = words.len() == least
        && words.iter().any(has_comma)
        && !words.iter().any(|word| word.ends_with(',') || word.contains('.'));
    let numbers: Option<Vec<f64>> = match is_decimal {
        true => words.iter().map(|word| word.replace(',', ".").parse().ok()).collect(),
        false => {
            let words = words.iter().flat_map(|word| word.split([',', ';'])).filter(|word| !word.is_empty());
            words.map(|word| word.parse().ok()).collect()
        }
    };
    match numbers.filter(|numbers| numbers.len() >= least) {
        Some(numbers) => Ok((numbers, is_decimal)),
        None => Err(lines.expected(&format!("{least} numbers of the header of a cloud"), &line)),
    }
}
