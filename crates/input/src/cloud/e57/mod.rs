//! E57 (ASTM E2807): any number of clouds, cartesian or spherical, each with a pose.
//!
//! Points lie in packets of up to 64 KiB, each with a part of every column; a column is one bit stream across all
//! packets. Opening visits the packet headers and records where every 65,536th point begins ([`Mark`]), so any number
//! of threads can decode one cloud. The checksum of every page that is read is verified.
//!
//! The crate `e57` is not used: it decodes a cloud only from its first packet on, buffers a column without bound if
//! another lags behind, and takes 16 bytes per value of a column. The tests use it as oracle and writer.
//!
//! Memory per piece: the bits of its points in the needed columns, at most 2 MiB, and a packet. Memory per file: its
//! XML (up to 16 MiB, while it is opened) and 96 bytes per 65,536 points.
//!
//! Source: ASTM E2807-11, and libE57Format where the standard is silent.

mod bits;
mod description;
mod pages;

use super::values::{SAMPLE_PLACES, SAMPLE_POINTS, Sample, Scale};
use super::{Cloud, Depth, Opened, Opening, Piece, Pose, Source, Standpoint, Taker, loss_unless_absent};
use crate::colour::ColourSource;
use crate::crs::Georeference;
use crate::diagnostics::without_path;
use crate::text::counted;
use crate::{Error, Parameter, Result};
use bits::Bits;
use description::{CHANNELS, Column, Contents, Description, Kind, Limits, MOST_BYTES, Undescribed, Wrong};
use pages::{PAGE, Pages, logical, physical};

/// Points per piece.
const PIECE_POINTS: u64 = 1 << 16;
/// Maximum number of columns for positions: three coordinates, their state, and one that counts points.
const NEEDED: usize = 5;
/// Maximum including those for values: four, and two that mark these as invalid.
const ALL: usize = NEEDED + 6;

/// A needed column.
#[derive(Debug, Clone, Copy)]
struct Needed {
    /// Index among all columns.
    number: usize,
    kind: Kind,
    bits: u64,
}

/// Start of a piece: its first packet (logical offset), and the bytes of each needed column before that packet.
#[derive(Debug, Clone, Copy)]
struct Mark {
    packet: u64,
    before: [u64; ALL],
}

/// One cloud.
#[derive(Debug)]
struct Scan {
    name: String,
    records: u64,
    columns: usize,
    /// Needed columns; the first `of_place` of them give the position.
    needed: Vec<Needed>,
    of_place: usize,
    rgb: Option<Values<3>>,
    intensity: Option<Values<1>>,
    spherical: bool,
    has_state: bool,
    pose: Option<Pose>,
    station: Option<[f64; 3]>,
    marks: Vec<Mark>,
}

/// Columns of values, as indices into the needed ones; their limits; and the column that marks invalid values.
#[derive(Debug, Clone, Copy)]
struct Values<const N: usize> {
    at: [usize; N],
    limits: [Limits; N],
    invalid: Option<usize>,
}

impl<const N: usize> Values<N> {
    /// Returns all of its columns.
    fn columns(&self) -> impl Iterator<Item = usize> {
        self.at.into_iter().chain(self.invalid)
    }

    /// Returns the columns without limits.
    fn open(&self) -> Vec<usize> {
        let open = self.at.into_iter().zip(self.limits).filter(|(_, limits)| *limits == Limits::Unstated);
        open.map(|(column, _)| column).collect()
    }

    /// Sets the limits of columns without.
    fn settle(&mut self, found: Limits) {
        self.limits.iter_mut().filter(|limits| **limits == Limits::Unstated).for_each(|limits| *limits = found);
    }
}

#[derive(Debug)]
struct E57 {
    scans: Vec<Scan>,
    stated: u64,
    depth: Depth,
}

/// How to read the values of one source from the columns returned by [`Scan::gather`].
struct Channel {
    at: Vec<(usize, Scale)>,
    invalid: Option<usize>,
}

