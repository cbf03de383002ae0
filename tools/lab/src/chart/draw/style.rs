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

const fn colour(rgb: u32) -> RGBColor {
    RGBColor((rgb >> 16) as u8, (rgb >> 8) as u8, rgb as u8)
}

/// Known methods with their colour and marker, in the order of legends and tables. The colours extend those of Okabe and Ito by some of
/// P. Tol's muted ones.
const METHODS: [(&str, RGBColor, Marker); 14] = [
    ("slicewalk plane", colour(0x0072B2), Marker::Circle),
    ("slicewalk span", colour(0x56B4E9), Marker::Square),
    ("slicewalk thesis", colour(0x332288), Marker::Down),
    ("slicewalk plane t/4", colour(0x2FB5A5), Marker::Diamond),
    ("slicewalk plane broad", colour(0x8A7BD8), Marker::Up),
    ("thesis", colour(0xD55E00), Marker::Square),
    ("parry3d Voxels", colour(0xE69F00), Marker::Circle),
    ("parry3d TriMesh", colour(0x8C510A), Marker::Up),
    ("rapier3d", colour(0x882255), Marker::Diamond),
    ("kiddo spheres", colour(0xCC79A7), Marker::Circle),
    ("kiddo exact", colour(0xE0218A), Marker::Up),
    ("capt", colour(0x5A5A5A), Marker::Square),
    ("octomap", colour(0x009E73), Marker::Circle),
    ("recast", colour(0x999933), Marker::Diamond),
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
    known.map_or((COLOURS[6], Marker::Star), |known| (known.1, known.2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_method_has_a_colour_of_its_own() {
        for (n, a) in METHODS.iter().enumerate() {
            assert!(METHODS[n + 1..].iter().all(|b| style(a.0).0 != style(b.0).0 && a.0 != b.0), "{}", a.0);
        }
    }
}
