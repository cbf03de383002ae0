//! `open` and `Archive`: where archives come from, and what they say about themselves.

use crate::arrays::{key, short};
use crate::attend::{Audience, attended};
use crate::convert::dictionary;
use crate::errors::Failure;
use crate::options::refuse;
use crate::pages::{Pages, Set};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyByteArray, PyBytes, PyDict, PyTuple};
use slicewalk::Error;
use slicewalk::archive::{Archive as Inner, ColourReader, Finding};
use slicewalk::bytes::{ByteSource, FileSource, RemoteOptions, RemoteSource, interruptible, stop_of_thread};
use slicewalk::store::Store;
use std::collections::HashMap;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, TryLockError};
use std::time::{Duration, Instant};

/// An open archive. Its pages are loaded when they are first asked for.
pub struct Opened {
    pub archive: Inner,
    source: Arc<dyn ByteSource>,
    /// Path or public address.
    pub name: Option<String>,
    /// How a server is asked; None for files and bytes.
    remote: Option<RemoteOptions>,
    store: OnceLock<Store>,
    loading: Mutex<()>,
}

impl Opened {
    fn new(
        source: Arc<dyn ByteSource>,
        name: Option<String>,
        remote: Option<RemoteOptions>,
    ) -> slicewalk::Result<Self> {
        let archive = Inner::from_source(Box::new(source.clone()))?;
        Ok(Self { archive, source, name, remote, store: OnceLock::new(), loading: Mutex::default() })
    }

    /// Opens an address. All of it is given up after the time-out.
    fn remote(url: &str, options: &RemoteOptions) -> slicewalk::Result<Self> {
        let (deadline, outer) = (Instant::now() + options.timeout, stop_of_thread());
        let late = move || Instant::now() >= deadline;
        let stop = move || late() || outer.as_ref().is_some_and(|stop| stop());
        let name = public(url);
        let opened = interruptible(Some(Arc::new(stop)), || {
            Self::new(Arc::new(RemoteSource::with(url, options)?), Some(name.clone()), Some(options.clone()))
        });
        opened.map_err(|error| match error {
            Error::Interrupted if late() => {
                let reason = format!("no answer within {} s; give a longer timeout", options.timeout.as_secs_f64());
                Error::io(&name, "open", std::io::Error::new(std::io::ErrorKind::TimedOut, reason))
            }
            error => error,
        })
    }

    /// An overview level.
    fn level(&self, number: u32) -> slicewalk::Result<Self> {
        let (archive, source) = (self.archive.level(number)?, self.source.clone());
        let (name, remote) = (self.name.clone(), self.remote.clone());
        Ok(Self { archive, source, name, remote, store: OnceLock::new(), loading: Mutex::default() })
    }

    /// A few reads. Ctrl-C is heard while a server is waited for.
    fn read<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&Self) -> slicewalk::Result<T> + Send) -> PyResult<T> {
        let name = self.name.as_deref();
        match self.remote {
            Some(_) => attended(py, &Audience::default(), name, |_| Ok(work(self)?)),
            None => py.detach(|| work(self)).map_err(|error| Failure::from(error).raise(py, name)),
        }
    }

    /// What it is, for people.
    pub fn described(&self, class: &str) -> String {
        let (frame, header) = (self.archive.frame(), self.archive.header());
        let name = self.name.as_deref().unwrap_or("bytes");
        let level = if header.level > 0 { format!("level {} of ", header.level) } else { String::new() };
        format!(
            "<slicewalk.{class} {level}{name:?}: {} voxels, pixel {} m, {} slices of {} m>",
            header.voxels.occupied,
            frame.pixel_m(),
            slicewalk::info::slice_count(header),
            frame.slice_m()
        )
    }

    /// The archive once more, on the same source.
    pub fn again(&self) -> slicewalk::Result<Inner> {
        Inner::from_source(Box::new(self.source.clone()))
    }

    /// All pages; the first call loads them.
    pub fn store(&self, py: Python<'_>) -> PyResult<&Store> {
        match self.store.get() {
            Some(store) => Ok(store),
            None => self.load(py, None),
        }
    }

    fn load(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<&Store> {
        let audience = Audience { progress, ..Audience::default() };
        attended(py, &audience, self.name.as_deref(), |monitor| {
            let _loading = loop {
                match self.loading.try_lock() {
                    Ok(guard) => break guard,
                    Err(TryLockError::Poisoned(poisoned)) => break poisoned.into_inner(),
                    Err(TryLockError::WouldBlock) if monitor.cancelled() => return Err(Error::Interrupted.into()),
                    Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(2)),
                }
            };
            if self.store.get().is_none() {
                let _ = self.store.set(Store::resident(&self.archive, monitor)?);
            }
            Ok(())
        })?;
        // Set by whoever held the lock last.
        self.store.get().ok_or_else(|| Failure::from(Error::Interrupted).into())
    }

    /// What tells this archive from others: its length, its plan, and the checksum of its head, which covers all others.
    fn identity(&self) -> slicewalk::Result<String> {
        let header = self.archive.header();
        let mut checksum = [0; 4];
        self.source.read_at(header.bytes.head.saturating_sub(4), &mut checksum)?;
        Ok(format!("{:x}-{:032x}-{:08x}", header.file_len, header.plan_hash, u32::from_le_bytes(checksum)))
    }
}

