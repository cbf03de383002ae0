//! `open` and `Archive`: sources of archives and their metadata.

use crate::arrays::{key, short};
use crate::attend::{Audience, attended};
use crate::convert::dictionary;
use crate::errors::Failure;
use crate::options::{argument, refuse, size, wrong_type};
use crate::pages::{MOST_SEEN_BYTES, Pages, Set};
use crate::seen::SeenSpace;
use numpy::{IntoPyArray, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyByteArray, PyBytes, PyDict, PyTuple};
use slicewalk::Error;
use slicewalk::archive::{Archive as Inner, ColourReader, Finding};
use slicewalk::bytes::{ByteSource, FileId, FileSource, RemoteOptions, RemoteSource, interruptible, stop_of_thread};
use slicewalk::seen::SeenSpace as Space;
use slicewalk::store::Snapshot;
use std::collections::HashMap;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, TryLockError};
use std::time::{Duration, Instant};

/// An open archive. The first query loads its pages.
pub struct Opened {
    pub archive: Inner,
    source: Arc<dyn ByteSource>,
    /// Path or public address.
    pub name: Option<String>,
    /// Options of requests to a server; `None` for files and bytes.
    remote: Option<RemoteOptions>,
    store: OnceLock<Snapshot>,
    /// `None` in it if the archive has no seen space.
    seen: OnceLock<Option<Arc<Space>>>,
    loading: Mutex<()>,
}

impl Opened {
    fn new(
        source: Arc<dyn ByteSource>,
        name: Option<String>,
        remote: Option<RemoteOptions>,
    ) -> slicewalk::Result<Self> {
        let archive = Inner::from_source(Box::new(source.clone()))?;
        Ok(Self::unread(archive, source, name, remote))
    }

    /// Opens an address. The time-out covers the whole of it.
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

    /// Opens an overview level.
    fn level(&self, number: u32) -> slicewalk::Result<Self> {
        let (archive, source) = (self.archive.level(number)?, self.source.clone());
        let (name, remote) = (self.name.clone(), self.remote.clone());
        Ok(Self::unread(archive, source, name, remote))
    }

    /// Nothing is read yet but what opening reads.
    fn unread(
        archive: Inner,
        source: Arc<dyn ByteSource>,
        name: Option<String>,
        remote: Option<RemoteOptions>,
    ) -> Self {
        let (store, seen) = (OnceLock::new(), OnceLock::new());
        Self { archive, source, name, remote, store, seen, loading: Mutex::default() }
    }

    /// Returns the seen space, which the first call reads into at most `most_bytes` of memory; `None` if there is none.
    pub fn seen_space(&self, py: Python<'_>, most_bytes: u64) -> PyResult<Option<Arc<Space>>> {
        if self.seen.get().is_none() {
            let name = self.name.as_deref();
            let space = attended(py, &Audience::default(), name, |_| Ok(self.archive.seen_space(most_bytes)?))?;
            // Another thread may have read it, too.
            let _ = self.seen.set(space.map(Arc::new));
        }
        Ok(self.seen.get().cloned().flatten())
    }

    /// Runs `work`, a few reads. Ctrl-C interrupts it while it waits for a server.
    fn read<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&Self) -> slicewalk::Result<T> + Send) -> PyResult<T> {
        let name = self.name.as_deref();
        match self.remote {
            Some(_) => attended(py, &Audience::default(), name, |_| Ok(work(self)?)),
            None => py.detach(|| work(self)).map_err(|error| Failure::from(error).raise(py, name)),
        }
    }

    /// One-line description for `repr`.
    pub fn described(&self, class: &str) -> String {
        let (frame, header) = (self.archive.frame(), self.archive.header());
        let name = self.name.as_deref().unwrap_or("bytes");
        // Voxels of an overview level are not counted.
        let (level, voxels) = match header.level {
            0 => (String::new(), format!("{} voxels, ", header.voxels.occupied)),
            level => (format!("level {level} of "), String::new()),
        };
        format!(
            "<slicewalk.{class} {level}{name:?}: {voxels}pixel {} m, {} slices of {} m>",
            frame.pixel_m(),
            slicewalk_convert::info::slice_count(header),
            frame.slice_m()
        )
    }

    /// Opens the archive again from the same source.
    pub fn again(&self) -> slicewalk::Result<Inner> {
        Inner::from_source(Box::new(self.source.clone()))
    }

    /// Returns all pages, which the first call loads.
    pub fn pages(&self, py: Python<'_>) -> PyResult<&Snapshot> {
        match self.store.get() {
            Some(store) => Ok(store),
            None => self.load(py, None),
        }
    }

    fn load(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<&Snapshot> {
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
                let _ = self.store.set(Snapshot::resident(&self.archive, monitor)?);
            }
            Ok(())
        })?;
        // The previous holder of the lock set it.
        self.store.get().ok_or_else(|| Failure::from(Error::Interrupted).into())
    }

    /// Returns what identifies this archive: its length, its plan, and the checksum of its head, which covers all other
    /// checksums.
    fn identity(&self) -> slicewalk::Result<String> {
        let header = self.archive.header();
        let mut checksum = [0; 4];
        self.source.read_at(header.bytes.head.saturating_sub(4), &mut checksum)?;
        Ok(format!("{:x}-{:032x}-{:08x}", header.file_len, header.plan_hash, u32::from_le_bytes(checksum)))
    }
}

