//! Scan files as found in practice: the result of each of them, and of damage.
//!
//! Real files come from a folder outside the repository; tests that need it say so and pass if it is missing. Damaged
//! files are made here, from a few lines of bytes.

use crate::data;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use laz::laszip::{ChunkTable, ChunkTableEntry, LazVlr};
use laz::{LasZipCompressor, LazVlrBuilder};
use slicewalk::plan::Up;
use slicewalk::{Error, Monitor, NoMonitor, Result, Warning};
use slicewalk_input::spacing::estimate_spacing;
use slicewalk_input::{BATCH_POINTS, InputOptions, InputSet, PointChunk, PointCounts, PointDecoder, Units};

/// Collects warnings.
#[derive(Default)]
struct Heard(Mutex<Vec<String>>);

impl Monitor for Heard {
    fn warn(&self, warning: &Warning) {
        let text = warning.to_string();
        assert!(!text.contains('\n'));
        self.0.lock().unwrap().push(text);
    }
}

/// Result of reading a set of files.
#[derive(Debug, Default, Clone, PartialEq)]
struct Read {
    counts: PointCounts,
    points: Vec<[f64; 3]>,
    warnings: String,
}

impl Read {
    /// A sum over the bits of all coordinates in file order, like the reference script computes from laspy's arrays.
    fn sums(&self) -> [u64; 3] {
        [0, 1, 2]
            .map(|axis| self.points.iter().fold(0u64, |sum, p| sum.wrapping_mul(31).wrapping_add(p[axis].to_bits())))
    }

    fn sorted(&self) -> Vec<[u64; 3]> {
        let mut bits: Vec<_> = self.points.iter().map(|p| p.map(f64::to_bits)).collect();
        bits.sort_unstable();
        bits
    }
}

/// Reads as much as possible.
fn read(paths: &[PathBuf], options: InputOptions) -> Result<Read> {
    read_strictly(paths, InputOptions { allow_incomplete: true, ..options })
}

/// Reads everything, or fails.
fn read_strictly(paths: &[PathBuf], options: InputOptions) -> Result<Read> {
    let heard = Heard::default();
    let set = InputSet::open(paths, options, &heard)?;
    let mut all = Read::default();
    let mut decoder = PointDecoder::new();
    for chunk in set.chunks() {
        all.counts += decoder.decode(&set, &chunk, &mut |batch| {
            assert!(batch.len() <= BATCH_POINTS);
            assert!(batch.y.len() == batch.len() && batch.z.len() == batch.len());
            all.points.extend((0..batch.len()).map(|i| [batch.x[i], batch.y[i], batch.z[i]]));
            Ok(())
        })?;
    }
    assert_eq!(all.counts.kept(), all.points.len() as u64);
    set.check_complete(&heard)?;
    all.warnings = heard.0.into_inner().unwrap().join("\n");
    Ok(all)
}

fn read_one(path: &Path) -> Result<Read> {
    read(&[path.to_path_buf()], InputOptions::default())
}

fn refusal(path: &Path) -> String {
    let outcome = read_strictly(&[path.to_path_buf()], InputOptions::default());
    let text = outcome.map(|read| read.counts).expect_err("should be refused").to_string();
    assert!(!text.contains('\n') && text.starts_with(path.to_str().unwrap()), "{text}");
    text
}

// ---- real files -----------------------------------------------------------------------------------------------------

/// Points read, how many of these are withheld, and a word in the warnings.
const READABLE: &[(&str, u64, u64, &str)] = &[
    ("indoor_two_storey_zup.laz", 808_042, 0, ""),
    ("indoor_two_storey_yup.laz", 808_042, 0, ""),
    ("room_single_station.laz", 112_624, 0, ""),
    ("corridor_three_stations.laz", 239_668, 0, ""),
    ("pump_room.laz", 155_201, 0, ""),
    ("delft_city_block_ahn3.laz", 640_510, 0, ""),
    ("isprs_csite2_town.laz", 486_800, 0, ""),
    ("forest_plot_tls.laz", 114_024, 0, ""),
    ("autzen_stadium.laz", 10_653_336, 0, "no unit of length is stated"),
    ("odd/10_points_format_0.las", 10, 0, ""),
    ("odd/10_points_format_1.las", 10, 0, ""),
    ("odd/10_points_format_2.las", 10, 0, ""),
    ("odd/10_points_format_3.las", 10, 0, ""),
    ("odd/10_points_format_4.las", 10, 0, ""),
    ("odd/10_points_format_5.las", 10, 0, ""),
    ("odd/10_points_format_6.las", 10, 4, ""),
    ("odd/10_points_format_7.las", 10, 4, ""),
    ("odd/10_points_format_8.las", 10, 4, ""),
    ("odd/10_points_format_9.las", 10, 4, ""),
    ("odd/10_points_format_10.las", 10, 4, ""),
    ("odd/10_points_format_6.laz", 10, 4, ""),
    ("odd/10_points_format_10.laz", 10, 4, "records of 67 bytes, the LASzip record 38"),
    ("odd/10_points_with_extra_bytes_format_7.las", 10, 4, ""),
    ("odd/unregistered_extra_bytes.las", 4, 0, ""),
    ("odd/pdrf10-1.5.las", 1024, 483, ""),
    ("odd/pdrf10-1.5.laz", 1024, 483, ""),
    ("odd/pdrf7-v4-1.4.laz", 1024, 512, ""),
    ("odd/pdrf4-1.3.laz", 1024, 0, ""),
    ("odd/pdrf9-1.4.laz", 1024, 494, ""),
    ("odd/simple-laszip-compressor-version-1.2r0.laz", 1065, 0, ""),
    ("odd/laszip-generated_with2bytespadding.laz", 1065, 0, ""),
    ("odd/1.2-no-points.las", 0, 0, "states 1065 points, but none can be read"),
    ("odd/no-points.las", 0, 0, "holds no points"),
    ("odd/1.2-with-color-clipped.las", 1064, 0, "states 1065 points, the file holds 1064"),
    ("odd/bad_vlr_count.las", 10, 0, "3 records before the points, 2 fit"),
    ("odd/garbage_nVariableLength.las", 718, 0, "1069128089 records before the points, 0 fit"),
    ("odd/lots_of_vlr.las", 1, 0, ""),
    ("odd/bad-geotiff-keys.las", 10, 0, ""),
    ("odd/1.2-empty-geotiff-vlrs.las", 43, 0, ""),
    ("odd/gps-time-nan.las", 1, 0, ""),
    ("odd/spurious.las", 1065, 0, "degrees"),
    ("odd/1.0_0.las", 1, 0, ""),
    ("odd/epsg_4326.las", 5380, 0, "degrees"),
    ("odd/hextest.las", 8, 0, ""),
    ("odd/1.1_1.las", 1, 0, ""),
    ("odd/bad_points_1.1.las", 1, 0, ""),
    ("odd/certainty3d-color-utm-feet-navd88.las", 10_126, 0, ""),
    ("odd/1_4_w_evlr.laz", 1000, 0, ""),
    ("odd/simple1_3.las", 999, 0, "name 32632 as unit"),
    ("odd/simple_with_page.copc.laz", 1065, 0, ""),
    ("odd/1.2-with-color.copc.laz", 1065, 0, ""),
    ("odd/no-points-1.3.laz", 0, 0, "holds no points"),
    ("odd/point10-1.0.laz", 1, 0, ""),
    ("odd/test_data_0436_6384_LA93_IGN69_single_point.laz", 1, 0, ""),
    ("odd/las11_32-1-472-150-76.laz", 5658, 0, ""),
    ("odd/multichunk.laz", 120_000, 0, ""),
];

