//! `slicetool info`: what an archive says of itself.

use crate::Outcome;
use std::fmt::Write;
use std::path::Path;

/// Facts of the archive at `path`, as JSON or as text.
pub fn run(path: &Path, json: bool) -> Outcome {
    let archive = crate::open(path)?;
    let facts = slicewalk::info::info(&archive).map_err(|error| crate::broken(path, &error))?;
    if json {
        return Ok(format!("{facts:#}\n"));
    }
    let mut text = String::new();
    if let serde_json::Value::Object(facts) = facts {
        for (key, value) in facts {
            let value = match value {
                _ if key == "unit" => {
                    let units = archive.units().map_err(|error| crate::broken(path, &error))?;
                    format!("{}; the archive is in metres", slicewalk::info::units_in_words(&units))
                }
                serde_json::Value::String(text) => text,
                other => other.to_string(),
            };
            let key = if key == "crs" { "crs of the source" } else { &key };
            writeln!(text, "{key:17} {value}")?;
        }
    }
    Ok(text)
}
