//! Facts of an archive as JSON: the only place that names the keys.

use crate::archive::{Archive, Header, Shard};
use crate::colour::{ColourPlan, ColourSource};
use crate::plan::{Noise, Plan};
use crate::text::{counted, number, rounded};
use crate::unit::{LengthUnit, unit_name};
use crate::{Result, Similarity, SplatCounts, UpFound};
use serde_json::{Value, json};

/// Quantum to which input coordinates are rounded before they reach the grid (m); 0 means none. Integers with scale and
/// offset, floats and decimals become the nearest `f64`.
pub const INPUT_QUANTUM_M: f64 = 0.0;

/// Returns the facts of an archive under the keys of the command-line contract.
pub fn info(archive: &Archive) -> Result<Value> {
    let mut facts = header_info(archive.header(), &archive.crs()?, &archive.units()?);
    if let Some(noise) = archive.noise()? {
        facts["tolerance_auto"] = noise_info(&noise);
    }
    if let Some(seen) = archive.seen_table()? {
        set_seen(&mut facts, seen.cells(), seen.bytes());
    }
    if let Some(shard) = archive.shard()? {
        facts["shard"] = shard_info(&shard);
    }
    Ok(facts)
}

/// Like [`info`], but from a header, the text of the coordinate reference system, and the units of the inputs.
pub fn header_info(header: &Header, crs: &str, units: &[LengthUnit]) -> Value {
    let bounds = header.bounds.map(|(min, max)| json!({ "min": min, "max": max }));
    let facts = json!({
        "format_version": format!("{}.{}", header.version.0, header.version.1),
        "bounds": bounds,
        "empty": header.voxels.occupied == 0,
        "points_read": header.points_read,
        "points_kept": header.points_kept,
        "points_withheld": header.points_withheld,
        "points_excluded": header.points_excluded,
        "slices": slice_count(header),
        "lowest_slice": header.slices.map(|slices| slices.0),
        "tiles": {
            "occupied": header.tiles.occupied,
            "stored": header.tiles.stored,
            "unique": header.tiles.unique,
        },
        "pages": {
            "stored": header.pages.stored,
            "shared": header.pages.shared,
            "uniform": header.pages.uniform,
        },
        "voxels": {
            "occupied": header.voxels.occupied,
            "obstacle": header.voxels.obstacle,
            "inferred": header.voxels.inferred,
        },
        "bytes": {
            "file": header.file_len,
            "tiles": header.bytes.pages,
            "directory": header.bytes.head + header.bytes.directory,
            "levels": header.bytes.levels,
            "colours": header.bytes.colours,
        },
        "plan_hash": format!("{:032x}", header.plan_hash),
        "crs": (!crs.is_empty()).then_some(crs),
        "unit": unit_info(units),
    });
    let mut all = plan_info(&header.plan);
    if let Some(colours) = &header.colours {
        all["colour"] = json!({
            "source": colours.plan.scale.source.name(),
            "range": [colours.plan.scale.low, colours.plan.scale.high],
            "error": f64::from(colours.plan.error_milli) / 1000.0,
            "voxels": colours.voxels,
        });
    }
    if let (Value::Object(all), Value::Object(facts)) = (&mut all, facts) {
        all.extend(facts);
    }
    all
}

/// Describes how colours were made.
pub fn colour_words(plan: &ColourPlan) -> String {
    let source = match plan.scale.source {
        ColourSource::Rgb if plan.scale.high <= u16::from(u8::MAX) => "RGB (8-bit values)".to_owned(),
        ColourSource::Rgb => "RGB (16-bit values)".to_owned(),
        ColourSource::Intensity => format!("intensity ({} to {})", plan.scale.low, plan.scale.high),
        ColourSource::Class => "classes by a palette".to_owned(),
    };
    match plan.error_milli {
        0 => format!("{source}, exact to 8 bits,"),
        milli => format!("{source}, mean error up to {} ΔE,", f64::from(milli) / 1000.0),
    }
}

/// Returns grid and options.
pub fn plan_info(plan: &Plan) -> Value {
    let mut facts = json!({
        "pixel_size": plan.frame.pixel_m(),
        "slice_height": plan.frame.slice_m(),
        "height_quantum": plan.frame.quantum_m(),
        "origin": [0.0, 0.0, 0.0],
        "max_slope": plan.options.max_slope_deg,
        "tolerance": plan.options.tolerance_m,
        "classifier": plan.options.classifier.name(),
        "min_points": plan.options.min_points,
        "drop_isolated": plan.options.drop_floaters > 0,
        "up": plan.options.up.name(),
        "excluded_classes": plan.options.exclude_classes.iter().collect::<Vec<_>>(),
    });
    if plan.options.remove_moving {
        facts["remove_moving"] = true.into();
    }
    if plan.options.fill_holes > 0 {
        let pixels = plan.options.fill_holes;
        facts["fill_holes"] = json!({ "pixels": pixels, "metres": f64::from(pixels) * plan.frame.pixel_m() });
    }
    if plan.options.drop_floaters > 1 {
        facts["drop_floaters"] = plan.options.drop_floaters.into();
    }
    facts
}

/// Returns the noise from which an automatic tolerance was chosen.
pub fn noise_info(noise: &Noise) -> Value {
    json!({ "noise": noise.noise_m, "regions": noise.regions, "region_size": noise.region_m })
}

/// Adds the counts of splats.
pub fn splat_info(facts: &mut Value, splats: &SplatCounts) {
    facts["splats_read"] = splats.read.into();
    facts["splats_transparent"] = splats.transparent.into();
    facts["splats_faint"] = splats.faint.into();
    facts["splats_large"] = splats.large.into();
    facts["splats_unusable"] = splats.unusable.into();
}

