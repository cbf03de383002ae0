//! `slicetool show`: draws one slice, in the thesis' colours or in those of the scan.

use crate::ground::seen_space;
use crate::{Failure, Outcome, figures};
use slicewalk::Parameter;
use slicewalk::archive::{Archive, ColourReader, Level, PageDecoder, PageEntry};
use slicewalk::frame::{Frame, PAGE_SLICES, TILE_PIXELS};
use slicewalk::page::Span;
use slicewalk::seen::{CELL_PIXELS, SeenSpace};
use slicewalk_base::text::{finite_number, grouped, number, one_line, rounded, whole_number};
use slicewalk_convert::info::slice_count;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Blue channel of floors, obstacles and inferred floor.
pub const BLUES: [u8; 3] = [26, 255, 128];
/// Index of inferred floor in [`BLUES`].
pub const INFERRED: usize = 2;
/// Colour of voxels without a colour, where voxels are drawn in their colours.
pub const COLOURLESS: [u8; 3] = [96; 3];
/// Colour of seen space, and most memory for it (bytes).
const SEEN: [u8; 3] = [0, 0, 96];
const MOST_SEEN_BYTES: u64 = 4 << 30;
/// Margin around the parts of a legend, length of its colour ramps, and its minimum width (pixels).
const MARGIN: i64 = 8;
const RAMP: i64 = 64;
const LEGEND_WIDTH: i64 = 400;

/// Largest width and height of a picture (pixels); viewers fail on larger ones.
const MAX_EDGE_PIXELS: i64 = 65_500;

/// Options of `slicetool show`.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("which").required(true))]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// Slice by number, from 0 at the lowest
    #[arg(long, value_name = "N", group = "which", value_parser = whole_number(0u64, u64::MAX))]
    slice: Option<u64>,
    /// Slice by height in metres
    #[arg(long, value_name = "Z", group = "which", allow_hyphen_values = true, value_parser = finite_number)]
    z: Option<f64>,
    /// Draw this overview level: 1 has pixels and slices 4 times as large, 2 has them 16 times as large. `--slice` then
    /// counts slices of the level
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    level: u32,
    /// Picture to write (PNG); `-` is standard output
    #[arg(short, long, value_name = "S.png")]
    output: PathBuf,
    /// Add a strip below with a scale bar and the colours of floors, obstacles and (if holes are filled) inferred
    /// floor, from the bottom to the top of the slice
    #[arg(long)]
    legend: bool,
    /// Draw voxels in their own colours (`sliceconv --colour`); those without one are grey
    #[arg(long, conflicts_with = "legend")]
    colour: bool,
    /// Also draw seen space (`sliceconv --free-space`), dark blue; what is black was never seen
    #[arg(long, conflicts_with_all = ["legend", "colour", "level"])]
    seen: bool,
}

/// Draws the requested slice.
pub fn run(arguments: &Arguments) -> Outcome {
    let mut archive = crate::open(&arguments.archive)?;
    if arguments.level > 0 {
        archive = archive.level(arguments.level).map_err(|error| crate::broken(&arguments.archive, &error))?;
    }
    let slice = slice(&archive, &arguments.archive, arguments.slice, arguments.z)?;
    let (lowest, _) = slices(&archive, &arguments.archive)?;
    let strip = if arguments.legend { Look::Legend } else { Look::Plain };
    let look = match (arguments.colour, arguments.seen) {
        (true, _) => Look::Colour,
        (_, true) => Look::Seen,
        _ => strip,
    };
    let (width, height) = draw(&archive, &arguments.archive, slice, look, &arguments.output)?;
    let frame = archive.frame();
    let [bottom, top] = [slice, slice + 1].map(|slice| rounded(frame.bottom_of_slice(slice), frame.quantum_m()));
    let (number_of, all, pixel) =
        (grouped((slice - lowest) as u64), slice_count(archive.header()), number(frame.pixel_m()));
    let name = arguments.output.to_string_lossy();
    let about = format!(
        "{}: slice {number_of} of {}, z from {bottom} to {top} m, {width} × {height} pixels of {pixel} m\n",
        one_line(&name),
        grouped(all as u64)
    );
    crate::standard::written(&arguments.output, &about)
}

/// Lowest and highest slice of an archive (absolute).
pub fn slices(archive: &Archive, path: &Path) -> Result<(i64, i64), Failure> {
    let none = || Failure::Text(format!("{}: holds no points, so there is no slice", path.display()));
    archive.header().slices.ok_or_else(none)
}

