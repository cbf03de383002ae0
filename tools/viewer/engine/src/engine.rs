//! The worker's interface: one archive, its loader, pawns and scenes, addressed by numbers.

use crate::batch::{self, Lacks};
use crate::colours::Colours;
use crate::crowd::Company;
use crate::facts;
use crate::fault::{self, invalid};
use crate::geometry::Geometry;
use crate::map::{columns, map};
use crate::messages::{ActionCode, ActionMessage, PageMessage, PaintMessage, RouteCode, StatsMessage};
use crate::named::{Moving, Named};
use crate::outline::{self, Outline};
use crate::paint::Paint;
use crate::pawn::{Input, Pawn, Settings};
use crate::routes::{Routed, Routing};
use crate::scene::{HORIZON_S, Part, Scenes};
use crate::slide::slide;
use slicewalk::archive::Catalog;
use slicewalk::frame::{Frame, PAGE_SLICES, PageKey, TILE_PIXELS};
use slicewalk::nalgebra::Point3;
use slicewalk::store::{Decode, FetchId, Loader, LoaderOptions, Next, Payload, RequestId, Snapshot, Time};
use std::collections::VecDeque;
use std::time::Duration;
use wasm_bindgen::prelude::wasm_bindgen;

/// Most bytes of one request for pages, few enough that decoding them never delays a step for long.
const RUN_BYTES: usize = 128 << 10;

/// Budget of an overview level beyond the main budget: this fraction of it, but at least this many bytes.
const OUTLINE_SHARE: f64 = 1.0 / 4.0;
const OUTLINE_LEAST: f64 = 4e6;
/// An overview level is fetched before pages that are needed later than this.
const OUTLINE_BEFORE: Duration = Duration::from_secs(1);

/// Most columns of pages that [`Engine::page_boxes`] visits.
const MOST_COLUMNS: usize = 10_000;

/// One open archive.
#[wasm_bindgen]
pub struct Engine {
    loader: Loader,
    /// Fetches in flight, with the loaders that requested them.
    fetches: Named<(Part, FetchId)>,
    decodes: VecDeque<(Part, Decode)>,
    reports: VecDeque<String>,
    requests: Named<RequestId>,
    lacks: Lacks,
    pawns: Named<Moving<Pawn>>,
    routes: Named<Routing>,
    crowds: Named<Company>,
    scenes: Named<Moving<Scenes>>,
    outline: Distant,
    outline_budget: usize,
    names: u32,
    loaded: u64,
    drawn: Option<(u32, PageKey, u32, Geometry)>,
    colours: Colours,
    painted: Option<Paint>,
}

/// State of the overview level, with its fetch by name.
enum Distant {
    /// Not needed until a camera looks.
    Later,
    Wanted,
    Asked(u32),
    Here(Box<Outline>),
    /// The archive has no level.
    Never,
}

#[wasm_bindgen]
impl Engine {
    /// Opens an archive of `file_len` bytes (NaN: unknown) under a budget of bytes and of concurrent requests.
    #[wasm_bindgen(constructor)]
    pub fn new(file_len: f64, budget: f64, requests: u32) -> Engine {
        let horizon = Duration::from_secs_f64(HORIZON_S);
        let budget = budget.clamp(0.0, 4e9);
        let outline_budget = Some(budget * OUTLINE_SHARE).filter(|share| *share >= OUTLINE_LEAST).unwrap_or(0.0);
        let options = LoaderOptions {
            horizon_min: horizon,
            horizon_max: horizon,
            run_bytes: RUN_BYTES,
            fetches: requests.clamp(1, 64) as usize,
            ..LoaderOptions::new(budget as usize)
        };
        let file_len = (file_len >= 0.0).then_some(file_len as u64);
        Engine {
            loader: Loader::open(file_len, options),
            fetches: Named::NONE,
            decodes: VecDeque::new(),
            reports: VecDeque::new(),
            requests: Named::NONE,
            lacks: Lacks::default(),
            pawns: Named::NONE,
            routes: Named::NONE,
            crowds: Named::NONE,
            scenes: Named::NONE,
            outline: if outline_budget > 0.0 { Distant::Later } else { Distant::Never },
            outline_budget: outline_budget as usize,
            names: 0,
            loaded: 0,
            drawn: None,
            colours: Colours::default(),
            painted: None,
        }
    }

    // Streaming ----------------------------------------------------------------------------------------------------------------

