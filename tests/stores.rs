//! Conversion from and to an object store: the bytes of local files, or an error of one line and nothing half visible,
//! whatever the store does wrong.
//!
//! The store is a server on loopback that speaks as much of S3 as is needed. It misbehaves at one request, at a share of
//! them, or from one on. Nothing asks a cloud: credentials and address come from the environment of the programs.
#![cfg(all(feature = "cli", feature = "remote"))]

#[path = "common/scans.rs"]
mod scans;

use scans::{Random, command, converts, points, write};
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Output;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use tempfile::TempDir;

/// What the store does to a request instead of answering it.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    /// 503 with a wish to wait.
    Throttles,
    /// 500.
    Fails,
    /// Reads the request and closes.
    Closes,
    /// Does what it was asked for, and closes without an answer.
    Mute,
    /// Stops in the middle of the body.
    Cuts,
    /// Gives other bytes than those that were asked for, and says so.
    OtherRange,
    /// Another writer has just replaced the object.
    Replaced,
    /// 403.
    Refuses,
}

/// Which requests a fault meets.
#[derive(Debug, Clone, Copy)]
enum When {
    Never,
    Once(usize),
    From(usize),
    /// So many of a hundred.
    Share(usize),
}

struct Store {
    objects: BTreeMap<String, Vec<u8>>,
    versions: BTreeMap<String, u64>,
    uploads: BTreeMap<String, BTreeMap<u32, Vec<u8>>>,
    /// What lists show, if not what is there.
    listed: Option<Vec<String>>,
    /// Another writer's object appears under the name of an upload just before its last request.
    rival: Option<Vec<u8>>,
    /// First lines of all requests.
    requests: Vec<String>,
    fault: Fault,
    when: When,
    dice: Random,
}

struct Server {
    address: String,
    store: Arc<Mutex<Store>>,
    stop: Arc<AtomicBool>,
}

impl Server {
    fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let store = Store {
            objects: BTreeMap::new(),
            versions: BTreeMap::new(),
            uploads: BTreeMap::new(),
            listed: None,
            rival: None,
            requests: Vec::new(),
            fault: Fault::Fails,
            when: When::Never,
            dice: Random(7),
        };
        let (store, stop) = (Arc::new(Mutex::new(store)), Arc::new(AtomicBool::new(false)));
        let (shared, stopped) = (store.clone(), stop.clone());
        std::thread::spawn(move || {
            for client in listener.incoming() {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                let shared = shared.clone();
                std::thread::spawn(move || client.and_then(|client| answer(client, &shared)));
            }
        });
        Self { address, store, stop }
    }

    fn store(&self) -> MutexGuard<'_, Store> {
        self.store.lock().unwrap()
    }

    fn put(&self, key: &str, bytes: Vec<u8>) {
        self.store().put(&format!("/bucket/{key}"), bytes);
    }

    fn get(&self, key: &str) -> Option<Vec<u8>> {
        self.store().objects.get(&format!("/bucket/{key}")).cloned()
    }

    /// Forgets what was asked, and misbehaves so from now on.
    fn set(&self, fault: Fault, when: When) {
        let mut store = self.store();
        (store.fault, store.when) = (fault, when);
        store.requests.clear();
    }

    /// The program, which knows of this store alone.
    fn program(&self, folder: &Path) -> std::process::Command {
        let mut command = command(folder);
        for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("AWS_")) {
            command.env_remove(name);
        }
        command
            .env("AWS_ENDPOINT", format!("http://{}", self.address))
            .env("AWS_ALLOW_HTTP", "true")
            .env("AWS_ACCESS_KEY_ID", "id")
            .env("AWS_SECRET_ACCESS_KEY", "very-secret")
            .env("AWS_REGION", "here");
        command
    }

    fn run(&self, folder: &Path, arguments: &[&str]) -> Output {
        self.program(folder).args(arguments).output().unwrap()
    }

    /// Succeeds, or says one line that holds no secret; returns whether it succeeded.
    fn done(&self, folder: &Path, arguments: &[&str]) -> Result<(), String> {
        let out = self.run(folder, arguments);
        let said = String::from_utf8(out.stderr).unwrap();
        assert!(!said.contains("very-secret") && !said.contains("panicked"), "{said}");
        match out.status.code() {
            Some(0) => Ok(()),
            Some(1) => {
                assert_eq!(said.lines().filter(|line| !line.contains("warning")).count(), 1, "{said}");
                Err(said)
            }
            other => panic!("{other:?}: {said}"),
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = TcpStream::connect(&self.address);
    }
}

impl Store {
    fn put(&mut self, path: &str, bytes: Vec<u8>) {
        self.objects.insert(path.to_owned(), bytes);
        *self.versions.entry(path.to_owned()).or_default() += 1;
    }

