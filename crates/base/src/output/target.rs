//! Check of the file or object at an output's target: whether the output may replace it.

#[cfg(not(feature = "remote"))]
use crate::bytes::without_feature;
use crate::bytes::{ByteSource, FileId, address, local};
#[cfg(feature = "remote")]
use crate::bytes::{check_upload, open_named};
use crate::disk::{Access, FileKind, Files, OpenFile, OpenFolder, STANDARD_OUTPUT, split};
use crate::{Error, Parameter, Result};
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

/// First bytes of every slice archive (chapter 3).
pub const ARCHIVE_MAGIC: [u8; 8] = *b"\x89SLA\r\n\x1a\n";
/// First bytes of an archive that an unreleased version wrote.
pub const DRAFT_MAGIC: [u8; 8] = *b"\x89SLIC\r\n\x1a";
/// JSON key that identifies a plan file.
pub const PLAN_KEY: &str = "slicewalk_plan";
/// Length of a file's beginning within which the key must appear (bytes).
const PLAN_START: usize = 4096;
/// Longest chain of symbolic links followed.
const MOST_LINKS: usize = 40;

/// Kind of an output, which decides what it may replace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutputKind {
    /// A slice archive. It replaces only slice archives and empty files.
    Archive(Existing),
    /// A plan. It replaces only plans and empty files.
    Plan(Existing),
    /// A picture, a table or an export. It replaces any regular file that can be written to, except archives and plans.
    Result,
}

/// Treatment of an existing file of that name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Existing {
    /// The file stays, and writing is refused.
    Refuse,
    /// The file is replaced.
    Replace,
    /// The file stays if it has exactly the bytes of the output; otherwise as for [`Refuse`](Self::Refuse).
    KeepSame,
}

impl Existing {
    /// Returns [`Replace`](Self::Replace) if the user allows it, else [`Refuse`](Self::Refuse).
    pub fn replaced_if(allowed: bool) -> Self {
        if allowed { Self::Replace } else { Self::Refuse }
    }
}

impl OutputKind {
    pub(super) fn existing(self) -> Existing {
        match self {
            Self::Archive(existing) | Self::Plan(existing) => existing,
            Self::Result => Existing::Replace,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Archive(_) => "a slice archive",
            Self::Plan(_) => "a plan",
            Self::Result => "a picture, table or export",
        }
    }

    /// Returns whether the output may replace `content`.
    fn replaces(self, content: Content) -> bool {
        match self {
            Self::Archive(_) => matches!(content, Content::Archive | Content::Nothing),
            Self::Plan(_) => matches!(content, Content::Plan | Content::Nothing),
            Self::Result => matches!(content, Content::Other | Content::Nothing),
        }
    }
}

/// Files that no output replaces, because the command reads them or writes them as another output.
#[derive(Debug, Clone, Default)]
pub struct Protected {
    files: Vec<FileId>,
    /// Files that do not exist yet: their folder, and their name in it.
    names: Vec<(FileId, OsString)>,
    addresses: Vec<String>,
}

impl Protected {
    /// Protects the file or object at `path`, and the name of a file that does not exist yet; does nothing if there is no
    /// such folder.
    pub fn add(&mut self, path: impl AsRef<Path>) {
        let file = local(path.as_ref());
        let path = file.as_deref().unwrap_or(path.as_ref());
        match address(path) {
            Some(address) => self.addresses.push(same_address(address)),
            None => match FileId::at(path) {
                Some(file) => self.files.push(file),
                None => {
                    let files = Files::current();
                    let followed = follow(&files, path).ok().filter(|(_, is_descriptor)| !is_descriptor);
                    self.names.extend(followed.and_then(|(path, _)| name_of(&files, &path)));
                }
            },
        }
    }

    /// Protects the file or object that `source` reads, if any.
    pub fn add_source(&mut self, source: &dyn ByteSource) {
        self.files.extend(source.file_id());
        source.address().iter().for_each(|address| self.add(address));
    }

    fn holds(&self, files: &Files, path: &Path) -> bool {
        !self.files.is_empty() && files.id(path).is_some_and(|id| self.files.contains(&id))
    }

    fn holds_name(&self, files: &Files, path: &Path) -> bool {
        !self.names.is_empty() && name_of(files, path).is_some_and(|name| self.names.contains(&name))
    }

    fn holds_address(&self, address: &str) -> bool {
        self.addresses.contains(&same_address(address))
    }
}

