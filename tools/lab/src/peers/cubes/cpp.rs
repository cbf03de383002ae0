//! Peers in C++, behind the functions of `peer.h`.

use super::matter::{Matter, Mesh};
use super::peer::Peer;
use super::questions::{Kind, Questions};
use crate::peers::native::Recipe;
use crate::stability::Result;
use nalgebra::{Point3, Vector2};
use std::ffi::{CStr, c_char, c_int, c_void};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

const HEADER: &str = include_str!("../../../native/peer.h");
/// Folder of JoltPhysics, with the library that its own build script makes.
pub const JOLT: &str = "SLICEWALK_JOLT";

/// Cubes and their mesh: `Matter` of `peer.h`.
#[repr(C)]
struct Input {
    cubes: *const [i32; 3],
    cube_count: usize,
    edge: f64,
    vertices: *const [f32; 3],
    vertex_count: usize,
    triangles: *const [u32; 3],
    triangle_count: usize,
}

type Walk = unsafe extern "C" fn(*const c_void, *const f64, *const f64, f64, f64, f64, usize, *mut [f64; 3], *mut f64);

/// The functions of `peer.h`, and one of `jolt.cc`.
struct Functions {
    build: unsafe extern "C" fn(*const Input) -> *mut c_void,
    free: unsafe extern "C" fn(*mut c_void),
    ask: unsafe extern "C" fn(*const c_void, c_int, *const f64, usize, *mut f64) -> c_int,
    version: unsafe extern "C" fn() -> *const c_char,
    file_bytes: unsafe extern "C" fn(*const c_void, c_int) -> usize,
    memory_bytes: unsafe extern "C" fn(*const c_void) -> usize,
    walk: Option<Walk>,
    /// The functions are its: it stays as long as they do.
    _library: libloading::Library,
}

/// A library behind its functions.
#[derive(Clone)]
pub struct Native {
    /// Name in messages and tables.
    name: &'static str,
    functions: Arc<Functions>,
    files: [Option<&'static str>; 2],
    has_mesh: bool,
}

impl Native {
    /// Embree, for rays.
    pub fn embree() -> Result<Self> {
        let library = embree_library()?;
        let folder = library.parent().unwrap_or(&library).display();
        let recipe = Recipe {
            name: "embree.cc",
            source: include_str!("../../../native/embree.cc"),
            beside: &[("peer.h", HEADER)],
            probe: "",
            missing: "",
            options: &[],
            libraries: &[
                library.display().to_string(),
                format!("-Wl,-rpath,{folder}"),
                // For the library that Embree's threads come from.
                format!("-Wl,-rpath-link,{folder}"),
            ],
        };
        Ok(Self { has_mesh: true, ..Self::load("Embree", &recipe, [None; 2])? })
    }

    /// NanoVDB, for places, boxes and rays.
    pub fn nanovdb() -> Result<Self> {
        let recipe = Recipe {
            name: "nanovdb.cc",
            source: include_str!("../../../native/nanovdb.cc"),
            beside: &[("peer.h", HEADER)],
            probe: "#include <nanovdb/util/OpenToNanoVDB.h>\n",
            missing: "libnanovdb-dev, libopenvdb-dev, libboost-dev and libtbb-dev are not all installed",
            options: &["-DNANOVDB_USE_INTRINSICS".into()],
            libraries: &["-lopenvdb".into(), "-ltbb".into()],
        };
        Self::load("NanoVDB", &recipe, [Some("`.nvdb`"), Some("`.vdb` of OpenVDB, ZIP and active mask")])
    }

    /// Coal, for boxes.
    pub fn coal() -> Result<Self> {
        let prefix = coal_prefix()?;
        let place = |folder: &str| prefix.join(folder).display().to_string();
        let recipe = Recipe {
            name: "coal.cc",
            source: include_str!("../../../native/coal.cc"),
            beside: &[("peer.h", HEADER)],
            probe: "#include <Eigen/Core>\n#include <coal/octree.h>\n",
            missing: "libeigen3-dev is not installed",
            options: &[
                format!("-I{}", place("include")),
                "-I/usr/include/eigen3".into(),
                // Definitions of the package's own pkg-config file.
                "-DCOAL_HAS_OCTOMAP".into(),
                "-DCOAL_HAVE_OCTOMAP".into(),
                "-DOCTOMAP_MAJOR_VERSION=1".into(),
                "-DOCTOMAP_MINOR_VERSION=10".into(),
                "-DOCTOMAP_PATCH_VERSION=0".into(),
            ],
            libraries: &[
                format!("-L{}", place("lib")),
                format!("-Wl,-rpath,{}", place("lib")),
                "-lcoal".into(),
                "-loctomap".into(),
                "-loctomath".into(),
            ],
        };
        Self::load("Coal, octree", &recipe, [None; 2])
    }

