//! Little-endian numbers and varints from untrusted bytes (specification, chapter 2).

use super::Violation;

/// Longest varint (bytes): 64 bits in groups of 7.
pub const MAX_VARINT: usize = 10;

/// Reads numbers from the front of a byte string. Missing bytes break the rule that it was created with.
#[derive(Debug, Clone)]
pub struct ByteReader<'a> {
    rest: &'a [u8],
    rule: &'static str,
}

impl<'a> ByteReader<'a> {
    /// Creates a reader of `bytes`. Missing bytes and varints that are not canonical break `rule`.
    pub fn new(bytes: &'a [u8], rule: &'static str) -> Self {
        Self { rest: bytes, rule }
    }

    /// Reads `len` bytes.
    pub fn take(&mut self, len: usize) -> Result<&'a [u8], Violation> {
        let Some((head, rest)) = self.rest.split_at_checked(len) else {
            return Err(Violation::new(self.rule, format!("{len} more bytes"), self.rest.len()));
        };
        self.rest = rest;
        Ok(head)
    }

    /// Reads `N` bytes as an array.
    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], Violation> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    /// Reads a 32-bit number.
    pub fn u32(&mut self) -> Result<u32, Violation> {
        self.array().map(u32::from_le_bytes)
    }

    /// Reads a 64-bit number.
    pub fn u64(&mut self) -> Result<u64, Violation> {
        self.array().map(u64::from_le_bytes)
    }

    /// Reads a 64-bit float by its bits.
    pub fn f64(&mut self) -> Result<f64, Violation> {
        self.array().map(f64::from_le_bytes)
    }

    /// Reads a varint: 7 bits per byte, lowest first, high bit set on all but the last; no leading zero group.
    pub fn varint(&mut self) -> Result<u64, Violation> {
        let mut value = 0u64;
        for (at, &byte) in self.rest.iter().enumerate().take(MAX_VARINT) {
            let group = (byte & 0x7F) as u64;
            if at == MAX_VARINT - 1 && byte > 1 || at > 0 && byte == 0 {
                break;
            }
            value |= group << (7 * at);
            if byte < 0x80 {
                self.rest = &self.rest[at + 1..];
                return Ok(value);
            }
        }
        Err(Violation::new(self.rule, "a varint in its shortest form", format!("{:02x?}", self.start())))
    }

    /// Returns the number of bytes left.
    pub fn len(&self) -> usize {
        self.rest.len()
    }

    /// Returns whether nothing is left.
    pub fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    fn start(&self) -> &[u8] {
        &self.rest[..self.rest.len().min(MAX_VARINT)]
    }
}

/// Appends `value` as a varint, 1 to 10 bytes.
pub fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Maps small numbers of either sign to small numbers: 0, −1, 1, −2, 2 ... to 0, 1, 2, 3, 4 ...
pub fn zigzag(value: i64) -> u64 {
    (value << 1 ^ value >> 63) as u64
}

/// Inverse of [`zigzag`].
pub fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn refuses_varints_that_are_long_or_cut() {
        // Sets bit 64.
        let too_great = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 2];
        for bad in [&[][..], &[0x80], &[0x80, 0], &too_great, &[0xFF; 10], &[0xFF; 11]] {
            assert_eq!(ByteReader::new(bad, "D3").varint().unwrap_err().rule, "D3");
        }
        let longest = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 1];
        assert_eq!(ByteReader::new(&longest, "D3").varint(), Ok(u64::MAX));
    }

    proptest! {
        #[test]
        fn varints_round_trip(value: u64, shift in 0u32..64) {
            let value = value >> shift;
            let mut bytes = Vec::new();
            put_varint(&mut bytes, value);
            let mut reader = ByteReader::new(&bytes, "D3");
            prop_assert_eq!(reader.varint(), Ok(value));
            prop_assert!(reader.is_empty() && bytes.len() <= MAX_VARINT);
            prop_assert_eq!(unzigzag(zigzag(value as i64)), value as i64);
        }

        #[test]
        fn accepts_exactly_the_canonical_form(bytes in proptest::collection::vec(any::<u8>(), 0..12)) {
            let mut reader = ByteReader::new(&bytes, "D3");
            if let Ok(value) = reader.varint() {
                let mut again = Vec::new();
                put_varint(&mut again, value);
                prop_assert_eq!(&bytes[..again.len()], &again[..]);
            }
        }
    }
}
