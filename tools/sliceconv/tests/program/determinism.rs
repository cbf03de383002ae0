//! Equal points give equal bytes (guarantee G4), whatever their order, files, number of threads and memory.

use crate::scans;

use scans::{Random, data, points, text, verifies, write, write_as};
use std::fs;
use std::path::{Path, PathBuf};

/// The archive of `inputs`.
fn archive(folder: &Path, inputs: &[PathBuf], arguments: &[&str]) -> Vec<u8> {
    let output = folder.join("out.slices");
    let inputs: Vec<&str> = inputs.iter().map(text).collect();
    let fixed = ["-o", text(&output), "--force", "--quiet", "--temp-dir", text(folder)];
    scans::converts(folder, &[&inputs, &fixed[..], arguments].concat());
    fs::read(&output).unwrap()
}

const FINE: [&str; 4] = ["--pixel", "0.1", "--units", "m"];

#[test]
fn order_files_formats_duplicates_scales_and_offsets_do_not_show() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut all = points(60_000);
    write(&at("a.las"), &all);
    for (rule, slice) in [("plane", "0.3"), ("plane", "0.01"), ("span", "0.3"), ("thesis", "0.3")] {
        let options = [&FINE[..], &["--classifier", rule, "--slice", slice]].concat();
        let expected = archive(folder.path(), &[at("a.las")], &options);
        let same = |inputs: &[&str], what: &str| {
            let inputs: Vec<PathBuf> = inputs.iter().map(|name| at(name)).collect();
            assert!(archive(folder.path(), &inputs, &options) == expected, "{rule}: {what}");
        };
        Random(9).shuffle(&mut all);
        write(&at("b.las"), &all);
        same(&["b.las"], "shuffled");
        write(&at("c.laz"), &all);
        same(&["c.laz"], "LAZ");
        write(&at("p.laz"), &all[..7]);
        write(&at("q.las"), &all[7..31_000]);
        write(&at("r.laz"), &all[31_000..]);
        same(&["p.laz", "q.las", "r.laz"], "three files");
        same(&["r.laz", "q.las", "p.laz", "q.las"], "three files in another order, one of them twice");
        // A quarter of a millimetre is finer than 32 bits reach from an offset of 0, but not from a near one; both
        // steps are powers of two, so every coordinate is the same number in both.
        let coarse: Vec<[f64; 3]> = all.iter().map(|p| p.map(|v| (v * 512.0).round() / 512.0)).collect();
        write_as(&at("s.las"), &coarse, 1.0 / 512.0, [0.0; 3]);
        write_as(&at("t.laz"), &coarse[..20_000], 1.0 / 1024.0, [4096.0, -8192.0, 64.0]);
        write_as(&at("u.las"), &coarse[20_000..], 1.0 / 2048.0, [-1.5, 300.25, -7.0]);
        let one = archive(folder.path(), &[at("s.las")], &options);
        assert!(archive(folder.path(), &[at("t.laz"), at("u.las")], &options) == one, "{rule}: scales and offsets");
    }
    verifies(&at("out.slices"));
}

#[test]
fn the_same_points_at_four_steps_and_offsets_spacing_included() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let all = points(40_000);
    write(&at("a.las"), &all);
    let expected = archive(folder.path(), &[at("a.las")], &["--units", "m"]);
    let mut shuffled = all.clone();
    Random(2).shuffle(&mut shuffled);
    write(&at("b.laz"), &shuffled[..15_000]);
    write(&at("c.las"), &shuffled[15_000..]);
    for threads in ["1", "2", "4"] {
        let found = archive(folder.path(), &[at("c.las"), at("b.laz")], &["--units", "m", "--threads", threads]);
        assert!(found == expected, "{threads} threads");
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn threads_and_memory_do_not_show_even_where_points_go_to_disk_and_columns_are_cut() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Enough to spill at 64 MiB, and a single column of tiles that no worker can hold at once with that budget.
    let mut random = Random(3);
    let mut all: Vec<[f64; 3]> = (0..5_000_000)
        .map(|number| {
            let size = if number < 600_000 { [6.0, 6.0, 60.0] } else { [300.0, 300.0, 0.2] };
            size.map(|size| (random.uniform() * size * 1000.0).round() / 1000.0 + 0.15)
        })
        .collect();
    random.shuffle(&mut all);
    write(&at("a.las"), &all);
    drop(all);
    let expected =
        archive(folder.path(), &[at("a.las")], &[&FINE[..], &["--memory", "2GiB", "--threads", "1"]].concat());
    verifies(&at("out.slices"));
    // In strips of rows, and by 16 threads in smaller areas.
    for (memory, threads) in [("64MiB", "1"), ("64MiB", "4"), ("64MiB", "16"), ("2GiB", "2")] {
        let options = [&FINE[..], &["--memory", memory, "--threads", threads]].concat();
        assert!(archive(folder.path(), &[at("a.las")], &options) == expected, "{memory}, {threads} threads");
    }
}

#[test]
fn real_scans_are_the_same_with_one_thread_in_little_memory_and_two_in_much() {
    let Some(data) = data::folder() else { return };
    let folder = tempfile::tempdir().unwrap();
    for name in ["indoor_two_storey_zup.laz", "delft_city_block_ahn3.laz"] {
        for pixel in ["auto", "0.2"] {
            let options = |memory, threads| ["--pixel", pixel, "--memory", memory, "--threads", threads];
            let input = [data.join(name)];
            let expected = archive(folder.path(), &input, &options("64MiB", "1"));
            let found = archive(folder.path(), &input, &options("1GiB", "2"));
            assert!(found == expected, "{name}: --pixel {pixel}");
        }
    }
}
