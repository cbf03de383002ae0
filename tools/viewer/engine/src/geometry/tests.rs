use super::*;
use proptest::prelude::*;
use slicewalk::page::{PageBuilder, Span};

const KEY: PageKey = PageKey { tx: -1, ty: 2, layer: 1 };

fn frame() -> Frame {
    Frame::new(0.05, 0.15).unwrap()
}

fn page(spans: impl Fn(u32, u32) -> Vec<(u32, u32, bool)>) -> Page {
    let mut builder = PageBuilder::default();
    for (x, y) in (0..64).flat_map(|y| (0..64).map(move |x| (x, y))) {
        let spans: Vec<Span> = spans(x, y).into_iter().map(|(b, t, o)| Span::new(b, t, o).unwrap()).collect();
        assert!(spans.is_empty() || builder.set_column(x, y, &spans));
    }
    builder.build()
}

/// Six times the volume that the quads enclose (cells² · steps), exact: wrong unless the surface is closed and faces
/// outwards.
fn volume(geometry: &Geometry) -> i64 {
    let corner = |at: usize| -> [i64; 3] { std::array::from_fn(|axis| i64::from(geometry.positions[3 * at + axis])) };
    let det = |[a, b, c]: [[i64; 3]; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    let quads = geometry.positions.len() / 12;
    (0..quads)
        .map(|n| 4 * n)
        .map(|n| det([0, 1, 2].map(|k| corner(n + k))) + det([0, 2, 3].map(|k| corner(n + k))))
        .sum()
}

fn matter(page: &Page, coarseness: u32, step: u32) -> i64 {
    let cells = Cells::of(page, None, coarseness, step);
    let edge = cells.edge as isize;
    let places = (0..edge).flat_map(|y| (0..edge).map(move |x| (x, y)));
    places.flat_map(|(x, y)| cells.at(x, y)).map(|bar| i64::from(bar.top - bar.bottom)).sum()
}

#[test]
fn a_level_floor_is_a_box_of_six_quads() {
    let page = page(|_, _| vec![(1000, 1020, false)]);
    for coarseness in 0..=COARSEST {
        let geometry = Geometry::of(&frame(), KEY, &page, None, coarseness);
        assert_eq!(geometry.positions.len(), 6 * 4 * 3, "{coarseness}");
        assert_eq!(geometry.triangles(), 12);
        assert_eq!(geometry.origin, [-3.2, 6.4, 9.6]);
    }
    let geometry = Geometry::of(&frame(), KEY, &page, None, 0);
    assert!((geometry.bounds[1][2] - (9.6 + 1020.0 * frame().quantum_m())).abs() < 1e-9);
    assert_eq!(geometry.bounds[0][..2], [-3.2, 6.4]);
    let top = geometry.origin[2] + f64::from(geometry.positions[2]) * geometry.scale[2];
    assert!((top - geometry.bounds[1][2]).abs() <= geometry.scale[2]);
}

#[test]
fn noise_below_a_step_draws_no_risers_and_stairs_do() {
    let noisy = page(|x, y| vec![(1000, 1020 + (x * 7 + y * 13) % 8, false)]);
    assert!(Geometry::of(&frame(), KEY, &noisy, None, 0).triangles() < 24);
    let stairs = page(|x, _| vec![(1000, 1020 + x / 16 * 300, false)]);
    let geometry = Geometry::of(&frame(), KEY, &stairs, None, 0);
    // Four treads, three risers and the outer sides.
    assert!((40..80).contains(&geometry.triangles()), "{}", geometry.triangles());
    assert!(geometry.attributes.chunks(4).any(|a| a[0] == 2));
}

#[test]
fn slopes_are_told_in_degrees() {
    // A rise of one pixel (85 quanta) per pixel is 45 degrees.
    let ramp = page(|x, _| vec![(0, 200 + 85 * x, false)]);
    let geometry = Geometry::of(&frame(), KEY, &ramp, None, 0);
    let tops: Vec<u8> = geometry.attributes.chunks(4).filter(|a| a[0] == 0).map(|a| a[2]).collect();
    assert!(tops.iter().filter(|slope| **slope == 45).count() * 10 > tops.len() * 9, "{tops:?}");
}

/// The page alone, without neighbours.
fn alone(page: &Page) -> [Option<&Page>; 9] {
    std::array::from_fn(|n| (n == 4).then_some(page))
}

#[test]
fn smooth_slopes_have_no_risers_and_steps_do() {
    // Rises by 60 and 50 quanta per pixel, of 85 quanta.
    let ramp = page(|x, y| vec![(0, 200 + 60 * x + 50 * y, false)]);
    let smooth = Geometry::of(&frame(), KEY, &ramp, Some(&alone(&ramp)), 0);
    let blocks = Geometry::of(&frame(), KEY, &ramp, None, 0);
    assert!(smooth.triangles() < blocks.triangles(), "{} of {}", smooth.triangles(), blocks.triangles());
    let mut checked = 0;
    for vertex in 0..smooth.positions.len() / 3 {
        let [x, y, z] = smooth.positions[3 * vertex..][..3] else { unreachable!() };
        let inner = (1..64).contains(&x) && (1..64).contains(&y);
        if smooth.attributes[4 * vertex] == 0 && inner {
            // The mean of the four columns that meet here.
            let expected = 200.0 + 60.0 * (f64::from(x) - 0.5) + 50.0 * (f64::from(y) - 0.5);
            assert!((f64::from(z) - expected).abs() < 22.0, "{z} at {x}, {y}, expected {expected}");
            let [nx, ny, nz] = smooth.normals[4 * vertex..][..3] else { unreachable!() };
            assert!((-90..-40).contains(&nx) && (-80..-30).contains(&ny) && nz > 75, "{nx} {ny} {nz}");
            checked += 1;
        }
    }
    assert!(checked > 10_000);
    // Risers of 17.6 cm stay.
    let stairs = page(|x, _| vec![(1000, 1020 + x / 16 * 300, false)]);
    let [smooth, blocks] = [Some(&alone(&stairs)), None].map(|around| Geometry::of(&frame(), KEY, &stairs, around, 0));
    assert_eq!(smooth.triangles(), blocks.triangles());
}

#[test]
fn floors_that_go_on_in_the_next_pages_are_drawn_whole() {
    let floor = page(|_, _| vec![(1000, 1020, false)]);
    for coarseness in 0..=COARSEST {
        let geometry = Geometry::of(&frame(), KEY, &floor, Some(&[Some(&floor); 9]), coarseness);
        let [mut top, mut underside] = [0; 2];
        for (corners, kinds) in geometry.positions.chunks(12).zip(geometry.attributes.chunks(16)) {
            let [x, y] = [0, 1].map(|axis| u32::from(corners[6 + axis].abs_diff(corners[axis])));
            match kinds[0] {
                0 => top += x * y,
                1 => underside += x * y,
                _ => {}
            }
        }
        let all = (64u32 >> coarseness).pow(2);
        assert_eq!([top, underside], [all; 2], "{coarseness}");
    }
}

#[test]
fn surrounded_holes_are_closed_for_the_eye() {
    let floor = |holes: &'static [(u32, u32)]| {
        page(move |x, y| match holes.contains(&(x, y)) {
            true => vec![],
            false => vec![(1000, 1020, false)],
        })
    };
    let triangles = |page: &Page| Geometry::of(&frame(), KEY, page, Some(&alone(page)), 0).triangles();
    let whole = triangles(&floor(&[]));
    assert_eq!(triangles(&floor(&[(9, 9), (30, 40)])), whole);
    let wide = floor(&[(9, 9), (10, 9), (11, 9), (9, 10), (10, 10), (11, 10), (9, 11), (10, 11), (11, 11)]);
    assert!(triangles(&wide) > whole);
}

