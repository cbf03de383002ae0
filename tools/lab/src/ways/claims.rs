//! Claims that one can stand somewhere, beside the truth.

use super::truth::{CLIMB, Floors, HEIGHT, SLOPE_DEG};
use crate::stability::table::Share;
use scangen::{Kind, Sample, Scene, Truth};
use slicewalk::frame::Frame;

/// A claim and a floor that lie nearer to each other are about the same place, beyond a climb (m).
const NEAR_M: f64 = 0.03;
/// A floor's class is promised to change within this angle of the steepest floor (degrees).
const VERDICT_DEG: f64 = 3.0;
/// Feet may rest on solid up to this height without its being in the way of the body (m).
const FEET_M: f64 = 0.01;

/// A pixel.
pub type Pixel = [i64; 2];

/// Origin of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Of {
    /// A surface that one can stand on.
    Floor,
    /// Another surface.
    Surface,
    /// Nothing: two surfaces at an edge, which give a point between them.
    Edge,
    /// Nothing: a mirror image.
    Image,
}

/// Points that belong to no surface, by kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ghost {
    /// Between two surfaces at an edge.
    Edge,
    /// Mirror image.
    Image,
}

/// The points of a scan by pixel.
pub struct Points {
    first: Pixel,
    size: [usize; 2],
    starts: Vec<u32>,
    /// Height (m), and what it is a point of.
    items: Vec<(f64, Of)>,
}

impl Points {
    /// Of samples as they lie in the file.
    pub fn new(scene: &Scene, floors: &Floors, frame: &Frame, samples: &[Sample]) -> Self {
        let pixel = |sample: &Sample| [0, 1].map(|axis| frame.pixel_of(sample.position[axis]));
        let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
        for at in samples.iter().map(pixel) {
            for axis in 0..2 {
                (low[axis], high[axis]) = (low[axis].min(at[axis]), high[axis].max(at[axis]));
            }
        }
        let size = [0, 1].map(|axis| (high[axis] - low[axis] + 1).max(0) as usize);
        let cell = |at: Pixel| (at[1] - low[1]) as usize * size[0] + (at[0] - low[0]) as usize;
        let mut starts = vec![0u32; size[0] * size[1] + 1];
        samples.iter().for_each(|sample| starts[cell(pixel(sample)) + 1] += 1);
        for n in 1..starts.len() {
            starts[n] += starts[n - 1];
        }
        let (mut next, mut items) = (starts.clone(), vec![(0.0, Of::Surface); samples.len()]);
        for sample in samples {
            let [x, y, z] = sample.position;
            let is_level = || scene.slope_at(sample.surface as usize, x, y) <= SLOPE_DEG;
            let of = match sample.kind {
                Kind::Mixed => Of::Edge,
                Kind::Outlier => Of::Image,
                _ if is_level() && floors.holds([x, y, z]) => Of::Floor,
                _ => Of::Surface,
            };
            let place = &mut next[cell(pixel(sample))];
            items[*place as usize] = (z, of);
            *place += 1;
        }
        Self { first: low, size, starts, items }
    }

