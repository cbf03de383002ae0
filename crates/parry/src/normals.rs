//! Directions that a contact with a part may take.

use parry3d::math::Vector;
use parry3d::query::details::NormalConstraints;

/// The sides of a part whose neighbours are level with it: bits of [`Part::level`](crate::parts::Part::level).
#[derive(Debug, Clone, Copy)]
pub struct Sides(pub u8);

/// Share of a direction that must be left for it to count.
const LEAST: f32 = 0.1;

impl NormalConstraints for Sides {
    fn project_local_normal_mut(&self, normal: &mut Vector) -> bool {
        // The edge that a direction leads over: a level one is a seam of the surface, not an edge.
        let (top, bottom) = (self.0 & 15, self.0 >> 4);
        let level = if normal.z > 0.0 {
            top
        } else if normal.z < 0.0 {
            bottom
        } else {
            top & bottom
        };
        let closed = |value: f32, low: u8| value < 0.0 && level & low != 0 || value > 0.0 && level & low << 1 != 0;
        if closed(normal.x, 1) {
            normal.x = 0.0;
        }
        if closed(normal.y, 4) {
            normal.y = 0.0;
        }
        let length = normal.length();
        if length < LEAST {
            return false;
        }
        *normal /= length;
        true
    }
}
