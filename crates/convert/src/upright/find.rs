//! Search for the floor, and with it for gravity, in a sample of surfaces.
//!
//! In: places of a sample, with normals where they are known. Out: the direction that points up, and how sure it is.
//! Places without a normal take that of a plane through their cell. Directions in which many normals point are
//! candidates. For each, layers are measured: the area of the cells that surfaces of this normal cover at one height. The
//! floor of a storey lies in one layer, its walls in many; so the root of the sum of their squares decides, and the
//! second best candidate says how surely. What stands on the floor says which side is up. All sums run in an order that the
//! places decide, so the result does not depend on the order of the input.

use std::collections::{BTreeMap, BTreeSet};

type Vec3 = [f64; 3];

/// Part of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    pub at: Vec3,
    /// Unit normal, of either sign.
    pub normal: Option<[f32; 3]>,
}

impl Patch {
    /// Returns numbers by which patches have an order of their own.
    pub fn key(&self) -> [u64; 6] {
        let [x, y, z] = self.at.map(f64::to_bits);
        let [a, b, c] = self.normal.unwrap_or_default().map(|v| u64::from(v.to_bits()));
        [x, y, z, a, b, c]
    }

    /// Returns whether a surface lies across `axis`; `None` if unknown.
    fn is_across(&self, axis: Vec3) -> Option<bool> {
        Some(dot(self.normal?.map(f64::from), axis).abs() > COS_ALONG)
    }

    /// Returns whether a surface may lie across `axis`: two sheets in one cell have no plane, and a wall that is cut
    /// across covers few cells.
    fn may_be_across(&self, axis: Vec3) -> bool {
        self.is_across(axis).unwrap_or(true)
    }
}

/// Direction that points up, and its evidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UpFound {
    /// Unit vector in the input's axes (after `--units` and the axes that a format fixes).
    pub up: Vec3,
    /// Certainty from 0 to 1: how much smaller the second best candidate is, for the axis or for its sign.
    pub sure: f64,
    /// Area of the floor (m²), from a sample: a lower bound.
    pub floor_m2: f64,
    /// Area of the largest layer of any other direction (m²), likewise.
    pub next_m2: f64,
}

impl UpFound {
    /// Names of the six axes.
    const AXES: [(&str, Vec3); 6] = [
        ("x", [1.0, 0.0, 0.0]),
        ("y", [0.0, 1.0, 0.0]),
        ("z", [0.0, 0.0, 1.0]),
        ("-x", [-1.0, 0.0, 0.0]),
        ("-y", [0.0, -1.0, 0.0]),
        ("-z", [0.0, 0.0, -1.0]),
    ];
    /// Certainty below which the direction is refused.
    pub const LEAST_SURE: f64 = 0.2;

    /// Returns the name of the nearest axis of the input, and the angle to it (degrees).
    pub fn axis(&self) -> (&'static str, f64) {
        let nearest = Self::AXES.iter().max_by(|a, b| dot(a.1, self.up).total_cmp(&dot(b.1, self.up)));
        let &(name, axis) = nearest.unwrap_or(&Self::AXES[2]);
        let across = cross(axis, self.up);
        (name, libm::atan2(length(across), dot(axis, self.up)).to_degrees())
    }
}

/// Least number of patches.
const LEAST_PATCHES: usize = 200;
/// Cells along the longest side of the bulk for layers.
const CELLS: f64 = 64.0;
/// Layers along the longest side of the bulk.
const LAYERS: f64 = 160.0;
/// Cosines of 10°, 25° and 70°.
const COS_NEAR: f64 = 0.984_807_753;
const COS_ALONG: f64 = 0.906_307_787;
const COS_APART: f64 = 0.939_692_621;
/// Most candidates.
const MOST_CANDIDATES: usize = 8;
/// Most normals that are tried as centres of candidates.
const MOST_SEEDS: usize = 256;
/// Certainty of the sign below which it says nothing against z, and from which on it outweighs z.
const WEAK: f64 = 0.5;
const STRONG: f64 = 0.8;
/// Directions nearer than this to an axis of the input take the axis (sine of 1.5°): floors are not that exact.
const SNAP: f64 = 0.026_176_948;