    fn at(&self, pixel: Pixel) -> &[(f64, Of)] {
        let [i, j] = [0, 1].map(|axis| pixel[axis] - self.first[axis]);
        if !(0..self.size[0] as i64).contains(&i) || !(0..self.size[1] as i64).contains(&j) {
            return &[];
        }
        let cell = j as usize * self.size[0] + i as usize;
        &self.items[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// Pixels between which all points lie.
    pub fn extent(&self) -> [Pixel; 2] {
        [self.first, [0, 1].map(|axis| self.first[axis] + self.size[axis] as i64 - 1)]
    }
}

/// A question about one scene and one radius.
pub struct Question<'a> {
    pub floors: &'a Floors<'a>,
    pub points: &'a Points,
    pub frame: Frame,
    pub radius: f64,
    /// Noise of the scan (m).
    pub noise: f64,
}

/// How claims compare with the truth. Places are counted by sampled pixel and floor.
#[derive(Debug, Clone, Default)]
pub struct Judged {
    /// Where one can stand and all under the footprint was scanned.
    pub places: u64,
    /// Where one can stand, but a pixel under the footprint holds no point of a floor.
    pub not_scanned: u64,
    /// Of the places, those not claimed: at the border, and others.
    pub border_missed: u64,
    pub missed: Vec<(Pixel, f64)>,
    /// All claims; of these, where one cannot stand: at the border of where one can; where what is in the way was not scanned; others.
    pub claims: u64,
    pub border_wrong: u64,
    pub unseen: u64,
    pub wrong: Vec<(Pixel, f64)>,
    /// Heights farther than a quantum above the highest point under the feet.
    pub off_points: Share,
    /// Heights beyond 1 cm and three times the noise outside the true ones, and how far the farthest lies outside (m).
    pub off_truth: Share,
    pub worst_m: f64,
    /// Why heights lie outside, and the farthest of each (m).
    pub off: [(u64, f64); 4],
}

/// Reasons why heights lie outside the true ones, in the order of [`Judged::off`].
pub const WHY_OFF: [&str; 4] =
    ["on points in the air at edges", "on what a mirror shows", "below them", "on other points above them"];

impl Judged {
    /// Adds another.
    pub fn merge(&mut self, other: &Self) {
        self.places += other.places;
        self.not_scanned += other.not_scanned;
        self.border_missed += other.border_missed;
        self.missed.extend(&other.missed);
        self.claims += other.claims;
        self.border_wrong += other.border_wrong;
        self.unseen += other.unseen;
        self.wrong.extend(&other.wrong);
        self.off_points.merge(other.off_points);
        self.off_truth.merge(other.off_truth);
        self.worst_m = self.worst_m.max(other.worst_m);
        for (own, other) in self.off.iter_mut().zip(&other.off) {
            *own = (own.0 + other.0, own.1.max(other.1));
        }
    }

    /// Share of places missed beyond the border.
    pub fn missed_share(&self) -> f64 {
        self.missed.len() as f64 / self.places.max(1) as f64
    }

    /// Share of claims that are wrong beyond the border.
    pub fn wrong_share(&self) -> f64 {
        self.wrong.len() as f64 / self.claims.max(1) as f64
    }
}

/// Whether a claimed height is about the floor at `z`: feet stand on it or on what they climb from it.
pub fn is_about(claim: f64, z: f64) -> bool {
    (-NEAR_M..=CLIMB + NEAR_M).contains(&(claim - z))
}

impl Question<'_> {
    fn middle(&self, pixel: Pixel) -> [f64; 2] {
        pixel.map(|v| (v as f64 + 0.5) * self.frame.pixel_m())
    }

