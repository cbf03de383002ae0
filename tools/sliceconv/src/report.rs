//! Reports of what was done, or would be, as text and as JSON.

use crate::Arguments;
use slicewalk::archive::Header;
use slicewalk::plan::{Noise, Plan};
use slicewalk_base::text::{counted, extent, file_size, grouped, lines, memory_size, number, one_line, place, rounded};
use slicewalk_convert::info::{colour_words, crs_name, noise_in_words, slice_count, units_in_words, up_in_words};
use slicewalk_convert::{PlanFile, Preview, Report, SplatCounts, UpFound};
use slicewalk_input::spacing::Spacing;
use slicewalk_terminal::say;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::{self, Write};

/// Most files that a preview lists by name; there may be thousands.
const MOST_LISTED: usize = 10;
/// Memory that a conversion may take in addition to `--memory` (bytes).
const BESIDE_MEMORY: u64 = 64 << 20;

/// Prints a result on standard output.
fn print(result: impl Display) -> io::Result<()> {
    print_bytes(format!("{}\n", lines(&result.to_string())).as_bytes())
}

/// Writes bytes to standard output. A reader that is gone is not a failure, because the work is done.
pub fn print_bytes(bytes: &[u8]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        written => written,
    }
}

pub fn of_plan(arguments: &Arguments, file: &PlanFile) -> io::Result<()> {
    say_up(arguments, file.up.as_ref());
    if arguments.json {
        let mut text = Vec::new();
        file.write_text(&mut text)?;
        print(String::from_utf8_lossy(&text).trim_end())?;
    } else if !arguments.quiet {
        let frame = &file.plan.frame;
        let (pixel, slice) = (number(frame.pixel_m()), number(frame.slice_m()));
        say(&format!("plan: pixels of {pixel} m, slices of {slice} m, {}", counted(file.inputs.len() as u64, "input")));
        file.noise.iter().for_each(|noise| say(&of_tolerance(&file.plan, noise)));
    }
    Ok(())
}

/// Describes the source of an automatic pixel size.
fn from_spacing(spacing: &Spacing) -> String {
    let Spacing { spacing_m, sampled, .. } = *spacing;
    format!("4 × the point spacing of {spacing_m:.4} m (median of {})", counted(sampled, "sampled point"))
}

/// Describes an automatic tolerance and its source.
fn of_tolerance(plan: &Plan, noise: &Noise) -> String {
    let finer =
        if plan.tolerance_quanta() == 0 { ", finer than the steps of heights, which stay as they are" } else { "" };
    format!("tolerance {} m: {}{finer}", number(plan.options.tolerance_m), noise_in_words(noise))
}

/// Says which direction was found to point up.
fn say_up(arguments: &Arguments, up: Option<&UpFound>) {
    up.filter(|_| !arguments.quiet).iter().for_each(|up| say(&format!("--up auto: {}", up_in_words(up))));
}

pub fn of_conversion(arguments: &Arguments, report: &Report, seconds: f64) -> io::Result<()> {
    say_up(arguments, report.up.as_ref());
    if arguments.json {
        let mut facts = report.info();
        facts["seconds"] = seconds.into();
        print(format!("{facts:#}"))?;
    } else if !arguments.quiet {
        summary(arguments, report, seconds);
    }
    Ok(())
}

/// Describes how many splats would be left out, and why.
fn of_splats(splats: &SplatCounts) -> String {
    let reasons = [
        (splats.transparent, "below --opacity everywhere"),
        (splats.faint, "below --min-opacity"),
        (splats.large, "above --max-size"),
        (splats.unusable, "unusable"),
    ];
    let reasons = reasons.iter().filter(|(count, _)| *count > 0);
    let reasons: Vec<_> = reasons.map(|(count, why)| format!("{} {why}", grouped(*count))).collect();
    let left_out = splats.left_out();
    let why = if left_out > 0 { format!(" ({})", reasons.join(", ")) } else { String::new() };
    format!("{}, {} of them left out{why}", counted(splats.read, "splat"), grouped(left_out))
}