const REFUSED: &[(&str, &str)] = &[
    ("odd/Semis_2022_0906_6665_LA93_IGN69_nok.laz", "header length 0"),
    ("odd/text_pointer_autzen.laz", "found text: \"version https://"),
];

/// [`Read::sums`] of the kept points as read by laspy 2.7 with lazrs 0.8, at one metre per unit.
const LASPY: &[(&str, [u64; 3])] = &include!("input/laspy_sums.in");

#[test]
fn every_real_file_gives_its_points_or_one_clear_line() {
    let Some(data) = data::folder() else { return };
    for &(name, points, withheld, warning) in READABLE {
        let found = read_one(&data.join(name)).unwrap_or_else(|e| panic!("{e}"));
        let expected = PointCounts { read: points, withheld, ..PointCounts::default() };
        assert_eq!(PointCounts { missing: 0, ..found.counts }, expected, "{name}");
        assert!(found.warnings.contains(warning), "{name}: {}", found.warnings);
        // Of all these, only cut files are refused unless incomplete input is allowed.
        let strict = read_strictly(&[data.join(name)], InputOptions::default());
        let cut = ["odd/1.2-no-points.las", "odd/1.2-with-color-clipped.las", "odd/garbage_nVariableLength.las"];
        assert_eq!(strict.is_err(), cut.contains(&name), "{name}: {strict:?}");
    }
    for &(name, text) in REFUSED {
        let found = refusal(&data.join(name));
        assert!(found.contains(text), "{found}");
    }
    for entry in std::fs::read_dir(data.join("odd")).unwrap() {
        let name = format!("odd/{}", entry.unwrap().file_name().to_str().unwrap());
        let known = READABLE.iter().map(|r| r.0).chain(REFUSED.iter().map(|r| r.0)).any(|n| n == name);
        assert!(known, "{name} is in no list of this test");
    }
}

#[test]
fn coordinates_are_the_very_bits_that_laspy_gives() {
    let Some(data) = data::folder() else { return };
    let options = InputOptions { units: Units::Factor(1.0), ..InputOptions::default() };
    for &(name, sums) in LASPY {
        assert_eq!(read(&[data.join(name)], options).unwrap().sums(), sums, "{name}");
    }
    let pairs = [
        ("odd/pdrf10-1.5.laz", "odd/pdrf10-1.5.las"),
        ("odd/10_points_format_10.laz", "odd/10_points_format_10.las"),
        ("odd/simple-laszip-compressor-version-1.2r0.laz", "odd/laszip-generated_with2bytespadding.laz"),
    ];
    for (packed, plain) in pairs {
        let [packed, plain] = [packed, plain].map(|n| read(&[data.join(n)], options).unwrap());
        assert_eq!(packed.points, plain.points);
    }
}

#[test]
fn units_follow_the_reference_system_of_each_file() {
    let Some(data) = data::folder() else { return };
    let us_foot = 1200.0 / 3937.0;
    let cases = [
        ("odd/1.2-with-color.copc.laz", [1.0, 1.0, us_foot], "COMPD_CS[\"NAD83 / Oregon LCC (m) + NAVD88"),
        ("odd/1_4_w_evlr.laz", [us_foot; 3], "PROJCS[\"NAD83(HARN) / New Mexico Central (ftUS)\""),
        ("odd/certainty3d-color-utm-feet-navd88.las", [us_foot; 3], "EPSG:2229"),
        ("odd/1.1_1.las", [1.0; 3], "EPSG:26915"),
        ("odd/epsg_4326.las", [1.0; 3], "EPSG:4326"),
        ("odd/las11_32-1-472-150-76.laz", [1.0; 3], "EPSG:25832"),
    ];
    for (name, unit, crs) in cases {
        let set = InputSet::open(&[data.join(name)], InputOptions::default(), &NoMonitor).unwrap();
        assert_eq!(set.files()[0].unit_m(), unit, "{name}");
        assert!(set.crs().unwrap().starts_with(crs), "{name}: {:?}", set.crs());
        let options = InputOptions { units: Units::Factor(2.0), ..InputOptions::default() };
        let heard = Heard::default();
        let set = InputSet::open(&[data.join(name)], options, &heard).unwrap();
        assert_eq!(set.files()[0].unit_m(), [2.0; 3], "an explicit unit overrides {name}");
        assert!(!heard.0.into_inner().unwrap().concat().contains("degrees"));
    }
}

#[test]
fn z_up_and_y_up_twins_agree() {
    let Some(data) = data::folder() else { return };
    let turned = InputOptions { up: Up::Y, ..InputOptions::default() };
    let y_up = read(&[data.join("indoor_two_storey_yup.laz")], turned).unwrap();
    let z_up = read_one(&data.join("indoor_two_storey_zup.laz")).unwrap();
    let round = |all: &Read| {
        let mut all: Vec<_> = all.points.iter().map(|p| p.map(|v| (v * 100.0).round() as i64)).collect();
        all.sort_unstable();
        all
    };
    assert_eq!(round(&y_up), round(&z_up));
}

#[test]
fn spacings_are_near_those_in_the_data_table() {
    let Some(data) = data::folder() else { return };
    // Medians over distinct points (scipy's k-d tree); the table's own medians are the same if no point occurs twice.
    let table = [
        ("indoor_two_storey_zup.laz", 0.0141),
        ("room_single_station.laz", 0.027),
        ("corridor_three_stations.laz", 0.01),
        ("pump_room.laz", 0.00465),
        ("delft_city_block_ahn3.laz", 0.289),
        ("isprs_csite2_town.laz", 0.04),
        ("forest_plot_tls.laz", 0.0283),
        ("autzen_stadium.laz", 0.797),
    ];
    for (name, median) in table {
        let set = InputSet::open(&[data.join(name)], InputOptions::default(), &NoMonitor).unwrap();
        let found = estimate_spacing(&set, 2, &NoMonitor).unwrap();
        println!("{name}: {found:?}, table {median}");
        assert!((0.8..1.25).contains(&(found.spacing_m / median)), "{name}: {found:?}, table {median}");
        assert_eq!(estimate_spacing(&set, 1, &NoMonitor).unwrap(), found);
    }
}

// ---- files made here --------------------------------------------------------------------------------------------

/// A scan to be written and then damaged.
#[derive(Clone)]
struct Scan {
    version: u8,
    format: u8,
    scale: f64,
    records: Vec<Vec<u8>>,
    vlrs: Vec<(&'static str, u16, Vec<u8>)>,
    evlrs: Vec<(&'static str, u16, Vec<u8>)>,
}

const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

impl Scan {
    fn new(version: u8, format: u8, points: u32) -> Self {
        let mut state = 0x1234_5678_9ABC_DEF1u64;
        let mut random = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 33) as i32
        };
        let bytes = RECORD_BYTES[usize::from(format)];
        let records = (0..points as i32)
            .map(|i| {
                let mut record = vec![0u8; bytes];
                for (axis, raw) in [i * 7 + random() % 50, random() % 10_000, random() % 300].into_iter().enumerate() {
                    record[4 * axis..4 * axis + 4].copy_from_slice(&raw.to_le_bytes());
                }
                record[14] = 0x11; // return 1 of 1, in both layouts
                record[if format < 6 { 15 } else { 16 }] = (random() % 6) as u8;
                record
            })
            .collect();
        Self { version, format, scale: 0.01, records, vlrs: Vec::new(), evlrs: Vec::new() }
    }