impl Channel {
    #[inline]
    fn value(&self, columns: &[Bits], number: usize) -> Option<[u16; 3]> {
        if self.invalid.is_some_and(|invalid| columns[invalid].value(number) != 0.0) {
            return None;
        }
        let mut value = [0; 3];
        for (value, (column, scale)) in value.iter_mut().zip(&self.at) {
            *value = scale.of(columns[*column].value(number));
        }
        Some(value)
    }
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes[at..at + 8].iter().rev().fold(0, |sum, &byte| sum << 8 | u64::from(byte))
}

pub(super) fn open(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    let bytes = opening.bytes;
    let header = opening.source.bytes_at(0, bytes.min(48) as usize)?.unwrap_or_default();
    if header.len() < 48 || &header[..8] != b"ASTM-E57" {
        return Err(
            opening.error("byte 0", "expected \"ASTM-E57\" and a header of 48 bytes: this is no E57 file, or cut")
        );
    }
    let version = (u64_at(&header, 8) as u32, u64_at(&header, 8) >> 32);
    let (length, xml_at, xml_len, page) =
        (u64_at(&header, 16), u64_at(&header, 24), u64_at(&header, 32), u64_at(&header, 40));
    let path = opening.source.path();
    if version.0 != 1 || page != PAGE {
        return Err(unsupported(
            path,
            format!("E57 of version {}.{} with pages of {page} bytes", version.0, version.1),
        ));
    }
    if length > bytes {
        let reason = format!("the header states {length} bytes, the file has {bytes}: it is cut; fetch it again");
        return Err(opening.error("header, byte 16", reason));
    }
    check_length(opening, length)?;
    if xml_len > MOST_BYTES {
        return Err(Error::limit(format!("bytes of the XML of {}", path.display()), xml_len, MOST_BYTES));
    }
    let mut pages = Pages::new(opening.source, bytes);
    // Verifies the first page, too: the header is part of it.
    pages.read(&mut [0; 48], 0, false)?;
    let xml_at = logical(xml_at).filter(|at| at.checked_add(xml_len).is_some_and(|end| end <= pages.len()));
    let Some(xml_at) = xml_at else {
        return Err(opening.error("header, byte 24", "its XML would lie behind the end: the file is cut or damaged"));
    };
    let mut xml = vec![0; xml_len as usize];
    pages.read(&mut xml, xml_at, true)?;
    let xml =
        String::from_utf8(xml).map_err(|_| opening.error("XML", "it is not text in UTF-8; write the file again"))?;
    let error_of = |wrong: Wrong| match wrong {
        Wrong::Damaged(at, reason) => Error::input(path, at, reason),
        Wrong::Unsupported(what) => unsupported(path, what),
    };
    let contents = Contents::parse(&xml).map_err(error_of)?;
    drop(xml);
    if contents.clouds.is_empty() && contents.images > 0 {
        let reason = format!("it holds {} images and no cloud of points; export the scans themselves", contents.images);
        return Err(opening.error("data3D", reason));
    }
    let (mut scans, mut stated) = (Vec::with_capacity(contents.clouds.len()), 0u64);
    let (others, mut left_out) = (contents.clouds.len() > 1, None);
    for cloud in contents.clouds {
        let points = cloud.as_ref().map_or_else(|wrong| wrong.points, |cloud| cloud.records);
        stated = stated.saturating_add(points);
        let scan = cloud.map_err(|Undescribed { wrong, .. }| error_of(wrong));
        match scan.and_then(|cloud| Scan::open(cloud, &mut pages, opening)) {
            Ok(scan) => scans.push(scan),
            Err(error @ (Error::Input { .. } | Error::Unsupported { .. })) if others => {
                if !opening.findings.allow_incomplete {
                    return Err(error.with_suggestion(Parameter::Incomplete));
                }
                let text = format!("{} left out: {error}", counted(points, "point"));
                opening.findings.lose_points(points, text)?;
                left_out = Some(error);
            }
            Err(error) => return Err(error),
        }
    }
    if let Some(error) = left_out.filter(|_| scans.is_empty()) {
        return Err(error);
    }
    let mut georeference = contents.system.map(Georeference::of_text).unwrap_or_default();
    georeference.take_metres();
    Ok(Opened { georeference, ..Opened::new(E57 { scans, stated, depth: Depth::Sixteen }) })
}

