//! Points of clouds read by the simplest means, independent of the code under test: whole files in memory, with x, y
//! and z in the first three columns.

use super::write::Point;
use std::path::Path;

/// All finite points of a PCD, PLY, PTS, PTX or text file.
pub fn points(path: &Path) -> Vec<Point> {
    let bytes = std::fs::read(path).unwrap();
    let all = match path.extension().unwrap().to_str().unwrap() {
        "pcd" => pcd(&bytes),
        "ply" => ply(&bytes),
        "ptx" => ptx(&String::from_utf8(bytes).unwrap()),
        _ => rows(&String::from_utf8(bytes).unwrap()).collect(),
    };
    all.into_iter().filter(|point: &Point| point.iter().all(|v| v.is_finite())).collect()
}

/// The first three columns of all lines with at least three numbers.
fn rows(text: &str) -> impl Iterator<Item = Point> {
    text.lines().filter_map(|line| {
        let mut words =
            line.split([' ', ',', '\t', '\r']).filter(|word| !word.is_empty()).map(|word| word.parse().ok());
        let mut next = || words.next().flatten();
        Some([next()?, next()?, next()?])
    })
}

/// The values of `names` in a header, and the bytes after its last line.
fn header<'a>(bytes: &'a [u8], last: &str) -> (&'a str, &'a [u8]) {
    let at = bytes.windows(last.len()).position(|window| window == last.as_bytes()).unwrap();
    let at = at + last.len();
    let end = at + bytes[at..].iter().position(|&byte| byte == b'\n').unwrap() + 1;
    (std::str::from_utf8(&bytes[..end]).unwrap(), &bytes[end..])
}

fn singles(bytes: &[u8]) -> impl Iterator<Item = f64> {
    bytes.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes).into())
}

fn doubles(bytes: &[u8]) -> impl Iterator<Item = f64> {
    bytes.as_chunks().0.iter().map(|&bytes| f64::from_le_bytes(bytes))
}

/// x, y and z at the start of a record of floats of 4 or 8 bytes.
fn first_three(record: &[u8], size: usize) -> Point {
    let three: Vec<f64> = if size == 4 { singles(&record[..12]).collect() } else { doubles(&record[..24]).collect() };
    three.try_into().unwrap()
}

fn pcd(bytes: &[u8]) -> Vec<Point> {
    let (head, body) = header(bytes, "\nDATA ");
    let words = |name: &str| -> Vec<&str> {
        let line = head.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace().skip(1).collect()
    };
    let numbers = |name: &str| -> Vec<usize> { words(name).iter().map(|word| word.parse().unwrap()).collect() };
    assert!(words("FIELDS")[..3].iter().map(|name| name.to_lowercase()).eq(["x", "y", "z"]));
    let (sizes, count) = (numbers("SIZE"), numbers("POINTS")[0]);
    let stride: usize = sizes.iter().zip(numbers("COUNT")).map(|(size, count)| size * count).sum();
    match words("DATA")[0] {
        "ascii" => rows(&String::from_utf8_lossy(body).replace("nan", "NaN")).take(count).collect(),
        "binary" => body.chunks(stride).take(count).map(|record| first_three(record, sizes[0])).collect(),
        _ => {
            let size = |at: usize| u32::from_le_bytes(body[at..at + 4].try_into().unwrap()) as usize;
            let plain = unpacked(&body[8..8 + size(0)]);
            assert_eq!((plain.len(), sizes[..3].iter().max()), (size(4), Some(&4)));
            let axis = |axis: usize| singles(&plain[axis * 4 * count..(axis + 1) * 4 * count]);
            axis(0).zip(axis(1)).zip(axis(2)).map(|((x, y), z)| [x, y, z]).collect()
        }
    }
}

/// Decompresses LZF.
fn unpacked(packed: &[u8]) -> Vec<u8> {
    let (mut out, mut at) = (Vec::new(), 0);
    while at < packed.len() {
        let control = usize::from(packed[at]);
        at += 1;
        if control < 32 {
            out.extend(&packed[at..=at + control]);
            at += control + 1;
            continue;
        }
        let mut len = control >> 5;
        if len == 7 {
            len += usize::from(packed[at]);
            at += 1;
        }
        let back = ((control & 31) << 8 | usize::from(packed[at])) + 1;
        at += 1;
        (0..len + 2).for_each(|_| out.push(out[out.len() - back]));
    }
    out
}

fn ply(bytes: &[u8]) -> Vec<Point> {
    let (head, body) = header(bytes, "end_header");
    let mut lines = head.lines().skip_while(|line| !line.starts_with("element vertex"));
    let count: usize = lines.next().unwrap()["element vertex ".len()..].trim().parse().unwrap();
    if head.contains("ascii") {
        return rows(std::str::from_utf8(body).unwrap()).take(count).collect();
    }
    let kinds = lines.take_while(|line| line.starts_with("property")).map(|line| line.split(' ').nth(1).unwrap());
    let sizes: Vec<usize> = kinds
        .map(|kind| match kind {
            "uchar" => 1,
            "float" => 4,
            "double" => 8,
            other => panic!("{other}"),
        })
        .collect();
    body.chunks(sizes.iter().sum()).take(count).map(|record| first_three(record, sizes[0])).collect()
}

fn ptx(text: &str) -> Vec<Point> {
    let (mut lines, mut found) = (text.lines(), Vec::new());
    while let Some(line) = lines.next() {
        let mut size = || lines.next().unwrap();
        let count = line.trim().parse::<usize>().unwrap() * size().trim().parse::<usize>().unwrap();
        let head: Vec<Vec<f64>> =
            (0..8).map(|_| size().split_whitespace().map(|word| word.parse().unwrap()).collect()).collect();
        let m = &head[4..];
        let own: Vec<&str> = lines.by_ref().take(count).collect();
        found.extend(rows(&own.join("\n")).filter(|point| *point != [0.0; 3]).map(|[x, y, z]| {
            std::array::from_fn(|axis| x * m[0][axis] + y * m[1][axis] + z * m[2][axis] + m[3][axis])
        }));
    }
    found
}
