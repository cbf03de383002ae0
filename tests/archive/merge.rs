//! Parts that make the whole, at once or in runs, and parts that cannot be merged: what each says, and what differs
//! from another.

use crate::common;
use crate::levels::halves_at;

use common::forge::{Parts, put, word};
use common::{Pages, archive_coloured_by_place, archive_of, key, page, plan, scene};
use slicewalk::NoMonitor;
use slicewalk::archive::{
    Archive, ArchiveWriter, InputRead, PageEncoder, Shard, Totals, extract, merge, merge_run, recover,
};
use slicewalk::page::{Inferred, Span};
use slicewalk::plan::{Noise, Plan, PlanOptions};
use slicewalk::seen::{SeenBlock, SeenPage};
use slicewalk::unit::LengthUnit;
use std::fs;
use std::path::{Path, PathBuf};

fn totals(points: u64) -> Totals {
    let units = vec![LengthUnit::of(0.3048)];
    Totals { points_read: points + 3, points_kept: points, crs: "here".into(), units, ..Totals::default() }
}

/// Two parts that meet at the column of page (0, 0).
fn halves() -> [Shard; 2] {
    halves_at(key(0, 0, 0))
}

/// One of the two parts, with a page of its own and what `more` adds.
fn half(at: usize, more: impl FnOnce(&mut ArchiveWriter)) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("half.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    writer.set_shard(halves()[at]);
    let own = [key(-1, -1, 0), key(0, 0, 0)][at];
    let content = page([((1, 1), vec![Span::new(5, 9, false).unwrap()])]);
    writer.put(own, PageEncoder::of_plan(&plan()).encode(own, &content)).unwrap();
    more(&mut writer);
    writer.finish(totals(1)).unwrap();
    fs::read(target).unwrap()
}

