//! A pawn climbs stairs in an app without a window.

use bevy_app::App;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use bevy_transform::components::Transform;
use bevy_walk::{Pawn, Scan, ScanPlugin};
use slicewalk::archive::{Archive, ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::nalgebra::{Point3, Vector2, Vector3};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::plan::Plan;
use slicewalk::walk::{Config, MoveInput};
use std::time::Duration;

/// Where `f32` has steps of half a metre: a corner of the grid's pages of 3.2 × 3.2 × 9.6 m.
const FAR: [f64; 3] = [4_500_000.0, 5_299_200.0, 96.0];
const FAR_PAGE: PageKey = PageKey { tx: 1_406_250, ty: 1_656_000, layer: 10 };

/// A flight of 12 stairs along x, from (0, 0, 0) up to 2.04 m, with a landing on either side, at `FAR`.
fn stairs() -> Archive {
    let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
    let steps = |i: i32| (i.div_euclid(6) + 1).clamp(0, 12);
    let page = |tx: i32| {
        let mut builder = PageBuilder::default();
        for (px, py) in (0..64).flat_map(|px| (0..64).map(move |py| (px, py))) {
            let top = plan.frame.quantum_ceil(0.17 * f64::from(steps(tx * 64 + px)));
            let span = Span::new(0, top as u32, false).unwrap();
            assert!(builder.set_column(px as u32, py, &[span]));
        }
        builder.build()
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stairs.slices");
    let mut writer = ArchiveWriter::create(&path, &plan, false).unwrap();
    let mut encoder = PageEncoder::of_plan(&plan);
    let mut pages: Vec<_> = [-1, 0, 1].iter().flat_map(|&tx| [-1, 0].map(|ty| (tx, ty))).collect();
    pages.sort_by_key(|&(tx, ty)| key(tx, ty).column());
    for (tx, ty) in pages {
        writer.put(key(tx, ty), encoder.encode(key(tx, ty), &page(tx))).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
    Archive::from_bytes(std::fs::read(path).unwrap()).unwrap()
}

fn key(tx: i32, ty: i32) -> PageKey {
    PageKey { tx: FAR_PAGE.tx + tx, ty: FAR_PAGE.ty + ty, ..FAR_PAGE }
}

#[test]
fn a_pawn_climbs_the_stairs_and_its_transform_follows() {
    let origin = Point3::from(FAR);
    let scan = Scan::new(stairs(), 16 << 20, origin).unwrap();
    let mut pawn = Pawn::new(&scan, Config::default(), origin + Vector3::new(-1.5, 0.0, 0.1)).unwrap();
    pawn.wish = MoveInput::Direction(Vector2::x());
    let tick = Duration::from_secs_f64(1.0 / 64.0);
    let mut app = App::new();
    app.add_plugins((TimePlugin, ScanPlugin))
        .insert_resource(TimeUpdateStrategy::ManualDuration(tick))
        .insert_resource(Time::<Fixed>::from_duration(tick))
        .insert_resource(scan);
    let walker = app.world_mut().spawn((pawn, Transform::default())).id();
    let place = |app: &App| app.world().get::<Transform>(walker).unwrap().translation;
    let mut highest = f32::MIN;
    // Ticks without their pages do not count: the app runs as fast as it can, and the reader may be slow.
    let (mut walked, mut waited) = (0, 0);
    while walked < 64 * 6 {
        app.update();
        highest = highest.max(place(&app).y);
        if app.world().get::<Pawn>(walker).unwrap().waits() {
            waited += 1;
            assert!(waited < 60_000, "pages never come");
            std::thread::sleep(Duration::from_millis(1));
        } else {
            walked += 1;
        }
    }
    assert!((highest - 2.04).abs() < 0.02, "{highest}");
    let feet = app.world().get::<Pawn>(walker).unwrap().walker().feet() - origin;
    let expected = Vec3::new(feet.x as f32, feet.z as f32, -feet.y as f32);
    assert!(place(&app).distance(expected) < 1e-5, "{} beside {expected}", place(&app));
}
