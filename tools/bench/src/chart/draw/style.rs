//! One colour and marker for each method, the same on all charts.

use crate::stability::plot::COLOURS;
use plotters::style::RGBColor;

/// Ground of a chart, its words, and its lines: no colour of a method, so that a page can turn them dark.
pub const PAPER: RGBColor = RGBColor(255, 255, 255);
pub const INK: RGBColor = RGBColor(31, 35, 40);
pub const GRID: RGBColor = RGBColor(225, 225, 225);

/// Shape of a marker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Marker {
    Circle,
    Square,
    Up,
    Down,
    Diamond,
    Star,
}

impl Marker {
    /// Corners around (0, 0), with about the area of a circle of radius 1; none of a circle.
    pub fn corners(self) -> Vec<(f64, f64)> {
        match self {
            Marker::Circle => vec![],
            Marker::Square => vec![(-0.88, -0.88), (0.88, -0.88), (0.88, 0.88), (-0.88, 0.88)],
            Marker::Up => vec![(0.0, -1.25), (1.2, 0.85), (-1.2, 0.85)],
            Marker::Down => vec![(0.0, 1.25), (-1.2, -0.85), (1.2, -0.85)],
            Marker::Diamond => vec![(0.0, -1.3), (1.15, 0.0), (0.0, 1.3), (-1.15, 0.0)],
            Marker::Star => (0..10)
                .map(|n| {
                    let (angle, length) = (std::f64::consts::PI * f64::from(n) / 5.0, [1.5, 0.65][n as usize % 2]);
                    (angle.sin() * length, -angle.cos() * length)
                })
                .collect(),
        }
    }
}

/// Known methods with their colour (index in [`COLOURS`]) and marker, in the order of legends and tables.
const METHODS: [(&str, usize, Marker); 14] = [
    ("slicewalk plane", 3, Marker::Circle),
    ("slicewalk span", 5, Marker::Square),
    ("slicewalk thesis", 5, Marker::Down),
    ("slicewalk plane t/4", 3, Marker::Diamond),
    ("slicewalk plane broad", 3, Marker::Up),
    ("thesis", 0, Marker::Square),
    ("parry3d Voxels", 1, Marker::Circle),
    ("parry3d TriMesh", 1, Marker::Up),
    ("rapier3d", 0, Marker::Diamond),
    ("kiddo spheres", 4, Marker::Circle),
    ("kiddo exact", 4, Marker::Up),
    ("capt", 6, Marker::Square),
    ("octomap", 2, Marker::Circle),
    ("recast", 2, Marker::Diamond),
];

/// Where a method stands among others; a new one stands last, by its name.
pub fn rank(method: &str) -> (usize, String) {
    let at = METHODS.iter().position(|known| known.0 == method);
    (at.unwrap_or(METHODS.len()), method.to_owned())
}

/// Colour and marker.
pub type Style = (RGBColor, Marker);

/// The style of slicewalk's first quantity, and of one beside it, where there is nothing but slicewalk.
pub const QUANTITIES: [Style; 2] = [(COLOURS[3], Marker::Circle), (COLOURS[0], Marker::Square)];

/// That of a method; grey stars for one that is new here.
pub fn style(method: &str) -> Style {
    let known = METHODS.iter().find(|known| known.0 == method);
    known.map_or((COLOURS[6], Marker::Star), |known| (COLOURS[known.1], known.2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_methods_look_alike() {
        for (n, a) in METHODS.iter().enumerate() {
            assert!(METHODS[n + 1..].iter().all(|b| style(a.0) != style(b.0) && a.0 != b.0), "{}", a.0);
        }
    }
}
