//! Statistics of an archive: its parts, and its tiles by the simplest model that describes them.
//!
//! Pages hold spans, so a tile (one slice of a page) is not stored separately; its [`Need`] says what it adds to its
//! page. Tiles in which no span begins or ends add nothing: they are like the slice below.

use crate::archive::{Archive, PageEntry, PageReader, Storage};
use crate::frame::{PAGE_SLICES, SLICE_QUANTA};
use crate::page::{Inferred, Page};
use crate::{Error, Result};
use std::collections::HashMap;

/// Storage need of a tile, least first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Need {
    /// The page is one span in all pixels: an entry of the directory.
    Uniform,
    /// The page has the bytes of an earlier one: an entry of the directory.
    Shared,
    /// Everything solid continues from the slice below into the slice above: nothing.
    LikeBelow,
    /// All bottoms in the tile have one height, and all tops: one number each.
    Level,
    /// All bottoms lie in one plane, and all tops.
    Plane,
    /// Individual heights.
    Heights,
}

impl Need {
    /// All needs, least first.
    pub const ALL: [Self; 6] = [Self::Uniform, Self::Shared, Self::LikeBelow, Self::Level, Self::Plane, Self::Heights];

    /// Returns the name that `slicetool stats` prints.
    pub fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Shared => "shared",
            Self::LikeBelow => "like_below",
            Self::Level => "level",
            Self::Plane => "plane",
            Self::Heights => "heights",
        }
    }

    /// Returns whether the tile costs neither bytes nor a read of its own.
    pub fn is_free(self) -> bool {
        self <= Self::LikeBelow
    }
}

/// Counts over an archive.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Stats {
    /// Stored, shared and uniform pages.
    pub pages: [u64; 3],
    /// Tiles in stored, shared and uniform pages.
    pub tiles: [u64; 3],
    /// Tiles by need, in the order of [`Need::ALL`].
    pub needs: [u64; 6],
    /// Tiles by need that hold an obstacle.
    pub wall_needs: [u64; 6],
    /// Slices in which some tile is not like the one below.
    pub distinct_slices: u64,
    /// Pixels of pages that hold a span.
    pub columns: u64,
    /// Such pixels by their number of spans: 1, 2, 3, 4, more.
    pub columns_by_spans: [u64; 5],
    /// Spans.
    pub spans: u64,
    /// Obstacle spans.
    pub obstacle_spans: u64,
    /// Occupied voxels.
    pub voxels: u64,
    /// Voxels with an obstacle.
    pub obstacle_voxels: u64,
    /// Inferred spans: floor that closes holes of the scan.
    pub inferred_spans: u64,
    /// Voxels with inferred spans only.
    pub inferred_voxels: u64,
    /// Voxels inside a span, where no height is stored.
    pub inner_voxels: u64,
    /// Memory of all pages when resident (bytes).
    pub memory_bytes: u64,
}

/// Most page contents whose counts are cached, in case the content repeats.
const KEPT: usize = 1 << 12;

impl Stats {
    /// Reads and counts all pages of `archive`. Cost: one pass over the file. Memory: 16 bytes for each occupied layer
    /// of 64 slices, of which there may be at most 2²⁰.
    pub fn of(archive: &Archive) -> Result<Self> {
        let mut stats = Self::default();
        let mut pages = PageReader::new(archive);
        let mut counter = TileCounter::new(archive.plan().tolerance_quanta());
        let mut layers = Layers::default();
        let mut known = HashMap::new();
        for entry in archive.entries() {
            let entry = entry?;
            // A stored page has other needs than the pages that share its bytes, so its counts are not cached.
            let again = (!matches!(entry.storage, Storage::Stored(_))).then(|| entry.content());
            let page = match again.and_then(|content| known.get(&content)) {
                Some(page) => *page,
                None => PageStats::of(pages.page_and_inferred(&entry)?, &entry, &mut counter),
            };
            if let Some(content) = again.filter(|content| !known.contains_key(content)) {
                if known.len() == KEPT {
                    known.clear();
                }
                known.insert(content, page);
            }
            stats.add(&entry, &page);
            layers.add(entry.key.layer, page.own_slices)?;
        }
        stats.distinct_slices = layers.slices()?;
        Ok(stats)
    }

