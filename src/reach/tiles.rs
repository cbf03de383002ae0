//! Numbers of tiles.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// Mixes the coordinates of a tile. They come from an archive, and a slow map is the worst that a crafted one can
/// cause.
#[derive(Debug, Clone, Default)]
struct TileHasher(u64);

impl Hasher for TileHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_u64(u64::from(*byte)));
    }

    fn write_u64(&mut self, value: u64) {
        let mixed = (self.0 ^ value).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 = mixed ^ mixed >> 32;
    }
}

/// Numbers of the added tiles, in the order of addition.
#[derive(Debug, Clone, Default)]
pub struct TileNumbers(HashMap<u64, u32, BuildHasherDefault<TileHasher>>);

impl TileNumbers {
    fn key([x, y]: [i32; 2]) -> u64 {
        u64::from(x as u32) | u64::from(y as u32) << 32
    }

    /// Returns the number of the tile `at`, if it has been added.
    #[inline]
    pub fn get(&self, at: [i32; 2]) -> Option<usize> {
        self.0.get(&Self::key(at)).map(|number| *number as usize)
    }

    /// Adds the tile `at`, which has not been added before.
    pub fn add(&mut self, at: [i32; 2]) {
        let number = self.0.len() as u32;
        self.0.insert(Self::key(at), number);
    }
}
