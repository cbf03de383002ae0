//! Objects against objects, pawns, spheres and scenes: equal to a brute-force comparison of all pairs of pixels, and
//! within a pixel of the triangles that they represent.

use crate::bodies;

use bodies::{Oriented, Random, bunny, gap_of_triangles, grid, knot, pose};
use nalgebra::{Isometry3, Point3, Vector3};
use slicewalk::frame::Frame;
use slicewalk::object::{Model, Object, touches, touches_box, touches_scene, touches_sphere};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::query::{Aabb, Overlap, Sphere};
use slicewalk::store::Snapshot;
use slicewalk_mesh::Triangle;
use std::collections::HashMap;

const POSES: usize = 2_000;
const BUNNY_POSES: usize = 10_000;
/// Distance from touching below which results are not compared.
const SLACK: f64 = 1e-10;

fn put<'a>(model: &'a Model, pose: Isometry3<f64>) -> Object<'a> {
    Object::new(model, pose).unwrap()
}

/// The world-space boxes of a model.
fn boxes(model: &Model, pose: &Isometry3<f64>) -> Vec<Oriented> {
    model.boxes().map(|(min, max)| Oriented::new(pose, min, max)).collect()
}

/// Smallest gap between two sets of boxes, accelerated by their bounding spheres.
fn least_gap(a: &[Oriented], b: &[Oriented]) -> f64 {
    let pairs = a.iter().flat_map(|one| b.iter().map(move |other| (one, other)));
    pairs.filter(|(one, other)| one.is_near(other)).map(|(one, other)| one.gap(other)).fold(f64::INFINITY, f64::min)
}

#[test]
fn two_bunnies_touch_exactly_where_their_pixels_do() {
    let Some(triangles) = bunny() else { return };
    let frame = Frame::new(0.012, 0.036).unwrap();
    let model = Model::from_triangles(frame, &triangles, false).unwrap();
    let mut random = Random(31);
    let (mut hits, mut unclear) = (0, 0);
    for _ in 0..BUNNY_POSES {
        let poses = [(); 2].map(|()| pose(&mut random, 0.16));
        let [a, b] = poses.map(|pose| put(&model, pose));
        let gap = least_gap(&boxes(&model, &poses[0]), &boxes(&model, &poses[1]));
        if gap.abs() < SLACK {
            unclear += 1;
            continue;
        }
        assert_eq!(touches(&a, &b), gap < 0.0, "{poses:?}: {gap}");
        assert_eq!(touches(&b, &a), gap < 0.0, "{poses:?}: {gap}");
        hits += usize::from(gap < 0.0);
    }
    assert!(
        hits > BUNNY_POSES / 10 && hits < BUNNY_POSES * 9 / 10 && unclear < 3,
        "{hits} of {BUNNY_POSES}: the test shows little"
    );
}

#[test]
fn touching_triangles_are_never_missed_and_phantoms_are_within_a_voxel_of_each() {
    let triangles = knot(24, 6);
    let frame = Frame::new(0.02, 0.06).unwrap();
    let model = Model::from_triangles(frame, &triangles, false).unwrap();
    let voxel = Vector3::new(0.02, 0.02, 0.06).norm();
    let mut random = Random(32);
    let (mut hits, mut clear) = (0, 0);
    for _ in 0..POSES / 10 {
        let poses = [(); 2].map(|()| pose(&mut random, 4.0));
        let [a, b] = poses.map(|pose| put(&model, pose));
        let placed = poses.map(|pose| bodies::placed(&triangles, &pose));
        let gap = gap_of_triangles(&placed[0], &placed[1]);
        if gap < -SLACK {
            assert!(touches(&a, &b), "{poses:?}: {gap}");
            hits += 1;
        } else if gap > 2.0 * voxel {
            assert!(!touches(&a, &b), "{poses:?}: {gap}");
            clear += 1;
        }
    }
    assert!(hits > POSES / 100 && clear > POSES / 100, "{hits} {clear}: the test shows little");
}

