//! Inputs that no program writes: each is refused with one line that names the file and what is wrong with it.

use super::write::{self, Kind, glb_with, gzip, put, with};
use super::{MemorySource, SplatOptions, SplatReader, is_one_line, read, testing};
use slicewalk_base::{Error, Monitor, Warning};
use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Reads each input; its error must contain these words.
fn refuse(name: &str, cases: impl IntoIterator<Item = (Vec<u8>, &'static str)>) {
    for (number, (bytes, words)) in cases.into_iter().enumerate() {
        let name = format!("{number}{name}");
        let Err(error) = read(&bytes, &name, false) else { panic!("{name} is read; expected: {words}") };
        let text = error.to_string();
        assert!(text.starts_with(&name) && text.contains(words) && is_one_line(&error), "{words}: {text}");
    }
}

#[test]
fn files_that_are_none_are_refused() {
    refuse(".splat", [(Vec::new(), "the file is empty")]);
    refuse(".bin", [(b"something".to_vec(), "expected Gaussian splats")]);
    let folder = tempfile::tempdir().unwrap();
    let open = |path: &Path| SplatReader::open(path, &SplatOptions::default()).map(|reader| reader.count());
    let error = open(folder.path()).unwrap_err();
    assert!(error.to_string().contains("expected a SOG folder with meta.json") && is_one_line(&error), "{error}");
    let splats = write::random_splats(9, 20);
    for (name, bytes) in write::sog(&splats, 2) {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    assert_eq!(open(folder.path()).unwrap(), 9);
    let error = open(&folder.path().join("none.ply")).unwrap_err();
    assert!(error.to_string().contains("none.ply: cannot open"), "{error}");
}

#[test]
fn odd_plys_are_refused() {
    let splats = write::random_splats(300, 21);
    let text = write::ply(&splats, Kind::Text, "float", 0);
    let little = write::ply(&splats, Kind::Little, "float", 0);
    let row = |row: &str| {
        let end = text.windows(11).position(|bytes| bytes == b"end_header\n").unwrap() + 11;
        let rest = text[end..].iter().position(|byte| *byte == b'\n').unwrap();
        [&text[..end], row.as_bytes(), &text[end + rest..]].concat()
    };
    let long = "comment ".to_owned() + &"a".repeat(1 << 21) + "\n";
    let many = |line: &str, count: usize| with(&text, "end_header", &(line.repeat(count) + "end_header"));
    // Lines that say nothing.
    let blank = with(&text, "comment a test\n", "obj_info a test\n\ncomment\n");
    // Coordinates in capitals, and lines that end with CR, or CR and LF.
    let upper = with(&with(&text, "float x\n", "float X\n"), "float z\n", "float Z\n");
    let returns = text.iter().map(|byte| if *byte == b'\n' { b'\r' } else { *byte }).collect();
    let both = String::from_utf8(text.clone()).unwrap().replace('\n', "\r\n").into_bytes();
    let expected = read(&text, "a.ply", false).unwrap().1;
    for (number, bytes) in [blank, upper, returns, both].into_iter().enumerate() {
        assert!(read(&bytes, "a.ply", false).unwrap().1 == expected, "{number}");
    }
    refuse(
        ".ply",
        [
            (with(&text, "end_header", "and_header"), "header"),
            (with(&text, "end_header", &(long + "end_header")), "header"),
            (many("comment on the next comment\n", 1 << 16), "header: no \"end_header\" in the first MiB"),
            (many("element e 0\n", 1024), "header: more than 1024 elements or properties"),
            (many("property int a\n", 1024), "header: more than 1024 elements or properties"),
            (with(&text, "element vertex", "element point"), "expected the element \"vertex\", found none"),
            (
                with(&text, "element vertex", "element face 1\nproperty list uchar int a\nelement vertex"),
                "expected no list in or before the splats, found one in element \"face\"",
            ),
            (with(&text, "float x\n", "float a\n"), "splats without the properties x, y, z"),
            (with(&text, "float rot_3\n", "float a\n"), "splats without the properties rot_0 to rot_3"),
            (with(&text, "float opacity\n", "float a\n"), "splats without the properties opacity"),
            (with(&text, "float scale_0\n", "float a\n"), "splats without the properties scale_0 to scale_2"),
            (with(&text, "float opacity\n", "uchar opacity\n"), "expected floating-point numbers"),
            (row("1 2 word"), "row 0: expected a number, found \"word\""),
            (row("1 2 3"), "row 0: expected 17 numbers, found 3"),
            (row(&"1 ".repeat(18)), "row 0: expected 17 numbers, found 18"),
            (row(&"1 ".repeat(1 << 15)), "row 0: a line of more than 64 KiB"),
            (with(&text, "element vertex 300", "element vertex 301"), "1 splat missing"),
            (with(&little, "element vertex 300", "element vertex 301"), "1 splat missing"),
            (with(&little, "end_header", "element more 9\nproperty int a\nend_header"), "the file is cut"),
        ],
    );
}

#[test]
fn plys_of_discs_and_balls_and_with_plain_colours_are_read() {
    let splats = write::random_splats(3, 22);
    let text = write::ply(&splats, Kind::Text, "float", 0);
    let rename = |changes: &[(&str, &str)]| {
        let mut bytes = text.clone();
        for (from, to) in changes {
            bytes = with(&bytes, &format!("float {from}\n"), &format!("{to}\n"));
        }
        read(&bytes, "a.ply", false).unwrap().1
    };
    for (disc, splat) in rename(&[("scale_2", "float a")]).iter().zip(&splats) {
        assert!(disc.scale[2] == 0.0 && (disc.scale[1] / splat.scale[1] - 1.0).abs() < 1e-5, "{disc:?} {splat:?}");
    }
    for (ball, splat) in rename(&[("scale_1", "float a")]).iter().zip(&splats) {
        assert!(ball.scale.iter().all(|size| (size / splat.scale[0] - 1.0).abs() < 1e-5), "{ball:?} {splat:?}");
    }
    let centre = |splat: &super::Splat| splat.mean.map(|v| v as f32);
    // The normals, which are 0, and the coefficients of the colour, as shares or steps.
    let zeros = |kind: &str| {
        rename(&[
            ("nx", &format!("{kind} red")),
            ("ny", &format!("{kind} green")),
            ("nz", &format!("{kind} blue")),
            ("f_dc_0", "float a"),
            ("f_dc_1", "float b"),
            ("f_dc_2", "float c"),
        ])
    };
    for kind in ["float", "uchar", "ushort"] {
        let read = zeros(kind);
        assert!(read.iter().all(|splat| splat.colour == [0; 3]), "{kind}: {read:?}");
        assert!(read.iter().map(centre).eq(splats.iter().map(centre)), "{kind}");
    }
    let grey = rename(&[("f_dc_1", "float a")]);
    assert!(grey.iter().all(|splat| splat.colour == [128; 3]), "{grey:?}");
    let constants = |kind: &str, value: &str| {
        let head = format!(
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
             property {kind} r\nproperty {kind} g\nproperty {kind} b\nproperty float opacity\nproperty float scale_0\n\
             property float rot_0\nproperty float rot_1\nproperty float rot_2\nproperty float rot_3\nend_header\n\
             1 2 3 {value} 0 {value} 0 0 1 0 0 0\n"
        );
        read(head.as_bytes(), "a.ply", false).unwrap().1[0].colour
    };
    assert_eq!(constants("float", "1"), [255, 0, 255]);
    assert_eq!(constants("uchar", "255"), [255, 0, 255]);
    assert_eq!(constants("ushort", "65535"), [255, 0, 255]);
    assert_eq!(constants("double", "7"), [255, 0, 255], "beyond white is white");
}

#[test]
fn odd_compressed_plys_are_refused() {
    let packed = write::packed_ply(&write::random_splats(300, 23), true, 0);
    let words = "property uint packed_position";
    let text = "ply\nformat ascii 1.0\nelement chunk 1\n".to_owned()
        + &["min", "max"]
            .map(|side| {
                ["x", "y", "z"]
                    .map(|a| {
                        format!(
                            "property float {side}_{a}\nproperty float \
           {side}_scale_{a}\n"
                        )
                    })
                    .concat()
            })
            .concat()
        + "element vertex 1\n"
        + &["position", "rotation", "scale", "color"].map(|word| format!("property uint packed_{word}\n")).concat()
        + "end_header\n0 0 0 0 0 0 1 0 1 0 1 0\n";
    let of = |row: &str| (text.clone() + row).into_bytes();
    // Chunks may follow the splats, and be cut.
    let at = |words: &str| packed.windows(words.len()).position(|bytes| bytes == words.as_bytes()).unwrap();
    let (chunk, vertex, end) = (at("element chunk"), at("element vertex"), at("end_header"));
    let (body, rows) = (end + "end_header\n".len(), packed.len() - 300 * 16);
    let header = [&packed[..chunk], &packed[vertex..end], &packed[chunk..vertex], &packed[end..body]].concat();
    let swapped = [&header[..], &packed[rows..], &packed[body..rows]].concat();
    let splats = |bytes: &[u8]| read(bytes, "a.compressed.ply", true).unwrap();
    assert!(splats(&swapped) == splats(&packed));
    let cut = &swapped[..swapped.len() - 1];
    let (_, found, summary) = splats(cut);
    assert_eq!((found.len(), summary.missing), (256, 44));
    assert_eq!(read(&of("0 0 0 255\n"), "a.compressed.ply", false).unwrap().1.len(), 1);
    refuse(
        ".compressed.ply",
        [
            (with(&packed, words, "property uint backed_position"), "expected Gaussian splats"),
            (with(&packed, "property float min_x", "property float a"), "without the properties min_x to max_z"),
            (with(&packed, "property float max_scale_y", "property float a"), "min_scale_x to max_scale_z"),
            (with(&packed, "uint packed_rotation", "uint a"), "without the properties packed_position"),
            (with(&packed, "uint packed_scale", "int packed_scale"), "expected packed properties of type uint"),
            (with(&packed, "element chunk 2", "element chunk 3"), "expected 2 chunks for 300 splats, found 3"),
            (with(&packed, "element chunk", "element chunks"), "expected Gaussian splats"),
            (of("0 0.5 0 255\n"), "row 0: expected whole numbers of 32 bits"),
            (of("0 4294967296 0 255\n"), "row 0: expected whole numbers of 32 bits"),
            (of("0 -1 0 255\n"), "row 0: expected whole numbers of 32 bits"),
            (of("0 0 0\n"), "row 0: expected 4 numbers, found 3"),
            (cut.to_vec(), "44 splats missing"),
            (of(""), "1 splat missing"),
        ],
    );
}

#[test]
fn odd_spzs_are_refused() {
    let splats = write::random_splats(300, 24);
    let bare = write::spz(&splats, 3, 1, false);
    let v4 = write::spz(&splats, 4, 0, true);
    let mut open_end = write::spz(&splats, 4, 0, true);
    open_end.truncate(40);
    // One byte more in the stream of opacities than it states.
    let longer = {
        let column = [vec![7; 300], vec![1]].concat();
        let stream = zstd::encode_all(&column[..], 3).unwrap();
        let long = |at: usize| u64::from_le_bytes(v4[at..at + 8].try_into().unwrap()) as usize;
        let (first, second) = (long(32), long(48));
        let start = 32 + 5 * 16 + first;
        let bytes = [&v4[..start], &stream, &v4[start + second..]].concat();
        put(&bytes, 48, &(stream.len() as u64).to_le_bytes())
    };
    let damaged = put(&v4, 32 + 5 * 16, b"none");
    refuse(
        ".spz",
        [
            (b"NGSP".to_vec(), "SPZ header: the data end before their stated length"),
            (put(&bare, 0, b"NGSQ"), "expected NGSP, found other bytes"),
            (put(&bare, 4, &[0]), "expected version 1 to 4, found 0"),
            (put(&bare, 4, &[5]), "expected version 1 to 4, found 5"),
            (put(&bare, 12, &[5]), "expected harmonics of degree 0 to 4, found 5"),
            (put(&bare, 13, &[31]), "expected at most 30 fractional bits, found 31"),
            (gzip(&put(&bare, 4, &[4])), "expected version 1 to 3 inside gzip, found 4"),
            (gzip(b"NGSP"), "the data end before their stated length"),
            (gzip(&bare[..bare.len() - 5]), "the data end 5 bytes before their stated length"),
            (put(&v4, 16, &[31]), "expected the table behind the header of 32 bytes, found it at byte 31"),
            (put(&v4, 15, &[4]), "expected 5 streams, found 4"),
            (put(&v4, 40, &[0]), "bytes in stream 0, found"),
            (put(&v4, 34, &[9]), "and the file holds"),
            (open_end, "SPZ table of streams: the data end"),
            (v4[..18].to_vec(), "SPZ table of streams: the data end"),
            (longer, "a stream holds more bytes than it states"),
            (damaged, "damaged data"),
        ],
    );
    // Cut within the harmonics, which are not read.
    let (_, found, summary) = read(&bare[..bare.len() - 1], "cut.spz", true).unwrap();
    assert_eq!((found.len(), summary.lost(), summary.is_complete()), (300, 0, false));
    let none = write::spz(&[], 4, 0, true);
    assert_eq!(read(&none, "none.spz", false).unwrap().0, 0);
}

#[test]
fn odd_ksplats_are_refused() {
    let splats = write::random_splats(11, 25);
    let [plain, packed] = [0, 1].map(|level| write::ksplat(&splats, level, 0));
    let word = |value: u32| value.to_le_bytes();
    refuse(
        ".ksplat",
        [
            (plain[..4000].to_vec(), "header: the data end before"),
            (put(&plain, 0, &[1]), "expected version 0.1 or later, found 1.1"),
            (put(&plain, 1, &[0]), "expected version 0.1 or later, found 0.0"),
            (put(&plain, 20, &[3]), "expected compression level 0, 1 or 2, found 3"),
            (put(&plain, 4, &word(9)), "it states 9 sections, and the file has room for 1"),
            (put(&plain, 16, &word(12)), "expected 12 splats in all sections, found 11"),
            (put(&plain, 4136, &[4]), "section 0: expected harmonics of degree 0 to 3, found others"),
            (put(&plain, 4100, &word(10)), "section 0: it states more splats than it has room for"),
            (put(&packed, 4116, &[11, 0]), "section 0: its buckets have no centre or no size"),
            (put(&packed, 4112, &f32::NAN.to_le_bytes()), "section 0: its buckets have no centre or no size"),
            (put(&packed, 4108, &word(2)), "section 0: it states more full and partial buckets than buckets"),
            (put(&packed, 4104, &word(3)), "section 0: its buckets hold fewer splats than it states"),
            // The bucket that is not full states one splat fewer than there are.
            (put(&packed, 5120, &word(2)), "buckets: the buckets end before the splats"),
            // It states one more.
            (put(&packed, 5120, &word(4)), "buckets: the buckets hold more splats than the section states"),
        ],
    );
    // A stated range, and a section without splats.
    let ranged = put(&packed, 4120, &word(32767));
    assert!(read(&ranged, "a.ksplat", false).unwrap().1 == read(&packed, "a.ksplat", false).unwrap().1);
    for bytes in [&plain, &packed] {
        let two = put(bytes, 4, &[word(2), word(2)].concat());
        let two = [&two[..5120], &[0; 1024], &two[5120..]].concat();
        assert!(read(&two, "a.ksplat", false).unwrap().1 == read(bytes, "a.ksplat", false).unwrap().1);
    }
    // Damage of a section loses no splat of the next.
    let head = put(&put(&packed[..5120], 4, &[word(2), word(2)].concat()), 16, &word(22));
    let broken = put(&packed, 5120, &word(2));
    let two = [&head[..], &packed[4096..5120], &broken[5120..], &packed[5120..]].concat();
    let (_, found, summary) = read(&two, "a.ksplat", true).unwrap();
    assert_eq!((found.len(), summary.splats, summary.missing), (21, 21, 1));
}

/// Notes all warnings.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Monitor for Notes {
    fn warn(&self, warning: &Warning) {
        self.0.lock().unwrap().push(warning.to_string());
    }
}

/// A WebP image of one pixel with losses.
const LOSSY: &[u8] =
    b"RIFF\x22\0\0\0WEBPVP8 \x16\0\0\0\x30\x01\0\x9D\x01\x2A\x01\0\x01\0\x0E\xC0\xFE\x25\xA4\0\x03\x70\0\0\0\0";

#[test]
fn odd_sogs_are_refused() {
    let splats = write::random_splats(40, 26);
    let files = write::sog(&splats, 2);
    let first = write::sog(&splats, 1);
    let of = |files: &[(String, Vec<u8>)], name: &str, bytes: Vec<u8>| -> Vec<_> {
        let new = |own: &String, old: &Vec<u8>| if own == name { bytes.clone() } else { old.clone() };
        files.iter().map(|(own, old)| (own.clone(), new(own, old))).collect()
    };
    let meta = |from: &str, to: &str| write::zip(&of(&files, "meta.json", with(&files[0].1, from, to)), false);
    let meta_1 = |from: &str, to: &str| write::zip(&of(&first, "meta.json", with(&first[0].1, from, to)), false);
    let image = |bytes: Vec<u8>| write::zip(&of(&files, "q.webp", bytes), true);
    let pixels = |count: usize| write::webp(&vec![[9, 9, 9, 252]; count]);
    refuse(
        ".sog",
        [
            (write::zip(&files[1..], false), "expected meta.json, found none"),
            (meta("\"version\":2", "\"version\":3"), "expected version 1 or 2, found 3"),
            (meta("\"count\":40,", ""), "expected a count, found none"),
            (meta("{", "["), "JSON: "),
            (meta("\"codebook\":[", "\"codebook\":[],\"a\":["), "expected a codebook of scales, found none"),
            (meta("\"sh0\":{\"codebook\":[", "\"sh0\":{\"codebook\":[0],\"a\":["), "a number that is not finite"),
            (meta("\"mins\":[", "\"mins\":[],\"a\":["), "expected 3 mins and maxs of means, found fewer"),
            (meta("\"mins\":[", "\"mins\":[1000,0,0],\"a\":["), "found numbers beyond 100"),
            (meta("\"s.webp\"", ""), "expected the names of all images, found fewer"),
            (meta("s.webp", "x.webp"), "zip: expected x.webp, found no such entry"),
            (
                write::zip(&of(&files, "meta.json", vec![b' '; (4 << 20) + 1]), true),
                "meta.json: expected at most 4 MiB, found 4.19 MB",
            ),
            (meta_1("\"scales\":{\"mins\":[", "\"scales\":{\"mins\":[],\"a\":["), "mins and maxs of scales"),
            (meta_1("\"sh0\":{\"mins\":[", "\"sh0\":{\"mins\":[],\"a\":["), "expected 4 mins and maxs of sh0"),
            (image(b"RIFF".to_vec()), "q.webp: "),
            (image(b"RIFF\x04\0\0\0WAVE".to_vec()), "q.webp: damaged WebP"),
            (image(LOSSY.to_vec()), "q.webp: expected a lossless image, found a lossy or animated one"),
            (image(pixels(30)), "expected 40 pixels, one for each splat, found"),
            (image(pixels(70_000)), "expected about 40 pixels, one for each splat, found"),
        ],
    );
    // A splat without a rotation is one that is not turned.
    let turned = image(write::webp(&[[0, 0, 0, 9]; 40]));
    assert!(read(&turned, "a.sog", false).unwrap().1.iter().all(|splat| splat.rotation == [1.0, 0.0, 0.0, 0.0]));
    let marked = write::zip(&of(&files, "meta.json", [&b"\xEF\xBB\xBF"[..], &files[0].1].concat()), false);
    let plain = write::zip(&files, false);
    assert!(read(&marked, "a.sog", false).unwrap().1 == read(&plain, "a.sog", false).unwrap().1);
    // Without alpha, the opacity is 1.
    let opaque =
        read(&write::zip(&of(&files, "c.webp", write::webp_rgb(&[[9; 3]; 40])), false), "a.sog", false).unwrap();
    assert!(opaque.1.iter().all(|splat| splat.opacity == 1.0));
}

#[test]
fn images_of_sog_beyond_the_memory_are_refused() {
    let splats = write::random_splats(9, 27);
    let mut files = write::sog(&splats, 2);
    let side = 1500;
    let meta = String::from_utf8(files[0].1.clone()).unwrap();
    files[0].1 = meta.replace("\"count\":9", &format!("\"count\":{}", side * side)).into_bytes();
    files[1].1 = write::webp(&vec![[0; 4]; side * side]);
    let zip = write::zip(&files, true);
    let options = SplatOptions { memory_bytes: 1, ..SplatOptions::default() };
    let mut reader = SplatReader::of_source(Arc::new(MemorySource::new(zip)), "big.sog", &options).unwrap();
    let error = reader.for_each_batch(&slicewalk_base::NoMonitor, &mut |_| Ok(())).unwrap_err();
    assert!(matches!(error, Error::Limit { .. }) && error.to_string().contains("the image l.webp"), "{error}");
}

#[test]
fn odd_levels_of_sog_are_refused() {
    let splats = write::random_splats(50, 28);
    for (folder, part) in [("a", 0..20), ("b", 20..50)] {
        for (name, bytes) in write::sog(&splats[part], 2) {
            testing::hold(format!("odd/{folder}/{name}"), bytes);
        }
    }
    testing::hold("odd/c.sog", write::zip(&write::sog(&splats[..20], 2), true));
    let set = r#"{"version":1,"counts":[50],"environment":"sky/meta.json","filenames":["a/meta.json","b/meta.json"],
        "tree":{"children":[{"lods":{"0":{"file":0,"offset":0,"count":20}}},{"lods":{"0":{"file":1,"offset":0,"count":30}}}]}}"#;
    let path = "odd/lod-meta.json";
    let pass = |text: String, allow_incomplete: bool| {
        testing::hold(path, text.as_bytes());
        let options = SplatOptions { allow_incomplete, ..SplatOptions::default() };
        let notes = Notes::default();
        let mut reader = SplatReader::open(path, &options)?;
        let mut found = 0;
        let summary = reader.for_each_batch(&notes, &mut |batch| {
            found += batch.len();
            Ok(())
        })?;
        Ok::<_, Error>((found, summary, notes.0.into_inner().unwrap()))
    };
    let (found, _, notes) = pass(set.into(), false).unwrap();
    assert!(found == 50 && notes.len() == 1 && notes[0].contains("the environment"), "{notes:?}");
    let (found, _, notes) = pass(set.replace("\"environment\":\"sky/meta.json\",", ""), false).unwrap();
    assert!(found == 50 && notes.is_empty(), "{notes:?}");
    // One of the files is a zip.
    let (found, ..) = pass(set.replace("a/meta.json", "c.sog"), false).unwrap();
    assert_eq!(found, 50);
    for (from, to, words) in [
        ("\"version\":1", "\"version\":2", "expected version 1, found 2"),
        ("\"file\":1", "\"file\":2", "a node names splats that no file holds"),
        ("\"file\":1", "\"file\":0", "two nodes name the same splats"),
        ("\"counts\":[50]", "\"counts\":[51]", "expected 51 splats in the finest level, found 50"),
        (
            "\"count\":20}}},{\"lods\":{\"0\":{\"file\":1,\"offset\":0,\"count\":30",
            "\"count\":9223372036854775808}}},{\"lods\":{\"0\":{\"file\":1,\"offset\":0,\"count\":9223372036854775808",
            "expected 50 splats in the finest level, found 18,446,744,073,709,551,615",
        ),
        ("b/meta.json", "../meta.json", "\"../meta.json\" lies outside its folder"),
        ("b/meta.json", "none/meta.json", "cannot open"),
    ] {
        let error = pass(set.replace(from, to), false).map(|pass| pass.0).unwrap_err();
        assert!(error.to_string().contains(words) && is_one_line(&error), "{words}: {error}");
    }
    // More splats than can be counted.
    let half = "\"count\":9223372036854775808";
    let endless = set.replace("\"counts\":[50],", "").replace("\"count\":20", half).replace("\"count\":30", half);
    let (found, summary, _) = pass(endless, true).unwrap();
    assert_eq!((found, summary.missing, summary.lost()), (0, u64::MAX, u64::MAX));
    // The splats of a file that cannot be read are missing.
    for to in ["none/meta.json", "../meta.json"] {
        let (found, summary, notes) = pass(set.replace("b/meta.json", to), true).unwrap();
        assert_eq!((found, summary.missing, summary.is_complete()), (20, 30, false));
        assert!(notes.iter().any(|note| note.contains("30 splats missing")), "{notes:?}");
    }
}

