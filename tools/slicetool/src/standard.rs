//! `-` as a file name: standard input for tables, standard output for tables and PLY.

use crate::{Failure, Outcome, say};
use slicewalk_base::output::is_standard;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Opens a table to read; returns it with its name for messages.
pub fn table(path: &Path) -> Result<(Box<dyn Read>, String), Failure> {
    if is_standard(path) {
        return Ok((Box::new(std::io::stdin().lock()), "standard input".into()));
    }
    let name = path.display().to_string();
    let file = File::open(path).map_err(|error| Failure::Text(format!("{name}: cannot read: {error}")))?;
    Ok((Box::new(file), name))
}

/// Refuses `-` for an archive, which is read in random order; a stream does not allow that.
pub fn refuse_archive(path: &Path) -> Result<(), Failure> {
    match is_standard(path) {
        true => Err(Failure::Usage("-: an archive is not read from standard input; name a file".into())),
        false => Ok(()),
    }
}

/// Refuses to write both JSON and a table to standard output; `option` names the table.
pub fn refuse_two(option: &str, output: Option<&Path>, json: bool) -> Result<(), Failure> {
    let reason = format!("{option} - and --json both write to standard output; name a file for {option}");
    if output.is_some_and(is_standard) && json { Err(Failure::Usage(reason)) } else { Ok(()) }
}

/// Returns the message about a written file as the result, or prints it as a diagnostic if the file itself went to
/// standard output.
pub fn written(output: &Path, about: &str) -> Outcome {
    if is_standard(output) {
        about.lines().for_each(say);
        return Ok(String::new());
    }
    Ok(about.to_owned())
}
