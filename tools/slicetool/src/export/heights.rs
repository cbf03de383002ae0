//! Figures of floors as a GeoTIFF: one sample per pixel and layer, north up, NaN where there is no floor.

use super::crs::Crs;
use super::layers::{Figures, Floor, Layer};
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

/// Metadata of GDAL, which name the bands.
const GDAL_METADATA: u16 = 42112;

/// Layers to write, and what computes them.
pub struct Layers<'a> {
    pub layers: &'a [Layer],
    pub figures: Figures,
    /// Floors above this height do not count (m).
    pub highest: Option<f64>,
}

/// Floors of a row of tiles, rows from the north.
struct Row {
    width: i64,
    /// Heights (quanta); [`NONE`] where there is no floor.
    tops: Vec<i64>,
    /// Bottoms of the spans above the floors; empty if no layer needs them.
    ceilings: Vec<i64>,
}

const NONE: i64 = i64::MIN;

impl Row {
    fn new(width: i64, with_ceilings: bool) -> Self {
        let empty = || vec![NONE; (width * STRIP) as usize];
        Self { width, tops: empty(), ceilings: if with_ceilings { empty() } else { Vec::new() } }
    }

    fn get(&self, x: i64, y: i64) -> Option<Floor> {
        if !(0..self.width).contains(&x) {
            return None;
        }
        let at = (y * self.width + x) as usize;
        let ceiling = self.ceilings.get(at).copied().filter(|ceiling| *ceiling != NONE);
        Some(Floor { top: self.tops[at], ceiling }).filter(|floor| floor.top != NONE)
    }

    /// Adds the spans of a pixel on one page, lowest first; pages come lowest first, too.
    fn add(&mut self, at: usize, spans: impl Iterator<Item = (i64, i64, bool)>, highest: i64) {
        for (bottom, top, is_obstacle) in spans {
            if !is_obstacle && top <= highest {
                self.tops[at] = top;
                self.ceilings.get_mut(at).into_iter().for_each(|ceiling| *ceiling = NONE);
            } else if let Some(ceiling) = self.ceilings.get_mut(at).filter(|ceiling| **ceiling == NONE)
                && self.tops[at] != NONE
            {
                *ceiling = bottom;
            }
        }
    }
}

