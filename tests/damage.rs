//! Damage and forgery: every flipped, cut, added or zeroed byte is reported with the rule that it breaks, or does no
//! harm; bytes with recomputed checksums break the rule that protects against them. Nothing panics or allocates more
//! than the limits of the specification.

mod common;

use common::content::rule_of;
use common::forge::{Parts, put, word};
use common::{archive, archive_coloured_by_place, archive_of, plan, read_all, scene, two_pixels};
use proptest::prelude::*;
use slicewalk::archive::{Archive, Finding, LISTED, Shard, Totals};
use slicewalk::bytes::MemorySource;
use slicewalk::bytes::testing::{Fault, FaultySource};
use slicewalk::codec::Encoder;
use slicewalk::frame::Frame;
use slicewalk::page::{PageBuilder, Span};
use slicewalk::{Error, NoMonitor};
use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Records the largest allocation.
struct Noting;

static LARGEST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: passes every call to the system's allocator unchanged.
unsafe impl GlobalAlloc for Noting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: as for the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        // SAFETY: as for the caller.
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Noting = Noting;

/// Memory of the largest leaf that the specification allows: 2²⁰ entries of 48 bytes.
const LIMIT: usize = 48 << 20;

/// Rules that `bytes` break: that of the error on opening, or those of all findings.
fn rules(bytes: &[u8]) -> Vec<&'static str> {
    match Archive::from_bytes(bytes.to_vec()) {
        Ok(archive) => {
            let mut rules = Vec::new();
            archive.verify(&NoMonitor, &mut |finding: Finding| rules.push(finding.rule)).unwrap();
            rules
        }
        Err(error) => vec![rule_of(&error)],
    }
}

/// First letters of the rules that protect the byte at `at`.
fn family(parts: &Parts, at: usize) -> &'static str {
    let ends = [parts.head.len(), parts.pages.len(), parts.stored_leaf().len(), parts.metadata.len()];
    let mut end = 0;
    for (len, family) in ends.iter().zip(["H", "P", "D", "M"]) {
        end += len;
        if at < end {
            return family;
        }
    }
    "F"
}

#[test]
fn every_flipped_bit_is_reported_by_the_rules_of_its_section() {
    for (made, every_bit) in [(two_pixels(), true), (scene(), false)] {
        let good = archive(&made);
        let parts = Parts::of(&good);
        for at in 0..good.len() {
            for bit in (0..8).filter(|bit| every_bit || at % 8 == *bit) {
                let mut bytes = good.clone();
                bytes[at] ^= 1 << bit;
                let found = rules(&bytes);
                let family = family(&parts, at);
                assert!(!found.is_empty(), "byte {at} bit {bit}");
                assert!(found.iter().all(|rule| rule.starts_with(family)), "byte {at} bit {bit}: {found:?}");
                if let Ok(archive) = Archive::from_bytes(bytes)
                    && let Ok(pages) = read_all(&archive)
                {
                    assert_eq!(pages, made.0, "byte {at} bit {bit}");
                }
            }
        }
    }
}

#[test]
fn an_empty_file_is_named_as_one() {
    let said = Archive::from_bytes(Vec::new()).unwrap_err().to_string();
    assert!(said.contains("found no byte"), "{said}");
}

#[test]
fn every_cut_and_every_added_byte_is_found_on_opening() {
    let good = archive(&scene());
    for len in 0..good.len() {
        let found = rules(&good[..len]);
        assert!(["H1", "H2", "H6"].contains(&found[0]), "{len} bytes: {found:?}");
    }
    for tail in [&[0][..], b"\n", &[0; 20_000], &good] {
        assert_eq!(rules(&[&good[..], tail].concat()), ["H6"]);
        assert!(["H1", "H3"].contains(&rules(&[tail, &good].concat())[0]) || tail == good);
    }
    assert_eq!(rules(&[&good[..], &good].concat()), ["H6"]);
}