#[test]
fn pawns_and_spheres_touch_an_object_exactly_where_its_pixels_do() {
    let frame = Frame::new(0.05, 0.15).unwrap();
    let model = Model::from_triangles(frame, &knot(24, 6), false).unwrap();
    let mut random = Random(33);
    let mut hits = [0; 2];
    for _ in 0..POSES {
        let place = pose(&mut random, 1.0);
        let object = put(&model, place);
        let own = boxes(&model, &place);
        let feet = Point3::from([0; 3].map(|_| random.between(-2.5, 2.5)));
        let size = Vector3::new(random.between(0.0, 0.6), random.between(0.0, 0.6), random.between(0.0, 1.8));
        let pawn = Aabb::standing(feet, size).unwrap();
        let gap = least_gap(&own, &[Oriented::new(&Isometry3::identity(), pawn.min(), pawn.max())]);
        if gap.abs() > SLACK {
            assert_eq!(touches_box(&object, &pawn), gap < 0.0, "{pawn:?}: {gap}");
            hits[0] += usize::from(gap < 0.0);
        }
        let sphere = Sphere::new(feet, size.x).unwrap();
        let far = own.iter().map(|b| b.distance_to(feet)).fold(f64::INFINITY, f64::min);
        if (far - size.x).abs() > SLACK {
            assert_eq!(touches_sphere(&object, &sphere), far < size.x, "{sphere:?}: {far}");
            hits[1] += usize::from(far < size.x);
        }
    }
    assert!(hits.iter().all(|&hits| hits > POSES / 20 && hits < POSES * 19 / 20), "{hits:?}: the test shows little");
}

#[test]
fn objects_in_a_scene_touch_exactly_where_its_pixels_do_and_missing_pages_are_told() {
    let frame = Frame::new(0.1, 0.3).unwrap();
    let span = |bottom, top| Span::new(bottom, top, false).unwrap();
    // A floor with posts, on four pages around the origin.
    let mut pages = Vec::new();
    for (tx, ty) in [(-1, -1), (0, -1), (-1, 0), (0, 0)] {
        let mut builder = PageBuilder::default();
        // Sixteen pixels of each, next to the origin.
        for at in 0..16 * 16 {
            let from = |tile: i32, at: u32| if tile < 0 { 48 + at } else { at };
            let (px, py) = (from(tx, at % 16), from(ty, at / 16));
            let post = if px % 9 == 3 && py % 7 == 5 { 3000 } else { 420 + px % 5 };
            assert!(builder.set_column(px, py, &[span(400, post)]));
        }
        pages.push((slicewalk::frame::PageKey { tx, ty, layer: 0 }, builder.build()));
    }
    let store = Snapshot::from_pages(frame, pages);
    let scene = Model::from_pages(&store).unwrap();
    let model = Model::from_triangles(Frame::new(0.05, 0.15).unwrap(), &knot(18, 5), false).unwrap();
    // A span has a box, of six numbers of four bytes at least.
    assert_eq!(model.span_count(), model.boxes().count());
    assert!(model.weight_bytes() >= 24 * model.span_count());
    let around: Vec<Oriented> = boxes(&scene, &Isometry3::identity());
    let mut random = Random(34);
    let mut hits = 0;
    let poses = POSES / 20;
    for _ in 0..poses {
        let mut place = pose(&mut random, 3.0);
        place.translation.vector.z = random.between(-0.5, 6.0);
        let object = put(&model, place);
        let gap = least_gap(&boxes(&model, &place), &around);
        if gap.abs() < SLACK {
            continue;
        }
        let expected = if gap < 0.0 { Overlap::Hit } else { Overlap::Clear };
        assert_eq!(touches_scene(&object, &store), expected, "{place:?}: {gap}");
        // The scene as an object gives the same answer.
        assert_eq!(touches(&object, &put(&scene, Isometry3::identity())), gap < 0.0, "{place:?}: {gap}");
        hits += usize::from(gap < 0.0);
    }
    assert!(hits > poses / 10 && hits < poses * 9 / 10, "{hits} of {poses}: the test shows little");
}

