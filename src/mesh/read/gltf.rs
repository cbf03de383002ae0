//! glTF 2.0, as `.gltf` with its buffers and as `.glb`: the triangles of the default scene, or of all nodes where there
//! is none, in the places that their nodes give them.
//!
//! The structure is read by the crate `gltf-json` and held in memory; what of it is used is checked here, because the
//! checks of the crate `gltf` panic on numbers of accessors that do not exist. Buffers are read piece by piece. Skins
//! and morph targets stay at rest. Source: "glTF 2.0 Specification", Khronos Group, chapters 3.5 to 3.7.

use super::blocks::Blocks;
use super::text::BYTE_ORDER_MARK;
use super::{MeshOptions, Triangle, Triangles};
use crate::{Error, Result};
use base64::Engine;
use gltf_json::accessor::{Accessor, ComponentType, Type};
use gltf_json::mesh::{Mode, Primitive, Semantic};
use gltf_json::root::Get;
use gltf_json::scene::Node;
use gltf_json::validation::Checked;
use gltf_json::{Buffer, Index, Root};
use nalgebra::{Matrix4, Point3, Quaternion, UnitQuaternion, Vector3};
use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Least memory granted to the structure of a file (bytes).
const LEAST_JSON_BYTES: u64 = 16 << 20;
/// Most placed parts of meshes; nodes may share meshes, so these are not bounded by the file's length.
const MOST_PARTS: usize = 1 << 22;
/// Triangles read for one batch.
const BATCH: u64 = 512;

/// A buffer of the file.
enum Data {
    /// A file of its own, or the second chunk of a `.glb`, which begins at `start` and has `len` bytes.
    File { blocks: Blocks, start: u64, len: u64 },
    /// Bytes that the structure itself holds.
    Memory(Vec<u8>),
}

/// Equally typed values in a buffer.
#[derive(Debug, Clone, Copy)]
struct Values {
    buffer: usize,
    start: u64,
    stride: u64,
    count: u64,
    kind: ComponentType,
}

/// A part of a mesh in its place.
struct Part {
    place: Matrix4<f64>,
    mode: Mode,
    positions: Values,
    indices: Option<Values>,
}

impl Part {
    /// Number of triangles.
    fn len(&self) -> u64 {
        let corners = self.indices.map_or(self.positions.count, |indices| indices.count);
        match self.mode {
            Mode::Triangles => corners / 3,
            Mode::TriangleStrip | Mode::TriangleFan => corners.saturating_sub(2),
            _ => 0,
        }
    }

    /// Corners of triangle `number`, in order of the indices.
    fn corners(&self, number: u64) -> [u64; 3] {
        match self.mode {
            Mode::TriangleStrip => [number, number + 1, number + 2],
            Mode::TriangleFan => [0, number + 1, number + 2],
            _ => [3 * number, 3 * number + 1, 3 * number + 2],
        }
    }
}

pub(super) struct Reader {
    path: PathBuf,
    buffers: Vec<Data>,
    parts: Vec<Part>,
    part: usize,
    triangle: u64,
}

impl Reader {
    pub(super) fn open(path: &Path, options: &MeshOptions) -> Result<Self> {
        let (json, binary) = read_structure(path, options.memory_bytes.max(LEAST_JSON_BYTES))?;
        let root = Root::from_slice(json.strip_prefix(BYTE_ORDER_MARK).unwrap_or(&json)).map_err(|e| {
            Error::input(path, "structure", format!("{}; expected glTF 2.0", e.to_string().replace('\n', " ")))
        })?;
        drop(json);
        let mut reader =
            Self { path: path.to_path_buf(), buffers: Vec::new(), parts: Vec::new(), part: 0, triangle: 0 };
        if !root.asset.version.starts_with("2.") {
            let reason = format!("expected glTF of version 2, found {:?}", root.asset.version);
            return Err(reader.error("structure", reason));
        }
        if let Some(extension) = root.extensions_required.first() {
            let reason = format!("it requires the extension {extension:?}; export the file without it");
            return Err(reader.error("structure", reason));
        }
        for (number, buffer) in root.buffers.iter().enumerate() {
            let data = reader.open_buffer(number, buffer, binary)?;
            reader.buffers.push(data);
        }
        reader.add_scene(&root)?;
        Ok(reader)
    }

