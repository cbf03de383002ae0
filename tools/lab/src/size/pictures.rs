//! The slices of an archive as PNG files, as the thesis keeps them.

use crate::stability::Result;
use png::{BitDepth, ColorType, Encoder};
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use std::collections::BTreeMap;

/// A voxel in a picture: place, bottom, top, obstacle.
type Dot = (usize, u8, u8, bool);

/// Bytes of all slices as RGB pictures over the bounds of the points: with the thesis' colours (top, 255 for solid,
/// obstacle or floor), and with the bottom in the place of the constant 255, the content of an archive.
pub fn bytes(archive: &Archive) -> Result<[u64; 2]> {
    let Some((min, max)) = archive.header().bounds else { return Ok([0; 2]) };
    let frame = archive.frame();
    let along = |axis: usize| (frame.pixel_of(min[axis]), frame.pixel_of(max[axis]));
    let ((left, right), (low, high)) = (along(0), along(1));
    let (width, height) = ((right - left + 1) as usize, (high - low + 1) as usize);
    let mut slices: BTreeMap<i64, Vec<Dot>> = BTreeMap::new();
    for entry in archive.entries() {
        let entry = entry?;
        let (x, y) = (i64::from(entry.key.tx) * TILE_PIXELS - left, i64::from(entry.key.ty) * TILE_PIXELS - low);
        for (px, py, spans) in archive.page(&entry)?.columns() {
            let at = (y + i64::from(py)) as usize * width + (x + i64::from(px)) as usize;
            for slice in 0..PAGE_SLICES as u32 {
                let part = |span: &slicewalk::page::Span| Some((span.within_slice(slice)?, span.is_obstacle()));
                if let Some(((bottom, top), obstacle)) = spans.iter().find_map(part) {
                    let number = i64::from(entry.key.layer) * PAGE_SLICES + i64::from(slice);
                    slices.entry(number).or_default().push((at, bottom, top, obstacle));
                }
            }
        }
    }
    let mut sums = [0; 2];
    for dots in slices.values() {
        for (both, sum) in sums.iter_mut().enumerate() {
            let mut pixels = vec![0; width * height * 3];
            for &(at, bottom, top, obstacle) in dots {
                let green = if both == 1 { bottom } else { 255 };
                pixels[3 * at..3 * at + 3].copy_from_slice(&[top, green, if obstacle { 255 } else { 26 }]);
            }
            *sum += png(width, height, &pixels)?.len() as u64;
        }
    }
    Ok(sums)
}

/// A picture of three bytes a pixel as a PNG file.
pub(crate) fn png(width: usize, height: usize, pixels: &[u8]) -> Result<Vec<u8>> {
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
    encoder.write_header()?.write_image_data(pixels)?;
    Ok(file)
}
