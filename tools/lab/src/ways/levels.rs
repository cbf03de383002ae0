//! Coarse ways on the overview levels of real scans, beside exact ones.

use super::routes::{archive, times};
use super::{Effort, everywhere, known, processor_s, reached, spot};
use crate::stability::Result;
use crate::stability::table::{Table, number, percent};
use crate::{Random, data};
use nalgebra::{Point2, Point3};
use slicewalk::NoMonitor;
use slicewalk::reach::{Coarse, Flood, Pawn, PlaceId, Planned, Region, Route, Search, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use slicewalk_convert::{ConvertOptions, PixelSize};
use slicewalk_input::Units;

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
/// From a coarse way to the edge of the corridor about it (pixels of its level), as `slicetool route` has it.
const BESIDE: f64 = 3.0;
/// Places of which that with the largest region around is taken.
const STARTS: usize = 20;

/// Two places and what leads from one to the other.
struct Pair {
    ends: [Point3<f64>; 2],
    spots: [PlaceId; 2],
    /// Length of the exact way, if there is one (m).
    length_m: Option<f64>,
}

/// A way on a level.
struct Guess {
    route: Route,
    doubt_m: f64,
    /// Whether an exact way lies in the corridor about it.
    holds: bool,
}

/// Results of all pairs on a level.
#[derive(Default)]
struct Tally {
    connected: usize,
    found: usize,
    held: usize,
    clear: usize,
    others: usize,
    invented: usize,
    shares: Vec<f64>,
    seconds: Vec<f64>,
}

impl Tally {
    fn add(&mut self, pair: &Pair, guess: Option<&Guess>, seconds: f64, pixel_m: f64) {
        self.seconds.push(seconds);
        match pair.length_m {
            Some(length_m) => {
                self.connected += 1;
                self.found += usize::from(guess.is_some());
                self.held += usize::from(guess.is_some_and(|guess| guess.holds));
                self.clear += usize::from(guess.is_some_and(|guess| guess.doubt_m == 0.0));
                self.shares.extend(guess.map(|guess| guess.route.length_m / length_m.max(pixel_m)));
            }
            None => {
                self.others += 1;
                self.invented += usize::from(guess.is_some());
            }
        }
    }

    fn row(mut self) -> [String; 7] {
        self.shares.sort_by(f64::total_cmp);
        let at = |share: f64| self.shares.get((self.shares.len().saturating_sub(1) as f64 * share) as usize);
        let share = |at: Option<&f64>| at.map_or("–".into(), |share| number(*share, 2));
        let of = |part: usize, all: usize| if all == 0 { "–".into() } else { percent(part as f64 / all as f64) };
        [
            self.connected.to_string(),
            of(self.found, self.connected),
            of(self.clear, self.found),
            of(self.held, self.found),
            format!("{}, {}, {}", share(at(0.5)), share(at(0.0)), share(at(1.0))),
            format!("{} of {}", of(self.invented, self.others), self.others),
            times(&mut self.seconds),
        ]
    }
}

/// A scan in memory, and where a pawn stands in it.
struct Ground {
    store: Snapshot,
    pawn: Pawn,
    standing: StandingPlaces,
}

impl Ground {
    fn spot(&mut self, at: Point3<f64>) -> Result<Option<PlaceId>> {
        spot(&self.store, &mut self.standing, at.into())
    }

    /// The largest of the regions around some random places.
    fn largest(&mut self, places: &[Point3<f64>], random: &mut Random) -> Result<Region> {
        let mut largest: Option<Region> = None;
        for _ in 0..STARTS {
            let from = places[(random.bits() % places.len().max(1) as u64) as usize];
            let start = self.spot(from)?.ok_or("a place is none")?;
            if largest.as_ref().is_some_and(|largest| largest.holds(&start)) {
                continue;
            }
            let region = reached(&self.store, &mut self.standing, start)?;
            if largest.as_ref().is_none_or(|largest| region.area_m2() > largest.area_m2()) {
                largest = Some(region);
            }
        }
        largest.ok_or_else(|| "nowhere to stand".into())
    }

    /// Pairs in the region, and half as many that lead out of it.
    fn pairs(&mut self, region: &Region, all: &[Point3<f64>], count: usize, random: &mut Random) -> Result<Vec<Pair>> {
        let places: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        let (mut search, mut pairs) = (Search::new(), Vec::new());
        let mut one_of = |places: &[Point3<f64>]| places[(random.bits() % places.len() as u64) as usize];
        while pairs.len() < count {
            let ends = [0; 2].map(|_| one_of(&places));
            let [Some(from), Some(to)] = [self.spot(ends[0])?, self.spot(ends[1])?] else { continue };
            let route = super::known(search.route(&self.store, region, &from, &to, &NoMonitor)?)?
                .ok_or("a region without a way")?;
            pairs.push(Pair { ends, spots: [from, to], length_m: Some(route.length_m) });
        }
        let mut tries = 0;
        while pairs.len() < count + count / 2 && tries < 100 * count {
            tries += 1;
            let ends = [one_of(&places), one_of(all)];
            let [Some(from), Some(to)] = [self.spot(ends[0])?, self.spot(ends[1])?] else { continue };
            if !region.holds(&to) {
                pairs.push(Pair { ends, spots: [from, to], length_m: None });
            }
        }
        Ok(pairs)
    }

    /// A way on a level, whether the level is fine, and the processor time that it took (s).
    fn guess(&mut self, level: &Snapshot, pair: &Pair) -> Result<(Option<Guess>, bool, f64)> {
        let start = processor_s();
        let mut planner = Coarse::new(level, self.pawn, pair.ends[0], pair.ends[1])?;
        let planned = planner.advance(level, usize::MAX, &NoMonitor)?;
        let seconds = processor_s() - start;
        let route = match planned {
            Planned::Done(found) => found.ok(),
            _ => return Err("a store without a page".into()),
        };
        let is_fine = planner.is_fine();
        let Some(route) = route else { return Ok((None, is_fine, seconds)) };
        let mut holds = false;
        if pair.length_m.is_some() {
            let line: Vec<Point2<f64>> = route.points.iter().map(|point| point.xy()).collect();
            let mut flood = Flood::from(pair.spots[0]);
            flood.along(&line, BESIDE * level.frame().pixel_m());
            known(flood.grow(&mut self.standing, &self.store, &NoMonitor)?)?;
            holds = flood.holds(&self.standing, &pair.spots[1]);
        }
        Ok((Some(Guess { route, doubt_m: planner.doubt_m(), holds }), is_fine, seconds))
    }
}

/// The table, as a page.
pub fn page(effort: &Effort) -> Result<String> {
    let mut table = Table::new([
        "scan",
        "pixel (m)",
        "level",
        "its pixel (m)",
        "pairs",
        "found",
        "of these without doubt",
        "an exact way within 3 pixels",
        "length: median, least, greatest share of the exact one",
        "found where no way leads",
        "median, 99 %, greatest time (ms)",
    ]);
    for (name, file, unit_m, pixel_m, height) in SCANS.iter().filter(|scan| effort.takes(scan.0)) {
        let Some(path) = data::file(file) else { continue };
        let folder = tempfile::tempdir()?;
        let mut options = ConvertOptions::new(vec![path], folder.path().join("scene.slices"));
        options.grid.pixel = PixelSize::Metres(*pixel_m);
        options.reading.units = Units::Factor(*unit_m);
        options.sections.levels = true;
        let archive = archive(options, folder.path())?;
        let store = Snapshot::resident(&archive, &NoMonitor)?;
        let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: *height });
        let (standing, region) = everywhere(&store, pawn)?;
        let places: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        drop(region);
        let mut ground = Ground { store, pawn, standing };
        let mut random = Random(71);
        let mut region = ground.largest(&places, &mut random)?;
        region.prepare(&NoMonitor)?;
        let pairs = ground.pairs(&region, &places, effort.of(300, 30), &mut random)?;
        drop(region);
        let levels = archive.levels()?;
        // By pair the way on the coarsest level that leaves no doubt, else on the finest, and the time of all that were asked.
        let mut chosen: Vec<(Option<Guess>, f64)> = pairs.iter().map(|_| (None, 0.0)).collect();
        let mut rows = Vec::new();
        for level in levels.iter().filter(|level| level.frame().pixel_m() <= COARSEST_M).rev() {
            let on_level = Snapshot::resident(&archive.level(level.number())?, &NoMonitor)?;
            let mut tally = Tally::default();
            for (pair, chosen) in pairs.iter().zip(&mut chosen) {
                let (guess, is_fine, seconds) = ground.guess(&on_level, pair)?;
                tally.add(pair, guess.as_ref(), seconds, *pixel_m);
                if chosen.0.as_ref().is_none_or(|chosen| chosen.doubt_m > 0.0) {
                    chosen.1 += seconds;
                    let before = chosen.0.take().filter(|_| !is_fine);
                    chosen.0 = guess.or(before);
                }
            }
            rows.push((level.number().to_string(), number(level.frame().pixel_m(), 1), tally));
        }
        let mut tally = Tally::default();
        for (pair, (guess, seconds)) in pairs.iter().zip(&chosen) {
            tally.add(pair, guess.as_ref(), *seconds, *pixel_m);
        }
        rows.push(("all".into(), "–".into(), tally));
        for (level, level_m, tally) in rows {
            table.row([(*name).to_owned(), number(*pixel_m, 2), level, level_m].into_iter().chain(tally.row()));
        }
    }
    Ok(format!("{}\n{}\n", include_str!("levels.head.md"), table.markdown()))
}
