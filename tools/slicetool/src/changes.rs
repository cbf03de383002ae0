//! Changes from one archive to another: `slicetool diff --changes`.
//!
//! Memory: the solid of a few hundred pages of each archive, 32 KiB each, and the seen space of the second.

use crate::diff::{Named, each_pair, voxel};
use crate::export::Ply;
use crate::ground::stored_seen;
use crate::{Failure, say};
use slicewalk::Parameter;
use slicewalk::archive::{Archive, PageEntry, PageReader};
use slicewalk::frame::{Frame, PAGE_SLICES, PageKey, SLICE_QUANTA, TILE_PIXELS};
use slicewalk::nalgebra::Point3;
use slicewalk::page::{Inferred, Page};
use slicewalk_base::output::{Output, is_standard};
use slicewalk_base::text::rounded;
use std::collections::{HashMap, VecDeque};
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::Path;
use std::rc::Rc;

/// Pages of each archive whose solid is kept for their neighbours.
const KEPT_PAGES: usize = 256;
/// Most memory for seen space (bytes).
const MOST_SEEN_BYTES: u64 = 1 << 30;
/// Farthest solid that keeps a voxel from being a change (pixels, and slices): it lies in a neighbouring page at most.
const MOST_CELLS: f64 = 64.0;
const PIXELS: usize = 64 * 64;

/// Kind of a change; its number is the index in [`COLOURS`] and in files.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Change {
    New,
    Gone,
    NotSeen,
}

/// Colours and names of changes.
const COLOURS: [[u8; 3]; 3] = [[40, 180, 60], [220, 40, 40], [128; 3]];
const NAMES: [&str; 3] = ["new", "gone", "not_seen"];

/// Numbers of voxels by change, in the order of [`NAMES`].
pub type Counts = [u64; 3];

/// File that changes are written to.
enum File {
    Csv(BufWriter<Output>),
    Ply(Ply),
}

impl File {
    /// Begins the file; its extension selects the format.
    fn begin(path: &Path, archive: &Archive, also: &Path) -> Result<Self, Failure> {
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
        let begin = || crate::output(path, archive, &[also]);
        match ending.as_str() {
            "ply" => Ok(Self::Ply(Ply::begin(begin()?, "comment change: 0 new, 1 gone, 2 not seen", &["change"])?)),
            "csv" => Self::csv(begin()?),
            _ if is_standard(path) => Self::csv(begin()?),
            _ => Err(Failure::Text(format!("{}: unknown format; name the file .ply or .csv", path.display()))),
        }
    }

    fn csv(output: Output) -> Result<Self, Failure> {
        let mut file = BufWriter::new(output);
        writeln!(file, "x,y,z,change")?;
        Ok(Self::Csv(file))
    }

    fn put(&mut self, at: [f64; 3], change: Change, step_m: f64) -> Result<(), Failure> {
        let number = change as usize;
        match self {
            Self::Csv(file) => {
                let [x, y, z] = at.map(|value| rounded(value, step_m));
                writeln!(file, "{x},{y},{z},{}", NAMES[number])?;
            }
            Self::Ply(ply) => ply.put(at, COLOURS[number], &[number as u8])?,
        }
        Ok(())
    }

    fn finish(self) -> Result<(), Failure> {
        match self {
            Self::Csv(file) => {
                file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
            }
            Self::Ply(ply) => {
                ply.finish()?;
            }
        }
        Ok(())
    }
}

/// Distance within which solid of the other archive keeps a voxel from being a change.
#[derive(Clone, Copy)]
struct Reach {
    pixels: usize,
    slices: u32,
}

impl Reach {
    /// Rounds up to whole pixels and slices; the default is a pixel.
    fn new(within_m: Option<f64>, frame: &Frame) -> Result<Self, Failure> {
        // A little less, because 0.3 / 0.1 is more than 3.
        let cells = |size_m: f64| (within_m.unwrap_or(frame.pixel_m()) / size_m - 1e-9).ceil().max(0.0);
        let (pixels, slices) = (cells(frame.pixel_m()), cells(frame.slice_m()));
        if pixels > MOST_CELLS || slices > MOST_CELLS {
            let most = MOST_CELLS * frame.pixel_m().min(frame.slice_m());
            return Err(Failure::Usage(format!("--within: at most {} m on this grid", rounded(most, most / 1e6))));
        }
        Ok(Self { pixels: pixels as usize, slices: slices as u32 })
    }
}

/// Occupied slices of each pixel of a page, as masks.
type Masks = Rc<[u64]>;

/// Solid of an archive around the page in question.
struct Solid<'a> {
    named: Named<'a>,
    kept: HashMap<PageKey, Option<Masks>>,
    /// Oldest first.
    order: VecDeque<PageKey>,
}