    /// Pixels that the body enters.
    fn footprint(&self) -> Vec<Pixel> {
        let reach = (self.radius / self.frame.pixel_m()).ceil() as i64 + 1;
        let gap = |d: i64| (d.abs() as f64 - 0.5).max(0.0) * self.frame.pixel_m();
        let all = (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| [i, j]));
        all.filter(|&[i, j]| gap(i).hypot(gap(j)) < self.radius - 1e-6).collect()
    }

    /// Places in a pixel and within one pixel of it.
    fn around(&self, pixel: Pixel) -> impl Iterator<Item = [f64; 2]> {
        // A little farther, for what lies on the line between two pixels belongs to the next one.
        let ([x, y], step) = (self.middle(pixel), 0.501 * self.frame.pixel_m());
        (-3..=3).flat_map(move |j| (-3..=3).map(move |i| [x + step * f64::from(i), y + step * f64::from(j)]))
    }

    /// Whether one can stand about `z` everywhere, or anywhere, in a pixel and within one pixel of it, on floor up to `limit_deg` steep.
    fn stands_near(&self, pixel: Pixel, z: f64, want_all: bool, limit_deg: f64) -> bool {
        let near = |[x, y]: [f64; 2]| {
            let all = self.floors.over(x, y);
            let mut own = all.iter().filter(|floor| (floor.0 - z).abs() <= CLIMB + NEAR_M);
            own.any(|&(z, slope)| self.floors.stands([x, y, z], slope, self.radius, limit_deg).is_some())
        };
        let mut around = self.around(pixel);
        if want_all { around.all(near) } else { around.any(near) }
    }

    /// Whether one can stand about `z` if the surface under the middle is taken anywhere in the pixel or within one pixel of it.
    fn stands_from_beside(&self, pixel: Pixel, z: f64) -> bool {
        let [x, y] = self.middle(pixel);
        let about = -NEAR_M..=CLIMB + NEAR_M + self.frame.pixel_m();
        self.around(pixel).any(|[beside_x, beside_y]| {
            let beside = self.floors.over(beside_x, beside_y);
            let mut own = beside.iter().filter(|floor| about.contains(&(z - floor.0)));
            let limit_deg = SLOPE_DEG + VERDICT_DEG;
            own.any(|&(floor, slope)| self.floors.stands([x, y, floor], slope, self.radius, limit_deg).is_some())
        })
    }

    /// Points of no surface that a place is missed for, or claimed on: those in the body of a missed one, or under the feet of a claim.
    pub fn ghost(&self, (pixel, z): (Pixel, f64), is_claimed: bool) -> Option<Ghost> {
        let footprint = self.footprint();
        let under = footprint.iter().flat_map(|[i, j]| self.points.at([pixel[0] + i, pixel[1] + j]));
        let own = |of: Of| match of {
            Of::Edge => Some(Ghost::Edge),
            Of::Image => Some(Ghost::Image),
            _ => None,
        };
        if is_claimed {
            let below = under.filter(|point| point.0 <= z + FEET_M);
            below.max_by(|a, b| a.0.total_cmp(&b.0)).and_then(|point| own(point.1))
        } else {
            let mut inside = under.filter(|point| (z + FEET_M..z + HEIGHT + CLIMB).contains(&point.0));
            inside.find_map(|point| own(point.1))
        }
    }

    /// Compares the claims over sampled pixels with the truth. With `excuse`, missing points excuse an error.
    pub fn judge(&self, pixels: &[Pixel], claims: impl Fn(Pixel) -> Vec<f64>, excuse: bool) -> Judged {
        let footprint = self.footprint();
        let mut judged = Judged::default();
        for &pixel in pixels {
            let [x, y] = self.middle(pixel);
            let claimed = claims(pixel);
            let floors = self.floors.over(x, y);
            let stands: Vec<_> =
                floors.iter().map(|&(z, slope)| self.floors.stands([x, y, z], slope, self.radius, SLOPE_DEG)).collect();
            let under = || footprint.iter().map(|[i, j]| self.points.at([pixel[0] + i, pixel[1] + j]));
            for (&(z, _), heights) in floors.iter().zip(&stands) {
                let Some([low, high]) = *heights else { continue };
                if !under().all(|points| points.iter().any(|(at, of)| *of == Of::Floor && (at - z).abs() <= CLIMB)) {
                    judged.not_scanned += 1;
                    continue;
                }
                judged.places += 1;
                let off = |claim: &f64| (claim - high).max(low - claim).max(0.0);
                let about = claimed.iter().filter(|claim| is_about(**claim, z));
                let Some(&claim) = about.min_by(|a, b| off(a).total_cmp(&off(b))) else {
                    if self.stands_near(pixel, z, true, SLOPE_DEG - VERDICT_DEG) {
                        judged.missed.push((pixel, z));
                    } else {
                        judged.border_missed += 1;
                    }
                    continue;
                };
                judged.worst_m = judged.worst_m.max(off(&claim));
                let is_off = off(&claim) > 0.01 + 3.0 * self.noise;
                judged.off_truth.add(is_off);
                if is_off {
                    let why = match self.ghost((pixel, claim), true) {
                        _ if claim < low => 2,
                        Some(Ghost::Edge) => 0,
                        Some(Ghost::Image) => 1,
                        None => 3,
                    };
                    let own = &mut judged.off[why];
                    *own = (own.0 + 1, own.1.max(off(&claim)));
                }
                let points = under().flatten().map(|point| point.0).filter(|at| *at <= claim + 1e-9);
                let highest = points.fold(f64::NEG_INFINITY, f64::max);
                judged.off_points.add(claim - highest > self.frame.quantum_m() + 1e-9);
            }
            for claim in claimed {
                judged.claims += 1;
                let mut at = floors.iter().zip(&stands);
                if at.any(|(floor, stands)| stands.is_some() && is_about(claim, floor.0)) {
                    continue;
                }
                let in_body = |at: f64| at > claim + FEET_M && at < claim + HEIGHT;
                let is_blocked = floors.iter().any(|floor| is_about(claim, floor.0));
                if self.stands_near(pixel, claim, false, SLOPE_DEG + VERDICT_DEG)
                    || self.stands_from_beside(pixel, claim)
                {
                    judged.border_wrong += 1;
                } else if excuse && is_blocked && !under().flatten().any(|point| in_body(point.0)) {
                    judged.unseen += 1;
                } else {
                    judged.wrong.push((pixel, claim));
                }
            }
        }
        judged
    }
}