    fn add(&mut self, entry: &PageEntry, page: &PageStats) {
        let kind = match entry.storage {
            Storage::Stored(_) => 0,
            Storage::Shared(_) => 1,
            Storage::Uniform(_) => 2,
        };
        self.pages[kind] += 1;
        self.tiles[kind] += u64::from(entry.slices.count_ones());
        self.memory_bytes += page.memory_bytes;
        self.voxels += page.voxels.0;
        self.obstacle_voxels += page.voxels.1;
        self.columns += page.columns_by_spans.iter().sum::<u64>();
        self.spans += page.spans;
        self.obstacle_spans += page.obstacle_spans;
        self.inferred_spans += page.inferred.0;
        self.inferred_voxels += page.inferred.1;
        self.inner_voxels += page.inner_voxels;
        let sums = [&mut self.columns_by_spans[..], &mut self.needs, &mut self.wall_needs];
        for (sums, counts) in sums.into_iter().zip([&page.columns_by_spans[..], &page.needs, &page.wall_needs]) {
            sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
        }
    }
}

/// Counts of one page.
#[derive(Debug, Clone, Copy, Default)]
struct PageStats {
    needs: [u64; 6],
    wall_needs: [u64; 6],
    /// Slices that are not like the one below, one bit each.
    own_slices: u64,
    columns_by_spans: [u64; 5],
    spans: u64,
    obstacle_spans: u64,
    voxels: (u64, u64),
    /// Inferred spans and voxels.
    inferred: (u64, u64),
    inner_voxels: u64,
    memory_bytes: u64,
}

impl PageStats {
    fn of((page, inferred): (&Page, &Inferred), entry: &PageEntry, counter: &mut TileCounter) -> Self {
        let memory_bytes = page.weight_bytes() as u64;
        let inferred = (inferred.span_count(), inferred.voxel_count(page));
        let mut stats = Self { voxels: page.voxel_counts(), inferred, memory_bytes, ..Self::default() };
        for (_, _, spans) in page.columns() {
            stats.columns_by_spans[spans.len().min(5) - 1] += 1;
            for span in spans {
                stats.spans += 1;
                stats.obstacle_spans += u64::from(span.is_obstacle());
                let (first, last) = span.slices();
                stats.inner_voxels += u64::from((last - first).saturating_sub(1));
            }
        }
        for (slice, need, wall) in counter.count(entry, page) {
            stats.needs[need as usize] += 1;
            stats.wall_needs[need as usize] += u64::from(wall);
            stats.own_slices |= u64::from(need != Need::LikeBelow) << slice;
        }
        stats
    }
}

/// Set of slices, by layers of 64.
#[derive(Debug, Default)]
struct Layers(Vec<(i32, u64)>);

impl Layers {
    /// Most layers in the set.
    const MOST: usize = 1 << 20;

    fn add(&mut self, layer: i32, slices: u64) -> Result<()> {
        match self.0.last_mut().filter(|last| last.0 == layer) {
            Some(last) => last.1 |= slices,
            None => {
                if self.0.len() == 2 * Self::MOST {
                    self.join()?;
                }
                self.0.push((layer, slices));
            }
        }
        Ok(())
    }

    /// Merges the entries of each layer.
    fn join(&mut self) -> Result<()> {
        self.0.sort_unstable_by_key(|&(layer, _)| layer);
        self.0.dedup_by(|other, kept| {
            let same = other.0 == kept.0;
            kept.1 |= if same { other.1 } else { 0 };
            same
        });
        if self.0.len() > Self::MOST {
            let what = "occupied layers of 64 slices (cut out a region with slicetool extract)";
            return Err(Error::limit(what, "more", Self::MOST));
        }
        Ok(())
    }

    /// Returns the number of slices.
    fn slices(mut self) -> Result<u64> {
        self.join()?;
        Ok(self.0.iter().map(|(_, slices)| u64::from(slices.count_ones())).sum())
    }
}

/// Bottoms or tops in a tile, to which a plane is fitted: pixel and height (quanta).
type Heights = Vec<[f64; 3]>;

