//! Scan files as found in practice: the result of each of them, and of damage.
//!
//! Real files come from a folder outside the repository; tests that need it say so and pass if it is missing. Damaged
//! files are made here, from a few lines of bytes.

use crate::data;
use crate::las::{Folder, Read, Scan, read, read_one, read_strictly, refusal};
use crate::reading::Listener;

use slicewalk::plan::Up;
use slicewalk::{Error, NoMonitor};
use slicewalk_input::spacing::estimate_spacing;
use slicewalk_input::{InputOptions, InputSet, PointChunk, PointCounts, PointDecoder, Units};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Mutex;

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
        let heard = Listener::default();
        let set = InputSet::open(&[data.join(name)], options, &heard).unwrap();
        assert_eq!(set.files()[0].unit_m(), [2.0; 3], "an explicit unit overrides {name}");
        // Other units than lengths are told of all the same.
        assert_eq!(heard.said().concat().contains("degrees"), crs == "EPSG:4326", "{name}");
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
        // One real scan; generated ones have a test of their own.
        if name == "pump_room.laz" {
            assert_eq!(estimate_spacing(&set, 1, &NoMonitor).unwrap(), found);
        }
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
    let heard = Listener::default();
    let set = InputSet::open(std::slice::from_ref(&a), InputOptions::default(), &heard).unwrap();
    assert_eq!((set.crs(), set.files()[0].unit_m()), (Some(feet), [0.3048; 3]));
    assert!(heard.said().is_empty());
    for order in [[a.clone(), b.clone()], [b, a]] {
        let set = InputSet::open(&order, InputOptions::default(), &heard).unwrap();
        assert!(set.crs().unwrap().starts_with("PROJCS[\"a\""));
        assert_eq!(set.files()[0].unit_m(), [0.3048; 3]);
    }
    assert!(heard.said()[0].contains("a.las (b) state different reference systems"));
}

#[test]
fn well_known_text_in_utf_16_is_read_and_a_record_that_is_no_text_is_warned_of() {
    let folder = Folder::new();
    let feet = "PROJCS[\"b\",UNIT[\"foot\",0.3048]]";
    let open = |body: Vec<u8>, units: Units| {
        let mut scan = Scan::new(4, 6, 5);
        scan.evlrs.push(("LASF_Projection", 2112, body));
        let (path, heard) = (folder.file("a.las", &scan.las()), Listener::default());
        let options = InputOptions { units, ..InputOptions::default() };
        let set = InputSet::open(&[path], options, &heard).unwrap();
        (set.crs().map(str::to_owned), set.files()[0].unit_m(), heard.said())
    };
    let utf_16 = feet.encode_utf16().flat_map(u16::to_le_bytes).collect();
    assert_eq!(open(utf_16, Units::Auto), (Some(feet.to_owned()), [0.3048; 3], Vec::new()));
    for units in [Units::Auto, Units::Factor(1.0)] {
        let utf_32 = feet.chars().flat_map(|c| u32::from(c).to_le_bytes()).collect();
        let (system, unit, said) = open(utf_32, units);
        assert_eq!((system, unit), (None, [1.0; 3]));
        assert!(
            said[0].ends_with("a.las: the well-known text of its reference system is unreadable; it is passed over")
        );
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
    for (name, advice) in [
        ("a.off", "write it as OBJ, PLY, STL or glTF"),
        ("a.FBX", "write it as OBJ, PLY, STL or glTF"),
        ("a.rcp", "write it as LAS, LAZ, E57, PLY, PCD, PTS, PTX or XYZ"),
        ("a.lsproj", "write it as LAS, LAZ, E57, PLY, PCD, PTS, PTX or XYZ"),
        ("a.slices", "a slice archive holds no points"),
    ] {
        let text = refusal(&folder.file(name, b"anything"));
        assert!(text.contains(advice) && text.matches("write it as").count() < 2, "{name}: {text}");
    }
}

#[test]
fn units_have_names_or_are_plausible_numbers() {
    let named = ["auto", "m", "ft", "us-ft", "0.001"].map(|text| text.parse::<Units>().unwrap());
    let factors = [1.0, 0.3048, 1200.0 / 3937.0, 0.001].map(Units::Factor);
    assert_eq!(named.to_vec(), [&[Units::Auto][..], &factors].concat());
    for text in ["", "0", "-1", "nan", "inf", "feet"] {
        assert!(text.parse::<Units>().unwrap_err().contains("expected auto, m, ft, us-ft"), "{text}");
    }
    // A program may give any number.
    for factor in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300] {
        let options = InputOptions { units: Units::Factor(factor), ..InputOptions::default() };
        let error = InputSet::of_paths(vec!["none.las".into()], options, &NoMonitor).map(drop).unwrap_err();
        assert!(error.to_string().contains("is not a number of metres per unit"), "{error}");
    }
}

