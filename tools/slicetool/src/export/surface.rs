//! The boundary of all occupied space as triangles: binary glTF 2.0.
//!
//! Each span is a box one pixel wide. Tops and bottoms of equal height are joined into rectangles, walls of equal
//! height along their row. Then every edge is cut at all corners on it, so that triangles meet along whole edges: the
//! surface is closed, and each edge is traversed equally often in both directions. Small case: one span of one pixel
//! gives six rectangles, eight corners and twelve triangles. Solid of zero thickness keeps a top and a bottom, back to
//! back.
//!
//! glTF is y-up: (x, y, z) of the archive becomes (x, z, -y). Positions have 32 bits and are relative to a corner of
//! the scene; the node's translation restores the coordinates.

use super::gltf::{self, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, FLOAT, UNSIGNED_INT};
use crate::Failure;
use serde_json::{Value, json};
use slicewalk::archive::{Archive, PageReader};
use slicewalk::frame::{Frame, PAGE_QUANTA, TILE_PIXELS};
use slicewalk_base::output::Output;
use std::collections::{BTreeMap, HashMap};
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::Path;

/// Most spans and rectangles, all held in memory at some hundred bytes each.
const MOST_SPANS: usize = 1 << 23;
const MOST_RECTANGLES: usize = 1 << 23;

/// A point in corners of pixels (x, y) and quanta (z).
pub type Corner = [i64; 3];
/// From bottom to top (quanta).
type Interval = [i64; 2];
pub type Columns = BTreeMap<(i64, i64), Vec<Interval>>;

/// Writes the surface; returns the number of triangles.
pub fn glb(archive: &Archive, path: &Path, to: Output) -> Result<u64, Failure> {
    let too_large = |what: &str, most: usize| {
        Failure::Text(format!("{}: more than {most} {what}; extract a region first", path.display()))
    };
    let columns = columns(archive, path)?.ok_or_else(|| too_large("spans", MOST_SPANS))?;
    let rectangles = rectangles(&columns);
    drop(columns);
    if rectangles.len() > MOST_RECTANGLES {
        return Err(too_large("rectangles", MOST_RECTANGLES));
    }
    let surface = Surface::of(&rectangles);
    drop(rectangles);
    let mut file = BufWriter::new(to);
    surface.write(archive.frame(), &mut file)?;
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    Ok(surface.triangles.len() as u64)
}

/// Returns corners and triangles of the boundary of columns of solid.
pub fn closed(columns: &Columns) -> (Vec<Corner>, Vec<[u32; 3]>) {
    let Surface { corners, triangles } = Surface::of(&rectangles(columns));
    (corners, triangles)
}

/// Solid intervals by pixel, joined where spans or pages touch; `None` if there are too many.
fn columns(archive: &Archive, path: &Path) -> Result<Option<Columns>, Failure> {
    let broken = |error| crate::broken(path, &error);
    let mut columns = Columns::new();
    let (mut pages, mut count) = (PageReader::new(archive), 0);
    for entry in crate::entries(archive, path) {
        let entry = entry?;
        let base = i64::from(entry.key.layer) * PAGE_QUANTA;
        let pixel = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
        for (px, py, spans) in pages.page(&entry).map_err(broken)?.columns() {
            let column = columns.entry((pixel(entry.key.tx, px), pixel(entry.key.ty, py))).or_default();
            column.extend(spans.iter().map(|span| [base + i64::from(span.bottom()), base + i64::from(span.top())]));
            count += spans.len();
        }
        if count > MOST_SPANS {
            return Ok(None);
        }
    }
    for column in columns.values_mut() {
        column.sort_unstable();
        column.dedup_by(|above, below| {
            let meets = above[0] <= below[1];
            if meets {
                below[1] = below[1].max(above[1]);
            }
            meets
        });
    }
    Ok(Some(columns))
}

/// An axis-aligned rectangle: lowest and highest corner, the axis that it faces along, and whether it faces towards
/// greater values.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rectangle {
    least: Corner,
    greatest: Corner,
    axis: usize,
    outward: bool,
}

impl Rectangle {
    /// Corners, anticlockwise as seen from the side that it faces.
    fn corners(&self) -> [Corner; 4] {
        let (u, v) = ((self.axis + 1) % 3, (self.axis + 2) % 3);
        let corner = |at_u: Corner, at_v: Corner| {
            let mut corner = self.least;
            (corner[u], corner[v]) = (at_u[u], at_v[v]);
            corner
        };
        let (a, b) = (self.least, self.greatest);
        let mut ring = [corner(a, a), corner(b, a), corner(b, b), corner(a, b)];
        if !self.outward {
            ring.reverse();
        }
        ring
    }
}

