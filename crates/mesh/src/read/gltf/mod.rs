//! glTF 2.0, as `.gltf` with its buffers and as `.glb`: the triangles of the default scene, or of all nodes if there is
//! no scene, with the transforms of their nodes applied.
//!
//! Materials, textures and vertex colours are read only if colours are requested ([`materials`]).
//!
//! The used part of the structure is held in memory and checked here. Buffers are read in blocks, and transforms are
//! computed while the reader traverses the nodes. Skins and morph targets stay at rest. Sources: "glTF 2.0
//! Specification", Khronos Group, chapters 3.5 to 3.7; `KHR_mesh_quantization`; `EXT_mesh_gpu_instancing`.

mod buffers;
mod materials;
mod structure;

use self::buffers::{BinaryPart, Buffers};
use self::materials::{Coat, Materials};
use self::structure::{Accessor, AccessorShape, Instances, NodeTransform, Primitive, SPLATS, Sparse, Structure};
use super::text::only_padding;
use super::texture::Textures;
use super::watch::{Digest, MeshSource, Watch};
use super::{BATCH_TRIANGLES, MeshBatch, MeshOptions, Triangles, Wants};
use crate::colour::{from_linear, multiplied};
use crate::input::gltf::check_matrix;
use crate::paint::{Paint, WHITE};
use crate::text::{behind_mark, counted};
use crate::{Error, Parameter, Result};
use bitvec::vec::BitVec;
use nalgebra::{Matrix4, Point3, Quaternion, UnitQuaternion, Vector3};
use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Least memory granted to the structure of a file (bytes), once as text and again as parsed.
const LEAST_JSON_BYTES: u64 = 16 << 20;
/// Most primitives placed by nodes; nodes may share meshes, so the file's length does not bound their number.
const MOST_PARTS: u64 = 1 << 22;
/// Most values that an accessor may have without bytes: as many as indices of 32 bits can name.
const MOST_ZEROS: u64 = 1 << 32;
/// Deepest nesting of nodes.
const DEEPEST: usize = 1000;

/// Modes of primitives: points and triangles.
const POINTS: u8 = 0;
const TRIANGLES: u8 = 4;
const STRIP: u8 = 5;
const FAN: u8 = 6;

/// Component types.
const I8: u32 = 5120;
const U8: u32 = 5121;
const I16: u32 = 5122;
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;

/// Values of an accessor: equally typed, in a buffer.
#[derive(Debug, Clone, Copy)]
struct Values {
    /// Zeros if `None`.
    place: Option<ValuePlace>,
    count: u64,
    /// Type and bytes of a component, and whether integers stand for fractions of their greatest value.
    kind: u32,
    size: usize,
    normalized: bool,
    /// Sparse values: their number, their indices in ascending order, and the values.
    sparse: Option<(u64, (ValuePlace, usize), ValuePlace)>,
}

/// Where values lie, one every `stride` bytes.
#[derive(Debug, Clone, Copy)]
struct ValuePlace {
    buffer: usize,
    start: u64,
    stride: u64,
}

/// Instances of a node's mesh.
#[derive(Debug, Clone, Copy)]
struct Copies {
    translation: Option<Values>,
    rotation: Option<Values>,
    scale: Option<Values>,
    count: u64,
}

/// A primitive with its transform.
#[derive(Debug, Clone, Copy)]
struct PlacedPrimitive {
    place: Matrix4<f64>,
    mode: u8,
    positions: Values,
    indices: Option<Values>,
    /// Number of the primitive.
    number: usize,
}

/// Colour source of the current primitive.
struct PartColours {
    coat: Coat,
    /// Texture coordinates and colours of its corners.
    places: Option<Values>,
    colours: Option<Values>,
}

impl PlacedPrimitive {
    /// Number of corners, as often as triangles name them.
    fn corner_count(&self) -> u64 {
        self.indices.map_or(self.positions.count, |indices| indices.count)
    }

    /// Number of triangles.
    fn len(&self) -> u64 {
        let corners = self.corner_count();
        if self.mode == TRIANGLES { corners / 3 } else { corners.saturating_sub(2) }
    }

