//! `slicetool info`: prints the metadata of archives.

use crate::{Failure, Outcome, broken, say};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::{Header, SeenTable};
use slicewalk_base::text::{counted, extent, file_size, grouped, number, one_line, ranges, rounded};
use slicewalk_convert::info::{
    INPUT_QUANTUM_M, colour_words, crs_name, info, noise_in_words, slice_count, units_in_words,
};
use slicewalk_input::{InputOptions, InputSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Prints metadata of the archives at `paths`, as JSON or text. An unreadable archive does not prevent the report of
/// the others.
pub fn run(paths: &[PathBuf], json: bool) -> Outcome {
    let mut texts = Vec::new();
    let mut facts = Vec::new();
    let mut failures = Vec::new();
    for path in paths {
        let told = match json {
            true => as_json(path).map(|found| facts.push((path, found))),
            false => as_text(path).map(|text| texts.push(text)),
        };
        failures.extend(told.err());
    }
    let result = match (json, paths) {
        (false, _) => texts.join("\n"),
        (true, [_]) => facts.pop().map_or_else(String::new, |(_, facts)| format!("{facts:#}\n")),
        (true, _) => {
            let named = facts.into_iter().map(|(path, mut facts)| {
                facts["archive"] = path.to_string_lossy().into();
                facts
            });
            format!("{:#}\n", Value::from_iter(named))
        }
    };
    match failures.pop() {
        None => Ok(result),
        Some(last) if paths.len() == 1 => Err(last),
        Some(last) => {
            for failure in failures.into_iter().chain([last]) {
                match failure {
                    Failure::Text(line) | Failure::Usage(line) | Failure::Result(line) => say(&line),
                    Failure::Interrupted(code) => return Err(Failure::Interrupted(code)),
                }
            }
            Err(Failure::Result(result))
        }
    }
}

fn as_json(path: &Path) -> Result<Value, Failure> {
    let mut facts = info(&crate::open(path)?).map_err(|error| broken(path, &error))?;
    facts["input_quantum"] = INPUT_QUANTUM_M.into();
    Ok(facts)
}

fn as_text(path: &Path) -> Result<String, Failure> {
    let archive = crate::open(path)?;
    let failed = |error| broken(path, &error);
    let (crs, units, shard) =
        (archive.crs().map_err(failed)?, archive.units().map_err(failed)?, archive.shard().map_err(failed)?);
    let header = archive.header();
    let frame = &header.plan.frame;
    let mut rows = vec![("points", points(header))];
    rows.push((
        "voxels",
        format!(
            "{} ({}{}) in {}",
            grouped(header.voxels.occupied),
            counted(header.voxels.obstacle, "obstacle"),
            match header.voxels.inferred {
                0 => String::new(),
                inferred => format!(", {} inferred", grouped(inferred)),
            },
            counted(slice_count(header) as u64, "slice")
        ),
    ));
    rows.extend(header.bounds.map(|(min, max)| {
        let corner = |corner: [f64; 3]| corner.map(|value| rounded(value, frame.quantum_m())).join(", ");
        let size = extent(min, max, frame.pixel_m());
        ("extent", format!("{size}, from ({}) to ({})", corner(min), corner(max)))
    }));
    let heights = rounded(1000.0 * frame.quantum_m(), 1000.0 * frame.quantum_m() / 100.0);
    let (pixel, slice) = (number(frame.pixel_m()), number(frame.slice_m()));
    rows.push(("grid", format!("pixels of {pixel} m, slices of {slice} m, heights in steps of {heights} mm")));
    rows.push(("options", options(header)));
    let noise = archive.noise().map_err(failed)?;
    rows.extend(noise.map(|noise| ("auto", format!("tolerance: {}", noise_in_words(&noise)))));
    let [occupied, stored, unique] = [header.tiles.occupied, header.tiles.stored, header.tiles.unique].map(grouped);
    rows.push(("tiles", format!("{occupied} occupied, {stored} stored, {unique} unique")));
    let directory = header.bytes.head + header.bytes.directory;
    let seen = archive.seen_table().map_err(failed)?;
    let pages = header.bytes.pages - seen.as_ref().map_or(0, SeenTable::bytes);
    let [pages, directory, levels] = [pages, directory, header.bytes.levels].map(grouped);
    let levels = if header.bytes.levels > 0 { format!(", levels {levels}") } else { String::new() };
    rows.push(("bytes", format!("{}: pages {pages}, directory {directory}{levels}", grouped(header.file_len))));
    if let Some(colours) = header.colours {
        rows.push((
            "colours",
            format!(
                "{} of {} in {}",
                colour_words(&colours.plan),
                counted(colours.voxels, "voxel"),
                counted(header.bytes.colours, "byte")
            ),
        ));
    }
    if let Some(seen) = seen {
        let [across, up] = [4.0 * frame.pixel_m(), frame.slice_m()].map(number);
        let cells = counted(seen.cells(), "cell");
        let bytes = counted(seen.bytes(), "byte");
        rows.push(("seen", format!("{cells} of {across} × {across} × {up} m in {bytes}")));
    }
    let unit = if units.is_empty() { "unknown".into() } else { format!("{} in the source", units_in_words(&units)) };
    rows.push(("unit", format!("{unit}; the archive is in metres")));
    rows.push(("crs", crs_name(&crs).unwrap_or_else(|| "unknown".into())));
    rows.extend(
        shard.map(|shard| ("part", format!("{} of {}", grouped(shard.index.into()), grouped(shard.count.into())))),
    );
    let (major, minor) = header.version;
    let mut text = String::new();
    writeln!(
        text,
        "{}",
        one_line(&format!("{}: {}, format {major}.{minor}", path.display(), file_size(header.file_len)))
    )?;
    for (name, value) in rows {
        writeln!(text, "  {name:8} {}", one_line(&value))?;
    }
    Ok(text)
}

fn points(header: &Header) -> String {
    let Header { points_read, points_kept, points_excluded, points_withheld, .. } = *header;
    if points_read == points_kept {
        return format!("{} read, all kept", grouped(points_read));
    }
    let unusable =
        points_read.saturating_sub(points_kept).saturating_sub(points_excluded).saturating_sub(points_withheld);
    let others = if header.plan.options.remove_moving { "moving or unusable" } else { "unusable" };
    let reasons = [(points_excluded, "excluded by class"), (points_withheld, "withheld"), (unusable, others)];
    let reasons = reasons.iter().filter(|reason| reason.0 > 0).map(|(n, why)| format!("{} {why}", grouped(*n)));
    let reasons = reasons.collect::<Vec<_>>().join(", ");
    format!("{} read, {} kept ({reasons})", grouped(points_read), grouped(points_kept))
}

fn options(header: &Header) -> String {
    let options = &header.plan.options;
    let mut text = format!(
        "classifier {}, slopes up to {}°, tolerance {} m",
        options.classifier.name(),
        number(options.max_slope_deg),
        number(options.tolerance_m)
    );
    if options.min_points > 1 {
        text += &format!(", at least {}", counted(options.min_points.into(), "point"));
    }
    if options.remove_moving {
        text += ", without moving points";
    }
    if options.fill_holes > 0 {
        let frame = &header.plan.frame;
        let widest = rounded(f64::from(options.fill_holes) * frame.pixel_m(), frame.quantum_m());
        text += &format!(", holes of up to {widest} m closed");
    }
    match options.drop_floaters {
        0 => {}
        1 => text += ", without isolated voxels",
        most => text += &format!(", without pieces of up to {most} voxels"),
    }
    if !options.exclude_classes.is_empty() {
        text += &format!(", without classes {}", ranges(options.exclude_classes.iter().map(u32::from), 16));
    }
    text
}

/// Describes the file at `path` and suggests a command, if it is a known kind of file but not an archive.
pub fn other_file(path: &Path) -> Option<Failure> {
    let mut start = Vec::new();
    let file = std::fs::File::open(path).ok().filter(|file| file.metadata().is_ok_and(|about| about.is_file()))?;
    std::io::Read::read_to_end(&mut std::io::Read::take(file, 4096), &mut start).ok()?;
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    let name = path.display();
    let convert = format!("convert it first: sliceconv {name} -o {}", path.with_extension("slices").display());
    let (what, suggestion) = match (&start[..], &ending[..]) {
        (start, _) if start.starts_with(b"LASF") => (scan(path), convert),
        (start, _) if start.starts_with(b"ply") || start.starts_with(b"glTF") => ("a mesh".into(), convert),
        (_, "obj" | "stl" | "gltf") => ("a mesh".into(), convert),
        (start, _) if String::from_utf8_lossy(start).contains("\"slicewalk_plan\"") => {
            ("a plan".into(), format!("convert with it: sliceconv INPUT... --plan {name} -o OUT.slices"))
        }
        _ => return None,
    };
    Some(Failure::Text(format!("{name}: it is {what} and not a slice archive; {suggestion}")))
}

/// Describes a scan, with its header's data if readable.
fn scan(path: &Path) -> String {
    let Ok(set) = InputSet::open(&[path.to_path_buf()], InputOptions::default(), &NoMonitor) else {
        return "a laser scan".into();
    };
    let of_file = |file: &slicewalk_input::ScanFile| {
        let version = file.version().map_or(String::new(), |(major, minor)| format!(" {major}.{minor}"));
        format!("a laser scan ({}{version}, {})", file.format(), counted(file.points_expected(), "point"))
    };
    set.files().first().map_or("a laser scan".into(), of_file)
}
