//! The project's demonstration: the scan of a small house, with a route up its stairs.

use crate::sample::{Mode, Order, Sample, SampleSpec, ScannerSpec};
use crate::{Params, Result, Scene, WriteSpec, Written, write_samples};
use std::path::Path;

/// Rays cast for the demonstration.
const RAYS: u64 = 1_000_000;

impl Scene {
    /// The house of three storeys used by `demo`; [`Scene::walk`] leads from the ground floor to the top.
    ///
    /// # Panics
    /// Never: the scene and its defaults are known.
    pub fn demo() -> Self {
        Self::named("house", &Params::new()).expect("the house has defaults for everything")
    }
}

/// Sampling of the demonstration: nine stations, 3 mm noise, mixed pixels.
pub fn demo_spec() -> SampleSpec {
    let scanner = ScannerSpec { mixed_rate: 0.02, ..ScannerSpec::default() };
    SampleSpec { mode: Mode::Scanner(scanner), ..SampleSpec::scanner(RAYS).with_noise(0.003) }
}

/// Points of the demonstration: the scan, plus directly drawn points that fill its shadows (300 per m²), because holes
/// in the floor would end the walk.
pub fn demo_samples(scene: &Scene, seed: u64) -> Result<impl Iterator<Item = Sample> + '_> {
    let fill = SampleSpec { mode: Mode::Direct(Order::Grid), ..SampleSpec::direct_density(300.0).with_noise(0.003) };
    Ok(scene.samples(seed, &demo_spec())?.chain(scene.samples(seed, &fill)?))
}

/// Writes the demonstration's scan as LAS or LAZ, chosen by the extension of `path`.
pub fn write_demo(path: &Path, seed: u64) -> Result<Written> {
    let scene = Scene::demo();
    write_samples(path, demo_samples(&scene, seed)?, &WriteSpec { format: 1, ..WriteSpec::for_path(path) })
}
