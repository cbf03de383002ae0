//! Pawn options and page loading, shared by `reach`, `route` and `export`.

use crate::edits::EditOption;
use crate::nearest::nearest;
use crate::{Failure, Quiet};
use nalgebra::Point3;
use slicewalk::Parameter;
use slicewalk::archive::Archive;
use slicewalk::frame::PageKey;
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, LongSearch, Pawn, Snapped, StandingPlaces};
use slicewalk::seen::SeenSpace;
use slicewalk::store::{MISSING_KEYS, Missing, Prefetch, Snapshot, Stream, StreamOptions};
use slicewalk::walk::Body;
use slicewalk_base::text::finite_number;
use slicewalk_convert::size::parse_size;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A kind of visitor: defaults of the pawn's options.
#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
pub enum Profile {
    /// A pedestrian.
    Foot,
    /// A wheelchair.
    Wheelchair,
    /// A stroller.
    Stroller,
}

impl Profile {
    /// The pawn of this profile.
    pub fn pawn(self) -> Pawn {
        let any = f64::INFINITY;
        let (body, climb, max_grade, max_ramp) = match self {
            Self::Foot => (Body::Box { x: 0.5, y: 0.5, height: 1.8 }, 0.35, any, any),
            Self::Wheelchair => (Body::Cylinder { radius: 0.4, height: 1.4 }, 0.02, 0.06, 6.0),
            Self::Stroller => (Body::Cylinder { radius: 0.3, height: 1.2 }, 0.08, 0.12, any),
        };
        Pawn { climb, max_drop: climb, max_grade, max_ramp, ..Pawn::new(body) }
    }

    /// Length of the pawn where its headings count (m); `None` if it is as long as wide.
    fn length(self) -> Option<f64> {
        match self {
            Self::Foot => None,
            Self::Wheelchair => Some(1.2),
            Self::Stroller => Some(1.0),
        }
    }
}

/// Options of the pawn, and of where it starts and ends.
#[derive(clap::Args)]
pub struct Walks {
    #[command(flatten)]
    pawns: Pawns,
    /// Length of a pawn that is longer than wide (m): a cylinder drawn out to this length, which drives along its heading
    /// and turns on the spot [default: of the profile, 1.2 of a wheelchair and 1 of a stroller, unless --pawn is given]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, value_parser = finite_number)]
    length: Option<f64>,
    #[command(flatten)]
    snap: Snap,
}

/// Options of the pawn.
#[derive(clap::Args)]
pub struct Pawns {
    /// Whose pawn, steps and grades count: those of foot are box:0.5x0.5x1.8 and 0.35 m; of a wheelchair
    /// cylinder:0.4x1.4, 0.02 m and 6 %, with a landing every 6 m; of a stroller cylinder:0.3x1.2, 0.08 m and 12 %
    #[arg(long, value_enum, default_value_t = Profile::Foot)]
    profile: Profile,
    /// The pawn: box:WIDTHxDEPTHxHEIGHT or cylinder:RADIUSxHEIGHT (m) [default: of the profile]
    #[arg(long, value_name = "SHAPE")]
    pawn: Option<Body>,
    /// Highest step the pawn climbs (m) [default: of the profile]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, value_parser = finite_number)]
    climb: Option<f64>,
    /// Steepest ground that the pawn walks on, over a metre (percent) [default: of the profile]
    #[arg(long, value_name = "PERCENT", allow_negative_numbers = true, value_parser = above_zero)]
    max_grade: Option<f64>,
    /// Longest ramp from one landing to the next (m): no ground steeper than 3 % is used that is farther than half of this
    /// from ground that rises by at most 3 % over 1.5 m [default: of the profile, 6 of a wheelchair]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, value_parser = above_zero)]
    max_ramp: Option<f64>,
    /// Deepest drop the pawn takes (m) [default: the climb height, so that the pawn gets back]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, value_parser = finite_number)]
    max_drop: Option<f64>,
    #[command(flatten)]
    variant: crate::Variant,
    /// Stay where a scanner saw the middle of the pawn, from the climb height, or three slices above the floor, to the head (`sliceconv --free-space`)
    #[arg(long)]
    seen: bool,
    /// Memory for pages, and as much again for seen space
    #[arg(long, default_value = "64MiB", value_name = "SIZE", value_parser = parse_size)]
    cache: u64,
}

/// Option `--snap`.
#[derive(clap::Args)]
pub struct Snap {
    /// Move a start or end where the pawn cannot stand to the nearest place where it can, at most this far (m)
    #[arg(id = "snap", long = "snap", default_value_t = 0.5, value_name = "METRES", allow_negative_numbers = true, value_parser = snap_m)]
    pub metres: f64,
}

