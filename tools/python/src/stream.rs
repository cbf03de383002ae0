//! `Stream`: the pages around moving bodies under a byte budget, and `View`, a snapshot of them for queries.

use crate::archive::{Archive, Opened};
use crate::arrays::{BLOCK, Rows, numbers};
use crate::attend::{Audience, LOOK, attended};
use crate::errors::{Failure, of_row, plain};
use crate::options::{argument, refuse, size};
use crate::pages::{Pages, Set};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::store::{LoadReport, MotionHint, PawnHandle, Prefetch, Stream as Inner, StreamOptions};
use slicewalk::{Error, Monitor};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

/// The pages of an archive around moving bodies, under a byte budget that is never exceeded.
///
/// A thread loads pages before they are needed. Query a :meth:`view`, which never waits: for a missing page it answers
/// ``NOT_LOADED`` or nan, never "free". Drop views soon, because the pages that they hold count against the budget. After
/// a fork, the child has no such thread: open another stream there.
///
/// Args:
///     archive: an :class:`Archive`
///     budget: memory for pages and everything needed to load them: bytes, or a text such as ``"64MiB"``
///     prefetch: whether a thread loads ahead; without it, only :meth:`load` loads pages
///
/// Raises:
///     LimitError, ParameterError: the budget is too small; the message states a sufficient one
///
/// >>> archive = slicewalk.open("room.slices")
/// >>> with slicewalk.Stream(archive, "16MiB") as stream:
/// ...     box = [[3, 2, 0.5, 3.5, 2.5, 1.8]]
/// ...     report = stream.load(box)
/// ...     print(report["left_out"], stream.view().overlaps(box))
/// 0 [0]
#[pyclass(frozen, module = "slicewalk")]
pub struct Stream {
    stream: Mutex<Option<Arc<Inner>>>,
    opened: Arc<Opened>,
    /// Hints keep the stream's pages in memory, so they must end with the stream.
    hints: Mutex<Vec<WeakHints>>,
}

/// Slot for the hints of one body; `None` once the stream is closed.
#[derive(Clone)]
pub struct Hints(Arc<Mutex<Option<PawnHandle>>>);

type WeakHints = Weak<Mutex<Option<PawnHandle>>>;

impl Hints {
    /// Lets `say` set hints.
    pub fn with(&self, say: impl FnOnce(&mut PawnHandle)) -> PyResult<()> {
        lock(&self.0).as_mut().map(say).ok_or_else(closed)
    }
}