    /// Returns the next actions as numbers of [`ActionMessage`]s; the last one waits. Fails while the archive cannot be
    /// opened.
    pub fn poll(&mut self, now_ms: f64) -> Result<Vec<f64>, String> {
        // Pages with the content of resident ones arrive without a fetch.
        let resident = |loader: &Loader| (loader.counters().resident_pages, loader.counters().evicted);
        let before = resident(&self.loader);
        let todo = self.todo(time(now_ms));
        if resident(&self.loader) != before {
            self.scenes.0.iter_mut().for_each(|(_, scene)| scene.thing.pages_changed());
        }
        todo
    }

    fn todo(&mut self, now: Time) -> Result<Vec<f64>, String> {
        let mut todo = Vec::new();
        let is_fetched = matches!(self.outline, Distant::Wanted | Distant::Asked(_));
        if !is_fetched && self.is_quiet() {
            self.colours.want(&mut self.loader, outline_of(&mut self.outline), &self.scenes);
        }
        let (mut until, is_urgent) = self.ask(Part::Pages, now, &mut todo)?;
        self.ask_outline(&mut todo);
        let waits = is_urgent || self.pawns.things().any(|pawn| pawn.thing.missing().is_some());
        if let Some(far) = outline_of(&mut self.outline).and_then(Outline::loader)
            && waits
        {
            self.colours.give_up(far);
        }
        if waits || self.is_quiet() {
            let (again, _) = self.ask(Part::Level, now, &mut todo)?;
            until = [until, again].into_iter().flatten().min();
        }
        let until = until.map_or(f64::INFINITY, |until| until.as_secs_f64() * 1000.0);
        todo.extend(acting(ActionCode::Wait, 0, until, 0.0));
        Ok(todo)
    }

    /// Returns whether nothing is in flight or to be decoded.
    fn is_quiet(&self) -> bool {
        self.fetches.0.is_empty() && self.decodes.is_empty() && !matches!(self.outline, Distant::Asked(_))
    }

    fn loader_of(&mut self, part: Part) -> Option<&mut Loader> {
        match part {
            Part::Pages => Some(&mut self.loader),
            Part::Level => outline_of(&mut self.outline).and_then(Outline::loader),
        }
    }

    /// Starts and cancels fetches as a loader demands; returns when to ask it again, and whether it began to fetch what
    /// is needed at once.
    fn ask(&mut self, part: Part, now: Time, todo: &mut Vec<f64>) -> Result<(Option<Time>, bool), String> {
        let mut is_urgent = false;
        loop {
            let Some(loader) = self.loader_of(part) else { return Ok((None, false)) };
            match loader.poll(now).map_err(|error| fault::text(&error))? {
                Next::Fetch(fetch) => {
                    let action = match fetch.what {
                        Payload::Colours => ActionCode::FetchColours,
                        _ => ActionCode::Fetch,
                    };
                    is_urgent |= fetch.needed_in.is_zero();
                    if fetch.needed_in > OUTLINE_BEFORE {
                        self.ask_outline(todo);
                    }
                    let name = self.name();
                    self.fetches.insert(name, (part, fetch.id));
                    todo.extend(fetching(action, name, &fetch.range));
                }
                Next::Cancel(id) => {
                    let name = self.fetches.0.iter().find(|(_, other)| *other == (part, id)).map(|(name, _)| *name);
                    if let Some(name) = name {
                        self.fetches.remove(name);
                        todo.extend(acting(ActionCode::Cancel, name, 0.0, 0.0));
                    }
                }
                Next::Report(page) => {
                    let text = fault::text(&page.error);
                    self.reports.push_back(text);
                }
                Next::Wait(until) => return Ok((until, is_urgent)),
            }
        }
    }

    /// Returns why a page could not be loaded, one report at a time; empty if there is none.
    pub fn take_report(&mut self) -> String {
        self.reports.pop_front().unwrap_or_default()
    }

    /// Takes the bytes of a fetch; [`decode`](Self::decode) processes them.
    pub fn given(&mut self, fetch: u32, bytes: Vec<u8>, now_ms: f64) {
        if let Some((part, id)) = self.fetches.remove(fetch) {
            let job = self.loader_of(part).and_then(|loader| loader.given(id, bytes, time(now_ms)));
            self.decodes.extend(job.map(|job| (part, job)));
        } else if matches!(self.outline, Distant::Asked(name) if name == fetch) {
            let outline = self.loader.catalog().map(|catalog| Outline::new(catalog, bytes, self.outline_budget));
            self.outline = self
                .sound(outline.transpose())
                .flatten()
                .map_or(Distant::Never, |outline| Distant::Here(Box::new(outline)));
        }
    }

