//! Whichever read of an input fails, wherever the user stops the work, and whenever the receiver of what was read fails:
//! reading ends with an error that says so. No failure is taken for damage or for the end of the file, and none is lost.

#[path = "common/strikes.rs"]
mod strikes;

use slicewalk::archive::{Archive, ColourReader, PageReader};
use slicewalk::bytes::testing::{Fault, FaultySource, Strike, StruckSource};
use slicewalk::bytes::{MemorySource, hold_source};
use slicewalk::colour::ColourSource;
use slicewalk::{Error, Monitor, NoMonitor, Result};
use slicewalk_convert::PlanFile;
use slicewalk_input::{InputOptions, InputSet, PointDecoder};
use slicewalk_mesh::{MeshBatch, MeshOptions, MeshSet};
use slicewalk_splat::{SplatOptions, SplatReader};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use strikes::{is_stop, says_the_reason, sweep};

/// Reads everything in the input at a path. Asks the monitor, and reports each batch to the strike.
type Reader = fn(&Path, &dyn Monitor, &Strike) -> Result<u64>;

/// Folder of seeds, ending by which the reader knows the format, and the reader.
const READERS: &[(&str, &str, Reader)] = &[
    ("scan", "laz", scan),
    ("points", "ply", scan),
    ("pcd", "pcd", scan),
    ("xyz", "xyz", scan),
    ("pts", "pts", scan),
    ("ptx", "ptx", scan),
    ("e57", "e57", scan),
    ("obj", "obj", mesh),
    ("ply", "ply", mesh),
    ("stl", "stl", mesh),
    ("gltf", "gltf", mesh),
    ("glb", "glb", mesh),
    ("splats", "splat", splats),
    ("plan", "json", plan),
    ("archive", "slices", archive),
    ("../../../spec/samples", "slices", archive),
];

fn scan(path: &Path, monitor: &dyn Monitor, batches: &Strike) -> Result<u64> {
    let options = InputOptions { colour: Some(ColourSource::Rgb), hash: true, ..InputOptions::default() };
    let set = InputSet::open(&[path.to_path_buf()], options, monitor)?;
    let (mut decoder, mut points) = (PointDecoder::new(), 0);
    for chunk in set.chunks() {
        decoder.decode(&set, &chunk, &mut |batch| {
            points += batch.len() as u64;
            refused(batches)
        })?;
    }
    Ok(points)
}

fn mesh(path: &Path, monitor: &dyn Monitor, batches: &Strike) -> Result<u64> {
    let options = MeshOptions { memory_bytes: 1 << 16, colours: true, hash: true, ..MeshOptions::default() };
    let set = MeshSet::open(&[path.to_path_buf()], options, monitor)?;
    let (mut feed, mut batch) = (set.feed(), MeshBatch::default());
    while feed.next_painted(&mut batch, monitor)? {
        refused(batches)?;
    }
    Ok(feed.counts().read)
}

/// With incomplete input allowed, which must not hide a failure either.
fn splats(path: &Path, monitor: &dyn Monitor, batches: &Strike) -> Result<u64> {
    let options = SplatOptions { allow_incomplete: true, memory_bytes: 16 << 20, ..SplatOptions::default() };
    let mut reader = SplatReader::open(path, &options)?;
    Ok(reader.for_each_batch(monitor, &mut |_| refused(batches))?.splats)
}

fn plan(path: &Path, _: &dyn Monitor, _: &Strike) -> Result<u64> {
    PlanFile::read(path).map(|_| 1)
}

fn archive(path: &Path, _: &dyn Monitor, _: &Strike) -> Result<u64> {
    let archive = Archive::open(path)?;
    let levels: Vec<_> = archive.levels()?.iter().map(|level| level.number()).collect();
    let (_, _, _, _) = (archive.crs()?, archive.units()?, archive.noise()?, archive.shard()?);
    archive.seen_space(1 << 30)?;
    let mut content = DefaultHasher::new();
    for archive in [Ok(archive.ignoring_inferred()), Archive::open(path)]
        .into_iter()
        .chain(levels.iter().map(|&level| Archive::open(path)?.level(level)))
    {
        let archive = archive?;
        let (mut reader, mut colours) = (PageReader::new(&archive), ColourReader::new(&archive)?);
        for entry in archive.entries() {
            let entry = entry?;
            let page = reader.page(&entry)?;
            if let Some(colours) = &mut colours {
                colours.colours_of(entry.key, page)?.values().hash(&mut content);
            }
            page.columns().for_each(|column| column.hash(&mut content));
        }
    }
    Ok(content.finish())
}

