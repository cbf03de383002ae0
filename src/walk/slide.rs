//! Walking by exact sweeps: forward, up steps, along walls, down to the ground.

use super::{Config, FLOOR_NEAR_M, Ground, Motion, Needs, Stop, known, pixels_beside};
use crate::query::SweepHit;
use crate::store::Snapshot;
use nalgebra::{Point3, Vector2, Vector3};
use std::ops::ControlFlow;

/// Most contacts that one stride handles.
const CONTACTS: usize = 4;
/// Longest stride (m). Whether the pawn can climb depends on what is under the body at the end of the stride.
const STRIDE_M: f64 = 0.25;
/// Distance from the wall of a detour around an edge (pixels). [`GAIN`] is the least progress against the wall that it
/// must allow.
const OFF: f64 = 0.3;
/// Longest detour (pixels).
pub(super) const EDGE_PIXELS: f64 = 4.0;
const GAIN: f64 = 0.35;
/// Most changes of the side on which a pawn goes around edges until it has walked [`FREE`] pixels without contact.
/// Without a limit it might alternate between two edges for ever.
const CHANGES: u32 = 2;
const FREE: f64 = 4.0;
/// Most detours without getting [`AWAY`] pixels from where the first one began: each gains a third of a pixel, but the
/// move input may lead back.
const DETOURS: u32 = 12;
const AWAY: f64 = 4.0;
/// Extra length of a detour where there is room (pixels).
const CLEAR: f64 = 0.02;
/// Bisection steps for the end of a detour within its pixel.
const NARROWINGS: usize = 3;
/// Overlap that counts as touching (pixels).
const TOUCH: f64 = 1e-5;
/// Moves shorter than this count as zero (m).
const NOTHING_M: f64 = 1e-9;
/// Heights closer than this count as equal (m): rounding errors at 10⁷ m.
pub(super) const LEVEL_M: f64 = 1e-7;

/// Runs one tick: `way` across the ground, then down.
pub(super) fn tick(config: &Config, set: &Snapshot, motion: &mut Motion, way: Vector2<f64>) -> Needs<Option<Stop>> {
    let mut attempt = Attempt { config, set, motion, stop: None };
    let strides = (way.norm() / STRIDE_M).ceil().max(1.0);
    let mut first = attempt.get_out(way / strides)?;
    let mut falls = attempt.motion.ground == Ground::Air;
    for _ in 0..strides as u64 {
        let before = attempt.motion.feet;
        let stride = way / strides;
        if !attempt.go_around(stride)? {
            attempt.stride(stride, first.take())?;
        }
        if attempt.motion.ground != Ground::Air {
            attempt.stand()?;
            falls |= attempt.motion.ground == Ground::Air;
        }
        if attempt.motion.feet == before {
            // The next stride would not move it either.
            break;
        }
    }
    if falls {
        attempt.fall()?;
    }
    ControlFlow::Continue(attempt.stop)
}

struct Attempt<'a> {
    config: &'a Config,
    set: &'a Snapshot,
    motion: &'a mut Motion,
    stop: Option<Stop>,
}

