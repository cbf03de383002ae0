//! One point per occupied voxel: PLY, LAS, LAZ and E57.

use super::Crs;
use crate::Failure;
use crate::show::{BLUES, COLOURLESS, INFERRED};
use e57::{E57Writer, Record, RecordDataType, RecordName, RecordValue};
use slicewalk::archive::{Archive, ColourReader, PageReader};
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use slicewalk_base::output::Output;
use std::io::{self, BufWriter, IntoInnerError, Read, Seek, SeekFrom, Write};
use std::mem::ManuallyDrop;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// LAS classes of floors (the standard's "ground") and obstacles (its "unclassified").
const CLASSES: [u8; 2] = [2, 1];
/// LAS records with GeoTIFF keys and their texts.
const GEO_KEYS: u16 = 34735;
const GEO_TEXT: u16 = 34737;
/// Width of the point count in a PLY header, which is filled in at the end.
const COUNT_DIGITS: usize = 20;
/// LAS 1.2 counts points with 32 bits.
const MOST_LAS_POINTS: u64 = u32::MAX as u64;
/// Where a LAS header states the bounds: greatest and least x, then y, then z.
const LAS_BOUNDS_AT: u64 = 179;
/// Most voxels exported: this many for any archive, or this many per byte if more; archives of scans and meshes have up
/// to 4 per byte.
const MOST_VOXELS: u64 = 1 << 26;
const MOST_VOXELS_A_BYTE: u64 = 1 << 10;
/// Largest step of LAS coordinates that the extent allows (m).
const COARSEST_STEP_M: f64 = 1e-4;
/// Most steps of LAS coordinates in an extent: 32 bits, less the rounding of the offset.
const MOST_STEPS: f64 = 4e9;
/// Offsets are rounded to this many steps, which makes whole metres at the usual step.
const ROUND_STEPS: f64 = 1e4;

/// Slice in its page, top of the solid (quanta), and kind, as index into [`BLUES`].
type Voxel = (u32, u8, usize);

/// A voxel as a point at the pixel's centre, with the voxel's colour, or that of `show` if the archive has no colours.
/// The point lies half a quantum below the top of the solid: on the face between two voxels it would belong to the
/// upper one.
struct VoxelPoint {
    position: [f64; 3],
    colour: [u8; 3],
    obstacle: bool,
    inferred: bool,
}

/// Fails if an archive is far too small to hold as many voxels as its head claims.
pub fn check_count(archive: &Archive, path: &Path) -> Result<(), Failure> {
    let header = archive.header();
    let (voxels, most) = (header.voxels.occupied, MOST_VOXELS.max(header.file_len.saturating_mul(MOST_VOXELS_A_BYTE)));
    if voxels > most {
        let reason = format!("{voxels} voxels in {} bytes; at most {most} are exported", header.file_len);
        return Err(Failure::Text(format!("{}: {reason}; extract a region first", path.display())));
    }
    Ok(())
}

