//! Streams: the pages around moving bodies under a byte budget.

use crate::archive::sw_archive;
use crate::border::{
    Failure, Handle, Outcome, Sized32, close, fill, give, guard, held, input, place, record, sized, sw_status,
};
use crate::pages::sw_pages;
use engine::frame::PageKey;
use engine::nalgebra::{Point3, Vector3};
use engine::store::{LoadReport, MotionHint, PawnHandle, Prefetch, Stream, StreamOptions};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The pages around moving bodies under a byte budget. Any number of threads may use it at once.
pub struct sw_stream;

impl Handle for sw_stream {
    type Value = Arc<Stream>;
    const NAME: &'static str = "sw_stream";
}

/// The hints of one moving body. One thread at a time: another one gets `SW_ERROR_BUSY`.
pub struct sw_body;

impl Handle for sw_body {
    type Value = Mutex<PawnHandle>;
    const NAME: &'static str = "sw_body";
}

/// Options of a stream.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sw_stream_options {
    /// `sizeof(sw_stream_options)`.
    pub size: u32,
    /// 1: a thread of the library loads pages ahead of the bodies; 0: only `sw_stream_load` loads pages.
    pub prefetch: u32,
    /// Memory limit of the stream (bytes).
    pub budget: u64,
}

// SAFETY: `repr(C)`, the size first, and numbers only.
unsafe impl Sized32 for sw_stream_options {
    const NAME: &'static str = "sw_stream_options";
}

/// Result of `sw_stream_load`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sw_loaded {
    /// `sizeof(sw_loaded)`, set by the caller.
    pub size: u32,
    /// Reserved; 0.
    pub reserved: u32,
    /// Pages that were loaded.
    pub loaded: u64,
    /// Pages that were in memory already.
    pub already: u64,
    /// Pages that did not fit in the budget.
    pub left_out: u64,
    /// Budget that the pages of the largest box need (bytes).
    pub needed: u64,
}

// SAFETY: `repr(C)`, the size first, and numbers only.
unsafe impl Sized32 for sw_loaded {
    const NAME: &'static str = "sw_loaded";
}

impl sw_loaded {
    fn of(report: &LoadReport) -> Self {
        Self {
            size: size_of::<Self>() as u32,
            reserved: 0,
            loaded: report.loaded as u64,
            already: report.already as u64,
            left_out: report.left_out as u64,
            needed: report.needed_bytes as u64,
        }
    }
}

/// Opens a stream on an archive; no page is loaded yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_stream_open(
    archive: *const sw_archive,
    options: *const sw_stream_options,
    stream: *mut *mut sw_stream,
) -> sw_status {
    guard(|| {
        let made = || {
            // SAFETY: as the header demands of handles and structs.
            let (opened, options) = unsafe { (held(archive)?, record(options)?) };
            let prefetch = match options.prefetch {
                0 => Prefetch::Off,
                1 => Prefetch::Thread,
                other => {
                    let text = format!("sw_stream_options.prefetch: expected 0 or 1, found {other}");
                    return Err(Failure::argument(text));
                }
            };
            let budget = usize::try_from(options.budget).unwrap_or(usize::MAX);
            let options = StreamOptions { prefetch, ..StreamOptions::new(budget) };
            Ok(Arc::new(Stream::open(opened.again()?, options)?))
        };
        // SAFETY: as the header demands of `stream`.
        unsafe { give(stream, made) }
    })
}

/// Creates the set of pages that are in memory now. Never waits. Create one per frame and close it with the frame,
/// because pages in a set count against the budget.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_stream_view(stream: *const sw_stream, pages: *mut *mut sw_pages) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles and `pages`.
        unsafe { give(pages, || Ok(held(stream)?.snapshot())) }
    })
}

fn resting(&[x0, y0, z0, x1, y1, z1]: &[f64; 6]) -> MotionHint {
    let (min, max) = (Point3::new(x0, y0, z0), Point3::new(x1, y1, z1));
    MotionHint { min, max, velocity: Vector3::zeros(), gravity: 0.0, terminal_speed: 0.0, agility: 0.0 }
}

/// Loads the pages that boxes touch, and waits for them: `boxes_len` numbers, 6 for each box. `report` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_stream_load(
    stream: *const sw_stream,
    boxes: *const f64,
    boxes_len: usize,
    report: *mut sw_loaded,
) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of `report`.
        unsafe { reports(report) }?;
        // SAFETY: as the header demands of handles and arrays.
        let (stream, boxes) = unsafe { (held(stream)?, input(boxes, boxes_len, "boxes")?) };
        let (rows, rest) = boxes.as_chunks::<6>();
        if !rest.is_empty() {
            return Err(Failure::argument(format!(
                "boxes: expected 6 numbers for each box, found {boxes_len} numbers"
            )));
        }
        let mut sum = LoadReport::default();
        for (number, row) in rows.iter().enumerate() {
            let wrong = |error| Failure::from(error).of_row("boxes", number);
            let one = stream.load_around(&resting(row)).map_err(wrong)?;
            sum.loaded += one.loaded;
            sum.already += one.already;
            sum.left_out += one.left_out;
            sum.needed_bytes = sum.needed_bytes.max(one.needed_bytes);
        }
        // SAFETY: as the header demands of `report`.
        unsafe { reported(report, &sum) }
    })
}

