//! The archive as a whole: pages come back by key and in order, and the same pages give the same file.

use super::*;
use crate::bytes::testing::{Fault, FaultySource};
use crate::bytes::{ByteSource, MemorySource};
use crate::codec::pages;
use crate::frame::{Frame, PageKey};
use crate::monitor::NoMonitor;
use crate::page::{Inferred, Page, PageBuilder, Span};
use crate::plan::{Classifier, Plan, PlanOptions};
use crate::seen::{SeenBlock, SeenPage};
use crate::{Error, Result};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

fn plan() -> Plan {
    let frame = Frame::new(0.05, 0.15).unwrap();
    let options = PlanOptions {
        classifier: Classifier::Span,
        exclude_classes: [7].into_iter().collect(),
        ..PlanOptions::default()
    };
    Plan { frame, options }
}

fn totals() -> Totals {
    let (crs, units) = ("EPSG:28992".into(), Vec::new());
    Totals {
        points_read: 9,
        points_kept: 5,
        points_withheld: 1,
        points_excluded: 2,
        bounds: None,
        crs,
        units,
        noise: None,
    }
}

fn write(target: &Path, pages: &BTreeMap<PageKey, Page>) -> Result<Header> {
    let mut writer = ArchiveWriter::create(target, &plan(), true)?;
    let mut encoder = PageEncoder::new(plan().frame);
    for (&key, page) in pages {
        writer.put(key, encoder.encode(key, page))?;
    }
    writer.finish(totals())
}

fn floor(height: u32) -> Page {
    let mut builder = PageBuilder::default();
    for pixel in 0..4096 {
        let bottom = height + pixel * 7919 % 11;
        assert!(builder.set_column(pixel % 64, pixel / 64, &[Span::new(bottom, bottom + 3, false).unwrap()]));
    }
    builder.build()
}

fn uniform(span: Span) -> Page {
    let mut builder = PageBuilder::default();
    for pixel in 0..4096 {
        assert!(builder.set_column(pixel % 64, pixel / 64, &[span]));
    }
    builder.build()
}

fn sound(archive: &Archive) -> VerifySummary {
    let mut findings = Vec::new();
    let summary = archive.verify(&NoMonitor, &mut |finding| findings.push(finding)).unwrap();
    assert_eq!(findings, []);
    assert_eq!(summary.bytes, archive.header().file_len);
    summary
}

/// Source that counts reads.
struct Counted(MemorySource, AtomicU64);

impl ByteSource for Counted {
    fn len(&self) -> u64 {
        self.0.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        self.1.fetch_add(1, Ordering::Relaxed);
        self.0.read_at(offset, buf)
    }
}

/// Source that counts reads, and does not answer those that begin in these bytes in time.
struct Silent(Counted, Range<u64>);

impl ByteSource for Silent {
    fn len(&self) -> u64 {
        self.0.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        self.0.read_at(offset, buf)?;
        match self.1.contains(&offset) {
            true => Err(Error::io("server", "read", std::io::ErrorKind::TimedOut.into())),
            false => Ok(()),
        }
    }
}

#[test]
fn what_is_no_archive_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.laz");
    std::fs::write(&scan, b"LASF and then more, longer than the head of any archive could be".repeat(20)).unwrap();
    for opened in [Archive::open(&scan), Archive::map(&scan)] {
        let said = opened.unwrap_err().to_string();
        assert!(said.contains("scan.laz") && said.contains("a slice archive"), "{said}");
    }
}

#[test]
fn an_empty_archive_is_an_archive() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("empty.slices");
    let header = write(&target, &BTreeMap::new()).unwrap();
    let archive = Archive::map(&target).unwrap();
    assert_eq!(archive.header(), &header);
    assert_eq!(archive.header().slices, None);
    assert_eq!(archive.crs().unwrap(), "EPSG:28992");
    assert_eq!(archive.find(PageKey { tx: 0, ty: 0, layer: 0 }).unwrap(), None);
    assert!(archive.level(1).unwrap_err().to_string().contains("no overview levels"));
    assert_eq!(sound(&archive).pages, Pages::default());
}

