//! `Walker`: a pawn with gravity, stairs and walls.

use crate::arrays::{BLOCK, Rows, numbers, reserve, short};
use crate::attend::{Audience, attended};
use crate::errors::Failure;
use crate::options::{argument, refuse, wrong_type};
use crate::pages::Pages;
use crate::reach::body;
use crate::stream::{Hints, Stream};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::exceptions::{PyMemoryError, PyRuntimeError};
use pyo3::prelude::*;
use slicewalk::nalgebra::{Point2, Vector2};
use slicewalk::store::{MotionHint, Snapshot, Stream as Inner};
use slicewalk::walk::{Config, MoveInput, Response, State, StepReport, Stop, Walker as Pawn3, Waypoints};
use slicewalk::{Error, Monitor};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError, Weak};
use std::time::Duration;

/// Longest time that a pawn may stay blocked before its path ends (s), as in `slicetool walk`.
const BLOCKED_S: f64 = 2.0;

/// How often a tick may miss pages that were loaded for it: prefetching may evict them before the pawn asks again.
const ATTEMPTS: usize = 64;

/// Pages that a walker walks on.
enum Ground<'py> {
    Pages(Bound<'py, Pages>),
    Stream(Bound<'py, Stream>),
}

impl<'py> Ground<'py> {
    fn of(given: &Bound<'py, PyAny>) -> PyResult<Self> {
        if let Ok(pages) = given.cast::<Pages>() {
            return Ok(Self::Pages(pages.clone()));
        }
        let stream = given.cast::<Stream>().map_err(|_| {
            let reason = format!("expected an Archive, a View or a Stream, found {}", short(given));
            wrong_type(given.py(), "pages", &reason)
        })?;
        Ok(Self::Stream(stream.clone()))
    }
}

/// A pawn with gravity that walks on floors and stairs and minds walls and ledges. Its path does not depend on the
/// frame rate.
///
/// While :meth:`path` runs, any other use of the walker, in another thread or in a signal handler, raises RuntimeError.
///
/// Args:
///     feet: ``x, y, z`` of the middle of its bottom face (m); a pawn in the air falls
///     pawn: ``"box:WIDTHxDEPTHxHEIGHT"`` or ``"cylinder:RADIUSxHEIGHT"`` (m)
///     speed: walking speed (m/s)
///     climb: highest step that it climbs, or walks down without falling (m)
///     gravity: m/s²
///     max_drop: it stops at ledges deeper than this (m) and at the edge of the scan; by default it falls
///     response: ``"slide"`` (exact sweeps), ``"thesis"`` or ``"thesis-mean"`` (fixed steps, halved)
///
/// Raises:
///     ParameterError: a number is invalid
///
/// >>> archive = slicewalk.open("room.slices")
/// >>> walker = slicewalk.Walker((1, 1, 0.1))
/// >>> for frame in range(60):
/// ...     report = walker.step(archive, 1 / 60, direction=(1, 0))
/// >>> report.state, round(walker.feet[0], 1)
/// ('walking', 2.4)
#[pyclass(frozen, module = "slicewalk")]
pub struct Walker {
    walking: Mutex<Walking>,
}

struct Walking {
    walker: Pawn3,
    /// Hints, and the stream that they are for.
    hints: Option<(Weak<Inner>, Hints)>,
}

fn response(name: &str) -> PyResult<Response> {
    match name {
        "slide" => Ok(Response::Slide),
        "thesis" => Ok(Response::Thesis),
        "thesis-mean" => Ok(Response::ThesisMean),
        _ => Err(refuse("response", format!("expected slide, thesis or thesis-mean, found {name:?}"))),
    }
}

fn stop_name(stop: Stop) -> &'static str {
    match stop {
        Stop::Wall => "wall",
        Stop::Steep => "steep",
        Stop::Headroom => "headroom",
        Stop::Corner => "corner",
        Stop::Inside => "inside",
        Stop::Ledge => "ledge",
        Stop::Void => "void",
    }
}

fn report<'py>(py: Python<'py>, report: &StepReport) -> PyResult<Bound<'py, PyAny>> {
    let moved = report.moved;
    py.import("slicewalk._results")?.getattr("StepReport")?.call1((
        report.state.name(),
        report.stop.map(stop_name),
        report.missing_count(),
        report.unspent,
        report.ticks,
        (moved.x, moved.y, moved.z),
    ))
}

