//! A model: the spans of an archive or of a mesh under a tree.

use super::fill::{Columns, fill};
use super::tree::{Item, MOST_ITEMS, MOST_REACH, Tree};
use crate::frame::{Frame, PAGE_QUANTA, TILE_PIXELS};
use crate::raster::{Raster, Triangle};
use crate::store::Snapshot;
use crate::{Error, Result};
use nalgebra::Point3;

/// A span before its place in the tree is known: pixel, lowest and highest quantum.
type PixelInterval = ((i64, i64), (i64, i64));

/// Geometry of a rigid body, as a tree of spans. Memory: about 32 bytes a span.
#[derive(Debug, Clone)]
pub struct Model {
    frame: Frame,
    /// Pixel and quantum at the origin of the tree's coordinates.
    origin: [i64; 3],
    radius: f64,
    tree: Tree,
}

impl Model {
    /// Builds a model of all spans of a set of pages.
    ///
    /// Fails if a page is not in memory or the set exceeds the limits of a model.
    pub fn from_pages(set: &Snapshot) -> Result<Self> {
        // Before a list of them takes more memory than the pages.
        let slots = (0..set.column_count()).flat_map(|number| set.column_at(number).2);
        check_count(slots.filter_map(|slot| slot.page()).map(|page| page.span_count()).sum())?;
        let mut spans: Vec<PixelInterval> = Vec::new();
        for number in 0..set.column_count() {
            let (tx, ty, slots) = set.column_at(number);
            for slot in slots {
                let page = slot.page().ok_or_else(|| {
                    let at = format!("({tx}, {ty}, {})", slot.layer());
                    Error::parameter("model", format!("page {at} is not in memory; make models of resident stores"))
                })?;
                let base = i64::from(slot.layer()) * PAGE_QUANTA;
                for (px, py, column) in page.columns() {
                    let i = i64::from(tx) * TILE_PIXELS + i64::from(px);
                    let j = i64::from(ty) * TILE_PIXELS + i64::from(py);
                    let heights =
                        column.iter().map(|span| (base + i64::from(span.bottom()), base + i64::from(span.top())));
                    spans.extend(heights.map(|heights| ((i, j), heights)));
                }
            }
        }
        Self::new(*set.frame(), spans)
    }

    /// Builds a model of `triangles` (m), rasterised as in a conversion, but without joining spans across gaps.
    /// Triangles without area are left out.
    ///
    /// `solid` fills the interior of closed meshes, by winding number, so bodies may overlap or occur twice. Through a
    /// hole, the fill leaks along the hole's pixels only.
    ///
    /// Fails if a coordinate is not finite or lies beyond the grid, or if the spans, or the pixels of all triangles
    /// together, exceed the limits of a model. Coordinates and pixels are checked before any other work.
    pub fn from_triangles(frame: Frame, triangles: &[Triangle], solid: bool) -> Result<Self> {
        let raster = Raster::new(frame, 90.0);
        look_at_all(&raster, triangles)?;
        let mut columns = Columns::default();
        for placed in triangles.iter().filter_map(|triangle| raster.place(triangle)) {
            let (area, extent) = placed.shadow();
            columns.make_room(area + extent)?;
            let (first, last) = placed.rows();
            (first..=last).for_each(|j| placed.for_each_pixel(j, |i, low, high| columns.add((i, j), (low, high))));
            if solid {
                placed.for_each_crossing(|pixel, height, change| columns.cross(pixel, height, change));
            }
        }
        Self::new(frame, fill(columns))
    }

