//! Small archives with millions of pages: code that visits all of them needs memory for only a few. The heap is
//! counted.

mod common;
#[path = "common/heap.rs"]
mod heap;

use common::forge::giant;
use common::{archive, two_pixels};
use heap::measured;
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, extract, recover, replace};
use slicewalk::stats::Stats;
use std::fs;

/// The only test of this file, because others would allocate at the same time.
#[test]
fn a_million_pages_in_a_thousand_bytes_take_memory_for_few() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let bytes = giant(&archive(&two_pixels()), 2);
    assert!(bytes.len() < 2000, "{} bytes", bytes.len());
    let pages = 2 << 20;
    fs::write(path("giant.slices"), &bytes).unwrap();
    let whole = Archive::open(path("giant.slices")).unwrap();
    // A leaf of 2²⁰ entries has 7 MiB of columns, twice in memory while it is unpacked.
    const LEAF: usize = 16 << 20;

    let (summary, peak) = measured(|| whole.verify(&NoMonitor, &mut |finding| panic!("{finding}")).unwrap());
    assert_eq!((summary.findings, summary.pages.uniform), (0, pages));
    assert!(peak < LEAF, "verify: {peak} bytes");

    let (refused, peak) = measured(|| Stats::of(&whole).unwrap_err().to_string());
    // A growing table of layers is in memory twice.
    assert!(refused.contains("extract") && peak < LEAF + (48 << 20), "{refused}, {peak} bytes");
    let half = Archive::from_bytes(giant(&bytes, 1)).unwrap();
    let (stats, peak) = measured(|| Stats::of(&half).unwrap());
    assert_eq!((stats.pages, stats.voxels), ([0, 0, pages / 2], 4096 * pages / 2));
    assert!(peak < LEAF + (32 << 20), "stats: {peak} bytes");

    let region = ([0.0, 0.0, 1e6], [1.0, 1.0, 1e6 + 40.0]);
    let (cut, peak) = measured(|| extract(&whole, &region, &path("cut.slices"), false, &NoMonitor).unwrap());
    assert_eq!(cut.header.pages.total(), 2);
    assert!(peak < LEAF + (8 << 20), "extract: {peak} bytes");

    let (recovered, peak) =
        measured(|| recover(&path("giant.slices"), None, &path("again.slices"), false, &NoMonitor).unwrap());
    assert!(recovered.is_complete() && recovered.found.uniform == pages, "{recovered:?}");
    assert!(peak < LEAF + (24 << 20), "recover: {peak} bytes");
    fs::write(path("more.slices"), giant(&bytes, 5)).unwrap();
    let refused = recover(&path("more.slices"), None, &path("no.slices"), false, &NoMonitor).unwrap_err().to_string();
    assert!(refused.contains("more.slices") && refused.contains("4194304") && !path("no.slices").exists(), "{refused}");
    let [more, other, none] = ["more.slices", "giant.slices", "no.slices"].map(path);
    let refused = replace(&more, &other, &region, &none, false, &NoMonitor).unwrap_err().to_string();
    assert!(refused.contains("more.slices: directory") && refused.contains("4194304") && !none.exists(), "{refused}");
    let more = Archive::open(more).unwrap();
    let refused = more.verify(&NoMonitor, &mut |finding| panic!("{finding}")).unwrap_err().to_string();
    assert!(
        refused.contains("5242880 is beyond the limit of 4194304") && refused.contains("larger pixels"),
        "{refused}"
    );
    let mut entries = more.entries();
    assert!(entries.next().unwrap().is_err() && entries.next().is_none());
    let key = more.leaf_first(3);
    assert_eq!(more.find(key).unwrap().unwrap().key, key, "a page here and there is no trouble");
}
