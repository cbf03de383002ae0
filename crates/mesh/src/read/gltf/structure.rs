//! Structure of a glTF file: the part of its JSON that triangles need, in a few bytes per item, because files may hold
//! millions of empty ones. References are checked where they are used.

use crate::input::gltf::{is_harmless, moves};
use crate::read::placing::Placing;
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::borrow::Cow;
use std::cell::Cell;
use std::marker::PhantomData;

/// Marks an absent number.
const NONE: u32 = u32::MAX;
/// Substring of the names of extensions for Gaussian splats.
pub const SPLATS: &str = "gaussian_splatting";

/// Lists of numbers, stored back to back.
#[derive(Debug, Default)]
pub struct Lists {
    ends: Vec<u32>,
    numbers: Vec<u32>,
}

impl Lists {
    /// Number of lists.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Returns where the numbers of list `index` stand.
    pub fn range(&self, index: usize) -> std::ops::Range<usize> {
        let begin = index.checked_sub(1).map_or(0, |before| self.ends[before]);
        begin as usize..self.ends[index] as usize
    }

    /// All numbers of all lists.
    pub fn numbers(&self) -> &[u32] {
        &self.numbers
    }

    fn add(&mut self, list: &[u32], budget: &Budget) -> Result<(), Refusal> {
        budget.take::<u32>()?;
        list.iter().try_for_each(|_| budget.take::<u32>())?;
        self.numbers.extend(list);
        self.ends.push(self.numbers.len() as u32);
        Ok(())
    }
}

/// Transform of a node.
#[derive(Debug, Clone, Copy)]
pub enum NodeTransform {
    Matrix([f64; 16]),
    Parts { translation: [f64; 3], rotation: [f64; 4], scale: [f64; 3] },
}

/// A node without its children.
#[derive(Debug, Clone, Copy)]
pub struct Node {
    mesh: u32,
    transform: u32,
    instances: u32,
}

/// Accessors of the transforms in which a node repeats its mesh.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(default, rename_all = "UPPERCASE")]
pub struct Instances {
    pub translation: Option<u32>,
    pub rotation: Option<u32>,
    pub scale: Option<u32>,
}

impl Instances {
    /// Accessors of the transforms.
    pub fn accessors(&self) -> impl Iterator<Item = usize> + use<> {
        [self.translation, self.rotation, self.scale].into_iter().flatten().map(|of| of as usize)
    }
}

impl Node {
    /// Number of its mesh.
    pub fn mesh(&self) -> Option<usize> {
        (self.mesh != NONE).then_some(self.mesh as usize)
    }

    /// Number of its instances.
    pub fn instances(&self) -> Option<usize> {
        some(self.instances)
    }

    /// Number of its transform.
    pub fn transform(&self) -> Option<usize> {
        (self.transform != NONE).then_some(self.transform as usize)
    }
}

/// A primitive of a mesh.
#[derive(Debug, Clone, Copy)]
pub struct Primitive {
    positions: u32,
    indices: u32,
    material: u32,
    colours: u32,
    /// Texture coordinates, of the first two sets.
    places: [u32; 2],
    pub mode: u8,
    /// True if it is compressed by Draco; uncompressed values may be present as well.
    pub is_draco: bool,
}

fn some(number: u32) -> Option<usize> {
    (number != NONE).then_some(number as usize)
}

impl Primitive {
    /// Accessor of its positions.
    pub fn positions(&self) -> Option<usize> {
        some(self.positions)
    }

    /// Accessor of its indices.
    pub fn indices(&self) -> Option<usize> {
        some(self.indices)
    }

    /// Its material.
    pub fn material(&self) -> Option<usize> {
        some(self.material)
    }

    /// Accessor of its vertex colours.
    pub fn colours(&self) -> Option<usize> {
        some(self.colours)
    }

    /// Accessor of texture coordinate set `set`.
    pub fn places(&self, set: u32) -> Option<usize> {
        self.places.get(set as usize).copied().and_then(some)
    }

    /// Accessors of its positions and indices, and of its colours and texture coordinates if `has_colours`.
    pub fn accessors(&self, has_colours: bool) -> impl Iterator<Item = usize> + use<> {
        let [first, second] = self.places;
        let of_colours = [self.colours, first, second].into_iter().filter(move |_| has_colours);
        [self.positions, self.indices].into_iter().chain(of_colours).filter_map(some)
    }
}

/// Shape of the values of an accessor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AccessorShape {
    Scalar,
    Vec2,
    Vec3,
    Vec4,
    Other,
}

