//! `slicetool show`: one slice as a picture in the thesis' colours.

use crate::{Failure, Outcome};
use slicewalk::archive::{Archive, PageEntry};
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Widest or highest picture drawn (pixels): beyond it, viewers give up.
const MAX_EDGE_PIXELS: i64 = 65_500;

/// Which slice of which archive, and where to.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("which").required(true))]
pub struct Arguments {
    archive: PathBuf,
    /// Slice by number, from 0 at the lowest
    #[arg(long, value_name = "N", group = "which")]
    slice: Option<u64>,
    /// Slice by height in metres
    #[arg(long, value_name = "Z", group = "which", allow_hyphen_values = true)]
    z: Option<f64>,
    /// Picture to write
    #[arg(short, long, value_name = "S.png")]
    output: PathBuf,
}

/// Draws the slice that `arguments` name.
pub fn run(arguments: &Arguments) -> Outcome {
    let archive = crate::open(&arguments.archive)?;
    let Some((lowest, highest)) = archive.header().slices else {
        return Err(Failure::Text(format!("{}: holds no points, so there is no slice", arguments.archive.display())));
    };
    let slice = match (arguments.slice, arguments.z) {
        (Some(number), _) => i64::try_from(number).ok().and_then(|number| lowest.checked_add(number)),
        (None, z) => Some(archive.frame().slice_of(z.unwrap_or(f64::NAN))),
    };
    let Some(slice) = slice.filter(|slice| (lowest..=highest).contains(slice)) else {
        let frame = archive.frame();
        return Err(Failure::Text(format!(
            "{}: no such slice; there are {}, --slice 0 to {}, --z {} to {}",
            arguments.archive.display(),
            highest - lowest + 1,
            highest - lowest,
            frame.bottom_of_slice(lowest),
            frame.bottom_of_slice(highest + 1)
        )));
    };
    draw(&archive, &arguments.archive, slice, &arguments.output)?;
    Ok(String::new())
}

/// Draws slice `slice` (absolute) of `archive`, which lies at `path`, as a PNG `to`: one pixel per pixel of the archive,
/// north up, over the bounds of all points. Memory: one row of tiles.
pub fn draw(archive: &Archive, path: &Path, slice: i64, to: &Path) -> Result<(), Failure> {
    let broken = |error| crate::broken(path, &error);
    let frame = archive.frame();
    let Some((min, max)) = archive.header().bounds else {
        return Err(Failure::Text(format!("{}: holds no points, so there is no slice", path.display())));
    };
    let (left, right) = (frame.pixel_of(min[0]), frame.pixel_of(max[0]));
    let (low, high) = (frame.pixel_of(min[1]), frame.pixel_of(max[1]));
    let (width, height) = (right - left + 1, high - low + 1);
    if width > MAX_EDGE_PIXELS || height > MAX_EDGE_PIXELS {
        return Err(Failure::Text(format!(
            "{}: the slice is {width} × {height} pixels, beyond the {MAX_EDGE_PIXELS} that a picture may have; extract a \
             region first",
            path.display()
        )));
    }
    let mut output = crate::output(to, archive, &[])?;
    let layer = slice.div_euclid(PAGE_SLICES) as i32;
    let in_page = slice.rem_euclid(PAGE_SLICES) as u32;
    let mut entries: Vec<PageEntry> = Vec::new();
    for entry in archive.entries() {
        let entry = entry.map_err(broken)?;
        if entry.key.layer == layer && entry.slices >> in_page & 1 == 1 {
            entries.push(entry);
        }
    }
    // North up: the highest row of tiles first.
    entries.sort_unstable_by_key(|entry| (std::cmp::Reverse(entry.key.ty), entry.key.tx));

    let mut file = BufWriter::new(&mut output);
    let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    let mut stream = writer.stream_writer()?;
    let mut rows = vec![0u8; width as usize * 3 * TILE_PIXELS as usize];
    let mut rest = &entries[..];
    for ty in (low.div_euclid(TILE_PIXELS)..=high.div_euclid(TILE_PIXELS)).rev() {
        rows.fill(0);
        let count = rest.iter().take_while(|entry| i64::from(entry.key.ty) == ty).count();
        let (row, others) = rest.split_at(count);
        rest = others;
        for entry in row {
            let page = archive.page(entry).map_err(broken)?;
            for (px, py, spans) in page.columns() {
                let part = spans.iter().find_map(|span| Some((span.within_slice(in_page)?, span.is_obstacle())));
                let x = i64::from(entry.key.tx) * TILE_PIXELS + i64::from(px) - left;
                if let Some(((_, top), obstacle)) = part
                    && (0..width).contains(&x)
                {
                    let at = (i64::from(py) * width + x) as usize * 3;
                    rows[at..at + 3].copy_from_slice(&[top, 255, if obstacle { 255 } else { 26 }]);
                }
            }
        }
        for py in (0..TILE_PIXELS).rev().filter(|py| (low..=high).contains(&(ty * TILE_PIXELS + py))) {
            let at = (py * width * 3) as usize;
            stream.write_all(&rows[at..at + width as usize * 3])?;
        }
    }
    stream.finish()?;
    writer.finish()?;
    file.flush()?;
    drop(file);
    output.publish()?;
    Ok(())
}
