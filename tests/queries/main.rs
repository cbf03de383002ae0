//! Queries against brute force: boxes, rays, sweeps, objects, on random scenes and real scans.

#[path = "../mesh/bodies.rs"]
mod bodies;
#[path = "../oracle/brute.rs"]
mod brute;
#[path = "../common/data.rs"]
mod data;
#[path = "../oracle/edges.rs"]
mod edges;
#[path = "../mesh/files.rs"]
mod files;
#[path = "../oracle/partial.rs"]
mod partial;
#[path = "../common/random.rs"]
mod random;
#[path = "../mesh/sat.rs"]
mod sat;
#[path = "../heights/scan.rs"]
mod scan;
#[path = "../oracle/scene.rs"]
mod scene;

mod clearance;
mod heights;
mod objects;
mod oracle;
mod raster;
mod real_scans;
mod surface;
mod sweep;
mod symmetry;