/// Counter of the needs of a page's tiles; reuses its scratch memory.
struct TileCounter {
    /// Greatest distance of heights from a plane (quanta): their rounding, and the tolerance.
    off: f64,
    bottoms: Vec<Heights>,
    tops: Vec<Heights>,
}

impl TileCounter {
    fn new(tolerance: u32) -> Self {
        let off = f64::from(1 + tolerance);
        Self { off, bottoms: vec![Vec::new(); PAGE_SLICES as usize], tops: vec![Vec::new(); PAGE_SLICES as usize] }
    }

    /// Returns for each tile of `page` its slice in the page, its need, and whether it holds an obstacle.
    fn count(&mut self, entry: &PageEntry, page: &Page) -> Vec<(u32, Need, bool)> {
        self.bottoms.iter_mut().chain(&mut self.tops).for_each(Vec::clear);
        let mut walls = 0u64;
        let page_top = (PAGE_SLICES * SLICE_QUANTA) as u32;
        for (px, py, spans) in page.columns() {
            for span in spans {
                let (first, last) = span.slices();
                walls |= if span.is_obstacle() { span.slice_mask() } else { 0 };
                let at = |height: u32| [f64::from(px), f64::from(py), f64::from(height)];
                // Ends at the page's own floor and ceiling are cuts: the span may continue in the next page.
                if span.bottom() > 0 {
                    self.bottoms[first as usize].push(at(span.bottom()));
                }
                if span.top() < page_top {
                    self.tops[last as usize].push(at(span.top()));
                }
            }
        }
        let slices = (0..PAGE_SLICES as u32).filter(|slice| entry.slices >> slice & 1 == 1);
        let need = |slice: u32| match entry.storage {
            Storage::Uniform(_) => Need::Uniform,
            Storage::Shared(_) => Need::Shared,
            Storage::Stored(_) => {
                let ends = [&self.bottoms[slice as usize], &self.tops[slice as usize]];
                if ends.iter().all(|heights| heights.is_empty()) {
                    Need::LikeBelow
                } else if ends.iter().all(|heights| is_level(heights, self.off)) {
                    Need::Level
                } else if ends.iter().all(|heights| is_plane(heights, self.off)) {
                    Need::Plane
                } else {
                    Need::Heights
                }
            }
        };
        slices.map(|slice| (slice, need(slice), walls >> slice & 1 == 1)).collect()
    }
}

fn is_level(heights: &[[f64; 3]], off: f64) -> bool {
    let (low, high) = heights.iter().fold((f64::MAX, f64::MIN), |(low, high), h| (low.min(h[2]), high.max(h[2])));
    high - low <= 2.0 * off
}

