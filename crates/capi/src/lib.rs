//! The C interface of Slicewalk: `slicewalk.h`, prefix `sw_`.
//!
//! [`border`] is the only file that turns pointers into references. It checks what a C caller can get wrong and can be
//! checked: null, alignment, lengths, overlap of input and output, the kind of a handle. Everything else works on
//! slices and values. No panic leaves a function: it becomes `SW_ERROR_INTERNAL`.
//!
//! cbindgen writes the header from these files; `tests/header.rs` fails if the header is not current.

// Types have the names that C programs write.
#![allow(non_camel_case_types)]
// The contract of every pointer is the header's: its first paragraphs and the function's own text.
#![allow(clippy::missing_safety_doc)]

mod archive;
mod border;
mod pages;
mod route;
mod seen;
mod stream;
mod walker;
