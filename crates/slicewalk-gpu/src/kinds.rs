//! The kinds of questions: their words for the device, the meaning of its answers, and the processor's answers.
#![allow(private_interfaces, reason = "the trait is public in name only")]

use crate::device::Program;
use crate::layout::{NONE, Place};
use crate::scene::Resident;
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use slicewalk::nalgebra::Vector3;
use slicewalk::query::{
    Aabb, Answer, Cylinder, GridExtent, Overlap, Ray, RayHit, Shape, Sphere, cast, cast_batch, first_of, floor_under,
    grid_extent, overlaps, overlaps_batch,
};
use slicewalk::store::Snapshot;

/// An answer, or that it depends on pages that are not in memory. To learn which ones, ask the query of
/// [`slicewalk::query`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply<T> {
    /// The answer.
    Known(T),
    /// Pages that are not in memory could change the answer.
    NotLoaded,
}

impl From<Overlap> for Reply<bool> {
    fn from(overlap: Overlap) -> Self {
        match overlap {
            Overlap::Clear => Self::Known(false),
            Overlap::Hit => Self::Known(true),
            Overlap::NotLoaded(_) => Self::NotLoaded,
        }
    }
}

impl<T> From<Answer<T>> for Reply<T> {
    fn from(answer: Answer<T>) -> Self {
        answer.known().map_or(Self::NotLoaded, Self::Known)
    }
}

/// Question for the highest floor under a box, as for [`floor_under`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Below {
    /// The box; its own heights do not count.
    pub shape: Aabb,
    /// Height at which the search begins (m).
    pub from: f64,
    /// Depth of the search [m, >= 0, may be infinite].
    pub depth: f64,
}

/// Question that a device answers: a shape ([`Aabb`], [`Cylinder`], [`Sphere`]: does it touch anything solid?), a [`Ray`]
/// (what does it hit first?), or [`Below`] (where is the floor?).
pub trait Question: sealed::Kind {}

impl<Q: sealed::Kind> Question for Q {}

/// The device's answer, or that the processor has to find it.
pub enum Found<T> {
    Answer(Reply<T>),
    Undecided,
}

pub(crate) mod sealed {
    use super::{Found, Place, Program, Reply, Resident, Snapshot};

    /// A kind of questions. Public in name only.
    pub trait Kind: Sized {
        /// Its answer.
        type Answer: Clone;
        const PROGRAM: Program;
        /// Words of a question and of an answer.
        const WORDS: usize;
        const ANSWER_WORDS: usize;

        /// Appends the words of the question; `false`, with nothing appended, if the processor has to answer.
        fn encode(&self, place: &Place, words: &mut Vec<u32>) -> bool;

        /// Returns the meaning of the device's words.
        fn decode(&self, resident: &Resident, pages: &Snapshot, words: &[u32]) -> Found<Self::Answer>;

        /// Returns the processor's answer.
        fn ask(&self, pages: &Snapshot) -> Reply<Self::Answer>;

        /// Returns the processor's answers to a batch.
        fn ask_all(pages: &Snapshot, questions: &[Self]) -> Vec<Reply<Self::Answer>> {
            questions.iter().map(|question| question.ask(pages)).collect()
        }
    }
}
use sealed::Kind;

/// Answers of shapes, as `pages.wgsl` names them.
const CLEAR: u32 = 1;
const HIT: u32 = 2;
const NOT_LOADED: u32 = 3;

/// Questions that the processor's batches answer at a time: their answers take 200 bytes and more each.
const AT_A_TIME: usize = 1 << 16;

/// Returns the answers of the library's batch `ask`; `blank` is any answer.
fn in_batches<Q, A: Copy + Into<Reply<T>>, T>(
    questions: &[Q],
    blank: A,
    ask: impl Fn(&[Q], &mut [A]),
) -> Vec<Reply<T>> {
    let mut answers = vec![blank; questions.len().min(AT_A_TIME)];
    let mut replies = Vec::with_capacity(questions.len());
    for questions in questions.chunks(AT_A_TIME) {
        let answers = &mut answers[..questions.len()];
        ask(questions, answers);
        replies.extend(answers.iter().map(|&answer| answer.into()));
    }
    replies
}

/// Most tiles under a shape; the device searches each of them, the processor skips those without pages.
const MOST_TILES: i64 = 1024;

/// An extent that meets nothing: it ends in a tile before the one in which it begins.
const NOWHERE: [i64; 6] = [64, 0, 64, 0, 1, 0];

