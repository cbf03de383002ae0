//! Disk in memory that records every change, and the states that a power loss may leave.
//!
//! | step | what a power loss may undo, and until when |
//! |---|---|
//! | a write | any of its blocks of 4 KiB, which then hold what was there before, or zeros; or all of it but the new length; until its file is synced |
//! | a name (created, renamed, removed) | that change of the name, in any order; until its folder is synced |
//! | a report of the program | nothing: its reader relies on it |
//!
//! A killed process undoes nothing: all its writes stay, and its locks are released.

use crate::bytes::FileId;
use crate::disk::{About, Access, Disk, DiskFile, DiskFolder, FileKind};
use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Bytes that reach a disk together or not at all.
const BLOCK: usize = 4096;

/// Change of the disk.
#[derive(Debug, Clone)]
pub enum Step {
    Create {
        path: PathBuf,
        file: u64,
    },
    Write {
        file: u64,
        at: u64,
        bytes: Vec<u8>,
    },
    Sync {
        file: u64,
    },
    Rename {
        from: PathBuf,
        to: PathBuf,
        file: u64,
    },
    Remove {
        path: PathBuf,
    },
    SyncFolder {
        folder: PathBuf,
    },
    /// Report of the program.
    Said(&'static str),
}

/// Names and contents.
#[derive(Debug, Clone, Default)]
pub struct Content {
    names: BTreeMap<PathBuf, u64>,
    files: BTreeMap<u64, Vec<u8>>,
}

impl Content {
    /// Puts a durable file into the folder.
    pub fn put(&mut self, path: &Path, bytes: Vec<u8>) {
        let file = self.files.keys().next_back().map_or(0, |last| last + 1);
        self.names.insert(path.to_path_buf(), file);
        self.files.insert(file, bytes);
    }

    pub fn bytes(&self, path: &Path) -> Option<&[u8]> {
        self.files.get(self.names.get(path)?).map(Vec::as_slice)
    }

    pub fn names(&self) -> impl Iterator<Item = &Path> {
        self.names.keys().map(PathBuf::as_path)
    }

    /// Returns the same hash for contents that no program can distinguish.
    pub fn hash(&self) -> u64 {
        self.hash_but(|_| false)
    }

    /// Like [`hash`](Self::hash), but ignoring the bytes of some files.
    pub fn hash_but(&self, without: impl Fn(&Path) -> bool) -> u64 {
        let mut hasher = DefaultHasher::new();
        for (path, file) in &self.names {
            (path, self.files.get(file).filter(|_| !without(path))).hash(&mut hasher);
        }
        hasher.finish()
    }

    fn write(&mut self, file: u64, at: u64, bytes: &[u8]) {
        let content = self.files.entry(file).or_default();
        let end = at as usize + bytes.len();
        content.resize(content.len().max(end), 0);
        content[at as usize..end].copy_from_slice(bytes);
    }

    fn apply(&mut self, step: &Step) {
        match step {
            Step::Create { path, file } => {
                self.names.insert(path.clone(), *file);
                self.files.entry(*file).or_default();
            }
            Step::Write { file, at, bytes } => self.write(*file, *at, bytes),
            Step::Rename { from, to, file } => {
                self.names.remove(from);
                self.names.insert(to.clone(), *file);
                // A name can be durable before any content of its file is.
                self.files.entry(*file).or_default();
            }
            Step::Remove { path } => drop(self.names.remove(path)),
            Step::Sync { .. } | Step::SyncFolder { .. } | Step::Said(_) => {}
        }
    }
}

/// Fate of a step that was not durable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    Kept,
    Lost,
    /// The file has its new length, and the bytes are zeros.
    LengthOnly,
    /// The first half of its bytes arrived.
    Half,
    /// The blocks that arrived are given by the bits of this number, repeated.
    Blocks(u64),
}

/// Recording of a disk: the initial content, and the steps.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    pub begin: Content,
    pub steps: Vec<Step>,
}

impl Recording {
    /// Returns the numbers of the steps that sync.
    pub fn syncs(&self) -> Vec<usize> {
        let is_sync = |step: &Step| matches!(step, Step::Sync { .. } | Step::SyncFolder { .. });
        (0..self.steps.len()).filter(|&at| is_sync(&self.steps[at])).collect()
    }

