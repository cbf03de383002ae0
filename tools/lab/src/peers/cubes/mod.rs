//! Identical cubes in many libraries: each holds exactly the voxels that Slicewalk holds, proves it by its answers, and
//! is then queried in turn with Slicewalk.
//!
//! `bench peers` writes `cubes.md`. What is not installed is skipped, with a word.

mod cpp;
mod matter;
mod open3d;
mod peer;
mod questions;
mod splat;
mod stairs;

use crate::chart::subject::Subject;
use crate::chart::workload::Workload;
use crate::stability::Result;
use crate::stability::table::spread;
use cpp::Native;
use matter::{Matter, Mesh};
use open3d::Open3d;
use peer::{Entry, Obvhs, Octree, Ours, Parry, Peer};
pub use questions::Kind;
use questions::{Questions, Verdict};
use slicewalk::NoMonitor;
use slicewalk::plan::PlanOptions;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::fmt::Write;
use std::path::Path;
use std::rc::Rc;
use std::time::Instant;

/// Scenes, and pixels (m).
const SCENES: [(&str, f64); 4] = [("house", 0.05), ("indoor", 0.05), ("indoor", 0.02), ("delft", 0.1)];
/// Suffix of the name of a peer that has fewer, larger triangles.
const MERGED: &str = ", merged faces";
/// Questions of each kind at most.
const QUESTIONS: usize = 6000;
/// Number of answers of each kind that are checked, each alone.
const JUDGED: usize = 2000;
/// A peer with a larger share of wrong answers than this is not timed.
const WRONG: f64 = 0.01;
/// Rounds; in each, every peer is queried once, just after Slicewalk was asked the same.
const ROUNDS: usize = 7;
/// A slow peer is asked as many questions as it answers in `ROUND_S` (s), and at least `LEAST`.
const ROUND_S: f64 = 0.05;
const LEAST: usize = 100;

/// Time of a peer beside Slicewalk's.
pub struct Ratio {
    /// Scene and pixel size.
    pub scene: String,
    /// Name, version and kind of the peer.
    pub peer: String,
    /// The kind of its questions.
    pub kind: Kind,
    /// Its time of Slicewalk's, a round at a time: median, least and greatest.
    pub of_ours: [f64; 3],
}

impl Ratio {
    /// Names the peer, the question and the scene.
    pub fn case(&self) -> String {
        format!("{}, {}, {}", self.peer, self.kind.title(), self.scene)
    }
}

/// Writes `cubes.md` into `out`, and returns the ratios of all peers; quick: one coarse scene, few questions.
pub fn run(out: &Path, quick: bool) -> Result<Vec<Ratio>> {
    let mut ratios = Vec::new();
    let natives = [
        ("Embree", Native::embree()),
        ("NanoVDB", Native::nanovdb()),
        ("Coal", Native::coal()),
        ("Jolt", Native::jolt()),
    ];
    let mut page = String::from(include_str!("head.md"));
    let at_first = load();
    for (name, native) in &natives {
        if let Err(error) = native {
            println!("{name}: skipped: {error}");
            let _ = writeln!(page, "\n{name} was skipped: {error}.");
        }
    }
    let scenes = if quick { &[("house", 0.2)][..] } else { &SCENES };
    let mut before = None;
    for &(name, pixel_m) in scenes {
        let count = if quick { 300 } else { QUESTIONS };
        if before.as_ref().is_none_or(|(subject, _): &(Subject, Workload)| subject.name != name) {
            let Some(subject) = Subject::named(name, quick.then_some(50_000))? else {
                println!("{name}: skipped, its file is missing");
                continue;
            };
            let work = Workload::new(&subject, count)?;
            before = Some((subject, work));
        }
        if let Some((subject, work)) = &before {
            ratios.extend(scene(&mut page, subject, work, pixel_m, &natives)?);
        }
    }
    let jolt = natives[3].1.as_ref().ok();
    let _ = writeln!(page, "\nLoad average of the machine: {at_first} at first, {} at last.", load());
    let _ = write!(page, "\n## Stairs\n\n{}{}", include_str!("stairs.md"), stairs::table(jolt, quick)?);
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("cubes.md"), page)?;
    Ok(ratios)
}

