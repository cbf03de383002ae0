//! Runs long work on its own thread, while the calling thread checks for Ctrl-C and passes on progress and warnings.
//! Loops that stay on the calling thread use a [`CheckTimer`].
//!
//! Callbacks and warnings run only on the calling thread, so no other thread waits for the interpreter, but once: before
//! work puts its output in place, it waits until they have run. An exception that they raise leaves no output behind.

use crate::errors::{Failure, in_python, suggestion};
use pyo3::prelude::*;
use slicewalk::bytes::interruptible;
use slicewalk::{Monitor, Warning};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::ffi::CString;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::{Duration, Instant};

/// Interval between two checks.
pub const LOOK: Duration = Duration::from_millis(50);

/// Raises what a signal handler raises; for work on the calling thread with the interpreter released.
pub fn check_signals() -> PyResult<()> {
    Python::attach(|py| py.check_signals())
}

/// Time since a loop last checked whether to stop.
pub struct CheckTimer(Instant);

impl CheckTimer {
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Returns whether the next check is due, and starts again if so.
    pub fn is_due(&mut self) -> bool {
        let is_due = self.0.elapsed() >= LOOK;
        if is_due {
            self.0 = Instant::now();
        }
        is_due
    }

    /// Checks for Ctrl-C if that is due, as [`check_signals`] does.
    pub fn check(&mut self) -> PyResult<()> {
        if self.is_due() { check_signals() } else { Ok(()) }
    }
}

/// Progress and warnings that the work passes to the calling thread.
struct News {
    stages: Mutex<VecDeque<Stage>>,
    warnings: Mutex<Vec<String>>,
    done: AtomicU64,
    stop: Arc<AtomicBool>,
    /// The working thread while it waits for the callbacks, before it puts its output in place.
    waiting: Mutex<Option<Thread>>,
    caller: Thread,
}

#[derive(Clone, PartialEq)]
struct Stage {
    name: String,
    total: u64,
    unit: String,
    /// Final amount of a stage that has ended.
    done: Option<u64>,
}

impl News {
    /// For work that the calling thread follows.
    fn new() -> Self {
        Self {
            stages: Mutex::default(),
            warnings: Mutex::default(),
            done: AtomicU64::new(0),
            stop: Arc::default(),
            waiting: Mutex::default(),
            caller: std::thread::current(),
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Monitor for News {
    fn stage(&self, name: &str, total: u64, unit: &str) {
        let mut stages = lock(&self.stages);
        let done = self.done.swap(0, Ordering::Relaxed);
        if let Some(last) = stages.back_mut() {
            last.done = Some(done);
        }
        stages.push_back(Stage { name: name.into(), total, unit: unit.into(), done: None });
    }

    fn advance(&self, amount: u64) {
        self.done.fetch_add(amount, Ordering::Relaxed);
    }

    fn warn(&self, warning: &Warning) {
        lock(&self.warnings).push(warning.render(suggestion));
    }

    fn cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn cancelled_at_last(&self) -> bool {
        *lock(&self.waiting) = Some(std::thread::current());
        self.caller.unpark();
        while lock(&self.waiting).is_some() {
            std::thread::park_timeout(LOOK);
        }
        self.cancelled()
    }
}

/// Recipients of progress and warnings.
#[derive(Default)]
pub struct Audience<'a, 'py> {
    /// Called with stage, amount done, total (0 if unknown) and unit.
    pub progress: Option<&'a Bound<'py, PyAny>>,
    /// Raises no warnings.
    pub quiet: bool,
    /// Texts of all warnings, raised or not.
    pub warnings: RefCell<Vec<String>>,
}

impl Audience<'_, '_> {
    fn tell(&self, py: Python<'_>, news: &News, told: &mut Option<(Stage, u64)>) -> PyResult<()> {
        py.check_signals()?;
        let warnings = std::mem::take(&mut *lock(&news.warnings));
        for text in warnings.iter().map(|text| in_python(text).replace('\0', " ")) {
            self.warnings.borrow_mut().push(text.clone());
            if !self.quiet {
                let category = py.import("slicewalk.errors")?.getattr("SlicewalkWarning")?;
                PyErr::warn(py, &category, &CString::new(text)?, 1)?;
            }
        }
        let Some(progress) = self.progress else { return Ok(()) };
        loop {
            let (stage, done) = {
                let mut stages = lock(&news.stages);
                let Some(stage) = stages.front().cloned() else { return Ok(()) };
                if stage.done.is_some() {
                    stages.pop_front();
                }
                let done = stage.done.unwrap_or_else(|| news.done.load(Ordering::Relaxed));
                (stage, done)
            };
            let ended = stage.done.is_some();
            let now = (Stage { done: None, ..stage }, done);
            if told.as_ref() != Some(&now) {
                progress.call1((&now.0.name, done, now.0.total, &now.0.unit))?;
                *told = Some(now);
            }
            if !ended {
                return Ok(());
            }
        }
    }
}

/// Runs `work` with the interpreter released, waits for servers included. Ctrl-C or an exception of a callback ends the
/// work and is raised.
pub fn attended<T: Send>(
    py: Python<'_>,
    audience: &Audience<'_, '_>,
    path: Option<&str>,
    work: impl FnOnce(&dyn Monitor) -> Result<T, Failure> + Send,
) -> PyResult<T> {
    let (news, ended) = (News::new(), AtomicBool::new(false));
    let (mut told, mut raised) = (None, None);
    let result = std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            // Reports the end also after a panic.
            let _end = End(&ended, &news.caller);
            let stop = news.stop.clone();
            interruptible(Some(Arc::new(move || stop.load(Ordering::Relaxed))), || work(&news))
        });
        while !ended.load(Ordering::Acquire) {
            py.detach(|| std::thread::park_timeout(LOOK));
            let waiting = lock(&news.waiting).clone();
            if raised.is_none() {
                raised = audience.tell(py, &news, &mut told).err();
                news.stop.store(raised.is_some(), Ordering::Relaxed);
            }
            if let Some(waiting) = waiting {
                *lock(&news.waiting) = None;
                waiting.unpark();
            }
        }
        py.detach(|| worker.join()).unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    });
    if raised.is_none() {
        raised = audience.tell(py, &news, &mut told).err();
    }
    match raised {
        Some(error) => Err(error),
        None => result.map_err(|failure| failure.raise(py, path)),
    }
}

struct End<'a>(&'a AtomicBool, &'a Thread);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
        self.1.unpark();
    }
}