/// Prints a short summary.
fn summary(arguments: &Arguments, report: &Report, seconds: f64) {
    let header = &report.header;
    let Header { points_read, points_kept, points_excluded, points_withheld, .. } = *header;
    let frame = &header.plan.frame;
    let splats = &report.splats;
    let (one, many) = match report.triangles.read {
        _ if report.cubes > 0 && report.cubes == points_read => ("cube", "cubes"),
        0 if splats.read > 0 && splats.read == points_read => ("splat", "splats"),
        0 if splats.read > 0 => ("point and splat", "points and splats"),
        0 => ("point", "points"),
        all if all == points_read => ("triangle", "triangles"),
        _ => ("points and triangles", "points and triangles"),
    };
    let things = |number: u64| format!("{} {}", grouped(number), if number == 1 { one } else { many });
    let size = header.bounds.map_or_else(String::new, |(min, max)| format!(", {}", extent(min, max, frame.pixel_m())));
    say(&format!(
        "{}: {} → {} ({}), {} of {} m{size}",
        arguments.output.clone().unwrap_or_default().display(),
        things(points_kept),
        counted(header.voxels.occupied, "voxel"),
        counted(header.voxels.obstacle, "obstacle"),
        counted(slice_count(header) as u64, "slice"),
        number(frame.slice_m())
    ));
    if points_read > points_kept {
        let moving = report.points_moving;
        // Each part reports all splats; they count in the first.
        let none = SplatCounts::default();
        let splats = if report.shard.is_some_and(|part| part.index > 1) { &none } else { splats };
        let unsolid = splats.left_out() - splats.unusable;
        let unusable = points_read - points_kept - points_excluded - points_withheld - moving - unsolid;
        let reasons = [
            (points_excluded, "by class"),
            (points_withheld, "withheld"),
            (moving, "moving"),
            (splats.transparent, "below --opacity everywhere"),
            (splats.faint, "below --min-opacity"),
            (splats.large, "above --max-size"),
            (unusable, "unusable"),
        ];
        let reasons = reasons.iter().filter(|reason| reason.0 > 0).map(|(n, why)| format!("{} {why}", grouped(*n)));
        let left_out = things(points_read - points_kept);
        say(&format!("left out: {left_out} ({})", reasons.collect::<Vec<_>>().join(", ")));
    }
    if report.points_missing > 0 {
        say(&format!("incomplete: {} could not be read", counted(report.points_missing, "point")));
    }
    if report.voxels_dropped > 0 {
        let dropped = counted(report.voxels_dropped, "voxel");
        say(&format!("dropped: {dropped} with too few points or without neighbours, and their points"));
    }
    if header.plan.options.fill_holes > 0 {
        let widest = rounded(f64::from(header.plan.options.fill_holes) * frame.pixel_m(), frame.quantum_m());
        let inferred = counted(header.voxels.inferred, "voxel");
        say(&format!("holes of up to {widest} m: closed by {inferred} of inferred floor"));
    }
    if let Some(colours) = header.colours {
        let (voxels, bytes) = (counted(colours.voxels, "voxel"), file_size(header.bytes.colours));
        let levels = header.levels.filter(|levels| levels.count > 0);
        let and_levels = levels.map_or("", |_| ", those of overview levels included");
        say(&format!("colours: {} of {voxels} in {bytes}{and_levels}", colour_words(&colours.plan)));
    }
    if let Some(spacing) = &report.spacing {
        say(&format!("pixel size {} m: {}", number(frame.pixel_m()), from_spacing(spacing)));
    }
    if let Some(noise) = &report.noise {
        say(&of_tolerance(&header.plan, noise));
    }
    if let Some(resumed) = report.resumed {
        let (points, bytes) = (counted(resumed.points, "point"), file_size(resumed.bytes));
        say(&format!("resumed: {points} from {bytes} of temporary data"));
    }
    let mut texts = BTreeMap::<String, (String, u64)>::new();
    for (path, layout) in &report.texts {
        texts.entry(layout.to_string()).or_insert_with(|| (path.display().to_string(), 0)).1 += 1;
    }
    for (layout, (first, files)) in texts.iter().take(MOST_LISTED) {
        let more = if *files > 1 { format!(" and {} more", grouped(files - 1)) } else { String::new() };
        say(&format!("columns of {first}{more}: {layout}"));
    }
    say(&format!("unit of the source: {}; the archive is in metres", units_in_words(&report.units)));
    // A part reads only some of the input.
    let sizes = match report.shard {
        None if report.input_bytes > 0 => {
            let share = 100.0 * header.file_len as f64 / report.input_bytes as f64;
            let (input, output) = (file_size(report.input_bytes), file_size(header.file_len));
            format!("{input} → {output} ({} %)", rounded(share, if share < 10.0 { 0.1 } else { 1.0 }))
        }
        _ => file_size(header.file_len),
    };
    let temporary = match report.temp_bytes {
        0 => String::new(),
        bytes => format!(", {} of temporary data", file_size(bytes)),
    };
    say(&format!("{sizes}{temporary}, {seconds:.2} s, {:.2} M {many}/s", points_read as f64 / seconds / 1e6));
}

