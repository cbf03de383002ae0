//! Archives on a web server: few requests, and an error for whatever a server can do wrong.

#[path = "stream/tower.rs"]
mod tower;

use slicewalk::archive::{Archive, PageEntry};
use slicewalk::bytes::{ByteSource, RemoteOptions, RemoteSource};
use slicewalk::query::{Overlap, overlaps};
use slicewalk::store::{Prefetch, Step, Stream, StreamOptions};
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tower::{Body, resident, tower};

/// What the server does to requests.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Manner {
    Good,
    /// Gives everything with status 200.
    Whole,
    /// Stops in the middle of the body and closes.
    Short,
    /// Stops in the middle of the first body, and is good again.
    ShortOnce,
    /// Says that the object has another version, and asks no questions.
    OtherTag,
    NotFound,
    Closes,
    Fails,
    /// Gives other bytes than those asked for.
    OtherRange,
}

struct State {
    bytes: Vec<u8>,
    tag: Option<String>,
    manner: Manner,
    /// Header lines of all requests.
    requests: Vec<Vec<String>>,
}

struct Server {
    url: String,
    state: Arc<Mutex<State>>,
    stop: Arc<AtomicBool>,
}

impl Server {
    fn new(bytes: Vec<u8>, tag: Option<&str>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/scans/tower.slices", listener.local_addr().unwrap());
        let tag = tag.map(str::to_string);
        let state = Arc::new(Mutex::new(State { bytes, tag, manner: Manner::Good, requests: Vec::new() }));
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, stopped) = (state.clone(), stop.clone());
        std::thread::spawn(move || {
            for client in listener.incoming() {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                let _ = answer(client.unwrap(), &shared);
            }
        });
        Self { url, state, stop }
    }

    fn set(&self, manner: Manner) {
        self.state.lock().unwrap().manner = manner;
    }

    fn count(&self) -> usize {
        self.state.lock().unwrap().requests.len()
    }

    fn source(&self) -> slicewalk::Result<RemoteSource> {
        let options = RemoteOptions { timeout: Duration::from_secs(5), retries: 1, ..RemoteOptions::default() };
        RemoteSource::with(&self.url, &options)
    }

    fn archive(&self) -> Archive {
        Archive::from_source(Box::new(self.source().unwrap())).unwrap()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = TcpStream::connect(self.url.split('/').nth(2).unwrap());
    }
}

/// One request per connection.
fn answer(mut client: TcpStream, state: &Mutex<State>) -> std::io::Result<()> {
    let lines = BufReader::new(client.try_clone()?).lines().map_while(Result::ok);
    let head: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
    if head.is_empty() {
        return Ok(());
    }
    let field = |name: &str| head.iter().find_map(|line| line.to_lowercase().strip_prefix(name).map(str::to_string));
    let mut state = state.lock().unwrap();
    state.requests.push(head.clone());
    let manner = state.manner;
    if manner == Manner::ShortOnce {
        state.manner = Manner::Good;
    }
    let len = state.bytes.len();
    let range = field("range: bytes=").unwrap_or_default();
    let (first, last) = range.split_once('-').unwrap_or(("0", ""));
    let (first, last) = (first.parse::<usize>().unwrap_or(0), last.parse::<usize>().unwrap_or(len).min(len - 1));
    let tag = match manner {
        Manner::OtherTag => Some("\"other\"".to_string()),
        _ => state.tag.clone(),
    };
    let tag_line = tag.as_ref().map_or(String::new(), |tag| format!("ETag: {tag}\r\n"));
    let matches = field("if-match: ").is_none_or(|wanted| Some(wanted) == tag.as_ref().map(|tag| tag.to_lowercase()));
    let status = match manner {
        Manner::Closes => return Ok(()),
        Manner::NotFound => Some("404 Not Found"),
        Manner::Fails => Some("503 Service Unavailable"),
        Manner::OtherTag => None,
        _ if !matches => Some("412 Precondition Failed"),
        _ => None,
    };
    if let Some(status) = status {
        return write!(client, "HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
    }
    let (code, body, range) = match manner {
        Manner::Whole => ("200 OK", &state.bytes[..], String::new()),
        _ => {
            let shift = usize::from(manner == Manner::OtherRange);
            let range = format!("Content-Range: bytes {}-{last}/{len}\r\n", first + shift);
            ("206 Partial Content", &state.bytes[first + shift..=last], range)
        }
    };
    let length = body.len();
    write!(client, "HTTP/1.1 {code}\r\n{tag_line}{range}Content-Length: {length}\r\nConnection: close\r\n\r\n")?;
    let short = matches!(manner, Manner::Short | Manner::ShortOnce);
    client.write_all(if short { &body[..length / 2] } else { body })
}

/// The error; without it no whole page is printed, as `expect_err` does.
fn error_of<T>(result: slicewalk::Result<T>) -> slicewalk::Error {
    result.err().unwrap_or_else(|| panic!("an error was expected"))
}

/// A page beyond the bytes that came with the first request.
fn last_stored(archive: &Archive) -> PageEntry {
    let stored = |entry: &PageEntry| entry.extent().is_some_and(|extent| extent.offset > 16384);
    archive.entries().map(Result::unwrap).filter(stored).last().unwrap()
}

#[test]
fn an_archive_opens_with_two_requests_and_streams_with_few() {
    let bytes = tower(3.0, 60.0, 5);
    let server = Server::new(bytes.clone(), Some("\"one\""));
    let archive = server.archive();
    assert_eq!(server.count(), 2, "head and footer");
    assert_eq!(archive.source().len(), bytes.len() as u64);
    let options = StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(16 << 20) };
    let stream = Stream::open(archive, options).unwrap();
    assert_eq!(server.count(), 3, "the whole directory");
    let mut pawn = stream.pawn();
    let body = Body::at(0.0, 0.0, 40.0);
    pawn.hint(&body.motion());
    while let Step::Loaded(_) = stream.step() {}
    assert!(stream.take_errors().is_empty());
    let counters = stream.counters();
    assert_eq!(server.count() as u64, 3 + counters.reads);
    println!("{} pages in {} requests", counters.loaded, counters.reads);
    assert!(counters.reads * 2 < counters.loaded);
    assert_eq!(overlaps(&stream.view(), &body.shape()), overlaps(&resident(&bytes), &body.shape()));
    let requests = &server.state.lock().unwrap().requests;
    let asks = |request: &Vec<String>| request.iter().any(|line| line.eq_ignore_ascii_case("if-match: \"one\""));
    assert!(!asks(&requests[0]) && requests[1..].iter().all(asks), "all but the first ask for the version");
}

