//! Colours of what scenes draw: those of pages first, then those of the overview level.
//!
//! In: what is drawn, and bytes fetched while nothing else is in flight. Out: one range to fetch at a time, and paint.
//! The caller cancels a fetch when a pawn waits for a page.

use crate::named::{Moving, Named};
use crate::outline::Outline;
use crate::paint::Paint;
use crate::scene::{Part, Scenes};
use slicewalk::Error;
use slicewalk::frame::PageKey;
use slicewalk::store::{ColourLoader, Loader, Snapshot, Time};
use std::ops::Range;

/// Most pages whose colours are requested at a time; afterwards the camera may see others.
const PAINTED: usize = 64;

/// State of the colours.
#[derive(Default)]
pub(crate) enum Colours {
    /// Not requested.
    #[default]
    Off,
    /// Requested, but the directory is not loaded yet.
    Wanted,
    On(Box<Bringing>),
    /// The archive has none.
    Never,
}

pub(crate) struct Bringing {
    near: ColourLoader,
    /// Loader for the overview level, used when no page needs colours.
    far: Option<ColourLoader>,
    /// The fetch in flight, by name.
    fetch: Option<(u32, Part)>,
    /// Set when something was drawn or painted since the loaders last received the pages.
    is_stale: bool,
    /// Decoded colours, and the scenes still to be painted with them.
    came: Option<(Part, PageKey, slicewalk::page::Colours, Vec<u32>)>,
}

impl Bringing {
    /// Ends a fetch and returns the loader that requested it.
    fn over(&mut self, name: u32) -> Option<&mut ColourLoader> {
        let (_, of) = self.fetch.take_if(|fetch| fetch.0 == name)?;
        match of {
            Part::Pages => Some(&mut self.near),
            Part::Level => self.far.as_mut(),
        }
    }
}

impl Colours {
    /// Starts bringing colours.
    pub fn bring(&mut self) {
        if matches!(self, Self::Off) {
            *self = Self::Wanted;
        }
    }

    pub fn are_on(&self) -> bool {
        matches!(self, Self::On(_))
    }

    /// Starts loading if colours are requested and the directory is loaded.
    pub fn begin(&mut self, loader: &Loader) {
        if matches!(self, Self::Wanted) && loader.snapshots().is_some() {
            *self = loader.colours().map_or(Self::Never, |near| {
                Self::On(Box::new(Bringing { near, far: None, fetch: None, is_stale: true, came: None }))
            });
        }
    }

    /// Notes that a scene drew something.
    pub fn drawn(&mut self) {
        if let Self::On(on) = self {
            on.is_stale = true;
        }
    }

    /// Cancels the fetch in flight and returns its name.
    pub fn give_up(&mut self) -> Option<u32> {
        let Self::On(on) = self else { return None };
        let (name, _) = on.fetch?;
        on.over(name).into_iter().for_each(ColourLoader::cancel);
        Some(name)
    }

    /// Returns the next range to fetch under this name, unless a fetch is in flight, and when to ask again.
    pub fn ask(
        &mut self,
        name: u32,
        scenes: &Named<Moving<Scenes>>,
        outline: Option<&Outline>,
        now: Time,
    ) -> (Option<Range<u64>>, Option<Time>) {
        let Self::On(on) = self else { return (None, None) };
        let Bringing { near, far, fetch, is_stale, .. } = &mut **on;
        if fetch.is_some() {
            return (None, None);
        }
        if far.is_none() {
            *far = outline.and_then(Outline::colours);
            *is_stale |= far.is_some();
        }
        if std::mem::take(is_stale) {
            let wanted = |of| scenes.things().flat_map(move |scene| scene.thing.unpainted(of, PAINTED));
            near.want(wanted(Part::Pages));
            far.iter_mut().for_each(|far| far.want(wanted(Part::Level)));
        }
        let of_pages = near.poll(now).map(|range| (Part::Pages, range));
        let found = of_pages.or_else(|| Some((Part::Level, far.as_mut()?.poll(now)?)));
        let range = found.map(|(of, range)| {
            *fetch = Some((name, of));
            range
        });
        (range, [near.retry_at(), far.as_ref().and_then(ColourLoader::retry_at)].into_iter().flatten().min())
    }

    /// Takes the bytes of a fetch; `None` if the fetch was not for colours.
    pub fn given(&mut self, name: u32, bytes: Vec<u8>, now: Time) -> Option<slicewalk::Result<()>> {
        let Self::On(on) = self else { return None };
        Some(on.over(name)?.given(bytes, now))
    }

    /// Notes that a fetch failed; it is requested again later.
    pub fn failed(&mut self, name: u32, now: Time) {
        if let Self::On(on) = self {
            on.over(name).into_iter().for_each(|loader| loader.failed(now));
        }
    }

    /// Number of pages that wait for colours, including those of an overview level.
    pub fn unpainted(&self, scenes: &Named<Moving<Scenes>>) -> u32 {
        let Self::On(on) = self else { return 0 };
        let of = |of| scenes.things().map(move |scene| scene.thing.unpainted(of, usize::MAX).len() as u32);
        of(Part::Pages).chain(of(Part::Level).filter(|_| on.far.is_some())).sum()
    }

