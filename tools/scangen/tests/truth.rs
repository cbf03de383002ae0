//! Truth compared with brute force: dense sampling of every shape, marching along rays, and moved scenes.

use proptest::prelude::*;
use scangen::geometry::{Aabb, Placement, add, length, scale, sub, unit};
use scangen::shape::{Cylinder, Disc, Polygon, Shape, Terrain, Wave};
use scangen::{Params, SampleSpec, Scene, Truth};

/// Points of a shape's chart grid, `n` along each side, and the largest distance of a surface point from one of them.
fn dense(shape: &Shape, n: usize, stretch: f64) -> (Vec<[f64; 3]>, f64) {
    let [w, h] = shape.chart_size();
    let mut points = Vec::new();
    for i in 0..=n {
        for j in 0..=n {
            points.extend(shape.chart(w * i as f64 / n as f64, h * j as f64 / n as f64));
        }
    }
    // Twice a cell's diagonal: at the border of a disc or polygon, the nearest grid point inside is at most this far
    // away.
    (points, 2.0 * stretch * (w / n as f64).hypot(h / n as f64))
}

fn check_against_sampling(shape: &Shape, query: &Aabb, stretch: f64, numeric: f64) -> Result<(), TestCaseError> {
    let (points, gap) = dense(shape, 120, stretch);
    let sampled = points.iter().map(|p| query.point_distance_squared(*p)).fold(f64::INFINITY, f64::min).sqrt();
    let exact = shape.distance_to_box(query);
    prop_assert!(exact <= sampled + 1e-9 + numeric, "{exact} above the sampled {sampled}");
    prop_assert!(sampled <= exact + gap + numeric, "{sampled} sampled, {exact} said, grid {gap}");
    Ok(())
}

fn boxes(reach: f64) -> impl Strategy<Value = Aabb> {
    let corner = [-reach..reach, -reach..reach, -reach..reach];
    (corner, [0.0..2.0, 0.0..2.0, 0.0..2.0]).prop_map(|(min, size)| Aabb::new(min, add(min, size)))
}

fn vectors(reach: f64) -> impl Strategy<Value = [f64; 3]> {
    [-reach..reach, -reach..reach, -reach..reach]
}

/// A regular polygon in a random plane: any orientation, 3 to 7 corners.
fn polygons() -> impl Strategy<Value = Polygon> {
    (vectors(2.0), vectors(1.0), vectors(1.0), 3usize..8, 0.3..3.0).prop_filter_map("a plane", |(c, a, b, n, r)| {
        let a = unit(a);
        let along = scale(a, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]);
        let b = sub(b, along);
        (length(a) > 0.5 && length(b) > 0.1).then(|| {
            let b = unit(b);
            let corner = |i: usize| {
                let (s, c0) = (std::f64::consts::TAU * i as f64 / n as f64).sin_cos();
                add(c, add(scale(a, r * c0), scale(b, r * s)))
            };
            Polygon::new((0..n).map(corner).collect())
        })
    })
}

fn small_terrain() -> Terrain {
    let wave = |amplitude, kx, ky, phase| Wave { amplitude, k: [kx, ky], phase };
    let waves = vec![wave(0.8, 1.1, 0.4, 0.2), wave(0.3, -0.7, 2.3, 1.0), wave(0.05, 6.0, 5.0, 0.0)];
    Terrain { center: [0.3, -0.2, 0.1], half: [3.0, 2.5], heading_deg: 33.0, waves }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn distance_from_box_to_polygon_is_that_of_its_points(polygon in polygons(), query in boxes(4.0)) {
        check_against_sampling(&Shape::Polygon(polygon), &query, 1.0, 0.0)?;
    }

    #[test]
    fn distance_from_box_to_lattice_rectangle_is_that_of_its_points(
        corner in [-2i32..3, -2..3, -2..3], size in [1i32..4, 1..4], axis in 0usize..3,
        low in [-3i32..4, -3..4, -3..4], extent in [0i32..3, 0..3, 0..3],
    ) {
        // On a lattice, boxes and rectangles touch often; closed sets then meet.
        let mut edges = [[0.0; 3]; 2];
        edges[0][(axis + 1) % 3] = f64::from(size[0]);
        edges[1][(axis + 2) % 3] = f64::from(size[1]);
        let shape = Shape::Polygon(Polygon::parallelogram(corner.map(f64::from), edges[0], edges[1]));
        let min = low.map(f64::from);
        let query = Aabb::new(min, add(min, extent.map(f64::from)));
        let exact = query.distance_squared(&shape.bounds()).sqrt();
        prop_assert_eq!(shape.distance_to_box(&query), exact);
    }

    #[test]
    fn distance_from_box_to_cylinder_is_that_of_its_points(
        center in [-2.0..2.0, -2.0..2.0], radius in 0.05..2.5, z in -2.0..2.0, height in 0.1..3.0, query in boxes(4.0),
    ) {
        let cylinder = Cylinder { center, radius, z_min: z, z_max: z + height };
        check_against_sampling(&Shape::Cylinder(cylinder), &query, 1.0, 0.0)?;
    }

    #[test]
    fn distance_from_box_to_disc_is_that_of_its_points(
        center in vectors(2.0), radius in 0.05..2.5, query in boxes(4.0),
    ) {
        check_against_sampling(&Shape::Disc(Disc { center, radius }), &query, 1.0, 0.0)?;
    }

    #[test]
    fn distance_from_box_to_terrain_is_that_of_its_points(query in boxes(4.0)) {
        check_against_sampling(&Shape::Terrain(small_terrain()), &query, 2.5, Terrain::TOLERANCE_M)?;
    }

    #[test]
    fn turning_the_world_does_not_change_the_distance_to_a_point(
        p in vectors(6.0), rotate_deg in -180.0..180.0, translate in vectors(100.0),
    ) {
        let place = Placement { rotate_deg, translate };
        for name in ["house", "stairs", "church"] {
            let scene = Scene::named(name, &Params::new()).unwrap();
            let (here, there) = (scene.distance_to_point(p), scene.placed(&place).distance_to_point(place.apply(p)));
            prop_assert!((here - there).abs() < 1e-9, "{name}: {here} and {there}");
        }
    }
}