fn closed() -> PyErr {
    plain("ClosedError", "the stream is closed: open another one")
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Hint of a box at rest: the pages that it touches.
fn resting(&[x0, y0, z0, x1, y1, z1]: &[f64; 6]) -> MotionHint {
    let (min, max) = (Point3::new(x0, y0, z0), Point3::new(x1, y1, z1));
    MotionHint { min, max, velocity: Vector3::zeros(), gravity: 0.0, terminal_speed: 0.0, agility: 0.0 }
}

impl Stream {
    /// Returns the stream unless it is closed.
    pub fn inner(&self) -> PyResult<Arc<Inner>> {
        lock(&self.stream).clone().ok_or_else(closed)
    }

    /// Registers a slot for the hints of a body.
    pub fn hints(&self) -> PyResult<Hints> {
        let stream = lock(&self.stream);
        let hints = Arc::new(Mutex::new(Some(stream.as_ref().ok_or_else(closed)?.pawn())));
        let mut all = lock(&self.hints);
        all.retain(|hints| hints.strong_count() > 0);
        all.push(Arc::downgrade(&hints));
        Ok(Hints(hints))
    }

    /// Waits like [`Inner::settle`], but ends when `monitor` asks to stop or the stream is closed.
    pub fn settled(&self, inner: &Inner, most: Duration, monitor: &dyn Monitor) -> Result<bool, Failure> {
        let start = Instant::now();
        loop {
            self.inner()?;
            let rest = most.saturating_sub(start.elapsed());
            if inner.settle(rest.min(LOOK)) {
                return Ok(true);
            }
            if rest.is_zero() || monitor.cancelled() {
                return Ok(false);
            }
        }
    }

    /// Name of the archive, for errors.
    pub fn name(&self) -> Option<&str> {
        self.opened.name.as_deref()
    }
}

#[pymethods]
impl Stream {
    #[new]
    #[pyo3(signature = (archive, budget, *, prefetch=true))]
    fn new(
        #[pyo3(from_py_with = argument::archive)] archive: &Bound<'_, Archive>,
        budget: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = argument::prefetch)] prefetch: bool,
    ) -> PyResult<Self> {
        let opened = archive.get().opened.clone();
        let budget = usize::try_from(size("budget", budget)?).unwrap_or(usize::MAX);
        let prefetch = if prefetch { Prefetch::Thread } else { Prefetch::Off };
        let options = StreamOptions { prefetch, ..StreamOptions::new(budget) };
        let name = opened.name.clone();
        let stream = attended(archive.py(), &Audience::default(), name.as_deref(), |_| {
            Ok(Inner::open(opened.again()?, options)?)
        })?;
        Ok(Self { stream: Mutex::new(Some(Arc::new(stream))), opened, hints: Mutex::default() })
    }

    /// Returns the pages now in memory as a :class:`View`. Take one per frame; it costs next to nothing.
    fn view(&self, py: Python<'_>) -> PyResult<Py<View>> {
        let view = self.inner()?.snapshot();
        Py::new(py, PyClassInitializer::from(Pages { set: Set::View(view, self.opened.clone()) }).add_subclass(View {}))
    }

    /// Loads the pages that the boxes touch, and returns once they are in memory.
    ///
    /// Args:
    ///     boxes: N × 6, each ``xmin, ymin, zmin, xmax, ymax, zmax`` (m, finite)
    ///
    /// Returns:
    ///     dict of ``loaded``, ``already``, ``evicted``, ``left_out`` (pages that did not fit) and ``needed_bytes`` (a
    ///     budget that fits the pages of any single box)
    fn load<'py>(&self, boxes: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyDict>> {
        let py = boxes.py();
        let rows = Rows::<6>::of(boxes, "boxes")?;
        let (mut block, mut sum) = (Vec::new(), LoadReport::default());
        let stream = self.inner()?;
        for first in (0..rows.len()).step_by(BLOCK) {
            rows.copy(first, BLOCK.min(rows.len() - first), &mut block)?;
            for (row, r#box) in block.iter().enumerate() {
                valid(resting(r#box)).map_err(|error| of_row(py, "boxes", first + row, error))?;
            }
            attended(py, &Audience::default(), self.name(), |monitor| {
                for row in &block {
                    if monitor.cancelled() {
                        return Err(Error::Interrupted.into());
                    }
                    self.inner()?;
                    let report = stream.load_around(&resting(row))?;
                    sum.loaded += report.loaded;
                    sum.already += report.already;
                    sum.evicted += report.evicted;
                    sum.left_out += report.left_out;
                    sum.needed_bytes = sum.needed_bytes.max(report.needed_bytes);
                }
                Ok(())
            })?;
        }
        let facts = PyDict::new(py);
        facts.set_item("loaded", sum.loaded)?;
        facts.set_item("already", sum.already)?;
        facts.set_item("evicted", sum.evicted)?;
        facts.set_item("left_out", sum.left_out)?;
        facts.set_item("needed_bytes", sum.needed_bytes)?;
        Ok(facts)
    }

    /// Registers a body of your own, which can give hints; a :class:`Walker` does so automatically.
    fn body(&self) -> PyResult<Body> {
        Ok(Body { hints: self.hints()? })
    }

    /// Waits until every page that the hints ask for is in memory, has failed, or does not fit.
    ///
    /// Args:
    ///     seconds: the longest wait (s)
    ///
    /// Returns:
    ///     whether that happened within the time
    fn settle(&self, py: Python<'_>, #[pyo3(from_py_with = argument::seconds)] seconds: f64) -> PyResult<bool> {
        let stream = self.inner()?;
        let wrong = |_| refuse("seconds", format!("expected seconds, 0 or more, found {seconds}"));
        let most = Duration::try_from_secs_f64(seconds).map_err(wrong)?;
        attended(py, &Audience::default(), None, |monitor| self.settled(&stream, most, monitor))
    }

    /// Returns counters since the start as a dict: ``loaded``, ``evicted``, ``failed``, ``reads``, ``read_bytes``,
    /// ``peak_bytes``, ``budget_bytes``.
    fn counters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let stream = self.inner()?;
        let counters = py.detach(|| stream.counters());
        let facts = PyDict::new(py);
        facts.set_item("loaded", counters.loaded)?;
        facts.set_item("evicted", counters.evicted)?;
        facts.set_item("failed", counters.failed)?;
        facts.set_item("reads", counters.reads)?;
        facts.set_item("read_bytes", counters.read_bytes)?;
        facts.set_item("peak_bytes", counters.peak_bytes)?;
        facts.set_item("budget_bytes", counters.budget_bytes)?;
        Ok(facts)
    }

    /// Returns the errors of prefetching since the last call, at most the last 16; they are not raised.
    fn errors(&self, py: Python<'_>) -> PyResult<Vec<PyErr>> {
        let stream = self.inner()?;
        let errors = py.detach(|| stream.take_errors());
        Ok(errors.into_iter().map(|failed| Failure::from(failed.error).raise(py, self.name())).collect())
    }

    /// Ends the stream, its thread, and the hints of bodies and walkers; existing views stay valid.
    fn close(&self, py: Python<'_>) {
        let stream = lock(&self.stream).take();
        let hints = std::mem::take(&mut *lock(&self.hints));
        py.detach(|| {
            for hints in hints.iter().filter_map(Weak::upgrade) {
                drop(lock(&hints).take());
            }
            drop(stream);
        });
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let name = self.name().unwrap_or("bytes");
        let Ok(stream) = self.inner() else { return format!("<slicewalk.Stream of {name:?}, closed>") };
        let counters = py.detach(|| stream.counters());
        let (pages, used, budget) = (counters.resident_pages, counters.used_bytes, counters.budget_bytes);
        format!("<slicewalk.Stream of {name:?}: {pages} pages, {used} of {budget} bytes>")
    }

    fn __enter__(this: Bound<'_, Self>) -> Bound<'_, Self> {
        this
    }

    #[pyo3(signature = (_kind, _value, _traceback))]
    fn __exit__(
        &self,
        py: Python<'_>,
        _kind: Option<&Bound<'_, PyAny>>,
        _value: Option<&Bound<'_, PyAny>>,
        _traceback: Option<&Bound<'_, PyAny>>,
    ) {
        self.close(py);
    }

    fn __del__(&self, py: Python<'_>) {
        self.close(py);
    }
}

