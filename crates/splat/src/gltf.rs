//! glTF and GLB with `KHR_gaussian_splatting`: splats as points of primitives, moved by their nodes, or SPZ in a buffer
//! view (`KHR_gaussian_splatting_compression_spz` and its drafts). Other primitives make the input incomplete.
//!
//! The extension stores sizes and opacities as they are. Its late drafts stored logarithms of sizes under the same name: a
//! negative size, which the extension forbids, marks such a draft. Its first drafts (`_SCALE`, `_ROTATION`) store sizes as they are, and
//! opacities and colours in `COLOR_0`.

mod accessor;
mod placing;

use super::columns::{Column, Part, json, read_error};
use super::gate::{Gate, Raw, colour_of};
use super::spz::Spz;
use super::{Body, Work, is_all, refuse};
use accessor::{Accessor, Values};
use base64::Engine;
pub use placing::Placing;
use serde::Deserialize;
use slicewalk_base::bytes::{ByteSource, MemorySource, open_named};
use slicewalk_base::colour::from_linear;
use slicewalk_base::text::{counted, grouped, shown};
use slicewalk_base::{Error, Result};
use slicewalk_input::beside::{Beside, decode_percent};
use slicewalk_input::gltf::{check_matrix, is_harmless, moves};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const EXTENSION: &str = "KHR_gaussian_splatting";
const POINTS: u64 = 0;

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Document {
    scene: Option<usize>,
    scenes: Vec<Scene>,
    nodes: Vec<Node>,
    meshes: Vec<Mesh>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<View>,
    buffers: Vec<Buffer>,
    extensions_required: Vec<String>,
    extensions_used: Vec<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Scene {
    nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Node {
    children: Vec<usize>,
    mesh: Option<usize>,
    // In boxes, because most nodes have none of them.
    matrix: Option<Box<[f64; 16]>>,
    translation: Option<Box<[f64; 3]>>,
    rotation: Option<Box<[f64; 4]>>,
    scale: Option<Box<[f64; 3]>>,
    extensions: BTreeMap<String, serde::de::IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Primitive {
    attributes: BTreeMap<String, usize>,
    mode: Option<u64>,
    extensions: BTreeMap<String, serde_json::Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct View {
    buffer: usize,
    byte_offset: u64,
    byte_length: u64,
    byte_stride: Option<u64>,
    extensions: BTreeMap<String, serde::de::IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Buffer {
    uri: Option<String>,
    byte_length: u64,
}

/// The splats of one primitive.
enum Content {
    Attributes(Box<Attributes>),
    Spz(Spz),
}

struct Attributes {
    count: u64,
    mean: Values,
    rotation: Values,
    scale: Values,
    /// Whether sizes may be logarithms.
    may_be_log: bool,
    opacity: Option<Values>,
    harmonics: Option<Values>,
    colour: Option<Values>,
    /// Whether the harmonics give linear light.
    is_linear: bool,
}

pub struct Gltf {
    path: PathBuf,
    /// Mesh by mesh, primitive by primitive.
    parts: Vec<(usize, Content)>,
    /// Meshes and where they are placed, in the order of the nodes.
    instances: Vec<(usize, Placing)>,
    count: u64,
    /// Splats of meshes that the scene does not show.
    elsewhere: u64,
    /// A mesh of the scene with primitives other than splats.
    other: Option<usize>,
    /// A GLB, and the length that it states (bytes).
    glb: Option<(Arc<dyn ByteSource>, u64)>,
}

fn wrong(path: &Path, at: impl Into<String>, reason: impl std::fmt::Display) -> Error {
    refuse(path, at, format!("{reason}; fetch or write it again"))
}

impl Gltf {
    pub fn open(source: Arc<dyn ByteSource>, path: &Path, memory: u64) -> Result<Self> {
        let (mut document, binary, glb) = read_document(source, path, memory)?;
        let stated = std::mem::take(&mut document.buffers);
        let (buffers, beside) = (BTreeMap::new(), Beside::new(path));
        let mut loader = Loader { path, document: &document, stated, binary, buffers, beside };
        let instances = instances(&document, path)?;
        let (mut parts, mut by_mesh) = (Vec::new(), vec![0u64; document.meshes.len()]);
        let mut others = Vec::new();
        for (number, mesh) in document.meshes.iter().enumerate() {
            for primitive in &mesh.primitives {
                match loader.primitive(primitive, number)? {
                    Some(part) => {
                        by_mesh[number] = by_mesh[number].saturating_add(part.count());
                        parts.push((number, part));
                    }
                    None => others.push(number),
                }
            }
        }
        let count = instances.iter().fold(0u64, |count, (mesh, _)| count.saturating_add(by_mesh[*mesh]));
        if parts.is_empty() {
            let reason = format!("expected primitives with the extension {EXTENSION}, found none; export it again");
            return Err(refuse(path, "meshes", reason));
        }
        let mut is_placed = vec![false; by_mesh.len()];
        instances.iter().for_each(|(mesh, _)| is_placed[*mesh] = true);
        let elsewhere = by_mesh.iter().zip(&is_placed).filter(|(_, is_placed)| !**is_placed);
        let elsewhere = elsewhere.fold(0u64, |sum, (splats, _)| sum.saturating_add(*splats));
        if count == 0 && elsewhere > 0 {
            let reason =
                format!("no node of the scene has a mesh of splats, of which there are {}", grouped(elsewhere));
            return Err(wrong(path, "scene", reason));
        }
        document.check_extensions(&by_mesh, path)?;
        let other = others.into_iter().find(|mesh| is_placed[*mesh]);
        Ok(Self { path: path.to_path_buf(), parts, instances, count, elsewhere, other, glb })
    }
}

impl Document {
    /// Refuses extensions that add splats or move them and are not read.
    fn check_extensions(&self, splats: &[u64], path: &Path) -> Result<()> {
        let is_own = |name: &str| name.starts_with(EXTENSION) || name.contains("spz");
        let required = self.extensions_required.iter().filter(|name| !is_own(name) && !is_harmless(name));
        let mut unread = required.chain(self.extensions_used.iter().filter(|name| moves(name)));
        if let Some(name) = unread.next() {
            let reason = format!("it needs {}, which is not read; export it without", shown(name.as_bytes()));
            return Err(refuse(path, "extensions", reason));
        }
        let has_splats = |node: &Node| node.mesh.is_some_and(|mesh| splats.get(mesh).is_some_and(|count| *count > 0));
        let repeats = |node: &Node| node.extensions.contains_key("EXT_mesh_gpu_instancing");
        match self.nodes.iter().position(|node| has_splats(node) && repeats(node)) {
            None => Ok(()),
            Some(node) => {
                let reason = "EXT_mesh_gpu_instancing of splats is not read; export a node for each instance";
                Err(refuse(path, format!("node {node}"), reason))
            }
        }
    }
}

impl Body for Gltf {
    fn count(&self) -> u64 {
        self.count
    }

    fn read(&mut self, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        if let Some((source, len)) = &self.glb
            && !is_all(Column::rest(source, *len), |byte| *byte == 0 || byte.is_ascii_whitespace(), work)?
        {
            let [stated, found] = [*len, source.len()].map(grouped);
            let reason = format!("it states {stated} bytes, and the file has {found}");
            gate.refuse(wrong(&self.path, "header", reason))?;
        }
        if self.elsewhere > 0 {
            let (name, splats) = (self.path.display(), counted(self.elsewhere, "splat"));
            work.monitor.warn(&format!("{name}: {splats} of meshes that the scene does not show were left out").into());
        }
        if let Some(mesh) = self.other {
            let reason = "it has triangles, lines or points that are not splats; export them to a file of their own";
            gate.refuse(refuse(&self.path, format!("mesh {mesh}"), reason))?;
        }
        for (mesh, placing) in &self.instances {
            for (_, part) in self.parts.iter_mut().filter(|(number, _)| number == mesh) {
                gate.begin(part.count());
                gate.place(Some(*placing));
                match part {
                    Content::Spz(spz) => spz.read(work, gate)?,
                    Content::Attributes(attributes) => attributes.read(&self.path, work, gate)?,
                }
                gate.place(None);
            }
        }
        Ok(())
    }
}

impl Content {
    fn count(&self) -> u64 {
        match self {
            Self::Attributes(attributes) => attributes.count,
            Self::Spz(spz) => spz.count(),
        }
    }
}

impl Attributes {
    /// Returns whether sizes are logarithms: one is negative.
    fn is_log(&self, path: &Path, work: &Work<'_>) -> Result<bool> {
        let mut sizes = self.scale.reader();
        for number in 0..if self.may_be_log { self.count } else { 0 } {
            if number.is_multiple_of(1 << 16) && work.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let size = sizes.step().map_err(|e| read_error(path, format!("splat {number}"), e))?;
            if size[..3].iter().any(|v| *v < 0.0) {
                let text = "sizes below 0 are taken for logarithms, which drafts of KHR_gaussian_splatting stored";
                work.monitor.warn(&format!("{}: {text}", path.display()).into());
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn read(&self, path: &Path, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        let is_log = self.is_log(path, work)?;
        let open = |values: &Values| values.reader();
        let (mut mean, mut rotation, mut scale) = (open(&self.mean), open(&self.rotation), open(&self.scale));
        let [mut opacity, mut harmonics, mut colour] =
            [&self.opacity, &self.harmonics, &self.colour].map(|values| values.as_ref().map(open));
        for number in 0..self.count {
            let failed = |e| read_error(path, format!("splat {number}"), e);
            let [x, y, z, w] = rotation.step().map_err(failed)?;
            let [a, b, c, _] = scale.step().map_err(failed)?;
            let [px, py, pz, _] = mean.step().map_err(failed)?;
            let tint = colour.as_mut().map(|c| c.step()).transpose().map_err(failed)?;
            let stated = opacity.as_mut().map(|o| o.step()).transpose().map_err(failed)?;
            let wave = harmonics.as_mut().map(|h| h.step()).transpose().map_err(failed)?;
            let light = |v: f64| f64::from(from_linear(v.clamp(0.0, 1.0) as f32)) / 255.0;
            let colour = match (wave, tint) {
                (Some([r, g, b, _]), _) if self.is_linear => [r, g, b].map(|v| light(colour_of(v))),
                (Some([r, g, b, _]), _) => [r, g, b].map(colour_of),
                (None, Some([r, g, b, _])) => [r, g, b],
                (None, None) => [0.5; 3],
            };
            gate.push(Raw {
                mean: [px, py, pz],
                scale: [a, b, c].map(|v| if is_log { libm::exp(v) } else { v }),
                rotation: [w, x, y, z],
                opacity: stated.map_or(tint.map_or(1.0, |tint| tint[3]), |stated| stated[0]),
                colour,
            })?;
        }
        Ok(())
    }
}

/// A structure, the binary part of a GLB, and the GLB with the length that it states (bytes).
type Parsed = (Document, Option<Arc<dyn ByteSource>>, Option<(Arc<dyn ByteSource>, u64)>);

/// Reads the JSON of a glTF or GLB, which takes at most `memory` bytes.
fn read_document(source: Arc<dyn ByteSource>, path: &Path, memory: u64) -> Result<Parsed> {
    let mut head = [0; 12];
    if source.len() < 12 {
        return Err(wrong(path, "header", "expected glTF, found fewer than 12 bytes"));
    }
    source.read_at(0, &mut head)?;
    if &head[..4] != b"glTF" {
        return Ok((json(&source, path, memory)?, None, None));
    }
    let word = |bytes: &[u8], at: usize| {
        u64::from(u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]))
    };
    let (version, len) = (word(&head, 4), word(&head, 8));
    if version != 2 {
        return Err(wrong(path, "header", format!("expected version 2, found {version}")));
    }
    if len > source.len() {
        return Err(wrong(
            path,
            "header",
            format!("it states {len} bytes, and the file has {}: it is cut", source.len()),
        ));
    }
    let (mut at, mut document, mut binary) = (12, None, None);
    while at + 8 <= len && binary.is_none() {
        let mut chunk = [0; 8];
        source.read_at(at, &mut chunk)?;
        let part = Part::new(&source, at + 8, word(&chunk, 0)).filter(|part| at + 8 + part.len() <= len);
        let part: Arc<dyn ByteSource> = Arc::new(
            part.ok_or_else(|| wrong(path, format!("chunk at byte {at}"), "it ends behind the file: it is cut"))?,
        );
        at += 8 + part.len().next_multiple_of(4);
        match &chunk[4..] {
            b"JSON" if document.is_none() => document = Some(json(&part, path, memory)?),
            b"BIN\0" => binary = Some(part),
            _ => {}
        }
    }
    let document = document.ok_or_else(|| wrong(path, "header", "expected JSON in the first chunk, found none"))?;
    Ok((document, binary, Some((source, len))))
}

/// Returns the meshes of the scene with their places.
fn instances(document: &Document, path: &Path) -> Result<Vec<(usize, Placing)>> {
    let nodes = &document.nodes;
    let mut is_child = vec![false; nodes.len()];
    for &child in nodes.iter().flat_map(|node| &node.children) {
        let seen = is_child.get_mut(child).ok_or_else(|| wrong(path, "nodes", format!("there is no node {child}")))?;
        if std::mem::replace(seen, true) {
            return Err(wrong(path, format!("node {child}"), "it has two parents"));
        }
    }
    let scene = document.scenes.get(document.scene.unwrap_or(0));
    let roots: Vec<usize> = match (scene, document.scene) {
        (Some(scene), _) => scene.nodes.clone(),
        (None, Some(number)) => return Err(wrong(path, "scene", format!("there is no scene {number}"))),
        (None, None) => (0..nodes.len()).filter(|node| !is_child[*node]).collect(),
    };
    let mut roots = roots.into_iter().map(|node| (node, Placing::IDENTITY));
    let (mut open, mut found, mut seen) = (Vec::new(), Vec::new(), vec![false; nodes.len()]);
    while let Some((number, parent)) = open.pop().or_else(|| roots.next()) {
        let node = nodes.get(number).ok_or_else(|| wrong(path, "nodes", format!("there is no node {number}")))?;
        if std::mem::replace(&mut seen[number], true) {
            return Err(wrong(path, format!("node {number}"), "it occurs twice in the scene"));
        }
        let own = match node.matrix.as_deref() {
            Some(matrix) => {
                check_matrix(matrix).map_err(|reason| refuse(path, format!("node {number}"), reason))?;
                Placing::of_matrix(*matrix)
            }
            None => {
                let [translation, scale] = [&node.translation, &node.scale].map(|of| of.as_deref().copied());
                Placing::of_parts(translation, node.rotation.as_deref().copied(), scale)
            }
        };
        let placing = parent.then(&own);
        if !placing.is_finite() {
            return Err(wrong(path, format!("node {number}"), "its place is not finite"));
        }
        if let Some(mesh) = node.mesh {
            if mesh >= document.meshes.len() {
                return Err(wrong(path, format!("node {number}"), format!("there is no mesh {mesh}")));
            }
            found.push((mesh, placing));
        }
        open.extend(node.children.iter().rev().map(|child| (*child, placing)));
    }
    Ok(found)
}

/// Opens buffers and finds the values of primitives.
struct Loader<'a> {
    path: &'a Path,
    document: &'a Document,
    /// Buffers of the document, but those that are open.
    stated: Vec<Buffer>,
    binary: Option<Arc<dyn ByteSource>>,
    buffers: BTreeMap<usize, Arc<dyn ByteSource>>,
    beside: Beside,
}

impl Loader<'_> {
    fn primitive(&mut self, primitive: &Primitive, mesh: usize) -> Result<Option<Content>> {
        let at = format!("mesh {mesh}");
        let is_spz = |name: &str| name.contains("spz");
        let own = primitive.extensions.get(EXTENSION);
        let nested = own.and_then(|value| value.get("extensions")).and_then(|value| value.as_object());
        let spz = nested
            .and_then(|all| all.iter().find(|(name, _)| is_spz(name)).map(|(_, value)| value))
            .or_else(|| primitive.extensions.iter().find(|(name, _)| is_spz(name)).map(|(_, value)| value));
        if own.is_none() && spz.is_none() {
            return Ok(None);
        }
        if let Some(mode) = primitive.mode.filter(|mode| *mode != POINTS) {
            return Err(wrong(self.path, at, format!("expected splats as points (mode 0), found mode {mode}")));
        }
        let accessor_count =
            primitive.attributes.get("POSITION").and_then(|number| self.document.accessors.get(*number));
        let accessor_count = accessor_count.map(|accessor| accessor.count);
        if let Some(spz) = spz {
            let view = spz.get("bufferView").and_then(|view| view.as_u64());
            let view = view.ok_or_else(|| wrong(self.path, &at, "expected the buffer view of SPZ, found none"))?;
            let view = usize::try_from(view).unwrap_or(usize::MAX);
            let spz = Spz::open(Arc::new(self.view(view)?.0), self.path)?;
            if let Some(stated) = accessor_count.filter(|stated| *stated != spz.count()) {
                let reason = format!("expected {stated} splats in SPZ, found {}", spz.count());
                return Err(wrong(self.path, at, reason));
            }
            return Ok(Some(Content::Spz(spz)));
        }
        let mut find = |names: &[&str], components: usize, are_shares: bool| -> Result<Option<Values>> {
            let number = names.iter().find_map(|name| primitive.attributes.get(*name)).copied();
            number.map(|number| self.values(number, components, are_shares)).transpose()
        };
        let name = |end: &str| format!("{EXTENSION}:{end}");
        let [scale, rotation, opacity, wave] = ["SCALE", "ROTATION", "OPACITY", "SH_DEGREE_0_COEF_0"].map(name);
        let found = (
            find(&["POSITION"], 3, false)?,
            find(&[&rotation, "_ROTATION"], 4, false)?,
            find(&[&scale, "_SCALE"], 3, false)?,
            find(&[&opacity, "_OPACITY"], 1, true)?,
            find(&[&wave], 3, false)?,
            find(&["COLOR_0"], 3, true)?,
        );
        let (Some(mean), Some(rotation), Some(scale_values), opacity, harmonics, colour) = found else {
            return Err(wrong(self.path, at, "expected positions, rotations and sizes of splats, found fewer"));
        };
        let count = mean.count;
        let others = [Some(&rotation), Some(&scale_values), opacity.as_ref(), harmonics.as_ref(), colour.as_ref()];
        if let Some(other) = others.into_iter().flatten().find(|other| other.count != count) {
            let reason = format!("expected {count} values of each attribute, found {}", other.count);
            return Err(wrong(self.path, at, reason));
        }
        let space = own.and_then(|own| own.get("colorSpace")).and_then(|space| space.as_str());
        let is_linear = space.is_some_and(|space| space.starts_with("lin_"));
        let may_be_log = primitive.attributes.contains_key(&scale);
        let (mean, scale) = (mean, scale_values);
        let all = Attributes { count, mean, rotation, scale, may_be_log, opacity, harmonics, colour, is_linear };
        Ok(Some(Content::Attributes(Box::new(all))))
    }

    /// Returns the bytes of a buffer view, and its stride.
    fn view(&mut self, number: usize) -> Result<(Part, Option<u64>)> {
        let at = || format!("buffer view {number}");
        let views = &self.document.buffer_views;
        let view = views.get(number).ok_or_else(|| wrong(self.path, at(), "there is no such view"))?;
        if view.extensions.keys().any(|name| name.contains("meshopt")) {
            let reason = "its values are compressed by meshopt; export the file without it";
            return Err(refuse(self.path, at(), reason));
        }
        let buffer = self.buffer(view.buffer)?;
        let part = Part::new(&buffer, view.byte_offset, view.byte_length);
        Ok((part.ok_or_else(|| wrong(self.path, at(), "it ends behind its buffer"))?, view.byte_stride))
    }

    fn buffer(&mut self, number: usize) -> Result<Arc<dyn ByteSource>> {
        if let Some(open) = self.buffers.get(&number) {
            return Ok(open.clone());
        }
        let at = || format!("buffer {number}");
        // The text of one that is embedded is dropped here: what it holds is in memory then.
        let stated = self.stated.get_mut(number).map(std::mem::take);
        let stated = stated.ok_or_else(|| wrong(self.path, at(), "there is no such buffer"))?;
        let Buffer { uri, byte_length } = stated;
        let in_binary = uri.is_none();
        let source: Arc<dyn ByteSource> = match uri {
            None => {
                let own = self.binary.clone().filter(|_| number == 0);
                own.ok_or_else(|| wrong(self.path, at(), "it should lie in this file, which has no binary part"))?
            }
            Some(uri) => match uri.strip_prefix("data:") {
                Some(data) => {
                    let text = data.split_once("base64,").map(|(_, text)| text);
                    let text = text.ok_or_else(|| wrong(self.path, at(), "expected base64 text, found other"))?;
                    let bytes = base64::engine::general_purpose::STANDARD.decode(text);
                    Arc::new(MemorySource::new(
                        bytes.map_err(|e| wrong(self.path, at(), format!("damaged base64 ({e})")))?,
                    ))
                }
                None if uri.contains(':') => {
                    let reason = "it lies elsewhere; fetch it beside the file and name it there";
                    return Err(refuse(self.path, at(), reason));
                }
                None => {
                    let path = self.beside.path(&decode_percent(&uri));
                    open_named(&path.map_err(|reason| refuse(self.path, at(), reason))?)?.into()
                }
            },
        };
        let cut = || format!("it should have {byte_length} bytes and has {}: it is cut", source.len());
        let own = Part::new(&source, 0, byte_length).ok_or_else(|| wrong(self.path, at(), cut()))?;
        // The binary part is padded to a multiple of four bytes; another file may hold more than the buffer.
        if in_binary && source.len() - byte_length > 3 {
            let reason = format!("it states {byte_length} bytes, and the binary part has {}", source.len());
            return Err(wrong(self.path, at(), reason));
        }
        let own: Arc<dyn ByteSource> = Arc::new(own);
        self.buffers.insert(number, own.clone());
        Ok(own)
    }

    fn values(&mut self, number: usize, components: usize, are_shares: bool) -> Result<Values> {
        let at = || format!("accessor {number}");
        let accessors = &self.document.accessors;
        let accessor = accessors.get(number).ok_or_else(|| wrong(self.path, at(), "there is no such accessor"))?;
        accessor.check(components).map_err(|reason| wrong(self.path, at(), reason))?;
        let view = accessor.view().ok_or_else(|| wrong(self.path, at(), "expected a buffer view, found none"))?;
        let (part, stride) = self.view(view)?;
        accessor.values(Arc::new(part), stride, are_shares).map_err(|reason| wrong(self.path, at(), reason))
    }
}

/// Fills `row` with the next bytes.
fn read_row(column: &mut Column, row: &mut [u8]) -> std::io::Result<()> {
    column.read_exact(row)
}
