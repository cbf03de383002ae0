//! Writes a scene as an archive into the folder given, and beside it what the native library says about it.

#[path = "../../../../tests/stream/tower.rs"]
mod tower;

use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::store::Store;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: record FOLDER")?;
    let folder = Path::new(&folder);
    let bytes = tower::tower(4.0, 6.5, 3);
    let archive = Archive::from_bytes(bytes.clone())?;
    let store = Store::resident(&archive, &NoMonitor)?;
    let write = |name: &str, words: Vec<u64>| {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        std::fs::write(folder.join(name), bytes)
    };
    write("answers.bin", wasm_check::answers(&store))?;
    write("path.bin", wasm_check::path(&store))?;
    write("streamed.bin", wasm_check::streamed_path(&bytes))?;
    std::fs::write(folder.join("scene.slices"), bytes)?;
    Ok(())
}
