//! One cell: a method is built and asked everything.

use super::method::{Built, Method, Vec3};
use super::record::{Figure, Phantom};
use super::subject::Subject;
use super::walkable::{self, Judged};
use super::workload::{Boxes, DEPTH_M, Grazing, Workload};
use crate::Random;
use crate::heap::live_bytes;
use crate::peers::measure::measure_within;
use crate::stability::Result;
use crate::stability::table::{Errors, Share};
use nalgebra::Point3;
use std::time::{Duration, Instant};

/// How much is asked.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Questions of each kind.
    pub questions: usize,
    /// Repeats of each set of questions, and of a build that is fast.
    pub repeats: usize,
    /// Number of places whose distance from solid is queried.
    pub places: usize,
    /// Grazing boxes per bin of distance.
    pub grazing: usize,
    /// Time of one round of questions.
    pub round: Duration,
    /// Builds are repeated while all of them took less.
    pub builds: Duration,
}

/// Figures of one cell.
pub struct Seen {
    pub figures: Vec<Figure>,
    pub phantoms: Vec<Phantom>,
    /// Time of a build (s), and memory kept (bytes).
    pub build_s: f64,
    pub resident_bytes: f64,
}

/// Builds a method and asks it.
pub fn measure(
    method: &dyn Method,
    subject: &Subject,
    pixel_m: f64,
    work: &Workload,
    grazing: &Grazing,
    effort: &Effort,
) -> Result<Seen> {
    let (built, builds, resident) = build(method, subject, pixel_m, effort)?;
    let built = &*built;
    let mut figures = Vec::new();
    let repeats = builds.len();
    let build_s = builds.iter().copied().fold(f64::INFINITY, f64::min);
    figures.extend(Figure::median("build_s", builds, repeats));
    figures.push(Figure::one("resident_bytes", resident, 1));
    figures.extend(built.file_bytes()?.map(|bytes| Figure::one("file_bytes", bytes as f64, 1)));
    let (mut missed, mut phantom) = (Share::default(), Share::default());
    for (boxes, names) in [
        (&work.random, ["random_mean_ns", "random_p50_ns", "random_p99_ns"]),
        (&work.walk, ["walk_mean_ns", "walk_p50_ns", "walk_p99_ns"]),
    ] {
        figures.extend(times(built, boxes, names, effort, [&mut missed, &mut phantom]));
    }
    let (phantoms, grazed) = curve(built, grazing, pixel_m, effort);
    missed.merge(grazed);
    figures.push(Figure::one("missed", missed.value(), missed.all as usize));
    figures.push(Figure::one("phantom", phantom.value(), phantom.all as usize));
    // The distance from triangles is computed for each triangle alone, which takes ten times as long.
    let places = if subject.is_mesh() { effort.places / 10 } else { effort.places };
    let out = outwards(built, subject, places)?;
    let inner = inwards(built, subject, effort.places);
    for (errors, names) in
        [(out, ["out_max_cm", "out_p99_cm", "out_mean_cm"]), (inner, ["in_max_cm", "in_p99_cm", "in_mean_cm"])]
    {
        let values = [errors.quantile(1.0), errors.quantile(0.99), errors.mean()];
        let n = errors.0.len();
        figures.extend(names.into_iter().zip(values).map(|(name, value)| Figure::one(name, value * 100.0, n)));
    }
    figures.extend(floors(built, grazing, effort));
    figures.extend(sweeps(built, subject, work, effort));
    figures.extend(stands(built, subject, work));
    figures.extend(slopes(built, subject, pixel_m, effort));
    Ok(Seen { figures, phantoms, build_s, resident_bytes: resident })
}

/// Builds it, more than once where that is fast: the structure, the times (s), and what it keeps (bytes).
fn build(
    method: &dyn Method,
    subject: &Subject,
    pixel_m: f64,
    effort: &Effort,
) -> Result<(Box<dyn Built>, Vec<f64>, f64)> {
    let begin = Instant::now();
    let mut times = Vec::new();
    loop {
        let before = live_bytes();
        let start = Instant::now();
        let built = method.build(subject, pixel_m)?;
        times.push(start.elapsed().as_secs_f64());
        if times.len() >= effort.repeats || begin.elapsed() > effort.builds {
            let kept = live_bytes().saturating_sub(before).saturating_sub(built.spare_bytes());
            let outside = built.outside_bytes();
            return Ok((built, times, (kept + outside) as f64));
        }
    }
}

