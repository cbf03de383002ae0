//! Parts that cannot be merged: what each says, and what differs from another.

use crate::common;
use crate::levels::halves_at;

use common::forge::{Parts, put, word};
use common::{Pages, archive_coloured_by_place, archive_of, key, page, plan, scene};
use slicewalk::NoMonitor;
use slicewalk::archive::{ArchiveWriter, InputRead, PageEncoder, Shard, Totals, merge};
use slicewalk::page::Span;
use slicewalk::seen::{SeenBlock, SeenPage};
use slicewalk::unit::LengthUnit;
use std::fs;

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