    fn expected(&self) -> Vec<[f64; 3]> {
        let raw = |r: &[u8], a: usize| i32::from_le_bytes(r[4 * a..4 * a + 4].try_into().unwrap());
        self.records.iter().map(|r| [0, 1, 2].map(|a| f64::from(raw(r, a)) * self.scale + 100.0)).collect()
    }

    fn head(&self, compressed: bool, vlrs: &[(&str, u16, Vec<u8>)]) -> Vec<u8> {
        let header_bytes = [227, 227, 227, 235, 375, 393][usize::from(self.version)];
        let mut out = vec![0u8; header_bytes];
        let mut put = |at: usize, bytes: &[u8]| out[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"LASF");
        put(24, &[1, self.version]);
        put(94, &(header_bytes as u16).to_le_bytes());
        let points_at = header_bytes + vlrs.iter().map(|v| 54 + v.2.len()).sum::<usize>();
        put(96, &(points_at as u32).to_le_bytes());
        put(100, &(vlrs.len() as u32).to_le_bytes());
        put(104, &[self.format | if compressed { 0x80 } else { 0 }]);
        put(105, &(self.records.first().map_or(RECORD_BYTES[usize::from(self.format)], Vec::len) as u16).to_le_bytes());
        put(107, &(self.records.len() as u32).to_le_bytes());
        for axis in 0..3 {
            put(131 + 8 * axis, &self.scale.to_le_bytes());
            put(155 + 8 * axis, &100f64.to_le_bytes());
        }
        if self.version >= 4 {
            put(247, &(self.records.len() as u64).to_le_bytes());
        }
        for (user, id, body) in vlrs {
            let mut head = [0u8; 54];
            head[2..2 + user.len()].copy_from_slice(user.as_bytes());
            head[18..20].copy_from_slice(&id.to_le_bytes());
            head[20..22].copy_from_slice(&(body.len() as u16).to_le_bytes());
            out.extend(head);
            out.extend(body);
        }
        out
    }

    fn tail(&self, mut out: Vec<u8>) -> Vec<u8> {
        if !self.evlrs.is_empty() {
            let at = out.len() as u64;
            out[235..243].copy_from_slice(&at.to_le_bytes());
            out[243..247].copy_from_slice(&(self.evlrs.len() as u32).to_le_bytes());
        }
        for (user, id, body) in &self.evlrs {
            let mut head = [0u8; 60];
            head[2..2 + user.len()].copy_from_slice(user.as_bytes());
            head[18..20].copy_from_slice(&id.to_le_bytes());
            head[20..28].copy_from_slice(&(body.len() as u64).to_le_bytes());
            out.extend(head);
            out.extend(body);
        }
        out
    }

    fn las(&self) -> Vec<u8> {
        let mut out = self.head(false, &self.vlrs);
        out.extend(self.records.concat());
        self.tail(out)
    }

    fn vlr(&self, chunk: u32) -> LazVlr {
        let usual = RECORD_BYTES[usize::from(self.format)];
        let extra = self.records.first().map_or(0, |r| r.len() - usual) as u16;
        let builder = LazVlrBuilder::default().with_point_format(self.format, extra).unwrap();
        match chunk {
            0 => builder.with_variable_chunk_size().build(),
            n => builder.with_fixed_chunk_size(n).build(),
        }
    }

    /// LAZ with `chunk` points per chunk; 0 for chunks of 100, 300, 500 ... points.
    fn laz(&self, chunk: u32) -> Vec<u8> {
        let vlr = self.vlr(chunk);
        let mut body = Vec::new();
        vlr.write_to(&mut body).unwrap();
        let mut vlrs = vec![(LazVlr::USER_ID, LazVlr::RECORD_ID, body)];
        vlrs.extend(self.vlrs.iter().cloned());
        let mut file = std::io::Cursor::new(self.head(true, &vlrs));
        file.set_position(file.get_ref().len() as u64);
        let mut compressor = LasZipCompressor::new(file, vlr).unwrap();
        let (mut left, mut next) = (100, 300);
        for record in &self.records {
            if chunk == 0 && left == 0 {
                compressor.finish_current_chunk().unwrap();
                (left, next) = (next, next + 200);
            }
            left -= 1;
            compressor.compress_one(record).unwrap();
        }
        compressor.done().unwrap();
        self.tail(compressor.into_inner().into_inner())
    }
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

#[test]
fn every_format_reads_back_plain_and_packed_in_fixed_and_variable_chunks() {
    let folder = Folder::new();
    for format in 0..=10u8 {
        let scan = Scan::new(if format < 6 { 3 } else { 4 }, format, 2500);
        for (name, bytes) in
            [("a.las", scan.las()), ("b.laz", scan.laz(1000)), ("c.laz", scan.laz(0)), ("d.laz", scan.laz(50_000))]
        {
            let found = read_one(&folder.file(name, &bytes)).unwrap_or_else(|e| panic!("format {format}: {e}"));
            assert_eq!(found.counts.read, 2500, "format {format} {name}");
            assert!(found.points == scan.expected(), "format {format} {name}");
            assert!(
                found.warnings.lines().all(|l| l.contains("no unit")),
                "format {format} {name}: {}",
                found.warnings
            );
        }
    }
}

/// Derives a field of a record from that of the previous one.
fn next_field(random: &mut impl FnMut() -> u64, field: &mut [u8], most_bits: u32) {
    let mut eight = [0; 8];
    eight[..field.len()].copy_from_slice(field);
    let before = u64::from_le_bytes(eight);
    let now = match random() % 8 {
        0..4 => before,
        4 | 5 => before.wrapping_add(random() % 9).wrapping_sub(4),
        6 => before.wrapping_add((random() % 1000) * 40),
        _ => random() >> (random() % 32),
    };
    field.copy_from_slice(&(now & ((1 << most_bits) - 1)).to_le_bytes()[..field.len()]);
}

/// Random records: extra bytes, scanner channels, times that jump, return numbers 0 to 15.
fn varied(format: u8, points: u32, extra: usize, random: &mut impl FnMut() -> u64) -> Scan {
    let mut scan = Scan::new(4, format, points);
    let bytes = RECORD_BYTES[usize::from(format)];
    // Ends of the fields after the coordinates, the last of which is a time.
    let (ends, time_at) = match format {
        0 | 2 => (vec![14, 15, 16, 17, 18, 20], None),
        0..6 => (vec![14, 15, 16, 17, 18, 20, 28], Some(20)),
        _ => (vec![14, 15, 16, 17, 18, 20, 22, 30], Some(22)),
    };
    let mut last = vec![0u8; bytes + extra];
    for record in &mut scan.records {
        let place: [u8; 12] = record[..12].try_into().unwrap();
        let (mut from, known) = (12, *ends.last().unwrap());
        for to in ends.iter().copied().chain(known + 1..=bytes + extra) {
            // `laz` computes differences of times as if they could not overflow.
            let bits = if time_at == Some(from) { 61 } else { 8 * (to - from) as u32 };
            next_field(random, &mut last[from..to], bits);
            from = to;
        }
        last[..12].copy_from_slice(&place);
        // The same holds for differences of waveform positions.
        if let Some(packet) = [(4, 28), (5, 34), (9, 30), (10, 38)].iter().find(|packet| packet.0 == format) {
            last[packet.1 + 8] &= 0x3F;
        }
        record.clone_from(&last);
    }
    scan
}

/// Random numbers of 53 bits.
fn numbers(mut state: u64) -> impl FnMut() -> u64 {
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state >> 11
    }
}

