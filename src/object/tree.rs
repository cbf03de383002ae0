//! A binary tree of boxes over the spans of a model.

use super::oriented::LocalBox;

/// Most spans of a leaf.
const LEAF_ITEMS: usize = 4;
/// Most spans of a model; they take 2 GiB with their tree.
pub(super) const MOST_ITEMS: usize = 1 << 26;
/// Most pixels or quanta along an axis of a model, so that indices fit `i32`.
pub(super) const MOST_REACH: i64 = 1 << 30;

/// Returns the levels of the deepest tree; each level halves the spans.
pub(super) const fn deepest() -> usize {
    MOST_ITEMS.ilog2() as usize + 1
}

/// A span: pixel, lowest and highest quantum, relative to the model's middle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Item {
    pub i: i32,
    pub j: i32,
    pub bottom: i32,
    pub top: i32,
}

impl Item {
    /// Returns the ends along an axis, in pixels or quanta.
    fn range(self, axis: usize) -> (i32, i32) {
        match axis {
            0 => (self.i, self.i + 1),
            1 => (self.j, self.j + 1),
            _ => (self.bottom, self.top),
        }
    }
}

/// A box around the spans below it, in 32 bits and rounded outwards, so that two nodes share a cache line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    middle: [f32; 3],
    half: [f32; 3],
    /// First span of a leaf; for an inner node, its second child (the first child is the next node).
    next: u32,
    /// Spans of a leaf; 0 for an inner node.
    count: u32,
}

impl Node {
    #[inline]
    pub(super) fn bounds(&self) -> LocalBox {
        LocalBox { middle: self.middle.map(f64::from), half: self.half.map(f64::from) }
    }

    /// Returns the size by which the larger of two nodes is chosen for descent.
    #[inline]
    pub(super) fn size(&self) -> f32 {
        self.half[0] + self.half[1] + self.half[2]
    }

    /// Returns the children of node `number`, or `None` for a leaf.
    #[inline]
    pub(super) fn children(&self, number: u32) -> Option<[u32; 2]> {
        (self.count == 0).then_some([number + 1, self.next])
    }
}

/// Spans in the order of the leaves, and the nodes above them, each before its children.
#[derive(Debug, Clone)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    items: Vec<Item>,
    /// Edges of a pixel and height of a quantum (m).
    unit: [f64; 3],
}

impl Tree {
    /// Builds a tree over `items`, at most [`MOST_ITEMS`] of them.
    pub(super) fn new(mut items: Vec<Item>, unit: [f64; 3]) -> Self {
        let mut nodes = Vec::with_capacity(items.len() / 2 + 1);
        items.sort_unstable();
        if !items.is_empty() {
            build(&mut nodes, &mut items, 0, unit);
        }
        Self { nodes, items, unit }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    pub(super) fn len(&self) -> usize {
        self.items.len()
    }

    pub(super) fn weight_bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.items[..])
    }

    #[inline]
    pub(super) fn node(&self, number: u32) -> &Node {
        &self.nodes[number as usize]
    }

    /// Iterates over the boxes of a leaf's spans.
    #[inline]
    pub(super) fn items(&self, leaf: &Node) -> impl Iterator<Item = LocalBox> + Clone {
        let first = leaf.next as usize;
        self.items[first..first + leaf.count as usize].iter().map(|&item| self.box_of(item))
    }

    /// Iterates over the boxes of all spans.
    pub(super) fn all(&self) -> impl Iterator<Item = LocalBox> {
        self.items.iter().map(|&item| self.box_of(item))
    }

    fn box_of(&self, item: Item) -> LocalBox {
        let ends = [0, 1, 2].map(|axis| {
            let (low, high) = item.range(axis);
            (f64::from(low) * self.unit[axis], f64::from(high) * self.unit[axis])
        });
        LocalBox {
            middle: ends.map(|(low, high)| (low + high) / 2.0),
            half: ends.map(|(low, high)| (high - low) / 2.0),
        }
    }

    /// Returns whether any span is `hit` among those whose enclosing boxes are all `near`.
    pub(super) fn any(&self, near: impl Fn(&LocalBox) -> bool, hit: impl Fn(&LocalBox) -> bool) -> bool {
        let mut found = false;
        self.descend(near, |item| {
            found = hit(item);
            found
        });
        found
    }

    /// Passes the spans whose enclosing boxes are all `near` to `enough`, until that returns `true`.
    pub(super) fn descend(&self, mut near: impl FnMut(&LocalBox) -> bool, mut enough: impl FnMut(&LocalBox) -> bool) {
        let mut open = [0u32; deepest() + 1];
        let mut count = usize::from(!self.is_empty());
        while count > 0 {
            count -= 1;
            let number = open[count];
            let node = self.node(number);
            if !near(&node.bounds()) {
                continue;
            }
            match node.children(number) {
                Some([first, second]) => {
                    (open[count], open[count + 1]) = (second, first);
                    count += 2;
                }
                None => {
                    if self.items(node).any(|item| enough(&item)) {
                        return;
                    }
                }
            }
        }
    }
}

/// Appends the nodes over `items`; `first` is the number of the first item.
fn build(nodes: &mut Vec<Node>, items: &mut [Item], first: usize, unit: [f64; 3]) {
    let ends = [0, 1, 2].map(|axis| {
        let low = items.iter().map(|item| item.range(axis).0).min().unwrap_or(0);
        let high = items.iter().map(|item| item.range(axis).1).max().unwrap_or(0);
        (f64::from(low) * unit[axis], f64::from(high) * unit[axis])
    });
    let middle = ends.map(|(low, high)| ((low + high) / 2.0) as f32);
    let half = [0, 1, 2].map(|axis| {
        let middle = f64::from(middle[axis]);
        let reach = (middle - ends[axis].0).max(ends[axis].1 - middle);
        // The conversion rounds to nearest, so the next number up is above the exact reach.
        (reach as f32).next_up()
    });
    let number = nodes.len();
    let leaf = items.len() <= LEAF_ITEMS;
    let count = if leaf { items.len() as u32 } else { 0 };
    nodes.push(Node { middle, half, next: first as u32, count });
    if leaf {
        return;
    }
    let length = |axis: usize| ends[axis].1 - ends[axis].0;
    let axis = (0..3).fold(0, |longest, axis| if length(axis) > length(longest) { axis } else { longest });
    let cut = items.len() / 2;
    items
        .select_nth_unstable_by_key(cut, |item| (i64::from(item.range(axis).0) + i64::from(item.range(axis).1), *item));
    let (low, high) = items.split_at_mut(cut);
    build(nodes, low, first, unit);
    nodes[number].next = nodes.len() as u32;
    build(nodes, high, first + cut, unit);
}
