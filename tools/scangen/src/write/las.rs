//! LAS and LAZ of any size in bounded memory: records are formed here and streamed out. The header, by `las`, is
//! written first with zeros and at the end with the true counts and bounds.

use super::record::{MAX_RECORD, Record, class_of, encode, has_colour, record_len};
use super::texture::Texture;
use crate::geometry::{Aabb, Vec3};
use crate::sample::{Kind, Sample, Stream};
use crate::{Error, Result};
use las::{Builder, Header, Transform, Vector, Vlr, point::Format, raw};
use laz::{LasZipCompressor, LazItemRecordBuilder, LazVlr, LazVlrBuilder};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

/// Sizes of LAZ chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chunks {
    /// Every chunk except the last has this many points `[> 0]`.
    Fixed(u32),
    /// Each chunk has a random number of points from 1 to this `[> 0]`; readers that seek often get these wrong.
    Variable(u32),
}

/// Format of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct WriteSpec {
    /// Point data record format `[0..=10]`.
    pub format: u8,
    /// LAS version; `None`: 1.2 for formats 0 to 3, 1.3 for 4 and 5, 1.4 for 6 to 10.
    pub version: Option<(u8, u8)>,
    /// Metres per coordinate step, by axis `[> 0]`.
    pub scale: Vec3,
    /// Added to scaled coordinates, by axis.
    pub offset: Vec3,
    /// Compression; `None` writes LAS.
    pub compression: Option<Chunks>,
    /// Coordinate system, as WKT.
    pub crs_wkt: Option<String>,
    /// Classes of points that are neither outliers nor mixed pixels, with their weights; if empty, all have class 1.
    pub classes: Vec<(u8, f64)>,
    /// Class of points on people who walked through, as truth for their removal (0..=31 in formats 0 to 5).
    pub moving_class: Option<u8>,
    /// Fraction of points flagged as withheld `[0..=1]`.
    pub withheld_share: f64,
    /// Colours of the points, computed from the positions that readers get; `None` writes meaningless values.
    pub texture: Option<Texture>,
    /// Seed of classes, flags and variable chunks.
    pub seed: u64,
}

impl Default for WriteSpec {
    fn default() -> Self {
        Self {
            format: 0,
            version: None,
            scale: [0.001; 3],
            offset: [0.0; 3],
            compression: None,
            crs_wkt: None,
            classes: Vec::new(),
            moving_class: None,
            withheld_share: 0.0,
            texture: None,
            seed: 0,
        }
    }
}