/// Times of box queries; counts what was missed and what was a phantom.
fn times(
    built: &dyn Built,
    boxes: &Boxes,
    names: [&'static str; 3],
    effort: &Effort,
    [missed, phantom]: [&mut Share; 2],
) -> Vec<Figure> {
    let mut repeats = [const { Vec::new() }; 3];
    let mut asked = 0;
    for repeat in 0..effort.repeats {
        let measured = measure_within(effort.round, &boxes.shapes, |shape| built.hits(shape));
        asked = if repeat == 0 { measured.answers.len() } else { asked.min(measured.answers.len()) };
        repeats.iter_mut().zip(measured.times).for_each(|(all, time)| all.push(time));
        if repeat == 0 {
            // A slow method is timed on some of the boxes, and checked on as many as it answers in 15 rounds.
            let begin = Instant::now();
            let rest = boxes.shapes[asked..].iter().take_while(|_| begin.elapsed() < 15 * effort.round);
            let answers = measured.answers.iter().copied().chain(rest.map(|shape| built.hits(shape)));
            for (answer, truth) in answers.zip(&boxes.truth) {
                if *truth { missed.add(!answer) } else { phantom.add(answer) }
            }
        }
    }
    names.into_iter().zip(repeats).filter_map(|(name, repeats)| Figure::median(name, repeats, asked)).collect()
}

/// Shares of grazing boxes that are hits, by distance; and of those that hold a point, how many were missed.
fn curve(built: &dyn Built, grazing: &Grazing, pixel_m: f64, effort: &Effort) -> (Vec<Phantom>, Share) {
    let mut bins: Vec<Share> = Vec::new();
    let mut missed = Share::default();
    let begin = Instant::now();
    for (shape, &gap) in grazing.shapes.iter().zip(&grazing.gaps) {
        let hit = built.hits(shape);
        let bin = Grazing::bin(gap, pixel_m);
        bins.resize(bins.len().max(bin + 1), Share::default());
        bins[bin].add(hit);
        if gap <= 0.0 {
            missed.add(!hit);
        }
        if begin.elapsed() > 10 * effort.round {
            break;
        }
    }
    let some = bins.iter().enumerate().filter(|(_, share)| share.all > 0);
    let phantom = |(bin, share): (usize, &Share)| Phantom {
        gap_cm: Grazing::middle(bin, pixel_m) * 100.0,
        share: share.value(),
        n: share.all as usize,
    };
    (some.map(phantom).collect(), missed)
}

/// Distances from places on claimed solid to the nearest point (m). Places are spread over the claims by their surface.
fn outwards(built: &dyn Built, subject: &Subject, count: usize) -> Result<Errors> {
    let (mut claims, mut whole) = (Vec::new(), 0.0);
    built.claimed(&mut |min, max| {
        // A point has no surface, but is as good as another.
        let own = surface(min, max).max(f64::MIN_POSITIVE);
        whole += own;
        claims.push((min, max, own));
    })?;
    let mut random = Random(31);
    let step = whole / count.min(8 * claims.len().max(1)) as f64;
    let (mut sum, mut next) = (0.0, random.between(0.0, step));
    let mut errors = Errors::default();
    for (min, max, own) in claims {
        sum += own;
        while next < sum {
            errors.0.push(subject.distance(on_surface(min, max, &mut random)));
            next += step;
        }
    }
    Ok(errors)
}

fn surface(min: Vec3, max: Vec3) -> f64 {
    let [a, b, c] = [0, 1, 2].map(|axis| max[axis] - min[axis]);
    2.0 * (a * b + b * c + c * a)
}

/// A corner, one time in four; else anywhere on a face, faces by their area.
fn on_surface(min: Vec3, max: Vec3, random: &mut Random) -> Point3<f64> {
    let bits = random.bits();
    let mut place = [0, 1, 2].map(|axis| if bits >> axis & 1 == 1 { max[axis] } else { min[axis] });
    if bits >> 3 & 3 != 0 {
        let [a, b, c] = [0, 1, 2].map(|axis| max[axis] - min[axis]);
        let mut at = random.between(0.0, b * c + c * a + a * b);
        let flat = [b * c, c * a, a * b].iter().position(|area| {
            at -= area;
            at <= 0.0
        });
        for axis in (0..3).filter(|&axis| Some(axis) != flat) {
            place[axis] = random.between(min[axis], max[axis]);
        }
    }
    place.into()
}

/// Distances from points to the nearest claimed solid, plus how far the tested shape falls short of the pawn (m).
fn inwards(built: &dyn Built, subject: &Subject, count: usize) -> Errors {
    let mut random = Random(32);
    let from = |_| {
        let p = subject.points[random.bits() as usize % subject.points.len()];
        built.nearest(p) + built.cut_off(subject.pawn, &mut random)
    };
    Errors((0..count).map(from).collect())
}

/// Heights under the feet along the walk, against those of the points.
fn floors(built: &dyn Built, grazing: &Grazing, effort: &Effort) -> Option<Figure> {
    let begin = Instant::now();
    let mut errors = Errors::default();
    for (shape, truth) in &grazing.floors {
        let found = built.floor(shape, DEPTH_M)?;
        errors.0.extend(found.map(|found| (found - truth) * 100.0));
        if begin.elapsed() > 10 * effort.round {
            break;
        }
    }
    (!errors.0.is_empty()).then(|| Figure::one("floor_rmse_cm", errors.rmse(), errors.0.len()))
}

/// Distances of sweeps, against those of the points.
fn sweeps(built: &dyn Built, subject: &Subject, work: &Workload, effort: &Effort) -> Vec<Figure> {
    if subject.is_mesh() {
        return Vec::new();
    }
    let begin = Instant::now();
    let mut errors = Errors::default();
    for ((shape, way), truth) in work.sweeps.iter().zip(&work.reached) {
        let Some(reached) = built.sweep(shape, *way) else { return Vec::new() };
        errors.0.push((reached - truth) * 100.0);
        if begin.elapsed() > 10 * effort.round {
            break;
        }
    }
    let n = errors.0.len();
    if n == 0 {
        return Vec::new();
    }
    let late = errors.0.iter().copied().fold(0.0, f64::max);
    let mean = errors.0.iter().map(|e| e.abs()).sum::<f64>() / n as f64;
    vec![Figure::one("toi_cm", mean, n), Figure::one("toi_late_cm", late, n)]
}

/// Where one may stand, against the true surfaces.
fn stands(built: &dyn Built, subject: &Subject, work: &Workload) -> Vec<Figure> {
    let between = [subject.bounds[0].z - 1.0, subject.bounds[1].z + 1.0];
    let claims = |x, y| built.standing([x, y], between).unwrap_or_default();
    if built.standing([0.0; 2], between).is_none() {
        return Vec::new();
    }
    stand_figures(&walkable::judge(&work.columns, claims))
}

/// Figures of a cell; those without samples are left out.
pub fn stand_figures(judged: &Judged) -> Vec<Figure> {
    let heights = &judged.heights;
    let figures = [
        Figure::one("stand_rmse_cm", heights.rmse() * 100.0, heights.0.len()),
        Figure::one("stand_missing", judged.missing.value(), judged.missing.all as usize),
        Figure::one("stand_wrong", judged.wrong.value(), judged.wrong.all as usize),
    ];
    figures.into_iter().filter(|figure| figure.n > 0).collect()
}

/// Steepest floor (degrees): the default limit.
const LIMIT_DEG: f64 = 45.0;

/// Share of wrong classes at points whose neighbourhood of two pixels is all floor or all obstacle.
fn slopes(built: &dyn Built, subject: &Subject, pixel_m: f64, effort: &Effort) -> Option<Figure> {
    use scangen::Truth;
    let scene = subject.scene.as_ref().filter(|_| !subject.surfaces.is_empty())?;
    let steep = |n: usize| {
        let p = subject.points[n];
        scene.slope_at(subject.surfaces[n] as usize, p.x, p.y) > LIMIT_DEG
    };
    let mut random = Random(33);
    let mut wrong = Share::default();
    for _ in 0..effort.questions / 4 {
        let n = random.bits() as usize % subject.points.len();
        let (p, truth) = (subject.points[n], steep(n));
        if subject.tree.within(p.into(), 2.0 * pixel_m).all(|other| steep(other) == truth)
            && let Some(obstacle) = built.obstacle(p)
        {
            wrong.add(obstacle != truth);
        }
    }
    (wrong.all > 0).then(|| Figure::one("slope_wrong", wrong.value(), wrong.all as usize))
}
