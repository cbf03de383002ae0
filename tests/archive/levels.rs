//! Overview levels contain all solid of the archive, do not depend on how the archive was made, and changes of them are
//! detected.

use crate::common;

use common::forge::{Parts, pack, put, word};
use common::random::Random;
use common::{Pages, archive_coloured_by_place, archive_in_colour, archive_of, archive_with_levels, key, page, plan};
use nalgebra::{Point3, Vector3};
use slicewalk::archive::{
    Archive, ArchiveWriter, ColourReader, EncodedColours, Finding, Opened, Opening, PageEncoder, Shard, Totals,
    extract, merge, recover,
};
use slicewalk::codec::{ColourEncoder, Encoder, Unpacker};
use slicewalk::colour::{ColourPlan, ColourScale, LabTable, difference};
use slicewalk::edit::{Edits, Prism};
use slicewalk::page::{Occupancy, Span};
use slicewalk::query::{Aabb, Answer, Overlap, Ray, RayBound, cast, cast_far, overlaps};
use slicewalk::store::{Loader, LoaderOptions, MISSING_KEYS, Next, Prefetch, Snapshot, Stream, StreamOptions, Time};
use slicewalk::unit::LengthUnit;
use slicewalk::{Error, NoMonitor};
use slicewalk_base::disk::testing::{Call, Hooked};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Floors and walls in pages near and far; most are alike.
fn city() -> Pages {
    let mut random = Random(11);
    let span = |bottom, top, obstacle| Span::new(bottom, top, obstacle).unwrap();
    let mut content = |seed: u32| {
        page((0..900).map(|at| {
            let bottom = 500 + seed * 900 + at % 30 * 40 + random.below(30);
            let mut spans = vec![span(bottom, bottom + 3 + random.below(90), at % 7 == 0)];
            if at % 5 == 0 {
                spans.push(span(6000 + at, 16320, true));
            }
            ((at % 30 * 2, at / 30 + 20), spans)
        }))
    };
    let contents = [content(0), content(1), content(2)];
    let flat = page((0..4096).map(|at| ((at % 64, at / 64), vec![span(255, 255, false)])));
    let mut pages = Pages::new();
    for number in 0..60i32 {
        let at = key(number * 7 % 23 - 9, number * 5 % 19 - 7, number % 3 - 1);
        pages.insert(at, contents[number as usize % 3].clone());
    }
    pages.insert(key(40, 41, 0), flat.clone());
    pages.insert(key(41, 41, 0), flat);
    pages
}

fn totals() -> Totals {
    Totals { points_read: 10, points_kept: 9, crs: "here".into(), ..Totals::default() }
}

fn with_levels(pages: Pages) -> Vec<u8> {
    archive_with_levels(&plan(), &(pages, totals()), None)
}

fn rules(bytes: Vec<u8>) -> Vec<&'static str> {
    let mut rules = Vec::new();
    Archive::from_bytes(bytes).unwrap().verify(&NoMonitor, &mut |finding| rules.push(finding.rule)).unwrap();
    rules
}

/// Findings of `verify`.
fn findings(bytes: Vec<u8>) -> Vec<String> {
    let mut said = Vec::new();
    Archive::from_bytes(bytes).unwrap().verify(&NoMonitor, &mut |finding| said.push(finding.to_string())).unwrap();
    said
}

#[test]
fn levels_go_up_to_one_page_or_the_eight_around_the_origin() {
    let content = || city().into_values().next().unwrap();
    for (keys, pages) in [
        (vec![], vec![]),
        (vec![key(5, 5, 5)], vec![]),
        (vec![key(-1, -1, -1), key(0, 0, 0)], vec![]),
        (vec![key(0, 0, 0), key(1, 0, 0)], vec![1]),
        (vec![key(0, 0, 0), key(20, 0, 0)], vec![2, 2, 1]),
        (vec![key(-1, 0, 0), key(0, 0, 0), key(0, 0, 2)], vec![2]),
        (vec![key(-1 << 30, 0, 0), key((1 << 30) - 1, 0, 0)], vec![2; 10]),
    ] {
        let bytes = with_levels(keys.into_iter().map(|key| (key, content())).collect());
        assert_eq!(rules(bytes.clone()), [""; 0]);
        let archive = Archive::from_bytes(bytes).unwrap();
        let found: Vec<_> =
            archive.levels().unwrap().iter().map(|level| level.catalog().header().pages.total()).collect();
        assert_eq!(found, pages);
        assert_eq!(archive.header().levels.unwrap().count as usize, pages.len());
    }
}

/// Sixteen flat pages become one of their level, which is flat again and stores no bytes.
#[test]
fn pages_of_levels_that_are_the_same_everywhere_are_only_listed() {
    let flat = page((0..4096).map(|at| ((at % 64, at / 64), vec![Span::new(255, 255, false).unwrap()])));
    let square = (0..8).flat_map(|x| (0..4).map(move |y| key(x, y, 0)));
    let archive = Archive::from_bytes(with_levels(square.map(|at| (at, flat.clone())).collect())).unwrap();
    let levels = archive.levels().unwrap();
    let pages = levels.iter().map(|level| level.catalog().header().pages);
    assert_eq!(pages.map(|pages| (pages.uniform, pages.stored)).collect::<Vec<_>>(), [(2, 0), (0, 1)]);
}

