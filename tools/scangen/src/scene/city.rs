//! A sparse city of great extent, which overflows maps that are held whole in memory.

use super::{SceneInfo, param};
use crate::sample::Stream;

pub(super) const EXTENT: SceneInfo = SceneInfo {
    name: "extent",
    about: "a sparse city of 896 x 427 x 789 m: blocks of houses, towers, one of them to the top",
    params: &[
        param("width", 896.0, 60.0, 1e5, "along x (m)"),
        param("depth", 427.0, 60.0, 1e5, "along y (m)"),
        param("height", 789.0, 10.0, 1e4, "of the greatest tower (m)"),
        param("block", 60.0, 20.0, 1e3, "distance between houses (m)"),
        param("layout", 1.0, 0.0, 1e9, "number that draws heights and sizes"),
    ],
    build: |p, b| {
        let [w, d, height, block] = [p[0], p[1], p[2], p[3]];
        b.level("ground", [0.0, 0.0, w, d], 0.0, &[]);
        let mut rng = Stream::new(p[4] as u64, 5);
        let (nx, ny) = ((w / block) as usize, (d / block) as usize);
        let tallest = (nx / 2, ny / 2);
        for i in 0..nx {
            for j in 0..ny {
                let share = 0.25 + 0.35 * rng.unit();
                let rise = rng.unit();
                let top = if (i, j) == tallest { height } else { 6.0 + 0.25 * height * rise * rise * rise * rise };
                let (x, y, half) = ((i as f64 + 0.5) * block, (j as f64 + 0.5) * block, share * block / 2.0);
                b.open_cuboid("house", [x - half, y - half, 0.0], [x + half, y + half, top]);
            }
        }
        for i in 0..nx.min(8) {
            b.station([(i * nx / nx.min(8)) as f64 * block + 1.0, (ny / 2) as f64 * block, 1.8]);
        }
        let end = [w - 0.05 * block, 0.05 * block];
        b.walk([0.05 * block, 0.05 * block, 0.0], vec![end], [end[0], end[1], 0.0]);
    },
};
