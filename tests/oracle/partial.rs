//! Half-loaded scenes compared with whole ones: every query gives the answer of the whole scene or "not loaded", and
//! loading the reported pages suffices.

use super::scene::{Part, Random, Scene};
use nalgebra::{Isometry3, Point3, Vector3};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::object::{Model, Object, touches_scene};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::query::*;
use slicewalk::store::Snapshot;

/// A scene with some pages loaded.
struct Half<'a> {
    scene: &'a Scene,
    full: Part,
    loaded: Vec<PageKey>,
    /// Queries that were not answered at first.
    waited: usize,
}

impl Half<'_> {
    /// Repeats a query, loading the missing pages, until it has an answer, which must be that of the whole scene.
    fn ask<T: PartialEq + std::fmt::Debug>(&mut self, what: &str, query: impl Fn(&Snapshot) -> Answer<T>) {
        let mut store = self.scene.part(&self.loaded);
        let mut known = self.loaded.clone();
        loop {
            match query(&store) {
                Answer::NotLoaded(missing) => {
                    let keys = missing.keys();
                    assert!(!keys.is_empty() && keys.iter().all(|key| !known.contains(key)), "{what}: {missing:?}");
                    assert_eq!(store.load(keys), keys.len(), "{what}: {missing:?}");
                    self.waited += usize::from(known.len() == self.loaded.len());
                    known.extend_from_slice(keys);
                }
                known => return assert_eq!(known, query(&self.full), "{what}"),
            }
        }
    }

    fn ask_overlap(&mut self, what: &str, query: impl Fn(&Snapshot) -> Overlap) {
        self.ask(what, |store| match query(store) {
            Overlap::NotLoaded(missing) => Answer::NotLoaded(missing),
            known => Answer::Known(known == Overlap::Hit),
        });
    }

    fn ask_all<H: Solid + std::fmt::Debug>(&mut self, shape: &H, random: &mut Random) {
        let (scene, what) = (self.scene, format!("{shape:?}"));
        let unit = scene.frame.pixel_m();
        let from = scene.random_point(random).z;
        let depth = [0.0, 20.0 * unit, 1e4][random.below(3)];
        let reach = [depth, f64::INFINITY][random.below(2)];
        let motion = Vector3::from_fn(|_, _| [0.0, random.between(-30.0, 30.0) * unit][random.below(2)]);
        let max = unit * [0.5, 20.0][random.below(2)];
        self.ask_overlap(&what, |store| overlaps(store, shape));
        self.ask(&what, |store| probe(store, shape));
        self.ask(&what, |store| floor_under(store, shape, from, reach));
        self.ask(&what, |store| ceiling_above(store, shape, from, reach));
        self.ask(&what, |store| top_under(store, shape, from, depth));
        self.ask(&what, |store| clearance(store, shape, max));
        self.ask(&what, |store| depenetrate(store, shape, max));
        let at = scene.random_point(random);
        self.ask(&what, |store| match nearest_surface(store, at, max) {
            // Of several places equally near, any one is an answer.
            Answer::Known(found) => Answer::Known(found.map(|found| found.distance)),
            Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
        });
        self.ask(&what, |store| mean_floor_under(store, shape, from, depth));
        self.ask(&what, |store| match sweep(store, shape, motion) {
            // A shape that begins inside solid may report any span that contains it.
            Answer::Known(Some(hit)) if hit.begins_inside() => Answer::Known(None),
            Answer::Known(hit) => Answer::Known(Some(hit)),
            Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
        });
    }
}

/// Moves the sides of `shape` selected by the bits of `infinite` to infinity.
fn opened(shape: &Aabb, infinite: usize) -> Aabb {
    let side = |bit: usize, inside: f64, outside: f64| if infinite >> bit & 1 == 1 { outside } else { inside };
    let min = Point3::from([0, 1, 2].map(|axis| side(axis, shape.min()[axis], f64::NEG_INFINITY)));
    let max = Point3::from([0, 1, 2].map(|axis| side(axis + 3, shape.max()[axis], f64::INFINITY)));
    Aabb::new(min, max).unwrap()
}

/// A bent rod of 20 pixels, as an object in a scene.
fn rod(frame: Frame) -> Model {
    let mut builder = PageBuilder::default();
    for n in 0..20u32 {
        let span = Span::new(100 + 20 * n, 140 + 20 * n + n % 3, false).unwrap();
        assert!(builder.set_column(10 + n, 20 + n * n / 25, &[span]));
    }
    Model::from_pages(&Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())])).unwrap()
}

