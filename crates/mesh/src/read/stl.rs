//! STL: the binary form (80 bytes, a count, 50 bytes per triangle) and the text form.
//!
//! Source: "StereoLithography Interface Specification", 3D Systems, 1989. Many binary files begin with "solid" like the
//! text form; so a file is binary if its length matches its count or its first bytes are not text. The text form is a
//! sequence of words, whatever separates them; only the name of a solid ends with its line. Keywords may be in upper
//! case, names in any encoding.

use super::text::{Words, only_padding};
use super::watch::{Digest, MeshSource, Watch};
use super::{MeshBatch, Triangles};
use crate::paint::Paint;
use crate::text::{behind_mark, counted, shown};
use crate::{Error, Result};
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

const HEAD_BYTES: u64 = 84;
const TRIANGLE_BYTES: usize = 50;
/// Triangles read for one batch, or keywords.
const BATCH: u64 = 512;
/// Keywords of the text form.
const KEYWORDS: [&str; 9] = ["vertex", "endloop", "facet", "normal", "outer", "loop", "endfacet", "solid", "endsolid"];

pub(super) enum StlReader {
    Binary { reader: BufReader<MeshSource>, path: PathBuf, left: u64, all: u64 },
    Text { words: Words, corners: Vec<[f64; 3]>, open: bool, place: Place },
}

/// Position in the text form: the words that may follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// Any keyword.
    Keyword,
    /// Behind a fault: all words up to the next facet, or the next begin or end of a solid, are left out.
    Broken,
    /// The name behind `solid` or `endsolid`, to the end of the line; whether its last word is `facet`.
    Name(bool),
    /// `normal`, behind `facet`.
    Facet,
    /// At most this many more numbers of a normal.
    Normal(u8),
    /// `loop`, behind `outer`.
    Outer,
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
        let start = behind_mark(&head);
        // A binary count below 16,777,216 has a zero byte, which text never has.
        let is_text = start.iter().all(|byte| !byte.is_ascii_control() || byte.is_ascii_whitespace());
        let begins = start.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
        if begins && is_text && expected != Some(bytes) {
            let mark = (head.len() - start.len()) as u64;
            reader.seek(SeekFrom::Start(mark)).map_err(io("read the header"))?;
            let (words, corners) = (Words::new(reader, path), Vec::new());
            return Ok(Self::Text { words, corners, open: false, place: Place::Keyword });
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
    fn are_singles(&self) -> [bool; 3] {
        [matches!(self, Self::Binary { .. }); 3]
    }

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
            Self::Text { words, corners, open, place } => {
                const CUT: &str = "the file ends before \"endsolid\": it is cut; fetch it again";
                for _ in 0..BATCH {
                    if !words.next()? {
                        if *open {
                            watch.lose(1, words.error(CUT))?;
                        }
                        return Ok(false);
                    }
                    let keyword = KEYWORDS.into_iter().find(|name| name.as_bytes().eq_ignore_ascii_case(words.word()));
                    *place = match (keyword, *place) {
                        // A solid on one line has its facets, or its end, behind its name.
                        (Some("normal" | "outer"), Place::Name(true)) if !words.is_first() => Place::Facet,
                        (Some("endsolid"), Place::Name(_)) => Place::Keyword,
                        (_, Place::Name(_)) if !words.is_first() => {
                            *place = Place::Name(keyword == Some("facet"));
                            continue;
                        }
                        (_, place) => place,
                    };
                    if *place == Place::Broken && !matches!(keyword, Some("facet" | "solid" | "endsolid")) {
                        continue;
                    }
                    *place = match (keyword, *place) {
                        (Some("facet"), _) => Place::Facet,
                        (Some("normal"), Place::Facet) => Place::Normal(3),
                        (Some("outer"), _) => Place::Outer,
                        (Some("loop"), Place::Outer) => Place::Keyword,
                        (Some("solid" | "endsolid"), _) => Place::Name(false),
                        (Some("vertex" | "endloop" | "endfacet"), _) => Place::Keyword,
                        (None, Place::Normal(left @ 1..)) => Place::Normal(left - 1),
                        _ => {
                            let found = shown(words.word());
                            let reason = format!("expected a keyword of STL, found {found}; write the file again");
                            watch.lose(1, words.error(reason))?;
                            corners.clear();
                            Place::Broken
                        }
                    };
                    *open = keyword != Some("endsolid");
                    match keyword {
                        Some("vertex") => match words.corner() {
                            // A fourth shows that there are too many.
                            Ok(Some(corner)) if corners.len() < 4 => corners.push(corner),
                            Ok(Some(_)) => {}
                            Ok(None) => {
                                watch.lose(1, words.error(CUT))?;
                                return Ok(false);
                            }
                            Err(error) => {
                                watch.lose(1, error)?;
                                corners.clear();
                                // An invalid number may be the first word of the next facet.
                                let is_facet = words.word().eq_ignore_ascii_case(b"facet");
                                *place = if is_facet { Place::Facet } else { Place::Broken };
                            }
                        },
                        Some("endloop") => {
                            match corners[..] {
                                [a, b, c] => out.push([a, b, c], Paint::None),
                                [_, _, _, _, ..] => {
                                    watch.lose(1, words.error("a loop has more than 3 corners"))?;
                                }
                                _ => {
                                    let found = corners.len();
                                    watch.lose(1, words.error(format!("a loop has {found} corners; expected 3")))?;
                                }
                            }
                            corners.clear();
                        }
                        _ if !corners.is_empty() => {
                            watch.lose(1, words.error("a loop ends without \"endloop\""))?;
                            corners.clear();
                        }
                        _ => {}
                    }
                }
                Ok(true)
            }
        }
    }
}
