//! `slicetool query`: answers boxes or rays from a CSV file as CSV, line by line.

use crate::ground::stored_seen;
use crate::nearest::nearest;
use crate::standard::table;
use crate::{Failure, Outcome, cache_too_small};
use nalgebra::Point3;
use slicewalk::Parameter;
use slicewalk::edit::Edits;
use slicewalk::frame::{Frame, PAGE_SLICES, PageKey, TILE_PIXELS};
use slicewalk::query::{Aabb, Answer, Ray, cast, probe};
use slicewalk::seen::SeenSpace;
use slicewalk::store::{Prefetch, Snapshot, Stream, StreamOptions};
use slicewalk_convert::size::parse_size;
use std::collections::HashSet;
use std::fmt::Write as _;
use std::io::{BufRead, BufReader, BufWriter, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

const BOX_COLUMNS: [&str; 6] = ["xmin", "ymin", "zmin", "xmax", "ymax", "zmax"];
const RAY_COLUMNS: [&str; 7] = ["x", "y", "z", "dx", "dy", "dz", "max"];

/// Options of `slicetool query`.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true))]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// Boxes: columns xmin,ymin,zmin,xmax,ymax,zmax; adds hit,obstacle,floor_z. `-` reads standard input. An archive
    /// with seen space adds a last column `seen`: 1 if a scanner saw through all of the box, or of the ray up to its hit
    #[arg(long, value_name = "Q.csv", group = "what")]
    boxes: Option<PathBuf>,
    /// Rays: columns x,y,z,dx,dy,dz,max; adds hit,distance,nx,ny,nz. `-` reads standard input
    #[arg(long, value_name = "R.csv", group = "what")]
    rays: Option<PathBuf>,
    #[command(flatten)]
    variant: crate::Variant,
    /// Add a column `inferred`: 1 if floor inferred by `--fill-holes` changes the answer
    #[arg(long, conflicts_with = "ignore_inferred")]
    show_inferred: bool,
    /// Add a column `edited`: 1 if the edits change the answer
    #[arg(long, requires = "edits", conflicts_with = "show_inferred")]
    show_edits: bool,
    /// Memory for pages
    #[arg(long, default_value = "1GiB", value_name = "SIZE", value_parser = parse_size)]
    cache: u64,
}

/// Number of pages needed by one query from which on nearby pages are loaded as well.
const MANY: usize = 256;
/// Limit of a ray's length, which keeps its end finite (m).
const FARTHEST_M: f64 = 1e15;
/// Longest line of a table (bytes).
const LONGEST_LINE: u64 = 1 << 20;

/// Answers row by row; rows before an invalid one are answered.
pub fn run(arguments: &Arguments) -> Outcome {
    let archive = arguments.variant.open(&arguments.archive)?;
    // Two sets of pages share the memory.
    let sets = 1 + u64::from(arguments.show_inferred || arguments.show_edits);
    let space = stored_seen(&archive, &arguments.archive, arguments.cache / 2, Parameter::Cache)?;
    let left = arguments.cache - space.as_ref().map_or(0, |space| space.bytes() as u64);
    let cache = usize::try_from(left / sets).unwrap_or(usize::MAX);
    let open = |archive| {
        let options = StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(cache) };
        Stream::open(archive, options).map_err(|error| crate::broken(&arguments.archive, &error))
    };
    let again = || arguments.variant.open(&arguments.archive);
    let (other, more) = match (arguments.show_inferred, arguments.show_edits) {
        (true, _) => (Some(open(again()?.ignoring_inferred())?), ",inferred"),
        (false, true) => (Some(open(again()?.with_edits(Edits::default()))?), ",edited"),
        _ => (None, ""),
    };
    let stream = open(archive)?;
    let more = if space.is_some() { format!("{more},seen") } else { more.to_owned() };
    let seen = |text: &mut String, is_seen: &dyn Fn(&SeenSpace) -> bool| {
        if let Some(space) = &space {
            text.push_str(if is_seen(space) { ",1" } else { ",0" });
        }
    };
    let compare = |text: &mut String, differs: &dyn Fn(&Stream) -> Result<bool, Failure>| -> Result<(), Failure> {
        if let Some(other) = &other {
            write!(text, ",{}", u8::from(differs(other)?))?;
        }
        Ok(())
    };
    match (&arguments.boxes, &arguments.rays) {
        (Some(path), _) => answer(path, BOX_COLUMNS, &format!("hit,obstacle,floor_z{more}"), |values, text| {
            let [x0, y0, z0, x1, y1, z1] = values;
            let shape = Aabb::new([x0, y0, z0].into(), [x1, y1, z1].into())?;
            let ask =
                |stream: &Stream| complete(stream, arguments, [shape.min(), shape.max()], |view| probe(view, &shape));
            let found = ask(&stream)?;
            write!(text, "{},{},", u8::from(found.hit), u8::from(found.obstacle))?;
            found.floor_z.map_or(Ok(()), |z| write!(text, "{z}"))?;
            compare(text, &|other| Ok(ask(other)? != found))?;
            seen(text, &|space| space.is_box_seen(shape.min(), shape.max()));
            Ok(())
        }),
        (None, Some(path)) => answer(path, RAY_COLUMNS, &format!("hit,distance,nx,ny,nz{more}"), |values, text| {
            let [x, y, z, dx, dy, dz, max] = values;
            let ray = Ray::new([x, y, z].into(), [dx, dy, dz].into(), max)?;
            let end = ray.at(ray.max().min(FARTHEST_M));
            let region = [ray.origin().inf(&end), ray.origin().sup(&end)];
            let ask = |stream: &Stream| complete(stream, arguments, region, |view| cast(view, &ray));
            let found = ask(&stream)?;
            match &found {
                Some(hit) => {
                    let normal = hit.normal;
                    write!(text, "1,{},{},{},{}", hit.distance, normal.x, normal.y, normal.z)?;
                }
                None => text.push_str("0,,,,"),
            }
            compare(text, &|other| Ok(ask(other)? != found))?;
            seen(text, &|space| match &found {
                Some(hit) => space.is_ray_seen(ray.origin(), ray.direction(), hit.distance, true),
                None => space.is_ray_seen(ray.origin(), ray.direction(), ray.max(), false),
            });
            Ok(())
        }),
        (None, None) => Err(Failure::Text("give --boxes or --rays".into())),
    }
}

