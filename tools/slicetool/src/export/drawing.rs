//! The floor plan of a slice: outlines of its obstacles and floors, as SVG at a round scale and as DXF in metres.

use super::crs::Crs;
use crate::figures::round_length;
use crate::outline::{Area, Corner};
use crate::{Failure, show};
use slicewalk::archive::{Archive, PageReader};
use slicewalk::frame::{Frame, PAGE_SLICES, TILE_PIXELS};
use slicewalk_base::output::Output;
use slicewalk_base::text::{number, one_line, rounded};
use std::collections::BTreeMap;
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::Path;

/// Height of the cut above the floor (m): through doors and most windows, above most furniture.
const CUT_M: f64 = 1.2;
/// Most occupied runs of pixels along x that are outlined; each takes up to 350 bytes.
const MOST_RUNS: usize = 1 << 21;
/// Scales of drawings, and the longest edge of the sheet (mm).
const SCALES: [u32; 12] = [20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000];
const SHEET_MM: f64 = 1100.0;
/// Margins around the plan, and below it for the scale bar (mm).
const MARGIN_MM: f64 = 10.0;
const FOOT_MM: f64 = 14.0;
/// Names of the layers.
const LAYERS: [&str; 2] = ["obstacles", "floors"];
/// Colours of the layers, for SVG and as AutoCAD colour index (black or white, grey).
const FILLS: [&str; 2] = ["#1a1a1a", "#d9e4ee"];
const COLOUR_NUMBERS: [u8; 2] = [7, 9];

/// Returns the slice to draw: the requested one, or the one at cut height above the lowest slice that has at least half
/// as much floor as any other.
pub fn slice(archive: &Archive, path: &Path, number: Option<u64>, z: Option<f64>) -> Result<i64, Failure> {
    if number.is_some() || z.is_some() {
        return show::slice(archive, path, number, z);
    }
    let (lowest, highest) = show::slices(archive, path)?;
    let mut floors: BTreeMap<i64, u64> = BTreeMap::new();
    let mut pages = PageReader::new(archive);
    for entry in crate::entries(archive, path) {
        let entry = entry?;
        let page = pages.page(&entry).map_err(|error| crate::broken(path, &error))?;
        for span in page.columns().flat_map(|(_, _, spans)| spans).filter(|span| !span.is_obstacle()) {
            *floors.entry(i64::from(entry.key.layer) * PAGE_SLICES + i64::from(span.slices().1)).or_default() += 1;
        }
    }
    // Roofs are floors, too, so take the lowest.
    let most = floors.values().max().copied().unwrap_or(0);
    let storey = floors.iter().find(|(_, count)| **count >= most.div_ceil(2)).map_or(lowest, |(slice, _)| *slice);
    let above = (CUT_M / archive.frame().slice_m()).round() as i64;
    Ok(storey.saturating_add(above).min(highest))
}

/// Outlines in one slice, in corners of pixels: for each layer closed polygons of an outer ring and its holes.
pub struct Plan<'a> {
    frame: &'a Frame,
    slice: i64,
    name: String,
    layers: [Vec<Vec<Vec<Corner>>>; 2],
    /// Lowest and highest corner.
    bounds: [Corner; 2],
}

impl<'a> Plan<'a> {
    /// Outlines the voxels of slice `slice` (absolute).
    pub fn of(archive: &'a Archive, path: &Path, slice: i64) -> Result<Self, Failure> {
        let broken = |error| crate::broken(path, &error);
        let (layer, in_page) = (slice.div_euclid(PAGE_SLICES) as i32, slice.rem_euclid(PAGE_SLICES) as u32);
        let mut areas: [Area; 2] = Default::default();
        let mut pages = PageReader::new(archive);
        for entry in crate::entries(archive, path) {
            let entry = entry?;
            if entry.key.layer != layer || entry.slices >> in_page & 1 == 0 {
                continue;
            }
            let pixel = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
            for (px, py, spans) in pages.page(&entry).map_err(broken)?.columns() {
                let mut here = spans.iter().filter(|span| span.within_slice(in_page).is_some()).peekable();
                if here.peek().is_some() {
                    let is_floor = !here.any(|span| span.is_obstacle());
                    areas[usize::from(is_floor)].insert((pixel(entry.key.tx, px), pixel(entry.key.ty, py)));
                }
            }
            let runs: usize = areas.iter().map(Area::runs).sum();
            if runs > MOST_RUNS && areas.iter_mut().map(Area::joined_runs).sum::<usize>() > MOST_RUNS {
                let reason = format!("the solid in the slice has more than {MOST_RUNS} runs of pixels");
                return Err(Failure::Text(format!("{}: {reason}; extract a region first", path.display())));
            }
        }
        let bounds = areas
            .iter()
            .filter_map(Area::bounds)
            .reduce(|[a, b], [c, d]| [(a.0.min(c.0), a.1.min(c.1)), (b.0.max(d.0), b.1.max(d.1))]);
        let bounds = bounds.unwrap_or([(0, 0), (0, 0)]);
        let name = path.file_name().map(|name| one_line(&name.to_string_lossy()).into_owned()).unwrap_or_default();
        Ok(Self { frame: archive.frame(), slice, name, layers: areas.map(Area::polygons), bounds })
    }

    fn heights(&self) -> String {
        let of = |slice| rounded(self.frame.bottom_of_slice(slice), self.frame.quantum_m());
        format!("z from {} to {} m", of(self.slice), of(self.slice + 1))
    }

