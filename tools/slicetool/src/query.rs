//! `slicetool query`: boxes or rays from a CSV file, answers as CSV.

use crate::{Failure, Outcome};
use slicewalk::frame::PageKey;
use slicewalk::query::{Aabb, Answer, Ray, cast, probe};
use slicewalk::store::Missing;
use slicewalk::store::Store;
use std::fmt::Write;
use std::path::{Path, PathBuf};

const BOX_COLUMNS: [&str; 6] = ["xmin", "ymin", "zmin", "xmax", "ymax", "zmax"];
const RAY_COLUMNS: [&str; 7] = ["x", "y", "z", "dx", "dy", "dz", "max"];

/// Which archive, and what to ask.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true))]
pub struct Arguments {
    archive: PathBuf,
    /// Boxes: columns xmin,ymin,zmin,xmax,ymax,zmax; adds hit,obstacle,floor_z
    #[arg(long, value_name = "Q.csv", group = "what")]
    boxes: Option<PathBuf>,
    /// Rays: columns x,y,z,dx,dy,dz,max; adds hit,distance,nx,ny,nz
    #[arg(long, value_name = "R.csv", group = "what")]
    rays: Option<PathBuf>,
    /// Memory for pages in MiB
    #[arg(long, value_name = "MIB", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..))]
    cache: u32,
}

/// Answers every row; the whole result appears, or none.
pub fn run(arguments: &Arguments) -> Outcome {
    let archive = crate::open(&arguments.archive)?;
    let mut store = Store::with_budget(Box::new(archive), (arguments.cache as usize) << 20)
        .map_err(|error| crate::broken(&arguments.archive, &error))?;
    match (&arguments.boxes, &arguments.rays) {
        (Some(path), _) => answer(path, BOX_COLUMNS, ["hit", "obstacle", "floor_z"], |values| {
            let [x0, y0, z0, x1, y1, z1] = values;
            let shape = Aabb::new([x0, y0, z0].into(), [x1, y1, z1].into())?;
            let found = complete(&mut store, &arguments.archive, |store| probe(store, &shape))?;
            let floor = found.floor_z.map_or(String::new(), |z| z.to_string());
            Ok([u8::from(found.hit).to_string(), u8::from(found.obstacle).to_string(), floor])
        }),
        (None, Some(path)) => answer(path, RAY_COLUMNS, ["hit", "distance", "nx", "ny", "nz"], |values| {
            let [x, y, z, dx, dy, dz, max] = values;
            let ray = Ray::new([x, y, z].into(), [dx, dy, dz].into(), max)?;
            Ok(match complete(&mut store, &arguments.archive, |store| cast(store, &ray))? {
                Some(hit) => {
                    let normal = hit.normal;
                    ["1".into(), hit.distance.to_string()]
                        .into_iter()
                        .chain([normal.x, normal.y, normal.z].map(|value| value.to_string()))
                        .collect::<Vec<_>>()
                        .try_into()
                        .unwrap_or_default()
                }
                None => ["0".into(), String::new(), String::new(), String::new(), String::new()],
            })
        }),
        (None, None) => Err(Failure::Text("give --boxes or --rays".into())),
    }
}

/// Repeats `ask` until nothing is missing, loading what is.
fn complete<T>(store: &mut Store, archive: &Path, ask: impl Fn(&Store) -> Answer<T>) -> Result<T, Failure> {
    loop {
        let missing: Missing = match ask(store) {
            Answer::Known(answer) => return Ok(answer),
            Answer::NotLoaded(missing) => missing,
        };
        let keys = missing.keys();
        let around = keys.first().copied().unwrap_or(PageKey { tx: 0, ty: 0, layer: 0 });
        if store.load_missing(keys, around).map_err(|error| crate::broken(archive, &error))?.loaded == 0 {
            return Err(Failure::Text(
                "one query needs more pages at once than fit in memory; give more --cache".into(),
            ));
        }
    }
}

/// Reads rows of the named columns (in any order, among others; without a header, exactly these in this order) and writes
/// each line as it stands with the answers behind. Empty lines and lines that begin with `#` are passed over.
fn answer<const IN: usize, const OUT: usize>(
    path: &Path,
    columns: [&str; IN],
    answers: [&str; OUT],
    mut ask: impl FnMut([f64; IN]) -> Result<[String; OUT], Failure>,
) -> Outcome {
    let failed = |line: usize, reason: String| Failure::Text(format!("{}: line {line}: {reason}", path.display()));
    let expected = columns.join(",");
    let bytes = std::fs::read(path).map_err(|e| Failure::Text(format!("{}: cannot read: {e}", path.display())))?;
    let input = String::from_utf8(bytes).map_err(|e| {
        let line = 1 + e.as_bytes()[..e.utf8_error().valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
        failed(line, "no UTF-8 text; save the table as UTF-8 (or plain ASCII) CSV".into())
    })?;
    // Spreadsheets begin UTF-8 files with a mark that is no part of the first name.
    let input = input.strip_prefix('\u{feff}').unwrap_or(&input);
    let mut places: [usize; IN] = std::array::from_fn(|at| at);
    let mut fields_expected = None;
    let mut text = String::new();
    for (number, line) in (1..).zip(input.lines()) {
        if line.trim().is_empty() || line.starts_with('#') {
            continue;
        }
        let row = fields(line).ok_or_else(|| failed(number, "a quoted field does not end on its line".into()))?;
        let is_number = |field: &str| field.parse::<f64>().is_ok();
        if fields_expected.is_none() {
            fields_expected = Some(row.len());
            if row.iter().any(|field| field == columns[0]) || !row.iter().any(is_number) {
                for (place, column) in places.iter_mut().zip(columns) {
                    *place = row.iter().position(|field| field == column).ok_or_else(|| {
                        failed(number, format!("no column {column}; expected the columns {expected}"))
                    })?;
                }
                writeln!(text, "{line},{}", answers.join(","))?;
                continue;
            }
            if row.len() != IN {
                let found = row.len();
                return Err(failed(number, format!("{found} fields and no header; expected the columns {expected}")));
            }
            writeln!(text, "{expected},{}", answers.join(","))?;
        }
        if let Some(expected) = fields_expected.filter(|&expected| expected != row.len()) {
            return Err(failed(number, format!("{} fields; the first line has {expected}", row.len())));
        }
        let mut values = [0.0; IN];
        for (value, (&place, column)) in values.iter_mut().zip(places.iter().zip(columns)) {
            let field = row.get(place).unwrap_or_default();
            *value = field.parse().map_err(|_| failed(number, format!("{column} is {field:?}; expected a number")))?;
        }
        let answers = ask(values).map_err(|failure| match failure {
            Failure::Text(reason) => failed(number, reason),
            result => result,
        })?;
        writeln!(text, "{line},{}", answers.join(","))?;
    }
    match fields_expected {
        Some(_) => Ok(text),
        None => Err(Failure::Text(format!("{}: it is empty; expected the columns {expected}", path.display()))),
    }
}

/// The fields of one line without blanks around them; `None` if a quoted one goes on beyond it.
fn fields(line: &str) -> Option<csv::StringRecord> {
    if line.bytes().filter(|&byte| byte == b'"').count() % 2 == 1 {
        return None;
    }
    let mut reader = csv::ReaderBuilder::new().has_headers(false).trim(csv::Trim::All).from_reader(line.as_bytes());
    let mut row = csv::StringRecord::new();
    reader.read_record(&mut row).ok()?.then_some(row)
}
