//! Archives: encodings, samples, overview levels, parts.

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/random.rs"]
mod random;

mod encodings;
mod levels;
mod parts;
mod samples;