    /// Checks that its corners make whole triangles; returns the reason if not.
    fn check_count(&self) -> Result<(), String> {
        let corners = self.corner_count();
        let (fits, expected) = match self.mode {
            TRIANGLES => (corners.is_multiple_of(3), "a multiple of 3"),
            _ => (corners != 1 && corners != 2, "at least 3"),
        };
        let reason = || format!("it has {}; expected {expected}; write the file again", counted(corners, "corner"));
        fits.then_some(()).ok_or_else(reason)
    }

    /// Returns the corners of triangle `number`, as positions in the list of indices.
    fn corners(&self, number: u64) -> [u64; 3] {
        match self.mode {
            STRIP => [number, number + 1, number + 2],
            FAN => [0, number + 1, number + 2],
            _ => [3 * number, 3 * number + 1, 3 * number + 2],
        }
    }
}

/// Contents of a file, checked as far as they are used.
struct Checked {
    path: PathBuf,
    structure: Structure<'static>,
    buffers: Buffers,
    /// Root nodes.
    roots: Vec<u32>,
}

/// Sibling nodes that are being traversed: a range of the list of all children, or of all roots.
struct Level {
    nodes: std::ops::Range<usize>,
    above: Matrix4<f64>,
}

/// Depth-first traversal of the nodes in file order: each node before its children.
#[derive(Default)]
struct Traversal {
    levels: Vec<Level>,
    /// Remaining primitives of the current node, and their transform.
    primitives: std::ops::Range<usize>,
    place: Matrix4<f64>,
    /// All its primitives and its transform, its instances, and the number of the next one.
    node: (std::ops::Range<usize>, Matrix4<f64>),
    copies: Option<Copies>,
    copy: u64,
}

pub(super) struct GltfReader {
    checked: Checked,
    traversal: Traversal,
    primitive: Option<PlacedPrimitive>,
    triangle: u64,
    /// Present if colours are requested.
    materials: Option<Materials>,
    colours: Option<PartColours>,
}

impl GltfReader {
    pub(super) fn open(path: &Path, options: &MeshOptions, wants: Wants<'_>, watch: &mut Watch) -> Result<Self> {
        let digest = wants.digest;
        let most_bytes = options.memory_bytes.max(LEAST_JSON_BYTES);
        let (json, binary) = read_structure(path, most_bytes, digest, watch)?;
        watch.check_cancelled()?;
        let text = behind_mark(&json);
        let structure = Structure::parse(text, most_bytes, wants.colours.is_some()).map_err(|e| {
            Error::input(path, "structure", format!("{}; expected glTF 2.0", e.to_string().replace('\n', " ")))
        })?;
        let wrong = |reason: String| Err(Error::input(path, "structure", reason));
        if !structure.version.starts_with("2.") {
            return wrong(format!("expected glTF of version 2, found {:?}", structure.version));
        }
        if structure.extension_needed.as_ref().is_some_and(|extension| extension.contains(SPLATS)) {
            return wrong("it holds Gaussian splats, not a mesh; export its mesh to a file of its own".into());
        }
        if let Some(extension) = &structure.extension_needed {
            return wrong(format!("it requires the extension {extension:?}; export the file without it"));
        }
        let buffers = Buffers::open(path, &structure.buffers, binary, digest)?;
        let textures = |alive| Textures::new(path, options.texture_bytes, digest, alive);
        let materials = wants.colours.map(|alive| Materials::new(path, &structure, textures(alive)));
        let structure = structure.without_text();
        drop(json);
        let mut checked = Checked { path: path.to_path_buf(), structure, buffers, roots: Vec::new() };
        checked.roots = checked.roots()?;
        for accessor in checked.check(wants.colours.is_some(), watch)? {
            checked.check_order(accessor, watch)?;
        }
        let traversal = Traversal::new(&checked);
        Ok(Self { checked, traversal, primitive: None, triangle: 0, materials, colours: None })
    }
}

impl Checked {
    fn error(&self, at: impl Into<String>, reason: impl Into<String>) -> Error {
        Error::input(&self.path, at, reason)
    }

    fn missing(&self, what: &str, number: impl std::fmt::Display) -> Error {
        self.error("structure", format!("it names {what} {number}, which does not exist"))
    }

