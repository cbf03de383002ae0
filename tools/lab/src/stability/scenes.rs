//! Floors of whole scenes against their closed-form truth.

use super::lab::{Method, Scan, Setting};
use super::planes::NOISE_M;
use super::table::{Errors, Share, Table, number, percent};
use super::{Effort, Outcome, Result};
use crate::Random;
use scangen::sample::{Mode, Order};
use scangen::{Params, SampleSpec, Scene, Truth};

/// Steepest floor that is asked for (degrees): well below the limit of 45.
const STEEPEST_DEG: f64 = 40.0;
/// Points per squared pixel of surface, on a jittered grid: no pixel of a floor is empty by chance.
const DENSITY: f64 = 4.0;
/// Floors are searched from `ABOVE_M` above the true one to `BELOW_M` below it: not through a slab to its underside
/// (m).
const ABOVE_M: f64 = 0.3;
const BELOW_M: f64 = 0.15;
/// Edge of the part of a scene that is scanned (pixels).
const WINDOW: f64 = 200.0;

/// Floor heights in five scenes at four pixel sizes.
pub fn floors(effort: Effort) -> Result<Outcome> {
    let scenes = [
        ("house", Params::new().with("storeys", 1.0)),
        ("church", Params::new().with("bays", 3.0)),
        ("street", Params::new().with("length", 20.0)),
        ("terrain", Params::new().with("size", 20.0).with("wave", 15.0).with("height", 1.0)),
        ("tower", Params::new().with("storeys", 3.0)),
    ];
    let sizes: &[f64] = effort.of(&[0.02, 0.05, 0.1, 0.2], &[0.2]);
    let mut csv = Table::new([
        "scene",
        "pixel_m",
        "method",
        "queries",
        "rmse_mm",
        "p95_mm",
        "max_mm",
        "inner_rmse_mm",
        "inner_p95_mm",
        "inner_max_mm",
        "without_floor",
        "inner_without_floor",
    ]);
    let mut page = Table::new([
        "scene",
        "t (cm)",
        "plane: RMSE / 95 % / max (mm)",
        "off edges: RMSE / 95 % / max (mm)",
        "without floor: all / off edges",
        "thesis as written: RMSE / 95 % / max (mm)",
        "without floor",
    ]);
    for (name, params) in scenes {
        let scene = Scene::named(name, &params)?;
        for &pixel_m in sizes {
            let bounds = scene.bounds();
            let middle = scene
                .walk()
                .map_or([0, 1].map(|a| (bounds.min[a] + bounds.max[a]) / 2.0), |walk| [walk.start[0], walk.start[1]]);
            let half = WINDOW * pixel_m / 2.0;
            let spec = SampleSpec {
                mode: Mode::Direct(Order::Grid),
                ..SampleSpec::direct_density(DENSITY / (pixel_m * pixel_m)).with_noise(NOISE_M)
            };
            let near = |p: &[f64; 3]| (0..2).all(|a| (p[a] - middle[a]).abs() <= half);
            let scan = Scan::new(scene.points(3, &spec)?.filter(near).collect())?;
            let mut random = Random(64);
            let mut queries = Vec::new();
            for _ in 0..effort.of(200_000, 20_000) {
                if queries.len() == effort.of(6000, 500) {
                    break;
                }
                let inset = half - 3.0 * pixel_m;
                let [x, y] = [0, 1].map(|a| middle[a] + random.between(-inset, inset));
                let z = random.between(bounds.min[2], bounds.max[2] + 0.5);
                let Some((floor, slope)) = scene.floor_under(x, y, z) else { continue };
                let room = scene.ceiling_above(x, y, floor + 1e-6).is_none_or(|(above, _)| above > floor + 0.4);
                if slope <= STEEPEST_DEG && room {
                    queries.push((x, y, floor, is_inner(&scene, x, y, floor, pixel_m)));
                }
            }
            let mut cells = Vec::new();
            for method in [Method::Written, Method::Plane] {
                let judged = scan.judge(Setting::new(pixel_m), method)?;
                let (mut errors, mut missing) = ([Errors::default(), Errors::default()], [Share::default(); 2]);
                for &(x, y, floor, inner) in &queries {
                    let found = judged.floor(x, y, floor + ABOVE_M, ABOVE_M + BELOW_M);
                    for k in 0..=usize::from(inner) {
                        missing[k].add(found.is_none());
                        errors[k].0.extend(found.map(|z| (z - floor) * 1000.0));
                    }
                }
                let [all, inner] = errors.map(|e| [e.rmse(), e.quantile(0.95), e.quantile(1.0)]);
                let missing = missing.map(|share| share.value());
                let heights = all.into_iter().chain(inner).map(|v| number(v, 2));
                csv.row(
                    [name.into(), number(pixel_m, 2), method.name().into(), queries.len().to_string()]
                        .into_iter()
                        .chain(heights)
                        .chain(missing.map(|v| number(v, 4))),
                );
                cells.push((all, inner, missing));
            }
            let triple = |of: [f64; 3], missing: f64| match missing {
                1.0 => "–".to_owned(),
                _ => of.map(|v| number(v, 1)).join(" / "),
            };
            let [(written, _, lost), (ours, inner, missing)] = [cells[0], cells[1]];
            page.row([
                name.to_owned(),
                number(pixel_m * 100.0, 0),
                triple(ours, missing[0]),
                triple(inner, missing[1]),
                missing.map(percent).join(" / "),
                triple(written, lost[0]),
                percent(lost[0]),
            ]);
        }
    }
    let mut outcome = Outcome { tables: vec![("scene-floors", csv)], ..Outcome::default() };
    outcome.fact("scene-floors", page.markdown());
    Ok(outcome)
}

/// Whether there is but one surface within one and a half pixels, as far as a pawn's feet are concerned.
fn is_inner(scene: &Scene, x: f64, y: f64, floor: f64, pixel_m: f64) -> bool {
    let reach = 1.5 * pixel_m;
    let rise = reach * std::f64::consts::SQRT_2 * STEEPEST_DEG.to_radians().tan() + 1e-6;
    let same = |dx: f64, dy: f64| {
        let found = scene.floor_under(x + dx, y + dy, floor + rise);
        found.is_some_and(|(z, slope)| (z - floor).abs() <= rise.min(reach * 2.0 * slope.to_radians().tan() + 0.005))
    };
    let corners = [(-reach, -reach), (-reach, reach), (reach, -reach), (reach, reach)];
    let low = [x - reach, y - reach, floor + rise + 0.01];
    let high = [x + reach, y + reach, floor + rise + 0.25];
    corners.into_iter().all(|(dx, dy)| same(dx, dy)) && scene.distance_to_box(low, high) > 0.0
}
