//! Components: finds connected components of few voxels, out of core.
//!
//! Voxels are connected if they share a face, an edge or a corner. A voxel counts by its weight, in quarters; all but
//! those of faint splats count in full.
//!
//! [`Pieces`] holds the components of one area of a tile column, whose voxels are in memory. Components that end inside
//! the area are settled at once. A [`Frontier`] joins the others across the areas' edges. Of each area it keeps only the
//! voxels with neighbours in areas still to come, and only small components voxel by voxel; all components above the size
//! limit count as one.
//!
//! The result is a set of voxels that does not depend on the order and the cut of the areas.

use super::accumulate::{Area, Patch, neighbourhood};
use super::record::{ColumnKey, HALO_PIXELS, PATCH_PIXELS, WHOLE};
use crate::frame::{PageKey, TILE_PIXELS, morton};
use crate::{Error, Parameter, Result};
use std::collections::HashMap;

/// A voxel of a tile column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    /// Pixel of the patch, never in its halo.
    pixel: u16,
    /// Slice above the first of the column's block.
    slice: u32,
}

impl Place {
    /// Returns pixel and slice on the grid.
    fn on_grid(self, column: ColumnKey) -> ((i64, i64), i64) {
        let PageKey { tx, ty, .. } = PageKey::from_column(column.column, 0);
        let along = |tile: i32, patch: usize| i64::from(tile) * TILE_PIXELS + patch as i64 - HALO_PIXELS;
        let pixel = usize::from(self.pixel);
        let pixel = (along(tx, pixel % PATCH_PIXELS), along(ty, pixel / PATCH_PIXELS));
        (pixel, column.first_slice() + i64::from(self.slice))
    }
}

/// A dropped voxel: pixel and slice on the grid.
pub type Dropped = ((i64, i64), i64);

/// Returns the column that owns a voxel of a patch, which may lie in the halo, and its place there.
fn home(column: ColumnKey, pixel: usize, slice: u32) -> (ColumnKey, Place) {
    let tile = TILE_PIXELS as usize;
    let side = |patch: usize| match patch {
        0 => (-1, tile),
        patch if patch > tile => (1, patch - tile),
        patch => (0, patch),
    };
    let ((dx, px), (dy, py)) = (side(pixel % PATCH_PIXELS), side(pixel / PATCH_PIXELS));
    let place = Place { pixel: (py * PATCH_PIXELS + px) as u16, slice };
    if (dx, dy) == (0, 0) {
        return (column, place);
    }
    let PageKey { tx, ty, .. } = PageKey::from_column(column.column, 0);
    (ColumnKey { column: morton(tx.wrapping_add(dx), ty.wrapping_add(dy)), ..column }, place)
}

/// A voxel with neighbours outside its area.
#[derive(Debug)]
struct Edge {
    place: Place,
    /// Index into [`Pieces::open`]; `None` for a component above the size limit.
    piece: Option<u32>,
    /// First of its [`Pieces::links`].
    first_link: u32,
}

/// Components of one area.
#[derive(Debug)]
pub struct Pieces {
    column: ColumnKey,
    /// Voxels of small components that touch nothing outside the area.
    floaters: Vec<Place>,
    /// Voxels and weight of each small component that touches something outside.
    open: Vec<(Vec<Place>, u32)>,
    edges: Vec<Edge>,
    /// Patch pixel and slice of the neighbours outside the area.
    links: Vec<(u16, u32)>,
}

/// Finds the components of areas; reuses its buffers.
#[derive(Debug)]
pub struct PieceFinder {
    /// Greatest weight of a small component (quarters of voxels).
    most: u32,
    parents: Vec<u32>,
    weights: Vec<u32>,
    links: Vec<(u32, u16, u32)>,
}

impl PieceFinder {
    /// Creates a finder whose small components have at most `most` voxels.
    pub fn new(most: u16) -> Self {
        Self { most: quarters(most), parents: Vec::new(), weights: Vec::new(), links: Vec::new() }
    }

