//! Clouds that lie about their size are refused in little memory. A single test, because its allocator counts all
//! memory.

#[path = "common/heap.rs"]
mod heap;
#[path = "cloud/write.rs"]
mod write;

use slicewalk::{Error, NoMonitor};
use slicewalk_input::{InputOptions, InputSet, PointDecoder};
use std::path::Path;
use write::{Cloud, E57, Pcd, Ply, e57, pcd, ply};

const MOST_BYTES: usize = 24 << 20;

fn read(path: &Path) -> Result<u64, Error> {
    let set = InputSet::open(&[path.to_path_buf()], InputOptions::default(), &NoMonitor)?;
    let (mut decoder, mut points) = (PointDecoder::new(), 0);
    for chunk in set.chunks() {
        points += decoder.decode(&set, &chunk, &mut |_| Ok(()))?.read;
    }
    set.check_complete(&NoMonitor)?;
    Ok(points)
}

/// The content of the pages of an E57, and its XML.
fn content_and_xml(good: &[u8]) -> (Vec<u8>, usize, String) {
    let number = |at: usize| u64::from_le_bytes(good[at..at + 8].try_into().unwrap());
    let content: Vec<u8> = good.chunks(1024).flat_map(|page| page[..1020].to_vec()).collect();
    let (xml_at, xml_len) = (number(24) / 1024 * 1020 + number(24) % 1024, number(32) as usize);
    let xml = std::str::from_utf8(&content[xml_at as usize..][..xml_len]).unwrap().to_owned();
    (content, xml_at as usize, xml)
}

/// Pages with an XML after `content`, which begins with a header.
fn file_of(mut content: Vec<u8>, xml: &str) -> Vec<u8> {
    let xml_at = content.len() as u64;
    content.extend(xml.as_bytes());
    content.resize(content.len().next_multiple_of(1020), 0);
    let numbers = [content.len() as u64 / 1020 * 1024, xml_at / 1020 * 1024 + xml_at % 1020, xml.len() as u64];
    for (number, place) in numbers.into_iter().zip(content[16..40].as_chunks_mut().0) {
        *place = number.to_le_bytes();
    }
    let page = |page: &[u8]| [page, &crc32c::crc32c(page).to_be_bytes()].concat();
    content.chunks(1020).flat_map(page).collect()
}

/// A sound E57 with another XML of as many pages, and recomputed checksums.
fn with_xml(good: &[u8], edit: impl Fn(&str) -> String) -> Vec<u8> {
    let (content, xml_at, xml) = content_and_xml(good);
    file_of(content[..xml_at].to_vec(), &edit(&xml))
}

/// A sound E57 with other packets.
fn with_packets(good: &[u8], packets: &[u8]) -> Vec<u8> {
    let (content, _, xml) = content_and_xml(good);
    let (before, offset) = xml.split_once("fileOffset=\"").unwrap();
    let behind = &offset[offset.find('"').unwrap()..];
    // A section of points after the header, and its packets after the head of the section.
    let section = [1, 32 + packets.len() as u64, 48 + 32, 0].map(u64::to_le_bytes);
    let content = [&content[..48], section.as_flattened(), packets].concat();
    file_of(content, &format!("{before}fileOffset=\"48{behind}"))
}

/// A packet of points with this many bytes in each column.
fn packet(columns: &[u16]) -> Vec<u8> {
    let sum: u16 = columns.iter().sum();
    let len = (6 + 2 * columns.len() as u16 + sum).next_multiple_of(4);
    let head = [1, len - 1, columns.len() as u16];
    let mut bytes: Vec<u8> = head.iter().chain(columns).flat_map(|number| number.to_le_bytes()).collect();
    bytes.resize(len.into(), 0);
    bytes
}

