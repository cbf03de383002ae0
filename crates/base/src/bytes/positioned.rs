//! Positioned reads and writes of files, the same on every system: no shared cursor moves.

use std::fs::File;
use std::io;

/// Fills `buf` with the bytes at `offset`; fails if there are fewer.
pub fn read_exact_at(file: &File, offset: u64, buf: &mut [u8]) -> io::Result<()> {
    match read_up_to(file, offset, buf)? == buf.len() {
        true => Ok(()),
        false => Err(io::ErrorKind::UnexpectedEof.into()),
    }
}

/// Fills `buf` with the bytes at `offset`; returns their number, which is less than the length of `buf` only at the end
/// of the file. Repeats interrupted calls.
pub fn read_up_to(file: &File, offset: u64, buf: &mut [u8]) -> io::Result<usize> {
    let mut done = 0;
    while done < buf.len() {
        match read_at(file, offset + done as u64, &mut buf[done..]) {
            Ok(0) => break,
            Ok(read) => done += read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(done)
}

/// Reads at a position, and does not move that of the file; may read less than was asked for.
#[cfg(unix)]
pub fn read_at(file: &File, offset: u64, buf: &mut [u8]) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buf, offset)
}

/// Writes at a position, and does not move that of the file; may write less than was given.
#[cfg(unix)]
pub fn write_at(file: &File, offset: u64, bytes: &[u8]) -> io::Result<usize> {
    std::os::unix::fs::FileExt::write_at(file, bytes, offset)
}

/// Reads at a position, and does not move that of the file; may read less than was asked for.
#[cfg(windows)]
pub fn read_at(file: &File, offset: u64, buf: &mut [u8]) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, buf, offset)
}

/// Writes at a position, and does not move that of the file; may write less than was given.
#[cfg(windows)]
pub fn write_at(file: &File, offset: u64, bytes: &[u8]) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_write(file, bytes, offset)
}

/// Fails: systems without positioned files, above all WebAssembly in a browser, use other sources.
#[cfg(not(any(unix, windows)))]
pub fn read_at(_: &File, _: u64, _: &mut [u8]) -> io::Result<usize> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Writes at a position, and does not move that of the file; may write less than was given.
#[cfg(not(any(unix, windows)))]
pub fn write_at(_: &File, _: u64, _: &[u8]) -> io::Result<usize> {
    Err(io::ErrorKind::Unsupported.into())
}
