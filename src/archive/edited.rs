//! Pages of an archive that carries edits: those of the tile columns that the edits touch.

use super::directory::PageEntry;
use super::reader::Archive;
use crate::edit::{EditedColumn, MOST_EDITED_PAGES};
use crate::frame::PageKey;
use crate::page::Page;
use crate::{Error, Monitor, NoMonitor, Result};
use std::collections::BTreeMap;

/// Pages that are read together, in memory (bytes); at least those of a tile column.
const TOGETHER: usize = 1 << 20;

/// Returns all pages of the tile columns that the archive's edits touch; `None` without edits. Fails if these are more
/// than 2¹⁶ pages, or if `monitor` requests a stop.
pub fn edited_pages(archive: &Archive, monitor: &dyn Monitor) -> Result<Option<BTreeMap<PageKey, Page>>> {
    let mut all = BTreeMap::new();
    let has_edits = each_edited_page(archive, monitor, |key, page| drop(all.insert(key, page)))?;
    Ok(has_edits.then_some(all))
}

/// Passes each of these pages to `give`, so that few are in memory at a time. Returns whether the archive has edits.
pub fn each_edited_page(archive: &Archive, monitor: &dyn Monitor, mut give: impl FnMut(PageKey, Page)) -> Result<bool> {
    let Some(edits) = archive.edits() else { return Ok(false) };
    let frame = archive.frame();
    let most = MOST_EDITED_PAGES as i128;
    let too_many = |found: i128| Error::limit("pages that edits change (draw smaller shapes)", found, most);
    let regions: Vec<_> = edits.regions(frame).collect();
    // In the order of the archive, where neighbours lie side by side.
    let key = |[tx, ty]: [i32; 2]| PageKey { tx, ty, layer: 0 };
    let mut columns: BTreeMap<PageKey, Vec<PageEntry>> = BTreeMap::new();
    for ([low, high], layers) in &regions {
        let Some([first, last]) = layers else { continue };
        let count = [high[0] - low[0] + 1, high[1] - low[1] + 1, last - first + 1].map(i128::from);
        let pages = columns.len() as i128 + count.into_iter().product::<i128>();
        if pages > most {
            return Err(too_many(pages));
        }
        for (x, y) in (low[1]..=high[1]).flat_map(|y| (low[0]..=high[0]).map(move |x| (x, y))) {
            let tile = [x, y].map(i32::try_from);
            let [Ok(x), Ok(y)] = tile else {
                return Err(Error::limit("tile of an edit", x.abs().max(y.abs()), i32::MAX));
            };
            columns.entry(key([x, y])).or_default();
        }
    }
    let is_touched = |at: [i64; 2]| {
        regions.iter().any(|([low, high], _)| (0..2).all(|axis| (low[axis]..=high[axis]).contains(&at[axis])))
    };
    let mut count = 0;
    for entry in archive.entries() {
        let entry = entry?;
        let column = [entry.key.tx, entry.key.ty];
        if columns.contains_key(&key(column)) || is_touched(column.map(i64::from)) {
            columns.entry(key(column)).or_default().push(entry);
            count += 1;
            if count > most {
                return Err(too_many(count));
            }
        }
    }
    let is_level = archive.header().level > 0;
    let (mut given, mut weight, mut batch) = (0, 0, Vec::new());
    let mut columns = columns.into_iter().peekable();
    while let Some(column) = columns.next() {
        weight += column.1.iter().map(PageEntry::weight_bytes).sum::<usize>();
        batch.push(column);
        if weight < TOGETHER && columns.peek().is_some() {
            continue;
        }
        let entries: Vec<PageEntry> = batch.iter().flat_map(|(_, entries)| entries).copied().collect();
        let mut pages = archive.pages(&entries, &NoMonitor)?.into_iter();
        for (column, entries) in batch.drain(..) {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let own: Vec<(i32, Page)> = entries.iter().map(|entry| entry.key.layer).zip(pages.by_ref()).collect();
            let own: Vec<(i32, &Page)> = own.iter().map(|(layer, page)| (*layer, page)).collect();
            for (layer, page) in EditedColumn::new(edits, frame, is_level, [column.tx, column.ty]).apply(&own)? {
                given += 1;
                if given > most {
                    return Err(too_many(given));
                }
                give(PageKey { layer, ..column }, page);
            }
        }
        weight = 0;
    }
    Ok(true)
}
