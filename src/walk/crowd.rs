//! Many pawns in one world.

/// Placeholder.
#[derive(Debug)]
pub struct Crowd;
/// Placeholder.
#[derive(Debug)]
pub struct CrowdReport;
