//! Where the bytes of an archive come from.

mod source;

pub(crate) use source::read_exact_at;
pub use source::{ByteSource, FileSource, MapSource, MemorySource};
