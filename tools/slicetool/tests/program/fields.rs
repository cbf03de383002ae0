//! Exports for planners: signed distances as `.npy`, and layers of a GeoTIFF, on scenes of known form.

use crate::scene::{converted, each_span, export, floor_wall_roof, run};
use slicewalk::archive::Archive;
use std::fs;
use std::path::Path;
use tempfile::TempDir;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

const PIXEL_M: f64 = 0.1;

/// A floor, a wall and a roof, and a ramp of 26.6° behind y = 5.
fn folder() -> TempDir {
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let ramp = (0..160).flat_map(|i| (0..80).map(move |j| [step(i) / 2.0, 5.0 + step(j) / 2.0, step(i) / 4.0]));
    converted(floor_wall_roof().into_iter().chain(ramp).collect(), PIXEL_M, None)
}

/// Boxes of all spans (m).
fn spans(folder: &Path) -> Vec<[[f64; 2]; 3]> {
    let archive = Archive::open(folder.join("a.slices")).unwrap();
    let quantum = archive.frame().quantum_m();
    let mut boxes = Vec::new();
    each_span(&archive, |pixel, bottom, top| {
        let [x, y] = pixel.map(|pixel| [pixel as f64 * PIXEL_M, (pixel + 1) as f64 * PIXEL_M]);
        boxes.push([x, y, [bottom, top].map(|height| height as f64 * quantum)]);
    });
    boxes
}

/// Shape and samples of a `.npy` of version 1.0.
fn npy(path: &Path) -> (String, Vec<f32>) {
    let bytes = fs::read(path).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\0");
    let end = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let head = std::str::from_utf8(&bytes[10..end]).unwrap();
    assert!(end % 64 == 0 && head.ends_with('\n'), "{head:?}");
    (head.trim_end().to_owned(), bytes[end..].as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect())
}

#[test]
fn distances_are_those_to_the_nearest_span() {
    let folder = folder();
    let at = folder.path();
    let spans = spans(at);
    let region = ["-o", "a.npy", "--esdf", "--bounds", "-0.5,0,0,4,4,3", "--within", "1"];
    for (step, size) in [(0.1, [45usize, 40, 30]), (0.13, [35, 31, 24])] {
        let step_text = step.to_string();
        let about = export(at, &[&region[..], &["--step", &step_text]].concat());
        assert!(about.contains("distances") && about.contains("axes z, y, x"), "{about}");
        let (head, samples) = npy(&at.join("a.npy"));
        let [nx, ny, nz] = size;
        assert_eq!(head, format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({nz}, {ny}, {nx}), }}"));
        assert_eq!(samples.len(), nx * ny * nz);
        let (mut inside, mut cut, mut near) = (0, 0, 0);
        for (n, found) in samples.iter().map(|found| f64::from(*found)).enumerate() {
            let first = (-0.5f64 / step).floor();
            let place = [first + (n % nx) as f64, (n / nx % ny) as f64, (n / nx / ny) as f64].map(|k| (k + 0.5) * step);
            let expected = spans
                .iter()
                .map(|span| {
                    let apart = |axis: usize| {
                        let [low, high] = span[axis];
                        (low - place[axis]).max(place[axis] - high).max(0.0)
                    };
                    (apart(0).powi(2) + apart(1).powi(2) + apart(2).powi(2)).sqrt()
                })
                .fold(f64::INFINITY, f64::min);
            match expected {
                0.0 => {
                    inside += 1;
                    assert!((-0.2..=0.0).contains(&found), "{place:?}: {found}");
                    // In the wall, away from its ends: its nearest side.
                    if (0.6..2.1).contains(&place[2]) && (0.2..3.8).contains(&place[1]) {
                        let side = (place[0] - 3.0).min(3.1 - place[0]);
                        assert!((found + side).abs() < 1e-6, "{place:?}: {found}, {side}");
                    }
                }
                _ => {
                    (cut, near) = (cut + u32::from(expected > 1.0), near + u32::from(expected <= 1.0));
                    assert!((found - expected.min(1.0)).abs() < 1e-6, "{place:?}: {found}, {expected}");
                }
            }
        }
        assert!(inside > 100 && cut > 100 && near > 1000, "{inside} {cut} {near}");
    }
    // All of the archive in steps of a pixel, by default.
    let about = export(at, &["-o", "all.npy", "--esdf"]);
    assert!(about.contains("of 0.1 m"), "{about}");
    let refused = |arguments: &[&str], code: i32, said: &str| {
        let out = run(at, arguments);
        let text = String::from_utf8(out.stderr).unwrap();
        assert!(out.status.code() == Some(code) && text.contains(said), "{arguments:?}: {text}");
    };
    refused(&["-o", "b.npy"], 2, "--esdf");
    refused(&["-o", "b.tif", "--esdf"], 2, "--esdf");
    refused(&["-o", "b.tif", "--step", "1"], 2, "only for .npy");
    refused(&["-o", "b.npy", "--esdf", "--step", "0"], 2, "above 0");
    refused(&["-o", "b.npy", "--esdf", "--bounds", "0,0,0,inf,1,1"], 1, "without inf");
    refused(&["-o", "b.npy", "--esdf", "--step", "1e-5"], 1, "larger --step");
    assert!(!at.join("b.npy").exists());
}

