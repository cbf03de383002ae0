//! Narrow places between wider ones: doors, corridors, gaps.
//!
//! The clearance of the places is a landscape whose peaks are the middles of rooms. Places are added from the highest
//! down. Where two rooms meet that are both clearly wider than their meeting place, they stay apart (a watershed with a
//! least prominence), and each place belongs to the room of its highest neighbour; otherwise the smaller one joins the
//! larger. Each stretch along which two rooms touch is a candidate, at its widest place.
//!
//! It is a passage if it separates the rooms: the same border of the region lies on both sides, so that there is no way
//! around, or borders at least twice as long as the passage is wide. Free-standing things on open ground make no
//! passage: a pole, a pit, a rough patch.

use super::pawn::WAYS;
use super::region::{NO_PLACE, Region, middle};
use nalgebra::Point3;

/// A room is at least this factor and this number of pixels wider than its passages.
const WIDER: f64 = 1.25;
const WIDER_PIXELS: f64 = 2.0;
/// Least area of a room (m²), which is also at least the square of the passage's width. Smaller ones are niches.
const LEAST_M2: f64 = 0.25;
/// A border that lies on one side only is at least this factor longer than the passage is wide.
const LONGER: f64 = 2.0;

/// A narrow place between two wider ones.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Passage {
    /// Middle of the passage, on the floor (m).
    pub at: Point3<f64>,
    /// Clear width, exact to a pixel (m).
    pub width: f64,
    /// The two rooms that it joins, each by the place with the most clearance (m).
    pub rooms: [Point3<f64>; 2],
}

struct Room {
    parent: u32,
    /// Its place with the most clearance, and that clearance.
    middle: u32,
    peak: f32,
    places: usize,
}

fn root(rooms: &[Room], mut room: u32) -> u32 {
    while rooms[room as usize].parent != room {
        room = rooms[room as usize].parent;
    }
    room
}

impl Region {
    /// Returns the passages between the rooms of the region, narrowest first.
    pub fn passages(&self) -> Vec<Passage> {
        let higher = |a: &u32, b: &u32| {
            let clearance = |place: &u32| self.clearances[*place as usize];
            clearance(b).total_cmp(&clearance(a)).then(a.cmp(b))
        };
        let mut order: Vec<u32> = (0..self.len() as u32).collect();
        order.sort_unstable_by(higher);
        let mut rooms: Vec<Room> = Vec::new();
        let mut room_of = vec![NO_PLACE; self.len()];
        let pixel = self.grid.frame.pixel_m();
        for &place in &order {
            let own = self.clearances[place as usize];
            let mut beside: Vec<u32> = self
                .around(place)
                .map(|next| room_of[next as usize])
                .filter(|r| *r != NO_PLACE)
                .map(|room| root(&rooms, room))
                .collect();
            beside.sort_by(|a, b| rooms[*b as usize].peak.total_cmp(&rooms[*a as usize].peak).then(a.cmp(b)));
            beside.dedup();
            let Some(&main) = beside.first() else {
                room_of[place as usize] = rooms.len() as u32;
                rooms.push(Room { parent: rooms.len() as u32, middle: place, peak: own, places: 1 });
                continue;
            };
            for &other in &beside[1..] {
                let is_room = f64::from(rooms[other as usize].peak) >= f64::from(own) * WIDER + WIDER_PIXELS * pixel
                    && self.area_of(rooms[other as usize].places) >= LEAST_M2.max((2.0 * f64::from(own)).powi(2));
                if !is_room {
                    rooms[other as usize].parent = main;
                    rooms[main as usize].places += rooms[other as usize].places;
                }
            }
            // Uphill: from a neighbour as high, the room would spread along the walls of the other one.
            let uphill = self.around(place).filter(|next| room_of[*next as usize] != NO_PLACE).min_by(higher);
            let room = uphill.map_or(main, |uphill| root(&rooms, room_of[uphill as usize]));
            room_of[place as usize] = room;
            rooms[room as usize].places += 1;
        }
        for room in &mut room_of {
            *room = root(&rooms, *room);
        }
        self.stretches(&room_of, &rooms)
    }