/// Returns the extent in the scene: first and last pixel along x and y, lowest and highest height. `None` if it covers
/// too many tiles.
fn within(place: &Place, extent: &GridExtent) -> Option<[i64; 6]> {
    let [columns, rows, height] = place.size;
    let ends = |[first, last]: [i64; 2], axis: usize, size: i64| {
        [(first - place.origin[axis]).max(0), (last - place.origin[axis]).min(size - 1)]
    };
    let (i, j) = (ends(extent.i, 0, columns), ends(extent.j, 1, rows));
    // A height between two quanta has a low end above its high one, which clamping must not change.
    let [low, high] = extent.heights.map(|height| height - place.origin[2]);
    if i[0] > i[1] || j[0] > j[1] || low > height || high < 0 {
        return Some(NOWHERE);
    }
    let tiles = |[first, last]: [i64; 2]| last / TILE_PIXELS - first / TILE_PIXELS + 1;
    (tiles(i) * tiles(j) <= MOST_TILES).then_some([i[0], i[1], j[0], j[1], low.max(0), high.min(height)])
}

/// Appends integers, which must fit 32 bits.
fn push(words: &mut Vec<u32>, values: &[i64]) {
    words.extend(values.iter().map(|&value| value as i32 as u32));
}

fn push_reals(words: &mut Vec<u32>, values: &[f64]) {
    words.extend(values.iter().map(|&value| (value as f32).to_bits()));
}

/// A shape that a program of the device meets with pages.
trait DeviceShape: Shape {
    const PROGRAM: Program;
    const WORDS: usize;

    /// See [`Kind::encode`].
    fn encode(&self, place: &Place, words: &mut Vec<u32>) -> bool;
}

impl<S: DeviceShape> Kind for S {
    type Answer = bool;
    const PROGRAM: Program = S::PROGRAM;
    const WORDS: usize = S::WORDS;
    const ANSWER_WORDS: usize = 1;

    #[inline]
    fn encode(&self, place: &Place, words: &mut Vec<u32>) -> bool {
        DeviceShape::encode(self, place, words)
    }

    fn decode(&self, _: &Resident, _: &Snapshot, words: &[u32]) -> Found<bool> {
        match words[0] {
            CLEAR => Found::Answer(Reply::Known(false)),
            HIT => Found::Answer(Reply::Known(true)),
            NOT_LOADED => Found::Answer(Reply::NotLoaded),
            _ => Found::Undecided,
        }
    }

    fn ask(&self, pages: &Snapshot) -> Reply<bool> {
        overlaps(pages, self).into()
    }

    fn ask_all(pages: &Snapshot, questions: &[Self]) -> Vec<Reply<bool>> {
        in_batches(questions, Overlap::Clear, |shapes, answers| overlaps_batch(pages, shapes, answers))
    }
}

impl DeviceShape for Aabb {
    const PROGRAM: Program = Program::Boxes;
    const WORDS: usize = 6;

    #[inline]
    fn encode(&self, place: &Place, words: &mut Vec<u32>) -> bool {
        let extent = within(place, &grid_extent(&place.frame, self));
        extent.map(|extent| push(words, &extent)).is_some()
    }
}

/// Greatest radius (pixels) and length along x and y (pixels) that single precision handles with useful margins.
const MOST_RADIUS: f64 = (1 << 16) as f64;
const MOST_LENGTH: f64 = (1 << 14) as f64;
/// Greatest coordinates of round shapes and rays (pixels, pixels, quanta), so that rounding errors of the processor stay
/// far below the device's margins.
const MOST_COORDINATE: f64 = (1u64 << 31) as f64;

