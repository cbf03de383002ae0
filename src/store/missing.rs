//! The pages that an answer needed and that are not in memory.

use crate::frame::PageKey;

/// Most keys that [`Missing`] names; more are only counted.
pub const MISSING_KEYS: usize = 16;

/// Pages that a query needed and that are not in memory. Holds its keys inline: making one allocates nothing.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Missing {
    keys: [PageKey; MISSING_KEYS],
    count: u32,
}

impl Missing {
    /// One missing page.
    #[cold]
    pub(crate) fn one(key: PageKey) -> Self {
        Self { keys: [key; MISSING_KEYS], count: 1 }
    }

    /// Counts `key`, unless it is among the keys named already.
    #[cold]
    pub(crate) fn push(&mut self, key: PageKey) {
        if self.keys().contains(&key) {
            return;
        }
        if let Some(free) = self.keys.get_mut(self.count as usize) {
            *free = key;
        }
        self.count = self.count.saturating_add(1);
    }

    /// The first [`MISSING_KEYS`] missing pages, each once.
    pub fn keys(&self) -> &[PageKey] {
        &self.keys[..self.keys.len().min(self.count as usize)]
    }

    /// Number of missing pages; exact up to [`MISSING_KEYS`], beyond that a page may be counted twice.
    pub fn count(&self) -> usize {
        self.count as usize
    }
}

impl std::fmt::Debug for Missing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} missing: ", self.count)?;
        f.debug_list().entries(self.keys().iter().map(|key| format_args!("{key}").to_string())).finish()
    }
}

/// Adds `key` to pages missing so far.
#[cold]
pub(crate) fn note(missing: &mut Option<Missing>, key: PageKey) {
    match missing {
        Some(missing) => missing.push(key),
        None => *missing = Some(Missing::one(key)),
    }
}

/// Adds the pages that `more` names to those missing so far.
#[cold]
pub(crate) fn join(missing: &mut Option<Missing>, more: &Missing) {
    more.keys().iter().for_each(|key| note(missing, *key));
}
