//! Checks the caller's arrays and copies them block by block.
//!
//! Another Python thread may write to an array while the interpreter is released, and Rust must not read it then. So no
//! slice of an array outlives the time in which the interpreter is held: a block of rows is copied, answered with the
//! interpreter released, and the next block follows. A block fits the cache, so the copy costs about 5 ns a row.

use crate::attend::{CheckTimer, LOOK, check_signals};
use crate::errors::{Failure, of_row};
use crate::options::{refuse, wrong_type};
use numpy::{Element, IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyMemoryError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyInt, PyString};
use slicewalk::Result;
use slicewalk::frame::PageKey;
use std::num::NonZeroUsize;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};

/// Rows copied at a time.
pub const BLOCK: usize = 1 << 16;
/// Rows below which a batch uses one thread only.
const LEAST_ROWS: usize = 1 << 13;
/// Most rows that a thread answers between two looks whether to stop.
const LOOK_ROWS: usize = 64;

/// Returns whether an array hides some of its numbers: numpy drops the mask, and they would count as any others.
pub fn is_masked(given: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(given.hasattr("mask")?
        && given.py().import("numpy")?.getattr("ma")?.call_method1("is_masked", (given,))?.extract()?)
}

/// Converts to an array of numbers, which fit `float64` without loss; `expected` describes it.
pub fn numeric<'py>(
    numpy: &Bound<'py, PyModule>,
    given: &Bound<'py, PyAny>,
    what: &str,
    expected: impl Fn() -> String,
) -> PyResult<Bound<'py, PyAny>> {
    let py = given.py();
    let found = numpy.call_method1("asarray", (given,)).map_err(|error| {
        if !error.is_instance_of::<PyValueError>(py) {
            return error;
        }
        let refused = refuse(what, format!("expected {}, found {}", expected(), short(given)));
        refused.set_cause(py, Some(error));
        refused
    })?;
    let untyped = found.cast::<PyUntypedArray>()?;
    let lossless: bool = numpy.call_method1("can_cast", (untyped.dtype(), "f8", "safe"))?.extract()?;
    if !lossless && untyped.len() > 0 {
        let dtype = untyped.dtype();
        let reason = format!("expected numbers (float64), found {dtype}; convert with numpy.asarray(..., float)");
        return Err(wrong_type(py, what, &reason));
    }
    Ok(found)
}

/// Rows of `N` numbers in a caller's array.
pub struct Rows<'py, const N: usize> {
    array: Bound<'py, PyArray2<f64>>,
    what: &'static str,
}

impl<'py, const N: usize> Rows<'py, N> {
    /// Checks shape and type. Accepts whatever numpy converts to `float64` without loss; an array of `float64` is not
    /// copied here.
    pub fn of(given: &Bound<'py, PyAny>, what: &'static str) -> PyResult<Self> {
        let py = given.py();
        let numpy = py.import("numpy")?;
        if is_masked(given)? {
            let way_out = format!("take the rows that count, such as {what}[~{what}.mask.any(axis=1)].data");
            return Err(refuse(what, format!("expected numbers, found masked ones; {way_out}")));
        }
        let found = numeric(&numpy, given, what, || format!("rows of {N} numbers"))?;
        let untyped = found.cast::<PyUntypedArray>()?;
        let corners = N == 6 && matches!(untyped.shape(), [_, 2, 3]);
        let found = if corners { found.call_method1("reshape", ((-1, 6),))? } else { found.clone() };
        let untyped = found.cast::<PyUntypedArray>()?;
        let shape = untyped.shape();
        let is_empty_list = shape == [0];
        if !is_empty_list && (shape.len() != 2 || shape[1] != N) {
            let suggestion = match shape {
                [n] if *n == N => format!("; for a single row pass {what}.reshape(1, {N})"),
                _ => String::new(),
            };
            let shape = untyped.getattr("shape")?.str()?;
            return Err(refuse(what, format!("expected shape (N, {N}), found {shape}{suggestion}")));
        }
        // Rust reads only aligned memory; numpy returns an aligned array unchanged.
        let options = PyDict::new(py);
        options.set_item("dtype", "f8")?;
        options.set_item("requirements", "A")?;
        let array = numpy.call_method("require", (&found,), Some(&options))?;
        let array = if is_empty_list { array.call_method1("reshape", ((0, N),))? } else { array };
        Ok(Self { array: array.cast_into::<PyArray2<f64>>()?, what })
    }

