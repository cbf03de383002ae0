//! Cubes that all libraries hold: their edge is a pixel's, and Slicewalk holds them exactly too, as whole thirds of
//! slices.

use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use slicewalk::archive::{Archive, ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PAGE_QUANTA, PAGE_SLICES, PageKey, SLICE_QUANTA, TILE_PIXELS};
use slicewalk::page::{Page, PageBuilder, Span};
use slicewalk::plan::Plan;
use slicewalk::store::Snapshot;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Quanta of a cube: slices are three pixels high.
const CUBE_QUANTA: i64 = SLICE_QUANTA / 3;
/// Cubes of a page, upwards.
const PAGE_CUBES: i64 = PAGE_QUANTA / CUBE_QUANTA;

/// Cubes, counted from a corner near the scene's middle.
pub struct Matter {
    /// Edge of a cube (m).
    pub edge: f64,
    /// Occupied cubes: number `n` of an axis begins at `n` edges.
    pub cubes: Vec<[i32; 3]>,
    /// Per column of cubes the runs of occupied ones, first and one behind the last, ascending and apart.
    columns: HashMap<[i32; 2], Vec<[i32; 2]>>,
    /// Where the count begins, in the coordinates of the scene (m).
    pub origin: Vector3<f64>,
    /// The cubes as pages.
    pub store: Snapshot,
    /// The scan as it was converted, with its finer heights.
    pub converted: Snapshot,
    /// Lengths of the archive of the cubes, and of the scan's own (bytes).
    pub archive_bytes: [u64; 2],
}

/// Vertices that faces share, and triangles, counter-clockwise from outside.
pub struct Mesh {
    /// x y z (m).
    pub vertices: Vec<[f32; 3]>,
    /// Three vertices each.
    pub triangles: Vec<[u32; 3]>,
}

impl Matter {
    /// The spans of an archive, grown to whole cubes; slices must be three pixels high. `about`: a place in the scene (m).
    pub fn new(file: &Path, about: Vector3<f64>) -> Result<Self> {
        let archive = Archive::open(file)?;
        let frame = *archive.frame();
        if (frame.slice_m() / frame.pixel_m() - 3.0).abs() > 1e-9 {
            return Err("slices are not three pixels high".into());
        }
        let middle = [0, 1].map(|axis| frame.pixel_of(about[axis]).div_euclid(TILE_PIXELS) as i32);
        let layer = frame.slice_of(about.z).div_euclid(PAGE_SLICES) as i32;
        let (mut converted, mut whole) = (Vec::new(), Vec::new());
        let mut columns: HashMap<[i32; 2], Vec<[i32; 2]>> = HashMap::new();
        let mut builder = PageBuilder::default();
        for entry in archive.entries() {
            let entry = entry?;
            let page = archive.page(&entry)?;
            let key =
                PageKey { tx: entry.key.tx - middle[0], ty: entry.key.ty - middle[1], layer: entry.key.layer - layer };
            builder.clear();
            for (px, py, spans) in page.columns() {
                let column = [(key.tx, px), (key.ty, py)].map(|(tile, p)| tile * TILE_PIXELS as i32 + p as i32);
                let spans = grown(spans);
                let base = key.layer * PAGE_CUBES as i32;
                let runs = columns.entry(column).or_default();
                runs.extend(
                    spans.iter().map(|s| [s.bottom(), s.top()].map(|q| base + (q as i64 / CUBE_QUANTA) as i32)),
                );
                if !builder.set_column(px, py, &spans) {
                    return Err(format!("cubes do not make a column: {spans:?}").into());
                }
            }
            whole.push((key, builder.build()));
            converted.push((key, page));
        }
        let mut cubes = Vec::new();
        for (&[i, j], runs) in &mut columns {
            runs.sort_unstable();
            runs.dedup_by(|next, last| {
                let joined = next[0] <= last[1];
                last[1] = if joined { last[1].max(next[1]) } else { last[1] };
                joined
            });
            cubes.extend(runs.iter().flat_map(|&[first, end]| (first..end).map(move |k| [i, j, k])));
        }
        cubes.sort_unstable();
        let archive_bytes = [written(&frame, &whole)?, std::fs::metadata(file)?.len()];
        let (tile, height) = (TILE_PIXELS as f64 * frame.pixel_m(), PAGE_SLICES as f64 * frame.slice_m());
        Ok(Self {
            edge: frame.pixel_m(),
            cubes,
            columns,
            origin: Vector3::new(f64::from(middle[0]) * tile, f64::from(middle[1]) * tile, f64::from(layer) * height),
            store: Snapshot::from_pages(frame, whole),
            converted: Snapshot::from_pages(frame, converted),
            archive_bytes,
        })
    }