/// Bytes that Python holds, read where they are.
struct Held(PyBackedBytes);

impl ByteSource for Held {
    fn len(&self) -> u64 {
        self.0.len() as u64
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> slicewalk::Result<()> {
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        let range = start..start.saturating_add(buf.len());
        let Some(bytes) = self.0.get(range) else {
            let action = format!("read {} bytes at {offset}", buf.len());
            return Err(Error::io("bytes in memory", action, std::io::ErrorKind::UnexpectedEof.into()));
        };
        buf.copy_from_slice(bytes);
        Ok(())
    }
}

/// An address without user, password, query and fragment.
fn public(url: &str) -> String {
    let url = url.split(['?', '#']).next().unwrap_or_default();
    let (scheme, rest) = url.split_once("://").unwrap_or(("", url));
    let (host, path) = rest.split_once('/').map_or((rest, None), |(host, path)| (host, Some(path)));
    let host = host.rsplit('@').next().unwrap_or_default();
    path.map_or_else(|| format!("{scheme}://{host}"), |path| format!("{scheme}://{host}/{path}"))
}

/// Opens a slice archive.
///
/// Args:
///     source: a path; an address (``https://``, ``http://``, ``s3://bucket/key``, ``file://``), which is read by ranges; or the
///         archive itself as ``bytes``, which are read where they are, without a copy (other buffers are copied)
///     timeout: longest time that opening takes, and that a later read waits for the next bytes, repetitions included (s)
///     retries: how often a request is repeated that failed for a reason which may pass: a lost connection, an error of the server
///     settings: settings of an object store by name, such as ``{"aws_endpoint": ...}``, on top of the environment's ``AWS_*``
///
/// These options are for addresses. Ctrl-C is heard while a server is waited for.
///
/// Returns:
///     :class:`Archive`. Two reads; pages follow when they are asked for, up to 1 MiB of them in a request
///
/// Raises:
///     MissingFileError: there is no such file
///     FileError: it cannot be read
///     FormatError: it is no archive, or is damaged
///     UnsupportedError: another version of slicewalk wrote it
///
/// >>> archive = slicewalk.open("room.slices")
/// >>> archive.pixel_size, archive.slices
/// (0.1, 9)
#[pyfunction]
#[pyo3(signature = (source, *, timeout=10.0, retries=8, settings=None))]
pub fn open<'py>(
    source: &Bound<'py, PyAny>,
    timeout: f64,
    retries: usize,
    settings: Option<HashMap<String, String>>,
) -> PyResult<Bound<'py, Archive>> {
    let py = source.py();
    let wrong = || refuse("timeout", format!("expected seconds above 0, found {timeout}"));
    let time = Duration::try_from_secs_f64(timeout).ok().filter(|time| !time.is_zero()).ok_or_else(wrong)?;
    // Longer is for ever, and clocks would overflow.
    let timeout = time.min(Duration::from_secs(1 << 30));
    let mut source = source.clone();
    let url = source.extract::<String>().ok().filter(|text| text.contains("://"));
    let (name, given): (Option<String>, _) = if let Some(url) = &url {
        let mut settings: Vec<_> = settings.unwrap_or_default().into_iter().collect();
        settings.sort();
        let options = RemoteOptions { timeout, patience: timeout, retries, settings };
        let opened = attended(py, &Audience::default(), Some(&public(url)), |_| Ok(Opened::remote(url, &options)?))?;
        return Archive::bound(py, opened, source.unbind());
    } else if source.is_instance_of::<PyBytes>() || source.is_instance_of::<PyByteArray>() {
        (None, Arc::new(Held(source.extract()?)) as Arc<dyn ByteSource>)
    } else if let Ok(path) = source.extract::<PathBuf>() {
        let name = path.to_string_lossy().into_owned();
        let file =
            py.detach(|| FileSource::open(&path)).map_err(|error| Failure::from(error).raise(py, Some(&name)))?;
        (Some(name), Arc::new(file))
    } else {
        let bytes =
            py.import("builtins")?.call_method1("memoryview", (&source,)).and_then(|view| view.call_method0("tobytes"));
        source = bytes.map_err(|_| {
            PyTypeError::new_err(format!("source: expected a path, an address or bytes, found {}", short(&source)))
        })?;
        (None, Arc::new(Held(source.extract()?)))
    };
    let opened = py.detach(|| Opened::new(given, name.clone(), None));
    let opened = opened.map_err(|error| Failure::from(error).raise(py, name.as_deref()))?;
    Archive::bound(py, opened, source.unbind())
}