    /// Paints the next page; returns the scene that draws it, its name, and its paint. Damaged colours are reported
    /// once.
    pub fn paint(
        &mut self,
        scenes: &mut Named<Moving<Scenes>>,
        view: &Snapshot,
        level: Option<&Snapshot>,
        mut report: impl FnMut(Error),
    ) -> Option<(u32, u32, Paint)> {
        let Self::On(on) = self else { return None };
        let Bringing { near, far, is_stale, came, .. } = &mut **on;
        loop {
            if let Some((of, key, colours, waiting)) = came {
                while let Some(name) = waiting.pop() {
                    let drawn = scenes.get_mut(name).and_then(|scene| scene.thing.paint(*of, *key));
                    if let Some((page, coarseness)) = drawn {
                        return Some((name, page, Paint::new(colours, coarseness)));
                    }
                }
                *came = None;
            }
            let of_pages = near.decode(view).map(|(key, colours)| (Part::Pages, key, colours));
            let found = of_pages.or_else(|| {
                let (key, colours) = far.as_mut()?.decode(level?)?;
                Some((Part::Level, key, colours))
            });
            let (of, key, colours) = found?;
            match colours {
                Ok(colours) => *came = Some((of, key, colours, scenes.0.iter().map(|(name, _)| *name).collect())),
                Err(error) => {
                    report(error);
                    // Prevents further requests for it.
                    for (_, scene) in &mut scenes.0 {
                        let _ = scene.thing.paint(of, key);
                    }
                }
            }
            *is_stale = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::Engine;
    use crate::engine::tests::{is, polled, state};
    use crate::messages::{ActionCode, ActionMessage};
    use crate::outline::tests::coloured_ground;
    use slicewalk::archive::Archive;
    use std::ops::Range;

    const SETTINGS: [f64; 10] = [0.0, 0.5, 0.5, 1.8, 0.35, 1.4, 9.81, 0.5, 1.0, f64::NAN];
    const STILL: [f64; 5] = [0.0, 0.0, 1.0, 0.0, 0.0];

    fn give(engine: &mut Engine, bytes: &[u8], fetch: &ActionMessage) {
        engine.given(fetch.fetch as u32, bytes[fetch.start as usize..fetch.end as usize].to_vec(), 0.0);
        while engine.decode(0.0) {}
    }

    /// Delivers everything else, draws and paints; returns the first request for colours that begins within `wanted`.
    fn until_colours(engine: &mut Engine, bytes: &[u8], scene: Option<u32>, wanted: &Range<u64>) -> Option<u32> {
        loop {
            let (todo, mut busy) = (polled(engine), false);
            for what in &todo {
                let of_colours = is(what, ActionCode::FetchColours);
                if of_colours && wanted.contains(&(what.start as u64)) {
                    return Some(what.fetch as u32);
                }
                if of_colours || is(what, ActionCode::Fetch) {
                    give(engine, bytes, what);
                    busy = true;
                }
            }
            busy |= scene.is_some_and(|scene| !engine.build(scene).unwrap().is_empty());
            while !engine.paint().unwrap().is_empty() {
                busy = true;
            }
            if !busy && todo.iter().all(|what| is(what, ActionCode::Wait)) {
                return None;
            }
        }
    }

    /// Checks that a request for colours that begins within `wanted` is cancelled while a pawn at `far` waits in a page
    /// that was not requested before.
    fn assert_gives_up(bytes: &[u8], eye: [f64; 3], far: [f64; 3], overview: bool, wanted: &Range<u64>) {
        let mut engine = Engine::new(bytes.len() as f64, 64e6, 4);
        assert_eq!(until_colours(&mut engine, bytes, None, wanted), None);
        let scene = engine.scene(2.0, 1e5, 0.01, overview, false);
        engine.bring_colours();
        engine.look(scene, &eye).unwrap();
        let first = until_colours(&mut engine, bytes, Some(scene), wanted).expect("colours of what is drawn");
        let pawn = engine.pawn(&SETTINGS, &far).unwrap();
        assert!(state(&mut engine, pawn, &STILL).missing > 0.0, "it waits");
        let todo = polled(&mut engine);
        let cancelled = |what: &&ActionMessage| is(what, ActionCode::Cancel) && what.fetch == f64::from(first);
        assert!(todo.iter().any(|what| cancelled(&what)), "{todo:?}");
        let of_pages = *todo.iter().find(|what| is(what, ActionCode::Fetch)).expect("what it waits for");
        assert!(polled(&mut engine).iter().all(|what| !is(what, ActionCode::FetchColours)), "none while it waits");
        // An answer that arrives after all is ignored.
        engine.given(first, vec![0; 12], 0.0);
        assert!(engine.take_report().is_empty());
        give(&mut engine, bytes, &of_pages);
        assert_eq!(state(&mut engine, pawn, &STILL).missing, 0.0);
        let again = until_colours(&mut engine, bytes, Some(scene), wanted).expect("colours again");
        assert!(again > first);
    }

    #[test]
    fn a_request_for_colours_is_given_up_while_a_pawn_waits() {
        let bytes = include_bytes!("../../../../spec/samples/colours.slices");
        assert_gives_up(bytes, [3.2, 3.2, 20.0], [16.0, -16.0, 97.0], false, &(0..u64::MAX));
    }

    #[test]
    fn one_for_colours_of_a_level_is_too() {
        let bytes = coloured_ground(true, true);
        let archive = Archive::from_bytes(bytes.clone()).unwrap();
        let level = archive.level(1).unwrap();
        // The table of levels, which comes first and is requested once no page needs colours.
        let table = level.catalog().level_colours_range().unwrap();
        // So close to the ground that the directory alone cannot rule out solid.
        assert_gives_up(&bytes, [1.0, 1.0, 1.0], [120.0, 20.0, 0.4], true, &table);
    }
}
