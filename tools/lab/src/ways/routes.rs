//! Routes between random places: found just where exhaustive search finds one, how long they take, and whether the walker arrives.

use super::{Effort, everywhere, known, processor_s};
use crate::stability::Result;
use crate::stability::lab::{Scan, Setting};
use crate::stability::table::{Table, number, percent};
use crate::{Random, data};
use nalgebra::{Point2, Point3};
use scangen::sample::{Mode, Order};
use scangen::{Params, SampleSpec, Scene};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::plan::{Classifier, Up};
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, Pawn, Planned, Planner, Route, Search};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, State, Walker, Waypoints};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::path::Path;

/// Pixel size (m).
const PIXEL_M: f64 = 0.05;
/// How near a walker must come to the end of its route (m).
const NEAR_M: f64 = 0.1;
/// One in this many routes is also searched without preparing the region.
const UNPREPARED: usize = 10;
/// Routes that are planned alone, without a prepared region.
const ALONE: usize = 100;

/// A building, and who walks in it.
struct Building {
    name: &'static str,
    store: Snapshot,
    body: Body,
}

/// The archive of a scan or mesh in metres, in memory.
pub fn converted(input: &Path, up: Up) -> Result<Snapshot> {
    let folder = tempfile::tempdir()?;
    let mut options = ConvertOptions::new(vec![input.to_path_buf()], folder.path().join("scene.slices"));
    options.grid.pixel = PixelSize::Metres(PIXEL_M);
    options.reading.units = Units::Factor(1.0);
    options.plan.up = up;
    Ok(Snapshot::resident(&archive(options, folder.path())?, &NoMonitor)?)
}

/// The archive that a conversion makes in a folder.
pub fn archive(mut options: ConvertOptions, folder: &Path) -> Result<Archive> {
    options.resources.temp_dir = folder.into();
    convert(&options, &NoMonitor)?;
    Ok(Archive::open(&options.output)?)
}

/// A generated scene, scanned evenly with noise of 2 mm.
pub fn generated(name: &str, params: &[(&str, f64)]) -> Result<Snapshot> {
    let params = params.iter().fold(Params::new(), |params, (name, value)| params.with(name, *value));
    let scene = Scene::named(name, &params)?;
    let even = SampleSpec::direct_density((3.0 / PIXEL_M).powi(2)).with_noise(0.002);
    let scan = Scan::new(scene.points(3, &SampleSpec { mode: Mode::Direct(Order::Grid), ..even })?.collect())?;
    Ok(scan.convert(Setting::new(PIXEL_M), Classifier::Plane)?.store)
}

fn buildings(effort: &Effort) -> Result<Vec<Building>> {
    let cylinder = Body::Cylinder { radius: 0.25, height: 1.8 };
    let mut all = Vec::new();
    if effort.takes("house") {
        all.push(Building { name: "house of three storeys", store: generated("house", &[])?, body: cylinder });
    }
    for (name, file, up, body) in [
        ("sibenik", "meshes/sibenik.obj", Up::Y, cylinder),
        ("nav_test", "meshes/nav_test.obj", Up::Y, cylinder),
        ("real scan of two storeys", "indoor_two_storey_zup.laz", Up::Z, Body::Box { x: 0.5, y: 0.5, height: 1.6 }),
    ] {
        if effort.takes(name)
            && let Some(path) = data::file(file)
        {
            all.push(Building { name, store: converted(&path, up)?, body });
        }
    }
    Ok(all)
}

/// Walks along a route; whether it arrives.
fn arrives(store: &Snapshot, body: Body, route: &Route) -> Result<bool> {
    let config = Config { tick_s: 1.0 / 60.0, ..Config::new(body) };
    let mut walker = Walker::new(config, route.points[0])?;
    let mut way = Waypoints::new(route.points.iter().map(|point| Point2::new(point.x, point.y)).collect())?;
    for _ in 0..(2.0 * route.length_m / config.speed * 60.0) as usize + 120 {
        walker.follow(store, 1.0 / 60.0, &mut way);
        if walker.state() == State::Arrived {
            return Ok((walker.feet() - route.points[route.points.len() - 1]).norm() < NEAR_M);
        }
    }
    Ok(false)
}

/// Plans a route alone, as `slicetool route` does; and the processor time that it took (s).
pub fn alone(store: &Snapshot, pawn: Pawn, ends: [Point3<f64>; 2]) -> Result<(Option<Route>, f64)> {
    let start = processor_s();
    let mut planner = Planner::new(store, pawn, ends[0], ends[1])?;
    loop {
        match planner.advance(store, usize::MAX, &NoMonitor)? {
            Planned::Done(found) => return Ok((found.ok(), processor_s() - start)),
            Planned::NotLoaded(_) => return Err("a store without a page".into()),
            _ => {}
        }
    }
}