/// In chunks of any length.
#[test]
fn the_same_records_plain_and_packed_give_the_same_archive() {
    use slicewalk::colour::ColourSource;
    use slicewalk_convert::{ColourMode, ConvertOptions, PixelSize, convert};
    let folder = Folder::new();
    let mut random = numbers(88_172_645_463_325_252);
    let modes = [ColourMode::Auto, ColourMode::Of(ColourSource::Intensity), ColourMode::Of(ColourSource::Class)];
    let archive = |bytes: &[u8], name: &str, exclude: bool, colour: ColourMode| {
        let path = folder.file(name, bytes);
        let mut options = ConvertOptions::new(vec![path], folder.0.path().join("a.slices"));
        options.pixel = PixelSize::Metres(5.0);
        options.overwrite = true;
        options.colour = colour;
        if exclude {
            options.plan.exclude_classes = [3].into_iter().collect();
        }
        // If all values are 0, both are refused.
        match convert(&options, &NoMonitor) {
            Ok(_) => std::fs::read(&options.output).unwrap(),
            Err(error) => error.to_string().into_bytes(),
        }
    };
    let mut archives = 0;
    for round in 0..44u64 {
        let format = (round % 11) as u8;
        let (points, extra) = (1 + random() as u32 % 900, random() as usize % 4);
        let scan = varied(format, points, extra, &mut random);
        let chunk = [0, 1 + random() as u32 % 40, 50 + random() as u32 % 400, 50_000][round as usize / 11];
        let (exclude, colour) = (random() & 1 == 0, modes[random() as usize % 3]);
        let [plain, packed] = [(scan.las(), "a.las"), (scan.laz(chunk), "b.laz")]
            .map(|(bytes, name)| archive(&bytes, name, exclude, colour));
        assert!(plain == packed, "format {format}, chunks of {chunk}");
        archives += usize::from(plain.len() > 300);
    }
    assert!(archives > 30, "{archives}");
}

#[test]
fn extra_bytes_are_stepped_over_and_bound_the_memory() {
    let folder = Folder::new();
    for format in [1, 7] {
        let mut scan = Scan::new(4, format, 600);
        scan.records.iter_mut().for_each(|r| r.extend((0..192).map(|i| i as u8)));
        for (name, bytes) in [("a.las", scan.las()), ("b.laz", scan.laz(250))] {
            let path = folder.file(name, &bytes);
            assert!(read_one(&path).unwrap().points == scan.expected());
            let options = InputOptions { memory_bytes: 1 << 20, ..InputOptions::default() };
            match read(&[path], options) {
                // Of layered points, only needed layers are decoded.
                Ok(found) => assert!((name == "a.las" || format == 7) && found.points.len() == 600),
                Err(error) => {
                    assert!(matches!(error, Error::Limit { .. }) && error.to_string().contains("give more memory"))
                }
            }
        }
    }
}

#[test]
fn withheld_points_and_classes_are_left_out_of_packed_files_too() {
    let folder = Folder::new();
    for format in [2u8, 8] {
        let mut scan = Scan::new(4, format, 3000);
        let (flag_bit, class_at) = if format < 6 { (0x80, 15) } else { (4, 16) };
        scan.records.iter_mut().step_by(5).for_each(|r| r[15] |= flag_bit);
        let class = |r: &Vec<u8>| r[class_at] & 31;
        let withheld = |r: &Vec<u8>| r[15] & flag_bit != 0;
        let options = InputOptions { exclude_classes: [3].into_iter().collect(), ..InputOptions::default() };
        let all = scan.expected();
        let kept: Vec<_> = std::iter::zip(&scan.records, &all)
            .filter(|(r, _)| class(r) != 3 && !withheld(r))
            .map(|(_, p)| *p)
            .collect();
        for (name, bytes) in [("a.las", scan.las()), ("b.laz", scan.laz(700))] {
            let found = read(&[folder.file(name, &bytes)], options).unwrap();
            assert_eq!((found.counts.withheld, found.counts.read), (600, 3000));
            assert!(found.points == kept, "format {format} {name}");
        }
    }
}

#[test]
fn a_cut_las_gives_its_whole_points_at_every_length() {
    let folder = Folder::new();
    let scan = Scan::new(2, 1, 40);
    let (whole, expected) = (scan.las(), scan.expected());
    for len in 0..whole.len() {
        let path = folder.file("cut.las", &whole[..len]);
        if len < 227 {
            refusal(&path);
            continue;
        }
        let found = read_one(&path).unwrap();
        assert_eq!(found.points, expected[..(len - 227) / 28]);
        assert!(found.warnings.contains("the header states 40 points"), "{}", found.warnings);
    }
}

#[test]
fn a_cut_laz_gives_the_points_before_the_cut_or_one_line() {
    let folder = Folder::new();
    for (format, chunk) in [(1u8, 500), (7, 500), (3, 0), (6, 0)] {
        let scan = Scan::new(4, format, 2400);
        let (whole, expected) = (scan.laz(chunk), scan.expected());
        let mut most = 0;
        for len in (0..whole.len()).step_by(97).chain([whole.len() - 1, whole.len() - 9]) {
            let path = folder.file("cut.laz", &whole[..len]);
            match read_one(&path) {
                Ok(found) => {
                    // Only whole chunks count, because the last points before a cut cannot be checked.
                    let n = found.points.len();
                    assert!(n <= 2400 && found.points[..] == expected[..n], "format {format}, {len} bytes");
                    assert!(chunk == 0 || n % chunk as usize == 0 || n == 2400, "format {format}, {len} bytes: {n}");
                    assert!(
                        found.warnings.contains("cut") || found.warnings.contains("ends before"),
                        "{}",
                        found.warnings
                    );
                    most = most.max(n);
                }
                Err(error) => assert!(!error.to_string().contains('\n')),
            }
        }
        // In formats 0 to 5, chunks of varying length cannot be found without their table.
        assert!(if (format, chunk) == (3, 0) { most == 0 } else { most > 1800 }, "format {format}: {most}");
    }
}

#[test]
fn a_lost_chunk_table_costs_nothing_where_chunks_can_be_found() {
    let folder = Folder::new();
    for (format, chunk) in [(0u8, 500), (6, 500), (7, 0)] {
        let scan = Scan::new(4, format, 1700);
        let good = scan.laz(chunk);
        let at = u32::from_le_bytes(good[96..100].try_into().unwrap()) as usize;
        let table = i64::from_le_bytes(good[at..at + 8].try_into().unwrap());
        for place in [-1, 0, 17, i64::MAX, i64::MIN, table + 1, table - 1, good.len() as i64 - 3] {
            let mut bytes = good.clone();
            bytes[at..at + 8].copy_from_slice(&place.to_le_bytes());
            let found = read_strictly(&[folder.file("lost.laz", &bytes)], InputOptions::default());
            let found = found.unwrap_or_else(|error| panic!("format {format}, table at {place}: {error}"));
            assert!(found.points == scan.expected(), "format {format}, {place}: {}", found.points.len());
            assert!(found.warnings.contains("chunk table"), "{}", found.warnings);
        }
        // Written to a pipe: the position of the table is at the end of the file.
        let mut bytes = good.clone();
        bytes[at..at + 8].copy_from_slice(&(-1i64).to_le_bytes());
        bytes.extend(table.to_le_bytes());
        let found = read_one(&folder.file("pipe.laz", &bytes)).unwrap();
        assert!(found.points == scan.expected() && !found.warnings.contains("chunk table"), "{}", found.warnings);
    }
}

