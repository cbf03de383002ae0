//! Heightfield tiles, read back: each sample is the highest floor of its pixel that is nearest to its storey.

use crate::scene::{converted, export};
use serde_json::Value;
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use std::collections::BTreeMap;
use std::fs;
use std::io::BufReader;
use std::path::Path;

/// Width, height and samples of a grey image of 16 bits, row by row from the greatest y.
fn image(path: &Path) -> ([usize; 2], Vec<u16>) {
    let mut reader = png::Decoder::new(BufReader::new(fs::File::open(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Grayscale, png::BitDepth::Sixteen));
    let samples = bytes.chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
    ([info.width as usize, info.height as usize], samples)
}

#[test]
fn samples_are_the_highest_floors_of_their_storey() {
    // A hall of 60 m with a slope, longer than a tile, and an upper floor over a part of it.
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let lower = (0..1200).flat_map(|i| (0..60).map(move |j| [step(i), step(j), 0.01 * step(i) + 0.02]));
    let upper = (0..200).flat_map(|i| (0..60).map(move |j| [step(i), step(j), 3.1]));
    let folder = converted(lower.chain(upper).collect(), 0.1, None);
    let at = folder.path();
    let said = export(at, &["-o", "hall.heightfield.json"]);
    assert_eq!(said, "hall.heightfield.json: 3 tiles of 2 storeys\n");
    let about: Value = serde_json::from_slice(&fs::read(at.join("hall.heightfield.json")).unwrap()).unwrap();
    let storeys = about["storeys"].as_array().unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    let levels: Vec<f64> = storeys.iter().map(|storey| number(&storey["z"])).collect();

    // Highest floor of each pixel and storey, from the archive.
    let archive = Archive::open(at.join("a.slices")).unwrap();
    let frame = archive.frame();
    let mut expected: BTreeMap<(usize, i64, i64), f64> = BTreeMap::new();
    for entry in archive.entries() {
        let entry = entry.unwrap();
        for (px, py, spans) in archive.page(&entry).unwrap().columns() {
            for span in spans.iter().filter(|span| !span.is_obstacle()) {
                let top =
                    (i64::from(entry.key.layer) * PAGE_QUANTA + i64::from(span.top())) as f64 * frame.slice_m() / 255.0;
                let storey = usize::from((top - levels[1]).abs() < (top - levels[0]).abs());
                let pixel = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
                let own = expected.entry((storey, pixel(entry.key.tx, px), pixel(entry.key.ty, py))).or_insert(top);
                *own = own.max(top);
            }
        }
    }
    let mut found: BTreeMap<(usize, i64, i64), f64> = BTreeMap::new();
    for (storey, of) in storeys.iter().enumerate() {
        let [offset, step] = ["height_offset", "height_step"].map(|key| number(&of[key]));
        for tile in of["tiles"].as_array().unwrap() {
            let ([width, height], samples) = image(&at.join(tile["file"].as_str().unwrap()));
            assert_eq!([width as f64, height as f64], [number(&about["samples"]); 2]);
            for (place, sample) in samples.iter().enumerate().filter(|(_, sample)| **sample != 0) {
                let x = number(&tile["x"]) + (place % width) as f64 * number(&about["pixel_size"]);
                let y = number(&tile["y"]) + (height - 1 - place / width) as f64 * number(&about["pixel_size"]);
                let z = offset + step * f64::from(*sample);
                let before = found.insert((storey, frame.pixel_of(x), frame.pixel_of(y)), z);
                assert!(before.is_none_or(|before| before == z), "tiles disagree at ({x}, {y})");
            }
        }
    }
    assert!(expected.len() > 20_000, "{}", expected.len());
    assert!(expected.keys().eq(found.keys()), "{} and {} samples", expected.len(), found.len());
    for (pixel, z) in &expected {
        assert!((found[pixel] - z).abs() < 1e-6, "{pixel:?}: {} and {z}", found[pixel]);
    }
}
