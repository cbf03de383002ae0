//! A church: nave and aisles, two arcades of round columns with arches, a barrel vault, and a step to the choir.

use super::build::{Builder, Wall};
use super::{SceneInfo, param};

pub(super) const CHURCH: SceneInfo = SceneInfo {
    name: "church",
    about: "nave with two arcades of columns and arches, a barrel vault, and a step to the choir",
    params: &[
        param("bays", 7.0, 2.0, 100.0, "arches on each side"),
        param("bay", 5.0, 2.0, 20.0, "length of a bay (m)"),
        param("nave", 9.0, 3.0, 40.0, "width of the nave (m)"),
        param("aisle", 4.0, 1.0, 20.0, "width of each aisle (m)"),
        param("column", 0.45, 0.1, 2.0, "radius of a column (m)"),
        param("step", 0.16, 0.01, 1.0, "height of the step to the choir (m)"),
    ],
    build: |p, b| build(b, p[0] as usize, p[1], p[2], p[3], p[4], p[5]),
};

/// Thickness of the wall over the arcades (m).
const ARCADE_M: f64 = 0.7;
/// Height of the columns (m).
const SPRINGING_M: f64 = 4.5;

fn build(b: &mut Builder, bays: usize, bay: f64, nave: f64, aisle: f64, radius: f64, step: f64) {
    let length = bays as f64 * bay;
    let choir = 2.0 * bay;
    let half = nave / 2.0;
    let outer = half + ARCADE_M + aisle;
    let crown = SPRINGING_M + bay / 2.0 + 0.8;
    b.level("floor", [0.0, -outer, length, outer], 0.0, &[]);
    b.level("floor", [length, -half, length + choir, half], step, &[]);
    b.quad("riser", [length, -half, 0.0], [0.0, nave, 0.0], [0.0, 0.0, step]);
    b.open_cuboid("altar", [length + 0.6 * choir, -1.2, step], [length + 0.6 * choir + 1.0, 1.2, step + 1.0]);
    for side in [-1.0, 1.0] {
        // The arcade: columns on its middle line, arches between them, flush walls above.
        let near = if side > 0.0 { half } else { -half - ARCADE_M };
        for i in 0..=bays {
            b.column("column", [i as f64 * bay, near + ARCADE_M / 2.0], radius, [0.0, SPRINGING_M]);
        }
        for i in 0..bays {
            let origin = [(i as f64 + 0.5) * bay, near, SPRINGING_M];
            let spandrel = crown - SPRINGING_M;
            b.arch(origin, [1.0, 0.0, 0.0], bay / 2.0, [0.0, ARCADE_M, 0.0], 24, spandrel);
        }
        b.level("ceiling", [0.0, aisle_min(side, half, outer), length, aisle_max(side, half, outer)], crown, &[]);
        b.wall(Wall { from: [0.0, side * outer], to: [length, side * outer], thickness: 0.0, z: [0.0, crown] }, &[]);
        let end = [length + choir, side * half];
        b.wall(Wall { from: [length, side * half], to: end, thickness: 0.0, z: [0.0, crown] }, &[]);
        let (from, to) = ([length, aisle_min(side, half, outer)], [length, aisle_max(side, half, outer)]);
        b.wall(Wall { from, to, thickness: 0.0, z: [0.0, crown] }, &[]);
    }
    b.arch([0.0, 0.0, crown], [0.0, 1.0, 0.0], half, [length + choir, 0.0, 0.0], 48, 0.0);
    let doors = [outer - 1.0, 0.0, outer + 1.0, 3.0];
    b.wall(Wall { from: [0.0, -outer], to: [0.0, outer], thickness: 0.0, z: [0.0, crown] }, &[doors]);
    let east = Wall { from: [length + choir, -half], to: [length + choir, half], thickness: 0.0, z: [step, crown] };
    b.wall(east, &[[half - 1.0, 3.0, half + 1.0, crown - 0.5]]);
    b.station([0.3 * length, 0.0, 1.7]);
    b.station([0.8 * length, half + ARCADE_M + aisle / 2.0, 1.7]);
    b.station([0.6 * length, -half - ARCADE_M - aisle / 2.0, 1.7]);
    b.station([length + 0.3 * choir, 0.3, step + 1.7]);
    let goal = [length + 0.3 * choir, 0.0];
    let aisle_y = half + ARCADE_M + aisle / 2.0;
    let way = vec![[1.5 * bay, 0.0], [1.5 * bay, aisle_y], [(bays as f64 - 0.5) * bay, aisle_y]];
    let way = way.into_iter().chain([[(bays as f64 - 0.5) * bay, 0.0], goal]).collect();
    b.walk([1.0, 0.0, 0.0], way, [goal[0], goal[1], step]);
}

fn aisle_min(side: f64, half: f64, outer: f64) -> f64 {
    if side > 0.0 { half } else { -outer }
}

fn aisle_max(side: f64, half: f64, outer: f64) -> f64 {
    if side > 0.0 { outer } else { -half }
}
