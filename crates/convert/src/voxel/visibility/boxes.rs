//! Points grouped in small boxes: if a station cannot have seen through any place in a box, its points are not tested.

use super::places::Places;
use super::view::{BATCH, View};
use crate::voxel::record::Record;
use std::ops::Range;

/// Edge of a box (m): about the difference in distance of neighbouring rays that graze a wall.
const EDGE_M: f64 = 0.2;
/// Bits in a key: the point's number, and the position of its box along each axis. Boxes whose positions do not fit
/// share a key, which only costs time.
const NUMBER_BITS: u32 = 16;
const PLACE_BITS: u32 = 16;
const _: () = assert!(super::CHUNK <= 1 << NUMBER_BITS && NUMBER_BITS + 3 * PLACE_BITS == 64);

/// Points of some records, box by box.
#[derive(Debug)]
pub(super) struct Boxes {
    /// Position of each point (m), by axis.
    points: [Vec<f64>; 3],
    /// Number of each point among the records; empty if the points are in the order of the records.
    numbers: Vec<u16>,
    boxes: Vec<Bounds>,
    all: Bounds,
}

/// Consecutive points, at most [`BATCH`], and their bounding box (m).
#[derive(Debug, Clone)]
struct Bounds {
    points: Range<usize>,
    min: [f64; 3],
    max: [f64; 3],
}

impl Boxes {
    /// Keeps the points in the order of the records, in boxes as large as their column.
    pub fn of_batches(places: Places, records: &[Record]) -> Self {
        let mut points = [0; 3].map(|_| vec![0.0; records.len()]);
        let [x, y, z] = &mut points;
        for (((record, x), y), z) in records.iter().zip(x).zip(y).zip(z) {
            [*x, *y, *z] = places.of(*record);
        }
        let (min, max) = places.bounds();
        let bounds = |points: Range<usize>| Bounds { points, min, max };
        let boxes = (0..records.len()).step_by(BATCH).map(|begin| bounds(begin..(begin + BATCH).min(records.len())));
        Self { points, numbers: Vec::new(), boxes: boxes.collect(), all: bounds(0..records.len()) }
    }

    /// Sorts the points into small boxes.
    pub fn small(places: Places, records: &[Record]) -> Self {
        let (min, _) = places.bounds();
        let place_of = |record: &Record| places.of(*record);
        let key = |point: [f64; 3]| {
            (0..3).fold(0, |key: u64, axis| {
                let from = if min[axis].is_finite() { min[axis] } else { 0.0 };
                let place = ((point[axis] - from) / EDGE_M).floor() as i64 as u64;
                (key << PLACE_BITS) | (place % (1 << PLACE_BITS))
            })
        };
        let mut keys: Vec<u64> = records
            .iter()
            .enumerate()
            .map(|(number, record)| key(place_of(record)) << NUMBER_BITS | number as u64)
            .collect();
        keys.sort_unstable();
        let numbers: Vec<u16> = keys.iter().map(|key| *key as u16).collect();
        let mut points = [0; 3].map(|_| Vec::with_capacity(records.len()));
        let mut boxes: Vec<Bounds> = Vec::new();
        for (at, key) in keys.iter().enumerate() {
            let point = place_of(&records[usize::from(numbers[at])]);
            (0..3).for_each(|axis| points[axis].push(point[axis]));
            let is_next =
                |own: &Bounds| own.points.len() < BATCH && keys[own.points.start] >> NUMBER_BITS == key >> NUMBER_BITS;
            match boxes.last_mut().filter(|own| is_next(own)) {
                Some(own) => {
                    own.points.end = at + 1;
                    own.hold(point, point);
                }
                None => boxes.push(Bounds { points: at..at + 1, min: point, max: point }),
            }
        }
        let mut all = Bounds { points: 0..records.len(), min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };
        boxes.iter().for_each(|own| all.hold(own.min, own.max));
        Self { points, numbers, boxes, all }
    }

    /// Returns the boxes with a place that the station may have seen through: the points of each, and their range among
    /// all points.
    pub fn seen_by<'a>(&'a self, view: &'a View) -> impl Iterator<Item = ([&'a [f64]; 3], Range<usize>)> {
        let boxes = if view.reaches(self.all.min, self.all.max) { &self.boxes[..] } else { &[] };
        let moves = view.station.within_m > 0.0;
        let some = boxes.iter().filter(move |own| !moves || view.may_see_through_some(own.min, own.max));
        some.map(move |own| (self.points.each_ref().map(|column| &column[own.points.clone()]), own.points.clone()))
    }

    /// Number among the records of the point at index `at`.
    pub fn number(&self, at: usize) -> usize {
        self.numbers.get(at).map_or(at, |number| usize::from(*number))
    }

    /// Position of a point (m).
    pub fn point(&self, at: usize) -> [f64; 3] {
        std::array::from_fn(|axis| self.points[axis][at])
    }

    /// Position of the middle point in the list (m).
    pub fn middle(&self) -> [f64; 3] {
        self.point(self.points[0].len() / 2)
    }
}

impl Bounds {
    fn hold(&mut self, min: [f64; 3], max: [f64; 3]) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(min[axis]);
            self.max[axis] = self.max[axis].max(max[axis]);
        }
    }
}