    /// Runs of cubes, one above the other: least and greatest corner (m).
    pub fn runs(&self) -> impl Iterator<Item = [Point3<f64>; 2]> {
        let corner = |i: i32, j: i32, k: i32| Point3::new(f64::from(i), f64::from(j), f64::from(k)) * self.edge;
        self.columns.iter().flat_map(move |(&[i, j], runs)| {
            runs.iter().map(move |&[first, end]| [corner(i, j, first), corner(i + 1, j + 1, end)])
        })
    }

    fn holds(&self, [i, j, k]: [i32; 3]) -> bool {
        self.columns.get(&[i, j]).is_some_and(|runs| meets(runs, k, k))
    }

    fn cube(&self, p: &Point3<f64>) -> [i32; 3] {
        [p.x, p.y, p.z].map(|v| (v / self.edge).floor() as i32)
    }

    /// Whether a closed box touches a cube, half-open as cubes are.
    pub fn hits(&self, min: &Point3<f64>, max: &Point3<f64>) -> bool {
        let (low, high) = (self.cube(min), self.cube(max));
        let mut columns = (low[0]..=high[0]).flat_map(|i| (low[1]..=high[1]).map(move |j| [i, j]));
        columns.any(|column| self.columns.get(&column).is_some_and(|runs| meets(runs, low[2], high[2])))
    }