#[test]
fn projection_records_that_are_too_long_are_passed_over() {
    let folder = Folder::new();
    let mut scan = Scan::new(4, 6, 5);
    let mut text = b"PROJCS[\"b\",UNIT[\"foot\",0.3048]]".to_vec();
    text.resize((1 << 20) + 1, b' ');
    scan.evlrs.push(("LASF_Projection", 2112, text));
    scan.evlrs.push(("LASF_Projection", 34735, vec![0; (1 << 16) + 8]));
    let heard = Listener::default();
    let set = InputSet::open(&[folder.file("a.las", &scan.las())], InputOptions::default(), &heard).unwrap();
    assert_eq!((set.crs(), set.files()[0].unit_m(), set.points_stated()), (None, [1.0; 3], 5));
    let said = heard.said().join("\n");
    for words in ["record 2112 at byte", "1048577 bytes long", "record 34735 at byte", "65544 bytes long"] {
        assert!(said.contains(words), "{words}: {said}");
    }
}

/// No piece is read from a file of another kind, whose bytes would give points that no scan has.
#[test]
fn pieces_of_another_set_are_refused() {
    let folder = Folder::new();
    let (plain, packed) = (Scan::new(2, 3, 30), Scan::new(2, 3, 30));
    let files = [
        folder.file("a.las", &plain.las()),
        folder.file("b.laz", &packed.laz(10)),
        folder.file("c.xyz", b"1 2 3\n4 5 6\n7 8 9\n"),
    ];
    let open = |paths: &[PathBuf]| InputSet::open(paths, InputOptions::default(), &NoMonitor).unwrap();
    let sets: Vec<InputSet> = files.iter().map(|path| open(std::slice::from_ref(path))).collect();
    assert_eq!(sets.iter().map(|set| set.files()[0].format()).collect::<Vec<_>>(), ["LAS", "LAZ", "text"]);
    let refused = |set: &InputSet, piece: &PointChunk| {
        let mut passed = 0;
        let done = PointDecoder::new().decode(set, piece, &mut |batch| {
            passed += batch.len();
            Ok(())
        });
        done.is_err_and(|error| error.to_string().contains("another set")) && passed == 0
    };
    for (own, set) in sets.iter().enumerate() {
        for piece in set.chunks() {
            let others: Vec<usize> = (0..sets.len()).filter(|&other| refused(&sets[other], &piece)).collect();
            assert_eq!(others, (0..sets.len()).filter(|&other| other != own).collect::<Vec<_>>(), "{own}");
        }
    }
    // A set of fewer files.
    let last = open(&files).chunks().last().unwrap();
    assert!(last.file() == 2 && sets.iter().all(|set| refused(set, &last)));
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
fn waveforms_behind_the_points_are_no_points() {
    let folder = Folder::new();
    let scan = Scan::new(3, 4, 10);
    let plain = scan.las();
    let mut head = [0; 60];
    head[2..11].copy_from_slice(b"LASF_Spec");
    head[18..20].copy_from_slice(&u16::MAX.to_le_bytes());
    let mut bytes = [&plain[..], &head, &[7; 1000]].concat();
    bytes[227..235].copy_from_slice(&(plain.len() as u64).to_le_bytes());
    let strictly = |bytes: &[u8]| read_strictly(&[folder.file("a.las", bytes)], InputOptions::default());
    assert_eq!(strictly(&bytes).unwrap().points, scan.expected());
    // Some programs write another owner of the record.
    bytes[plain.len() + 2..plain.len() + 11].copy_from_slice(b"LAS_Spec\0");
    assert_eq!(strictly(&bytes).unwrap().points, scan.expected());
    bytes[107] = 12;
    let said = refusal(&folder.file("a.las", &bytes));
    assert!(said.contains("the header states 12 points, the file holds 10 whole ones"), "{said}");
    // A place without such a record means nothing.
    let mut stray = plain.clone();
    stray[227..235].copy_from_slice(&(plain.len() as u64 / 2).to_le_bytes());
    assert_eq!(strictly(&stray).unwrap().points, scan.expected());
    // Nor does it hide points that the header does not count.
    stray[107] = 5;
    let said = refusal(&folder.file("a.las", &stray));
    assert!(said.contains("the header states 5 points, but its records have room for 10"), "{said}");
}

#[test]
fn an_error_of_the_sink_ends_the_work() {
    let folder = Folder::new();
    let path = folder.file("a.laz", &Scan::new(4, 6, 20_000).laz(5000));
    let set = InputSet::open(&[path], InputOptions::default(), &NoMonitor).unwrap();
    let chunk = set.chunks().next().unwrap();
    let outcome = PointDecoder::new().decode(&set, &chunk, &mut |_| Err(Error::Interrupted));
    assert!(matches!(outcome, Err(Error::Interrupted)));
    // It is no loss of the input, which may be incomplete.
    for path in [
        folder.file("b.laz", &Scan::new(2, 1, 20_000).laz(5000)),
        folder.file("c.las", &Scan::new(2, 1, 20_000).las()),
        folder.file("d.xyz", b"1 2 3\n4 5 6\n"),
    ] {
        let options = InputOptions { allow_incomplete: true, ..InputOptions::default() };
        let set = InputSet::open(&[path], options, &NoMonitor).unwrap();
        let chunk = set.chunks().next().unwrap();
        let outcome = PointDecoder::new()
            .decode(&set, &chunk, &mut |_| Err(Error::io("disk", "write", std::io::Error::other("no space"))));
        assert!(outcome.is_err_and(|error| error.to_string().contains("no space")));
        set.check_complete(&NoMonitor).unwrap();
        assert!(set.is_complete());
    }
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