#[test]
fn forged_counts_endless_lines_and_bombs_take_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let points: Vec<_> = (0..20_000).map(|n| [f64::from(n % 141), f64::from(n / 141), 1.0]).collect();
    e57(&at("good.e57"), &[Cloud { points: &points, form: E57::Single, posed: false, mixed: true }], None);
    let good = std::fs::read(at("good.e57")).unwrap();
    assert!(with_xml(&good, str::to_owned) == good, "putting the same XML back changes nothing");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    let constant = |xml: &str| {
        let mut out = xml.to_owned();
        for name in ["cartesianX", "cartesianY", "cartesianZ"] {
            let begin = out.find(&format!("<{name} ")).unwrap();
            let end = begin + out[begin..].find('>').unwrap();
            out.replace_range(begin..end, &format!("<{name} type=\"Integer\" minimum=\"5\" maximum=\"5\""));
        }
        out
    };
    let count = |xml: &str, to: &str| xml.replacen("recordCount=\"24000\"", &format!("recordCount=\"{to}\""), 1);
    let entity = "<!DOCTYPE e57Root [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;&a;&a;&a;&a;\">]>";
    let bomb = |xml: &str| {
        let begin = xml.find("<e57Root").unwrap();
        format!("{}{entity}{}", &xml[..begin], &xml[begin..])
    };
    let nodes = |xml: &str| xml.replacen("</e57Root>", &format!("{}</e57Root>", "<a/>".repeat(3_000_000)), 1);
    let attributes = |xml: &str| {
        let many: String = (0..1_000_000).map(|n| format!(" a{n}=\"\"")).collect();
        xml.replacen("</e57Root>", &format!("<a{many}/></e57Root>"), 1)
    };
    let deep = |xml: &str| xml.replacen("</e57Root>", &"<a>".repeat(1_000_000), 1);
    let mut length = good.clone();
    length[32..40].copy_from_slice(&(1u64 << 40).to_le_bytes());
    let huge_ply = text(ply(&points, Ply::Text)).replacen("vertex 20000", "vertex 18446744073709551615", 1);
    let mut binary = ply(&points, Ply::Little);
    let place = binary.windows(12).position(|w| w == b"vertex 20000").unwrap();
    binary.splice(place..place + 12, *b"vertex 18446744073709551615");
    let mut lists = ply(&points, Ply::Little);
    let place = lists.windows(8).position(|w| w == b"camera 2").unwrap();
    lists.splice(place..place + 8, *b"camera 999999999999");
    let mut lonely = [0; 9];
    lonely[0] = 60_000;
    let mut longer = packet(&[100; 9]);
    longer[6..8].copy_from_slice(&u16::MAX.to_le_bytes());
    let cases: Vec<(&str, Vec<u8>, &str)> = vec![
        ("count.e57", with_xml(&good, |xml| count(xml, "18446744073709551615")), "its packets hold 24000 whole ones"),
        ("constant.e57", with_xml(&good, |xml| count(&constant(xml), "999999999999999")), "packet"),
        (
            "offset.e57",
            with_xml(&good, |xml| xml.replacen("fileOffset=\"", "fileOffset=\"9999999999", 1)),
            "beyond the file",
        ),
        // Chains of packets without points, and of packets whose points never become complete.
        ("chain.e57", with_packets(&good, &[0, 0, 3, 0].repeat(2_000_000)), "its packets hold 0 whole ones"),
        ("empty.e57", with_packets(&good, &packet(&[0; 9]).repeat(300_000)), "its packets hold 0 whole ones"),
        ("apart.e57", with_packets(&good, &packet(&lonely).repeat(500)), "bytes apart"),
        ("long.e57", with_packets(&good, &longer), "it is damaged"),
        ("bomb.e57", with_xml(&good, bomb), "XML"),
        ("nodes.e57", with_xml(&good, nodes), "XML"),
        ("attributes.e57", with_xml(&good, attributes), "XML"),
        ("deep.e57", with_xml(&good, deep), "XML"),
        ("length.e57", length, "bytes of the XML"),
        (
            "codec.e57",
            with_xml(&good, |xml| {
                xml.replacen("<prototype", "<codecs><vectorChild><zipCodec/></vectorChild></codecs><prototype", 1)
            }),
            "codec \"zipCodec\"",
        ),
        (
            "images.e57",
            with_xml(&good, |xml| {
                let (begin, end) = (xml.find("<data3D").unwrap(), xml.find("</data3D>").unwrap() + 9);
                format!(
                    "{}<images2D><vectorChild/></images2D></e57Root>",
                    &xml.replace(&xml[begin..end], "").replace("</e57Root>", "")
                )
            }),
            "1 images and no cloud",
        ),
        ("text.ply", huge_ply.into_bytes(), "20001 lines follow"),
        ("binary.ply", binary, "the file holds"),
        ("lists.ply", lists, "the file ends within"),
        ("line.xyz", vec![b'1'; 64 << 20], "a line of more than 65536 bytes"),
        ("line.pcd", vec![b'V'; 64 << 20], "no DATA line"),
        ("blank.xyz", vec![b'\n'; 32 << 20], ""),
        (
            "width.pcd",
            text(pcd(&points, Pcd::Text)).replace(" 20000\n", " 9223372036854775807\n").into_bytes(),
            "20000 lines follow",
        ),
        (
            "many.ptx",
            b"1\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3 4\n".repeat(70_000),
            "clouds in",
        ),
        ("zip.xyz.zst", zstd::encode_all(&vec![b'7'; 64 << 20][..], 1).unwrap(), "a line of more than 65536 bytes"),
    ];
    for (name, bytes, words) in cases {
        std::fs::write(at(name), bytes).unwrap();
        let (result, peak) = heap::measured(|| read(&at(name)));
        std::fs::remove_file(at(name)).unwrap();
        match result {
            Err(error) => assert!(!words.is_empty() && error.to_string().contains(words), "{name}: {error}"),
            Ok(points) => assert_eq!((words, points), ("", 0), "{name}"),
        }
        // XML of at most 16 MiB, and its tree.
        let most = if name.ends_with("e57") { 4 * MOST_BYTES } else { MOST_BYTES };
        assert!(peak < most, "{name}: {peak} bytes");
    }
}