    /// Notes that a fetch failed; it is requested again later.
    pub fn failed(&mut self, fetch: u32, message: &str, now_ms: f64) {
        let Some((part, id)) = self.fetches.remove(fetch) else { return };
        let error = slicewalk::Error::io("archive", "fetch", std::io::Error::other(message));
        if let Some(loader) = self.loader_of(part) {
            loader.failed(id, error, time(now_ms));
        }
    }

    /// Decodes the bytes of one fetch; returns whether there were any.
    pub fn decode(&mut self, now_ms: f64) -> bool {
        let Some((part, job)) = self.decodes.pop_front() else { return self.decode_outline(time(now_ms)) };
        let decoded = job.run();
        let loaded = self.loader_of(part).map_or(0, |loader| loader.loaded(decoded, time(now_ms)));
        self.loaded += loaded as u64;
        if loaded > 0 {
            self.scenes.0.iter_mut().for_each(|(_, scene)| scene.thing.pages_changed());
        }
        true
    }

    fn decode_outline(&mut self, now: Time) -> bool {
        let Distant::Here(outline) = &mut self.outline else { return false };
        let advanced = outline.advance(now);
        let level = outline.level();
        match self.sound(advanced) {
            Some(advanced) => {
                if advanced && level.is_some() {
                    self.scenes.0.iter_mut().for_each(|(_, scene)| scene.thing.overview(level));
                }
                advanced
            }
            None => {
                self.outline = Distant::Never;
                false
            }
        }
    }

    /// Reports levels that cannot be read; pages load without them.
    fn sound<T>(&mut self, result: slicewalk::Result<T>) -> Option<T> {
        result.inspect_err(|error| self.reports.push_back(fault::text(error))).ok()
    }

    fn ask_outline(&mut self, todo: &mut Vec<f64>) {
        if !matches!(self.outline, Distant::Wanted) {
            return;
        }
        self.outline = Distant::Never;
        if let Some(range) = self.loader.catalog().and_then(outline::range) {
            let name = self.name();
            self.outline = Distant::Asked(name);
            // Colours come while nothing else is in flight.
            self.colours.give_up(&mut self.loader);
            todo.extend(fetching(ActionCode::Fetch, name, &range));
        }
    }

    /// Returns whether the archive is open, with head and directory loaded.
    pub fn is_open(&self) -> bool {
        self.loader.catalog().is_some() && self.loader.snapshots().is_some()
    }

    /// The fields of the package's `ArchiveInfo` except the name, as JSON.
    pub fn info(&self) -> Result<String, String> {
        Ok(facts::info(self.catalog()?.header()))
    }

    /// Start and end of the metadata (bytes).
    pub fn metadata_range(&self) -> Result<Vec<f64>, String> {
        let range = self.catalog()?.metadata_range();
        Ok(vec![range.start as f64, range.end as f64])
    }

    /// The fields of the package's `ArchiveReference` as JSON, parsed from the bytes of the metadata.
    pub fn reference(&self, metadata: &[u8]) -> Result<String, String> {
        let catalog = self.catalog()?;
        let text = |error| fault::text(&error);
        let (crs, units) = (catalog.decode_crs(metadata).map_err(text)?, catalog.decode_units(metadata).map_err(text)?);
        Ok(facts::reference(&crs, &units))
    }

    /// Numbers of a `StatsMessage`.
    pub fn stats(&self) -> Vec<f64> {
        let counters = self.loader.counters();
        let missing: usize = self.pawns.things().filter_map(|pawn| pawn.thing.missing()).map(|m| m.count()).sum();
        let unbuilt: usize = self.scenes.things().map(|scene| scene.thing.unbuilt()).sum();
        let [used, peak, budget] = self.outline().map_or([0; 3], Outline::bytes);
        let stats = StatsMessage {
            resident_pages: counters.resident_pages as f64,
            resident_bytes: counters.resident_bytes as f64,
            used_bytes: (counters.used_bytes + used) as f64,
            peak_bytes: (counters.peak_bytes + peak) as f64,
            budget_bytes: (counters.budget_bytes + budget) as f64,
            loaded: self.loaded as f64,
            evicted: counters.evicted as f64,
            missing: missing as f64,
            unbuilt: unbuilt as f64,
        };
        stats.numbers().to_vec()
    }

