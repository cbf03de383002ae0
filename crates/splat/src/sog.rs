//! SOG: parameters as pixels of lossless WebP images, one splat a pixel, with `meta.json` for their scales; in a folder or
//! a zip. A set of levels (`lod-meta.json`) names many of these; its finest level is read.
//!
//! Version 2 looks sizes and colours up in tables, version 1 (which states none) interpolates them linearly.

use super::columns::{Column, beside, json, read_error};
use super::gate::{Gate, Raw, colour_of, sigmoid, smallest_three};
use super::store::Store;
use super::zip::Zip;
use super::{Body, Work, refuse, too_large};
use image_webp::{DecodingError, WebPDecoder};
use serde::Deserialize;
use slicewalk_base::bytes::{ByteSource, open_named};
use slicewalk_base::text::{file_size, grouped, one_line};
use slicewalk_base::{Error, Result};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes of a pixel: red, green, blue, alpha.
const PIXEL: usize = 4;
/// Images that are read: centres (low and high bytes), quaternions, sizes, colours.
const IMAGES: usize = 5;
/// Place of the quaternions among them.
const QUATERNIONS: usize = 2;
/// Least alpha of a quaternion: the place of its largest component.
const TAG: u8 = 252;
/// Most bytes of a `meta.json` in a zip; real ones have some ten thousand.
const MOST_META: u64 = 4 << 20;
/// Pixels read at once.
const ROWS: u64 = 1 << 13;

#[derive(Debug, Deserialize)]
struct Meta {
    version: Option<u64>,
    count: Option<u64>,
    means: Image,
    scales: Image,
    quats: Image,
    sh0: Image,
}

#[derive(Debug, Default, Deserialize)]
struct Image {
    #[serde(default)]
    shape: Vec<u64>,
    #[serde(default)]
    mins: Vec<f64>,
    #[serde(default)]
    maxs: Vec<f64>,
    #[serde(default)]
    codebook: Vec<f64>,
    #[serde(default)]
    files: Vec<String>,
}

/// How the bytes of an image become values.
#[derive(Debug)]
enum Scale {
    Table(Vec<f64>),
    /// Least value and span of each channel.
    Linear(Vec<[f64; 2]>),
}

impl Scale {
    fn get(&self, channel: usize, byte: u8) -> f64 {
        match self {
            Self::Table(table) => table.get(usize::from(byte)).copied().unwrap_or(f64::NAN),
            Self::Linear(spans) => spans[channel][0] + spans[channel][1] * (f64::from(byte) / 255.0),
        }
    }
}

/// Where the images are.
enum Files {
    /// Beside `meta.json`.
    Folder,
    /// In a zip, under names that begin with this.
    Zip(Zip, String),
}

pub struct Sog {
    /// Name for messages, and place of the images of a folder.
    path: PathBuf,
    files: Files,
    count: u64,
    means: Vec<[f64; 2]>,
    scales: Scale,
    colours: Scale,
    /// Opacities as logarithms of odds, and their range; else they are opacities.
    opacity: Option<[f64; 2]>,
    names: [String; IMAGES],
}

impl Sog {
    pub fn open_folder(source: Arc<dyn ByteSource>, path: &Path, memory: u64) -> Result<Self> {
        Self::of_meta(json(&source, path, memory)?, path, Files::Folder)
    }

    pub fn open_zip(source: Arc<dyn ByteSource>, path: &Path) -> Result<Self> {
        let zip = Zip::open(source, path)?;
        let is_meta = |name: &str| name == "meta.json" || name.ends_with("/meta.json");
        let mut metas = zip.entries.iter().filter(|entry| is_meta(&entry.name));
        let Some(entry) = metas.next().cloned() else {
            return Err(refuse(path, "zip", "expected meta.json, found none: this is no SOG; fetch or write it again"));
        };
        if metas.next().is_some() {
            let found = 2 + metas.count();
            let reason =
                format!("expected one meta.json, found {found}; unpack it, and convert its folders or lod-meta.json");
            return Err(refuse(path, "zip", reason));
        }
        if entry.size > MOST_META {
            let found = file_size(entry.size);
            let reason = format!("expected at most 4 MiB, found {found}; fetch or write it again");
            return Err(refuse(path, "meta.json", reason));
        }
        let options = super::SplatOptions::default();
        let monitor = &slicewalk_base::NoMonitor;
        let work = Work { path, options: &options, memory: 0, monitor };
        // All of it in memory, of which a store uses a third: there is no folder for temporary data here. Parsing it
        // takes no more than its length allows.
        let meta = json(&zip.read(&entry, path, &work, 3 * MOST_META)?, path, 8 * MOST_META)?;
        let folder = entry.name.strip_suffix("meta.json").unwrap_or_default().to_owned();
        Self::of_meta(meta, path, Files::Zip(zip, folder))
    }

