//! Expands the paths given by the user to a sorted list of scan files.
//!
//! Input: files, directories, glob patterns. Output: files sorted by path, each once. Memory: the list of paths.

use super::diagnostics::Diagnostics;
use super::{cloud, is_of_input, pattern};
#[cfg(feature = "remote")]
use crate::bytes::list;
use crate::bytes::{FileId, Input, address, held, local};
use crate::ply_header::MOST_HEADER;
use crate::{Error, Monitor, Parameter, Result};
use std::collections::HashMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Error for patterns without a match.
const NO_MATCH: &str = "it matches no scan; name .txt, .csv and .asc explicitly";

/// Expands `inputs` to files.
///
/// - A file is accepted whatever its name; its signature decides later.
/// - A directory stands for the scans directly in it, by extension in any case: `.las`, `.laz`, `.e57`, `.pcd`,
///   `.pts`, `.ptx`, `.xyz`, the last three also with `.gz` or `.zst`. Subdirectories are not entered, because tiles of
///   one survey usually lie beside folders of older deliveries; `DIR/**/*.laz` enters them. A directory without scans
///   stands for the Gaussian splats directly in it, by extension.
/// - A path that does not exist and contains `*`, `?` or `[` is a pattern. It finds files with these extensions, and
///   meshes, PLY and Gaussian splats only if the pattern has the same extension, because an export beside the scans is
///   not input. A pattern that ends in `meta.json` or `lod-meta.json` finds folders of splats.
///   Neither are tables: `.txt`, `.csv` and `.asc` must be named individually.
///
/// With `diagnostics`, unreadable inputs are recorded there and reported to `monitor`, unless nothing else is left.
pub(super) fn expand(
    inputs: &[PathBuf],
    diagnostics: Option<&Diagnostics>,
    monitor: &dyn Monitor,
) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut left_out = None;
    for input in inputs {
        match (expand_one(input, &mut found, diagnostics, monitor), diagnostics) {
            (Err(error), Some(diagnostics)) if is_of_input(&error) => {
                tell(diagnostics, &error, monitor);
                left_out = Some(error);
            }
            (done, _) => done?,
        }
    }
    if found.is_empty() {
        let none = || Error::parameter("INPUT", "no file was given; name scans, meshes, directories or patterns");
        return Err(left_out.unwrap_or_else(none));
    }
    Ok(each_once(found, monitor))
}

/// Sorts paths and leaves out files that are named again. Those under another name are reported to `monitor`.
pub fn each_once(mut found: Vec<PathBuf>, monitor: &dyn Monitor) -> Vec<PathBuf> {
    found.sort();
    found.dedup();
    let mut seen: HashMap<FileId, usize> = HashMap::new();
    let mut once: Vec<PathBuf> = Vec::with_capacity(found.len());
    for path in found {
        // If the system returns no id, opening the file will report why.
        let before = FileId::at(&path).and_then(|id| seen.insert(id, once.len()).map(|first| (id, first)));
        match before {
            Some((id, first)) => {
                seen.insert(id, first);
                let first = once[first].display();
                monitor.warn(&format!("{}: the same file as {first}; it is read once", path.display()).into());
            }
            None => once.push(path),
        }
    }
    once
}

/// Reports that an input is left out.
fn tell(diagnostics: &Diagnostics, error: &Error, monitor: &dyn Monitor) {
    diagnostics.note();
    monitor.warn(&format!("incomplete: left out: {error}").into());
}

