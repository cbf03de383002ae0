//! At which slope does a surface become an obstacle? Tilted planes of every slope, heading and density.

use super::lab::{Judged, Method, Scan, Setting};
use super::patch::Field;
use super::plot::{Line, Plot};
use super::table::{Share, Table, crossing, number, percent};
use super::{Effort, Outcome, Result};
use crate::Random;
use std::collections::BTreeMap;

/// Pixel size of the sweeps that have one (m).
pub const PIXEL_M: f64 = 0.05;
/// Noise of the sweeps that have one (m).
pub const NOISE_M: f64 = 0.002;
const LIMITS: [f64; 2] = [30.0, 45.0];

/// Per patch: the interior voxels, and of them the obstacles.
pub fn shares(field: &Field, judged: &Judged) -> Result<Vec<Share>> {
    let mut shares = vec![Share::default(); field.patches.len()];
    judged.voxels(|voxel| {
        if let Some(number) = field.at(voxel.pixel).filter(|&n| field.patches[n].is_interior(&voxel)) {
            shares[number].add(voxel.obstacle);
        }
    })?;
    Ok(shares)
}

/// Random shift of a patch: within a pixel, within a pixel, within a slice.
pub fn phase(random: &mut Random) -> [f64; 3] {
    [random.between(0.0, 1.0), random.between(0.0, 1.0), random.between(0.0, 1.0)]
}

