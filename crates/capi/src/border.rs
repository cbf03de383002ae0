//! Statuses, the text of the last error, and every conversion of a pointer.

use engine::Error;
use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::mem::MaybeUninit;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Outcome of a call. `sw_last_error` returns the text of an error.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum sw_status {
    /// Done.
    SW_OK = 0,
    /// A pointer, length, handle or number is not allowed.
    SW_ERROR_ARGUMENT = 1,
    /// The operating system or a callback refused an action.
    SW_ERROR_IO = 2,
    /// The archive is damaged, or the file is not an archive.
    SW_ERROR_FORMAT = 3,
    /// A value lies beyond a limit, such as a budget.
    SW_ERROR_LIMIT = 4,
    /// The archive uses a feature that this version does not read.
    SW_ERROR_UNSUPPORTED = 5,
    /// The answer depends on pages that are not in memory.
    SW_ERROR_NOT_LOADED = 6,
    /// No route connects the places, or the pawn cannot stand at one of them.
    SW_ERROR_NO_ROUTE = 7,
    /// Another thread is using this walker or body.
    SW_ERROR_BUSY = 8,
    /// A defect of the library.
    SW_ERROR_INTERNAL = 9,
}

/// Status and text of a failed call.
#[derive(Debug)]
pub struct Failure(pub sw_status, pub String);

/// Result of the inside of a call.
pub type Outcome<T = ()> = Result<T, Failure>;

impl Failure {
    /// Refuses an argument.
    pub fn argument(text: impl Into<String>) -> Self {
        Self(sw_status::SW_ERROR_ARGUMENT, text.into())
    }

    /// Adds the number of the row that failed.
    pub fn of_row(self, what: &str, row: usize) -> Self {
        Self(self.0, format!("{what}: row {row}: {}", self.1))
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::Format { .. } => sw_status::SW_ERROR_FORMAT,
            Error::Limit { .. } => sw_status::SW_ERROR_LIMIT,
            Error::Unsupported { .. } => sw_status::SW_ERROR_UNSUPPORTED,
            Error::Parameter { .. } => sw_status::SW_ERROR_ARGUMENT,
            _ => sw_status::SW_ERROR_IO,
        };
        Self(status, error.to_string())
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

fn remember(text: &str) {
    let bytes = text.bytes().filter(|&byte| byte != 0).collect::<Vec<u8>>();
    // A thread that ends has no text any more.
    let _ = LAST.try_with(|last| *last.borrow_mut() = CString::new(bytes).unwrap_or_default());
}

/// Runs the inside of a call, and turns failures and panics into a status and a text.
pub fn guard(work: impl FnOnce() -> Outcome) -> sw_status {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(())) => sw_status::SW_OK,
        Ok(Err(Failure(status, text))) => {
            remember(&text);
            status
        }
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no text");
            remember(&format!("defect of the library, please report it: {text}"));
            // The drop of a payload may panic as well.
            let _ = catch_unwind(AssertUnwindSafe(|| drop(panic)));
            sw_status::SW_ERROR_INTERNAL
        }
    }
}

/// Returns the text of the last failed call on this thread: one line in UTF-8 without a newline, or "" if none failed.
/// It stays valid and unchanged until another call fails on the same thread, or the thread ends.
#[unsafe(no_mangle)]
pub extern "C" fn sw_last_error() -> *const c_char {
    LAST.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

/// Version of this interface. A program runs with a library of the same number as the header that it was compiled with.
pub const SW_INTERFACE: u32 = 1;

/// Writes the interface version (`SW_INTERFACE`) of the loaded library into `version`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_interface(version: *mut u32) -> sw_status {
    // SAFETY: as the header demands of `version`.
    guard(|| unsafe { place(version, "version") }.map(|at| _ = at.write(SW_INTERFACE)))
}

