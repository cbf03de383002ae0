//! Streams pages around a pawn that walks straight ahead for ten seconds: `stream ARCHIVE.slices X,Y,Z HEADING_DEG`.

use nalgebra::{Point3, Vector2};
use slicewalk::archive::Archive;
use slicewalk::store::{Stream, StreamOptions};
use slicewalk::walk::{Config, MoveInput, Walker};
use std::time::Duration;

const FRAME_S: f64 = 1.0 / 60.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, start, heading] = &arguments[..] else {
        return Err("usage: stream ARCHIVE.slices X,Y,Z HEADING_DEG (0 is +y, clockwise)".into());
    };
    let start = start.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
    let [x, y, z] = start[..] else { return Err("the start is X,Y,Z".into()) };
    let heading = heading.parse::<f64>()?.to_radians();
    let ahead = Vector2::new(heading.sin(), heading.cos());

    let stream = Stream::open(Archive::open(path)?, StreamOptions::new(16 << 20))?;
    let mut body = stream.pawn();
    let mut pawn = Walker::new(Config::default(), Point3::new(x, y, z))?;
    stream.load_around(&pawn.motion_hint(stream.archive().frame()))?; // blocks, like a loading screen
    for frame in 0..600 {
        body.hint(&pawn.motion_hint(stream.archive().frame()));
        let report = pawn.step(&stream.snapshot(), FRAME_S, MoveInput::Direction(ahead));
        if let Some(missing) = report.missing {
            body.need(&missing); // the pawn waits in place until these pages are loaded
        }
        if frame % 60 == 0 {
            let at = pawn.feet();
            println!("{:5.2} s: {:.2}, {:.2}, {:.2} {:?}", frame as f64 * FRAME_S, at.x, at.y, at.z, pawn.state());
        }
        std::thread::sleep(Duration::from_secs_f64(FRAME_S));
    }
    for failed in stream.take_errors() {
        eprintln!("{}: {}", failed.key, failed.error);
    }
    Ok(())
}