/// An open slice archive; see :func:`open`.
///
/// Its facts are attributes; ``info()`` has all of them. The first question loads all pages, as :meth:`load` does; for an
/// archive larger than memory ask the :class:`View` of a :class:`Stream`. Archives can be used from many threads at once,
/// and pickled: a copy opens the same file with the same options, and fails if it is another by then. The pickle holds the
/// ``settings``, secrets included; leave those to the environment.
#[pyclass(frozen, extends = Pages, module = "slicewalk")]
pub struct Archive {
    pub opened: Arc<Opened>,
    given: Py<PyAny>,
}

impl Archive {
    fn bound(py: Python<'_>, opened: Opened, given: Py<PyAny>) -> PyResult<Bound<'_, Self>> {
        let opened = Arc::new(opened);
        let pages = PyClassInitializer::from(Pages { set: Set::All(opened.clone()) });
        Bound::new(py, pages.add_subclass(Self { opened, given }))
    }
}

#[pymethods]
impl Archive {
    /// Path or address, without password and query; None for bytes.
    #[getter]
    fn path(&self, py: Python<'_>) -> Option<OsString> {
        // As it was given: a name that is no UTF-8 opens the same file again.
        let file = self.given.extract::<PathBuf>(py).ok().filter(|_| self.opened.remote.is_none());
        file.map(Into::into).or_else(|| self.opened.name.as_deref().map(Into::into))
    }

    /// Version of the format.
    #[getter]
    fn format_version(&self) -> String {
        let (major, minor) = self.opened.archive.header().version;
        format!("{major}.{minor}")
    }

    /// Least and greatest coordinates of all points: float64 of shape (2, 3) (m); None without points.
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let bounds = self.opened.archive.header().bounds;
        bounds.map(|(min, max)| Ok(PyArray2::from_vec2(py, &[min.to_vec(), max.to_vec()])?)).transpose()
    }

    /// Points read by the conversion.
    #[getter]
    fn points_read(&self) -> u64 {
        self.opened.archive.header().points_read
    }

    /// Points that made voxels.
    #[getter]
    fn points_kept(&self) -> u64 {
        self.opened.archive.header().points_kept
    }

    /// Slices from the lowest to the highest with matter.
    #[getter]
    fn slices(&self) -> i64 {
        slicewalk::info::slice_count(self.opened.archive.header())
    }

    /// Voxels with matter.
    #[getter]
    fn voxels(&self) -> u64 {
        self.opened.archive.header().voxels.occupied
    }

    /// Steepest slope that counts as floor (degrees).
    #[getter]
    fn max_slope(&self) -> f64 {
        self.opened.archive.plan().options.max_slope_deg
    }

    /// How far heights were coarsened, always outwards (m).
    #[getter]
    fn tolerance(&self) -> f64 {
        self.opened.archive.plan().options.tolerance_m
    }

    /// Coordinate reference system as the scan stated it; empty if unknown. One read.
    #[getter]
    fn crs(&self, py: Python<'_>) -> PyResult<String> {
        self.opened.read(py, |opened| opened.archive.crs())
    }