    /// Returns the passages among the stretches along which two rooms touch, each at the widest place of its stretch.
    fn stretches(&self, room_of: &[u32], rooms: &[Room]) -> Vec<Passage> {
        let clearance = |place: u32| self.clearances[place as usize];
        let across =
            |place: u32| self.around(place).filter(move |next| room_of[*next as usize] != room_of[place as usize]);
        // The narrower one of two places that touch.
        let is_narrower =
            |place: &u32| across(*place).any(|next| (clearance(*place), *place) < (clearance(next), next));
        let mut borders: Vec<u32> = (0..self.len() as u32).filter(is_narrower).collect();
        borders.sort_by(|a, b| clearance(*b).total_cmp(&clearance(*a)).then(a.cmp(b)));
        let ends = Borders::new(self);
        let (mut taken, mut is_middle) = (vec![false; self.len()], vec![false; self.len()]);
        let mut level_of = vec![NO_PLACE; self.len()];
        let mut passages = Vec::new();
        for place in borders {
            if taken[place as usize] {
                continue;
            }
            let middle = self.middle_of_its_level(place, &mut level_of);
            if self.standing[middle as usize] && !std::mem::replace(&mut is_middle[middle as usize], true) {
                let beyond = across(place).next().unwrap_or(place);
                let joined = [place, beyond].map(|place| rooms[room_of[place as usize] as usize].middle);
                passages.extend(self.passage(middle, &ends, joined.map(|middle| self.feet(middle))));
            }
            // The rest of the stretch, on both sides of it.
            let mut open = vec![place];
            while let Some(place) = open.pop() {
                let near = self.around(place).chain([place]).filter(|next| across(*next).next().is_some());
                open.extend(near.filter(|next| !std::mem::replace(&mut taken[*next as usize], true)));
            }
        }
        passages.sort_by(|a, b| a.width.total_cmp(&b.width));
        passages
    }

    /// Returns the middle of the connected places with the same clearance as `place` and no more beside them: along a corridor
    /// all are as narrow, while along a wall of a room there is more clearance on the other side.
    /// `level_of` keeps the last place for which each place was visited.
    fn middle_of_its_level(&self, place: u32, level_of: &mut [u32]) -> u32 {
        let clearance = |place: u32| self.clearances[place as usize];
        let own = clearance(place);
        let (mut level, mut next) = (vec![place], 0);
        level_of[place as usize] = place;
        while next < level.len() {
            let is_ridge =
                |other: &u32| clearance(*other) == own && self.around(*other).all(|beside| clearance(beside) <= own);
            for other in self.around(level[next]).filter(is_ridge) {
                if std::mem::replace(&mut level_of[other as usize], place) != place {
                    level.push(other);
                }
            }
            next += 1;
        }
        middle(&level, |place| self.pixels[*place as usize]).unwrap_or(place)
    }

    /// Returns the neighbours along the axes.
    fn around(&self, place: u32) -> impl Iterator<Item = u32> + '_ {
        self.links[place as usize].iter().copied().filter(|link| *link != NO_PLACE)
    }

    /// Returns the passage at a place, if there is one. Its clear width leads from one end of the region across the
    /// place to the end on the other side.
    fn passage(&self, place: u32, borders: &Borders, rooms: [Point3<f64>; 2]) -> Option<Passage> {
        let pixel = self.grid.frame.pixel_m();
        let clear = |place: u32| f64::from(self.clearances[place as usize]) / pixel;
        // The shortest of eight lines through the place.
        let across = |by: [i32; 2]| {
            let far = |by: [i32; 2]| {
                let (mut at, mut steps, mut width) = (place, 0.0, clear(place));
                while let Some(next) = self.hop(at, by) {
                    (at, steps) = (next, steps + f64::from(by[0]).hypot(f64::from(by[1])));
                    // Beyond that only the body hangs over the edge.
                    if width > 0.0 && clear(at) > 0.0 {
                        width = steps + clear(at);
                    }
                }
                (width, self.end_beside(at, by))
            };
            let [(one, first), (other, last)] = [far(by), far(by.map(|v| -v))];
            (one + other, [first, last])
        };
        let ways = [[1, 0], [0, 1], [1, 1], [1, -1], [2, 1], [1, 2], [2, -1], [1, -2]];
        let (pixels, ends) = ways.into_iter().map(across).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let [one, other] = ends.map(|end| end.and_then(|end| borders.number(end)));
        let is_long = |border: Option<usize>| {
            border.is_some_and(|border| borders.length(border, self.grid.half) >= LONGER * pixels)
        };
        let separates = one == other || is_long(one) && is_long(other);
        // If the middle of the body hangs over an edge on both sides, no ground leads across.
        (separates && pixels >= 1.0).then(|| Passage { at: self.feet(place), width: pixels * pixel, rooms })
    }

    /// Returns the step without a link between a place and the pixel a few pixels away.
    fn end_beside(&self, place: u32, by: [i32; 2]) -> Option<(u32, usize)> {
        let mut at = place;
        for (axis, by) in by.into_iter().enumerate() {
            let way = if by > 0 { axis } else { axis + 2 };
            for _ in 0..by.abs() {
                match self.links[at as usize][way] {
                    NO_PLACE => return Some((at, way)),
                    next => at = next,
                }
            }
        }
        None
    }

    /// Returns the place a few pixels away, following links along one axis and then along the other.
    fn hop(&self, place: u32, by: [i32; 2]) -> Option<u32> {
        let go = |from: u32, way: usize, count: i32| {
            (0..count).try_fold(from, |at, _| Some(self.links[at as usize][way]).filter(|link| *link != NO_PLACE))
        };
        let way = |axis: usize| if by[axis] > 0 { axis } else { axis + 2 };
        debug_assert!(WAYS[way(0)][0].signum() == by[0].signum() || by[0] == 0);
        let first = |axes: [usize; 2]| {
            let middle = go(place, way(axes[0]), by[axes[0]].abs())?;
            go(middle, way(axes[1]), by[axes[1]].abs())
        };
        first([0, 1]).or_else(|| first([1, 0]))
    }
}

