//! Archives taken apart and reassembled: merged, recovered and extracted, compared page by page and by brute force.

use crate::common;

use common::forge::{Parts, giant, put};
use common::random::Random;
use common::{
    Pages, archive_coloured_by_place, archive_of, archive_with_levels, key, page, plan, read_all, render, scene,
    two_pixels,
};
use proptest::prelude::*;
use slicewalk::NoMonitor;
use slicewalk::archive::{
    Archive, ArchiveWriter, Bounds, ColourReader, EncodedColours, PageDecoder, PageEncoder, PageReader, Recovered,
    Shard, Storage, Totals, extract, merge, recover,
};
use slicewalk::codec::ColourEncoder;
use slicewalk::colour::{ColourPlan, ColourScale};
use slicewalk::edit::{Edits, Prism};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{Inferred, Occupancy, Page, Span};
use slicewalk::plan::{Plan, PlanOptions};
use slicewalk::query::{Aabb, Answer, Cylinder, Ray, Sphere, cast, overlaps, probe};
use slicewalk::seen::{SeenBlock, SeenPage};
use slicewalk::stats::Stats;
use slicewalk::store::Snapshot;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;

fn archive(made: &(Pages, Totals)) -> Vec<u8> {
    archive_of(&plan(), made, None)
}

#[test]
fn a_reader_gives_the_pages_of_an_archive_in_any_order() {
    let pages: Pages = (0..12).map(|at| (key(at, at % 3, 0), content([0, 1, 1, 2, 0, 3][at as usize % 6]))).collect();
    let archive = Archive::from_bytes(archive(&(pages.clone(), Totals::default()))).unwrap();
    let entries: Vec<_> = archive.entries().map(Result::unwrap).collect();
    let mut reader = PageReader::new(&archive);
    for entry in entries.iter().chain(entries.iter().rev()) {
        assert_eq!(reader.page(entry).unwrap(), &pages[&entry.key]);
        let (page, inferred) = reader.page_and_inferred(entry).unwrap();
        assert_eq!((page, inferred.span_count()), (&pages[&entry.key], 0));
    }
}

/// Few different contents, so that many pages are equal, and a uniform one.
fn content(number: u32) -> Page {
    let span = |bottom, top, obstacle| Span::new(bottom, top, obstacle).unwrap();
    if number == 0 {
        return page((0..4096).map(|at| ((at % 64, at / 64), vec![span(300, 700, true)])));
    }
    let mut random = Random(u64::from(number));
    page((0..200 * number).map(|at| {
        let bottom = random.below(16000);
        ((at % 64, at / 64), vec![span(bottom, bottom + random.below(300), at % 3 == 0)])
    }))
}

fn pages() -> impl Strategy<Value = Pages> {
    let keys = (-4i32..4, -4i32..4, -2i32..3);
    let contents = proptest::collection::btree_map(keys, 0u32..5, 1..40);
    contents.prop_map(|all| all.into_iter().map(|((tx, ty, layer), n)| (key(tx, ty, layer), content(n))).collect())
}

/// Totals with the bounds of the solid.
fn totals(points: u64) -> Totals {
    let read = points + 3;
    Totals {
        points_read: read,
        points_kept: points,
        points_withheld: 1,
        points_excluded: 2,
        bounds: None,
        crs: "here".into(),
        units: vec![slicewalk::unit::LengthUnit::of(0.3048)],
        noise: None,
    }
}

fn write(target: &Path, pages: &Pages, totals: Totals, shard: Option<Shard>) {
    let plan = plan();
    let mut writer = ArchiveWriter::create(target, &plan, true).unwrap();
    let mut encoder = PageEncoder::of_plan(&plan);
    for (&key, page) in pages {
        if shard.is_none_or(|shard| shard.columns().contains(&key.column())) {
            writer.put(key, encoder.encode(key, page)).unwrap();
        }
    }
    if let Some(shard) = shard {
        writer.set_shard(shard);
    }
    writer.finish(totals).unwrap();
}

fn verified(path: &Path) -> Archive {
    let archive = Archive::open(path).unwrap();
    let mut findings = Vec::new();
    archive.verify(&NoMonitor, &mut |finding| findings.push(finding)).unwrap();
    assert_eq!(findings, []);
    archive
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn any_split_merges_to_the_whole(
        pages in pages(), cuts in proptest::collection::btree_set(-40i64..40, 0..6), at in 0usize..7
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        // Columns around the origin, where the pages are.
        let middle = key(0, 0, 0).column();
        let firsts: Vec<u64> = std::iter::once(0).chain(cuts.iter().map(|cut| middle.wrapping_add_signed(*cut))).collect();
        let count = firsts.len();
        let parts: Vec<PathBuf> = (0..count).map(|index| {
            let last = firsts.get(index + 1).map_or(u64::MAX, |next| next - 1);
            let shard = Shard { index: index as u32 + 1, count: count as u32, first: firsts[index], last, plan_file: 7 };
            let name = path(&format!("{index}.slices"));
            write(&name, &pages, totals(index as u64), Some(shard));
            name
        }).collect();
        for part in &parts {
            verified(part);
        }
        let points = (0..count as u64).sum();
        let mut whole = totals(points);
        (whole.points_read, whole.points_withheld, whole.points_excluded) =
            (points + 3 * count as u64, count as u64, 2 * count as u64);
        write(&path("whole.slices"), &pages, whole, None);
        let mut order = parts.clone();
        order.rotate_left(at % count);
        merge(&order, &path("merged.slices"), false, &NoMonitor).unwrap();
        prop_assert!(fs::read(path("merged.slices")).unwrap() == fs::read(path("whole.slices")).unwrap());
    }

    #[test]
    fn what_is_undamaged_is_recovered(
        pages in pages(), cut in any::<prop::sample::Index>(), flips in proptest::collection::vec(any::<(prop::sample::Index, u8)>(), 0..4),
        cuts: bool
    ) {
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("a.slices"), &pages, totals(9), None);
        let good = fs::read(folder.path().join("a.slices")).unwrap();
        let mut bad = good.clone();
        for (at, value) in flips {
            let at = at.index(bad.len());
            bad[at] ^= value;
        }
        if cuts {
            bad.truncate(cut.index(good.len()));
        }
        recovers(folder.path(), &good, &bad);
    }
}

