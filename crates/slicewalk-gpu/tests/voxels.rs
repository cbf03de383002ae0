//! The voxel pass on the device: the same archives as without.
#![cfg(feature = "convert")]

mod common;

use common::{data, device};
use scangen::{Params, SampleSpec, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_gpu::VoxelPass;
use slicewalk_input::Units;
use std::fs;
use std::path::Path;
use std::sync::Arc;

/// Converts `scan` with and without the device and compares the bytes; returns the records that the device took and
/// left.
fn compare(pass: &Arc<VoxelPass>, scan: &Path, change: impl Fn(&mut ConvertOptions)) -> [u64; 2] {
    let folder = tempfile::tempdir().unwrap();
    let made = |name: &str, with: bool| {
        let output = folder.path().join(name);
        let mut options = ConvertOptions::new(vec![scan.to_owned()], output.clone());
        options.reading.units = Units::Factor(1.0);
        options.resources.temp_dir = folder.path().to_owned();
        options.resources.accumulator = with.then(|| pass.clone() as Arc<_>);
        change(&mut options);
        convert(&options, &NoMonitor).unwrap();
        fs::read(output).unwrap()
    };
    let expected = made("processor.slices", false);
    let before = pass.records();
    assert!(made("device.slices", true) == expected, "{}: the archives differ", scan.display());
    assert_eq!(pass.failure(), None);
    let after = pass.records();
    [0, 1].map(|which| after[which] - before[which])
}

fn pixel(metres: f64) -> impl Fn(&mut ConvertOptions) {
    move |options| options.grid.pixel = PixelSize::Metres(metres)
}

#[test]
fn scans_become_the_same_archives() {
    let Some(device) = device() else { return };
    let pass = Arc::new(VoxelPass::new(&device).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("house.las");
    let house = scangen::Scene::named("house", &Params::new()).unwrap();
    let samples = house.samples(1, &SampleSpec::direct_count(300_000).with_noise(0.003)).unwrap();
    write_samples(&scan, samples, &WriteSpec::for_path(&scan)).unwrap();
    let [taken, left] = compare(&pass, &scan, pixel(0.05));
    assert!(taken > 300_000 && left == 0, "{taken} records taken, {left} left");
    // Thin slices, which are classified in bands, and voxels of few points dropped.
    let [taken, left] = compare(&pass, &scan, |options| {
        pixel(0.05)(options);
        options.grid.slice_m = Some(0.02);
        options.plan.min_points = 2;
    });
    assert!(taken > 300_000 && left == 0, "{taken} records taken, {left} left");
    // The second of two passes has records of dropped voxels, which the processor accumulates.
    let [taken, left] = compare(&pass, &scan, |options| {
        pixel(0.05)(options);
        options.plan.drop_floaters = 30;
        options.plan.tolerance_m = 0.01;
    });
    assert!(taken > 300_000 && left > 0, "{taken} records taken, {left} left");
    for (name, metres) in [
        ("indoor_two_storey_zup.laz", 0.05),
        ("pump_room.laz", 0.02),
        ("forest_plot_tls.laz", 0.1),
        ("delft_city_block_ahn3.laz", 0.1),
        ("corridor_three_stations.laz", 0.05),
    ] {
        let Some(scan) = data::file(name) else { continue };
        let [taken, left] = compare(&pass, &scan, pixel(metres));
        eprintln!("{name}: {taken} records on the device, {left} left to the processor");
        assert!(taken > 0);
    }
}

#[test]
fn after_a_loss_the_processor_goes_on() {
    let Some(device) = device() else { return };
    let pass = Arc::new(VoxelPass::new(&device).unwrap());
    device.wgpu().0.destroy();
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("stairs.las");
    let stairs = scangen::Scene::named("stairs", &Params::new()).unwrap();
    let samples = stairs.samples(1, &SampleSpec::direct_count(20_000)).unwrap();
    write_samples(&scan, samples, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], folder.path().join("stairs.slices"));
    options.resources.accumulator = Some(pass.clone());
    convert(&options, &NoMonitor).unwrap();
    let device_made = fs::read(&options.output).unwrap();
    options.resources.accumulator = None;
    options.overwrite = true;
    convert(&options, &NoMonitor).unwrap();
    assert!(device_made == fs::read(&options.output).unwrap());
    assert!(matches!(pass.failure(), Some(slicewalk_gpu::Error::Lost { .. })), "{:?}", pass.failure());
    assert_eq!(pass.records()[0], 0);
}
