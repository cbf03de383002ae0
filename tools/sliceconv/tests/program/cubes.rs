//! Solid cubes of OctoMap trees and voxel octrees: every place in a cube is solid (G1), nothing farther than a pixel and a
//! slice is (G2), the same cubes in any format make the same bytes (G4), and hostile files get one line.

use crate::scans;

use scans::{Random, converts, refuses, verifies};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Lowest corner and edge, in cubes of the finest level.
type Leaf = ([i64; 3], i64);

/// Leaves of several sizes around the origin, none of which overlap.
fn leaves(count: usize) -> BTreeSet<Leaf> {
    let mut random = Random(11);
    let mut taken = BTreeSet::new();
    let mut leaves = BTreeSet::new();
    while leaves.len() < count {
        let edge = 1i64 << random.below(4);
        let corner = [0; 3].map(|_: i64| (random.below(80) as i64 - 40).div_euclid(edge) * edge);
        let cells = || {
            let within = move |axis: usize| corner[axis]..corner[axis] + edge;
            within(0).flat_map(move |x| within(1).flat_map(move |y| within(2).map(move |z| [x, y, z])))
        };
        if cells().all(|cell| !taken.contains(&cell)) {
            taken.extend(cells());
            leaves.insert((corner, edge));
        }
    }
    leaves
}

/// Appends the node of a cube in the format of OctoMap, without what its parent knows, and counts nodes.
fn octomap(leaves: &BTreeSet<Leaf>, corner: [i64; 3], edge: i64, out: &mut Vec<u8>, nodes: &mut u64) -> u16 {
    if leaves.contains(&(corner, edge)) {
        return 2;
    }
    let is_within = |(at, _): &Leaf| (0..3).all(|axis| (corner[axis]..corner[axis] + edge).contains(&at[axis]));
    let own: BTreeSet<Leaf> = leaves.iter().copied().filter(is_within).collect();
    if own.is_empty() {
        return 0;
    }
    let start = out.len();
    out.extend([0, 0]);
    let mut bits = 0u16;
    for child in 0..8 {
        let half = edge / 2;
        let corner = [0, 1, 2].map(|axis| corner[axis] + half * (child >> axis & 1));
        let own = octomap(&own, corner, half, out, nodes);
        *nodes += u64::from(own != 0);
        bits |= own << (2 * child);
    }
    out[start..start + 2].copy_from_slice(&bits.to_le_bytes());
    3
}

fn write_tree(path: &Path, leaves: &BTreeSet<Leaf>, size: f64) {
    let (mut data, mut nodes) = (Vec::new(), 1);
    octomap(leaves, [-(1 << 15); 3], 1 << 16, &mut data, &mut nodes);
    let mut bytes = format!("# Octomap OcTree binary file\nid OcTree\nsize {nodes}\nres {size}\ndata\n").into_bytes();
    bytes.extend(data);
    fs::write(path, bytes).unwrap();
}

/// Writes the same cubes as one level of mixed blocks under one chain of nodes: y-up, (x, y, z) becomes (x, z, -y).
fn write_octree(folder: &Path, leaves: &BTreeSet<Leaf>, size: f64) {
    let mut blocks = std::collections::BTreeMap::<[i64; 3], u64>::new();
    for (corner, edge) in leaves {
        for (x, y, z) in (0..*edge).flat_map(|x| (0..*edge).flat_map(move |y| (0..*edge).map(move |z| (x, y, z)))) {
            let at = [corner[0] + x + 64, corner[2] + z + 64, -(corner[1] + y) - 1 + 64];
            let bit = at[0] % 4 + 4 * (at[1] % 4) + 16 * (at[2] % 4);
            *blocks.entry(at.map(|v| v / 4)).or_default() |= 1 << bit;
        }
    }
    // Breadth first over a grid of 32 blocks: five levels below the root.
    let mut level: Vec<[i64; 3]> = vec![[0; 3]];
    let (mut words, mut mixed, mut inner) = (Vec::<u32>::new(), Vec::new(), 0);
    for depth in (0..=5).rev() {
        let first = (words.len() + level.len()) as u32;
        let mut next = Vec::new();
        for at in &level {
            if depth == 0 {
                words.push(mixed.len() as u32);
                mixed.push(blocks[at]);
                continue;
            }
            let (begin, mut mask) = (next.len() as u32, 0);
            for child in 0..8 {
                let below = [0, 1, 2].map(|axis| 2 * at[axis] + (child >> axis & 1));
                if blocks.keys().any(|block| (0..3).all(|axis| block[axis] >> (depth - 1) == below[axis])) {
                    (mask, inner) = (mask | 1 << child, inner + u32::from(mask == 0));
                    next.push(below);
                }
            }
            words.push(mask << 24 | (first + begin));
        }
        level = next;
    }
    let [min, max] = [-64.0, 64.0].map(|end| [end * size; 3]);
    let head = serde_json::json!({
        "version": "1.1", "gridBounds": { "min": min, "max": max },
        "sceneBounds": { "min": [0, 0, 0], "max": [0, 0, 0] }, "voxelResolution": size, "leafSize": 4, "treeDepth": 5,
        "numInteriorNodes": inner, "numMixedLeaves": mixed.len(), "nodeCount": words.len(),
        "leafDataCount": 2 * mixed.len(),
    });
    // The byte order mark of editors on Windows does not belong to the text.
    fs::write(folder.join("a.voxel.json"), format!("\u{feff}{head}")).unwrap();
    let bytes =
        words.iter().flat_map(|word| word.to_le_bytes()).chain(mixed.iter().flat_map(|bits| bits.to_le_bytes()));
    fs::write(folder.join("a.voxel.bin"), bytes.collect::<Vec<u8>>()).unwrap();
}

