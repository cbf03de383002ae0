//! Occupied space as an octree of OctoMap (`.bt`): cubes with the edge of a pixel, anchored like pixels at the origin.
//!
//! A cube is occupied if a span reaches into it, so the tree contains every scanned point and nothing higher or lower
//! than a pixel beyond a span. Where an archive stores seen space, cubes that lie in it are free unless a span reaches
//! into them. All other cubes are unknown.
//!
//! A tree of OctoMap has 2¹⁶ cubes along each axis, around the origin. An archive that reaches beyond is moved by whole
//! tiles; a comment in the header and the program's message say how far.

use super::cubes::each_span;
use crate::Failure;
use crate::ground::stored_seen;
use slicewalk::Parameter;
use slicewalk::archive::Archive;
use slicewalk::seen::{CELL_PIXELS, SeenSpace};
use slicewalk_base::output::Output;
use slicewalk_base::text::{counted, grouped, number};
use slicewalk_cube::{FreeCubes, OctomapTree};
use std::io::{BufWriter, IntoInnerError};
use std::path::Path;

/// Most memory for seen space (bytes).
const MOST_SEEN_BYTES: u64 = 4 << 30;

/// Writes the tree; returns a message about it. Memory: the tree, and the blocks of a tile column (64 KiB each).
pub fn bt(archive: &Archive, path: &Path, to: Output) -> Result<String, Failure> {
    let seen = stored_seen(archive, path, MOST_SEEN_BYTES, Parameter::Bounds)?;
    let free = FreeCubes::new(archive.frame(), CELL_PIXELS, seen.iter().flat_map(SeenSpace::runs), None);
    let mut tree = OctomapTree::new().with_free(free);
    each_span(archive, path, |pixel, cubes| tree.occupy(pixel, cubes))?;
    while tree.encode_next() {
        crate::go_on()?;
    }
    let size = archive.frame().pixel_m();
    let tree = tree.finish(size).ok_or_else(|| {
        let reason = format!("larger than the {} cubes of an OctoMap tree along an axis", OctomapTree::MOST_CUBES);
        Failure::Text(format!("{}: {reason}; extract a region first", path.display()))
    })?;
    let mut file = BufWriter::new(to);
    tree.write(&mut file)?;
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    let moved = match tree.moved {
        [0, 0, 0] => String::new(),
        by => format!(", moved by {} m", by.map(|cubes| number(cubes as f64 * size)).join(",")),
    };
    let seen = if tree.free > 0 { format!(", {} free", grouped(tree.free)) } else { String::new() };
    Ok(format!("{}{seen} of {} m{moved}", counted(tree.occupied, "occupied cube"), number(size)))
}