    /// Returns the nodes of the default scene, else of the first scene, else all nodes without a parent.
    fn roots(&self) -> Result<Vec<u32>> {
        let Structure { scenes, nodes, children, .. } = &self.structure;
        let scene = match self.structure.scene {
            Some(number) if number as usize >= scenes.len() => return Err(self.missing("scene", number)),
            Some(number) => Some(number as usize),
            None => (scenes.len() > 0).then_some(0),
        };
        if let Some(scene) = scene {
            return Ok(scenes.numbers()[scenes.range(scene)].to_vec());
        }
        let mut is_child: BitVec = BitVec::repeat(false, nodes.len());
        for &child in children.numbers().iter().filter(|child| (**child as usize) < nodes.len()) {
            is_child.set(child as usize, true);
        }
        Ok(is_child.iter_zeros().map(|node| node as u32).collect())
    }

    /// Traverses all nodes and checks each primitive once, so that faults show at once and not after hours. Returns the
    /// accessors with sparse values whose values will be read.
    fn check(&self, has_colours: bool, watch: &mut Watch) -> Result<BTreeSet<usize>> {
        let Structure { nodes, children, .. } = &self.structure;
        let (mut met, mut checked): (BitVec, BitVec) =
            (BitVec::repeat(false, nodes.len()), BitVec::repeat(false, self.structure.primitives.len()));
        let (mut parts, mut clouds) = (0u64, 0u64);
        let mut sparse = BTreeSet::new();
        let is_sparse = |of: &usize| self.structure.accessors.get(*of).is_some_and(|of| of.sparse.is_some());
        let mut levels = vec![(0..self.roots.len(), true)];
        while let Some((level, are_roots)) = levels.last_mut() {
            watch.step()?;
            let list = if *are_roots { &self.roots[..] } else { children.numbers() };
            let Some(number) = level.next().map(|at| list[at]) else {
                levels.pop();
                continue;
            };
            let node = nodes.get(number as usize).ok_or_else(|| self.missing("node", number))?;
            // A node has at most one parent, so a node met twice is damage, and might be a cycle.
            if met.replace(number as usize, true) {
                return Err(self.error(format!("node {number}"), "it has two parents, or is its own"));
            }
            if let Some(NodeTransform::Matrix(matrix)) = node.transform().map(|of| self.structure.transforms[of]) {
                check_matrix(&matrix).map_err(|reason| self.error(format!("node {number}"), reason))?;
            }
            if let Some(mesh) = node.mesh() {
                let primitives = self.structure.mesh(mesh).ok_or_else(|| self.missing("mesh", mesh))?;
                let copies = node.instances().map(|number| self.copies(number)).transpose()?;
                let copies = copies.map_or(1, |copies| copies.count);
                parts = parts.saturating_add(copies.saturating_mul(primitives.len() as u64));
                let instances = node.instances().map(|number| self.structure.instances[number]);
                sparse.extend(instances.iter().flat_map(Instances::accessors).filter(is_sparse));
                let first = primitives.start;
                for number in primitives.filter(|&number| !checked.replace(number, true)) {
                    watch.step()?;
                    let primitive = self.structure.primitives[number];
                    if let Some(part) = self.part(number, Matrix4::identity())? {
                        let at = || format!("mesh {mesh}, part {}", number - first);
                        part.check_count().or_else(|reason| watch.lose(1, self.error(at(), reason)))?;
                        sparse.extend(primitive.accessors(has_colours).filter(is_sparse));
                    }
                    clouds += u64::from(primitive.mode == POINTS);
                }
            }
            if parts > MOST_PARTS {
                return Err(self.error("structure", format!("more than {MOST_PARTS} placed parts of meshes")));
            }
            if levels.len() == DEEPEST {
                return Err(self.error(format!("node {number}"), format!("it lies below {DEEPEST} others")));
            }
            levels.push((children.range(number as usize), false));
        }
        if clouds > 0 {
            let reason = format!(
                "it has {} of points, which are not read from glTF; write scans as E57, LAS or PLY, and splats to a \
                 file of their own",
                counted(clouds, "part")
            );
            watch.lose(clouds, self.error("structure", reason))?;
        }
        let has_triangles = |number: &usize| {
            let primitive = &self.structure.primitives[*number];
            matches!(primitive.mode, TRIANGLES | STRIP | FAN) && primitive.positions().is_some()
        };
        let hidden = checked.iter_zeros().filter(has_triangles).count() as u64;
        if hidden > 0 {
            let (name, parts) = (self.path.display(), counted(hidden, "part"));
            watch.monitor.warn(&format!("{name}: left out {parts} of meshes that the scene does not show").into());
        }
        Ok(sparse)
    }

