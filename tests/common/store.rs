//! A server on loopback that implements the needed part of S3 and misbehaves at one request, at a fraction of them, or
//! from one on. No request leaves the machine: credentials and address come from the programs' environment.
#![allow(dead_code, reason = "each test file uses a part")]

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

/// Misbehaviour of the store.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// 503 with a delay to wait.
    Throttles,
    /// 500.
    Fails,
    /// Reads the request and closes.
    Closes,
    /// Carries out the request, and closes without an answer.
    Mute,
    /// Stops in the middle of the body.
    Cuts,
    /// Returns another range than the requested one, and states it.
    OtherRange,
    /// Another writer has just replaced the object.
    Replaced,
    /// 403.
    Refuses,
}

/// Requests that a fault affects.
#[derive(Debug, Clone, Copy)]
pub enum When {
    Never,
    Once(usize),
    From(usize),
    /// This percentage of them.
    Share(u64),
}

pub struct Store {
    pub objects: BTreeMap<String, Vec<u8>>,
    versions: BTreeMap<String, u64>,
    /// Multipart uploads that were begun and neither completed nor aborted.
    pub uploads: BTreeMap<String, BTreeMap<u32, Vec<u8>>>,
    begun: usize,
    /// Listed names, if they differ from the stored ones.
    pub listed: Option<Vec<String>>,
    /// Another writer's object, which appears under the name of an upload just before its last request.
    pub rival: Option<Vec<u8>>,
    /// Number of requests after which an object gets other bytes.
    pub swap: Option<(usize, String, Vec<u8>)>,
    /// Number of parts that must arrive before they are answered, waiting a few seconds at most.
    pub gathers: usize,
    /// Parts of uploads received, those not yet answered, and the peak of the latter.
    pub parts: [usize; 3],
    /// Request lines of all requests.
    pub requests: Vec<String>,
    /// Connections that clients opened.
    pub connections: usize,
    fault: Fault,
    when: When,
}

pub struct Server {
    pub address: String,
    program: &'static str,
    store: Arc<Mutex<Store>>,
    stop: Arc<AtomicBool>,
}

