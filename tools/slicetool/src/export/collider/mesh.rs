//! Collapse of edges, cheapest first by squared distances to planes (Garland and Heckbert, 1997), while the surface stays
//! in its shell, closed, and on the same side of all solid.

use super::shell::{Point, Shell, Tally};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap, HashSet};

type Lattice = [i64; 3];

/// Least cosine between the normals of a triangle before and after a collapse.
const LEAST_COSINE: f64 = 0.0;
/// Least height of a triangle (steps of a cell).
const LEAST_HEIGHT: f64 = 0.02;
/// Most passes over edges that could not be collapsed at first.
const PASSES: usize = 4;

/// Sum of squared distances to planes, weighted by area: the upper half of a symmetric 4 × 4 matrix.
#[derive(Clone, Copy, Default)]
struct Quadric([f64; 10]);

impl Quadric {
    fn of_plane(normal: Point, through: Point, weight: f64) -> Self {
        let [a, b, c] = normal;
        let d = -(a * through[0] + b * through[1] + c * through[2]);
        Self([a * a, a * b, a * c, a * d, b * b, b * c, b * d, c * c, c * d, d * d].map(|v| v * weight))
    }

    fn plus(&self, other: &Self) -> Self {
        let mut sum = *self;
        sum.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a += b);
        sum
    }

    fn at(&self, [x, y, z]: Point) -> f64 {
        let [aa, ab, ac, ad, bb, bc, bd, cc, cd, dd] = self.0;
        (aa * x * x + bb * y * y + cc * z * z + dd)
            + 2.0 * (ab * x * y + ac * x * z + bc * y * z + ad * x + bd * y + cd * z)
    }

    /// The place of the least value, if it is well defined.
    fn least(&self) -> Option<Point> {
        let [aa, ab, ac, ad, bb, bc, bd, cc, cd, _] = self.0;
        let determinant = aa * (bb * cc - bc * bc) - ab * (ab * cc - bc * ac) + ac * (ab * bc - bb * ac);
        let size = aa + bb + cc;
        let is_defined = determinant.abs() > 1e-4 * size * size * size;
        if !is_defined {
            return None;
        }
        let [x, y, z] = [-ad, -bd, -cd];
        Some([
            (x * (bb * cc - bc * bc) - ab * (y * cc - bc * z) + ac * (y * bc - bb * z)) / determinant,
            (aa * (y * cc - z * bc) - x * (ab * cc - bc * ac) + ac * (ab * z - y * ac)) / determinant,
            (aa * (bb * z - bc * y) - ab * (ab * z - y * ac) + x * (ab * bc - bb * ac)) / determinant,
        ])
    }
}

/// An edge that waits for its collapse.
struct Candidate {
    cost: f64,
    ends: [u32; 2],
    versions: [u32; 2],
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then_with(|| other.ends.cmp(&self.ends))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}

/// A closed surface, each edge of which has two triangles.
pub struct Mesh<'a> {
    shell: &'a Shell,
    tally: Tally,
    /// Metres in a step and in a unit.
    scale: Point,
    places: Vec<Lattice>,
    taken: HashSet<Lattice>,
    quadrics: Vec<Quadric>,
    versions: Vec<u32>,
    fans: Vec<Vec<u32>>,
    triangles: Vec<[u32; 3]>,
    is_gone: Vec<bool>,
}

impl<'a> Mesh<'a> {
    /// Begins with corners in steps and units; `None` if the surface leaves its shell, or an edge has more than two
    /// triangles.
    pub fn new(shell: &'a Shell, scale: Point, places: Vec<Lattice>, triangles: Vec<[u32; 3]>) -> Option<Self> {
        let mut edges: HashMap<[u32; 2], i32> = HashMap::with_capacity(3 * triangles.len());
        let mut fans = vec![Vec::new(); places.len()];
        for (number, triangle) in (0..).zip(&triangles) {
            for side in 0..3 {
                *edges.entry([triangle[side], triangle[(side + 1) % 3]]).or_default() += 1;
                fans[triangle[side] as usize].push(number);
            }
        }
        if edges.iter().any(|([from, to], count)| *count != 1 || !edges.contains_key(&[*to, *from])) {
            return None;
        }
        drop(edges);
        let count = places.len();
        let mut mesh = Self {
            shell,
            tally: Tally::new(shell),
            scale,
            taken: places.iter().copied().collect(),
            quadrics: vec![Quadric::default(); count],
            versions: vec![0; count],
            fans,
            is_gone: vec![false; triangles.len()],
            places,
            triangles,
        };
        for number in 0..mesh.triangles.len() {
            let triangle = mesh.triangles[number];
            if !mesh.shell.holds(&triangle.map(|at| float(mesh.places[at as usize]))) {
                return None;
            }
            let normal = mesh.normal(triangle.map(|at| mesh.places[at as usize]));
            let twice_area = length(normal);
            let quadric = Quadric::of_plane(normal.map(|v| v / twice_area), mesh.metres(triangle[0]), twice_area);
            for at in triangle {
                mesh.quadrics[at as usize] = mesh.quadrics[at as usize].plus(&quadric);
            }
        }
        Some(mesh)
    }

