//! `slicetool merge` of parts in an object store to an archive in it: gives the bytes of local files, or a one-line
//! error and nothing visible, whatever the store does wrong.

use crate::store;

use scangen::{WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, ShardOptions, convert};
use std::fs;
use std::path::Path;
use store::{Fault, Server, When};
use tempfile::TempDir;

/// A rough floor of 40 × 10 m around the origin; `seed` determines its heights.
fn scan(path: &Path, seed: u64) {
    let mut state = seed;
    let points = (0..400 * 100).map(|number| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let height = (state >> 33) % 900;
        [f64::from(number % 400) * 0.1 - 20.0, f64::from(number / 400) * 0.1 - 5.0, height as f64 * 0.001]
    });
    write_las(path, points, &WriteSpec::for_path(path)).unwrap();
}

/// Writes the archive of the scan in `folder`, or a part of it.
fn archive(folder: &Path, name: &str, shard: Option<ShardOptions>) -> Vec<u8> {
    let mut options = ConvertOptions::new(vec![folder.join("scan.las")], folder.join(name));
    options.grid.pixel = PixelSize::Metres(0.05);
    options.shard = shard;
    options.overwrite = true;
    convert(&options, &NoMonitor).unwrap();
    fs::read(folder.join(name)).unwrap()
}

const COUNT: u32 = 3;
const PARTS: [&str; 3] = ["s3://bucket/1.slices", "s3://bucket/2.slices", "s3://bucket/3.slices"];
const WHOLE: &str = "s3://bucket/whole.slices";

/// Three parts in a store and in a folder, and the archive of the whole.
fn job() -> (TempDir, Server, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let (at, server) = (folder.path(), Server::new(env!("CARGO_BIN_EXE_slicetool")));
    scan(&at.join("scan.las"), 7);
    for index in 1..=COUNT {
        let name = format!("{index}.slices");
        server.put(&name, archive(at, &name, Some(ShardOptions { index, count: COUNT })));
    }
    let whole = archive(at, "whole.slices", None);
    (folder, server, whole)
}

fn merge<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["merge"], more, &["-o", WHOLE]].concat()
}

#[test]
fn parts_in_a_store_merge_to_an_archive_there_as_files_do() {
    let (folder, server, whole) = job();
    let at = folder.path();
    server.done(at, &merge(&PARTS)).unwrap();
    assert!(server.get("whole.slices").unwrap() == whole);
    {
        let store = server.store();
        let (connections, requests) = (store.connections, &store.requests);
        println!("merge: {} requests, {connections} connections", requests.len());
        assert!(connections <= 8 && requests.len() < 40, "{connections} connections: {requests:#?}");
    }
    // Again: the bytes exist already, so nothing is written.
    server.set(Fault::Fails, When::Never);
    server.done(at, &merge(&[PARTS[2], PARTS[0], PARTS[1]])).unwrap();
    assert!(!server.store().requests.iter().any(|line| line.starts_with("PUT")));
    // Files and objects may be mixed, also in a tree.
    server.done(at, &["merge", PARTS[0], "2.slices", "--part", "1/2", "-o", "s3://bucket/left.slices"]).unwrap();
    server.done(at, &["merge", PARTS[2], "--part", "2/2", "-o", "right.slices"]).unwrap();
    server.done(at, &["merge", "s3://bucket/left.slices", "right.slices", "-o", "here.slices"]).unwrap();
    assert!(fs::read(at.join("here.slices")).unwrap() == whole);
    // Other objects of that name stay.
    let stays = |bytes: Vec<u8>, more: &[&'static str], words: &str| {
        server.put("whole.slices", bytes.clone());
        let said = server.done(at, &merge(more)).unwrap_err();
        assert!(said.contains(words), "{words}: {said}");
        assert!(server.get("whole.slices").unwrap() == bytes);
    };
    let part = server.get("1.slices").unwrap();
    stays(part.clone(), &PARTS, "--force");
    stays(b"notes".to_vec(), &[&PARTS[..], &["--force"]].concat(), "not a slice archive");
    stays(part.clone(), &[PARTS[0], PARTS[2], "--force"], "missing of 3: 2");
    stays(part.clone(), &[PARTS[0], PARTS[1], "s3://bucket/none.slices", "--force"], "none.slices");
    stays(part, &[PARTS[0], PARTS[1], PARTS[2], WHOLE, "--force"], "this command reads");
    server.put("whole.slices", server.get("2.slices").unwrap());
    server.done(at, &merge(&[&PARTS[..], &["--force"]].concat())).unwrap();
    assert!(server.get("whole.slices").unwrap() == whole);
}

