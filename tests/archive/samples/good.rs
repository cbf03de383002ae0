//! Sound samples.

use crate::common::forge::{Parts, put};
use crate::common::{
    Congruential, Pages, archive, archive_of, archive_with_colours, archive_with_levels, key, page, plan, scene,
    two_pixels,
};
use slicewalk::archive::{Archive, ArchiveWriter, InputRead, PageEncoder, Shard, Totals};
use slicewalk::colour::ColourScale;
use slicewalk::frame::Frame;
use slicewalk::page::{Inferred, Span};
use slicewalk::plan::{Classifier, Noise, Plan, PlanOptions, Up};
use slicewalk::seen::{SeenBlock, SeenPage};
use slicewalk::unit::{LengthUnit, US_SURVEY_FOOT_M};
use std::collections::BTreeMap;

/// Names and bytes.
pub fn all() -> Vec<(&'static str, Vec<u8>)> {
    let (in_centimetres, slope) = centimetres();
    let (in_feet, pillars) = centimetres_cut();
    vec![
        ("empty", archive(&Default::default())),
        ("two-pixels", archive(&two_pixels())),
        ("floor", archive(&(floor(), totals()))),
        ("wall", archive(&(wall(), totals()))),
        ("stairs", archive(&(stairs(), totals()))),
        ("crowded", archive(&(crowded(), totals()))),
        ("shared-and-uniform", archive(&scene())),
        ("centimetres", archive_of(&in_centimetres, &(slope, totals()), None)),
        ("centimetres-cut", archive_of(&in_feet, &(pillars, totals()), None)),
        ("tolerance", tolerance()),
        ("options", archive_of(&options(), &(floor(), totals_beyond()), None)),
        ("part", archive_of(&plan(), &(stairs(), totals_beyond()), Some(part()))),
        ("part-with-inputs", part_with_inputs()),
        ("units", archive(&in_units(vec![LengthUnit { horizontal_m: US_SURVEY_FOOT_M, vertical_m: 1.0 }]))),
        ("units-mixed", archive(&in_units(LengthUnit::distinct([0.3048, 1.0, 20.1168].map(LengthUnit::of))))),
        ("leaves", archive(&(leaves(), totals()))),
        ("unknown-metadata", unknown_metadata()),
        ("newer-minor-version", newer()),
        ("holes", holes(&plan())),
        ("levels", archive_with_levels(&plan(), &(city(), totals()), None)),
        ("colours", archive_with_colours(&scene(), ColourScale::of_rgb(255), 2000, true)),
        ("colours-exact", archive_with_colours(&two_pixels(), ColourScale::of_rgb(65_535), 0, false)),
        ("levels-of-one-page", archive_with_levels(&plan(), &two_pixels(), None)),
        ("seen", seen(floor(), seen_blocks(), |_| ())),
        ("seen-nothing", seen(two_pixels().0, Vec::new(), |_| ())),
        ("seen-of-part", seen(stairs(), seen_blocks().split_off(2), |writer| writer.set_shard(part()))),
        ("seen-with-levels", seen(wall(), seen_blocks(), ArchiveWriter::set_levels)),
    ]
}

fn span(bottom: u32, top: u32, obstacle: bool) -> Span {
    Span::new(bottom, top, obstacle).unwrap()
}

/// With the bounds of the matter.
fn totals() -> Totals {
    Totals { points_read: 1_234_567, points_kept: 1_200_000, ..Totals::default() }
}

/// With bounds of points far outside of the matter, as where voxels were dropped, or of other parts.
fn totals_beyond() -> Totals {
    Totals { bounds: Some(([-1000.0, -1000.0, -70.0], [2000.0, 1000.0, 75.5])), ..totals() }
}

/// With the bounds of points whose heights were moved outwards later.
fn totals_within(pages: Pages) -> Totals {
    let exact = Archive::from_bytes(archive(&(pages, totals()))).unwrap();
    Totals { bounds: exact.header().bounds, ..totals() }
}

/// A rough floor over the four pages around the origin, up to their last rows and columns.
fn floor() -> Pages {
    let mut random = Congruential(3);
    let mut corner = |px: u32, py: u32| {
        page((0..12 * 9).map(|at| {
            let bottom = 1000 + 2 * (at % 12) + 30 * (at / 12) + random.below(6);
            ((px + at % 12, py + at / 12), vec![span(bottom, bottom + 1 + random.below(4), false)])
        }))
    };
    Pages::from([
        (key(-1, -1, 0), corner(52, 55)),
        (key(-1, 0, 0), corner(52, 0)),
        (key(0, -1, 0), corner(0, 55)),
        (key(0, 0, 0), corner(0, 0)),
    ])
}