    /// Requests the pages that touch a box (six numbers, min and max); returns the name of the request.
    pub fn load(&mut self, corners: &[f64]) -> Result<u32, String> {
        let &[x0, y0, z0, x1, y1, z1] = corners else { return Err(invalid("a box is six numbers")) };
        if !corners.iter().all(|v| v.is_finite()) || x0 > x1 || y0 > y1 || z0 > z1 {
            return Err(invalid(format_args!("no box lies between ({x0}, {y0}, {z0}) and ({x1}, {y1}, {z1})")));
        }
        let view = self.snapshot()?;
        let (low, high) = (view.frame().slice_of(z0), view.frame().slice_of(z1));
        let mut keys = Vec::new();
        for (tx, ty, slots) in columns(&view, [x0, y0, x1, y1]) {
            let layers = low.div_euclid(PAGE_SLICES)..=high.div_euclid(PAGE_SLICES);
            let slots = slots.iter().filter(|slot| layers.contains(&i64::from(slot.layer())));
            keys.extend(slots.map(|slot| PageKey { tx, ty, layer: slot.layer() }));
        }
        Ok(self.request(&keys))
    }

    /// Requests the pages that batches missed since [`forget_missing`](Self::forget_missing); returns the name of the
    /// request, or 0 if no page was missing.
    pub fn load_missing(&mut self) -> u32 {
        let keys = self.lacks.0.clone();
        if keys.is_empty() { 0 } else { self.request(&keys) }
    }

    /// Forgets the pages that batches missed.
    pub fn forget_missing(&mut self) {
        self.lacks.0.clear();
    }

    /// Number of requested pages that did not fit; NaN while the request is in progress.
    pub fn outcome(&mut self, request: u32) -> Result<f64, String> {
        let Some(id) = self.requests.get_mut(request) else { return Err(invalid("no such request")) };
        match self.loader.outcome(*id) {
            None => Ok(f64::NAN),
            Some(outcome) => {
                self.requests.remove(request);
                outcome.map(|report| report.left_out as f64).map_err(|error| fault::text(&error))
            }
        }
    }

    // Questions ----------------------------------------------------------------------------------------------------------------

    /// Boxes N×6 → 0 clear, 1 hit, 2 not loaded.
    pub fn overlaps(&mut self, boxes: &[f64]) -> Result<Vec<u8>, String> {
        let view = self.snapshot()?;
        batch::overlaps(&view, boxes, &mut self.lacks)
    }

    /// Spheres N×4 → 0 clear, 1 hit, 2 not loaded.
    pub fn spheres(&mut self, spheres: &[f64]) -> Result<Vec<u8>, String> {
        let view = self.snapshot()?;
        batch::spheres(&view, spheres, &mut self.lacks)
    }

    /// Upright cylinders N×5 → 0 clear, 1 hit, 2 not loaded.
    pub fn cylinders(&mut self, cylinders: &[f64]) -> Result<Vec<u8>, String> {
        let view = self.snapshot()?;
        batch::cylinders(&view, cylinders, &mut self.lacks)
    }

    /// Sweeps N×9 → free fraction of the motion; NaN: not loaded.
    pub fn sweep(&mut self, sweeps: &[f64]) -> Result<Vec<f64>, String> {
        let view = self.snapshot()?;
        batch::sweep(&view, sweeps, &mut self.lacks)
    }

    /// Rays N×7 → distance, normal and obstacle, five numbers per ray.
    pub fn cast(&mut self, rays: &[f64]) -> Result<Vec<f64>, String> {
        let view = self.snapshot()?;
        batch::cast(&view, rays, &mut self.lacks)
    }

    /// Rays N×7 → distance, and 1 if it is only a lower bound, from an overview level; two numbers per ray.
    pub fn far(&mut self, rays: &[f64]) -> Result<Vec<f64>, String> {
        let (view, level) = (self.snapshot()?, self.outline().and_then(Outline::snapshot));
        batch::far(&view, level.as_ref(), rays, &mut self.lacks)
    }

    /// Boxes N×6 → highest floor at or below the top; −∞: none, NaN: not loaded.
    pub fn floor(&mut self, boxes: &[f64]) -> Result<Vec<f64>, String> {
        let view = self.snapshot()?;
        batch::floor(&view, boxes, &mut self.lacks)
    }

