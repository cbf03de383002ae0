//! Occupied space as arrays: the column at one place, a page, a region.
//!
//! Pages store their spans packed in bits. A column or page is unpacked once into its own memory; its arrays are
//! read-only views of that memory.

use crate::arrays::{lend, numbers};
use crate::attend::CheckTimer;
use crate::errors::Failure;
use numpy::ndarray::{Array1, Array2, ArrayViewMut3};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use slicewalk::Error;
use slicewalk::frame::{Frame, PAGE_QUANTA, PAGE_SLICES, PageKey, SLICE_QUANTA, TILE_PIXELS};
use slicewalk::page::Span;
use slicewalk::seen::{CELL_PIXELS, SeenSpace};
use slicewalk::store::Snapshot;
use slicewalk_cube::{FreeCubes, OctomapTree, SpanCubes};

/// Most voxels of a region.
const MOST_VOXELS: i64 = 1 << 31;

fn absent(key: PageKey) -> Failure {
    Failure::NotLoaded(vec![key])
}

/// Spans of solid at one place, lowest first; see :meth:`Pages.column`.
#[pyclass(frozen, module = "slicewalk")]
pub struct Column {
    bottoms: Array1<f64>,
    tops: Array1<f64>,
    obstacle: Array1<bool>,
}

impl Column {
    pub fn of(set: &Snapshot, x: f64, y: f64) -> Result<Self, Failure> {
        if let Some((name, found)) = [("x", x), ("y", y)].into_iter().find(|(_, value)| !value.is_finite()) {
            return Err(Error::parameter(name, format!("expected a finite number, found {found}")).into());
        }
        let frame = set.frame();
        let (i, j) = (frame.pixel_of(x), frame.pixel_of(y));
        let mut spans: Vec<(i64, i64, bool)> = Vec::new();
        if let (Ok(tx), Ok(ty)) = (i32::try_from(i.div_euclid(TILE_PIXELS)), i32::try_from(j.div_euclid(TILE_PIXELS))) {
            let pixel = |index: i64| index.rem_euclid(TILE_PIXELS) as u32;
            for slot in set.column(tx, ty) {
                let key = PageKey { tx, ty, layer: slot.layer() };
                let page = slot.page().ok_or_else(|| absent(key))?;
                let base = i64::from(slot.layer()) * PAGE_QUANTA;
                for span in page.column(pixel(i), pixel(j)) {
                    let (bottom, top) = (base + i64::from(span.bottom()), base + i64::from(span.top()));
                    match spans.last_mut() {
                        // Solid that continues into the next page is one span.
                        Some(last) if last.1 == bottom && bottom == base && last.2 == span.is_obstacle() => {
                            last.1 = top
                        }
                        _ => spans.push((bottom, top, span.is_obstacle())),
                    }
                }
            }
        }
        Ok(Self {
            bottoms: spans.iter().map(|span| frame.bottom_height(span.0)).collect(),
            tops: spans.iter().map(|span| frame.top_height(span.1)).collect(),
            obstacle: spans.iter().map(|span| span.2).collect(),
        })
    }
}

/// Array on a field of `owner`, which never changes after it is made.
macro_rules! view {
    ($owner:expr, $field:ident) => {
        // SAFETY: the object is frozen and its arrays are private, so they neither move nor change while it lives.
        unsafe { lend(&$owner.get().$field, $owner.clone().into_any()) }
    };
}

#[pymethods]
impl Column {
    /// Lower ends: float64 of shape (n,) (m), read-only.
    #[getter]
    fn bottoms<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        view!(this, bottoms)
    }

    /// Upper ends: float64 of shape (n,) (m), read-only.
    #[getter]
    fn tops<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        view!(this, tops)
    }

    /// Whether each span is steeper than the slope limit: bool of shape (n,), read-only.
    #[getter]
    fn obstacle<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<bool>>> {
        view!(this, obstacle)
    }

    fn __len__(&self) -> usize {
        self.tops.len()
    }

    fn __repr__(&self) -> String {
        format!("<slicewalk.Column of {} spans>", self.tops.len())
    }
}