#[test]
fn odd_zips_are_refused() {
    let splats = write::random_splats(30, 29);
    let zip = write::zip(&write::sog(&splats, 2), false);
    let end = zip.len() - 22;
    let directory = u32::from_le_bytes(zip[end + 16..end + 20].try_into().unwrap()) as usize;
    let meta = directory;
    // With the end of a long file: the fields of the short one are 0xFFFFFFFF.
    let long = |change: &dyn Fn(&mut Vec<u8>, &mut Vec<u8>)| {
        let (size, at) = (end - directory, directory);
        let mut record = b"PK\x06\x06".to_vec();
        record.extend([0; 36]);
        record.extend((size as u64).to_le_bytes());
        record.extend((at as u64).to_le_bytes());
        let mut locator = b"PK\x06\x07\0\0\0\0".to_vec();
        locator.extend((end as u64).to_le_bytes());
        locator.extend([1, 0, 0, 0]);
        change(&mut record, &mut locator);
        [&zip[..end], &record, &locator, &put(&zip[end..], 12, &[0xFF; 8])].concat()
    };
    assert!(read(&long(&|_, _| ()), "long.sog", false).unwrap().1 == read(&zip, "a.sog", false).unwrap().1);
    let broken = "the end of the directory of a long file is damaged";
    refuse(
        ".sog",
        [
            (zip[..end].to_vec(), "expected the directory of a zip at the end, found none"),
            (zip[..end + 15].to_vec(), "expected the directory of a zip at the end, found none"),
            (put(&zip, end + 12, &[0xFF, 0xFF, 0xFF, 0]), "does not fit before its end"),
            (put(&zip, end + 16, &[0xFF, 0xFF, 0xFF, 0xFE]), "does not fit before its end"),
            (put(&zip, meta, b"QK"), "entry 0 is damaged"),
            (put(&zip, meta + 28, &[0xFF, 0xFF]), "entry 0 is damaged"),
            (put(&zip, meta + 8, &[1]), "another compression or a password"),
            (put(&zip, meta + 10, &[9]), "another compression or a password"),
            (put(&zip, meta + 42, &[0, 0, 0, 0x7F]), "it lies behind the end of the zip"),
            (put(&zip, meta + 42, &[9]), "expected its header where the directory says"),
            (put(&zip, meta + 20, &[0, 0, 0, 0x7F]), "it ends behind the end of the zip"),
            (put(&zip, meta + 24, &[1, 0, 0, 0]), "found more"),
            (put(&zip, meta + 24, &[0, 0, 1, 0]), "expected 65.5 kB, found"),
            (put(&zip, meta + 16, &[1, 2, 3, 4]), "its checksum does not match"),
            (long(&|record, _| record[0] = b'Q'), broken),
            (long(&|_, locator| locator[0] = b'Q'), broken),
            (long(&|_, locator| locator[15] = 0x7F), broken),
            (put(&zip[end..], 12, &[0xFF; 8]), broken),
            ([b"PK\x03\x04", &put(&zip[end..], 12, &[0xFF; 8])[..]].concat(), broken),
        ],
    );
    // Fields of a long file in an extra field of its entry.
    let field = |fields: &[u64], has_place: bool| {
        let mut extra = [[9, 9, 0, 0], [1, 0, 8 * fields.len() as u8, 0]].concat();
        fields.iter().for_each(|value| extra.extend(value.to_le_bytes()));
        let word = |at: usize| u32::from_le_bytes(zip[at..at + 4].try_into().unwrap());
        let name = u16::from_le_bytes([zip[meta + 28], zip[meta + 29]]) as usize;
        let entry = put(&zip[meta..meta + 46 + name], 20, &[0xFF; 8]);
        let entry = if has_place { entry } else { put(&entry, 42, &[0xFF; 4]) };
        let entry = put(&entry, 30, &[extra.len() as u8]);
        let bytes = [&zip[..meta], &entry, &extra, &zip[meta + 46 + name..]].concat();
        let end = end + extra.len();
        put(&bytes, end + 12, &(word(end - extra.len() + 12) + extra.len() as u32).to_le_bytes())
    };
    let sizes = u64::from(u32::from_le_bytes(zip[meta + 20..meta + 24].try_into().unwrap()));
    // Only those that do not fit into the fields of the entry itself.
    for bytes in [field(&[sizes, sizes, 0], false), field(&[sizes, sizes], true)] {
        assert_eq!(read(&bytes, "long.sog", false).unwrap().1.len(), 30);
    }
    refuse(".sog", [(field(&[sizes, sizes], false), "entry 0 is damaged")]);
}