    /// Finds the components of an area of the column's patch. Cost: linear in its voxels.
    pub fn find(&mut self, column: ColumnKey, patch: &Patch, area: Area) -> Pieces {
        self.join(patch, area);
        let Self { most, parents, weights, links } = self;
        // Numbers the small components with links to outside, by root.
        let mut numbers: HashMap<u32, u32> = HashMap::new();
        links.sort_unstable();
        for &(voxel, ..) in &*links {
            let root = find(parents, voxel);
            if weights[root as usize] <= *most {
                let next = numbers.len() as u32;
                numbers.entry(root).or_insert(next);
            }
        }
        let mut pieces = Pieces {
            column,
            floaters: Vec::new(),
            open: vec![(Vec::new(), 0); numbers.len()],
            edges: Vec::new(),
            links: Vec::with_capacity(links.len()),
        };
        for pixel in patch.occupied().filter(|&pixel| area.holds(pixel)) {
            for voxel in patch.range(pixel) {
                let root = find(parents, voxel as u32);
                let weight = weights[root as usize];
                if weight <= *most {
                    let place = Place { pixel: pixel as u16, slice: patch.voxels()[voxel].slice };
                    match numbers.get(&root) {
                        Some(&number) => {
                            let (places, of_all) = &mut pieces.open[number as usize];
                            places.push(place);
                            *of_all = weight;
                        }
                        None => pieces.floaters.push(place),
                    }
                }
            }
        }
        let mut own = patch.occupied().peekable();
        for of_voxel in links.chunk_by(|a, b| a.0 == b.0) {
            let voxel = of_voxel[0].0;
            while own.peek().is_some_and(|&pixel| patch.range(pixel).end <= voxel as usize) {
                own.next();
            }
            let Some(&pixel) = own.peek() else { break };
            pieces.edges.push(Edge {
                place: Place { pixel: pixel as u16, slice: patch.voxels()[voxel as usize].slice },
                piece: numbers.get(&find(parents, voxel)).copied(),
                first_link: pieces.links.len() as u32,
            });
            pieces.links.extend(of_voxel.iter().map(|&(_, pixel, slice)| (pixel, slice)));
        }
        pieces
    }

    /// Joins connected voxels inside the area, and lists the neighbours outside.
    fn join(&mut self, patch: &Patch, area: Area) {
        let Self { parents, weights, links, .. } = self;
        let voxels = patch.voxels();
        parents.clear();
        parents.extend(0..voxels.len() as u32);
        links.clear();
        for pixel in patch.occupied().filter(|&pixel| area.holds(pixel)) {
            for voxel in patch.range(pixel).skip(1) {
                if voxels[voxel - 1].slice + 1 == voxels[voxel].slice {
                    union(parents, voxel as u32 - 1, voxel as u32);
                }
            }
            for (other, ..) in neighbourhood(pixel).filter(|&(other, ..)| other != pixel) {
                let inside = area.holds(other);
                // Visits pairs inside the area once.
                if inside && other > pixel {
                    continue;
                }
                touching(patch, pixel, other, |voxel, neighbour| {
                    if inside {
                        union(parents, voxel as u32, neighbour as u32);
                    } else {
                        links.push((voxel as u32, other as u16, voxels[neighbour].slice));
                    }
                });
            }
        }
        weights.clear();
        weights.resize(voxels.len(), 0);
        for pixel in patch.occupied().filter(|&pixel| area.holds(pixel)) {
            for voxel in patch.range(pixel) {
                let sum = &mut weights[find(parents, voxel as u32) as usize];
                *sum = sum.saturating_add(voxels[voxel].weight());
            }
        }
    }
}

/// Calls `take` with each voxel of a pixel and each voxel of a neighbouring pixel that it touches.
fn touching(patch: &Patch, pixel: usize, other: usize, mut take: impl FnMut(usize, usize)) {
    let voxels = patch.voxels();
    let others = patch.range(other);
    let mut first = others.start;
    for voxel in patch.range(pixel) {
        let slice = voxels[voxel].slice;
        while first < others.end && voxels[first].slice + 1 < slice {
            first += 1;
        }
        (first..others.end).take_while(|&other| voxels[other].slice <= slice + 1).for_each(|other| take(voxel, other));
    }
}

fn find(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        parents[at as usize] = parents[parents[at as usize] as usize];
        at = parents[at as usize];
    }
    at
}

fn union(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (find(parents, a), find(parents, b));
    parents[a.max(b) as usize] = a.min(b);
}

/// A voxel with neighbours in areas still to come.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    place: Place,
    /// Number of these neighbours.
    left: u8,
    node: u32,
}

#[derive(Debug, Default)]
struct OpenColumn {
    /// Sorted by place.
    voxels: Vec<Waiting>,
    left: u64,
}

/// A component, or a part of one whose parent is another part.
#[derive(Debug)]
struct Node {
    parent: u32,
    /// Waiting voxels of the whole component, if this is its root.
    waiting: u32,
    /// Weight of the whole component, if this is its root (quarters).
    weight: u32,
    voxels: Vec<(ColumnKey, Place)>,
}

/// Returns the weight of this many voxels that count in full.
fn quarters(voxels: u16) -> u32 {
    u32::from(voxels) * u32::from(WHOLE)
}