    /// Distance from `origin` along `direction`, of length 1, to the first cube; infinite beyond `max` (m).
    pub fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>, max: f64) -> f64 {
        let mut cube = self.cube(origin);
        let edge = |n: i32| f64::from(n) * self.edge;
        let next = |axis: usize, n: i32| match direction[axis] {
            d if d > 0.0 => (edge(n + 1) - origin[axis]) / d,
            d if d < 0.0 => (edge(n) - origin[axis]) / d,
            _ => f64::INFINITY,
        };
        let mut ahead = [0, 1, 2].map(|axis| next(axis, cube[axis]));
        let mut at = 0.0;
        while at <= max {
            if self.holds(cube) {
                return at;
            }
            let axis = (0..3).min_by(|a, b| ahead[*a].total_cmp(&ahead[*b])).unwrap_or_default();
            at = ahead[axis];
            cube[axis] += if direction[axis] > 0.0 { 1 } else { -1 };
            ahead[axis] = next(axis, cube[axis]);
        }
        f64::INFINITY
    }

    /// How far a box gets along `way` until it touches a cube; the whole way if it touches none (m).
    pub fn sweep(&self, min: &Point3<f64>, max: &Point3<f64>, way: &Vector3<f64>) -> f64 {
        let zero = Vector3::zeros();
        let (low, high) = (self.cube(&(min + way.inf(&zero))), self.cube(&(max + way.sup(&zero))));
        let mut first = 1.0f64;
        for column in (low[0]..=high[0]).flat_map(|i| (low[1]..=high[1]).map(move |j| [i, j])) {
            let near =
                self.columns.get(&column).into_iter().flatten().filter(|run| run[0] <= high[2] && run[1] > low[2]);
            for run in near {
                let from = [column[0], column[1], run[0]].map(|n| f64::from(n) * self.edge);
                let to = [column[0] + 1, column[1] + 1, run[1]].map(|n| f64::from(n) * self.edge);
                let (mut enter, mut leave) = (0.0f64, 1.0f64);
                for axis in 0..3 {
                    let (gap, beyond) = (from[axis] - max[axis], to[axis] - min[axis]);
                    if way[axis] == 0.0 {
                        if gap > 0.0 || beyond < 0.0 {
                            enter = f64::INFINITY;
                        }
                        continue;
                    }
                    let (s, t) = (gap / way[axis], beyond / way[axis]);
                    (enter, leave) = (enter.max(s.min(t)), leave.min(s.max(t)));
                }
                if enter <= leave {
                    first = first.min(enter);
                }
            }
        }
        first * way.norm()
    }

    /// Calls `face` with every face between an occupied cube and a free one: axis, side (0 or 1), cube.
    fn faces(&self, mut face: impl FnMut(usize, i32, [i32; 3])) {
        for &cube in &self.cubes {
            for axis in 0..3 {
                for side in [0, 1] {
                    let mut beside = cube;
                    beside[axis] += 2 * side - 1;
                    if !self.holds(beside) {
                        face(axis, side, cube);
                    }
                }
            }
        }
    }

    /// The faces between occupied cubes and free ones, two triangles each.
    pub fn mesh(&self) -> Mesh {
        let mut builder = Builder::new(self.edge);
        self.faces(|axis, side, cube| builder.rectangle(axis, side, cube, [1, 1]));
        builder.mesh
    }

    /// Like [`mesh`](Self::mesh), but faces of one plane that make a rectangle are two triangles: rows first, then
    /// equal rows.
    pub fn merged(&self) -> Mesh {
        let mut planes: BTreeMap<(usize, i32, i32), Vec<[i32; 2]>> = BTreeMap::new();
        self.faces(|axis, side, cube| {
            planes.entry((axis, side, cube[axis])).or_default().push([cube[(axis + 2) % 3], cube[(axis + 1) % 3]]);
        });
        let mut builder = Builder::new(self.edge);
        for ((axis, side, plane), mut cells) in planes {
            cells.sort_unstable();
            let mut rectangle = |first: i32, end: i32, from: i32, to: i32| {
                let mut cube = [plane; 3];
                (cube[(axis + 1) % 3], cube[(axis + 2) % 3]) = (first, from);
                builder.rectangle(axis, side, cube, [end - first, to - from]);
            };
            // Open rows, by their ends: the row in which each began.
            let (mut open, mut last) = (BTreeMap::<[i32; 2], i32>::new(), i32::MIN);
            for row in cells.chunk_by(|a, b| a[0] == b[0]) {
                let at = row[0][0];
                if at != last.saturating_add(1) {
                    std::mem::take(&mut open)
                        .into_iter()
                        .for_each(|([i, end], from)| rectangle(i, end, from, last + 1));
                }
                let runs: BTreeMap<[i32; 2], i32> = row
                    .chunk_by(|a, b| a[1] + 1 == b[1])
                    .map(|run| [run[0][1], run[run.len() - 1][1] + 1])
                    .map(|ends| (ends, open.remove(&ends).unwrap_or(at)))
                    .collect();
                std::mem::replace(&mut open, runs).into_iter().for_each(|([i, end], from)| rectangle(i, end, from, at));
                last = at;
            }
            open.into_iter().for_each(|([i, end], from)| rectangle(i, end, from, last + 1));
        }
        builder.mesh
    }
}

/// Makes rectangles of triangles that share their vertices.
struct Builder {
    edge: f64,
    numbers: HashMap<[i32; 3], u32>,
    mesh: Mesh,
}

impl Builder {
    fn new(edge: f64) -> Self {
        Self { edge, numbers: HashMap::new(), mesh: Mesh { vertices: Vec::new(), triangles: Vec::new() } }
    }

    /// Adds the side of a cube, extended to `along` and `beyond` cubes along the two axes that follow.
    fn rectangle(&mut self, axis: usize, side: i32, cube: [i32; 3], [along, beyond]: [i32; 2]) {
        // The other two axes, so that their cross product points along the first.
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut corners = [(0, 0), (along, 0), (along, beyond), (0, beyond)].map(|(u, v)| {
            let mut corner = cube;
            corner[axis] += side;
            (corner[a], corner[b]) = (corner[a] + u, corner[b] + v);
            *self.numbers.entry(corner).or_insert_with(|| {
                self.mesh.vertices.push(corner.map(|n| (f64::from(n) * self.edge) as f32));
                self.mesh.vertices.len() as u32 - 1
            })
        });
        if side == 0 {
            corners.reverse();
        }
        let [p, q, r, s] = corners;
        self.mesh.triangles.extend([[p, q, r], [p, r, s]]);
    }
}

