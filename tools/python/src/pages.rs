//! `Pages`: queries on a set of pages, either all pages of an archive or those of a view.

use crate::archive::Opened;
use crate::arrays::{self, batch, batch_of_rows, refused};
use crate::errors::Failure;
use crate::options::{argument, refuse};
use crate::page::{Column, Page, octomap, region};
use crate::reach::{self, Ability};
use crate::seen;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use slicewalk::Result;
use slicewalk::frame::Frame;
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::query::{
    Aabb, Answer, Cylinder, Overlap, Ray, Sphere, cast, ceiling_between, floor_between, nearest_surface, overlaps,
    sweep,
};
use slicewalk::seen::SeenSpace;
use slicewalk::store::Snapshot;
use std::num::NonZeroUsize;
use std::sync::Arc;

/// Source of the pages.
#[derive(Clone)]
pub enum Set {
    /// All pages of an archive; the first query loads them.
    All(Arc<Opened>),
    /// The pages in memory at one moment, and the archive that they are of.
    View(Snapshot, Arc<Opened>),
}

impl Set {
    /// Returns the pages; loads them if they are those of an archive.
    pub fn pages(&self, py: Python<'_>) -> PyResult<&Snapshot> {
        match self {
            Self::All(opened) => opened.pages(py),
            Self::View(view, _) => Ok(view),
        }
    }
}

/// Most memory for seen space by default (bytes).
pub const MOST_SEEN_BYTES: u64 = 1 << 30;

/// Number of threads of a batch; all cores by default.
type Threads = Option<NonZeroUsize>;
/// One answer for each row of a batch.
type Answers<'py, A> = PyResult<Bound<'py, PyArray1<A>>>;

/// A set of pages that answers queries: an :class:`Archive` or the :class:`View` of a :class:`Stream`.
///
/// All coordinates are metres in the archive's reference system. Every method that takes an array of N rows returns an
/// array of N values, lets other Python threads run meanwhile, and uses all cores unless ``threads=`` sets another
/// number. An array of ``float64`` with any strides is read as it is; anything else that numpy converts to ``float64``
/// without loss (``float32``, integers, lists) is converted first. Boxes may also be N × 2 × 3, two corners each. The
/// rows must not change while a method runs. Without memory for the results, a method raises MemoryError.
#[pyclass(frozen, subclass, module = "slicewalk")]
pub struct Pages {
    pub set: Set,
}

fn code(overlap: Overlap) -> u8 {
    match overlap {
        Overlap::Clear => 0,
        Overlap::Hit => 1,
        Overlap::NotLoaded(_) => 2,
    }
}

fn aabb(&[x0, y0, z0, x1, y1, z1]: &[f64; 6]) -> Result<Aabb> {
    Aabb::new([x0, y0, z0].into(), [x1, y1, z1].into())
}

/// Maps "not loaded" to NaN.
fn known<T>(answer: Answer<T>, value: impl FnOnce(T) -> f64) -> f64 {
    answer.known().map_or(f64::NAN, value)
}

impl Pages {
    pub fn frame(&self) -> Frame {
        match &self.set {
            Set::All(opened) => *opened.archive.frame(),
            Set::View(view, _) => *view.frame(),
        }
    }

    /// The archive's name, for errors.
    pub fn name(&self) -> Option<&str> {
        match &self.set {
            Set::All(opened) => opened.name.as_deref(),
            Set::View(..) => None,
        }
    }

    /// The archive that the pages are of.
    fn opened(&self) -> &Opened {
        let (Set::All(opened) | Set::View(_, opened)) = &self.set;
        opened
    }

    /// Returns the seen space in which a pawn must stay, if it must.
    fn seen(&self, py: Python<'_>, must: bool) -> PyResult<Option<Arc<SeenSpace>>> {
        if !must {
            return Ok(None);
        }
        let opened = self.opened();
        let space = opened.seen_space(py, MOST_SEEN_BYTES)?;
        space.map(Some).ok_or_else(|| {
            let reason = match opened.archive.header().level {
                0 => "the archive does not say which space was seen; convert the scan again with free_space=True",
                _ => "overview levels do not say which space was seen; ask the archive itself",
            };
            refuse("seen", reason)
        })
    }
}

