//! Multipart uploads: several parts in flight, in bounded memory; all or nothing, and nothing stays in the store
//! whatever it does wrong.

use crate::store;

use slicewalk::NoMonitor;
use slicewalk_base::Monitor;
use slicewalk_base::bytes::testing::Strike;
use slicewalk_base::output::{Existing, Output, OutputKind, Protected, upload_archive};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use store::{Fault, Server, When};

/// This program, which uploads on request.
fn server() -> Server {
    let program = std::env::current_exe().unwrap();
    Server::new(program.to_str().unwrap().to_owned().leak())
}

/// Exit code if the object had the same bytes already and was kept.
const KEPT: i32 = 3;
const UPLOADS: [&str; 3] = ["uploads::this_program_uploads", "--exact", "--nocapture"];

fn content(len: usize) -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..len).map(|at| ((at / 7) ^ (at >> 11)) as u8).collect();
    bytes[..8].copy_from_slice(b"\x89SLA\r\n\x1a\n");
    bytes
}

/// Writes as many bytes as the environment says to `s3://bucket/large.slices`; does nothing as a test. A test's
/// environment contains no address of a store, so this runs in its own process.
#[test]
fn this_program_uploads() {
    let Some(len) = std::env::var("UPLOADED_BYTES").ok().and_then(|text| text.parse().ok()) else { return };
    let existing = match std::env::var("EXISTING").unwrap().as_str() {
        "Replace" => Existing::Replace,
        "KeepSame" => Existing::KeepSame,
        _ => Existing::Refuse,
    };
    let upload = || {
        let name = Path::new("s3://bucket/large.slices");
        if let Some(file) = std::env::var_os("UPLOADED_FILE") {
            let strike = std::env::var("STOPS_AT").ok().map(|number| Strike::at(number.parse().unwrap()));
            let monitor: &dyn Monitor = match &strike {
                Some(strike) => &**strike,
                None => &NoMonitor,
            };
            return upload_archive(Path::new(&file), name, existing, monitor);
        }
        let mut output = Output::create(name, OutputKind::Archive(existing), Protected::default())?;
        output.write_at(0, &content(len))?;
        output.publish()
    };
    std::process::exit(match upload() {
        Ok(true) => 0,
        Ok(false) => KEPT,
        Err(error) => {
            eprintln!("{error}");
            1
        }
    });
}

/// Uploads `len` bytes; `Err` holds the one-line error.
fn uploads(server: &Server, len: usize, replaces: bool) -> Result<(), String> {
    uploads_over(server, len, Existing::replaced_if(replaces)).map(|was_written| assert!(was_written))
}

/// Uploads `len` bytes; returns whether it wrote the object.
fn uploads_over(server: &Server, len: usize, existing: Existing) -> Result<bool, String> {
    let mut program = server.program(Path::new("."));
    program.args(UPLOADS).env("UPLOADED_BYTES", len.to_string()).env("EXISTING", format!("{existing:?}"));
    ended(program)
}

/// Result of a program that uploads: whether it wrote the object.
fn ended(mut program: Command) -> Result<bool, String> {
    let out = program.output().unwrap();
    let said = String::from_utf8(out.stderr).unwrap();
    match out.status.code() {
        Some(0) => Ok(true),
        Some(KEPT) => Ok(false),
        Some(1) if said.lines().count() == 1 && !said.contains("very-secret") => Err(said),
        other => panic!("{other:?}: {said}"),
    }
}

const MIB: usize = 1 << 20;

#[test]
fn four_parts_are_on_their_way_and_no_more() {
    let server = server();
    let len = 57 * MIB + 11;
    // A program that waits for one part before it sends the next would wait in vain.
    server.store().gathers = 4;
    uploads(&server, len, false).unwrap();
    assert!(server.get("large.slices").unwrap() == content(len));
    let store = server.store();
    assert_eq!((store.parts[0], store.parts[2]), (12, 4), "parts, and the most at a time");
    assert!(store.connections <= 6, "{} connections", store.connections);
    assert!(store.uploads.is_empty());
}

