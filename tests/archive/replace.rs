//! A region of one archive in place of that of another: every voxel by brute force, colours, seen space, what is refused.

use crate::common;

use common::forge::{Parts, put};
use common::random::Random;
use common::{
    Pages, archive_coloured_by_place, archive_in_colour, archive_of, archive_with_levels, key, page, read_all,
};
use slicewalk::archive::{Archive, ArchiveWriter, Bounds, ColourReader, PageEncoder, Replaced, Shard, Totals, replace};
use slicewalk::colour::{ColourPlan, ColourScale};
use slicewalk::frame::Frame;
use slicewalk::page::{Occupancy, Span};
use slicewalk::plan::{Noise, Plan, PlanOptions};
use slicewalk::query::{Aabb, overlaps};
use slicewalk::seen::{SeenBlock, SeenPage, SeenSpace};
use slicewalk::store::Snapshot;
use slicewalk::{Error, Monitor, NoMonitor, Result};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Pixels of 0.5 m and slices of 1 m, so that edges of both are exact numbers.
fn plan() -> Plan {
    Plan::new(Frame::new(0.5, 1.0).unwrap())
}

/// Slices with solid: those on both sides of a boundary of pages.
const SLICES: std::ops::Range<i64> = -5..5;
/// Height (quanta) of the lowest.
const LOWEST: i64 = SLICES.start * 255;

/// A span by its heights (quanta above the grid's origin) and class.
type Solid = (i64, i64, bool);
/// Spans by pixel of the grid, lowest first.
type Columns = BTreeMap<(i64, i64), Vec<Solid>>;

/// Returns spans as conversions make them, of random voxels, if `natural`; else any that a page can hold.
fn column(random: &mut Random, natural: bool) -> Vec<Solid> {
    let mut below = |most: u32| i64::from(random.below(most));
    let mut spans: Vec<Solid> = Vec::new();
    if !natural {
        let mut at = LOWEST + below(300);
        while at < 255 * SLICES.end {
            let top = (at + [0, below(80), 255 - at.rem_euclid(255), below(900)][below(4) as usize])
                .min(255 * SLICES.end - 1);
            spans.push((at, top, below(2) == 0));
            at = top + 1 + below(400);
        }
        return spans;
    }
    let mut open: Option<(i64, Solid)> = None;
    for slice in SLICES {
        if below(3) == 0 {
            continue;
        }
        let (floor, a, b) = (255 * slice, below(256), below(256));
        let [a, b] = [a, b].map(|at| [at, at, 0, 255][below(4) as usize]);
        let (bottom, top, obstacle) = (floor + a.min(b).min(254), floor + a.max(b), below(2) == 0);
        let joins = |last: &(i64, Solid)| last.0 + 1 == slice && (last.1.2 && obstacle || bottom - last.1.1 <= 85);
        let span = match open.take() {
            Some(last) if joins(&last) && last.1.2 == obstacle => (last.1.0, top, obstacle),
            Some(last) if joins(&last) => {
                spans.push((last.1.0, floor, last.1.2));
                (floor, top, obstacle)
            }
            last => {
                spans.extend(last.map(|last| last.1));
                (bottom, top, obstacle)
            }
        };
        open = Some((slice, span));
    }
    spans.extend(open.map(|last| last.1));
    spans
}

/// Pixels along an axis with solid: at the ends of pages and at their middle.
const PIXELS: [i64; 9] = [-65, -64, -3, -1, 0, 1, 2, 63, 64];

fn columns(random: &mut Random, natural: bool) -> Columns {
    let pixels = PIXELS.iter().flat_map(|&i| PIXELS.map(|j| (i, j)));
    let wanted: Vec<_> = pixels.filter(|_| random.below(3) > 0).collect();
    wanted.into_iter().map(|pixel| (pixel, column(random, natural))).collect()
}