#[pymethods]
impl Pages {
    /// Edge of a pixel (m).
    #[getter]
    fn pixel_size(&self) -> f64 {
        self.frame().pixel_m()
    }

    /// Height of a slice (m).
    #[getter]
    fn slice_height(&self) -> f64 {
        self.frame().slice_m()
    }

    /// Unit of stored heights: slice height / 255 (m).
    #[getter]
    fn height_quantum(&self) -> f64 {
        self.frame().quantum_m()
    }

    /// Tests whether closed boxes touch solid.
    ///
    /// Args:
    ///     boxes: N × 6, each ``xmin, ymin, zmin, xmax, ymax, zmax`` (m); a minimum of -inf and a maximum of inf are allowed
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     uint8 of shape (N,): ``CLEAR`` (0), ``HIT`` (1) or ``NOT_LOADED`` (2, in a view of a stream only)
    ///
    /// A box that contains a scanned point is always a hit. A box is clear if it contains no point even after growing
    /// by a pixel in x and y and by a slice in z.
    ///
    /// Raises:
    ///     ParameterError: the shape is wrong, or a row is not a valid box (``row`` of the error has its index)
    ///     ParameterTypeError: the array does not hold numbers
    ///
    /// >>> archive = slicewalk.open("room.slices")
    /// >>> archive.overlaps([[3, 2, 0.5, 3.5, 2.5, 1.8], [-0.1, 2, 0.5, 0.2, 2.5, 1.8]])
    /// array([0, 1], dtype=uint8)
    #[pyo3(signature = (boxes, *, threads=None))]
    fn overlaps<'py>(
        &self,
        boxes: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py, u8> {
        let pages = self.set.pages(boxes.py())?;
        batch(boxes, "boxes", threads, |row| Ok(code(overlaps(pages, &aabb(row)?))))
    }

    /// Tests whether upright cylinders touch solid; see :meth:`overlaps`.
    ///
    /// Args:
    ///     cylinders: N × 5, each ``x, y, z, radius, height`` (m), where x, y, z is the middle of the bottom face
    ///     threads: number of threads; all cores by default
    ///
    /// >>> slicewalk.open("room.slices").overlaps_cylinders([[4, 3, 0.1, 0.25, 1.8], [4, 0.2, 0.1, 0.25, 1.8]])
    /// array([0, 1], dtype=uint8)
    #[pyo3(signature = (cylinders, *, threads=None))]
    fn overlaps_cylinders<'py>(
        &self,
        cylinders: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py, u8> {
        let pages = self.set.pages(cylinders.py())?;
        batch(cylinders, "cylinders", threads, |&[x, y, z, radius, height]: &[f64; 5]| {
            Ok(code(overlaps(pages, &Cylinder::new([x, y, z].into(), radius, height)?)))
        })
    }

    /// Tests whether spheres touch solid; see :meth:`overlaps`.
    ///
    /// Args:
    ///     spheres: N × 4, each ``x, y, z, radius`` (m), where x, y, z is the centre
    ///     threads: number of threads; all cores by default
    ///
    /// >>> slicewalk.open("room.slices").overlaps_spheres([[4, 3, 1.2, 0.5], [4, 3, 0.2, 0.5]])
    /// array([0, 1], dtype=uint8)
    #[pyo3(signature = (spheres, *, threads=None))]
    fn overlaps_spheres<'py>(
        &self,
        spheres: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py, u8> {
        let pages = self.set.pages(spheres.py())?;
        batch(spheres, "spheres", threads, |&[x, y, z, radius]: &[f64; 4]| {
            Ok(code(overlaps(pages, &Sphere::new([x, y, z].into(), radius)?)))
        })
    }

    /// Finds the highest floor in each box: the greatest top of a floor span that lies within the pixels under the box
    /// and between its lower and upper ends.
    ///
    /// Args:
    ///     boxes: N × 6, each ``xmin, ymin, zmin, xmax, ymax, zmax`` (m); zmin may be -inf
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     float64 of shape (N,): heights (m), at most a quantum above the scanned floor; -inf without a floor, nan if
    ///     a page is not loaded
    ///
    /// >>> archive = slicewalk.open("room.slices")
    /// >>> archive.floor([[3, 2, -1, 3.5, 2.5, 2], [30, 2, -1, 31, 3, 2]]).round(2)
    /// array([  0., -inf])
    #[pyo3(signature = (boxes, *, threads=None))]
    fn floor<'py>(
        &self,
        boxes: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py, f64> {
        let pages = self.set.pages(boxes.py())?;
        batch(boxes, "boxes", threads, |row| {
            let answer = floor_between(pages, &aabb(row)?, row[2], row[5]);
            Ok(known(answer, |z| z.unwrap_or(f64::NEG_INFINITY)))
        })
    }

