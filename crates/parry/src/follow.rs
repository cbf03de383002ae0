//! Window that follows a moving body.

use crate::window::{Options, Window};
use parry3d::bounding_volume::{Aabb, BoundingVolume};
use parry3d::math::{Real, Vector};
use slicewalk::Result;
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::store::Snapshot;

/// Keeps a window around a body, and creates the next one before the body leaves it.
#[derive(Debug, Clone)]
pub struct Follow {
    options: Options,
    reach: f64,
    window: Option<Window>,
}

impl Follow {
    /// Creates the follower of a body that moves less than `reach` (m, > 0) between two calls of
    /// [`update`](Self::update). A window reaches three times as far, so a new one is created about every two `reach`.
    pub fn new(options: Options, reach: f64) -> Self {
        Self { options, reach, window: None }
    }

    /// Returns a new window if one is needed: at the first call, when the body comes nearer to the window's end than
    /// `reach`, and while pages are missing. `body` is the body's box in the coordinates of the shape.
    ///
    /// Give the new window to the collider (`set_shape`). Fails like [`Window::new`].
    pub fn update(&mut self, set: &Snapshot, body: &Aabb) -> Result<Option<Window>> {
        let inner = body.loosened(self.reach as Real);
        let is_enough = |window: &Window| window.missing().is_empty() && window.bounds().contains(&inner);
        if self.window.as_ref().is_some_and(is_enough) {
            return Ok(None);
        }
        let place = |corner: Vector, by: f64| -> Point3<f64> {
            let corner = Vector3::new(corner.x, corner.y, corner.z).map(f64::from);
            self.options.origin + corner + Vector3::repeat(by)
        };
        let far = 3.0 * self.reach;
        let window = Window::new(set, place(body.mins, -far), place(body.maxs, far), &self.options)?;
        self.window = Some(window.clone());
        Ok(Some(window))
    }

    /// Returns the current window.
    pub fn window(&self) -> Option<&Window> {
        self.window.as_ref()
    }
}
