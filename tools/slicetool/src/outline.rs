//! Outlines of areas of pixels. An area is a set of runs along x, so its interior costs nothing.

use std::collections::BTreeMap;
use std::ops::Range;

/// Corners of pixels: pixel (i, j) lies between the corners (i, j) and (i + 1, j + 1).
pub type Corner = (i64, i64);

/// An area of pixels.
#[derive(Default)]
pub struct Area {
    /// Ranges of pixels along x for each row; sorted and disjoint after [`Area::join`].
    rows: BTreeMap<i64, Vec<Range<i64>>>,
    runs: usize,
    /// Number of runs at which they are joined again.
    join_at: usize,
}

impl Area {
    pub fn insert(&mut self, (i, j): Corner) {
        let row = self.rows.entry(j).or_default();
        match row.last_mut() {
            Some(last) if last.contains(&i) => return,
            Some(last) if last.end == i => last.end += 1,
            _ => {
                row.push(i..i + 1);
                self.runs += 1;
            }
        }
        if self.runs > self.join_at {
            self.join();
        }
    }

    /// Number of runs of pixels along x; touching runs may be counted separately.
    pub fn runs(&self) -> usize {
        self.runs
    }

    /// Number of runs of pixels along x after joining.
    pub fn joined_runs(&mut self) -> usize {
        self.join();
        self.runs
    }

    /// Lowest and highest corner; `None` for an empty area.
    pub fn bounds(&self) -> Option<[Corner; 2]> {
        let (bottom, top) = (*self.rows.first_key_value()?.0, self.rows.last_key_value()?.0 + 1);
        let runs = || self.rows.values().flatten();
        let (left, right) = (runs().map(|run| run.start).min()?, runs().map(|run| run.end).max()?);
        Some([(left, bottom), (right, top)])
    }

    fn join(&mut self) {
        for row in self.rows.values_mut() {
            row.sort_unstable_by_key(|run| run.start);
            row.dedup_by(|next, run| {
                let joins = next.start <= run.end;
                if joins {
                    run.end = run.end.max(next.end);
                }
                joins
            });
        }
        self.runs = self.rows.values().map(Vec::len).sum();
        self.join_at = 2 * self.runs + (1 << 16);
    }

    /// Returns the outlines: for each polygon the outer ring, anticlockwise, then its holes, clockwise; rings are
    /// closed.
    pub fn polygons(mut self) -> Vec<Vec<Vec<Corner>>> {
        self.join();
        let rows: Vec<(i64, &[Range<i64>])> = self.rows.iter().map(|(j, runs)| (*j, &runs[..])).collect();
        let mut edges = Edges::of(&rows);
        let (mut outer, mut holes): (Vec<Vec<Vec<Corner>>>, Vec<Vec<Corner>>) = (Vec::new(), Vec::new());
        while let Some(ring) = edges.next_ring() {
            if twice_area(&ring) > 0 { outer.push(vec![ring]) } else { holes.push(ring) }
        }
        if holes.is_empty() {
            return outer;
        }
        // A hole belongs to the outer ring around the pixel to the left of its first edge.
        let parts = Parts::of(&rows);
        let mut ring_of = vec![None; parts.part_of_run.len()];
        for (number, rings) in outer.iter().enumerate() {
            // A ring begins at its lowest corner on the left, so the pixel there is inside.
            ring_of[parts.of_pixel(&rows, rings[0][0])] = Some(number);
        }
        for hole in holes {
            let ((i, j), (to_i, to_j)) = (hole[0], hole[1]);
            // The pixel to the left of a unit step from the corner.
            let pixel = match ((to_i - i).signum(), (to_j - j).signum()) {
                (1, _) => (i, j),
                (-1, _) => (i - 1, j - 1),
                (_, 1) => (i - 1, j),
                _ => (i, j - 1),
            };
            if let Some(own) = ring_of[parts.of_pixel(&rows, pixel)] {
                outer[own].push(hole);
            }
        }
        outer
    }
}

impl FromIterator<Corner> for Area {
    fn from_iter<I: IntoIterator<Item = Corner>>(pixels: I) -> Self {
        let mut area = Self::default();
        pixels.into_iter().for_each(|pixel| area.insert(pixel));
        area
    }
}

/// Edges with the area on their left, by start; an edge along x extends as long as the area stays on one side of it.
struct Edges {
    edges: Vec<(Corner, Corner)>,
    taken: Vec<bool>,
    /// All edges before this one are taken.
    first: usize,
}