    fn add_scene(&mut self, root: &Root) -> Result<()> {
        let scene = match root.scene {
            Some(number) => Some(self.part(root, number, "scene")?),
            None => root.scenes.first(),
        };
        let roots: Vec<Index<Node>> = match scene {
            Some(scene) => scene.nodes.clone(),
            None => {
                let children: HashSet<usize> =
                    root.nodes.iter().flat_map(|node| node.children.iter().flatten()).map(Index::value).collect();
                (0..root.nodes.len()).filter(|n| !children.contains(n)).map(|n| Index::new(n as u32)).collect()
            }
        };
        // Every node has one parent at most, so one that is met twice is damage, and might be a circle.
        let mut met = vec![false; root.nodes.len()];
        // The last is taken first; so parts come in the order of the file.
        let mut open: Vec<_> = roots.into_iter().rev().map(|node| (node, Matrix4::identity())).collect();
        while let Some((number, above)) = open.pop() {
            let node: &Node = self.part(root, number, "node")?;
            if std::mem::replace(&mut met[number.value()], true) {
                return Err(self.error(format!("node {}", number.value()), "it has two parents, or is its own"));
            }
            let place = above * matrix(node);
            if let Some(mesh) = node.mesh {
                let mesh: &gltf_json::Mesh = self.part(root, mesh, "mesh")?;
                mesh.primitives.iter().try_for_each(|primitive| self.add_part(root, primitive, place))?;
            }
            open.extend(node.children.iter().flatten().rev().map(|&child| (child, place)));
        }
        Ok(())
    }

