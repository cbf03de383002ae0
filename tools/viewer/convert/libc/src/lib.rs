//! `libzstd-rs-sys` names these types and functions of C; the crate `libc` has none of them for WebAssembly without a
//! system. The functions for memory are called by configurations that this module does not use.
#![allow(non_camel_case_types)]
#![no_std]

pub use core::ffi::{c_char, c_int, c_long, c_uint, c_ulong, c_ulonglong, c_void};

pub type size_t = usize;
pub type ptrdiff_t = isize;

/// Copies `len` bytes, as C does.
///
/// # Safety
///
/// `to` and `from` are valid for `len` bytes and do not overlap.
pub unsafe fn memcpy(to: *mut c_void, from: *const c_void, len: size_t) -> *mut c_void {
    // SAFETY: the caller's condition.
    unsafe { core::ptr::copy_nonoverlapping(from.cast::<u8>(), to.cast::<u8>(), len) };
    to
}

/// Compares `len` bytes, as C does.
///
/// # Safety
///
/// `a` and `b` are valid for `len` bytes.
pub unsafe fn memcmp(a: *const c_void, b: *const c_void, len: size_t) -> c_int {
    // SAFETY: the caller's condition.
    let of = |at: *const c_void| unsafe { core::slice::from_raw_parts(at.cast::<u8>(), len) };
    of(a).cmp(of(b)) as c_int
}

/// Has no memory to give: the translation's own allocator is used.
///
/// # Safety
///
/// None.
pub unsafe fn malloc(_: size_t) -> *mut c_void {
    core::ptr::null_mut()
}

/// Has no memory to give: the translation's own allocator is used.
///
/// # Safety
///
/// None.
pub unsafe fn calloc(_: size_t, _: size_t) -> *mut c_void {
    core::ptr::null_mut()
}

/// Takes back what [`malloc`] gave: nothing.
///
/// # Safety
///
/// None.
pub unsafe fn free(_: *mut c_void) {}
