//! Slicewalk beside its peers: the same questions about the same real scan, in one run on one machine, with the wrong
//! answers beside the times. Brute force over the points decides which answers are wrong.
//!
//! `bench peers` writes `peers.md`. Needs a real scan.

pub(crate) mod character;
pub mod cubes;
pub(crate) mod measure;
mod native;
pub mod octomap;
pub(crate) mod oracle;
pub(crate) mod parry;
pub mod recast;
pub(crate) mod scene;
pub(crate) mod spheres;

use crate::stability::Result;
use measure::{Measured, measure};
use oracle::Oracle;
use parry3d::shape::SharedShape;
use scene::Workload;
use slicewalk::query::{Aabb, Answer, Overlap, Ray, cast, overlaps, sweep, top_under};
use slicewalk::store::Snapshot;
use std::fmt::Write;
use std::path::Path;

/// Whether an answer about a ray, and the distance of the point that it goes through, is wrong.
type Verdict<'a> = dyn Fn(Option<f64>, &(Ray, f64)) -> bool + 'a;

/// How far down floor is looked for (m).
const DEPTH: f64 = 1.0;
/// Differences below this are rounding of single precision (m).
const EXACT: f64 = 0.002;

/// One line of the page: who, times, and wrong answers of two kinds.
fn row<R>(page: &mut String, who: &str, measured: &Measured<R>, wrong: [usize; 2]) {
    let [mean, p50, p99, p999] = measured.times;
    let asked = measured.answers.len();
    let line =
        format!("| {who} | {mean:.0} | {p50:.0} | {p99:.0} | {p999:.0} | {asked} | {} | {} |", wrong[0], wrong[1]);
    println!("{line}");
    let _ = writeln!(page, "{line}");
}

fn head(page: &mut String, what: &str, wrong: [&str; 2]) {
    let _ = write!(
        page,
        "\n### {what}\n\n| | mean (ns) | p50 | p99 | p99.9 | asked | {} | {} |\n| --- | --- | --- | --- | --- | --- | --- | --- |\n",
        wrong[0], wrong[1]
    );
    println!("{what}");
}

struct World<'a> {
    pixel: f64,
    oracle: &'a Oracle,
    store: Snapshot,
    peers: Vec<(&'static str, SharedShape)>,
    tree: &'a spheres::Tree,
    capt: Option<spheres::Affording>,
}

impl World<'_> {
    fn boxes(&self, page: &mut String, what: &str, shapes: &[Aabb]) {
        head(page, what, ["missed", "phantoms"]);
        let truth: Vec<bool> = shapes.iter().map(|shape| self.oracle.hits(shape)).collect();
        let wrong = |answers: &[bool]| {
            let count = |hit: bool| answers.iter().zip(&truth).filter(|(a, t)| **a == hit && **t != hit).count();
            [count(false), count(true)]
        };
        let mut add = |who: &str, measured: Measured<bool>| row(page, who, &measured, wrong(&measured.answers));
        add("slicewalk", measure(shapes, |shape| overlaps(&self.store, shape) == Overlap::Hit));
        for (who, world) in &self.peers {
            add(who, measure(shapes, |shape| parry::hits(&**world, shape)));
        }
        add("kiddo, spheres", measure(shapes, |shape| self.tree.hits_spheres(shape)));
        add("kiddo, exact", measure(shapes, |shape| self.tree.hits(shape)));
        if let Some(capt) = &self.capt {
            add("capt, spheres", measure(shapes, |shape| capt.hits(shape)));
        }
    }

    fn sweeps(&self, page: &mut String, items: &[(Aabb, nalgebra::Vector3<f64>)]) {
        head(page, "Sweep of 0.1 m", ["late by 2 mm or more", "early by more than a pixel"]);
        let truth: Vec<f64> = items.iter().map(|(shape, way)| self.oracle.sweep(shape, *way)).collect();
        let wrong = |answers: &[f64]| {
            let pairs = || answers.iter().zip(&truth);
            let late = pairs().filter(|(a, t)| **a > **t + EXACT).count();
            [late, pairs().filter(|(a, t)| **a < **t - self.pixel - EXACT).count()]
        };
        let mut add = |who: &str, measured: Measured<f64>| row(page, who, &measured, wrong(&measured.answers));
        add(
            "slicewalk",
            measure(items, |(shape, way)| match sweep(&self.store, shape, *way) {
                Answer::Known(hit) => hit.map_or(way.norm(), |hit| hit.distance),
                Answer::NotLoaded(_) => unreachable!("all pages are in memory"),
            }),
        );
        for (who, world) in &self.peers {
            add(who, measure(items, |(shape, way)| parry::sweep(&**world, shape, *way)));
        }
    }

    fn floors(&self, page: &mut String, shapes: &[Aabb]) {
        head(page, "Height under the feet", ["too low by 2 mm or more", "too high by more than 2 cm"]);
        let truth: Vec<Option<f64>> = shapes.iter().map(|shape| self.oracle.top(shape, DEPTH)).collect();
        let wrong = |answers: &[Option<f64>]| {
            let pairs = || answers.iter().zip(&truth).map(|(a, t)| (a.unwrap_or(f64::MIN), t.unwrap_or(f64::MIN)));
            [pairs().filter(|(a, t)| *a < t - EXACT).count(), pairs().filter(|(a, t)| *a > t + 0.02).count()]
        };
        let mut add = |who: &str, measured: Measured<Option<f64>>| row(page, who, &measured, wrong(&measured.answers));
        add(
            "slicewalk",
            measure(shapes, |shape| top_under(&self.store, shape, shape.min().z, DEPTH).known().flatten()),
        );
        for (who, world) in &self.peers {
            add(who, measure(shapes, |shape| parry::top(&**world, shape, DEPTH)));
        }
    }

    fn rays(&self, page: &mut String, rays: &[(Ray, f64)]) {
        head(page, "Ray through a point, up to 10 m", ["passed the point", "phantoms"]);
        let passed = |hit: Option<f64>, (ray, point): &(Ray, f64)| {
            *point <= ray.max() && hit.unwrap_or(f64::INFINITY) > *point + EXACT
        };
        let phantom = |hit: Option<f64>, (ray, _): &(Ray, f64)| {
            let place = |distance: f64| ray.origin() + ray.direction().normalize() * distance;
            hit.is_some_and(|distance| !self.oracle.near(place(distance), 2.0 * self.pixel, 4.0 * self.pixel))
        };
        let mut add = |who: &str, measured: Measured<Option<f64>>| {
            let count =
                |wrong: &Verdict| measured.answers.iter().zip(rays).filter(|(hit, ray)| wrong(**hit, ray)).count();
            row(page, who, &measured, [count(&passed), count(&phantom)]);
        };
        add("slicewalk", measure(rays, |(ray, _)| cast(&self.store, ray).known().flatten().map(|hit| hit.distance)));
        for (who, world) in &self.peers {
            add(who, measure(rays, |(ray, _)| parry::ray(&**world, ray)));
        }
    }

    fn walks(&self, page: &mut String) -> Result<()> {
        let places = scene::route()?.len();
        head(page, "A frame of a walk, 60 a second", ["frames inside solid", "waypoints not reached"]);
        let mut add = |who: &str, walked: character::Walked| {
            row(page, who, &walked.measured, [walked.inside(self.oracle), places - walked.reached]);
        };
        add("slicewalk `Walker`, ticks of 1/240 s", character::ours(&self.store, 1.0 / 240.0)?);
        add("slicewalk `Walker`, ticks of 1/60 s", character::ours(&self.store, 1.0 / 60.0)?);
        for (who, world) in &self.peers {
            for steps in character::STEPS {
                let who = format!("rapier3d controller on {who}, step {} m, tread {} m", steps.0, steps.1);
                add(&who, character::rapier(world.clone(), steps)?);
            }
        }
        Ok(())
    }
}

