//! Pixels under the middle line of a long pawn that stands, drives or turns on the spot.
//!
//! The middle line is the row of middles of the discs that make up the pawn. The middles of the pixels are the corners
//! of a grid of squares: a [`Mask`] holds the corners of each square that the line meets, and the sides of those
//! squares. On a line of the grid itself it holds only the corners and sides on that line. The footprint of a disc
//! anywhere inside of a square is covered by the footprints at its corners, so nothing thin lies between two masks.
//!
//! All masks are computed with integers, in the first octant, and turned to the other headings.

use super::pawn::WAYS;
use super::region::{NO_PLACE, Region};
use std::collections::{BTreeMap, BTreeSet};

/// Number of headings that differ: a pawn that is turned by 180° covers the same pixels.
pub const HEADINGS: usize = 8;
/// Direction of each heading (pixels); the next one lies to the left.
pub const DIRECTIONS: [[i32; 2]; HEADINGS] = [[1, 0], [2, 1], [1, 1], [1, 2], [0, 1], [-1, 2], [-1, 1], [-2, 1]];
/// Angles between neighbouring headings, one of which lies along an axis, and between others: atan(1/2) and atan(1/3).
pub const ANGLES: [f64; 2] = [0.463_647_609_000_806_1, 0.321_750_554_396_642_2];
/// Returns which of the [`ANGLES`] lies between a heading and the next one.
pub fn kind_of_turn(heading: usize) -> usize {
    usize::from(matches!(heading % 4, 1 | 2))
}

/// Fractions of a pixel in which lengths count.
const PARTS: i64 = 1 << 10;

/// Two pixels beside each other, or at opposite corners of a square.
type Pair = [[i32; 2]; 2];

/// Pixels of which all neighbours must be linked.
#[derive(Debug, Clone)]
pub struct Mask {
    /// Offsets of the pixels, the own one first.
    pub pixels: Vec<[i32; 2]>,
    /// Number of a pixel, the way from there, and the number of the pixel that it leads to: the next number at the first
    /// visit.
    links: Vec<(u32, u8, u32)>,
    /// Opposite corners of the squares.
    diagonals: Vec<[u32; 2]>,
    /// Greatest offset along x or y.
    pub extent: i32,
}

impl Mask {
    fn new(pairs: impl IntoIterator<Item = Pair>) -> Self {
        let mut sides: BTreeMap<[i32; 2], [bool; 4]> = BTreeMap::new();
        let mut corners: BTreeSet<Pair> = BTreeSet::new();
        for [a, b] in pairs {
            let by = [b[0] - a[0], b[1] - a[1]];
            match WAYS.iter().position(|way| *way == by) {
                Some(way) => {
                    sides.entry(a).or_default()[way] = true;
                    sides.entry(b).or_default()[(way + 2) & 3] = true;
                }
                None => _ = corners.insert([a.min(b), a.max(b)]),
            }
        }
        let (mut pixels, mut links) = (vec![[0; 2]], Vec::new());
        let mut numbers = BTreeMap::from([([0; 2], 0)]);
        let mut own = 0;
        while let Some(&pixel) = pixels.get(own) {
            let ways = sides.get(&pixel).copied().unwrap_or_default();
            for way in (0..4).filter(|way| ways[*way]) {
                let to = [pixel[0] + WAYS[way][0], pixel[1] + WAYS[way][1]];
                let number = *numbers.entry(to).or_insert_with(|| {
                    pixels.push(to);
                    pixels.len() - 1
                });
                // The links of earlier pixels count in both directions.
                if number > own {
                    links.push((own as u32, way as u8, number as u32));
                }
            }
            own += 1;
        }
        let diagonals = corners.iter().map(|pair| pair.map(|pixel| numbers[&pixel] as u32)).collect();
        let extent = pixels.iter().flatten().map(|by| by.abs()).max().unwrap_or(0);
        Self { pixels, links, diagonals, extent }
    }

