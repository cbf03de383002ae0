//! Floors of storeys as tiles of heights for the terrain of engines: `NAME.heightfield.json` with images beside it,
//! `NAME_storeyN_X_Y.png` (grey, 16 bits).
//!
//! A sample is the highest floor in its pixel among those that are nearest to the storey in height, and 0 where there is
//! none. Tiles have a power of two of samples along an edge, and one more that they share with the next tile.

use super::nav2::{Ground, Which};
use crate::Failure;
use crate::ground::{Loader, Pawns, tidy};
use serde_json::{Value, json};
use slicewalk::archive::PageReader;
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use slicewalk_base::text::{counted, one_line};
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::Path;

/// Pixels from one tile to the next.
const STRIDE: i64 = 512;
/// Greatest sample.
const MOST: i64 = 65_535;

/// Returns whether a file's name ends in `.heightfield.json`.
pub fn is_name(output: &Path) -> bool {
    stem(output).is_some()
}

fn stem(output: &Path) -> Option<&str> {
    let name = output.file_name()?.to_str()?;
    let stem = name.get(..name.len().checked_sub(ENDING.len())?)?;
    name.to_ascii_lowercase().ends_with(ENDING).then_some(stem)
}

const ENDING: &str = ".heightfield.json";

/// Writes the tiles of an archive at `path`; returns a line about them. Memory: the standing places of the pawn, and the
/// heights of one storey.
pub fn write(output: &Path, path: &Path, pawns: &Pawns, which: Which) -> Result<String, Failure> {
    let loader = Loader::new(pawns.open(path)?, path, pawns.cache())?;
    // Before the work, which would be lost if it must not be replaced.
    let to = crate::output(output, loader.archive(), &[])?;
    let ground = Ground::of(&loader, pawns.pawn())?;
    let chosen = ground.chosen(which)?;
    let (mut storeys, mut count) = (Vec::new(), 0);
    for storey in 0..ground.storeys().len() {
        if chosen.is_none_or(|chosen| chosen == storey) {
            let (about, tiles) = storey_tiles(&ground, &loader, output, storey)?;
            storeys.push(about);
            count += tiles;
        }
    }
    let about = json!({
        "generator": format!("slicetool {}", env!("CARGO_PKG_VERSION")),
        "pixel_size": loader.archive().frame().pixel_m(),
        "samples": STRIDE + 1,
        "storeys": storeys,
    });
    let mut file = BufWriter::new(to);
    writeln!(file, "{about:#}")?;
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    let storeys = counted(storeys.len() as u64, "storey");
    Ok(format!("{}: {} of {storeys}\n", one_line(&output.to_string_lossy()), counted(count, "tile")))
}

/// Writes the tiles of a storey; returns their entry in the list, and their number.
fn storey_tiles(ground: &Ground, loader: &Loader, output: &Path, storey: usize) -> Result<(Value, u64), Failure> {
    let (archive, frame) = (loader.archive(), loader.archive().frame());
    let ([left, lower], [width, height]) = (ground.first(), ground.size());
    let heights: Vec<f64> = ground.storeys().iter().map(|storey| storey.z).collect();
    let is_near = |top: i64| {
        let far = |z: f64| (frame.top_height(top) - z).abs();
        heights.iter().enumerate().all(|(other, z)| other == storey || far(heights[storey]) <= far(*z))
    };
    let broken = |error| crate::broken(loader.path(), &error);
    let mut tops: Vec<Option<i64>> = vec![None; (width * height) as usize];
    let mut pages = PageReader::new(archive);
    for entry in crate::entries(archive, loader.path()) {
        let entry = entry?;
        let base = i64::from(entry.key.layer) * PAGE_QUANTA;
        for (px, py, spans) in pages.page(&entry).map_err(broken)?.columns() {
            let at = |tile: i32, pixel: u32, first: i64| i64::from(tile) * TILE_PIXELS + i64::from(pixel) - first;
            let (x, y) = (at(entry.key.tx, px, left), at(entry.key.ty, py, lower));
            let floors = spans.iter().filter(|span| !span.is_obstacle()).map(|span| base + i64::from(span.top()));
            if let Some(top) = floors.filter(|top| is_near(*top)).max() {
                let own = &mut tops[(y * width + x) as usize];
                *own = (*own).max(Some(top));
            }
        }
    }
    let (low, high) =
        tops.iter().flatten().fold((i64::MAX, i64::MIN), |(low, high), top| (low.min(*top), high.max(*top)));
    // Sample 1 is the lowest floor.
    let span = high.saturating_sub(low).max(0);
    let quanta = (span + MOST - 2) / (MOST - 1);
    let quanta = quanta.max(1);
    let mut tiles = Vec::new();
    for row in 0..(height - 1).max(0) / STRIDE + 1 {
        for column in 0..(width - 1).max(0) / STRIDE + 1 {
            let sample = |at: i64| {
                // The first row of an image is the one of the greatest y.
                let (x, y) = (column * STRIDE + at % (STRIDE + 1), row * STRIDE + STRIDE - at / (STRIDE + 1));
                let top = (x < width && y < height).then(|| tops[(y * width + x) as usize]).flatten();
                top.map_or(0, |top| 1 + (top - low + quanta / 2) / quanta) as u16
            };
            let samples: Vec<u16> = (0..(STRIDE + 1) * (STRIDE + 1)).map(sample).collect();
            if samples.iter().all(|sample| *sample == 0) {
                continue;
            }
            let name = format!("{}_storey{storey}_{column}_{row}.png", stem(output).unwrap_or_default());
            let image = output.with_file_name(&name);
            png(&image, loader, &samples, output)?;
            let middle = |first: i64, number: i64| frame.edge_of_pixel(first + number * STRIDE) + frame.pixel_m() / 2.0;
            tiles.push(json!({
                "file": name, "column": column, "row": row,
                "x": tidy(middle(left, column)), "y": tidy(middle(lower, row)),
            }));
        }
    }
    let step = quanta as f64 * frame.quantum_m();
    let offset = if tiles.is_empty() { 0.0 } else { frame.top_height(low) - step };
    let count = tiles.len() as u64;
    let about = json!({
        "storey": storey, "z": tidy(heights[storey]), "height_offset": offset, "height_step": step, "tiles": tiles,
    });
    Ok((about, count))
}

/// Writes an image of 16-bit samples.
fn png(image: &Path, loader: &Loader, samples: &[u16], output: &Path) -> Result<(), Failure> {
    let mut file = BufWriter::new(crate::output(image, loader.archive(), &[output])?);
    let edge = (STRIDE + 1) as u32;
    let mut encoder = png::Encoder::new(&mut file, edge, edge);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let bytes: Vec<u8> = samples.iter().flat_map(|sample| sample.to_be_bytes()).collect();
    encoder.write_header()?.write_image_data(&bytes)?;
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    Ok(())
}
