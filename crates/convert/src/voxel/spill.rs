//! Spilled runs on disk, and the journal from which another process can resume.
//!
//! Two files of one name in the folder for temporary data: `.TARGET.slicewalk-<16 hex digits>.spill` holds the records;
//! `….journal` states who wrote them, then in one entry per complete run which part of the input the run covers. The
//! journal is locked while its writer lives. Nothing is synced: an entry holds checksums of itself, of all entries
//! before it and of its run, so data lost in a power failure is detected and recomputed.
//!
//! Dropping the [`Spill`] removes both files, unless [`keep`](Spill::keep) was called. A killed process leaves them;
//! [`Leftover::find`] finds them.

use crate::disk::{Access, Files, OpenFile, Temporary, leftovers, lock};
use crate::{Error, Parameter, Result};
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use xxhash_rust::xxh3::{Xxh3, xxh3_64_with_seed};

const JOURNAL: &str = ".journal";
const SPILL: &str = ".spill";
/// Magic number. Files of other layouts or of the other byte order begin differently.
const MAGIC: u64 = u64::from_be_bytes(*b"SLJRNL\x00\x02");
/// Permissions: only the owner may read a scan.
const PRIVATE: Option<u32> = Some(0o600);
/// Most bytes of a head or an entry when reading: more than is ever written.
const MOST_BYTES: u64 = 1 << 30;
const COPY_BYTES: usize = 1 << 20;

/// Location of spilled runs, and the conversion that writes them.
#[derive(Debug)]
pub struct SpillPlace {
    pub files: Files,
    pub folder: PathBuf,
    /// Name of the target without folders.
    pub name: OsString,
    /// Identity of the writer, which [`Leftover::head`] returns.
    pub head: Vec<u8>,
}

impl SpillPlace {
    /// Returns a place on the current disk for work without a target name.
    #[cfg(test)]
    pub fn unnamed(folder: &Path) -> Self {
        let files = Files::current();
        Self { files, folder: folder.to_path_buf(), name: "test".into(), head: Vec::new() }
    }
}

/// A complete run in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpilledRun {
    pub records_at: u64,
    pub records: u64,
    pub index_bytes: u64,
    pub columns: u64,
    /// True if its records are values of points.
    pub values: bool,
}

impl SpilledRun {
    pub fn bytes(&self) -> u64 {
        self.records.saturating_mul(8).saturating_add(self.index_bytes)
    }

    fn end(&self) -> u64 {
        self.records_at.saturating_add(self.bytes())
    }
}

/// The files once something is spilled. Fields are dropped in order: the spill first, because without its journal no
/// process can claim it.
#[derive(Debug)]
struct Open {
    spill: Temporary,
    journal: Temporary,
}

/// Ends of the files, and the checksum of the last entry.
#[derive(Debug, Default)]
struct Ends {
    spill: u64,
    journal: u64,
    sum: u64,
}

/// The temporary files of one conversion.
#[derive(Debug)]
pub struct Spill {
    place: SpillPlace,
    open: OnceLock<Open>,
    ends: Mutex<Ends>,
}

impl Spill {
    /// Creates an empty spill; files are created on demand.
    pub fn new(place: SpillPlace) -> Self {
        Self { place, open: OnceLock::new(), ends: Mutex::default() }
    }

    /// Returns whether anything was spilled.
    pub fn is_open(&self) -> bool {
        self.open.get().is_some()
    }

    /// Length of the file of runs (bytes).
    pub fn bytes(&self) -> u64 {
        self.ends().spill
    }

    /// Returns the path of the runs, if anything was spilled.
    pub fn path(&self) -> Option<&Path> {
        self.open.get().map(|open| open.spill.path())
    }

    /// Keeps the files for another process.
    pub fn keep(&mut self) {
        if let Some(open) = self.open.get_mut() {
            open.spill.set_stays(true);
            open.journal.set_stays(true);
        }
    }

