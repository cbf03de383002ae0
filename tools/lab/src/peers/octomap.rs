//! OctoMap: an octree of occupied cubes, behind a few C++ functions that are built if its library is installed.

use super::native::Recipe;
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use slicewalk::query::Aabb;
use std::ffi::{c_int, c_void};
use std::sync::Arc;

/// Settings that its documentation advises, and the method for boxes.
pub const SETTINGS: &str = "updateNode as occupied, lazy; updateInnerOccupancy, toMaxLikelihood, prune; no free space; \
     boxes by a search down from the root, only into nodes that meet the box";
const SOURCE: &str = include_str!("../../octomap/octomap.cc");
/// Cubes to a side of its trees.
const SIDE: f64 = 65_536.0;

/// The functions of `octomap.cc`.
struct Functions {
    build: unsafe extern "C" fn(*const f64, usize, f64) -> *mut c_void,
    free: unsafe extern "C" fn(*mut c_void),
    hits: unsafe extern "C" fn(*const c_void, *const f64) -> c_int,
    memory_bytes: unsafe extern "C" fn(*const c_void) -> usize,
    leaves: unsafe extern "C" fn(*const c_void, *mut f64, usize) -> usize,
    binary_bytes: unsafe extern "C" fn(*const c_void) -> usize,
    /// The functions are its: it stays as long as they do.
    _library: libloading::Library,
}

/// The library, built and loaded.
#[derive(Clone)]
pub struct Octomap(Arc<Functions>);

impl Octomap {
    /// Builds and loads it; an error says in one line why it cannot.
    pub fn load() -> Result<Self> {
        let recipe = Recipe {
            name: "octomap.cc",
            source: SOURCE,
            beside: &[],
            probe: "#include <octomap/OcTree.h>\n",
            missing: "liboctomap-dev is not installed",
            options: &[],
            libraries: &["-loctomap".into(), "-loctomath".into()],
        };
        let library = recipe.load()?;
        // SAFETY: these are the types of the functions of our source.
        let functions = unsafe {
            Functions {
                build: *library.get(c"octree_build")?,
                free: *library.get(c"octree_free")?,
                hits: *library.get(c"octree_hits")?,
                memory_bytes: *library.get(c"octree_memory_bytes")?,
                leaves: *library.get(c"octree_leaves")?,
                binary_bytes: *library.get(c"octree_binary_bytes")?,
                _library: library,
            }
        };
        Ok(Self(Arc::new(functions)))
    }

    /// A tree of cubes of this edge (m) about points; an error where it would be too wide.
    pub fn tree(&self, points: &[Point3<f64>], cube_m: f64) -> Result<Tree> {
        let from = middle(points, cube_m)?;
        let places: Vec<[f64; 3]> = points.iter().map(|p| (p - from).into()).collect();
        // SAFETY: as many points as the count says, three numbers each.
        let handle = unsafe { (self.0.build)(places.as_ptr().cast(), places.len(), cube_m) };
        if handle.is_null() {
            return Err("OctoMap could not build the tree: memory ran out".into());
        }
        Ok(Tree { functions: self.0.clone(), handle, from })
    }
}

/// Why its trees cannot hold something of this size (m), if they cannot.
pub fn too_wide(size: Vector3<f64>, cube_m: f64) -> Option<String> {
    let cubes = size.max() / cube_m;
    (cubes > SIDE - 4.0).then(|| format!("{cubes:.0} cubes to a side; OctoMap's trees have {SIDE} at most"))
}

/// Whole cubes from the origin to the middle of the points: its trees lie around (0, 0, 0).
fn middle(points: &[Point3<f64>], cube_m: f64) -> Result<Vector3<f64>> {
    let first = *points.first().ok_or("no points")?;
    let (low, high) = points.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    if let Some(why) = too_wide(high - low, cube_m) {
        return Err(why.into());
    }
    Ok(nalgebra::center(&low, &high).coords.map(|value| (value / cube_m).round() * cube_m))
}

/// A tree.
pub struct Tree {
    functions: Arc<Functions>,
    handle: *mut c_void,
    from: Vector3<f64>,
}

