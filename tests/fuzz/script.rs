//! Interprets a fuzzer's bytes as choices; any bytes are valid.

/// Takes choices from bytes, and zeros once they are used up.
pub struct Script<'a>(pub &'a [u8]);

impl Script<'_> {
    pub fn is_over(&self) -> bool {
        self.0.is_empty()
    }

    pub fn byte(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        first
    }

    /// Two bytes, little-endian.
    pub fn short(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// Below `end`, which is positive.
    pub fn below(&mut self, end: usize) -> usize {
        let choice = if end <= 256 { usize::from(self.byte()) } else { usize::from(self.short()) };
        choice % end
    }

    /// Changes `bytes` at one place: flips a bit, sets a byte, writes a number at the edge of its type, or drops or
    /// doubles a part.
    pub fn change(&mut self, bytes: &mut Vec<u8>) {
        let kind = self.below(5);
        let at = self.below(bytes.len().max(1));
        if bytes.is_empty() {
            return bytes.push(self.byte());
        }
        match kind {
            0 => bytes[at] ^= 1 << self.below(8),
            1 => bytes[at] = self.byte(),
            2 => self.overwrite(bytes, at),
            3 => drop(bytes.drain(at..bytes.len().min(at + 1 + self.below(16)))),
            _ => {
                let piece = bytes[at..bytes.len().min(at + 1 + self.below(16))].to_vec();
                bytes.splice(at..at, piece);
            }
        }
    }

    /// Like [`change`](Self::change), but keeps the length.
    pub fn change_in_place(&mut self, bytes: &mut [u8]) {
        let kind = self.below(3);
        let at = self.below(bytes.len().max(1));
        match kind {
            _ if bytes.is_empty() => {}
            0 => bytes[at] ^= 1 << self.below(8),
            1 => bytes[at] = self.byte(),
            _ => self.overwrite(bytes, at),
        }
    }

    /// Writes a number at the limit of a check.
    fn overwrite(&mut self, bytes: &mut [u8], at: usize) {
        const EDGES: [u64; 10] = [0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF, i64::MAX as u64, u64::MAX];
        let width = [1, 2, 4, 8][self.below(4)].min(bytes.len() - at);
        let value = EDGES[self.below(EDGES.len())].to_le_bytes();
        bytes[at..at + width].copy_from_slice(&value[..width]);
    }
}