impl WriteSpec {
    /// The defaults with the compression that the extension selects: `.laz` in chunks of 50 000, anything else plain
    /// LAS.
    pub fn for_path(path: &Path) -> Self {
        let laz = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("laz"));
        Self { compression: laz.then_some(Chunks::Fixed(50_000)), ..Self::default() }
    }

    /// The position that a reader gets for `p`, rounded to the file's steps. `None` if it does not fit.
    pub fn rounded(&self, p: Vec3) -> Option<Vec3> {
        self.grid(p).map(|g| self.place(g))
    }

    #[inline]
    pub(super) fn grid(&self, p: Vec3) -> Option<[i32; 3]> {
        let mut grid = [0; 3];
        for axis in 0..3 {
            let steps = ((p[axis] - self.offset[axis]) / self.scale[axis]).round();
            // NaN fails as well.
            if !(steps >= f64::from(i32::MIN) && steps <= f64::from(i32::MAX)) {
                return None;
            }
            grid[axis] = steps as i32;
        }
        Some(grid)
    }

    pub(super) fn place(&self, grid: [i32; 3]) -> Vec3 {
        std::array::from_fn(|a| f64::from(grid[a]) * self.scale[a] + self.offset[a])
    }

    fn header(&self, path: &Path) -> Result<(Header, Option<LazVlr>)> {
        let fault = |reason: String| Error::output(path, reason);
        record_len(self.format).ok_or_else(|| fault(format!("point format {} is not one of 0 to 10", self.format)))?;
        if self.scale.iter().any(|s| !s.is_finite() || *s <= 0.0) || self.offset.iter().any(|o| !o.is_finite()) {
            return Err(fault(format!("scale {:?} or offset {:?} is not usable", self.scale, self.offset)));
        }
        if !(0.0..=1.0).contains(&self.withheld_share) || self.classes.iter().any(|c| !c.1.is_finite() || c.1 < 0.0) {
            return Err(fault(
                "shares of classes and withheld points must be 0 or more, withheld at most 1".to_owned(),
            ));
        }
        if let Some((class, _)) = self.classes.iter().find(|c| self.format < 6 && c.0 > 31) {
            return Err(fault(format!("class {class} does not fit format {}; use formats 6 to 10", self.format)));
        }
        if let Some(texture) = self.texture
            && !(has_colour(self.format) && texture.period_m > 0.0 && texture.period_m.is_finite())
        {
            return Err(fault("colours need a format with RGB (2, 3, 5, 7, 8 or 10) and a period above 0".to_owned()));
        }
        if self.texture.is_some_and(|texture| !(0.0..=1.0).contains(&texture.exposure)) {
            return Err(fault("exposures differ by a share of 0 to 1".to_owned()));
        }
        let version = self.version.unwrap_or(match self.format {
            0..=3 => (1, 2),
            4 | 5 => (1, 3),
            _ => (1, 4),
        });
        let mut builder = Builder::from(version);
        builder.point_format = Format::new(self.format).map_err(|e| fault(e.to_string()))?;
        let transform = |a: usize| Transform { scale: self.scale[a], offset: self.offset[a] };
        builder.transforms = Vector { x: transform(0), y: transform(1), z: transform(2) };
        builder.generating_software = concat!("scangen ", env!("CARGO_PKG_VERSION")).to_owned();
        builder.system_identifier = "synthetic".to_owned();
        // No creation date, so that the same seed gives the same bytes.
        builder.date = None;
        if let Some(wkt) = &self.crs_wkt {
            builder.has_wkt_crs = true;
            let data = wkt.bytes().chain([0]).collect();
            builder.vlrs.push(Vlr { user_id: "LASF_Projection".to_owned(), record_id: 2112, data, ..Vlr::default() });
        }
        let vlr = self.laz_vlr().map_err(|e| fault(format!("format {} as LAZ: {e}", self.format)))?;
        if let Some(vlr) = &vlr {
            let mut data = Vec::new();
            vlr.write_to(&mut data).map_err(|e| fault(e.to_string()))?;
            builder.vlrs.push(Vlr {
                user_id: LazVlr::USER_ID.to_owned(),
                record_id: LazVlr::RECORD_ID,
                description: LazVlr::DESCRIPTION.to_owned(),
                data,
            });
        }
        Ok((builder.into_header().map_err(|e| fault(e.to_string()))?, vlr))
    }

    fn laz_vlr(&self) -> std::result::Result<Option<LazVlr>, String> {
        let Some(chunks) = self.compression else { return Ok(None) };
        let items = LazItemRecordBuilder::default_for_point_format_id(self.format, 0).map_err(|e| e.to_string())?;
        let builder = LazVlrBuilder::new(items);
        match chunks {
            Chunks::Fixed(0) | Chunks::Variable(0) => Err("a chunk holds at least one point".to_owned()),
            Chunks::Fixed(n) if n == u32::MAX => Err("this chunk size means variable chunks".to_owned()),
            Chunks::Fixed(n) => Ok(Some(builder.with_fixed_chunk_size(n).build())),
            Chunks::Variable(_) => Ok(Some(builder.with_variable_chunk_size().build())),
        }
    }
}

