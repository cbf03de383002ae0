//! Clouds written byte by byte, with what their headers may state besides the usual: every point is read once, or its
//! loss is reported.

use super::Standpoint;
use crate::colour::ColourSource;
use crate::{Error, InputOptions, InputSet, Monitor, PointCounts, PointDecoder, Warning};
use std::io::Write;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Collects warnings, and cancels from the call of this number on.
struct Listener {
    cancels_at: u64,
    calls: AtomicU64,
    said: Mutex<Vec<String>>,
}

impl Listener {
    fn new(cancels_at: u64) -> Self {
        Self { cancels_at, calls: AtomicU64::new(0), said: Mutex::default() }
    }
}

impl Monitor for Listener {
    fn warn(&self, warning: &Warning) {
        self.said.lock().unwrap().push(warning.to_string());
    }

    fn cancelled(&self) -> bool {
        self.calls.fetch_add(1, Ordering::Relaxed) >= self.cancels_at
    }
}

#[derive(Debug)]
struct Found {
    points: Vec<[f64; 3]>,
    /// Values of the points, where they have some.
    values: Vec<Option<[u16; 3]>>,
    counts: PointCounts,
    stated: u64,
    missing: u64,
    said: String,
    format: &'static str,
    standpoints: Vec<Standpoint>,
}

fn read_with(name: &str, bytes: &[u8], options: InputOptions) -> Result<Found, Error> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    let listener = Listener::new(u64::MAX);
    let set = InputSet::open(&[path], options, &listener)?;
    let file = &set.files()[0];
    let (format, stated, standpoints) = (file.format(), file.points_stated(), file.standpoints());
    let (mut decoder, mut counts) = (PointDecoder::new(), PointCounts::default());
    let (mut points, mut values) = (Vec::new(), Vec::new());
    for chunk in set.chunks() {
        counts += decoder.decode(&set, &chunk, &mut |batch| {
            points.extend((0..batch.len()).map(|n| [batch.x[n], batch.y[n], batch.z[n]]));
            values.extend((0..batch.len()).map(|n| batch.values.get(n).copied()));
            Ok(())
        })?;
    }
    set.check_complete(&listener)?;
    let (missing, said) = (set.points_missing(), listener.said.lock().unwrap().join("\n"));
    Ok(Found { points, values, counts, stated, missing, said, format, standpoints })
}

fn read(name: &str, bytes: &[u8]) -> Result<Found, Error> {
    read_with(name, bytes, InputOptions::default())
}

/// Reads what is left of an incomplete file.
fn read_rest(name: &str, bytes: &[u8]) -> Result<Found, Error> {
    read_with(name, bytes, InputOptions { allow_incomplete: true, ..InputOptions::default() })
}

fn coloured(name: &str, bytes: &[u8], source: ColourSource) -> Result<Found, Error> {
    read_with(name, bytes, InputOptions { colour: Some(source), ..InputOptions::default() })
}

/// Checks that a file is refused with `words`; if incomplete input is allowed, `left` points are read, `missing` are
/// counted as such, and the same words are a warning.
#[track_caller]
fn is_incomplete(name: &str, bytes: &[u8], words: &str, left: usize, missing: u64) {
    let said = read(name, bytes).unwrap_err().to_string();
    assert!(said.contains(words), "{words}: {said}");
    let found = read_rest(name, bytes).unwrap();
    assert!(found.said.contains("incomplete") && found.said.contains(words), "{words}: {}", found.said);
    assert_eq!((found.points.len(), found.missing + found.counts.missing), (left, missing), "{words}");
}

