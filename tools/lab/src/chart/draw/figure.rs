//! A chart before it is drawn: axes, tracks of dots, and the front.

use super::axis::Axis;
use super::style::Style;

/// A chart.
#[derive(Debug, Clone)]
pub struct Figure {
    /// File name without its ending.
    pub name: String,
    /// One line above.
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub tracks: Vec<Track>,
    /// Corners of the line through the Pareto front; none where there is no such line.
    pub front: Vec<(f64, f64)>,
    /// A height that nothing may exceed, and what it is.
    pub limit: Option<(f64, &'static str)>,
    /// Words under the legend, one line each.
    pub notes: Vec<String>,
}

/// Dots of one method or quantity, joined in order.
#[derive(Debug, Clone)]
pub struct Track {
    /// In the legend.
    pub name: String,
    pub style: Style,
    pub dots: Vec<Dot>,
}

/// One measured point.
#[derive(Debug, Clone)]
pub struct Dot {
    pub at: (f64, f64),
    /// Least and greatest repeat of the value that repeats differ in.
    pub spread: Spread,
    /// Beside it, where there is room.
    pub label: String,
    /// Drawn hollow: it misses points.
    pub hollow: bool,
    /// Its numbers, for one who points at it.
    pub says: String,
}

/// The repeats of a dot.
#[derive(Debug, Clone, Copy)]
pub enum Spread {
    X(f64, f64),
    Y(f64, f64),
    None,
}
