//! Wavefront OBJ: `v` and `f` of the text format; for colours also `vt`, `mtllib`, `usemtl` and the colours that many
//! programs write after the coordinates of `v`. The rest of the format is skipped, except what would be missed: a line
//! of no keyword may be a damaged corner and `call` reads in a file of corners, without which later corners would have
//! other numbers, so both are refused; so are surfaces that are not made of faces.
//!
//! Reads the file twice: faces may refer to vertices that come later, while negative indices count back from the
//! current line. Source: "Object Files (.obj)", Wavefront Advanced Visualizer, appendix B1.

use super::material::{Material, Materials};
use super::polygon::Polygon;
use super::text::Lines;
use super::texture::Textures;
use super::vertices::Vertices;
use super::watch::Watch;
use super::{BATCH_TRIANGLES, MeshBatch, MeshOptions, Triangles, Wants};
use crate::Result;
use crate::paint::{Paint, WHITE};
use crate::text::shown;
use std::path::Path;

/// Keywords of the format besides `v`, `f` and `fo`; the last line has obsolete ones.
const OTHERS: &str = "vt vn vp cstype deg bmat step p l curv curv2 surf parm trim hole scrv sp end con g s mg o bevel \
                      c_interp d_interp lod usemap usemtl mtllib maplib shadow_obj trace_obj ctech stech call csh \
                      bsp bzp cdc cdp res";
/// Of these: free-form surfaces, the obsolete ones last.
const SURFACES: [&[u8]; 4] = [b"surf", b"bsp", b"bzp", b"cdp"];
/// Lines read for one batch of triangles.
const LINES: usize = 512;

pub(super) struct ObjReader {
    lines: Lines,
    vertices: Vertices,
    /// Vertices defined before the current line.
    before: u64,
    polygon: Polygon,
    colours: Option<ObjColours>,
}

/// Colour of a corner, and its texture coordinates.
type CornerColour = (Option<[u8; 3]>, Option<[f64; 2]>);

/// Colours of the faces of a file.
struct ObjColours {
    /// Vertex colours as stated, but at least 0; below 0 if a vertex has none.
    corners: Vertices,
    /// Greatest value of all vertex colours.
    greatest: f64,
    /// Texture coordinates.
    places: Vertices,
    /// Texture coordinates defined before the current line.
    places_before: u64,
    materials: Materials,
    /// Material of the current faces.
    material: Option<Material>,
    /// Corners of the current face.
    of_face: Vec<CornerColour>,
}

/// Parses the corner behind `v` and what follows its coordinates: a weight, a colour, or a weight and a colour. Returns
/// the coordinates and the colour.
fn corner_of<'a>(lines: &Lines, mut words: impl Iterator<Item = &'a [u8]>) -> Result<([f64; 3], Option<[f64; 3]>)> {
    let corner = lines.corner(&mut words)?;
    let (mut behind, mut count) = ([0.0; 4], 0);
    for word in words.take_while(|word| !word.starts_with(b"#")) {
        let value = lines.number(Some(word))?;
        if let Some(place) = behind.get_mut(count) {
            *place = value;
        }
        count += 1;
    }
    match (count, behind) {
        (0 | 1, _) => Ok((corner, None)),
        (3, [r, g, b, _]) | (4, [_, r, g, b]) => Ok((corner, Some([r, g, b]))),
        _ => {
            let found = 3 + count;
            Err(lines.error(format!("expected 3, 4, 6 or 7 numbers of a corner, found {found}; write the file again")))
        }
    }
}

impl ObjColours {
    /// Adds the colour of the next vertex.
    fn add(&mut self, colour: Option<[f64; 3]>) -> Result<()> {
        let colour = colour.filter(|colour| colour.iter().all(|value| value.is_finite()));
        self.greatest = colour.iter().flatten().fold(self.greatest, |greatest, value| greatest.max(*value));
        self.corners.push(colour.map_or([-1.0; 3], |colour| colour.map(|value| value.max(0.0))))
    }

    /// Returns the colour of a vertex in 8 bits, if it has one. Programs write it as 0 to 1, which some exceed a little,
    /// or as 0 to 255; the greatest value of the file decides, because dark corners fit both.
    fn of_corner(&mut self, number: u64) -> Result<Option<[u8; 3]>> {
        let white = if self.greatest < 2.0 { 1.0 } else { 255.0 };
        let colour = self.corners.get(number)?.filter(|colour| colour[0] >= 0.0);
        Ok(colour.map(|colour| colour.map(|value| (value / white * 255.0 + 0.5).clamp(0.0, 255.0) as u8)))
    }

    /// Returns the paint of the triangle with these corners of the face.
    fn paint(&self, numbers: [usize; 3]) -> Paint {
        let [a, b, c] = numbers.map(|number| self.of_face.get(number).copied().unwrap_or_default());
        let at_corners = match (a.0, b.0, c.0) {
            (Some(a), Some(b), Some(c)) => Some([a, b, c]),
            _ => None,
        };
        let material = self.material.as_ref();
        if let Some(Material { texture: Some(texture), placing, .. }) = material
            && let (Some(a), Some(b), Some(c)) = (a.1, b.1, c.1)
        {
            let places = [a, b, c].map(|place| placing.of(place));
            return Paint::Texture { texture: texture.clone(), places, tints: [WHITE; 3] };
        }
        match (at_corners, material.and_then(Material::flat)) {
            (Some(colours), _) => Paint::Corners(colours),
            (None, Some(colour)) => Paint::Flat(colour),
            (None, None) => Paint::None,
        }
    }
}