/// Returns how many processes wanted to run in the last minute, as reported by the system.
fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().next().unwrap_or("unknown").to_owned()
}

/// The scene as cubes.
fn matter(subject: &Subject, pixel_m: f64) -> Result<Matter> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("scene.slices");
    let mut options = ConvertOptions::new(vec![subject.file.clone()], file.clone());
    options.grid.pixel = PixelSize::Metres(pixel_m);
    options.plan = PlanOptions { up: subject.up, ..PlanOptions::default() };
    options.reading.units = subject.units;
    options.resources.temp_dir = folder.path().into();
    convert(&options, &NoMonitor)?;
    Matter::new(&file, nalgebra::center(&subject.bounds[0], &subject.bounds[1]).coords)
}

/// The boundary, face by face, and with faces merged.
type Meshes = [Mesh; 2];

/// Everybody but slicewalk, with the cubes.
fn peers(matter: &Matter, meshes: &Meshes, q: &Rc<Questions>, natives: &[(&str, Result<Native>)]) -> Vec<Entry> {
    fn boxed<P: Peer + 'static>(peer: Result<P>) -> Result<Box<dyn Peer>> {
        peer.map(|peer| Box::new(peer) as Box<dyn Peer>)
    }
    let mut all: Vec<Entry> = Vec::new();
    let mut add = |name: &str, note: &str, build: &dyn Fn() -> Result<Box<dyn Peer>>| {
        let start = Instant::now();
        let peer = build();
        match &peer {
            Ok(_) => println!("{name}{note}: built in {:.1} s", start.elapsed().as_secs_f64()),
            Err(error) => println!("{name}{note}: skipped: {error}"),
        }
        let version = peer.as_ref().ok().and_then(|peer| peer.version()).map(|version| format!(" {version}"));
        all.push(Entry { name: format!("{name}{}{note}", version.unwrap_or_default()), peer });
    };
    let [faces, merged] = meshes;
    add("parry3d `Voxels`", "", &|| boxed(Ok(Parry::voxels(matter, q.clone()))));
    add("parry3d `TriMesh`", "", &|| boxed(Parry::mesh(faces, q.clone())));
    add("parry3d `TriMesh`", MERGED, &|| boxed(Parry::mesh(merged, q.clone())));
    add("obvhs", "", &|| boxed(Ok(Obvhs::new(Some(matter), faces, q.clone()))));
    add("obvhs", MERGED, &|| boxed(Ok(Obvhs::new(None, merged, q.clone()))));
    for (name, native) in natives {
        let Ok(native) = native else { continue };
        add(name, "", &|| boxed(native.peer(matter, faces, q)));
        if native.has_mesh() {
            add(name, MERGED, &|| boxed(native.peer(matter, merged, q)));
        }
    }
    add("OctoMap", "", &|| boxed(Octree::new(matter, q.clone())));
    add("Open3D", "", &|| boxed(Open3d::new(matter, faces, q)));
    all
}

fn scene(
    page: &mut String,
    subject: &Subject,
    work: &Workload,
    pixel_m: f64,
    natives: &[(&str, Result<Native>)],
) -> Result<Vec<Ratio>> {
    let matter = matter(subject, pixel_m)?;
    let meshes = [matter.mesh(), matter.merged()];
    let counts = [0, 1].map(|n| meshes[n].triangles.len());
    let name = format!("{}, pixels of {:.0} cm", subject.name, pixel_m * 100.0);
    println!("== {name}: {} cubes, {counts:?} triangles", matter.cubes.len());
    let _ = writeln!(
        page,
        "\n## {name}\n\n{} points, {} cubes, {} triangles, {} with merged faces.",
        subject.points.len(),
        matter.cubes.len(),
        counts[0],
        counts[1]
    );
    let questions = Rc::new(Questions::new(subject, work, &matter)?);
    let mut entries = peers(&matter, &meshes, &questions, natives);
    for entry in &entries {
        if let Err(error) = &entry.peer {
            let _ = writeln!(page, "{} was skipped: {error}.", entry.name);
        }
    }
    bytes(page, &matter, &entries);
    let mut ours = Ours { store: &matter.store, questions: questions.clone() };
    let mut finer = Ours { store: &matter.converted, questions: questions.clone() };
    let mut ratios = Vec::new();
    for kind in Kind::ALL {
        let count = questions.count(kind);
        if count < LEAST {
            continue;
        }
        let mut asked = Vec::new();
        let mut converted = Asked::new("slicewalk, as converted", &mut finer, kind, count)?;
        if let Some(converted) = &mut converted {
            // It holds less: its answers are not those of the cubes.
            converted.answers.clear();
        }
        asked.extend(Asked::new("**slicewalk**", &mut ours, kind, count)?);
        asked.extend(converted);
        let own = asked.len();
        for entry in &mut entries {
            if let Ok(peer) = &mut entry.peer {
                asked.extend(Asked::new(&entry.name, &mut **peer, kind, count)?);
            }
        }
        let title = format!("{}{}", kind.title(), share(kind, &asked));
        println!("{title}");
        let _ = write!(
            page,
            "\n### {title}\n\n| | ns | least and greatest | × slicewalk | least and greatest | asked | checked | rounded | wrong |\n\
             | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n"
        );
        measure(page, &matter, &questions, kind, &mut asked)?;
        let others = asked[own..].iter().filter(|asked| !asked.times.is_empty());
        ratios.extend(others.map(|asked| Ratio {
            scene: name.clone(),
            peer: asked.name.clone(),
            kind,
            of_ours: asked.of_ours(),
        }));
    }
    Ok(ratios)
}

