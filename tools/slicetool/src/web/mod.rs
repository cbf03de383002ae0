//! Walking in the browser: the built page and archives, from a server on this machine (`serve`) or as a folder for any
//! web host (`site`).
//!
//! Both provide the same files: the page, the archives beside it, and `archives.json`, which lists their addresses for
//! the page. A browser can reach nothing that is not in that table.

mod page;
#[cfg(feature = "serve")]
mod ranges;
#[cfg(feature = "serve")]
pub mod serve;
pub mod site;

use crate::{Failure, open};
use page::Page;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use slicewalk::archive::Archive;
use std::path::{Path, PathBuf};

/// Name of the table of archives, beside the page.
const TABLE: &str = "archives.json";
/// Characters that need no escape in the address of a file.
const PLAIN: &AsciiSet = &NON_ALPHANUMERIC.remove(b'.').remove(b'-').remove(b'_').remove(b'~');

/// Options shared by `serve` and `site`.
#[derive(clap::Args)]
pub struct ShowArguments {
    /// Archives to walk in; the page opens the first one
    #[arg(required = true)]
    archives: Vec<PathBuf>,
    /// COPC point cloud of the same place, which the page can draw over the archive
    #[arg(long, value_name = "FILE")]
    cloud: Option<PathBuf>,
    /// Folder of the built page [default: beside the program, or tools/viewer/dist of the repository]
    #[arg(long, value_name = "DIR")]
    page: Option<PathBuf>,
}

/// A file that is served or copied unchanged.
struct Shown {
    /// Its name in addresses.
    name: String,
    path: PathBuf,
    /// The opened archive, if it is one.
    archive: Option<Archive>,
}

struct Show {
    page: Page,
    files: Vec<Shown>,
}

impl Show {
    fn new(arguments: &ShowArguments) -> Result<Self, Failure> {
        let archives: Vec<_> = arguments
            .archives
            .iter()
            .map(|path| open(path).map(|archive| (path, Some(archive))))
            .collect::<Result<_, _>>()?;
        let page = Page::find(arguments.page.as_deref())?;
        if let Some(cloud) = &arguments.cloud {
            check_cloud(cloud)?;
        }
        let mut files: Vec<Shown> = Vec::new();
        for (path, archive) in archives.into_iter().chain(arguments.cloud.iter().map(|cloud| (cloud, None))) {
            let name = free_name(path, |name| {
                page.get(name).is_none() && name != TABLE && files.iter().all(|other| other.name != name)
            });
            files.push(Shown { name, path: path.clone(), archive });
        }
        Ok(Self { page, files })
    }

    /// The table that the page reads, with addresses relative to the page.
    fn table(&self) -> String {
        let address = |file: &Shown| utf8_percent_encode(&file.name, PLAIN).to_string();
        let (archives, others): (Vec<_>, Vec<_>) = self.files.iter().partition(|file| file.archive.is_some());
        let archives: Vec<_> =
            archives.iter().map(|file| serde_json::json!({ "name": file.name, "url": address(file) })).collect();
        let cloud = others.first().map(|file| address(file));
        format!("{}\n", serde_json::json!({ "archives": archives, "cloud": cloud }))
    }
}

/// The name of `path`, changed until it is unused.
fn free_name(path: &Path, is_free: impl Fn(&str) -> bool) -> String {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    // Web hosts hide names that begin with a dot.
    let name = match name.trim_start_matches('.') {
        "" => "archive.slices",
        name => name,
    };
    if is_free(name) {
        return name.into();
    }
    let (stem, ending) = name.rsplit_once('.').unwrap_or((name, "slices"));
    let numbered = |n: u32| format!("{stem}-{n}.{ending}");
    (2..).map(numbered).find(|name| is_free(name)).unwrap_or_default()
}

/// Refuses a file that is not LAS or LAZ; the page reads it by ranges, as COPC.
fn check_cloud(path: &Path) -> Result<(), Failure> {
    let failed = |reason: String| Failure::Text(format!("{}: {reason}", path.display()));
    let mut head = Vec::new();
    let file = std::fs::File::open(path).map_err(|error| failed(format!("cannot open: {error}")))?;
    let read = std::io::Read::read_to_end(&mut std::io::Read::take(file, 589), &mut head);
    read.map_err(|error| failed(format!("cannot read: {error}")))?;
    // The first variable length record of a COPC file is at byte 375 and is called `copc`.
    if head.starts_with(b"LASF") && head.get(377..381) == Some(b"copc") {
        return Ok(());
    }
    Err(failed("not a COPC file; `untwine` or `pdal translate` (writers.copc) makes one from LAS or LAZ".into()))
}
