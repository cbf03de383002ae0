//! Map of a region: a panel for each storey, the highest on top, north up.
//!
//! Standing places are coloured by height, from blue (lowest of the region) through green to yellow (highest). Pixels
//! with solid at the height of the body are grey, leaks are red dots, larger for wider ones, passages orange dots, and the requested route is
//! a black line. Each panel shows its height; the bar at the bottom shows a length.

use super::Reach;
use super::files::Out;
use crate::Failure;
use crate::figures::{figures, round_length};
use crate::ground::Loader;
use nalgebra::Point3;
use slicewalk::frame::{PAGE_QUANTA, PageKey, TILE_PIXELS};

/// Narrower maps are enlarged to this width, wider ones are reduced (pixels).
const WIDTH: i64 = 900;
const MOST_WIDTH: i64 = 8000;
/// Most pixels of a map, and most panels.
const MOST_PIXELS: i64 = 100_000_000;
const MOST_PANELS: usize = 64;
/// Margin of each panel (pixels of the picture).
const MARGIN: i64 = 12;
const CAPTION: i64 = 24;

const WHITE: [u8; 3] = [255; 3];
const MATTER: [u8; 3] = [120; 3];
const INK: [u8; 3] = [30; 3];
const LEAK: [u8; 3] = [220, 30, 30];
const PASSAGE: [u8; 3] = [240, 140, 0];
/// Colours of heights, low to high.
const HEIGHTS: [[u8; 3]; 5] = [[68, 60, 140], [50, 110, 170], [40, 160, 140], [120, 200, 90], [250, 225, 60]];

struct Map {
    width: i64,
    height: i64,
    pixels: Vec<[u8; 3]>,
    /// First pixel of the region, pixels of the scan per pixel of the picture, and the inverse.
    first: [i64; 2],
    reduce: i64,
    enlarge: i64,
    panel: [i64; 2],
    panels: usize,
}