#[test]
fn whatever_request_fails_the_object_is_whole_or_absent_and_no_upload_stays_open() {
    let server = server();
    let len = 26 * MIB;
    let whole = content(len);
    uploads(&server, len, false).unwrap();
    let requests = server.store().requests.clone();
    let begin = requests.iter().position(|line| line.ends_with("?uploads=")).unwrap();
    let last_part = requests.iter().rposition(|line| line.contains("partNumber=")).unwrap();
    let complete = requests.iter().position(|line| line.starts_with("POST") && line.contains("uploadId=")).unwrap();
    assert_eq!(requests.iter().filter(|line| line.contains("partNumber=")).count(), 6, "{requests:#?}");
    let mut outcomes = BTreeMap::new();
    let mut run = |fault: Fault, at: usize, replaces: bool| {
        server.store().objects.clear();
        server.store().uploads.clear();
        if replaces {
            server.put("large.slices", content(100));
        }
        server.set(fault, When::Once(at));
        let done = uploads(&server, len, replaces);
        let what = format!("{fault:?} at {at} ({replaces}): {done:?}");
        let found = server.get("large.slices");
        let old = replaces.then(|| content(100));
        match done.is_ok() {
            true => assert!(found.as_ref() == Some(&whole), "{what}"),
            false => assert!(found == old, "{what}"),
        }
        // An upload whose first answer was lost is unknown to the program.
        let lost = at == begin && matches!(fault, Fault::Mute | Fault::Cuts);
        let open = server.store().uploads.len();
        assert!(open == 0 || lost && open == 1, "{what}: {open} uploads are open");
        *outcomes.entry((format!("{fault:?}"), done.is_ok())).or_insert(0) += 1;
    };
    for at in 0..requests.len() {
        run(Fault::Refuses, at, false);
    }
    for fault in [Fault::Throttles, Fault::Fails, Fault::Closes, Fault::Mute, Fault::Cuts] {
        for at in [begin, begin + 1, last_part, complete, requests.len() - 1] {
            run(fault, at, at == complete);
        }
    }
    println!("{outcomes:?}");
    for fault in ["Throttles", "Fails", "Closes"] {
        assert_eq!(outcomes[&(fault.to_owned(), true)], 5, "{outcomes:?}");
    }
    assert!(outcomes[&("Refuses".to_owned(), false)] >= 8, "{outcomes:?}");
}

#[test]
fn a_store_that_fails_for_long_keeps_neither_parts_nor_the_object() {
    let server = server();
    let len = 26 * MIB;
    server.set(Fault::Throttles, When::Share(30));
    uploads(&server, len, false).unwrap();
    assert!(server.get("large.slices").unwrap() == content(len));
    assert!(server.store().uploads.is_empty());
    // An object that another writer made meanwhile stays.
    server.store().objects.clear();
    server.set(Fault::Fails, When::Never);
    server.store().rival = Some(b"first".to_vec());
    let said = uploads(&server, len, false).unwrap_err();
    assert!(said.contains("exists already"), "{said}");
    assert_eq!(server.get("large.slices").unwrap(), b"first");
    assert!(server.store().uploads.is_empty());
}

#[test]
fn an_object_that_is_there_is_replaced_kept_or_refused_as_the_caller_says() {
    let server = server();
    let (short, long) = (content(1000), content(5000));
    for existing in [Existing::Refuse, Existing::Replace, Existing::KeepSame] {
        server.store().objects.clear();
        assert_eq!(uploads_over(&server, short.len(), existing), Ok(true), "{existing:?}: the name is free");
        // Of the same bytes, of other bytes and of another length.
        let mut other = short.clone();
        other[999] ^= 1;
        for there in [&short, &other, &long] {
            server.put("large.slices", there.clone());
            let done = uploads_over(&server, short.len(), existing);
            let is_same = there == &short;
            let found = server.get("large.slices").unwrap();
            match existing {
                Existing::Replace => assert!(done == Ok(true) && found == short, "{done:?}"),
                Existing::KeepSame if is_same => assert!(done == Ok(false) && found == short, "{done:?}"),
                Existing::Refuse | Existing::KeepSame => {
                    let said = done.unwrap_err();
                    assert!(said.contains("exists already"), "{said}");
                    assert_eq!(said.contains("something else"), existing == Existing::KeepSame, "{said}");
                    assert!(found == *there, "{existing:?}");
                }
            }
        }
        // A file of another kind is never replaced.
        server.put("large.slices", b"a letter to the editor".to_vec());
        assert!(uploads_over(&server, short.len(), existing).is_err());
        assert_eq!(server.get("large.slices").unwrap(), b"a letter to the editor");
    }
}

