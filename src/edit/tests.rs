use super::*;
use crate::page::{Page, PageBuilder, Span};

/// Bottom, top, and whether it is an obstacle.
type Run = (u32, u32, bool);

/// Pixels of 1 m and quanta of 1 m: a page is 16,320 m high.
fn frame() -> Frame {
    Frame::new(1.0, 255.0).unwrap()
}

/// A prism in pixel (0, 0).
fn prism(bottom: f64, top: f64) -> Prism {
    Prism::of_box([0.1, 0.1, bottom], [0.9, 0.9, top]).unwrap()
}

fn page(runs: &[Run]) -> Page {
    let spans: Vec<_> = runs.iter().map(|&(bottom, top, obstacle)| Span::new(bottom, top, obstacle).unwrap()).collect();
    let mut builder = PageBuilder::default();
    assert!(builder.set_column(0, 0, &spans));
    builder.build()
}

/// Runs of pixel (0, 0) with the edits.
fn edited(runs: &[Run], edits: &Edits) -> Vec<Run> {
    let pages = EditedColumn::new(edits, &frame(), false, [0, 0]).apply(&[(0, &page(runs))]).unwrap();
    assert_eq!((pages.len(), pages[0].0), (1, 0));
    pages[0].1.column(0, 0).iter().map(|span| (span.bottom(), span.top(), span.is_obstacle())).collect()
}

#[test]
fn pixels_are_cut_level_and_what_is_added_joins_what_it_touches() {
    const FLOOR: Option<bool> = Some(true);
    type Case<'a> = (&'a [Run], Option<bool>, [f64; 2], &'a [Run]);
    let cases: [Case; 6] = [
        (&[(0, 600, true)], None, [100.0, 200.0], &[(0, 100, false), (200, 600, true)]),
        // No quantum lies in between.
        (&[(0, 600, true)], None, [100.2, 100.8], &[(0, 600, true)]),
        // What remains below is floor, like the run that it stands on.
        (&[(0, 255, false), (255, 600, true)], None, [400.0, 500.0], &[(0, 400, false), (500, 600, true)]),
        // Floor up to the height of an obstacle: below the top slice it is an obstacle still.
        (&[(0, 300, true)], FLOOR, [250.0, 300.0], &[(0, 255, true), (255, 300, false)]),
        // Inside a floor, whose lower slices join the obstacle below.
        (&[(0, 255, true), (255, 700, false)], FLOOR, [400.0, 500.0], &[(0, 510, true), (510, 700, false)]),
        (&[(0, 100, false)], Some(false), [300.0, 400.0], &[(0, 100, false), (300, 400, true)]),
    ];
    for (runs, added, [bottom, top], expected) in cases {
        let mut edits = Edits::default();
        match added {
            None => edits.remove(prism(bottom, top)).unwrap(),
            Some(is_floor) => edits.add(prism(bottom, top), is_floor).unwrap(),
        }
        assert_eq!(edited(runs, &edits), expected, "{runs:?}, {added:?} from {bottom} to {top}");
    }
}

#[test]
fn edits_of_a_level_keep_to_the_unit_of_its_heights() {
    let mut edits = Edits::default();
    edits.add(prism(13.0, 77.7), false).unwrap();
    edits.remove(Prism::of_box([-9.0, -9.0, 201.3], [9.0, 9.0, 400.3]).unwrap()).unwrap();
    // In a page that the level does not have.
    edits.add(prism(16_400.5, 16_433.2), false).unwrap();
    let level = page(&[(0, 85, false), (170, 16_320, true)]);
    let runs = |page: &Page| -> Vec<Run> {
        page.column(0, 0).iter().map(|span| (span.bottom(), span.top(), span.is_obstacle())).collect()
    };
    let pages = EditedColumn::new(&edits, &frame(), true, [0, 0]).apply(&[(0, &level)]).unwrap();
    assert_eq!(runs(&pages[0].1), [(0, 85, false), (170, 255, false), (340, 16_320, true)]);
    assert_eq!(runs(&pages[1].1), [(80, 114, true)]);
}

