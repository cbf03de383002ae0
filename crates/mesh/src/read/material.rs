//! Materials of OBJ files: `newmtl`, `Kd` and `map_Kd` of MTL files; the rest is skipped.
//!
//! Faults in them are warnings, because triangles do not need them. Source: "MTL material format (Lightwave, OBJ)",
//! Alias/Wavefront, 1995.

use super::placing::Placing;
use super::texture::{Fault, Textures, read_beside};
use super::watch::Watch;
use crate::Result;
use crate::bytes::is_file_at;
use crate::input::beside::Beside;
use crate::paint::{Texture, WHITE, Wrap};
use crate::text::{behind_mark, shown};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Most bytes of all MTL files of one mesh.
const MOST_BYTES: u64 = 16 << 20;
/// Most materials of one mesh.
const MOST_MATERIALS: usize = 1 << 16;
/// Most MTL files of one mesh.
const MOST_FILES: usize = 64;

/// A material as stated in its file.
#[derive(Debug, Clone, Default, PartialEq)]
struct Stated {
    colour: Option<[u8; 3]>,
    map: Option<Map>,
}

/// A texture as a material refers to it.
#[derive(Debug, Clone, Default, PartialEq)]
struct Map {
    file: String,
    wrap: Wrap,
    placing: Placing,
    /// Unsupported option that would change the texture's appearance.
    ignored: Option<String>,
}

/// A material with its texture loaded.
#[derive(Debug, Clone, Default)]
pub(super) struct Material {
    pub colour: Option<[u8; 3]>,
    pub texture: Option<Arc<Texture>>,
    /// Transform of texture coordinates.
    pub placing: Placing,
}

/// The materials of one OBJ file.
pub(super) struct Materials {
    beside: Beside,
    stated: HashMap<Vec<u8>, Stated>,
    textures: Textures<(String, Wrap)>,
    files: usize,
    bytes_left: u64,
}

impl Materials {
    /// Creates the materials of the mesh at `path`: none yet.
    pub(super) fn new(path: &Path, textures: Textures<(String, Wrap)>) -> Self {
        Self { beside: Beside::new(path), stated: HashMap::new(), textures, files: 0, bytes_left: MOST_BYTES }
    }

    /// Reads the MTL files that an `mtllib` line of the mesh names: one, whose name may contain blanks, or several.
    pub(super) fn read_all(&mut self, names: &[u8], watch: &Watch) -> Result<()> {
        let whole = self.beside.path(&String::from_utf8_lossy(names));
        if whole.is_ok_and(|path| is_file_at(&path)) {
            return self.read(names, watch);
        }
        let words = names.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        words.take(MOST_FILES).try_for_each(|name| self.read(name, watch))
    }

    /// Reads the MTL file that the mesh calls `name`.
    fn read(&mut self, name: &[u8], watch: &Watch) -> Result<()> {
        watch.check_cancelled()?;
        self.files += 1;
        if self.files > MOST_FILES {
            return Ok(());
        }
        let text = read_beside(&mut self.beside, &String::from_utf8_lossy(name), self.bytes_left);
        let parsed = text.and_then(|text| {
            self.bytes_left = self.bytes_left.saturating_sub(text.len() as u64);
            self.textures.add_to_digest(&text);
            Ok(self.parse(&text)?)
        });
        match parsed {
            Ok(()) => {}
            Err(Fault::Unusable(reason)) => self.textures.warn(watch, &format!("materials: {reason}")),
            Err(Fault::Failed(error)) => return Err(error),
            Err(Fault::Memory(bytes)) => {
                let text =
                    format!("materials: {} has {bytes} bytes; expected at most {}", shown(name), self.bytes_left);
                self.textures.warn(watch, &text);
            }
        }
        Ok(())
    }

    /// Returns the material called `name`, with its texture loaded.
    pub(super) fn get(&mut self, name: &[u8], watch: &Watch) -> Result<Material> {
        let Some(Stated { colour, map }) = self.stated.get(name).cloned() else {
            self.textures.warn(watch, &format!("materials: no material is called {}", shown(name)));
            return Ok(Material::default());
        };
        let Some(Map { file, wrap, placing, ignored }) = map else {
            return Ok(Material { colour, ..Material::default() });
        };
        if let Some(option) = ignored {
            let name = shown(name);
            self.textures.warn(watch, &format!("materials: {name}: map_Kd {option} is not supported and is left out"));
        }
        let read = |most: u64| read_beside(&mut self.beside, &file, most);
        let texture = self.textures.get((file.clone(), wrap), (&shown(file.as_bytes()), [wrap; 2]), watch, read)?;
        Ok(Material { colour, texture, placing })
    }

    fn parse(&mut self, text: &[u8]) -> Result<(), String> {
        let mut current = None;
        for line in behind_mark(text).split(|byte| matches!(byte, b'\n' | b'\r')) {
            let line = line.trim_ascii();
            let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
            let (key, rest) = (&line[..end], line[end..].trim_ascii());
            if key == b"newmtl" {
                if self.stated.len() >= MOST_MATERIALS {
                    return Err(format!("more than {MOST_MATERIALS} materials"));
                }
                self.stated.insert(rest.to_vec(), Stated::default());
                current = Some(rest.to_vec());
                continue;
            }
            let Some(material) = current.as_ref().and_then(|name| self.stated.get_mut(name)) else { continue };
            match key {
                b"Kd" => material.colour = colour_of(rest),
                b"map_Kd" => material.map = map_of(rest),
                _ => {}
            }
        }
        Ok(())
    }
}