    fn of_meta(meta: Meta, path: &Path, files: Files) -> Result<Self> {
        let wrong = |reason: String| refuse(path, "meta.json", format!("{reason}; fetch or write it again"));
        let spans = |image: &Image, name: &str, channels: usize| {
            if image.mins.len() < channels || image.maxs.len() < channels {
                return Err(wrong(format!("expected {channels} mins and maxs of {name}, found fewer")));
            }
            Ok(image.mins.iter().zip(&image.maxs).map(|(least, most)| [*least, most - least]).collect::<Vec<_>>())
        };
        let table = |image: &mut Image, name: &str| match image.codebook.is_empty() {
            true => Err(wrong(format!("expected a codebook of {name}, found none"))),
            false => Ok(Scale::Table(std::mem::take(&mut image.codebook))),
        };
        let Meta { version, count, means, mut scales, quats, mut sh0 } = meta;
        let count =
            count.or(means.shape.first().copied()).ok_or_else(|| wrong("expected a count, found none".into()))?;
        let (sizes, colours, opacity) = match version.unwrap_or(1) {
            1 => {
                let colours = spans(&sh0, "sh0", 4)?;
                let opacity = colours[3];
                (Scale::Linear(spans(&scales, "scales", 3)?), Scale::Linear(colours), Some(opacity))
            }
            2 => (table(&mut scales, "scales")?, table(&mut sh0, "sh0")?, None),
            other => return Err(wrong(format!("expected version 1 or 2, found {other}"))),
        };
        let name = |image: &Image, place: usize| {
            image.files.get(place).cloned().ok_or_else(|| wrong("expected the names of all images, found fewer".into()))
        };
        let names = [name(&means, 0)?, name(&means, 1)?, name(&quats, 0)?, name(&scales, 0)?, name(&sh0, 0)?];
        let means = spans(&means, "means", 3)?;
        if !means.iter().take(3).flatten().all(|v| v.abs() < 100.0) {
            return Err(wrong("expected the logarithms of the bounds of centres, found numbers beyond 100".into()));
        }
        Ok(Self { path: path.to_path_buf(), files, count, means, scales: sizes, colours, opacity, names })
    }

    /// Decodes an image; returns its first pixels, one for each splat, and whether those behind them are splats, too.
    fn image(&self, name: &str, work: &Work<'_>) -> Result<(Arc<dyn ByteSource>, bool)> {
        let (source, path): (Arc<dyn ByteSource>, _) = match &self.files {
            Files::Folder => {
                let path = beside(&self.path, name)?;
                (open_named(&path)?.into(), path)
            }
            Files::Zip(zip, folder) => {
                let whole = format!("{folder}{name}");
                let Some(entry) = zip.find(&whole, &self.path)? else {
                    let name = one_line(&whole);
                    return Err(refuse(
                        &self.path,
                        "zip",
                        format!("expected {name}, found no such entry; write it again"),
                    ));
                };
                (zip.read(entry, &self.path, work, work.memory / 8)?, self.path.clone())
            }
        };
        let at = one_line(name).into_owned();
        let wrong = |reason: String| refuse(&path, &at, format!("{reason}; fetch or write it again"));
        let failed = |error| match error {
            DecodingError::IoError(error) => read_error(&path, &at, error),
            error => wrong(format!("damaged WebP ({error})")),
        };
        let mut decoder = WebPDecoder::new(Column::rest(&source, 0)).map_err(failed)?;
        let (width, height) = decoder.dimensions();
        let pixels = u64::from(width) * u64::from(height);
        if decoder.is_animated() || decoder.is_lossy() {
            return Err(wrong("expected a lossless image, found a lossy or animated one".into()));
        }
        if pixels < self.count {
            let [expected, found] = [self.count, pixels].map(grouped);
            return Err(wrong(format!("expected {expected} pixels, one for each splat, found {found}")));
        }
        // Rows are padded, at most to powers of two.
        if pixels > self.count.saturating_mul(4).saturating_add(1 << 16) {
            let [expected, found] = [self.count, pixels].map(grouped);
            return Err(wrong(format!("expected about {expected} pixels, one for each splat, found {found}")));
        }
        // The decoder holds the pixels twice if the image has no alpha.
        let needed = pixels * 2 * PIXEL as u64;
        if needed > work.memory {
            return Err(too_large(&path, &format!("the image {at}"), needed, work.memory));
        }
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut bytes = vec![0; pixels as usize * channels];
        decoder.read_image(&mut bytes).map_err(failed)?;
        let mut store = Store::new(work, if needed * IMAGES as u64 > work.memory { 0 } else { work.memory / 2 });
        let mut block = Vec::with_capacity(ROWS as usize * PIXEL);
        let (own, rest) = bytes.split_at(self.count as usize * channels);
        let is_more = name == self.names[QUATERNIONS] && are_splats(rest, channels);
        for pixels in own.chunks(ROWS as usize * channels) {
            block.clear();
            pixels.chunks_exact(channels).for_each(|pixel| {
                block.extend_from_slice(&[pixel[0], pixel[1], pixel[2], pixel.get(3).copied().unwrap_or(255)]);
            });
            store.append(&block)?;
        }
        Ok((Arc::new(store), is_more))
    }

