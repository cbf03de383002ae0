//! Buffers of a glTF file, read in blocks through one cache and a few open files, however many buffers there are.

use super::structure::Buffer;
use crate::bytes::{Regular, Stamp};
use crate::input::beside::{Beside, decode_percent};
use crate::read::blocks::{Blocks, fill_block};
use crate::read::watch::Digest;
use crate::{Error, Result};
use base64::Engine;
use std::path::{Path, PathBuf};

/// Error text for a URI that points elsewhere.
pub const ELSEWHERE: &str = "it lies elsewhere; fetch it beside the file and name it there";
/// Most files held open.
const OPEN_FILES: usize = 8;

/// Where the bytes of a buffer are.
enum Data {
    /// In a file of its own, or in the second chunk of a `.glb`: file number, start and length (bytes).
    File { file: u32, start: u64, len: u64 },
    /// In the JSON itself.
    Memory(Vec<u8>),
}

impl Data {
    /// Leaves out what lies behind the first `len` bytes.
    fn cut_at(self, len: u64) -> Self {
        match self {
            Self::File { file, start, .. } => Self::File { file, start, len },
            Self::Memory(mut bytes) => {
                bytes.truncate(len as usize);
                Self::Memory(bytes)
            }
        }
    }

    fn len(&self) -> u64 {
        match self {
            Self::File { len, .. } => *len,
            Self::Memory(bytes) => bytes.len() as u64,
        }
    }
}

/// All buffers of a glTF file.
pub struct Buffers {
    /// The glTF file itself comes first.
    files: Vec<(PathBuf, Stamp)>,
    /// Open files, the most recently used last.
    open: Vec<(u32, Regular)>,
    all: Vec<Data>,
    beside: Beside,
    cache: Blocks,
    digest: Digest,
}

/// Start and length (bytes) of the binary chunk of a `.glb`.
pub type BinaryPart = (u64, u64);

impl Buffers {
    /// Opens the buffers that the file at `path` names, and checks that each has the bytes that it states.
    pub fn open(path: &Path, buffers: &[Buffer], binary: Option<BinaryPart>, digest: &Digest) -> Result<Self> {
        let own = |e| Error::io(path, "open", e);
        let (file, stamp) = Regular::open(path).map_err(own)?;
        let files = vec![(path.to_path_buf(), stamp)];
        let (open, all) = (vec![(0, file)], Vec::with_capacity(buffers.len()));
        let (beside, cache) = (Beside::new(path), Blocks::new());
        let mut found = Self { files, open, all, beside, cache, digest: digest.clone() };
        for (number, buffer) in buffers.iter().enumerate() {
            // The binary chunk of a file is its first buffer.
            let data =
                found.find(buffer, binary.filter(|_| number == 0)).map_err(|reason| error(path, number, reason))?;
            let (stated, there) = (buffer.byte_length, data.len());
            if there < stated {
                let reason = format!("it should have {stated} bytes and has {there}: it is cut");
                return Err(error(path, number, reason));
            }
            // The chunk is padded to a multiple of four bytes; a file beside it may hold more than the buffer.
            if buffer.uri.is_none() && there - stated > 3 {
                let reason = format!(
                    "it states {stated} bytes, and the binary part of the file that holds it states {there}; write the \
                     file again"
                );
                return Err(error(path, number, reason));
            }
            found.all.push(data.cut_at(stated));
        }
        Ok(found)
    }

