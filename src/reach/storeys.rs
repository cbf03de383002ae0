//! Storeys of a region.
//!
//! Neighbouring places at most 6 cm apart in height belong to one part (ramps, terrain, rooms; not the treads of a
//! stair). A part that lies above itself, such as a helical ramp or two floors and a ramp between them, is split: each
//! piece grows from the lowest place that is left, lowest neighbours first, and leaves out what lies above or below it.
//! The largest part makes a storey together with all parts whose median height lies within half of the pawn's
//! height; the largest of the rest makes the next one, as long as it has two square metres. What remains, treads and
//! landings, joins the storey nearest in height.

use super::region::{NO_PLACE, Region};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

/// Highest step inside one part (m). With coarse pixels it is the pixel size, because ramps rise as much.
const LEVEL_M: f64 = 0.06;
/// Least area of a storey (m²); the largest part makes one whatever its area.
const LEAST_M2: f64 = 2.0;

/// A storey.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Storey {
    /// Median height of its area (m).
    pub z: f64,
    /// Area of its standing places (m²).
    pub area_m2: f64,
}

/// The storeys of a region.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct Storeys {
    /// All storeys, from the lowest up; none if the region has no standing place.
    pub all: Vec<Storey>,
    /// Number of the storey of each standing place, in the order of [`Region::places`].
    pub of: Vec<u16>,
}

impl Region {
    /// Returns the storeys of the region: floors that lie more than half of the pawn's height apart.
    pub fn storeys(&self) -> Storeys {
        storeys(self)
    }
}

struct Part {
    tops: Vec<i32>,
    members: Vec<u32>,
}

impl Part {
    fn of(region: &Region, members: Vec<u32>) -> Self {
        let standing = members.iter().filter(|place| region.standing[**place as usize]);
        let mut tops: Vec<i32> = standing.map(|place| region.tops[*place as usize]).collect();
        tops.sort_unstable();
        Self { tops, members }
    }

    fn middle(&self) -> i32 {
        self.tops.get(self.tops.len() / 2).copied().unwrap_or(0)
    }
}

fn storeys(region: &Region) -> Storeys {
    let grid = &region.grid;
    let level = grid.frame.quanta(LEVEL_M.max(grid.frame.pixel_m() * 1.01)) as i32;
    let mut parts = parts(region, level);
    parts.sort_by_key(|part| (Reverse(part.tops.len()), part.members[0]));
    let mut heights: Vec<i32> = Vec::new();
    let near = |heights: &[i32], part: &Part| heights.iter().any(|z| (z - part.middle()).abs() <= grid.height / 2);
    for part in &parts {
        let is_ground = !part.tops.is_empty();
        if heights.is_empty() && is_ground || region.area_of(part.tops.len()) >= LEAST_M2 && !near(&heights, part) {
            heights.push(part.middle());
        }
    }
    heights.truncate(usize::from(u16::MAX));
    heights.sort_unstable();
    let mut of = vec![0u16; region.len()];
    let mut tops: Vec<Vec<i32>> = vec![Vec::new(); heights.len()];
    for part in &parts {
        // The treads of a flight are divided between the storeys that it joins.
        let middle = if part.tops.is_empty() { region.tops[part.members[0] as usize] } else { part.middle() };
        let Some(nearest) = (0..heights.len()).min_by_key(|storey| (heights[*storey] - middle).abs()) else { break };
        tops[nearest].extend(&part.tops);
        part.members.iter().for_each(|member| of[*member as usize] = nearest as u16);
    }
    let storey = |tops: &mut Vec<i32>| {
        tops.sort_unstable();
        let middle = tops.get(tops.len() / 2).map_or(0, |top| *top);
        Storey { z: grid.z(middle), area_m2: region.area_of(tops.len()) }
    };
    let of = of.into_iter().zip(&region.standing).filter(|(_, standing)| **standing).map(|(of, _)| of).collect();
    Storeys { all: tops.iter_mut().map(storey).collect(), of }
}

/// Returns the parts: places joined by steps of at most `level`, none above another one.
fn parts(region: &Region, level: i32) -> Vec<Part> {
    let mut whole = vec![NO_PART; region.len()];
    let mut parts = Vec::new();
    for first in 0..region.len() as u32 {
        if whole[first as usize] != NO_PART {
            continue;
        }
        let (number, mut members, mut next) = (first, vec![first], 0);
        whole[first as usize] = number;
        while let Some(&place) = members.get(next) {
            next += 1;
            for link in level_links(region, place, level) {
                if whole[link as usize] == NO_PART {
                    whole[link as usize] = number;
                    members.push(link);
                }
            }
        }
        let is_same = |other: u32| whole[other as usize] == number;
        match members.iter().any(|place| others_of_pixel(region, *place).any(is_same)) {
            true => parts.extend(pieces(region, level, members).into_iter().map(|members| Part::of(region, members))),
            false => parts.push(Part::of(region, members)),
        }
    }
    parts
}

/// Stands for a place that belongs to no part yet.
const NO_PART: u32 = u32::MAX;

/// Iterates over the places beside `place` that are at most `level` higher or lower.
fn level_links(region: &Region, place: u32, level: i32) -> impl Iterator<Item = u32> {
    let links = region.links[place as usize].into_iter().filter(|link| *link != NO_PLACE);
    links.filter(move |link| (region.tops[*link as usize] - region.tops[place as usize]).abs() <= level)
}

/// Iterates over the places above and below `place`, whose numbers follow each other.
fn others_of_pixel(region: &Region, place: u32) -> impl Iterator<Item = u32> {
    let pixel = region.pixels[place as usize];
    let is_here = move |other: &u32| region.pixels[*other as usize] == pixel;
    let above = (place + 1..region.len() as u32).take_while(is_here);
    (0..place).rev().take_while(is_here).chain(above)
}

/// Splits the places of a part into pieces that nowhere lie above themselves.
fn pieces(region: &Region, level: i32, mut members: Vec<u32>) -> Vec<Vec<u32>> {
    let height = |place: u32| Reverse((region.tops[place as usize], place));
    members.sort_unstable_by_key(|place| Reverse(height(*place)));
    // By place: the number of its piece.
    let mut piece_of: HashMap<u32, usize> = members.iter().map(|place| (*place, usize::MAX)).collect();
    let mut pieces: Vec<Vec<u32>> = Vec::new();
    for &first in &members {
        if piece_of[&first] != usize::MAX {
            continue;
        }
        let (own, mut piece, mut open) = (pieces.len(), Vec::new(), BinaryHeap::from([height(first)]));
        while let Some(Reverse((_, place))) = open.pop() {
            let is_free = piece_of.get(&place) == Some(&usize::MAX);
            if !is_free || others_of_pixel(region, place).any(|other| piece_of.get(&other) == Some(&own)) {
                continue;
            }
            piece_of.insert(place, own);
            piece.push(place);
            open.extend(level_links(region, place, level).map(height));
        }
        pieces.push(piece);
    }
    pieces
}
