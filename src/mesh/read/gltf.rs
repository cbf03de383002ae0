//! glTF 2.0, as `.gltf` with its buffers and as `.glb`: the triangles of the default scene, or of all nodes where there
//! is none, in the places that their nodes give them.
//!
//! The structure is read and checked by the crate `gltf` and held in memory; buffers are read piece by piece. Skins and
//! morph targets stay at rest. Source: "glTF 2.0 Specification", Khronos Group, chapters 3.5 to 3.7.

use super::blocks::Blocks;
use super::{MeshOptions, Triangle, Triangles};
use crate::{Error, Result};
use base64::Engine;
use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::Source;
use gltf::mesh::Mode;
use gltf::scene::Transform;
use nalgebra::{Matrix4, Point3, Quaternion, UnitQuaternion, Vector3};
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
    kind: DataType,
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
        let gltf = gltf::Gltf::from_slice(&json).map_err(|e| {
            let text = e.to_string().replace('\n', " ");
            Error::input(path, "structure", format!("{text}; expected glTF 2.0 without required extensions"))
        })?;
        drop(json);
        let mut reader =
            Self { path: path.to_path_buf(), buffers: Vec::new(), parts: Vec::new(), part: 0, triangle: 0 };
        for buffer in gltf.buffers() {
            let data = reader.open_buffer(buffer, binary)?;
            reader.buffers.push(data);
        }
        let scene = gltf.default_scene().or_else(|| gltf.scenes().next());
        // Every node has one parent at most, so one that is met twice is damage, and might be a circle.
        let mut met = vec![false; gltf.nodes().len()];
        let mut open: Vec<(gltf::Node<'_>, Matrix4<f64>)> = match &scene {
            Some(scene) => scene.nodes().map(|node| (node, Matrix4::identity())).collect(),
            None => {
                let is_child = |node: &gltf::Node<'_>| {
                    gltf.nodes().any(|parent| parent.children().any(|child| child.index() == node.index()))
                };
                gltf.nodes().filter(|node| !is_child(node)).map(|node| (node, Matrix4::identity())).collect()
            }
        };
        // The last is taken first; so parts come in the order of the file.
        open.reverse();
        while let Some((node, above)) = open.pop() {
            if std::mem::replace(&mut met[node.index()], true) {
                return Err(reader.error(format!("node {}", node.index()), "it has two parents, or is its own"));
            }
            let place = above * matrix(node.transform());
            for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
                reader.add_part(&primitive, place)?;
            }
            let children: Vec<_> = node.children().collect();
            open.extend(children.into_iter().rev().map(|child| (child, place)));
        }
        Ok(reader)
    }

    fn error(&self, at: impl Into<String>, reason: impl Into<String>) -> Error {
        Error::input(&self.path, at, reason)
    }

    fn open_buffer(&self, buffer: gltf::Buffer<'_>, binary: Option<(u64, u64)>) -> Result<Data> {
        let at = || format!("buffer {}", buffer.index());
        let data = match buffer.source() {
            Source::Bin => {
                let (start, len) =
                    binary.ok_or_else(|| self.error(at(), "it should lie in this file, which has no binary part"))?;
                let file = File::open(&self.path).map_err(|e| Error::io(&self.path, "open", e))?;
                Data::File { blocks: Blocks::new(file, &self.path), start, len }
            }
            Source::Uri(uri) => match uri.split_once("base64,") {
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
                    let (len, file) = open.map_err(|e| Error::io(&path, "open", e))?;
                    Data::File { blocks: Blocks::new(file, &path), start: 0, len }
                }
            },
        };
        let found = match &data {
            Data::File { len, .. } => *len,
            Data::Memory(bytes) => bytes.len() as u64,
        };
        if found < buffer.length() as u64 {
            let reason = format!("it should have {} bytes and has {found}: it is cut", buffer.length());
            return Err(self.error(at(), reason));
        }
        Ok(data)
    }

    fn add_part(&mut self, primitive: &gltf::Primitive<'_>, place: Matrix4<f64>) -> Result<()> {
        if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            return Ok(());
        }
        let Some(positions) = primitive.get(&gltf::Semantic::Positions) else { return Ok(()) };
        let (mode, kinds) = (primitive.mode(), [DataType::U8, DataType::U16, DataType::U32]);
        let positions = self.values(&positions, Dimensions::Vec3, &[DataType::F32])?;
        let indices = primitive.indices().map(|of| self.values(&of, Dimensions::Scalar, &kinds)).transpose()?;
        if self.parts.len() == MOST_PARTS {
            return Err(self.error("structure", format!("more than {MOST_PARTS} placed parts of meshes")));
        }
        self.parts.push(Part { place, mode, positions, indices });
        Ok(())
    }

    /// Values that lie within their buffer.
    fn values(&self, of: &gltf::Accessor<'_>, dimensions: Dimensions, kinds: &[DataType]) -> Result<Values> {
        let at = || format!("accessor {}", of.index());
        if of.dimensions() != dimensions || !kinds.contains(&of.data_type()) {
            let found = format!("{:?} of {:?}", of.dimensions(), of.data_type());
            return Err(self.error(at(), format!("expected {dimensions:?} of {kinds:?}, found {found}")));
        }
        let (Some(view), None) = (of.view(), of.sparse()) else {
            return Err(self.error(at(), "sparse values are not supported; export the file without them"));
        };
        let sum = |a: usize, b: usize| (a as u64).checked_add(b as u64);
        let (size, count) = (of.size() as u64, of.count() as u64);
        let stride = view.stride().map_or(size, |stride| stride as u64);
        let start = sum(view.offset(), of.offset());
        let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        let end = start.zip(needed).and_then(|(start, needed)| start.checked_add(needed));
        let limit = sum(view.offset(), view.length()).unwrap_or(0).min(view.buffer().length() as u64);
        match (start, end) {
            (Some(start), Some(end)) if end <= limit => {
                Ok(Values { buffer: view.buffer().index(), start, stride, count, kind: of.data_type() })
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
            DataType::U8 => 1,
            DataType::U16 => 2,
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

fn matrix(transform: Transform) -> Matrix4<f64> {
    match transform {
        Transform::Matrix { matrix } => Matrix4::from_fn(|row, column| f64::from(matrix[column][row])),
        Transform::Decomposed { translation, rotation, scale } => {
            let [x, y, z, w] = rotation.map(f64::from);
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_homogeneous();
            let scale = Matrix4::new_nonuniform_scaling(&Vector3::from(scale.map(f64::from)));
            Matrix4::new_translation(&Vector3::from(translation.map(f64::from))) * turn * scale
        }
    }
}

/// The structure of a file, and of a `.glb` where its binary part begins and its length.
fn read_structure(path: &Path, most_bytes: u64) -> Result<(Vec<u8>, Option<(u64, u64)>)> {
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