#[pymethods]
impl Walker {
    #[new]
    #[pyo3(signature = (feet, *, pawn=None, speed=1.4, climb=0.35, gravity=9.81, max_drop=None, response="slide"))]
    fn new(
        feet: &Bound<'_, PyAny>,
        pawn: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = argument::speed)] speed: f64,
        #[pyo3(from_py_with = argument::climb)] climb: f64,
        #[pyo3(from_py_with = argument::gravity)] gravity: f64,
        #[pyo3(from_py_with = argument::max_drop)] max_drop: Option<f64>,
        #[pyo3(from_py_with = argument::response)] response: &str,
    ) -> PyResult<Self> {
        let response = self::response(response)?;
        let config = Config { speed, climb, gravity, max_drop, response, ..Config::new(body(pawn)?) };
        let walker = Pawn3::new(config, numbers::<3>(feet, "feet")?.into()).map_err(Failure::from)?;
        Ok(Self { walking: Mutex::new(Walking { walker, hints: None }) })
    }

    /// Middle of the bottom face: ``x, y, z`` (m).
    #[getter]
    fn feet(&self) -> PyResult<(f64, f64, f64)> {
        let feet = self.lock()?.walker.feet();
        Ok((feet.x, feet.y, feet.z))
    }

    /// ``"walking"``, ``"falling"``, ``"blocked"`` or ``"arrived"``.
    #[getter]
    fn state(&self) -> PyResult<&'static str> {
        Ok(self.lock()?.walker.state().name())
    }

    /// Speed of fall (m/s).
    #[getter]
    fn falling(&self) -> PyResult<f64> {
        Ok(self.lock()?.walker.falling())
    }

    /// Moves the pawn to another place, within ±10⁹ m, at rest.
    fn place(&self, feet: &Bound<'_, PyAny>) -> PyResult<()> {
        let place = numbers::<3>(feet, "feet")?;
        let mut walking = self.lock()?;
        walking.walker.place(place.into());
        // The walker ignores other places.
        if walking.walker.feet() != place.into() {
            return Err(refuse("feet", format!("expected numbers within ±1e9 m, found {}", short(feet))));
        }
        Ok(())
    }

    /// Advances the pawn by a time step.
    ///
    /// Args:
    ///     pages: an :class:`Archive`, a :class:`View`, or a :class:`Stream`, which also receives hints where the pawn
    ///         is heading
    ///     dt: time (s), 0 or more. A step takes at most 256 ticks of 1/240 s; ``report.unspent`` has the time left over
    ///     direction: ``dx, dy``: direction to walk in; a length below 1 means slower
    ///     toward: ``x, y``: place to walk to (m). Without `direction` and `toward` the pawn stands
    ///
    /// Returns:
    ///     :class:`StepReport`. If pages are missing, the pawn waits in place and ``report.waits`` is true
    #[pyo3(signature = (pages, dt, *, direction=None, toward=None))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        pages: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::dt)] dt: f64,
        direction: Option<&Bound<'py, PyAny>>,
        toward: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let pages = Ground::of(pages)?;
        if !dt.is_finite() || dt < 0.0 {
            return Err(refuse("dt", format!("expected seconds, 0 or more, found {dt}")));
        }
        let wish = match (direction, toward) {
            (None, None) => MoveInput::Stay,
            (Some(way), None) => MoveInput::Direction(Vector2::from(numbers::<2>(way, "direction")?)),
            (None, Some(place)) => MoveInput::Toward(Point2::from(numbers::<2>(place, "toward")?)),
            _ => return Err(wrong_type(py, "toward", "it and direction exclude each other; give one of them")),
        };
        let done = match &pages {
            Ground::Pages(pages) => {
                let set = pages.get().set.pages(py)?;
                self.lock()?.walker.step(set, dt, wish)
            }
            Ground::Stream(stream) => {
                let (inner, mut walking) = (stream.get().inner()?, self.lock()?);
                let motion_hint = walking.walker.motion_hint(inner.archive().frame());
                let hints = walking.hints_for(stream.get(), &inner)?;
                hints.with(|pawn| pawn.hint(&motion_hint))?;
                let done = walking.walker.step(&inner.snapshot(), dt, wish);
                if let Some(missing) = &done.missing {
                    hints.with(|pawn| pawn.need(missing))?;
                }
                done
            }
        };
        report(py, &done)
    }

    /// Walks along waypoints, like ``slicetool walk``, until the pawn reaches the last one, has been blocked for 2 s,
    /// falls below everything that was scanned, or runs out of time.
    ///
    /// Args:
    ///     pages: an :class:`Archive`, a :class:`View`, or a :class:`Stream`, which loads missing pages during the walk
    ///     waypoints: N × 2 or N × 3, each ``x, y`` (m) of a place to reach; z is ignored
    ///     hz: frames per second, 0.1 to 100000
    ///     max_seconds: longest time (s), more than 0, at most 1000000
    ///
    /// Returns:
    ///     :class:`Path`: time, feet and state for each frame
    ///
    /// Raises:
    ///     NotLoadedError: a page of a view is not in memory
    ///     ParameterError: an argument is invalid, or the budget of the stream is too small for one step
    ///     MemoryError: the system lacks memory for the frames
    ///
    /// >>> archive = slicewalk.open("room.slices")
    /// >>> path = slicewalk.Walker((1, 1, 0.1)).path(archive, [(7, 1), (7, 5)])
    /// >>> path.state, path.feet.shape[1], path.feet[-1].round(1)
    /// ('arrived', 3, array([7., 5., 0.]))
    #[pyo3(signature = (pages, waypoints, *, hz=60.0, max_seconds=300.0))]
    fn path<'py>(
        &self,
        py: Python<'py>,
        pages: &Bound<'py, PyAny>,
        waypoints: &Bound<'py, PyAny>,
        #[pyo3(from_py_with = argument::hz)] hz: f64,
        #[pyo3(from_py_with = argument::max_seconds)] max_seconds: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        let pages = Ground::of(pages)?;
        if !(0.1..=1e5).contains(&hz) {
            return Err(refuse("hz", format!("expected 0.1 to 100000 frames per second, found {hz}")));
        }
        if !(max_seconds > 0.0 && max_seconds <= 1e6) {
            return Err(refuse("max_seconds", format!("expected more than 0 s, at most 1000000, found {max_seconds}")));
        }
        let mut route = Waypoints::new(places(waypoints)?).map_err(Failure::from)?;
        let most = (max_seconds * hz).ceil().max(1.0) as u64;
        let walk = Walk { frame_s: 1.0 / hz, most };
        let mut walking = self.lock()?;
        let walker = &mut walking.walker;
        let start: [f64; 3] = walker.feet().into();
        let Frames { feet, states } = match &pages {
            Ground::Pages(pages) => {
                let set = pages.get().set.pages(py)?;
                attended(py, &Audience::default(), pages.get().name(), |monitor| {
                    walk.frames(monitor, walker, |walker, dt| follow(walker, set, dt, &mut route))
                })?
            }
            Ground::Stream(stream) => {
                let (ground, name) = (stream.get(), stream.get().name());
                let stream = ground.inner()?;
                let mut hints = stream.pawn();
                attended(py, &Audience::default(), name, |monitor| {
                    let frame = *stream.archive().frame();
                    stream.load_around(&walker.motion_hint(&frame))?;
                    walk.frames(monitor, walker, |walker, dt| {
                        hints.hint(&walker.motion_hint(&frame));
                        ground.settled(&stream, Duration::from_secs_f64(dt), monitor)?;
                        follow_loading(walker, &stream, dt, &mut route, monitor)
                    })
                })?
            }
        };
        let (count, mut times) = (states.len(), Vec::new());
        reserve(&mut times, count, || format!("the times of {count} frames"))?;
        times.extend((1..=count).map(|frame| frame as f64 / hz));
        let feet = feet.into_flattened().into_pyarray(py).reshape([count, 3])?;
        py.import("slicewalk._results")?.getattr("Path")?.call_method1(
            "_of",
            (times.into_pyarray(py), feet, states.into_pyarray(py), route.next(), <(f64, f64, f64)>::from(start)),
        )
    }

    fn __repr__(&self) -> String {
        let Ok(walking) = self.lock() else { return "<slicewalk.Walker on a path>".into() };
        let (feet, state) = (walking.walker.feet(), walking.walker.state().name());
        format!("<slicewalk.Walker {state} at ({}, {}, {})>", feet.x, feet.y, feet.z)
    }
}

