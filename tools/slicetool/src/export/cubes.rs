//! Cubes with the edge of a pixel, anchored like pixels at the origin, for formats of solid and empty cubes.

use crate::Failure;
use slicewalk::archive::{Archive, PageReader};
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use slicewalk_cube::SpanCubes;
use std::path::Path;

/// Calls `give` with each span of an archive at `path`, in the archive's order: pixel, the first cube that the span reaches
/// along z, and the one after the last. Memory: a page.
pub fn each_span(archive: &Archive, path: &Path, mut give: impl FnMut([i64; 2], (i64, i64))) -> Result<(), Failure> {
    let cubes = SpanCubes::of(archive.frame());
    let mut pages = PageReader::new(archive);
    for entry in crate::entries(archive, path) {
        let entry = entry?;
        let tile = [i64::from(entry.key.tx), i64::from(entry.key.ty)];
        let base = i64::from(entry.key.layer) * PAGE_QUANTA;
        for (px, py, spans) in pages.page(&entry).map_err(|error| crate::broken(path, &error))?.columns() {
            let pixel = [tile[0] * TILE_PIXELS + i64::from(px), tile[1] * TILE_PIXELS + i64::from(py)];
            for span in spans {
                give(pixel, cubes.of_span(base + i64::from(span.bottom()), base + i64::from(span.top())));
            }
        }
    }
    Ok(())
}