/// Returns the slice (absolute) with number `number` counted from the lowest, or at height `z`.
pub fn slice(archive: &Archive, path: &Path, number: Option<u64>, z: Option<f64>) -> Result<i64, Failure> {
    let (lowest, highest) = slices(archive, path)?;
    let frame = archive.frame();
    let slice = match number {
        Some(number) => i64::try_from(number).ok().and_then(|number| lowest.checked_add(number)),
        None => Some(frame.slice_of(z.unwrap_or(f64::NAN))),
    };
    slice.filter(|slice| (lowest..=highest).contains(slice)).ok_or_else(|| {
        Failure::Text(format!(
            "{}: no such slice; there are {}, --slice 0 to {}, --z {} to {}",
            path.display(),
            grouped((highest - lowest) as u64 + 1),
            highest - lowest,
            rounded(frame.bottom_of_slice(lowest), frame.quantum_m()),
            rounded(frame.bottom_of_slice(highest + 1), frame.quantum_m())
        ))
    })
}

/// Returns the finest overview level of `archive` in which an edge of `pixels` pixels fits a picture.
fn fitting_level(archive: &Archive, pixels: i64) -> Option<u32> {
    let levels = archive.levels().ok()?;
    levels.iter().map(Level::number).find(|&level| (pixels >> (2 * level)) + 1 < MAX_EDGE_PIXELS)
}

/// Style of a drawing.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// The thesis' colours.
    Plain,
    /// The thesis' colours with a legend below.
    Legend,
    /// The colours of the voxels.
    Colour,
    /// The thesis' colours, and seen space.
    Seen,
}

/// Reads the colours of the archive at `path`; fails if it has none.
pub fn colours(archive: &Archive, path: &Path) -> Result<ColourReader, Failure> {
    let reader = ColourReader::new(archive).map_err(|error| crate::broken(path, &error))?;
    reader.ok_or_else(|| {
        Failure::Text(format!("{}: has no colours; convert the scan with --colour auto", path.display()))
    })
}

/// Draws slice `slice` (absolute) of `archive`, which is at `path`, as a PNG `to`: one pixel per pixel of the archive,
/// north up, over the bounds of all points. Returns width and height. Memory: one row of tiles.
pub fn draw(archive: &Archive, path: &Path, slice: i64, look: Look, to: &Path) -> Result<(i64, i64), Failure> {
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
            "{}: the slice is {width} × {height} pixels, beyond the {MAX_EDGE_PIXELS} that a picture may have; {}extract a \
             region first",
            path.display(),
            fitting_level(archive, width.max(height))
                .map_or(String::new(), |level| format!("draw --level {level}, or "))
        )));
    }
    let seen = match look {
        Look::Seen => Some(seen_space(archive, path, MOST_SEEN_BYTES, Parameter::Bounds)?),
        _ => None,
    };
    let mut colours = if look == Look::Colour { Some(colours(archive, path)?) } else { None };
    let mut output = crate::output(to, archive, &[])?;
    let kinds = if archive.plan().options.fill_holes > 0 { &BLUES[..] } else { &BLUES[..INFERRED] };
    let strip = (look == Look::Legend).then(|| Strip::new(frame, slice, width, kinds));
    let (full_width, strip_height) = strip.as_ref().map_or((width, 0), |strip| (strip.width, strip.height()));
    let layer = slice.div_euclid(PAGE_SLICES) as i32;
    let in_page = slice.rem_euclid(PAGE_SLICES) as u32;
    let mut entries: Vec<PageEntry> = Vec::new();
    for entry in crate::entries(archive, path) {
        let entry = entry?;
        if entry.key.layer == layer && entry.slices >> in_page & 1 == 1 {
            entries.push(entry);
        }
    }
    // North up: the highest row of tiles first.
    entries.sort_unstable_by_key(|entry| (std::cmp::Reverse(entry.key.ty), entry.key.tx));

    let mut file = BufWriter::new(&mut output);
    let mut encoder = png::Encoder::new(&mut file, full_width as u32, (height + strip_height) as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    let mut stream = writer.stream_writer()?;
    let mut rows = vec![0u8; full_width as usize * 3 * TILE_PIXELS as usize];
    let (mut rest, mut decoder) = (&entries[..], PageDecoder::new());
    for ty in (low.div_euclid(TILE_PIXELS)..=high.div_euclid(TILE_PIXELS)).rev() {
        rows.fill(0);
        if let Some(seen) = &seen {
            draw_seen(seen, slice, [ty * TILE_PIXELS, left, width], &mut rows);
        }
        let count = rest.iter().take_while(|entry| i64::from(entry.key.ty) == ty).count();
        let (row, others) = rest.split_at(count);
        rest = others;
        for entry in row {
            crate::go_on()?;
            let page = archive.page_with(entry, &mut decoder).map_err(broken)?;
            let colours = colours.as_mut().map(|colours| colours.colours(entry)).transpose().map_err(broken)?;
            for (px, py, spans) in page.columns() {
                let inferred = decoder.inferred().of(px, py);
                let kind = |at: usize, span: &Span| match inferred >> (at & 63) & 1 {
                    1 => INFERRED,
                    _ => usize::from(span.is_obstacle()),
                };
                // Of several spans in the slice, the lowest; inferred floor only if nothing was scanned.
                let parts = spans.iter().enumerate();
                let parts = parts.filter_map(|(at, span)| Some((span.within_slice(in_page)?, kind(at, span))));
                let part = parts.min_by_key(|(_, kind)| *kind == INFERRED);
                let x = i64::from(entry.key.tx) * TILE_PIXELS + i64::from(px) - left;
                if let Some(((_, top), kind)) = part
                    && (0..width).contains(&x)
                {
                    let at = (i64::from(py) * full_width + x) as usize * 3;
                    let colour = match &colours {
                        Some(colours) => colours.of(px, py, in_page).unwrap_or(COLOURLESS),
                        None => [top, 255, BLUES[kind]],
                    };
                    rows[at..at + 3].copy_from_slice(&colour);
                }
            }
        }
        for py in (0..TILE_PIXELS).rev().filter(|py| (low..=high).contains(&(ty * TILE_PIXELS + py))) {
            let at = (py * full_width * 3) as usize;
            stream.write_all(&rows[at..at + full_width as usize * 3])?;
        }
    }
    if let Some(strip) = strip {
        stream.write_all(strip.pixels.as_flattened())?;
    }
    stream.finish()?;
    writer.finish()?;
    file.flush()?;
    drop(file);
    output.publish()?;
    Ok((full_width, height + strip_height))
}

