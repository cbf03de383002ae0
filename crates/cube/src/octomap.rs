//! OctoMap trees: a text header, then the nodes depth first.
//!
//! A node of a `.bt` is two bits for each of its eight children (0 unknown, 1 free, 2 occupied, 3 inner node); a node of
//! a `.ot` is its log-odds (`f32`), for coloured trees three bytes of colour, and a byte with a bit for each child.
//! Children ascend with x, y and z, x lowest. The tree has 16 levels and 2¹⁶ cubes along each axis around the origin.

use super::recognise::{BINARY, FULL};
use super::window::Window;
use super::{Body, Cube, CubeReader, refuse};
use slicewalk_base::bytes::ByteSource;
use slicewalk_base::text::{grouped, one_line};
use slicewalk_base::{Error, Result};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Most bytes of the header: comments are a few lines.
const MOST_HEADER: usize = 1 << 16;
/// Levels below the root.
pub const LEVELS: u32 = 16;
/// Values of a child's two bits.
pub const FREE: u16 = 1;
pub const OCCUPIED: u16 = 2;
pub const INNER: u16 = 3;
/// Trees farther from the origin than this are not moved (cubes).
const FARTHEST: f64 = (1u64 << 40) as f64;

struct Header {
    /// Bytes of colour in a node of a `.ot`.
    colour: u64,
    nodes: u64,
    size: f64,
    /// Cubes by which slicewalk moved the tree when it wrote it.
    moved: [i64; 3],
    /// Length (bytes).
    len: u64,
}

/// Parses the header of a tree.
fn header(source: &dyn ByteSource, path: &Path) -> Result<Header> {
    let mut head = vec![0; source.len().min(MOST_HEADER as u64) as usize];
    source.read_at(0, &mut head)?;
    let damaged = |what: &str| refuse(path, "header", format!("{what}; fetch or write the file again"));
    if !head.starts_with(BINARY) && !head.starts_with(FULL) {
        return Err(refuse(path, "byte 0", "expected \"# Octomap OcTree\" as the first line, found another format"));
    }
    let (mut id, mut nodes, mut size, mut moved, mut at) = (None, None, None, None, 0);
    let once = |is_second: bool, key: &str| match is_second {
        true => Err(damaged(&format!("expected one line {key}, found two"))),
        false => Ok(()),
    };
    loop {
        let Some(end) = head[at..].iter().position(|byte| *byte == b'\n') else {
            return Err(damaged("expected a line \"data\", found none"));
        };
        let line = String::from_utf8_lossy(&head[at..at + end]).into_owned();
        at += end + 1;
        let line = line.trim_end();
        let mut words = line.split_whitespace();
        let key = words.next().unwrap_or_default();
        let value = words.next().unwrap_or_default();
        match key {
            "data" => break,
            "id" => once(id.replace(value.to_owned()).is_some(), "id")?,
            "size" => {
                let parsed = value.parse::<u64>().map_err(|_| damaged("expected a number of nodes as size"))?;
                once(nodes.replace(parsed).is_some(), "size")?;
            }
            "res" => {
                let parsed = value.parse().ok().filter(|size: &f64| *size > 0.0 && size.is_finite());
                let parsed = parsed.ok_or_else(|| damaged("expected a length above 0 as res"))?;
                once(size.replace(parsed).is_some(), "res")?;
            }
            "#" => {
                if let Some(shift) = shift(line) {
                    once(moved.replace(shift).is_some(), "\"# moved by\"")?;
                }
            }
            _ => {}
        }
    }
    let (Some(id), Some(nodes), Some(size)) = (id, nodes, size) else {
        return Err(damaged("expected lines with id, size and res, found fewer"));
    };
    let colour = match id.as_str() {
        "OcTree" | "1" => 0,
        "ColorOcTree" => 3,
        other => {
            let reason = format!(
                "expected a tree of kind OcTree or ColorOcTree, found {}; convert it with octomap's own tools",
                one_line(other)
            );
            return Err(refuse(path, "header", reason));
        }
    };
    let moved = match moved {
        None => [0; 3],
        Some(metres) => {
            let cubes = metres.map(|metres| metres / size);
            let is_whole = cubes.iter().all(|v| v.abs() < FARTHEST && (v - v.round()).abs() < 0.01);
            if !is_whole {
                return Err(damaged("the comment \"moved by\" is no whole number of cubes"));
            }
            cubes.map(|v| v.round() as i64)
        }
    };
    Ok(Header { colour, nodes, size, moved, len: at as u64 })
}

/// Parses the comment `# moved by X Y Z m` of a tree that slicewalk wrote.
fn shift(line: &str) -> Option<[f64; 3]> {
    let metres = line.strip_prefix("# moved by ")?.strip_suffix(" m")?;
    let metres: Vec<f64> = metres.split(' ').map_while(|word| word.parse().ok()).collect();
    metres.try_into().ok()
}

