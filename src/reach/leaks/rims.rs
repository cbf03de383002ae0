//! Rims: brinks near each other, and the stretches of a rim below which the depth changes little.

use super::{NOTHING, Sets, Survey, TILE, There, cell};
use crate::reach::Needs;
use crate::reach::pawn::WAYS;
use crate::reach::tiles::TileNumbers;
use std::ops::ControlFlow;

/// Greatest distance between brinks of one rim (pixels).
const TOGETHER: i32 = 2;

/// A step from a standing place to an open pixel.
#[derive(Debug, Clone, Copy)]
pub struct Brink {
    pub place: u32,
    pub way: usize,
    /// Depth of the ground, if any (quanta).
    pub depth: Option<i32>,
}

/// Brinks near each other.
#[derive(Debug)]
pub struct Rim {
    /// Median height: a rim beside stairs has a height for each tread.
    pub level: i32,
    pub brinks: Vec<Brink>,
    /// The brinks of each of its stretches.
    pub stretches: Vec<Vec<Brink>>,
}

/// Neighbouring brinks of a rim with similar depth.
#[derive(Debug)]
pub struct Stretch {
    pub brinks: Vec<Brink>,
    /// Number of its gap.
    pub gap: u32,
}

/// Returns the median depth; `None` if there is no ground below most of the brinks.
fn depth_of(brinks: &[Brink]) -> Option<i32> {
    let mut depths: Vec<i32> = brinks.iter().filter_map(|brink| brink.depth).collect();
    depths.sort_unstable();
    depths.get(depths.len() / 2).copied().filter(|_| 2 * depths.len() >= brinks.len())
}

impl Stretch {
    pub fn depth(&self) -> Option<i32> {
        depth_of(&self.brinks)
    }

    /// Returns the least and the greatest depth.
    pub fn depths(&self) -> Option<[i32; 2]> {
        self.depth()?;
        let depths = || self.brinks.iter().filter_map(|brink| brink.depth);
        Some([depths().min()?, depths().max()?])
    }
}

/// Number of the last brink at each pixel, by tile.
struct Firsts {
    numbers: TileNumbers,
    tiles: Vec<Box<[u32; TILE * TILE]>>,
}

impl Firsts {
    /// Returns the numbers from one pixel of row `j` to another one in the same tile; `None` if the tile has no brink.
    fn row(&self, [from, to]: [i32; 2], j: i32) -> Option<&[u32]> {
        let first = ((j & 63) << 6 | from & 63) as usize;
        let tile = &self.tiles[self.numbers.get([from >> 6, j >> 6])?];
        Some(&tile[first..first + (to - from) as usize + 1])
    }

    fn put(&mut self, pixel: [i32; 2], number: u32) -> u32 {
        let at = [pixel[0] >> 6, pixel[1] >> 6];
        let tile = match self.numbers.get(at) {
            Some(tile) => tile,
            None => {
                self.numbers.add(at);
                self.tiles.push(Box::new([NOTHING; TILE * TILE]));
                self.tiles.len() - 1
            }
        };
        std::mem::replace(&mut self.tiles[tile][cell(pixel)], number)
    }
}