#[test]
fn equal_and_uniform_pages_take_no_bytes_and_no_read() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let key = |layer| PageKey { tx: -3, ty: 4, layer };
    let slab = uniform(Span::new(10, 300, true).unwrap());
    let pages =
        BTreeMap::from([(key(-1), floor(10)), (key(0), floor(10)), (key(1), slab.clone()), (key(2), floor(900))]);
    let header = write(&target, &pages).unwrap();
    assert_eq!(header.pages, Pages { stored: 2, shared: 1, uniform: 1 });
    assert_eq!(header.tiles, Tiles { occupied: 5, stored: 3, unique: 2 });
    assert_eq!(header.slices, Some((-64, 131)));
    let bytes = std::fs::read(&target).unwrap();
    let source = Arc::new(Counted(MemorySource::new(bytes), AtomicU64::new(0)));
    let archive = Archive::from_source(Box::new(source.clone())).unwrap();
    assert_eq!(source.1.load(Ordering::Relaxed), 1, "a small archive opens with one read");
    for (&key, page) in &pages {
        let entry = archive.find(key).unwrap().unwrap();
        assert_eq!(&archive.page(&entry).unwrap(), page);
    }
    assert_eq!(source.1.load(Ordering::Relaxed), 1 + 1 + 3, "one leaf, three pages, no read for the uniform one");
    sound(&archive);
}

#[test]
fn pages_with_one_span_everywhere_are_uniform_also_with_moved_heights() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let loose = Plan { options: PlanOptions { tolerance_m: 0.0101, ..PlanOptions::default() }, ..plan() };
    let mut writer = ArchiveWriter::create(&target, &loose, false).unwrap();
    let mut encoder = PageEncoder::of_plan(&loose);
    let key = |layer| PageKey { tx: 0, ty: 0, layer };
    // As many spans as pixels: the first pixel has two, the last one none.
    let mut builder = PageBuilder::default();
    for pixel in 0..4095 {
        let spans = [10, 20].map(|bottom| Span::new(bottom, bottom + 4, false).unwrap());
        let count = if pixel == 0 { 2 } else { 1 };
        assert!(builder.set_column(pixel % 64, pixel / 64, &spans[..count]));
    }
    let uneven = builder.build();
    assert_eq!(uneven.span_count(), 4096);
    writer.put(key(0), encoder.encode(key(0), &uneven)).unwrap();
    let (moved, page) = encoder.encode_lossy(key(1), &uniform(Span::new(255, 255, false).unwrap()), &Inferred::new());
    writer.put(key(1), moved).unwrap();
    let header = writer.finish(totals()).unwrap();
    assert_eq!(header.pages, Pages { stored: 1, shared: 0, uniform: 1 });
    let archive = Archive::open(&target).unwrap();
    let read = |layer| archive.page(&archive.find(key(layer)).unwrap().unwrap()).unwrap();
    assert_eq!((read(0), read(1)), (uneven, page));
    let (span, most) = (read(1).column(63, 63)[0], loose.tolerance_quanta());
    assert!((255 - most..=255).contains(&span.bottom()) && (255..=255 + most).contains(&span.top()), "{span:?}");
    sound(&archive);
}

/// A page with solid in one pixel.
fn pixel(px: u32) -> Page {
    let mut builder = PageBuilder::default();
    assert!(builder.set_column(px, 9, &[Span::new(7, 8, false).unwrap()]));
    builder.build()
}