impl Attempt<'_> {
    fn sweep(&self, feet: Point3<f64>, by: Vector3<f64>) -> Needs<Option<SweepHit>> {
        known(self.config.body.sweep(self.set, feet, by))
    }

    /// Returns the height up to which the pawn may step now.
    fn limit(&self) -> f64 {
        self.motion.floor_z.max(self.motion.feet.z - self.config.climb) + self.reach()
    }

    /// Returns the height of the floor that a pawn with its feet at `feet` stands on: the highest one under the
    /// footprint at most [`FLOOR_NEAR_M`] below the feet. Otherwise, because the edge of a step is an obstacle, the highest
    /// one beside the footprint within the same distance below the feet, or else above them.
    fn floor_at(&self, feet: Point3<f64>) -> Needs<Option<f64>> {
        let under = self.config.body.floor(self.set, feet, feet.z + LEVEL_M, FLOOR_NEAR_M + LEVEL_M);
        if let floor @ Some(_) = known(under)? {
            return ControlFlow::Continue(floor);
        }
        for from in [LEVEL_M, FLOOR_NEAR_M + LEVEL_M] {
            if let floor @ Some(_) = self.floor_beside(feet, feet.z + from)? {
                return ControlFlow::Continue(floor);
            }
        }
        ControlFlow::Continue(None)
    }

    /// Returns the highest floor within [`BESIDE_M`](super::BESIDE_M) of the footprint, from `from` down to
    /// [`FLOOR_NEAR_M`] below the feet.
    fn floor_beside(&self, feet: Point3<f64>, from: f64) -> Needs<Option<f64>> {
        // Whole pixels, but without touching the next one.
        let pixel = self.set.frame().pixel_m();
        let margin = (f64::from(pixels_beside(pixel)) - TOUCH) * pixel;
        let depth = from - feet.z + FLOOR_NEAR_M + LEVEL_M;
        known(self.config.body.floor_around(self.set, feet, margin, from, depth))
    }

    /// Returns the climb height plus a quantum: floors are rounded to quanta, so a step of exactly the climb height may
    /// be stored one quantum higher.
    fn reach(&self) -> f64 {
        self.config.climb + self.set.frame().quantum_m() + LEVEL_M
    }

    /// Moves the pawn out of something solid that it was placed in, or that has been loaded around it. Returns the
    /// obstruction of the first `stride` where the query has found it along the way.
    fn get_out(&mut self, stride: Vector2<f64>) -> Needs<Option<Option<SweepHit>>> {
        let feet = self.motion.feet;
        // Any sweep shows whether the pawn is inside, so use the stride, unless a detour replaces it.
        let is_way = stride.norm() >= NOTHING_M && self.motion.detour == Vector2::zeros();
        let hit = self.sweep(feet, if is_way { stride.push(0.0) } else { Vector3::zeros() })?;
        if !hit.is_some_and(|hit| hit.begins_inside()) {
            return ControlFlow::Continue(is_way.then_some(hit));
        }
        self.stop = Some(Stop::Inside);
        let max = self.config.climb.max(self.config.body.half().max());
        if let Some(out) = known(self.config.body.escape(self.set, feet, max))? {
            self.motion.feet += out;
        }
        ControlFlow::Continue(None)
    }

    /// Moves across the ground by `way`, over steps and along walls; `first` is the result of the first sweep, if
    /// known.
    fn stride(&mut self, way: Vector2<f64>, mut first: Option<Option<SweepHit>>) -> Needs<()> {
        let mut rest = way;
        let mut wall: Option<Vector2<f64>> = None;
        for _ in 0..CONTACTS {
            if rest.norm() < NOTHING_M {
                break;
            }
            let hit = match first.take() {
                Some(hit) => hit,
                None => self.sweep(self.motion.feet, rest.push(0.0))?,
            };
            let Some(hit) = hit else {
                self.motion.feet += rest.push(0.0);
                if wall.is_none() {
                    self.note_free(rest.norm());
                }
                return ControlFlow::Continue(());
            };
            if hit.begins_inside() {
                self.stop = Some(Stop::Inside);
                return ControlFlow::Continue(());
            }
            self.motion.feet += (rest * hit.fraction).push(0.0);
            rest *= 1.0 - hit.fraction;
            if rest.norm() < NOTHING_M {
                break;
            }
            let mut reason = Stop::Wall;
            if self.motion.ground != Ground::Air {
                match self.climb(rest, &hit)? {
                    Step::Done(gone) => {
                        rest *= 1.0 - gone;
                        continue;
                    }
                    Step::Refused(why) => reason = why,
                }
            }
            self.stop = Some(reason);
            let normal = hit.normal.xy();
            let into = -rest.dot(&normal).min(0.0);
            rest += normal * into;
            if self.round_the_edge(normal, into, rest, way)? {
                break;
            }
            // Between two walls, or turned back: the stride ends in the corner.
            if rest.dot(&way) <= 0.0 || wall.is_some_and(|wall| rest.dot(&wall) < -NOTHING_M) {
                if rest.norm() > NOTHING_M {
                    self.stop = Some(Stop::Corner);
                }
                break;
            }
            wall = Some(normal);
        }
        ControlFlow::Continue(())
    }

    /// Counts a move without contact; after enough of them the pawn may go around the next edge on either side.
    fn note_free(&mut self, way: f64) {
        self.motion.free += way;
        if self.motion.free > FREE * self.set.frame().pixel_m() {
            (self.motion.hand, self.motion.changes) = (0.0, 0);
        }
    }

    /// Returns whether another detour is allowed: the last ones led away from where they began, or the pawn has turned
    /// since.
    fn may_go_around(&mut self, wanted: Vector2<f64>) -> bool {
        let motion = &mut *self.motion;
        let away = (motion.feet.xy() - motion.detours_from).norm() > AWAY * self.set.frame().pixel_m();
        let turned = wanted.dot(&motion.detours_for) < 0.9 * wanted.norm() * motion.detours_for.norm();
        if away || turned || motion.detours == 0 {
            (motion.detours_from, motion.detours_for, motion.detours) = (motion.feet.xy(), wanted, 0);
        }
        motion.detours < DETOURS
    }

    /// Continues a detour around an edge, if there is one and the pawn still wants past the edge. Returns whether it
    /// did.
    fn go_around(&mut self, way: Vector2<f64>) -> Needs<bool> {
        let rest = self.motion.detour;
        if rest == Vector2::zeros() {
            return ControlFlow::Continue(false);
        }
        if self.motion.ground == Ground::Air || way.dot(&self.motion.detour_for) < NOTHING_M {
            self.motion.detour = Vector2::zeros();
            return ControlFlow::Continue(false);
        }
        let length = rest.norm();
        let by = rest * (way.norm() / length).min(1.0);
        let hit = self.sweep(self.motion.feet, by.push(0.0))?;
        let share = hit.map_or(1.0, |hit| hit.fraction);
        self.motion.feet += (by * share).push(0.0);
        let ends = hit.is_some() || by == rest;
        self.motion.detour = if ends { Vector2::zeros() } else { rest - by };
        self.stop = Some(Stop::Wall);
        ControlFlow::Continue(true)
    }

    /// Starts a detour sideways if up to three pixels to the side the path into the wall with this `normal` is free.
    ///
    /// A wall that crosses the grid is a staircase of pixel edges. A box would stop at each edge and a cylinder between
    /// two of them, although both slide along the true wall. So the pawn goes around the edges, over several ticks.
    fn round_the_edge(
        &mut self,
        normal: Vector2<f64>,
        into: f64,
        along: Vector2<f64>,
        wanted: Vector2<f64>,
    ) -> Needs<bool> {
        if along.norm() >= into || into < NOTHING_M || !self.may_go_around(wanted) {
            return ControlFlow::Continue(false);
        }
        let (feet, pixel) = (self.motion.feet, self.set.frame().pixel_m());
        let left = Vector2::new(-normal.y, normal.x);
        let side = if along.dot(&left) < 0.0 { -left } else { left };
        // A little off the wall, because a round body may rest between two edges.
        let off = if normal.amax() < 0.999 { OFF } else { 0.0 };
        // Against the direction along the wall only if that is closed or nearly zero.
        let closed = along.norm() < 0.25 * into
            || self.sweep(feet, (side * pixel).push(0.0))?.is_some_and(|hit| hit.fraction < 0.5);
        for pixels in [1.0, 2.0, 3.0] {
            for side in [side, -side] {
                if side.dot(&along) < 0.0 && (!closed || along.norm() * pixels >= into) {
                    continue;
                }
                let hand = side.dot(&left);
                let changes = self.motion.changes + u32::from(hand * self.motion.hand < 0.0);
                if changes > CHANGES {
                    continue;
                }
                let way = |pixels: f64, off: f64| (side * pixels + normal * off) * pixel;
                if !self.is_way_around(way(pixels, off), normal * pixel, off)? {
                    continue;
                }
                // No farther aside and off than necessary: the path should stay near the true wall.
                let ([mut short, mut long], [mut near, mut far]) = ([pixels - 1.0, pixels], [0.0, off]);
                for _ in 0..NARROWINGS {
                    let middle = (short + long) / 2.0;
                    let is_way = self.is_way_around(way(middle, off), normal * pixel, off)?;
                    *(if is_way { &mut long } else { &mut short }) = middle;
                }
                for _ in 0..NARROWINGS.min((off * 100.0) as usize) {
                    let middle = (near + far) / 2.0;
                    let is_way = self.is_way_around(way(long, middle), normal * pixel, middle)?;
                    *(if is_way { &mut far } else { &mut near }) = middle;
                }
                // Clear of the edge, so that the next contact is not with its corner, which would turn the pawn back.
                let clear = long + CLEAR;
                if self.is_way_around(way(clear, far), normal * pixel, far)? {
                    long = clear;
                }
                (self.motion.detour, self.motion.detour_for) = (way(long, far), -normal);
                (self.motion.hand, self.motion.changes, self.motion.free) = (hand, changes, 0.0);
                self.motion.detours += 1;
                return ControlFlow::Continue(true);
            }
        }
        ControlFlow::Continue(false)
    }

    /// Returns whether the pawn can move `aside` and then far enough against the wall, whose normal is `pixel` scaled
    /// to a pixel.
    fn is_way_around(&self, aside: Vector2<f64>, pixel: Vector2<f64>, off: f64) -> Needs<bool> {
        let aside = aside.push(0.0);
        if self.sweep(self.motion.feet, aside)?.is_some() {
            return ControlFlow::Continue(false);
        }
        let on = self.sweep(self.motion.feet + aside, (-pixel * (1.0 + off)).push(0.0))?;
        ControlFlow::Continue(on.is_none_or(|hit| hit.fraction * (1.0 + off) >= off + GAIN))
    }

    /// Moves up, forward by `rest` and down if the obstruction `hit` is a step with floor on it.
    fn climb(&mut self, rest: Vector2<f64>, hit: &SweepHit) -> Needs<Step> {
        let (feet, limit) = (self.motion.feet, self.limit());
        if hit.heights[1] > limit {
            return ControlFlow::Continue(Step::Refused(Stop::Wall));
        }
        // Up to the highest top within reach; or only just over the obstruction, because there may be no room above
        // what lies behind it.
        let end = feet + rest.push(0.0);
        let highest = known(self.config.body.top(self.set, end, limit, limit - feet.z))?;
        let mut refused = Stop::Wall;
        let first = highest.map_or(hit.heights[1], |top| top.max(hit.heights[1]));
        for top in [first, hit.heights[1]] {
            match self.climb_to(top, rest, limit)? {
                Step::Done(gone) => return ControlFlow::Continue(Step::Done(gone)),
                Step::Refused(why) => refused = why,
            }
            if first == hit.heights[1] {
                break;
            }
        }
        ControlFlow::Continue(Step::Refused(refused))
    }

    fn climb_to(&mut self, top: f64, rest: Vector2<f64>, limit: f64) -> Needs<Step> {
        let feet = self.motion.feet;
        let lift = Vector3::new(0.0, 0.0, top - feet.z);
        if self.sweep(feet, lift)?.is_some() {
            return ControlFlow::Continue(Step::Refused(Stop::Headroom));
        }
        let raised = Point3::new(feet.x, feet.y, top);
        let ahead = self.sweep(raised, rest.push(0.0))?;
        let gone = ahead.map_or(1.0, |hit| hit.fraction);
        if rest.norm() * gone < NOTHING_M {
            // A lintel that is too low, or more wall behind the step.
            let lowest = limit.max(feet.z + self.config.body.height() / 2.0);
            let over = ahead.is_some_and(|hit| hit.heights[0] > lowest);
            return ControlFlow::Continue(Step::Refused(if over { Stop::Headroom } else { Stop::Wall }));
        }
        let mut to = raised + (rest * gone).push(0.0);
        // Down at most by the rise; `stand` handles what is lower.
        match self.sweep(to, -lift)? {
            Some(hit) if hit.normal.z > 0.5 => to.z = hit.heights[1],
            Some(_) => {}
            None => to.z = feet.z,
        }
        if to.z > feet.z + LEVEL_M && self.floor_beside(to, limit)?.is_none() {
            return ControlFlow::Continue(Step::Refused(Stop::Steep));
        }
        self.motion.feet = to;
        ControlFlow::Continue(Step::Done(gone))
    }

    /// Moves down to the ground, at most by the climb height; without ground, the pawn starts to fall.
    fn stand(&mut self) -> Needs<()> {
        let feet = self.motion.feet;
        let down = Vector3::new(0.0, 0.0, -self.reach());
        match self.sweep(feet, down)? {
            Some(hit) if hit.begins_inside() => self.stop = Some(Stop::Inside),
            Some(hit) => {
                // The stored height, not a sum of moves, so that a standing pawn keeps exactly the same height.
                self.motion.feet.z = hit.heights[1];
                self.note_ground(&hit)?;
            }
            None => self.motion.ground = Ground::Air,
        }
        ControlFlow::Continue(())
    }

    /// Records what the pawn stands on after it came down on `hit`, and the floor from which its next climb is
    /// measured.
    fn note_ground(&mut self, hit: &SweepHit) -> Needs<()> {
        let feet = self.motion.feet;
        // If floor stopped it, no floor under it is higher.
        let floor = if hit.obstacle { self.floor_at(feet)? } else { Some(feet.z) };
        self.motion.ground = if floor.is_some() { Ground::Floor } else { Ground::Obstacle };
        self.motion.floor_z = floor.unwrap_or(self.motion.floor_z.min(feet.z));
        self.motion.falling = 0.0;
        ControlFlow::Continue(())
    }

    /// Runs one tick of free fall or of a jump, up to the first contact.
    fn fall(&mut self) -> Needs<()> {
        let config = self.config;
        let before = self.motion.falling;
        let after = (before + config.gravity * config.tick_s).min(config.terminal);
        let down = (before + after) * 0.5 * config.tick_s;
        match self.sweep(self.motion.feet, Vector3::new(0.0, 0.0, -down))? {
            Some(hit) if hit.begins_inside() => self.stop = Some(Stop::Inside),
            Some(hit) if down < 0.0 => {
                self.motion.feet.z -= down * hit.fraction;
                self.motion.falling = 0.0;
            }
            Some(hit) => {
                self.motion.feet.z = hit.heights[1];
                self.motion.floor_z = self.motion.feet.z;
                self.note_ground(&hit)?;
            }
            None => {
                self.motion.feet.z -= down;
                (self.motion.ground, self.motion.falling) = (Ground::Air, after);
            }
        }
        ControlFlow::Continue(())
    }
}

/// Outcome of an attempt to climb.
enum Step {
    /// The pawn went up, and forward by this share of the move.
    Done(f64),
    Refused(Stop),
}
