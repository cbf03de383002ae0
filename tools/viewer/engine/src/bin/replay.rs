//! `replay ARCHIVE RECORDING.json`: repeats natively what a walker of the package recorded in a browser, and compares
//! the paths bit for bit.

use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::nalgebra::Point3;
use slicewalk::store::Snapshot;
use slicewalk_engine::{Pawn, Settings};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [archive, recording] = &arguments[..] else {
        eprintln!("usage: replay ARCHIVE RECORDING.json");
        std::process::exit(2);
    };
    match replay(archive, recording) {
        Ok(steps) => println!("{steps} steps: the same path natively, to the last bit"),
        Err(error) => {
            eprintln!("replay: {recording}: {error}");
            std::process::exit(1);
        }
    }
}

fn replay(archive: &str, recording: &str) -> Result<usize, Box<dyn std::error::Error>> {
    let recording: Value = serde_json::from_str(&std::fs::read_to_string(recording)?)?;
    if recording["version"] != 1 {
        return Err("a recording of another version (expected 1)".into());
    }
    let numbers = |value: &Value| -> Result<Vec<f64>, String> {
        let list = value.as_array().ok_or("a list of numbers is missing")?;
        list.iter().map(|value| value.as_f64().ok_or_else(|| format!("{value} is no number"))).collect()
    };
    let options = &recording["options"];
    let field = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let body = &options["body"];
    let [shape, x, y] = match body["shape"].as_str() {
        Some("cylinder") => [1.0, field(&body["radius"]), 0.0],
        _ => [0.0, field(&body["x"]), field(&body["y"])],
    };
    let rest = ["climb", "speed", "gravity", "jump", "crouchHeight", "maxDrop"].map(|name| field(&options[name]));
    let settings = [&[shape, x, y, field(&body["height"])][..], &rest].concat();
    let (at, steps, path) = (numbers(&options["at"])?, numbers(&recording["steps"])?, numbers(&recording["path"])?);
    let [x, y, z] = at[..] else { return Err("the start is three numbers".into()) };

    let store = Snapshot::resident(&Archive::open(archive)?, &NoMonitor)?;
    let mut pawn = Pawn::new(Settings::from_numbers(&settings)?, Point3::new(x, y, z))?;
    let found = pawn.replay(&store, &steps)?;
    if found.len() != path.len() {
        return Err(format!("a path of {} numbers (expected {})", path.len(), found.len()).into());
    }
    if let Some(at) = (0..path.len()).find(|&at| found[at].to_bits() != path[at].to_bits()) {
        let step = at / 3;
        return Err(format!(
            "step {step}: {:?} was recorded, natively it is {:?}",
            &path[3 * step..][..3],
            &found[3 * step..][..3]
        )
        .into());
    }
    Ok(path.len() / 3)
}