/// Finds the direction that points up. Fails with a reason if there is none, or if it is not sure. `z_is_likely` lets z
/// decide between a direction and its opposite, where nothing else does.
pub fn find(mut patches: Vec<Patch>, z_is_likely: bool) -> Result<UpFound, String> {
    patches.sort_unstable_by_key(Patch::key);
    let bulk = Bulk::of(&patches).ok_or("too few places to find a floor")?;
    patches.retain(|patch| bulk.holds(patch.at));
    if patches.len() < LEAST_PATCHES {
        return Err("too few places to find a floor".into());
    }
    let facets = with_normals(&mut patches, bulk.extent);
    let mut found: Vec<Layers> =
        candidates(facets).into_iter().filter_map(|axis| Layers::refined(axis, &patches, &bulk)).collect();
    found.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let Some(best) = found.first() else { return Err("no flat surface is large enough to be a floor".into()) };
    let next = found.iter().find(|other| dot(other.axis, best.axis).abs() < COS_APART);
    let next_m2 = next.map_or(0.0, Layers::area);
    let of_axis = 1.0 - next.map_or(0.0, Layers::score) / best.score();
    let (sign, of_sign) = best.side(&patches);
    // Scanners stand upright, so only strong evidence turns a scan upside down.
    let z_sign = best.axis[2].signum();
    let (sign, of_sign) = match z_is_likely && best.axis[2].abs() > COS_ALONG {
        true if sign == z_sign || of_sign < WEAK => (z_sign, of_axis),
        true if of_sign < STRONG => (sign, 0.0),
        _ => (sign, of_sign),
    };
    let up = snapped(best.axis.map(|v| v * sign));
    let result = UpFound { up, sure: of_axis.min(of_sign), floor_m2: best.area(), next_m2 };
    let (axis, _) = result.axis();
    if of_axis < UpFound::LEAST_SURE {
        return Err(format!(
            "two surfaces could be the floor: {:.1} m² across the axis {axis}, and {next_m2:.1} m² elsewhere",
            best.area()
        ));
    }
    if of_sign < UpFound::LEAST_SURE {
        let bare = axis.trim_start_matches('-');
        return Err(format!("floor and ceiling look alike: up is {bare} or -{bare}"));
    }
    Ok(result)
}

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

fn unit(a: Vec3) -> Option<Vec3> {
    let length = length(a);
    (length > 1e-12).then(|| a.map(|v| v / length))
}

fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [0, 1, 2].map(|axis| a[axis] - b[axis])
}

/// Takes an axis of the input if it is near enough.
fn snapped(up: Vec3) -> Vec3 {
    let near = UpFound::AXES.iter().find(|(_, axis)| dot(*axis, up) > 0.0 && length(cross(*axis, up)) < SNAP);
    near.map_or(up, |(_, axis)| *axis)
}

/// The box that holds most places.
pub struct Bulk {
    min: Vec3,
    max: Vec3,
    /// Longest side (m).
    pub extent: f64,
}

impl Bulk {
    pub fn of(patches: &[Patch]) -> Option<Self> {
        if patches.len() < LEAST_PATCHES {
            return None;
        }
        let ends = [0, 1, 2].map(|axis| {
            let mut values: Vec<f64> = patches.iter().map(|patch| patch.at[axis]).collect();
            values.sort_by(f64::total_cmp);
            let cut = values.len() / 50;
            (values[cut], values[values.len() - 1 - cut])
        });
        let extent = ends.iter().map(|end| end.1 - end.0).fold(0.0, f64::max);
        // Space a little outside may be a floor that few places show.
        let margin = 0.1 * extent;
        let (min, max) = (ends.map(|end| end.0 - margin), ends.map(|end| end.1 + margin));
        (extent > 1e-9 && extent.is_finite()).then_some(Self { min, max, extent })
    }