/// Stands for all components above the size limit.
const LARGE: u32 = 0;
/// Bytes of a waiting voxel, of a node, and of a voxel of a small component, doubled for the spare capacity of vectors.
const WAITING_BYTES: u64 = 2 * size_of::<Waiting>() as u64;
const NODE_BYTES: u64 = 2 * size_of::<Node>() as u64;
const VOXEL_BYTES: u64 = 2 * size_of::<(ColumnKey, Place)>() as u64;

/// Joins the components of areas that arrive in any order, each area once.
///
/// Memory: proportional to the voxels along the border of the areas seen, and to the small components among them.
#[derive(Debug)]
pub struct Frontier {
    /// Greatest weight of a small component (quarters of voxels).
    most: u32,
    max_bytes: u64,
    columns: HashMap<ColumnKey, OpenColumn>,
    nodes: Vec<Node>,
    /// Number of nodes after the last cleanup.
    tidy: usize,
    waiting: u64,
    voxels: u64,
}

impl Frontier {
    /// Creates a frontier whose small components have at most `most` voxels, using at most `max_bytes` of memory.
    pub fn new(most: u16, max_bytes: u64) -> Self {
        let large = Node { parent: LARGE, waiting: 0, weight: 0, voxels: Vec::new() };
        let (columns, nodes) = (HashMap::new(), vec![large]);
        Self { most: quarters(most), max_bytes, columns, nodes, tidy: 1, waiting: 0, voxels: 0 }
    }

    /// Adds the components of an area, and appends to `dropped` the voxels of all components that are now complete and
    /// small.
    ///
    /// Fails if the border takes too much memory.
    pub fn add(&mut self, pieces: Pieces, dropped: &mut Vec<Dropped>) -> Result<()> {
        let Pieces { column, floaters, open, edges, links } = pieces;
        dropped.extend(floaters.iter().map(|place| place.on_grid(column)));
        let first = self.nodes.len() as u32;
        let mut touched: Vec<u32> = (first..first + open.len() as u32).collect();
        for ((places, weight), &parent) in open.into_iter().zip(&touched) {
            self.voxels += places.len() as u64;
            let voxels = places.into_iter().map(|place| (column, place)).collect();
            self.nodes.push(Node { parent, waiting: 0, weight, voxels });
        }
        let mut own = OpenColumn::default();
        for (number, edge) in edges.iter().enumerate() {
            let end = edges.get(number + 1).map_or(links.len(), |next| next.first_link as usize);
            let node = edge.piece.map_or(LARGE, |piece| first + piece);
            let mut left = 0;
            for &(pixel, slice) in &links[edge.first_link as usize..end] {
                match self.meet(home(column, usize::from(pixel), slice)) {
                    Some(other) => {
                        self.join(node, other);
                        touched.push(other);
                    }
                    None => left += 1,
                }
            }
            if left > 0 {
                let root = self.root(node);
                self.nodes[root as usize].waiting += 1;
                own.voxels.push(Waiting { place: edge.place, left, node });
                own.left += u64::from(left);
            }
        }
        if own.left > 0 {
            self.waiting += own.voxels.len() as u64;
            let here = self.columns.entry(column).or_default();
            here.left += own.left;
            here.voxels.append(&mut own.voxels);
            here.voxels.sort_unstable_by_key(|waiting| waiting.place);
        }
        for node in touched {
            let root = self.root(node);
            if root != LARGE && self.nodes[root as usize].waiting == 0 {
                let voxels = std::mem::take(&mut self.nodes[root as usize].voxels);
                self.voxels -= voxels.len() as u64;
                dropped.extend(voxels.into_iter().map(|(column, place)| place.on_grid(column)));
            }
        }
        self.tidy_up();
        let bytes = self.waiting * WAITING_BYTES + self.nodes.len() as u64 * NODE_BYTES + self.voxels * VOXEL_BYTES;
        if bytes > self.max_bytes {
            let what = "memory for pieces of matter that are not complete yet (bytes; fewer voxels in pieces to drop, or \
                        larger pixels, need less)";
            return Err(Error::limit(what, bytes, self.max_bytes).with_suggestion(Parameter::Memory));
        }
        Ok(())
    }

    /// Counts one arrived neighbour of a waiting voxel and returns its node; `None` if the voxel itself has not
    /// arrived.
    fn meet(&mut self, (column, place): (ColumnKey, Place)) -> Option<u32> {
        let open = self.columns.get_mut(&column)?;
        let number = open.voxels.binary_search_by_key(&place, |waiting| waiting.place).ok()?;
        let waiting = &mut open.voxels[number];
        let node = waiting.node;
        waiting.left = waiting.left.saturating_sub(1);
        open.left = open.left.saturating_sub(1);
        let settled = waiting.left == 0;
        if open.left == 0 {
            self.waiting -= open.voxels.len() as u64;
            self.columns.remove(&column);
        }
        let root = self.root(node);
        if settled {
            let waiting = &mut self.nodes[root as usize].waiting;
            *waiting = waiting.saturating_sub(1);
        }
        Some(root)
    }

