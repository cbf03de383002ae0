//! A figure as SVG text: plotters draws the axes, and the marks by their pixels, so that words keep clear of them.

use super::figure::{Figure, Spread};
use super::labels::{Rect, Surroundings};
use super::style::{GRID, INK, Marker, PAPER};
use crate::stability::Result;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::fmt::Write;

const SIZE: (u32, u32) = (900, 540);
/// Width of the legend (pixels).
const LEGEND: u32 = 200;
const RADIUS: f64 = 5.0;
/// Sizes of words: plotters takes 1.24 times what it writes.
const TITLE: i32 = 20;
const WORDS: i32 = 17;
const SMALL: i32 = 15;

type Root<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Draws it.
pub fn render(figure: &Figure) -> Result<String> {
    let mut text = String::new();
    let spots = {
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        root.fill(&PAPER)?;
        let spots = draw(&root, figure)?;
        root.present()?;
        spots
    };
    let body = text.trim_end().strip_suffix("</svg>").ok_or("the drawing has no end")?;
    // Leaving out default attributes makes the page a seventh smaller.
    Ok(format!("{}{spots}</svg>\n", body.replace(r#" opacity="1""#, "").replace(r#" stroke-width="1""#, "")))
}

/// Gives the places to point at, as SVG.
fn draw(root: &Root, figure: &Figure) -> Result<String> {
    let (area, _) = root.split_horizontally(SIZE.0 - LEGEND);
    words(root, &figure.title, (14, 22), HPos::Left, TITLE)?;
    let mut chart = ChartBuilder::on(&area)
        .margin(14)
        .margin_top(40)
        .x_label_area_size(46)
        .y_label_area_size(66)
        .build_cartesian_2d(figure.x.clone(), figure.y.clone())?;
    chart
        .configure_mesh()
        .light_line_style(PAPER)
        .bold_line_style(GRID)
        .axis_style(INK)
        .x_desc(&figure.x.label)
        .y_desc(&figure.y.label)
        .label_style(("sans-serif", WORDS).into_font().color(&INK))
        .axis_desc_style(("sans-serif", WORDS).into_font().color(&INK))
        .x_label_formatter(&|tick| figure.x.number(*tick))
        .y_label_formatter(&|tick| figure.y.number(*tick))
        .draw()?;
    let pixel = |place: (f64, f64)| {
        let (x, y) = chart.backend_coord(&place);
        (f64::from(x), f64::from(y))
    };
    let (left, right) = ends(chart.plotting_area().get_x_axis_pixel_range());
    let (top, bottom) = ends(chart.plotting_area().get_y_axis_pixel_range());
    let bounds = Rect(left, top, right, bottom);
    breaks(root, figure, &pixel, bounds)?;
    marks(root, figure, pixel, bounds)?;
    legend(root, figure)?;
    spots(figure, pixel)
}

/// Two strokes across an axis that has a place for zero.
fn breaks(root: &Root, figure: &Figure, pixel: &impl Fn((f64, f64)) -> (f64, f64), bounds: Rect) -> Result<()> {
    let mut strokes = Vec::new();
    if let Some((zero, low)) = figure.x.broken() {
        let middle = (pixel((zero, 0.0)).0 + pixel((low, 0.0)).0) / 2.0;
        strokes
            .extend([-2.0, 2.0].map(|by| [(middle + by - 3.0, bounds.3 + 5.0), (middle + by + 3.0, bounds.3 - 5.0)]));
    }
    if let Some((zero, low)) = figure.y.broken() {
        let middle = (pixel((1.0, zero)).1 + pixel((1.0, low)).1) / 2.0;
        strokes
            .extend([-2.0, 2.0].map(|by| [(bounds.0 - 5.0, middle + by + 3.0), (bounds.0 + 5.0, middle + by - 3.0)]));
    }
    for stroke in strokes {
        root.draw(&PathElement::new(stroke.map(whole), INK.stroke_width(1)))?;
    }
    Ok(())
}

/// Both ends of a range of pixels, the lesser first.
fn ends(range: std::ops::Range<i32>) -> (f64, f64) {
    (f64::from(range.start.min(range.end)), f64::from(range.start.max(range.end)))
}

fn whole((x, y): (f64, f64)) -> (i32, i32) {
    (x.round() as i32, y.round() as i32)
}

fn marks(root: &Root, figure: &Figure, pixel: impl Fn((f64, f64)) -> (f64, f64), bounds: Rect) -> Result<()> {
    let mut around = Surroundings { bounds, taken: vec![], lines: vec![] };
    let mut line = |places: Vec<(f64, f64)>, style: ShapeStyle| -> Result<()> {
        around.lines.extend(places.windows(2).map(|pair| [pair[0], pair[1]]));
        root.draw(&PathElement::new(places.into_iter().map(whole).collect::<Vec<_>>(), style))?;
        Ok(())
    };
    if let Some((limit, what)) = figure.limit {
        let y = pixel((1.0, limit)).1;
        line(vec![(bounds.0, y), (bounds.2, y)], front_style())?;
        words(root, what, whole((bounds.0 + 8.0, y - 11.0)), HPos::Left, SMALL)?;
    }
    line(figure.front.iter().map(|corner| pixel(*corner)).collect(), front_style())?;
    for track in &figure.tracks {
        let colour = track.style.0;
        line(track.dots.iter().map(|dot| pixel(dot.at)).collect(), colour.mix(0.75).stroke_width(2))?;
        for dot in &track.dots {
            let ends = match dot.spread {
                Spread::X(low, high) => [(low, dot.at.1), (high, dot.at.1)],
                Spread::Y(low, high) => [(dot.at.0, low), (dot.at.0, high)],
                Spread::None => continue,
            };
            let inside = |(x, y): (f64, f64)| (x.clamp(bounds.0, bounds.2), y.clamp(bounds.1, bounds.3));
            line(ends.map(|end| inside(pixel(end))).to_vec(), colour.stroke_width(1))?;
        }
    }
    // Slicewalk comes first in the list; drawn last, it lies on top.
    for track in figure.tracks.iter().rev() {
        let (colour, shape) = track.style;
        for dot in &track.dots {
            let place = pixel(dot.at);
            marker(root, place, RADIUS, shape, colour, dot.hollow)?;
            around.taken.push(Rect::around(place, 2.3 * RADIUS, 2.3 * RADIUS));
        }
    }
    words_beside(root, figure, pixel, around)
}

/// The labels of dots: those of the front first, and one for dots of a track that lie on each other.
fn words_beside(
    root: &Root,
    figure: &Figure,
    pixel: impl Fn((f64, f64)) -> (f64, f64),
    mut around: Surroundings,
) -> Result<()> {
    let dots = || figure.tracks.iter().flat_map(|track| track.dots.iter().map(move |dot| (track, dot)));
    let (first, rest): (Vec<_>, Vec<_>) = dots().partition(|(_, dot)| figure.front.contains(&dot.at));
    let mut named: Vec<(&str, (f64, f64))> = Vec::new();
    for (track, dot) in first.into_iter().chain(rest).filter(|(_, dot)| !dot.label.is_empty()) {
        let place = pixel(dot.at);
        let near = |other: (f64, f64)| (other.0 - place.0).hypot(other.1 - place.1) < 2.0 * RADIUS;
        if named.iter().any(|(name, other)| *name == track.name && near(*other)) {
            continue;
        }
        let width = dot.label.chars().count() as f64 * 7.5 + 2.0;
        if let Some(rect) = around.place(place, width, 12.0) {
            // Lines that pass behind it fade.
            let ground = [whole((rect.0, rect.1)), whole((rect.2, rect.3))];
            root.draw(&Rectangle::new(ground, PAPER.mix(0.75).filled()))?;
            let font = ("sans-serif", SMALL).into_font().color(&track.style.0);
            root.draw(&Text::new(
                dot.label.clone(),
                whole(rect.middle()),
                font.pos(Pos::new(HPos::Center, VPos::Center)),
            ))?;
            named.push((&track.name, place));
        }
    }
    Ok(())
}

fn front_style() -> ShapeStyle {
    INK.mix(0.55).stroke_width(3)
}

fn marker(root: &Root, at: (f64, f64), radius: f64, shape: Marker, colour: RGBColor, hollow: bool) -> Result<()> {
    let place = |(x, y): (f64, f64)| ((at.0 + x * radius).round() as i32, (at.1 + y * radius).round() as i32);
    let fill = if hollow { PAPER.filled() } else { colour.filled() };
    let edge = if hollow { colour } else { PAPER };
    let edge = edge.stroke_width(if hollow { 2 } else { 1 });
    let corners: Vec<_> = shape.corners().into_iter().map(place).collect();
    if corners.is_empty() {
        root.draw(&Circle::new(place((0.0, 0.0)), radius, fill))?;
        root.draw(&Circle::new(place((0.0, 0.0)), radius, edge))?;
    } else {
        root.draw(&Polygon::new(corners.clone(), fill))?;
        let around: Vec<_> = corners.iter().chain(&corners[..1]).copied().collect();
        root.draw(&PathElement::new(around, edge))?;
    }
    Ok(())
}

fn legend(root: &Root, figure: &Figure) -> Result<()> {
    let left = (SIZE.0 - LEGEND) as i32 + 8;
    let mut y = 54;
    for track in figure.tracks.iter().filter(|track| !track.dots.is_empty()) {
        let (colour, shape) = track.style;
        root.draw(&PathElement::new([(left, y), (left + 24, y)], colour.mix(0.75).stroke_width(2)))?;
        marker(root, (f64::from(left + 12), f64::from(y)), RADIUS, shape, colour, false)?;
        words(root, &track.name, (left + 32, y), HPos::Left, WORDS)?;
        y += 22;
    }
    if !figure.front.is_empty() {
        root.draw(&PathElement::new([(left, y), (left + 24, y)], front_style()))?;
        words(root, "Pareto front", (left + 32, y), HPos::Left, WORDS)?;
        y += 22;
    }
    if figure.tracks.iter().flat_map(|track| &track.dots).any(|dot| dot.hollow) {
        marker(root, (f64::from(left + 12), f64::from(y)), RADIUS, Marker::Circle, INK, true)?;
        words(root, "misses points", (left + 32, y), HPos::Left, WORDS)?;
        y += 22;
    }
    y += 6;
    for note in &figure.notes {
        words(root, note, (left, y), HPos::Left, SMALL)?;
        y += 18;
    }
    Ok(())
}

fn words(root: &Root, text: &str, at: (i32, i32), from: HPos, size: i32) -> Result<()> {
    let font = ("sans-serif", size).into_font().color(&INK).pos(Pos::new(from, VPos::Center));
    root.draw(&Text::new(text.to_owned(), at, font))?;
    Ok(())
}

/// Transparent circles with the numbers of the dots under them.
fn spots(figure: &Figure, pixel: impl Fn((f64, f64)) -> (f64, f64)) -> Result<String> {
    let mut spots = String::new();
    for dot in figure.tracks.iter().flat_map(|track| &track.dots) {
        let (x, y) = pixel(dot.at);
        let says = escaped(&dot.says);
        writeln!(
            spots,
            r##"<circle class="spot" cx="{x}" cy="{y}" r="8" fill-opacity="0"><title>{says}</title></circle>"##
        )?;
    }
    Ok(spots)
}

/// Text in XML.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
