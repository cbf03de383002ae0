//! Files: points as LAS, LAZ, E57 or text, splats as 3DGS PLY, surfaces as JSON and OBJ.

mod cloud;
mod json;
mod las;
mod obj;
mod record;
mod splats;
mod texture;

pub use cloud::{CloudFormat, write_clouds};
pub use json::{truth_json, write_truth_json};
pub use las::{Chunks, WriteSpec, Written, write_las, write_samples};
pub use obj::write_triangles_obj;
pub use splats::{SplatLook, write_splats};
pub use texture::Texture;
