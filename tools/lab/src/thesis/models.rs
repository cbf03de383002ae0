//! The models of the comparison: those of the thesis where they are to be had, else of its kind.

use crate::Random;
use crate::data;
use crate::stability::Result;
use crate::stability::table::{Table, number};
use scangen::write::write_triangles_obj;
use scangen::{Params, Scene, WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk::plan::Up;
use slicewalk_input::{InputOptions, InputSet, PointDecoder, Units};
use slicewalk_mesh::{MeshOptions, MeshSet, Triangle};
use std::path::{Path, PathBuf};

/// Numbers of the thesis for a model (tables 4.2, 4.3 and 4.4).
#[derive(Debug, Clone, Copy)]
pub struct Thesis {
    pub name: &'static str,
    /// Points before, and after oversampling for 350 and 700 pixels; scans are not oversampled.
    pub points: u64,
    pub made: Option<[u64; 2]>,
    /// Memory for obstacles at 350 and 700 pixels (MB).
    pub obstacles_mb: [f64; 2],
    pub fps: u32,
}

const fn thesis(name: &'static str, points: u64, made: Option<[u64; 2]>, mb: [f64; 2], fps: u32) -> Option<Thesis> {
    Some(Thesis { name, points, made, obstacles_mb: mb, fps })
}

const OFFICE: Option<Thesis> = thesis("Office", 17_353, Some([3_088_193, 9_349_585]), [20.48, 65.54], 60);
const CHURCH: Option<Thesis> = thesis("Church", 26_721, Some([2_246_549, 6_475_125]), [16.38, 151.55], 60);
const SIBENIK: Option<Thesis> = thesis("Sibenik", 47_658, Some([1_838_167, 5_199_093]), [38.86, 249.86], 60);
const COLUMNS: Option<Thesis> = thesis("Columns", 143_591, Some([1_448_383, 2_612_303]), [8.19, 45.06], 30);
const STREET: Option<Thesis> = thesis("Street", 281_169, Some([3_606_225, 7_142_361]), [16.38, 122.88], 19);
const ROOM: Option<Thesis> = thesis("Room", 271_731, None, [20.48, 51.2], 60);
const ENTRANCE: Option<Thesis> = thesis("Entrance", 580_062, None, [16.38, 69.63], 30);

/// A scan or a mesh.
#[derive(Debug)]
pub struct Model {
    pub name: &'static str,
    pub about: &'static str,
    pub path: PathBuf,
    pub y_up: bool,
    pub thesis: Option<Thesis>,
    /// Points of a scan; empty for meshes.
    pub points: Vec<[f64; 3]>,
    /// Triangles of a mesh, z up; empty for scans.
    pub triangles: Vec<Triangle>,
    pub min: [f64; 3],
    pub max: [f64; 3],
    /// Where a pawn can begin to walk, of generated scenes.
    pub start: Option<[f64; 3]>,
}

impl Model {
    pub fn is_mesh(&self) -> bool {
        !self.triangles.is_empty()
    }

    /// Returns the pixel size for `pixels` pixels along the longer side: equation 3.3 with the sides of the images.
    pub fn pixel(&self, pixels: f64) -> f64 {
        let size = self.size();
        size[0].max(size[1]) / pixels
    }

    /// Returns the pixel size by the equation as printed: with one of the sides and the height.
    pub fn pixel_as_printed(&self, pixels: f64) -> f64 {
        let size = self.size();
        size[0].max(size[2]) / pixels
    }

    pub fn size(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.max[k] - self.min[k])
    }
}

/// Triangles of a mesh file (m, z up).
pub fn triangles(path: &Path, y_up: bool) -> Result<Vec<Triangle>> {
    let options = MeshOptions {
        units: Units::Factor(1.0),
        up: if y_up { Up::Y } else { Up::Z },
        memory_bytes: 1 << 30,
        ..MeshOptions::default()
    };
    let set = MeshSet::open(&[path.to_path_buf()], options, &NoMonitor)?;
    let (mut feed, mut batch, mut all) = (set.feed(), Vec::new(), Vec::new());
    while feed.next(&mut batch, &NoMonitor)? {
        all.extend_from_slice(&batch);
    }
    Ok(all)
}