#[test]
fn chunk_tables_that_lie_lose_no_point_unnoticed() {
    let folder = Folder::new();
    for (format, chunk) in [(1u8, 300), (6, 300), (7, 0), (3, 0)] {
        let scan = Scan::new(4, format, 2450);
        let (good, vlr) = (scan.laz(chunk), scan.vlr(chunk));
        let points_at = u32::from_le_bytes(good[96..100].try_into().unwrap()) as u64;
        let table_at = u64::from_le_bytes(good[points_at as usize..][..8].try_into().unwrap()) as usize;
        let mut file = std::io::Cursor::new(&good);
        file.set_position(points_at);
        let table = ChunkTable::read_from(&mut file, &vlr).unwrap();
        let entries: Vec<(u64, u64)> = table.as_ref().iter().map(|e| (e.point_count, e.byte_count)).collect();
        assert!(entries.len() > 4);
        let mut lies =
            vec![entries[..1].to_vec(), entries[..entries.len() - 1].to_vec(), entries[1..].to_vec(), vec![]];
        lies.push([&entries[..], &entries[..2]].concat());
        lies.push([&entries[..], &[(1, 40)]].concat());
        lies.push(vec![(2450, entries.iter().map(|e| e.1).sum())]);
        for (at, from) in [(0, 1), (2, 3), (entries.len() - 2, entries.len() - 1)] {
            for bytes in [1, 7, 500].map(|bytes: u64| bytes.min(entries[at].1).min(entries[from].1)) {
                let mut shifted = entries.clone();
                (shifted[at].1, shifted[from].1) = (shifted[at].1 + bytes, shifted[from].1 - bytes);
                lies.push(shifted);
                let mut less = entries.clone();
                less[at].1 -= bytes;
                lies.push(less);
                let mut more = entries.clone();
                more[at].1 += bytes;
                lies.push(more);
            }
            for points in [1, 90].into_iter().filter(|&points| points <= entries[at].0) {
                let mut counts = entries.clone();
                counts[at].0 -= points;
                lies.push(counts.clone());
                counts[from].0 += points;
                lies.push(counts);
            }
        }
        let (mut whole, mut refused) = (0, 0);
        for (number, lie) in lies.iter().enumerate() {
            let mut table = ChunkTable::with_capacity(lie.len());
            lie.iter().for_each(|&(point_count, byte_count)| table.push(ChunkTableEntry { point_count, byte_count }));
            for stated in [2450u32, lie.iter().map(|e| e.0 as u32).sum::<u32>().min(2450), 2449] {
                let mut bytes = good[..table_at].to_vec();
                bytes[107..111].copy_from_slice(&stated.to_le_bytes());
                bytes[247..255].copy_from_slice(&u64::from(stated).to_le_bytes());
                table.write_to(&mut bytes, &vlr).unwrap();
                let path = folder.file("lie.laz", &bytes);
                match read_strictly(std::slice::from_ref(&path), InputOptions::default()) {
                    Ok(found) => {
                        let read = found.points.len();
                        assert!(stated == 2450, "format {format}, lie {number}: {stated} stated, {read} points");
                        assert!(found.points == scan.expected(), "format {format}, lie {number}: {read} points");
                        whole += 1;
                    }
                    Err(error) => {
                        assert!(!error.to_string().contains('\n'), "{error}");
                        refused += 1;
                    }
                }
                if lie == &entries && stated == 2450 {
                    assert!(refused == 0);
                }
            }
        }
        println!("format {format}, chunks of {chunk}: {whole} read whole, {refused} refused");
        assert!(refused > 5 && (whole > 5 || format == 3), "format {format}: {whole} {refused}");
    }
}

#[test]
fn chunks_of_few_points_give_them_and_cost_what_they_hold() {
    let folder = Folder::new();
    for (format, points, chunk) in [(0u8, 700, 1), (3, 700, 1), (6, 700, 1), (8, 700, 1), (7, 700, 2), (1, 700, 3)] {
        let scan = Scan::new(4, format, points);
        let path = folder.file("few.laz", &scan.laz(chunk));
        let found = read_strictly(std::slice::from_ref(&path), InputOptions::default()).unwrap();
        assert!(found.points == scan.expected(), "format {format}, chunks of {chunk}");
        assert!(found.warnings.lines().all(|line| line.contains("no unit")), "{}", found.warnings);
    }
}

#[test]
fn counts_that_lie_are_survived() {
    let folder = Folder::new();
    let scan = Scan::new(2, 0, 1700);
    let expected = scan.expected();
    let stating = |bytes: &[u8], count: u32| {
        let mut bytes = bytes.to_vec();
        bytes[107..111].copy_from_slice(&count.to_le_bytes());
        bytes
    };
    for count in [1, 1500, 1690, 1701, 2001, u32::MAX] {
        let found = read_one(&folder.file("lie.las", &stating(&scan.las(), count))).unwrap();
        assert_eq!(found.points, expected[..(count as usize).min(1700)]);
        if count == 1701 {
            // Indistinguishable from damage in the last chunk, which is more likely.
            let text = refusal(&folder.file("lie.laz", &stating(&scan.laz(500), count)));
            assert!(text.contains("LAZ chunk 3: damaged") && text.contains("of 201"), "{text}");
        }
        let path = folder.file("lie.laz", &stating(&scan.laz(500), count));
        refusal(&path);
        // The last chunk is dropped: nothing states how many points it has.
        let found = read_one(&path).unwrap();
        assert!(found.points == expected[..1500], "{count}: {} points", found.points.len());
    }
    for bytes in [scan.las(), scan.laz(500)] {
        let text = refusal(&folder.file("zero.laz", &stating(&bytes, 0)));
        assert!(text.contains("states 0 points") && text.contains("interrupted"), "{text}");
    }
    // Layered chunks state their number of points.
    let scan = Scan::new(4, 6, 1700);
    for count in [0u64, 1, 1500, 1699, 1701, u64::MAX] {
        let mut bytes = scan.laz(500);
        bytes[107..111].copy_from_slice(&0u32.to_le_bytes());
        bytes[247..255].copy_from_slice(&count.to_le_bytes());
        let path = folder.file("lie.laz", &bytes);
        let text = refusal(&path);
        assert!(text.contains(&format!("the header states {count} points, its chunks hold 1700")), "{text}");
        let found = read_one(&path).unwrap();
        assert!(found.points == scan.expected(), "{count}");
        assert!(found.warnings.contains("its chunks hold 1700"), "{}", found.warnings);
    }
}

/// Offsets of the chunks in a file of `Scan::laz`, and the end of the last one.
fn chunk_places(laz: &[u8], scan: &Scan, chunk: u32) -> Vec<usize> {
    let points_at = u64::from(u32::from_le_bytes(laz[96..100].try_into().unwrap()));
    let mut file = std::io::Cursor::new(laz);
    file.set_position(points_at);
    let table = ChunkTable::read_from(&mut file, &scan.vlr(chunk)).unwrap();
    let mut at = points_at as usize + 8;
    let ends = table.as_ref().iter().map(|entry| {
        at += entry.byte_count as usize;
        at
    });
    std::iter::once(points_at as usize + 8).chain(ends).collect()
}