#[test]
fn a_box_that_hits_in_the_archive_hits_in_every_level() {
    let archive = Archive::from_bytes(with_levels(city())).unwrap();
    let store = Snapshot::resident(&archive, &NoMonitor).unwrap();
    let numbers: Vec<_> = archive.levels().unwrap().iter().map(|level| level.number()).collect();
    assert_eq!(numbers, [1, 2, 3]);
    let levels: Vec<_> = numbers.iter().map(|&number| archive.level(number).unwrap()).collect();
    let stores: Vec<_> = levels.iter().map(|level| Snapshot::resident(level, &NoMonitor).unwrap()).collect();
    let (mut random, mut hits, mut clear) = (Random(5), 0, 0);
    let mut between = |low: f64, high: f64| low + (high - low) * f64::from(random.below(1 << 20)) / f64::from(1 << 20);
    let keys: Vec<_> = archive.entries().map(|entry| entry.unwrap().key).collect();
    for number in 0..20_000 {
        // In an occupied page: 64 pixels of 0.1 m, 64 slices of 0.3 m.
        let key = keys[number % keys.len()];
        let edges = [(key.tx, 6.4), (key.ty, 6.4), (key.layer, 19.2)];
        let corner: [f64; 3] = edges.map(|(index, edge)| f64::from(index) * edge + between(0.0, edge));
        let size: [f64; 3] = std::array::from_fn(|_| between(0.01, 0.6));
        let shape = Aabb::new(corner.into(), std::array::from_fn::<f64, 3, _>(|axis| corner[axis] + size[axis]).into());
        let shape = shape.unwrap();
        if overlaps(&store, &shape) == Overlap::Hit {
            hits += 1;
            assert!(stores.iter().all(|level| overlaps(level, &shape) == Overlap::Hit), "{shape:?}");
        } else {
            clear += u32::from(overlaps(&stores[0], &shape) == Overlap::Clear);
        }
    }
    assert!(hits > 200 && clear > 2000, "{hits} hits, {clear} clear in level 1 too");
}

#[test]
fn levels_of_an_edited_archive_hold_all_solid_that_remains() {
    let archive = Archive::from_bytes(with_levels(city())).unwrap();
    let pixel_m = archive.frame().pixel_m();
    let (mut random, mut edits) = (Random(5), Edits::default());
    for _ in 0..40 {
        // Through columns of pages, with borders between the middles of pixels.
        let low = [0, 1].map(|_| (f64::from(random.below(1600)) - 600.0 + 0.37) * pixel_m);
        let high = low.map(|low| low + f64::from(3 + random.below(40)) * pixel_m);
        edits.remove(Prism::of_box([low[0], low[1], -1e6], [high[0], high[1], 1e6]).unwrap()).unwrap();
    }
    let edited = archive.with_edits(edits);
    let store = Snapshot::resident(&edited, &NoMonitor).unwrap();
    let levels = [1, 2, 3].map(|number| Snapshot::resident(&edited.level(number).unwrap(), &NoMonitor).unwrap());
    let (mut hits, mut clear) = (0, [0; 3]);
    let columns: BTreeSet<_> = city().into_keys().map(|key| (key.tx, key.ty)).collect();
    for (tx, ty) in columns {
        // Most pages have solid in every second pixel of a row.
        for (px, py) in (0..64).flat_map(|py| (0..64).step_by(2).map(move |px| (px, py))) {
            let [x, y] = [64 * tx + px, 64 * ty + py].map(|pixel| (f64::from(pixel) + 0.5) * pixel_m);
            let shape = Aabb::new([x, y, -1e5].into(), [x, y, 1e5].into()).unwrap();
            let found = [0, 1, 2].map(|number| overlaps(&levels[number], &shape) == Overlap::Hit);
            if overlaps(&store, &shape) == Overlap::Hit {
                hits += 1;
                assert_eq!(found, [true; 3], "{shape:?}");
            }
            clear = [0, 1, 2].map(|number| clear[number] + u32::from(!found[number]));
        }
    }
    assert!(hits > 1000 && clear.is_sorted_by(|a, b| a >= b) && clear[0] > 1000, "{hits} hits, {clear:?} clear");
}

#[test]
fn heights_of_levels_lie_on_thirds_of_slices_and_of_sparse_pages_on_slices() {
    let heights = |every: usize| {
        let pixels = (0..4096).step_by(every);
        let content =
            page(pixels.map(|at| ((at % 64, at / 64), vec![Span::new(400 + at % 7, 410 + at % 5, false).unwrap()])));
        let bytes = with_levels([key(0, 0, 0), key(4, 0, 0)].map(|key| (key, content.clone())).into());
        assert_eq!(rules(bytes.clone()), [""; 0]);
        let pages = pages_of(&Archive::from_bytes(bytes).unwrap().level(1).unwrap());
        let spans: Vec<Span> =
            pages.values().flat_map(|page| page.columns()).flat_map(|(_, _, spans)| spans.to_vec()).collect();
        let ends: BTreeSet<(u32, u32)> = spans.iter().map(|span| (span.bottom(), span.top())).collect();
        (spans.len(), ends)
    };
    // Heights of the level are a quarter of those below: 100 to 104 there.
    assert_eq!(heights(1), (512, BTreeSet::from([(85, 170)])));
    // Every fourth pixel: four spans become one. Every fifth: fewer.
    assert_eq!(heights(4), (512, BTreeSet::from([(85, 170)])));
    assert_eq!(heights(5), (512, BTreeSet::from([(0, 255)])));
}

#[test]
fn a_level_streams_like_an_archive() {
    let archive = Archive::from_bytes(with_levels(city())).unwrap();
    let outline = archive.level(2).unwrap();
    let keys: Vec<_> = outline.entries().map(|entry| entry.unwrap().key).collect();
    assert_eq!(keys.len() as u64, outline.header().pages.total());
    let options = StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(4 << 20) };
    let stream = Stream::open(outline, options).unwrap();
    let report = stream.load(&keys, keys[0]).unwrap();
    assert_eq!((report.loaded, report.left_out), (keys.len(), 0));
    assert!(archive.level(0).is_err() && archive.level(4).unwrap_err().to_string().contains("levels 1 to 3"));
}

/// All pages of an archive.
fn pages_of(archive: &Archive) -> Pages {
    let entries = archive.entries().map(Result::unwrap);
    entries.map(|entry| (entry.key, archive.page(&entry).unwrap())).collect()
}