fn archive(folder: &Path, input: &str, arguments: &[&str]) -> Vec<u8> {
    converts(folder, &[&[input, "-o", "out.slices", "--force", "--quiet"], arguments].concat());
    fs::read(folder.join("out.slices")).unwrap()
}

#[test]
fn both_formats_make_the_same_bytes_whatever_threads_and_memory() {
    let folder = tempfile::tempdir().unwrap();
    let (at, leaves) = (folder.path(), leaves(400));
    write_tree(&at.join("a.bt"), &leaves, 0.05);
    write_octree(at, &leaves, 0.05);
    let expected = archive(at, "a.bt", &["--threads", "1"]);
    verifies(&at.join("out.slices"));
    let cubes: i64 = leaves.iter().map(|(_, edge)| edge.pow(3)).sum();
    let header = Archive::open(at.join("out.slices")).unwrap().header().clone();
    assert_eq!((header.plan.frame.pixel_m(), header.plan.frame.slice_m()), (0.05, 0.05));
    assert_eq!((header.voxels.occupied, header.voxels.obstacle), (cubes as u64, 0), "a cube is a voxel");
    assert_eq!((header.points_read, header.points_kept), (400, 400));
    for arguments in [&["--threads", "3", "--memory", "64MiB"][..], &["--threads", "2"]] {
        assert!(archive(at, "a.bt", arguments) == expected, "{arguments:?}");
    }
    fs::hard_link(at.join("a.bt"), at.join("b.bt")).unwrap();
    let twice = ["a.bt", "./a.bt", "b.bt", "-o", "twice.slices"];
    let said = converts(at, &twice);
    assert!(said.matches("it is read once").count() == 2, "{said}");
    assert!(fs::read(at.join("twice.slices")).unwrap() == expected, "the same file under three names");
    // Counts of cubes differ, what is solid does not: all of the file but its metadata.
    archive(at, "a.voxel.json", &[]);
    let pages = |name: &str| {
        let archive = Archive::open(at.join(name)).unwrap();
        let entries: Vec<_> = archive.entries().map(Result::unwrap).collect();
        entries.iter().map(|entry| (entry.key, format!("{:?}", archive.page(entry).unwrap()))).collect::<Vec<_>>()
    };
    fs::rename(at.join("out.slices"), at.join("octree.slices")).unwrap();
    archive(at, "a.bt", &[]);
    assert!(pages("octree.slices") == pages("out.slices"));
}