/// Typed values in a view.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Accessor {
    pub buffer_view: Option<u32>,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
    pub count: u64,
    #[serde(rename = "type", deserialize_with = "shape")]
    pub shape: AccessorShape,
    #[serde(default)]
    pub normalized: bool,
    pub sparse: Option<Sparse>,
}

/// Values of an accessor that replace those in its view.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Sparse {
    pub count: u64,
    pub indices: SparsePart,
    pub values: SparsePart,
}

/// Location of the sparse indices or of the sparse values.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct SparsePart {
    pub buffer_view: u32,
    #[serde(default)]
    pub byte_offset: u64,
    /// Of the indices only.
    #[serde(default)]
    pub component_type: u32,
}

/// Range of a buffer.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct BufferView {
    pub buffer: u32,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: Option<u32>,
}

/// Bytes, in the file or elsewhere.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Buffer<'a> {
    pub byte_length: u64,
    #[serde(borrow)]
    pub uri: Option<Cow<'a, str>>,
    #[serde(default)]
    pub extensions: BufferExtensions,
}

/// Presence of meshopt compression: the buffer stands in for a compressed one.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(default)]
pub struct BufferExtensions {
    #[serde(rename = "EXT_meshopt_compression", alias = "KHR_meshopt_compression", deserialize_with = "is_there")]
    pub is_meshopt: bool,
}

#[derive(Debug, Default, Deserialize)]
struct Asset<'a> {
    #[serde(borrow)]
    version: Cow<'a, str>,
}

/// Parsed contents of a file. Numbers are those of the file and may refer to missing items.
#[derive(Debug, Default)]
pub struct Structure<'a> {
    pub version: Cow<'a, str>,
    /// A required extension without which the triangles would be wrong: one for splats if there is one, else the first.
    pub extension_needed: Option<Cow<'a, str>>,
    pub scene: Option<u32>,
    /// Root nodes by scene.
    pub scenes: Lists,
    pub nodes: Vec<Node>,
    /// Children by node.
    pub children: Lists,
    pub transforms: Vec<NodeTransform>,
    pub instances: Vec<Instances>,
    /// All primitives; `meshes` holds the end of each mesh's range.
    pub primitives: Vec<Primitive>,
    meshes: Vec<u32>,
    pub accessors: Vec<Accessor>,
    pub views: Vec<BufferView>,
    pub buffers: Vec<Buffer<'a>>,
    pub materials: Vec<Material>,
    pub textures: Vec<TextureOf>,
    pub images: Vec<ImageOf<'a>>,
    pub samplers: Vec<Sampler>,
}

/// Material of a primitive.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Material {
    #[serde(rename = "pbrMetallicRoughness")]
    pub base: Base,
}

/// Colour of a material.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Base {
    /// Linear light.
    pub base_color_factor: [f32; 4],
    pub base_color_texture: Option<TextureName>,
}

impl Default for Base {
    fn default() -> Self {
        Self { base_color_factor: [1.0; 4], base_color_texture: None }
    }
}

/// Reference to a texture, with its set of texture coordinates.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct TextureName {
    pub index: u32,
    #[serde(default)]
    tex_coord: u32,
    #[serde(default)]
    extensions: TextureExtensions,
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(default)]
struct TextureExtensions {
    #[serde(rename = "KHR_texture_transform")]
    transform: Option<TextureTransform>,
}

/// Transform of texture coordinates, and maybe another set of them.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct TextureTransform {
    offset: [f64; 2],
    rotation: f64,
    scale: [f64; 2],
    tex_coord: Option<u32>,
}

impl Default for TextureTransform {
    fn default() -> Self {
        Self { offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2], tex_coord: None }
    }
}

impl TextureName {
    /// Returns the set of texture coordinates.
    pub fn set(&self) -> u32 {
        self.extensions.transform.and_then(|transform| transform.tex_coord).unwrap_or(self.tex_coord)
    }

    /// Returns the transform of the texture coordinates.
    pub fn placing(&self) -> Placing {
        let transform = self.extensions.transform;
        transform.map_or_else(Placing::default, |TextureTransform { offset, rotation, scale, .. }| {
            Placing::of_gltf(offset, rotation, scale)
        })
    }
}

/// An image and its sampler.
#[derive(Debug, Clone, Copy, Deserialize)]
pub struct TextureOf {
    pub source: Option<u32>,
    pub sampler: Option<u32>,
}

/// Location of an image.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct ImageOf<'a> {
    #[serde(borrow)]
    pub uri: Option<Cow<'a, str>>,
    pub buffer_view: Option<u32>,
}

/// Wrap modes of a texture, by number.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Sampler {
    pub wrap_s: Option<u32>,
    pub wrap_t: Option<u32>,
}