/// A wall through three layers with a door and a lintel.
fn wall() -> Pages {
    let run = |spans: fn(u32) -> Vec<Span>| page((0..64).map(|py| ((60 + py % 4, py), spans(py))));
    let low = |py| match py {
        20..26 => vec![span(12_002 + py, 12_002 + py, false), span(14_000, 16_320, true)],
        _ => vec![span(12_000, 16_320, true)],
    };
    Pages::from([
        (key(0, 0, -1), run(low)),
        (key(0, 0, 0), run(|_| vec![span(0, 16_320, true)])),
        (key(0, 0, 1), run(|py| vec![span(0, 700 + py / 8, true)])),
    ])
}

/// Stairs below a ceiling, with a landing that only touches an obstacle below it.
fn stairs() -> Pages {
    let mut random = Congruential(11);
    let steps = (0..24 * 10).map(|at| {
        let (px, py) = (30 + at % 24, 4 + at / 24);
        let tread = 2000 + px / 3 * 150;
        let riser = px % 3 == 0;
        let bottom = tread - if riser { 150 } else { random.below(4) };
        let ceiling = 9000 + random.below(9);
        let mut spans = vec![span(bottom, tread + 2, riser), span(ceiling, ceiling + 3, false)];
        if py == 13 {
            spans.splice(..1, [span(1900, 2040, true), span(2040, 2045, false)]);
        }
        ((px, py), spans)
    });
    Pages::from([(key(0, 0, 0), page(steps)), (key(0, 0, 2), page([((0, 63), vec![span(16_319, 16_320, true)])]))])
}

/// Many spans in a pixel, at the ends of slices and pages, of both kinds, touching and apart; full blocks.
fn crowded() -> Pages {
    let mut random = Congruential(5);
    let tower: Vec<_> = (0..64).map(|k| span(255 * k, 255 * k + 255, k % 2 == 1)).collect();
    let rungs: Vec<_> = (0..64).map(|k| span(255 * k, 255 * k + k, k % 3 == 0)).collect();
    let mut columns: BTreeMap<(u32, u32), Vec<Span>> = BTreeMap::new();
    for at in 0..64 {
        let bottom = random.below(16_000);
        columns.insert((56 + at % 8, 8 + at / 8), vec![span(bottom, bottom + random.below(300), at % 5 == 0)]);
    }
    columns.insert((0, 0), tower.clone());
    columns.insert((1, 0), rungs.clone());
    columns.insert((62, 62), rungs);
    columns.insert((63, 63), tower);
    columns.insert((63, 0), vec![span(0, 0, false), span(1, 1, true), span(16_319, 16_319, false)]);
    Pages::from([(key(-2, 1, -3), page(columns))])
}

/// A slope and pillars scanned in whole centimetres, of which a slice is no multiple of three. The slope begins on the
/// floor of the page, where the rounding of products makes a quantum of height from nothing.
fn centimetres() -> (Plan, Pages) {
    let plan = Plan { frame: Frame::new(0.29, 0.87).unwrap(), ..plan() };
    let (layer, floor_cm) = (1, 64 * 87);
    let floor = 16_320 * i64::from(layer);
    let columns = (0..20 * 20).filter_map(|at| {
        let z = f64::from(floor_cm + at as i32) / 100.0;
        let bottom = plan.frame.quantum_floor(z) - floor;
        let pillar = at % 20 == 7;
        let top = if pillar { 16_320 } else { plan.frame.quantum_ceil(z) - floor };
        let span = Span::new(u32::try_from(bottom).ok()?, top as u32, pillar)?;
        Some(((44 + at % 20, 30 + at / 20), vec![span]))
    });
    let pages = Pages::from([(key(3, 2, layer), page(columns))]);
    (plan, pages)
}

/// A floor and pillars in whole centimetres, cut where two pages meet, which is no centimetre: slices of a foot.
fn centimetres_cut() -> (Plan, Pages) {
    let plan = Plan { frame: Frame::new(0.1016, 0.3048).unwrap(), ..plan() };
    let quanta = |cm: u32| {
        let z = f64::from(cm) / 100.0;
        (plan.frame.quantum_floor(z) as u32, plan.frame.quantum_ceil(z) as u32)
    };
    let place = |at: u32| (8 + at % 9, 50 + at / 9);
    let lower = (0..81).map(|at| {
        let (bottom, top) = quanta(100 + at % 7);
        (place(at), vec![if at % 9 < 2 { span(bottom, 16_320, true) } else { span(bottom, top, false) }])
    });
    let upper = (0..81).filter(|at| at % 9 < 2);
    let upper = upper.map(|at| (place(at), vec![span(0, quanta(2950 + at % 40).1 - 16_320, true)]));
    let pages = Pages::from([(key(0, 0, 0), page(lower)), (key(0, 0, 1), page(upper))]);
    (plan, pages)
}