/// Cuts spans at pages.
fn pages(columns: &Columns) -> Pages {
    let mut found: BTreeMap<_, BTreeMap<(u32, u32), Vec<Span>>> = BTreeMap::new();
    for (&(i, j), spans) in columns {
        for &(bottom, top, obstacle) in spans {
            for layer in -1..=0 {
                let (floor, end) = (16320 * layer, 16320 * (layer + 1));
                // What ends on the floor of a page belongs to the page below, unless it is that height alone.
                if bottom < end && (top > floor || bottom >= floor) {
                    let span = Span::new((bottom.max(floor) - floor) as u32, (top.min(end) - floor) as u32, obstacle);
                    let at = key(i.div_euclid(64) as i32, j.div_euclid(64) as i32, layer as i32);
                    let pixel = (i.rem_euclid(64) as u32, j.rem_euclid(64) as u32);
                    found.entry(at).or_default().entry(pixel).or_default().push(span.unwrap());
                }
            }
        }
    }
    found.into_iter().map(|(key, columns)| (key, page(columns))).collect()
}

/// Solid of a pixel by height: even numbers are quanta, odd ones the open intervals between them. The class of a height
/// is unknown where spans of two classes touch.
#[derive(Clone, PartialEq)]
struct Heights(Vec<Option<Option<bool>>>);

impl Heights {
    fn new() -> Self {
        Self(vec![None; (2 * 255 * (SLICES.end - SLICES.start) + 1) as usize])
    }

    fn add(&mut self, (bottom, top, obstacle): Solid) {
        for at in 2 * (bottom - LOWEST)..=2 * (top - LOWEST) {
            let known = (at % 510 != 0).then_some(obstacle);
            self.0[at as usize] = Some(known);
        }
    }
}

/// Parts of spans within slices. Those that only end at their floor belong to them, unless another one begins there;
/// those that begin at their end do not.
fn within(spans: &[Solid], (first, last): (i64, i64)) -> Vec<Solid> {
    let (low, high) = (255 * first, 255 * (last + 1));
    let begins = spans.iter().any(|span| span.0 == low);
    let meets = |span: &&Solid| span.0 < high && (span.1 > low || span.0 == low || span.1 == low && !begins);
    spans.iter().filter(meets).map(|&(bottom, top, obstacle)| (bottom.max(low), top.min(high), obstacle)).collect()
}

/// Solid of a pixel in the region, whose slices are these.
fn expected(old: &[Solid], new: &[Solid], slices: (i64, i64)) -> Heights {
    let (first, last) = (slices.0.clamp(-9, 9), slices.1.clamp(-9, 9));
    let parts = [within(old, (-10, first - 1)), within(new, (first, last)), within(old, (last + 1, 10))];
    let mut heights = Heights::new();
    parts.iter().flatten().for_each(|&span| heights.add(span));
    for (at, slice) in [(0, first), (1, last + 1)] {
        let seam = 255 * slice;
        // The voxels on both sides, if both are occupied.
        let lower = parts[at].iter().rfind(|span| span.1 > seam - 255 || span.0 == seam - 255);
        let upper = parts[at + 1].iter().find(|span| span.0 < seam + 255);
        if let (Some(lower), Some(upper)) = (lower, upper)
            && (lower.2 && upper.2 || upper.0 - lower.1 <= 85)
        {
            heights.add((lower.1, seam, lower.2));
            heights.add((seam, upper.0, upper.2));
        }
    }
    heights
}

fn heights(pages: &Pages, (i, j): (i64, i64)) -> Heights {
    let mut heights = Heights::new();
    for layer in -1..=0 {
        let at = key(i.div_euclid(64) as i32, j.div_euclid(64) as i32, layer);
        let spans =
            pages.get(&at).map_or(&[][..], |page| page.column(i.rem_euclid(64) as u32, j.rem_euclid(64) as u32));
        for span in spans {
            let floor = 16320 * i64::from(layer);
            heights.add((floor + i64::from(span.bottom()), floor + i64::from(span.top()), span.is_obstacle()));
        }
    }
    heights
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        fs::write(self.path(name), bytes).unwrap();
        self.path(name)
    }

    fn replaced(&self, old: &[u8], new: &[u8], bounds: &Bounds) -> Result<(Replaced, Archive)> {
        let (old, new) = (self.write("old.slices", old), self.write("new.slices", new));
        let made = replace(&old, &new, bounds, &self.path("c.slices"), true, &NoMonitor)?;
        Ok((made, verified(&self.path("c.slices"))))
    }
}