    pub fn array(&self) -> &Bound<'py, PyArray2<f64>> {
        &self.array
    }

    pub fn len(&self) -> usize {
        self.array.shape()[0]
    }

    /// Copies up to `count` rows from `first` on into `block`, as they are now.
    pub fn copy(&self, first: usize, count: usize, block: &mut Vec<[f64; N]>) -> PyResult<()> {
        let array = self.array.try_readonly().map_err(|_| self.busy("in use"))?;
        let array = array.as_array();
        if array.shape()[1] != N || array.shape()[0] < first + count {
            return Err(self.busy("resized"));
        }
        block.clear();
        reserve(block, count, || format!("{count} rows of {}", self.what))?;
        match array.as_slice() {
            Some(all) => block.extend_from_slice(all[first * N..(first + count) * N].as_chunks::<N>().0),
            None => block.extend((first..first + count).map(|row| std::array::from_fn(|at| array[[row, at]]))),
        }
        Ok(())
    }

    fn busy(&self, what: &str) -> PyErr {
        PyRuntimeError::new_err(format!("{}: the array was {what} by another thread while it was read", self.what))
    }
}

/// Returns an array of the `answer` for each row.
pub fn batch<'py, const N: usize, A: Element + Copy + Default + Send>(
    given: &Bound<'py, PyAny>,
    what: &'static str,
    threads: Option<NonZeroUsize>,
    answer: impl Fn(&[f64; N]) -> Result<A> + Sync,
) -> PyResult<Bound<'py, PyArray1<A>>> {
    Ok(answers(given, what, threads, answer)?.into_pyarray(given.py()))
}

/// Returns an array of the `answer` of `M` numbers for each row.
pub fn batch_of_rows<'py, const N: usize, const M: usize>(
    given: &Bound<'py, PyAny>,
    what: &'static str,
    threads: Option<NonZeroUsize>,
    answer: impl Fn(&[f64; N]) -> Result<[f64; M]> + Sync,
) -> PyResult<Bound<'py, PyArray2<f64>>>
where
    [f64; M]: Default,
{
    let answers = answers(given, what, threads, answer)?;
    let count = answers.len();
    answers.into_flattened().into_pyarray(given.py()).reshape([count, M])
}

/// Computes `answer` for each row, on several threads, with the interpreter released.
fn answers<const N: usize, A: Copy + Default + Send>(
    given: &Bound<'_, PyAny>,
    what: &'static str,
    threads: Option<NonZeroUsize>,
    answer: impl Fn(&[f64; N]) -> Result<A> + Sync,
) -> PyResult<Vec<A>> {
    let py = given.py();
    let rows = Rows::<N>::of(given, what)?;
    let (mut answers, mut block) = (Vec::new(), Vec::new());
    reserve(&mut answers, rows.len(), || format!("the answers to {} rows of {what}", rows.len()))?;
    for first in (0..rows.len()).step_by(BLOCK) {
        py.check_signals()?;
        rows.copy(first, BLOCK.min(rows.len() - first), &mut block)?;
        answers.resize(first + block.len(), A::default());
        let answered = py.detach(|| on_threads(&block, &mut answers[first..], threads, &answer));
        answered.map_err(|halt| match halt {
            Halt::Row(row, error) => of_row(py, what, first + row, error),
            Halt::Raised(error) => error,
        })?;
    }
    Ok(answers)
}

