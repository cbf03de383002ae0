//! Bits for an occupied cube, beside the general coders of point clouds.
//!
//! The cubes of a scan are the voxels of an archive whose slices are as high as its pixels are wide. Their centres,
//! converted again, are an archive that holds what the others hold, and which cubes are obstacles.

use super::{Case, Made, RUNS};
use crate::stability::Result;
use crate::stability::table::{Table, number, spread};
use crate::venv::python;
use slicewalk::archive::PageDecoder;
use slicewalk_input::Units;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

const DRACO: &str = include_str!("../../draco/size.py");

/// Scans, edges of the cubes (m), and bits a cube of G-PCC with flags, as measured elsewhere (see `cubes.md`).
const SETS: [(&str, f64, f64); 6] = [
    ("indoor_two_storey_zup", 0.05, 2.39),
    ("indoor_two_storey_zup", 0.02, 5.56),
    ("delft_city_block_ahn3", 0.1, 8.63),
    ("pump_room", 0.022, 2.18),
    ("corridor_three_stations", 0.066, 2.80),
    ("forest_plot_tls", 0.17, 4.05),
];

/// Identical cubes in an archive, in Draco and in G-PCC.
pub struct Cubes {
    /// Scan and edge of the cubes.
    pub name: String,
    /// Bits a cube of an archive.
    pub bits: f64,
    /// Bits a cube of Draco, without flags; `None` where it is not installed.
    pub draco_bits: Option<f64>,
    /// Bits a cube of G-PCC, with flags, as measured elsewhere.
    pub gpcc_bits: f64,
}

/// Returns the table of the sets whose scans are there, and their figures.
pub fn measure(folder: &Path, quick: bool) -> Result<(Table, Vec<Cubes>)> {
    let mut found = Vec::new();
    let mut table =
        Table::new(["scan", "cube (m)", "cubes", "archive", "Draco", "G-PCC and flags", "ns a cube", "ns a span"]);
    for &(name, edge_m, gpcc_bits) in &SETS[..if quick { 1 } else { SETS.len() }] {
        let Some(file) = crate::data::file(&format!("{name}.laz")) else { continue };
        eprintln!("{name}, cubes of {edge_m} m");
        let case = |file| Case { name: name.to_owned(), file, pixel_m: edge_m, units: Units::Factor(1.0) };
        let cubes = of_archive(&super::make_slices(&case(file), 0.0, Some(edge_m), folder)?)?;
        let centres = folder.join("centres.xyz");
        let mut text = String::new();
        for cube in &cubes {
            let [x, y, z] = cube.map(|at| (at as f64 + 0.5) * edge_m);
            writeln!(text, "{x:.4} {y:.4} {z:.4}")?;
        }
        std::fs::write(&centres, text)?;
        let made = super::make_slices(&case(centres), 0.0, Some(edge_m), folder)?;
        assert_eq!(of_archive(&made)?, cubes, "{name}: the archive holds other cubes");
        let decode_ns = decode_ns(&made)?;
        let bits_of = |bytes: u64| bytes as f64 * 8.0 / cubes.len() as f64;
        let draco = draco_bytes(&cubes).map(bits_of);
        found.push(Cubes {
            name: format!("{name}, {edge_m} m"),
            bits: bits_of(made.bytes),
            draco_bits: draco.as_ref().ok().copied(),
            gpcc_bits,
        });
        table.row([
            name.to_owned(),
            number(edge_m, 3),
            cubes.len().to_string(),
            number(bits_of(made.bytes), 2),
            draco.map_or_else(|reason| format!("({reason})"), |bits| number(bits, 2)),
            number(gpcc_bits, 2),
            number(decode_ns / cubes.len() as f64, 0),
            number(decode_ns / made.stats.spans as f64, 0),
        ]);
    }
    Ok((table, found))
}

/// Returns the occupied voxels, sorted.
fn of_archive(made: &Made) -> Result<Vec<[i64; 3]>> {
    let (mut cubes, mut decoder) = (Vec::new(), PageDecoder::new());
    for entry in made.archive.entries() {
        let entry = entry?;
        let page = made.archive.page_with(&entry, &mut decoder)?;
        let [x, y, z] = [entry.key.tx, entry.key.ty, entry.key.layer].map(|at| i64::from(at) * 64);
        for (px, py, spans) in page.columns() {
            let slices = spans.iter().fold(0u64, |slices, span| slices | span.slice_mask());
            let occupied = (0..64).filter(|k| slices >> k & 1 == 1);
            cubes.extend(occupied.map(|k| [x + i64::from(px), y + i64::from(py), z + k]));
        }
    }
    cubes.sort_unstable();
    Ok(cubes)
}

/// Returns the median time for decoding all pages (ns).
fn decode_ns(made: &Made) -> Result<f64> {
    let mut decoder = PageDecoder::new();
    let entries = made.archive.entries().collect::<std::result::Result<Vec<_>, _>>()?;
    let mut times = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        for entry in &entries {
            std::hint::black_box(made.archive.page_with(entry, &mut decoder)?);
        }
        times.push(start.elapsed().as_secs_f64() * 1e9);
    }
    Ok(spread(&times)[0])
}

/// Returns the bytes of the cubes in Draco; an error says in a few words why it cannot.
fn draco_bytes(cubes: &[[i64; 3]]) -> Result<u64> {
    let mut child = Command::new(python()?).args(["-c", DRACO]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
    let bytes: Vec<u8> = cubes.iter().flatten().flat_map(|&at| (at as i32).to_le_bytes()).collect();
    child.stdin.take().ok_or("no input")?.write_all(&bytes)?;
    let output = child.wait_with_output()?;
    let text = String::from_utf8(output.stdout)?;
    Ok(text.trim().parse().map_err(|_| "DracoPy is not in the virtual environment")?)
}
