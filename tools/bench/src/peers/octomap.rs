//! OctoMap: an octree of occupied cubes, asked by a C++ program of ours that is built when its library is installed.

use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use slicewalk::query::Aabb;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// What its documentation advises, and how boxes are asked.
pub const SETTINGS: &str = "points as occupied by updateNode, lazy; updateInnerOccupancy, toMaxLikelihood, prune; no free space; boxes by a search down from the root that leaves out what lies outside";
const SOURCE: &str = include_str!("../../octomap/octomap.cc");
/// Cubes to a side of its trees.
const SIDE: f64 = 65_536.0;

/// The program, in a folder of its own.
pub struct Octomap {
    folder: tempfile::TempDir,
    program: PathBuf,
}

/// What it answered, and what it cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Asked {
    /// Time to build (s).
    pub build_s: f64,
    /// Memory, by its own count (bytes).
    pub resident_bytes: u64,
    /// Its binary tree, `.bt` (bytes).
    pub file_bytes: u64,
    /// Occupied cubes of the finest level.
    pub occupied_cubes: u64,
    /// Whether it calls each box a hit.
    pub answers: Vec<bool>,
    /// For each repeat the time of each box, the best of three less the clock's (ns).
    pub times_ns: Vec<Vec<f64>>,
    /// Least corners of occupied cubes, evenly among all (m).
    pub cubes: Vec<Point3<f64>>,
}

/// What to build and to ask.
#[derive(Debug, Clone, Copy)]
pub struct Task<'a> {
    /// Occupied places.
    pub points: &'a [Point3<f64>],
    /// Edge of a cube (m).
    pub cube_m: f64,
    /// Boxes to ask about.
    pub boxes: &'a [Aabb],
    /// How often the times are taken.
    pub repeats: usize,
    /// Cubes to give, at most.
    pub samples: usize,
}

impl Octomap {
    /// Builds the program; an error says in one line why there is none.
    pub fn new() -> Result<Self> {
        let compiler = std::env::var_os("CXX").unwrap_or_else(|| "c++".into());
        let folder = tempfile::tempdir()?;
        let (source, program) = (folder.path().join("octomap.cc"), folder.path().join("octomap"));
        std::fs::write(&source, SOURCE)?;
        let header = folder.path().join("header.cc");
        std::fs::write(&header, "#include <octomap/OcTree.h>\n")?;
        let start = |command: &mut Command| {
            command.output().map_err(|e| format!("{} cannot be started: {e}", compiler.to_string_lossy()))
        };
        if !start(Command::new(&compiler).arg("-E").arg(&header))?.status.success() {
            return Err("liboctomap-dev is not installed".into());
        }
        let mut build = Command::new(&compiler);
        build.args(["-std=c++17", "-O3", "-DNDEBUG", "-o"]).args([&program, &source]);
        successful(start(build.args(["-loctomap", "-loctomath"]))?, "octomap.cc does not compile")?;
        Ok(Self { folder, program })
    }

    /// Builds a tree and asks it.
    pub fn ask(&self, task: &Task) -> Result<Asked> {
        let from = middle(task)?;
        let place = |name| self.folder.path().join(name);
        let (points, boxes, answers, tree) = (place("points"), place("boxes"), place("answers"), place("tree.bt"));
        let shifted = |p: &Point3<f64>| [p.x - from.x, p.y - from.y, p.z - from.z];
        write(&points, task.points.iter().flat_map(shifted))?;
        let ends = |shape: &Aabb| [shifted(&shape.min()), shifted(&shape.max())];
        write(&boxes, task.boxes.iter().flat_map(ends).flatten())?;
        let mut command = Command::new(&self.program);
        command.arg(task.cube_m.to_string()).args([&points, &boxes]);
        command.args([task.repeats, task.samples].map(|count| count.to_string())).args([&answers, &tree]);
        let said = successful(command.output()?, "octomap.cc failed")?;
        let fact = |name: &str| -> Result<f64> {
            let found = said.lines().find_map(|line| line.strip_prefix(name)?.trim().parse().ok());
            found.ok_or_else(|| format!("octomap.cc gave no {name}").into())
        };
        let values = read(&answers)?;
        let asked = task.boxes.len();
        if values.len() < asked * (1 + task.repeats) || !(values.len() - asked * (1 + task.repeats)).is_multiple_of(3) {
            return Err(format!("octomap.cc gave {} numbers about {asked} boxes", values.len()).into());
        }
        let (hits, rest) = values.split_at(asked);
        let (times, cubes) = rest.split_at(asked * task.repeats);
        let times_ns = (0..task.repeats).map(|repeat| times[repeat * asked..][..asked].to_vec());
        Ok(Asked {
            build_s: fact("build_s")?,
            resident_bytes: fact("resident_bytes")? as u64,
            file_bytes: std::fs::metadata(&tree)?.len(),
            occupied_cubes: fact("occupied_cubes")? as u64,
            answers: hits.iter().map(|hit| *hit == 1.0).collect(),
            times_ns: times_ns.collect(),
            cubes: cubes.chunks_exact(3).map(|c| Point3::new(c[0], c[1], c[2]) + from).collect(),
        })
    }
}

