//! A tower: many storeys around one open shaft, to fall through.

use super::build::Wall;
use super::{SceneInfo, param};

pub(super) const TOWER: SceneInfo = SceneInfo {
    name: "tower",
    about: "many storeys around an open shaft; the walk steps into it at the top and falls to the ground",
    params: &[
        param("storeys", 50.0, 2.0, 1000.0, "number of storeys"),
        param("height", 3.0, 2.2, 20.0, "from floor to floor (m)"),
        param("size", 10.0, 4.0, 200.0, "edge of a storey (m)"),
        param("shaft", 3.0, 1.0, 100.0, "edge of the shaft in its middle [m, at most size - 2]"),
    ],
    build: |p, b| {
        let (storeys, height, half) = (p[0] as usize, p[1], p[2] / 2.0);
        let hole = p[3].min(p[2] - 2.0) / 2.0;
        let square = [-half, -half, half, half];
        b.slab(square, 0.0, 0.25, &[]);
        for storey in 1..storeys {
            let floor = storey as f64 * height;
            b.slab(square, floor, 0.25, &[[-hole, -hole, hole, hole]]);
            for [x, y] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
                let at = (half + hole) / 2.0;
                b.column("column", [x * at, y * at], 0.15, [floor - height, floor - 0.25]);
            }
            b.station([(half + hole) / 2.0, 0.0, floor - height + 1.6]);
        }
        let z = [0.0, storeys as f64 * height];
        let corners = [[-half, -half], [half, -half], [half, half], [-half, half]];
        for i in 0..4 {
            b.wall(Wall { from: corners[i], to: corners[(i + 1) % 4], thickness: 0.0, z }, &[]);
        }
        let start = [-(half + hole) / 2.0, 0.0, (storeys - 1) as f64 * height];
        b.walk(start, vec![[0.0, 0.0]], [0.0; 3]);
    },
};
