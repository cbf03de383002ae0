//! Walking in the browser: the built page and archives, from a server on this machine (`serve`) or as a folder for any
//! web host (`site`).
//!
//! Both provide the same files: the page, the archives beside it, and `archives.json`, which lists their addresses for
//! the page. A browser can reach nothing that is not in that table. Scans are converted first; `serve` shows the page
//! meanwhile. With `--edits`, they show an edited copy, which is made in the same way.

mod conversion;
mod page;
#[cfg(feature = "serve")]
mod ranges;
#[cfg(feature = "serve")]
pub mod serve;
pub mod site;

use crate::edits::{EditFile, EditOption};
use crate::{Failure, open};
use conversion::{Conversion, ConversionArguments, check_tour, is_archive};
use page::Page;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk_base::bytes::{address, local};
use slicewalk_base::text::{behind_mark, one_line};
use slicewalk_input::expand_inputs;
use std::path::{Path, PathBuf};

/// Name of the table of archives, beside the page.
const TABLE: &str = "archives.json";
/// Name of the state of a conversion, beside the page.
const CONVERSION: &str = "conversion.json";
/// Name of the texts and rules of a place, beside its archive and beside the page.
const SETTINGS: &str = "settings.json";
/// Its fields.
const SETTINGS_FIELDS: [&str; 5] = ["title", "text", "start", "modes", "stops"];
/// Characters that need no escape in the address of a file.
const PLAIN: &AsciiSet = &NON_ALPHANUMERIC.remove(b'.').remove(b'-').remove(b'_').remove(b'~');

/// Why `--edits` is refused.
const ONE_ARCHIVE: &str = "--edits: expected one archive and no scans; convert scans first, with sliceconv";

/// Options shared by `serve` and `site`.
#[derive(clap::Args)]
pub struct ShowArguments {
    /// Archives to walk in, or a folder of them, and scans, meshes, folders and patterns as for `sliceconv`, which are
    /// converted into one archive; the page opens the first input
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// COPC point cloud of the same place, which the page can draw over the archive
    #[arg(long, value_name = "FILE")]
    cloud: Option<PathBuf>,
    /// Folder of the built page [default: beside the program, or tools/viewer/dist of the repository]
    #[arg(long, value_name = "DIR")]
    page: Option<PathBuf>,
    #[command(flatten)]
    edits: EditOption,
    #[command(flatten)]
    conversion: ConversionArguments,
    #[command(flatten)]
    kiosk: KioskArguments,
}

/// Options for a page that stands in a public place.
#[derive(clap::Args)]
pub struct KioskArguments {
    /// Kiosk: large controls and no settings; back to the start after this many seconds without a touch
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u32).range(1..=86_400))]
    kiosk: Option<u32>,
    /// Walk along this route (columns x, y, z; `slicetool route -o` writes one) until someone touches the page
    #[arg(long, value_name = "ROUTE.csv")]
    tour: Option<PathBuf>,
}

/// A file that is served or copied unchanged.
struct Shown {
    /// Its name in addresses.
    name: String,
    path: PathBuf,
    kind: Kind,
}

enum Kind {
    Archive(Box<Archive>),
    /// The archive that scans are converted to.
    Converted,
    Cloud,
    Tour,
    Settings,
}

struct Show {
    page: Page,
    files: Vec<Shown>,
    /// Work to do before all files exist.
    conversion: Option<Conversion>,
    kiosk: Option<u32>,
}

impl Show {
    fn new(arguments: &ShowArguments) -> Result<Self, Failure> {
        let mut named: Vec<(PathBuf, String, Kind)> = Vec::new();
        let mut scans = Vec::new();
        let inputs: Vec<PathBuf> = arguments.inputs.iter().flat_map(|input| archives_in(input)).collect();
        for path in &inputs {
            if is_archive(path) {
                let file = local(path).unwrap_or_else(|| path.clone());
                if arguments.edits.path().is_none() {
                    refuse_address(&file)?;
                }
                let kind = Kind::Archive(Box::new(open(&file)?));
                let name = name_of(&file);
                named.push((file, name, kind));
            } else {
                scans.push((path.clone(), named.len()));
            }
        }
        let page = Page::find(arguments.page.as_deref())?;
        let mut conversion = None;
        if let Some(file) = arguments.edits.read()? {
            let [only] = &mut named[..] else { return Err(Failure::Usage(ONE_ARCHIVE.into())) };
            if !scans.is_empty() {
                return Err(Failure::Usage(ONE_ARCHIVE.into()));
            }
            conversion = edited(only, &file)?;
        }
        if let Some(cloud) = &arguments.cloud {
            check_cloud(cloud)?;
            named.push((cloud.clone(), name_of(cloud), Kind::Cloud));
        }
        check_tour(&arguments.kiosk)?;
        if let Some(tour) = &arguments.kiosk.tour {
            named.push((tour.clone(), name_of(tour), Kind::Tour));
        }
        let beside = inputs.first().and_then(|input| input.parent()).unwrap_or(Path::new(""));
        let settings = beside.join(SETTINGS);
        if settings.is_file() && are_settings(&settings)? {
            named.push((settings, SETTINGS.into(), Kind::Settings));
        }
        if scans.is_empty()
            && let Some(option) = arguments.conversion.given()
        {
            let reason = "only for scans, and none is given; archives are shown as they are";
            return Err(Failure::Usage(format!("--{option}: {reason}")));
        }
        let first = scans.first().map(|(_, place)| *place);
        if let Some(place) = first {
            let scans = scans.into_iter().map(|(path, _)| path).collect();
            let scan = Conversion::new(scans, &arguments.conversion)?;
            named.insert(place, (scan.path.clone(), scan.name.clone(), Kind::Converted));
            conversion = Some(scan);
        }
        let mut files: Vec<Shown> = Vec::new();
        for (path, name, kind) in named {
            let name = free_name(&name, |name| {
                let is = |other: &str| is_same_name(name, other);
                let is_own = is(TABLE) || is(CONVERSION) || is(SETTINGS) && !matches!(kind, Kind::Settings);
                !page.has(name) && !is_own && !files.iter().any(|other| is(&other.name))
            });
            files.push(Shown { name, path, kind });
        }
        Ok(Self { page, files, conversion, kiosk: arguments.kiosk.kiosk })
    }

