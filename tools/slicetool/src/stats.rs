//! `slicetool stats`: what the scene needed.

use crate::Outcome;
use serde_json::json;
use slicewalk::archive::{Archive, Place};
use std::fmt::Write;
use std::path::Path;

#[derive(Default)]
struct Stats {
    pages: [u64; 3],
    tiles: [u64; 3],
    columns: u64,
    spans: u64,
    obstacle_spans: u64,
    voxels: u64,
    obstacle_voxels: u64,
    /// Pixels by number of spans: 1, 2, 3, 4, more.
    columns_by_spans: [u64; 5],
    /// Voxels inside a span, where no height is stored.
    inner_voxels: u64,
    memory_bytes: u64,
}

const KINDS: [&str; 3] = ["stored", "shared", "uniform"];

/// Counts over all pages of the archive at `path`.
pub fn run(path: &Path, json: bool) -> Outcome {
    let archive = crate::open(path)?;
    let stats = count(&archive).map_err(|error| crate::broken(path, &error))?;
    let header = archive.header();
    let per = |amount: u64, of: u64| if of == 0 { 0.0 } else { amount as f64 / of as f64 };
    let bytes_per_voxel = per(header.file_len, stats.voxels);
    let memory_per_voxel = per(stats.memory_bytes, stats.voxels);
    if json {
        let by_kind = |counts: &[u64; 3]| {
            KINDS
                .iter()
                .zip(counts)
                .map(|(kind, count)| ((*kind).to_owned(), json!(count)))
                .collect::<serde_json::Map<_, _>>()
        };
        let facts = json!({
            "pages": by_kind(&stats.pages),
            "tiles": by_kind(&stats.tiles),
            "columns": stats.columns,
            "columns_by_spans": stats.columns_by_spans,
            "spans": { "all": stats.spans, "obstacle": stats.obstacle_spans },
            "voxels": { "occupied": stats.voxels, "obstacle": stats.obstacle_voxels, "without_height": stats.inner_voxels },
            "bytes": {
                "file": header.file_len,
                "tiles": header.bytes.pages,
                "directory": header.bytes.directory,
                "per_voxel": bytes_per_voxel,
            },
            "resident_bytes": { "all": stats.memory_bytes, "per_voxel": memory_per_voxel },
        });
        return Ok(format!("{facts:#}\n"));
    }
    let mut text = String::new();
    writeln!(text, "{:10} {:>12} {:>12}", "stored as", "pages", "tiles")?;
    for (kind, name) in KINDS.iter().enumerate() {
        writeln!(text, "{name:10} {:>12} {:>12}", stats.pages[kind], stats.tiles[kind])?;
    }
    writeln!(text, "\n{:10} {:>12}", "spans", "pixels")?;
    for (index, count) in stats.columns_by_spans.iter().enumerate() {
        let name = if index == 4 { "5 or more".to_owned() } else { (index + 1).to_string() };
        writeln!(text, "{name:10} {count:>12}")?;
    }
    writeln!(
        text,
        "\n{} voxels ({} obstacle) are {} spans ({} obstacle); {:.1} % of the voxels lie inside a span and store no height",
        stats.voxels,
        stats.obstacle_voxels,
        stats.spans,
        stats.obstacle_spans,
        100.0 * per(stats.inner_voxels, stats.voxels)
    )?;
    writeln!(
        text,
        "file {} bytes ({bytes_per_voxel:.2} per voxel): pages {}, directory {}; resident {} bytes ({memory_per_voxel:.2} per voxel)",
        header.file_len, header.bytes.pages, header.bytes.directory, stats.memory_bytes
    )?;
    Ok(text)
}

fn count(archive: &Archive) -> slicewalk::Result<Stats> {
    let mut stats = Stats::default();
    for entry in archive.entries() {
        let entry = entry?;
        let kind = match entry.place {
            Place::Stored(_) => 0,
            Place::Shared(_) => 1,
            Place::Uniform(_) => 2,
        };
        stats.pages[kind] += 1;
        stats.tiles[kind] += u64::from(entry.slices.count_ones());
        let page = archive.page(&entry)?;
        stats.memory_bytes += page.weight_bytes() as u64;
        let (voxels, obstacles) = page.voxel_counts();
        stats.voxels += voxels;
        stats.obstacle_voxels += obstacles;
        for (_, _, spans) in page.columns() {
            stats.columns += 1;
            stats.columns_by_spans[spans.len().min(5) - 1] += 1;
            for span in spans {
                stats.spans += 1;
                stats.obstacle_spans += u64::from(span.is_obstacle());
                let (first, last) = span.slices();
                stats.inner_voxels += u64::from((last - first).saturating_sub(1));
            }
        }
    }
    Ok(stats)
}
