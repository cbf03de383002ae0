//! `viewer-bindgen ENGINE.wasm FOLDER`: writes the output of `wasm-bindgen --target web` without building its test
//! runner, and drops the exports of zstd's C code, which nothing outside calls.

use wasm_bindgen_cli_support::Bindgen;

fn main() {
    let [module, folder] = &std::env::args().skip(1).collect::<Vec<_>>()[..] else {
        eprintln!("usage: viewer-bindgen ENGINE.wasm FOLDER");
        std::process::exit(2);
    };
    let written = without_shims(module).and_then(|module| {
        let mut bindgen = Bindgen::new();
        bindgen.input_bytes("engine", module).web(true)?;
        bindgen.omit_default_module_path(false).typescript(true);
        bindgen.remove_name_section(true).remove_producers_section(true).generate(folder)
    });
    if let Err(error) = written {
        eprintln!("viewer-bindgen: {module}: {error:#}");
        std::process::exit(1);
    }
}

fn without_shims(path: &str) -> walrus::Result<Vec<u8>> {
    let mut module = walrus::Module::from_file(path)?;
    let shims = module.exports.iter().filter(|export| export.name.starts_with("rust_zstd_wasm_shim_"));
    let shims: Vec<_> = shims.map(|export| export.id()).collect();
    shims.into_iter().for_each(|shim| module.exports.delete(shim));
    walrus::passes::gc::run(&mut module);
    Ok(module.emit_wasm())
}