/// Writes the layers; returns width and height. Samples have 32 bits if these resolve a quantum of height, otherwise 64.
/// Memory: three rows of tiles, an entry per page, and for clearance the pages in the cache.
pub fn tif(
    archive: &Archive,
    path: &Path,
    layers: &Layers<'_>,
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
    let Layers { layers, figures, highest } = layers;
    let highest = highest.map_or(i64::MAX, |z| frame.quantum_floor(z));
    let mut entries: Vec<PageEntry> = crate::entries(archive, path).collect::<Result<_, _>>()?;
    // Highest row of tiles first; within a column the lowest page first, so that higher floors come last.
    entries.sort_unstable_by_key(|entry| (Reverse(entry.key.ty), entry.key.tx, entry.key.layer));
    let ends = |of: fn(&PageEntry) -> i32| {
        let all = || entries.iter().map(of);
        (i64::from(all().min().unwrap_or(0)), i64::from(all().max().unwrap_or(0)))
    };
    let ((left, right), (low, high)) = (ends(|entry| entry.key.tx), ends(|entry| entry.key.ty));
    let [width, height] = [right - left + 1, high - low + 1].map(|tiles| tiles * TILE_PIXELS);
    if width.saturating_mul(height).saturating_mul(layers.len() as i64) > MOST_PIXELS {
        return Err(Failure::Text(format!(
            "{}: {width} × {height} pixels, beyond the {MOST_PIXELS} of a raster; extract a region first, or write fewer \
             layers",
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
    let has_ceilings = layers.contains(&Layer::Headroom);
    let has_neighbours = layers.iter().any(|layer| matches!(layer, Layer::Slope | Layer::Roughness));
    let mut rest = &entries[..];
    let mut read = |ty: i64| -> Result<Row, Failure> {
        let mut row = Row::new(width, has_ceilings);
        let count = rest.iter().take_while(|entry| i64::from(entry.key.ty) == ty).count();
        let (own, others) = rest.split_at(count);
        rest = others;
        for entry in own {
            crate::go_on()?;
            let base = i64::from(entry.key.layer) * PAGE_QUANTA;
            if base > highest && !has_ceilings {
                continue;
            }
            for (px, py, spans) in pages.page(entry).map_err(broken)?.columns() {
                let x = (i64::from(entry.key.tx) - left) * TILE_PIXELS + i64::from(px);
                let y = TILE_PIXELS - 1 - i64::from(py);
                let spans = spans
                    .iter()
                    .map(|span| (base + i64::from(span.bottom()), base + i64::from(span.top()), span.is_obstacle()));
                row.add((y * width + x) as usize, spans, highest);
            }
        }
        Ok(row)
    };
    let (mut north, mut south): (Option<Row>, Option<Row>) = (None, None);
    for ty in (low..=high).rev() {
        let row = match south.take() {
            Some(row) => row,
            None => read(ty)?,
        };
        if has_neighbours && ty > low {
            south = Some(read(ty - 1)?);
        }
        let floor_at = |x: i64, y: i64| match y {
            -1 => north.as_ref().and_then(|row| row.get(x, STRIP - 1)),
            STRIP => south.as_ref().and_then(|row| row.get(x, 0)),
            _ => row.get(x, y),
        };
        let mut strip = ZlibEncoder::new(Vec::new(), Compression::default());
        for (y, x) in (0..STRIP).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let floor = row.get(x, y);
            let around = match floor {
                Some(_) if has_neighbours => [-1, 0, 1].map(|dy| [-1, 0, 1].map(|dx| floor_at(x + dx, y + dy))),
                _ => [[None; 3]; 3],
            };
            let middle = [left * TILE_PIXELS + x, (ty + 1) * TILE_PIXELS - 1 - y]
                .map(|pixel| (pixel as f64 + 0.5) * frame.pixel_m());
            for layer in *layers {
                let value = match floor {
                    Some(floor) => figures.of(*layer, floor, &around, middle)?,
                    None => f64::NAN,
                };
                match is_fine {
                    true => strip.write_all(&(value as f32).to_ne_bytes())?,
                    false => strip.write_all(&value.to_ne_bytes())?,
                }
            }
        }
        north = Some(row);
        let strip = strip.finish()?;
        offsets.push(u32::try_from(directory.write_data(&strip[..])?)?);
        lengths.push(u32::try_from(strip.len())?);
    }
    directory.write_tag(Tag::ImageWidth, size[0])?;
    directory.write_tag(Tag::ImageLength, size[1])?;
    directory.write_tag(Tag::BitsPerSample, &vec![if is_fine { 32u16 } else { 64 }; layers.len()][..])?;
    directory.write_tag(Tag::Compression, CompressionMethod::Deflate.to_u16())?;
    directory.write_tag(Tag::PhotometricInterpretation, PhotometricInterpretation::BlackIsZero.to_u16())?;
    directory.write_tag(Tag::StripOffsets, &offsets[..])?;
    directory.write_tag(Tag::SamplesPerPixel, u16::try_from(layers.len())?)?;
    if layers.len() > 1 {
        directory.write_tag(Tag::ExtraSamples, &vec![0u16; layers.len() - 1][..])?;
    }
    directory.write_tag(Tag::RowsPerStrip, STRIP as u32)?;
    directory.write_tag(Tag::StripByteCounts, &lengths[..])?;
    directory.write_tag(Tag::SampleFormat, &vec![SampleFormat::IEEEFP.to_u16(); layers.len()][..])?;
    let corner = [frame.edge_of_pixel(left * TILE_PIXELS), frame.edge_of_pixel((high + 1) * TILE_PIXELS)];
    directory.write_tag(Tag::ModelPixelScaleTag, &[frame.pixel_m(), frame.pixel_m(), 0.0][..])?;
    directory.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, corner[0], corner[1], 0.0][..])?;
    let named = |(band, layer): (usize, &Layer)| {
        format!("<Item name=\"DESCRIPTION\" sample=\"{band}\" role=\"description\">{}</Item>", layer.name())
    };
    let names: String = layers.iter().enumerate().map(named).collect();
    directory.write_tag(Tag::Unknown(GDAL_METADATA), &format!("<GDALMetadata>{names}</GDALMetadata>")[..])?;
    directory.write_tag(Tag::GdalNodata, "nan")?;
    if let Some(keys) = crs.map(Crs::geo_keys) {
        directory.write_tag(Tag::GeoKeyDirectoryTag, &keys.directory[..])?;
        directory.write_tag(Tag::GeoAsciiParamsTag, keys.text.as_str())?;
    }
    directory.finish()?;
    file.into_inner().map_err(std::io::IntoInnerError::into_error)?.publish()?;
    Ok(size)
}
