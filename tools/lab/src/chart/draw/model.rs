//! Measured figures, by scene, method and pixel size.

use super::style;
use crate::chart::lines::{Measured, Value};
use std::collections::BTreeMap;

/// Names of our methods begin so.
const OURS: &str = "slicewalk";

/// A cost that error is charted against.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cost {
    /// Part of the names of its files.
    pub key: &'static str,
    /// In a heading: error against ...
    pub what: &'static str,
    /// With its unit, on an axis.
    pub axis: &'static str,
    /// Unit after a number.
    pub unit: &'static str,
    metric: &'static str,
    per_area: bool,
}

/// All costs, the first first.
pub const COSTS: [Cost; 5] = [
    Cost {
        key: "walk",
        what: "time of a query along a walk",
        axis: "one box query of the pawn along a walk (ns, mean)",
        unit: "ns",
        metric: "walk_mean_ns",
        per_area: false,
    },
    Cost {
        key: "random",
        what: "time of a query at random places",
        axis: "one box query of the pawn at a random place (ns, mean)",
        unit: "ns",
        metric: "random_mean_ns",
        per_area: false,
    },
    Cost {
        key: "resident",
        what: "bytes in memory",
        axis: "bytes in memory per square metre of ground",
        unit: "B/m²",
        metric: "resident_bytes",
        per_area: true,
    },
    Cost {
        key: "file",
        what: "bytes in a file",
        axis: "bytes in a file per square metre of ground",
        unit: "B/m²",
        metric: "file_bytes",
        per_area: true,
    },
    Cost {
        key: "build",
        what: "time to build",
        axis: "time to build from points or triangles (s)",
        unit: "s",
        metric: "build_s",
        per_area: false,
    },
];

/// A method at one pixel size.
#[derive(Debug, Clone, Default)]
pub struct Setting {
    pub pixel_cm: f64,
    pub settings: String,
    values: BTreeMap<String, Value>,
}

impl Setting {
    pub fn get(&self, metric: &str) -> Option<Value> {
        self.values.get(metric).copied()
    }

    /// The greater of the 99th percentiles of both one-sided distances (cm).
    pub fn error_cm(&self) -> Option<f64> {
        Some(self.get("out_p99_cm")?.value.max(self.get("in_p99_cm")?.value))
    }

    /// Whether it answered "clear" where there was a point; where that was not asked, it is not held against it.
    pub fn misses(&self) -> bool {
        self.get("missed").is_some_and(|share| share.value > 0.0)
    }
}

/// A method, from the least pixels to the largest.
#[derive(Debug, Clone)]
pub struct Series {
    pub method: String,
    pub settings: Vec<Setting>,
}

impl Series {
    pub fn ours(&self) -> bool {
        self.method.starts_with(OURS)
    }

    pub fn at(&self, pixel_cm: f64) -> Option<&Setting> {
        self.settings.iter().find(|setting| setting.pixel_cm == pixel_cm)
    }
}

/// A cell that was not run, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Skipped {
    pub method: String,
    pub pixel_cm: f64,
    pub reason: String,
}

/// A scene with all that was measured in it.
#[derive(Debug, Clone)]
pub struct Scene {
    pub name: String,
    area_m2: Option<f64>,
    pub series: Vec<Series>,
    pub skipped: Vec<Skipped>,
}

impl Scene {
    pub fn cost(&self, cost: &Cost, setting: &Setting) -> Option<Value> {
        let value = setting.get(cost.metric)?;
        if !cost.per_area {
            return Some(value);
        }
        let per = |bytes: f64| self.area_m2.filter(|area| *area > 0.0).map(|area| bytes / area);
        Some(Value { value: per(value.value)?, low: per(value.low)?, high: per(value.high)? })
    }
}

/// The scenes in the order of the lines; a later line of the same cell holds.
pub fn scenes(lines: Vec<Measured>) -> Vec<Scene> {
    let mut scenes: Vec<Scene> = Vec::new();
    for line in lines {
        let at = scenes.iter().position(|scene| scene.name == line.scene).unwrap_or_else(|| {
            scenes.push(Scene { name: line.scene.clone(), area_m2: None, series: vec![], skipped: vec![] });
            scenes.len() - 1
        });
        add(&mut scenes[at], line);
    }
    for scene in &mut scenes {
        scene.series.sort_by_key(|series| style::rank(&series.method));
        for series in &mut scene.series {
            series.settings.sort_by(|a, b| a.pixel_cm.total_cmp(&b.pixel_cm));
        }
    }
    scenes
}

fn add(scene: &mut Scene, line: Measured) {
    let Measured { method, settings, figure, .. } = line;
    let pixel_cm = f64::from(line.pixel_cm);
    let Some((metric, value, _)) = figure else {
        scene.skipped.push(Skipped { method, pixel_cm, reason: settings });
        return;
    };
    if metric == "area_m2" {
        scene.area_m2 = Some(value.value);
    }
    let at = scene.series.iter().position(|series| series.method == method).unwrap_or_else(|| {
        scene.series.push(Series { method, settings: Vec::new() });
        scene.series.len() - 1
    });
    let known = &mut scene.series[at].settings;
    let at = known.iter().position(|setting| setting.pixel_cm == pixel_cm).unwrap_or_else(|| {
        known.push(Setting { pixel_cm, ..Setting::default() });
        known.len() - 1
    });
    known[at].settings = settings;
    known[at].values.insert(metric, value);
}
