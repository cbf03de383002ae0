use super::geotiff::{GEOCENTRIC_MODEL, unit_in_words};
use super::*;
use crate::epsg::{FOOT, US_SURVEY_FOOT};
use crate::records::{GEO_DOUBLES, GEO_TEXT};

fn wkt(text: &str) -> Georeference {
    Georeference::from_wkt(text.to_string())
}

#[test]
fn the_unit_of_the_projection_counts_and_not_that_of_the_angles() {
    let found = wkt(
        r#"PROJCS["P [ftUS]",GEOGCS["G",UNIT["degree",0.0174532925199433]],UNIT["US survey foot",0.304800609601219]]"#,
    );
    assert_eq!((found.horizontal, found.vertical, found.degrees), (Some(US_SURVEY_FOOT), None, false));
}

#[test]
fn heights_may_have_another_unit() {
    let found = wkt(
        r#"COMPD_CS["C",PROJCS["P",GEOGCS["G",UNIT["degree",0.0174]],UNIT["metre",1]],VERT_CS["V",VERT_DATUM["D",2005],UNIT["US survey foot",0.3048006096012192],AXIS["Up",UP]]]"#,
    );
    assert_eq!((found.horizontal, found.vertical), (Some(1.0), Some(US_SURVEY_FOOT)));
    let found = wkt(
        r#"COMPOUNDCRS["C",PROJCRS["P",BASEGEOGCRS["G",UNIT["degree",0.0174]],CONVERSION["c",PARAMETER["x",1,LENGTHUNIT["metre",1]]],CS[Cartesian,2],AXIS["(E)",east,ORDER[1],LENGTHUNIT["foot",0.3048]],AXIS["(N)",north,LENGTHUNIT["foot",0.3048]]],VERTCRS["V",VDATUM["D"],CS[vertical,1],AXIS["H",up,LENGTHUNIT["metre",1]]]]"#,
    );
    assert_eq!((found.horizontal, found.vertical), (Some(FOOT), Some(1.0)));
}

/// Returns metres per unit of x and y, and of heights.
fn units(text: &str) -> (Option<f64>, Option<f64>) {
    let found = wkt(text);
    assert!(!found.notes.iter().any(|note| note.contains("damaged")), "{text}: {:?}", found.notes);
    (found.horizontal, found.vertical)
}

const GEOGRAPHIC: &str =
    r#"GEOGCS["G",DATUM["D",SPHEROID["S",6378137,298.25]],PRIMEM["Greenwich",0],UNIT["Degree",0.0174532925199433]]"#;