/// Recovers `bad`, a damaged `good`; checks that every page with intact bytes is recovered, and no other content.
fn recovers(folder: &Path, good: &[u8], bad: &[u8]) -> Option<Recovered> {
    let (from, to) = (folder.join("bad.slices"), folder.join("recovered.slices"));
    fs::write(&from, bad).unwrap();
    let whole = Archive::from_bytes(good.to_vec()).unwrap();
    let pages = read_all(&whole).unwrap();
    let same = |offset: u64, len: u64| {
        let range = offset as usize..(offset + len) as usize;
        bad.get(range.clone()) == Some(&good[range])
    };
    let header = whole.header();
    let head = same(0, header.bytes.head);
    let directory = head && same(header.directory_offset(), header.bytes.directory);
    let expected: Pages = whole
        .entries()
        .map(Result::unwrap)
        .filter(|entry| match entry.storage {
            Storage::Stored(extent) => same(extent.offset, extent.len.into()),
            Storage::Shared(extent) => directory && same(extent.offset, extent.len.into()),
            Storage::Uniform(_) => directory,
        })
        .map(|entry| (entry.key, pages[&entry.key].clone()))
        .collect();
    let recovered = match recover(&from, Some(&plan()), &to, true, &NoMonitor) {
        Ok(recovered) => recovered,
        Err(error) => {
            assert!(expected.is_empty(), "{error}");
            return None;
        }
    };
    let found = verified(&to);
    assert_eq!(read_all(&found).unwrap(), expected);
    assert_eq!(recovered.head, head);
    assert_eq!(recovered.found.total(), expected.len() as u64);
    if let Some(lost) = recovered.lost {
        assert_eq!(lost.total() as usize, pages.len() - expected.len());
    }
    if recovered.is_complete() {
        assert!(fs::read(&to).unwrap() == good, "what is complete has the bytes that it once had");
    }
    Some(recovered)
}

#[test]
fn an_archive_cut_anywhere_gives_every_page_before_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let good = archive(&scene());
    let whole = Archive::from_bytes(good.clone()).unwrap();
    let header = whole.header();
    let end = (header.metadata_offset() + header.bytes.metadata) as usize;
    // Byte by byte around every section's end, elsewhere in steps, because each recovery syncs a file.
    let near = |len: &usize| {
        let ends = [header.pages_offset(), header.directory_offset(), header.metadata_offset(), end as u64];
        len.is_multiple_of(7) || ends.iter().any(|end| end.abs_diff(*len as u64) < 3)
    };
    for len in (0..=good.len()).filter(near) {
        let recovered = recovers(folder.path(), &good, &good[..len]);
        let Some(recovered) = recovered else { continue };
        // If only the footer is missing, nothing is lost.
        assert_eq!(recovered.is_complete(), len >= end, "{len}");
    }
}

#[test]
fn without_a_head_the_plan_must_be_given_and_bounds_come_from_the_pages() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("a.slices"), folder.path().join("b.slices"));
    let good = archive(&scene());
    let mut bad = good.clone();
    bad[130] ^= 1;
    fs::write(&from, &bad).unwrap();
    let error = recover(&from, None, &to, false, &NoMonitor).unwrap_err().to_string();
    assert!(error.contains("a.slices") && error.contains("give its plan"), "{error}");
    assert!(!to.exists());
    let recovered = recovers(folder.path(), &good, &bad).unwrap();
    assert!(recovered.lost.is_none() && recovered.leaves.is_none() && !recovered.is_complete());
    let (min, max) = recovered.header.bounds.unwrap();
    let (pages, _) = scene();
    let lowest = pages.keys().map(|key| key.tx).min().unwrap();
    assert!(min[0] >= f64::from(lowest) * 6.4 - 1e-9 && min[0] <= max[0] && max[2] > 90.0, "{min:?} {max:?}");
    fs::write(&from, &good).unwrap();
    let mut other = plan();
    other.options.max_slope_deg = 30.0;
    let error = recover(&from, Some(&other), &to, false, &NoMonitor).unwrap_err().to_string();
    assert!(error.starts_with("plan: ") && error.contains("a.slices"), "{error}");
    // Inserted bytes: the pages are found at their new offsets.
    let at = Archive::from_bytes(good.clone()).unwrap().header().pages_offset() as usize;
    let shifted = [&good[..at], b"\x89PAG of no page", &good[at..]].concat();
    fs::write(&from, shifted).unwrap();
    let recovered = recover(&from, None, &to, false, &NoMonitor).unwrap();
    assert_eq!(recovered.lost.map(|lost| lost.stored), Some(0));
    assert!(recovered.lost.is_some_and(|lost| lost.uniform > 0), "the directory is not where the head says");
    fs::write(&from, b"no archive at all").unwrap();
    let error = recover(&from, Some(&plan()), &folder.path().join("c.slices"), false, &NoMonitor).unwrap_err();
    assert!(error.to_string().contains("no sound page"), "{error}");
}

/// Recovers `bytes` and returns the result; the written archive keeps every rule.
fn recovered(folder: &Path, bytes: &[u8]) -> (Recovered, Pages) {
    let (from, to) = (folder.join("from.slices"), folder.join("to.slices"));
    fs::write(&from, bytes).unwrap();
    let recovered = recover(&from, Some(&plan()), &to, true, &NoMonitor).unwrap();
    (recovered, read_all(&verified(&to)).unwrap())
}

/// The scene with a changed page and its recomputed checksum.
fn with_page(at: usize, change: impl FnOnce(&mut [u8])) -> Vec<u8> {
    let mut bytes = archive(&scene());
    let whole = Archive::from_bytes(bytes.clone()).unwrap();
    let stored = whole.leaf(0).unwrap().into_iter().filter(|entry| matches!(entry.storage, Storage::Stored(_)));
    let extent = stored.map(|entry| entry.extent().unwrap()).nth(at).unwrap();
    let page = &mut bytes[extent.offset as usize..extent.offset as usize + extent.len as usize];
    change(page);
    let crc = crc32c::crc32c_append(crc32c::crc32c(&page[..20]), &page[24..]);
    put(page, 20, crc.into(), 4);
    bytes
}