/// Number of threads of a batch. Queried once, because the system reads files to answer.
fn cores() -> NonZeroUsize {
    static CORES: OnceLock<NonZeroUsize> = OnceLock::new();
    *CORES.get_or_init(|| std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN))
}

/// Reserves room for `count` more elements, or raises MemoryError.
pub fn reserve<T>(vec: &mut Vec<T>, count: usize, what: impl FnOnce() -> String) -> PyResult<()> {
    vec.try_reserve_exact(count)
        .map_err(|_| PyMemoryError::new_err(format!("no memory for {}; ask for less at once", what())))
}

/// Reason why a block has no answers.
enum Halt {
    /// Index of a row, and what is wrong with it.
    Row(usize, slicewalk::Error),
    /// Exception of a signal handler.
    Raised(PyErr),
}

/// Computes `answer` for the rows of a block. Only the calling thread can check for Ctrl-C, and stops the others.
fn on_threads<R: Sync, A: Send>(
    rows: &[R],
    answers: &mut [A],
    threads: Option<NonZeroUsize>,
    answer: &(impl Fn(&R) -> Result<A> + Sync),
) -> std::result::Result<(), Halt> {
    let stop = AtomicBool::new(false);
    let raised = |error: PyErr| {
        stop.store(true, Ordering::Relaxed);
        Halt::Raised(error)
    };
    let run = |first: usize, rows: &[R], answers: &mut [A], is_caller: bool| -> std::result::Result<(), Halt> {
        let (mut timer, mut next, mut step) = (CheckTimer::start(), 1, 1);
        for (number, (row, place)) in rows.iter().zip(answers).enumerate() {
            if number == next {
                if stop.load(Ordering::Relaxed) {
                    return Ok(());
                }
                let is_due = timer.is_due();
                if is_due && is_caller {
                    check_signals().map_err(raised)?;
                }
                // While rows take long, such as huge boxes, it looks after each.
                step = if is_due { 1 } else { LOOK_ROWS.min(2 * step) };
                next += step;
            }
            *place = answer(row).map_err(|error| Halt::Row(first + number, error))?;
        }
        Ok(())
    };
    let threads = if rows.len() <= LEAST_ROWS { 1 } else { threads.unwrap_or_else(cores).get() };
    let each = rows.len().div_ceil(threads).max(LEAST_ROWS);
    if each >= rows.len() {
        return run(0, rows, answers, true);
    }
    std::thread::scope(|scope| {
        let (running, ended) = channel::<()>();
        let parts = rows.chunks(each).zip(answers.chunks_mut(each)).enumerate();
        let mut parts = parts.map(|(part, (rows, answers))| (part * each, rows, answers));
        let own = parts.next();
        let others: Vec<_> = parts
            .map(|(first, rows, out)| {
                let running = running.clone();
                scope.spawn(move || {
                    let _running = running;
                    run(first, rows, out, false)
                })
            })
            .collect();
        drop(running);
        let mut own = own.map_or(Ok(()), |(first, rows, answers)| run(first, rows, answers, true));
        // The other parts may take longer than this one.
        while ended.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
            own = check_signals().map_err(raised).and(own);
        }
        let joined =
            others.into_iter().map(|other| other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        std::iter::once(own).chain(joined).collect()
    })
}

/// Reads `N` numbers, such as a place or a box. A box may also come as its two corners, like `Archive.bounds`.
pub fn numbers<const N: usize>(given: &Bound<'_, PyAny>, what: &str) -> PyResult<[f64; N]> {
    let mut values = Vec::new();
    let taken = take_numbers(given, N == 6, N, &mut values);
    if taken.is_ok()
        && let Ok(values) = <[f64; N]>::try_from(values)
        && values.iter().all(|value| value.is_finite())
    {
        return Ok(values);
    }
    let reason = format!("expected {N} finite numbers, found {}", short(given));
    Err(match taken {
        Err(Misfit::Type) => wrong_type(given.py(), what, &reason),
        _ => refuse(what, reason),
    })
}