impl Survey<'_> {
    /// Finds the brinks of all places.
    pub fn brinks(&mut self) -> Needs<()> {
        while (self.found.seen as usize) < self.region.len() {
            let place = self.found.seen;
            let at = place as usize;
            // A neighbour that can be stood on is not open.
            if self.region.standing[at] && self.region.is_beside_end(place) {
                let mut own = [None; WAYS.len()];
                for (way, own) in own.iter_mut().enumerate() {
                    let brink = Brink { place, way, depth: None };
                    if let There::Open(depth) = self.there(self.beyond(&brink), self.region.tops[at])? {
                        *own = Some(Brink { depth, ..brink });
                    }
                }
                self.found.brinks.extend(own.into_iter().flatten());
            }
            self.found.seen += 1;
        }
        ControlFlow::Continue(())
    }

    /// Returns the open pixel of a brink.
    pub fn beyond(&self, brink: &Brink) -> [i32; 2] {
        let pixel = self.region.pixels[brink.place as usize];
        let way = WAYS[brink.way];
        [pixel[0] + way[0], pixel[1] + way[1]]
    }

    /// Returns the rims, by their first brink.
    pub fn rims(&self, brinks: &[Brink]) -> Vec<Rim> {
        let (mut rims, mut stretches) = (Sets::new(brinks.len()), Sets::new(brinks.len()));
        let mut meets: Vec<[u32; 2]> = Vec::new();
        let up = self.standing.grid.up;
        let pixel_of = |brink: &Brink| self.region.pixels[brink.place as usize];
        let top_of = |brink: &Brink| self.region.tops[brink.place as usize];
        let mut firsts = Firsts { numbers: TileNumbers::default(), tiles: Vec::new() };
        let mut next = vec![NOTHING; brinks.len()];
        for (number, brink) in brinks.iter().enumerate() {
            let [i, j] = pixel_of(brink);
            let beyond = self.beyond(brink);
            let mut meet = |mut other: u32| {
                while other != NOTHING {
                    let before = &brinks[other as usize];
                    let far = self.beyond(before);
                    let is_near = (top_of(before) - top_of(brink)).abs() <= up
                        && (0..2).all(|axis| (far[axis] - beyond[axis]).abs() <= TOGETHER)
                        // Not on the other side of a beam.
                        && before.way != (brink.way + 2) & 3;
                    if is_near {
                        rims.join(number as u32, other);
                        let is_alike = match (before.depth, brink.depth) {
                            (Some(a), Some(b)) => (a - b).abs() <= up,
                            (a, b) => a == b,
                        };
                        if is_alike {
                            stretches.join(number as u32, other);
                        } else {
                            meets.push([number as u32, other]);
                        }
                    }
                    other = next[other as usize];
                }
            };
            for y in j - TOGETHER..=j + TOGETHER {
                // The part of the row in each tile.
                let (first, last) = (i - TOGETHER, i + TOGETHER);
                let border = last & !63;
                let parts = if first < border {
                    [Some([first, border - 1]), Some([border, last])]
                } else {
                    [Some([first, last]), None]
                };
                for row in parts.into_iter().flatten().filter_map(|part| firsts.row(part, y)) {
                    row.iter().for_each(|other| meet(*other));
                }
            }
            next[number] = firsts.put([i, j], number as u32);
        }
        self.join_narrow(brinks, &mut stretches, &meets);
        // By the first brink of the rim.
        let mut own: Vec<Vec<Vec<Brink>>> = vec![Vec::new(); brinks.len()];
        for members in stretches.members() {
            let of_stretch = members.iter().map(|brink| brinks[*brink as usize]).collect();
            own[rims.root(members[0]) as usize].push(of_stretch);
        }
        let rim = |members: Vec<u32>| {
            let mut tops: Vec<i32> = members.iter().map(|brink| top_of(&brinks[*brink as usize])).collect();
            tops.sort_unstable();
            Rim {
                level: tops[tops.len() / 2],
                brinks: members.iter().map(|brink| brinks[*brink as usize]).collect(),
                stretches: std::mem::take(&mut own[members[0] as usize]),
            }
        };
        rims.members().into_iter().map(rim).collect()
    }

    /// Joins stretches narrower than half of the pawn to each other, and to the longest one that they meet; of equally
    /// long ones to the deepest.
    fn join_narrow(&self, brinks: &[Brink], stretches: &mut Sets, meets: &[[u32; 2]]) {
        // By the first brink of a stretch: whether the stretch is narrow, its length and its depth.
        let sizes = |stretches: &mut Sets| -> Vec<Option<(bool, usize, i32)>> {
            let mut sizes = vec![None; brinks.len()];
            for members in stretches.members() {
                let own: Vec<Brink> = members.iter().map(|brink| brinks[*brink as usize]).collect();
                let extent = self.extent(own.iter().map(|brink| self.region.pixels[brink.place as usize]), 0);
                let is_narrow = extent[0].max(extent[1]) < self.standing.grid.pawn.body.half().min();
                sizes[members[0] as usize] = Some((is_narrow, own.len(), depth_of(&own).unwrap_or(i32::MAX)));
            }
            sizes
        };
        let before = sizes(stretches);
        for [a, b] in meets {
            let [a, b] = [stretches.root(*a), stretches.root(*b)];
            // A joined set keeps the name of its first member.
            if [a, b].iter().all(|root| before[*root as usize].is_some_and(|size| size.0)) {
                stretches.join(a, b);
            }
        }
        let after = sizes(stretches);
        // The longest wide stretch that each narrow one meets.
        let mut longest: Vec<Option<(usize, i32, u32)>> = vec![None; brinks.len()];
        for meet in meets {
            let roots = meet.map(|brink| stretches.root(brink));
            for [own, other] in [roots, [roots[1], roots[0]]] {
                if let (Some((true, ..)), Some((false, size, depth))) = (after[own as usize], after[other as usize]) {
                    let longest = &mut longest[own as usize];
                    *longest = (*longest).max(Some((size, depth, other)));
                }
            }
        }
        for (own, longest) in (0..).zip(longest) {
            if let Some((_, _, other)) = longest {
                stretches.join(own, other);
            }
        }
    }
}