    fn ends(&self) -> MutexGuard<'_, Ends> {
        self.ends.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn open(&self) -> Result<&Open> {
        if let Some(open) = self.open.get() {
            return Ok(open);
        }
        // Held while the files are created, so that only one worker creates them.
        let mut ends = self.ends();
        if let Some(open) = self.open.get() {
            return Ok(open);
        }
        let SpillPlace { files, folder, name, head } = &self.place;
        let refused = |error| match error {
            Error::Io { source, .. } => {
                Error::io(folder, "create a temporary file", source).with_suggestion(Parameter::TempDir)
            }
            other => other,
        };
        let journal = Temporary::create(files, folder, name, JOURNAL, PRIVATE).map_err(refused)?;
        let (bytes, sum) = block(&[&MAGIC.to_ne_bytes(), head], 0);
        write(folder, 0, || journal.write_at(0, &bytes))?;
        *ends = Ends { spill: 0, journal: bytes.len() as u64, sum };
        let path = journal.path().with_extension(&SPILL[1..]);
        let file = files.create(&path, PRIVATE).map_err(|error| refused(Error::io(&path, "create", error)))?;
        let spill = Temporary::of(files, path, file);
        Ok(self.open.get_or_init(|| Open { spill, journal }))
    }

    /// Reserves `bytes` at the end of the file and returns their offset.
    pub fn reserve(&self, bytes: u64) -> Result<u64> {
        self.open()?;
        let mut ends = self.ends();
        let at = ends.spill;
        ends.spill += bytes;
        Ok(at)
    }

    /// Writes into a reserved range.
    pub fn write(&self, at: u64, bytes: &[u8]) -> Result<()> {
        let spill = &self.open()?.spill;
        write(&self.place.folder, at, || spill.write_at(at, bytes))
    }

    /// Reads back written bytes.
    pub fn read(&self, at: u64, bytes: &mut [u8]) -> Result<()> {
        let read = self.open()?.spill.read_at(at, bytes);
        read.map_err(|error| in_folder(&self.place.folder, format!("read temporary data at byte {at}"), error))
    }

    /// Appends a complete run to the journal. `sum` is the checksum of its bytes, `cover` states which part of the
    /// input it covers.
    pub fn note(&self, run: &SpilledRun, sum: u64, cover: &[u8]) -> Result<()> {
        let journal = &self.open()?.journal;
        let mut ends = self.ends();
        let numbers = [run.records_at, run.records, run.index_bytes, run.columns, run.values.into(), sum];
        let numbers = numbers.map(u64::to_ne_bytes);
        let (bytes, sum) = block(&[numbers.as_flattened(), cover], ends.sum);
        write(&self.place.folder, ends.journal, || journal.write_at(ends.journal, &bytes))?;
        ends.journal += bytes.len() as u64;
        ends.sum = sum;
        Ok(())
    }
}

fn write(folder: &Path, at: u64, write: impl FnOnce() -> Result<()>) -> Result<()> {
    write()
        .map_err(|error| in_folder(folder, format!("write temporary data at byte {at}"), error))
        .map_err(|error| error.with_suggestion(Parameter::TempDir))
}

fn in_folder(folder: &Path, action: String, error: Error) -> Error {
    match error {
        Error::Io { source, .. } => Error::io(folder, action, source),
        other => other,
    }
}

/// Encodes a block of the journal: length, content and checksum; also returns the checksum. The checksum depends on
/// that of the block `before`, so blocks left over from another journal are invalid in this one.
fn block(content: &[&[u8]], before: u64) -> (Vec<u8>, u64) {
    let content = content.concat();
    let mut bytes = [&(content.len() as u32).to_ne_bytes(), &content[..]].concat();
    let sum = xxh3_64_with_seed(&bytes, before);
    bytes.extend(sum.to_ne_bytes());
    (bytes, sum)
}

/// Returns the content of the block at `at`, its checksum, and where the next one begins; `None` if the block is
/// incomplete or damaged.
fn read_block(file: &OpenFile, at: u64, before: u64) -> Option<(Vec<u8>, u64, u64)> {
    let mut len = [0; 4];
    file.read_exact_at(at, &mut len).ok()?;
    let len = u64::from(u32::from_ne_bytes(len));
    let end = at + 4 + len + 8;
    // A false length must not allocate memory.
    if len > MOST_BYTES || file.len().ok()? < end {
        return None;
    }
    let mut bytes = vec![0; (end - at) as usize];
    file.read_exact_at(at, &mut bytes).ok()?;
    let (block, stated) = bytes.split_last_chunk()?;
    let sum = xxh3_64_with_seed(block, before);
    (sum == u64::from_ne_bytes(*stated)).then(|| (block[4..].to_vec(), sum, end))
}

