//! Where one may stand: what surfaces in closed form say, and how far the claims of a method are from that.
//!
//! The one who stands is that of Recast: a cylinder that ignores what lies below its climb height.

use crate::Random;
use crate::peers::recast::{CLIMB, HEIGHT, RADIUS, SLOPE_DEG};
use crate::stability::table::{Errors, Share};
use nalgebra::{Point3, Vector3};
use scangen::{Scene, Truth};
use slicewalk::query::{Aabb, Cylinder, Overlap, overlaps, probe, top_under};
use slicewalk::store::Snapshot;

/// A claim within this of a floor is about that floor (m).
const SAME_M: f64 = CLIMB;
/// Edge of the patch under the middle of the feet whose highest solid is the floor (m): scans have holes.
const FOOT_M: f64 = 0.05;

/// Whether one may stand on a floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stand {
    /// One may.
    Yes,
    /// It is too steep, or something is in the way.
    No,
    /// Nothing is in the way, but a drop or a steep slope is within reach of the feet: some methods keep away from them,
    /// some do not.
    AtAnEdge,
}

/// The floors over one place (m).
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Where.
    pub x: f64,
    /// Where.
    pub y: f64,
    /// From the highest down; what lies less than a climb under another is no floor, but what that lies on.
    pub floors: Vec<(f64, Stand)>,
}

/// How far claims are from the truth.
#[derive(Debug, Clone, Default)]
pub struct Judged {
    /// Claimed heights less true ones, where one may stand and it is claimed (m).
    pub heights: Errors,
    /// Of the floors where one may stand, those that are not claimed.
    pub missing: Share,
    /// Of the claims, those where one may not stand.
    pub wrong: Share,
}

/// Seeded places all over a scene.
pub fn columns(scene: &Scene, count: usize, seed: u64) -> Vec<Column> {
    let mut random = Random(seed);
    let bounds = scene.bounds();
    let column = |_| {
        let [x, y] = [0, 1].map(|axis| random.between(bounds.min[axis], bounds.max[axis]));
        let mut floors = Vec::new();
        let mut from = bounds.max[2] + 1.0;
        while let Some((z, slope)) = scene.floor_under(x, y, from) {
            floors.push((z, stand(scene, [x, y, z], slope)));
            from = z - CLIMB;
        }
        Column { x, y, floors }
    };
    (0..count).map(column).collect()
}

fn stand(scene: &Scene, [x, y, z]: [f64; 3], slope: f64) -> Stand {
    // Boxes in the cylinder, of its whole height above what is climbed: together they leave out a twentieth of it.
    let blocked = (1..6).any(|n| {
        let (sin, cos) = (f64::from(n) * std::f64::consts::FRAC_PI_2 / 6.0).sin_cos();
        let (a, b) = (RADIUS * cos, RADIUS * sin);
        scene.distance_to_box([x - a, y - b, z + CLIMB], [x + a, y + b, z + HEIGHT]) == 0.0
    });
    if slope > SLOPE_DEG || blocked {
        return Stand::No;
    }
    let level = |n: i32| {
        let (sin, cos) = (f64::from(n) * std::f64::consts::FRAC_PI_4).sin_cos();
        let found = scene.floor_under(x + RADIUS * cos, y + RADIUS * sin, z + CLIMB);
        found.is_some_and(|(height, slope)| height >= z - CLIMB && slope <= SLOPE_DEG)
    };
    if (0..8).all(level) { Stand::Yes } else { Stand::AtAnEdge }
}

/// Compares the heights that a method claims over each place with the floors there.
pub fn judge(columns: &[Column], claims: impl Fn(f64, f64) -> Vec<f64>) -> Judged {
    let mut judged = Judged::default();
    for Column { x, y, floors } in columns {
        let claimed = claims(*x, *y);
        for (z, _) in floors.iter().filter(|floor| floor.1 == Stand::Yes) {
            let errors = claimed.iter().map(|claim| claim - z).filter(|error| error.abs() <= SAME_M);
            let nearest = errors.min_by(|a, b| a.abs().total_cmp(&b.abs()));
            judged.missing.add(nearest.is_none());
            judged.heights.0.extend(nearest);
        }
        for claim in claimed {
            let about = |floor: &&(f64, Stand)| (floor.0 - claim).abs() <= SAME_M;
            judged.wrong.add(!floors.iter().filter(about).any(|floor| floor.1 != Stand::No));
        }
    }
    judged
}