#[test]
fn closed_meshes_may_be_solid() {
    let frame = Frame::new(0.02, 0.06).unwrap();
    let knot = knot(24, 12);
    let small = |size: f64| -> Vec<Triangle> { knot.iter().map(|t| t.map(|p| p.map(|v| v * size))).collect() };
    let [hollow, solid] = [false, true].map(|solid| Model::from_triangles(frame, &knot, solid).unwrap());
    let pebble = Model::from_triangles(Frame::new(0.002, 0.006).unwrap(), &small(0.04), false).unwrap();
    // The middle of the tube, far from its surface, and the hole of the ring.
    let at = |x: f64| put(&pebble, Isometry3::translation(x, 0.0, 0.0));
    let [hollow, solid] = [&hollow, &solid].map(|model| put(model, Isometry3::identity()));
    assert!(touches(&solid, &at(1.0)) && !touches(&hollow, &at(1.0)), "inside the tube");
    assert!(!touches(&solid, &at(0.0)) && !touches(&solid, &at(2.0)), "outside of it");
    assert!(touches(&hollow, &at(1.4)) && touches(&solid, &at(1.4)), "on its surface");
    // Every solid pixel agrees with the ring in closed form.
    let mut columns: HashMap<(i64, i64), Vec<(f64, f64)>> = HashMap::new();
    for (min, max) in solid.model().boxes() {
        let middle = nalgebra::center(&min, &max);
        columns.entry((frame.pixel_of(middle.x), frame.pixel_of(middle.y))).or_default().push((min.z, max.z));
    }
    let inside = |p: Vector3<f64>| (p.xy().norm() - 1.0).hypot(p.z) < 0.4;
    for (i, j) in (-80..80).flat_map(|i| (-80..80).map(move |j| (i, j))) {
        let (x, y) = ((f64::from(i) + 0.5) * 0.02, (f64::from(j) + 0.5) * 0.02);
        let pixel = columns.get(&(i64::from(i), i64::from(j)));
        let filled = pixel.is_some_and(|spans| spans.iter().any(|(low, high)| *low < 0.0 && 0.0 < *high));
        let distance = ((x.hypot(y) - 1.0).abs() - 0.4).abs();
        assert!(distance < 0.06 || filled == inside(Vector3::new(x, y, 0.0)), "({x}, {y}): {filled}");
    }
}

/// The faces of a box, facing outwards.
fn cuboid(min: [f64; 3], max: [f64; 3]) -> Vec<Triangle> {
    let corner = |bits: usize| [0, 1, 2].map(|axis| if bits >> axis & 1 == 1 { max[axis] } else { min[axis] });
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let halves = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    halves.map(|corners| corners.map(corner)).collect()
}

fn turned_inside_out(triangles: Vec<Triangle>) -> Vec<Triangle> {
    triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect()
}

#[test]
fn what_bodies_enclose_together_is_solid_and_a_cavity_is_not() {
    let frame = Frame::new(0.1, 0.3).unwrap();
    let outer = || cuboid([0.02, 0.03, 0.01], [2.04, 2.05, 2.06]);
    let (shifted, inner) =
        (cuboid([1.03, 1.01, 1.02], [3.04, 3.02, 3.05]), cuboid([0.52, 0.51, 0.53], [1.54, 1.52, 1.55]));
    let cases = [
        ("one", vec![outer()], true),
        ("one given twice", vec![outer(), outer()], true),
        ("one whose faces look inwards", vec![turned_inside_out(outer())], true),
        ("two that overlap", vec![outer(), shifted.clone()], true),
        ("two that overlap, both inwards", vec![turned_inside_out(outer()), turned_inside_out(shifted)], true),
        ("one inside the other", vec![outer(), inner.clone()], true),
        ("one with a cavity", vec![outer(), turned_inside_out(inner)], false),
    ];
    for (what, bodies, is_full) in cases {
        let model = Model::from_triangles(frame, &bodies.concat(), true).unwrap();
        let object = put(&model, Isometry3::identity());
        let touched = |at: [f64; 3]| touches_sphere(&object, &Sphere::new(at.into(), 0.02).unwrap());
        // Inside only the first body, and where another one overlaps it.
        assert!(touched([0.25, 0.25, 0.25]), "{what}");
        assert_eq!(touched([1.25, 1.25, 1.25]), is_full, "{what}");
        assert!(!touched([2.55, 0.55, 0.55]) && !touched([0.8, 0.8, 2.9]), "{what}: outside");
    }
}