fn verified(path: &Path) -> Archive {
    let archive = Archive::open(path).unwrap();
    let mut findings = Vec::new();
    archive.verify(&NoMonitor, &mut |finding| findings.push(finding)).unwrap();
    assert_eq!(findings, []);
    archive
}

fn totals(points: u64) -> Totals {
    Totals { points_read: points + 3, points_kept: points, points_withheld: 1, points_excluded: 2, ..Totals::default() }
}

/// Bounds with their pixels and slices.
fn bounds(random: &mut Random) -> (Bounds, [(i64, i64); 3]) {
    let mut bounds = ([0.0; 3], [0.0; 3]);
    let ranges = std::array::from_fn(|axis| {
        let all: &[i64] = if axis == 2 { &[-5, -3, -2, -1, 0, 1, 2, 4] } else { &[-65, -64, -2, -1, 0, 1, 63, 64] };
        let [a, b] = [0; 2].map(|_| all[random.below(all.len() as u32) as usize]);
        let size = if axis == 2 { 1.0 } else { 0.5 };
        // At the lower edge of a cell, or inside.
        let [low, high] = [a.min(b), a.max(b)].map(|at| (at as f64 + [0.0, 0.37][random.below(2) as usize]) * size);
        (bounds.0[axis], bounds.1[axis]) = (low.min(high), low.max(high));
        if random.below(8) == 0 {
            (bounds.0[axis], bounds.1[axis]) = (f64::NEG_INFINITY, f64::INFINITY);
            return (i64::MIN / 1024, i64::MAX / 1024);
        }
        (a.min(b), a.max(b))
    });
    (bounds, ranges)
}

#[test]
fn every_voxel_comes_from_one_archive_and_spans_join_at_the_seam() {
    let (folder, mut random) = (Folder::new(), Random(5));
    let (mut joined, mut inside) = (0, 0);
    for number in 0..200 {
        let natural = number % 3 > 0;
        let [old, new] = [0; 2].map(|_| columns(&mut random, natural));
        let [before, after] = [&old, &new].map(pages);
        let bytes = |pages: &Pages, points| archive_with_levels(&plan(), &(pages.clone(), totals(points)), None);
        let (bounds, [i, j, slices]) = bounds(&mut random);
        let (made, archive) = folder.replaced(&bytes(&before, 20), &bytes(&after, 7), &bounds).unwrap();
        assert_eq!(archive.header(), &made.header);
        assert!(archive.header().levels.is_some() && made.dropped.is_empty());
        assert_eq!((made.header.points_read, made.header.points_kept, made.header.points_excluded), (33, 27, 4));
        let found = read_all(&archive).unwrap();
        for pixel in PIXELS.iter().flat_map(|&x| PIXELS.map(|y| (x, y))) {
            let spans = |columns: &Columns| columns.get(&pixel).cloned().unwrap_or_default();
            let is_inside = (i.0..=i.1).contains(&pixel.0) && (j.0..=j.1).contains(&pixel.1);
            let expected = match is_inside {
                true => expected(&spans(&old), &spans(&new), slices),
                false => heights(&before, pixel),
            };
            let found = heights(&found, pixel);
            let wrong = (0..found.0.len()).find(|&at| found.0[at] != expected.0[at]);
            assert!(
                wrong.is_none(),
                "{number}: {pixel:?}, {slices:?}, height {:?}: {:?} {:?}",
                wrong.map(|at| at as f64 / 2.0 + LOWEST as f64),
                spans(&old),
                spans(&new)
            );
            let apart =
                [within(&spans(&old), (slices.0.max(-9) - 9, slices.0.max(-9) - 1)), within(&spans(&new), slices)];
            inside += usize::from(is_inside && !apart[1].is_empty());
            joined += usize::from(is_inside && apart.iter().all(|spans| !spans.is_empty()));
        }
        // Nothing but what was placed there.
        assert!(found.values().flat_map(|page| page.columns()).count() <= PIXELS.len() * PIXELS.len() * 2);
        let is_in = |at: &(i64, i64)| (i.0..=i.1).contains(&at.0) && (j.0..=j.1).contains(&at.1);
        let left: Vec<_> = new.iter().filter(|(at, spans)| is_in(at) && !within(spans, slices).is_empty()).collect();
        assert_eq!(made.is_cleared, left.is_empty(), "{number}: {bounds:?} {slices:?}, {left:?} {new:?}");
    }
    assert!(inside > 300 && joined > 100, "{inside} {joined}");
}

