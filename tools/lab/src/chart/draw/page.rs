//! `chart.md`: how to read the charts, who is on which front, and the tables.

use super::model::Scene;
use super::{Drawn, plots, tables, verdict};
use crate::stability::{Result, fill};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The words of the page; `{{name}}` stands for what was computed.
const PAGE: &str = include_str!("chart.md");

pub fn page(scenes: &[Scene], drawn: &[Drawn], machine: &str) -> Result<String> {
    let mut sections = String::new();
    for scene in scenes {
        section(&mut sections, scene, drawn)?;
    }
    let facts = BTreeMap::from([
        ("machine".to_owned(), machine.to_owned()),
        ("shown".into(), super::axis::short(plots::SHOWN_CM)),
        ("summary".into(), verdict::summary(scenes)),
        ("settings".into(), tables::settings(scenes)),
        ("scale".into(), pictures(plots::SCALE, drawn)),
        ("scenes".into(), sections.trim_end().to_owned()),
    ]);
    fill(PAGE, &facts)
}

fn section(page: &mut String, scene: &Scene, drawn: &[Drawn]) -> Result<()> {
    let shown = super::axis::short(plots::SHOWN_CM);
    writeln!(page, "## {}\n\n{}", scene.name, pictures(&scene.name, drawn))?;
    if let Some(stands) = verdict::table(scene) {
        writeln!(page, "Slicewalk on the fronts:\n\n{stands}\n")?;
    }
    writeln!(page, "At t = {shown} cm:\n\n{}\n", tables::costs(scene))?;
    if let Some(walking) = tables::walking(scene) {
        writeln!(page, "{walking}\n")?;
    }
    let skipped = tables::skipped(scene);
    if !skipped.is_empty() {
        writeln!(page, "{skipped}")?;
    }
    Ok(())
}

/// The first chart of a group as a picture, the others as links.
fn pictures(group: &str, drawn: &[Drawn]) -> String {
    let mut of_group = drawn.iter().filter(|chart| chart.group == group);
    let Some(first) = of_group.next() else { return String::new() };
    let links: Vec<_> = of_group.map(|chart| format!("[{}](chart/{}.svg)", chart.what, chart.name)).collect();
    let more = if links.is_empty() { String::new() } else { format!("\nAlso: {}.\n", links.join(", ")) };
    format!("![{}](chart/{}.svg)\n{more}", first.what, first.name)
}
