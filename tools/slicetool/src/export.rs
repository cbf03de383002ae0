//! `slicetool export`: one point per occupied voxel, for any viewer of point clouds.

use crate::{Failure, Outcome};
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

/// LAS class of floor (the standard's "ground") and of obstacles (its "unclassified").
const CLASSES: [u8; 2] = [2, 1];
/// Room for the point count in a PLY header, so that it can be filled in at the end.
const COUNT_DIGITS: usize = 20;

/// A voxel as a point: pixel centre, top of the matter in the voxel, colour as in `show`.
struct VoxelPoint {
    position: [f64; 3],
    colour: [u8; 3],
    obstacle: bool,
}

/// Exports the archive at `path` in the format that the ending of `output` names.
pub fn run(path: &Path, output: &Path) -> Outcome {
    let archive = crate::open(path)?;
    crate::keep_apart(path, output)?;
    let ending = output.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    let count = match ending.as_str() {
        "ply" => ply(&archive, path, output),
        "las" | "laz" => las(&archive, path, output),
        _ => {
            let text = format!("{}: unknown format; name the file .ply, .las or .laz", output.display());
            return Err(Failure::Text(text));
        }
    };
    match count {
        Ok(count) => Ok(format!("{}: {count} points\n", output.display())),
        Err(failure) => {
            // Half an export is worse than none.
            let _ = std::fs::remove_file(output);
            Err(failure)
        }
    }
}

fn each_voxel(
    archive: &Archive,
    path: &Path,
    mut give: impl FnMut(&VoxelPoint) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let frame = archive.frame();
    let broken = |error| crate::broken(path, &error);
    for entry in archive.entries() {
        let entry = entry.map_err(broken)?;
        let page = archive.page(&entry).map_err(broken)?;
        for (px, py, spans) in page.columns() {
            let centre = |tile: i32, pixel: u32| {
                (f64::from(tile) * TILE_PIXELS as f64 + f64::from(pixel) + 0.5) * frame.pixel_m()
            };
            for span in spans {
                let (first, last) = span.slices();
                for slice in first..=last {
                    let Some((_, top)) = span.within_slice(slice) else { continue };
                    let floor = frame.bottom_of_slice(i64::from(entry.key.layer) * PAGE_SLICES + i64::from(slice));
                    give(&VoxelPoint {
                        position: [
                            centre(entry.key.tx, px),
                            centre(entry.key.ty, py),
                            floor + f64::from(top) * frame.quantum_m(),
                        ],
                        colour: [top, 255, if span.is_obstacle() { 255 } else { 26 }],
                        obstacle: span.is_obstacle(),
                    })?;
                }
            }
        }
    }
    Ok(())
}

fn ply(archive: &Archive, path: &Path, output: &Path) -> Result<u64, Failure> {
    let failed = |action: &str, e: std::io::Error| Failure::Text(format!("{}: cannot {action}: {e}", output.display()));
    let mut file = BufWriter::new(File::create(output).map_err(|e| failed("create", e))?);
    let head = "ply\nformat binary_little_endian 1.0\nelement vertex ";
    write!(
        file,
        "{head}{:COUNT_DIGITS$}\nproperty double x\nproperty double y\nproperty double z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        ""
    )?;
    let mut count = 0u64;
    each_voxel(archive, path, |point| {
        count += 1;
        for value in point.position {
            file.write_all(&value.to_le_bytes()).map_err(|e| failed("write", e))?;
        }
        file.write_all(&point.colour).map_err(|e| failed("write", e))
    })?;
    file.seek(SeekFrom::Start(head.len() as u64)).map_err(|e| failed("seek", e))?;
    write!(file, "{count:<COUNT_DIGITS$}")?;
    file.flush().map_err(|e| failed("write", e))?;
    Ok(count)
}

fn las(archive: &Archive, path: &Path, output: &Path) -> Result<u64, Failure> {
    let mut builder = las::Builder::from((1, 2));
    builder.point_format = las::point::Format::new(2)?;
    let (min, max) = archive.header().bounds.unwrap_or_default();
    for (axis, transform) in
        [&mut builder.transforms.x, &mut builder.transforms.y, &mut builder.transforms.z].into_iter().enumerate()
    {
        transform.offset = ((min[axis] + max[axis]) / 2.0).round();
        // Fine enough for any quantum, coarse enough for 32 bits.
        transform.scale = (((max[axis] - min[axis]) / 2e9).max(1e-12)).log10().ceil().max(-4.0);
        transform.scale = 10f64.powf(transform.scale);
    }
    let failed = |e: las::Error| Failure::Text(format!("{}: cannot write: {e}", output.display()));
    let mut writer = las::Writer::from_path(output, builder.into_header()?).map_err(failed)?;
    let mut count = 0u64;
    each_voxel(archive, path, |point| {
        count += 1;
        let [x, y, z] = point.position;
        let [red, green, blue] = point.colour.map(|value| u16::from(value) * 257);
        writer
            .write_point(las::Point {
                x,
                y,
                z,
                color: Some(las::Color { red, green, blue }),
                classification: las::point::Classification::new(CLASSES[usize::from(point.obstacle)])?,
                return_number: 1,
                number_of_returns: 1,
                ..Default::default()
            })
            .map_err(failed)
    })?;
    writer.close().map_err(failed)?;
    Ok(count)
}
