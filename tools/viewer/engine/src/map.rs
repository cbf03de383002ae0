//! A plan of one storey: floor and obstacles between two heights, from above.

use crate::fault::invalid;
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use slicewalk::store::{PageSlot, Snapshot};

/// Most cells along an edge.
const LONGEST: u32 = 1024;
const FLOOR: u8 = 1;
const OBSTACLE: u8 = 2;
const NOT_LOADED: u8 = 3;

/// Draws at most `cells × cells` cells over `area` (minimum x and y, maximum x and y) between two heights (m). Out:
/// width, height, edge of a cell (m), then the cells row by row from the greatest y down.
pub(crate) fn map(
    set: &Snapshot,
    area: [f64; 4],
    heights: [f64; 2],
    cells: u32,
) -> Result<(u32, u32, f64, Vec<u8>), String> {
    let [x0, y0, x1, y1] = area;
    let fits = area.iter().chain(&heights).all(|v| v.is_finite()) && x0 < x1 && y0 < y1 && heights[0] <= heights[1];
    if !fits {
        return Err(invalid(format_args!(
            "no map lies between ({x0}, {y0}) and ({x1}, {y1}) at {} to {}",
            heights[0], heights[1]
        )));
    }
    let cells = cells.clamp(1, LONGEST);
    let frame = *set.frame();
    let cell = ((x1 - x0).max(y1 - y0) / f64::from(cells)).max(frame.pixel_m());
    let size = |length: f64| (length / cell).ceil().clamp(1.0, f64::from(LONGEST)) as u32;
    let (width, height) = (size(x1 - x0), size(y1 - y0));
    let mut out = vec![0u8; (width * height) as usize];
    let (low, high) = (frame.quantum_floor(heights[0]), frame.quantum_ceil(heights[1]));
    let tile_m = frame.pixel_m() * TILE_PIXELS as f64;
    let mut put = |x: f64, y: f64, edge: f64, value: u8| {
        let span = |from: f64, least: f64, count: u32| {
            let first = ((from - least) / cell).floor().max(0.0);
            let last = ((from + edge - least) / cell).ceil().min(f64::from(count));
            first as u32..last.max(first) as u32
        };
        for row in span(y, y0, height) {
            for column in span(x, x0, width) {
                let at = &mut out[((height - 1 - row) * width + column) as usize];
                *at = (*at).max(value);
            }
        }
    };
    for (tx, ty, slots) in columns(set, area) {
        let corner = [f64::from(tx) * tile_m, f64::from(ty) * tile_m];
        for slot in slots {
            let base = i64::from(slot.layer()) * PAGE_QUANTA;
            if base > high || base + PAGE_QUANTA < low {
                continue;
            }
            let Some(page) = slot.page() else {
                let first = (low - base).max(0) / 255;
                let last = ((high - base).min(PAGE_QUANTA - 1) / 255).min(63);
                if first <= last && slot.slices() >> first << first << (63 - last) != 0 {
                    put(corner[0], corner[1], tile_m, NOT_LOADED);
                }
                continue;
            };
            for (px, py, spans) in page.columns() {
                let within =
                    spans.iter().filter(|s| base + i64::from(s.bottom()) <= high && base + i64::from(s.top()) >= low);
                let kind = within.map(|span| if span.is_obstacle() { OBSTACLE } else { FLOOR }).max();
                if let Some(kind) = kind {
                    let pixel = frame.pixel_m();
                    put(corner[0] + f64::from(px) * pixel, corner[1] + f64::from(py) * pixel, pixel * 0.999, kind);
                }
            }
        }
    }
    Ok((width, height, cell, out))
}

/// Iterates over the tile columns of `set` that an area (minimum x and y, maximum x and y; m) touches.
pub(crate) fn columns(set: &Snapshot, [x0, y0, x1, y1]: [f64; 4]) -> impl Iterator<Item = (i32, i32, &[PageSlot])> {
    let frame = *set.frame();
    let tile = move |x: f64| frame.pixel_of(x).div_euclid(TILE_PIXELS);
    // Without pages, an empty range.
    let bounds = set.bounds().map_or([0, 0, -1, -1], |keys| [keys.min[0], keys.min[1], keys.max[0], keys.max[1]]);
    let bounds = bounds.map(i64::from);
    let (tx, ty) =
        (tile(x0).max(bounds[0])..=tile(x1).min(bounds[2]), tile(y0).max(bounds[1])..=tile(y1).min(bounds[3]));
    let count = |range: &std::ops::RangeInclusive<i64>| (range.end() - range.start() + 1).max(0) as u128;
    let few = count(&tx) * count(&ty) <= 4 * set.column_count() as u128;
    let by_place = few.then(|| {
        let (tx, ty) = (tx.clone(), ty.clone());
        ty.flat_map(move |ty| tx.clone().map(move |tx| (tx as i32, ty as i32)))
            .map(|(tx, ty)| (tx, ty, set.column(tx, ty)))
            .filter(|(_, _, slots)| !slots.is_empty())
    });
    let by_number = (!few).then(|| {
        let inside = move |x: i32, y: i32| tx.contains(&i64::from(x)) && ty.contains(&i64::from(y));
        (0..set.column_count()).map(|number| set.column_at(number)).filter(move |&(x, y, _)| inside(x, y))
    });
    by_place.into_iter().flatten().chain(by_number.into_iter().flatten())
}
