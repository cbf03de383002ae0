//! The recipe of `docs/splats.md` on generated rooms with floaters and holes: where one can stand, beside the archive of
//! the scene's own triangles; through doors and up the stairs.

use crate::scans;

use nalgebra::Point3;
use scangen::sample::Amount;
use scangen::write::{SplatLook, write_splats, write_triangles_obj};
use scangen::{Params, SampleSpec, Scene};
use scans::converts;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, Pawn, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const PIXEL_M: f64 = 0.05;
const RECIPE: [&str; 8] = ["--opacity", "0.65", "--max-size", "3", "--drop-floaters", "200", "--fill-holes", "0.4"];
const RADIUS: f64 = 0.25;
/// Places where only a body narrower or wider by this can stand are not compared: the grid alone shifts a wall or an edge
/// by up to a pixel, and noise more (m).
const MARGIN: f64 = 1.5 * PIXEL_M;
/// Difference of height of the same place: less than a step of the stairs (m).
const SAME_M: f64 = 0.12;

fn known<T>(answer: Answer<T>) -> T {
    match answer {
        Answer::Known(value) => value,
        Answer::NotLoaded(missing) => panic!("all pages are resident, but {missing:?}"),
    }
}

/// Heights of the places that a body reaches from a place, by pixel.
type Places = HashMap<(i64, i64), Vec<f64>>;

fn reached(archive: &Path, radius: f64, [x, y, z]: [f64; 3]) -> Places {
    let store = Snapshot::resident(&Archive::open(archive).unwrap(), &NoMonitor).unwrap();
    let pawn = Pawn::new(Body::Cylinder { radius, height: 1.8 });
    let mut standing = StandingPlaces::new(&store, pawn).unwrap();
    let start = known(standing.snapped(&store, Point3::new(x, y, z + 0.1), 0.3).unwrap()).expect("a place to start");
    let mut flood = Flood::from(start.spot);
    known(flood.grow(&mut standing, &store, &NoMonitor).unwrap());
    let mut places = Places::new();
    for place in flood.region(&standing).places() {
        let pixel = |v: f64| (v / PIXEL_M).floor() as i64;
        places.entry((pixel(place.feet.x), pixel(place.feet.y))).or_default().push(place.feet.z);
    }
    places
}

/// Returns how many of `some` are not among `all`, which may be `around` pixels away, and their number.
fn lacking(some: &Places, all: &Places, around: i64) -> (usize, usize) {
    let has = |(i, j): (i64, i64), z: f64| {
        (-around..=around).any(|a| {
            (-around..=around)
                .any(|b| all.get(&(i + a, j + b)).is_some_and(|own| own.iter().any(|v| (v - z).abs() <= SAME_M)))
        })
    };
    let places = || some.iter().flat_map(|(pixel, heights)| heights.iter().map(|z| (*pixel, *z)));
    (places().filter(|&(pixel, z)| !has(pixel, z)).count(), places().count())
}

/// A house of two storeys, and where one can stand in it.
struct House {
    folder: TempDir,
    scene: Scene,
    /// Places where a wider body can stand, and where a narrower one can.
    surely: Places,
    perhaps: Places,
}

impl House {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let house = Params::new().with("width", 10.0).with("depth", 9.0).with("storeys", 2.0);
        let scene = Scene::named("house", &house).unwrap();
        write_triangles_obj(&folder.path().join("truth.obj"), &scene, 0.25).unwrap();
        let truth = converted(&folder, "truth.obj", &["--up", "z"]);
        let start = scene.walk().unwrap().start;
        let (surely, perhaps) = (reached(&truth, RADIUS + MARGIN, start), reached(&truth, RADIUS - MARGIN, start));
        Self { folder, scene, surely, perhaps }
    }

    /// Compares a sample with `spacing_m` between splats, a floater for every twenty of them, and holes in the floors.
    fn check(&self, seed: u64, spacing_m: f64) {
        let Self { folder, scene, surely, perhaps } = self;
        let walk = scene.walk().unwrap();
        let density = 1.0 / (spacing_m * spacing_m);
        let holes = vec![[6.6, 2.4, 0.15], [2.6, 2.6, 0.12], [6.8, 7.0, 0.1]];
        let spec = SampleSpec { holes, ..SampleSpec::direct_density(density).with_noise(0.004) };
        let look = SplatLook { seed, floater_rate: 0.05, ..SplatLook::for_scene(scene, Amount::Density(density)) };
        let file = folder.path().join("rooms.ply");
        write_splats(&file, scene, &mut scene.samples(seed, &spec).unwrap(), &look).unwrap();
        let rooms = converted(folder, "rooms.ply", &[&["--up", "auto"], &RECIPE[..]].concat());
        let own = reached(&rooms, RADIUS, walk.start);
        let ((missed, sure), (wrong, claimed)) = (lacking(surely, &own, 0), lacking(&own, perhaps, 1));
        let sample = format!("seed {seed}, a splat every {spacing_m} m");
        println!("{sample}: {missed} of {sure} places missed, {wrong} of {claimed} wrong");
        assert!(sure > 40_000 && claimed > 40_000, "{sample}: {sure} {claimed}");
        assert!(missed * 50 <= sure, "{sample}: {missed} of {sure} places are missed");
        assert!(wrong * 100 <= claimed, "{sample}: {wrong} of {claimed} places are wrong");
        // The walk leads through doors and up the stairs.
        assert!(walk.end[2] > walk.start[2] + 2.0);
        for [x, y, z] in [walk.start, walk.end] {
            let is_near =
                |(i, j): (i64, i64)| (i as f64 * PIXEL_M - x).abs() < 0.3 && (j as f64 * PIXEL_M - y).abs() < 0.3;
            let mut heights = own.iter().filter(|(pixel, _)| is_near(**pixel)).flat_map(|(_, heights)| heights);
            assert!(heights.any(|own| (own - z).abs() <= SAME_M), "{sample}: no place to stand at {x}, {y}, {z}");
        }
    }
}

fn converted(folder: &TempDir, input: &str, more: &[&str]) -> PathBuf {
    let fixed = [input, "-o", "out.slices", "--force", "--quiet", "--units", "m", "--pixel", "0.05"];
    converts(folder.path(), &[&fixed[..], more].concat());
    folder.path().join("out.slices")
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_room_of_splats_can_be_walked_after_the_recipe() {
    House::new().check(1, 0.09);
}

/// `SLICEWALK_ROOMS` sets the number of samples of each density (default 3).
#[test]
#[ignore = "a minute and more, .ci/long splats"]
fn many_rooms_of_splats_can_be_walked_after_the_recipe() {
    let samples = std::env::var("SLICEWALK_ROOMS").ok().and_then(|text| text.parse().ok()).unwrap_or(3);
    let house = House::new();
    for spacing_m in [0.06, 0.09] {
        (1..=samples).for_each(|seed| house.check(seed, spacing_m));
    }
}