    fn holds(&self, at: Vec3) -> bool {
        (0..3).all(|axis| self.min[axis] <= at[axis] && at[axis] <= self.max[axis])
    }
}

/// Gives a normal to patches without one, from a plane through their cell. Returns all normals with weights.
fn with_normals(patches: &mut [Patch], extent: f64) -> Vec<(Vec3, f64)> {
    // The sample is even, so every place stands for the same area.
    let own = patches.iter().filter_map(|patch| Some((patch.normal?.map(f64::from), 1.0)));
    let mut facets: Vec<(Vec3, f64)> = own.collect();
    let bare: Vec<usize> = (0..patches.len()).filter(|&number| patches[number].normal.is_none()).collect();
    let mut found = Vec::new();
    // The finest cells in which enough places are flat.
    for cells in [128.0, 64.0, 32.0, 16.0] {
        let edge = extent / cells;
        let mut of_cell = BTreeMap::<[i64; 3], Vec<usize>>::new();
        for &number in &bare {
            let cell = patches[number].at.map(|v| (v / edge).floor() as i64);
            of_cell.entry(cell).or_default().push(number);
        }
        found = of_cell
            .into_values()
            .filter_map(|own| {
                let places: Vec<Vec3> = own.iter().map(|&number| patches[number].at).collect();
                Some((plane_through(&places)?, own))
            })
            .collect();
        if 3 * found.iter().map(|(_, own)| own.len()).sum::<usize>() >= bare.len() {
            break;
        }
    }
    for (normal, own) in found {
        own.iter().for_each(|&number| patches[number].normal = Some(normal.map(|v| v as f32)));
        facets.push((normal, own.len() as f64));
    }
    facets
}

/// Returns the normal of the plane through some places, if they are flat and neither few nor in a line.
fn plane_through(places: &[Vec3]) -> Option<Vec3> {
    const LEAST: usize = 8;
    if places.len() < LEAST {
        return None;
    }
    let (_, [low, middle, high], normal) = spread(places.iter().copied())?;
    (low <= 0.02 * middle && middle >= 0.04 * high).then_some(normal)
}

/// Returns the centre, the variances in ascending order, and the direction of the least.
fn spread(places: impl Iterator<Item = Vec3> + Clone) -> Option<(Vec3, Vec3, Vec3)> {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for at in places.clone() {
        (0..3).for_each(|axis| sum[axis] += at[axis]);
        count += 1.0;
    }
    if count < 3.0 {
        return None;
    }
    let centre = sum.map(|v| v / count);
    let mut m = [[0.0; 3]; 3];
    for at in places {
        let d = sub(at, centre);
        (0..3).for_each(|a| (0..3).for_each(|b| m[a][b] += d[a] * d[b] / count));
    }
    let (values, vectors) = eigen(m);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let least = order[0];
    Some((centre, order.map(|k| values[k].max(0.0)), unit([vectors[0][least], vectors[1][least], vectors[2][least]])?))
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, by Jacobi's rotations.
fn eigen(mut m: [[f64; 3]; 3]) -> (Vec3, [[f64; 3]; 3]) {
    let mut vectors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..24 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if m[p][q] == 0.0 {
                continue;
            }
            let theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
            let t = 1.0f64.copysign(theta) / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            let turn = |a: f64, b: f64| (c * a - s * b, s * a + c * b);
            for row in &mut m {
                (row[p], row[q]) = turn(row[p], row[q]);
            }
            let (upper, lower) = (m[p], m[q]);
            for (k, (a, b)) in upper.into_iter().zip(lower).enumerate() {
                (m[p][k], m[q][k]) = turn(a, b);
            }
            for row in &mut vectors {
                (row[p], row[q]) = turn(row[p], row[q]);
            }
        }
    }
    ([m[0][0], m[1][1], m[2][2]], vectors)
}