/// Heights moved outwards by up to 17 quanta, by a tolerance that the noise of the scan allows.
fn tolerance() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("test.slices");
    let mut writer = ArchiveWriter::create(&target, &tolerant(), false).unwrap();
    let mut encoder = PageEncoder::of_plan(&tolerant());
    for (key, page) in floor() {
        writer.put(key, encoder.encode_lossy(key, &page, &Inferred::NONE).0).unwrap();
    }
    let noise = Some(Noise { noise_m: 0.0203, regions: 1234, region_m: 0.25 });
    writer.finish(Totals { noise, ..totals_within(floor()) }).unwrap();
    std::fs::read(&target).unwrap()
}

/// The plan of the samples, but coarse heights.
fn tolerant() -> Plan {
    let plan = plan();
    Plan { options: PlanOptions { tolerance_m: 0.02, ..plan.options }, ..plan }
}

/// More pages than a leaf holds: most of one span, some with bytes, some that share those of a leaf before.
fn leaves() -> Pages {
    let content = |n: u32| match n % 40 {
        7 => page([((n % 64, n / 64), vec![span(n, n + 9, false)])]),
        21 => page([((3, 4), vec![span(40, 50, true)])]),
        _ => page((0..4096).map(|at| ((at % 64, at / 64), vec![span(n % 5, 300, n.is_multiple_of(3))]))),
    };
    (0..4099u32).map(|n| (key(n as i32 % 70 - 35, 2, n as i32 / 70), content(n))).collect()
}

/// No option as by default, and sizes that are no round numbers.
fn options() -> Plan {
    let options = PlanOptions {
        max_slope_deg: 33.3,
        tolerance_m: 0.0,
        classifier: Classifier::Plane,
        min_points: 3,
        drop_floaters: 1,
        remove_moving: false,
        fill_holes: 0,
        up: Up::Y,
        exclude_classes: [7, 18, 255].into_iter().collect(),
    };
    Plan { frame: Frame::new(0.3048 / 7.0, 0.17).unwrap(), options }
}

/// A floor and a wall with closed holes: rows of inferred spans, one above a scanned floor, one in all of a page.
fn holes(plan: &Plan) -> Vec<u8> {
    let plan = Plan { options: PlanOptions { fill_holes: 7, ..plan.options.clone() }, ..plan.clone() };
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("holes.slices");
    let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
    let mut encoder = PageEncoder::of_plan(&plan);
    let in_hole = |x: u32, y: u32| (20..27).contains(&x) && (30..33).contains(&y) || (x, y) == (63, 63);
    let column = |x: u32, y: u32| match (x, y) {
        (x, _) if x < 2 => vec![span(90, 3000, true)],
        (40, 40) => vec![span(20, 22, false), span(1000, 1001, false)],
        _ => vec![span(100 + x / 8, 103 + x / 8, false)],
    };
    let floor = page((0..4096).map(|at| ((at % 64, at / 64), column(at % 64, at / 64))));
    let mut inferred = Inferred::new();
    for at in 0..4096 {
        let (x, y) = (at % 64, at / 64);
        let mask = if (x, y) == (40, 40) { 2 } else { u64::from(in_hole(x, y)) };
        assert!(inferred.push(x, y, mask));
    }
    let flat = page((0..4096).map(|at| ((at % 64, at / 64), vec![span(5, 6, false)])));
    let mut all = Inferred::new();
    (0..4096).for_each(|at| assert!(all.push(at % 64, at / 64, 1)));
    for (key, page, inferred) in [
        (key(0, 0, 0), &floor, &inferred),
        (key(1, 0, 0), &flat, &Inferred::new()),
        (key(0, 1, 0), &flat, &all),
        (key(1, 1, 0), &flat, &all),
    ] {
        writer.put(key, encoder.encode_inferred(key, page, inferred)).unwrap();
    }
    writer.finish(totals()).unwrap();
    std::fs::read(target).unwrap()
}

