//! Converts a scan with the voxel pass on the processor and on the device, compares the archives and prints the times.
//!
//! ```text
//! cargo run --release --features convert --example convert -- SCAN PIXEL_METRES [--software]
//! ```

use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_gpu::{Device, Options, VoxelPass};
use std::error::Error;
use std::sync::Arc;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let software = arguments.iter().position(|argument| argument == "--software").map(|at| arguments.remove(at));
    let [scan, pixel] = &arguments[..] else { return Err("SCAN and PIXEL_METRES are missing".into()) };
    let device = Device::open(&Options { software: software.is_some(), buffer_bytes: None })?;
    let pass = Arc::new(VoxelPass::new(&device)?);
    let folder = tempfile::tempdir()?;
    let run = |name: &str, with: bool| -> Result<_, Box<dyn Error>> {
        let output = folder.path().join(name);
        let mut options = ConvertOptions::new(vec![scan.into()], output.clone());
        options.grid.pixel = PixelSize::Metres(pixel.parse()?);
        options.resources.accumulator = with.then(|| pass.clone() as Arc<_>);
        let begin = Instant::now();
        convert(&options, &NoMonitor)?;
        let seconds = begin.elapsed().as_secs_f64();
        Ok((seconds, std::fs::read(output)?))
    };
    // The first run warms up the file's cache.
    run("warm.slices", false)?;
    let (processor, expected) = run("processor.slices", false)?;
    let (with_device, archive) = run("device.slices", true)?;
    if archive != expected {
        return Err("the archives differ".into());
    }
    let [taken, left] = pass.records();
    println!("{}: {taken} records on the device, {left} left to the processor", device.name());
    println!("processor {processor:.2} s, with the device {with_device:.2} s, equal archives");
    match pass.failure() {
        Some(failure) => Err(failure.into()),
        None => Ok(()),
    }
}
