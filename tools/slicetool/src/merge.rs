//! `slicetool merge`: joins the parts of a conversion.

use crate::Outcome;
use slicewalk::archive::{merge, merge_run};
use slicewalk_base::text::{counted, file_size, one_line};
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `slicetool merge`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Archives that `sliceconv --shard` wrote: all parts of one plan, in any order; files or addresses (s3://, gs://,
    /// az://, https://)
    #[arg(required = true, value_name = "SHARD")]
    shards: Vec<PathBuf>,
    /// Merge only neighbouring parts, into part I of N of a coarser cut, to be merged with its other parts later
    #[arg(long, value_name = "I/N", value_parser = slicewalk_convert::values::part)]
    part: Option<(u32, u32)>,
    /// Archive to write, a file or an address in an object store; left alone if it already has the right bytes
    #[arg(short, long, value_name = "OUT.slices")]
    output: PathBuf,
    /// Replace an existing slice archive that holds something else
    #[arg(long)]
    force: bool,
    /// Print a report as JSON
    #[arg(long)]
    json: bool,
}

/// Merges the parts; refuses missing, foreign and damaged ones by name.
pub fn run(arguments: &Arguments) -> Outcome {
    let Arguments { shards, part, output, force, json } = arguments;
    shards.iter().try_for_each(|shard| crate::standard::refuse_archive(shard))?;
    let merged = match part {
        Some(part) => merge_run(shards, *part, output, *force, &crate::terminal())?,
        None => merge(shards, output, *force, &crate::terminal())?,
    };
    let copies: Vec<String> = merged.copies.iter().map(|path| one_line(&path.to_string_lossy()).into_owned()).collect();
    if *json {
        let mut facts = slicewalk_convert::info::header_info(&merged.header, &merged.crs, &merged.units);
        facts["written"] = merged.written.into();
        facts["shards"] = (shards.len() - copies.len()).into();
        facts["copies_left_out"] = copies.into();
        facts["dropped"] = merged.dropped.into();
        return Ok(format!("{facts:#}\n"));
    }
    let mut text = String::new();
    for copy in &copies {
        writeln!(text, "{copy}: a copy of another part, left out")?;
    }
    for what in &merged.dropped {
        writeln!(text, "dropped: {what}")?;
    }
    let state = if merged.written { "written" } else { "was there already" };
    let parts = counted((shards.len() - copies.len()) as u64, "part");
    let name = output.to_string_lossy();
    writeln!(text, "{}: {state}, {parts}, {}", one_line(&name), file_size(merged.header.file_len))?;
    Ok(text)
}
