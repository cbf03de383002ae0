use super::*;
use slicewalk_base::bytes::MemorySource;
use slicewalk_base::bytes::testing::{Fault, FaultySource};
use slicewalk_base::frame::Frame;
use std::collections::{BTreeMap, BTreeSet};

fn all(reader: Result<CubeReader>) -> Result<Vec<Cube>> {
    let mut reader = reader?;
    let (mut cubes, mut batch) = (Vec::new(), Vec::new());
    while reader.next_batch(&mut batch)? {
        cubes.extend_from_slice(&batch);
    }
    assert!(!reader.next_batch(&mut batch)?, "stays at its end");
    Ok(cubes)
}

/// Numbers of a linear congruential generator.
struct Random(u64);

impl Random {
    fn below(&mut self, most: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % most
    }
}

enum Node {
    Unknown,
    Free,
    Solid,
    Inner(Vec<Node>),
}

/// A tree whose leaves lie at any depth; it is deep along one path, so that cubes of the finest level occur.
fn tree(random: &mut Random, levels: u32) -> Node {
    let path = random.below(8);
    let child = |random: &mut Random, number: u64| match random.below(12) {
        _ if number == path && levels > 1 => tree(random, levels - 1),
        // A node without children would be a leaf in a `.ot`.
        _ if number == path => Node::Solid,
        0 if levels > 1 && levels < 5 => tree(random, levels - 1),
        1..=3 => Node::Solid,
        4 | 5 => Node::Free,
        _ => Node::Unknown,
    };
    Node::Inner((0..8).map(|number| child(random, number)).collect())
}

/// Lowest corner and edge of each solid leaf.
fn leaves(node: &Node, corner: [i64; 3], edge: i64, out: &mut BTreeSet<([i64; 3], i64)>) {
    match node {
        Node::Solid => drop(out.insert((corner, edge))),
        Node::Inner(children) => {
            let half = edge / 2;
            for (number, child) in children.iter().enumerate() {
                let [x, y, z] = [number & 1, number >> 1 & 1, number >> 2].map(|bit| bit as i64 * half);
                leaves(child, [corner[0] + x, corner[1] + y, corner[2] + z], half, out);
            }
        }
        _ => {}
    }
}

fn count(node: &Node) -> u64 {
    match node {
        Node::Unknown => 0,
        Node::Inner(children) => 1 + children.iter().map(count).sum::<u64>(),
        _ => 1,
    }
}

fn encode_binary(node: &Node, out: &mut Vec<u8>) {
    let Node::Inner(children) = node else { return };
    let bits = |(number, child): (usize, &Node)| {
        let bits: u16 = match child {
            Node::Unknown => 0,
            Node::Free => 1,
            Node::Solid => 2,
            Node::Inner(_) => 3,
        };
        bits << (2 * number)
    };
    out.extend(children.iter().enumerate().map(bits).sum::<u16>().to_le_bytes());
    children.iter().for_each(|child| encode_binary(child, out));
}

fn encode_full(node: &Node, colour: &[u8], out: &mut Vec<u8>) {
    let odds: f32 = match node {
        Node::Unknown => return,
        Node::Free => -0.4,
        Node::Solid => 0.85,
        Node::Inner(_) => 3.5,
    };
    out.extend(odds.to_le_bytes());
    out.extend(colour);
    let Node::Inner(children) = node else { return out.push(0) };
    let is_there = |child: &Node| !matches!(child, Node::Unknown);
    out.push(children.iter().enumerate().map(|(number, child)| u8::from(is_there(child)) << number).sum());
    children.iter().for_each(|child| encode_full(child, colour, out));
}

fn octomap(first: &str, id: &str, nodes: u64, data: &[u8]) -> Vec<u8> {
    let mut bytes = format!("{first}\n# a comment\nid {id}\nsize {nodes}\nres 0.05\ndata\n").into_bytes();
    bytes.extend(data);
    bytes
}

const BINARY: &str = "# Octomap OcTree binary file";
const FULL: &str = "# Octomap OcTree file";

