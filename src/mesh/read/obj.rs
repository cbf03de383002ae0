//! Wavefront OBJ: `v` and `f` of the text format; all else is passed over.
//!
//! Two passes over the file: faces may name corners that come later, and corners before are counted from the end.
//! Source: "Object Files (.obj)", Wavefront Advanced Visualizer, appendix B1.

use super::polygon::Polygon;
use super::text::Lines;
use super::vertices::Vertices;
use super::watch::{Digest, Watch};
use super::{BATCH_TRIANGLES, MeshOptions, Triangle, Triangles};
use crate::Result;
use crate::text::shown;
use std::path::Path;

/// Lines read for one batch of triangles.
const LINES: usize = 512;

pub(super) struct ObjReader {
    lines: Lines,
    vertices: Vertices,
    /// Corners defined before the line at hand.
    before: u64,
    polygon: Polygon,
}

impl ObjReader {
    pub(super) fn open(path: &Path, options: &MeshOptions, digest: &Digest, watch: &mut Watch) -> Result<Self> {
        let mut lines = Lines::open(path, true, digest)?;
        let mut vertices = Vertices::new(options);
        while lines.next()? {
            watch.step()?;
            let mut words = lines.words();
            if words.next() == Some(b"v") {
                vertices.push(lines.corner(&mut words)?)?;
            }
        }
        vertices.flush()?;
        Ok(Self { lines: Lines::open(path, true, digest)?, vertices, before: 0, polygon: Polygon::default() })
    }

    fn face(&mut self, out: &mut Vec<Triangle>, watch: &Watch) -> Result<()> {
        self.polygon.clear();
        for word in self.lines.words().skip(1).take_while(|word| !word.starts_with(b"#")) {
            let index = word.split(|&byte| byte == b'/').next().unwrap_or(word);
            let parsed = std::str::from_utf8(index).ok().and_then(|text| text.parse::<i64>().ok());
            let number = match parsed {
                Some(index @ 1..) => Some(index as u64 - 1),
                Some(index @ ..=-1) => self.before.checked_sub(index.unsigned_abs()),
                Some(0) => None,
                None => {
                    return Err(self.lines.error(format!("expected the number of a corner, found {}", shown(word))));
                }
            };
            let corner = match number {
                Some(number) => self.vertices.get(number)?,
                None => None,
            };
            let all = self.vertices.len();
            let missing = || self.lines.error(format!("there is no corner {}: the file has {all}", shown(index)));
            self.polygon.push(corner.ok_or_else(missing)?);
        }
        let cut = self.polygon.triangles(out, &|| watch.go_on())?;
        cut.map_err(|reason| self.lines.error(reason))
    }
}

impl Triangles for ObjReader {
    fn read(&mut self, out: &mut Vec<Triangle>, watch: &mut Watch) -> Result<bool> {
        for _ in 0..LINES {
            if out.len() >= BATCH_TRIANGLES {
                break;
            }
            if !self.lines.next()? {
                return Ok(false);
            }
            watch.step()?;
            let kind = self.lines.words().next();
            match kind {
                Some(b"v") => self.before += 1,
                // "fo" is the old name.
                Some(b"f" | b"fo") => self.face(out, watch).or_else(|error| watch.lose(1, error))?,
                _ => {}
            }
        }
        Ok(true)
    }
}
