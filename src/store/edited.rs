//! Pages of an archive that carries edits in a set of pages: they are read and edited when the set is opened.

use super::budget::Budget;
use super::index::Index;
use super::snapshot::{Edited, Held, PageSlot};
use crate::archive::{Archive, each_edited_page};
use crate::text::counted;
use crate::{Error, NoMonitor, Parameter, Result};
use std::sync::Arc;

#[cfg_attr(target_family = "wasm", allow(dead_code, reason = "of streams, which need threads"))]
/// Reads and edits the columns that the archive's edits touch; `None` without edits. Their pages count against the budget.
pub(super) fn edited_columns(archive: &Archive, index: &Index, budget: &Arc<Budget>) -> Result<Option<Edited>> {
    let (mut slots, mut needed, mut count, mut fits) = (Vec::new(), 0, 0, true);
    let has_edits = each_edited_page(archive, &NoMonitor, |key, page| {
        let bytes = page.weight_bytes() + size_of::<PageSlot>() + size_of::<Held>();
        (needed, count) = (needed + bytes, count + 1);
        match budget.take(bytes).filter(|_| fits) {
            Some(room) => slots.push((key, PageSlot::of(key.layer, Held { page, room: Some(room) }))),
            // The rest is only counted.
            None => (slots, fits) = (Vec::new(), false),
        }
    })?;
    if !fits {
        // What the budget holds besides them stays.
        let (own, needed, pages) = (budget.budget(), budget.used() + needed, counted(count, "page"));
        let reason = format!(
            "{own} bytes do not hold the {pages} with edits; give {needed} bytes or more, or draw smaller shapes"
        );
        return Err(Error::parameter(Parameter::Cache, reason));
    }
    Ok(has_edits.then(|| Edited::new(slots, index.table())))
}
