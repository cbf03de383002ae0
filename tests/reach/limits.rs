//! Pawns and sets of pages that are refused, and sets at the limits.

use super::{everywhere, known};
use crate::common::{key, page};
use nalgebra::Point3;
use slicewalk::frame::Frame;
use slicewalk::page::{Page, Span};
use slicewalk::reach::{Coarse, LeakSearch, Pawn, Planned, Refusal, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use slicewalk::{Error, NoMonitor};

fn frame() -> Frame {
    Frame::new(0.1, 0.3).unwrap()
}

/// A pawn as wide as a pixel.
fn pawn() -> Pawn {
    Pawn::new(Body::Box { x: 0.1, y: 0.1, height: 1.0 })
}

/// A page with floors above one another over each of its pixels.
fn floors(count: u32) -> Page {
    let floor = |number: u32| Span::new(510 * number + 10, 510 * number + 20, false).unwrap();
    let spans: Vec<Span> = (0..count).map(floor).collect();
    page((0..64 * 64).map(|cell| ((cell % 64, cell / 64), spans.clone())))
}

#[test]
fn pawns_that_cannot_be_are_refused_by_name() {
    let set = Snapshot::from_pages(frame(), [(key(0, 0, 0), floors(1))]);
    let plain = pawn();
    for (pawn, what) in [
        (Pawn { climb: -0.1, ..plain }, "climb height"),
        (Pawn { climb: 1.0, ..plain }, "climb height"),
        (Pawn { climb: f64::NAN, ..plain }, "climb height"),
        (Pawn { max_drop: -0.1, ..plain }, "deepest drop"),
        (Pawn { max_drop: f64::INFINITY, ..plain }, "deepest drop"),
        (Pawn { max_grade: 0.0, ..plain }, "steepest grade"),
        (Pawn { max_grade: f64::NAN, ..plain }, "steepest grade"),
        (Pawn { max_ramp: -1.0, ..plain }, "longest ramp"),
        (Pawn { max_ramp: f64::NAN, ..plain }, "longest ramp"),
        (Pawn::new(Body::Box { x: 60.0, y: 0.1, height: 1.0 }), "size"),
    ] {
        let error = StandingPlaces::new(&set, pawn).unwrap_err();
        assert!(matches!(error, Error::Parameter { .. }), "{pawn:?}: {error}");
        assert!(error.to_string().contains(what), "{pawn:?}: {error}");
    }
    let least = Pawn { climb: 0.0, max_drop: 0.0, max_grade: 0.01, max_ramp: 0.1, ..plain };
    assert!(StandingPlaces::new(&set, least).is_ok());
}

#[test]
fn a_set_of_pages_too_large_to_be_numbered_is_refused() {
    let (tiles, layers) = (1 << 24, 1 << 16);
    for (last, is_refused) in [
        (key(tiles - 1, tiles - 1, layers - 1), false),
        (key(tiles, 0, 0), true),
        (key(0, tiles, 0), true),
        (key(0, 0, layers), true),
    ] {
        let set = Snapshot::from_pages(frame(), [key(0, 0, 0), last].map(|key| (key, floors(1))));
        let error = StandingPlaces::new(&set, pawn()).err();
        assert_eq!(error.is_some(), is_refused, "{last}: {error:?}");
        let is_limit =
            |error: Error| matches!(error, Error::Limit { .. }) && error.to_string().contains("extract a region first");
        assert!(error.is_none_or(is_limit), "{last}");
    }
}

#[test]
fn more_pages_or_spans_over_a_tile_than_any_scan_has_are_refused() {
    let one = page([((0, 0), vec![Span::new(0, 10, false).unwrap()])]);
    // 2¹⁷ spans.
    let full = floors(32);
    for (page, layers, refused) in [
        (&one, 4096, None),
        (&one, 4097, Some("pages over one tile")),
        (&full, 1, None),
        (&full, 17, Some("spans over one tile")),
    ] {
        let set = Snapshot::from_pages(frame(), (0..layers).map(|layer| (key(0, 0, layer), page.clone())));
        let at = Point3::new(0.05, 0.05, 1.0);
        let exact = StandingPlaces::new(&set, pawn()).unwrap().spot(&set, at).err();
        let coarse = Coarse::new(&set, pawn(), at, at).unwrap().advance(&set, 10, &NoMonitor).err();
        for error in [exact, coarse] {
            let text = error.as_ref().map(ToString::to_string).unwrap_or_default();
            assert_eq!(error.is_some(), refused.is_some(), "{layers} pages: {text}");
            assert!(error.is_none_or(|error| matches!(error, Error::Limit { .. })), "{layers} pages: {text}");
            assert!(text.contains(refused.unwrap_or_default()), "{layers} pages: {text}");
        }
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_pawn_stands_between_a_floor_and_a_ceiling_at_pixels_of_a_millimetre() {
    let page = floors(2);
    let keys = (0..17).flat_map(|tx| (0..17).map(move |ty| key(tx, ty, 0)));
    let set = Snapshot::from_pages(Frame::new(0.001, 0.003).unwrap(), keys.map(|key| (key, page.clone())));
    let mut standing = StandingPlaces::new(&set, Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 })).unwrap();
    // Under the tile in the middle and 501 pixels around it: all pages.
    let middle = 8.5 * 0.064;
    assert!(known(standing.spot(&set, Point3::new(middle, middle, 0.1)).unwrap()).is_some());
}

#[test]
fn a_floor_at_the_first_and_the_last_tile_is_as_large_as_anywhere() {
    for (tx, ty) in [(0, 0), (i32::MAX, i32::MIN), (i32::MIN, i32::MAX)] {
        let set = Snapshot::from_pages(frame(), [(key(tx, ty, 0), floors(1))]);
        let (_, region) = everywhere(&set, pawn());
        assert_eq!(region.places().count(), 64 * 64, "({tx}, {ty})");
    }
}

#[test]
fn a_set_without_pages_has_no_ground() {
    let set = Snapshot::from_pages(frame(), []);
    let (mut standing, mut region) = everywhere(&set, pawn());
    region.prepare(&NoMonitor).unwrap();
    assert!(region.is_empty() && region.passages().is_empty() && region.storeys().all.is_empty());
    assert_eq!(known(LeakSearch::new(&region).find(&mut standing, &set).unwrap()), []);
    let at = Point3::origin();
    assert_eq!(known(standing.spot(&set, at).unwrap()), None);
    let found = Coarse::new(&set, pawn(), at, at).unwrap().advance(&set, 10, &NoMonitor).unwrap();
    assert_eq!(found, Planned::Done(Err(Refusal::NotStandingFrom)));
}