    /// Checks that the indices of an accessor's sparse values ascend, which the search for a value relies on.
    fn check_order(&mut self, number: usize, watch: &mut Watch) -> Result<()> {
        let accessor = self.structure.accessors.get(number);
        let Some(&Accessor { count, sparse: Some(Sparse { count: some, indices, .. }), .. }) = accessor else {
            return Ok(());
        };
        let at = || format!("accessor {number}");
        let size = size_of_kind(indices.component_type);
        let place = self.place(indices.buffer_view, indices.byte_offset, some, size as u64);
        let place = place.map_err(|reason| self.error(at(), reason))?;
        let mut least = 0;
        for value in 0..some {
            watch.step()?;
            let mut index = [0; 4];
            self.read_at(Some(place), value, &mut index[..size])?;
            let index = u64::from(u32::from_le_bytes(index));
            if index < least || index >= count {
                let reason = format!(
                    "sparse value {value} has the index {index}; expected ascending indices below {count}; write the \
                     file again"
                );
                return Err(self.error(at(), reason));
            }
            least = index + 1;
        }
        Ok(())
    }

    /// Returns a primitive with its transform; `None` if it has no triangles.
    fn part(&self, number: usize, place: Matrix4<f64>) -> Result<Option<PlacedPrimitive>> {
        let primitive = &self.structure.primitives[number];
        if primitive.mode > FAN {
            return Err(
                self.error("structure", format!("a part of a mesh has the mode {}; expected 0 to 6", primitive.mode))
            );
        }
        let (TRIANGLES | STRIP | FAN, Some(positions)) = (primitive.mode, primitive.positions()) else {
            return Ok(None);
        };
        if primitive.is_draco && self.structure.accessors.get(positions).is_some_and(|of| of.buffer_view.is_none()) {
            let reason =
                "its parts are there compressed by KHR_draco_mesh_compression only; export the file without it";
            return Err(self.error("structure", reason));
        }
        let positions = self.values(positions, AccessorShape::Vec3, &[F32, I8, U8, I16, U16])?;
        let indices =
            primitive.indices().map(|of| self.values(of, AccessorShape::Scalar, &[U8, U16, U32])).transpose()?;
        Ok(Some(PlacedPrimitive { place, mode: primitive.mode, positions, indices, number }))
    }

    /// Returns the values of an accessor, checked to lie within their buffer.
    fn values(&self, number: usize, shape: AccessorShape, kinds: &[u32]) -> Result<Values> {
        let at = || format!("accessor {number}");
        let accessor = self.structure.accessors.get(number).ok_or_else(|| self.missing("accessor", number))?;
        let &Accessor { component_type, count, .. } = accessor;
        if accessor.shape != shape || !kinds.contains(&component_type) {
            let found = format!("{:?} of type {component_type}", accessor.shape);
            return Err(self.error(at(), format!("expected {shape:?} of type {kinds:?}, found {found}")));
        }
        let size = size_of_kind(component_type);
        let whole = size as u64
            * match shape {
                AccessorShape::Vec2 => 2,
                AccessorShape::Vec3 => 3,
                AccessorShape::Vec4 => 4,
                AccessorShape::Scalar | AccessorShape::Other => 1,
            };
        let place =
            |view, offset, count, whole| self.place(view, offset, count, whole).map_err(|e| self.error(at(), e));
        let sparse = match accessor.sparse {
            None => None,
            Some(Sparse { count: some, indices, values }) => {
                let kind = indices.component_type;
                if ![U8, U16, U32].contains(&kind) || some > count {
                    return Err(self.error(at(), format!("{some} sparse values with indices of type {kind}")));
                }
                let size = size_of_kind(kind);
                let of_indices = place(indices.buffer_view, indices.byte_offset, some, size as u64)?;
                Some((some, (of_indices, size), place(values.buffer_view, values.byte_offset, some, whole)?))
            }
        };
        let place = match accessor.buffer_view {
            Some(view) => Some(place(view, accessor.byte_offset, count, whole)?),
            // Zeros take no bytes, so nothing else bounds their number.
            None if sparse.is_some() && count > MOST_ZEROS => {
                let reason = format!("{count} values without bytes; expected at most {MOST_ZEROS}");
                return Err(self.error(at(), reason));
            }
            None if sparse.is_some() => None,
            None => return Err(self.error(at(), "it has no values")),
        };
        Ok(Values { place, count, kind: component_type, size, normalized: accessor.normalized, sparse })
    }