/// The count in the head of the last chunk is not trusted if the header contradicts it.
#[test]
fn a_count_in_a_layered_chunk_that_lies_is_refused() {
    let folder = Folder::new();
    for (format, chunk, points) in [(6u8, 50_000, 600u32), (8, 500, 600), (7, 0, 600)] {
        let scan = Scan::new(4, format, points);
        let good = scan.laz(chunk);
        let places = chunk_places(&good, &scan, chunk);
        let filled = places.windows(2).rfind(|place| place[1] - place[0] > 4).unwrap();
        let at = filled[0] + RECORD_BYTES[usize::from(format)];
        let held = u32::from_le_bytes(good[at..at + 4].try_into().unwrap());
        for count in [0, 1, held - 1, held + 1, u32::MAX] {
            let mut bad = good.clone();
            bad[at..at + 4].copy_from_slice(&count.to_le_bytes());
            let path = folder.file("count.laz", &bad);
            refusal(&path);
            // Every point that is left is one of the file.
            let found = read_one(&path).unwrap();
            assert!(found.points == scan.expected()[..(points - held) as usize], "format {format}, {count}");
        }
    }
}

/// The end of a chunk, or of a layer, shows whether its points are those that were packed. The first point's
/// coordinates are not covered: a chunk stores them uncompressed.
#[test]
fn flipped_bits_of_packed_points_are_errors_or_change_nothing() {
    let folder = Folder::new();
    for (format, chunk) in [(0u8, 200), (3, 150), (5, 200), (6, 200), (7, 150), (8, 0), (10, 200)] {
        let scan = Scan::new(4, format, 450);
        let (good, bytes) = (scan.laz(chunk), RECORD_BYTES[usize::from(format)]);
        let places = chunk_places(&good, &scan, chunk);
        let (mut refused, mut tried, mut others) = (0, 0, 0);
        for place in places.windows(2) {
            for at in (place[0] + 12..place[1]).step_by(13) {
                let mut bad = good.clone();
                bad[at] ^= 1 << ((at * 7 + at / 64) % 8);
                let path = folder.file("flip.laz", &bad);
                tried += 1;
                match read_strictly(std::slice::from_ref(&path), InputOptions::default()) {
                    Ok(found) => {
                        let is_flag = at < place[0] + bytes;
                        let same = found.points == scan.expected() || is_flag && found.counts.withheld > 0;
                        others += usize::from(!same);
                    }
                    Err(error) => {
                        assert!(!error.to_string().contains('\n'), "{error}");
                        refused += 1;
                        // The allowed loss is a chunk, and no point is invented.
                        let left = read_one(&path).unwrap();
                        let lost = 450 - left.points.len();
                        // If the count of the last chunk is damaged, the number lost is unknown.
                        let is_told = left.counts.missing == lost as u64 || format > 5;
                        assert!(lost <= 300 && left.counts.missing > 0 && is_told, "{lost} {:?}", left.counts);
                        let all = scan.expected();
                        assert!(left.points.iter().all(|point| all.contains(point)), "format {format}, byte {at}");
                        assert!(left.warnings.contains("could not be read"), "{}", left.warnings);
                    }
                }
            }
        }
        println!("format {format}: {refused} of {tried} refused, {others} other points");
        // By chance a layer's last bytes may be those of other points; `flipped_bits_by_the_million` counts these
        // cases.
        assert!(others * 100 < tried, "format {format}: {others} of {tried}");
        assert!(refused * 3 > tried, "format {format}: {refused} of {tried}");
    }
}

/// Flips as many bits as `SLICEWALK_FLIPS` says, anywhere from the points on, and counts the results. Wrong points are
/// read where `laz` reads the same: then the bytes encode those points. Apart from that, in fewer than one in a
/// thousand, because layers that are not needed are not decoded, and the damage may show only in these.
#[test]
#[ignore = "counts: SLICEWALK_FLIPS=1000000 takes minutes"]
fn flipped_bits_by_the_million() {
    let flips: u64 = std::env::var("SLICEWALK_FLIPS").map_or(20_000, |text| text.parse().unwrap());
    // Held in memory, because files would take most of the time.
    let path = PathBuf::from("/no folder/flip.laz");
    let read = |bytes: &[u8]| {
        slicewalk::bytes::testing::hold(&path, bytes);
        read_strictly(std::slice::from_ref(&path), InputOptions::default())
    };
    let mut random = numbers(0x9E37_79B9_7F4A_7C15);
    for format in [6u8, 7, 8, 1, 3] {
        let [mut refused, mut same, mut first, mut packed, mut alone] = [0u64; 5];
        let of_each = 2000.min(flips);
        for _ in 0..flips / of_each {
            let scan = varied(format, 200, 0, &mut random);
            let (good, chunk) = (scan.laz(60), 60);
            let places = chunk_places(&good, &scan, chunk);
            let points_at = places[0] - 8;
            let expected = read(&good).unwrap();
            for _ in 0..of_each {
                let at = points_at + random() as usize % (good.len() - points_at);
                let mut bad = good.clone();
                bad[at] ^= 1 << (random() % 8);
                let Ok(found) = read(&bad) else {
                    refused += 1;
                    continue;
                };
                if (&found.points, found.counts) == (&expected.points, expected.counts) {
                    same += 1;
                    continue;
                }
                let mut file = std::io::Cursor::new(&bad);
                file.set_position(points_at as u64);
                let bytes = scan.records[0].len();
                let mut records = vec![0; 200 * bytes];
                let decoder = laz::LasZipDecompressor::new(file, scan.vlr(chunk)).ok();
                let is_read = decoder.is_some_and(|mut decoder| decoder.decompress_many(&mut records).is_ok());
                let theirs = Scan { records: records.chunks(bytes).map(<[u8]>::to_vec).collect(), ..scan.clone() };
                let is_kept = |record: &&Vec<u8>| record[15] & if format < 6 { 0x80 } else { 4 } == 0;
                let kept: Vec<_> = std::iter::zip(theirs.expected(), &theirs.records)
                    .filter(|(_, record)| is_kept(record))
                    .map(|(point, _)| point)
                    .collect();
                let is_first = places.iter().any(|&place| (place..place + 30.min(bytes)).contains(&at));
                match (is_read && kept == found.points, is_first) {
                    (true, true) => first += 1,
                    (true, false) => packed += 1,
                    (false, _) => alone += 1,
                }
            }
        }
        println!(
            "format {format}: {refused} flips refused, {same} change no point; others as laz reads them: {first} of first points, \
             {packed} of packed ones; by us alone: {alone}"
        );
        assert!(alone * 1000 < flips.max(2000), "format {format}: {alone} of {flips}");
    }
}

/// Without a chunk table, the points must end where the table begins, or at the end of the file.
#[test]
fn garbage_behind_points_without_a_chunk_table_is_refused() {
    let folder = Folder::new();
    for (format, chunk) in [(1u8, 1), (1, 100), (3, 700), (6, 100)] {
        let scan = Scan::new(4, format, 600);
        let good = scan.laz(chunk);
        let place = u32::from_le_bytes(good[96..100].try_into().unwrap()) as usize;
        let table = *chunk_places(&good, &scan, chunk).last().unwrap();
        // The table's offset is lost, or its count.
        let mut lost = good.clone();
        lost[place..place + 8].copy_from_slice(&(-1i64).to_le_bytes());
        let mut wrong = good.clone();
        wrong[table + 7] ^= 2;
        for bytes in [&lost, &wrong] {
            let path = folder.file("table.laz", bytes);
            assert!(read_strictly(&[path], InputOptions::default()).unwrap().points == scan.expected());
            // Within layers of coordinates.
            let places = chunk_places(&good, &scan, chunk);
            let damaged = if format < 6 { [table - 40, table - 300] } else { [places[1] + 100, places[4] + 150] };
            for at in damaged {
                let mut bad = bytes.clone();
                bad[at..at + 16].iter_mut().enumerate().for_each(|(n, byte)| *byte ^= 0x5A + n as u8);
                refusal(&folder.file("damaged.laz", &bad));
            }
            // Bytes other than the table's where it should begin.
            let mut bad = bytes.clone();
            bad.splice(table..table, [7; 100]);
            if bytes == &lost {
                refusal(&folder.file("behind.laz", &bad));
            }
        }
    }
}