#[test]
fn odd_gltfs_are_refused() {
    let splats = write::random_splats(20, 30);
    let glb = write::gltf(&splats);
    let spz = write::gltf_spz(&splats, 2);
    let len = glb.len() as u32;
    let change = |from: &str, to: &str| glb_with(&glb, from, to);
    let of_spz = |from: &str, to: &str| glb_with(&spz, from, to);
    let node = "\"mesh\":0,\"translation\":[1,2,3]";
    let view = "{\"buffer\":0,\"byteOffset\":0,";
    let accessor = "\"componentType\":5126,\"count\":20,\"type\":\"VEC3\"";
    refuse(
        ".glb",
        [
            (put(&glb, 4, &[1]), "expected version 2, found 1"),
            (put(&glb, 8, &(len + 1).to_le_bytes()), "it is cut"),
            (put(&glb, 12, &len.to_le_bytes()), "chunk at byte 12: it ends behind the file: it is cut"),
            (put(&glb, 16, b"NONE"), "expected JSON in the first chunk, found none"),
            (change("\"asset\"", "asset"), "JSON: "),
            (change(node, "\"mesh\":0,\"children\":[7]"), "nodes: there is no node 7"),
            (
                change(&format!("{{{node}}}"), &format!("{{{node}}},{{\"children\":[0,0]}}")),
                "node 0: it has two parents",
            ),
            (change("\"nodes\"", "\"scene\":3,\"nodes\""), "scene: there is no scene 3"),
            (change("\"nodes\"", "\"scenes\":[{\"nodes\":[5]}],\"nodes\""), "nodes: there is no node 5"),
            (change("\"nodes\"", "\"scenes\":[{\"nodes\":[0,0]}],\"nodes\""), "node 0: it occurs twice in the scene"),
            (change(node, "\"mesh\":0,\"scale\":[1e308,1e308,1e308],\"translation\":[1e309,0,0]"), "JSON: "),
            (
                change(
                    &format!("{{{node}}}"),
                    "{\"mesh\":0,\"scale\":[1e308,1,1]},{\"children\":[0],\"scale\":[1e308,1,1]}",
                ),
                "node 0: its place is not finite",
            ),
            (change(node, "\"mesh\":4"), "node 0: there is no mesh 4"),
            (
                change(node, "\"mesh\":0,\"matrix\":[1,0,0,10,0,1,0,20,0,0,1,30,0,0,0,1]"),
                "node 0: expected a matrix with the last row 0 0 0 1, found 10 20 30 1; write it column by column",
            ),
            (
                change(node, "\"mesh\":0,\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,2]"),
                "node 0: expected a matrix with the last row 0 0 0 1, found 0 0 0 2",
            ),
            (change("\"mode\":0", "\"mode\":4"), "mesh 0: expected splats as points (mode 0), found mode 4"),
            (
                change("\"extensions\":{\"KHR_gaussian_splatting\"", "\"extensions\":{\"other\""),
                "expected primitives with the extension KHR_gaussian_splatting, found none; export it again",
            ),
            (change("\"POSITION\":0,", ""), "expected positions, rotations and sizes of splats, found fewer"),
            (change("\"POSITION\":0,", "\"POSITION\":9,"), "accessor 9: there is no such accessor"),
            (change("\"POSITION\":0,", "\"POSITION\":3,"), "accessor 3: expected 3 numbers a value, found 1"),
            (
                change(accessor, "\"componentType\":5126,\"count\":19,\"type\":\"VEC3\""),
                "expected 19 values of each attribute, found 20",
            ),
            (
                change(accessor, "\"componentType\":5127,\"count\":20,\"type\":\"VEC3\""),
                "expected a component type of glTF, found 5127",
            ),
            (
                change(accessor, "\"componentType\":5126,\"count\":20,\"type\":\"VEC2\""),
                "expected 3 numbers a value, found 2",
            ),
            (
                change(accessor, "\"componentType\":5126,\"count\":20,\"type\":\"MAT3\""),
                "expected 3 numbers a value, found 0",
            ),
            (change(accessor, &format!("\"sparse\":{{}},{accessor}")), "sparse values of splats are not read"),
            (change("\"bufferView\":0,", ""), "accessor 0: expected a buffer view, found none"),
            (change("\"bufferView\":0,", "\"bufferView\":9,"), "buffer view 9: there is no such view"),
            (change("\"bufferView\":0,", "\"byteOffset\":4,\"bufferView\":0,"), "its buffer view ends before them"),
            (change(view, &format!("{view}\"byteStride\":11,")), "expected values 12 bytes apart or more, found 11"),
            (change(view, &format!("{view}\"byteStride\":99,")), "it states 20 values, and its buffer view ends"),
            (
                change(view, &format!("{view}\"extensions\":{{\"EXT_meshopt_compression\":{{}}}},")),
                "its values are compressed by meshopt",
            ),
            (change(view, "{\"buffer\":0,\"byteOffset\":99999,"), "buffer view 0: it ends behind its buffer"),
            (change(view, "{\"buffer\":7,\"byteOffset\":0,"), "buffer 7: there is no such buffer"),
            (
                change("\"buffers\":[{", "\"buffers\":[{\"uri\":\"data:text/plain,abc\","),
                "buffer 0: expected base64 text, found other",
            ),
            (change("\"buffers\":[{", "\"buffers\":[{\"uri\":\"data:;base64,a?\","), "buffer 0: damaged base64"),
            (change("\"buffers\":[{", "\"buffers\":[{\"uri\":\"data:;base64,AAAA\","), "it should have"),
            (
                change("\"buffers\":[{", "\"buffers\":[{\"uri\":\"../a.bin\","),
                "buffer 0: \"../a.bin\" leads out of the folder",
            ),
            (change("\"buffers\":[{", "\"buffers\":[{\"uri\":\"https://host/a.bin\","), "buffer 0: it lies elsewhere"),
            (
                change("\"buffers\":[{\"byteLength\":", "\"buffers\":[{\"byteLength\":1,\"a\":"),
                "buffer 0: it states 1 bytes, and the binary part has 1120",
            ),
            (
                change("\"buffers\":[{\"byteLength\":1120", "\"buffers\":[{\"byteLength\":1118"),
                "buffer view 4: it ends behind its buffer",
            ),
            (of_spz("\"bufferView\":0", "\"view\":0"), "mesh 0: expected the buffer view of SPZ, found none"),
            (of_spz("\"bufferView\":0", "\"bufferView\":8"), "buffer view 8: there is no such view"),
            (of_spz("\"count\":20", "\"count\":21"), "mesh 0: expected 21 splats in SPZ, found 20"),
        ],
    );
    // A node takes more memory than text.
    let many = change("\"nodes\":[", &("\"nodes\":[".to_owned() + &"{},".repeat(1 << 20)));
    let options = SplatOptions { memory_bytes: 1, ..SplatOptions::default() };
    let error = SplatReader::of_source(Arc::new(MemorySource::new(many)), "a.glb", &options).map(drop).unwrap_err();
    assert!(matches!(error, Error::Limit { .. }) && is_one_line(&error), "{error}");
    let head = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let text = glb[20..20 + head].to_vec();
    refuse(
        ".gltf",
        [
            (b"{\"KHR_spz\":".to_vec(), "expected glTF, found fewer than 12 bytes"),
            (text.clone(), "buffer 0: it should lie in this file, which has no binary part"),
        ],
    );
    let missing = with(&text, "\"buffers\":[{", "\"buffers\":[{\"uri\":\"no%20file.bin\",");
    let error = read(&missing, "folder/a.gltf", false).map(drop).unwrap_err().to_string();
    assert!(error.starts_with("folder/no file.bin: cannot open"), "{error}");
    // The binary part under a name that is written in percent codes.
    testing::hold("folder/no file%.bin", &glb[28 + head..]);
    let beside = with(&text, "\"buffers\":[{", "\"buffers\":[{\"uri\":\"no%20file%.bin\",");
    let found = read(&beside, "folder/a.gltf", false).unwrap().1;
    assert!(found == read(&glb, "a.glb", false).unwrap().1);
    // A browser hands files over without their folders, and a file may hold more than the buffer.
    testing::hold("folder/more.bin", [&glb[28 + head..], b"more"].concat());
    let below = with(&text, "\"buffers\":[{", "\"buffers\":[{\"uri\":\"buffers/more.bin\",");
    assert!(read(&below, "folder/a.gltf", false).unwrap().1 == found);
}

