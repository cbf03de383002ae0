//! OctoMap, where its library is installed.

use super::method::{Built, Method, Vec3};
use super::subject::Subject;
use crate::peers::octomap::{self, SETTINGS, Tree};
use crate::stability::Result;
use slicewalk::query::Aabb;
use std::sync::OnceLock;

/// Bytes of a cube at worst, with the nodes above that it shares with few.
const CUBE_BYTES: f64 = 200.0;

/// Cubes of a pixel's edge.
pub struct Octomap;

/// Built and loaded once, or why not.
fn library() -> &'static std::result::Result<octomap::Octomap, String> {
    static LIBRARY: OnceLock<std::result::Result<octomap::Octomap, String>> = OnceLock::new();
    LIBRARY.get_or_init(|| octomap::Octomap::load().map_err(|e| e.to_string()))
}

impl Method for Octomap {
    fn name(&self) -> &'static str {
        "octomap"
    }

    fn settings(&self) -> String {
        SETTINGS.into()
    }

    fn refuses(&self, subject: &Subject, pixel_m: f64) -> Option<String> {
        let [low, high] = subject.bounds;
        library().as_ref().err().cloned().or_else(|| octomap::too_wide(high - low, pixel_m))
    }

    fn estimate_bytes(&self, _: &Subject, _: f64, cubes: usize) -> f64 {
        CUBE_BYTES * cubes as f64
    }

    fn build(&self, subject: &Subject, pixel_m: f64) -> Result<Box<dyn Built>> {
        let library = library().as_ref().map_err(Clone::clone)?;
        Ok(Box::new(Cubes(library.tree(&subject.points, pixel_m)?)))
    }
}

struct Cubes(Tree);

impl Built for Cubes {
    fn hits(&self, shape: &Aabb) -> bool {
        self.0.hits(shape)
    }

    fn file_bytes(&self) -> Result<Option<u64>> {
        Ok(Some(self.0.file_bytes()))
    }

    fn outside_bytes(&self) -> usize {
        self.0.memory_bytes() as usize
    }

    fn claimed(&self, give: &mut dyn FnMut(Vec3, Vec3)) -> Result<()> {
        self.0.leaves().into_iter().for_each(|[min, max]| give(min.into(), max.into()));
        Ok(())
    }
}
