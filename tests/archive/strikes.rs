//! Merges, extracts and replacements of which one step fails: a read of an archive, a call of the disk, or the user stops.
//! The call says so, and what it leaves under the output's name is whole or not there. Verifications and recoveries, which
//! continue where bytes cannot be read, end when the user stops them.

use crate::common;

#[path = "../common/strikes.rs"]
mod sweeps;

use common::random::Random;
use common::{key, page, plan};
use slicewalk::archive::{
    Archive, ArchiveWriter, Bounds, EncodedColours, PageEncoder, Shard, Totals, extract, merge, merge_run, recover,
    replace,
};
use slicewalk::bytes::testing::{Strike, StruckSource};
use slicewalk::bytes::{MemorySource, hold_source};
use slicewalk::codec::ColourEncoder;
use slicewalk::colour::{ColourPlan, ColourScale};
use slicewalk::edit::{Edits, Prism};
use slicewalk::page::{Occupancy, Span};
use slicewalk::seen::{SeenBlock, SeenPage};
use slicewalk::{Error, Monitor, NoMonitor, Result};
use slicewalk_base::disk::testing::{Call, Hooked};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sweeps::{is_stop, says_the_reason, sweep};

/// An archive with everything: overview levels, colours, seen space; or a part of it.
fn archive(seed: u32, shard: Option<Shard>) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let (target, plan) = (folder.path().join("a.slices"), plan());
    let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
    let colours = ColourPlan { scale: ColourScale::of_rgb(255), error_milli: 0 };
    writer.set_levels();
    writer.set_colours(colours);
    writer.set_seen();
    shard.into_iter().for_each(|shard| writer.set_shard(shard));
    let (mut random, mut encoder, mut colour_encoder) =
        (Random(seed.into()), PageEncoder::of_plan(&plan), ColourEncoder::default());
    let keys = (-3..3).flat_map(|tx| (0..2).map(move |layer| key(tx, 0, layer)));
    let mut keys: Vec<_> =
        keys.filter(|key| shard.is_none_or(|shard| shard.columns().contains(&key.column()))).collect();
    keys.sort();
    for &key in &keys {
        let made = page((0..64).map(|at| {
            let bottom = random.below(9000);
            ((at, random.below(64)), vec![Span::new(bottom, bottom + random.below(900), at % 2 == 0).unwrap()])
        }));
        let occupancy = Occupancy::of(&made);
        let values: Vec<_> = occupancy.voxels().map(|_| Some([random.below(65_536) as u16; 3])).collect();
        let own = EncodedColours::new(&colours, &occupancy, &values, &mut colour_encoder);
        writer.put(key, encoder.encode(key, &made).with_colours(own)).unwrap();
    }
    let mut blocks = BTreeMap::new();
    for &key in &keys {
        let (of, at) = SeenBlock::place_of(key);
        let seen = if key.tx == 0 { SeenPage::ALL } else { SeenPage::decode(&std::array::from_fn(|n| n as u8)) };
        blocks.entry(of).or_insert_with(|| SeenBlock::new(of)).push(at, &seen);
    }
    blocks.values().for_each(|block| writer.put_seen(block).unwrap());
    let totals = Totals { points_read: 9, points_kept: 9, crs: "EPSG:28992".into(), ..Totals::default() };
    writer.finish(totals).unwrap();
    fs::read(&target).unwrap()
}

/// An archive in three parts.
fn parts() -> Vec<Vec<u8>> {
    let cuts = [0, key(-1, 0, 0).column(), key(1, 0, 0).column(), u64::MAX];
    let shard = |index: u32| {
        let first = cuts[index as usize - 1];
        let last = if index == 3 { u64::MAX } else { cuts[index as usize] - 1 };
        Shard { index, count: 3, first, last, plan_file: 7 }
    };
    (1..=3).map(|index| archive(index, Some(shard(index)))).collect()
}

/// Makes an archive at a path from those held under these names.
type Work = fn(&[PathBuf], &Path, &dyn Monitor) -> Result<()>;

const REGION: Bounds = ([-7.0, -1.0, -3.0], [7.0, 4.0, 30.0]);

fn extracted(inputs: &[PathBuf], output: &Path, monitor: &dyn Monitor) -> Result<()> {
    extract(&Archive::open(&inputs[0])?, &REGION, output, true, monitor).map(|_| ())
}

fn extracted_with_edits(inputs: &[PathBuf], output: &Path, monitor: &dyn Monitor) -> Result<()> {
    let mut edits = Edits::default();
    edits.remove(Prism::of_box([-6.5, 0.5, 0.0], [2.0, 2.0, 8.0])?)?;
    edits.add(Prism::of_box([5.0, 0.5, 0.0], [9.0, 2.0, 2.0])?, true)?;
    extract(&Archive::open(&inputs[0])?.with_edits(edits), &REGION, output, true, monitor).map(|_| ())
}

fn merged(inputs: &[PathBuf], output: &Path, monitor: &dyn Monitor) -> Result<()> {
    merge(inputs, output, true, monitor).map(|_| ())
}

fn merged_in_part(inputs: &[PathBuf], output: &Path, monitor: &dyn Monitor) -> Result<()> {
    merge_run(inputs, (1, 1), output, true, monitor).map(|_| ())
}

fn replaced(inputs: &[PathBuf], output: &Path, monitor: &dyn Monitor) -> Result<()> {
    replace(&inputs[0], &inputs[1], &REGION, output, true, monitor).map(|_| ())
}

