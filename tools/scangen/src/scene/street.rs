//! A street: carriageway, kerbs, pavements with round posts and lamps, house fronts with doors and windows.

use super::build::{Builder, Wall};
use super::{SceneInfo, param};

pub(super) const STREET: SceneInfo = SceneInfo {
    name: "street",
    about: "a street along x with kerbs, round posts, lamps and house fronts",
    params: &[
        param("length", 80.0, 10.0, 1e4, "along x (m)"),
        param("road", 7.0, 2.0, 50.0, "width between the kerbs (m)"),
        param("pavement", 3.0, 1.0, 20.0, "width of each pavement (m)"),
        param("kerb", 0.12, 0.01, 0.5, "height of the kerb (m)"),
        param("posts", 2.5, 0.5, 100.0, "distance between posts (m)"),
        param("post", 0.08, 0.01, 1.0, "radius of a post (m)"),
        param("height", 9.0, 3.0, 100.0, "of the house fronts (m)"),
    ],
    build: |p, b| {
        let (length, half, kerb, gap, radius, height) = (p[0], p[1] / 2.0, p[3], p[4], p[5], p[6]);
        let front = half + p[2];
        b.level("road", [0.0, -half, length, half], 0.0, &[]);
        for side in [-1.0, 1.0] {
            let [inner, outer] = [side * half, side * front];
            b.level("pavement", [0.0, inner.min(outer), length, inner.max(outer)], kerb, &[]);
            b.quad("kerb", [0.0, inner, 0.0], [length, 0.0, 0.0], [0.0, 0.0, kerb]);
            let line = side * (half + 0.4);
            for i in 0..((length / gap) as usize) {
                b.column("post", [(i as f64 + 0.5) * gap, line], radius, [kerb, kerb + 0.9]);
            }
            for i in 0..((length / 25.0).ceil() as usize) {
                b.column("lamp", [25.0 * i as f64 + 3.0, side * (half + 0.7)], 0.07, [kerb, kerb + 6.0]);
            }
            houses(b, length, outer, [kerb, kerb + height]);
        }
        for i in 0..((length / 20.0).ceil() as usize) {
            let x = 20.0 * i as f64 + 10.0;
            if x < length {
                b.station([x, 0.4, 1.8]);
            }
        }
        let y = half + 1.0 + p[2] / 3.0;
        let end = [length - 2.0, -y];
        let way = vec![[length / 2.0, y], [length / 2.0 + gap, 0.0], [length / 2.0 + gap, -y], end];
        b.walk([2.0, y, kerb], way, [end[0], end[1], kerb]);
    },
};

/// House fronts of ten metres each: a recessed door, windows on every storey.
fn houses(b: &mut Builder, length: f64, y: f64, z: [f64; 2]) {
    let n = (length / 10.0) as usize;
    for i in 0..n {
        let from = i as f64 * 10.0;
        let to = if i + 1 == n { length } else { from + 10.0 };
        let mut openings = vec![[1.0, z[0], 2.1, z[0] + 2.2]];
        for floor in 0..((z[1] - z[0]) / 3.0) as usize {
            let sill = z[0] + 3.0 * floor as f64 + 0.9;
            openings.extend([4.0, 7.0].map(|u| [u, sill, u + 1.3, sill + 1.4]));
        }
        // Reveals face away from the road.
        let (start, end) = if y > 0.0 { ([from, y], [to, y]) } else { ([to, y], [from, y]) };
        b.wall(Wall { from: start, to: end, thickness: 0.25, z }, &openings);
    }
}
