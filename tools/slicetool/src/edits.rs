//! `--edits E.json`: what has changed since the scan, as `docs/edits.md` describes it.

use crate::Failure;
use nalgebra::{Point2, Point3};
use serde::Deserialize;
use slicewalk::edit::{Edits, Prism};
use slicewalk_base::output::is_standard;
use slicewalk_base::text::{behind_mark, counted};
use std::collections::HashSet;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest file (bytes).
const MOST_BYTES: u64 = 16 << 20;
/// Most links; routes are searched between all of them.
const MOST_LINKS: usize = 100;
/// Longest time of a link (s).
const LONGEST_S: f64 = 86_400.0;
/// Longest name (characters).
const LONGEST_NAME: usize = 200;

/// The file as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object")]
struct Written {
    #[serde(default)]
    remove: Vec<Shape>,
    #[serde(default)]
    add: Vec<Shape>,
    #[serde(default)]
    doors: Vec<Shape>,
    #[serde(default)]
    links: Vec<WrittenLink>,
    #[serde(default)]
    no_go: Vec<Shape>,
}

/// Reads the lists; an error names the place of the entry.
fn parse(bytes: &[u8]) -> Result<Written, String> {
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let written = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let (place, error) = (error.path().to_string(), error.into_inner());
        // Where the text ends inside an entry, the field is unknown.
        match place.trim_end_matches(".?") {
            "." | "?" => format!("edits: {error}"),
            place => format!("edits: {place}: {error}"),
        }
    })?;
    json.end().map_err(|error| format!("edits: {error}"))?;
    Ok(written)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object")]
struct Shape {
    name: Option<String>,
    #[serde(rename = "box")]
    corners: Option<[f64; 6]>,
    outline: Option<Vec<[f64; 2]>>,
    z: Option<[f64; 2]>,
    /// Only of added solids.
    floor: Option<bool>,
    /// Only of doors.
    open: Option<bool>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object")]
struct WrittenLink {
    name: String,
    from: [f64; 3],
    to: [f64; 3],
    seconds: f64,
    #[serde(default)]
    one_way: bool,
}

/// A lift, a stair or another way that the scan does not show.
#[derive(Clone, PartialEq, Debug)]
pub struct Link {
    /// Unique name.
    pub name: String,
    /// Its ends (m).
    pub ends: [Point3<f64>; 2],
    /// Time that it takes (s).
    pub seconds: f64,
    /// True if it leads only from the first end to the second.
    pub is_one_way: bool,
}

/// Edits of an archive.
#[derive(Default)]
pub struct EditFile {
    solids: Edits,
    with_no_go: Edits,
    /// Lifts and stairs.
    pub links: Vec<Link>,
}

impl EditFile {
    /// Reads and checks a file.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        if is_standard(path) {
            let text = "--edits -: edits are read more than once, not from standard input; name a file";
            return Err(Failure::Usage(text.into()));
        }
        let failed = |reason: String| Failure::Text(format!("{}: {reason}", path.display()));
        let file = File::open(path).map_err(|error| failed(format!("cannot read: {error}")))?;
        let mut bytes = Vec::new();
        file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(|error| failed(format!("cannot read: {error}")))?;
        if bytes.len() as u64 > MOST_BYTES {
            return Err(failed(format!("edits: expected at most {MOST_BYTES} bytes, found more; draw fewer shapes")));
        }
        let bytes = behind_mark(&bytes);
        // A list would be taken for the fields in turn.
        if bytes.trim_ascii_start().first() == Some(&b'[') {
            return Err(failed("edits: invalid: expected an object, found a list".into()));
        }
        let written = parse(bytes).map_err(failed)?;
        Self::of(written).map_err(failed)
    }

    fn of(written: Written) -> Result<Self, String> {
        let mut solids = Edits::default();
        let mut names = HashSet::new();
        let lists = [("remove", written.remove), ("add", written.add), ("doors", written.doors)];
        for (list, shapes) in lists {
            for (number, shape) in shapes.into_iter().enumerate() {
                let at = format!("{list}[{number}]");
                let prism = shape.prism(&at)?;
                let done = match list {
                    "remove" => solids.remove(prism),
                    "add" => solids.add(prism, shape.floor.unwrap_or(true)),
                    _ => {
                        named(&mut names, &at, shape.name.as_deref().unwrap_or_default())?;
                        match shape.open {
                            Some(true) => solids.remove(prism),
                            Some(false) => solids.add(prism, false),
                            None => return Err(format!("{at}: open: expected true or false, found none")),
                        }
                    }
                };
                done.map_err(|error| format!("{at}: {error}"))?;
            }
        }
        let mut with_no_go = solids.clone();
        for (number, shape) in written.no_go.into_iter().enumerate() {
            let at = format!("no_go[{number}]");
            with_no_go.add(shape.prism(&at)?, false).map_err(|error| format!("{at}: {error}"))?;
        }
        if written.links.len() > MOST_LINKS {
            return Err(format!("links: expected at most {MOST_LINKS}, found {}", written.links.len()));
        }
        let mut links = Vec::new();
        for (number, link) in written.links.into_iter().enumerate() {
            let at = format!("links[{number}]");
            named(&mut names, &at, &link.name)?;
            if !(0.0..=LONGEST_S).contains(&link.seconds) {
                return Err(format!("{at}: seconds: expected 0 to {LONGEST_S}, found {}", link.seconds));
            }
            if let Some(wrong) = link.from.iter().chain(&link.to).find(|value| value.abs() > 1e9) {
                return Err(format!("{at}: expected places from -1e9 to 1e9 m, found {wrong}"));
            }
            let ends = [link.from, link.to].map(Point3::from);
            links.push(Link { name: link.name, ends, seconds: link.seconds, is_one_way: link.one_way });
        }
        Ok(Self { solids, with_no_go, links })
    }
}

