//! The documented recipe on generated rooms with floaters and holes: where one can stand beside the scene's own surfaces,
//! doors, and stairs.

use crate::scans;

use nalgebra::Point3;
use scangen::write::{SplatLook, write_splats};
use scangen::{Params, SampleSpec, Scene, Truth};
use scans::{converts, text};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, Pawn, Region, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use std::collections::HashMap;
use std::path::Path;

/// Pixel of the archives, and the recipe of `docs/splats.md`.
const PIXEL_M: f64 = 0.05;
const RECIPE: [&str; 8] = ["--min-opacity", "0.3", "--max-size", "3", "--drop-floaters", "200", "--fill-holes", "0.4"];
const RADIUS: f64 = 0.25;
const HEIGHT: f64 = 1.8;
/// Highest step of a pawn (m).
const CLIMB: f64 = 0.35;
/// Places nearer than this to the border between standing and not are not judged (m).
const MARGIN: f64 = 1.5 * PIXEL_M;
/// Difference of height of the same place (m).
const SAME_M: f64 = 0.12;
/// Floor counts as level under a body down to this (m).
const LEVEL_M: f64 = 0.05;

fn known<T>(answer: Answer<T>) -> T {
    match answer {
        Answer::Known(value) => value,
        Answer::NotLoaded(missing) => panic!("all pages are resident, but {missing:?}"),
    }
}

/// Whether nothing is in an upright cylinder with its feet at `z`, above a step.
fn is_free(scene: &Scene, [x, y, z]: [f64; 3], radius: f64) -> bool {
    (1..12).all(|n| {
        let (sin, cos) = (f64::from(n) * std::f64::consts::FRAC_PI_2 / 12.0).sin_cos();
        let (a, b) = (radius * cos, radius * sin);
        scene.distance_to_box([x - a, y - b, z + CLIMB], [x + a, y + b, z + HEIGHT]) > 0.0
    })
}

/// Places around another one, and itself.
fn around([x, y]: [f64; 2], radius: f64) -> impl Iterator<Item = [f64; 2]> {
    let ring = move |n: i32| {
        let (sin, cos) = (f64::from(n) * std::f64::consts::FRAC_PI_8).sin_cos();
        [0.5, 1.0].map(|share| [x + share * radius * cos, y + share * radius * sin])
    };
    std::iter::once([x, y]).chain((0..16).flat_map(ring))
}

/// Whether a body surely stands with its middle over level floor at `z`, a little wider than it is.
fn stands_surely(scene: &Scene, [x, y]: [f64; 2], z: f64) -> bool {
    let wide = RADIUS + MARGIN;
    let level = around([x, y], wide).all(|[x, y]| {
        scene.floor_under(x, y, z + CLIMB).is_some_and(|(other, slope)| (other - z).abs() < LEVEL_M && slope < 45.0)
    });
    level && is_free(scene, [x, y, z], wide)
}

/// Whether a slightly narrower body may stand there: a floor at its feet's height lies under a wider one.
fn may_stand(scene: &Scene, [x, y, z]: [f64; 3]) -> bool {
    let near = around([x, y], RADIUS + MARGIN).any(|[x, y]| {
        scene.floor_under(x, y, z + SAME_M).is_some_and(|(floor, slope)| (floor - z).abs() <= SAME_M && slope <= 45.0)
    });
    near && is_free(scene, [x, y, z + SAME_M], RADIUS - MARGIN)
}

fn region(standing: &mut StandingPlaces, store: &Snapshot, mut flood: Flood) -> Region {
    known(flood.grow(standing, store, &NoMonitor).unwrap());
    flood.region(standing)
}

struct Rooms {
    scene: Scene,
    store: Snapshot,
}