/// Returns the directions in which most normals point, by weight.
fn candidates(mut facets: Vec<(Vec3, f64)>) -> Vec<Vec3> {
    let mut found = Vec::new();
    while found.len() < MOST_CANDIDATES && !facets.is_empty() {
        let step = facets.len().div_ceil(MOST_SEEDS);
        let weight = |seed: Vec3| -> f64 {
            facets.iter().filter(|(normal, _)| dot(*normal, seed).abs() > COS_NEAR).map(|facet| facet.1).sum()
        };
        let seeds = facets.iter().step_by(step).map(|&(seed, _)| (weight(seed), seed));
        let Some((most, mut axis)) = seeds.reduce(|best, other| if other.0 > best.0 { other } else { best }) else {
            break;
        };
        if most <= 0.0 {
            break;
        }
        for _ in 0..4 {
            let mut sum = [0.0; 3];
            for (normal, weight) in &facets {
                let along = dot(*normal, axis);
                if along.abs() > COS_NEAR {
                    (0..3).for_each(|k| sum[k] += normal[k] * weight * along.signum());
                }
            }
            axis = unit(sum).unwrap_or(axis);
        }
        found.push(axis);
        facets.retain(|(normal, _)| dot(*normal, axis).abs() < COS_NEAR);
    }
    found
}

/// Area of the surfaces across an axis, by height.
struct Layers {
    axis: Vec3,
    /// Directions of the cells, and their edge (m).
    across: Vec3,
    along: Vec3,
    edge: f64,
    /// Height of a layer (m).
    step: f64,
    /// Areas (m²) by number: layer `k` begins at the height `k · step`, and reaches over two steps.
    areas: BTreeMap<i64, f64>,
    largest: i64,
}

impl Layers {
    /// Measures the layers across `axis`, then turns the axis to the plane of the largest one and measures again.
    fn refined(axis: Vec3, patches: &[Patch], bulk: &Bulk) -> Option<Self> {
        let mut layers = Self::of(axis, patches, bulk)?;
        for share in [1.0, 0.5, 0.25] {
            let level = layers.level(patches);
            let half = share * layers.step;
            let within = |patch: &&Patch| {
                patch.is_across(layers.axis) == Some(true) && (dot(patch.at, layers.axis) - level).abs() <= half
            };
            let floor = patches.iter().filter(within).map(|patch| patch.at);
            let Some((_, [low, middle, _], normal)) = spread(floor) else { break };
            let turned = normal.map(|v| v * dot(normal, layers.axis).signum());
            if low > 0.01 * middle || dot(turned, layers.axis) < COS_NEAR {
                break;
            }
            layers = Self::of(turned, patches, bulk)?;
        }
        Some(layers)
    }