fn expand_one(
    input: &Path,
    found: &mut Vec<PathBuf>,
    diagnostics: Option<&Diagnostics>,
    monitor: &dyn Monitor,
) -> Result<()> {
    if let Some(file) = local(input) {
        return expand_one(&file, found, diagnostics, monitor);
    }
    if let Some(address) = address(input) {
        return objects(input, address, found);
    }
    if held(input).is_some() {
        found.push(input.to_path_buf());
        return Ok(());
    }
    match fs::metadata(input) {
        Ok(about) if about.is_dir() => directory(input, found),
        Ok(_) => {
            found.push(input.to_path_buf());
            Ok(())
        }
        Err(_) if pattern::is_pattern(input) => {
            let before = found.len();
            let mut failed = |error: Error| match diagnostics {
                Some(diagnostics) => {
                    tell(diagnostics, &error, monitor);
                    Ok(())
                }
                None => Err(error),
            };
            pattern::walk(input, monitor, &mut failed, &mut |path| {
                if is_scan(path) || is_export(path) && same_ending(path, input) || is_splat_folder(path, input) {
                    found.push(path.to_path_buf());
                }
            })?;
            if found.len() == before {
                return Err(Error::input(input, "pattern", NO_MATCH));
            }
            Ok(())
        }
        Err(error) if error.kind() == ErrorKind::NotFound => {
            Err(Error::io(input, "open", error).with_suggestion(Parameter::Input))
        }
        Err(error) => Err(Error::io(input, "open", error)),
    }
}

/// Expands an address: an object; `s3://bucket/folder/`, which stands for the scans directly in it; a pattern in an
/// object store.
#[cfg_attr(
    not(feature = "remote"),
    allow(unused_variables, reason = "opening it will say that addresses are not read")
)]
fn objects(input: &Path, address: &str, found: &mut Vec<PathBuf>) -> Result<()> {
    #[cfg(feature = "remote")]
    if !address.starts_with("http") {
        let before = found.len();
        let (bucket, key) = split_address(address);
        if let Some(wild) = key.find(['*', '?', '[']) {
            let pattern = glob::Pattern::new(key).map_err(|e| Error::input(input, "pattern", e.to_string()))?;
            let folder = &key[..key[..wild].rfind('/').map_or(0, |at| at + 1)];
            let deep = key[folder.len()..].contains('/');
            // A leading dot is not special, as in patterns over folders.
            let how = glob::MatchOptions { require_literal_separator: true, ..glob::MatchOptions::default() };
            for name in list(&format!("{bucket}{folder}"), deep)? {
                let path = PathBuf::from(&name);
                let matches = pattern.matches_with(&decoded(split_address(&name).1), how);
                if matches && (is_scan(&path) || is_mesh_named(&path) && same_ending(&path, input)) {
                    found.push(path);
                }
            }
            if found.len() == before {
                return Err(Error::input(input, "pattern", NO_MATCH));
            }
            return Ok(());
        }
        if key.is_empty() || key.ends_with('/') {
            found.extend(list(address, false)?.into_iter().map(PathBuf::from).filter(|path| is_scan(path)));
            if found.len() == before {
                let reason = "no scan lies in it (name .txt, .csv, .asc and .ply explicitly); folders inside are not \
                              entered, name them or use a pattern such as s3://bucket/**/*.laz";
                return Err(Error::input(input, "folder", reason));
            }
            return Ok(());
        }
    }
    found.push(input.to_path_buf());
    Ok(())
}

/// Splits an address into `s3://bucket/` and the key.
#[cfg(feature = "remote")]
fn split_address(address: &str) -> (&str, &str) {
    let host = address.find("://").map_or(0, |at| at + 3);
    let end = address[host..].find('/').map_or(address.len(), |at| host + at + 1);
    address.split_at(end)
}

#[cfg(feature = "remote")]
fn decoded(key: &str) -> String {
    percent_encoding::percent_decode_str(key).decode_utf8_lossy().into_owned()
}

fn same_ending(path: &Path, other: &Path) -> bool {
    path.extension().is_some_and(|e| other.extension().is_some_and(|f| e.eq_ignore_ascii_case(f)))
}

fn is_scan(path: &Path) -> bool {
    cloud::is_found(path)
        || path.extension().is_some_and(|e| e.eq_ignore_ascii_case("las") || e.eq_ignore_ascii_case("laz"))
}

