//! Scenes for a single question each: a plane, ramps, stairs, a corridor, columns, terrain, an endless floor.

use super::build::{Builder, Flight, Wall};
use super::{SceneInfo, param};
use crate::geometry::{scale, sin_cos_deg};
use crate::shape::{Polygon, Shape, Terrain, Wave};
use std::f64::consts::TAU;

pub(super) const PLANE: SceneInfo = SceneInfo {
    name: "plane",
    about: "one tilted square about the origin",
    params: &[
        param("slope", 0.0, 0.0, 90.0, "degrees from the horizontal"),
        param("heading", 0.0, -360.0, 360.0, "direction of ascent, degrees from x"),
        param("size", 20.0, 0.01, 1e5, "edge along the slope (m)"),
    ],
    build: |p, b| tilted(b, "plane", [0.0; 3], p[0], p[1], p[2]),
};

/// A square of edge `size` around `center`, rising by `slope_deg` towards `heading_deg`.
fn tilted(b: &mut Builder, label: &'static str, center: [f64; 3], slope_deg: f64, heading_deg: f64, size: f64) {
    let ((ss, sc), (hs, hc)) = (sin_cos_deg(slope_deg), sin_cos_deg(heading_deg));
    let up = scale([sc * hc, sc * hs, ss], size);
    let across = scale([-hs, hc, 0.0], size);
    let corner = [0, 1, 2].map(|a| center[a] - (up[a] + across[a]) / 2.0);
    b.shape(label, Shape::Polygon(Polygon::parallelogram(corner, up, across)));
}

pub(super) const RAMPS: SceneInfo = SceneInfo {
    name: "ramps",
    about: "a field of tilted squares: slopes along x, headings along y",
    params: &[
        param("slope_step", 5.0, 0.5, 90.0, "degrees between columns, from 0 to 90"),
        param("heading_step", 15.0, 1.0, 360.0, "degrees between rows, from 0 to heading_max"),
        param("heading_max", 90.0, 0.0, 360.0, "last heading [degrees]"),
        param("size", 2.0, 0.1, 100.0, "edge of a square (m)"),
    ],
    build: |p, b| {
        let gap = 2.0 * p[3];
        for i in 0..=(90.0 / p[0] + 1e-9) as usize {
            for j in 0..=(p[2] / p[1] + 1e-9) as usize {
                let center = [(i as f64 + 0.5) * gap, (j as f64 + 0.5) * gap, p[3]];
                tilted(b, "ramp", center, i as f64 * p[0], j as f64 * p[1], p[3]);
            }
        }
    },
};

pub(super) const STAIRS: SceneInfo = SceneInfo {
    name: "stairs",
    about: "a flight between two landings, climbing along x",
    params: &[
        param("riser", 0.17, 0.01, 0.4, "height of a step (m)"),
        param("tread", 0.28, 0.1, 1.0, "depth of a step (m)"),
        param("risers", 12.0, 1.0, 1000.0, "number of steps"),
        param("width", 2.0, 0.3, 100.0, "width (m)"),
        param("landing", 2.0, 0.3, 100.0, "length of the landings (m)"),
    ],
    build: |p, b| {
        let (riser, tread, risers, width, landing) = (p[0], p[1], p[2] as usize, p[3], p[4]);
        let (run, rise) = ((risers - 1) as f64 * tread, risers as f64 * riser);
        b.level("floor", [-landing, -width / 2.0, 0.0, width / 2.0], 0.0, &[]);
        b.flight(Flight { foot: [0.0; 3], heading_deg: 0.0, risers, riser, tread, width });
        b.level("floor", [run, -width / 2.0, run + landing, width / 2.0], rise, &[]);
        b.walk([-landing / 2.0, 0.0, 0.0], vec![[run + landing / 2.0, 0.0]], [run + landing / 2.0, 0.0, rise]);
    },
};

pub(super) const CORRIDOR: SceneInfo = SceneInfo {
    name: "corridor",
    about: "a corridor along x with a door, a low beam and a thin sheet of wall at its end",
    params: &[
        param("width", 2.0, 0.5, 100.0, "between the walls (m)"),
        param("door", 0.9, 0.1, 100.0, "clear width of the door (m)"),
        param("wall", 0.15, 0.0, 2.0, "thickness of the door's wall; 0 is a single sheet (m)"),
        param("beam", 1.9, 0.2, 10.0, "clear height under the beam (m)"),
        param("length", 12.0, 4.0, 1000.0, "length (m)"),
    ],
    build: |p, b| {
        let (half, door, thick, beam, length) = (p[0] / 2.0, p[1].min(p[0]), p[2], p[3], p[4]);
        let height = beam.max(2.5) + 0.5;
        b.level("floor", [0.0, -half, length, half], 0.0, &[]);
        for y in [-half, half] {
            b.wall(Wall { from: [0.0, y], to: [length, y], thickness: 0.0, z: [0.0, height] }, &[]);
        }
        let third = length / 3.0;
        let top = (height - 0.5).min(2.1);
        let jambs = [half - door / 2.0, 0.0, half + door / 2.0, top];
        b.wall(Wall { from: [third, -half], to: [third, half], thickness: thick, z: [0.0, height] }, &[jambs]);
        b.cuboid("beam", [2.0 * third, -half, beam], [2.0 * third + 0.3, half, beam + 0.3]);
        b.wall(Wall { from: [length, -half], to: [length, half], thickness: 0.0, z: [0.0, height] }, &[]);
        b.station([third / 2.0, 0.0, 1.7]);
        b.station([1.5 * third, 0.0, 1.7]);
        b.walk([1.0, 0.0, 0.0], vec![[length - 0.5, 0.0]], [length - 0.5, 0.0, 0.0]);
    },
};

