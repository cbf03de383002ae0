//! Pages that a camera sees and their level of detail: what to build next, what to drop.
//!
//! In: the pages in memory and the position of the camera. Out: geometry, nearest first. Memory: a few words per page
//! drawn.

use crate::geometry::{COARSEST, Geometry};
use crate::map::columns;
use slicewalk::frame::{Frame, PAGE_SLICES, PageKey, TILE_PIXELS};
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::page::Page;
use slicewalk::store::{MotionHint, Snapshot};
use slicewalk_base::sort::sort_by;
use std::collections::HashMap;

/// Time that a loader looks ahead (s).
pub(crate) const HORIZON_S: f64 = 8.0;
/// Pages are dropped beyond this multiple of the radius, so that walking to and fro keeps them.
const FORGET: f64 = 1.25;
/// Share of a step of coarseness that a cell may be off before its page is rebuilt.
const STEADY: f64 = 0.3;
/// Factor by which everything becomes coarser when there are too many triangles.
const COARSEN: f64 = 1.3;
/// Added to distances (m): the camera's own page and those next to it have much the same detail.
const NEAR_M: f64 = 2.5;
/// Below this fraction of the allowed triangles, everything becomes finer again.
const REFINE_BELOW: f64 = 0.5;
/// Fraction of the triangles for an overview level, and how far it is drawn (m).
const OVERVIEW_SHARE: f64 = 1.0 / 3.0;
const OVERVIEW_M: f64 = 4000.0;
/// With an overview level, pages are drawn at most this far (pages), the range in which they can be cut out of the
/// level.
const FULL_PAGES: f64 = 48.0;
/// Least distance up to which they are drawn (m).
const FULL_LEAST_M: f64 = 10.0;
/// First name of the overview level's pages.
const OVERVIEW_NAMES: u32 = 1 << 31;

/// Part of the drawing: pages, or those of an overview level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    Pages,
    Level,
}

/// Drawing of a camera: pages around it, and beyond them an overview level if there is one.
#[derive(Debug)]
pub struct Scenes {
    near: Scene,
    far: Scene,
    level: Option<(u32, Frame)>,
    given: [f64; 3],
    has_overview: bool,
}

/// Eight neighbours and the page itself, row by row.
type Around<'a> = [Option<&'a Page>; 9];

impl Scenes {
    /// Creates scenes like `Scene::new`; `overview`: draws a level too, once it is loaded. Surfaces are smooth unless
    /// `blocks`: then they are drawn as they collide.
    pub fn new(radius: f64, triangles: f64, detail: f64, overview: bool, blocks: bool) -> Self {
        let mut far = Scene::new(OVERVIEW_M, triangles, detail);
        far.names = OVERVIEW_NAMES;
        let near = Scene::new(radius, triangles, detail);
        let mut scenes = Self { near, far, level: None, given: [radius, triangles, detail], has_overview: overview };
        scenes.set(radius, triangles, detail, overview, blocks);
        scenes
    }

    /// Changes the parameters of [`new`](Self::new).
    pub fn set(&mut self, radius: f64, triangles: f64, detail: f64, overview: bool, blocks: bool) {
        (self.given, self.has_overview) = ([radius, triangles, detail], overview);
        [&mut self.near, &mut self.far].into_iter().for_each(|scene| scene.set_blocks(blocks));
        if !overview {
            self.far.drop_all();
        }
        let Some((level, frame)) = self.level.filter(|_| overview) else {
            return self.near.set(radius, triangles, detail);
        };
        // Farther away the level's cells are fine enough.
        let page_m = TILE_PIXELS as f64 * frame.pixel_m() / f64::from(1 << (2 * level));
        let enough = (frame.pixel_m() / detail.max(1e-4)).clamp(FULL_LEAST_M, (FULL_PAGES * page_m).max(FULL_LEAST_M));
        self.near.set(radius.min(enough), triangles * (1.0 - OVERVIEW_SHARE), detail);
        self.far.set(OVERVIEW_M, triangles * OVERVIEW_SHARE, detail);
    }

    /// Returns whether it draws an overview level.
    pub fn has_overview(&self) -> bool {
        self.has_overview
    }

    /// Sets number and grid of the overview level once it is loaded.
    pub fn overview(&mut self, level: Option<(u32, Frame)>) {
        if self.level.is_none() && level.is_some() {
            self.level = level;
            let [radius, triangles, detail] = self.given;
            self.set(radius, triangles, detail, self.has_overview, self.near.blocks);
        }
    }

    /// Moves the camera.
    pub fn look(&mut self, at: Point3<f64>) {
        self.near.look(at);
        self.far.look(at);
    }

    /// Notes that pages were loaded.
    pub fn pages_changed(&mut self) {
        self.near.stale = true;
    }