    /// The part of the structure with a number that the file gives.
    fn part<'r, T>(&self, root: &'r Root, number: Index<T>, what: &str) -> Result<&'r T>
    where
        Root: Get<T>,
    {
        root.get(number)
            .ok_or_else(|| self.error("structure", format!("it names {what} {}, which does not exist", number.value())))
    }

    fn error(&self, at: impl Into<String>, reason: impl Into<String>) -> Error {
        Error::input(&self.path, at, reason)
    }

    fn open_buffer(&self, number: usize, buffer: &Buffer, binary: Option<BinaryPart>) -> Result<Data> {
        let at = || format!("buffer {number}");
        let data = match buffer.uri.as_deref() {
            None => {
                let (start, len) =
                    binary.ok_or_else(|| self.error(at(), "it should lie in this file, which has no binary part"))?;
                let file = File::open(&self.path).map_err(|e| Error::io(&self.path, "open", e))?;
                Data::File { blocks: Blocks::new(file, &self.path), start, len }
            }
            Some(uri) => match uri.split_once("base64,") {
                Some((head, text)) if head.starts_with("data:") => {
                    let bytes = base64::engine::general_purpose::STANDARD.decode(text);
                    Data::Memory(bytes.map_err(|e| self.error(at(), format!("its base64 text is damaged: {e}")))?)
                }
                _ if uri.contains(':') => {
                    return Err(self.error(at(), "it lies elsewhere; fetch it beside the file and name it there"));
                }
                _ => {
                    let path = self.path.with_file_name(decode_percent(uri));
                    let open = File::open(&path).and_then(|file| Ok((file.metadata()?.len(), file)));
                    let (len, file) =
                        open.map_err(|e| self.error(at(), format!("cannot open {}: {e}", path.display())))?;
                    Data::File { blocks: Blocks::new(file, &path), start: 0, len }
                }
            },
        };
        let found = match &data {
            Data::File { len, .. } => *len,
            Data::Memory(bytes) => bytes.len() as u64,
        };
        let stated = buffer.byte_length.0;
        if found < stated {
            return Err(self.error(at(), format!("it should have {stated} bytes and has {found}: it is cut")));
        }
        Ok(data)
    }

    fn add_part(&mut self, root: &Root, primitive: &Primitive, place: Matrix4<f64>) -> Result<()> {
        let Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) = primitive.mode else {
            return Ok(());
        };
        let Some(&positions) = primitive.attributes.get(&Checked::Valid(Semantic::Positions)) else { return Ok(()) };
        let kinds = [ComponentType::U8, ComponentType::U16, ComponentType::U32];
        let positions = self.values(root, positions, Type::Vec3, &[ComponentType::F32])?;
        let indices = primitive.indices.map(|of| self.values(root, of, Type::Scalar, &kinds)).transpose()?;
        if self.parts.len() == MOST_PARTS {
            return Err(self.error("structure", format!("more than {MOST_PARTS} placed parts of meshes")));
        }
        self.parts.push(Part { place, mode, positions, indices });
        Ok(())
    }

    /// Values that lie within their buffer.
    fn values(&self, root: &Root, of: Index<Accessor>, shape: Type, kinds: &[ComponentType]) -> Result<Values> {
        let at = || format!("accessor {}", of.value());
        let accessor = self.part(root, of, "accessor")?;
        let kind = match (accessor.type_, accessor.component_type) {
            (Checked::Valid(found), Checked::Valid(kind)) if found == shape && kinds.contains(&kind.0) => kind.0,
            (found, kind) => {
                let reason = format!("expected {shape:?} of {kinds:?}, found {found:?} of {kind:?}");
                return Err(self.error(at(), reason));
            }
        };
        let (Some(view), None) = (accessor.buffer_view, &accessor.sparse) else {
            return Err(self.error(at(), "sparse values are not supported; export the file without them"));
        };
        let view = self.part(root, view, "view")?;
        let buffer = self.part(root, view.buffer, "buffer")?;
        let (size, count) = ((kind.size() * shape.multiplicity()) as u64, accessor.count.0);
        let stride = view.byte_stride.map_or(0, |stride| stride.0 as u64);
        // Zero stands for no gaps.
        let stride = if stride == 0 { size } else { stride };
        let view_start = view.byte_offset.map_or(0, |offset| offset.0);
        let start = view_start.checked_add(accessor.byte_offset.map_or(0, |offset| offset.0));
        let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        let end = start.zip(needed).and_then(|(start, needed)| start.checked_add(needed));
        let limit = view_start.saturating_add(view.byte_length.0).min(buffer.byte_length.0);
        match (start, end) {
            (Some(start), Some(end)) if end <= limit => {
                Ok(Values { buffer: view.buffer.value(), start, stride, count, kind })
            }
            _ => Err(self.error(at(), format!("its {count} values reach beyond the {limit} bytes that hold them"))),
        }
    }

    fn fill(&mut self, values: &Values, number: u64, out: &mut [u8]) -> Result<()> {
        let at = values.start + number * values.stride;
        match self.buffers.get_mut(values.buffer) {
            Some(Data::File { blocks, start, .. }) => blocks.read(*start + at, out),
            Some(Data::Memory(bytes)) => {
                let bytes = usize::try_from(at).ok().and_then(|at| bytes.get(at..at + out.len()));
                bytes.map(|bytes| out.copy_from_slice(bytes)).ok_or_else(|| self.error("buffer", "it is too short"))
            }
            None => Err(self.error("buffer", "it does not exist")),
        }
    }

    fn index(&mut self, values: &Values, number: u64) -> Result<u64> {
        let mut bytes = [0; 4];
        let size = match values.kind {
            ComponentType::U8 => 1,
            ComponentType::U16 => 2,
            _ => 4,
        };
        self.fill(values, number, &mut bytes[..size])?;
        Ok(u64::from(u32::from_le_bytes(bytes)))
    }

    fn position(&mut self, values: &Values, number: u64) -> Result<[f64; 3]> {
        if number >= values.count {
            return Err(self.error("indices", format!("there is no corner {number}: the part has {}", values.count)));
        }
        let mut bytes = [0; 12];
        self.fill(values, number, &mut bytes)?;
        let (numbers, _) = bytes.as_chunks::<4>();
        Ok([0, 1, 2].map(|axis| f64::from(f32::from_le_bytes(numbers[axis]))))
    }
}