/// Returns whether the name has the extension of a mesh or of Gaussian splats.
fn is_export(path: &Path) -> bool {
    is_mesh_named(path) || cloud::splat_named(path).is_some()
}

/// Returns whether a file describes a folder of splats, and a pattern asks for its name.
fn is_splat_folder(path: &Path, pattern: &Path) -> bool {
    let name = path.file_name();
    name == pattern.file_name() && name.is_some_and(|name| name == "meta.json" || name == "lod-meta.json")
}

/// Returns whether the name has the extension of a mesh.
fn is_mesh_named(path: &Path) -> bool {
    const ENDINGS: [&str; 5] = ["obj", "ply", "stl", "gltf", "glb"];
    path.extension().is_some_and(|e| ENDINGS.iter().any(|ending| e.eq_ignore_ascii_case(ending)))
}

/// Returns whether a file is a mesh according to its extension. Exceptions: a file with the signature of a scan, and a
/// PLY file without faces, which is a cloud. Fails if the file cannot be read.
pub(super) fn is_mesh(path: &Path) -> Result<bool> {
    const SIGNATURE: &[u8] = b"LASF";
    if !is_mesh_named(path) {
        return Ok(false);
    }
    let is_ply = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("ply"));
    let (input, stamp) = Input::open(path)?;
    let most = if is_ply { MOST_HEADER } else { SIGNATURE.len() };
    let mut start = vec![0; stamp.len().min(most as u64) as usize];
    let read = input.read_up_to(0, &mut start).map_err(|error| Error::io(path, "read", error))?;
    start.truncate(read);
    let is_scan = start.starts_with(SIGNATURE) || is_ply && cloud::is_ply_cloud(&start);
    Ok(!is_scan)
}

