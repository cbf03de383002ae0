//! Conversion of scans in the browser: the crates that `sliceconv` is made of, as one WebAssembly module without
//! imports but those of [`host`].
//!
//! The program that runs it calls [`allocate`], writes a request as JSON there and calls [`run`]; [`answer`] and
//! [`answer_len`] then say where the answer is. A request:
//!
//! ```json
//! {"task": "convert", "inputs": [{"name": "scan.laz", "file": 0, "length": 1234}], "options": {"pixel": 0.05}}
//! ```
//!
//! `file` is the number by which the host reads an input. Names have no folders: the second input of a name is read as
//! `2/scan.laz`, the third as `3/scan.laz`. `"task": "preview"` answers what `sliceconv --dry-run --json` prints, without
//! passing over the points, and whether the input says its unit (`unit_stated`). The answer to `convert` has the `report`
//! that `sliceconv --json` prints, and the number and length of the host's `file` that holds the archive; or an `error`,
//! with the `parameter` that helps.
//!
//! One thread, memory by the option `memory`; the archive has the bytes that `sliceconv` writes with the same options.

mod host;
mod options;

use host::{HostDisk, HostMonitor, HostSource};
use serde_json::{Value, json};
use slicewalk_base::bytes::{held, hold_source, release_sources};
use slicewalk_base::disk;
use slicewalk_base::{Error, Parameter, Result};
use slicewalk_convert::{ConvertOptions, PixelSize, convert, preview};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Memory budget (bytes) unless the options name another. With the page, 150 MiB, and buffers that the browser has not
/// collected, a file of any size is converted in about 500 MiB.
const MEMORY_BYTES: u64 = 112 << 20;
/// Folder of all files, as errors name it, and the archive in it.
const FOLDER: &str = "/browser storage";
const OUTPUT: &str = "/browser storage/scan.slices";

thread_local! {
    static REQUEST: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    static ANSWER: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// Makes room for a request of `len` bytes and returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn allocate(len: usize) -> *mut u8 {
    REQUEST.with_borrow_mut(|request| {
        request.clear();
        request.resize(len, 0);
        request.as_mut_ptr()
    })
}

/// Answers the request.
#[unsafe(no_mangle)]
pub extern "C" fn run() {
    slicewalk::codec::set_compressor(compress);
    let request = REQUEST.take();
    let answer = serde_json::from_slice::<Value>(&request).map_or_else(
        |error| json!({ "error": error.to_string() }),
        |request| answer_to(&request).unwrap_or_else(|error| error_info(&error)),
    );
    release_sources();
    ANSWER.set(answer.to_string().into_bytes());
}

/// Returns the address of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn answer() -> *const u8 {
    ANSWER.with_borrow(|answer| answer.as_ptr())
}

/// Returns the length of the answer (bytes).
#[unsafe(no_mangle)]
pub extern "C" fn answer_len() -> usize {
    ANSWER.with_borrow(Vec::len)
}

fn answer_to(request: &Value) -> Result<Value> {
    let mut inputs = Vec::new();
    let given = || request["inputs"].as_array().into_iter().flatten();
    for input in given() {
        let own = input["name"].as_str().unwrap_or("scan");
        let (mut name, mut number) = (PathBuf::from(own), 1);
        while held(&name).is_some() {
            number += 1;
            name = PathBuf::from(format!("{number}/{own}"));
        }
        // Which of them a mesh names, or which mesh a file lies beside, is not known.
        if number > 1 && given().any(|input| input["beside"] == true) {
            let reason = format!("two files are called {own}; convert them one after the other, or rename one");
            return Err(Error::parameter("inputs", reason));
        }
        let file = input["file"].as_u64().unwrap_or(0) as u32;
        let len = input["length"].as_u64().unwrap_or(0);
        hold_source(&name, HostSource { name: name.clone(), file, len });
        // A file beside a mesh, such as its materials, is read only if the mesh names it.
        if input["beside"] != true {
            inputs.push(name);
        }
    }
    let mut options = ConvertOptions::new(inputs, OUTPUT.into());
    options.resources.memory_bytes = MEMORY_BYTES;
    options.resources.threads = 1;
    options.resources.temp_dir = FOLDER.into();
    options::apply(&mut options, &request["options"])?;
    let (files, monitor) = (Arc::new(HostDisk::default()), HostMonitor::default());
    if request["task"] == "preview" {
        if options.grid.pixel == PixelSize::Auto {
            // The form must not wait for a pass over the points.
            options.grid.pixel = PixelSize::Metres(1.0);
        }
        options.grid.tolerance_auto = false;
        let mut facts = disk::with(files, || preview(&options, &monitor))?.info();
        facts["unit_stated"] = (!monitor.assumed_unit.get()).into();
        return Ok(json!({ "preview": facts }));
    }
    let report = disk::with(files.clone(), || convert(&options, &monitor))?;
    let (file, length) = files.take(Path::new(OUTPUT)).unwrap_or_default();
    Ok(json!({ "report": report.info(), "file": file, "length": length }))
}

fn error_info(error: &Error) -> Value {
    let parameter = match error {
        Error::Parameter { what, .. } => Some(what),
        _ => error.suggestion(),
    };
    // The page has fields for these, and no command line.
    let field = |parameter: &Parameter| match parameter {
        Parameter::Units => Some("choose its unit"),
        Parameter::PixelSize => Some("choose a larger pixel size, or the unit"),
        Parameter::Columns => Some("name its columns"),
        Parameter::Incomplete => Some("or take what can be read"),
        Parameter::TempDir => Some("free some space of this browser's storage"),
        _ => None,
    };
    json!({ "error": error.render(field), "parameter": parameter.map(|what| format!("{what:?}")) })
}

/// Appends the zstd frame of `raw` to `out`.
fn compress(raw: &[u8], out: &mut Vec<u8>) {
    use libzstd_rs_sys::{ZSTD_compress, ZSTD_compressBound, ZSTD_isError};
    let start = out.len();
    out.resize(start + ZSTD_compressBound(raw.len()), 0);
    let room = &mut out[start..];
    let level = slicewalk::codec::LEVEL;
    // SAFETY: both slices are valid for their lengths and do not overlap.
    let len = unsafe { ZSTD_compress(room.as_mut_ptr().cast(), room.len(), raw.as_ptr().cast(), raw.len(), level) };
    assert!(ZSTD_isError(len) == 0, "room for the longest frame");
    out.truncate(start + len);
}
