//! Recast, by its Rust port `rerecast`: walkable floors as a navmesh made of triangles.

use crate::stability::Result;
use glam::{UVec3, Vec3A};
use nalgebra::{Point3, Vector3};
use parry3d::shape::TriMesh;
use rerecast::{
    AreaType, BuildContoursFlags, CompactHeightfield, Config, ConfigBuilder, Contour, ContourSet, DetailNavmesh,
    HeightfieldBuilder, PolygonNavmesh,
};
use std::collections::HashMap;
use std::time::Instant;

/// Radius of the one who walks (m).
pub const RADIUS: f64 = 0.25;
/// Its height (m).
pub const HEIGHT: f64 = 1.8;
/// The highest step it climbs (m).
pub const CLIMB: f64 = 0.35;
/// The steepest floor it walks on (degrees).
pub const SLOPE_DEG: f64 = 45.0;
/// Settings that its documentation advises, with cells of a pixel instead of a half or a third of the radius.
pub const SETTINGS: &str = "cells of t, half as high or 7.2 mm; agent 0.25 m wide, 1.8 m high, climbs 0.35 m, slopes to 45°; \
     the rest by ConfigBuilder::default; one mesh without tiles; heights of the detail mesh";
/// Columns of a heightfield: more take more than a gigabyte.
const MOST_CELLS: f64 = 40e6;
/// Recast counts headroom in a byte: with lower cells one of this height could stand nowhere (m).
const LEAST_CELL_HEIGHT_M: f64 = HEIGHT / 250.0;
/// Edge of a cell of the index over triangles (m).
const INDEX_M: f64 = 0.5;

/// Three corners (m), z up.
pub type Triangle = [Point3<f64>; 3];

/// A navmesh, with what it cost.
pub struct Navmesh {
    /// Time to build (s).
    pub build_s: f64,
    /// The compact heightfield that it was made of (bytes).
    pub heightfield_bytes: u64,
    /// Polygons and detail (bytes).
    pub navmesh_bytes: u64,
    floor: Vec<Triangle>,
    index: HashMap<[i64; 2], Vec<u32>>,
}

/// Triangles of a generated scene, curved surfaces cut into steps of `step_m`.
pub fn of_scene(scene: &scangen::Scene, step_m: f64) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    for surface in scene.surfaces() {
        surface.shape.triangles(step_m, &mut |corners| triangles.push(corners.map(Point3::from)));
    }
    triangles
}

/// Triangles of a mesh, for instance the faces of cubes, from its own origin.
pub fn of_mesh(mesh: &TriMesh, origin: Vector3<f64>) -> Vec<Triangle> {
    let corner = |n: u32| {
        let v = mesh.vertices()[n as usize];
        Point3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z)) + origin
    };
    mesh.indices().iter().map(|triangle| triangle.map(corner)).collect()
}

impl Navmesh {
    /// Makes one with cells of `cell_m` (m). Triangles may wind either way: each counts as seen from above.
    pub fn build(triangles: &[Triangle], cell_m: f64) -> Result<Self> {
        Self::build_for(RADIUS, triangles, cell_m)
    }

    /// Like [`build`](Self::build) for an agent of another radius (m).
    pub fn build_for(radius: f64, triangles: &[Triangle], cell_m: f64) -> Result<Self> {
        let mut corners = triangles.iter().flatten();
        let first = *corners.next().ok_or("no triangles")?;
        let (low, high) = corners.fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
        let [across, along, up] = [0, 1, 2].map(|axis| (high[axis] - low[axis]) / cell_m);
        if across * along > MOST_CELLS || across.max(along).max(2.0 * up) > 65_000.0 {
            let cells = format!("{across:.0} x {along:.0} cells, {:.0} high", 2.0 * up);
            return Err(format!("{cells}; 40 million are the most here, and Recast counts to 65,535 a side").into());
        }
        let start = Instant::now();
        let (heightfield, polygons, detail) = make(triangles, low, cell_m, radius)?;
        let build_s = start.elapsed().as_secs_f64();
        let floor = floor(&detail, low);
        let mut index: HashMap<[i64; 2], Vec<u32>> = HashMap::new();
        for (n, corners) in floor.iter().enumerate() {
            let (low, high) =
                (corners[0].inf(&corners[1]).inf(&corners[2]), corners[0].sup(&corners[1]).sup(&corners[2]));
            let [(i0, j0), (i1, j1)] = [low, high].map(|p| (cell(p.x), cell(p.y)));
            for key in (i0..=i1).flat_map(|i| (j0..=j1).map(move |j| [i, j])) {
                index.entry(key).or_default().push(n as u32);
            }
        }
        Ok(Self { build_s, heightfield_bytes: heightfield, navmesh_bytes: bytes(&polygons, &detail), floor, index })
    }