#[test]
fn pages_with_the_same_hash_are_told_apart_by_their_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    let mut encoder = PageEncoder::new(plan().frame);
    let key = |layer| PageKey { tx: 0, ty: 0, layer };
    let one = encoder.encode(key(0), &pixel(0));
    let mut others = (1..64).map(|px| (px, encoder.encode(key(1), &pixel(px))));
    let (px, mut other) = others.find(|(_, other)| other.bytes.len() == one.bytes.len()).unwrap();
    other.hash = one.hash;
    let first = writer.put_placed(key(0), &one).unwrap();
    let second = writer.put_placed(key(1), &other).unwrap();
    // The writer remembers only the last page of a hash.
    let again = |writer: &mut ArchiveWriter, placed| writer.put_again(key(2), placed, &[], &EncodedColours::default());
    assert!(!again(&mut writer, &first).unwrap());
    assert!(again(&mut writer, &second).unwrap());
    writer.put(key(3), encoder.encode(key(3), &pixel(0))).unwrap();
    let header = writer.finish(totals()).unwrap();
    assert_eq!(header.pages, Pages { stored: 3, shared: 1, uniform: 0 });
    let archive = Archive::open(&target).unwrap();
    for (layer, px) in [(0, 0), (1, px), (2, px), (3, 0)] {
        assert_eq!(archive.page(&archive.find(key(layer)).unwrap().unwrap()).unwrap(), pixel(px), "layer {layer}");
    }
    sound(&archive);
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_page_shares_the_bytes_of_the_last_65536_distinct_ones_and_no_others() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    let mut encoder = PageEncoder::new(plan().frame);
    let page = |number: u32| {
        let mut builder = PageBuilder::default();
        assert!(builder.set_column(number / 16000, 9, &[Span::new(number % 16000, 16100, false).unwrap()]));
        builder.build()
    };
    // One page more than are remembered; then again the first, which is forgotten, the third, which is now the oldest
    // one remembered, and the second, which was forgotten for the first.
    let numbers = (0..=65536).chain([0, 2, 1]);
    for (layer, number) in (0..).zip(numbers.clone()) {
        let key = PageKey { tx: 0, ty: 0, layer };
        writer.put(key, encoder.encode(key, &page(number))).unwrap();
    }
    let header = writer.finish(totals()).unwrap();
    assert_eq!(header.pages, Pages { stored: 65537 + 2, shared: 1, uniform: 0 });
    let archive = Archive::open(&target).unwrap();
    sound(&archive);
    for (entry, number) in archive.entries().zip(numbers).skip(65536) {
        assert_eq!(archive.page(&entry.unwrap()).unwrap(), page(number));
    }
}

#[test]
fn whole_leaves_may_share_one_page() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    let mut builder = PageBuilder::default();
    assert!(builder.set_column(5, 6, &[Span::new(7, 8, false).unwrap()]));
    let (page, mut encoder) = (builder.build(), PageEncoder::new(plan().frame));
    let count = 3 * 4096;
    for layer in 0..count {
        let key = PageKey { tx: 0, ty: 0, layer };
        writer.put(key, encoder.encode(key, &page)).unwrap();
    }
    let header = writer.finish(totals()).unwrap();
    assert_eq!(header.pages, Pages { stored: 1, shared: count as u64 - 1, uniform: 0 });
    let archive = Archive::open(&target).unwrap();
    let last = archive.find(PageKey { tx: 0, ty: 0, layer: count - 1 }).unwrap().unwrap();
    assert_eq!(archive.page(&last).unwrap(), page);
    sound(&archive);
}

#[test]
fn a_large_archive_has_a_padded_head_many_leaves_and_opens_with_two_reads() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("large.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    let mut encoder = PageEncoder::new(plan().frame);
    let key = |at: u64| PageKey::from_column((3 << 62) | (at / 7), (at % 7) as i32 - 3);
    let count = 40_000u64;
    let page = |at: u64| {
        let mut builder = PageBuilder::default();
        let spans = [Span::new(at as u32 % 16000, 16100, at.is_multiple_of(2)).unwrap()];
        // Every 100th page equals others; the rest differ in their pixels.
        let pixel = if at.is_multiple_of(100) { 5 } else { (at / 16000 + 1) as u32 };
        for px in 0..pixel {
            assert!(builder.set_column(px, 9, &spans));
        }
        builder.build()
    };
    for at in 0..count {
        writer.put(key(at), encoder.encode(key(at), &page(at))).unwrap();
    }
    let header = writer.finish(totals()).unwrap();
    assert!(header.pages.shared > 0);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the temporary file of entries is gone");
    let counted = || Counted(MemorySource::new(std::fs::read(&target).unwrap()), AtomicU64::new(0));
    let source = Arc::new(counted());
    let archive = Archive::from_source(Box::new(source.clone())).unwrap();
    assert_eq!(source.1.load(Ordering::Relaxed), 2);
    assert_eq!(archive.header(), &header);
    assert_eq!((header.bytes.head, archive.leaf_count()), (16384, 10));
    let entries: Vec<_> = archive.entries().collect::<Result<_>>().unwrap();
    assert!(entries.iter().map(|entry| entry.key).eq((0..count).map(key)));
    for at in (0..count).step_by(997) {
        let entry = archive.find(key(at)).unwrap().unwrap();
        assert_eq!(archive.page(&entry).unwrap(), page(at));
    }
    assert_eq!(archive.find(key(count)).unwrap(), None);
    sound(&archive);
    // One read fetches several leaves; bytes that cannot be read cost their own leaf alone.
    let faulty = Arc::new(FaultySource::new(MemorySource::new(std::fs::read(&target).unwrap())));
    let struck = Archive::from_source(Box::new(faulty.clone())).unwrap();
    let mut first = 0;
    for leaf in 0..archive.leaf_count() {
        let bytes = archive.catalog().leaf_range(leaf);
        faulty.set(Fault::Fail, bytes.end - 1..bytes.end);
        let (found, failed): (Vec<_>, Vec<_>) = struck.entries().partition(Result::is_ok);
        assert!(matches!(failed[..], [Err(Error::Io { .. })]), "leaf {leaf}: {} errors", failed.len());
        let end = first + archive.leaf(leaf).unwrap().len();
        let expected = entries[..first].iter().chain(&entries[end..]);
        assert!(found.into_iter().map(Result::unwrap).eq(expected.copied()), "leaf {leaf}");
        first = end;
    }
    // A server that does not answer is not asked twice for a leaf: each question takes its time.
    let silent = Arc::new(Silent(counted(), header.directory_offset()..header.metadata_offset()));
    let waiting = Archive::from_source(Box::new(silent.clone())).unwrap();
    let before = silent.0.1.load(Ordering::Relaxed);
    assert_eq!(waiting.entries().filter(Result::is_err).count(), 10);
    assert_eq!(silent.0.1.load(Ordering::Relaxed) - before, 10);
}