    /// Moves a box (six numbers), a cylinder (five) or a sphere (four) until it meets solid, and on along it. Returns the
    /// numbers of a `SlideMessage`, and of a `ContactMessage` for each contact.
    pub fn slide(&mut self, shape: &[f64], motion: &[f64], contacts: u32) -> Result<Vec<f64>, String> {
        let view = self.snapshot()?;
        slide(&view, shape, motion, contacts, &mut self.lacks)
    }

    /// Boxes around all solid, six numbers each (min, max): the runs of occupied slices of pages, in memory or not. Of a
    /// large archive, some pages only.
    pub fn page_boxes(&self) -> Result<Vec<f64>, String> {
        let view = self.snapshot()?;
        let frame = view.frame();
        let edge = frame.pixel_m() * TILE_PIXELS as f64;
        let mut boxes = Vec::new();
        for number in (0..view.column_count()).step_by(view.column_count() / MOST_COLUMNS + 1) {
            let (tx, ty, slots) = view.column_at(number);
            let (x, y) = (f64::from(tx) * edge, f64::from(ty) * edge);
            for slot in slots {
                let (mut slices, first) = (slot.slices(), i64::from(slot.layer()) * PAGE_SLICES);
                while slices != 0 {
                    let low = slices.trailing_zeros();
                    let high = low + (slices >> low).trailing_ones();
                    slices &= u64::MAX.checked_shl(high).unwrap_or(0);
                    let bottom = |slice: u32| frame.bottom_of_slice(first + i64::from(slice));
                    boxes.extend([x, y, bottom(low), x + edge, y + edge, bottom(high)]);
                }
            }
        }
        Ok(boxes)
    }

    /// Draws a plan between two heights: width, height and edge of a cell (eight bytes each, as numbers), then one byte
    /// per cell. `area`: minimum x and y, maximum x and y, lowest and highest z.
    pub fn map(&self, area: &[f64], cells: u32) -> Result<Vec<u8>, String> {
        let &[x0, y0, x1, y1, z0, z1] = area else { return Err(invalid("an area is six numbers")) };
        let (width, height, cell, found) = map(&self.snapshot()?, [x0, y0, x1, y1], [z0, z1], cells)?;
        let head = [f64::from(width), f64::from(height), cell].map(f64::to_le_bytes);
        Ok([head.as_flattened(), &found].concat())
    }

    // Pawns --------------------------------------------------------------------------------------------------------------------

    /// Places a pawn at `at` with these settings (see [`Settings::from_numbers`]); returns its name.
    pub fn pawn(&mut self, settings: &[f64], at: &[f64]) -> Result<u32, String> {
        let pawn = Pawn::new(Settings::from_numbers(settings)?, point(at)?)?;
        let body = self.loader.body();
        let name = self.name();
        self.pawns.insert(name, Moving { thing: pawn, body, hinted: None });
        self.hint(name)?;
        Ok(name)
    }

    /// Advances a pawn by a time step; returns the numbers of its state (see [`Pawn::state`]). `input`: numbers of an
    /// `InputMessage`.
    pub fn step(&mut self, pawn: u32, seconds: f64, input: &[f64]) -> Result<Vec<f64>, String> {
        let (view, input) = (self.snapshot()?, Input::from_numbers(input)?);
        self.moving(pawn)?.thing.step(&view, seconds, &input);
        self.hint(pawn)?;
        self.pawn_state(pawn)
    }

    /// State of a pawn.
    pub fn pawn_state(&mut self, pawn: u32) -> Result<Vec<f64>, String> {
        Ok(self.moving(pawn)?.thing.state().numbers().to_vec())
    }

    /// Moves a pawn elsewhere.
    pub fn place(&mut self, pawn: u32, at: &[f64]) -> Result<Vec<f64>, String> {
        let at = point(at)?;
        self.moving(pawn)?.thing.place(at)?;
        self.hint(pawn)?;
        self.pawn_state(pawn)
    }

    /// Begins the route of a pawn to a place (m); returns its name. [`advance_route`](Self::advance_route) finds it.
    pub fn route(&mut self, pawn: u32, to: &[f64]) -> Result<u32, String> {
        let routing = self.moving(pawn)?.thing.routing(pawn, point(to)?)?;
        let name = self.name();
        self.routes.insert(name, routing);
        Ok(name)
    }

