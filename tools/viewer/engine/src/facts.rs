//! Head and metadata of an archive as JSON.

use slicewalk::archive::Header;
use slicewalk::unit::{LengthUnit, unit_name};
use std::fmt::Write;

/// The fields of the package's `ArchiveInfo` except the name.
pub(crate) fn info(header: &Header) -> String {
    let (frame, options) = (&header.plan.frame, &header.plan.options);
    let bounds =
        header.bounds.map_or("null".into(), |(min, max)| format!(r#"{{"min":{},"max":{}}}"#, triple(min), triple(max)));
    let slices = header.slices.map_or("null".into(), |(low, high)| format!(r#"{{"lowest":{low},"highest":{high}}}"#));
    format!(
        concat!(
            r#"{{"fileBytes":{},"formatVersion":"{}.{}","pixelSize":{},"sliceHeight":{},"origin":[0,0,0],"bounds":{},"#,
            r#""slices":{},"maxSlope":{},"tolerance":{},"pointsRead":{},"pointsKept":{},"#,
            r#""voxels":{{"occupied":{},"obstacle":{},"coloured":{}}},"pages":{},"levels":{}}}"#
        ),
        header.file_len,
        header.version.0,
        header.version.1,
        frame.pixel_m(),
        frame.slice_m(),
        bounds,
        slices,
        options.max_slope_deg,
        options.tolerance_m,
        header.points_read,
        header.points_kept,
        header.voxels.occupied,
        header.voxels.obstacle,
        header.colours.map_or(0, |colours| colours.voxels),
        header.pages.total(),
        header.levels.map_or(0, |levels| levels.count),
    )
}

fn triple([x, y, z]: [f64; 3]) -> String {
    format!("[{x},{y},{z}]")
}

/// The fields of the package's `ArchiveReference`.
pub(crate) fn reference(crs: &str, units: &[LengthUnit]) -> String {
    let factor = match units {
        [unit] => Some(unit.horizontal_m),
        _ => None,
    };
    let name = match units {
        [] => "unknown",
        [unit] => unit_name(unit.horizontal_m),
        _ => "mixed",
    };
    let factor = factor.map_or("null".into(), |factor| factor.to_string());
    format!(r#"{{"crs":{},"unit":{{"name":"{name}","factor":{factor}}}}}"#, quoted(crs))
}

/// Quotes a JSON string.
fn quoted(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + 2);
    out.push('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c < ' ' => {
                // Writing to a string never fails.
                let _ = write!(out, "\\u{:04x}", c as u32);
            }
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_others_are_quoted() {
        assert_eq!(quoted("GEOGCS[\"a\\b\"]\n\u{1}é"), r#""GEOGCS[\"a\\b\"]\u000a\u0001é""#);
        assert_eq!(reference("", &[LengthUnit::METRE]), r#"{"crs":"","unit":{"name":"m","factor":1}}"#);
        assert_eq!(reference("x", &[]), r#"{"crs":"x","unit":{"name":"unknown","factor":null}}"#);
        let two = [LengthUnit::METRE, LengthUnit::of(0.3048)];
        assert_eq!(reference("x", &two), r#"{"crs":"x","unit":{"name":"mixed","factor":null}}"#);
    }
}