fn rooms(folder: &Path, scene: Scene, spread_m: f64, holes: &[[f64; 3]], floater_rate: f64) -> Rooms {
    let count = (scene.area() / (spread_m * spread_m)) as u64;
    let spec = SampleSpec { holes: holes.to_vec(), ..SampleSpec::direct_count(count).with_noise(0.004) };
    let look = SplatLook { floater_rate, ..SplatLook::for_scene(&scene, Some(count)) };
    let mut samples = scene.samples(2, &spec).unwrap();
    write_splats(&folder.join("rooms.ply"), &scene, &mut samples, &look).unwrap();
    drop(samples);
    let pixel = PIXEL_M.to_string();
    let fixed = ["rooms.ply", "-o", "rooms.slices", "--quiet", "--force", "--units", "m", "--up", "auto", "--pixel"];
    converts(folder, &[&fixed[..], &[&pixel], &RECIPE].concat());
    let archive = Archive::open(folder.join("rooms.slices")).unwrap();
    Rooms { scene, store: Snapshot::resident(&archive, &NoMonitor).unwrap() }
}

/// Shares of the places that are missed and wrong, of those that are judged.
fn judged(Rooms { scene, store }: &Rooms, pawn: Pawn) -> (f64, f64) {
    let mut standing = StandingPlaces::new(store, pawn).unwrap();
    let flood = known(Flood::everywhere(&mut standing, store).unwrap());
    let region = region(&mut standing, store, flood);
    let pixel = |v: f64| (v / PIXEL_M).floor() as i64;
    let mut found: HashMap<(i64, i64), Vec<f64>> = HashMap::new();
    let (mut claimed, mut wrong) = (0u64, 0u64);
    for place in region.places() {
        let feet = place.feet;
        found.entry((pixel(feet.x), pixel(feet.y))).or_default().push(feet.z);
        claimed += 1;
        wrong += u64::from(!may_stand(scene, [feet.x, feet.y, feet.z]));
    }
    let bounds = scene.bounds();
    let (mut sure, mut missed) = (0u64, 0u64);
    // Every third pixel along both axes.
    for i in (pixel(bounds.min[0])..=pixel(bounds.max[0])).step_by(3) {
        for j in (pixel(bounds.min[1])..=pixel(bounds.max[1])).step_by(3) {
            let at = [(i as f64 + 0.5) * PIXEL_M, (j as f64 + 0.5) * PIXEL_M];
            let mut from = bounds.max[2] + 1.0;
            while let Some((z, _)) = scene.floor_under(at[0], at[1], from) {
                if stands_surely(scene, at, z) {
                    sure += 1;
                    let here = found.get(&(i, j)).is_some_and(|all| all.iter().any(|feet| (feet - z).abs() <= SAME_M));
                    missed += u64::from(!here);
                }
                from = z - CLIMB;
            }
        }
    }
    assert!(sure > 1_000 && claimed > 10_000, "{sure} {claimed}");
    println!("{sure} sure places, {missed} missed; {claimed} claimed, {wrong} wrong");
    (missed as f64 / sure as f64, wrong as f64 / claimed as f64)
}

#[test]
fn rooms_of_splats_can_be_walked_after_the_recipe() {
    let folder = tempfile::tempdir().unwrap();
    let scene =
        Scene::named("house", &Params::new().with("width", 10.0).with("depth", 9.0).with("storeys", 2.0)).unwrap();
    let walk = scene.walk().unwrap().clone();
    let holes = [[6.6, 2.4, 0.15], [2.6, 2.6, 0.12], [6.8, 7.0, 0.1]];
    let rooms = rooms(folder.path(), scene, 0.06, &holes, 0.05);
    let pawn = Pawn::new(Body::Cylinder { radius: RADIUS, height: HEIGHT });
    let (missed, wrong) = judged(&rooms, pawn);
    assert!(missed <= 0.02, "{missed} of the places are missed");
    assert!(wrong <= 0.01, "{wrong} of the places are wrong");
    // Through the doors and up the stairs.
    let mut standing = StandingPlaces::new(&rooms.store, pawn).unwrap();
    let place = |[x, y, z]: [f64; 3]| Point3::new(x, y, z + 0.1);
    let mut spot = |at: [f64; 3]| {
        let snapped = known(standing.snapped(&rooms.store, place(at), 0.3).unwrap());
        snapped.unwrap_or_else(|| panic!("nobody stands at {at:?}")).spot
    };
    let (start, end) = (spot(walk.start), spot(walk.end));
    let reached = region(&mut standing, &rooms.store, Flood::from(start));
    assert!(reached.holds(&end), "the upper storey is out of reach of {}", text(folder.path()));
}