/// Adds the direction that was found to point up, and the matrix that places the input, row by row.
pub fn placing_info(facts: &mut Value, up: Option<&UpFound>, placement: Option<&Similarity>) {
    if let Some(up) = up {
        facts["up_auto"] = up_info(up);
    }
    if let Some(placement) = placement {
        facts["placement"] = json!(placement.matrix());
    }
}

/// Returns the direction that was found to point up.
pub fn up_info(up: &UpFound) -> Value {
    let (axis, tilt_deg) = up.axis();
    json!({
        "direction": up.up,
        "axis": axis,
        "tilt_deg": tilt_deg,
        "sure": up.sure,
        "floor_m2": up.floor_m2,
        "next_m2": up.next_m2,
    })
}

/// Describes the direction that was found to point up.
pub fn up_in_words(up: &UpFound) -> String {
    let (axis, tilt_deg) = up.axis();
    let tilt = if tilt_deg > 0.0 { format!(", tilted by {}°", rounded(tilt_deg, 0.1)) } else { String::new() };
    let [sure, floor, next] =
        [(100.0 * up.sure, 1.0), (up.floor_m2, 0.1), (up.next_m2, 0.1)].map(|(v, to)| rounded(v, to));
    format!(
        "{axis} points up{tilt}; {sure} % sure (floor of {floor} m² in the sample, largest other surface {next} m²)"
    )
}

/// Describes the noise of a scan.
pub fn noise_in_words(noise: &Noise) -> String {
    match noise.regions {
        0 => "too little is flat to measure the noise of the scan".into(),
        regions => {
            let (noise, edge) = (rounded(1000.0 * noise.noise_m, 0.01), number(noise.region_m));
            format!("the noise of the scan is {noise} mm, on {} of {edge} m", counted(regions, "flat region"))
        }
    }
}

/// Returns the name of a reference system, whose text may be long: the first name in it, or its beginning. `None` if it
/// is empty.
pub fn crs_name(crs: &str) -> Option<String> {
    const MOST: usize = 60;
    let name = crs.split('"').nth(1).unwrap_or(crs);
    let short: String = name.chars().take(MOST).collect();
    let more = if name.chars().count() > MOST { "…" } else { "" };
    (!crs.is_empty()).then(|| short + more)
}

/// Returns name and factor (m) of the unit of the inputs: null if unknown, `mixed` if there are several.
pub fn unit_info(units: &[LengthUnit]) -> Value {
    let one = |factor: f64| json!({ "name": unit_name(factor), "factor": factor });
    let whole = |unit: &LengthUnit| {
        let mut facts = one(unit.horizontal_m);
        if unit.vertical_m != unit.horizontal_m {
            facts["vertical"] = one(unit.vertical_m);
        }
        facts
    };
    match units {
        [] => Value::Null,
        [unit] => whole(unit),
        _ => json!({ "name": "mixed", "factor": null, "units": units.iter().map(whole).collect::<Vec<_>>() }),
    }
}

/// Describes the units of the inputs.
pub fn units_in_words(units: &[LengthUnit]) -> String {
    let one = |factor: f64| match unit_name(factor) {
        "m" => "metres".to_owned(),
        "ft" => format!("feet ({factor} m)"),
        "us-ft" => format!("US survey feet ({factor} m)"),
        _ => format!("units of {factor} m"),
    };
    let whole = |unit: &LengthUnit| match unit.horizontal_m == unit.vertical_m {
        true => one(unit.horizontal_m),
        false => format!("{}, heights in {}", one(unit.horizontal_m), one(unit.vertical_m)),
    };
    match units {
        [] => "unknown".to_owned(),
        units => units.iter().map(whole).collect::<Vec<_>>().join("; "),
    }
}

/// Adds the facts of seen space to those of an archive: cells, and bytes of its section, which follows the pages.
pub fn set_seen(facts: &mut Value, cells: u64, bytes: u64) {
    facts["seen"] = json!({ "cells": cells, "bytes": bytes });
    let with_pages = facts["bytes"]["tiles"].as_u64().unwrap_or(0);
    facts["bytes"]["tiles"] = with_pages.saturating_sub(bytes).into();
}

/// Returns the facts of a part of a conversion.
pub fn shard_info(shard: &Shard) -> Value {
    json!({
        "index": shard.index,
        "count": shard.count,
        "first_column": format!("{:016x}", shard.first),
        "last_column": format!("{:016x}", shard.last),
        "plan_file": format!("{:032x}", shard.plan_file),
    })
}

/// Returns the number of slices from the lowest to the highest occupied one.
pub fn slice_count(header: &Header) -> i64 {
    header.slices.map_or(0, |(lowest, highest)| highest - lowest + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colour::ColourScale;

    #[test]
    fn colours_are_described_by_their_source_and_error() {
        for (source, error_milli, words) in [
            (ColourSource::Rgb, 0, ["RGB (16-bit", "exact"]),
            (ColourSource::Intensity, 1500, ["intensity (3 to 900)", "up to 1.5 "]),
            (ColourSource::Class, 2000, ["classes by a palette", "up to 2 "]),
        ] {
            let said = colour_words(&ColourPlan { scale: ColourScale { source, low: 3, high: 900 }, error_milli });
            assert!(words.iter().all(|word| said.contains(word)), "{said}");
        }
    }

    #[test]
    fn reference_systems_are_shown_by_their_name_or_beginning() {
        assert_eq!(crs_name(""), None);
        assert_eq!(crs_name(r#"PROJCS["UTM 33N",UNIT["metre",1]]"#).as_deref(), Some("UTM 33N"));
        assert_eq!(crs_name(&"é".repeat(60)), Some("é".repeat(60)));
        assert_eq!(crs_name(&"é".repeat(61)), Some("é".repeat(60) + "…"));
    }
}