#[test]
fn every_place_in_a_cube_is_solid_and_nothing_farther_than_a_pixel_and_a_slice() {
    let folder = tempfile::tempdir().unwrap();
    let (at, leaves) = (folder.path(), leaves(150));
    write_tree(&at.join("a.bt"), &leaves, 0.05);
    for (pixel, slice) in [("0.05", "0.15"), ("0.07", "0.031"), ("0.02", "0.05"), ("0.3", "0.9")] {
        archive(at, "a.bt", &["--pixel", pixel, "--slice", slice]);
        let store = Snapshot::resident(&Archive::open(at.join("out.slices")).unwrap(), &NoMonitor).unwrap();
        let hits = |min: [f64; 3], max: [f64; 3]| {
            overlaps(&store, &Aabb::new(min.into(), max.into()).unwrap()) != Overlap::Clear
        };
        let mut random = Random(5);
        for (corner, edge) in &leaves {
            for _ in 0..20 {
                let place = [0, 1, 2].map(|axis| (corner[axis] as f64 + *edge as f64 * random.uniform()) * 0.05);
                assert!(hits(place, place), "{pixel} {slice} {place:?}");
            }
            // Beside the face, which rounding may put on either side.
            let corner = corner.map(|v| v as f64 * 0.05 + 1e-12);
            assert!(hits(corner, corner));
        }
        let grown = [pixel, pixel, slice].map(|text| text.parse::<f64>().unwrap() + 1e-9);
        let (mut clear, mut tried) = (0, 0);
        for _ in 0..30_000 {
            let place = [0; 3].map(|_: i32| random.uniform() * 5.0 - 2.5);
            let is_far = leaves.iter().all(|(corner, edge)| {
                (0..3).any(|axis| {
                    let (low, high) = (corner[axis] as f64 * 0.05, (corner[axis] + edge) as f64 * 0.05);
                    place[axis] < low - grown[axis] || place[axis] > high + grown[axis]
                })
            });
            tried += usize::from(is_far);
            clear += usize::from(is_far && !hits(place, place));
        }
        assert!(tried == clear && tried > 1000, "{pixel} {slice}: {clear} of {tried}");
    }
}

#[test]
fn a_damaged_file_of_cubes_is_left_out_beside_others_if_incomplete_input_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_tree(&at.join("a.bt"), &leaves(40), 0.05);
    let expected = archive(at, "a.bt", &[]);
    write_tree(&at.join("cut.bt"), &leaves(400), 0.05);
    let bytes = fs::read(at.join("cut.bt")).unwrap();
    fs::write(at.join("cut.bt"), &bytes[..bytes.len() * 2 / 3]).unwrap();
    let both = ["a.bt", "cut.bt", "-o", "out.slices", "--force"];
    assert!(refuses(at, &both, 1).contains("cut.bt"));
    let said = converts(at, &[&both[..], &["--allow-incomplete"]].concat());
    assert!(said.contains("warning: incomplete: left out: cut.bt: "), "{said}");
    assert!(fs::read(at.join("out.slices")).unwrap() == expected);
    refuses(at, &["cut.bt", "-o", "out.slices", "--force", "--allow-incomplete"], 1);
    assert!(fs::read(at.join("out.slices")).unwrap() == expected);
}

#[test]
fn cubes_come_with_scans_units_and_a_preview() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_tree(&at.join("a.bt"), &BTreeSet::from([([0, 0, 0], 1), ([2, 4, 8], 2)]), 0.1);
    let run = |arguments: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_sliceconv")).current_dir(at).args(arguments).output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        serde_json::from_slice::<serde_json::Value>(&out.stdout).unwrap_or_default()
    };
    let facts = run(&["a.bt", "-o", "out.slices", "--json"]);
    assert_eq!(
        (&facts["cubes_read"], &facts["pixel_size"], &facts["slice_height"]),
        (&2.into(), &0.1.into(), &0.1.into())
    );
    let facts = run(&["a.bt", "--dry-run", "--json", "--units", "ft"]);
    assert!((facts["pixel_size"].as_f64().unwrap() - 0.03048).abs() < 1e-12, "{facts}");
    let facts = run(&["a.bt", "-o", "out.slices", "--force", "--json", "--up", "y"]);
    let end =
        |key: &str| facts["bounds"][key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>();
    let near = |found: Vec<f64>, expected: [f64; 3]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12);
    assert!(near(end("min"), [0.0, -1.0, 0.0]) && near(end("max"), [0.4, 0.0, 0.6]), "{facts}");
    // The finest cubes decide, and cubes beside the grid grow.
    write_tree(&at.join("b.bt"), &BTreeSet::from([([8, 8, 8], 1)]), 0.05);
    for inputs in [["a.bt", "b.bt"], ["b.bt", "a.bt"]] {
        let facts = run(&[&inputs[..], &["--dry-run", "--json"]].concat());
        assert_eq!(facts["pixel_size"], 0.05);
    }
    write_octree(at, &BTreeSet::from([([0, 0, 0], 1)]), 0.1);
    let head = fs::read_to_string(at.join("a.voxel.json")).unwrap();
    let mut head: serde_json::Value = serde_json::from_str(head.trim_start_matches('\u{feff}')).unwrap();
    let warned = |said: String| said.contains("a.voxel.json: its cubes do not lie on a grid from the origin");
    let octree = ["a.voxel.json", "-o", "out.slices", "--force"];
    assert!(!warned(converts(at, &octree)));
    head["gridBounds"]["min"][0] = (-6.43).into();
    fs::write(at.join("a.voxel.json"), head.to_string()).unwrap();
    assert!(warned(converts(at, &octree)));
    for (end, place) in [("min", 1e11), ("max", 1e11 + 100.0)] {
        head["gridBounds"][end][0] = place.into();
    }
    fs::write(at.join("a.voxel.json"), head.to_string()).unwrap();
    let line = refuses(at, &octree, 1);
    assert!(line.contains("a grid of this pixel size reaches"), "{line}");
    // A tree without a cube makes an empty archive.
    fs::write(at.join("none.bt"), "# Octomap OcTree binary file\nid OcTree\nsize 0\nres 0.1\ndata\n").unwrap();
    let said = converts(at, &["none.bt", "-o", "out.slices", "--force"]);
    assert!(said.contains("the archive is empty"), "{said}");
    // A scan decides the pixel size where there is one.
    let points: String =
        (0..400).map(|n| format!("{} {} 0\n", f64::from(n % 20) * 0.05, f64::from(n / 20) * 0.05)).collect();
    fs::write(at.join("s.xyz"), points).unwrap();
    let facts = run(&["a.bt", "s.xyz", "-o", "out.slices", "--force", "--json", "--units", "m"]);
    assert_eq!((&facts["points_read"], &facts["cubes_read"]), (&402.into(), &2.into()));
    assert!(facts["slice_height"].as_f64() > facts["pixel_size"].as_f64());
}

