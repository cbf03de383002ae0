//! Zip files: the directory at the end, entries stored or deflated, with the extensions for long files.

use super::Work;
use super::columns::{Column, Part, read_error};
use super::store::Store;
use flate2::Crc;
use flate2::bufread::DeflateDecoder;
use slicewalk_base::bytes::ByteSource;
use slicewalk_base::text::{file_size, shown};
use slicewalk_base::{Error, Result};
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

/// Most bytes behind the directory: its end and a comment.
const MOST_END: u64 = 22 + 65_535;
/// Most bytes of a directory: SOG has about ten entries.
const MOST_DIRECTORY: u64 = 16 << 20;
const END: &[u8] = b"PK\x05\x06";
const LONG_END: &[u8] = b"PK\x06\x06";
const LONG_LOCATOR: &[u8] = b"PK\x06\x07";
const ENTRY: &[u8] = b"PK\x01\x02";
const LOCAL: &[u8] = b"PK\x03\x04";
const LONG_EXTRA: u16 = 1;
const STORED: u16 = 0;
const DEFLATED: u16 = 8;

/// A file in a zip.
#[derive(Debug, Clone)]
pub struct Entry {
    pub name: String,
    method: u16,
    is_encrypted: bool,
    crc: u32,
    packed: u64,
    /// Unpacked length (bytes).
    pub size: u64,
    at: u64,
}

/// A zip whose directory was read.
pub struct Zip {
    source: Arc<dyn ByteSource>,
    pub entries: Vec<Entry>,
}

/// Little-endian fields in sequence; `None` at the end.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, len: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(taken)
    }

    fn number(&mut self, len: usize) -> Option<u64> {
        Some(self.take(len)?.iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte)))
    }

    fn short(&mut self) -> Option<u16> {
        self.number(2).map(|value| value as u16)
    }
}

fn wrong(path: &Path, reason: impl Into<String>) -> Error {
    Error::input(path, "zip directory", format!("{}; fetch or write it again", reason.into()))
}

impl Zip {
    pub fn open(source: Arc<dyn ByteSource>, path: &Path) -> Result<Self> {
        let cut = || wrong(path, "expected the directory of a zip at the end, found none: the file is cut");
        let len = source.len();
        let from = len.saturating_sub(MOST_END);
        let mut end = vec![0; (len - from) as usize];
        source.read_at(from, &mut end)?;
        let place = memchr::memmem::rfind(&end, END).ok_or_else(cut)?;
        let end_at = from + place as u64;
        let mut fields = Fields(&end[place..]);
        let (mut size, mut at) =
            fields.take(12).and_then(|_| fields.number(4)).zip(fields.number(4)).ok_or_else(cut)?;
        if size == u64::from(u32::MAX) || at == u64::from(u32::MAX) {
            (size, at) = Self::long_end(&source, end_at, path)?;
        }
        if at.checked_add(size).is_none_or(|directory_end| directory_end > end_at) || size > MOST_DIRECTORY {
            return Err(wrong(path, format!("the directory of {size} bytes at byte {at} does not fit before its end")));
        }
        let mut directory = vec![0; size as usize];
        source.read_at(at, &mut directory)?;
        let mut fields = Fields(&directory);
        let mut entries = Vec::new();
        while !fields.0.is_empty() {
            entries.push(entry(&mut fields).ok_or_else(|| wrong(path, format!("entry {} is damaged", entries.len())))?);
        }
        Ok(Self { source, entries })
    }

    /// Reads length and place of the directory of a long file.
    fn long_end(source: &Arc<dyn ByteSource>, end_at: u64, path: &Path) -> Result<(u64, u64)> {
        let broken = || wrong(path, "the end of the directory of a long file is damaged");
        let mut locator = [0; 20];
        source.read_at(end_at.checked_sub(20).ok_or_else(broken)?, &mut locator)?;
        let at = Fields(&locator[8..]).number(8).filter(|_| locator.starts_with(LONG_LOCATOR)).ok_or_else(broken)?;
        let mut end = [0; 56];
        if at.checked_add(56).is_none_or(|stop| stop > source.len()) {
            return Err(broken());
        }
        source.read_at(at, &mut end)?;
        let mut fields = Fields(&end[40..]);
        fields.number(8).zip(fields.number(8)).filter(|_| end.starts_with(LONG_END)).ok_or_else(broken)
    }