impl Edges {
    fn of(rows: &[(i64, &[Range<i64>])]) -> Self {
        let mut edges = Vec::new();
        let row = |at: Option<usize>, j: i64| match at.and_then(|at| rows.get(at)) {
            Some((found, runs)) if *found == j => runs,
            _ => &[][..],
        };
        for (at, &(j, runs)) in rows.iter().enumerate() {
            for run in runs {
                edges.push(((run.end, j), (run.end, j + 1)));
                edges.push(((run.start, j + 1), (run.start, j)));
            }
            uncovered(runs, row(at.checked_sub(1), j - 1), |from, to| edges.push(((from, j), (to, j))));
            uncovered(runs, row(Some(at + 1), j + 1), |from, to| edges.push(((to, j + 1), (from, j + 1))));
        }
        edges.sort_unstable();
        Self { taken: vec![false; edges.len()], edges, first: 0 }
    }

    /// Takes the edges of one ring, starting at the least corner, and leaves out corners on straight lines.
    fn next_ring(&mut self) -> Option<Vec<Corner>> {
        self.first += self.taken[self.first..].iter().position(|taken| !taken)?;
        let start = self.edges[self.first].0;
        let (mut ring, mut at, mut heading) = (vec![start], start, None::<Corner>);
        loop {
            let from = self.edges.partition_point(|edge| edge.0 < at);
            let mut free = (from..self.edges.len())
                .take_while(|number| self.edges[*number].0 == at)
                .filter(|number| !self.taken[*number]);
            let heading_of = |number: usize| {
                let to = self.edges[number].1;
                ((to.0 - at.0).signum(), (to.1 - at.1).signum())
            };
            // Every corner has as many edges leaving as entering.
            let one = free.next()?;
            // Where two pixels touch at a corner, turn left, so that rings do not cross.
            let left = heading.map(|(di, dj): Corner| (-dj, di));
            let number = free.find(|number| Some(heading_of(*number)) == left).unwrap_or(one);
            let own = heading_of(number);
            self.taken[number] = true;
            if heading == Some(own) {
                ring.pop();
            }
            at = self.edges[number].1;
            ring.push(at);
            heading = Some(own);
            if at == start {
                return Some(ring);
            }
        }
    }
}

/// Calls `part` for the parts of `runs` that no run of `others` covers.
fn uncovered(runs: &[Range<i64>], others: &[Range<i64>], mut part: impl FnMut(i64, i64)) {
    for run in runs {
        let mut from = run.start;
        let first = others.partition_point(|other| other.end <= run.start);
        for other in others[first..].iter().take_while(|other| other.start < run.end) {
            if other.start > from {
                part(from, other.start);
            }
            from = other.end;
        }
        if from < run.end {
            part(from, run.end);
        }
    }
}

/// Sets of pixels connected along edges.
struct Parts {
    /// Index of the first run of each row, in the order of rows.
    first_run: Vec<usize>,
    /// For each run the index of one run of its part, the same for the whole part.
    part_of_run: Vec<usize>,
}

impl Parts {
    fn of(rows: &[(i64, &[Range<i64>])]) -> Self {
        let mut first_run = Vec::with_capacity(rows.len());
        let mut count = 0;
        for (_, runs) in rows {
            first_run.push(count);
            count += runs.len();
        }
        let mut parent: Vec<usize> = (0..count).collect();
        fn root(parent: &mut [usize], mut run: usize) -> usize {
            while parent[run] != run {
                parent[run] = parent[parent[run]];
                run = parent[run];
            }
            run
        }
        for (at, pair) in rows.windows(2).enumerate() {
            let [(j, below), (above_j, above)] = [pair[0], pair[1]];
            if above_j != j + 1 {
                continue;
            }
            for (number, run) in above.iter().enumerate() {
                let first = below.partition_point(|other| other.end <= run.start);
                let touching = below[first..].iter().take_while(|other| other.start < run.end).count();
                for other in first..first + touching {
                    let own = root(&mut parent, first_run[at + 1] + number);
                    let other = root(&mut parent, first_run[at] + other);
                    parent[own.max(other)] = own.min(other);
                }
            }
        }
        let part_of_run = (0..count).map(|run| root(&mut parent, run)).collect();
        Self { first_run, part_of_run }
    }

    /// Returns the part of a pixel of the area.
    fn of_pixel(&self, rows: &[(i64, &[Range<i64>])], (i, j): Corner) -> usize {
        let row = rows.partition_point(|(row, _)| *row < j);
        let run = rows[row].1.partition_point(|run| run.end <= i);
        self.part_of_run[self.first_run[row] + run]
    }
}