/// A point on the boundary of two slices belongs to the upper one, but ends the span of the lower one if the two join.
#[test]
fn points_on_the_floor_of_a_page_stay_when_all_below_them_is_replaced() {
    let folder = Folder::new();
    let spans = Columns::from([((3, 3), vec![(-40, 0, false)]), ((4, 3), vec![(-40, -1, false)])]);
    let archive = |columns: &Columns| archive_of(&plan(), &(pages(columns), totals(1)), None);
    let [old, empty] = [archive(&spans), archive(&Columns::new())];
    let below: Bounds = ([-9.0; 3], [9.0, 9.0, -0.5]);
    let (_, found) = folder.replaced(&old, &empty, &below).unwrap();
    assert_eq!(read_all(&found).unwrap(), pages(&[((3, 3), vec![(0, 0, false)])].into()));
    let above: Bounds = ([-9.0, -9.0, 0.0], [9.0; 3]);
    let (made, found) = folder.replaced(&empty, &old, &above).unwrap();
    assert_eq!(read_all(&found).unwrap(), pages(&[((3, 3), vec![(0, 0, false)])].into()));
    assert!(!made.is_cleared);
}

#[test]
fn boxes_inside_answer_as_in_the_new_archive_and_outside_as_in_the_old_one() {
    let (folder, mut random) = (Folder::new(), Random(9));
    let [old, new] = [0; 2].map(|_| archive_of(&plan(), &(pages(&columns(&mut random, true)), totals(1)), None));
    let bounds = ([-0.9, -1.4, -1.5], [0.7, 31.9, 1.5]);
    let (_, archive) = folder.replaced(&old, &new, &bounds).unwrap();
    let stores = [archive, Archive::from_bytes(old).unwrap(), Archive::from_bytes(new).unwrap()]
        .map(|archive| Snapshot::resident(&archive, &NoMonitor).unwrap());
    let (mut inside, mut outside) = (0, 0);
    for _ in 0..20_000 {
        let mut between =
            |low: f64, high: f64| low + (high - low) * f64::from(random.below(1 << 20)) / f64::from(1 << 20);
        let min = [between(-2.0, 2.0), between(-2.0, 33.0), between(-4.0, 4.0)];
        let max: [f64; 3] = std::array::from_fn(|axis| min[axis] + between(0.0, 0.8));
        let shape = Aabb::new(min.into(), max.into()).unwrap();
        // Inside and outside of the region's pixels and slices, a slice away from the seams.
        if min[0] > -0.99 && max[0] < 0.99 && min[1] > -1.49 && max[1] < 31.99 && min[2] > -1.0 && max[2] < 1.0 {
            assert_eq!(overlaps(&stores[0], &shape), overlaps(&stores[2], &shape), "{shape:?}");
            inside += 1;
        } else if max[0] < -1.01 || min[0] > 1.01 || max[1] < -1.51 || min[1] > 32.01 || max[2] < -3.0 || min[2] > 3.0 {
            assert_eq!(overlaps(&stores[0], &shape), overlaps(&stores[1], &shape), "{shape:?}");
            outside += 1;
        }
    }
    assert!(inside > 300 && outside > 300, "{inside} {outside}");
}

/// The colour of each voxel by its place: pixel and slice of the grid.
fn colours_of(archive: &Archive) -> BTreeMap<[i64; 3], Option<[u8; 3]>> {
    let mut reader = ColourReader::new(archive).unwrap().unwrap();
    let mut found = BTreeMap::new();
    for entry in archive.entries().map(Result::unwrap) {
        for (px, py, k, colour) in reader.colours(&entry).unwrap().voxels() {
            let place = [(entry.key.tx, px), (entry.key.ty, py), (entry.key.layer, k)];
            found.insert(place.map(|(page, at)| 64 * i64::from(page) + i64::from(at)), colour);
        }
    }
    found
}

