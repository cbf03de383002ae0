//! E57, PTX, PTS and XYZ of any size in bounded memory.

use super::las::{WriteSpec, Written};
use crate::geometry::{Aabb, Vec3};
use crate::sample::Sample;
use crate::{Error, Result};
use e57::{E57Writer, Record, RecordDataType, RecordName, RecordValue};
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::iter::Peekable;
use std::path::Path;

/// A point cloud format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CloudFormat {
    /// Scaled integers of 32 bits, intensity and colours; no poses.
    E57,
    /// Columns of a cloud of one row; x, y, z, intensity; the identity as matrix.
    Ptx,
    /// x, y, z, intensity, red, green, blue.
    Pts,
    /// x, y, z.
    Xyz,
}

impl CloudFormat {
    /// The format named by the extension.
    pub fn of(path: &Path) -> Option<Self> {
        Some(match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "e57" => Self::E57,
            "ptx" => Self::Ptx,
            "pts" => Self::Pts,
            "xyz" => Self::Xyz,
            _ => return None,
        })
    }
}

/// Writes samples to `path`, replacing an existing file, with the scale and offset of `spec`. A new cloud begins after
/// every `cloud_points` (> 0) points, except in XYZ. The same samples give the same bytes. Memory: 1 MiB, and an E57
/// packet.
///
/// Fails if a point does not fit into 32-bit coordinates at the spec's scale and offset; the file is then incomplete.
pub fn write_clouds(
    path: &Path,
    format: CloudFormat,
    samples: impl IntoIterator<Item = Sample>,
    spec: &WriteSpec,
    cloud_points: u64,
) -> Result<Written> {
    let mut stock = Stock { path, spec, count: 0, bounds: Aabb::EMPTY };
    let mut samples = samples.into_iter().peekable();
    match format {
        CloudFormat::E57 => write_e57(&mut samples, &mut stock, cloud_points)?,
        _ => {
            let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
            let mut out = BufWriter::with_capacity(1 << 20, file);
            while samples.peek().is_some() {
                write_text(&mut out, format, &mut samples, &mut stock, cloud_points)?;
                if format == CloudFormat::Xyz {
                    break;
                }
            }
            out.flush().map_err(|e| Error::io(path, "write points", e))?;
        }
    }
    let len_bytes = path.metadata().map_err(|e| Error::io(path, "read the length", e))?.len();
    Ok(Written { points: stock.count, bounds: stock.bounds, len_bytes })
}

/// Rounds points and counts them.
struct Stock<'a> {
    path: &'a Path,
    spec: &'a WriteSpec,
    count: u64,
    bounds: Aabb,
}

impl Stock<'_> {
    fn take(&mut self, sample: &Sample) -> Result<[i32; 3]> {
        let grid = self.spec.grid(sample.position).ok_or_else(|| {
            let reason = format!("point {} at {:?} does not fit 32-bit coordinates", self.count, sample.position);
            Error::output(self.path, reason)
        })?;
        let place = self.spec.place(grid);
        for (axis, value) in place.into_iter().enumerate() {
            self.bounds.min[axis] = self.bounds.min[axis].min(value);
            self.bounds.max[axis] = self.bounds.max[axis].max(value);
        }
        self.count += 1;
        Ok(grid)
    }

    /// A number from 0 to 255 that differs from point to point.
    fn varied(&self) -> u8 {
        (self.count.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8
    }
}

fn write_e57(
    samples: &mut Peekable<impl Iterator<Item = Sample>>,
    stock: &mut Stock<'_>,
    cloud_points: u64,
) -> Result<()> {
    let path = stock.path;
    let fault = |e: e57::Error| Error::output(path, e.to_string());
    let mut writer = E57Writer::from_file(path, "{00000000-0000-0000-0000-000000000000}").map_err(fault)?;
    let (min, max) = (i64::from(i32::MIN), i64::from(i32::MAX));
    let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ].into_iter().zip(0..3);
    let mut columns: Vec<Record> = axes
        .map(|(name, axis)| {
            let (scale, offset) = (stock.spec.scale[axis], stock.spec.offset[axis]);
            Record { name, data_type: RecordDataType::ScaledInteger { min, max, scale, offset } }
        })
        .collect();
    columns.extend([Record::INTENSITY_U16, Record::COLOR_RED_U8, Record::COLOR_GREEN_U8, Record::COLOR_BLUE_U8]);
    let mut number = 0;
    while samples.peek().is_some() {
        number += 1;
        let guid = format!("{{00000000-0000-0000-0000-{number:012}}}");
        let mut cloud = writer.add_pointcloud(&guid, columns.clone()).map_err(fault)?;
        for sample in samples.by_ref().take(cloud_points as usize) {
            let varied = i64::from(stock.varied());
            let place = stock.take(&sample)?.map(|v| RecordValue::ScaledInteger(v.into()));
            let others = [256 * varied, varied, varied, 255 - varied].map(RecordValue::Integer);
            cloud.add_point(place.into_iter().chain(others).collect()).map_err(fault)?;
        }
        cloud.finalize().map_err(fault)?;
    }
    writer.finalize().map_err(fault)
}

/// Writes one cloud as text.
fn write_text(
    out: &mut BufWriter<File>,
    format: CloudFormat,
    samples: &mut Peekable<impl Iterator<Item = Sample>>,
    stock: &mut Stock<'_>,
    cloud_points: u64,
) -> Result<()> {
    let path = stock.path;
    let written = |e: io::Error| Error::io(path, "write points", e);
    let start = out.stream_position().map_err(written)?;
    match format {
        CloudFormat::Ptx => {
            write!(out, "{:<20}\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "")
        }
        CloudFormat::Pts => writeln!(out, "{:<20}", ""),
        _ => Ok(()),
    }
    .map_err(written)?;
    let places: [usize; 3] = std::array::from_fn(|axis| decimals(stock.spec.scale[axis]));
    let most = if format == CloudFormat::Xyz { u64::MAX } else { cloud_points };
    let mut count = 0u64;
    while count < most {
        let Some(sample) = samples.next() else { break };
        let varied = stock.varied();
        let grid = stock.take(&sample)?;
        let [x, y, z]: Vec3 = stock.spec.place(grid);
        let [a, b, c] = places;
        match format {
            CloudFormat::Ptx => writeln!(out, "{x:.a$} {y:.b$} {z:.c$} {:.6}", f64::from(varied) / 256.0),
            CloudFormat::Pts => {
                writeln!(out, "{x:.a$} {y:.b$} {z:.c$} {} {varied} {varied} {}", i32::from(varied) - 128, 255 - varied)
            }
            _ => writeln!(out, "{x:.a$} {y:.b$} {z:.c$}"),
        }
        .map_err(written)?;
        count += 1;
    }
    if format != CloudFormat::Xyz {
        let end = out.stream_position().map_err(written)?;
        out.seek(SeekFrom::Start(start)).map_err(written)?;
        write!(out, "{count:<20}").map_err(written)?;
        out.seek(SeekFrom::Start(end)).map_err(written)?;
    }
    Ok(())
}

/// Decimal places that represent a step of `scale` exactly.
fn decimals(scale: f64) -> usize {
    (0..12).find(|&places| (scale * 10f64.powi(places)).fract() < 1e-9).map_or(12, |places| places as usize)
}
