//! The same questions and the same walk, natively and as wasm: every answer is a row of bits.
//!
//! In: an archive. Out: 64-bit words, the bits of each answer one after the other. Random numbers and positions come from
//! integers and exact operations, so that a word that differs is a difference of the library.

mod questions;
mod walks;

pub use questions::{ANSWERS, answers};
pub use walks::{path, streamed_path};

/// SplitMix64 (Steele, Lea and Flood 2014).
pub(crate) struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn in_range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// What wasm exports: memory for the archive, and the words of each list.
#[cfg(target_family = "wasm")]
#[allow(unsafe_code)]
mod exports {
    use slicewalk::NoMonitor;
    use slicewalk::archive::Archive;
    use slicewalk::store::Store;
    use std::cell::RefCell;

    thread_local! {
        static ARCHIVE: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
        static WORDS: RefCell<Vec<u64>> = const { RefCell::new(Vec::new()) };
    }

    /// Makes room for an archive of `len` bytes; where it begins.
    // SAFETY: no other item of this name is linked.
    #[unsafe(no_mangle)]
    pub extern "C" fn archive_of(len: usize) -> *mut u8 {
        ARCHIVE.with_borrow_mut(|archive| {
            archive.resize(len, 0);
            archive.as_mut_ptr()
        })
    }

    /// Computes list 0 (answers), 1 (a walk on a store) or 2 (a walk on a loader); its number of words.
    // SAFETY: no other item of this name is linked.
    #[unsafe(no_mangle)]
    pub extern "C" fn compute(list: u32) -> usize {
        let bytes = ARCHIVE.with_borrow(Clone::clone);
        let store = || {
            let archive = Archive::from_bytes(bytes.clone()).expect("a sound archive");
            Store::resident(&archive, &NoMonitor).expect("sound pages")
        };
        let words = match list {
            0 => super::answers(&store()),
            1 => super::path(&store()),
            _ => super::streamed_path(&bytes),
        };
        WORDS.with_borrow_mut(|slot| {
            *slot = words;
            slot.len()
        })
    }

    /// Where the words of the last list begin.
    // SAFETY: no other item of this name is linked.
    #[unsafe(no_mangle)]
    pub extern "C" fn words() -> *const u64 {
        WORDS.with_borrow(|words| words.as_ptr())
    }
}
