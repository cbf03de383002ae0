//! The program `slicetool`, by its command line.

#[path = "../../../../tests/common/data.rs"]
mod data;
#[path = "../../../../tests/common/forge.rs"]
mod forge;
#[path = "../../../../tests/common/full.rs"]
mod full;
#[cfg(feature = "remote")]
#[path = "../../../../tests/common/store.rs"]
mod store;

mod blocked;
mod budgets;
mod changes;
mod cli;
mod collider;
mod colour;
mod cubes;
mod edits;
mod exports;
mod fields;
mod heightfields;
mod house;
#[cfg(unix)]
mod interrupts;
mod long;
mod outputs;
mod reach;
mod replace;
mod scene;
mod seen;
mod serve;
mod sparse;
#[cfg(feature = "remote")]
mod stores;
mod walk;
mod words;
