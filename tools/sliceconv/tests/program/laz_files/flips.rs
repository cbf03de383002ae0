//! Flipped bits of LAZ files: errors, or the points that other programs read.

use crate::las::{Folder, RECORD_BYTES, Scan, chunk_places, numbers, read_one, read_strictly, varied};
use laz::laszip::LazVlr;
use laz::{DecompressionSelection, LasZipDecompressor};
use slicewalk::colour::ColourSource;
use slicewalk::{NoMonitor, Result};
use slicewalk_input::{InputOptions, InputSet, PointCounts, PointDecoder, Tag};
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};

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

/// Bits of a decoded point: coordinates, colour value, tag.
type Fields = ([u64; 3], Option<[u16; 3]>, Option<u64>);

/// Fields that a conversion reads in addition to coordinates and flags.
#[derive(Debug, Clone, Copy)]
struct Used {
    class: bool,
    colour: Option<ColourSource>,
    tag: Option<Tag>,
}

impl Used {
    const NOTHING: Self = Self { class: false, colour: None, tag: None };
    const ALL: [Self; 6] = [
        Self::NOTHING,
        Self { class: true, colour: Some(ColourSource::Class), ..Self::NOTHING },
        Self { colour: Some(ColourSource::Intensity), ..Self::NOTHING },
        Self { class: true, colour: Some(ColourSource::Rgb), ..Self::NOTHING },
        Self { tag: Some(Tag::SourceId), ..Self::NOTHING },
        Self { tag: Some(Tag::GpsTime), ..Self::NOTHING },
    ];

    /// Reads the file `path`.
    fn read(self, path: &Path) -> Result<(PointCounts, Vec<Fields>)> {
        let exclude_classes = self.class.then_some(3).into_iter().collect();
        let options = InputOptions { exclude_classes, colour: self.colour, ..InputOptions::default() };
        let mut set = InputSet::open(&[path.to_path_buf()], options, &NoMonitor)?;
        set.set_tag(self.tag);
        let (mut counts, mut points, mut decoder) = (PointCounts::default(), Vec::new(), PointDecoder::new());
        for chunk in set.chunks() {
            counts += decoder.decode(&set, &chunk, &mut |batch| {
                points.extend((0..batch.len()).map(|i| {
                    let place = [batch.x[i], batch.y[i], batch.z[i]].map(f64::to_bits);
                    (place, batch.values.get(i).copied(), batch.tags.get(i).copied().map(f64::to_bits))
                }));
                Ok(())
            })?;
        }
        set.check_complete(&NoMonitor)?;
        Ok((counts, points))
    }

    /// Returns these fields as a selection of `laz`.
    fn selection(self) -> DecompressionSelection {
        let all = DecompressionSelection::base().decompress_z().decompress_flags();
        let all = match self.colour {
            Some(ColourSource::Rgb) => all.decompress_rgb(),
            Some(ColourSource::Intensity) => all.decompress_intensity(),
            _ => all,
        };
        let all = if self.class { all.decompress_classification() } else { all };
        match self.tag {
            Some(Tag::SourceId) => all.decompress_point_source_id(),
            Some(Tag::GpsTime) => all.decompress_gps_time(),
            None => all,
        }
    }
}

/// Returns a LAS file with the fields that `laz` decodes from a LAZ file of up to 1000 points, trusting the file's own
/// header; `None` if `laz` cannot read it.
fn plain_by_laz(packed: &[u8], selection: DecompressionSelection) -> Option<Vec<u8>> {
    let number = |at: usize, bytes: usize| {
        let mut eight = [0; 8];
        eight[..bytes].copy_from_slice(packed.get(at..at + bytes)?);
        Some(u64::from_le_bytes(eight) as usize)
    };
    let (mut at, mut record_at) = (number(94, 2)?, 0);
    let vlr = (0..number(100, 4)?).find_map(|_| {
        record_at = at;
        let body = at + 54..at + 54 + number(at + 20, 2)?;
        let is_it = packed.get(at + 2..)?.starts_with(LazVlr::USER_ID.as_bytes()) && number(at + 18, 2)? == 22204;
        at = body.end;
        is_it.then(|| packed.get(body)).flatten()
    })?;
    let vlr = LazVlr::from_buffer(vlr).ok()?;
    let points = if packed[25] < 4 { 0 } else { number(247, 8)? };
    let points = Some(if points == 0 { number(107, 4)? } else { points }).filter(|points| *points <= 1000)?;
    let (points_at, bytes) = (number(96, 4)?, vlr.items_size() as usize);
    let mut plain = packed.get(..points_at)?.to_vec();
    // The result is not compressed, so it has no LASzip record.
    plain[104] &= 0x7F;
    plain[record_at + 2] = b'_';
    plain[105..107].copy_from_slice(&(bytes as u16).to_le_bytes());
    plain.resize(points_at + points * bytes, 0);
    let mut file = std::io::Cursor::new(packed);
    file.set_position(points_at as u64);
    // Damage can make `laz` panic.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let decoded = std::panic::catch_unwind(AssertUnwindSafe(|| {
        let mut decoder = LasZipDecompressor::selective(file, vlr, selection).ok()?;
        decoder.decompress_many(&mut plain[points_at..]).ok()
    }));
    std::panic::set_hook(hook);
    decoded.ok()??;
    Some(plain)
}

