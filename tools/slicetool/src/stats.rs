//! `slicetool stats`: statistics of how the scene is stored.

use crate::Outcome;
use serde_json::{Map, Value, json};
use slicewalk::archive::{Archive, ColourReader, Level};
use slicewalk::stats::{Need, Stats};
use slicewalk_base::text::{counted, grouped, memory_size};
use std::fmt::Write;
use std::path::Path;

const KINDS: [&str; 3] = ["stored", "shared", "uniform"];

/// Description of each need of a tile, in the order of [`Need::ALL`].
const NEEDS: [&str; 6] = [
    "one span everywhere: an entry of the directory",
    "bytes of an earlier page: an entry of the directory",
    "continues from the slice below: nothing",
    "level: one height",
    "plane: three numbers",
    "heights of its own",
];

/// Bytes of the colours of each level; empty if the levels have none.
fn level_colours(archive: &Archive) -> slicewalk::Result<Vec<u64>> {
    let levels = archive.levels()?.iter();
    let readers = levels.map(|level| ColourReader::new(&archive.level(level.number())?));
    let len = |reader: ColourReader| reader.bytes().end - reader.bytes().start;
    readers.filter_map(|reader| reader.map(|reader| reader.map(len)).transpose()).collect()
}

/// Grid and size of an overview level.
fn level_facts(level: &Level, colours: Option<&u64>) -> Value {
    let bytes = level.bytes();
    json!({
        "level": level.number(),
        "pixel_size": level.frame().pixel_m(),
        "slice_height": level.frame().slice_m(),
        "pages": level.catalog().header().pages.total(),
        "bytes": bytes.end - bytes.start,
        "colours": colours,
    })
}