/// Draws the seen cells of a slice in a row of tiles whose first pixel along y is `low`; `left` is the first pixel of the
/// picture along x.
fn draw_seen(seen: &SeenSpace, slice: i64, [low, left, width]: [i64; 3], rows: &mut [u8]) {
    for (key, page) in seen.pages() {
        if i64::from(key.ty) * TILE_PIXELS != low || i64::from(key.layer) != slice.div_euclid(PAGE_SLICES) {
            continue;
        }
        let cells = &page.slices()[slice.rem_euclid(PAGE_SLICES) as usize];
        for (px, py) in (0..TILE_PIXELS).flat_map(|py| (0..TILE_PIXELS).map(move |px| (px, py))) {
            let (cx, cy) = ((px / CELL_PIXELS) as usize, (py / CELL_PIXELS) as usize);
            let x = i64::from(key.tx) * TILE_PIXELS + px - left;
            if (0..width).contains(&x) && cells[cy / 4] >> (16 * (cy % 4) + cx) & 1 == 1 {
                let at = (py * width + x) as usize * 3;
                rows[at..at + 3].copy_from_slice(&SEEN);
            }
        }
    }
}

/// The legend: a bar of a round length, then colour ramps for heights within the slice, each labelled.
struct Strip {
    width: i64,
    pixels: Vec<[u8; 3]>,
}

impl Strip {
    const ROW: i64 = figures::HEIGHT + MARGIN;

    fn new(frame: &Frame, slice: i64, width: i64, blues: &[u8]) -> Self {
        let width = width.max(LEGEND_WIDTH);
        let mut strip = Self { width, pixels: vec![[0; 3]; (width * (2 * Self::ROW + MARGIN)) as usize] };
        let length = figures::round_length(width as f64 / 3.0 * frame.pixel_m());
        let end = (length / frame.pixel_m()).round() as i64;
        strip.fill([MARGIN, MARGIN + figures::HEIGHT / 2], [end, 2], |_| [255; 3]);
        strip.write([2 * MARGIN + end, MARGIN], &format!("{} m", number(length)));
        let [bottom, top] = [slice, slice + 1].map(|slice| rounded(frame.bottom_of_slice(slice), frame.quantum_m()));
        let row = MARGIN + Self::ROW;
        let mut at = strip.write([MARGIN, row], &format!("z {bottom}"));
        for &blue in blues {
            strip.fill([at, row], [RAMP, figures::HEIGHT], |x| [(x * 255 / (RAMP - 1)) as u8, 255, blue]);
            at += RAMP + MARGIN;
        }
        strip.write([at, row], &format!("{top} m"));
        strip
    }

    fn height(&self) -> i64 {
        self.pixels.len() as i64 / self.width
    }

    fn set(&mut self, x: i64, y: i64, colour: [u8; 3]) {
        if (0..self.width).contains(&x) && (0..self.height()).contains(&y) {
            self.pixels[(y * self.width + x) as usize] = colour;
        }
    }

    fn fill(&mut self, [x, y]: [i64; 2], [width, height]: [i64; 2], colour: impl Fn(i64) -> [u8; 3]) {
        for (dx, dy) in (0..width).flat_map(|dx| (0..height).map(move |dy| (dx, dy))) {
            self.set(x + dx, y + dy, colour(dx));
        }
    }

    /// Draws digits; returns where the next part begins.
    fn write(&mut self, [x, y]: [i64; 2], text: &str) -> i64 {
        figures::figures(text, |dx, dy| self.set(x + dx, y + dy, [255; 3]));
        x + text.len() as i64 * figures::WIDTH + MARGIN
    }
}