fn check<T>(pointer: *const T, len: usize, what: &str) -> Outcome {
    if pointer.is_null() {
        return Err(Failure::argument(format!("{what}: expected a pointer, found NULL")));
    }
    if !pointer.is_aligned() {
        let text = format!("{what}: expected an address that is a multiple of {}, found {pointer:p}", align_of::<T>());
        return Err(Failure::argument(text));
    }
    let bytes = len.checked_mul(size_of::<T>()).filter(|&bytes| bytes <= isize::MAX as usize);
    if bytes.and_then(|bytes| pointer.addr().checked_add(bytes)).is_none() {
        return Err(Failure::argument(format!("{what}: {len} elements do not fit into memory; check the length")));
    }
    Ok(())
}

/// Returns `len` elements to read. With length 0 the pointer is not used.
///
/// # Safety
/// The pointer is null or has `len` initialised elements that do not change during the call. Every bit pattern is a
/// value of `T`.
pub unsafe fn input<'a, T: Copy>(pointer: *const T, len: usize, what: &str) -> Outcome<&'a [T]> {
    if len == 0 {
        return Ok(&[]);
    }
    check(pointer, len, what)?;
    // SAFETY: not null, aligned, of a length that fits; the rest is the caller's promise.
    Ok(unsafe { std::slice::from_raw_parts(pointer, len) })
}

/// Returns `len` elements to write, which may be uninitialised.
///
/// # Safety
/// The pointer is null or has room for `len` elements, used by no other code during the call.
pub unsafe fn output<'a, T: Copy>(pointer: *mut T, len: usize, what: &str) -> Outcome<&'a mut [MaybeUninit<T>]> {
    if len == 0 {
        return Ok(&mut []);
    }
    check(pointer, len, what)?;
    // SAFETY: not null, aligned, of a length that fits, and any bytes are a `MaybeUninit`; the rest is the caller's promise.
    Ok(unsafe { std::slice::from_raw_parts_mut(pointer.cast(), len) })
}

/// Returns one place to write.
///
/// # Safety
/// The conditions of [`output`] hold for one element.
pub unsafe fn place<'a, T: Copy>(pointer: *mut T, what: &str) -> Outcome<&'a mut MaybeUninit<T>> {
    check(pointer, 1, what)?;
    // SAFETY: not null and aligned; the rest is the caller's promise.
    Ok(unsafe { &mut *pointer.cast() })
}

/// Fails if `len` elements at `a` and `other` elements at `b` share a byte, because answers would overwrite questions.
pub fn check_apart<A, B>(a: *const A, len: usize, b: *const B, other: usize) -> Outcome {
    let end = |start: usize, len: usize, size: usize| start.saturating_add(len.saturating_mul(size));
    let (a_end, b_end) = (end(a.addr(), len, size_of::<A>()), end(b.addr(), other, size_of::<B>()));
    if len == 0 || other == 0 || a_end <= b.addr() || b_end <= a.addr() {
        return Ok(());
    }
    Err(Failure::argument("the answers overlap the questions in memory; give them an array of their own"))
}

/// Text of a C string in UTF-8.
///
/// # Safety
/// The pointer is null or a string that ends with a zero byte, unchanged during the call.
pub unsafe fn text<'a>(pointer: *const c_char, what: &str) -> Outcome<&'a str> {
    check(pointer, 1, what)?;
    // SAFETY: not null; the rest is the caller's promise.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| Failure::argument(format!("{what}: expected UTF-8")))
}

/// A struct whose first field is its own size in bytes, set by the caller.
///
/// # Safety
/// The type is `repr(C)`, its first field is a `u32`, and every bit pattern of its fields is a value.
pub unsafe trait Sized32: Copy {
    /// Its name in C.
    const NAME: &'static str;
}

