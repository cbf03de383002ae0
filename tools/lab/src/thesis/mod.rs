//! The thesis' tables with Slicewalk's numbers and the differences; objects against triangles.
//!
//! Out: `thesis.md`. Every conversion runs in a process of its own, so that its memory can be measured.

mod bunnies;
mod frames;
pub(crate) mod models;
mod prepare;

use crate::stability::{Result, fill};
use std::collections::BTreeMap;
use std::path::Path;

/// The words of the page; `{{name}}` stands for a table.
const PAGE: &str = include_str!("page.md");

/// Measures, and writes `thesis.md` into `out`.
pub fn run(out: &Path, quick: bool) -> Result<()> {
    let folder = tempfile::tempdir()?;
    let models = models::all(folder.path(), quick)?;
    let mut facts = BTreeMap::new();
    let mut add =
        |found: Vec<(&str, String)>| facts.extend(found.into_iter().map(|(name, text)| (name.to_owned(), text)));
    add(vec![("models", models::table(&models))]);
    add(prepare::measure(&models, folder.path(), quick)?);
    add(frames::measure(&models, folder.path(), quick)?);
    add(bunnies::measure(quick)?);
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("thesis.md"), fill(PAGE, &facts)?)?;
    Ok(())
}
