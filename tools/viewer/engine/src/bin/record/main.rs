//! `record FOLDER [QUESTIONS]`: writes a scene, seeded queries and inputs, and the engine's native answers.
//! `test/same.test.js` of the package runs the same queries on the wasm engine.
//!
//! Random numbers come from integers and exact operations, so any difference in bits comes from the engine.

mod random;
mod scene;

use random::Random;
use slicewalk_engine::{ActionCode, ActionMessage, Engine};
use std::path::Path;
use std::time::Instant;

/// Frames of the long walk (ten minutes).
const FRAMES: usize = 36_000;
/// Frames of the walk over a slow link.
const STREAMED: usize = 1800;
/// Moves of cylinders and spheres.
const SLIDES: usize = 10_000;
/// Walkers of a crowd, and the frames in which they gather.
const MEMBERS: usize = 30;
const GATHERING: usize = 600;
/// Runs of each measurement.
const RUNS: usize = 5;
/// Lowest and highest corner of the loaded pages where an overview level covers the rest.
const CORNER: [f64; 6] = [-3.0, -3.0, -1.0, 1.0, 1.0, 4.0];
const LOW: [f64; 3] = [-4.5, -4.5, -0.5];
const HIGH: [f64; 3] = [4.5, 4.5, 6.5];
/// Settings of a box and of a cylinder.
const SETTINGS: [[f64; 10]; 2] =
    [[0.0, 0.5, 0.5, 1.8, 0.35, 1.4, 9.81, 0.6, 1.1, f64::NAN], [1.0, 0.25, 0.0, 1.7, 0.3, 1.8, 9.81, 0.4, 0.9, 1.0]];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().ok_or("usage: record FOLDER [QUESTIONS]")?);
    let questions: usize = arguments.get(1).map_or(Ok(100_000), |count| count.parse())?;
    let write = |name: &str, numbers: &[f64]| {
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_bits().to_le_bytes()).collect();
        std::fs::write(folder.join(name), bytes)
    };
    let bytes = scene::hall(false)?;
    std::fs::write(folder.join("scene.slices"), &bytes)?;
    let with_levels = scene::hall(true)?;
    std::fs::write(folder.join("levels.slices"), &with_levels)?;
    write("settings.f64", SETTINGS.as_flattened())?;

    let mut engine = open(&bytes)?;
    let mut random = Random(17);
    let boxes = rows(questions, || shape(&mut random).to_vec());
    write("boxes.f64", &boxes)?;
    std::fs::write(folder.join("boxes.answers.u8"), engine.overlaps(&boxes)?)?;
    write("boxes.floors.f64", &engine.floor(&boxes)?)?;
    let sweeps = rows(questions, || [&shape(&mut random)[..], &place(&mut random, [-1.0; 3], [1.0; 3])].concat());
    write("sweeps.f64", &sweeps)?;
    write("sweeps.answers.f64", &engine.sweep(&sweeps)?)?;
    let rays = rows(questions, || {
        [&place(&mut random, LOW, HIGH)[..], &place(&mut random, [-1.0; 3], [1.0; 3]), &[20.0]].concat()
    });
    write("rays.f64", &rays)?;
    write("rays.answers.f64", &engine.cast(&rays)?)?;
    let spheres = rows(questions, || [&place(&mut random, LOW, HIGH)[..], &[random.in_range(0.0, 0.8)]].concat());
    write("spheres.f64", &spheres)?;
    std::fs::write(folder.join("spheres.answers.u8"), engine.spheres(&spheres)?)?;
    let cylinders = rows(questions, || {
        [&place(&mut random, LOW, HIGH)[..], &[random.in_range(0.0, 0.5), random.in_range(0.0, 2.0)]].concat()
    });
    write("cylinders.f64", &cylinders)?;
    std::fs::write(folder.join("cylinders.answers.u8"), engine.cylinders(&cylinders)?)?;

    let mut slides = Vec::new();
    let motions = sweeps.chunks(9).map(|sweep| &sweep[6..]);
    for (motion, (cylinder, sphere)) in motions.zip(cylinders.chunks(5).zip(spheres.chunks(4))).take(SLIDES) {
        slides.extend(engine.slide(cylinder, motion, 4)?);
        slides.extend(engine.slide(sphere, motion, 4)?);
    }
    write("slides.f64", &slides)?;
    let places = rows(MEMBERS, || place(&mut random, [-4.0, -4.0, 0.6], [-2.0, -2.0, 0.6]).to_vec());
    write("crowd.f64", &places)?;
    write("crowd.states.f64", &crowd(&mut engine, &places)?)?;
    write("rays.far.f64", &partly(&with_levels)?.far(&rays)?)?;

    let inputs = inputs(FRAMES);
    write("inputs.f64", inputs.as_flattened())?;
    let mut states = Vec::new();
    for settings in &SETTINGS {
        let pawn = engine.pawn(settings, &[-2.0, 2.0, 0.2])?;
        for input in &inputs {
            states.extend(play(&mut engine, pawn, input)?);
        }
    }
    write("inputs.states.f64", &states)?;
    std::fs::write(folder.join("times.json"), times(&mut engine, &boxes, &inputs)?)?;
    write("streamed.f64", &streamed(&bytes, &inputs[..STREAMED])?)?;
    Ok(())
}