/// Faces of all columns, joined where they continue each other.
fn rectangles(columns: &Columns) -> Vec<Rectangle> {
    let mut faces = Faces::default();
    let none = Vec::new();
    let at = |i: i64, j: i64| columns.get(&(i, j)).unwrap_or(&none);
    for (&(i, j), column) in columns {
        for &[bottom, top] in column {
            faces.levels.push(([top, 1], j, i));
            faces.levels.push(([bottom, 0], j, i));
        }
        // Each side belongs to the column whose solid it bounds.
        for (axis, neighbour, plane, row) in
            [(0, at(i + 1, j), i + 1, j), (0, at(i - 1, j), i, j), (1, at(i, j + 1), j + 1, i), (1, at(i, j - 1), j, i)]
        {
            let outward = plane == if axis == 0 { i + 1 } else { j + 1 };
            let walls = difference(column, neighbour).map(|interval| (axis, plane, outward, interval, row));
            faces.walls.extend(walls);
        }
    }
    let mut rectangles = faces.joined_levels();
    rectangles.extend(faces.joined_walls());
    rectangles
}

/// Returns the parts of the intervals of `column` outside those of `other`; both ascend.
fn difference(column: &[Interval], other: &[Interval]) -> impl Iterator<Item = Interval> {
    column.iter().flat_map(|&[bottom, top]| {
        let mut parts = Vec::new();
        let mut from = bottom;
        for &[low, high] in other.iter().filter(|[low, high]| *low < top && *high > bottom) {
            if low > from {
                parts.push([from, low]);
            }
            from = from.max(high);
        }
        if from < top {
            parts.push([from, top]);
        }
        parts
    })
}

#[derive(Default)]
struct Faces {
    /// Height and side (1: top), row, pixel in the row.
    levels: Vec<([i64; 2], i64, i64)>,
    /// Axis, plane, whether outward, heights, pixel along the wall.
    walls: Vec<(usize, i64, bool, Interval, i64)>,
}

impl Faces {
    /// Joins runs along x with equal ends in consecutive rows into rectangles.
    fn joined_levels(&mut self) -> Vec<Rectangle> {
        self.levels.sort_unstable();
        let mut rectangles: Vec<Rectangle> = Vec::new();
        // Rectangles that end at the previous row, by their ends along x.
        let mut open: HashMap<[i64; 2], usize> = HashMap::new();
        let mut next_open: HashMap<[i64; 2], usize> = HashMap::new();
        let mut rest = &self.levels[..];
        let mut before = None;
        while let Some(&(level, row, _)) = rest.first() {
            let count = rest.iter().take_while(|face| (face.0, face.1) == (level, row)).count();
            let (own, others) = rest.split_at(count);
            rest = others;
            if before != Some((level, row - 1)) {
                open.clear();
            }
            for run in own.chunk_by(|a, b| a.2 + 1 == b.2) {
                let ends = [run[0].2, run[run.len() - 1].2 + 1];
                let number = match open.remove(&ends) {
                    Some(number) => {
                        rectangles[number].greatest[1] = row + 1;
                        number
                    }
                    None => {
                        let (least, greatest) = ([ends[0], row, level[0]], [ends[1], row + 1, level[0]]);
                        rectangles.push(Rectangle { least, greatest, axis: 2, outward: level[1] == 1 });
                        rectangles.len() - 1
                    }
                };
                next_open.insert(ends, number);
            }
            std::mem::swap(&mut open, &mut next_open);
            next_open.clear();
            before = Some((level, row));
        }
        rectangles
    }

    /// Joins consecutive walls of equal height into rectangles.
    fn joined_walls(&mut self) -> Vec<Rectangle> {
        self.walls.sort_unstable();
        let runs = self.walls.chunk_by(|a, b| (a.0, a.1, a.2, a.3, a.4 + 1) == (b.0, b.1, b.2, b.3, b.4));
        let rectangle = |run: &[(usize, i64, bool, Interval, i64)]| {
            let (axis, plane, outward, [low, high], first) = run[0];
            let end = run[run.len() - 1].4 + 1;
            let (least, greatest) = match axis {
                0 => ([plane, first, low], [plane, end, high]),
                _ => ([first, plane, low], [end, plane, high]),
            };
            Rectangle { least, greatest, axis, outward }
        };
        runs.map(rectangle).collect()
    }
}

/// Triangles over shared corners.
struct Surface {
    corners: Vec<Corner>,
    triangles: Vec<[u32; 3]>,
}