#[test]
fn a_level_opens_from_the_end_of_the_section_or_by_ranges_without_a_file() {
    let totals = Totals { units: vec![LengthUnit::of(0.3048)], ..totals() };
    let bytes = archive_with_levels(&plan(), &(city(), totals.clone()), None);
    let archive = Archive::from_bytes(bytes.clone()).unwrap();
    let fetch = |range: std::ops::Range<u64>| bytes[range.start as usize..range.end as usize].to_vec();
    // Only head and footer, the table and the level are read.
    let mut opening = Opening::new(Some(bytes.len() as u64));
    let catalog = loop {
        match opening.next().unwrap() {
            Opened::Wants(ranges) => {
                ranges.into_iter().for_each(|range| opening.give(range.start, &fetch(range.clone())))
            }
            Opened::Ready(catalog) => break catalog,
        }
    };
    let (section, table) = (catalog.levels_section().unwrap(), catalog.levels_range().unwrap());
    let levels = catalog.decode_levels(&fetch(table.clone())).unwrap();
    assert_eq!(levels, archive.levels().unwrap());
    assert_eq!(
        (levels[0].bytes().start, levels.last().unwrap().bytes().end, table.end),
        (section.start, table.start, section.end)
    );
    assert!(catalog.decode_levels(&fetch(table.start..table.end - 1)).is_err());
    for level in &levels {
        let range = level.bytes();
        let alone = Archive::of_level(level, fetch(range.clone())).unwrap();
        assert_eq!(pages_of(&alone), pages_of(&archive.level(level.number()).unwrap()));
        assert!(alone.levels().unwrap().is_empty() && alone.crs().unwrap().is_empty());
        assert!(Archive::of_level(level, fetch(range.start..range.end - 1)).is_err());
        assert!(alone.source().read_at(range.start - 1, &mut [0]).is_err());
        // As the viewer loads it.
        let mut loader = Loader::new(level.catalog().clone(), LoaderOptions::new(16 << 20)).unwrap();
        let keys: Vec<_> = pages_of(&alone).into_keys().collect();
        let request = loader.request(&keys, keys[0]);
        while let Next::Fetch(asked) = loader.poll(Time::ZERO).unwrap() {
            assert!(range.start <= asked.range.start && asked.range.end <= range.end, "{:?}", asked.range);
            let job = loader.given(asked.id, fetch(asked.range), Time::ZERO);
            job.map(|job| loader.loaded(job.run(), Time::ZERO));
        }
        assert_eq!(loader.outcome(request).unwrap().unwrap().loaded, keys.len());
    }
    let mut metadata = fetch(catalog.metadata_range());
    assert_eq!(catalog.decode_crs(&metadata).unwrap(), totals.crs);
    assert_eq!(catalog.decode_units(&metadata).unwrap(), totals.units);
    metadata[9] ^= 1;
    assert!(catalog.decode_units(&metadata).unwrap_err().to_string().contains("rule M1"));
    let without = Archive::from_bytes(archive_of(&plan(), &(city(), totals), None)).unwrap();
    assert_eq!((without.catalog().levels_section(), without.catalog().levels_range()), (None, None));
    assert!(without.catalog().decode_levels(&[]).unwrap().is_empty());
}

#[test]
fn pages_that_were_not_prepared_for_levels_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = ArchiveWriter::create(&folder.path().join("a.slices"), &plan(), false).unwrap();
    writer.set_levels();
    let (key, page) = city().pop_first().unwrap();
    let encoded = PageEncoder::of_plan(&plan()).for_levels(false).encode(key, &page);
    assert!(writer.put(key, encoded).unwrap_err().to_string().contains("without overview levels"));
    let colours = ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 0 };
    writer.set_colours(colours);
    let (occupancy, mut encoder) = (Occupancy::of(&page), ColourEncoder::default().for_levels(false));
    let made = EncodedColours::new(&colours, &occupancy, &vec![Some([7; 3]); occupancy.len()], &mut encoder);
    let encoded = PageEncoder::of_plan(&plan()).encode(key, &page).with_colours(made);
    assert!(writer.put(key, encoded).unwrap_err().to_string().contains("without overview levels"));
}

/// Two parts, cut within a column of level 1.
fn halves() -> [Shard; 2] {
    halves_at(key(1, 0, 0))
}

/// Two parts, the second of which begins with the column of `page`.
pub fn halves_at(page: slicewalk::frame::PageKey) -> [Shard; 2] {
    let middle = page.column();
    [(1, 0, middle - 1), (2, middle, u64::MAX)].map(|(index, first, last)| Shard {
        index,
        count: 2,
        first,
        last,
        plan_file: 7,
    })
}

fn totals_of_part(index: u32) -> Totals {
    if index == 1 { totals() } else { Totals { crs: "here".into(), ..Totals::default() } }
}

/// The city in two parts, each an archive without findings.
fn written_parts(folder: &Path, archive: impl Fn(&(Pages, Totals), Shard) -> Vec<u8>) -> Vec<PathBuf> {
    let write = |shard: Shard| {
        let own = city().into_iter().filter(|(key, _)| shard.columns().contains(&key.column())).collect();
        let bytes = archive(&(own, totals_of_part(shard.index)), shard);
        assert_eq!(rules(bytes.clone()), [""; 0]);
        let target = folder.join(format!("{}.slices", shard.index));
        fs::write(&target, bytes).unwrap();
        target
    };
    halves().map(write).into()
}

#[test]
fn parts_extracts_and_recovered_archives_have_the_levels_of_a_single_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let single = with_levels(city());
    let parts = written_parts(folder.path(), |part, shard| archive_with_levels(&plan(), part, Some(shard)));
    merge(&parts, &path("whole.slices"), false, &NoMonitor).unwrap();
    assert!(fs::read(path("whole.slices")).unwrap() == single);
    let (empty, without) = ((Pages::new(), totals_of_part(2)), halves()[1]);
    fs::write(&parts[1], archive_of(&plan(), &empty, Some(without))).unwrap();
    let refused = merge(&parts, &path("no.slices"), false, &NoMonitor).unwrap_err().to_string();
    assert!(refused.contains("2.slices") && refused.contains("--levels"), "{refused}");

    let archive = Archive::from_bytes(single.clone()).unwrap();
    let everything = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    let extracted = extract(&archive, &everything, &path("all.slices"), false, &NoMonitor).unwrap();
    assert!(extracted.dropped.is_empty(), "{:?}", extracted.dropped);
    assert!(fs::read(path("all.slices")).unwrap() == single);
    let room = extract(&archive, &([0.0; 3], [20.0, 20.0, 9.0]), &path("room.slices"), false, &NoMonitor).unwrap();
    assert!(room.header.levels.is_some() && rules(fs::read(path("room.slices")).unwrap()).is_empty());

    // A damaged level is rebuilt from the pages; a level's page never counts as one of the archive.
    let level = archive.levels().unwrap()[0].bytes();
    let mut damaged = single.clone();
    damaged[level.start as usize + 40] ^= 1;
    assert_eq!(rules(damaged.clone()), ["P2"]);
    fs::write(path("damaged.slices"), &damaged).unwrap();
    let recovered = recover(&path("damaged.slices"), None, &path("saved.slices"), false, &NoMonitor).unwrap();
    assert!(recovered.is_complete() && fs::read(path("saved.slices")).unwrap() == single);
    damaged[20] ^= 1;
    fs::write(path("headless.slices"), &damaged).unwrap();
    recover(&path("headless.slices"), Some(&plan()), &path("pages.slices"), false, &NoMonitor).unwrap();
    let pages = Archive::open(path("pages.slices")).unwrap();
    assert_eq!(pages.header().pages.stored, archive.header().pages.stored);
    assert!(pages.header().levels.is_none());
}

