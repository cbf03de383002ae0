//! CRC-32C. Processors have an instruction for it. On WebAssembly the table is computed on first use, because a
//! compiled-in table would add 8 kB to every download.

#[cfg(not(target_arch = "wasm32"))]
pub use ::crc32c::{crc32c, crc32c_append};
#[cfg(target_arch = "wasm32")]
pub use soft::{crc32c, crc32c_append};

#[cfg(any(target_arch = "wasm32", test))]
mod soft {
    use std::sync::OnceLock;

    /// Polynomial with its bits reversed.
    const POLYNOMIAL: u32 = 0x82F6_3B78;

    type Tables = [[u32; 256]; 8];

    /// Returns the remainders of a byte followed by 0 to 7 zero bytes.
    fn tables() -> &'static Tables {
        static TABLES: OnceLock<Box<Tables>> = OnceLock::new();
        TABLES.get_or_init(|| {
            let mut tables = Box::new([[0; 256]; 8]);
            for byte in 0..256 {
                let mut rest = byte as u32;
                for _ in 0..8 {
                    rest = rest >> 1 ^ (POLYNOMIAL & 0u32.wrapping_sub(rest & 1));
                }
                tables[0][byte] = rest;
            }
            for zeros in 1..8 {
                for byte in 0..256 {
                    let rest = tables[zeros - 1][byte];
                    tables[zeros][byte] = rest >> 8 ^ tables[0][(rest & 0xFF) as usize];
                }
            }
            tables
        })
    }

    /// Returns the checksum of `bytes`.
    pub fn crc32c(bytes: &[u8]) -> u32 {
        crc32c_append(0, bytes)
    }

    /// Continues the checksum `crc` with `bytes`.
    pub fn crc32c_append(crc: u32, bytes: &[u8]) -> u32 {
        let tables = tables();
        let (eights, rest) = bytes.as_chunks::<8>();
        let mut crc = !crc;
        for eight in eights {
            let word = u64::from_le_bytes(*eight) ^ u64::from(crc);
            crc = (0..8).fold(0, |sum, n| sum ^ tables[7 - n][(word >> (8 * n) & 0xFF) as usize]);
        }
        !rest.iter().fold(crc, |crc, byte| crc >> 8 ^ tables[0][((crc ^ u32::from(*byte)) & 0xFF) as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::soft;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_table_gives_what_the_processor_does(known: u32, bytes in proptest::collection::vec(any::<u8>(), 0..100)) {
            prop_assert_eq!(soft::crc32c(&bytes), ::crc32c::crc32c(&bytes));
            prop_assert_eq!(soft::crc32c_append(known, &bytes), ::crc32c::crc32c_append(known, &bytes));
        }
    }
}
