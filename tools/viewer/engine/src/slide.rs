//! A shape that moves until it meets solid and slides on along it, as character controllers do.

use crate::batch::Lacks;
use crate::fault::{self, invalid};
use crate::messages::{ContactMessage, SlideMessage};
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::query::{Aabb, Answer, Cylinder, Sphere, SweepHit, sweep};
use slicewalk::store::Snapshot;

/// Most contacts of one move, whatever is asked for.
const MOST_CONTACTS: usize = 16;
/// Moves shorter than this count as zero (m).
const NOTHING_M: f64 = 1e-9;
/// A direction goes into a surface if it does by more than this share of its length.
const LEVEL: f64 = 1e-12;

/// Outcome of a move.
#[derive(Debug, Default)]
struct Slide {
    moved: Vector3<f64>,
    /// Contacts in order, with the way until then (m).
    contacts: Vec<(f64, SweepHit)>,
    /// The move ended because pages are missing ahead.
    is_missing: bool,
}

/// Sweeps the shape, moved by the first vector, along the second one.
type Meet<'a> = &'a dyn Fn(Vector3<f64>, Vector3<f64>) -> slicewalk::Result<Answer<Option<SweepHit>>>;

/// Moves a shape by `motion`, with at most `contacts` contacts. Six numbers are a box (min, max), five a cylinder (feet,
/// radius, height), four a sphere (centre, radius). Returns the numbers of a [`SlideMessage`], and of a
/// [`ContactMessage`] for each contact.
pub(crate) fn slide(
    set: &Snapshot,
    shape: &[f64],
    motion: &[f64],
    contacts: u32,
    lacks: &mut Lacks,
) -> Result<Vec<f64>, String> {
    let &[x, y, z] = motion else { return Err(invalid("a motion is three numbers")) };
    if !motion.iter().all(|v| v.is_finite()) {
        return Err(invalid(format_args!("nothing can move by ({x}, {y}, {z})")));
    }
    let (motion, most) = (Vector3::new(x, y, z), (contacts as usize).clamp(1, MOST_CONTACTS));
    // The shape is made from its numbers at each place, as the caller will make it at the end.
    let slid = match *shape {
        [x0, y0, z0, x1, y1, z1] => {
            let (min, max) = (Point3::new(x0, y0, z0), Point3::new(x1, y1, z1));
            along(motion, most, &|moved, by| Ok(sweep(set, &Aabb::new(min + moved, max + moved)?, by)), lacks)
        }
        [x, y, z, radius, height] => {
            let feet = Point3::new(x, y, z);
            along(motion, most, &|moved, by| Ok(sweep(set, &Cylinder::new(feet + moved, radius, height)?, by)), lacks)
        }
        [x, y, z, radius] => {
            let center = Point3::new(x, y, z);
            along(motion, most, &|moved, by| Ok(sweep(set, &Sphere::new(center + moved, radius)?, by)), lacks)
        }
        _ => return Err(invalid(format_args!("{} numbers are no shape", shape.len()))),
    };
    let Slide { moved, contacts, is_missing } = slid.map_err(|error| fault::text(&error))?;
    let head = SlideMessage { x: moved.x, y: moved.y, z: moved.z, missing: f64::from(u8::from(is_missing)) };
    let mut numbers = head.numbers().to_vec();
    for (distance, hit) in contacts {
        let (normal, obstacle) = (hit.normal, f64::from(u8::from(hit.obstacle)));
        let contact = ContactMessage { distance, normal_x: normal.x, normal_y: normal.y, normal_z: normal.z, obstacle };
        numbers.extend(contact.numbers());
    }
    Ok(numbers)
}