/// Bytes on this machine. Like those of a server, they cannot be read on a thread that should stop.
struct Local<S>(S);

impl<S: ByteSource> ByteSource for Local<S> {
    fn len(&self) -> u64 {
        self.0.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> slicewalk::Result<()> {
        match stop_of_thread() {
            Some(stop) if stop() => Err(Error::Interrupted),
            _ => self.0.read_at(offset, buf),
        }
    }

    fn file_id(&self) -> Option<FileId> {
        self.0.file_id()
    }
}

/// Bytes that a Python object owns, read in place.
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

/// Gives the error of a parameter the name of the argument.
fn as_given(name: &str, error: Error) -> Error {
    match error {
        Error::Parameter { what, reason } => Error::parameter(name, format!("{what}: {reason}")),
        error => error,
    }
}

/// Strips user, password, query and fragment from an address.
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
///     source: a path; an address (``https://``, ``http://``, ``s3://bucket/key``, ``file://``), which is read in
///         ranges; or the archive itself as ``bytes``, which are read in place (other buffers are copied)
///     timeout: longest time that opening may take, and that a later read waits for the next bytes, retries included
///         (s)
///     retries: how often a request is repeated after an error that may pass, such as a lost connection or a server
///         error
///     settings: settings of an object store by name, such as ``{"aws_endpoint": ...}``, which override ``AWS_*`` of
///         the environment
///
/// ``timeout``, ``retries`` and ``settings`` apply to addresses only. Ctrl-C interrupts a wait for a server.
///
/// Returns:
///     :class:`Archive`. Opening takes two reads; later reads fetch pages on demand, up to 1 MiB per request
///
/// Raises:
///     MissingFileError: the file does not exist
///     FileError: the file cannot be read
///     FormatError: the file is damaged or is not an archive
///     UnsupportedError: another version of slicewalk wrote the file
///
/// >>> archive = slicewalk.open("room.slices")
/// >>> archive.pixel_size, archive.slices
/// (0.1, 9)
#[pyfunction]
#[pyo3(signature = (source, *, timeout=10.0, retries=8, settings=None))]
pub fn open<'py>(
    source: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = argument::timeout)] timeout: f64,
    #[pyo3(from_py_with = argument::retries)] retries: usize,
    #[pyo3(from_py_with = argument::settings)] settings: Option<HashMap<String, String>>,
) -> PyResult<Bound<'py, Archive>> {
    let py = source.py();
    let wrong = || refuse("timeout", format!("expected seconds above 0, found {timeout}"));
    let time = Duration::try_from_secs_f64(timeout).ok().filter(|time| !time.is_zero()).ok_or_else(wrong)?;
    // A longer time-out means none; anything above would overflow the clock.
    let timeout = time.min(Duration::from_secs(1 << 30));
    let (mut source, mut file) = (source.clone(), None);
    let url = source.extract::<String>().ok().filter(|text| text.contains("://"));
    let (name, given): (Option<String>, _) = if let Some(url) = &url {
        let mut settings: Vec<_> = settings.unwrap_or_default().into_iter().collect();
        settings.sort();
        let options = RemoteOptions { timeout, patience: timeout, retries, settings };
        let opened = attended(py, &Audience::default(), Some(&public(url)), |_| Ok(Opened::remote(url, &options)?))?;
        return Archive::bound(py, opened, source.unbind(), None);
    } else if source.is_instance_of::<PyBytes>() || source.is_instance_of::<PyByteArray>() {
        (None, Arc::new(Local(Held(source.extract()?))) as Arc<dyn ByteSource>)
    } else if let Ok(path) = source.extract::<PathBuf>() {
        let name = path.to_string_lossy().into_owned();
        let opened =
            py.detach(|| FileSource::open(&path)).map_err(|error| Failure::from(error).raise(py, Some(&name)))?;
        file = Some(std::path::absolute(&path)?.into_os_string());
        (Some(name), Arc::new(Local(opened)))
    } else {
        let bytes =
            py.import("builtins")?.call_method1("memoryview", (&source,)).and_then(|view| view.call_method0("tobytes"));
        source = bytes.map_err(|_| {
            wrong_type(py, "source", &format!("expected a path, an address or bytes, found {}", short(&source)))
        })?;
        (None, Arc::new(Local(Held(source.extract()?))))
    };
    let opened = py.detach(|| Opened::new(given, name.clone(), None));
    let opened = opened.map_err(|error| Failure::from(error).raise(py, name.as_deref()))?;
    Archive::bound(py, opened, source.unbind(), file)
}