/// One tile column of 64 × 64 pixels and 64 slices; see :meth:`Pages.page`.
///
/// The spans of pixel ``(x, y)`` are those from ``starts[64 * y + x]`` to ``starts[64 * y + x + 1]``, lowest first.
/// Heights are in quanta (``height_quantum``) above the page's floor: ``origin[2] + tops * height_quantum`` (m). All
/// arrays are read-only views of the page's own memory: reading them copies nothing, and they stay valid after the
/// archive is gone. Solid that continues into the page above or below is cut at the border into one span in each page;
/// :meth:`Pages.column` joins them.
#[pyclass(frozen, module = "slicewalk")]
pub struct Page {
    key: PageKey,
    frame: Frame,
    occupancy: Array2<u64>,
    starts: Array1<u32>,
    bottoms: Array1<u16>,
    tops: Array1<u16>,
    obstacle: Array1<bool>,
}

impl Page {
    pub fn of(set: &Snapshot, key: PageKey) -> Result<Option<Self>, Failure> {
        let Some(slot) = set.column(key.tx, key.ty).iter().find(|slot| slot.layer() == key.layer) else {
            return Ok(None);
        };
        let page = slot.page().ok_or_else(|| absent(key))?;
        let edge = TILE_PIXELS as usize;
        let mut occupancy = Array2::zeros((edge, edge));
        let (mut starts, mut spans) = (vec![0; 1], Vec::with_capacity(page.span_count()));
        for (py, px) in (0..edge as u32).flat_map(|py| (0..edge as u32).map(move |px| (py, px))) {
            let column = page.column(px, py);
            occupancy[[py as usize, px as usize]] = column.iter().fold(0, |mask, span| mask | span.slice_mask());
            spans.extend_from_slice(column);
            starts.push(spans.len() as u32);
        }
        Ok(Some(Self {
            key,
            frame: *set.frame(),
            occupancy,
            starts: starts.into(),
            bottoms: spans.iter().map(|span| span.bottom() as u16).collect(),
            tops: spans.iter().map(|span| span.top() as u16).collect(),
            obstacle: spans.iter().map(|span| span.is_obstacle()).collect(),
        }))
    }
}

#[pymethods]
impl Page {
    /// Key of the page: ``tx, ty, layer``.
    #[getter]
    fn key(&self) -> (i32, i32, i32) {
        (self.key.tx, self.key.ty, self.key.layer)
    }

    /// Lowest corner of the page (m).
    #[getter]
    fn origin(&self) -> (f64, f64, f64) {
        let edge = |tile: i32| self.frame.edge_of_pixel(i64::from(tile) * TILE_PIXELS);
        let floor = self.frame.bottom_of_slice(i64::from(self.key.layer) * PAGE_SLICES);
        (edge(self.key.tx), edge(self.key.ty), floor)
    }

    /// Occupied slices as bits, bit 0 the lowest: uint64 of shape (64, 64), rows along y, read-only.
    #[getter]
    fn occupancy<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<u64>>> {
        view!(this, occupancy)
    }

    /// Index of the first span of each pixel: uint32 of shape (4097,), read-only.
    #[getter]
    fn starts<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<u32>>> {
        view!(this, starts)
    }

    /// Lower ends of all spans: uint16 of shape (n,) (quanta above the page's floor), read-only.
    #[getter]
    fn bottoms<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<u16>>> {
        view!(this, bottoms)
    }

    /// Upper ends of all spans: uint16 of shape (n,) (quanta above the page's floor), read-only.
    #[getter]
    fn tops<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<u16>>> {
        view!(this, tops)
    }

    /// Whether each span is steeper than the slope limit: bool of shape (n,), read-only.
    #[getter]
    fn obstacle<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<bool>>> {
        view!(this, obstacle)
    }

    fn __repr__(&self) -> String {
        format!("<slicewalk.Page ({}, {}, {}): {} spans>", self.key.tx, self.key.ty, self.key.layer, self.tops.len())
    }
}

