//! Compiled half of the Python package `slicewalk`; the other half is in `python/slicewalk`.
//!
//! One file per subject: [`pages`] (queries), [`archive`], [`page`] (columns, pages, regions), [`stream`], [`walk`],
//! [`reach`], [`seen`], [`convert`], [`writer`]. Only [`arrays`] touches the caller's arrays; [`attend`] handles signals and
//! progress, [`errors`] exceptions.

mod archive;
mod arrays;
mod attend;
mod convert;
mod errors;
mod options;
mod page;
mod pages;
mod reach;
mod seen;
mod stream;
mod walk;
mod writer;

/// The compiled module; programs import `slicewalk`.
#[pyo3::pymodule]
mod _slicewalk {
    #[pymodule_export]
    use crate::archive::{Archive, open};
    #[pymodule_export]
    use crate::convert::{check_output, convert, input_files, merge, upload, write_export, write_plan};
    #[pymodule_export]
    use crate::page::{Column, Page};
    #[pymodule_export]
    use crate::pages::Pages;
    #[pymodule_export]
    use crate::seen::SeenSpace;
    #[pymodule_export]
    use crate::stream::{Body, Stream, View};
    #[pymodule_export]
    use crate::walk::Walker;
    #[pymodule_export]
    use crate::writer::Writer;
    use pyo3::exceptions::PyImportError;
    use pyo3::ffi;
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // SAFETY: the interpreter is held, so there is a current one.
        if unsafe { ffi::PyInterpreterState_GetID(ffi::PyInterpreterState_Get()) } != 0 {
            return Err(PyImportError::new_err("no subinterpreter is supported"));
        }
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