/// Indices of a voxel in the whole grid of an archive or level.
type Place = [i64; 3];

/// All colours of an archive or a level.
fn colours_of(archive: &Archive) -> BTreeMap<Place, [u8; 3]> {
    let mut reader = ColourReader::new(archive).unwrap().expect("it has colours");
    let mut found = BTreeMap::new();
    for entry in archive.entries().map(Result::unwrap) {
        let key = entry.key;
        for (px, py, k, colour) in reader.colours(&entry).unwrap().voxels() {
            let place = [(key.tx, px), (key.ty, py), (key.layer, k)].map(|(t, p)| 64 * i64::from(t) + i64::from(p));
            found.extend(colour.map(|colour| (place, colour)));
        }
    }
    found
}

#[test]
fn voxels_of_levels_have_the_mean_colours_of_the_voxels_in_them() {
    for error_milli in [0u16, 2000, 6000] {
        let bytes = archive_coloured_by_place(&(city(), totals()), error_milli, true, None);
        assert_eq!(rules(bytes.clone()), [""; 0]);
        let archive = Archive::from_bytes(bytes).unwrap();
        assert_eq!(archive.header().features_optional, 0b11);
        let all = colours_of(&archive);
        assert_eq!(archive.levels().unwrap().len(), 3);
        for told in archive.levels().unwrap() {
            let number = told.number();
            let mut sums: BTreeMap<Place, (f64, [f64; 3])> = BTreeMap::new();
            for (place, colour) in &all {
                let (n, sum) = sums.entry(place.map(|index| index >> (2 * number))).or_default();
                *n += 1.0;
                sum.iter_mut().zip(colour).for_each(|(sum, channel)| *sum += f64::from(*channel));
            }
            let level = archive.level(number).unwrap();
            let found = colours_of(&level);
            assert!(found.keys().eq(sums.keys()), "level {number}");
            assert!(found.len() > 50 && found.len() < all.len());
            let (table, mut apart) = (LabTable::get(), 0.0);
            for (place, colour) in &found {
                let (n, sum) = sums[place];
                if error_milli == 0 {
                    for (channel, sum) in colour.iter().zip(sum) {
                        assert!((f64::from(*channel) - sum / n).abs() <= 0.51, "{place:?} of level {number}");
                    }
                }
                let mean = sum.map(|sum| (sum / n * 257.0).round() as u16);
                apart += f64::from(difference(table.of_16_bits(mean), table.of_8_bits(*colour)));
            }
            // Per page, and so overall; 8 bits are the finest.
            let (apart, most) = (apart / found.len() as f64, f64::from(error_milli.max(500)) / 1000.0);
            assert!(apart <= most, "level {number}: {apart} of {most}");
            // The table states where the colours are; reading them needs no other bytes.
            let catalog = level.catalog();
            assert!(catalog.colours_section().is_none());
            let table = catalog.level_colours_range().unwrap();
            assert_eq!((table.start, table.end - table.start), (archive.header().colours_offset(), 64));
        }
        let voxels = archive.header().colours.unwrap().voxels;
        assert_eq!(voxels, all.len() as u64, "the archive's own");
    }
}

#[test]
fn colours_of_more_pages_than_a_leaf_lists_come_back() {
    let one = page([((3, 4), vec![Span::new(40, 50, true).unwrap()])]);
    let pages: Pages = (0..4100).map(|layer| (key(0, 0, layer), one.clone())).collect();
    let plan_of_colours = ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 0 };
    let red = |layer: i32| layer as u16 * 15;
    let made = (pages, Totals::default());
    let bytes = archive_in_colour(&plan(), &made, plan_of_colours, true, None, |_, key, _| {
        vec![(key.layer % 2 == 0).then_some([red(key.layer), 0, 65_535])]
    });
    assert_eq!(rules(bytes.clone()), [""; 0]);
    let archive = Archive::from_bytes(bytes).unwrap();
    let (header, mut reader) = (archive.header(), ColourReader::new(&archive).unwrap().unwrap());
    assert_eq!((archive.leaf_count(), reader.bytes()), (2, header.colours_offset()..header.levels_offset()));
    for entry in archive.entries().map(Result::unwrap) {
        // 16 bits become 8, to the nearest.
        let expected = [((u32::from(red(entry.key.layer)) + 128) / 257) as u8, 0, 255, 255];
        let expected = if entry.key.layer % 2 == 0 { expected } else { [0; 4] };
        assert_eq!(reader.colours(&entry).unwrap().values(), [expected], "{}", entry.key);
    }
}

/// One voxel of the archive has a colour. Its solid is the boundary below its slice alone; in the level it joins solid
/// that ends there, so the voxel of the level that the colour would be of is not occupied.
#[test]
fn colours_on_a_boundary_may_belong_to_no_voxel_of_a_level() {
    let span = |bottom, top| vec![Span::new(bottom, top, false).unwrap()];
    let content = page([((0, 0), span(900, 1020)), ((1, 0), span(1020, 1020))]);
    let made = ([(key(0, 0, 0), content), (key(1, 0, 0), page([((9, 9), span(5, 9))]))].into(), Totals::default());
    let colours = ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 0 };
    let bytes = archive_in_colour(&plan(), &made, colours, true, None, |_, key, occupancy| {
        occupancy.voxels().map(|(_, slice)| (key.tx == 0 && slice == 4).then_some([9000; 3])).collect()
    });
    let archive = Archive::from_bytes(bytes.clone()).unwrap();
    let summary = archive.verify(&NoMonitor, &mut |finding| panic!("{finding}")).unwrap();
    // Those of colours of levels, too.
    assert_eq!(summary.bytes, bytes.len() as u64);
    assert_eq!(colours_of(&archive), BTreeMap::from([([1, 0, 4], [35; 3])]));
    assert_eq!(colours_of(&archive.level(1).unwrap()), BTreeMap::new());
}

