//! Exports read by other programs' formats: E57, GeoTIFF, SVG, DXF, glTF, LAS with its reference system.

use scangen::{WriteSpec, write_las};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_QUANTA, SLICE_QUANTA, TILE_PIXELS};
use slicewalk::page::Span;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

const PIXEL_M: f64 = 0.1;

/// A floor of 4 × 4 m at z = 0.35 with a wall 2 m high along x = 3 and a roof over a quarter, far from the origin.
fn points() -> Vec<[f64; 3]> {
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let floor = (0..80).flat_map(|i| (0..80).map(move |j| [step(i), step(j), 0.35]));
    let wall = (0..80).flat_map(|j| (0..40).map(move |k| [3.025, step(j), 0.35 + step(k)]));
    let roof = (0..40).flat_map(|i| (0..40).map(move |j| [step(i), step(j), 2.75]));
    floor.chain(wall).chain(roof).map(|[x, y, z]| [x + 200_000.0, y + 500_000.0, z]).collect()
}

fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.las");
    write_las(&scan, points(), &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan.clone()], folder.path().join("a.slices"));
    options.grid.pixel = PixelSize::Metres(PIXEL_M);
    options.reading.epsg = Some(28992);
    convert(&options, &NoMonitor).unwrap();
    fs::remove_file(scan).unwrap();
    folder
}

fn export(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_slicetool"))
        .current_dir(folder)
        .args(["export", "a.slices"])
        .args(arguments)
        .output()
        .unwrap()
}

fn done(folder: &Path, arguments: &[&str]) -> String {
    let out = export(folder, arguments);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success() && said.is_empty(), "{arguments:?}: {said}");
    String::from_utf8(out.stdout).unwrap()
}

/// Bottom and top in quanta above the origin, and whether the span is an obstacle.
type Matter = (i64, i64, bool);

/// Spans by pixel.
fn columns(folder: &Path) -> BTreeMap<(i64, i64), Vec<Matter>> {
    let archive = Archive::open(folder.join("a.slices")).unwrap();
    let mut columns: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for entry in archive.entries() {
        let entry = entry.unwrap();
        let base = i64::from(entry.key.layer) * PAGE_QUANTA;
        let page = archive.page(&entry).unwrap();
        for (px, py, spans) in page.columns() {
            let pixel = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
            let span =
                |span: &Span| (base + i64::from(span.bottom()), base + i64::from(span.top()), span.is_obstacle());
            let column = columns.entry((pixel(entry.key.tx, px), pixel(entry.key.ty, py))).or_default();
            column.extend(spans.iter().map(span));
        }
    }
    columns
}

/// Top of the solid (quanta above the origin) of each voxel, by pixel and slice.
fn tops(folder: &Path) -> BTreeMap<(i64, i64, i64), i64> {
    let mut tops = BTreeMap::new();
    for ((x, y), spans) in columns(folder) {
        for (bottom, top, _) in spans {
            let (first, last) = (bottom.div_euclid(SLICE_QUANTA), (top - 1).div_euclid(SLICE_QUANTA));
            for slice in first..=last.max(first) {
                let top = top.min((slice + 1) * SLICE_QUANTA);
                tops.entry((x, y, slice)).and_modify(|above: &mut i64| *above = top.max(*above)).or_insert(top);
            }
        }
    }
    tops
}