/// Returns the folder of a file and its name in it; `None` if there is no such folder.
fn name_of(files: &Files, path: &Path) -> Option<(FileId, OsString)> {
    let (folder, name) = split(path).ok()?;
    Some((files.id(folder)?, name.to_owned()))
}

/// Returns an address in one canonical spelling.
fn same_address(address: &str) -> String {
    #[cfg(feature = "remote")]
    if let Ok(url) = url::Url::parse(address) {
        let key = percent_encoding::percent_decode_str(url.path()).decode_utf8_lossy();
        return format!("{}://{}{key}", url.scheme(), url.authority());
    }
    address.to_owned()
}

impl<P: AsRef<Path>> FromIterator<P> for Protected {
    fn from_iter<I: IntoIterator<Item = P>>(paths: I) -> Self {
        let mut protected = Self::default();
        paths.into_iter().for_each(|path| protected.add(path));
        protected
    }
}

/// Destination of an output.
#[derive(Debug)]
pub(super) enum Target {
    /// Regular file, after following links: its path, its folder, and whether it existed.
    File { path: PathBuf, folder: OpenFolder, existed: bool },
    /// Pipe, terminal or device.
    Stream(OpenFile),
    /// Object at the address that is the output's name, and whether it existed.
    Object { existed: bool },
}

impl Target {
    /// Follows the links of `name`, and refuses a target that must not be replaced.
    pub fn find(files: &Files, name: &Path, kind: OutputKind, protected: &Protected) -> Result<Self> {
        let file = local(name);
        let name = file.as_deref().unwrap_or(name);
        if let Some(address) = address(name) {
            if protected.holds_address(address) {
                return Err(is_read(name));
            }
            let existed = judge_object(name, kind)? == Judged::Replaceable;
            return Ok(Self::Object { existed });
        }
        let (path, is_descriptor) = follow(files, name)?;
        let about = files.about(&path).ok().flatten();
        if is_descriptor || about.is_some_and(|about| about.kind == FileKind::Stream) {
            if kind != OutputKind::Result && is_standard(name) {
                let reason = format!("{} is not written to standard output; name a file", kind.name());
                return Err(Error::output(name, reason));
            }
            if kind != OutputKind::Result {
                let reason = format!("is not a regular file, which {} must be; choose another name", kind.name());
                return Err(Error::output(name, reason));
            }
            // A file opened by the shell is written to, not replaced.
            if about.is_some_and(|about| about.kind == FileKind::File) && protected.holds(files, &path) {
                return Err(is_read(name));
            }
            let stream = files.open(&path, Access::Append).map_err(|error| Error::io(name, "open", error))?;
            return Ok(Self::Stream(stream));
        }
        let existed = judge(files, name, &path, kind, protected)? == Judged::Replaceable;
        let (folder, _) = split(&path)?;
        let folder = files.open_folder(folder).map_err(|error| Error::io(name, "open its folder", error))?;
        Ok(Self::File { path, folder, existed })
    }
}

/// Returns whether `path` is `-`, which stands for standard output or standard input. A file of that name is `./-`.
pub fn is_standard(path: &Path) -> bool {
    path == Path::new("-")
}

/// Follows the symbolic links of `name`. Returns the target, and whether the process already has it open
/// (`/dev/stdout`).
fn follow(files: &Files, name: &Path) -> Result<(PathBuf, bool)> {
    if is_standard(name) {
        return Ok((STANDARD_OUTPUT.into(), true));
    }
    let mut path = name.to_path_buf();
    for _ in 0..MOST_LINKS {
        if is_descriptor(&path) {
            return Ok((path, true));
        }
        match files.read_link(&path) {
            Ok(to) => path = path.parent().unwrap_or(Path::new("")).join(to),
            // Not a link; any other problem shows when the path is used.
            Err(_) => return Ok((path, false)),
        }
    }
    Err(Error::output(name, "is a link that leads to itself; choose another name"))
}

/// Returns whether `path` names a descriptor: `/dev/fd/1`, `/proc/self/fd/1`.
fn is_descriptor(path: &Path) -> bool {
    let folder = path.parent().unwrap_or(Path::new(""));
    folder == Path::new("/dev/fd") || folder.starts_with("/proc") && folder.ends_with("fd")
}

/// State of a name, from [`judge`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Judged {
    /// Nothing has the name.
    Free,
    /// The existing file may be replaced, or compared.
    Replaceable,
}