/// Summary of a written file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Written {
    /// Number of points.
    pub points: u64,
    /// Bounds of the points as readers get them; [`Aabb::EMPTY`] without points.
    pub bounds: Aabb,
    /// Length of the file `[bytes]`.
    pub len_bytes: u64,
}

/// Writes points, all of [`Kind::Surface`]. See [`write_samples`].
pub fn write_las(path: &Path, points: impl IntoIterator<Item = Vec3>, spec: &WriteSpec) -> Result<Written> {
    write_samples(
        path,
        points.into_iter().map(|position| Sample { position, kind: Kind::Surface, surface: 0, station: 0 }),
        spec,
    )
}

/// Writes samples to `path`, replacing an existing file, in bounded memory (1 MiB, and a chunk for LAZ). The same
/// samples and spec give the same bytes. Outliers and mixed pixels get class 7.
///
/// Fails if a point does not fit into 32-bit coordinates at the spec's scale and offset; the file is then incomplete.
pub fn write_samples(path: &Path, samples: impl IntoIterator<Item = Sample>, spec: &WriteSpec) -> Result<Written> {
    let (header, vlr) = spec.header(path)?;
    let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
    let mut file = BufWriter::with_capacity(1 << 20, file);
    write_header(&mut file, header.clone(), vlr.is_some(), None).map_err(|e| Error::io(path, "write the header", e))?;
    let mut stock = Stock::new(spec);
    let written = |e| Error::io(path, "write points", e);
    let mut file = match vlr {
        None => {
            let len = record_len(spec.format).unwrap_or(MAX_RECORD);
            let mut buffer = [0; MAX_RECORD];
            for sample in samples {
                encode(spec.format, &stock.record(path, &sample)?, &mut buffer);
                file.write_all(&buffer[..len]).map_err(written)?;
            }
            file
        }
        Some(vlr) => compress(path, file, vlr, samples, &mut stock)?,
    };
    let len_bytes = file.stream_position().map_err(written)?;
    let counted = (stock.count > 0).then(|| (stock.count, stock.bounds()));
    file.seek(SeekFrom::Start(0)).map_err(written)?;
    if stock.count > u64::from(u32::MAX) && header.version().minor < 4 {
        let reason = format!("{} points need LAS 1.4 (4 294 967 295 at most before it)", stock.count);
        return Err(Error::output(path, reason));
    }
    write_header(&mut file, header, spec.compression.is_some(), counted)
        .and_then(|()| file.flush())
        .map_err(|e| Error::io(path, "write the header", e))?;
    Ok(Written { points: stock.count, bounds: stock.bounds(), len_bytes })
}

fn compress<W: Write + Seek + Send + Sync>(
    path: &Path,
    file: W,
    vlr: LazVlr,
    samples: impl IntoIterator<Item = Sample>,
    stock: &mut Stock<'_>,
) -> Result<W> {
    let fault = |e: laz::LasZipError| Error::output(path, e.to_string());
    let written = |e| Error::io(path, "write points", e);
    let len = vlr.items_size() as usize;
    let mut laz = LasZipCompressor::new(file, vlr).map_err(fault)?;
    laz.reserve_offset_to_chunk_table().map_err(written)?;
    let mut buffer = [0; MAX_RECORD];
    let (mut left, mut chunk_rng) = (u64::MAX, Stream::new(stock.spec.seed, 7));
    let variable = match stock.spec.compression {
        Some(Chunks::Variable(most)) => Some(u64::from(most)),
        _ => None,
    };
    for sample in samples {
        if let Some(most) = variable {
            if left == 0 {
                laz.finish_current_chunk().map_err(written)?;
            }
            if left == 0 || left == u64::MAX {
                left = 1 + chunk_rng.below(most);
            }
            left -= 1;
        }
        encode(stock.spec.format, &stock.record(path, &sample)?, &mut buffer);
        laz.compress_one(&buffer[..len]).map_err(written)?;
    }
    laz.done().map_err(written)?;
    Ok(laz.into_inner())
}

