//! On macOS, leaves Python's symbols undefined at link time; they resolve when Python loads the module.

fn main() {
    pyo3_build_config::add_extension_module_link_args();
}
