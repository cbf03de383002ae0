//! The program `sliceconv`, by its command line.

#[path = "../../../../tests/cloud/boxes.rs"]
mod boxes;
#[path = "../../../../tests/cloud/coloured.rs"]
mod coloured;
#[path = "../../../../tests/mesh/files.rs"]
mod files;
#[path = "../../../../tests/common/full.rs"]
mod full;
#[path = "../../../../tests/common/las.rs"]
mod las;
#[path = "../../../../tests/cloud/plain.rs"]
mod plain;
#[path = "../../../../tests/common/reading.rs"]
mod reading;
#[path = "../../../../tests/mesh/sat.rs"]
mod sat;
#[path = "../../../../tests/common/scans.rs"]
mod scans;
#[cfg(feature = "remote")]
#[path = "../../../../tests/common/store.rs"]
mod store;
#[path = "../../../../tests/mesh/truth.rs"]
mod truth;
#[path = "../../../../tests/cloud/write.rs"]
mod write;

use scans::data;

mod cli;
mod clouds;
mod colours;
mod cubes;
mod determinism;
mod faults;
mod floaters;
mod formats;
mod holes;
mod incomplete;
mod input;
mod laz_files;
mod memory;
mod mesh_colours;
mod meshes;
mod moving;
mod odd_files;
mod outputs;
mod placing;
mod resume;
mod seen;
mod shards;
mod splat_rooms;
mod splats;
#[cfg(feature = "remote")]
mod stores;
mod tables;
mod tolerance;
mod units;
#[cfg(feature = "remote")]
mod uploads;