/// First and last slice, row and column of a box.
type Extent = [[i64; 3]; 2];

/// Returns the voxels that the box `bounds` meets.
fn extent(frame: &Frame, bounds: &Bound<'_, PyAny>, wrong: impl Fn(Error) -> PyErr) -> PyResult<Extent> {
    let [x0, y0, z0, x1, y1, z1] = numbers(bounds, "bounds")?;
    if x0 > x1 || y0 > y1 || z0 > z1 {
        let reason = "expected xmin, ymin, zmin, xmax, ymax, zmax in order";
        return Err(wrong(Error::parameter("bounds", reason)));
    }
    let of = |[x, y, z]: [f64; 3]| [frame.slice_of(z), frame.pixel_of(y), frame.pixel_of(x)];
    Ok([of([x0, y0, z0]), of([x1, y1, z1])])
}

/// Returns the voxels that the box `bounds` meets, as `slicewalk.Region`.
pub fn region<'py>(
    py: Python<'py>,
    set: &Snapshot,
    name: Option<&str>,
    bounds: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let frame = *set.frame();
    let wrong = |error: Error| Failure::from(error).raise(py, name);
    let [first, last] = extent(&frame, bounds, wrong)?;
    let count = [0, 1, 2].map(|axis| last[axis] - first[axis] + 1);
    let voxels = count.iter().try_fold(1i64, |product, count| product.checked_mul(*count));
    if voxels.is_none_or(|voxels| voxels > MOST_VOXELS) {
        let value = format!("{} × {} × {}", count[0], count[1], count[2]);
        return Err(wrong(Error::limit("voxels of a region (take a smaller one)", value, MOST_VOXELS)));
    }
    let shape = count.map(|count| count as usize);
    let zeros = py.import("numpy")?.getattr("zeros")?;
    // Allocated by numpy: it raises MemoryError, and zeroed memory that is never written costs nothing.
    let zeros = || PyResult::Ok(zeros.call1((shape, "u1"))?.cast_into::<PyArray3<u8>>()?);
    let [kind, bottom, top] = [zeros()?, zeros()?, zeros()?];
    // SAFETY: the arrays are new, and nothing else refers to them.
    let mut arrays = unsafe { [kind.as_array_mut(), bottom.as_array_mut(), top.as_array_mut()] };
    let fill = |[i, j]: [i64; 2], base: i64, span: Span| fill(&mut arrays, [first, last], [i, j], base, span);
    py.detach(|| each_span(set, [first, last], fill)).map_err(|failure| failure.raise(py, name))?;
    py.import("slicewalk._results")?.getattr("Region")?.call1((
        kind,
        bottom,
        top,
        (first[2], first[1], first[0]),
        frame.pixel_m(),
        frame.slice_m(),
    ))
}