    /// Returns where `count` values of `whole` bytes each lie, checked to be within their view and their buffer.
    fn place(&self, view: u32, offset: u64, count: u64, whole: u64) -> Result<ValuePlace, String> {
        let of_number = self.structure.views.get(view as usize);
        let number = view;
        let view = of_number.ok_or_else(|| format!("there is no view {number}"))?;
        let buffer = view.buffer as usize;
        let bytes = self.buffers.len(buffer).ok_or_else(|| format!("there is no buffer {buffer}"))?;
        let view_end = view.byte_offset.saturating_add(view.byte_length);
        if view_end > bytes {
            return Err(format!(
                "its view {number} reaches to byte {view_end} of buffer {buffer}, which states {bytes} bytes; write the \
                 file again"
            ));
        }
        // A stride of zero means tightly packed.
        let stride = view.byte_stride.map_or(0, u64::from);
        let stride = if stride == 0 { whole } else { stride };
        if stride < whole {
            return Err(format!(
                "its view {number} has values {stride} bytes apart; expected {whole} or more; write the file again"
            ));
        }
        let start = view.byte_offset.checked_add(offset);
        let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(whole));
        let end = start.zip(needed).and_then(|(start, needed)| start.checked_add(needed));
        match (start, end) {
            (Some(start), Some(end)) if end <= view_end => Ok(ValuePlace { buffer, start, stride }),
            _ => Err(format!("its {count} values reach beyond the {view_end} bytes that hold them")),
        }
    }

    /// Reads value `number` at a place; zeros if there is no place.
    fn read_at(&mut self, place: Option<ValuePlace>, number: u64, out: &mut [u8]) -> Result<()> {
        match place {
            Some(ValuePlace { buffer, start, stride }) => self.buffers.read(buffer, start + number * stride, out),
            None => {
                out.fill(0);
                Ok(())
            }
        }
    }

    /// Reads the bytes of value `number`, which must exist.
    fn read(&mut self, values: &Values, number: u64, out: &mut [u8]) -> Result<()> {
        let Some((count, (indices, size), others)) = values.sparse else {
            return self.read_at(values.place, number, out);
        };
        let (mut first, mut end) = (0, count);
        while first < end {
            let middle = first + (end - first) / 2;
            let mut index = [0; 4];
            self.read_at(Some(indices), middle, &mut index[..size])?;
            match u64::from(u32::from_le_bytes(index)).cmp(&number) {
                Ordering::Equal => return self.read_at(Some(others), middle, out),
                Ordering::Less => first = middle + 1,
                Ordering::Greater => end = middle,
            }
        }
        self.read_at(values.place, number, out)
    }

    fn index(&mut self, values: &Values, number: u64) -> Result<u64> {
        let mut bytes = [0; 4];
        self.read(values, number, &mut bytes[..values.size])?;
        Ok(u64::from(u32::from_le_bytes(bytes)))
    }

    /// Reads the components of value `number`, which must exist.
    fn numbers<const N: usize>(&mut self, values: &Values, number: u64) -> Result<[f64; N]> {
        let mut bytes = [0; 16];
        let size = values.size;
        self.read(values, number, &mut bytes[..N * size])?;
        let (kind, normalized) = (values.kind, values.normalized);
        Ok(std::array::from_fn(|k| component(kind, normalized, &bytes[k * size..(k + 1) * size])))
    }

    fn position(&mut self, values: &Values, number: u64) -> Result<[f64; 3]> {
        if number >= values.count {
            return Err(self.error("indices", format!("there is no corner {number}: the part has {}", values.count)));
        }
        self.numbers(values, number)
    }

    /// Reads the components of a value for colours; `None` if there is no such value.
    fn shares<const N: usize>(&mut self, values: &Values, number: u64) -> Result<Option<[f32; N]>> {
        if number >= values.count {
            return Ok(None);
        }
        self.numbers(values, number).map(|numbers| Some(numbers.map(|value| value as f32)))
    }

    /// Returns the instances of a node.
    fn copies(&self, number: usize) -> Result<Copies> {
        let Instances { translation, rotation, scale } = self.structure.instances[number];
        let values = |of: Option<u32>, shape, kinds| of.map(|of| self.values(of as usize, shape, kinds)).transpose();
        let translation = values(translation, AccessorShape::Vec3, &[F32])?;
        let rotation = values(rotation, AccessorShape::Vec4, &[F32, I8, I16])?;
        let scale = values(scale, AccessorShape::Vec3, &[F32])?;
        let mut counts = [translation, rotation, scale].into_iter().flatten().map(|values| values.count);
        // Instances with attributes of other kinds alone all lie at the node.
        let count = counts.next().unwrap_or(1);
        if counts.any(|other| other != count) {
            return Err(self.error("structure", "places, turns and sizes of the instances of a node differ in number"));
        }
        Ok(Copies { translation, rotation, scale, count })
    }

    /// Returns the transform of one instance within its node.
    fn copy(&mut self, copies: &Copies, number: u64) -> Result<Matrix4<f64>> {
        let mut part = |values: Option<Values>| values.map(|values| self.numbers::<3>(&values, number)).transpose();
        let (translation, scale) = (part(copies.translation)?, part(copies.scale)?);
        let rotation = copies.rotation.map(|values| self.numbers::<4>(&values, number)).transpose()?;
        let rotation = rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        Ok(placed(translation.unwrap_or_default(), rotation, scale.unwrap_or([1.0; 3])))
    }

    /// Reads a triangle and its paint.
    fn triangle(
        &mut self,
        part: &PlacedPrimitive,
        number: u64,
        colours: Option<&PartColours>,
    ) -> Result<([[f64; 3]; 3], Paint)> {
        let mut triangle = [[0.0; 3]; 3];
        let mut numbers = part.corners(number);
        for (corner, number) in triangle.iter_mut().zip(&mut numbers) {
            if let Some(indices) = &part.indices {
                *number = self.index(indices, *number)?;
            }
            let at = self.position(&part.positions, *number)?;
            *corner = part.place.transform_point(&Point3::from(at)).into();
        }
        let paint = colours.map(|colours| self.paint(colours, numbers)).transpose()?;
        Ok((triangle, paint.unwrap_or_default()))
    }

    fn paint(&mut self, part: &PartColours, numbers: [u64; 3]) -> Result<Paint> {
        let Coat { factor, texture, placing, .. } = &part.coat;
        let mut tints = [*factor; 3];
        if let Some(values) = &part.colours {
            for (tint, number) in tints.iter_mut().zip(numbers) {
                if let Some(colour) = self.shares::<3>(values, number)? {
                    *tint = multiplied(*tint, colour.map(from_linear));
                }
            }
        }
        if let (Some(texture), Some(values)) = (texture, &part.places) {
            let mut places = [[0.0; 2]; 3];
            for (place, number) in places.iter_mut().zip(numbers) {
                *place = placing.of(self.shares::<2>(values, number)?.unwrap_or_default().map(f64::from));
            }
            return Ok(Paint::Texture { texture: texture.clone(), places, tints });
        }
        Ok(if part.colours.is_some() { Paint::Corners(tints) } else { Paint::Flat(*factor) })
    }

    /// Returns the colour source of a primitive; `None` if it has no colours. Warns of those that cannot be used.
    fn colours(&mut self, number: usize, materials: &mut Materials, watch: &Watch) -> Result<Option<PartColours>> {
        let primitive: Primitive = self.structure.primitives[number];
        let coat = match primitive.material() {
            Some(material) => materials.coat(material, &self.structure, &mut self.buffers, watch)?,
            None => None,
        };
        // Triangles do not need colours, so those that cannot be used are warnings.
        let mut usable = |values: Option<Result<Values>>| match values.transpose() {
            Err(Error::Input { at, reason, .. }) => {
                materials.warn(watch, &format!("{at}: {reason}; its triangles get the colour of their material"));
                Ok(None)
            }
            values => values,
        };
        let kinds = [F32, U8, U16];
        let of_corners = |of: usize| match self.structure.accessors.get(of).map(|accessor| accessor.shape) {
            Some(AccessorShape::Vec4) => self.values(of, AccessorShape::Vec4, &kinds),
            _ => self.values(of, AccessorShape::Vec3, &kinds),
        };
        let colours = usable(primitive.colours().map(of_corners))?;
        // Integer colours are normalized, whether the file says so or not.
        let colours = colours.map(|values| Values { normalized: true, ..values });
        if coat.is_none() && colours.is_none() {
            return Ok(None);
        }
        let coat = coat.unwrap_or(Coat::of_factor(WHITE));
        let kinds = [F32, U8, U16, I8, I16];
        let missing = || {
            let reason = "a part has a texture whose coordinates are missing, or of a set other than 0 and 1";
            self.error(format!("TEXCOORD_{}", coat.set), reason)
        };
        let places = coat.texture.is_some().then(|| {
            let of = primitive.places(coat.set).ok_or_else(missing)?;
            self.values(of, AccessorShape::Vec2, &kinds)
        });
        let places = usable(places)?;
        Ok(Some(PartColours { coat, places, colours }))
    }

    /// Returns the transform of a node; a matrix excludes the other properties (glTF 2.0, section 3.5.3).
    fn matrix(&self, transform: Option<usize>) -> Matrix4<f64> {
        match transform.map(|number| self.structure.transforms[number]) {
            None => Matrix4::identity(),
            Some(NodeTransform::Matrix(matrix)) => Matrix4::from_iterator(matrix),
            Some(NodeTransform::Parts { translation, rotation, scale }) => placed(translation, rotation, scale),
        }
    }
}