/// Distance along a ray by marching: each step is as long as the distance to the nearest surface.
fn march(scene: &Scene, origin: [f64; 3], dir: [f64; 3], max: f64) -> Option<f64> {
    let mut t = 0.0;
    for _ in 0..20_000 {
        let d = scene.distance_to_point(add(origin, scale(dir, t)));
        if d < 1e-7 {
            return Some(t);
        }
        t += d;
        if t > max {
            return None;
        }
    }
    None
}

#[test]
fn rays_end_where_marching_by_distance_ends() {
    for name in ["house", "church", "terrain", "columns", "street"] {
        let scene = Scene::named(name, &Params::new()).unwrap();
        let stations = scene.stations();
        let mut agreed = 0;
        // Marching on terrain computes its numeric distance thousands of times.
        let rays = if name == "terrain" { 25 } else { 120 };
        for i in 0..rays {
            let origin = stations[i % stations.len()];
            let turn = i as f64 * 2.399963;
            let up = ((i * 37 % 100) as f64 / 50.0 - 1.0) * 0.9;
            let flat = (1.0f64 - up * up).sqrt();
            let dir = [flat * turn.cos(), flat * turn.sin(), up];
            let (marched, cast) = (march(&scene, origin, dir, 50.0), scene.raycast(origin, dir, 50.0));
            match (marched, cast) {
                // Marching stops up to 1e-7 from the surface; a shallow angle stretches that along the ray.
                (Some(m), Some((c, _))) if (m - c).abs() < 1e-3 => agreed += 1,
                (None, None) => agreed += 1,
                // Terrain is known only to its tolerance, and grazing rays stretch that.
                (Some(m), Some((c, _))) if name == "terrain" && (m - c).abs() < 0.1 => agreed += 1,
                other => eprintln!("{name}: {origin:?} {dir:?}: {other:?}"),
            }
        }
        assert!(agreed + 1 >= rays, "{name}: {agreed} of {rays} rays agree");
    }
}

#[test]
fn every_point_of_a_floor_is_found_from_just_above_it_and_every_ceiling_from_just_below() {
    for name in scangen::SCENES.iter().map(|s| s.name) {
        let scene = Scene::named(name, &Params::new()).unwrap();
        for sample in scene.samples(3, &SampleSpec::direct_count(3000)).unwrap() {
            let [x, y, z] = sample.position;
            let slope = scene.slope_at(sample.surface as usize, x, y);
            if slope > 89.0 {
                continue;
            }
            let (floor, _) = scene.floor_under(x, y, z + 1e-7).unwrap_or_else(|| panic!("{name}: no floor"));
            let (ceiling, _) = scene.ceiling_above(x, y, z - 1e-7).unwrap_or_else(|| panic!("{name}: no ceiling"));
            assert!((floor - z).abs() < 2e-7 && (ceiling - z).abs() < 2e-7, "{name}: {floor} {z} {ceiling}");
        }
    }
}

#[test]
fn a_box_on_the_border_meets_and_one_beside_it_tells_the_gap() {
    let plane = Scene::named("plane", &Params::new().with("size", 2.0)).unwrap();
    assert_eq!(plane.distance_to_box([-0.1, -0.1, 0.0], [0.1, 0.1, 1.0]), 0.0);
    assert_eq!(plane.distance_to_box([-0.1, -0.1, 0.25], [0.1, 0.1, 1.0]), 0.25);
    assert_eq!(plane.distance_to_box([1.0, 1.0, -1.0], [2.0, 2.0, 1.0]), 0.0);
    assert_eq!(plane.distance_to_box([4.0, 5.0, 0.0], [5.0, 6.0, 0.0]), 5.0);
    assert_eq!(plane.distance_to_box([-9.0; 3], [9.0; 3]), 0.0);
}

#[test]
fn ramps_have_the_slopes_of_their_names_at_every_heading() {
    let params = Params::new().with("slope_step", 7.5).with("heading_step", 30.0);
    let ramps = Scene::named("ramps", &params).unwrap();
    let slopes: Vec<f64> = (0..ramps.surfaces().len()).map(|i| ramps.slope_at(i, 0.0, 0.0)).collect();
    assert_eq!(slopes.len(), 13 * 4);
    for (i, slope) in slopes.iter().enumerate() {
        assert!((slope - 7.5 * (i / 4) as f64).abs() < 1e-9, "ramp {i}: {slope}");
    }
}

#[test]
fn the_slope_of_terrain_is_that_of_its_heights() {
    let scene = Scene::named("terrain", &Params::new()).unwrap();
    let scene = scene.placed(&Placement { rotate_deg: 30.0, translate: [5.0, 6.0, 7.0] });
    for i in 0..50 {
        let (x, y) = (5.0 + i as f64, 6.0 - 0.7 * i as f64);
        let height = |x, y| scene.floor_under(x, y, 1e6).unwrap().0;
        let h = 1e-4;
        let dx = (height(x + h, y) - height(x - h, y)) / (2.0 * h);
        let dy = (height(x, y + h) - height(x, y - h)) / (2.0 * h);
        let (_, slope) = scene.floor_under(x, y, 1e6).unwrap();
        assert!((dx.hypot(dy).atan().to_degrees() - slope).abs() < 1e-4);
    }
}
