//! Polygons to triangles.

use crate::mesh::Triangle;

/// Most corners of a polygon: cutting ears takes the square of their number.
const MOST_CORNERS: usize = 4096;

/// The corners of one face.
#[derive(Debug, Default)]
pub(super) struct Polygon {
    corners: Vec<[f64; 3]>,
    left: Vec<u32>,
}

impl Polygon {
    pub(super) fn clear(&mut self) {
        self.corners.clear();
    }

    pub(super) fn push(&mut self, corner: [f64; 3]) {
        // One more than the most is enough to tell.
        if self.corners.len() <= MOST_CORNERS {
            self.corners.push(corner);
        }
    }

    /// Appends the triangles of the polygon, concave or not: ears are cut off in the plane in which it is largest. Fails
    /// with a reason if there are too few or too many corners.
    pub(super) fn triangles(&mut self, out: &mut Vec<Triangle>) -> Result<(), String> {
        let corners = &self.corners;
        match corners.len() {
            0..=2 => return Err(format!("a face has {} corners; expected at least 3", corners.len())),
            3 => {
                out.push([corners[0], corners[1], corners[2]]);
                return Ok(());
            }
            count if count > MOST_CORNERS => return Err(format!("a face has more than {MOST_CORNERS} corners")),
            _ => {}
        }
        let normal = self.normal();
        let axis = (0..3).fold(0, |best, axis| if normal[axis].abs() > normal[best].abs() { axis } else { best });
        let flip = if normal[axis] < 0.0 { -1.0 } else { 1.0 };
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let flat = |n: u32| (self.corners[n as usize][u], self.corners[n as usize][v]);
        // Twice the area of a triangle in that plane, above 0 if it turns as the polygon does.
        let area = |a: u32, b: u32, c: u32| {
            let (a, b, c) = (flat(a), flat(b), flat(c));
            flip * ((b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0))
        };
        let left = &mut self.left;
        left.clear();
        left.extend(0..self.corners.len() as u32);
        while left.len() > 3 {
            let count = left.len();
            let around = |at: usize| (left[(at + count - 1) % count], left[at], left[(at + 1) % count]);
            let is_ear = |&at: &usize| {
                let (a, b, c) = around(at);
                let holds = |p: u32| {
                    let apart = [a, b, c].iter().all(|&corner| flat(corner) != flat(p));
                    apart && area(a, b, p) >= 0.0 && area(b, c, p) >= 0.0 && area(c, a, p) >= 0.0
                };
                area(a, b, c) > 0.0 && !left.iter().any(|&p| holds(p))
            };
            // A polygon that crosses itself may have no ear; then any corner is cut off.
            // From the second corner on, so that a convex polygon becomes the usual fan around its first.
            let at = (1..count).chain([0]).find(is_ear).unwrap_or(1);
            let (a, b, c) = around(at);
            out.push([a, b, c].map(|n| self.corners[n as usize]));
            left.remove(at);
        }
        out.push([0, 1, 2].map(|n| self.corners[left[n] as usize]));
        Ok(())
    }

    /// Newell's normal.
    fn normal(&self) -> [f64; 3] {
        let mut normal = [0.0; 3];
        let next = self.corners.iter().cycle().skip(1);
        for (a, b) in self.corners.iter().zip(next) {
            for (axis, sum) in normal.iter_mut().enumerate() {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                *sum += (a[u] - b[u]) * (a[v] + b[v]);
            }
        }
        normal
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(corners: &[[f64; 3]]) -> Vec<Triangle> {
        let mut polygon = Polygon::default();
        corners.iter().for_each(|&corner| polygon.push(corner));
        let mut out = Vec::new();
        polygon.triangles(&mut out).unwrap();
        out
    }

    fn area(t: &Triangle) -> f64 {
        let (p, q) = ([0, 1, 2].map(|k| t[1][k] - t[0][k]), [0, 1, 2].map(|k| t[2][k] - t[0][k]));
        let n = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
        n.iter().map(|v| v * v).sum::<f64>().sqrt() / 2.0
    }

    #[test]
    fn a_concave_polygon_is_covered_once_in_any_plane_and_winding() {
        // An L of area 3.
        let outline = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)];
        for axis in 0..3 {
            for turned in [false, true] {
                for start in 0..6 {
                    let mut corners: Vec<[f64; 3]> = (0..6)
                        .map(|n| outline[(n + start) % 6])
                        .map(|(a, b)| match axis {
                            0 => [5.0, a, b],
                            1 => [a, -7.0, b],
                            _ => [a, b, 9.0],
                        })
                        .collect();
                    if turned {
                        corners.reverse();
                    }
                    let triangles = cut(&corners);
                    assert_eq!(triangles.len(), 4);
                    let total: f64 = triangles.iter().map(area).sum();
                    assert!((total - 3.0).abs() < 1e-12, "{triangles:?}");
                }
            }
        }
    }

    #[test]
    fn too_few_corners_and_too_many_are_refused_and_crossing_outlines_are_not() {
        let mut out = Vec::new();
        let mut polygon = Polygon::default();
        polygon.push([0.0; 3]);
        assert!(polygon.triangles(&mut out).unwrap_err().contains("1 corners"));
        (0..10_000).for_each(|n| polygon.push([f64::from(n), 0.0, 0.0]));
        assert!(polygon.triangles(&mut out).unwrap_err().contains("more than 4096"));
        assert_eq!(cut(&[[0.0; 3], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).len(), 2);
        assert_eq!(cut(&[[f64::NAN; 3]; 7]).len(), 5);
    }
}