/// Share of voxels called obstacle over slope, heading and density; the slopes at which it passes 10, 50 and 90 %.
pub fn limit_angle(effort: Effort) -> Result<Outcome> {
    // Steps of 2.5 degrees, of half a degree near the limits.
    let (step, near) = effort.of((2.5, 0.5), (10.0, 2.5));
    let all = (0..=(90.0 / step) as usize).map(|n| n as f64 * step);
    let fine =
        LIMITS.into_iter().flat_map(|limit| (0..=(8.0 / near) as usize).map(move |n| limit - 4.0 + n as f64 * near));
    let mut slopes: Vec<f64> = all.chain(fine).collect();
    slopes.sort_by(f64::total_cmp);
    slopes.dedup();
    let headings = effort.of(7, 3);
    let densities: &[f64] = effort.of(&[1.0, 2.0, 3.0, 4.0, 5.0, 10.0, 20.0, 40.0], &[1.0, 4.0, 10.0]);
    let mut csv = Table::new(["points_per_pixel", "limit_deg", "method", "slope_deg", "heading_deg", "obstacle_share"]);
    let mut thetas = Table::new([
        "points_per_pixel",
        "limit_deg",
        "method",
        "theta10",
        "theta50",
        "theta90",
        "least_theta50_of_headings",
        "greatest_theta50_of_headings",
    ]);
    let mut outcome = Outcome::default();
    let mut lines: BTreeMap<(u32, usize), Vec<(f64, f64)>> = BTreeMap::new();
    let mut pages = [Table::new(theta_head()), Table::new(theta_head())];
    for &density in densities {
        let mut random = Random(density.to_bits());
        let copies = if density < 10.0 { effort.of(3, 1) } else { 1 };
        let mut field = Field::new(slopes.len() * headings * copies);
        for &slope in &slopes {
            for heading in 0..headings {
                for _ in 0..copies {
                    let heading = heading as f64 * 90.0 / (headings - 1) as f64;
                    field.add(PIXEL_M, slope, heading, if density > 10.0 { 16.0 } else { 24.0 }, phase(&mut random));
                }
            }
        }
        let scan = Scan::new(field.points(density, NOISE_M, &mut random))?;
        let mut cells: BTreeMap<(usize, usize), [String; 2]> = BTreeMap::new();
        for (l, limit) in LIMITS.into_iter().enumerate() {
            for method in Method::ALL {
                // The thesis' rules know no limit.
                let fixed = matches!(method, Method::Written | Method::OrderFree);
                if fixed && limit != 45.0 {
                    continue;
                }
                let shares = shares(&field, &scan.judge(Setting::new(PIXEL_M).limit(limit), method)?)?;
                let mut by_heading = vec![Vec::new(); headings];
                let mut pooled = Vec::new();
                for (s, &slope) in slopes.iter().enumerate() {
                    let mut all = Share::default();
                    for (h, curve) in by_heading.iter_mut().enumerate() {
                        let first = (s * headings + h) * copies;
                        let mut share = Share::default();
                        shares[first..first + copies].iter().for_each(|&other| share.merge(other));
                        all.merge(share);
                        curve.push((slope, share.value()));
                        let heading = field.patches[first].heading_deg;
                        csv.row([
                            number(density, 0),
                            number(limit, 0),
                            method.name().into(),
                            number(slope, 1),
                            number(heading, 0),
                            number(share.value(), 4),
                        ]);
                    }
                    pooled.push((slope, all.value()));
                }
                let theta = |curve: &[(f64, f64)], level| crossing(curve, level);
                let text = |v: Option<f64>| v.map_or("never".into(), |v| number(v, 1));
                let [t10, t50, t90] = [0.1, 0.5, 0.9].map(|level| text(theta(&pooled, level)));
                let halves: Vec<f64> = by_heading.iter().filter_map(|curve| theta(curve, 0.5)).collect();
                let ends = [f64::INFINITY, f64::NEG_INFINITY];
                let [low, high] = halves.iter().fold(ends, |[a, b], &v| [a.min(v), b.max(v)]);
                let ends = if halves.is_empty() { [None; 2] } else { [Some(low), Some(high)] }.map(text);
                let row = [number(density, 0), number(limit, 0), method.name().into()];
                thetas.row(row.into_iter().chain([t10.clone(), t50.clone(), t90.clone()]).chain(ends.clone()));
                cells.insert((l, method as usize), [format!("{t10} / {t50} / {t90}"), ends.join(" to ")]);
                if density == 4.0 {
                    lines.insert((limit as u32, method as usize), pooled);
                }
            }
        }
        for (l, page) in pages.iter_mut().enumerate() {
            let cell = |method: Method, of: usize| {
                let own = cells.get(&(l, method as usize)).or_else(|| cells.get(&(1, method as usize)));
                own.map_or_else(String::new, |cell| cell[of].clone())
            };
            let all = Method::ALL.map(|method| cell(method, 0));
            let headings = [cell(Method::OrderFree, 1), cell(Method::Plane, 1)];
            page.row([number(density, 0)].into_iter().chain(all).chain(headings));
        }
    }
    for (limit, page) in LIMITS.into_iter().zip(&pages) {
        outcome.fact(format!("theta{limit}"), page.markdown());
    }
    for limit in [45u32, 30] {
        let mut drawn = Vec::new();
        for method in Method::ALL {
            let own = lines.get(&(limit, method as usize)).or_else(|| lines.get(&(45, method as usize)));
            drawn.push(Line::of(method, own.cloned().unwrap_or_default()));
        }
        outcome.plots.push(Plot {
            name: if limit == 45 { "limit-angle-45" } else { "limit-angle-30" },
            title: format!(
                "Share of a plane's voxels called obstacle: limit {limit}°, 4 points per pixel, all headings"
            ),
            x: "slope of the plane (degrees)",
            y: "share called obstacle",
            log_x: false,
            y_range: (0.0, 1.0),
            marks: vec![(f64::from(limit), format!("limit {limit}°"))],
            lines: drawn,
        });
    }
    outcome.tables = vec![("limit-angle", csv), ("theta", thetas)];
    Ok(outcome)
}

fn theta_head() -> [String; 7] {
    let of = |method: Method| format!("{}: θ10 / θ50 / θ90", method.name());
    let [a, b, c, d] = Method::ALL.map(of);
    ["points per pixel".into(), a, b, c, d, "order-free: θ50 by heading".into(), "plane: θ50 by heading".into()]
}