#[test]
fn parts_that_differ_or_say_what_is_not_so_are_refused_by_name() {
    let part = |at: usize, totals: Totals| {
        let own = scene().0.into_iter().filter(|(key, _)| halves()[at].columns().contains(&key.column()));
        (own.collect::<Pages>(), totals)
    };
    let made = |at: usize, totals: Totals| archive_of(&plan(), &part(at, totals), Some(halves()[at]));
    let coloured = |at: usize| archive_coloured_by_place(&part(at, totals(1)), 0, false, Some(halves()[at]));
    let forged = |bytes: Vec<u8>, at: usize, value: u64| Parts::of(&bytes).build(|head| put(head, at, value, 8));
    // Seen space in the column of page (tile, tile).
    let seen = |at: usize, tile: i32| {
        half(at, |writer| {
            let mut block = SeenBlock::new(key(tile, tile, 0));
            block.push(3, &SeenPage::ALL);
            writer.set_seen();
            writer.put_seen(&block).unwrap();
        })
    };
    let miscounted = || {
        let mut parts = Parts::of(&seen(1, 0));
        let trailer = parts.pages.len() - 40;
        put(&mut parts.pages, trailer + 16, SeenPage::CELLS - 1, 8);
        let crc = crc32c::crc32c(&parts.pages[trailer..trailer + 36]);
        put(&mut parts.pages, trailer + 36, crc.into(), 4);
        parts.build(|_| ())
    };
    let reading = |at: usize, hash: u128| {
        let read = vec![InputRead { input: 3, hash, name: String::new() }];
        half(at, |writer| writer.set_read(read))
    };
    let (first, good) = (|| made(0, totals(1)), || made(1, totals(2)));
    let there = || Totals { crs: "there".into(), ..totals(2) };
    let in_nothing = Totals { units: Vec::new(), ..totals(2) };
    let many = Totals { points_read: u64::MAX, ..totals(1) };
    let everything = archive_of(&plan(), &(scene().0, totals(2)), Some(halves()[1]));
    let coloured_voxels = word(&coloured(1), 360) as u64;
    for (parts, words) in [
        ([first(), made(1, there())], "2.slices: part 2 of 2: its reference system is not that of"),
        ([first(), made(1, in_nothing)], "2.slices: part 2 of 2: the units of its inputs are not those of"),
        ([reading(0, 1), reading(1, 2)], "input 3 of the plan: content: it changed between two parts: part 1 of 2 ("),
        ([first(), made(0, there())], "1.slices says the same of itself and holds something else"),
        ([made(0, many), good()], "2.slices: part 2 of 2: its 5 points make more than can be counted"),
        ([first(), everything], "2.slices: part 2 of 2: page (-1, -1, -1) lies outside its columns (rule T5)"),
        ([first(), forged(good(), 256, 0)], "2.slices: part 2 of 2: its totals are not those of its pages (rules T1"),
        ([first(), forged(good(), 184, 1f64.to_bits())], "2.slices: part 2 of 2: rule T6: expected bounds"),
        (
            [coloured(0), forged(coloured(1), 360, coloured_voxels - 1)],
            "2.slices: part 2 of 2: its voxels with colours",
        ),
        ([seen(0, -1), seen(1, -1)], "2.slices: part 2 of 2: seen space of column 3fffffffffffffff lies outside"),
        ([seen(0, -1), miscounted()], "2.slices: part 2 of 2: its seen cells are not as many as it says (rule V4)"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let names = ["1.slices", "2.slices"].map(|name| folder.path().join(name));
        names.iter().zip(&parts).for_each(|(name, bytes)| fs::write(name, bytes).unwrap());
        let whole = folder.path().join("whole.slices");
        let said = merge(&names, &whole, false, &NoMonitor).unwrap_err().to_string();
        assert!(said.contains(words) && !whole.exists(), "{words}: {said}");
    }
}

/// A plan that closes holes.
fn closing() -> Plan {
    Plan { options: PlanOptions { fill_holes: 3, ..plan().options }, ..plan() }
}

/// Tiles of the pages of three parts.
const TILES: [(i32, i32); 3] = [(-1, -1), (0, 0), (1, 0)];

/// One of three parts: the columns of the last two begin with their pages.
fn third(at: usize) -> Shard {
    let column = |(tx, ty)| key(tx, ty, 0).column();
    let first = if at == 0 { 0 } else { column(TILES[at]) };
    let last = TILES.get(at + 1).map_or(u64::MAX, |&next| column(next) - 1);
    Shard { index: at as u32 + 1, count: 3, first, last, plan_file: 7 }
}

/// Writes an archive with a page at each of `tiles`, alike and with inferred floor.
fn write(target: &Path, plan: &Plan, tiles: &[(i32, i32)], crs: &str, shard: Option<Shard>) {
    let floor = |bottom| Span::new(bottom, bottom + 4, false).unwrap();
    let content = page([((1, 1), vec![floor(10), floor(900)]), ((2, 1), vec![floor(10)])]);
    let mut inferred = Inferred::new();
    assert!(inferred.push(1, 1, 0b01));
    let mut writer = ArchiveWriter::create(target, plan, true).unwrap();
    let mut encoder = PageEncoder::of_plan(plan);
    for &(tx, ty) in tiles {
        let at = key(tx, ty, 0);
        writer.put(at, encoder.encode_inferred(at, &content, &inferred)).unwrap();
    }
    if let Some(shard) = shard {
        writer.set_shard(shard);
        writer.set_read(vec![InputRead { input: 3, hash: 5, name: String::new() }]);
    }
    let noise = Some(Noise { noise_m: 0.003, regions: 9, region_m: 0.25 });
    let points = tiles.len() as u64;
    let units = vec![LengthUnit::of(0.3048)];
    let totals =
        Totals { points_read: points, points_kept: points, crs: crs.into(), units, noise, ..Totals::default() };
    writer.finish(totals).unwrap();
}

/// Writes the three parts to `folder`.
fn thirds(folder: &Path, crs: &str) -> Vec<PathBuf> {
    let part = |at: usize| {
        let name = folder.join(format!("{}.slices", at + 1));
        write(&name, &closing(), &TILES[at..=at], crs, Some(third(at)));
        name
    };
    (0..3).map(part).collect()
}

#[test]
fn parts_merge_at_once_or_in_runs_to_the_bytes_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let parts = thirds(folder.path(), "here");
    write(&path("whole.slices"), &closing(), &TILES, "here", None);
    let is_whole = |name: &str| fs::read(path(name)).unwrap() == fs::read(path("whole.slices")).unwrap();
    merge(&parts, &path("merged.slices"), false, &NoMonitor).unwrap();
    assert!(is_whole("merged.slices"));
    let runs = ["a.slices", "b.slices"].map(path);
    merge_run(&parts[..2], (1, 2), &runs[0], false, &NoMonitor).unwrap();
    merge_run(&parts[2..], (2, 2), &runs[1], false, &NoMonitor).unwrap();
    let last = Archive::open(&runs[1]).unwrap().shard().unwrap();
    assert_eq!(last, Some(Shard { index: 2, count: 2, ..third(2) }));
    merge(&runs, &path("joined.slices"), false, &NoMonitor).unwrap();
    assert!(is_whole("joined.slices"));
    // An extract of everything and what is recovered of a sound archive have them, too.
    let whole = Archive::open(path("whole.slices")).unwrap();
    assert!(whole.noise().unwrap().is_some() && whole.header().voxels.inferred == 3);
    let everything = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    extract(&whole, &everything, &path("e.slices"), false, &NoMonitor).unwrap();
    assert!(is_whole("e.slices"));
    let recovered = recover(&path("whole.slices"), None, &path("r.slices"), false, &NoMonitor).unwrap();
    assert!(recovered.identical && is_whole("r.slices"), "{recovered:?}");
}

