//! The overview level that views draw where they draw no pages: all of an archive, coarse, from one contiguous range of
//! bytes.
//! In: the end of the section of levels, which holds the coarse ones. Out: the finest level whose pages all fit in
//! memory. Memory: the fetched range, and a separate budget.

use slicewalk::archive::{Catalog, Level};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::store::{Loader, LoaderOptions, Next, RequestId, Snapshot, Time};
use slicewalk::{Error, Result};
use std::ops::Range;

/// Most bytes to fetch, unless the table of levels alone is longer.
const MOST_BYTES: u64 = 1 << 20;
/// Most bytes decoded at a time.
const RUN_BYTES: usize = 64 << 10;

/// Range of bytes to fetch for an [`Outline`]; `None` if the archive has no levels.
pub(crate) fn range(catalog: &Catalog) -> Option<Range<u64>> {
    let (start, table) = (catalog.header().levels_offset(), catalog.levels_range()?);
    Some(table.end.saturating_sub(MOST_BYTES).max(start).min(table.start)..table.end)
}

/// A level that is loading or resident.
pub(crate) struct Outline {
    /// Offset of the fetched bytes, and the bytes.
    start: u64,
    bytes: Vec<u8>,
    /// Levels contained in them, the finest last.
    levels: Vec<Level>,
    budget: usize,
    loading: Option<(u32, Loader, Option<RequestId>)>,
    is_ready: bool,
}

impl Outline {
    /// Reads the levels from the bytes of [`range`].
    pub fn new(catalog: &Catalog, bytes: Vec<u8>, budget: usize) -> Result<Self> {
        let (whole, table) = (range(catalog).unwrap_or(0..0), catalog.levels_range().unwrap_or(0..0));
        let table = bytes.get((table.start - whole.start) as usize..).unwrap_or(&[]);
        let mut levels = catalog.decode_levels(table)?;
        levels.retain(|level| level.bytes().start >= whole.start);
        levels.reverse();
        Ok(Self {
            start: whole.start,
            budget: budget.saturating_sub(bytes.len()),
            bytes,
            levels,
            loading: None,
            is_ready: false,
        })
    }

    /// The level's pages, once all are resident.
    pub fn snapshot(&self) -> Option<Snapshot> {
        self.loading.as_ref().filter(|_| self.is_ready)?.1.snapshot()
    }

    /// Number and grid of the level.
    pub fn level(&self) -> Option<(u32, Frame)> {
        Some((self.loading.as_ref()?.0, *self.snapshot()?.frame()))
    }

    /// Loader of the level once all its pages are resident: it brings the level's colours, within its budget.
    pub fn loader(&mut self) -> Option<&mut Loader> {
        self.loading.as_mut().filter(|_| self.is_ready).map(|loading| &mut loading.1)
    }

    pub fn has_colours(&self) -> bool {
        self.is_ready && self.loading.as_ref().is_some_and(|loading| loading.1.has_colours())
    }

    /// Bytes in use, peak bytes, and budget, without the fetched range.
    pub fn bytes(&self) -> [usize; 3] {
        let counters = self.loading.as_ref().map(|(_, loader, _)| loader.counters()).unwrap_or_default();
        [counters.used_bytes, counters.peak_bytes, self.budget]
    }

    /// Decodes a part; returns whether there was any left.
    pub fn advance(&mut self, now: Time) -> Result<bool> {
        if self.is_ready {
            return Ok(false);
        }
        let Some((_, loader, request)) = &mut self.loading else {
            let Some(level) = self.levels.pop() else { return Ok(false) };
            let options = LoaderOptions { fetches: 1, run_bytes: RUN_BYTES, ..LoaderOptions::new(self.budget) };
            // If the table of pages does not fit, the level is too fine.
            self.loading =
                Loader::new(level.catalog().clone(), options).ok().map(|loader| (level.number(), loader, None));
            return Ok(true);
        };
        match loader.poll(now)? {
            Next::Fetch(fetch) => {
                let at = |byte: u64| byte.checked_sub(self.start).map_or(usize::MAX, |at| at as usize);
                let bytes = self.bytes.get(at(fetch.range.start)..at(fetch.range.end)).unwrap_or(&[]).to_vec();
                if let Some(job) = loader.given(fetch.id, bytes, now) {
                    loader.loaded(job.run(), now);
                }
            }
            Next::Report(page) => return Err(page.error),
            Next::Cancel(_) => {}
            Next::Wait(_) => match (*request, loader.snapshot()) {
                (_, None) => return Err(Error::parameter("archive", "the levels cannot be read")),
                (None, Some(view)) => *request = Some(loader.request(&keys(&view), PageKey { tx: 0, ty: 0, layer: 0 })),
                (Some(id), _) => match loader.outcome(id).transpose()? {
                    None => return Err(Error::parameter("archive", "the levels cannot be read")),
                    Some(report) if report.left_out > 0 => self.loading = None,
                    Some(_) => (self.is_ready, self.bytes) = (true, Vec::new()),
                },
            },
        }
        Ok(true)
    }
}