/// Seen space below and above the origin, in columns with and without pages: pages seen entirely, in part, and not at
/// all between them.
fn seen_blocks() -> Vec<SeenBlock> {
    let mut random = Congruential(17);
    let mut part = |boxes: u32| {
        let mut page = SeenPage::NOTHING;
        for _ in 0..boxes {
            let [x, y, z] = [12, 12, 56].map(|limit| random.below(limit) as usize);
            page.mark([[x, x + 3], [y, y + 2], [z, z + 7]]);
        }
        page
    };
    let mut cell = SeenPage::NOTHING;
    cell.mark([[15, 15], [0, 0], [63, 63]]);
    let mut most = SeenPage::NOTHING;
    most.mark([[0, 15], [0, 15], [0, 62]]);
    let mut made = Vec::new();
    for (key, pages) in [
        (key(-1, -1, -1), vec![(62, SeenPage::ALL), (63, part(3))]),
        (key(-1, -1, 0), vec![(0, part(2))]),
        (key(0, 0, 0), vec![(0, part(4)), (1, SeenPage::ALL), (3, SeenPage::ALL), (5, most)]),
        (key(7, 2, 3), vec![(63, cell)]),
    ] {
        let mut block = SeenBlock::new(key);
        pages.iter().for_each(|(at, page)| block.push(*at, page));
        made.push(block);
    }
    made
}

/// Pages with seen space.
fn seen(pages: Pages, blocks: Vec<SeenBlock>, begin: impl FnOnce(&mut ArchiveWriter)) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("seen.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    begin(&mut writer);
    writer.set_seen();
    let mut encoder = PageEncoder::of_plan(&plan());
    for (key, page) in &pages {
        writer.put(*key, encoder.encode(*key, page)).unwrap();
    }
    blocks.iter().for_each(|block| writer.put_seen(block).unwrap());
    writer.finish(totals()).unwrap();
    std::fs::read(target).unwrap()
}

/// All columns from that of page (0, 0).
pub fn part() -> Shard {
    Shard { index: 3, count: 3, first: 3 << 62, last: u64::MAX, plan_file: 0x0123_4567_89AB_CDEF_0011_2233_4455_6677 }
}

/// A part that shares two of its inputs with others.
fn part_with_inputs() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("part.slices");
    let mut writer = ArchiveWriter::create(&target, &plan(), false).unwrap();
    writer.set_shard(part());
    let read = |input, name: &str| InputRead { input, hash: u128::from(input) << 100 | 0xABC, name: name.into() };
    writer.set_read(vec![read(0, "west.laz"), read(7, "Größe.las")]);
    writer.finish(Totals::default()).unwrap();
    std::fs::read(target).unwrap()
}

fn in_units(units: Vec<LengthUnit>) -> (Pages, Totals) {
    let (pages, totals) = two_pixels();
    (pages, Totals { units, ..totals })
}

fn unknown_metadata() -> Vec<u8> {
    let mut parts = Parts::of(&archive(&two_pixels()));
    parts.metadata = [b"AAAA\x03\0\0\0abc", &parts.metadata[..], b"zzzz\0\0\0\0"].concat();
    parts.build(|_| ())
}

/// A later version 1.x with something in a reserved field, and an optional feature.
fn newer() -> Vec<u8> {
    Parts::of(&archive(&two_pixels())).build(|head| {
        put(head, 10, 7, 2);
        put(head, 24, 1 << 50, 8);
        put(head, 325, 99, 1);
    })
}

/// Floors, walls and cuts in pages near and far, over three levels.
pub fn city() -> Pages {
    let mut random = Congruential(3);
    let mut pages = Pages::new();
    for (tx, ty, layer) in [(-3, 1, 0), (0, 0, -1), (0, 0, 0), (1, 0, 0), (1, 2, 0), (2, 1, 0), (9, -6, 1), (17, 30, 0)]
    {
        let floor = (0..24 * 24).map(|at| {
            let bottom = 900 + at % 24 * 40 + random.below(30);
            let mut spans = vec![span(bottom, bottom + 3 + random.below(90), at % 7 == 0)];
            if at % 5 == 0 {
                spans.push(span(4080 + at, 16320, true));
            }
            ((at % 24 * 2, at / 24 + 20), spans)
        });
        pages.insert(key(tx, ty, layer), page(floor));
    }
    let flat = page((0..4096).map(|at| ((at % 64, at / 64), vec![span(255, 255, false)])));
    pages.insert(key(2, 2, 0), flat.clone());
    pages.insert(key(3, 2, 0), flat);
    pages
}
