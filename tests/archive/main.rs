//! Archives: encodings, samples, overview levels, parts.

#[path = "../common/mod.rs"]
mod common;

use common::random;

mod encodings;
mod levels;
mod merge;
mod parts;
mod replace;
mod samples;
mod strikes;