impl Tree {
    /// Whether a closed box touches an occupied cube.
    pub fn hits(&self, shape: &Aabb) -> bool {
        let (min, max) = (shape.min() - self.from, shape.max() - self.from);
        let ends = [min.x, min.y, min.z, max.x, max.y, max.z];
        // SAFETY: the handle is that of a tree until it is dropped; six numbers are read.
        unsafe { (self.functions.hits)(self.handle, ends.as_ptr()) == 1 }
    }

    /// Memory, by its own count (bytes).
    pub fn memory_bytes(&self) -> u64 {
        // SAFETY: as above.
        unsafe { (self.functions.memory_bytes)(self.handle) as u64 }
    }

    /// Bytes of its binary tree, `.bt`, less a few lines of text.
    pub fn file_bytes(&self) -> u64 {
        // SAFETY: as above.
        unsafe { (self.functions.binary_bytes)(self.handle) as u64 }
    }

    /// Occupied leaves: cubes, and eight times as large where all eight are occupied, and so on; least and greatest corner.
    pub fn leaves(&self) -> Vec<[Point3<f64>; 2]> {
        // SAFETY: as above; without room nothing is written.
        let count = unsafe { (self.functions.leaves)(self.handle, std::ptr::null_mut(), 0) };
        let mut leaves = vec![[0.0; 4]; count];
        // SAFETY: as above; there is room for four numbers for each of `count` leaves, and the tree has not changed.
        unsafe { (self.functions.leaves)(self.handle, leaves.as_mut_ptr().cast(), count) };
        let corners = |[x, y, z, edge]: [f64; 4]| {
            let least = Point3::new(x, y, z) + self.from;
            [least, least + Vector3::repeat(edge)]
        };
        leaves.into_iter().map(corners).collect()
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        // SAFETY: no other owner has the handle.
        unsafe { (self.functions.free)(self.handle) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Random;
    use std::collections::HashSet;

    const CUBE: f64 = 0.25;

    #[test]
    fn its_answers_are_those_of_the_cubes_that_hold_a_point() -> Result<()> {
        let octomap = match Octomap::load() {
            Ok(octomap) => octomap,
            Err(error) => {
                eprintln!("skipped: {error}");
                return Ok(());
            }
        };
        let mut random = Random(5);
        let mut place = |low: f64, high: f64| Point3::from([0, 1, 2].map(|_| random.between(low, high)));
        // Far from the origin, and dense enough in a corner that cubes are pruned into larger ones.
        let mut points: Vec<_> = (0..3000).map(|_| place(1000.0, 1002.0)).collect();
        points.extend((0..300).map(|_| place(1000.0, 1020.0)));
        let cell = |p: &Point3<f64>| [0, 1, 2].map(|axis| (p[axis] / CUBE).floor() as i64);
        let cubes: HashSet<[i64; 3]> = points.iter().map(cell).collect();
        let tree = octomap.tree(&points, CUBE)?;
        let mut hits = 0;
        for _ in 0..500 {
            let shape = Aabb::standing(place(999.0, 1006.0), Vector3::new(0.5, 0.5, 1.8))?;
            let (low, high) = (cell(&shape.min()), cell(&shape.max()));
            let touches = cubes.iter().any(|cube| (0..3).all(|axis| (low[axis]..=high[axis]).contains(&cube[axis])));
            assert_eq!(tree.hits(&shape), touches, "{shape:?}");
            hits += usize::from(touches);
        }
        assert!((25..450).contains(&hits), "{hits}");
        let leaves = tree.leaves();
        assert!(leaves.len() < cubes.len(), "none was pruned");
        let volume: f64 = leaves.iter().map(|[min, max]| (max - min).product()).sum();
        assert!((volume / CUBE.powi(3) - cubes.len() as f64).abs() < 1e-6);
        let inside = |[min, _]: &[Point3<f64>; 2]| cubes.contains(&cell(&(min + Vector3::repeat(CUBE / 2.0))));
        assert!(leaves.iter().all(inside));
        let (memory, file) = (tree.memory_bytes(), tree.file_bytes());
        assert!(file > 100 && memory > file, "{memory} {file}");
        let wide = octomap.tree(&points, 20.0 / 70_000.0);
        assert!(wide.is_err_and(|error| error.to_string().contains("65536 at most")));
        Ok(())
    }
}