    fn new(frame: Frame, spans: Vec<PixelInterval>) -> Result<Self> {
        check_count(spans.len())?;
        let ends = |span: &PixelInterval| [(span.0.0, span.0.0 + 1), (span.0.1, span.0.1 + 1), span.1];
        let bounds = [0, 1, 2].map(|axis| {
            let low = spans.iter().map(|span| ends(span)[axis].0).min().unwrap_or(0);
            (low, spans.iter().map(|span| ends(span)[axis].1).max().unwrap_or(0))
        });
        let origin = bounds.map(|(low, high)| low + (high - low) / 2);
        check_reach(&bounds)?;
        let unit = [frame.pixel_m(), frame.pixel_m(), frame.quantum_m()];
        // `check_reach` bounds the difference.
        let local = |value: i64, axis: usize| (value - origin[axis]) as i32;
        let items = spans.iter().map(|&((i, j), (bottom, top))| Item {
            i: local(i, 0),
            j: local(j, 1),
            bottom: local(bottom, 2),
            top: local(top, 2),
        });
        let tree = Tree::new(items.collect(), unit);
        let radius = tree.all().map(|b| (0..3).map(|k| (b.middle[k].abs() + b.half[k]).powi(2)).sum::<f64>());
        let radius = radius.fold(0.0, f64::max).sqrt();
        Ok(Self { frame, origin, radius, tree })
    }

    /// Returns the number of spans.
    pub fn span_count(&self) -> usize {
        self.tree.len()
    }

    /// Returns the memory of the model (bytes).
    pub fn weight_bytes(&self) -> usize {
        self.tree.weight_bytes()
    }

    /// Iterates over the boxes of all spans, least and greatest corner (m), in the model's own coordinates.
    pub fn boxes(&self) -> impl Iterator<Item = (Point3<f64>, Point3<f64>)> {
        let middle = self.middle();
        self.tree.all().map(move |b| {
            let corner = |sign: f64| Point3::from([0, 1, 2].map(|k| middle[k] + b.middle[k] + sign * b.half[k]));
            (corner(-1.0), corner(1.0))
        })
    }

    /// Returns the origin of the tree's coordinates (m).
    pub(super) fn middle(&self) -> Point3<f64> {
        let [i, j, quantum] = self.origin.map(|v| v as f64);
        Point3::new(i * self.frame.pixel_m(), j * self.frame.pixel_m(), quantum * self.frame.quantum_m())
    }

    /// Returns the greatest distance of a span from the middle (m).
    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    pub(super) fn tree(&self) -> &Tree {
        &self.tree
    }
}

/// Fails if a model of so many spans is too large.
fn check_count(spans: usize) -> Result<()> {
    if spans > MOST_ITEMS { Err(too_large("spans", spans, MOST_ITEMS)) } else { Ok(()) }
}

fn too_large(what: &str, value: impl ToString, max: impl ToString) -> Error {
    let what = format!("{what} of a model (give a larger pixel)");
    Error::limit(what, value, max)
}

/// Fails if a model with these bounds (pixels, pixels, quanta) is too long along an axis.
fn check_reach(bounds: &[(i64, i64); 3]) -> Result<()> {
    match bounds.iter().find(|(low, high)| high - low > MOST_REACH) {
        Some((low, high)) => Err(too_large("pixels or quanta along an axis", high - low, MOST_REACH)),
        None => Ok(()),
    }
}

/// Fails if no model can be built from these triangles, before any work is done on them.
fn look_at_all(raster: &Raster, triangles: &[Triangle]) -> Result<()> {
    let mut bounds = [(i64::MAX, i64::MIN); 3];
    let mut pixels = 0.0;
    for (number, triangle) in triangles.iter().enumerate() {
        if !triangle.as_flattened().iter().all(|v| v.is_finite()) {
            let corners =
                format!("triangle {number} of {} (expected finite corners, found {triangle:?})", triangles.len());
            return Err(Error::parameter("model", corners));
        }
        let Some(placed) = raster.place(triangle) else { continue };
        if !placed.is_on_grid() {
            return Err(Error::limit(
                "pixels and slices of a model's coordinates (give larger ones)",
                "more",
                crate::frame::MAX_INDEX,
            ));
        }
        let (low, high) = placed.bounds();
        bounds = [0, 1, 2].map(|axis| (bounds[axis].0.min(low[axis]), bounds[axis].1.max(high[axis])));
        pixels += placed.shadow().0;
    }
    if pixels > MOST_ITEMS as f64 {
        return Err(too_large("pixels of all triangles", format!("{pixels:.0}"), MOST_ITEMS));
    }
    if bounds[0].0 <= bounds[0].1 { check_reach(&bounds) } else { Ok(()) }
}
