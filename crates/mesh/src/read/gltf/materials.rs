//! Materials of a glTF file: factors, textures and vertex colours.
//!
//! Factors and vertex colours are linear, textures are sRGB (glTF 2.0, sections 3.7.2.1 and 3.9.2). Values between
//! corners are interpolated after the conversion to sRGB.

use super::buffers::{Buffers, ELSEWHERE};
use super::structure::{BufferView, Material, Structure};
use crate::colour::from_linear;
use crate::input::beside::{Beside, decode_percent};
use crate::paint::{Texture, Wrap};
use crate::read::placing::Placing;
use crate::read::texture::{Fault, Textures, read_beside};
use crate::read::watch::Watch;
use crate::{Error, Result};
use std::path::Path;
use std::sync::Arc;

/// Where an image is.
enum Source {
    View(Option<BufferView>),
    File(String),
    Memory(Vec<u8>),
    /// Nowhere, with the reason.
    None(String),
}

/// The materials of a file.
pub struct Materials {
    beside: Beside,
    sources: Vec<Source>,
    textures: Textures<(u32, [Wrap; 2])>,
}

/// Colour source of a primitive.
#[derive(Debug, Clone)]
pub struct Coat {
    /// Colour (sRGB) that multiplies that of the texture.
    pub factor: [u8; 3],
    pub texture: Option<Arc<Texture>>,
    /// Set of texture coordinates, and their transform.
    pub set: u32,
    pub placing: Placing,
}

impl Coat {
    /// A coat of one colour.
    pub fn of_factor(factor: [u8; 3]) -> Self {
        Self { factor, texture: None, set: 0, placing: Placing::default() }
    }
}

impl Materials {
    pub fn new(path: &Path, structure: &Structure, textures: Textures<(u32, [Wrap; 2])>) -> Self {
        let source = |image: &super::structure::ImageOf| match (&image.uri, image.buffer_view) {
            (Some(uri), _) => match Buffers::in_text(uri) {
                Some(Ok(bytes)) => Source::Memory(bytes),
                Some(Err(reason)) => Source::None(reason),
                None if uri.contains(':') => Source::None(ELSEWHERE.into()),
                None => Source::File(decode_percent(uri)),
            },
            (None, Some(view)) => Source::View(structure.views.get(view as usize).copied()),
            (None, None) => Source::None("it has neither an address nor a place in a buffer".into()),
        };
        Self { beside: Beside::new(path), sources: structure.images.iter().map(source).collect(), textures }
    }

    /// Warns about the colours of the file.
    pub fn warn(&mut self, watch: &Watch, text: &str) {
        self.textures.warn(watch, text);
    }

    /// Returns the coat of material `number`; warns and returns `None` if there is no such material.
    pub fn coat(
        &mut self,
        number: usize,
        structure: &Structure,
        buffers: &mut Buffers,
        watch: &Watch,
    ) -> Result<Option<Coat>> {
        let Some(Material { base }) = structure.materials.get(number).copied() else {
            self.textures.warn(watch, &format!("there is no material {number}; its triangles get no colour"));
            return Ok(None);
        };
        let [r, g, b, _] = base.base_color_factor;
        let factor = [r, g, b].map(from_linear);
        let Some(name) = base.base_color_texture else { return Ok(Some(Coat::of_factor(factor))) };
        let texture = structure.textures.get(name.index as usize);
        let Some(image) = texture.and_then(|texture| texture.source) else {
            let text =
                format!("texture {} has no image in PNG or JPEG; its triangles get the factor alone", name.index);
            self.textures.warn(watch, &text);
            return Ok(Some(Coat::of_factor(factor)));
        };
        let sampler = texture.and_then(|texture| structure.samplers.get(texture.sampler? as usize));
        let wrap = |number: Option<u32>| match number {
            Some(33071) => Wrap::Clamp,
            Some(33648) => Wrap::Mirror,
            _ => Wrap::Repeat,
        };
        let wraps = [wrap(sampler.and_then(|s| s.wrap_s)), wrap(sampler.and_then(|s| s.wrap_t))];
        let (beside, source) = (&mut self.beside, self.sources.get(image as usize));
        let read = |most: u64| match source {
            None => Err(Fault::Unusable(format!("there is no image {image}"))),
            Some(Source::None(reason)) => Err(Fault::Unusable(reason.clone())),
            Some(Source::File(name)) => read_beside(beside, name, most),
            // Already in memory.
            Some(Source::Memory(bytes)) => Ok(bytes.clone()),
            Some(Source::View(view)) => of_view(*view, buffers, most),
        };
        let texture = self.textures.get((image, wraps), (&format!("image {image}"), wraps), watch, read)?;
        Ok(Some(Coat { factor, texture, set: name.set(), placing: name.placing() }))
    }
}

/// Reads the bytes of a buffer view.
fn of_view(view: Option<BufferView>, buffers: &mut Buffers, most_bytes: u64) -> Result<Vec<u8>, Fault> {
    let missing = || Fault::Unusable("it should lie in a buffer, and does not".into());
    let BufferView { buffer, byte_offset, byte_length, .. } = view.ok_or_else(missing)?;
    let there = buffers.len(buffer as usize).ok_or_else(missing)?;
    if byte_offset.checked_add(byte_length).is_none_or(|end| end > there) {
        return Err(missing());
    }
    if byte_length > most_bytes {
        return Err(Fault::Memory(byte_length));
    }
    let mut bytes = vec![0; byte_length as usize];
    buffers.read(buffer as usize, byte_offset, &mut bytes).map_err(|error| match error {
        Error::Input { .. } => Fault::Unusable(error.to_string()),
        failed => Fault::Failed(failed),
    })?;
    Ok(bytes)
}
