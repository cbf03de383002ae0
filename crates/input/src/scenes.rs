//! Checks whether the files of one run can belong together.

use crate::Warning;
use std::path::Path;

/// Minimum gap that causes a warning (m): parts of one scene, and models placed in it, lie closer.
const FAR_M: f64 = 1000.0;
/// Minimum gap that causes a warning, in sizes of the largest file.
const FAR_SIZES: f64 = 10.0;

/// Bounds of the content of a file (m).
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The file.
    pub path: &'a Path,
    /// Least coordinates (m).
    pub min: [f64; 3],
    /// Greatest coordinates (m).
    pub max: [f64; 3],
}

impl Scene<'_> {
    fn diagonal(&self) -> f64 {
        (0..3).map(|axis| (self.max[axis] - self.min[axis]).powi(2)).sum::<f64>().sqrt()
    }
}

/// Returns a warning if the scenes fall into groups separated along an axis by a gap far wider than any scene: they
/// probably use different reference systems or units. Cost: n log n.
pub fn far_apart(scenes: &[Scene]) -> Option<Warning> {
    let size = scenes.iter().map(Scene::diagonal).fold(0.0, f64::max);
    let mut widest: Option<(f64, &Path, &Path)> = None;
    let mut order: Vec<&Scene> = scenes.iter().collect();
    for axis in 0..3 {
        order.sort_by(|a, b| a.min[axis].total_cmp(&b.min[axis]));
        let Some(mut last) = order.first() else { break };
        for scene in &order {
            let gap = scene.min[axis] - last.max[axis];
            if gap > widest.map_or(FAR_M.max(FAR_SIZES * size), |widest| widest.0) {
                widest = Some((gap, last.path, scene.path));
            }
            if scene.max[axis] > last.max[axis] {
                last = scene;
            }
        }
    }
    let (gap, a, b) = widest?;
    let text = format!(
        "{} and {} lie {:.0} km apart, and no file is larger than {:.1} km: they may come in different reference systems \
         or units; convert them apart, or bring them into one system first",
        a.display(),
        b.display(),
        gap / 1000.0,
        size / 1000.0
    );
    Some(text.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_gaps_far_wider_than_any_scene_are_told() {
        let names = ["a", "b", "c"].map(Path::new);
        let found = |places: [([f64; 3], f64); 3]| {
            let scene = |(path, (min, size)): (&'static Path, ([f64; 3], f64))| {
                let max = min.map(|v| v + size);
                Scene { path, min, max }
            };
            far_apart(&names.into_iter().zip(places).map(scene).collect::<Vec<_>>())
        };
        let (here, tile) = (([0.0; 3], 100.0), |x: f64, y: f64| ([x, y, 0.0], 100.0));
        assert_eq!(found([here, tile(500.0, 0.0), tile(900.0, 900.0)]), None);
        assert_eq!(found([here, tile(20_000.0, 0.0), ([0.0; 3], 9_000.0)]), None, "11 km beside a scene of 16 km");
        let told = found([tile(0.0, 500_000.0), tile(0.0, 300.0), here]).unwrap().to_string();
        assert!(told.starts_with("b and a lie 500 km apart, and no file is larger than 0.2 km"), "{told}");
        // A scene that covers another: the gap begins where the longer one ends.
        assert_eq!(found([([0.0; 3], 50_000.0), tile(1.0, 1.0), tile(51_000.0, 0.0)]), None);
        assert!(found([here, here, ([0.0, 0.0, -5_000.0], 1.0)]).is_some(), "heights count");
        assert_eq!(far_apart(&[]), None);
    }
}