#[test]
fn hostile_cubes_get_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let leaves = leaves(60);
    write_tree(&at.join("a.bt"), &leaves, 0.05);
    write_octree(at, &leaves, 0.05);
    let (tree, words) = (fs::read(at.join("a.bt")).unwrap(), fs::read(at.join("a.voxel.bin")).unwrap());
    let refused = |input: &str, code: i32, said: &str| {
        let line = refuses(at, &[input, "-o", "out.slices"], code);
        assert!(line.contains(said) && !at.join("out.slices").exists(), "{input}: {line}");
    };
    fs::write(at.join("cut.bt"), &tree[..tree.len() - 3]).unwrap();
    refused("cut.bt", 1, "the file is cut");
    fs::write(at.join("more.bt"), [&tree[..], b"x"].concat()).unwrap();
    refused("more.bt", 1, "expected the end of the file");
    fs::write(at.join("other.bt"), "solid cubes").unwrap();
    refused("other.bt", 1, "expected \"# Octomap OcTree\"");
    fs::write(at.join("empty.bt"), "").unwrap();
    refused("empty.bt", 1, "empty.bt");
    // One leaf as large as an eighth of the world, in 60 bytes.
    fs::write(at.join("huge.bt"), b"# Octomap OcTree binary file\nid OcTree\nsize 2\nres 0.05\ndata\n\x02\0").unwrap();
    refused("huge.bt", 1, "voxels");
    fs::write(at.join("far.bt"), b"# Octomap OcTree binary file\nid OcTree\nsize 2\nres 1e300\ndata\n\x02\0").unwrap();
    refused("far.bt", 1, "pixel");
    refused("a.voxel.bin", 1, "name its .voxel.json");
    fs::write(at.join("a.voxel.bin"), &words[..words.len() - 1]).unwrap();
    refused("a.voxel.json", 1, "bytes");
    fs::remove_file(at.join("a.voxel.bin")).unwrap();
    refused("a.voxel.json", 1, "a.voxel.bin");
    for arguments in [&["--shard", "1/2", "--plan", "p.json"][..], &["--shard", "1/2"]] {
        let code = Command::new(env!("CARGO_BIN_EXE_sliceconv"))
            .current_dir(at)
            .args([&["a.bt", "-o", "out.slices"], arguments].concat())
            .output()
            .unwrap();
        assert!(!code.status.success());
    }
    refuses(at, &["a.bt", "--write-plan", "p.json"], 1);
    fs::write(at.join("s.xyz"), "0 0 0\n1 1 0\n").unwrap();
    converts(at, &["s.xyz", "--write-plan", "p.json", "--pixel", "0.1", "--units", "m"]);
    let said = refuses(at, &["a.bt", "--plan", "p.json", "-o", "out.slices"], 2);
    assert!(said.contains("--plan: a.bt: cubes are converted in one run"), "{said}");
    fs::write(at.join("m.txt"), "2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n").unwrap();
    for moved in [["--up", "x"], ["--up", "auto"], ["--transform", "m.txt"]] {
        let said = refuses(at, &[&["a.bt", "-o", "out.slices"][..], &moved].concat(), 2);
        assert!(said.contains("a.bt: its cubes lie on the grid of pixels and are not moved"), "{said}");
    }
}