/// Turns samples into records and counts them.
struct Stock<'a> {
    spec: &'a WriteSpec,
    rng: Stream,
    weights: Vec<(f64, u8)>,
    count: u64,
    low: [i32; 3],
    high: [i32; 3],
}

impl<'a> Stock<'a> {
    fn new(spec: &'a WriteSpec) -> Self {
        let mut total = 0.0;
        let weights = spec.classes.iter().map(|(class, share)| {
            total += share;
            (total, *class)
        });
        let weights = weights.collect();
        Self { spec, rng: Stream::new(spec.seed, 6), weights, count: 0, low: [i32::MAX; 3], high: [i32::MIN; 3] }
    }

    #[inline]
    fn record(&mut self, path: &Path, sample: &Sample) -> Result<Record> {
        let grid = self.spec.grid(sample.position).ok_or_else(|| self.misfit(path, sample))?;
        for (axis, value) in grid.into_iter().enumerate() {
            self.low[axis] = self.low[axis].min(value);
            self.high[axis] = self.high[axis].max(value);
        }
        let mut class = class_of(sample.kind);
        if let Some((total, last)) = self.weights.last().filter(|_| class == 1) {
            let at = self.rng.unit() * total;
            class = self.weights.iter().find(|w| at < w.0).map_or(*last, |w| w.1);
        }
        if let Some(moving) = self.spec.moving_class.filter(|_| sample.kind == Kind::Moving) {
            class = moving;
        }
        let withheld = self.spec.withheld_share > 0.0 && self.rng.unit() < self.spec.withheld_share;
        let index = self.count;
        self.count += 1;
        let colour = self.spec.texture.map(|texture| texture.seen_from(sample.station, self.spec.place(grid)));
        Ok(Record { grid, class, withheld, index, colour })
    }

    #[cold]
    fn misfit(&self, path: &Path, sample: &Sample) -> Error {
        let reason = format!(
            "point {} at {:?} does not fit 32-bit coordinates of scale {:?} and offset {:?}; use a coarser scale or an \
             offset nearby",
            self.count, sample.position, self.spec.scale, self.spec.offset
        );
        Error::output(path, reason)
    }

    fn bounds(&self) -> Aabb {
        if self.count == 0 { Aabb::EMPTY } else { Aabb::new(self.spec.place(self.low), self.spec.place(self.high)) }
    }
}

/// Writes the header and its variable length records; their length does not depend on `counted`.
fn write_header<W: Write>(out: W, header: Header, laz: bool, counted: Option<(u64, Aabb)>) -> std::io::Result<()> {
    let other = |e: las::Error| std::io::Error::other(e.to_string());
    let vlrs = header.vlrs().clone();
    let padding = header.vlr_padding().clone();
    let extended = header.version().minor >= 4;
    // The extended formats leave the legacy 32-bit counts at zero.
    let legacy = !header.point_format().is_extended;
    let mut out = out;
    let mut raw = header.into_raw().map_err(other)?;
    if laz {
        raw.point_data_record_format |= 0x80;
    }
    let (count, bounds) = counted.unwrap_or((0, Aabb::new([0.0; 3], [0.0; 3])));
    [raw.min_x, raw.min_y, raw.min_z] = bounds.min;
    [raw.max_x, raw.max_y, raw.max_z] = bounds.max;
    if let Some(count) = u32::try_from(count).ok().filter(|_| legacy) {
        raw.number_of_point_records = count;
        raw.number_of_points_by_return[0] = count;
    }
    if extended {
        let mut large = raw::header::LargeFile { number_of_point_records: count, ..Default::default() };
        large.number_of_points_by_return[0] = count;
        raw.large_file = Some(large);
    }
    raw.write_to(&mut out).map_err(other)?;
    for vlr in vlrs {
        vlr.into_raw(false).and_then(|v| v.write_to(&mut out)).map_err(other)?;
    }
    out.write_all(&padding)
}