/// Whole cubes from the origin to the middle of the points: its trees lie around (0, 0, 0). An error where they do not fit.
fn middle(task: &Task) -> Result<Vector3<f64>> {
    let mut points = task.points.iter();
    let first = *points.next().ok_or("no points")?;
    let (low, high) = points.fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    let cubes = (high - low).max() / task.cube_m;
    if cubes > SIDE - 4.0 {
        return Err(format!("{cubes:.0} cubes to a side; its trees have {SIDE} at most").into());
    }
    Ok(nalgebra::center(&low, &high).coords.map(|value| (value / task.cube_m).round() * task.cube_m))
}

/// What a program said, or its first line of complaint.
fn successful(output: Output, failed: &str) -> Result<String> {
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let line = said.lines().find(|line| line.contains("error")).or(said.lines().next());
    Err(format!("{failed} ({}): {}", output.status, line.unwrap_or("no word why")).into())
}

fn write(path: &Path, values: impl Iterator<Item = f64>) -> Result<()> {
    let bytes: Vec<u8> = values.flat_map(f64::to_ne_bytes).collect();
    Ok(std::fs::write(path, bytes)?)
}

fn read(path: &Path) -> Result<Vec<f64>> {
    let bytes = std::fs::read(path)?;
    let (values, _) = bytes.as_chunks::<8>();
    Ok(values.iter().map(|value| f64::from_ne_bytes(*value)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Random;
    use std::collections::HashSet;

    #[test]
    fn its_answers_are_those_of_the_cubes_that_hold_a_point() -> Result<()> {
        let octomap = match Octomap::new() {
            Ok(octomap) => octomap,
            Err(error) => {
                eprintln!("skipped: {error}");
                return Ok(());
            }
        };
        const CUBE: f64 = 0.25;
        let mut random = Random(5);
        let mut place = |low: f64, high: f64| Point3::from([0, 1, 2].map(|_| random.between(low, high)));
        // Far from the origin, and dense enough in a corner that cubes are pruned into larger ones.
        let mut points: Vec<_> = (0..3000).map(|_| place(1000.0, 1002.0)).collect();
        points.extend((0..300).map(|_| place(1000.0, 1020.0)));
        let boxes: Result<Vec<_>> =
            (0..500).map(|_| Ok(Aabb::standing(place(999.0, 1021.0), Vector3::new(0.5, 0.5, 1.8))?)).collect();
        let boxes = boxes?;
        let cell = |p: &Point3<f64>| [0, 1, 2].map(|axis| (p[axis] / CUBE).floor() as i64);
        let cubes: HashSet<[i64; 3]> = points.iter().map(cell).collect();
        let task = Task { points: &points, cube_m: CUBE, boxes: &boxes, repeats: 2, samples: 100_000 };
        let asked = octomap.ask(&task)?;
        let touches = |shape: &Aabb| {
            let (low, high) = (cell(&shape.min()), cell(&shape.max()));
            cubes.iter().any(|cube| (0..3).all(|axis| (low[axis]..=high[axis]).contains(&cube[axis])))
        };
        let expected: Vec<bool> = boxes.iter().map(touches).collect();
        assert!(expected.contains(&true) && expected.contains(&false));
        assert_eq!(asked.answers, expected);
        let inside = |corner: &Point3<f64>| cell(&(corner + Vector3::repeat(CUBE / 2.0)));
        assert_eq!(asked.cubes.iter().map(inside).collect::<HashSet<_>>(), cubes);
        assert_eq!((asked.occupied_cubes, asked.cubes.len()), (cubes.len() as u64, cubes.len()));
        assert_eq!(asked.times_ns.iter().map(Vec::len).collect::<Vec<_>>(), [500, 500]);
        assert!(asked.file_bytes > 100 && asked.resident_bytes > 16 * asked.file_bytes / 2, "{asked:?}");
        let wide = Task { cube_m: 20.0 / 70_000.0, ..task };
        assert!(octomap.ask(&wide).is_err_and(|error| error.to_string().contains("65536 at most")));
        Ok(())
    }
}