/// Opens a tree.
pub fn open(source: Arc<dyn ByteSource>, path: &Path) -> Result<CubeReader> {
    let Header { colour, nodes, size, moved, len } = header(&source, path)?;
    let mut first = [0; BINARY.len()];
    let is_binary = source.len() >= BINARY.len() as u64 && {
        source.read_at(0, &mut first)?;
        first == BINARY
    };
    let tree = Tree {
        path: path.to_path_buf(),
        window: Window::new(source),
        at: len,
        colour: (!is_binary).then_some(colour),
        stated: nodes,
        found: 0,
        stack: Vec::new(),
        moved,
        state: State::Root,
    };
    Ok(CubeReader { size, origin: [0.0; 3], body: Box::new(tree) })
}

/// A node whose children are being read.
struct Open {
    /// Two bits a child, as in a `.bt`.
    children: u16,
    next: u32,
    corner: [i64; 3],
    edge: i64,
}

#[derive(PartialEq)]
enum State {
    Root,
    Inside,
    Ended,
}

struct Tree {
    path: PathBuf,
    window: Window,
    /// Place of the next node in the file.
    at: u64,
    /// Bytes of colour in a node of a `.ot`; `None` for a `.bt`.
    colour: Option<u64>,
    stated: u64,
    found: u64,
    /// One node for each level.
    stack: Vec<Open>,
    moved: [i64; 3],
    state: State,
}

impl Tree {
    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let Some(bytes) = self.window.bytes(self.at)? else {
            let reason = format!(
                "expected {} nodes, found {} before the end: the file is cut; fetch or write it again",
                grouped(self.stated),
                grouped(self.found)
            );
            return Err(self.refuse(reason));
        };
        self.at += N as u64;
        Ok(bytes)
    }

    fn refuse(&self, reason: impl Into<String>) -> Error {
        refuse(&self.path, format!("byte {}", self.at), reason)
    }

    /// Reads the node of this cube, and returns the bits that a `.bt` has for it.
    fn enter(&mut self, corner: [i64; 3], edge: i64) -> Result<u16> {
        let children = match self.colour {
            None => u16::from_le_bytes(self.take()?),
            Some(colour) => {
                let odds = f32::from_le_bytes(self.take()?);
                self.at += colour;
                let [mask] = self.take()?;
                if odds.is_nan() {
                    return Err(self.refuse("a node's log-odds is no number; fetch or write the file again"));
                }
                if mask == 0 {
                    return Ok(if odds >= 0.0 { OCCUPIED } else { FREE });
                }
                // Every child has a node of its own, which says what it is.
                (0..8).filter(|child| mask >> child & 1 == 1).map(|child| INNER << (2 * child)).sum()
            }
        };
        if edge == 1 {
            let reason = format!("a node lies deeper than the {LEVELS} levels of a tree: the file is damaged");
            return Err(self.refuse(reason));
        }
        self.stack.push(Open { children, next: 0, corner, edge });
        Ok(INNER)
    }

    fn finish(&mut self) -> Result<()> {
        self.state = State::Ended;
        if self.found != self.stated {
            let reason = format!(
                "the header states {} nodes, but the tree has {}; fetch or write the file again",
                grouped(self.stated),
                grouped(self.found)
            );
            return Err(self.refuse(reason));
        }
        if self.at != self.window.len() {
            let reason =
                format!("expected the end of the file, found {} more bytes", grouped(self.window.len() - self.at));
            return Err(self.refuse(reason));
        }
        Ok(())
    }
}

impl Body for Tree {
    fn next(&mut self) -> Result<Option<Cube>> {
        let solid = |corner: [i64; 3], edge: i64, moved: [i64; 3]| {
            Some(Cube { corner: [0, 1, 2].map(|axis| corner[axis] - moved[axis]), edge })
        };
        if self.state == State::Root {
            self.state = State::Inside;
            let (corner, edge) = ([-(1 << (LEVELS - 1)); 3], 1 << LEVELS);
            if self.stated > 0 {
                self.found = 1;
                if self.enter(corner, edge)? == OCCUPIED {
                    return Ok(solid(corner, edge, self.moved));
                }
            }
        }
        while let Some(open) = self.stack.last_mut() {
            if open.next == 8 {
                self.stack.pop();
                continue;
            }
            let child = open.next;
            open.next += 1;
            let edge = open.edge / 2;
            let corner = [0, 1, 2].map(|axis| open.corner[axis] + edge * i64::from(child >> axis & 1));
            let mut bits = open.children >> (2 * child) & 3;
            if bits == 0 {
                continue;
            }
            self.found += 1;
            if self.found > self.stated {
                let reason =
                    format!("expected {} nodes, found more; fetch or write the file again", grouped(self.stated));
                return Err(self.refuse(reason));
            }
            if bits == INNER {
                bits = match (self.colour, edge) {
                    // A `.bt` has no node below the finest level; a leaf of a `.ot` has one.
                    (None, 1) => {
                        let reason =
                            format!("an inner node lies on the finest of {LEVELS} levels: the file is damaged");
                        return Err(self.refuse(reason));
                    }
                    _ => self.enter(corner, edge)?,
                };
            }
            if bits == OCCUPIED {
                return Ok(solid(corner, edge, self.moved));
            }
        }
        if self.state == State::Inside {
            self.finish()?;
        }
        Ok(None)
    }
}
