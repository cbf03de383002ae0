//! A house: storeys, doors, columns, tables, ceilings and stairs that lead from the ground floor to the top.
//!
//! ```text
//!  y ▲ depth
//!    │ west room │ hall                 │lane 1│lane 0│
//!    │           ╎ door                 │  ↑   │  ↑   │   flights climb along y, even storeys in lane 0,
//!    │  start    │                      │      │      │   odd ones in lane 1, with a wall between them
//!    └───╎door╎──┴──────────────────────┴──────┴──────┴──▶ x  width
//! ```

use super::build::{Builder, Flight, Wall};
use super::{SceneInfo, param};

const LANE_M: f64 = 1.1;
const BETWEEN_LANES_M: f64 = 0.1;
const STAIR_FOOT_Y: f64 = 2.0;
const TREAD_M: f64 = 0.28;

pub(super) const HOUSE: SceneInfo = SceneInfo {
    name: "house",
    about: "storeys with rooms, doors, columns, tables, ceilings and stairs to the top",
    params: &[
        param("width", 14.0, 10.0, 100.0, "along x, inside (m)"),
        param("depth", 10.0, 9.0, 100.0, "along y, inside (m)"),
        param("storeys", 3.0, 1.0, 50.0, "number of storeys"),
        param("height", 3.0, 2.4, 4.0, "from floor to floor (m)"),
        param("door", 1.0, 0.6, 2.0, "clear width of a door (m)"),
        param("wall", 0.2, 0.05, 0.5, "thickness of walls and slabs (m)"),
    ],
    build: |p, b| build(b, [p[0], p[1]], p[2] as usize, p[3], p[4], p[5]),
};

fn build(b: &mut Builder, [w, d]: [f64; 2], storeys: usize, height: f64, door: f64, wall: f64) {
    let risers = (height / 0.175).round() as usize;
    let stair_end = STAIR_FOOT_Y + (risers - 1) as f64 * TREAD_M;
    let lanes = [w - LANE_M, w - 2.0 * LANE_M - BETWEEN_LANES_M];
    let lane_middle = |storey: usize| lanes[storey % 2] + LANE_M / 2.0;
    let partition = 5.0;
    for storey in 0..storeys {
        let floor = storey as f64 * height;
        let ceiling = floor + height - wall;
        // The hole for the flight from below.
        let holes: Vec<_> = (storey > 0)
            .then(|| [lanes[(storey - 1) % 2], STAIR_FOOT_Y, lanes[(storey - 1) % 2] + LANE_M, stair_end])
            .into_iter()
            .collect();
        b.slab([0.0, 0.0, w, d], floor, wall, &holes);
        shell(b, [w, d], wall, [floor, ceiling], storey == 0, door);
        let jamb = d / 2.0 - door / 2.0;
        let opening = [jamb, floor, jamb + door, floor + 2.1];
        let z = [floor, ceiling];
        b.wall(Wall { from: [partition, 0.0], to: [partition, d], thickness: wall, z }, &[opening]);
        furnish(b, [w, d], partition, z);
        if storeys > 1 {
            let x = lanes[0];
            let wall = Wall { from: [x, STAIR_FOOT_Y], to: [x, stair_end], thickness: BETWEEN_LANES_M, z };
            b.wall(wall, &[]);
        }
        if storey + 1 < storeys {
            b.flight(Flight {
                foot: [lane_middle(storey), STAIR_FOOT_Y, floor],
                heading_deg: 90.0,
                risers,
                riser: height / risers as f64,
                tread: TREAD_M,
                width: LANE_M,
            });
        }
        b.station([2.5, d / 2.0 - 1.5, floor + 1.6]);
        b.station([partition + 2.5, d / 2.0 + 0.3, floor + 1.6]);
        b.station([w - 2.0 * LANE_M - 0.8, 1.2, floor + 1.6]);
    }
    b.slab([0.0, 0.0, w, d], storeys as f64 * height, wall, &[]);
    walk(b, [w, d], storeys, height, partition, stair_end, lane_middle);
}

/// The route from the west room of the ground floor through the door and up every flight to the west room at the top.
fn walk(
    b: &mut Builder,
    [w, d]: [f64; 2],
    storeys: usize,
    height: f64,
    partition: f64,
    stair_end: f64,
    lane_middle: impl Fn(usize) -> f64,
) {
    let start = [1.5, 2.0, 0.0];
    let beside = w - 2.0 * LANE_M - BETWEEN_LANES_M - 0.7;
    let mut way = vec![[partition - 1.2, d / 2.0], [partition + 1.4, d / 2.0]];
    for storey in 0..storeys.saturating_sub(1) {
        way.push([beside, 1.1]);
        way.push([lane_middle(storey), 1.1]);
        way.push([lane_middle(storey), stair_end + 0.8]);
        way.push([beside, stair_end + 0.8]);
    }
    if storeys > 1 {
        way.push([partition + 1.4, d / 2.0]);
    }
    way.push([partition - 1.2, d / 2.0]);
    let end = [1.5, d - 2.0];
    way.push(end);
    b.walk(start, way, [end[0], end[1], (storeys - 1) as f64 * height]);
}

/// Outer walls with windows, and a front door on the ground floor.
fn shell(b: &mut Builder, [w, d]: [f64; 2], thick: f64, z: [f64; 2], ground: bool, door: f64) {
    let (sill, head) = (z[0] + 0.9, z[0] + 2.1);
    let windows = |len: f64, from: f64| -> Vec<[f64; 4]> {
        let n = ((len - from) / 3.0) as usize;
        (0..n).map(|i| from + 3.0 * i as f64).map(|u| [u + 0.9, sill, u + 2.1, head]).collect()
    };
    let mut front = windows(w, 4.6);
    front.push(if ground { [2.0, z[0], 2.0 + door, head] } else { [2.0, sill, 3.2, head] });
    b.wall(Wall { from: [0.0, -thick], to: [w, -thick], thickness: thick, z }, &front);
    b.wall(Wall { from: [0.0, d], to: [w, d], thickness: thick, z }, &windows(w, -0.6));
    b.wall(Wall { from: [0.0, -thick], to: [0.0, d + thick], thickness: thick, z }, &windows(d, 0.5));
    b.wall(Wall { from: [w + thick, -thick], to: [w + thick, d + thick], thickness: thick, z }, &[]);
}

/// Two columns and a round table in the hall, a square table in the west room.
fn furnish(b: &mut Builder, [_, d]: [f64; 2], partition: f64, z: [f64; 2]) {
    for y in [1.6, d - 1.6] {
        b.column("column", [partition + 3.0, y], 0.2, z);
    }
    let top = z[0] + 0.75;
    b.column("table", [partition + 2.0, d - 3.0], 0.05, [z[0], top - 0.04]);
    b.column("table", [partition + 2.0, d - 3.0], 0.5, [top - 0.04, top]);
    let [x0, y0, x1, y1] = [0.8, 4.0, 2.0, 5.2];
    b.cuboid("table", [x0, y0, top - 0.04], [x1, y1, top]);
    for [x, y] in [[x0, y0], [x1 - 0.06, y0], [x0, y1 - 0.06], [x1 - 0.06, y1 - 0.06]] {
        b.open_cuboid("table", [x, y, z[0]], [x + 0.06, y + 0.06, top - 0.04]);
    }
}