pub(super) const COLUMNS: SceneInfo = SceneInfo {
    name: "columns",
    about: "a large floor with a dense field of round columns in its middle and nothing else",
    params: &[
        param("size", 200.0, 1.0, 1e4, "edge of the floor (m)"),
        param("field", 40.0, 1.0, 1e4, "edge of the field of columns (m)"),
        param("spacing", 2.0, 0.2, 100.0, "between columns (m)"),
        param("radius", 0.25, 0.01, 10.0, "of a column (m)"),
        param("height", 4.0, 0.1, 100.0, "of a column (m)"),
    ],
    build: |p, b| {
        let (half, spacing, radius, height) = (p[0] / 2.0, p[2], p[3], p[4]);
        b.level("floor", [-half, -half, half, half], 0.0, &[]);
        let n = (p[1].min(p[0]) / spacing) as i64;
        for i in 0..n {
            for j in 0..n {
                let at = |k: i64| (k as f64 - (n - 1) as f64 / 2.0) * spacing;
                b.column("column", [at(i), at(j)], radius, [0.0, height]);
            }
        }
        b.station([half / 2.0, half / 2.0, 1.7]);
        b.station([0.5 * spacing * (n % 2) as f64, 0.5 * spacing * (n % 2) as f64, 1.7]);
        b.walk([-half + 1.0, 0.0, 0.0], vec![[-half / 2.0, half / 2.0]], [-half / 2.0, half / 2.0, 0.0]);
    },
};

pub(super) const TERRAIN: SceneInfo = SceneInfo {
    name: "terrain",
    about: "rolling ground: a sum of four sines with a known slope everywhere",
    params: &[
        param("size", 200.0, 1.0, 1e5, "edge (m)"),
        param("height", 4.0, 0.0, 1e3, "amplitude of the longest wave (m)"),
        param("wave", 60.0, 0.5, 1e5, "length of the longest wave (m)"),
    ],
    build: |p, b| {
        let k = TAU / p[2];
        let wave = |share: f64, turns: f64, heading: f64, phase: f64| {
            let (s, c) = sin_cos_deg(heading);
            Wave { amplitude: p[1] * share, k: [k * turns * c, k * turns * s], phase }
        };
        let waves = vec![
            wave(1.0, 1.0, 20.0, 0.3),
            wave(0.5, 1.7, 115.0, 1.1),
            wave(0.15, 4.3, 70.0, 2.0),
            wave(0.04, 11.0, 160.0, 0.0),
        ];
        let half = [p[0] / 2.0; 2];
        b.shape("terrain", Shape::Terrain(Terrain { center: [0.0; 3], half, heading_deg: 0.0, waves }));
        b.station([0.0, 0.0, 2.0 * p[1] + 2.0]);
    },
};

pub(super) const UNIFORM: SceneInfo = SceneInfo {
    name: "uniform",
    about: "a square kilometre of floor with pillars, for files of any size (points are independent: already shuffled)",
    params: &[
        param("size", 1500.0, 1.0, 1e5, "edge (m)"),
        param("spacing", 100.0, 1.0, 1e5, "between pillars (m)"),
        param("height", 3.0, 0.1, 1e3, "of a pillar (m)"),
    ],
    build: |p, b| {
        let (size, spacing, height) = (p[0], p[1], p[2]);
        b.level("floor", [0.0, 0.0, size, size], 0.0, &[]);
        let n = (size / spacing).min(200.0) as i64;
        for i in 0..n {
            for j in 0..n {
                let [x, y] = [i, j].map(|k| (k as f64 + 0.5) * spacing);
                b.open_cuboid("pillar", [x - 0.4, y - 0.4, 0.0], [x + 0.4, y + 0.4, height]);
            }
        }
        b.station([size / 2.0 + 0.25 * spacing, size / 2.0 + 0.25 * spacing, 1.7]);
        b.walk([1.0, 1.0, 0.0], vec![[20.0f64.min(size - 1.0), 1.0]], [20.0f64.min(size - 1.0), 1.0, 0.0]);
    },
};