#[test]
fn copies_of_parts_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let [copy, whole] = ["copy.slices", "whole.slices"].map(|name| folder.path().join(name));
    // More than is compared at once.
    let parts = thirds(folder.path(), &"x".repeat((1 << 20) - 200));
    assert!(fs::metadata(&parts[1]).unwrap().len() > 1 << 20);
    fs::copy(&parts[1], &copy).unwrap();
    let given = [&parts[..], &[copy.clone(), parts[0].clone()]].concat();
    let merged = merge(&given, &whole, false, &NoMonitor).unwrap();
    assert_eq!(merged.copies, [copy, parts[0].clone()]);
    assert_eq!(merged.header.pages.total(), 3);
}

#[test]
fn missing_parts_and_those_of_other_plans_inputs_or_cuts_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let parts = thirds(folder.path(), "here");
    let whole = folder.path().join("whole.slices");
    let refused = |given: &[PathBuf], words: &str| {
        let said = merge(given, &whole, false, &NoMonitor).unwrap_err().to_string();
        assert!(said.contains(words) && !whole.exists(), "{words}: {said}");
    };
    refused(&parts[1..], "missing of 3: 1;");
    refused(&[parts[0].clone(), parts[2].clone()], "missing of 3: 2;");
    refused(&parts[..2], "missing of 3: 3;");
    let own = closing();
    let steep = Plan { options: PlanOptions { max_slope_deg: 30.0, ..own.options.clone() }, ..own.clone() };
    let plans = format!("its plan {:032x} is not that of the other parts, {:032x}; leave", steep.hash(), own.hash());
    let of_others = Shard { plan_file: 9, ..third(0) };
    let of_two = Shard { count: 2, ..third(0) };
    for (plan, crs, shard, words) in [
        (&steep, "here", third(0), format!("1.slices: part 1 of 3: {plans}")),
        (&own, "here", of_others, "1.slices: part 1 of 3: it was converted from other inputs than".into()),
        (&own, "there", of_others, "1.slices: part 1 of 3: its reference system is not that of".into()),
        (&own, "here", of_two, "1.slices: part 1 of 2: the other parts are of 3; leave".into()),
    ] {
        write(&parts[0], plan, &TILES[..1], crs, Some(shard));
        refused(&parts, &words);
    }
}