    fn find(&mut self, buffer: &Buffer, binary: Option<BinaryPart>) -> Result<Data, String> {
        let Some(uri) = buffer.uri.as_deref() else {
            if buffer.extensions.is_meshopt {
                return Err(
                    "its values are there compressed by EXT_meshopt_compression only; export the file without it"
                        .into(),
                );
            }
            let (start, len) = binary.ok_or("it should lie in this file, which has no binary part")?;
            return Ok(Data::File { file: 0, start, len });
        };
        if let Some(bytes) = Self::in_text(uri) {
            return Ok(Data::Memory(bytes?));
        }
        if uri.contains(':') {
            return Err(ELSEWHERE.into());
        }
        let path = self.beside.path(&decode_percent(uri))?;
        let refused = |e| format!("cannot open {}: {e}", path.display());
        let (file, stamp) = Regular::open(&path).map_err(refused)?;
        let number = self.files.len() as u32;
        self.files.push((path, stamp));
        self.keep_open(number, file);
        Ok(Data::File { file: number, start: 0, len: stamp.len() })
    }

    fn keep_open(&mut self, number: u32, file: Regular) {
        if self.open.len() == OPEN_FILES {
            self.open.remove(0);
        }
        self.open.push((number, file));
    }

    /// Decodes the base64 text of a `data:` URI; `None` if `uri` is not one.
    pub fn in_text(uri: &str) -> Option<Result<Vec<u8>, String>> {
        let text = uri.split_once("base64,").filter(|(head, _)| head.starts_with("data:"))?.1;
        let bytes = base64::engine::general_purpose::STANDARD.decode(text);
        Some(bytes.map_err(|e| format!("its base64 text is damaged: {e}")))
    }

    /// Returns the length of a buffer (bytes).
    pub fn len(&self, buffer: usize) -> Option<u64> {
        self.all.get(buffer).map(Data::len)
    }

    /// Fills `out` with the bytes of a buffer from `at` on.
    pub fn read(&mut self, buffer: usize, at: u64, out: &mut [u8]) -> Result<()> {
        let short = |path: &Path| error(path, buffer, "the file ends before its values; fetch or write it again");
        match self.all.get(buffer) {
            Some(&Data::File { file, start, .. }) => {
                let Self { files, open, cache, digest, .. } = self;
                let at = start + at;
                let load = |number, bytes: &mut Vec<u8>| {
                    let block = Self::open_again(files, open, file)?;
                    fill_block(block, number, bytes)?;
                    digest.update(&file.to_le_bytes());
                    digest.update(bytes);
                    Ok(())
                };
                match cache.read(file, at, out, load) {
                    Ok(true) => Ok(()),
                    Ok(false) => Err(short(&self.files[0].0)),
                    Err(e) => Err(Error::io(&self.files[0].0, format!("read buffer {buffer} at byte {at}"), e)),
                }
            }
            Some(Data::Memory(bytes)) => {
                let there = usize::try_from(at).ok().and_then(|at| bytes.get(at..)?.get(..out.len()));
                out.copy_from_slice(there.ok_or_else(|| short(&self.files[0].0))?);
                Ok(())
            }
            None => Err(short(&self.files[0].0)),
        }
    }

    /// Returns file `number`, reopened if it was closed.
    fn open_again<'o>(
        files: &[(PathBuf, Stamp)],
        open: &'o mut Vec<(u32, Regular)>,
        number: u32,
    ) -> std::io::Result<&'o mut Regular> {
        let at = match open.iter().position(|file| file.0 == number) {
            Some(at) => at,
            None => {
                let (path, stamp) = &files[number as usize];
                let (file, now) = Regular::open(path)?;
                if now != *stamp {
                    return Err(std::io::Error::other(format!("{} changed while it was read", path.display())));
                }
                if open.len() == OPEN_FILES {
                    open.remove(0);
                }
                open.push((number, file));
                open.len() - 1
            }
        };
        let file = open.remove(at);
        open.push(file);
        let last = open.len() - 1;
        Ok(&mut open[last].1)
    }

    /// Returns the first file that changed since it was opened.
    pub fn changed(&self) -> Option<&Path> {
        self.files.iter().find(|(path, stamp)| !stamp.is_of(path)).map(|(path, _)| path.as_path())
    }
}

fn error(path: &Path, buffer: usize, reason: impl Into<String>) -> Error {
    Error::input(path, format!("buffer {buffer}"), reason)
}