fn read(bytes: &[u8]) -> Result<Vec<Cube>> {
    all(CubeReader::of_source(Arc::new(MemorySource::new(bytes)), "t.bt"))
}

fn set(cubes: &[Cube]) -> BTreeSet<([i64; 3], i64)> {
    let set: BTreeSet<_> = cubes.iter().map(|cube| (cube.corner, cube.edge)).collect();
    assert_eq!(set.len(), cubes.len(), "a cube came twice");
    set
}

#[test]
fn trees_of_octomap_give_their_solid_leaves() {
    let mut fine = 0;
    for seed in 0..40 {
        let tree = tree(&mut Random(seed), 16);
        let mut expected = BTreeSet::new();
        leaves(&tree, [-(1 << 15); 3], 1 << 16, &mut expected);
        fine += expected.iter().filter(|(_, edge)| *edge == 1).count();
        let (mut binary, mut full, mut coloured) = (Vec::new(), Vec::new(), Vec::new());
        encode_binary(&tree, &mut binary);
        encode_full(&tree, &[], &mut full);
        encode_full(&tree, &[1, 2, 3], &mut coloured);
        let nodes = count(&tree);
        for (first, id, data) in [
            (BINARY, "OcTree", &binary),
            (BINARY, "1", &binary),
            (FULL, "OcTree", &full),
            (FULL, "ColorOcTree", &coloured),
        ] {
            assert_eq!(set(&read(&octomap(first, id, nodes, data)).unwrap()), expected, "{seed} {first} {id}");
        }
        for wrong in [nodes - 1, nodes + 1, u64::MAX] {
            assert!(read(&octomap(BINARY, "OcTree", wrong, &binary)).is_err());
        }
    }
    assert!(fine > 40, "{fine}");
}

#[test]
fn moved_trees_are_moved_back_and_empty_ones_are_empty() {
    let mut tree = octomap(BINARY, "OcTree", 3, &[2, 0b1000_0000]);
    tree.splice(0..BINARY.len() + 1, format!("{BINARY}\n# moved by 3.2 0 -6.4 m\n").into_bytes());
    let half = 1 << 15;
    let expected = [[-half - 64, -half, -half + 128], [-64, 0, 128]].map(|corner| Cube { corner, edge: half });
    assert_eq!(read(&tree).unwrap(), expected);
    assert_eq!(read(&octomap(BINARY, "OcTree", 0, &[])).unwrap(), []);
    let cube = Cube { corner: [-half; 3], edge: 2 * half };
    let leaf = [&0.0f32.to_le_bytes()[..], &[0]].concat();
    assert_eq!(read(&octomap(FULL, "OcTree", 1, &leaf)).unwrap(), [cube]);
}

/// The tree of single cubes, each free or occupied, as the format describes it.
fn tree_of(cubes: &[([i64; 3], bool)], corner: [i64; 3], edge: i64) -> Node {
    if let ([(_, occupied)], 1) = (cubes, edge) {
        return if *occupied { Node::Solid } else { Node::Free };
    }
    if cubes.is_empty() {
        return Node::Unknown;
    }
    let half = edge / 2;
    let child = |number: i64| {
        let corner = [0, 1, 2].map(|axis| corner[axis] + half * (number >> axis & 1));
        let is_inside = |at: &[i64; 3]| (0..3).all(|axis| (corner[axis]..corner[axis] + half).contains(&at[axis]));
        let own: Vec<_> = cubes.iter().filter(|(at, _)| is_inside(at)).copied().collect();
        tree_of(&own, corner, half)
    };
    let children: Vec<Node> = (0..8).map(child).collect();
    match &children[0] {
        Node::Solid if children.iter().all(|child| matches!(child, Node::Solid)) => Node::Solid,
        Node::Free if children.iter().all(|child| matches!(child, Node::Free)) => Node::Free,
        _ => Node::Inner(children),
    }
}

