//! A scene of which some pages are not in memory.

use slicewalk::frame::PageKey;
use slicewalk::store::Snapshot;
use std::collections::BTreeSet;

/// All pages of a scene, some of them in memory.
pub struct Part {
    scene: Snapshot,
    loaded: BTreeSet<PageKey>,
    now: Snapshot,
}

impl Part {
    /// Starts with none of the pages in memory.
    pub fn new(scene: Snapshot) -> Self {
        Self { now: scene.keep_loaded(|_| false), loaded: BTreeSet::new(), scene }
    }

    /// Loads pages; returns how many were missing.
    pub fn load(&mut self, keys: &[PageKey]) -> usize {
        let before = self.loaded.len();
        for key in keys {
            assert!(self.scene.is_loaded(*key).is_some(), "{key} is no page of the scene");
            self.loaded.insert(*key);
        }
        self.now = self.scene.keep_loaded(|key| self.loaded.contains(&key));
        self.loaded.len() - before
    }
}

impl std::ops::Deref for Part {
    type Target = Snapshot;

    fn deref(&self) -> &Snapshot {
        &self.now
    }
}
