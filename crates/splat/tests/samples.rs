//! Public files of every format, with the counts that another program found in them.

use slicewalk_base::{NoMonitor, Result};
use slicewalk_splat::{Splat, SplatFormat, SplatOptions, SplatReader, SplatSummary};
use std::path::{Path, PathBuf};

fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("SLICEWALK_DATA").map(|data| Path::new(&data).join("formats/splat"));
    let there = folder.filter(|folder| folder.is_dir());
    if there.is_none() {
        println!("skipped: SLICEWALK_DATA names no folder with formats/splat");
    }
    there
}

fn read(path: &Path) -> Result<(SplatFormat, u64, Vec<Splat>, SplatSummary)> {
    let mut reader = SplatReader::open(path, &SplatOptions::default())?;
    let mut all = Vec::new();
    let summary = reader.for_each_batch(&NoMonitor, &mut |batch| {
        all.extend_from_slice(batch);
        Ok(())
    })?;
    Ok((reader.format(), reader.count(), all, summary))
}

#[test]
fn samples_hold_the_splats_that_another_program_found() {
    let Some(folder) = folder() else { return };
    let cases = [
        ("basic-spz.glb", SplatFormat::Gltf, 1),
        ("cesium-synthetic-draft.gltf", SplatFormat::Gltf, 5),
        ("engine-test.ply", SplatFormat::CompressedPly, 64),
        ("fourth_st.spz", SplatFormat::Spz, 131_199),
        ("guitar.compressed.ply", SplatFormat::CompressedPly, 90_854),
        ("massa.sog", SplatFormat::Sog, 58_649),
        ("minimal-raw.spz", SplatFormat::Spz, 4),
        ("minimal-v2.spz", SplatFormat::Spz, 4),
        ("minimal-v4.spz", SplatFormat::Spz, 4),
        ("minimal.ksplat", SplatFormat::Ksplat, 4),
        ("minimal.splat", SplatFormat::Splat, 4),
        ("minimal_ascii.ply", SplatFormat::Ply, 3),
        ("playbot-lod5", SplatFormat::SogFolder, 3000),
        ("playbot-lod5/meta.json", SplatFormat::SogFolder, 3000),
        ("train-1000.ply", SplatFormat::Ply, 1000),
    ];
    for (name, format, count) in cases {
        let (found, stated, splats, summary) = read(&folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!((found, stated, splats.len() as u64, summary.splats), (format, count, count, count), "{name}");
        for splat in &splats {
            let length: f32 = splat.rotation.iter().map(|v| v * v).sum();
            assert!((length - 1.0).abs() < 1e-5, "{name}: {splat:?}");
            assert!(
                splat.mean.iter().all(|v| v.abs() < 1e4) && splat.scale.iter().all(|v| *v < 1e4),
                "{name}: {splat:?}"
            );
        }
    }
}

/// Five writers put the same four splats into these; the one of version 4 negates z.
#[test]
fn minimal_files_hold_the_same_splats() {
    let Some(folder) = folder() else { return };
    let all = ["minimal.splat", "minimal.ksplat", "minimal-v2.spz", "minimal-raw.spz", "minimal-v4.spz"]
        .map(|name| read(&folder.join(name)).unwrap().2);
    for (number, other) in all.iter().enumerate() {
        for (a, b) in all[0].iter().zip(other) {
            let z = if number == 4 { -b.mean[2] } else { b.mean[2] };
            assert_eq!((a.mean, a.opacity), ([b.mean[0], b.mean[1], z], b.opacity), "{number}");
            assert!(a.scale.iter().zip(b.scale).all(|(a, b)| (a / b - 1.0).abs() < 0.033), "{number}: {a:?} {b:?}");
        }
    }
}

#[test]
fn splats_have_the_same_sizes_as_gltf_and_as_ply() {
    let Some(folder) = folder() else { return };
    for (ply, glb) in [("train-1000.ply", "../made/train-1000.glb"), ("../made/room.ply", "../made/room.glb")] {
        let sizes = |name: &str| read(&folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}")).2;
        let (ply, glb) = (sizes(ply), sizes(glb));
        assert_eq!(ply.len(), glb.len());
        for (a, b) in ply.iter().zip(&glb) {
            assert!((0..3).all(|axis| (a.scale[axis] / b.scale[axis] - 1.0).abs() < 1e-4), "{a:?} {b:?}");
        }
    }
}
