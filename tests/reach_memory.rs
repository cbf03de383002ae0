//! The memory that the parts of `reach` report is that which they hold on the heap, and as much for each place as documented.

#[path = "common/heap.rs"]
mod heap;
#[allow(dead_code)]
#[path = "walk/world.rs"]
mod world;

use heap::{kept, measured};
use nalgebra::Point3;
use slicewalk::NoMonitor;
use slicewalk::query::Answer;
use slicewalk::reach::{Coarse, Flood, LongSearch, Pawn, Planned, Planner, RouteRefiner, Search, StandingPlaces};
use slicewalk::walk::Body;

/// Bytes beside the tables: small vectors and maps.
const BESIDE: usize = 4 << 10;

fn is_reported(what: &str, reported: usize, held: usize) {
    assert!(held > 8 * BESIDE, "{what}: too small a scene, {held} bytes");
    assert!(reported.abs_diff(held) <= BESIDE + held / 20, "{what}: reported {reported} bytes, held {held}");
}

/// A peak is reported without what is needed only while a region is made.
fn is_peak(what: &str, reported: usize, held: usize) {
    assert!((held - held / 8..=held).contains(&reported), "{what}: reported {reported} bytes, held at most {held}");
}

/// The only test of this file, because others would allocate at the same time.
#[test]
fn every_part_reports_the_memory_that_it_holds() {
    // Walls with gaps, across the way.
    let store = world::room(8, |(x, y)| x.rem_euclid(40) == 20 && y.rem_euclid(80) > 30);
    let pawn = Pawn::new(Body::Cylinder { radius: 0.25, height: 1.8 });
    let [from, to] = [[-12.0, -12.0, 0.1], [12.0, 12.0, 0.1]].map(Point3::from);
    let mut standing = StandingPlaces::new(&store, pawn).unwrap();
    let (mut flood, held) = kept(|| {
        let Ok(Answer::Known(flood)) = Flood::everywhere(&mut standing, &store) else { panic!("all is in memory") };
        flood
    });
    // The places to begin from are the flood's.
    is_reported("standing places", standing.memory_bytes() + flood.memory_bytes(), held);
    let (_, more) = kept(|| flood.grow(&mut standing, &store, &NoMonitor).unwrap());
    is_reported("flood", standing.memory_bytes() + flood.memory_bytes(), held + more);

    let (mut region, held) = kept(|| flood.region(&standing));
    is_reported("region", region.memory_bytes(), held);
    let places = region.len();
    // Tiles of the scene and around it; a place over each pixel under which the footprint has ground, walls included.
    let (tiles, pixels) = (10 * 10 * (16 << 10), (8 * 64 + 10) * (8 * 64 + 10));
    let bytes = standing.memory_bytes() - tiles;
    assert!(bytes <= 21 * pixels, "{bytes} bytes of standing places over {pixels} pixels");
    assert!(held.div_ceil(places) <= 40, "{held} bytes for {places} places");
    let (_, more) = kept(|| region.prepare(&NoMonitor).unwrap());
    is_reported("prepared region", region.memory_bytes(), held + more);

    let ends = [from, to].map(|at| match standing.spot(&store, at).unwrap() {
        Answer::Known(spot) => spot.unwrap(),
        Answer::NotLoaded(missing) => panic!("{missing:?}"),
    });
    let mut search = Search::new();
    let (found, held) = kept(|| search.route(&store, &region, &ends[0], &ends[1], &NoMonitor).unwrap());
    assert!(matches!(found, Answer::Known(Some(_))));
    is_reported("search", search.memory_bytes(), held);
    assert!(held.div_ceil(places) <= 14, "{held} bytes of the search for {places} places");

    let (mut long, held) = kept(|| LongSearch::new(&region, 1.2).unwrap());
    is_reported("long pawn", long.memory_bytes(), held);
    let (found, more) = kept(|| long.route(&store, &ends[0], &ends[1], &NoMonitor).unwrap());
    assert!(matches!(found, Answer::Known(Some(_))));
    is_reported("route of a long pawn", long.memory_bytes(), held + more);
    assert!((held + more).div_ceil(places) <= 68, "{} bytes of the long pawn for {places} places", held + more);

    let (planner, held) = kept(|| {
        let mut planner = Coarse::new(&store, pawn, from, to).unwrap();
        assert!(matches!(planner.advance(&store, usize::MAX, &NoMonitor), Ok(Planned::Done(Ok(_)))));
        planner
    });
    is_reported("coarse plan", planner.memory_bytes(), held);

    for length in [None, Some(1.2)] {
        let (reported, held) = measured(|| {
            let mut planner = Planner::new(&store, pawn, from, to).unwrap().drawn_out(length);
            loop {
                match planner.advance(&store, usize::MAX, &NoMonitor).unwrap() {
                    Planned::Done(found) => break assert!(found.is_ok(), "{found:?}"),
                    Planned::NotLoaded(missing) => panic!("{missing:?}"),
                    _ => {}
                }
            }
            planner.peak_bytes()
        });
        is_peak("planner", reported, held);
    }
    let Answer::Known(Some(guide)) = search.route(&store, &region, &ends[0], &ends[1], &NoMonitor).unwrap() else {
        panic!("there was a route before")
    };
    let (reported, held) = measured(|| {
        let mut refiner = RouteRefiner::new(pawn, from, to, &guide, 1.0);
        assert!(matches!(refiner.advance(&store, &NoMonitor), Ok(Answer::Known(Ok(_)))));
        refiner.peak_bytes()
    });
    is_peak("refiner", reported, held);
}
