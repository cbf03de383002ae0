//! Seen space: the last pass of a conversion, which writes the cells that the stations saw.

use super::pipeline::Pipeline;
use crate::archive::ArchiveWriter;
use crate::voxel::visibility::{FreeColumn, Views};
use crate::{Error, Monitor, Result};
use slicewalk::seen::SeenBlock;

/// Columns per thread that may be finished before the oldest unfinished one.
const AHEAD_PER_THREAD: usize = 16;

/// Seen space of an archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SeenCounts {
    /// Cells of 4 × 4 pixels and one slice.
    pub cells: u64,
    /// Bytes in the archive.
    pub bytes: u64,
}

/// Writes the seen space of the tile columns from `columns.0` to `columns.1` (all by default), whose pages are written.
///
/// Memory: images of about the size of the views, and the blocks of a few columns for each thread.
pub(super) fn write_seen(
    views: &Views,
    columns: Option<(u64, u64)>,
    threads: usize,
    writer: &mut ArchiveWriter,
    monitor: &dyn Monitor,
) -> Result<SeenCounts> {
    monitor.stage("seen space", 0, "columns");
    let space = views.free_space();
    let space = &space;
    let worker = || {
        |column: FreeColumn| -> Result<Vec<SeenBlock>> {
            let mut blocks: Vec<SeenBlock> = Vec::new();
            for (key, page) in space.pages(&column) {
                let (block, at) = SeenBlock::place_of(key);
                if blocks.last().is_none_or(|last| last.key != block) {
                    blocks.push(SeenBlock::new(block));
                }
                if let Some(last) = blocks.last_mut() {
                    last.push(at, &page);
                }
            }
            monitor.advance(1);
            Ok(blocks)
        }
    };
    let pool = Pipeline { threads, ahead: AHEAD_PER_THREAD * threads };
    pool.run(
        |give| {
            // Once the results are no longer taken, an error says why.
            let _ = space.each_column(columns.unwrap_or((0, u64::MAX)), give);
            Ok(())
        },
        worker,
        |blocks: Vec<SeenBlock>| blocks.iter().try_for_each(|block| writer.put_seen(block)),
        || if monitor.cancelled() { Err(Error::Interrupted) } else { Ok(()) },
        |error| Error::io("a worker", "start", error),
    )?;
    let (cells, bytes) = writer.end_seen()?;
    Ok(SeenCounts { cells, bytes })
}