#[test]
fn colours_that_an_archive_lacks_are_refused() {
    let plain = Archive::from_bytes(with_levels(city())).unwrap();
    let said = plain.catalog().decode_colour_table(&[]).unwrap_err().to_string();
    assert!(said.contains("rule K2") && said.contains("without"), "{said}");
    let level = plain.level(1).unwrap();
    assert_eq!(level.frame().pixel_m(), 4.0 * plain.frame().pixel_m());
    assert_eq!(&level.catalog().with_level_colours(&[]).unwrap(), level.catalog());
    let coloured = Archive::from_bytes(archive_coloured_by_place(&(city(), totals()), 2000, true, None)).unwrap();
    let said = coloured.level(1).unwrap().catalog().with_level_colours(&[0; 3]).unwrap_err().to_string();
    assert!(said.contains("rule K11") && said.contains("3 bytes"), "{said}");
    let mut reader = ColourReader::new(&coloured).unwrap().unwrap();
    let keys: Vec<_> = coloured.entries().map(|entry| entry.unwrap().key).collect();
    // Before all pages, and between two of them.
    for unknown in [key(-1 << 30, -1 << 30, 0), key(keys[7].tx, keys[7].ty, keys[7].layer + 9)] {
        let said = reader.find(unknown).unwrap_err().to_string();
        assert!(!keys.contains(&unknown) && said.contains("no such page"), "{unknown}: {said}");
    }
    assert!(reader.find(keys[7]).is_ok());
}

#[test]
fn plain_archives_keep_their_bytes_and_what_comes_before_colours_of_levels_is_as_without() {
    let made = (city(), totals());
    let [with, without] = [true, false].map(|levels| archive_coloured_by_place(&made, 2000, levels, None));
    let both = [&with, &without].map(|bytes| Archive::from_bytes(bytes.clone()).unwrap());
    assert_eq!(both[1].header().features_optional, 0b10);
    let section = |archive: &Archive, from: u64, to: u64| {
        let mut bytes = vec![0; (to - from) as usize];
        archive.source().read_at(from, &mut bytes).unwrap();
        bytes
    };
    let pages = |archive: &Archive| {
        let header = archive.header();
        section(archive, header.pages_offset(), header.colours_offset())
    };
    assert!(pages(&both[0]) == pages(&both[1]));
    assert_eq!(colours_of(&both[0]), colours_of(&both[1]));
    // The levels equal those of an archive without colours.
    let plain = Archive::from_bytes(with_levels(city())).unwrap();
    assert_eq!(plain.header().features_optional, 0b1);
    let levels = |archive: &Archive| {
        let header = archive.header();
        section(archive, header.levels_offset(), header.directory_offset())
    };
    assert!(levels(&plain) == levels(&both[0]));
}

#[test]
fn parts_extracts_and_recovered_archives_have_the_coloured_levels_of_a_single_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let single = archive_coloured_by_place(&(city(), totals()), 2000, true, None);
    let parts = written_parts(folder.path(), |part, shard| archive_coloured_by_place(part, 2000, true, Some(shard)));
    merge(&parts, &path("whole.slices"), false, &NoMonitor).unwrap();
    assert!(fs::read(path("whole.slices")).unwrap() == single);

    let archive = Archive::from_bytes(single.clone()).unwrap();
    let everything = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    extract(&archive, &everything, &path("all.slices"), false, &NoMonitor).unwrap();
    assert!(fs::read(path("all.slices")).unwrap() == single);
    extract(&archive, &([-40.0; 3], [60.0, 50.0, 9.0]), &path("room.slices"), false, &NoMonitor).unwrap();
    let room = fs::read(path("room.slices")).unwrap();
    assert_eq!(rules(room.clone()), [""; 0]);
    assert!(!colours_of(&Archive::from_bytes(room).unwrap().level(1).unwrap()).is_empty());

    // Damaged colours of a level are rebuilt.
    let mut damaged = single.clone();
    damaged[archive.header().colours_offset() as usize + 64 + 10] ^= 1;
    assert_eq!(rules(damaged.clone()), ["K4"]);
    fs::write(path("damaged.slices"), &damaged).unwrap();
    let recovered = recover(&path("damaged.slices"), None, &path("saved.slices"), false, &NoMonitor).unwrap();
    assert!(recovered.identical && fs::read(path("saved.slices")).unwrap() == single);
    // Levels without colours receive some.
    let forged = Parts::of(&single).build(|head| put(head, 24, 0b111, 8));
    fs::write(path("forged.slices"), forged).unwrap();
    recover(&path("forged.slices"), None, &path("coloured.slices"), false, &NoMonitor).unwrap();
    assert!(fs::read(path("coloured.slices")).unwrap() == single);
}