#[test]
fn points_that_lie_apart_are_drawn_as_a_surface() {
    // A point on every third pixel, and one of five of them missing.
    let is_point = |x: u32, y: u32| [x % 3, y % 3] == [1, 1] && !(x * 7 + y * 13).is_multiple_of(5);
    let apart = page(|x, y| if is_point(x, y) { vec![(1000, 1020, false)] } else { vec![] });
    let drawn = |geometry: &Geometry| {
        let cell = (geometry.scale[0] / frame().pixel_m()).round() as u32;
        let faces = geometry.positions.chunks(12).zip(geometry.attributes.chunks(16));
        let tops = faces.filter(|(_, kinds)| kinds[0] == 0);
        let area = |corners: &[u16]| {
            [0, 1].map(|axis| u32::from(corners[6 + axis].abs_diff(corners[axis]))).iter().product::<u32>()
        };
        tops.map(|(corners, _)| area(corners)).sum::<u32>() * cell * cell
    };
    let smooth = drawn(&Geometry::of(&frame(), KEY, &apart, Some(&alone(&apart)), 0));
    let collides = drawn(&Geometry::of(&frame(), KEY, &apart, None, 0));
    let points = (0..64).flat_map(|y| (0..64).map(move |x| (x, y))).filter(|(x, y)| is_point(*x, *y)).count();
    assert_eq!(collides, points as u32, "what collides stays as it is");
    assert!(smooth > 64 * 64 * 9 / 10, "{smooth} of {} pixels", 64 * 64);
}