/// Chunks of equal length without a table, as LASzip's first versions wrote them: one for the whole file.
#[test]
fn a_file_of_one_sequence_reads_whole_or_not_at_all() {
    let folder = Folder::new();
    let scan = Scan::new(2, 3, 700);
    let chunked = scan.laz(50_000);
    let places = chunk_places(&chunked, &scan, 50_000);
    // Remove the table's offset and the table; compressor 1.
    let mut whole = chunked[..places[0] - 8].to_vec();
    let record = 227 + 54;
    assert_eq!(whole[record], 2);
    whole[record] = 1;
    whole.extend(&chunked[places[0]..places[1]]);
    let found = read_strictly(&[folder.file("whole.laz", &whole)], InputOptions::default()).unwrap();
    assert!(found.points == scan.expected());
    let refused =
        [whole[..whole.len() - 1].to_vec(), whole[..whole.len() / 2].to_vec(), [&whole[..], &[1; 40]].concat(), {
            let mut bad = whole.clone();
            bad[places[0] + 3000] ^= 1;
            bad
        }];
    for (number, bytes) in refused.iter().enumerate() {
        let path = folder.file("bad.laz", bytes);
        refusal(&path);
        // All points before unknown bytes are read.
        let left = read_one(&path).unwrap().points.len();
        assert_eq!(left, if number == 2 { 700 } else { 0 });
    }
}

/// Empty chunks: one in a file without points, one after the last.
#[test]
fn empty_chunks_and_empty_files_are_sound() {
    let folder = Folder::new();
    for format in 0..=10u8 {
        let scan = Scan::new(4, format, 130);
        let nothing = Scan { records: Vec::new(), ..scan.clone() };
        for chunk in [0, 50, 65, 130] {
            let good = scan.laz(chunk);
            let vlr = scan.vlr(chunk);
            let places = chunk_places(&good, &scan, chunk);
            let entry = |points: u64, bytes: usize| ChunkTableEntry { point_count: points, byte_count: bytes as u64 };
            let with_table = |mut body: Vec<u8>, entries: &[ChunkTableEntry]| {
                let at = body.len() as u64;
                let place = u32::from_le_bytes(body[96..100].try_into().unwrap()) as usize;
                body[place..place + 8].copy_from_slice(&at.to_le_bytes());
                let mut table = ChunkTable::with_capacity(entries.len());
                entries.iter().for_each(|entry| table.push(*entry));
                table.write_to(&mut body, &vlr).unwrap();
                body
            };
            // As `laz` ends it, with a chunk of only an encoder's end, and with an empty chunk.
            let mut file = std::io::Cursor::new(&good);
            file.set_position(places[0] as u64 - 8);
            let table = ChunkTable::read_from(&mut file, &vlr).unwrap();
            let filled: Vec<_> = table.as_ref().iter().filter(|entry| entry.byte_count > 4).copied().collect();
            let end = places[0] + filled.iter().map(|entry| entry.byte_count as usize).sum::<usize>();
            let plain = good[..end].to_vec();
            let mut cases = vec![good.clone(), with_table(plain.clone(), &[&filled[..], &[entry(0, 0)]].concat())];
            if format < 6 {
                let one_more = [&plain[..], &[1, 0, 0, 0]].concat();
                cases.push(with_table(one_more, &[&filled[..], &[entry(0, 4)]].concat()));
                let other = [&plain[..], &[1, 0, 2, 0]].concat();
                let other = with_table(other, &[&filled[..], &[entry(0, 4)]].concat());
                refusal(&folder.file("other.laz", &other));
            }
            for bytes in cases {
                let found = read_strictly(&[folder.file("full.laz", &bytes)], InputOptions::default()).unwrap();
                assert!(found.points == scan.expected(), "format {format}, chunks of {chunk}");
            }
            let head = nothing.laz(chunk)[..places[0]].to_vec();
            for entries in [vec![], vec![entry(0, 0)]] {
                let empty = folder.file("empty.laz", &with_table(head.clone(), &entries));
                let full = folder.file("full.laz", &good);
                let found = read_strictly(&[empty, full], InputOptions::default()).unwrap();
                assert!(found.points == scan.expected(), "format {format}, chunks of {chunk}");
            }
        }
    }
}

#[test]
fn hostile_headers_are_refused_in_one_line_and_size_nothing() {
    let folder = Folder::new();
    let las = Scan::new(4, 6, 10).las();
    let cases: &[(usize, &[u8], &str)] = &[
        (0, b"LASX", "expected \"LASF\""),
        (0, &[0; 4], "the bytes 00 00 00 00"),
        (25, &[9], "LAS version 1.9"),
        (94, &[1, 0], "header length 1"),
        (94, &[255, 255], "header length 65535"),
        (96, &[10, 0, 0, 0], "the points begin at byte 10"),
        (104, &[11], "point format 11"),
        (104, &[0x86], "LASzip record that says how is missing"),
        (105, &[29, 0], "records of 29 bytes"),
        (131, &[0; 8], "scale of x is 0"),
        (139, &f64::NAN.to_le_bytes(), "scale of y is NaN"),
        (147, &f64::INFINITY.to_le_bytes(), "scale of z is inf"),
        (171, &f64::NEG_INFINITY.to_le_bytes(), "offset of z is -inf"),
    ];
    for (at, bytes, text) in cases {
        let mut bad = las.clone();
        bad[*at..at + bytes.len()].copy_from_slice(bytes);
        let found = read_one(&folder.file("bad.las", &bad)).unwrap_err().to_string();
        assert!(found.contains(text) && !found.contains('\n'), "{found}");
    }
    let soft: &[(usize, &[u8])] = &[
        (100, &[255; 4]),                 // records before the points
        (243, &[255; 4]),                 // records after them, at byte 0
        (131, &(-0.01f64).to_le_bytes()), // a mirrored axis is meant that way
        (179, &f64::NAN.to_le_bytes()),   // bounds are never trusted
    ];
    for (at, bytes) in soft {
        let mut odd = las.clone();
        odd[*at..at + bytes.len()].copy_from_slice(bytes);
        assert_eq!(read_one(&folder.file("soft.las", &odd)).unwrap().counts.read, 10);
    }
    // Extended records far outside the file, and of absurd length.
    for (at, len) in [(u64::MAX - 3, 0), (1 << 40, 5), (375, u64::MAX), (600, 1 << 50)] {
        let mut scan = Scan::new(4, 6, 10);
        scan.evlrs.push(("LASF_Projection", 2112, b"PROJCS[\"x\",UNIT[\"foot\",0.3048]]".to_vec()));
        let mut odd = scan.las();
        let place = odd.len() - 60 - 33;
        odd[235..243].copy_from_slice(&at.to_le_bytes());
        odd[place + 20..place + 28].copy_from_slice(&u64::to_le_bytes(len));
        let _ = read_one(&folder.file("evlr.las", &odd)).map(|f| assert!(f.counts.read <= 10));
    }
}