    fn metres(&self, at: u32) -> Point {
        let place = self.places[at as usize];
        [0, 1, 2].map(|axis| place[axis] as f64 * self.scale[axis])
    }

    /// Normal of a triangle, as long as twice its area (m²).
    fn normal(&self, [a, b, c]: [Lattice; 3]) -> Point {
        let side = |to: Lattice| [0, 1, 2].map(|axis| (to[axis] - a[axis]) as f64 * self.scale[axis]);
        cross(side(b), side(c))
    }

    /// Collapses edges as long as any can be. Fails once a signal asks to stop.
    pub fn simplify(&mut self) -> slicewalk::Result<()> {
        for _ in 0..PASSES {
            let mut open = BinaryHeap::new();
            for number in 0..self.triangles.len() {
                if !self.is_gone[number] {
                    let triangle = self.triangles[number];
                    for side in 0..3 {
                        let ends = [triangle[side], triangle[(side + 1) % 3]];
                        if ends[0] < ends[1] {
                            open.push(self.candidate(ends));
                        }
                    }
                }
            }
            let mut collapsed = 0usize;
            let edges = open.len();
            while let Some(Candidate { ends, versions, .. }) = open.pop() {
                crate::go_on()?;
                let is_current = [0, 1].iter().all(|&n| self.versions[ends[n] as usize] == versions[n]);
                if !is_current || !self.collapse(ends) {
                    continue;
                }
                collapsed += 1;
                for to in self.neighbours(ends[0]) {
                    open.push(self.candidate([ends[0].min(to), ends[0].max(to)]));
                }
            }
            if collapsed * 100 <= edges {
                break;
            }
        }
        Ok(())
    }

    fn candidate(&self, ends: [u32; 2]) -> Candidate {
        let quadric = self.quadrics[ends[0] as usize].plus(&self.quadrics[ends[1] as usize]);
        let cost = self.targets(ends, &quadric).first().map_or(f64::INFINITY, |target| target.0);
        // Among edges of equal cost, as on a plane, short ones first.
        let [a, b] = ends.map(|at| self.metres(at));
        let across = [0, 1, 2].map(|axis| a[axis] - b[axis]);
        let cost = cost.max(0.0) + 1e-6 * dot(across, across) * dot(across, across);
        Candidate { cost, ends, versions: ends.map(|at| self.versions[at as usize]) }
    }

    /// Returns places for the corner that replaces an edge, best first.
    fn targets(&self, ends: [u32; 2], quadric: &Quadric) -> Vec<(f64, Lattice)> {
        let [a, b] = ends.map(|at| self.places[at as usize]);
        let mut places = vec![a, b, [0, 1, 2].map(|axis| (a[axis] + b[axis]).div_euclid(2))];
        if let Some(best) = quadric.least() {
            let place = [0, 1, 2].map(|axis| (best[axis] / self.scale[axis]).round());
            let [low, high] = [f64::min, f64::max].map(|f| [0, 1, 2].map(|axis| f(a[axis] as f64, b[axis] as f64)));
            let room = 2.0 * (0..3).map(|axis| (high[axis] - low[axis]) * self.scale[axis]).fold(0.0, f64::max);
            let is_near = (0..3).all(|axis| {
                let room = room / self.scale[axis];
                place[axis] >= low[axis] - room && place[axis] <= high[axis] + room
            });
            if is_near {
                places.push(place.map(|v| v as i64));
            }
        }
        let value = |place: Lattice| quadric.at([0, 1, 2].map(|axis| place[axis] as f64 * self.scale[axis]));
        let mut targets: Vec<_> = places.into_iter().map(|place| (value(place), place)).collect();
        targets.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
        targets.dedup_by_key(|target| target.1);
        targets
    }

    /// Returns the corners around a corner, ascending.
    fn neighbours(&self, at: u32) -> Vec<u32> {
        let corners = self.fans[at as usize].iter().flat_map(|triangle| self.triangles[*triangle as usize]);
        let mut corners: Vec<u32> = corners.filter(|corner| *corner != at).collect();
        corners.sort_unstable();
        corners.dedup();
        corners
    }