#[test]
fn systems_stand_side_by_side_in_each_other_or_behind_too_many_brackets() {
    let feet = r#"UNIT["Foot_US",0.3048006096012192]"#;
    let ground = format!(r#"PROJCS["P",{GEOGRAPHIC},PROJECTION["Albers"],PARAMETER["x",0],UNIT["Meter",1.0]"#);
    for word in ["VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS", "vert_cs"] {
        let heights = format!(r#"{word}["V",VDATUM["D"],PARAMETER["Direction",1.0],{feet}"#);
        for text in [
            format!("{ground}],{heights}]"),
            format!("{ground}]{heights}]"),
            format!("{ground}] \n {heights}]"),
            format!("{ground},{heights}]]"),
            format!("{ground},{heights}],AUTHORITY[\"EPSG\",\"2903\"]]"),
            format!("{heights}],{ground}]"),
            format!("COMPD_CS[\"C\",{ground}],{heights}]]"),
            format!("COMPD_CS[\"C\",{ground}]],{heights}]]"),
            format!("COMPD_CS[\"C\",{ground}],{heights}"),
            format!("COMPD_CS[\"C\",{ground},{heights}]]"),
            format!("COMPD_CS[\"C\",{ground}]]],{heights}]]]"),
        ] {
            for text in [text.clone(), text.replace('[', "(").replace(']', ")"), text.to_lowercase()] {
                assert_eq!(units(&text), (Some(1.0), Some(US_SURVEY_FOOT)), "{text}");
            }
        }
    }
    // A surplus or missing bracket before the unit of the map itself.
    let map = r#"PROJECTION["Albers"],UNIT["foot",0.3048]"#;
    let heights = r#"VERT_CS["V",VERT_DATUM["D",2005],UNIT["metre",1],AXIS["Up",UP]]"#;
    let open = &GEOGRAPHIC[..GEOGRAPHIC.len() - 1];
    for text in [
        format!("PROJCS[\"P\",{GEOGRAPHIC}],{map}],{heights}"),
        format!("PROJCS[\"P\",{open},{map}]],{heights}"),
        format!("COMPD_CS[\"C\",PROJCS[\"P\",{GEOGRAPHIC}],{map}],{heights}]"),
        format!("COMPD_CS[\"C\",PROJCS[\"P\",{open},{map}],{heights}]]"),
        format!("PROJCS[\"P\",{GEOGRAPHIC},{map}],{}]", heights.replace(",UNIT", "],UNIT")),
    ] {
        assert_eq!(units(&text), (Some(FOOT), Some(1.0)), "{text}");
    }
}

#[test]
fn text_of_the_second_kind_states_units_by_system_by_axis_or_by_what_it_is_derived_from() {
    let foot = r#"LENGTHUNIT["US survey foot",0.304800609601219]"#;
    let metre = r#"LENGTHUNIT["metre",1]"#;
    let base = r#"BASEGEOGCRS["G",DATUM["D",ELLIPSOID["E",6378137,298.25,LENGTHUNIT["metre",1]]]],CONVERSION["c",METHOD["m"]]"#;
    let projected = |axes: &str| format!(r#"PROJCRS["P",{base},{axes}]"#);
    let feet = Some(US_SURVEY_FOOT);
    for (axes, expected) in [
        (
            format!(r#"CS[Cartesian,3],AXIS["E",east,{metre}],AXIS["N",north,{metre}],AXIS["h",up,{foot}]"#),
            (Some(1.0), feet),
        ),
        (
            format!(r#"CS[Cartesian,3],AXIS["h",up,{foot}],AXIS["E",east,{metre}],AXIS["N",north,{metre}]"#),
            (Some(1.0), feet),
        ),
        (format!(r#"CS[Cartesian,3],AXIS["E",east],AXIS["N",north],AXIS["h",up,{metre}],{foot}"#), (feet, Some(1.0))),
        (format!(r#"CS[Cartesian,3],AXIS["E",east],AXIS["N",north],AXIS["h",up],{foot}"#), (feet, None)),
        (format!(r#"CS[Cartesian,2],AXIS["E",east],AXIS["N",north],{foot},ID["EPSG",26915]"#), (feet, None)),
    ] {
        assert_eq!(units(&projected(&axes)), expected, "{axes}");
        let vertical = format!(r#"VERTCRS["V",VDATUM["D"],CS[vertical,1],AXIS["H",up],{foot}]"#);
        let joined = format!(r#"COMPOUNDCRS["C",{},{vertical}]"#, projected(&axes));
        assert_eq!(units(&joined), (expected.0, feet), "{joined}");
        let bound = format!(r#"BOUNDCRS[SOURCECRS[{joined}],TARGETCRS[GEOGCRS["WGS 84",CS[ellipsoidal,3]]]]"#);
        assert_eq!((units(&bound), wkt(&bound).degrees), ((expected.0, feet), false), "{bound}");
        let dated = format!(r#"COORDINATEMETADATA[{joined},EPOCH[2020]]"#);
        assert_eq!(units(&dated), (expected.0, feet), "{dated}");
    }
    let axes = format!(r#"CS[Cartesian,2],AXIS["E",east],AXIS["N",north],{foot}"#);
    let of_base = format!(r#"BASEPROJCRS["P",{base},{axes}],DERIVINGCONVERSION["d",METHOD["Affine"]]"#);
    assert_eq!(units(&format!(r#"DERIVEDPROJCRS["S",{of_base},{axes}]"#)), (feet, None));
    assert_eq!(units(&format!(r#"DERIVEDPROJCRS["S",{of_base},CS[Cartesian,2]]"#)), (feet, None));
    assert_eq!(units(&format!(r#"DERIVEDPROJCRS["S",{of_base},CS[Cartesian,2],{metre}]"#)), (Some(1.0), None));
    let of_base = format!(r#"BASEVERTCRS["V",VDATUM["D"],CS[vertical,1],{foot}]"#);
    assert_eq!(units(&format!(r#"VERTCRS["W",{of_base},DERIVINGCONVERSION["d",METHOD["m"]]]"#)), (None, feet));
    assert_eq!(
        units(&format!(
            r#"ENGCRS["S",EDATUM["D"],CS[Cartesian,3],AXIS["x",east],AXIS["y",north],AXIS["z",up,{metre}],{foot}]"#
        )),
        (feet, Some(1.0))
    );
    assert_eq!(units(r#"LOCAL_CS["S",LOCAL_DATUM["D",1],UNIT["foot",0.3048],AXIS["x",EAST]]"#), (Some(FOOT), None));
    let ellipsoidal = format!(
        r#"GEOGCRS["G",DATUM["D"],CS[ellipsoidal,3],AXIS["lat",north,ANGLEUNIT["degree",0.0174]],AXIS["h",up,{foot}]]"#
    );
    assert_eq!((units(&ellipsoidal), wkt(&ellipsoidal).degrees), ((None, feet), true));
    let geocentric = format!(r#"GEODCRS["G",DATUM["D"],CS[Cartesian,3],AXIS["X",geocentricX],{metre}]"#);
    let geocentric = wkt(&geocentric);
    let of_the_first_kind = wkt(r#"GEOCCS["G",DATUM["D"],PRIMEM["Greenwich",0],UNIT["metre",1],AXIS["X",OTHER]]"#);
    assert_eq!((of_the_first_kind.horizontal, of_the_first_kind.degrees), (Some(1.0), false));
    assert_eq!(of_the_first_kind.notes, [GEOCENTRIC]);
    assert_eq!((geocentric.degrees, geocentric.notes.as_slice()), (false, [GEOCENTRIC.to_owned()].as_slice()));
}

#[test]
fn units_without_a_sound_factor_go_by_their_name_or_code_and_systems_without_units_by_theirs() {
    for (unit, expected) in [
        (r#"UNIT["US survey foot",1.0]"#, Some(US_SURVEY_FOOT)), // as some programs write it
        (r#"UNIT["Foot_US"]"#, Some(US_SURVEY_FOOT)),
        (r#"UNIT["Foot_US",0.3048006]"#, Some(US_SURVEY_FOOT)),
        (r#"UNIT["their foot",0.31]"#, Some(0.31)),
        (r#"UNIT["their foot",AUTHORITY["EPSG","9002"]]"#, Some(FOOT)),
        (r#"UNIT["metre",1,AUTHORITY["EPSG","9001"]]"#, Some(1.0)),
        (r#"UNIT["Degree",0.0174532925199433]"#, None),
        (r#"AUTHORITY["EPSG","2229"]"#, Some(US_SURVEY_FOOT)),
    ] {
        assert_eq!(units(&format!(r#"PROJCS["P",{GEOGRAPHIC},{unit}]"#)).0, expected, "{unit}");
    }
    assert_eq!(units(r#"PROJCS["P",UNIT["metre",1]],VERT_CS["V",AUTHORITY["EPSG","6360"]]"#).1, Some(US_SURVEY_FOOT));
    let joined =
        r#"COMPD_CS["C",PROJCS["P",UNIT["metre",1]],VERT_CS["V",VERT_DATUM["D",2005]],AUTHORITY["EPSG","8720"]]"#;
    assert_eq!(units(joined).1, epsg::system(8720).and_then(|system| system.up));
    let text = r#"PROJCS["P",UNIT["Foot_US",0.3048006096012192]]"#;
    for before in ["\u{feff}", "ESRI PE String = ", "\"no system\" "] {
        assert_eq!(units(&format!("{before}{text}")).0, Some(US_SURVEY_FOOT), "{before}");
    }
    // All quotes doubled, with quotes in the name; then all escaped by a backslash.
    let text = r#"PROJCS["P ""[old]"" one",UNIT["Foot_US",0.3048006096012192]]"#;
    assert_eq!(units(text).0, Some(US_SURVEY_FOOT));
    let long = format!(r#"PROJCS["{}",UNIT["Foot_US",0.3048006096012192]]"#, "long name ".repeat(20));
    assert_eq!(units(&long).0, Some(US_SURVEY_FOOT));
    let text = r#"PROJCS["P [ftUS]",UNIT["Foot_US",0.3048006096012192]]"#;
    for text in [text.replace('"', "\"\""), text.replace('"', "\\\""), text.replacen('"', "\u{201c}", 1)] {
        assert_eq!(units(&text).0, Some(US_SURVEY_FOOT), "{text}");
    }
}

#[test]
fn depths_are_noted() {
    for text in [
        r#"VERT_CS["V",UNIT["metre",1],AXIS["Depth",DOWN]]"#,
        r#"VERTCS["V",PARAMETER["Direction",-1.0],UNIT["Meter",1.0]]"#,
        r#"VERTCRS["V",ID["EPSG",5715]]"#,
        r#"ENGCRS["S",CS[Cartesian,3],AXIS["x",east],AXIS["y",north],AXIS["z",down],LENGTHUNIT["metre",1]]"#,
        r#"GEOGCRS["G",DATUM["D"],CS[ellipsoidal,3],AXIS["lat",north],AXIS["lon",east],AXIS["d",down]]"#,
    ] {
        assert_eq!(wkt(text).notes, [DOWNWARD], "{text}");
    }
}

#[test]
fn a_text_and_keys_complete_each_other_and_the_one_that_counts_is_followed() {
    let records = |wkt: &str, entries: &[[u16; 4]]| {
        let mut records = key_records(entries, "", &[]);
        records.keep(WKT, wkt.as_bytes().iter().copied().chain([0, 0]).collect());
        records
    };
    let text = format!(r#"PROJCS["P",{GEOGRAPHIC},UNIT["Meter",1.0]]"#);
    let keys = [[1024, 0, 1, 1], [3072, 0, 1, 5070], [4096, 0, 1, 6360], [4099, 0, 1, 9003]];
    for says_wkt in [true, false] {
        let found = Georeference::read(&records(&text, &keys), says_wkt);
        assert_eq!((found.horizontal, found.vertical), (Some(1.0), Some(US_SURVEY_FOOT)));
        assert_eq!((found.text.as_deref(), found.notes.len()), (Some(text.as_str()), 0));
        let feet = [[1024, 0, 1, 1], [3072, 0, 1, 2229]];
        let found = Georeference::read(&records(&text, &feet), says_wkt);
        let counts = if says_wkt { 1.0 } else { US_SURVEY_FOOT };
        assert_eq!((found.horizontal, found.notes.len()), (Some(counts), 1), "{:?}", found.notes);
    }
    let heights = r#"VERTCS["V",UNIT["foot",0.3048]]"#;
    let found = Georeference::read(&records(&format!("{text},{heights}"), &keys), true);
    assert_eq!((found.vertical, found.notes.len()), (Some(FOOT), 1));
    // The text states no unit.
    let feet = [[1024, 0, 1, 1], [3072, 0, 1, 2229]];
    let found = Georeference::read(&records("a site", &feet), true);
    assert_eq!((found.text.as_deref(), found.horizontal), (Some("a site"), Some(US_SURVEY_FOOT)));
    assert_eq!((found.codes, found.degrees, found.notes), (vec![2229], false, vec![]));
}

#[test]
fn records_of_text_are_read_in_utf_16_and_others_are_no_name() {
    let records = |bytes: &[u8]| {
        let mut records = key_records(&[[1024, 0, 1, 1], [3072, 0, 1, 2229]], "", &[]);
        records.keep(WKT, bytes.to_vec());
        records
    };
    let text = format!(r#"PROJCS["Gauß",{GEOGRAPHIC},UNIT["Meter",1.0]]"#);
    let little = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    let big = |text: &str| text.encode_utf16().flat_map(u16::to_be_bytes).collect::<Vec<u8>>();
    for written in [text.clone(), format!("\u{feff}{text}"), format!("{text}\0"), format!("\u{feff}{text}|\0\0")] {
        for bytes in [written.as_bytes().to_vec(), little(&written), big(&written)] {
            let found = Georeference::of_record(&bytes).unwrap();
            assert_eq!((found.text.as_deref(), found.horizontal), (Some(text.as_str()), Some(1.0)), "{bytes:?}");
            assert!(found.notes.is_empty(), "{:?}", found.notes);
        }
    }
    assert_eq!(Georeference::of_record(&big("EPSG:25832")).unwrap().codes, [25832]);
    assert_eq!(Georeference::of_record(b"\0WGS 84\0\0").unwrap().text.as_deref(), Some("WGS 84"));
    assert_eq!(Georeference::of_record(b"\0 \0"), None);
    // UTF-32, UTF-16 from an odd byte on, and other bytes.
    let wide: Vec<u8> = text.chars().flat_map(|c| u32::from(c).to_le_bytes()).collect();
    for bytes in [&wide[..], b"P\0R\0", &[&[1], &little(&text)[..]].concat(), b"\x03\x80\xFF\x10"] {
        let alone = Georeference::of_record(bytes).unwrap();
        assert_eq!((alone.text, alone.notes), (None, vec![UNREADABLE.to_owned()]), "{bytes:?}");
        // The keys count instead.
        let found = Georeference::read(&records(bytes), true);
        assert_eq!((found.text.as_deref(), found.notes.len()), (Some("EPSG:2229"), 1), "{bytes:?}");
    }
}

#[test]
fn keys_name_the_unit_of_heights_by_code_by_system_or_in_words() {
    let vertical = |entries: &[[u16; 4]], text: &str| keys(entries, text, &[]).vertical;
    let feet = [3072, 0, 1, 2229];
    assert_eq!(vertical(&[feet, [4099, 0, 1, 9001]], ""), Some(1.0));
    assert_eq!(vertical(&[feet, [4096, 0, 1, 5703]], ""), Some(1.0));
    assert_eq!(vertical(&[feet, [4096, 0, 1, 6360], [4099, 0, 1, 9002]], ""), Some(FOOT));
    assert_eq!(vertical(&[feet, [4096, 0, 1, 4979]], ""), Some(1.0));
    assert_eq!(vertical(&[feet, [4096, 0, 1, 32767], [4099, 0, 1, 0]], ""), None);
    assert_eq!(vertical(&[[3072, 0, 1, 26915], [4097, GEO_TEXT, 13, 0]], "NAVD88 (ftUS)|"), Some(US_SURVEY_FOOT));
    let both = "Somewhere (m) + height (ftUS)|";
    let found = keys(&[[3073, GEO_TEXT, 30, 0], [3076, 0, 1, 9001]], both, &[]);
    assert_eq!((found.horizontal, found.vertical), (Some(1.0), Some(US_SURVEY_FOOT)));
    let degrees = keys(&[[3072, 0, 1, 4326]], "", &[]);
    assert!(degrees.degrees && degrees.horizontal.is_none());
    assert!(keys(&[[2048, 0, 1, 4759]], "", &[]).degrees);
    assert_eq!(keys(&[[1024, 0, 1, 3], [2048, 0, 1, 4978]], "", &[]).notes, [GEOCENTRIC]);
}

#[test]
fn a_code_alone_gives_the_axes_of_its_system() {
    let of = |code| {
        let mut found = Georeference::default();
        let note = found.complete(code).unwrap();
        (found.degrees, found.horizontal, found.vertical, note.is_some())
    };
    for degrees in [4167, 4258, 4326, 4674, 4759, 4807, 9000] {
        assert_eq!(of(degrees), (true, None, None, false), "{degrees}");
    }
    assert_eq!(of(4979), (true, None, Some(1.0), false));
    assert_eq!(of(2229), (false, Some(US_SURVEY_FOOT), None, false));
    assert_eq!(of(5555), (false, Some(1.0), Some(1.0), false));
    assert_eq!(of(6360), (false, None, Some(US_SURVEY_FOOT), false));
    assert_eq!(of(900_913), (false, None, None, true));
    let mut of_metres = Georeference { horizontal: Some(1.0), ..Georeference::default() };
    assert_eq!(of_metres.complete(900_913), Ok(None));
    let text = |text: &str| Georeference::of_text(text.to_owned());
    // Where --units counts, metres are not taken.
    let mut feet = text("EPSG:2229");
    feet.take_metres();
    assert_eq!(feet.notes.len(), 1, "{:?}", feet.notes);
    feet.drop_notes_of_units();
    assert!(feet.notes.is_empty(), "{:?}", feet.notes);
    assert_eq!(text("EPSG:2229+5703").codes, [2229, 5703]);
    assert_eq!((text("EPSG:2229+5703").horizontal, text("EPSG:2229+5703").vertical), (Some(US_SURVEY_FOOT), Some(1.0)));
    assert!(text("urn:ogc:def:crs:EPSG::4674").degrees);
    assert_eq!(text("a site of ours").codes, [0; 0]);
    assert_eq!(["EPSG:5555", "EPSG:4979", "EPSG:25832"].map(projected_epsg), [None, None, Some(25832)]);
    assert_eq!(
        projected_epsg(r#"PROJCS["P",AUTHORITY["EPSG","25832"]],VERTCS["V",AUTHORITY["EPSG","5783"]]"#),
        Some(25832)
    );
}

#[test]
fn codes_are_those_of_the_system_and_its_parts_and_not_of_what_these_rest_on() {
    let found = wkt(
        r#"PROJCRS["P",BASEGEOGCRS["G",ID["EPSG",4258]],CS[Cartesian,2],LENGTHUNIT["metre",1,ID["EPSG",9001]],ID["EPSG",25832]]"#,
    );
    assert_eq!(found.codes, [25832]);
    let found = wkt(
        r#"COMPD_CS["C",PROJCS["P",GEOGCS["G",AUTHORITY["EPSG","4269"]],UNIT["metre",1],AUTHORITY["EPSG","26917"]],VERT_CS["V",AUTHORITY["EPSG","5703"]]]"#,
    );
    assert_eq!(found.codes, [26917, 5703]);
    for none in
        [r#"PROJCS["P",AUTHORITY["ESRI","102100"]]"#, r#"PROJCS["EPSG","25832"]"#, r#"PROJCS["P",ID["EPSG",1e9]]"#]
    {
        assert_eq!(wkt(none).codes, [0; 0], "{none}");
    }
    let mut keyed = keys(&[[3072, 0, 1, 26915]], "", &[]);
    assert!(keyed.complete(26915).is_ok() && keyed.complete(25832).is_err());
}

#[test]
fn the_code_of_a_projection_is_found_in_a_compound_and_behind_others() {
    let ground = r#"PROJCS["P",GEOGCS["G",AUTHORITY["EPSG","4258"]],AUTHORITY["EPSG","25832"]]"#;
    let heights = r#"VERT_CS["V",AUTHORITY["EPSG","5783"]]"#;
    for text in [
        format!(r#"COMPD_CS["C",{ground},{heights}]"#),
        format!(r#"COMPD_CS["C",COMPD_CS["D",{heights},{ground}]]"#),
        format!("{heights},{ground}"),
    ] {
        assert_eq!(projected_epsg(&text), Some(25832), "{text}");
    }
    for text in [format!(r#"COMPD_CS["C",GEOGCS["G",AUTHORITY["EPSG","25832"]],{heights}]"#), heights.to_owned()] {
        assert_eq!(projected_epsg(&text), None, "{text}");
    }
}

#[test]
fn a_text_longer_than_an_archive_can_hold_is_passed_over() {
    let longest = Georeference::of_text("x".repeat(1 << 20));
    assert_eq!((longest.text.map(|text| text.len()), longest.notes), (Some(1 << 20), vec![]));
    let longer = Georeference::of_text(r#"PROJCS["P",UNIT["foot",0.3048]]"#.repeat(1 << 16));
    assert_eq!((longer.text, longer.horizontal, longer.notes.len()), (None, None, 1));
    assert!(longer.notes[0].contains("its reference system is 2031616 bytes long"), "{:?}", longer.notes);
}

#[test]
fn degrees_are_told_apart() {
    let found = wkt(r#"GEOGCS["WGS 84",DATUM["D",SPHEROID["S",6378137,298.2]],UNIT["degree",0.0174532925]]"#);
    assert!(found.degrees && found.horizontal.is_none());
}

#[test]
fn damaged_text_is_noted_and_never_followed_deep() {
    for text in ["PROJCS[\"P", "]", "A[B[C", &"A[".repeat(100_000), "PROJCS[UNIT[\"x\",one]]", ""] {
        let found = wkt(text);
        assert!(found.horizontal.is_none());
    }
}

fn key_records(entries: &[[u16; 4]], text: &str, doubles: &[f64]) -> Records {
    counted_records(entries.len() as u16, entries, text, doubles)
}

fn counted_records(stated: u16, entries: &[[u16; 4]], text: &str, doubles: &[f64]) -> Records {
    let mut directory = vec![1u16, 1, 0, stated];
    directory.extend(entries.iter().flatten());
    let bytes = |words: Vec<u16>| words.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
    let mut records = Records::default();
    records.keep(GEO_KEYS, bytes(directory));
    records.keep(GEO_TEXT, text.as_bytes().to_vec());
    records.keep(GEO_DOUBLES, doubles.iter().flat_map(|d| d.to_le_bytes()).collect());
    records
}

fn keys(entries: &[[u16; 4]], text: &str, doubles: &[f64]) -> Georeference {
    Georeference::read(&key_records(entries, text, doubles), false)
}

#[test]
fn a_projection_of_the_files_own_is_not_named_by_the_geographic_system_below_it() {
    let base = [[1024, 0, 1, 1], [2048, 0, 1, 4269], [3072, 0, 1, USER_DEFINED], [3076, 0, 1, 9002]];
    let mut own = keys(&base, "", &[]);
    assert_eq!((own.text.as_deref(), own.codes.as_slice(), own.horizontal), (None, [].as_slice(), Some(FOOT)));
    assert_eq!(own.complete(2992), Ok(None));
    let cited = [base.as_slice(), &[[3073, GEO_TEXT, 9, 0]]].concat();
    assert_eq!(keys(&cited, "Our grid|", &[]).text.as_deref(), Some("Our grid"));
    let geocentric = keys(&[[1024, 0, 1, GEOCENTRIC_MODEL], [2048, 0, 1, 4978]], "", &[]);
    assert_eq!((geocentric.text.as_deref(), geocentric.horizontal), (Some("EPSG:4978"), Some(1.0)));
}

#[test]
fn statements_that_contradict_each_other_are_noted() {
    let two = |axes, counts, other| format!("two units are given for {axes}: {counts} m, which counts, and {other} m");
    let metres = [[3072, 0, 1, 2992], [3076, 0, 1, 9001], [4096, 0, 1, 6360], [4099, 0, 1, 9001]];
    let found = keys(&metres, "", &[]);
    assert_eq!((found.horizontal, found.vertical), (Some(1.0), Some(1.0)));
    assert_eq!(found.notes, [two("heights", "1", "0.3048006096012192"), two("x and y", "1", "0.3048")]);
    let found = wkt(r#"PROJCS["P",UNIT["metre",1],AUTHORITY["EPSG","2992"]]"#);
    assert_eq!((found.horizontal, found.notes), (Some(1.0), vec![two("x and y", "1", "0.3048")]));
    let mut given = keys(&[[3076, 0, 1, 9001]], "", &[]);
    assert_eq!(given.complete(2229), Ok(None));
    assert_eq!(given.notes, [two("x and y", "1", "0.3048006096012192")]);
    let mut given = keys(&[[3076, 0, 1, 9001]], "", &[]);
    assert_eq!((given.complete(4326), given.degrees), (Ok(None), false));
    assert_eq!(given.notes, [LENGTHS_FOR_ANGLES]);
    for sound in [&[[3072, 0, 1, 2992], [3076, 0, 1, 9002]][..], &[[3072, 0, 1, 2155], [4096, 0, 1, 5703]]] {
        assert_eq!(keys(sound, "", &[]).notes, [""; 0]);
    }
    for (unit, counts) in [
        (r#"UNIT["metre",0.3048]"#, FOOT),
        (r#"UNIT["US survey foot",3.28083333333333]"#, US_SURVEY_FOOT),
        (r#"UNIT["foot",3.28084]"#, FOOT),
    ] {
        let found = wkt(&format!(r#"PROJCS["P",{unit}]"#));
        assert_eq!((found.horizontal, found.notes.len()), (Some(counts), 1), "{unit}: {:?}", found.notes);
    }
    for sound in [r#"UNIT["foot",0.3048006096]"#, r#"UNIT["Foot_US",0.304801]"#, r#"UNIT["metre",1.0000135965]"#] {
        assert_eq!(wkt(&format!(r#"PROJCS["P",{sound}]"#)).notes, [""; 0], "{sound}");
    }
}

#[test]
fn keys_that_are_missing_or_surplus_or_refer_to_nothing_are_noted() {
    let entries = [[1024, 0, 1, 1], [3076, 0, 1, 9002]];
    let counted = |stated| Georeference::read(&counted_records(stated, &entries, "", &[]), false);
    assert_eq!((counted(2).horizontal, counted(2).notes), (Some(FOOT), vec![]));
    assert_eq!(counted(1).horizontal, None);
    assert_eq!(counted(1).notes, ["its GeoTIFF directory states 1 keys and has room for 2"]);
    assert_eq!(counted(9).notes[0], "its GeoTIFF directory states 9 keys and has room for 2");
    let padded = [entries[0], [0; 4]];
    assert_eq!(Georeference::read(&counted_records(1, &padded, "", &[]), false).notes, [""; 0]);
    let past = keys(&[[3072, 0, 1, 26910], [3076, 0, 1, USER_DEFINED], [3077, GEO_DOUBLES, 1, 7]], "", &[0.5]);
    assert_eq!(past.notes, ["its GeoTIFF keys state a unit of their own for x and y, but not its length"]);
    let heights = keys(&[[3072, 0, 1, 2992], [4099, 0, 1, USER_DEFINED]], "", &[]);
    assert_eq!(heights.notes, ["its GeoTIFF keys state a unit of their own for heights, but not its length"]);
    let unknown = keys(&[[3072, 0, 1, 2992], [4096, 0, 1, 5103]], "", &[]);
    assert_eq!(unknown.notes, ["the unit of its vertical system 5103 is unknown; that of x and y is taken"]);
}

#[test]
fn a_system_is_in_metres_if_neither_its_text_nor_its_codes_state_another_unit() {
    let of = |unit: &str, code: u32| format!(r#"PROJCS["P",{unit},AUTHORITY["EPSG","{code}"]]"#);
    for metres in ["EPSG:25832", "EPSG:25832+5783", "EPSG:4326", "a site", &of(r#"UNIT["metre",1]"#, 25832)] {
        assert!(is_in_metres(metres), "{metres}");
    }
    let feet = r#"UNIT["foot",0.3048]"#;
    for other in ["EPSG:2992", "EPSG:25832+6360", &of(feet, 2992), &of(feet, 1), &of(r#"UNIT["metre",1]"#, 2992)] {
        assert!(!is_in_metres(other), "{other}");
    }
}

#[test]
fn names_give_a_unit_by_whole_words() {
    for (name, expected) in [
        ("NAD_1983_StatePlane_Oregon_North_FIPS_3601_Feet_Intl", Some(FOOT)),
        ("NAD_1983_StatePlane_Oregon_North_FIPS_3601_Feet", Some(US_SURVEY_FOOT)),
        ("NAD 1983 StatePlane Michigan South FIPS 2113 Ft Intl", Some(FOOT)),
        ("Texas Central, U.S. survey feet", Some(US_SURVEY_FOOT)),
        ("Site in us-ft", Some(US_SURVEY_FOOT)),
        ("Site, international feet", Some(FOOT)),
        ("Footprints of Barefoot Bay", None),
        ("Foothills of International Falls", None),
        ("Ft Worth", None),
    ] {
        assert_eq!(unit_in_words(name), expected, "{name}");
    }
}

#[test]
fn keys_give_the_unit_by_code_by_size_or_by_the_system() {
    let stated = keys(&[[3072, 0, 1, 26915], [3076, 0, 1, 9003], [4099, 0, 1, 9002]], "", &[]);
    assert_eq!(stated.text.as_deref(), Some("EPSG:26915"));
    assert_eq!((stated.horizontal, stated.vertical), (Some(US_SURVEY_FOOT), Some(FOOT)));
    let by_size = keys(&[[3076, 0, 1, 32767], [3077, GEO_DOUBLES, 1, 1]], "", &[7.0, 2.5]);
    assert_eq!(by_size.horizontal, Some(2.5));
    for size in [1e-7, 1e9, 0.0, -1.0, f64::NAN] {
        let absurd = keys(&[[3076, 0, 1, 32767], [3077, GEO_DOUBLES, 1, 0]], "", &[size]).absurd_unit();
        assert!(absurd.is_some_and(|unit| unit == size || size.is_nan()), "{size}: {absurd:?}");
        assert!(wkt(&format!(r#"PROJCS["P",UNIT["odd",{size}]]"#)).absurd_unit().is_some(), "{size}");
    }
    assert_eq!(by_size.absurd_unit(), None);
    let by_system = keys(&[[3072, 0, 1, 2229]], "", &[]);
    assert_eq!(by_system.horizontal, Some(US_SURVEY_FOOT));
    let by_words = keys(&[[3073, GEO_TEXT, 14, 0]], "Somewhere (ft)|", &[]);
    assert_eq!((by_words.text.as_deref(), by_words.horizontal), (Some("Somewhere (ft)"), Some(FOOT)));
    let degrees = keys(&[[1024, 0, 1, 2], [2048, 0, 1, 4326]], "", &[]);
    assert!(degrees.degrees && degrees.text.as_deref() == Some("EPSG:4326"));
    let broken = keys(&[[3076, 0, 1, 32632], [3077, GEO_DOUBLES, 1, 900], [3073, GEO_TEXT, 900, 800]], "", &[]);
    assert_eq!((broken.horizontal, broken.text, broken.notes.len()), (None, None, 1));
}