/// Triangulates a rectangle with extra corners on its sides into two triangles fewer than corners, none degenerate.
/// Side n holds the corners from corner n of `ring` up to, but without, the next one.
fn triangulate(ring: [Corner; 4], sides: &[Vec<Corner>; 4], mut give: impl FnMut([Corner; 3])) {
    // Goes up the left and the right side, always to the corner nearer to the lower side.
    let left: Vec<Corner> = std::iter::once(ring[0]).chain(sides[3].iter().rev().copied()).collect();
    let right: Vec<Corner> = sides[1].iter().copied().chain([ring[2]]).collect();
    let height = |corner: &Corner, from: &Corner| (0..3).map(|axis| (corner[axis] - from[axis]).abs()).sum::<i64>();
    let (mut l, mut r) = (0, 0);
    // The triangles at the lower and the upper side form fans over the corners there.
    let fan = |side: &[Corner], end: Corner, top: Corner, give: &mut dyn FnMut([Corner; 3])| {
        let ends = side.iter().skip(1).chain([&end]);
        side.iter().zip(ends).for_each(|(a, b)| give([*a, *b, top]));
    };
    while (l, r) != (left.len() - 1, right.len() - 1) {
        let is_left = r == right.len() - 1
            || l < left.len() - 1 && height(&left[l + 1], &ring[0]) < height(&right[r + 1], &ring[1]);
        let next = if is_left { left[l + 1] } else { right[r + 1] };
        let triangle = [left[l], right[r], next];
        let is_first = (l, r) == (0, 0);
        if is_left {
            l += 1
        } else {
            r += 1
        }
        let is_last = (l, r) == (left.len() - 1, right.len() - 1);
        match (is_first, is_last) {
            (true, _) => fan(&sides[0], ring[1], next, &mut give),
            (_, true) => fan(&sides[2], ring[3], triangle[usize::from(!is_left)], &mut give),
            _ => give(triangle),
        }
    }
}

/// Corners in three orders: grouped by line along x, y and z, and sorted along the line.
struct Lines([Vec<Corner>; 3]);

impl Lines {
    fn of(corners: &[Corner]) -> Self {
        Self([0, 1, 2].map(|axis| {
            let mut sorted = corners.to_vec();
            sorted.sort_unstable_by_key(|corner| Self::key(axis, corner));
            sorted
        }))
    }

    /// The two coordinates that identify the line along `axis`, then the one along it.
    fn key(axis: usize, corner: &Corner) -> Corner {
        [corner[(axis + 1) % 3], corner[(axis + 2) % 3], corner[axis]]
    }

    /// Returns the corners from `from` up to, but without, `to`, which differ along one axis, in this direction.
    fn along(&self, from: Corner, to: Corner) -> Vec<Corner> {
        let axis = (0..3).find(|&axis| from[axis] != to[axis]).unwrap_or(0);
        let (low, high) = (Self::key(axis, &from.min(to)), Self::key(axis, &from.max(to)));
        let line = &self.0[axis];
        let first = line.partition_point(|corner| Self::key(axis, corner) < low);
        let end = line.partition_point(|corner| Self::key(axis, corner) <= high);
        let mut found = line[first..end].to_vec();
        if from[axis] > to[axis] {
            found.reverse();
        }
        found.pop();
        found
    }
}

impl Surface {
    fn of(rectangles: &[Rectangle]) -> Self {
        let mut corners: Vec<Corner> = rectangles.iter().flat_map(Rectangle::corners).collect();
        corners.sort_unstable();
        corners.dedup();
        let lines = Lines::of(&corners);
        let number = |corner: &Corner| corners.binary_search(corner).unwrap_or(0) as u32;
        let mut triangles = Vec::with_capacity(2 * rectangles.len());
        for rectangle in rectangles {
            let ring = rectangle.corners();
            let sides = [0, 1, 2, 3].map(|side| lines.along(ring[side], ring[(side + 1) % 4]));
            triangulate(ring, &sides, |triangle| triangles.push(triangle.map(|corner| number(&corner))));
        }
        Self { corners, triangles }
    }

    fn write(&self, frame: &Frame, out: &mut impl Write) -> Result<(), Failure> {
        let origin = [0, 1, 2].map(|axis| self.corners.iter().map(|at| at[axis]).min().unwrap_or(0));
        let units = [frame.pixel_m(), frame.pixel_m(), frame.quantum_m()];
        let metres = |corner: Corner| [0, 1, 2].map(|axis| corner[axis] as f64 * units[axis]);
        let turned = |[x, y, z]: [f64; 3]| [x, z, -y];
        let relative = |at: &Corner| turned(metres([0, 1, 2].map(|axis| at[axis] - origin[axis]))).map(|v| v as f32);
        let bytes = [12 * self.corners.len() as u64, 12 * self.triangles.len() as u64];
        let head = self.head(relative, turned(metres(origin)), bytes);
        if !gltf::write_head(&head, bytes[0] + bytes[1], out)? {
            return Ok(());
        }
        for at in &self.corners {
            for value in relative(at) {
                out.write_all(&value.to_le_bytes())?;
            }
        }
        for index in self.triangles.as_flattened() {
            out.write_all(&index.to_le_bytes())?;
        }
        Ok(())
    }

