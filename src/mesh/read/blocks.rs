//! Random access to a file in small pieces, through a cache of fixed size.

use crate::{Error, Result};
use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

const BLOCK_BYTES: usize = 4096;
/// Blocks held; faces of real meshes use corners near those of the faces before.
const BLOCKS: usize = 256;

/// A file whose blocks are kept where they were read last: block `n` in place `n % 256`.
pub(super) struct Blocks {
    file: File,
    path: PathBuf,
    held: Vec<Block>,
}

#[derive(Clone)]
struct Block {
    number: u64,
    bytes: Vec<u8>,
}

impl Blocks {
    /// A cache for `file`, which is called `path` in errors.
    pub(super) fn new(file: File, path: &Path) -> Self {
        let empty = Block { number: u64::MAX, bytes: Vec::new() };
        Self { file, path: path.to_path_buf(), held: vec![empty; BLOCKS] }
    }

    pub(super) fn file_mut(&mut self) -> &mut File {
        &mut self.file
    }

    /// Forgets what is held: the file has changed.
    pub(super) fn forget(&mut self) {
        self.held.iter_mut().for_each(|block| block.number = u64::MAX);
    }

    /// Fills `out` from `offset` on.
    pub(super) fn read(&mut self, mut offset: u64, mut out: &mut [u8]) -> Result<()> {
        let Self { file, path, held } = self;
        while !out.is_empty() {
            let (number, skip) = (offset / BLOCK_BYTES as u64, (offset % BLOCK_BYTES as u64) as usize);
            let block = &mut held[(number % BLOCKS as u64) as usize];
            if block.number != number {
                block.load(file, number).map_err(|e| Error::io(&*path, format!("read at byte {offset}"), e))?;
            }
            let bytes = block.bytes.get(skip..).unwrap_or(&[]);
            if bytes.is_empty() {
                let reason = "the file ends before it; fetch or write it again";
                return Err(Error::input(path, format!("byte {offset}"), reason));
            }
            let count = bytes.len().min(out.len());
            out[..count].copy_from_slice(&bytes[..count]);
            out = &mut out[count..];
            offset += count as u64;
        }
        Ok(())
    }
}

impl Block {
    fn load(&mut self, file: &mut File, number: u64) -> std::io::Result<()> {
        // Until it is filled it is no block.
        self.number = u64::MAX;
        self.bytes.resize(BLOCK_BYTES, 0);
        file.seek(SeekFrom::Start(number * BLOCK_BYTES as u64))?;
        let mut filled = 0;
        while filled < BLOCK_BYTES {
            match file.read(&mut self.bytes[filled..]) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        self.bytes.truncate(filled);
        self.number = number;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn pieces_across_blocks_and_far_apart_are_those_of_the_file() {
        let all: Vec<u8> = (0..3_000_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&all).unwrap();
        let mut blocks = Blocks::new(file, Path::new("test"));
        for n in 0..2000usize {
            let (at, count) = (n * 7_919_777 % 2_990_000, n % 9000);
            let mut out = vec![0; count];
            blocks.read(at as u64, &mut out).unwrap();
            assert!(out == all[at..at + count], "{count} bytes at {at}");
        }
        for at in [2_999_990, 3_000_000, 1 << 40, u64::MAX - 20] {
            assert!(blocks.read(at, &mut [0; 12]).is_err(), "{at}");
        }
    }
}