/// Counts over all pages of the archive at `path`.
pub fn run(path: &Path, json: bool) -> Outcome {
    let archive = crate::open(path)?;
    let stats = Stats::of(&archive).map_err(|error| crate::broken(path, &error))?;
    let levels = archive.levels().map_err(|error| crate::broken(path, &error))?;
    let header = archive.header();
    let of_levels = level_colours(&archive).map_err(|error| crate::broken(path, &error))?;
    let seen = archive.seen_table().map_err(|error| crate::broken(path, &error))?.map_or(0, |table| table.bytes());
    let page_bytes = header.bytes.pages.saturating_sub(seen);
    let level_bytes = of_levels.iter().sum::<u64>();
    let own_colours = header.bytes.colours.saturating_sub(level_bytes);
    let per = |amount: u64, of: u64| if of == 0 { 0.0 } else { amount as f64 / of as f64 };
    let bytes_per_voxel = per(header.file_len, stats.voxels);
    let memory_per_voxel = per(stats.memory_bytes, stats.voxels);
    let slices = header.slices.map_or(0, |(lowest, highest)| (highest - lowest) as u64 + 1);
    let sum = |counts: &[u64]| counts.iter().sum::<u64>();
    let free =
        |counts: &[u64; 6]| Need::ALL.iter().zip(counts).filter(|(need, _)| need.is_free()).map(|(_, n)| n).sum();
    let free_tiles: u64 = free(&stats.needs);
    if json {
        let named = |names: &mut dyn Iterator<Item = &'static str>, counts: &[u64]| -> Value {
            names.zip(counts).map(|(name, count)| (name.to_owned(), json!(count))).collect::<Map<_, _>>().into()
        };
        let needs = |counts: &[u64; 6]| named(&mut Need::ALL.iter().map(|need| need.name()), counts);
        let facts = json!({
            "pages": named(&mut KINDS.into_iter(), &stats.pages),
            "tiles": named(&mut KINDS.into_iter(), &stats.tiles),
            "models": needs(&stats.needs),
            "models_of_walls": needs(&stats.wall_needs),
            "slices": { "all": slices, "distinct": stats.distinct_slices },
            "columns": stats.columns,
            "columns_by_spans": stats.columns_by_spans,
            "spans": { "all": stats.spans, "obstacle": stats.obstacle_spans, "inferred": stats.inferred_spans },
            "voxels": {
                "occupied": stats.voxels,
                "obstacle": stats.obstacle_voxels,
                "inferred": stats.inferred_voxels,
                "without_height": stats.inner_voxels,
            },
            "bytes": {
                "file": header.file_len,
                "tiles": page_bytes,
                "seen": seen,
                "directory": header.bytes.head + header.bytes.directory,
                "levels": header.bytes.levels,
                "colours": header.bytes.colours,
                "per_voxel": bytes_per_voxel,
            },
            "colours": header.colours.map(|colours| json!({
                "voxels": colours.voxels,
                "bytes": own_colours,
                "per_voxel": per(own_colours, colours.voxels),
                "levels": level_bytes,
            })),
            "levels": levels.iter().enumerate().map(|(at, level)| level_facts(level, of_levels.get(at))).collect::<Vec<_>>(),
            "resident_bytes": { "all": stats.memory_bytes, "per_voxel": memory_per_voxel },
        });
        return Ok(format!("{facts:#}\n"));
    }
    let mut text = String::new();
    writeln!(text, "{:10} {:>12} {:>12}", "stored as", "pages", "tiles")?;
    for (kind, name) in KINDS.iter().enumerate() {
        writeln!(text, "{name:10} {:>12} {:>12}", grouped(stats.pages[kind]), grouped(stats.tiles[kind]))?;
    }
    writeln!(text, "\n{:10} {:>12} {:>12}  what the tile needed", "model", "tiles", "with walls")?;
    for (number, need) in Need::ALL.iter().enumerate() {
        let (tiles, walls) = (grouped(stats.needs[number]), grouped(stats.wall_needs[number]));
        writeln!(text, "{:10} {tiles:>12} {walls:>12}  {}", need.name(), NEEDS[number])?;
    }
    writeln!(text, "\n{:10} {:>12}", "spans", "pixels")?;
    for (index, count) in stats.columns_by_spans.iter().enumerate() {
        let name = if index == 4 { "5 or more".to_owned() } else { (index + 1).to_string() };
        writeln!(text, "{name:10} {:>12}", grouped(*count))?;
    }
    writeln!(
        text,
        "\nThe scene needed {} of {} and {} of {}; {:.1} % of the tiles take neither bytes nor a read.",
        grouped(stats.distinct_slices),
        counted(slices, "slice"),
        grouped(sum(&stats.needs) - free_tiles),
        counted(sum(&stats.needs), "tile"),
        100.0 * per(free_tiles, sum(&stats.needs))
    )?;
    writeln!(
        text,
        "{} ({}) form {} ({}); {:.1} % of the voxels lie inside a span and store no height.",
        counted(stats.voxels, "voxel"),
        counted(stats.obstacle_voxels, "obstacle"),
        counted(stats.spans, "span"),
        counted(stats.obstacle_spans, "obstacle"),
        100.0 * per(stats.inner_voxels, stats.voxels)
    )?;
    if stats.inferred_spans > 0 {
        let (spans, voxels) = (counted(stats.inferred_spans, "span"), counted(stats.inferred_voxels, "voxel"));
        writeln!(text, "Holes are closed by {spans} of inferred floor ({voxels}), where nothing was scanned.")?;
    }
    if let Some(colours) = header.colours {
        let levels = match level_bytes {
            0 => String::new(),
            bytes => format!("; colours of overview levels take {}", counted(bytes, "byte")),
        };
        writeln!(
            text,
            "{} have a colour, in {} ({:.2} a voxel){levels}.",
            counted(colours.voxels, "voxel"),
            counted(own_colours, "byte"),
            per(own_colours, colours.voxels)
        )?;
    }
    writeln!(
        text,
        "The file has {} ({bytes_per_voxel:.2} a voxel): pages {}, directory {}, overview levels {}, seen space {}. In memory it takes {} \
         ({memory_per_voxel:.2} bytes a voxel).",
        counted(header.file_len, "byte"),
        grouped(page_bytes),
        grouped(header.bytes.head + header.bytes.directory),
        grouped(header.bytes.levels),
        grouped(seen),
        memory_size(stats.memory_bytes)
    )?;
    if !levels.is_empty() {
        let colours = if of_levels.is_empty() { "" } else { "      colours" };
        writeln!(text, "\n{:10} {:>12} {:>12} {:>12}{colours}", "level", "pixel (m)", "pages", "bytes")?;
    }
    for (at, level) in levels.iter().enumerate() {
        let (pages, bytes) = (level.catalog().header().pages.total(), level.bytes());
        let pixel_m = format!("{:.4}", level.frame().pixel_m());
        let colours = of_levels.get(at).map_or(String::new(), |bytes| format!(" {bytes:>12}"));
        let bytes = bytes.end - bytes.start;
        writeln!(text, "{:<10} {pixel_m:>12} {pages:>12} {bytes:>12}{colours}", level.number())?;
    }
    Ok(text)
}