#[test]
fn a_page_with_a_wrong_key_costs_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let whole = Archive::from_bytes(archive(&scene())).unwrap();
    let entries = whole.leaf(0).unwrap();
    let stored: Vec<_> = entries.iter().filter(|entry| matches!(entry.storage, Storage::Stored(_))).collect();
    let keys: Vec<_> = stored.iter().map(|entry| entry.key).collect();
    for (at, tx) in (0..keys.len()).flat_map(|at| [(at, -(1 << 29)), (at, 1 << 29)]) {
        let bytes = with_page(at, |page| put(page, 4, tx as u64, 4));
        let (found, pages) = recovered(folder.path(), &bytes);
        // Pages that share its bytes are lost with it.
        let alike = entries.iter().filter(|entry| entry.content() == stored[at].content()).count();
        assert_eq!((found.lost.unwrap().stored, pages.len()), (1, entries.len() - alike));
        assert!(!found.is_complete());
        // Without a head only the order reveals a misplaced page.
        let mut headless = bytes;
        headless[100] ^= 1;
        let (found, pages) = recovered(folder.path(), &headless);
        let (mut in_order, moved) = (keys.clone(), key(tx, keys[at].ty, keys[at].layer));
        in_order[at] = moved;
        let lost = usize::from(!in_order.is_sorted());
        assert_eq!(pages.len(), keys.len() - lost, "page {at} moved to {moved}");
        assert!(found.lost.is_none() && !found.is_complete());
    }
}

#[test]
fn pages_in_metadata_are_no_matter() {
    let folder = tempfile::tempdir().unwrap();
    let mut parts = Parts::of(&archive(&scene()));
    let other = Parts::of(&archive(&(Pages::from([(key(900, 900, 0), content(3))]), totals(1))));
    let record = [b"zzzz", &(other.pages.len() as u32).to_le_bytes()[..], &other.pages].concat();
    parts.metadata.extend(record);
    let good = parts.build(|_| ());
    let (found, pages) = recovered(folder.path(), &good);
    assert!(found.is_complete() && found.identical && pages == scene().0);
    // Neither head nor directory state where pages end, but a leaf follows them.
    let mut headless = good.clone();
    headless[100] ^= 1;
    let mut stored: Pages =
        scene().0.into_iter().filter(|(key, _)| ![(0, 1), (1, 0)].contains(&(key.tx, key.layer))).collect();
    assert_eq!(recovered(folder.path(), &headless).1, stored);
    let mut leafless = good.clone();
    let leaf = Archive::from_bytes(good.clone()).unwrap().header().directory_offset() as usize;
    leafless[leaf + 20] ^= 1;
    let (found, pages) = recovered(folder.path(), &leafless);
    assert!(pages == stored && !found.is_complete() && found.leaves == Some((0, 1)));
    // Neither leaf nor metadata are where the head has them.
    let start = parts.head.len();
    let (found, pages) = recovered(folder.path(), &[&good[..start], b"\x89", &good[start..]].concat());
    assert!(pages == stored && found.metadata_lost && found.leaves == Some((0, 1)));
    // Metadata are, so pages end where the head says, though the last one is damaged.
    leafless[leaf - 1] ^= 1;
    stored.pop_last();
    let (found, pages) = recovered(folder.path(), &leafless);
    assert!(pages == stored && !found.metadata_lost && found.leaves == Some((0, 1)));
}

#[test]
fn pages_that_are_not_where_their_leaf_has_them_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let mut parts = Parts::of(&archive(&scene()));
    parts.pages.insert(0, 0x89);
    let (found, pages) = recovered(folder.path(), &parts.build(|_| ()));
    assert_eq!((found.leaves, found.lost.unwrap().stored), (Some((1, 1)), 0));
    assert_eq!(pages.len() as u64, found.found.total());
    assert!(found.found.stored == 5 && found.found.uniform == 1);
    // With their colours, which have no leaders.
    let good = archive_coloured_by_place(&scene(), 0, false, None);
    assert!(recovered(folder.path(), &good).0.identical);
    let mut parts = Parts::of(&good);
    parts.pages.insert(0, 0x89);
    let (found, pages) = recovered(folder.path(), &parts.build(|_| ()));
    let all = colours_of(&Archive::from_bytes(good).unwrap());
    let left = colours_of(&Archive::open(folder.path().join("to.slices")).unwrap());
    assert!(pages.len() == 6 && left.keys().eq(pages.keys()) && left.iter().all(|(key, own)| all[key] == *own));
    assert!(left.values().all(|own| own.iter().any(|colour| colour[3] > 0)), "{found:?}");
    // The page that shared the bytes of another one is lost.
    let coloured = |pages: &BTreeMap<PageKey, Vec<[u8; 4]>>| pages.values().flatten().filter(|own| own[3] > 0).count();
    let (all, left) = (coloured(&all), coloured(&left));
    assert_eq!(found.dropped, [format!("colours of {} of {all} voxels (damaged)", all - left)]);
}

/// The colours of the voxels of each page.
fn colours_of(archive: &Archive) -> BTreeMap<PageKey, Vec<[u8; 4]>> {
    let mut reader = ColourReader::new(archive).unwrap().unwrap();
    let entries = archive.entries().map(Result::unwrap);
    entries.map(|entry| (entry.key, reader.colours(&entry).unwrap().values().to_vec())).collect()
}

#[test]
fn pages_of_a_lost_leaf_are_found_before_those_of_the_next_one() {
    let folder = tempfile::tempdir().unwrap();
    // Two leaves, the first of 4,096 pages.
    let content = |n: u32| page([((n % 64, n / 64 % 64), vec![Span::new(n, n + 5, false).unwrap()])]);
    let pages: Pages = (0..4100).map(|n| (key(0, 0, n as i32), content(n))).collect();
    let good = archive(&(pages, totals(9)));
    let whole = Archive::from_bytes(good.clone()).unwrap();
    let mut bad = good.clone();
    bad[whole.header().directory_offset() as usize + 20] ^= 1;
    let found = recovers(folder.path(), &good, &bad).unwrap();
    assert!(found.leaves == Some((1, 2)) && found.is_complete(), "{found:?}");
    // The last page of the lost leaf has the key of a page of the next leaf, or of none.
    let extent = whole.leaf(0).unwrap()[4095].extent().unwrap();
    for layer in [4096, 5000] {
        let page = &mut bad[extent.offset as usize..][..extent.len as usize];
        put(page, 12, layer, 4);
        let crc = crc32c::crc32c_append(crc32c::crc32c(&page[..20]), &page[24..]);
        put(page, 20, crc.into(), 4);
        let (found, pages) = recovered(folder.path(), &bad);
        assert_eq!((found.lost.unwrap().stored, pages.len()), (1, 4099), "layer {layer}");
        assert!(!pages.contains_key(&key(0, 0, 4095)) && !pages.contains_key(&key(0, 0, 5000)));
    }
}

