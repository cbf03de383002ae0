//! From the paths a user gives to a sorted list of scan files.
//!
//! In: files, directories, glob patterns. Out: files in order of their paths, each file once.
//! Memory: the list of paths.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::{Error, Monitor, Result};

/// Expands `inputs` to files.
///
/// - A file is taken as it is, whatever its name (its signature decides later).
/// - A directory stands for the `.las` and `.laz` files directly in it, letters of any case. Directories in it are not
///   entered, because tiles of one survey usually lie beside folders of older deliveries; `DIR/**/*.laz` enters them.
/// - A path that does not exist and holds `*`, `?` or `[` is a pattern; files in its matches count if they end in
///   `.las` or `.laz`, and meshes if the pattern itself ends as they do: an export beside the scans is no input.
pub(super) fn expand(inputs: &[PathBuf], monitor: &dyn Monitor) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for input in inputs {
        match fs::metadata(input) {
            Ok(about) if about.is_dir() => directory(input, &mut found)?,
            Ok(_) => found.push(input.clone()),
            Err(error) => match input.to_str() {
                Some(pattern) if pattern.contains(['*', '?', '[']) => matches(input, pattern, &mut found)?,
                _ => return Err(Error::io(input, "open", error)),
            },
        }
    }
    if found.is_empty() {
        return Err(Error::parameter("INPUT", "no file was given; name scans, meshes, directories or patterns"));
    }
    found.sort();
    found.dedup();
    let mut seen: HashMap<PathBuf, PathBuf> = HashMap::new();
    let mut once = Vec::with_capacity(found.len());
    for path in found {
        // Where the system cannot resolve a path, opening the file will say why.
        let real = fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
        match seen.get(&real) {
            Some(first) => {
                monitor.warn(&format!("{}: the same file as {}; it is read once", path.display(), first.display()))
            }
            None => {
                seen.insert(real, path.clone());
                once.push(path);
            }
        }
    }
    Ok(once)
}

fn is_scan(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("las") || e.eq_ignore_ascii_case("laz"))
}

/// Whether the name says mesh. (A scan under such a name is told by its signature.)
pub(super) fn is_mesh(path: &Path) -> bool {
    const ENDINGS: [&str; 5] = ["obj", "ply", "stl", "gltf", "glb"];
    let named = path.extension().is_some_and(|e| ENDINGS.iter().any(|ending| e.eq_ignore_ascii_case(ending)));
    named && !has_signature_of_scan(path)
}

fn has_signature_of_scan(path: &Path) -> bool {
    let mut start = [0; 4];
    // Where it cannot be read, opening it as a mesh will say why.
    fs::File::open(path)
        .is_ok_and(|mut file| std::io::Read::read_exact(&mut file, &mut start).is_ok() && &start == b"LASF")
}

fn directory(path: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    let before = found.len();
    let list = |e| Error::io(path, "list", e);
    for entry in fs::read_dir(path).map_err(list)? {
        let file = entry.map_err(list)?.path();
        if is_scan(&file) && !file.is_dir() {
            found.push(file);
        }
    }
    if found.len() == before {
        let reason = "no .las or .laz file lies in it; directories inside are not entered, name them or use a pattern \
                      such as DIR/**/*.laz";
        return Err(Error::input(path, "directory", reason));
    }
    Ok(())
}

fn matches(input: &Path, pattern: &str, found: &mut Vec<PathBuf>) -> Result<()> {
    let before = found.len();
    let paths = glob::glob(pattern).map_err(|e| Error::input(input, "pattern", e.to_string()))?;
    for path in paths {
        let path = path.map_err(|e| {
            let at = e.path().to_path_buf();
            Error::io(at, "list", e.into())
        })?;
        let same_ending =
            || path.extension().is_some_and(|e| input.extension().is_some_and(|f| e.eq_ignore_ascii_case(f)));
        if !path.is_dir() && (is_scan(&path) || same_ending() && is_mesh(&path)) {
            found.push(path);
        }
    }
    if found.len() == before {
        return Err(Error::input(input, "pattern", "it matches no .las or .laz file"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoMonitor;

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
            expand(&inputs, &NoMonitor).map(|paths| {
                paths.iter().map(|p| p.file_name().unwrap().to_str().unwrap().to_string()).collect::<Vec<_>>()
            })
        };
        assert_eq!(names(&["b.las", "a.LAZ"]).unwrap(), ["a.LAZ", "b.las"]);
        assert_eq!(names(&["", "b.las", "sub/../b.las"]).unwrap(), ["a.LAZ", "b.las"]);
        assert_eq!(names(&["**/*.laz"]).unwrap(), ["d.laz"]);
        assert_eq!(names(&["?.*"]).unwrap(), ["a.LAZ", "b.las"]);
        assert_eq!(names(&["**/*.PLY", "*.obj"]).unwrap(), ["e.obj", "f.PLY"]);
        assert_eq!(names(&["c.txt"]).unwrap(), ["c.txt"]);
        assert!(names(&["*.e57"]).unwrap_err().to_string().contains("matches no .las or .laz"));
        assert!(names(&["none.las"]).unwrap_err().to_string().contains("cannot open"));
        fs::create_dir(dir.path().join("empty")).unwrap();
        assert!(names(&["empty"]).unwrap_err().to_string().contains("no .las or .laz file lies in it"));
        assert!(expand(&[], &NoMonitor).is_err());
    }
}