    /// Returns for each of the first `end` steps whether it is durable after them, if step `without` does nothing.
    pub fn durable(&self, end: usize, without: Option<usize>) -> Vec<bool> {
        let mut durable = vec![false; end];
        for (at, step) in self.steps[..end].iter().enumerate() {
            let synced: &dyn Fn(&Step) -> bool = match step {
                _ if without == Some(at) => continue,
                Step::Sync { file } => &move |step| matches!(step, Step::Write { file: of, .. } if of == file),
                Step::SyncFolder { folder } => &move |step| match step {
                    Step::Create { path, .. } | Step::Remove { path } | Step::Rename { to: path, .. } => {
                        path.parent() == Some(folder)
                    }
                    _ => false,
                },
                _ => continue,
            };
            for (earlier, durable) in durable[..at].iter_mut().enumerate() {
                *durable |= synced(&self.steps[earlier]);
            }
        }
        durable
    }

    /// Returns what a power loss after the first steps leaves, given the fate of those that are not `durable`.
    pub fn left(&self, durable: &[bool], mut fate: impl FnMut(usize) -> Fate) -> Content {
        let mut content = self.begin.clone();
        for (at, (step, &durable)) in self.steps.iter().zip(durable).enumerate() {
            let fate = if durable { Fate::Kept } else { fate(at) };
            match (step, fate) {
                (_, Fate::Kept) => content.apply(step),
                (Step::Write { file, at, bytes }, Fate::Half) => content.write(*file, *at, &bytes[..bytes.len() / 2]),
                (Step::Write { file, at, bytes }, Fate::LengthOnly) => {
                    content.write(*file, at + bytes.len() as u64, &[]);
                }
                (Step::Write { file, at, bytes }, Fate::Blocks(kept)) => {
                    for (number, block) in bytes.chunks(BLOCK).enumerate() {
                        if kept >> (number % 64) & 1 == 1 {
                            content.write(*file, at + (number * BLOCK) as u64, block);
                        }
                    }
                }
                _ => {}
            }
        }
        content
    }

    /// Returns whether the program reported `text` in the first `end` steps.
    pub fn said(&self, end: usize, text: &str) -> bool {
        self.steps[..end].iter().any(|step| matches!(step, Step::Said(said) if *said == text))
    }
}

#[derive(Debug, Default)]
struct State {
    content: Content,
    recording: Recording,
    locked: Vec<u64>,
}

/// Disk in memory. Every folder exists.
#[derive(Debug, Clone, Default)]
pub struct ModelDisk(Arc<Mutex<State>>);

impl ModelDisk {
    /// Creates a disk that holds `content`, all of it durable.
    pub fn new(content: Content) -> Arc<Self> {
        let recording = Recording { begin: content.clone(), steps: Vec::new() };
        Arc::new(Self(Arc::new(Mutex::new(State { content, recording, locked: Vec::new() }))))
    }

    pub fn content(&self) -> Content {
        self.state().content.clone()
    }

    pub fn recording(&self) -> Recording {
        self.state().recording.clone()
    }

    /// Records a report of the program.
    pub fn say(&self, text: &'static str) {
        self.state().recording.steps.push(Step::Said(text));
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn file(&self, number: u64) -> Box<dyn DiskFile> {
        Box::new(ModelFile { disk: self.clone(), number, locked: Mutex::new(false) })
    }
}

impl State {
    fn done(&mut self, step: Step) {
        self.content.apply(&step);
        self.recording.steps.push(step);
    }