#[test]
fn what_breaks_a_rule_is_mended_or_dropped_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let parts = Parts::of(&archive(&scene()));
    let shard = |index: u32, first: u64, last: u64| {
        let numbers = [&index.to_le_bytes()[..], &3u32.to_le_bytes(), &first.to_le_bytes(), &last.to_le_bytes()];
        let metadata = [b"SHRD\x28\0\0\0", &numbers.concat()[..], &[7; 16]].concat();
        Parts { metadata, ..parts.clone() }.build(|_| ())
    };
    let (found, _) = recovered(folder.path(), &shard(2, 1, u64::MAX - 1));
    assert!(found.identical, "{found:?}");
    // All pages, and some of them, lie outside.
    for last in [9, key(0, 0, 0).column() - 1] {
        let (found, pages) = recovered(folder.path(), &shard(1, 0, last));
        assert!(!found.is_complete() && pages == scene().0);
        assert!(found.dropped[0].contains("part 1 of 3") && found.lost.unwrap().total() == 0, "{found:?}");
    }
    let bounds = parts.build(|head| put(head, 184, 0, 8));
    let (found, _) = recovered(folder.path(), &bounds);
    assert!(found.is_complete() && !found.identical && found.mended == ["bounds in the head (rule T6)"], "{found:?}");
    let totals = parts.build(|head| put(head, 256, 0, 8));
    let (found, _) = recovered(folder.path(), &totals);
    assert!(found.is_complete() && found.mended == ["counts in the head (rules T1 to T4)"], "{found:?}");
    let newer = parts.build(|head| put(head, 10, 7, 2));
    let (found, _) = recovered(folder.path(), &newer);
    assert!(!found.is_complete() && found.dropped == ["what format 1.7 adds to the head"], "{found:?}");
    // The directory has another slice, or another block, than the page.
    let parts = Parts::of(&archive(&two_pixels()));
    for (at, value) in [(4, 2), (17, 1)] {
        let mut wrong = parts.clone();
        wrong.leaf[at] = value;
        let (found, pages) = recovered(folder.path(), &wrong.build(|_| ()));
        assert_eq!(found.mended, ["directory entries of 1 page (rules P9, P11)"]);
        assert!(found.is_complete() && !found.identical && pages == two_pixels().0, "{found:?}");
    }
    // Heights in centimetres, coded in quanta: the content is sound, but its encoding is not canonical.
    let columns = (0..64).map(|px| ((px, 0), vec![Span::new(51 * px, 51 * px + 1, false).unwrap()]));
    let steps = page(columns);
    let parts = Parts::of(&archive(&(Pages::from([(key(0, 0, 0), steps.clone())]), Totals::default())));
    let mut body = Vec::new();
    slicewalk::codec::Encoder::new(Frame::new(1e5, 3e5).unwrap(), 0).encode(&steps, &mut body);
    let (found, pages) = recovered(folder.path(), &parts.with_page(&body).build(|_| ()));
    assert_eq!(pages, Pages::from([(key(0, 0, 0), steps)]));
    assert!(found.is_complete() && found.mended == ["encoding of 1 page (rule P10)"], "{found:?}");
}

#[test]
fn an_extracted_region_has_one_slice_and_pixel_more_on_every_side() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("e.slices");
    // Solid in the middle of each slice of seven by seven pixels.
    let spans: Vec<_> = (5..16).map(|slice| Span::new(slice * 255 + 90, slice * 255 + 120, false).unwrap()).collect();
    let pages = [(key(0, 0, 0), page((0..49).map(|at| ((20 + at % 7, 30 + at / 7), spans.clone()))))];
    let whole = Archive::from_bytes(archive(&(pages.into(), Totals::default()))).unwrap();
    let frame = whole.header().plan.frame;
    // Inside pixel (23, 33) and slice 10.
    let at =
        |pixel: f64, slice: f64| [pixel * frame.pixel_m(), (pixel + 10.0) * frame.pixel_m(), slice * frame.slice_m()];
    extract(&whole, &(at(23.3, 10.3), at(23.6, 10.6)), &target, false, &NoMonitor).unwrap();
    let part = read_all(&Archive::open(&target).unwrap()).unwrap();
    let kept: Vec<_> = part[&key(0, 0, 0)].columns().map(|(x, y, spans)| (x, y, spans.to_vec())).collect();
    let expected: Vec<_> = (32..35).flat_map(|y| (22..25).map(move |x| (x, y))).collect();
    assert_eq!(kept, expected.into_iter().map(|(x, y)| (x, y, spans[4..7].to_vec())).collect::<Vec<_>>());
}

