//! Lifts and stairs of `--edits`: regions that they join, and routes that use them.

use crate::edits::Link;
use crate::ground::{Loader, Walks};
use crate::{Failure, Quiet};
use nalgebra::Point3;
use slicewalk::reach::{Flood, LongSearch, PlaceId, Region, Route, Search, Snapped, StandingPlaces};

/// Speed at which the time of a way counts (m/s).
const SPEED_M_S: f64 = 1.4;

/// Places that a pawn reaches on foot and by links.
pub struct Joined {
    pub flood: Flood,
    pub region: Region,
    doors: Vec<Door>,
    /// Length of a long pawn (m).
    length: Option<f64>,
}

/// A direction of a link of which the pawn can use both ends.
struct Door {
    /// Number of the link.
    link: usize,
    from: PlaceId,
    to: PlaceId,
}

/// A way that may use links.
pub struct Way {
    /// Places to reach in turn (m). A link is a step from one end to the other.
    pub points: Vec<Point3<f64>>,
    /// Length on foot (m).
    pub length_m: f64,
    /// Time on foot at 1.4 m/s and in links (s).
    pub seconds: f64,
    /// Names of the links, in turn.
    pub links: Vec<String>,
    /// Heading of a long pawn at each point (degrees clockwise from +y); empty for other pawns.
    pub headings: Vec<f64>,
}

impl Way {
    /// A way on foot.
    pub fn on_foot(Route { points, length_m, headings, .. }: Route) -> Self {
        Self { points, length_m, seconds: length_m / SPEED_M_S, links: Vec::new(), headings }
    }

    /// The sum of the turns of a long pawn (degrees). In a link its heading is free.
    pub fn turned_deg(&self) -> f64 {
        let pairs = self.points.windows(2).zip(self.headings.windows(2));
        let turns = pairs.filter(|(points, _)| points[0] == points[1]);
        // The sum of nothing is -0.
        0.0 + turns.map(|(_, pair)| ((pair[1] - pair[0] + 180.0).rem_euclid(360.0) - 180.0).abs()).sum::<f64>()
    }

    /// A way that has not begun.
    fn empty() -> Self {
        Self { points: Vec::new(), length_m: 0.0, seconds: 0.0, links: Vec::new(), headings: Vec::new() }
    }
}

impl Joined {
    /// Finds everything that can be reached from `start`. Links at whose ends the pawn cannot stand are reported and
    /// left out.
    pub fn from(
        loader: &Loader,
        walks: &Walks,
        standing: &mut StandingPlaces,
        start: &Snapped,
        links: &[Link],
    ) -> Result<Self, Failure> {
        let (mut doors, length) = (Vec::new(), walks.length()?);
        for (number, link) in links.iter().enumerate() {
            let mut spots = Vec::new();
            for end in link.ends {
                match walks.snapped(loader, standing, end)? {
                    Some(snapped) => spots.push(snapped.spot),
                    None => crate::say(&format!(
                        "link {:?} is left out: the pawn cannot stand at {},{},{} ({})",
                        link.name,
                        end.x,
                        end.y,
                        end.z,
                        walks.nowhere_near()
                    )),
                }
            }
            if let [from, to] = spots[..] {
                doors.push(Door { link: number, from, to });
                if !link.is_one_way {
                    doors.push(Door { link: number, from: to, to: from });
                }
            }
        }
        let (mut flood, mut seeds) = (Flood::from(start.spot), vec![start.spot]);
        loop {
            loader.known(|view| flood.grow(standing, view, &Quiet))?;
            let mut region = flood.region(standing);
            region.keep_linked(standing, &seeds);
            if let Some(length) = length {
                let reached = LongSearch::new(&region, length)?.reached(&seeds, &Quiet)?;
                region.keep_reached(standing, &reached);
            }
            let more: Vec<PlaceId> = doors
                .iter()
                .filter(|door| region.stands_at(&door.from) && !region.stands_at(&door.to))
                .map(|door| door.to)
                .filter(|to| !seeds.contains(to))
                .collect();
            if more.is_empty() {
                return Ok(Self { flood, region, doors, length });
            }
            for spot in more {
                flood.add(spot);
                seeds.push(spot);
            }
        }
    }

    /// Memory of the region and its flood (bytes).
    pub fn memory_bytes(&self) -> usize {
        // A long pawn has a byte for the places around each place, and one for its headings there.
        let headings = self.length.map_or(0, |_| 2 * self.region.len());
        self.flood.memory_bytes() + self.region.memory_bytes() + headings
    }

    /// Returns the way of least time from one place to another; `None` if there is none.
    pub fn way(&self, loader: &Loader, [from, to]: [&Snapped; 2], links: &[Link]) -> Result<Option<Way>, Failure> {
        let mut search = Search::new();
        let mut long = self.length.map(|length| LongSearch::new(&self.region, length)).transpose()?;
        let mut leg = |from: &PlaceId, to: &PlaceId| -> Result<Option<Way>, Failure> {
            let route = loader.known(|view| match &mut long {
                Some(long) => long.route(view, from, to, &Quiet),
                None => search.route(view, &self.region, from, to, &Quiet),
            })?;
            Ok(route.map(Way::on_foot))
        };
        if self.doors.is_empty() {
            return leg(&from.spot, &to.spot);
        }
        // Dijkstra's algorithm: place 0 is the start, place n + 1 lies behind door n.
        let count = self.doors.len() + 1;
        let mut best: Vec<Option<Way>> = (0..count).map(|_| None).collect();
        best[0] = Some(Way::empty());
        let mut done = vec![false; count];
        let mut found: Option<Way> = None;
        loop {
            let time = |place: usize| best[place].as_ref().map_or(f64::INFINITY, |way| way.seconds);
            let next = (0..count).filter(|place| !done[*place] && best[*place].is_some());
            let Some(place) = next.min_by(|a, b| time(*a).total_cmp(&time(*b))) else { return Ok(found) };
            if found.as_ref().is_some_and(|found| found.seconds <= time(place)) {
                return Ok(found);
            }
            done[place] = true;
            let here = if place == 0 { from.spot } else { self.doors[place - 1].to };
            let longer = |more: Way| {
                let way = best[place].as_ref()?;
                Some(Way {
                    points: way.points.iter().chain(&more.points).copied().collect(),
                    length_m: way.length_m + more.length_m,
                    seconds: way.seconds + more.seconds,
                    links: way.links.iter().chain(&more.links).cloned().collect(),
                    headings: way.headings.iter().chain(&more.headings).copied().collect(),
                })
            };
            if let Some(way) = leg(&here, &to.spot)?.and_then(longer)
                && found.as_ref().is_none_or(|found| way.seconds < found.seconds)
            {
                found = Some(way);
            }
            let mut offers = Vec::new();
            for (number, door) in self.doors.iter().enumerate().filter(|(number, _)| !done[number + 1]) {
                let Some(mut way) = leg(&here, &door.from)?.and_then(longer) else { continue };
                let link = &links[door.link];
                way.seconds += link.seconds;
                way.links.push(link.name.clone());
                offers.push((number + 1, way));
            }
            for (at, way) in offers {
                if best[at].as_ref().is_none_or(|best| way.seconds < best.seconds) {
                    best[at] = Some(way);
                }
            }
        }
    }
}