/// An open slice archive; see :func:`open`.
///
/// Attributes hold the main metadata, ``info()`` all of it. The first query loads all pages, as :meth:`load` does; to
/// query an archive larger than memory, use the :class:`View` of a :class:`Stream`. An archive can be used from many
/// threads at once. It can be pickled: unpickling opens the same file with the same options, from any working folder,
/// and fails if the file has become another archive. The pickle contains ``settings``, secrets included; keep secrets in
/// the environment instead.
#[pyclass(frozen, extends = Pages, module = "slicewalk")]
pub struct Archive {
    pub opened: Arc<Opened>,
    given: Py<PyAny>,
    /// Absolute path of a file, as of opening.
    file: Option<OsString>,
}

impl Archive {
    fn bound(py: Python<'_>, opened: Opened, given: Py<PyAny>, file: Option<OsString>) -> PyResult<Bound<'_, Self>> {
        let opened = Arc::new(opened);
        let pages = PyClassInitializer::from(Pages { set: Set::All(opened.clone()) });
        Bound::new(py, pages.add_subclass(Self { opened, given, file }))
    }
}

#[pymethods]
impl Archive {
    /// Path or address, without password and query; None for bytes.
    #[getter]
    fn path(&self, py: Python<'_>) -> Option<OsString> {
        // As the caller gave it, so that a name that is not valid UTF-8 opens the same file again.
        let file = self.given.extract::<PathBuf>(py).ok().filter(|_| self.opened.remote.is_none());
        file.map(Into::into).or_else(|| self.opened.name.as_deref().map(Into::into))
    }

    /// Version of the format.
    #[getter]
    fn format_version(&self) -> String {
        let (major, minor) = self.opened.archive.header().version;
        format!("{major}.{minor}")
    }

    /// Bounds of all points, minimum and maximum: float64 of shape (2, 3) (m); None without points.
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let bounds = self.opened.archive.header().bounds;
        bounds.map(|(min, max)| Ok(PyArray2::from_vec2(py, &[min.to_vec(), max.to_vec()])?)).transpose()
    }

    /// Number of points that the conversion read.
    #[getter]
    fn points_read(&self) -> u64 {
        self.opened.archive.header().points_read
    }

    /// Number of points that contributed to voxels.
    #[getter]
    fn points_kept(&self) -> u64 {
        self.opened.archive.header().points_kept
    }

    /// Number of slices from the lowest to the highest occupied one.
    #[getter]
    fn slices(&self) -> i64 {
        slicewalk_convert::info::slice_count(self.opened.archive.header())
    }

    /// Number of occupied voxels.
    #[getter]
    fn voxels(&self) -> u64 {
        self.opened.archive.header().voxels.occupied
    }

    /// Steepest slope classified as floor (degrees).
    #[getter]
    fn max_slope(&self) -> f64 {
        self.opened.archive.plan().options.max_slope_deg
    }

    /// Largest error of the stored heights, always outwards (m).
    #[getter]
    fn tolerance(&self) -> f64 {
        self.opened.archive.plan().options.tolerance_m
    }

    /// Coordinate reference system as stated by the scan; empty if unknown. Takes one read.
    #[getter]
    fn crs(&self, py: Python<'_>) -> PyResult<String> {
        self.opened.read(py, |opened| opened.archive.crs())
    }