/// How many of the questions the cubes answer with a hit, in words.
fn share(kind: Kind, asked: &[Asked]) -> String {
    let Some(ours) = asked.first() else { return String::new() };
    let hit = |answer: &&f64| match kind {
        Kind::Rays => answer.is_finite(),
        Kind::Sweeps => **answer < questions::SWEEP_M - 1e-9,
        _ => **answer == 1.0,
    };
    let hits = ours.answers.iter().filter(hit).count();
    format!(" ({:.0} % hit)", 100.0 * hits as f64 / ours.answers.len() as f64)
}

/// Files, and memory by own count.
fn bytes(page: &mut String, matter: &Matter, entries: &[Entry]) {
    let mega = |bytes: u64| format!("{:.2}", bytes as f64 / 1e6);
    let mut rows = vec![
        ("slicewalk, archive as converted".to_owned(), mega(matter.archive_bytes[1])),
        ("slicewalk, archive of the cubes".to_owned(), mega(matter.archive_bytes[0])),
        (
            "slicewalk, the cubes in memory".to_owned(),
            mega((matter.store.weight_bytes() + matter.store.table_bytes()) as u64),
        ),
    ];
    rows.push(("splat-transform, `.voxel.bin`, by its format".into(), mega(splat::voxel_bytes(&matter.cubes))));
    for entry in entries {
        let Ok(peer) = &entry.peer else { continue };
        rows.extend(peer.files().into_iter().map(|(file, bytes)| (format!("{}, {file}", entry.name), mega(bytes))));
        rows.extend(peer.memory_bytes().map(|bytes| (format!("{}, in memory", entry.name), mega(bytes))));
    }
    let _ = writeln!(page, "\n| | MB |\n| --- | --- |");
    for (what, bytes) in rows {
        let _ = writeln!(page, "| {what} | {bytes} |");
    }
}

/// Peer that knows a kind of question, after a first query.
struct Asked<'a> {
    name: String,
    peer: &'a mut dyn Peer,
    kind: Kind,
    /// How many questions a round has for it.
    count: usize,
    /// Its answers; empty if they are not checked.
    answers: Vec<f64>,
    /// Per round its time, and that of slicewalk for the same questions (s).
    times: Vec<[f64; 2]>,
}

impl<'a> Asked<'a> {
    fn new(name: &str, peer: &'a mut dyn Peer, kind: Kind, count: usize) -> Result<Option<Self>> {
        let mut answers = Vec::new();
        let first = count.min(LEAST);
        // The first time it may still have to build something.
        peer.ask(kind, first, &mut answers)?;
        let Some(seconds) = peer.ask(kind, first, &mut answers)? else { return Ok(None) };
        let fits = ROUND_S / (seconds / first as f64);
        let count = count.min((fits as usize).max(LEAST));
        peer.ask(kind, count, &mut answers)?;
        Ok(Some(Self { name: name.into(), peer, kind, count, answers, times: Vec::new() }))
    }