#[test]
fn bounds_of_added_solid_are_those_of_its_pixels() {
    let mut edits = Edits::default();
    edits.remove(Prism::of_box([-90.0, -90.0, -90.0], [90.0, 90.0, 90.0]).unwrap()).unwrap();
    assert_eq!(edits.added_bounds(&frame()), None);
    edits.add(prism(3.5, 4.5), true).unwrap();
    edits.add(Prism::of_box([-1.5, 2.5, -7.0], [2.0, 3.5, 0.5]).unwrap(), false).unwrap();
    // A box that ends on the border of two pixels touches both.
    assert_eq!(edits.added_bounds(&frame()), Some(([-2.0, 0.0, -7.0], [3.0, 4.0, 5.0])));
}

#[test]
fn solid_that_ends_on_the_border_of_pixels_fills_those_on_both_sides() {
    let mut edits = Edits::default();
    edits.add(Prism::of_box([-1.0, 0.0, 0.0], [1.0, 2.5, 1.0]).unwrap(), false).unwrap();
    let (mut tiles, mut pixels) = (Vec::new(), Vec::new());
    let frame = frame();
    let ([low, high], _) = edits.regions(&frame).next().unwrap();
    for (tx, ty) in (low[0]..=high[0]).flat_map(|tx| (low[1]..=high[1]).map(move |ty| (tx, ty))) {
        tiles.push((tx, ty));
        for (_, page) in EditedColumn::new(&edits, &frame, false, [tx as i32, ty as i32]).apply(&[]).unwrap() {
            let all = (0..64).flat_map(|y| (0..64).map(move |x| (x, y)));
            let solid = all.filter(|&(x, y)| !page.column(x, y).is_empty());
            pixels.extend(solid.map(|(x, y)| (tx * 64 + i64::from(x), ty * 64 + i64::from(y))));
        }
    }
    assert_eq!(tiles, [(-1, -1), (-1, 0), (0, -1), (0, 0)]);
    pixels.sort_unstable();
    let expected: Vec<_> = (-2..=1).flat_map(|x| (-1..=2).map(move |y| (x, y))).collect();
    assert_eq!(pixels, expected);
}

#[test]
fn where_a_pixel_has_more_spans_than_a_page_holds_the_nearest_are_joined() {
    // One in each slice, 75 apart, but numbers 30 and 31 only 35.
    let mut runs: Vec<Run> = (0..64).map(|slice| (255 * slice + 20, 255 * slice + 200, false)).collect();
    runs[30].1 += 40;
    let mut edits = Edits::default();
    edits.remove(prism(255.0 * 10.0 + 60.0, 255.0 * 10.0 + 160.0)).unwrap();
    let mut expected = runs.clone();
    expected[30].1 = expected.remove(31).1;
    expected.splice(10..11, [(2570, 2610, false), (2710, 2750, false)]);
    assert_eq!(edited(&runs, &edits), expected);
}

#[test]
fn edits_beyond_the_limits_are_refused() {
    // Slices of a millimetre, 64 in a layer.
    let fine = Frame::new(1.0, 0.001).unwrap();
    // One layer more than may change: half of them below the origin.
    let half = f64::from(1 << 15) * 16_320.0;
    let cases = [
        (fine, prism(9e8 + 0.5, 9e8 + 0.51), "layer of an edit: 14062500007 is beyond the limit of 2147483647"),
        (fine, prism(-9e8 - 0.5, -9e8 - 0.49), "layer of an edit: 14062500008 is beyond the limit of 2147483647"),
        (frame(), prism(-half, half + 1.0), "pages that edits change: 65537 is beyond the limit of 65536"),
    ];
    for (frame, prism, says) in cases {
        let mut edits = Edits::default();
        edits.add(prism, false).unwrap();
        let error = EditedColumn::new(&edits, &frame, false, [0, 0]).apply(&[]).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    let line = [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]].map(Point2::from);
    let error = Prism::new(&line, 0.0, 1.0).unwrap_err().to_string();
    assert!(error.contains("corners around an area"), "{error}");
    let mut edits = Edits::default();
    for number in 0..MOST_EDITS {
        let done = if number % 2 == 0 { edits.remove(prism(0.0, 1.0)) } else { edits.add(prism(0.0, 1.0), true) };
        done.unwrap();
    }
    for refused in [edits.remove(prism(0.0, 1.0)), edits.add(prism(0.0, 1.0), false)] {
        let error = refused.unwrap_err().to_string();
        assert!(error.contains("edits: 10001 is beyond the limit of 10000"), "{error}");
    }
    assert_eq!(edits.len(), MOST_EDITS);
}
