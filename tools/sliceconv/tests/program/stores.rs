//! Conversion from and to an object store: the bytes of local files, or a one-line error and no partial object,
//! whatever the store does wrong.
//!
//! `slicetool merge` has such tests in `tools/slicetool/tests/stores.rs`.

use crate::scans;
use crate::store;

use scans::{Random, converts, merges_to, points, write};
use std::fs;
use std::path::Path;
use store::{Fault, Server, When};
use tempfile::TempDir;

const SLICECONV: &str = env!("CARGO_BIN_EXE_sliceconv");

const OPTIONS: [&str; 6] = ["--pixel", "0.1", "--units", "m", "--threads", "1"];

/// Two scans in the store and on disk, and the archive of both.
fn job() -> (TempDir, Server, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut all = points(24_000);
    all.retain(|point| point.iter().all(|v| v.abs() < 100.0));
    write(&at.join("west.laz"), &all);
    let east: Vec<_> = all.iter().map(|[x, y, z]| [x + 30.0, *y, *z]).collect();
    write(&at.join("east.las"), &east);
    converts(at, &[&["west.laz", "east.las", "-o", "whole.slices", "--quiet"][..], &OPTIONS].concat());
    let server = Server::new(SLICECONV);
    for name in ["west.laz", "east.las"] {
        server.put(name, fs::read(at.join(name)).unwrap());
    }
    let whole = fs::read(at.join("whole.slices")).unwrap();
    (folder, server, whole)
}

const INPUTS: [&str; 2] = ["s3://bucket/west.laz", "s3://bucket/east.las"];