impl Server {
    /// A store for the program that [`run`](Self::run) runs.
    pub fn new(program: &'static str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let store = Store {
            objects: BTreeMap::new(),
            versions: BTreeMap::new(),
            uploads: BTreeMap::new(),
            begun: 0,
            listed: None,
            rival: None,
            swap: None,
            gathers: 0,
            parts: [0; 3],
            requests: Vec::new(),
            connections: 0,
            fault: Fault::Fails,
            when: When::Never,
        };
        let (store, stop) = (Arc::new(Mutex::new(store)), Arc::new(AtomicBool::new(false)));
        let (shared, stopped) = (store.clone(), stop.clone());
        std::thread::spawn(move || {
            for client in listener.incoming() {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                let shared = shared.clone();
                shared.lock().unwrap().connections += 1;
                std::thread::spawn(move || client.and_then(|client| answer_all(client, &shared)));
            }
        });
        Self { address, program, store, stop }
    }

    pub fn store(&self) -> MutexGuard<'_, Store> {
        self.store.lock().unwrap()
    }

    pub fn put(&self, key: &str, bytes: Vec<u8>) {
        self.store().put(&format!("/bucket/{key}"), bytes);
    }

    pub fn get(&self, key: &str) -> Option<Vec<u8>> {
        self.store().objects.get(&format!("/bucket/{key}")).cloned()
    }

    /// Forgets earlier requests, and misbehaves in this way from now on.
    pub fn set(&self, fault: Fault, when: When) {
        let mut store = self.store();
        (store.fault, store.when) = (fault, when);
        store.requests.clear();
        (store.connections, store.parts) = (0, [0; 3]);
    }

    /// The program in `folder` with access only to this store, without credentials.
    pub fn stranger(&self, folder: &Path) -> Command {
        let mut command = Command::new(self.program);
        for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("AWS_")) {
            command.env_remove(name);
        }
        command.current_dir(folder).env("AWS_ENDPOINT", format!("http://{}", self.address));
        command.env("AWS_ALLOW_HTTP", "true");
        command
    }

    /// The program with credentials.
    pub fn program(&self, folder: &Path) -> Command {
        let mut command = self.stranger(folder);
        command.env("AWS_ACCESS_KEY_ID", "id").env("AWS_SECRET_ACCESS_KEY", "very-secret").env("AWS_REGION", "here");
        command
    }

    pub fn run(&self, folder: &Path, arguments: &[&str]) -> Output {
        self.program(folder).args(arguments).output().unwrap()
    }

    /// Checks that the program succeeds, or returns its one-line error, which must not contain a secret.
    pub fn done(&self, folder: &Path, arguments: &[&str]) -> Result<(), String> {
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

    /// Fault of the request now recorded.
    fn fault(&mut self, line: String) -> Option<Fault> {
        let number = self.requests.len();
        self.requests.push(line);
        if let Some((_, path, bytes)) = self.swap.take_if(|(at, ..)| *at == number) {
            self.put(&path, bytes);
        }
        let strikes = match self.when {
            When::Never => false,
            When::Once(at) => number == at,
            When::From(at) => number >= at,
            When::Share(percent) => {
                ((number as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 33) % 128 < percent * 128 / 100
            }
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
                // Two per page.
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
                let id = format!("upload{}", self.begun);
                self.begun += 1;
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

/// Answers the requests of a connection in turn.
fn answer_all(mut client: TcpStream, store: &Mutex<Store>) -> std::io::Result<()> {
    client.set_nodelay(true)?;
    let mut reader = BufReader::new(client.try_clone()?);
    while answer(&mut client, &mut reader, store)? {}
    Ok(())
}

/// Answers one request; returns whether the connection stays open.
fn answer(client: &mut TcpStream, reader: &mut impl BufRead, store: &Mutex<Store>) -> std::io::Result<bool> {
    let mut head: Vec<String> = Vec::new();
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line)? == 0 || line.trim().is_empty() {
            break;
        }
        head.push(line.trim().to_owned());
    }
    let Some((method, rest)) = head.first().and_then(|line| line.split_once(' ')) else { return Ok(false) };
    let target = rest.split(' ').next().unwrap_or_default().to_owned();
    let length =
        head.iter().find_map(|line| line.to_ascii_lowercase().strip_prefix("content-length:")?.trim().parse().ok());
    let mut body = vec![0; length.unwrap_or(0)];
    let is_part = target.contains("partNumber=");
    if is_part {
        gather(store);
    }
    reader.read_exact(&mut body)?;
    let mut store = store.lock().unwrap();
    store.parts[1] -= usize::from(is_part);
    let fault = store.fault(format!("{method} {target}"));
    let refusal = match fault {
        Some(Fault::Throttles) => Some("503 Slow Down\r\nRetry-After: 0"),
        Some(Fault::Fails) => Some("500 Internal Server Error"),
        Some(Fault::Refuses) => Some("403 Forbidden"),
        Some(Fault::Closes) => return Ok(false),
        Some(Fault::Replaced) => {
            let path = target.split('?').next().unwrap().to_owned();
            if let (true, Some(bytes)) = (method == "GET", store.objects.get(&path).cloned()) {
                let flipped = bytes.iter().map(|byte| byte ^ 1).collect();
                store.put(&path, flipped);
            }
            None
        }
        _ => None,
    };
    if let Some(status) = refusal {
        client.write_all(format!("HTTP/1.1 {status}\r\nContent-Length: 3\r\n\r\nno\n").as_bytes())?;
        return Ok(true);
    }
    let (status, mut more, mut bytes) = store.answer(method, &target, &head, body);
    drop(store);
    let mut length = bytes.len();
    let mut stays = true;
    match fault {
        Some(Fault::Mute) => return Ok(false),
        Some(Fault::Cuts) if length > 1 => {
            bytes.truncate(length / 2);
            stays = false;
        }
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
    let head = format!("HTTP/1.1 {status}\r\n{more}Content-Length: {length}\r\n\r\n");
    client.write_all(&[head.as_bytes(), &bytes].concat())?;
    Ok(stays)
}

/// Counts a part of an upload, and waits for others.
fn gather(store: &Mutex<Store>) {
    let mut held = store.lock().unwrap();
    held.parts[0] += 1;
    held.parts[1] += 1;
    held.parts[2] = held.parts[2].max(held.parts[1]);
    for _ in 0..10_000 {
        if held.parts[0] >= held.gathers {
            return;
        }
        drop(held);
        std::thread::sleep(std::time::Duration::from_millis(1));
        held = store.lock().unwrap();
    }
}
