//! Loading pages around moving bodies: the loader as a state machine, prefetching, remote archives.

#[path = "../stream/clock.rs"]
mod clock;
#[path = "../loader/link.rs"]
mod link;
#[path = "../common/random.rs"]
mod random;
#[path = "../stream/tower.rs"]
mod tower;

mod loader;
mod prefetch;