#[test]
fn a_model_built_far_from_its_origin_misses_no_contact() {
    let frame = Frame::new(0.05, 0.15).unwrap();
    let mut random = Random(35);
    let block = |at: [f64; 3]| Model::from_triangles(frame, &cuboid(at, at.map(|v| v + 0.95)), false).unwrap();
    let far = [1e6, -2e6, 3e5];
    let (there, here) = (block(far.map(|v| v + 0.01)), block([0.01; 3]));
    // Both contain whole pixels: one metre along x and y.
    let wide = |model: &Model| {
        let low = model.boxes().map(|(min, _)| min.x).fold(f64::INFINITY, f64::min);
        (low, model.boxes().map(|(_, max)| max.x).fold(f64::NEG_INFINITY, f64::max))
    };
    let (from, to) = (wide(&there).0, wide(&here).1);
    assert!((wide(&here).1 - wide(&here).0 - 1.0).abs() < 1e-9);
    for _ in 0..POSES {
        let place = pose(&mut random, 3.0);
        // Moved back, beside the other, along x.
        let beside = |gap: f64| Isometry3::translation(to + gap - from, -far[1], -far[2]);
        let near = put(&here, place);
        for (gap, expected) in [(0.0, true), (1e-6, false), (-1e-6, true)] {
            let moved = put(&there, place * beside(gap));
            assert_eq!(touches(&moved, &near), expected, "{place:?} {gap}");
            assert_eq!(touches(&near, &moved), expected, "{place:?} {gap}");
        }
    }
}

#[test]
fn boxes_with_infinite_sides_are_those_with_sides_far_out() {
    let model = Model::from_triangles(Frame::new(0.05, 0.15).unwrap(), &knot(18, 5), false).unwrap();
    let mut random = Random(36);
    let mut hits = 0;
    for n in 0..POSES {
        let object = put(&model, pose(&mut random, 1.0));
        let corner = [0; 3].map(|_| random.between(-2.0, 2.0));
        let side = |bit: usize, far: f64, near: f64| if (n % 64) >> bit & 1 == 1 { far } else { near };
        let shape = |far: f64| {
            let min = [0, 1, 2].map(|axis| side(axis, -far, corner[axis]));
            let max = [0, 1, 2].map(|axis| side(axis + 3, far, corner[axis] + 0.1));
            touches_box(&object, &Aabb::new(min.into(), max.into()).unwrap())
        };
        let expected = shape(10.0);
        for far in [1e6, 1e12, 1e300, f64::MAX, f64::INFINITY] {
            assert_eq!(shape(far), expected, "{corner:?} {n} {far}");
        }
        hits += usize::from(expected);
    }
    assert!(hits > POSES / 10 && hits < POSES * 9 / 10, "{hits} of {POSES}: the test shows little");
}