impl Material {
    /// Returns the colour to use without texture coordinates.
    pub(super) fn flat(&self) -> Option<[u8; 3]> {
        // A material with a texture may state black beside it.
        if self.texture.is_some() { Some(WHITE) } else { self.colour }
    }
}

fn colour_of(text: &[u8]) -> Option<[u8; 3]> {
    let mut values = std::str::from_utf8(text).ok()?.split_ascii_whitespace().map(|word| word.parse::<f64>().ok());
    let mut channel = || Some((values.next()?? * 255.0 + 0.5).clamp(0.0, 255.0) as u8);
    // A single value is grey.
    let red = channel()?;
    let Some(green) = channel() else { return Some([red; 3]) };
    Some([red, green, channel()?])
}

/// Returns the first word, and what follows behind it and the blanks.
fn next_word(text: &str) -> (&str, &str) {
    let (word, behind) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, behind.trim_start())
}

/// Parses the options and the name of the texture, which may contain blanks.
fn map_of(text: &[u8]) -> Option<Map> {
    let text = String::from_utf8_lossy(text);
    let (mut rest, mut map) = (text.trim(), Map::default());
    let (mut scale, mut offset) = ([1.0; 2], [0.0; 2]);
    while rest.starts_with('-') {
        let (option, mut behind) = next_word(rest);
        // Least number of words that follow, and how many more numbers may.
        let (least, more) = match option {
            "-blendu" | "-blendv" | "-cc" | "-clamp" | "-imfchan" | "-texres" | "-bm" | "-boost" | "-type" => (1, 0),
            "-mm" => (2, 0),
            "-o" | "-s" | "-t" => (1, 2),
            _ => break,
        };
        let mut words = Vec::new();
        while words.len() < least + more {
            let (word, after) = next_word(behind);
            if words.len() >= least && word.parse::<f64>().is_err() {
                break;
            }
            words.push(word);
            behind = after;
        }
        rest = behind;
        let number = |at: usize, absent: f64| match words.get(at) {
            Some(word) => word.parse().ok().filter(|value: &f64| value.is_finite()),
            None => Some(absent),
        };
        let pair = |absent: f64| Some([number(0, absent)?, number(1, absent)?]);
        let is_followed = match option {
            "-clamp" => {
                map.wrap = if words[0] == "on" { Wrap::Clamp } else { Wrap::Repeat };
                true
            }
            "-s" => pair(1.0).inspect(|found| scale = *found).is_some(),
            "-o" => pair(0.0).inspect(|found| offset = *found).is_some(),
            // These would change the appearance, unless they state the defaults.
            "-t" => (0..3).all(|at| number(at, 0.0) == Some(0.0)),
            "-mm" => (number(0, 0.0), number(1, 1.0)) == (Some(0.0), Some(1.0)),
            _ => true,
        };
        if !is_followed {
            map.ignored = Some(format!("{option} {}", words.join(" ")));
        }
    }
    (!rest.is_empty()).then(|| Map { file: rest.to_owned(), placing: Placing::of_mtl(scale, offset), ..map })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_and_names_of_textures_are_found_behind_options() {
        assert_eq!(colour_of(b"1 0.5 0"), Some([255, 128, 0]));
        assert_eq!(colour_of(b"0.2"), Some([51; 3]));
        assert_eq!(colour_of(b"2 -1 nan"), Some([255, 0, 0]));
        assert_eq!(colour_of(b"spectral a.rfl"), None);
        assert_eq!(colour_of(b""), None);
        let map = |text: &str| map_of(text.as_bytes()).map(|map| (map.file, map.wrap == Wrap::Clamp));
        assert_eq!(map("a.png"), Some(("a.png".into(), false)));
        assert_eq!(map("  two words.jpg "), Some(("two words.jpg".into(), false)));
        assert_eq!(map("-s 2 2 1 -clamp on -o 0.5 a b.png"), Some(("a b.png".into(), true)));
        assert_eq!(map("-blendu off 7.png"), Some(("7.png".into(), false)));
        assert_eq!(map("-clamp on -clamp off 7.png"), Some(("7.png".into(), false)));
        assert_eq!(map("-strange.png"), Some(("-strange.png".into(), false)));
        assert_eq!(map("-s"), None);
        // No option costs more behind many others.
        assert_eq!(map(&("-cc on ".repeat(200_000) + "a.png")), Some(("a.png".into(), false)));
        assert_eq!(map(""), None);
    }

    #[test]
    fn options_say_where_a_texture_lies_and_those_that_would_show_are_told() {
        let map = |text: &str| map_of(text.as_bytes()).map(|map| (map.placing, map.ignored));
        let placed = |scale, offset| Some((Placing::of_mtl(scale, offset), None));
        assert_eq!(map("-s 2 3 1 -o 0.5 a b.png"), placed([2.0, 3.0], [0.5, 0.0]));
        assert_eq!(map("-o -1 2 -s 4 a.png"), placed([4.0, 1.0], [-1.0, 2.0]));
        assert_eq!(map("-t 0 0 0 -mm 0 1 -cc on a.png"), placed([1.0; 2], [0.0; 2]));
        let ignored = |text: &str| map(text).and_then(|map| map.1);
        assert_eq!(ignored("-t 0.1 a.png").as_deref(), Some("-t 0.1"));
        assert_eq!(ignored("-mm 0.2 0.5 a.png").as_deref(), Some("-mm 0.2 0.5"));
        assert_eq!(ignored("-s wide a.png").as_deref(), Some("-s wide"));
        assert_eq!(ignored("-o inf 1 a.png").as_deref(), Some("-o inf 1"));
    }
}
