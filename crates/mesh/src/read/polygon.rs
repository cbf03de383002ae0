//! Triangulation of polygons.

use crate::Result;
#[cfg(test)]
use crate::Triangle;

/// Most corners of a polygon, because ear clipping takes quadratic time.
const MOST_CORNERS: usize = 4096;

/// The corners of one face.
#[derive(Debug, Default)]
pub(super) struct Polygon {
    corners: Vec<[f64; 3]>,
    /// Neighbours of each remaining corner.
    before: Vec<u32>,
    after: Vec<u32>,
    verdicts: Vec<Verdict>,
}

/// State of the triangle at a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Verdict {
    /// Not tested since it last changed.
    New,
    /// It turns the wrong way, or has no area.
    Reflex,
    /// It contains this corner, and none with a lower number.
    Holds(u32),
    /// The corner was cut off.
    Gone,
}

impl Polygon {
    pub(super) fn clear(&mut self) {
        self.corners.clear();
    }

    pub(super) fn push(&mut self, corner: [f64; 3]) {
        // One more than the limit is enough to detect the excess.
        if self.corners.len() <= MOST_CORNERS {
            self.corners.push(corner);
        }
    }

    /// Corners of the polygon.
    pub(super) fn corners(&self) -> &[[f64; 3]] {
        &self.corners
    }

    /// Triangulates the polygon, concave or not, by ear clipping in the coordinate plane in which it is largest. Passes
    /// the corner numbers of each triangle to `give`. The inner error reports too few or too many corners; an error of
    /// `check_cancelled`, which is called once per ear, aborts the work.
    ///
    /// An edge that goes out and back and a corner named twice have no area and are cut off first: an ear beside them
    /// might reach to their tip, outside of the polygon.
    ///
    /// Cost: at most three tests per pair of corners, and one more where such corners are. A corner found inside a
    /// triangle keeps that triangle from being an ear until it is cut off itself; the search for another then continues
    /// after it.
    pub(super) fn triangles(
        &mut self,
        mut give: impl FnMut([usize; 3]),
        check_cancelled: &dyn Fn() -> Result<()>,
    ) -> Result<Result<(), String>> {
        let Self { corners, before, after, verdicts } = self;
        let count = corners.len();
        match count {
            0..=2 => return Ok(Err(format!("a face has {count} corners; expected at least 3"))),
            3 => {
                give([0, 1, 2]);
                return Ok(Ok(()));
            }
            _ if count > MOST_CORNERS => return Ok(Err(format!("a face has more than {MOST_CORNERS} corners"))),
            _ => {}
        }
        let plane = Plane::of(corners);
        let last = count as u32 - 1;
        before.clear();
        before.extend((0..=last).map(|n| n.checked_sub(1).unwrap_or(last)));
        after.clear();
        after.extend((0..=last).map(|n| if n == last { 0 } else { n + 1 }));
        verdicts.clear();
        verdicts.resize(count, Verdict::New);
        let (mut first, mut may_have_spikes) = (0u32, true);
        for _ in 3..count {
            check_cancelled()?;
            let around = |at: u32| (before[at as usize], at, after[at as usize]);
            let spike =
                may_have_spikes.then(|| find(first, after, |at| is_spike(corners, &plane, around(at)))).flatten();
            let ear = spike.or_else(|| find(first, after, |at| is_ear(corners, &plane, around(at), verdicts)));
            // A polygon that crosses itself may have no ear; then the second corner is cut off.
            let ear = ear.unwrap_or(after[first as usize]);
            let (a, c) = (before[ear as usize], after[ear as usize]);
            give([a, ear, c].map(|n| n as usize));
            (after[a as usize], before[c as usize]) = (c, a);
            verdicts[ear as usize] = Verdict::Gone;
            (verdicts[a as usize], verdicts[c as usize]) = (Verdict::New, Verdict::New);
            // Only these two have other neighbours than before.
            may_have_spikes = spike.is_some()
                || [a, c].iter().any(|&at| is_spike(corners, &plane, (before[at as usize], at, after[at as usize])));
            if ear == first {
                first = c;
            }
        }
        let second = after[first as usize];
        give([first, second, after[second as usize]].map(|n| n as usize));
        Ok(Ok(()))
    }
}

/// Returns the next corner for which `is_such` holds. Starts behind `first`, so that a convex polygon becomes the usual
/// fan around its first corner.
fn find(first: u32, after: &[u32], mut is_such: impl FnMut(u32) -> bool) -> Option<u32> {
    let mut at = after[first as usize];
    loop {
        if is_such(at) {
            return Some(at);
        }
        if at == first {
            return None;
        }
        at = after[at as usize];
    }
}