#[test]
fn a_page_is_decoded_from_exactly_its_own_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let key = PageKey { tx: 0, ty: 0, layer: 0 };
    write(&target, &BTreeMap::from([(key, floor(10))])).unwrap();
    let archive = Archive::open(&target).unwrap();
    let entry = archive.find(key).unwrap().unwrap();
    let extent = entry.extent().unwrap();
    let mut bytes = vec![0; extent.len as usize + 1];
    archive.source().read_at(extent.offset, &mut bytes).unwrap();
    let (longer, mut decoder) = (bytes.clone(), PageDecoder::new());
    bytes.pop();
    assert_eq!(decoder.decode(&entry, &bytes).unwrap(), floor(10));
    for wrong in [&longer[..], &bytes[1..], &bytes[..20], &[]] {
        let said = decoder.decode(&entry, wrong).unwrap_err().to_string();
        assert!(said.contains("rule P1"), "{} bytes: {said}", wrong.len());
    }
    // An entry made by hand, of more bytes than any page has.
    let storage = Storage::Stored(Extent { len: u32::MAX, ..extent });
    assert!(matches!(archive.page(&PageEntry { storage, ..entry }), Err(Error::Limit { .. })));
    // No page of a level has such heights.
    assert!(!PageEncoder::of_levels().gives(&floor(10), &Inferred::new(), &bytes));
}

#[test]
fn keys_must_ascend_and_pages_hold_matter() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    let mut encoder = PageEncoder::new(plan().frame);
    let key = |layer| PageKey { tx: 0, ty: 0, layer };
    writer.put(key(1), encoder.encode(key(1), &floor(0))).unwrap();
    for (put, encoded, page) in [(key(1), key(1), floor(0)), (key(0), key(0), floor(0)), (key(3), key(2), floor(0))] {
        assert!(matches!(writer.put(put, encoder.encode(encoded, &page)), Err(Error::Parameter { .. })));
    }
    let empty = encoder.encode(key(4), &PageBuilder::default().build());
    assert!(matches!(writer.put(key(4), empty), Err(Error::Parameter { .. })));
    let contradiction = Totals { points_kept: 2, points_read: 1, ..Totals::default() };
    assert!(writer.finish(contradiction).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
}

#[test]
fn what_an_archive_has_no_place_for_is_refused_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    let mut encoder = PageEncoder::new(plan().frame);
    let key = |layer| PageKey { tx: 0, ty: 0, layer };
    let seen = |layer| {
        let mut block = SeenBlock::new(key(layer));
        block.push(0, &SeenPage::ALL);
        block
    };
    let refused = |result: Result<()>, words: &str| {
        let said = result.unwrap_err();
        assert!(matches!(said, Error::Parameter { .. }) && said.to_string().contains(words), "{words}: {said}");
    };
    let mut inferred = Inferred::new();
    assert!(inferred.push(0, 0, 1));
    refused(writer.put(key(0), encoder.encode_inferred(key(0), &floor(10), &inferred)), "the plan fills no holes");
    refused(writer.put_seen(&seen(0)), "without seen space");
    refused(writer.end_seen().map(drop), "without it");
    writer.set_seen();
    writer.put(key(0), encoder.encode(key(0), &floor(10))).unwrap();
    writer.put_seen(&seen(0)).unwrap();
    // The block again, one below it, one without cells, and one beyond the grid.
    for wrong in [seen(0), seen(-1), SeenBlock::new(key(1)), seen(1 << 24)] {
        refused(writer.put_seen(&wrong), "ascending keys in the grid");
    }
    refused(writer.put(key(1), encoder.encode(key(1), &floor(20))), "pages come first");
    assert_eq!(writer.finish(totals()).unwrap().pages.total(), 1);
    let archive = Archive::open(&target).unwrap();
    assert_eq!(archive.seen_table().unwrap().unwrap().cells(), SeenPage::CELLS);
    sound(&archive);
}