    /// Finds the lowest ceiling in each box: the least underside of a span that lies within the pixels under the box
    /// and between its lower and upper ends.
    ///
    /// Args:
    ///     boxes: N × 6, each ``xmin, ymin, zmin, xmax, ymax, zmax`` (m); zmax may be inf
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     float64 of shape (N,): heights (m), at most a quantum below the scanned ceiling; inf without a ceiling, nan
    ///     if a page is not loaded
    ///
    /// >>> slicewalk.open("room.slices").ceiling([[3, 2, 1, 3.5, 2.5, 9], [3, 2, 3, 3.5, 2.5, 9]]).round(2)
    /// array([2.5, inf])
    #[pyo3(signature = (boxes, *, threads=None))]
    fn ceiling<'py>(
        &self,
        boxes: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py, f64> {
        let pages = self.set.pages(boxes.py())?;
        batch(boxes, "boxes", threads, |row| {
            let answer = ceiling_between(pages, &aabb(row)?, row[2], row[5]);
            Ok(known(answer, |z| z.unwrap_or(f64::INFINITY)))
        })
    }

    /// Computes how far each box can move before its inside meets solid. Exact at any speed: the motion is not sampled.
    ///
    /// Args:
    ///     boxes: N × 9, each ``xmin, ymin, zmin, xmax, ymax, zmax, dx, dy, dz`` (m): a box and its motion
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     float64 of shape (N,): free fraction of the motion, 0 to 1; 1 if nothing is in the way, 0 for a box that
    ///     starts inside solid, nan if a page is not loaded
    ///
    /// >>> archive = slicewalk.open("room.slices")
    /// >>> archive.sweep([[3, 2, 0.5, 3.5, 2.5, 1.8, 0, 1, 0], [3, 2, 0.5, 3.5, 2.5, 1.8, 9, 0, 0]]).round(2)
    /// array([1.  , 0.49])
    #[pyo3(signature = (boxes, *, threads=None))]
    fn sweep<'py>(
        &self,
        boxes: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py, f64> {
        let pages = self.set.pages(boxes.py())?;
        batch(boxes, "boxes", threads, |&[x0, y0, z0, x1, y1, z1, dx, dy, dz]: &[f64; 9]| {
            let motion = Vector3::new(dx, dy, dz);
            if !motion.iter().all(|v| v.is_finite()) {
                return refused("motion", "its numbers must be finite");
            }
            let answer = sweep(pages, &aabb(&[x0, y0, z0, x1, y1, z1])?, motion);
            Ok(known(answer, |hit| hit.map_or(1.0, |hit| hit.fraction)))
        })
    }

    /// Computes the distance along each ray to the first solid.
    ///
    /// Args:
    ///     rays: N × 7, each ``x, y, z, dx, dy, dz, max`` (m): origin, direction of any length except 0, and greatest
    ///         distance (may be inf)
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     float64 of shape (N,): distances (m), 0 for a ray that starts in solid; inf without a hit, nan if a page is
    ///     not loaded
    ///
    /// >>> archive = slicewalk.open("room.slices")
    /// >>> archive.cast([[4, 3, 1.2, 0, 0, -1, 10], [4, 3, 1.2, 1, 0, 0, 2]]).round(2)
    /// array([1.2, inf])
    #[pyo3(signature = (rays, *, threads=None))]
    fn cast<'py>(
        &self,
        rays: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py, f64> {
        let pages = self.set.pages(rays.py())?;
        batch(rays, "rays", threads, |&[x, y, z, dx, dy, dz, max]: &[f64; 7]| {
            let ray = Ray::new(Point3::new(x, y, z), Vector3::new(dx, dy, dz), max)?;
            Ok(known(cast(pages, &ray), |hit| hit.map_or(f64::INFINITY, |hit| hit.distance)))
        })
    }

