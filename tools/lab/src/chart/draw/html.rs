//! `chart.html`: all charts in one page without outside addresses. Scripts choose a chart and show the numbers of a point;
//! without them all charts follow each other and the numbers are titles.

use super::Drawn;
use super::style::{GRID, INK, PAPER};
use super::svg::escaped;
use crate::stability::plot::COLOURS;
use crate::stability::{Result, fill};
use plotters::style::RGBColor;
use std::collections::BTreeMap;
use std::fmt::Write;

const PAGE: &str = include_str!("chart.html");

pub fn page(drawn: &[Drawn], machine: &str) -> Result<String> {
    let mut figures = String::new();
    for chart in drawn {
        // The title inside is the heading of the figure already.
        let (group, what) = (escaped(&chart.group), escaped(&chart.what));
        writeln!(
            figures,
            "<figure data-group=\"{group}\" data-what=\"{what}\">\n<h2>{group}: {what}</h2>\n{}</figure>",
            chart.svg
        )?;
    }
    let facts = BTreeMap::from([
        ("machine".to_owned(), escaped(machine)),
        ("paper".into(), hex(PAPER)),
        ("ink".into(), hex(INK)),
        ("grid".into(), hex(GRID)),
        ("blue".into(), hex(COLOURS[3])),
        ("grey".into(), hex(COLOURS[6])),
        ("figures".into(), figures),
    ]);
    fill(PAGE, &facts)
}

/// As plotters writes it.
fn hex(RGBColor(r, g, b): RGBColor) -> String {
    format!("#{r:02X}{g:02X}{b:02X}")
}