/// Reason why something does not hold the numbers that are expected.
enum Misfit {
    /// It is no sequence, or an element is neither a number nor a sequence.
    Type,
    /// There are too many numbers, one is too large, or they are nested otherwise.
    Value,
}

/// Appends the numbers of a sequence, or of its two sequences if `nested`; fails if it holds anything else or more than
/// `most` numbers.
fn take_numbers(
    given: &Bound<'_, PyAny>,
    nested: bool,
    most: usize,
    values: &mut Vec<f64>,
) -> std::result::Result<(), Misfit> {
    let before = values.len();
    for (number, item) in given.try_iter().map_err(|_| Misfit::Type)?.enumerate() {
        let item = item.map_err(|_| Misfit::Value)?;
        match item.extract() {
            Ok(value) => values.push(value),
            // A text is a sequence of texts.
            Err(_) if item.is_instance_of::<PyString>() => return Err(Misfit::Type),
            // A whole number that is too large for a float.
            Err(_) if item.is_instance_of::<PyInt>() => return Err(Misfit::Value),
            Err(_) if nested && number < 2 && values.len() == before + number * (most / 2) => {
                take_numbers(&item, false, most, values)?;
            }
            Err(_) if item.try_iter().is_ok() => return Err(Misfit::Value),
            Err(_) => return Err(Misfit::Type),
        }
        if values.len() > most {
            return Err(Misfit::Value);
        }
    }
    Ok(())
}

/// Reads the key of a page: a tuple, or a row of `Pages.keys`.
pub fn key(given: &Bound<'_, PyAny>) -> PyResult<PageKey> {
    let parts = given
        .try_iter()
        .and_then(|items| items.take(4).map(|item| item?.extract::<i32>()).collect::<PyResult<Vec<_>>>());
    match parts.as_deref() {
        Ok(&[tx, ty, layer]) => Ok(PageKey { tx, ty, layer }),
        _ => Err(wrong_type(given.py(), "key", &format!("expected tx, ty, layer of a page, found {}", short(given)))),
    }
}

/// Short text for messages: the shape of an array, the type and length of anything long, otherwise the value.
pub fn short(given: &Bound<'_, PyAny>) -> String {
    let class = given.get_type().name().map_or_else(|_| "something".into(), |name| name.to_string());
    if let Ok(array) = given.cast::<PyUntypedArray>()
        && array.len() > 20
    {
        return format!("an array of shape {:?}", array.shape());
    }
    match given.len() {
        Ok(len) if len > 200 => format!("a {class} of length {len}"),
        _ => given.repr().map_or(class, |repr| {
            let text = repr.to_string();
            let cut: String = text.chars().take(200).collect();
            if cut.len() < text.len() { cut + "…" } else { text }
        }),
    }
}

/// Array on memory that `owner` keeps alive, without a copy and read-only.
///
/// # Safety
/// The memory of `array` must stay in place and unchanged while `owner` lives.
pub unsafe fn lend<'py, T: Element, D: numpy::ndarray::Dimension>(
    array: &numpy::ndarray::Array<T, D>,
    owner: Bound<'py, PyAny>,
) -> PyResult<Bound<'py, numpy::PyArray<T, D>>> {
    // SAFETY: guaranteed by the caller.
    let lent = unsafe { numpy::PyArray::borrow_from_array(array, owner) };
    let options = PyDict::new(lent.py());
    options.set_item("write", false)?;
    lent.call_method("setflags", (), Some(&options))?;
    Ok(lent)
}

/// Error for a row whose values are invalid.
pub fn refused<T>(what: &'static str, reason: &str) -> Result<T> {
    Err(slicewalk::Error::parameter(what, reason))
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| failure.raise(py, None))
    }
}