/// Parses a vertex or texture coordinate index, with `before` of them defined before the line. The inner `None` means
/// that there is no such element.
fn number_of(word: &[u8], before: u64) -> Option<Option<u64>> {
    match std::str::from_utf8(word).ok()?.parse::<i64>().ok()? {
        index @ 1.. => Some(Some(index as u64 - 1)),
        index @ ..=-1 => Some(before.checked_sub(index.unsigned_abs())),
        0 => Some(None),
    }
}

impl ObjReader {
    pub(super) fn open(path: &Path, options: &MeshOptions, wants: Wants<'_>, watch: &mut Watch) -> Result<Self> {
        let mut lines = Lines::open(path, true, wants.digest)?;
        let share = MeshOptions { memory_bytes: options.memory_bytes / 3, ..options.clone() };
        let mut vertices = Vertices::new(if wants.colours.is_some() { &share } else { options });
        let mut colours = wants.colours.map(|alive| ObjColours {
            corners: Vertices::new(&share),
            greatest: 0.0,
            places: Vertices::new(&share),
            places_before: 0,
            materials: Materials::new(path, Textures::new(path, options.texture_bytes, wants.digest, alive)),
            material: None,
            of_face: Vec::new(),
        });
        while lines.next()? {
            watch.step()?;
            let mut words = lines.words();
            match (words.next(), &mut colours) {
                (Some(b"v"), colours) => {
                    let (corner, colour) = corner_of(&lines, words)?;
                    vertices.push(corner)?;
                    if let Some(colours) = colours {
                        colours.add(colour)?;
                    }
                }
                (Some(b"vt"), Some(colours)) => {
                    let mut next = || words.next().and_then(|word| lines.number(Some(word)).ok()).unwrap_or(0.0);
                    // OBJ counts v from the lower edge of the image.
                    let (u, v) = (next(), 1.0 - next());
                    colours.places.push([u, v, 0.0])?;
                }
                (None | Some(b"f" | b"fo" | b"vt" | b"vn" | [b'#', ..]), _) => {}
                (Some(b"call"), _) => {
                    let reason =
                        "it reads in another file, whose corners count here; write the lines of that file here";
                    return Err(lines.error(reason));
                }
                (Some(word), _) if OTHERS.split(' ').any(|name| name.as_bytes() == word) => {}
                (Some(word), _) => {
                    let reason = format!(
                        "expected a keyword of OBJ, such as v or f, found {}; write the file again, or the line as a \
                         comment",
                        shown(word)
                    );
                    return Err(lines.error(reason));
                }
            }
        }
        vertices.flush()?;
        if let Some(colours) = &mut colours {
            colours.corners.flush()?;
            colours.places.flush()?;
        }
        let lines = Lines::open(path, true, wants.digest)?;
        Ok(Self { lines, vertices, before: 0, polygon: Polygon::default(), colours })
    }

    fn face(&mut self, out: &mut MeshBatch, watch: &Watch) -> Result<()> {
        self.polygon.clear();
        self.colours.iter_mut().for_each(|colours| colours.of_face.clear());
        for word in self.lines.words().skip(1).take_while(|word| !word.starts_with(b"#")) {
            let mut parts = word.split(|&byte| byte == b'/');
            let index = parts.next().unwrap_or(word);
            let Some(number) = number_of(index, self.before) else {
                return Err(self.lines.error(format!("expected the number of a corner, found {}", shown(word))));
            };
            let corner = match number {
                Some(number) => self.vertices.get(number)?,
                None => None,
            };
            let all = self.vertices.len();
            let missing = || self.lines.error(format!("there is no corner {}: the file has {all}", shown(index)));
            self.polygon.push(corner.ok_or_else(missing)?);
            if let (Some(colours), Some(number)) = (&mut self.colours, number) {
                let colour = colours.of_corner(number)?;
                let place = parts.next().and_then(|part| number_of(part, colours.places_before)).flatten();
                let place = place.map(|place| colours.places.get(place)).transpose()?.flatten();
                colours.of_face.push((colour, place.map(|[u, v, _]| [u, v])));
            }
        }
        let mut found = Vec::new();
        let cut = self.polygon.triangles(|numbers| found.push(numbers), &|| watch.check_cancelled())?;
        for numbers in found {
            let paint = self.colours.as_ref().map_or(Paint::None, |colours| colours.paint(numbers));
            out.push(numbers.map(|number| self.polygon.corners()[number]), paint);
        }
        cut.map_err(|reason| self.lines.error(reason))
    }
}

impl Triangles for ObjReader {
    fn read(&mut self, out: &mut MeshBatch, watch: &mut Watch) -> Result<bool> {
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
                // `fo` is the obsolete name of `f`.
                Some(b"f" | b"fo") => self.face(out, watch).or_else(|error| watch.lose(1, error))?,
                Some(name) if SURFACES.contains(&name) => {
                    watch.lose(1, self.lines.error("it is a free-form surface; export the model as faces"))?;
                }
                _ => self.take_colours(watch)?,
            }
        }
        Ok(true)
    }
}

impl ObjReader {
    /// Reads the line's colour statement, if colours are requested.
    fn take_colours(&mut self, watch: &Watch) -> Result<()> {
        let Self { lines, colours: Some(colours), .. } = self else { return Ok(()) };
        let line = lines.line().trim_ascii();
        let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
        let rest = line[end..].trim_ascii();
        let ObjColours { materials, material, places_before, .. } = colours;
        match &line[..end] {
            b"vt" => *places_before += 1,
            b"usemtl" => *material = Some(materials.get(rest, watch)?),
            // One name with blanks, or several names.
            b"mtllib" => materials.read_all(rest, watch)?,
            _ => {}
        }
        Ok(())
    }
}
