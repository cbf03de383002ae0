//! Which charts there are: of a scene, and of size.

use super::axis::{Axis, figures, short};
use super::figure::{Dot, Figure, Spread, Track};
use super::front;
use super::model::{COSTS, Cost, Scene, Series, Setting};
use super::style;
use crate::chart::lines::{PhantomShare, Scaled};
use crate::scale::MEMORY;

/// Group of the charts over size.
pub const SCALE: &str = "scale";
/// Pixels of the chart of phantoms and of the tables (cm), where they were measured.
pub const SHOWN_CM: f64 = 4.0;

/// Error measure that is charted against a cost.
#[derive(Debug, Clone, Copy)]
struct Wrong {
    /// Part of the names of its files, before that of the cost.
    key: &'static str,
    what: &'static str,
    axis: &'static str,
    of: fn(&Setting) -> Option<f64>,
    /// Greatest possible value.
    most: f64,
}

const ERROR: Wrong = Wrong {
    key: "",
    what: "error",
    axis: "error (cm): 99th percentile, the worse direction",
    of: Setting::error_cm,
    most: f64::INFINITY,
};
const PHANTOMS: Wrong = Wrong {
    key: "phantoms-",
    what: "phantoms",
    axis: "boxes without a point that are answered \"hit\" (%)",
    of: |setting| Some(setting.get("phantom")?.value * 100.0),
    most: 100.0,
};

/// The charts of a scene, each with what it shows.
pub fn of_scene(scene: &Scene, phantoms: &[PhantomShare]) -> Vec<(String, Figure)> {
    let errors = COSTS.iter().map(|cost| (ERROR, cost)).chain([(PHANTOMS, &COSTS[0])]);
    let named = |(wrong, cost): (Wrong, &Cost)| {
        Some((format!("{} against {}", wrong.what, cost.what), against(scene, wrong, cost)?))
    };
    let shares = phantoms_of(scene, phantoms).map(|figure| ("phantoms over the gap".to_owned(), figure));
    errors.filter_map(named).chain(shares).collect()
}

/// A file name for a scene: letters, digits and hyphens.
fn file(scene: &str, what: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    format!("{}-{what}", scene.chars().map(plain).collect::<String>())
}

/// A method's setting with its cost and how wrong it is.
type Costly<'a> = (&'a Series, &'a Setting, (f64, f64));

/// All settings of a scene whose cost and error are known.
pub fn costly<'a>(scene: &'a Scene, cost: &'a Cost) -> impl Iterator<Item = Costly<'a>> {
    known(scene, ERROR, cost)
}

fn known<'a>(scene: &'a Scene, wrong: Wrong, cost: &'a Cost) -> impl Iterator<Item = Costly<'a>> {
    let all = scene.series.iter().flat_map(|series| series.settings.iter().map(move |setting| (series, setting)));
    all.filter_map(move |(series, setting)| {
        Some((series, setting, (scene.cost(cost, setting)?.value, (wrong.of)(setting)?)))
    })
}

fn against(scene: &Scene, wrong: Wrong, cost: &Cost) -> Option<Figure> {
    let all: Vec<Costly> = known(scene, wrong, cost).collect();
    let allowed: Vec<_> = all.iter().filter(|(_, setting, _)| !setting.misses()).map(|found| found.2).collect();
    let dot = |(series, setting, at): &Costly| {
        let spread = scene.cost(cost, setting)?;
        let t = short(setting.pixel_cm);
        let says = format!(
            "{}, t = {t} cm: {} {} ({} to {}){}{}{}",
            series.method,
            figures(at.0),
            cost.unit,
            figures(spread.low),
            figures(spread.high),
            setting.error_cm().map_or_else(String::new, |error| format!(", error {} cm", figures(error))),
            share(setting, "missed", "misses"),
            share(setting, "phantom", "phantoms"),
        );
        let spread = Spread::X(spread.low, spread.high);
        Some(Dot { at: *at, spread, label: short(setting.pixel_cm), hollow: setting.misses(), says })
    };
    let tracks = scene.series.iter().map(|series| Track {
        name: series.method.clone(),
        style: style::style(&series.method),
        dots: all.iter().filter(|found| found.0.method == series.method).filter_map(dot).collect(),
    });
    let tracks: Vec<Track> = tracks.collect();
    (!all.is_empty()).then(|| Figure {
        name: file(&scene.name, &format!("{}{}", wrong.key, cost.key)),
        title: format!("{}: {} against {}", scene.name, wrong.what, cost.what),
        x: Axis::log(cost.axis, all.iter().map(|found| found.2.0)),
        y: Axis::log(wrong.axis, all.iter().map(|found| found.2.1)).up_to(wrong.most),
        tracks,
        front: front::stairs(&allowed),
        limit: None,
        notes: vec!["Numbers: t, the edge of".into(), "a pixel or cube (cm).".into(), "Left and low is good.".into()],
    })
}

fn share(setting: &Setting, metric: &str, word: &str) -> String {
    setting.get(metric).map_or_else(String::new, |share| format!(", {word} {} %", figures(share.value * 100.0)))
}