/// Returns the occupied slices of a pixel, without those of the spans in `left_out`.
fn mask(page: &Page, px: u32, py: u32, left_out: u64) -> u64 {
    let spans = page.column(px, py).iter().enumerate().filter(|(at, _)| left_out >> (at & 63) & 1 == 0);
    spans.fold(0, |mask, (_, span)| mask | span.slice_mask())
}

impl<'a> Solid<'a> {
    fn new(named: Named<'a>) -> Self {
        Self { named, kept: HashMap::new(), order: VecDeque::new() }
    }

    fn masks(&mut self, key: PageKey) -> Result<Option<Masks>, Failure> {
        if let Some(found) = self.kept.get(&key) {
            return Ok(found.clone());
        }
        let (archive, path) = self.named;
        let read = || {
            let Some(entry) = archive.find(key)? else { return Ok(None) };
            let page = archive.page(&entry)?;
            Ok(Some((0..PIXELS as u32).map(|pixel| mask(&page, pixel & 63, pixel >> 6, 0)).collect()))
        };
        let found: Option<Masks> = read().map_err(|error| crate::broken(path, &error))?;
        self.kept.insert(key, found.clone());
        self.order.push_back(key);
        if self.order.len() > KEPT_PAGES
            && let Some(oldest) = self.order.pop_front()
        {
            self.kept.remove(&oldest);
        }
        Ok(found)
    }

    /// Returns, for each pixel of page `key`, the slices with solid within `reach` of them. What is returned is right for
    /// the voxels of `page` alone, so that few pages need be read.
    fn near(&mut self, key: PageKey, page: &Page, reach: Reach) -> Result<Vec<u64>, Failure> {
        let Some(bounds) = page.bounds() else { return Ok(vec![0; PIXELS]) };
        let (edge, by) = (TILE_PIXELS as usize, reach.pixels);
        let neighbours = |axis: usize, size: u32, reach: u32| {
            let (low, high) = (bounds.min[axis] / size, bounds.max[axis] / size);
            -i32::from(low < reach)..=i32::from(high + reach >= TILE_PIXELS as u32)
        };
        let across = |axis: usize| neighbours(axis, 1, by as u32);
        // A top on the boundary of slices counts as that of the upper one here, which reads a page in vain at most.
        let layers = neighbours(2, SLICE_QUANTA as u32, reach.slices);
        // The page with a border as wide as the reach.
        let width = edge + 2 * by;
        let mut wide = vec![0; width * width];
        for dy in across(1) {
            for dx in across(0) {
                let mut column: [Option<Masks>; 3] = [None, None, None];
                for dl in layers.clone() {
                    let beside = [key.tx.checked_add(dx), key.ty.checked_add(dy), key.layer.checked_add(dl)];
                    if let [Some(tx), Some(ty), Some(layer)] = beside {
                        column[(dl + 1) as usize] = self.masks(PageKey { tx, ty, layer })?;
                    }
                }
                if column.iter().all(Option::is_none) {
                    continue;
                }
                let range = |d: i32| match d {
                    -1 => (edge - by, edge),
                    0 => (0, edge),
                    _ => (0, by),
                };
                // Where the neighbour begins in the wide page, plus an edge.
                let start = |d: i32| ((d + 1) as usize) * edge + by;
                let (xs, ys) = (range(dx), range(dy));
                for y in ys.0..ys.1 {
                    for x in xs.0..xs.1 {
                        let of = |masks: &Option<Masks>| masks.as_ref().map_or(0, |masks| masks[y * edge + x]);
                        let place = (start(dy) + y - edge) * width + start(dx) + x - edge;
                        wide[place] = spread(column.each_ref().map(of), reach.slices);
                    }
                }
            }
        }
        let mut rows = vec![0; width * edge];
        for y in 0..width {
            for x in 0..edge {
                rows[y * edge + x] = wide[y * width + x..][..2 * by + 1].iter().fold(0, |all, mask| all | mask);
            }
        }
        let mut near = vec![0; PIXELS];
        for y in 0..edge {
            for x in 0..edge {
                near[y * edge + x] = (y..=y + 2 * by).fold(0, |all, y| all | rows[y * edge + x]);
            }
        }
        Ok(near)
    }
}

/// Returns the slices of a page within `by` (up to 64) of the occupied ones of the pages below, at, and above it.
fn spread([below, at, above]: [u64; 3], by: u32) -> u64 {
    let shifted = |by: u32| at.checked_shl(by).unwrap_or(0) | at.checked_shr(by).unwrap_or(0);
    (1..=by).fold(at, |all, by| all | shifted(by) | below >> (64 - by) | above << (64 - by))
}