    /// The table that the page reads, with addresses relative to the page.
    fn table(&self, is_converting: bool) -> String {
        let address = |file: &Shown| utf8_percent_encode(&file.name, PLAIN).to_string();
        let find = |wanted: fn(&Kind) -> bool| self.files.iter().find(|file| wanted(&file.kind)).map(address);
        let archives = self.files.iter().filter(|file| matches!(file.kind, Kind::Archive(_) | Kind::Converted));
        let archives: Vec<_> = archives
            .map(|file| {
                let mut entry = serde_json::json!({ "name": file.name, "url": address(file) });
                if is_converting && matches!(file.kind, Kind::Converted) {
                    entry["converting"] = CONVERSION.into();
                }
                entry
            })
            .collect();
        let mut table = serde_json::json!({ "archives": archives, "cloud": find(|kind| matches!(kind, Kind::Cloud)) });
        if let Some(seconds) = self.kiosk {
            table["kiosk"] = seconds.into();
        }
        if let Some(tour) = find(|kind| matches!(kind, Kind::Tour)) {
            table["tour"] = tour.into();
        }
        if let Some(settings) = find(|kind| matches!(kind, Kind::Settings)) {
            table["settings"] = settings.into();
        }
        format!("{table}\n")
    }
}

/// Returns the archives in a folder without scans, by name; otherwise the input itself.
fn archives_in(input: &Path) -> Vec<PathBuf> {
    let own = vec![input.to_owned()];
    if !input.is_dir() || expand_inputs(&own, &NoMonitor).is_ok() {
        return own;
    }
    let files = std::fs::read_dir(input).into_iter().flatten().flatten().map(|file| file.path());
    let mut archives: Vec<PathBuf> = files.filter(|file| file.is_file() && is_archive(file)).collect();
    archives.sort();
    if archives.is_empty() { own } else { archives }
}

/// Puts an edited copy, which is yet to be made, in place of an archive.
fn edited((path, name, kind): &mut (PathBuf, String, Kind), file: &EditFile) -> Result<Option<Conversion>, Failure> {
    let Kind::Archive(archive) = std::mem::replace(kind, Kind::Converted) else { return Ok(None) };
    let lacking = file.not_solid();
    if !lacking.is_empty() {
        crate::say(&format!("--edits: the page does not know {}", lacking.join(" and ")));
    }
    let copy = Conversion::of_edits(archive.with_edits(file.for_queries()), name.clone())?;
    path.clone_from(&copy.path);
    Ok(Some(copy))
}

/// Refuses an archive elsewhere, which cannot be served or copied as a file.
fn refuse_address(path: &Path) -> Result<(), Failure> {
    let Some(address) = address(path) else { return Ok(()) };
    let name = one_line(address);
    let way_out = "fetch it first (a page itself also opens web addresses: ?archive=URL)";
    Err(Failure::Text(format!("{name}: expected an archive in a file, found an address; {way_out}")))
}

/// The file name of `path`.
fn name_of(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Returns whether two names are one to a host or a file system that ignores case.
fn is_same_name(a: &str, b: &str) -> bool {
    a.to_lowercase() == b.to_lowercase()
}

/// Returns whether a file holds settings of the page; other programs have private files of that name. Refuses one that the
/// page could not read.
fn are_settings(path: &Path) -> Result<bool, Failure> {
    let failed = |reason: String| Failure::Text(format!("{}: {reason}", path.display()));
    let text = std::fs::read(path).map_err(|error| failed(format!("cannot read: {error}")))?;
    match serde_json::from_slice(behind_mark(&text)) {
        Ok(serde_json::Value::Object(fields)) => {
            let are_ours = SETTINGS_FIELDS.iter().any(|name| fields.contains_key(*name));
            if !are_ours {
                let (path, names) = (path.display(), SETTINGS_FIELDS.join(", "));
                crate::say(&format!("{path}: left out: it has none of the page's settings {names}"));
            }
            Ok(are_ours)
        }
        Ok(_) => Err(failed("expected a JSON object with the texts of the place".into())),
        Err(error) => Err(failed(format!("expected JSON with the texts of the place: {error}"))),
    }
}

/// Returns `name`, changed until it is unused.
fn free_name(name: &str, is_free: impl Fn(&str) -> bool) -> String {
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