/// Measures the native time of a box query and of a pawn's frame (minimum of several runs), for `tests/bench.js`.
fn times(engine: &mut Engine, boxes: &[f64], inputs: &[[f64; 6]]) -> Result<String, String> {
    let mut least = [f64::INFINITY; 2];
    for _ in 0..RUNS {
        let start = Instant::now();
        engine.overlaps(boxes)?;
        least[0] = least[0].min(start.elapsed().as_secs_f64() * 1e9 / (boxes.len() / 6) as f64);
        let pawn = engine.pawn(&SETTINGS[0], &[-2.0, 2.0, 0.2])?;
        let start = Instant::now();
        for input in &inputs[..STREAMED] {
            play(engine, pawn, input)?;
        }
        least[1] = least[1].min(start.elapsed().as_secs_f64() * 1e6 / STREAMED as f64);
        engine.forget(pawn);
    }
    Ok(format!(r#"{{"box_ns":{},"frame_us":{}}}"#, least[0], least[1]))
}

fn rows(count: usize, mut row: impl FnMut() -> Vec<f64>) -> Vec<f64> {
    (0..count).flat_map(|_| row()).collect()
}

fn place(random: &mut Random, low: [f64; 3], high: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| random.in_range(low[axis], high[axis]))
}

fn shape(random: &mut Random) -> [f64; 6] {
    let (low, size) = (place(random, LOW, HIGH), place(random, [0.0; 3], [0.8, 0.8, 2.0]));
    [low[0], low[1], low[2], low[0] + size[0], low[1] + size[1], low[2] + size[2]]
}

/// Inputs of a player who turns, runs, jumps, crouches, sometimes flies and is moved elsewhere. One row per frame:
/// seconds, wish x and y, pace, lift, flags; or x, y and z of a place, and -1 as flags.
fn inputs(count: usize) -> Vec<[f64; 6]> {
    let mut random = Random(5);
    let mut input = [0.0; 6];
    let frames = (0..count).map(|frame| {
        if frame % 600 == 0 {
            let storey = 3.0 * random.below(2) as f64;
            let (x, y) = (random.in_range(-4.0, 4.0), random.in_range(-4.0, 4.0));
            return [0.0, x, y, storey + 0.6, 0.0, -1.0];
        }
        if frame % 90 == 1 {
            let flags = [0, 0, 0, 1, 1, 2, 3, 4][random.below(8) as usize];
            let (x, y) = (random.in_range(-1.0, 1.0), random.in_range(-1.0, 1.0));
            let (pace, lift) = (random.in_range(0.5, 2.5), random.in_range(-0.6, 0.5));
            input = [0.0, x, y, pace, lift, f64::from(flags)];
        }
        // Frames of many lengths, but mostly one sixtieth of a second.
        let seconds = match random.below(16) {
            0 => random.in_range(0.0, 0.3),
            _ => 1.0 / 60.0,
        };
        // Occasionally moves to another place.
        match frame % 450 {
            400.. => [seconds, 0.0, -0.4, 1.5, 0.0, 8.0],
            _ => [seconds, input[1], input[2], input[3], input[4], input[5]],
        }
    });
    frames.collect()
}

/// Applies one of [`inputs`] and returns the state of the pawn.
fn play(engine: &mut Engine, pawn: u32, input: &[f64; 6]) -> Result<Vec<f64>, String> {
    match input {
        [_, place @ .., -1.0] => engine.place(pawn, &place[..3]),
        [seconds, input @ ..] => engine.step(pawn, *seconds, input),
    }
}

/// States of a crowd whose walkers go to one place.
fn crowd(engine: &mut Engine, places: &[f64]) -> Result<Vec<f64>, String> {
    let crowd = engine.crowd(&SETTINGS[1], places)?;
    let wishes = [2.0, -2.0, 1.0].repeat(places.len() / 3);
    let mut states = Vec::new();
    for _ in 0..GATHERING {
        states.extend(engine.step_crowd(crowd, 1.0 / 60.0, &wishes)?);
    }
    engine.forget(crowd);
    Ok(states)
}

/// Opens an engine with the whole archive in memory.
fn open(bytes: &[u8]) -> Result<Engine, String> {
    let mut engine = Engine::new(bytes.len() as f64, 1e9, 4);
    serve(&mut engine, bytes, 0.0)?;
    let all = engine.load(&[-100.0, -100.0, -100.0, 100.0, 100.0, 100.0])?;
    serve(&mut engine, bytes, 0.0)?;
    match engine.outcome(all)? {
        0.0 => Ok(engine),
        other => Err(format!("{other} pages were left out")),
    }
}

/// Opens an engine with a corner of the archive and all of its overview level in memory.
fn partly(bytes: &[u8]) -> Result<Engine, String> {
    let mut engine = Engine::new(bytes.len() as f64, 64e6, 4);
    serve(&mut engine, bytes, 0.0)?;
    let scene = engine.scene(0.1, 1e5, 0.01, true, false);
    engine.look(scene, &[0.0, 0.0, 1.0])?;
    serve(&mut engine, bytes, 0.0)?;
    engine.load(&CORNER)?;
    serve(&mut engine, bytes, 0.0)?;
    Ok(engine)
}

/// What the engine wants done.
fn actions(engine: &mut Engine, now: f64) -> Result<Vec<ActionMessage>, String> {
    let todo = engine.poll(now)?;
    Ok(todo.chunks(ActionMessage::LEN).filter_map(ActionMessage::from_numbers).collect())
}

fn is(what: &ActionMessage, action: ActionCode) -> bool {
    what.action == f64::from(action)
}

/// Delivers all requested bytes at once.
fn serve(engine: &mut Engine, bytes: &[u8], now: f64) -> Result<(), String> {
    loop {
        let mut fetches = actions(engine, now)?;
        fetches.retain(|action| is(action, ActionCode::Fetch));
        for fetch in &fetches {
            engine.given(fetch.fetch as u32, bytes[fetch.start as usize..fetch.end as usize].to_vec(), now);
        }
        while engine.decode(now) {}
        if fetches.is_empty() {
            return Ok(());
        }
    }
}

/// Bytes in flight and their time of arrival (ms).
struct Coming {
    at: f64,
    name: u32,
    range: std::ops::Range<usize>,
}

/// A walk over a link of 40 ms and 20 Mbit/s in virtual time; returns the requested ranges and the states, in order.
fn streamed(bytes: &[u8], inputs: &[[f64; 6]]) -> Result<Vec<f64>, String> {
    let mut engine = Engine::new(bytes.len() as f64, (64 << 20) as f64, 4);
    let (mut words, mut link, mut pawn) = (Vec::<f64>::new(), Vec::<Coming>::new(), None);
    let (mut free_at, mut now) = (0.0f64, 0.0);
    for input in inputs {
        let arrived: Vec<_> = link.extract_if(.., |coming| coming.at <= now).collect();
        for Coming { name, range, .. } in arrived {
            engine.given(name, bytes[range].to_vec(), now);
            while engine.decode(now) {}
        }
        if engine.is_open() {
            let pawn = match pawn {
                Some(pawn) => pawn,
                None => *pawn.insert(engine.pawn(&SETTINGS[0], &[-2.0, 2.0, 0.2])?),
            };
            words.extend(play(&mut engine, pawn, input)?);
        }
        for action in actions(&mut engine, now)? {
            let ActionMessage { fetch, start, end, .. } = action;
            if is(&action, ActionCode::Fetch) {
                words.extend([start, end]);
                free_at = free_at.max(now + 40.0) + (end - start) / 2500.0;
                link.push(Coming { at: free_at, name: fetch as u32, range: start as usize..end as usize });
            } else if is(&action, ActionCode::Cancel) {
                link.retain(|coming| f64::from(coming.name) != fetch);
            }
        }
        now += 1000.0 / 60.0;
    }
    Ok(words)
}
