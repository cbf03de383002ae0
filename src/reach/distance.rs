//! Distance of each place from where its region ends.
//!
//! Each place knows the nearest pixel at which the region ends as an offset; neighbours pass theirs on, nearest first
//! (Danielsson's vector distance transform, over links instead of a plane: a region may lie above itself).

use super::region::{NO_PLACE, WAYS};
use nalgebra::Point2;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

type Queue = BinaryHeap<Reverse<(u32, u32)>>;

/// From each place to the nearest pixel beyond its region (pixels along x and y).
pub fn nearest_ends(links: &[[u32; 4]]) -> Vec<[i16; 2]> {
    let (mut offsets, mut queue) = (vec![[i16::MAX; 2]; links.len()], Queue::new());
    for (place, links) in links.iter().enumerate() {
        for (way, _) in WAYS.iter().zip(links).filter(|(_, link)| **link == NO_PLACE) {
            offer(&mut offsets, &mut queue, place as u32, way.map(|v| v as i16));
        }
    }
    while let Some(Reverse((distance, place))) = queue.pop() {
        let [x, y] = offsets[place as usize];
        if distance > square([x, y]) {
            continue;
        }
        for (way, &link) in WAYS.iter().zip(&links[place as usize]).filter(|(_, link)| **link != NO_PLACE) {
            let passed = [x.saturating_sub(way[0] as i16), y.saturating_sub(way[1] as i16)];
            offer(&mut offsets, &mut queue, link, passed);
        }
    }
    offsets
}

/// Distance of a place from the line between two others (m).
pub fn to_line(at: Point2<f64>, [from, to]: [Point2<f64>; 2]) -> f64 {
    let along = to - from;
    let share = ((at - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    // A line of one place has no direction.
    let share = if share.is_finite() { share } else { 0.0 };
    (at - (from + along * share)).norm()
}

fn square([x, y]: [i16; 2]) -> u32 {
    i32::from(x).pow(2).unsigned_abs() + i32::from(y).pow(2).unsigned_abs()
}

/// Takes `offset` if it is shorter than what `place` has; of two of one length the lesser, so that the order does not show.
fn offer(offsets: &mut [[i16; 2]], queue: &mut Queue, place: u32, offset: [i16; 2]) {
    let own = &mut offsets[place as usize];
    if (square(offset), offset) < (square(*own), *own) {
        *own = offset;
        queue.push(Reverse((square(offset), place)));
    }
}