    /// Heights of walkable floor over a place (m), in no order.
    pub fn heights(&self, x: f64, y: f64) -> Vec<f64> {
        let near = self.index.get(&[cell(x), cell(y)]).into_iter().flatten();
        near.filter_map(|n| height(&self.floor[*n as usize], x, y)).collect()
    }
}

fn cell(value: f64) -> i64 {
    (value / INDEX_M).floor() as i64
}

/// The stages of Recast; gives the bytes of the compact heightfield, which is as large as it gets.
fn make(
    triangles: &[Triangle],
    low: Point3<f64>,
    cell_m: f64,
    radius: f64,
) -> Result<(u64, PolygonNavmesh, DetailNavmesh)> {
    let mut mesh = rerecast::TriMesh::default();
    for corners in triangles {
        let mut corners = corners.map(|p| turned(p - low));
        if (corners[1] - corners[0]).cross(corners[2] - corners[0]).y < 0.0 {
            corners.swap(1, 2);
        }
        let n = mesh.vertices.len() as u32;
        mesh.vertices.extend(corners);
        mesh.indices.push(UVec3::new(n, n + 1, n + 2));
        mesh.area_types.push(AreaType::NOT_WALKABLE);
    }
    let aabb = mesh.compute_aabb().ok_or("no triangles")?;
    let settings = ConfigBuilder {
        cell_size_fraction: (radius / cell_m) as f32,
        cell_height_fraction: (radius / (cell_m / 2.0).max(LEAST_CELL_HEIGHT_M)) as f32,
        agent_height: HEIGHT as f32,
        agent_radius: radius as f32,
        walkable_climb: CLIMB as f32,
        walkable_slope_angle: SLOPE_DEG.to_radians() as f32,
        aabb,
        ..ConfigBuilder::default()
    };
    // Only tiles need a border, which would cut off the rim of the scene.
    let settings = Config { border_size: 0, ..settings.build() };
    mesh.mark_walkable_triangles(settings.walkable_slope_angle);
    let field = HeightfieldBuilder { aabb, cell_size: settings.cell_size, cell_height: settings.cell_height };
    let mut field = field.build()?;
    field.rasterize_triangles(&mesh, settings.walkable_climb)?;
    field.filter_low_hanging_walkable_obstacles(settings.walkable_climb);
    field.filter_ledge_spans(settings.walkable_height, settings.walkable_climb);
    field.filter_walkable_low_height_spans(settings.walkable_height);
    let mut field = field.into_compact(settings.walkable_height, settings.walkable_climb)?;
    field.erode_walkable_area(settings.walkable_radius);
    field.build_distance_field();
    field.build_regions(settings.border_size, settings.min_region_area, settings.merge_region_area)?;
    let flags = BuildContoursFlags::default();
    let contours = field.build_contours(settings.max_simplification_error, settings.max_edge_len, flags);
    let contours = sound(contours, settings.max_vertices_per_polygon);
    let polygons = contours.into_polygon_mesh(settings.max_vertices_per_polygon)?;
    let detail = DetailNavmesh::new(&polygons, &field, settings.detail_sample_dist, settings.detail_sample_max_error)?;
    Ok((field_bytes(&field), polygons, detail))
}

/// The contours that triangles can be made of. The port gives up at one that is not; Recast warns, and leaves it out.
fn sound(contours: ContourSet, max_vertices_per_polygon: u16) -> ContourSet {
    let ContourSet { contours: all, aabb, cell_size, cell_height, width, height, border_size, max_error } = contours;
    let set = |contours| ContourSet { contours, aabb, cell_size, cell_height, width, height, border_size, max_error };
    let alone = |contour: &Contour| set(vec![contour.clone()]).into_polygon_mesh(max_vertices_per_polygon).is_ok();
    set(all.into_iter().filter(alone).collect())
}

/// y up, turned so that what is counter-clockwise stays so.
fn turned(v: Vector3<f64>) -> Vec3A {
    Vec3A::new(v.x as f32, v.z as f32, -v.y as f32)
}