impl Walker {
    /// Returns the pawn, unless a path of it runs.
    fn lock(&self) -> PyResult<MutexGuard<'_, Walking>> {
        match self.walking.try_lock() {
            Ok(walking) => Ok(walking),
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => {
                let reason = "walker: its path has not ended yet; wait for the end, or use one walker for each thread";
                Err(PyRuntimeError::new_err(reason))
            }
        }
    }
}

impl Walking {
    /// Returns the hints for this stream.
    fn hints_for(&mut self, stream: &Stream, inner: &Arc<Inner>) -> PyResult<Hints> {
        let known = self.hints.take().filter(|(own, _)| own.as_ptr() == Arc::as_ptr(inner));
        let (own, hints) = match known {
            Some(known) => known,
            None => (Arc::downgrade(inner), stream.hints()?),
        };
        self.hints = Some((own, hints.clone()));
        Ok(hints)
    }
}

fn places(waypoints: &Bound<'_, PyAny>) -> PyResult<Vec<Point2<f64>>> {
    // Without a shape, the reader of the rows says what is wrong.
    let shape = waypoints.py().import("numpy")?.call_method1("shape", (waypoints,));
    let columns = shape.as_ref().ok().and_then(|shape| shape.get_item(-1).ok()?.extract::<usize>().ok());
    match columns {
        Some(3) => places_of(&Rows::<3>::of(waypoints, "waypoints")?),
        Some(1 | 4..) => Err(refuse("waypoints", format!("expected shape (N, 2) or (N, 3), found {}", shape?))),
        _ => places_of(&Rows::<2>::of(waypoints, "waypoints")?),
    }
}