    /// Searches a route for some milliseconds. Returns the number of a `RouteCode`; after `NotLoaded`, the name of a
    /// request; after `Found`, the places, three numbers each, which the pawn follows from now on.
    pub fn advance_route(&mut self, route: u32) -> Result<Vec<f64>, String> {
        let view = self.snapshot()?;
        let Some(routing) = self.routes.get_mut(route) else { return Err(invalid("no such route")) };
        let pawn = routing.pawn;
        Ok(match routing.advance(&view)? {
            Routed::Unfinished => vec![RouteCode::Unfinished.into()],
            Routed::Refused(code) => vec![code.into()],
            Routed::NotLoaded(missing) => {
                let request = self.request(missing.keys());
                vec![RouteCode::NotLoaded.into(), f64::from(request)]
            }
            Routed::Found(points) => {
                self.moving(pawn)?.thing.set_route(&points);
                let places = points.iter().flat_map(|point| [point.x, point.y, point.z]);
                std::iter::once(RouteCode::Found.into()).chain(places).collect()
            }
        })
    }

    /// Changes the settings of a pawn.
    pub fn set_pawn(&mut self, pawn: u32, settings: &[f64]) -> Result<Vec<f64>, String> {
        let (view, settings) = (self.snapshot()?, Settings::from_numbers(settings)?);
        self.moving(pawn)?.thing.set(&view, settings)?;
        self.pawn_state(pawn)
    }

    /// Begins to record a pawn; returns where it stands.
    pub fn record(&mut self, pawn: u32) -> Result<Vec<f64>, String> {
        self.moving(pawn)?.thing.record();
        self.pawn_state(pawn)
    }

    /// The steps recorded so far.
    pub fn recorded_steps(&mut self, pawn: u32) -> Result<Vec<f64>, String> {
        Ok(self.moving(pawn)?.thing.recording().0.to_vec())
    }

    /// The feet after each step recorded so far.
    pub fn recorded_path(&mut self, pawn: u32) -> Result<Vec<f64>, String> {
        Ok(self.moving(pawn)?.thing.recording().1.to_vec())
    }

    /// Places walkers that keep out of each other, three numbers each, with the same settings; returns the name of the
    /// crowd.
    pub fn crowd(&mut self, settings: &[f64], places: &[f64]) -> Result<u32, String> {
        let frame = *self.snapshot()?.frame();
        let company = Company::new(&Settings::from_numbers(settings)?, places, || self.loader.body())?;
        let name = self.name();
        self.crowds.insert(name, company);
        self.hint_crowd(name, &frame);
        Ok(name)
    }

    /// Advances a crowd by at most 0.25 s, with three numbers per walker: x and y of a direction, or of a place if the
    /// third is 1. Returns the numbers of a `CrowdMessage`, and of a `MemberMessage` for each walker.
    pub fn step_crowd(&mut self, crowd: u32, seconds: f64, wishes: &[f64]) -> Result<Vec<f64>, String> {
        let view = self.snapshot()?;
        let company = self.crowds.get_mut(crowd).ok_or_else(|| invalid("the crowd is closed"))?;
        company.step(&view, seconds, wishes)?;
        let state = company.state();
        self.hint_crowd(crowd, view.frame());
        Ok(state)
    }

    /// Removes a pawn, a crowd, a route that is being planned, or a scene.
    pub fn forget(&mut self, name: u32) {
        self.routes.remove(name);
        let crowd = self.crowds.remove(name);
        crowd.iter().flat_map(|company| &company.bodies).for_each(|(body, _)| self.loader.forget(*body));
        let bodies = [self.pawns.remove(name).map(|pawn| pawn.body), self.scenes.remove(name).map(|scene| scene.body)];
        bodies.into_iter().flatten().for_each(|body| self.loader.forget(body));
    }

    // Scenes -------------------------------------------------------------------------------------------------------------------

    /// Creates a scene (see [`Scenes::new`]); returns its name.
    pub fn scene(&mut self, radius: f64, triangles: f64, detail: f64, overview: bool, blocks: bool) -> u32 {
        let body = self.loader.body();
        let name = self.name();
        let mut scenes = Scenes::new(radius, triangles, detail, overview, blocks);
        scenes.overview(self.outline().and_then(Outline::level));
        self.scenes.insert(name, Moving { thing: scenes, body, hinted: None });
        name
    }

    /// Changes the parameters of a scene.
    #[rustfmt::skip]
    pub fn set_scene(
        &mut self, scene: u32, radius: f64, triangles: f64, detail: f64, overview: bool, blocks: bool,
    ) {
        if let Some(scenes) = self.scenes.get_mut(scene) {
            scenes.thing.set(radius, triangles, detail, overview, blocks);
            // A camera that has not looked yet needs nothing.
            if scenes.hinted.is_some() {
                self.hint_scene(scene);
            }
        }
    }