/// Sorted times in words: median, 99 %, and the greatest (ms).
pub fn times(times: &mut [f64]) -> String {
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times.get(((times.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or(0.0);
    format!("{}, {}, {}", number(at(0.5) * 1e3, 2), number(at(0.99) * 1e3, 2), number(at(1.0) * 1e3, 2))
}

/// The table, as a page.
pub fn page(effort: &Effort) -> Result<String> {
    let mut table = Table::new([
        "building",
        "places",
        "pairs",
        "connected",
        "as exhaustive search",
        "planned alone as well",
        "walker arrives",
        "median, 99 %, greatest of a route (ms)",
        "without preparing",
        "alone",
        "preparing (ms), region (MiB)",
    ]);
    // As many sources as goals of each.
    let side = effort.of(100, 12);
    for Building { name, store, body } in buildings(effort)? {
        let pawn = Pawn::new(body);
        let (mut standing, mut region) = everywhere(&store, pawn)?;
        let places: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        let mut random = Random(21);
        let mut place = || places[(random.bits() % places.len().max(1) as u64) as usize];
        let mut pairs = Vec::new();
        let (mut connected, mut all) = (0, 0);
        for _ in 0..side {
            let from = place();
            let Answer::Known(Some(start)) = standing.spot(&store, from)? else {
                return Err(format!("{name}: {from} is no place").into());
            };
            let mut own = Flood::from(start);
            known(own.grow(&mut standing, &store, &NoMonitor)?)?;
            for _ in 0..side {
                let to = place();
                let Answer::Known(Some(goal)) = standing.spot(&store, to)? else {
                    return Err(format!("{name}: {to} is no place").into());
                };
                let is_connected = own.holds(&standing, &goal);
                pairs.push((start, goal, from, to, is_connected));
                connected += usize::from(is_connected);
                all += 1;
            }
        }
        let (mut search, mut plain, mut guided) = (Search::new(), Vec::new(), Vec::new());
        let mut unprepared = Vec::new();
        for (number, (a, b, .., is_connected)) in pairs.iter().enumerate() {
            if number % UNPREPARED != 0 {
                unprepared.push(None);
                continue;
            }
            let start = processor_s();
            let route = known(search.route(&store, &region, a, b, &NoMonitor)?)?;
            if *is_connected {
                plain.push(processor_s() - start);
            }
            unprepared.push(Some(route.map(|route| route.length_m)));
        }
        let start = processor_s();
        region.prepare(&NoMonitor)?;
        let preparing = processor_s() - start;
        let (mut as_exhaustive, mut arrived, mut found, mut longer) = (0, 0, 0, 0.0f64);
        let mut lost = Vec::new();
        for ((a, b, from, to, is_connected), before) in pairs.iter().zip(&unprepared) {
            let start = processor_s();
            let route = known(search.route(&store, &region, a, b, &NoMonitor)?)?;
            let agrees = before.as_ref().is_none_or(|before| before.is_some() == *is_connected);
            as_exhaustive += usize::from(route.is_some() == *is_connected && agrees);
            let Some(route) = route else { continue };
            guided.push(processor_s() - start);
            found += 1;
            longer = longer.max(route.length_m / before.flatten().unwrap_or(route.length_m).max(PIXEL_M));
            if arrives(&store, body, &route)? {
                arrived += 1;
            } else {
                lost.push((*from, *to));
            }
        }
        let (mut single, mut same) = (Vec::new(), 0);
        let every = (pairs.len() / effort.of(ALONE, 10)).max(1);
        for (_, _, from, to, is_connected) in pairs.iter().step_by(every) {
            let (route, seconds) = alone(&store, pawn, [*from, *to])?;
            same += usize::from(route.is_some() == *is_connected);
            single.push(seconds);
        }
        eprintln!(
            "{name}: lost {:?}; a prepared search is at most {longer:.4} times as long",
            &lost[..lost.len().min(8)]
        );
        table.row([
            name.to_owned(),
            places.len().to_string(),
            all.to_string(),
            percent(connected as f64 / all.max(1) as f64),
            as_exhaustive.to_string(),
            format!("{same} of {}", single.len()),
            format!("{arrived} of {found} ({})", percent(f64::from(arrived) / f64::from(found.max(1)))),
            times(&mut guided),
            times(&mut plain),
            times(&mut single),
            format!("{}, {}", number(preparing * 1e3, 0), number(region.memory_bytes() as f64 / f64::from(1 << 20), 1)),
        ]);
    }
    Ok(format!("{}\n{}\n", include_str!("routes.head.md"), table.markdown()))
}