    fn number_of(&self, path: &Path) -> io::Result<u64> {
        self.content.names.get(path).copied().ok_or_else(|| ErrorKind::NotFound.into())
    }
}

impl Disk for ModelDisk {
    fn create(&self, path: &Path, _: Option<u32>) -> io::Result<Box<dyn DiskFile>> {
        let mut state = self.state();
        if state.content.names.contains_key(path) {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let file = state.content.files.keys().next_back().map_or(0, |last| last + 1);
        state.done(Step::Create { path: path.to_path_buf(), file });
        drop(state);
        Ok(self.file(file))
    }
    #[cfg(feature = "spill")]
    fn create_unnamed(&self, _: &Path) -> io::Result<Box<dyn DiskFile>> {
        Err(ErrorKind::Unsupported.into())
    }
    fn open(&self, path: &Path, _: Access) -> io::Result<Box<dyn DiskFile>> {
        let number = self.state().number_of(path)?;
        Ok(self.file(number))
    }
    fn about(&self, path: &Path) -> io::Result<About> {
        let state = self.state();
        let is_folder = state.content.names.keys().any(|name| name.starts_with(path) && name != path);
        if is_folder || path.extension().is_none() {
            return Ok(About { kind: FileKind::Folder, len: 0, mode: None, owner: None, read_only: false });
        }
        let len = state.content.files[&state.number_of(path)?].len() as u64;
        Ok(About { kind: FileKind::File, len, mode: None, owner: None, read_only: false })
    }
    fn id(&self, _: &Path) -> Option<FileId> {
        None
    }
    fn read_link(&self, _: &Path) -> io::Result<PathBuf> {
        Err(ErrorKind::InvalidInput.into())
    }
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.state();
        let file = state.number_of(from)?;
        state.done(Step::Rename { from: from.to_path_buf(), to: to.to_path_buf(), file });
        Ok(())
    }
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        if self.state().content.names.contains_key(to) {
            return Err(ErrorKind::AlreadyExists.into());
        }
        self.rename(from, to)
    }
    fn link(&self, _: &Path, _: &Path) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
    fn remove(&self, path: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.number_of(path)?;
        state.done(Step::Remove { path: path.to_path_buf() });
        Ok(())
    }
    fn list(&self, folder: &Path, wanted: &dyn Fn(&OsStr) -> bool) -> io::Result<Vec<OsString>> {
        let state = self.state();
        let inside = state.content.names.keys().filter(|path| path.parent() == Some(folder));
        Ok(inside.filter_map(|path| path.file_name()).filter(|name| wanted(name)).map(OsStr::to_owned).collect())
    }
    fn open_folder(&self, path: &Path) -> io::Result<Box<dyn DiskFolder>> {
        Ok(Box::new(ModelFolder { disk: self.clone(), path: path.to_path_buf() }))
    }
    #[cfg(feature = "spill")]
    fn free_bytes(&self, _: &Path) -> io::Result<u64> {
        Ok(u64::MAX)
    }
}

#[derive(Debug)]
struct ModelFile {
    disk: ModelDisk,
    number: u64,
    locked: Mutex<bool>,
}

impl Drop for ModelFile {
    fn drop(&mut self) {
        if *self.locked.get_mut().unwrap_or_else(PoisonError::into_inner) {
            self.disk.state().locked.retain(|&locked| locked != self.number);
        }
    }
}

impl DiskFile for ModelFile {
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        let state = self.disk.state();
        let bytes = state.content.files[&self.number].get(offset as usize..).unwrap_or(&[]);
        let count = bytes.len().min(buf.len());
        buf[..count].copy_from_slice(&bytes[..count]);
        Ok(count)
    }
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize> {
        self.disk.state().done(Step::Write { file: self.number, at: offset, bytes: bytes.to_vec() });
        Ok(bytes.len())
    }
    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        self.write_at(bytes, self.len()?)
    }
    fn len(&self) -> io::Result<u64> {
        Ok(self.disk.state().content.files[&self.number].len() as u64)
    }
    fn sync(&self) -> io::Result<()> {
        self.disk.state().done(Step::Sync { file: self.number });
        Ok(())
    }
    fn try_lock(&self) -> io::Result<bool> {
        let mut state = self.disk.state();
        if state.locked.contains(&self.number) {
            return Ok(false);
        }
        state.locked.push(self.number);
        *self.locked.lock().unwrap_or_else(PoisonError::into_inner) = true;
        Ok(true)
    }
}

#[derive(Debug)]
struct ModelFolder {
    disk: ModelDisk,
    path: PathBuf,
}

impl DiskFolder for ModelFolder {
    fn sync(&self) -> io::Result<()> {
        self.disk.state().done(Step::SyncFolder { folder: self.path.clone() });
        Ok(())
    }
}