fn places_of<const N: usize>(rows: &Rows<'_, N>) -> PyResult<Vec<Point2<f64>>> {
    let (mut all, mut block) = (Vec::new(), Vec::new());
    reserve(&mut all, rows.len(), || format!("{} waypoints", rows.len()))?;
    for first in (0..rows.len()).step_by(BLOCK) {
        rows.copy(first, BLOCK.min(rows.len() - first), &mut block)?;
        all.extend(block.iter().map(|place| Point2::new(place[0], place[1])));
    }
    Ok(all)
}

/// Frames of equal length.
struct Walk {
    frame_s: f64,
    most: u64,
}

/// Feet (m) and state after each frame.
#[derive(Default)]
struct Frames {
    feet: Vec<[f64; 3]>,
    states: Vec<u8>,
}

impl Frames {
    fn push(&mut self, feet: [f64; 3], state: State) -> PyResult<()> {
        let reserved = self.feet.try_reserve(1).and_then(|()| self.states.try_reserve(1));
        reserved.map_err(|_| {
            let count = self.states.len();
            PyMemoryError::new_err(format!("no memory for a path of over {count} frames; lower hz or max_seconds"))
        })?;
        self.feet.push(feet);
        self.states.push(state as u8);
        Ok(())
    }
}

impl Walk {
    /// Calls `frame` for each frame, until it returns that the pawn fell out of the scan.
    fn frames(
        &self,
        monitor: &dyn Monitor,
        walker: &mut Pawn3,
        mut frame: impl FnMut(&mut Pawn3, f64) -> Result<bool, Failure>,
    ) -> Result<Frames, Failure> {
        let (mut frames, mut blocked) = (Frames::default(), 0.0);
        for _ in 0..self.most {
            if monitor.cancelled() {
                return Err(Error::Interrupted.into());
            }
            let is_lost = frame(walker, self.frame_s)?;
            let (feet, state) = (walker.feet(), walker.state());
            frames.push(feet.into(), state)?;
            blocked = if state == State::Blocked { blocked + self.frame_s } else { 0.0 };
            if is_lost || state == State::Arrived || blocked >= BLOCKED_S - 1e-9 {
                break;
            }
        }
        Ok(frames)
    }
}

/// Advances one frame, which may be longer than the longest step of the library. Returns whether the pawn fell out of the
/// scan.
fn follow(walker: &mut Pawn3, set: &Snapshot, mut dt: f64, route: &mut Waypoints) -> Result<bool, Failure> {
    loop {
        let report = walker.follow(set, dt, route);
        if let Some(missing) = report.missing {
            return Err(missing.into());
        }
        dt = report.unspent;
        if dt <= 0.0 {
            return Ok(walker.is_lost(set));
        }
    }
}

/// Like [`follow`]. Missing pages are loaded at once, and stay until they have been used.
fn follow_loading(
    walker: &mut Pawn3,
    stream: &Inner,
    mut dt: f64,
    route: &mut Waypoints,
    monitor: &dyn Monitor,
) -> Result<bool, Failure> {
    let (mut needed, mut attempts) = (Vec::new(), 0);
    loop {
        if monitor.cancelled() {
            return Err(Error::Interrupted.into());
        }
        let report = walker.follow(&stream.snapshot(), dt, route);
        dt = report.unspent;
        if report.ticks > 0 {
            attempts = 0;
            needed.clear();
        }
        let Some(missing) = report.missing else {
            if dt > 0.0 {
                continue;
            }
            return Ok(walker.is_lost(&stream.snapshot()));
        };
        attempts += 1;
        for key in missing.keys() {
            if !needed.contains(key) {
                needed.push(*key);
            }
        }
        let loaded = stream.load(&needed, needed[0])?;
        if loaded.left_out > 0 || attempts > ATTEMPTS {
            let around: &MotionHint = &walker.motion_hint(stream.archive().frame());
            let bytes = stream.load_around(around)?.needed_bytes.max(loaded.needed_bytes);
            let given = stream.counters().budget_bytes;
            let reason = format!(
                "one step needs at least {bytes} bytes at once, found {given}; open the stream with a larger budget"
            );
            return Err(Error::parameter("budget", reason).into());
        }
    }
}