    /// Its time of Slicewalk's, a round at a time: median, least and greatest.
    fn of_ours(&self) -> [f64; 3] {
        spread(&self.times.iter().map(|[own, ours]| own / ours).collect::<Vec<_>>())
    }

    fn time(&mut self, count: usize) -> Result<f64> {
        let mut answers = Vec::new();
        self.peer.ask(self.kind, count, &mut answers)?.ok_or_else(|| "it knew the question before".into())
    }
}

/// Checks the answers, measures in rounds, and writes a row for each peer.
fn measure(page: &mut String, matter: &Matter, q: &Questions, kind: Kind, asked: &mut [Asked]) -> Result<()> {
    let judge = |asked: &Asked| {
        let step = asked.answers.len().div_ceil(JUDGED).max(1);
        let judged = (0..asked.answers.len()).step_by(step).map(|n| q.judge(matter, kind, n, asked.answers[n]));
        judged.fold([0usize; 3], |mut count, verdict| {
            count[match verdict {
                Verdict::Equal => 0,
                Verdict::Rounded => 1,
                Verdict::Wrong => 2,
            }] += 1;
            count
        })
    };
    let judged: Vec<[usize; 3]> = asked.iter().map(judge).collect();
    let wrong = |[equal, rounded, wrong]: [usize; 3]| wrong as f64 > WRONG * (equal + rounded + wrong) as f64;
    for _ in 0..ROUNDS {
        let [ours, others @ ..] = &mut *asked else { break };
        for (peer, judged) in others.iter_mut().zip(&judged[1..]) {
            if !wrong(*judged) {
                let same = ours.time(peer.count)?;
                let own = peer.time(peer.count)?;
                peer.times.push([own, same]);
            }
        }
        let own = ours.time(ours.count)?;
        ours.times.push([own, own]);
    }
    for (asked, judged) in asked.iter().zip(judged) {
        let [equal, rounded, wrong] = judged;
        let judged = equal + rounded + wrong;
        let verdicts = if judged == 0 { "– | – | –".into() } else { format!("{judged} | {rounded} | {wrong}") };
        let times = if asked.times.is_empty() {
            "not timed | | |".into()
        } else {
            let ns: Vec<f64> = asked.times.iter().map(|[own, _]| own / asked.count as f64 * 1e9).collect();
            let ([ns, low, high], [ratio, least, most]) = (spread(&ns), asked.of_ours());
            format!("{ns:.0} | {low:.0}–{high:.0} | {ratio:.2} | {least:.2}–{most:.2}")
        };
        let line = format!("| {} | {times} | {} | {verdicts} |", asked.name, asked.count);
        println!("{line}");
        let _ = writeln!(page, "{line}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Random;
    use nalgebra::{Point3, Vector3};
    use slicewalk::query::{Aabb, Ray};

    fn questions(matter: &Matter) -> Result<Questions> {
        let mut random = Random(17);
        let about = Vector3::new(1000.0, -2000.0, 300.0) - matter.origin;
        let mut place = |size: f64| Point3::from([0, 1, 2].map(|_| random.between(-size, size)));
        let mut points: Vec<_> = (0..300).map(|_| place(4.0) + about).collect();
        points
            .extend(matter.cubes.iter().take(300).map(|c| Point3::from(c.map(|n| (f64::from(n) + 0.5) * matter.edge))));
        let boxed = |p: Point3<f64>| Ok(Aabb::standing(p + about, Vector3::new(0.3, 0.3, 0.5))?);
        let boxes = (0..800).map(|_| boxed(place(4.0))).collect::<Result<Vec<_>>>()?;
        let free = |min: &Point3<f64>, max: &Point3<f64>| {
            !matter.hits(&(min - Vector3::repeat(1e-3)), &(max + Vector3::repeat(1e-3)))
        };
        let ray = |from: Point3<f64>, to: Point3<f64>| Ok(Ray::new(from + about, to - from, questions::RAY_M)?);
        let mut rays = (0..800).map(|_| ray(place(4.0), place(4.0))).collect::<Result<Vec<_>>>()?;
        rays.retain(|ray| free(&ray.origin(), &ray.origin()));
        let clear = boxes.iter().filter(|shape| free(&shape.min(), &shape.max()));
        let sweeps: Vec<_> = clear.map(|shape| (*shape, place(1.0).coords.normalize() * questions::SWEEP_M)).collect();
        Ok(Questions { points, random: boxes.clone(), walk: boxes.clone(), raised: boxes, rays, sweeps })
    }

    #[test]
    fn whoever_is_installed_holds_the_same_cubes() -> Result<()> {
        let matter = matter::tests::matter()?;
        let (meshes, q) = ([matter.mesh(), matter.merged()], Rc::new(questions(&matter)?));
        let natives = [
            ("Embree", Native::embree()),
            ("NanoVDB", Native::nanovdb()),
            ("Coal", Native::coal()),
            ("Jolt", Native::jolt()),
        ];
        for (name, native) in &natives {
            if let Err(error) = native {
                eprintln!("{name} is skipped: {error}");
            }
        }
        let mut ours = Ours { store: &matter.store, questions: q.clone() };
        let mut entries = peers(&matter, &meshes, &q, &natives);
        let mut all: Vec<(&str, &mut dyn Peer)> = vec![("slicewalk", &mut ours)];
        for entry in &mut entries {
            if let Ok(peer) = &mut entry.peer {
                all.push((&entry.name, &mut **peer));
            }
        }
        for (name, peer) in all {
            let mut known = 0;
            for kind in Kind::ALL {
                let mut answers = Vec::new();
                if peer.ask(kind, q.count(kind), &mut answers)?.is_none() {
                    continue;
                }
                known += 1;
                assert_eq!(answers.len(), q.count(kind));
                let verdicts = answers.iter().enumerate().map(|(n, answer)| q.judge(&matter, kind, n, *answer));
                let mut count = [0; 2];
                for verdict in verdicts {
                    count[usize::from(verdict == Verdict::Wrong)] += 1;
                }
                eprintln!("{name}: {kind:?}: {count:?}");
                assert_eq!(count[1], 0, "{name}: {kind:?}: {count:?}");
                let (least, most) = answers.iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
                assert!(least < most, "{name}: {kind:?}: all answers are {least}");
            }
            assert!(known > 0, "{name} knows no question");
        }
        Ok(())
    }

    #[test]
    fn other_answers_are_wrong_unless_rounding_explains_them() -> Result<()> {
        let matter = matter::tests::matter()?;
        let cube = matter.cubes[0].map(|n| f64::from(n) * matter.edge);
        let below = Point3::new(cube[0] + 0.5 * matter.edge, cube[1] + 0.5 * matter.edge, cube[2] - 0.05);
        let above = Vector3::new(0.02, 0.02, 0.02);
        let shape = |top: f64| Aabb::new(below, Point3::new(below.x + above.x, below.y + above.y, cube[2] + top));
        let q = Questions {
            points: vec![below],
            random: vec![shape(-5e-5)?, shape(-0.01)?],
            walk: Vec::new(),
            raised: Vec::new(),
            rays: vec![Ray::new(below, Vector3::z(), questions::RAY_M)?],
            sweeps: vec![(shape(-0.01)?, Vector3::z() * questions::SWEEP_M)],
        };
        let judge = |kind, n, answer| q.judge(&matter, kind, n, answer);
        assert_eq!(judge(Kind::Points, 0, 0.0), Verdict::Equal);
        assert_eq!(judge(Kind::Points, 0, 1.0), Verdict::Wrong);
        assert_eq!(judge(Kind::RandomBoxes, 0, 0.0), Verdict::Equal);
        assert_eq!(judge(Kind::RandomBoxes, 0, 1.0), Verdict::Rounded);
        assert_eq!(judge(Kind::RandomBoxes, 1, 1.0), Verdict::Wrong);
        assert_eq!(judge(Kind::Rays, 0, 0.05), Verdict::Equal);
        assert_eq!(judge(Kind::Rays, 0, 0.06), Verdict::Wrong);
        assert_eq!(judge(Kind::Rays, 0, f64::INFINITY), Verdict::Wrong);
        assert_eq!(judge(Kind::Sweeps, 0, 0.01), Verdict::Equal);
        assert_eq!(judge(Kind::Sweeps, 0, 0.1), Verdict::Wrong);
        Ok(())
    }
}