#[test]
#[ignore = "slow: .ci/run"]
fn damage_of_colours_of_levels_is_named_and_leaves_all_else() {
    let bytes = archive_coloured_by_place(&(city(), totals()), 2000, true, None);
    let good = Archive::from_bytes(bytes.clone()).unwrap();
    let start = good.header().colours_offset();
    let parts: Vec<_> = [1, 2, 3]
        .map(|number| {
            let level = good.level(number).unwrap();
            let table = level.catalog().level_colours_range().unwrap();
            let table = bytes[table.start as usize..table.end as usize].to_vec();
            level.catalog().with_level_colours(&table).unwrap().colours_section().unwrap()
        })
        .into();
    assert_eq!((parts[2].start, parts[2].end, parts[1].end), (start + 64, parts[1].start, parts[0].start));
    let all = start..parts[0].end;
    for at in all.clone().step_by(((all.end - all.start) / 12) as usize).chain((start..start + 64).step_by(15)) {
        let mut damaged = bytes.clone();
        damaged[at as usize] ^= 1 << (at % 8);
        let archive = Archive::from_bytes(damaged).unwrap();
        let mut found = Vec::new();
        archive.verify(&NoMonitor, &mut |finding| found.push((finding.rule, finding.part))).unwrap();
        assert!(
            !found.is_empty() && found.iter().all(|(rule, part)| rule.starts_with('K') && part.contains("colour")),
            "byte {at}: {found:?}"
        );
        assert_eq!(colours_of(&archive), colours_of(&good));
        for (number, range) in (1..).zip(&parts) {
            let (level, sound) = (archive.level(number).unwrap(), good.level(number).unwrap());
            assert_eq!(pages_of(&level), pages_of(&sound));
            let mut sound = ColourReader::new(&sound).unwrap().unwrap();
            let mut reader = match ColourReader::new(&level) {
                Ok(reader) => reader.unwrap(),
                Err(Error::Format { rule, .. }) => {
                    assert!(rule == "K11" && at < start + 64 || rule == "K2" && range.contains(&at), "{rule} at {at}");
                    continue;
                }
                Err(error) => panic!("{error}"),
            };
            for entry in level.entries().map(Result::unwrap) {
                match reader.colours(&entry) {
                    Ok(colours) => assert_eq!(colours, sound.colours(&entry).unwrap()),
                    Err(Error::Format { rule, .. }) => assert!(rule.starts_with('K') && range.contains(&at)),
                    Err(error) => panic!("{error}"),
                }
            }
        }
    }
    // Valid checksums around wrong numbers.
    let forged = |change: &dyn Fn(&mut [u8])| {
        let mut parts = Parts::of(&bytes);
        let at = (start - parts.head.len() as u64) as usize;
        let table = &mut parts.pages[at..at + 64];
        change(table);
        let crc = crc32c::crc32c(&table[..60]);
        put(table, 60, crc.into(), 4);
        rules(parts.build(|_| ()))
    };
    assert_eq!(forged(&|_| ()), [""; 0]);
    // Voxels, length and checksum of level 2; then a length beyond the section.
    assert_eq!(forged(&|table| table[28] ^= 1), ["K10"]);
    assert!(forged(&|table| table[36] ^= 1).contains(&"K2"));
    assert!(forged(&|table| put(table, 20, 3, 8)).contains(&"K11"));
    assert!(forged(&|table| put(table, 20, u64::MAX - 5, 8)).contains(&"K11"));
}

#[test]
fn heads_without_room_for_colours_of_levels_are_refused_and_verify_looks_at_every_byte() {
    let parts = Parts::of(&archive_coloured_by_place(&(city(), totals()), 2000, true, None));
    let refused = |forge: &dyn Fn(&mut Vec<u8>)| Archive::from_bytes(parts.build(forge)).unwrap_err().to_string();
    let said = refused(&|head| put(head, 352, 70, 8));
    assert!(said.contains("rule K1"), "{said}");
    // Bytes that only a newer version may use.
    let said = refused(&|head| head[383] = 1);
    assert!(said.contains("rule K1"), "{said}");
    let newer = parts.build(|head| (head[10], head[383]) = (head[10] + 1, 1));
    assert!(Archive::from_bytes(newer).is_ok());
    // Every byte of a sound archive is checked.
    let sound = parts.build(|_| ());
    let summary = Archive::from_bytes(sound.clone()).unwrap().verify(&NoMonitor, &mut |_| ()).unwrap();
    assert_eq!((summary.findings, summary.bytes), (0, sound.len() as u64));
}

/// The archive of `pages` with the levels of `others`, and valid checksums.
fn with_levels_of(pages: Pages, others: Pages) -> Vec<u8> {
    let [own, other] = [pages, others].map(|pages| Parts::of(&with_levels(pages)));
    let levels = |parts: &Parts| parts.pages.len() - word(&parts.head, 328);
    let pages = [&own.pages[..levels(&own)], &other.pages[levels(&other)..]].concat();
    let mut head = own.head.clone();
    head[325..344].copy_from_slice(&other.head[325..344]);
    Parts { head, pages, ..own }.build(|_| ())
}

/// Length of the record of a level with one leaf, in the table of levels.
const RECORD: usize = 40 + 28;

/// The archive with another table of levels, without as many bytes before it as `change` says, and valid checksums.
fn with_table(parts: &Parts, change: impl FnOnce(&mut Vec<u8>) -> usize) -> Parts {
    let [levels_len, table_len] = [328, 336].map(|at| word(&parts.head, at));
    let (rest, table) = parts.pages.split_at(parts.pages.len() - table_len);
    let mut raw = Unpacker::new().unpack(table, 1 << 20, "").unwrap().to_vec();
    assert_eq!(raw.len(), usize::from(parts.head[325]) * RECORD, "one leaf a level");
    let cut = change(&mut raw);
    let mut table = Vec::new();
    pack(&raw, &mut table);
    let mut head = parts.head.clone();
    put(&mut head, 328, (levels_len - table_len - cut + table.len()) as u64, 8);
    put(&mut head, 336, table.len() as u64, 4);
    put(&mut head, 340, crc32c::crc32c(&table).into(), 4);
    let pages = [&rest[..rest.len() - cut], &table].concat();
    Parts { head, pages, ..parts.clone() }
}

/// The archive without its last level, and valid checksums.
fn without_last_level(parts: &Parts) -> Vec<u8> {
    let less = with_table(parts, |raw| {
        let last = raw.split_off(raw.len() - RECORD);
        word(&last, 0) + word(&last, 8)
    });
    less.build(|head| head[325] -= 1)
}

/// The archive, which has one level of one leaf, with the level's pages, its leaf and its record in the table changed,
/// and valid lengths and checksums.
fn with_level(parts: &Parts, change: impl FnOnce(&mut Vec<u8>, &mut Vec<u8>, &mut Vec<u8>)) -> Vec<u8> {
    let [levels_len, table_len] = [328, 336].map(|at| word(&parts.head, at));
    let (rest, level) = parts.pages.split_at(parts.pages.len() - levels_len);
    let (level, table) = level.split_at(levels_len - table_len);
    let unpacked = |frame: &[u8]| Unpacker::new().unpack(frame, 1 << 20, "").unwrap().to_vec();
    let mut record = unpacked(table);
    assert_eq!(record.len(), RECORD);
    let (pages, leaf) = level.split_at(word(&record, 0));
    let (mut pages, mut leaf) = (pages.to_vec(), unpacked(leaf));
    change(&mut pages, &mut leaf, &mut record);
    let (mut stored, mut table) = (Vec::new(), Vec::new());
    pack(&leaf, &mut stored);
    put(&mut record, 0, pages.len() as u64, 8);
    put(&mut record, 8, stored.len() as u64, 8);
    // The leaf's record follows the fixed fields; lengths and checksum end it.
    for (at, value) in [(56, stored.len() as u32), (60, leaf.len() as u32), (64, crc32c::crc32c(&stored))] {
        put(&mut record, at, value.into(), 4);
    }
    pack(&record, &mut table);
    let mut head = parts.head.clone();
    put(&mut head, 328, (pages.len() + stored.len() + table.len()) as u64, 8);
    put(&mut head, 336, table.len() as u64, 4);
    put(&mut head, 340, crc32c::crc32c(&table).into(), 4);
    let pages = [rest, &pages, &stored, &table].concat();
    Parts { head, pages, ..parts.clone() }.build(|_| ())
}