fn each_voxel(
    archive: &Archive,
    path: &Path,
    mut give: impl FnMut(&VoxelPoint) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let frame = archive.frame();
    let broken = |error| crate::broken(path, &error);
    let mut pages = PageReader::new(archive);
    let mut colours = ColourReader::new(archive).map_err(broken)?;
    for entry in crate::entries(archive, path) {
        let entry = entry?;
        let (page, inferred) = pages.page_and_inferred(&entry).map_err(broken)?;
        let colours = colours.as_mut().map(|colours| colours.colours(&entry)).transpose().map_err(broken)?;
        for (px, py, spans) in page.columns() {
            let mask = inferred.of(px, py);
            let centre = |tile: i32, pixel: u32| {
                (f64::from(tile) * TILE_PIXELS as f64 + f64::from(pixel) + 0.5) * frame.pixel_m()
            };
            let (x, y) = (centre(entry.key.tx, px), centre(entry.key.ty, py));
            let mut give_voxel = |(slice, top, kind): Voxel| {
                let floor = frame.bottom_of_slice(i64::from(entry.key.layer) * PAGE_SLICES + i64::from(slice));
                let colour = match &colours {
                    Some(colours) => colours.of(px, py, slice).unwrap_or(COLOURLESS),
                    None => [top, 255, BLUES[kind]],
                };
                give(&VoxelPoint {
                    position: [x, y, floor + (f64::from(top.max(1)) - 0.5) * frame.quantum_m()],
                    colour,
                    obstacle: kind == 1,
                    inferred: kind == INFERRED,
                })
            };
            // Spans ascend. Two that share a voxel still make one point.
            let mut voxel: Option<Voxel> = None;
            for (at, span) in spans.iter().enumerate() {
                let kind = if mask >> (at & 63) & 1 == 1 { INFERRED } else { usize::from(span.is_obstacle()) };
                let (first, last) = span.slices();
                for slice in first..=last {
                    let Some((_, top)) = span.within_slice(slice) else { continue };
                    let below = voxel.take();
                    let same = below.filter(|below| below.0 == slice);
                    if same.is_none() {
                        below.map_or(Ok(()), &mut give_voxel)?;
                    }
                    let kind = match same.map_or(kind, |same| same.2) {
                        // Scanned spans decide the kind, and among them obstacles.
                        INFERRED => kind,
                        below if kind == INFERRED => below,
                        below => below.max(kind),
                    };
                    voxel = Some((slice, top, kind));
                }
            }
            voxel.map_or(Ok(()), give_voxel)?;
        }
    }
    Ok(())
}

/// Coloured points as binary PLY; their number may become known at the end.
pub struct Ply {
    file: BufWriter<Output>,
    /// Where the count is written.
    count_at: u64,
    count: u64,
}

impl Ply {
    /// Begins the file. `comment` is a line of the header, or empty; `more` names properties of one byte.
    pub fn begin(output: Output, comment: &str, more: &[&str]) -> Result<Self, Failure> {
        let mut file = BufWriter::new(output);
        let comment = if comment.is_empty() { String::new() } else { format!("{comment}\n") };
        let head = format!("ply\nformat binary_little_endian 1.0\n{comment}element vertex ");
        let bytes = ["red", "green", "blue"].iter().chain(more);
        let bytes: String = bytes.map(|name| format!("property uchar {name}\n")).collect();
        write!(
            file,
            "{head}{:COUNT_DIGITS$}\nproperty double x\nproperty double y\nproperty double z\n{bytes}end_header\n",
            ""
        )?;
        Ok(Self { file, count_at: head.len() as u64, count: 0 })
    }

    /// Adds a point with the values of its further properties.
    pub fn put(&mut self, position: [f64; 3], colour: [u8; 3], more: &[u8]) -> Result<(), Failure> {
        self.count += 1;
        for value in position {
            self.file.write_all(&value.to_le_bytes())?;
        }
        self.file.write_all(&colour)?;
        Ok(self.file.write_all(more)?)
    }

    /// Publishes the file and returns the number of points.
    pub fn finish(mut self) -> Result<u64, Failure> {
        self.file.seek(SeekFrom::Start(self.count_at))?;
        write!(self.file, "{:<COUNT_DIGITS$}", self.count)?;
        self.file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
        Ok(self.count)
    }
}

pub fn ply(archive: &Archive, path: &Path, output: Output) -> Result<u64, Failure> {
    let mut ply = Ply::begin(output, "", &[])?;
    each_voxel(archive, path, |point| ply.put(point.position, point.colour, &[]))?;
    ply.finish()
}