#[test]
fn colours_stay_as_they_are_where_both_were_made_alike() {
    let (folder, mut random) = (Folder::new(), Random(21));
    let [old, new] = [0; 2].map(|_| pages(&columns(&mut random, true)));
    let bounds = ([-32.1, -0.9, -1.5], [0.7, 31.9, 1.5]);
    let is_inside = |[i, j, k]: &[i64; 3]| (-65..=1).contains(i) && (-2..=63).contains(j) && (-2..=1).contains(k);
    let colours = |error_milli| ColourPlan { scale: ColourScale::of_rgb(255), error_milli };
    let archive = |pages: &Pages, colours: ColourPlan, seed: u32, noise: u32| {
        archive_in_colour(&plan(), &(pages.clone(), totals(1)), colours, true, None, |_, _, occupancy: &Occupancy| {
            let mut random = Random(u64::from(seed));
            let value = |_| {
                let colour = [0; 3].map(|_| (20_000 + random.below(noise)) as u16);
                (random.below(7) > 0).then_some(colour)
            };
            occupancy.voxels().map(value).collect()
        })
    };
    for error_milli in [0, 3000] {
        // Of different noise, so that the steps of blocks differ.
        let made = [archive(&old, colours(error_milli), 1, 40_000), archive(&new, colours(error_milli), 2, 300)];
        let (replaced, found) = folder.replaced(&made[0], &made[1], &bounds).unwrap();
        assert!(replaced.dropped.is_empty(), "{:?}", replaced.dropped);
        let [before, after] = made.map(|bytes| colours_of(&Archive::from_bytes(bytes).unwrap()));
        let (found, mut counts) = (colours_of(&found), [0; 2]);
        for (place, colour) in &found {
            let side = usize::from(is_inside(place));
            assert_eq!(colour, [&before, &after][side].get(place).unwrap_or(&None), "{place:?}");
            counts[side] += usize::from(colour.is_some());
        }
        assert!(counts.iter().all(|count| *count > 20), "{counts:?}");
    }
    // Colours that were made otherwise are left out; those of the old archive stay.
    let plain = archive_of(&plan(), &(new.clone(), totals(1)), None);
    let coloured = archive(&old, colours(0), 1, 9000);
    for (other, words) in [(plain.clone(), None), (archive(&new, colours(5), 2, 300), Some("made otherwise"))] {
        let (replaced, found) = folder.replaced(&coloured, &other, &bounds).unwrap();
        assert_eq!(replaced.dropped.len(), usize::from(words.is_some()));
        assert!(words.is_none_or(|words| replaced.dropped[0].contains(words)), "{:?}", replaced.dropped);
        let found = colours_of(&found);
        assert!(found.iter().all(|(place, colour)| !is_inside(place) || colour.is_none()));
        assert!(found.iter().any(|(place, colour)| !is_inside(place) && colour.is_some()));
    }
    let (replaced, found) = folder.replaced(&plain, &coloured, &bounds).unwrap();
    assert!(
        found.header().colours.is_none() && replaced.dropped[0].contains("have no place"),
        "{:?}",
        replaced.dropped
    );
}

/// Writes an archive without pages whose seen space are these pages.
fn seen_archive(path: &Path, pages: Option<&BTreeMap<slicewalk::frame::PageKey, SeenPage>>) {
    let plan = plan();
    let mut writer = ArchiveWriter::create(path, &plan, true).unwrap();
    let at = key(0, 0, 0);
    let content = page([((1, 1), vec![Span::new(5, 9, false).unwrap()])]);
    writer.put(at, PageEncoder::of_plan(&plan).encode(at, &content)).unwrap();
    if let Some(pages) = pages {
        writer.set_seen();
        let mut blocks: BTreeMap<_, SeenBlock> = BTreeMap::new();
        for (&key, page) in pages {
            let (block, place) = SeenBlock::place_of(key);
            blocks.entry(block).or_insert_with(|| SeenBlock::new(block)).push(place, page);
        }
        blocks.values().for_each(|block| writer.put_seen(block).unwrap());
    }
    writer.finish(totals(1)).unwrap();
}