    /// Passes on the splats of these ranges, which are in order and do not overlap.
    fn read_ranges(&self, ranges: &[(u64, u64)], work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        let mut images = Vec::with_capacity(IMAGES);
        for name in &self.names {
            match self.image(name, work) {
                Ok((image, false)) => images.push(image),
                Ok((image, true)) => {
                    let reason =
                        format!("expected {} splats, found more; fetch or write it again", grouped(self.count));
                    gate.refuse(refuse(&self.path, one_line(name), reason))?;
                    images.push(image);
                }
                Err(error @ Error::Input { .. }) => {
                    gate.refuse(error)?;
                    return gate.miss(ranges.iter().map(|(start, end)| end - start).sum());
                }
                Err(error) => return Err(error),
            }
        }
        let mut blocks: [Vec<u8>; IMAGES] = Default::default();
        for &(start, end) in ranges {
            let mut columns: Vec<Column> =
                images.iter().map(|i| Column::new(i, start * PIXEL as u64, (end - start) * PIXEL as u64)).collect();
            let mut at = start;
            while at < end {
                let count = (end - at).min(ROWS);
                for (column, block) in columns.iter_mut().zip(&mut blocks) {
                    block.resize(count as usize * PIXEL, 0);
                    column.read_exact(block).map_err(|e| read_error(&self.path, "images", e))?;
                }
                for pixel in 0..count as usize {
                    let pixel = |image: usize| &blocks[image][pixel * PIXEL..][..PIXEL];
                    gate.push(self.splat([0, 1, 2, 3, 4].map(pixel)))?;
                }
                at += count;
            }
        }
        Ok(())
    }

    fn splat(&self, [low, high, quaternion, size, colour]: [&[u8]; IMAGES]) -> Raw {
        let mean = [0, 1, 2].map(|axis| {
            let share = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / 65_535.0;
            let value = self.means[axis][0] + self.means[axis][1] * share;
            libm::copysign(libm::expm1(libm::fabs(value)), value)
        });
        let small = [0, 1, 2].map(|at| (f64::from(quaternion[at]) / 127.5 - 1.0) * std::f64::consts::FRAC_1_SQRT_2);
        // Another tag than that of w, x, y or z marks a splat without a rotation.
        let rotation = match quaternion[3].checked_sub(TAG) {
            Some(largest) => smallest_three(small, usize::from(largest)),
            None => [1.0, 0.0, 0.0, 0.0],
        };
        let opacity = match self.opacity {
            Some([least, span]) => sigmoid(least + span * (f64::from(colour[3]) / 255.0)),
            None => f64::from(colour[3]) / 255.0,
        };
        Raw {
            mean,
            scale: [0, 1, 2].map(|axis| libm::exp(self.scales.get(axis, size[axis]))),
            rotation,
            opacity,
            colour: [0, 1, 2].map(|at| colour_of(self.colours.get(at, colour[at]))),
        }
    }
}

/// Returns whether pixels of quaternions are splats; equal ones are padding, whatever their value.
fn are_splats(pixels: &[u8], channels: usize) -> bool {
    let mut pixels = pixels.chunks_exact(channels);
    let is_tagged = |pixel: &[u8]| pixel.get(3).is_some_and(|tag| *tag >= TAG);
    pixels.clone().any(is_tagged) && pixels.next().is_some_and(|first| pixels.any(|pixel| pixel != first))
}

