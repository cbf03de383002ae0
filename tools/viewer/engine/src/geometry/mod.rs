//! Geometry of a page for drawing: tops, undersides and sides of its spans as quads.
//!
//! In: a page, and the width of a drawing's cell in pixels. Out: quads on a grid of cells and of vertical steps of a
//! quarter of a cell, or of quanta where surfaces are smooth. Every page is a closed surface: neighbours need not be in
//! memory, and adjacent pages of another detail leave no gap.

mod cells;
mod quads;
mod smooth;

use cells::Cells;
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey, SLICE_QUANTA, TILE_PIXELS};
use slicewalk::page::Page;
use smooth::Smooth;

/// Largest cell, as a power of two of pixels.
pub(crate) const COARSEST: u32 = 4;

/// Quads of one page. Positions count cells from the page's corner and steps from its floor.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// Lowest corner (m), the point of position zero.
    pub origin: [f64; 3],
    /// Length of a cell along x and y, and of a step (m).
    pub scale: [f64; 3],
    /// Lowest and highest corner of the solid (m).
    pub bounds: [[f64; 3]; 2],
    /// Three per vertex, four vertices per quad, counterclockwise seen from outside.
    pub positions: Vec<u16>,
    /// Four per vertex: normal, and zero.
    pub normals: Vec<i8>,
    /// Four per vertex: face (0 top, 1 underside, 2 side), obstacle, slope (degrees), zero.
    pub attributes: Vec<u8>,
}

impl Geometry {
    /// Builds the geometry of `page` with cells of `2^coarseness` pixels: what collides, or if there are pages `around`
    /// it (see `Cells::of`), with smooth surfaces, and larger cells where points lie apart.
    pub fn of(frame: &Frame, key: PageKey, page: &Page, around: Option<&[Option<&Page>; 9]>, coarseness: u32) -> Self {
        let sparseness = around.map_or(0, |_| smooth::sparseness(page));
        let coarseness = coarseness.max(sparseness).min(COARSEST);
        let pixels = f64::from(1 << coarseness);
        let cell_m = frame.pixel_m() * pixels;
        let step = (cell_m / 4.0 / frame.quantum_m()).round().clamp(1.0, PAGE_QUANTA as f64) as u32;
        let mut cells = Cells::of(page, around, coarseness, step);
        let step_cells = f64::from(step) * frame.quantum_m() / cell_m;
        let smooth = around.map(|_| Smooth::new(cell_m, step, step_cells));
        smooth.iter().for_each(|smooth| smooth.close_holes(&mut cells, sparseness > 0));
        let mut faces = Faces { step_cells, smooth, ..Faces::default() };
        quads::levels(&cells, true, &mut faces);
        quads::levels(&cells, false, &mut faces);
        quads::sides(&cells, &mut faces);
        let origin = [
            frame.edge_of_pixel(i64::from(key.tx) * TILE_PIXELS),
            frame.edge_of_pixel(i64::from(key.ty) * TILE_PIXELS),
            frame.bottom_of_slice(i64::from(key.layer) * PAGE_QUANTA / SLICE_QUANTA),
        ];
        let bounds = page.bounds().map_or([origin; 2], |bounds| {
            let at = |[x, y, z]: [u32; 3], end: u32| {
                let side = |pixel: u32| f64::from(pixel + end) * frame.pixel_m();
                [origin[0] + side(x), origin[1] + side(y), origin[2] + f64::from(z) * frame.quantum_m()]
            };
            [at(bounds.min, 0), at(bounds.max, 1)]
        });
        let z_quanta = if smooth.is_some() { 1 } else { step };
        let scale = [cell_m, cell_m, f64::from(z_quanta) * frame.quantum_m()];
        let Faces { positions, normals, attributes, .. } = faces;
        Self { origin, scale, bounds, positions, normals, attributes }
    }

    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.positions.len() / 6
    }
}

/// Kinds of faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Face {
    Top = 0,
    Underside = 1,
    Side = 2,
}

/// Collector of quads.
#[derive(Debug, Default)]
struct Faces {
    /// Height of a step in cells.
    step_cells: f64,
    smooth: Option<Smooth>,
    positions: Vec<u16>,
    normals: Vec<i8>,
    attributes: Vec<u8>,
}

impl Faces {
    /// Adds a quad with these corners (z in steps), counterclockwise seen from where `normal` points.
    fn quad(&mut self, corners: [[u16; 3]; 4], normal: [i8; 3], attributes: [u8; 3]) {
        let step = self.smooth.map_or(1, |smooth| smooth.step as u16);
        self.bent(corners.map(|[x, y, z]| [x, y, z * step]), [normal; 4], attributes);
    }

    /// Adds a quad whose corners have normals of their own, and z in units of the geometry.
    fn bent(&mut self, corners: [[u16; 3]; 4], normals: [[i8; 3]; 4], attributes: [u8; 3]) {
        for (corner, normal) in corners.into_iter().zip(normals) {
            self.positions.extend(corner);
            self.normals.extend([normal[0], normal[1], normal[2], 0]);
            self.attributes.extend([attributes[0], attributes[1], attributes[2], 0]);
        }
    }
}

#[cfg(test)]
mod tests;
