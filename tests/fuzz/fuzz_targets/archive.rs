//! Opens, verifies and reads any bytes as an archive, as they are and with the head's and footer's checksums put right.
//!
//! Worth seeding with the archives of `tests/golden/`.
#![no_main]

use libfuzzer_sys::fuzz_target;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;

fn read(bytes: Vec<u8>) {
    let Ok(archive) = Archive::from_bytes(bytes) else { return };
    let _ = archive.crs();
    let summary = archive.verify(&NoMonitor, &mut |_| ()).expect("nobody asks to stop");
    let sound = archive.entries().all(|entry| entry.and_then(|entry| archive.page(&entry)).is_ok());
    assert!(sound || summary.findings > 0, "verify finds what reading refuses");
}

fn repair(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = bytes.to_vec();
    let len = bytes.len();
    let head_len = u32::from_le_bytes(bytes.get(12..16)?.try_into().ok()?) as usize;
    bytes.get_mut(32..40)?.copy_from_slice(&(len as u64).to_le_bytes());
    let end = head_len.checked_sub(4).filter(|_| head_len <= len)?;
    let crc = crc32c::crc32c(&bytes[..end]).to_le_bytes();
    bytes[end..head_len].copy_from_slice(&crc);
    let footer = len.checked_sub(24).filter(|&at| at >= head_len)?;
    bytes[footer..footer + 8].copy_from_slice(&(len as u64).to_le_bytes());
    bytes[footer + 8..footer + 12].copy_from_slice(&crc);
    let crc = crc32c::crc32c(&bytes[footer..footer + 12]).to_le_bytes();
    bytes[footer + 12..footer + 16].copy_from_slice(&crc);
    Some(bytes)
}

fuzz_target!(|bytes: &[u8]| {
    read(bytes.to_vec());
    if let Some(repaired) = repair(bytes) {
        read(repaired);
    }
});