#[test]
fn neighbouring_pages_meet_at_the_same_heights() {
    let ground =
        |shift: u32| page(move |x, y| vec![(0, 900 + (x + shift) * 7 + y * 3 + (x + shift) * y % 11 * 9, false)]);
    let (left, right) = (ground(0), ground(64));
    let mut around = alone(&left);
    around[5] = Some(&right);
    let first = Geometry::of(&frame(), KEY, &left, Some(&around), 0);
    let mut around = alone(&right);
    around[3] = Some(&left);
    let second = Geometry::of(&frame(), KEY, &right, Some(&around), 0);
    // Tops at the common edge, by y; corners of the pages have other neighbours.
    let edge = |geometry: &Geometry, x: u16| {
        let tops = geometry.attributes.chunks(4).zip(geometry.positions.chunks(3)).zip(geometry.normals.chunks(4));
        let at = tops.filter(|((a, p), _)| a[0] == 0 && p[0] == x && (1..64).contains(&p[1]));
        at.map(|((_, p), n)| (p[1], (p[2], n[0]))).collect::<std::collections::BTreeMap<_, _>>()
    };
    let (a, b) = (edge(&first, 64), edge(&second, 0));
    let differing = a.iter().filter(|(y, at)| b.get(y).is_some_and(|other| other.0.abs_diff(at.0) > 40)).count();
    assert!(a.len() > 50 && differing == 0, "{a:?} {b:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    /// The drawing of any page is closed, faces outwards and encloses exactly the solid of the cells.
    #[test]
    fn drawings_are_closed(seed: u64, density in 1u32..40, coarseness in 0u32..=COARSEST) {
        let hash = |x: u32, y: u32, k: u32| {
            let v = seed ^ u64::from(x) << 40 ^ u64::from(y) << 20 ^ u64::from(k);
            (v.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 33) as u32
        };
        let page = page(|x, y| {
            let mut from = hash(x, y, 0) % 3000;
            let mut spans = Vec::new();
            for k in 0..hash(x, y, 1) % density % 6 {
                let top = from + hash(x, y, 2 + k) % 900;
                spans.push((from, top, hash(x, y, 9 + k) & 1 == 1));
                from = top + 2 + hash(x, y, 20 + k) % 700;
            }
            spans
        });
        let frame = frame();
        let geometry = Geometry::of(&frame, KEY, &page, None, coarseness);
        let step = (geometry.scale[2] / frame.quantum_m()).round() as u32;
        prop_assert_eq!(volume(&geometry), 6 * matter(&page, coarseness, step));
        for (vertices, normals) in geometry.positions.chunks(12).zip(geometry.normals.chunks(16)) {
            let at = |n: usize| -> [i64; 3] { std::array::from_fn(|axis| i64::from(vertices[3 * n + axis])) };
            let (a, b, c) = (at(0), at(1), at(2));
            let (u, v): ([i64; 3], [i64; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
            let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            for axis in 0..3 {
                prop_assert_eq!(cross[axis].signum(), i64::from(normals[axis]).signum());
            }
        }
    }
}