/// Share of boxes answered "hit" over the gap to the nearest point, at [`SHOWN_CM`] or the nearest size there is.
fn phantoms_of(scene: &Scene, phantoms: &[PhantomShare]) -> Option<Figure> {
    let of_scene = || phantoms.iter().filter(|line| line.scene == scene.name);
    let from_shown = |line: &&PhantomShare| (f64::from(line.pixel_cm) / SHOWN_CM).log2().abs();
    let pixel_cm = of_scene().min_by(|a, b| from_shown(a).total_cmp(&from_shown(b)))?.pixel_cm;
    let shown = || of_scene().filter(|line| line.pixel_cm == pixel_cm);
    let mut methods: Vec<&str> = shown().map(|line| line.method.as_str()).collect();
    methods.sort_by_key(|method| style::rank(method));
    methods.dedup();
    let track = |method: &str| {
        let mut dots: Vec<Dot> = shown().filter(|line| line.method == method).map(phantom_dot).collect();
        dots.sort_by(|a, b| a.at.0.total_cmp(&b.at.0));
        Track { name: method.into(), style: style::style(method), dots }
    };
    let (low, high) = shown().fold((0f64, 0f64), |ends, line| (ends.0.min(line.gap_cm), ends.1.max(line.gap_cm)));
    let t = short(f64::from(pixel_cm));
    Some(Figure {
        name: file(&scene.name, "phantoms"),
        title: format!("{}: boxes answered \"hit\" over the gap to the nearest point, t = {t} cm", scene.name),
        x: Axis::linear("gap between box and nearest point (cm; below 0 the point lies inside)", low, high),
        y: Axis::linear("share answered \"hit\"", 0.0, 1.05),
        tracks: methods.into_iter().map(track).collect(),
        front: vec![],
        limit: None,
        notes: vec!["Right of 0 a hit is a".into(), "phantom; left of 0".into(), "anything but 1 misses.".into()],
    })
}

fn phantom_dot(line: &PhantomShare) -> Dot {
    let says = format!("{}, gap {} cm: {} % hit", line.method, short(line.gap_cm), figures(line.share * 100.0));
    Dot { at: (line.gap_cm, line.share), spread: Spread::None, label: String::new(), hollow: false, says }
}

/// A chart over size.
struct Over {
    key: &'static str,
    title: &'static str,
    of: &'static str,
    x: &'static str,
    y: &'static str,
    /// Metric, and its name in the legend.
    metrics: &'static [(&'static str, &'static str)],
    /// Limit of all values, and its name.
    limit: Option<(f64, &'static str)>,
}

const OVER: [Over; 3] = [
    Over {
        key: "throughput",
        title: "conversion throughput over the size of the input",
        of: "conversion",
        x: "points of the input",
        y: "points per second",
        metrics: &[("points_per_s", "converted"), ("read_points_per_s", "read alone")],
        limit: None,
    },
    Over {
        key: "memory",
        title: "peak memory of a conversion over the size of the input",
        of: "conversion",
        x: "points of the input",
        y: "peak memory (bytes)",
        metrics: &[("peak_bytes", "converted")],
        limit: Some((MEMORY as f64, "budget: --memory 512MiB")),
    },
    Over {
        key: "query",
        title: "time of a query over the size of the scene",
        of: "query",
        x: "occupied voxels of the scene",
        y: "one box query of the pawn (ns, mean)",
        metrics: &[("walk_mean_ns", "along a walk"), ("random_mean_ns", "random places")],
        limit: None,
    },
];

/// The charts over size, each with what it shows.
pub fn of_scale(lines: &[Scaled]) -> Vec<(String, Figure)> {
    OVER.iter().filter_map(|over| Some((over.title.to_owned(), over_size(over, lines)?))).collect()
}

fn over_size(over: &Over, lines: &[Scaled]) -> Option<Figure> {
    let track = |((metric, name), style): (&(&str, &str), style::Style)| {
        let of_it = lines.iter().filter(|line| line.what == over.of && line.metric == *metric);
        let dot = |line: &Scaled| {
            let says = format!("{name}: {} at {}", figures(line.value.value), figures(line.size as f64));
            let spread = Spread::Y(line.value.low, line.value.high);
            Dot { at: (line.size as f64, line.value.value), spread, label: String::new(), hollow: false, says }
        };
        let mut dots: Vec<Dot> = of_it.map(dot).collect();
        dots.sort_by(|a, b| a.at.0.total_cmp(&b.at.0));
        Track { name: (*name).into(), style, dots }
    };
    let tracks: Vec<Track> = over.metrics.iter().zip(style::QUANTITIES).map(track).collect();
    let dots = || tracks.iter().flat_map(|track| &track.dots);
    dots().next()?;
    // A wide axis keeps what is flat looking flat.
    let (least, most) = dots().fold((f64::INFINITY, 0f64), |ends, dot| (ends.0.min(dot.at.1), ends.1.max(dot.at.1)));
    Some(Figure {
        name: file(SCALE, over.key),
        title: format!("slicewalk: {}", over.title),
        x: Axis::log(over.x, dots().map(|dot| dot.at.0)),
        y: Axis::log(over.y, [least / 3.0, most.max(over.limit.map_or(0.0, |limit| limit.0)) * 3.0].into_iter()),
        tracks,
        front: vec![],
        limit: over.limit,
        notes: vec![],
    })
}
