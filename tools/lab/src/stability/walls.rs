//! Walls of few points, thin walls, and where the pixel borders lie.

use super::lab::{Judged, Method, Scan, Setting, Vec3};
use super::patch::Field;
use super::planes::{NOISE_M, PIXEL_M, phase, shares};
use super::plot::{Line, Plot};
use super::table::{Share, Table, crossing, number, percent};
use super::{Effort, Outcome, Result};
use crate::Random;

/// Width and height of the pawn (m).
const PAWN: [f64; 2] = [0.5, 1.8];

/// How a wall stops a body that stands in it.
#[derive(Debug, Clone, Copy, Default)]
struct Leak {
    hit: Share,
    obstacle: Share,
    /// Boxes with a point inside that are not hit: must be none.
    missed: u64,
}

/// Boxes of `size` (m) at random places across patch `number`, a wall.
fn leak(judged: &Judged, field: &Field, number: usize, points: &[Vec3], size: [f64; 2], tries: usize) -> Leak {
    let patch = &field.patches[number];
    let mut random = Random(4242 + number as u64);
    let mut leak = Leak::default();
    let (s, c) = patch.heading_deg.to_radians().sin_cos();
    // A wall's width lies across its heading.
    let [high, wide] = patch.size.map(|pixels| pixels * PIXEL_M / 2.0);
    for _ in 0..tries {
        let room = (wide - size[0]).max(0.0);
        let (along, off) = (random.between(-room, room), random.between(-0.4, 0.4) * size[0]);
        let x = patch.middle[0] - s * along + c * off;
        let y = patch.middle[1] + c * along + s * off;
        let z = patch.middle[2] + random.between(-high, high - size[1]);
        let min = [x - size[0] / 2.0, y - size[0] / 2.0, z];
        let max = [x + size[0] / 2.0, y + size[0] / 2.0, z + size[1]];
        let (hit, obstacle) = judged.touches(min, max);
        leak.hit.add(hit);
        leak.obstacle.add(obstacle);
        if !hit {
            let inside = |p: &Vec3| (0..3).all(|a| min[a] <= p[a] && p[a] <= max[a]);
            leak.missed += points.iter().filter(|p| inside(p)).count() as u64;
        }
    }
    leak
}

/// Floors and walls of 0.1 to 100 points per pixel: their classes, and the bodies that leak through.
pub fn density(effort: Effort) -> Result<Outcome> {
    let densities: &[f64] = effort.of(&[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0], &[0.1, 1.0, 10.0]);
    let headings = [0.0, 20.0, 45.0];
    let copies = effort.of(6, 2);
    let tries = effort.of(200, 50);
    let mut csv = Table::new([
        "points_per_pixel",
        "method",
        "floor_called_obstacle",
        "wall_called_obstacle",
        "pawn_stopped_by_matter",
        "pawn_stopped_by_obstacle",
        "cube_10cm_stopped_by_matter",
        "cube_10cm_stopped_by_obstacle",
        "boxes_with_a_point_not_hit",
    ]);
    let mut page = Table::new([
        "points per pixel",
        "method",
        "floor called obstacle",
        "wall called obstacle",
        "pawn stopped: solid / obstacle",
        "cube of 10 cm stopped: solid / obstacle",
    ]);
    let mut walls = vec![Vec::new(); Method::ALL.len()];
    let mut stops = vec![Vec::new(); Method::ALL.len()];
    let mut missed = 0;
    for &density in densities {
        let mut random = Random(9000 + (density * 10.0) as u64);
        let mut field = Field::new(copies * 2 * headings.len());
        for slope in [0.0, 90.0] {
            for heading in headings {
                for _ in 0..copies {
                    field.add(PIXEL_M, slope, heading, 24.0, phase(&mut random));
                }
            }
        }
        let scan = Scan::new(field.points(density, NOISE_M, &mut random))?;
        let half = copies * headings.len();
        for method in Method::ALL {
            let judged = scan.judge(Setting::new(PIXEL_M), method)?;
            let shares = shares(&field, &judged)?;
            let mut sums = [Share::default(); 2];
            shares.iter().enumerate().for_each(|(n, &share)| sums[n / half].merge(share));
            let mut bodies = [Leak::default(); 2];
            for (body, size) in bodies.iter_mut().zip([PAWN, [0.1, 0.1]]) {
                for number in half..2 * half {
                    let own = leak(&judged, &field, number, &scan.points, size, tries);
                    body.hit.merge(own.hit);
                    body.obstacle.merge(own.obstacle);
                    body.missed += own.missed;
                }
            }
            // The rule as written begins its slices at the lowest point and is not held to our promise.
            missed += if method == Method::Written { 0 } else { bodies[0].missed + bodies[1].missed };
            let [floor, wall] = sums.map(|share| share.value());
            let stopped = [bodies[0].hit, bodies[0].obstacle, bodies[1].hit, bodies[1].obstacle].map(|s| s.value());
            let cells = [floor, wall].into_iter().chain(stopped).map(|v| number(v, 4));
            let last = [(bodies[0].missed + bodies[1].missed).to_string()];
            csv.row([number(density, 1), method.name().into()].into_iter().chain(cells).chain(last));
            walls[method as usize].push((density, wall));
            stops[method as usize].push((density, stopped[3]));
            if [0.2, 0.5, 1.0, 2.0, 10.0, 100.0].contains(&density) && method != Method::OrderFree {
                let pair = |n: usize| format!("{} / {}", percent(stopped[n]), percent(stopped[n + 1]));
                let cells = [percent(floor), percent(wall), pair(0), pair(2)];
                page.row([number(density, 1), method.name().into()].into_iter().chain(cells));
            }
        }
    }
    let mut outcome = Outcome { tables: vec![("density", csv)], ..Outcome::default() };
    outcome.fact("density", page.markdown());
    outcome.fact("density-missed", missed.to_string());
    for method in Method::ALL {
        let reached = crossing(&walls[method as usize], 0.9);
        let text = reached.map_or("never".to_owned(), |v| number(v, 1));
        outcome.fact(format!("density-breakdown-{}", method as usize), text);
    }
    let lines = |of: &[Vec<(f64, f64)>]| Method::ALL.map(|m| Line::of(m, of[m as usize].clone())).to_vec();
    for (name, title, y, of) in [
        ("density", "Voxels of a single sheet of wall called obstacle: 5 cm pixels", "share of wall voxels", &walls),
        (
            "density-cube",
            "Cubes of 10 cm in a wall that touch an obstacle voxel: 5 cm pixels",
            "share of cubes",
            &stops,
        ),
    ] {
        outcome.plots.push(Plot {
            name,
            title: title.into(),
            x: "points per pixel (t × t) of the wall",
            y,
            log_x: true,
            y_range: (0.0, 1.0),
            marks: vec![],
            lines: lines(of),
        });
    }
    Ok(outcome)
}