    /// Returns whether all places under the mask around `place` are linked in both directions, and no square rises by
    /// more than the pawn climbs; then `places` are the places of the pixels.
    pub fn follow(&self, region: &Region, place: u32, places: &mut Vec<u32>) -> bool {
        places.clear();
        places.push(place);
        for &(from, way, number) in &self.links {
            let (from, way) = (places[from as usize], usize::from(way));
            let to = region.links[from as usize][way];
            if to == NO_PLACE || region.links[to as usize][(way + 2) & 3] != from {
                return false;
            }
            match places.get(number as usize) {
                Some(known) if *known != to => return false,
                Some(_) => {}
                None => places.push(to),
            }
        }
        let rise = |[a, b]: &[u32; 2]| {
            let [a, b] = [*a, *b].map(|number| region.tops[places[number as usize] as usize]);
            (a - b).abs()
        };
        self.diagonals.iter().all(|pair| region.grid.is_stride(-rise(pair)) && region.grid.is_stride(rise(pair)))
    }

    /// Returns the number of the pixel at `offset`.
    pub fn number(&self, offset: [i32; 2]) -> Option<usize> {
        self.pixels.iter().position(|pixel| *pixel == offset)
    }

    fn memory_bytes(&self) -> usize {
        size_of_val(&self.pixels[..]) + size_of_val(&self.links[..]) + size_of_val(&self.diagonals[..])
    }
}

/// Masks of a long pawn.
#[derive(Debug, Clone)]
pub struct Footprints {
    /// The four squares around a pixel.
    pub around: Mask,
    /// By heading: where the pawn stands.
    pub stand: Vec<Mask>,
    /// By heading: where it drives by the direction of the heading, ahead and back.
    pub drive: Vec<[Mask; 2]>,
    /// By heading: where it turns to the next one.
    pub turn: Vec<Mask>,
}

impl Footprints {
    /// Returns the masks of a pawn whose middle line is `2 · half` pixels long.
    pub fn new(half: f64) -> Self {
        let parts = |pixels: f64| (pixels * PARTS as f64).round() as i64;
        let along = |heading: usize| {
            let [x, y] = DIRECTIONS[heading].map(f64::from);
            parts(half / (x * x + y * y).sqrt())
        };
        let both = |heading: usize, ahead: i64, back: i64| {
            let back = line(heading, back).into_iter().map(|pair| pair.map(|[x, y]| [-x, -y]));
            line(heading, ahead).into_iter().chain(back).collect::<Vec<Pair>>()
        };
        let row = |heading: usize| both(heading, along(heading), along(heading));
        let turn = |heading: usize| {
            let ahead = sector(heading, parts(half));
            let back: Vec<Pair> = ahead.iter().map(|pair| pair.map(|[x, y]| [-x, -y])).collect();
            Mask::new([ahead, back, row(heading), row((heading + 1) % HEADINGS)].concat())
        };
        let drive = |heading: usize| {
            let (own, next) = (along(heading), along(heading) + PARTS);
            [Mask::new(both(heading, next, own)), Mask::new(both(heading, own, next))]
        };
        Self {
            around: Mask::new([[0, 0], [-1, 0], [0, -1], [-1, -1]].into_iter().flat_map(square)),
            stand: (0..HEADINGS).map(|heading| Mask::new(row(heading))).collect(),
            drive: (0..HEADINGS).map(drive).collect(),
            turn: (0..HEADINGS).map(turn).collect(),
        }
    }

    /// Returns the greatest extent of a mask (pixels).
    pub fn extent(&self) -> i32 {
        let drive = self.drive.iter().flatten();
        self.turn.iter().chain(drive).map(|mask| mask.extent).max().unwrap_or(0)
    }

    pub fn memory_bytes(&self) -> usize {
        self.stand.iter().chain(&self.turn).chain(self.drive.iter().flatten()).map(Mask::memory_bytes).sum()
    }
}