    fn root(&mut self, mut at: u32) -> u32 {
        while self.nodes[at as usize].parent != at {
            let next = self.nodes[at as usize].parent;
            self.nodes[at as usize].parent = self.nodes[next as usize].parent;
            at = next;
        }
        at
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        let [in_a, in_b] = [a, b].map(|node| self.nodes[node as usize].voxels.len());
        let weight = self.nodes[a as usize].weight + self.nodes[b as usize].weight;
        let large = a == LARGE || b == LARGE || weight > self.most;
        let into = match large {
            true => LARGE,
            false if in_a >= in_b => a,
            false => b,
        };
        for node in [a, b].into_iter().filter(|&node| node != into) {
            let from = &mut self.nodes[node as usize];
            from.parent = into;
            let (voxels, waiting) = (std::mem::take(&mut from.voxels), from.waiting);
            if large {
                self.voxels -= voxels.len() as u64;
            } else {
                self.nodes[into as usize].voxels.extend(voxels);
                self.nodes[into as usize].waiting += waiting;
                self.nodes[into as usize].weight = weight;
            }
        }
    }

    /// Drops nodes without waiting voxels once the number of nodes has doubled since the last cleanup.
    fn tidy_up(&mut self) {
        if self.nodes.len() < 2 * self.tidy + 1024 {
            return;
        }
        let mut columns = std::mem::take(&mut self.columns);
        let mut numbers = vec![LARGE; self.nodes.len()];
        let mut kept = 1;
        for waiting in columns.values_mut().flat_map(|column| &mut column.voxels).filter(|waiting| waiting.left > 0) {
            let root = self.root(waiting.node);
            if root != LARGE && numbers[root as usize] == LARGE {
                numbers[root as usize] = kept;
                kept += 1;
            }
            waiting.node = numbers[root as usize];
        }
        for waiting in columns.values_mut().flat_map(|column| &mut column.voxels).filter(|waiting| waiting.left == 0) {
            waiting.node = LARGE;
        }
        let large = std::iter::once((LARGE, Node { parent: LARGE, waiting: 0, weight: 0, voxels: Vec::new() }));
        let old = std::mem::take(&mut self.nodes).into_iter().zip(numbers).filter(|(_, number)| *number != LARGE);
        let mut nodes: Vec<_> =
            large.chain(old.map(|(node, number)| (number, Node { parent: number, ..node }))).collect();
        nodes.sort_unstable_by_key(|(number, _)| *number);
        self.nodes = nodes.into_iter().map(|(_, node)| node).collect();
        self.columns = columns;
        self.tidy = self.nodes.len();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::voxel::accumulate::Sums;
    use crate::voxel::record::{ColumnIndex, Record, Recorder, SurfacePart, SurfaceVoxel};
    use proptest::prelude::*;
    use std::collections::{BTreeMap, BTreeSet, HashSet};

    type Voxels = BTreeSet<(i64, i64, i64)>;

    /// Weight of a voxel: full without a seed, else any.
    fn weight((x, y, z): (i64, i64, i64), seed: Option<u64>) -> u8 {
        let hash = |seed| xxhash_rust::xxh3::xxh3_64_with_seed(format!("{x} {y} {z}").as_bytes(), seed);
        seed.map_or(WHOLE, |seed| 1 + (hash(seed) % u64::from(WHOLE)) as u8)
    }

    /// Reference implementation: flood fill, voxel by voxel.
    fn small(all: &Voxels, most: u16, weights: Option<u64>) -> Voxels {
        let (mut seen, mut dropped) = (HashSet::new(), Voxels::new());
        for &start in all {
            if !seen.insert(start) {
                continue;
            }
            let (mut piece, mut next) = (vec![start], 0);
            while let Some(&(x, y, z)) = piece.get(next) {
                next += 1;
                for step in 0..27 {
                    let near = (x + step % 3 - 1, y + step / 3 % 3 - 1, z + step / 9 - 1);
                    if all.contains(&near) && seen.insert(near) {
                        piece.push(near);
                    }
                }
            }
            let sum: u64 = piece.iter().map(|&place| u64::from(weight(place, weights))).sum();
            if sum <= 4 * u64::from(most) {
                dropped.extend(piece);
            }
        }
        dropped
    }

    /// Computes the same set by areas: each column in areas of `depth` halvings, in an order that depends on `seed`.
    fn found(all: &Voxels, most: u16, depth: u32, seed: u64, weights: Option<u64>) -> Voxels {
        let recorder = Recorder::new(Frame::new(1.0, 1.0).unwrap());
        let mut columns: BTreeMap<ColumnKey, Vec<Record>> = BTreeMap::new();
        for &(i, j, k) in all {
            let weight = weight((i, j, k), weights);
            if weight < WHOLE {
                let part = SurfacePart { bottom: 9, top: 99, steep: k % 2 == 0, undecided: false, weight };
                recorder.record_surface(&SurfaceVoxel { pixel: (i, j), slice: k, part }, |index, record| {
                    columns.entry(index.key()).or_default().push(record);
                });
                continue;
            }
            let [x, y, z] = [i, j, k].map(|v| [v as f64 + 0.5]);
            recorder.record(&x, &y, &z, |index: ColumnIndex, record| {
                columns.entry(index.key()).or_default().push(record);
            });
        }
        let mut units = Vec::new();
        for (key, records) in &columns {
            let mut areas = vec![Area::TILE];
            for _ in 0..depth {
                areas = areas.iter().flat_map(|area| area.halves().unwrap()).collect();
            }
            units.extend(areas.into_iter().map(|area| (*key, area, records)));
        }
        units.sort_by_key(|(key, area, _)| {
            xxhash_rust::xxh3::xxh3_64_with_seed(format!("{key:?}{area:?}").as_bytes(), seed)
        });
        let (mut patch, mut sums) = (Patch::default(), Sums::default());
        let (mut finder, mut frontier) = (PieceFinder::new(most), Frontier::new(most, u64::MAX));
        let mut dropped = Vec::new();
        for (key, area, records) in units {
            let own: Vec<Record> = records.iter().copied().filter(|r| area.holds_with_halo(r.pixel())).collect();
            patch.fold(&own[..], 1, area, &mut sums);
            frontier.add(finder.find(key, &patch, area), &mut dropped).unwrap();
        }
        assert!(frontier.columns.is_empty(), "every neighbour has come");
        assert_eq!((frontier.waiting, frontier.voxels), (0, 0));
        let set: Voxels = dropped.iter().map(|&((x, y), z)| (x, y, z)).collect();
        assert_eq!(set.len(), dropped.len(), "no voxel is dropped twice");
        set
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn pieces_across_areas_and_tiles_are_those_of_a_flood(
            // Around the corner of four tiles, where most components cross an edge.
            places in proptest::collection::vec((-9i64..9, -9i64..9, -4i64..5), 1..700),
            far in proptest::collection::vec((-70i64..140, 60i64..68, 0i64..2), 0..300),
            most in prop::sample::select(vec![1u16, 2, 3, 5, 9, 40, 400, 65_535]), depth in 0u32..5, seed: u64,
            weights in proptest::option::of(0u64..100)
        ) {
            let all: Voxels = places.into_iter().chain(far).collect();
            prop_assert_eq!(found(&all, most, depth, seed, weights), small(&all, most, weights));
        }
    }

    #[test]
    fn a_long_thin_piece_is_one_however_many_tiles_it_crosses() {
        let line: Voxels = (-200..300i64).map(|x| (x, x / 3, x.rem_euclid(2))).collect();
        for seed in 0..6 {
            assert_eq!(found(&line, 500, 1, seed, None).len(), 500, "all of it");
            assert_eq!(found(&line, 499, 1, seed, None).len(), 0, "it has one voxel more");
        }
    }

    #[test]
    fn many_pieces_are_forgotten_once_they_are_settled_and_a_limit_is_kept() {
        // Pairs across the edge of two columns of tiles, in many rows.
        let pairs: Voxels = (0..6400).flat_map(|row| [(63, 2 * row, 0), (64, 2 * row, 0)]).collect();
        assert_eq!(found(&pairs, 2, 0, 1, None).len(), pairs.len());
        let mut frontier = Frontier::new(2, 100);
        let pieces = Pieces {
            column: ColumnKey { column: 0, block: 0 },
            floaters: Vec::new(),
            open: vec![(vec![Place { pixel: 67, slice: 1 }], 4)],
            edges: vec![Edge { place: Place { pixel: 67, slice: 1 }, piece: Some(0), first_link: 0 }],
            links: vec![(0, 1)],
        };
        let refused = frontier.add(pieces, &mut Vec::new()).unwrap_err();
        assert_eq!(refused.suggestion(), Some(&Parameter::Memory));
    }
}