#[test]
fn unknown_metadata_is_copied_or_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut parts = Parts::of(&archive(&scene()));
    parts.metadata = [b"AAAA\x03\0\0\0abc", &parts.metadata[..], b"zzzz\0\0\0\0"].concat();
    let good = parts.build(|_| ());
    assert!(recovered(folder.path(), &good).0.identical);
    let mut bad = good.clone();
    bad[parts.head.len() + 30] ^= 1;
    let (found, _) = recovered(folder.path(), &bad);
    assert!(!found.is_complete() && found.dropped.is_empty());
    let metadata = |path: &Path| Parts::of(&fs::read(path).unwrap()).metadata;
    assert_eq!(metadata(&path("to.slices")), parts.metadata);
    let whole = Archive::from_bytes(good).unwrap();
    let region = ([-1.0; 3], [1.0; 3]);
    let extracted = extract(&whole, &region, &path("e.slices"), false, &NoMonitor).unwrap();
    assert_eq!(extracted.dropped, ["metadata AAAA", "metadata zzzz"]);
    assert_eq!(verified(&path("e.slices")).crs().unwrap(), "a made-up place");
    let part = Archive::from_bytes(only_part(&scene())).unwrap();
    let extracted = extract(&part, &region, &path("p.slices"), false, &NoMonitor).unwrap();
    assert_eq!(extracted.dropped, ["that it is part 1 of 1"]);
    assert!(part.shard().unwrap().is_some() && verified(&path("p.slices")).shard().unwrap().is_none());
    // The whole states what all parts agree on.
    let middle = key(0, 0, 0).column();
    let names: Vec<_> = [(1, 0, middle - 1), (2, middle, u64::MAX)]
        .map(|(index, first, last)| {
            let name = path(&format!("{index}.slices"));
            write(&name, &scene().0, totals(1), Some(Shard { index, count: 2, first, last, plan_file: 7 }));
            let mut parts = Parts::of(&fs::read(&name).unwrap());
            parts.metadata = [b"AAAA\x03\0\0\0abc", &parts.metadata[..], b"zzzz\x01\0\0\0", &[index as u8]].concat();
            fs::write(&name, parts.build(|_| ())).unwrap();
            name
        })
        .to_vec();
    let merged = merge(&names, &path("m.slices"), false, &NoMonitor).unwrap();
    assert_eq!(merged.dropped, ["metadata zzzz, which is not the same in all parts"]);
    assert!(metadata(&path("m.slices")).starts_with(b"AAAA\x03\0\0\0abcCRS "));
    verified(&path("m.slices"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn what_is_recovered_of_forged_bytes_keeps_every_rule(
        part in 0usize..4, changes in proptest::collection::vec(any::<(prop::sample::Index, u8)>(), 1..6), of_scene: bool
    ) {
        let folder = tempfile::tempdir().unwrap();
        let good = if of_scene { archive(&scene()) } else { only_part(&scene()) };
        let mut parts = Parts::of(&good);
        let mut head = parts.head.clone();
        let bytes = [&mut head, &mut parts.pages, &mut parts.leaf, &mut parts.metadata];
        let changed = bytes.into_iter().nth(part).unwrap();
        for (at, value) in changes {
            let at = at.index(changed.len());
            changed[at] = value;
        }
        let forged = parts.build(|good| if part == 0 { *good = head });
        let (from, to) = (folder.path().join("from.slices"), folder.path().join("to.slices"));
        fs::write(&from, &forged).unwrap();
        let given = plan();
        let known = Archive::from_bytes(forged).map_or(given, |archive| archive.plan().clone());
        if recover(&from, Some(&known), &to, true, &NoMonitor).is_ok() {
            verified(&to);
        }
    }
}

/// All columns.
const ONLY: Shard = Shard { index: 1, count: 1, first: 0, last: u64::MAX, plan_file: 9 };

/// The scene as the only part of a conversion.
fn only_part(made: &(Pages, Totals)) -> Vec<u8> {
    archive_of(&plan(), made, Some(ONLY))
}

#[test]
fn answers_inside_an_extracted_region_are_those_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let mut made = scene();
    // Solid that ends exactly on slices and pixels, like the regions and boxes below.
    let span = |bottom, top, obstacle| vec![Span::new(bottom, top, obstacle).unwrap()];
    let steps = (0..4096u32).filter(|at| at % 3 > 0);
    let steps = steps.map(|at| ((at % 64, at / 64), span(255 * (at % 7), 255 * (at % 7 + at % 3), at % 3 == 2)));
    made.0.insert(key(0, -1, 0), page(steps));
    let good = archive(&made);
    let whole = Archive::from_bytes(good.clone()).unwrap();
    let store = Snapshot::resident(&whole, &NoMonitor).unwrap();
    let mut random = Random(3);
    // Corners on and between pixel and slice boundaries: tenths of a pixel of 0.1 m, slices of 0.3 m.
    let mut between = |low: f64, high: f64| {
        let step = [0.1, 0.3, 0.013][random.below(3) as usize];
        ((low + (high - low) * f64::from(random.below(1 << 20)) / f64::from(1 << 20)) / step).round() * step
    };
    let mut hits = 0;
    for number in 0..60 {
        let mut bounds = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let range = [(-7.0, 20.0), (-20.0, 7.0), if number % 2 == 0 { (-20.0, 20.0) } else { (-0.6, 3.0) }][axis];
            let (a, b) = (between(range.0, range.1), between(range.0, range.1));
            (bounds.0[axis], bounds.1[axis]) = (a.min(b), a.max(b));
        }
        let target = folder.path().join(format!("{number}.slices"));
        let header = extract(&whole, &bounds, &target, false, &NoMonitor).unwrap().header;
        let part = verified(&target);
        assert_eq!(part.header(), &header);
        assert_eq!(part.crs().unwrap(), whole.crs().unwrap());
        let own = Snapshot::resident(&part, &NoMonitor).unwrap();
        for _ in 0..60 {
            let mut corners = ([0.0; 3], [0.0; 3]);
            for axis in 0..3 {
                let (low, high) = (bounds.0[axis], bounds.1[axis]);
                let (a, b) = (between(low, high).clamp(low, high), between(low, high).clamp(low, high));
                (corners.0[axis], corners.1[axis]) = (a.min(b), a.max(b));
            }
            let shape = Aabb::new(corners.0.into(), corners.1.into()).unwrap();
            hits += usize::from(overlaps(&store, &shape) == slicewalk::query::Overlap::Hit);
            assert_eq!(overlaps(&own, &shape), overlaps(&store, &shape), "{shape:?} in {bounds:?}");
            let (Answer::Known(a), Answer::Known(b)) = (probe(&own, &shape), probe(&store, &shape)) else {
                panic!("all is in memory");
            };
            assert_eq!((a.hit, a.obstacle), (b.hit, b.obstacle), "{shape:?} in {bounds:?}");
            // A floor may be far below the box, outside the region.
            if b.floor_z.is_some_and(|z| z >= bounds.0[2]) {
                assert_eq!(a.floor_z, b.floor_z, "{shape:?} in {bounds:?}");
            }
            let centre = (shape.min().coords + shape.max().coords) / 2.0;
            let size = shape.max() - shape.min();
            let sphere = Sphere::new(centre.into(), size.min() / 2.0).unwrap();
            assert_eq!(overlaps(&own, &sphere), overlaps(&store, &sphere), "{sphere:?} in {bounds:?}");
            let foot = nalgebra::Point3::new(centre.x, centre.y, shape.min().z);
            let cylinder = Cylinder::new(foot, size.x.min(size.y) / 2.0, size.z).unwrap();
            assert_eq!(overlaps(&own, &cylinder), overlaps(&store, &cylinder), "{cylinder:?} in {bounds:?}");
            if size.y > 0.01 {
                // Along the face of the region, where both sides count.
                let from = nalgebra::Point3::new(bounds.0[0], shape.min().y, shape.min().z);
                let ray = Ray::new(from, nalgebra::Vector3::new(0.0, size.y, 0.0), size.y).unwrap();
                assert_eq!(cast(&own, &ray), cast(&store, &ray), "{ray:?} in {bounds:?}");
            }
            if size.norm() > 0.01 {
                let ray = Ray::new(shape.min(), size, size.norm()).unwrap();
                assert_eq!(cast(&own, &ray), cast(&store, &ray), "{ray:?} in {bounds:?}");
            }
        }
    }
    assert!(hits > 100, "{hits} boxes met anything");
    let everything: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    let target = folder.path().join("all.slices");
    extract(&whole, &everything, &target, false, &NoMonitor).unwrap();
    assert!(fs::read(&target).unwrap() == good, "all of it, byte for byte");
    let nothing: Bounds = ([500.0; 3], [501.0; 3]);
    let header = extract(&whole, &nothing, &target, true, &NoMonitor).unwrap().header;
    assert!(header.pages.total() == 0 && header.bounds.is_none());
    assert!(extract(&whole, &([1.0; 3], [0.0; 3]), &target, true, &NoMonitor).is_err());
    assert!(render(&verified(&target)).contains("points read 5000"));
}