/// Sides and diagonals of the square from a corner on.
fn square([i, j]: [i32; 2]) -> [Pair; 6] {
    let [a, b, c, d] = [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]];
    [[a, b], [a, c], [b, d], [c, d], [a, d], [b, c]]
}

/// Turns pairs from the first octant to a heading; `is_mirrored` exchanges x and y first.
fn turned(pairs: Vec<Pair>, is_mirrored: bool, quarters: usize) -> Vec<Pair> {
    let turn = |[x, y]: [i32; 2]| {
        let at = if is_mirrored { [y, x] } else { [x, y] };
        (0..quarters).fold(at, |[x, y], _| [-y, x])
    };
    pairs.into_iter().map(|pair| pair.map(turn)).collect()
}

/// Returns what the line meets from the middle of a pixel to `length` times the direction of a heading (parts).
fn line(heading: usize, length: i64) -> Vec<Pair> {
    let before = |halves: i64| (0i32..).take_while(move |n| i64::from(*n) * PARTS < halves * length);
    let (is_mirrored, quarters) = (heading % 4 == 3, heading / 4);
    let pairs = match heading % 4 {
        0 => before(1).map(|i| [[i, 0], [i + 1, 0]]).collect(),
        2 => before(1).flat_map(|i| square([i, i])).collect(),
        // Two squares for each time the direction.
        _ => before(2).flat_map(|n| square([n, n / 2])).collect(),
    };
    turned(pairs, is_mirrored, quarters)
}