#[test]
fn layers_are_the_slopes_and_clearances_of_the_scene() {
    let folder = folder();
    let at = folder.path();
    let names = "height,slope,roughness,headroom,clearance";
    export(at, &["-o", "a.tif", "--layer", names]);
    export(at, &["-o", "h.tif"]);
    let read = |name: &str| {
        let mut decoder = Decoder::new(fs::File::open(at.join(name)).unwrap()).unwrap();
        let (width, height) = decoder.dimensions().unwrap();
        let ties = decoder.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap();
        let text = decoder.get_tag_ascii_string(Tag::Unknown(42112)).unwrap();
        let DecodingResult::F32(samples) = decoder.read_image().unwrap() else { panic!("expected f32") };
        (width as usize, height as usize, [ties[3], ties[4]], samples, text)
    };
    let (width, height, [left, north], samples, text) = read("a.tif");
    let bands = samples.len() / (width * height);
    assert_eq!((bands, samples.len() % (width * height)), (5, 0));
    let position = |name: &str| text.find(&format!(">{name}<")).unwrap();
    assert!(names.split(',').map(position).is_sorted(), "{text}");
    let (_, _, _, alone, _) = read("h.tif");
    let same = |a: f32, b: f32| a == b || a.is_nan() && b.is_nan();
    assert!(alone.iter().zip(samples.iter().step_by(5)).all(|(a, b)| same(*a, *b)), "the first band is the height");
    let sample = |x: f64, y: f64| -> [f64; 5] {
        let (i, j) = (((x - left) / PIXEL_M) as usize, ((north - y) / PIXEL_M) as usize);
        std::array::from_fn(|band| f64::from(samples[(j * width + i) * 5 + band]))
    };
    // Lowest floor: the roof hides what is under it.
    let [z, slope, roughness, headroom, clearance] = sample(2.05, 3.05);
    assert!((z - 0.35).abs() < 2e-3 && slope < 0.1 && roughness < 1e-3, "{z} {slope} {roughness}");
    assert!(headroom.is_infinite() && (0.9485..=0.9501).contains(&clearance), "{headroom} {clearance}");
    let [.., far] = sample(0.45, 2.55);
    assert!((far - 2.0).abs() < 1e-6, "{far}");
    // The middle of the ramp.
    let [_, slope, roughness, ..] = sample(2.05, 6.05);
    assert!((slope - 26.565).abs() < 1.0 && roughness < 0.02, "{slope} {roughness}");
    let none = sample(-0.05 + left + PIXEL_M, 4.55);
    assert!(none.iter().all(|value| value.is_nan()), "{none:?}");
    // Up to a height under the roof, the floor below it counts, and has headroom.
    export(at, &["-o", "a.tif", "--layer", "headroom", "--z", "1"]);
    let (_, _, _, samples, _) = read("a.tif");
    let (i, j) = (((1.05 - left) / PIXEL_M) as usize, ((north - 1.05) / PIXEL_M) as usize);
    assert!((f64::from(samples[j * width + i]) - 2.4).abs() < 4e-3, "{}", samples[j * width + i]);
    for (arguments, said) in [
        (&["-o", "b.tif", "--layer", "slope,slope"][..], "named twice"),
        (&["-o", "b.ply", "--layer", "slope"], "only for .tif"),
        (&["-o", "b.tif", "--layer", "colour"], "possible values"),
        (&["-o", "b.tif", "--layer", "slope", "--edits", "none.json"], "only for .yaml and .npy"),
        (&["-o", "b.tif", "--layer", "clearance", "--seen"], "only for `reach` and `route`"),
        (&["-o", "b.tif", "--layer", "slope", "--max-grade", "6"], "only for .yaml and .heightfield.json"),
        (&["-o", "b.tif", "--layer", "slope", "--max-ramp", "6"], "only for .yaml and .heightfield.json"),
    ] {
        let out = run(at, arguments);
        assert!(out.status.code() == Some(2) && String::from_utf8_lossy(&out.stderr).contains(said), "{arguments:?}");
    }
}