#[test]
fn an_export_of_points_converted_again_gives_the_same_voxels() {
    let mut state = 7u64;
    let mut below = |limit: f64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64 * limit
    };
    for (pixel, slice, offset) in
        [(0.1, 0.3, [0.0; 3]), (0.25, 0.25, [481_000.3, 5_456_000.7, -3.0]), (0.037, 0.111, [-77.7, 1e6, 1234.5])]
    {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        // Floors on the faces between slices, walls through several slices, and random points, above and below 0.
        let mut points = Vec::new();
        for number in 0..6000 {
            let (x, y) = (below(60.0 * pixel) - 10.0 * pixel, below(60.0 * pixel) - 10.0 * pixel);
            let z = match number % 4 {
                0 => slice * below(3.0).floor(),
                1 => slice * (below(40.0) - 20.0),
                2 => slice * (below(40.0) - 20.0).floor(),
                _ => slice * below(9.0),
            };
            points.push(if number % 4 == 3 { [20.0 * pixel, y, z] } else { [x, y, z] });
        }
        let rows = points.iter().map(|p| [0, 1, 2].map(|axis| p[axis] + offset[axis]));
        let text = rows.map(|[x, y, z]| format!("{x} {y} {z}\n")).collect::<String>();
        fs::write(at.join("scan.xyz"), text).unwrap();
        let converted = |name: &str| {
            let mut options = ConvertOptions::new(vec![at.join(name)], at.join("a.slices"));
            (options.grid.pixel, options.grid.slice_m, options.overwrite) =
                (PixelSize::Metres(pixel), Some(slice), true);
            convert(&options, &NoMonitor).unwrap();
            tops(at)
        };
        let first = converted("scan.xyz");
        for name in ["out.ply", "out.las", "out.laz", "out.e57"] {
            converted("scan.xyz");
            done(at, &["-o", name]);
            if name.contains(".la") {
                assert_states_its_bounds(&at.join(name));
            }
            let again = converted(name);
            assert!(first.keys().eq(again.keys()), "{name} at {pixel} m: {} and {} voxels", first.len(), again.len());
            for (voxel, top) in &first {
                // A voxel of one point may be classified differently, and obstacles join the voxel above.
                let (x, y, slice) = *voxel;
                let joined = (slice + 1) * SLICE_QUANTA;
                let found = again[voxel];
                let is_joined = found == joined && first.contains_key(&(x, y, slice + 1));
                assert!((found - top).abs() <= 1 || is_joined, "{name} at {pixel} m: {voxel:?}: {top} and {found}");
            }
        }
    }
}

/// The header of a LAS file states the bounds of its points exactly.
fn assert_states_its_bounds(path: &Path) {
    fn ends(values: impl Iterator<Item = f64>) -> [f64; 2] {
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, greatest], v| [least.min(v), greatest.max(v)])
    }
    let mut reader = las::Reader::from_path(path).unwrap();
    let las::Bounds { min, max } = reader.header().bounds();
    let points = reader.read_all().unwrap();
    let found = [ends(points.x()), ends(points.y()), ends(points.z())];
    assert_eq!(found, [[min.x, max.x], [min.y, max.y], [min.z, max.z]], "{}", path.display());
}

#[test]
fn e57_holds_the_points_of_las_and_both_name_the_reference_system() {
    let folder = folder();
    let at = folder.path();
    assert_eq!(done(at, &["-o", "a.e57"]).replace("e57", "las"), done(at, &["-o", "a.las"]));
    let mut reader = las::Reader::from_path(at.join("a.las")).unwrap();
    let keys = reader.header().get_geotiff_crs().unwrap().unwrap();
    assert_eq!(keys.get_projected_crs_geo_key_value(), Some(28992));
    let all = reader.read_all().unwrap();
    let expected: Vec<_> = all.x().zip(all.y()).zip(all.z()).map(|((x, y), z)| [x, y, z]).collect();
    let mut reader = e57::E57Reader::from_file(at.join("a.e57")).unwrap();
    assert_eq!(reader.coordinate_metadata(), Some("EPSG:28992"));
    let cloud = reader.pointclouds().remove(0);
    let found: Vec<_> = reader.pointcloud_simple(&cloud).unwrap().collect::<Result<_, _>>().unwrap();
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        let e57::CartesianCoordinate::Valid { x, y, z } = found.cartesian else { panic!("{found:?}") };
        let off = [x - expected[0], y - expected[1], z - expected[2]].map(f64::abs);
        assert!(off.iter().all(|off| *off < 1e-6), "{off:?}");
    }
}

