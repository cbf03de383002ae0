//! Objects of the engine by their names in JavaScript.

use slicewalk::store::{BodyId, MotionHint};

/// A few objects by their names in JavaScript, in order of creation.
pub(crate) struct Named<T>(pub Vec<(u32, T)>);

impl<T> Named<T> {
    pub const NONE: Self = Self(Vec::new());

    pub fn insert(&mut self, name: u32, thing: T) {
        self.0.push((name, thing));
    }

    pub fn get_mut(&mut self, name: u32) -> Option<&mut T> {
        self.0.iter_mut().find(|(other, _)| *other == name).map(|(_, thing)| thing)
    }

    pub fn remove(&mut self, name: u32) -> Option<T> {
        let at = self.0.iter().position(|(other, _)| *other == name)?;
        Some(self.0.remove(at).1)
    }

    pub fn things(&self) -> impl Iterator<Item = &T> {
        self.0.iter().map(|(_, thing)| thing)
    }
}

/// An object that needs pages around it.
pub(crate) struct Moving<T> {
    pub thing: T,
    pub body: BodyId,
    pub hinted: Option<MotionHint>,
}