    /// All facts, as ``slicetool info --json`` prints them. One read.
    ///
    /// >>> slicewalk.open("room.slices").info()["voxels"]["obstacle"] > 0
    /// True
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dictionary(py, &self.opened.read(py, |opened| slicewalk::info::info(&opened.archive))?)
    }

    /// Loads all pages now. Ctrl-C ends it.
    ///
    /// Args:
    ///     progress: called with stage, amount done, total and unit
    ///
    /// Returns:
    ///     memory that the pages take (bytes)
    ///
    /// >>> slicewalk.open("room.slices").load() > 1000
    /// True
    #[pyo3(signature = (progress=None))]
    fn load(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<usize> {
        let store = self.opened.load(py, progress)?;
        Ok(store.weight_bytes() + store.table_bytes())
    }

    /// An overview level: the same scan on pixels and slices four times as large for each number, as pages of their own. Questions and
    /// keys are those of the level.
    ///
    /// Args:
    ///     number: 1 is the finest
    ///
    /// Returns:
    ///     :class:`Pages`, loaded when they are first asked for
    ///
    /// Raises:
    ///     ParameterError: the archive has no such level
    fn level(&self, py: Python<'_>, number: u32) -> PyResult<Pages> {
        let of_level = self.opened.read(py, |opened| opened.level(number))?;
        Ok(Pages { set: Set::All(Arc::new(of_level)) })
    }

    /// Colours of the voxels of a page, as `sliceconv --colour` made them.
    ///
    /// Args:
    ///     key: ``tx, ty, layer`` of the page
    ///     level: 0 for a page of the archive itself, else of this overview level (see :meth:`level`)
    ///
    /// Returns:
    ///     uint8 of shape (n, 4): red, green and blue (sRGB), and 255 for voxels that have a colour, 0 for others. Voxels come pixel by
    ///     pixel in row order, in each from the lowest slice up: the bits of :attr:`Page.occupancy`. None where the archive has no
    ///     colours, or no such page
    ///
    /// Raises:
    ///     ParameterError: the archive has no such level
    ///
    /// >>> slicewalk.open("room.slices").colours((0, 0, 0)) is None
    /// True
    #[pyo3(signature = (key, *, level=0))]
    fn colours<'py>(
        &self,
        py: Python<'py>,
        key: &Bound<'py, PyAny>,
        level: u32,
    ) -> PyResult<Option<Bound<'py, PyArray2<u8>>>> {
        let key = self::key(key)?;
        let colours = self.opened.read(py, |opened| {
            let whole = &opened.archive;
            let archive = if level == 0 { whole } else { &whole.level(level)? };
            let Some(mut reader) = ColourReader::new(archive)? else { return Ok(None) };
            let entry = archive.find(key)?;
            entry.map(|entry| reader.colours(&entry)).transpose()
        });
        let values = colours?.map(|colours| colours.values().as_flattened().to_vec());
        values
            .map(|values| {
                let count = values.len() / 4;
                values.into_pyarray(py).reshape([count, 4])
            })
            .transpose()
    }

    /// Checks every byte; an empty list says that all is well.
    ///
    /// Returns:
    ///     the findings, each a :class:`FormatError` that was not raised
    ///
    /// >>> slicewalk.open("room.slices").verify()
    /// []
    #[pyo3(signature = (progress=None))]
    fn verify(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<PyErr>> {
        let name = self.opened.name.as_deref();
        let audience = Audience { progress, ..Audience::default() };
        let findings = attended(py, &audience, name, |monitor| {
            let mut findings = Vec::new();
            self.opened.archive.verify(monitor, &mut |finding| findings.push(finding))?;
            Ok(findings)
        })?;
        let error = |finding: Finding| {
            let Finding { rule, part, offset, expected, found, .. } = finding;
            Failure::from(Error::Format { rule, part, offset, expected, found }).raise(py, name)
        };
        Ok(findings.into_iter().map(error).collect())
    }

    fn __repr__(&self) -> String {
        self.opened.described("Archive")
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let again = py.import("slicewalk")?.getattr("_again")?;
        let identity = self.opened.read(py, Opened::identity)?;
        let options = PyDict::new(py);
        if let Some(RemoteOptions { timeout, retries, settings, .. }) = &self.opened.remote {
            options.set_item("timeout", timeout.as_secs_f64())?;
            options.set_item("retries", retries)?;
            options.set_item("settings", settings.iter().cloned().collect::<HashMap<_, _>>())?;
        }
        Ok((again, (&self.given, identity, options).into_pyobject(py)?))
    }

    #[getter]
    fn _identity(&self, py: Python<'_>) -> PyResult<String> {
        self.opened.read(py, Opened::identity)
    }
}