#[test]
fn the_raster_has_the_highest_floor_of_each_pixel() {
    let folder = folder();
    let at = folder.path();
    let columns = columns(at);
    let archive = Archive::open(at.join("a.slices")).unwrap();
    let frame = archive.frame();
    for (name, below) in [("all.tif", None), ("low.tif", Some(1.5))] {
        let z = below.map(|z: f64| z.to_string());
        let arguments: Vec<&str> = ["-o", name].into_iter().chain(z.iter().flat_map(|z| ["--z", z.as_str()])).collect();
        assert!(done(at, &arguments).contains("64 × 64 pixels of 0.1 m"));
        let mut decoder = Decoder::new(fs::File::open(at.join(name)).unwrap()).unwrap();
        assert_eq!(decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag).unwrap(), [0.1, 0.1, 0.0]);
        let tie = decoder.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap();
        let keys = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap();
        assert!(keys.chunks(4).any(|key| key == [3072, 0, 1, 28992]), "{keys:?}");
        let (width, _) = decoder.dimensions().unwrap();
        let DecodingResult::F32(samples) = decoder.read_image().unwrap() else { panic!("not floats of 32 bits") };
        let (left, upper) = (frame.pixel_of(tie[3] + 0.01), frame.pixel_of(tie[4] + 0.01));
        let mut filled = 0;
        for (place, sample) in samples.iter().enumerate() {
            let pixel = (left + place as i64 % i64::from(width), upper - 1 - place as i64 / i64::from(width));
            let limit = below.map_or(i64::MAX, |z| frame.quantum_floor(z));
            let tops = columns.get(&pixel).into_iter().flatten().filter(|span| !span.2 && span.1 <= limit);
            match tops.map(|span| span.1).max() {
                Some(top) => assert_eq!(*sample, frame.top_height(top) as f32, "{pixel:?}"),
                None => assert!(sample.is_nan(), "{pixel:?}"),
            }
            filled += usize::from(!sample.is_nan());
        }
        assert!(filled > 1400, "{name}: {filled}");
    }
}

/// Twice the area of rings of corners, minus holes.
fn twice_area(rings: &[Vec<[f64; 2]>]) -> f64 {
    let ring = |ring: &Vec<[f64; 2]>| -> f64 {
        let next = ring.iter().cycle().skip(1);
        ring.iter().zip(next).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum()
    };
    rings.iter().map(ring).sum()
}

/// Rings of each layer of a DXF file.
fn rings_of_dxf(text: &str) -> BTreeMap<String, Vec<Vec<[f64; 2]>>> {
    let lines: Vec<&str> = text.lines().collect();
    let mut rings: BTreeMap<String, Vec<Vec<[f64; 2]>>> = BTreeMap::new();
    let mut entity = "";
    let mut layer = String::new();
    for pair in lines.chunks(2) {
        let value = pair[1];
        match (pair[0], entity) {
            ("0", _) => entity = value,
            ("8", "POLYLINE") => {
                layer = value.to_owned();
                rings.entry(layer.clone()).or_default().push(Vec::new());
            }
            ("10", "VERTEX") => {
                rings.get_mut(&layer).unwrap().last_mut().unwrap().push([value.parse().unwrap(), 0.0]);
            }
            ("20", "VERTEX") => {
                rings.get_mut(&layer).unwrap().last_mut().unwrap().last_mut().unwrap()[1] = value.parse().unwrap();
            }
            _ => {}
        }
    }
    rings
}

