//! Outlines in plan, and which pixels they hold or touch.

use crate::frame::Frame;
use nalgebra::Point2;

/// A closed polygon.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    corners: Vec<Point2<f64>>,
    bounds: [Point2<f64>; 2],
}

impl Outline {
    /// Creates an outline of finite corners; `None` if they lie on a line along an axis.
    pub fn new(corners: &[Point2<f64>]) -> Option<Self> {
        let first = *corners.first()?;
        let bounds = corners.iter().fold([first; 2], |[low, high], corner| [low.inf(corner), high.sup(corner)]);
        let area = |corner: usize| {
            let [a, b] = [corner, (corner + 1) % corners.len()].map(|at| corners[at] - first);
            a.x * b.y - a.y * b.x
        };
        // Relative to the first corner, so that large coordinates lose nothing.
        let area: f64 = (0..corners.len()).map(area).sum();
        (area != 0.0).then(|| Self { corners: corners.to_vec(), bounds })
    }

    /// Returns the lower and the upper corner of the rectangle around it.
    pub fn bounds(&self) -> [Point2<f64>; 2] {
        self.bounds
    }

    fn edges(&self) -> impl Iterator<Item = [Point2<f64>; 2]> + '_ {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.iter().zip(next).map(|(a, b)| [*a, *b])
    }

    /// Returns whether a place lies inside (even-odd rule).
    pub fn holds(&self, at: Point2<f64>) -> bool {
        let crosses = |[a, b]: [Point2<f64>; 2]| {
            (a.y > at.y) != (b.y > at.y) && {
                // The edge lies to the right of the place.
                let (low, high) = if a.y < b.y { (a, b) } else { (b, a) };
                let side = (high.x - low.x) * (at.y - low.y) - (high.y - low.y) * (at.x - low.x);
                side > 0.0
            }
        };
        self.edges().filter(|edge| crosses(*edge)).count() % 2 == 1
    }

    /// Returns whether the middle of a pixel lies inside.
    pub fn holds_middle(&self, frame: &Frame, [i, j]: [i64; 2]) -> bool {
        self.holds(Point2::new((i as f64 + 0.5) * frame.pixel_m(), (j as f64 + 0.5) * frame.pixel_m()))
    }

    /// Returns whether all of a pixel lies inside, clear of every edge.
    pub fn holds_all(&self, frame: &Frame, at: [i64; 2]) -> bool {
        self.holds_middle(frame, at) && !self.crosses(frame, at)
    }

    /// Returns whether a pixel and the outline share a place.
    pub fn touches(&self, frame: &Frame, at: [i64; 2]) -> bool {
        self.holds_middle(frame, at) || self.crosses(frame, at)
    }

    /// Returns whether a pixel, its border included, and an edge share a place.
    fn crosses(&self, frame: &Frame, [i, j]: [i64; 2]) -> bool {
        let (low, high) = ([i, j].map(|at| frame.edge_of_pixel(at)), [i + 1, j + 1].map(|at| frame.edge_of_pixel(at)));
        self.edges().any(|edge| meets(edge, low, high))
    }
}

/// Returns whether a straight line and a closed rectangle share a place (Liang and Barsky's clipping).
fn meets([a, b]: [Point2<f64>; 2], low: [f64; 2], high: [f64; 2]) -> bool {
    let (mut first, mut last) = (0.0f64, 1.0f64);
    for axis in 0..2 {
        let way = b[axis] - a[axis];
        if way == 0.0 {
            if a[axis] < low[axis] || a[axis] > high[axis] {
                return false;
            }
            continue;
        }
        let ends = [(low[axis] - a[axis]) / way, (high[axis] - a[axis]) / way];
        first = first.max(ends[0].min(ends[1]));
        last = last.min(ends[0].max(ends[1]));
    }
    first <= last
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline(corners: &[[f64; 2]]) -> Outline {
        Outline::new(&corners.iter().map(|corner| Point2::from(*corner)).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn pixels_inside_or_touched() {
        let frame = Frame::new(1.0, 1.0).unwrap();
        let l_shape = outline(&[[0.2, 0.2], [4.7, 0.2], [4.7, 1.6], [2.3, 1.6], [2.3, 5.5], [0.2, 5.5]]);
        let rows = |is_in: &dyn Fn([i64; 2]) -> bool| -> Vec<String> {
            (0..6).map(|j| (0..6).map(|i| if is_in([i, j]) { '#' } else { '.' }).collect()).collect()
        };
        let held = ["#####.", "#####.", "##....", "##....", "##....", "......"];
        let touched = ["#####.", "#####.", "###...", "###...", "###...", "###..."];
        let whole = ["......", ".#....", ".#....", ".#....", ".#....", "......"];
        assert_eq!(rows(&|at| l_shape.holds_middle(&frame, at)), held.map(String::from).to_vec());
        assert_eq!(rows(&|at| l_shape.touches(&frame, at)), touched.map(String::from).to_vec());
        assert_eq!(rows(&|at| l_shape.holds_all(&frame, at)), whole.map(String::from).to_vec());
        // A thin wall holds no middle, and touches every pixel on its way.
        let thin = outline(&[[0.1, 2.2], [5.9, 2.2], [5.9, 2.3], [0.1, 2.3]]);
        assert!((0..6).all(|i| thin.touches(&frame, [i, 2]) && !thin.holds_middle(&frame, [i, 2])));
        assert!(Outline::new(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]].map(Point2::from)).is_none());
    }
}