fn snap_m(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| (0.0..=100.0).contains(v));
    value.ok_or_else(|| "expected 0 to 100 m".into())
}

/// Start or end of a route in JSON.
pub fn end_json(feet: Point3<f64>, moved: f64) -> serde_json::Value {
    let [x, y, z, moved] = [feet.x, feet.y, feet.z, moved].map(tidy);
    serde_json::json!({ "x": x, "y": y, "z": z, "moved": moved })
}

/// Rounds a length or an area to a millionth, to drop the rounding errors of sums.
pub fn tidy(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

impl Pawns {
    /// Opens the archive.
    pub fn open(&self, archive: &Path) -> Result<Archive, Failure> {
        self.variant.open_for_pawns(archive)
    }

    /// The edits.
    pub fn edits(&self) -> &EditOption {
        self.variant.edits()
    }

    /// Makes a loader of the archive, which knows its seen space if the pawn must stay in it.
    pub fn loader(&self, archive: Archive, path: &Path) -> Result<Loader, Failure> {
        let seen = match self.seen {
            true => Some(seen_space(&archive, path, self.cache, Parameter::Cache)?),
            false => None,
        };
        Ok(Loader { seen, ..Loader::new(archive, path, self.cache)? })
    }

    /// True if the pawn must stay in seen space.
    pub fn needs_seen(&self) -> bool {
        self.seen
    }

    /// The option that overview levels cannot follow, if one was given.
    pub fn unknown_to_levels(&self) -> Option<&'static str> {
        let given = [
            (self.max_grade.is_some(), "max-grade"),
            (self.max_ramp.is_some(), "max-ramp"),
            (self.variant.ignore_inferred, "ignore-inferred"),
        ];
        given.into_iter().find(|(is_given, _)| *is_given).map(|(_, option)| option)
    }

    /// Memory for pages (bytes).
    pub fn cache(&self) -> u64 {
        self.cache
    }

    /// The pawn in the library's type.
    pub fn pawn(&self) -> Pawn {
        let mut pawn = self.profile.pawn();
        pawn.body = self.pawn.unwrap_or(pawn.body);
        pawn.climb = self.climb.unwrap_or(pawn.climb);
        pawn.max_drop = self.max_drop.unwrap_or(pawn.climb);
        pawn.max_grade = self.max_grade.map_or(pawn.max_grade, |percent| percent / 100.0);
        pawn.max_ramp = self.max_ramp.unwrap_or(pawn.max_ramp);
        pawn
    }
}

impl std::ops::Deref for Walks {
    type Target = Pawns;

    fn deref(&self) -> &Pawns {
        &self.pawns
    }
}

impl Walks {
    /// The length of a long pawn (m): of `--length`, or of the profile if its pawn is used. Refuses what no pawn can have.
    pub fn length(&self) -> Result<Option<f64>, Failure> {
        let Some(length) = self.length else {
            return Ok(self.pawns.profile.length().filter(|_| self.pawns.pawn.is_none()));
        };
        match self.pawn().body {
            Body::Cylinder { radius, .. } if length >= 2.0 * radius => Ok(Some(length)),
            Body::Cylinder { radius, .. } => {
                let text = format!("--length {length}: the pawn is {} m wide; give at least that", 2.0 * radius);
                Err(Failure::Usage(text))
            }
            Body::Box { .. } => {
                let text = "only a cylinder can be drawn out; give --pawn cylinder:RADIUSxHEIGHT or a --profile";
                Err(Failure::Usage(format!("--length {length}: {text}")))
            }
        }
    }

    /// True if the length was given as an option.
    pub fn has_length(&self) -> bool {
        self.length.is_some()
    }

    /// Finds the standing place at `at` or near it. A long pawn must have room there in some heading.
    pub fn snapped(
        &self,
        loader: &Loader,
        standing: &mut StandingPlaces,
        at: Point3<f64>,
    ) -> Result<Option<Snapped>, Failure> {
        let snapped = loader.known(|view| standing.snapped(view, at, self.snap.metres))?;
        match (snapped, self.length()?) {
            (Some(snapped), Some(length)) => self.with_room(loader, standing, at, snapped, length),
            (snapped, _) => Ok(snapped),
        }
    }

