//! Room for the surface: around the solid of a tile and within reach of it, as intervals of height per cell.

use super::grid::{Grid, STEPS};

/// From bottom to top, in units of height above the base of the tile.
pub type Interval = [i64; 2];
/// A corner of the surface: steps of a cell along x and y, units along z.
pub type Point = [f64; 3];

/// Sorted disjoint intervals per cell.
pub struct Columns {
    pub size: [usize; 2],
    starts: Vec<u32>,
    all: Vec<Interval>,
}

impl Columns {
    pub fn new(size: [usize; 2], mut column: impl FnMut(usize, usize, &mut Vec<Interval>)) -> Self {
        let (mut starts, mut all, mut own) = (vec![0], Vec::new(), Vec::new());
        for y in 0..size[1] {
            for x in 0..size[0] {
                own.clear();
                column(x, y, &mut own);
                join(&mut own);
                all.extend_from_slice(&own);
                starts.push(all.len() as u32);
            }
        }
        Self { size, starts, all }
    }

    pub fn at(&self, x: usize, y: usize) -> &[Interval] {
        let cell = y * self.size[0] + x;
        &self.all[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// Number of the first interval of a cell among those of all cells.
    fn first(&self, x: usize, y: usize) -> usize {
        self.starts[y * self.size[0] + x] as usize
    }
}

/// Sorts intervals and joins those that meet.
pub fn join(intervals: &mut Vec<Interval>) {
    intervals.sort_unstable();
    intervals.dedup_by(|above, below| {
        let meets = above[0] <= below[1];
        if meets {
            below[1] = below[1].max(above[1]);
        }
        meets
    });
}

/// Places within reach of solid, per cell: each is at most the reach from some solid, wherever in its cell it lies.
pub fn within_reach(solid: &Columns, grid: &Grid) -> Columns {
    let cells = (grid.reach_m / grid.cell_m) as i64;
    let mut offsets = Vec::new();
    for (dx, dy) in (-cells..=cells).flat_map(|dy| (-cells..=cells).map(move |dx| (dx, dy))) {
        // The farthest place in a cell from the nearest place of the other one.
        let across = (dx * dx + dy * dy) as f64 * grid.cell_m * grid.cell_m;
        let left = grid.reach_m * grid.reach_m - across;
        if left >= 0.0 {
            offsets.push((dx, dy, (left.sqrt() / grid.unit_m * (1.0 - 1e-9)) as i64));
        }
    }
    let [width, height] = solid.size.map(|size| size as i64);
    Columns::new(solid.size, |x, y, own| {
        for &(dx, dy, grow) in &offsets {
            let (x, y) = (x as i64 + dx, y as i64 + dy);
            if (0..width).contains(&x) && (0..height).contains(&y) {
                let spans = solid.at(x as usize, y as usize);
                own.extend(spans.iter().map(|[bottom, top]| [bottom - grow, top + grow]));
            }
        }
    })
}

/// Room for the surface: outside of solid, within reach of it.
pub struct Shell {
    /// Solid, with the margin.
    blocked: Columns,
    /// Places within reach, less the margin.
    allowed: Columns,
    /// Heights that are allowed and not blocked.
    free: Columns,
    /// Steps by which cells are widened against solid, so that a surface keeps this distance from solid in other cells.
    margin: f64,
}

impl Shell {
    /// Room outside of `solid` and within `reach`, less `margin` units at each end; solid is widened by `steps`.
    pub fn new(solid: &Columns, reach: &Columns, margin: i64, steps: f64) -> Self {
        let blocked = Columns::new(solid.size, |x, y, own| {
            own.extend(solid.at(x, y).iter().map(|[bottom, top]| [bottom - margin, top + margin]));
        });
        let allowed = Columns::new(solid.size, |x, y, own| {
            own.extend(
                reach.at(x, y).iter().map(|[low, high]| [low + margin, high - margin]).filter(|[low, high]| low < high),
            );
        });
        let free = Columns::new(solid.size, |x, y, own| {
            let mut spans = blocked.at(x, y).iter().peekable();
            for [low, high] in allowed.at(x, y) {
                let mut from = *low;
                while let Some([bottom, top]) = spans.next_if(|span| span[0] < *high) {
                    if from < *bottom {
                        own.push([from, *bottom]);
                    }
                    from = *top;
                }
                if from < *high {
                    own.push([from, *high]);
                }
            }
        });
        Self { blocked, allowed, free, margin: steps }
    }

    /// Number of free intervals in all cells.
    pub fn len(&self) -> usize {
        self.free.all.len()
    }

    /// Returns whether every part of the triangle lies outside of solid and within reach.
    pub fn holds(&self, triangle: &[Point; 3]) -> bool {
        let (least, greatest) = bounds(triangle);
        let edge = |axis: &usize| least[*axis] == greatest[*axis] && least[*axis] % STEPS as f64 == 0.0;
        let Some(axis) = (0..2).find(edge) else { return self.scan(triangle, true) };
        // Where cells meet, it is enough to be within reach in one of them.
        let moved =
            |by: f64| triangle.map(|corner| [0, 1, 2].map(|a| if a == axis { corner[a] + by } else { corner[a] }));
        self.scan(triangle, false) && [-1e-3, 1e-3].iter().any(|by| self.scan(&moved(*by), true))
    }

    /// Returns whether the triangle lies outside of solid and, if asked for, within reach.
    fn scan(&self, triangle: &[Point; 3], is_bounded: bool) -> bool {
        let [width, height] = self.free.size.map(|size| size as i64);
        let (least, greatest) = bounds(triangle);
        let rows = self.cells(least[1], greatest[1]);
        let columns = self.cells(least[0], greatest[0]);
        if rows.0 < 0 || columns.0 < 0 || rows.1 > height || columns.1 > width {
            return false;
        }
        let plane = Plane::of(triangle);
        for y in rows.0..rows.1 {
            let (low, high) = self.ends(y);
            let row =
                if rows.0 + 1 == rows.1 { Polygon::of(triangle) } else { Polygon::of(triangle).cut(1, low, high) };
            if row.count == 0 {
                continue;
            }
            let (least, greatest) = bounds(row.corners());
            let columns = self.cells(least[0], greatest[0]);
            // Cells inside of the triangle, where its plane gives the heights.
            let inner = plane.as_ref().and_then(|_| Some((chord(triangle, low)?, chord(triangle, high)?)));
            let inner = inner.map(|(a, b)| (a[0][0].max(b[0][0]), a[1][0].min(b[1][0])));
            for x in columns.0..columns.1 {
                let (left, right) = self.ends(x);
                let mut is_inside = true;
                let [bottom, top] = match (&plane, inner) {
                    (Some(plane), Some((from, to))) if from <= left && right <= to => {
                        let (middle, half) =
                            plane.over([(left + right) / 2.0, (low + high) / 2.0], (right - left) / 2.0);
                        [(middle - half).max(least[2]), (middle + half).min(greatest[2])]
                    }
                    _ => {
                        let cell = if columns.0 + 1 == columns.1 { row } else { row.cut(0, left, right) };
                        if cell.count == 0 {
                            continue;
                        }
                        let (least, greatest) = bounds(cell.corners());
                        is_inside = [x, y].iter().zip(0..).all(|(cell, axis)| {
                            greatest[axis] > (cell * STEPS) as f64 && least[axis] < ((cell + 1) * STEPS) as f64
                        });
                        [least[2], greatest[2]]
                    }
                };
                let cell = (x as usize, y as usize);
                let is_blocked = meets(self.blocked.at(cell.0, cell.1), bottom, top);
                if is_blocked || is_bounded && is_inside && !contains(self.allowed.at(cell.0, cell.1), bottom, top) {
                    return false;
                }
            }
        }
        true
    }

    /// Cells, widened by the margin, that an open interval of steps meets.
    fn cells(&self, least: f64, greatest: f64) -> (i64, i64) {
        let steps = STEPS as f64;
        let first = ((least - self.margin) / steps).floor() as i64;
        let end = ((greatest + self.margin) / steps).ceil() as i64;
        (first, end.max(first + 1))
    }

    fn ends(&self, cell: i64) -> (f64, f64) {
        ((cell * STEPS) as f64 - self.margin, ((cell + 1) * STEPS) as f64 + self.margin)
    }

    /// Calls `give` with each cell whose middle the triangle covers in plan, its height there, and 1 if it faces up, -1
    /// if it faces down.
    pub fn middles(&self, triangle: &[Point; 3], mut give: impl FnMut(usize, usize, f64, i32)) {
        let [a, b, c] = triangle;
        let turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if turn == 0.0 {
            return;
        }
        let steps = STEPS as f64;
        let (least, greatest) = bounds(triangle);
        let first = ((least[1] - MIDDLE[1]) / steps).ceil().max(0.0) as usize;
        for y in first..self.free.size[1] {
            let at = y as f64 * steps + MIDDLE[1];
            if at > greatest[1] {
                break;
            }
            let Some([left, right]) = chord(triangle, at) else { continue };
            let first = ((left[0] - MIDDLE[0]) / steps).ceil().max(0.0) as usize;
            for x in first..self.free.size[0] {
                let place = x as f64 * steps + MIDDLE[0];
                if place >= right[0] {
                    break;
                }
                let share = (place - left[0]) / (right[0] - left[0]);
                give(x, y, left[1] + share * (right[1] - left[1]), if turn > 0.0 { 1 } else { -1 });
            }
        }
    }

    /// Adds `sign` for each crossing of a vertical line through the middle of a cell to the tally of the interval in
    /// which it lies; false if it lies in none.
    pub fn tally(&self, triangle: &[Point; 3], sign: i32, tally: &mut Tally) -> bool {
        let mut is_inside = true;
        self.middles(triangle, |x, y, height, up| {
            let free = self.free.at(x, y);
            let at = free.partition_point(|[_, high]| (*high as f64) < height - 1e-6);
            is_inside &= free.get(at).is_some_and(|[low, _]| *low as f64 <= height + 1e-6);
            if at < free.len() {
                tally.add(self.free.first(x, y) + at, sign * up);
            }
        });
        is_inside
    }
}

/// Where vertical lines run in a cell (steps): not through corners or edges between corners of the lattice.
const MIDDLE: [f64; 2] = [4.137_094_219_3, 3.891_730_547_1];

/// Crossings of vertical lines per interval of a shell.
pub struct Tally {
    sums: Vec<i32>,
    touched: Vec<usize>,
}

impl Tally {
    pub fn new(shell: &Shell) -> Self {
        Self { sums: vec![0; shell.len()], touched: Vec::new() }
    }

    fn add(&mut self, at: usize, sign: i32) {
        self.sums[at] += sign;
        self.touched.push(at);
    }

    /// Returns whether all sums are 0, and resets them. If a changed surface crosses each free interval as often as
    /// before, what lies between the intervals is still inside or outside, as it was.
    pub fn is_balanced(&mut self) -> bool {
        let mut is_balanced = true;
        for at in self.touched.drain(..) {
            is_balanced &= self.sums[at] == 0;
            self.sums[at] = 0;
        }
        is_balanced
    }
}

/// Returns whether heights from `bottom` to `top` enter one of the intervals.
fn meets(intervals: &[Interval], bottom: f64, top: f64) -> bool {
    let at = intervals.partition_point(|[_, high]| *high as f64 <= bottom);
    intervals.get(at).is_some_and(|[low, _]| (*low as f64) < top)
}

/// Returns whether one of the intervals contains the heights from `bottom` to `top`.
fn contains(intervals: &[Interval], bottom: f64, top: f64) -> bool {
    let at = intervals.partition_point(|[_, high]| (*high as f64) < top);
    intervals.get(at).is_some_and(|[low, _]| *low as f64 <= bottom)
}

fn bounds(corners: &[Point]) -> (Point, Point) {
    let mut ends = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for corner in corners {
        for (axis, v) in corner.iter().enumerate() {
            ends.0[axis] = ends.0[axis].min(*v);
            ends.1[axis] = ends.1[axis].max(*v);
        }
    }
    ends
}

/// Returns where a triangle begins and ends along x at `y`, each as x and z; `None` outside of it. Both triangles at an
/// edge get the same places.
fn chord(triangle: &[Point; 3], y: f64) -> Option<[[f64; 2]; 2]> {
    let mut found: Option<[[f64; 2]; 2]> = None;
    for side in 0..3 {
        let (a, b) = (triangle[side], triangle[(side + 1) % 3]);
        let (a, b) = if (a[1], a[0], a[2]) <= (b[1], b[0], b[2]) { (a, b) } else { (b, a) };
        if a[1] <= y && y < b[1] {
            let share = (y - a[1]) / (b[1] - a[1]);
            let at = [a[0] + share * (b[0] - a[0]), a[2] + share * (b[2] - a[2])];
            found = Some(match found {
                None => [at, at],
                Some([first, _]) if first[0] <= at[0] => [first, at],
                Some([first, _]) => [at, first],
            });
        }
    }
    found
}

/// The plane of a triangle as heights.
struct Plane {
    through: Point,
    slope: [f64; 2],
}

impl Plane {
    /// `None` if the triangle is steep: rounding of its heights would show.
    fn of([a, b, c]: &[Point; 3]) -> Option<Self> {
        let (p, q) = ([0, 1, 2].map(|axis| b[axis] - a[axis]), [0, 1, 2].map(|axis| c[axis] - a[axis]));
        let turn = p[0] * q[1] - p[1] * q[0];
        let slope = [(p[2] * q[1] - p[1] * q[2]) / turn, (p[0] * q[2] - p[2] * q[0]) / turn];
        (turn.abs() >= 1.0 && slope.iter().all(|slope| slope.abs() < 1e4)).then_some(Self { through: *a, slope })
    }

    /// Returns the height in the middle of a square, and by how much other heights in it differ at most.
    fn over(&self, middle: [f64; 2], half: f64) -> (f64, f64) {
        let [dx, dy] = [0, 1].map(|axis| (middle[axis] - self.through[axis]) * self.slope[axis]);
        (self.through[2] + dx + dy, (self.slope[0].abs() + self.slope[1].abs()) * half)
    }
}

/// A convex polygon, part of a triangle.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [Point; 8],
    count: usize,
}

impl Polygon {
    fn of(triangle: &[Point; 3]) -> Self {
        let mut corners = [[0.0; 3]; 8];
        corners[..3].copy_from_slice(triangle);
        Self { corners, count: 3 }
    }

    fn corners(&self) -> &[Point] {
        &self.corners[..self.count]
    }

    /// Returns the part from `low` to `high` along an axis.
    fn cut(self, axis: usize, low: f64, high: f64) -> Self {
        self.half(axis, low, 1.0).half(axis, high, -1.0)
    }

    fn half(self, axis: usize, limit: f64, sign: f64) -> Self {
        let mut part = Self { corners: [[0.0; 3]; 8], count: 0 };
        let mut push = |corner: Point| {
            if part.count < part.corners.len() {
                part.corners[part.count] = corner;
                part.count += 1;
            }
        };
        let corners = self.corners();
        for (number, corner) in corners.iter().enumerate() {
            let before = &corners[(number + corners.len() - 1) % corners.len()];
            let (from, to) = (sign * (before[axis] - limit), sign * (corner[axis] - limit));
            if (from < 0.0) != (to < 0.0) {
                let share = from / (from - to);
                let mut at = [0, 1, 2].map(|axis| before[axis] + share * (corner[axis] - before[axis]));
                at[axis] = limit;
                push(at);
            }
            if to >= 0.0 {
                push(*corner);
            }
        }
        part
    }
}
