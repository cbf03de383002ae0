//! `Writer`: an archive of points from numpy, batch by batch.

use crate::arrays::{BLOCK, Rows};
use crate::attend::{Audience, attended};
use crate::convert::dictionary;
use crate::errors::{Failure, plain};
use crate::options::{Asked, argument, refuse};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slicewalk_convert::{PointWriter, Turn};
use std::path::PathBuf;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Writes an archive of points in memory, in batches of any size and order and with bounded memory.
///
/// As a context manager it publishes the archive at the end of the block, or writes nothing if the block raises. The
/// archive has the bytes that :func:`convert` would write for a file of the same points in metres.
///
/// Args:
///     output: the archive to write
///     pixel: edge of a pixel (m)
///     crs: coordinate reference system of the points (WKT, or any other text)
///     options: ``slice, max_slope, tolerance, classifier, memory, threads, temp_dir, min_points, drop_isolated, drop_floaters, fill_holes, up, levels, force``
///         as for :func:`convert`, but `up` is ``"z"`` or ``"y"``, and `tolerance` and `fill_holes` are in metres
///
/// Raises:
///     OutputError: the archive exists already (``force=True`` replaces it)
///     ParameterError: an option is invalid
///
/// >>> with slicewalk.Writer("floor.slices", pixel=0.1, force=True) as writer:
/// ...     for y in range(4):
/// ...         writer.write([[x / 20, y / 20, 0] for x in range(100)])
/// >>> slicewalk.open("floor.slices").voxels
/// 100
#[pyclass(frozen, module = "slicewalk")]
pub struct Writer {
    writer: Mutex<Option<PointWriter>>,
    report: Mutex<Option<Py<PyAny>>>,
    output: PathBuf,
    /// Points of a writer that is finished or discarded.
    points: AtomicU64,
}

/// Options that do not concern input files.
const OPTIONS: [&str; 15] = [
    "slice",
    "max_slope",
    "tolerance",
    "classifier",
    "memory",
    "threads",
    "temp_dir",
    "min_points",
    "drop_isolated",
    "drop_floaters",
    "fill_holes",
    "up",
    "levels",
    "force",
    "crs",
];

impl Writer {
    /// Takes the writer and ends it; the count of points is kept.
    fn take(&self) -> Option<PointWriter> {
        let writer = self.lock().take();
        if let Some(writer) = &writer {
            self.points.store(writer.points(), Relaxed);
        }
        writer
    }

    fn lock(&self) -> MutexGuard<'_, Option<PointWriter>> {
        self.writer.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn ended() -> PyErr {
    plain("ClosedError", "the writer has ended: write to another one")
}

#[pymethods]
impl Writer {
    #[new]
    #[pyo3(signature = (output, *, pixel, **options))]
    fn new(
        py: Python<'_>,
        #[pyo3(from_py_with = argument::output)] output: PathBuf,
        pixel: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        Asked::refuse(options, |name| OPTIONS.contains(&name))?;
        let options = options.map_or_else(|| Ok(PyDict::new(py)), |options| options.copy())?;
        options.set_item("pixel", pixel)?;
        let asked = Asked::new(Vec::new(), output.clone(), Some(&options))?;
        if asked.options.reading.turn != Turn::None {
            let reason = "expected \"z\" or \"y\": a writer does not turn points; turn them before they are written";
            return Err(refuse("up", reason));
        }
        // The output may lie in an object store, which may be slow.
        let writer =
            attended(py, &Audience::default(), None, |_| Ok(PointWriter::create(&asked.options, &asked.crs)?))?;
        Ok(Self { writer: Mutex::new(Some(writer)), report: Mutex::default(), output, points: AtomicU64::new(0) })
    }

    /// Adds points.
    ///
    /// Args:
    ///     points: N × 3 (m); rows with a coordinate that is not finite or beyond 10¹² m are counted and left out
    ///
    /// Raises:
    ///     LimitError: a coordinate is beyond the range of a grid with this pixel size
    fn write(&self, points: &Bound<'_, PyAny>) -> PyResult<()> {
        let py = points.py();
        let rows = Rows::<3>::of(points, "points")?;
        let mut block = Vec::new();
        for first in (0..rows.len()).step_by(BLOCK) {
            py.check_signals()?;
            rows.copy(first, BLOCK.min(rows.len() - first), &mut block)?;
            py.detach(|| {
                let column = |axis: usize| block.iter().map(|point| point[axis]).collect::<Vec<_>>();
                self.lock().as_mut().map(|writer| writer.push(&column(0), &column(1), &column(2)))
            })
            .ok_or_else(ended)?
            .map_err(Failure::from)?;
        }
        Ok(())
    }

    /// Number of points added to the archive, including those left out.
    #[getter]
    fn points(&self, py: Python<'_>) -> u64 {
        py.detach(|| self.lock().as_ref().map_or_else(|| self.points.load(Relaxed), PointWriter::points))
    }

    /// Publishes the archive and ends the writer.
    ///
    /// Returns:
    ///     the dict that ``sliceconv --json`` prints; ``report`` returns it from then on
    ///
    /// Raises:
    ///     ParameterError: points were added, but all of them are left out
    #[pyo3(signature = (progress=None))]
    fn finish<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = argument::progress)] progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let writer = py.detach(|| self.take()).ok_or_else(ended)?;
        let audience = Audience { progress, ..Audience::default() };
        let report = attended(py, &audience, None, |monitor| Ok(writer.finish(monitor)?))?;
        let facts = dictionary(py, &report.info())?;
        *self.report.lock().unwrap_or_else(PoisonError::into_inner) = Some(facts.clone().unbind());
        Ok(facts)
    }

    /// Result of :meth:`finish`; None before.
    #[getter]
    fn report(&self, py: Python<'_>) -> Option<Py<PyAny>> {
        self.report.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(|report| report.clone_ref(py))
    }

    /// Ends the writer; no archive is written.
    fn discard(&self, py: Python<'_>) {
        py.detach(|| drop(self.take()));
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let state = if py.detach(|| self.lock().is_some()) { "open" } else { "ended" };
        format!("<slicewalk.Writer {:?}: {} points, {state}>", self.output, self.points(py))
    }

    fn __enter__(this: Bound<'_, Self>) -> Bound<'_, Self> {
        this
    }

    #[pyo3(signature = (kind, _value, _traceback))]
    fn __exit__(
        &self,
        py: Python<'_>,
        kind: Option<&Bound<'_, PyAny>>,
        _value: Option<&Bound<'_, PyAny>>,
        _traceback: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let open = py.detach(|| self.lock().is_some());
        match kind {
            None if open => self.finish(py, None).map(|_| ()),
            _ => {
                self.discard(py);
                Ok(())
            }
        }
    }
}