fn twice_area(ring: &[Corner]) -> i64 {
    ring.windows(2)
        .map(|pair| {
            (pair[0].0 - ring[0].0) * (pair[1].1 - ring[0].1) - (pair[1].0 - ring[0].0) * (pair[0].1 - ring[0].1)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn pixels(rows: &[&str]) -> Vec<Corner> {
        let pixel = |(j, row): (usize, &&str)| {
            let found = row.bytes().enumerate().filter(|(_, byte)| *byte == b'#');
            found.map(|(i, _)| (i as i64, j as i64)).collect::<Vec<_>>()
        };
        rows.iter().enumerate().flat_map(|row| pixel((row.0, row.1))).collect()
    }

    fn polygons(pixels: &[Corner]) -> Vec<Vec<Vec<Corner>>> {
        pixels.iter().copied().collect::<Area>().polygons()
    }

    /// Returns whether the rings of a polygon wind around the middle of a pixel.
    fn holds(rings: &[Vec<Corner>], (i, j): Corner) -> bool {
        let crosses = |pair: &&[Corner]| {
            let [from, to] = [pair[0], pair[1]];
            from.0 == to.0 && from.0 > i && from.1.min(to.1) <= j && j < from.1.max(to.1)
        };
        rings.iter().map(|ring| ring.windows(2).filter(crosses).count()).sum::<usize>() % 2 == 1
    }

    proptest! {
        /// Pixels in any order, some twice.
        #[test]
        fn each_pixel_lies_in_one_polygon_of_the_pixels_that_hang_together_with_it(
            pixels in proptest::collection::vec((-6i64..6, -6i64..6), 0..120),
        ) {
            let found = polygons(&pixels);
            let area: BTreeSet<Corner> = pixels.iter().copied().collect();
            for pixel in (-8..8).flat_map(|i| (-8..8).map(move |j| (i, j))) {
                let around = found.iter().filter(|rings| holds(rings, pixel)).count();
                prop_assert_eq!(around, usize::from(area.contains(&pixel)), "{:?}", pixel);
            }
            let mut parts = 0;
            let mut open = area.clone();
            while let Some(first) = open.pop_first() {
                parts += 1;
                let mut edge = vec![first];
                while let Some((i, j)) = edge.pop() {
                    edge.extend([(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)].into_iter().filter(|next| open.remove(next)));
                }
            }
            prop_assert_eq!(found.len(), parts);
            for rings in &found {
                prop_assert!(twice_area(&rings[0]) > 0 && rings[1..].iter().all(|hole| twice_area(hole) < 0));
                // No corner lies on a straight line, and none is missing.
                for ring in rings {
                    prop_assert!(ring.first() == ring.last() && ring.len() >= 5);
                    let straight = |three: &[Corner]| {
                        (three[0].0 == three[1].0) == (three[1].0 == three[2].0)
                    };
                    prop_assert!(!ring.windows(3).any(straight), "{:?}", ring);
                }
            }
            let bounds = pixels.iter().copied().collect::<Area>().bounds();
            let along = |of: fn(&Corner) -> i64| Some((area.iter().map(of).min()?, area.iter().map(of).max()? + 1));
            let expected = along(|pixel| pixel.0).zip(along(|pixel| pixel.1)).map(|(i, j)| [(i.0, j.0), (i.1, j.1)]);
            prop_assert_eq!(bounds, expected);
        }
    }

    #[test]
    fn runs_that_hang_together_count_as_one() {
        let mut area: Area = (0..200).rev().map(|i| (i, 0)).collect();
        assert_eq!((area.runs(), area.joined_runs()), (200, 1));
    }

    #[test]
    fn outlines_hold_the_area_with_its_holes() {
        for rows in [
            &["#"][..],
            &["###", "#.#", "###"],
            &["##..", "##..", "..##", "..##"],
            &["#####", "#.#.#", "#####", "....#", "##..#"],
            &["######", "#....#", "#.##.#", "#.##.#", "#....#", "######"],
            &["####", "#..#", "##.#", "#..#", "####"],
        ] {
            let pixels = pixels(rows);
            let found = polygons(&pixels);
            let sum: i64 = found.iter().flatten().map(|ring| twice_area(ring)).sum();
            assert_eq!(sum, 2 * pixels.len() as i64, "{rows:?}: {found:?}");
            for rings in &found {
                assert!(rings.iter().all(|ring| ring.first() == ring.last() && ring.len() >= 5), "{rings:?}");
                assert!(twice_area(&rings[0]) > 0 && rings[1..].iter().all(|hole| twice_area(hole) < 0));
            }
        }
        assert_eq!(polygons(&pixels(&["##", "##"])), [[[(0, 0), (2, 0), (2, 2), (0, 2), (0, 0)]]]);
        assert_eq!(polygons(&pixels(&["###", "#.#", "###"]))[0].len(), 2);
    }
}