#[test]
fn zeroed_ranges_are_reported_or_were_zero() {
    let made = scene();
    let good = archive(&made);
    for len in [1, 4, 64, 512] {
        for at in (0..good.len()).step_by(if len == 1 { 1 } else { 7 }) {
            let mut bytes = good.clone();
            let end = (at + len).min(good.len());
            bytes[at..end].fill(0);
            assert_eq!(rules(&bytes).is_empty(), bytes == good, "{len} bytes from {at}");
        }
    }
}

/// Counts stated by the head: the offset of each, and the largest value that rule H8 allows.
#[test]
fn counts_of_a_head_may_reach_their_limits_and_not_pass_them() {
    let [read, kept, withheld, excluded] = [128, 136, 144, 152];
    let [occupied, stored, unique, voxels, obstacle] = [224, 232, 240, 248, 256];
    let [pages_stored, pages_shared, pages_uniform] = [264, 272, 280];
    let parts = Parts::of(&archive(&two_pixels()));
    let most = 1 << 29;
    // Numbers with which the head is valid; one of them must not be one greater, or smaller.
    type Counts<'a> = &'a [(usize, u64)];
    let cases: [(Counts<'_>, (usize, i64)); 10] = [
        (&[(read, 9), (kept, 2), (withheld, 3), (excluded, 4)], (kept, 1)),
        (&[(read, 9), (kept, 2), (withheld, 3), (excluded, 4)], (read, -1)),
        (&[(occupied, 7), (stored, 6), (unique, 6), (voxels, 7), (obstacle, 0)], (unique, 1)),
        (&[(occupied, 7), (stored, 7), (unique, 6), (voxels, 7), (obstacle, 0)], (stored, 1)),
        (&[(occupied, 7), (stored, 6), (unique, 6), (voxels, 7), (obstacle, 7)], (obstacle, 1)),
        (&[(occupied, 7), (stored, 6), (unique, 6), (voxels, 7), (obstacle, 0)], (voxels, -1)),
        (
            &[
                (occupied, 6),
                (stored, 6),
                (unique, 6),
                (pages_stored, 1),
                (pages_shared, 2),
                (pages_uniform, 3),
                (voxels, 6),
            ],
            (pages_uniform, 1),
        ),
        (&[(occupied, most + 1), (voxels, most + 1), (pages_stored, most), (pages_uniform, 0)], (pages_stored, 1)),
        (
            &[
                (occupied, most + 1),
                (voxels, most + 1),
                (pages_stored, 1),
                (pages_shared, most - 1),
                (pages_uniform, 0),
            ],
            (pages_uniform, 1),
        ),
        (&[(occupied, most + 1), (voxels, most + 1), (pages_stored, 1), (pages_uniform, most - 1)], (pages_shared, 1)),
    ];
    for (number, (counts, (at, by))) in cases.into_iter().enumerate() {
        let found = |by: i64| {
            let bytes = parts.build(|head| {
                counts.iter().for_each(|&(at, count)| put(head, at, count, 8));
                let count = u64::from_le_bytes(head[at..at + 8].try_into().unwrap());
                put(head, at, count.wrapping_add_signed(by), 8);
            });
            rules(&bytes)
        };
        // Valid on its own; other rules cover contradictions with the rest of the file.
        assert!(!found(0).contains(&"H8"), "case {number}: {:?}", found(0));
        assert_eq!(found(by), ["H8"], "case {number}");
    }
}

#[test]
fn heads_with_right_checksums_and_wrong_numbers_break_the_rule_for_them() {
    let parts = Parts::of(&archive(&two_pixels()));
    assert_eq!(parts.build(|_| ()), archive(&two_pixels()));
    let hash = |head: &mut Vec<u8>| {
        let hash = xxhash_rust::xxh3::xxh3_128(&head[56..128]);
        head[40..56].copy_from_slice(&hash.to_le_bytes());
    };
    type Forge = fn(&mut Vec<u8>);
    // Rule, whether the plan's hash is recomputed, what is wrong.
    let cases: [(&str, bool, Forge); 32] = [
        ("H1", false, |head| head[0] = b'S'),
        ("H2", false, |head| put(head, 12, 387, 4)),
        ("H2", false, |head| put(head, 12, 16_385, 4)),
        ("H2", false, |head| put(head, 12, u32::MAX as u64, 4)),
        ("H4", false, |head| head[8] = 2),
        ("H5", false, |head| head[20] = 1),
        ("H6", false, |head| head[32] ^= 1),
        ("H7", false, |head| head[40] ^= 1),
        ("H7", true, |head| put(head, 56, 0, 8)),
        ("H7", true, |head| put(head, 64, f64::NAN.to_bits(), 8)),
        ("H7", true, |head| put(head, 72, 91f64.to_bits(), 8)),
        ("H7", true, |head| put(head, 80, (-0f64).to_bits(), 8)),
        ("H7", true, |head| head[88] = 3),
        ("H7", true, |head| head[89] = 4),
        ("H7", true, |head| head[92] = 0),
        ("H8", false, |head| put(head, 136, 4, 8)),
        ("H8", false, |head| put(head, 144, u64::MAX, 8)),
        ("H8", false, |head| put(head, 160, f64::INFINITY.to_bits(), 8)),
        ("H8", false, |head| put(head, 184, 0, 8)),
        ("H8", false, |head| head[324] = 2),
        ("H8", false, |head| put(head, 208, 1, 8)),
        ("H8", false, |head| put(head, 240, 2, 8)),
        ("H8", false, |head| put(head, 256, 3, 8)),
        ("H8", false, |head| put(head, 264, u64::MAX, 8)),
        ("H9", false, |head| put(head, 288, u64::MAX, 8)),
        ("H9", false, |head| put(head, 304, 17, 8)),
        ("H10", false, |head| head[383] = 1),
        ("R1", false, |head| put(head, 316, 4095, 4)),
        ("R1", false, |head| put(head, 320, 2, 4)),
        ("R3", false, |head| put(head, 384 + 12, 2, 4)),
        ("R4", false, |head| put(head, 384 + 16, 1 << 31, 4)),
        ("H6", false, |head| put(head, 32, 0, 8)),
    ];
    for (number, (rule, hashed, forge)) in cases.into_iter().enumerate() {
        let bytes = parts.build(|head| {
            forge(head);
            if hashed {
                hash(head);
            }
        });
        assert_eq!(rules(&bytes), [rule], "case {number}");
    }
    let unknown = parts.build(|head| (head[16], head[23]) = (head[16] | 32, head[23] | 128));
    let refused = Archive::from_bytes(unknown).unwrap_err().to_string();
    assert!(refused.contains("required archive feature 5, 63 (rule H5)"), "{refused}");
    let unknown_but_optional = parts.build(|head| head[24] = 1);
    assert_eq!(rules(&unknown_but_optional), [""; 0]);
    let newer = parts.build(|head| {
        head[10] = 6;
        head[383] = 1;
    });
    assert_eq!(rules(&newer), [""; 0], "a newer minor version may use reserved bytes");
}

#[test]
fn leaves_in_a_root_that_do_not_ascend_break_the_rule_for_them() {
    // Enough pages for two leaves of 4096 entries.
    let page = |n: u32| common::page([((n % 64, n / 64 % 64), vec![Span::new(n, n + 5, false).unwrap()])]);
    let pages: common::Pages = (0..4100).map(|n| (common::key(n % 70, n / 70, 0), page(n as u32))).collect();
    let totals = Totals { points_read: 4100, points_kept: 4100, ..Totals::default() };
    let good = archive(&(pages, totals));
    assert_eq!(word(&good, 320), 2);
    let forged = |record: usize| {
        let mut bytes = good.clone();
        let (first, second) = (384, 384 + 28);
        match record {
            0 => bytes.copy_within(first..first + 12, second),
            1 => put(&mut bytes, second, 0, 8),
            _ => put(&mut bytes, second, u64::MAX, 8),
        }
        let end = word(&bytes, 12) - 4;
        let crc = crc32c::crc32c(&bytes[..end]) as u64;
        put(&mut bytes, end, crc, 4);
        let footer = bytes.len() - 24;
        put(&mut bytes, footer + 8, crc, 4);
        let crc = crc32c::crc32c(&bytes[footer..footer + 12]) as u64;
        put(&mut bytes, footer + 12, crc, 4);
        bytes
    };
    assert_eq!(rules(&good), [""; 0]);
    assert_eq!(rules(&forged(0)), ["R2"], "the same key twice");
    assert_eq!(rules(&forged(1)), ["R2"], "a lower key");
    let found = rules(&forged(2));
    assert!(found.contains(&"D4"), "a key that ascends, but is not the leaf's: {found:?}");
}

#[test]
fn footers_that_belong_elsewhere_are_refused() {
    let good = archive(&two_pixels());
    let other = archive(&scene());
    let swapped = [&good[..good.len() - 24], &other[other.len() - 24..]].concat();
    assert_eq!(rules(&swapped), ["F3"]);
}

#[test]
fn totals_that_are_not_those_of_the_pages_are_found() {
    let parts = Parts::of(&archive(&scene()));
    let cases: [(&str, usize, u64); 5] =
        [("T1", 272, 0), ("T2", 240, 1), ("T3", 256, 0), ("T4", 216, 0), ("T4", 208, -9i64 as u64)];
    for (rule, at, value) in cases {
        let bytes = parts.build(|head| {
            put(head, at, value, 8);
            if rule == "T1" {
                // One shared page fewer, one uniform page more.
                put(head, 280, 2, 8);
            }
        });
        assert_eq!(rules(&bytes), [rule]);
    }
}

#[test]
fn bounds_that_do_not_fit_the_matter_are_found() {
    let parts = Parts::of(&archive(&scene()));
    let with = |at: usize, value: f64| rules(&parts.build(|head| put(head, at, value.to_bits(), 8)));
    // Bounds that cut the solid, end far outside it, or are absurdly large; then bounds only slightly too wide.
    for (at, inside, far, near) in [
        (160, -6.25, -13.0, -12.7),
        (168, -19.0, -26.0, -25.5),
        (176, 0.0, -20.0, -19.5),
        (184, 18.6, 25.3, 25.1),
        (192, 6.2, 12.9, 12.7),
        (200, 96.0, 140.0, 115.0),
    ] {
        let nowhere = 1e300f64.copysign(far);
        for value in [inside, far, nowhere] {
            assert_eq!(with(at, value), ["T6"], "{value} at {at}");
        }
        assert_eq!(with(at, near), [""; 0], "{near} at {at}");
    }
    let none = parts.build(|head| {
        head[160..208].fill(0);
        head[324] = 0;
    });
    assert_eq!(rules(&none), ["T6"]);
}

#[test]
fn pages_with_right_checksums_and_wrong_content_break_the_rule_for_them() {
    let parts = Parts::of(&archive(&two_pixels()));
    let body = parts.pages[24..].to_vec();
    let build = |body: &[u8]| parts.with_page(body).build(|_| ());
    assert_eq!(build(&body), archive(&two_pixels()));
    let changed = |at: usize, value: u8| {
        let mut body = body.clone();
        body[at] = value;
        body
    };
    let cases = [
        ("D6", vec![]),
        ("P5", changed(0, 5)),
        ("P5", changed(0, 2)),
        ("P12", changed(0, 4)),
        ("P6", body[..7].to_vec()),
        ("P6", body[..body.len() - 1].to_vec()),
        ("P6", [&body[..], &[0, 0]].concat()),
        // The second state is below its least.
        ("P6", vec![3, 0, 0, 1, 0, 0, 0, 0, 0]),
    ];
    for (number, (rule, body)) in cases.into_iter().enumerate() {
        assert_eq!(rules(&build(&body)), [rule], "case {number}");
    }
    // Another page of as many blocks and words, in other slices; then one of more spans.
    let encoded = |columns: &[(u32, &[Span])]| {
        let mut builder = PageBuilder::default();
        assert!(columns.iter().all(|(px, spans)| builder.set_column(*px, 0, spans)));
        let mut body = Vec::new();
        Encoder::new(plan().frame, 0).encode(&builder.build(), &mut body);
        body
    };
    let span = |bottom: u32, top: u32| Span::new(bottom, top, false).unwrap();
    assert_eq!(rules(&build(&encoded(&[(0, &[span(10, 14)]), (1, &[span(12, 15)])]))), [""; 0]);
    assert_eq!(rules(&build(&encoded(&[(0, &[span(10, 14)]), (1, &[span(12, 256)])]))), ["P9"]);
    assert_eq!(rules(&build(&encoded(&[(0, &[span(10, 14)]), (1, &[span(12, 15)]), (2, &[span(1, 2)])]))), ["P11"]);
    // Heights in centimetres, written as quanta: an encoder of another grid finds no steps.
    let mut builder = PageBuilder::default();
    let columns: Vec<_> = (0..64).map(|px| (px, span(51 * px, 51 * px + 1))).collect();
    assert!(columns.iter().all(|(px, span)| builder.set_column(*px, 0, &[*span])));
    let page = builder.build();
    let mut body = Vec::new();
    let mut encoder = Encoder::new(Frame::new(1e5, 3e5).unwrap(), 0);
    encoder.encode(&page, &mut body);
    let steps = Parts::of(&archive(&([(common::key(0, 0, 0), page)].into(), Totals::default())));
    assert_eq!(rules(&steps.build(|_| ())), [""; 0]);
    assert_eq!(rules(&steps.with_page(&body).build(|_| ())), ["P10"]);
    let leader = |at: usize, value: u64| {
        let mut parts = parts.clone();
        put(&mut parts.pages, at, value, 4);
        rules(&parts.with_leader().build(|_| ()))
    };
    assert_eq!(leader(0, 0), ["P1"]);
    assert_eq!(leader(16, 5), ["P1"]);
    assert_eq!(leader(4, 1), ["P3"]);
    let mut wrong_crc = parts.clone();
    // The checksum is followed by one byte of blocks and one of words.
    let end = wrong_crc.leaf.len() - 3;
    wrong_crc.leaf[end] ^= 1;
    assert_eq!(rules(&wrong_crc.build(|_| ())), ["P2"]);
}

#[test]
fn leaves_with_right_checksums_and_wrong_entries_break_the_rule_for_them() {
    let parts = Parts::of(&archive(&two_pixels()));
    let with = |leaf: Vec<u8>| Parts { leaf, ..parts.clone() };
    let changed = |at: usize, value: u8| {
        let mut leaf = parts.leaf.clone();
        leaf[at] = value;
        rules(&with(leaf).build(|_| ()))
    };
    assert_eq!(changed(0, 0x80), ["D3"]);
    assert_eq!(changed(0, 1), ["D6"]);
    assert_eq!(changed(1, 1), ["D4"]);
    assert_eq!(changed(2, 1), ["D4"]);
    assert_eq!(changed(3, 3), ["D5"]);
    assert_eq!(changed(3, 1), ["D3"], "a shared page needs a distance");
    assert_eq!(changed(3, 2), ["D8"], "a uniform page needs a span");
    assert_eq!(changed(4, 0), ["D7"]);
    assert_eq!(changed(4, 2), ["P9"]);
    assert_eq!(changed(12, 24), ["D6"]);
    assert_eq!(changed(12, 42), ["D6"]);
    assert_eq!(changed(12, 40), ["P1", "D9"]);
    assert_eq!(changed(17, 64), ["D11"]);
    assert_eq!(changed(17, 1), ["P11"]);
    assert_eq!(changed(18, 2), ["P11"]);
    assert_eq!(rules(&with(parts.leaf[..18].to_vec()).build(|_| ())), ["D3"]);
    assert_eq!(rules(&with([&parts.leaf[..], &[0]].concat()).build(|_| ())), ["D3"]);
    assert_eq!(rules(&with(vec![0; 3 << 20]).build(|_| ())), ["D2"]);
    assert_eq!(rules(&parts.build(|head| put(head, 384 + 20, 18, 4))), ["D2"]);
    assert_eq!(rules(&parts.build(|head| head[384 + 24] ^= 1)), ["D1"]);
    // The leaf passes over a byte before its page.
    let mut gap = with([&[1][..], &parts.leaf[1..]].concat());
    gap.pages.insert(0, 0);
    assert_eq!(rules(&gap.build(|_| ())), ["D9"]);

    // In the scene, page 5 in order shares the bytes of an earlier page; make it point between two pages.
    let parts = Parts::of(&archive(&scene()));
    let entries = Archive::from_bytes(archive(&scene())).unwrap().leaf(0).unwrap();
    let paged = entries.iter().filter(|entry| entry.extent().is_some()).count();
    // The distance is the last varint before the checksums, the sizes and the one uniform span.
    let sizes = entries.iter().filter(|entry| entry.extent().is_some());
    let sizes: usize = sizes.map(|entry| if entry.size.words() - entry.size.blocks() < 128 { 2 } else { 3 }).sum();
    let at = parts.leaf.len() - 4 - sizes - 4 * paged - 1;
    let mut leaf = parts.leaf.clone();
    leaf[at] ^= 1;
    let found = rules(&Parts { leaf, ..parts.clone() }.build(|_| ()));
    assert!(found[0] == "D10", "{found:?}");
}

/// The pages that a lost leaf lists are unknown, so nothing else is taken for damage: neither the pages of the next leaf that share
/// the bytes of one of its pages, nor the colours of its pages.
#[test]
fn a_lost_leaf_is_one_finding() {
    for mut bytes in [common::sharing(), archive_coloured_by_place(&scene(), 0, true, None)] {
        let leaf = Archive::from_bytes(bytes.clone()).unwrap().header().directory_offset() as usize;
        bytes[leaf + 9] ^= 1;
        assert_eq!(rules(&bytes), ["D1"]);
    }
}

#[test]
fn bytes_that_cannot_be_read_are_findings_and_taken_for_no_damage() {
    // The first page has the bytes of all pages, or its own.
    for (bytes, alike) in [(common::sharing(), 5000), (archive_coloured_by_place(&scene(), 0, true, None), 1)] {
        let header = Archive::from_bytes(bytes.clone()).unwrap().header().clone();
        let ends = [
            header.pages_offset(),
            header.colours_offset(),
            header.levels_offset(),
            header.directory_offset(),
            header.metadata_offset(),
            header.metadata_offset() + header.bytes.metadata,
        ];
        let sections = ends.windows(2).filter(|ends| ends[0] < ends[1]);
        // Sections begin with a page or with the colours of levels, and end with tables.
        let places = sections.flat_map(|ends| [ends[0], ends[0] + (ends[1] - ends[0]) / 2, ends[1] - 1]);
        for at in places {
            let source = Arc::new(FaultySource::new(MemorySource::new(&bytes[..])));
            let archive = Archive::from_source(Box::new(source.clone())).unwrap();
            source.set(Fault::Fail, at..at + 1);
            let mut found = Vec::new();
            let summary = archive.verify(&NoMonitor, &mut |finding| found.push(finding)).unwrap();
            assert!(!found.is_empty() && found.iter().all(|finding| finding.rule == "S1"), "byte {at}: {found:?}");
            assert!(at != header.pages_offset() || summary.findings == alike, "{found:?}");
        }
    }
}

#[test]
fn verification_is_of_whole_archives() {
    let sample =
        |name: &str| Archive::open(Path::new(env!("CARGO_MANIFEST_DIR")).join("spec/samples").join(name)).unwrap();
    let verified = |archive: &Archive| archive.verify(&NoMonitor, &mut |finding| panic!("{finding}"));
    let whole = verified(&sample("holes.slices")).unwrap();
    assert!(whole.voxels.inferred > 0);
    assert_eq!(verified(&sample("holes.slices").ignoring_inferred()).unwrap(), whole);
    let refused = verified(&sample("levels.slices").level(1).unwrap()).unwrap_err().to_string();
    assert!(refused.contains("level 1: verify the archive that it is a level of"), "{refused}");
}

#[test]
fn findings_beyond_the_first_are_counted() {
    // A damaged page is reported for all pages that share its bytes.
    let mut bytes = common::sharing();
    let offset = Archive::from_bytes(bytes.clone()).unwrap().header().pages_offset() as usize;
    bytes[offset + 30] ^= 1;
    let verified = |bytes: Vec<u8>| {
        let mut listed = Vec::new();
        let summary =
            Archive::from_bytes(bytes).unwrap().verify(&NoMonitor, &mut |finding| listed.push(finding)).unwrap();
        (summary.findings, listed)
    };
    let (count, listed) = verified(bytes);
    assert_eq!((count, listed.len() as u64), (5000, LISTED));
    assert!(listed.iter().all(|finding| finding.rule == "P2" && finding.offset == offset as u64));
    assert_eq!(listed[7].part, "page (0, 0, 7)");
    // Pages of another part.
    let content = common::page([((1, 2), vec![Span::new(3, 4, false).unwrap()])]);
    let pages = (0..1500).map(|layer| (common::key(0, 0, layer), content.clone())).collect();
    let shard = Shard { index: 1, count: 2, first: 0, last: 3 << 62, plan_file: 0 };
    let mut part = archive_of(&plan(), &(pages, Totals::default()), Some(shard));
    let at = part.windows(4).position(|bytes| bytes == b"SHRD").unwrap();
    put(&mut part, at + 8 + 16, (3 << 62) - 1, 8);
    let metadata = part.len() - 24 - 48..part.len() - 24;
    let crc = crc32c::crc32c(&part[metadata]);
    put(&mut part, 312, crc.into(), 4);
    let head = u32::from_le_bytes(part[12..16].try_into().unwrap()) as usize;
    let crc = crc32c::crc32c(&part[..head - 4]);
    let footer = part.len() - 24;
    put(&mut part, head - 4, crc.into(), 4);
    put(&mut part, footer + 8, crc.into(), 4);
    let crc = crc32c::crc32c(&part[footer..footer + 12]);
    put(&mut part, footer + 12, crc.into(), 4);
    let (count, listed) = verified(part);
    assert_eq!((count, listed.len() as u64), (1500, LISTED));
    assert!(listed.iter().all(|finding| finding.rule == "T5"));
}

#[test]
fn metadata_with_right_checksums_and_wrong_records_are_found() {
    let parts = Parts::of(&archive(&two_pixels()));
    let with = |metadata: &[u8]| rules(&Parts { metadata: metadata.to_vec(), ..parts.clone() }.build(|_| ()));
    assert_eq!(with(b"CRS \xFF\xFF\xFF\xFF"), ["M2"]);
    assert_eq!(with(b"CRS \x01\0\0\0\xFF"), ["M3"]);
    assert_eq!(with(b"zzzz\0\0\0\0"), [""; 0], "unknown records are skipped");
    // The longest metadata, and one byte more.
    let of_len = |len: u32| [&b"zzzz"[..], &(len - 8).to_le_bytes(), &vec![7; len as usize - 8]].concat();
    assert_eq!(with(&of_len(1 << 20)), [""; 0]);
    assert_eq!(with(&of_len((1 << 20) + 1)), ["H9"]);
    let part = |index: u32, count: u32, first: u64, last: u64| {
        let numbers = [&index.to_le_bytes()[..], &count.to_le_bytes(), &first.to_le_bytes(), &last.to_le_bytes()];
        [b"SHRD\x28\0\0\0", &numbers.concat()[..], &[7; 16]].concat()
    };
    // The only page lies in column 3 << 62.
    assert_eq!(with(&part(2, 3, 1, u64::MAX - 1)), [""; 0]);
    assert_eq!(with(&part(2, 3, (3 << 62) + 1, u64::MAX - 1)), ["T5"]);
    assert_eq!(with(&part(1, 2, 0, 9)), ["T5"]);
    assert_eq!(with(&part(0, 3, 1, 9)), ["M4"]);
    assert_eq!(with(&part(2, 3, 9, 1)), ["M4"]);
    assert_eq!(with(b"SHRD\x01\0\0\0\0"), ["M4"]);
    assert_eq!(with(&[]), [""; 0]);
}

#[test]
fn a_failing_read_is_an_error_or_a_finding() {
    let made = scene();
    let bytes = archive(&made);
    for fails in 0..20 {
        let source = common::Watched::new(&bytes, fails);
        match Archive::from_source(Box::new(source.clone())) {
            Err(error) => assert!(fails == 0 && matches!(error, Error::Io { .. })),
            Ok(archive) => match read_all(&archive) {
                Err(error) => assert!(matches!(error, Error::Io { .. }), "{error}"),
                Ok(pages) => assert_eq!(pages, made.0),
            },
        }
        let source = common::Watched::new(&bytes, fails);
        if let Ok(archive) = Archive::from_source(Box::new(source.clone())) {
            let mut found = Vec::new();
            archive.verify(&NoMonitor, &mut |finding| found.push(finding.rule)).unwrap();
            assert!(found.iter().all(|rule| *rule == "S1"), "read {fails}: {found:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn forged_bytes_never_panic_and_never_allocate_beyond_the_limits(
        part in 0usize..4, changes in proptest::collection::vec(any::<(prop::sample::Index, u8)>(), 1..6), of_scene: bool,
    ) {
        let mut parts = Parts::of(&archive(&if of_scene { scene() } else { two_pixels() }));
        let raw = (!of_scene && part == 1).then(|| parts.pages[24..].to_vec());
        let mut bytes = [parts.head.clone(), raw.unwrap_or(parts.pages.clone()), parts.leaf.clone(), parts.metadata.clone()];
        for (at, value) in changes {
            let place = at.index(bytes[part].len());
            bytes[part][place] = value;
        }
        let [head, pages, leaf, metadata] = bytes;
        match part {
            0 => {}
            1 if of_scene => parts.pages = pages,
            1 => parts = parts.with_page(&pages),
            2 => parts.leaf = leaf,
            _ => parts.metadata = metadata,
        }
        let forged = parts.build(|good| {
            if part == 0 {
                *good = head;
            }
        });
        rules(&forged);
        if let Ok(archive) = Archive::from_bytes(forged) {
            let _ = read_all(&archive);
        }
        prop_assert!(LARGEST.load(Ordering::Relaxed) <= LIMIT);
    }

    #[test]
    fn any_bytes_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..600), magic: bool) {
        let bytes = if magic { [b"\x89SLA\r\n\x1a\n\x01\0\0\0\xA0\x01\0\0", &bytes[..]].concat() } else { bytes };
        prop_assert!(!rules(&bytes).is_empty());
    }
}