    /// The scene: one node at `origin` with one mesh.
    fn head(&self, relative: impl Fn(&Corner) -> [f32; 3], origin: [f64; 3], bytes: [u64; 2]) -> Value {
        let asset = gltf::asset();
        if self.triangles.is_empty() {
            return json!({ "asset": asset, "scene": 0, "scenes": [{}] });
        }
        let ends = |choose: fn(f32, f32) -> f32| {
            let places = self.corners.iter().map(&relative);
            places.reduce(|a, b| [0, 1, 2].map(|axis| choose(a[axis], b[axis]))).unwrap_or_default()
        };
        let view = |offset: u64, length: u64, target: u32| json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": target });
        json!({
            "asset": asset,
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "mesh": 0, "name": "matter", "translation": origin }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": 0 }] }],
            "materials": [{
                "name": "matter",
                "pbrMetallicRoughness": { "baseColorFactor": [0.75, 0.75, 0.72, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0 }
            }],
            "accessors": [
                {
                    "bufferView": 0, "componentType": FLOAT, "count": self.corners.len(), "type": "VEC3",
                    "min": ends(f32::min), "max": ends(f32::max)
                },
                { "bufferView": 1, "componentType": UNSIGNED_INT, "count": 3 * self.triangles.len(), "type": "SCALAR" }
            ],
            "bufferViews": [view(0, bytes[0], ARRAY_BUFFER), view(bytes[0], bytes[1], ELEMENT_ARRAY_BUFFER)],
            "buffers": [{ "byteLength": bytes[0] + bytes[1] }],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    /// Checks that each edge is traversed equally often both ways, no triangle is degenerate, and the volume equals
    /// that of the columns.
    fn check(columns: &Columns) -> Surface {
        let surface = Surface::of(&rectangles(columns));
        let mut edges: HashMap<[u32; 2], i64> = HashMap::new();
        let mut six_volumes = 0i128;
        for triangle in &surface.triangles {
            let [a, b, c] = triangle.map(|at| surface.corners[at as usize].map(i128::from));
            let minus = |p: [i128; 3], q: [i128; 3]| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
            let cross = |p: [i128; 3], q: [i128; 3]| {
                [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
            };
            let normal = cross(minus(b, a), minus(c, a));
            assert_ne!(normal, [0; 3], "{triangle:?} is flat");
            six_volumes += a[0] * normal[0] + a[1] * normal[1] + a[2] * normal[2];
            for side in 0..3 {
                let (from, to) = (triangle[side], triangle[(side + 1) % 3]);
                *edges.entry([from.min(to), from.max(to)]).or_default() += if from < to { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|sum| *sum == 0), "open: {columns:?}");
        let volume: i64 = columns.values().flatten().map(|[bottom, top]| top - bottom).sum();
        assert_eq!(six_volumes, 6 * i128::from(volume));
        surface
    }

    #[test]
    fn one_box_has_twelve_triangles() {
        let surface = check(&Columns::from([((3, -2), vec![[10, 17]])]));
        assert_eq!((surface.corners.len(), surface.triangles.len()), (8, 12));
    }

    #[test]
    fn a_floor_is_one_box_and_matter_without_thickness_has_two_sides() {
        let floor: Columns = (0..9).flat_map(|i| (0..7).map(move |j| ((i, j), vec![[5, 9]]))).collect();
        assert_eq!(check(&floor).triangles.len(), 12);
        let sheet: Columns = (0..9).flat_map(|i| (0..7).map(move |j| ((i, j), vec![[5, 5]]))).collect();
        assert_eq!(check(&sheet).triangles.len(), 4);
    }

    #[test]
    fn surfaces_are_closed_whatever_the_columns() {
        let mut state = 7u64;
        let mut below = |end: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % end
        };
        for _ in 0..200 {
            let (edge, high) = (1 + below(6), 1 + below(8));
            let mut columns = Columns::new();
            for (i, j) in (0..edge as i64).flat_map(|i| (0..edge as i64).map(move |j| (i, j))) {
                let mut column = Vec::new();
                let mut z = below(high) as i64;
                for _ in 0..below(4) {
                    let top = z + below(high) as i64;
                    column.push([z, top]);
                    z = top + 1 + below(high) as i64;
                }
                if !column.is_empty() {
                    columns.insert((i - 3, j - 3), column);
                }
            }
            check(&columns);
        }
    }
}
