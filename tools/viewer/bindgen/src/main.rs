//! `viewer-bindgen ENGINE.wasm FOLDER`: what `wasm-bindgen --target web` writes, without building its test runner.

fn main() {
    let [module, folder] = &std::env::args().skip(1).collect::<Vec<_>>()[..] else {
        eprintln!("usage: viewer-bindgen ENGINE.wasm FOLDER");
        std::process::exit(2);
    };
    let mut bindgen = wasm_bindgen_cli_support::Bindgen::new();
    let written = bindgen.input_path(module).web(true).and_then(|bindgen| {
        bindgen
            .out_name("engine")
            .omit_default_module_path(false)
            .typescript(true)
            .remove_name_section(true)
            .remove_producers_section(true)
            .generate(folder)
    });
    if let Err(error) = written {
        eprintln!("viewer-bindgen: {module}: {error:#}");
        std::process::exit(1);
    }
}