    /// Sets the position of a scene's camera.
    pub fn look(&mut self, scene: u32, at: &[f64]) -> Result<(), String> {
        let at = point(at)?;
        if let Some(scenes) = self.scenes.get_mut(scene) {
            scenes.thing.look(at);
            self.hint_scene(scene);
        }
        Ok(())
    }

    /// Builds the next page of a scene and returns the numbers of a `PageMessage`;
    /// [`take_positions`](Self::take_positions) and similar functions return its geometry. Empty if there is no page to
    /// build.
    pub fn build(&mut self, scene: u32) -> Result<Vec<f64>, String> {
        let (view, outline) = (self.snapshot()?, self.outline().and_then(Outline::snapshot));
        let Some(scene) = self.scenes.get_mut(scene) else { return Ok(Vec::new()) };
        let (level, drawn) = scene.thing.build(&view, outline.as_ref());
        self.drawn = drawn;
        if self.drawn.is_some() {
            self.colours.drawn();
        }
        let Some((id, key, _, geometry)) = &self.drawn else { return Ok(Vec::new()) };
        let ([x, y, z], [scale_x, scale_y, scale_z]) = (geometry.origin, geometry.scale);
        let [[min_x, min_y, min_z], [max_x, max_y, max_z]] = geometry.bounds;
        let (page, level) = (f64::from(*id), f64::from(level));
        let (tx, ty, layer) = (f64::from(key.tx), f64::from(key.ty), f64::from(key.layer));
        #[rustfmt::skip]
        let message = PageMessage {
            page, tx, ty, layer, x, y, z, scale_x, scale_y, scale_z, min_x, min_y, min_z, max_x, max_y, max_z, level,
        };
        Ok(message.numbers().to_vec())
    }

    /// Starts bringing colours for what scenes draw.
    pub fn bring_colours(&mut self) {
        self.colours.bring();
    }

    /// Number of pages that wait for colours, including those of an overview level.
    pub fn unpainted(&self) -> u32 {
        self.colours.unpainted(&self.scenes, &self.loader, self.outline())
    }

    /// Paints the next page and returns the numbers of a `PaintMessage`; [`take_cells`](Self::take_cells) and [`take_colours`](Self::take_colours) return the rest. Empty if there is no
    /// page to paint.
    pub fn paint(&mut self) -> Result<Vec<f64>, String> {
        let report = |error: &_| self.reports.push_back(fault::text(error));
        let outline = outline_of(&mut self.outline);
        let Some((scene, page, paint)) = self.colours.paint(&mut self.scenes, &mut self.loader, outline, report) else {
            return Ok(Vec::new());
        };
        let paint = self.painted.insert(paint);
        let message = PaintMessage { view: f64::from(scene), page: f64::from(page), edge: f64::from(paint.edge) };
        Ok(message.numbers().to_vec())
    }

    /// Cells of the page painted last; returned once.
    pub fn take_cells(&mut self) -> Vec<u32> {
        self.painted.as_mut().map_or(Vec::new(), |paint| std::mem::take(&mut paint.cells))
    }

    /// Colours of the page painted last; returned once.
    pub fn take_colours(&mut self) -> Vec<u8> {
        self.painted.as_mut().map_or(Vec::new(), |paint| std::mem::take(&mut paint.colours))
    }

    /// Names of the pages that a scene's camera left behind.
    pub fn take_dropped(&mut self, scene: u32) -> Vec<u32> {
        self.scenes.get_mut(scene).map_or(Vec::new(), |scene| scene.thing.take_dropped())
    }

    /// Vertices of the page built last; returned once.
    pub fn take_positions(&mut self) -> Vec<u16> {
        self.drawn.as_mut().map_or(Vec::new(), |drawn| std::mem::take(&mut drawn.3.positions))
    }

    /// Normals of the page built last; returned once.
    pub fn take_normals(&mut self) -> Vec<i8> {
        self.drawn.as_mut().map_or(Vec::new(), |drawn| std::mem::take(&mut drawn.3.normals))
    }

    /// Attributes of the page built last; returned once.
    pub fn take_attributes(&mut self) -> Vec<u8> {
        self.drawn.as_mut().map_or(Vec::new(), |drawn| std::mem::take(&mut drawn.3.attributes))
    }
}

impl Engine {
    fn name(&mut self) -> u32 {
        self.names += 1;
        self.names
    }

