//! A tree of boxes over the surfaces of a scene, so that truth and ray casting test few of them.

use crate::geometry::Aabb;

/// Most surfaces in a leaf.
const LEAF: usize = 4;

#[derive(Debug, Clone)]
struct Node {
    bounds: Aabb,
    /// Leaf: first place in `order`. Inner node: index of the second child; the first one follows its parent.
    start: u32,
    /// Leaf: number of surfaces, > 0. Inner node: 0.
    count: u32,
}

/// The tree. Its depth is logarithmic, because nodes are split at the median.
#[derive(Debug, Clone, Default)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    order: Vec<u32>,
}

impl Bvh {
    pub fn new(boxes: &[Aabb]) -> Self {
        let mut tree = Self { nodes: Vec::new(), order: (0..boxes.len() as u32).collect() };
        if !boxes.is_empty() {
            tree.build(boxes, 0, boxes.len());
        }
        tree
    }

    fn build(&mut self, boxes: &[Aabb], start: usize, end: usize) {
        let bounds = self.order[start..end].iter().fold(Aabb::EMPTY, |b, i| b.union(&boxes[*i as usize]));
        let index = self.nodes.len();
        self.nodes.push(Node { bounds, start: start as u32, count: (end - start) as u32 });
        if end - start <= LEAF {
            return;
        }
        let axis = (0..3)
            .max_by(|a, b| (bounds.max[*a] - bounds.min[*a]).total_cmp(&(bounds.max[*b] - bounds.min[*b])))
            .unwrap_or(0);
        let middle = (start + end) / 2;
        // Ties are broken by index, so the tree, and with it the order of equal answers, is the same everywhere.
        self.order[start..end].sort_by(|a, b| {
            boxes[*a as usize].center()[axis].total_cmp(&boxes[*b as usize].center()[axis]).then(a.cmp(b))
        });
        self.build(boxes, start, middle);
        let second = self.nodes.len() as u32;
        self.build(boxes, middle, end);
        self.nodes[index].start = second;
        self.nodes[index].count = 0;
    }

    /// Returns the least value over the surfaces. `bound` of a box is at most `value` of its contents (`None`:
    /// irrelevant); `value` receives the best value found before. Nearer nodes come first.
    pub fn least(
        &self,
        limit: f64,
        bound: impl Fn(&Aabb, f64) -> Option<f64>,
        mut value: impl FnMut(usize, f64) -> Option<f64>,
    ) -> Option<(usize, f64)> {
        let (mut best, mut which) = (limit, None);
        let mut stack = Stack::new();
        if let Some(low) = self.nodes.first().and_then(|root| bound(&root.bounds, best)) {
            stack.push(0, low);
        }
        while let Some((at, low)) = stack.pop() {
            if low >= best {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                for i in &self.order[node.start as usize..(node.start + node.count) as usize] {
                    if let Some(v) = value(*i as usize, best).filter(|v| *v < best) {
                        (best, which) = (v, Some(*i as usize));
                    }
                }
                continue;
            }
            let children = [at + 1, node.start].map(|c| (c, bound(&self.nodes[c as usize].bounds, best)));
            let [first, second] = children;
            let swapped = first.1.unwrap_or(f64::INFINITY) > second.1.unwrap_or(f64::INFINITY);
            let (near, far) = if swapped { (second, first) } else { (first, second) };
            for (child, low) in [far, near] {
                if let Some(low) = low.filter(|low| *low < best) {
                    stack.push(child, low);
                }
            }
        }
        which.map(|i| (i, best))
    }
}

/// A small stack without allocation: at most 32 levels, one pending sibling each.
struct Stack {
    items: [(u32, f64); 64],
    len: usize,
}

impl Stack {
    fn new() -> Self {
        Self { items: [(0, 0.0); 64], len: 0 }
    }

    fn push(&mut self, node: u32, low: f64) {
        self.items[self.len] = (node, low);
        self.len += 1;
    }

    fn pop(&mut self) -> Option<(u32, f64)> {
        self.len = self.len.checked_sub(1)?;
        Some(self.items[self.len])
    }
}