#[test]
fn a_step_that_fails_is_told_and_leaves_no_half_archive() {
    let [one, other] = [4, 5].map(|seed| archive(seed, None));
    let works: [(&str, Vec<Vec<u8>>, Work); 5] = [
        ("extract", vec![one.clone()], extracted),
        ("extract edited", vec![one.clone()], extracted_with_edits),
        ("merge", parts(), merged),
        ("merge a run", parts(), merged_in_part),
        ("replace", vec![one, other], replaced),
    ];
    for (name, inputs, work) in works {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("out.slices");
        let names: Vec<_> = (0..inputs.len()).map(|n| PathBuf::from(format!("/no folder/{n}.slices"))).collect();
        let source = |n: usize| MemorySource::new(&inputs[n][..]);
        let hold = || (0..inputs.len()).for_each(|n| hold_source(&names[n], source(n)));
        let is_clean = || fs::read_dir(folder.path()).unwrap().next().is_none();
        let made = |done: Result<()>| {
            if done.is_err() {
                assert!(is_clean(), "{name}: a failure leaves something behind");
            }
            done.map(|()| {
                let bytes = fs::read(&output).unwrap();
                fs::remove_file(&output).unwrap();
                bytes
            })
        };
        hold();
        let whole = made(work(&names, &output, &NoMonitor)).unwrap();
        let mut counts = Vec::new();
        for n in 0..inputs.len() {
            hold();
            counts.push(sweep(
                &format!("{name}, reads of input {n}"),
                0,
                whole.clone(),
                true,
                says_the_reason,
                |strike| {
                    hold_source(&names[n], StruckSource::new(source(n), strike));
                    made(work(&names, &output, &NoMonitor))
                },
            ));
        }
        hold();
        counts.push(sweep(&format!("{name}, stops"), 0, whole.clone(), false, is_stop, |strike| {
            made(work(&names, &output, &**strike))
        }));
        counts.push(calls_of_the_disk(name, &whole, folder.path(), &output, || work(&names, &output, &NoMonitor)));
        println!("{name}: reads of each input, stops and calls of the disk: {counts:?}");
        assert!(counts.iter().all(|count| *count > 0), "{counts:?}");
    }
}

#[test]
fn verifications_and_recoveries_end_where_the_user_stops_them() {
    let bytes = archive(4, None);
    let sound = Archive::from_bytes(bytes.clone()).unwrap();
    let verified = |monitor: &dyn Monitor| sound.verify(monitor, &mut |finding| panic!("{finding}"));
    let whole = verified(&NoMonitor).unwrap();
    let mut counts = vec![sweep("verify, stops", 0, whole, false, is_stop, |strike| verified(&**strike))];
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (Path::new("/no folder/a.slices"), folder.path().join("out.slices"));
    let recovered = |monitor: &dyn Monitor| {
        let done = recover(input, Some(&plan()), &output, true, monitor);
        if done.is_err() {
            assert!(fs::read_dir(folder.path()).unwrap().next().is_none(), "a stop leaves something behind");
        }
        done.map(|_| fs::read(&output).unwrap()).inspect(|_| fs::remove_file(&output).unwrap())
    };
    // Without a head, pages are searched for.
    let mut headless = bytes.clone();
    headless[100] ^= 1;
    for (name, bytes) in [("recover, stops", bytes), ("recover without a head, stops", headless)] {
        hold_source(input, MemorySource::new(bytes));
        let whole = recovered(&NoMonitor).unwrap();
        counts.push(sweep(name, 0, whole, false, is_stop, |strike| recovered(&**strike)));
    }
    // Each page is asked for once, and once more where it is searched for.
    assert!(counts[0] > 0 && counts[1] == 12 && counts[2] == 24, "{counts:?}");
}

/// Lets each call of the disk fail in turn; returns their number.
fn calls_of_the_disk(name: &str, whole: &[u8], folder: &Path, output: &Path, work: impl Fn() -> Result<()>) -> u64 {
    for number in 0.. {
        let strike = Strike::at(number);
        let struck = Arc::new(std::sync::Mutex::new(None));
        let (hook, seen) = (strike.clone(), struck.clone());
        let disk = Hooked::real(move |call| {
            if !hook.hits() {
                return Ok(());
            }
            *seen.lock().unwrap() = Some(call);
            Err(std::io::Error::other(Strike::REASON))
        });
        let done = slicewalk_base::disk::with(disk, &work);
        let call = *struck.lock().unwrap();
        let left = fs::read(output).ok();
        assert!(left.as_deref().is_none_or(|left| left == whole), "{name}: half an archive after {call:?}");
        match &done {
            Ok(()) => assert!(left.is_some(), "{name}: {call:?}"),
            Err(Error::NotDurable { .. }) => assert!(left.is_some() && call != Some(Call::Write), "{name}: {call:?}"),
            Err(error) => assert!(says_the_reason(error), "{name}: {call:?}: {error}"),
        }
        // A failure that could change the bytes must be reported.
        let bears = matches!(call, Some(Call::Create | Call::Write | Call::Read | Call::Sync));
        assert!(!bears || done.is_err(), "{name}: {call:?} failed, and no error says so");
        for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            let is_kept = entry == *output || fs::read(&entry).unwrap() == whole || call == Some(Call::Remove);
            assert!(is_kept, "{name}: {} is left behind after {call:?}", entry.display());
            fs::remove_file(entry).unwrap();
        }
        if !strike.fell() {
            assert!(done.is_ok());
            return number;
        }
    }
    unreachable!("the calls of a run have an end")
}