    fn of(axis: Vec3, patches: &[Patch], bulk: &Bulk) -> Option<Self> {
        let (edge, step) = (bulk.extent / CELLS, bulk.extent / LAYERS);
        let across = unit(cross(axis, if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] }))?;
        let along = cross(axis, across);
        let mut cells = BTreeSet::new();
        for patch in patches {
            if patch.may_be_across(axis) {
                let cell = |direction: Vec3, edge: f64| (dot(patch.at, direction) / edge).floor() as i64;
                let (k, u, v) = (cell(axis, step), cell(across, edge), cell(along, edge));
                cells.extend([(k - 1, u, v), (k, u, v)]);
            }
        }
        let mut areas = BTreeMap::<i64, f64>::new();
        for (k, _, _) in cells {
            *areas.entry(k).or_default() += edge * edge;
        }
        let largest = areas.iter().reduce(|best, other| if other.1 > best.1 { other } else { best });
        let largest = *largest?.0;
        Some(Self { axis, across, along, edge, step, areas, largest })
    }

    /// Area of the largest layer (m²).
    fn area(&self) -> f64 {
        self.areas.get(&self.largest).copied().unwrap_or(0.0)
    }

    /// Root of the sum of the squares of all areas (m²): storeys add to each other, and many small walls hardly do.
    fn score(&self) -> f64 {
        self.areas.values().map(|area| area * area).sum::<f64>().sqrt()
    }

    /// Median height of the largest layer (m).
    fn level(&self, patches: &[Patch]) -> f64 {
        let (low, high) = (self.largest as f64 * self.step, (self.largest + 2) as f64 * self.step);
        let heights = patches.iter().filter(|patch| patch.may_be_across(self.axis));
        let mut heights: Vec<f64> =
            heights.map(|patch| dot(patch.at, self.axis)).filter(|h| (low..high).contains(h)).collect();
        heights.sort_by(f64::total_cmp);
        heights.get(heights.len() / 2).copied().unwrap_or(0.5 * (low + high))
    }

    /// Returns 1 if the axis points up, −1 if down, and how surely.
    ///
    /// Between two large layers, floor and ceiling, furniture stands on the lower one: more cells hold something in the
    /// lower half alone than in the upper half alone; walls hold something in both. Beside a single layer, everything
    /// stands on it.
    fn side(&self, patches: &[Patch]) -> (f64, f64) {
        const LARGE: f64 = 0.4;
        /// Least distance of floor and ceiling (layers).
        const APART: i64 = 6;
        /// Parts of the room that are compared, from the lower layer to the upper one.
        const LOWER: [f64; 2] = [0.12, 0.45];
        const UPPER: [f64; 2] = [0.55, 0.88];
        let large = |k: i64| self.areas.get(&k).is_some_and(|area| *area >= LARGE * self.area());
        let mut levels: Vec<i64> = Vec::new();
        for &k in self.areas.keys().filter(|k| large(**k)) {
            match levels.last_mut() {
                Some(last) if k - *last < APART => {
                    if self.areas[&k] > self.areas[last] {
                        *last = k;
                    }
                }
                _ => levels.push(k),
            }
        }
        let margin = |up: f64, down: f64, least: f64| match up + down > least {
            true => ((up - down).signum(), (up - down).abs() / (up + down)),
            false => (1.0, 0.0),
        };
        // Both layers of a number begin at its height.
        let levels: Vec<f64> = levels.iter().map(|k| (*k + 1) as f64 * self.step).collect();
        if levels.len() < 2 {
            let level = self.level(patches);
            let (mut above, mut below) = (0.0, 0.0);
            for patch in patches {
                let height = dot(patch.at, self.axis) - level;
                if height > 2.0 * self.step {
                    above += 1.0;
                } else if height < -2.0 * self.step {
                    below += 1.0;
                }
            }
            return margin(above, below, 0.01 * patches.len() as f64);
        }
        // By storey and cell: whether its lower and its upper part hold something.
        let mut cells = BTreeMap::<(usize, i64, i64), [bool; 2]>::new();
        for patch in patches {
            let height = dot(patch.at, self.axis);
            let storey = levels.partition_point(|level| *level <= height);
            if storey == 0 || storey == levels.len() {
                continue;
            }
            let share = (height - levels[storey - 1]) / (levels[storey] - levels[storey - 1]);
            let within = |[from, to]: [f64; 2]| from <= share && share < to;
            let cell = |direction: Vec3| (dot(patch.at, direction) / self.edge).floor() as i64;
            if within(LOWER) || within(UPPER) {
                cells.entry((storey, cell(self.across), cell(self.along))).or_default()[usize::from(within(UPPER))] =
                    true;
            }
        }
        let count = |held: [bool; 2]| cells.values().filter(|own| **own == held).count() as f64;
        let floor = self.area() / (self.edge * self.edge);
        margin(count([true, false]), count([false, true]), 0.01 * floor)
    }
}