#[test]
fn seen_cells_are_those_of_their_side_and_on_the_border_of_both() {
    let (folder, mut random) = (Folder::new(), Random(3));
    let mut pages = || {
        let keys = (-2..2).flat_map(|tx| (-1..1).flat_map(move |ty| (-1..2).map(move |layer| key(tx, ty, layer))));
        let mut found = BTreeMap::new();
        for at in keys.filter(|_| random.below(4) > 0).collect::<Vec<_>>() {
            let mut cells = SeenPage::NOTHING;
            if random.below(4) == 0 {
                cells = SeenPage::ALL;
            }
            for _ in 0..200 {
                let mut range = |most: u32| {
                    let [a, b] = [0; 2].map(|_| random.below(most) as usize);
                    [a.min(b), a.max(b).min(a.min(b) + 5)]
                };
                cells.mark([range(16), range(16), range(64)]);
            }
            found.insert(at, cells);
        }
        found
    };
    let [old, new] = [pages(), pages()];
    let seen = |archive: &Archive| archive.seen_space(1 << 30).unwrap();
    let bounds = ([-33.2, -3.0, -1.5], [5.4, 9.9, 3.5]);
    // Pixels and slices of the region.
    let region = [(-67, 10), (-6, 19), (-2, 3)];
    for present in [[true, true], [true, false], [false, true], [false, false]] {
        let paths = [folder.path("old.slices"), folder.path("new.slices")];
        seen_archive(&paths[0], present[0].then_some(&old));
        seen_archive(&paths[1], present[1].then_some(&new));
        replace(&paths[0], &paths[1], &bounds, &folder.path("c.slices"), true, &NoMonitor).unwrap();
        let found = seen(&verified(&folder.path("c.slices")));
        assert_eq!(found.is_some(), present != [false; 2]);
        let Some(found) = found else { continue };
        let [old, new] =
            paths.map(|path| seen(&Archive::open(path).unwrap()).unwrap_or_else(|| SeenSpace::new(*found.frame())));
        let mut counts = [0; 3];
        for x in -36..36 {
            for y in -20..20 {
                for z in -70..70 {
                    let place =
                        nalgebra::Point3::new(f64::from(x) * 2.0 + 1.0, f64::from(y) * 2.0 + 1.0, f64::from(z) + 0.5);
                    let cell = [(4 * x, 4 * x + 3), (4 * y, 4 * y + 3), (z, z)];
                    let mut pairs = cell.iter().zip(&region);
                    let is_inside = pairs.clone().all(|(cell, range)| range.0 <= cell.0 && cell.1 <= range.1);
                    let meets = pairs.all(|(cell, range)| range.0 <= cell.1 && cell.0 <= range.1);
                    let expected = match (is_inside, meets) {
                        (true, _) => new.is_seen(place),
                        (_, true) => new.is_seen(place) && old.is_seen(place),
                        _ => old.is_seen(place),
                    };
                    assert_eq!(found.is_seen(place), expected, "{place} {present:?}");
                    counts[if is_inside { 0 } else { 1 + usize::from(meets) }] += usize::from(expected);
                }
            }
        }
        assert!(present != [true; 2] || counts.iter().all(|count| *count > 30), "{counts:?}");
    }
}

