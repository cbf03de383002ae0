//! Converts points to an archive through a LAS file, and reads its spans.

use crate::random;
pub use random::Random;

use scangen::{Kind, Sample, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use slicewalk::plan::{Classifier, PlanOptions};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::collections::BTreeMap;

/// Grid, file and rule of a conversion.
#[derive(Debug, Clone, Copy)]
pub struct Setting {
    /// Pixel size and slice height (m).
    pub pixel_m: f64,
    pub slice_m: f64,
    /// Step of the file's coordinates (m).
    pub step: f64,
    /// Offset of the file's coordinates (m).
    pub offset: [f64; 3],
    pub classifier: Classifier,
}

/// Spans by pixel: bottom and top (quanta), whether an obstacle; lowest first. Parts of a span in several pages are
/// joined, and nothing else is.
pub type Columns = BTreeMap<[i64; 2], Vec<(i64, i64, bool)>>;

/// Writes `points`, converts them, and returns them as read by a reader, with the archive's bytes.
pub fn converted(points: &[[f64; 3]], setting: Setting) -> (Vec<[f64; 3]>, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let spec = WriteSpec { scale: [setting.step; 3], offset: setting.offset, ..WriteSpec::default() };
    let points: Vec<_> = points.iter().map(|&p| spec.rounded(p).expect("fits the file")).collect();
    let sample = |&position: &[f64; 3]| Sample { position, kind: Kind::Surface, surface: 0, station: 0 };
    let (input, output) = (folder.path().join("scan.las"), folder.path().join("scan.slices"));
    write_samples(&input, points.iter().map(sample), &spec).unwrap();
    let mut options = ConvertOptions::new(vec![input], output.clone());
    options.grid.pixel = PixelSize::Metres(setting.pixel_m);
    options.grid.slice_m = Some(setting.slice_m);
    options.plan = PlanOptions { classifier: setting.classifier, ..PlanOptions::default() };
    options.resources.threads = 2;
    options.resources.temp_dir = folder.path().into();
    convert(&options, &NoMonitor).unwrap();
    (points, std::fs::read(output).unwrap())
}

/// The spans of an archive.
pub fn columns(bytes: Vec<u8>) -> Columns {
    let archive = Archive::from_bytes(bytes).unwrap();
    let mut columns = Columns::new();
    for entry in archive.entries() {
        let entry = entry.unwrap();
        let (key, base) = (entry.key, i64::from(entry.key.layer) * PAGE_QUANTA);
        for (px, py, spans) in archive.page(&entry).unwrap().columns() {
            let pixel =
                [i64::from(key.tx) * TILE_PIXELS + i64::from(px), i64::from(key.ty) * TILE_PIXELS + i64::from(py)];
            let column = columns.entry(pixel).or_default();
            for span in spans {
                let (bottom, top) = (base + i64::from(span.bottom()), base + i64::from(span.top()));
                match column.last_mut() {
                    Some(below) if below.1 == bottom && bottom == base && below.2 == span.is_obstacle() => {
                        below.1 = top
                    }
                    _ => column.push((bottom, top, span.is_obstacle())),
                }
            }
        }
    }
    columns
}
