//! Archives: from a file, from memory, from callbacks.

use crate::border::{
    Failure, Handle, Outcome, Sized32, close, fill, give, guard, held, input, record, sw_status, text,
};
use engine::archive::Archive;
use engine::bytes::{ByteSource, FileSource, MemorySource};
use engine::{Error, Result};
use std::ffi::{c_char, c_void};
use std::sync::Arc;

/// An open archive: head and directory, no pages. Any number of threads may use it at once.
pub struct sw_archive;

impl Handle for sw_archive {
    type Value = Opened;
    const NAME: &'static str = "sw_archive";
}

/// An archive, and its source to open it again for a stream.
pub struct Opened {
    pub archive: Archive,
    source: Arc<dyn ByteSource>,
}

impl Opened {
    fn new(source: Arc<dyn ByteSource>) -> Outcome<Self> {
        Ok(Self { archive: Archive::from_source(Box::new(source.clone()))?, source })
    }

    /// Opens the archive again from the same source.
    pub fn again(&self) -> Outcome<Archive> {
        Ok(Archive::from_source(Box::new(self.source.clone()))?)
    }
}

/// Source of an archive: functions that read its bytes by ranges.
///
/// Slicewalk calls them from any thread, from several at once, and from the threads of its streams, until it calls
/// `release`. They must not throw exceptions, and must not call `sw_` functions.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sw_source {
    /// `sizeof(sw_source)`.
    pub size: u32,
    /// Passed to both functions unchanged.
    pub context: *mut c_void,
    /// Length of the archive (bytes).
    pub length: u64,
    /// Fills `buffer` with the `len` bytes at `offset`. Returns 0 on success, any other number on failure.
    pub read: Option<extern "C" fn(context: *mut c_void, offset: u64, buffer: *mut u8, len: usize) -> i32>,
    /// Called once after the last `read`, also if opening fails. Not called if this struct is refused for its size. May
    /// be NULL.
    pub release: Option<extern "C" fn(context: *mut c_void)>,
}

// SAFETY: `repr(C)`, the size first. A function pointer of the caller is NULL or valid by the header's contract.
unsafe impl Sized32 for sw_source {
    const NAME: &'static str = "sw_source";
}

struct Callbacks(sw_source);

// SAFETY: the header demands that both functions may be called from any thread.
unsafe impl Send for Callbacks {}
// SAFETY: the header demands that `read` may be called from several threads at once.
unsafe impl Sync for Callbacks {}

impl ByteSource for Callbacks {
    fn len(&self) -> u64 {
        self.0.length
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let bytes = buf.len();
        let action = || format!("read {bytes} bytes at {offset}");
        let failed = |action: String, error: std::io::Error| Error::io("the program's source", action, error);
        if offset.checked_add(buf.len() as u64).is_none_or(|end| end > self.0.length) {
            return Err(failed(action(), std::io::ErrorKind::UnexpectedEof.into()));
        }
        let code = self.0.read.map_or(-1, |read| read(self.0.context, offset, buf.as_mut_ptr(), buf.len()));
        match code {
            0 => Ok(()),
            code => Err(failed(action(), std::io::Error::other(format!("its function returned {code}")))),
        }
    }
}

impl Drop for Callbacks {
    fn drop(&mut self) {
        if let Some(release) = self.0.release {
            release(self.0.context);
        }
    }
}

/// Opens the archive file at `path` (UTF-8).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_open_file(path: *const c_char, archive: *mut *mut sw_archive) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of `path` and `archive`.
        unsafe { give(archive, || Opened::new(Arc::new(FileSource::open(text(path, "path")?)?))) }
    })
}

/// Opens an archive of `len` bytes in memory, and copies them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_open_memory(bytes: *const u8, len: usize, archive: *mut *mut sw_archive) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of `bytes`, `len` and `archive`.
        unsafe { give(archive, || Opened::new(Arc::new(MemorySource::new(input(bytes, len, "bytes")?)))) }
    })
}

/// Opens an archive that the functions in `source` read.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_open_source(source: *const sw_source, archive: *mut *mut sw_archive) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of `source`.
        let source = unsafe { record(source) }.map(Callbacks);
        let made = || {
            let source = source?;
            if source.0.read.is_none() {
                return Err(Failure::argument("sw_source.read: expected a function, found NULL"));
            }
            Opened::new(Arc::new(source))
        };
        // SAFETY: as the header demands of `archive`.
        unsafe { give(archive, made) }
    })
}

/// Facts about an archive.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sw_info {
    /// `sizeof(sw_info)`, set by the caller.
    pub size: u32,
    /// 1 if it holds points; otherwise 0, and the bounds are 0.
    pub has_points: u32,
    /// Edge of a pixel (m).
    pub pixel_size: f64,
    /// Height of a slice (m).
    pub slice_height: f64,
    /// Steps of heights (m).
    pub height_quantum: f64,
    /// Least coordinates of the scan (m).
    pub min: [f64; 3],
    /// Greatest coordinates of the scan (m).
    pub max: [f64; 3],
    /// Occupied voxels.
    pub voxels: u64,
    /// Length of the archive (bytes).
    pub bytes: u64,
}

// SAFETY: `repr(C)`, the size first, and numbers only.
unsafe impl Sized32 for sw_info {
    const NAME: &'static str = "sw_info";
}

/// Writes facts about the archive into `info`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_archive_info(archive: *const sw_archive, info: *mut sw_info) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles.
        let opened = unsafe { held(archive) }?;
        let (header, frame) = (opened.archive.header(), opened.archive.frame());
        let (min, max) = header.bounds.map_or(([0.0; 3], [0.0; 3]), |(min, max)| (min, max));
        let value = sw_info {
            size: size_of::<sw_info>() as u32,
            has_points: header.bounds.is_some().into(),
            pixel_size: frame.pixel_m(),
            slice_height: frame.slice_m(),
            height_quantum: frame.quantum_m(),
            min,
            max,
            voxels: header.voxels.occupied,
            bytes: header.file_len,
        };
        // SAFETY: as the header demands of `info`.
        unsafe { fill(info, value) }
    })
}

/// Closes an archive. Pages and streams made from it stay open. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_archive_close(archive: *mut sw_archive) -> sw_status {
    // SAFETY: as the header demands of handles.
    unsafe { close(archive) }
}
