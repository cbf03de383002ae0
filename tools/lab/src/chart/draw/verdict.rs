//! Says where Slicewalk is on the Pareto front, and which peers beat it elsewhere.

use super::axis::short;
use super::front::dominates;
use super::model::{COSTS, Cost, Scene};
use super::plots::costly;
use crate::stability::table::Table;

/// Standing of Slicewalk at one pixel size, for one cost.
#[derive(Debug, Clone, PartialEq)]
pub enum Stand {
    /// These Slicewalk methods are on the front.
    Front(Vec<String>),
    /// No peer beats these Slicewalk methods, but Slicewalk at another setting beats all of its methods here.
    OnlyOurs(Vec<String>),
    /// Peers, each with its pixel size (cm), that beat the Slicewalk method that the fewest beat.
    Beaten { method: String, by: Vec<(String, f64)> },
    /// Every Slicewalk method misses points here.
    Misses,
}

/// Returns the standing at each of Slicewalk's pixel sizes; empty where its cost or error is unknown.
pub fn stands(scene: &Scene, cost: &Cost) -> Vec<(f64, Stand)> {
    let all: Vec<_> = costly(scene, cost).collect();
    let mut sizes: Vec<f64> = all.iter().filter(|found| found.0.ours()).map(|found| found.1.pixel_cm).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.dedup();
    let allowed = || all.iter().filter(|found| !found.1.misses());
    let beats = |at: (f64, f64), peers: bool| {
        allowed().filter(move |other| (!other.0.ours() || !peers) && dominates(other.2, at))
    };
    let stand = |size: &f64| {
        let here = || allowed().filter(|found| found.0.ours() && found.1.pixel_cm == *size);
        let of_ours = |peers: bool| {
            let unbeaten = here().filter(|found| beats(found.2, peers).next().is_none());
            unbeaten.map(|found| found.0.method.clone()).collect::<Vec<_>>()
        };
        let stand = match (of_ours(false), of_ours(true)) {
            (front, _) if !front.is_empty() => Stand::Front(front),
            (_, only) if !only.is_empty() => Stand::OnlyOurs(only),
            _ => match here().min_by_key(|found| beats(found.2, true).count()) {
                Some(least) => {
                    let by = beats(least.2, true).map(|other| (other.0.method.clone(), other.1.pixel_cm)).collect();
                    Stand::Beaten { method: least.0.method.clone(), by }
                }
                None => Stand::Misses,
            },
        };
        (*size, stand)
    };
    sizes.iter().map(stand).collect()
}

impl Stand {
    /// In a cell of a table.
    fn words(&self) -> String {
        match self {
            Self::Front(methods) => format!("front: {}", listed(methods)),
            Self::OnlyOurs(methods) => {
                format!("no peer better than {}, but Slicewalk at another setting", listed(methods))
            }
            Self::Beaten { method, by } => {
                let peers: Vec<_> = by.chunk_by(|a, b| a.0 == b.0).map(at_sizes).collect();
                format!("**`{method}` beaten** by {}", peers.join(", "))
            }
            Self::Misses => "**misses points**".into(),
        }
    }

    /// Whether no peer is better in both.
    pub fn unbeaten(&self) -> bool {
        matches!(self, Self::Front(_) | Self::OnlyOurs(_))
    }
}

fn listed(methods: &[String]) -> String {
    methods.iter().map(|method| format!("`{method}`")).collect::<Vec<_>>().join(", ")
}

/// One peer with its pixel sizes.
fn at_sizes(same: &[(String, f64)]) -> String {
    let sizes: Vec<_> = same.iter().map(|(_, size)| short(*size)).collect();
    format!("`{}` at {} cm", same[0].0, sizes.join(", "))
}

/// Returns a row for each pixel size and a column for each cost, as Markdown; `None` without figures of Slicewalk.
pub fn table(scene: &Scene) -> Option<String> {
    let costs: Vec<_> =
        COSTS.iter().map(|cost| (cost, stands(scene, cost))).filter(|(_, all)| !all.is_empty()).collect();
    let mut sizes: Vec<f64> = costs.iter().flat_map(|(_, all)| all.iter().map(|stand| stand.0)).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.dedup();
    if sizes.is_empty() {
        return None;
    }
    let head = std::iter::once("t (cm)").chain(costs.iter().map(|(cost, _)| cost.what));
    let mut table = Table::new(head);
    for size in sizes {
        let cell = |all: &Vec<(f64, Stand)>| {
            all.iter().find(|stand| stand.0 == size).map_or_else(|| "–".into(), |stand| stand.1.words())
        };
        table.row(std::iter::once(short(size)).chain(costs.iter().map(|(_, all)| cell(all))));
    }
    Some(table.markdown())
}