/// Copies a struct that the caller filled in.
///
/// # Safety
/// The pointer is null or points to as many initialised bytes as its first field says.
pub unsafe fn record<T: Sized32>(pointer: *const T) -> Outcome<T> {
    // SAFETY: guaranteed by the caller.
    unsafe { sized(pointer) }?;
    // SAFETY: not null, aligned, and of the size of `T`, thus with all fields, whose every bit pattern is a value.
    Ok(unsafe { pointer.read() })
}

/// Fills in a struct whose size the caller set.
///
/// # Safety
/// The pointer is null or points to an initialised size and as many bytes as it states; no other code uses them during
/// the call.
pub unsafe fn fill<T: Sized32>(pointer: *mut T, value: T) -> Outcome {
    // SAFETY: guaranteed by the caller.
    unsafe { sized(pointer) }?;
    // SAFETY: not null, aligned, and of the size of `T`.
    unsafe { pointer.write(value) };
    Ok(())
}

/// Checks a struct that will be filled in, before work that takes long or changes something.
///
/// # Safety
/// The pointer is null or points to an initialised size.
pub unsafe fn sized<T: Sized32>(pointer: *const T) -> Outcome {
    check(pointer, 1, T::NAME)?;
    // SAFETY: not null and aligned; the first field is a `u32` by the contract of `Sized32`.
    let size = unsafe { pointer.cast::<u32>().read() };
    if size as usize == size_of::<T>() {
        return Ok(());
    }
    let (name, expected) = (T::NAME, size_of::<T>());
    Err(Failure::argument(format!(
        "{name}.size: expected {expected}, found {size}; set it to sizeof({name}), with the header of this library"
    )))
}

/// A kind of opaque handle.
pub trait Handle: Sized {
    /// Content of the handle.
    type Value: Any + Send + Sync;
    /// Its name in C.
    const NAME: &'static str;
}

/// Target of every handle. All kinds share this layout, so that a handle of another kind is recognised.
struct Held {
    mark: u64,
    value: Box<dyn Any + Send + Sync>,
}

/// Mark of an open handle: an arbitrary number.
const OPEN: u64 = 0x51D3_C0DE_AB1E_0001;

/// Creates a handle. `make` runs after the place for it has been checked, and checks the other arguments: on failure the
/// place holds NULL.
///
/// # Safety
/// The conditions of [`place`] hold for `at`.
pub unsafe fn give<H: Handle>(at: *mut *mut H, make: impl FnOnce() -> Outcome<H::Value>) -> Outcome {
    // SAFETY: guaranteed by the caller.
    let at = unsafe { place(at, "place of the new handle") }?;
    at.write(std::ptr::null_mut());
    let held = Box::new(Held { mark: OPEN, value: Box::new(make()?) });
    at.write(Box::into_raw(held).cast());
    Ok(())
}

/// Returns what a handle holds.
///
/// # Safety
/// The pointer is null or an open handle of any kind, and stays open during the call.
pub unsafe fn held<'a, H: Handle>(handle: *const H) -> Outcome<&'a H::Value> {
    let held = handle.cast::<Held>();
    check(held, 1, H::NAME)?;
    // SAFETY: every handle points to a `Held` of `give`, which lives until it is closed.
    let held = unsafe { &*held };
    let value = if held.mark == OPEN { held.value.downcast_ref() } else { None };
    value.ok_or_else(|| Failure::argument(format!("expected an open {}, found another handle", H::NAME)))
}

/// Closes a handle; NULL is allowed.
///
/// # Safety
/// The conditions of [`held`] hold, and no other code uses the handle during the call or later.
pub unsafe fn close<H: Handle>(handle: *mut H) -> sw_status {
    guard(|| {
        if handle.is_null() {
            return Ok(());
        }
        // SAFETY: guaranteed by the caller; checks the kind.
        unsafe { held::<H>(handle) }?;
        // SAFETY: the handle came from `Box::into_raw` in `give`, is open, and is not used again.
        let mut held = unsafe { Box::from_raw(handle.cast::<Held>()) };
        held.mark = 0;
        Ok(())
    })
}
