//! Standing places beside the truth: what is missed, what is wrongly claimed, and why.

use super::claims::{Ghost, Judged, Pixel, Points, Question, WHY_OFF};
use super::peer::{Meshes, claims};
use super::truth::{Floors, HEIGHT, SLOPE_DEG};
use super::{Effort, everywhere, reached, spot};
use crate::Random;
use crate::peers::recast::Navmesh;
use crate::stability::Result;
use crate::stability::lab::{Converted, Scan, Setting};
use crate::stability::table::{Table, number, percent};
use scangen::sample::{Mode, Order, ScannerSpec};
use scangen::{Params, Sample, SampleSpec, Scene};
use slicewalk::plan::Classifier;
use slicewalk::reach::{Pawn, StandingPlaces};
use slicewalk::walk::Body;
use std::collections::HashMap;
use std::fmt::Write as _;

/// Radii of the pawns (m), all from one archive.
pub const RADII: [f64; 4] = [0.2, 0.3, 0.45, 0.6];
/// Noise of the scans (m).
const NOISE_M: f64 = 0.002;
/// Points to a side of a pixel in even scans.
const PER_PIXEL: f64 = 3.0;
/// Height of a pawn that ceilings are hardly in the way of (m).
const LOW_M: f64 = 1.0;
/// Connected solid of at most this many voxels is dropped from scans that are cleaned.
const FLOATERS: u16 = 8;

/// How a scene is scanned.
#[derive(Debug, Clone, Copy, PartialEq)]
enum How {
    /// Evenly, hidden surfaces too.
    Even,
    /// From stations, with this many million rays: shadows, and edges that give points in the air.
    Stations(f64),
    /// From stations, converted with `--drop-floaters`.
    Cleaned(f64),
}