/// Heights that slicewalk lets one stand at over a place, between two heights (m): floor, and nothing in the way above.
pub fn standing(store: &Snapshot, x: f64, y: f64, [bottom, top]: [f64; 2]) -> Vec<f64> {
    let mut heights = Vec::new();
    let mut from = top;
    while let Some(z) = top_below(store, [x, y, from], bottom) {
        let body = Cylinder::new(Point3::new(x, y, z + CLIMB), RADIUS, HEIGHT - CLIMB);
        if is_floor(store, [x, y, z]) && body.is_ok_and(|body| overlaps(store, &body) == Overlap::Clear) {
            heights.push(z);
        }
        from = z - 2.0 * store.frame().quantum_m();
    }
    heights
}

fn foot([x, y, z]: [f64; 3]) -> Option<Aabb> {
    Aabb::standing(Point3::new(x, y, z), Vector3::new(FOOT_M, FOOT_M, 0.0)).ok()
}

fn top_below(store: &Snapshot, from: [f64; 3], bottom: f64) -> Option<f64> {
    top_under(store, &foot(from)?, from[2], from[2] - bottom).known().flatten()
}

/// Whether there is floor under the feet, no deeper than they climb: as for a walker, a kerb under them is no obstacle.
fn is_floor(store: &Snapshot, [x, y, z]: [f64; 3]) -> bool {
    let feet = Cylinder::new(Point3::new(x, y, z - CLIMB), RADIUS, CLIMB);
    let floor = feet.ok().and_then(|feet| probe(store, &feet).known()?.floor_z);
    floor.is_some_and(|floor| floor >= z - CLIMB)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::peers::recast::{Navmesh, of_scene};
    use crate::stability::Result;
    use crate::stability::lab::{Scan, Setting};
    use scangen::{Params, SampleSpec};
    use slicewalk::plan::Classifier;

    #[test]
    fn on_stairs_truth_recast_and_slicewalk_agree_about_where_one_may_stand() -> Result<()> {
        let scene = Scene::named("stairs", &Params::new())?;
        let columns = columns(&scene, 400, 3);
        let count = |stand| columns.iter().flat_map(|c| &c.floors).filter(|floor| floor.1 == stand).count();
        assert!(count(Stand::Yes) > 100 && count(Stand::No) + count(Stand::AtAnEdge) > 20, "{columns:?}");
        let navmesh = Navmesh::build(&of_scene(&scene, 0.1), 0.04)?;
        let scan = Scan::new(scene.points(7, &SampleSpec::direct_density(5000.0))?.collect())?;
        let store = scan.convert(Setting::new(0.04), Classifier::Plane)?.store;
        let bounds = scene.bounds();
        let ours = |x: f64, y: f64| standing(&store, x, y, [bounds.min[2] - 1.0, bounds.max[2] + 1.0]);
        // Recast keeps half a cell away from what is near, and its detail smooths stairs.
        for (who, judged, limits) in [
            ("recast", judge(&columns, |x, y| navmesh.heights(x, y)), [0.15, 0.02, 0.1]),
            ("slicewalk", judge(&columns, ours), [0.05, 0.02, 0.03]),
        ] {
            let seen = [judged.missing.value(), judged.wrong.value(), judged.heights.rmse()];
            assert!(seen.iter().zip(limits).all(|(seen, limit)| *seen < limit), "{who}: {seen:?}");
        }
        let nothing = judge(&columns, |_, _| vec![]);
        assert_eq!((nothing.missing.value(), nothing.wrong.value()), (1.0, 0.0));
        let all_wrong = judge(&columns, |_, _| vec![bounds.max[2] + 5.0]);
        assert_eq!((all_wrong.missing.value(), all_wrong.wrong.value()), (1.0, 1.0));
        Ok(())
    }
}
