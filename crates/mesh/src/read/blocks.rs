//! Random access to files through a small block cache of fixed size (1 MiB).

use std::io::{self, Read, Seek, SeekFrom};

pub(super) const BLOCK_BYTES: usize = 4096;
/// Blocks in the cache; faces of real meshes use corners near those of the previous faces.
const BLOCKS: u64 = 256;

/// Direct-mapped cache of blocks of any number of files.
pub(super) struct Blocks {
    held: Vec<Block>,
}

#[derive(Clone)]
struct Block {
    /// File and block number; [`NO_FILE`] if the entry is empty.
    name: (u32, u64),
    bytes: Vec<u8>,
}

const NO_FILE: u32 = u32::MAX;

impl Blocks {
    pub(super) fn new() -> Self {
        Self { held: vec![Block { name: (NO_FILE, 0), bytes: Vec::new() }; BLOCKS as usize] }
    }

    /// Empties the cache, because the files have changed.
    pub(super) fn forget(&mut self) {
        self.held.iter_mut().for_each(|block| block.name.0 = NO_FILE);
    }

    /// Fills `out` with the bytes of `file` from `offset` on, loading blocks by number with `load`; returns false if
    /// the file ends too early.
    pub(super) fn read(
        &mut self,
        file: u32,
        mut offset: u64,
        mut out: &mut [u8],
        mut load: impl FnMut(u64, &mut Vec<u8>) -> io::Result<()>,
    ) -> io::Result<bool> {
        while !out.is_empty() {
            let (number, skip) = (offset / BLOCK_BYTES as u64, (offset % BLOCK_BYTES as u64) as usize);
            let place = number.wrapping_add(u64::from(file).wrapping_mul(37)) % BLOCKS;
            let block = &mut self.held[place as usize];
            if block.name != (file, number) {
                // The entry is invalid until it is filled.
                block.name.0 = NO_FILE;
                load(number, &mut block.bytes)?;
                block.name = (file, number);
            }
            let bytes = block.bytes.get(skip..).unwrap_or(&[]);
            if bytes.is_empty() {
                return Ok(false);
            }
            let count = bytes.len().min(out.len());
            out[..count].copy_from_slice(&bytes[..count]);
            out = &mut out[count..];
            offset += count as u64;
        }
        Ok(true)
    }
}

/// Reads block `number` of `file`, up to the end of the file.
pub(super) fn fill_block(file: &mut (impl Read + Seek), number: u64, bytes: &mut Vec<u8>) -> io::Result<()> {
    bytes.clear();
    bytes.reserve(BLOCK_BYTES);
    file.seek(SeekFrom::Start(number.saturating_mul(BLOCK_BYTES as u64)))?;
    file.take(BLOCK_BYTES as u64).read_to_end(bytes).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn pieces_across_blocks_and_far_apart_are_those_of_the_files() {
        let all = |salt: u32| -> Vec<u8> {
            (0..1_000_000u32).map(|i| (i.wrapping_mul(2_654_435_761).wrapping_add(salt << 24) >> 24) as u8).collect()
        };
        let all = [all(0), all(77)];
        let mut files = [0, 1].map(|n: usize| {
            let mut file = tempfile::tempfile().unwrap();
            file.write_all(&all[n]).unwrap();
            file
        });
        let mut blocks = Blocks::new();
        let mut read = |file: usize, at: u64, out: &mut [u8]| {
            let load = |number, bytes: &mut Vec<u8>| fill_block(&mut files[file], number, bytes);
            blocks.read(file as u32, at, out, load)
        };
        for n in 0..4000usize {
            let (at, count) = (n * 7_919_777 % 990_000, n % 9000);
            let mut out = vec![0; count];
            assert!(read(n % 2, at as u64, &mut out).unwrap());
            assert!(out == all[n % 2][at..at + count], "{count} bytes at {at}");
        }
        for at in [999_990, 1_000_000, 1 << 40] {
            assert!(!read(0, at, &mut [0; 12]).unwrap(), "{at}");
        }
    }
}
