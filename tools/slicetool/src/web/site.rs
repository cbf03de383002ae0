//! `slicetool site`: writes the page and archives to a folder for any web host that answers range requests.
//!
//! Each file appears complete. `index.html` is written last: until then, a folder with an older site shows that site.

use super::conversion::Progress;
use super::page::INDEX;
use super::{Kind, Show, ShowArguments, Shown, TABLE};
use crate::{Failure, Outcome};
use slicewalk_base::output::{Existing, Output, OutputKind, Protected};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// Bytes copied between two looks whether to stop.
const PIECE: u64 = 16 << 20;

/// Options of `slicetool site`.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    show: ShowArguments,
    /// Folder to write; it may contain an older site
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace archives of the same name in that folder, and a start page that is not of such a site
    #[arg(long)]
    force: bool,
}

/// Writes the site and reports where it is.
pub fn run(arguments: &Arguments) -> Outcome {
    // From now on signals only ask to stop, so that no temporary file stays.
    crate::go_on()?;
    let (show, folder) = (Show::new(&arguments.show)?, &arguments.output);
    if !arguments.force {
        keep_start_page(folder)?;
    }
    if let Some(conversion) = &show.conversion {
        let progress = Progress::new(crate::signal().clone());
        conversion.run(&progress)?;
    }
    let shown = show.files.iter().map(|file| file.path.as_path());
    let read = arguments.show.inputs.iter().map(PathBuf::as_path).chain(arguments.show.edits.path());
    let mut protected: Protected = shown.chain(read).collect();
    for file in &show.files {
        if let Kind::Archive(archive) = &file.kind {
            protected.add_source(archive.source());
        }
    }
    create(folder)?;
    for file in &show.files {
        copy(file, &folder.join(&file.name), arguments.force, &protected)?;
    }
    let write = |name: &str, bytes: &[u8]| -> Result<(), Failure> {
        crate::go_on()?;
        let path = folder.join(name);
        path.parent().map_or(Ok(()), create)?;
        let mut output = Output::create(&path, OutputKind::Result, protected.clone())?;
        output.write_at(0, bytes)?;
        output.publish()?;
        Ok(())
    };
    write(TABLE, show.table(false).as_bytes())?;
    for (name, bytes) in show.page.files().filter(|(name, _)| *name != INDEX && *name != TABLE) {
        write(name, bytes)?;
    }
    write(INDEX, show.page.get(INDEX).unwrap_or_default())?;
    if let Some(conversion) = show.conversion {
        conversion.remove();
    }
    Ok(format!("{}: put this folder on any web host that answers range requests\n", folder.display()))
}

/// Refuses a folder whose start page this command did not write.
fn keep_start_page(folder: &Path) -> Result<(), Failure> {
    let (index, table) = (folder.join(INDEX), std::fs::read(folder.join(TABLE)).unwrap_or_default());
    let is_ours = serde_json::from_slice(&table).is_ok_and(|table: serde_json::Value| table["archives"].is_array());
    if is_ours || index.symlink_metadata().is_err() {
        return Ok(());
    }
    let name = index.display();
    Err(Failure::Text(format!("{name}: is of another site; choose another folder, or --force replaces it")))
}

fn create(folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder)
        .map_err(|error| Failure::Text(format!("{}: cannot create: {error}", folder.display())))
}

/// Copies an archive or a cloud. An identical archive that exists already stays.
fn copy(file: &Shown, to: &Path, force: bool, protected: &Protected) -> Result<(), Failure> {
    let existing = if force { Existing::Replace } else { Existing::KeepSame };
    let kind = match file.kind {
        Kind::Archive(_) | Kind::Converted => OutputKind::Archive(existing),
        Kind::Cloud | Kind::Tour | Kind::Settings => OutputKind::Result,
    };
    let mut output = Output::create(to, kind, protected.clone())?;
    let mut writer = std::io::BufWriter::with_capacity(1 << 20, &mut output);
    let failed = |error: std::io::Error| {
        Failure::Text(format!("{}: cannot copy to {}: {error}", file.path.display(), to.display()))
    };
    let mut from = std::fs::File::open(&file.path).map_err(failed)?;
    while std::io::copy(&mut (&mut from).take(PIECE), &mut writer).map_err(failed)? > 0 {
        crate::go_on()?;
    }
    writer.flush().map_err(failed)?;
    drop(writer);
    output.publish()?;
    Ok(())
}