/// Runs of cubes in columns, tile by tile; some fill whole blocks of cubes.
fn runs(random: &mut Random, corner: [i64; 3]) -> Vec<([i64; 2], (i64, i64), bool)> {
    let mut runs = Vec::new();
    for (x, y) in [(-70, 0), (0, -64), (0, 0)] {
        for _ in 0..40 {
            let at = [x + random.below(64) as i64, y + random.below(64) as i64];
            let first = random.below(200) as i64 - 100;
            runs.push((at, (first, first + 1 + random.below(90) as i64), random.below(3) > 0));
        }
        let is_solid = random.below(2) == 0;
        runs.extend((0..64).map(|n| ([x.div_euclid(64) * 64 + n % 8, y + n / 8], (-8, 16), is_solid)));
    }
    runs.iter_mut().for_each(|(at, (first, end), _)| {
        (*at, *first, *end) = ([at[0] + corner[0], at[1] + corner[1]], *first + corner[2], *end + corner[2]);
    });
    runs.sort_by_key(|(at, ..)| at.map(|v| v.div_euclid(64)));
    runs
}

fn written(runs: &[([i64; 2], (i64, i64), bool)]) -> Octomap {
    let mut tree = OctomapTree::new();
    for &(at, cubes, is_occupied) in runs {
        if is_occupied { tree.occupy(at, cubes) } else { tree.free(at, cubes) }
    }
    tree.finish(0.05).unwrap()
}

#[test]
fn written_trees_are_those_of_their_cubes() {
    for seed in 0..6 {
        let runs = runs(&mut Random(seed), [0; 3]);
        let mut cubes = BTreeMap::new();
        for &([x, y], (first, end), is_occupied) in &runs {
            (first..end).for_each(|z| *cubes.entry([x, y, z]).or_insert(false) |= is_occupied);
        }
        let cubes: Vec<_> = cubes.into_iter().collect();
        let tree = tree_of(&cubes, [-(1 << 15); 3], 1 << 16);
        let mut expected = format!("{BINARY}\nid OcTree\nsize {}\nres 0.05\ndata\n", count(&tree)).into_bytes();
        encode_binary(&tree, &mut expected);
        let (octomap, mut bytes) = (written(&runs), Vec::new());
        octomap.write(&mut bytes).unwrap();
        assert!(bytes == expected, "seed {seed}");
        let occupied = cubes.iter().filter(|(_, occupied)| *occupied).count() as u64;
        assert_eq!((octomap.occupied, octomap.free), (occupied, cubes.len() as u64 - occupied));
    }
}

#[test]
fn written_trees_far_from_the_origin_are_moved_and_come_back() {
    let corner = [640_000, -6_400_000, 0];
    let cubes = |corner| {
        let octomap = written(&runs(&mut Random(1), corner));
        let mut bytes = Vec::new();
        octomap.write(&mut bytes).unwrap();
        (octomap.moved, read(&bytes).unwrap())
    };
    let ((still, near), (moved, far)) = (cubes([0; 3]), cubes(corner));
    assert_eq!((still, moved[2]), ([0; 3], 0));
    assert!(moved[0] < 0 && moved[1] > 0, "{moved:?}");
    let single = |cubes: &[Cube], by: [i64; 3]| {
        let of = |cube: &Cube| {
            let (corner, edge) = (cube.corner, cube.edge);
            (0..edge.pow(3))
                .map(move |n| [n % edge, n / edge % edge, n / edge / edge])
                .map(move |at| [0, 1, 2].map(|axis| corner[axis] + at[axis] - by[axis]))
        };
        cubes.iter().flat_map(of).collect::<BTreeSet<_>>()
    };
    assert_eq!(single(&far, corner), single(&near, [0; 3]));
}