    /// Finds the place nearest to `at` on the ground around `near` where a long pawn has room in some heading.
    fn with_room(
        &self,
        loader: &Loader,
        standing: &mut StandingPlaces,
        at: Point3<f64>,
        near: Snapped,
        length: f64,
    ) -> Result<Option<Snapped>, Failure> {
        let mut flood = Flood::from(near.spot);
        flood.within([at.xy(); 2], 2.0 * (self.snap.metres + length + AROUND_M));
        loader.known(|view| flood.grow(standing, view, &Quiet))?;
        let region = flood.region(standing);
        let mut search = LongSearch::new(&region, length)?;
        if search.stands_at(&near.spot) {
            return Ok(Some(near));
        }
        // In the air, the floor below counts.
        let from = Point3::new(at.x, at.y, at.z.min(near.feet.z));
        let far = |feet: &Point3<f64>| (feet - from).norm();
        let mut others: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        others.retain(|feet| far(feet) <= self.snap.metres);
        others.sort_by(|a, b| far(a).total_cmp(&far(b)));
        for feet in others {
            let found = loader.known(|view| standing.snapped(view, feet, 0.0))?;
            if let Some(mut found) = found.filter(|found| search.stands_at(&found.spot)) {
                found.moved = far(&feet);
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    /// Describes in words how far a place may be moved.
    pub fn nowhere_near(&self) -> String {
        match self.snap.metres {
            0.0 => "expected floor below it and room for its whole body".to_owned(),
            metres => format!("expected floor below it and room for its whole body, there or within --snap {metres} m"),
        }
    }
}

/// Parses a number above 0.
pub fn above_zero(text: &str) -> Result<f64, String> {
    finite_number(text).ok().filter(|value| *value > 0.0).ok_or_else(|| "expected a number above 0".into())
}

/// Ground around a place that decides on its grade (m).
const AROUND_M: f64 = 2.0;
/// Queries near one place after which more pages are loaded than those reported missing.
const MANY: u32 = 16;
/// How often one question may restart with the same page before the cache counts as too small: it restarts for a tile
/// around the page, or for a walker that comes by, and a route is searched up to 128 times.
const AGAIN: u32 = 1 << 9;

/// Pages that one question has missed.
#[derive(Default)]
struct Missed {
    /// Those that stay in memory together.
    kept: Vec<PageKey>,
    /// How often each page was among those with which `kept` restarted.
    again: HashMap<PageKey, u32>,
    /// Where it missed pages last.
    place: Option<Place>,
}

/// A tile column, with the loads for it and its neighbours.
struct Place {
    column: [i32; 2],
    asked: u32,
    /// False once pages had to be evicted for others near it.
    has_room: bool,
}

impl Place {
    fn is_near(&self, key: PageKey) -> bool {
        let [tx, ty] = self.column;
        tx.abs_diff(key.tx) <= 1 && ty.abs_diff(key.ty) <= 1
    }
}

/// Reads the seen space of an archive, if it has any, into at most `most_bytes` of memory. If that is too little, the
/// failure names what helps, `way_out`.
pub fn stored_seen(
    archive: &Archive,
    path: &Path,
    most_bytes: u64,
    way_out: Parameter,
) -> Result<Option<SeenSpace>, Failure> {
    archive.seen_space(most_bytes).map_err(|error| match error {
        slicewalk::Error::Limit { .. } => crate::broken(path, &error.with_suggestion(way_out)),
        _ => crate::broken(path, &error),
    })
}

/// Like [`stored_seen`], and fails if the archive has none.
pub fn seen_space(
    archive: &Archive,
    path: &Path,
    most_bytes: u64,
    way_out: Parameter,
) -> Result<Arc<SeenSpace>, Failure> {
    let seen = stored_seen(archive, path, most_bytes, way_out)?;
    seen.map(Arc::new).ok_or_else(|| {
        let suggestion = "convert the scan with --free-space";
        Failure::Text(format!("{}: it does not say which space was seen; {suggestion}", path.display()))
    })
}

/// Loads pages as queries need them.
pub struct Loader {
    stream: Stream,
    archive: PathBuf,
    /// Memory for pages (bytes).
    cache: u64,
    /// Space in which the pawn must stay.
    seen: Option<Arc<SeenSpace>>,
    /// Seen space, where it only matters for what is reported.
    known: Option<Arc<SeenSpace>>,
}

impl Loader {
    /// Loads from an archive at `path` into a cache of `cache` bytes.
    pub fn new(archive: Archive, path: &Path, cache: u64) -> Result<Self, Failure> {
        let budget = usize::try_from(cache).unwrap_or(usize::MAX);
        let options = StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(budget) };
        let stream = Stream::open(archive, options).map_err(|error| crate::broken(path, &error))?;
        Ok(Self { stream, archive: path.to_path_buf(), cache, seen: None, known: None })
    }

    /// The pages in memory now.
    pub fn snapshot(&self) -> Snapshot {
        self.stream.snapshot()
    }

    /// Reads the seen space of the archive, if it has any, into as much memory again as the cache has.
    pub fn knowing_seen(self) -> Result<Self, Failure> {
        let known = stored_seen(self.archive(), &self.archive, self.cache, Parameter::Cache)?;
        Ok(Self { known: known.map(Arc::new), ..self })
    }

    /// The seen space that was read.
    pub fn known_seen(&self) -> Option<&SeenSpace> {
        self.known.as_deref()
    }

    /// The standing places of a pawn.
    pub fn standing(&self, pawn: Pawn) -> slicewalk::Result<StandingPlaces> {
        Ok(StandingPlaces::new(&self.snapshot(), pawn)?.within_seen(self.seen.clone()))
    }

    /// Space in which the pawn must stay, if any.
    pub fn seen(&self) -> Option<&Arc<SeenSpace>> {
        self.seen.as_ref()
    }

    /// The archive.
    pub fn archive(&self) -> &Archive {
        self.stream.archive()
    }

    /// Path of the archive.
    pub fn path(&self) -> &Path {
        &self.archive
    }

    /// Repeats `ask` and loads the missing pages until it gives an answer. Fails if the pages of one of its steps do not fit
    /// in the cache at once.
    pub fn known<T>(&self, mut ask: impl FnMut(&Snapshot) -> slicewalk::Result<Answer<T>>) -> Result<T, Failure> {
        let mut missed = Missed::default();
        loop {
            crate::go_on()?;
            // A statement of its own: the snapshot would keep evicted pages in memory.
            let answer = ask(&self.stream.snapshot()).map_err(|error| self.broken(&error))?;
            match answer {
                Answer::Known(known) => return Ok(known),
                Answer::NotLoaded(missing) => self.load(&missing, &mut missed)?,
            }
        }
    }

    /// Loads `missing` pages. A step of a question needs all of its pages at once and does not say when it is done, so those
    /// that the question missed before stay until they no longer fit.
    fn load(&self, missing: &Missing, missed: &mut Missed) -> Result<(), Failure> {
        let (keys, around) = (missing.keys(), missing.keys()[0]);
        let broken = |error| self.broken(&error);
        let load = |keys: &[PageKey]| self.stream.load(keys, around).map_err(broken);
        let here = match &mut missed.place {
            Some(here) if here.is_near(around) => here,
            other => other.insert(Place { column: [around.tx, around.ty], asked: 0, has_room: true }),
        };
        here.asked += 1;
        let mut evicted = 0;
        if here.asked > MANY && here.has_room {
            // In a tall column, load more of it each time.
            let most = MISSING_KEYS << (here.asked - MANY).min(24);
            let others = nearest(self.archive(), around, most, |key| here.is_near(key)).map_err(broken)?;
            let report = load(&[keys, &others].concat())?;
            here.has_room = report.left_out == 0 && report.evicted == 0;
            evicted = report.evicted;
        }
        missed.kept.extend(keys);
        let mut report = load(keys)?;
        if report.left_out > 0 || evicted + report.evicted > 0 && !self.holds(&missed.kept) {
            report = load(&missed.kept)?;
        }
        if report.left_out == 0 {
            return Ok(());
        }
        // Pages of earlier steps are among them, or this step does not fit.
        missed.kept = keys.to_vec();
        let alone = load(keys)?;
        if alone.left_out > 0 {
            return Err(self.too_small(alone.needed_bytes));
        }
        for key in keys {
            let again = missed.again.entry(*key).or_default();
            *again += 1;
            if *again > AGAIN {
                return Err(self.too_small(report.needed_bytes));
            }
        }
        Ok(())
    }

    fn holds(&self, keys: &[PageKey]) -> bool {
        let view = self.snapshot();
        keys.iter().all(|key| view.is_loaded(*key) == Some(true))
    }

    fn too_small(&self, needed_bytes: usize) -> Failure {
        crate::cache_too_small("one place", self.cache, needed_bytes)
    }

    fn broken(&self, error: &slicewalk::Error) -> Failure {
        crate::broken(&self.archive, error)
    }

    /// Peak bytes of pages and of the table of pages.
    pub fn memory_bytes(&self) -> usize {
        let counters = self.stream.counters();
        counters.peak_bytes + counters.table_bytes
    }
}