impl Body for Sog {
    fn count(&self) -> u64 {
        self.count
    }

    fn read(&mut self, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        self.read_ranges(&[(0, self.count)], work, gate)
    }
}

#[derive(Debug, Deserialize)]
struct Set {
    version: Option<u64>,
    #[serde(default)]
    counts: Vec<u64>,
    environment: Option<String>,
    filenames: Vec<String>,
    tree: Node,
}

#[derive(Debug, Deserialize)]
struct Node {
    #[serde(default)]
    children: Vec<Node>,
    #[serde(default)]
    lods: BTreeMap<u32, Range>,
}

#[derive(Debug, Deserialize)]
struct Range {
    file: usize,
    offset: u64,
    count: u64,
}

/// A set of levels.
pub struct Levels {
    path: PathBuf,
    names: Vec<String>,
    /// Ranges of splats of each file, in order.
    ranges: BTreeMap<usize, Vec<(u64, u64)>>,
    count: u64,
    has_environment: bool,
}

impl Levels {
    pub fn open(source: Arc<dyn ByteSource>, path: &Path, memory: u64) -> Result<Self> {
        let wrong = |reason: String| refuse(path, "levels", format!("{reason}; fetch or write it again"));
        let Set { version, counts, environment, filenames: names, tree }: Set = json(&source, path, memory)?;
        if version.is_some_and(|version| version != 1) {
            return Err(wrong(format!("expected version 1, found {}", version.unwrap_or(0))));
        }
        let (mut ranges, mut count) = (BTreeMap::<usize, Vec<(u64, u64)>>::new(), 0u64);
        let (mut nodes, mut finest) = (vec![&tree], 0u64);
        while let Some(node) = nodes.pop() {
            nodes.extend(&node.children);
            // A place may have no more than a coarse level.
            let Some((level, range)) = node.lods.iter().find(|(_, range)| range.count > 0) else {
                continue;
            };
            let end = range.offset.checked_add(range.count).filter(|_| range.file < names.len());
            let end = end.ok_or_else(|| wrong("a node names splats that no file holds".into()))?;
            ranges.entry(range.file).or_default().push((range.offset, end));
            count = count.saturating_add(range.count);
            finest = finest.saturating_add(if *level == 0 { range.count } else { 0 });
        }
        for ranges in ranges.values_mut() {
            ranges.sort_unstable();
            if ranges.windows(2).any(|pair| pair[1].0 < pair[0].1) {
                return Err(wrong("two nodes name the same splats".into()));
            }
        }
        if let Some(&stated) = counts.first().filter(|stated| **stated != finest) {
            let [stated, finest] = [stated, finest].map(grouped);
            return Err(wrong(format!("expected {stated} splats in the finest level, found {finest}")));
        }
        Ok(Self { path: path.to_path_buf(), names, ranges, count, has_environment: environment.is_some() })
    }

    fn open_file(&self, file: usize, memory: u64) -> Result<Sog> {
        let path = beside(&self.path, &self.names[file])?;
        let source: Arc<dyn ByteSource> = open_named(&path)?.into();
        match path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
            true => Sog::open_folder(source, &path, memory),
            false => Sog::open_zip(source, &path),
        }
    }
}

impl Body for Levels {
    fn count(&self) -> u64 {
        self.count
    }

    fn read(&mut self, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        if self.has_environment {
            let name = self.path.display();
            work.monitor.warn(&format!("{name}: the environment, which surrounds the scene, was left out").into());
        }
        for (&file, ranges) in &self.ranges {
            let wanted: u64 = ranges.iter().map(|(start, end)| end - start).sum();
            let sog = self.open_file(file, work.memory).and_then(|sog| match ranges.last() {
                Some(&(_, end)) if end > sog.count => {
                    let [expected, found] = [end, sog.count].map(grouped);
                    let reason = format!("expected at least {expected} splats, found {found}; fetch or write it again");
                    Err(refuse(&sog.path, "meta.json", reason))
                }
                _ => Ok(sog),
            });
            match sog {
                Ok(sog) => sog.read_ranges(ranges, work, gate)?,
                Err(error @ (Error::Input { .. } | Error::Io { .. })) => {
                    gate.refuse(error)?;
                    gate.miss(wanted)?;
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}
