//! Slice archives as collision shapes of parry, and with it of rapier.
//!
//! A [`Window`] is a parry [`Shape`](parry3d::shape::Shape) of the solid in a box of a scan: one cuboid for each span,
//! exactly as long, wide and high as the span is in the archive, with `f32` coordinates from an origin that the program
//! chooses near the body. parry's own dispatcher handles it as a composite shape, so everything that parry and rapier
//! offer works without another dispatcher: rays, projections, distances, shape casts, contacts, the character
//! controller. [`Follow`] makes the next window before a body leaves the present one.
//!
//! Memory follows the window, not the scan: about 130 bytes a span. The pages themselves stay as they are, all in a
//! [`Snapshot`](slicewalk::store::Snapshot) or those around bodies in a [`Stream`](slicewalk::store::Stream).
//!
//! **Exactness.** The cuboids are those that the queries of `slicewalk` answer by, rounded to `f32`: at 20 m from the
//! origin by a few µm. Contacts of balls, capsules, cylinders and other bodies except cuboids take no direction that
//! leads into a neighbouring span whose face is as high, so that bodies roll over seams between pixels without bumps;
//! see [`Options::level`]. parry gives cuboid bodies no such choice.
//!
//! **Missing pages** of a stream are solid by default, never free by accident: [`Unloaded`].

mod follow;
mod normals;
mod parts;
mod window;

pub use follow::Follow;
pub use window::{Options, Unloaded, Window};