/// A wall and a floor at 16 places within a pixel, along x and along y.
pub fn phase_xy(effort: Effort) -> Result<Outcome> {
    let (phases, copies) = (16, effort.of(4, 1));
    let mut random = Random(61);
    let mut field = Field::new(4 * phases * copies);
    // Wall across x, shifted in x; wall across y, shifted in y; a slope of 40° shifted in x, one of 50°.
    let kinds = [(90.0, 0.0, 0), (90.0, 90.0, 1), (40.0, 0.0, 0), (50.0, 0.0, 0)];
    for (slope, heading, axis) in kinds {
        for phase in 0..phases {
            for _ in 0..copies {
                let mut shift = [0.5, 0.5, random.between(0.0, 1.0)];
                shift[axis] = phase as f64 / phases as f64;
                field.add(PIXEL_M, slope, heading, 24.0, shift);
            }
        }
    }
    let scan = Scan::new(field.points(4.0, NOISE_M, &mut random))?;
    let head =
        ["phase_of_pixel", "method", "wall_across_x_wrong", "wall_across_y_wrong", "slope40_wrong", "slope50_wrong"];
    let mut csv = Table::new(head);
    let mut page = Table::new([
        "method",
        "wall across x called floor",
        "wall across y",
        "40° called obstacle",
        "50° called floor",
    ]);
    for method in Method::ALL {
        let shares = shares(&field, &scan.judge(Setting::new(PIXEL_M), method)?)?;
        let mut worst = [0.0f64; 4];
        for phase in 0..phases {
            let wrong = [0, 1, 2, 3].map(|kind| {
                let mut sum = Share::default();
                let first = (kind * phases + phase) * copies;
                shares[first..first + copies].iter().for_each(|&share| sum.merge(share));
                if kinds[kind].0 > 45.0 { 1.0 - sum.value() } else { sum.value() }
            });
            worst.iter_mut().zip(wrong).for_each(|(worst, wrong)| *worst = worst.max(wrong));
            let first = [number(phase as f64 / phases as f64, 4), method.name().into()];
            csv.row(first.into_iter().chain(wrong.map(|v| number(v, 4))));
        }
        page.row([method.name().to_owned()].into_iter().chain(worst.map(percent)));
    }
    let mut outcome = Outcome { tables: vec![("phase-xy", csv)], ..Outcome::default() };
    outcome.fact("phase-xy", page.markdown());
    Ok(outcome)
}