#[test]
fn full_blocks_are_leaves_and_eight_of_them_are_a_larger_one() {
    for (edge, is_occupied) in [(64, true), (128, true), (128, false)] {
        let tiles = (0..edge / 64).flat_map(|y| (0..edge / 64).map(move |x| [x, y]));
        let columns = tiles.flat_map(|[x, y]| (0..64 * 64).map(move |n| [64 * x + n % 64, 64 * y + n / 64]));
        let runs: Vec<_> = columns.map(|at| (at, (0, edge), is_occupied)).collect();
        let mut bytes = Vec::new();
        written(&runs).write(&mut bytes).unwrap();
        let cubes = if is_occupied { vec![Cube { corner: [0; 3], edge }] } else { Vec::new() };
        assert_eq!(read(&bytes).unwrap(), cubes, "{edge}");
        // The nodes from the root to the leaf.
        let size = format!("\nsize {}\n", ((1i64 << 16) / edge).ilog2() + 1);
        assert!(String::from_utf8_lossy(&bytes).contains(&size), "{edge}: expected {size}");
    }
}

#[test]
fn names_decide_where_the_content_says_nothing() {
    for (head, name, format) in [
        (BINARY, "a.ot", Some(CubeFormat::OctomapBinary)),
        (FULL, "a.bt", Some(CubeFormat::Octomap)),
        ("", "a.bt", Some(CubeFormat::OctomapBinary)),
        ("", "a.OT", Some(CubeFormat::Octomap)),
        ("{", "a.voxel.json", Some(CubeFormat::Voxel)),
        ("{", "a.json", None),
        ("", "a", None),
    ] {
        assert_eq!(recognise(head.as_bytes(), Path::new(name)), format, "{name}");
    }
    let unknown = CubeReader::of_source(Arc::new(MemorySource::new(&b"ply"[..])), "a.ply").err().unwrap();
    assert!(unknown.to_string().contains("expected an OctoMap tree"), "{unknown}");
}

#[test]
fn after_a_failed_read_the_bytes_are_read_again() {
    let bytes: Vec<u8> = (0..100).collect();
    let source = Arc::new(FaultySource::new(MemorySource::new(&bytes[..])));
    let mut window = window::Window::new(source.clone());
    source.set(Fault::Fail, 0..100);
    assert!(window.bytes::<4>(8).is_err());
    source.set(Fault::Flip, 8..9);
    assert_eq!(window.bytes::<4>(8).unwrap(), Some([8 ^ 0x10, 9, 10, 11]));
}

#[test]
fn trees_without_cubes_and_too_large_ones() {
    let mut bytes = Vec::new();
    OctomapTree::new().finish(0.1).unwrap().write(&mut bytes).unwrap();
    assert!(read(&bytes).unwrap().is_empty());
    let mut tree = OctomapTree::new();
    tree.occupy([0, 0], (0, 1));
    tree.occupy([OctomapTree::MOST_CUBES, 0], (0, 1));
    assert!(tree.finish(0.1).is_none());
}

#[test]
fn spans_higher_than_a_tree_take_no_memory() {
    for spans in [&[(0, 1 << 40)][..], &[(0, 1), (1 << 40, (1 << 40) + 1)]] {
        let mut tree = OctomapTree::new();
        spans.iter().for_each(|&span| tree.occupy([0, 0], span));
        assert!(tree.finish(0.1).is_none());
    }
    // As high as a tree, wherever it begins. A run of no cubes counts nowhere.
    const MOST: i64 = OctomapTree::MOST_CUBES;
    for first in [-MOST / 2, 0, -64, 64 * 1001, -64 * 2047] {
        let mut tree = OctomapTree::new();
        for cubes in [(first, first + 1), (first + MOST - 1, first + MOST), (1 << 40, 1 << 40)] {
            tree.occupy([0, 0], cubes);
        }
        let mut bytes = Vec::new();
        tree.finish(0.1).unwrap().write(&mut bytes).unwrap();
        let heights: Vec<i64> = read(&bytes).unwrap().iter().map(|cube| cube.corner[2]).collect();
        assert_eq!(heights, [first, first + MOST - 1]);
    }
}

#[test]
#[should_panic(expected = "two turns")]
fn tiles_in_two_turns_are_a_mistake() {
    let mut tree = OctomapTree::new();
    for at in [[0, 0], [64, 0], [1, 1]] {
        tree.occupy(at, (0, 1));
    }
    tree.finish(0.1);
}