    /// What meets the request that is now noted.
    fn fault(&mut self, line: String) -> Option<Fault> {
        let number = self.requests.len();
        self.requests.push(line);
        let strikes = match self.when {
            When::Never => false,
            When::Once(at) => number == at,
            When::From(at) => number >= at,
            When::Share(percent) => self.dice.chance(percent),
        };
        strikes.then_some(self.fault)
    }

    /// Status line, header lines and body for a request.
    fn answer(&mut self, method: &str, target: &str, head: &[String], body: Vec<u8>) -> (String, String, Vec<u8>) {
        let field = |name: &str| {
            let is_it = |line: &&String| line.to_ascii_lowercase().starts_with(&format!("{name}:"));
            head.iter().find(is_it).map(|line| line[name.len() + 1..].trim().to_owned())
        };
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let query: BTreeMap<&str, &str> =
            query.split('&').map(|pair| pair.split_once('=').unwrap_or((pair, ""))).collect();
        let tag = self.versions.get(path).map_or(String::new(), |version| format!("\"v{version}\""));
        let plain = |status: &str| (status.to_owned(), String::new(), Vec::new());
        match method {
            "GET" if query.contains_key("list-type") => {
                let plain_text = |text: &str| text.replace("%2F", "/").replace("%20", " ").replace('+', " ");
                let value = |name: &str| query.get(name).map_or(String::new(), |text| plain_text(text));
                let (prefix, after) = (value("prefix"), value("continuation-token"));
                let all = self.listed.clone().unwrap_or_else(|| self.objects.keys().cloned().collect());
                let keys: Vec<String> =
                    all.iter().filter_map(|key| key.strip_prefix("/bucket/")).map(plain_text).collect();
                let direct = |key: &&String| value("delimiter").is_empty() || !key[prefix.len()..].contains('/');
                let found = keys.iter().filter(|key| key.starts_with(&prefix) && **key > after).filter(direct);
                // Two at a time.
                let page: Vec<&String> = found.take(3).collect();
                let more = page.len() == 3;
                let contents: String = page
                    .iter()
                    .take(2)
                    .map(|key| {
                        format!(
                            "<Contents><Key>{key}</Key><LastModified>2025-06-03T10:00:00.000Z</LastModified>\
                             <ETag>\"x\"</ETag><Size>1</Size></Contents>"
                        )
                    })
                    .collect();
                let next = match more {
                    true => format!("<NextContinuationToken>{}</NextContinuationToken>", page[1]),
                    false => String::new(),
                };
                let xml = format!(
                    "<ListBucketResult><Name>bucket</Name><Prefix>{prefix}</Prefix><KeyCount>2</KeyCount><MaxKeys>2</MaxKeys>\
                     <IsTruncated>{more}</IsTruncated>{contents}{next}</ListBucketResult>"
                );
                ("200 OK".into(), String::new(), xml.into_bytes())
            }
            "GET" | "HEAD" => {
                let Some(bytes) = self.objects.get(path) else { return plain("404 Not Found") };
                let dates = format!("ETag: {tag}\r\nLast-Modified: Tue, 03 Jun 2025 10:00:00 GMT\r\n");
                if field("if-match").is_some_and(|wanted| wanted != tag) {
                    return plain("412 Precondition Failed");
                }
                if method == "HEAD" {
                    return ("200 OK".into(), format!("{dates}X-Length: {}\r\n", bytes.len()), Vec::new());
                }
                let range = field("range").unwrap();
                let (from, to) = range.strip_prefix("bytes=").unwrap().split_once('-').unwrap();
                let (from, to) = (from.parse::<usize>().unwrap(), to.parse::<usize>().unwrap());
                if from >= bytes.len() {
                    return plain("416 Range Not Satisfiable");
                }
                let to = to.min(bytes.len() - 1);
                let about = format!("{dates}Content-Range: bytes {from}-{to}/{}\r\n", bytes.len());
                ("206 Partial Content".into(), about, bytes[from..=to].to_vec())
            }
            "POST" if query.contains_key("uploads") => {
                let id = format!("upload{}", self.uploads.len());
                self.uploads.insert(id.clone(), BTreeMap::new());
                let xml = format!(
                    "<InitiateMultipartUploadResult><Bucket>b</Bucket><Key>k</Key><UploadId>{id}</UploadId>\
                     </InitiateMultipartUploadResult>"
                );
                ("200 OK".into(), String::new(), xml.into_bytes())
            }
            "PUT" if query.contains_key("uploadId") => {
                let number: u32 = query["partNumber"].parse().unwrap();
                let Some(upload) = self.uploads.get_mut(query["uploadId"]) else { return plain("404 Not Found") };
                upload.insert(number, body);
                ("200 OK".into(), format!("ETag: \"p{number}\"\r\n"), Vec::new())
            }
            "POST" => {
                if let Some(rival) = self.rival.take() {
                    self.put(path, rival);
                }
                if field("if-none-match").is_some() && self.objects.contains_key(path) {
                    return plain("412 Precondition Failed");
                }
                let Some(parts) = self.uploads.remove(query["uploadId"]) else { return plain("404 Not Found") };
                assert!(parts.keys().copied().eq(1..=parts.len() as u32));
                self.put(path, parts.into_values().flatten().collect());
                let xml = "<CompleteMultipartUploadResult><Bucket>b</Bucket><Key>k</Key><ETag>\"x\"</ETag>\
                           </CompleteMultipartUploadResult>";
                ("200 OK".into(), String::new(), xml.into())
            }
            "PUT" => {
                if field("if-none-match").is_some() && self.objects.contains_key(path) {
                    return plain("412 Precondition Failed");
                }
                self.put(path, body);
                let tag = format!("ETag: \"v{}\"\r\n", self.versions[path]);
                ("200 OK".into(), tag, Vec::new())
            }
            "DELETE" => {
                self.uploads.remove(query["uploadId"]);
                plain("204 No Content")
            }
            other => panic!("{other} {target}"),
        }
    }
}

