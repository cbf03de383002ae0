//! The engine of the viewer: streaming, queries, walking and page geometry, without files, threads or a clock.
//!
//! In: bytes of an archive, inputs of players, positions of cameras. Out: answers, states and geometry, as numbers that
//! pass between wasm and JavaScript unchanged. A Web Worker drives it (`tools/viewer/package/src/worker.ts`); compiled
//! natively, it gives the same answers bit for bit.
//!
//! Errors are texts `kind|message` with the kinds of the package's `SlicewalkError`.

mod batch;
mod colours;
mod crowd;
mod engine;
mod facts;
mod fault;
mod geometry;
mod map;
mod messages;
mod named;
mod outline;
mod paint;
mod pawn;
mod routes;
mod scene;
mod slide;

pub use engine::Engine;
pub use geometry::Geometry;
pub use messages::{ActionCode, ActionMessage};
pub use pawn::{Input, Pawn, Settings, TICK_S};
pub use scene::{BuiltPage, Scenes};