/// Writes LAS 1.2 with a reference system's code as GeoTIFF keys, or 1.4 for a system known by its text.
pub fn las(
    archive: &Archive,
    path: &Path,
    output: Output,
    crs: Option<&Crs>,
    compressed: bool,
) -> Result<u64, Failure> {
    let wkt = crs.and_then(|crs| crs.wkt());
    let mut builder = las::Builder::from(if wkt.is_some() { (1, 4) } else { (1, 2) });
    builder.point_format = las::point::Format::new(2)?;
    if let (None, Some(keys)) = (wkt, crs.map(Crs::geo_keys)) {
        builder.vlrs.push(projection(GEO_KEYS, keys.directory.iter().flat_map(|key| key.to_le_bytes()).collect()));
        builder.vlrs.push(projection(GEO_TEXT, keys.text.into_bytes()));
    }
    builder.point_format.is_compressed = compressed;
    let steps = transforms(archive, path)?;
    let [x, y, z] = steps;
    builder.transforms = las::Vector { x, y, z };
    let output = Arc::new(Mutex::new(output));
    let file = BufWriter::new(Lent(Arc::downgrade(&output)));
    // A writer that failed panics when dropped, so it is not dropped; it owns no file.
    let mut head = builder.into_header()?;
    if let Some(wkt) = wkt {
        head.set_wkt_crs(wkt.as_bytes().iter().copied().chain([0]).collect())?;
    }
    let mut writer = ManuallyDrop::new(las::Writer::new(file, head)?);
    let mut count = 0u64;
    let mut range = [(i32::MAX, i32::MIN); 3];
    each_voxel(archive, path, |point| {
        count += 1;
        if count > MOST_LAS_POINTS {
            let reason = format!("more than {MOST_LAS_POINTS} voxels, the most points of LAS 1.2");
            return Err(Failure::Text(format!("{}: {reason}; export .ply, or extract a region first", path.display())));
        }
        for ((value, step), (low, high)) in point.position.iter().zip(&steps).zip(&mut range) {
            let stored = step.inverse(*value)?;
            (*low, *high) = ((*low).min(stored), (*high).max(stored));
        }
        let [x, y, z] = point.position;
        let [red, green, blue] = point.colour.map(|value| u16::from(value) * 257);
        Ok(writer.write_point(las::Point {
            x,
            y,
            z,
            color: Some(las::Color { red, green, blue }),
            classification: las::point::Classification::new(CLASSES[usize::from(point.obstacle)])?,
            return_number: 1,
            is_synthetic: point.inferred,
            number_of_returns: 1,
            ..Default::default()
        })?)
    })?;
    writer.close()?;
    // The writer is closed; only the file's buffer remains to be written.
    let file = ManuallyDrop::into_inner(writer).into_inner()?;
    file.into_inner().map_err(IntoInnerError::into_error)?;
    let mut output = returned(output);
    if count > 0 {
        // The writer's own bounds are those of the points before they are rounded to steps.
        let bounds = steps.iter().zip(range).flat_map(|(step, (low, high))| [step.direct(high), step.direct(low)]);
        output.write_at(LAS_BOUNDS_AT, &bounds.flat_map(f64::to_le_bytes).collect::<Vec<u8>>())?;
    }
    output.publish()?;
    Ok(count)
}

fn projection(record_id: u16, data: Vec<u8>) -> las::Vlr {
    las::Vlr { user_id: "LASF_Projection".into(), record_id, description: String::new(), data }
}

/// Writes E57 with scaled coordinates, colours, and the reference system as text.
pub fn e57(archive: &Archive, path: &Path, output: Output, crs: Option<&Crs>) -> Result<u64, Failure> {
    let output = Arc::new(Mutex::new(output));
    let hash = format!("{:032x}", archive.header().plan_hash);
    let guid = format!("{}-{}-{}-{}-{}", &hash[..8], &hash[8..12], &hash[12..16], &hash[16..20], &hash[20..]);
    let mut writer = E57Writer::new(Lent(Arc::downgrade(&output)), &guid)?;
    writer.set_coordinate_metadata(crs.map(|crs| crs.text().to_owned()));
    let steps = transforms(archive, path)?;
    let coordinate = |name, step: las::Transform| {
        let (scale, offset) = (step.scale, step.offset);
        let data_type = RecordDataType::ScaledInteger { min: i32::MIN.into(), max: i32::MAX.into(), scale, offset };
        Record { name, data_type }
    };
    let colour = |name| Record { name, data_type: RecordDataType::Integer { min: 0, max: 255 } };
    let prototype = vec![
        coordinate(RecordName::CartesianX, steps[0]),
        coordinate(RecordName::CartesianY, steps[1]),
        coordinate(RecordName::CartesianZ, steps[2]),
        colour(RecordName::ColorRed),
        colour(RecordName::ColorGreen),
        colour(RecordName::ColorBlue),
    ];
    let mut cloud = writer.add_pointcloud(&guid, prototype)?;
    cloud.set_name(Some("voxels".into()));
    let mut count = 0u64;
    each_voxel(archive, path, |point| {
        count += 1;
        let scaled = |axis: usize| {
            let step = steps[axis];
            RecordValue::ScaledInteger(((point.position[axis] - step.offset) / step.scale).round() as i64)
        };
        let [red, green, blue] = point.colour.map(|value| RecordValue::Integer(value.into()));
        Ok(cloud.add_point(vec![scaled(0), scaled(1), scaled(2), red, green, blue])?)
    })?;
    cloud.finalize()?;
    writer.finalize()?;
    drop(writer);
    returned(output).publish()?;
    Ok(count)
}

