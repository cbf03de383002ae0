//! Distance of each place from the ends of its region.
//!
//! Each place stores the offset of the nearest pixel that ends its region, and neighbours pass theirs on, nearest first
//! (Danielsson's vector distance transform, over links instead of a plane, because a region may lie above itself). An
//! end is a pixel whose spans stop the body, or a pixel of a footprint that has no ground at all, which is what the
//! footprint cannot span of a gap.

use super::pawn::{Grid, WAYS, gap};
use super::region::NO_PLACE;
use crate::sort::sort;
use nalgebra::Point2;

/// A step from a place that leads nowhere.
pub struct End {
    pub place: u32,
    /// From the place to the pixel that stops the body, or to the middle of a footprint without ground (pixels).
    pub offset: [i16; 2],
    pub is_open: bool,
}

struct Spread<'a> {
    links: &'a [[u32; 4]],
    /// A bit for each link that leads in both directions.
    both: Vec<u8>,
    offsets: Vec<[i16; 2]>,
    /// Places by distance, the nearest last: there are far fewer distances than places.
    queue: Vec<(u64, Vec<u32>)>,
    /// The last open end that was spread over each place.
    seen: Vec<u32>,
    /// True for places with a step that is stopped by something solid.
    stopped: Vec<bool>,
    /// Places over which an open end is still to be spread.
    around: Vec<(u32, [i32; 2])>,
}

impl Spread<'_> {
    /// Stores an offset for `place` if it is shorter than the present one. Of equally long ones the lesser wins, so
    /// that the result does not depend on the order.
    fn offer(&mut self, place: u32, offset: [i16; 2]) {
        let key = |offset: [i16; 2]| (gap(offset.map(i32::from)), offset);
        let own = &mut self.offsets[place as usize];
        if key(offset) < key(*own) {
            *own = offset;
            let distance = key(offset).0;
            match self.queue.binary_search_by(|(other, _)| distance.cmp(other)) {
                Ok(at) => self.queue[at].1.push(place),
                Err(at) => self.queue.insert(at, (distance, vec![place])),
            }
        }
    }

    /// Returns the neighbours that are linked with a place in both directions, with the offset from them to it.
    fn beside(&self, place: u32) -> impl Iterator<Item = (u32, [i32; 2])> + use<> {
        let (beside, both) = (self.links[place as usize], self.both[place as usize]);
        (0..4).filter(move |way| both >> way & 1 == 1).map(move |way| (beside[way], WAYS[(way + 2) & 3]))
    }

    /// Offers the nearest pixel of a footprint without ground to the places whose gap to it is at most `reach`. Returns
    /// whether something solid stops a step from one of them.
    fn open(&mut self, grid: &Grid, number: u32, end: &End, reach: u64) -> bool {
        let mut is_stopped = false;
        let mut places = std::mem::take(&mut self.around);
        places.push((end.place, end.offset.map(i32::from)));
        self.seen[end.place as usize] = number;
        while let Some((place, to)) = places.pop() {
            let beyond = |rect: &[i32; 2]| [0, 1].map(|axis| to[axis] - to[axis].clamp(-rect[axis], rect[axis]));
            let nearest = grid.rects.iter().map(beyond).min_by_key(|by| (gap(*by), *by));
            let Some(by) = nearest.filter(|by| gap(*by) <= reach) else { continue };
            self.offer(place, by.map(|by| by as i16));
            is_stopped |= self.stopped[place as usize];
            for (next, way) in self.beside(place) {
                if std::mem::replace(&mut self.seen[next as usize], number) != number {
                    places.push((next, [to[0] + way[0], to[1] + way[1]]));
                }
            }
        }
        self.around = places;
        is_stopped
    }
}

/// Returns the distance from the middle of each place to the nearest end (m).
pub fn clearances(grid: &Grid, links: &[[u32; 4]], ends: &[End]) -> Vec<f32> {
    let count = links.len();
    // Distances also spread backwards over links that lead one way only.
    let mut one_way: Vec<(u32, u32, [i32; 2])> = Vec::new();
    let mut both = vec![0; count];
    for (place, own) in (0..).zip(links) {
        for (way, &link) in own.iter().enumerate().filter(|(_, link)| **link != NO_PLACE) {
            if links[link as usize][(way + 2) & 3] == place {
                both[place as usize] |= 1 << way;
            } else {
                one_way.push((link, place, WAYS[way]));
            }
        }
    }
    sort(&mut one_way);
    let mut spread = Spread {
        links,
        both,
        offsets: vec![[i16::MAX; 2]; count],
        queue: Vec::new(),
        seen: vec![u32::MAX; count],
        stopped: vec![false; count],
        around: Vec::new(),
    };
    for end in ends.iter().filter(|end| !end.is_open) {
        spread.offer(end.place, end.offset);
        spread.stopped[end.place as usize] = true;
    }
    for (number, end) in (0..).zip(ends.iter().filter(|end| end.is_open)) {
        // Where something solid keeps the body away, the gap behind it may still be nearest: twice as far as a corner of
        // the footprint is enough in all scenes tried.
        if spread.open(grid, 2 * number, end, gap([1, 0])) {
            spread.open(grid, 2 * number + 1, end, 4 * grid.corner);
        }
    }
    while let Some((key, places)) = spread.queue.pop() {
        // All of one distance pass on what they have at first, so that their order does not count.
        let own = |place: u32| (place, spread.offsets[place as usize].map(i32::from));
        let nearest: Vec<(u32, [i32; 2])> =
            places.into_iter().map(own).filter(|(_, offset)| gap(*offset) == key).collect();
        for (place, [x, y]) in nearest {
            let first = one_way.partition_point(|(to, ..)| *to < place);
            let from = one_way[first..].iter().take_while(|(to, ..)| *to == place).map(|(_, from, way)| (*from, *way));
            for (next, way) in spread.beside(place).chain(from) {
                let far = i32::from(i16::MAX);
                spread.offer(next, [x + way[0], y + way[1]].map(|by| by.clamp(-far, far) as i16));
            }
        }
    }
    let metres = |offset: &[i16; 2]| match offset.map(i32::from) {
        by if *offset != [i16::MAX; 2] => ((gap(by) as f64).sqrt() / 2.0 * grid.frame.pixel_m()) as f32,
        _ => f32::INFINITY,
    };
    spread.offsets.iter().map(metres).collect()
}

/// Returns the distance of a place from the line between two others (m).
pub fn to_line(at: Point2<f64>, [from, to]: [Point2<f64>; 2]) -> f64 {
    let along = to - from;
    let share = ((at - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    // A line between equal ends has no direction.
    let share = if share.is_finite() { share } else { 0.0 };
    (at - (from + along * share)).norm()
}