#[test]
fn an_edited_archive_is_written_as_it_answers() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("edited.slices");
    let made = scene();
    let (mut random, mut changed) = (Random(11), 0);
    for number in 0..30 {
        let mut between =
            |low: f64, high: f64| low + (high - low) * f64::from(random.below(1 << 20)) / f64::from(1 << 20);
        let (mut edits, mut corners) = (Edits::default(), Vec::new());
        for edit in 0..4 {
            // Around the scene and in it, so that pages are changed, emptied and added, also beyond its bounds.
            let low = [between(-8.0, 18.0), between(-22.0, 6.0), between(-18.0, 25.0)];
            let high = [0, 1, 2].map(|axis| low[axis] + between(0.02, [3.0, 3.0, 12.0][axis]));
            corners.extend([low, high]);
            let prism = Prism::of_box(low, high).unwrap();
            match edit % 2 {
                0 => edits.remove(prism).unwrap(),
                _ => edits.add(prism, number % 2 == 0).unwrap(),
            }
        }
        // A whole column is emptied.
        edits.remove(Prism::of_box([6.3, -0.1, -30.0], [12.9, 6.5, 30.0]).unwrap()).unwrap();
        let whole = Archive::from_bytes(archive(&made)).unwrap();
        let before = Snapshot::resident(&whole, &NoMonitor).unwrap();
        let edited = whole.with_edits(edits);
        let expected = Snapshot::resident(&edited, &NoMonitor).unwrap();
        let everything: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
        let header = extract(&edited, &everything, &target, true, &NoMonitor).unwrap().header;
        let found = verified(&target);
        assert_eq!((found.header(), found.edits()), (&header, None));
        let found = Snapshot::resident(&found, &NoMonitor).unwrap();
        for _ in 0..200 {
            let corner = corners[between(0.0, 8.0) as usize];
            let low = corner.map(|at| at + between(-1.0, 1.0));
            let high = low.map(|at| at + between(0.0, 1.0));
            let shape = Aabb::new(low.into(), high.into()).unwrap();
            assert_eq!(probe(&found, &shape), probe(&expected, &shape), "{number}: {shape:?}");
            changed += usize::from(probe(&before, &shape) != probe(&expected, &shape));
            let direction = nalgebra::Vector3::from(low) - nalgebra::Vector3::new(5.0, -7.0, 3.0);
            let ray = Ray::new([5.0, -7.0, 3.0].into(), direction, 60.0).unwrap();
            assert_eq!(cast(&found, &ray), cast(&expected, &ray), "{number}: {ray:?}");
        }
    }
    assert!(changed > 300, "{changed} boxes met an edit");
    // Edits that change nothing give the same bytes.
    let mut edits = Edits::default();
    edits.remove(Prism::of_box([-7.0, -7.0, -90.0], [7.0, 7.0, -80.0]).unwrap()).unwrap();
    let edited = Archive::from_bytes(archive(&made)).unwrap().with_edits(edits);
    extract(&edited, &([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]), &target, true, &NoMonitor).unwrap();
    assert!(fs::read(&target).unwrap() == archive(&made));
}

#[test]
fn edits_of_too_many_pages_and_beyond_all_tiles_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("e.slices");
    let refused = |bytes: Vec<u8>, edits: Edits| {
        let edited = Archive::from_bytes(bytes).unwrap().with_edits(edits);
        let everything: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
        let error = extract(&edited, &everything, &target, false, &NoMonitor).unwrap_err().to_string();
        assert!(!target.exists());
        error
    };
    // A tile column of 2²⁰ pages.
    let mut edits = Edits::default();
    edits.remove(Prism::of_box([0.5, 0.5, 0.5], [1.0, 1.0, 1.0]).unwrap()).unwrap();
    let said = refused(giant(&archive(&two_pixels()), 1), edits);
    assert!(said.contains("pages that edits change") && said.contains("65537 is beyond the limit of 65536"), "{said}");
    // New pages, in three layers of 200 by 120 tile columns, none of them at the origin.
    let (tile, layer) = (64.0 * plan().frame.pixel_m(), 64.0 * plan().frame.slice_m());
    let (low, high) = ([3.5 * tile, 7.5 * tile, 1.5 * layer], [202.5 * tile, 126.5 * tile, 3.5 * layer]);
    let mut edits = Edits::default();
    edits.add(Prism::of_box(low, high).unwrap(), true).unwrap();
    let said = refused(archive(&two_pixels()), edits);
    assert!(said.contains("72000 is beyond the limit of 65536"), "{said}");
    // Pixels of a millimetre, 64 in a tile.
    let fine = archive_of(&Plan { frame: Frame::new(0.001, 0.3).unwrap(), ..plan() }, &Default::default(), None);
    for (x, tile) in [(9e8 + 0.5, "14062500007"), (-9e8 - 0.5, "14062500008")] {
        let mut edits = Edits::default();
        edits.add(Prism::of_box([x, 0.0, 0.0], [x + 0.01, 0.01, 0.2]).unwrap(), true).unwrap();
        let said = refused(fine.clone(), edits);
        assert!(said.contains(&format!("tile of an edit: {tile} is beyond the limit of 2147483647")), "{said}");
    }
}

#[test]
fn edits_of_an_archive_whose_heights_are_slice_boundaries_are_exact() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("e.slices");
    let slab = page([((0, 0), vec![Span::new(0, 510, true).unwrap()])]);
    let frame = plan().frame;
    let whole = archive(&(Pages::from([(key(0, 0, 0), slab)]), Totals::default()));
    let mut edits = Edits::default();
    let (pixel, quantum) = (frame.pixel_m(), frame.slice_m() / 255.0);
    edits.remove(Prism::of_box([-pixel, -pixel, 100.0 * quantum], [pixel, pixel, 1.0]).unwrap()).unwrap();
    let edited = Archive::from_bytes(whole).unwrap().with_edits(edits);
    let everything: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    extract(&edited, &everything, &target, false, &NoMonitor).unwrap();
    let pages = read_all(&verified(&target)).unwrap();
    let [span] = pages[&key(0, 0, 0)].column(0, 0) else { panic!("one span") };
    assert!(span.bottom() == 0 && (100..=101).contains(&span.top()), "{span:?}");
}