fn along(motion: Vector3<f64>, most: usize, meet: Meet, lacks: &mut Lacks) -> slicewalk::Result<Slide> {
    let mut slide = Slide::default();
    // The rest of the motion: undeflected (`wish`), and along the surfaces that the shape touches here (`rest`).
    let (mut wish, mut rest) = (motion, motion);
    let (mut surfaces, mut way) = (Vec::new(), 0.0);
    loop {
        let hit = match lacks.known(meet(slide.moved, rest)?) {
            Some(Some(hit)) => hit,
            Some(None) => {
                slide.moved += rest;
                return Ok(slide);
            }
            None => {
                slide.is_missing = true;
                return Ok(slide);
            }
        };
        let gone = rest.norm() * hit.fraction;
        slide.moved += rest * hit.fraction;
        way += gone;
        slide.contacts.push((way, hit));
        if hit.begins_inside() || slide.contacts.len() == most {
            return Ok(slide);
        }
        if gone > NOTHING_M {
            // It has left the surfaces before; where one goes on, the next sweep meets it again.
            surfaces.clear();
            wish = rest;
        }
        wish *= 1.0 - hit.fraction;
        surfaces.push(hit.normal);
        rest = deflected(wish, &surfaces);
        // Turned back: it would bounce between two surfaces.
        if rest.norm() < NOTHING_M || rest.dot(&motion) <= 0.0 {
            return Ok(slide);
        }
    }
}