    /// Jolt, for boxes, rays, sweeps and walks.
    pub fn jolt() -> Result<Self> {
        let folder = PathBuf::from(std::env::var_os(JOLT).ok_or(format!("{JOLT} names no folder of JoltPhysics"))?);
        let library = folder.join("Build/Linux_Distribution/libJolt.a");
        if !library.is_file() {
            return Err(format!("{} is not there", library.display()).into());
        }
        let features = ["AVX2", "AVX", "SSE4_1", "SSE4_2", "LZCNT", "TZCNT", "F16C", "FMADD"];
        let mut options: Vec<String> = features.iter().map(|name| format!("-DJPH_USE_{name}")).collect();
        // Its own build asks for these; both sides must agree.
        options.extend(["-mavx2", "-mbmi", "-mpopcnt", "-mlzcnt", "-mf16c", "-mfma"].map(String::from));
        options.extend(["-fno-exceptions", "-fno-rtti", "-DJPH_OBJECT_LAYER_BITS=16"].map(String::from));
        options.push(format!("-I{}", folder.display()));
        let recipe = Recipe {
            name: "jolt.cc",
            source: include_str!("../../../native/jolt.cc"),
            beside: &[("peer.h", HEADER)],
            probe: "#include <Jolt/Jolt.h>\n",
            missing: "JoltPhysics has no headers there",
            options: &options,
            libraries: &[library.display().to_string(), "-pthread".into()],
        };
        Ok(Self { has_mesh: true, ..Self::load("Jolt", &recipe, [None; 2])? })
    }

    fn load(name: &'static str, recipe: &Recipe, files: [Option<&'static str>; 2]) -> Result<Self> {
        let library = recipe.load()?;
        // SAFETY: these are the types of the functions of our sources.
        let functions = unsafe {
            Functions {
                build: *library.get(c"peer_build")?,
                free: *library.get(c"peer_free")?,
                ask: *library.get(c"peer_ask")?,
                version: *library.get(c"peer_version")?,
                file_bytes: *library.get(c"peer_file_bytes")?,
                memory_bytes: *library.get(c"peer_memory_bytes")?,
                walk: library.get(c"jolt_walk").ok().map(|walk| *walk),
                _library: library,
            }
        };
        Ok(Self { name, functions: Arc::new(functions), files, has_mesh: false })
    }

    /// Whether it holds triangles.
    pub fn has_mesh(&self) -> bool {
        self.has_mesh
    }

    /// A world of these triangles and cubes; either may be none, where the peer needs only the other.
    pub fn build(&self, cubes: &[[i32; 3]], edge: f64, mesh: &Mesh) -> Result<World> {
        let input = Input {
            cubes: cubes.as_ptr(),
            cube_count: cubes.len(),
            edge,
            vertices: mesh.vertices.as_ptr(),
            vertex_count: mesh.vertices.len(),
            triangles: mesh.triangles.as_ptr(),
            triangle_count: mesh.triangles.len(),
        };
        // SAFETY: as many of each as the counts say; nothing is kept but copies.
        let handle = unsafe { (self.functions.build)(&raw const input) };
        if handle.is_null() {
            return Err(format!("{} could not be built", self.name).into());
        }
        Ok(World { native: self.clone(), handle, questions: Vec::new() })
    }

    /// Builds the world of these cubes, with the questions that will be asked.
    pub fn peer(&self, matter: &Matter, mesh: &Mesh, questions: &Questions) -> Result<World> {
        let mut world = self.build(&matter.cubes, matter.edge, mesh)?;
        world.questions = Kind::ALL.map(|kind| questions.numbers(kind)).into();
        Ok(world)
    }
}

