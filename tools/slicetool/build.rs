//! With the feature `page`, lists the files of the built page for `src/web/page.rs`. Without a built page the list is empty,
//! and the program looks for a folder as it does without the feature.

use std::fmt::Write;
use std::path::{Path, PathBuf};

const MOST_DEPTH: usize = 8;

fn main() -> std::io::Result<()> {
    println!("cargo::rerun-if-env-changed=SLICEWALK_PAGE");
    let root = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let viewer = root.join("../viewer");
    let named = std::env::var_os("SLICEWALK_PAGE").map(PathBuf::from);
    let folder = named.clone().unwrap_or_else(|| viewer.join("dist"));
    let mut list = String::from("&[\n");
    if std::env::var_os("CARGO_FEATURE_PAGE").is_some() {
        // Cargo takes a folder that does not exist as changed, and would compile the program each time.
        let watched = if named.is_none() && !folder.exists() { &viewer } else { &folder };
        println!("cargo::rerun-if-changed={}", watched.display());
        if folder.join("index.html").is_file() {
            add(&folder.canonicalize()?, "", MOST_DEPTH, &mut list)?;
        } else {
            println!("cargo::warning=no page is built into slicetool: {} has no index.html", folder.display());
        }
    }
    list.push(']');
    let out = PathBuf::from(std::env::var_os("OUT_DIR").unwrap_or_default());
    std::fs::write(out.join("page.rs"), list)
}

/// Adds the regular files of a folder in the order of their names. Links and hidden files are not part of a page.
fn add(folder: &Path, prefix: &str, depth: usize, list: &mut String) -> std::io::Result<()> {
    let mut entries = std::fs::read_dir(folder)?.collect::<Result<Vec<_>, _>>()?;
    entries.sort_by_key(std::fs::DirEntry::file_name);
    for entry in entries {
        let (kind, path) = (entry.file_type()?, entry.path());
        let Ok(name) = entry.file_name().into_string() else { continue };
        if name.starts_with('.') || kind.is_symlink() {
            continue;
        }
        let name = format!("{prefix}{name}");
        if kind.is_dir() && depth > 0 {
            add(&path, &format!("{name}/"), depth - 1, list)?;
        } else if kind.is_file() {
            // Writing to a string never fails.
            let _ = writeln!(list, "    ({name:?}, include_bytes!({:?}).as_slice()),", path.to_string_lossy());
        }
    }
    Ok(())
}
