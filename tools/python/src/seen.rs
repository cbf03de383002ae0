//! `SeenSpace`: which places, boxes and rays the scanners saw.

use crate::arrays::{Rows, batch, is_masked, numeric, refused};
use crate::options::{argument, refuse};
use numpy::{PyArray1, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use slicewalk::query::{Aabb, Ray};
use slicewalk::seen::{CELL_PIXELS, SeenSpace as Space};
use std::num::NonZeroUsize;
use std::sync::Arc;

/// Number of threads of a batch; all cores by default.
type Threads = Option<NonZeroUsize>;
/// One answer for each row of a batch.
type Answers<'py> = PyResult<Bound<'py, PyArray1<bool>>>;

/// Space that the scanners saw, from :meth:`Archive.seen_space`; in memory, and usable from many threads at once.
///
/// Space is divided into cells of 4 × 4 pixels and one slice. A cell is stored as seen only if one station looked
/// through all of it; of all other cells nothing is known. The cells of a surface and about two in front of it are
/// never seen, so a box beside a wall is not seen, either. What is outside the scan is not seen.
///
/// A box that is clear and seen is free; one that is clear and not seen may hold solid that was never scanned:
///
/// >>> archive = slicewalk.open("seen.slices")
/// >>> boxes = np.array([[3, 2, 0.9, 3.5, 2.5, 1.4], [30, 2, 0.9, 30.5, 2.5, 1.4]])
/// >>> archive.overlaps(boxes) == slicewalk.CLEAR
/// array([ True,  True])
/// >>> archive.seen_space().boxes(boxes)
/// array([ True, False])
#[pyclass(frozen, module = "slicewalk")]
pub struct SeenSpace {
    pub space: Arc<Space>,
}

#[pymethods]
impl SeenSpace {
    /// Number of seen cells.
    #[getter]
    fn cells(&self) -> u64 {
        self.space.cells()
    }

    /// Size of a cell along x, y and z (m).
    #[getter]
    fn cell_size(&self) -> (f64, f64, f64) {
        let frame = self.space.frame();
        let across = CELL_PIXELS as f64 * frame.pixel_m();
        (across, across, frame.slice_m())
    }

    /// Tests whether places were seen.
    ///
    /// Args:
    ///     places: N × 3, each ``x, y, z`` (m)
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     bool of shape (N,)
    ///
    /// Raises:
    ///     ParameterError: the shape is wrong, or a number is not finite (``row`` of the error has its index)
    ///     ParameterTypeError: the array does not hold numbers
    ///
    /// >>> slicewalk.open("seen.slices").seen_space().places([[3, 2, 1.2], [3, 2, -0.5]])
    /// array([ True, False])
    #[pyo3(signature = (places, *, threads=None))]
    fn places<'py>(
        &self,
        places: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py> {
        batch(places, "places", threads, |&place: &[f64; 3]| match place.iter().all(|v| v.is_finite()) {
            true => Ok(self.space.is_seen(place.into())),
            false => refused("place", "its numbers must be finite"),
        })
    }

    /// Tests whether all of each closed box was seen.
    ///
    /// Args:
    ///     boxes: N × 6 as for :meth:`Pages.overlaps`
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     bool of shape (N,). A box costs as much as the seen part of it: the test ends at the first cell that was not
    ///     seen
    ///
    /// Raises:
    ///     ParameterError: the shape is wrong, or a row is not a valid box (``row`` of the error has its index)
    ///     ParameterTypeError: the array does not hold numbers
    ///
    /// >>> slicewalk.open("seen.slices").seen_space().boxes([[1, 2, 0.9, 3, 4, 1.4], [1, 2, 0.9, 3, 40, 1.4]])
    /// array([ True, False])
    #[pyo3(signature = (boxes, *, threads=None))]
    fn boxes<'py>(
        &self,
        boxes: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py> {
        batch(boxes, "boxes", threads, |&[x0, y0, z0, x1, y1, z1]: &[f64; 6]| {
            let shape = Aabb::new([x0, y0, z0].into(), [x1, y1, z1].into())?;
            Ok(self.space.is_box_seen(shape.min(), shape.max()))
        })
    }

    /// Tests whether the middle of each pawn was seen, as a pawn that must stay in seen space does: N × 5, its feet, what it
    /// climbs, and its height (m).
    #[pyo3(name = "_pawns")]
    fn pawns<'py>(&self, pawns: &Bound<'py, PyAny>) -> Answers<'py> {
        batch(pawns, "pawns", None, |&[x, y, z, climb, height]: &[f64; 5]| {
            Ok(self.space.is_pawn_seen([x, y, z].into(), climb, height))
        })
    }

    /// Tests whether all of each ray was seen, up to its hit or its greatest distance.
    ///
    /// Args:
    ///     rays: N × 7 as for :meth:`Pages.cast`; copied once
    ///     distances: what :meth:`Pages.cast` returns for these rays, or one number for all; by default inf, no hit
    ///     threads: number of threads; all cores by default
    ///
    /// Returns:
    ///     bool of shape (N,). The two cells before a hit count as seen, along each axis, because none is stored so
    ///     near to a surface. False where the distance is nan (not loaded), and for an endless ray without a hit
    ///
    /// Raises:
    ///     ParameterError: the shape is wrong, or a row is not a valid ray or distance (``row`` of the error has its index)
    ///     ParameterTypeError: the arrays do not hold numbers
    ///
    /// >>> archive = slicewalk.open("seen.slices")
    /// >>> rays = [[4, 2, 1.2, -1, 0, 0, 9], [4, 2, 1.2, -1, 0, 0, 0.5], [30, 2, 1.2, 1, 0, 0, 9]]
    /// >>> archive.seen_space().rays(rays, archive.cast(rays))
    /// array([ True,  True, False])
    #[pyo3(signature = (rays, distances=None, *, threads=None))]
    fn rays<'py>(
        &self,
        rays: &Bound<'py, PyAny>,
        distances: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = argument::threads)] threads: Threads,
    ) -> Answers<'py> {
        let numpy = rays.py().import("numpy")?;
        let rows = Rows::<7>::of(rays, "rays")?;
        let count = rows.len();
        let distances = match distances {
            Some(given) if is_masked(given)? => {
                return Err(refuse(
                    "distances",
                    "expected numbers, found masked ones; fill them, with nan for no answer",
                ));
            }
            Some(given) => numeric(&numpy, given, "distances", || format!("{count} numbers, or one"))?,
            None => numpy.call_method1("asarray", (f64::INFINITY,))?,
        };
        let untyped = distances.cast::<PyUntypedArray>()?;
        if untyped.ndim() > 0 && untyped.shape() != [count] {
            let found = untyped.getattr("shape")?.str()?;
            return Err(refuse("distances", format!("expected shape ({count},), found {found}")));
        }
        let distances = numpy.call_method1("broadcast_to", (&distances, (count,)))?;
        let both = numpy.call_method1("column_stack", ((rows.array(), distances),))?;
        batch(&both, "rays", threads, |&[x, y, z, dx, dy, dz, max, distance]: &[f64; 8]| {
            let ray = Ray::new([x, y, z].into(), [dx, dy, dz].into(), max)?;
            if distance < 0.0 {
                return refused("distance", "expected 0 or more");
            }
            let hits = distance <= ray.max();
            let length = if hits { distance } else { ray.max() };
            Ok(!distance.is_nan() && self.space.is_ray_seen(ray.origin(), ray.direction(), length, hits))
        })
    }

    fn __repr__(&self) -> String {
        let (across, _, high) = self.cell_size();
        format!("<slicewalk.SeenSpace: {} cells of {across} × {across} × {high} m>", self.space.cells())
    }
}