/// Embree's library in the package `embreex` of the virtual environment.
fn embree_library() -> Result<PathBuf> {
    let is_library =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"libembree4"));
    crate::venv::find("embreex", |packages| {
        let files = std::fs::read_dir(packages.join("embreex.libs")).ok()?;
        files.filter_map(|file| Some(file.ok()?.path())).find(is_library)
    })
}

/// Where the package `coal` of the virtual environment has its headers and libraries.
fn coal_prefix() -> Result<PathBuf> {
    crate::venv::find("coal", |packages| {
        let prefix = packages.join("cmeel.prefix");
        prefix.join("include/coal/octree.h").is_file().then_some(prefix)
    })
}

/// World built by a library, and the questions as plain numbers.
pub struct World {
    native: Native,
    handle: *mut c_void,
    /// By kind, in the order of [`Kind::ALL`].
    questions: Vec<Vec<f64>>,
}

impl World {
    /// A walk of `frames` frames of 1/60 s: a capsule of a radius and a height (m) that wants to go with a velocity (m/s),
    /// and climbs steps so high (m). Its feet after each frame, and the time of each (ns); nothing where it cannot walk.
    pub fn walk(
        &self,
        start: Point3<f64>,
        velocity: Vector2<f64>,
        [radius, height]: [f64; 2],
        climb: f64,
        frames: usize,
    ) -> Option<(Vec<[f64; 3]>, Vec<f64>)> {
        let walk = self.native.functions.walk?;
        let (mut feet, mut times) = (vec![[0.0; 3]; frames], vec![0.0; frames]);
        let (start, velocity): ([f64; 3], [f64; 2]) = (start.into(), velocity.into());
        // SAFETY: the handle is that of a world until it is dropped; the place has room for `FRAMES` frames.
        unsafe {
            walk(
                self.handle,
                start.as_ptr(),
                velocity.as_ptr(),
                radius,
                height,
                climb,
                frames,
                feet.as_mut_ptr(),
                times.as_mut_ptr(),
            );
        }
        Some((feet, times))
    }
}

impl Peer for World {
    fn ask(&mut self, kind: Kind, count: usize, answers: &mut Vec<f64>) -> Result<Option<f64>> {
        let (code, numbers) = match kind {
            Kind::Points => (0, 3),
            Kind::RandomBoxes | Kind::WalkBoxes | Kind::RaisedBoxes => (1, 6),
            Kind::Rays => (2, 7),
            Kind::Sweeps => (3, 9),
        };
        let place = Kind::ALL.iter().position(|of| *of == kind).unwrap_or_default();
        let questions = self.questions.get(place).and_then(|all| all.get(..count * numbers));
        let questions = questions.ok_or("a batch exceeds the questions")?;
        answers.clear();
        answers.resize(count, f64::NAN);
        let start = Instant::now();
        // SAFETY: the handle is that of a world until it is dropped; `count` questions are read and answers written.
        let known =
            unsafe { (self.native.functions.ask)(self.handle, code, questions.as_ptr(), count, answers.as_mut_ptr()) };
        Ok((known != 0).then(|| start.elapsed().as_secs_f64()))
    }

    fn version(&self) -> Option<String> {
        // SAFETY: it gives a text that ends with zero and stays.
        Some(unsafe { CStr::from_ptr((self.native.functions.version)()) }.to_string_lossy().into_owned())
    }

    fn files(&self) -> Vec<(&'static str, u64)> {
        // SAFETY: the handle is that of a world until it is dropped.
        let bytes = |which: usize| unsafe { (self.native.functions.file_bytes)(self.handle, which as c_int) } as u64;
        let named = self.native.files.iter().enumerate();
        named.filter_map(|(which, name)| name.map(|name| (name, bytes(which)))).collect()
    }

    fn memory_bytes(&self) -> Option<u64> {
        // SAFETY: as above.
        let bytes = unsafe { (self.native.functions.memory_bytes)(self.handle) } as u64;
        (bytes > 0).then_some(bytes)
    }
}

impl Drop for World {
    fn drop(&mut self) {
        // SAFETY: no other owner has the handle.
        unsafe { (self.native.functions.free)(self.handle) }
    }
}
