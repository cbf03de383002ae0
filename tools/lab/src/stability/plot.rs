//! Line plots as SVG, on white, with the same colour for the same method everywhere.

use super::Result;
use super::lab::Method;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use std::path::Path;

/// One line of a plot.
#[derive(Debug, Clone)]
pub struct Line {
    /// Name in the legend.
    pub name: String,
    /// Which colour: see [`Line::new`].
    pub colour: usize,
    /// Points, in order of x.
    pub points: Vec<(f64, f64)>,
}

impl Line {
    /// A line in colour number `colour`.
    pub fn new(name: impl Into<String>, colour: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), colour, points }
    }

    /// A line in the colour of `method`.
    pub fn of(method: Method, points: Vec<(f64, f64)>) -> Self {
        Self::new(method.name(), method as usize, points)
    }
}

/// A plot.
#[derive(Debug, Clone)]
pub struct Plot {
    /// File name without its ending.
    pub name: &'static str,
    /// One line above.
    pub title: String,
    /// Label of the x axis, with its unit.
    pub x: &'static str,
    /// Label of the y axis, with its unit.
    pub y: &'static str,
    /// Whether x is logarithmic.
    pub log_x: bool,
    /// Least range of y.
    pub y_range: (f64, f64),
    /// Vertical lines to mark, with what they are.
    pub marks: Vec<(f64, String)>,
    /// The lines.
    pub lines: Vec<Line>,
}

/// Colours that colour-blind readers can distinguish too (Okabe and Ito).
pub(crate) const COLOURS: [RGBColor; 8] = [
    RGBColor(213, 94, 0),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(0, 114, 178),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
    RGBColor(0, 0, 0),
];
const SIZE: (u32, u32) = (860, 480);

impl Plot {
    /// Writes `NAME.svg` into `folder`.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let path = folder.join(format!("{}.svg", self.name));
        let all = || self.lines.iter().flat_map(|line| &line.points);
        let (mut x, mut y) = ((f64::INFINITY, f64::NEG_INFINITY), self.y_range);
        for &(px, py) in all() {
            x = (x.0.min(px), x.1.max(px));
            y = (y.0.min(py), y.1.max(py));
        }
        let room = (y.1 - y.0) * 0.04;
        let y = y.0 - if y.0 < 0.0 { room } else { 0.0 }..y.1 + room;
        let area = SVGBackend::new(&path, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        if self.log_x {
            self.draw(&area, (x.0..x.1).log_scale(), y)?;
        } else {
            self.draw(&area, x.0..x.1, y)?;
        }
        area.present()?;
        Ok(())
    }

    fn draw<X>(
        &self,
        area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
        x: X,
        y: std::ops::Range<f64>,
    ) -> Result<()>
    where
        X: AsRangedCoord<Value = f64>,
        X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let y_low = y.start;
        let y_high = y.end;
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 19))
            .margin(14)
            .x_label_area_size(48)
            .y_label_area_size(72)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(225, 225, 225))
            .x_desc(self.x)
            .y_desc(self.y)
            .x_labels(12)
            .y_labels(9)
            .label_style(("sans-serif", 14))
            .axis_desc_style(("sans-serif", 15))
            .x_label_formatter(&|v| short(*v))
            .y_label_formatter(&|v| short(*v))
            .draw()?;
        for (at, what) in &self.marks {
            let grey = RGBColor(120, 120, 120);
            chart.draw_series([PathElement::new(vec![(*at, y_low), (*at, y_high)], grey.stroke_width(1))])?;
            let style = ("sans-serif", 13).into_font().color(&grey);
            chart.draw_series([EmptyElement::at((*at, y_high)) + Text::new(what.clone(), (4, 2), style)])?;
        }
        for line in &self.lines {
            let colour = COLOURS[line.colour % COLOURS.len()];
            let style = colour.stroke_width(2);
            let series = chart.draw_series(LineSeries::new(line.points.iter().copied(), style))?;
            series.label(&line.name).legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], style));
            if line.points.len() <= 24 {
                chart.draw_series(line.points.iter().map(|&p| Circle::new(p, 3, colour.filled())))?;
            }
        }
        chart
            .configure_series_labels()
            .position(self.legend_place(y_low, y_high))
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(200, 200, 200))
            .label_font(("sans-serif", 14))
            .legend_area_size(28)
            .margin(8)
            .draw()?;
        Ok(())
    }

    /// The corner, or middle of a side, with the fewest points near it.
    fn legend_place(&self, low: f64, high: f64) -> SeriesLabelPosition {
        use SeriesLabelPosition::*;
        let xs = || self.lines.iter().flat_map(|line| line.points.iter().map(|p| self.along(p.0)));
        let (x0, x1) = (xs().fold(f64::INFINITY, f64::min), xs().fold(f64::NEG_INFINITY, f64::max));
        let near = |right: bool, at: f64| {
            let points = self.lines.iter().flat_map(|line| line.points.windows(2)).flat_map(|pair| {
                (0..8).map(|n| {
                    let part = f64::from(n) / 8.0;
                    let x = self.along(pair[0].0) * (1.0 - part) + self.along(pair[1].0) * part;
                    ((x - x0) / (x1 - x0), (pair[0].1 * (1.0 - part) + pair[1].1 * part - low) / (high - low))
                })
            });
            let inside = |p: &(f64, f64)| (if right { p.0 > 0.68 } else { p.0 < 0.32 }) && (p.1 - at).abs() < 0.2;
            points.filter(inside).count()
        };
        let places = [
            (UpperRight, near(true, 0.85)),
            (UpperLeft, near(false, 0.85)),
            (LowerRight, near(true, 0.15)),
            (LowerLeft, near(false, 0.15)),
            (MiddleRight, near(true, 0.5)),
            (MiddleLeft, near(false, 0.5)),
        ];
        places.into_iter().min_by_key(|place| place.1).map_or(UpperRight, |place| place.0)
    }

    fn along(&self, x: f64) -> f64 {
        if self.log_x { x.ln() } else { x }
    }
}

/// A number on an axis without needless digits.
fn short(value: f64) -> String {
    let text = if value != 0.0 && value.abs() < 1e-3 { format!("{value:.0e}") } else { format!("{value:.4}") };
    if text.contains('e') || !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
