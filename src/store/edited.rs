//! Pages of an archive that carries edits in a set of pages: they are read and edited when the set is opened.

use super::budget::Budget;
use super::index::Index;
use super::snapshot::{Edited, Held, PageSlot};
use crate::archive::{Archive, edited_pages};
use crate::frame::PageKey;
use crate::page::Page;
use crate::text::counted;
use crate::{Error, Parameter, Result};
use std::sync::Arc;

#[cfg_attr(target_family = "wasm", allow(dead_code, reason = "of streams, which need threads"))]
/// Reads and edits the columns that the archive's edits touch; `None` without edits. Their pages count against the budget.
pub(super) fn edited_columns(archive: &Archive, index: &Index, budget: &Arc<Budget>) -> Result<Option<Edited>> {
    let Some(pages) = edited_pages(archive)? else { return Ok(None) };
    let needed: usize = pages.values().map(Page::weight_bytes).sum();
    let count = pages.len();
    let slot = |(key, page): (PageKey, Page)| {
        let bytes = page.weight_bytes() + size_of::<PageSlot>() + size_of::<Held>();
        let room = budget.take(bytes).ok_or_else(|| {
            let (own, count) = (budget.budget(), counted(count as u64, "page"));
            let reason = format!("{own} bytes do not hold the {count} with edits ({needed} bytes)");
            Error::parameter(Parameter::Cache, reason)
        })?;
        Ok((key, PageSlot::of(key.layer, Held { page, room: Some(room) })))
    };
    let slots = pages.into_iter().map(slot).collect::<Result<_>>()?;
    Ok(Some(Edited::new(slots, index.table())))
}
