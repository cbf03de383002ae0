//! Answers that can also say which pages are missing.

use crate::store::Missing;

/// Whether a shape touches matter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Overlap {
    /// It touches none.
    Clear,
    /// It touches matter, or may within the bounds that the [module text](crate::query) states.
    Hit,
    /// It touches none in the pages in memory, but these pages could hold some.
    NotLoaded(Missing),
}

/// An answer, or the pages without which it is not known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer<T> {
    /// The answer.
    Known(T),
    /// These pages are not in memory and could change the answer.
    NotLoaded(Missing),
}

impl<T> Answer<T> {
    pub(super) fn new(value: T, missing: Option<Missing>) -> Self {
        missing.map_or(Self::Known(value), Self::NotLoaded)
    }

    /// The answer, if it is known.
    pub fn known(self) -> Option<T> {
        match self {
            Self::Known(value) => Some(value),
            Self::NotLoaded(_) => None,
        }
    }
}