/// Archives with a level of one page that breaks a rule: their names, the rules, the bytes.
pub fn damaged_levels() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let content = page([((3, 4), vec![Span::new(40, 50, true).unwrap()])]);
    let bytes = with_levels([key(0, 0, 0), key(1, 0, 0)].map(|key| (key, content.clone())).into());
    let parts = Parts::of(&bytes);
    assert!(with_level(&parts, |_, _, _| ()) == bytes);
    // Recomputes the checksum of the page, and its length and checksum in the leaf.
    let seal = |pages: &mut Vec<u8>, leaf: &mut Vec<u8>| {
        let own = Parts { head: Vec::new(), pages: pages.clone(), leaf: leaf.clone(), metadata: Vec::new() };
        Parts { pages: *pages, leaf: *leaf, .. } = own.with_leader();
    };
    // Heights of levels have a grid of their own.
    let level = Archive::from_bytes(bytes.clone()).unwrap().level(1).unwrap();
    let mut other = Vec::new();
    Encoder::new(plan().frame, 0).encode(&pages_of(&level)[&key(0, 0, 0)], &mut other);
    vec![
        (
            "gap-before-page-of-level",
            "D9",
            with_level(&parts, |pages, leaf, _| {
                pages.insert(0, 0);
                leaf[0] = 1;
            }),
        ),
        ("bytes-left-behind-page-of-level", "D9", with_level(&parts, |pages, _, _| pages.push(0))),
        (
            "shared-page-of-level",
            "D10",
            with_level(&parts, |pages, leaf, _| {
                // The base, the storage, and behind the length the distance back.
                (leaf[0], leaf[3]) = (pages.len() as u8, 1);
                leaf.insert(13, pages.len() as u8);
            }),
        ),
        (
            "page-of-level-that-begins-as-another",
            "P1",
            with_level(&parts, |pages, leaf, _| {
                pages[..4].copy_from_slice(b"\x89PAG");
                seal(pages, leaf);
            }),
        ),
        (
            "not-the-one-encoding-of-level",
            "P10",
            with_level(&parts, |pages, leaf, _| {
                assert_ne!(pages[24..], other);
                pages.truncate(24);
                pages.extend(other);
                let len = pages.len() as u64 - 24;
                put(pages, 16, len, 4);
                seal(pages, leaf);
            }),
        ),
        (
            "pages-of-level-miscounted",
            "L5",
            with_level(&parts, |_, _, record| {
                // Stored, uniform.
                put(record, 16, 0, 8);
                put(record, 24, 1, 8);
            }),
        ),
    ]
}

#[test]
fn damage_of_pages_of_levels_is_named_at_its_place() {
    for (name, rule, bytes) in damaged_levels() {
        let archive = Archive::from_bytes(bytes).unwrap();
        // The page follows the gap; else it begins the level.
        let at = archive.levels().unwrap()[0].bytes().start + u64::from(name == "gap-before-page-of-level");
        let mut found = Vec::new();
        let mut list = |finding: Finding| found.push((finding.rule, finding.part, finding.offset));
        archive.verify(&NoMonitor, &mut list).unwrap();
        let [(found_rule, part, offset)] = &found[..] else { panic!("{name}: {found:?}") };
        assert_eq!((*found_rule, *offset), (rule, at), "{name}");
        assert!(part.ends_with("level 1"), "{name}: {part}");
    }
}

#[test]
fn temporary_files_that_fail_are_findings_of_their_own() {
    // More spans in a column of level 1 than are sorted in memory.
    let content = page((0..256).map(|at| {
        let bottoms = (0..16).map(|slice| 1020 * slice + 340);
        ((at % 16 * 4, at / 16 * 4), bottoms.map(|bottom| Span::new(bottom, bottom + 300, false).unwrap()).collect())
    }));
    let bytes = with_levels((0..40).map(|layer| (key(0, 0, layer), content.clone())).collect());
    assert_eq!(rules(bytes.clone()), [""; 0]);
    for fails in [Call::Create, Call::Write, Call::Read] {
        let disk = Hooked::real(move |call| match call == fails {
            true => Err(std::io::Error::other("the disk is broken")),
            false => Ok(()),
        });
        let found = slicewalk_base::disk::with(disk, || findings(bytes.clone()));
        assert!(matches!(&found[..], [one] if one.contains("S1") && one.contains("broken")), "{fails:?}: {found:?}");
    }
}