/// Incremental checksum of a run's bytes.
#[derive(Default)]
pub struct RunSum(Box<Xxh3>);

impl RunSum {
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    pub fn value(&self) -> u64 {
        self.0.digest()
    }
}

/// Temporary files of a process that ended before it could remove them; locked.
#[derive(Debug)]
pub struct Leftover {
    files: Files,
    journal: OpenFile,
    journal_path: PathBuf,
    spill_path: PathBuf,
    head: Option<Vec<u8>>,
    /// Where the entries begin, and the checksum before them.
    begin: (u64, u64),
}

impl Leftover {
    /// Finds the leftovers for the target called `name` in `folder` that belong to the user `owner`. In a shared
    /// folder, other users could plant points that were never scanned. Removes spills without a journal.
    pub fn find(files: &Files, folder: &Path, name: &OsStr, owner: Option<u32>) -> Result<Vec<Self>> {
        let mut found = Vec::new();
        // Spills first: those of a run that begins meanwhile have a journal by then.
        let spills = leftovers(files, folder, name, SPILL)?;
        let journals = leftovers(files, folder, name, JOURNAL)?;
        for spill in spills {
            if !journals.contains(&spill.with_extension(&JOURNAL[1..])) {
                let _ = files.remove(&spill);
            }
        }
        for journal_path in journals {
            let Some(journal) = lock(files, &journal_path) else { continue };
            let spill_path = journal_path.with_extension(&SPILL[1..]);
            let is_strange = |path: &Path| files.about(path).ok().flatten().is_some_and(|about| about.owner != owner);
            if is_strange(&journal_path) || is_strange(&spill_path) {
                continue;
            }
            let first = read_block(&journal, 0, 0);
            let begin = first.as_ref().map_or((0, 0), |&(_, sum, end)| (end, sum));
            let head = first.and_then(|(content, ..)| content.strip_prefix(&MAGIC.to_ne_bytes()).map(<[u8]>::to_vec));
            found.push(Self { files: files.clone(), journal, journal_path, spill_path, head, begin });
        }
        Ok(found)
    }

    /// Returns the identity of the writer, as given by [`SpillPlace::head`]; `None` if it cannot be read.
    pub fn head(&self) -> Option<&[u8]> {
        self.head.as_deref()
    }

    /// Returns the path of the runs.
    pub fn path(&self) -> &Path {
        &self.spill_path
    }

    /// Length of the file of runs (bytes).
    pub fn bytes(&self) -> u64 {
        self.files.about(&self.spill_path).ok().flatten().map_or(0, |about| about.len)
    }

    /// Removes the files.
    pub fn remove(self) {
        let _ = self.files.remove(&self.spill_path);
        let _ = self.files.remove(&self.journal_path);
    }

    /// Resumes from the files: passes each intact run with its coverage to `take`. Calls `look` after each part read,
    /// which may end the work by an error. Passes the records of a run to `see` in parts, the first of them empty,
    /// before the run is known to be intact. On failure the files stay. Cost: reads all runs.
    pub fn take_over(
        self,
        place: SpillPlace,
        look: &mut dyn FnMut(u64) -> Result<()>,
        see: &mut dyn FnMut(&SpilledRun, &[u8]),
        take: &mut dyn FnMut(SpilledRun, &[u8]) -> Result<()>,
    ) -> Result<Spill> {
        let Self { files, journal, journal_path, spill_path, begin: (mut at, mut sum), .. } = self;
        let spill = files.open(&spill_path, Access::Change).map_err(|error| Error::io(&spill_path, "open", error))?;
        let mut end = 0;
        while let Some((entry, next_sum, next)) = read_block(&journal, at, sum) {
            let Some((run, run_sum, cover)) = parse(&entry) else { break };
            // Counts damaged runs as well: what is written now must not make one look intact.
            end = end.max(run.end());
            if sum_in(&spill, &run, look, see)? == Some(run_sum) {
                take(run, cover)?;
            }
            (at, sum) = (next, next_sum);
        }
        let spill = Temporary::of(&files, spill_path, spill);
        let open = Open { spill, journal: Temporary::of(&files, journal_path, journal) };
        let spill = Spill::new(place);
        *spill.ends() = Ends { spill: end, journal: at, sum };
        let _ = spill.open.set(open);
        Ok(spill)
    }
}