/// Returns the part of `wish` that goes into none of the surfaces with these normals: along one of them, or along the
/// crease between two; zero in a corner.
fn deflected(wish: Vector3<f64>, surfaces: &[Vector3<f64>]) -> Vector3<f64> {
    let is_free = |way: &Vector3<f64>| surfaces.iter().all(|normal| way.dot(normal) >= -LEVEL * wish.norm());
    let along_one = surfaces.iter().map(|normal| wish - normal * wish.dot(normal));
    let pairs = surfaces.iter().enumerate().flat_map(|(n, one)| surfaces[..n].iter().map(move |other| (one, other)));
    let along_two = pairs.filter_map(|(one, other)| one.cross(other).try_normalize(LEVEL));
    along_one.chain(along_two.map(|crease| crease * wish.dot(&crease))).find(is_free).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
    use slicewalk::page::{PageBuilder, Span};
    use slicewalk::query::{Overlap, overlaps};
    use std::collections::BTreeMap;

    const PIXEL_M: f64 = 0.1;

    /// Pixels with a bottom and a top (m), around the corner of four pages.
    fn scene(blocks: &[([i64; 2], f64, f64)]) -> Snapshot {
        let frame = Frame::new(PIXEL_M, 0.255).unwrap();
        let mut pages: BTreeMap<PageKey, PageBuilder> = BTreeMap::new();
        for &([i, j], bottom, top) in blocks {
            let (bottom, top) = (frame.quantum_ceil(bottom), frame.quantum_ceil(top));
            for layer in bottom.div_euclid(PAGE_QUANTA)..=(top - 1).div_euclid(PAGE_QUANTA) {
                let base = layer * PAGE_QUANTA;
                let (low, high) = ((bottom - base).max(0), (top - base).min(PAGE_QUANTA));
                let span = Span::new(low as u32, high as u32, true).unwrap();
                let key = PageKey { tx: (i >> 6) as i32, ty: (j >> 6) as i32, layer: layer as i32 };
                assert!(pages.entry(key).or_default().set_column((i & 63) as u32, (j & 63) as u32, &[span]));
            }
        }
        Snapshot::from_pages(frame, pages.into_iter().map(|(key, page)| (key, page.build())))
    }

    fn moved(set: &Snapshot, shape: &[f64], motion: [f64; 3]) -> (SlideMessage, Vec<ContactMessage>) {
        let numbers = slide(set, shape, &motion, 4, &mut Lacks::default()).unwrap();
        let (head, contacts) = numbers.split_at(SlideMessage::LEN);
        let contacts =
            contacts.chunks(ContactMessage::LEN).map(|numbers| ContactMessage::from_numbers(numbers).unwrap());
        (SlideMessage::from_numbers(head).unwrap(), contacts.collect())
    }

    fn near(found: &SlideMessage, expected: [f64; 3]) {
        let found = [found.x, found.y, found.z];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}, not {expected:?}");
    }

    /// The shape, a little smaller: what it touches only is not within it.
    fn is_inside(set: &Snapshot, shape: &[f64]) -> bool {
        const LESS: f64 = 1e-6;
        let overlap = match *shape {
            [x0, y0, z0, x1, y1, z1] => {
                let less = Vector3::repeat(LESS);
                overlaps(set, &Aabb::new(Point3::new(x0, y0, z0) + less, Point3::new(x1, y1, z1) - less).unwrap())
            }
            [x, y, z, radius, height] => {
                let feet = Point3::new(x, y, z + LESS);
                overlaps(set, &Cylinder::new(feet, radius - LESS, height - 2.0 * LESS).unwrap())
            }
            [x, y, z, radius] => overlaps(set, &Sphere::new(Point3::new(x, y, z), radius - LESS).unwrap()),
            _ => unreachable!(),
        };
        overlap == Overlap::Hit
    }

    fn shifted(shape: &[f64], by: [f64; 3]) -> Vec<f64> {
        let places = if shape.len() == 6 { 6 } else { 3 };
        shape.iter().enumerate().map(|(n, v)| if n < places { v + by[n % 3] } else { *v }).collect()
    }

    /// A floor up to z = 0, walls from x = 2 and from y = 2.
    fn room() -> Snapshot {
        let pixels = (-20..30).flat_map(|i| (-20..30).map(move |j| [i, j]));
        let blocks = pixels.map(|[i, j]| ([i, j], -0.2, if i >= 20 || j >= 20 { 3.0 } else { 0.0 }));
        scene(&blocks.collect::<Vec<_>>())
    }

    #[test]
    fn walls_deflect_and_corners_stop() {
        let set = room();
        let shape = [0.0, 0.0, 0.0, 0.5, 0.5, 1.8];
        let (found, contacts) = moved(&set, &shape, [0.7, 0.3, 1.0]);
        near(&found, [0.7, 0.3, 1.0]);
        assert!(contacts.is_empty() && found.missing == 0.0);
        // Along the floor, the wall, and up the crease of both walls.
        let (found, contacts) = moved(&set, &shape, [3.0, 1.0, -0.5]);
        near(&found, [1.5, 1.0, 0.0]);
        let normals: Vec<_> = contacts.iter().map(|hit| [hit.normal_x, hit.normal_y, hit.normal_z]).collect();
        assert_eq!(normals, [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]);
        assert!(contacts[0].distance == 0.0 && (contacts[1].distance - 1.5f64.hypot(0.5)).abs() < 1e-9);
        assert_eq!(contacts[1].obstacle, 1.0);
        let (found, _) = moved(&set, &shape, [3.0, 3.0, 0.5]);
        near(&found, [1.5, 1.5, 0.5]);
        let (found, contacts) = moved(&set, &shifted(&shape, [1.5, 1.5, 0.0]), [1.0, 1.0, -1.0]);
        near(&found, [0.0; 3]);
        assert_eq!(contacts.len(), 3);
        // From a surface everything goes.
        near(&moved(&set, &shifted(&shape, [1.5, 0.0, 0.0]), [-1.0, 0.0, 0.2]).0, [-1.0, 0.0, 0.2]);
        // Inside of solid nothing does.
        let (found, contacts) = moved(&set, &shifted(&shape, [1.8, 0.0, 0.0]), [-1.0, 0.0, 0.0]);
        near(&found, [0.0; 3]);
        assert_eq!((contacts.len(), contacts[0].normal_x), (1, 0.0));
    }

    #[test]
    fn round_shapes_slide_round_a_pillar() {
        let set = scene(&[([10, 10], -1.0, 3.0)]);
        for shape in [&[0.0, 1.2, 0.0, 0.3, 1.8][..], &[0.0, 1.2, 0.9, 0.3]] {
            let (found, contacts) = moved(&set, shape, [2.0, 0.0, 0.0]);
            assert!(found.x > 0.8 && found.y > 0.05 && found.z == 0.0, "{found:?}");
            assert!(contacts[0].normal_x < -0.1 && contacts[0].normal_y > 0.1 && contacts[0].normal_z == 0.0);
        }
    }

    #[test]
    fn a_crease_between_slanted_surfaces_is_followed() {
        let surface = |x: f64, y: f64, z: f64| Vector3::new(x, y, z).normalize();
        let surfaces = [surface(-1.0, 1.0, 0.0), surface(-1.0, -1.0, 0.0)];
        let along = deflected(Vector3::new(1.0, 0.0, -0.25), &surfaces);
        assert!((along - Vector3::new(0.0, 0.0, -0.25)).norm() < 1e-12, "{along}");
        let all = [surfaces[0], surfaces[1], surface(0.0, 0.0, 1.0)];
        assert_eq!(deflected(Vector3::new(1.0, 0.0, -0.25), &all), Vector3::zeros());
    }

    #[test]
    fn what_is_no_shape_or_motion_is_refused() {
        let set = room();
        let refused = |shape: &[f64], motion: &[f64]| slide(&set, shape, motion, 4, &mut Lacks::default()).unwrap_err();
        let shape = [0.0, 0.0, 0.0, 0.5, 0.5, 1.8];
        for text in [
            refused(&shape[..3], &[0.0; 3]),
            refused(&shape, &[0.0; 2]),
            refused(&shape, &[0.0, f64::NAN, 0.0]),
            refused(&shape, &[0.0, f64::INFINITY, 0.0]),
            refused(&[0.0, 0.0, 0.0, -0.5, 0.5, 1.8], &[0.0; 3]),
            refused(&[0.0, 0.0, 0.0, -0.5], &[0.0; 3]),
            refused(&[f64::NAN, 0.0, 0.0, 0.5, 1.0], &[0.0; 3]),
        ] {
            assert!(text.starts_with("invalid|"), "{text}");
        }
        // However many contacts are asked for.
        assert!(slide(&set, &shape, &[5.0, 5.0, -5.0], u32::MAX, &mut Lacks::default()).is_ok());
    }

    fn shape() -> impl Strategy<Value = Vec<f64>> {
        let place = prop::array::uniform3(-20i32..20).prop_map(|place| place.map(|v| f64::from(v) * 0.1));
        let size = prop::sample::select(vec![0.05, 0.1, 0.23, 0.5]);
        (place, size.clone(), size, 0..3).prop_map(|([x, y, z], a, b, kind)| match kind {
            0 => vec![x, y, z, x + a, y + b, z + a + b],
            1 => vec![x, y, z, a, b],
            _ => vec![x, y, z, a],
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(600))]
        #[test]
        fn nothing_ends_in_solid_or_gains_way(
            blocks in prop::collection::btree_map(
                prop::array::uniform2(-20i64..20), (prop::sample::select(vec![-2.0, -0.5, 0.0, 0.7]), 0.02..1.5f64), 1..400,
            ),
            shape in shape(),
            motions in prop::collection::vec(prop::array::uniform3(prop_oneof![Just(0.0), -0.1..0.1f64, -2.0..2.0f64]), 1..12),
        ) {
            let blocks: Vec<_> = blocks.into_iter().map(|(pixel, (bottom, more))| (pixel, bottom, bottom + more)).collect();
            let set = scene(&blocks);
            let mut shape = shape;
            let mut is_free = !is_inside(&set, &shape);
            for motion in motions {
                let (found, contacts) = moved(&set, &shape, motion);
                let by = [found.x, found.y, found.z];
                let (length, most) = (Vector3::from(by).norm(), Vector3::from(motion).norm());
                prop_assert!(length <= most * (1.0 + 1e-12), "{length} of {most}");
                prop_assert!(contacts.len() <= 4 && found.missing == 0.0);
                if contacts.is_empty() {
                    prop_assert_eq!(by, motion);
                }
                for contact in &contacts {
                    prop_assert!(contact.distance <= most * (1.0 + 1e-12));
                }
                shape = shifted(&shape, by);
                prop_assert!(!is_free || !is_inside(&set, &shape), "{:?} by {:?} to {:?}, {:?}", motion, by, shape, contacts);
                is_free = !is_inside(&set, &shape);
            }
        }
    }
}
