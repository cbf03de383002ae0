//! Archives with wrong numbers and valid checksums.
#![allow(dead_code, reason = "each test file uses a part")]

use slicewalk::codec::{Packer, Unpacker};
use std::cell::RefCell;

/// Parts of an archive with one leaf, to be reassembled with correct lengths and checksums.
#[derive(Clone)]
pub struct Parts {
    pub head: Vec<u8>,
    pub pages: Vec<u8>,
    pub leaf: Vec<u8>,
    pub metadata: Vec<u8>,
}

/// The u32 at `at`.
pub fn word(bytes: &[u8], at: usize) -> usize {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
}

/// Writes the lowest `len` bytes of `value` at `at`.
pub fn put(bytes: &mut [u8], at: usize, value: u64, len: usize) {
    bytes[at..at + len].copy_from_slice(&value.to_le_bytes()[..len]);
}

/// Appends the compressed `raw` to `out`.
pub fn pack(raw: &[u8], out: &mut Vec<u8>) {
    thread_local! {
        static PACKER: RefCell<Packer> = RefCell::default();
    }
    PACKER.with_borrow_mut(|packer| packer.pack(raw, out));
}

impl Parts {
    /// Splits an archive into its parts.
    pub fn of(bytes: &[u8]) -> Self {
        let mut at = 0;
        let mut take = |len: usize| {
            at += len;
            bytes[at - len..at].to_vec()
        };
        let head = take(word(bytes, 12));
        let pages = take(word(bytes, 288));
        let stored = take(word(bytes, 296));
        let metadata = take(word(bytes, 304));
        let leaf = Unpacker::new().unpack(&stored, 1 << 20, "").unwrap().to_vec();
        Self { head, pages, leaf, metadata }
    }

    /// The leaf as stored in the file.
    pub fn stored_leaf(&self) -> Vec<u8> {
        let mut stored = Vec::new();
        pack(&self.leaf, &mut stored);
        stored
    }

    /// Recomputes the head's numbers, lets `forge` change them, and recomputes the checksums.
    pub fn build(&self, forge: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
        let (mut head, stored) = (self.head.clone(), self.stored_leaf());
        let lens = [self.pages.len(), stored.len(), self.metadata.len()];
        let file_len = head.len() + lens.iter().sum::<usize>() + 24;
        put(&mut head, 32, file_len as u64, 8);
        for (field, len) in lens.iter().enumerate() {
            put(&mut head, 288 + 8 * field, *len as u64, 8);
        }
        put(&mut head, 312, crc32c::crc32c(&self.metadata) as u64, 4);
        put(&mut head, 384 + 16, stored.len() as u64, 4);
        put(&mut head, 384 + 20, self.leaf.len() as u64, 4);
        put(&mut head, 384 + 24, crc32c::crc32c(&stored) as u64, 4);
        forge(&mut head);
        let end = head.len() - 4;
        let crc = crc32c::crc32c(&head[..end]) as u64;
        put(&mut head, end, crc, 4);
        let mut footer = vec![0; 12];
        put(&mut footer, 0, file_len as u64, 8);
        put(&mut footer, 8, crc, 4);
        let crc = crc32c::crc32c(&footer);
        footer.extend(crc.to_le_bytes());
        [&head[..], &self.pages, &stored, &self.metadata, &footer, b"\x89ALS\r\n\x1a\n"].concat()
    }

    /// Replaces the encoding of the only page and recomputes lengths and checksums.
    pub fn with_page(&self, body: &[u8]) -> Self {
        let mut pages = [&self.pages[..24], body].concat();
        put(&mut pages, 16, body.len() as u64, 4);
        Self { pages, ..self.clone() }.with_leader()
    }

    /// Recomputes the checksum of the only page, and its length and checksum in the leaf.
    pub fn with_leader(mut self) -> Self {
        let crc = crc32c::crc32c_append(crc32c::crc32c(&self.pages[..20]), &self.pages[24..]);
        put(&mut self.pages, 20, crc as u64, 4);
        let mut len = Vec::new();
        slicewalk::codec::put_varint(&mut len, self.pages.len() as u64);
        // Base, column, layer, kind: one byte each; eight bytes of slices; then length, checksum, blocks and words.
        let size = self.leaf[self.leaf.len() - 2..].to_vec();
        self.leaf = [&self.leaf[..12], &len, &crc.to_le_bytes(), &size].concat();
        self
    }
}

/// An archive of `leaves` leaves of 2²⁰ uniform pages each, stacked vertically: 7 MB of directory in a few hundred
/// bytes each. It breaks no rule.
pub fn giant(template: &[u8], leaves: u32) -> Vec<u8> {
    const ENTRIES: u32 = 1 << 20;
    let pages = u64::from(leaves) * u64::from(ENTRIES);
    let count = ENTRIES as usize;
    let mut raw = vec![0; 1 + count];
    // Layers increase by one: zigzag(1). All pages have one span in their lowest slice.
    raw.push(0);
    raw.extend(std::iter::repeat_n(2, count - 1));
    raw.extend(std::iter::repeat_n(2, count));
    raw.extend((10u32 | 14 << 14).to_le_bytes().repeat(count));
    let mut leaf = Vec::new();
    Packer::new().pack(&raw, &mut leaf);
    let mut head = template[..384].to_vec();
    for (at, value) in [
        (216, 64 * (pages - 1)),
        (224, pages),
        (232, 0),
        (240, 0),
        (248, 4096 * pages),
        (256, 0),
        (264, 0),
        (272, 0),
        (280, pages),
        (288, 0),
        (296, u64::from(leaves) * leaf.len() as u64),
        (304, 0),
    ] {
        put(&mut head, at, value, 8);
    }
    // Slices of 0.3 m.
    let corners = [0.0, 0.0, 0.0125, 6.39, 6.39, (16320 * (pages - 1) + 14) as f64 * 0.3 / 255.0];
    for (axis, value) in corners.into_iter().enumerate() {
        put(&mut head, 160 + 8 * axis, value.to_bits(), 8);
    }
    for (at, value) in [(312, 0), (316, u64::from(ENTRIES)), (320, leaves.into())] {
        put(&mut head, at, value, 4);
    }
    for number in 0..u64::from(leaves) {
        let layer = number as u32 * ENTRIES;
        head.extend((3u64 << 62).to_le_bytes());
        for value in [layer, ENTRIES, leaf.len() as u32, raw.len() as u32, crc32c::crc32c(&leaf)] {
            head.extend(value.to_le_bytes());
        }
    }
    let head_len = head.len() + 4;
    let file_len = head_len + leaf.len() * leaves as usize + 24;
    put(&mut head, 12, head_len as u64, 4);
    put(&mut head, 32, file_len as u64, 8);
    let crc = crc32c::crc32c(&head);
    head.extend(crc.to_le_bytes());
    let mut footer = (file_len as u64).to_le_bytes().to_vec();
    footer.extend(crc.to_le_bytes());
    let footer_crc = crc32c::crc32c(&footer);
    footer.extend(footer_crc.to_le_bytes());
    [&head[..], &leaf.repeat(leaves as usize), &footer, b"\x89ALS\r\n\x1a\n"].concat()
}
