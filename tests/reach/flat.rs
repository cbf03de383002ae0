//! Flat worlds of floor, walls and gaps, drawn as text.

use crate::common::{key, page};
use slicewalk::frame::{Frame, PAGE_QUANTA};
use slicewalk::page::Span;
use slicewalk::store::Snapshot;
use std::collections::{BTreeMap, HashMap};

/// Pixel size (m).
pub const T: f64 = 0.1;

/// A world of pixels: `.` floor at 0, `#` wall, `-` a floor 1 m lower, blank nothing; the first row is the highest in
/// y.
pub fn world(rows: &[String]) -> Snapshot {
    let mut columns = Vec::new();
    for (j, row) in (0..).zip(rows.iter().rev()) {
        for (i, pixel) in (0..).zip(row.bytes()) {
            let zero = 10 * 255;
            let span = match pixel {
                b'.' => Span::new(zero - 3, zero, false),
                b'#' => Span::new(zero - 3, zero + 9 * 255, true),
                b'-' => Span::new(zero - 853, zero - 850, false),
                _ => continue,
            };
            columns.push(((i, j), vec![span.unwrap()]));
        }
    }
    store(Frame::new(T, 0.3).unwrap(), columns)
}

/// Pages of spans by pixel, all of layer 0.
pub fn store(frame: Frame, columns: impl IntoIterator<Item = ((i64, i64), Vec<Span>)>) -> Snapshot {
    let mut tiles: BTreeMap<(i32, i32), Vec<_>> = BTreeMap::new();
    for ((i, j), spans) in columns {
        let tile = ((i >> 6) as i32, (j >> 6) as i32);
        tiles.entry(tile).or_default().push((((i & 63) as u32, (j & 63) as u32), spans));
    }
    Snapshot::from_pages(frame, tiles.into_iter().map(|((tx, ty), columns)| (key(tx, ty, 0), page(columns))))
}

/// Spans of pixels: bottom and top above layer 0 (quanta), and whether they are obstacles.
pub type Columns = HashMap<(i64, i64), Vec<(i64, i64, bool)>>;

/// Pages of `columns`, as high as they reach; a span over the border of two pages is split there.
pub fn layers(frame: Frame, columns: &Columns) -> Snapshot {
    let mut pages: BTreeMap<_, BTreeMap<(u32, u32), Vec<Span>>> = BTreeMap::new();
    for (&(i, j), spans) in columns {
        let (tx, ty, pixel) = ((i >> 6) as i32, (j >> 6) as i32, ((i & 63) as u32, (j & 63) as u32));
        for &(bottom, top, is_obstacle) in spans {
            for layer in bottom / PAGE_QUANTA..=(top - 1).max(bottom) / PAGE_QUANTA {
                let [low, high] = [bottom, top].map(|z| (z - layer * PAGE_QUANTA).clamp(0, PAGE_QUANTA) as u32);
                let span = Span::new(low, high, is_obstacle).unwrap();
                pages.entry((tx, ty, layer as i32)).or_default().entry(pixel).or_default().push(span);
            }
        }
    }
    Snapshot::from_pages(frame, pages.into_iter().map(|((tx, ty, layer), columns)| (key(tx, ty, layer), page(columns))))
}

/// Height of the floor (m).
pub const FLOOR: f64 = 3.0;

/// A room of `width` × `depth` pixels, including walls; `draw` changes pixels by column and row (from below).
pub fn room(width: usize, depth: usize, draw: impl Fn(usize, usize) -> Option<u8>) -> Snapshot {
    let pixel = |i: usize, j: usize| {
        let is_wall = i == 0 || j == 0 || i + 1 == width || j + 1 == depth;
        draw(i, j).unwrap_or(if is_wall { b'#' } else { b'.' }) as char
    };
    let rows: Vec<String> = (0..depth).rev().map(|j| (0..width).map(|i| pixel(i, j)).collect()).collect();
    world(&rows)
}