/// Checks that nothing but zeros follows the `length` bytes that the header states; 0: not filled in.
fn check_length(opening: &mut Opening<'_, '_>, length: u64) -> Result<()> {
    let mut block = [0; 4096];
    let mut at = if length == 0 { opening.bytes } else { length };
    while at < opening.bytes {
        if opening.monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let got = opening.source.read_at(&mut block, at)?;
        if block[..got].iter().any(|&byte| byte != 0) {
            let text = format!("the header states {length} bytes, the file has {}", opening.bytes);
            return opening.findings.lose(text);
        }
        if got == 0 {
            break;
        }
        at += got as u64;
    }
    Ok(())
}

fn unsupported(path: &std::path::Path, what: String) -> Error {
    Error::Unsupported {
        what: format!("{}: {what}", path.display()),
        version: env!("CARGO_PKG_VERSION"),
        suggestion: "write it with another program, bit packed, as cartesian or spherical points".into(),
    }
}

/// Header of a packet: its length, and whether it holds points.
struct Packet {
    len: u64,
    is_data: bool,
}

impl Scan {
    fn open(cloud: Description, pages: &mut Pages<'_>, opening: &mut Opening<'_, '_>) -> Result<Self> {
        let Description { name, at, records, columns, pose, station, .. } = &cloud;
        let (name, at, records, pose, station) = (name.clone(), *at, *records, *pose, *station);
        let find = |wanted: &str| columns.iter().position(|column| column.name == wanted);
        let all = |wanted: [&str; 3]| Some([find(wanted[0])?, find(wanted[1])?, find(wanted[2])?]);
        let cartesian =
            all(["cartesianX", "cartesianY", "cartesianZ"]).map(|axes| (axes, find("cartesianInvalidState")));
        let spherical = || {
            let axes = all(["sphericalRange", "sphericalAzimuth", "sphericalElevation"])?;
            Some((axes, find("sphericalInvalidState")))
        };
        let is_spherical = cartesian.is_none();
        let mut scan = Self {
            name,
            records: 0,
            columns: columns.len(),
            needed: Vec::new(),
            of_place: 0,
            rgb: None,
            intensity: None,
            spherical: is_spherical,
            has_state: false,
            pose,
            station,
            marks: Vec::new(),
        };
        if records == 0 {
            scan.check_empty(at, columns, pages, opening)?;
            return Ok(scan);
        }
        let Some((axes, state)) = cartesian.or_else(spherical) else {
            let reason = "it has neither cartesian nor spherical coordinates; export the scans with coordinates";
            return Err(opening.error(scan.name, reason));
        };
        scan.has_state = state.is_some();
        let need =
            |number: usize| Needed { number, kind: columns[number].kind, bits: columns[number].kind.bits().into() };
        scan.needed = axes.into_iter().chain(state).map(need).collect();
        if scan.needed.iter().all(|column| column.bits == 0) {
            // Columns without bits do not show the number of points; another column has to.
            let Some(counting) = (0..columns.len()).map(need).find(|column| column.bits > 0) else {
                return Err(opening.error(scan.name, format!("none of its columns has any bits for {records} points")));
            };
            scan.needed.push(counting);
        }
        scan.of_place = scan.needed.len();
        let mut values = |names: &[&str], invalid: &str| {
            let columns = names.iter().map(|name| find(name)).collect::<Option<Vec<_>>>()?;
            let begin = scan.needed.len();
            scan.needed.extend(columns.iter().chain(&find(invalid)).map(|&column| need(column)));
            let invalid = find(invalid).map(|_| begin + columns.len());
            Some((begin, columns, invalid))
        };
        scan.rgb = values(&CHANNELS[..3], "isColorInvalid").map(|(begin, columns, invalid)| Values {
            at: [0, 1, 2].map(|channel| begin + channel),
            limits: [0, 1, 2].map(|channel| cloud.limits(channel, columns[channel])),
            invalid,
        });
        scan.intensity = values(&CHANNELS[3..], "isIntensityInvalid").map(|(begin, columns, invalid)| Values {
            at: [begin],
            limits: [cloud.limits(3, columns[0])],
            invalid,
        });
        for (place, &Needed { number, kind, bits }) in scan.needed.iter().enumerate() {
            let column = &columns[number].name;
            if columns.iter().filter(|other| other.name == *column).count() > 1 {
                let reason = format!("it has the column {column} more than once; write it once");
                return Err(opening.error(scan.name.clone(), reason));
            }
            let is_flat = matches!(kind, Kind::Integer { scale, .. } if scale == 0.0);
            if is_flat && bits > 0 && place < scan.of_place {
                let reason = format!("the scale of {column} is 0; expected another number; write the file again");
                return Err(opening.error(scan.name.clone(), reason));
            }
        }
        let per_point: u64 = columns.iter().map(|column| u64::from(column.kind.bits())).sum();
        scan.index(at, records, per_point, pages, opening)?;
        Ok(scan)
    }

