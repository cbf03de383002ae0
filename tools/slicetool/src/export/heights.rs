//! Heights of floors as a GeoTIFF: one sample per pixel, north up, NaN where there is no floor.

use super::crs::Crs;
use crate::Failure;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use slicewalk::archive::{Archive, PageEntry, PageReader};
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use slicewalk_base::output::Output;
use std::cmp::Reverse;
use std::io::{BufWriter, Write};
use std::path::Path;
use tiff::encoder::TiffEncoder;
use tiff::tags::{CompressionMethod, PhotometricInterpretation, SampleFormat, Tag};

/// Most samples: a classic TIFF holds at most 4 GiB, and noise may not compress.
const MOST_PIXELS: i64 = 1 << 28;
/// Rows of a strip, which readers load as a unit.
const STRIP: i64 = TILE_PIXELS;

/// Writes the highest floor of each pixel, at most `highest` (m) if given; returns width and height. Samples have
/// 32 bits if these resolve a quantum of height, otherwise 64. Memory: a row of tiles, and an entry per page.
pub fn tif(
    archive: &Archive,
    path: &Path,
    highest: Option<f64>,
    to: Output,
    crs: Option<&Crs>,
) -> Result<[u32; 2], Failure> {
    let frame = archive.frame();
    let Some((min, max)) = archive.header().bounds else {
        return Err(Failure::Text(format!("{}: holds no points, so there are no heights", path.display())));
    };
    let farthest = [min[2], max[2]].map(f64::abs).into_iter().fold(0.0, f64::max);
    let is_fine = farthest * f64::from(f32::EPSILON) < frame.quantum_m() / 2.0;
    let broken = |error| crate::broken(path, &error);
    let highest = highest.map_or(i64::MAX, |z| frame.quantum_floor(z));
    let mut entries: Vec<PageEntry> = archive.entries().collect::<Result<_, _>>().map_err(broken)?;
    // Highest row of tiles first; within a column the lowest page first, so that higher floors come last.
    entries.sort_unstable_by_key(|entry| (Reverse(entry.key.ty), entry.key.tx, entry.key.layer));
    let ends = |of: fn(&PageEntry) -> i32| {
        let all = || entries.iter().map(of);
        (i64::from(all().min().unwrap_or(0)), i64::from(all().max().unwrap_or(0)))
    };
    let ((left, right), (low, high)) = (ends(|entry| entry.key.tx), ends(|entry| entry.key.ty));
    let [width, height] = [right - left + 1, high - low + 1].map(|tiles| tiles * TILE_PIXELS);
    if width.saturating_mul(height) > MOST_PIXELS {
        return Err(Failure::Text(format!(
            "{}: {width} × {height} pixels, beyond the {MOST_PIXELS} of a raster; extract a region first",
            path.display()
        )));
    }
    let mut file = BufWriter::new(to);
    let size = [width, height].map(|edge| edge as u32);
    let mut tiff = TiffEncoder::new(&mut file)?;
    // Packed here strip by strip, because the encoder of whole images needs all of the image at once.
    let mut directory = tiff.image_directory()?;
    let mut pages = PageReader::new(archive);
    let (mut offsets, mut lengths) = (Vec::new(), Vec::new());
    let mut row = vec![f64::NAN; (width * STRIP) as usize];
    let mut rest = &entries[..];
    for ty in (low..=high).rev() {
        row.fill(f64::NAN);
        let count = rest.iter().take_while(|entry| i64::from(entry.key.ty) == ty).count();
        let (own, others) = rest.split_at(count);
        rest = others;
        for entry in own {
            let base = i64::from(entry.key.layer) * PAGE_QUANTA;
            if base > highest {
                continue;
            }
            for (px, py, spans) in pages.page(entry).map_err(broken)?.columns() {
                let heights = spans.iter().rev().filter(|span| !span.is_obstacle());
                let top = heights.map(|span| base + i64::from(span.top())).find(|top| *top <= highest);
                if let Some(top) = top {
                    let x = (i64::from(entry.key.tx) - left) * TILE_PIXELS + i64::from(px);
                    let y = TILE_PIXELS - 1 - i64::from(py);
                    row[(y * width + x) as usize] = frame.top_height(top);
                }
            }
        }
        let mut strip = ZlibEncoder::new(Vec::new(), Compression::default());
        for height in &row {
            match is_fine {
                true => strip.write_all(&(*height as f32).to_ne_bytes())?,
                false => strip.write_all(&height.to_ne_bytes())?,
            }
        }
        let strip = strip.finish()?;
        offsets.push(u32::try_from(directory.write_data(&strip[..])?)?);
        lengths.push(u32::try_from(strip.len())?);
    }
    directory.write_tag(Tag::ImageWidth, size[0])?;
    directory.write_tag(Tag::ImageLength, size[1])?;
    directory.write_tag(Tag::BitsPerSample, if is_fine { 32u16 } else { 64 })?;
    directory.write_tag(Tag::Compression, CompressionMethod::Deflate.to_u16())?;
    directory.write_tag(Tag::PhotometricInterpretation, PhotometricInterpretation::BlackIsZero.to_u16())?;
    directory.write_tag(Tag::StripOffsets, &offsets[..])?;
    directory.write_tag(Tag::SamplesPerPixel, 1u16)?;
    directory.write_tag(Tag::RowsPerStrip, STRIP as u32)?;
    directory.write_tag(Tag::StripByteCounts, &lengths[..])?;
    directory.write_tag(Tag::SampleFormat, SampleFormat::IEEEFP.to_u16())?;
    let corner = [frame.edge_of_pixel(left * TILE_PIXELS), frame.edge_of_pixel((high + 1) * TILE_PIXELS)];
    directory.write_tag(Tag::ModelPixelScaleTag, &[frame.pixel_m(), frame.pixel_m(), 0.0][..])?;
    directory.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, corner[0], corner[1], 0.0][..])?;
    directory.write_tag(Tag::GdalNodata, "nan")?;
    if let Some(keys) = crs.map(Crs::geo_keys) {
        directory.write_tag(Tag::GeoKeyDirectoryTag, &keys.directory[..])?;
        directory.write_tag(Tag::GeoAsciiParamsTag, keys.text.as_str())?;
    }
    directory.finish()?;
    file.into_inner().map_err(std::io::IntoInnerError::into_error)?.publish()?;
    Ok(size)
}