#[test]
fn an_object_that_is_replaced_is_an_error_even_if_the_server_does_not_mind() {
    let (old, new) = (tower(2.0, 30.0, 1), tower(2.0, 30.0, 2));
    for tag in [Some("\"one\""), Some("W/\"one\""), None] {
        let server = Server::new(old.clone(), tag);
        let archive = server.archive();
        let entry = last_stored(&archive);
        let good = archive.page(&entry).unwrap();
        server.set(Manner::OtherTag);
        let error = error_of(archive.page(&entry)).to_string();
        assert!(error.contains("replaced"), "{error}");
        server.set(Manner::Good);
        {
            let mut state = server.state.lock().unwrap();
            state.bytes = new.clone();
            state.tag = tag.map(|tag| tag.replace("one", "two"));
        }
        // Without any tag it is the length or the checksum in the directory that tells.
        let error = error_of(archive.page(&entry)).to_string();
        assert!(["replaced", "rule P"].iter().any(|text| error.contains(text)), "{error}");
        *server.state.lock().unwrap() =
            State { bytes: old.clone(), tag: tag.map(str::to_string), manner: Manner::Good, requests: vec![] };
        assert!(archive.page(&entry).unwrap() == good);
    }
}

#[test]
fn whatever_a_server_does_wrong_is_an_error_and_passes_when_it_is_good_again() {
    let server = Server::new(tower(2.0, 30.0, 3), Some("\"one\""));
    let archive = server.archive();
    let entry = last_stored(&archive);
    let good = archive.page(&entry).unwrap();
    for manner in [Manner::Whole, Manner::Short, Manner::NotFound, Manner::Closes, Manner::Fails, Manner::OtherRange] {
        server.set(manner);
        let error = error_of(archive.page(&entry));
        assert!(matches!(error, slicewalk::Error::Io { .. }), "{manner:?}: {error}");
        println!("{manner:?}: {error}");
        let error = server.source().err();
        assert!(error.is_some(), "{manner:?}: opening");
        server.set(Manner::Good);
        assert!(archive.page(&entry).unwrap() == good, "{manner:?}");
    }
    server.set(Manner::ShortOnce);
    assert!(archive.page(&entry).unwrap() == good, "a lost connection is taken up again");
}

#[test]
fn a_stream_reports_a_server_that_went_away_and_its_answers_stay() {
    let server = Server::new(tower(2.0, 60.0, 4), Some("\"one\""));
    let options = StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(16 << 20) };
    let stream = Stream::open(server.archive(), options).unwrap();
    let (here, there) = (Body::at(1.0, 0.0, 3.0), Body::at(1.0, 0.0, 50.0));
    stream.load_around(&here.motion()).unwrap();
    server.set(Manner::Closes);
    let mut pawn = stream.pawn();
    pawn.hint(&there.motion());
    while let Step::Loaded(_) = stream.step() {}
    assert!(!stream.take_errors().is_empty());
    let view = stream.view();
    assert_eq!(overlaps(&view, &here.shape()), Overlap::Hit);
    assert!(matches!(overlaps(&view, &there.shape()), Overlap::NotLoaded(_)));
}

#[test]
fn a_file_is_an_object_too_and_addresses_without_sense_are_refused() {
    let bytes = tower(1.0, 9.0, 4);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.slices");
    std::fs::write(&path, &bytes).unwrap();
    let source = RemoteSource::open(&format!("file://{}", path.display())).unwrap();
    assert_eq!(source.len(), bytes.len() as u64);
    let mut all = vec![0; bytes.len()];
    source.read_at(0, &mut all).unwrap();
    assert_eq!(all, bytes);
    assert!(source.read_at(bytes.len() as u64, &mut [0]).is_err());
    assert!(source.read_at(u64::MAX, &mut [0]).is_err());
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(source.read_at(bytes.len() as u64 - 10, &mut [0; 10]).is_err(), "cut");
    for address in ["", "nothing", "ftp://host/a", "http://host/a?key=1", "file:///no/such/file"] {
        assert!(RemoteSource::open(address).is_err(), "{address}");
    }
}