    fn error(&self, source: &Source, at: u64, reason: impl Into<String>) -> Error {
        Error::input(source.path(), format!("{}, byte {}", self.name, physical(at)), reason)
    }

    /// Visits the packets and records where pieces begin. `per_point`: bits per point in all columns.
    fn index(
        &mut self,
        at: u64,
        records: u64,
        per_point: u64,
        pages: &mut Pages<'_>,
        opening: &mut Opening<'_, '_>,
    ) -> Result<()> {
        let source = opening.source;
        let Some(section) = logical(at).filter(|&section| section < pages.len()) else {
            return Err(
                opening.error(self.name.clone(), format!("its points would begin at byte {at}, beyond the file"))
            );
        };
        let mut head = [0; 32];
        pages.read(&mut head, section, false)?;
        let data = logical(u64_at(&head, 16)).filter(|&data| data >= section && data < pages.len());
        let (1, Some(data)) = (head[0], data) else {
            let reason = format!("expected a section of points (1), found {}, or its data lie outside", head[0]);
            return Err(self.error(source, section, reason));
        };
        // Some writers do not fill in the length of the section.
        let stated = u64_at(&head, 8);
        let stated_end = Some(section.saturating_add(stated)).filter(|&end| data < end && end <= pages.len());
        if stated > 0 && stated_end.is_none() {
            let (least, most) = (data - section, pages.len() - section);
            let reason = format!(
                "{}: its section states {stated} bytes, expected more than {least} and at most {most}",
                self.name
            );
            opening.findings.lose(reason)?;
        }
        let end = stated_end.unwrap_or(pages.len());
        // In a sound file, the columns of the same points are at most this far apart.
        let apart = (PIECE_POINTS * per_point / 8 + (4 << 20)) * 2;
        let (mut packet, mut before) = (data, [0u64; ALL]);
        let mut number = 0u64;
        let mut lens = Vec::new();
        // Number of points whose whole position has been seen.
        let mut held = 0;
        let mut damage = String::new();
        // Columns of colours and of intensities, and whether they lie too far behind the points to be collected.
        let of_values = [
            self.rgb.iter().flat_map(Values::columns).collect::<Vec<_>>(),
            self.intensity.iter().flat_map(Values::columns).collect(),
        ];
        let mut are_far = [false; 2];
        while packet < end && self.lags(&before, records) {
            if number.is_multiple_of(1024) && opening.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            number += 1;
            let Packet { len, is_data } = match self.head(pages, source, packet, &mut lens) {
                Ok(packet) => packet,
                // Only values are missing; the check of the rest reports the damage.
                Err(Error::Input { .. }) if held == records => break,
                // The points before the damage are complete.
                Err(error @ Error::Input { .. }) if held > 0 && opening.findings.allow_incomplete => {
                    damage = format!("; {}", without_path(error));
                    break;
                }
                Err(error) => return Err(error),
            };
            if is_data {
                let mut after = before;
                for (after, column) in after.iter_mut().zip(&self.needed) {
                    *after += u64::from(lens[column.number]);
                }
                // A piece begins in the packet with the first byte of its first point.
                loop {
                    let first = self.marks.len() as u64 * PIECE_POINTS;
                    let begins = |(column, &after): (&Needed, &u64)| {
                        column.bits > 0 && u128::from(after) > u128::from(first) * u128::from(column.bits) / 8
                    };
                    if first >= records || !self.needed.iter().zip(&after).any(begins) {
                        break;
                    }
                    self.marks.push(Mark { packet, before });
                }
                before = after;
                let whole = |column: usize| {
                    let (bytes, bits) = (u128::from(before[column]), u128::from(self.needed[column].bits));
                    (bits > 0).then(|| (bytes * 8 / bits).min(records.into()) as u64)
                };
                // True if the first points that are not whole began too long ago.
                let is_far = |held: u64| {
                    let mark = self.marks.get((held / PIECE_POINTS) as usize).filter(|_| held < records);
                    mark.is_some_and(|mark| packet - mark.packet > apart)
                };
                held = (0..self.of_place).filter_map(whole).min().unwrap_or(0);
                for (are_far, columns) in are_far.iter_mut().zip(&of_values) {
                    *are_far |= columns.iter().filter_map(|&column| whole(column)).min().is_some_and(is_far);
                }
                if is_far(held) {
                    let reason =
                        format!("columns of the same points lie more than {apart} bytes apart; write the file again");
                    return Err(self.error(source, packet, reason));
                }
            }
            packet += len;
        }
        if held == records
            && let Some(end) = stated_end
        {
            let needed = self.needed[..self.of_place].iter().zip(before);
            let mut columns: Vec<_> = needed.map(|(column, bytes)| (column.number, column.bits, bytes)).collect();
            self.check_rest((packet, end), records, &mut columns, pages, opening)?;
        }
        if held < records {
            let text = format!("{}: it states {records} points, its packets hold {held} whole ones{damage}", self.name);
            opening.findings.lose_points(records - held, text)?;
        }
        self.records = held;
        // Values may end before the points do.
        let lacks = |at: usize| u128::from(before[at]) * 8 < u128::from(held) * u128::from(self.needed[at].bits);
        let [rgb, intensity] = [("colours", 0), ("intensities", 1)].map(|(what, group): (&str, usize)| {
            let reason = match of_values[group].iter().any(|&column| lacks(column)) {
                true => format!("it holds fewer {what} than points"),
                false if are_far[group] => format!("its {what} lie more than {apart} bytes behind the points"),
                false => return true,
            };
            opening.findings.note(format!("{}: {reason}; they are not used", self.name));
            false
        });
        self.rgb = self.rgb.filter(|_| rgb);
        self.intensity = self.intensity.filter(|_| intensity);
        self.marks.truncate(held.div_ceil(PIECE_POINTS) as usize);
        self.marks.shrink_to_fit();
        Ok(())
    }