impl Triangles for Reader {
    fn read(&mut self, out: &mut Vec<Triangle>) -> Result<bool> {
        for _ in 0..BATCH {
            let Some(part) = self.parts.get(self.part) else { return Ok(false) };
            if self.triangle == part.len() {
                (self.part, self.triangle) = (self.part + 1, 0);
                continue;
            }
            let (place, positions, indices) = (part.place, part.positions, part.indices);
            let mut triangle = [[0.0; 3]; 3];
            for (corner, mut number) in triangle.iter_mut().zip(part.corners(self.triangle)) {
                if let Some(indices) = &indices {
                    number = self.index(indices, number)?;
                }
                let at = self.position(&positions, number)?;
                *corner = place.transform_point(&Point3::from(at)).into();
            }
            out.push(triangle);
            self.triangle += 1;
        }
        Ok(true)
    }
}

/// Where a node places what it holds; a matrix excludes the rest (glTF 2.0, section 3.5.3).
fn matrix(node: &Node) -> Matrix4<f64> {
    if let Some(matrix) = node.matrix {
        return Matrix4::from_iterator(matrix.into_iter().map(f64::from));
    }
    let wide = |v: [f32; 3]| Vector3::from(v.map(f64::from));
    let shift = node.translation.map_or(Vector3::zeros(), wide);
    let scale = node.scale.map_or(Vector3::repeat(1.0), wide);
    let [x, y, z, w] = node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |rotation| rotation.0.map(f64::from));
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Matrix4::new_translation(&shift) * turn.to_homogeneous() * Matrix4::new_nonuniform_scaling(&scale)
}

/// Where the binary part of a `.glb` begins, and its length.
type BinaryPart = (u64, u64);

/// The structure of a file, and of a `.glb` where its binary part begins and its length.
fn read_structure(path: &Path, most_bytes: u64) -> Result<(Vec<u8>, Option<BinaryPart>)> {
    let io = |e| Error::io(path, "read the structure", e);
    let mut file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let bytes = file.metadata().map_err(io)?.len();
    let mut head = Vec::new();
    Read::by_ref(&mut file).take(20).read_to_end(&mut head).map_err(io)?;
    let word = |at: usize| head.get(at..at + 4).map_or(0, |b| u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])));
    let binary = head.starts_with(b"glTF");
    let (start, len) = if binary {
        let (version, whole, len) = (word(4), word(8), word(12));
        if version != 2 || head.get(16..20) != Some(b"JSON") {
            return Err(Error::input(path, "header", format!("expected GLB of version 2, found version {version}")));
        }
        if whole > bytes || 20 + len > whole {
            let reason = format!("it states {whole} bytes, {len} of structure, and has {bytes}: it is cut or damaged");
            return Err(Error::input(path, "header, byte 8", reason));
        }
        (20, len)
    } else {
        (0, bytes)
    };
    if len > most_bytes {
        let what = format!("{}: structure (bytes) (give more --memory)", path.display());
        return Err(Error::Limit { what, value: len.to_string(), max: most_bytes.to_string() });
    }
    let mut json = Vec::new();
    file.seek(SeekFrom::Start(start)).map_err(io)?;
    Read::by_ref(&mut file).take(len).read_to_end(&mut json).map_err(io)?;
    let mut next = [0; 8];
    let chunk = binary && file.read_exact(&mut next).is_ok() && next[4..] == *b"BIN\0";
    let stated = u64::from(u32::from_le_bytes([next[0], next[1], next[2], next[3]]));
    let at = start + len + 8;
    Ok((json, chunk.then(|| (at, stated.min(bytes.saturating_sub(at))))))
}

/// `%20` and the like to the bytes they stand for; what is no such code stays.
fn decode_percent(text: &str) -> String {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        let code = after.get(..2).filter(|_| byte == b'%').and_then(|code| std::str::from_utf8(code).ok());
        match code.and_then(|code| u8::from_str_radix(code, 16).ok()) {
            Some(decoded) => (bytes.push(decoded), rest = &after[2..]).1,
            None => (bytes.push(byte), rest = after).1,
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}
