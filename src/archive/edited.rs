//! Pages of an archive that carries edits: those of the tile columns that the edits touch.

use super::directory::PageEntry;
use super::page_coding::PageDecoder;
use super::reader::Archive;
use crate::edit::{EditedColumn, MOST_EDITED_PAGES};
use crate::frame::PageKey;
use crate::page::Page;
use crate::{Error, Result};
use std::collections::BTreeMap;

/// Returns all pages of the tile columns that the archive's edits touch; `None` without edits. Fails if these are more
/// than 2¹⁶ pages.
pub fn edited_pages(archive: &Archive) -> Result<Option<BTreeMap<PageKey, Page>>> {
    let Some(edits) = archive.edits() else { return Ok(None) };
    let frame = archive.frame();
    let most = MOST_EDITED_PAGES as i128;
    let too_many = |found: i128| Error::limit("pages that edits change (draw smaller shapes)", found, most);
    let regions: Vec<_> = edits.regions(frame).collect();
    let mut columns: BTreeMap<[i32; 2], Vec<PageEntry>> = BTreeMap::new();
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
            columns.entry([x, y]).or_default();
        }
    }
    let is_touched = |at: [i64; 2]| {
        regions.iter().any(|([low, high], _)| (0..2).all(|axis| (low[axis]..=high[axis]).contains(&at[axis])))
    };
    let mut count = 0;
    for entry in archive.entries() {
        let entry = entry?;
        let column = [entry.key.tx, entry.key.ty];
        if columns.contains_key(&column) || is_touched(column.map(i64::from)) {
            columns.entry(column).or_default().push(entry);
            count += 1;
            if count > most {
                return Err(too_many(count));
            }
        }
    }
    let is_level = archive.header().level > 0;
    let (mut all, mut decoder) = (BTreeMap::new(), PageDecoder::new());
    for ([tx, ty], entries) in columns {
        let read = |entry: &PageEntry| Ok((entry.key.layer, archive.page_with(entry, &mut decoder)?));
        let pages = entries.iter().map(read).collect::<Result<Vec<_>>>()?;
        let pages: Vec<(i32, &Page)> = pages.iter().map(|(layer, page)| (*layer, page)).collect();
        for (layer, page) in EditedColumn::new(edits, frame, is_level, [tx, ty]).apply(&pages)? {
            all.insert(PageKey { tx, ty, layer }, page);
            if all.len() as i128 > most {
                return Err(too_many(all.len() as i128));
            }
        }
    }
    Ok(Some(all))
}