    /// Returns whether a needed column has fewer bytes than `records` points take.
    fn lags(&self, before: &[u64; ALL], records: u64) -> bool {
        let lags =
            |(column, &bytes): (&Needed, &u64)| u128::from(bytes) * 8 < u128::from(records) * u128::from(column.bits);
        self.needed.iter().zip(before).any(lags)
    }

    /// Checks that a cloud of 0 points has no packets with points.
    fn check_empty(
        &self,
        at: u64,
        columns: &[Column],
        pages: &mut Pages<'_>,
        opening: &mut Opening<'_, '_>,
    ) -> Result<()> {
        // Writers of empty clouds leave offsets and lengths unset.
        let Some(section) = logical(at).filter(|&section| section + 32 < pages.len()) else { return Ok(()) };
        let mut head = [0; 32];
        pages.read(&mut head, section, false)?;
        let end = section.saturating_add(u64_at(&head, 8));
        let data = logical(u64_at(&head, 16)).filter(|&data| data >= section && data < end && end <= pages.len());
        let (1, Some(data)) = (head[0], data) else { return Ok(()) };
        match self.head(pages, opening.source, data, &mut Vec::new()) {
            Err(Error::Input { .. }) => return Ok(()),
            first => first?,
        };
        let bits = columns.iter().map(|column| u64::from(column.kind.bits()));
        let mut columns: Vec<_> = bits.enumerate().map(|(number, bits)| (number, bits, 0)).collect();
        self.check_rest((data, end), 0, &mut columns, pages, opening)
    }