#[test]
fn free_cubes_of_any_tile_are_added_once() {
    let frame = Frame::new(0.1, 0.1).unwrap();
    // Tiles before, at, between and after those with occupied cubes, in an order of their own.
    let cells = [[128, 0], [-64, 60], [0, 0], [64, 64], [0, 64], [256, 0], [-128, 0]];
    let octomap = |is_stepped: bool| {
        let free = FreeCubes::new(&frame, 4, cells.map(|cell| (cell, [3, 7])), Some([[-62, 0, 5], [200, 200, 200]]));
        let mut tree = OctomapTree::new().with_free(free);
        for at in [[64, 0], [65, 2], [0, 0], [64, 64]] {
            tree.occupy(at, (5, 6));
        }
        if is_stepped {
            let steps = std::iter::repeat_with(|| tree.encode_next()).take_while(|&is_left| is_left).count();
            assert_eq!(steps, 3, "tiles of free cubes alone");
        }
        let (octomap, mut bytes) = (tree.finish(0.1).unwrap(), Vec::new());
        octomap.write(&mut bytes).unwrap();
        (octomap.occupied, octomap.free, bytes)
    };
    let (occupied, free, bytes) = octomap(false);
    // Five cells of 4 × 4 × 2, one of them cut to half, and two of their cubes are occupied; two more lie outside.
    assert_eq!((occupied, free), (4, 5 * 32 - 16 - 2));
    assert!(octomap(true) == (occupied, free, bytes), "step by step");
}

#[test]
fn spans_reach_at_least_one_cube() {
    let frame = Frame::new(0.1, 0.3).unwrap();
    let cubes = SpanCubes::of(&frame);
    // A cube is 85 quanta.
    assert_eq!(cubes.of_span(0, 0), (0, 1));
    assert_eq!([84, 85, 86].map(|height| cubes.of_span(height, height)), [(0, 1), (1, 2), (1, 2)]);
    assert_eq!(cubes.of_span(-1, 85), (-1, 1));
    assert_eq!(cubes.of_span(84, 86), (0, 2));
    let frame = Frame::new(0.1, 0.17).unwrap();
    let cubes = SpanCubes::of(&frame);
    for bottom in -600..600 {
        let (first, end) = cubes.of_span(bottom, bottom + 40);
        let [low, high] = [first, end].map(|cube| cube as f64 * 0.1);
        assert!(low <= frame.bottom_height(bottom) + 1e-12 && high >= frame.top_height(bottom + 40) - 1e-12);
        assert!(end - first <= 2, "{bottom}");
    }
}

/// Reads damaged copies of `good`; returns how many were refused. Every message is one line that names the file.
fn damage(good: &[u8], read: impl Fn(&[u8]) -> Result<Vec<Cube>>) -> usize {
    let mut refused = 0;
    let mut check = |bytes: &[u8], must_fail: bool| match read(bytes) {
        // A block of 8 bytes holds 64 cubes at most.
        Ok(cubes) => assert!(!must_fail && cubes.len() <= 8 * bytes.len(), "{} bytes", bytes.len()),
        Err(error) => {
            let text = error.to_string();
            assert!(!text.contains('\n') && text.contains("t."), "{text}");
            refused += 1;
        }
    };
    (0..good.len()).for_each(|len| check(&good[..len], true));
    for at in 0..good.len() {
        for mask in [1, 0x80, 0xFF, 0x0F, 0x40] {
            let mut bytes = good.to_vec();
            bytes[at] ^= mask;
            check(&bytes, false);
        }
    }
    let mut random = Random(9);
    for _ in 0..2000 {
        let mut bytes = good.to_vec();
        for _ in 0..1 + random.below(6) {
            let at = random.below(bytes.len() as u64) as usize;
            bytes[at] = random.below(256) as u8;
        }
        check(&bytes, false);
    }
    check(&[good, &[0]].concat(), true);
    refused
}

