//! On macOS a module that is loaded by Python leaves Python's symbols to be found then.

fn main() {
    pyo3_build_config::add_extension_module_link_args();
}
