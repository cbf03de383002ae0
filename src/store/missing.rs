//! Missing pages of an answer.

use crate::frame::PageKey;

/// Most keys that [`Missing`] stores; further ones are only counted.
pub const MISSING_KEYS: usize = 16;

/// Pages that a query needed and that are not in memory. Stores its keys inline, so creating one allocates nothing.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Missing {
    keys: [PageKey; MISSING_KEYS],
    count: u32,
}

impl Missing {
    /// Creates a set of one missing page.
    #[cold]
    pub(crate) fn one(key: PageKey) -> Self {
        Self { keys: [key; MISSING_KEYS], count: 1 }
    }

    /// Adds `key` unless it is among the stored keys.
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

    /// Returns the first [`MISSING_KEYS`] missing pages, each once.
    pub fn keys(&self) -> &[PageKey] {
        &self.keys[..self.keys.len().min(self.count as usize)]
    }

    /// Returns the number of missing pages: exact up to [`MISSING_KEYS`]; beyond, a page may be counted twice.
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

/// Adds `key` to the missing pages.
#[cold]
pub(crate) fn note(missing: &mut Option<Missing>, key: PageKey) {
    match missing {
        Some(missing) => missing.push(key),
        None => *missing = Some(Missing::one(key)),
    }
}

/// Adds the pages that `more` names to the missing pages.
#[cold]
pub(crate) fn join(missing: &mut Option<Missing>, more: &Missing) {
    more.keys().iter().for_each(|key| note(missing, *key));
}