#[test]
fn damaged_trees_of_octomap_are_refused_in_one_line() {
    let tree = tree(&mut Random(3), 16);
    let (mut binary, mut full) = (Vec::new(), Vec::new());
    encode_binary(&tree, &mut binary);
    encode_full(&tree, &[], &mut full);
    for (first, data) in [(BINARY, binary), (FULL, full)] {
        let good = octomap(first, "OcTree", count(&tree), &data);
        assert!(damage(&good, read) > good.len());
    }
    // Inner nodes down to a level that no tree has.
    let deep: Vec<u8> = [3, 0].repeat(40);
    let text = read(&octomap(BINARY, "OcTree", 41, &deep)).unwrap_err().to_string();
    assert!(text.contains("finest of 16 levels"), "{text}");
    let deep: Vec<u8> = [0, 0, 0, 0, 1].repeat(40);
    let text = read(&octomap(FULL, "OcTree", 41, &deep)).unwrap_err().to_string();
    assert!(text.contains("deeper than the 16 levels"), "{text}");
    // A header that says something twice could be meant either way.
    let good = String::from_utf8(octomap(BINARY, "OcTree", 0, &[])).unwrap();
    for line in ["id OcTree", "size 0", "res 0.1"] {
        let text = read(good.replace("data", &format!("{line}\ndata")).as_bytes()).unwrap_err().to_string();
        assert!(text.contains("found two"), "{text}");
    }
    let moved = "# moved by 1 0 0 m\n";
    assert!(read(good.replace("data", &format!("{moved}data")).as_bytes()).is_ok());
    let text = read(good.replace("data", &format!("{moved}{moved}data")).as_bytes()).unwrap_err().to_string();
    assert!(text.contains("expected one line \"# moved by\", found two"), "{text}");
    let text = read(good.replace("data", "# moved by 0.12 0 0 m\ndata").as_bytes()).unwrap_err().to_string();
    assert!(text.contains("no whole number of cubes"), "{text}");
    let leaf = [&f32::NAN.to_le_bytes()[..], &[0]].concat();
    let text = read(&octomap(FULL, "OcTree", 1, &leaf)).unwrap_err().to_string();
    assert!(text.contains("log-odds is no number"), "{text}");
    for (kind, expected) in [("OcTreeStamped", "OcTreeStamped"), ("", "found")] {
        let text = read(&octomap(BINARY, kind, 1, &[0, 0])).unwrap_err().to_string();
        assert!(text.contains(expected), "{text}");
    }
}

/// Header and words of an octree whose root has eight children, solid, mixed and inner ones among them.
fn octree() -> (String, Vec<u8>) {
    let inner = |mask: u32, first: u32| mask << 24 | first;
    let solid = 0xFF00_0000;
    // Level 0; level 1: children 0, 3 and 7; level 2: children 1 and 2 of 3, and 0 of 7.
    let nodes = [inner(0b1000_1001, 1), solid, inner(0b110, 4), inner(1, 6), 0, solid, 1];
    let leaves = [1u64 | 1 << 63, 1 << 27];
    let words = nodes.iter().flat_map(|word| word.to_le_bytes());
    let words = words.chain(leaves.iter().flat_map(|bits| bits.to_le_bytes())).collect();
    let head = r#"{"version":"1.1","gridBounds":{"min":[-0.4,0.2,0.6],"max":[1.2,1.8,2.2]},
        "sceneBounds":{"min":[0,0,0],"max":[1,1,1]},"voxelResolution":0.1,"leafSize":4,"treeDepth":2,
        "numInteriorNodes":3,"numMixedLeaves":2,"nodeCount":7,"leafDataCount":4}"#;
    (head.to_owned(), words)
}

fn read_octree(head: &[u8], words: &[u8]) -> Result<Vec<Cube>> {
    let sources = [head, words].map(|bytes| Arc::new(MemorySource::new(bytes)) as Arc<dyn ByteSource>);
    all(voxel::of_sources(sources, Path::new("t.voxel.json"), "t.voxel.bin".into()))
}

