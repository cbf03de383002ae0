//! Narrow places between wider ones: doors, corridors, gaps.
//!
//! The clearance of the places is a landscape whose peaks are the middles of rooms. Places are taken from the highest down; where
//! two rooms meet that are both clearly wider than their meeting place, they stay apart (a watershed with a least
//! prominence), else the smaller joins the larger. Each stretch along which two rooms touch is a passage, at its widest place.

use super::region::{NO_PLACE, Region, WAYS, middle};
use nalgebra::Point3;
use std::collections::HashSet;

/// A room is wider than its passages by this factor at least, and by so many pixels.
const WIDER: f64 = 1.25;
const WIDER_PIXELS: f64 = 2.0;
/// Least area of a room (m²): smaller ones are niches.
const LEAST_M2: f64 = 0.25;

/// A narrow place between two wider ones.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Passage {
    /// Its middle, on the floor (m).
    pub at: Point3<f64>,
    /// Clear width across it, within a pixel (m).
    pub width: f64,
}

struct Room {
    parent: u32,
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
    /// The passages between the rooms of the region, narrowest first.
    pub fn passages(&self) -> Vec<Passage> {
        let mut order: Vec<u32> = (0..self.len() as u32).collect();
        order.sort_unstable_by(|a, b| {
            let clearance = |place: &u32| self.clearances[*place as usize];
            clearance(b).total_cmp(&clearance(a)).then(a.cmp(b))
        });
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
                rooms.push(Room { parent: rooms.len() as u32, peak: own, places: 1 });
                continue;
            };
            for &other in &beside[1..] {
                let is_room = f64::from(rooms[other as usize].peak) >= f64::from(own) * WIDER + WIDER_PIXELS * pixel
                    && self.area_of(rooms[other as usize].places) >= LEAST_M2;
                if !is_room {
                    rooms[other as usize].parent = main;
                    rooms[main as usize].places += rooms[other as usize].places;
                }
            }
            room_of[place as usize] = main;
            rooms[main as usize].places += 1;
        }
        for room in &mut room_of {
            *room = root(&rooms, *room);
        }
        self.stretches(&room_of)
    }

    /// Of each stretch along which two rooms touch the widest place.
    fn stretches(&self, room_of: &[u32]) -> Vec<Passage> {
        let clearance = |place: u32| self.clearances[place as usize];
        let across =
            |place: u32| self.around(place).filter(move |next| room_of[*next as usize] != room_of[place as usize]);
        // Of two places that touch the narrower one.
        let is_narrower =
            |place: &u32| across(*place).any(|next| (clearance(*place), *place) < (clearance(next), next));
        let mut borders: Vec<u32> = (0..self.len() as u32).filter(is_narrower).collect();
        borders.sort_by(|a, b| clearance(*b).total_cmp(&clearance(*a)).then(a.cmp(b)));
        let mut taken: HashSet<u32> = HashSet::new();
        let mut passages = Vec::new();
        for place in borders {
            if taken.contains(&place) {
                continue;
            }
            passages.push(self.passage(self.middle_of_its_level(place)));
            // The rest of the stretch, on both of its sides.
            let mut open = vec![place];
            while let Some(place) = open.pop() {
                let near = self.around(place).chain([place]).filter(|next| across(*next).next().is_some());
                open.extend(near.filter(|next| taken.insert(*next)));
            }
        }
        passages.sort_by(|a, b| a.width.total_cmp(&b.width));
        passages
    }

    /// Along a corridor all places are as narrow: the one in its middle.
    fn middle_of_its_level(&self, place: u32) -> u32 {
        let (mut level, mut next) = (vec![place], 0);
        let mut seen = HashSet::from([place]);
        while next < level.len() {
            let same = |other: &u32| self.clearances[*other as usize] == self.clearances[place as usize];
            let more: Vec<u32> = self.around(level[next]).filter(same).filter(|other| seen.insert(*other)).collect();
            level.extend(more);
            next += 1;
        }
        middle(&level, |place| self.pixels[*place as usize]).unwrap_or(place)
    }

    /// Neighbours along the axes.
    fn around(&self, place: u32) -> impl Iterator<Item = u32> + '_ {
        self.links[place as usize].iter().copied().filter(|link| *link != NO_PLACE)
    }

    /// The clear width: from the nearest end of the region across the place to the end on the other side.
    fn passage(&self, place: u32) -> Passage {
        // The narrowest of eight lines through the place.
        let across = |[dx, dy]: [i32; 2]| {
            let far = |sign: i32| {
                let (mut at, mut steps) = (place, 0);
                while let Some(next) = self.hop(at, [sign * dx, sign * dy]) {
                    (at, steps) = (next, steps + 1);
                }
                steps
            };
            f64::from(far(1) + far(-1) + 1) * f64::from(dx).hypot(f64::from(dy))
        };
        let ways = [[1, 0], [0, 1], [1, 1], [1, -1], [2, 1], [1, 2], [2, -1], [1, -2]];
        let narrowest = ways.into_iter().map(across).fold(f64::INFINITY, f64::min);
        let width = (narrowest + 2.0 * self.body_pixels()) * self.grid.frame.pixel_m();
        Passage { at: self.feet(place), width }
    }

    /// The place a few pixels away, over links one axis after the other.
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