/// The pages of a :class:`Stream` that were in memory when the view was taken. Its answers refer to that moment.
#[pyclass(frozen, extends = Pages, module = "slicewalk")]
pub struct View {}

/// Announces how a body of your own moves; see :meth:`Stream.body`. Its hints end with it.
#[pyclass(frozen, module = "slicewalk")]
pub struct Body {
    hints: Hints,
}

#[pymethods]
impl Body {
    /// Announces how the body moves now. Call it once per frame; it never waits.
    ///
    /// Args:
    ///     box: ``xmin, ymin, zmin, xmax, ymax, zmax`` (m): everything that the queries of one frame may touch
    ///     velocity: ``vx, vy, vz`` (m/s)
    ///
    /// Prefetching assumes that the body may turn at any moment, walk at 1.5 m/s or more, and fall.
    ///
    /// >>> with slicewalk.Stream(slicewalk.open("room.slices"), "16MiB") as stream:
    /// ...     body = stream.body()
    /// ...     body.hint((3, 2, 0, 3.5, 2.5, 1.8), (1.4, 0, 0))
    /// ...     stream.settle(10)
    /// True
    #[pyo3(signature = (r#box, velocity))]
    fn hint(&self, r#box: &Bound<'_, PyAny>, velocity: &Bound<'_, PyAny>) -> PyResult<()> {
        let motion = motion(numbers(r#box, "box")?, numbers(velocity, "velocity")?).map_err(Failure::from)?;
        self.hints.with(|pawn| pawn.hint(&motion))
    }

    fn __repr__(&self) -> &'static str {
        match *lock(&self.hints.0) {
            Some(_) => "<slicewalk.Body of a stream>",
            None => "<slicewalk.Body of a closed stream>",
        }
    }
}

fn motion([x0, y0, z0, x1, y1, z1]: [f64; 6], velocity: [f64; 3]) -> slicewalk::Result<MotionHint> {
    valid(MotionHint::walking([x0, y0, z0].into(), [x1, y1, z1].into(), velocity.into()))
}

/// Returns a motion hint unless its box or velocity is invalid.
fn valid(hint: MotionHint) -> slicewalk::Result<MotionHint> {
    if hint.is_valid() {
        return Ok(hint);
    }
    let at_rest = MotionHint { velocity: Vector3::zeros(), agility: 0.0, ..hint };
    Err(match at_rest.is_valid() {
        true => Error::parameter("velocity", "expected numbers within ±1e9 m/s"),
        false => Error::parameter("box", "expected numbers within ±1e9 m, and minima up to maxima"),
    })
}