#[test]
fn plans_outline_the_pixels_of_a_slice() {
    let folder = folder();
    let at = folder.path();
    // A cut above the floor shows only the wall. The slice of the floor shows all of it, and the foot of the wall.
    let said = done(at, &["-o", "a.dxf"]);
    assert_eq!(said, "a.dxf: z from 1.5 to 1.8 m\n");
    for (arguments, areas) in [(&["-o", "a.dxf"][..], [40, 0]), (&["-o", "f.dxf", "--z", "0.35"], [40, 1560])] {
        done(at, arguments);
        let text = fs::read_to_string(at.join(arguments[1])).unwrap();
        let rings = rings_of_dxf(&text);
        for (layer, area) in ["obstacles", "floors"].into_iter().zip(areas) {
            let found = rings.get(layer).map_or(0.0, |rings| {
                let near: Vec<Vec<[f64; 2]>> = rings
                    .iter()
                    .map(|ring| ring.iter().map(|[x, y]| [x - 200_000.0, y - 500_000.0]).collect())
                    .collect();
                twice_area(&near) / 2.0 / (PIXEL_M * PIXEL_M)
            });
            // Another test checks which pixels at the foot of the wall are obstacles.
            assert!((found - f64::from(area)).abs() < 130.0, "{arguments:?}: {layer} {found}");
            assert!((found - found.round()).abs() < 1e-4, "{layer} {found}");
        }
    }
    assert!(done(at, &["-o", "a.svg"]).starts_with("a.svg: 1:20, z from 1.5 to 1.8 m"));
    let svg = fs::read_to_string(at.join("a.svg")).unwrap();
    assert!(
        svg.contains("EPSG:28992") && svg.contains(r#"<path id="obstacles""#) && svg.ends_with("</svg>\n"),
        "{svg}"
    );
    let twice = done(at, &["-o", "b.svg", "--z", "1.6"]);
    assert!(twice.contains("z from 1.5") && fs::read_to_string(at.join("b.svg")).unwrap() == svg);
}

#[test]
fn the_surface_is_closed_and_encloses_the_matter() {
    let folder = folder();
    let at = folder.path();
    let said = done(at, &["-o", "a.glb"]);
    let bytes = fs::read(at.join("a.glb")).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((word(0), word(4), word(8)), (0x4654_6C67, 2, bytes.len()));
    let head: Value = serde_json::from_slice(&bytes[20..20 + word(12)]).unwrap();
    let count = |accessor: usize| head["accessors"][accessor]["count"].as_u64().unwrap() as usize;
    let binary = 28 + word(12);
    let float = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
    let place = |number: usize| [0, 1, 2].map(|axis| float(binary + 12 * number + 4 * axis));
    let indices = binary + 12 * count(0);
    assert!(said.contains(&format!("{} triangles", slicewalk_base::text::grouped(count(1) as u64 / 3))), "{said}");
    let (mut volume, mut edges) = (0.0, BTreeMap::new());
    for triangle in 0..count(1) / 3 {
        let corners = [0, 1, 2].map(|corner| word(indices + 12 * triangle + 4 * corner));
        let [a, b, c] = corners.map(place);
        volume += a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0]);
        for side in 0..3 {
            let (from, to) = (corners[side], corners[(side + 1) % 3]);
            *edges.entry([from.min(to), from.max(to)]).or_insert(0) += if from < to { 1 } else { -1 };
        }
    }
    assert!(edges.values().all(|sum| *sum == 0));
    let archive = Archive::open(at.join("a.slices")).unwrap();
    let cell = archive.frame().pixel_m().powi(2) * archive.frame().quantum_m();
    let columns = columns(at);
    let expected: i64 = columns.values().flatten().map(|span| span.1 - span.0).sum();
    assert!((volume / 6.0 / cell - expected as f64).abs() < 1e-3 * expected as f64, "{volume} {expected}");
    let node = &head["nodes"][0]["translation"];
    let [x, y] = [&node[0], &node[2]].map(|value| value.as_f64().unwrap());
    assert!((x - 200_000.0).abs() < 0.2 && (y + 500_000.0).abs() < 0.2, "{node}");
}