    fn catalog(&self) -> Result<&Catalog, String> {
        self.loader.catalog().ok_or_else(not_open)
    }

    fn snapshot(&self) -> Result<Snapshot, String> {
        self.loader.snapshot().ok_or_else(not_open)
    }

    fn outline(&self) -> Option<&Outline> {
        match &self.outline {
            Distant::Here(outline) => Some(outline),
            _ => None,
        }
    }

    fn moving(&mut self, pawn: u32) -> Result<&mut Moving<Pawn>, String> {
        self.pawns.get_mut(pawn).ok_or_else(|| invalid("the walker is closed"))
    }

    /// Passes a pawn's motion hint and missing pages to the loader.
    fn hint(&mut self, pawn: u32) -> Result<(), String> {
        let frame = *self.snapshot()?.frame();
        if let Some(pawn) = self.pawns.get_mut(pawn) {
            let motion_hint = pawn.thing.motion_hint(&frame);
            let missing = pawn.thing.missing();
            if pawn.hinted != Some(motion_hint) || missing.is_some() {
                pawn.hinted = Some(motion_hint);
                self.loader.hint(pawn.body, &motion_hint);
                missing.into_iter().for_each(|missing| self.loader.need(pawn.body, missing));
            }
        }
        Ok(())
    }

    /// Passes the motion hints of a crowd and its missing pages to the loader.
    fn hint_crowd(&mut self, name: u32, frame: &Frame) {
        let Some(company) = self.crowds.get_mut(name) else { return };
        let missing = company.missing.zip(company.bodies.first().map(|(body, _)| *body));
        company.hints(frame).for_each(|(body, hint)| self.loader.hint(body, &hint));
        missing.iter().for_each(|(missing, body)| self.loader.need(*body, missing));
    }

    /// Passes the motion hint of a scene's camera to the loader, and asks for the overview level if it draws one.
    fn hint_scene(&mut self, name: u32) {
        let Some(scene) = self.scenes.get_mut(name) else { return };
        if scene.thing.has_overview() && matches!(self.outline, Distant::Later) {
            self.outline = Distant::Wanted;
        }
        let motion_hint = scene.thing.motion_hint();
        if scene.hinted != Some(motion_hint) {
            scene.hinted = Some(motion_hint);
            self.loader.hint(scene.body, &motion_hint);
        }
    }

    fn request(&mut self, keys: &[PageKey]) -> u32 {
        let around = keys.get(keys.len() / 2).copied().unwrap_or(PageKey { tx: 0, ty: 0, layer: 0 });
        let id = self.loader.request(keys, around);
        let name = self.name();
        self.requests.insert(name, id);
        name
    }
}

fn acting(action: ActionCode, fetch: u32, start: f64, end: f64) -> [f64; ActionMessage::LEN] {
    ActionMessage { action: action.into(), fetch: f64::from(fetch), start, end }.numbers()
}

fn fetching(action: ActionCode, fetch: u32, range: &std::ops::Range<u64>) -> [f64; ActionMessage::LEN] {
    acting(action, fetch, range.start as f64, range.end as f64)
}

fn outline_of(distant: &mut Distant) -> Option<&mut Outline> {
    match distant {
        Distant::Here(outline) => Some(outline),
        _ => None,
    }
}

fn time(ms: f64) -> Time {
    Duration::try_from_secs_f64(ms / 1000.0).unwrap_or_default()
}

fn point(at: &[f64]) -> Result<Point3<f64>, String> {
    match *at {
        [x, y, z] if at.iter().all(|v| v.is_finite()) => Ok(Point3::new(x, y, z)),
        _ => Err(invalid("a place is three finite numbers")),
    }
}

fn not_open() -> String {
    invalid("the archive is not open yet")
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub fn is(what: &ActionMessage, action: ActionCode) -> bool {
        what.action == f64::from(action)
    }

    /// Steps a pawn.
    pub fn state(engine: &mut Engine, pawn: u32, input: &[f64]) -> crate::messages::StateMessage {
        crate::messages::StateMessage::from_numbers(&engine.step(pawn, 0.05, input).unwrap()).unwrap()
    }

    /// Actions of a poll.
    pub fn polled(engine: &mut Engine) -> Vec<ActionMessage> {
        let todo = engine.poll(0.0).unwrap();
        todo.chunks(ActionMessage::LEN).map(|numbers| ActionMessage::from_numbers(numbers).unwrap()).collect()
    }
}