fn keys(view: &Snapshot) -> Vec<PageKey> {
    let columns = (0..view.column_count()).map(|number| view.column_at(number));
    columns.flat_map(|(tx, ty, slots)| slots.iter().map(move |slot| PageKey { tx, ty, layer: slot.layer() })).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::Engine;
    use crate::engine::tests::{is, polled};
    use crate::messages::{ActionCode, PageMessage, PaintMessage};
    use slicewalk::archive::{Archive, ArchiveWriter, EncodedColours, PageEncoder, Totals};
    use slicewalk::codec::ColourEncoder;
    use slicewalk::colour::{ColourPlan, ColourScale};
    use slicewalk::page::{Occupancy, PageBuilder, Span};
    use slicewalk::plan::Plan;
    use std::collections::BTreeSet;

    /// Rough ground of 40 × 10 pages of 3.2 m.
    fn ground(has_levels: bool) -> Vec<u8> {
        coloured_ground(has_levels, false)
    }

    pub fn coloured_ground(has_levels: bool, has_colours: bool) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("ground.slices");
        let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
        let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        let mut encoder = PageEncoder::new(plan.frame).for_levels(has_levels);
        if has_levels {
            writer.set_levels();
        }
        let colours = ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 2000 };
        if has_colours {
            writer.set_colours(colours);
        }
        let mut of_colours = ColourEncoder::default();
        let mut keys: Vec<_> = (0..400).map(|n| PageKey { tx: n % 40, ty: n / 40, layer: 0 }).collect();
        keys.sort_unstable();
        for key in keys {
            let mut page = PageBuilder::default();
            for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
                // No two pages are alike.
                let top = 100 + (x * 31 + y * 17) % 5 * 60 + (key.ty * 40 + key.tx) as u32 / 2 + x % 2 * key.tx as u32;
                assert!(page.set_column(x, y, &[Span::new(0, top, false).unwrap()]));
            }
            let page = page.build();
            let encoded = encoder.encode(key, &page);
            let occupancy = Occupancy::of(&page);
            let own = vec![Some([key.tx as u16 * 1500, key.ty as u16 * 6000, 30_000]); occupancy.len()];
            let made = has_colours.then(|| EncodedColours::new(&colours, &occupancy, &own, &mut of_colours));
            writer.put(key, encoded.with_colours(made.unwrap_or_default())).unwrap();
        }
        writer.finish(Totals { points_read: 1, points_kept: 1, ..Totals::default() }).unwrap();
        std::fs::read(&target).unwrap()
    }

    /// Results of a camera at one end of the ground.
    #[derive(Default)]
    struct Seen {
        /// Bytes fetched since it first looked, and those of colours.
        fetches: Vec<[u64; 2]>,
        of_colours: Vec<[u64; 2]>,
        /// Names, places and levels of pages drawn, and names of those painted.
        built: Vec<(u32, [f64; 2])>,
        painted: Vec<u32>,
    }

    fn seen(bytes: &[u8], overview: bool, budget: f64, has_colours: bool) -> Seen {
        let mut engine = Engine::new(bytes.len() as f64, budget, 4);
        let (mut scene, mut seen) = (None, Seen::default());
        for _ in 0..5000 {
            let mut busy = false;
            for what in polled(&mut engine) {
                let of_colours = is(&what, ActionCode::FetchColours);
                if !of_colours && !is(&what, ActionCode::Fetch) {
                    continue;
                }
                let fetches = if of_colours { &mut seen.of_colours } else { &mut seen.fetches };
                fetches.extend(scene.map(|_| [what.start as u64, what.end as u64]));
                let range = what.start as usize..what.end as usize;
                engine.given(what.fetch as u32, bytes[range].to_vec(), 0.0);
                busy = true;
            }
            while engine.decode(0.0) {
                busy = true;
            }
            let name = match scene {
                Some(name) => name,
                None if !engine.is_open() => continue,
                None => {
                    let name = engine.scene(20.0, 1e6, 0.02, overview, false);
                    engine.look(name, &[1.0, 1.0, 1.0]).unwrap();
                    if has_colours {
                        engine.bring_colours();
                    }
                    *scene.insert(name)
                }
            };
            while let Some(page) = PageMessage::from_numbers(&engine.build(name).unwrap()) {
                seen.built.push((page.page as u32, [page.x, page.level]));
                busy = true;
            }
            while let Some(PaintMessage { view, page, edge }) = PaintMessage::from_numbers(&engine.paint().unwrap()) {
                assert!(view == f64::from(name) && edge >= 1.0);
                assert_eq!(engine.take_cells().len(), (4.0 * edge * edge) as usize);
                assert!(!engine.take_colours().is_empty());
                seen.painted.push(page as u32);
                busy = true;
            }
            assert_eq!(engine.take_report(), "");
            if !busy && !seen.fetches.is_empty() {
                assert_eq!(engine.unpainted(), 0);
                return seen;
            }
        }
        panic!("it never ends");
    }

    #[test]
    fn beyond_the_pages_all_of_a_level_is_drawn_after_one_fetch() {
        let bytes = ground(true);
        let Seen { fetches, built, .. } = seen(&bytes, true, 64e6, false);
        let (level, pages): (Vec<_>, Vec<_>) = built.iter().map(|page| page.1).partition(|page| page[1] > 0.0);
        // Level 1 has pixels of 0.2 m, fine enough from 10 m on.
        assert_eq!(level.len(), 30, "40 × 10 pages, four by four");
        assert!(level.iter().all(|page| page[1] == 1.0) && level.iter().any(|page| page[0] > 100.0));
        assert!(!pages.is_empty() && pages.iter().all(|page| page[0] <= 1.0 + 10.0 * 1.25));
        let Seen { fetches: without, built: alone, .. } = seen(&bytes, false, 64e6, false);
        assert!(alone.iter().all(|page| page.1[1] == 0.0) && alone.iter().any(|page| page.1[0] > 15.0));
        // One more, at the end of the pages, where the levels are.
        let last = |fetches: &[[u64; 2]]| fetches.iter().map(|range| range[1]).max();
        assert!(last(&without) < last(&fetches), "{without:?}, {fetches:?}");
        let of_level = fetches.iter().filter(|range| Some(range[1]) == last(&fetches));
        assert_eq!(of_level.count(), 1, "{fetches:?}");
    }

    #[test]
    fn colours_of_the_level_come_after_those_of_the_pages() {
        let bytes = coloured_ground(true, true);
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        let table = archive.level(1).unwrap().catalog().level_colours_range().unwrap();
        let Seen { of_colours: fetches, built, painted, .. } = seen(&bytes, true, 64e6, true);
        let built = BTreeSet::from_iter(built.iter().map(|page| page.0));
        assert_eq!(BTreeSet::from_iter(painted.iter().copied()), built, "all that was drawn");
        let level = painted.iter().filter(|page| **page >= 1 << 31).count();
        assert_eq!(level, 30);
        let far = fetches.iter().position(|range| range[0] == table.start).expect("the table of levels");
        let section = archive.catalog().colours_section().unwrap();
        assert!(far > 1 && fetches[0][1] == section.end, "{fetches:?}");
        assert_eq!(BTreeSet::from_iter(&fetches).len(), fetches.len(), "none twice: {fetches:?}");
        let end = fetches[far + 1..].iter().map(|range| range[1]).max().unwrap();
        assert!(fetches[..far].iter().all(|range| range[0] >= end), "{fetches:?}");
    }

    #[test]
    fn archives_without_levels_and_small_budgets_show_pages_alone() {
        for (has_levels, budget) in [(false, 64e6), (true, 12e6)] {
            let built = seen(&ground(has_levels), true, budget, false).built;
            assert!(built.iter().all(|page| page.1[1] == 0.0) && built.iter().any(|page| page.1[0] > 15.0));
        }
    }
}