#[test]
fn octrees_give_their_solid_cubes_with_z_up() {
    let (head, words) = octree();
    let found = read_octree(head.as_bytes(), &words).unwrap();
    // Corners in the axes of the file, from the corner of the grid: blocks of 4 cubes in a grid of 16.
    let expected = [([0, 0, 0], 8), ([12, 8, 0], 1), ([15, 11, 3], 1), ([8, 12, 0], 4), ([11, 10, 9], 1)];
    let turned = expected.map(|([x, y, z], edge): ([i64; 3], i64)| {
        let [x, y, z] = [x - 4, y + 2, z + 6];
        ([x, -z - edge, y], edge)
    });
    assert_eq!(set(&found), BTreeSet::from(turned));
    let counts = "\"numInteriorNodes\":3,\"numMixedLeaves\":2,\"nodeCount\":7,\"leafDataCount\":4";
    let none = counts.replace(['2', '3', '4', '7'], "0");
    assert_eq!(read_octree(head.replace(counts, &none).as_bytes(), &[]).unwrap(), []);
    // A grid that is not anchored at the origin keeps its corner.
    let sources =
        |head: &str| [head.as_bytes(), &words].map(|bytes| Arc::new(MemorySource::new(bytes)) as Arc<dyn ByteSource>);
    let open = |head: &str| voxel::of_sources(sources(head), Path::new("t.voxel.json"), "t.voxel.bin".into()).unwrap();
    assert_eq!((open(&head).size(), open(&head).origin()), (0.1, [0.0; 3]));
    let reader = open(&head.replace("-0.4,0.2,0.6", "-0.43,0.2,0.6"));
    assert_eq!(reader.origin(), [-0.43, -0.6, 0.2]);
    let reader = open(&head.replace("-0.4,0.2,0.6", "-0.4000000059604645,0.2,0.6"));
    assert_eq!(reader.origin(), [0.0; 3]);
}

#[test]
fn damaged_octrees_are_refused_in_one_line() {
    let (head, words) = octree();
    assert!(damage(&words, |words| read_octree(head.as_bytes(), words)) > words.len());
    assert!(damage(head.as_bytes(), |head| read_octree(head, &words)) > head.len());
    // Each mixed block belongs to one node: one that no node names would be lost.
    let twice = [&words[..4 * 6], &0u32.to_le_bytes(), &words[4 * 7..]].concat();
    let text = read_octree(head.as_bytes(), &twice).unwrap_err().to_string();
    assert!(text.contains("node 6: it names the block of another node"), "{text}");
    let long = head.clone() + &" ".repeat(1 << 20);
    let text = read_octree(long.as_bytes(), &words).unwrap_err().to_string();
    assert!(text.contains("expected at most 1048576 bytes"), "{text}");
    let deep = head.replace("\"treeDepth\":2", "\"treeDepth\":25");
    let text = read_octree(deep.as_bytes(), &words).unwrap_err().to_string();
    assert!(text.contains("expected a treeDepth of at most 24, found 25"), "{text}");
    let swapped = head.replace("\"min\":[-0.4", "\"min\":[2.8");
    let text = read_octree(swapped.as_bytes(), &words).unwrap_err().to_string();
    assert!(text.contains("gridBounds has a max below its min"), "{text}");
    // Both children of one node name the same blocks again: read by every path, a small file would take for ever.
    let shared: Vec<u8> = [0x0300_0001u32, 0x0300_0003, 0x0300_0003, 0xFF00_0000, 0xFF00_0000]
        .iter()
        .flat_map(|word| word.to_le_bytes())
        .collect();
    let head = head.replace(
        "\"numMixedLeaves\":2,\"nodeCount\":7,\"leafDataCount\":4",
        "\"numMixedLeaves\":0,\"nodeCount\":5,\"leafDataCount\":0",
    );
    let text = read_octree(head.as_bytes(), &shared).unwrap_err().to_string();
    assert!(text.contains("earlier node"), "{text}");
    let old = head.replace("\"1.1\"", "\"1.0\"");
    let text = read_octree(old.as_bytes(), &shared).unwrap_err().to_string();
    assert!(text.contains("expected version 1.1"), "{text}");
}