/// A block in this group of layers with cells of one page, and of one page all.
fn seen_block(tx: i32, group: i32) -> SeenBlock {
    let (mut block, mut some) = (SeenBlock::new(key(tx, 0, group)), SeenPage::NOTHING);
    some.mark([[2, 5], [0, 3], [1, 3]]);
    block.push(0, &some);
    block.push(1, &SeenPage::ALL);
    block
}

#[test]
fn seen_space_has_a_limit_of_memory_and_its_sound_blocks_are_recovered() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, target] = ["a.slices", "e.slices"].map(|name| folder.path().join(name));
    let mut writer = ArchiveWriter::create(&whole, &plan(), false).unwrap();
    writer.set_seen();
    (0..300).for_each(|tx| writer.put_seen(&seen_block(tx, 1)).unwrap());
    writer.finish(totals(1)).unwrap();
    let archive = verified(&whole);
    // A page seen in part takes 16 by 16 by 64 bits, a block 64 bytes more.
    let memory = 300 * (16 * 16 * 64 / 8 + 64);
    assert_eq!(archive.seen_space(memory).unwrap().unwrap().pages().count(), 600);
    let said = archive.seen_space(memory - 1).unwrap_err().to_string();
    assert!(said.contains(&format!("{memory} is beyond the limit of {}", memory - 1)), "{said}");
    // Above the first 64 layers, too: both pages of a block, or only the upper one, slices above the block's floor.
    let height = 64.0 * 64.0 * plan().frame.slice_m();
    for (from, pages) in [(0.1, 2), (20.0, 1)] {
        let region = ([0.0, 0.0, height + from], [6.0, 6.0, height + 30.0]);
        extract(&archive, &region, &target, true, &NoMonitor).unwrap();
        assert_eq!(verified(&target).seen_space(1 << 30).unwrap().unwrap().pages().count(), pages);
    }

    let start = archive.header().pages_offset() as usize;
    let mut bytes = fs::read(&whole).unwrap();
    bytes[start] ^= 1;
    fs::write(&target, bytes).unwrap();
    let recovered = recover(&target, None, &folder.path().join("r.slices"), false, &NoMonitor).unwrap();
    // The page of all cells, and 4 by 4 by 3 of the other.
    let lost = 16 * 16 * 64 + 48;
    let all = 300 * lost;
    let expected = format!("{lost} of {all} cells of seen space (damaged)");
    assert!(recovered.dropped.contains(&expected), "{:?}", recovered.dropped);
    let space = verified(&folder.path().join("r.slices")).seen_space(1 << 30).unwrap().unwrap();
    assert_eq!(space.pages().count(), 598);
}

#[test]
fn a_page_that_states_more_bytes_than_any_has_costs_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let good = archive(&two_pixels());
    let header = Archive::from_bytes(good.clone()).unwrap().header().clone();
    let (start, end) = (header.pages_offset() as usize, header.directory_offset() as usize);
    // Magic, key, length of the body and checksum, and room for the body.
    let mut long = good[start..start + 16].to_vec();
    long.extend(30_000_000u32.to_le_bytes());
    long.extend([0; 4]);
    long.resize(32_000_000, 0);
    let [from, to] = ["bad.slices", "c.slices"].map(|name| folder.path().join(name));
    fs::write(&from, [&long, &good[start..end]].concat()).unwrap();
    let recovered = recover(&from, Some(&plan()), &to, false, &NoMonitor).unwrap();
    assert_eq!(recovered.found.total(), 1);
    assert_eq!(read_all(&verified(&to)).unwrap(), two_pixels().0);
}

#[test]
fn an_archive_without_pages_is_recovered_and_one_that_lost_all_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let (done, pages) = recovered(folder.path(), &archive(&Default::default()));
    assert!(done.is_complete() && pages.is_empty());
    // Without its footer it ends with its head.
    let mut bytes = archive(&Default::default());
    bytes.truncate(Archive::from_bytes(bytes.clone()).unwrap().header().bytes.head as usize);
    assert!(recovered(folder.path(), &bytes).0.identical);
    let mut bytes = archive(&two_pixels());
    let header = Archive::from_bytes(bytes.clone()).unwrap().header().clone();
    bytes[header.pages_offset() as usize..header.directory_offset() as usize].fill(0);
    let [from, to] = ["bad.slices", "c.slices"].map(|name| folder.path().join(name));
    fs::write(&from, bytes).unwrap();
    let error = recover(&from, None, &to, false, &NoMonitor).unwrap_err().to_string();
    assert!(error.contains("no sound page is left"), "{error}");
}

#[test]
fn an_extract_has_the_seen_cells_that_meet_its_region() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, target] = ["a.slices", "e.slices"].map(|name| folder.path().join(name));
    let mut writer = ArchiveWriter::create(&whole, &plan(), false).unwrap();
    writer.set_seen();
    // The region has two layers of the first block, and no pixel of those cells of the second that were seen.
    let mut far = SeenPage::NOTHING;
    far.mark([[10, 12], [0, 3], [0, 63]]);
    let seen = [(0, [(0, SeenPage::ALL), (1, SeenPage::ALL), (5, SeenPage::ALL)].to_vec()), (1, vec![(0, far)])];
    for (tx, pages) in seen {
        let mut block = SeenBlock::new(key(tx, 0, 0));
        pages.iter().for_each(|(layer, cells)| block.push(*layer, cells));
        writer.put_seen(&block).unwrap();
    }
    writer.finish(totals(1)).unwrap();
    // Pixels 0 to 64 along x and 8 to 11 along y, slices 60 to 65, and one more on every side.
    let region = ([0.05, 0.85, 18.1], [6.45, 1.15, 19.6]);
    extract(&verified(&whole), &region, &target, false, &NoMonitor).unwrap();
    let seen = verified(&target).seen_space(1 << 30).unwrap().unwrap();
    let found: Vec<_> = seen.pages().collect();
    let expected = [(0, [59, 63]), (1, [0, 2])].map(|(layer, slices)| {
        let mut cells = SeenPage::NOTHING;
        cells.mark([[0, 15], [1, 3], slices]);
        (key(0, 0, layer), cells)
    });
    assert!(found == expected, "{:?}", found.iter().map(|(key, page)| (key, page.cells())).collect::<Vec<_>>());
}