fn from_and_to(output: &'static str) -> Vec<&'static str> {
    [&INPUTS[..], &["-o", output, "--quiet"], &OPTIONS].concat()
}

#[test]
#[cfg(unix)]
fn a_signal_ends_the_wait_for_a_server() {
    let folder = tempfile::tempdir().unwrap();
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", silent.local_addr().unwrap());
    for input in [&format!("{address}/a.laz"), "s3://bucket/*.laz"] {
        let mut command = std::process::Command::new(SLICECONV);
        command.current_dir(folder.path()).env("AWS_ENDPOINT", &address).env("AWS_ALLOW_HTTP", "true");
        command.args([input, "-o", "a.slices"]).stderr(std::process::Stdio::piped());
        let mut child = command.spawn().unwrap();
        let _client = silent.accept().unwrap();
        let sent = std::process::Command::new("kill").args(["-s", "INT", &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        for _ in 0..200 {
            if child.try_wait().unwrap().is_some() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
        let _ = child.kill();
        let out = child.wait_with_output().unwrap();
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!(
            (out.status.code(), &said[..]),
            (Some(130), "sliceconv: interrupted: nothing was written\n"),
            "{input}"
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "{input}");
    }
}

#[test]
fn scans_plans_parts_and_archives_in_a_store_have_the_bytes_of_local_ones() {
    let (folder, server, whole) = job();
    let at = folder.path();
    server.done(at, &from_and_to("s3://bucket/out/whole.slices")).unwrap();
    assert!(server.get("out/whole.slices").unwrap() == whole);
    // A scan of 700 kB takes few requests, and bytes read ahead are not read twice.
    let requests = server.store().requests.clone();
    assert!(requests.len() < 60, "{requests:#?}");
    assert!(requests.iter().any(|line| line == "PUT /bucket/out/whole.slices"));
    server.done(at, &from_and_to("here.slices")).unwrap();
    assert!(fs::read(at.join("here.slices")).unwrap() == whole);
    let web =
        [format!("http://{}/bucket/west.laz", server.address), format!("http://{}/bucket/east.las", server.address)];
    let mixed = [&[&web[0][..], &web[1], "-o", "web.slices", "--quiet"], &OPTIONS[..]].concat();
    server.done(at, &mixed).unwrap();
    assert!(fs::read(at.join("web.slices")).unwrap() == whole);
    let here = at.display().to_string().replace('\\', "/");
    let here = format!("file:///{}", here.trim_start_matches('/'));
    let (local, output) = (format!("{here}/west.laz"), format!("{here}/by%20name.slices"));
    server.done(at, &[&[&local[..], INPUTS[1], "-o", &output, "--quiet"], &OPTIONS[..]].concat()).unwrap();
    assert!(fs::read(at.join("by name.slices")).unwrap() == whole);
    // A plan and its parts; existing objects stay without --force, and foreign ones stay even with it.
    server.done(at, &[&INPUTS[..], &["--write-plan", "s3://bucket/plan.json", "--quiet"], &OPTIONS].concat()).unwrap();
    for shard in ["1/2", "2/2"] {
        let name = format!("s3://bucket/part{}.slices", &shard[..1]);
        let part = ["--plan", "s3://bucket/plan.json", "--shard", shard, "-o", &name, "--quiet"];
        server.done(at, &[&INPUTS[..], &part].concat()).unwrap();
    }
    for part in ["part1.slices", "part2.slices"] {
        fs::write(at.join(part), server.get(part).unwrap()).unwrap();
    }
    merges_to(&["part1.slices", "part2.slices"].map(|part| at.join(part)), &at.join("whole.slices"));
    let said = server.done(at, &from_and_to("s3://bucket/out/whole.slices")).unwrap_err();
    assert!(said.contains("exists already; --force"), "{said}");
    server.put("notes.txt", b"mine".to_vec());
    let said = server.done(at, &[&from_and_to("s3://bucket/notes.txt")[..], &["--force"]].concat()).unwrap_err();
    assert!(said.contains("not a slice archive"), "{said}");
    assert_eq!(server.get("notes.txt").unwrap(), b"mine");
    server.done(at, &[&from_and_to("s3://bucket/part1.slices")[..], &["--force"]].concat()).unwrap();
    assert!(server.get("part1.slices").unwrap() == whole);
    server.put("room.obj", b"v 0 0 0\n".to_vec());
    for (arguments, words) in [
        (vec!["s3://bucket/none.laz", "-o", "x.slices"], "cannot open: no such object (HTTP status 404 Not Found)"),
        (vec!["s3://bucket/room.obj", "-o", "x.slices"], "meshes are read from files only"),
        (vec!["s3://bucket/*.obj", "-o", "x.slices"], "room.obj: address: meshes are read from files only"),
        (vec!["s3://bucket/out/", "-o", "x.slices"], "no scan lies in it"),
        (vec!["s3://bucket/e*.laz", "-o", "x.slices"], "matches no scan"),
    ] {
        let said = server.done(at, &[&arguments[..], &OPTIONS].concat());
        assert!(said.as_ref().is_err_and(|said| said.contains(words)), "{said:?}");
    }
    let out = server.run(at, &[&["gopher://host/a.laz", "-o", "x.slices"][..], &OPTIONS].concat());
    assert!(String::from_utf8_lossy(&out.stderr).contains("supported"), "{out:?}");
    let out = server.run(at, &[&["west.laz", "-o", "http://127.0.0.1:9/x.slices"][..], &OPTIONS].concat());
    assert!(
        String::from_utf8_lossy(&out.stderr)
            .contains("only files and s3://, gs:// and az:// addresses with a name can be written"),
        "{out:?}"
    );
    assert!(server.store().uploads.is_empty());
}

#[test]
fn folders_and_patterns_name_the_scans_of_a_store_and_old_lists_are_noticed() {
    let (folder, server, whole) = job();
    let at = folder.path();
    let run = |inputs: &[&str]| {
        server.store().objects.remove("/bucket/out.slices");
        let done = server.done(at, &[inputs, &["-o", "s3://bucket/out.slices", "--quiet"], &OPTIONS].concat());
        assert_eq!(done.is_ok(), server.get("out.slices").is_some(), "{done:?}");
        done.map(|()| server.get("out.slices").unwrap() == whole)
    };
    let (west, east) = (server.get("west.laz").unwrap(), server.get("east.las").unwrap());
    server.put("tiles/a%20west.laz", west.clone());
    server.put("tiles/east.las", east.clone());
    server.put("tiles/deep/east.las", east);
    server.put("tiles/notes.txt", b"x".to_vec());
    for inputs in [
        &["s3://bucket/*.la[sz]"][..],
        &["s3://bucket/tiles/"],
        &["s3://bucket/tiles/*"],
        &["s3://bucket/tiles/*.laz", "s3://bucket/**/deep/*.las"],
    ] {
        assert_eq!(run(inputs), Ok(true), "{inputs:?}");
    }
    server.set(Fault::Cuts, When::Once(0));
    assert_eq!(run(&["s3://bucket/tiles/"]), Ok(true));
    assert!(server.store().requests[0].contains("list-type=2"), "{:?}", server.store().requests);
    server.set(Fault::Throttles, When::Share(20));
    assert_eq!(run(&["s3://bucket/tiles/"]), Ok(true));
    server.set(Fault::Refuses, When::Once(0));
    assert!(run(&["s3://bucket/tiles/"]).unwrap_err().contains("cannot list"));
    server.set(Fault::Refuses, When::Never);
    // An old list names deleted objects, and lacks new ones, which a plan from another list detects.
    let now: Vec<String> = server.store().objects.keys().cloned().collect();
    server.store().listed = Some([&now[..], &["/bucket/tiles/gone.laz".to_owned()]].concat());
    assert!(
        run(&["s3://bucket/tiles/"]).unwrap_err().contains("s3://bucket/tiles/gone.laz: cannot open: no such object")
    );
    server.store().listed = None;
    let plan = ["s3://bucket/tiles/", "--write-plan", "plan.json", "--quiet"];
    server.done(at, &[&plan[..], &OPTIONS].concat()).unwrap();
    server.store().listed = Some(now.iter().filter(|name| !name.contains("east")).cloned().collect());
    let said =
        server.done(at, &["s3://bucket/tiles/", "--plan", "plan.json", "-o", "x.slices", "--quiet"]).unwrap_err();
    assert!(said.contains("is a file of the plan, but not among the inputs"), "{said}");
}

/// A square of `side` × `side` tiles in the store, and their archive `whole.slices` on disk; returns the names of the
/// tiles.
fn tiles(at: &Path, side: usize) -> (Server, Vec<String>) {
    let (server, mut random) = (Server::new(SLICECONV), Random(9));
    let names: Vec<String> = (0..side * side).map(|number| format!("t{number:02}.laz")).collect();
    for (number, name) in names.iter().enumerate() {
        let corner = [20.0 * (number % side) as f64, 20.0 * (number / side) as f64, 0.0];
        let mut along = |axis: usize, size: f64| corner[axis] + (random.uniform() * size * 1000.0).round() / 1000.0;
        let tile: Vec<[f64; 3]> = (0..2000).map(|_| [along(0, 12.0), along(1, 12.0), along(2, 0.5)]).collect();
        write(&at.join(name), &tile);
        server.put(&format!("tiles/{name}"), fs::read(at.join(name)).unwrap());
    }
    let local: Vec<&str> = names.iter().map(|name| &name[..]).collect();
    converts(at, &[&local[..], &["-o", "whole.slices", "--quiet"], &OPTIONS].concat());
    (server, names)
}

#[test]
fn tiles_share_the_connections_of_their_threads() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (server, names) = tiles(at, 4);
    let whole = fs::read(at.join("whole.slices")).unwrap();
    for threads in ["1", "3"] {
        server.set(Fault::Fails, When::Never);
        let arguments = ["s3://bucket/tiles/", "-o", "s3://bucket/out.slices", "--quiet", "--force"];
        server.done(at, &[&arguments[..], &OPTIONS[..4], &["--threads", threads]].concat()).unwrap();
        assert!(server.get("out.slices").unwrap() == whole);
        let store = server.store();
        let (connections, requests) = (store.connections, store.requests.len());
        println!("{} tiles, {threads} threads: {requests} requests, {connections} connections", names.len());
        // Without sharing, each request would have its own. On a busy machine a few are not returned in time.
        let is_shared = 3 * connections <= requests;
        assert!(requests > 3 * names.len() && is_shared, "{requests} requests, {connections} connections");
    }
}

#[test]
fn a_part_asks_for_no_tile_that_its_columns_do_not_meet() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (server, names) = tiles(at, 4);
    let plan = ["s3://bucket/tiles/", "--write-plan", "plan.json", "--quiet"];
    server.done(at, &[&plan[..], &OPTIONS[..4], &["--threads", "4"]].concat()).unwrap();
    let part = |shard: &str, output: &str| {
        let name = format!("s3://bucket/{output}");
        server.done(at, &["s3://bucket/tiles/", "--plan", "plan.json", "--shard", shard, "-o", &name, "--quiet"])
    };
    let mut asked = Vec::new();
    for index in 1..=4 {
        server.set(Fault::Fails, When::Never);
        let output = format!("part{index}.slices");
        part(&format!("{index}/4"), &output).unwrap();
        let requests = server.store().requests.clone();
        let of = |name: &&String| requests.iter().any(|line| line.contains(&format!("/tiles/{name}")));
        asked.push(names.iter().filter(of).cloned().collect::<Vec<_>>());
        assert!(requests.len() < 12 * asked[index - 1].len() + 12, "{requests:#?}");
        fs::write(at.join(&output), server.get(&output).unwrap()).unwrap();
    }
    assert!(asked.iter().all(|asked| (1..=9).contains(&asked.len())), "{asked:?}");
    let mut all: Vec<_> = asked.concat();
    all.sort();
    all.dedup();
    assert_eq!(all, names);
    let parts: Vec<_> = (1..=4).map(|index| at.join(format!("part{index}.slices"))).collect();
    merges_to(&parts, &at.join("whole.slices"));
    // A replaced tile is detected by the parts that read it, and by no others.
    let foreign = names.iter().find(|name| !asked[0].contains(name)).unwrap();
    let tile = at.join(foreign);
    let mut bytes = fs::read(&tile).unwrap();
    let end = bytes.len() - 1;
    bytes[end] ^= 1;
    server.put(&format!("tiles/{foreign}"), bytes);
    for (index, asked) in asked.iter().enumerate() {
        let done = part(&format!("{}/4", index + 1), "again.slices");
        server.store().objects.remove("/bucket/again.slices");
        match asked.contains(foreign) {
            true => assert!(done.unwrap_err().contains("not among the files of the plan"), "{foreign} by {index}"),
            false => done.unwrap(),
        }
    }
    // One is gone, and one is new to the plan.
    server.store().objects.remove(&format!("/bucket/tiles/{foreign}"));
    let said = part("1/4", "again.slices").unwrap_err();
    assert!(said.contains(foreign) && said.contains("is a file of the plan, but not among the inputs"), "{said}");
    server.put(&format!("tiles/{foreign}"), fs::read(&tile).unwrap());
    server.put("tiles/new.laz", fs::read(at.join(&names[0])).unwrap().split_off(1));
    assert!(part("1/4", "again.slices").unwrap_err().contains("new.laz"));
}

#[test]
fn without_credentials_requests_go_unsigned_and_no_metadata_address_is_asked() {
    let (folder, server, whole) = job();
    let at = folder.path();
    let run = |metadata: Option<&str>| {
        let mut program = server.stranger(at);
        // A request to another server would show here.
        program.env("http_proxy", format!("http://{}", server.address)).env("no_proxy", "127.0.0.1");
        metadata.map(|address| program.env("AWS_METADATA_ENDPOINT", address));
        program.args(from_and_to("s3://bucket/out.slices")).output().unwrap()
    };
    let out = run(None);
    assert!(out.status.success(), "{out:?}");
    assert!(server.get("out.slices").unwrap() == whole);
    assert!(server.store().requests.iter().all(|line| line.contains(" /bucket/")), "{:?}", server.store().requests);
    server.set(Fault::Refuses, When::From(0));
    let said = String::from_utf8(run(None).stderr).unwrap();
    assert!(said.contains("403") && said.contains("no credentials are set"), "{said}");
}

#[test]
fn whatever_a_store_does_wrong_the_bytes_are_right_or_nothing_is_there() {
    let (folder, server, whole) = job();
    let at = folder.path();
    let (west, east) = (server.get("west.laz").unwrap(), server.get("east.las").unwrap());
    let run = |fault: Fault, when: When| {
        server.put("west.laz", west.clone());
        server.put("east.las", east.clone());
        server.store().objects.remove("/bucket/out.slices");
        server.set(fault, when);
        let done = server.done(at, &from_and_to("s3://bucket/out.slices"));
        let found = server.get("out.slices");
        assert!(found.as_ref().is_none_or(|found| *found == whole), "{fault:?} {when:?}: other bytes");
        assert_eq!(done.is_ok(), found.is_some() || done.is_ok(), "{fault:?} {when:?}: {done:?}");
        done
    };
    run(Fault::Fails, When::Never).unwrap();
    let requests = server.store().requests.len();
    for fault in [Fault::Throttles, Fault::Closes, Fault::Cuts, Fault::OtherRange, Fault::Mute] {
        let mut succeeded = 0;
        for number in (0..requests).step_by(5).chain([requests - 2, requests - 1]) {
            succeeded += usize::from(run(fault, When::Once(number)).is_ok());
        }
        // A single failed connection is retried; a wrong range is not accepted.
        if matches!(fault, Fault::Throttles | Fault::Closes) {
            assert_eq!(succeeded, requests.div_ceil(5) + 2, "{fault:?}");
        }
    }
    run(Fault::Throttles, When::Share(20)).unwrap();
    // The last three requests look up the output, write it, and look it up again.
    for (fault, at) in [(Fault::Refuses, 0), (Fault::Refuses, requests / 2), (Fault::Refuses, requests - 3)]
        .into_iter()
        .chain([0, requests / 2, requests - 5].map(|at| (Fault::Replaced, at)))
    {
        let said = run(fault, When::From(at)).unwrap_err();
        assert!(fault == Fault::Replaced || said.contains("403"), "{fault:?} from {at}: {said}");
        assert!(server.get("out.slices").is_none(), "{fault:?} from {at}: {said}");
    }
    assert!(server.store().uploads.is_empty());
}

#[test]
fn a_large_archive_appears_whole_by_parts_that_are_thrown_away_if_one_fails() {
    let folder = tempfile::tempdir().unwrap();
    let (at, server) = (folder.path(), Server::new(SLICECONV));
    let mut random = Random(3);
    let scattered: Vec<[f64; 3]> = (0..3_200_000)
        .map(|_| [40.0, 40.0, 12.0].map(|size| (random.uniform() * size * 1000.0).round() / 1000.0))
        .collect();
    write(&at.join("dust.las"), &scattered);
    let arguments = |output: &'static str| ["dust.las", "-o", output, "--quiet", "--pixel", "0.05", "--units", "m"];
    converts(at, &arguments("dust.slices"));
    let whole = fs::read(at.join("dust.slices")).unwrap();
    assert!(whole.len() > 5 << 20, "{} bytes are one part", whole.len());
    server.done(at, &arguments("s3://bucket/dust.slices")).unwrap();
    assert!(server.get("dust.slices").unwrap() == whole);
    let requests = server.store().requests.clone();
    assert!(requests.iter().filter(|line| line.contains("partNumber=")).count() >= 2, "{requests:?}");
    server.store().objects.clear();
    let first = requests.iter().position(|line| line.contains("partNumber=")).unwrap();
    for (fault, when) in [(Fault::Refuses, When::Once(first)), (Fault::Refuses, When::Once(first + 1))] {
        server.set(fault, when);
        server.done(at, &arguments("s3://bucket/dust.slices")).unwrap_err();
        let store = server.store();
        assert!(store.objects.is_empty() && store.uploads.is_empty(), "{:?}", store.requests);
    }
    server.set(Fault::Throttles, When::Share(30));
    server.done(at, &arguments("s3://bucket/dust.slices")).unwrap();
    assert!(server.get("dust.slices").unwrap() == whole);
    // Killed in the middle of the upload: nothing is visible, and the next run is not affected.
    server.store().objects.clear();
    server.set(Fault::Throttles, When::Never);
    let mut program = server.program(at);
    let mut killed = program.args(arguments("s3://bucket/dust.slices")).spawn().unwrap();
    while !server.store().requests.iter().any(|line| line.contains("partNumber=1")) {
        assert!(killed.try_wait().unwrap().is_none(), "it ended before it wrote");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert!(server.get("dust.slices").is_none_or(|there| there == whole));
    server.store().objects.clear();
    server.done(at, &arguments("s3://bucket/dust.slices")).unwrap();
    assert!(server.get("dust.slices").unwrap() == whole);
    // The first writer wins, also between the last lookup and the last request.
    server.store().objects.clear();
    server.store().uploads.clear();
    server.store().rival = Some(b"first".to_vec());
    let said = server.done(at, &arguments("s3://bucket/dust.slices")).unwrap_err();
    assert!(said.contains("exists already"), "{said}");
    assert_eq!(server.get("dust.slices").unwrap(), b"first");
    assert!(server.store().uploads.is_empty());
}