/// Returns whether the least-squares plane lies within `off` of all heights.
fn is_plane(heights: &[[f64; 3]], off: f64) -> bool {
    let n = heights.len() as f64;
    let mean = [0, 1, 2].map(|axis| heights.iter().map(|h| h[axis]).sum::<f64>() / n.max(1.0));
    let moment = |a: usize, b: usize| heights.iter().map(|h| (h[a] - mean[a]) * (h[b] - mean[b])).sum::<f64>();
    let (xx, xy, yy, xz, yz) = (moment(0, 0), moment(0, 1), moment(1, 1), moment(0, 2), moment(1, 2));
    let determinant = xx * yy - xy * xy;
    let (dx, dy) = if determinant.abs() > 1e-9 * (xx * yy).max(1.0) {
        ((xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant)
    } else if xx + yy > 0.0 {
        // All pixels on one line: the plane through the line's fit that is level across it.
        (xz / (xx + yy), yz / (xx + yy))
    } else {
        (0.0, 0.0)
    };
    heights.iter().all(|h| (h[2] - mean[2] - dx * (h[0] - mean[0]) - dy * (h[1] - mean[1])).abs() <= off)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::{ArchiveWriter, Extent, PageEncoder, Totals};
    use crate::frame::{Frame, PageKey};
    use crate::page::{PageBuilder, Span};
    use crate::plan::Plan;

    /// A page with these spans in one pixel.
    fn page(spans: &[Span]) -> Page {
        let mut page = PageBuilder::default();
        assert!(page.set_column(10, 20, spans));
        page.build()
    }

    #[test]
    fn ends_at_the_floor_and_the_ceiling_of_a_page_need_nothing() {
        let page = page(&[Span::new(0, 300, true).unwrap(), Span::new(700, 16_320, false).unwrap()]);
        let storage = Storage::Stored(Extent { offset: 0, len: 1, crc: 0 });
        let key = PageKey { tx: 0, ty: 0, layer: 0 };
        let entry = PageEntry { key, slices: page.slices(), size: page.size(), storage };
        let expected: Vec<_> = (0..64)
            .map(|slice| match slice {
                0 => (slice, Need::LikeBelow, true),
                1 => (slice, Need::Level, true),
                2 => (slice, Need::Level, false),
                _ => (slice, Need::LikeBelow, false),
            })
            .collect();
        assert_eq!(TileCounter::new(0).count(&entry, &page), expected);
        assert_eq!(Need::ALL.map(Need::is_free), [true, true, true, false, false, false]);
    }

    #[test]
    fn contents_that_recur_are_counted_alike_whether_their_counts_are_kept_or_not() {
        let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        let mut encoder = PageEncoder::of_plan(&plan);
        // More contents than are kept, all of them once again, then the first and the last of them.
        let most = KEPT as u32 + 10;
        let tops: Vec<u32> = (1..=most).chain(1..=most).chain(1..=5).chain(most - 5..=most).collect();
        for (layer, top) in (0..).zip(&tops) {
            let key = PageKey { tx: 0, ty: 0, layer };
            writer.put(key, encoder.encode(key, &page(&[Span::new(0, *top, false).unwrap()]))).unwrap();
        }
        writer.finish(Totals::default()).unwrap();
        let stats = Stats::of(&Archive::open(&target).unwrap()).unwrap();
        let slices = |tops: &[u32]| tops.iter().map(|top| u64::from(top.div_ceil(255))).sum::<u64>();
        let (once, again) = tops.split_at(most as usize);
        assert_eq!(stats.pages, [once.len() as u64, again.len() as u64, 0]);
        assert_eq!(stats.tiles, [slices(once), slices(again), 0]);
        assert_eq!((stats.spans, stats.columns, stats.voxels), (tops.len() as u64, tops.len() as u64, slices(&tops)));
        assert_eq!(stats.needs[Need::Shared as usize], slices(again));
    }

    #[test]
    fn slices_are_counted_once_and_layers_up_to_a_limit() {
        let mut layers = Layers::default();
        for layer in (-3..5).chain([4, 4, -3, 1 << 30]) {
            layers.add(layer, 1 << (layer & 63) | 1 << 63).unwrap();
        }
        // In layer −1, both are slice 63.
        assert_eq!(layers.slices().unwrap(), 9 * 2 - 1);
        let mut layers = Layers::default();
        for round in 0..3 {
            for layer in 0..Layers::MOST as i32 {
                layers.add(layer, 1 << round).unwrap();
            }
        }
        layers.add(-1, 1).unwrap();
        let refused = layers.slices().unwrap_err().to_string();
        assert!(refused.contains("1048576"), "{refused}");
    }

    #[test]
    fn planes_are_told_from_levels_and_from_noise() {
        let field = |height: fn(f64, f64) -> f64| -> Heights {
            (0..64).map(|n| [f64::from(n % 8), f64::from(n / 8)]).map(|[x, y]| [x, y, height(x, y)]).collect()
        };
        let level = field(|x, _| 100.0 + (x % 2.0));
        assert!(is_level(&level, 1.0) && is_plane(&level, 1.0));
        let ramp = field(|x, y| (7.3 * x - 2.6 * y).floor());
        assert!(!is_level(&ramp, 1.0) && is_plane(&ramp, 1.0));
        let noise = field(|x, y| (x * 37.0 + y * 91.0) % 64.0);
        assert!(!is_plane(&noise, 1.0) && is_plane(&noise, 64.0));
        for way in [[1, 1], [1, -1], [1, 0], [0, -1], [2, -1]] {
            let [x, y] = way.map(f64::from);
            let line: Heights = (0..9).map(f64::from).map(|n| [x * n, y * n, 5.0 * n]).collect();
            assert!(is_plane(&line, 1.0), "{way:?}");
        }
        assert!(is_plane(&[], 1.0) && is_level(&[], 1.0));
    }
}