    /// Motion hint of the near scene.
    pub fn motion_hint(&self) -> MotionHint {
        self.near.motion_hint()
    }

    /// Number of pages that [`build`](Self::build) will draw.
    pub fn unbuilt(&self) -> usize {
        self.near.queue.len() + self.far.queue.len()
    }

    /// Drawn pages whose colours are missing or too coarse, nearest first, or those of the level; at most `most`.
    pub fn unpainted(&self, of: Part, most: usize) -> Vec<PageKey> {
        match of {
            Part::Pages => self.near.unpainted(most),
            Part::Level => self.far.unpainted(most),
        }
    }

    /// Marks a page as painted; returns its name and the coarseness of its colours, or `None` if it is no longer drawn.
    pub fn paint(&mut self, of: Part, key: PageKey) -> Option<(u32, u32)> {
        let scene = match of {
            Part::Pages => &mut self.near,
            Part::Level => &mut self.far,
        };
        let drawn = scene.drawn.get_mut(&key)?;
        let coarseness = drawn.coarseness.saturating_sub(1);
        drawn.painted = coarseness;
        Some((drawn.id, coarseness))
    }

    /// Names of pages that the camera left behind since the last call.
    pub fn take_dropped(&mut self) -> Vec<u32> {
        let mut dropped = std::mem::take(&mut self.near.dropped);
        dropped.append(&mut self.far.dropped);
        dropped
    }

    /// Builds the next page like `Scene::build` and returns its level; pages of the overview level come last.
    pub fn build(&mut self, pages: &Snapshot, overview: Option<&Snapshot>) -> (u32, Option<BuiltPage>) {
        self.near.plan(pages);
        let built = self.near.build(pages);
        match (self.level, overview) {
            (Some((level, _)), Some(overview)) if self.has_overview && built.is_none() => {
                self.far.plan(overview);
                (level, self.far.build(overview))
            }
            _ => (0, built),
        }
    }
}

/// A page as it is drawn: name, place, coarseness and geometry.
pub type BuiltPage = (u32, PageKey, u32, Geometry);

/// Drawing of one set of pages.
#[derive(Debug)]
struct Scene {
    at: Point3<f64>,
    radius: f64,
    triangles: usize,
    detail: f64,
    blocks: bool,
    /// Factor by which everything is coarser than `detail` requires, to stay within `triangles`.
    coarser: f64,
    drawn: HashMap<PageKey, Drawn>,
    /// Pages to be built: distance (m), page, coarseness; unordered.
    queue: Vec<(f64, PageKey, u32)>,
    dropped: Vec<u32>,
    stale: bool,
    names: u32,
    /// Grid of the pages, known once there are some.
    frame: Option<Frame>,
}

#[derive(Debug, Clone, Copy)]
struct Drawn {
    id: u32,
    coarseness: u32,
    triangles: usize,
    /// Coarseness of its colours, or [`UNPAINTED`].
    painted: u32,
    blocks: bool,
    /// Pages around it that were in memory when it was built.
    neighbours: usize,
}

const UNPAINTED: u32 = u32::MAX;

impl Scene {
    /// Creates a scene of pages up to `radius` metres away, with at most `triangles` triangles and cells no wider than
    /// `detail` times their distance.
    pub fn new(radius: f64, triangles: f64, detail: f64) -> Self {
        let mut scene = Self {
            at: Point3::origin(),
            radius: 0.0,
            triangles: 0,
            detail: 0.0,
            blocks: false,
            coarser: 1.0,
            drawn: HashMap::new(),
            queue: Vec::new(),
            dropped: Vec::new(),
            stale: false,
            names: 0,
            frame: None,
        };
        scene.set(radius, triangles, detail);
        scene
    }

    /// Changes the parameters of [`new`](Self::new); invalid values are clamped.
    pub fn set(&mut self, radius: f64, triangles: f64, detail: f64) {
        let wanted = (radius.clamp(1.0, 10_000.0), triangles.clamp(10_000.0, 1e9) as usize, detail.clamp(1e-4, 1.0));
        if wanted != (self.radius, self.triangles, self.detail) {
            (self.radius, self.triangles, self.detail) = wanted;
            (self.coarser, self.stale) = (1.0, true);
        }
    }

    fn set_blocks(&mut self, blocks: bool) {
        self.stale |= blocks != self.blocks;
        self.blocks = blocks;
    }

    /// Moves the camera.
    pub fn look(&mut self, at: Point3<f64>) {
        if at.iter().all(|v| v.is_finite()) && at != self.at {
            (self.at, self.stale) = (at, true);
        }
    }

