//! Tables of one pixel size; the settings; and the cells that were left out.

use super::axis::{figures, short};
use super::model::{COSTS, Scene, Series, Setting, Skipped};
use super::plots::SHOWN_CM;
use crate::stability::table::{Table, percent};

const NONE: &str = "–";
/// Metrics of the second table: metric, heading, and whether it is a share.
const WALKING: [(&str, &str, bool); 10] = [
    ("floor_rmse_cm", "floor, RMSE (cm)", false),
    ("slope_wrong", "wrong slope classes", true),
    ("door_cm", "least door (cm)", false),
    ("path_cm", "path off (cm)", false),
    ("toi_cm", "contact, mean error (cm)", false),
    ("toi_late_cm", "contact, latest (cm)", false),
    ("stand_rmse_cm", "where one may stand: height, RMSE (cm)", false),
    ("stand_missing", "not claimed", true),
    ("stand_wrong", "of claims wrong", true),
    ("out_max_cm", "claimed solid to point, most (cm)", false),
];

fn shown(scene: &Scene) -> impl Iterator<Item = (&Series, &Setting)> {
    scene.series.iter().filter_map(|series| Some((series, series.at(SHOWN_CM)?)))
}

/// Error, wrong answers and costs of every method.
pub fn costs(scene: &Scene) -> String {
    let mut table = Table::new(
        ["method", "error (cm)", "missed", "phantoms"]
            .map(String::from)
            .into_iter()
            .chain(COSTS.iter().map(|cost| format!("{} ({})", cost.what, cost.unit))),
    );
    for (series, setting) in shown(scene) {
        let share = |metric| setting.get(metric).map_or_else(|| NONE.into(), |share| percent(share.value));
        let error = setting.error_cm().map_or_else(|| NONE.into(), figures);
        let costs = COSTS.iter().map(|cost| {
            scene.cost(cost, setting).map_or_else(
                || NONE.into(),
                |found| {
                    let [low, value, high] = [found.low, found.value, found.high].map(figures);
                    if low == high { value } else { format!("{value} ({low} to {high})") }
                },
            )
        });
        let cells: Vec<_> = [error, share("missed"), share("phantom")].into_iter().chain(costs).collect();
        if cells.iter().any(|cell| cell != NONE) {
            table.row(std::iter::once(series.method.clone()).chain(cells));
        }
    }
    table.markdown()
}

/// Floors, slopes, doors, paths and contacts, of the methods that were asked; none where none was.
pub fn walking(scene: &Scene) -> Option<String> {
    let asked: Vec<_> = WALKING.iter().filter(|column| shown(scene).any(|(_, s)| s.get(column.0).is_some())).collect();
    if asked.is_empty() {
        return None;
    }
    let mut table = Table::new(std::iter::once("method").chain(asked.iter().map(|column| column.1)));
    for (series, setting) in shown(scene) {
        let cells: Vec<_> = asked.iter().map(|column| setting.get(column.0)).collect();
        if cells.iter().any(Option::is_some) {
            let text = asked.iter().zip(cells).map(|(column, cell)| match cell {
                Some(cell) if column.2 => percent(cell.value),
                Some(cell) => figures(cell.value),
                None => NONE.into(),
            });
            table.row(std::iter::once(series.method.clone()).chain(text));
        }
    }
    Some(table.markdown())
}

/// Settings of every method, each in the words of its first measured cell.
pub fn settings(scenes: &[Scene]) -> String {
    let mut table = Table::new(["method", "settings"]);
    let mut seen: Vec<(&str, &str)> = Vec::new();
    let all = scenes.iter().flat_map(|scene| &scene.series);
    for (series, setting) in all.flat_map(|series| series.settings.iter().map(move |setting| (series, setting))) {
        if !seen.iter().any(|(method, _)| *method == series.method) {
            seen.push((&series.method, &setting.settings));
        }
    }
    seen.sort_by_key(|(method, _)| super::style::rank(method));
    seen.iter().for_each(|(method, settings)| table.row([*method, settings]));
    table.markdown()
}

/// Skipped cells with their reasons; pixel sizes with the same reason share a row.
pub fn skipped(scene: &Scene) -> String {
    let mut groups: Vec<(&Skipped, Vec<f64>)> = Vec::new();
    for cell in &scene.skipped {
        let same = groups.iter_mut().find(|(first, _)| first.method == cell.method && first.reason == cell.reason);
        match same {
            Some((_, sizes)) => sizes.push(cell.pixel_cm),
            None => groups.push((cell, vec![cell.pixel_cm])),
        }
    }
    let line = |(cell, mut sizes): (&Skipped, Vec<f64>)| {
        sizes.sort_by(f64::total_cmp);
        let sizes: Vec<_> = sizes.into_iter().map(short).collect();
        format!("- not run: {} at {} cm: {}\n", cell.method, sizes.join(", "), cell.reason)
    };
    groups.into_iter().map(line).collect()
}