#[test]
fn whatever_a_store_does_wrong_a_merge_gives_the_bytes_or_nothing() {
    let (folder, server, whole) = job();
    let at = folder.path();
    let parts: Vec<Vec<u8>> = (1..=COUNT).map(|index| server.get(&format!("{index}.slices")).unwrap()).collect();
    let run = |fault: Fault, when: When| {
        for (index, part) in parts.iter().enumerate() {
            server.put(&format!("{}.slices", index + 1), part.clone());
        }
        server.store().objects.remove("/bucket/whole.slices");
        server.set(fault, when);
        let done = server.done(at, &merge(&PARTS));
        let found = server.get("whole.slices");
        assert!(found.as_ref().is_none_or(|found| *found == whole), "{fault:?} {when:?}: other bytes");
        // After an error the last request may still have stored the object.
        assert!(done.is_err() || found.is_some(), "{fault:?} {when:?}: {done:?}");
        assert!(server.store().uploads.is_empty());
        done
    };
    run(Fault::Fails, When::Never).unwrap();
    let requests = server.store().requests.len();
    let looks = server.store().requests.iter().filter(|line| line.starts_with("GET")).count();
    for fault in [Fault::Throttles, Fault::Closes, Fault::Cuts, Fault::OtherRange, Fault::Mute] {
        let done: Vec<bool> = (0..requests).map(|number| run(fault, When::Once(number)).is_ok()).collect();
        let succeeded = done.iter().filter(|done| **done).count();
        println!("{fault:?}: {succeeded} of {requests}");
        match fault {
            // A single failed connection is retried; a wrong range is not accepted.
            Fault::OtherRange => assert!(succeeded < requests - looks / 2, "{done:?}"),
            _ => assert_eq!(succeeded, requests, "{fault:?}: {done:?}"),
        }
    }
    run(Fault::Throttles, When::Share(25)).unwrap();
    for number in (0..requests - 1).step_by(2) {
        let said = run(Fault::Refuses, When::From(number)).unwrap_err();
        assert!(said.contains("403") && said.contains("s3://bucket/"), "from {number}: {said}");
        assert!(server.get("whole.slices").is_none(), "from {number}: {said}");
    }
}

#[test]
fn an_archive_in_a_store_is_recovered_there_and_never_replaced_by_its_own_part() {
    let (folder, server, whole) = job();
    let at = folder.path();
    server.put("whole.slices", whole.clone());
    server.done(at, &["recover", WHOLE, "-o", "s3://bucket/again.slices"]).unwrap();
    assert!(server.get("again.slices").unwrap() == whole);
    let part = ["extract", WHOLE, "--bounds=0,0,-1,1,1,1", "--force", "-o"];
    let said = server.done(at, &[&part[..], &[WHOLE]].concat()).unwrap_err();
    assert!(said.contains("is a file that this command reads"), "{said}");
    assert!(server.get("whole.slices").unwrap() == whole);
    server.done(at, &[&part[..], &["s3://bucket/again.slices"]].concat()).unwrap();
    assert!(server.get("again.slices").unwrap().len() < whole.len());
}

#[test]
fn a_part_that_is_replaced_while_it_is_read_is_noticed() {
    let (folder, server, whole) = job();
    let at = folder.path();
    server.done(at, &merge(&PARTS)).unwrap();
    let requests = server.store().requests.len();
    // The wanted part of another scan, and a part with other bytes but an equal head.
    scan(&at.join("scan.las"), 8);
    let strange = archive(at, "2.slices", Some(ShardOptions { index: 2, count: COUNT }));
    let part = server.get("2.slices").unwrap();
    let mut damaged = part.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    for other in [strange, damaged] {
        let mut refused = 0;
        for number in 0..requests {
            server.put("2.slices", part.clone());
            server.store().objects.remove("/bucket/whole.slices");
            server.set(Fault::Fails, When::Never);
            server.store().swap = Some((number, "/bucket/2.slices".into(), other.clone()));
            match server.done(at, &merge(&PARTS)) {
                Ok(()) => assert!(server.get("whole.slices").unwrap() == whole, "at {number}"),
                Err(said) => {
                    assert!(said.contains("s3://bucket/"), "{said}");
                    assert!(server.get("whole.slices").is_none(), "at {number}: {said}");
                    refused += 1;
                }
            }
            server.store().swap = None;
        }
        // Noticed at the latest when the part has been read to its end.
        println!("refused {refused} of {requests}");
        assert!(refused > requests / 4 && refused < requests, "{refused} of {requests}");
    }
}