#[test]
fn what_is_no_pose_and_no_triangle_is_refused() {
    let frame = Frame::new(0.05, 0.15).unwrap();
    let block = Model::from_triangles(frame, &grid(3), false).unwrap();
    let turned = |turn: nalgebra::Quaternion<f64>| {
        Isometry3::from_parts(Default::default(), nalgebra::UnitQuaternion::new_unchecked(turn))
    };
    let nan = f64::NAN;
    for bad in [
        Isometry3::translation(nan, 0.0, 0.0),
        Isometry3::translation(0.0, f64::INFINITY, 0.0),
        Isometry3::translation(0.0, 0.0, -1e101),
        Isometry3::rotation(Vector3::new(nan, 0.0, 0.0)),
        turned(nalgebra::Quaternion::new(0.0, 0.0, 0.0, 0.0)),
        turned(nalgebra::Quaternion::new(1.0, 0.1, 0.0, 0.0)),
    ] {
        let error = Object::new(&block, bad).unwrap_err().to_string();
        assert!(error.contains("pose"), "{bad:?}: {error}");
    }
    // Rounding drift after many rotations is accepted.
    assert!(Object::new(&block, turned(nalgebra::Quaternion::new(1.0 + 1e-9, 0.0, 0.0, 0.0))).is_ok());
    for bad in [nan, f64::INFINITY, f64::NEG_INFINITY] {
        let mut triangles = grid(3);
        triangles[1][2][0] = bad;
        for solid in [false, true] {
            let error = Model::from_triangles(frame, &triangles, solid).unwrap_err().to_string();
            assert!(error.contains("triangle 1 of 2") && error.contains("finite"), "{error}");
        }
    }
    // Each fits, but not all together, which is detected before any of them is rasterised.
    let many: Vec<Triangle> = (0..200).flat_map(|_| grid(50)).collect();
    let error = Model::from_triangles(frame, &many, false).unwrap_err().to_string();
    assert!(error.contains("pixels of all triangles") && error.contains("200000000"), "{error}");
}

#[test]
fn models_without_matter_touch_nothing_and_models_beyond_the_grid_are_refused() {
    let frame = Frame::new(0.05, 0.15).unwrap();
    let empty = Model::from_triangles(frame, &[[[0.0; 3]; 3]], true).unwrap();
    let block = Model::from_triangles(frame, &grid(3), false).unwrap();
    let [empty, block] = [&empty, &block].map(|model| put(model, Isometry3::identity()));
    assert!(!touches(&empty, &block) && !touches(&block, &empty) && touches(&block, &block));
    let everything = Aabb::new(Point3::from([-1e9; 3]), Point3::from([1e9; 3])).unwrap();
    assert!(!touches_box(&empty, &everything) && touches_box(&block, &everything));
    assert!(!touches_sphere(&empty, &Sphere::new(Point3::origin(), 1e9).unwrap()));
    let far = [[1e12, 0.0, 0.0], [1e12 + 1.0, 0.0, 0.0], [1e12, 1.0, 0.0]];
    let error = Model::from_triangles(frame, &[far], false).unwrap_err().to_string();
    assert!(error.contains("give larger ones"), "{error}");
    // Too large an area, two places too far from each other, and an area at the limit without room for its edges.
    let corner = |at: f64, side: f64| [[at, 0.0, 0.0], [at + side, 0.0, 0.0], [at, side, 0.0]];
    let wide = [[0.0; 3], [1e8, 0.0, 0.0], [0.0, 0.01, 0.0]];
    for (triangles, says) in [
        (vec![wide], "pixels of all triangles of a model"),
        (vec![corner(0.0, 0.1), corner(6e7, 0.1)], "along an axis of a model"),
        (vec![corner(0.0, 579.25)], "pixels of a model's triangles"),
    ] {
        let error = Model::from_triangles(frame, &triangles, false).unwrap_err().to_string();
        assert!(error.contains(says) && error.contains("give a larger pixel"), "{error}");
    }
}

#[test]
fn a_model_counts_its_spans_and_bytes_and_needs_all_pages() {
    let frame = Frame::new(0.05, 0.15).unwrap();
    let model = Model::from_triangles(frame, &knot(18, 5), false).unwrap();
    assert_eq!(model.span_count(), model.boxes().count());
    let each = model.weight_bytes() as f64 / model.span_count() as f64;
    assert!((24.0..48.0).contains(&each), "{each} bytes a span");
    let mut page = PageBuilder::default();
    assert!(page.set_column(1, 2, &[Span::new(0, 255, false).unwrap()]));
    let key = slicewalk::frame::PageKey { tx: 3, ty: -2, layer: 1 };
    let scene = Snapshot::from_pages(frame, [(key, page.build())]);
    assert_eq!(Model::from_pages(&scene).unwrap().span_count(), 1);
    let error = Model::from_pages(&scene.keep_loaded(|_| false)).unwrap_err().to_string();
    assert!(error.contains("page (3, -2, 1) is not in memory"), "{error}");
}
