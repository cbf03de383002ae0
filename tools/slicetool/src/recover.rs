//! `slicetool recover`: rebuilds an archive from the sound pages of a damaged one.

use crate::Outcome;
use serde_json::json;
use slicewalk::archive::{Pages, Recovered, recover};
use slicewalk_base::text::{counted, file_size, grouped, one_line};
use slicewalk_convert::PlanFile;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `slicetool recover`.
#[derive(clap::Args)]
pub struct Arguments {
    /// The damaged archive
    archive: PathBuf,
    /// Archive to write
    #[arg(short, long, value_name = "OUT.slices")]
    output: PathBuf,
    /// Grid and options, needed if the head is damaged (see `sliceconv --write-plan`)
    #[arg(long, value_name = "PLAN.json")]
    plan: Option<PathBuf>,
    /// Replace an existing slice archive
    #[arg(long)]
    force: bool,
    /// Print the findings as JSON
    #[arg(long)]
    json: bool,
}

/// Writes the sound pages. Losses are reported; they are a failure only if nothing can be written.
pub fn run(arguments: &Arguments) -> Outcome {
    let Arguments { archive, output, plan, force, json } = arguments;
    crate::standard::refuse_archive(archive)?;
    let plan = plan.as_deref().map(PlanFile::read).transpose()?.map(|file| file.plan);
    let recovered = recover(archive, plan.as_ref(), output, *force, &crate::terminal())?;
    if *json {
        let pages = |pages: Pages| json!({ "stored": pages.stored, "shared": pages.shared, "uniform": pages.uniform });
        let facts = json!({
            "complete": recovered.is_complete(),
            "head": recovered.head,
            "leaves": recovered.leaves.map(|(sound, all)| json!({ "sound": sound, "all": all })),
            "metadata": !recovered.metadata_lost,
            "pages": { "recovered": pages(recovered.found), "lost": recovered.lost.map(pages) },
            "dropped": recovered.dropped,
            "mended": recovered.mended,
            "identical": recovered.identical,
            "bytes": recovered.header.file_len,
        });
        return Ok(format!("{facts:#}\n"));
    }
    report(&recovered, output)
}

fn report(recovered: &Recovered, output: &std::path::Path) -> Outcome {
    let mut text = String::new();
    let list = |pages: Pages| {
        let [stored, shared, uniform] = [pages.stored, pages.shared, pages.uniform].map(grouped);
        format!("{stored} stored, {shared} shared, {uniform} uniform")
    };
    writeln!(text, "pages recovered: {}", list(recovered.found))?;
    match (recovered.lost, recovered.leaves) {
        (Some(lost), _) if lost.total() == 0 => writeln!(text, "pages lost: none")?,
        (Some(lost), Some((sound, all))) => {
            let (sound, leaves) = (grouped(sound as u64), counted(all as u64, "directory leaf"));
            writeln!(text, "pages lost: {} ({sound} of {leaves} were sound)", list(lost))?;
        }
        _ => writeln!(
            text,
            "pages lost: unknown; without head and directory all shared and uniform pages are, and point counts with them"
        )?,
    }
    if recovered.metadata_lost {
        writeln!(text, "metadata lost: reference system and units are unknown")?;
    }
    for (word, list) in [("dropped", &recovered.dropped), ("mended", &recovered.mended)] {
        for what in list {
            writeln!(text, "{word}: {}", one_line(what))?;
        }
    }
    let state = match (recovered.is_complete(), recovered.identical) {
        (true, true) => "complete, with the bytes that it once had",
        (true, false) => "complete",
        _ => "with losses",
    };
    let bytes = file_size(recovered.header.file_len);
    writeln!(text, "{}: {state}, {bytes}", one_line(&output.to_string_lossy()))?;
    Ok(text)
}
