//! The program `slicetool`, by its command line.

#[path = "../../../../tests/common/data.rs"]
mod data;
#[allow(dead_code)]
#[path = "../../../../tests/common/forge.rs"]
mod forge;
#[allow(dead_code)]
#[path = "../../../../tests/common/full.rs"]
mod full;
#[allow(dead_code)]
#[path = "../../../../tests/common/store.rs"]
mod store;

mod budgets;
mod cli;
mod colour;
mod exports;
mod outputs;
mod reach;
mod serve;
mod stores;
mod walk;
mod words;