fn directory(path: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    let before = found.len();
    let mut splats = Vec::new();
    let list = |e| Error::io(path, "list", e);
    for entry in fs::read_dir(path).map_err(list)? {
        let file = entry.map_err(list)?.path();
        let (scan, splat) = (is_scan(&file), cloud::splat_named(&file).is_some());
        if (scan || splat) && !file.is_dir() {
            (if scan { &mut *found } else { &mut splats }).push(file);
        }
    }
    if found.len() == before {
        found.append(&mut splats);
    }
    if found.len() == before {
        let reason = "no scan lies in it (name .txt, .csv, .asc and .ply explicitly); directories inside are not \
                      entered, name them or use a pattern such as DIR/**/*.laz";
        return Err(Error::input(path, "directory", reason));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use slicewalk_base::NoMonitor;

    #[test]
    fn a_failed_read_makes_no_mesh() {
        use crate::{InputOptions, InputSet};
        use slicewalk_base::bytes::testing::{Strike, StruckSource};
        use slicewalk_base::bytes::{MemorySource, hold_source};
        let cloud = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                     end_header\n1 2 3\n";
        for name in ["struck.ply", "struck.obj"] {
            let hold = || {
                let strike = Strike::at(0);
                hold_source(name, StruckSource::new(MemorySource::new(cloud.as_bytes()), &strike));
                strike
            };
            let open = |allow_incomplete: bool| {
                let options = InputOptions { allow_incomplete, ..InputOptions::default() };
                InputSet::of_paths(vec![name.into()], options, &NoMonitor)
            };
            for allow_incomplete in [false, true] {
                let strike = hold();
                let said = open(allow_incomplete).unwrap_err().to_string();
                assert!(strike.fell() && said.contains(name) && said.contains(Strike::REASON), "{said}");
            }
        }
    }

    #[test]
    fn files_directories_and_patterns_give_each_scan_once_in_order_of_path() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["b.las", "a.LAZ", "c.txt", "sub/d.laz", "e.obj", "sub/f.PLY"] {
            let path = dir.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, name).unwrap();
        }
        let names = |inputs: &[&str]| {
            let inputs: Vec<_> = inputs.iter().map(|i| dir.path().join(i)).collect();
            expand(&inputs, None, &NoMonitor).map(|paths| {
                paths.iter().map(|p| p.file_name().unwrap().to_str().unwrap().to_string()).collect::<Vec<_>>()
            })
        };
        assert_eq!(names(&["b.las", "a.LAZ"]).unwrap(), ["a.LAZ", "b.las"]);
        assert_eq!(names(&["", "b.las", "sub/../b.las"]).unwrap(), ["a.LAZ", "b.las"]);
        assert_eq!(names(&["**/*.laz"]).unwrap(), ["d.laz"]);
        assert_eq!(names(&["?.*"]).unwrap(), ["a.LAZ", "b.las"]);
        assert_eq!(names(&["**/*.PLY", "*.obj"]).unwrap(), ["e.obj", "f.PLY"]);
        assert_eq!(names(&["c.txt"]).unwrap(), ["c.txt"]);
        fs::write(dir.path().join("g.asc"), "1 2 3\n").unwrap();
        assert_eq!(names(&["g.asc"]).unwrap(), ["g.asc"]);
        assert_eq!(names(&["", "?.*"]).unwrap(), ["a.LAZ", "b.las"]);
        let said = names(&["*.asc"]).unwrap_err().to_string();
        assert!(said.contains("it matches no scan; name .txt, .csv and .asc explicitly"), "{said}");
        let texts = ["a.xyz", "b.XYZN", "c.xyzrgb", "d.xyzn.gz", "e.xyzrgb.zst"];
        fs::create_dir(dir.path().join("texts")).unwrap();
        texts.iter().for_each(|name| fs::write(dir.path().join("texts").join(name), "1 2 3\n").unwrap());
        assert_eq!(names(&["texts"]).unwrap(), texts);
        assert_eq!(names(&["texts/*"]).unwrap(), texts);
        assert!(names(&["*.e57"]).unwrap_err().to_string().contains("matches no scan"));
        let missing = names(&["none.las"]).unwrap_err().to_string();
        assert!(
            missing.contains("cannot open")
                && missing.ends_with("; check the name: a file, a folder, or a pattern such as tiles/*.laz")
        );
        fs::create_dir(dir.path().join("empty")).unwrap();
        assert!(names(&["empty"]).unwrap_err().to_string().contains("no scan lies in it"));
        assert!(expand(&[], None, &NoMonitor).is_err());
        let through_a_file = names(&["b.las/c.las"]).unwrap_err().to_string();
        assert!(through_a_file.contains("c.las: cannot open"), "{through_a_file}");
    }

    #[test]
    fn splats_are_found_where_no_scan_is_and_by_their_names() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["both/a.las", "both/b.splat", "only/c.SPZ", "only/d.txt", "sog/meta.json", "sog/lod-meta.json"] {
            let path = dir.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, name).unwrap();
        }
        let names = |input: &str| {
            let paths = expand(&[dir.path().join(input)], None, &NoMonitor)?;
            Ok::<_, Error>(
                paths.iter().map(|p| p.file_name().unwrap().to_str().unwrap().to_owned()).collect::<Vec<_>>(),
            )
        };
        for (input, expected) in [
            ("both", "a.las"),
            ("only", "c.SPZ"),
            ("*/*.splat", "b.splat"),
            ("*/meta.json", "meta.json"),
            ("*/lod-meta.json", "lod-meta.json"),
        ] {
            assert_eq!(names(input).unwrap(), [expected], "{input}");
        }
        assert!(names("sog/*.json").is_err());
    }

    #[cfg(feature = "remote")]
    #[test]
    fn a_pattern_of_objects_that_is_none_is_refused() {
        let error = expand(&["s3://bucket/a[.laz".into()], None, &NoMonitor).unwrap_err().to_string();
        assert!(error.starts_with("s3://bucket/a[.laz: pattern: "), "{error}");
    }
}