/// A mesh that no node names is no part of the scene; a monitor hears of its splats.
#[test]
fn splats_that_the_scene_does_not_show_are_left_out_with_a_warning() {
    let glb = write::gltf(&write::random_splats(20, 31));
    let len = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let json = std::str::from_utf8(&glb[20..20 + len]).unwrap().trim_end();
    let (before, meshes) = json.split_once("\"meshes\":[").unwrap();
    let mesh = meshes.strip_suffix("]}").unwrap();
    let twice = write::glb(&format!("{before}\"meshes\":[{mesh},{mesh}]}}"), glb[28 + len..].to_vec());
    let notes = Notes::default();
    let source = Arc::new(MemorySource::new(twice));
    let mut reader = SplatReader::of_source(source, "two.glb", &SplatOptions::default()).unwrap();
    let mut found = Vec::new();
    let summary = reader.for_each_batch(&notes, &mut |batch| {
        found.extend_from_slice(batch);
        Ok(())
    });
    assert!(summary.unwrap().is_complete() && found == read(&glb, "a.glb", false).unwrap().1);
    let notes = notes.0.into_inner().unwrap();
    assert!(notes.iter().any(|note| note.contains("20 splats of meshes that the scene does not show")), "{notes:?}");
}

/// Values as whole numbers, apart in their buffer, under the names of the drafts; colours in linear light.
#[test]
fn drafts_of_gltf_and_their_types_are_read() {
    let name = "KHR_gaussian_splatting";
    let mut binary = Vec::new();
    let floats = |binary: &mut Vec<u8>, values: &[f32]| values.iter().for_each(|v| binary.extend(v.to_le_bytes()));
    // Two splats: each centre is followed by four bytes of something else.
    for x in [1.0, 2.0] {
        floats(&mut binary, &[x, 5.0, 6.0, 99.0]);
    }
    let rotations_at = binary.len();
    binary.extend([0i8, 0, 0, 127, 127, 0, 0, -128].map(|v| v as u8));
    let scales_at = binary.len();
    floats(&mut binary, &[0.5, 0.25, 0.125, 1.0, 2.0, 3.0]);
    let colours_at = binary.len();
    binary.extend([255, 0, 51, 102, 0, 255, 0, 255]);
    let len = binary.len();
    let json = |attributes: &str, extension: &str| {
        let view = |at: usize, len: usize, more: &str| {
            format!("{{\"buffer\":0,\"byteOffset\":{at},\"byteLength\":{len}{more}}}")
        };
        let views = [
            view(0, rotations_at, ",\"byteStride\":16"),
            view(rotations_at, 8, ""),
            view(scales_at, colours_at - scales_at, ""),
            view(colours_at, 8, ""),
        ];
        let accessor = |view: usize, kind: u32, shape: &str, more: &str| {
            format!("{{\"bufferView\":{view},\"componentType\":{kind},\"count\":2,\"type\":\"{shape}\"{more}}}")
        };
        let accessors = [
            accessor(0, 5126, "VEC3", ""),
            accessor(1, 5120, "VEC4", ",\"normalized\":true"),
            accessor(2, 5126, "VEC3", ""),
            accessor(3, 5121, "VEC4", ""),
            accessor(2, 5126, "SCALAR", ""),
        ];
        format!(
            "{{\"buffers\":[{{\"byteLength\":{len}}}],\"bufferViews\":[{}],\"accessors\":[{}],\"nodes\":[{{\"mesh\":0}}],\
             \"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0,{attributes}}},\"extensions\":{{\"{name}\":\
             {extension}}}}}]}}]}}",
            views.join(","),
            accessors.join(",")
        )
    };
    let pass = |attributes: &str, extension: &str| {
        read(&write::glb(&json(attributes, extension), binary.clone()), "a.glb", false).unwrap().1
    };
    let draft = "\"_ROTATION\":1,\"_SCALE\":2";
    let found = pass(&format!("{draft},\"COLOR_0\":3"), "{}");
    assert_eq!((found[0].mean, found[1].mean), ([1.0, 5.0, 6.0], [2.0, 5.0, 6.0]));
    assert_eq!((found[0].scale, found[1].scale), ([0.5, 0.25, 0.125], [1.0, 2.0, 3.0]));
    assert_eq!(found[0].rotation, [1.0, 0.0, 0.0, 0.0]);
    assert!((found[1].rotation[1] - 0.5f32.sqrt()).abs() < 1e-6 && found[1].rotation[0] < 0.0, "{found:?}");
    assert_eq!((found[0].colour, found[1].colour), ([255, 0, 51], [0, 255, 0]));
    assert!((found[0].opacity - 0.4).abs() < 1e-6 && found[1].opacity == 1.0, "{found:?}");
    // Neither colour nor opacity.
    let found = pass(draft, "{}");
    assert!(found.iter().all(|splat| splat.colour == [128; 3] && splat.opacity == 1.0), "{found:?}");
    // Opacity of its own, before that of the colour.
    let found = pass(&format!("{draft},\"COLOR_0\":3,\"{name}:OPACITY\":4"), "{}");
    assert_eq!(found.iter().map(|splat| splat.opacity).collect::<Vec<_>>(), [0.5, 0.25]);
    // Harmonics in linear light are brighter than equal ones in sRGB.
    let waves = |space: &str| {
        pass(&format!("{draft},\"{name}:SH_DEGREE_0_COEF_0\":2"), &format!("{{\"colorSpace\":\"{space}\"}}"))
    };
    let [plain, linear] = ["srgb_rec709_display", "lin_rec709_display"].map(waves);
    assert_eq!(plain[0].colour, [163, 145, 136]);
    assert_eq!(linear[0].colour, [210, 199, 193]);
}