fn size<T>(items: &[T]) -> u64 {
    size_of_val(items) as u64
}

fn field_bytes(field: &CompactHeightfield) -> u64 {
    size(&field.cells) + size(&field.spans) + size(&field.dist) + size(&field.areas)
}

fn bytes(polygons: &PolygonNavmesh, detail: &DetailNavmesh) -> u64 {
    let polygons = size(&polygons.vertices)
        + size(&polygons.polygons)
        + size(&polygons.polygon_neighbors)
        + size(&polygons.flags)
        + size(&polygons.regions)
        + size(&polygons.areas);
    polygons + size(&detail.meshes) + size(&detail.vertices) + size(&detail.triangles) + size(&detail.triangle_flags)
}

/// The triangles of the detail mesh, turned back.
fn floor(detail: &DetailNavmesh, low: Point3<f64>) -> Vec<Triangle> {
    let place = |v: &glam::Vec3| low + Vector3::new(f64::from(v.x), -f64::from(v.z), f64::from(v.y));
    let mut all = Vec::new();
    for mesh in &detail.meshes {
        let vertices = &detail.vertices[mesh.base_vertex_index as usize..][..mesh.vertex_count as usize];
        let triangles = &detail.triangles[mesh.base_triangle_index as usize..][..mesh.triangle_count as usize];
        all.extend(triangles.iter().map(|corners| corners.map(|n| place(&vertices[usize::from(n)]))));
    }
    all
}

/// Height of a triangle over a place, if it lies over it.
fn height(corners: &Triangle, x: f64, y: f64) -> Option<f64> {
    let [a, b, c] = corners;
    let area = |p: (f64, f64), q: (f64, f64), r: (f64, f64)| (q.0 - p.0) * (r.1 - p.1) - (r.0 - p.0) * (q.1 - p.1);
    let [p, q, r] = [a, b, c].map(|corner| (corner.x, corner.y));
    let whole = area(p, q, r);
    let parts = [area(q, r, (x, y)), area(r, p, (x, y)), area(p, q, (x, y))].map(|part| part / whole);
    let inside = whole != 0.0 && parts.iter().all(|part| *part >= -1e-9);
    inside.then(|| parts[0] * a.z + parts[1] * b.z + parts[2] * c.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_room_with_a_step_and_a_wall_is_walkable_but_near_them() -> Result<()> {
        let quad = |corner: [f64; 3], a: [f64; 3], b: [f64; 3]| {
            let (corner, a, b) = (Point3::from(corner), Vector3::from(a), Vector3::from(b));
            [[corner, corner + a, corner + a + b], [corner, corner + b, corner + a + b]]
        };
        // A floor of 6 x 4 m, from x = 4 on 0.2 m higher, and a wall across at x = 2, 3 m wide.
        let parts = [
            quad([10.0, 5.0, 1.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]),
            quad([14.0, 5.0, 1.0], [0.0, 4.0, 0.0], [0.0, 0.0, 0.2]),
            quad([14.0, 5.0, 1.2], [2.0, 0.0, 0.0], [0.0, 4.0, 0.0]),
            quad([12.0, 5.0, 1.0], [0.0, 3.0, 0.0], [0.0, 0.0, 2.5]),
        ];
        let navmesh = Navmesh::build(&parts.concat(), 0.05)?;
        for (x, y, expected) in [
            (11.0, 7.0, Some(1.0)),
            (13.0, 6.0, Some(1.0)),
            (15.0, 7.0, Some(1.2)),
            (12.0, 8.6, Some(1.0)),
            (12.1, 6.0, None),
            (10.05, 7.0, None),
            (20.0, 7.0, None),
        ] {
            let found = navmesh.heights(x, y);
            match expected {
                Some(z) => assert!(found.len() == 1 && (found[0] - z).abs() < 0.06, "{x} {y}: {found:?}"),
                None => assert!(found.is_empty(), "{x} {y}: {found:?}"),
            }
        }
        assert!(navmesh.heightfield_bytes > 9600 * 8 && (100..20_000).contains(&navmesh.navmesh_bytes));
        let narrow = Navmesh::build(&parts.concat(), 0.0005);
        assert!(narrow.is_err_and(|error| error.to_string().contains("12000 x 8000 cells")));
        Ok(())
    }
}
