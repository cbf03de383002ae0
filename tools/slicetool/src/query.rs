//! `slicetool query`: boxes or rays from a CSV file, answers as CSV.

use crate::{Failure, Outcome};
use slicewalk::archive::Archive;
use slicewalk::frame::PageKey;
use slicewalk::query::{Aabb, Answer, Missing, Ray, cast, probe};
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
    let archive = Archive::open(&arguments.archive)?;
    let mut store = Store::with_budget(Box::new(archive), (arguments.cache as usize) << 20)?;
    match (&arguments.boxes, &arguments.rays) {
        (Some(path), _) => answer(path, BOX_COLUMNS, ["hit", "obstacle", "floor_z"], |values| {
            let [x0, y0, z0, x1, y1, z1] = values;
            let shape = Aabb::new([x0, y0, z0].into(), [x1, y1, z1].into())?;
            let found = complete(&mut store, |store| probe(store, &shape))?;
            let floor = found.floor_z.map_or(String::new(), |z| z.to_string());
            Ok([u8::from(found.hit).to_string(), u8::from(found.obstacle).to_string(), floor])
        }),
        (None, Some(path)) => answer(path, RAY_COLUMNS, ["hit", "distance", "nx", "ny", "nz"], |values| {
            let [x, y, z, dx, dy, dz, max] = values;
            let ray = Ray::new([x, y, z].into(), [dx, dy, dz].into(), max)?;
            Ok(match complete(&mut store, |store| cast(store, &ray))? {
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
fn complete<T>(store: &mut Store, ask: impl Fn(&Store) -> Answer<T>) -> Result<T, Failure> {
    loop {
        let missing: Missing = match ask(store) {
            Answer::Known(answer) => return Ok(answer),
            Answer::NotLoaded(missing) => missing,
        };
        let keys = missing.keys();
        let around = keys.first().copied().unwrap_or(PageKey { tx: 0, ty: 0, layer: 0 });
        if store.load_missing(keys, around)?.loaded == 0 {
            return Err(Failure::Text(
                "one query needs more pages at once than fit in memory; give more --cache".into(),
            ));
        }
    }
}

/// Reads rows of the named columns (in any order, among others; without a header, in this order) and writes them with
/// the answers behind.
fn answer<const IN: usize, const OUT: usize>(
    path: &Path,
    columns: [&str; IN],
    answers: [&str; OUT],
    mut ask: impl FnMut([f64; IN]) -> Result<[String; OUT], Failure>,
) -> Outcome {
    let failed = |at: &str, reason: &str| Failure::Text(format!("{}: {at}: {reason}", path.display()));
    let expected = columns.join(",");
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_path(path)
        .map_err(|e| failed("cannot open", &e.to_string()))?;
    let mut order: Option<[usize; IN]> = None;
    let mut text = String::new();
    for row in reader.records() {
        let row = row.map_err(|e| failed("cannot read", &e.to_string()))?;
        let line = row.position().map_or(0, |position| position.line());
        let order = match &order {
            Some(order) => order,
            None => {
                let named = row.iter().any(|field| field.parse::<f64>().is_err());
                let mut places = std::array::from_fn(|at| at);
                if named {
                    for (place, column) in places.iter_mut().zip(columns) {
                        *place = row.iter().position(|field| field == column).ok_or_else(|| {
                            failed("line 1", &format!("no column {column}; expected the columns {expected}"))
                        })?;
                    }
                    writeln!(text, "{},{}", row.iter().collect::<Vec<_>>().join(","), answers.join(","))?;
                } else {
                    writeln!(text, "{expected},{}", answers.join(","))?;
                }
                let order = order.insert(places);
                if named {
                    continue;
                }
                order
            }
        };
        let mut values = [0.0; IN];
        for (value, (&place, column)) in values.iter_mut().zip(order.iter().zip(columns)) {
            let field = row.get(place).unwrap_or_default();
            *value = field
                .parse()
                .map_err(|_| failed(&format!("line {line}"), &format!("{column} is {field:?}; expected a number")))?;
        }
        let answers = ask(values).map_err(|failure| match failure {
            Failure::Text(reason) => failed(&format!("line {line}"), &reason),
            result => result,
        })?;
        writeln!(text, "{},{}", row.iter().collect::<Vec<_>>().join(","), answers.join(","))?;
    }
    Ok(text)
}