/// Fails if this is the chosen batch.
fn refused(batches: &Strike) -> Result<()> {
    if batches.hits() { Err(Error::parameter(Strike::REASON, "no more")) } else { Ok(()) }
}

/// Seeds that the readers of a folder accept.
fn seeds(folder: &str) -> impl Iterator<Item = (String, Arc<[u8]>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/seeds").join(folder);
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.into_iter().map(|path| (path.display().to_string(), std::fs::read(path).unwrap().into()))
}

#[test]
fn no_failure_is_lost_and_none_is_taken_for_damage() {
    for &(folder, ending, read) in READERS {
        let (mut sound, mut struck) = (0, [0; 3]);
        // Where several leaves cannot be read at once, each is read alone.
        let repeats = ending == "slices";
        // A PLY whose kind cannot be read is left to the reader of meshes, which reports why.
        let first = if folder == "points" { 2 } else { 0 };
        // Larger ones have no other parts.
        for (name, bytes) in seeds(folder).filter(|(_, bytes)| bytes.len() < 5600) {
            // Seeds of splats end with the name of their format.
            let ending = if folder == "splats" { name.rsplit('-').next().unwrap_or(ending) } else { ending };
            let path = PathBuf::from(format!("/no folder/a.{ending}"));
            let source = || MemorySource::new(bytes.clone());
            let never = Strike::at(u64::MAX);
            hold_source(&path, source());
            let Ok(whole) = read(&path, &NoMonitor, &never) else { continue };
            sound += 1;
            struck[0] += sweep(&format!("{name}, reads"), first, whole, repeats, says_the_reason, |strike| {
                hold_source(&path, StruckSource::new(source(), strike));
                read(&path, &NoMonitor, &never)
            });
            hold_source(&path, source());
            struck[1] +=
                sweep(&format!("{name}, stops"), 0, whole, false, is_stop, |strike| read(&path, &**strike, &never));
            struck[2] += sweep(&format!("{name}, batches"), 0, whole, false, says_the_reason, |strike| {
                read(&path, &NoMonitor, strike)
            });
        }
        println!("{folder}: {sound} seeds, failed reads, stops and batches: {struck:?}");
        assert!(sound > 0 && struck[0] > 1, "{folder}");
    }
}

/// Verification continues behind bytes that cannot be read, and says which they are.
#[test]
fn a_verification_finds_every_byte_that_cannot_be_read() {
    let mut checked = 0;
    for (name, bytes) in ["archive", "../../../spec/samples"].into_iter().flat_map(seeds) {
        let is_sound = |archive: Result<Archive>| {
            let mut unread = 0;
            let verified = archive?.verify(&NoMonitor, &mut |finding| unread += u64::from(finding.rule == "S1"))?;
            Ok::<_, Error>((verified.findings == 0, unread))
        };
        if bytes.len() > 3000 || !is_sound(Archive::from_bytes(bytes.to_vec())).is_ok_and(|(sound, _)| sound) {
            continue;
        }
        checked += 1;
        for at in (0..bytes.len() as u64).step_by(13) {
            let source = FaultySource::new(MemorySource::new(bytes.clone()));
            source.set(Fault::Fail, at..at + 1);
            match is_sound(Archive::from_source(Box::new(source))) {
                Ok((_, unread)) => assert!(unread > 0, "{name}: byte {at} is never read"),
                Err(error) => assert!(matches!(error, Error::Io { .. }), "{name}: byte {at}: {error}"),
            }
        }
        // A user may stop between any two steps.
        let whole = is_sound(Archive::from_bytes(bytes.to_vec())).unwrap().0;
        sweep(&format!("{name}, stops of a verification"), 0, whole, false, is_stop, |strike| {
            let verified = Archive::from_bytes(bytes.to_vec())?.verify(&**strike, &mut |_| ())?;
            Ok(verified.findings == 0)
        });
    }
    assert!(checked > 20, "{checked}");
}