/// Fails if an output of `kind` must not replace the file at `path`. `name` is what the user calls it.
pub(super) fn judge(
    files: &Files,
    name: &Path,
    path: &Path,
    kind: OutputKind,
    protected: &Protected,
) -> Result<Judged> {
    let refuse = |reason: String| Err(Error::output(name, reason));
    let about = match files.about(path) {
        Ok(Some(about)) => about,
        Ok(None) if protected.holds_name(files, path) => {
            return refuse("is another output of this command; choose another name".into());
        }
        Ok(None) => return Ok(Judged::Free),
        Err(error) => return Err(Error::io(name, "examine the existing file", error)),
    };
    match about.kind {
        FileKind::File => {}
        FileKind::Folder => return refuse("is a folder; choose another name".into()),
        FileKind::Stream | FileKind::Other => return refuse("is not a regular file; choose another name".into()),
    }
    if protected.holds(files, path) {
        return Err(is_read(name));
    }
    let content = Content::of(files, path).map_err(|error| Error::io(name, "examine the existing file", error))?;
    may_replace(name, kind, content, about.read_only)
}

/// Fails if an object of `kind` must not replace the one at the address `name`.
#[cfg(feature = "remote")]
pub(super) fn judge_object(name: &Path, kind: OutputKind) -> Result<Judged> {
    check_upload(name)?;
    let source = match open_named(name) {
        Ok(source) => source,
        Err(Error::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => return Ok(Judged::Free),
        Err(error) => return Err(error),
    };
    let mut start = vec![0; source.len().min(PLAN_START as u64) as usize];
    source.read_at(0, &mut start)?;
    may_replace(name, kind, Content::beginning(&start), false)
}

#[cfg(not(feature = "remote"))]
pub(super) fn judge_object(name: &Path, _: OutputKind) -> Result<Judged> {
    Err(without_feature(name))
}

/// Fails if an output of `kind` must not replace `content`.
fn may_replace(name: &Path, kind: OutputKind, content: Content, read_only: bool) -> Result<Judged> {
    let refuse = |reason: String| Err(Error::output(name, reason));
    if !kind.replaces(content) {
        return refuse(match (kind, content.name()) {
            (OutputKind::Result, Some(content)) => {
                format!("is {content}, which {} never replaces; choose another name", kind.name())
            }
            _ => format!("exists and is not {}, so it is not replaced; choose another name", kind.name()),
        });
    }
    match kind {
        OutputKind::Archive(Existing::Refuse) | OutputKind::Plan(Existing::Refuse) => {
            refuse("exists already".into()).map_err(|error| error.with_suggestion(Parameter::Overwrite))
        }
        OutputKind::Result if read_only => {
            refuse("exists and is read-only; make it writable, or choose another name".into())
        }
        _ => Ok(Judged::Replaceable),
    }
}

fn is_read(name: &Path) -> Error {
    Error::output(name, "is a file that this command reads, maybe under another name; choose another output")
}

/// Content of a file, recognised by its beginning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Content {
    Nothing,
    Archive,
    Plan,
    Other,
}

impl Content {
    fn of(files: &Files, path: &Path) -> io::Result<Self> {
        let mut start = vec![0; PLAN_START];
        let len = files.open(path, Access::Read)?.read_up_to(0, &mut start)?;
        start.truncate(len);
        Ok(Self::beginning(&start))
    }

    fn beginning(start: &[u8]) -> Self {
        let is_plan = || {
            let text = String::from_utf8_lossy(start);
            text.trim_start_matches('\u{feff}').trim_start().starts_with('{')
                && text.contains(&format!("\"{PLAN_KEY}\""))
        };
        match start {
            [] => Self::Nothing,
            start if start.starts_with(&ARCHIVE_MAGIC) || start.starts_with(&DRAFT_MAGIC) => Self::Archive,
            _ if is_plan() => Self::Plan,
            _ => Self::Other,
        }
    }

    fn name(self) -> Option<&'static str> {
        match self {
            Self::Archive => Some("a slice archive"),
            Self::Plan => Some("a plan"),
            Self::Nothing | Self::Other => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn protected_addresses_are_known_by_any_spelling_and_others_are_free() {
        let protected: Protected = ["s3://bucket/a b.laz", "s3://[/a"].into_iter().collect();
        assert!(protected.holds_address("s3://[/a") && !protected.holds_address("s3://[/b"), "no valid addresses");
        assert!(protected.holds_address("s3://bucket/a b.laz"));
        assert_eq!(protected.holds_address("s3://bucket/a%20b.laz"), cfg!(feature = "remote"));
        assert!(!protected.holds_address("s3://bucket/ab.laz") && !protected.holds_address("s3://other/a b.laz"));
        assert!(!Protected::default().holds_address("s3://bucket/a b.laz"));
    }
}
