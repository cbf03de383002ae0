//! Footer: marks the archive as complete (chapter 8).

use super::{CRC, FOOTER, hex};
use crate::Result;
use crate::bytes::crc;
use crate::codec::Violation;

/// Last bytes of an archive.
pub(in crate::archive) const END_MAGIC: [u8; 8] = *b"\x89ALS\r\n\x1a\n";

/// Encodes the footer of an archive of `file_len` bytes whose head is `head`.
pub(in crate::archive) fn encode_footer(file_len: u64, head: &[u8]) -> [u8; FOOTER] {
    let mut out = [0; FOOTER];
    out[..8].copy_from_slice(&file_len.to_le_bytes());
    out[8..12].copy_from_slice(&head[head.len() - CRC..]);
    let crc = crc::crc32c(&out[..12]);
    out[12..16].copy_from_slice(&crc.to_le_bytes());
    out[16..].copy_from_slice(&END_MAGIC);
    out
}

/// Checks the footer `bytes` of an archive of `file_len` bytes whose head is `head` (rules F1 to F3).
pub(in crate::archive) fn check_footer(bytes: &[u8; FOOTER], file_len: u64, head: &[u8]) -> Result<()> {
    let at = |violation: Violation| violation.at("footer", file_len - FOOTER as u64);
    let expected = encode_footer(file_len, head);
    if bytes[16..] != END_MAGIC {
        return Err(at(Violation::new("F1", hex(&END_MAGIC), hex(&bytes[16..]))));
    }
    if crc::crc32c(&bytes[..12]).to_le_bytes() != bytes[12..16] {
        return Err(at(Violation::new("F2", "the footer's checksum", hex(&bytes[12..16]))));
    }
    if *bytes != expected {
        return Err(at(Violation::new("F3", format!("the footer of this head, {}", hex(&expected)), hex(bytes))));
    }
    Ok(())
}
