//! Converts scans into slice archives.
fn main() {}
