//! Identity of a file, independent of its name.

use std::path::Path;

/// Identity of a file among all files visible to the machine: device and inode, or volume and index on Windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct FileId {
    volume: u64,
    index: u64,
}

impl FileId {
    /// Identifies an object by its address and version.
    #[cfg(feature = "remote")]
    pub(super) fn of_object(address: u64, version: u64) -> Self {
        Self { volume: address, index: version }
    }

    /// Identifies the file at `path`, following links; `None` if there is no file or the system cannot identify it.
    #[cfg_attr(not(any(unix, windows)), allow(unused_variables, reason = "a browser has no files"))]
    pub fn at(path: &Path) -> Option<Self> {
        // Query by name: opening a pipe would block.
        #[cfg(unix)]
        return Some(Self::of_metadata(&std::fs::metadata(path).ok()?));
        #[cfg(windows)]
        return Self::of_handle(winapi_util::Handle::from_path_any(path).ok()?);
        #[cfg(not(any(unix, windows)))]
        return None;
    }

    /// Identifies the open `file`.
    #[cfg_attr(not(any(unix, windows)), allow(unused_variables, reason = "a browser has no files"))]
    pub fn of(file: &std::fs::File) -> Option<Self> {
        #[cfg(unix)]
        return Some(Self::of_metadata(&file.metadata().ok()?));
        #[cfg(windows)]
        return Self::of_handle(file);
        #[cfg(not(any(unix, windows)))]
        return None;
    }

    #[cfg(unix)]
    fn of_metadata(about: &std::fs::Metadata) -> Self {
        use std::os::unix::fs::MetadataExt;
        Self { volume: about.dev(), index: about.ino() }
    }

    #[cfg(windows)]
    fn of_handle(handle: impl winapi_util::AsHandleRef) -> Option<Self> {
        let about = winapi_util::file::information(handle).ok()?;
        Some(Self { volume: about.volume_serial_number(), index: about.file_index() })
    }
}