/// One request per connection.
fn answer(mut client: TcpStream, store: &Mutex<Store>) -> std::io::Result<()> {
    let mut reader = BufReader::new(client.try_clone()?);
    let mut head: Vec<String> = Vec::new();
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line)? == 0 || line.trim().is_empty() {
            break;
        }
        head.push(line.trim().to_owned());
    }
    let Some((method, rest)) = head.first().and_then(|line| line.split_once(' ')) else { return Ok(()) };
    let target = rest.split(' ').next().unwrap_or_default().to_owned();
    let length =
        head.iter().find_map(|line| line.to_ascii_lowercase().strip_prefix("content-length:")?.trim().parse().ok());
    let mut body = vec![0; length.unwrap_or(0)];
    reader.read_exact(&mut body)?;
    let mut store = store.lock().unwrap();
    let fault = store.fault(format!("{method} {target}"));
    let refusal = |status: &str, more: &str| {
        format!("HTTP/1.1 {status}\r\n{more}Content-Length: 3\r\nConnection: close\r\n\r\nno\n").into_bytes()
    };
    match fault {
        Some(Fault::Throttles) => return client.write_all(&refusal("503 Slow Down", "Retry-After: 0\r\n")),
        Some(Fault::Fails) => return client.write_all(&refusal("500 Internal Server Error", "")),
        Some(Fault::Refuses) => return client.write_all(&refusal("403 Forbidden", "")),
        Some(Fault::Closes) => return Ok(()),
        Some(Fault::Replaced) => {
            let path = target.split('?').next().unwrap().to_owned();
            if let (true, Some(bytes)) = (method == "GET", store.objects.get(&path).cloned()) {
                let flipped = bytes.iter().map(|byte| byte ^ 1).collect();
                store.put(&path, flipped);
            }
        }
        _ => {}
    }
    let (status, mut more, mut bytes) = store.answer(method, &target, &head, body);
    drop(store);
    let mut length = bytes.len();
    match fault {
        Some(Fault::Mute) => return Ok(()),
        Some(Fault::Cuts) if length > 1 => bytes.truncate(length / 2),
        Some(Fault::OtherRange) if status.starts_with("206") && length > 1 => {
            let at = more.find("bytes ").unwrap() + 6;
            let dash = at + more[at..].find('-').unwrap();
            let from: usize = more[at..dash].parse().unwrap();
            more.replace_range(at..dash, &(from + 1).to_string());
            bytes.remove(0);
            length -= 1;
        }
        _ => {}
    }
    if let Some(at) = more.find("X-Length: ") {
        length = more[at + 10..].trim().parse().unwrap();
        more.truncate(at);
    }
    write!(client, "HTTP/1.1 {status}\r\n{more}Content-Length: {length}\r\nConnection: close\r\n\r\n")?;
    client.write_all(&bytes)
}

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
    let server = Server::new();
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
fn scans_plans_parts_and_archives_in_a_store_have_the_bytes_of_local_ones() {
    let (folder, server, whole) = job();
    let at = folder.path();
    server.done(at, &from_and_to("s3://bucket/out/whole.slices")).unwrap();
    assert!(server.get("out/whole.slices").unwrap() == whole);
    // A scan of 700 kB takes few requests, and what is read ahead of it is not read twice.
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
    let local = format!("file://{}", at.join("west.laz").display());
    let output = format!("file://{}", at.join("by%20name.slices").display());
    server.done(at, &[&[&local[..], INPUTS[1], "-o", &output, "--quiet"], &OPTIONS[..]].concat()).unwrap();
    assert!(fs::read(at.join("by name.slices")).unwrap() == whole);
    // A plan and its parts; what is there stays without --force, and a stranger stays with it.
    server.done(at, &[&INPUTS[..], &["--write-plan", "s3://bucket/plan.json", "--quiet"], &OPTIONS].concat()).unwrap();
    for shard in ["1/2", "2/2"] {
        let name = format!("s3://bucket/part{}.slices", &shard[..1]);
        let part = ["--plan", "s3://bucket/plan.json", "--shard", shard, "-o", &name, "--quiet"];
        server.done(at, &[&INPUTS[..], &part].concat()).unwrap();
    }
    for part in ["part1.slices", "part2.slices"] {
        fs::write(at.join(part), server.get(part).unwrap()).unwrap();
    }
    let parts = ["part1.slices", "part2.slices"].map(|part| at.join(part));
    slicewalk::archive::merge(&parts, &at.join("merged.slices"), false, &slicewalk::NoMonitor).unwrap();
    assert!(fs::read(at.join("merged.slices")).unwrap() == whole);
    let said = server.done(at, &from_and_to("s3://bucket/out/whole.slices")).unwrap_err();
    assert!(said.contains("exists already; --force"), "{said}");
    server.put("notes.txt", b"mine".to_vec());
    let said = server.done(at, &[&from_and_to("s3://bucket/notes.txt")[..], &["--force"]].concat()).unwrap_err();
    assert!(said.contains("not a slice archive"), "{said}");
    assert_eq!(server.get("notes.txt").unwrap(), b"mine");
    server.done(at, &[&from_and_to("s3://bucket/part1.slices")[..], &["--force"]].concat()).unwrap();
    assert!(server.get("part1.slices").unwrap() == whole);
    for (arguments, words) in [
        (vec!["s3://bucket/none.laz", "-o", "x.slices"], "cannot open: no such object (HTTP status 404 Not Found)"),
        (vec!["s3://bucket/room.obj", "-o", "x.slices"], "meshes are read from files only"),
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
    // An old list names what is gone; and it lacks what is new, which the plan of another list notices.
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

#[test]
fn a_part_asks_for_no_tile_that_its_columns_do_not_meet() {
    let folder = tempfile::tempdir().unwrap();
    let (at, server, mut random) = (folder.path(), Server::new(), Random(9));
    let names: Vec<String> = (0..16).map(|number| format!("t{number:02}.laz")).collect();
    for (number, name) in names.iter().enumerate() {
        let corner = [20.0 * (number % 4) as f64, 20.0 * (number / 4) as f64, 0.0];
        let mut along = |axis: usize, size: f64| corner[axis] + (random.uniform() * size * 1000.0).round() / 1000.0;
        let tile: Vec<[f64; 3]> = (0..2000).map(|_| [along(0, 12.0), along(1, 12.0), along(2, 0.5)]).collect();
        write(&at.join(name), &tile);
        server.put(&format!("tiles/{name}"), fs::read(at.join(name)).unwrap());
    }
    let local: Vec<&str> = names.iter().map(|name| &name[..]).collect();
    converts(at, &[&local[..], &["-o", "whole.slices", "--quiet"], &OPTIONS].concat());
    let whole = fs::read(at.join("whole.slices")).unwrap();
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
    slicewalk::archive::merge(&parts, &at.join("merged.slices"), false, &slicewalk::NoMonitor).unwrap();
    assert!(fs::read(at.join("merged.slices")).unwrap() == whole);
    // A tile that was replaced is noticed by the parts that read it, and by these alone.
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
    // One is gone, and one is there that the plan does not know.
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
        let mut program = command(at);
        for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("AWS_")) {
            program.env_remove(name);
        }
        program.env("AWS_ENDPOINT", format!("http://{}", server.address)).env("AWS_ALLOW_HTTP", "true");
        // Whoever asks another server shows here.
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
        // One failure of a connection passes; a range that is not the one asked for does not.
        if matches!(fault, Fault::Throttles | Fault::Closes) {
            assert_eq!(succeeded, requests.div_ceil(5) + 2, "{fault:?}");
        }
    }
    run(Fault::Throttles, When::Share(20)).unwrap();
    // The last three look for the output, write it, and look again.
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
    let (at, server) = (folder.path(), Server::new());
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
    // Killed in the middle of the upload: nothing is visible, and the next run is not in its way.
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
    // Whoever is first stays, also if that is between the last look and the last request.
    server.store().objects.clear();
    server.store().uploads.clear();
    server.store().rival = Some(b"first".to_vec());
    let said = server.done(at, &arguments("s3://bucket/dust.slices")).unwrap_err();
    assert!(said.contains("exists already"), "{said}");
    assert_eq!(server.get("dust.slices").unwrap(), b"first");
    assert!(server.store().uploads.is_empty());
}
