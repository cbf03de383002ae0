//! Shell completions and manual pages, generated from the argument definitions.

use crate::{Arguments, Failure, Outcome};
use clap::CommandFactory;
use slicewalk_base::output::{Output, OutputKind, Protected};
use slicewalk_base::text::counted;
use std::path::Path;

/// Prints completions for `shell`.
pub fn completions(shell: clap_complete::Shell) -> Outcome {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "slicetool", &mut text);
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// Writes manual pages to `folder`, one for the program and one per command: `slicetool-info.1` and so on.
pub fn write(folder: &Path) -> Outcome {
    let failed = |error| Failure::Text(format!("{}: cannot create: {error}", folder.display()));
    std::fs::create_dir_all(folder).map_err(failed)?;
    let mut program = Arguments::command().disable_help_subcommand(true);
    program.build();
    let pages: Vec<_> = program.get_subcommands().chain([&program]).collect();
    for &page in &pages {
        let path = folder.join(format!("{}.1", page.get_display_name().unwrap_or(page.get_name())));
        let mut text = Vec::new();
        let source = concat!("slicewalk ", env!("CARGO_PKG_VERSION"));
        clap_mangen::Man::new(page.clone()).source(source).manual("Slicewalk").render(&mut text)?;
        let mut output = Output::create(&path, OutputKind::Result, Protected::default())?;
        output.write_at(0, &text)?;
        output.publish()?;
    }
    Ok(format!("{}: {}\n", folder.display(), counted(pages.len() as u64, "manual page")))
}