    /// Replaces an edge by its first end at the best place that keeps all conditions; false if no place does.
    fn collapse(&mut self, [kept, lost]: [u32; 2]) -> bool {
        let others = self.neighbours(lost);
        let common: Vec<u32> =
            self.neighbours(kept).into_iter().filter(|at| others.binary_search(at).is_ok()).collect();
        let [left, right] = common[..] else { return false };
        // The last four triangles stay.
        let is_corner_of = |fan: &[u32], ends: [u32; 2]| {
            fan.iter().any(|triangle| ends.iter().all(|end| self.triangles[*triangle as usize].contains(end)))
        };
        if is_corner_of(&self.fans[lost as usize], [left, right])
            && is_corner_of(&self.fans[kept as usize], [left, right])
        {
            return false;
        }
        let quadric = self.quadrics[kept as usize].plus(&self.quadrics[lost as usize]);
        let found =
            self.targets([kept, lost], &quadric).into_iter().find(|(_, place)| self.can_move([kept, lost], *place));
        let Some((_, place)) = found else { return false };
        self.taken.remove(&self.places[kept as usize]);
        self.taken.remove(&self.places[lost as usize]);
        self.taken.insert(place);
        self.places[kept as usize] = place;
        self.quadrics[kept as usize] = quadric;
        self.versions[kept as usize] += 1;
        self.versions[lost as usize] += 1;
        for triangle in std::mem::take(&mut self.fans[lost as usize]) {
            let corners = &mut self.triangles[triangle as usize];
            if corners.contains(&kept) {
                self.is_gone[triangle as usize] = true;
                for at in *corners {
                    self.fans[at as usize].retain(|other| *other != triangle);
                }
            } else {
                corners.iter_mut().filter(|at| **at == lost).for_each(|at| *at = kept);
                self.fans[kept as usize].push(triangle);
            }
        }
        true
    }

    /// Returns whether both ends of an edge can move to `place`.
    fn can_move(&mut self, ends: [u32; 2], place: Lattice) -> bool {
        if ends.iter().all(|end| self.places[*end as usize] != place) && self.taken.contains(&place) {
            return false;
        }
        let mut changed: Vec<([Lattice; 3], Option<[Lattice; 3]>)> = Vec::new();
        for (number, end) in ends.iter().enumerate() {
            for triangle in &self.fans[*end as usize] {
                let corners = self.triangles[*triangle as usize];
                let is_lost = corners.contains(&ends[1 - number]);
                if is_lost && number == 1 {
                    continue;
                }
                let old = corners.map(|at| self.places[at as usize]);
                let new = corners.map(|at| if at == *end { place } else { self.places[at as usize] });
                if is_lost || old != new {
                    changed.push((old, (!is_lost).then_some(new)));
                }
            }
        }
        for (old, new) in &changed {
            if let Some(new) = new {
                let (before, after) = (self.normal(*old), self.normal(*new));
                let longest = (0..3)
                    .map(|side| {
                        let (a, b) = (new[side], new[(side + 1) % 3]);
                        length([0, 1, 2].map(|axis| (a[axis] - b[axis]) as f64 * self.scale[axis]))
                    })
                    .fold(0.0, f64::max);
                let is_flat = length(after) < LEAST_HEIGHT * longest * self.scale[0];
                if is_flat || dot(before, after) <= LEAST_COSINE * length(before) * length(after) {
                    return false;
                }
            }
        }
        if !changed.iter().all(|(_, new)| new.is_none_or(|new| self.shell.holds(&new.map(float)))) {
            return false;
        }
        let mut is_inside = true;
        for (old, new) in &changed {
            is_inside &= self.shell.tally(&old.map(float), -1, &mut self.tally);
            if let Some(new) = new {
                is_inside &= self.shell.tally(&new.map(float), 1, &mut self.tally);
            }
        }
        self.tally.is_balanced() && is_inside
    }

    /// Returns corners, in steps and units, and triangles.
    pub fn finish(self) -> (Vec<Lattice>, Vec<[u32; 3]>) {
        let mut numbers = vec![u32::MAX; self.places.len()];
        let (mut places, mut triangles) = (Vec::new(), Vec::new());
        for (triangle, _) in self.triangles.iter().zip(&self.is_gone).filter(|(_, is_gone)| !**is_gone) {
            triangles.push(triangle.map(|at| {
                let number = &mut numbers[at as usize];
                if *number == u32::MAX {
                    *number = places.len() as u32;
                    places.push(self.places[at as usize]);
                }
                *number
            }));
        }
        (places, triangles)
    }
}

/// A place of the lattice in floats, exactly.
fn float(place: Lattice) -> Point {
    place.map(|v| v as f64)
}

fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(a: Point) -> f64 {
    dot(a, a).sqrt()
}
