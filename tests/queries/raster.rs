//! Triangles on the grid: the reported pixels are those that the closed triangle touches, with its exact heights,
//! compared with separating axes in integers.

use crate::sat;

use proptest::prelude::*;
use sat::{Box3, meets_exactly};
use slicewalk::frame::Frame;
use slicewalk_mesh::Triangle;
use slicewalk_mesh::raster::Raster;

/// Steps per pixel and per quantum of the coordinates in these tests.
const FINE: i128 = 1 << 10;

/// A grid of pixels of a metre and quanta of a metre, so that coordinates on it are exact.
fn frame() -> Frame {
    Frame::new(1.0, 255.0).unwrap()
}

fn touched(frame: Frame, triangle: &Triangle) -> Vec<(i64, i64, i64, i64)> {
    let mut all = Vec::new();
    if let Some(placed) = Raster::new(frame, 45.0).place(triangle) {
        let (first, last) = placed.rows();
        (first..=last).for_each(|j| placed.for_each_pixel(j, |i, low, high| all.push((i, j, low, high))));
    }
    all
}

/// Corners in steps of 1/FINE: on borders of pixels, near them, or anywhere.
fn coordinate() -> impl Strategy<Value = i128> {
    prop_oneof![
        (-8i128..8).prop_map(|v| v * FINE),
        (-8i128..8, -2i128..3).prop_map(|(v, w)| v * FINE + w),
        (-64i128..64).prop_map(|v| v * FINE / 8),
        -8 * FINE..8 * FINE,
    ]
}

fn corners() -> impl Strategy<Value = [[i128; 3]; 3]> {
    let corner = || [coordinate(), coordinate(), coordinate()];
    // Some triangles lie in planes of the grid.
    ([corner(), corner(), corner()], prop::option::weighted(0.3, 0usize..3)).prop_map(|(mut all, level)| {
        if let Some(axis) = level {
            all[1][axis] = all[0][axis];
            all[2][axis] = all[0][axis];
        }
        all
    })
}

fn world(corners: &[[i128; 3]; 3]) -> Triangle {
    corners.map(|corner| corner.map(|v| v as f64 / FINE as f64))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn pixels_and_heights_are_those_of_the_exact_triangle(corners in corners()) {
        let found = touched(frame(), &world(&corners));
        let flat = Raster::new(frame(), 45.0).place(&world(&corners)).is_none();
        prop_assume!(!flat);
        for i in -9i64..9 {
            for j in -9i64..9 {
                let pixel = |grow: i128, low: i128, high: i128| Box3 {
                    min: [i as i128 * FINE - grow, j as i128 * FINE - grow, low],
                    max: [(i as i128 + 1) * FINE + grow, (j as i128 + 1) * FINE + grow, high],
                };
                let (sky, ground) = (100 * FINE, -100 * FINE);
                let given: Vec<_> = found.iter().filter(|p| (p.0, p.1) == (i, j)).collect();
                prop_assert!(given.len() <= 1, "{given:?}");
                // Half open: points on the upper borders belong to the next pixel.
                let mut inner = pixel(0, ground, sky);
                inner.max[0] -= 1;
                inner.max[1] -= 1;
                match given.first() {
                    None => prop_assert!(!meets_exactly(&corners, &inner), "({i}, {j}) is missing"),
                    Some(&&(_, _, low, high)) => {
                        let (low, high) = (low as i128 * FINE, high as i128 * FINE);
                        prop_assert!(meets_exactly(&corners, &pixel(0, ground, sky)), "({i}, {j}) is not touched");
                        inner.max[2] = low - 1;
                        prop_assert!(!meets_exactly(&corners, &inner), "({i}, {j}) has solid below {low}");
                        (inner.min[2], inner.max[2]) = (high + 1, sky);
                        prop_assert!(!meets_exactly(&corners, &inner), "({i}, {j}) has solid above {high}");
                        prop_assert!(meets_exactly(&corners, &pixel(1, low, low + FINE)), "({i}, {j}): {low} too low");
                        prop_assert!(meets_exactly(&corners, &pixel(1, high - FINE, high)), "({i}, {j}): {high}");
                    }
                }
            }
        }
    }

    #[test]
    fn winding_and_first_corner_do_not_show(corners in corners()) {
        let [a, b, c] = world(&corners);
        let expected = touched(frame(), &[a, b, c]);
        for other in [[b, c, a], [c, a, b], [a, c, b], [c, b, a], [b, a, c]] {
            prop_assert_eq!(&touched(frame(), &other), &expected);
        }
    }

    #[test]
    fn far_from_the_origin_no_place_of_the_triangle_is_missed(
        corner in [-1e7f64..1e7, -1e7f64..1e7, -1e3f64..1e3],
        edges in [[-3.0f64..3.0, -3.0f64..3.0, -3.0f64..3.0], [-3.0f64..3.0, -3.0f64..3.0, -3.0f64..3.0]],
        t in 0.02f64..2.0,
        shares in prop::collection::vec((0.0f64..1.0, 0.0f64..1.0), 50)
    ) {
        let frame = Frame::new(t, 3.0 * t).unwrap();
        let at = |p: f64, q: f64| [0, 1, 2].map(|k| corner[k] + p * edges[0][k] + q * edges[1][k]);
        let triangle = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)];
        let found = touched(frame, &triangle);
        for (p, q) in shares {
            let (p, q) = if p + q > 1.0 { (1.0 - p, 1.0 - q) } else { (p, q) };
            let place = at(p, q);
            // The point is rounded, so it lies on the triangle only to within a few ulps.
            let near = |v: f64| 8.0 * f64::EPSILON * v.abs().max(1.0);
            let range = |k: usize| (frame.pixel_of(place[k] - near(place[k])), frame.pixel_of(place[k] + near(place[k])));
            let (x, y) = (range(0), range(1));
            let (low, high) = (frame.quantum_floor(place[2] + near(place[2])), frame.quantum_ceil(place[2] - near(place[2])));
            prop_assert!(found.iter().any(|&(i, j, bottom, top)| {
                (x.0..=x.1).contains(&i) && (y.0..=y.1).contains(&j) && bottom <= low && top >= high
            }), "{place:?}");
        }
    }

    #[test]
    fn triangles_that_share_an_edge_leave_no_pixel_between_them(corners in corners(), apex in [coordinate(), coordinate(), coordinate()]) {
        // The edge alone, as a very thin triangle beside it, touches no pixel that both triangles miss.
        let [a, b, c] = world(&corners);
        let apex = apex.map(|v| v as f64 / FINE as f64);
        let (one, other) = (touched(frame(), &[a, b, c]), touched(frame(), &[a, b, apex]));
        prop_assume!(!one.is_empty() && !other.is_empty());
        for share in 0..=64 {
            let place = [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * f64::from(share) / 64.0);
            let pixel = (frame().pixel_of(place[0]), frame().pixel_of(place[1]));
            for found in [&one, &other] {
                prop_assert!(found.iter().any(|&(i, j, ..)| (i, j) == pixel), "{place:?}");
            }
        }
    }
}