    /// Drops all that is drawn.
    fn drop_all(&mut self) {
        self.dropped.extend(self.drawn.drain().map(|(_, drawn)| drawn.id));
        self.queue.clear();
        self.stale = true;
    }

    /// Motion hint for a loader, to load the nearest pages first.
    pub fn motion_hint(&self) -> MotionHint {
        MotionHint {
            min: self.at,
            max: self.at,
            velocity: Vector3::zeros(),
            gravity: 0.0,
            terminal_speed: 0.0,
            agility: self.radius / HORIZON_S,
        }
    }

    /// Plans what to draw if something changed.
    pub fn plan(&mut self, set: &Snapshot) {
        if !std::mem::take(&mut self.stale) {
            return;
        }
        let (frame, at, forget) = (*set.frame(), self.at, self.radius * FORGET);
        self.frame = Some(frame);
        self.drawn.retain(|key, drawn| {
            let keeps = distance(&frame, *key, &at) <= forget;
            if !keeps {
                self.dropped.push(drawn.id);
            }
            keeps
        });
        self.refine();
        self.queue = self.wanted(set);
        // Coarser, until that makes a difference.
        let is_coarsest = |scene: &Self| scene.level(&frame, 0.0) >= f64::from(COARSEST);
        while self.queue.is_empty() && self.sum() > self.triangles && !is_coarsest(self) {
            self.coarser *= COARSEN;
            self.queue = self.wanted(set);
        }
    }

    /// Pages in memory that are not drawn, or not with the right detail.
    fn wanted(&self, set: &Snapshot) -> Vec<(f64, PageKey, u32)> {
        let (frame, at) = (*set.frame(), self.at);
        let mut wanted = Vec::new();
        let area = [at.x - self.radius, at.y - self.radius, at.x + self.radius, at.y + self.radius];
        for (tx, ty, slots) in columns(set, area) {
            for slot in slots.iter().filter(|slot| slot.page().is_some()) {
                let key = PageKey { tx, ty, layer: slot.layer() };
                let far = distance(&frame, key, &at);
                if far > self.radius {
                    continue;
                }
                let level = self.level(&frame, far);
                let coarseness = level as u32;
                let Some(built) = self.drawn.get(&key) else {
                    wanted.push((far, key, coarseness));
                    continue;
                };
                let above = level - f64::from(built.coarseness);
                if !(-STEADY..1.0 + STEADY).contains(&above) || built.blocks != self.blocks {
                    wanted.push((far, key, coarseness));
                } else if !self.blocks && neighbours(set, key).iter().flatten().count() > built.neighbours {
                    // New neighbours only bend its edge, which is less urgent than all the rest.
                    wanted.push((far + self.radius, key, built.coarseness));
                }
            }
        }
        wanted
    }

    fn unpainted(&self, most: usize) -> Vec<PageKey> {
        let missing = self.drawn.iter().filter(|(_, drawn)| drawn.painted > drawn.coarseness && drawn.triangles > 0);
        let mut keys: Vec<(f64, PageKey)> =
            missing.map(|(key, _)| (self.frame.map_or(0.0, |frame| distance(&frame, *key, &self.at)), *key)).collect();
        sort_by(&mut keys, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        keys.into_iter().take(most).map(|(_, key)| key).collect()
    }

    fn sum(&self) -> usize {
        self.drawn.values().map(|drawn| drawn.triangles).sum()
    }

    /// Makes everything finer again if there is room for many more triangles.
    fn refine(&mut self) {
        if (self.sum() as f64) < self.triangles as f64 * REFINE_BELOW {
            self.coarser = (self.coarser / COARSEN).max(1.0);
        }
    }

    /// Coarseness of a page at a distance of `far` (m), with its fraction.
    fn level(&self, frame: &Frame, far: f64) -> f64 {
        let cell = (far + NEAR_M) * self.detail * self.coarser / frame.pixel_m();
        cell.max(1.0).log2().min(f64::from(COARSEST))
    }

    fn nearest(&mut self) -> Option<(PageKey, u32)> {
        let order = |(_, a): &(usize, &(f64, PageKey, u32)), (_, b): &(usize, &(f64, PageKey, u32))| {
            a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
        };
        let (at, _) = self.queue.iter().enumerate().min_by(order)?;
        let (_, key, coarseness) = self.queue.swap_remove(at);
        Some((key, coarseness))
    }

    /// Builds the next page: name, place, coarseness and geometry. `None` if there is nothing to build.
    pub fn build(&mut self, set: &Snapshot) -> Option<BuiltPage> {
        while let Some((key, coarseness)) = self.nearest() {
            let slot = set.column(key.tx, key.ty).iter().find(|slot| slot.layer() == key.layer);
            let Some(page) = slot.and_then(|slot| slot.page()) else { continue };
            let around = (!self.blocks).then(|| neighbours(set, key));
            let geometry = Geometry::of(set.frame(), key, page, around.as_ref(), coarseness);
            let neighbours = around.map_or(0, |around| around.iter().flatten().count());
            let before = self.drawn.get(&key).map(|drawn| (drawn.id, drawn.painted));
            let (id, painted) = before.unwrap_or_else(|| {
                self.names += 1;
                (self.names, UNPAINTED)
            });
            let (triangles, blocks) = (geometry.triangles(), self.blocks);
            self.drawn.insert(key, Drawn { id, coarseness, triangles, painted, blocks, neighbours });
            self.stale |= self.queue.is_empty() && self.sum() > self.triangles;
            return Some((id, key, coarseness, geometry));
        }
        None
    }
}

/// Pages in memory around a page in its layer, and the page itself.
fn neighbours(set: &Snapshot, key: PageKey) -> Around<'_> {
    std::array::from_fn(|n| {
        let (tx, ty) = (key.tx.checked_add(n as i32 % 3 - 1)?, key.ty.checked_add(n as i32 / 3 - 1)?);
        set.column(tx, ty).iter().find(|slot| slot.layer() == key.layer)?.page()
    })
}

