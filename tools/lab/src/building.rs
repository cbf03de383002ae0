//! A furnished building of two storeys as a scanner sees it: floors, ceilings, both faces of walls with doors, tables,
//! stools, shelves, pillars.

use crate::Random;
use nalgebra::{Point3, Vector3};

/// Size of the building (m).
pub const SIZE: [f64; 3] = [30.0, 24.0, 6.4];
/// From floor to floor, and from floor to ceiling (m).
pub const STOREY: [f64; 2] = [3.2, 3.0];
const ROOM: f64 = 6.0;
const DOOR: f64 = 1.2;
/// Noise of the scanner, one standard deviation (m).
const NOISE: f64 = 0.002;

/// A rectangle `corner + u·a + v·b`, `0 ≤ u, v ≤ 1`.
struct Face {
    corner: Point3<f64>,
    a: Vector3<f64>,
    b: Vector3<f64>,
}

/// Calls `point` for the points of a scan with `spacing` between them (m).
pub fn scan(spacing: f64, seed: u64, mut point: impl FnMut(Point3<f64>)) {
    let mut random = Random(seed);
    for face in faces(&mut random) {
        let (m, n) = ((face.a.norm() / spacing).ceil() as usize, (face.b.norm() / spacing).ceil() as usize);
        let normal = face.a.cross(&face.b).normalize();
        for i in 0..m {
            for j in 0..n {
                let (u, v) = (
                    (i as f64 + random.between(0.0, 1.0)) / m as f64,
                    (j as f64 + random.between(0.0, 1.0)) / n as f64,
                );
                point(face.corner + face.a * u + face.b * v + normal * random.normal(NOISE));
            }
        }
    }
}

fn faces(random: &mut Random) -> Vec<Face> {
    let mut faces = Vec::new();
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    for storey in 0..2 {
        let ground = STOREY[0] * storey as f64 + 0.017;
        for height in [ground, ground + STOREY[1]] {
            faces.push(Face { corner: Point3::new(0.0, 0.0, height), a: x * SIZE[0], b: y * SIZE[1] });
        }
        let rooms = [(SIZE[0] / ROOM) as usize, (SIZE[1] / ROOM) as usize];
        // Walls along x, then along y: two faces 12 cm apart, with a door in every room's stretch.
        for (along, across, stretches, lines) in [(x, y, rooms[0], rooms[1]), (y, x, rooms[1], rooms[0])] {
            for line in 0..=lines {
                for stretch in 0..stretches {
                    let outer = line == 0 || line == lines;
                    for side in [-0.06, 0.06] {
                        let at = across * (line as f64 * ROOM + side) + along * (stretch as f64 * ROOM) + z * ground;
                        let up = z * STOREY[1];
                        if outer {
                            faces.push(Face { corner: at.into(), a: along * ROOM, b: up });
                        } else {
                            let jamb = (ROOM - DOOR) / 2.0;
                            faces.push(Face { corner: at.into(), a: along * jamb, b: up });
                            faces.push(Face { corner: (at + along * (jamb + DOOR)).into(), a: along * jamb, b: up });
                            let lintel = at + along * jamb + z * 2.1;
                            faces.push(Face { corner: lintel.into(), a: along * DOOR, b: z * (STOREY[1] - 2.1) });
                        }
                    }
                }
            }
        }
        for room in 0..rooms[0] * rooms[1] {
            let corner = Vector3::new((room % rooms[0]) as f64 * ROOM, (room / rooms[0]) as f64 * ROOM, ground);
            furnish(&mut faces, corner, random);
        }
    }
    faces
}

/// A table, two stools, a shelf and a pillar of eight sides.
fn furnish(faces: &mut Vec<Face>, room: Vector3<f64>, random: &mut Random) {
    let mut place =
        |margin: f64| Vector3::new(random.between(margin, ROOM - margin), random.between(margin, ROOM - margin), 0.0);
    block(faces, room + place(0.9) + Vector3::z() * 0.70, Vector3::new(1.4, 0.8, 0.05));
    for _ in 0..2 {
        block(faces, room + place(0.4), Vector3::new(0.4, 0.4, 0.45));
    }
    block(faces, room + Vector3::new(0.2, 0.1, 0.0), Vector3::new(1.2, 0.35, 2.0));
    let pillar = room + place(0.5);
    for side in 0..8 {
        let corner = |n: usize| {
            let angle = n as f64 * std::f64::consts::TAU / 8.0 + 0.2;
            pillar + Vector3::new(angle.cos(), angle.sin(), 0.0) * 0.15
        };
        let (from, to) = (corner(side), corner(side + 1));
        faces.push(Face { corner: from.into(), a: to - from, b: Vector3::z() * STOREY[1] });
    }
}

/// The six faces of a box with its lower corner at `corner`.
fn block(faces: &mut Vec<Face>, corner: Vector3<f64>, size: Vector3<f64>) {
    let edges = [Vector3::x() * size.x, Vector3::y() * size.y, Vector3::z() * size.z];
    for axis in 0..3 {
        let (a, b) = (edges[(axis + 1) % 3], edges[(axis + 2) % 3]);
        faces.push(Face { corner: corner.into(), a, b });
        faces.push(Face { corner: (corner + edges[axis]).into(), a, b });
    }
}