/// Checks the name of a door or a link.
fn named(names: &mut HashSet<String>, at: &str, name: &str) -> Result<(), String> {
    if name.is_empty() || name.chars().count() > LONGEST_NAME {
        let found = if name.is_empty() { "none" } else { "more" };
        return Err(format!("{at}: name: expected 1 to {LONGEST_NAME} characters, found {found}"));
    }
    match names.insert(name.to_owned()) {
        true => Ok(()),
        false => Err(format!("{at}: name: expected one of its own, found {name:?} a second time")),
    }
}

impl Shape {
    fn prism(&self, at: &str) -> Result<Prism, String> {
        if self.floor.is_some() && !at.starts_with("add") {
            return Err(format!("{at}: floor: expected only in \"add\""));
        }
        if self.open.is_some() && !at.starts_with("doors") {
            return Err(format!("{at}: open: expected only in \"doors\""));
        }
        if self.name.as_ref().is_some_and(|name| name.chars().count() > LONGEST_NAME) {
            return Err(format!("{at}: name: expected at most {LONGEST_NAME} characters, found more"));
        }
        let prism = match (&self.corners, &self.outline, &self.z) {
            (Some([x, y, z, x1, y1, z1]), None, None) => Prism::of_box([*x, *y, *z], [*x1, *y1, *z1]),
            (None, Some(outline), Some([bottom, top])) => {
                let corners: Vec<Point2<f64>> = outline.iter().map(|corner| Point2::from(*corner)).collect();
                Prism::new(&corners, *bottom, *top)
            }
            _ => return Err(format!("{at}: expected \"box\", or \"outline\" and \"z\"")),
        };
        prism.map_err(|error| format!("{at}: {error}"))
    }
}

/// Option `--edits`.
#[derive(clap::Args)]
pub struct EditOption {
    /// Apply the edits of this file, which leave the archive untouched: solids added or removed, doors open or shut,
    /// lifts and stairs, no-go areas
    #[arg(id = "edits", long = "edits", value_name = "E.json")]
    file: Option<PathBuf>,
}

impl EditOption {
    /// The file, which outputs must not replace.
    pub fn path(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    /// Reads the file, or returns none without the option.
    pub fn read(&self) -> Result<Option<EditFile>, Failure> {
        self.file.as_deref().map(EditFile::read).transpose()
    }
}

impl EditFile {
    /// The edits as a pawn meets them: no-go areas are in its way.
    pub fn for_pawns(&self) -> Edits {
        self.with_no_go.clone()
    }

    /// The edits as boxes and rays meet them.
    pub fn for_queries(&self) -> Edits {
        self.solids.clone()
    }

    /// Describes what an archive with the edited solid lacks of them.
    pub fn not_solid(&self) -> Vec<String> {
        let areas = self.with_no_go.len() - self.solids.len();
        let lacking = [(areas, "no-go area"), (self.links.len(), "link")];
        lacking.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| counted(count as u64, what)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<EditFile, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("e.json");
        std::fs::write(&path, text).unwrap();
        EditFile::read(&path).map_err(|failure| match failure {
            Failure::Text(text) => text,
            _ => panic!("another kind of failure"),
        })
    }