/// Bytes of a component.
fn size_of_kind(kind: u32) -> usize {
    match kind {
        I8 | U8 => 1,
        I16 | U16 => 2,
        _ => 4,
    }
}

/// Decodes a component; normalized integers stand for fractions of their greatest value (glTF 2.0, section 3.6.2.2).
fn component(kind: u32, normalized: bool, bytes: &[u8]) -> f64 {
    let bits = bytes.iter().rev().fold(0, |bits, byte| bits << 8 | u32::from(*byte));
    let (value, greatest) = match kind {
        I8 => (f64::from(bits as u8 as i8), 127.0),
        U8 => (f64::from(bits), 255.0),
        I16 => (f64::from(bits as u16 as i16), 32_767.0),
        U16 => (f64::from(bits), 65_535.0),
        _ => return f64::from(f32::from_bits(bits)),
    };
    if normalized { (value / greatest).max(-1.0) } else { value }
}

/// Returns the transform that scales, then rotates, then translates.
fn placed(translation: [f64; 3], [x, y, z, w]: [f64; 4], scale: [f64; 3]) -> Matrix4<f64> {
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Matrix4::new_translation(&Vector3::from(translation))
        * turn.to_homogeneous()
        * Matrix4::new_nonuniform_scaling(&Vector3::from(scale))
}