    /// Returns all metadata, as ``slicetool info --json`` prints it. Takes one read.
    ///
    /// >>> slicewalk.open("room.slices").info()["voxels"]["obstacle"] > 0
    /// True
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dictionary(py, &self.opened.read(py, |opened| slicewalk_convert::info::info(&opened.archive))?)
    }

    /// Loads all pages now. Ctrl-C interrupts it.
    ///
    /// Args:
    ///     progress: called with stage, amount done, total and unit
    ///
    /// Returns:
    ///     memory used by the pages (bytes)
    ///
    /// >>> slicewalk.open("room.slices").load() > 1000
    /// True
    #[pyo3(signature = (progress=None))]
    fn load(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = argument::progress)] progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<usize> {
        let store = self.opened.load(py, progress)?;
        Ok(store.weight_bytes() + store.table_bytes())
    }

    /// Returns an overview level: the same scan with pixels and slices 4 ** ``number`` times as large, as its own set
    /// of pages. Queries and keys refer to the level.
    ///
    /// Args:
    ///     number: 1 is the finest
    ///
    /// Returns:
    ///     :class:`Pages`; the first query loads them
    ///
    /// Raises:
    ///     ParameterError: the archive has no such level
    fn level(&self, py: Python<'_>, #[pyo3(from_py_with = argument::number)] number: u32) -> PyResult<Pages> {
        let of_level =
            self.opened.read(py, |opened| opened.level(number).map_err(|error| as_given("number", error)))?;
        Ok(Pages { set: Set::All(Arc::new(of_level)) })
    }

    /// Returns the space that the scanners saw, as ``convert(..., free_space=True)`` stored it. The first call reads it.
    ///
    /// Args:
    ///     memory: most memory that it may take: bytes, or a text such as ``"4GiB"``; 1 GiB by default
    ///
    /// Returns:
    ///     :class:`SeenSpace`; None if the archive was written without, so that nothing is known about it
    ///
    /// Raises:
    ///     LimitError: it takes more than ``memory``
    ///     FormatError: it is damaged; other queries do not need it
    ///
    /// >>> slicewalk.open("seen.slices").seen_space().cells > 100
    /// True
    /// >>> slicewalk.open("room.slices").seen_space() is None
    /// True
    #[pyo3(signature = (*, memory=None))]
    fn seen_space(&self, py: Python<'_>, memory: Option<&Bound<'_, PyAny>>) -> PyResult<Option<SeenSpace>> {
        let most = memory.map_or(Ok(MOST_SEEN_BYTES), |memory| size("memory", memory))?;
        Ok(self.opened.seen_space(py, most)?.map(|space| SeenSpace { space }))
    }

    /// Returns the colours of a page's voxels, as `sliceconv --colour` stored them.
    ///
    /// Args:
    ///     key: ``tx, ty, layer`` of the page
    ///     level: 0 for a page of the archive itself, otherwise the number of the overview level (see :meth:`level`)
    ///
    /// Returns:
    ///     uint8 of shape (n, 4): red, green and blue (sRGB), then 255 for a voxel with a colour or 0 for one without.
    ///     Voxels are in the order of the bits of :attr:`Page.occupancy`: pixels in row order, and from the lowest
    ///     slice up within a pixel. None if the archive has no colours or no such page
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
        #[pyo3(from_py_with = argument::level)] level: u32,
    ) -> PyResult<Option<Bound<'py, PyArray2<u8>>>> {
        let key = self::key(key)?;
        let colours = self.opened.read(py, |opened| {
            let whole = &opened.archive;
            let archive =
                if level == 0 { whole } else { &whole.level(level).map_err(|error| as_given("level", error))? };
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

    /// Checks every byte and returns what is wrong; an empty list means the archive is sound.
    ///
    /// Returns:
    ///     the findings, each a :class:`FormatError`, returned instead of raised
    ///
    /// >>> slicewalk.open("room.slices").verify()
    /// []
    #[pyo3(signature = (progress=None))]
    fn verify(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = argument::progress)] progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Vec<PyErr>> {
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
        let source = match &self.file {
            Some(file) => file.into_pyobject(py)?.into_any(),
            None => self.given.bind(py).clone(),
        };
        Ok((again, (source, identity, options).into_pyobject(py)?))
    }

    #[getter]
    fn _identity(&self, py: Python<'_>) -> PyResult<String> {
        self.opened.read(py, Opened::identity)
    }
}