/// Distance from a place to the nearest point of a page's box (m).
fn distance(frame: &Frame, key: PageKey, at: &Point3<f64>) -> f64 {
    let gap = |low: f64, size: f64, x: f64| (low - x).max(x - low - size).max(0.0);
    let edge = TILE_PIXELS as f64 * frame.pixel_m();
    let height = PAGE_SLICES as f64 * frame.slice_m();
    Vector3::new(
        gap(f64::from(key.tx) * edge, edge, at.x),
        gap(f64::from(key.ty) * edge, edge, at.y),
        gap(f64::from(key.layer) * height, height, at.z),
    )
    .norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use slicewalk::page::{PageBuilder, Span};
    use slicewalk::store::Snapshot;

    /// Rough ground of 16 × 16 pages of 3.2 m.
    fn ground() -> Snapshot {
        let pages = (0..256).map(|n| {
            let mut builder = PageBuilder::default();
            for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
                let top = 100 + (x * 31 + y * 17 + n as u32) % 5 * 60;
                assert!(builder.set_column(x, y, &[Span::new(0, top, false).unwrap()]));
            }
            (PageKey { tx: n % 16, ty: n / 16, layer: 0 }, builder.build())
        });
        Snapshot::from_pages(Frame::new(0.05, 0.15).unwrap(), pages)
    }

    fn build_all(scene: &mut Scene, store: &Snapshot) -> Vec<(u32, PageKey, u32)> {
        let mut built = Vec::new();
        for _ in 0..40 {
            scene.plan(store);
            while let Some((id, key, coarseness, _)) = scene.build(store) {
                built.push((id, key, coarseness));
            }
        }
        built
    }

    #[test]
    fn the_nearest_is_built_first_and_finest_and_what_is_left_behind_is_dropped() {
        let store = ground();
        let mut scene = Scene::new(10.0, 1e9, 0.01);
        scene.look(Point3::new(1.0, 1.0, 1.0));
        let built = build_all(&mut scene, &store);
        assert_eq!(built[0].1, PageKey { tx: 0, ty: 0, layer: 0 });
        assert!(built.iter().map(|page| page.2).is_sorted(), "{built:?}");
        assert_eq!((built[0].2, built.last().unwrap().2), (0, 1), "0.01 × (10 + 2.5) m are two pixels");
        assert!(scene.dropped.is_empty());
        let count = built.len();
        assert!(count < 30 && build_all(&mut scene, &store).is_empty());
        // Move to the other end: all pages are dropped, and as many are built.
        scene.look(Point3::new(50.0, 50.0, 1.0));
        let again = build_all(&mut scene, &store);
        let mut dropped = scene.dropped.clone();
        dropped.sort_unstable();
        assert_eq!(dropped, Vec::from_iter(1..=count as u32));
        assert!(again.iter().all(|page| page.0 > count as u32));
    }

    #[test]
    fn triangles_keep_to_their_number() {
        let store = ground();
        let mut scene = Scene::new(60.0, 1e9, 0.001);
        scene.look(Point3::new(25.0, 25.0, 1.0));
        build_all(&mut scene, &store);
        let all = scene.sum();
        scene.set(60.0, all as f64 / 8.0, 0.001);
        let again = build_all(&mut scene, &store);
        assert!(scene.sum() <= all / 8, "{} of {all}", scene.sum());
        assert!(again.iter().all(|page| page.0 <= 256), "pages keep their names");
        assert_eq!(scene.drawn.len(), 256);
    }
}