#[test]
fn a_file_is_uploaded_if_it_is_an_archive() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    let file = folder.path().join("a.slices");
    let upload = |bytes: &[u8], existing: Existing| {
        std::fs::write(&file, bytes).unwrap();
        let mut program = server.program(Path::new("."));
        program.args(UPLOADS).env("UPLOADED_BYTES", "0").env("UPLOADED_FILE", &file);
        program.env("EXISTING", format!("{existing:?}"));
        ended(program)
    };
    let archive = content(3000);
    for bad in [&b"a letter"[..], &[], &archive[..7], &archive[1..]] {
        let said = upload(bad, Existing::Replace).unwrap_err();
        assert!(said.contains("is not a slice archive"), "{said}");
        assert!(server.get("large.slices").is_none());
    }
    assert_eq!(upload(&archive, Existing::Refuse), Ok(true));
    assert!(server.get("large.slices").unwrap() == archive);
    assert_eq!(upload(&archive, Existing::KeepSame), Ok(false));
    assert!(upload(&archive, Existing::Refuse).unwrap_err().contains("exists already"));
    assert_eq!(upload(&archive, Existing::Replace), Ok(true));
    // Not the address of a store: refused before anything is read.
    let here = upload_archive(&file, &folder.path().join("b.slices"), Existing::Replace, &NoMonitor);
    assert!(here.unwrap_err().to_string().contains("not an address in an object store"));
    assert!(!folder.path().join("b.slices").exists());
}

#[test]
fn a_stopped_upload_leaves_neither_parts_nor_the_object() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    let file = folder.path().join("a.slices");
    // At the whole, at the first part, and during later parts.
    for (len, number) in [(1000, "0"), (11 * MIB, "0"), (11 * MIB, "2")] {
        std::fs::write(&file, content(len)).unwrap();
        let mut program = server.program(Path::new("."));
        program.args(UPLOADS).env("UPLOADED_BYTES", "0").env("UPLOADED_FILE", &file);
        program.env("EXISTING", "Refuse").env("STOPS_AT", number);
        let said = ended(program).unwrap_err();
        assert!(said.contains("interrupted"), "{said}");
        assert!(server.get("large.slices").is_none() && server.store().uploads.is_empty(), "{len} {number}");
    }
}

#[test]
fn what_another_writer_does_just_before_or_after_is_noticed_even_without_conditions() {
    let server = server();
    let (whole, other) = (content(1000), content(500));
    let run = |has_conditions: bool, appears: Option<usize>| {
        server.store().objects.clear();
        server.set(Fault::Fails, When::Never);
        server.store().swap = appears.map(|at| (at, "/bucket/large.slices".to_owned(), other.clone()));
        let mut program = server.program(Path::new("."));
        program.args(UPLOADS).env("UPLOADED_BYTES", whole.len().to_string()).env("EXISTING", "Refuse");
        if !has_conditions {
            program.env("AWS_CONDITIONAL_PUT", "disabled");
        }
        ended(program)
    };
    for has_conditions in [true, false] {
        assert_eq!(run(has_conditions, None), Ok(true));
        assert!(server.get("large.slices").unwrap() == whole);
        let requests = server.store().requests.clone();
        let put = requests.iter().position(|line| line.starts_with("PUT")).unwrap();
        // Without conditions, the program looks directly before it writes.
        let said = run(has_conditions, Some(put - usize::from(!has_conditions))).unwrap_err();
        assert!(said.contains("exists already"), "{said}");
        assert!(server.get("large.slices").unwrap() == other);
        let said = run(has_conditions, Some(put + 1)).unwrap_err();
        assert!(said.contains("500 bytes of 1000"), "{said}");
    }
}