#[test]
fn options_that_mean_nothing_for_a_format_are_refused() {
    let folder = folder();
    let at = folder.path();
    let formats = [
        "a.ply",
        "a.las",
        "a.laz",
        "a.e57",
        "a.glb",
        "a.obj",
        "a.tif",
        "a.svg",
        "a.dxf",
        "a.yaml",
        "a.heightfield.json",
        "a.bt",
        "a.voxel.json",
    ];
    // Each option, a value, the formats that it is for, and how the message names them.
    let options: [(&[&str], &[&str], &str); 15] = [
        (&["--slice", "1"], &["a.svg", "a.dxf"], ".svg and .dxf"),
        (
            &["--z", "1"],
            &["a.tif", "a.svg", "a.dxf", "a.yaml", "a.heightfield.json"],
            ".tif, .svg, .dxf, .yaml and .heightfield.json",
        ),
        (&["--storey", "0"], &["a.yaml", "a.heightfield.json"], ".yaml and .heightfield.json"),
        (&["--error", "0.5"], &["a.glb", "a.obj"], ".glb and .obj"),
        (&["--triangles", "500"], &["a.glb", "a.obj"], ".glb and .obj"),
        (
            &["--pawn", "box:0.5x0.5x1.8"],
            &["a.yaml", "a.heightfield.json"],
            ".yaml, .heightfield.json and layers of .tif",
        ),
        (&["--profile", "foot"], &["a.yaml", "a.heightfield.json"], ".yaml, .heightfield.json and layers of .tif"),
        (&["--climb", "0.35"], &["a.yaml", "a.heightfield.json"], ".yaml, .heightfield.json and layers of .tif"),
        (&["--max-drop", "0.35"], &["a.yaml", "a.heightfield.json"], ".yaml and .heightfield.json"),
        (&["--max-grade", "90"], &["a.yaml", "a.heightfield.json"], ".yaml and .heightfield.json"),
        (&["--max-ramp", "6"], &["a.yaml", "a.heightfield.json"], ".yaml and .heightfield.json"),
        (&["--seen"], &[], "`reach` and `route`"),
        (&["--edits", "e.json"], &["a.yaml"], ".yaml and .npy; for others, `slicetool extract --edits` makes a copy"),
        (&["--ignore-inferred"], &["a.yaml", "a.heightfield.json", "a.tif"], ".yaml, .heightfield.json, .npy and .tif"),
        (&["--cache", "64MiB"], &["a.yaml", "a.heightfield.json"], ".yaml, .heightfield.json, .npy and layers of .tif"),
    ];
    for (option, accepting, named) in options {
        for format in formats {
            if accepting.contains(&format) {
                continue;
            }
            let out = export(at, &[&["-o", format], option].concat());
            let said = String::from_utf8(out.stderr).unwrap();
            assert_eq!(out.status.code(), Some(2), "{option:?} with {format}: {said}");
            assert_eq!(said, format!("slicetool: {}: this option is only for {named}\n", option[0]), "{format}");
        }
    }
    let help = String::from_utf8(export(at, &["--help"]).stdout).unwrap();
    assert!(help.contains("--edits") && !help.contains("--seen"), "no option without a use: {help}");
    assert_eq!(export(at, &["-o", "a.svg", "--slice", "1", "--z", "1"]).status.code(), Some(2));
    let out = export(at, &["-o", "a.dxf", "--z", "99"]);
    assert!(out.status.code() == Some(1) && String::from_utf8_lossy(&out.stderr).contains("no such slice"));
    assert_eq!(fs::read_dir(at).unwrap().count(), 1);
}

/// Writes an archive of a scan that states this text as its system, in a unit.
fn stated(folder: &Path, wkt: &str, units: Units) {
    let mut head = las::Builder::from((1, 4)).into_header().unwrap();
    head.set_wkt_crs(wkt.as_bytes().to_vec()).unwrap();
    let mut writer = las::Writer::from_path(folder.join("w.las"), head).unwrap();
    for [x, y, z] in points() {
        writer.write_point(las::Point { x: x - 200_000.0, y: y - 500_000.0, z, ..Default::default() }).unwrap();
    }
    writer.close().unwrap();
    let mut options = ConvertOptions::new(vec![folder.join("w.las")], folder.join("a.slices"));
    options.grid.pixel = PixelSize::Metres(PIXEL_M);
    options.overwrite = true;
    options.reading.units = units;
    convert(&options, &NoMonitor).unwrap();
}

#[test]
fn well_known_text_goes_on_and_a_system_in_feet_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let system = |unit: &str| format!(r#"PROJCS["P",GEOGCS["G",UNIT["degree",0.0174532925199433]],UNIT[{unit}]]"#);
    let metres = system(r#""metre",1"#);
    stated(at, &metres, Units::Auto);
    done(at, &["-o", "m.las"]);
    let reader = las::Reader::from_path(at.join("m.las")).unwrap();
    let text = String::from_utf8_lossy(reader.header().get_wkt_crs_bytes().unwrap()).into_owned();
    assert_eq!(text.trim_end_matches('\0'), metres);
    // Coordinates in metres do not make the system one of metres.
    for units in [Units::Auto, Units::Factor(1.0)] {
        stated(at, &system(r#""foot",0.3048"#), units);
        let out = export(at, &["-o", "f.las"]);
        let said = String::from_utf8(out.stderr).unwrap();
        let is_said = said.contains("states no reference system") && said.lines().count() == 1;
        assert!(out.status.success() && is_said, "{units:?}: {said}");
        assert!(!las::Reader::from_path(at.join("f.las")).unwrap().header().has_crs_vlrs());
    }
}