/// Writes `peers.md` into `out`; quick: one pixel size.
pub fn run(out: &Path, quick: bool) -> Result<()> {
    let Some(scan) = scene::scan() else {
        println!("skipped: it needs a real scan");
        return Ok(());
    };
    let points = scene::points(&scan)?;
    let oracle = Oracle::new(&points);
    let tree = spheres::Tree::new(points.iter().map(|p| [p.x, p.y, p.z]).collect())?;
    // The way is that of the coarser grid for both.
    let workload = Workload::new(&points, &scene::store(&scan, 0.05)?)?;
    let mut page = String::from(include_str!("head.md"));
    for &pixel in if quick { &[0.05][..] } else { &[0.05, 0.02] } {
        println!("== pixels of {pixel} m");
        let _ = writeln!(page, "\n## Pixels of {:.0} cm", pixel * 100.0);
        let store = scene::store(&scan, pixel)?;
        let cubes = parry::voxels(&points, [pixel; 3]);
        let mesh = parry::mesh(&cubes)?;
        let triangles = mesh.indices().len();
        let slices = parry::voxels(&points, [pixel, pixel, 3.0 * pixel]);
        let peers = vec![
            ("parry3d `Voxels`, cubes", SharedShape::new(cubes)),
            ("parry3d `Voxels`, slices", SharedShape::new(slices)),
            ("parry3d `TriMesh`", SharedShape::new(mesh)),
        ];
        let thinned = spheres::thinned(&points, pixel);
        let _ = writeln!(
            page,
            "\nSlicewalk: {:.2} MB in memory. {triangles} triangles. `capt` over {} points{}.",
            store.weight_bytes() as f64 / 1e6,
            thinned.len(),
            if pixel < 0.03 { " was not run: see above" } else { "" },
        );
        let capt = (pixel > 0.03).then(|| spheres::Affording::new(&thinned));
        let world = World { pixel, oracle: &oracle, store, peers, tree: &tree, capt };
        world.boxes(&mut page, "Box of the pawn, random places", &workload.random);
        world.boxes(&mut page, "Box of the pawn, along a walk", &workload.walk);
        world.sweeps(&mut page, &workload.sweeps);
        world.floors(&mut page, &workload.walk);
        world.rays(&mut page, &workload.rays);
        world.walks(&mut page)?;
    }
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("peers.md"), page)?;
    Ok(())
}