#[test]
fn level_and_upright_triangles_on_grid_lines_have_their_pixels_and_no_others() {
    // A level square half on row 1 and half on row 2, at the boundary of two slices.
    let frame = Frame::new(0.5, 1.5).unwrap();
    let found = touched(frame, &[[0.5, 0.5, 1.5], [1.25, 0.5, 1.5], [0.5, 1.25, 1.5]]);
    assert_eq!(found, [(1, 1, 255, 255), (2, 1, 255, 255), (1, 2, 255, 255)]);
    // An upright one in the plane between two rows belongs to the upper row.
    let found = touched(frame, &[[0.0, 1.0, 0.0], [0.9, 1.0, 0.0], [0.0, 1.0, 3.0]]);
    assert_eq!(found.iter().map(|p| (p.0, p.1)).collect::<Vec<_>>(), [(0, 2), (1, 2)]);
    assert_eq!((found[0].2, found[0].3, found[1].2), (0, 510, 0));
}

#[test]
fn triangles_without_area_and_those_that_are_not_finite_are_told() {
    let raster = Raster::new(frame(), 45.0);
    for bad in [
        [[1.0; 3], [1.0; 3], [2.0; 3]],
        [[0.0; 3], [1.0; 3], [2.0; 3]],
        [[0.0, 0.0, f64::NAN], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[0.0, f64::INFINITY, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    ] {
        assert!(raster.place(&bad).is_none(), "{bad:?}");
    }
}

#[test]
fn the_true_slope_decides_at_the_limit_for_every_heading() {
    for limit in [10.0f64, 30.0, 45.0, 60.0, 89.0] {
        let raster = Raster::new(frame(), limit);
        for heading in 0..36 {
            let (s, c) = (f64::from(heading) * 10.0).to_radians().sin_cos();
            let steep = |slope: f64| {
                let rise = slope.to_radians().tan();
                let triangle = [[0.0, 0.0, 0.0], [c, s, rise], [-s, c, 0.0]];
                raster.place(&triangle).unwrap().is_steep()
            };
            assert!(!steep(limit - 0.01) && !steep(limit) && steep(limit + 0.01), "{limit} at {heading}");
        }
    }
    let upright = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    assert!(Raster::new(frame(), 89.9).place(&upright).unwrap().is_steep());
    assert!(!Raster::new(frame(), 90.0).place(&upright).unwrap().is_steep(), "at a limit of 90 degrees all is floor");
}