/// Name of a scene, its parameters, and how it is scanned.
type Case = (&'static str, &'static [(&'static str, f64)], How);

/// Scenes whose surfaces are known, and how each is scanned. Plants are left out: a leaf is no floor, but as level as one.
const CASES: [Case; 20] = [
    ("plane", &[("size", 8.0)], How::Even),
    ("ramps", &[("slope_step", 10.0), ("heading_step", 30.0), ("size", 3.0)], How::Even),
    ("stairs", &[], How::Even),
    ("corridor", &[], How::Even),
    ("house", &[], How::Even),
    ("hall", &[("leaves", 0.0)], How::Even),
    ("church", &[("bays", 4.0)], How::Even),
    ("columns", &[("size", 24.0), ("field", 12.0)], How::Even),
    ("street", &[("length", 30.0)], How::Even),
    ("terrain", &[("size", 30.0), ("wave", 20.0), ("height", 2.0)], How::Even),
    ("tower", &[("storeys", 5.0)], How::Even),
    ("uniform", &[("size", 24.0), ("spacing", 8.0)], How::Even),
    ("corridor", &[], How::Stations(1.0)),
    ("house", &[], How::Stations(8.0)),
    ("hall", &[("leaves", 0.0)], How::Stations(4.0)),
    ("street", &[("length", 30.0)], How::Stations(4.0)),
    ("corridor", &[], How::Cleaned(1.0)),
    ("house", &[], How::Cleaned(8.0)),
    ("hall", &[("leaves", 0.0)], How::Cleaned(4.0)),
    ("street", &[("length", 30.0)], How::Cleaned(4.0)),
];

/// A scene, its scan, and how the scan is made again with other noise.
struct Subject {
    scene: Scene,
    spec: SampleSpec,
    pixel_m: f64,
    setting: Setting,
}

impl Subject {
    fn new(name: &str, params: &[(&str, f64)], how: How, pixel_m: f64) -> Result<Self> {
        let params = params.iter().fold(Params::new(), |params, (name, value)| params.with(name, *value));
        let scene = Scene::named(name, &params)?;
        let spec = match how {
            How::Even => {
                let even = SampleSpec::direct_density((PER_PIXEL / pixel_m).powi(2));
                SampleSpec { mode: Mode::Direct(Order::Grid), ..even }
            }
            How::Stations(millions) | How::Cleaned(millions) => SampleSpec::scanner((millions * 1e6) as u64),
        };
        let setting = match how {
            How::Cleaned(_) => Setting { drop_floaters: FLOATERS, ..Setting::new(pixel_m) },
            _ => Setting::new(pixel_m),
        };
        Ok(Self { scene, spec: spec.with_noise(NOISE_M), pixel_m, setting })
    }

    fn scan(&self, spec: &SampleSpec) -> Result<(Scan, Vec<Sample>)> {
        let mut samples: Vec<Sample> = self.scene.samples(11, spec)?.collect();
        let scan = Scan::new(samples.iter().map(|sample| sample.position).collect())?;
        samples.iter_mut().zip(&scan.points).for_each(|(sample, point)| sample.position = *point);
        Ok((scan, samples))
    }

    /// Returns the sampling without noise and without points in the air.
    fn calm(&self) -> SampleSpec {
        let mode = match &self.spec.mode {
            Mode::Scanner(scanner) => Mode::Scanner(ScannerSpec { mixed_rate: 0.0, ..scanner.clone() }),
            direct => direct.clone(),
        };
        SampleSpec { mode, noise_m: 0.0, ..self.spec.clone() }
    }
}

/// Heights of all standing places by pixel.
struct Places(HashMap<Pixel, Vec<f64>>);

impl Places {
    /// All standing places; with `from`, those that can be reached on foot from there.
    fn new(converted: &Converted, radius: f64, height: f64, from: Option<[f64; 3]>) -> Result<Self> {
        let pawn = Pawn::new(Body::Cylinder { radius, height });
        let region = match from {
            Some([x, y, z]) => {
                let mut standing = StandingPlaces::new(&converted.store, pawn)?;
                // Where the start of the walk itself was not scanned, a place near it.
                let pixel_m = converted.archive.frame().pixel_m();
                let mut start = None;
                for ring in 0..=40 {
                    for n in 0..8 * ring.max(1) {
                        let (sin, cos) =
                            (f64::from(n) / f64::from(ring.max(1)) * std::f64::consts::FRAC_PI_4).sin_cos();
                        let far = f64::from(ring) * pixel_m;
                        if start.is_none() {
                            start = spot(&converted.store, &mut standing, [x + far * cos, y + far * sin, z + 0.1])?;
                        }
                    }
                }
                match start {
                    Some(start) => reached(&converted.store, &mut standing, start)?,
                    None => return Err("nowhere to start".into()),
                }
            }
            None => everywhere(&converted.store, pawn)?.1,
        };
        let frame = converted.archive.frame();
        let mut places: HashMap<Pixel, Vec<f64>> = HashMap::new();
        for place in region.places() {
            let at = [frame.pixel_of(place.feet.x), frame.pixel_of(place.feet.y)];
            places.entry(at).or_default().push(place.feet.z);
        }
        Ok(Self(places))
    }

    fn at(&self, pixel: Pixel) -> Vec<f64> {
        self.0.get(&pixel).cloned().unwrap_or_default()
    }

    fn claims(&self, (pixel, z): (Pixel, f64)) -> bool {
        self.0.get(&pixel).is_some_and(|own| own.iter().any(|claim| super::claims::is_about(*claim, z)))
    }
}

/// Why places are missed or wrong: what puts them right.
#[derive(Debug, Clone, Copy, Default)]
struct Causes {
    /// On, or in the way, what a mirror shows.
    mirror: [usize; 2],
    /// On, or in the way, points between two surfaces at an edge.
    edge: [usize; 2],
    /// Right without noise and without points in the air between surfaces.
    noise: [usize; 2],
    /// Right if every slope is a floor; or a floor that is too steep.
    verdict: [usize; 2],
    /// Right for a lower pawn.
    headroom: usize,
    /// The rest.
    definition: [usize; 2],
}

impl Causes {
    fn add(&mut self, other: Self) {
        for at in 0..2 {
            self.mirror[at] += other.mirror[at];
            self.edge[at] += other.edge[at];
            self.noise[at] += other.noise[at];
            self.verdict[at] += other.verdict[at];
            self.definition[at] += other.definition[at];
        }
        self.headroom += other.headroom;
    }

    fn text(self, at: usize) -> String {
        let headroom = if at == 0 { self.headroom } else { 0 };
        let all = [
            ("mirror", self.mirror[at]),
            ("edge points", self.edge[at]),
            ("noise", self.noise[at]),
            ("class", self.verdict[at]),
            ("headroom", headroom),
            ("definition", self.definition[at]),
        ];
        let some: Vec<String> =
            all.iter().filter(|cause| cause.1 > 0).map(|(name, count)| format!("{name} {count}")).collect();
        if some.is_empty() { "–".into() } else { some.join(", ") }
    }
}

/// Archives of the scene that separate the causes, made when the first place needs them.
struct Others<'a> {
    subject: &'a Subject,
    scan: &'a Scan,
    calm: Option<Converted>,
    lenient: Option<Converted>,
}

impl Others<'_> {
    fn causes(&mut self, own: &Converted, question: &Question, judged: &Judged) -> Result<Causes> {
        let (radius, floors) = (question.radius, question.floors);
        let mut causes = Causes::default();
        if judged.missed.is_empty() && judged.wrong.is_empty() {
            return Ok(causes);
        }
        let setting = self.subject.setting;
        if self.calm.is_none() {
            self.calm = Some(self.subject.scan(&self.subject.calm())?.0.convert(setting, Classifier::Plane)?);
            self.lenient = Some(self.scan.convert(setting.limit(89.0), Classifier::Plane)?);
        }
        let places = |other: &Option<Converted>| Places::new(other.as_ref().ok_or("made above")?, radius, HEIGHT, None);
        let (calm, lenient) = (places(&self.calm)?, places(&self.lenient)?);
        let low = Places::new(own, radius, LOW_M, None)?;
        for &place in &judged.missed {
            match question.ghost(place, false) {
                Some(Ghost::Image) => causes.mirror[0] += 1,
                Some(Ghost::Edge) => causes.edge[0] += 1,
                None if calm.claims(place) => causes.noise[0] += 1,
                None if lenient.claims(place) => causes.verdict[0] += 1,
                None if low.claims(place) => causes.headroom += 1,
                None => causes.definition[0] += 1,
            }
        }
        for &(pixel, z) in &judged.wrong {
            let [x, y] = pixel.map(|v| (v as f64 + 0.5) * self.subject.pixel_m);
            let mut near = floors.over(x, y).into_iter().filter(|floor| super::claims::is_about(z, floor.0));
            match question.ghost((pixel, z), true) {
                Some(Ghost::Image) => causes.mirror[1] += 1,
                Some(Ghost::Edge) => causes.edge[1] += 1,
                None if !calm.claims((pixel, z)) => causes.noise[1] += 1,
                None if near.any(|floor| floor.1 > SLOPE_DEG) => causes.verdict[1] += 1,
                None => causes.definition[1] += 1,
            }
        }
        Ok(causes)
    }
}

/// The tables, as a page.
pub fn page(effort: &Effort) -> Result<String> {
    let mut page = String::from(include_str!("standing.head.md"));
    let fewer = if effort.quick { " `--quick`: an eighth of the rays from stations." } else { "" };
    writeln!(page, "\nSample: {} random pixels in each scene.{fewer}", pixels_of(effort))?;
    for pixel_m in if effort.quick { &[0.05][..] } else { &[0.05, 0.025] } {
        page += &section(*pixel_m, effort)?;
    }
    Ok(page)
}

fn pixels_of(effort: &Effort) -> usize {
    effort.of(20_000, 600)
}

fn section(pixel_m: f64, effort: &Effort) -> Result<String> {
    let mut table = Table::new([
        "scene",
        "radius (m)",
        "places",
        "not scanned",
        "missed",
        "at the border",
        "why",
        "wrong",
        "at the border",
        "unseen",
        "why",
        "wrong anywhere",
        "worst height (cm)",
    ]);
    let mut peers = Table::new([
        "scene",
        "radius (m)",
        "Slicewalk: missed",
        "wrong",
        "Recast, voxels: missed",
        "wrong",
        "Recast, true triangles: missed",
        "wrong",
    ]);
    let (mut all, mut all_causes) = (Judged::default(), Causes::default());
    let mut worst: [(f64, String); 2] = Default::default();
    // Finer pixels are checked on fewer scenes: what is to be seen are the pixels.
    let cases = CASES.iter().filter(|case| pixel_m > 0.04 || ["ramps", "stairs", "corridor", "hall"].contains(&case.0));
    for &(name, params, how) in cases.filter(|case| effort.takes(case.0)) {
        let how = match how {
            How::Stations(millions) if effort.quick => How::Stations(millions / 8.0),
            How::Cleaned(millions) if effort.quick => How::Cleaned(millions / 8.0),
            how => how,
        };
        let subject = Subject::new(name, params, how, pixel_m)?;
        let (scan, samples) = subject.scan(&subject.spec)?;
        let own = scan.convert(subject.setting, Classifier::Plane)?;
        let frame = *own.archive.frame();
        let floors = Floors::new(&subject.scene, pixel_m);
        let points = Points::new(&subject.scene, &floors, &frame, &samples);
        drop(samples);
        let [low, high] = points.extent();
        let mut random = Random(5);
        let pixels: Vec<Pixel> = (0..pixels_of(effort))
            .map(|_| [0, 1].map(|axis| random.between(low[axis] as f64, high[axis] as f64 + 1.0).floor() as i64))
            .collect();
        let meshes = Meshes::new(&subject.scene, &scan.points, pixel_m)?;
        let mut others = Others { subject: &subject, scan: &scan, calm: None, lenient: None };
        let title = match how {
            How::Even => name.to_owned(),
            How::Stations(_) => format!("{name}, from stations"),
            How::Cleaned(_) => format!("{name}, from stations, floaters dropped"),
        };
        for radius in RADII {
            let question = Question { floors: &floors, points: &points, frame, radius, noise: NOISE_M };
            let places = Places::new(&own, radius, HEIGHT, None)?;
            let mut judged = question.judge(&pixels, |pixel| places.at(pixel), true);
            let anywhere = judged.wrong_share();
            if let Some(walk) = subject.scene.walk() {
                let near = Places::new(&own, radius, HEIGHT, Some(walk.start))?;
                let on_foot = question.judge(&pixels, |pixel| near.at(pixel), true);
                (judged.claims, judged.border_wrong, judged.unseen, judged.wrong) =
                    (on_foot.claims, on_foot.border_wrong, on_foot.unseen, on_foot.wrong);
            }
            let causes = others.causes(&own, &question, &judged)?;
            table.row([
                title.clone(),
                number(radius, 2),
                judged.places.to_string(),
                judged.not_scanned.to_string(),
                percent(judged.missed_share()),
                percent(judged.border_missed as f64 / judged.places.max(1) as f64),
                causes.text(0),
                percent(judged.wrong_share()),
                percent(judged.border_wrong as f64 / judged.claims.max(1) as f64),
                judged.unseen.to_string(),
                causes.text(1),
                percent(anywhere),
                number(judged.worst_m * 100.0, 1),
            ]);
            let peer = |triangles: Option<&Vec<_>>, excuse: bool| -> Result<[String; 2]> {
                let Some(triangles) = triangles else { return Ok(["–".into(), "–".into()]) };
                let navmesh = Navmesh::build_for(radius, triangles, pixel_m).ok();
                let judged = question.judge(&pixels, |pixel| claims(navmesh.as_ref(), &frame, pixel), excuse);
                Ok([percent(judged.missed_share()), percent(judged.wrong_share())])
            };
            let [voxels, truth] = [peer(meshes.scan.as_ref(), true)?, peer(Some(&meshes.truth), false)?];
            let ours = [percent(judged.missed_share()), percent(judged.wrong_share())];
            peers.row([title.clone(), number(radius, 2)].into_iter().chain(ours).chain(voxels).chain(truth));
            for (worst, share) in worst.iter_mut().zip([judged.missed_share(), judged.wrong_share()]) {
                if share > worst.0 || worst.1.is_empty() {
                    *worst = (share, format!("{title}, {radius} m"));
                }
            }
            all_causes.add(causes);
            all.merge(&judged);
            if judged.off_truth.yes > 0 {
                eprintln!("{title} {radius}: heights {:?}", judged.off);
            }
            eprintln!("{title} {radius}: missed {:?} wrong {:?}", sample(&judged.missed), sample(&judged.wrong));
            for (pixel, _) in sample(&judged.wrong) {
                let [x, y] = pixel.map(|v| (v as f64 + 0.5) * pixel_m);
                eprintln!("  surfaces at {x:.3}, {y:.3}: {:.3?}", floors.over(x, y));
            }
        }
    }
    let off = WHY_OFF.iter().zip(&all.off).filter(|(_, own)| own.0 > 0);
    let off: Vec<String> =
        off.map(|(why, own)| format!("{} {why}, up to {} cm", own.0, number(own.1 * 100.0, 1))).collect();
    let words = format!(
        "All together: of {} places {} are missed ({} more next to the border); of {} claims {} are wrong ({} more next to the border, {} where \
         what is in the way was not scanned). Missed: {}; wrong: {}. Worst: {} missed ({}), {} wrong ({}). {} places have a pixel without a point \
         of floor under the footprint. Heights: {} of {} more than a quantum above the highest point under the feet, {} more than 1 cm and three \
         times the noise outside the true ones{}{} (the farthest of all {} cm).",
        all.places,
        percent(all.missed_share()),
        percent(all.border_missed as f64 / all.places.max(1) as f64),
        all.claims,
        percent(all.wrong_share()),
        percent(all.border_wrong as f64 / all.claims.max(1) as f64),
        all.unseen,
        all_causes.text(0),
        all_causes.text(1),
        percent(worst[0].0),
        worst[0].1,
        percent(worst[1].0),
        worst[1].1,
        all.not_scanned,
        all.off_points.yes,
        all.off_points.all,
        all.off_truth.yes,
        if off.is_empty() { "" } else { ": " },
        off.join("; "),
        number(all.worst_m * 100.0, 1),
    );
    Ok(format!(
        "\n## Pixels of {} cm\n\n{words}\n\n{}\n\n### Beside Recast\n\n{}\n",
        number(pixel_m * 100.0, 1),
        table.markdown(),
        peers.markdown()
    ))
}

/// Picks some of many places, for printing.
fn sample(places: &[(Pixel, f64)]) -> Vec<(Pixel, f64)> {
    places.iter().step_by((places.len() / 6).max(1)).copied().collect()
}
