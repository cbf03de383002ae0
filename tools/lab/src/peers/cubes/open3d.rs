//! Open3D, in a process of its own: a script of Python that answers whole batches.

use super::matter::{Matter, Mesh};
use super::peer::Peer;
use super::questions::{Kind, Questions};
use crate::stability::Result;
use crate::venv::python;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use tempfile::TempDir;

const SCRIPT: &str = include_str!("../../../open3d/ask.py");

/// The script, ready to answer.
pub struct Open3d {
    child: Child,
    asks: Option<ChildStdin>,
    says: BufReader<ChildStdout>,
    folder: TempDir,
    version: String,
}

fn write<T: Copy, const N: usize>(path: &Path, items: &[[T; N]], bytes: impl Fn(T) -> Vec<u8>) -> Result<()> {
    let all: Vec<u8> = items.iter().flatten().flat_map(|v| bytes(*v)).collect();
    Ok(std::fs::write(path, all)?)
}

fn numbers(path: &Path, values: &[f64]) -> Result<()> {
    let all: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    Ok(std::fs::write(path, all)?)
}

impl Open3d {
    /// Starts it; an error says in one line why it cannot.
    pub fn new(matter: &Matter, mesh: &Mesh, questions: &Questions) -> Result<Self> {
        let python = python()?;
        let has = Command::new(&python).args(["-c", "import numpy, open3d"]).stderr(Stdio::null()).status()?;
        if !has.success() {
            return Err("the package open3d-cpu is not in the virtual environment".into());
        }
        let folder = tempfile::tempdir()?;
        let file = |name: &str| folder.path().join(name);
        std::fs::write(file("ask.py"), SCRIPT)?;
        write(&file("cubes.bin"), &matter.cubes, |v| v.to_le_bytes().into())?;
        write(&file("vertices.bin"), &mesh.vertices, |v| v.to_le_bytes().into())?;
        write(&file("triangles.bin"), &mesh.triangles, |v| v.to_le_bytes().into())?;
        numbers(&file("points.bin"), &questions.numbers(Kind::Points))?;
        numbers(&file("rays.bin"), &questions.numbers(Kind::Rays))?;
        let mut command = Command::new(python);
        command.arg(file("ask.py")).arg(folder.path()).arg(matter.edge.to_string());
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn()?;
        let (asks, says) = (child.stdin.take(), child.stdout.take().ok_or("the script has no output")?);
        let mut peer = Self { child, asks, says: BufReader::new(says), folder, version: String::new() };
        peer.version = peer.line()?;
        Ok(peer)
    }

    fn line(&mut self) -> Result<String> {
        let mut line = String::new();
        self.says.read_line(&mut line)?;
        let line = line.trim();
        if line.is_empty() { Err("the script of Open3D ended".into()) } else { Ok(line.into()) }
    }
}

impl Peer for Open3d {
    fn ask(&mut self, kind: Kind, count: usize, answers: &mut Vec<f64>) -> Result<Option<f64>> {
        let word = match kind {
            Kind::Points => "points",
            Kind::Rays => "rays",
            _ => return Ok(None),
        };
        writeln!(self.asks.as_mut().ok_or("the script has no input")?, "{word} {count}")?;
        let seconds = self.line()?.parse()?;
        let bytes = std::fs::read(self.folder.path().join("answers.bin"))?;
        answers.clear();
        answers.extend(bytes.as_chunks().0.iter().map(|value| f64::from_le_bytes(*value)));
        if answers.len() != count {
            return Err(format!("Open3D gave {} answers to {count} questions", answers.len()).into());
        }
        Ok(Some(seconds))
    }

    fn version(&self) -> Option<String> {
        Some(self.version.clone())
    }
}

impl Drop for Open3d {
    fn drop(&mut self) {
        // It exits when its input closes.
        self.asks = None;
        let _ = self.child.wait();
    }
}