    /// Visits the packets behind the last needed one: they must end where the section does, and all packets together
    /// must hold at most `records` points. `columns`: number, bits per point and bytes in the packets before.
    fn check_rest(
        &self,
        (mut packet, end): (u64, u64),
        records: u64,
        columns: &mut [(usize, u64, u64)],
        pages: &mut Pages<'_>,
        opening: &mut Opening<'_, '_>,
    ) -> Result<()> {
        let (mut lens, mut number, mut damage) = (Vec::new(), 0u64, None);
        while packet < end {
            if number.is_multiple_of(1024) && opening.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            number += 1;
            match self.head(pages, opening.source, packet, &mut lens) {
                Ok(Packet { len, is_data }) => {
                    if is_data {
                        columns.iter_mut().for_each(|(number, _, bytes)| *bytes += u64::from(lens[*number]));
                    }
                    packet += len;
                }
                Err(error @ Error::Input { .. }) => {
                    damage = Some(error);
                    break;
                }
                Err(error) => return Err(error),
            }
        }
        // Writers fill the last word of a column, of up to 64 bits, with zeros.
        let surplus = |&(_, bits, bytes): &(usize, u64, u64)| {
            let word = [1, 2, 4].into_iter().find(|word| bits <= 8 * word).unwrap_or(8);
            let most = (u128::from(records) * u128::from(bits)).div_ceil(8).next_multiple_of(word.into());
            (bits > 0 && u128::from(bytes) > most).then(|| u128::from(bytes) * 8 / u128::from(bits))
        };
        if let Some(held) = columns.iter().filter_map(surplus).min() {
            let text = format!("{}: it states {records} points, its packets hold {held} whole ones", self.name);
            let more = u64::try_from(held - u128::from(records)).unwrap_or(u64::MAX);
            return opening.findings.lose_points(more, text);
        }
        if packet != end {
            let (end, found) = (physical(end), physical(packet));
            let damage = damage.map(|error| format!("; {}", without_path(error))).unwrap_or_default();
            let text =
                format!("{}: its section should end at byte {end}, its packets end at byte {found}{damage}", self.name);
            return opening.findings.lose(text);
        }
        Ok(())
    }

    /// Reads the header of the packet at a logical offset; for a packet with points, fills `lens` with the bytes per
    /// column.
    fn head(&self, pages: &mut Pages<'_>, source: &Source, at: u64, lens: &mut Vec<u16>) -> Result<Packet> {
        let mut head = [0; 6];
        pages.read(&mut head[..4], at, false)?;
        let len = u64::from(u16_at(&head, 2)) + 1;
        if !len.is_multiple_of(4) || head[0] > 2 {
            let reason = format!(
                "expected a packet of type 0 to 2 whose length divides by 4, found type {} and {len} bytes; fetch or write \
                 the file again",
                head[0]
            );
            return Err(self.error(source, at, reason));
        }
        if head[0] != 1 {
            return Ok(Packet { len, is_data: false });
        }
        pages.read(&mut head, at, false)?;
        let count = usize::from(u16_at(&head, 4));
        if count != self.columns || len < 6 + 2 * count as u64 {
            let reason = format!("a packet of {count} columns and {len} bytes; expected {} columns", self.columns);
            return Err(self.error(source, at, reason));
        }
        let mut table = [0; 2048];
        let table = &mut table[..2 * count];
        pages.read(table, at + 6, false)?;
        lens.clear();
        lens.extend(table.as_chunks().0.iter().map(|&bytes| u16::from_le_bytes(bytes)));
        let sum: u64 = lens.iter().map(|&len| u64::from(len)).sum();
        if 6 + 2 * count as u64 + sum > len {
            let reason = format!("a packet of {len} bytes with columns of {sum}: it is damaged; fetch the file again");
            return Err(self.error(source, at, reason));
        }
        Ok(Packet { len, is_data: true })
    }

    /// Returns which needed columns hold values of `source`, and how to convert them; `None` if the cloud has none.
    fn channel(&self, source: ColourSource, depth: Depth) -> Option<(Vec<usize>, Channel)> {
        let (at, limits, invalid) = match source {
            ColourSource::Rgb => self.rgb.map(|v| (v.at.to_vec(), v.limits.to_vec(), v.invalid)),
            ColourSource::Intensity => self.intensity.map(|v| (v.at.to_vec(), v.limits.to_vec(), v.invalid)),
            ColourSource::Class => None,
        }?;
        let scale = |limits: &Limits| match limits {
            Limits::Between(scale) => *scale,
            Limits::Bytes if source == ColourSource::Rgb && depth == Depth::Eight => Scale::BYTES,
            Limits::Bytes => Scale::between(0.0, 255.0).unwrap_or(Scale::BYTES),
            Limits::Unstated => Scale::between(0.0, 1.0).unwrap_or(Scale::WHOLE),
        };
        let places = (self.of_place..).zip(&limits).map(|(place, limits)| (place, scale(limits))).collect();
        let channel = Channel { at: places, invalid: invalid.map(|_| self.of_place + at.len()) };
        Some((at.into_iter().chain(invalid).collect(), channel))
    }