impl<'a> Structure<'a> {
    /// Parses `json` using at most `most_bytes` of memory besides the text. Skips materials unless `colours` is set.
    pub fn parse(json: &'a [u8], most_bytes: u64, colours: bool) -> Result<Self, serde_json::Error> {
        let mut reader = serde_json::Deserializer::from_slice(json);
        let structure = Root(&Budget(Cell::new(most_bytes)), colours).deserialize(&mut reader)?;
        reader.end()?;
        Ok(structure)
    }

    /// Drops the fields that borrow from the text: version, extension, buffers and images.
    pub fn without_text(self) -> Structure<'static> {
        let Self { scene, scenes, nodes, children, transforms, primitives, meshes, accessors, views, .. } = self;
        let Self { instances, materials, textures, samplers, .. } = self;
        let (version, extension_needed, buffers, images) = Default::default();
        Structure {
            version,
            extension_needed,
            scene,
            scenes,
            nodes,
            children,
            transforms,
            instances,
            primitives,
            meshes,
            accessors,
            views,
            buffers,
            materials,
            textures,
            images,
            samplers,
        }
    }

    /// Returns the range of the primitives of a mesh.
    pub fn mesh(&self, number: usize) -> Option<std::ops::Range<usize>> {
        let end = *self.meshes.get(number)?;
        let begin = number.checked_sub(1).map_or(0, |before| self.meshes[before]);
        Some(begin as usize..end as usize)
    }
}

/// Reason for aborting the parse.
type Refusal = &'static str;

/// Bytes of memory left.
struct Budget(Cell<u64>);

impl Budget {
    /// Reserves bytes for one more `T`: twice its size, because a growing vector is in memory twice for a moment.
    fn take<T>(&self) -> Result<(), Refusal> {
        let left = self.0.get().checked_sub(2 * size_of::<T>() as u64);
        self.0.set(left.ok_or("its structure takes more than its share of the memory budget; give more memory")?);
        Ok(())
    }
}

fn shape<'de, D: Deserializer<'de>>(value: D) -> Result<AccessorShape, D::Error> {
    Ok(match &*Cow::<str>::deserialize(value)? {
        "SCALAR" => AccessorShape::Scalar,
        "VEC2" => AccessorShape::Vec2,
        "VEC3" => AccessorShape::Vec3,
        "VEC4" => AccessorShape::Vec4,
        _ => AccessorShape::Other,
    })
}

fn is_there<'de, D: Deserializer<'de>>(value: D) -> Result<bool, D::Error> {
    IgnoredAny::deserialize(value).map(|_| true)
}

fn no_number() -> u32 {
    NONE
}

fn triangles() -> u8 {
    super::TRIANGLES
}

/// A nested list of bounded length.
struct Bounded<T>(Vec<T>);

impl<T> Default for Bounded<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Bounded<T> {
    fn deserialize<D: Deserializer<'de>>(list: D) -> Result<Self, D::Error> {
        let mut all = Vec::new();
        let put = |item| {
            all.push(item);
            if all.len() > MOST_IN_LIST { Err("a list of more than 1048576 things") } else { Ok(()) }
        };
        fill(put).deserialize(list)?;
        Ok(Self(all))
    }
}

/// Most elements of a [`Bounded`] list.
const MOST_IN_LIST: usize = 1 << 20;

/// Passes the elements of a list to a function, one at a time.
struct Fill<F, T>(F, PhantomData<T>);

fn fill<T, F: FnMut(T) -> Result<(), Refusal>>(put: F) -> Fill<F, T> {
    Fill(put, PhantomData)
}

impl<'de, T: Deserialize<'de>, F: FnMut(T) -> Result<(), Refusal>> DeserializeSeed<'de> for Fill<F, T> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, list: D) -> Result<(), D::Error> {
        list.deserialize_seq(self)
    }
}

impl<'de, T: Deserialize<'de>, F: FnMut(T) -> Result<(), Refusal>> Visitor<'de> for Fill<F, T> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<(), A::Error> {
        while let Some(item) = list.next_element()? {
            (self.0)(item).map_err(A::Error::custom)?;
        }
        Ok(())
    }
}

#[derive(Deserialize)]
struct SceneText {
    #[serde(default)]
    nodes: Bounded<u32>,
}

#[derive(Deserialize)]
struct NodeText {
    #[serde(default = "no_number")]
    mesh: u32,
    #[serde(default)]
    children: Bounded<u32>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
    #[serde(default)]
    extensions: NodeExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    instancing: Option<InstancingText>,
}

#[derive(Deserialize)]
struct InstancingText {
    attributes: Instances,
}

