//! Storeys of a region.
//!
//! Neighbouring places at most 6 cm apart in height belong to one part (ramps, terrain, rooms; not the treads of a
//! stair). The largest part makes a storey together with all parts whose median height lies within half of the pawn's
//! height; the largest of the rest makes the next one, as long as it has two square metres. What remains, treads and
//! landings, joins the storey nearest in height.

use super::region::{NO_PLACE, Region};

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
    /// All storeys, from the lowest up.
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
    fn middle(&self) -> i32 {
        self.tops.get(self.tops.len() / 2).copied().unwrap_or(0)
    }
}

fn storeys(region: &Region) -> Storeys {
    let grid = &region.grid;
    let level = grid.frame.quanta(LEVEL_M.max(grid.frame.pixel_m() * 1.01)) as i32;
    let mut parts = parts(region, level);
    parts.sort_by_key(|part| (std::cmp::Reverse(part.tops.len()), part.members[0]));
    let mut heights: Vec<i32> = Vec::new();
    let near = |heights: &[i32], part: &Part| heights.iter().any(|z| (z - part.middle()).abs() <= grid.height / 2);
    for part in &parts {
        if heights.is_empty() || region.area_of(part.tops.len()) >= LEAST_M2 && !near(&heights, part) {
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
        let nearest = (0..heights.len()).min_by_key(|storey| (heights[*storey] - middle).abs()).unwrap_or(0);
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

/// Returns the parts: places joined by steps of at most `level`.
fn parts(region: &Region, level: i32) -> Vec<Part> {
    let mut seen = vec![false; region.len()];
    let mut parts = Vec::new();
    for first in 0..region.len() as u32 {
        if std::mem::replace(&mut seen[first as usize], true) {
            continue;
        }
        let (mut part, mut next) = (Part { tops: Vec::new(), members: vec![first] }, 0);
        while next < part.members.len() {
            let place = part.members[next] as usize;
            next += 1;
            if region.standing[place] {
                part.tops.push(region.tops[place]);
            }
            for &link in region.links[place].iter().filter(|link| **link != NO_PLACE) {
                if (region.tops[link as usize] - region.tops[place]).abs() <= level && !seen[link as usize] {
                    seen[link as usize] = true;
                    part.members.push(link);
                }
            }
        }
        part.tops.sort_unstable();
        parts.push(part);
    }
    parts
}