    /// Samples points to find the range of colours or intensities without limits.
    fn look(&mut self, of: ColourSource, source: &Source) -> Result<()> {
        let values = match of {
            ColourSource::Rgb => self.rgb.map(|values| (values.open(), values.invalid)),
            ColourSource::Intensity => self.intensity.map(|values| (values.open(), values.invalid)),
            ColourSource::Class => None,
        };
        let Some((open, invalid)) = values.filter(|(open, _)| !open.is_empty()) else { return Ok(()) };
        let wanted: Vec<usize> = open.iter().copied().chain(invalid).collect();
        let mut pages = Pages::new(source, source.stamp().len());
        let mut sample = Sample::NOTHING;
        let places = SAMPLE_PLACES.min(self.records.div_ceil(SAMPLE_POINTS as u64));
        for place in 0..places {
            let first = (u128::from(self.records) * u128::from(place) / u128::from(places)) as u64;
            let end = self.records.min(first + SAMPLE_POINTS as u64);
            let piece = Piece { points: end - first, part: 0, first, end };
            // Damage is reported when the points are read in full.
            let columns = match self.gather(&piece, &wanted, &mut pages, source) {
                Err(Error::Input { .. }) => continue,
                columns => columns?,
            };
            let values = columns.get(self.of_place..).and_then(|values| values.split_at_checked(open.len()));
            let (numbers, invalid) = values.unwrap_or_default();
            let is_valid = |number: &usize| invalid.iter().all(|invalid| invalid.value(*number) == 0.0);
            for number in (0..(end - first) as usize).filter(is_valid) {
                numbers.iter().for_each(|column| sample.add(column.value(number)));
            }
        }
        if of == ColourSource::Rgb {
            let limits = Limits::of((0.0, sample.white())).unwrap_or(Limits::Unstated);
            self.rgb.iter_mut().for_each(|values| values.settle(limits));
        } else {
            self.intensity.iter_mut().for_each(|values| values.settle(Limits::Between(sample.intensity())));
        }
        Ok(())
    }

    /// Collects the bits of the points in `piece` for the columns of the position, followed by the needed columns with
    /// the indices `wanted`.
    fn gather(&self, piece: &Piece, wanted: &[usize], pages: &mut Pages<'_>, source: &Source) -> Result<Vec<Bits>> {
        let Some(mark) = self.marks.get((piece.first / PIECE_POINTS) as usize) else { return Ok(Vec::new()) };
        let chosen: Vec<usize> = (0..self.of_place).chain(wanted.iter().copied()).collect();
        let columns: Vec<&Needed> = chosen.iter().map(|&number| &self.needed[number]).collect();
        let mut bits: Vec<Bits> = columns.iter().map(|column| Bits::of(column, piece)).collect();
        let mut at = mark.packet;
        let mut before: Vec<u64> = chosen.iter().map(|&number| mark.before[number]).collect();
        let (mut lens, mut content) = (Vec::new(), Vec::new());
        while bits.iter().any(|bits| !bits.is_full()) {
            let Packet { len, is_data } = self.head(pages, source, at, &mut lens)?;
            // Packets are read whole and in order, so that their checksums are verified.
            content.resize(len as usize, 0);
            pages.read(&mut content, at, true)?;
            if is_data {
                for ((bits, column), before) in bits.iter_mut().zip(&columns).zip(&mut before) {
                    let skip: usize = lens[..column.number].iter().map(|&len| usize::from(len)).sum();
                    let begin = 6 + 2 * self.columns + skip;
                    let own = &content[begin..begin + usize::from(lens[column.number])];
                    bits.take(own, *before);
                    *before += own.len() as u64;
                }
            }
            at += len;
        }
        Ok(bits)
    }
}

