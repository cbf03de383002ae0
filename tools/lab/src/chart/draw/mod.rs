//! Charts and pages of what `bench chart` and `bench scale` measured; measures nothing itself.
//!
//! In: `chart/measured.csv`, and `chart/phantoms.csv`, `chart/scale.csv` and `chart/machine.txt` where they are there.
//! Out: `chart/*.svg`, `chart.md` and `chart.html`, a page of its own.

mod axis;
mod figure;
mod front;
mod html;
mod labels;
mod machine;
mod model;
mod page;
mod plots;
mod style;
mod svg;
mod tables;
mod verdict;

use super::lines::{self, Line};
use crate::stability::Result;
use std::path::Path;

pub use machine::{MACHINE_FILE, machine};

/// A chart as it is stored: file name without its ending, whose chart it is, what it shows, and the SVG.
struct Drawn {
    name: String,
    /// The scene, or [`plots::SCALE`].
    group: String,
    /// Short description of both axes.
    what: String,
    svg: String,
}

/// Draws all that was measured into `folder`; scans nothing but `folder/chart`.
pub fn run(folder: &Path) -> Result<()> {
    let charts = folder.join("chart");
    let scenes = model::scenes(lines::read(&charts.join("measured.csv"))?);
    let phantoms = optional(&charts.join("phantoms.csv"))?;
    let scale = optional(&charts.join("scale.csv"))?;
    let mut drawn = Vec::new();
    for scene in &scenes {
        for (what, figure) in plots::of_scene(scene, &phantoms) {
            drawn.push(draw(&figure, scene.name.clone(), what)?);
        }
    }
    for (what, figure) in plots::of_scale(&scale) {
        drawn.push(draw(&figure, plots::SCALE.into(), what)?);
    }
    for chart in &drawn {
        write(&charts.join(format!("{}.svg", chart.name)), &chart.svg)?;
    }
    let machine = machine::measured_on(&charts)?;
    write(&folder.join("chart.md"), &page::page(&scenes, &drawn, &machine)?)?;
    write(&folder.join("chart.html"), &html::page(&drawn, &machine)?)
}

/// A table that may be missing: no lines then.
fn optional<T: Line>(path: &Path) -> Result<Vec<T>> {
    if path.exists() { lines::read(path) } else { Ok(Vec::new()) }
}

fn draw(figure: &figure::Figure, group: String, what: String) -> Result<Drawn> {
    let svg = svg::render(figure).map_err(|e| format!("{}.svg: {e}", figure.name))?;
    Ok(Drawn { name: figure.name.clone(), group, what, svg })
}

fn write(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).map_err(|e| format!("{}: cannot be written: {e}", path.display()).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEASURED: &str = "\
scene,method,settings,pixel_cm,metric,value,low,high,n
house,slicewalk plane,\"slices of 3 pixels, plane\",4,walk_mean_ns,60,55,66,4000
house,slicewalk plane,\"slices of 3 pixels, plane\",4,out_p99_cm,5,5,5,20000
house,slicewalk plane,\"slices of 3 pixels, plane\",4,in_p99_cm,0,0,0,20000
house,slicewalk plane,\"slices of 3 pixels, plane\",4,missed,0,0,0,4000
house,octomap,<lazy>,4,walk_mean_ns,30,30,30,4000
house,octomap,<lazy>,4,out_p99_cm,4,4,4,20000
house,octomap,<lazy>,4,in_p99_cm,0,0,0,20000
house,capt,would take 40 GB,4,skipped,,,,
";

    #[test]
    fn the_pages_name_the_peer_that_is_better_and_need_nothing_else() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let charts = folder.path().join("chart");
        std::fs::create_dir(&charts)?;
        std::fs::write(charts.join("measured.csv"), MEASURED)?;
        std::fs::write(charts.join(MACHINE_FILE), "an abacus\n")?;
        run(folder.path())?;
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name));
        let (words, page, svg) = (read("chart.md")?, read("chart.html")?, read("chart/house-walk.svg")?);
        for found in
            ["an abacus", "**`slicewalk plane` beaten** by `octomap` at 4 cm", "capt at 4 cm: would take 40 GB"]
        {
            assert!(words.contains(found), "{found:?} is missing in {words}");
        }
        assert!(svg.contains("octomap, t = 4 cm: 30.0 ns (30.0 to 30.0), error 4.00 cm"), "{svg}");
        let outside = page.replace("http://www.w3.org/2000/svg", "");
        assert!(
            page.contains(svg.trim()) && !["http", "src=", "href=", "url("].iter().any(|way| outside.contains(way))
        );
        Ok(())
    }
}
