//! STL: the binary form (80 bytes, a count, 50 bytes per triangle) and the text form.
//!
//! Source: "StereoLithography Interface Specification", 3D Systems, 1989. Many binary files begin with "solid" like the
//! text form; so a file is binary if its length matches its count or its first bytes are not text. Keywords of the text
//! form may be in upper case, names of solids in any encoding.

use super::text::{BYTE_ORDER_MARK, Lines, only_padding};
use super::watch::{Digest, MeshSource, Watch};
use super::{MeshBatch, Triangles};
use crate::paint::Paint;
use crate::text::{counted, shown};
use crate::{Error, Result};
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

const HEAD_BYTES: u64 = 84;
const TRIANGLE_BYTES: usize = 50;
/// Triangles, or lines, read for one batch.
const BATCH: u64 = 512;

pub(super) enum StlReader {
    Binary { reader: BufReader<MeshSource>, path: PathBuf, left: u64, all: u64 },
    Text { lines: Lines, corners: Vec<[f64; 3]>, open: bool },
}

impl StlReader {
    pub(super) fn open(path: &Path, digest: &Digest, watch: &mut Watch) -> Result<Self> {
        let io = |action| move |e| Error::io(path, action, e);
        let file = MeshSource::open(path, digest)?;
        let bytes = file.len();
        let mut reader = BufReader::with_capacity(1 << 18, file);
        let mut head = Vec::with_capacity(HEAD_BYTES as usize);
        Read::by_ref(&mut reader).take(HEAD_BYTES).read_to_end(&mut head).map_err(io("read the header"))?;
        let count = head.last_chunk().filter(|_| head.len() as u64 == HEAD_BYTES).map(|b| u32::from_le_bytes(*b));
        let expected = count.map(|count| HEAD_BYTES + u64::from(count) * TRIANGLE_BYTES as u64);
        let start = head.strip_prefix(BYTE_ORDER_MARK).unwrap_or(&head);
        // A binary count below 16,777,216 has a zero byte, which text never has.
        let is_text = start.iter().all(|byte| !byte.is_ascii_control() || byte.is_ascii_whitespace());
        let begins = start.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
        if begins && is_text && expected != Some(bytes) {
            reader.rewind().map_err(io("read the header"))?;
            return Ok(Self::Text { lines: Lines::new(reader, path, false), corners: Vec::new(), open: false });
        }
        match (count, expected) {
            (Some(count), Some(expected)) if expected <= bytes => {
                let all = u64::from(count);
                Ok(Self::Binary { reader, path: path.to_path_buf(), left: all, all })
            }
            (Some(count), _) => {
                let reason = format!(
                    "it states {count} triangles of 50 bytes, which the file's {bytes} bytes do not hold: it is cut or \
                     damaged; fetch or write it again"
                );
                let all = (bytes - HEAD_BYTES) / TRIANGLE_BYTES as u64;
                watch.lose(u64::from(count) - all, Error::input(path, "header, byte 80", reason))?;
                Ok(Self::Binary { reader, path: path.to_path_buf(), left: all, all })
            }
            _ => Err(Error::input(path, "header", format!("expected at least 84 bytes or \"solid\", found {bytes}"))),
        }
    }
}

impl Triangles for StlReader {
    fn read(&mut self, out: &mut MeshBatch, watch: &mut Watch) -> Result<bool> {
        watch.check_cancelled()?;
        match self {
            Self::Binary { reader, path, left, all } => {
                for _ in 0..BATCH.min(*left) {
                    let mut bytes = [0; TRIANGLE_BYTES];
                    let number = *all - *left;
                    reader
                        .read_exact(&mut bytes)
                        .map_err(|e| Error::io(&path, format!("read triangle {number}"), e))?;
                    // The first 12 bytes are the normal.
                    let value = |at: usize| f64::from(f32::from_le_bytes([0, 1, 2, 3].map(|k| bytes[12 + 4 * at + k])));
                    let corners = [0, 1, 2].map(|corner| [0, 1, 2].map(|axis| value(3 * corner + axis)));
                    out.push(corners, Paint::None);
                    *left -= 1;
                }
                if *left > 0 {
                    return Ok(true);
                }
                if !only_padding(reader).map_err(|e| Error::io(&path, "read what follows the triangles", e))? {
                    let reason = format!("it states {} of 50 bytes, and more bytes follow", counted(*all, "triangle"));
                    watch.lose(0, Error::input(&path, "header, byte 80", reason))?;
                }
                Ok(false)
            }
            Self::Text { lines, corners, open } => {
                for _ in 0..BATCH {
                    if !lines.next()? {
                        if *open {
                            watch
                                .lose(1, lines.error("the file ends before \"endsolid\": it is cut; fetch it again"))?;
                        }
                        return Ok(false);
                    }
                    let mut words = lines.words();
                    match words.next().map(<[u8]>::to_ascii_lowercase).as_deref() {
                        Some(b"vertex") => corners.push(lines.corner(&mut words)?),
                        Some(b"endloop") => {
                            match corners[..] {
                                [a, b, c] => out.push([a, b, c], Paint::None),
                                _ => {
                                    let found = corners.len();
                                    watch.lose(1, lines.error(format!("a loop has {found} corners; expected 3")))?;
                                }
                            }
                            corners.clear();
                        }
                        Some(b"solid") => *open = true,
                        Some(b"endsolid") => *open = false,
                        Some(b"facet" | b"outer" | b"endfacet") | None => {}
                        Some(other) => {
                            return Err(lines.error(format!("expected a line of an STL file, found {}", shown(other))));
                        }
                    }
                    if corners.len() > 3 {
                        watch.lose(1, lines.error("a loop has more than 3 corners"))?;
                        corners.clear();
                    }
                }
                Ok(true)
            }
        }
    }
}
