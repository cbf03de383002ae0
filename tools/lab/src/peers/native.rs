//! Peers in C++: a few plain functions around a library, built with the system's compiler if the library is installed,
//! and loaded into this process.

use crate::stability::Result;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// Source of a C++ peer and the requirements to build it.
pub struct Recipe<'a> {
    /// Its name, and what it holds.
    pub name: &'a str,
    /// The C++ itself.
    pub source: &'a str,
    /// Further files beside it: name and content.
    pub beside: &'a [(&'a str, &'a str)],
    /// Lines that compile where the library is installed.
    pub probe: &'a str,
    /// Missing package that the message names if they do not compile.
    pub missing: &'a str,
    /// Options of the compiler.
    pub options: &'a [String],
    /// Libraries to link, after the source.
    pub libraries: &'a [String],
}

impl Recipe<'_> {
    /// Builds and loads it; an error says in one line why it cannot. The files may be deleted once the library is
    /// loaded.
    pub fn load(&self) -> Result<libloading::Library> {
        let folder = tempfile::tempdir()?;
        let library = folder.path().join("libpeer.so");
        self.build(&folder, &library)?;
        // SAFETY: the library was made from our source a moment ago. It runs nothing when it is loaded but what the
        // constructors of C++ and of the library behind it do.
        unsafe { libloading::Library::new(&library) }.map_err(|e| format!("{} cannot be loaded: {e}", self.name).into())
    }

    fn build(&self, folder: &TempDir, library: &Path) -> Result<()> {
        let compiler = std::env::var_os("CXX").unwrap_or_else(|| "c++".into());
        let start = |command: &mut Command| -> Result<Output> {
            command.output().map_err(|e| format!("{} cannot be started: {e}", compiler.to_string_lossy()).into())
        };
        let (source, probe) = (folder.path().join(self.name), folder.path().join("probe.cc"));
        std::fs::write(&source, self.source)?;
        std::fs::write(&probe, self.probe)?;
        for (name, content) in self.beside {
            std::fs::write(folder.path().join(name), content)?;
        }
        let mut first = Command::new(&compiler);
        if !start(first.arg("-std=c++17").args(self.options).arg("-E").arg(&probe))?.status.success() {
            return Err(self.missing.into());
        }
        let mut build = Command::new(&compiler);
        // Tests compare answers only; to optimise the templates of OpenVDB takes a minute.
        let level = if cfg!(test) { "-O0" } else { "-O3" };
        build.args(["-std=c++17", level, "-DNDEBUG", "-shared", "-fPIC"]).args(self.options);
        let output = start(build.arg("-o").args([library, &source]).args(self.libraries))?;
        if output.status.success() {
            return Ok(());
        }
        let said = String::from_utf8_lossy(&output.stderr);
        let line = said.lines().find(|line| line.contains("error")).or(said.lines().next());
        Err(format!("{} does not compile ({}): {}", self.name, output.status, line.unwrap_or("no word why")).into())
    }
}