impl Traversal {
    fn new(checked: &Checked) -> Self {
        let roots = Level { nodes: 0..checked.roots.len(), above: Matrix4::identity() };
        Self { levels: vec![roots], ..Self::default() }
    }

    /// Returns the next primitive, through nodes that were checked; `None` after the last.
    fn next(&mut self, checked: &mut Checked, watch: &mut Watch) -> Result<Option<PlacedPrimitive>> {
        loop {
            watch.step()?;
            if let Some(number) = self.primitives.next() {
                match checked.part(number, self.place)? {
                    Some(part) => return Ok(Some(part)),
                    None => continue,
                }
            }
            if let Some(copies) = self.copies.filter(|copies| self.copy < copies.count) {
                self.place = self.node.1 * checked.copy(&copies, self.copy)?;
                self.primitives = self.node.0.clone();
                self.copy += 1;
                continue;
            }
            let Structure { nodes, children, .. } = &checked.structure;
            let depth = self.levels.len();
            let Some(level) = self.levels.last_mut() else { return Ok(None) };
            let list = if depth == 1 { &checked.roots[..] } else { children.numbers() };
            let Some(number) = level.nodes.next().map(|at| list[at] as usize) else {
                self.levels.pop();
                continue;
            };
            let node = nodes[number];
            self.place = level.above * checked.matrix(node.transform());
            self.primitives = node.mesh().and_then(|mesh| checked.structure.mesh(mesh)).unwrap_or_default();
            self.levels.push(Level { nodes: children.range(number), above: self.place });
            (self.copies, self.copy) = (node.instances().map(|of| checked.copies(of)).transpose()?, 0);
            if self.copies.is_some() {
                self.node = (std::mem::take(&mut self.primitives), self.place);
            }
        }
    }
}