    /// Finds the nearest place on the surface of solid space for each place, from outside or from inside.
    ///
    /// Args:
    ///     places: N × 3, each ``x, y, z`` (m)
    ///     within: greatest distance (m); a small one is faster
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     :class:`SurfacePoints` of three arrays: ``distance`` (N,), above 0 in free space, below 0 inside solid, inf if
    ///     nothing is within reach, nan if a page is not loaded; ``point`` (N, 3), the place on the surface;
    ///     ``gradient`` (N, 3), the unit vector along which the distance grows, zero on the surface. Point and gradient
    ///     are nan where the distance is inf or nan
    ///
    /// Exact for the spans, whose union is solid space.
    ///
    /// >>> found = slicewalk.open("room.slices").nearest_surfaces([[4, 3, 0.5], [4, 3, 1.2]], 1.0)
    /// >>> found.distance.round(2), found.gradient[0].round(2)
    /// (array([0.5, inf]), array([0., 0., 1.]))
    #[pyo3(signature = (places, within, *, threads=None))]
    fn nearest_surfaces<'py>(
        &self,
        places: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::within)] within: f64,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> PyResult<Bound<'py, PyAny>> {
        if within.is_nan() || within < 0.0 {
            return Err(refuse("within", format!("expected a distance of at least 0, found {within}")));
        }
        let py = places.py();
        let pages = self.set.pages(py)?;
        let rows = batch_of_rows(places, "places", threads, |&place: &[f64; 3]| {
            if !place.iter().all(|v| v.is_finite()) {
                return refused("place", "its numbers must be finite");
            }
            let none = |distance| [distance, f64::NAN, f64::NAN, f64::NAN, f64::NAN, f64::NAN, f64::NAN];
            Ok(match nearest_surface(pages, place.into(), within) {
                Answer::NotLoaded(_) => none(f64::NAN),
                Answer::Known(None) => none(f64::INFINITY),
                Answer::Known(Some(found)) => {
                    let ([x, y, z], [dx, dy, dz]): ([f64; 3], [f64; 3]) = (found.point.into(), found.gradient.into());
                    [found.distance, x, y, z, dx, dy, dz]
                }
            })
        })?;
        py.import("slicewalk._results")?.call_method1("surface_points", (rows,))
    }

    /// Returns the spans of solid at one place, lowest first.
    ///
    /// Raises:
    ///     NotLoadedError: a page of a view is not in memory
    ///
    /// >>> column = slicewalk.open("room.slices").column(4.05, 3.05)
    /// >>> column.tops.round(2), column.obstacle
    /// (array([0. , 2.5]), array([False, False]))
    fn column(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = argument::x)] x: f64,
        #[pyo3(from_py_with = argument::y)] y: f64,
    ) -> PyResult<Column> {
        let pages = self.set.pages(py)?;
        Column::of(pages, x, y).map_err(|failure| failure.raise(py, self.name()))
    }

    /// Returns the keys of all pages, in memory or not: int32 of shape (M, 3), each ``tx, ty, layer``.
    ///
    /// A page holds 64 × 64 pixels and 64 slices; page ``(0, 0, 0)`` begins at the origin.
    ///
    /// >>> slicewalk.open("room.slices").keys()
    /// array([[0, 0, 0],
    ///        [1, 0, 0]], dtype=int32)
    fn keys<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i32>>> {
        let mut keys = Vec::new();
        let pages = self.set.pages(py)?;
        for number in 0..pages.column_count() {
            let (tx, ty, slots) = pages.column_at(number);
            slots.iter().for_each(|slot| keys.extend([tx, ty, slot.layer()]));
        }
        let count = keys.len() / 3;
        keys.into_pyarray(py).reshape([count, 3])
    }

    /// Returns the page of a key, which is a tuple or a row of :meth:`keys`; None if the archive has no such page.
    ///
    /// Raises:
    ///     NotLoadedError: the page is not in memory (views only)
    ///
    /// >>> page = slicewalk.open("room.slices").page((0, 0, 0))
    /// >>> page.occupancy.shape, page.bottoms.dtype, page.bottoms.flags.writeable
    /// ((64, 64), dtype('uint16'), False)
    fn page(&self, py: Python<'_>, key: &Bound<'_, PyAny>) -> PyResult<Option<Page>> {
        let key = arrays::key(key)?;
        let pages = self.set.pages(py)?;
        Page::of(pages, key).map_err(|failure| failure.raise(py, self.name()))
    }

    /// Returns all voxels of a region as arrays.
    ///
    /// Args:
    ///     bounds: ``xmin, ymin, zmin, xmax, ymax, zmax`` (m), or two corners like :attr:`Archive.bounds`; the region
    ///         consists of the voxels that this box meets
    ///
    /// Returns:
    ///     :class:`Region`; ``region.kind`` is uint8 of shape (slices, rows along y, columns along x): 0 empty, 1 floor, 2
    ///     obstacle
    ///
    /// Raises:
    ///     LimitError: the region has more than 2³¹ voxels
    ///     MemoryError: the system lacks memory for them
    ///     NotLoadedError: a page of a view is not in memory
    ///
    /// >>> region = slicewalk.open("room.slices").region((0, 0, 0, 8, 6, 2.5))
    /// >>> region.kind.shape, int((region.kind == 2).any(axis=0).sum())
    /// ((9, 61, 81), 276)
    /// >>> archive = slicewalk.open("room.slices")
    /// >>> archive.region(archive.bounds).occupied.sum() == archive.voxels
    /// np.True_
    fn region<'py>(&self, py: Python<'py>, bounds: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let pages = self.set.pages(py)?;
        region(py, pages, self.name(), bounds)
    }

    /// Returns a region as a tree of OctoMap; see :func:`to_octomap`.
    #[pyo3(name = "_octomap")]
    fn octomap<'py>(&self, py: Python<'py>, bounds: &Bound<'py, PyAny>) -> PyResult<(u64, u64, Bound<'py, PyBytes>)> {
        let pages = self.set.pages(py)?;
        let seen = self.opened().seen_space(py, MOST_SEEN_BYTES)?;
        octomap(py, pages, seen.as_deref(), self.name(), bounds)
    }

    /// Returns the seen space of the archive, also for a view; see :meth:`Archive.seen_space`.
    #[pyo3(name = "_seen_space")]
    fn seen_space(&self, py: Python<'_>) -> PyResult<Option<seen::SeenSpace>> {
        Ok(self.opened().seen_space(py, MOST_SEEN_BYTES)?.map(|space| seen::SeenSpace { space }))
    }

    /// Finds everything that a pawn can reach on foot.
    ///
    /// Args:
    ///     start: ``x, y, z`` of the feet (m); the pawn starts on the first floor below
    ///     pawn: ``"box:WIDTHxDEPTHxHEIGHT"`` or ``"cylinder:RADIUSxHEIGHT"`` (m)
    ///     climb: highest step that the pawn climbs (m)
    ///     max_drop: deepest drop that the pawn takes (m); by default the climb height, so that the pawn gets back
    ///     max_grade: steepest ground that the pawn walks on, as rise over run, over a metre; any by default
    ///     max_ramp: longest ramp without a landing (m): ground steeper than 3 % that is farther than half of this from a
    ///         landing is left out; any by default
    ///     length: length of a pawn that is longer than wide (m): a cylinder drawn out to this length, which drives along
    ///         its heading and turns on the spot
    ///     seen: whether the pawn must stay in seen space (see :meth:`Archive.seen_space`): a place counts only if
    ///         the line through its middle was seen, up to the head, from the climb height or three slices above the
    ///         floor, whichever is more
    ///     progress: called with stage, amount done, total (0 if unknown) and unit
    ///
    /// Returns:
    ///     :class:`Reach`: area, storeys, passages, leaks, and all standing places
    ///
    /// Raises:
    ///     ParameterError: the pawn cannot stand at ``start``, or ``seen`` is True and the archive has no seen space
    ///     NotLoadedError: a page of a view is not in memory
    ///
    /// >>> reach = slicewalk.open("room.slices").reach((4, 3, 0.1))
    /// >>> round(reach.area), len(reach.storeys), reach.places.shape[1]
    /// (40, 1, 4)
    #[expect(clippy::too_many_arguments, reason = "one for each argument in Python")]
    #[pyo3(signature = (start, *, pawn=None, climb=0.35, max_drop=None, max_grade=None, max_ramp=None, length=None, seen=false, progress=None))]
    fn reach<'py>(
        &self,
        start: &Bound<'py, PyAny>,
        pawn: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = argument::climb)] climb: f64,
        #[pyo3(from_py_with = argument::max_drop)] max_drop: Option<f64>,
        #[pyo3(from_py_with = argument::max_grade)] max_grade: Option<f64>,
        #[pyo3(from_py_with = argument::max_ramp)] max_ramp: Option<f64>,
        #[pyo3(from_py_with = argument::length)] length: Option<f64>,
        #[pyo3(from_py_with = argument::seen)] seen: bool,
        #[pyo3(from_py_with = argument::progress)] progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let seen = self.seen(start.py(), seen)?;
        let pawn = reach::pawn(pawn, &Ability { climb, max_drop, max_grade, max_ramp })?;
        reach::reach(self, start, &pawn, length, seen, progress)
    }

    /// Finds a route of a pawn between two places, at most 5 % longer than the shortest.
    ///
    /// Args:
    ///     start: ``x, y, z`` of the feet (m); the pawn starts on the first floor below
    ///     goal: like `start`
    ///     pawn: ``"box:WIDTHxDEPTHxHEIGHT"`` or ``"cylinder:RADIUSxHEIGHT"`` (m)
    ///     climb: highest step that the pawn climbs (m)
    ///     max_drop: deepest drop that the pawn takes (m); the climb height by default
    ///     max_grade, max_ramp, length: as for :meth:`reach`
    ///     seen: whether the pawn must stay in seen space, as for :meth:`reach`
    ///     explain: whether to find what is in the way if no route connects the two, as ``blocked`` of the result. Takes
    ///         up to about 25 times as long as finding all places within twice the straight distance plus 30 m
    ///     progress: called with stage, amount done, total (0 if unknown) and unit
    ///
    /// Returns:
    ///     :class:`Route`: whether there is a route, why not, its length, and its points, which ``Walker.path`` takes
    ///     as waypoints
    ///
    /// Raises:
    ///     ParameterError: ``seen`` is True and the archive has no seen space
    ///     NotLoadedError: a page of a view is not in memory
    ///
    /// >>> route = slicewalk.open("room.slices").route((1, 1, 0.1), (7, 5, 0.1))
    /// >>> route.found, round(route.length, 1)
    /// (True, 7.2)
    #[expect(clippy::too_many_arguments, reason = "one for each argument in Python")]
    #[pyo3(signature = (start, goal, *, pawn=None, climb=0.35, max_drop=None, max_grade=None, max_ramp=None, length=None, seen=false, explain=false, progress=None))]
    fn route<'py>(
        &self,
        start: &Bound<'py, PyAny>,
        goal: &Bound<'py, PyAny>,
        pawn: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = argument::climb)] climb: f64,
        #[pyo3(from_py_with = argument::max_drop)] max_drop: Option<f64>,
        #[pyo3(from_py_with = argument::max_grade)] max_grade: Option<f64>,
        #[pyo3(from_py_with = argument::max_ramp)] max_ramp: Option<f64>,
        #[pyo3(from_py_with = argument::length)] length: Option<f64>,
        #[pyo3(from_py_with = argument::seen)] seen: bool,
        #[pyo3(from_py_with = argument::explain)] explain: bool,
        #[pyo3(from_py_with = argument::progress)] progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let seen = self.seen(start.py(), seen)?;
        let pawn = reach::pawn(pawn, &Ability { climb, max_drop, max_grade, max_ramp })?;
        reach::route(self, [start, goal], &pawn, length, seen, explain, progress)
    }

    fn __repr__(&self) -> String {
        match &self.set {
            Set::All(opened) => opened.described("Pages"),
            Set::View(view, _) => {
                let columns = (0..view.column_count()).map(|number| view.column_at(number).2);
                let (all, there) = columns
                    .flatten()
                    .fold((0, 0), |(all, there), slot| (all + 1, there + usize::from(slot.page().is_some())));
                format!("<slicewalk.View: {there} of {all} pages in memory>")
            }
        }
    }
}

/// Unwraps an answer, or fails with the pages that it needs.
pub fn needs<T>(answer: Answer<T>) -> std::result::Result<T, Failure> {
    match answer {
        Answer::Known(value) => Ok(value),
        Answer::NotLoaded(missing) => Err(missing.into()),
    }
}