impl NodeText {
    fn transform(&self) -> Option<NodeTransform> {
        if let Some(matrix) = self.matrix {
            return Some(NodeTransform::Matrix(matrix));
        }
        (self.translation.is_some() || self.rotation.is_some() || self.scale.is_some()).then_some(
            NodeTransform::Parts {
                translation: self.translation.unwrap_or_default(),
                rotation: self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]),
                scale: self.scale.unwrap_or([1.0; 3]),
            },
        )
    }
}

#[derive(Deserialize)]
struct MeshText {
    primitives: Bounded<PrimitiveText>,
}

#[derive(Deserialize)]
struct PrimitiveText {
    attributes: Attributes,
    #[serde(default = "no_number")]
    indices: u32,
    #[serde(default = "triangles")]
    mode: u8,
    #[serde(default = "no_number")]
    material: u32,
    #[serde(default)]
    extensions: PrimitiveExtensions,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(default)]
struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression", deserialize_with = "is_there")]
    is_draco: bool,
}

#[derive(Clone, Copy, Deserialize)]
struct Attributes {
    #[serde(rename = "POSITION", default = "no_number")]
    position: u32,
    #[serde(rename = "COLOR_0", default = "no_number")]
    colour: u32,
    #[serde(rename = "TEXCOORD_0", default = "no_number")]
    first_places: u32,
    #[serde(rename = "TEXCOORD_1", default = "no_number")]
    second_places: u32,
}

#[derive(Deserialize)]
#[serde(field_identifier, rename_all = "camelCase")]
enum Key {
    Asset,
    ExtensionsRequired,
    ExtensionsUsed,
    Scene,
    Scenes,
    Nodes,
    Meshes,
    Accessors,
    BufferViews,
    Buffers,
    Materials,
    Textures,
    Images,
    Samplers,
    #[serde(other)]
    Other,
}

/// Reads the whole document, with or without materials.
struct Root<'b>(&'b Budget, bool);

impl<'de> DeserializeSeed<'de> for Root<'_> {
    type Value = Structure<'de>;

    fn deserialize<D: Deserializer<'de>>(self, root: D) -> Result<Self::Value, D::Error> {
        root.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Root<'_> {
    type Value = Structure<'de>;

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (Self(budget, colours), mut all) = (self, Structure::default());
        let (mut version, mut required, mut used) = (None, Vec::<Cow<str>>::new(), Vec::<Cow<str>>::new());
        while let Some(key) = map.next_key()? {
            match key {
                Key::Asset => version = Some(map.next_value::<Asset>()?.version),
                Key::ExtensionsRequired => required = map.next_value::<Bounded<Cow<str>>>()?.0,
                Key::ExtensionsUsed => used = map.next_value::<Bounded<Cow<str>>>()?.0,
                Key::Scene => all.scene = Some(map.next_value()?),
                Key::Scenes => {
                    let scenes = &mut all.scenes;
                    map.next_value_seed(fill(|scene: SceneText| scenes.add(&scene.nodes.0, budget)))?;
                }
                Key::Nodes => map.next_value_seed(fill(|node| all.add_node(&node, budget)))?,
                Key::Meshes => map.next_value_seed(fill(|mesh| all.add_mesh(&mesh, budget)))?,
                Key::Accessors => map.next_value_seed(fill(push(&mut all.accessors, budget)))?,
                Key::BufferViews => map.next_value_seed(fill(push(&mut all.views, budget)))?,
                Key::Buffers => map.next_value_seed(fill(push(&mut all.buffers, budget)))?,
                Key::Materials if colours => map.next_value_seed(fill(push(&mut all.materials, budget)))?,
                Key::Textures if colours => map.next_value_seed(fill(push(&mut all.textures, budget)))?,
                Key::Images if colours => map.next_value_seed(fill(push(&mut all.images, budget)))?,
                Key::Samplers if colours => map.next_value_seed(fill(push(&mut all.samplers, budget)))?,
                Key::Materials | Key::Textures | Key::Images | Key::Samplers | Key::Other => {
                    let IgnoredAny = map.next_value()?;
                }
            }
        }
        all.version = version.ok_or_else(|| A::Error::missing_field("asset"))?;
        required.retain(|name| !is_harmless(name));
        required.extend(used.into_iter().filter(|name| moves(name)));
        let splats = required.iter().position(|name| name.contains(SPLATS));
        all.extension_needed = required.into_iter().nth(splats.unwrap_or(0));
        Ok(all)
    }
}