/// Over all scenes and pixel sizes: at how many no peer is better, for each cost, and where one is.
pub fn summary(scenes: &[Scene]) -> String {
    let mut words = Vec::new();
    for cost in &COSTS {
        let all: Vec<_> = scenes.iter().map(|scene| (scene, stands(scene, cost))).collect();
        let count = |wanted: fn(&Stand) -> bool| all.iter().flat_map(|(_, all)| all).filter(|at| wanted(&at.1)).count();
        let pairs = count(|_| true);
        if pairs == 0 {
            continue;
        }
        let beaten: Vec<_> = all.iter().filter_map(|(scene, all)| beaten_in(&scene.name, all)).collect();
        words.push(format!(
            "- error and {}: of {pairs} pairs of scene and t, Slicewalk is on the front at {}, and no peer is better in both at {}{}",
            cost.what,
            count(|stand| matches!(stand, Stand::Front(_))),
            count(Stand::unbeaten),
            if beaten.is_empty() { ".".into() } else { format!(". Better peers: {}.", beaten.join("; ")) },
        ));
    }
    words.join("\n")
}

/// At which pixel sizes of a scene peers are better, and which; `None` at none.
fn beaten_in(scene: &str, all: &[(f64, Stand)]) -> Option<String> {
    let beaten = || all.iter().filter(|(_, stand)| !stand.unbeaten());
    let sizes: Vec<_> = beaten().map(|(size, _)| short(*size)).collect();
    let mut peers: Vec<String> = Vec::new();
    for (_, stand) in beaten() {
        match stand {
            Stand::Beaten { by, .. } => peers.extend(by.iter().map(|(peer, _)| format!("`{peer}`"))),
            _ => peers.push("Slicewalk misses points".into()),
        }
    }
    peers.sort();
    peers.dedup();
    (!sizes.is_empty()).then(|| format!("{scene} at {} cm: {}", sizes.join(", "), peers.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::super::model;
    use super::*;
    use crate::chart::lines::{Measured, Value};

    fn scene(lines: &[(&str, u32, f64, f64, f64)]) -> Vec<Scene> {
        let cells = lines.iter().flat_map(|(method, pixel_cm, ns, error, missed)| {
            [("walk_mean_ns", ns), ("out_p99_cm", error), ("in_p99_cm", &0.0), ("missed", missed)].map(
                |(metric, value)| Measured {
                    scene: "house".into(),
                    method: (*method).into(),
                    settings: String::new(),
                    pixel_cm: *pixel_cm,
                    figure: Some((metric.into(), Value { value: *value, low: *value, high: *value }, 1)),
                },
            )
        });
        model::scenes(cells.collect())
    }

    #[test]
    fn a_peer_that_is_faster_and_nearer_is_named_and_one_that_misses_is_not() {
        let mut lines = vec![
            ("slicewalk plane", 1, 60.0, 1.0, 0.0),
            ("slicewalk plane", 4, 70.0, 4.0, 0.0),
            ("slicewalk span", 8, 90.0, 8.0, 0.0),
            ("capt", 4, 80.0, 5.0, 0.0),
            ("kiddo spheres", 4, 10.0, 0.5, 0.01),
        ];
        let found = stands(&scene(&lines)[0], &COSTS[0]);
        let expected = [
            (1.0, Stand::Front(vec!["slicewalk plane".into()])),
            (4.0, Stand::OnlyOurs(vec!["slicewalk plane".into()])),
            (8.0, Stand::Beaten { method: "slicewalk span".into(), by: vec![("capt".into(), 4.0)] }),
        ];
        assert_eq!(found, expected);
        lines[2].4 = 0.1;
        assert_eq!(stands(&scene(&lines)[0], &COSTS[0])[2].1, Stand::Misses);
        let words = summary(&scene(&lines));
        let places = [(1.0, found[2].1.clone()), (2.0, found[0].1.clone()), (4.0, found[2].1.clone())];
        assert_eq!(beaten_in("hall", &places).as_deref(), Some("hall at 1, 4 cm: `capt`"));
        assert_eq!(beaten_in("hall", &places[1..2]), None);
        assert_eq!(at_sizes(&[("capt".into(), 4.0), ("capt".into(), 8.0)]), "`capt` at 4, 8 cm");
        assert!(words.contains("of 3 pairs") && words.contains("front at 1") && words.contains("both at 2"), "{words}");
    }
}