/// Enters the slices of a span into the arrays of a region.
fn fill(arrays: &mut [ArrayViewMut3<'_, u8>; 3], [first, last]: Extent, [i, j]: [i64; 2], base: i64, span: Span) {
    let (lowest, highest) = span.slices();
    for k in (lowest..=highest).filter(|k| (first[0]..=last[0]).contains(&(base + i64::from(*k)))) {
        let at = [base + i64::from(k) - first[0], j - first[1], i - first[2]].map(|v| v as usize);
        let (bottom, top) = span.within_slice(k).unwrap_or((0, 0));
        let [kinds, bottoms, tops] = &mut *arrays;
        let was_empty = kinds[at] == 0;
        bottoms[at] = if was_empty { bottom } else { bottoms[at].min(bottom) };
        tops[at] = tops[at].max(top);
        kinds[at] = kinds[at].max(if span.is_obstacle() { 2 } else { 1 });
    }
}

/// Returns the voxels that the box `bounds` meets as a tree of OctoMap, and its seen space as free cubes: the numbers of
/// occupied and free cubes, and the file.
pub fn octomap<'py>(
    py: Python<'py>,
    set: &Snapshot,
    seen: Option<&SeenSpace>,
    name: Option<&str>,
    bounds: &Bound<'py, PyAny>,
) -> PyResult<(u64, u64, Bound<'py, PyBytes>)> {
    let wrong = |error: Error| Failure::from(error).raise(py, name);
    let [first, last] = extent(set.frame(), bounds, wrong)?;
    let made = py.detach(|| {
        let within = [first, last].map(|[z, y, x]| [x, y, z]);
        let (mut timer, mut checked) = (CheckTimer::start(), Ok(()));
        let runs = seen.into_iter().flat_map(SeenSpace::runs).take_while(|_| {
            checked = timer.check();
            checked.is_ok()
        });
        let free = FreeCubes::new(set.frame(), CELL_PIXELS, runs, Some(within));
        checked?;
        let (mut tree, cubes) = (OctomapTree::new().with_free(free), SpanCubes::of(set.frame()));
        each_span(set, [first, last], |pixel, base, span| {
            let (lowest, highest) = span.slices();
            if base + i64::from(highest) < first[0] || base + i64::from(lowest) > last[0] {
                return;
            }
            let bottom = base * SLICE_QUANTA + i64::from(span.bottom());
            let top = base * SLICE_QUANTA + i64::from(span.top());
            let ends = (first[0] * SLICE_QUANTA, (last[0] + 1) * SLICE_QUANTA);
            tree.occupy(pixel, cubes.of_span(bottom.max(ends.0), top.min(ends.1)));
        })?;
        while tree.encode_next() {
            timer.check()?;
        }
        let tree = tree.finish(set.frame().pixel_m()).ok_or_else(|| {
            let most = OctomapTree::MOST_CUBES;
            Error::limit("cubes along an axis of an OctoMap tree (take a smaller region)", format!("over {most}"), most)
        })?;
        let mut file = Vec::new();
        tree.write(&mut file).map_err(|error| Failure::Raised(error.into()))?;
        Ok::<_, Failure>((tree.occupied, tree.free, file))
    });
    let (occupied, free, file) = made.map_err(|failure| failure.raise(py, name))?;
    Ok((occupied, free, PyBytes::new(py, &file)))
}

/// Calls `give` with pixel, first slice of the page, and span of everything in the pixels of an extent, tile by tile.
/// Called with the interpreter released; takes it to check for Ctrl-C.
fn each_span(set: &Snapshot, [first, last]: Extent, mut give: impl FnMut([i64; 2], i64, Span)) -> Result<(), Failure> {
    let mut timer = CheckTimer::start();
    let Some(bounds) = set.bounds() else { return Ok(()) };
    let tiles = |axis: usize, own: usize| {
        let (least, most) = (i64::from(bounds.min[own]), i64::from(bounds.max[own]));
        (first[axis].div_euclid(TILE_PIXELS).max(least), last[axis].div_euclid(TILE_PIXELS).min(most))
    };
    let ((tx0, tx1), (ty0, ty1)) = (tiles(2, 0), tiles(1, 1));
    for (ty, tx) in (ty0..=ty1).flat_map(|ty| (tx0..=tx1).map(move |tx| (ty as i32, tx as i32))) {
        for slot in set.column(tx, ty) {
            let base = i64::from(slot.layer()) * PAGE_SLICES;
            let slices = slot.slices();
            let in_range = |k: u32| slices >> k & 1 == 1 && (first[0]..=last[0]).contains(&(base + i64::from(k)));
            if !(0..64).any(in_range) {
                continue;
            }
            let page = slot.page().ok_or_else(|| absent(PageKey { tx, ty, layer: slot.layer() }))?;
            let corner = [i64::from(ty) * TILE_PIXELS, i64::from(tx) * TILE_PIXELS];
            for (px, py, spans) in page.columns() {
                timer.check()?;
                let (i, j) = (corner[1] + i64::from(px), corner[0] + i64::from(py));
                if !(first[2]..=last[2]).contains(&i) || !(first[1]..=last[1]).contains(&j) {
                    continue;
                }
                for span in spans {
                    give([i, j], base, *span);
                }
            }
        }
    }
    Ok(())
}