/// Returns a function that appends to `all`.
fn push<T>(all: &mut Vec<T>, budget: &Budget) -> impl FnMut(T) -> Result<(), Refusal> {
    |item| {
        budget.take::<T>()?;
        all.push(item);
        Ok(())
    }
}

impl Structure<'_> {
    fn add_node(&mut self, node: &NodeText, budget: &Budget) -> Result<(), Refusal> {
        budget.take::<Node>()?;
        let mut transform = NONE;
        if let Some(of_node) = node.transform() {
            budget.take::<NodeTransform>()?;
            transform = self.transforms.len() as u32;
            self.transforms.push(of_node);
        }
        let mut instances = NONE;
        if let Some(of_node) = &node.extensions.instancing {
            budget.take::<Instances>()?;
            instances = self.instances.len() as u32;
            self.instances.push(of_node.attributes);
        }
        self.nodes.push(Node { mesh: node.mesh, transform, instances });
        self.children.add(&node.children.0, budget)
    }

    fn add_mesh(&mut self, mesh: &MeshText, budget: &Budget) -> Result<(), Refusal> {
        budget.take::<u32>()?;
        for &PrimitiveText { attributes, indices, mode, material, extensions } in &mesh.primitives.0 {
            budget.take::<Primitive>()?;
            let Attributes { position: positions, colour: colours, first_places, second_places } = attributes;
            let places = [first_places, second_places];
            let PrimitiveExtensions { is_draco } = extensions;
            self.primitives.push(Primitive { positions, indices, material, colours, places, mode, is_draco });
        }
        self.meshes.push(self.primitives.len() as u32);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_triangles_need_is_kept_and_the_rest_is_passed_over() {
        let json = br#"{"asset":{"version":"2.0","generator":"x"},"scenes":[{},{"nodes":[1,0]}],"scene":1,"cameras":[{"a":[1]}],
            "nodes":[{},{"mesh":3,"children":[0],"scale":[1,2,3],"extras":{}},{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}],
            "meshes":[{"primitives":[]},{"primitives":[{"attributes":{"POSITION":7,"NORMAL":8},"material":1},
            {"attributes":{},"indices":2,"mode":5}]}],"bufferViews":[{"buffer":0,"byteLength":9}],
            "accessors":[{"bufferView":0,"componentType":5126,"count":2,"type":"VEC3","sparse":{"count":1,
            "indices":{"bufferView":1,"componentType":5123},"values":{"bufferView":2,"byteOffset":4}}}],
            "buffers":[{"byteLength":9,"uri":"a\u0041"}]}"#;
        let all = Structure::parse(json, 1 << 20, true).unwrap();
        assert_eq!((&*all.version, all.scene, all.extension_needed.is_some()), ("2.0", Some(1), false));
        assert_eq!(&all.scenes.numbers()[all.scenes.range(1)], [1, 0]);
        assert_eq!((all.scenes.len(), all.scenes.range(0).len(), all.children.range(1)), (2, 0, 0..1));
        assert_eq!((all.nodes[1].mesh(), all.nodes[0].mesh(), all.nodes[2].transform()), (Some(3), None, Some(1)));
        assert!(matches!(all.transforms[0], NodeTransform::Parts { scale: [1.0, 2.0, 3.0], .. }));
        assert_eq!((all.mesh(0), all.mesh(1), all.mesh(2)), (Some(0..0), Some(0..2), None));
        let [one, other] = all.primitives[..] else { panic!() };
        assert_eq!((one.positions(), one.indices(), one.mode), (Some(7), None, 4));
        assert_eq!((other.positions(), other.indices(), other.mode), (None, Some(2), 5));
        let sparse = all.accessors[0].sparse.unwrap();
        assert_eq!((sparse.count, sparse.indices.component_type, sparse.values.byte_offset), (1, 5123, 4));
        assert!(all.accessors[0].shape == AccessorShape::Vec3);
        assert_eq!(all.buffers[0].uri.as_deref(), Some("aA"));
    }

    #[test]
    fn millions_of_empty_things_are_refused_and_not_held() {
        for list in ["nodes", "scenes"] {
            let json = format!(r#"{{"asset":{{"version":"2.0"}},"{list}":[{}{{}}]}}"#, "{},".repeat(2_000_000));
            let error = Structure::parse(json.as_bytes(), 8 << 20, false).unwrap_err().to_string();
            assert!(error.contains("give more memory"), "{error}");
            assert!(Structure::parse(json.as_bytes(), 128 << 20, false).is_ok());
        }
        let json = format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"children":[{}1]}}]}}"#, "1,".repeat(2_000_000));
        assert!(Structure::parse(json.as_bytes(), 1 << 30, false).is_err());
    }
}
