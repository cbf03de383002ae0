//! A hall with everything that makes it hard to find moving people: glass, a mirror, plants, clutter.

use super::build::{Builder, Wall};
use super::{SceneInfo, param};
use crate::sample::Stream;
use crate::shape::{Polygon, Shape};

pub(super) const HALL: SceneInfo = SceneInfo {
    name: "hall",
    about: "two rooms and a door, a glass partition, a mirror, plants and clutter",
    params: &[
        param("leaves", 600.0, 0.0, 1e5, "leaves of each plant"),
        param("clutter", 20.0, 0.0, 1e4, "boxes on the floor"),
    ],
    build: |p, b| hall(b, p[0] as usize, p[1] as usize),
};

/// Length, width and height (m); the wall between the rooms, and its door.
const SIZE: [f64; 3] = [14.0, 9.0, 3.0];
const PARTITION_X: f64 = 8.0;
const DOOR: [f64; 2] = [4.0, 5.0];

fn hall(b: &mut Builder, leaves: usize, clutter: usize) {
    let [l, w, h] = SIZE;
    b.level("floor", [0.0, 0.0, l, w], 0.0, &[]);
    b.level("ceiling", [0.0, 0.0, l, w], h, &[]);
    let z = [0.0, h];
    for (from, to) in [([0.0, 0.0], [l, 0.0]), ([l, 0.0], [l, w]), ([l, w], [0.0, w]), ([0.0, w], [0.0, 0.0])] {
        b.wall(Wall { from, to, thickness: 0.0, z }, &[]);
    }
    let wall = Wall { from: [PARTITION_X, 0.0], to: [PARTITION_X, w], thickness: 0.15, z };
    b.wall(wall, &[[DOOR[0], 0.0, DOOR[1], 2.1]]);
    // A meeting place behind glass, and a mirror on the wall of the small room.
    b.quad("glass", [4.5, w - 3.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 2.4]);
    b.quad("mirror", [l - 0.02, 2.0, 0.6], [0.0, 1.5, 0.0], [0.0, 0.0, 1.4]);
    let mut chance = Stream::new(17, 31);
    for [x, y] in [[1.0, 1.0], [12.5, 7.8]] {
        b.column("pot", [x, y], 0.2, [0.0, 0.4]);
        b.column("stem", [x, y], 0.02, [0.4, 1.0]);
        for _ in 0..leaves {
            let (out, up) = (chance.direction(), chance.direction());
            let middle = [x + 0.5 * out[0], y + 0.5 * out[1], 1.3 + 0.45 * out[2]];
            let across = [up[1], -up[0], 0.0].map(|v| 0.05 * v);
            let along = [0.05 * up[0], 0.05 * up[1], 0.06 * up[2]];
            b.shape("leaf", Shape::Polygon(Polygon::parallelogram(middle, along, across)));
        }
    }
    for _ in 0..clutter {
        let [x, y] = [0.3 + (l - 1.0) * chance.unit(), 0.3 + (w - 1.0) * chance.unit()];
        // The routes past the door and the stations stay clear.
        let in_way = (x - PARTITION_X).abs() < 1.5 && (DOOR[0] - 1.0..DOOR[1] + 1.0).contains(&y);
        let size = [0.1 + 0.5 * chance.unit(), 0.1 + 0.5 * chance.unit(), 0.1 + 0.9 * chance.unit()];
        if !in_way {
            b.open_cuboid("clutter", [x, y, 0.0], [x + size[0], y + size[1], size[2]]);
        }
    }
    for at in [[2.5, 2.2, 1.7], [6.3, 6.9, 1.7], [6.2, 2.3, 1.7], [10.5, 4.4, 1.7], [12.6, 2.0, 1.7]] {
        b.station(at);
    }
    let way = vec![[PARTITION_X - 1.2, 4.5], [PARTITION_X + 1.2, 4.5], [10.5, 3.0]];
    b.walk([2.5, 2.2, 0.0], way, [10.5, 3.0, 0.0]);
}