/// Borders of a region: closed lines of steps that lead nowhere.
struct Borders {
    steps: Vec<(u32, usize)>,
    border_of: Vec<usize>,
    /// Least and greatest pixel beyond each border along x and y, and whether ground is missing there.
    extents: Vec<([[i32; 2]; 2], bool)>,
}

impl Borders {
    fn new(region: &Region) -> Self {
        let links = &region.links;
        let ways = |place: u32| (0..WAYS.len()).filter(move |way| links[place as usize][*way] == NO_PLACE);
        let steps: Vec<(u32, usize)> =
            (0..links.len() as u32).flat_map(|place| ways(place).map(move |way| (place, way))).collect();
        let number = |step: (u32, usize)| steps.binary_search(&step).ok();
        // The next step along the border, which lies to the right.
        let next = |(place, way): (u32, usize)| {
            let side = (way + 1) & 3;
            let beside = links[place as usize][side];
            if beside == NO_PLACE {
                return number((place, side));
            }
            match links[beside as usize][way] {
                NO_PLACE => number((beside, way)),
                corner => number((corner, (way + 3) & 3)),
            }
        };
        let mut border_of = vec![usize::MAX; steps.len()];
        let mut extents: Vec<([[i32; 2]; 2], bool)> = Vec::new();
        for first in 0..steps.len() {
            let mut at = Some(first).filter(|first| border_of[*first] == usize::MAX);
            if at.is_some() {
                extents.push(([[i32::MAX; 2], [i32::MIN; 2]], false));
            }
            while let Some(step) = at.filter(|step| border_of[*step] == usize::MAX) {
                border_of[step] = extents.len() - 1;
                let (place, way) = steps[step];
                let Some(([low, high], is_open)) = extents.last_mut() else { break };
                for axis in 0..2 {
                    let pixel = region.pixels[place as usize][axis] + WAYS[way][axis];
                    (low[axis], high[axis]) = (low[axis].min(pixel), high[axis].max(pixel));
                }
                *is_open |= region.clearances[place as usize] == 0.0;
                at = next((place, way));
            }
        }
        Self { steps, border_of, extents }
    }

    fn number(&self, step: (u32, usize)) -> Option<usize> {
        self.steps.binary_search(&step).ok().map(|step| self.border_of[step])
    }

    /// Returns the extent along x or y of what ends the region there (pixels): the body stays half of its width away
    /// from solid, and hangs as far over gaps.
    fn length(&self, border: usize, half: [i32; 2]) -> f64 {
        let ([low, high], is_open) = self.extents[border];
        let along = |axis: usize| high[axis] - low[axis] + 1 + if is_open { 2 } else { -2 } * half[axis];
        f64::from(along(0).max(along(1)))
    }
}