/// Appends the words of a cylinder or a sphere with its middle at `middle` (m).
fn encode_round(place: &Place, extent: &GridExtent, middle: [f64; 3], radius: f64, words: &mut Vec<u32>) -> bool {
    let Some(extent) = within(place, extent) else { return false };
    if extent == NOWHERE {
        push(words, &extent);
        words.extend([0; 8]);
        return true;
    }
    let frame = &place.frame;
    let on_grid = [frame.pixels(middle[0]), frame.pixels(middle[1]), frame.quanta(middle[2])];
    let radius = frame.pixels(radius);
    let small = |value: f64| value.abs() <= MOST_COORDINATE;
    if !(on_grid.into_iter().all(small) && radius <= MOST_RADIUS) {
        return false;
    }
    let cells = on_grid.map(f64::floor);
    let fractions = [0, 1, 2].map(|axis| on_grid[axis] - cells[axis]);
    let cells = [0, 1, 2].map(|axis| cells[axis] as i64 - place.origin[axis]);
    if cells.iter().any(|&cell| cell.abs() > 1 << 30) {
        return false;
    }
    // Single precision errs by at most 2⁻²¹ of a distance and 2⁻²⁴ pixels of the middle, the processor by 2⁻⁴⁶ of a
    // coordinate. The margin is several times their sum.
    let heights = on_grid[2].abs() * frame.quantum_m() / frame.pixel_m();
    let farthest = on_grid[0].abs().max(on_grid[1].abs()).max(heights);
    let quantum = frame.quantum_m() / frame.pixel_m();
    let margin = (radius + quantum + 1.0) * 2f64.powi(-18) + farthest * 2f64.powi(-43);
    let inner = radius - margin;
    push(words, &extent);
    push(words, &cells);
    push_reals(words, &fractions);
    // Negative if nothing is certainly inside.
    push_reals(words, &[if inner > 0.0 { inner * inner } else { -1.0 }, (radius + margin).powi(2)]);
    true
}

impl DeviceShape for Cylinder {
    const PROGRAM: Program = Program::Cylinders;
    const WORDS: usize = 14;

    fn encode(&self, place: &Place, words: &mut Vec<u32>) -> bool {
        let [x, y, _] = self.feet().into();
        // The heights decide as integers, so the middle's height plays no part.
        encode_round(place, &grid_extent(&place.frame, self), [x, y, 0.0], self.radius(), words)
    }
}

impl DeviceShape for Sphere {
    const PROGRAM: Program = Program::Spheres;
    const WORDS: usize = 14;

    fn encode(&self, place: &Place, words: &mut Vec<u32>) -> bool {
        encode_round(place, &grid_extent(&place.frame, self), self.center().into(), self.radius(), words)
    }
}

/// Answers of floors, as `floors.wgsl` names them.
const NO_FLOOR: i32 = -1;
const FLOOR_NOT_LOADED: i32 = -2;
const FLOOR_UNDECIDED: i32 = -3;

impl Kind for Below {
    type Answer = Option<f64>;
    const PROGRAM: Program = Program::Floors;
    const WORDS: usize = 6;
    const ANSWER_WORDS: usize = 1;

    fn encode(&self, place: &Place, words: &mut Vec<u32>) -> bool {
        let frame = &place.frame;
        let mut extent = grid_extent(frame, &self.shape);
        let lowest = if self.depth == f64::INFINITY { f64::NEG_INFINITY } else { self.from - self.depth };
        extent.heights = [frame.quantum_ceil(lowest), frame.quantum_floor(self.from)];
        if self.from.is_nan() || self.depth.is_nan() || extent.heights[0] > extent.heights[1] {
            push(words, &NOWHERE);
            return true;
        }
        within(place, &extent).map(|extent| push(words, &extent)).is_some()
    }

    fn decode(&self, resident: &Resident, _: &Snapshot, words: &[u32]) -> Found<Option<f64>> {
        let place = &resident.place;
        let height = |top: i32| place.frame.top_height(i64::from(top) + place.origin[2]);
        match words[0] as i32 - 4 {
            NO_FLOOR => Found::Answer(Reply::Known(None)),
            FLOOR_NOT_LOADED => Found::Answer(Reply::NotLoaded),
            FLOOR_UNDECIDED => Found::Undecided,
            top => Found::Answer(Reply::Known(Some(height(top)))),
        }
    }

    fn ask(&self, pages: &Snapshot) -> Reply<Option<f64>> {
        floor_under(pages, &self.shape, self.from, self.depth).into()
    }
}

/// A ray in units of the grid, from where it enters the scene.
struct Course {
    begin: [f64; 3],
    speed: [f64; 3],
    /// Units at most and at least.
    length: [f64; 2],
}

