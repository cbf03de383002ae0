//! The goals of speed and size, and what one run finds: `goals.md`.
//!
//! The run also writes `size.md` and `cubes.md`, whose figures it takes.

mod conversions;

use crate::peers::cubes::{self, Kind, Ratio};
use crate::size::{self, Sizes};
use crate::stability::Result;
use crate::stability::table::{Table, number, spread};
use std::path::Path;

const HEAD: &str = include_str!("head.md");

/// Least ratio of a peer's time, and least median of all of them.
const PEER: f64 = 1.0;
const PEERS: f64 = 1.5;
/// parry3d's `Voxels`: its boxes along walks, which are near surfaces, and its rays.
const VOXELS: &str = "parry3d `Voxels`";
const VOXELS_BOXES: f64 = 12.0;
const VOXELS_RAYS: f64 = 5.0;
/// Bits of a cube, of those of G-PCC.
const GPCC: f64 = 1.15;
const SPAN_NS: f64 = 50.0;
/// Ratio of the times of converting and of decoding LAZ, for files of `LARGE` points and more, and for smaller ones.
const LARGE: u64 = 3_000_000;
const LAZ: f64 = 0.8;
const SMALL_LAZ: f64 = 1.2;
const SPARSE_US: f64 = 0.15;
const VOXEL_BYTES: f64 = 5.0;

enum Goal {
    AtLeast(f64),
    AtMost(f64),
}

/// Goals and what was found.
struct Goals {
    table: Table,
    reached: usize,
    count: usize,
}

impl Goals {
    /// Adds a row; `found`: median, least and greatest.
    fn add(&mut self, what: &str, goal: Goal, found: [f64; 3], case: &str) {
        let (sign, limit, reached) = match goal {
            Goal::AtLeast(limit) => ("≥", limit, found[0] >= limit),
            Goal::AtMost(limit) => ("≤", limit, found[0] <= limit),
        };
        let [median, least, most] = found.map(|value| number(value, if value < 20.0 { 2 } else { 0 }));
        let range = if least == most { String::new() } else { format!("{least}–{most}") };
        let mark = if reached { "yes" } else { "**no**" };
        self.table.row([what, &format!("{sign} {limit}"), &median, &range, case, mark]);
        self.count += 1;
        self.reached += usize::from(reached);
    }

    /// Times of peers, of Slicewalk's for the same questions.
    fn peers(&mut self, all: &[Ratio]) {
        let groups: [(&str, &[Kind]); 4] = [
            ("place", &[Kind::Points]),
            ("box", &[Kind::RandomBoxes, Kind::WalkBoxes, Kind::RaisedBoxes]),
            ("ray of 20 m", &[Kind::Rays]),
            ("sweep of 0.1 m", &[Kind::Sweeps]),
        ];
        for (what, kinds) in groups {
            let of: Vec<&Ratio> = all.iter().filter(|ratio| kinds.contains(&ratio.kind)).collect();
            let Some(hardest) = hardest(&of) else { continue };
            let below = of.iter().filter(|ratio| ratio.of_ours[0] < PEER).count();
            let case = format!("{}; {below} of {} rows below 1", hardest.case(), of.len());
            self.add(&format!("{what}: the fastest peer"), Goal::AtLeast(PEER), hardest.of_ours, &case);
            let medians: Vec<f64> = of.iter().map(|ratio| ratio.of_ours[0]).collect();
            self.add(&format!("{what}: median of all rows"), Goal::AtLeast(PEERS), spread(&medians), "");
        }
        let voxels = |kinds: &[Kind]| {
            all.iter().filter(|ratio| ratio.peer == VOXELS && kinds.contains(&ratio.kind)).collect::<Vec<_>>()
        };
        for (what, limit, kinds) in [
            ("box along a walk", VOXELS_BOXES, &[Kind::WalkBoxes, Kind::RaisedBoxes][..]),
            ("ray of 20 m", VOXELS_RAYS, &[Kind::Rays]),
        ] {
            let of = voxels(kinds);
            let Some(hardest) = hardest(&of) else { continue };
            let reached = of.iter().filter(|ratio| ratio.of_ours[0] >= limit).count();
            let case = format!("{}; {reached} of {} rows reach it", hardest.case(), of.len());
            self.add(&format!("{what}: {VOXELS}"), Goal::AtLeast(limit), hardest.of_ours, &case);
        }
    }

    fn sizes(&mut self, sizes: &Sizes) {
        for set in &sizes.cubes {
            let draco =
                set.draco_bits.map_or_else(String::new, |bits| format!(", Draco {} without flags", number(bits, 2)));
            let case = format!("G-PCC {}{draco}", number(set.gpcc_bits, 2));
            // Two digits, as the table has.
            let limit = (GPCC * set.gpcc_bits * 100.0).round() / 100.0;
            self.add(&format!("bits a cube: {}", set.name), Goal::AtMost(limit), [set.bits; 3], &case);
        }
        for scan in &sizes.decoding {
            let what = format!("decoding, ns a span: {}", scan.name);
            self.add(&what, Goal::AtMost(SPAN_NS), scan.span_ns, "");
        }
    }
}

/// The row with the least ratio.
fn hardest<'a>(of: &[&'a Ratio]) -> Option<&'a Ratio> {
    of.iter().copied().min_by(|a, b| a.of_ours[0].total_cmp(&b.of_ours[0]))
}

/// Measures, and writes `goals.md`, `size.md` and `cubes.md` into `out`.
pub fn run(out: &Path, quick: bool) -> Result<()> {
    let table = Table::new(["what", "goal", "median", "least and greatest", "", "reached"]);
    let mut goals = Goals { table, reached: 0, count: 0 };
    goals.sizes(&size::run(out, quick)?);
    let folder = tempfile::tempdir()?;
    let (conversions, laz) = conversions::beside_reading(folder.path(), quick)?;
    for scan in laz {
        let limit = if scan.points < LARGE { SMALL_LAZ } else { LAZ };
        let case = format!("{} points", scan.points);
        let what = format!("conversion of LAZ, of decoding alone: {}", scan.name);
        goals.add(&what, Goal::AtMost(limit), scan.of_decoding, &case);
    }
    for scan in conversions::sparse(folder.path(), quick)? {
        let voxels = format!("{} voxels", scan.voxels);
        goals.add(&format!("sparse scan, µs a voxel: {}", scan.name), Goal::AtMost(SPARSE_US), scan.us, &voxels);
        let what = format!("sparse scan, bytes of memory a voxel: {}", scan.name);
        goals.add(&what, Goal::AtMost(VOXEL_BYTES), [scan.bytes; 3], "");
    }
    goals.peers(&cubes::run(out, quick)?);
    let page = format!(
        "{HEAD}\n{}\n\n{} of {} are reached.\n\n## Conversions beside reading\n\n{}\n",
        goals.table.markdown(),
        goals.reached,
        goals.count,
        conversions.markdown()
    );
    println!("{page}");
    std::fs::write(out.join("goals.md"), page)?;
    Ok(())
}
