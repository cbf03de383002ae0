//! The archive as a whole: pages come back by key and in order, and the same pages give the same file.

use super::*;
use crate::bytes::testing::{Fault, FaultySource};
use crate::bytes::{ByteSource, MemorySource};
use crate::codec::pages;
use crate::frame::{Frame, PageKey};
use crate::monitor::NoMonitor;
use crate::page::{Page, PageBuilder, Span};
use crate::plan::{Classifier, Plan, PlanOptions};
use crate::{Error, Result};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
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
    let source = std::sync::Arc::new(Counted(MemorySource::new(bytes), AtomicU64::new(0)));
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
    let source = std::sync::Arc::new(Counted(MemorySource::new(std::fs::read(&target).unwrap()), AtomicU64::new(0)));
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
    let faulty = std::sync::Arc::new(FaultySource::new(MemorySource::new(std::fs::read(&target).unwrap())));
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