/// Checks that a file is refused with `words`, even if incomplete input is allowed.
#[track_caller]
fn is_refused(name: &str, bytes: &[u8], words: &str) {
    for found in [read(name, bytes), read_rest(name, bytes)] {
        let said = found.map(|found| found.points.len()).unwrap_err().to_string();
        assert!(said.contains(words), "{words}: {said}");
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// Lines of blanks, `bytes` bytes or a few more.
fn blank_lines(bytes: usize) -> String {
    format!("{}\n", " ".repeat(60_000)).repeat(bytes.div_ceil(60_001))
}

/// Bytes per page of an E57, and those of its content.
const PAGE: usize = 1024;
const CONTENT: usize = PAGE - 4;
/// Offsets of the section of points and of its packets, on the first page.
const SECTION: u64 = 48;
const PACKETS: u64 = SECTION + 32;

/// An E57 of one section of points, with these packets and these clouds.
fn e57(packets: &[Vec<u8>], clouds: &[String]) -> Vec<u8> {
    let packets = packets.concat();
    let clouds = clouds.concat();
    let xml = format!("<e57Root><data3D>{clouds}</data3D></e57Root>");
    let section = [1, 32 + packets.len() as u64, PACKETS, 0].map(u64::to_le_bytes);
    let xml_at = (PACKETS as usize + packets.len()) as u64;
    let len = (xml_at as usize + xml.len()).next_multiple_of(CONTENT);
    let physical = |at: u64| at / CONTENT as u64 * PAGE as u64 + at % CONTENT as u64;
    let header = [1, physical(len as u64), physical(xml_at), xml.len() as u64, PAGE as u64].map(u64::to_le_bytes);
    let mut content =
        [&b"ASTM-E57"[..], header.as_flattened(), section.as_flattened(), &packets[..], xml.as_bytes()].concat();
    content.resize(len, 0);
    content.chunks(CONTENT).flat_map(|page| [page, &crc32c::crc32c(page).to_be_bytes()].concat()).collect()
}

/// Changes bytes on the first page of an E57, and its checksum.
fn edited(file: &[u8], at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut file = file.to_vec();
    file[at..at + bytes.len()].copy_from_slice(bytes);
    let sum = crc32c::crc32c(&file[..CONTENT]).to_be_bytes();
    file[CONTENT..PAGE].copy_from_slice(&sum);
    file
}

/// The description of a cloud whose section of points lies at a physical offset.
fn cloud_at(at: u64, records: u64, columns: &str) -> String {
    format!(
        "<vectorChild><points fileOffset=\"{at}\" recordCount=\"{records}\"><prototype>{columns}</prototype></points>\
         </vectorChild>"
    )
}

fn cloud(records: u64, columns: &str) -> String {
    cloud_at(SECTION, records, columns)
}

/// A packet of points with these parts of the columns.
fn packet(columns: &[&[u8]]) -> Vec<u8> {
    let parts = columns.concat();
    let len = (6 + 2 * columns.len() + parts.len()).next_multiple_of(4);
    let head = [1, len as u16 - 1, columns.len() as u16];
    let lens = columns.iter().map(|part| part.len() as u16);
    let mut bytes: Vec<u8> = head.into_iter().chain(lens).flat_map(u16::to_le_bytes).collect();
    bytes.extend(parts);
    bytes.resize(len, 0);
    bytes
}

/// A packet without points, which readers ignore.
const IGNORED: [u8; 4] = [2, 0, 3, 0];

fn singles(numbers: impl IntoIterator<Item = f32>) -> Vec<u8> {
    numbers.into_iter().flat_map(f32::to_le_bytes).collect()
}

const AXES: &str = "<cartesianX type=\"Float\" precision=\"single\"/><cartesianY type=\"Float\" precision=\"single\"/>\
                    <cartesianZ type=\"Float\" precision=\"single\"/>";

/// Packets of `count` points, with these parts of further columns.
fn packed_points(count: usize, others: &[&[u8]]) -> Vec<u8> {
    let x = singles((0..count).map(|n| n as f32));
    let still = singles(vec![2.0; count]);
    let axes: [&[u8]; 3] = [&x, &still, &still];
    packet(&[&axes[..], others].concat())
}

/// The points of [`packed_points`].
fn line_of_points(count: usize) -> Vec<[f64; 3]> {
    (0..count).map(|n| [n as f64, 2.0, 2.0]).collect()
}

#[test]
fn columns_of_an_e57_may_lag_and_be_constant_with_other_packets_between() {
    let x = singles([1.0, 2.0, 3.0, 4.0, 5.0]);
    let y = singles([10.0, 20.0, 30.0, 40.0, 50.0]);
    let single = |axis: &str| format!("<cartesian{axis} type=\"Float\" precision=\"single\"/>");
    let constant = |axis: &str| format!("<cartesian{axis} type=\"Integer\" minimum=\"7\" maximum=\"7\"/>");
    let columns = [single("X"), single("Y"), constant("Z")].concat();
    let lagging =
        [packet(&[&x, &[], &[]]), IGNORED.to_vec(), packet(&[&[], &y[..8], &[]]), packet(&[&[], &y[8..], &[]])];
    let found = read("a.e57", &e57(&lagging, &[cloud(5, &columns)])).unwrap();
    assert_eq!(found.points, [1.0, 2.0, 3.0, 4.0, 5.0].map(|v| [v, 10.0 * v, 7.0]));
    assert_eq!(found.format, "E57");
    // Another column shows that the points are there.
    let columns = ["X", "Y", "Z"].map(constant).concat();
    let counted = format!("{columns}<rowIndex type=\"Integer\" minimum=\"0\" maximum=\"255\"/>");
    let rows = [packet(&[&[], &[], &[], &[0, 1, 2, 3, 4]])];
    assert_eq!(read("a.e57", &e57(&rows, &[cloud(5, &counted)])).unwrap().points, [[7.0; 3]; 5]);
    is_incomplete("a.e57", &e57(&rows, &[cloud(9, &counted)]), "it states 9 points, its packets hold 5", 5, 4);
    let none = e57(&[packet(&[&[], &[], &[]])], &[cloud(5, &columns)]);
    is_refused("a.e57", &none, "none of its columns has any bits for 5 points");
}

#[test]
fn places_that_an_e57_states_must_lie_in_it() {
    let good = e57(&[packed_points(3, &[])], &[cloud(3, AXES)]);
    assert_eq!(read("a.e57", &good).unwrap().points, line_of_points(3));
    let behind = (good.len() as u64).to_le_bytes();
    is_refused("a.e57", &edited(&good, 24, &behind), "its XML would lie behind the end");
    let cut = edited(&good, 16, &500u64.to_le_bytes());
    is_refused("a.e57", &cut[..500], "byte 0: the file ends there: it has 0 pages");
    let packets = [packed_points(3, &[])];
    // The head of the section would reach beyond the last page.
    let last = good.len() as u64 - 20;
    let near_end = e57(&packets, &[cloud_at(last, 3, AXES)]);
    assert_eq!(near_end.len(), good.len());
    is_refused("a.e57", &near_end, "the file ends there");
    is_refused("a.e57", &e57(&packets, &[cloud_at(0, 3, AXES)]), "expected a section of points (1), found 65");
    // If no cloud is left, allowing incomplete input changes nothing.
    is_refused("a.e57", &e57(&packets, &[cloud_at(0, 3, AXES), cloud_at(0, 2, AXES)]), "found 65");
    // Writers of clouds without points may leave out their place.
    let found = read("a.e57", &e57(&packets, &[cloud_at(1 << 40, 0, AXES), cloud(3, AXES)])).unwrap();
    assert_eq!(found.points, line_of_points(3));
    assert_eq!(found.standpoints[0], Standpoint::Needless);
    assert!(matches!(&found.standpoints[1], Standpoint::Unknown(why) if why.contains("has no pose")));
}

#[test]
fn zeros_after_an_e57_are_padding_and_its_length_may_be_unset() {
    let good = e57(&[packed_points(3, &[])], &[cloud(3, AXES)]);
    let padded = [&good[..], &[0; 9000]].concat();
    let unset = edited(&good, 16, &[0; 8]);
    for bytes in [&padded, &unset] {
        let found = read("a.e57", bytes).unwrap();
        assert_eq!(found.points, line_of_points(3));
        assert!(!found.said.contains("bytes"), "{}", found.said);
    }
    let mut more = padded.clone();
    more[good.len() + 8999] = 1;
    is_incomplete("a.e57", &more, "bytes, the file has", 3, 0);
}

#[test]
fn points_before_the_damage_of_an_e57_are_kept() {
    let broken = [packed_points(3, &[]), vec![9, 0, 3, 0]];
    let file = e57(&broken, &[cloud(5, AXES)]);
    let said = read("a.e57", &file).unwrap_err().to_string();
    assert!(said.contains("expected a packet of type 0 to 2"), "{said}");
    let found = read_rest("a.e57", &file).unwrap();
    assert_eq!((found.points, found.missing), (line_of_points(3), 2));
    for words in ["it states 5 points, its packets hold 3 whole ones", "found type 9"] {
        assert!(found.said.contains(words), "{}", found.said);
    }
    // Values end before the points do.
    let number = |name: &str| format!("<{name} type=\"Integer\" minimum=\"0\" maximum=\"255\"/>");
    let columns = ["colorRed", "colorGreen", "colorBlue", "intensity"].map(number).concat();
    let packets = [packed_points(5, &[&[1, 2, 3, 4, 5], &[1, 2, 3, 4, 5], &[1, 2, 3], &[9]])];
    let file = e57(&packets, &[cloud(5, &format!("{AXES}{columns}"))]);
    let found = coloured("a.e57", &file, ColourSource::Rgb).unwrap();
    assert_eq!((found.points, found.values), (line_of_points(5), vec![None; 5]));
    for what in ["colours", "intensities"] {
        assert!(
            found.said.contains(&format!("it holds fewer {what} than points; they are not used")),
            "{}",
            found.said
        );
    }
}

#[test]
fn colours_of_an_e57_may_lie_behind_its_points_but_not_far() {
    let number = |name: &str| format!("<{name} type=\"Integer\" minimum=\"0\" maximum=\"255\"/>");
    let columns = [AXES.to_owned(), number("colorRed"), number("colorGreen"), number("colorBlue")].concat();
    let points = packed_points(3, &[&[], &[], &[]]);
    let colours = packet(&[&[], &[], &[], &[1, 2, 3], &[4, 5, 6], &[7, 8, 9]]);
    let of_packets = |packets: &[Vec<u8>]| {
        let found = coloured("a.e57", &e57(packets, &[cloud(3, &columns)]), ColourSource::Rgb).unwrap();
        assert_eq!(found.points, line_of_points(3));
        (found.values, found.said)
    };
    let (values, said) = of_packets(&[points.clone(), IGNORED.to_vec(), colours]);
    assert_eq!(values, [[1, 4, 7], [2, 5, 8], [3, 6, 9]].map(Some), "{said}");
    // To collect such colours, each piece of a large cloud would read on to its end.
    let ignored = [&[2u8, 0, 0xFF, 0xFF][..], &[0; (1 << 16) - 4]].concat();
    let parts = [&[1u8, 2][..], &[3]].map(|part| packet(&[&[], &[], &[], part, part, part]));
    let packets = [&[points][..], &vec![ignored; 160], &parts].concat();
    let (values, said) = of_packets(&packets);
    assert_eq!(values, [None; 3]);
    assert!(said.contains("its colours lie more than 10354688 bytes behind the points; they are not used"), "{said}");
}

#[test]
fn an_infinite_range_of_an_e57_is_a_loss_in_every_direction() {
    let columns = ["Range", "Azimuth", "Elevation"];
    let columns = columns.map(|of| format!("<spherical{of} type=\"Float\" precision=\"single\"/>")).concat();
    for angle in [0.0, 0.1] {
        let of_range = |range: f32| {
            let angles = singles([angle; 2]);
            e57(&[packet(&[&singles([1.0, range]), &angles, &angles])], &[cloud(2, &columns)])
        };
        is_incomplete("a.e57", &of_range(f32::INFINITY), "1 points have a coordinate that is not finite", 1, 0);
        let found = read("a.e57", &of_range(f32::NAN)).unwrap();
        assert_eq!((found.points.len(), found.counts.withheld), (1, 1), "{angle}");
    }
}

#[test]
fn values_of_an_e57_without_limits_are_read_by_their_range() {
    let column = |name: &str| format!("<{name} type=\"Float\" precision=\"single\"/>");
    let columns = format!("{AXES}{}", column("intensity"));
    // 0 to 1; those of Cyclone, which begin at -2048; others unchanged.
    for (numbers, expected) in [
        ([0.0, 0.5, 1.0], [0, 32_768, 65_535]),
        ([-2048.0, 0.0, 2047.0], [0, 32_768, 65_520]),
        ([3.0, 700.0, 40_000.0], [3, 700, 40_000]),
    ] {
        let file = e57(&[packed_points(3, &[&singles(numbers)])], &[cloud(3, &columns)]);
        let found = coloured("a.e57", &file, ColourSource::Intensity).unwrap();
        assert_eq!(found.values, expected.map(|value| Some([value, 0, 0])), "{numbers:?}");
    }
    // No point shows the range.
    let file = e57(&[IGNORED.to_vec()], &[cloud(3, &columns)]);
    let options =
        InputOptions { colour: Some(ColourSource::Intensity), allow_incomplete: true, ..InputOptions::default() };
    let found = read_with("a.e57", &file, options).unwrap();
    assert_eq!((found.points.len(), found.missing), (0, 3));
    // Damage is reported when the points are read.
    let mut file = e57(&[packed_points(400, &[&singles(vec![1.0; 400])])], &[cloud(400, &columns)]);
    file[2 * PAGE + 7] ^= 1;
    let said = coloured("a.e57", &file, ColourSource::Intensity).unwrap_err().to_string();
    assert!(said.contains("cloud 1, byte 2048") && said.contains("checksum"), "{said}");
    let columns = [AXES.to_owned(), column("colorRed"), column("colorGreen"), column("colorBlue")].concat();
    // Colours of 0 to 1, of 8 bits and of 16.
    for (rgb, expected) in [
        ([[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]], [[0, 32_768, 65_535], [65_535, 32_768, 0]]),
        ([[0.0, 255.0], [10.0, 20.0], [1.0, 2.0]], [[0, 10, 1], [255, 20, 2]]),
        ([[0.0, 256.0], [10.0, 20.0], [1.0, 2.0]], [[0, 10, 1], [256, 20, 2]]),
    ] {
        let rgb = rgb.map(singles);
        let file = e57(&[packed_points(2, &[&rgb[0], &rgb[1], &rgb[2]])], &[cloud(2, &columns)]);
        let found = coloured("a.e57", &file, ColourSource::Rgb).unwrap();
        assert_eq!(found.values, expected.map(Some));
    }
}

#[test]
fn the_range_of_e57_colours_shows_in_the_whole_cloud() {
    let number = |name: &str| format!("<{name} type=\"Float\" precision=\"single\"/>");
    let columns = [AXES.to_owned(), number("colorRed"), number("colorGreen"), number("colorBlue")].concat();
    let packets: Vec<Vec<u8>> = (0..5)
        .map(|part| {
            let colour = singles((0..1000).map(|n| if 1000 * part + n < 4096 { 0.0 } else { 200.0 }));
            packed_points(1000, &[&colour, &colour, &colour])
        })
        .collect();
    let found = coloured("a.e57", &e57(&packets, &[cloud(5000, &columns)]), ColourSource::Rgb).unwrap();
    assert_eq!((found.values[0], found.values[4999]), (Some([0; 3]), Some([200; 3])));
    // Invalid colours do not show it.
    let columns = format!("{columns}<isColorInvalid type=\"Integer\" minimum=\"0\" maximum=\"255\"/>");
    let colour = singles([900.0, 0.5]);
    let packets = [packed_points(2, &[&colour, &colour, &colour, &[1, 0]])];
    let found = coloured("a.e57", &e57(&packets, &[cloud(2, &columns)]), ColourSource::Rgb).unwrap();
    assert_eq!(found.values, [None, Some([32_768; 3])]);
}

#[test]
fn columns_of_an_e57_are_unique_and_no_scale_of_a_coordinate_is_0() {
    let axis =
        |axis: &str| format!("<cartesian{axis} type=\"ScaledInteger\" minimum=\"0\" maximum=\"255\" scale=\"0\"/>");
    let flat = e57(&[packet(&[&[1, 2], &[1, 2], &[1, 2]])], &[cloud(2, &["X", "Y", "Z"].map(axis).concat())]);
    is_refused("a.e57", &flat, "the scale of cartesianX is 0");
    let twice = format!("{AXES}<cartesianX type=\"Float\" precision=\"single\"/>");
    let twice = e57(&[packed_points(2, &[&singles([1.0; 2])])], &[cloud(2, &twice)]);
    is_refused("a.e57", &twice, "the column cartesianX more than once");
}

/// Name, type and bytes of a PCD's field of one number.
type PcdField<'a> = (&'a str, char, usize);

fn pcd_header(fields: &[PcdField<'_>], points: usize, data: &str) -> String {
    let list = |of: &dyn Fn(&PcdField<'_>) -> String| fields.iter().map(of).collect::<Vec<_>>().join(" ");
    let (names, sizes) = (list(&|field| field.0.to_owned()), list(&|field| field.2.to_string()));
    let types = list(&|field| field.1.to_string());
    format!(
        "VERSION 0.7\nFIELDS {names}\nSIZE {sizes}\nTYPE {types}\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA {data}\n"
    )
}

/// A PCD of rows of numbers.
fn pcd(fields: &[PcdField<'_>], rows: &[Vec<f64>], data: &str) -> Vec<u8> {
    let mut bytes = pcd_header(fields, rows.len(), data).into_bytes();
    let encoded = |(_, kind, size): PcdField<'_>, value: f64| match (kind, size) {
        ('F', 4) => (value as f32).to_le_bytes().to_vec(),
        ('F', _) => value.to_le_bytes().to_vec(),
        _ => (value as i64).to_le_bytes()[..size].to_vec(),
    };
    let column = |number: usize| rows.iter().flat_map(move |row| encoded(fields[number], row[number]));
    match data {
        "ascii" => bytes.extend(text_rows(rows, " ").bytes()),
        "binary" => {
            rows.iter().for_each(|row| fields.iter().zip(row).for_each(|(field, v)| bytes.extend(encoded(*field, *v))));
        }
        _ => {
            let plain: Vec<u8> = (0..fields.len()).flat_map(column).collect();
            // Literals only.
            let packed: Vec<u8> =
                plain.chunks(32).flat_map(|piece| [&[piece.len() as u8 - 1][..], piece].concat()).collect();
            bytes.extend((packed.len() as u32).to_le_bytes());
            bytes.extend((plain.len() as u32).to_le_bytes());
            bytes.extend(packed);
        }
    }
    bytes
}

fn text_rows(rows: &[Vec<f64>], separator: &str) -> String {
    let line = |row: &Vec<f64>| row.iter().map(f64::to_string).collect::<Vec<_>>().join(separator) + "\n";
    rows.iter().map(line).collect()
}

#[test]
fn coordinates_of_a_pcd_may_be_of_any_type() {
    for (kind, size) in
        [('I', 1), ('I', 2), ('I', 4), ('I', 8), ('U', 1), ('U', 2), ('U', 4), ('U', 8), ('F', 4), ('F', 8)]
    {
        let fields = ["x", "y", "z"].map(|name| (name, kind, size));
        let first = if kind == 'U' { 200.0 } else { -100.0 };
        let rows = [vec![first, 2.0, 3.0], vec![4.0, first, 6.0]];
        for data in ["ascii", "binary", "binary_compressed"] {
            let found = read("a.pcd", &pcd(&fields, &rows, data)).unwrap();
            assert_eq!(found.points, [[first, 2.0, 3.0], [4.0, first, 6.0]], "{kind} {size} {data}");
        }
    }
}

#[test]
fn packed_colours_of_a_pcd_may_be_negative() {
    let fields = [("x", 'F', 4), ("y", 'F', 4), ("z", 'F', 4), ("rgb", 'I', 4)];
    for data in ["ascii", "binary", "binary_compressed"] {
        let file = pcd(&fields, &[vec![1.0, 2.0, 3.0, f64::from(0xFF7F_7F7F_u32 as i32)]], data);
        assert_eq!(coloured("a.pcd", &file, ColourSource::Rgb).unwrap().values, [Some([127; 3])], "{data}");
    }
}

/// A PLY of columns x, y, z and others of other types.
fn ply(names: &[&str], types: &[&str], rows: &[Vec<f64>], binary: bool) -> Vec<u8> {
    let properties: String = names.iter().zip(types).map(|(name, kind)| format!("property {kind} {name}\n")).collect();
    let format = if binary { "binary_little_endian" } else { "ascii" };
    let count = rows.len();
    let mut bytes = format!("ply\nformat {format} 1.0\nelement vertex {count}\n{properties}end_header\n").into_bytes();
    if !binary {
        bytes.extend(text_rows(rows, " ").bytes());
        return bytes;
    }
    for row in rows {
        for (&value, &kind) in row.iter().zip(types) {
            match kind {
                "uchar" => bytes.push(value as u8),
                "ushort" => bytes.extend((value as u16).to_le_bytes()),
                _ => bytes.extend(value.to_le_bytes()),
            }
        }
    }
    bytes
}

#[test]
fn classes_and_values_are_those_of_the_rows_in_every_format() {
    let names = ["x", "y", "z", "class", "red", "green", "blue", "intensity"];
    let rows = [
        vec![1.0, 2.0, 3.0, 2.0, 10.0, 20.0, 30.0, 500.0],
        vec![4.0, 5.0, 6.0, 7.0, 40.0, 50.0, 60.0, 600.0],
        // No class is greater than 255.
        vec![7.0, 8.0, 9.0, 300.0, 70.0, 80.0, 90.0, 700.0],
    ];
    let fields = |rgb: usize| {
        names.map(|name| match name {
            "class" | "intensity" => (name, 'U', 2),
            "red" | "green" | "blue" => (name, 'U', rgb),
            _ => (name, 'F', 8),
        })
    };
    let types = ["double", "double", "double", "ushort", "uchar", "uchar", "uchar", "ushort"];
    let files = [
        ("a.pcd", "PCD", pcd(&fields(1), &rows, "ascii")),
        ("a.pcd", "PCD", pcd(&fields(1), &rows, "binary")),
        ("a.pcd", "PCD", pcd(&fields(1), &rows, "binary_compressed")),
        ("a.pcd", "PCD", pcd(&fields(4), &rows, "binary_compressed")),
        ("a.ply", "PLY", ply(&names, &types, &rows, false)),
        ("a.ply", "PLY", ply(&names, &types, &rows, true)),
        ("a.csv", "text", format!("{}\n{}", names.join(","), text_rows(&rows, ",")).into_bytes()),
    ];
    for (number, (name, format, bytes)) in files.iter().enumerate() {
        let values = |source| coloured(name, bytes, source).unwrap().values;
        let grey = |value: u16| Some([value, 0, 0]);
        assert_eq!(values(ColourSource::Class), [grey(2), grey(7), None], "{number}");
        assert_eq!(values(ColourSource::Intensity), [500, 600, 700].map(grey), "{number}");
        let rgb = [[10, 20, 30], [40, 50, 60], [70, 80, 90]].map(Some);
        assert_eq!(values(ColourSource::Rgb), rgb, "{number}");
        let options = InputOptions { exclude_classes: [7].into_iter().collect(), ..InputOptions::default() };
        let found = read_with(name, bytes, options).unwrap();
        assert_eq!((found.counts.excluded, found.format), (1, *format), "{number}");
        assert_eq!(found.points, [[1.0, 2.0, 3.0], [7.0, 8.0, 9.0]], "{number}");
        let unknown = format!("{format} does not say where the scanner stood");
        assert_eq!(found.standpoints, [Standpoint::Unknown(unknown)], "{number}");
    }
    // Intensities of 8 bits are not stretched, however small they are.
    let fields = [("x", 'F', 4), ("y", 'F', 4), ("z", 'F', 4), ("intensity", 'U', 1)];
    let file = pcd(&fields, &[vec![1.0, 2.0, 3.0, 0.0], vec![4.0, 5.0, 6.0, 1.0]], "binary");
    let found = coloured("a.pcd", &file, ColourSource::Intensity).unwrap();
    assert_eq!(found.values, [Some([0; 3]), Some([1, 0, 0])]);
}

#[test]
fn pcd_that_is_cut_damaged_or_too_wide() {
    let fields = [("intensity", 'F', 4), ("x", 'F', 4), ("y", 'F', 4), ("z", 'F', 4)];
    let rows = [vec![0.0, 1.0, 2.0, 3.0], vec![0.5, 4.0, 5.0, 6.0], vec![1.0, 7.0, 8.0, 9.0]];
    let binary = pcd(&fields, &rows, "binary");
    is_incomplete("a.pcd", &binary[..binary.len() - 3], "the file holds 2 whole ones", 2, 1);
    let packed = pcd(&fields, &rows, "binary_compressed");
    is_incomplete("a.pcd", &packed[..packed.len() - 3], "its compressed data have", 0, 3);
    for file in [&binary, &packed] {
        assert_eq!(read_rest("a.pcd", &file[..file.len() - 3]).unwrap().stated, 3);
    }
    let start = pcd_header(&fields, 3, "binary_compressed").len();
    is_refused("a.pcd", &packed[..start + 5], "the file ends before its data");
    // The first byte refers to bytes before the first.
    let mut damaged = packed.clone();
    damaged[start + 8] = 0xFF;
    for source in [ColourSource::Intensity, ColourSource::Rgb] {
        let said = coloured("a.pcd", &damaged, source).unwrap_err().to_string();
        assert!(said.contains("compressed data: LZF"), "{said}");
    }
    let sizes = [10u32, 16_000_000].map(u32::to_le_bytes);
    let bomb =
        [pcd_header(&fields, 1_000_000, "binary_compressed").as_bytes(), sizes.as_flattened(), &[0; 10]].concat();
    is_refused("a.pcd", &bomb, "10 compressed bytes cannot hold 16000000 unpacked ones");
    let many = vec![("x", 'F', 4usize); 1025];
    is_refused("a.pcd", pcd_header(&many, 1, "binary").as_bytes(), "1025 fields; at most 1024");
    let wide = pcd_header(&fields, 1, "binary").replacen("WIDTH", "COUNT 65536 1 1 1\nWIDTH", 1);
    is_refused("a.pcd", wide.as_bytes(), "a point of 262156 bytes; at most 65536");
}

/// A PLY of the points (1 2 3) and (4 5 6), with these elements before and behind them.
fn ply_between(format: &str, [before, behind]: [(&str, &[u8]); 2]) -> Vec<u8> {
    let (axes, vertex) = ("property float x\nproperty float y\nproperty float z\n", "element vertex 2\n");
    let header = format!("ply\nformat {format} 1.0\n{}{vertex}{axes}{}end_header\n", before.0, behind.0);
    let points = match format {
        "ascii" => b"1 2 3\n4 5 6\n".to_vec(),
        _ => singles([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
    };
    [header.as_bytes(), before.1, &points, behind.1].concat()
}

#[test]
fn elements_of_a_ply_around_its_points_hide_none_of_them() {
    const BINARY: &str = "binary_little_endian";
    let list = |count: usize, kind: &str| format!("element other {count}\nproperty list {kind} short n\n");
    let mixed = "element other 2\nproperty list uchar short n\nproperty int end\n";
    let ends = "the file ends within the element \"other\"";
    let none: (&str, &[u8]) = ("", &[]);
    // Sound elements.
    for (format, element) in [
        ("ascii", (mixed, &b"2 7 8 9\n0 9\n"[..])),
        ("ascii", (mixed, b"2\n7 8\n9\n0\n9\n")),
        (BINARY, (mixed, &[2, 7, 0, 8, 0, 9, 0, 0, 0, 0, 9, 0, 0, 0])),
    ] {
        for around in [[element, none], [none, element], [element, element]] {
            let found = read("a.ply", &ply_between(format, around)).unwrap();
            assert_eq!(found.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{format}: {around:?}");
            assert!(!found.said.contains("behind"), "{}", found.said);
        }
    }
    // Damaged or cut ones: before the points, these cannot be found; behind them, a warning says so.
    let lists = [list(2, "uchar"), list(1, "uchar"), list(1, "float")];
    let half = 2.5f32.to_le_bytes();
    for (format, element, words) in [
        ("ascii", (&lists[0][..], &b"x\n"[..]), "expected the length of a list, found \"x\""),
        ("ascii", (&lists[0], b"-1\n"), "expected the length of a list, found \"-1\""),
        (BINARY, (&lists[1], &[]), ends),
        (BINARY, (&lists[1], &[3, 7, 0]), ends),
        (BINARY, (&lists[2], &half), "a list of 2.5 numbers; expected 0 to 65536"),
    ] {
        let found = read("a.ply", &ply_between(format, [none, element])).unwrap();
        assert_eq!(found.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{words}");
        assert!(found.said.contains("behind its points") && found.said.contains(words), "{words}: {}", found.said);
    }
    for (format, element, words) in [
        ("ascii", (&lists[0][..], &b"x\n"[..]), "element \"other\": expected the length of a list, found \"x\""),
        (BINARY, (&lists[2], &half), "a list of 2.5 numbers; expected 0 to 65536"),
        (BINARY, ("element other 99\nproperty int end\n", b""), ends),
        ("ascii", ("element other 9\nproperty int a\nproperty int b\nproperty int c\n", b""), ends),
    ] {
        is_refused("a.ply", &ply_between(format, [element, none]), words);
    }
    // Fewer lines behind the points, none of them wrong.
    let found = read("a.ply", &ply_between("ascii", [none, (&lists[0], b"1 5\n")])).unwrap();
    assert!(found.points.len() == 2 && found.said.contains(ends), "{}", found.said);
    let listed = ply_between("ascii", [none, none]);
    let listed = String::from_utf8(listed).unwrap().replacen("property float z\n", "property list uchar int z\n", 1);
    is_refused("a.ply", listed.as_bytes(), "the element \"vertex\" has lists");
}

#[test]
fn rows_end_with_the_file_or_far_behind_blank_lines() {
    let header = |count: usize| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        )
    };
    is_incomplete("a.ply", format!("{}1 2 3\n4 5 6\n\n\n", header(3)).as_bytes(), "2 lines follow", 2, 1);
    is_incomplete("a.ply", header(3).as_bytes(), "the header states 3 points, 0 lines follow", 0, 3);
    // The second row lies behind the end of the first piece, which no row reaches.
    let rows = format!("1 2 3\n{}4 5 6\n", blank_lines(4 << 20));
    for (name, text) in [("a.ply", header(2) + &rows), ("a.xyz", rows.clone()), ("a.pts", format!("2\n{rows}"))] {
        let found = read(name, text.as_bytes()).unwrap();
        assert_eq!(found.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{name}");
    }
}

#[test]
fn rows_that_cannot_be_read_are_left_out_and_no_sample() {
    let text = format!("1 2 3\n{}\n4 5 6\n", "7".repeat(70_000));
    is_incomplete("a.xyz", text.as_bytes(), "line 2: a line of more than 65536 bytes", 2, 1);
    // The sample shows intensities from 0 to 1, although one row is wrong and the others come late.
    let text = format!("x,y,z,intensity\n1,2,3,0.5\n1,2,three,0.5\n{}4,5,6,1\n", blank_lines(3 << 19));
    is_incomplete("a.csv", text.as_bytes(), "line 3", 2, 1);
    let options =
        InputOptions { colour: Some(ColourSource::Intensity), allow_incomplete: true, ..InputOptions::default() };
    let found = read_with("a.csv", text.as_bytes(), options).unwrap();
    assert_eq!(found.values, [Some([32_768, 0, 0]), Some([65_535, 0, 0])]);
    let header =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let long = " ".repeat(70_000);
    for (rows, words) in [
        (format!("1 2 3\n4 5 6{long}\n7 8 9\n"), "line 9: a line of more than 65536 bytes"),
        (format!("1 2 3{long}\n4 5 6\n7 8 9\n"), "line 8: a line of more than 65536 bytes"),
        ("1 2 3\n4 five 6\n7 8 9\n".to_owned(), "line 9: value 2: expected a number, found \"five\""),
    ] {
        let text = format!("{header}{rows}");
        is_incomplete("a.ply", text.as_bytes(), words, 2, 1);
        let said = read("a.ply", text.as_bytes()).unwrap_err().to_string();
        assert!(said.contains("; fetch or write it again"), "{said}");
    }
    let fewer = format!("{}1 2 3\n4 5 6{long}\n7 8 9\n", header.replace("vertex 3", "vertex 4"));
    is_incomplete("a.ply", fewer.as_bytes(), "the header states 4 points, 3 lines follow", 2, 2);
    for name in ["a.ply.gz", "a.las.gz", "a.laz.zst"] {
        let said = read(name, &gzip(b"ply\n")).unwrap_err().to_string();
        assert!(said.contains("only text is read compressed"), "{name}: {said}");
    }
}

#[test]
fn the_first_row_of_a_table_may_have_empty_coordinates() {
    for text in [
        "x,y,z,i\n,,,0.5\n1,2,3,0.5\n",
        "x,y,z\n1,2,\n1,2,3\n",
        "x\ty\tz\n\t2.5\t\n1\t2\t3\n",
        "x;y;z\n;;7\n1;2;3\n",
        "# x,y,z,i\n,,,0.5\n1,2,3,0.5\n",
        "//X;Y;Z\n1;;\n1;2;3\n",
    ] {
        let found = read("a.csv", text.as_bytes()).unwrap();
        assert_eq!((&found.points[..], found.counts.withheld), (&[[1.0, 2.0, 3.0]][..], 1), "{text}");
    }
    let columns = InputOptions { columns: Some("name,x,y,z".parse().unwrap()), ..InputOptions::default() };
    let found = read_with("a.csv", b"scan,a,b,c\n0,,,\n1,1,2,3\n", columns).unwrap();
    assert_eq!((&found.points[..], found.counts.withheld), (&[[1.0, 2.0, 3.0]][..], 1));
    // A fault behind the names is that of a row.
    is_incomplete("a.csv", b"x,y,z\n1,2\n4,5,6\n7,8,9\n", "line 2: expected 3 columns, found 2", 2, 1);
}

#[test]
fn a_damaged_first_row_is_no_header() {
    let columns = Some("x,y,z".parse().unwrap());
    for (text, words) in [
        ("1 2 three\n4 5 6\n", "line 1: expected a number in column 3, found \"three\""),
        ("# a scan\n1 2\n4 5 6\n", "line 2: expected 3 columns or more, found 2"),
    ] {
        for (name, bytes) in [("a.xyz", text.as_bytes().to_vec()), ("a.xyz.gz", gzip(text.as_bytes()))] {
            let options = InputOptions { columns, ..InputOptions::default() };
            let said = read_with(name, &bytes, options).unwrap_err().to_string();
            assert!(said.contains(words), "{words}: {said}");
            let found = read_with(name, &bytes, InputOptions { allow_incomplete: true, ..options }).unwrap();
            assert_eq!((&found.points[..], found.counts.missing), (&[[4.0, 5.0, 6.0]][..], 1), "{text}");
            assert!(found.said.contains("1 row left out"), "{}", found.said);
        }
    }
    // Words are names, with or without a number among them.
    for text in ["a b c\n4 5 6\n", "2 rows follow\n4 5 6\n"] {
        let found = read_with("a.xyz", text.as_bytes(), InputOptions { columns, ..InputOptions::default() }).unwrap();
        assert_eq!(found.points, [[4.0, 5.0, 6.0]], "{text}");
    }
}

#[test]
fn a_first_line_may_state_the_separator() {
    for text in [
        "sep=;\nx;y;z\n1,5;2;3\n",
        "\"SEP=;\"\n1,5;2;3\n",
        "sep=,\nx,y,z\n1.5,2,3\n",
        "sep=\t\n1.5\t2\t3\n",
        // Semicolons separate numbers, too.
        "sep=,\n1.5,2,3,0;0;0;0\n",
    ] {
        assert_eq!(read("a.csv", text.as_bytes()).unwrap().points, [[1.5, 2.0, 3.0]], "{text}");
    }
    is_refused("a.csv", b"sep=;\n1,2,3\n", "expected three numbers, found \"1,2,3\"");
}

/// A PTX of a cloud of one column: what its header states, and rows.
fn ptx(count: usize, position: &str, last: [&str; 2], rows: &str) -> String {
    let [third, fourth] = last;
    format!("1\n{count}\n{position}\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 {third}\n{fourth} 1\n{rows}")
}

#[test]
fn clouds_of_a_ptx_may_be_empty_and_end_with_a_broken_header() {
    let rows = "1 2 3 0.5\n4 5 6 0.5\n";
    let good = ptx(2, "0 0 0", ["0", "0 0 0"], rows);
    let broken = ptx(1, "0 0 0", ["9", "0 0 0"], "7 8 9 0.5\n");
    for (name, bytes) in
        [("a.ptx", format!("{good}{broken}").into_bytes()), ("a.ptx.gz", gzip(format!("{good}{broken}").as_bytes()))]
    {
        let said = read(name, &bytes).unwrap_err().to_string();
        assert!(said.contains("a matrix with the last column 0 0 0 1"), "{said}");
        let found = read_rest(name, &bytes).unwrap();
        assert_eq!(found.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{name}");
        assert!(found.said.contains("cloud 2 of 1 points is left out"), "{}", found.said);
    }
    let empty = ptx(0, "0 0 0", ["0", "0 0 0"], "");
    let found = read("a.ptx", empty.as_bytes()).unwrap();
    assert_eq!((found.points.len(), found.standpoints), (0, vec![Standpoint::Needless]));
    let found = read("a.ptx", format!("{empty}{good}").as_bytes()).unwrap();
    assert_eq!(found.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    // A position that is not finite is unknown.
    let found = read("a.ptx", ptx(2, "inf 0 0", ["0", "3 2 1"], rows).as_bytes()).unwrap();
    assert_eq!(found.points, [[4.0, 4.0, 4.0], [7.0, 7.0, 7.0]]);
    assert!(matches!(&found.standpoints[..], [Standpoint::Unknown(why)] if why.contains("different places")));
    let words = ptx(2, "0 0 0", ["0", "0 0 0"], "a b c d\ne f g h\n");
    is_refused("a.ptx", words.as_bytes(), "rows: ");
    is_incomplete("a.ptx", ptx(3, "0 0 0", ["0", "0 0 0"], "1 2 3 0.5\n").as_bytes(), "3 points, 1 lines follow", 1, 2);
}

#[test]
fn the_first_row_of_a_ptx_may_have_no_return_and_another_width() {
    for rows in ["0 0 0 0.5\n1 2 3 0.5 10 20 30\n4 5 6 0.5 40 50 60\n", "0 0 0 0.5 0 0 0\n1 2 3 0.5\n4 5 6 0.5\n"] {
        let text = ptx(3, "0 0 0", ["0", "0 0 0"], rows);
        for clouds in [1, 2] {
            let found = read("a.ptx", text.repeat(clouds).as_bytes()).unwrap();
            assert_eq!(found.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]].repeat(clouds), "{rows}");
            assert_eq!(found.counts.withheld, clouds as u64, "{rows}");
        }
    }
    // Rows with a return must all have the same width.
    let mixed = ptx(3, "0 0 0", ["0", "0 0 0"], "0 0 0 0.5\n1 2 3 0.5 10 20 30\n4 5 6 0.5\n");
    is_incomplete("a.ptx", mixed.as_bytes(), "expected 7 columns, found 4", 1, 1);
    // However many rows have no return before these, and if the first of them is cut.
    let sky = "0 0 0 0.5\n".repeat(300);
    let cut = ptx(302, "0 0 0", ["0", "0 0 0"], &format!("{sky}1 2 3 0.5 10 20 30\n4 5 0.5 10 20 30\n"));
    is_incomplete("a.ptx", cut.as_bytes(), "expected 7 columns, found 6", 1, 1);
    let cut = ptx(3, "0 0 0", ["0", "0 0 0"], "1 2 0.5\n4 5 6 0.5\n7 8 9 0.5\n");
    is_incomplete("a.ptx", cut.as_bytes(), "expected 4 columns, found 3", 2, 1);
    // A single word begins the next cloud only if it is a whole number.
    let cut = ptx(3, "0 0 0", ["0", "0 0 0"], "1 2 3 0.5\n4.5\n7 8 9 0.5\n");
    is_incomplete("a.ptx", cut.as_bytes(), "expected 4 columns, found 1", 2, 1);
}

#[test]
fn clouds_of_a_ptx_without_returns_do_not_show_decimal_commas() {
    let cloud = |rows: &str| ptx(1, "0 0 0", ["0", "0 0 0"], rows);
    let text = [cloud("0 0 0 0\n"), cloud("1,5 2,5 3,5 0,5\n")].concat();
    let found = read("a.ptx", text.as_bytes()).unwrap();
    assert_eq!((&found.points[..], found.counts.withheld), (&[[1.5, 2.5, 3.5]][..], 1));
}

#[test]
fn a_cut_first_row_of_a_pts_does_not_take_the_others_with_it() {
    let text = b"4\n1 2 3 5\n4 5 6 5 1 2 3\n7 8 9 5 1 2 3\n1 1 1 5 1 2 3\n";
    is_incomplete("a.pts", text, "line 3: expected 4 columns, found 7", 3, 1);
    // Nor if it has the usual width.
    let text = b"2\n1 2 3 5\n4 5 6 5\n4\n1 2 3 5\n4 5 6 5 1 2 3\n7 8 9 5 1 2 3\n1 1 1 5 1 2 3\n";
    is_incomplete("a.pts", text, "line 6: expected 4 columns, found 7", 5, 1);
    // Two rows that became one do not take the others with them.
    let text = b"5\n1 2 3 5\n4 5 6 57 8 9 5\n1 1 1 5\n2 2 2 5\n";
    is_incomplete("a.pts", text, "line 3: expected 4 columns, found 7", 2, 3);
    // One row of another width does not end a cloud that differs from the first one.
    let text = b"2\n1 2 3 5 1 2 3\n4 5 6 5 1 2 3\n4\n1 2 3 5\n4 5 6 5\n4 5 6 5 1 2 3\n7 8 9 5\n";
    is_incomplete("a.pts", text, "line 7: expected 4 columns, found 7", 5, 1);
}

#[test]
fn clouds_of_a_pts_have_their_own_colours() {
    let rgb = Some([10, 20, 300]);
    for (text, values) in [
        (&b"1\n1 2 3 5\n1\n7 8 9 5 10 20 300\n"[..], [None, rgb]),
        (b"1\n1 2 3 5 10 20 300\n1\n7 8 9 5\n", [rgb, None]),
    ] {
        let found = coloured("a.pts", text, ColourSource::Rgb).unwrap();
        assert_eq!((found.points, &found.values[..]), (vec![[1.0, 2.0, 3.0], [7.0, 8.0, 9.0]], &values[..]));
        let found = coloured("a.pts", text, ColourSource::Intensity).unwrap();
        assert_eq!(found.values, [Some([5, 0, 0]); 2]);
    }
}

#[test]
fn e57_and_ptx_are_in_metres_whatever_system_is_given() {
    let text = ptx(2, "0 0 0", ["0", "0 0 0"], "1 2 3 0.5\n4 5 6 0.5\n");
    // Two systems with heights in feet, and one with all axes in feet.
    for code in [8700, 6360, 2277] {
        let options = InputOptions { epsg: Some(code), ..InputOptions::default() };
        let found = read_with("a.ptx", text.as_bytes(), options).unwrap();
        assert_eq!(found.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{code}");
        let found = read_with("a.e57", &e57(&[packed_points(2, &[])], &[cloud(2, AXES)]), options).unwrap();
        assert_eq!(found.points, line_of_points(2), "{code}");
    }
}

/// Opens a file and makes all checks that need its points, none of which are decoded here.
fn check_only(path: &Path, monitor: &dyn Monitor) -> Result<(), Error> {
    InputSet::open(&[path.to_path_buf()], InputOptions::default(), monitor)?.check_complete(monitor)
}

#[test]
fn rows_of_pieces_that_another_run_decoded_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pts");
    let long = "7".repeat(70_000);
    for (text, words) in [
        ("2\n1 2 3\n4 5 6\n".to_owned(), ""),
        ("2\n1 2 3\n4 5 6\n1\n7 8 9\n".into(), ""),
        (format!("3\n1 2 3\n{}4 5 6\n{long}\n", blank_lines(3 << 19)), ""),
        ("3\n1 2 3\n4 5 6\n".into(), "its first line states 3 points, 2 lines follow"),
        ("2\n1 2 3\n4 5 6\n2\n7 8 9\n".into(), "cloud 2: its first line states 2 points, 1 line follows"),
    ] {
        std::fs::write(&path, &text).unwrap();
        let listener = Listener::new(u64::MAX);
        match check_only(&path, &listener) {
            Ok(()) => assert_eq!(words, ""),
            Err(error) => assert!(!words.is_empty() && error.to_string().contains(words), "{words}: {error}"),
        }
    }
}

#[test]
fn rows_that_a_table_lacks_are_counted_once() {
    is_incomplete("a.xyz", b"5\n1 2 3\n4 5 6\n", "its first line states 5 points, 2 lines follow", 2, 3);
    let two = b"3\n1 2 3\n4\n4 5 6\n";
    is_incomplete("a.pts", two, "cloud 1: its first line states 3 points, 1 line follows", 2, 2 + 3);
    is_incomplete("a.pts", b"5\n", "its first line states 5 points, no lines follow", 0, 5);
    // Damage at the end of packed text and the count show the same loss.
    let rows: String = (0..20_000).map(|n| format!("{} 2 {}.5\n", n % 89, n % 97)).collect();
    let packed = gzip(format!("20000\n{rows}").as_bytes());
    let found = read_rest("a.xyz.gz", &packed[..packed.len() / 2]).unwrap();
    assert!(found.said.contains("cannot be unpacked") && found.counts.read > 0, "{}", found.said);
    assert_eq!(found.counts.read + found.counts.missing + found.missing, 20_000);
}

#[test]
fn rows_behind_the_point_where_a_sink_stopped_are_not_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pts");
    for (stated, is_sound) in [(3, true), (4, false)] {
        // The blank lines make the reader pause after the first row.
        let text = format!("{stated}\n1 2 3\n{}4 5 6\n7 8 9\n", blank_lines(3 << 19));
        std::fs::write(&path, text).unwrap();
        let listener = Listener::new(u64::MAX);
        let set = InputSet::open(std::slice::from_ref(&path), InputOptions::default(), &listener).unwrap();
        let stop = || {
            let chunk = set.chunks().next().unwrap();
            let stopped = PointDecoder::new().decode(&set, &chunk, &mut |_| Err(Error::Interrupted));
            assert!(matches!(stopped, Err(Error::Interrupted)), "{stopped:?}");
        };
        stop();
        assert_eq!(set.check_complete(&listener).is_ok(), is_sound, "{stated}");
        // A file that was read only in part is not read again to check it.
        stop();
        set.check_complete_of(&|_| false, &listener).unwrap();
    }
}

#[test]
fn opening_and_checking_can_be_cancelled_at_any_time() {
    let folder = tempfile::tempdir().unwrap();
    let list = "element other 2\nproperty list uchar short n\n";
    let around = |format: &str, bytes: &[u8]| ply_between(format, [(list, bytes), (list, bytes)]);
    let padded = |bytes: Vec<u8>| [&bytes[..], &[0; 200_000]].concat();
    let fields = ["x", "y", "z"].map(|name| (name, 'F', 4));
    let many: Vec<Vec<u8>> = std::iter::once(packed_points(3, &[])).chain(vec![IGNORED.to_vec(); 3000]).collect();
    for (name, bytes) in [
        ("a.e57", padded(e57(&many, &[cloud(3, AXES)]))),
        ("a.ply", around("ascii", b"1\n5\n0\n")),
        ("b.ply", padded(around("binary_little_endian", &[1, 5, 0, 0]))),
        ("a.pcd", padded(pcd(&fields, &[vec![1.0, 2.0, 3.0]], "binary"))),
        ("a.pts", format!("2\n1 2 3\n{}4 5 6\n", blank_lines(3 << 20)).into_bytes()),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let all = Listener::new(u64::MAX);
        check_only(&path, &all).unwrap();
        let calls = all.calls.into_inner();
        assert!(calls > 4, "{name}: asked {calls} times");
        for number in 0..calls {
            let outcome = check_only(&path, &Listener::new(number));
            assert!(matches!(outcome, Err(Error::Interrupted)), "{name}, call {number}: {outcome:?}");
        }
    }
}

#[test]
fn records_cut_off_after_opening_are_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let bytes = ply_between("binary_little_endian", [("", &[]), ("", &[])]);
    std::fs::write(&path, &bytes).unwrap();
    let listener = Listener::new(u64::MAX);
    let set = InputSet::open(std::slice::from_ref(&path), InputOptions::default(), &listener).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 5]).unwrap();
    let chunk = set.chunks().next().unwrap();
    let counts = PointDecoder::new().decode(&set, &chunk, &mut |_| Ok(())).unwrap();
    assert_eq!((counts.read, counts.missing), (1, 1));
    assert!(set.check_complete(&listener).is_err());
}
