//! Vertices of a mesh by number: in memory as far as they fit, the rest in an unnamed temporary file.

use super::MeshOptions;
use super::blocks::{BLOCK_BYTES, Blocks};
use crate::disk::{Files, OpenFile};
use crate::{Error, Parameter, Result};
use std::io::ErrorKind;
use std::path::PathBuf;

const VERTEX_BYTES: usize = 24;
const BUFFER_BYTES: usize = 64 << 10;

/// Vertices in file order, 24 bytes each.
pub(super) struct Vertices {
    memory: Vec<[f64; 3]>,
    most_in_memory: usize,
    temp_dir: PathBuf,
    files: Files,
    /// File for the vertices beyond those in memory, with its cache.
    file: Option<(OpenFile, Blocks)>,
    file_bytes: u64,
    buffer: Vec<u8>,
    count: u64,
}

impl Vertices {
    /// Creates an empty list; a third of `options.memory_bytes` limits the vertices in memory.
    pub(super) fn new(options: &MeshOptions) -> Self {
        // A growing vector takes up to three times its contents while it reallocates.
        let most_in_memory = (options.memory_bytes / 3 / VERTEX_BYTES as u64) as usize;
        let temp_dir = options.temp_dir.clone();
        let files = Files::current();
        Self {
            memory: Vec::new(),
            most_in_memory,
            temp_dir,
            files,
            file: None,
            file_bytes: 0,
            buffer: Vec::new(),
            count: 0,
        }
    }

    pub(super) fn len(&self) -> u64 {
        self.count
    }

    pub(super) fn push(&mut self, vertex: [f64; 3]) -> Result<()> {
        self.count += 1;
        if self.memory.len() < self.most_in_memory {
            self.memory.push(vertex);
            return Ok(());
        }
        vertex.iter().for_each(|v| self.buffer.extend_from_slice(&v.to_ne_bytes()));
        if self.buffer.len() >= BUFFER_BYTES { self.flush() } else { Ok(()) }
    }

    /// Makes all vertices readable; must follow the last [`push`](Self::push).
    pub(super) fn flush(&mut self) -> Result<()> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let dir = &self.temp_dir;
        let refused = |action| move |e| Error::io(dir, action, e).with_suggestion(Parameter::TempDir);
        let (file, blocks) = match &mut self.file {
            Some(file) => file,
            none => {
                let action = "create a temporary file";
                none.insert((self.files.create_unnamed(dir).map_err(refused(action))?, Blocks::new()))
            }
        };
        blocks.forget();
        file.write_at(self.file_bytes, &self.buffer).map_err(refused("write temporary data"))?;
        self.file_bytes += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Returns vertex `number`, if it exists.
    pub(super) fn get(&mut self, number: u64) -> Result<Option<[f64; 3]>> {
        if number >= self.count {
            return Ok(None);
        }
        if let Some(&vertex) = usize::try_from(number).ok().and_then(|number| self.memory.get(number)) {
            return Ok(Some(vertex));
        }
        let Some((file, blocks)) = &mut self.file else { return Ok(None) };
        let mut bytes = [0; VERTEX_BYTES];
        let at = (number - self.memory.len() as u64) * VERTEX_BYTES as u64;
        let load = |number: u64, block: &mut Vec<u8>| {
            block.resize(BLOCK_BYTES, 0);
            let filled = file.read_up_to(number * BLOCK_BYTES as u64, block)?;
            block.truncate(filled);
            Ok(())
        };
        match blocks.read(0, at, &mut bytes, load) {
            Ok(true) => {}
            Ok(false) => return Err(Error::io(&self.temp_dir, "read temporary data", ErrorKind::UnexpectedEof.into())),
            Err(e) => return Err(Error::io(&self.temp_dir, "read temporary data", e)),
        }
        let (values, _) = bytes.as_chunks::<8>();
        Ok(Some([0, 1, 2].map(|axis| f64::from_ne_bytes(values[axis]))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_come_back_from_memory_and_from_the_file() {
        for memory_bytes in [0, 72 * 100, 1 << 20] {
            let temp_dir = std::env::temp_dir();
            let mut vertices = Vertices::new(&MeshOptions { memory_bytes, temp_dir, ..MeshOptions::default() });
            let vertex = |n: u64| [n as f64, -(n as f64), 0.5 / (n + 1) as f64];
            (0..10_000).for_each(|n| vertices.push(vertex(n)).unwrap());
            vertices.flush().unwrap();
            assert_eq!(vertices.len(), 10_000);
            for n in (0..10_000).map(|n| n * 7919 % 10_000) {
                assert_eq!(vertices.get(n).unwrap(), Some(vertex(n)));
            }
            assert_eq!(vertices.get(10_000).unwrap(), None);
            assert_eq!(vertices.file.is_some(), memory_bytes < 1 << 20);
        }
    }
}