/// Writes what is new in `b`, what is gone, and what was not seen, to `path`. Returns the number of voxels of each.
///
/// A voxel with scanned solid in one archive is a change if the other one has no solid within `within_m` (a pixel by
/// default), rounded up to whole pixels and slices.
pub fn write(a: Named<'_>, b: Named<'_>, path: &Path, within_m: Option<f64>) -> Result<Counts, Failure> {
    for (archive, path) in [a, b] {
        crate::export::check_count(archive, path)?;
    }
    let frame = *a.0.frame();
    let reach = Reach::new(within_m, &frame)?;
    let mut file = File::begin(path, a.0, b.1)?;
    let seen = stored_seen(b.0, b.1, MOST_SEEN_BYTES, Parameter::Bounds)?;
    if seen.is_none() {
        let name = b.1.display();
        say(&format!("{name}: it does not say which space was seen, so what was not scanned counts as gone"));
    }
    let sides = [a, b];
    let (mut solid, mut readers) = (sides.map(Solid::new), sides.map(|(archive, _)| PageReader::new(archive)));
    let mut counts = Counts::default();
    each_pair(a, b, |key, entries: [Option<PageEntry>; 2]| {
        let mut pages: [Option<(Page, Inferred)>; 2] = [None, None];
        for (side, page) in pages.iter_mut().enumerate() {
            if let Some(entry) = &entries[side] {
                let read =
                    readers[side].page_and_inferred(entry).map_err(|error| crate::broken(sides[side].1, &error))?;
                *page = Some((read.0.clone(), read.1.clone()));
            }
        }
        if let [Some((a, _)), Some((b, _))] = &pages
            && a == b
        {
            return Ok(());
        }
        let mut changed = [const { Vec::new() }; 2];
        for (side, changed) in changed.iter_mut().enumerate() {
            let Some((page, inferred)) = &pages[side] else { continue };
            let near = solid[1 - side].near(key, page, reach)?;
            *changed = (0..PIXELS as u32)
                .map(|pixel| {
                    let (px, py) = (pixel & 63, pixel >> 6);
                    mask(page, px, py, inferred.of(px, py)) & !near[pixel as usize]
                })
                .collect();
        }
        for pixel in 0..PIXELS {
            let masks = changed.each_ref().map(|changed| changed.get(pixel).copied().unwrap_or(0));
            let mut rest = masks[0] | masks[1];
            while rest != 0 {
                let k = rest.trailing_zeros();
                rest &= rest - 1;
                let side = usize::from(masks[1] >> k & 1 == 1);
                let (px, py) = (pixel as u32 & 63, pixel as u32 >> 6);
                let found = pages[side].as_ref().and_then(|(page, _)| voxel(page.column(px, py), k));
                let Some((bottom, top, _)) = found else { continue };
                let at = middle(&frame, key, [px, py, k], (bottom, top));
                let change = match (side, &seen) {
                    (1, _) => Change::New,
                    (_, Some(seen)) if !seen.is_seen(Point3::from(at)) => Change::NotSeen,
                    _ => Change::Gone,
                };
                counts[change as usize] += 1;
                file.put(at, change, frame.quantum_m() / 10.0)?;
            }
        }
        Ok(())
    })?;
    file.finish()?;
    Ok(counts)
}

/// Returns the middle of the solid in a voxel (m); `bottom` and `top` are quanta above the floor of its slice.
fn middle(frame: &Frame, key: PageKey, [px, py, k]: [u32; 3], (bottom, top): (u8, u8)) -> [f64; 3] {
    let pixel = |tile: i32, at: u32| (f64::from(tile) * TILE_PIXELS as f64 + f64::from(at) + 0.5) * frame.pixel_m();
    let floor = frame.bottom_of_slice(i64::from(key.layer) * PAGE_SLICES + i64::from(k));
    let z = floor + (f64::from(bottom) + f64::from(top)) / 2.0 * frame.quantum_m();
    [pixel(key.tx, px), pixel(key.ty, py), z]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solid_spreads_over_the_ends_of_a_page() {
        let bit = |at: u32| 1u64 << at;
        assert_eq!(spread([bit(63), bit(5), bit(0)], 0), bit(5));
        assert_eq!(spread([bit(63), bit(5), bit(0)], 1), bit(0) | bit(4) | bit(5) | bit(6) | bit(63));
        assert_eq!(spread([bit(62), 0, bit(1)], 2), bit(0) | bit(63));
        assert_eq!(spread([bit(0), 0, 0], 64), bit(0));
        assert_eq!(spread([0, 0, bit(63)], 64), bit(63));
        assert_eq!(spread([0, bit(63), 0], 64), u64::MAX);
    }
}