impl Course {
    /// Returns the course of `ray` through the scene; `Ok(None)` if it misses the scene, `Err` if it goes beyond what
    /// single precision handles.
    fn of(place: &Place, ray: &Ray) -> Result<Option<Self>, ()> {
        let frame = &place.frame;
        let grid = |v: &Vector3<f64>| [frame.pixels(v.x), frame.pixels(v.y), frame.quanta(v.z)];
        let (origin, speed) = (grid(&ray.origin().coords), grid(&ray.direction()));
        let (mut enter, mut leave) = (0.0f64, ray.max());
        for axis in 0..3 {
            if origin[axis].abs() > MOST_COORDINATE {
                return Err(());
            }
            // A pixel and a quantum more, far beyond every rounding error.
            let low = (place.origin[axis] - 1) as f64 - origin[axis];
            let high = (place.origin[axis] + place.size[axis] + 1) as f64 - origin[axis];
            if speed[axis].abs() < 1e-30 {
                if low > 0.0 || high < 0.0 {
                    return Ok(None);
                }
                continue;
            }
            let (a, b) = (low / speed[axis], high / speed[axis]);
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        if enter > leave {
            return Ok(None);
        }
        // Units in which the ray passes at most one pixel, or 64 quanta.
        let unit = speed[0].abs().max(speed[1].abs()).max(speed[2].abs() / 64.0);
        let length = (leave - enter) * unit;
        // Written so that NaN fails.
        if !(length <= MOST_LENGTH && unit > 0.0) {
            return Err(());
        }
        // Within these the ray ends, if it does so in the scene.
        let slack = length * 2f64.powi(-20) + 2f64.powi(-20);
        Ok(Some(Self {
            begin: [0, 1, 2].map(|axis| origin[axis] + speed[axis] * enter - place.origin[axis] as f64),
            speed: speed.map(|speed| speed / unit),
            length: [length + slack, length - slack],
        }))
    }
}

impl Kind for Ray {
    type Answer = Option<RayHit>;
    const PROGRAM: Program = Program::Rays;
    const WORDS: usize = 16;
    const ANSWER_WORDS: usize = 2;

    fn encode(&self, place: &Place, words: &mut Vec<u32>) -> bool {
        let course = match Course::of(place, self) {
            Ok(Some(course)) => course,
            Ok(None) => {
                // Lies before the scene's first pixel and has no length.
                push(words, &[-10, -10, 0]);
                words.resize(words.len() + Self::WORDS - 3, 0);
                return true;
            }
            Err(()) => return false,
        };
        let cells = course.begin.map(f64::floor);
        let fractions = [0, 1, 2].map(|axis| course.begin[axis] - cells[axis]);
        // Slower movement leads nowhere within the greatest length.
        let speed = course.speed.map(|speed| if speed.abs() < 2f64.powi(-40) { 0.0 } else { speed });
        let inverse = speed.map(|speed| if speed == 0.0 { 1e30 } else { 1.0 / speed });
        // Single precision errs by at most 2⁻²⁰ of the ray's length along each axis. The margins are several times that.
        let across = 2f64.powi(-12) + course.length[0] * 2f64.powi(-19);
        let along_z = 2f64.powi(-9) + course.length[0] * speed[2].abs() * 2f64.powi(-19);
        push(words, &cells.map(|cell| cell as i64));
        push_reals(words, &fractions);
        push_reals(words, &speed);
        push_reals(words, &inverse);
        push_reals(words, &course.length);
        push_reals(words, &[across, along_z]);
        true
    }

    fn decode(&self, resident: &Resident, pages: &Snapshot, words: &[u32]) -> Found<Option<RayHit>> {
        let (slot, place) = match words[0] {
            1 => return Found::Answer(Reply::Known(None)),
            NONE => return Found::Undecided,
            number => (number.wrapping_sub(2), words[1]),
        };
        let Some(key) = resident.keys.get(slot as usize) else { return Found::Undecided };
        let (x, y, first, count) = (place & 63, place >> 6 & 63, place >> 12 & 1023, place >> 22);
        let slots = pages.column(key.tx, key.ty);
        let page = slots.iter().find(|slot| slot.layer() == key.layer).and_then(|slot| slot.page());
        let spans = page.and_then(|page| page.column(x, y).get(first as usize..(first + count) as usize));
        let pixel = [(key.tx, x), (key.ty, y)].map(|(tile, pixel)| i64::from(tile) * TILE_PIXELS + i64::from(pixel));
        match spans.and_then(|spans| first_of(&resident.place.frame, self, pixel, key.layer, spans)) {
            Some(hit) => Found::Answer(Reply::Known(Some(hit))),
            None => Found::Undecided,
        }
    }

    fn ask(&self, pages: &Snapshot) -> Reply<Option<RayHit>> {
        cast(pages, self).into()
    }

    fn ask_all(pages: &Snapshot, questions: &[Self]) -> Vec<Reply<Option<RayHit>>> {
        in_batches(questions, Answer::Known(None), |rays, answers| cast_batch(pages, rays, answers))
    }
}

const _: () = assert!(PAGE_QUANTA == 16320 && TILE_PIXELS == 64, "the shaders have these numbers");