/// Flips as many single bits as `SLICEWALK_FLIPS` says, anywhere in files of each format, and counts the results. A
/// flip is refused, changes nothing that is read, or gives exactly the points that `laz` reads from the same bytes.
#[test]
#[ignore = "takes minutes: `.ci/long flips`"]
fn flipped_bits_by_the_million() {
    let flips: u64 = std::env::var("SLICEWALK_FLIPS").map_or(20_000, |text| text.parse().unwrap());
    let formats = std::env::var("SLICEWALK_FORMATS").unwrap_or("6 7 8 1 3".into());
    let formats: Vec<u8> = formats.split_whitespace().map(|format| format.parse().unwrap()).collect();
    // Held in memory, because files would take most of the time.
    let path = PathBuf::from("/no folder/flip.laz");
    let read = |bytes: &[u8], used: Used| {
        slicewalk::bytes::testing::hold(&path, bytes);
        used.read(&path)
    };
    let mut random = numbers(0x9E37_79B9_7F4A_7C15);
    for format in formats {
        let [mut refused, mut same, mut header, mut first, mut packed, mut in_part] = [0u64; 6];
        let mut alone = Vec::new();
        let of_each = 2000.min(flips);
        for round in 0..flips.div_ceil(of_each) {
            let mut scan = varied(format, 120, 0, &mut random);
            // One scanner channel, two, or all.
            let channels = [0xCF, 0xDF, 0xFF][round as usize % 3];
            scan.records.iter_mut().filter(|_| format > 5).for_each(|record| record[15] &= channels);
            let chunk = [50, 0, 30, 1000][round as usize % 4];
            let good = scan.laz(chunk);
            let places = chunk_places(&good, &scan, chunk);
            let expected = Used::ALL.map(|used| read(&good, used).unwrap());
            for _ in 0..of_each {
                let at = random() as usize % good.len();
                let mut bad = good.clone();
                bad[at] ^= 1 << (random() % 8);
                let number = random() as usize % Used::ALL.len();
                let used = Used::ALL[number];
                let Ok(found) = read(&bad, used) else {
                    refused += 1;
                    continue;
                };
                if found == expected[number] {
                    same += 1;
                    continue;
                }
                let is_by_laz = |selection| {
                    plain_by_laz(&bad, selection)
                        .is_some_and(|plain| read(&plain, used).is_ok_and(|theirs| theirs == found))
                };
                let bytes = scan.records[0].len();
                match is_by_laz(DecompressionSelection::all()) {
                    true if at < places[0] => header += 1,
                    true if places.iter().any(|&place| (place..place + bytes).contains(&at)) => first += 1,
                    true => packed += 1,
                    // The damage shows only in layers of other fields.
                    false if is_by_laz(used.selection()) => in_part += 1,
                    false => alone.push((at, used)),
                }
            }
        }
        println!(
            "format {format}: {refused} flips refused, {same} change nothing that is read; other points, which laz \
             reads too: {header} in the header, {first} in first points, {packed} in packed ones, {in_part} if laz decodes \
             only the same fields; read by Slicewalk only: {}",
            alone.len()
        );
        alone.iter().take(20).for_each(|(at, used)| println!("  by Slicewalk only: byte {at}, {used:?}"));
        assert!(alone.is_empty(), "format {format}: {} of {flips}", alone.len());
    }
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