/// Repeats `ask` until it gives an answer, loading the missing pages. All pages that one query needs stay until it is
/// answered. Once they are many, as many more pages are loaded along with them if they fit: the nearest within
/// `region`, given by its lowest and highest corner.
fn complete<T>(
    stream: &Stream,
    arguments: &Arguments,
    region: [Point3<f64>; 2],
    ask: impl Fn(&Snapshot) -> Answer<T>,
) -> Result<T, Failure> {
    let broken = |error| crate::broken(&arguments.archive, &error);
    let mut needed = Vec::new();
    let mut loaded = HashSet::new();
    loop {
        let missing = match ask(&stream.snapshot()) {
            Answer::Known(answer) => return Ok(answer),
            Answer::NotLoaded(missing) => missing,
        };
        needed.extend_from_slice(missing.keys());
        loaded.extend(missing.keys());
        if needed.len() >= MANY {
            let mut keys = needed.clone();
            let frame = stream.archive().frame();
            let wanted = |key| is_in(frame, region, key) && !loaded.contains(&key);
            keys.extend(nearest(stream.archive(), missing.keys()[0], loaded.len(), wanted).map_err(broken)?);
            let report = stream.load(&keys, needed[0]).map_err(broken)?;
            if report.left_out == 0 {
                loaded.extend(keys);
                continue;
            }
        }
        let report = stream.load(&needed, needed[0]).map_err(broken)?;
        if report.left_out > 0 {
            return Err(cache_too_small("this question", arguments.cache, report.needed_bytes));
        }
    }
}

/// Returns whether a page is between the corners of `region` or next to it: solid on an edge belongs to both sides.
fn is_in(frame: &Frame, region: [Point3<f64>; 2], key: PageKey) -> bool {
    let [low, high] = region.map(|corner| {
        let tile = |v: f64| frame.pixel_of(v).div_euclid(TILE_PIXELS);
        [tile(corner.x), tile(corner.y), frame.slice_of(corner.z).div_euclid(PAGE_SLICES)]
    });
    let at = [key.tx, key.ty, key.layer].map(i64::from);
    (0..3).all(|axis| (low[axis] - 1..=high[axis] + 1).contains(&at[axis]))
}