#[test]
fn levels_that_are_not_those_of_the_pages_are_found() {
    assert_eq!(rules(with_levels_of(city(), city())), [""; 0]);
    let mut other = city();
    // Solid that a level lacks, moves, or has too much of.
    let (&last, _) = other.last_key_value().unwrap();
    other.remove(&last);
    assert!(rules(with_levels_of(city(), other.clone())).contains(&"L5"));
    assert!(rules(with_levels_of(other.clone(), city())).contains(&"L5"));
    other.insert(last, page([((0, 0), vec![Span::new(9, 10, false).unwrap()])]));
    assert!(rules(with_levels_of(city(), other)).contains(&"L5"));
    let mut far = city();
    far.insert(key(4000, 0, 0), far.values().next().unwrap().clone());
    assert!(rules(with_levels_of(city(), far.clone())).contains(&"L5"));
    assert!(rules(with_levels_of(far, city())).contains(&"L5"));
    // An extra page after all those of level 1; the levels above follow from it.
    let mut more = city();
    more.insert(key(3, 900, 0), more.values().next().unwrap().clone());
    let found = findings(with_levels_of(city(), more));
    assert!(found.iter().any(|said| said.contains("no more pages: the level below is empty there")), "{found:?}");
    // One before all of them.
    let mut more = city();
    more.insert(key(-40, -40, 0), more.values().next().unwrap().clone());
    let found = findings(with_levels_of(city(), more));
    assert!(
        found.iter().any(|said| said.contains("rule L5") && said.contains("found page (-10, -10, 0)")),
        "{found:?}"
    );
    // The last level is missing, and nothing else is wrong.
    assert_eq!(rules(without_last_level(&Parts::of(&with_levels(city())))), ["L5"]);
    // Numbers in the head.
    let parts = Parts::of(&with_levels(city()));
    for (at, value, len, rule) in [
        (325, 2, 1, "L3"),
        (325, 17, 1, "L1"),
        (326, 1, 1, "L1"),
        (328, 1 << 40, 8, "L1"),
        (336, 0, 4, "L1"),
        (340, 1, 4, "L2"),
        (344, 1, 1, "H10"),
    ] {
        let forged = parts.build(|head| put(head, at, value, len));
        assert!(refusal(forged).contains(&format!("rule {rule}")), "{at}: {value}");
    }
    // Numbers in the record of the first level: pages stored, entries a leaf, bytes of pages.
    for (at, value, len, rule) in [
        (16, 0, 8, "L4"),
        (16, 1 << 40, 8, "L4"),
        (32, 1 << 21, 4, "R1"),
        (0, 1 << 40, 8, "L4"),
        (8, u64::MAX, 8, "L4"),
    ] {
        let forged = with_table(&parts, |raw| {
            put(raw, at, value, len);
            0
        });
        assert!(refusal(forged.build(|_| ())).contains(&format!("rule {rule}")), "{at}: {value}");
    }
    let longer = with_table(&parts, |raw| {
        raw.push(0);
        0
    });
    assert!(refusal(longer.build(|_| ())).contains("rule L3"));
    // No level has pixels of 4,000,000 m.
    let coarse = parts.build(|head| {
        put(head, 56, 1e6f64.to_bits(), 8);
        let hash = xxhash_rust::xxh3::xxh3_128(&head[56..128]);
        head[40..56].copy_from_slice(&hash.to_le_bytes());
    });
    let said = refusal(coarse);
    assert!(said.contains("rule L4") && said.contains("at most 1000000 m"), "{said}");
    // A byte of the last level's directory is missing before the table.
    assert!(refusal(with_table(&parts, |_| 1).build(|_| ())).contains("rule L4"));
}

/// Message of the error when levels are opened.
fn refusal(bytes: Vec<u8>) -> String {
    Archive::from_bytes(bytes).and_then(|archive| archive.levels().map(drop)).unwrap_err().to_string()
}

#[test]
fn where_pages_are_missing_a_level_says_how_far_a_ray_is_free() {
    let archive = || Archive::from_bytes(with_levels(city())).unwrap();
    let whole = Snapshot::resident(&archive(), &NoMonitor).unwrap();
    let keys: Vec<_> = archive().entries().map(|entry| entry.unwrap().key).collect();
    let stream =
        Stream::open(archive(), StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(64 << 20) }).unwrap();
    let some: Vec<_> = keys.iter().copied().step_by(3).collect();
    assert_eq!(stream.load(&some, some[0]).unwrap().left_out, 0);
    let view = stream.snapshot();
    let frame = archive().header().plan.frame;
    let page_m = [64.0 * frame.pixel_m(), 64.0 * frame.pixel_m(), 64.0 * frame.slice_m()];
    // Where the ray enters pages that are not loaded (m).
    let entries = |ray: &Ray| {
        let absent = keys.iter().filter(|key| !some.contains(key));
        let entry = |key: &slicewalk::frame::PageKey| {
            let (mut enter, mut leave) = (0.0f64, ray.max());
            for (axis, index) in [key.tx, key.ty, key.layer].into_iter().enumerate() {
                let side = |index: i32| (f64::from(index) * page_m[axis] - ray.origin()[axis]) / ray.direction()[axis];
                let (a, b) = (side(index), side(index + 1));
                (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
            }
            (enter <= leave).then_some(enter)
        };
        absent.filter_map(entry).collect::<Vec<_>>()
    };
    let mut random = Random(5);
    for number in [1, 2] {
        let level = Snapshot::resident(&archive().level(number).unwrap(), &NoMonitor).unwrap();
        let (mut exact, mut free, mut bounds, mut better) = (0, 0, 0, 0);
        for _ in 0..4000 {
            let origin = Point3::new(
                random.between(-10.0, 15.0) * page_m[0],
                random.between(-8.0, 13.0) * page_m[1],
                random.between(-1.2, 2.2) * page_m[2],
            );
            let direction =
                Vector3::new(random.between(-1.0, 1.0), random.between(-1.0, 1.0), random.between(-0.3, 0.3));
            let ray = Ray::new(origin, direction, random.between(0.0, 30.0) * page_m[0]).unwrap();
            let Answer::Known(truth) = cast(&whole, &ray) else { panic!("all pages are there") };
            let is_loaded = matches!(cast(&view, &ray), Answer::Known(_));
            match cast_far(&view, &level, &ray) {
                Answer::Known(RayBound::Exact(found)) => {
                    assert_eq!(found, truth, "{ray:?}");
                    exact += 1;
                    free += usize::from(!is_loaded);
                }
                Answer::Known(RayBound::AtLeast(distance)) => {
                    assert!(!is_loaded && (0.0..=ray.max()).contains(&distance), "{ray:?}: {distance}");
                    assert!(
                        truth.is_none_or(|hit| hit.distance >= distance),
                        "{ray:?}: {truth:?} is nearer than {distance}"
                    );
                    let entries = entries(&ray);
                    if entries.len() <= MISSING_KEYS {
                        let nearest = entries.into_iter().fold(f64::INFINITY, f64::min);
                        assert!(distance >= nearest - 1e-5, "{ray:?}: {distance}, loaded up to {nearest}");
                    }
                    bounds += 1;
                    better += usize::from(distance > 0.1);
                }
                Answer::NotLoaded(_) => panic!("all of the level is there"),
            }
        }
        assert!(exact > 500 && free > 20 && bounds > 100 && better > 50, "{exact} {free} {bounds} {better}");
    }
}
