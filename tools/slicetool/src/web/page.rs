//! The built page: a few files, read once and held in memory, so that no request can reach anything else on the disk.
//!
//! It is looked for in the folder that is named, in the program itself (feature `page`), beside the program, and in the
//! repository.

use super::is_same_name;
use crate::Failure;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Output folder in the repository.
const BUILT: &str = "tools/viewer/dist";
/// Program that builds it.
const BUILD: &str = "tools/viewer/build.mjs";
/// Folder beside an installed program.
const BESIDE: &str = "slicewalk-viewer";
/// Entry file of the page.
pub const INDEX: &str = "index.html";
/// Largest total size of a page; a larger folder was named by mistake.
const MOST_BYTES: u64 = 64 << 20;
const MOST_FILES: usize = 1000;
const MOST_DEPTH: usize = 8;
/// Files of the page that the program was built with, by name.
static OWN: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// Files of the page by name; `/` separates folders.
pub struct Page(BTreeMap<String, Vec<u8>>);

impl Page {
    /// Loads the page from `named`, or from beside the program or the repository.
    pub fn find(named: Option<&Path>) -> Result<Self, Failure> {
        let folder = match named {
            Some(folder) if folder.join(INDEX).is_file() => folder.to_path_buf(),
            Some(folder) => {
                let found = if folder.is_dir() { "a folder without it" } else { "no folder" };
                let text = format!("--page {}: not a built page (expected {INDEX}, found {found})", folder.display());
                return Err(Failure::Text(format!("{text}; `node {BUILD}` builds one in {BUILT}")));
            }
            None if !OWN.is_empty() => {
                return Ok(Self(OWN.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect()));
            }
            None => usual_folders().into_iter().find(|folder| folder.join(INDEX).is_file()).ok_or_else(|| {
                Failure::Text(format!(
                    "the page is not built; run `node {BUILD}` in the repository (minutes; it needs Node.js and Rust only), \
                     or take it from a release and name its folder by --page DIR"
                ))
            })?,
        };
        let mut page = Self(BTreeMap::new());
        page.read(&folder, "", MOST_DEPTH, &mut MOST_BYTES.clone())?;
        Ok(page)
    }

    /// Returns the file called `name`.
    pub fn get(&self, name: &str) -> Option<&[u8]> {
        self.0.get(name).map(Vec::as_slice)
    }

    /// Returns whether a file or a folder beside its entry has this name, in upper or lower case.
    pub fn has(&self, name: &str) -> bool {
        self.0.keys().filter_map(|own| own.split('/').next()).any(|own| is_same_name(own, name))
    }

    pub fn files(&self) -> impl Iterator<Item = (&str, &[u8])> {
        self.0.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice()))
    }

    /// Reads the regular files of a folder. Links and hidden files are not part of a page.
    fn read(&mut self, folder: &Path, prefix: &str, depth: usize, room: &mut u64) -> Result<(), Failure> {
        let failed =
            |path: &Path, error: std::io::Error| Failure::Text(format!("{}: cannot read: {error}", path.display()));
        for entry in std::fs::read_dir(folder).map_err(|error| failed(folder, error))? {
            let entry = entry.map_err(|error| failed(folder, error))?;
            let path = entry.path();
            let Ok(name) = entry.file_name().into_string() else { continue };
            let about = entry.metadata().map_err(|error| failed(&path, error))?;
            if name.starts_with('.') || about.is_symlink() {
                continue;
            }
            let name = format!("{prefix}{name}");
            if about.is_dir() && depth > 0 {
                self.read(&path, &format!("{name}/"), depth - 1, room)?;
            } else if about.is_file() {
                let left = room.checked_sub(about.len()).filter(|_| self.0.len() < MOST_FILES);
                *room = left.ok_or_else(|| {
                    let most = MOST_BYTES >> 20;
                    Failure::Text(format!(
                        "{}: too large for a page ({MOST_FILES} files, {most} MiB)",
                        folder.display()
                    ))
                })?;
                self.0.insert(name, std::fs::read(&path).map_err(|error| failed(&path, error))?);
            }
        }
        Ok(())
    }
}

/// Folders that may hold the page: beside the program, and in the repository above the program or the working folder.
fn usual_folders() -> Vec<PathBuf> {
    let program = std::env::current_exe().and_then(|path| path.canonicalize()).ok();
    let beside = program.iter().filter_map(|path| path.parent()).map(|folder| folder.join(BESIDE));
    let here = std::env::current_dir().ok();
    let above =
        [&program, &here].into_iter().flatten().flat_map(|path| path.ancestors()).map(|folder| folder.join(BUILT));
    beside.chain(above).collect()
}

/// MIME type by file extension.
#[cfg(feature = "serve")]
pub fn mime(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, ending)| ending) {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" | "webmanifest" => "application/json",
        "wasm" => "application/wasm",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "jpg" | "jpeg" => "image/jpeg",
        "ico" => "image/x-icon",
        "woff2" => "font/woff2",
        "txt" | "md" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}