pub fn of_preview(arguments: &Arguments, preview: &Preview) -> io::Result<()> {
    say_up(arguments, preview.up.as_ref());
    let bytes: u64 = preview.inputs.iter().map(|input| input.bytes).sum();
    let points = preview.inputs.iter().filter_map(|input| input.points).fold(0, u64::saturating_add);
    let temp_dir = arguments.temp_dir.clone().unwrap_or_else(std::env::temp_dir);
    if arguments.json {
        let mut facts = preview.info();
        facts["memory_bytes"] = arguments.memory.into();
        facts["temp_dir"] = temp_dir.to_string_lossy().into();
        return print(format!("{facts:#}"));
    }
    let frame = &preview.plan.frame;
    let (pixel, slice) = (number(frame.pixel_m()), number(frame.slice_m()));
    let spacing = preview.spacing.as_ref().map_or_else(String::new, |spacing| format!(", {}", from_spacing(spacing)));
    let files = preview.inputs.len();
    let mut rows = vec![("files", format!("{}, {}", counted(files as u64, "file"), file_size(bytes)))];
    for input in preview.inputs.iter().take(MOST_LISTED) {
        let holds = input.points.map_or("a mesh, splats or cubes".into(), |points| counted(points, "point"));
        rows.push(("", format!("{}: {holds}, {}", input.path.display(), file_size(input.bytes))));
        if let Some(text) = &input.text {
            let points = text.first_points.iter().map(|point| place(*point)).collect::<Vec<_>>();
            rows.push(("", format!("  {text}")));
            rows.push(("", format!("  first points: {}", points.join(", "))));
        }
    }
    if files > MOST_LISTED {
        rows.push(("", format!("and {} more", grouped((files - MOST_LISTED) as u64))));
    }
    rows.push(("points", format!("{} stated", grouped(points))));
    if preview.splats.read > 0 {
        rows.push(("splats", of_splats(&preview.splats)));
    }
    rows.push((
        "extent",
        preview.bounds.map_or("unknown".into(), |(min, max)| {
            let corner = |corner: [f64; 3]| corner.map(|value| rounded(value, frame.quantum_m())).join(", ");
            format!("{}, from ({}) to ({})", extent(min, max, frame.pixel_m()), corner(min), corner(max))
        }),
    ));
    rows.push(("crs", crs_name(&preview.crs).unwrap_or_else(|| "not stated".into())));
    rows.push(("unit", units_in_words(&preview.units)));
    rows.push(("grid", format!("pixels of {pixel} m{spacing}; slices of {slice} m")));
    rows.extend(preview.noise.iter().map(|noise| ("heights", of_tolerance(&preview.plan, noise))));
    let most = memory_size(arguments.memory + BESIDE_MEMORY);
    rows.push(("memory", format!("at most {most} (--memory {} and 64 MiB more)", memory_size(arguments.memory))));
    rows.push((
        "temporary",
        match preview.temp_bytes {
            0 => "nothing expected on disk".into(),
            bytes => format!("about {} in {}", file_size(bytes), temp_dir.display()),
        },
    ));
    let rows = rows.iter().map(|(name, value)| one_line(format!("{name:10}{value}").trim_end()).into_owned());
    print(rows.collect::<Vec<_>>().join("\n"))
}
