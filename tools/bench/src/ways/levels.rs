//! Coarse ways on the overview levels of real scans, beside exact ones.

use super::routes::{alone, archive, times};
use super::{Effort, everywhere, reached, spot};
use crate::stability::Result;
use crate::stability::table::{Table, number, percent};
use crate::{Random, data};
use nalgebra::Point3;
use slicewalk::NoMonitor;
use slicewalk::convert::{ConvertOptions, PixelSize};
use slicewalk::input::Units;
use slicewalk::reach::{Pawn, Search};
use slicewalk::store::Store;
use slicewalk::walk::Body;

/// Metres of an international foot.
const FOOT_M: f64 = 0.3048;
/// Name, file, metres of its unit, pixel size and height of the pawn (m).
const SCANS: [(&str, &str, f64, f64, f64); 5] = [
    ("Autzen stadium, from the air", "autzen_stadium.laz", FOOT_M, 0.5, 1.8),
    ("ISPRS town, from the air", "isprs_csite2_town.laz", 1.0, 0.5, 1.8),
    ("Delft, from the air", "delft_city_block_ahn3.laz", 1.0, 0.5, 1.8),
    ("forest plot", "forest_plot_tls.laz", 1.0, 0.1, 1.8),
    ("real scan of two storeys", "indoor_two_storey_zup.laz", 1.0, 0.05, 1.6),
];
/// Largest pixels of a level on which `slicetool route` plans (m).
const COARSEST_M: f64 = 4.0;
/// Places of which that with the largest region around is taken.
const STARTS: usize = 20;

/// The table, as a page.
pub fn page(effort: &Effort) -> Result<String> {
    let mut table = Table::new([
        "scan",
        "pixel (m)",
        "level",
        "its pixel (m)",
        "pairs",
        "found on the level",
        "length: median, least, greatest share of the exact one",
        "median, 99 %, greatest time (ms)",
    ]);
    for (name, file, unit_m, pixel_m, height) in SCANS.iter().filter(|scan| effort.takes(scan.0)) {
        let Some(path) = data::file(file) else { continue };
        let folder = tempfile::tempdir()?;
        let archive = archive(
            ConvertOptions {
                pixel: PixelSize::Metres(*pixel_m),
                units: Units::Factor(*unit_m),
                levels: true,
                ..ConvertOptions::new(vec![path], folder.path().join("scene.slices"))
            },
            folder.path(),
        )?;
        let store = Store::resident(&archive, &NoMonitor)?;
        let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: *height });
        let (mut standing, region) = everywhere(&store, pawn)?;
        let places: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        drop(region);
        let mut random = Random(71);
        let mut largest = None;
        for _ in 0..STARTS {
            let from = places[(random.bits() % places.len().max(1) as u64) as usize];
            let start = spot(&store, &mut standing, from.into())?.ok_or("a place is none")?;
            let region = reached(&store, &mut standing, start)?;
            if largest.as_ref().is_none_or(|(_, most)| region.area_m2() > *most) {
                let area = region.area_m2();
                largest = Some((region, area));
            }
        }
        let (mut region, _) = largest.ok_or("nowhere to stand")?;
        region.prepare(&NoMonitor)?;
        let places: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        let mut search = Search::new();
        let mut pairs = Vec::new();
        while pairs.len() < effort.of(300, 30) {
            let ends = [0; 2].map(|_| places[(random.bits() % places.len() as u64) as usize]);
            let mut spot = |end: Point3<f64>| spot(&store, &mut standing, end.into());
            let (Some(from), Some(to)) = (spot(ends[0])?, spot(ends[1])?) else { continue };
            let route = search.route(&region, &from, &to, &NoMonitor)?.ok_or("a region without a way")?;
            pairs.push((ends, route.length_m));
        }
        for level in archive.levels()?.iter().filter(|level| level.frame().pixel_m() <= COARSEST_M) {
            let on_level = Store::resident(&archive.level(level.number())?, &NoMonitor)?;
            let pawn = pawn.on_level(level.frame());
            let (mut seconds, mut shares) = (Vec::new(), Vec::new());
            for (ends, length_m) in &pairs {
                let (route, took) = alone(&on_level, pawn, *ends)?;
                seconds.push(took);
                shares.extend(route.map(|route| route.length_m / length_m.max(*pixel_m)));
            }
            shares.sort_by(f64::total_cmp);
            let at = |share: f64| shares.get((shares.len().saturating_sub(1) as f64 * share) as usize);
            let share = |at: Option<&f64>| at.map_or("–".into(), |share| number(*share, 2));
            table.row([
                (*name).to_owned(),
                number(*pixel_m, 2),
                level.number().to_string(),
                number(level.frame().pixel_m(), 1),
                pairs.len().to_string(),
                percent(shares.len() as f64 / pairs.len() as f64),
                format!("{}, {}, {}", share(at(0.5)), share(at(0.0)), share(at(1.0))),
                times(&mut seconds),
            ]);
        }
    }
    Ok(format!("{}\n{}\n", include_str!("levels.head.md"), table.markdown()))
}