/// All models; real ones that are missing are left out, and said so.
pub fn all(folder: &Path, quick: bool) -> Result<Vec<Model>> {
    let mut models = Vec::new();
    let mut add = |name, about, path: PathBuf, y_up, thesis, start| -> Result<()> {
        let triangles = triangles(&path, y_up)?;
        let (min, max) = bounds(triangles.iter().flatten());
        models.push(Model { name, about, path, y_up, thesis, points: Vec::new(), triangles, min, max, start });
        Ok(())
    };
    let generated = [
        ("office (house)", "generated: three storeys with rooms, doors, tables, stairs", "house", OFFICE),
        ("church", "generated: nave, columns, stairs", "church", CHURCH),
        ("columns", "generated: a wide floor with a dense field of columns", "columns", COLUMNS),
        ("street", "generated: a street with houses", "street", STREET),
    ];
    for (name, about, scene, thesis) in generated.into_iter().take(if quick { 1 } else { 4 }) {
        let scene = Scene::named(scene, &Params::new())?;
        let path = folder.join(format!("{}.obj", scene.name()));
        write_triangles_obj(&path, &scene, 0.1)?;
        add(name, about, path, false, thesis, scene.walk().map(|walk| walk.start))?;
    }
    let real = [
        ("Sibenik", "the thesis' own, 75,284 triangles", "meshes/sibenik.obj", true, SIBENIK),
        ("Sponza", "atrium, not in the thesis", "meshes/sponza_dabrovic.obj", true, None),
        ("nav_test", "level for walking, not in the thesis", "meshes/nav_test.obj", true, None),
        ("Delft street", "streets and houses, not in the thesis", "meshes/delft_street.obj", false, None),
    ];
    for (name, about, file, y_up, thesis) in real.into_iter().take(if quick { 1 } else { 4 }) {
        if let Some(path) = data::file(file) {
            add(name, about, path, y_up, thesis, None)?;
        }
    }
    if let Some(scan) = data::file("indoor_two_storey_zup.laz") {
        let points = read_scan(&scan, Units::Auto)?;
        for (name, about, count, thesis) in [
            ("scan, 271,731 points", "two storeys, thinned at random to the thesis' number", 271_731, ROOM),
            ("scan, 580,062 points", "two storeys, thinned at random to the thesis' number", 580_062, ENTRANCE),
        ] {
            let path = folder.join(format!("{count}.las"));
            let points = thinned(&points, count);
            write_las(&path, points.iter().copied(), &WriteSpec::for_path(&path))?;
            let (min, max) = bounds(points.iter());
            let (y_up, triangles, start) = (false, Vec::new(), None);
            models.push(Model { name, about, path, y_up, thesis, points, triangles, min, max, start });
        }
    }
    Ok(models)
}

/// Points of a scan (m).
pub fn read_scan(path: &Path, units: Units) -> Result<Vec<[f64; 3]>> {
    let set = InputSet::open(&[path.to_path_buf()], InputOptions { units, ..InputOptions::default() }, &NoMonitor)?;
    let (mut decoder, mut all) = (PointDecoder::new(), Vec::new());
    for chunk in set.chunks() {
        decoder.decode(&set, &chunk, &mut |batch| {
            all.extend((0..batch.len()).map(|n| [batch.x[n], batch.y[n], batch.z[n]]));
            Ok(())
        })?;
    }
    Ok(all)
}

/// Picks `count` of the points, all equally likely, and keeps their order.
fn thinned(points: &[[f64; 3]], count: usize) -> Vec<[f64; 3]> {
    let mut random = Random(5);
    let (mut wanted, mut left) = (count as f64, points.len() as f64);
    let mut take = || {
        let taken = random.between(0.0, left) < wanted;
        left -= 1.0;
        wanted -= f64::from(u8::from(taken));
        taken
    };
    points.iter().copied().filter(|_| take()).collect()
}

fn bounds<'a>(points: impl Iterator<Item = &'a [f64; 3]>) -> ([f64; 3], [f64; 3]) {
    points.fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(min, max), p| {
        ([0, 1, 2].map(|k| min[k].min(p[k])), [0, 1, 2].map(|k| max[k].max(p[k])))
    })
}

/// Table of the models.
pub fn table(models: &[Model]) -> String {
    let mut table = Table::new(["model", "what it is", "triangles or points", "size (m)", "in the thesis (points)"]);
    for model in models {
        let size = model.size().map(|v| number(v, 1)).join(" × ");
        let count = (model.triangles.len() + model.points.len()).to_string();
        let theirs = model.thesis.map_or("-".into(), |thesis| format!("{}: {}", thesis.name, thesis.points));
        table.row([model.name.to_owned(), model.about.into(), count, size, theirs]);
    }
    table.markdown()
}