/// Reads rows of the named columns (in any order, possibly among others; without a header, exactly these in this order)
/// and writes each line unchanged with the answers appended. Skips empty lines and lines that begin with `#`. Answers
/// are flushed whenever the input pauses.
fn answer<const IN: usize>(
    path: &Path,
    columns: [&str; IN],
    answers: &str,
    mut ask: impl FnMut([f64; IN], &mut String) -> Result<(), Failure>,
) -> Outcome {
    let (table, name) = table(path)?;
    let failed = |line: usize, reason: String| Failure::Text(format!("{name}: line {line}: {reason}"));
    let unreadable = |error| Failure::Text(format!("{name}: cannot read: {error}"));
    let expected = columns.join(",");
    let mut input = BufReader::new(table);
    let mut output = BufWriter::new(std::io::stdout().lock());
    let mut places: [usize; IN] = std::array::from_fn(|at| at);
    let (mut fields_expected, mut fields) = (None, Fields::new());
    let (mut bytes, mut text) = (Vec::new(), String::new());
    for number in 1.. {
        text.clear();
        bytes.clear();
        if input.buffer().is_empty() && !is_open(output.flush())? {
            return Ok(String::new());
        }
        let read = input.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut bytes).map_err(unreadable)?;
        if read == 0 {
            break;
        }
        if read as u64 == LONGEST_LINE {
            return Err(failed(number, format!("it is longer than {LONGEST_LINE} bytes; is this a table?")));
        }
        let line = std::str::from_utf8(&bytes)
            .map_err(|_| failed(number, "no UTF-8 text; save the table as UTF-8 (or plain ASCII) CSV".into()))?;
        let line = line.strip_suffix('\n').unwrap_or(line);
        let line = line.strip_suffix('\r').unwrap_or(line);
        // Spreadsheets begin UTF-8 files with a byte order mark, which is not part of the first name.
        let line = if number == 1 { line.strip_prefix('\u{feff}').unwrap_or(line) } else { line };
        if line.trim().is_empty() || line.starts_with('#') {
            continue;
        }
        let row = fields.of(line).ok_or_else(|| failed(number, "a quoted field does not end on its line".into()))?;
        if fields_expected.is_none() {
            fields_expected = Some(row.len());
            let is_number = |at| row.get(at).parse::<f64>().is_ok();
            if row.find(columns[0]).is_some() || !(0..row.len()).any(is_number) {
                for (place, column) in places.iter_mut().zip(columns) {
                    *place = row.find(column).ok_or_else(|| {
                        failed(number, format!("no column {column}; expected the columns {expected}"))
                    })?;
                }
                if !is_open(writeln!(output, "{line},{answers}"))? {
                    return Ok(String::new());
                }
                continue;
            }
            if row.len() != IN {
                let found = row.len();
                return Err(failed(number, format!("{found} fields and no header; expected the columns {expected}")));
            }
            if !is_open(writeln!(output, "{expected},{answers}"))? {
                return Ok(String::new());
            }
        }
        if let Some(expected) = fields_expected.filter(|&expected| expected != row.len()) {
            return Err(failed(number, format!("{} fields; the first line has {expected}", row.len())));
        }
        let mut values = [0.0; IN];
        for (value, (&place, column)) in values.iter_mut().zip(places.iter().zip(columns)) {
            let field = row.get(place);
            *value = field.parse().map_err(|_| failed(number, format!("{column} is {field:?}; expected a number")))?;
        }
        ask(values, &mut text).map_err(|failure| match failure {
            Failure::Text(reason) => failed(number, reason),
            result => result,
        })?;
        if !is_open(writeln!(output, "{line},{text}"))? {
            return Ok(String::new());
        }
    }
    match fields_expected {
        Some(_) => Ok(String::new()),
        None => Err(Failure::Text(format!("{name}: it is empty; expected the columns {expected}"))),
    }
}

/// Returns whether the answers are still read: a closed pipe (`slicetool query … | head`) is the reader's choice.
fn is_open(written: std::io::Result<()>) -> Result<bool, Failure> {
    match written {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(Failure::Text(format!("cannot write to standard output: {error}"))),
    }
}

/// Splits lines into fields and trims blanks. One reader serves all lines, because creating one takes longer than a
/// query.
struct Fields {
    reader: csv_core::Reader,
    text: Vec<u8>,
    ends: Vec<usize>,
}

impl Fields {
    fn new() -> Self {
        // `default` would create a reader without a separator.
        Self { reader: csv_core::Reader::new(), text: Vec::new(), ends: Vec::new() }
    }

    /// Returns the fields of a line; `None` if a quoted field does not end within it.
    fn of(&mut self, line: &str) -> Option<Row<'_>> {
        self.reader.reset();
        self.text.resize(line.len() + 1, 0);
        self.ends.resize(line.len() + 2, 0);
        let (result, read, text, count) = self.reader.read_record(line.as_bytes(), &mut self.text, &mut self.ends);
        // Append the line's end; an open quoted field swallows it.
        let ended = match result {
            csv_core::ReadRecordResult::InputEmpty if read == line.len() => {
                self.reader.read_record(b"\n", &mut self.text[text..], &mut self.ends[count..])
            }
            _ => return None,
        };
        let (csv_core::ReadRecordResult::Record, _, more, ends) = ended else { return None };
        Some(Row { text: std::str::from_utf8(&self.text[..text + more]).ok()?, ends: &self.ends[..count + ends] })
    }
}

/// The fields of one line.
struct Row<'a> {
    text: &'a str,
    ends: &'a [usize],
}

impl Row<'_> {
    fn len(&self) -> usize {
        self.ends.len()
    }

    /// Returns a field, or an empty text if there is no such field.
    fn get(&self, at: usize) -> &str {
        let start = if at == 0 { Some(&0) } else { self.ends.get(at - 1) };
        let field = start.zip(self.ends.get(at)).and_then(|(start, end)| self.text.get(*start..*end));
        field.unwrap_or_default().trim()
    }

    fn find(&self, name: &str) -> Option<usize> {
        (0..self.len()).find(|&at| self.get(at) == name)
    }
}