/// Returns an output that a writer borrowed.
fn returned(output: Arc<Mutex<Output>>) -> Output {
    let output = Arc::into_inner(output).expect("the output was only lent");
    output.into_inner().unwrap_or_else(PoisonError::into_inner)
}

/// An output lent to a writer that insists on owning what it writes to.
struct Lent(Weak<Mutex<Output>>);

impl Lent {
    fn with<T>(&self, act: impl FnOnce(&mut Output) -> io::Result<T>) -> io::Result<T> {
        let output = self.0.upgrade().ok_or(io::ErrorKind::NotConnected)?;
        act(&mut output.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Write for Lent {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.with(|output| output.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.with(Output::flush)
    }
}

impl Read for Lent {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.with(|output| output.read(bytes))
    }
}

impl Seek for Lent {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.with(|output| output.seek(to))
    }
}

/// Computes steps and offsets of LAS coordinates from all pages of the archive, regardless of the bounds in its head.
fn transforms(archive: &Archive, path: &Path) -> Result<[las::Transform; 3], Failure> {
    let frame = archive.frame();
    let mut range = [(i64::MAX, i64::MIN); 3];
    for entry in crate::entries(archive, path) {
        let entry = entry?;
        let tile = |at: i32| (i64::from(at) * TILE_PIXELS, (i64::from(at) + 1) * TILE_PIXELS);
        let (low, high) = entry.slice_range();
        for (range, (low, high)) in range.iter_mut().zip([tile(entry.key.tx), tile(entry.key.ty), (low, high + 1)]) {
            *range = (range.0.min(low), range.1.max(high));
        }
    }
    let mut transforms = [las::Transform { scale: COARSEST_STEP_M, offset: 0.0 }; 3];
    for (axis, transform) in transforms.iter_mut().enumerate() {
        if range[axis].0 > range[axis].1 {
            continue;
        }
        let (ends, finest): ([f64; 2], f64) = match axis {
            2 => ([range[2].0, range[2].1].map(|slice| frame.bottom_of_slice(slice)), frame.quantum_m()),
            _ => ([range[axis].0, range[axis].1].map(|pixel| frame.edge_of_pixel(pixel)), frame.pixel_m()),
        };
        *transform = transform_of(ends, finest).ok_or_else(|| {
            Failure::Text(format!(
                "{}: its pages reach over {:.0} m along {}, too far for the 32 bits of LAS coordinates in steps of {finest} \
                 m; export .ply, or extract a region first",
                path.display(),
                ends[1] - ends[0],
                ["x", "y", "z"][axis]
            ))
        })?;
    }
    Ok(transforms)
}

/// Computes step and offset for coordinates between two ends (m); the step is at most half of `finest`, so that the
/// middle of an interval of that length stays inside. `None` if 32 bits do not suffice. The step is a power of ten, as
/// fine as the ends allow but no finer than needed.
fn transform_of([least, greatest]: [f64; 2], finest: f64) -> Option<las::Transform> {
    let wanted = (finest / 2.0).min(COARSEST_STEP_M).log10().floor();
    let reached = ((greatest - least) / MOST_STEPS).log10().ceil();
    let scale: f64 = format!("1e{}", wanted.max(reached)).parse().ok()?;
    let round = ROUND_STEPS * scale;
    let offset = ((least + greatest) / 2.0 / round).round() * round;
    (scale <= finest / 2.0).then_some(las::Transform { scale, offset })
}