/// Measures whether slopes three degrees from the limit are classified correctly, for every heading, phase and pixel
/// size.
pub fn at_the_limit(effort: Effort) -> Result<Outcome> {
    const OFF: f64 = 3.0;
    let (headings, phases) = effort.of((24, 8), (6, 2));
    let mut outcome = Outcome::default();
    let head = [
        "pixel_m",
        "noise_m",
        "points_per_pixel_edge",
        "limit_deg",
        "slope_deg",
        "method",
        "voxels_right",
        "pixels_right",
        "worst_heading_pixels_right",
        "worst_patch_pixels_right",
    ];
    let mut csv = Table::new(head);
    let mut page = Table::new([
        "t (cm)",
        "noise (mm)",
        "limit",
        "slope",
        "span: pixels right",
        "plane: pixels right",
        "plane: worst heading",
        "plane: worst single patch",
    ]);
    let mut least: f64 = 1.0;
    for &pixel_m in effort.of(&[0.02, 0.05, 0.1][..], &[0.05][..]) {
        for &noise in effort.of(&[0.0, 0.001, 0.002][..], &[0.002][..]) {
            let mut random = Random(77 + (pixel_m * 1e3 + noise * 1e7) as u64);
            let mut field = Field::new(4 * headings * phases);
            for limit in LIMITS {
                for slope in [limit - OFF, limit + OFF] {
                    for heading in 0..headings {
                        for _ in 0..phases {
                            let heading = heading as f64 * 360.0 / headings as f64;
                            field.add(pixel_m, slope, heading, 24.0, phase(&mut random));
                        }
                    }
                }
            }
            let scan = Scan::new(field.points(4.0, noise, &mut random))?;
            let per_slope = headings * phases;
            for (l, limit) in LIMITS.into_iter().enumerate() {
                let mut cells = Vec::new();
                for method in [Method::Span, Method::Plane] {
                    let judged = scan.judge(Setting::new(pixel_m).limit(limit), method)?;
                    let patches = (2 * l * per_slope)..(2 * (l + 1) * per_slope);
                    let (voxels, pixels) = right(&field, &judged, patches.clone(), limit)?;
                    for (n, slope) in [limit - OFF, limit + OFF].into_iter().enumerate() {
                        let own = n * per_slope..(n + 1) * per_slope;
                        let sum = |shares: &[Share]| {
                            shares.iter().fold(Share::default(), |mut sum, &share| {
                                sum.merge(share);
                                sum
                            })
                        };
                        let heading =
                            |h: usize| sum(&pixels[own.start + h * phases..own.start + (h + 1) * phases]).value();
                        let all = sum(&pixels[own.clone()]).value();
                        let worst_heading = (0..headings).map(heading).fold(1.0, f64::min);
                        let worst = pixels[own.clone()].iter().map(Share::value).fold(1.0, f64::min);
                        csv.row([
                            number(pixel_m, 2),
                            number(noise, 3),
                            "2".into(),
                            number(limit, 0),
                            number(slope, 0),
                            method.name().into(),
                            number(sum(&voxels[own]).value(), 4),
                            number(all, 4),
                            number(worst_heading, 4),
                            number(worst, 4),
                        ]);
                        cells.push([all, worst_heading, worst]);
                    }
                }
                for (n, slope) in [limit - OFF, limit + OFF].into_iter().enumerate() {
                    let ([span, ..], [plane, heading, worst]) = (cells[n], cells[2 + n]);
                    least = least.min(heading);
                    page.row([
                        number(pixel_m * 100.0, 0),
                        number(noise * 1000.0, 0),
                        format!("{limit:.0}°"),
                        format!("{slope:.0}°"),
                        percent(span),
                        percent(plane),
                        percent(heading),
                        percent(worst),
                    ]);
                }
            }
        }
    }
    outcome.fact("at-the-limit", page.markdown());
    outcome.fact("at-the-limit-least", percent(least));
    outcome.tables.push(("verdicts-at-the-limit", csv));
    Ok(outcome)
}

/// Per patch of `patches`: voxels classified correctly, and pixels of which all voxels are.
fn right(
    field: &Field,
    judged: &Judged,
    patches: std::ops::Range<usize>,
    limit: f64,
) -> Result<(Vec<Share>, Vec<Share>)> {
    let mut voxels = vec![Share::default(); patches.len()];
    let mut by_pixel: BTreeMap<(usize, [i64; 2]), bool> = BTreeMap::new();
    judged.voxels(|voxel| {
        let Some(number) = field.at(voxel.pixel).filter(|n| patches.contains(n)) else { return };
        let patch = &field.patches[number];
        if patch.is_interior(&voxel) {
            let right = voxel.obstacle == (patch.slope_deg > limit);
            voxels[number - patches.start].add(right);
            *by_pixel.entry((number - patches.start, voxel.pixel)).or_insert(true) &= right;
        }
    })?;
    let mut pixels = vec![Share::default(); patches.len()];
    by_pixel.into_iter().for_each(|((number, _), right)| pixels[number].add(right));
    Ok((voxels, pixels))
}