/// Parses an entry: the run, its checksum, and its coverage.
fn parse(entry: &[u8]) -> Option<(SpilledRun, u64, &[u8])> {
    let (numbers, cover) = entry.split_at_checked(48)?;
    let mut numbers = numbers.as_chunks().0.iter().map(|&bytes| u64::from_ne_bytes(bytes));
    let mut next = || numbers.next();
    let (records_at, records, index_bytes, columns) = (next()?, next()?, next()?, next()?);
    let run = SpilledRun { records_at, records, index_bytes, columns, values: next()? != 0 };
    Some((run, next()?, cover))
}

/// Returns the checksum of a run's bytes in the file; `None` if some are missing.
fn sum_in(
    spill: &OpenFile,
    run: &SpilledRun,
    look: &mut dyn FnMut(u64) -> Result<()>,
    see: &mut dyn FnMut(&SpilledRun, &[u8]),
) -> Result<Option<u64>> {
    let len = spill.len().unwrap_or(0);
    if run.end() > len {
        return Ok(None);
    }
    let (mut sum, mut buffer) = (RunSum::default(), vec![0; COPY_BYTES]);
    let (mut at, index_at) = (run.records_at, run.records_at + run.records * 8);
    see(run, &[]);
    while at < run.end() {
        let count = (run.end() - at).min(COPY_BYTES as u64) as usize;
        if spill.read_exact_at(at, &mut buffer[..count]).is_err() {
            return Ok(None);
        }
        sum.update(&buffer[..count]);
        let of_records = index_at.saturating_sub(at).min(count as u64) as usize;
        if of_records > 0 {
            see(run, &buffer[..of_records]);
        }
        at += count as u64;
        look(count as u64)?;
    }
    Ok(Some(sum.value()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::disk::testing::{Call, Hooked};

    fn place(folder: &Path, head: &[u8]) -> SpillPlace {
        SpillPlace { head: head.to_vec(), ..SpillPlace::unnamed(folder) }
    }

    fn put(spill: &Spill, bytes: &[u8], cover: &[u8]) -> SpilledRun {
        let at = spill.reserve(bytes.len() as u64).unwrap();
        spill.write(at, bytes).unwrap();
        let mut sum = RunSum::default();
        sum.update(bytes);
        let records = bytes.len() as u64 / 8;
        let run =
            SpilledRun { records_at: at, records, index_bytes: bytes.len() as u64 % 8, columns: 1, values: false };
        spill.note(&run, sum.value(), cover).unwrap();
        run
    }

    fn find(folder: &Path) -> Vec<Leftover> {
        let files = Files::current();
        let owner = files.about(folder).unwrap().and_then(|about| about.owner);
        let stranger = owner.map(|owner| owner + 1);
        if stranger.is_some() {
            assert!(Leftover::find(&files, folder, OsStr::new("test"), stranger).unwrap().is_empty());
        }
        Leftover::find(&files, folder, OsStr::new("test"), owner).unwrap()
    }

    fn names(folder: &Path) -> Vec<OsString> {
        Files::current().list(folder, |_| true).unwrap()
    }

    #[test]
    fn what_is_kept_is_found_and_goes_on_and_what_is_not_kept_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let spill = Spill::new(place(folder, b"head"));
        assert!(!spill.is_open() && names(folder).is_empty());
        let first = put(&spill, b"0123456789", b"one");
        assert!(find(folder).is_empty(), "its writer lives");
        drop(spill);
        assert!(names(folder).is_empty());

        let mut spill = Spill::new(place(folder, b"head"));
        assert_eq!(put(&spill, b"0123456789", b"one"), first);
        let second = put(&spill, b"abcdefgh", b"");
        spill.keep();
        drop(spill);
        for round in 0..2 {
            let leftover = find(folder).pop().unwrap();
            assert_eq!(leftover.head(), Some(&b"head"[..]));
            let mut taken = Vec::new();
            let mut take = |run, cover: &[u8]| {
                taken.push((run, cover.to_vec()));
                Ok(())
            };
            let mut spill =
                leftover.take_over(place(folder, b"head"), &mut |_| Ok(()), &mut |_, _| {}, &mut take).unwrap();
            assert_eq!(taken[..2], [(first, b"one".to_vec()), (second, Vec::new())]);
            assert_eq!(taken.len(), 2 + round);
            put(&spill, b"more", b"three");
            let mut back = [0; 10];
            spill.read(0, &mut back).unwrap();
            assert_eq!(&back, b"0123456789");
            if round == 0 {
                spill.keep();
            }
        }
        assert!(names(folder).is_empty());
    }

    #[test]
    fn damage_anywhere_costs_the_runs_that_it_meets_and_those_behind_it_in_the_journal() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let mut spill = Spill::new(place(folder, b"head"));
        let runs = [put(&spill, b"0123456789", b"one"), put(&spill, b"abcdefgh", b"two")];
        let (spill_path, journal_path) =
            (spill.path().unwrap().to_path_buf(), spill.path().unwrap().with_extension("journal"));
        spill.keep();
        drop(spill);
        let sound = (std::fs::read(&spill_path).unwrap(), std::fs::read(&journal_path).unwrap());
        let taken = || {
            let leftover = find(folder).pop().unwrap();
            leftover.head()?;
            let mut taken = Vec::new();
            let mut take = |run, _: &[u8]| {
                taken.push(run);
                Ok(())
            };
            let mut spill =
                leftover.take_over(place(folder, b"head"), &mut |_| Ok(()), &mut |_, _| {}, &mut take).unwrap();
            spill.keep();
            Some(taken)
        };
        assert_eq!(taken(), Some(runs.to_vec()));
        for at in 0..sound.0.len() {
            let mut bytes = sound.0.clone();
            bytes[at] ^= 1;
            std::fs::write(&spill_path, bytes).unwrap();
            assert_eq!(taken(), Some(vec![runs[usize::from(at < 10)]]), "byte {at}");
        }
        std::fs::write(&spill_path, &sound.0).unwrap();
        for at in 0..sound.1.len() {
            let mut flipped = sound.1.clone();
            flipped[at] ^= 1;
            for bytes in [flipped, sound.1[..at].to_vec()] {
                std::fs::write(&journal_path, bytes).unwrap();
                let taken = taken();
                assert!(taken.is_none_or(|taken| runs.starts_with(&taken) && taken.len() < 2), "byte {at}");
            }
        }
    }

    #[test]
    fn a_spill_of_a_run_that_begins_during_the_search_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = |ending: &str| folder.path().join(format!(".test.slicewalk-0123456789abcdef{ending}"));
        let (mut lists, journal, spill) = (0, path(JOURNAL), path(SPILL));
        let created = spill.clone();
        let disk = Hooked::real(move |call| {
            lists += u32::from(call == Call::List);
            if (call, lists) == (Call::List, 2) {
                std::fs::write(&journal, "")?;
                std::fs::write(&created, "")?;
            }
            Ok(())
        });
        crate::disk::with(disk, || find(folder.path()));
        assert!(spill.exists());
    }

    #[test]
    fn a_spill_without_a_journal_is_removed_and_a_journal_without_a_head_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        std::fs::write(folder.join(".test.slicewalk-0123456789abcdef.spill"), "lost").unwrap();
        std::fs::write(folder.join(".test.slicewalk-fedcba9876543210.journal"), "").unwrap();
        std::fs::write(folder.join(".other.slicewalk-0123456789abcdef.spill"), "not ours").unwrap();
        let found = find(folder);
        assert!(found.len() == 1 && found[0].head().is_none());
        found.into_iter().for_each(Leftover::remove);
        assert_eq!(names(folder), [".other.slicewalk-0123456789abcdef.spill"]);
    }
}