/// Loads pages by their keys, 3 numbers each (`sw_walker_missing` writes them), and waits for them. `report` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_stream_load_pages(
    stream: *const sw_stream,
    keys: *const i32,
    keys_len: usize,
    report: *mut sw_loaded,
) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of `report`.
        unsafe { reports(report) }?;
        // SAFETY: as the header demands of handles and arrays.
        let (stream, keys) = unsafe { (held(stream)?, input(keys, keys_len, "keys")?) };
        let (rows, rest) = keys.as_chunks::<3>();
        if !rest.is_empty() {
            return Err(Failure::argument(format!("keys: expected 3 numbers for each page, found {keys_len} numbers")));
        }
        let keys: Vec<PageKey> = rows.iter().map(|&[tx, ty, layer]| PageKey { tx, ty, layer }).collect();
        let loaded = keys.first().map_or(Ok(LoadReport::default()), |&first| stream.load(&keys, first))?;
        // SAFETY: as the header demands of `report`.
        unsafe { reported(report, &loaded) }
    })
}

/// Checks `report` before pages are loaded.
///
/// # Safety
/// The conditions of [`sized`] hold.
unsafe fn reports(report: *const sw_loaded) -> Outcome {
    if report.is_null() {
        return Ok(());
    }
    // SAFETY: guaranteed by the caller.
    unsafe { sized(report) }
}

/// # Safety
/// The conditions of [`fill`] hold, except that NULL is allowed.
unsafe fn reported(at: *mut sw_loaded, report: &LoadReport) -> Outcome {
    if at.is_null() {
        return Ok(());
    }
    // SAFETY: guaranteed by the caller.
    unsafe { fill(at, sw_loaded::of(report)) }
}

/// Waits at most `seconds` until all pages that hints ask for are loaded. `done` gets 1 if they are, else 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_stream_settle(stream: *const sw_stream, seconds: f64, done: *mut u32) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles and `done`.
        let (stream, done) = unsafe { (held(stream)?, place(done, "done")?) };
        let wrong = |_| Failure::argument(format!("seconds: expected 0 or more, found {seconds}"));
        let most = Duration::try_from_secs_f64(seconds).map_err(wrong)?;
        done.write(stream.settle(most).into());
        Ok(())
    })
}

/// Closes a stream and ends its thread. Page sets, bodies and walkers stay open. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_stream_close(stream: *mut sw_stream) -> sw_status {
    // SAFETY: as the header demands of handles.
    unsafe { close(stream) }
}

/// Adds a body; the stream loads pages ahead of its motion. Walkers of `sw_walker_step_stream` do not need one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_body_open(stream: *const sw_stream, body: *mut *mut sw_body) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles and `body`.
        unsafe { give(body, || Ok(Mutex::new(held(stream)?.pawn()))) }
    })
}

/// Sets how a body moves now: 6 numbers of the box around all queries of a frame (m), and 3 of its velocity (m/s). Call
/// it once a frame; it never waits.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_body_hint(body: *const sw_body, around: *const f64, velocity: *const f64) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles and arrays.
        let (body, around, velocity) =
            unsafe { (held(body)?, numbers(around, "around")?, numbers(velocity, "velocity")?) };
        let [x0, y0, z0, x1, y1, z1] = around;
        let motion_hint = MotionHint::walking([x0, y0, z0].into(), [x1, y1, z1].into(), Vector3::from(velocity));
        if !motion_hint.is_valid() {
            return Err(Failure::argument("around, velocity: expected finite numbers, and minima up to maxima"));
        }
        let mut body = body.try_lock().map_err(|_| busy("body"))?;
        body.hint(&motion_hint);
        Ok(())
    })
}

/// Removes a body. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_body_close(body: *mut sw_body) -> sw_status {
    // SAFETY: as the header demands of handles.
    unsafe { close(body) }
}

/// Copies `N` finite numbers.
///
/// # Safety
/// The conditions of [`input`] hold for `N` elements.
pub unsafe fn numbers<const N: usize>(pointer: *const f64, what: &str) -> Outcome<[f64; N]> {
    // SAFETY: guaranteed by the caller.
    let numbers = unsafe { input(pointer, N, what) }?;
    match <[f64; N]>::try_from(numbers) {
        Ok(numbers) if numbers.iter().all(|v| v.is_finite()) => Ok(numbers),
        _ => Err(Failure::argument(format!("{what}: expected {N} finite numbers, found {numbers:?}"))),
    }
}

/// Returns the failure of a call on an object that another thread uses, or that a panic left unfinished.
pub fn busy(what: &str) -> Failure {
    let text = format!("another thread uses this {what}; give each thread its own, or take turns");
    Failure(sw_status::SW_ERROR_BUSY, text)
}