/// Converts range, azimuth and elevation.
#[inline]
fn cartesian(at: [f64; 3]) -> [f64; 3] {
    let [range, azimuth, elevation] = at;
    let across = range * libm::cos(elevation);
    let moved = [across * libm::cos(azimuth), across * libm::sin(azimuth), range * libm::sin(elevation)];
    loss_unless_absent(at, moved)
}

impl Cloud for E57 {
    fn format(&self) -> &'static str {
        "E57"
    }

    fn points_stated(&self) -> u64 {
        self.stated
    }

    fn points_expected(&self) -> u64 {
        self.scans.iter().map(|scan| scan.records).fold(0, u64::saturating_add)
    }

    fn pieces(&self) -> Box<dyn Iterator<Item = Piece> + Send + '_> {
        Box::new(self.scans.iter().enumerate().flat_map(|(part, scan)| {
            (0..scan.records.div_ceil(PIECE_POINTS)).map(move |number| {
                let first = number * PIECE_POINTS;
                let end = scan.records.min(first + PIECE_POINTS);
                Piece { points: end - first, part, first, end }
            })
        }))
    }

    fn has_values(&self, source: ColourSource) -> bool {
        self.scans.iter().any(|scan| scan.channel(source, self.depth).is_some())
    }

    fn prepare(&mut self, source: ColourSource, file: &Source) -> Result<()> {
        self.scans.iter_mut().try_for_each(|scan| scan.look(source, file))?;
        let all_bytes = self.scans.iter().filter_map(|scan| scan.rgb).all(|rgb| rgb.limits == [Limits::Bytes; 3]);
        self.depth = if all_bytes { Depth::Eight } else { Depth::Sixteen };
        Ok(())
    }

    fn depth(&self) -> Depth {
        self.depth
    }

    fn decode(&self, piece: &Piece, source: &Source, _: &mut Vec<u8>, taker: &mut Taker<'_>) -> Result<u64> {
        let Some(scan) = self.scans.get(piece.part) else { return Ok(0) };
        taker.begin_cloud(piece.part)?;
        let mut pages = Pages::new(source, source.stamp().len());
        let (wanted, channel) = taker.wanted().and_then(|source| scan.channel(source, self.depth)).unzip();
        let columns =
            scan.gather(piece, &wanted.unwrap_or_default(), &mut pages, source).map_err(|error| match error {
                Error::Input { path, at, reason, .. } if !at.starts_with(&scan.name) => {
                    Error::input(path, format!("{}, {at}", scan.name), reason)
                }
                other => other,
            })?;
        let [a, b, c, rest @ ..] = &columns[..] else { return Ok(0) };
        let state = rest.first().filter(|_| scan.has_state);
        // Ranges are short.
        let is_single = [0, 1, 2].map(|axis| !scan.spherical && scan.needed[axis].kind == Kind::Single);
        for number in 0..(piece.end - piece.first) as usize {
            if state.is_some_and(|state| state.value(number) != 0.0) {
                taker.absent()?;
                continue;
            }
            let mut at = [a.value(number), b.value(number), c.value(number)];
            if scan.spherical {
                at = cartesian(at);
            }
            taker.note_singles(at, is_single);
            let value = channel.as_ref().and_then(|channel| channel.value(&columns, number));
            taker.push(scan.pose.map_or(at, |pose| pose.apply(at)), None, value)?;
        }
        Ok(0)
    }

    fn state(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for scan in &self.scans {
            bytes.extend(scan.records.to_le_bytes());
            bytes.extend([u8::from(scan.spherical), u8::from(scan.has_state)]);
            bytes.extend(scan.marks.iter().flat_map(|mark| mark.packet.to_le_bytes()));
            bytes.extend(format!("{:?}", &scan.needed[..scan.of_place]).into_bytes());
            bytes.extend(scan.pose.iter().flat_map(Pose::bytes));
        }
        bytes
    }

    fn standpoints(&self) -> Vec<Standpoint> {
        let of_scan = |scan: &Scan| match scan.station {
            _ if scan.records == 0 => Standpoint::Needless,
            Some(at) => Standpoint::At(at),
            None => Standpoint::Unknown(format!("{} has no pose", scan.name)),
        };
        self.scans.iter().map(of_scan).collect()
    }
}