/// Returns whether both edges of a corner leave it in one direction, or one of them has no length.
fn is_spike(corners: &[[f64; 3]], plane: &Plane, (a, b, c): (u32, u32, u32)) -> bool {
    let [a, b, c] = [a, b, c].map(|n| plane.flat(&corners[n as usize]));
    plane.area(a, b, c) == 0.0 && (a.0 - b.0) * (c.0 - b.0) + (a.1 - b.1) * (c.1 - b.1) >= 0.0
}

/// Returns whether the triangle of a corner and its neighbours lies inside the polygon and contains no other corner.
fn is_ear(corners: &[[f64; 3]], plane: &Plane, (a, b, c): (u32, u32, u32), verdicts: &mut [Verdict]) -> bool {
    let from = match verdicts[b as usize] {
        Verdict::Reflex | Verdict::Gone => return false,
        Verdict::Holds(one) if verdicts[one as usize] != Verdict::Gone => return false,
        Verdict::Holds(one) => one + 1,
        Verdict::New => 0,
    };
    let at = |n: u32| plane.flat(&corners[n as usize]);
    let (a, flat_b, c) = (at(a), at(b), at(c));
    let area = plane.area(a, flat_b, c);
    if area <= 0.0 || area.is_nan() {
        verdicts[b as usize] = Verdict::Reflex;
        return false;
    }
    let holds = |p: (f64, f64)| {
        [a, flat_b, c].iter().all(|&corner| corner != p)
            && plane.area(a, flat_b, p) >= 0.0
            && plane.area(flat_b, c, p) >= 0.0
            && plane.area(c, a, p) >= 0.0
    };
    let left = (from..corners.len() as u32).filter(|&n| verdicts[n as usize] != Verdict::Gone);
    match left.map(|n| (n, at(n))).find(|&(_, p)| holds(p)) {
        Some((one, _)) => {
            verdicts[b as usize] = Verdict::Holds(one);
            false
        }
        None => true,
    }
}

/// The coordinate plane in which a polygon is largest.
struct Plane {
    axes: (usize, usize),
    /// −1 if the polygon turns the other way round.
    flip: f64,
}

impl Plane {
    fn of(corners: &[[f64; 3]]) -> Self {
        let normal = normal(corners);
        let axis = (0..3).fold(0, |best, axis| if normal[axis].abs() > normal[best].abs() { axis } else { best });
        let flip = if normal[axis] < 0.0 { -1.0 } else { 1.0 };
        Self { axes: ((axis + 1) % 3, (axis + 2) % 3), flip }
    }

    fn flat(&self, corner: &[f64; 3]) -> (f64, f64) {
        (corner[self.axes.0], corner[self.axes.1])
    }

    /// Twice the area of a triangle, positive if it turns like the polygon.
    fn area(&self, a: (f64, f64), b: (f64, f64), c: (f64, f64)) -> f64 {
        self.flip * ((b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0))
    }
}