/// An item that a layered record cannot have has no layer, so nothing may be read at its index.
#[test]
fn items_of_other_point_formats_are_refused_in_one_line() {
    let folder = Folder::new();
    for (format, from, to, names) in [(7, 11u16, 8u16, "Point14 and RGB12"), (3, 8, 11, "Point10 and RGB14")] {
        let mut bytes = Scan::new(4, format, 100).laz(50);
        // Each item of the record: type, bytes, version.
        let item = |kind: u16| [kind.to_le_bytes(), 6u16.to_le_bytes()].concat();
        let at = bytes.windows(4).position(|window| window == item(from)).unwrap();
        bytes[at..at + 4].copy_from_slice(&item(to));
        let text = refusal(&folder.file("mixed.laz", &bytes));
        assert!(text.contains("LASzip record") && text.contains(names), "{text}");
    }
}

#[test]
fn coordinates_out_of_range_are_counted_and_told_once() {
    let folder = Folder::new();
    let mut scan = Scan::new(2, 3, 200_000);
    scan.scale = 1e9;
    let found = read_one(&folder.file("far.las", &scan.las())).unwrap();
    let near = scan.expected().iter().filter(|p| p.iter().all(|v| v.abs() <= 1e12)).count();
    assert_eq!(found.points.len(), near);
    assert_eq!(found.counts.not_finite, 200_000 - near as u64);
    assert_eq!(found.warnings.matches("beyond 1e12 m").count(), 1);
}

#[test]
fn the_reference_system_is_found_after_the_points_and_agreed_on_over_files() {
    let folder = Folder::new();
    let with = |name: &str, text: &str| {
        let mut scan = Scan::new(4, 6, 5);
        scan.evlrs.push(("other", 1, vec![1; 70]));
        scan.evlrs.push(("LASF_Projection", 2112, text.as_bytes().to_vec()));
        folder.file(name, &scan.las())
    };
    let feet = "PROJCS[\"b\",UNIT[\"foot\",0.3048]]";
    let (a, b) = (with("a.las", feet), with("b.las", "PROJCS[\"a\",UNIT[\"metre\",1]]"));
    let heard = Heard::default();
    let set = InputSet::open(std::slice::from_ref(&a), InputOptions::default(), &heard).unwrap();
    assert_eq!((set.crs(), set.files()[0].unit_m()), (Some(feet), [0.3048; 3]));
    assert!(heard.0.lock().unwrap().is_empty());
    for order in [[a.clone(), b.clone()], [b, a]] {
        let set = InputSet::open(&order, InputOptions::default(), &heard).unwrap();
        assert!(set.crs().unwrap().starts_with("PROJCS[\"a\""));
        assert_eq!(set.files()[0].unit_m(), [0.3048; 3]);
    }
    assert!(heard.0.lock().unwrap()[0].contains("a.las (b) state different reference systems"));
}

#[test]
fn flipped_bytes_give_points_or_one_line_and_never_a_panic() {
    let folder = Folder::new();
    let scans = [
        Scan::new(2, 1, 300).laz(120),
        Scan::new(4, 7, 300).laz(0),
        Scan::new(4, 9, 200).laz(90),
        Scan::new(4, 6, 60).las(),
    ];
    for (index, good) in scans.iter().enumerate() {
        for at in (0..good.len()).filter(|at| *at < 700 || at % 5 == 0 || *at + 80 > good.len()) {
            let mut bad = good.clone();
            bad[at] ^= [0x01, 0x80, 0xFF][(at + index) % 3];
            let path = folder.file("flip.laz", &bad);
            if let Err(error) = read_one(&path) {
                let text = error.to_string();
                assert!(text.starts_with(path.to_str().unwrap()) && !text.contains('\n'), "scan {index}: {text}");
            }
        }
    }
}

#[test]
fn other_files_are_named_for_what_they_are() {
    let folder = Folder::new();
    let text = refusal(&folder.file("notes.laz", b"x y z\n1 2 3\n"));
    assert!(text.contains("found text: \"x y z\""), "{text}");
    assert!(refusal(&folder.file("nothing.las", b"")).contains("an empty file"));
    assert!(refusal(&folder.0.path().join("none.las")).contains("cannot open"));
    assert!(read_one(&folder.file("scan.dat", &Scan::new(2, 0, 3).las())).is_ok(), "a scan under another name");
}

#[test]
fn threads_and_the_order_of_units_change_nothing() {
    let folder = Folder::new();
    let (plain, packed) = (Scan::new(2, 3, 300_000), Scan::new(4, 7, 20_000));
    let paths = [folder.file("a.las", &plain.las()), folder.file("b.laz", &packed.laz(3000))];
    let one = read(&paths, InputOptions::default()).unwrap();
    let set = InputSet::open(&paths, InputOptions::default(), &NoMonitor).unwrap();
    let mut chunks: Vec<PointChunk> = set.chunks().collect();
    assert_eq!(chunks.len(), 3 + 7);
    assert_eq!(chunks.iter().map(PointChunk::points).sum::<u64>(), set.points_stated());
    chunks.reverse();
    let all = Mutex::new(Read::default());
    std::thread::scope(|scope| {
        for part in chunks.chunks(4) {
            let (set, all) = (&set, &all);
            scope.spawn(move || {
                let mut decoder = PointDecoder::new();
                for chunk in part {
                    let mut points = Vec::new();
                    let counts = decoder.decode(set, chunk, &mut |b| {
                        points.extend((0..b.len()).map(|i| [b.x[i], b.y[i], b.z[i]]));
                        Ok(())
                    });
                    let mut all = all.lock().unwrap();
                    all.counts += counts.unwrap();
                    all.points.extend(points);
                }
            });
        }
    });
    let all = all.into_inner().unwrap();
    assert_eq!(all.counts, one.counts);
    assert!(all.sorted() == one.sorted());
}

#[test]
fn an_error_of_the_sink_ends_the_work() {
    let folder = Folder::new();
    let path = folder.file("a.laz", &Scan::new(4, 6, 20_000).laz(5000));
    let set = InputSet::open(&[path], InputOptions::default(), &NoMonitor).unwrap();
    let chunk = set.chunks().next().unwrap();
    let outcome = PointDecoder::new().decode(&set, &chunk, &mut |_| Err(Error::Interrupted));
    assert!(matches!(outcome, Err(Error::Interrupted)));
}

#[test]
fn spacing_is_the_same_for_shuffled_points_split_files_and_any_number_of_threads() {
    let folder = Folder::new();
    let mut scan = Scan::new(2, 0, 150_000);
    for (i, record) in scan.records.iter_mut().enumerate() {
        let raw = [(i % 390) * 5 + i % 3, (i / 390) * 5 + i % 2, i % 4].map(|v| (v as i32).to_le_bytes());
        record[..12].copy_from_slice(&raw.concat());
    }
    let spacing = |files: Vec<Vec<u8>>, threads| {
        let paths: Vec<_> = files.iter().enumerate().map(|(i, f)| folder.file(&format!("{i}.laz"), f)).collect();
        let set = InputSet::open(&paths, InputOptions::default(), &NoMonitor).unwrap();
        estimate_spacing(&set, threads, &NoMonitor).unwrap()
    };
    let first = spacing(vec![scan.las()], 1);
    assert!((0.04..0.06).contains(&first.spacing_m), "{first:?}");
    let mut mixed = scan.clone();
    let key: HashMap<Vec<u8>, usize> =
        mixed.records.iter().enumerate().map(|(i, r)| (r.clone(), i.wrapping_mul(0x9E37_79B9) % 1_000_003)).collect();
    mixed.records.sort_by_key(|r| key[r]);
    assert_eq!(spacing(vec![mixed.laz(9000)], 3), first);
    let mut parts = Vec::new();
    for part in mixed.records.chunks(40_000) {
        parts.push(Scan { records: part.to_vec(), ..mixed.clone() }.las());
    }
    assert_eq!(spacing(parts, 4), first);
}
