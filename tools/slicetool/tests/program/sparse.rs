//! Sparse floors: what `--fill-holes` adds lets a pawn reach more, never less.

use crate::house::{Random, slicetool};
use scangen::{WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, HoleWidth, PixelSize, convert};
use std::collections::HashSet;
use std::fs;
use tempfile::TempDir;

/// Points at random on a floor of 9 × 9 m that rises slightly, with holes of all widths up to 1.5 m.
fn floor(random: &mut Random, count: usize) -> Vec<[f64; 3]> {
    let mut number = || random.below(1 << 20) as f64 / f64::from(1 << 20);
    let holes: Vec<[f64; 3]> = (0..8).map(|_| [9.0 * number(), 9.0 * number(), 0.1 + 0.65 * number()]).collect();
    (0..count)
        .map(|_| {
            let [x, y] = [9.0 * number(), 9.0 * number()];
            [x, y, 0.02 * x + 0.01 * number()]
        })
        .filter(|[x, y, _]| holes.iter().all(|hole| (x - hole[0]).hypot(y - hole[1]) > hole[2]))
        .chain((0..40 * 40).map(|n| [0.1 + f64::from(n % 40) * 0.02, 0.1 + f64::from(n / 40) * 0.02, 0.005]))
        .collect()
}

/// Pixels with a standing place that a pawn reaches from the densely scanned corner.
fn reached(folder: &TempDir) -> HashSet<[i64; 2]> {
    let options = ["a.slices", "--from", "0.5,0.5,0.1", "--pawn", "cylinder:0.15x1.6", "-o", "r.csv"];
    let out = slicetool(folder, "reach", &options);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let table = fs::read_to_string(folder.path().join("r.csv")).unwrap();
    let pixel = |field: &str| (field.parse::<f64>().unwrap() * 10.0).floor() as i64;
    let place = |line: &str| {
        let mut fields = line.split(',').map(pixel);
        [fields.next().unwrap(), fields.next().unwrap()]
    };
    table.lines().skip(1).map(place).collect()
}

#[test]
fn a_larger_width_of_holes_never_reaches_less() {
    for (seed, count) in [(1, 1500), (2, 3000), (3, 6000)] {
        let folder = tempfile::tempdir().unwrap();
        let scan = folder.path().join("scan.las");
        write_las(&scan, floor(&mut Random(seed), count), &WriteSpec::for_path(&scan)).unwrap();
        let mut options = ConvertOptions::new(vec![scan], folder.path().join("a.slices"));
        (options.grid.pixel, options.overwrite) = (PixelSize::Metres(0.1), true);
        let mut areas = Vec::new();
        let mut before = HashSet::new();
        for width in [0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.3, 2.0] {
            options.grid.fill_holes = (width > 0.0).then_some(HoleWidth::Metres(width));
            convert(&options, &NoMonitor).unwrap();
            let found = reached(&folder);
            let lost = before.difference(&found).count();
            assert_eq!(lost, 0, "{count} points, {width} m: {} of {} places are lost", lost, before.len());
            areas.push(found.len());
            before = found;
        }
        assert!(areas[7] > areas[0], "{areas:?}");
        options.grid.fill_holes = Some(HoleWidth::Auto);
        convert(&options, &NoMonitor).unwrap();
        let of_gaps = reached(&folder).len();
        println!("{count} points: {areas:?} places, {of_gaps} with gaps between points closed");
        assert!((areas[0]..=areas[7]).contains(&of_gaps), "{of_gaps} {areas:?}");
    }
}