    #[test]
    fn edits_are_read_and_bad_ones_named() {
        let all = r#"{
            "remove": [{"box": [0, 0, 0, 1, 1, 1]}],
            "add": [{"name": "ramp", "outline": [[0, 0], [2, 0], [0, 2]], "z": [0, 0.1], "floor": false}],
            "doors": [{"name": "office", "box": [0, 0, 0, 1, 0.1, 2], "open": false}],
            "links": [{"name": "lift", "from": [0, 0, 0], "to": [0, 0, 3], "seconds": 20, "one_way": true}],
            "no_go": [{"box": [5, 5, 0, 6, 6, 2]}]
        }"#;
        let edits = read(all).unwrap();
        assert_eq!((edits.for_queries().len(), edits.for_pawns().len()), (3, 4));
        assert!(edits.links[0].is_one_way && edits.links[0].seconds == 20.0);
        assert!(read("{}").unwrap().for_pawns().is_empty());
        // Editors on Windows begin a text with a byte order mark.
        assert_eq!(read(&format!("\u{feff}{all}")).unwrap().for_pawns().len(), 4);
        for (text, says) in [
            ("", "EOF"),
            ("[]", "invalid"),
            ("\u{feff}[]", "expected an object, found a list"),
            (r#"{"walls": []}"#, "unknown field `walls`"),
            (r#"{"remove": {}}"#, "edits: remove: invalid type: map, expected a sequence at line 1 column 11"),
            (r#"{"remove": [], "remove": []}"#, "duplicate field `remove`"),
            (r#"{"remove": [{"box": [0, 0, 0, 1, 1]}]}"#, "edits: remove[0].box: invalid length 5"),
            (
                "{\"add\": [{\"box\": [0, 0, 0, 1, 1, 1]},\n{\"colour\": 1}]}",
                "edits: add[1].colour: unknown field `colour`, expected one of `name`, `box`, `outline`, `z`, `floor`, `open` at \
                 line 2 column 9",
            ),
            (
                r#"{"doors": [{"name": 1}]}"#,
                "edits: doors[0].name: invalid type: integer `1`, expected a string at line 1",
            ),
            (r#"{"links": [{"name": "a"}]}"#, "edits: links[0]: missing field `from` at line 1"),
            (
                r#"{"no_go": [{"box": [0, 0, 0, 1, 1, 1]}, 5"#,
                "edits: no_go[1]: invalid type: integer `5`, expected an object at",
            ),
            (r#"{"no_go": [{"box": [0, 0, 0, 1, 1, 1]}, {"#, "edits: no_go[1]: EOF while parsing"),
            (r#"{"remove": [{"box": [0, 0, 0, 1, 1, 0]}]}"#, "remove[0]: prism: expected a bottom below the top"),
            (r#"{"remove": [{"box": [0, 0, 0, 0, 1, 1]}]}"#, "remove[0]: box: expected minima below maxima"),
            (r#"{"remove": [{"name": "a"}]}"#, r#"remove[0]: expected "box", or "outline" and "z""#),
            (r#"{"add": [{"outline": [[0, 0], [1, 1]], "z": [0, 1]}]}"#, "expected 3 to 1000 corners, found 2"),
            (r#"{"add": [{"outline": [[0, 0], [1, 1], [1e12, 0]], "z": [0, 1]}]}"#, "found 1000000000000"),
            (r#"{"doors": [{"name": "a", "box": [0, 0, 0, 1, 1, 1]}]}"#, "doors[0]: open: expected true or false"),
            (r#"{"doors": [{"open": true, "box": [0, 0, 0, 1, 1, 1]}]}"#, "doors[0]: name: expected 1 to 200"),
            (r#"{"no_go": [{"open": true, "box": [0, 0, 0, 1, 1, 1]}]}"#, "no_go[0]: open: expected only in"),
            (r#"{"links": [{"name": "a", "from": [0, 0, 0], "to": [0, 0, 1], "seconds": -1}]}"#, "links[0]: seconds"),
            (
                r#"{"doors": [{"name": "a", "box": [0, 0, 0, 1, 1, 1], "open": true}],
                    "links": [{"name": "a", "from": [0, 0, 0], "to": [0, 0, 1], "seconds": 1}]}"#,
                "links[0]: name: expected one of its own",
            ),
        ] {
            let said = read(text).err().unwrap_or_else(|| panic!("accepted: {text}"));
            assert!(said.contains(says) && said.lines().count() == 1, "{text}: {said}");
        }
    }
}