#[test]
fn what_does_not_fit_together_or_is_damaged_is_named() {
    let folder = Folder::new();
    let content: Pages = [(key(0, 0, 0), page([((1, 1), vec![Span::new(5, 9, false).unwrap()])]))].into();
    let made = |plan: &Plan, crs: &str, feet: f64| {
        let units = vec![slicewalk::unit::LengthUnit::of(feet)];
        archive_of(plan, &(content.clone(), Totals { crs: crs.into(), units, ..totals(4) }), None)
    };
    let old = made(&plan(), "EPSG:28992", 1.0);
    let everything: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    let refused = |new: &[u8], bounds: &Bounds| {
        let error = folder.replaced(&old, new, bounds).unwrap_err().to_string();
        assert!(!folder.path("c.slices").exists());
        error
    };
    let with = |options| Plan { options, ..plan() };
    let options = PlanOptions { max_slope_deg: 30.0, min_points: 2, ..PlanOptions::default() };
    let classes =
        PlanOptions { remove_moving: true, exclude_classes: [18, 7].into_iter().collect(), ..PlanOptions::default() };
    let many = Totals { points_read: u64::MAX, ..totals(4) };
    for (new, words) in [
        (
            made(&Plan::new(Frame::new(0.25, 1.0).unwrap()), "", 1.0),
            &["new.slices: grid: pixel 0.25 m", "--pixel 0.5"][..],
        ),
        (
            made(&with(options), "", 1.0),
            &["new.slices: options: --max-slope is 30 and not 45 as, --min-points is 2", "old"],
        ),
        (
            made(&with(classes), "", 1.0),
            &["--remove-moving is on and not off as, --exclude-class is 7,18 and not none as in", "old"],
        ),
        (
            archive_of(&plan(), &(content.clone(), many), None),
            &["new.slices: header: its 18446744073709551615 points are too many to count"],
        ),
        (made(&plan(), "EPSG:4978", 1.0), &["new.slices: reference system", "old.slices"]),
        (made(&plan(), "EPSG:28992", 0.3048), &["new.slices: units", "--units"]),
    ] {
        let error = refused(&new, &everything);
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
    // A pixel with 64 spans in its lowest slice, and with as many in its sixth.
    let crowded = |slice: u32| {
        let bottoms = (0..64).map(|number| 255 * slice + 3 * number);
        let spans = bottoms.map(|bottom| Span::new(bottom, bottom + 1, true).unwrap()).collect();
        archive_of(&plan(), &([(key(0, 0, 0), page([((1, 1), spans)]))].into(), totals(1)), None)
    };
    let above: Bounds = ([-9.0, -9.0, 5.5], [9.0; 3]);
    let error = folder.replaced(&crowded(0), &crowded(5), &above).unwrap_err().to_string();
    assert!(error.contains("spans of a pixel in page (0, 0, 0): 128 is beyond the limit of 64"), "{error}");
    let new = made(&plan(), "", 1.0);
    assert!(refused(&new, &([1.0; 3], [0.0; 3])).contains("no region"));
    let mut damaged = new.clone();
    let at = Archive::from_bytes(new.clone()).unwrap().header().pages_offset() as usize;
    damaged[at + 30] ^= 1;
    let error = refused(&damaged, &everything);
    assert!(error.contains("new.slices: damaged: rule P2: page (0, 0, 0)"), "{error}");
    // An unknown system takes that of the other archive.
    let (made, archive) = folder.replaced(&old, &new, &everything).unwrap();
    assert_eq!((archive.crs().unwrap(), made.crs), ("EPSG:28992".into(), "EPSG:28992".to_owned()));
    assert_eq!(read_all(&archive).unwrap(), content);

    struct Stop;
    impl Monitor for Stop {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let paths = ["old.slices", "new.slices", "none.slices"].map(|name| folder.path(name));
    let stopped = replace(&paths[0], &paths[1], &everything, &paths[2], false, &Stop);
    assert!(matches!(stopped, Err(Error::Interrupted)) && !paths[2].exists());
    for target in &paths[..2] {
        let before = fs::read(target).unwrap();
        let error = replace(&paths[0], &paths[1], &everything, target, true, &NoMonitor).unwrap_err().to_string();
        assert!(error.contains("reads") && fs::read(target).unwrap() == before, "{error}");
    }
}

#[test]
fn what_the_new_archive_lacks_of_both_is_told() {
    let folder = Folder::new();
    let content: Pages = [(key(0, 0, 0), page([((1, 1), vec![Span::new(5, 9, false).unwrap()])]))].into();
    let everything: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    let noise = |noise_m: f64| Some(Noise { noise_m, regions: 9, region_m: 0.5 });
    let with_noise = |noise_m: f64, shard: Option<Shard>| {
        archive_of(&plan(), &(content.clone(), Totals { noise: noise(noise_m), ..totals(1) }), shard)
    };
    let (made, archive) = folder.replaced(&with_noise(0.01, None), &with_noise(0.01, None), &everything).unwrap();
    assert_eq!((archive.noise().unwrap(), made.dropped), (noise(0.01), Vec::new()));
    // A part with a record of an unknown tag, and an archive of a later version.
    let shard = Shard { index: 1, count: 1, first: 0, last: u64::MAX, plan_file: 7 };
    let mut old = Parts::of(&with_noise(0.01, Some(shard)));
    old.metadata = [b"AAAA\x03\0\0\0abc", &old.metadata[..]].concat();
    let new = Parts::of(&with_noise(0.02, None)).build(|head| put(head, 10, 7, 2));
    let (made, archive) = folder.replaced(&old.build(|_| ()), &new, &everything).unwrap();
    let [old, new] = ["old.slices", "new.slices"].map(|name| folder.path(name).display().to_string());
    let expected = [
        format!("metadata AAAA of {old}"),
        format!("what format 1.7 adds to the head, of {new}"),
        "that it is part 1 of 1".to_owned(),
        "noise of the scan, which is not the same in both".to_owned(),
    ];
    assert_eq!(made.dropped, expected);
    assert_eq!((archive.noise().unwrap(), archive.shard().unwrap(), archive.header().version), (None, None, (1, 0)));
}

#[test]
fn all_or_nothing_of_an_archive_gives_its_bytes() {
    let folder = Folder::new();
    let mut made = common::scene();
    made.1.points_read = 0;
    (made.1.points_kept, made.1.points_withheld, made.1.points_excluded) = (0, 0, 0);
    // Points lie within their voxels.
    made.1.bounds = None;
    let (min, max) = Archive::from_bytes(common::archive(&made)).unwrap().header().bounds.unwrap();
    made.1.bounds = Some((min.map(|at| at + 1e-4), max.map(|at| at - 1e-4)));
    let other = archive_coloured_by_place(
        &(Pages::new(), Totals { crs: "a made-up place".into(), ..Totals::default() }),
        0,
        true,
        None,
    );
    let whole = archive_coloured_by_place(&made, 0, true, None);
    let everything: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    let nothing: Bounds = ([700.0; 3], [701.0; 3]);
    for (old, new, bounds) in [(&whole, &other, &nothing), (&other, &whole, &everything)] {
        folder.replaced(old, new, bounds).unwrap();
        assert!(fs::read(folder.path("c.slices")).unwrap() == whole);
    }
    let (made, archive) = folder.replaced(&whole, &other, &everything).unwrap();
    assert!(made.is_cleared && archive.header().pages.total() == 0 && archive.header().bounds.is_none());
}

#[test]
fn bounds_stay_as_tight_as_those_of_the_points() {
    let folder = Folder::new();
    let archive = |pixel, span, bounds| {
        let columns = Columns::from([(pixel, vec![span])]);
        archive_of(&plan(), &(pages(&columns), Totals { bounds: Some(bounds), ..totals(1) }), None)
    };
    // Inside the outermost pixels and quanta.
    let height = |quanta: f64| quanta / 255.0;
    let old = archive((3, 3), (-40, 10, false), ([1.6, 1.7, height(-39.5)], [1.9, 1.8, height(9.5)]));
    let new = archive((9, 3), (-31, 4, false), ([4.6, 1.55, height(-30.5)], [4.8, 1.9, height(3.5)]));
    let (made, _) = folder.replaced(&old, &new, &([4.0, -9.0, -9.0], [9.0; 3])).unwrap();
    assert_eq!(made.header.bounds, Some(([1.6, 1.55, height(-39.5)], [4.8, 1.9, height(9.5)])));
    // The face of what is replaced goes to the edge of the pixel that remains.
    let empty = archive_of(&plan(), &(Pages::new(), totals(1)), None);
    let both = fs::read(folder.path("c.slices")).unwrap();
    let (made, _) = folder.replaced(&both, &empty, &([4.0, -9.0, -9.0], [9.0; 3])).unwrap();
    assert_eq!(made.header.bounds, Some(([1.6, 1.55, height(-39.5)], [2.0, 1.9, height(9.5)])));
}
