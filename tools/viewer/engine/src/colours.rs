//! Colours of what scenes draw: those of pages first, then those of the overview level.
//!
//! In: what is drawn, and the loaders of pages and of the level. Out: the pages whose colours they bring, and paint.

use crate::named::{Moving, Named};
use crate::outline::Outline;
use crate::paint::Paint;
use crate::scene::{Part, Scenes};
use slicewalk::Error;
use slicewalk::frame::PageKey;
use slicewalk::store::Loader;

/// Most pages whose colours are requested at a time; afterwards the camera may see others.
const PAINTED: usize = 64;

#[derive(Default)]
pub(crate) struct Colours {
    is_on: bool,
    /// Set when something was drawn or painted since the loaders last received the pages.
    is_stale: bool,
    /// Decoded colours, and the scenes still to be painted with them.
    came: Option<(Part, PageKey, slicewalk::page::Colours, Vec<u32>)>,
}

impl Colours {
    /// Starts bringing colours.
    pub fn bring(&mut self) {
        (self.is_on, self.is_stale) = (true, true);
    }

    /// Notes that a scene drew something.
    pub fn drawn(&mut self) {
        self.is_stale = true;
    }

    /// Requests the colours of what is drawn without. The caller does so while nothing is in flight.
    pub fn want(&mut self, loader: &mut Loader, outline: Option<&mut Outline>, scenes: &Named<Moving<Scenes>>) {
        if !self.is_on || !loader.has_colours() || !std::mem::take(&mut self.is_stale) {
            return;
        }
        let wanted = |of| -> Vec<_> { scenes.things().flat_map(|scene| scene.thing.unpainted(of, PAINTED)).collect() };
        loader.want_colours(&wanted(Part::Pages));
        outline.and_then(Outline::loader).into_iter().for_each(|far| far.want_colours(&wanted(Part::Level)));
    }

    /// Gives up what a loader was asked for, until the next [`want`](Self::want).
    pub fn give_up(&mut self, loader: &mut Loader) {
        if self.is_on {
            loader.want_colours(&[]);
            self.is_stale = true;
        }
    }

    /// Number of pages that wait for colours, including those of an overview level.
    pub fn unpainted(&self, scenes: &Named<Moving<Scenes>>, loader: &Loader, outline: Option<&Outline>) -> u32 {
        let of = |of| scenes.things().map(|scene| scene.thing.unpainted(of, usize::MAX).len() as u32).sum::<u32>();
        match self.is_on && loader.has_colours() {
            true => of(Part::Pages) + if outline.is_some_and(Outline::has_colours) { of(Part::Level) } else { 0 },
            false => 0,
        }
    }

    /// Paints the next page; returns the scene that draws it, its name, and its paint. Damaged colours are reported
    /// once.
    pub fn paint(
        &mut self,
        scenes: &mut Named<Moving<Scenes>>,
        loader: &mut Loader,
        mut outline: Option<&mut Outline>,
        mut report: impl FnMut(&Error),
    ) -> Option<(u32, u32, Paint)> {
        loop {
            if let Some((of, key, colours, waiting)) = &mut self.came {
                while let Some(name) = waiting.pop() {
                    let drawn = scenes.get_mut(name).and_then(|scene| scene.thing.paint(*of, *key));
                    if let Some((page, coarseness)) = drawn {
                        return Some((name, page, Paint::new(colours, coarseness)));
                    }
                }
                self.came = None;
            }
            let near = loader.take_colours().map(|came| (Part::Pages, came));
            let far = || outline.as_deref_mut()?.loader()?.take_colours().map(|came| (Part::Level, came));
            let (of, (key, colours)) = near.or_else(far)?;
            match colours {
                Ok(colours) => self.came = Some((of, key, colours, scenes.0.iter().map(|(name, _)| *name).collect())),
                Err(error) => {
                    report(&error);
                    // Prevents further requests for damaged colours; others are requested again by the loader.
                    let is_damaged = !matches!(error, Error::Io { .. });
                    for (_, scene) in scenes.0.iter_mut().filter(|_| is_damaged) {
                        let _ = scene.thing.paint(of, key);
                    }
                }
            }
            self.is_stale = true;
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