/// Newell's normal.
fn normal(corners: &[[f64; 3]]) -> [f64; 3] {
    let mut normal = [0.0; 3];
    let next = corners.iter().cycle().skip(1);
    for (a, b) in corners.iter().zip(next) {
        for (axis, sum) in normal.iter_mut().enumerate() {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            *sum += (a[u] - b[u]) * (a[v] + b[v]);
        }
    }
    normal
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(corners: &[[f64; 3]]) -> Vec<Triangle> {
        let mut polygon = Polygon::default();
        corners.iter().for_each(|&corner| polygon.push(corner));
        let mut out = Vec::new();
        polygon.triangles(|numbers| out.push(numbers.map(|n| corners[n])), &|| Ok(())).unwrap().unwrap();
        out
    }

    /// Reference implementation, which tests every corner for every ear.
    fn cut_plainly(corners: &[[f64; 3]]) -> Vec<Triangle> {
        let (plane, mut left, mut out) = (Plane::of(corners), corners.to_vec(), Vec::new());
        while left.len() > 3 {
            let count = left.len();
            let around = |at: usize| [left[(at + count - 1) % count], left[at], left[(at + 1) % count]];
            let is_spike = |&at: &usize| {
                let [a, b, c] = around(at).map(|corner| plane.flat(&corner));
                plane.area(a, b, c) == 0.0 && (a.0 - b.0) * (c.0 - b.0) + (a.1 - b.1) * (c.1 - b.1) >= 0.0
            };
            let is_ear = |&at: &usize| {
                let [a, b, c] = around(at).map(|corner| plane.flat(&corner));
                let holds = |p: (f64, f64)| {
                    [a, b, c].iter().all(|&corner| corner != p)
                        && [(a, b), (b, c), (c, a)].iter().all(|&(u, v)| plane.area(u, v, p) >= 0.0)
                };
                plane.area(a, b, c) > 0.0 && !left.iter().any(|p| holds(plane.flat(p)))
            };
            let order = || (1..count).chain([0]);
            let at = order().find(is_spike).or_else(|| order().find(is_ear)).unwrap_or(1);
            out.push(around(at));
            left.remove(at);
        }
        out.push([left[0], left[1], left[2]]);
        out
    }

    #[test]
    fn ears_are_those_of_a_plain_search_also_of_outlines_that_cross_and_repeat() {
        let mut state = 7u64;
        let mut below = |limit: u64| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) % limit
        };
        for round in 0..3000 {
            let count = 4 + below(if round % 10 == 0 { 60 } else { 9 });
            let star = round % 3 == 0;
            let corners: Vec<[f64; 3]> = (0..count)
                .map(|n| {
                    let turn = n as f64 / count as f64 * std::f64::consts::TAU;
                    let radius = 1.0 + below(9) as f64;
                    match star {
                        true => [turn.cos() * radius, turn.sin() * radius, below(2) as f64],
                        false => [0; 3].map(|_| below(5) as f64),
                    }
                })
                .collect();
            assert_eq!(cut(&corners), cut_plainly(&corners), "{corners:?}");
        }
    }

    #[test]
    fn the_work_for_a_great_face_is_bounded_and_can_be_stopped() {
        // A comb: most triangles contain a corner, and most corners are cut off late.
        let corners: Vec<[f64; 3]> =
            (0..4096).map(|n| [f64::from(n), if n % 2 == 0 { 0.0 } else { f64::from(n % 7) + 1.0 }, 0.0]).collect();
        let mut polygon = Polygon::default();
        corners.iter().for_each(|&corner| polygon.push(corner));
        let (mut out, asked) = (Vec::new(), std::cell::Cell::new(0));
        let stop_late = || {
            asked.set(asked.get() + 1);
            if asked.get() == 1000 { Err(crate::Error::Interrupted) } else { Ok(()) }
        };
        assert!(matches!(polygon.triangles(|numbers| out.push(numbers), &stop_late), Err(crate::Error::Interrupted)));
        assert_eq!(out.len(), 999);
        out.clear();
        polygon.triangles(|numbers| out.push(numbers), &|| Ok(())).unwrap().unwrap();
        assert_eq!(out.len(), 4094);
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

    /// Edges that go out and come back, and corners that are named twice, add nothing to a square.
    #[test]
    fn no_triangle_reaches_to_the_tip_of_a_spike() {
        let square = |tips: &[(f64, f64)], corners: usize| {
            let mut all = vec![(0.0, 2.0), (2.0, 2.0)];
            all.extend(vec![(2.0, 0.0); corners]);
            all.extend(tips.iter().chain(tips.iter().rev().skip(1)));
            all.extend([(2.0, 0.0), (0.0, 0.0)]);
            all.iter().map(|&(x, y)| [x, y, 7.0]).collect::<Vec<_>>()
        };
        for mut corners in [
            square(&[], 1),
            square(&[], 4),
            square(&[(4.0, 0.0)], 1),
            square(&[(4.0, 0.0), (5.0, 3.0)], 1),
            square(&[(-4.0, 1.0), (5.0, 3.0)], 3),
            square(&[(0.5, 0.5)], 1),
        ] {
            for turned in [false, true] {
                for start in 0..corners.len() {
                    corners.rotate_left(1);
                    let triangles = cut(&corners);
                    assert_eq!(triangles.iter().map(area).sum::<f64>(), 4.0, "{turned} {start}: {triangles:?}");
                }
                corners.reverse();
            }
        }
    }

    #[test]
    fn too_few_corners_and_too_many_are_refused_and_crossing_outlines_are_not() {
        let mut polygon = Polygon::default();
        polygon.push([0.0; 3]);
        let wrong = |polygon: &mut Polygon| polygon.triangles(|_| (), &|| Ok(())).unwrap().unwrap_err();
        assert!(wrong(&mut polygon).contains("1 corners"));
        (0..10_000).for_each(|n| polygon.push([f64::from(n), 0.0, 0.0]));
        assert!(wrong(&mut polygon).contains("more than 4096"));
        assert_eq!(cut(&[[0.0; 3], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).len(), 2);
        assert_eq!(cut(&[[f64::NAN; 3]; 7]).len(), 5);
    }
}