    /// Writes a drawing in millimetres of paper with a scale bar; returns a message about it.
    pub fn svg(&self, crs: Option<&Crs>, to: Output) -> Result<String, Failure> {
        let [least, greatest] = self.bounds;
        let size = [greatest.0 - least.0, greatest.1 - least.1].map(|pixels| pixels as f64 * self.frame.pixel_m());
        let longest = size[0].max(size[1]) * 1000.0;
        let scale = SCALES.into_iter().find(|scale| longest / f64::from(*scale) <= SHEET_MM).unwrap_or(SCALES[11]);
        let mm = |metres: f64| metres * 1000.0 / f64::from(scale);
        let [width, height] =
            [mm(size[0]).max(60.0) + 2.0 * MARGIN_MM, mm(size[1]) + 2.0 * MARGIN_MM + FOOT_MM].map(round);
        let mut out = BufWriter::new(to);
        writeln!(
            out,
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" viewBox="0 0 {width} {height}">"#
        )?;
        let origin = [least.0, least.1].map(|corner| number(self.frame.edge_of_pixel(corner)));
        let system = crs.map_or(String::new(), |crs| format!(", {}", crs.text()));
        let about = format!("{}, {}, 1:{scale}", self.name, self.heights());
        writeln!(out, "<title>{}</title>", escaped(&about))?;
        let place = format!("lower left corner of the plan: x {} m, y {} m{system}", origin[0], origin[1]);
        writeln!(out, "<desc>{}</desc>", escaped(&place))?;
        let point = |&(i, j): &Corner| {
            let along = |corner: i64, from: i64| mm((corner - from) as f64 * self.frame.pixel_m());
            let (x, y) = (MARGIN_MM + along(i, least.0), MARGIN_MM + along(greatest.1, j));
            format!("{} {}", round(x), round(y))
        };
        // Floors first, so that walls are drawn over them.
        for layer in [1, 0] {
            writeln!(out, r#"<path id="{}" fill="{}" fill-rule="evenodd" d=""#, LAYERS[layer], FILLS[layer])?;
            for ring in self.layers[layer].iter().flatten() {
                let corners: Vec<String> = ring[..ring.len() - 1].iter().map(point).collect();
                writeln!(out, "M{}Z", corners.join("L"))?;
            }
            writeln!(out, r#""/>"#)?;
        }
        let bar = round_length((width - 2.0 * MARGIN_MM) / 3.0 * f64::from(scale) / 1000.0);
        let (y, end) = (round(height - MARGIN_MM), round(MARGIN_MM + mm(bar)));
        writeln!(out, r##"<path id="scale" stroke="#1a1a1a" stroke-width="0.6" d="M{MARGIN_MM} {y}L{end} {y}"/>"##)?;
        let text = format!("{} m, 1:{scale}, {}", number(bar), self.heights());
        let x = round(end + 3.0);
        writeln!(out, r#"<text x="{x}" y="{y}" font-family="sans-serif" font-size="4">{}</text>"#, escaped(&text))?;
        writeln!(out, "</svg>")?;
        out.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
        Ok(format!("1:{scale}, {}", self.heights()))
    }

    /// Writes closed polylines in metres, in the archive's coordinates, as DXF release 12, which every program reads;
    /// returns a message about it.
    pub fn dxf(&self, to: Output) -> Result<String, Failure> {
        let mut out = BufWriter::new(to);
        let metres = |edge: i64| rounded(self.frame.edge_of_pixel(edge), 1e-6);
        let (x, y) = (|corner: &Corner| metres(corner.0), |corner: &Corner| metres(corner.1));
        let [least, greatest] = &self.bounds;
        let z = rounded(self.frame.bottom_of_slice(self.slice), 1e-6);
        // DXF consists of pairs of lines: a group code, then its value.
        write!(out, "999\n{}, {}, metres\n", self.name, self.heights())?;
        write!(out, "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n")?;
        write!(out, "9\n$EXTMIN\n10\n{}\n20\n{}\n30\n{z}\n", x(least), y(least))?;
        write!(out, "9\n$EXTMAX\n10\n{}\n20\n{}\n30\n{z}\n0\nENDSEC\n", x(greatest), y(greatest))?;
        write!(out, "0\nSECTION\n2\nTABLES\n0\nTABLE\n2\nLAYER\n70\n{}\n", LAYERS.len())?;
        for (layer, colour) in LAYERS.into_iter().zip(COLOUR_NUMBERS) {
            write!(out, "0\nLAYER\n2\n{layer}\n70\n0\n62\n{colour}\n6\nCONTINUOUS\n")?;
        }
        write!(out, "0\nENDTAB\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n")?;
        for (layer, polygons) in LAYERS.into_iter().zip(&self.layers) {
            for ring in polygons.iter().flatten() {
                write!(out, "0\nPOLYLINE\n8\n{layer}\n66\n1\n10\n0\n20\n0\n30\n{z}\n70\n1\n")?;
                for corner in &ring[..ring.len() - 1] {
                    write!(out, "0\nVERTEX\n8\n{layer}\n10\n{}\n20\n{}\n30\n{z}\n", x(corner), y(corner))?;
                }
                write!(out, "0\nSEQEND\n8\n{layer}\n")?;
            }
        }
        write!(out, "0\nENDSEC\n0\nEOF\n")?;
        out.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
        Ok(self.heights())
    }
}

/// Rounds to micrometres of paper.
fn round(mm: f64) -> f64 {
    (mm * 1000.0).round() / 1000.0
}

/// Escapes text for XML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