fn middle(model: &Model) -> Point3<f64> {
    let corners = model.boxes().map(|(min, max)| nalgebra::center(&min, &max).coords).collect::<Vec<_>>();
    Point3::from(corners.iter().sum::<Vector3<f64>>() / corners.len() as f64)
}

#[test]
fn no_answer_of_a_half_loaded_scene_contradicts_the_whole_one() {
    let mut waited = 0;
    for (scene, mut random) in Scene::all() {
        for percent in [0, 40, 80] {
            let loaded = scene.pages.iter().map(|page| page.0).filter(|_| random.chance(percent)).collect();
            let mut half = Half { scene: &scene, full: scene.part(&scene.keys()), loaded, waited: 0 };
            for _ in 0..12 {
                let shape = scene.random_box(&mut random);
                let size = (shape.max() - shape.min()) / 2.0;
                let radius = [0.0, size.x, size.norm()][random.below(3)];
                half.ask_all(&shape, &mut random);
                half.ask_all(&opened(&shape, random.below(64)), &mut random);
                half.ask_all(&Cylinder::new(shape.min(), radius, size.z).unwrap(), &mut random);
                half.ask_all(&Sphere::new(shape.min(), radius).unwrap(), &mut random);
                let way = scene.random_point(&mut random) - shape.min() + Vector3::new(0.0, 0.0, 1e-3);
                let ray = Ray::new(shape.min(), way, [f64::INFINITY, way.norm()][random.below(2)]).unwrap();
                half.ask("ray", |store| cast(store, &ray));
            }
            waited += half.waited;
        }
    }
    assert!(waited > 10_000, "{waited}: the test shows little");
}

#[test]
fn no_object_in_a_half_loaded_scene_is_free_where_it_is_not_in_the_whole_one() {
    let (mut waited, mut hits) = (0, 0);
    for (scene, mut random) in Scene::all() {
        let rods =
            [rod(scene.frame), rod(Frame::new(scene.frame.pixel_m() / 3.0, scene.frame.slice_m() / 2.0).unwrap())];
        for percent in [0, 40, 80] {
            let loaded = scene.pages.iter().map(|page| page.0).filter(|_| random.chance(percent)).collect();
            let mut half = Half { scene: &scene, full: scene.part(&scene.keys()), loaded, waited: 0 };
            for n in 0..20 {
                let turn = Vector3::from_fn(|_, _| random.between(-3.0, 3.0));
                // Mostly around a point of the scene, so that the rod's middle is near solid.
                let near = Isometry3::new(scene.random_point(&mut random).coords, turn);
                let pose = near * nalgebra::Translation3::from(-middle(&rods[n % 2]).coords);
                let object = Object::new(&rods[n % 2], pose).unwrap();
                hits += usize::from(touches_scene(&object, &half.full) == Overlap::Hit);
                half.ask_overlap("object", |store| touches_scene(&object, store));
            }
            waited += half.waited;
        }
    }
    assert!(waited > 500 && hits > 300, "{waited} {hits}: the test shows little");
}

/// The column examined first lacks a page, but another has a floor above it: no need to wait.
#[test]
fn a_missing_page_below_the_floor_is_no_hindrance() {
    let frame = Frame::new(0.1, 0.1).unwrap();
    let page = |px| {
        let mut builder = PageBuilder::default();
        assert!(builder.set_column(px, 30, &[Span::new(100, 140, false).unwrap()]));
        builder.build()
    };
    let key = |tx, layer| PageKey { tx, ty: 0, layer };
    for [low, high] in [[key(0, 0), key(1, 1)], [key(1, 0), key(0, 1)]] {
        let pages = [low, high].map(|key| (key, page(if key.tx == 0 { 60 } else { 3 })));
        let mut part = Part::new(Snapshot::from_pages(frame, pages));
        let shape = Aabb::new(Point3::new(6.0, 3.0, 0.0), Point3::new(6.8, 3.1, 1.0)).unwrap();
        let floor = |part: &Snapshot| floor_under(part, &shape, 20.0, 20.0);
        assert!(matches!(floor(&part), Answer::NotLoaded(_)));
        assert_eq!(part.load(&[high]), 1);
        let Answer::Known(Some(found)) = floor(&part) else { panic!("{high:?} is enough") };
        assert!((found - 6.4 - 140.0 * frame.quantum_m()).abs() < 1e-9, "{found}");
        assert_eq!(part.load(&[low]), 1);
        assert_eq!(floor(&part), Answer::Known(Some(found)));
    }
}
