//! One tile of a collider: some page columns, from their solid to a checked surface.

use super::cover::{Cover, growth};
use super::grid::{Grid, STEPS};
use super::mesh::Mesh;
use super::shell::{Columns, Interval, Point, Shell, within_reach};
use crate::Failure;
use slicewalk::archive::{Archive, PageEntry, PageReader};
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use std::collections::BTreeMap;
use std::path::Path;

/// How often a tile is tried again with cells of half the size.
const ATTEMPTS: u32 = 3;

/// Page columns that make a tile.
pub struct Tile {
    pub name: String,
    pub entries: Vec<PageEntry>,
}

/// The surface of a tile: closed, each edge with two triangles.
pub struct Piece {
    pub name: String,
    /// Metres of the archive.
    pub origin: [f64; 3],
    /// Corners relative to the origin (m).
    pub corners: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// Solid of a tile on the cells of a grid.
struct Solid {
    grid: Grid,
    /// First cell along x and y.
    first: [i64; 2],
    /// Height of the base (quanta).
    base: i64,
    columns: Columns,
}

/// Makes the surface of a tile that contains its solid and lies within `error_m` of it.
pub fn piece(archive: &Archive, path: &Path, tile: &Tile, error_m: f64) -> Result<Piece, Failure> {
    for attempt in 0..ATTEMPTS {
        let Some(grid) = Grid::new(archive.frame(), error_m, 1 << attempt) else { break };
        let solid = Solid::load(archive, path, tile, grid)?;
        if let Some(piece) = solid.simplified(archive, &tile.name)? {
            return Ok(piece);
        }
    }
    let reason = format!("no surface within {error_m} m was found; give a larger error");
    Err(Failure::Text(format!("{}: {}: {reason}", path.display(), tile.name)))
}

impl Solid {
    fn load(archive: &Archive, path: &Path, tile: &Tile, grid: Grid) -> Result<Self, Failure> {
        let broken = |error| crate::broken(path, &error);
        let mut cells: BTreeMap<(i64, i64), Vec<Interval>> = BTreeMap::new();
        let mut pages = PageReader::new(archive);
        for entry in &tile.entries {
            let base = i64::from(entry.key.layer) * PAGE_QUANTA;
            for (px, py, spans) in pages.page(entry).map_err(broken)?.columns() {
                let pixel = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
                let (x, y) = (grid.cells(pixel(entry.key.tx, px)), grid.cells(pixel(entry.key.ty, py)));
                for cell in (y.0..y.1).flat_map(|y| (x.0..x.1).map(move |x| (y, x))) {
                    let spans =
                        spans.iter().map(|span| [base + i64::from(span.bottom()), base + i64::from(span.top())]);
                    cells.entry(cell).or_default().extend(spans);
                }
            }
        }
        let margin = (grid.reach_m / grid.cell_m) as i64 + growth(&grid) as i64 + 2;
        let ends = |axis: fn(&(i64, i64)) -> i64| {
            let (low, high) =
                cells.keys().map(axis).fold((i64::MAX, i64::MIN), |(low, high), at| (low.min(at), high.max(at)));
            (low - margin, (high - low + 1 + 2 * margin) as usize)
        };
        let (x, y) = (ends(|cell| cell.1), ends(|cell| cell.0));
        let base = cells.values().flatten().map(|span| span[0]).min().unwrap_or(0);
        let columns = Columns::new([x.1, y.1], |cx, cy, own| {
            let spans = cells.get(&(y.0 + cy as i64, x.0 + cx as i64)).into_iter().flatten();
            own.extend(spans.map(|span| span.map(|height| (height - base) * grid.fine)));
        });
        Ok(Self { grid, first: [x.0, y.0], base, columns })
    }

    /// Returns the checked surface; `None` if it cannot be had on this grid.
    fn simplified(&self, archive: &Archive, name: &str) -> slicewalk::Result<Option<Piece>> {
        let grid = &self.grid;
        let reach = within_reach(&self.columns, grid);
        let scale = [grid.cell_m / STEPS as f64, grid.cell_m / STEPS as f64, grid.unit_m];
        let Some(cover) = Cover::of(&self.columns, grid) else { return Ok(None) };
        let (mut corners, triangles) = cover.surface();
        corners.iter_mut().for_each(|corner| (corner[0], corner[1]) = (corner[0] * STEPS, corner[1] * STEPS));
        let shell = Shell::new(&self.columns, &reach, 1, 1.0);
        let Some(mut mesh) = Mesh::new(&shell, scale, corners, triangles) else { return Ok(None) };
        mesh.simplify()?;
        let (places, triangles) = mesh.finish();
        let frame = archive.frame();
        let [x, y] = self.first.map(|cell| (cell * grid.group) as f64 / grid.parts as f64 * frame.pixel_m());
        let corners = places.iter().map(|place| [0, 1, 2].map(|axis| (place[axis] as f64 * scale[axis]) as f32));
        let piece = Piece {
            name: name.to_owned(),
            origin: [x, y, self.base as f64 * frame.quantum_m()],
            corners: corners.collect(),
            triangles,
        };
        Ok(self.is_sound(&reach, &piece, scale).then_some(piece))
    }

    /// Returns whether the surface, with its corners as they will be written, lies outside of the solid and within
    /// reach of it, and has all solid inside and nothing beyond reach.
    fn is_sound(&self, reach: &Columns, piece: &Piece, scale: Point) -> bool {
        let shell = Shell::new(&self.columns, reach, 0, 0.0);
        let place = |at: u32| {
            let corner = piece.corners[at as usize];
            [0, 1, 2].map(|axis| f64::from(corner[axis]) / scale[axis])
        };
        let mut crossings: Vec<(usize, f64, i32)> = Vec::new();
        for triangle in &piece.triangles {
            let triangle = triangle.map(place);
            if !shell.holds(&triangle) {
                return false;
            }
            shell.middles(&triangle, |x, y, height, up| crossings.push((y * self.columns.size[0] + x, height, up)));
        }
        crossings.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut rest = &crossings[..];
        let [width, height] = self.columns.size;
        for cell in 0..width * height {
            let (own, others) = rest.split_at(rest.partition_point(|crossing| crossing.0 == cell));
            rest = others;
            // How often the surface winds around a height.
            let around =
                |at: f64| own.iter().filter(|crossing| crossing.1 > at).map(|crossing| crossing.2).sum::<i32>();
            let (x, y) = (cell % width, cell / width);
            let is_around_solid =
                self.columns.at(x, y).iter().all(|[bottom, top]| around((bottom + top) as f64 / 2.0) == 1);
            let gaps = reach.at(x, y).windows(2).map(|pair| (pair[0][1] + pair[1][0]) as f64 / 2.0);
            if !is_around_solid || !gaps.chain([f64::NEG_INFINITY]).all(|gap| around(gap) == 0) {
                return false;
            }
        }
        true
    }
}