/// Returns what the sector of a circle of `radius` (parts) between a heading and the next one meets.
fn sector(heading: usize, radius: i64) -> Vec<Pair> {
    let (is_mirrored, quarters) = (heading % 4 >= 2, heading / 4);
    let [low, high]: [[i64; 2]; 2] = match heading % 4 {
        0 | 3 => [[1, 0], [2, 1]],
        _ => [[2, 1], [1, 1]],
    };
    let cross = |a: [i64; 2], b: [i64; 2]| a[0] * b[1] - a[1] * b[0];
    let squared = |[x, y]: [i64; 2]| i128::from(x * x + y * y);
    let most = radius / PARTS;
    let meets = |at: &[i64; 2]| {
        let [i, j] = *at;
        let is_between = cross([i + 1, j], high) > 0 && cross(low, [i, j + 1]) > 0;
        // The nearest point of the square within the sector is its corner, or where the lower ray enters it, on its left
        // side. The upper ray rises by one pixel in two or in one, so no corner of a square between the rays lies above it.
        is_between
            && match cross(low, *at) < 0 {
                true => i128::from(i * PARTS).pow(2) * squared(low) < i128::from(radius * low[0]).pow(2),
                false => squared([i * PARTS, j * PARTS]) < i128::from(radius).pow(2),
            }
    };
    let all = (0..=most).flat_map(|j| (0..=most).map(move |i| [i, j])).filter(meets);
    turned(all.flat_map(|at| square(at.map(|v| v as i32))).collect(), is_mirrored, quarters)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoMonitor;
    use crate::frame::{Frame, PageKey};
    use crate::page::{PageBuilder, Span};
    use crate::query::Answer;
    use crate::reach::{Flood, Pawn, StandingPlaces};
    use crate::store::Snapshot;
    use crate::walk::Body;
    use nalgebra::Point3;

    const DISC: Body = Body::Cylinder { radius: 0.05, height: 0.6 };

    /// Returns whether a square fits whose corners have floors at these heights (quanta).
    fn fits(corners: [&[i32]; 4], pawn: Pawn) -> bool {
        let mut builder = PageBuilder::default();
        let floor = |top: &i32| Span::new((2547 + top) as u32, (2550 + top) as u32, false).unwrap();
        for ([px, py], tops) in [[0, 0], [1, 0], [0, 1], [1, 1]].into_iter().zip(corners) {
            let spans: Vec<Span> = tops.iter().map(floor).collect();
            assert!(builder.set_column(px, py, &spans));
        }
        let key = PageKey { tx: 0, ty: 0, layer: 0 };
        let set = Snapshot::from_pages(Frame::new(0.1, 0.3).unwrap(), [(key, builder.build())]);
        let mut standing = StandingPlaces::new(&set, pawn).unwrap();
        let Answer::Known(mut flood) = Flood::everywhere(&mut standing, &set).unwrap() else { panic!("all is loaded") };
        assert_eq!(flood.grow(&mut standing, &set, &NoMonitor).unwrap(), Answer::Known(()));
        let region = flood.region(&standing);
        let first = Point3::new(0.05, 0.05, 3.0 + f64::from(corners[0][0]) / 850.0);
        let Answer::Known(Some(first)) = standing.spot(&set, first).unwrap() else { panic!("it is floor") };
        Mask::new(square([0, 0])).follow(&region, region.number(&first).unwrap(), &mut Vec::new())
    }

    #[test]
    fn a_square_fits_only_if_both_ways_round_lead_to_the_same_place() {
        let opposite = |tops: &[i32]| fits([&[0], &[0], &[289], tops], Pawn::new(DISC));
        assert!(opposite(&[289]));
        // 0.34 m down from one corner beside it, and 0.34 m up from the other.
        assert!(!opposite(&[-289, 578]));
    }

    #[test]
    fn a_square_fits_only_if_steps_from_corner_to_corner_are_no_higher_than_those_along_its_sides() {
        // Sides rise by 0.12 and 0.14 m, diagonals by 0.26 and 0.02 m.
        for (climb, max_drop, expected) in
            [(0.25, 0.25, false), (0.35, 0.25, false), (0.25, 0.35, false), (0.35, 0.35, true)]
        {
            let pawn = Pawn { climb, max_drop, ..Pawn::new(DISC) };
            for corners in [[0, 102, 119, 221], [221, 119, 102, 0], [102, 0, 221, 119]] {
                let tops = corners.each_ref().map(std::slice::from_ref);
                assert_eq!(fits(tops, pawn), expected, "{climb} m up, {max_drop} m down, {corners:?}");
            }
        }
    }

    type Point = [f64; 2];

    fn cross(a: Point, b: Point) -> f64 {
        a[0] * b[1] - a[1] * b[0]
    }

    /// Returns the part of a convex polygon at whose points `side` is not negative; it is linear.
    fn clipped(polygon: &[Point], side: impl Fn(Point) -> f64) -> Vec<Point> {
        let mut part = Vec::new();
        for (n, &a) in polygon.iter().enumerate() {
            let b = polygon[(n + 1) % polygon.len()];
            let (own, next) = (side(a), side(b));
            if own >= 0.0 {
                part.push(a);
            }
            if own * next < 0.0 {
                part.push([0, 1].map(|axis| a[axis] + (b[axis] - a[axis]) * own / (own - next)));
            }
        }
        part
    }

    fn area(polygon: &[Point]) -> f64 {
        (0..polygon.len()).map(|n| cross(polygon[n], polygon[(n + 1) % polygon.len()])).sum::<f64>() / 2.0
    }

    /// Returns how far a convex polygon is from the origin, which is not inside.
    fn distance(polygon: &[Point]) -> f64 {
        let far = |n: usize| {
            let (a, b) = (polygon[n], polygon[(n + 1) % polygon.len()]);
            let by = [b[0] - a[0], b[1] - a[1]];
            let square = by[0] * by[0] + by[1] * by[1];
            let share = if square > 0.0 { (-(a[0] * by[0] + a[1] * by[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
            (a[0] + share * by[0]).hypot(a[1] + share * by[1])
        };
        (0..polygon.len()).map(far).fold(f64::INFINITY, f64::min)
    }

    /// Returns the sides and diagonals of all squares of which `meets` says that they count, given their corners.
    fn of_squares(meets: impl Fn(&[Point]) -> bool) -> BTreeSet<Pair> {
        let all = (-12..12).flat_map(|i| (-12..12).map(move |j| [i, j]));
        let corners = |[i, j]: [i32; 2]| [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]].map(|at| at.map(f64::from));
        sorted(all.filter(|at| meets(&corners(*at))).flat_map(square))
    }

    fn sorted(pairs: impl IntoIterator<Item = Pair>) -> BTreeSet<Pair> {
        pairs.into_iter().map(|[a, b]| [a.min(b), a.max(b)]).collect()
    }

    /// Lengths (parts), some of which end at corners of squares.
    const LENGTHS: [i64; 9] = [1, 410, 1024, 1229, 1536, 2048, 2355, 3789, 5120];

    #[test]
    fn a_turn_meets_the_squares_of_its_sector() {
        for (heading, radius) in (0..HEADINGS).flat_map(|heading| LENGTHS.map(|radius| (heading, radius))) {
            let low = DIRECTIONS[heading].map(f64::from);
            let high = if heading + 1 == HEADINGS { [-1.0, 0.0] } else { DIRECTIONS[heading + 1].map(f64::from) };
            let expected = of_squares(|corners| {
                let part = clipped(&clipped(corners, |at| cross(low, at)), |at| cross(at, high));
                area(&part) > 1e-9 && distance(&part) < radius as f64 / PARTS as f64 - 1e-9
            });
            assert_eq!(sorted(sector(heading, radius)), expected, "heading {heading}, radius {radius}");
        }
    }

    #[test]
    fn a_drive_meets_the_squares_of_its_line() {
        for (heading, length) in (0..HEADINGS).flat_map(|heading| LENGTHS.map(|length| (heading, length))) {
            let direction = DIRECTIONS[heading].map(f64::from);
            let ends = length as f64 / PARTS as f64;
            let expected = if heading % 4 == 0 {
                let along = (0..8).filter(|n| f64::from(*n) < ends);
                sorted(along.map(|n| [n, n + 1].map(|n| DIRECTIONS[heading].map(|by| by * n))))
            } else {
                of_squares(|corners| {
                    let share = [0, 1].map(|axis| {
                        let [a, b] = [corners[0], corners[2]].map(|corner| corner[axis] / direction[axis]);
                        [a.min(b), a.max(b)]
                    });
                    share[0][1].min(share[1][1]).min(ends) - share[0][0].max(share[1][0]).max(0.0) > 1e-9
                })
            };
            assert_eq!(sorted(line(heading, length)), expected, "heading {heading}, length {length}");
        }
    }

    #[test]
    fn a_mask_numbers_its_pixels_and_counts_their_memory() {
        let mask = Mask::new(line(1, 3 * PARTS));
        assert_eq!((mask.pixels[0], mask.extent), ([0; 2], 6));
        assert!((0..mask.pixels.len()).all(|n| mask.number(mask.pixels[n]) == Some(n)));
        assert_eq!(mask.number([-1, 0]), None);
        assert_eq!(mask.memory_bytes(), 8 * mask.pixels.len() + 12 * mask.links.len() + 8 * mask.diagonals.len());
        let footprints = Footprints::new(2.5);
        let masks = || footprints.stand.iter().chain(&footprints.turn).chain(footprints.drive.iter().flatten());
        assert_eq!(footprints.memory_bytes(), masks().map(Mask::memory_bytes).sum::<usize>());
        assert_eq!(Some(footprints.extent()), masks().map(|mask| mask.extent).max());
        for (heading, [a, b]) in (0..HEADINGS).map(|heading| (heading, [heading, (heading + 1) % HEADINGS])) {
            let [a, b] = [a, b].map(|heading| DIRECTIONS[heading].map(f64::from));
            let angle = cross(a, b).abs().atan2((a[0] * b[0] + a[1] * b[1]).abs());
            assert!((ANGLES[kind_of_turn(heading)] - angle).abs() < 1e-15, "heading {heading}");
        }
    }
}