    /// Returns the only entry of this name, if there is one.
    pub fn find(&self, name: &str, path: &Path) -> Result<Option<&Entry>> {
        let mut found = self.entries.iter().filter(|entry| entry.name == name);
        match (found.next(), found.count()) {
            (entry, 0) => Ok(entry),
            (_, more) => {
                let name = shown(name.as_bytes());
                Err(wrong(path, format!("expected one entry {name}, found {}", more + 1)))
            }
        }
    }

    /// Returns the bytes of an entry, checked against their length and checksum. They take `memory` bytes of memory, and
    /// the rest goes to a temporary file.
    pub fn read(&self, entry: &Entry, path: &Path, work: &Work<'_>, memory: u64) -> Result<Arc<dyn ByteSource>> {
        let name = shown(entry.name.as_bytes());
        let wrong = |reason: &str| Error::input(path, &name, format!("{reason}; fetch or write it again"));
        if entry.is_encrypted || ![STORED, DEFLATED].contains(&entry.method) {
            return Err(wrong("expected a stored or deflated file, found one with another compression or a password"));
        }
        let mut local = [0; 30];
        if entry.at.checked_add(30).is_none_or(|end| end > self.source.len()) {
            return Err(wrong("it lies behind the end of the zip"));
        }
        self.source.read_at(entry.at, &mut local)?;
        if !local.starts_with(LOCAL) {
            return Err(wrong("expected its header where the directory says, found other bytes"));
        }
        let skipped = Fields(&local[26..]).number(2).zip(Fields(&local[28..]).number(2)).map_or(0, |(a, b)| a + b);
        let part = Part::new(&self.source, entry.at + 30 + skipped, entry.packed);
        let part: Arc<dyn ByteSource> = Arc::new(part.ok_or_else(|| wrong("it ends behind the end of the zip"))?);
        let mut reader: Box<dyn Read> = match entry.method {
            STORED => Box::new(Column::rest(&part, 0)),
            _ => Box::new(DeflateDecoder::new(Column::rest(&part, 0))),
        };
        let mut store = Store::new(work, memory);
        let (mut crc, mut block) = (Crc::new(), vec![0; 1 << 16]);
        loop {
            let len = reader.read(&mut block).map_err(|e| read_error(path, &name, e))?;
            if len == 0 {
                break;
            }
            if work.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            crc.update(&block[..len]);
            if store.len() + len as u64 > entry.size {
                return Err(wrong(&format!("expected {}, found more", file_size(entry.size))));
            }
            store.append(&block[..len])?;
        }
        if store.len() != entry.size {
            return Err(wrong(&format!("expected {}, found {}", file_size(entry.size), file_size(store.len()))));
        }
        if crc.sum() != entry.crc {
            return Err(wrong("its checksum does not match"));
        }
        Ok(Arc::new(store))
    }
}

fn entry(fields: &mut Fields<'_>) -> Option<Entry> {
    if fields.take(4)? != ENTRY {
        return None;
    }
    fields.take(4)?;
    let (flags, method) = (fields.short()?, fields.short()?);
    fields.take(4)?;
    let crc = fields.number(4)? as u32;
    let (mut packed, mut size) = (fields.number(4)?, fields.number(4)?);
    let [name, extra, comment] = [fields.short()?, fields.short()?, fields.short()?].map(usize::from);
    fields.take(8)?;
    let mut at = fields.number(4)?;
    let name = String::from_utf8_lossy(fields.take(name)?).into_owned();
    let mut extra = Fields(fields.take(extra)?);
    fields.take(comment)?;
    while let Some((kind, len)) = extra.short().zip(extra.short()) {
        let mut long = Fields(extra.take(usize::from(len))?);
        if kind == LONG_EXTRA {
            for value in [&mut size, &mut packed, &mut at] {
                if *value == u64::from(u32::MAX) {
                    *value = long.number(8)?;
                }
            }
        }
    }
    Some(Entry { name, method, is_encrypted: flags & 1 != 0, crc, packed, size, at })
}
