//! Looks into slice archives.
fn main() {}