impl Triangles for GltfReader {
    fn read(&mut self, out: &mut MeshBatch, watch: &mut Watch) -> Result<bool> {
        while out.len() < BATCH_TRIANGLES {
            let part = match &self.primitive {
                Some(part) if self.triangle < part.len() => *part,
                _ => {
                    (self.primitive, self.triangle) = (self.traversal.next(&mut self.checked, watch)?, 0);
                    if let Some(part) = &self.primitive {
                        let materials = self.materials.as_mut();
                        let colours = materials.map(|all| self.checked.colours(part.number, all, watch)).transpose()?;
                        self.colours = colours.flatten();
                        continue;
                    }
                    return match self.checked.buffers.changed() {
                        Some(path) => {
                            let reason = format!("{} changed while it was read", path.display());
                            watch.lose(1, self.checked.error("buffers", reason)).map(|()| false)
                        }
                        None => Ok(false),
                    };
                }
            };
            watch.step()?;
            match self.checked.triangle(&part, self.triangle, self.colours.as_ref()) {
                Ok((triangle, paint)) => out.push(triangle, paint),
                Err(error) => watch.lose(1, error)?,
            }
            self.triangle += 1;
        }
        Ok(true)
    }
}

/// Reads the structure (JSON) of a file, and locates the binary chunk of a `.glb`.
fn read_structure(
    path: &Path,
    most_bytes: u64,
    digest: &Digest,
    watch: &mut Watch,
) -> Result<(Vec<u8>, Option<BinaryPart>)> {
    let io = |e| Error::io(path, "read the structure", e);
    let mut file = MeshSource::open(path, digest)?;
    let bytes = file.len();
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
        let what = format!("{}: structure (bytes)", path.display());
        return Err(Error::limit(what, len, most_bytes).with_suggestion(Parameter::Memory));
    }
    let mut json = Vec::with_capacity(len as usize);
    file.seek(SeekFrom::Start(start)).map_err(io)?;
    Read::by_ref(&mut file).take(len).read_to_end(&mut json).map_err(io)?;
    if !binary {
        return Ok((json, None));
    }
    let mut next = Vec::new();
    file.take(8).read_to_end(&mut next).map_err(io)?;
    let chunk = next.get(4..) == Some(b"BIN\0");
    let stated = next.first_chunk().map_or(0, |bytes| u64::from(u32::from_le_bytes(*bytes)));
    let (whole, at) = (word(8), start + len + 8);
    if chunk && at + stated > whole {
        let reason = format!(
            "it states {whole} bytes, and its binary part reaches to byte {}: one of them is damaged; write it again",
            at + stated
        );
        watch.lose(0, Error::input(path, "header, byte 8", reason))?;
    }
    // Not hashed: what follows is no part of the model.
    let mut behind = BufReader::new(MeshSource::open(path, &Digest::new(false))?);
    behind.seek(SeekFrom::Start(whole)).map_err(io)?;
    if !only_padding(&mut behind).map_err(io)? {
        let reason = format!("it states {whole} bytes, and {} follow; write it again", counted(bytes - whole, "byte"));
        watch.lose(0, Error::input(path, "header, byte 8", reason))?;
    }
    Ok((json, chunk.then(|| (at, stated.min(bytes.saturating_sub(at))))))
}
