//! What an archive says of itself, as JSON: the one place that names the keys.

use crate::Result;
use crate::archive::{Archive, Header};
use serde_json::{Value, json};

/// Facts of an archive under the keys of the command-line contract (`slicetool info --json`).
pub fn info(archive: &Archive) -> Result<Value> {
    Ok(header_info(archive.header(), &archive.crs()?))
}

/// As [`info`], from a header and the text of the coordinate reference system.
pub fn header_info(header: &Header, crs: &str) -> Value {
    let plan = &header.plan;
    let bounds = header.bounds.map(|(min, max)| json!({ "min": min, "max": max }));
    let classes = (0..=255u8).filter(|&class| plan.excludes(class)).collect::<Vec<_>>();
    json!({
        "format_version": format!("{}.{}", header.major, header.minor),
        "pixel_size": plan.frame.pixel_m(),
        "slice_height": plan.frame.slice_m(),
        "height_quantum": plan.frame.quantum_m(),
        "origin": [0.0, 0.0, 0.0],
        "bounds": bounds,
        "points_read": header.points_read,
        "points_kept": header.points_kept,
        "points_withheld": header.points_withheld,
        "points_excluded": header.points_excluded,
        "slices": header.slice_count(),
        "lowest_slice": header.slices.map(|slices| slices.0),
        "tiles": {
            "occupied": header.tiles_occupied,
            "stored": header.tiles_stored,
            "unique": header.tiles_unique,
        },
        "pages": header.pages,
        "voxels": { "occupied": header.voxels_occupied, "obstacle": header.voxels_obstacle },
        "bytes": {
            "file": header.file_bytes(),
            "tiles": header.page_bytes(),
            "directory": header.directory_bytes(),
        },
        "max_slope": plan.max_slope_deg,
        "tolerance": plan.tolerance_m,
        "classifier": plan.classifier.name(),
        "min_points": plan.min_points,
        "up": match plan.up { crate::plan::Up::Z => "z", crate::plan::Up::Y => "y" },
        "excluded_classes": classes,
        "plan_hash": format!("{:032x}", header.plan_hash),
        "crs": (!crs.is_empty()).then_some(crs),
    })
}
