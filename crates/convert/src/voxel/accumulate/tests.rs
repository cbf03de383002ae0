use super::sums::KEPT_SUMS;
use super::*;
use crate::frame::Frame;
use crate::plan::Plan;
use crate::voxel::bands::Bands;
use crate::voxel::record::{Recorder, SLICE_STEPS, SUBPIXELS, surface_voxels};
use proptest::prelude::*;

fn records(points: &[(f64, f64, f64)]) -> Vec<Record> {
    let recorder = Recorder::new(Frame::new(0.5, 1.5).unwrap());
    let mut records = Vec::new();
    for &(x, y, z) in points {
        recorder.record(&[x], &[y], &[z], |index, record| {
            if (index.tx, index.ty) == (0, 0) {
                records.push(record);
            }
        });
    }
    records
}

proptest! {
    #[test]
    fn folding_in_pieces_and_in_any_order_is_folding_at_once(
        points in proptest::collection::vec((-1.0f64..33.0, -1.0f64..33.0, -4.0f64..4.0), 1..6000),
        surfaces in proptest::collection::vec((0i64..64, 0i64..64, -600i64..600, 0i64..300, any::<bool>()), 0..500),
        piece in 1usize..500, min_points in 1u32..3, slices in 1u32..7
    ) {
        let mut records = records(&points);
        let points_kept_at_most = records.len() as i64;
        let recorder = Recorder::new(Frame::new(0.5, 1.5).unwrap());
        for voxel in surfaces.iter().flat_map(|&(i, j, low, more, s)| surface_voxels((i, j), (low, low + more), s)) {
            recorder.record_surface(&voxel, |index, record| {
                if (index.tx, index.ty) == (0, 0) {
                    records.push(record);
                }
            });
        }
        let (mut at_once, mut piecemeal) = (Patch::default(), Patch::default());
        let thin = Plan::new(Frame::new(0.5, 1.5 / f64::from(slices)).unwrap());
        let bands = Bands::new(&thin);
        assert_eq!(bands.slices(), slices);
        let (mut made, mut added) = (Sums::new(bands), Sums::default());
        let dropped = at_once.fold(&records[..], min_points, Area::TILE, &mut made);
        records.reverse();
        let (mut folded, mut scratch, mut folder) = (Folded::new(), Folded::new(), PieceFolder::new(bands));
        records.chunks(piece).for_each(|piece| folder.fold_into(&mut folded, &mut scratch, piece));
        prop_assert_eq!(piecemeal.set_folded(&folded, min_points, Area::TILE, &mut added), dropped);
        prop_assert_eq!(&at_once.voxels, &piecemeal.voxels);
        prop_assert_eq!(&at_once.starts, &piecemeal.starts);
        let mut points_kept = 0;
        for pixel in at_once.occupied() {
            for number in at_once.range(pixel) {
                let band = bands.of(at_once.voxels[number].slice) - made.lowest_band().unwrap();
                let [x, y] = [pixel % PATCH_PIXELS, pixel / PATCH_PIXELS].map(|at| at as i64);
                let mut about_the_patch = Moments::default();
                about_the_patch.add_shifted(added.of(&piecemeal, pixel, number), x, y, band.into());
                prop_assert_eq!(made.of(&at_once, pixel, number), &about_the_patch);
                points_kept += made.of(&at_once, pixel, number).n;
            }
        }
        prop_assert!(points_kept <= points_kept_at_most);
        prop_assert!(min_points > 1 || points_kept == points_kept_at_most);
        for &(i, j, low, more, steep) in &surfaces {
            let pixel = (j as usize + 1) * PATCH_PIXELS + i as usize + 1;
            let (first, last) = (low.div_euclid(255), low.max(low + more - 1).div_euclid(255));
            for voxel in (first..=last).map(|slice| slice + crate::voxel::record::BLOCK_SLICES / 2) {
                let found = at_once.voxels[at_once.range(pixel)].iter().find(|v| i64::from(v.slice) == voxel);
                prop_assert!(found.is_some_and(|v| v.kinds & Voxel::SURFACES != 0 && (v.is_steep() || !steep)));
            }
        }
    }

    #[test]
    fn shifted_sums_are_sums_of_shifted_points(
        points in proptest::collection::vec((0i64..128, 0i64..128, 0i64..8160), 0..50),
        (dx, dy, ds) in (0i64..3, 0i64..3, 0i64..3)
    ) {
        let (mut plain, mut shifted, mut direct) = <(Moments, Moments, Moments)>::default();
        for &(u, v, w) in &points {
            plain.add(u, v, w);
            direct.add(u + dx * SUBPIXELS, v + dy * SUBPIXELS, w + ds * SLICE_STEPS);
        }
        shifted.add_shifted(&plain, dx, dy, ds);
        prop_assert_eq!(shifted, direct);
    }
}

#[test]
fn slices_far_apart_in_one_pixel_are_told_apart() {
    let points: Vec<_> = (0..9000).map(|n| (0.2, 0.2, f64::from(n * 7919 % 4500) * 1.5 + 0.1)).collect();
    let mut patch = Patch::default();
    let mut sums = Sums::default();
    patch.fold(&records(&points)[..], 1, Area::TILE, &mut sums);
    assert_eq!(patch.voxels().len(), 4500);
    assert!(patch.voxels().is_sorted_by_key(|voxel| voxel.slice));
    let pixel = PATCH_PIXELS + 1;
    assert!(patch.range(pixel).all(|number| sums.of(&patch, pixel, number).n == 2));
}

#[test]
fn more_sums_than_are_kept_are_made_again() {
    let places = (0..64 * 64).flat_map(|p| (0..20).map(move |s| (p, s)));
    let points: Vec<_> = places
        .map(|(p, s)| (f64::from(p % 64) * 0.5 + 0.2, f64::from(p / 64) * 0.5 + 0.2, f64::from(s) * 1.5 + 0.1))
        .collect();
    assert!(points.len() > KEPT_SUMS, "the test would show nothing");
    let (mut patch, mut sums) = (Patch::default(), Sums::default());
    patch.fold(&records(&points)[..], 1, Area::TILE, &mut sums);
    for round in 0..2 {
        for pixel in patch.occupied() {
            for number in patch.range(pixel) {
                let alone = *sums.of(&patch, pixel, number);
                let x = (pixel % PATCH_PIXELS) as i64 * SUBPIXELS;
                assert_eq!((alone.n, alone.u), (1, x + 51), "round {round}, voxel {number}");
                assert!(sums.kept.len() <= KEPT_SUMS);
            }
        }
    }
}

#[test]
fn halves_cover_an_area_without_overlap_down_to_single_pixels() {
    let mut open = vec![Area::TILE];
    let mut seen = vec![false; 4096];
    while let Some(area) = open.pop() {
        match area.halves() {
            Some(halves) => open.extend(halves),
            None => {
                assert_eq!((area.x.1, area.y.1), (area.x.0 + 1, area.y.0 + 1));
                let pixel = (area.y.0 * 64 + area.x.0) as usize;
                assert!(!std::mem::replace(&mut seen[pixel], true));
            }
        }
    }
    assert!(seen.iter().all(|&seen| seen));
}