#[test]
fn shared_bytes_are_read_once() {
    let bytes = common::sharing();
    let watched = common::Watched::new(&bytes, u64::MAX);
    let whole = Archive::from_source(Box::new(watched.clone())).unwrap();
    let reads = |work: &mut dyn FnMut()| {
        let before = watched.reads.load(Relaxed);
        work();
        watched.reads.load(Relaxed) - before
    };
    assert_eq!(whole.leaf_count(), 2);
    // Metadata, two leaves, the page.
    let verify = reads(&mut || {
        let summary = whole.verify(&NoMonitor, &mut |finding| panic!("{finding}")).unwrap();
        assert_eq!((summary.pages.stored, summary.pages.shared), (1, 4999));
    });
    assert_eq!(verify, 4);
    let stats = reads(&mut || assert_eq!(Stats::of(&whole).unwrap().pages, [1, 4999, 0]));
    // Adjacent leaves take one read.
    assert_eq!(stats, 2);
    let folder = tempfile::tempdir().unwrap();
    let extracted = reads(&mut || {
        let everything = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
        extract(&whole, &everything, &folder.path().join("a.slices"), false, &NoMonitor).unwrap();
    });
    assert_eq!(extracted, 3);
    assert!(fs::read(folder.path().join("a.slices")).unwrap() == bytes);
}

#[test]
fn pages_come_with_their_inferred_spans_or_without_them() {
    let folder = tempfile::tempdir().unwrap();
    let floor = |bottom| Span::new(bottom, bottom + 4, false).unwrap();
    let whole = page([((1, 1), vec![floor(10), floor(900)]), ((2, 1), vec![floor(10)])]);
    let mut inferred = Inferred::new();
    assert!(inferred.push(1, 1, 0b01) && inferred.push(2, 1, 0b1));
    let plan = Plan { options: PlanOptions { fill_holes: 3, ..plan().options }, ..plan() };
    let mut writer = ArchiveWriter::create(&folder.path().join("a.slices"), &plan, false).unwrap();
    let at = key(0, 0, 0);
    writer.put(at, PageEncoder::of_plan(&plan).encode_inferred(at, &whole, &inferred)).unwrap();
    assert_eq!(writer.finish(totals(1)).unwrap().voxels.inferred, 2);
    let archive = verified(&folder.path().join("a.slices"));
    let entry = archive.entries().next().unwrap().unwrap();
    let mut decoder = PageDecoder::new();
    assert_eq!(archive.page_with(&entry, &mut decoder).unwrap(), whole);
    assert_eq!(decoder.inferred(), &inferred);
    let scanned = archive.ignoring_inferred();
    assert_eq!(scanned.page_with(&entry, &mut decoder).unwrap(), page([((1, 1), vec![floor(900)])]));
    assert!(decoder.inferred().is_empty());
}

#[test]
fn levels_have_no_seen_space_and_no_section_of_it_is_longer_than_the_pages() {
    let folder = tempfile::tempdir().unwrap();
    let written = |levels: bool| {
        let target = folder.path().join("a.slices");
        let mut writer = ArchiveWriter::create(&target, &plan(), true).unwrap();
        if levels {
            writer.set_levels();
        }
        writer.set_seen();
        let mut encoder = PageEncoder::of_plan(&plan());
        for at in [key(0, 0, 0), key(20, 0, 0)] {
            writer.put(at, encoder.encode(at, &content(1))).unwrap();
        }
        writer.put_seen(&seen_block(0, 0)).unwrap();
        writer.finish(totals(1)).unwrap();
        fs::read(target).unwrap()
    };
    let archive = Archive::from_bytes(written(true)).unwrap();
    assert!(archive.seen_table().unwrap().is_some());
    assert!(archive.level(1).unwrap().seen_table().unwrap().is_none());
    let none = Archive::from_bytes(archive_with_levels(&plan(), &Default::default(), None)).unwrap();
    assert!(none.header().levels.is_some() && none.catalog().levels_range().is_none());
    // Its trailer states one byte more than all pages have.
    let mut parts = Parts::of(&written(false));
    let (len, trailer) = (parts.pages.len() as u64, parts.pages.len() - 40);
    put(&mut parts.pages, trailer + 8, len + 1, 8);
    let crc = crc32c::crc32c(&parts.pages[trailer..trailer + 36]);
    put(&mut parts.pages, trailer + 36, crc.into(), 4);
    let said = Archive::from_bytes(parts.build(|_| ())).unwrap().seen_table().unwrap_err().to_string();
    assert!(said.starts_with("rule V1: trailer of seen space"), "{said}");
}

#[test]
fn what_edits_leave_keeps_its_colours_and_inferred_spans() {
    let folder = tempfile::tempdir().unwrap();
    let [from, to] = ["a.slices", "e.slices"].map(|name| folder.path().join(name));
    let floor = |bottom| Span::new(bottom, bottom + 4, false).unwrap();
    // The lower floor of the first pixel is inferred, and has no colour.
    let stays = ((1, 1), vec![floor(10), floor(900)]);
    let whole = page([stays.clone(), ((40, 1), vec![floor(10)])]);
    let mut inferred = Inferred::new();
    assert!(inferred.push(1, 1, 0b01));
    let colours = ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 0 };
    let values = [None, Some([9000, 30_000, 50_000]), Some([60_000, 100, 7000])];
    let made = EncodedColours::new(&colours, &Occupancy::of(&whole), &values, &mut ColourEncoder::default());
    let plan = Plan { options: PlanOptions { fill_holes: 3, ..plan().options }, ..plan() };
    let mut writer = ArchiveWriter::create(&from, &plan, false).unwrap();
    writer.set_colours(colours);
    let at = key(0, 0, 0);
    writer.put(at, PageEncoder::of_plan(&plan).encode_inferred(at, &whole, &inferred).with_colours(made)).unwrap();
    writer.finish(totals(1)).unwrap();
    let archive = verified(&from);
    let before = colours_of(&archive)[&at].clone();
    assert!(before.len() == 3 && before[0][3] == 0 && before[1][3] > 0, "{before:?}");
    // All of the other pixel, which is that from 4 to 4.1 m.
    let mut edits = Edits::default();
    edits.remove(Prism::of_box([3.95, 0.05, -1.0], [4.15, 0.25, 1.0]).unwrap()).unwrap();
    let everything: Bounds = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    extract(&archive.with_edits(edits), &everything, &to, false, &NoMonitor).unwrap();
    let extracted = verified(&to);
    let entry = extracted.entries().next().unwrap().unwrap();
    let mut decoder = PageDecoder::new();
    assert_eq!(extracted.page_with(&entry, &mut decoder).unwrap(), page([stays]));
    assert_eq!(decoder.inferred(), &inferred);
    assert_eq!(colours_of(&extracted)[&at], before[..2]);
}