pub fn write(reach: &Reach, loader: &Loader, out: &mut Out) -> Result<(), Failure> {
    let mut map = Map::new(reach, loader)?;
    matter(&mut map, reach, loader)?;
    let frame = loader.archive().frame();
    let heights = reach.region.places().map(|place| place.feet.z);
    let (low, high) = heights.fold((f64::MAX, f64::MIN), |(low, high), z| (low.min(z), high.max(z)));
    for (place, storey) in reach.region.places().zip(&reach.storeys.of) {
        let share = if high > low { (place.feet.z - low) / (high - low) } else { 0.0 };
        let at = [frame.pixel_of(place.feet.x), frame.pixel_of(place.feet.y)];
        map.fill(usize::from(*storey), at, colour(share));
    }
    let storey_of = |at: Point3<f64>| {
        let far = |storey: &usize| (reach.storeys.all[*storey].z - at.z).abs();
        (0..reach.storeys.all.len()).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap_or(0)
    };
    let leaks = reach.leaks.iter().map(|leak| (leak.at, leak.width, LEAK));
    for (at, width, colour) in leaks.chain(reach.passages.iter().map(|passage| (passage.at, f64::INFINITY, PASSAGE))) {
        let pixel = [frame.pixel_of(at.x), frame.pixel_of(at.y)];
        map.dot(storey_of(at), pixel, width / 2.0 / frame.pixel_m(), colour);
    }
    let ways = reach.way.iter().flat_map(|way| way.points.windows(2));
    for pair in ways {
        let steps = ((pair[1] - pair[0]).xy().norm() / frame.pixel_m() * 8.0).ceil().max(1.0);
        for n in 0..=steps as usize {
            let at = pair[0] + (pair[1] - pair[0]) * (n as f64 / steps);
            map.pen(storey_of(at), [at.x / frame.pixel_m(), at.y / frame.pixel_m()]);
        }
    }
    for (number, storey) in reach.storeys.all.iter().enumerate() {
        let top = map.top(number);
        map.write([MARGIN, top - CAPTION + 6], &format!("z {:.2} m", storey.z));
    }
    map.bar(frame.pixel_m());
    let mut encoder = png::Encoder::new(out, map.width as u32, map.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(map.pixels.as_flattened())?;
    Ok(writer.finish()?)
}

/// Greys the pixels of each storey in which solid meets the body above its climb height.
fn matter(map: &mut Map, reach: &Reach, loader: &Loader) -> Result<(), Failure> {
    let archive = loader.archive();
    let (frame, pawn) = (archive.frame(), reach.region.pawn());
    let bands: Vec<[i64; 2]> = reach
        .storeys
        .all
        .iter()
        .map(|storey| [frame.quantum_floor(storey.z + pawn.climb), frame.quantum_floor(storey.z + pawn.body.height())])
        .collect();
    let broken = |error| crate::broken(loader.path(), &error);
    let view = loader.snapshot();
    let columns = (0..view.column_count()).map(|number| view.column_at(number));
    for (tx, ty, slot) in columns.flat_map(|(tx, ty, slots)| slots.iter().map(move |slot| (tx, ty, slot))) {
        crate::go_on()?;
        let base = i64::from(slot.layer()) * PAGE_QUANTA;
        let corner = [i64::from(tx) * TILE_PIXELS, i64::from(ty) * TILE_PIXELS];
        let is_near = bands.iter().any(|band| band[0] <= base + PAGE_QUANTA && band[1] >= base);
        if !is_near || !map.meets(corner) {
            continue;
        }
        // Pages with edits are in memory; the archive holds them as they were scanned.
        let read = match slot.page() {
            Some(_) => None,
            None => archive.find(PageKey { tx, ty, layer: slot.layer() }).map_err(broken)?,
        };
        let read = read.map(|entry| archive.page(&entry)).transpose().map_err(broken)?;
        let Some(page) = slot.page().or(read.as_ref()) else { continue };
        for (px, py, spans) in page.columns() {
            for (number, band) in bands.iter().enumerate() {
                let meets = |low: u32, high: u32| base + i64::from(low) <= band[1] && base + i64::from(high) >= band[0];
                if spans.iter().any(|span| meets(span.bottom(), span.top())) {
                    map.fill(number, [corner[0] + i64::from(px), corner[1] + i64::from(py)], MATTER);
                }
            }
        }
    }
    Ok(())
}

fn colour(share: f64) -> [u8; 3] {
    let at = share.clamp(0.0, 1.0) * (HEIGHTS.len() - 1) as f64;
    let low = (at as usize).min(HEIGHTS.len() - 2);
    let mix = |n: usize| {
        let [a, b] = [low, low + 1].map(|at| f64::from(HEIGHTS[at][n]));
        (a + (b - a) * (at - low as f64)).round() as u8
    };
    [mix(0), mix(1), mix(2)]
}

impl Map {
    fn new(reach: &Reach, loader: &Loader) -> Result<Self, Failure> {
        let frame = loader.archive().frame();
        let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
        // The start, too: nothing else is left of a region on ground that is too steep.
        for feet in reach.region.places().map(|place| place.feet).chain([reach.from.feet]) {
            for (axis, value) in [feet.x, feet.y].into_iter().enumerate() {
                let pixel = frame.pixel_of(value);
                (low[axis], high[axis]) = (low[axis].min(pixel), high[axis].max(pixel));
            }
        }
        // Margin for the surrounding walls.
        let wall = (0.6 / frame.pixel_m()).ceil() as i64;
        let size = [0, 1].map(|axis| high[axis] - low[axis] + 1 + 2 * wall);
        let longest = size[0].max(size[1]);
        let reduce = longest.div_euclid(MOST_WIDTH) + 1;
        let enlarge = if reduce > 1 { 1 } else { (WIDTH / size[0].max(1)).clamp(1, 16) };
        let panel = size.map(|pixels| (pixels / reduce + 1) * enlarge);
        let panels = reach.storeys.all.len().min(MOST_PANELS);
        let width = panel[0].max(200) + 2 * MARGIN;
        let height = (panel[1] + CAPTION + MARGIN) * panels as i64 + CAPTION + MARGIN;
        if width * height > MOST_PIXELS {
            let text = format!("the map would have {width} × {height} pixels; write .csv, .ply or .geojson instead");
            return Err(Failure::Text(text));
        }
        let pixels = vec![WHITE; (width * height) as usize];
        Ok(Self { width, height, pixels, first: low.map(|v| v - wall), reduce, enlarge, panel, panels })
    }

    /// Row of the picture at which the panel of a storey begins.
    fn top(&self, storey: usize) -> i64 {
        (self.panels - 1).saturating_sub(storey) as i64 * (self.panel[1] + CAPTION + MARGIN) + CAPTION
    }

    fn meets(&self, corner: [i64; 2]) -> bool {
        let last = |axis: usize| self.first[axis] + self.panel[axis] * self.reduce / self.enlarge;
        (0..2).all(|axis| corner[axis] + TILE_PIXELS > self.first[axis] && corner[axis] <= last(axis))
    }

    /// Upper left corner, in the picture, of a pixel of the scan.
    fn place(&self, storey: usize, at: [i64; 2]) -> Option<[i64; 2]> {
        let [x, y] = [0, 1].map(|axis| (at[axis] - self.first[axis]).div_euclid(self.reduce) * self.enlarge);
        let is_inside = storey < self.panels && (0..self.panel[0]).contains(&x) && (0..self.panel[1]).contains(&y);
        is_inside.then(|| [MARGIN + x, self.top(storey) + self.panel[1] - self.enlarge - y])
    }

    fn set(&mut self, [x, y]: [i64; 2], colour: [u8; 3]) {
        if (0..self.width).contains(&x) && (0..self.height).contains(&y) {
            self.pixels[(y * self.width + x) as usize] = colour;
        }
    }

    fn square(&mut self, [x, y]: [i64; 2], edge: i64, colour: [u8; 3]) {
        for (dx, dy) in (0..edge).flat_map(|dx| (0..edge).map(move |dy| (dx, dy))) {
            self.set([x + dx, y + dy], colour);
        }
    }

    fn fill(&mut self, storey: usize, at: [i64; 2], colour: [u8; 3]) {
        if let Some(place) = self.place(storey, at) {
            self.square(place, self.enlarge, colour);
        }
    }

    /// Draws a round dot in a pixel of the scan, as large as `radius` (pixels of the scan) but always to be seen.
    fn dot(&mut self, storey: usize, at: [i64; 2], radius: f64, colour: [u8; 3]) {
        let Some([x, y]) = self.place(storey, at) else { return };
        let half = self.enlarge / 2;
        let radius = (radius * self.enlarge as f64 / self.reduce as f64).clamp(2.3, 5.5);
        for (dx, dy) in (-6i64..=6).flat_map(|dx| (-6i64..=6).map(move |dy| (dx, dy))) {
            if (dx * dx + dy * dy) as f64 <= radius * radius {
                self.set([x + half + dx, y + half + dy], colour);
            }
        }
    }

    /// Draws a dot of a line at a position (pixels of the scan).
    fn pen(&mut self, storey: usize, at: [f64; 2]) {
        let Some(corner) = self.place(storey, at.map(|v| v.floor() as i64)) else { return };
        let within = at.map(|v| (v - v.floor()) * self.enlarge as f64);
        // Rows of the picture count downwards.
        let [x, y] = [corner[0] + within[0] as i64, corner[1] + self.enlarge - 1 - within[1] as i64];
        for (dx, dy) in (-2i64..=2).flat_map(|dx| (-2i64..=2).map(move |dy| (dx, dy))) {
            if dx * dx + dy * dy <= 5 {
                self.set([x + dx, y + dy], INK);
            }
        }
    }

    /// Draws a bar of a round length, at most a third of the map wide.
    fn bar(&mut self, pixel_m: f64) {
        let metre = self.enlarge as f64 / (self.reduce as f64 * pixel_m);
        let most = self.panel[0].max(200) as f64 / 3.0 / metre;
        let length = round_length(most);
        let (row, end) = (self.height - MARGIN - 8, (length * metre).round() as i64);
        for x in 0..=end {
            for y in 0..3 {
                self.set([MARGIN + x, row + y], INK);
            }
        }
        for y in -4..7 {
            self.set([MARGIN, row + y], INK);
            self.set([MARGIN + end, row + y], INK);
        }
        self.write([MARGIN + end + 8, row - 6], &format!("{length} m"));
    }

    /// Draws a text of digits.
    fn write(&mut self, [x, y]: [i64; 2], text: &str) {
        figures(text, |dx, dy| self.set([x + dx, y + dy], INK));
    }
}
