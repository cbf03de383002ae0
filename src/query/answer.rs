//! Answers that can also name missing pages.

use crate::store::Missing;

/// Result of an overlap query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Overlap {
    /// The shape touches nothing solid.
    Clear,
    /// The shape touches solid space, or may within the bounds that the [module text](crate::query) states.
    Hit,
    /// The shape touches nothing solid in the pages in memory, but the missing pages could change that.
    NotLoaded(Missing),
}

/// An answer, or the missing pages on which it depends.
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

    /// Returns the answer if it is known.
    pub fn known(self) -> Option<T> {
        match self {
            Self::Known(value) => Some(value),
            Self::NotLoaded(_) => None,
        }
    }
}