#[test]
fn bounds_are_those_of_the_matter_or_fit_it() {
    let folder = tempfile::tempdir().unwrap();
    let key = PageKey { tx: -3, ty: 4, layer: 1 };
    let write = |name: &str, bounds| {
        let mut writer = ArchiveWriter::create(&folder.path().join(name), &plan(), false).unwrap();
        writer.put(key, PageEncoder::new(plan().frame).encode(key, &floor(100))).unwrap();
        writer.finish(Totals { bounds, ..totals() })
    };
    let (min, max) = write("a.slices", None).unwrap().bounds.unwrap();
    let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    let quanta = |n: f64| 9.6 + n * 0.15 / 255.0;
    assert!(near(min, [-9.6, 12.8, quanta(100.0)]) && near(max, [-6.4, 16.0, quanta(113.0)]), "{min:?} {max:?}");
    sound(&Archive::open(folder.path().join("a.slices")).unwrap());
    let inside = ([min[0] + 0.04, min[1], min[2]], [max[0] - 0.04, max[1], max[2]]);
    write("b.slices", Some(inside)).unwrap();
    let outside = ([min[0] + 0.06, min[1], min[2]], max);
    let error = write("c.slices", Some(outside)).unwrap_err().to_string();
    assert!(error.contains("bounds") && !folder.path().join("c.slices").exists(), "{error}");
}

#[test]
fn the_old_archive_stays_until_the_new_one_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let key = PageKey { tx: 0, ty: 0, layer: 0 };
    write(&target, &BTreeMap::from([(key, floor(1))])).unwrap();
    let old = std::fs::read(&target).unwrap();
    let refused = ArchiveWriter::create(&target, &plan(), false).unwrap_err();
    assert!(refused.to_string().contains("allow it to be replaced"), "{refused}");
    let mut writer = ArchiveWriter::create(&target, &plan(), true).unwrap();
    writer.put(key, PageEncoder::new(plan().frame).encode(key, &floor(2))).unwrap();
    assert_eq!(std::fs::read(&target).unwrap(), old);
    drop(writer);
    assert_eq!(std::fs::read(&target).unwrap(), old);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    write(&target, &BTreeMap::from([(key, floor(2))])).unwrap();
    assert_ne!(std::fs::read(&target).unwrap(), old);
}

#[cfg(unix)]
#[test]
fn an_archive_has_the_permissions_of_any_new_file() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (target, plain) = (folder.path().join("a.slices"), folder.path().join("plain"));
    write(&target, &BTreeMap::new()).unwrap();
    std::fs::write(&plain, "").unwrap();
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&target), mode(&plain));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn what_is_put_comes_back(pages in proptest::collection::btree_map((-2i32..2, -2i32..2, -3i32..3), pages(), 0..8)) {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let key = |(tx, ty, layer)| PageKey { tx, ty, layer };
        let pages: BTreeMap<PageKey, Page> = pages.into_iter().map(|(at, page)| (key(at), page)).collect();
        let header = write(&target, &pages).unwrap();
        let archive = Archive::open(&target).unwrap();
        prop_assert_eq!(archive.header(), &header);
        prop_assert_eq!(archive.plan(), &plan());
        let read = archive.entries().map(|entry| { let entry = entry?; Ok((entry.key, archive.page(&entry)?)) });
        prop_assert_eq!(read.collect::<Result<BTreeMap<_, _>>>().unwrap(), pages.clone());
        sound(&archive);
        let again = folder.path().join("b.slices");
        write(&again, &pages).unwrap();
        prop_assert_eq!(std::fs::read(&target).unwrap(), std::fs::read(&again).unwrap());
    }
}