/// Whether a run holds a cube from `low` to `high`.
fn meets(runs: &[[i32; 2]], low: i32, high: i32) -> bool {
    let behind = runs.partition_point(|run| run[1] <= low);
    runs.get(behind).is_some_and(|run| run[0] <= high)
}

/// Spans of a column, grown to whole cubes; those of one kind that touch then are one.
fn grown(spans: &[Span]) -> Vec<Span> {
    let cube = CUBE_QUANTA as u32;
    let mut grown: Vec<Span> = Vec::with_capacity(spans.len());
    for span in spans {
        let bottom = span.bottom() / cube * cube;
        let top = span.top().div_ceil(cube).max(span.bottom() / cube + 1) * cube;
        let joined = grown.last().filter(|last| last.top() >= bottom && last.is_obstacle() == span.is_obstacle());
        let from = joined.map_or(bottom, |last| last.bottom());
        if joined.is_some() {
            grown.pop();
        }
        grown.extend(Span::new(from, top, span.is_obstacle()));
    }
    grown
}

/// Length of an archive of pages (bytes).
fn written(frame: &Frame, pages: &[(PageKey, Page)]) -> Result<u64> {
    let folder = tempfile::tempdir()?;
    let plan = Plan::new(*frame);
    let mut writer = ArchiveWriter::create(&folder.path().join("cubes.slices"), &plan, false)?;
    let mut encoder = PageEncoder::of_plan(&plan).for_levels(false);
    let mut order: Vec<_> = pages.iter().collect();
    order.sort_by_key(|(key, _)| (key.column(), key.layer));
    for (key, page) in order {
        writer.put(*key, encoder.encode(*key, page))?;
    }
    Ok(writer.finish(Totals::default())?.file_len)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::Random;
    use slicewalk::NoMonitor;
    use slicewalk::query::{Aabb, Overlap, Ray, cast, overlaps};
    use slicewalk_convert::{ConvertOptions, PixelSize, convert};

    pub const EDGE: f64 = 0.1;

    /// A floor with a step, a wall with a hole, and dust, far from the origin; and how far.
    pub fn matter() -> Result<Matter> {
        let about = Vector3::new(1000.0, -2000.0, 300.0);
        let mut random = Random(3);
        let mut points = Vec::new();
        for n in 0..200 * 200 {
            let (x, y) = (f64::from(n % 200) * 0.04 - 4.0, f64::from(n / 200) * 0.04 - 4.0);
            points.push(Vector3::new(x, y, if x > 1.0 { 0.21 } else { 0.013 }));
            if (y - 1.0).abs() > 0.5 {
                points.push(Vector3::new(2.51, x, (y + 4.0) * 0.4));
            }
        }
        points.extend((0..300).map(|_| Vector3::from([0, 1, 2].map(|_| random.between(-4.0, 4.0)))));
        let folder = tempfile::tempdir()?;
        let (scan, archive) = (folder.path().join("scan.las"), folder.path().join("scan.slices"));
        let spec = scangen::WriteSpec { scale: [1e-4; 3], offset: about.into(), ..scangen::WriteSpec::default() };
        scangen::write_las(&scan, points.iter().map(|p| (p + about).into()), &spec)?;
        let mut options = ConvertOptions::new(vec![scan], archive.clone());
        options.grid.pixel = PixelSize::Metres(EDGE);
        convert(&options, &NoMonitor)?;
        Matter::new(&archive, about)
    }

    #[test]
    fn pages_hold_exactly_the_cubes_and_all_matter_of_the_scan() -> Result<()> {
        let matter = matter()?;
        assert!(matter.cubes.len() > 6000, "{}", matter.cubes.len());
        assert!(matter.cubes.iter().flatten().all(|n| n.abs() < 400), "counted from the middle");
        let volume: f64 = matter.runs().map(|[low, high]| (high - low).product()).sum();
        assert!((volume / EDGE.powi(3) - matter.cubes.len() as f64).abs() < 1e-6);
        let mut random = Random(9);
        let (mut hits, mut finer) = (0, 0);
        for _ in 0..1500 {
            let place = Point3::from([0, 1, 2].map(|_| random.between(-4.0, 4.0)))
                + Vector3::new(1000.0, -2000.0, 300.0)
                - matter.origin;
            let shape = Aabb::standing(place, Vector3::new(0.17, 0.13, 0.11))?;
            let all = matter.cubes.iter().any(|cube| {
                (0..3).all(|axis| {
                    let low = f64::from(cube[axis]) * EDGE;
                    low <= shape.max()[axis] && low + EDGE > shape.min()[axis]
                })
            });
            assert_eq!(matter.hits(&shape.min(), &shape.max()), all, "{shape:?}");
            assert_eq!(overlaps(&matter.store, &shape) == Overlap::Hit, all, "{shape:?}");
            hits += usize::from(all);
            let as_converted = overlaps(&matter.converted, &shape) == Overlap::Hit;
            assert!(all || !as_converted, "{shape:?}");
            finer += usize::from(all && !as_converted);
        }
        assert!((30..1000).contains(&hits) && finer > 8, "{hits} {finer}");
        assert!(matter.archive_bytes.iter().all(|&bytes| bytes > 1000));
        Ok(())
    }

    #[test]
    fn rays_and_sweeps_of_the_reference_are_those_of_the_pages() -> Result<()> {
        let matter = matter()?;
        let about = Point3::new(1000.0, -2000.0, 300.0) - matter.origin;
        let mut random = Random(10);
        let mut hits = [0, 0];
        for _ in 0..2000 {
            let mut place = |size: f64| Vector3::from([0, 1, 2].map(|_| random.between(-size, size)));
            let (from, way) = (about + place(4.0), place(1.0));
            let ray = Ray::new(from, way, 3.0)?;
            let found = cast(&matter.store, &ray).known().flatten().map_or(f64::INFINITY, |hit| hit.distance);
            let expected = matter.cast(&from, &ray.direction(), 3.0);
            assert!((found.min(3.0) - expected.min(3.0)).abs() < 1e-6, "{ray:?}: {found} {expected}");
            hits[0] += usize::from(expected < 3.0);
            let shape = Aabb::standing(from, Vector3::new(0.2, 0.2, 0.3))?;
            let met = slicewalk::query::sweep(&matter.store, &shape, way).known().flatten();
            let found = met.map_or(way.norm(), |hit| hit.distance);
            let expected = matter.sweep(&shape.min(), &shape.max(), &way);
            assert!((found - expected).abs() < 1e-6, "{shape:?} {way:?}: {found} {expected}");
            hits[1] += usize::from(expected > 0.0 && expected < way.norm());
        }
        assert!(hits.iter().all(|&n| n > 100), "{hits:?}");
        Ok(())
    }

    #[test]
    fn triangles_are_the_closed_boundary() -> Result<()> {
        let matter = matter()?;
        for mesh in [matter.mesh(), matter.merged()] {
            let corner = |n: u32| Vector3::from(mesh.vertices[n as usize].map(f64::from));
            let corners = |t: &[u32; 3]| t.map(corner);
            // The volume inside of a closed surface, by the divergence theorem.
            let parts = mesh.triangles.iter().map(corners).map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0);
            let volume: f64 = parts.sum();
            assert!((volume / EDGE.powi(3) / matter.cubes.len() as f64 - 1.0).abs() < 1e-3, "{volume}");
            let areas = mesh.triangles.iter().map(corners).map(|[a, b, c]| (b - a).cross(&(c - a)).norm() / 2.0);
            let (mut faces, area) = (0, areas.sum::<f64>());
            matter.faces(|_, _, _| faces += 1);
            assert!((area / EDGE.powi(2) / f64::from(faces) - 1.0).abs() < 1e-3, "{area}");
        }
        let mesh = matter.mesh();
        assert!(matter.merged().triangles.len() * 2 < mesh.triangles.len());
        let mut distinct = mesh.vertices.iter().map(|v| v.map(f32::to_bits)).collect::<Vec<_>>();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), mesh.vertices.len());
        Ok(())
    }
}
